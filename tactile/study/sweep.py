"""Sweeps: every combination of some parameters, solved over frequency, as a labeled array.

A `Study` defines the sweep. It is cut into blocks (`blocks`), each of which is solved by itself
(`solve_block`). `frame` is the empty data set that they fill, with coordinates, units and
provenance. `solve_study` does all of this in memory and in the calling process;
`tactile.study.runs` stores results as it goes, with several processes or machines.
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
"""Slice of each axis."""

PIECE_POINTS = 7 * 2**10
"""Designs × frequencies that are solved at once.

Their arrays stay in a processor's cache, and below the 128 KiB from which glibc requests each from
the operating system, which is twice as slow.
"""
LARGEST = 2**31
"""Largest size of a data set that is made in memory [bytes]."""
MODEL = "Hofmann & Twiefel 2014, doi 10.1515/ehs-2014-0055, corrected; exp(+jωt)"
"""Description of the model in the attributes of a data set."""


@dataclass(frozen=True)
class ResponseVariable:
    """A response over frequency that a data set can hold.

    Attributes
    ----------
    variable : str
        Name of the variable.
    unit : str
        Unit, for labels.
    means : str
        Meaning, for labels.
    scale : float
        Factor from SI to the unit.
    """

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
"""Responses that a study can keep, by name."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """A sweep over parameters of a design.

    Attributes
    ----------
    axes : mapping of str to array_like
        Values of each parameter that is varied, in the unit of its name.
    frequency : (F,) array of float
        Ascending frequencies [Hz]; may be empty if no criterion needs a band.
    fixed : mapping of str to object
        Values of further parameters.
    criteria : tuple of str
        Names of `CRITERIA` to compute.
    responses : tuple of str
        Names of `RESPONSES` to keep over frequency.
    scenarios : Scenarios or None
        Fingers and tolerances, along a last axis ``scenario``.
    conditions : Conditions
        Band and limits.
    fingers : mapping of str to FingerLoad
        Finger loads that ``load`` may name.
    base : Bimorph
        Design that supplies everything that is neither varied nor fixed.

    Raises
    ------
    InputError
        If an axis is empty or unknown, a value is out of its limits, or a criterion lacks its band
        or frequencies within it.
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
        """Names of the axes, with ``scenario`` last."""
        return (*self.axes, *(() if self.scenarios is None else ("scenario",)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        several = () if self.scenarios is None else (self.scenarios.count,)
        return (*(np.size(v) for v in self.axes.values()), *several)

    @property
    def designs(self) -> int:
        """Number of combinations, including scenarios."""
        return math.prod(self.shape)


def check_study(study: Study) -> None:
    """Check that a study is possible; see `Study`.

    Parameters
    ----------
    study : Study
        Study to check.

    Raises
    ------
    InputError
        If an axis, value, frequency, criterion or response is not possible.
    """
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
    for first, second in itertools.combinations((set(study.axes), set(study.fixed), drawn), 2):
        if first & second:
            raise InputError(
                f"{min(first & second)}: given twice; a parameter is an axis, fixed, or drawn"
            )
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
    """Raise InputError if a criterion lacks its band, or a response its frequencies."""
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
    """Return which frequencies are in the band.

    Parameters
    ----------
    study : Study
        Study with frequencies and a band.

    Returns
    -------
    (F,) array of bool
        Whether each frequency is in the band; all are if there is no band.
    """
    f, band = np.asarray(study.frequency), study.conditions.band
    low, high = band or (0.0, np.inf)
    return np.asarray((f >= low) & (f <= high))


def blocks(shape: tuple[int, ...], designs: int) -> Iterator[Block]:
    """Cut axes into blocks, the last axis varying fastest.

    Parameters
    ----------
    shape : tuple of int
        Length of each axis.
    designs : int
        Largest number of designs of a block, at least 1.

    Returns
    -------
    iterator of Block
        Blocks in order.
    """
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

    Parameters
    ----------
    study : Study
        Study that the block belongs to.
    block : Block
        Slice of each axis.

    Returns
    -------
    dict of str to ndarray
        Values by variable, in its unit: criteria in the block's shape, responses with a last axis
        (F,).
    """
    frequencies = max(1, np.size(study.frequency))
    shape = tuple(part.stop - part.start for part in block)
    results: dict[str, NDArray[Any]] = {}
    for piece in blocks(shape, max(1, PIECE_POINTS // frequencies)):
        whole = tuple(
            slice(b.start + p.start, b.start + p.stop) for b, p in zip(block, piece, strict=True)
        )
        for name, values in _solve_piece(study, whole).items():
            if name not in results:
                last = () if values.ndim == len(shape) else values.shape[-1:]
                results[name] = np.empty((*shape, *last), values.dtype)
            results[name][piece] = values
    return results


def _solve_piece(study: Study, piece: Block) -> dict[str, NDArray[Any]]:
    """Solve a piece of a block; see `solve_block`. Its arrays may have length one along an axis."""
    designs = specimen(values_of(study, piece), base=study.base, fingers=study.fingers)
    results: dict[str, NDArray[Any]] = {}
    response = response_of(designs, study.frequency)
    if response is not None:
        results.update(_kept_responses(study, response, len(piece)))
    judged = Solved(designs, _response_in_band(study, response), study.conditions)
    for name, value in numbers_of(study.criteria, judged).items():
        results[variable(name)] = value.reshape((1,) * (len(piece) - value.ndim) + value.shape)
    return results


def response_of(designs: Specimen, frequency: ArrayLike) -> TipResponse | None:
    """Compute the response of designs.

    Parameters
    ----------
    designs : Specimen
        Designs (...,).
    frequency : (F,) array_like of float
        Frequencies [Hz].

    Returns
    -------
    TipResponse or None
        Response (..., F), or None without frequencies.
    """
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
    """Return the values of all parameters in a block.

    Parameters
    ----------
    study : Study
        Study that the block belongs to.
    block : Block
        Slice of each axis.

    Returns
    -------
    dict of str to object
        Values by parameter, in the unit of its name. They broadcast: each axis has its own
        dimension.
    """
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


def _response_in_band(study: Study, response: TipResponse | None) -> TipResponse | None:
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


def _kept_responses(study: Study, response: TipResponse, axes: int) -> dict[str, NDArray[Any]]:
    """Return the responses to keep, in their units and with all axes."""
    arrays = {}
    for name in study.responses:
        curve = RESPONSES[name]
        values = np.asarray(getattr(response, name)) * curve.scale
        arrays[curve.variable] = values.reshape((1,) * (axes + 1 - values.ndim) + values.shape)
    return arrays


def frame(study: Study) -> "xarray.Dataset":
    """Return the data set of a study without its variables.

    Parameters
    ----------
    study : Study
        Study to be solved.

    Returns
    -------
    xarray.Dataset
        Data set with coordinates, units and provenance.

    Raises
    ------
    InputError
        If xarray is missing.
    """
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
    """Return unit and meaning of a parameter."""
    parameter = PARAMETERS.get(name)
    return ("", NAMED[name]) if parameter is None else (parameter.unit, parameter.means)


def variables(study: Study) -> dict[str, tuple[tuple[str, ...], dict[str, str], Any]]:
    """Return the dimensions, attributes and type of each variable of a study.

    Parameters
    ----------
    study : Study
        Study to be solved.

    Returns
    -------
    dict of str to tuple
        Names of the dimensions, attributes, and element type, by variable.
    """
    layout: dict[str, tuple[tuple[str, ...], dict[str, str], Any]] = {}
    for name in study.criteria:
        c = CRITERIA[name]
        labels = {"units": c.unit, "long_name": c.means, "criterion": name}
        if c.needs_band and study.conditions.band is not None:
            labels["band"] = "{:g} … {:g} Hz".format(*study.conditions.band)
        layout[variable(name)] = (study.dimensions, labels, np.float64)
    for name in study.responses:
        curve = RESPONSES[name]
        labels = {"units": curve.unit, "long_name": curve.means}
        layout[curve.variable] = ((*study.dimensions, "frequency_hz"), labels, np.complex128)
    return layout


def provenance(study: Study) -> dict[str, str]:
    """Return the provenance of a data set, as its attributes.

    Parameters
    ----------
    study : Study
        Study to be solved.

    Returns
    -------
    dict of str to str
        Title, versions of tactile and of the model, time, and the values of everything not varied.
    """
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
    """Check that the data set of a study takes no more than `LARGEST` bytes.

    Parameters
    ----------
    study : Study
        Study to be solved.

    Raises
    ------
    InputError
        If the data set takes more.
    """
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

    Parameters
    ----------
    study : Study
        Study to be solved.

    Returns
    -------
    xarray.Dataset
        One variable for each criterion and response, over the axes (and ``frequency_hz``).

    Raises
    ------
    InputError
        If xarray is missing, or the data set takes more than `LARGEST` bytes.
    """
    check_memory(study)
    return labeled(study, solve_block(study, tuple(slice(0, size) for size in study.shape)))


def labeled(study: Study, solved: Mapping[str, NDArray[Any]]) -> "xarray.Dataset":
    """Return the data set of a study whose variables have been solved.

    Parameters
    ----------
    study : Study
        Solved study.
    solved : mapping of str to ndarray
        Values by variable, in its unit.

    Returns
    -------
    xarray.Dataset
        Data set with coordinates, labels and provenance.

    Raises
    ------
    InputError
        If xarray is missing.
    """
    data = frame(study)
    for name, (dimensions, labels, _) in variables(study).items():
        data[name] = (dimensions, solved[name], labels)
    return data
