"""Processes that only wake for each block in real time, which shows what the host is capable of.

One process on each processor runs beside the measurement, on the same deadlines and above its
priority. A block that is sent a lead time ahead is lost to any program that wakes later than that,
however little it has to do, so that what the metronome misses cannot be blamed on the stream. The
file is run by itself, so that nothing but the standard library is loaded.
"""

import os
import select
import subprocess
import sys
import time
from array import array
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PERIOD = 2e-3
"""Duration of a block of 16 samples at 8 kHz [s]."""
STEP = 1e-4
"""Resolution of the lateness [s]."""
MOST = 0xFFFF
"""Largest lateness that is recorded [STEP]."""
PRIORITY = 6
"""Real-time priority, one above that of a stream."""


@contextmanager
def beating() -> Iterator[list[int]]:
    """Run the metronome during a block of code.

    Each block gets the lateness on the processor that was latest. The priority is real-time where
    that is allowed.

    Yields
    ------
    list of int
        Lateness of each block, filled in when the context ends [STEP].
    """
    late: list[int] = []
    begin = str(time.monotonic())
    processes = [
        subprocess.Popen(
            [sys.executable, __file__, begin, processor],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for processor in processors()
    ]
    try:
        yield late
    finally:
        recordings = [array("H", process.communicate()[0]) for process in processes]
        late += map(max, zip(*recordings, strict=False))


def processors() -> list[str]:
    """List the processors on which this process may run.

    Returns
    -------
    list of str
        Numbers of the processors; a single empty string where the system does not provide them.
    """
    if hasattr(os, "sched_getaffinity"):
        return [str(number) for number in sorted(os.sched_getaffinity(0))]
    return [""]


def beat(begin: float) -> "array[int]":
    """Wake for each block until standard input ends.

    Blocks that passed before the process had started count as punctual.

    Parameters
    ----------
    begin : float
        Time of the first block by the monotonic clock, less one period [s].

    Returns
    -------
    array of int
        Lateness of each block [STEP].
    """
    passed = max(int((time.monotonic() - begin) / PERIOD), 0)
    late = array("H", [0] * passed)
    while not select.select([sys.stdin], [], [], 0)[0]:
        due = begin + PERIOD * (len(late) + 1)
        time.sleep(max(due - time.monotonic(), 0.0))
        late.append(min(max(round((time.monotonic() - due) / STEP), 0), MOST))
    return late


def own(processor: str) -> None:
    """Pin this process to a processor and raise it to real-time priority, where that is allowed.

    Parameters
    ----------
    processor : str
        Number of the processor; empty for no pinning.
    """
    with suppress(OSError, AttributeError):
        if processor:
            os.sched_setaffinity(0, {int(processor)})
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))


if __name__ == "__main__":
    own(sys.argv[2])
    sys.stdout.buffer.write(beat(float(sys.argv[1])).tobytes())
