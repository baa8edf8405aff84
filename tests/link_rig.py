"""Bench for links under faults: writes a signal, records the output and checks it.

Even channels carry a triangle, whose value tells the position to within its fold; odd ones carry a
level, which tells whether the gain is full. Everything that each amplifier puts out is kept with
the true time at which it is.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FULL_SCALE_CODE, State
from firmware_protocol.packet import Packet
from tactile.arrays import Floats, Ints
from tactile.bus.base import DriveBlock
from tactile.bus.link.phases import SessionPhase
from tactile.bus.simulated.line_model import Faults
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus

RATE = 2500.0
VOLTAGE = 100.0
SLEW = 0.05e6
"""Slew limit [V/s]: 20 V from sample to sample at 2.5 kHz, 6.25 V at 8 kHz."""
PEAK, LEVEL = 80.0, 50.0
"""Amplitudes of the triangle and of the constant level [V]."""
PERIOD = 4000
"""Period of the triangle in samples: 0.08 V from one to the next, 26 codes of 16 bits."""
FOLD = 60
"""Number of samples beside an apex, or the end, that are not compared: a straight line may have cut
it."""
SETTLED = 20
"""Samples for which the level has stood before the triangle is compared: so long from 0 V at most
at the slew limit."""
SAMPLE = 1.0
"""Number of samples by which a signal may be early or late [samples]."""
RECOVERY = 2.0
"""Longest time until a link plays again [s]."""
FADED = 20e-3
"""Length of a fade [s]."""

LINKS = {
    "serial": "mock:?link=serial&bit_rate=3000000&format=pcm16",
    "can": "mock:?link=can&format=pcm16",
    "canfd": "mock:?link=canfd&format=pcm16",
    "i2c": "mock:?link=i2c&bit_rate=1000000&format=pcm16",
}
MOST = [
    pytest.param(name, marks=pytest.mark.ci if name in ("canfd", "i2c") else ()) for name in LINKS
]
"""All of them, some only in CI."""


@dataclass(frozen=True)
class _Limits:
    voltage: float = VOLTAGE
    fade: float = 20e-3


@dataclass(frozen=True)
class _Wired:
    audio_full_scale: float | None = None
    ac_coupling: float = 0.0


@dataclass(frozen=True)
class Panel:
    """Part of a display that a link needs."""

    channels: int = 2
    slew: float = SLEW
    limits: _Limits = field(default_factory=_Limits)
    amplifier: _Wired = field(default_factory=_Wired)


def content(position: Ints | Floats, channels: int = 2) -> Floats:
    """Return what is written at positions (S, C) [V]."""
    turns = np.asarray(position, np.float64) / PERIOD
    volts = np.full((len(turns), channels), LEVEL)
    volts[:, ::2] = PEAK * (4 * np.abs(turns - np.floor(turns + 0.5)) - 1)[:, None]
    return volts


@dataclass
class Heard:
    """Output of one amplifier between two resets: times [s], codes and states of instants."""

    times: list[Floats] = field(default_factory=list)
    codes: list[NDArray[np.int16]] = field(default_factory=list)
    states: list[Ints] = field(default_factory=list)

    def together(self) -> tuple[Floats, Ints, Ints]:
        """Return times (S,), codes (S, C) and states (S,)."""
        if not self.times:
            return np.zeros(0), np.zeros((0, 1), np.int64), np.zeros(0, np.int64)
        codes = np.concatenate(self.codes).astype(np.int64)
        return np.concatenate(self.times), codes, np.concatenate(self.states)


class Bench:
    """A modeled link that is written to and watched.

    Parameters
    ----------
    url : URL of the link
    panel : part of a display that the link drives
    rate : [Hz]

    Attributes
    ----------
    bus, model, clock : bus, model and clock of the link
    position : written next
    zero : true time at which position 0 was put out [s]
    full_scale : full scale of the amplifiers [V]
    """

    def __init__(self, url: str, panel: Panel | None = None, rate: float = RATE) -> None:
        self.panel = panel or Panel()
        self.bus = cast(ModeledBus, open_bus(url, self.panel, sample_rate=rate))
        self.model, self.clock, self.rate = self.bus.model, self.bus.model.clock, rate
        self.position, self.zero = 0, math.nan
        self.full_scale = VOLTAGE
        self._inner = self.model.on_output
        self._amplifiers = list(self.model.amplifiers)
        self.heard: list[list[Heard]] = [[Heard()] for _ in self._amplifiers]
        self.model.on_output = self._hear

    def _hear(self, board: int, run: PlayedRun) -> None:
        self._inner(board, run)
        model = self.model
        if model.amplifiers[board] is not self._amplifiers[board]:
            self._amplifiers[board] = model.amplifiers[board]
            self.heard[board].append(Heard())
        kept = self.heard[board][-1]
        first = model.time_of(board, 0)
        pace = model.configs[board].tick_hz * (1 + model.drift[board])
        kept.times.append(first + run.ticks / pace)
        kept.codes.append(run.codes)
        kept.states.append(np.full(len(run.codes), int(run.state)))

    # What is done

    def start(self) -> None:
        """Play from position 0 on."""
        self.bus.start()
        self.position = 0
        peer = self.bus.peers[0]
        self.zero = self.model.time_of(0, peer.begun)

    def begin(self, seconds: float) -> None:
        """Play from position 0 on, for a while."""
        self.start()
        self.play(seconds)

    def write(self, count: int) -> None:
        """Write the samples that come next."""
        at = np.arange(self.position, self.position + count)
        self.position += count
        self.bus.write(DriveBlock(int(at[0]), content(at, self.panel.channels)))

    def play(self, seconds: float, block: int = 16) -> None:
        """Write for a while."""
        end = self.position + round(seconds * self.rate)
        while self.position < end:
            self.write(min(block, end - self.position))

    @property
    def playing(self) -> bool:
        """Whether all amplifiers play now."""
        return all(a.state == State.RUNNING for a in self.model.amplifiers)

    @property
    def silent(self) -> bool:
        """Whether all amplifiers put out 0 V."""
        return not any(a._player.output.any() for a in self.model.amplifiers)

    def silence_after(self, since: float) -> float:
        """Return how long after a time all outputs are at 0 V for good [s]."""
        self.model.report_output()
        last = since
        for board in self.heard:
            for kept in board:
                times, codes, _ = kept.together()
                sounding = np.flatnonzero(codes.any(axis=1))
                if len(sounding):
                    after = sounding[-1] + 1
                    last = max(last, times[after] if after < len(times) else math.inf)
        return last - since

    def idle(self, seconds: float) -> None:
        """Let time pass while the program writes nothing."""
        end = self.clock.now() + seconds
        while self.clock.now() < end:
            self.bus._turn(end)

    def at(self, time: float) -> Floats:
        """Return magnitudes put out last before a time (C,) [V]."""
        self.model.report_output()
        found = []
        for board in self.heard:
            times, codes, _ = board[-1].together()
            found.append(codes[np.searchsorted(times, time) - 1])
        volts: Floats = np.abs(np.concatenate(found)) * (self.full_scale / FULL_SCALE_CODE)
        return volts

    # What must hold

    def check_limits(self) -> int:
        """See that no sample passes the limits in value or step; return how many there were."""
        self.model.report_output()
        volts = self.full_scale / FULL_SCALE_CODE
        most = math.floor(self.panel.limits.voltage / volts + 1e-6)
        step = math.floor(self.panel.slew / self.rate / volts + 1e-6)
        count = 0
        for board in self.heard:
            for kept in board:
                times, codes, _ = kept.together()
                steps = np.diff(codes, axis=0, prepend=0)
                assert np.abs(codes).max(initial=0) <= most
                assert np.abs(steps).max(initial=0) <= step
                assert np.all(np.diff(times) > 0)
                count += len(codes)
        return count

    def misplaced(self, board: int = 0, since: float = -math.inf) -> tuple[float, int]:
        """Return by how much samples at full gain are early or late at most [samples].

        And how many were compared, of those after a time.
        """
        self.model.report_output()
        worst, count = 0.0, 0
        slope = 4 * PEAK / PERIOD
        level = round(LEVEL / self.full_scale * FULL_SCALE_CODE)
        for kept in self.heard[board]:
            times, codes, _ = kept.together()
            if not len(times):
                continue
            full = codes[:, 1] == level
            stands = np.convolve(full, np.ones(SETTLED))[: len(full)] >= SETTLED
            due = (times - self.zero) * self.rate
            fold = np.abs(due % (PERIOD / 2) - PERIOD / 4) < PERIOD / 4 - FOLD
            seen = stands & fold & (times > since) & (due > 0)
            seen &= due < self.position - FOLD  # at a stop the last sample is held
            wanted = content(due[seen])[:, 0]
            got = codes[seen, 0] * self.full_scale / FULL_SCALE_CODE
            count += int(seen.sum())
            worst = max(worst, float(np.abs(got - wanted).max(initial=0.0)) / slope)
        return worst, count

    def faults(self) -> dict[str, int]:
        """Return what all amplifiers have counted that should be zero."""
        total: dict[str, int] = {}
        for amplifier in self.model.amplifiers:
            for name, n in vars(amplifier.counters).items():
                if n and name != "packets":
                    total[name] = total.get(name, 0) + n
        return total


Linked = Callable[..., Bench]
"""Makes benches of a link by its name, and options of its URL."""


def recover(rig: Bench, reconnects: int, random: np.random.Generator) -> None:
    """Write until all play again after a reconnection."""
    end = rig.clock.now() + RECOVERY
    session = rig.bus._session
    while not (
        rig.bus.counters.reconnects > reconnects
        and rig.playing
        and session.phase is SessionPhase.RUN
    ):
        assert rig.clock.now() < end, rig.bus.status
        rig.write(int(random.integers(3, 20)))


def fade_in(rig: Bench) -> None:
    """Play until the gain is at full again."""
    rig.play(rig.bus.lead + FADED + 0.08)


def disturb(rig: Bench, faults: Faults) -> None:
    """Let a link be as bad as this from now on."""
    rig.model.faults = rig.model.out._faults = rig.model.back._faults = faults


def overheard(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Packet, int]]:
    """Return what fills with the packets that amplifiers get, and when [ticks]."""
    heard: list[tuple[Packet, int]] = []
    usual = ReferenceAmplifier.receive

    def receive(self: ReferenceAmplifier, packet: Packet, now: int) -> None:
        heard.append((packet, now))
        usual(self, packet, now)

    monkeypatch.setattr(ReferenceAmplifier, "receive", receive)
    return heard
