"""Real-time privileges of a process, so that it is never late; refusals are reported."""

import ctypes
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

PRIORITY = 10
"""Priority under SCHED_FIFO: above all ordinary threads, below the kernel's own (50)."""
CURRENT, FUTURE = 1, 2
"""Flags MCL_CURRENT and MCL_FUTURE of mlockall."""
SWITCH = 2e-4
"""Interval after which a Python thread has to yield to another [s]; 5 ms by default."""


def shorten_collections() -> None:
    """Exempt all present objects from Python's garbage collector.

    Otherwise each full collection visits everything that was ever imported, and all threads stop
    for some 50 to 90 ms.
    """
    gc.collect()
    gc.freeze()


def prepare() -> tuple[str, ...]:
    """Request real-time privileges for all present and future threads.

    Automatic garbage collection is switched off, the priority is made real-time, and memory is
    locked.

    Returns
    -------
    tuple of str
        One line for each privilege that was refused, with its remedy.
    """
    sys.setswitchinterval(SWITCH)
    shorten_collections()
    gc.disable()
    refused = []
    if not raise_priority():
        refused.append("no real-time priority: allow it by LimitRTPRIO=20, or rtprio 20")
    if not _lock():
        refused.append("memory not locked: allow it by LimitMEMLOCK=infinity, or memlock unlimited")
    return tuple(refused)


def raise_priority() -> bool:
    """Give real-time priority to all threads of this process.

    Returns
    -------
    bool
        Whether the system allows it.
    """
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        for thread in Path("/proc/self/task").iterdir():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def _lock() -> bool:
    """Lock all memory of the process; return whether the system allows it."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return bool(libc.mlockall(CURRENT | FUTURE) == 0)
    except (OSError, AttributeError, TypeError):
        return False
