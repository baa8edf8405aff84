"""Virtual clock that goes on to the next event of any process, and the processes on it.

Each thread of a process is a greenlet that runs until it sleeps or waits; then the next one does
whose time has come. So everything happens in one order, which depends on nothing but what happens.
"""

import asyncio
import functools
import heapq
import itertools
import os
import pickle
import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import greenlet

from tactile.bus.link.link_bus import LinkBus

if TYPE_CHECKING:
    from virtual_server import World

T = TypeVar("T")
PIPE = 0.3e-3
"""Delay of a pipe from one process to another [s]."""
LONGEST = 60.0
"""Longest time for which a process without work waits at once [s]."""
LOOK = 2e-3
"""Interval after which a program that waits for a link checks whether it was woken [s]."""


class Killed(BaseException):
    """The process is killed; raised where its threads sleep."""


def never() -> bool:
    """Return False: nothing is awaited but the time."""
    return False


@dataclass(eq=False)
class Thread:
    """A thread of a process.

    Attributes
    ----------
    turn : number of its latest sleep
    awaited : condition that would wake it before its time
    held : whether its process hangs
    due : whether it would run, did its process not hang
    """

    run: Any
    turn: int = 0
    awaited: Callable[[], bool] = never
    held: bool = False
    due: bool = False


class VirtualClock:
    """Time of all processes [s], and what they will do when; it is a `Clock` for all of them."""

    def __init__(self) -> None:
        self.time = 1000.0
        self._events: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = itertools.count()
        self._threads: dict[Any, Thread] = {}

    def now(self) -> float:
        """Return the time [s]."""
        return self.time

    def after(self, seconds: float, work: Callable[[], object]) -> None:
        """Have something done later."""
        heapq.heappush(self._events, (self.time + seconds, next(self._numbers), work))

    def advance(self, seconds: float, awaited: Callable[[], bool] = never) -> None:
        """Let time pass, or less of it where what is awaited comes true."""
        end = self.time + seconds
        self._wake()
        while not awaited():
            if not self._events or self._events[0][0] > end:
                self.time = max(self.time, end)
                return
            when, _, work = heapq.heappop(self._events)
            self.time = max(self.time, when)
            work()
            self._wake()

    def forget(self) -> None:
        """Drop everything that was to be done later."""
        self._events.clear()

    # What threads do

    def start(self, work: Callable[[], None]) -> Thread:
        """Start a thread of a process; it runs until it sleeps, now and whenever it is woken."""
        thread = Thread(None)

        def body() -> None:
            try:
                work()
            except Killed:
                return
            finally:
                del self._threads[thread.run]

        thread.run = greenlet.greenlet(body)
        self._threads[thread.run] = thread
        self.after(0.0, lambda: self._go_on(thread, 0))
        return thread

    def sleep(self, seconds: float) -> None:
        """Let time pass, and others run."""
        thread = self._threads.get(greenlet.getcurrent())
        if thread is None:
            self.advance(max(seconds, 0.0))
            return
        turn = thread.turn = thread.turn + 1
        self.after(max(seconds, 0.0), lambda: self._go_on(thread, turn))
        _switch(thread.run.parent.switch)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Let time pass, or less of it where an event is set."""
        self.wait_for(event.is_set, seconds)

    def wait_for(self, awaited: Callable[[], bool], seconds: float) -> None:
        """Let time pass, or less of it where what is awaited comes true."""
        if awaited():
            return
        thread = self._threads.get(greenlet.getcurrent())
        if thread is None:
            self.advance(seconds, awaited)
            return
        thread.awaited = awaited
        self.sleep(seconds)
        thread.awaited = never

    def _wake(self) -> None:
        for thread in list(self._threads.values()):
            if not thread.held and thread.awaited():
                thread.awaited = never
                self._go_on(thread, thread.turn)

    def _go_on(self, thread: Thread, turn: int) -> None:
        if turn != thread.turn or thread.run.dead:
            return
        if thread.held:
            thread.due = True
            return
        thread.turn += 1  # what else would wake it is over
        thread.run.parent = greenlet.getcurrent()
        _switch(thread.run.switch)

    def hold(self, thread: Thread) -> None:
        """Let a thread stand still."""
        thread.held = True

    def release(self, thread: Thread) -> None:
        """Let a thread that stood still go on, with what it missed first."""
        thread.held = False
        if thread.due:
            thread.due = False
            turn = thread.turn
            self.after(0.0, lambda: self._go_on(thread, turn))

    def kill(self, *threads: Thread) -> None:
        """End threads where they sleep, the running one last."""
        current = greenlet.getcurrent()
        for thread in threads:
            thread.turn += 1
            if thread.run is not current and thread.run:
                thread.run.parent = current
                _switch(functools.partial(thread.run.throw, Killed))
            elif thread.run is not current:
                self._threads.pop(thread.run, None)
        if any(thread.run is current for thread in threads):
            raise Killed


def _switch(go: Callable[[], object]) -> None:
    """Go on in another thread; what asyncio remembers for a thread is this one's again after it."""
    loop, hooks = asyncio._get_running_loop(), sys.get_asyncgen_hooks()
    asyncio._set_running_loop(None)
    try:
        go()
    finally:
        asyncio._set_running_loop(loop)
        sys.set_asyncgen_hooks(*hooks)


class VirtualLock:
    """A lock of threads that may let time pass while they hold it.

    Those that wait have it in the order in which they came. It also serves as a Condition.

    Parameters
    ----------
    clock : clock of the threads
    reentrant : whether who has it may take it again
    """

    def __init__(self, clock: VirtualClock, *, reentrant: bool = True) -> None:
        self._clock, self._reentrant = clock, reentrant
        self._owner: greenlet.greenlet | None = None
        self._depth = 0
        self._waiting: deque[greenlet.greenlet] = deque()

    def acquire(self, seconds: float = LONGEST) -> bool:
        """Wait for the lock, for so long at most [s]; return whether it is had."""
        me = greenlet.getcurrent()
        if self._owner is me and not self._reentrant:
            raise RuntimeError("a thread waits for a lock that it has itself")
        if self._owner not in (None, me):
            self._waiting.append(me)
            try:
                self._clock.wait_for(lambda: self._owner is me, seconds)
            except Killed:
                if self._owner is me:
                    self._hand_over()
                else:
                    self._waiting.remove(me)
                raise
            if self._owner is not me:
                self._waiting.remove(me)
                return False
        self._owner, self._depth = me, self._depth + 1
        return True

    def release(self) -> None:
        """Give it back, once for each time that it was taken."""
        self._depth -= 1
        if not self._depth:
            self._hand_over()

    def _hand_over(self) -> None:
        self._owner = self._waiting.popleft() if self._waiting else None

    def locked(self) -> bool:
        """Return whether anybody has it."""
        return self._owner is not None

    def wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        """Give the lock back until something is so or time is over; return which."""
        me, depth = self._owner, self._depth
        self._depth = 0
        self._hand_over()
        try:
            self._clock.wait_for(done, seconds)
            self.acquire()
        finally:  # also where it is killed: so are all that might have the lock
            self._owner, self._depth = me, depth
        return done()

    def notify_all(self) -> None:
        """Do nothing: waiting threads check again whenever anything happens."""

    def __enter__(self) -> "VirtualLock":
        if not self.acquire():
            raise RuntimeError(f"a lock that nobody gives back within {LONGEST:g} s")
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


class ChipThread:
    """Substitute for `tactile.bus.chips.pump.ThreadRunner`, the thread that writes to chips.

    Parameters
    ----------
    clock : clock of all threads
    """

    thread: Thread

    def __init__(self, clock: VirtualClock) -> None:
        self.now, self.sleep, self.wait = clock.now, clock.sleep, clock.wait
        self.lock = VirtualLock(clock)
        self.wait_for = self.lock.wait_for
        self._clock, self._alarmed, self._ended = clock, False, False

    def begin(self, step: Callable[[], float | None]) -> None:
        """Start the thread."""
        self.thread = self._clock.start(lambda: self._run(step))

    def _run(self, step: Callable[[], float | None]) -> None:
        while not self._ended:
            deadline = step()
            left = LONGEST if deadline is None else max(0.0, deadline - self.now())
            self._clock.wait_for(lambda: self._alarmed, left)
            self._alarmed = False

    def alarm(self) -> None:
        """Let the step be called soon."""
        self._alarmed = True

    def end(self) -> None:
        """End the thread, later."""
        self._ended = True
        self.alarm()


class LinkTime:
    """Clock of a program with a bus that has no thread: waiting lets both of its ends go on.

    Parameters
    ----------
    bus : a link with a model
    """

    def __init__(self, bus: LinkBus) -> None:
        self._bus, self.now = bus, bus._clock.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        end = self.now() + seconds
        while self.now() < end:
            self._bus._turn(end)

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Let time pass, or little more of it than until an event is set."""
        end = self.now() + seconds
        while self.now() < end and not event.is_set():
            self._bus._turn(min(end, self.now() + LOOK))


class Process:
    """Substitute for `tactile.server.children.Child`: the server's end and the process.

    Parameters
    ----------
    world : world of the process
    module, on_answer, inherited : parameters of `Child`
    """

    def __init__(
        self, world: "World", module: str, on_answer: Callable[[Any], None],
        inherited: tuple[int, ...] = (),
    ) -> None:  # fmt: skip
        self.world, self.clock, self._heard = world, world.clock, on_answer
        self._loop = asyncio.get_running_loop()
        self._files = {file: os.dup(file) for file in inherited}
        self.pid = next(world.numbers)
        self.alive, self.ending, self.hung = True, False, False
        world.processes.append(self)

    # The server's end

    @property
    def of_server(self) -> bool:
        """Whether the server that started the process is the one that runs."""
        return self._loop is self.world.loop

    def send(self, order: object) -> None:
        """Send an order, or bytes that are the pickle of one."""
        data = order if isinstance(order, bytes) else pickle.dumps(order, protocol=5)
        self.clock.after(PIPE, lambda: self._deliver(data))

    async def end(self, patience: float) -> None:
        """Close the input of the process and wait for its end; kill it after a while."""
        self.hang_up()
        deadline = self._loop.time() + patience
        while self.alive and self._loop.time() < deadline:
            await asyncio.sleep(0.01)
        self.kill()

    def hang_up(self) -> None:
        """Close its input."""
        self.clock.after(PIPE, self._deliver_end)

    def kill(self) -> None:
        """End it at once."""
        if self.alive:
            self.alive = False
            for file in self._files.values():
                os.close(file)
            self.world.processes.remove(self)
            self._post(None)
            self.let_go()  # last: it does not return to a thread that ends its own process

    # The process

    def handle(self, of_server: str) -> str:
        """Return the handle of a file for a mapping of this process's own."""
        return f"fd:{self._files[int(of_server.partition(':')[2])]}"

    def answer(self, what: object) -> None:
        """Send an answer."""
        self._post(pickle.dumps(what, protocol=5))

    def _post(self, data: bytes | None) -> None:
        def arrive() -> None:
            if self.of_server:
                order = None if data is None else pickle.loads(data)
                self._loop.call_soon_threadsafe(self._heard, order)

        self.clock.after(PIPE, arrive)

    def _deliver(self, data: bytes) -> None:
        if self.alive:
            self.receive(pickle.loads(data))

    def _deliver_end(self) -> None:
        self.ending = True
        if self.alive and not self.hung:
            self.finish()

    def receive(self, order: Any) -> None:
        """Take an order."""
        raise NotImplementedError

    def finish(self) -> None:
        """End in good order."""
        self.kill()

    def let_go(self) -> None:
        """Unmap the memory that the process shares."""
