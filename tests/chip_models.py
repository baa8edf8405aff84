"""Models of DRV2667, BOS1921 and TCA9548A by their registers, on a virtual clock.

Written from what is published of the chips, not from the driver. A chip has ``write(data)`` and
``read(size)``, each a transfer on the wire, which raise OSError(ENXIO) where the address is not
acknowledged and OSError(EREMOTEIO) where a byte is not. Samples are played by the chip's own clock;
what was put out is remembered tick by tick. `ModelBus` makes an adapter of chips, with faults and
wire time, `VirtualRunner` calls a driver's step by the same clock.
"""

import errno
import threading
from collections import deque
from collections.abc import Callable

import numpy as np

from tactile.arrays import Floats
from tactile.clock import Clock, ModelClock


class VirtualRunner(ModelClock):
    """Calls a step when it is due, without a thread.

    Attributes
    ----------
    lateness : returns by how much each call comes late [s]
    """

    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.Condition()
        self.lateness: Callable[[], float] = lambda: 0.0
        self._step: Callable[[], float | None] | None = None
        self._deadline: float | None = None

    def begin(self, step: Callable[[], float | None]) -> None:
        """Call ``step`` from now on."""
        self._step, self._deadline = step, self.now()

    def alarm(self) -> None:
        """Let it be called at once."""
        self._deadline = self.now()

    def wait_for(self, done: Callable[[], bool], seconds: float) -> bool:
        """Let time pass until something is so."""
        limit = self.now() + seconds
        while not done():
            if self._step is None or self._deadline is None or self._deadline > limit:
                self.time = max(self.time, limit)
                return done()
            self.time = max(self.time, self._deadline) + self.lateness()
            self._deadline = None
            deadline = self._step()
            if deadline is not None:
                self._deadline = min(deadline, self._deadline or deadline)
        return True

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
        limit = self.now() + seconds
        self.wait_for(lambda: self.now() >= limit, seconds)

    def end(self) -> None:
        """End the calls of the step."""
        self._step = None


class Playing:
    """A chip's clock, FIFO and output.

    Parameters
    ----------
    time : the virtual clock
    rate : rate of its own clock [Hz]

    Attributes
    ----------
    output : volts at each tick
    played : volts of the samples, each once, in order
    drops : ticks at which it went to 0 V by itself, not by a sample
    """

    def __init__(self, time: Clock, rate: float) -> None:
        self.time, self.rate = time, rate
        self.fifo: deque[int] = deque()
        self.volts = 0.0
        self.output: list[float] = []
        self.played: list[float] = []
        self.drops: list[int] = []
        self._start, self._ticks = time.now(), 0

    def run(self) -> None:
        """Play up to now."""
        due = int((self.time.now() - self._start) * self.rate)
        while self._ticks < due:
            self._ticks += 1
            self.tick(self._start + self._ticks / self.rate)
            self.output.append(self.volts)

    def tick(self, now: float) -> None:
        """Put out one sample."""
        raise NotImplementedError

    def reset(self) -> None:
        """Set the registers as they are after power came."""
        raise NotImplementedError

    def power_cycle(self) -> None:
        """Lose everything."""
        self.run()
        self.drop()
        self.fifo.clear()
        self.reset()

    def drop(self) -> None:
        """Go to 0 V whatever is played."""
        if self.volts:
            self.drops.append(len(self.output))
        self.volts = 0.0

    def waveform(self) -> Floats:
        """Return what was put out until now [V]."""
        self.run()
        return np.asarray(self.output)


class Drv2667Model(Playing):
    """A DRV2667, or with ``identity=5`` a DRV2665."""

    def __init__(self, time: Clock, rate: float = 8000.0, identity: int = 7) -> None:
        super().__init__(time, rate)
        self.identity = identity
        self.reset()

    def reset(self) -> None:
        """Set the registers as they are after power came."""
        self.control = {1: 0x38 & 0x07 | self.identity << 3, 2: 0x40}
        self._pointer, self._illegal = 0, False
        self._active_from: float | None = None
        self._empty_since: float | None = None

    def tick(self, now: float) -> None:
        """Play a sample, hold, or time out."""
        if self._active_from is None or now < self._active_from:
            return
        if self.fifo:
            code = self.fifo.popleft()
            self.volts = code / 127 * (25, 50, 75, 100)[self.control[1] & 3]
            self.played.append(self.volts)
            self._empty_since = None if self.fifo else now
        elif self._empty_since is None:
            self._empty_since = now
        elif self._timed_out(now - self._empty_since):
            self.drop()
            self._active_from = None

    def _timed_out(self, empty: float) -> bool:
        timeout = (1 + (self.control[2] >> 2 & 3)) * 5e-3
        return empty >= timeout and not self.control[2] & 2

    def write(self, data: bytes) -> None:
        """Take a write transfer."""
        self.run()
        self._pointer, values = data[0], data[1:]
        if self._pointer == 0x0B:
            for value in values:
                self._push(value)
            return
        for k, value in enumerate(values):
            self._register(self._pointer + k, value)

    def _push(self, value: int) -> None:
        if self.control[2] & 0x40 or len(self.fifo) >= 100:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        if self._active_from is None:
            self._active_from = self.time.now() + 2e-3
        self._empty_since = None
        self.fifo.append(value - 256 if value > 127 else value)

    def _register(self, register: int, value: int) -> None:
        if register == 2 and value & 0x80:
            self.power_cycle()
        elif register == 1:
            self.control[1] = value & 0x07 | self.identity << 3
        elif register == 2:
            self.control[2] = value & 0x4F
            if value & 0x40:
                self.drop()
                self.fifo.clear()
                self._active_from = None
        elif not 0 <= register <= 0x0B:
            self._illegal = True

    def read(self, size: int) -> bytes:
        """Answer a read transfer."""
        self.run()
        status = 4 * self._illegal + 2 * (not self.fifo) + (len(self.fifo) >= 100)
        values = {0: status, **self.control}
        return bytes(values.get(self._pointer + k, 0) for k in range(size))


class Bos1921Model(Playing):
    """A BOS1921."""

    def __init__(self, time: Clock, rate: float = 8000.0) -> None:
        super().__init__(time, rate)
        self.reset()

    def reset(self) -> None:
        """Set the registers as they are after power came."""
        self.registers = {0x05: 0x0007, 0x0B: 0x001E}
        self.error = False

    @property
    def playing(self) -> bool:
        """Whether FIFO and output are on."""
        return self.registers[0x05] & 0x0610 == 0x0210

    def tick(self, now: float) -> None:
        """Play a sample or hold the last."""
        if self.playing and self.fifo:
            scale = 13.28 if self.registers[0x05] & 0x0800 else 3.6 * 31
            self.volts = self.fifo.popleft() / 2047 * scale
            self.played.append(self.volts)

    def write(self, data: bytes) -> None:
        """Take a write transfer: register, then words."""
        self.run()
        register = data[0]
        words = [data[k] << 8 | data[k + 1] for k in range(1, len(data) - 1, 2)]
        for word in words:
            if register == 0:
                self._push(word & 0xFFF)
            elif register == 0x05 and word & 0x0040:
                self.power_cycle()
            else:
                self.registers[register] = word
                if register == 0x05 and not word & 0x0010:
                    self.drop()

    def _push(self, code: int) -> None:
        if not self.playing:
            return
        if len(self.fifo) >= 1024:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        self.fifo.append(code - 4096 if code > 2047 else code)

    def read(self, size: int) -> bytes:
        """Answer a read transfer: the register that COMM names."""
        self.run()
        free = 1024 - len(self.fifo)
        state = self.error << 12 | (not free) << 11 | (free == 1024) << 10 | free & 0x3FF
        status = (3 if self.error else 2 if self.playing else 0) << 8 | 0x80 * self.error
        values = {0x10: status, 0x11: state, 0x1E: 0x3781, **self.registers}
        return values.get(self.registers[0x0B] & 0x1F, 0).to_bytes(2, "big")[:size]


class Tca9548aModel:
    """A multiplexer: a bit per port."""

    def __init__(self) -> None:
        self.ports = 0

    def power_cycle(self) -> None:
        """Lose everything."""
        self.ports = 0

    def write(self, data: bytes) -> None:
        """Take the ports."""
        self.ports = data[-1]

    def read(self, size: int) -> bytes:
        """Answer with the ports."""
        return bytes([self.ports] * size)


ChipModel = Drv2667Model | Bos1921Model | Tca9548aModel


class ModelBus:
    """An adapter with chips.

    Parameters
    ----------
    time : the virtual clock, which transfers move on
    chips : models by address, or by (port, address) behind the multiplexer at 0x70
    clock : clock of the bus [Hz]; None for transfers that take no time

    Attributes
    ----------
    gone : the whole bus
    fault : asked before each transfer, given address and bytes: None to let it pass, else how many
        bytes come through before one is refused, −1 for a refused address
    transfers, bits : so far
    closed : whether it was let go of
    """

    def __init__(
        self,
        time: Clock,
        chips: dict[int | tuple[int, int], ChipModel],
        clock: float | None = 400e3,
    ) -> None:
        self.time, self.chips, self.clock = time, chips, clock
        self.gone = self.closed = False
        self.fault: Callable[[int, bytes], int | None] = lambda address, data: None
        self.transfers = self.bits = 0

    def _chip(self, address: int) -> ChipModel:
        if self.gone:
            raise OSError(errno.ENXIO, "No such device or address")
        if address in self.chips:
            return self.chips[address]
        mux = self.chips.get(0x70)
        if isinstance(mux, Tca9548aModel):
            for port in range(8):
                if mux.ports >> port & 1 and (port, address) in self.chips:
                    return self.chips[port, address]
        raise OSError(errno.ENXIO, "No such device or address")

    def _pass(self, count: int) -> None:
        self.transfers += 1
        self.bits += 9 * (1 + count) + 2
        if self.clock:
            self.time.sleep((9 * (1 + count) + 2) / self.clock)

    def write(self, address: int, data: bytes) -> None:
        """Write to a chip: all bytes at the start of the transfer, the least room there can be."""
        chip, through = self._chip(address), self.fault(address, data)
        if through is None:
            chip.write(data)
            self._pass(len(data))
            return
        if through > 1:
            chip.write(data[:through])
        self._pass(max(through, 0))
        if through < 0:
            raise OSError(errno.ENXIO, "No such device or address")
        raise OSError(errno.EREMOTEIO, "Remote I/O error")

    def write_read(self, address: int, data: bytes, size: int) -> bytes:
        """Write, then read."""
        if data:
            self.write(address, data)
        chip = self._chip(address)
        self._pass(size)
        return chip.read(size)

    def close(self) -> None:
        """Let go."""
        self.closed = True
