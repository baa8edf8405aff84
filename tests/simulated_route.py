"""Way from a program of a simulation to its amplifiers, judged by their output."""

import asyncio
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from sample_ledger import Ledger
from simulated_chips import Chips
from virtual_clock import VirtualClock
from virtual_loop import LoopProcess
from virtual_server import World

from firmware_protocol.machine import PlayedRun
from tactile.arrays import Floats
from tactile.bus.registry import parse
from tactile.bus.simulated.line_model import Model
from tactile.client import aio
from tactile.client.websocket import TaskTransport
from tactile.errors import ClientError

RATE = 2500.0
LIMIT, SLEW = 60.0, 20e3
"""Limits of the display: voltage [V] and slew [V/s]."""
SILENT = 0.3
"""Longest time to 0 V from an e-stop, or from the death of any process between a program and its
amplifier [s]."""
STOPPED = 0.03
"""Longest time from an e-stop to 0 V where nothing fails [s]: a look at the latch, and a fade."""
ORPHANED = 0.6
"""Longest time to 0 V from the death of a program that armed, while an engine plays on [s]."""
UNPOWERED = 1.0
"""Longest time from that death until the high voltage is off [s]."""


class Program(LoopProcess):
    """A program that plays on a display, or only stops.

    Parameters
    ----------
    world : world of the program
    url : URL of the server
    rearm : whether to arm again after a reconnection
    """

    def __init__(self, world: World, url: str, *, rearm: bool = False) -> None:
        super().__init__(world.clock, world.errors)
        self.connection: aio.AsyncConnection | None = None
        self.begin(self._connect(world.clock, url, rearm))

    async def _connect(self, clock: VirtualClock, url: str, rearm: bool) -> None:
        while True:
            transport = TaskTransport(url, timeout=1.0)
            connection = aio.AsyncConnection(transport, clock=clock, rearm=rearm)
            try:
                self.connection = await connection.open()
            except ClientError:  # there is no server yet
                await asyncio.sleep(0.1)
            else:
                return


@dataclass
class Route:
    """Way from a program to the amplifiers of one display, and the requests that went over it.

    Attributes
    ----------
    name, device : name and device of the display
    program : program that plays on the display
    wrong : broken promises on any way, one line each
    model : model of the link and its amplifiers, or of chips; None before it is opened
    number : number of the latest e-stop that was answered
    stopped : when that was, unless its clear was asked for since [s]
    deaths : who on the way is dead, and since when [s]
    woken : when playback went on that had stood still; who died meanwhile it learns then [s]
    disturbed : until when something that has failed may still be felt [s]
    moved : until when an engine moves a finger [s]
    last : latest output of each amplifier (C,) [V]
    ledger : ledger of samples
    sounding : samples other than 0 V that were put out
    worst : longest time from an e-stop or a death to 0 V [s]
    """

    name: str
    device: str
    program: Program
    wrong: list[str]
    ledger: Ledger = field(default_factory=Ledger)
    model: Model | Chips | None = None
    number: int = 0
    stopped: float = math.inf
    deaths: dict[str, float] = field(default_factory=dict)
    woken: float = 0.0
    disturbed: float = 0.0
    moved: float = 0.0
    last: dict[int, Floats] = field(default_factory=dict)
    sounding: int = 0
    worst: dict[str, float] = field(default_factory=lambda: {"e-stop": 0.0, "death": 0.0})

    def __post_init__(self) -> None:
        self.address = parse(self.device)

    @property
    def dead(self) -> float:
        """Time since when the way is cut [s]; infinite if it is not."""
        return min(self.deaths.values(), default=math.inf)

    def judge(self, board: int, run: PlayedRun, times: Floats, code: float) -> None:
        """Judge what an amplifier put out, at these times (S,) [s], with so many volts a code."""
        volts = np.float64(code) * run.codes
        self.judge_volts(board, volts, times, code)
        if board == 0:
            rough = (17 if "pcm12" in self.device else 2) * code
            self.ledger.put_out(run, volts, times, rough)
        since = min(self.stopped, max(self.dead, self.woken))
        if run.high_voltage and times[-1] > since + UNPOWERED:
            self.wrong.append(f"{self.name}: high voltage at {times[-1]:.4f}, from {since:.4f}")

    def judge_volts(
        self, board: int, volts: Floats, times: Floats, code: float, *, rate: float = RATE,
        dropped: NDArray[np.bool_] | None = None,
    ) -> None:  # fmt: skip
        """Judge volts (S, C) that come at a rate [Hz], but for steps to 0 V of a chip itself (S,).

        The first promise that is broken is enough.
        """
        if self.wrong:
            return
        before = self.last.get(board, np.zeros(volts.shape[1]))
        steps = np.abs(np.diff(np.vstack([before, volts]), axis=0))
        step = float(steps.max(initial=0.0, where=True if dropped is None else ~dropped[:, None]))
        self.last[board] = volts[-1]
        peak = float(np.abs(volts).max())
        if peak > LIMIT + code:
            self.wrong.append(f"{self.name}: {peak:.2f} V is above the limit, at {times[0]:.4f}")
        if step > SLEW / rate + 2 * code:
            self.wrong.append(f"{self.name}: a step of {step:.2f} V, at {times[0]:.4f}")
        loud = times[volts.any(axis=1)]
        if not len(loud):
            return
        self.sounding += len(loud)
        for what, since, within in self._causes():
            if loud[-1] > since + within:
                self.wrong.append(
                    f"{self.name}: {peak:.2f} V at {loud[-1]:.4f}, {what} was at {since:.4f}"
                )
            elif loud[-1] > since and within != ORPHANED:
                kind = what.partition(" ")[0]
                self.worst[kind] = max(self.worst[kind], float(loud[-1] - since))

    def _causes(self) -> Iterator[tuple[str, float, float]]:
        """Yield what leads to 0 V, when it came [s], and within which time it does [s]."""
        undisturbed = self.stopped > self.disturbed and "loss" not in self.device
        yield "e-stop", self.stopped, STOPPED if undisturbed else SILENT
        for who, since in self.deaths.items():
            orphaned = "program" in who and self.moved > since
            yield f"death of {who}", since, ORPHANED if orphaned else SILENT
