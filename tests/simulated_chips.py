"""Two DRV2667 behind a multiplexer in a simulation, and their output."""

from collections.abc import Callable

import numpy as np
from chip_models import ChipModel, Drv2667Model, ModelBus, Tca9548aModel
from numpy.typing import NDArray
from virtual_clock import VirtualClock

from tactile.arrays import Floats

Bools = NDArray[np.bool_]
DEVICE = "drv2667:0?mux=0x70&ports=0,1"
PATH = "/dev/i2c-0"
RATE, LSB = 8000.0, 75 / 127
"""Sample rate of what is written [Hz], and volts of a code in the range of 150 V peak to peak."""
RATES = (8000 * 0.995, 8000 * 1.005)
"""Sample rates by the chips' own clocks [Hz]."""
READ = 5e-3
"""Time between two looks at what the chips have put out [s]."""
REFUSED = -1
"""Answer of `ModelBus.fault` for a transfer whose address is not acknowledged."""


class Chips:
    """The chips, which play on whether or not anybody writes to them.

    Parameters
    ----------
    clock : clock of all chips
    put_out : called with a chip's number, the volts (S, 1) [V] that it has put out, at which times
        (S,) [s], and whether it went to 0 V by itself at each (S,)
    """

    def __init__(
        self, clock: VirtualClock, put_out: Callable[[int, Floats, Floats, Bools], None]
    ) -> None:
        self._clock, self._put_out = clock, put_out
        self._mux = Tca9548aModel()
        self._chips = [Drv2667Model(clock, rate) for rate in RATES]
        models: dict[int | tuple[int, int], ChipModel] = {0x70: self._mux}
        models.update({(port, 0x59): chip for port, chip in enumerate(self._chips)})
        self.adapter = ModelBus(clock, models)
        self._go_on()

    def _go_on(self) -> None:
        self._hand_on()
        self._clock.after(READ, self._go_on)

    def _hand_on(self) -> None:
        for number, chip in enumerate(self._chips):
            volts = chip.waveform()[:, None]
            times = self._clock.now() - np.arange(len(volts))[::-1] / chip.rate
            dropped = np.isin(np.arange(len(volts)), chip.drops)
            chip.drops[:] = [at - len(volts) for at in chip.drops if at >= len(volts)]
            chip.output.clear()
            if len(volts):
                self._put_out(number, volts, times, dropped)

    def unplug(self, seconds: float) -> None:
        """Take the adapter away for a while."""
        self.adapter.gone = True
        self._clock.after(seconds, lambda: setattr(self.adapter, "gone", False))

    def stall(self, seconds: float) -> None:
        """Acknowledge nothing for a while."""
        end = self._clock.now() + seconds
        self.adapter.fault = lambda address, data: REFUSED if self._clock.now() < end else None

    def power_cycle(self) -> None:
        """Take power away, and give it again."""
        self._hand_on()
        self._mux.power_cycle()
        for chip in self._chips:
            chip.power_cycle()
