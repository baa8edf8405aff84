"""The SDK for asyncio: the calls of `tactile.client`, awaited; no thread.

>>> from tactile.client import aio
>>> async def main():
...     async with aio.connect() as display:
...         await display.select("wood-oak")
...         await display.touch((0.012, 0.003), velocity=(0.08, 0.0), normal_force=0.5)

The event loop also answers the server's pings: if a program blocks it for 150 ms, the server takes
the program as gone, and fades its waveforms.
"""

import functools
from collections.abc import Callable, Coroutine, Generator
from typing import Any, Generic, ParamSpec, TypeVar

from tactile.client.connection import AsyncConnection as AsyncConnection
from tactile.client.connection import Opener
from tactile.client.display import AsyncDisplay as AsyncDisplay
from tactile.client.telemetry import AsyncTelemetryStream as AsyncTelemetryStream

P = ParamSpec("P")
C = TypeVar("C", bound="AsyncConnection | AsyncDisplay")


class Opening(Generic[C]):
    """A connection or display that is being opened.

    ``await`` it, or use it in an ``async with``, which also closes it.

    Parameters
    ----------
    opener : Callable
        Coroutine function that opens it.
    """

    def __init__(self, opener: Callable[[], Coroutine[Any, Any, C]]) -> None:
        self._opener = opener

    def __await__(self) -> Generator[Any, None, C]:
        return self._opener().__await__()

    async def __aenter__(self) -> C:
        self._object = await self._opener()
        return self._object

    async def __aexit__(self, *_: object) -> None:
        await self._object.close()


def _opening(function: Callable[P, Coroutine[Any, Any, C]]) -> Callable[P, Opening[C]]:
    """Return a function with the same parameters, whose result is awaited or entered."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Opening[C]:
        return Opening(lambda: function(*args, **kwargs))

    return call


_opener = Opener(AsyncConnection, AsyncDisplay, threaded=False)
open_connection = _opening(_opener.open_connection)
connect = _opening(_opener.connect)
