"""``mock:?link=…``, a link in memory that takes time and fails as its URL requests.

``mock:?link=serial&bit_rate=3000000&loss=0.001``; other links are ``can``, ``canfd`` and ``i2c``.
Everything except the device is what real links use. The output of the amplifiers is kept as in
`mock_bus`, without the instants before a start and those in which the last sample was held before
the ramp.
"""

import math
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from firmware_protocol.config import AmplifierConfig
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FULL_SCALE_CODE, MARKER_LINES_MOST, State
from firmware_protocol.player import distance
from tactile.arrays import Floats
from tactile.bus.base import RATE, DisplayLike, Wiring
from tactile.bus.board import config_of
from tactile.bus.can_bus import DATA, NOMINAL, CanWire
from tactile.bus.i2c_bus import ADDRESS, CLOCK, I2cWire
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LinkOptions, planner
from tactile.bus.link.session import MOVING
from tactile.bus.options import Keep
from tactile.bus.output import OutputRecord
from tactile.bus.serial_bus import SerialWire
from tactile.bus.simulated.current_sensor import (
    CapacitiveLoad,
    CurrentModel,
    CurrentSensor,
    SensorDesign,
)
from tactile.bus.simulated.line_model import (
    CanModel,
    Faults,
    I2cModel,
    Model,
    ModelSetup,
    SerialModel,
)
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Can, I2c, Link, Uart, Unlimited
from tactile.clock import Clock, ModelClock
from tactile.errors import InputError

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
"""Type of an option that is a probability."""
Interval = Annotated[float, Meta(ge=0.01, le=1e9)]
"""Type of an option that is an interval [s]."""


class MockOptions(LinkOptions, frozen=True, kw_only=True):
    """Options of a URL ``mock:?option=value&…``.

    Without ``link`` only ``keep``, ``format``, ``rearm``, ``load_pf`` and ``correlation_ms`` may be
    given. With it packets go over a modeled link that takes time and fails as the other options
    request.

    Attributes
    ----------
    keep : str
        Part of the output that is kept: the last second, or all.
    link : str or None
        Kind of the modeled link; by default there is none, and samples arrive at once.
    bit_rate : float or None
        Bit rate of the link [bit/s]; by default 1 Mbit/s for CAN, 400 kbit/s for I2C, and unlimited
        for a serial line.
    data_bit_rate : float or None
        Bit rate of the data phase of CAN FD [bit/s]; by default 5 Mbit/s.
    loss : float
        Probability that a chunk, frame or transfer is lost.
    corrupt : float
        Probability that a chunk, frame or transfer is damaged.
    reorder : float
        Probability that a chunk, frame or transfer is overtaken by the next one.
    delay_ms : float
        Mean of the delay that a driver adds to each chunk or frame [ms].
    arbitration_us : float
        Longest time that a chunk or frame waits for other traffic [µs].
    fifo_ms : float
        Length of an amplifier's buffer at 16 kHz [ms].
    disconnect_s : float or None
        Mean time between losses of the link [s]; by default there are none.
    power_s : float or None
        Mean time between losses of power [s]; by default there are none.
    stall_s : float or None
        Mean time between stalls of an amplifier [s]; by default there are none.
    drift_ppm : float
        Drift of the first amplifier's clock [ppm]; the k-th drifts k times as much.
    boards : int
        Number of amplifiers.
    seed : int
        Seed of the faults.
    load_pf : float or None
        Capacitance of each channel, whose current the amplifiers measure [pF]; by default they do
        not measure.
    """

    keep: Keep = "second"
    link: Literal["serial", "can", "canfd", "i2c"] | None = None
    bit_rate: Annotated[float, Meta(ge=1e3, le=1e9)] | None = None
    data_bit_rate: Annotated[float, Meta(ge=1e4, le=1e8)] | None = None
    loss: Share = 0.0
    corrupt: Share = 0.0
    reorder: Share = 0.0
    delay_ms: Annotated[float, Meta(ge=0.0, le=1000.0)] = 0.0
    arbitration_us: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    fifo_ms: Annotated[float, Meta(ge=64, le=4000)] = 64.0
    disconnect_s: Interval | None = None
    power_s: Interval | None = None
    stall_s: Interval | None = None
    drift_ppm: Annotated[float, Meta(ge=-20000, le=20000)] = 0.0
    boards: Annotated[int, Meta(ge=1, le=16)] = 1
    seed: Annotated[int, Meta(ge=0, le=2**31)] = 0
    load_pf: Annotated[float, Meta(ge=0.0, le=1e6)] | None = None

    def load(self, channels: int) -> CurrentModel | None:
        """Return the load of an amplifier.

        Parameters
        ----------
        channels : int
            Number of its channels.

        Returns
        -------
        CurrentModel or None
            Equal capacitors; None if the amplifier does not measure.
        """
        return None if self.load_pf is None else CapacitiveLoad(self.load_pf * 1e-12, channels)

    @property
    def medium(self) -> Link:
        """Modeled link; one on which packets take no time, if none or no bit rate is given."""
        rate = self.bit_rate
        match self.link:
            case None | "serial":
                return Unlimited() if rate is None else Uart(rate)
            case "i2c":
                return I2c(rate or CLOCK)
            case _:
                data = (self.data_bit_rate or DATA) if self.link == "canfd" else None
                return Can(rate or NOMINAL, data)


RATES = (2500, 16000)
"""Lowest and highest sample rate that the amplifiers play [Hz]."""


class AmplifierRecord(OutputRecord):
    """Output of one amplifier between starts and ends.

    Parameters
    ----------
    scale : float
        Voltage of one code [V].
    channels : int
        Number of channels, C.
    kept : float
        Number of samples that are kept; infinite for all.
    """

    def __init__(self, scale: float, channels: int, kept: float) -> None:
        super().__init__(channels, kept)
        self._scale, self._channels = scale, channels
        self._last, self._sounding = State.IDLE, False

    def add_run(self, run: PlayedRun, begun: int, end: int | None) -> None:
        """Add a run of instants.

        Parameters
        ----------
        run : PlayedRun
            What the amplifier has put out.
        begun : int
            Tick of the latest START.
        end : int or None
            Wire position after the last sample that was written before the STOP; None before a
            STOP.
        """
        ending = run.state == State.ARMED and self._last in MOVING
        state = State.RAMPDOWN if ending else run.state
        self._last = run.state
        if state == State.RUNNING:
            keep = run.ticks >= begun
            if end is not None:
                before = distance(end, run.position)
                keep &= np.arange(len(run.codes)) < before
        elif state == State.RAMPDOWN:
            keep = np.ones(len(run.codes), bool)
        else:
            sounding = np.flatnonzero(run.codes.any(axis=1))
            count = sounding[-1] + 2 if len(sounding) else int(self._sounding)
            keep = np.arange(len(run.codes)) < count  # up to and including the first 0 V
        self._sounding = bool(run.codes[-1:].any())
        lines = np.full(np.count_nonzero(keep), run.lines, np.uint8)
        self.add(run.codes[keep].astype(np.float64) * self._scale, lines)

    def rest(self, total: int) -> None:
        """Extend the output by 0 V, because another amplifier came to rest slightly later.

        Parameters
        ----------
        total : int
            Number of samples after the extension.
        """
        self.add(np.zeros((total - self.total, self._channels)))


class ModeledBus(LinkBus):
    """Amplifiers on a link in memory.

    Parameters
    ----------
    wiring : Wiring
        What the amplifiers drive.
    model : Model
        Link and amplifiers.
    *arguments, **named : object
        Further arguments of `LinkBus`, and ``keep``: "all" to keep the whole output, otherwise the
        last second is kept.

    Attributes
    ----------
    model : Model
        Link and amplifiers.
    """

    paced = False

    def __init__(self, wiring: Wiring, model: Model, *arguments: Any, **named: Any) -> None:
        self.model = model
        self._ends: list[int | None] = [None] * len(model.configs)
        limit = math.inf if named.pop("keep") == "all" else wiring.sample_rate
        self._records = [
            AmplifierRecord(c.full_scale_uv * 1e-6 / FULL_SCALE_CODE, c.channels, limit)
            for c in model.configs
        ]
        super().__init__(wiring, *arguments, clock=model.clock, **named)
        model.on_output = self._record_run

    @property
    def output(self) -> Floats:
        """Drive voltages that were put out, as far as they are kept, array (S, C) [V]."""
        self._align()
        volts = [record.volts for record in self._records]
        shortest = min(len(samples) for samples in volts)
        return np.hstack([samples[len(samples) - shortest :] for samples in volts])[
            :, : self.wiring.channels
        ]

    @property
    def lines(self) -> NDArray[np.uint8]:
        """Codes on the lines that show marks, with each sample of `output`, array (S,)."""
        count, marks = len(self.output), [bool(c.marker_lines) for c in self.model.configs]
        lines = self._records[marks.index(True)].lines if any(marks) else np.zeros(count, np.uint8)
        return lines[len(lines) - count :]

    def _align(self) -> None:
        """Extend the outputs of all amplifiers to the same length, if all are at rest."""
        self.model.report_output()
        if not any(amplifier.state in MOVING for amplifier in self.model.amplifiers):
            longest = max(record.total for record in self._records)
            for record in self._records:
                record.rest(longest)

    def _record_run(self, board: int, run: PlayedRun) -> None:
        """Keep what an amplifier has put out."""
        node = self.model.configs[board].node
        begun = [peer.begun for peer in self._session.peers if peer.host.node == node]
        self._records[board].add_run(run, begun[0] if begun else 0, self._ends[board])

    def _turn(self, until: float) -> None:
        super()._turn(until)
        self.model.report_output()

    def _start(self, position: int) -> None:
        self._align()
        self._ends = [None] * len(self._ends)
        super()._start(position)

    def _stop(self) -> None:
        self.model.report_output()
        stream = self._session.stream
        if stream is not None:
            self._ends = [peer.wire_end(stream.end) for peer in self._session.peers]
        super()._stop()


def open_modeled(
    options: MockOptions,
    display: DisplayLike,
    sample_rate: float | None,
    model: Model | None = None,
) -> ModeledBus:
    """Open a modeled link.

    Parameters
    ----------
    options : MockOptions
        Options of the device's URL.
    display : DisplayLike
        Display that the amplifiers drive.
    sample_rate : float or None
        Sample rate of the drive [Hz]; None for the best that fits the link.
    model : Model or None
        Amplifiers and link; by default new ones with a clock of their own.

    Returns
    -------
    ModeledBus
        The bus, which remembers what its amplifiers put out.
    """
    wiring = Wiring.of(display, sample_rate or RATE)
    if model is None:
        model = model_of(options, wiring, ModelClock())
    return ModeledBus(
        wiring, model, partial(wire_of, model, options.medium),
        planner(options, display, sample_rate),
        keep=options.keep, rearm=options.rearm, lead=options.lead,
        correlation_ms=options.correlation_ms or 0,
    )  # fmt: skip


def wire_of(model: Model, link: Link) -> Wire:
    """Open the host's end of a modeled link.

    Parameters
    ----------
    model : Model
        Amplifiers and link.
    link : Link
        Medium of the link.

    Returns
    -------
    Wire
        The open wire.
    """
    model.open()
    if isinstance(model, CanModel):
        assert isinstance(link, Can)
        return CanWire(model, link, model.clock)
    if isinstance(model, I2cModel):
        assert isinstance(link, I2c)
        return I2cWire(model, [ADDRESS + k for k in range(len(model.configs))], link, model.clock)
    assert isinstance(model, SerialModel)
    return SerialWire(model, link, model.clock)


def model_of(options: MockOptions, wiring: Wiring, clock: Clock) -> Model:
    """Return new amplifiers on a modeled link.

    Parameters
    ----------
    options : MockOptions
        Options of the device's URL.
    wiring : Wiring
        What the amplifiers drive.
    clock : Clock
        Clock of the model.

    Returns
    -------
    Model
        The link with its amplifiers.

    Raises
    ------
    InputError
        If a serial line is to have more than one amplifier.
    """
    link, boards = options.medium, options.boards
    drift = options.drift_ppm * 1e-6
    width = -(wiring.channels // -boards)
    ranges = SensorDesign().ranges_ua if options.load_pf is not None else ()
    configs = [
        config_of(
            wiring,
            width,
            node,
            rates=RATES,
            fifo_ms=options.fifo_ms,
            sense_ranges_ua=ranges,
            marker_lines=MARKER_LINES_MOST,
        )
        for node in range(1, boards + 1)
    ]
    setup = ModelSetup(
        configs, _faults(options), clock,
        drift=[drift * k for k in range(1, boards + 1)],
        seed=options.seed,
        sensor=lambda board: _sensor(options, configs[board], options.seed + board),
    )  # fmt: skip
    if isinstance(link, Can):
        return CanModel(link, setup)
    if isinstance(link, I2c):
        return I2cModel(link, ADDRESS, setup)
    if boards > 1:
        raise InputError(f"mock: boards = {boards}: one on a serial line")
    return SerialModel(link, setup)


def _sensor(options: MockOptions, config: AmplifierConfig, seed: int) -> CurrentSensor | None:
    """Return the sensor of an amplifier; None if it does not measure."""
    load = options.load(config.channels)
    if load is None:
        return None
    full_scale = config.full_scale_uv * 1e-6
    design = SensorDesign(seed=seed)
    return CurrentSensor(load, design, channels=config.channels, full_scale=full_scale)


def _faults(options: MockOptions) -> Faults:
    return Faults(
        loss=options.loss,
        corrupt=options.corrupt,
        reorder=options.reorder,
        delay=options.delay_ms * 1e-3,
        arbitration=options.arbitration_us * 1e-6,
        disconnect=options.disconnect_s or math.inf,
        power=options.power_s or math.inf,
        stall=options.stall_s or math.inf,
    )
