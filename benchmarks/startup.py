"""Time that the command line takes before it does anything."""

import os
import subprocess
import sys
from collections.abc import Iterator

from tactile.bench.figures import Figure, at_most

REPEATS = 9
"""Number of runs, of which the quickest counts: the others wait for the machine."""


def processor_time(*arguments: str) -> float:
    """Return the processor time of the command ``tactile``, user and system, the best of several.

    Parameters
    ----------
    arguments : str
        Arguments of the command.

    Returns
    -------
    float
        Time [s].
    """
    times = []
    for _ in range(REPEATS):
        command = [sys.executable, "-m", "tactile", *arguments]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0  # it has been waited for
        times.append(usage.ru_utime + usage.ru_stime)
    return min(times)


def measure_startup() -> Iterator[Figure]:
    """Measure the start of the command line: its help, an e-stop, the list of textures."""
    yield at_most("startup.help", processor_time("--help"), "s", 0.35)
    yield Figure("startup.estop", processor_time("estop"), "s")
    yield Figure("startup.textures", processor_time("textures"), "s")
