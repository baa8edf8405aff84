"""What a process asks of the system, so that it is never late; what it did not get it says."""

import ctypes
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

PRIORITY = 10
"""Of SCHED_FIFO: above all that is ordinary, below the kernel's own threads (50)."""
CURRENT, FUTURE = 1, 2
"""Of mlockall."""
SWITCH = 2e-4
"""s after which a thread of Python's has to let another have its turn; 5 ms by default."""


def shorten_collections() -> None:
    """Have Python's garbage collector look no more at the objects that there are now.

    Else each full collection goes through all that was ever imported, and all threads stand still
    for some 50 to 90 ms.
    """
    gc.collect()
    gc.freeze()


def prepare() -> tuple[str, ...]:
    """Ask for all of it, for the threads there are and will be; return what was not granted.

    Memory is collected no more by itself, priority is real-time, memory is locked.
    """
    sys.setswitchinterval(SWITCH)
    shorten_collections()
    gc.disable()
    refused = []
    if not urge():
        refused.append("no real-time priority: allow it by LimitRTPRIO=20, or rtprio 20")
    if not _lock():
        refused.append("memory not locked: allow it by LimitMEMLOCK=infinity, or memlock unlimited")
    return tuple(refused)


def urge() -> bool:
    """Give real-time priority to all threads of this process; tell whether that is allowed."""
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
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return bool(libc.mlockall(CURRENT | FUTURE) == 0)
    except (OSError, AttributeError, TypeError):
        return False
