"""Simulated display ``sim:``, a mock amplifier with a model of the actuators behind it.

Unlike a real amplifier it knows how the skin is sheared. ``sim:`` simulates the display's own
bimorph, amplifier and finger. ``sim:?plant=package.module:factory`` uses another plant:
``factory(display, sample_rate)`` must return an object with ``delay`` and ``step`` like those of
`Plant`.
"""

import importlib
from collections import deque

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from firmware_protocol.messages import SampleFormat
from tactile.actuator.actuator import PlantLike
from tactile.arrays import Floats
from tactile.bus.base import RATE, Bus, DisplayLike, Wiring
from tactile.bus.options import FORMATS, Keep, Options, SampleFormatName
from tactile.bus.registry import Address, register_bus
from tactile.bus.simulated.mock_bus import MockBus
from tactile.display.display import Display
from tactile.errors import InputError

JUDGED_BAND = (20.0, 1000.0)
"""Lowest and highest frequency at which the fidelity of played shear is measured [Hz]."""


class SimOptions(Options, frozen=True, kw_only=True):
    """Options of a URL ``sim:?option=value&…``.

    Attributes
    ----------
    keep : str
        Part of the output that is kept: the last second, or all.
    plant : str or None
        Factory of a plant, as ``package.module:factory``; by default the display's own plant.
    format : str
        Format of the samples on the line to the amplifier.
    """

    keep: Keep = "second"
    plant: str | None = None
    format: SampleFormatName = "pcm16"


class SimulatedDisplay(MockBus):
    """A simulated display in memory.

    Parameters
    ----------
    display : Display
        Display to simulate.
    sample_rate : float
        Sample rate of the drive [Hz].
    plant : PlantLike, optional
        Model of the N contactors on the skin; by default the display's own bimorph, amplifier and
        finger.
    keep : {"second", "all"}
        Whether to keep the last second or all of the output.
    sample_format : SampleFormat
        Sample format on the link to the amplifier.

    Attributes
    ----------
    dropped_shear : int
        Samples of shear that were not taken within a second; none are dropped if all are kept.
    peak_current : float
        Largest current into any contactor so far [A].
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
        self._shear_count = 0
        self.dropped_shear = 0
        self.peak_current = 0.0

    def _put(self, volts: Floats) -> None:
        super()._put(volts)
        self._step_plant(volts[:, self._display.channel])

    def _step_plant(self, volts: Floats) -> None:
        """Feed the plant with the drive of the contactors, and keep its shear."""
        shear, current = self._plant.step(volts)
        self.peak_current = max(self.peak_current, float(np.abs(current).max(initial=0.0)))
        skipped = min(self._late, len(shear))
        self._late -= skipped
        if len(shear) > skipped:
            self._shear.append(shear[skipped:] * self._display.polarity)
            self._shear_count += len(shear) - skipped
        while self._shear_count - len(shear) > self._kept:
            dropped = len(self._shear.popleft())
            self._shear_count -= dropped
            self.dropped_shear += dropped

    def take_shear(self) -> Floats:
        """Return the shear of the skin since the last call.

        The first sample of the first call belongs to the first drive sample: the delay of the plant
        is removed, so that the shear of the latest ``plant.delay`` samples of drive is still to
        come.

        Returns
        -------
        (S, N) array of float
            Shear displacement of the skin at each contactor [m].
        """
        shear = np.concatenate([np.zeros((0, len(self._display.contactors))), *self._shear])
        self._shear.clear()
        self._shear_count = 0
        return shear

    def settle(self) -> None:
        """Run the plant on at 0 V until its output covers everything that was played."""
        self._step_plant(np.zeros((self._plant.delay, len(self._display.contactors))))
        self._late = self._plant.delay


def default_plant(display: Display, sample_rate: float) -> PlantLike:
    """Create the plant of a display from its own actuators, amplifier and finger.

    Parameters
    ----------
    display : Display
        Display to simulate; of a finger table the middle force is used.
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    PlantLike
        Simulation of all contactors.
    """
    force = display.load_forces[len(display.load_forces) // 2]
    return display.actuator.plant(
        display.load_at(force),
        sample_rate,
        contactors=len(display.contactors),
        amplifier=display.amplifier,
    )


class Fidelity:
    """Running signal-to-error ratio of played shear against commanded shear, in 20–1000 Hz.

    Parameters
    ----------
    sample_rate : float
        Sample rate of the shear [Hz].
    """

    def __init__(self, sample_rate: float) -> None:
        self._filter = butter(4, JUDGED_BAND, "bandpass", fs=sample_rate, output="sos")
        self._state: Floats | None = None
        self._energy = np.zeros(2)

    def add(self, commanded: Floats, played: Floats) -> None:
        """Add further samples.

        Parameters
        ----------
        commanded : (S, N) array of float
            Commanded shear displacement [m].
        played : (S, N) array of float
            Played shear displacement [m].
        """
        if not len(commanded):
            return
        both = np.stack([commanded, played - commanded], axis=1)
        if self._state is None:
            rest = sosfilt_zi(self._filter)
            self._state = np.zeros((*rest.shape, *both.shape[1:]))
        filtered, self._state = sosfilt(self._filter, both, axis=0, zi=self._state)
        self._energy += np.sum(filtered**2, axis=(0, 2))

    @property
    def signal_to_error_db(self) -> float:
        """Ratio so far; infinite without error, NaN before any signal [dB]."""
        signal, error = self._energy
        if not signal > 0:
            return float("nan")
        return float(10 * np.log10(signal / error)) if error > 0 else float("inf")


def _load_plant(name: str, display: Display, sample_rate: float) -> PlantLike:
    """Create a plant from the name of its factory, package.module:factory."""
    module, _, factory = name.partition(":")
    try:
        factory_function = getattr(importlib.import_module(module), factory)
        plant = factory_function(display, sample_rate)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise InputError(f"sim: plant = {name!r}: {error}; give package.module:factory") from error
    delay = getattr(plant, "delay", None)
    if not isinstance(delay, int) or delay < 0 or not callable(getattr(plant, "step", None)):
        raise InputError(f"sim: plant = {name!r}: has no delay from 0 up and no step(drive)")
    return plant  # type: ignore[no-any-return]


def _open(address: Address[SimOptions], display: DisplayLike, sample_rate: float | None) -> Bus:
    """Open the device of a ``sim:`` URL."""
    if not isinstance(display, Display):
        raise InputError("sim: needs a Display, not only its wiring")
    sample_rate = sample_rate or RATE
    options = address.options
    plant = None if options.plant is None else _load_plant(options.plant, display, sample_rate)
    return SimulatedDisplay(
        display, sample_rate,
        plant=plant, keep=options.keep, sample_format=FORMATS[options.format],
    )  # fmt: skip


register_bus("sim", _open, SimOptions)
