"""Simulated display ``sim:``, a mock amplifier with a model of the actuators behind it.

Unlike a real amplifier it knows how the skin is sheared, and which current flows into each
contactor. ``sim:`` simulates the display's own bimorph, amplifier and finger. With an option about
finger, force, tolerance or hysteresis, ``sim:?finger=mid&force=0.2:2&liftoff=1``, the load of each
contactor changes while it plays (`TouchedPlant`). With ``coupling=0.2`` the skin couples them
(`CoupledTouchedPlant`). ``sim:?plant=package.module:factory`` uses
another plant: ``factory(display, sample_rate)`` must return an object with ``delay`` and ``step``
like those of `Plant`.
"""

import importlib
import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from firmware_protocol.messages import SampleFormat
from tactile.actuator.actuator import PlantLike
from tactile.actuator.coupled_plant import CoupledTouchedPlant
from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.hysteresis import Hysteresis
from tactile.actuator.plant import Plant
from tactile.actuator.population import random_finger
from tactile.actuator.tolerances import Tolerances
from tactile.actuator.touch import TRANSITION, NormalForce, Touch
from tactile.actuator.touched_plant import LARGEST_FORCE, TouchedPlant
from tactile.arrays import Floats
from tactile.bus.base import RATE, Bus, DisplayLike, Wiring
from tactile.bus.options import FORMATS, Keep, Options, SampleFormatName
from tactile.bus.registry import Address, register_bus
from tactile.bus.simulated.current_sensor import SensorDesign
from tactile.bus.simulated.mock_bus import MockBus
from tactile.display.display import Display
from tactile.errors import InputError

JUDGED_BAND = (20.0, 1000.0)
"""Lowest and highest frequency at which the fidelity of played shear is measured [Hz]."""

FINGERS = {
    "low": FingerLoad.low,
    "mid": FingerLoad.mid,
    "high": FingerLoad.high,
    "air": FingerLoad.none,
}
"""Loads by the values of the option ``finger``."""
COUPLING_EXPONENT = 4.8
"""Power of the distance by which couplings fall (assumed): where skin slips on the walls between
openings, a design study had 0.2 at 2.5 mm and 0.04 at 3.5 mm."""
LEAST_FORCE = 1e-3
"""Smallest normal force of a finger that touches [N]."""
PERIOD = 1.5
"""Period of a force that swings, unless it is given [s]."""
LONGEST = 86400.0
"""Latest time at which a finger lifts off or touches again [s]."""


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
    finger : str or None
        Finger at 1 N: ``low``, ``mid``, ``high``, ``random:SEED`` (each contactor differs) or
        ``air``; by default that of the display.
    force : str or None
        Normal force in newtons, as ``1``, or as ``0.2:2`` if it swings between two; by default 1 N,
        or the middle force of a finger table.
    period : float or None
        Period of a force that swings, 1.5 s by default [s].
    liftoff : float or None
        Time of played samples at which the finger lifts off [s]; by default never.
    retouch : float or None
        Time at which it touches again [s]; by default never.
    tolerance : int or None
        Seed of benders that differ; by default all are as designed.
    hysteresis : float
        Width of the ceramic's loop at the largest voltage that its layers bear, as a fraction of
        its swing; 0.12 to 0.15 is usual.
    coupling : float
        Coupling of contactors that are nearest to each other through the skin, at a force that is
        steady; of others it falls with the distance (`COUPLING_EXPONENT`).
    correlation_ms : int or None
        Length of the windows of correlated currents, of whole samples [ms]; by default the
        amplifier does not measure. It has a range of ±2.5 mA and 12 bits with noise.
    """

    keep: Keep = "second"
    plant: str | None = None
    format: SampleFormatName = "pcm16"
    finger: str | None = None
    force: str | None = None
    period: Annotated[float, Meta(ge=0.05, le=3600)] | None = None
    liftoff: Annotated[float, Meta(ge=0, le=LONGEST)] | None = None
    retouch: Annotated[float, Meta(ge=0, le=LONGEST)] | None = None
    tolerance: Annotated[int, Meta(ge=0, le=2**31 - 1)] | None = None
    hysteresis: Annotated[float, Meta(ge=0, le=0.3)] = 0.0
    coupling: Annotated[float, Meta(ge=0, le=0.3)] = 0.0
    correlation_ms: Annotated[int, Meta(ge=10, le=100)] | None = None

    @property
    def touched(self) -> bool:
        """Whether an option wants fingers that change or couple, or benders that differ."""
        wanted = self.finger, self.force, self.period, self.liftoff, self.retouch, self.tolerance
        given = any(option is not None for option in wanted)
        return given or self.hysteresis > 0 or self.coupling > 0


class _Kept:
    """Samples that wait to be taken, as many as `limit` at least."""

    def __init__(self, channels: int, limit: float) -> None:
        self.dropped = 0
        self._limit = limit
        self._none = np.zeros((0, channels))
        self._blocks: deque[Floats] = deque()
        self._count = 0

    def add(self, block: Floats) -> None:
        """Append a block, and drop the oldest ones that are not needed for the limit."""
        self._blocks.append(block)
        self._count += len(block)
        while self._count - len(block) > self._limit:
            dropped = len(self._blocks.popleft())
            self._count -= dropped
            self.dropped += dropped

    def take(self) -> Floats:
        """Return all samples, and keep none."""
        taken = np.concatenate([self._none, *self._blocks])
        self._blocks.clear()
        self._count = 0
        return taken


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
    correlation_ms : int
        Length of the windows of correlated currents that the amplifier measures [ms]; 0 for none.

    Attributes
    ----------
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
        correlation_ms: int = 0,
    ) -> None:
        contactors = len(display.contactors)
        self._display = display
        self._plant = default_plant(display, sample_rate) if plant is None else plant
        self._stepped: list[tuple[Floats, Floats]] = []
        """Shear and currents that the plant has given and that are not kept yet."""
        self._wanted = np.zeros(self._plant.delay, np.bool_)
        """Whether each sample that the plant gives next belongs to drive that was put out."""
        self._ahead = 0
        """Number of samples that were played for the sensor and not put out yet."""
        self._shear = _Kept(contactors, math.inf if keep == "all" else sample_rate)
        self._currents = _Kept(contactors, sample_rate)
        self.peak_current = 0.0
        super().__init__(
            Wiring.of(display, sample_rate), keep=keep, sample_format=sample_format,
            currents=self._measured if correlation_ms else None,
            sensor=SensorDesign(delay=self._plant.delay), correlation_ms=correlation_ms,
        )  # fmt: skip

    @property
    def dropped_shear(self) -> int:
        """Samples of shear that were not taken within a second; none are if all are kept."""
        return self._shear.dropped

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Whether a finger is on each contactor, array (N,); always so under a constant load.

        Raises
        ------
        InputError
            If the plant is not the display's own.
        """
        plant = self._plant
        if isinstance(plant, TouchedPlant):
            return plant.touching
        return np.full(len(self._display.contactors), bool(np.any(np.asarray(self.finger.k0) > 0)))

    @property
    def finger(self) -> FingerLoad:
        """Present load: of arrays (N,) over contactors, or of numbers if it is constant.

        It is 16 samples ahead of the shear and the currents that were taken last.

        Raises
        ------
        InputError
            If the plant is not the display's own.
        """
        if isinstance(self._plant, TouchedPlant):
            return self._plant.load
        if isinstance(self._plant, Plant):
            return self._display.load_at(_middle_force(self._display))
        raise InputError("sim: the load of another plant is not known")

    def _measured(self, volts: Floats, sample_rate: float) -> Floats:
        """Return the currents (S, C) that channels draw, as late as the plant gives them."""
        del sample_rate
        self._ahead += len(volts)
        currents = np.zeros_like(volts)
        currents[:, self._display.channel] = self._step_plant(volts)
        return currents

    def _put(self, volts: Floats, lines: NDArray[np.uint8]) -> None:
        super()._put(volts, lines)
        if self.correlates:  # the plant has played what is put out, and rest after it
            rest = self._ahead - len(volts)
        else:
            self._step_plant(volts)
            rest = 0
        self._ahead = 0
        self._keep(np.repeat([True, False], [len(volts), rest]))

    def _step_plant(self, volts: Floats) -> Floats:
        """Feed the plant with the drive of the channels, and return the contactors' currents."""
        shear, current = self._plant.step(volts[:, self._display.channel])
        self.peak_current = max(self.peak_current, float(np.abs(current).max(initial=0.0)))
        self._stepped.append((shear, current))
        return current

    def _keep(self, wanted: NDArray[np.bool_]) -> None:
        """Keep what the plant has given for drive that was put out, and say what comes next."""
        wanted = np.concatenate([self._wanted, wanted])
        for shear, current in self._stepped:
            now, wanted = wanted[: len(shear)], wanted[len(shear) :]
            if now.any():
                self._shear.add(shear[now] * self._display.polarity)
                self._currents.add(current[now])
        self._stepped.clear()
        self._wanted = wanted

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
        return self._shear.take()

    def take_currents(self) -> Floats:
        """Return the currents since the last call, at most those of the last second.

        As of `take_shear`, the first sample of the first call belongs to the first drive sample.

        Returns
        -------
        (S, N) array of float
            Current into each contactor [A].
        """
        return self._currents.take()

    def settle(self) -> None:
        """Run the plant on at 0 V until its output covers everything that was played."""
        self._step_plant(np.zeros((self._plant.delay, self._display.channels)))
        self._keep(np.zeros(self._plant.delay, np.bool_))


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
    return display.actuator.plant(
        display.load_at(_middle_force(display)),
        sample_rate,
        contactors=len(display.contactors),
        amplifier=display.amplifier,
    )


def _middle_force(display: Display) -> float:
    """Return the middle force of a finger table, or 1 N [N]."""
    return display.load_forces[len(display.load_forces) // 2]


def changing_plant(display: Display, sample_rate: float, options: SimOptions) -> TouchedPlant:
    """Create the plant of a display whose fingers change, as the options say.

    Parameters
    ----------
    display : Display
        Display to simulate, of bimorphs.
    sample_rate : float
        Sample rate of the drive [Hz].
    options : SimOptions
        Finger, force, tolerance, hysteresis and coupling.

    Returns
    -------
    TouchedPlant
        Simulation of all contactors.

    Raises
    ------
    InputError
        If an option has no such value or does not fit another, or if the actuators are not
        bimorphs.
    """
    contactors = len(display.contactors)
    force = _normal_force(options, display)
    tolerances, hysteresis = None, None
    if options.tolerance is not None:
        tolerances = Tolerances.drawn(contactors, options.tolerance)
    if options.hysteresis > 0:
        full = 1 / display.actuator.overload(1.0)[0]
        hysteresis = Hysteresis(width=options.hysteresis, full_drive=full)
    plant: Callable[..., TouchedPlant] = TouchedPlant
    if options.coupling > 0:
        plant = partial(CoupledTouchedPlant, coupling=_couplings(display, force, options.coupling))
    return plant(
        display.bimorph,
        Touch(load=_finger(options.finger, display), force=force),
        sample_rate,
        contactors=contactors,
        amplifier=display.amplifier,
        tolerances=tolerances,
        hysteresis=hysteresis,
    )


def _couplings(display: Display, force: NormalForce, nearest: float) -> Floats:
    """Return the couplings (N, N) of contactors per volt of each, by that of the nearest."""
    if force.low != force.high or np.isfinite(force.liftoff):
        raise InputError("sim: coupling: needs a force that is steady")
    away = np.linalg.norm(display.contactors[:, None] - display.contactors, axis=2)
    np.fill_diagonal(away, np.inf)
    couplings = nearest * (away.min() / away) ** COUPLING_EXPONENT
    if np.linalg.eigvalsh(np.eye(len(away)) - couplings)[0] <= 0:
        raise InputError(
            f"sim: coupling = {nearest:g}: together the contactors would have a negative load"
        )
    return np.asarray(couplings * display.polarity * display.polarity[:, None])


def _finger(text: str | None, display: Display) -> FingerLoad | FingerTable:
    """Return the finger that the option names, or the display's."""
    if text is None:
        return display.load
    if text in FINGERS:
        return FINGERS[text]()
    kind, _, seed = text.partition(":")
    if kind == "random" and seed.isascii() and seed.isdecimal():
        return random_finger(int(seed), len(display.contactors))
    raise InputError(f"sim: finger = {text!r}: must be {', '.join(FINGERS)} or random:SEED")


def _normal_force(options: SimOptions, display: Display) -> NormalForce:
    """Return the course of the force that the options describe."""
    given = {"force": options.force, "liftoff": options.liftoff, "retouch": options.retouch}
    if options.finger == "air":
        for name, value in given.items():
            if value is not None:
                raise InputError(f"sim: {name}: a finger in air has none")
        return NormalForce(low=0.0, high=0.0)
    low = high = _middle_force(display) if options.finger is None else 1.0
    if options.force is not None:
        low, high = _newtons(options.force)
    if options.period is not None and low == high:
        raise InputError("sim: period: needs a force that swings, as in force=0.2:2")
    liftoff = np.inf if options.liftoff is None else options.liftoff
    retouch = np.inf if options.retouch is None else options.retouch
    if retouch < np.inf and not retouch >= liftoff + TRANSITION:
        raise InputError(
            f"sim: retouch = {retouch:g} s: must be {1e3 * TRANSITION:g} ms after liftoff or later"
        )
    return NormalForce(
        low=low, high=high, period=options.period or PERIOD, liftoff=liftoff, retouch=retouch
    )


def _newtons(text: str) -> tuple[float, float]:
    """Return the ends of a force, which are alike if it does not swing."""
    try:
        ends = [float(part) for part in text.split(":")]
    except ValueError:
        ends = []
    if not (
        len(ends) in (1, 2)
        and all(LEAST_FORCE <= end <= LARGEST_FORCE for end in ends)
        and ends[0] <= ends[-1]
    ):
        raise InputError(
            f"sim: force = {text!r}: must be newtons or low:high, {LEAST_FORCE:g} … "
            f"{LARGEST_FORCE:g} N"
        )
    return ends[0], ends[-1]


class Fidelity:
    """Running signal-to-error ratio of played shear against commanded shear, in 20–1000 Hz.

    Parameters
    ----------
    sample_rate : float
        Sample rate of the shear [Hz].
    """

    def __init__(self, sample_rate: float) -> None:
        from scipy.signal import butter  # takes 0.3 s, which other programs are spared

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
        from scipy.signal import sosfilt, sosfilt_zi

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
    plant: PlantLike | None = None
    if options.plant is not None:
        if options.touched:
            raise InputError("sim: plant: has a finger of its own, so that no other can be given")
        plant = _load_plant(options.plant, display, sample_rate)
    elif options.touched:
        plant = changing_plant(display, sample_rate, options)
    return SimulatedDisplay(
        display, sample_rate,
        plant=plant, keep=options.keep, sample_format=FORMATS[options.format],
        correlation_ms=options.correlation_ms or 0,
    )  # fmt: skip


register_bus("sim", _open, SimOptions)
