"""What may be varied in a design, by name and unit, and the designs that a choice of it makes.

A parameter's name ends in its unit (``length_mm``), as in a display's file. Numbers have limits
within which a bender can be made or the model holds (assumed, wide); names (``load``, ``piezo``,
``shim``, ``wiring``) come from the libraries. Values may be arrays that broadcast: one element a
design.

``firmness`` makes a finger between and around the paper's two: each constant c of the load is
c_low^(1 − φ) c_high^φ, so that φ = 0 is the low finger, 1 the high one, and a normal distribution
of φ a log-normal one of every constant (assumed; two fingers are all that is published).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.bimorph import Bimorph, section
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import PIEZOS, SHIMS, VACUUM_PERMITTIVITY, Real
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.files import nearest

Values = Mapping[str, ArrayLike]
"""Values of parameters by name, in the unit that the name ends in."""


@dataclass(frozen=True)
class DesignParameter:
    """A number of a design.

    Attributes
    ----------
    unit, means : for labels
    low, high : limits, in that unit
    to_si : from a value in that unit, and back by ``from_si``
    part, constant : where it belongs: "bimorph", "piezo" or "shim", or "" for the specimen itself
    """

    unit: str
    means: str
    low: float
    high: float
    part: str
    constant: str
    scale: float = 1.0
    inverse: bool = False

    def to_si(self, value: ArrayLike) -> Floats:
        """Return what the model takes; a modulus becomes a compliance."""
        scaled = np.asarray(value, np.float64) * self.scale
        return 1 / scaled if self.inverse else scaled

    def from_si(self, value: Real) -> Floats:
        """Return the value in the unit of the name."""
        number = np.asarray(value, np.float64)
        return (1 / number if self.inverse else number) / self.scale


PARAMETERS: dict[str, DesignParameter] = {
    "length_mm": DesignParameter("mm", "free length", 0.5, 200, "bimorph", "length", 1e-3),
    "width_mm": DesignParameter("mm", "width", 0.05, 50, "bimorph", "width", 1e-3),
    "clamped_length_mm": DesignParameter(
        "mm", "clamped length", 0, 100, "bimorph", "clamped_length", 1e-3
    ),
    "piezo_height_mm": DesignParameter(
        "mm", "height of one piezo layer", 0.01, 5, "bimorph", "piezo_height", 1e-3
    ),
    "shim_height_mm": DesignParameter(
        "mm", "height of the shim", 0, 5, "bimorph", "shim_height", 1e-3
    ),
    "shim_modulus_gpa": DesignParameter(
        "GPa", "Young's modulus of the shim", 0.1, 1000, "shim", "s11", 1e9, inverse=True
    ),
    "shim_shear_modulus_gpa": DesignParameter(
        "GPa", "shear modulus of the shim", 0.05, 500, "shim", "s55", 1e9, inverse=True
    ),
    "shim_density_kg_m3": DesignParameter(
        "kg/m³", "density of the shim", 100, 25000, "shim", "density"
    ),
    "piezo_modulus_gpa": DesignParameter(
        "GPa", "Young's modulus 1/s11E of the piezo", 1, 500, "piezo", "s11E", 1e9, inverse=True
    ),
    "piezo_density_kg_m3": DesignParameter(
        "kg/m³", "density of the piezo", 1000, 15000, "piezo", "density"
    ),
    "d31_pm_per_v": DesignParameter(
        "pm/V", "piezoelectric charge constant d31", -2000, 2000, "piezo", "d31", 1e-12
    ),
    "eps33t_relative": DesignParameter(
        "ε0", "permittivity eps33T", 10, 50000, "piezo", "eps33T", VACUUM_PERMITTIVITY
    ),
    "piezo_quality": DesignParameter(
        "1", "quality factor of the piezo", 1, 1e6, "piezo", "quality_factor"
    ),
    "shim_quality": DesignParameter(
        "1", "quality factor of the shim", 1, 1e6, "shim", "quality_factor"
    ),
    "axial_force_n": DesignParameter(
        "N", "axial tension; a pressing finger is negative", -50, 50, "", "axial_force"
    ),
    "measuring_point_mm": DesignParameter(
        "mm", "measuring point, from the clamp", 0.01, 200, "", "measuring_point", 1e-3
    ),
    "firmness": DesignParameter("1", "finger from low (0) to high (1)", -4, 5, "", "firmness"),
}
NAMED = {
    "load": "finger that loads the tip",
    "piezo": "piezoceramic",
    "shim": "material of the shim",
    "wiring": "of the two piezo layers",
}
"""Parameters that are names, and what they mean."""
WIRINGS = ("parallel", "series")
FINGERS: dict[str, FingerLoad] = {
    "low": FingerLoad.low(),
    "high": FingerLoad.high(),
    "none": FingerLoad.none(),
}
"""The paper's two fingers and the tip in air."""


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """Designs as the model takes them; arrays broadcast.

    Attributes
    ----------
    bimorph, load, axial_force : see `tactile.actuator.response.tip_response`
    measuring_point : from the clamp [m], or None for the tip
    """

    bimorph: Bimorph
    load: FingerLoad
    axial_force: Real = 0.0
    measuring_point: Real | None = None


def names_of(fingers: Mapping[str, FingerLoad]) -> dict[str, list[str]]:
    """Return which names each named parameter may take."""
    return {
        "load": list(fingers),
        "piezo": list(PIEZOS),
        "shim": list(SHIMS),
        "wiring": list(WIRINGS),
    }


def check_value(name: str, value: Any, fingers: Mapping[str, FingerLoad] = FINGERS) -> None:
    """Raise InputError where a parameter is unknown or a value is outside its limits or names."""
    named = names_of(fingers)
    if name in named:
        for entry in np.unique(np.asarray(value).astype(str)).tolist():
            if entry not in named[name]:
                raise InputError(f"{name} = {entry!r}: no such name; {nearest(entry, named[name])}")
        return
    if name not in PARAMETERS:
        raise InputError(f"no parameter {name!r}; {nearest(name, [*PARAMETERS, *named])}")
    parameter = PARAMETERS[name]
    try:
        numbers = np.asarray(value, np.float64)
    except ValueError:
        raise InputError(f"{name} = {value!r}: not a number") from None
    wrong = numbers[~((numbers >= parameter.low) & (numbers <= parameter.high))]
    if wrong.size:
        raise InputError(
            f"{name} = {wrong.flat[0]:g}: must be {parameter.low:g} … {parameter.high:g} "
            f"{parameter.unit}"
        )


def standard_value(name: str, bimorph: Bimorph) -> Floats:
    """Return a number as a bimorph has it, in its unit.

    Raises
    ------
    InputError
        For a number that a bimorph does not have.
    """
    parameter = PARAMETERS[name]
    if not parameter.part:
        raise InputError(f"{name}: belongs to no bimorph and has no standard value")
    owner = bimorph if parameter.part == "bimorph" else getattr(bimorph, parameter.part)
    return parameter.from_si(getattr(owner, parameter.constant))


def between(firmness: Real) -> FingerLoad:
    """Return the finger of a firmness; see the module's docstring."""
    low, high = FingerLoad.low(), FingerLoad.high()

    def mixed(a: Real, b: Real) -> Floats:
        return np.asarray(a * (np.asarray(b) / a) ** np.asarray(firmness))

    return FingerLoad(
        k0=mixed(low.k0, high.k0),
        d0=mixed(low.d0, high.d0),
        branches=tuple(
            (mixed(k, k2), mixed(d, d2))
            for (k, d), (k2, d2) in zip(low.branches, high.branches, strict=True)
        ),
    )


def gathered(names: NDArray[np.str_], known: Mapping[str, Any], *path: str | int) -> Floats:
    """Return a constant of the thing that each name means, as an array like ``names``."""

    def constant(thing: Any) -> float:
        for step in path:
            thing = thing[step] if isinstance(step, int) else getattr(thing, step)
        return float(thing)

    found, place = np.unique(names, return_inverse=True)
    return np.array([constant(known[str(name)]) for name in found])[place].reshape(names.shape)


def _constants(names: ArrayLike | None, known: Mapping[str, Any]) -> dict[str, Floats]:
    """Return all constants of the materials that are named, by field."""
    if names is None:
        return {}
    spelled = np.asarray(names).astype(str)
    owner = next(iter(known.values()))
    return {each.name: gathered(spelled, known, each.name) for each in fields(owner)}


def loads(names: ArrayLike, fingers: Mapping[str, FingerLoad]) -> FingerLoad:
    """Return the loads of these names as one, its constants arrays; the shorter have no branch."""
    names = np.asarray(names).astype(str)
    most = max(len(load.branches) for load in fingers.values())
    filled = {
        name: replace(load, branches=load.branches + ((0.0, 0.0),) * (most - len(load.branches)))
        for name, load in fingers.items()
    }
    return FingerLoad(
        k0=gathered(names, filled, "k0"),
        d0=gathered(names, filled, "d0"),
        branches=tuple(
            (gathered(names, filled, "branches", i, 0), gathered(names, filled, "branches", i, 1))
            for i in range(most)
        ),
    )


def _bimorph(values: Values, base: Bimorph) -> tuple[Bimorph, dict[str, Floats]]:
    """Return the benders, and what of the values is not theirs."""
    parts: dict[str, dict[str, Any]] = {
        "bimorph": {},
        "piezo": _constants(values.get("piezo"), PIEZOS),
        "shim": _constants(values.get("shim"), SHIMS),
        "": {},
    }
    if "wiring" in values:
        parts["bimorph"]["series"] = np.asarray(values["wiring"]) == "series"
    for name, value in values.items():
        if name in PARAMETERS:
            parameter = PARAMETERS[name]
            parts[parameter.part][parameter.constant] = parameter.to_si(value)
    try:
        piezo = replace(base.piezo, **parts["piezo"])
        shim = replace(base.shim, **parts["shim"])
        return replace(base, piezo=piezo, shim=shim, **parts["bimorph"]), parts[""]
    except ValueError as error:
        raise InputError(f"impossible bender: {error}") from None


def _check_buckling(bimorph: Bimorph, axial_force: Floats) -> None:
    """Raise InputError where a bender gives way under a press, as a column does by itself (Euler).

    A finger would hold its tip a little longer; a bender that relies on that is none to build.
    """
    if not np.any(axial_force < 0):
        return
    s = section(bimorph)
    column = np.pi**2 * s.EI.real / (4 * np.asarray(bimorph.length) ** 2)
    share = -axial_force / (column / (1 + column / s.AG.real))
    if np.any(share >= 1):
        least = float(np.min(np.broadcast_to(column, np.shape(share))[share >= 1]))
        raise InputError(
            f"axial_force_n = {float(np.min(axial_force)):g}: "
            f"buckles a bender that bears {least:.3g} N"
        )


def specimen(
    values: Values,
    *,
    base: Bimorph | None = None,
    fingers: Mapping[str, FingerLoad] = FINGERS,
) -> Specimen:
    """Return the designs of these values; what is not among them is the base design's, in air.

    Parameters
    ----------
    values : by name, in the names' units, arrays that broadcast to (...,) designs
    base : the default design where it is None
    fingers : what ``load`` may name

    Raises
    ------
    InputError
        Naming the parameter, value and limit; also for a measuring point beyond the tip, and for
        both a load and a firmness.
    """
    for name, value in values.items():
        check_value(name, value, fingers)
    if {"load", "firmness"} <= set(values):
        raise InputError("load and firmness: both are the finger; give one of them")
    bimorph, rest = _bimorph(values, base or Bimorph())
    point = rest.get("measuring_point")
    if point is not None and np.any(point > bimorph.length):
        raise InputError(
            f"measuring_point_mm = {float(np.max(point)) * 1e3:g}: lies beyond the tip of a bender "
            f"of length_mm = {float(np.min(bimorph.length)) * 1e3:g}"
        )
    _check_buckling(bimorph, rest.get("axial_force", np.zeros(())))
    load = (
        between(rest["firmness"])
        if "firmness" in rest
        else loads(values.get("load", "none"), fingers)
    )
    return Specimen(
        bimorph=bimorph,
        load=load,
        axial_force=rest.get("axial_force", 0.0),
        measuring_point=point,
    )
