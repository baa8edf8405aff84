"""The program that plays one display: it reads orders, plays, and answers.

It is a process of its own, so that nothing that a server does holds up a block. Its standard input
is the server's pipe: where that ends, for whatever reason, it fades out, disarms and exits. What
it writes never holds it up: answers wait in a queue of their own thread.

Another thread watches the latch and the server's signs of life, also while the loop waits for the
amplifier: an e-stop goes to the bus at once, and a server that is silent for `SILENCE` is one that
could not stop what plays, so all fades and high voltage goes off.
"""

import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, BinaryIO

from tactile.bus.base import Bus
from tactile.bus.registry import with_default_option
from tactile.devices import open_bus
from tactile.errors import BusStateError, TactileError
from tactile.estop.latch import Latch, LatchWriter
from tactile.playback import commands, priority
from tactile.playback.commands import Answer, DeviceOpened, News, Order, Setup
from tactile.playback.loop import PlaybackLoop, state_of
from tactile.playback.shared_memory import Shared
from tactile.playback.silence import SilenceTimer

IDLE = 20e-3
"""s between looks at orders while nothing plays."""
WATCH = 5e-3
"""s between looks at the latch and at the server's signs of life."""
SILENCE = 0.15
"""s without a sign of life of the server after which all fades and is disarmed."""
MOST_ORDERS = 8
"""Orders that are obeyed between two blocks, so that many of them hold up none (100 µs each)."""
WAITING = 256
"""Answers and news that wait to be written; more are dropped, since nobody reads them."""
PATIENCE = 0.1
"""s that what is left to say may take at the end."""


class Program:
    """Obeys the server.

    Parameters
    ----------
    player : what it plays with
    latch : the display's e-stop latch
    say : takes answers and news, and never waits
    """

    def __init__(
        self, player: PlaybackLoop, latch: Latch, say: Callable[[Answer | News], None]
    ) -> None:
        self._player, self._latch, self._say = player, latch, say
        self._orders: deque[tuple[int, Order]] = deque()
        self._news = threading.Event()
        self._stopping = threading.Lock()
        self._estop = 0
        self._bus_estops = player.bus.estops if latch.holds else 0  # it is e-stopped for that one
        self._beats, self._silence = 0, SilenceTimer(longest_step=2 * WATCH)
        self._forsaken = self._ended = False
        self._told = "", "disarmed", "up"
        self._underruns = 0

    def run(self) -> None:
        """Play until `end`, then close the bus."""
        try:
            while not self._ended:
                if not self.turn():
                    self._player.clock.wait(self._news, IDLE)
                    self._news.clear()
        finally:
            self._player.bus.close()

    def take(self, number: int, order: Order) -> None:
        """Take an order, from any thread."""
        self._orders.append((number, order))
        self._news.set()

    def end(self) -> None:
        """Let `run` end, from any thread."""
        self._ended = True
        self._news.set()

    def turn(self) -> bool:
        """Obey, and play a block; return whether there are more to play."""
        player = self._player
        self.look_at_latch()
        for _ in range(min(len(self._orders), MOST_ORDERS)):
            self._obey(*self._orders.popleft())
        if self._forsaken and player.running:
            player.disarm()
            self._say(News("disarmed", f"the server was silent for {SILENCE:g} s"))
        if player.running:
            player.step()
            if player.report.blocks % 16 == 0:
                self._tell_changes()
        else:
            player.write_report()
            self._tell_changes()
        return player.running or bool(self._orders)

    # What another thread does

    def watch(self) -> None:
        """Look at the latch and at the server's signs of life until the end, in another thread."""
        clock = self._player.clock
        looked = clock.now()
        try:
            while not self._ended:
                clock.sleep(WATCH)
                self.look_at_latch()
                before, looked = looked, clock.now()
                self.look_at_server(looked - before)
        finally:  # also where an amplifier cannot be e-stopped: its watchdog takes it to 0 V
            self.end()

    def look_at_latch(self) -> None:
        """Stop at once where there is a new e-stop, and latch one that the amplifier tells of."""
        with self._stopping:
            bus, holds = self._player.bus, self._latch.holds
            if bus.estops != self._bus_estops:  # who pressed a button, or another host
                self._bus_estops = bus.estops
                why = bus.status.detail or "no reason known"
                self._estop = self._latch.trip(f"by the amplifier: {why}")
            elif holds and holds != self._estop:
                before = bus.estops
                bus.estop()
                self._bus_estops += min(bus.estops - before, 1)  # one more is the amplifier's own
                self._estop = holds

    def look_at_server(self, passed: float) -> None:
        """See whether the server still gives signs of life, a time after the last look [s]."""
        beats, before = self._player.memory.beats, self._beats
        self._beats = beats
        self._forsaken = self._silence.look(passed, sign=beats != before) > SILENCE
        if self._forsaken:
            self._news.set()

    # Orders

    def _obey(self, number: int, order: Order) -> None:
        try:
            value = self._do(order)
        except (TactileError, ValueError) as error:
            self._say(Answer(number, failure=str(error)))
        except Exception as error:  # playing goes on, whatever was wrong with an order
            traceback.print_exc()
            self._say(Answer(number, failure=f"playback failed: {error!r}"))
        else:
            self._say(Answer(number, value))

    def _do(self, order: Order) -> tuple[float, ...]:
        player = self._player
        match order:
            case commands.Keep():
                player.keep(order.number, order.texture)
            case commands.Drop():
                player.textures.pop(order.number, None)
            case commands.SelectTextures():
                player.voice(order.client).layers = order.layers
                player.refresh(order.client)
            case commands.Scale():
                voice = player.voice(order.client)
                voice.gain, voice.sounds = order.gain, order.sounds
                player.refresh(order.client)
            case commands.Shape():
                player.voice(order.client).effect.begin(order.curve)
            case commands.Wave():
                return self._append(order)
            case commands.Silence():
                player.voice(order.client).queue.clear()
                player.voice(order.client).effect.begin(None)
            case commands.Forget():
                player.forget(order.client)
            case commands.StartBus():
                self._may_arm()
                if not player.running:  # else it would silence what others play
                    player.arm()
            case commands.StopBus():
                player.disarm()
            case commands.ClearDevice():
                self._clear(order.estop)
        return ()

    def _may_arm(self) -> None:
        """Refuse to arm while an e-stop holds, or the server could not stop what plays.

        Raises
        ------
        BusStateError
            Where that is so.
        """
        if self._latch.holds:
            raise BusStateError(f"e-stop {self._latch.holds} holds, {self._latch.reason}")
        if self._forsaken:
            raise BusStateError(f"the server was silent for {SILENCE:g} s")

    def _clear(self, estop: int) -> None:
        """Make the device ready after an e-stop, unless a newer one holds.

        Raises
        ------
        BusError
            Where the device refuses, or a newer e-stop holds.
        """
        self.look_at_latch()
        if self._latch.holds == estop:
            self._player.bus.clear()
            self._player.write_report()
        if self._latch.holds not in (0, estop):  # 0: another clear of the same came before
            raise BusStateError(f"e-stop {self._latch.holds} holds, not {estop}")

    def _append(self, order: commands.Wave) -> tuple[float, ...]:
        waves = self._player.voice(order.client).queue
        if not order.append:
            waves.clear()
        taken = waves.append(order.samples, order.sample_rate, order.contactors)
        return float(taken), waves.waiting

    # What there is to say

    def _tell_changes(self) -> None:
        """Tell of another state but e-stops, another line of trouble, and underruns."""
        status, counters = self._player.bus.status, self._player.bus.counters
        state = state_of(status)
        told, self._told = self._told, (status.detail, state, status.link)
        if state != told[1] and state != "estopped":
            self._say(News(state, status.detail))
        if status.link != told[2]:
            self._say(News("link", status.detail or f"the link is {status.link}"))
        elif status.detail and status.detail != told[0]:
            self._say(News("fault", status.detail))
        if counters.underruns > self._underruns:
            self._say(News("underrun", f"{counters.underruns - self._underruns} more"))
            self._underruns = counters.underruns


class Pipe:
    """The server's end of a playback process: orders come in, answers and news go out.

    Parameters
    ----------
    orders, answers : files to read and to write
    """

    def __init__(self, orders: BinaryIO, answers: BinaryIO) -> None:
        self._orders, self._answers = orders, answers
        self._waiting: queue.Queue[Answer | News] = queue.Queue(WAITING)

    def say(self, what: Answer | News) -> None:
        """Have something written; drop it where nobody reads."""
        with suppress(queue.Full):
            self._waiting.put_nowait(what)

    def begin(self, program: Program) -> None:
        """Hand orders to a program and write what it says, each in a thread of its own."""
        for work in (self._read, self._write):
            threading.Thread(target=work, args=(program,), name="tactile-talk", daemon=True).start()

    def _read(self, program: Program) -> None:
        try:
            while True:
                program.take(*pickle.load(self._orders))
        except (EOFError, OSError, pickle.UnpicklingError):
            return  # the server is gone
        finally:
            program.end()

    def _write(self, program: Program) -> None:
        while True:
            what = self._waiting.get()
            try:
                self._answers.write(pickle.dumps(what, protocol=5))
                self._answers.flush()
            except (OSError, ValueError):
                program.end()
                return
            finally:
                self._waiting.task_done()

    def flush(self, seconds: float) -> None:
        """Wait for a while until all is written."""
        waited = threading.Thread(target=self._waiting.join, daemon=True)
        waited.start()
        waited.join(seconds)


def opened(setup: Setup) -> tuple[Bus, DeviceOpened]:
    """Open a bus; return it and how it plays.

    Parameters
    ----------
    setup : what the server says of the device and its display

    Raises
    ------
    TactileError
        Where it cannot be.
    """
    device = setup.device
    if setup.rearm:
        device = with_default_option(device, "rearm", "true")
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
    )


def main() -> None:
    """Play as the server says on standard input."""
    inward: Any = os.fdopen(os.dup(0), "rb", buffering=1 << 16)
    outward: Any = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        setup: Setup = pickle.load(inward)
    except (EOFError, OSError, pickle.UnpicklingError):
        sys.exit(1)
    try:
        bus, how = opened(setup)
    except TactileError as error:
        outward.write(pickle.dumps(DeviceOpened(why_not=str(error)), protocol=5))
        outward.flush()
        sys.exit(1)
    memory = Shared(setup.memory, len(setup.display.contactors))
    player = PlaybackLoop(setup.display, bus, memory, gain=setup.gain, worn=setup.worn)
    pipe = Pipe(inward, outward)
    program = Program(player, Latch(setup.latch, LatchWriter.PLAYBACK), pipe.say)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    refused = priority.prepare()
    outward.write(pickle.dumps(DeviceOpened(*_fields(how), refused), protocol=5))
    outward.flush()
    pipe.begin(program)
    threading.Thread(target=program.watch, name="tactile-watch", daemon=True).start()
    priority.urge()
    with suppress(SystemExit):
        try:
            program.run()
        finally:
            pipe.flush(PATIENCE)
    os._exit(0)  # at once: nothing that was frozen is taken to pieces


def _fields(how: DeviceOpened) -> tuple[float, int, float, float]:
    return how.sample_rate, how.carriers, how.frame_rate, how.latency
