"""The loaded bimorph in the frequency domain: shear, force and current per volt.

From clamp to tip the beam is carried as a compliance: at each cut w = Y f + y U, where
w = (u, ψ) and f = (M, F) (`beam`). Y = 0 and y = 0 at the clamp; a segment with the transition
w2 = A w1 + B f1 + e U, f2 = C w1 + D f1 + g U turns them into

    Y2 = (A Y + B)(C Y + D)⁻¹,    y2 = A y + e − Y2 (C y + g),

and at the tip the load closes the system, F = −Z_L v and M = −Z_Lr ψ̇. Unlike a product of
transfer matrices this loses nothing to the growth of cosh λ, so that long segments may be cut.
Everything broadcasts: designs (...,) in front, frequency (F,) last.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.beam import Complex, Matrix2, characteristic_roots, transition
from tactile.actuator.bimorph import (
    Bimorph,
    Segment,
    active_segment,
    capacitance,
    over_frequency,
)
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import Real

Vector2 = tuple[Complex, Complex]

LARGEST_GROWTH = 8.0
"""λ1 of a piece: rounding grows as its square's exponential, to 3e-8 at most (measured)."""


@dataclass(frozen=True)
class TipResponse:
    """What a bimorph's tip does per volt, exp(+jωt).

    Attributes
    ----------
    frequency : (F,) [Hz]
    displacement, velocity, rotation : (..., F) complex, of the tip [m/V], [m/(s V)], [rad/V]
    force : (..., F) complex, into the skin, Z_L v [N/V]
    admittance : (..., F) complex, I/U, the clamped segment included [S]
    displacement_at_point : (..., F) complex [m/V] at the measuring point, or None without one
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
    """The compliance at the start of a segment, and what leads from its end back to it."""

    Y: Matrix2
    y: Vector2
    inverse: Matrix2
    offset: Vector2


def _product(a: Matrix2, b: Matrix2) -> Matrix2:
    return (
        (a[0][0] * b[0][0] + a[0][1] * b[1][0], a[0][0] * b[0][1] + a[0][1] * b[1][1]),
        (a[1][0] * b[0][0] + a[1][1] * b[1][0], a[1][0] * b[0][1] + a[1][1] * b[1][1]),
    )


def _sum(a: Matrix2, b: Matrix2) -> Matrix2:
    return (
        (a[0][0] + b[0][0], a[0][1] + b[0][1]),
        (a[1][0] + b[1][0], a[1][1] + b[1][1]),
    )


def _apply(a: Matrix2, x: Vector2) -> Vector2:
    return a[0][0] * x[0] + a[0][1] * x[1], a[1][0] * x[0] + a[1][1] * x[1]


def _inverse(a: Matrix2) -> Matrix2:
    scale = 1 / (a[0][0] * a[1][1] - a[0][1] * a[1][0])
    return (a[1][1] * scale, -a[0][1] * scale), (-a[1][0] * scale, a[0][0] * scale)


def _across(
    segment: Segment,
    Y: Matrix2 | None,
    y: Vector2,
    omega: NDArray[np.float64],
    axial_force: NDArray[np.float64],
) -> tuple[Matrix2, Vector2, Matrix2, Vector2]:
    """Carry compliance Y (None: clamped) and y across a segment; see the module's docstring."""
    t = transition(segment.section, segment.length, omega, axial_force)
    K = segment.coupling
    start, inner = (
        (t.wf, t.ff)
        if Y is None
        else (_sum(_product(t.ww, Y), t.wf), _sum(_product(t.fw, Y), t.ff))
    )
    back = _inverse(inner)
    Y2 = _product(start, back)
    push = (t.ff[0][0] * K - K, t.ff[1][0] * K)
    move = (t.wf[0][0] * K, t.wf[1][0] * K)
    if Y is not None:
        push = _add(push, _apply(t.fw, y))
        move = _add(move, _apply(t.ww, y))
    pulled = _apply(Y2, push)
    return Y2, (move[0] - pulled[0], move[1] - pulled[1]), back, push


def _add(a: Vector2, b: Vector2) -> Vector2:
    return a[0] + b[0], a[1] + b[1]


def pieces(segment: Segment, omega: NDArray[np.float64], axial_force: NDArray[np.float64]) -> int:
    """Return in how many pieces a segment is cut so that rounding cannot grow."""
    s, top = segment.section, omega.max(initial=0.0)
    a = segment.length**2 / s.EI
    sigma = s.m * top**2 * segment.length**2 / s.AG
    tau = (s.rhoI * top**2 - axial_force) * a
    z1, _ = characteristic_roots(sigma, tau, s.m * top**2 * segment.length**2 * a)
    return max(1, int(np.ceil(np.sqrt(z1).real.max() / LARGEST_GROWTH)))


@dataclass(frozen=True)
class _Sweep:
    """Compliance of a chain seen from its tip, and the cuts along it."""

    Y: Matrix2
    y: Vector2
    cuts: list[_Cut]
    segments: list[Segment]
    ends: list[int]


def _sweep(
    segments: list[Segment], omega: NDArray[np.float64], axial_force: NDArray[np.float64]
) -> _Sweep:
    """Carry the compliance from the clamp to the tip."""
    Y: Matrix2 | None = None
    zero = np.zeros((), np.complex128)
    y: Vector2 = (zero, zero)
    cuts: list[_Cut] = []
    cut_segments, ends = [], []
    for whole in segments:
        n = pieces(whole, omega, axial_force)
        part = Segment(whole.section, whole.length / n, whole.coupling, whole.capacitance / n)
        for _ in range(n):
            Y2, y2, inverse, offset = _across(part, Y, y, omega, axial_force)
            start = ((zero, zero), (zero, zero)) if Y is None else Y
            cuts.append(_Cut(start, y, inverse, offset))
            cut_segments.append(part)
            Y, y = Y2, y2
        ends.append(len(cuts))
    if Y is None:
        raise ValueError("a chain needs at least one segment")
    return _Sweep(Y, y, cuts, cut_segments, ends)


def _back(sweep: _Sweep, f: Vector2) -> list[Vector2]:
    """Return w at the start of each cut piece, from f at the tip; the clamp does not move."""
    found = []
    for cut in sweep.cuts[:0:-1]:
        f = _apply(cut.inverse, (f[0] - cut.offset[0], f[1] - cut.offset[1]))
        found.append(_add(_apply(cut.Y, f), cut.y))
    return [sweep.cuts[0].y, *found[::-1]]


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
    """Return the response of segments in a row from clamp to tip, their electrodes joined.

    Parameters
    ----------
    segments : active or passive, of constants (...,) over designs
    load, rotational_load : at the tip
    frequency : (F,) [Hz], from 0 up
    axial_force : tension (...,) [N]; a pressing finger is negative
    point_after : reports the displacement at the end of this many segments

    Raises
    ------
    ValueError
        Without a segment, or with frequencies that are negative or not finite.
    """
    f, axial = _checked(frequency, axial_force)
    if point_after is not None and not 1 <= point_after <= len(segments):
        raise ValueError(f"point_after = {point_after}: must be 1 … {len(segments)}")
    omega = 2 * np.pi * f
    over = [over_frequency(s) for s in segments]
    sweep = _sweep(over, omega, axial)
    k = load.stiffness(f)
    kr = np.zeros((), np.complex128) if rotational_load is None else rotational_load.stiffness(f)
    (a, b), (c, d) = sweep.Y
    one = np.ones((), np.complex128)
    u, psi = _apply(_inverse(((one + b * k, a * kr), (d * k, one + c * kr))), sweep.y)
    starts = _back(sweep, (-kr * psi, -k * u))
    rotations = [*(w[1] for w in starts), psi]
    charge = np.zeros((), np.complex128)
    for cut, start, end in zip(sweep.segments, rotations[:-1], rotations[1:], strict=True):
        charge = charge + cut.capacitance + cut.coupling * (end - start)
    point = None
    if point_after is not None:
        point = [*(w[0] for w in starts), u][sweep.ends[point_after - 1]]
    rate = 1j * omega
    return TipResponse(f, u, rate * u, psi, k * u, rate * charge, point)


def tip_response(
    bimorph: Bimorph,
    load: FingerLoad,
    frequency: ArrayLike,
    *,
    rotational_load: FingerLoad | None = None,
    axial_force: Real = 0.0,
    measuring_point: Real | None = None,
) -> TipResponse:
    """Return the response of a bimorph whose tip carries a load.

    Parameters
    ----------
    bimorph, load : numbers, or arrays that broadcast to (...,) designs
    frequency : (F,) [Hz], from 0 up
    rotational_load : against rotation of the tip (k0 [N m], d0 [N m s]); a finger has none
    axial_force : tension (...,) [N]; a pressing finger is negative
    measuring_point : distance from the clamp [m] where ``displacement_at_point`` is wanted

    Returns
    -------
    TipResponse
        Of arrays (..., F), per volt.

    Raises
    ------
    ValueError
        With frequencies that are negative or not finite, or a point off the beam.

    Notes
    -----
    Hofmann & Twiefel 2014, corrected (see `beam`, `bimorph`, `finger`): a Timoshenko beam with
    constant loss factors. Of the model itself the first resonance is 1 % low (`Bimorph`).
    """
    segment = active_segment(bimorph)
    chain, point_after = [segment], None
    if measuring_point is not None:
        fraction = np.asarray(measuring_point) / segment.length
        if not np.all((fraction > 0) & (fraction <= 1)):
            raise ValueError(
                f"measuring_point {measuring_point} m is not between clamp and tip "
                f"(0 … {bimorph.length} m)"
            )
        chain, point_after = [*segment.cut(fraction)], 1
    r = chain_response(
        chain,
        load,
        frequency,
        rotational_load=rotational_load,
        axial_force=axial_force,
        point_after=point_after,
    )
    clamped = 2j * np.pi * r.frequency * capacitance(bimorph, bimorph.clamped_length)[..., None]
    return replace(r, admittance=r.admittance + clamped)


def blocked_force(
    bimorph: Bimorph, frequency: ArrayLike, *, axial_force: Real = 0.0
) -> tuple[Complex, Complex]:
    """Return the force of a tip held in place and the stiffness of the tip.

    Parameters
    ----------
    bimorph, axial_force : numbers, or arrays over designs (...,)
    frequency : (F,) [Hz], from 0 up

    Returns
    -------
    force : (..., F) complex ndarray
        Against what holds the tip (free to rotate), per volt [N/V].
    stiffness : (..., F) complex ndarray
        Dynamic stiffness of the undriven tip [N/m]; force/stiffness is the displacement in air.
    """
    f, axial = _checked(frequency, axial_force)
    sweep = _sweep([over_frequency(active_segment(bimorph))], 2 * np.pi * f, axial)
    stiffness = 1 / sweep.Y[0][1]
    return sweep.y[0] * stiffness, stiffness
