"""The one thread that writes to chips: absolute deadlines, retries, ends at 0 V.

The amplifier in memory (`Board`) is played as fast as the first chip plays; what it puts out goes
to that chip sample by sample, to the others stretched by a sample now and then, for each chip has
its own clock. The pump never waits for what is written to it: where nothing is, the amplifier
fades, as one with firmware does.

A transfer that fails is repeated after `BACK_OFF`, while the FIFOs last. Then, or where nobody
knows what a chip took, the link is down: the amplifier is no longer fed and so fades out, its time
goes on by the host's clock, and the chips are set up again until that succeeds; then the amplifier
is fed again and fades in.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Literal, Protocol

import numpy as np

from tactile.arrays import Floats
from tactile.bus.board import Board
from tactile.bus.chips.chip import BURST, LEAST, Chip, ChipCounters, LostError
from tactile.bus.chips.occupancy import RATE
from tactile.clock import Clock, MonotonicClock
from tactile.errors import BusError

QUEUE = 64
"""Samples that wait in the amplifier at most, 8 ms."""
LOW = 40
"""Samples in the first FIFO below which the amplifier plays on, whether or not it has any."""
PATIENCE = 10e-3
"""s after the first write until playing begins though less than a burst came."""
BACK_OFF = (0.5e-3, 4e-3)
"""s between repeated transfers: at first, at most."""
RECONNECT = (10e-3, 0.5)
"""s between attempts to set up again: at first, at most."""
TICK = 4e-3
"""s between looks at what has no deadline of its own."""
IDLE_POLL = 0.5e-3
"""s until the next look where there was nothing to play; what is written wakes it sooner."""
QUIET_POLL = 1e-3
"""s between looks whether chips have played all."""

Order = Literal["", "start", "stop", "abort", "estop"]
Phase = Literal["rest", "ready", "running", "ending", "down"]


class Runner(Clock, Protocol):
    """What calls the pump, and by which clock: a thread, or a test's virtual time."""

    @property
    def lock(self) -> threading.Condition:
        """What guards the amplifier, and is notified after each step."""
        ...

    def begin(self, step: Callable[[], float | None]) -> None:
        """Call ``step`` again at the time that it returns, on `alarm` at once; None: only then."""
        ...

    def alarm(self) -> None:
        """Let the step be called soon."""
        ...

    def wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        """Wait, with the lock held, until something is so or time is over; return which."""
        ...

    def end(self) -> None:
        """Call it no more."""
        ...


class ThreadRunner(MonotonicClock):
    """A thread of its own by the monotonic clock."""

    def __init__(self) -> None:
        self._lock = threading.Condition()
        self._alarmed = self._ended = False
        self._thread: threading.Thread | None = None

    @property
    def lock(self) -> threading.Condition:
        """What guards the amplifier, and is notified after each step."""
        return self._lock

    def begin(self, step: Callable[[], float | None]) -> None:
        """Start the thread."""
        self._thread = threading.Thread(
            target=self._run, args=(step,), name="tactile chips", daemon=True
        )
        self._thread.start()

    def _run(self, step: Callable[[], float | None]) -> None:
        while True:
            deadline = step()
            with self.lock:
                self.lock.notify_all()
                if not self._alarmed:
                    left = None if deadline is None else max(0.0, deadline - self.now())
                    self.lock.wait_for(lambda: self._alarmed, left)
                if self._ended:
                    return
                self._alarmed = False

    def alarm(self) -> None:
        """Let the step be called soon."""
        with self.lock:
            self._alarmed = True
            self.lock.notify_all()

    def wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        """Wait, with the lock held, until something is so or time is over; return which."""
        with self.lock:
            return self.lock.wait_for(done, seconds)

    def end(self) -> None:
        """End the thread."""
        if self._thread is not None:
            with self.lock:
                self._ended = True
                self.alarm()
            self._thread.join(timeout=5.0)
            self._thread = None


def share(first: int, room: int, waiting: int) -> int:
    """Return how many samples a chip gets when the first one gets ``first``.

    As many, or up to a sixteenth more or fewer where its own clock has made more or less room;
    what does not fit waits.
    """
    most = 1 + first // 16
    return max(1, min(max(room - waiting, first - most), first + most))


class Pump:
    """Plays an amplifier in memory on chips.

    Parameters
    ----------
    board, chips, counters : the amplifier, a chip for each of its channels, what to count in
    runner : whose thread calls `step`; its lock guards the amplifier

    Attributes
    ----------
    phase : "rest" (high voltage off), "ready", "running", "ending" or "down"
    position : that the amplifier plays next
    detail : what is wrong, one line
    """

    def __init__(
        self, board: Board, chips: Sequence[Chip], counters: ChipCounters, runner: Runner
    ) -> None:
        self.board, self.chips, self.counters, self.runner = board, chips, counters, runner
        self.phase: Phase = "rest"
        self.position = self.sent = 0
        self.detail = ""
        self.hungry = False
        self._order: Order = ""
        self._playing = self._cutting = self._estopped = False
        self._resume = self._awake = False
        self._first_write = -1.0
        self._eager = False
        self._retry = self._reconnect = self._since = 0.0
        self._delay = 0.0

    # What the bus asks, with the lock held

    def order(self, order: Order) -> None:
        """Ask for a change; an e-stop overtakes every other, nothing an e-stop."""
        if self._order != "estop":
            self._order = order
        self.runner.alarm()

    def start(self, position: int, rate: int) -> None:
        """Let the amplifier play from a position on; the chips are set up by the thread."""
        self.board.start(position, rate)
        self.position = self.sent = position
        self._playing, self._first_write, self._eager = True, -1.0, False
        self.order("start")

    def send(self, position: int, volts: Floats) -> None:
        """Hand on samples to the amplifier."""
        self.board.send(position, volts)
        self.sent = max(self.sent, position + len(volts))
        if self._first_write < 0:
            self._first_write = self.runner.now()
        if self.hungry or self.phase == "ready":
            self.hungry = False
            self.runner.alarm()

    def hurry(self) -> None:
        """Begin to play, however little has come: somebody waits for it."""
        if self.phase == "ready" and not self._eager:
            self._eager = True
            self.runner.alarm()

    @property
    def settled(self) -> bool:
        """Whether nothing is under way to 0 V any more."""
        return not self._order and self.phase in ("rest", "down")

    # The thread

    def step(self) -> float | None:
        """Do what is due; return when to be called again [s], None for not before an order."""
        with self.runner.lock:
            order, self._order = self._order, ""
        try:
            if order:
                self._obey(order)
            return self._act()
        except OSError as error:
            return self._trouble(error)
        except Exception as error:
            self._lose(f"unforeseen: {error!r}")
            return self._reconnect

    def _obey(self, order: Order) -> None:
        if order == "start":
            self._resume, self._estopped = True, False
            self._since = self.runner.now()
            if self.phase != "down":
                self._wake()
                self.phase = "ready"
            return
        with self.runner.lock:
            tail = self._end_board(order)
        self._resume = False
        self._estopped |= order == "estop"
        if self.phase == "ready" or (self.phase == "ending" and order != "estop"):
            self.phase = "ending"
        elif self.phase in ("running", "ending"):
            self.phase = "ending"
            self._cutting = order == "estop"
            if not self._cutting:
                self._put(np.concatenate([tail, np.zeros((1, len(self.chips)))]))

    def _end_board(self, order: Order) -> Floats:
        was, self._playing = self._playing, False
        if order == "estop":
            return self.board.estop()
        if was:
            return self.board.end(quick=order == "abort")
        return np.zeros((0, len(self.chips)))

    def _act(self) -> float | None:
        if self.phase == "rest":
            return None
        if self.phase == "down":
            return self._down()
        if self.runner.now() < self._retry:
            return self._retry
        deadline = {"ready": self._ready, "running": self._feed, "ending": self._end}[self.phase]()
        self._delay = self._retry = 0.0
        self.detail = ""
        return deadline

    def _wake(self) -> None:
        for chip in self.chips:
            chip.wake()
        for chip in self.chips:
            chip.calibrate()

    def _ready(self) -> float | None:
        """Wait for what is to be played, then let the chips start up."""
        if self._first_write < 0 and not self._eager:
            return None
        now, until = self.runner.now(), self._first_write + PATIENCE
        if not self._eager and self.sent - self.position < BURST and now < until:
            return until
        self._warm()
        self.phase = "running"
        return self._feed()

    def _warm(self) -> None:
        for chip in self.chips:
            chip.warm()
        for chip in self.chips:
            chip.ready()

    def _feed(self) -> float:
        first = self.chips[0]
        queued = max(0, self.sent - self.position)
        needed = LOW - min(chip.fill() + len(chip.pending) for chip in self.chips)
        count = min(first.wanted(), max(queued, needed), 2 * BURST)
        if BURST < count < BURST + LEAST:
            count = BURST
        fed = count >= LEAST or count >= needed > 0
        if fed:
            with self.runner.lock:
                volts = self._played(count)
                self.runner.lock.notify_all()
            self._put(volts)
        for chip in self.chips:
            chip.flush()
        self.hungry = not fed
        due = min(chip.due() for chip in self.chips)
        now = self.runner.now()
        return due if fed or due > now else now + IDLE_POLL

    def _played(self, count: int) -> Floats:
        if not self._playing:
            return np.zeros((count, len(self.chips)))
        volts = self.board.play(count)
        self.position += len(volts)
        self.counters.underruns = self.board.amplifier.counters.underruns
        return volts

    def _put(self, volts: Floats) -> None:
        """Give all chips the same volts; nothing may fail between them, for then one would jump."""
        if not len(volts):
            return
        first = self.chips[0]
        first.put(volts[:, 0], len(volts))
        for k, chip in enumerate(self.chips[1:], 1):
            room = chip.room_at(self.runner.now())
            chip.put(volts[:, k], share(len(volts), room, len(chip.pending)))

    def _end(self) -> float:
        """Write what leads to 0 V, wait until it has been played, switch off."""
        if self._cutting:
            for chip in self.chips:
                chip.cut()
            self._cutting = False
        for chip in self.chips:
            chip.flush()
        if any(chip.pending for chip in self.chips):
            return min(chip.due() for chip in self.chips if chip.pending)
        if not all(chip.quiet() for chip in self.chips):
            return self.runner.now() + QUIET_POLL
        for chip in self.chips:
            chip.rest()
        self.phase = "rest"
        return self.runner.now()

    # What goes wrong

    def _trouble(self, error: OSError) -> float:
        self.counters.bus_errors += 1
        now = self.runner.now()
        if self.phase == "down":
            self._awake = False
            self.detail = f"{error}; trying again"
            self._delay = min(self._delay * 2, RECONNECT[1])
            self._reconnect = now + self._delay
            return self._deadline_down()
        lost = isinstance(error, BusError | LostError) or self.phase in ("rest", "ready")
        if lost or now > min(chip.lost_at for chip in self.chips):
            self._lose(str(error))
            return self._deadline_down()
        self.detail = f"{error}; trying again"
        self._delay = min(max(self._delay * 2, BACK_OFF[0]), BACK_OFF[1])
        self._retry = now + self._delay
        return self._retry

    def _lose(self, reason: str) -> None:
        """Take the link for down; in an e-stop switch off at once, whatever the voltage."""
        now = self.runner.now()
        self.counters.disconnects += 1
        self.counters.dropped_samples += max(0, self.sent - self.position)
        self.detail = reason
        self.phase, self._since, self._awake = "down", now, False
        self._delay = RECONNECT[0]
        self._reconnect = now + (0.0 if self._estopped else self._delay)
        self._retry = 0.0

    def _deadline_down(self) -> float:
        return min(self._reconnect, self.runner.now() + TICK) if self._resume else self._reconnect

    def _down(self) -> float:
        """Let time go on, and try to set up again."""
        self._pass_time()
        if self.runner.now() < self._reconnect:
            return self._deadline_down()
        if self._estopped:
            for chip in self.chips:
                chip.reset()
        if not self._awake:
            self._wake()
            self._awake = True
            self._pass_time()
        if self._resume and not self._silent():
            self._reconnect = self.runner.now() + TICK
            return self._reconnect
        if self._resume:
            self._warm()
            self._pass_time()
        self.counters.reconnects += 1
        self._delay = 0.0
        self.detail = ""
        self.phase = "running" if self._resume else "ending"
        return self.runner.now()

    def _silent(self) -> bool:
        with self.runner.lock:
            return not self._playing or not self._played(1).any()

    def _pass_time(self) -> None:
        """Play the amplifier by the host's clock for nobody."""
        now = self.runner.now()
        count = int((now - self._since) * RATE)
        self._since += count / RATE
        longest = int(RATE * TICK)
        for k in range(0, count, longest):
            with self.runner.lock:
                self._played(min(longest, count - k))
