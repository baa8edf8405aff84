"""Common tools of the checks of the project's own buses inside a guest.

`tactile.devices` is left alone, since it loads scipy, which takes a guest a minute.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event, Thread

import numpy as np
from guest_tools import wait_for
from numpy.typing import NDArray

from firmware_protocol.messages import FULL_SCALE_CODE, SampleFormat
from tactile.arrays import Floats
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.registry import open_bus
from tactile.errors import BusError

PEAK = 80.0
"""Amplitude of `waves` [V]."""
CODE = 100.0 / FULL_SCALE_CODE
"""Voltage of one sample code [V]."""
ROUNDING = {SampleFormat.PCM16: 0.5, SampleFormat.PCM12: 8.0, SampleFormat.BFP8: 128.0}
"""Codes by which a format is off at most, at `PEAK` (SPEC.md, 9)."""
BLOCK = 16
TRIES = 5
"""A guest waits for the files of this machine now and then."""


@dataclass(frozen=True)
class Limits:
    """Limits of a display, in SI units."""

    voltage: float = 100.0
    fade: float = 20e-3


@dataclass(frozen=True)
class Calibration:
    """Calibration of an audio card."""

    audio_full_scale: float | None = 100.0
    ac_coupling: float = 0.0


@dataclass(frozen=True)
class Rig:
    """Part of a display that a bus needs."""

    channels: int
    slew: float = 0.7e6
    limits: Limits = field(default_factory=Limits)
    amplifier: Calibration = field(default_factory=Calibration)


def opened(url: str, channels: int, rate: float | None = None) -> LinkBus:
    """Open a bus of amplifiers that speak the protocol."""
    bus = open_bus(url, Rig(channels), sample_rate=rate)
    assert isinstance(bus, LinkBus)
    return bus


@contextmanager
def linked(url: str, channels: int, rate: float | None = None) -> Iterator[LinkBus]:
    """Have it open within the context."""
    bus = opened(url, channels, rate)
    with bus:
        yield bus


def waves(count: int, channels: int, rate: float) -> Floats:
    """Return sines (S, C), each channel's own, that begin at 0 V [V]."""
    time = np.arange(count)[:, None] / rate
    return np.asarray(PEAK * np.sin(2 * np.pi * (40 + 7 * np.arange(channels)) * time))


def write(bus: Bus, volts: Floats, block: int = BLOCK) -> None:
    """Play samples in blocks."""
    for k in range(0, len(volts), block):
        bus.write(DriveBlock(k, volts[k : k + block]))


@contextmanager
def playing(bus: Bus, block: int = BLOCK) -> Iterator[None]:
    """Play waves, over and over, by a thread of its own; it ends with the context."""
    volts = waves(round(bus.wiring.sample_rate), bus.wiring.channels, bus.wiring.sample_rate)
    volts *= bus.wiring.voltage / 100
    ended, failed = Event(), []

    def run() -> None:
        position = 0
        try:
            while not ended.is_set():
                k = position % len(volts)
                bus.write(DriveBlock(position, volts[k : k + block]))
                position += len(volts[k : k + block])
        except BusError as error:
            if bus.state == "running":
                failed.append(error)

    bus.start()
    thread = Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
    assert not failed


@dataclass(frozen=True)
class Record:
    """Output of an amplifier, one row per instant.

    Attributes
    ----------
    ticks, positions, states, high_voltage : (S,)
    volts : (S, C)
    """

    ticks: NDArray[np.int64]
    positions: NDArray[np.int64]
    states: NDArray[np.int64]
    high_voltage: NDArray[np.bool_]
    volts: Floats

    @classmethod
    def read(cls, path: Path, channels: int) -> "Record":
        """Read what the amplifier in C has written so far with --out."""
        kind = np.dtype(
            [("tick", "<u8"), ("at", "<u4"), ("state", "u1"), ("hv", "?"), ("v", "<i2", channels)]
        )
        data = path.read_bytes() if path.exists() else b""
        rows = np.frombuffer(data[: len(data) // kind.itemsize * kind.itemsize], kind)
        return cls(
            rows["tick"].astype(np.int64), rows["at"].astype(np.int64),
            rows["state"].astype(np.int64), rows["hv"],
            rows["v"].reshape(-1, channels) * CODE,
        )  # fmt: skip

    def first(self, where: NDArray[np.bool_]) -> int:
        """Return the tick of the first row that is so."""
        assert where.any()
        return int(self.ticks[np.argmax(where)])

    @property
    def at_rest(self) -> NDArray[np.bool_]:
        """Return which rows are at 0 V."""
        return np.asarray(~self.volts.any(axis=1))

    def began(self, bus: LinkBus, node: int = 0) -> int:
        """Return the row of the first sample of a start; its position stands there until then."""
        first = bus._session.peers[node].wire_end(0)
        return int(np.flatnonzero(self.positions == first)[-1])

    def played(self, bus: LinkBus, count: int, node: int = 0) -> Floats:
        """Return the first samples that a bus sent since its latest start."""
        begin = self.began(bus, node)
        rows = slice(begin, begin + count)
        assert np.array_equal(self.positions[rows], self.positions[begin] + np.arange(count))
        return self.volts[rows]


def assert_is(played: Floats, volts: Floats, sample_format: SampleFormat | None) -> None:
    """Compare what was put out with the drive, to what its format rounds."""
    assert sample_format is not None
    worst = np.abs(played - volts).max()
    assert worst <= (ROUNDING[sample_format] + 0.5) * CODE


def play(bus: Bus, seconds: float = 0.5, block: int = BLOCK) -> Floats:
    """Play waves to their end, again where something came late, and return them."""
    rate = bus.wiring.sample_rate
    volts = waves(int(seconds * rate), bus.wiring.channels, rate)
    for _ in range(TRIES):
        before = bus.counters.faults()
        try:
            bus.start()
        except BusError as error:
            print(error)
        else:
            write(bus, volts, block)
            bus.stop()
            if bus.counters.faults() == before:
                return volts
        faults = bus.counters.faults()
        print("faults:", faults)
        wait_for_link(bus, "up")
    raise AssertionError(f"faults in each of {TRIES} tries: {faults}")


def wait_for_link(bus: Bus, link: str) -> None:
    """Wait until the status of the link is up or down."""
    wait_for(f"the link is {link}", lambda: bus.status.link == link)
    assert "\n" not in bus.status.detail
