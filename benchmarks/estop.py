"""Time from an e-stop to its answer and to 0 V under different loads, by the amplifier's clock.

An effect plays through a server, in its own process, to the C amplifier on a pty. An e-stop is sent
over a WebSocket of the SDK that was already connected, or as `tactile estop` does. After each
e-stop arming must be refused until the e-stop is cleared by its number. The same is measured for
`tactile play`, which drives the amplifier without a server.
"""

import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.app import TEXTURE, begin_effect
from benchmarks.deaths import PLAYING, plays
from benchmarks.floods import (
    Load,
    flood_osc,
    loaded,
    open_connections,
    send_messages,
    touch_together,
)
from benchmarks.server import (
    NAME,
    PATIENCE,
    POLL,
    AmplifierOutput,
    OutputRecorder,
    ServerProcess,
    amplifier_and_folder,
    clear,
    connected,
    last_after,
    send_signal,
    wait_for,
)
from benchmarks.virtual import beside_amplifier
from tactile.bench.figures import Figure, at_most
from tactile.client import RemoteDisplay
from tactile.display.display import load_display
from tactile.errors import ClientError, RequestError
from tactile.estop.request import request_estop
from tactile.playback.estop_guard import clear_device

SHORT, LONG = 10, 200
"""Number of tries of each way under each load."""
PLAYS = 100
"""Number of tries with `tactile play`."""
P99, WORST = 50.0, 100.0
"""Limits of the time to the answer and to 0 V [ms]."""
WATCHED = 0.3
"""Time after an e-stop that is watched [s]."""
WAIT = 0.2
"""Least time that a load lasts before an e-stop [s]."""
TRY = 8.0
"""Longest time that a load lasts for each try [s]."""
CLIENTS = 50
"""Number of apps that touch together."""
MESSAGES, SENDERS = 100_000, 4
"""Rate of messages [1/s], and number of processes that send them."""
CONNECTIONS, PACKETS = 5000, 20_000
"""Rates of TCP connections and of OSC packets [1/s]."""
NO_LIMIT = "messages_per_second = 100000"
"""Line of the server's configuration by which a flood reaches it."""
SEED = 14
"""Seed of the waits before e-stops."""


@dataclass
class Times:
    """Times to the answer and to 0 V, of one way under one load [s], and the failures.

    Attributes
    ----------
    answered : list of float
        Times to the answer [s].
    silent : list of float
        Times to 0 V [s].
    unanswered : int
        Number of e-stops that were refused or not answered.
    forgotten : int
        Number of e-stops after which the display could be armed.
    """

    answered: list[float] = field(default_factory=list)
    silent: list[float] = field(default_factory=list)
    unanswered: int = 0
    forgotten: int = 0

    def figures(self, name: str) -> Iterator[Figure]:
        """Yield the figures."""
        yield Figure(f"{name}.tries", float(len(self.silent)), "")
        yield at_most(f"{name}.unanswered", float(self.unanswered), "", 0)
        yield at_most(f"{name}.forgotten", float(self.forgotten), "", 0)
        for part, times in (("answered", self.answered), ("silent", self.silent)):
            late = 1e3 * np.array(times or [np.nan])
            yield Figure(f"{name}.{part}.p50", float(np.percentile(late, 50)), "ms")
            yield at_most(f"{name}.{part}.p99", float(np.percentile(late, 99)), "ms", P99)
            yield at_most(f"{name}.{part}.worst", float(late.max()), "ms", WORST)


@dataclass(frozen=True)
class EstopRig:
    """A server, its amplifier's recorder, and a program that is connected to it."""

    server: ServerProcess
    recorder: OutputRecorder
    display: RemoteDisplay
    osc_port: int
    load: Load | None = None


def _stop_by_command(name: str) -> bool:
    """Do what `tactile estop` does, and return whether an e-stop was latched.

    Parameters
    ----------
    name : str
        Name of the display, or URL of the device.
    """
    return any(answer.estops for answer in request_estop(name))


def _over_socket(rig: EstopRig) -> bool:
    try:
        rig.display.estop(timeout=PATIENCE)
    except ClientError:
        return False
    return True


def _as_command(rig: EstopRig) -> bool:
    return _stop_by_command(NAME)


WAYS: dict[str, Callable[[EstopRig], bool]] = {"websocket": _over_socket, "command": _as_command}
"""Ways to send an e-stop, by name."""


@contextmanager
def _server_stopped(rig: EstopRig) -> Iterator[None]:
    send_signal(rig.server.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        send_signal(rig.server.pid, signal.SIGCONT)


@contextmanager
def _playback_restarting(rig: EstopRig) -> Iterator[None]:
    """Kill playback, and continue when the amplifier has noticed."""
    send_signal(rig.server.playback(), signal.SIGKILL)
    wait_for("0 V", lambda: is_silent(rig.recorder.read()))
    yield


def is_silent(output: AmplifierOutput) -> bool:
    """Return whether the last instants of the amplifier's record are at 0 V."""
    return len(output.times) > 0 and not output.is_loud[-20:].any()


@dataclass(frozen=True)
class Condition:
    """A condition under which an e-stop is sent.

    Attributes
    ----------
    ways : tuple of str
        Keys of `WAYS` that are available.
    load : callable
        Load that begins some time before each e-stop; it takes the rig and its longest duration
        [s].
    at_once : callable
        Fault that lasts in each try from just before the e-stop until all is recorded.
    """

    ways: tuple[str, ...] = tuple(WAYS)
    load: Callable[[EstopRig, float], AbstractContextManager[Load | None]] = lambda rig, s: (
        nullcontext()
    )
    at_once: Callable[[EstopRig], AbstractContextManager[None]] = lambda rig: nullcontext()


CONDITIONS: dict[str, Condition] = {
    "idle": Condition(),
    "clients": Condition(load=lambda rig, s: loaded(touch_together, rig.server.url, CLIENTS, s)),
    "messages": Condition(
        load=lambda rig, s: loaded(
            send_messages, rig.server.port, MESSAGES / SENDERS, s, processes=SENDERS
        )
    ),
    "connections": Condition(
        load=lambda rig, s: loaded(open_connections, rig.server.port, CONNECTIONS, s)
    ),
    "osc": Condition(load=lambda rig, s: loaded(flood_osc, rig.osc_port, PACKETS, s)),
    "playback_restarting": Condition(at_once=_playback_restarting),
    "server_stopped": Condition(ways=("command",), at_once=_server_stopped),
}
"""Conditions by name."""


def carry_out(rig: EstopRig, way: str, condition: Condition, times: Times, wait: float) -> None:
    """Send an e-stop while an effect plays, add its times, and clear it by its number.

    Parameters
    ----------
    rig : EstopRig
        Rig that plays.
    way : str
        Key of `WAYS`.
    condition : Condition
        Condition during the e-stop.
    times : Times
        Times to add to.
    wait : float
        Time for which the load lasts before the e-stop [s].
    """
    _play(rig)
    with rig.load.on() if rig.load else nullcontext():
        time.sleep(wait)
        with condition.at_once(rig):
            _stop(times, rig.recorder, lambda: WAYS[way](rig))
    times.forgotten += not is_refused(rig.display)
    wait_for("no e-stop", lambda: clear(rig.display))


def _stop(times: Times, recorder: OutputRecorder, request: Callable[[], bool]) -> None:
    """Send an e-stop by a function that returns whether it was answered, and add its times."""
    sent = time.monotonic()
    if request():
        times.answered.append(time.monotonic() - sent)
    else:
        times.unanswered += 1
    output = recorder.read_until(lambda o: o.reaches(sent + WATCHED), "the amplifier's record")
    times.silent.append(last_after(output.times, output.is_loud, sent))


def _play(rig: EstopRig) -> None:
    """Arm, and make an effect play."""

    def does_play(output: AmplifierOutput) -> bool:
        if plays(output):
            return True
        rig.display.arm(timeout=PATIENCE)
        begin_effect(rig.display)
        time.sleep(2 * PLAYING)
        return False

    rig.recorder.read_until(does_play, "an effect", span=5 * PLAYING)


def is_refused(display: RemoteDisplay) -> bool:
    """Return whether an e-stop refuses to arm; playback may have to be started for the answer."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            display.arm(timeout=PATIENCE)
        except ClientError as error:  # A client that has lost its connection connects again.
            if isinstance(error, RequestError) and error.code == "estopped":
                return True
        else:
            return False
        time.sleep(POLL)
    return False


def measure_estop(tries: int = SHORT) -> Iterator[Figure]:
    """Measure a number of e-stops of each way in each condition."""
    name = "estop-long" if tries == LONG else "estop"
    yield from beside_amplifier(name, _measured(name, tries))


def _measured(name: str, tries: int) -> Iterator[Figure]:
    rng = random.Random(SEED)
    for kind, condition in CONDITIONS.items():
        with _rig() as rig, condition.load(rig, tries * len(WAYS) * TRY) as load:
            rig = replace(rig, load=load)
            for way in condition.ways:
                times = Times()
                for _ in range(tries):
                    carry_out(rig, way, condition, times, rng.uniform(WAIT, 2 * WAIT))
                yield from times.figures(f"{name}.{kind}.{way}")
            if load is not None:
                yield Figure(f"{name}.{kind}.rate", load.rate(), "1/s")
            yield from rig.recorder.figures(f"{name}.{kind}")


def measure_estop_play() -> Iterator[Figure]:
    """Measure e-stops of `tactile play`, which must then refuse to play again."""
    yield from beside_amplifier("estop-play", _measured_play("estop-play", PLAYS))


def _measured_play(name: str, tries: int) -> Iterator[Figure]:
    times, display = Times(), load_display("reference-24")
    with amplifier_and_folder() as (amplifier, _):
        recorder, device = OutputRecorder(amplifier), f"serial://{amplifier.path}"
        words = [sys.executable, "-m", "tactile", "play", TEXTURE, "--quiet", "--device", device]
        for _ in range(tries):
            player = subprocess.Popen([*words, "--seconds", "3600"], stderr=subprocess.DEVNULL)
            try:
                wait_for("a texture", lambda: plays(_latest(recorder)))
                _stop(times, recorder, lambda: _stop_by_command(device))
            finally:
                player.kill()
                player.wait()
            second = subprocess.run([*words, "--seconds", "0.1"], stderr=subprocess.DEVNULL)
            times.forgotten += second.returncode == 0
            clear_device(device, display, lambda number, _: number, accept_unsafe_hold=False)
        yield from times.figures(name)
        yield from recorder.figures(name)


def _latest(recorder: OutputRecorder) -> AmplifierOutput:
    """Return the amplifier's output from now on, for as long as `plays` needs."""
    recorder.read()
    time.sleep(2 * PLAYING)
    return recorder.read()


@contextmanager
def _rig() -> Iterator[EstopRig]:
    """Yield a server, and a program that is connected to it."""
    with ExitStack() as stack:
        amplifier, folder = stack.enter_context(amplifier_and_folder())
        port = free_udp_port()
        server = ServerProcess(folder, amplifier.path, osc=port, server=NO_LIMIT)
        stack.enter_context(closing(server))
        display = stack.enter_context(connected(server))
        yield EstopRig(server, OutputRecorder(amplifier), display, port)


def free_udp_port() -> int:
    """Return a UDP port that is not in use."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])
