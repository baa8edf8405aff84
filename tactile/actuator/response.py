"""Frequency response of the loaded bimorph: shear displacement, force and current per volt.

The beam is condensed from clamp to tip into a compliance: at each cut w = Y f + y U, where
w = (u, ψ) and f = (M, F) (see `beam`). At the clamp Y = 0 and y = 0. The drive of a segment of
coupling K is a pair of moments k = (K, 0) U at its ends. Within the segment, f + k is the moment
and force of bending and shear, so that with the passive transition

    w2 = A w1 + B (f1 + k),    f2 + k = C w1 + D (f1 + k),

the compliance at its end is

    Y2 = (A Y + B)(C Y + D)⁻¹,    y2 = A x − Y2 (C x − k),    x = y − Y k,

and at the tip the load closes the system with F = −Z_L v and M = −Z_Lr ψ̇. Unlike a product of
transfer matrices, this recursion loses no accuracy to the growth of cosh λ, so that long segments
can be cut into pieces.

Everything broadcasts: designs (...,) come first and frequency (F,) comes last. The computation
works on whole arrays and takes about 550 bytes per point (designs × frequencies) at its peak.
Sweeps are fastest in blocks of some ten thousand points, which stay in the processor's cache.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.beam import Matrix2, Transition, characteristic_roots, transition
from tactile.actuator.bimorph import (
    Bimorph,
    Segment,
    active_segment,
    capacitance,
    over_frequency,
)
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import Real
from tactile.arrays import Complex

Vector2 = tuple[Complex, Complex]
"""A vector of two arrays."""
ZERO: Complex = np.zeros((), np.complex128)
"""Complex zero that broadcasts."""

LARGEST_GROWTH = 10.0
"""Largest λ1 of a piece. Rounding errors grow as exp(λ1), to 2e-10 at λ1 = 12 (measured)."""


@dataclass(frozen=True)
class TipResponse:
    """Response of a bimorph's tip per volt, at exp(+jωt).

    Attributes
    ----------
    frequency : (F,) array of float
        Frequencies [Hz].
    displacement : (..., F) complex array
        Displacement of the tip [m/V].
    velocity : (..., F) complex array
        Velocity of the tip [m/(s V)].
    rotation : (..., F) complex array
        Rotation of the tip [rad/V].
    force : (..., F) complex array
        Force on the skin, Z_L v [N/V].
    admittance : (..., F) complex array
        Electrical admittance I/U, the clamped segment included [S].
    displacement_at_point : (..., F) complex array or None
        Displacement at the measuring point [m/V]; None without one.
    """

    frequency: NDArray[np.float64]
    displacement: Complex
    velocity: Complex
    rotation: Complex
    force: Complex
    admittance: Complex
    displacement_at_point: Complex | None = None


@dataclass(frozen=True)
class _Cut:
    """Quantities that lead from the end of a piece back to its start.

    They are Y, x, (C Y + D)⁻¹, C x − k, and the moment K per volt of the drive.
    """

    Y: Matrix2
    x: Vector2
    inverse: Matrix2
    offset: Vector2
    k: Complex


def _product(a: Matrix2, b: Matrix2) -> Matrix2:
    """Return the matrix product."""
    return (
        (a[0][0] * b[0][0] + a[0][1] * b[1][0], a[0][0] * b[0][1] + a[0][1] * b[1][1]),
        (a[1][0] * b[0][0] + a[1][1] * b[1][0], a[1][0] * b[0][1] + a[1][1] * b[1][1]),
    )


def _sum(a: Matrix2, b: Matrix2) -> Matrix2:
    """Return the sum of two matrices."""
    return (
        (a[0][0] + b[0][0], a[0][1] + b[0][1]),
        (a[1][0] + b[1][0], a[1][1] + b[1][1]),
    )


def _apply(a: Matrix2, x: Vector2) -> Vector2:
    """Return the product of a matrix and a vector."""
    return a[0][0] * x[0] + a[0][1] * x[1], a[1][0] * x[0] + a[1][1] * x[1]


def _less(a: Vector2, b: Vector2) -> Vector2:
    """Return the difference of two vectors."""
    return a[0] - b[0], a[1] - b[1]


def _inverse(a: Matrix2) -> Matrix2:
    """Return the inverse of a matrix."""
    scale = 1 / (a[0][0] * a[1][1] - a[0][1] * a[1][0])
    back = -1 * scale  # twice as fast as two negations
    return (a[1][1] * scale, a[0][1] * back), (a[1][0] * back, a[0][0] * scale)


def _from_clamp(t: Transition, K: Complex) -> tuple[Matrix2, Vector2, _Cut]:
    """Return compliance, y and cut of the first piece of a chain, which begins at the clamp."""
    inverse = _inverse(t.ff)
    Y = _product(t.wf, inverse)
    cut = _Cut(((ZERO, ZERO), (ZERO, ZERO)), (ZERO, ZERO), inverse, (-K, ZERO), K)
    return Y, (K * Y[0][0], K * Y[1][0]), cut


def _across(t: Transition, K: Complex, Y: Matrix2, y: Vector2) -> tuple[Matrix2, Vector2, _Cut]:
    """Propagate compliance and y across a piece, by the recursion in the module docstring."""
    x = y[0] - Y[0][0] * K, y[1] - Y[1][0] * K
    inverse = _inverse(_sum(_product(t.fw, Y), t.ff))
    Y2 = _product(_sum(_product(t.ww, Y), t.wf), inverse)
    pushed = _apply(t.fw, x)
    offset = pushed[0] - K, pushed[1]
    return Y2, _less(_apply(t.ww, x), _apply(Y2, offset)), _Cut(Y, x, inverse, offset, K)


def pieces(segment: Segment, omega: NDArray[np.float64], axial_force: NDArray[np.float64]) -> int:
    """Compute the number of pieces into which a segment must be cut.

    The cuts bound the growth of rounding errors.

    Parameters
    ----------
    segment : Segment
        Segment with constants that broadcast against ``omega``.
    omega : array of float
        Angular frequencies [rad/s].
    axial_force : array of float
        Axial tension [N].

    Returns
    -------
    int
        Number of pieces, at least 1.
    """
    s, top = segment.section, omega.max(initial=0.0)
    a, inertia = segment.length**2 / s.EI, s.m * top**2 * segment.length**2
    sigma, tau = inertia / s.AG, (s.rhoI * top**2 - axial_force) * a
    z1, _ = characteristic_roots(-(sigma + tau), sigma * tau - inertia * a)
    return max(1, int(np.ceil(np.sqrt(z1).real.max() / LARGEST_GROWTH)))


@dataclass(frozen=True)
class _Sweep:
    """Compliance of a chain seen from its tip, with the cuts along it.

    ``ends`` holds, for each segment, the number of cuts up to its end.
    """

    Y: Matrix2
    y: Vector2
    cuts: list[_Cut]
    ends: list[int]


def _sweep(
    segments: list[Segment], omega: NDArray[np.float64], axial_force: NDArray[np.float64]
) -> _Sweep:
    """Condense a chain of segments from the clamp to the tip."""
    Y: Matrix2 = ((ZERO, ZERO), (ZERO, ZERO))
    y: Vector2 = (ZERO, ZERO)
    cuts: list[_Cut] = []
    ends = []
    for whole in segments:
        n = pieces(whole, omega, axial_force)
        t = transition(whole.section, whole.length / n, omega, axial_force)
        for _ in range(n):
            Y, y, cut = _across(t, whole.coupling, Y, y) if cuts else _from_clamp(t, whole.coupling)
            cuts.append(cut)
        ends.append(len(cuts))
    if not cuts:
        raise ValueError("a chain needs at least one segment")
    return _Sweep(Y, y, cuts, ends)


def _back(sweep: _Sweep, exerted: Vector2) -> list[Vector2]:
    """Return w at the start of each piece, given what the tip exerts; the clamp does not move."""
    if len(sweep.cuts) == 1:
        return [(ZERO, ZERO)]
    states: list[Vector2] = []
    f = _less((ZERO, ZERO), exerted)
    for cut in sweep.cuts[:0:-1]:
        f = _apply(cut.inverse, _less(f, cut.offset))
        w = _apply(cut.Y, f)
        states.append((w[0] + cut.x[0], w[1] + cut.x[1]))
        f = f[0] - cut.k, f[1]
    return [(ZERO, ZERO), *states[::-1]]


def _at_tip(sweep: _Sweep, k: Complex, kr: Complex | None) -> Vector2:
    """Return w of a tip held by dynamic stiffnesses k and kr: (1 + Y diag(kr, k)) w = y.

    ``kr`` is the stiffness against rotation; without it the system reduces to one equation.
    """
    (a, b), (c, d) = sweep.Y
    if kr is None:
        u = sweep.y[0] / (1 + b * k)
        return u, sweep.y[1] - d * (k * u)
    return _apply(_inverse(((1 + b * k, a * kr), (d * k, 1 + c * kr))), sweep.y)


def _checked(
    frequency: ArrayLike, axial_force: Real
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return frequency (F,) and axial force (..., 1), or raise ValueError."""
    f = np.atleast_1d(np.asarray(frequency, np.float64))
    if f.ndim != 1 or not np.all(np.isfinite(f) & (f >= 0)):
        raise ValueError("frequency: needs one axis of finite numbers from 0 Hz up")
    axial = np.asarray(axial_force, np.float64)
    if not np.all(np.isfinite(axial)):
        raise ValueError(f"axial_force = {axial_force}: not a finite number of newtons")
    return f, axial[..., None]


def chain_response(
    segments: list[Segment],
    load: FingerLoad,
    frequency: ArrayLike,
    *,
    rotational_load: FingerLoad | None = None,
    axial_force: Real = 0.0,
    point_after: int | None = None,
) -> TipResponse:
    """Compute the response of a chain of segments whose electrodes are connected.

    Parameters
    ----------
    segments : list of Segment
        Active or passive segments from clamp to tip, with constants (...,) over designs.
    load : FingerLoad
        Load against displacement of the tip.
    frequency : (F,) array_like of float
        Frequencies, zero allowed [Hz].
    rotational_load : FingerLoad, optional
        Load against rotation of the tip (k0 [N m], d0 [N m s]).
    axial_force : float or (...,) array of float
        Axial tension; a pressing finger is negative [N].
    point_after : int, optional
        Number of segments, counted from the clamp, after which the displacement is reported as
        ``displacement_at_point``.

    Returns
    -------
    TipResponse
        Response per volt, of shape (..., F).

    Raises
    ------
    ValueError
        If there is no segment, if a frequency is negative or not finite, if the axial force is not
        finite, or if ``point_after`` is not the number of a segment.
    """
    f, axial = _checked(frequency, axial_force)
    if point_after is not None and not 1 <= point_after <= len(segments):
        raise ValueError(f"point_after = {point_after}: must be 1 … {len(segments)}")
    omega = 2 * np.pi * f
    over = [over_frequency(s) for s in segments]
    sweep = _sweep(over, omega, axial)
    k = load.stiffness(f)
    kr = None if rotational_load is None else rotational_load.stiffness(f)
    u, psi = _at_tip(sweep, k, kr)
    force = k * u
    along = [*_back(sweep, (ZERO if kr is None else kr * psi, force)), (u, psi)]
    charges = [
        part.capacitance + part.coupling * (along[end][1] - along[start][1])
        for part, start, end in zip(over, [0, *sweep.ends[:-1]], sweep.ends, strict=True)
    ]
    point = None if point_after is None else along[sweep.ends[point_after - 1]][0]
    rate = 2j * np.pi * f
    return TipResponse(f, u, rate * u, psi, force, rate * sum(charges[1:], charges[0]), point)


def tip_response(
    bimorph: Bimorph,
    load: FingerLoad,
    frequency: ArrayLike,
    *,
    rotational_load: FingerLoad | None = None,
    axial_force: Real = 0.0,
    measuring_point: Real | None = None,
) -> TipResponse:
    """Compute the response of a bimorph whose tip carries a load.

    Parameters
    ----------
    bimorph : Bimorph
        One design, or arrays that broadcast to (...,) designs.
    load : FingerLoad
        Load against displacement of the tip.
    frequency : (F,) array_like of float
        Frequencies, zero allowed [Hz].
    rotational_load : FingerLoad, optional
        Load against rotation of the tip (k0 [N m], d0 [N m s]); a finger has none.
    axial_force : float or (...,) array of float
        Axial tension; a pressing finger is negative [N].
    measuring_point : float or array of float, optional
        Distance from the clamp at which ``displacement_at_point`` is computed [m].

    Returns
    -------
    TipResponse
        Response per volt, of shape (..., F).

    Raises
    ------
    ValueError
        If a frequency is negative or not finite, if the axial force is not finite, or if the
        measuring point is not on the free length.

    Notes
    -----
    Hofmann & Twiefel 2014, corrected (see `beam`, `bimorph`, `finger`): a Timoshenko beam with
    constant loss factors. The first resonance of the model itself is 1 % low (see `Bimorph`).

    Examples
    --------
    Static displacement in air and on a finger, in µm/V; the finger's 1000 N/m add to the 1535 N/m
    of the tip.

    >>> import tactile
    >>> loads = tactile.FingerLoad.none(), tactile.FingerLoad.low()
    >>> tips = [tactile.tip_response(tactile.Bimorph(), load, [0.0]) for load in loads]
    >>> [round(float(tip.displacement[0].real) * 1e6, 3) for tip in tips]
    [0.931, 0.564]
    """
    electrodes = np.asarray(bimorph.length) + bimorph.clamped_length
    segment = replace(active_segment(bimorph), capacitance=capacitance(bimorph, electrodes))
    chain, point_after = [segment], None
    if measuring_point is not None:
        fraction = np.asarray(measuring_point) / segment.length
        if not np.all((fraction > 0) & (fraction <= 1)):
            raise ValueError(
                f"measuring_point {measuring_point} m is not between clamp and tip "
                f"(0 … {bimorph.length} m)"
            )
        chain, point_after = [*segment.cut(fraction)], 1
    return chain_response(
        chain,
        load,
        frequency,
        rotational_load=rotational_load,
        axial_force=axial_force,
        point_after=point_after,
    )


def blocked_force(
    bimorph: Bimorph, frequency: ArrayLike, *, axial_force: Real = 0.0
) -> tuple[Complex, Complex]:
    """Compute the force of a tip that is held in place, and the dynamic stiffness of the tip.

    Parameters
    ----------
    bimorph : Bimorph
        One design, or arrays over designs (...,).
    frequency : (F,) array_like of float
        Frequencies, zero allowed [Hz].
    axial_force : float or (...,) array of float
        Axial tension; a pressing finger is negative [N].

    Returns
    -------
    force : (..., F) complex array
        Force on the support that holds the tip, which is free to rotate [N/V].
    stiffness : (..., F) complex array
        Dynamic stiffness of the undriven tip [N/m]; force/stiffness is the displacement in air.

    Raises
    ------
    ValueError
        If a frequency is negative or not finite, or if the axial force is not finite.

    Examples
    --------
    Static force in mN/V and stiffness in N/m; their ratio is the displacement in air.

    >>> import tactile
    >>> force, stiffness = tactile.blocked_force(tactile.Bimorph(), [0.0])
    >>> round(float(force[0].real) * 1e3, 2), round(float(stiffness[0].real))
    (1.43, 1535)
    """
    f, axial = _checked(frequency, axial_force)
    sweep = _sweep([over_frequency(active_segment(bimorph))], 2 * np.pi * f, axial)
    stiffness = 1 / sweep.Y[0][1]
    return sweep.y[0] * stiffness, stiffness
