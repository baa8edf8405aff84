"""The SDK: connect a program, such as a VR application, to the server that drives the displays.

`connect` returns a `RemoteDisplay`; `open_connection` returns a `Connection` to all displays of a
server, for example for two hands. `tactile.client.aio` has the same for asyncio. Values are in SI:
m, m/s, N, s, Hz. Times are those of `time.monotonic` (on Linux, OpenXR's XrTime in seconds).

Calls wait for the server, except `RemoteDisplay.touch` and `RemoteDisplay.lift`.

>>> import tactile
>>> with tactile.connect() as display:  # doctest: +SKIP
...     display.select("wood-oak")
...     display.arm()
...     display.touch((0.012, 0.003), velocity=(0.08, 0.0), normal_force=0.5)
"""

from tactile.client import aio as aio
from tactile.client.base import BaseConnection as BaseConnection
from tactile.client.connection import Connection as Connection
from tactile.client.connection import connect as connect
from tactile.client.connection import open_connection as open_connection
from tactile.client.display import BaseDisplay as BaseDisplay
from tactile.client.display import RemoteDisplay as RemoteDisplay
from tactile.client.frames import FrameWriter as FrameWriter
from tactile.client.onsets import At as At
from tactile.client.telemetry import TelemetryStream as TelemetryStream
from tactile.client.transport import Transport as Transport
from tactile.client.wire import Appended as Appended
from tactile.client.wire import CommandedSamples as CommandedSamples
from tactile.client.wire import DisplayInfo as DisplayInfo
from tactile.client.wire import Event as Event
from tactile.client.wire import Onset as Onset
from tactile.client.wire import Stats as Stats
from tactile.client.wire import Telemetry as Telemetry
from tactile.messages import Layer as Layer
from tactile.messages import TextureInfo as TextureInfo
