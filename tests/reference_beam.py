"""Two independent numerical references for the loaded piezoelectric bimorph.

The bimorph is a thin cantilever: a passive shim between two piezoelectric layers. A voltage
between the shim and the two outer electrodes makes one layer longer and the other one shorter,
so the beam bends and its tip shears the skin that rests on it. The model under test solves the
beam equations of the design page in closed form, as a transfer matrix. This file solves the same
equations twice more, by methods which share nothing with that closed form, so that tests can
compare numbers that were obtained independently:

* ``response`` and ``natural_frequencies``: a finite-element model. The unknown deflection u(x)
  and cross-section rotation psi(x) are sums of polynomials on a few elements. They follow from
  the principle of virtual work, for all admissible du and dpsi, time factor exp(j omega t):

      integral(EI psi' dpsi' + AG (u' + psi)(du' + dpsi) + N psi dpsi
               - omega^2 (m u du + rhoI psi dpsi)) dx
          = U integral(K dpsi') dx + (F du + M dpsi) at the tip,

  which is what integrating M' = F - omega^2 rhoI psi + N psi and F' = -omega^2 m u by parts
  gives, with M = EI psi' - K U and F = AG (u' + psi). At the clamp u = psi = 0. The finger
  pushes back on the tip: F = -Z_L v, M = -Z_Lr psi_dot. The charge is the same coupling read
  backwards: Q = integral(K psi') dx + C U. The polynomials are of high order (ten), which makes
  the result exact to about ten digits and leaves shear locking, the over-stiffness of low-order
  elements, no room.
* ``matrix_exponential``: the same equations as a first-order system y' = A y along the beam,
  solved by the matrix exponential, and ``scaled`` to compare two such matrices fairly.

The two share the constants of the cross section (``section``), the loads and nothing else. All
quantities are in SI units. Losses are complex constants: 1/s (1 + j/Q), eps (1 - j tan delta)
and d (1 - j tan theta).
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, pi, sqrt

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from tactile.arrays import Complex

Real = NDArray[np.float64]
Load = tuple[float, float, tuple[tuple[float, float], ...]]
"""Generalized Maxwell load: stiffness k0, damping d0, then (k, d) of each spring-dashpot pair."""

VACUUM_PERMITTIVITY = 8.8541878128e-12
SHEAR_CORRECTION = 5 / 6
ORDER = 10
ELEMENTS = 6

LOW_FINGER: Load = (1000.0, 0.11, ((1300.0, 0.33),))
HIGH_FINGER: Load = (4300.0, 0.55, ((5000.0, 2.0),))


@dataclass(frozen=True)
class Beam:
    """Layers and materials of one bimorph, by default the default design of the design page.

    Of the two equal piezoelectric layers each has ``piezo_height``. ``length`` is the free
    length; ``clamped_length`` moves nothing and only adds its capacitance.
    """

    width: float = 2.1e-3
    length: float = 20e-3
    clamped_length: float = 5e-3
    piezo_height: float = 0.26e-3
    shim_height: float = 0.20e-3
    s11E: float = 16.2e-12
    s55E: float = 44e-12
    d31: float = -320e-12
    eps33T: float = 3800 * VACUUM_PERMITTIVITY
    piezo_density: float = 7870.0
    piezo_quality: float = 60.0
    loss_tangent: float = 0.02
    piezo_loss_tangent: float = 0.01
    shim_s11: float = 1 / 110e9
    shim_s55: float = 1 / 4.5e9
    shim_density: float = 1550.0
    shim_quality: float = 30.0


Chain = Sequence[tuple[Beam, float, bool]]
"""Sections from the clamp to the tip: layers, length, and whether the voltage drives them."""


@dataclass(frozen=True)
class Section:
    """Constants of a cross section: EI, AG, m, rhoI, K and the capacitance per length."""

    bending: complex
    shear: complex
    mass: float
    inertia: float
    coupling: complex
    capacitance: complex


@dataclass(frozen=True)
class Response:
    """Response to one volt, one entry per frequency.

    ``displacement`` [m/V] and ``rotation`` [1/V] are those of the tip, ``force`` [N/V] is the one
    into the skin, ``admittance`` [S] is current over voltage, and ``at_point`` [m/V] is the
    displacement at the measuring point (the tip, if none was asked for).
    """

    displacement: Complex
    rotation: Complex
    force: Complex
    admittance: Complex
    at_point: Complex


@dataclass(frozen=True)
class Model:
    """The assembled matrices, with the clamped unknowns removed.

    ``drive`` is the generalized force of one volt and, read backwards, the charge of a motion.
    ``tip`` and ``turn`` are the places of the tip's u and psi among the unknowns, and ``probe``
    weighs the unknowns into the displacement at the measuring point.
    """

    stiffness: Complex
    mass: Real
    drive: Complex
    capacitance: complex
    tip: int
    turn: int
    probe: Real


def lossless(beam: Beam) -> Beam:
    """Return the same beam with every loss removed."""
    return replace(
        beam, piezo_quality=inf, shim_quality=inf, loss_tangent=0.0, piezo_loss_tangent=0.0
    )


def section(beam: Beam, active: bool = True) -> Section:
    """Integrate the layers' constants over the cross section."""
    width, shim, piezo = beam.width, beam.shim_height, beam.piezo_height
    piezo_loss = complex(1.0, 1.0 / beam.piezo_quality)
    shim_loss = complex(1.0, 1.0 / beam.shim_quality)
    outer = 2 / 3 * ((piezo + shim / 2) ** 3 - (shim / 2) ** 3)
    inner = shim**3 / 12
    stretch = shim_loss * inner / beam.shim_s11 + piezo_loss * outer / beam.s11E
    shear = shim_loss * shim / beam.shim_s55 + piezo_loss * 2 * piezo / beam.s55E
    coupling, capacitance = electric(beam) if active else (0j, 0j)
    return Section(
        bending=width * stretch,
        shear=SHEAR_CORRECTION * width * shear,
        mass=width * (beam.shim_density * shim + beam.piezo_density * 2 * piezo),
        inertia=width * (beam.shim_density * inner + beam.piezo_density * outer),
        coupling=coupling,
        capacitance=capacitance,
    )


def electric(beam: Beam) -> tuple[complex, complex]:
    """Return the coupling K and the capacitance per length of both layers in parallel."""
    elasticity = complex(1.0, 1.0 / beam.piezo_quality) / beam.s11E
    strain = beam.d31 * complex(1.0, -beam.piezo_loss_tangent)
    permittivity = beam.eps33T * complex(1.0, -beam.loss_tangent)
    coupling = beam.width * strain * elasticity * (beam.shim_height + beam.piezo_height)
    clamped = permittivity - strain**2 * elasticity
    return coupling, 2 * beam.width / beam.piezo_height * clamped


def shapes(order: int, places: Real) -> tuple[Real, Real]:
    """Return Lobatto's shape functions and their derivatives, on -1 to 1, one row each.

    The first two are the straight lines which carry the values at the two ends. The others
    are integrals of Legendre polynomials; they vanish at both ends.
    """
    legendre = np.polynomial.legendre.legvander(places, order).T
    values = np.zeros((order + 1, len(places)))
    slopes = np.zeros((order + 1, len(places)))
    values[0], values[1] = (1 - places) / 2, (1 + places) / 2
    slopes[0], slopes[1] = -0.5, 0.5
    for k in range(2, order + 1):
        values[k] = (legendre[k] - legendre[k - 2]) / sqrt(2 * (2 * k - 1))
        slopes[k] = sqrt((2 * k - 1) / 2) * legendre[k - 1]
    return values, slopes


def numbering(element: int, elements: int, order: int) -> NDArray[np.intp]:
    """Return the places of one element's shape functions among those of one field."""
    inside = elements + 1 + element * (order - 1) + np.arange(order - 1)
    return np.concatenate(([element, element + 1], inside)).astype(np.intp)


def element_matrices(
    part: Section, size: float, order: int, axial_force: float
) -> tuple[Complex, Real, Complex]:
    """Return stiffness, mass and drive of one element, first all of u, then all of psi."""
    places, gauss = np.polynomial.legendre.leggauss(order + 1)
    weights: Real = np.asarray(gauss * size / 2, np.float64)
    values, slopes = shapes(order, np.asarray(places, np.float64))
    slopes = slopes * 2 / size
    still = np.zeros_like(values)
    bend, turn = np.vstack((still, slopes)), np.vstack((still, values))
    move, slant = np.vstack((values, still)), np.vstack((slopes, values))

    def product(rows: Real) -> Real:
        return (rows * weights) @ rows.T

    elastic = part.bending * product(bend) + part.shear * product(slant)
    stiffness: Complex = np.asarray(elastic + axial_force * product(turn), np.complex128)
    mass = part.mass * product(move) + part.inertia * product(turn)
    drive: Complex = np.asarray(part.coupling * (bend @ weights), np.complex128)
    return stiffness, mass, drive


def gather(
    pieces: Sequence[tuple[Section, float]], order: int, axial_force: float
) -> tuple[Complex, Real, Complex]:
    """Add the matrices of all elements up, first all of u, then all of psi, none clamped yet."""
    count = len(pieces) * order + 1
    stiffness = np.zeros((2 * count, 2 * count), np.complex128)
    mass, drive = np.zeros((2 * count, 2 * count)), np.zeros(2 * count, np.complex128)
    for index, (part, size) in enumerate(pieces):
        field = numbering(index, len(pieces), order)
        places = np.concatenate((field, count + field))
        own = element_matrices(part, size, order, axial_force)
        stiffness[np.ix_(places, places)] += own[0]
        mass[np.ix_(places, places)] += own[1]
        drive[places] += own[2]
    return stiffness, mass, drive


def assemble(
    beam: Beam,
    chain: Chain | None = None,
    *,
    axial_force: float = 0.0,
    point: float | None = None,
    segments: int | None = None,
    order: int = ORDER,
) -> Model:
    """Assemble the finite-element model of a beam, or of a chain of sections.

    Each section is cut into ``segments`` equal elements with polynomials of the given order.
    """
    each = segments or ELEMENTS
    parts = [(section(b, active), size) for b, size, active in chain or [(beam, beam.length, True)]]
    pieces = [(part, size / each) for part, size in parts for _ in range(each)]
    count = len(pieces) * order + 1
    stiffness, mass, drive = gather(pieces, order, axial_force)
    free = np.delete(np.arange(2 * count), [0, count])  # u = psi = 0 at the clamp
    inner = np.ix_(free, free)
    layered = sum(part.capacitance * size for part, size in parts)
    return Model(
        stiffness=stiffness[inner],
        mass=mass[inner],
        drive=drive[free],
        capacitance=electric(beam)[1] * beam.clamped_length + layered,
        tip=len(pieces) - 1,
        turn=count - 1 + len(pieces) - 1,
        probe=probe([size for _, size in pieces], order, point)[free],
    )


def probe(sizes: Sequence[float], order: int, point: float | None) -> Real:
    """Return the weights which add all unknowns up to the displacement at one point."""
    edges = np.concatenate(([0.0], np.cumsum(sizes)))
    place = edges[-1] if point is None else point
    if not 0 <= place <= edges[-1] * (1 + 1e-12):
        raise ValueError(f"the point {place} m is not on the beam, 0 to {edges[-1]} m")
    element = min(int(np.searchsorted(edges, place, side="right")) - 1, len(sizes) - 1)
    local = np.array([2 * (place - edges[element]) / sizes[element] - 1])
    weights = np.zeros(2 * (len(sizes) * order + 1))
    weights[numbering(element, len(sizes), order)] = shapes(order, local)[0][:, 0]
    return weights


def dynamic_stiffness(load: Load | None, omega: float) -> complex:
    """Return j omega Z of a generalized Maxwell load: force over displacement."""
    if load is None:
        return 0j
    stiffness, damping, pairs = load
    branches = sum(1j * omega * k * d / (k + 1j * omega * d) for k, d in pairs)
    return stiffness + 1j * omega * damping + branches


def solve(model: Model, omega: float, load: complex, rotational_load: complex) -> Complex:
    """Return all unknowns for one volt, the tip being held by the two dynamic stiffnesses."""
    matrix = model.stiffness - omega**2 * model.mass
    matrix[model.tip, model.tip] += load
    matrix[model.turn, model.turn] += rotational_load
    balance = 1 / np.sqrt(np.abs(np.diag(model.stiffness)))
    balanced = balance[:, None] * matrix * balance
    solution: Complex = balance * np.linalg.solve(balanced, balance * model.drive)
    return solution


def response(
    beam: Beam,
    frequency: ArrayLike,
    *,
    load: Load | None = None,
    rotational_load: Load | None = None,
    axial_force: float = 0.0,
    point: float | None = None,
    segments: int | None = None,
    chain: Chain | None = None,
    order: int = ORDER,
) -> Response:
    """Return what one volt does at each frequency [Hz], zero included.

    ``axial_force`` is a tension (a pressing finger is negative). ``point`` is a distance from
    the clamp. ``segments`` is the number of finite elements in each section. A ``chain``
    replaces the free part of the beam by sections of their own layers, lengths and drive; the
    clamped part stays that of ``beam``. The electrodes of a section which is not driven are
    short-circuited and add nothing to the current.
    """
    model = assemble(
        beam, chain, axial_force=axial_force, point=point, segments=segments, order=order
    )
    omegas = 2 * pi * np.atleast_1d(np.asarray(frequency, float)).ravel()
    skin = np.array([dynamic_stiffness(load, omega) for omega in omegas])
    twist = np.array([dynamic_stiffness(rotational_load, omega) for omega in omegas])
    unknowns: Complex = np.array(
        [solve(model, *row) for row in zip(omegas, skin, twist, strict=True)]
    )
    return Response(
        displacement=unknowns[:, model.tip],
        rotation=unknowns[:, model.turn],
        force=skin * unknowns[:, model.tip],
        admittance=1j * omegas * (model.capacitance + unknowns @ model.drive),
        at_point=unknowns @ model.probe,
    )


def natural_frequencies(
    beam: Beam, n: int, *, segments: int | None = None, order: int = ORDER
) -> Real:
    """Return the first n undamped natural frequencies [Hz], clamped-free, short-circuited.

    Solving for 1/omega^2 rather than omega^2 keeps the low frequencies exact: they are then the
    large eigenvalues.
    """
    model = assemble(lossless(beam), segments=segments or max(ELEMENTS, n), order=order)
    balance = 1 / np.sqrt(np.diag(model.stiffness.real))
    weigh = balance[:, None] * balance
    inverse: Real = scipy.linalg.eigh(
        weigh * model.mass, weigh * model.stiffness.real, eigvals_only=True
    )
    frequencies: Real = 1 / (2 * pi * np.sqrt(inverse[::-1][:n]))
    return frequencies


def generator(part: Section, omega: float, axial_force: float) -> Complex:
    """Return A of y' = A y, for y = [v, psi_dot, M, F, U, I], I being gathered from the clamp."""
    matrix = np.zeros((6, 6), complex)
    matrix[0, 3] = 1j * omega / part.shear  # F = AG (u' + psi), v = j omega u
    matrix[0, 1] = -1
    matrix[1, 2] = 1j * omega / part.bending  # M = EI psi' - K U
    matrix[1, 4] = 1j * omega * part.coupling / part.bending
    matrix[2, 3] = 1  # M' = F - omega^2 rhoI psi + N psi
    matrix[2, 1] = (axial_force - omega**2 * part.inertia) / (1j * omega)
    matrix[3, 0] = 1j * omega * part.mass  # F' = -omega^2 m u
    matrix[5] = part.coupling * matrix[1]  # I' = K psi_dot' + j omega (C/l) U
    matrix[5, 4] += 1j * omega * part.capacitance
    return matrix


def units(part: Section, omega: float, length: float) -> Complex:
    """Return units of v, psi_dot, M, F, U and I in which the system has entries of order one.

    The unit of length is the beam's, or 1/(2 pi) of the bending wavelength if that is shorter.
    """
    bending, capacitance = abs(part.bending), abs(part.capacitance)
    size = min(length, (bending / (part.mass * omega**2)) ** 0.25)
    voltage = sqrt(bending / capacitance) / size
    charge = sqrt(bending * capacitance)
    motion = [1j * omega * size, 1j * omega]
    return np.array(
        [*motion, bending / size, bending / size**2, voltage, 1j * omega * charge], complex
    )


def matrix_exponential(
    beam: Beam,
    length: float,
    frequency: float,
    axial_force: float = 0.0,
    *,
    digits: int | None = None,
) -> Complex:
    """Return the 5 x 5 matrix from [v, psi_dot, M, F, U] at one end to [v, psi_dot, M, F, I].

    M and F are the bending moment and shear force in the beam, U is the voltage and I the
    current of this length alone (without the clamped part). The frequency must not be zero.
    With ``digits`` the exponential is found in that many decimal digits, by mpmath: slow, but
    then each entry is good by itself and not only in proportion to the largest.
    """
    omega, part = 2 * pi * frequency, section(beam)
    unit = units(part, omega, length)
    exponent = generator(part, omega, axial_force) * length * unit / unit[:, None]
    if digits is None:
        power: Complex = scipy.linalg.expm(exponent)
    else:
        mpmath = importlib.import_module("mpmath")  # only here, so that it stays optional
        with mpmath.workdps(digits):
            power = np.array(mpmath.expm(mpmath.matrix(exponent.tolist())).tolist(), complex)
    full: Complex = power * unit[:, None] / unit
    return full[np.ix_([0, 1, 2, 3, 5], [0, 1, 2, 3, 4])]


def scaled(matrix: ArrayLike, beam: Beam, frequency: float, length: float) -> Complex:
    """Bring a 5 x 5 transfer matrix to dimensionless entries of comparable size.

    In SI units a norm would see nothing but the largest entry, such as velocity per newton.
    Compare two matrices by ``norm(scaled(a, ...) - scaled(b, ...)) / norm(scaled(b, ...))``.
    """
    unit = units(section(beam), 2 * pi * frequency, length)
    result: Complex = np.asarray(matrix, complex) * unit[:5] / unit[[0, 1, 2, 3, 5]][:, None]
    return result
