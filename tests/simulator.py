"""Simulation of a server with its programs, processes, links and amplifiers, and of all faults.

All is real but time, process boundaries and wires (`virtual_server`): programs have the SDK, and
talk to the server over its socket; an engine sends it OSC. All that happens follows from a seed.
What holds whatever happens is judged where each amplifier puts out its volts, by what was asked
and answered.
"""

import argparse
import asyncio
import functools
import hashlib
import math
import random
import socket
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import simulated_chips
from numpy.typing import NDArray
from osc_faults import mutated, packet
from sample_ledger import Ledger
from simulated_route import RATE, Program, Route
from virtual_loop import Datagrams
from virtual_server import small_display, virtual_world

from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FULL_SCALE_CODE, Start
from tactile.arrays import Floats
from tactile.bus.base import DriveBlock
from tactile.bus.link.stream import LinkStream
from tactile.bus.registry import Address
from tactile.bus.simulated.line_model import Model
from tactile.bus.simulated.modeled_bus import MockOptions, ModeledBus
from tactile.client import aio
from tactile.client.address import UNIX
from tactile.errors import ClientError, RequestError
from tactile.server.config import Configuration, DisplayConfig, OscConfig, ServerConfig

LINKS = {
    "serial": "mock:?link=serial&bit_rate=3000000&format=pcm16",
    "can": "mock:?link=can&format=pcm12",
    "canfd": "mock:?link=canfd&format=pcm16&boards=2",
    "i2c": "mock:?link=i2c&bit_rate=1000000&format=pcm16",
}
AFTERMATH = 3.0
"""Longest time that a fault has effects [s]: processes and links need it to come back."""
OSC = 7412
"""Port of the server; an engine sends from the one below."""
FAULTY = "&loss=0.002&corrupt=0.002&reorder=0.002&drift_ppm=100"
"""Faults that a link may suffer besides: 1 of 500 packets or frames lost, harmed or late."""


class Simulation:
    """A server with a display on each kind of link, and one on chips, from a seed.

    Parameters
    ----------
    seed : seed of all that happens

    Attributes
    ----------
    wrong : broken promises, one line each
    worst : longest time from an e-stop or a death to 0 V [s]
    counts : how often each kind of event came
    answers : how often programs had what they asked for, or why not
    sounding : samples other than 0 V that were put out
    exact : samples that were put out as they were written, in their place
    digest : digest of all that was put out, and when
    """

    def __init__(self, seed: int) -> None:
        self.random, self.seed = random.Random(seed), seed
        self.wrong: list[str] = []
        self.log: list[str] = []
        self.counts, self.answers = Counter[str](), Counter[str]()
        self.digest = hashlib.sha256()
        self.stack = ExitStack()
        folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory(prefix="t-")))
        patch = self.stack.enter_context(pytest.MonkeyPatch.context())
        patch.setenv("STATE_DIRECTORY", str(folder / "state"))
        self.stack.callback(random.setstate, random.getstate())
        random.seed(seed)  # the SDK draws how long it waits to reconnect
        self.world = self.stack.enter_context(virtual_world(lambda playback, volts: None))
        self.world.on_link = self._listen
        self._overhear(patch)
        self.url = f"{UNIX}{folder}/socket"
        display = small_display(folder)
        self.routes = [
            Route(
                name,
                device + (FAULTY if self.random.random() < 0.5 else "") + f"&seed={seed}",
                self._program(),
                self.wrong,
            )
            for name, device in LINKS.items()
        ]
        self.routes.append(self._chips())
        self.stopper = self._program()
        self._have_engine(folder, patch)
        self.config = Configuration(
            server=ServerConfig(port=0, socket=f"{folder}/socket"),
            osc=OscConfig(port=OSC),
            display=tuple(
                DisplayConfig(
                    name=route.name, display=display, device=route.device, worn=True,
                    sample_rate_hz=RATE if route.name in LINKS else None,
                )
                for route in self.routes
            ),
        )  # fmt: skip
        self._start()

    def _chips(self) -> Route:
        """Return a display on chips without firmware."""
        route = Route("chips", simulated_chips.DEVICE, self._program(), self.wrong)

        def put_out(chip: int, volts: Floats, times: Floats, dropped: NDArray[np.bool_]) -> None:
            self._note_playback(route)
            self.digest.update(volts.tobytes() + times.tobytes())
            code, rate = simulated_chips.LSB, simulated_chips.RATE
            route.judge_volts(chip, volts, times, code, rate=rate, dropped=dropped)

        route.model = simulated_chips.Chips(self.world.clock, put_out)
        self.world.adapters[simulated_chips.PATH] = route.model.adapter
        return route

    def _have_engine(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        """Have an engine, and a server whose OSC comes as datagrams that arrive at once."""
        sockets = vars(socket) | {"socket": functools.partial(Datagrams, folder)}
        patch.setattr("tactile.server.server.socket", SimpleNamespace(**sockets))
        self.engine = self.stack.enter_context(Datagrams(folder))
        self.engine.bind(("127.0.0.1", OSC - 1))

    @property
    def exact(self) -> int:
        return sum(route.ledger.exact for route in self.routes)

    @property
    def sounding(self) -> int:
        return sum(route.sounding for route in self.routes)

    @property
    def worst(self) -> dict[str, float]:
        return {kind: max(one.worst[kind] for one in self.routes) for kind in ("e-stop", "death")}

    @property
    def now(self) -> float:
        """The time [s]."""
        return self.world.clock.now()

    # What is written, and what amplifiers put out

    def _overhear(self, patch: pytest.MonkeyPatch) -> None:
        """Let ledgers know what is written and withdrawn, and what a START plays first."""
        real_write, real_begin, real_clear = ModeledBus.write, LinkStream.begin, LinkStream.clear

        def route_of(bus: ModeledBus) -> Route:
            return next(one for one in self.routes if one.model is bus.model)

        def ledgers(stream: LinkStream) -> Iterator[Ledger]:
            for playback in self.world.playbacks():
                if playback.bus.counters is stream._counters:
                    assert isinstance(playback.bus, ModeledBus)
                    yield route_of(playback.bus).ledger

        def write(bus: ModeledBus, block: DriveBlock) -> None:
            route_of(bus).ledger.write(block)
            real_write(bus, block)

        def begin(stream: LinkStream, position: int, time: float, **named: bool) -> list[Start]:
            for ledger in ledgers(stream):
                ledger.begin(position)
            return real_begin(stream, position, time, **named)

        def clear(stream: LinkStream, now: float = math.inf) -> None:
            for ledger in ledgers(stream):
                ledger.withdraw()
            real_clear(stream, now)

        patch.setattr(ModeledBus, "write", write)
        patch.setattr(LinkStream, "clear", clear)
        patch.setattr(LinkStream, "begin", begin)

    def _listen(
        self, address: Address[MockOptions], model: Model, board: int, run: PlayedRun
    ) -> None:
        route = next(one for one in self.routes if one.address == address)
        route.model = model
        self._note_playback(route)
        if len(run.codes):
            code = model.configs[board].full_scale_uv * 1e-6 / FULL_SCALE_CODE
            pace = model.configs[board].tick_hz * (1 + model.drift[board])
            times = np.asarray(model.time_of(board, 0) + run.ticks / pace)
            self.digest.update(run.codes.tobytes() + times.tobytes())
            if board == 0:
                faults = replace(model.amplifiers[0].counters, packets=0)
                route.ledger.count(faults, self.now)
            route.judge(board, run, times, code)

    def _note_playback(self, route: Route) -> None:
        if any(one.of_server for one in self.world.playbacks(route.device)):  # started anew
            route.deaths.pop("playback", None)
            route.deaths.pop("server", None)

    # Programs and the server

    def _program(self) -> Program:
        return Program(self.world, self.url, rearm=self.random.random() < 0.5)

    def _start(self) -> None:
        while not self.world.start(self.config, listening=True):  # what a killed server left
            self.world.clock.advance(0.5)  # has the latch

    def _die(self, route: Route, who: str, seconds: float) -> None:
        """Note a death that ends by itself."""
        route.deaths[who] = self.now
        self.world.clock.after(seconds, lambda: route.deaths.pop(who, None))

    def _have(
        self, program: Program, work: Callable[[aio.AsyncConnection], Coroutine[Any, Any, None]]
    ) -> None:
        """Have a program do something; what it is refused is counted, other errors are wrong."""

        async def done() -> None:
            try:
                if program.connection is not None:
                    await work(program.connection)
                    self.answers["done"] += 1
            except ClientError as error:
                self.answers[type(error).__name__] += 1
            except Exception as error:
                self.wrong.append(f"{work.__name__}: {error!r}")

        program.begin(done())

    def _note(self, estops: dict[str, int]) -> None:
        """Note e-stops that were answered, by the name of the display."""
        for one in self.routes:
            if estops.get(one.name, 0) > one.number:
                one.number, one.stopped = estops[one.name], self.now

    # What happens

    def play(self, route: Route) -> None:
        """Clear, arm and begin an effect, if that is allowed."""

        async def clear_and_play(connection: aio.AsyncConnection) -> None:
            display = connection.display(route.name)
            if display.estopped and display.estopped >= route.number:
                route.stopped = math.inf
            if display.estopped:
                with suppress(RequestError):  # a newer one holds
                    await display.clear(estop=display.estopped)
            route.deaths.pop("program", None)
            await display.arm()
            await display.effect(20e-6, amplitude_points=[(0.0, 1.0), (60.0, 1.0)])

        self._have(route.program, clear_and_play)

    def estop(self, route: Route) -> None:
        """E-stop one display, or all."""
        name = None if self.random.random() < 0.3 else route.name
        program = self.random.choice([route.program, self.stopper])

        async def stop(connection: aio.AsyncConnection) -> None:
            if name is None:
                estops = await connection.estop()
            else:
                estops = {name: await connection.display(name).estop()}
            self._note(estops)

        self._have(program, stop)

    def arm_in_vain(self, route: Route) -> None:
        """Try to arm what is e-stopped."""
        number, stopped = route.number, route.stopped

        async def arm(connection: aio.AsyncConnection) -> None:
            route.deaths.pop("program", None)
            await connection.display(route.name).arm()
            if stopped < math.inf and (number, stopped) == (route.number, route.stopped):
                self.wrong.append(f"{route.name}: armed at {self.now:.4f} in an e-stop")

        self._have(route.program, arm)

    def clear_in_vain(self, route: Route) -> None:
        """E-stop, and try to clear that by the number of the one before."""

        async def clear(connection: aio.AsyncConnection) -> None:
            display = connection.display(route.name)
            number = await display.estop()
            self._note({route.name: number})
            stopped = route.stopped
            if number > 1:
                await display.clear(estop=number - 1)
                if stopped < math.inf and (number, stopped) == (route.number, route.stopped):
                    self.wrong.append(f"{route.name}: {number - 1} cleared e-stop {number}")

        self._have(route.program, clear)

    def touch(self, route: Route) -> None:
        """Move a finger over a texture."""

        async def move(connection: aio.AsyncConnection) -> None:
            display = connection.display(route.name)
            await display.select("wood-oak")
            for k in range(20):
                await display.touch((0.5e-3 * k, 0.0), velocity=(0.05, 0.0))
                await asyncio.sleep(0.01)

        self._have(route.program, move)

    def send_osc(self, route: Route) -> None:
        """Have an engine move a finger over a texture, with packets that have faults among it."""
        packets = [packet(f"/tactile/{route.name}/texture", "wood-oak")]
        for k in range(20):
            packets.append(packet(f"/tactile/{route.name}/contact", 0.5 * k, 0.0, 1.0, 50.0, 0.0))
            packets += [mutated(self.random)] if self.random.random() < 0.2 else []
        for one in (route, self.routes[0]):  # which those mean that name no display
            one.moved = self.now + 0.01 * len(packets) + 0.1  # a finger is forgotten 0.1 s later
        for k, data in enumerate(packets):
            self.world.clock.after(0.01 * k, functools.partial(self._send, data))

    def _send(self, data: bytes) -> None:
        self.answers["OSC"] += self.engine.send_to(data, OSC)

    def estop_by_osc(self, route: Route) -> None:
        """E-stop by a packet, which is not answered."""
        assert self.world.host is not None
        latch = self.world.host.playing[route.name].latch
        before, now = latch.number, self.now
        if self.engine.send_to(packet(f"/tactile/{route.name}/estop"), OSC):
            self.world.clock.advance(0.1, lambda: latch.number > before)
            if latch.number == before:
                self.wrong.append(f"{route.name}: no e-stop by OSC since {now:.4f}")
            self._note({route.name: latch.number})

    def disarm(self, route: Route) -> None:
        """Fade out and disarm."""

        async def end(connection: aio.AsyncConnection) -> None:
            await connection.display(route.name).disarm()

        self._have(route.program, end)

    def kill_program(self, route: Route) -> None:
        """Kill a program; another takes its place."""
        route.program.kill()
        self.world.killed.append(route.program)
        route.deaths.pop(f"hanging program {id(route.program)}", None)
        route.deaths.setdefault("program", self.now)
        route.program = self._program()

    def hang_program(self, route: Route) -> None:
        """Let a program stand still, for long or not."""
        if not route.program.hung:
            seconds = self.random.choice([0.05, 0.2, 0.6, 2.0])
            route.program.hang(seconds)
            self._die(route, f"hanging program {id(route.program)}", seconds)

    def kill_playback(self, route: Route) -> None:
        """Kill the playback process."""
        for playback in self.world.playbacks(route.device):
            playback.kill()
            route.deaths.pop(f"hanging {playback.pid}", None)
            route.deaths.setdefault("playback", self.now)

    def hang_playback(self, route: Route) -> None:
        """Let playback stand still, for long or not."""
        seconds = self.random.choice([0.005, 0.05, 0.2, 1.0])
        for playback in self.world.playbacks(route.device):
            if not playback.hung:
                playback.hang(seconds)
                self._die(route, f"hanging {playback.pid}", seconds)
                self.world.clock.after(seconds, lambda: setattr(route, "woken", self.now))

    def kill_server(self, route: Route) -> None:
        """Kill the server, and start another some time later."""
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
        (play, 10), (estop, 3), (arm_in_vain, 2), (clear_in_vain, 1), (touch, 2), (disarm, 1),
        (send_osc, 2), (estop_by_osc, 1), (kill_program, 1), (hang_program, 2),
        (kill_playback, 1), (hang_playback, 2), (kill_server, 1), (stall_server, 1), (unplug, 2),
        (stall_link, 1), (power_cycle, 1),
    )  # fmt: skip
    OF_ALL = (kill_server, stall_server)
    FAULTS = (kill_playback, hang_playback, unplug, stall_link, power_cycle, *OF_ALL)

    def run(self, seconds: float) -> None:
        """Let things happen for a while; stop at the first promise that is broken."""
        events, weights = zip(*self.EVENTS, strict=True)
        end = self.now + seconds
        self.world.clock.advance(0.1)  # programs connect
        for route in self.routes:
            self.play(route)
        while self.now < end and not self.wrong:
            (event,) = self.random.choices(events, weights)
            sounding = [one for one in self.routes if any(v.any() for v in one.last.values())]
            often = sounding and event is not Simulation.play and self.random.random() < 0.7
            route = self.random.choice(sounding if often else self.routes)
            self.counts[event.__name__] += 1
            self.log.append(f"{self.now:.6f} {event.__name__} {route.name}")
            event(self, route)
            if event in self.FAULTS:
                for one in self.routes if event in self.OF_ALL else [route]:
                    one.disturbed = self.now + AFTERMATH
            self.world.clock.advance(self.random.choice([0.001, 0.01, 0.05, 0.2, 0.5]))
            self._check()

    def _check(self) -> None:
        """See what must hold between events."""
        assert self.world.host is not None
        self.wrong += self.world.errors.all
        for route in self.routes:
            for time in route.ledger.unexplained:
                self.wrong.append(f"{route.name}: from {time:.4f} not what was written")
            playing = self.world.host.playing[route.name]
            if route.stopped < math.inf and playing.state not in ("estopped", "lost"):
                self.wrong.append(f"{route.name}: {playing.state} at {self.now:.4f} in an e-stop")

    def close(self) -> None:
        """End everything."""
        for program in (self.stopper, *(route.program for route in self.routes)):
            program.kill()
            self.world.killed.append(program)
        self.stack.close()


def simulate(seed: int, seconds: float) -> Simulation:
    """Run a simulation to its end, or to the first promise that is broken."""
    simulation = Simulation(seed)
    try:
        simulation.run(seconds)
    finally:
        simulation.close()
    return simulation


def main() -> None:
    """Simulate, then print the last events, the counts, and the promises that were broken."""
    parser = argparse.ArgumentParser(
        description="Simulate a server under faults, the same way for the same seed.",
        epilog="Example: python tests/simulator.py 7 60",
    )
    parser.add_argument("seed", type=int, help="number that decides all that happens")
    parser.add_argument("seconds", type=float, help="simulated time [s]")
    options = parser.parse_args()
    done = simulate(options.seed, options.seconds)
    print(*done.log[-20:], sep="\n")
    print("events:", ", ".join(f"{name} {n}" for name, n in done.counts.most_common()))
    print(f"samples that sounded: {done.sounding}, compared with what was written: {done.exact}")
    for kind, longest in done.worst.items():
        print(f"longest time from {kind} to 0 V: {longest * 1e3:.0f} ms")
    sys.exit("broken promises:\n" + "\n".join(done.wrong) if done.wrong else 0)


if __name__ == "__main__":
    main()
