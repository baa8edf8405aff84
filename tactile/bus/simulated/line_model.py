"""A link that is not there but behaves: bits take their time, and things go wrong, as its URL says.

Time goes only while somebody waits, unless the model is given another clock. Amplifiers in memory
run by it, each with a clock that may be off. What the host sees is what a driver would show it: a
line of bytes, a channel of CAN frames, an I²C adapter, over which the same code runs as over real
ones.
"""

import errno
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.can_link import Frame
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.machine import PlayedRun
from firmware_protocol.ports import CanPort, I2cPort, SerialPort
from tactile.bus.can_bus import CanChannel
from tactile.bus.i2c_bus import Adapter
from tactile.bus.serial_bus import SerialLine
from tactile.bus.wire import WireError
from tactile.bus.wire_time import (
    Can,
    I2c,
    Link,
    Uart,
    can_estimate,
    fd_estimate,
    i2c_bits,
    uart_bits,
)
from tactile.clock import Clock

STEP = 1e-3
"""s that amplifiers run at a time."""
KERNEL = 4096
"""Bytes that a line takes at once, as a tty of Linux does."""
FRAMES = 64
"""CAN frames that a channel takes at once (assumed; Linux: txqueuelen)."""
AWAY = 0.1
"""s for which a link stays away that was disconnected."""
STALLED = 0.3
"""s for which a reader stalls."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What goes wrong: probabilities per chunk, frame or transfer, and mean intervals.

    Attributes
    ----------
    loss, corrupt, reorder : probability that it is lost, harmed, or overtaken by the next. What
        harms a CAN frame is seen by all, who have it again; on I²C a loss is not acknowledged
    delay : mean of what a driver adds to each [s]
    arbitration : most that a CAN frame waits for others [s]
    disconnect, power, stall : mean interval of disconnections, of the amplifiers' resets, and of
        readers that stall [s]; infinite for none
    """

    loss: float = 0.0
    corrupt: float = 0.0
    reorder: float = 0.0
    delay: float = 0.0
    arbitration: float = 0.0
    disconnect: float = math.inf
    power: float = math.inf
    stall: float = math.inf


class Sent(NamedTuple):
    """A unit on its way."""

    begins: float
    arrives: float
    unit: bytes | Frame


class Medium:
    """Who sends next: one direction of a line, or both of a bus."""

    def __init__(self) -> None:
        self.free = 0.0


class Lane:
    """One direction: units in order, each as long as the wire needs.

    Parameters
    ----------
    medium : which may be shared
    faults, random : what goes wrong, drawn from
    resent : whether a harmed unit is sent again rather than delivered
    """

    def __init__(
        self, medium: Medium, faults: Faults, random: np.random.Generator, *, resent: bool
    ) -> None:
        self._medium, self._faults, self._random, self._resent = medium, faults, random, resent
        self._way: deque[Sent] = deque()
        self._held = 0.0

    def put(self, unit: bytes | Frame, seconds: float, now: float) -> None:
        """Send a unit."""
        f, random = self._faults, self._random
        begins = max(now, self._medium.free, self._held) + random.uniform(0, f.arbitration)
        harmed = random.random() < f.corrupt
        if harmed and self._resent:
            seconds *= 2
        self._medium.free = begins + seconds
        if random.random() < f.loss:
            return
        arrives = self._medium.free + (random.exponential(f.delay) if f.delay else 0.0)
        if harmed and not self._resent and isinstance(unit, bytes):
            unit = self._harm(unit)
        if self._way:
            arrives = max(arrives, self._way[-1].arrives)
        self._way.append(Sent(begins, arrives, unit))
        if len(self._way) > 1 and random.random() < f.reorder:
            a, b = self._way[-2], self._way[-1]
            self._way[-2], self._way[-1] = a._replace(unit=b.unit), b._replace(unit=a.unit)

    def _harm(self, unit: bytes) -> bytes:
        """Return bytes of which some bits are wrong, and now and then some bytes gone."""
        harmed = bytearray(unit)
        for _ in range(self._random.integers(1, 4)):
            bit = int(self._random.integers(8 * len(harmed)))
            harmed[bit // 8] ^= 1 << bit % 8
        if self._random.random() < 0.5:
            at = int(self._random.integers(len(harmed)))
            del harmed[at : at + int(self._random.integers(1, 9))]
        return bytes(harmed)

    def hold(self, seconds: float, now: float) -> None:
        """Let nothing arrive for a while."""
        self._held = now + seconds
        self._way = deque(s._replace(arrives=max(s.arrives, now + seconds)) for s in self._way)

    def forget(self, now: float) -> None:
        """Drop what is not on the wire yet."""
        self._way = deque(s for s in self._way if s.begins <= now)
        self._medium.free = max([now, *(s.arrives for s in self._way)])

    def clear(self) -> None:
        """Drop everything."""
        self._way.clear()
        self._medium.free = 0.0

    def take(self, now: float) -> list[bytes | Frame]:
        """Return what has arrived."""
        found = []
        while self._way and self._way[0].arrives <= now:
            found.append(self._way.popleft().unit)
        return found

    def waiting(self, now: float) -> list[bytes | Frame]:
        """Return what is not on the wire yet."""
        return [s.unit for s in self._way if s.begins > now]

    @property
    def next(self) -> float:
        """When something arrives [s]."""
        return self._way[0].arrives if self._way else math.inf


class Party(NamedTuple):
    """Who is on a link, and what befalls them.

    Attributes
    ----------
    configs : of the amplifiers
    faults : what goes wrong
    clock : time
    drift : by which each amplifier's clock is fast
    seed : of what is drawn
    """

    configs: list[AmplifierConfig]
    faults: Faults
    clock: Clock
    drift: list[float]
    seed: int = 0


class Model(ABC):
    """A link with its amplifiers.

    Attributes
    ----------
    configs, faults, clock, drift : of the `Party`
    amplifiers : as they are now, after the latest reset
    disconnects, resets, stalls : that were
    listener : is handed what each amplifier, by its index, puts out
    """

    shared = False
    resent = False

    def __init__(self, party: Party) -> None:
        self.configs, self.faults, self.clock, self.drift, seed = party
        faults = self.faults
        self.random = np.random.default_rng(seed)
        there = Medium()
        back = there if self.shared else Medium()
        self.out = Lane(there, faults, self.random, resent=self.resent)
        self.back = Lane(back, faults, self.random, resent=self.resent)
        self.disconnects = self.resets = self.stalls = 0
        self.amplifiers: list[ReferenceAmplifier] = []
        self.listener: Callable[[int, PlayedRun], None] = lambda board, run: None
        self._open, self._away_until = False, -math.inf
        self._events = {
            name: self._after(getattr(faults, name)) for name in ("disconnect", "power", "stall")
        }
        self._power_up()

    def power_cycle(self) -> None:
        """Take power away from all amplifiers, and give it again."""
        self.resets += 1
        self._power_up()

    def _power_up(self) -> None:
        self.listen()
        self.amplifiers = [ReferenceAmplifier(config) for config in self.configs]
        self._powered = [self.clock.now()] * len(self.configs)
        self.attach()

    def _after(self, mean: float) -> float:
        return self.clock.now() + (self.random.exponential(mean) if mean < math.inf else math.inf)

    def tick(self, board: int) -> int:
        """Return an amplifier's tick."""
        passed = (self.clock.now() - self._powered[board]) * (1 + self.drift[board])
        return int(passed * self.configs[board].tick_hz)

    def time_of(self, board: int, tick: int) -> float:
        """Return when an amplifier's tick is [s]."""
        passed = tick / self.configs[board].tick_hz
        return self._powered[board] + passed / (1 + self.drift[board])

    def listen(self) -> None:
        """Hand over what the amplifiers have put out."""
        for board, amplifier in enumerate(self.amplifiers):
            for run in amplifier.take_played():
                self.listener(board, run)

    @abstractmethod
    def attach(self) -> None:
        """Put ports before the amplifiers."""

    @abstractmethod
    def exchange(self) -> None:
        """Hand what has arrived to the amplifiers, and put what they answer on the wire."""

    def open(self) -> None:
        """Open the link; raise WireError where it is not there."""
        self._open = self.clock.now() >= self._away_until
        self.require()

    def require(self) -> None:
        """Raise WireError where the link is gone, or was since it was opened."""
        if not self._open:
            raise WireError("the device is gone (modeled)")

    def advance(self, until: float) -> None:
        """Let time pass to a time at the latest, or until something has come back."""
        self._happen()
        while self.clock.now() < until and self.back.next > self.clock.now():
            pause = min(until, self.clock.now() + STEP, self.out.next, self.back.next)
            self.clock.sleep(pause - self.clock.now())
            self.exchange()
            self._happen()
            self.require()

    def _happen(self) -> None:
        """Let faults happen whose time has come."""
        now = self.clock.now()
        for name, when in self._events.items():
            if when <= now:
                self._events[name] = self._after(getattr(self.faults, name))
                if name == "power":
                    self.power_cycle()
                elif name == "stall":
                    self.stall(STALLED)
                else:
                    self.disconnects += 1
                    self.unplug(AWAY)

    def stall(self, seconds: float) -> None:
        """Let the amplifiers read nothing for a while."""
        self.stalls += 1
        self.out.hold(seconds, self.clock.now())

    def unplug(self, seconds: float = math.inf) -> None:
        """Take the link away for a while."""
        self.out.clear()
        self.back.clear()
        self._open = False
        self._away_until = self.clock.now() + seconds

    def run_away(self, until: float) -> None:
        """Let amplifiers run on while nobody talks to them."""
        while self.clock.now() < until:
            self.clock.sleep(min(until - self.clock.now(), STEP))
            self.exchange()
            self._happen()


class SerialModel(Model, SerialLine):
    """One amplifier on a line; ``link`` says how long bytes take."""

    def __init__(self, link: Link, party: Party) -> None:
        rate = link.bit_rate if isinstance(link, Uart) else math.inf
        self._byte = uart_bits(1) / rate
        super().__init__(party)

    def attach(self) -> None:
        """Put a serial port before the amplifier."""
        (amplifier,) = self.amplifiers
        self._port = SerialPort(amplifier)

    def exchange(self) -> None:
        """Hand bytes over."""
        tick = self.tick(0)
        self.amplifiers[0].run(tick)
        for unit in self.out.take(self.clock.now()):
            assert isinstance(unit, bytes)
            self._port.feed(unit, tick)
        answer = self._port.take()
        if answer:
            self.back.put(answer, len(answer) * self._byte, self.clock.now())

    def write(self, data: bytes) -> int:
        """Take what the kernel has room for."""
        self.require()
        taken = data[: max(KERNEL - self.waiting(), 0)]
        if taken:
            self.out.put(taken, len(taken) * self._byte, self.clock.now())
        return len(taken)

    def read(self) -> bytes:
        """Return what has come."""
        self.require()
        return b"".join(u for u in self.back.take(self.clock.now()) if isinstance(u, bytes))

    def wait(self, until: float, *, writable: bool) -> None:
        """Let time pass."""
        self.require()
        self.advance(min(until, self.clock.now() + STEP) if writable else until)

    def wake(self) -> None:
        """Nothing to do: who waits is who calls."""

    def waiting(self) -> int:
        """Return what is not on the wire yet."""
        return sum(len(unit) for unit in self.out.waiting(self.clock.now()))

    def discard(self) -> None:
        """Drop what is not on the wire yet."""
        self.out.forget(self.clock.now())

    def close(self) -> None:
        """Drop what is under way."""
        self.out.forget(self.clock.now())


class CanModel(Model, CanChannel):
    """Amplifiers on CAN."""

    shared = resent = True

    def __init__(self, link: Can, party: Party) -> None:
        self._link = link
        super().__init__(party)

    def attach(self) -> None:
        """Put a CAN port before each amplifier."""
        fd, extended = self._link.data is not None, self._link.extended
        self._ports = [CanPort(a, fd=fd, extended=extended) for a in self.amplifiers]

    def _seconds(self, size: int) -> float:
        if self._link.data is None:
            return can_estimate(size, "mean") / self._link.nominal
        return fd_estimate(size, "mean").seconds(self._link.nominal, self._link.data)

    def exchange(self) -> None:
        """Hand frames over."""
        arrived = [u for u in self.out.take(self.clock.now()) if isinstance(u, tuple)]
        for board, port in enumerate(self._ports):
            tick = self.tick(board)
            if not arrived:
                self.amplifiers[board].run(tick)
            for identifier, data in arrived:
                port.feed(identifier, data, tick)
            for frame in port.take():
                self.back.put(frame, self._seconds(len(frame[1])), self.clock.now())

    def send(self, frame: Frame) -> bool:
        """Take a frame, if there is room."""
        self.require()
        if len(self.out.waiting(self.clock.now())) >= FRAMES:
            return False
        self.out.put(frame, self._seconds(len(frame[1])), self.clock.now())
        return True

    def urge(self, frame: Frame) -> None:
        """Send a frame before those that wait."""
        self.require()
        waiting = [u for u in self.out.waiting(self.clock.now()) if isinstance(u, tuple)]
        self.out.forget(self.clock.now())
        for one in (frame, *waiting):
            self.out.put(one, self._seconds(len(one[1])), self.clock.now())

    def receive(self, until: float) -> list[Frame]:
        """Return what has come."""
        self.require()
        self.advance(until)
        return [u for u in self.back.take(self.clock.now()) if isinstance(u, tuple)]

    def wake(self) -> None:
        """Nothing to do: who waits is who calls."""

    def close(self) -> None:
        """Drop what is under way."""
        self.out.forget(self.clock.now())


class I2cModel(Model, Adapter):
    """Amplifiers on I²C, the first at address 0x42 and so on; transfers take time at once."""

    def __init__(self, link: I2c, first: int, party: Party) -> None:
        self._link, self._first = link, first
        super().__init__(party)

    def attach(self) -> None:
        """Put an I²C port before each amplifier."""
        self._ports = [I2cPort(a) for a in self.amplifiers]

    def exchange(self) -> None:
        """Let the amplifiers run."""
        for board, amplifier in enumerate(self.amplifiers):
            amplifier.run(self.tick(board))

    def _transfer(self, address: int, size: int) -> I2cPort:
        """Let a transfer's time pass; return who acknowledges."""
        self.require()
        self.run_away(self.clock.now() + i2c_bits(size) / self._link.clock_hz)
        self.require()
        board = address - self._first
        if not 0 <= board < len(self._ports) or self.random.random() < self.faults.loss:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return self._ports[board]

    def _harmed(self, data: bytes) -> bytes:
        if data and self.random.random() < self.faults.corrupt:
            return self.out._harm(data)
        return data

    def write(self, address: int, data: bytes) -> None:
        """Write a transfer."""
        port = self._transfer(address, len(data))
        port.write(self._harmed(data), self.tick(address - self._first))

    def read(self, address: int, size: int) -> bytes:
        """Read a transfer."""
        port = self._transfer(address, size)
        data = port.read(size, self.tick(address - self._first))
        return self._harmed(data).ljust(size, b"\0")[:size]

    def write_block(self, address: int, command: int, block: bytes) -> None:
        """Write an SMBus block."""
        port = self._transfer(address, len(block) + 2)
        port.write_block(self._harmed(block), self.tick(address - self._first))

    def read_block(self, address: int, command: int) -> bytes:
        """Read an SMBus block."""
        port = self._transfer(address, 34)
        return self._harmed(port.read_block(self.tick(address - self._first)))

    def close(self) -> None:
        """Nothing to do."""
