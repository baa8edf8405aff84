"""Displays to bring up, and the C amplifier on a pseudo-terminal, with loads on its channels.

Its record of every instant tells what it put out.
"""

import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bringup.bringup import CheckReport
from tactile.bus.base import Bus
from tactile.display.display import Display

CHANNELS = 5
PF = (12800, 0, 99, 22000, 12000)
"""Capacitances of the channels [pF]; 99 stands for a short."""
LOADS = ",".join("short" if pf == 99 else str(pf) for pf in PF)
RATE = 8000.0
CODE = 100 / 32767
"""Voltage of one sample code [V]."""

FOUR = """\
# Four contactors in a row, and a gap in the channels
[display]
id = "four"
description = "A # that is none, and [grid] in a text"
opening_mm = [2.0, 3.0]   # along and across

# how they stand
[[contactor]]
position_mm = [0.0, 0.0]
channel = 0
[[contactor]]
# the second one
position_mm = [3.1, 0]
channel = 1
polarity = -1            # glued the other way round
shear_direction_deg = 30.0
[[contactor]]
position_mm = [6.2, 0.0]
channel = 3

[finger]                  # [[contactor]] is over
preset = "low"
[[contactor]]
position_mm = [9.3, 0.0]
channel = 4
# of the limits
[limits]
voltage_v = 100.0
"""
GRID = """\
# Rows of three
[display]
id = "six"
description = "Two rows of three"
opening_mm = [2.0, 3.0]

# the comment above
[grid]       # of the header
columns = 3  # along x
rows = 2
pitch_mm = [2.9, 3.7]   # 0.9 mm apart
polarity = -1
first_channel = 2

# the finger's own
[finger]
preset = "none"
[limits]
voltage_v = 60.0
"""


def verdicts(report: CheckReport) -> list[str]:
    return [one.verdict for one in report.channels]


@dataclass
class Served:
    """A virtual amplifier on a pseudo-terminal."""

    url: str
    out: Path

    def rows(self) -> tuple[NDArray[np.int64], Floats]:
        """Return states, high voltage (S, 2), and volts (S, C), up to some moment after now."""
        size = struct.calcsize(f"<QIBB{CHANNELS}h")
        before = self.out.stat().st_size
        end = time.monotonic() + 60
        while self.out.stat().st_size < before + 2 * 20 * 8 * size:  # two flushes
            assert time.monotonic() < end, "nothing is put out any more"
            time.sleep(0.01)
        data = self.out.read_bytes()
        kind = np.dtype(
            [("tick", "<u8"), ("at", "<u4"), ("now", "u1", 2), ("codes", "<i2", CHANNELS)]
        )
        rows = np.frombuffer(data[: len(data) // size * size], kind)
        return rows["now"].astype(np.int64), rows["codes"].astype(np.float64) * CODE


@contextmanager
def serving(program: Path, out: Path) -> Iterator[Callable[..., Served]]:
    """Give what starts amplifiers with options, and end them."""
    processes = []

    def start(*options: str) -> Served:
        process = subprocess.Popen(
            [program, "--pty", "--channels", str(CHANNELS), "--out", out, *options],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        processes.append(process)
        assert process.stdout is not None
        return Served(f"serial://{process.stdout.readline().strip()}", out)

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def check_drive(volts: Floats, *, most: float = 5.0) -> None:
    """See that no more than one channel is driven at a time, within a limit [V].

    Of 5 V, where nothing else is said: a twentieth of full drive, which harms no bimorph.
    """
    assert np.abs(volts).max() <= most
    assert np.count_nonzero(volts, axis=1).max() == 1


def put_out(bus: Bus) -> Floats:
    return cast(Any, bus).output  # type: ignore[no-any-return]


def same(a: Display, b: Display) -> None:
    """See that two displays have the same arrays, bit by bit, and all else."""
    for name in ("contactors", "shear_direction", "polarity", "channel", "kind"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    names = ("name", "opening", "projected", "bimorph", "load", "amplifier", "limits")
    assert [getattr(a, n) for n in names] == [getattr(b, n) for n in names]
    assert len(a.measured) == len(b.measured)
