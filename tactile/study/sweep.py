"""A sweep: every combination of some parameters, solved over frequency, as a labeled array.

A `Study` says what is asked. It is cut into blocks (`blocks`), each of which is solved by itself
(`solve_block`); `frame` is the empty data set that they fill, with coordinates, units and how it
came to be. `solve_study` does all of it in memory and in this process; `tactile.study.runs`
stores as it goes, on several processes or machines.
"""

import datetime
import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import TipResponse, tip_response
from tactile.errors import InputError
from tactile.files import nearest
from tactile.study.criteria import CRITERIA, Conditions, Solved, numbers_of, variable
from tactile.study.extras import study_extra
from tactile.study.parameters import (
    FINGERS,
    NAMED,
    PARAMETERS,
    Specimen,
    check_value,
    specimen,
    standard_value,
)
from tactile.study.scenarios import Scenarios

if TYPE_CHECKING:
    import xarray

Block = tuple[slice, ...]
"""A slice of each axis."""

PIECE_POINTS = 7 * 2**10
"""Designs × frequencies that are solved at once. Their arrays stay in a processor's cache, and
below the 128 KiB from which glibc asks the system for each, which is twice as slow."""
LARGEST = 2**31
"""Bytes of a data set that is made in memory."""
MODEL = "Hofmann & Twiefel 2014, doi 10.1515/ehs-2014-0055, corrected; exp(+jωt)"


@dataclass(frozen=True)
class ResponseVariable:
    """A response over frequency that a data set can hold: its unit, meaning and scale from SI."""

    variable: str
    unit: str
    means: str
    scale: float


RESPONSES: dict[str, ResponseVariable] = {
    "displacement": ResponseVariable("displacement_um_per_v", "µm/V", "shear of the tip", 1e6),
    "displacement_at_point": ResponseVariable(
        "displacement_at_point_um_per_v", "µm/V", "shear at the measuring point", 1e6
    ),
    "velocity": ResponseVariable("velocity_mm_per_s_v", "mm/(s V)", "velocity of the tip", 1e3),
    "force": ResponseVariable("force_mn_per_v", "mN/V", "force into the skin", 1e3),
    "admittance": ResponseVariable(
        "admittance_us", "µS", "current per volt, clamped part included", 1e6
    ),
}


@dataclass(frozen=True, kw_only=True)
class Study:
    """A question about a design.

    Attributes
    ----------
    axes : values of each parameter that is varied, in the unit of its name
    frequency : ascending (F,) [Hz]; may be empty where no criterion needs a band
    fixed : values of further parameters
    criteria : names of `CRITERIA`
    responses : names of `RESPONSES` that are kept over frequency
    scenarios : fingers and tolerances, along a last axis ``scenario``
    conditions : band and limits
    fingers : what ``load`` may name
    base : what nobody varies

    Raises
    ------
    InputError
        For an empty or unknown axis, a value out of its limits, a criterion without its band or
        without frequencies in it.
    """

    axes: Mapping[str, ArrayLike]
    frequency: ArrayLike = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)
    criteria: tuple[str, ...] = ()
    responses: tuple[str, ...] = ()
    scenarios: Scenarios | None = None
    conditions: Conditions = field(default_factory=Conditions)
    fingers: Mapping[str, FingerLoad] = field(default_factory=lambda: FINGERS)
    base: Bimorph = field(default_factory=Bimorph)

    def __post_init__(self) -> None:
        axes = {name: np.atleast_1d(np.asarray(v)) for name, v in self.axes.items()}
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "frequency", np.asarray(self.frequency, np.float64))
        check_study(self)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names of the axes, ``scenario`` last."""
        return (*self.axes, *(() if self.scenarios is None else ("scenario",)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each of them."""
        several = () if self.scenarios is None else (self.scenarios.count,)
        return (*(np.size(v) for v in self.axes.values()), *several)

    @property
    def designs(self) -> int:
        """Number of combinations."""
        return math.prod(self.shape)


def check_study(study: Study) -> None:
    """Raise InputError for what cannot be asked; see `Study`."""
    if not study.axes:
        raise InputError("a study needs an axis, as length_mm=8:30:0.5")
    for name, values in [*study.axes.items(), *study.fixed.items()]:
        if not np.size(values):
            raise InputError(f"{name}: the axis is empty; give at least one value")
        check_value(name, values, study.fingers)
    for name, values in study.axes.items():
        if np.unique(np.asarray(values)).size < np.size(values):
            raise InputError(f"{name}: the axis has a value twice")
    drawn = set() if study.scenarios is None else set(study.scenarios.values)
    for one, other in itertools.combinations((set(study.axes), set(study.fixed), drawn), 2):
        if one & other:
            raise InputError(f"{min(one & other)}: given twice; an axis, fixed or drawn, but once")
    if {"load", "firmness"} <= set(study.axes) | set(study.fixed) | drawn:
        raise InputError("load and firmness: both are the finger; give one of them")
    f = np.asarray(study.frequency)
    if f.ndim != 1 or not np.all(np.isfinite(f) & (f >= 0)) or np.any(np.diff(f) <= 0):
        raise InputError("frequency_hz: must ascend from 0 Hz or above")
    for known, names, what in (
        (CRITERIA, study.criteria, "criterion"),
        (RESPONSES, study.responses, "response"),
    ):
        for name in names:
            if name not in known:
                raise InputError(f"no {what} {name!r}; {nearest(name, list(known))}")
    if not study.criteria and not study.responses:
        raise InputError("a study needs a criterion or a response to keep")
    _check_frequencies(study)


def _check_frequencies(study: Study) -> None:
    """Raise InputError where a criterion lacks its band, or a curve its frequencies."""
    f, band = np.asarray(study.frequency), study.conditions.band
    if study.responses and not f.size:
        raise InputError(f"{study.responses[0]}: needs frequencies, as 10:1000:5 Hz")
    if "displacement_at_point" in study.responses and not (
        "measuring_point_mm" in study.axes or "measuring_point_mm" in study.fixed
    ):
        raise InputError("displacement_at_point: needs measuring_point_mm, an axis or fixed")
    for name in study.criteria:
        if not CRITERIA[name].needs_band:
            continue
        if band is None:
            raise InputError(f"{name}: needs a band, as 10:1000 Hz")
        inside = f[in_band(study)]
        if inside.size < 2:
            raise InputError(
                f"{name}: fewer than two frequencies in the band {band[0]:g}:{band[1]:g} Hz"
            )
        if not np.allclose((inside[0], inside[-1]), band, rtol=1e-6, atol=1e-9):
            raise InputError(
                f"{name}: frequencies in the band {band[0]:g}:{band[1]:g} Hz go from "
                f"{inside[0]:g} to {inside[-1]:g} Hz; add the band's ends"
            )


def in_band(study: Study) -> NDArray[np.bool_]:
    """Return which frequencies are in the band."""
    f, band = np.asarray(study.frequency), study.conditions.band
    low, high = band or (0.0, np.inf)
    return np.asarray((f >= low) & (f <= high))


def blocks(shape: tuple[int, ...], designs: int) -> Iterator[Block]:
    """Cut axes of this shape into blocks of at most so many designs, in order, the last first."""
    steps: list[int] = []
    for size in reversed(shape):
        steps.append(max(1, min(size, designs)))
        designs //= steps[-1]
    cuts = [
        [slice(at, min(at + step, size)) for at in range(0, size, step)]
        for size, step in zip(shape, reversed(steps), strict=True)
    ]
    return itertools.product(*cuts)


def solve_block(study: Study, block: Block) -> dict[str, NDArray[Any]]:
    """Solve one block, in pieces that stay in a processor's cache.

    Returns
    -------
    dict of ndarray
        By the variables' names, in their units: criteria of the block's shape, responses with a
        last axis (F,).
    """
    frequencies = max(1, np.size(study.frequency))
    shape = tuple(part.stop - part.start for part in block)
    found: dict[str, NDArray[Any]] = {}
    for piece in blocks(shape, max(1, PIECE_POINTS // frequencies)):
        whole = tuple(
            slice(b.start + p.start, b.start + p.stop) for b, p in zip(block, piece, strict=True)
        )
        for name, values in _solve_piece(study, whole).items():
            if name not in found:
                last = () if values.ndim == len(shape) else values.shape[-1:]
                found[name] = np.empty((*shape, *last), values.dtype)
            found[name][piece] = values
    return found


def _solve_piece(study: Study, piece: Block) -> dict[str, NDArray[Any]]:
    """Return what `solve_block` does of a part, its arrays perhaps of length one along an axis."""
    designs = specimen(values_of(study, piece), base=study.base, fingers=study.fingers)
    found: dict[str, NDArray[Any]] = {}
    response = response_of(designs, study.frequency)
    if response is not None:
        found.update(_kept(study, response, len(piece)))
    judged = Solved(designs, _banded(study, response), study.conditions)
    for name, value in numbers_of(study.criteria, judged).items():
        found[variable(name)] = value.reshape((1,) * (len(piece) - value.ndim) + value.shape)
    return found


def response_of(designs: Specimen, frequency: ArrayLike) -> TipResponse | None:
    """Return the response of designs (...,) at frequencies (F,) [Hz], or None without any."""
    if not np.size(frequency):
        return None
    return tip_response(
        designs.bimorph,
        designs.load,
        frequency,
        axial_force=designs.axial_force,
        measuring_point=designs.measuring_point,
    )


def values_of(study: Study, block: Block) -> dict[str, Any]:
    """Return the values of all parameters in a block, to broadcast: each axis along its own."""
    values: dict[str, Any] = dict(study.fixed)
    along = dict(zip(study.dimensions, block, strict=True))
    for place, (name, part) in enumerate(along.items()):
        shape = [1] * len(block)
        shape[place] = -1
        if name in study.axes:
            values[name] = np.asarray(study.axes[name])[part].reshape(shape)
    if study.scenarios is not None:
        part = block[-1]
        drawn = specimen(values, base=study.base, fingers=study.fingers).bimorph
        for name, array in study.scenarios.factors.items():
            values[name] = standard_value(name, drawn) * np.asarray(array)[part]
        for name, array in study.scenarios.values.items():
            values[name] = np.asarray(array)[part]
    return values


def _banded(study: Study, response: TipResponse | None) -> TipResponse | None:
    """Return the response at the frequencies in the band."""
    keep = in_band(study)
    if response is None or keep.all():
        return response
    point = response.displacement_at_point
    return TipResponse(
        response.frequency[keep],
        response.displacement[..., keep],
        response.velocity[..., keep],
        response.rotation[..., keep],
        response.force[..., keep],
        response.admittance[..., keep],
        None if point is None else point[..., keep],
    )


def _kept(study: Study, response: TipResponse, axes: int) -> dict[str, NDArray[Any]]:
    """Return the curves that are kept, in their units, with all axes."""
    found = {}
    for name in study.responses:
        curve = RESPONSES[name]
        values = np.asarray(getattr(response, name)) * curve.scale
        found[curve.variable] = values.reshape((1,) * (axes + 1 - values.ndim) + values.shape)
    return found


def frame(study: Study) -> "xarray.Dataset":
    """Return the data set without its variables: coordinates, units and how it came to be."""
    with study_extra("a study"):
        import xarray

    coordinates: dict[str, Any] = {}
    for name, values in study.axes.items():
        unit, means = _label(name)
        coordinates[name] = (name, values, {"units": unit, "long_name": means})
    if study.scenarios is not None:
        for name, values in study.scenarios.values.items():
            coordinates[name] = ("scenario", values, {"units": _label(name)[0]})
        for name, values in study.scenarios.factors.items():
            coordinates[f"{name}_factor"] = ("scenario", values, {"units": "1"})
    if np.size(study.frequency):
        labels = {"units": "Hz", "long_name": "frequency"}
        coordinates["frequency_hz"] = ("frequency_hz", study.frequency, labels)
    return xarray.Dataset(coords=coordinates, attrs=provenance(study))


def _label(name: str) -> tuple[str, str]:
    parameter = PARAMETERS.get(name)
    return ("", NAMED[name]) if parameter is None else (parameter.unit, parameter.means)


def variables(study: Study) -> dict[str, tuple[tuple[str, ...], dict[str, str], Any]]:
    """Return dimensions, attributes and type of each variable of a study."""
    found: dict[str, tuple[tuple[str, ...], dict[str, str], Any]] = {}
    for name in study.criteria:
        c = CRITERIA[name]
        labels = {"units": c.unit, "long_name": c.means, "criterion": name}
        if c.needs_band and study.conditions.band is not None:
            labels["band"] = "{:g} … {:g} Hz".format(*study.conditions.band)
        found[variable(name)] = (study.dimensions, labels, np.float64)
    for name in study.responses:
        curve = RESPONSES[name]
        labels = {"units": curve.unit, "long_name": curve.means}
        found[curve.variable] = ((*study.dimensions, "frequency_hz"), labels, np.complex128)
    return found


def provenance(study: Study) -> dict[str, str]:
    """Return how a data set came to be, as its attributes."""
    limits = asdict(study.conditions)
    conditions = {name: v for name, v in limits.items() if v is not None and v != np.inf}
    return {
        "title": f"Bimorph over {', '.join(study.axes)}",
        "source": f"tactile {version('tactile-display')}",
        "model": MODEL,
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "base": json.dumps(asdict(study.base)),
        "fixed": json.dumps(dict(study.fixed)),
        "conditions": json.dumps(conditions),
        "fingers": json.dumps({name: asdict(load) for name, load in study.fingers.items()}),
    }


def check_memory(study: Study) -> None:
    """Raise InputError where a study's data set takes more than `LARGEST` bytes."""
    need = sum(
        math.prod(study.shape) * (16 * np.size(study.frequency) if kind is np.complex128 else 8)
        for _, _, kind in variables(study).values()
    )
    if need > LARGEST:
        raise InputError(
            f"the study takes {need / 2**30:.1f} GiB, more than {LARGEST / 2**30:g} GiB of memory; "
            "store it as it goes (--out study.zarr), or keep fewer responses"
        )


def solve_study(study: Study) -> "xarray.Dataset":
    """Solve a study in memory and in this process.

    Returns
    -------
    xarray.Dataset
        One variable for each criterion and response, over the axes (and ``frequency_hz``).

    Raises
    ------
    InputError
        Where xarray is missing, or it takes more than `LARGEST` bytes.
    """
    check_memory(study)
    return labeled(study, solve_block(study, tuple(slice(0, size) for size in study.shape)))


def labeled(study: Study, solved: Mapping[str, NDArray[Any]]) -> "xarray.Dataset":
    """Return the data set of a study whose variables have been solved."""
    data = frame(study)
    for name, (dimensions, labels, _) in variables(study).items():
        data[name] = (dimensions, solved[name], labels)
    return data
