"""Common tools of the checks inside a guest."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can

WAIT = 60.0
"""Seconds to wait at most for what should happen soon; a guest is slow."""


def command(*words: str) -> str:
    """Run a command that succeeds, and return its output."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr}"
    return done.stdout


def wait_for(what: str, happens: Callable[[], bool], every: float = 0.05) -> None:
    """Return as soon as something happens, for which is looked every so many seconds."""
    deadline = time.monotonic() + WAIT
    while not happens():
        assert time.monotonic() < deadline, f"{what}: not after {WAIT} s"
        time.sleep(every)


@contextmanager
def refused(*codes: int) -> Iterator[None]:
    """Expect an OSError with one of some codes."""
    try:
        yield
    except OSError as error:
        if error.errno not in codes:
            raise
    else:
        raise AssertionError("no error")


def received(bus: can.BusABC) -> can.Message:
    """Return the next frame of a bus."""
    message = bus.recv(WAIT)
    assert message is not None, f"nothing came for {WAIT} s"
    return message


@contextmanager
def virtual_amplifier(*options: str) -> Iterator["subprocess.Popen[str]"]:
    """Run the amplifier in C, built on the host; its output is a pipe."""
    words = [os.environ["TACTILE_VIRTUAL_AMPLIFIER"], *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()
