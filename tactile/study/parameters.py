"""Parameters of a design, by name and unit, and the designs that their values describe.

A parameter's name ends in its unit (``length_mm``), as in a display's file. Numbers have limits
within which a bender can be made or the model holds (assumed, wide). Names (``load``, ``piezo``,
``shim``, ``wiring``) refer to the libraries of materials and fingers. Values may be arrays that
broadcast, with one element for each design.

``firmness`` describes a finger between and around the paper's two: each constant c of the load is
c_low^(1 − φ) c_high^φ, so that φ = 0 is the low finger and φ = 1 the high one. A normal
distribution of φ makes every constant log-normal (assumed; two fingers are all that is published).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
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
    """A numeric parameter of a design.

    Attributes
    ----------
    unit : str
        Unit, for labels.
    means : str
        Meaning, for labels.
    low : float
        Lowest value, in the unit of the name.
    high : float
        Highest value, in the unit of the name.
    part : str
        Object that the parameter belongs to: "bimorph", "piezo", "shim", or "" for the specimen
        itself.
    constant : str
        Name of the constant in that object.
    scale : float
        Size of the unit in SI.
    inverse : bool
        Whether the constant is the inverse of the parameter, as compliance is of a modulus.
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
        """Convert a value to what the model takes; a modulus becomes a compliance.

        Parameters
        ----------
        value : array_like
            Value in the unit of the name.

        Returns
        -------
        ndarray of float
            Value of the constant [SI].
        """
        scaled = np.asarray(value, np.float64) * self.scale
        return 1 / scaled if self.inverse else scaled

    def from_si(self, value: Real) -> Floats:
        """Convert a constant of the model to the unit of the name.

        Parameters
        ----------
        value : float or ndarray of float
            Value of the constant [SI].

        Returns
        -------
        ndarray of float
            Value in the unit of the name.
        """
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
"""Numeric parameters by name."""
NAMED = {
    "load": "finger that loads the tip",
    "piezo": "piezoceramic",
    "shim": "material of the shim",
    "wiring": "of the two piezo layers",
}
"""Meanings of the parameters whose values are names."""
WIRINGS = ("parallel", "series")
"""Wirings of the two piezo layers."""
FINGERS: dict[str, FingerLoad] = {
    "low": FingerLoad.low(),
    "high": FingerLoad.high(),
    "none": FingerLoad.none(),
}
"""The paper's two fingers, and the tip in air."""


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """Designs as the model takes them; their arrays broadcast.

    Attributes
    ----------
    bimorph : Bimorph
        Benders.
    load : FingerLoad
        Loads of the tip.
    axial_force : float or ndarray of float
        Axial tension [N]; see `tactile.actuator.response.tip_response`.
    measuring_point : float or ndarray of float or None
        Distance of the measuring point from the clamp [m], or None for the tip.
    """

    bimorph: Bimorph
    load: FingerLoad
    axial_force: Real = 0.0
    measuring_point: Real | None = None


def names_of(fingers: Mapping[str, FingerLoad]) -> dict[str, list[str]]:
    """Return the names that each named parameter may take.

    Parameters
    ----------
    fingers : mapping of str to FingerLoad
        Finger loads by name.

    Returns
    -------
    dict of str to list of str
        Permitted names by parameter.
    """
    return {
        "load": list(fingers),
        "piezo": list(PIEZOS),
        "shim": list(SHIMS),
        "wiring": list(WIRINGS),
    }


def check_value(name: str, value: Any, fingers: Mapping[str, FingerLoad] = FINGERS) -> None:
    """Check that a parameter is known and its value within its limits or among its names.

    Parameters
    ----------
    name : str
        Name of the parameter.
    value : array_like
        Value or values, in the unit of the name.
    fingers : mapping of str to FingerLoad
        Finger loads that ``load`` may name.

    Raises
    ------
    InputError
        If the parameter is unknown, or a value is not a number, out of limits or no known name.
    """
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
    """Return the value of a parameter that a bimorph has.

    Parameters
    ----------
    name : str
        Name of a numeric parameter.
    bimorph : Bimorph
        Bender, or benders, to read it from.

    Returns
    -------
    ndarray of float
        Value in the unit of the name.

    Raises
    ------
    InputError
        If the parameter is not one of a bimorph.
    """
    parameter = PARAMETERS[name]
    if not parameter.part:
        raise InputError(f"{name}: is not a parameter of the bimorph; give its value")
    owner = bimorph if parameter.part == "bimorph" else getattr(bimorph, parameter.part)
    return parameter.from_si(getattr(owner, parameter.constant))


def load_of_firmness(firmness: Real) -> FingerLoad:
    """Return the finger load of a given firmness; see the module's docstring.

    Parameters
    ----------
    firmness : float or ndarray of float
        Firmness φ: 0 for the low finger, 1 for the high one.

    Returns
    -------
    FingerLoad
        Load whose constants have the shape of ``firmness``.
    """
    low, high = FingerLoad.low(), FingerLoad.high()

    def interpolated(a: Real, b: Real) -> Floats:
        return np.asarray(a * (np.asarray(b) / a) ** np.asarray(firmness))

    return FingerLoad(
        k0=interpolated(low.k0, high.k0),
        d0=interpolated(low.d0, high.d0),
        branches=tuple(
            (interpolated(k, k2), interpolated(d, d2))
            for (k, d), (k2, d2) in zip(low.branches, high.branches, strict=True)
        ),
    )


def constant_of(names: NDArray[np.str_], known: Mapping[str, Any], *path: str | int) -> Floats:
    """Return a constant of the object that each name refers to.

    Parameters
    ----------
    names : ndarray of str
        Names of objects.
    known : mapping of str to object
        Objects by name.
    *path : str or int
        Attributes and indices that lead from an object to its constant.

    Returns
    -------
    ndarray of float
        Constants, in the shape of ``names``.
    """

    def constant(thing: Any) -> float:
        for step in path:
            thing = thing[step] if isinstance(step, int) else getattr(thing, step)
        return float(thing)

    unique, place = np.unique(names, return_inverse=True)
    return np.array([constant(known[str(name)]) for name in unique])[place].reshape(names.shape)


def _constants(names: ArrayLike | None, known: Mapping[str, Any]) -> dict[str, Floats]:
    """Return all constants of the named materials, by field."""
    if names is None:
        return {}
    material_names = np.asarray(names).astype(str)
    owner = next(iter(known.values()))
    return {each.name: constant_of(material_names, known, each.name) for each in fields(owner)}


def loads(names: ArrayLike, fingers: Mapping[str, FingerLoad]) -> FingerLoad:
    """Return the named loads as one whose constants are arrays.

    Loads with fewer branches are filled up with branches of zero stiffness and damping.

    Parameters
    ----------
    names : array_like of str
        Names of finger loads.
    fingers : mapping of str to FingerLoad
        Finger loads by name.

    Returns
    -------
    FingerLoad
        Loads with constants in the shape of ``names``.
    """
    names = np.asarray(names).astype(str)
    most = max(len(load.branches) for load in fingers.values())
    filled = {
        name: replace(load, branches=load.branches + ((0.0, 0.0),) * (most - len(load.branches)))
        for name, load in fingers.items()
    }
    constant = partial(constant_of, names, filled)
    return FingerLoad(
        k0=constant("k0"),
        d0=constant("d0"),
        branches=tuple(
            (constant("branches", i, 0), constant("branches", i, 1)) for i in range(most)
        ),
    )


def _bimorph(values: Values, base: Bimorph) -> tuple[Bimorph, dict[str, Floats]]:
    """Return the benders, and those values that do not belong to a bender."""
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
    """Raise InputError if an axial load would buckle a bender as a free column (Euler).

    A finger would support the tip slightly longer, but a bender that relies on it should not be
    built.
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
    """Return the designs that values describe.

    Parameters
    ----------
    values : mapping of str to array_like
        Values by parameter, in the unit of its name: arrays that broadcast to (...,) designs. What
        is missing is taken from the base design, and the tip is in air.
    base : Bimorph, optional
        Base design; the default bimorph if None.
    fingers : mapping of str to FingerLoad
        Finger loads that ``load`` may name.

    Returns
    -------
    Specimen
        Designs whose arrays broadcast.

    Raises
    ------
    InputError
        If a value is out of limits (the message names parameter, value and limit), a measuring
        point is beyond the tip, both a load and a firmness are given, or a bender is impossible or
        would buckle.
    """
    for name, value in values.items():
        check_value(name, value, fingers)
    if {"load", "firmness"} <= set(values):
        raise InputError("load and firmness: both are the finger; give one of them")
    bimorph, remaining = _bimorph(values, base or Bimorph())
    point = remaining.get("measuring_point")
    if point is not None and np.any(point > bimorph.length):
        raise InputError(
            f"measuring_point_mm = {float(np.max(point)) * 1e3:g}: lies beyond the tip of a bender "
            f"of length_mm = {float(np.min(bimorph.length)) * 1e3:g}"
        )
    _check_buckling(bimorph, remaining.get("axial_force", np.zeros(())))
    load = (
        load_of_firmness(remaining["firmness"])
        if "firmness" in remaining
        else loads(values.get("load", "none"), fingers)
    )
    return Specimen(
        bimorph=bimorph,
        load=load,
        axial_force=remaining.get("axial_force", 0.0),
        measuring_point=point,
    )
