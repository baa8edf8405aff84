"""``sim:``, the simulated display: a mock amplifier with the plant behind it.

It knows what no amplifier does: how the skin is sheared. ``sim:`` puts the display's own bimorph,
amplifier and finger behind the drive; ``sim:?plant=package.module:factory`` anyone's plant, where
``factory(display, sample_rate)`` returns an object with ``delay`` and ``step`` as `Plant` has them.
"""

import importlib
from collections import deque
from typing import Protocol

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from firmware_protocol.messages import SampleFormat
from tactile.actuator.plant import Plant
from tactile.arrays import Floats
from tactile.bus.base import RATE, Bus, DisplayLike, Wiring
from tactile.bus.options import FORMATS, Keep, Options, SampleFormatName
from tactile.bus.registry import Address, register_bus
from tactile.bus.simulated.mock_bus import MockBus
from tactile.display.display import Display
from tactile.errors import InputError

HEARD = (20.0, 1000.0)
"""Hz over which played shear is judged."""


class SimOptions(Options, frozen=True, kw_only=True):
    """Options of a ``sim:`` URL.

    Attributes
    ----------
    keep : str
        How much of what was put out is remembered: the last second, or all.
    plant : str or None
        Factory of a plant, as ``package.module:factory``; None for the display's own.
    format : str
        Format of the samples on the line to the amplifier.
    """

    keep: Keep = "second"
    plant: str | None = None
    format: SampleFormatName = "pcm16"


class PlantLike(Protocol):
    """What may stand behind the drive.

    Attributes
    ----------
    delay : samples by which the outputs of `step` lag the drive
    """

    delay: int

    def step(self, drive: Floats) -> tuple[Floats, Floats]:
        """Return shear displacement [m] and current [A] (S, N) for drive (S, N) [V]."""
        ...


class SimulatedDisplay(MockBus):
    """A display in memory.

    Parameters
    ----------
    display, sample_rate : what is simulated
    plant : N contactors on the skin; by default the display's own bimorph, amplifier and finger
    keep : "second" or "all" of the output
    sample_format : on the line to the amplifier
    """

    def __init__(
        self,
        display: Display,
        sample_rate: float,
        *,
        plant: PlantLike | None = None,
        keep: str = "second",
        sample_format: SampleFormat = SampleFormat.PCM16,
    ) -> None:
        wiring = Wiring.of(display, sample_rate)
        super().__init__(wiring, keep=keep, sample_format=sample_format)
        self._display = display
        self._plant = default_plant(display, sample_rate) if plant is None else plant
        self._late = self._plant.delay
        self._shear: deque[Floats] = deque()
        self._untaken = 0
        self.dropped_shear = 0
        """Samples of shear that nobody took within a second; with keep=all none are dropped."""
        self.peak_current = 0.0
        """Largest current into any contactor so far [A]."""

    def _put(self, volts: Floats) -> None:
        super()._put(volts)
        self._feel(volts[:, self._display.channel])

    def _feel(self, volts: Floats) -> None:
        shear, current = self._plant.step(volts)
        self.peak_current = max(self.peak_current, float(np.abs(current).max(initial=0.0)))
        skipped = min(self._late, len(shear))
        self._late -= skipped
        if len(shear) > skipped:
            self._shear.append(shear[skipped:] * self._display.polarity)
            self._untaken += len(shear) - skipped
        while not self._all and self._untaken - len(shear) > self.wiring.sample_rate:
            dropped = len(self._shear.popleft())
            self._untaken -= dropped
            self.dropped_shear += dropped

    def take_shear(self) -> Floats:
        """Return the skin's shear (S, N) [m] since the last call.

        Its first sample belongs to the first drive sample; the plant's delay is taken off, so that
        the latest ``plant.delay`` samples of drive are still to come.
        """
        taken = np.concatenate([np.zeros((0, len(self._display.contactors))), *self._shear])
        self._shear.clear()
        self._untaken = 0
        return taken

    def settle(self) -> None:
        """Let the plant run on at 0 V until all that was played has been felt."""
        self._feel(np.zeros((self._plant.delay, len(self._display.contactors))))
        self._late = self._plant.delay


def default_plant(display: Display, sample_rate: float) -> Plant:
    """Return the plant of a display; with a table of fingers that at its middle force."""
    force = display.load_forces[len(display.load_forces) // 2]
    return Plant(
        display.bimorph,
        display.load_at(force),
        sample_rate,
        contactors=len(display.contactors),
        amplifier=display.amplifier,
    )


class Fidelity:
    """Signal-to-error ratio of played against commanded shear, in 20–1000 Hz, as it streams.

    Parameters
    ----------
    sample_rate : [Hz]
    """

    def __init__(self, sample_rate: float) -> None:
        self._filter = butter(4, HEARD, "bandpass", fs=sample_rate, output="sos")
        self._state: Floats | None = None
        self._energy = np.zeros(2)

    def add(self, commanded: Floats, played: Floats) -> None:
        """Take further samples (S, N) [m] of both."""
        if not len(commanded):
            return
        both = np.stack([commanded, played - commanded], axis=1)
        if self._state is None:
            rest = sosfilt_zi(self._filter)
            self._state = np.zeros((*rest.shape, *both.shape[1:]))
        heard, self._state = sosfilt(self._filter, both, axis=0, zi=self._state)
        self._energy += np.sum(heard**2, axis=(0, 2))

    @property
    def signal_to_error_db(self) -> float:
        """The ratio so far [dB]; infinite without error, NaN before any signal."""
        signal, error = self._energy
        if not signal > 0:
            return float("nan")
        return float(10 * np.log10(signal / error)) if error > 0 else float("inf")


def _foreign(name: str, display: Display, sample_rate: float) -> PlantLike:
    module, _, factory = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), factory)
        plant = found(display, sample_rate)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise InputError(f"sim: plant = {name!r}: {error}; give package.module:factory") from error
    delay = getattr(plant, "delay", None)
    if not isinstance(delay, int) or delay < 0 or not callable(getattr(plant, "step", None)):
        raise InputError(f"sim: plant = {name!r}: has no delay from 0 up and no step(drive)")
    return plant  # type: ignore[no-any-return]


def _open(address: Address[SimOptions], display: DisplayLike, sample_rate: float | None) -> Bus:
    if not isinstance(display, Display):
        raise InputError("sim: needs a Display, not only its wiring")
    sample_rate = sample_rate or RATE
    options = address.options
    plant = None if options.plant is None else _foreign(options.plant, display, sample_rate)
    return SimulatedDisplay(
        display, sample_rate,
        plant=plant, keep=options.keep, sample_format=FORMATS[options.format],
    )  # fmt: skip


register_bus("sim", _open, SimOptions)
