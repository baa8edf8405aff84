"""The finger's load from a measured response: a generalized Maxwell load on a known bimorph.

A tip that is held with the dynamic stiffness k moves by y = F/(S + k) per volt, with F the blocked
force and S the stiffness of the bimorph's tip. So each measured point tells its k(ω) in closed
form, F/y − S, and how noise in y spreads to it. For given corners of the branches k(ω) is linear
in k0, d0 and every k_i, which are not negative: trying the corners of a grid finds the start from
which the whole fit (`log_fit`) then runs.
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
    what_is_left,
    what_is_unknown,
)
from tactile.study.log_fit import LogFit, Model, fit_logs, response_spread
from tactile.study.measurement import Kind, Measurement

KINDS: tuple[Kind, ...] = ("displacement", "velocity", "force")
MOST_BRANCHES = 3
CORNERS = 16
"""Of the grid: 1.5 apart over two decades and a bit to either side."""
BEYOND = 3.0
"""Factor by which the grid of corners exceeds the measured band."""
REACH = (1e-6, 1e3)
"""Bounds of a constant over what it would be if it alone made the largest stiffness measured."""
LARGEST = (1e6, 1e3)
"""Stiffness [N/m] and damping [N s/m] that a display file takes."""
ALIKE = 1.5
"""Ratio of corners below which two branches are called out as one."""
REVERSED = 0.3
"""Misfit of the reversed response over that of the response below which it is reversed."""
EXACT_BENDER = (
    "intervals take the bimorph as known exactly; one whose d31 is 5 % off shifts a stiffness "
    "by 6 to 12 %: fit the bimorph first (--admittance, --velocity)"
)
"""What is to be said of every fit of a load; measured on the paper's two."""


@dataclass(frozen=True)
class LoadFit:
    """A fitted load.

    Attributes
    ----------
    load : branches by ascending corner
    constants : k0_n_per_m, d0_n_s_per_m, k1_n_per_m, d1_n_s_per_m, …
    comparison : with the measurement; its start is the load that was given as ``before``
    notes : sentences on what is not identifiable, and on a misfit that is not noise
    bic : Bayesian information criterion; lower is better
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
    def told(self) -> tuple[Constant, ...]:
        """All constants."""
        return self.constants


@dataclass(frozen=True)
class _Tip:
    """What is known of the tip at the measured frequencies: blocked force and stiffness."""

    measurement: Measurement
    force: Complex
    stiffness: Complex

    @property
    def omega(self) -> Floats:
        return 2 * np.pi * self.measurement.frequency

    def response(self, k: Complex) -> Complex:
        """Return the response, as it was measured, to a load of stiffness k (..., F)."""
        moved = self.force / (self.stiffness + k)
        if self.measurement.kind == "velocity":
            moved = moved * 1j * self.omega
        return moved * k if self.measurement.kind == "force" else moved

    def pointwise(self, value: Complex) -> tuple[Complex, Floats]:
        """Return k (F,), and the relative change of the response per change of it."""
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
    """Fit a generalized Maxwell load to a response of a bimorph that it loads.

    Parameters
    ----------
    bimorph : one design, known
    measurement : displacement, velocity or force of the tip per volt at the electrodes
    branches : 1 … 3; where not told, one more for as long as the Bayesian
        information criterion prefers it
    before : to be compared with; air where not given

    Returns
    -------
    LoadFit

    Raises
    ------
    InputError
        With too few points, another kind of measurement, a reversed response, or a number of
        branches out of range.

    Notes
    -----
    Intervals hold for noise that is independent from point to point and as large in the real as
    in the imaginary part, of a bimorph known exactly.
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
    return _told(tip, fit, FingerLoad.none() if before is None else before)


def _checked(bimorph: Bimorph, measurement: Measurement, branches: int | None) -> _Tip:
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
    """Return misfit and constants [k0, d0, k1, d1, …] of the best corners of the grid."""
    k, weight = tip.pointwise(value)
    rate = 1j * tip.omega
    times = np.geomspace(1 / (BEYOND * tip.omega[-1]), BEYOND / tip.omega[0], CORNERS)
    turn = rate[:, None] * times
    columns = np.column_stack([np.ones_like(rate), rate, turn / (1 + turn)])
    table = _stacked(np.asarray(columns * weight[:, None], np.complex128))
    wanted = _stacked(k * weight)
    scale = np.linalg.norm(table, axis=0)
    q, r = np.linalg.qr(table / scale)
    short = q.T @ wanted
    found: list[tuple[float, Floats]] = []
    for chosen in combinations(range(CORNERS), branches):
        used = [0, 1, *(2 + i for i in chosen)]
        linear, misfit = nnls(r[:, used], short)
        linear = linear / scale[used]
        pairs = [(s, s * times[i]) for s, i in zip(linear[2:], chosen, strict=True)]
        found.append((float(misfit), np.array([*linear[:2], *np.ravel(pairs)])))
    return min(found, key=lambda one: one[0])


def _stacked(values: Complex) -> Floats:
    return np.concatenate([values.real, values.imag])


def _load_of(logs: Floats) -> FingerLoad:
    """Return the load, or loads, of logarithms (..., p)."""
    c = np.moveaxis(np.exp(logs), -1, 0)
    pairs = tuple((c[i], c[i + 1]) for i in range(2, len(c), 2))
    return FingerLoad(k0=c[0], d0=c[1], branches=pairs)


def _model(tip: _Tip) -> Model:
    return lambda logs: tip.response(_load_of(logs).stiffness(tip.measurement.frequency))


def _fit(tip: _Tip, branches: int) -> LogFit:
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


def _told(tip: _Tip, fit: LogFit, before: FingerLoad) -> LoadFit:
    fit = _by_corner(fit)
    names = ["k0_n_per_m", "d0_n_s_per_m"]
    for i in range(1, len(fit.logs) // 2):
        names += [f"k{i}_n_per_m", f"d{i}_n_s_per_m"]
    one = np.ones(len(names))
    constants = constants_of(fit, names, fit.logs, one, [False] * len(names))
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
        *what_is_unknown(fit, constants),
        *_about_corners(load, tip.measurement.frequency),
        *what_is_left(comparison),
    ]
    return LoadFit(load, constants, comparison, tuple(notes), fit.bic)


def _by_corner(fit: LogFit) -> LogFit:
    """Return a fit with its branches in the order of their corners."""
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
    """Return k/(2π d) [Hz], where a branch turns from damper to spring; infinite without damper."""
    return float(k) / (2 * math.pi * float(d)) if d else math.inf


def _about_corners(load: FingerLoad, frequency: Floats) -> list[str]:
    """Return sentences about branches that turn outside the band, or at the same place."""
    said = []
    corners = [corner_frequency(k, d) for k, d in load.branches]
    low, high = float(frequency[0]), float(frequency[-1])
    for i, corner in enumerate(corners, 1):
        where = f"branch {i} turns at {corner:.3g} Hz, outside the measured {low:g} … {high:g} Hz: "
        if corner > high:
            said.append(f"{where}there it is a damper, and adds to d0_n_s_per_m")
        elif corner < low:
            said.append(f"{where}there it is a spring, and adds to k0_n_per_m")
    for i, (first, second) in enumerate(pairwise(corners), 1):
        if second < ALIKE * first:
            said.append(
                f"branches {i} and {i + 1} turn at the same place ({first:.3g} and {second:.3g} "
                "Hz): one would do"
            )
    return said
