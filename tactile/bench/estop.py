"""From an e-stop to its answer and to 0 V, whatever else goes on, by the amplifier's own clock.

An effect plays through a daemon, a process of its own, to the C amplifier on a pty. An e-stop is
sent over a WebSocket of the SDK that was there before, or as `tactile estop` does. After each one
arming must be refused until it is cleared by its number.
"""

import random
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace

import numpy as np

import tactile.client
from tactile.bench.app import begin_effect
from tactile.bench.daemon import (
    NAME,
    PATIENCE,
    POLL,
    Daemon,
    Output,
    Recorder,
    amplifier_and_folder,
    joined,
    last_after,
    send_signal,
    wait_for,
)
from tactile.bench.deaths import HEARD, plays
from tactile.bench.figures import Figure, at_most, beside_machine
from tactile.bench.floods import (
    Load,
    burdened,
    flood_osc,
    open_connections,
    send_messages,
    touch_together,
)
from tactile.bench.virtual import can_be_built
from tactile.client import Display
from tactile.daemon import messages as m
from tactile.daemon.estop_request import request_estop
from tactile.errors import ClientError, RequestError

SHORT, LONG = 10, 200
"""Tries of each way under each load."""
P99, WORST = 50.0, 100.0
"""ms to the answer and to 0 V."""
WATCHED = 0.3
"""s after an e-stop that are watched."""
WAIT = 0.2
"""s of a load before an e-stop, at least."""
TRY = 8.0
"""s that a load lasts for each try, at most."""
CLIENTS = 50
MESSAGES, SENDERS = 100_000, 4
"""Messages a second, and processes that send them."""
CONNECTIONS, PACKETS = 5000, 20_000
"""TCP connections and OSC packets a second."""
NO_LIMIT = "messages_per_second = 100000"
"""Of the server's configuration: a flood is to reach it."""
SEED = 14


@dataclass
class Times:
    """Of one way under one load: to the answer and to 0 V [s]; and what went wrong.

    Attributes
    ----------
    unanswered : e-stops that were refused or not answered
    forgotten : e-stops after which the display could be armed
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
class Rig:
    """A daemon, its amplifier's recorder, and a program that is connected to it."""

    daemon: Daemon
    recorder: Recorder
    display: Display
    osc_port: int
    load: Load | None = None


def _over_socket(rig: Rig) -> bool:
    try:
        rig.display.estop(timeout=PATIENCE)
    except ClientError:
        return False
    return True


def _as_command(rig: Rig) -> bool:
    return any(answer.estops for answer in request_estop(NAME))


WAYS: dict[str, Callable[[Rig], bool]] = {"websocket": _over_socket, "command": _as_command}


@contextmanager
def _server_stopped(rig: Rig) -> Iterator[None]:
    send_signal(rig.daemon.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        send_signal(rig.daemon.pid, signal.SIGCONT)


@contextmanager
def _playback_restarting(rig: Rig) -> Iterator[None]:
    """Kill playback, and go on when the amplifier has noticed."""
    send_signal(rig.daemon.playback(), signal.SIGKILL)
    wait_for("0 V", lambda: is_silent(rig.recorder.read()))
    yield


def is_silent(output: Output) -> bool:
    """Return whether nothing was put out in the last instants."""
    return len(output.times) > 0 and not output.is_loud[-20:].any()


@dataclass(frozen=True)
class Condition:
    """What goes on while an e-stop is sent.

    Attributes
    ----------
    ways : keys of `WAYS` that there are then
    load : let from a while before each e-stop on; gets the rig and for how long there is one [s]
    at_once : in each try from just before the e-stop until all is recorded
    """

    ways: tuple[str, ...] = tuple(WAYS)
    load: Callable[[Rig, float], AbstractContextManager[Load | None]] = lambda rig, s: nullcontext()
    at_once: Callable[[Rig], AbstractContextManager[None]] = lambda rig: nullcontext()


CONDITIONS: dict[str, Condition] = {
    "idle": Condition(),
    "clients": Condition(load=lambda rig, s: burdened(touch_together, rig.daemon.url, CLIENTS, s)),
    "messages": Condition(
        load=lambda rig, s: burdened(
            send_messages, rig.daemon.port, MESSAGES / SENDERS, s, processes=SENDERS
        )
    ),
    "connections": Condition(
        load=lambda rig, s: burdened(open_connections, rig.daemon.port, CONNECTIONS, s)
    ),
    "osc": Condition(load=lambda rig, s: burdened(flood_osc, rig.osc_port, PACKETS, s)),
    "playback_restarting": Condition(at_once=_playback_restarting),
    "server_stopped": Condition(ways=("command",), at_once=_server_stopped),
}


def carry_out(rig: Rig, way: str, condition: Condition, times: Times, wait: float) -> None:
    """Send an e-stop while an effect plays, add how long it took, and clear it by its number.

    Parameters
    ----------
    rig, way, condition : what plays, a key of `WAYS`, what goes on besides
    times : to which is added
    wait : how long that goes on before the e-stop [s]
    """
    _play(rig)
    with rig.load.on() if rig.load else nullcontext():
        time.sleep(wait)
        with condition.at_once(rig):
            sent = time.monotonic()
            if WAYS[way](rig):
                times.answered.append(time.monotonic() - sent)
            else:
                times.unanswered += 1
            output = _watched(rig.recorder, sent)
    times.silent.append(last_after(output.times, output.is_loud, sent))
    times.forgotten += not is_refused(rig.display)
    _clear(rig.display)


def _play(rig: Rig) -> None:
    """Arm, and have an effect play."""
    deadline = time.monotonic() + PATIENCE
    output = rig.recorder.read()
    while not plays(output):
        try:
            rig.display.arm(timeout=PATIENCE)
            begin_effect(rig.display)
        except ClientError:
            if time.monotonic() > deadline:
                raise
        time.sleep(2 * HEARD)
        output = joined([output, rig.recorder.read()]).since(time.monotonic() - 5 * HEARD)
        if time.monotonic() > deadline:
            raise TimeoutError(f"an effect did not play within {PATIENCE:g} s")


def _watched(recorder: Recorder, sent: float) -> Output:
    """Return what is put out from an e-stop on."""
    parts = [recorder.read()]

    def all_recorded() -> bool:
        parts.append(recorder.read())
        return any(len(part.times) and part.times[-1] > sent + WATCHED for part in parts)

    wait_for("the amplifier's record", all_recorded)
    return joined(parts)


def is_refused(display: Display) -> bool:
    """Return whether an e-stop refuses to arm; playback may have to be started for the answer."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            display.arm(timeout=PATIENCE)
        except RequestError as error:
            if error.code == "estopped":
                return True
        except ClientError:
            pass  # not connected: it connects again
        else:
            return False
        time.sleep(POLL)
    return False


def _clear(display: Display) -> None:
    """End the e-stop that holds."""
    ask, deadline = display.connection._ask, time.monotonic() + PATIENCE
    while True:
        try:
            estop = ask(m.GetStats(display=NAME), m.Stats, PATIENCE).estop
            if not estop:
                return
            ask(m.Clear(display=NAME, estop=estop), m.Done, PATIENCE)
        except ClientError:
            if time.monotonic() > deadline:
                raise
        time.sleep(POLL)


def measure_estop(tries: int = SHORT) -> Iterator[Figure]:
    """Measure e-stops while different things go on."""
    if sys.platform == "linux" and can_be_built():
        name = "estop-long" if tries == LONG else "estop"
        yield from beside_machine(name, _measured(name, tries))


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


@contextmanager
def _rig() -> Iterator[Rig]:
    """Give a daemon, and a program that is connected to it."""
    with ExitStack() as stack:
        amplifier, folder = stack.enter_context(amplifier_and_folder())
        port = free_udp_port()
        daemon = Daemon(folder, amplifier.path, osc=port, server=NO_LIMIT)
        stack.enter_context(closing(daemon))
        display = tactile.client.connect(daemon.url, display=NAME, timeout=PATIENCE)
        stack.enter_context(display)
        yield Rig(daemon, Recorder(amplifier), display, port)


def free_udp_port() -> int:
    """Return a port that nobody listens at."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


def measure_estop_long() -> Iterator[Figure]:
    """Measure hundreds of e-stops of each kind."""
    yield from measure_estop(LONG)
