"""Fit of a bimorph's material constants to electrical and mechanical measurements.

The paper adjusts quality factors, capacitance and coupling by hand until the model meets the
measured admittances. Here a search provides the start, and the misfit of all measurements together
is minimized. Constants that the measurements say nothing about stay as they were, and are named in
a note. Source of the model: Hofmann & Twiefel 2014 (see `tactile.actuator`).
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
    identifiability_notes,
    misfit_notes,
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
"""Constants that can be fitted: their material, their name there, and their unit in SI."""
ADJUSTED = tuple(name for name in CONSTANTS if name != "s11e_um2_per_n")
"""Constants that the paper adjusts; s11E is not one, as it would shift the resonance."""
ELECTRICAL = ("eps33t_relative", "loss_tangent")
"""Constants that motion says nothing about."""
REACH = 30.0
"""Factor by which a constant may leave its start."""
SEARCHED = 2.0
"""Factor by which s11E may leave its start."""
RANGES = {"loss_tangent": (1e-5, 1.0), "quality_factor": (1.0, 1e6)}
"""Lowest and highest start of constants, which need to have a logarithm."""
TRIED = 41
"""Number of starts of s11E that are tried: their resonances are 1.7 % apart."""
TRIED_QUALITY = (1 / 3, 1.0, 3.0)
"""Factors on the quality factors that are tried as starts."""
LARGEST_COUPLING = 0.95
"""Largest k31² = d31²/(s11E eps33T) during the fit, as it must remain below 1."""
TURNED = 120.0
"""Phase between start and measurement above which the measurement counts as reversed [°]."""
SHIFTED = 0.01
"""Relative difference of the model's resonance from the measured one that gives a note."""
MODEL_BAND = (10.0, 20000.0)
"""Band in which the first resonance is sought [Hz]."""


@dataclass(frozen=True)
class BimorphFit:
    """A fitted bimorph.

    Attributes
    ----------
    bimorph : Bimorph
        Design with the fitted constants.
    constants : tuple of Constant
        Fitted constants, named as in `CONSTANTS`.
    derived : tuple of Constant
        coupling_un_m_per_v, the magnitude of K [µN m/V], and capacitance_nf of both layers with
        bending blocked, clamped segment included [nF]; the latter only with a measured admittance.
    comparisons : tuple of Comparison
        Comparison with each measurement.
    notes : tuple of str
        Sentences on constants that are not identifiable, and on a misfit that is not noise.
    """

    bimorph: Bimorph
    constants: tuple[Constant, ...]
    derived: tuple[Constant, ...]
    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...]

    @property
    def reported(self) -> tuple[Constant, ...]:
        """Constants to report: those that were fitted, then those derived from them."""
        return self.constants + self.derived


@dataclass(frozen=True)
class _Task:
    """A fit: the bimorph at the start, the measurements with their loads, and what to fit."""

    bimorph: Bimorph
    measured: tuple[tuple[Measurement, FingerLoad], ...]
    names: tuple[str, ...]

    @property
    def start(self) -> Floats:
        """Logarithms (p,) of the constants at the start."""
        return np.log([abs(_value(self.bimorph, name)) for name in self.names])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest logarithms (p,)."""
        reach = np.log([SEARCHED if name.startswith("s11e") else REACH for name in self.names])
        return self.start - reach, self.start + reach

    def with_logs(self, logs: Floats) -> Bimorph:
        """Return the bimorph, or bimorphs, for logarithms of constants (..., p)."""
        values: dict[str, dict[str, Any]] = {"piezo": {}, "shim": {}}
        for k, name in enumerate(self.names):
            part, key, unit = CONSTANTS[name]
            values[part][key] = np.exp(logs[..., k]) * unit
        piezo = {"d31": np.abs(self.bimorph.piezo.d31)} | values["piezo"]
        stiff, electric = (piezo.get(n, getattr(self.bimorph.piezo, n)) for n in ("s11E", "eps33T"))
        size = np.minimum(piezo["d31"], np.sqrt(LARGEST_COUPLING * stiff * electric))
        piezo["d31"] = np.copysign(size, self.bimorph.piezo.d31)
        return replace(
            self.bimorph,
            piezo=replace(self.bimorph.piezo, **piezo),
            shim=replace(self.bimorph.shim, **values["shim"]),
        )

    def model(self, logs: Floats) -> Complex:
        """Return all responses, one after the other, for logarithms of constants (N, p)."""
        return self.response(self.with_logs(logs))

    def response(self, bimorph: Bimorph) -> Complex:
        """Return all responses of a bimorph, one after the other."""
        responses = [
            getattr(tip_response(bimorph, load, m.frequency), m.kind) for m, load in self.measured
        ]
        return np.concatenate(responses, axis=-1)

    @property
    def value(self) -> Complex:
        """All measured responses, one after the other."""
        return np.concatenate([m.value for m, _ in self.measured])

    @property
    def groups(self) -> list[slice]:
        """Slices of the measurements within all points."""
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
    """Fit material constants of a bimorph to all its measurements.

    Parameters
    ----------
    bimorph : Bimorph
        One design, at which the fit starts.
    measured : sequence of (Measurement, FingerLoad)
        Electrical admittance, or velocity, displacement or force of the tip, each with the load on
        the tip (`FingerLoad.none` in air).
    names : sequence of str
        Names of `CONSTANTS` to fit.

    Returns
    -------
    BimorphFit
        Fitted design with intervals, comparisons and notes.

    Raises
    ------
    InputError
        If there is no measurement, there are too few points, a response is reversed, a name is
        unknown, or no constant can be fitted.

    Notes ----- Each measurement has its own noise, which is estimated from the residuals. The
    intervals hold for noise that is independent from point to point, and for a bimorph whose other
    constants are known.
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
        *identifiability_notes(fit, constants),
        *_about_bounds(task, fit),
        *(
            line
            for comparison, (_, load) in zip(comparisons, task.measured, strict=True)
            for line in (
                *_about_resonance(comparison, fitted, load, task.names),
                *misfit_notes(comparison),
            )
        ),
    ]
    return BimorphFit(
        _of_numbers(fitted), constants, _derived(task, fit), comparisons, tuple(notes)
    )


def _of_numbers(bimorph: Bimorph) -> Bimorph:
    """Return a bimorph with plain numbers instead of arrays without an axis."""
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
    """Return the fit of those constants that the measurements determine, or raise InputError."""
    for name in names:
        if name not in CONSTANTS:
            raise InputError(f"no constant {name!r}; {nearest(name, list(CONSTANTS))}")
    if not measured:
        raise InputError("needs an electrical admittance or a response of the tip, or both")
    electrical = any(m.kind == "admittance" for m, _ in measured)
    fitted = tuple(name for name in dict.fromkeys(names) if electrical or name not in ELECTRICAL)
    if not fitted:
        raise InputError(f"{', '.join(names)}: only an electrical admittance determines them")
    points = sum(len(m.frequency) for m, _ in measured)
    if points <= len(fitted):
        files = ", ".join(m.name for m, _ in measured)
        raise InputError(
            f"{files}: {points} points for {len(fitted)} constants; needs more than {len(fitted)}"
        )
    return _Task(bimorph, tuple(measured), fitted)


def _searched(task: _Task) -> Floats:
    """Return the best of some starts, which differ in s11E and the quality factors.

    Raises
    ------
    InputError
        If a measured response is reversed against the best start.
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
                f"{m.name}: is reversed against the bimorph, or lies beyond another resonance; "
                "swap the polarity, or add 180 to phase_deg"
            )
    return np.asarray(starts[best])


def _comparisons(task: _Task, fit: LogFit) -> tuple[Comparison, ...]:
    """Return the comparison of each measurement with the fit."""
    started = task.response(task.bimorph)
    size, turn = response_spread(task.model, fit)
    return tuple(
        Comparison(m, fit.predicted[group], started[group], size[group], turn[group])
        for (m, _), group in zip(task.measured, task.groups, strict=True)
    )


def _activity(m: Measurement, value: Complex) -> Floats:
    """Return a quantity that peaks at a resonance: speed, or conductance over frequency."""
    if m.kind == "admittance":
        return np.asarray(value.real / m.frequency)
    return np.abs(value) * (1.0 if m.kind == "velocity" else m.frequency)


def _derived(task: _Task, fit: LogFit) -> tuple[Constant, ...]:
    """Return coupling and capacitance, with intervals propagated from those of the constants."""

    def log_sizes(logs: Floats) -> Floats:
        bimorph = task.with_logs(logs)
        whole = np.asarray(bimorph.length) + bimorph.clamped_length
        sizes = coupling(bimorph), capacitance(bimorph, whole)
        shape = np.broadcast_shapes(*(np.shape(size) for size in sizes))
        return np.log([np.broadcast_to(np.abs(size), shape) for size in sizes]).T

    def model(logs: Floats) -> Complex:
        return log_sizes(logs).astype(np.complex128)

    slope = model_slope(model, fit.logs).real
    half = fit.half_width * np.sqrt(np.einsum("pf,pq,qf->f", slope, fit.covariance, slope))
    before, after = log_sizes(task.start[None])[0], log_sizes(fit.logs[None])[0]
    results = []
    units = {"coupling_un_m_per_v": 1e6, "capacitance_nf": 1e9}
    electrical = any(m.kind == "admittance" for m, _ in task.measured)
    for k, (name, scale) in enumerate(units.items() if electrical else [*units.items()][:1]):
        ends = interval(float(after[k]), float(half[k]))
        values = (math.exp(before[k]), math.exp(after[k]), *ends)
        results.append(Constant(name, *(value * scale for value in values)))
    return tuple(results)


def _about_task(task: _Task, names: Sequence[str]) -> list[str]:
    """Return notes on constants that were not fitted."""
    omitted = [name for name in names if name not in task.names]
    if not omitted:
        return []
    return [
        f"{' and '.join(omitted)} stay as they were: motion does not tell of them, only current"
    ]


def _about_bounds(task: _Task, fit: LogFit) -> list[str]:
    """Return notes on constants that reached a bound."""
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
    """Return notes on a resonance outside the band, or away from that of the model."""
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
