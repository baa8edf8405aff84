"""Whatever happens in whatever order, an e-stop holds until the clear that names it.

Programs connect, arm, play, e-stop, clear, fall silent and leave, several commands at once; the
e-stop process and the amplifier trip the latch, also in the middle of a block; playback hangs or is
killed, the server stands still, is killed or ended, and started again. The server is the real one,
on a virtual clock (`virtual_server`); what is right is told by plain counting of what was answered.

``TACTILE_LONG=1 pytest tests/test_estop_model.py -m ci`` takes 10⁵ steps.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import numpy as np
import pytest
from estop_model import DEVICES, RATE, App, Expected, Judged, Tally, tally
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from repeating import LONG
from virtual_server import PlaybackProcess, small_display

from firmware_protocol.messages import State
from tactile import messages as m
from tactile.bus.simulated.mock_bus import MockBus
from tactile.errors import BusError
from tactile.server.config import Configuration, DisplayConfig

T = TypeVar("T")
NAMES = st.sampled_from(list(DEVICES))
MOMENTS = st.sampled_from(
    [0, 0, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 15, 20, 25, 30, 40, 55, 60, 110, 160, 260, 700]
).map(lambda ms: 1e-3 * ms + 1e-4)
"""Moments of events [s]. Few are long, since playing takes a tenth of their time."""
ROLES = st.frozensets(st.sampled_from(sorted(m.ALL_ROLES))) | st.just(m.ALL_ROLES)
KINDS = st.sampled_from(
    ["arm"] * 3
    + ["effect"] * 2
    + ["clear"] * 3
    + ["append", "frames", "timed_frames", "scheduled"]
    + ["select", "touch", "stop", "gain", "stats", "disarm"]
    + ["estop", "estop_all", "clear_older", "clear_newer"]
)


class Model(Judged):
    """Events that may happen to a server."""

    # The beginning

    def config(self, *, arm_on_start: bool, rearm: bool) -> Configuration:
        display = small_display(self.folder)
        return Configuration(
            display=tuple(
                DisplayConfig(
                    name=name, display=display, device=device, sample_rate_hz=RATE, worn=True,
                    arm_on_start=arm_on_start, rearm=rearm,
                )
                for name, device in DEVICES.items()
            )
        )  # fmt: skip

    def start(self, *, arm_on_start: bool, rearm: bool) -> None:
        """Start a server."""
        for expected in self.expected.values():
            expected.owners, expected.unowned = {}, self.now
            if arm_on_start and not expected.holds:
                expected.opened = True
            if arm_on_start:  # and for as long as this server lives
                expected.owners[0] = np.inf
        config = self.config(arm_on_start=arm_on_start, rearm=rearm)
        while not self.world.start(config):  # playback of the last one hangs, and holds the latch
            tally.count("server not started")
            self.world.clock.advance(1.0)
        self.connect(m.ALL_ROLES)

    @initialize(arm_on_start=st.booleans(), rearm=st.booleans())
    def begin(self, *, arm_on_start: bool, rearm: bool) -> None:
        """Start the first server."""
        self.start(arm_on_start=arm_on_start, rearm=rearm)

    # What happens

    @rule(roles=ROLES)
    @precondition(lambda self: len(self.apps) < 4)
    def connect(self, roles: frozenset[m.Role]) -> None:
        """Let a program connect."""
        assert self.world.host is not None
        self.apps.append(App(self.world.host.connect("app", roles=roles)))

    @rule(k=st.integers(0, 3))
    @precondition(lambda self: len(self.apps) > 1)
    def leave(self, k: int) -> None:
        """Let a program end, as its connection does: what is in flight is canceled."""
        self._leave(self.app(k))

    def _leave(self, app: App) -> None:
        self.apps.remove(app)
        self.world.run(self._cancel(app))
        for expected in self.expected.values():
            self.disown(expected, app.client.number)

    async def _cancel(self, app: App) -> None:
        tasks = list(app.tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        app.client.close()

    @rule(k=st.integers(0, 3), seconds=MOMENTS)
    def fall_silent(self, k: int, seconds: float) -> None:
        """Let a program give no sign of life, once its requests are answered."""
        app = self.app(k)
        if not app.tasks:
            self.world.run(_call(app.client.quiet))
            self.pass_time(seconds)
        if not app.tasks:
            self.world.run(_call(app.client.give_up))
            for expected in self.expected.values():
                self.disown(expected, app.client.number)

    @rule(
        k=st.integers(0, 3), name=NAMES,
        kinds=st.lists(KINDS, min_size=1, max_size=4), seconds=MOMENTS,
    )  # fmt: skip
    def request_all(self, k: int, name: str, kinds: list[str], seconds: float) -> None:
        """Let a program send commands, all at once, and let some time pass."""
        self.ask(self.app(k), *(self.command(kind, name) for kind in kinds))
        self.pass_time(seconds)

    @rule(k=st.integers(0, 3), other=st.integers(0, 3), name=NAMES, kinds=st.tuples(KINDS, KINDS))
    def request_together(self, k: int, other: int, name: str, kinds: tuple[str, str]) -> None:
        """Let two programs each send a command at the same time, and wait for neither."""
        for which, kind in zip((k, other), kinds, strict=True):
            self.ask(self.app(which), self.command(kind, name))

    @rule(name=NAMES, seconds=MOMENTS, stalled=st.sampled_from([0.0, 0.0, 0.0, 0.35]))
    def sound(self, name: str, seconds: float, stalled: float) -> None:
        """Let whoever may do so clear, arm and play, and perhaps the server stand still then."""
        for kind in ("clear", "arm", "effect"):
            tasks = self.ask(self.apps[0], self.command(kind, name))
            self.world.run(_all(tasks))
        self.pass_time(seconds)
        if stalled:
            self.stand_still(stalled)

    @rule(seconds=MOMENTS)
    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.pass_time(seconds)

    def trip(self, name: str | None) -> None:
        """E-stop as `tactile estop` does, which needs no server that runs."""
        desk = self.world.desk
        if desk is not None:
            word = "null" if name is None else f'"{name}"'
            answer = desk.answer(b'{"estop": %s}' % word.encode(), "by tactile estop")
            for stopped, number in answer["estops"].items():
                assert number > self.expected[stopped].number
                self.expected[stopped].stop(number, self.now)
            tally.count("tactile estop")

    @rule(name=st.none() | NAMES, seconds=MOMENTS)
    def estop_aside(self, name: str | None, seconds: float) -> None:
        """E-stop by the command `tactile estop`."""
        self.trip(name)
        self.pass_time(seconds)

    @rule(name=NAMES)
    def estop_in_the_middle(self, name: str) -> None:
        """E-stop while playback is between two lines of a block, or of a start."""
        for playback in self.world.playbacks(DEVICES[name]):
            playback.within = lambda: self.trip(name)

    def fail(self, playback: PlaybackProcess) -> None:
        playback.bus.abort()
        tally.count("fault")

    @rule(name=NAMES, middle=st.booleans())
    def fault(self, name: str, *, middle: bool) -> None:
        """Let an amplifier have a fault, after which it is at 0 V and idle."""
        for playback in self.world.playbacks(DEVICES[name]):
            if middle:
                playback.within = lambda playback=playback: self.fail(playback)
            else:
                self.fail(playback)

    @rule(name=NAMES)
    def estop_by_amplifier(self, name: str) -> None:
        """Press the amplifier's own e-stop button: playback latches it."""
        assert self.world.host is not None
        playing, before = self.world.host.playing[name], self.expected[name].number
        for playback in self.world.playbacks(DEVICES[name]):
            if not playback.hung and playback.alive:
                playback.bus.estop()
                self.pass_time(0.015)
                if playback.alive and not self.expected[name].clearing:
                    assert playing.latch.holds >= max(before, 1)
                    self.expected[name].stop(playing.latch.holds, self.now)
                    tally.count("e-stop by the amplifier")

    @rule(name=NAMES, seconds=MOMENTS | st.floats(3.0, 6.0))
    def hang(self, name: str, seconds: float) -> None:
        """Let playback stand still for a while."""
        for playback in self.world.playbacks(DEVICES[name]):
            if not playback.hung:
                self.expected[name].hang = self.now, self.now + seconds
                playback.hang(seconds)
                tally.count("hang")

    @rule(name=NAMES, seconds=MOMENTS)
    def kill_playback(self, name: str, seconds: float) -> None:
        """Kill playback."""
        for playback in self.world.playbacks(DEVICES[name]):
            playback.kill()
            tally.count("playback killed")
        self.pass_time(seconds)

    @rule(
        seconds=MOMENTS | st.floats(0.1, 0.7),
        name=st.none() | NAMES,
        tripped=st.none() | st.floats(0, 0.7),
    )
    def stall(self, seconds: float, name: str | None, tripped: float | None) -> None:
        """Let the server stand still, and perhaps call `tactile estop` meanwhile."""
        if tripped is not None:
            self.world.clock.after(tripped, lambda: self.trip(name))
        self.stand_still(seconds)

    def stand_still(self, seconds: float) -> None:
        self.world.stall(seconds)
        for expected in self.expected.values():
            expected.unowned = self.now
        tally.count("stall")

    @rule(
        kill=st.booleans(), seconds=MOMENTS, arm_on_start=st.booleans(), rearm=st.booleans(),
    )  # fmt: skip
    def restart(self, *, kill: bool, seconds: float, arm_on_start: bool, rearm: bool) -> None:
        """End or kill the server, and start another."""
        if kill:
            self.world.kill()
        else:
            self.world.run(_all([self._cancel(app) for app in self.apps]))
            self.world.stop()
        for expected in self.expected.values():
            expected.cleared = max([expected.cleared, *expected.clearing])
            expected.clearing = []
        self.apps.clear()
        self.killed = self.now
        self.world.clock.advance(seconds)
        tally.count("server killed" if kill else "server ended")
        self.start(arm_on_start=arm_on_start, rearm=rearm)

    @rule()
    def reload(self) -> None:
        """Let the server read its configuration again."""
        assert self.world.host is not None
        try:
            self.world.run(self.world.host.reload())
        except BusError:
            tally.count("not reloaded")

    # What holds

    @invariant()
    def all_is_well(self) -> None:
        tally.steps += 1
        assert not self.wrong, self.wrong
        assert not self.world.errors.all, self.world.errors.all
        for name, expected in self.expected.items():
            self.check(name, expected)

    def check(self, name: str, expected: Expected) -> None:
        host, now = self.world.host, self.now
        if host is None:
            return
        playing = host.playing[name]
        if expected.holds:
            assert playing.state in ("estopped", "lost")
            assert playing.latch.holds >= expected.number
        for playback in self.world.playbacks(DEVICES[name]):
            if playback.hung:
                continue
            if expected.is_quiet(now) or expected.is_unowned(now):
                assert playback.bus.state != "running", (expected, now)
                # after a stop the watchdog takes high voltage away, but a mock's clock stands still
                allowed = set() if expected.holds else {State.ARMED}
                assert isinstance(playback.bus, MockBus)
                amplifiers = [board.amplifier for board in playback.bus.boards]
                assert {one.state for one in amplifiers if one.high_voltage} <= allowed
        if not host.tasks and not any(app.tasks for app in self.apps):
            numbers = {app.client.number for app in self.apps}
            assert set(playing.states) <= numbers
            assert playing.owners.clients <= numbers | {0}

    def teardown(self) -> None:
        """See that all comes back, and that one who may can clear, arm and play."""
        try:
            if self.world.host is not None:
                self.all_comes_back()
        finally:
            tally.seconds += self.now - 1000.0
            self.stack.close()

    def all_comes_back(self) -> None:
        host = self.world.host
        assert host is not None
        for playback in self.world.playbacks():
            playback.within = None
        while self.apps:
            self._leave(self.apps[0])
        self.connect(m.ALL_ROLES)
        app = self.apps[-1]
        for name in DEVICES:
            self.ask(app, m.DisarmDisplay(display=name))
        self.pass_time(0.8)  # in which the last e-stop that is under way comes
        for _ in range(200):
            self.pass_time(0.1)
            if all(one.alive for one in host.playing.values()) and not app.tasks:
                break
        self.all_is_well()
        for name, playing in host.playing.items():
            assert playing.alive, "playback always comes back"
            number = playing.latch.holds
            self.expected[name].stop(number, self.now)
            clear = m.ClearEstop(display=name, estop=max(number, 1))
            commands = [clear] if number else []
            for command in [*commands, m.ArmDisplay(display=name), self.command("effect", name)]:
                (answer,) = self.world.run(_all(self.ask(app, command)))
                assert isinstance(answer, m.Done), answer
            before = tally.counts.get("sounding blocks", 0)
            self.pass_time(0.1)
            state = name, playing.state, playing.report, playing.latch.holds
            assert tally.counts.get("sounding blocks", 0) > before, f"silent: {state}"
        self.all_is_well()


async def _call(work: Callable[[], None]) -> None:
    work()


async def _all(tasks: Sequence[Awaitable[T]]) -> list[T]:
    return await asyncio.gather(*tasks)


def run(examples: int, steps: int) -> None:
    """Take so many steps in so many lives of a server."""
    begun = time.perf_counter()
    before = Tally(tally.steps, tally.seconds)
    run_state_machine_as_test(
        Model,
        settings=settings(
            max_examples=examples, stateful_step_count=steps, phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )  # fmt: skip
    wall = time.perf_counter() - begun
    taken, seconds = tally.steps - before.steps, tally.seconds - before.seconds
    assert tally.counts["sounding blocks"], "otherwise nothing was tested"
    print(f"{taken} steps, {seconds:.0f} s simulated, {wall:.0f} s: {tally.counts}")


def test_an_estop_holds_until_the_clear_that_names_it() -> None:
    run(12, 40)


@pytest.mark.ci
def test_an_estop_holds_in_many_more_steps() -> None:
    run(1500 if LONG else 50, 80 if LONG else 60)
