"""Buses under contract, each with a bench that gives its output to the tests.

A bus in memory remembers that itself. Behind a real one is the amplifier in C, which writes each
instant to a file; `put_out` maps that as `tactile.bus.simulated.modeled_bus` does. A new bus joins
with a `Bench` and its name in `BENCHES`; audio cards and chips have files of their own.
"""

import functools
import inspect
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Protocol, TypeVar, cast

import numpy as np
import pytest
from bus_bridges import bridge, virtual_can
from numpy.typing import NDArray

from firmware_protocol.messages import FULL_SCALE_CODE, State
from tactile.arrays import Floats
from tactile.bus.base import Bus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError

Rows = NDArray[Any]
Test = TypeVar("Test", bound=type)

RATE, SLOW_RATE = 8000.0, 2500.0
"""Sample rates [Hz]. The slower one is for slcan, where python-can and a fake adapter in one Python
process spend a tenth of a millisecond on each of 4500 frames per second."""
PCM16 = 5e-3
"""Largest error of PCM16 [V]; 16 bits over ±100 V round by 1.5 mV at most."""
PCM12 = 60e-3
"""Largest error of PCM12 [V]; 12 bits round by 25 mV, and end 46 mV below ±100 V."""
LONGEST_HOLD = 50e-3
"""Longest time for which the last sample may be held before the ramp, while STOP is on its way
[s]."""
FLUSHED = 45_000
"""Ticks of 1 µs by which the amplifier in C has written, each 20 ms, what it put out before."""
SETTLING = 30e-3
"""Time after which an amplifier in memory, whose time passes only while somebody waits, is at 0 V
[s]."""
SWITCH, FAST_SWITCH = sys.getswitchinterval(), 5e-4
"""Intervals after which Python's threads take turns: 5 ms as usual, and the one for bridge and host
in one process [s]."""
LEAD = "lead_ms=60"
"""Parameter of buses in real time: a machine that stands still for less does no harm."""
TRIES = 12
"""Runs of a test, where the machine stalls."""
STALLS = ("underruns", "late_blocks", "dropped_samples", "disconnects")


class Watched(Protocol):
    """View of a bus in memory for the tests."""

    @property
    def output(self) -> Floats: ...


class Bench:
    """A kind of bus, ready to be tested: this one lies in memory.

    Attributes
    ----------
    url : URL that opens the bus, or the name of a real link
    reached : URL that opened the latest one
    rate : sample rate [Hz]
    wire : volts by which its samples are rounded at most
    rates : sample rates that the bus can carry beside 8 kHz [Hz]
    boards : amplifiers behind it
    """

    rate = RATE
    wire = PCM16
    rates: tuple[float, ...] = (5000.0, 16000.0)

    def __init__(self, url: str) -> None:
        self.url = self.reached = url
        if "link=can&" in url or url.endswith("link=can"):
            self.wire = PCM12
        if "link=can" in url or "link=i2c" in url:
            self.rates = (5000.0,)
        self.boards = 2 if "boards=2" in url else 1
        self.buses: list[Bus] = []

    def open(self, display: Display, sample_rate: float | None = None) -> Bus:
        """Open a bus."""
        return self._opened(self.url, display, sample_rate or self.rate)

    def _opened(self, url: str, display: Display, sample_rate: float) -> Bus:
        self.reached = url
        bus = open_bus(url, display, sample_rate=sample_rate)
        self.buses.append(bus)
        return bus

    def put_out(self, bus: Bus) -> Floats:
        """Return the volts put out since it was opened, at least the last second of them.

        Without the instants before a start and those in which the last sample was held before the
        ramp.
        """
        if isinstance(bus, ModeledBus) and bus.state != "closed":
            bus._wait(lambda: False, SETTLING)
        return cast(Watched, bus).output.copy()

    def stalled(self) -> dict[str, int]:
        """Return what buses in real time counted that shows a stall of this machine."""
        return {}

    def reset(self) -> None:
        """Close all that was opened."""
        for bus in self.buses:
            bus.close()
        self.buses.clear()


# In real time


@dataclass
class Amplifier:
    """A process of the amplifier in C, with what it put out.

    Attributes
    ----------
    played : of each start since, how many samples were to be played before the ramp; None where
        nobody said so
    """

    process: "subprocess.Popen[str]"
    out: Path
    channels: int
    played: list[int | None] = field(default_factory=list)

    def rows(self) -> Rows:
        """Return the instants that it has written by now."""
        layout = np.dtype(
            [("tick", "<u8"), ("position", "<u4"), ("state", "u1"), ("high_voltage", "u1"),
             ("codes", "<i2", (self.channels,))]
        )  # fmt: skip
        data = self.out.read_bytes() if self.out.exists() else b""
        return np.frombuffer(data[: len(data) // layout.itemsize * layout.itemsize], layout)

    def settled(self) -> Rows:
        """Return all instants up to now, and some more."""
        rows = self.rows()
        before = int(rows["tick"][-1]) if len(rows) else 0
        while not len(rows) or rows["tick"][-1] < before + FLUSHED:
            assert self.process.poll() is None, "the amplifier has ended"
            select_nothing(5e-3)
            rows = self.rows()
        return rows

    def watch(self, bus: Bus) -> None:
        """Store with each start the position up to which it is to play."""
        start, stop, first = bus._start, bus._stop, 0

        def starting(position: int) -> None:
            nonlocal first
            first = position
            self.played.append(None)
            start(position)

        def stopping() -> None:
            self.played[-1] = bus._next - first
            stop()

        vars(bus).update(_start=starting, _stop=stopping)

    def kill(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        cast(IO[str], self.process.stdout).close()


def prefer(process: int, priority: int = 1) -> None:
    """Run a process before all others, 0 for this thread and those it starts, where allowed."""
    with suppress(OSError, AttributeError):  # not root, not Linux
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        os.sched_setscheduler(process, policy, os.sched_param(priority))


def select_nothing(seconds: float) -> None:
    """Sleep, also when the clock of the tests does not."""
    select.select([], [], [], seconds)


class EarlyError(AssertionError):
    """An end took effect before all was played: the bus was early, or the process held up."""


def heard(rows: Rows, played: list[int | None], longest_hold: float) -> Floats:
    """Return the volts of instants between starts and ends.

    Each start is held at its position until its tick comes. What was to be played is followed by
    the last sample, held, for ``longest_hold`` instants at most, and by the ramp, to its first 0.
    """
    running = rows["state"] == State.RUNNING
    edges = np.flatnonzero(np.diff(running.astype(np.int8), prepend=0, append=0))
    begins, ends = edges[::2], edges[1::2]
    if len(begins) < len(played):
        raise EarlyError(f"{len(played) - len(begins)} starts ended before their tick came")
    assert len(begins) == len(played), "starts that the amplifier did, and the bus"
    keep = np.zeros(len(rows), bool)
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        positions = rows["position"][begin:end]
        first = begin + np.flatnonzero(positions == positions[0])[-1]
        count = played[k]
        last = end if count is None else first + count
        if last > end:
            raise EarlyError(f"the ramp began {last - end} instants before the last sample")
        assert end - last <= longest_hold, "instants for which the last sample was held"
        keep[first:last] = True
        after = rows[end : begins[k + 1] if k + 1 < len(begins) else len(rows)]
        loud = np.flatnonzero(after["codes"].any(axis=1) | (after["state"] == State.RAMPDOWN))
        keep[end : end + (loud[-1] + 2 if len(loud) else 1)] = True
    return rows["codes"][keep] * (100.0 / FULL_SCALE_CODE)


class RealBench(Bench):
    """A bus in real time, with the amplifier in C behind it.

    Parameters
    ----------
    link : "pty", "rfc2217", "udp", "virtual" or "slcan"
    program : virtual-amplifier
    directory : folder for the files that it writes
    """

    def __init__(self, link: str, program: Path, directory: Path) -> None:
        super().__init__(link)
        self._program, self._directory = program, directory
        self._amplifiers: dict[int, Amplifier] = {}
        self._open = ExitStack()
        self._early = 0
        self._count = 0
        if link == "slcan":
            self.rate, self.wire = SLOW_RATE, PCM12

    def amplifier(self, channels: int, *options: str) -> Amplifier:
        """Start an amplifier; what it is reached by is its first line, or the socket's path."""
        self._count += 1
        out = self._directory / f"out{self._count}"
        process = subprocess.Popen(
            [self._program, *options, "--channels", str(channels), "--out", out,
             "--slew-v-per-s", "100000000"],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        prefer(process.pid)
        found = Amplifier(process, out, channels)
        self._open.callback(found.kill)
        return found

    def pty(self, channels: int, *options: str) -> tuple[Amplifier, str]:
        """Start an amplifier on a pseudo-terminal; return it and the path."""
        amplifier = self.amplifier(channels, "--pty", *options)
        return amplifier, cast(IO[str], amplifier.process.stdout).readline().strip()

    def _reached(self, channels: int) -> tuple[Amplifier, str]:
        """Return an amplifier and the URL that it is reached by."""
        if self.url in ("pty", "rfc2217", "udp"):
            amplifier, path = self.pty(channels)
            if self.url == "pty":
                return amplifier, f"serial://{path}?{LEAD}"
            port = self._open.enter_context(bridge(self.url, path))
            if self.url == "udp":
                return amplifier, f"udp:127.0.0.1:{port}?{LEAD}"
            return amplifier, f"serial:rfc2217://127.0.0.1:{port}?baud=3000000&{LEAD}"
        path = str(self._directory / f"can{self._count}")
        fd = ["--fd"] if self.url == "virtual" else []
        amplifier = self.amplifier(channels, "--can", path, *fd)
        while not Path(path).exists():
            assert amplifier.process.poll() is None
            select_nothing(1e-3)
        if self.url == "virtual":
            name = self._open.enter_context(virtual_can(path, fd=True))
            return amplifier, f"can:virtual/{name}?fd=true&{LEAD}"
        tty = self._open.enter_context(bridge("slcan", path))
        return amplifier, f"can:slcan/{tty}?bitrate=1000000&{LEAD}"

    def open(self, display: Display, sample_rate: float | None = None) -> Bus:
        prefer(0)
        sys.setswitchinterval(FAST_SWITCH)
        amplifier, url = self._reached(display.channels)
        bus = self._opened(url, display, sample_rate or self.rate)
        amplifier.watch(bus)
        self._amplifiers[id(bus)] = amplifier
        return bus

    def put_out(self, bus: Bus) -> Floats:
        amplifier = self._amplifiers[id(bus)]
        rows, longest = amplifier.settled(), LONGEST_HOLD * bus.wiring.sample_rate
        try:
            return heard(rows, amplifier.played, longest)
        except EarlyError:
            self._early += 1
            raise

    def stalled(self) -> dict[str, int]:
        faults = [bus.counters.faults() for bus in self.buses]
        if self._early:
            return {"early ramps": self._early}
        return {
            name: sum(f.get(name, 0) for f in faults)
            for name in STALLS
            if any(name in f for f in faults)
        }

    def reset(self) -> None:
        super().reset()
        self._open.close()
        self._amplifiers.clear()
        self._early = 0
        prefer(0, 0)
        sys.setswitchinterval(SWITCH)


def steadied(cases: Test) -> Test:
    """Repeat tests of a class, a few times at most, whose failure this machine's stalls explain.

    What plays in real time plays late where amplifier, bridge or host are not run for longer than
    the lead, 60 ms. The amplifier then fades, as it must, and what was put out is not what a test
    compares with. Such a run shows itself: it has failed, *and* the bus has counted underruns, late
    or dropped samples, or lost the link. One
    stall no counter shows: the virtual amplifier, held up for milliseconds, takes what waits as
    come before, so that a STOP begins its ramp before the last samples (`EarlyError`). Such a run
    proves nothing and is repeated. A bus that causes these by itself does so each time, and fails
    after `TRIES` runs; any other failure with clean counters fails at once, and so does each of a
    bus in memory, whose time is its own.
    """

    def repeated(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(*arguments: Any, **named: Any) -> None:
            bench: Bench = named["bench"]
            for left in reversed(range(TRIES)):
                try:
                    test(*arguments, **named)
                    return
                except (AssertionError, BusError, pytest.fail.Exception) as error:
                    stalls = bench.stalled()
                    if not stalls:
                        raise
                    if not left:
                        error.add_note(f"each of {TRIES} runs stalled; the last counted {stalls}")
                        raise
                bench.reset()

        return run

    for name, test in inspect.getmembers(cases, inspect.isfunction):
        if name.startswith("test_"):
            setattr(cases, name, repeated(test))
    return cases


# All benches

IDEAL = ("mock:", "mock:?keep=all", "sim:", "sim:?plant=plant_of_the_bus_contract:make")
"""Buses that play as fast as they are written to."""
MODELED = (
    "mock:?link=serial",
    "mock:?link=serial&bit_rate=3000000",
    "mock:?link=can",
    "mock:?link=canfd&boards=2",
    "mock:?link=i2c&bit_rate=1000000",
)
REAL = ("pty", "rfc2217", "udp", "virtual", "slcan")
"""Buses of which only tests with ``-m realtime`` run."""
SELDOM = (
    "mock:?keep=all",
    "mock:?link=serial",
    "mock:?link=can",
    "mock:?link=i2c&bit_rate=1000000",
)
"""Buses that only tests with ``-m ci`` run on: they differ little from the others, or take their
time."""
BENCHES = [
    *(
        pytest.param(name, id=name, marks=[pytest.mark.ci] if name in SELDOM else [])
        for name in (*IDEAL, *MODELED)
    ),
    *(
        pytest.param(name, id=name, marks=pytest.mark.realtime)
        for name in ("pty", "virtual")  # the others differ in what is between, and have a test
    ),
]


def bench_of(name: str, request: pytest.FixtureRequest) -> Iterator[Bench]:
    """Yield a bench by its name, and close what it opened; the body of a fixture."""
    if name in REAL:
        bench: Bench = RealBench(
            name, request.getfixturevalue("virtual_amplifier"), request.getfixturevalue("tmp_path")
        )
    else:
        bench = Bench(name)
    try:
        yield bench
    finally:
        bench.reset()
