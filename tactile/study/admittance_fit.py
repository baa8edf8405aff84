"""Material constants of a bimorph from what was measured of it, electrically or at its tip.

The paper adjusts quality factors, capacitance and coupling by hand until the model lies on the
measured admittances. Here that is the start, and the least misfit of all measurements together is
what is found. Constants that the measurements cannot tell of stay as they were, and are named.
Source of the model: Hofmann & Twiefel 2014 (see `tactile.actuator`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from tactile.actuator.bimorph import Bimorph, capacitance, coupling
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import VACUUM_PERMITTIVITY
from tactile.actuator.response import tip_response
from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.files import nearest
from tactile.study.adjusted import (
    Comparison,
    Constant,
    constants_of,
    what_is_left,
    what_is_unknown,
)
from tactile.study.log_fit import LogFit, fit_logs, interval, model_slope, response_spread
from tactile.study.measurement import Measurement

CONSTANTS = {
    "piezo_quality": ("piezo", "quality_factor", 1.0),
    "shim_quality": ("shim", "quality_factor", 1.0),
    "d31_pm_per_v": ("piezo", "d31", 1e-12),
    "eps33t_relative": ("piezo", "eps33T", VACUUM_PERMITTIVITY),
    "loss_tangent": ("piezo", "loss_tangent", 1.0),
    "s11e_um2_per_n": ("piezo", "s11E", 1e-12),
}
"""Constants that can be fitted: of which material, their name there, and their unit in SI."""
ADJUSTED = tuple(name for name in CONSTANTS if name != "s11e_um2_per_n")
"""Those that the paper adjusts; s11E would shift the resonance."""
ELECTRICAL = ("eps33t_relative", "loss_tangent")
"""Those that motion says nothing of."""
REACH = 30.0
"""Factor by which a constant may leave its start."""
SEARCHED = 2.0
"""Factor by which s11E may."""
RANGES = {"loss_tangent": (1e-5, 1.0), "quality_factor": (1.0, 1e6)}
"""Where a start lies at the least and at the most, for it has a logarithm."""
TRIED = 41
"""Values of s11E that are tried for a start: resonances 1.7 % apart."""
TRIED_QUALITY = (1 / 3, 1.0, 3.0)
LARGEST_COUPLING = 0.95
"""Of k31² = d31²/(s11E eps33T), which must remain below 1 while constants are sought."""
TURNED = 120.0
"""Degrees between start and measurement above which the latter is reversed."""
SHIFTED = 0.01
"""Difference of resonance, model from measurement, that is called out."""
MODEL_BAND = (10.0, 20000.0)
"""Hz where the first resonance is looked for."""


@dataclass(frozen=True)
class BimorphFit:
    """A fitted bimorph.

    Attributes
    ----------
    bimorph : with the fitted constants
    constants : those that were fitted, named as in `CONSTANTS`
    derived : coupling_un_m_per_v, the size of K [µN m/V], and capacitance_nf of both layers with
        bending blocked, clamped segment included [nF]; the latter with an admittance only
    comparisons : with each measurement
    notes : sentences on what is not identifiable, and on a misfit that is not noise
    """

    bimorph: Bimorph
    constants: tuple[Constant, ...]
    derived: tuple[Constant, ...]
    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...]

    @property
    def told(self) -> tuple[Constant, ...]:
        """All constants, those derived last."""
        return self.constants + self.derived


@dataclass(frozen=True)
class _Task:
    """What is to be fitted to what."""

    bimorph: Bimorph
    measured: tuple[tuple[Measurement, FingerLoad], ...]
    names: tuple[str, ...]

    @property
    def start(self) -> Floats:
        return np.log([abs(_value(self.bimorph, name)) for name in self.names])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        reach = np.log([SEARCHED if name.startswith("s11e") else REACH for name in self.names])
        return self.start - reach, self.start + reach

    def with_logs(self, logs: Floats) -> Bimorph:
        """Return the bimorph, or bimorphs, of logarithms (..., p)."""
        told: dict[str, dict[str, Any]] = {"piezo": {}, "shim": {}}
        for k, name in enumerate(self.names):
            part, key, unit = CONSTANTS[name]
            told[part][key] = np.exp(logs[..., k]) * unit
        piezo = {"d31": np.abs(self.bimorph.piezo.d31)} | told["piezo"]
        stiff, electric = (piezo.get(n, getattr(self.bimorph.piezo, n)) for n in ("s11E", "eps33T"))
        size = np.minimum(piezo["d31"], np.sqrt(LARGEST_COUPLING * stiff * electric))
        piezo["d31"] = np.copysign(size, self.bimorph.piezo.d31)
        return replace(
            self.bimorph,
            piezo=replace(self.bimorph.piezo, **piezo),
            shim=replace(self.bimorph.shim, **told["shim"]),
        )

    def model(self, logs: Floats) -> Complex:
        """Return all responses, one after the other, of logarithms (N, p)."""
        return self.response(self.with_logs(logs))

    def response(self, bimorph: Bimorph) -> Complex:
        found = [
            getattr(tip_response(bimorph, load, m.frequency), m.kind) for m, load in self.measured
        ]
        return np.concatenate(found, axis=-1)

    @property
    def value(self) -> Complex:
        return np.concatenate([m.value for m, _ in self.measured])

    @property
    def groups(self) -> list[slice]:
        ends = np.cumsum([len(m.frequency) for m, _ in self.measured]).tolist()
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def _value(bimorph: Bimorph, name: str) -> float:
    """Return a constant of a bimorph in the unit of its name, within `RANGES`."""
    part, key, unit = CONSTANTS[name]
    low, high = RANGES.get(key, (-math.inf, math.inf))
    return float(np.clip(getattr(getattr(bimorph, part), key), low, high)) / unit


def fit_bimorph(
    bimorph: Bimorph,
    measured: Sequence[tuple[Measurement, FingerLoad]],
    *,
    names: Sequence[str] = ADJUSTED,
) -> BimorphFit:
    """Fit material constants of a bimorph to all that was measured of it.

    Parameters
    ----------
    bimorph : one design, the start
    measured : electrical admittance, or velocity, displacement or force of the tip, and the load
        that was on the tip then (`FingerLoad.none` in air)
    names : of the constants, of `CONSTANTS`

    Returns
    -------
    BimorphFit

    Raises
    ------
    InputError
        Without a measurement, with too few points or a reversed response, or with an unknown name
        or a start from which a constant cannot be fitted.

    Notes
    -----
    Each measurement has its own noise, found from what is left over. Intervals hold for noise that
    is independent from point to point, of a bimorph whose other constants are known.
    """
    task = _checked(bimorph, measured, names)
    fit = fit_logs(task.model, task.value, _searched(task), task.bounds, task.groups)
    signs = np.array([math.copysign(1.0, _value(bimorph, name)) for name in task.names])
    inverse = [name.endswith("quality") for name in task.names]
    constants = constants_of(fit, task.names, task.start, signs, inverse)
    comparisons = _comparisons(task, fit)
    fitted = task.with_logs(fit.logs)
    notes = [
        *_about_task(task, names),
        *what_is_unknown(fit, constants),
        *_about_bounds(task, fit),
        *(
            line
            for comparison, (_, load) in zip(comparisons, task.measured, strict=True)
            for line in (
                *_about_resonance(comparison, fitted, load, task.names),
                *what_is_left(comparison),
            )
        ),
    ]
    return BimorphFit(
        _of_numbers(fitted), constants, _derived(task, fit), comparisons, tuple(notes)
    )


def _of_numbers(bimorph: Bimorph) -> Bimorph:
    """Return a bimorph with plain numbers for arrays without an axis."""
    numbers = {
        part: {
            field.name: float(getattr(getattr(bimorph, part), field.name))
            for field in fields(getattr(bimorph, part))
        }
        for part in ("piezo", "shim")
    }
    return replace(
        bimorph,
        piezo=replace(bimorph.piezo, **numbers["piezo"]),
        shim=replace(bimorph.shim, **numbers["shim"]),
    )


def _checked(
    bimorph: Bimorph, measured: Sequence[tuple[Measurement, FingerLoad]], names: Sequence[str]
) -> _Task:
    for name in names:
        if name not in CONSTANTS:
            raise InputError(f"no constant {name!r}; {nearest(name, list(CONSTANTS))}")
    if not measured:
        raise InputError("needs an electrical admittance or a response of the tip, or both")
    electrical = any(m.kind == "admittance" for m, _ in measured)
    told = tuple(name for name in dict.fromkeys(names) if electrical or name not in ELECTRICAL)
    if not told:
        raise InputError(f"{', '.join(names)}: only an electrical admittance tells of them")
    points = sum(len(m.frequency) for m, _ in measured)
    if points <= len(told):
        files = ", ".join(m.name for m, _ in measured)
        raise InputError(
            f"{files}: {points} points for {len(told)} constants; needs more than {len(told)}"
        )
    return _Task(bimorph, tuple(measured), told)


def _searched(task: _Task) -> Floats:
    """Return the best of some starts, s11E and the quality factors scaled.

    Raises
    ------
    InputError
        Where a response of the tip is reversed against it.
    """
    stiff = np.array([float(name.startswith("s11e")) for name in task.names])
    lossy = np.array([float(name.endswith("quality")) for name in task.names])
    span = math.log(SEARCHED) * 0.99
    shifts = np.linspace(-span, span, TRIED) if stiff.any() else np.zeros(1)
    losses = np.log(TRIED_QUALITY) if lossy.any() else np.zeros(1)
    starts = task.start + np.array([a * stiff + b * lossy for a in shifts for b in losses])
    ratio = np.log(task.model(starts) / task.value)
    size = np.array([np.mean(np.abs(ratio[:, group]) ** 2, axis=1) for group in task.groups])
    best = int(size.sum(axis=0).argmin())
    for (m, _), group in zip(task.measured, task.groups, strict=True):
        if np.degrees(np.median(np.abs(ratio[best, group].imag))) > TURNED:
            raise InputError(
                f"{m.name}: is reversed against the bimorph, or all beyond another resonance; "
                "swap the polarity, or add 180 to phase_deg"
            )
    return np.asarray(starts[best])


def _comparisons(task: _Task, fit: LogFit) -> tuple[Comparison, ...]:
    started = task.response(task.bimorph)
    size, turn = response_spread(task.model, fit)
    return tuple(
        Comparison(m, fit.predicted[group], started[group], size[group], turn[group])
        for (m, _), group in zip(task.measured, task.groups, strict=True)
    )


def _activity(m: Measurement, value: Complex) -> Floats:
    """Return what peaks at a resonance: speed, or conductance over frequency."""
    if m.kind == "admittance":
        return np.asarray(value.real / m.frequency)
    return np.abs(value) * (1.0 if m.kind == "velocity" else m.frequency)


def _derived(task: _Task, fit: LogFit) -> tuple[Constant, ...]:
    """Return coupling and capacitance, with the intervals that those of the constants make."""

    def both(logs: Floats) -> Floats:
        bimorph = task.with_logs(logs)
        whole = np.asarray(bimorph.length) + bimorph.clamped_length
        sizes = coupling(bimorph), capacitance(bimorph, whole)
        shape = np.broadcast_shapes(*(np.shape(size) for size in sizes))
        return np.log([np.broadcast_to(np.abs(size), shape) for size in sizes]).T

    def model(logs: Floats) -> Complex:
        return both(logs).astype(np.complex128)

    slope = model_slope(model, fit.logs).real
    half = fit.half_width * np.sqrt(np.einsum("pf,pq,qf->f", slope, fit.covariance, slope))
    before, after = both(task.start[None])[0], both(fit.logs[None])[0]
    found = []
    told = {"coupling_un_m_per_v": 1e6, "capacitance_nf": 1e9}
    electrical = any(m.kind == "admittance" for m, _ in task.measured)
    for k, (name, scale) in enumerate(told.items() if electrical else [*told.items()][:1]):
        ends = interval(float(after[k]), float(half[k]))
        values = (math.exp(before[k]), math.exp(after[k]), *ends)
        found.append(Constant(name, *(value * scale for value in values)))
    return tuple(found)


def _about_task(task: _Task, names: Sequence[str]) -> list[str]:
    """Return sentences about what was not fitted."""
    left = [name for name in names if name not in task.names]
    if not left:
        return []
    return [f"{' and '.join(left)} stay as they were: motion does not tell of them, only current"]


def _about_bounds(task: _Task, fit: LogFit) -> list[str]:
    """Return sentences about constants that went as far as they may."""
    low, high = task.bounds
    at_end = np.minimum(fit.logs - low, high - fit.logs) < 1e-3
    return [
        f"{task.names[k]} went as far as it may, {math.exp(fit.logs[k] - task.start[k]):.2g} times "
        "its start: another constant is off, or the start is"
        for k in np.flatnonzero(at_end)
    ]


def _about_resonance(
    comparison: Comparison, fitted: Bimorph, load: FingerLoad, names: Sequence[str]
) -> list[str]:
    """Return sentences about a resonance that is not in the band, or not where the model's is."""
    m = comparison.measurement
    low, high = float(m.frequency[0]), float(m.frequency[-1])
    frequency = np.geomspace(*MODEL_BAND, 4000)
    speed = np.abs(tip_response(fitted, load, frequency).velocity)
    peaks = np.flatnonzero((speed[1:-1] > speed[:-2]) & (speed[1:-1] > speed[2:])) + 1
    if not len(peaks):
        return []
    first = float(frequency[peaks[0]])
    if not low < first < high:
        return [
            f"{m.name}: has no resonance: the first is at {first:.0f} Hz, outside the measured "
            f"{low:g} … {high:g} Hz; of losses it tells little"
        ]
    at = [int(_activity(m, v).argmax()) for v in (m.value, comparison.predicted)]
    measured, model = m.frequency[at].tolist()
    inside = 0 < at[0] < len(m.frequency) - 1
    if inside and "s11e_um2_per_n" not in names and abs(model / measured - 1) > SHIFTED:
        return [
            f"{m.name}: peaks at {measured:.4g} Hz, the model at {model:.4g} Hz: its stiffness or "
            "length is off, and the quality factors with it; fit s11e_um2_per_n as well"
        ]
    return []
