"""The bridge: a client of the server that offers a display to LSL, until it is stopped."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from tactile.client import Event, RemoteDisplay, Telemetry
from tactile.client.wire import CommandedSamples
from tactile.clock import MONOTONIC
from tactile.errors import ClientTimeoutError, DisconnectedError, InputError
from tactile.lsl.continuity import Continuity
from tactile.lsl.inlet import MarkerInlet
from tactile.lsl.library import load_pylsl
from tactile.lsl.outlets import Outlet, describe_markers
from tactile.lsl.sampled_streams import SampledStreams, SampleForm
from tactile.lsl.settings import BridgeSettings
from tactile.lsl.stimuli import StimulusStarter
from tactile.lsl.timing import measure_clock

TELEMETRY_RATE = 50.0
"""Rate at which samples are fetched, by whose period the streams lag [Hz]."""
PAUSE = 0.2
"""Time between attempts to begin while the server is not there [s]."""
EVENTS = {"armed", "disarmed", "estopped", "cleared", "lost", "connected", "disconnected"}
"""Kinds of events that become markers; the contacts tell of the finger."""


@dataclass(frozen=True)
class StreamSummary:
    """Stream that was offered, as a bridge reports it.

    Attributes
    ----------
    name, kind : str
        Name and content type of the stream.
    channels : int
        Number of channels.
    rate : float
        Nominal rate; 0 for markers [Hz].
    samples : int
        Number of samples that were added.
    """

    name: str
    kind: str
    channels: int
    rate: float
    samples: int


@dataclass(frozen=True)
class BridgeSummary:
    """What a bridge has done so far.

    Attributes
    ----------
    display : str
        Name of the display.
    streams : tuple of StreamSummary
        Streams that are offered.
    missing : int
        Number of samples that did not reach the bridge.
    uncertainty : float or None
        Half of the largest interval around a time stamp that holds the true time; None if it is
        not known [s].
    begun, dropped, ignored : int
        Number of effects that markers started, of those that did not begin, and of markers that
        name no effect.
    """

    display: str
    streams: tuple[StreamSummary, ...]
    missing: int
    uncertainty: float | None
    begun: int
    dropped: int
    ignored: int

    def as_dict(self) -> dict[str, Any]:
        """Return the summary in types that JSON has, with units in the names.

        Returns
        -------
        dict
            Values by name.
        """
        facts = asdict(self)
        uncertainty = facts.pop("uncertainty")
        facts["uncertainty_us"] = None if uncertainty is None else 1e6 * uncertainty
        for stream in facts["streams"]:
            stream["rate_hz"] = stream.pop("rate")
        return facts


class Bridge:
    """Bridge from a display to LSL.

    Parameters
    ----------
    display : RemoteDisplay
        Display, whose connection is to reconnect by itself.
    settings : BridgeSettings
        What is offered, and which markers start effects.
    tell : Callable
        Function that takes each line for the user, from any thread.

    Raises
    ------
    InputError
        If pylsl cannot be loaded, or markers are to come from the bridge's own stream.
    NotFoundError
        If a marker is to start an effect that the server does not have.
    """

    def __init__(
        self, display: RemoteDisplay, settings: BridgeSettings, tell: Callable[[str], None]
    ) -> None:
        self._display, self._settings, self._tell = display, settings, tell
        self._clock = measure_clock(load_pylsl().local_clock)
        self._continuity = Continuity()
        self._uncertainty: float | None = 0.0
        self._sampled: SampledStreams | None = None
        self._markers: Outlet | None = None
        self._inlet: MarkerInlet | None = None
        self._starter: StimulusStarter | None = None
        own = describe_markers(display.name)
        if settings.start_from is not None:
            if settings.start_from == own.name:
                raise InputError(f"stream {own.name!r}: its markers are those of this bridge")
            self._starter = StimulusStarter(display, self._clock, settings.starts, settings.delay)
            self._inlet = MarkerInlet(settings.start_from, tell)
        if "markers" in settings.streams:
            self._markers = Outlet(own)
            self._tell(describe_outlet(self._markers))

    def run(self, stop: threading.Event) -> None:
        """Offer the display until an event is set, or its connection is closed; call this once.

        Parameters
        ----------
        stop : threading.Event
            Event that ends the bridge.

        Raises
        ------
        RequestError
            If the server does not let this program watch the display.
        """
        self._display.on_event(self._take_event)
        try:
            with (
                self._starting(stop),
                self._display.telemetry(TELEMETRY_RATE, samples=True) as stream,
            ):
                while not stop.is_set():
                    try:
                        self._take(next(stream))
                    except StopIteration:
                        return
                    except ClientTimeoutError:
                        self._report_stimuli()
                    except DisconnectedError:  # the SDK connects again
                        MONOTONIC.sleep(PAUSE)  # no lock that a handler of signals may need
        finally:
            if self._starter is not None:
                self._starter.finish()
            self._report_stimuli()
            self.close()

    def close(self) -> None:
        """Withdraw all streams; `run` does so at its end."""
        if self._sampled is not None:
            self._sampled.close()
        if self._markers is not None:
            self._markers.close()

    @property
    def summary(self) -> BridgeSummary:
        """What the bridge has done so far; any thread may ask."""
        sampled, starter, inlet = self._sampled, self._starter, self._inlet
        outlets = [] if sampled is None else list(sampled.outlets.values())
        outlets += [] if self._markers is None else [self._markers]
        ignored = 0 if starter is None else starter.ignored
        return BridgeSummary(
            display=self._display.name,
            streams=tuple(
                StreamSummary(
                    one.description.name, one.description.kind, len(one.description.channels),
                    one.description.rate, one.samples,
                )
                for one in outlets
            ),
            missing=self._continuity.missing,
            uncertainty=self._uncertainty,
            begun=0 if starter is None else starter.begun,
            dropped=0 if starter is None else starter.dropped,
            ignored=ignored + (0 if inlet is None else inlet.unreadable),
        )  # fmt: skip

    @contextmanager
    def _starting(self, stop: threading.Event) -> Iterator[None]:
        """Let a thread start effects meanwhile, if markers are to start any."""
        inlet, starter = self._inlet, self._starter
        if inlet is None or starter is None:
            yield
            return
        ended = threading.Event()

        def read() -> None:
            for marker in inlet.read(ended):
                starter.start(marker)

        thread = threading.Thread(target=read, name="tactile-lsl-inlet", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _take(self, telemetry: Telemetry) -> None:
        """Add what has come to the streams."""
        samples = telemetry.samples
        if samples is not None and samples.block_samples > 0 and samples.sample_rate > 0:
            has_samples = telemetry.shear is not None  # also while nothing plays
            form = SampleForm(samples.sample_rate, samples.block_samples, has_samples)
            sampled = self._offer(form)
            if samples.times:
                self._count(samples)
                sampled.push(samples)
        self._report_stimuli()

    def _offer(self, form: SampleForm) -> SampledStreams:
        """Return the streams for samples of a form, which are offered if they are not yet."""
        sampled, settings = self._sampled, self._settings
        if sampled is not None:
            if sampled.form == form:
                return sampled
            sampled.close()
        sampled = self._sampled = SampledStreams(
            self._display.info, form, settings.streams, settings.decimate, self._clock
        )
        for outlet in sampled.outlets.values():
            self._tell(describe_outlet(outlet))
        if not form.has_samples and {"shear", "drive"} & set(settings.streams):
            self._tell("no shear and drive: the link takes spectrum frames, which have no samples")
        return sampled

    def _count(self, samples: CommandedSamples) -> None:
        """Mark what interrupts samples, and note their uncertainty."""
        for interruption in self._continuity.take(samples):
            self._mark(interruption.text, interruption.time)
        if samples.uncertainty is None or self._uncertainty is None:
            self._uncertainty = None
        else:
            self._uncertainty = max(self._uncertainty, samples.uncertainty)

    def _report_stimuli(self) -> None:
        """Mark the stimuli of which it has become known what became of them."""
        if self._starter is not None:
            for report in self._starter.take_reports():
                if self._markers is not None:
                    self._markers.push_marker(report.text, report.time)

    def _take_event(self, event: Event) -> None:
        """Mark what other programs play at its onset, and other events when they are received."""
        onset = event.onset
        if onset is not None:
            time = onset.at if onset.time is None else onset.time
            if onset.marker and onset.time is not None:
                self._mark(str(onset.marker), time)
            if onset.reason:
                self._mark(f"stimulus: {onset.reason}", time)
            return
        if event.kind == "connected":  # maybe to another server, with numbers of its own
            self._continuity.restart()
        if event.kind in EVENTS:
            self._mark(event.kind, MONOTONIC.now())

    def _mark(self, text: str, time: float) -> None:
        """Add a marker at a time of the monotonic clock [s]."""
        if self._markers is not None:
            self._markers.push_marker(text, self._clock.to_lsl(time))


def describe_outlet(outlet: Outlet) -> str:
    """Return a stream as a line for the user.

    Parameters
    ----------
    outlet : Outlet
        Stream.

    Returns
    -------
    str
        Name, type, channels and rate of the stream.
    """
    one = outlet.description
    count = len(one.channels)
    rate = f"{one.rate:g} Hz" if one.rate else "no rate"
    return f"{one.name}: {one.kind}, {count} channel{'s' if count != 1 else ''}, {rate}"
