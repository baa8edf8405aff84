"""Program that plays one display: it reads orders, plays, and answers.

It is a process of its own, so that nothing that the server does delays a block. Its standard input
is a pipe from the server. If that ends, for whatever reason, the program fades out, disarms and
exits. Writing never delays it: answers wait in a queue that has its own thread.

Another thread watches the latch and the server's signs of life, also while the loop waits for the
amplifier. An e-stop goes to the bus at once. A server that is silent for `SILENCE` could not stop
what plays, so that everything fades and the high voltage goes off.
"""

import os
import queue
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from tactile.bus.base import Bus
from tactile.bus.registry import with_default_option
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.errors import BusError, BusStateError, TactileError
from tactile.estop.latch import Latch, LatchWriter
from tactile.messages import ArmDisplay, ClearEstop, DisarmDisplay
from tactile.playback import priority
from tactile.playback.commands import (
    AddFrames,
    DeviceOpened,
    EndWaves,
    ForgetClient,
    News,
    OnsetReport,
    Order,
    OrderAnswer,
    PlayAt,
    PlaybackSetup,
)
from tactile.playback.estimates import Estimates, ProcessEstimates
from tactile.playback.finger_following import WINDOW_MS, FingerFollowing
from tactile.playback.loop import PlaybackLoop, state_of
from tactile.playback.session_ring import SessionRing
from tactile.playback.shared_memory import PlaybackMemory
from tactile.playback.silence import SilenceTimer
from tactile.processes import pipes_of_parent, received, send
from tactile.sensing.baseline_file import load_calibration
from tactile.sim import SimulatedDisplay

IDLE = 20e-3
"""Interval between looks at the orders while nothing plays [s]."""
WATCH = 5e-3
"""Interval between looks at the latch and at the server's signs of life [s]."""
SILENCE = 0.15
"""Time without a sign of life of the server after which all fades and is disarmed [s]."""
MOST_ORDERS = 8
"""Largest number of orders that are executed between two blocks, so that many of them delay none
(100 µs each)."""
Message = OrderAnswer | News | list[OnsetReport]
"""Message to the server."""
WAITING = 256
"""Largest number of answers and news that wait to be written; more are dropped, since nobody reads
them."""
PATIENCE = 0.1
"""Time that remaining answers may take at the end [s]."""


class Program:
    """Executor of the server's orders.

    Parameters
    ----------
    player : PlaybackLoop
        Loop that plays the display.
    latch : Latch
        E-stop latch of the display.
    say : callable
        Function that sends answers and news, and never waits.
    """

    def __init__(self, player: PlaybackLoop, latch: Latch, say: Callable[[Message], None]) -> None:
        self._player, self._latch, self._send = player, latch, say
        self._orders: deque[tuple[int, Order]] = deque()
        self._frames: deque[tuple[int, AddFrames | PlayAt]] = deque()
        self._wake = threading.Event()
        self._stopping = threading.Lock()
        self._estop = 0
        # If an e-stop holds, the bus has been e-stopped for that one.
        self._bus_estops = player.bus.estops if latch.holds else 0
        self._beats, self._silence = 0, SilenceTimer(longest_step=2 * WATCH)
        self._server_silent = self._ended = False
        self._sent_status = "", "disarmed", "up"
        self._underruns = 0
        self._failure = ""

    def run(self) -> None:
        """Play until `end`, then close the bus."""
        try:
            while not self._ended:
                if not self.turn():
                    self._player.clock.wait(self._wake, IDLE)
                    self._wake.clear()
        finally:
            self._player.bus.close()

    def take(self, number: int, order: Order) -> None:
        """Queue an order, from any thread.

        Parameters
        ----------
        number : int
            Number of the order.
        order : Order
            Order to execute.
        """
        if isinstance(order, AddFrames) or (
            isinstance(order, PlayAt) and isinstance(order.order, AddFrames)
        ):
            self._frames.append((number, order))
        else:
            self._orders.append((number, order))
        self._wake.set()

    def end(self) -> None:
        """Let `run` return, from any thread."""
        self._ended = True
        self._wake.set()

    def turn(self) -> bool:
        """Execute orders and play a block.

        Returns
        -------
        bool
            Whether there is more to do at once.
        """
        player = self._player
        self.look_at_latch()
        self._execute_next(self._orders)
        if self._server_silent and player.running:
            player.disarm()
            self._send(News("disarmed", f"the server was silent for {SILENCE:g} s"))
        if player.running:
            player.wait()
            self._execute_next(self._frames)  # as late as contacts: they take little time
            player.step()
            self._send_touches()
            if player.report.blocks % 16 == 0:
                self._send_changes()
        else:
            self._execute_next(self._frames)
            player.write_report()
            self._send_changes()
        if reports := player.report_onsets():
            self._send(reports)
        return player.running or bool(self._orders or self._frames)

    def _execute_next(
        self, orders: deque[tuple[int, Order]] | deque[tuple[int, AddFrames | PlayAt]]
    ) -> None:
        """Execute the next of the orders that wait, as many as may delay a block."""
        for _ in range(min(len(orders), MOST_ORDERS)):
            self._answer(*orders.popleft())

    # Methods that another thread calls

    def watch(self) -> None:
        """Watch the latch and the server's signs of life until the end, in another thread."""
        clock = self._player.clock
        looked = clock.now()
        try:
            while not self._ended:
                clock.sleep(WATCH)
                self.look_at_latch()
                before, looked = looked, clock.now()
                self.look_at_server(looked - before)
        finally:  # also if an amplifier cannot be e-stopped: its watchdog takes it to 0 V
            self.end()

    def look_at_latch(self) -> None:
        """Stop at once for a new e-stop, and latch one that the amplifier reports."""
        with self._stopping:
            bus, holds = self._player.bus, self._latch.holds
            if bus.estops != self._bus_estops:  # from a button or another host
                self._bus_estops = bus.estops
                why = bus.status.detail or "no reason known"
                self._estop = self._latch.trip(f"by the amplifier: {why}")
            elif holds and holds != self._estop:
                before = bus.estops
                bus.estop()
                # A second e-stop within the call is the amplifier's own, left for the next look.
                self._bus_estops += min(bus.estops - before, 1)
                self._estop = holds

    def look_at_server(self, passed: float) -> None:
        """Check whether the server still gives signs of life.

        Parameters
        ----------
        passed : float
            Time since the last look [s].
        """
        beats, before = self._player.memory.beats, self._beats
        self._beats = beats
        self._server_silent = self._silence.look(passed, sign=beats != before) > SILENCE
        if self._server_silent:
            self._wake.set()

    # Orders

    def _execute_frames_of(self, client: int) -> None:
        """Execute the orders of frames of a client, which came before one that ends them."""
        came = [self._frames.popleft() for _ in range(len(self._frames))]
        self._frames.extendleft(one for one in reversed(came) if one[1].client != client)
        for number, order in came:
            if order.client == client:
                self._answer(number, order)

    def _answer(self, number: int, order: Order) -> None:
        """Execute an order, and send its result or failure."""
        if isinstance(order, EndWaves | ForgetClient):
            self._execute_frames_of(order.client)
        try:
            value = self._execute(number, order)
        except (TactileError, ValueError) as error:
            self._send(OrderAnswer(number, failure=str(error)))
        except Exception as error:  # playback continues, whatever was wrong with an order
            traceback.print_exc()
            self._send(OrderAnswer(number, failure=f"playback failed: {error!r}"))
        else:
            self._send(OrderAnswer(number, value))

    def _execute(self, number: int, order: Order) -> tuple[float, ...]:
        """Execute an order; return its result."""
        player = self._player
        match order:
            case ArmDisplay():
                self._check_may_arm()
                if not player.running:  # arming would silence what others play
                    player.arm()
            case DisarmDisplay():
                player.disarm()
            case ClearEstop():
                self._clear(order.estop)
            case _:
                return player.execute(number, order)
        return ()

    def _check_may_arm(self) -> None:
        """Refuse to arm while an e-stop holds, or while the server could not stop what plays.

        Raises
        ------
        BusStateError
            If that is so.
        """
        if self._latch.holds:
            raise BusStateError(f"e-stop {self._latch.holds} holds, {self._latch.reason}")
        if self._server_silent:
            raise BusStateError(f"the server was silent for {SILENCE:g} s")

    def _clear(self, estop: int) -> None:
        """Clear the device after an e-stop, unless a newer one holds.

        Raises
        ------
        BusError
            If the device refuses, or a newer e-stop holds.
        """
        self.look_at_latch()
        if self._latch.holds == estop:
            self._player.bus.clear()
            self._player.write_report()
        if self._latch.holds not in (0, estop):  # 0: another order has cleared the same before
            raise BusStateError(f"e-stop {self._latch.holds} holds, not {estop}")

    # News

    def _send_touches(self) -> None:
        """Send news of contactors that were touched, or lost their finger."""
        following = self._player.following
        if following is not None:
            for change in following.take_changes():
                self._send(News(change.kind, "", change.contactors))

    def _send_changes(self) -> None:
        """Send news of another state but e-stops, of trouble, and of underruns."""
        status, counters = self._player.bus.status, self._player.bus.counters
        state = state_of(status)
        before, self._sent_status = self._sent_status, (status.detail, state, status.link)
        if state != before[1] and state != "estopped":
            self._send(News(state, status.detail))
        if status.link != before[2]:
            self._send(News("link", status.detail or f"the link is {status.link}"))
        elif status.detail and status.detail != before[0]:
            self._send(News("fault", status.detail))
        if counters.underruns > self._underruns:
            self._send(News("underrun", f"{counters.underruns - self._underruns} more"))
            self._underruns = counters.underruns
        following = self._player.following
        if following is not None and following.failure != self._failure:
            self._failure = following.failure
            self._send(News("fault", self._failure))


class Pipe:
    """Connection of a playback process to the server: orders come in, answers and news go out.

    Parameters
    ----------
    orders : file
        File to read orders from.
    answers : file
        File to write answers and news to.
    """

    def __init__(self, orders: BinaryIO, answers: BinaryIO) -> None:
        self._orders, self._answers = orders, answers
        self._waiting: queue.Queue[Message] = queue.Queue(WAITING)

    def say(self, what: Message) -> None:
        """Queue a message to be written; it is dropped if nobody reads.

        Parameters
        ----------
        what : OrderAnswer or News or list of OnsetReport
            Message to write.
        """
        with suppress(queue.Full):
            self._waiting.put_nowait(what)

    def begin(self, program: Program) -> None:
        """Pass orders to a program and write its messages, each in a thread of its own.

        Parameters
        ----------
        program : Program
            Program that executes the orders.
        """
        for work in (self._read, self._write):
            threading.Thread(target=work, args=(program,), name="tactile-talk", daemon=True).start()

    def _read(self, program: Program) -> None:
        """Read orders until the server is gone, then end the program."""
        try:
            for order in received(self._orders):
                program.take(*order)
        finally:
            program.end()

    def _write(self, program: Program) -> None:
        """Write messages until the server is gone, then end the program."""
        while True:
            message = self._waiting.get()
            try:
                send(self._answers, message)
            except (OSError, ValueError):
                program.end()
                return
            finally:
                self._waiting.task_done()

    def flush(self, seconds: float) -> None:
        """Wait until everything is written.

        Parameters
        ----------
        seconds : float
            Longest time to wait [s].
        """
        joining = threading.Thread(target=self._waiting.join, daemon=True)
        joining.start()
        joining.join(seconds)


def open_device(setup: PlaybackSetup) -> tuple[Bus, DeviceOpened]:
    """Open the bus of a display.

    Parameters
    ----------
    setup : PlaybackSetup
        Device and display, as the server describes them.

    Returns
    -------
    bus : Bus
        Open bus.
    how : DeviceOpened
        How the device plays.

    Raises
    ------
    TactileError
        If the device cannot be opened.
    """
    device = setup.device
    if setup.rearm:
        device = with_default_option(device, "rearm", "true")
    if setup.calibration:
        device = with_default_option(device, "correlation_ms", str(WINDOW_MS))
    bus = open_bus(
        device, setup.display,
        sample_rate=setup.sample_rate, accept_unsafe_hold=setup.accept_unsafe_hold,
    )  # fmt: skip
    frames = bus.frames
    return bus, DeviceOpened(
        bus.wiring.sample_rate,
        frames.carriers if frames is not None else 0,
        frames.rate if frames is not None else 0.0,
        bus.ahead,
        marker_lines=bus.marker_lines,
    )


def follow(
    setup: PlaybackSetup, bus: Bus, estimates: Callable[[], Estimates]
) -> FingerFollowing | None:
    """Prepare to follow the finger, if the server asks for it and the device measures currents.

    Parameters
    ----------
    setup : PlaybackSetup
        Device and display, as the server describes them.
    bus : Bus
        Open bus; it is closed if the finger cannot be followed as asked for.
    estimates : callable
        Function that returns the place where loads are estimated.

    Returns
    -------
    FingerFollowing or None
        What follows the finger; None if the display's own finger is played for.

    Raises
    ------
    TactileError
        If the calibration cannot be used.
    """
    if not setup.calibration or not bus.correlates or bus.frames is not None:
        return None
    try:
        calibration = load_calibration(Path(setup.calibration))
        return FingerFollowing(setup.display, bus, calibration, estimates())
    except TactileError:
        bus.close()
        raise


def main() -> None:
    """Play as the server orders on standard input."""
    inward, outward = pipes_of_parent()
    setup: PlaybackSetup | None = next(received(inward), None)
    if setup is None:
        sys.exit(1)
    try:
        bus, how = open_device(setup)
        following = follow(setup, bus, ProcessEstimates)
        if isinstance(bus, ModeledBus):
            raise BusError(
                f"{setup.device}: the modeled link has a time of its own, in which a server cannot "
                "play; use mock: or sim:, or play it with tactile play"
            )
    except TactileError as error:
        send(outward, DeviceOpened(why_not=str(error)))
        sys.exit(1)
    memory = PlaybackMemory(setup.memory, len(setup.display.contactors))
    session = SessionRing(setup.session) if setup.session else None
    player = PlaybackLoop(
        setup.display, bus, memory,
        gain=setup.gain, worn=setup.worn, session=session, following=following,
        played=bus.take_shear if isinstance(bus, SimulatedDisplay) else None,
    )  # fmt: skip
    pipe = Pipe(inward, outward)
    program = Program(player, Latch(setup.latch, LatchWriter.PLAYBACK), pipe.say)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    refused = priority.prepare()
    send(outward, replace(how, real_time=refused, follows=following is not None))
    pipe.begin(program)
    threading.Thread(target=program.watch, name="tactile-watch", daemon=True).start()
    priority.raise_priority()
    with suppress(SystemExit):
        try:
            program.run()
        finally:
            pipe.flush(PATIENCE)
    os._exit(0)  # at once: frozen objects are not deallocated one by one
