"""Processes that do nothing but wake for each block, in real time: what the machine allows.

One on each processor runs beside what is measured, on the same deadlines and above its priority. A
block that is sent a lead ahead of its time is lost to anybody who wakes later than that, however
little there is to do; so what the metronome misses is not the stream's to answer for. The file is
run by itself, so that nothing but the standard library is loaded.
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
"""s of a block of 16 samples at 8 kHz."""
STEP = 1e-4
"""s of lateness that are counted as one."""
MOST = 0xFFFF
"""Steps that are told at most."""
PRIORITY = 6
"""Real-time, one above that of a stream."""


@contextmanager
def beating() -> Iterator[list[int]]:
    """Wake for each block meanwhile; what is yielded tells at the end how late each was [STEP].

    It is that of the processor which was latest. The priority is real-time where that is allowed.
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
        told = [array("H", process.communicate()[0]) for process in processes]
        late += map(max, zip(*told, strict=False))


def processors() -> list[str]:
    """Return the numbers of those that this process may run on; "" where nobody tells."""
    if hasattr(os, "sched_getaffinity"):
        return [str(number) for number in sorted(os.sched_getaffinity(0))]
    return [""]


def beat(begin: float) -> "array[int]":
    """Wake for each block until standard input ends; return by how many `STEP` each was late.

    Blocks that passed before all was loaded were not late.
    """
    passed = max(int((time.monotonic() - begin) / PERIOD), 0)
    late = array("H", [0] * passed)
    while not select.select([sys.stdin], [], [], 0)[0]:
        due = begin + PERIOD * (len(late) + 1)
        time.sleep(max(due - time.monotonic(), 0.0))
        late.append(min(max(round((time.monotonic() - due) / STEP), 0), MOST))
    return late


def own(processor: str) -> None:
    """Keep to a processor, and come first there, where that is allowed."""
    with suppress(OSError, AttributeError):
        if processor:
            os.sched_setaffinity(0, {int(processor)})
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))


if __name__ == "__main__":
    own(sys.argv[2])
    sys.stdout.buffer.write(beat(float(sys.argv[1])).tobytes())
