"""Time to 0 V and to high voltage off after something dies, hangs or runs out during playback.

In each try a program plays a stroke, a waveform or a long effect through a server to the C
amplifier on a pty, with the display worn and not worn. Then something happens to the program, the
server, playback, the link, the disk or the descriptors. Times are those of the amplifier's record.
"""

import os
import random
import signal
import socket
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count, product
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from benchmarks.app import SOUNDS, start_app
from benchmarks.server import (
    PATIENCE,
    POLL,
    AmplifierOutput,
    OutputRecorder,
    ServerProcess,
    amplifier_and_folder,
    joined,
    last_after,
    send_signal,
)
from benchmarks.virtual import beside_amplifier
from tactile.bench.figures import Figure, at_most

if sys.platform == "linux":
    import resource

SHORT, LONG = 2, 200
"""Number of tries of each fault."""
SILENT_WITHIN, OFF_WITHIN = 0.3, 1.0
"""Largest permitted times from a fault to 0 V and to high voltage off [s]."""
WATCHED = 1.2
"""Longest time after a fault that is watched [s]."""
CALM = 0.15
"""Time at 0 V without high voltage after which there is nothing more to watch [s]."""
PLAYING = 0.1
"""Time for which something must have played before a fault [s]."""
ATTEMPTS = 5
"""Number of attempts to make something play."""
SPARE, CONNECTIONS = 4, 64
"""Number of descriptors left to a server, and of connections that use them up."""
SEED = 14
"""Seed of the order of tries and of the waits."""


@dataclass(frozen=True)
class FaultScene:
    """Target of a fault: an app that plays through a server over a link (a descriptor)."""

    server: ServerProcess
    app: BaseProcess
    playback: int
    link: int

    @property
    def app_pid(self) -> int:
        """Identifier of the app's process."""
        assert self.app.pid is not None
        return self.app.pid


Fault = Callable[[FaultScene], AbstractContextManager[float]]
"""Fault in a scene: a context manager that yields the time of the fault [s] and ends it."""


@contextmanager
def _signaled(pid: int, number: signal.Signals) -> Iterator[float]:
    """Send a signal to a process, and continue it at the end."""
    moment = time.monotonic()
    send_signal(pid, number)
    try:
        yield moment
    finally:
        send_signal(pid, signal.SIGCONT)


@contextmanager
def _link_lost(scene: FaultScene) -> Iterator[float]:
    """Keep everything that the host sends from the amplifier."""
    moment = time.monotonic()
    termios.tcflow(scene.link, termios.TCOOFF)
    try:
        yield moment
    finally:
        termios.tcflow(scene.link, termios.TCOON)


@contextmanager
def _descriptors_exhausted(scene: FaultScene) -> Iterator[float]:
    """Leave no descriptor to the server, then kill the app."""
    pid, folder = scene.server.pid, Path(f"/proc/{scene.server.pid}/fd")
    before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    limit = max(int(fd.name) for fd in folder.iterdir()) + 1 + SPARE
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (limit, before[1]))
    try:
        with ExitStack() as stack:
            for _ in range(CONNECTIONS):
                link = stack.enter_context(socket.socket())
                link.setblocking(False)
                link.connect_ex(("127.0.0.1", scene.server.port))
            time.sleep(5 * POLL)
            with _signaled(scene.app_pid, signal.SIGKILL) as moment:
                yield moment
    finally:
        resource.prlimit(pid, resource.RLIMIT_NOFILE, before)


FAULTS: dict[str, Fault] = {
    "app_killed": lambda scene: _signaled(scene.app_pid, signal.SIGKILL),
    "app_stopped": lambda scene: _signaled(scene.app_pid, signal.SIGSTOP),
    "server_killed": lambda scene: _signaled(scene.server.pid, signal.SIGKILL),
    "server_stopped": lambda scene: _signaled(scene.server.pid, signal.SIGSTOP),
    "playback_killed": lambda scene: _signaled(scene.playback, signal.SIGKILL),
    "playback_stopped": lambda scene: _signaled(scene.playback, signal.SIGSTOP),
    "link_lost": _link_lost,
    "descriptors": _descriptors_exhausted,
}
"""Faults by name."""
FULL_DISK: dict[str, Fault] = {"disk_full": FAULTS["app_killed"]}
"""Fault of a server whose log's disk is full all the time."""


@dataclass
class Outcomes:
    """Outcomes of the tries of one fault: times to 0 V and to high voltage off [s]."""

    silent: list[float] = field(default_factory=list)
    off: list[float] = field(default_factory=list)

    def add(self, output: AmplifierOutput, moment: float) -> bool:
        """Add the output around a fault; return whether all was off in time."""
        self.silent.append(last_after(output.times, output.is_loud, moment))
        self.off.append(last_after(output.times, output.high_voltage, moment))
        return self.silent[-1] <= SILENT_WITHIN and self.off[-1] <= OFF_WITHIN

    def failures(self) -> int:
        """Return the number of tries in which something was on for too long."""
        silent, off = np.array(self.silent), np.array(self.off)
        return int(np.sum((silent > SILENT_WITHIN) | (off > OFF_WITHIN)))

    def figures(self, name: str) -> Iterator[Figure]:
        """Yield the figures of a fault."""
        yield Figure(f"{name}.tries", float(len(self.silent)), "")
        yield at_most(f"{name}.failures", float(self.failures()), "", 0)
        for part, times, limit in (
            ("silent", self.silent, SILENT_WITHIN),
            ("off", self.off, OFF_WITHIN),
        ):
            yield Figure(f"{name}.{part}.p99", float(np.percentile(times, 99)), "s")
            yield at_most(f"{name}.{part}.worst", max(times), "s", limit)


def plays(output: AmplifierOutput) -> bool:
    """Return whether something plays, by the latest output."""
    if not len(output.times) or output.times[-1] - output.times[0] < PLAYING:
        return False
    last = output.since(output.times[-1] - PLAYING)
    return bool(last.is_loud.mean() > 0.5 and last.high_voltage.all())


def is_over(output: AmplifierOutput, moment: float) -> bool:
    """Return whether all has been off for a while, and long enough after a fault."""
    if not len(output.times) or output.times[-1] < moment + SILENT_WITHIN + CALM:
        return False
    last = output.since(output.times[-1] - CALM)
    return not (last.is_loud | last.high_voltage).any()


class Tries:
    """Tries of faults with one server, which is started again if it died.

    Parameters
    ----------
    server : ServerProcess
        Server that plays.
    recorder : OutputRecorder
        Recorder of its amplifier.
    link : int
        Descriptor of the amplifier's pty, at the host's end.
    """

    def __init__(self, server: ServerProcess, recorder: OutputRecorder, link: int) -> None:
        self._server, self._recorder, self._link = server, recorder, link

    def carry_out(self, sound: str, fault: Fault, outcomes: Outcomes, wait: float) -> None:
        """Play a sound, wait [s], cause a fault, and add its outcome."""
        self._server.restart()
        app = self._playing(sound)
        try:
            scene = FaultScene(self._server, app, self._server.playback(), self._link)
            time.sleep(wait)
            before = self._recorder.read()
            with fault(scene) as moment:
                output = joined([before, self._watch(moment)])
        finally:
            app.kill()
            app.join()
        if not outcomes.add(output, moment):
            self._server.close()  # Its remains would spoil the next try.

    def _playing(self, sound: str) -> BaseProcess:
        """Return an app that plays."""
        for _ in range(ATTEMPTS):
            app = start_app(self._server.url, sound)
            self._recorder.read()
            with suppress(TimeoutError):
                output = self._recorder.read_until(
                    lambda output, app=app: plays(output) or not app.is_alive(),  # type: ignore[misc]
                    sound, span=5 * PLAYING,
                )  # fmt: skip
                if plays(output):
                    return app
            # An app that ended met playback while that was started again.
            if app.is_alive():
                self._server.close()
                self._server.start()
            app.kill()
            app.join()
        raise TimeoutError(f"a {sound} did not play in {ATTEMPTS} attempts of {PATIENCE:g} s")

    def _watch(self, moment: float) -> AmplifierOutput:
        """Return the output until all is off, or for as long as is watched."""
        return self._recorder.read_until(
            lambda output: is_over(output, moment) or output.reaches(moment + WATCHED),
            "the amplifier's record",
        )


def schedule(faults: list[str], tries: range, rng: random.Random) -> list[tuple[str, str]]:
    """Return pairs of sound and fault in random order: each fault with all sounds in turn.

    Parameters
    ----------
    faults : list of str
        Names of the faults.
    tries : range
        Numbers of the tries of each fault.
    rng : random.Random
        Source of the order.
    """
    sounds = list(SOUNDS)
    pairs = [
        (sounds[(k + shift) % len(sounds)], fault)
        for shift, fault in enumerate(faults)
        for k in tries
    ]
    rng.shuffle(pairs)
    return pairs


def measure_deaths(tries: int = SHORT) -> Iterator[Figure]:
    """Measure how soon all is off after each fault."""
    name = "deaths-long" if tries == LONG else "deaths"
    yield from beside_amplifier(name, _measured(name, tries))


def _measured(name: str, tries: int) -> Iterator[Figure]:
    outcomes = {fault: Outcomes() for fault in FAULTS | FULL_DISK}
    rng, done = random.Random(SEED), count(1)
    for (log, faults), worn in product((("log", FAULTS), ("/dev/full", FULL_DISK)), (True, False)):
        share = range(tries)[: tries // 2] if worn else range(tries)[tries // 2 :]
        with _tries(worn=worn, log=log) as (runner, recorder):
            for sound, fault in schedule(list(faults), share, rng):
                runner.carry_out(sound, faults[fault], outcomes[fault], rng.uniform(0, 2 * PLAYING))
                _print_progress(name, next(done), tries * len(outcomes))
        yield from recorder.figures(f"{name}.{'worn' if worn else 'not_worn'}.{Path(log).name}")
    for fault, outcome in outcomes.items():
        yield from outcome.figures(f"{name}.{fault}")


@contextmanager
def _tries(*, worn: bool, log: str) -> Iterator[tuple[Tries, OutputRecorder]]:
    """Yield tries with their own server."""
    with amplifier_and_folder() as (amplifier, folder):
        link = os.open(amplifier.path, os.O_RDWR | os.O_NOCTTY)
        try:
            recorder = OutputRecorder(amplifier)
            with closing(ServerProcess(folder, amplifier.path, worn=worn, log=log)) as server:
                yield Tries(server, recorder, link), recorder
        finally:
            os.close(link)


def _print_progress(name: str, done: int, of: int) -> None:
    """Print the progress on a terminal."""
    if sys.stderr.isatty():
        print(f"\r{name}: {done} of {of}", end="" if done < of else "\n", file=sys.stderr)
