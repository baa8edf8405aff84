"""Recording of what one display plays, as the server sees it: the ring and the recorder's process.

Nothing waits for the recorder. If it ends or does not follow, playback goes on, and what is missing
is counted.
"""

import asyncio
import logging
from contextlib import suppress
from typing import Any

from tactile.display.display import Display
from tactile.errors import BusError
from tactile.files import SourceFile
from tactile.playback.commands import DeviceOpened, News, Order
from tactile.playback.session_messages import (
    NumberedOrder,
    RecordingBegun,
    SessionHeader,
    SessionMessage,
    SessionSetup,
)
from tactile.playback.session_orders import KINDS, TextureDescription
from tactile.playback.session_ring import SessionRing
from tactile.server.children import Child
from tactile.server.config import DisplayConfig, RecordConfig

log = logging.getLogger("tactile.session")

ENDING = 5.0
"""Time that the recorder may take to write the last part [s]."""
_KINDS = tuple(KINDS.values())


class SessionRecording:
    """Recording of one display: a new session whenever its playback process is started.

    Parameters
    ----------
    config : DisplayConfig
        Configuration of the display.
    display : Display
        The display, with the limits of the configuration.
    source : SourceFile
        Texts of its files.
    record : RecordConfig
        Where sessions are recorded.
    """

    def __init__(
        self, config: DisplayConfig, display: Display, source: SourceFile, record: RecordConfig
    ) -> None:
        self._config, self._display, self._source = config, display, source
        self._folder = record.folder
        self._loop = asyncio.get_running_loop()
        self._ring: SessionRing | None = None
        self._child: Child | None = None
        self._written = self._lost = self._lost_messages = 0

    async def renew(self) -> SessionRing | None:
        """End the present session and prepare the next.

        Returns
        -------
        SessionRing or None
            Ring that playback writes to; None if nothing is recorded.
        """
        await self.end()
        self.close()
        self._ring = SessionRing.create() if self._folder else None
        return self._ring

    def begin(self, how: DeviceOpened) -> None:
        """Start the recorder, once the device is open.

        Parameters
        ----------
        how : DeviceOpened
            How the device plays.
        """
        if self._ring is None or self._folder is None:
            return
        config, descriptor = self._config, self._ring.descriptor
        header = SessionHeader(
            name=config.name,
            device=config.device,
            display=self._source,
            voltage_limit_v=self._display.limits.voltage,
            how=how,
            gain=config.gain,
            worn=config.worn,
        )

        def on_answer(what: Any) -> None:
            if self._child is child:
                self._receive(what)

        try:
            inherited = () if descriptor is None else (descriptor,)
            child = self._child = Child("tactile.playback.session_recorder", on_answer, inherited)
            child.send(SessionSetup(self._folder, self._ring.handle, header))
        except (OSError, BusError) as error:  # no descriptor or memory left
            log.error("%s: nothing is recorded: %s", config.name, error)

    def _receive(self, what: RecordingBegun | None) -> None:
        """Take a message of the recorder, or None if it has ended."""
        name = self._config.name
        if what is None:
            log.error("%s: nothing is recorded any more: the recorder has ended", name)
            self._child = None
        elif what.failure:
            log.error("%s: nothing is recorded any more: %s", name, what.failure)
        else:
            log.info("%s: recording to %s", name, what.folder)

    def add_order(self, number: int, order: Order | TextureDescription) -> None:
        """Add an order to playback; one that does not change what is rendered is ignored.

        Parameters
        ----------
        number : int
            Number of the order.
        order : Order or TextureDescription
            The order.
        """
        if isinstance(order, _KINDS):
            self._send(NumberedOrder(number, order))

    def add_news(self, news: News) -> None:
        """Add news of the display: e-stops, arming, the link and faults.

        Parameters
        ----------
        news : News
            What happened.
        """
        self._send(SessionMessage(self._loop.time(), news))

    def _send(self, message: NumberedOrder | SessionMessage) -> None:
        """Send a message to the recorder, if there is one that follows."""
        if self._child is None:
            return
        try:
            self._child.send(message)
        except BusError:
            self._lost_messages += 1

    def figures(self) -> dict[str, float]:
        """Return counters for metrics.

        Returns
        -------
        dict of str to float
            Whether a session is recorded, and numbers of records; empty if none is to be.
        """
        if self._folder is None:
            return {}
        ring = self._ring
        return {
            "recording": float(self._child is not None and self._child.alive),
            "session_records_total": self._written + float(ring.written if ring else 0),
            "lost_session_records_total": self._lost
            + self._lost_messages
            + float(ring.lost if ring else 0),
        }

    async def end(self) -> None:
        """Let the recorder write what it has, and end it."""
        child, self._child = self._child, None
        if child is not None:
            await child.end(ENDING)

    def close(self) -> None:
        """Release the ring."""
        ring, self._ring = self._ring, None
        if ring is not None:
            self._written += ring.written
            self._lost += ring.lost
            with suppress(ValueError):
                ring.close()
