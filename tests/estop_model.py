"""Model of e-stops that counts what was answered; the rules are in the test."""

import asyncio
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis.stateful import RuleBasedStateMachine
from virtual_server import PlaybackProcess, virtual_world

from tactile import messages as m
from tactile.arrays import Floats
from tactile.server.client import Client

RATE = 2500.0
LIMIT, SLEW = 60.0, 20e3
"""Limits of the display: voltage [V] and slew [V/s]."""
CODE = LIMIT / 32767
QUIET = 0.05
"""Longest time from an e-stop to 0 V [s]."""
DEAD_MAN = 0.25
"""Longest time from the server's last heartbeat to 0 V [s]."""
UNOWNED = 1.0
"""Longest time until the high voltage is off after the last client that had armed has left [s]."""
FRAMES = (0.9, 0.9, -0.9, -0.9) * 150
"""Values of tactile frames for two contactors: 0.6 s at 500 Hz."""
DEVICES = {"left": "mock:", "right": "mock:?format=pcm12"}


@dataclass
class Expected:
    """State that a display must have by what was answered.

    Attributes
    ----------
    number, since : number of the latest e-stop that was answered, and its time [s]
    cleared : highest number of a clear that was, or might have been, accepted
    opened : whether somebody asked to arm since then, and that was allowed
    owners : when each client that might own high voltage asked for it last [s]
    unowned : time since when no client might own it [s]
    hang : beginning and end of the last hang of playback [s]
    """

    number: int = 0
    since: float = 0.0
    cleared: int = 0
    clearing: list[int] = field(default_factory=list)
    opened: bool = False
    owners: dict[int, float] = field(default_factory=dict)
    unowned: float = 0.0
    hang: tuple[float, float] = 0.0, 0.0

    @property
    def holds(self) -> bool:
        return self.number > max([self.cleared, *self.clearing])

    def stop(self, number: int, now: float) -> None:
        """Take note of an e-stop that was answered."""
        if number > self.number:
            self.number, self.since, self.opened = number, now, False

    def is_quiet(self, now: float) -> bool:
        """Return whether the output must be at 0 V."""
        begin, end = self.hang
        since = max(self.since, end) if begin < self.since + QUIET else self.since
        return not self.opened and now > since + QUIET

    def is_unowned(self, now: float) -> bool:
        return not self.owners and now > max(self.unowned, self.hang[1]) + UNOWNED


@dataclass
class App:
    """A program: a client, and its requests in flight."""

    client: Client
    tasks: set["asyncio.Task[m.Answer]"] = field(default_factory=set)
    gone: bool = False


@dataclass
class Tally:
    """Counts of what the test came across, which show that it has tested something."""

    steps: int = 0
    seconds: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)

    def count(self, what: str) -> None:
        self.counts[what] = self.counts.get(what, 0) + 1


tally = Tally()


class Judged(RuleBasedStateMachine):
    """A server and its surroundings, and what is right of all that they answer and put out."""

    def __init__(self) -> None:
        super().__init__()
        self.stack = ExitStack()
        self.folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory(prefix="t-")))
        patched = self.stack.enter_context(pytest.MonkeyPatch.context())
        patched.setenv("STATE_DIRECTORY", str(self.folder / "state"))
        self.world = self.stack.enter_context(virtual_world(self.put_out))
        self.expected = {name: Expected() for name in DEVICES}
        self.of_device = {device: self.expected[name] for name, device in DEVICES.items()}
        self.last: dict[int, Floats] = {}
        self.wrong: list[str] = []
        self.apps: list[App] = []
        self.killed = -np.inf
        self.tripping: set[str] = set()

    @property
    def now(self) -> float:
        return self.world.clock.now()

    # What is put out

    def put_out(self, playback: PlaybackProcess, volts: Floats) -> None:
        """Check each sample that an amplifier puts out, as it does."""
        if not len(volts):
            return
        before = self.last.get(playback.pid, np.zeros(volts.shape[1]))
        steps = np.abs(np.diff(np.vstack([before, volts]), axis=0)).max()
        self.last[playback.pid] = volts[-1]
        peak = np.abs(volts).max()
        if peak > LIMIT + CODE:
            self.wrong.append(f"{peak} V is above the limit")
        if steps > SLEW / RATE + 2 * CODE:
            self.wrong.append(f"a step of {steps} V is above the slew limit")
        if not volts.any():
            return
        tally.count("sounding blocks")
        expected = self.of_device[playback.device]
        if expected.is_quiet(self.now):
            self.wrong.append(f"{peak} V with {expected} at {self.now}")
        if self.is_forsaken(expected):
            self.wrong.append(f"{peak} V without a server")

    def is_forsaken(self, expected: Expected) -> bool:
        """Return whether playback must have noticed that the server is silent."""
        stalled = self.world.stalled
        since = self.killed if self.world.host is None else stalled
        return since is not None and self.now > max(since, expected.hang[1]) + DEAD_MAN

    # Programs

    def app(self, k: int) -> App:
        return self.apps[k % len(self.apps)]

    def command(self, kind: str, name: str) -> m.Command:
        number = self.expected[name].number
        point = m.Point(0.0, 1.0), m.Point(60_000.0, 1.0)
        commands: dict[str, Callable[[], m.Command]] = {
            "arm": lambda: m.ArmDisplay(display=name),
            "disarm": lambda: m.DisarmDisplay(display=name),
            "effect": lambda: m.PlayEffect(display=name, amplitude_um=20.0, amplitude=point),
            "append": lambda: m.Append(
                display=name, sample_rate_hz=500.0, amplitude_um=20.0, samples=(0.9, -0.9) * 300
            ),
            "scheduled": lambda: m.PlayEffect(
                display=name,
                amplitude_um=20.0,
                amplitude=point,
                begin=m.BeginAt(at_us=round(1e6 * (self.now + 0.02))),
            ),
            "frames": lambda: m.TactileFrames(
                display=name, frame_rate_hz=500.0, amplitude_um=20.0, frames=FRAMES
            ),
            "timed_frames": lambda: m.TactileFrames(
                display=name,
                frame_rate_hz=500.0,
                amplitude_um=20.0,
                frames=FRAMES,
                time_us=round(1e6 * (self.now + 0.02)),
            ),
            "select": lambda: m.Select(display=name, layers=(m.Layer(texture="wood-oak"),)),
            "touch": lambda: m.Contact(display=name, position_mm=(1.0, 0), normal_force_n=0.5),
            "stop": lambda: m.StopPlaying(display=name),
            "gain": lambda: m.SetGain(display=name, gain=0.7),
            "stats": lambda: m.GetStats(display=name),
            "estop": lambda: m.EStop(display=name),
            "estop_all": lambda: m.EStop(),
            "clear": lambda: m.ClearEstop(display=name, estop=max(number, 1)),
            "clear_older": lambda: m.ClearEstop(display=name, estop=max(number - 1, 1)),
            "clear_newer": lambda: m.ClearEstop(display=name, estop=number + 1),
        }
        return commands[kind]()

    async def request(self, app: App, command: m.Command) -> m.Answer:
        """Have a command carried out, and take note of what follows from it."""
        asked, numbers = self.now, {name: one.number for name, one in self.expected.items()}
        tally.count(type(command).__name__)
        if isinstance(command, m.EStop):
            answer = await app.client.request(command)
            assert isinstance(answer, m.Done), answer
            assert set(answer.estops) == ({command.display} if command.display else set(DEVICES))
            for name, number in answer.estops.items():
                assert number > numbers[name], "an e-stop has a number of its own"
                self.expected[name].stop(number, self.now)
            return answer
        name = getattr(command, "display", "")
        expected = self.expected[name]
        if isinstance(command, m.ArmDisplay):
            return await self.request_arm(app, command, expected)
        if isinstance(command, m.ClearEstop):
            return await self.request_clear(app, command, expected)
        answer = await app.client.request(command)
        if isinstance(command, m.DisarmDisplay) and isinstance(answer, m.Done):
            for owner in [k for k, when in expected.owners.items() if when < asked]:
                self.disown(expected, owner)
        if isinstance(command, m.GetStats) and expected.holds and app.client.roles:
            assert isinstance(answer, m.StatsReply), answer
            assert answer.state in ("estopped", "lost"), answer
        return answer

    async def request_arm(self, app: App, command: m.ArmDisplay, expected: Expected) -> m.Answer:
        held = expected.number if expected.holds else 0
        if not held and "arm" in app.client.roles:
            expected.opened = True
            expected.owners[app.client.number] = self.now
        answer = await app.client.request(command)
        if isinstance(answer, m.Done):
            tally.count("armed")
            assert "arm" in app.client.roles
            assert not held, f"armed though e-stop {held} holds"
        return answer

    async def request_clear(self, app: App, command: m.ClearEstop, expected: Expected) -> m.Answer:
        held, clearing = expected.number if expected.holds else 0, expected.clearing
        clearing.append(command.estop)
        try:
            answer = await app.client.request(command)
        except asyncio.CancelledError:
            expected.cleared = max(expected.cleared, command.estop)
            raise
        finally:
            clearing.remove(command.estop)
        if isinstance(answer, m.Done):
            assert "arm" in app.client.roles
            expected.cleared = max(expected.cleared, command.estop)
            assert held <= command.estop, f"a clear of {command.estop} ended e-stop {held}"
            tally.count("cleared")
        return answer

    def disown(self, expected: Expected, owner: int) -> None:
        if expected.owners.pop(owner, None) is not None and not expected.owners:
            expected.unowned = self.now

    def ask(self, app: App, *commands: m.Command) -> list["asyncio.Task[m.Answer]"]:
        """Send requests, all at once."""
        assert self.world.loop is not None
        tasks = [self.world.loop.create_task(self.request(app, one)) for one in commands]
        for task in tasks:
            app.tasks.add(task)
            task.add_done_callback(lambda done: self.judge(app, done))
        return tasks

    def judge(self, app: App, task: "asyncio.Task[m.Answer]") -> None:
        app.tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.wrong.append(f"a request: {error!r}")

    def pass_time(self, seconds: float) -> None:
        self.world.run(asyncio.sleep(seconds))
