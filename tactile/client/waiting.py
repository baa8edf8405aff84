"""How a call waits: either its thread is blocked, or other tasks of its event loop run meanwhile.

The SDK is written once, as coroutines that wait only by `BaseConnection._wait` and
`BaseConnection._sleep`. Under asyncio these suspend the task. In the synchronous SDK they block the
thread, so that a coroutine runs from its first line to its last without being suspended, in the
thread that called: `blocking` makes an ordinary function of it. No event loop and no second thread
lies between a call such as `estop` and the message that it sends.
"""

import asyncio
import functools
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from typing import Any, ParamSpec, Self, TypeVar

from tactile.errors import ClientTimeoutError

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


async def block(future: "Future[T]", timeout: float, what: str) -> T:
    """Return the result of a future; block the thread until it is there.

    Parameters
    ----------
    future : Future
        Future, which is canceled if its result does not come in time.
    timeout : float
        Longest wait [s].
    what : str
        Name of what is waited for, for the error message.

    Returns
    -------
    T
        Result of the future.

    Raises
    ------
    ClientTimeoutError
        If the result does not come in time.
    """
    try:
        return future.result(timeout)
    except BaseException as error:
        late = isinstance(error, TimeoutError) and not future.done()
        if not future.cancel() and late and future.done():
            return future.result()  # the result came meanwhile
        if late:
            raise ClientTimeoutError(f"{what}: no answer in {timeout:g} s") from None
        raise


async def suspend(future: "Future[T]", timeout: float, what: str) -> T:
    """Return the result of a future; let other tasks run until it is there.

    Parameters
    ----------
    future : Future
        Future, which is canceled if its result does not come in time.
    timeout : float
        Longest wait [s].
    what : str
        Name of what is waited for, for the error message.

    Returns
    -------
    T
        Result of the future.

    Raises
    ------
    ClientTimeoutError
        If the result does not come in time.
    """
    try:
        async with asyncio.timeout(timeout):
            return await asyncio.wrap_future(future)
    except TimeoutError:
        raise ClientTimeoutError(f"{what}: no answer in {timeout:g} s") from None


def finish(coroutine: Coroutine[Any, Any, R]) -> R:
    """Run a coroutine that waits by blocking, in this thread.

    Parameters
    ----------
    coroutine : Coroutine
        Coroutine that is never suspended.

    Returns
    -------
    R
        Result of the coroutine.

    Raises
    ------
    RuntimeError
        If it was suspended, which is a mistake in this package.
    """
    try:
        coroutine.send(None)
    except StopIteration as end:
        result: R = end.value
        return result
    coroutine.close()
    raise RuntimeError(f"{coroutine!r} was suspended, but nothing would resume it")


def blocking(function: Callable[P, Coroutine[Any, Any, R]]) -> Callable[P, R]:
    """Return the synchronous counterpart of a coroutine function or method.

    Parameters
    ----------
    function : Callable
        Coroutine function that waits by blocking, on the objects that it is called with.

    Returns
    -------
    Callable
        Function with the same parameters, result and docstring.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return finish(function(*args, **kwargs))

    return call


class Closing:
    """Base of objects that are closed at the end of a ``with``."""

    def close(self: Any) -> None:
        """Close it."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncClosing:
    """Base of objects that are closed at the end of an ``async with``."""

    async def close(self) -> None:
        """Close it."""
        raise NotImplementedError

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()
