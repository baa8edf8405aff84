"""A simulated daemon with its programs, processes, links and amplifiers, and all that fails.

All is real but time, process boundaries and wires (`virtual_daemon`), and all that happens follows
from a seed. What holds whatever happens is judged where each amplifier puts out its volts, by what
was asked and answered.
"""

import asyncio
import hashlib
import math
import random
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from virtual_daemon import Floats, small_display, virtual_world

from firmware_protocol.machine import Played
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile.bus.line_model import Model
from tactile.bus.registry import Address, parse
from tactile.daemon import messages as m
from tactile.daemon.client import Client
from tactile.daemon.config import Config, DisplayConfig

RATE = 2500.0
LIMIT, SLEW = 60.0, 20e3
"""Of the display [V] and [V/s]."""
SILENT = 0.3
"""s from an e-stop, or from the death of anybody between a program and its amplifier, to 0 V."""
UNPOWERED = 1.0
"""s from then to high voltage off."""
LINKS = {
    "serial": "mock:?link=serial&bit_rate=3000000&format=pcm16",
    "can": "mock:?link=can&format=pcm12",
    "canfd": "mock:?link=canfd&format=pcm16&boards=2",
}
FAULTY = "&loss=0.002&corrupt=0.002&reorder=0.002&drift_ppm=100"
"""What a link may suffer besides: 1 of 500 packets or frames lost, harmed or late."""


@dataclass
class Route:
    """What is between a program and the amplifiers of one display, and what was asked of it.

    Attributes
    ----------
    model : of the link and its amplifiers; None before it is opened
    stopped : when the latest e-stop was answered, unless a clear was asked for since [s]
    deaths : who on the way is dead, and since when [s]
    last : what each amplifier put out last (C,) [V]
    """

    name: str
    device: str
    model: Model | None = None
    number: int = 0
    stopped: float = math.inf
    deaths: dict[str, float] = field(default_factory=dict)
    last: dict[int, Floats] = field(default_factory=dict)

    @property
    def dead(self) -> float:
        """Time since when the way is cut [s]; infinite where it is not."""
        return min(self.deaths.values(), default=math.inf)


class Simulation:
    """A daemon with three displays, from a seed.

    Parameters
    ----------
    seed : of all that happens

    Attributes
    ----------
    wrong : what broke a promise, a line each
    worst : longest time from an e-stop or a death to 0 V [s]
    counts : how often each kind of event came
    sounding : samples other than 0 V that were put out
    digest : of all that was put out, and when
    """

    def __init__(self, seed: int) -> None:
        self.random, self.seed = random.Random(seed), seed
        self.wrong: list[str] = []
        self.log: list[str] = []
        self.worst = {"e-stop": 0.0, "death": 0.0}
        self.counts: dict[str, int] = {}
        self.sounding = 0
        self.digest = hashlib.sha256()
        self.stack = ExitStack()
        folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory(prefix="t-")))
        patch = self.stack.enter_context(pytest.MonkeyPatch.context())
        patch.setenv("STATE_DIRECTORY", str(folder / "state"))
        self.world = self.stack.enter_context(virtual_world(lambda playback, volts: None))
        self.world.on_link = self._listen
        display = small_display(folder)
        self.routes = [
            Route(name, device + (FAULTY if self.random.random() < 0.5 else "") + f"&seed={seed}")
            for name, device in LINKS.items()
        ]
        self.config = Config(
            display=tuple(
                DisplayConfig(
                    name=route.name, display=display, device=route.device, sample_rate_hz=RATE,
                    worn=True,
                )
                for route in self.routes
            )
        )  # fmt: skip
        self.client: Client
        self._start()

    @property
    def now(self) -> float:
        """The time [s]."""
        return self.world.clock.now()

    # What amplifiers put out

    def _listen(self, address: Address, model: Model, board: int, run: Played) -> None:
        route = next(one for one in self.routes if parse(one.device) == address)
        route.model = model
        if any(one.of_server for one in self.world.playbacks(route.device)):  # started anew
            route.deaths.pop("playback", None)
            route.deaths.pop("server", None)
        if len(run.codes):
            code = model.configs[board].full_scale_uv * 1e-6 / FULL_SCALE_CODE
            pace = model.configs[board].tick_hz * (1 + model.drift[board])
            times = model.time_of(board, 0) + run.ticks / pace
            self.digest.update(run.codes.tobytes() + times.tobytes())
            self._judge(route, board, np.float64(code) * run.codes, np.asarray(times), code)
            since = min(route.stopped, route.dead)
            if run.high_voltage and times[-1] > since + UNPOWERED:
                self.wrong.append(
                    f"{route.name}: high voltage at {times[-1]:.4f}, from {since:.4f}"
                )

    def _judge(self, route: Route, board: int, volts: Floats, times: Floats, code: float) -> None:
        before = route.last.get(board, np.zeros(volts.shape[1]))
        step = float(np.abs(np.diff(np.vstack([before, volts]), axis=0)).max())
        route.last[board] = volts[-1]
        peak = float(np.abs(volts).max())
        if peak > LIMIT + code:
            self.wrong.append(f"{route.name}: {peak:.2f} V is above the limit, at {times[0]:.4f}")
        if step > SLEW / RATE + 2 * code:
            self.wrong.append(f"{route.name}: a step of {step:.2f} V, at {times[0]:.4f}")
        loud = times[volts.any(axis=1)]
        if not len(loud):
            return
        self.sounding += len(loud)
        for kind, since in (("e-stop", route.stopped), ("death", route.dead)):
            if loud[-1] > since:
                self.worst[kind] = max(self.worst[kind], float(loud[-1] - since))
            if loud[-1] > since + SILENT:
                self.wrong.append(
                    f"{route.name}: {peak:.2f} V at {loud[-1]:.4f}, the {kind} was at {since:.4f}"
                )

    # What happens

    def _start(self) -> None:
        while not self.world.start(self.config):  # what a killed server left has the latch
            self.world.clock.advance(0.5)
        assert self.world.host is not None
        self.client = self.world.host.connect("app", roles=m.ALL_ROLES)

    def _die(self, route: Route, who: str, seconds: float) -> None:
        """Note a death that ends by itself."""
        route.deaths[who] = self.now
        self.world.clock.after(seconds, lambda: route.deaths.pop(who, None))

    def _pass(self, seconds: float) -> None:
        self.world.run(asyncio.sleep(seconds))

    async def _ask(self, *commands: m.Command) -> list[m.Answer]:
        return list(await asyncio.gather(*(self.client.request(one) for one in commands)))

    def play(self, route: Route) -> None:
        """Clear, arm and begin an effect, if that is allowed."""
        route.stopped = math.inf
        begin, end = m.Point(0.0, 1.0), m.Point(60_000.0, 1.0)
        clear = m.Clear(display=route.name, estop=max(route.number, 1))
        effect = m.Effect(display=route.name, amplitude_um=20.0, amplitude=(begin, end))
        for command in (clear, m.Arm(display=route.name), effect):
            self.world.run(self._ask(command))

    def estop(self, route: Route) -> None:
        """E-stop one display, or all."""
        every = self.random.random() < 0.3
        (answer,) = self.world.run(self._ask(m.EStop(display=None if every else route.name)))
        assert isinstance(answer, m.Done), answer
        for one in self.routes:
            if one.name in answer.estops:
                one.number, one.stopped = answer.estops[one.name], self.now

    def arm_in_vain(self, route: Route) -> None:
        """Try to arm what is e-stopped."""
        if route.stopped < math.inf:
            (answer,) = self.world.run(self._ask(m.Arm(display=route.name)))
            if isinstance(answer, m.Done):
                self.wrong.append(f"{route.name}: armed at {self.now:.4f} in an e-stop")

    def touch(self, route: Route) -> None:
        """Move a finger over a texture."""
        select = m.Select(display=route.name, layers=(m.Layer(texture="wood-oak"),))
        self.world.run(self._ask(select))
        for k in range(20):
            place = m.Contact(
                display=route.name, position_mm=(0.5 * k, 0.0), normal_force_n=0.5,
                velocity_mm_s=(50.0, 0.0),
            )  # fmt: skip
            self.client.contact(place, self.now)
            self._pass(0.01)

    def disarm(self, route: Route) -> None:
        """Fade out and disarm."""
        self.world.run(self._ask(m.Disarm(display=route.name)))

    def kill_playback(self, route: Route) -> None:
        """Kill the playback process."""
        for playback in self.world.playbacks(route.device):
            playback.kill()
            route.deaths.setdefault("playback", self.now)

    def hang_playback(self, route: Route) -> None:
        """Let playback stand still, for long or not."""
        seconds = self.random.choice([0.005, 0.05, 0.2, 1.0])
        for playback in self.world.playbacks(route.device):
            if not playback.hung:
                playback.hang(seconds)
                self._die(route, f"hanging {playback.pid}", seconds)

    def kill_server(self, route: Route) -> None:
        """Kill the daemon's server, and start another some time later."""
        self.world.kill()
        for one in self.routes:
            one.deaths.setdefault("server", self.now)
        self.world.clock.advance(self.random.choice([0.0, 0.3, 1.5]))
        self._start()

    def stall_server(self, route: Route) -> None:
        """Let the server's event loop stand still."""
        for one in self.routes:
            one.deaths["stalled server"] = self.now
        self.world.stall(self.random.choice([0.01, 0.1, 0.5]))
        for one in self.routes:
            del one.deaths["stalled server"]

    def unplug(self, route: Route) -> None:
        """Take the link away for a while."""
        if route.model is not None and "link" not in route.deaths:
            seconds = self.random.choice([0.01, 0.1, 0.6, 1.5])
            route.model.unplug(seconds)
            self._die(route, "link", seconds)

    def stall_link(self, route: Route) -> None:
        """Let the amplifiers read nothing for a while."""
        if route.model is not None:
            route.model.stall(self.random.choice([0.01, 0.05, 0.25]))

    def power_cycle(self, route: Route) -> None:
        """Take power away from the amplifiers, and give it again."""
        if route.model is not None:
            route.model.power_cycle()
            route.last.clear()

    EVENTS = (
        (play, 8), (estop, 3), (arm_in_vain, 2), (touch, 2), (disarm, 1), (kill_playback, 1),
        (hang_playback, 2), (kill_server, 1), (stall_server, 1), (unplug, 2), (stall_link, 1),
        (power_cycle, 1),
    )  # fmt: skip

    def run(self, seconds: float) -> None:
        """Let things happen for a while; stop at the first promise that is broken."""
        events, weights = zip(*self.EVENTS, strict=True)
        end = self.now + seconds
        while self.now < end and not self.wrong:
            (event,) = self.random.choices(events, weights)
            route = self.random.choice(self.routes)
            self.counts[event.__name__] = self.counts.get(event.__name__, 0) + 1
            self.log.append(f"{self.now:.6f} {event.__name__} {route.name}")
            event(self, route)
            self._pass(self.random.choice([0.001, 0.01, 0.05, 0.2, 0.5]))
            self._check()

    def _check(self) -> None:
        """See what must hold between events."""
        assert self.world.host is not None
        self.wrong += self.world.errors.all
        for route in self.routes:
            playing = self.world.host.playing[route.name]
            if route.stopped < math.inf and playing.state not in ("estopped", "lost"):
                self.wrong.append(f"{route.name}: {playing.state} at {self.now:.4f} in an e-stop")

    def close(self) -> None:
        """End everything."""
        self.stack.close()


def simulate(seed: int, seconds: float) -> Simulation:
    """Run a simulation to its end, or to the first promise that is broken."""
    simulation = Simulation(seed)
    try:
        simulation.run(seconds)
    finally:
        simulation.close()
    return simulation


if __name__ == "__main__":
    done = simulate(int(sys.argv[1]), float(sys.argv[2]))
    print(*done.log[-20:], sep="\n")
    print(done.wrong, done.worst, done.counts, done.sounding)
