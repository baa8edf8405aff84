"""Thread that writes to the chips: absolute deadlines, retries, and ends at 0 V.

The amplifier in memory (`Board`) is played as fast as the first chip plays. That chip gets each
sample of its output. For the others a sample is inserted or removed now and then, because each chip
has its own clock. The pump never waits for samples from the host: if there are none, the amplifier
fades, as one with firmware does.

A transfer that fails is repeated after `BACK_OFF`, as long as the FIFOs last. When they do not, or
when it is unknown what a chip took, the link is down. The amplifier is then no longer fed and
therefore fades out, and its time advances by the host's clock. The chips are set up again until
that succeeds; then the amplifier is fed again and fades in.
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
"""Largest number of samples that wait in the amplifier, 8 ms."""
LOW = 40
"""Number of samples that every chip should have, in its FIFO or queued for it.

Below it the amplifier plays even if it has no samples.
"""
PATIENCE = 10e-3
"""Time after the first write at which playing begins even without a whole burst [s]."""
BACK_OFF = (0.5e-3, 4e-3)
"""Shortest and longest interval between repeated transfers [s]."""
RECONNECT = (10e-3, 0.5)
"""Shortest and longest interval between attempts to set up again [s]."""
TICK = 4e-3
"""Interval between steps that have no deadline of their own [s]."""
IDLE_POLL = 0.5e-3
"""Interval to the next step if there was nothing to play [s].

A write ends it sooner.
"""
QUIET_POLL = 1e-3
"""Interval between checks whether the chips have played everything [s]."""

Order = Literal["", "start", "stop", "abort", "estop"]
Phase = Literal["rest", "ready", "running", "ending", "down"]


class Runner(Clock, Protocol):
    """Executor and clock of the pump: a thread, or the virtual time of a test."""

    @property
    def lock(self) -> threading.Condition:
        """Condition that guards the amplifier, and is notified after each step."""
        ...

    def begin(self, step: Callable[[], float | None]) -> None:
        """Call a step again and again.

        Parameters
        ----------
        step : callable
            Function that returns the time of its next call [s], or None to be called after `alarm`
            only.
        """
        ...

    def alarm(self) -> None:
        """Call the step without waiting for its time."""
        ...

    def wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        """Wait, with the lock held, until a condition holds or the time is over.

        Parameters
        ----------
        done : callable
            Condition.
        seconds : float
            Time limit [s].

        Returns
        -------
        bool
            Whether the condition holds.
        """
        ...

    def end(self) -> None:
        """Call the step no more."""
        ...


class ThreadRunner(MonotonicClock):
    """Executor with a thread of its own and the monotonic clock."""

    def __init__(self) -> None:
        self._lock = threading.Condition()
        self._alarmed = self._ended = False
        self._thread: threading.Thread | None = None

    @property
    def lock(self) -> threading.Condition:
        """Condition that guards the amplifier, and is notified after each step."""
        return self._lock

    def begin(self, step: Callable[[], float | None]) -> None:
        """Start the thread.

        Parameters
        ----------
        step : callable
            Function that returns the time of its next call [s], or None to be called after `alarm`
            only.
        """
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
        """Call the step without waiting for its time."""
        with self.lock:
            self._alarmed = True
            self.lock.notify_all()

    def wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        """Wait, with the lock held, until a condition holds or the time is over.

        Parameters
        ----------
        done : callable
            Condition.
        seconds : float
            Time limit [s].

        Returns
        -------
        bool
            Whether the condition holds.
        """
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
    """Return how many samples a chip gets when the first chip gets a given number.

    It is the same number, or up to 1/16 more or fewer if the chip's own clock has made more or less
    room. Samples that do not fit wait.

    Parameters
    ----------
    first : int
        Number of samples for the first chip.
    room : int
        Number of samples that fit into the FIFO of this chip.
    waiting : int
        Number of samples that already wait for this chip.

    Returns
    -------
    int
        Number of samples, at least 1.
    """
    most = 1 + first // 16
    return max(1, min(max(room - waiting, first - most), first + most))


class Pump:
    """Playback of an amplifier in memory on chips.

    Parameters
    ----------
    board : Board
        Amplifier.
    chips : sequence of Chip
        Chip for each channel of the amplifier.
    counters : ChipCounters
        Counters, which are shared with the chips and the bus.
    runner : Runner
        Executor of `step`, whose lock guards the amplifier.

    Attributes
    ----------
    phase : str
        "rest" (high voltage off), "ready", "running", "ending" or "down".
    position : int
        Position that the amplifier plays next.
    sent : int
        Position after the last sample that was sent to the amplifier.
    detail : str
        Description of a problem in one line; empty if there is none.
    last_fault : str
        Reason for which the chips were lost the last time, one line; empty if they never were.
    hungry : bool
        Whether the chips wait for samples.
    """

    def __init__(
        self, board: Board, chips: Sequence[Chip], counters: ChipCounters, runner: Runner
    ) -> None:
        self.board, self.chips, self.counters, self.runner = board, chips, counters, runner
        self.phase: Phase = "rest"
        self.position = self.sent = 0
        self.detail = self.last_fault = ""
        self.hungry = False
        self._order: Order = ""
        self._playing = self._cutting = self._estopped = False
        self._resume = self._awake = False
        self._first_write = -1.0
        self._eager = False
        self._retry = self._reconnect = self._passed_until = 0.0
        self._delay = 0.0

    # Called by the bus with the lock held

    def order(self, order: Order) -> None:
        """Order a change; an e-stop replaces every other order, and no order replaces an e-stop.

        Parameters
        ----------
        order : str
            "start", "stop", "abort" or "estop".
        """
        if self._order != "estop":
            self._order = order
        self.runner.alarm()

    def start(self, position: int, rate: int) -> None:
        """Let the amplifier play; the thread sets up the chips.

        Parameters
        ----------
        position : int
            Position of the first sample.
        rate : int
            Sample rate [Hz].
        """
        self.board.start(position, rate)
        self.position = self.sent = position
        self._playing, self._first_write, self._eager = True, -1.0, False
        self.order("start")

    def send(self, position: int, volts: Floats) -> None:
        """Pass samples to the amplifier.

        Parameters
        ----------
        position : int
            Position of the first sample.
        volts : (S, C) array of float
            Drive voltages [V].
        """
        self.board.send(position, volts)
        self.sent = max(self.sent, position + len(volts))
        if self._first_write < 0:
            self._first_write = self.runner.now()
        if self.hungry or self.phase == "ready":
            self.hungry = False
            self.runner.alarm()

    def hurry(self) -> None:
        """Begin to play with the samples at hand, because a caller waits for room."""
        if self.phase == "ready" and not self._eager:
            self._eager = True
            self.runner.alarm()

    @property
    def at_rest(self) -> bool:
        """Whether no order is pending and nothing is on its way to 0 V."""
        return not self._order and self.phase in ("rest", "down")

    # Called by the thread

    def step(self) -> float | None:
        """Do what is due.

        Returns
        -------
        float or None
            Time of the next call [s]; None if nothing is due before an order.
        """
        with self.runner.lock:
            order, self._order = self._order, ""
        try:
            if order:
                self._carry_out(order)
            return self._continue_phase()
        except OSError as error:
            return self._handle_error(error)
        except Exception as error:
            self._lose(f"unforeseen: {error!r}")
            return self._reconnect

    def _carry_out(self, order: Order) -> None:
        """Carry out an order."""
        if order == "start":
            self._resume, self._estopped = True, False
            self._passed_until = self.runner.now()
            if self.phase != "down":
                self._wake_chips()
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
                self._put_on_chips(np.concatenate([tail, np.zeros((1, len(self.chips)))]))

    def _end_board(self, order: Order) -> Floats:
        """End the amplifier's playback; return what it still puts out (S, C) [V]."""
        was, self._playing = self._playing, False
        if order == "estop":
            return self.board.estop()
        if was:
            return self.board.end(quick=order == "abort")
        return np.zeros((0, len(self.chips)))

    def _continue_phase(self) -> float | None:
        """Do what the phase requires; return the time of the next call [s]."""
        if self.phase == "rest":
            return None
        if self.phase == "down":
            return self._recover()
        if self.runner.now() < self._retry:
            return self._retry
        deadline = {"ready": self._await_samples, "running": self._feed, "ending": self._end_chips}[
            self.phase
        ]()
        self._delay = self._retry = 0.0
        self.detail = ""
        return deadline

    def _wake_chips(self) -> None:
        for chip in self.chips:
            chip.wake()
        for chip in self.chips:
            chip.calibrate()

    def _await_samples(self) -> float | None:
        """Wait for samples to play, then start up the chips."""
        if self._first_write < 0 and not self._eager:
            return None
        now, until = self.runner.now(), self._first_write + PATIENCE
        if not self._eager and self.sent - self.position < BURST and now < until:
            return until
        self._warm_chips()
        self.phase = "running"
        return self._feed()

    def _warm_chips(self) -> None:
        for chip in self.chips:
            chip.warm()
        for chip in self.chips:
            chip.ready()

    def _feed(self) -> float:
        """Play the amplifier as far as the chips have room; return when to be called again."""
        first = self.chips[0]
        queued = max(0, self.sent - self.position)
        needed = LOW - min(chip.fill() + len(chip.pending) for chip in self.chips)
        count = min(first.demand(), max(queued, needed), 2 * BURST)
        if BURST < count < BURST + LEAST:
            count = BURST
        fed = count >= LEAST or count >= needed > 0
        if fed:
            with self.runner.lock:
                volts = self._play_board(count)
                self.runner.lock.notify_all()
            self._put_on_chips(volts)
        for chip in self.chips:
            chip.flush()
        self.hungry = not fed
        due = min(chip.due() for chip in self.chips)
        now = self.runner.now()
        return due if fed or due > now else now + IDLE_POLL

    def _play_board(self, count: int) -> Floats:
        """Let the amplifier play; return what it puts out (S, C) [V]."""
        if not self._playing:
            return np.zeros((count, len(self.chips)))
        volts = self.board.play(count)
        self.position += len(volts)
        self.counters.underruns = self.board.amplifier.counters.underruns
        return volts

    def _put_on_chips(self, volts: Floats) -> None:
        """Queue the same voltages on all chips.

        Nothing may fail between them, for then the output of one chip would jump.
        """
        if not len(volts):
            return
        first = self.chips[0]
        first.put(volts[:, 0], len(volts))
        for k, chip in enumerate(self.chips[1:], 1):
            room = chip.room_at(self.runner.now())
            chip.put(volts[:, k], share(len(volts), room, len(chip.pending)))

    def _end_chips(self) -> float:
        """Write the ramp to 0 V, wait until it has been played, then switch off."""
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

    # Errors and recovery

    def _handle_error(self, error: OSError) -> float:
        """Decide about a failed transfer: repeat it, or take the link for down."""
        self.counters.bus_errors += 1
        now = self.runner.now()
        if self.phase == "down":
            self._awake = False
            self.detail = f"{error}; trying again"
            self._delay = min(self._delay * 2, RECONNECT[1])
            self._reconnect = now + self._delay
            return self._recovery_deadline()
        lost = isinstance(error, BusError | LostError) or self.phase in ("rest", "ready")
        if lost or now > min(chip.lost_at for chip in self.chips):
            self._lose(str(error))
            return self._recovery_deadline()
        self.detail = f"{error}; trying again"
        self._delay = min(max(self._delay * 2, BACK_OFF[0]), BACK_OFF[1])
        self._retry = now + self._delay
        return self._retry

    def _lose(self, reason: str) -> None:
        """Take the link for down; in an e-stop switch off at once, whatever the voltage."""
        now = self.runner.now()
        self.counters.disconnects += 1
        self.counters.dropped_samples += max(0, self.sent - self.position)
        self.detail = self.last_fault = reason
        self.phase, self._passed_until, self._awake = "down", now, False
        self._delay = RECONNECT[0]
        self._reconnect = now + (0.0 if self._estopped else self._delay)
        self._retry = 0.0

    def _recovery_deadline(self) -> float:
        return min(self._reconnect, self.runner.now() + TICK) if self._resume else self._reconnect

    def _recover(self) -> float:
        """Advance the amplifier's time, and try to set up the chips again."""
        self._pass_time()
        if self.runner.now() < self._reconnect:
            return self._recovery_deadline()
        if self._estopped:
            for chip in self.chips:
                chip.reset()
        if not self._awake:
            self._wake_chips()
            self._awake = True
            self._pass_time()
        if self._resume and not self._silent():
            self._reconnect = self.runner.now() + TICK
            return self._reconnect
        if self._resume:
            self._warm_chips()
            self._pass_time()
        self.counters.reconnects += 1
        self._delay = 0.0
        self.detail = ""
        self.phase = "running" if self._resume else "ending"
        return self.runner.now()

    def _silent(self) -> bool:
        """Return whether the amplifier has faded out."""
        with self.runner.lock:
            return not self._playing or not self._play_board(1).any()

    def _pass_time(self) -> None:
        """Play the amplifier by the host's clock and discard its output."""
        now = self.runner.now()
        count = int((now - self._passed_until) * RATE)
        self._passed_until += count / RATE
        longest = int(RATE * TICK)
        for k in range(0, count, longest):
            with self.runner.lock:
                self._play_board(min(longest, count - k))
