"""Fit of a finger load to a measured response: a generalized Maxwell load on a known bimorph.

A tip that is held by the dynamic stiffness k moves by y = F/(S + k) per volt, with the blocked
force F and the stiffness S of the bimorph's tip. Each measured point therefore gives k(ω) in closed
form, F/y − S, and how noise in y propagates to it. For given corner frequencies of the branches,
k(ω) is linear in k0, d0 and every k_i, none of which is negative. A search over a grid of corner
frequencies finds the start from which the full nonlinear fit (`log_fit`) then runs.
"""

import math
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from scipy.optimize import nnls

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import Real
from tactile.actuator.response import blocked_force
from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.study.adjusted import (
    Comparison,
    Constant,
    constants_of,
    identifiability_notes,
    misfit_notes,
)
from tactile.study.log_fit import LogFit, Model, fit_logs, response_spread
from tactile.study.measurement import Kind, Measurement

KINDS: tuple[Kind, ...] = ("displacement", "velocity", "force")
"""Kinds of measurement to which a load can be fitted."""
MOST_BRANCHES = 3
"""Largest number of Maxwell branches."""
CORNERS = 16
"""Number of time constants of the grid: 1.5 apart for two decades, with a margin on either side."""
BEYOND = 3.0
"""Factor by which the grid of corner frequencies exceeds the measured band."""
REACH = (1e-6, 1e3)
"""Bounds of a constant, relative to the value that alone would make the largest measured
stiffness."""
LARGEST = (1e6, 1e3)
"""Largest stiffness [N/m] and damping [N s/m] that a display file accepts."""
ALIKE = 1.5
"""Ratio of corner frequencies below which two branches are reported as one."""
REVERSED = 0.3
"""Ratio of misfits, of the sign-reversed to the measured response, below which it counts as
reversed."""
EXACT_BENDER = (
    "intervals take the bimorph as known exactly; one whose d31 is 5 % off shifts a stiffness "
    "by 6 to 12 %: fit the bimorph first (--admittance, --velocity)"
)
"""Note on every fit of a load; its numbers were measured on the paper's two fingers."""


@dataclass(frozen=True)
class LoadFit:
    """A fitted finger load.

    Attributes
    ----------
    load : FingerLoad
        Fitted load, its branches by ascending corner frequency.
    constants : tuple of Constant
        Fitted constants: k0_n_per_m, d0_n_s_per_m, k1_n_per_m, d1_n_s_per_m, and so on.
    comparison : Comparison
        Comparison with the measurement. Its start is the load that was given as ``before``.
    notes : tuple of str
        Sentences on constants that are not identifiable, and on a misfit that is not noise.
    bic : float
        Bayesian information criterion; lower is better.
    """

    load: FingerLoad
    constants: tuple[Constant, ...]
    comparison: Comparison
    notes: tuple[str, ...]
    bic: float

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Comparisons with all measurements, of which there is one."""
        return (self.comparison,)

    @property
    def reported(self) -> tuple[Constant, ...]:
        """Constants to report: all that were fitted."""
        return self.constants


@dataclass(frozen=True)
class _Tip:
    """Known properties of the tip at the measured frequencies: blocked force and stiffness."""

    measurement: Measurement
    force: Complex
    stiffness: Complex

    @property
    def omega(self) -> Floats:
        """Angular frequencies (F,) of the measurement [rad/s]."""
        return 2 * np.pi * self.measurement.frequency

    def response(self, k: Complex) -> Complex:
        """Return the response to a load of stiffness k (..., F), of the kind that was measured."""
        moved = self.force / (self.stiffness + k)
        if self.measurement.kind == "velocity":
            moved = moved * 1j * self.omega
        return moved * k if self.measurement.kind == "force" else moved

    def pointwise(self, value: Complex) -> tuple[Complex, Floats]:
        """Return k (F,), and the relative change of the response per change of k (F,)."""
        if self.measurement.kind == "force":
            k = self.stiffness * value / (self.force - value)
            return k, np.abs(self.stiffness / (k * (self.stiffness + k)))
        moved = value / (1j * self.omega) if self.measurement.kind == "velocity" else value
        return self.force / moved - self.stiffness, np.abs(moved / self.force)


def fit_load(
    bimorph: Bimorph,
    measurement: Measurement,
    *,
    branches: int | None = None,
    before: FingerLoad | None = None,
) -> LoadFit:
    """Fit a generalized Maxwell load to the response of a bimorph that it loads.

    Parameters
    ----------
    bimorph : Bimorph
        Known design; one, not an array of designs.
    measurement : Measurement
        Displacement, velocity or force of the tip per volt at the electrodes.
    branches : int, optional
        Number of branches, 1 to 3. By default, branches are added for as long as the Bayesian
        information criterion prefers one more.
    before : FingerLoad, optional
        Load to compare with; a tip in air by default.

    Returns
    -------
    LoadFit
        Fitted load with intervals, comparison and notes.

    Raises
    ------
    InputError
        If there are too few points, the measurement is of another kind or reversed, or the number
        of branches is out of range.

    Notes ----- The intervals hold for noise that is independent from point to point and equally
    large in the real and the imaginary part, and for a bimorph that is known exactly.
    """
    tip = _checked(bimorph, measurement, branches)
    fit = _fit(tip, branches or 1)
    if branches is None:
        most = min(MOST_BRANCHES, len(measurement.frequency) // 2 - 1)
        for more in range(2, most + 1):
            richer = _fit(tip, more)
            if richer.bic >= fit.bic:
                break
            fit = richer
    return _labeled_fit(tip, fit, FingerLoad.none() if before is None else before)


def _checked(bimorph: Bimorph, measurement: Measurement, branches: int | None) -> _Tip:
    """Return the tip at the measured frequencies; raise InputError for an unusable measurement."""
    name, points = measurement.name, len(measurement.frequency)
    if measurement.kind not in KINDS:
        raise InputError(
            f"{name}: is {measurement.kind}; a load is fitted to one of {', '.join(KINDS)}"
        )
    if branches is not None and not 1 <= branches <= MOST_BRANCHES:
        raise InputError(f"branches = {branches}: must be 1 … {MOST_BRANCHES}")
    needed = 2 + 2 * (branches or 1)
    if points < needed:
        raise InputError(
            f"{name}: has {points} points; a load of {branches or 1} branches has {needed} "
            f"constants and needs at least {needed} points"
        )
    tip = _Tip(measurement, *blocked_force(bimorph, measurement.frequency))
    upright, turned = (_grid_search(tip, sign * measurement.value, 1)[0] for sign in (1, -1))
    if turned < REVERSED * upright:
        raise InputError(
            f"{name}: is reversed against the bimorph; swap the polarity, or add 180 to phase_deg"
        )
    return tip


def _grid_search(tip: _Tip, value: Complex, branches: int) -> tuple[float, Floats]:
    """Return misfit and constants [k0, d0, k1, d1, …] for the best corners of the grid."""
    k, weight = tip.pointwise(value)
    rate = 1j * tip.omega
    times = np.geomspace(1 / (BEYOND * tip.omega[-1]), BEYOND / tip.omega[0], CORNERS)
    turn = rate[:, None] * times
    columns = np.column_stack([np.ones_like(rate), rate, turn / (1 + turn)])
    table = _stacked(np.asarray(columns * weight[:, None], np.complex128))
    target = _stacked(k * weight)
    scale = np.linalg.norm(table, axis=0)
    q, r = np.linalg.qr(table / scale)
    projected = q.T @ target
    candidates: list[tuple[float, Floats]] = []
    for chosen in combinations(range(CORNERS), branches):
        used = [0, 1, *(2 + i for i in chosen)]
        linear, misfit = nnls(r[:, used], projected)
        linear = linear / scale[used]
        pairs = [(s, s * times[i]) for s, i in zip(linear[2:], chosen, strict=True)]
        candidates.append((float(misfit), np.array([*linear[:2], *np.ravel(pairs)])))
    return min(candidates, key=lambda one: one[0])


def _stacked(values: Complex) -> Floats:
    """Return the real parts followed by the imaginary parts."""
    return np.concatenate([values.real, values.imag])


def _load_of(logs: Floats) -> FingerLoad:
    """Return the load, or loads, for logarithms of constants (..., p)."""
    c = np.moveaxis(np.exp(logs), -1, 0)
    pairs = tuple((c[i], c[i + 1]) for i in range(2, len(c), 2))
    return FingerLoad(k0=c[0], d0=c[1], branches=pairs)


def _model(tip: _Tip) -> Model:
    return lambda logs: tip.response(_load_of(logs).stiffness(tip.measurement.frequency))


def _fit(tip: _Tip, branches: int) -> LogFit:
    """Fit a load with a given number of branches, starting from the grid search."""
    largest = float(np.abs(tip.pointwise(tip.measurement.value)[0]).max())
    stiff = np.minimum(np.array(REACH) * largest, LARGEST[0])
    damp = np.minimum(
        np.array([REACH[0] * largest / tip.omega[-1], REACH[1] * largest / tip.omega[0]]),
        LARGEST[1],
    )
    low, high = np.log(np.tile([stiff, damp], (1 + branches, 1))).T
    least = np.tile([stiff[0], damp[0]], 1 + branches) * 1e3
    whole = [slice(0, len(tip.omega))]
    _, start = _grid_search(tip, tip.measurement.value, branches)
    begin = np.log(np.maximum(start, least))
    return fit_logs(_model(tip), tip.measurement.value, begin, (low, high), whole)


def _labeled_fit(tip: _Tip, fit: LogFit, before: FingerLoad) -> LoadFit:
    """Return the fit as a load, with its constants, comparison and notes."""
    fit = _by_corner(fit)
    names = ["k0_n_per_m", "d0_n_s_per_m"]
    for i in range(1, len(fit.logs) // 2):
        names += [f"k{i}_n_per_m", f"d{i}_n_s_per_m"]
    signs = np.ones(len(names))
    constants = constants_of(fit, names, fit.logs, signs, [False] * len(names))
    value = [c.value for c in constants]
    load = FingerLoad(
        k0=value[0], d0=value[1], branches=tuple(zip(value[2::2], value[3::2], strict=True))
    )
    comparison = Comparison(
        tip.measurement,
        fit.predicted,
        tip.response(before.stiffness(tip.measurement.frequency)),
        *response_spread(_model(tip), fit),
    )
    notes = [
        *identifiability_notes(fit, constants),
        *_about_corners(load, tip.measurement.frequency),
        *misfit_notes(comparison),
    ]
    return LoadFit(load, constants, comparison, tuple(notes), fit.bic)


def _by_corner(fit: LogFit) -> LogFit:
    """Return the fit with its branches in ascending order of corner frequency."""
    corner = fit.logs[2::2] - fit.logs[3::2]
    pairs = [[2 + 2 * int(i), 3 + 2 * int(i)] for i in corner.argsort()]
    order = np.array([0, 1, *np.ravel(pairs)], np.intp)
    return replace(
        fit,
        logs=fit.logs[order],
        covariance=fit.covariance[np.ix_(order, order)],
        axes=fit.axes[:, order],
    )


def corner_frequency(k: Real, d: Real) -> float:
    """Compute the corner frequency k/(2π d), at which a branch turns from damper to spring.

    Parameters
    ----------
    k : float
        Stiffness of the branch [N/m].
    d : float
        Damping of the branch [N s/m].

    Returns
    -------
    float
        Corner frequency [Hz]; infinite without damping.
    """
    return float(k) / (2 * math.pi * float(d)) if d else math.inf


def _about_corners(load: FingerLoad, frequency: Floats) -> list[str]:
    """Return notes about branches whose corners are outside the band, or coincide."""
    notes = []
    corners = [corner_frequency(k, d) for k, d in load.branches]
    low, high = float(frequency[0]), float(frequency[-1])
    for i, corner in enumerate(corners, 1):
        where = f"branch {i} turns at {corner:.3g} Hz, outside the measured {low:g} … {high:g} Hz: "
        if corner > high:
            notes.append(f"{where}there it is a damper, and adds to d0_n_s_per_m")
        elif corner < low:
            notes.append(f"{where}there it is a spring, and adds to k0_n_per_m")
    for i, (first, second) in enumerate(pairwise(corners), 1):
        if second < ALIKE * first:
            notes.append(
                f"branches {i} and {i + 1} turn at the same place ({first:.3g} and {second:.3g} "
                "Hz): one would do"
            )
    return notes
