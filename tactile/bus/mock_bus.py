"""``mock:``, an amplifier that is not there but behaves: the same contract, ramps and counters.

It holds its last output over a gap, drops what was sent before, plays what is not finite as 0 V and
keeps its own voltage limit. It remembers what it put out, ramps included: the last second, or with
``?keep=all`` everything.
"""

from collections import deque

import numpy as np

from tactile.bus.base import Address, Bus, DriveBlock, Floats, Rig, Wiring, register_bus
from tactile.errors import InputError


class MockBus(Bus):
    """An amplifier in memory.

    Parameters
    ----------
    wiring : what it drives
    keep : "second" or "all" of the output
    """

    on_host_death = "ramps"

    def __init__(self, wiring: Wiring, *, keep: str = "second") -> None:
        super().__init__(wiring)
        self._all = keep == "all"
        self._kept: deque[Floats] = deque()
        self._kept_samples = 0
        self._position = 0
        self._last = np.zeros(wiring.channels)

    @property
    def output(self) -> Floats:
        """Volts put out (S, C), what is kept of them [V]."""
        return np.concatenate([np.zeros((0, self.wiring.channels)), *self._kept])

    def _start(self, position: int) -> None:
        self._position = position

    def _write(self, block: DriveBlock) -> None:
        ahead = block.position - self._position
        volts = block.volts
        if ahead < 0:
            self.counters.repeated_samples += min(-ahead, len(volts))
            volts = volts[-ahead:]
        elif ahead > 0:
            self.counters.lost_samples += ahead
            self._hold(ahead)
        self.counters.blocks += 1
        self.counters.samples += len(volts)
        self._position += len(volts)
        self._put(self._allowed(volts))

    def _hold(self, count: int) -> None:
        """Put the last output out again, a second at a time at most."""
        self._position += count
        longest = int(self.wiring.sample_rate)
        for k in range(0, count, longest):
            self._put(np.repeat(self._last[None], min(longest, count - k), axis=0))

    def _allowed(self, volts: Floats) -> Floats:
        limit = self.wiring.voltage
        if np.abs(volts).max(initial=0.0) <= limit:
            return volts
        bad = ~np.isfinite(volts)
        volts = np.where(bad, 0.0, volts)
        self.counters.invalid_samples += int(bad.sum())
        self.counters.clipped_samples += int(np.count_nonzero(np.abs(volts) > limit))
        return np.clip(volts, -limit, limit)

    def _stop(self) -> None:
        count = max(round(self.wiring.fade * self.wiring.sample_rate), self._fastest())
        ramp = 1 - np.arange(1, count + 1) / max(count, 1)
        self._put(ramp[:, None] * self._last)

    def _abort(self) -> None:
        step = self.wiring.slew / self.wiring.sample_rate
        fall = step * np.arange(1, self._fastest() + 1)[:, None]
        self._put(np.maximum(np.abs(self._last) - fall, 0) * np.sign(self._last))

    def _fastest(self) -> int:
        """Return in how many samples the slew limit allows 0 V."""
        step = self.wiring.slew / self.wiring.sample_rate
        return int(np.ceil(np.abs(self._last).max() / step))

    def _put(self, volts: Floats) -> None:
        """Put volts out; a driver with something behind it goes on from here."""
        if not len(volts):
            return
        self._last = volts[-1].copy()
        self._kept.append(volts.copy())
        self._kept_samples += len(volts)
        while not self._all and self._kept_samples - len(self._kept[0]) >= self.wiring.sample_rate:
            self._kept_samples -= len(self._kept.popleft())


def kept(address: Address) -> str:
    """Return the ``keep`` option of an address.

    Raises
    ------
    InputError
        Where it is neither "second" nor "all".
    """
    keep = address.options.get("keep", "second")
    if keep not in ("second", "all"):
        raise InputError(f"{address.scheme}: keep = {keep!r}: must be 'second' or 'all'")
    return keep


def _open(address: Address, rig: Rig, sample_rate: float) -> MockBus:
    address.only("keep")
    return MockBus(Wiring.of(rig, sample_rate), keep=kept(address))


register_bus("mock", _open)
