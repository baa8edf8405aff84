"""``mock:?link=…``, a link in memory that takes its time and fails as its URL says.

``mock:?link=serial&bit_rate=3000000&loss=0.001``, ``link=can``, ``canfd`` or ``i2c``. Everything
but the device is what real links use. What the amplifiers put out is remembered as `mock_bus` does,
without the instants before a start and those in which the last sample was held before the ramp.
"""

import math
from collections import deque
from typing import Any

import numpy as np

from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FULL_SCALE_CODE, State
from firmware_protocol.player import distance
from tactile.arrays import Floats
from tactile.bus.base import RATE, DisplayLike, Wiring
from tactile.bus.board import config_of
from tactile.bus.can_bus import DATA, NOMINAL, CanWire
from tactile.bus.i2c_bus import ADDRESS, CLOCK, I2cWire
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.link_url import LINK_OPTIONS, lead_of, planner
from tactile.bus.options import flag, number, whole
from tactile.bus.registry import Address
from tactile.bus.serial_bus import SerialWire
from tactile.bus.simulated.line_model import CanModel, Faults, I2cModel, Model, Party, SerialModel
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Can, I2c, Link, Uart, Unlimited
from tactile.clock import Clock, ModelClock
from tactile.errors import InputError
from tactile.files import nearest

LINKS = ("serial", "can", "canfd", "i2c")
OPTIONS = (
    "link", "bit_rate", "data_bit_rate", "loss", "corrupt", "reorder", "delay_ms",
    "arbitration_us", "fifo_ms", "disconnect_s", "power_s", "stall_s", "drift_ppm", "boards",
    "seed", "keep", *LINK_OPTIONS,
)  # fmt: skip
RATES = (2500, 16000)
"""Hz that the amplifiers play."""
MOVING = (State.RUNNING, State.RAMPDOWN)


class Heard:
    """What one amplifier put out between starts and ends.

    Parameters
    ----------
    scale : volts per code
    channels : C
    kept : samples that are remembered; infinite for all

    Attributes
    ----------
    total : samples there ever were
    """

    def __init__(self, scale: float, channels: int, kept: float) -> None:
        self._scale, self._channels, self._most = scale, channels, kept
        self._kept: deque[Floats] = deque()
        self._count = self.total = 0
        self._last, self._sounding = State.IDLE, False

    def add(self, run: PlayedRun, begun: int, end: int | None) -> None:
        """Take a run of instants.

        ``begun`` is the tick of the latest START, ``end`` the wire position after what was written
        before its STOP.
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
            keep = np.arange(len(run.codes)) < count  # to the first 0 V
        self._sounding = bool(run.codes[-1:].any())
        self._keep(run.codes[keep].astype(np.float64) * self._scale)

    def _keep(self, volts: Floats) -> None:
        self._kept.append(volts)
        self.total += len(volts)
        self._count += len(volts)
        while self._count - len(self._kept[0]) >= self._most:
            self._count -= len(self._kept.popleft())

    def rest(self, total: int) -> None:
        """Take 0 V up to a sample: another amplifier was at 0 V later, by an instant or so."""
        self._keep(np.zeros((total - self.total, self._channels)))

    @property
    def volts(self) -> Floats:
        """What is kept (S, C) [V]."""
        return np.concatenate([np.zeros((0, self._channels)), *self._kept])


class ModeledBus(LinkBus):
    """Amplifiers on a link in memory.

    Attributes
    ----------
    model : of the link
    """

    paced = False

    def __init__(self, wiring: Wiring, model: Model, *arguments: Any, **named: Any) -> None:
        self.model = model
        self._ends: list[int | None] = [None] * len(model.configs)
        kept = math.inf if named.pop("keep") == "all" else wiring.sample_rate
        self._heard = [
            Heard(c.full_scale_uv * 1e-6 / FULL_SCALE_CODE, c.channels, kept) for c in model.configs
        ]
        super().__init__(wiring, *arguments, clock=model.clock, **named)
        model.listener = self._hear

    @property
    def output(self) -> Floats:
        """Volts put out (S, C), what is kept of them [V]."""
        self._align()
        volts = [heard.volts for heard in self._heard]
        shortest = min(len(one) for one in volts)
        return np.hstack([one[len(one) - shortest :] for one in volts])[:, : self.wiring.channels]

    def _align(self) -> None:
        """Let what all have put out be as long, where they have come to rest."""
        self.model.listen()
        if not any(amplifier.state in MOVING for amplifier in self.model.amplifiers):
            longest = max(heard.total for heard in self._heard)
            for heard in self._heard:
                heard.rest(longest)

    def _hear(self, board: int, run: PlayedRun) -> None:
        node = self.model.configs[board].node
        begun = [peer.begun for peer in self._session.peers if peer.host.node == node]
        self._heard[board].add(run, begun[0] if begun else 0, self._ends[board])

    def _turn(self, until: float) -> None:
        super()._turn(until)
        self.model.listen()

    def _start(self, position: int) -> None:
        self._align()
        self._ends = [None] * len(self._ends)
        super()._start(position)

    def _stop(self) -> None:
        self.model.listen()
        stream = self._session.stream
        if stream is not None:
            self._ends = [peer.wire_end(stream.end) for peer in self._session.peers]
        super()._stop()


def open_modeled(
    address: Address, display: DisplayLike, sample_rate: float | None, model: Model | None = None
) -> ModeledBus:
    """Open a link as its URL says: with new amplifiers and a clock of its own, unless given."""
    address.only(*OPTIONS)
    keep = address.options.get("keep", "second")
    if keep not in ("second", "all"):
        raise InputError(f"{address.scheme}: keep = {keep!r}: must be 'second' or 'all'")
    wiring = Wiring.of(display, sample_rate or RATE)
    if model is None:
        model = model_of(address, wiring, ModelClock())
    clock, link = model.clock, link_of(address)

    def connect() -> Wire:
        model.open()
        if isinstance(model, CanModel):
            assert isinstance(link, Can)
            return CanWire(model, link, clock)
        if isinstance(model, I2cModel):
            assert isinstance(link, I2c)
            return I2cWire(model, [ADDRESS + k for k in range(len(model.configs))], link, clock)
        assert isinstance(model, SerialModel)
        return SerialWire(model, link, clock)

    return ModeledBus(
        wiring, model, connect, planner(address, display, sample_rate, link),
        keep=keep, rearm=flag(address, "rearm"), lead=lead_of(address),
    )  # fmt: skip


def link_of(address: Address) -> Link:
    """Return how long packets take on the link that a URL asks for; no time, where on none."""
    name = address.options.get("link", "serial")
    if name not in LINKS:
        raise InputError(f"{address.scheme}: link = {name!r}: {nearest(name, list(LINKS))}")
    rate = number(address, "bit_rate", 1e3, 1e9)
    if name == "serial":
        return Unlimited() if rate is None else Uart(rate)
    if name == "i2c":
        return I2c(rate or CLOCK)
    data = number(address, "data_bit_rate", 1e4, 1e8) or DATA
    return Can(rate or NOMINAL, data if name == "canfd" else None)


def model_of(address: Address, wiring: Wiring, clock: Clock) -> Model:
    """Return the amplifiers and the link that a URL asks for."""
    link = link_of(address)
    boards = whole(address, "boards", 1, 16) or 1
    drift = (number(address, "drift_ppm", -20000, 20000) or 0.0) * 1e-6
    width = -(wiring.channels // -boards)
    fifo = number(address, "fifo_ms", 1, 10000) or 64.0
    configs = [
        config_of(wiring, width, node, rates=RATES, fifo_ms=fifo) for node in range(1, boards + 1)
    ]
    party = Party(
        configs, _faults(address), clock,
        drift=[drift * k for k in range(1, boards + 1)],
        seed=whole(address, "seed", 0, 2**31) or 0,
    )  # fmt: skip
    if isinstance(link, Can):
        return CanModel(link, party)
    if isinstance(link, I2c):
        return I2cModel(link, ADDRESS, party)
    if boards > 1:
        raise InputError(f"{address.scheme}: boards = {boards}: one on a serial line")
    return SerialModel(link, party)


def _faults(address: Address) -> Faults:
    def share(name: str) -> float:
        return number(address, name, 0.0, 1.0) or 0.0

    def interval(name: str) -> float:
        return number(address, name, 0.01, 1e9) or math.inf

    return Faults(
        loss=share("loss"),
        corrupt=share("corrupt"),
        reorder=share("reorder"),
        delay=(number(address, "delay_ms", 0.0, 1000.0) or 0.0) * 1e-3,
        arbitration=(number(address, "arbitration_us", 0.0, 1e6) or 0.0) * 1e-6,
        disconnect=interval("disconnect_s"),
        power=interval("power_s"),
        stall=interval("stall_s"),
    )
