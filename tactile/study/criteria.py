"""Criteria that a design is judged by: each is one number, computed from the response in a band.

Means over a band are integrals over frequency in Hz (trapezoidal rule over the study's frequencies,
which include the band's ends), so that they do not depend on how densely the band is sampled.
"Smallest" refers to the frequencies that were solved.
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
    """Conditions under which a design is judged.

    Attributes
    ----------
    band : (float, float) or None
        Lowest and highest frequency [Hz], or None if no criterion needs a band.
    voltage : float
        Limit of the drive [V].
    field : float
        Limit of the field in a piezo layer [V/m]; thin layers reach it below the drive's limit.
    current : float
        Limit of the amplifier's current for one channel [A]; infinite by default.
    amplitude : float
        Flat shear that a drive has to produce [m].

    Raises
    ------
    InputError
        If the band does not ascend, or a limit is not above 0.
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
    """A specimen and its response in the band, from which criteria are computed.

    Attributes
    ----------
    specimen : Specimen
        Designs.
    response : TipResponse or None
        Response with (..., F) arrays in the band, or None if nothing was solved over frequency.
    conditions : Conditions
        Band and limits.
    """

    specimen: Specimen
    response: TipResponse | None
    conditions: Conditions

    @property
    def solved(self) -> TipResponse:
        """Response in the band, for criteria that need one; raises ValueError if there is none."""
        if self.response is None:
            raise ValueError("this criterion needs a response in a band")
        return self.response

    @property
    def displacement(self) -> Floats:
        """Magnitude of the shear (..., F), at the measuring point if there is one [m/V]."""
        at_point = self.solved.displacement_at_point
        return np.abs(self.solved.displacement if at_point is None else at_point)

    @property
    def force(self) -> Floats:
        """Magnitude of the force into the skin (..., F) [N/V]."""
        return np.abs(self.solved.force)

    @property
    def admittance(self) -> Floats:
        """Magnitude of the electrical admittance (..., F) [S]."""
        return np.abs(self.solved.admittance)

    def over_band(self, values: Floats) -> Floats:
        """Compute the mean over the band.

        Parameters
        ----------
        values : (..., F) array of float
            Values at the frequencies of the response.

        Returns
        -------
        (...,) array of float
            Means, in the unit of the values.
        """
        f = self.solved.frequency
        return np.asarray(np.trapezoid(values, f, axis=-1) / (f[-1] - f[0]))


@dataclass(frozen=True)
class Criterion:
    """A scalar measure of a design.

    Attributes
    ----------
    unit : str
        Unit, for labels.
    means : str
        Meaning, for labels.
    sign : int
        1 if more is better, −1 if less is, 0 if neither is.
    needs_band : bool
        Whether the criterion is computed from a response in a band.
    judge : callable
        Function from `Solved` to an array (...,) of values in the unit.
    """

    unit: str
    means: str
    sign: int
    needs_band: bool
    judge: Callable[[Solved], Floats]


def _magnitude_criteria(
    what: str, unit: str, scale: float, size: Callable[[Solved], Floats]
) -> dict[str, Criterion]:
    """Return the four criteria that judge a magnitude over a band."""

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
    """Compute the drive that the limits of voltage, field and current allow.

    Parameters
    ----------
    s : Solved
        Designs, response and limits.

    Returns
    -------
    (..., F) array of float
        Largest permitted amplitude of the drive [V].
    """
    b = s.specimen.bimorph
    with np.errstate(divide="ignore"):
        current_limit = s.conditions.current / s.admittance
    field_limit = s.conditions.field * np.asarray(b.piezo_height) / b.layer_voltage
    return np.minimum(np.minimum(s.conditions.voltage, field_limit)[..., None], current_limit)


def _attainable(s: Solved) -> Floats:
    """Return the flat shear that the limits of the drive allow over the band [µm]."""
    return np.asarray((s.displacement * drive_limit(s)).min(axis=-1) * 1e6)


def _drive(s: Solved) -> Floats:
    """Return the largest drive for the required flat shear over the band [V]."""
    return np.asarray(s.conditions.amplitude / s.displacement.min(axis=-1))


def _field(s: Solved) -> Floats:
    """Return the largest field for the required flat shear over the band [V/mm]."""
    b = s.specimen.bimorph
    return np.asarray(_drive(s) * b.layer_voltage / b.piezo_height * 1e-3)


def _current(s: Solved) -> Floats:
    """Return the largest current for the required flat shear over the band [mA]."""
    volts = s.conditions.amplitude / s.displacement
    return np.asarray((volts * s.admittance).max(axis=-1) * 1e3)


def _shaping(s: Solved) -> Floats:
    """Return the ratio of the largest to the smallest shear in the band [dB]."""
    size = s.displacement
    return np.asarray(20 * np.log10(size.max(axis=-1) / size.min(axis=-1)))


def _blocked(s: Solved) -> Floats:
    """Return the static blocked force of the tip [mN/V]."""
    force, _ = blocked_force(s.specimen.bimorph, [0.0], axial_force=s.specimen.axial_force)
    return np.asarray(np.abs(force)[..., 0] * 1e3)


def _resonance(s: Solved) -> Floats:
    """Return the first resonance in air [Hz]."""
    return first_resonance(s.specimen.bimorph, axial_force=s.specimen.axial_force)


def _footprint(s: Solved) -> Floats:
    """Return width times height of the bender [mm²]."""
    b = s.specimen.bimorph
    return np.asarray(_as_array(b.width) * b.height * 1e6)


def _total_length(s: Solved) -> Floats:
    """Return the length of the bender with its clamped part [mm]."""
    b = s.specimen.bimorph
    return np.asarray((_as_array(b.length) + b.clamped_length) * 1e3)


def _as_array(value: Real) -> Floats:
    return np.asarray(value, np.float64)


CRITERIA: dict[str, Criterion] = {
    **_magnitude_criteria("displacement", "µm/V", 1e6, lambda s: s.displacement),
    **_magnitude_criteria("force", "mN/V", 1e3, lambda s: s.force),
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
    "standing": Criterion("mm", "length of the bender, clamp included", -1, False, _total_length),
}
"""Criteria by name."""


def numbers_of(names: Iterable[str], solved: Solved) -> dict[str, Floats]:
    """Compute criteria of solved designs.

    Parameters
    ----------
    names : iterable of str
        Names of `CRITERIA`.
    solved : Solved
        Designs and their response.

    Returns
    -------
    dict of str to (...,) array of float
        Values by name, in the criterion's unit. They are infinite or NaN for a bender without
        piezoelectricity, which does not move and would need an infinite drive for any shear.
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
"""Spelling of each unit at the end of a variable's name."""


def variable(criterion: str) -> str:
    """Return the name of a criterion with its unit, as data sets have it.

    Parameters
    ----------
    criterion : str
        Name of `CRITERIA`.

    Returns
    -------
    str
        Name of the variable, such as ``first_resonance_hz``.
    """
    return f"{criterion}_{UNIT_NAMES[CRITERIA[criterion].unit]}"
