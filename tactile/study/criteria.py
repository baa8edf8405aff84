"""What a design is judged by: one number for each, from its response in a band.

Means over a band are integrals over frequency in Hz (trapezoidal rule over the study's
frequencies, in which the band's ends are), so that they do not depend on how densely the band is
sampled; "smallest" is that of the frequencies solved.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from tactile.actuator.materials import LARGEST_FIELD, Real
from tactile.actuator.resonance import first_resonance
from tactile.actuator.response import TipResponse, blocked_force
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.study.parameters import Specimen


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Under what a design is judged.

    Attributes
    ----------
    band : the lowest and highest frequency [Hz], or None where no criterion needs one
    voltage : the drive's limit [V]
    field : the limit in a piezo layer [V/m], which a thin one reaches before that of the drive
    current : the amplifier's limit for one channel [A]; none by default
    amplitude : the flat shear that a drive is asked for [m]

    Raises
    ------
    InputError
        Naming the value that cannot be.
    """

    band: tuple[float, float] | None = None
    voltage: float = 100.0
    field: float = LARGEST_FIELD
    current: float = np.inf
    amplitude: float = 10e-6

    def __post_init__(self) -> None:
        if self.band is not None and not 0 <= self.band[0] < self.band[1] < np.inf:
            raise InputError(
                f"band = {self.band[0]:g}:{self.band[1]:g} Hz: must ascend from 0 Hz or above"
            )
        for name in ("voltage", "field", "current", "amplitude"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} = {getattr(self, name):g}: must be above 0")


@dataclass(frozen=True)
class Solved:
    """A specimen and its response in the band, for criteria to read.

    Attributes
    ----------
    response : (..., F) arrays in the band, or None where nothing was solved over frequency
    """

    specimen: Specimen
    response: TipResponse | None
    conditions: Conditions

    @property
    def solved(self) -> TipResponse:
        """The response, for criteria that need a band."""
        if self.response is None:
            raise ValueError("this criterion needs a response in a band")
        return self.response

    @property
    def displacement(self) -> Floats:
        """Size of the shear (..., F) [m/V], at the measuring point where there is one."""
        at_point = self.solved.displacement_at_point
        return np.abs(self.solved.displacement if at_point is None else at_point)

    @property
    def force(self) -> Floats:
        """Size of the force into the skin (..., F) [N/V]."""
        return np.abs(self.solved.force)

    @property
    def admittance(self) -> Floats:
        """Size of the current per volt (..., F) [S]."""
        return np.abs(self.solved.admittance)

    def over_band(self, values: Floats) -> Floats:
        """Return the mean (...,) of values (..., F) over the band."""
        f = self.solved.frequency
        return np.asarray(np.trapezoid(values, f, axis=-1) / (f[-1] - f[0]))


@dataclass(frozen=True)
class Criterion:
    """One number of a design.

    Attributes
    ----------
    unit, means : of the number, for labels
    sign : 1 where more is better, −1 where less is, 0 where neither is
    needs_band : whether it is read from a response in a band
    judge : from `Solved` to (...,), in the unit
    """

    unit: str
    means: str
    sign: int
    needs_band: bool
    judge: Callable[[Solved], Floats]


def _of_size(
    what: str, unit: str, scale: float, size: Callable[[Solved], Floats]
) -> dict[str, Criterion]:
    """Return the four ways to judge a size over a band."""

    def smallest(s: Solved) -> Floats:
        return np.asarray(size(s).min(axis=-1) * scale)

    def mean(s: Solved) -> Floats:
        return s.over_band(size(s)) * scale

    def rms(s: Solved) -> Floats:
        return np.sqrt(s.over_band(size(s) ** 2)) * scale

    def db_mean(s: Solved) -> Floats:
        with np.errstate(divide="ignore"):
            return np.exp(s.over_band(np.log(size(s)))) * scale

    return {
        f"smallest_{what}": Criterion(unit, f"smallest {what} in the band", 1, True, smallest),
        f"mean_{what}": Criterion(unit, f"mean {what} over the band", 1, True, mean),
        f"rms_{what}": Criterion(unit, f"rms {what} over the band", 1, True, rms),
        f"db_mean_{what}": Criterion(
            unit, f"{what} of the mean level in dB over the band", 1, True, db_mean
        ),
    }


def drive_limit(s: Solved) -> Floats:
    """Return the drive (..., F) [V] that limits of voltage, field and current allow."""
    b = s.specimen.bimorph
    with np.errstate(divide="ignore"):
        allowed = s.conditions.current / s.admittance
    borne = s.conditions.field * np.asarray(b.piezo_height) / b.layer_voltage
    return np.minimum(np.minimum(s.conditions.voltage, borne)[..., None], allowed)


def _attainable(s: Solved) -> Floats:
    return np.asarray((s.displacement * drive_limit(s)).min(axis=-1) * 1e6)


def _drive(s: Solved) -> Floats:
    return np.asarray(s.conditions.amplitude / s.displacement.min(axis=-1))


def _field(s: Solved) -> Floats:
    b = s.specimen.bimorph
    return np.asarray(_drive(s) * b.layer_voltage / b.piezo_height * 1e-3)


def _current(s: Solved) -> Floats:
    volts = s.conditions.amplitude / s.displacement
    return np.asarray((volts * s.admittance).max(axis=-1) * 1e3)


def _shaping(s: Solved) -> Floats:
    size = s.displacement
    return np.asarray(20 * np.log10(size.max(axis=-1) / size.min(axis=-1)))


def _blocked(s: Solved) -> Floats:
    force, _ = blocked_force(s.specimen.bimorph, [0.0], axial_force=s.specimen.axial_force)
    return np.asarray(np.abs(force)[..., 0] * 1e3)


def _resonance(s: Solved) -> Floats:
    return first_resonance(s.specimen.bimorph, axial_force=s.specimen.axial_force)


def _footprint(s: Solved) -> Floats:
    b = s.specimen.bimorph
    return np.asarray(_like(b.width) * b.height * 1e6)


def _standing(s: Solved) -> Floats:
    b = s.specimen.bimorph
    return np.asarray((_like(b.length) + b.clamped_length) * 1e3)


def _like(value: Real) -> Floats:
    return np.asarray(value, np.float64)


CRITERIA: dict[str, Criterion] = {
    **_of_size("displacement", "µm/V", 1e6, lambda s: s.displacement),
    **_of_size("force", "mN/V", 1e3, lambda s: s.force),
    "attainable": Criterion(
        "µm", "flat shear over the band at the limits of drive and field", 1, True, _attainable
    ),
    "drive": Criterion("V", "largest drive for flat shear over the band", -1, True, _drive),
    "field": Criterion("V/mm", "largest field for flat shear over the band", -1, True, _field),
    "current": Criterion("mA", "largest current for flat shear over the band", -1, True, _current),
    "shaping": Criterion("dB", "largest to smallest shear in the band", -1, True, _shaping),
    "blocked_force": Criterion(
        "mN/V", "force of the tip held in place, at rest", 1, False, _blocked
    ),
    "first_resonance": Criterion("Hz", "first resonance in air", 0, False, _resonance),
    "footprint": Criterion("mm²", "width times height of the bender", -1, False, _footprint),
    "standing": Criterion("mm", "length of the bender, clamp included", -1, False, _standing),
}


def numbers_of(names: Iterable[str], solved: Solved) -> dict[str, Floats]:
    """Return criteria (...,) by name, in their units; infinite or NaN where a bender does not move.

    That is one without piezoelectricity, whose drive for any shear is infinite.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return {name: np.asarray(CRITERIA[name].judge(solved)) for name in names}


UNIT_NAMES = {
    "µm/V": "um_per_v",
    "mN/V": "mn_per_v",
    "µm": "um",
    "V": "v",
    "V/mm": "v_per_mm",
    "mA": "ma",
    "dB": "db",
    "Hz": "hz",
    "mm²": "mm2",
    "mm": "mm",
}
"""How a unit is spelled at the end of a name."""


def variable(criterion: str) -> str:
    """Return the name of a criterion with its unit, as data sets have it."""
    return f"{criterion}_{UNIT_NAMES[CRITERIA[criterion].unit]}"
