"""Model of a link with its amplifiers: transfers take time, and faults occur as its URL requests.

Time advances only while somebody waits, unless the model is given another clock. Amplifiers in
memory run by it, each with a clock that may deviate. The host sees what a driver would provide, a
line of bytes, a channel of CAN frames or an I²C adapter, so that the same code runs over the model
as over real devices.
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
from firmware_protocol.correlation import Sensor
from firmware_protocol.machine import PlayedRun
from firmware_protocol.ports import CanPort, I2cPort, SerialPort
from tactile.bus.can_bus import CanChannel
from tactile.bus.linux_i2c import SmbusAdapter
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
"""Longest time for which the amplifiers run at once [s]."""
KERNEL = 4096
"""Number of bytes that a line takes at once, as a tty of Linux does."""
FRAMES = 64
"""Number of CAN frames that a channel takes at once (assumed; Linux: txqueuelen)."""
AWAY = 0.1
"""Time for which a disconnected link stays away [s]."""
STALLED = 0.3
"""Time for which a reader stalls [s]."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Faults of a link, as probabilities for each chunk, frame or transfer, or as mean intervals.

    Attributes
    ----------
    loss, corrupt, reorder : float
        Probabilities of loss, damage, and being overtaken by the next one. A damaged CAN frame is
        detected by all nodes and sent again. A loss on I²C is a missing acknowledge.
    delay : float
        Mean delay that a driver adds to each unit [s].
    arbitration : float
        Longest time that a CAN frame waits for others [s].
    disconnect, power, stall : float
        Mean intervals of disconnections, of resets of the amplifiers, and of readers that stall
        [s]; infinite for none.
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
    """Unit on its way.

    Attributes
    ----------
    begins : float
        Time at which it begins to occupy the wire [s].
    arrives : float
        Time at which it arrives [s].
    unit : bytes or Frame
        Content.
    """

    begins: float
    arrives: float
    unit: bytes | Frame


class Medium:
    """One direction of a line, or both directions of a bus; it carries one unit at a time.

    Attributes
    ----------
    free : float
        Time from which the medium is free [s].
    """

    def __init__(self) -> None:
        self.free = 0.0


class Lane:
    """One direction of a link: units in order, each of which takes as long as the wire needs.

    Parameters
    ----------
    medium : Medium
        Medium, which both directions may share.
    faults : Faults
        Faults to model.
    random : numpy.random.Generator
        Generator from which the faults are drawn.
    resent : bool
        Whether a damaged unit is sent again rather than delivered.
    """

    def __init__(
        self, medium: Medium, faults: Faults, random: np.random.Generator, *, resent: bool
    ) -> None:
        self._medium, self._faults, self._random, self._resent = medium, faults, random, resent
        self._under_way: deque[Sent] = deque()
        self._held_until = 0.0

    def put(self, unit: bytes | Frame, seconds: float, now: float) -> None:
        """Send a unit.

        Parameters
        ----------
        unit : bytes or Frame
            Content.
        seconds : float
            Time that it takes on the wire [s].
        now : float
            Present time [s].
        """
        faults, random = self._faults, self._random
        begins = max(now, self._medium.free, self._held_until) + random.uniform(
            0, faults.arbitration
        )
        damaged = random.random() < faults.corrupt
        if damaged and self._resent:
            seconds *= 2
        self._medium.free = begins + seconds
        if random.random() < faults.loss:
            return
        arrives = self._medium.free + (random.exponential(faults.delay) if faults.delay else 0.0)
        if damaged and not self._resent and isinstance(unit, bytes):
            unit = self._damage(unit)
        if self._under_way:
            arrives = max(arrives, self._under_way[-1].arrives)
        self._under_way.append(Sent(begins, arrives, unit))
        if len(self._under_way) > 1 and random.random() < faults.reorder:
            a, b = self._under_way[-2], self._under_way[-1]
            self._under_way[-2], self._under_way[-1] = (
                a._replace(unit=b.unit),
                b._replace(unit=a.unit),
            )

    def _damage(self, unit: bytes) -> bytes:
        """Return a copy in which some bits are wrong and sometimes some bytes are missing."""
        damaged = bytearray(unit)
        for _ in range(self._random.integers(1, 4)):
            bit = int(self._random.integers(8 * len(damaged)))
            damaged[bit // 8] ^= 1 << bit % 8
        if self._random.random() < 0.5:
            at = int(self._random.integers(len(damaged)))
            del damaged[at : at + int(self._random.integers(1, 9))]
        return bytes(damaged)

    def hold(self, seconds: float, now: float) -> None:
        """Let nothing arrive for a while.

        Parameters
        ----------
        seconds : float
            Duration [s].
        now : float
            Present time [s].
        """
        self._held_until = now + seconds
        self._under_way = deque(
            s._replace(arrives=max(s.arrives, now + seconds)) for s in self._under_way
        )

    def forget(self, now: float) -> None:
        """Discard what is not on the wire yet.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        self._under_way = deque(s for s in self._under_way if s.begins <= now)
        self._medium.free = max([now, *(s.arrives for s in self._under_way)])

    def clear(self) -> None:
        """Discard everything."""
        self._under_way.clear()
        self._medium.free = 0.0

    def take(self, now: float) -> list[bytes | Frame]:
        """Remove and return what has arrived.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        list of bytes or Frame
            Units in the order of their arrival.
        """
        units = []
        while self._under_way and self._under_way[0].arrives <= now:
            units.append(self._under_way.popleft().unit)
        return units

    def waiting(self, now: float) -> list[bytes | Frame]:
        """Return what is not on the wire yet.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        list of bytes or Frame
            Units in the order in which they will be sent.
        """
        return [s.unit for s in self._under_way if s.begins > now]

    @property
    def next(self) -> float:
        """Time of the next arrival [s]; infinite if nothing is on its way."""
        return self._under_way[0].arrives if self._under_way else math.inf


class ModelSetup(NamedTuple):
    """Amplifiers of a link, with their clocks and faults.

    Attributes
    ----------
    configs : list of AmplifierConfig
        Configurations of the amplifiers.
    faults : Faults
        Faults to model.
    clock : Clock
        Clock of the model.
    drift : list of float
        Relative deviation of each amplifier's clock; positive for a fast one.
    seed : int
        Seed of the faults.
    sensor : callable
        Function that takes the index of an amplifier and returns a new sensor of its currents, or
        None if it does not measure.
    """

    configs: list[AmplifierConfig]
    faults: Faults
    clock: Clock
    drift: list[float]
    seed: int = 0
    sensor: Callable[[int], Sensor | None] = lambda board: None


class Model(ABC):
    """Model of a link with its amplifiers.

    Parameters
    ----------
    setup : ModelSetup
        Amplifiers, clocks and faults.

    Attributes
    ----------
    shared : bool
        Whether both directions share one medium.
    resent : bool
        Whether damaged units are sent again.
    configs, faults, clock, drift
        Attributes of the `ModelSetup`.
    random : numpy.random.Generator
        Generator from which the faults are drawn.
    out, back : Lane
        Directions to the amplifiers and to the host.
    amplifiers : list of ReferenceAmplifier
        Amplifiers since their latest reset.
    disconnects, resets, stalls : int
        Numbers of the faults so far.
    on_output : callable
        Function that receives the index of an amplifier and each run that it puts out.
    """

    shared = False
    resent = False

    def __init__(self, setup: ModelSetup) -> None:
        self.configs, self.faults, self.clock, self.drift, seed, self._sensor = setup
        faults = self.faults
        self.random = np.random.default_rng(seed)
        outward = Medium()
        inward = outward if self.shared else Medium()
        self.out = Lane(outward, faults, self.random, resent=self.resent)
        self.back = Lane(inward, faults, self.random, resent=self.resent)
        self.disconnects = self.resets = self.stalls = 0
        self.amplifiers: list[ReferenceAmplifier] = []
        self.on_output: Callable[[int, PlayedRun], None] = lambda board, run: None
        self._open, self._away_until = False, -math.inf
        self._events = {
            name: self._draw_time(getattr(faults, name))
            for name in ("disconnect", "power", "stall")
        }
        self._power_up()

    def power_cycle(self) -> None:
        """Switch the power of all amplifiers off and on again."""
        self.resets += 1
        self._power_up()

    def _power_up(self) -> None:
        self.report_output()
        self.amplifiers = [
            ReferenceAmplifier(config, self._sensor(board))
            for board, config in enumerate(self.configs)
        ]
        self._powered_at = [self.clock.now()] * len(self.configs)
        self.attach()

    def _draw_time(self, mean: float) -> float:
        """Draw the time of a fault from the mean interval of such faults."""
        return self.clock.now() + (self.random.exponential(mean) if mean < math.inf else math.inf)

    def tick(self, board: int) -> int:
        """Return the present tick of an amplifier's clock.

        Parameters
        ----------
        board : int
            Index of the amplifier.

        Returns
        -------
        int
            Tick.
        """
        passed = (self.clock.now() - self._powered_at[board]) * (1 + self.drift[board])
        return int(passed * self.configs[board].tick_hz)

    def time_of(self, board: int, tick: int) -> float:
        """Return the time of a tick of an amplifier's clock.

        Parameters
        ----------
        board : int
            Index of the amplifier.
        tick : int
            Tick.

        Returns
        -------
        float
            Time [s].
        """
        passed = tick / self.configs[board].tick_hz
        return self._powered_at[board] + passed / (1 + self.drift[board])

    def report_output(self) -> None:
        """Pass what the amplifiers have put out to `on_output`."""
        for board, amplifier in enumerate(self.amplifiers):
            for run in amplifier.take_played():
                self.on_output(board, run)

    @abstractmethod
    def attach(self) -> None:
        """Connect ports to the amplifiers."""

    @abstractmethod
    def exchange(self) -> None:
        """Pass what has arrived to the amplifiers, and put their answers on the wire."""

    def open(self) -> None:
        """Open the link.

        Raises
        ------
        WireError
            If it is disconnected.
        """
        self._open = self.clock.now() >= self._away_until
        self.check_connected()

    def check_connected(self) -> None:
        """Check that the link is connected and has been since it was opened.

        Raises
        ------
        WireError
            If it is not.
        """
        if not self._open:
            raise WireError("the device is gone (modeled)")

    def advance(self, until: float) -> None:
        """Let time pass until something has come back.

        Parameters
        ----------
        until : float
            Latest time [s].

        Raises
        ------
        WireError
            If the link is disconnected meanwhile.
        """
        self._trigger_faults()
        while self.clock.now() < until and self.back.next > self.clock.now():
            pause = min(until, self.clock.now() + STEP, self.out.next, self.back.next)
            self.clock.sleep(pause - self.clock.now())
            self.exchange()
            self._trigger_faults()
            self.check_connected()

    def _trigger_faults(self) -> None:
        """Let the faults occur whose time has come."""
        now = self.clock.now()
        for name, when in self._events.items():
            if when <= now:
                self._events[name] = self._draw_time(getattr(self.faults, name))
                if name == "power":
                    self.power_cycle()
                elif name == "stall":
                    self.stall(STALLED)
                else:
                    self.disconnects += 1
                    self.unplug(AWAY)

    def stall(self, seconds: float) -> None:
        """Let the amplifiers read nothing for a while.

        Parameters
        ----------
        seconds : float
            Duration [s].
        """
        self.stalls += 1
        self.out.hold(seconds, self.clock.now())

    def unplug(self, seconds: float = math.inf) -> None:
        """Disconnect the link for a while.

        Parameters
        ----------
        seconds : float
            Duration [s].
        """
        self.out.clear()
        self.back.clear()
        self._open = False
        self._away_until = self.clock.now() + seconds

    def run_alone(self, until: float) -> None:
        """Let the amplifiers run while nobody communicates with them.

        Parameters
        ----------
        until : float
            Time until which they run [s].
        """
        while self.clock.now() < until:
            self.clock.sleep(min(until - self.clock.now(), STEP))
            self.exchange()
            self._trigger_faults()


class SerialModel(Model, SerialLine):
    """One amplifier on a serial line.

    Parameters
    ----------
    link : Link
        Link that determines the time on the wire; none is taken unless it is a `Uart`.
    setup : ModelSetup
        Amplifier, clock and faults.
    """

    def __init__(self, link: Link, setup: ModelSetup) -> None:
        rate = link.bit_rate if isinstance(link, Uart) else math.inf
        self._byte_seconds = uart_bits(1) / rate
        super().__init__(setup)

    def attach(self) -> None:
        """Connect a serial port to the amplifier."""
        (amplifier,) = self.amplifiers
        self._port = SerialPort(amplifier)

    def exchange(self) -> None:
        """Pass on the bytes of both directions."""
        tick = self.tick(0)
        self.amplifiers[0].run(tick)
        for unit in self.out.take(self.clock.now()):
            assert isinstance(unit, bytes)
            self._port.feed(unit, tick)
        answer = self._port.take()
        if answer:
            self.back.put(answer, len(answer) * self._byte_seconds, self.clock.now())

    def write(self, data: bytes) -> int:
        """Take the bytes that the kernel has room for.

        Parameters
        ----------
        data : bytes
            Bytes to send.

        Returns
        -------
        int
            Number of bytes that were taken.
        """
        self.check_connected()
        accepted = data[: max(KERNEL - self.waiting(), 0)]
        if accepted:
            self.out.put(accepted, len(accepted) * self._byte_seconds, self.clock.now())
        return len(accepted)

    def read(self) -> bytes:
        """Return what has arrived.

        Returns
        -------
        bytes
            Bytes; empty if there are none.
        """
        self.check_connected()
        return b"".join(u for u in self.back.take(self.clock.now()) if isinstance(u, bytes))

    def wait(self, until: float, *, writable: bool) -> None:
        """Let time pass until bytes have come.

        Parameters
        ----------
        until : float
            Latest time [s].
        writable : bool
            Whether to wait for room for writing as well, which ends the wait after `STEP`.
        """
        self.check_connected()
        self.advance(min(until, self.clock.now() + STEP) if writable else until)

    def wake(self) -> None:
        """Do nothing, since the caller itself is who waits."""

    def waiting(self) -> int:
        """Return how many bytes are not on the wire yet.

        Returns
        -------
        int
            Number of bytes.
        """
        return sum(len(unit) for unit in self.out.waiting(self.clock.now()))

    def discard(self) -> None:
        """Discard what is not on the wire yet."""
        self.out.forget(self.clock.now())

    def close(self) -> None:
        """Discard what is not on the wire yet."""
        self.out.forget(self.clock.now())


class CanModel(Model, CanChannel):
    """Amplifiers on a CAN bus.

    Parameters
    ----------
    link : Can
        Link that determines the time on the wire.
    setup : ModelSetup
        Amplifiers, clocks and faults.
    """

    shared = resent = True

    def __init__(self, link: Can, setup: ModelSetup) -> None:
        self._link = link
        super().__init__(setup)

    def attach(self) -> None:
        """Connect a CAN port to each amplifier."""
        fd, extended = self._link.data is not None, self._link.extended
        self._ports = [CanPort(a, fd=fd, extended=extended) for a in self.amplifiers]

    def _seconds(self, size: int) -> float:
        """Return the time that a frame of so many bytes takes on the wire [s]."""
        if self._link.data is None:
            return can_estimate(size, "mean") / self._link.nominal
        return fd_estimate(size, "mean").seconds(self._link.nominal, self._link.data)

    def exchange(self) -> None:
        """Pass on the frames of both directions."""
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
        """Take a frame if there is room for it.

        Parameters
        ----------
        frame : Frame
            Frame to send.

        Returns
        -------
        bool
            Whether it was taken.
        """
        self.check_connected()
        if len(self.out.waiting(self.clock.now())) >= FRAMES:
            return False
        self.out.put(frame, self._seconds(len(frame[1])), self.clock.now())
        return True

    def send_urgent(self, frame: Frame) -> None:
        """Send a frame before those that wait.

        Parameters
        ----------
        frame : Frame
            Frame to send.
        """
        self.check_connected()
        waiting = [u for u in self.out.waiting(self.clock.now()) if isinstance(u, tuple)]
        self.out.forget(self.clock.now())
        for queued in (frame, *waiting):
            self.out.put(queued, self._seconds(len(queued[1])), self.clock.now())

    def receive(self, until: float) -> list[Frame]:
        """Wait for frames and return them.

        Parameters
        ----------
        until : float
            Latest time [s].

        Returns
        -------
        list of Frame
            Frames that have arrived; empty if there are none.
        """
        self.check_connected()
        self.advance(until)
        return [u for u in self.back.take(self.clock.now()) if isinstance(u, tuple)]

    def wake(self) -> None:
        """Do nothing, since the caller itself is who waits."""

    def close(self) -> None:
        """Discard what is not on the wire yet."""
        self.out.forget(self.clock.now())


class I2cModel(Model, SmbusAdapter):
    """Amplifiers on an I²C bus, at consecutive addresses; time passes during each transfer.

    Parameters
    ----------
    link : I2c
        Link that determines the time on the wire.
    first : int
        Address of the first amplifier, such as 0x42.
    setup : ModelSetup
        Amplifiers, clocks and faults.
    """

    def __init__(self, link: I2c, first: int, setup: ModelSetup) -> None:
        self._link, self._first = link, first
        super().__init__(setup)

    def attach(self) -> None:
        """Connect an I²C port to each amplifier."""
        self._ports = [I2cPort(a) for a in self.amplifiers]

    def exchange(self) -> None:
        """Let the amplifiers run."""
        for board, amplifier in enumerate(self.amplifiers):
            amplifier.run(self.tick(board))

    def _transfer(self, address: int, size: int) -> I2cPort:
        """Let the time of a transfer pass, and return the port that acknowledges it."""
        self.check_connected()
        self.run_alone(self.clock.now() + i2c_bits(size) / self._link.clock_hz)
        self.check_connected()
        board = address - self._first
        if not 0 <= board < len(self._ports) or self.random.random() < self.faults.loss:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return self._ports[board]

    def _maybe_damaged(self, data: bytes) -> bytes:
        """Return data, damaged with the probability of that fault."""
        if data and self.random.random() < self.faults.corrupt:
            return self.out._damage(data)
        return data

    def write(self, address: int, data: bytes) -> None:
        """Write to an amplifier.

        Parameters
        ----------
        address : int
            Address of the amplifier.
        data : bytes
            Bytes to write.
        """
        port = self._transfer(address, len(data))
        port.write(self._maybe_damaged(data), self.tick(address - self._first))

    def write_read(self, address: int, data: bytes, size: int) -> bytes:
        """Read from an amplifier.

        Parameters
        ----------
        address : int
            Address of the amplifier.
        data : bytes
            Bytes to write before, of which amplifiers expect none.
        size : int
            Number of bytes to read.

        Returns
        -------
        bytes
            Bytes that were read.
        """
        port = self._transfer(address, size)
        answer = port.read(size, self.tick(address - self._first))
        return self._maybe_damaged(answer).ljust(size, b"\0")[:size]

    def write_block(self, address: int, command: int, block: bytes) -> None:
        """Write an SMBus block.

        Parameters
        ----------
        address : int
            Address of the amplifier.
        command : int
            Command, which the model ignores.
        block : bytes
            Contents of the block.
        """
        port = self._transfer(address, len(block) + 2)
        port.write_block(self._maybe_damaged(block), self.tick(address - self._first))

    def read_block(self, address: int, command: int) -> bytes:
        """Read an SMBus block.

        Parameters
        ----------
        address : int
            Address of the amplifier.
        command : int
            Command, which the model ignores.

        Returns
        -------
        bytes
            Contents of the block.
        """
        port = self._transfer(address, 34)
        return self._maybe_damaged(port.read_block(self.tick(address - self._first)))

    def close(self) -> None:
        """Do nothing, since there is nothing to release."""
