"""A server on a virtual clock: all of it is real but process boundaries and time.

`Host`, `Playing`, `Client`, `Desk`, `Program`, `PlaybackLoop`, the latch's file, the shared memory
and the amplifier are the real ones. Time passes only where the event loop has nothing to do, and
then at once, as far as the next thing that any process does; a process is a set of calls on the
clock, so that it can hang, or be killed, at any of them while the others go on.
"""

import asyncio
import atexit
import functools
import itertools
import logging
import os
import pickle
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar
from unittest.mock import patch

import numpy as np
from chip_models import ModelBus
from numpy.typing import NDArray
from virtual_clock import (
    PIPE,
    ChipThread,
    LinkTime,
    Process,
    Thread,
    VirtualClock,
    VirtualLock,
)
from virtual_loop import Errors, LoopProcess

from firmware_protocol.machine import PlayedRun
from tactile.arrays import Floats
from tactile.bus.base import RATE, Bus, DisplayLike, DriveBlock, DriveFrame, Wiring
from tactile.bus.chips.chip_bus import ChipBus
from tactile.bus.registry import Address, register_bus
from tactile.bus.simulated.line_model import Model
from tactile.bus.simulated.mock_bus import MockBus, open_mock
from tactile.bus.simulated.modeled_bus import (
    MockOptions,
    ModeledBus,
    model_of,
    open_modeled,
)
from tactile.display.display import Display, load_with_source
from tactile.errors import TactileError
from tactile.estop.latch import Latch, LatchWriter
from tactile.estop.process import Desk, EstopReady, EstopSetup
from tactile.files import SourceFile
from tactile.playback import commands
from tactile.playback import process as playback_process
from tactile.playback.commands import DeviceOpened, PlaybackSetup
from tactile.playback.estimates import OwnEstimates
from tactile.playback.loop import PlaybackLoop
from tactile.playback.mixer import BlockInput, Mixer
from tactile.playback.process import Program
from tactile.playback.session_messages import RecorderAnswer, SessionSetup
from tactile.playback.session_orders import TextureDescription
from tactile.playback.session_recorder import LOOK, SessionRecorder, completed, new_folder
from tactile.playback.session_ring import SessionRing
from tactile.playback.shared_memory import PlaybackMemory
from tactile.server import host, preparing
from tactile.server.config import Configuration
from tactile.server.host import Host
from tactile.server.server import running
from tactile.sim import SimulatedDisplay

T = TypeVar("T")
OPENING, PREPARING = 20e-3, 30e-3
"""Times that it takes to open a device, and to prepare a texture [s]."""
RENDERING = 0.2e-3
"""Time that it takes to render a block [s]."""
ALONE = 5e-3
"""Longest time after which amplifiers on a link go on by themselves [s]."""


class EstopProcess(Process):
    """The e-stop process: a real `Desk`."""

    desk: Desk | None = None

    def receive(self, order: Any) -> None:
        assert isinstance(order, EstopSetup)
        self._latches = {
            name: Latch(f"fd:{os.dup(int(self.handle(one).partition(':')[2]))}",
                        LatchWriter.ESTOP_PROCESS)
            for name, one in order.latches.items()
        }  # fmt: skip
        self.desk = Desk(self._latches)
        self.answer(EstopReady("here"))

    def let_go(self) -> None:
        if self.desk is not None:
            for latch in self._latches.values():
                latch.close()
            self.desk = None


class PreparationProcess(Process):
    """Process that prepares and draws textures; each is prepared once for all servers."""

    def receive(self, order: Any) -> None:
        if isinstance(order, preparing.DrawingRequest):
            self.clock.after(PREPARING, lambda: self.answer(preparing.answer_to(order)))
            return
        assert isinstance(order, preparing.PreparationRequest)
        try:
            stored = Stored(order)
            keep = commands.KeepTexture(order.number, stored)  # type: ignore[arg-type]
            kept = preparing.order_number(order.number), keep
            description = replace(stored.description, number=order.number)
            made = preparing.Preparation(order.number, pickle.dumps(kept), description)
        except TactileError as error:
            made = preparing.Preparation(order.number, failure=str(error))
        self.clock.after(PREPARING, lambda: self.answer(made))


PREPARED: dict[bytes, tuple[commands.PreparedTexture, TextureDescription]] = {}
"""Textures that were prepared, with what they were realized from, by the pickles of requests but
for their numbers."""


class Stored:
    """A texture that is unpickled as the one that was prepared before: it has 17 MB."""

    def __init__(self, request: preparing.PreparationRequest) -> None:
        self._key = pickle.dumps(replace(request, number=0))
        if self._key not in PREPARED:
            PREPARED[self._key] = preparing.prepare(request)
        self.description = PREPARED[self._key][1]

    def __reduce__(self) -> Any:
        return _prepared, (self._key,)


def _prepared(key: bytes) -> commands.PreparedTexture:
    return PREPARED[key][0]


class PlaybackProcess(Process):
    """A playback process: real `Program`, `PlaybackLoop` and bus, in two threads."""

    program: Program | None = None
    bus: MockBus | ModeledBus | ChipBus
    device = ""
    within: Callable[[], object] | None = None
    """Done once in the middle of what the loop does next, as another thread would."""
    threads: tuple[Thread, ...] = ()
    _ring: SessionRing | None = None

    def receive(self, order: Any) -> None:
        if isinstance(order, PlaybackSetup):
            self._start(lambda: self._play(order))
        elif self.program is not None:
            self.program.take(*order)

    def _start(self, work: Callable[[], None]) -> None:
        def run() -> None:
            try:
                work()
            except Exception as error:
                self.world.errors.all.append(f"a thread of playback: {error!r}")
                self.kill()

        self.threads += (self.clock.start(run),)

    def _play(self, setup: PlaybackSetup) -> None:
        self.clock.sleep(OPENING)
        try:
            bus, how = playback_process.open_device(setup)
            following = playback_process.follow(setup, bus, OwnEstimates)
        except TactileError as error:
            self.answer(DeviceOpened(why_not=str(error)))
            self.clock.sleep(PIPE)
            self.kill()
            return
        assert isinstance(bus, MockBus | ModeledBus | ChipBus)
        self.bus, self.device = bus, setup.device
        if isinstance(bus, SimulatedDisplay):
            bus._clock = self.clock
        if isinstance(bus, ChipBus):
            assert isinstance(bus.pump.runner, ChipThread)
            self.threads += (bus.pump.runner.thread,)
            atexit.unregister(bus.close)
        file = int(self.handle(setup.memory).partition(":")[2])
        self._memory = PlaybackMemory(f"fd:{os.dup(file)}", len(setup.display.contactors))
        file = int(self.handle(setup.latch).partition(":")[2])
        self._latch = Latch(f"fd:{os.dup(file)}", LatchWriter.PLAYBACK)
        clock = LinkTime(bus) if isinstance(bus, ModeledBus) else self.clock
        if setup.session:
            file = int(self.handle(setup.session).partition(":")[2])
            self._ring = SessionRing(f"fd:{os.dup(file)}")
        player = PlaybackLoop(
            setup.display, bus, self._memory,
            gain=setup.gain, worn=setup.worn, clock=clock, session=self._ring, following=following,
        )  # fmt: skip
        self.program = Program(player, self._latch, self.answer)
        self.world.by_bus[id(bus)] = self
        self.answer(replace(how, follows=following is not None))
        self._start(self.program.watch)
        self.program.run()
        self.kill()

    def interrupt(self) -> None:
        """Let what is to come in the middle come, and the thread that watches look."""
        program = self.program
        if self.within is not None and program is not None and not program._stopping.locked():
            work, self.within = self.within, None
            work()
            program.look_at_latch()

    def hang(self, seconds: float) -> None:
        """Stand still for a while."""
        self.hung = True
        for thread in self.threads:
            self.clock.hold(thread)
        self.clock.after(seconds, self._resume)

    def _resume(self) -> None:
        self.hung = False
        for thread in self.threads:
            self.clock.release(thread)
        if self.ending and self.alive:
            self.finish()

    def finish(self) -> None:
        if self.program is None:
            self.kill()
        else:
            self.program.end()

    def let_go(self) -> None:
        if self.program is not None:
            self.world.by_bus.pop(id(self.bus), None)
            self._latch.close()
            self._memory.close()
            if self._ring is not None:
                self._ring.close()
            vars(self.bus)["close"] = lambda: None  # what ends its threads is no end in good order
        self.clock.kill(*self.threads)


class RecorderProcess(Process):
    """The process that records a session: a real `SessionRecorder`."""

    recorder: SessionRecorder | None = None

    def receive(self, order: Any) -> None:
        if isinstance(order, SessionSetup):
            file = int(self.handle(order.ring).partition(":")[2])
            self._ring = SessionRing(f"fd:{os.dup(file)}")
            folder = new_folder(Path(order.folder), order.header.name)
            header = completed(order.header, self.clock.now())
            self.recorder = SessionRecorder(folder, header, self._ring)
            self.answer(RecorderAnswer(str(folder)))
            self._look()
        else:
            assert self.recorder is not None
            self.recorder.take(order)

    def _look(self) -> None:
        if not self.alive or self.recorder is None:
            return
        try:
            self.recorder.turn(self.clock.now())
        except OSError as error:
            self.answer(RecorderAnswer(failure=str(error)))
            self.clock.after(0.0, self.kill)
        else:
            self.clock.after(LOOK, self._look)

    def finish(self) -> None:
        if self.recorder is not None:
            self.recorder.turn(self.clock.now(), last=True)
        self.kill()

    def let_go(self) -> None:
        if self.recorder is not None:
            self._ring.close()


KINDS: dict[str, type[Process]] = {
    "tactile.playback.session_recorder": RecorderProcess,
    "tactile.playback.process": PlaybackProcess,
    "tactile.server.preparing": PreparationProcess,
    "tactile.estop.process": EstopProcess,
}


class World:
    """A clock, a server and its processes.

    Parameters
    ----------
    put_out : called with a playback process and what its amplifier puts out (S, C) [V]
    """

    def __init__(self, put_out: Callable[[PlaybackProcess, Floats], None]) -> None:
        self.clock, self.errors = VirtualClock(), Errors()
        self.numbers = itertools.count(1)
        self.processes: list[Process] = []
        self.by_bus: dict[int, PlaybackProcess] = {}
        self.put_out = put_out
        self.models: dict[str, Model] = {}
        self.adapters: dict[str, ModelBus] = {}
        """I²C adapters with chips, by their paths."""
        self.on_link: Callable[[Address[MockOptions], Model, int, PlayedRun], None] = lambda *_: (
            None
        )
        """Function that gets all that an amplifier on a link puts out, also when no host talks to
        it."""
        self.server: LoopProcess | None = None
        self.host: Host | None = None
        self.killed: list[LoopProcess] = []
        self.stalled: float | None = None

    # The server

    @property
    def loop(self) -> asyncio.AbstractEventLoop | None:
        """Event loop of the server that runs."""
        return None if self.server is None else self.server.loop

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Run the server's event loop until something is done."""
        assert self.server is not None
        return self.server.run(work)

    def start(self, config: Configuration, *, listening: bool = False) -> bool:
        """Start a server, which listens or does not; return whether it had what it needs."""
        server = self.server = LoopProcess(self.clock, self.errors)

        async def started() -> Host:
            host = Host(config, clock=self.clock)
            if listening:
                await server.opened.enter_async_context(running(config, host=host))
            else:
                await host.start()
                server.opened.push_async_callback(host.close)
            return host

        try:
            self.host = self.run(started())
        except TactileError:
            server.end()
            self.server = None
            return False
        return True

    def stop(self) -> None:
        """End the server in good order."""
        assert self.server is not None
        self.server.end()
        self.server = self.host = None

    def kill(self) -> None:
        """Kill the server: nothing of it runs any more, its pipes and files are closed."""
        assert self.host is not None
        assert self.server is not None
        self.server.kill()
        self.killed.append(self.server)
        for playing in self.host.playing.values():
            playing.latch._writer = (
                LatchWriter.PLAYBACK
            )  # who is killed unlocks nothing: a child may
            playing.latch.close()  # have the file still
            playing.memory.close()
            for one in (playing.latch, playing.memory):  # whose files' numbers others have soon
                vars(one)["close"] = lambda: None
        for process in list(self.processes):
            process.hang_up()
        self.server = self.host = None

    def stall(self, seconds: float) -> None:
        """Let the server's event loop stand still, all other processes going on."""
        assert self.server is not None
        self.stalled = self.clock.now()
        self.server.hang(seconds)
        self.clock.advance(seconds)
        self.stalled = None

    # The amplifiers

    def open_bus(
        self, address: Address[MockOptions], rig: DisplayLike, sample_rate: float | None
    ) -> Bus:
        """Open amplifiers in memory; those on a link are the same ones each time."""
        if address.options.link is None:
            return open_mock(address, rig, sample_rate, self.clock)
        name = str(address)
        if name not in self.models:
            wiring = Wiring.of(rig, sample_rate or RATE)
            model = self.models[name] = model_of(address.options, wiring, self.clock)
            vars(model)["report_output"] = lambda: self._listen(address, model)
            self._go_on(model)
        bus = open_modeled(address.options, rig, sample_rate, self.models[name])
        vars(bus)["_turn"] = self._in_turn(bus._turn)
        return bus

    def _in_turn(self, turn: Callable[[float], None]) -> Callable[[float], None]:
        """Let one thread at a time wait for what comes on a link, as real links have only one."""
        lock = VirtualLock(self.clock)

        def in_turn(until: float) -> None:
            if lock.acquire(until - self.clock.now()):
                try:
                    turn(until)
                finally:
                    lock.release()

        return in_turn

    def _listen(self, address: Address[MockOptions], model: Model) -> None:
        for board, amplifier in enumerate(model.amplifiers):
            for run in amplifier.take_played():
                self.on_link(address, model, board, run)
                model.on_output(board, run)

    def _go_on(self, model: Model) -> None:
        """Let amplifiers go on, also when no host talks to them."""
        model.exchange()
        model.report_output()
        self.clock.after(ALONE, lambda: self._go_on(model))

    # The processes

    @property
    def threading(self) -> SimpleNamespace:
        """Substitute for the module `threading`: locks that threads wait for on the clock."""
        again = functools.partial(VirtualLock, self.clock)
        once = functools.partial(again, reentrant=False)
        return SimpleNamespace(Lock=once, RLock=again, Condition=again, Event=threading.Event)

    def child(
        self, module: str, on_answer: Callable[[Any], None], inherited: tuple[int, ...] = ()
    ) -> Process:
        """Start a process."""
        return KINDS[module](self, module, on_answer, inherited)

    @property
    def desk(self) -> Desk | None:
        """Desk that `tactile estop` reaches."""
        desks = [p.desk for p in self.processes if isinstance(p, EstopProcess) and p.desk]
        return desks[-1] if desks else None

    def playbacks(self, device: str = "") -> list[PlaybackProcess]:
        """Return the playback processes that have opened a device."""
        return [p for p in self.by_bus.values() if device in ("", p.device)]

    def close(self) -> None:
        """End everything."""
        if self.host is not None:
            self.kill()
        for process in list(self.processes):
            process.kill()
        self.clock.forget()
        for one in self.killed:
            one.bury()


async def _inline(work: Callable[..., T], *words: Any) -> T:
    """Do here what `asyncio.to_thread` does elsewhere."""
    return work(*words)


@functools.cache
def _display(name: str) -> tuple[Display, SourceFile]:
    return load_with_source(name)


_textures = functools.cache(host.shipped_textures)


def _stand_ins(world: World) -> dict[str, object]:
    """Return what stands in a world for time, processes and threads, by the names of those."""
    threads = world.threading
    return {
        "asyncio.to_thread": _inline,
        "tactile.server.playing.Child": world.child,
        "tactile.server.estop_desk.Child": world.child,
        "tactile.server.preparation_queue.Child": world.child,
        "tactile.server.config.load_with_source": _display,
        "tactile.server.session_recording.Child": world.child,
        "tactile.server.host.shipped_textures": lambda: dict(_textures()),
        "tactile.playback.process.threading": threads,
        "tactile.bus.base.threading": threads,
        "tactile.bus.link.link_bus.threading": threads,
        "tactile.bus.chips.adapter.open_adapter": world.adapters.__getitem__,
        "tactile.bus.chips.drv2667.ThreadRunner": lambda: ChipThread(world.clock),
    }


@contextmanager
def virtual_world(put_out: Callable[[PlaybackProcess, Floats], None]) -> Iterator[World]:
    """Put a world in place of time and of processes.

    Parameters
    ----------
    put_out : called with a playback process and what its amplifier puts out (S, C) [V]
    """
    _textures()  # before time stands still
    world = World(put_out)

    def put(bus: MockBus, volts: Floats, _lines: NDArray[np.uint8]) -> None:
        if id(bus) in world.by_bus:
            put_out(world.by_bus[id(bus)], volts)

    def render(loop: PlaybackLoop, block: BlockInput) -> DriveBlock | DriveFrame:
        interrupt(loop.bus)
        world.clock.sleep(RENDERING)
        return Mixer.render(loop, block)

    def interrupt(bus: Any) -> None:
        if id(bus) in world.by_bus:
            world.by_bus[id(bus)].interrupt()

    logger = logging.getLogger("tactile")
    with ExitStack() as stack:
        stack.enter_context(patch.dict("tactile.bus.registry._drivers"))
        register_bus("mock", world.open_bus, MockOptions)
        stand_ins = {
            **_stand_ins(world),
            "tactile.bus.simulated.mock_bus.MockBus._put": put,
        }
        for name, instead in stand_ins.items():
            stack.enter_context(patch(name, instead))
        stack.enter_context(patch.object(PlaybackLoop, "render", render))
        logger.addHandler(world.errors)
        stack.callback(logger.removeHandler, world.errors)
        stack.enter_context(closing(world))
        yield world


def small_display(folder: Path) -> str:
    """Write a display of two contactors that slews slowly enough for that to be seen."""
    path = folder / "small.toml"
    path.write_text(
        '[display]\nid = "small"\ndescription = "two benders"\nopening_mm = [2.0, 3.0]\n'
        "[grid]\ncolumns = 2\nrows = 1\npitch_mm = [2.5, 3.5]\n"
        '[finger]\npreset = "low"\n[limits]\nvoltage_v = 60.0\nslew_v_per_us = 0.02\n'
    )
    return str(path)
