"""The sound card: a client of the server whose display plays what comes from JACK."""

import gc
import threading
from collections.abc import Callable
from math import inf
from typing import Any

from tactile.client import Event, RemoteDisplay
from tactile.client.wire import Stats
from tactile.clock import MONOTONIC, Clock
from tactile.errors import ClientTimeoutError, DisconnectedError, InputError, RequestError
from tactile.jack.card_messages import (
    CardFailed,
    CardLost,
    CardOpened,
    CardOrder,
    CardSources,
    CardWaits,
    JackCycle,
    PortSources,
)
from tactile.jack.card_summary import SoundCardSummary
from tactile.jack.counter_growth import CounterGrowth
from tactile.jack.delay import Delay
from tactile.jack.feed import CardFeed
from tactile.jack.library import load_jack
from tactile.jack.meters import Meters
from tactile.jack.process import JackProcess
from tactile.jack.refusals import Refusals
from tactile.jack.settings import SoundCardSettings

PAUSE = 0.2
"""Time between looks at the process and the display [s]."""
STANDSTILL = 1.0
"""Time without cycles after which JACK stands still [s]. Assumed: longer than a busy machine makes
JACK late."""
FASTEST = 192e3
"""Highest rate of frames that the API has [Hz]."""
STANDS_STILL = "JACK stands still, or plays into a file"
"""Line about a JACK server that is there, but has no cycles."""
NO_WAVES = "the link takes spectrum frames, which carry textures and no waves"
UNTOUCHED = (
    "no finger touches the display: unless it is worn, waves are 34 dB weaker until one does"
)
"""Line about the mixing rule of the server for waves."""
LINES = {
    "armed": "armed",
    "disarmed": "disarmed; it plays again when it is armed",
    "estopped": "stopped by an e-stop; it plays again when that is cleared and it is armed",
    "lost": "its amplifier is lost; it plays again when it is armed",
    "disconnected": "the server is gone, and is waited for",
    "connected": "the server is back; it plays again when it is armed",
}
"""Line about the display for each kind of event."""
SILENCING = ("disarmed", "estopped", "lost", "disconnected")
"""Kinds of events after which the display does not play."""


class SoundCard:
    """Sound card of JACK that plays on a display.

    Parameters
    ----------
    display : RemoteDisplay
        Display, whose connection is to reconnect by itself, and not to arm again.
    settings : SoundCardSettings
        What is played, and how much later.
    tell : Callable
        Function that takes each line for the user, from any thread.
    clock : Clock
        Monotonic clock.

    Attributes
    ----------
    state : str
        State of the display, as in `Stats`, or "disconnected"; empty while it is not known.

    Raises
    ------
    InputError
        If the library of JACK cannot be loaded, or the display plays no waves.
    """

    def __init__(
        self,
        display: RemoteDisplay,
        settings: SoundCardSettings,
        tell: Callable[[str], None],
        clock: Clock = MONOTONIC,
    ) -> None:
        load_jack()
        info = display.info
        if not info.waveforms:
            raise InputError(f"display {display.name!r}: {NO_WAVES}")
        self._display, self._settings, self._tell = display, settings, tell
        self._clock = clock
        channels = len(info.contactors)
        self._delay = Delay(info.latency, settings.headroom)
        self._feed = CardFeed(display, channels, settings.full_scale, self._delay, clock)
        self._sources: PortSources = (frozenset(),) * channels
        self._growths = {name: CounterGrowth(name) for name in ("dropped_frames", "frame_gaps")}
        self._unsent = CounterGrowth("dropped_frames")
        self._process: JackProcess | None = None
        self._opened: CardOpened | None = None
        self._failure: InputError | None = None
        self._has_spoken = self._waits = self._has_ended = False
        self._refusals = Refusals()
        self._was_open = False
        """Whether the feed was open after the last look."""
        self._late = 0
        """Number of frames that were too late, as of the last look."""
        self._is_silent = False
        """Whether the last line about the display says that it does not play."""
        self._last_cycle, self._stands_still = clock.now(), False
        self.state = ""

    def run(self, stop: threading.Event) -> None:
        """Arm the display, and play what comes until an event is set; call this once.

        Parameters
        ----------
        stop : threading.Event
            Event that ends the sound card.

        Raises
        ------
        InputError
            If JACK or the display cannot do what is wanted, such as with so many ports.
        """
        gc.collect()
        gc.freeze()  # else each full collection holds up the cycles for as long as one lasts
        self._display.on_event(self._take_event)
        self._arm()
        stats = self._look()
        if stats is not None and not stats.touching:
            self._tell(UNTOUCHED)
        try:
            self._start()
            while not stop.is_set():
                if self._failure is not None:
                    raise self._failure
                if self._has_ended:
                    self._restart()
                self._clock.sleep(PAUSE)  # no lock that a handler of signals may need
                self._look()
                self._watch_cycles()
        finally:
            self._feed.open = False
            stats = self._stats()
            if stats is not None:
                self._count(stats)
            if self._process is not None:
                self._process.close()

    @property
    def meters(self) -> Meters:
        """Meters of all channels; any thread may read them."""
        return self._feed.meters

    @property
    def summary(self) -> SoundCardSummary:
        """What the sound card has done so far; any thread may ask."""
        feed, scale = self._feed, self._settings.full_scale
        return SoundCardSummary(
            display=self._display.name,
            client="" if self._opened is None else self._opened.client,
            rate=feed.rate,
            buffer=feed.buffer,
            full_scale=scale,
            delay=self._delay.seconds,
            frames=feed.frames,
            missing=feed.numbers.missing,
            dropped=self._growths["dropped_frames"].count
            + self._unsent.count
            + feed.late
            + feed.early,
            gaps=self._growths["frame_gaps"].count,
            xruns=feed.xruns,
            invalid=feed.meters.invalid,
            clipped=tuple(feed.meters.clipped.tolist()),
            peaks=tuple((scale * feed.meters.peaks).tolist()),
        )

    def _arm(self) -> None:
        """Arm the display once, such that its high voltage goes off with this program."""
        try:
            self._display.arm()
        except (RequestError, ClientTimeoutError, DisconnectedError) as error:
            self._is_silent = True
            self._tell(f"{self._display.name}: not armed: {error}; it plays when it is armed")

    def _start(self) -> None:
        """Start the process that is a client of JACK."""
        self._has_ended = self._has_spoken = False
        order = CardOrder(f"tactile {self._display.name}", self._sources)
        self._process = JackProcess(order, self._take)

    def _restart(self) -> None:
        """Start another process in place of one that has ended."""
        if self._process is not None:
            self._process.kill()
        if not self._has_spoken:
            raise InputError("the process of JACK has ended at once")
        if not self._waits:
            self._tell("the process of JACK has ended; it is started again")
        self._start()

    def _stats(self) -> Stats | None:
        """Return the state of the display; None if the server does not answer."""
        try:
            return self._display.stats()
        except (ClientTimeoutError, DisconnectedError, RequestError):
            return None

    def _look(self) -> Stats | None:
        """Take the state of the display, and return it; None if the server does not answer."""
        stats = self._stats()
        if stats is None:
            self._feed.open = self._feed.open and self._display.connected
            return None
        self._check_contactors()
        now = self._clock.now()
        self.state = stats.state
        self._feed.open = stats.state == "armed" and now >= self._refusals.until
        lost = self._count(stats)
        if self._delay.update(stats.latency, now):
            if self._feed.frames:
                self._tell_delay("the display needs more time")
        elif lost and self._delay.raise_headroom(now):
            self._tell_delay("frames come too late")
        return stats

    def _check_contactors(self) -> None:
        """See that the display has the contactors that it had; a server that is back may differ.

        Raises
        ------
        InputError
            If it has not as many.
        """
        now, before = len(self._display.info.contactors), len(self._sources)
        if now != before:
            raise InputError(
                f"display {self._display.name!r} has {now} contactors now, not {before}; start the "
                f"command again"
            )

    def _count(self, stats: Stats) -> int:
        """Return how many frames and gaps more than before were lost while the feed was open."""
        counts, self._was_open = self._was_open, self._feed.open
        lost = self._feed.late - self._late
        self._late += lost
        for growth in self._growths.values():
            lost += growth.take(stats.counters, counts=counts)
        return lost + self._unsent.take(self._display.connection.counters, counts=counts)

    def _tell_delay(self, reason: str) -> None:
        """Tell that the delay was raised."""
        self._tell(f"{reason}: delay raised to {1e3 * self._delay.seconds:.1f} ms")

    def _watch_cycles(self) -> None:
        """Let the meters fall if no cycles come, and tell of it if JACK is there."""
        feed = self._feed
        cycle = feed.buffer / feed.rate if feed.buffer and feed.rate else 0.0
        if self._clock.now() - self._last_cycle <= STANDSTILL + cycle:
            return
        feed.meters.rest()
        if self._opened is not None and not self._waits and not self._stands_still:
            self._stands_still = True
            self._tell(STANDS_STILL)

    def _take_event(self, event: Event) -> None:
        """Tell of an event, and stop to send what would not be played."""
        line = LINES.get(event.kind, "")
        if event.kind in ("armed", "connected"):
            self._refusals.forget()
        if event.kind == "armed":
            line = line if self._is_silent else ""  # as after the arming at the beginning
            self._is_silent = False
        if event.kind in SILENCING:
            self._feed.open, self._is_silent = False, True
            self.state = event.kind
        if event.kind == "refused":
            line = self._refusals.take(event.detail, self._clock.now())
            self._feed.open = self._feed.open and self._clock.now() >= self._refusals.until
            self._is_silent = self._is_silent or self._refusals.until == inf
        if line:
            self._tell(f"{self._display.name}: {line}")

    def _take(self, message: Any) -> None:
        """Take a message of the process; None means that it has ended."""
        match message:
            case JackCycle():
                self._play(message)
            case CardOpened():
                self._feed.restart()
                self._refusals.retry()
                self._last_cycle = self._clock.now()
                self._tell_opened(message)
            case CardSources():
                self._sources = message.sources
            case CardWaits():
                if not self._waits:
                    self._tell(message.reason)
                self._waits = True
            case CardLost():
                self._waits = True
                self._tell(f"{message.reason or 'JACK has ended'}; it is waited for")
            case CardFailed():
                self._failure = InputError(message.reason)
            case None:
                self._has_ended = True
                return
        self._has_spoken = True

    def _tell_opened(self, opened: CardOpened) -> None:
        """Tell that the ports are there, unless the client has been there before."""
        if self._waits or self._opened != opened:
            self._tell(
                f"JACK client {opened.client!r}: {len(self._sources)} ports, {opened.rate:g} Hz, "
                f"{opened.buffer} frames"
            )
        self._opened, self._waits = opened, False
        if opened.rate > FASTEST:
            self._failure = InputError(
                f"JACK runs at {opened.rate:g} Hz; a display takes at most {FASTEST:g} Hz"
            )

    def _play(self, cycle: JackCycle) -> None:
        """Play a cycle, unless the sound card ends because the display cannot."""
        self._last_cycle, self._stands_still = self._clock.now(), False
        if self._failure is None:
            try:
                self._feed.take(cycle)
            except InputError as error:
                self._failure = error
