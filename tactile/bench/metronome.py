"""A process that does nothing but wake for each block, in real time: what the machine allows.

It runs beside what is measured, on the same deadlines and above its priority. A block that is sent
a lead ahead of its time is lost to anybody who wakes later than that, however little there is to
do; so what the metronome misses is not the stream's to answer for. The file is run by itself, so
that nothing but the standard library is loaded.
"""

import json
import os
import select
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PERIOD = 2e-3
"""s of a block of 16 samples at 8 kHz."""
STEP = 1e-4
"""s of lateness that are counted as one."""
PRIORITY = 6
"""Real-time, one above that of a stream."""


@contextmanager
def beating() -> Iterator[Counter[int]]:
    """Wake for each block meanwhile; at the end what is yielded counts by how many `STEP` late.

    The priority is real-time where that is allowed.
    """
    late = Counter[int]()
    process = subprocess.Popen(
        [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        yield late
    finally:
        told = json.loads(process.communicate()[0])
    late.update({int(steps): count for steps, count in told.items()})


def beat() -> Counter[int]:
    """Wake for each block until standard input ends; count by how many `STEP` each was late."""
    late = Counter[int]()
    due = time.monotonic()
    while not select.select([sys.stdin], [], [], 0)[0]:
        due += PERIOD
        time.sleep(max(due - time.monotonic(), 0.0))
        late[max(round((time.monotonic() - due) / STEP), 0)] += 1
    return late


if __name__ == "__main__":
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    json.dump(beat(), sys.stdout)
