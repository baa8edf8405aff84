"""``mock:``, an amplifier in memory that decodes the packets that a real one receives.

What is written is sent as packets of the protocol over a serial line in memory to the amplifier of
`firmware_protocol`, whose sample clock advances only by the samples that are written and the ramps
that end them. Gaps are therefore bridged or fade, the limits are those of the amplifier, and the
output is restricted to what the wire can carry. The last second of the output is kept, or
everything with ``?keep=all``, together with the codes on the marker lines. ``?format=pcm16`` (the
default), ``pcm12`` or ``bfp8`` selects the coding of the samples.
"""

import math
import threading
from dataclasses import replace

import numpy as np
from msgspec.structs import fields
from msgspec.structs import replace as replace_options
from numpy.typing import NDArray

from firmware_protocol.config import AmplifierConfig
from firmware_protocol.messages import FADE_MS, HEARTBEAT_MS, MARKER_LINES_MOST, SampleFormat
from tactile.arrays import Floats
from tactile.bus.base import RATE, Bus, DisplayLike, DriveBlock, Wiring
from tactile.bus.board import CHUNK, MOST_CHANNELS, Board, config_of
from tactile.bus.guards import GuardSettings
from tactile.bus.output import OutputRecord
from tactile.bus.registry import Address, register_bus
from tactile.bus.simulated.current_sensor import CurrentModel, CurrentSensor, SensorDesign
from tactile.bus.simulated.modeled_bus import MockOptions, model_of, open_modeled, wire_of
from tactile.bus.wire import Wire
from tactile.clock import MONOTONIC, Clock, ModelClock
from tactile.errors import InputError


class MockBus(Bus):
    """Amplifiers in memory.

    Parameters
    ----------
    wiring : Wiring
        What the amplifiers drive.
    keep : str
        Part of the output that is kept: "second" for the last second, or "all".
    sample_format : SampleFormat
        Format of the samples on the line.
    clock : Clock
        Clock of the host, by which `due` counts from the start.
    currents : CurrentModel or None
        Load of all channels, whose currents the amplifier measures; None for one that does not. It
        is called with all that is put out, in every state.
    sensor : SensorDesign
        How the amplifier measures them.
    correlation_ms : int
        Length of the windows of correlated currents [ms]; 0 for none.

    Attributes
    ----------
    boards : list of Board
        Amplifiers, as many as the channels need.

    Raises
    ------
    InputError
        If the protocol cannot carry the sample rate, 0 V cannot be reached in time within the slew
        limit, or currents are to be measured by more than one amplifier.
    """

    on_host_death = "ramps"
    paced = False

    def __init__(
        self,
        wiring: Wiring,
        *,
        keep: str = "second",
        sample_format: SampleFormat = SampleFormat.PCM16,
        clock: Clock = MONOTONIC,
        currents: CurrentModel | None = None,
        sensor: SensorDesign = SensorDesign(),  # noqa: B008
        correlation_ms: int = 0,
    ) -> None:
        super().__init__(wiring, clock)
        self._kept = math.inf if keep == "all" else wiring.sample_rate
        """Number of samples of the output that are kept at least."""
        self._record = OutputRecord(wiring.channels, self._kept)
        self._position = 0
        self._guard = threading.RLock()
        """Lock held while the amplifiers advance; an e-stop may come from any thread."""
        widths = [
            min(MOST_CHANNELS, wiring.channels - first)
            for first in range(0, wiring.channels, MOST_CHANNELS)
        ]
        if currents is not None and len(widths) > 1:
            raise InputError(f"{wiring.channels} channels: currents of {MOST_CHANNELS} at most")
        self.boards = [
            self._board(
                config_of(wiring, width, node, marker_lines=MARKER_LINES_MOST),
                sample_format,
                currents,
                sensor,
            )
            for node, width in enumerate(widths, 1)
        ]
        self._correlates = currents is not None and correlation_ms > 0
        if self._correlates:
            self.boards[0].ask_for_windows(correlation_ms)

    def _board(
        self,
        config: AmplifierConfig,
        sample_format: SampleFormat,
        currents: CurrentModel | None,
        design: SensorDesign,
    ) -> Board:
        """Return an amplifier, with a sensor if there is a load to measure."""
        if currents is None:
            return Board(config, sample_format, windows=self._windows)
        full_scale = config.full_scale_uv * 1e-6
        sensor = CurrentSensor(currents, design, channels=config.channels, full_scale=full_scale)
        measuring = replace(config, sense_ranges_ua=design.ranges_ua, current_delay=design.delay)
        return Board(measuring, sample_format, sensor, self._windows)

    @property
    def correlates(self) -> bool:
        """Whether the amplifier measures currents, and was asked for their correlations."""
        return self._correlates

    @property
    def guards(self) -> bool:
        """Whether the amplifier has guards, and was asked for the correlations that they need."""
        return self._correlates and self.boards[0].guards

    def _set_guards(self, settings: GuardSettings) -> None:
        with self._guard:
            if self.state == "running":  # no e-stop has come since the caller saw it running
                self.boards[0].set_guards(settings)

    @property
    def marker_lines(self) -> int:
        """Number of marker lines of the first amplifier."""
        return self.boards[0].amplifier.config.marker_lines

    def _mark(self, position: int, code: int) -> None:
        with self._guard:
            self.boards[0].mark(position, code)

    def due_uncertainty(self, position: int) -> float:
        """Return half of an interval around `due` that holds the true time.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Half of the interval; none, as both are one [s].
        """
        return 0.0

    @property
    def output(self) -> Floats:
        """Drive voltages that were put out, as far as they are kept, array (S, C) [V]."""
        return self._record.volts

    @property
    def lines(self) -> NDArray[np.uint8]:
        """Codes on the marker lines of the first amplifier with each of `output`, array (S,)."""
        return self._record.lines

    def _start(self, position: int) -> None:
        with self._guard:
            self._position = position
            for board in self.boards:
                board.start(position, round(self.wiring.sample_rate))

    def _write(self, block: DriveBlock) -> None:
        with self._guard:
            if self.state == "running":
                self._take(block)
            else:  # an e-stop has come since the caller saw the bus running
                self.counters.dropped_samples += len(block.volts)

    def _take(self, block: DriveBlock) -> None:
        """Play a block after the gap before it."""
        gap = block.position - self._position
        if gap > self.wiring.sample_rate * FADE_MS / 1000:
            self._play(gap)
            gap = 0
        for k in range(0, len(block.volts), CHUNK):
            part = block.volts[k : k + CHUNK]
            self._send(self._position + gap, part)
            self._play(gap + len(part))
            gap = 0

    def _send(self, position: int, volts: Floats) -> None:
        """Send samples to the amplifiers, each of which has a part of the channels."""
        for k, board in enumerate(self.boards):
            board.send(position, volts[:, k * MOST_CHANNELS : (k + 1) * MOST_CHANNELS])

    def _play(self, count: int) -> None:
        """Advance the amplifiers, by at most the interval of the heartbeats at once."""
        longest = max(1, int(self.wiring.sample_rate) * HEARTBEAT_MS // 1000)
        for k in range(0, count, longest):
            parts = [board.play(min(longest, count - k)) for board in self.boards]
            self._position += len(parts[0])
            volts = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
            self._put(volts, self.boards[0].lines)
        self.counters.underruns = sum(b.amplifier.counters.underruns for b in self.boards)

    def _stop(self) -> None:
        self._end(quick=False)

    def _abort(self) -> None:
        self._end(quick=True)

    def _end(self, *, quick: bool) -> None:
        with self._guard:
            self._put_all([board.end(quick=quick) for board in self.boards])

    def _put_all(self, ends: list[Floats]) -> None:
        """Put out the ends of all amplifiers, the shorter ones extended by 0 V and their lines."""
        longest, lines = max(len(end) for end in ends), self.boards[0].lines
        self._put(
            np.hstack([np.pad(end, ((0, longest - len(end)), (0, 0))) for end in ends]),
            np.pad(lines, (0, longest - len(lines)), mode="edge"),
        )

    def _close(self) -> None:
        with self._guard:
            for board in self.boards:
                board.disarm()

    def _estop(self) -> None:
        with self._guard:
            self._put_all([board.estop() for board in self.boards])

    def _clear(self) -> None:
        with self._guard:
            for board in self.boards:
                board.clear()

    def _put(self, volts: Floats, lines: NDArray[np.uint8]) -> None:
        """Put voltages out; a subclass with something behind the amplifiers continues from here."""
        self._record.add(volts, lines)


WITHOUT_LINK = ("keep", "format", "rearm", "load_pf", "correlation_ms")
"""Options that need no link."""


def open_mock(
    address: Address[MockOptions],
    display: DisplayLike,
    sample_rate: float | None,
    clock: Clock = MONOTONIC,
) -> Bus:
    """Open amplifiers in memory, or a modeled link.

    Parameters
    ----------
    address : Address
        Address with `MockOptions`.
    display : DisplayLike
        Display that the amplifiers drive.
    sample_rate : float or None
        Sample rate of the drive [Hz]; None for the bus's choice.
    clock : Clock
        Clock of the host, for amplifiers in memory.

    Returns
    -------
    Bus
        The open bus.

    Raises
    ------
    InputError
        If an option requires a link, and none is requested.
    """
    options = address.options
    if options.link is not None:
        return open_modeled(options, display, sample_rate)
    for option in fields(options):
        changed = getattr(options, option.name) != option.default
        if changed and option.name not in WITHOUT_LINK:
            raise InputError(f"mock: {option.name}: needs link=serial, can, canfd or i2c")
    if options.format == "spectrum":
        raise InputError("mock: format = 'spectrum': needs link=serial, can, canfd or i2c")
    wiring = Wiring.of(display, sample_rate or RATE)
    kind = options.sample_format or SampleFormat.PCM16
    return MockBus(
        wiring,
        keep=options.keep,
        sample_format=kind,
        clock=clock,
        currents=options.load(wiring.channels),
        correlation_ms=options.correlation_ms or 0,
    )


BARE = Wiring(channels=24, sample_rate=RATE, voltage=100.0, slew=0.7e6, fade=20e-3)
"""What an amplifier drives whose wire is opened without a display: the values that
`AmplifierConfig` has by default."""


def _wire(address: Address[MockOptions]) -> tuple[Wire, Clock]:
    options = replace_options(address.options, link=address.options.link or "serial")
    model = model_of(options, BARE, ModelClock())
    return wire_of(model, options.medium), model.clock


register_bus("mock", open_mock, MockOptions, wire=_wire)
