"""Recording of what one display plays, as the server sees it: the ring and the recorder's process.

Nothing waits for the recorder but the end of the server, for `LEAVING`. If it ends or does not
follow, playback goes on, and what is missing is counted.
"""

import asyncio
import logging
import tempfile
from pathlib import Path
from typing import Any

from tactile.display.display import Display
from tactile.errors import BusError, InputError
from tactile.files import SourceFile
from tactile.playback.commands import DeviceOpened, News, Order
from tactile.playback.session_messages import (
    NumberedOrder,
    RecorderAnswer,
    SessionHeader,
    SessionMessage,
    SessionSetup,
)
from tactile.playback.session_orders import KINDS, TextureDescription
from tactile.playback.session_ring import SessionRing
from tactile.server.children import Child
from tactile.server.config import DisplayConfig, RecordConfig
from tactile.server.tasks import start_task

log = logging.getLogger("tactile.session")

ENDING = 60.0
"""Time that the recorder of a session that has ended may take to write the last part [s], on a slow
disk at low priority, while everything else goes on."""
LEAVING = 3.0
"""Time that the server waits for recorders when it ends [s], within ``TimeoutStopSec=5`` of its
systemd unit. One that is not ready then writes what it has by itself, unless systemd kills it."""
_KINDS = tuple(KINDS.values())


def prepare_folder(folder: str | None) -> None:
    """Create the folder of all sessions if there is none, and check that it takes files.

    Parameters
    ----------
    folder : str or None
        Folder of all sessions; None if nothing is recorded.

    Raises
    ------
    InputError
        If no file can be created in it.
    """
    if folder is None:
        return
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(
            f"record.folder = {folder!r}: no file can be created in it: {error.strerror}; name a "
            "folder that the server may write to"
        ) from error


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

    Attributes
    ----------
    endings : set of asyncio.Task
        Recorders of sessions that have ended, which write the last part.
    """

    def __init__(
        self, config: DisplayConfig, display: Display, source: SourceFile, record: RecordConfig
    ) -> None:
        self._config, self._display, self._source = config, display, source
        self._folder = record.folder
        self._loop = asyncio.get_running_loop()
        self._ring: SessionRing | None = None
        self._child: Child | None = None
        self.endings: set[asyncio.Task[None]] = set()
        self._written = self._lost = 0

    def renew(self) -> SessionRing | None:
        """Let the present session end, which nothing waits for, and prepare the next.

        Returns
        -------
        SessionRing or None
            Ring that playback writes to; None if nothing is recorded.
        """
        self.leave()
        try:
            self._ring = SessionRing.create() if self._folder else None
        except OSError as error:  # no memory or descriptor left
            log.error("%s: nothing is recorded: %s", self._config.name, error)
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
        except (OSError, RuntimeError, BusError) as error:  # no descriptor, thread or memory left
            log.error("%s: nothing is recorded: %s", config.name, error)

    def _receive(self, what: RecorderAnswer | None) -> None:
        """Take a message of the recorder, or None if it has ended."""
        name = self._config.name
        if what is not None and not what.failure:
            log.info("%s: recording to %s", name, what.folder)
            return
        reason = what.failure if what is not None else "the recorder has ended"
        log.error("%s: nothing is recorded any more: %s", name, reason)
        self._end_child()

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
        except BusError:  # it does not follow
            self._lost += 1

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
            "recording": float(self._child is not None),
            "session_records_total": float(self._written + (ring.written if ring else 0)),
            "lost_session_records_total": float(self._lost + (ring.lost if ring else 0)),
        }

    def leave(self) -> None:
        """Leave the present session to its end in the background, after that of playback."""
        ring, self._ring = self._ring, None
        if ring is not None:
            self._written += ring.written
            self._lost += ring.lost
        self._end_child(ring)

    def _end_child(self, ring: SessionRing | None = None) -> None:
        """End the recorder in the background, and then release the ring that it reads."""
        child, self._child = self._child, None

        async def end() -> None:
            if child is not None:
                await child.end(ENDING)
            if ring is not None:
                ring.close()

        if child is not None or ring is not None:
            start_task(end(), among=self.endings)
