"""The transfer matrix of one segment of bimorph, against methods that share no code with it.

The yardsticks are the matrix exponential of `reference_beam`, mpmath with 50 digits, and what
every reciprocal beam must satisfy. `Beam()` there and `Bimorph()` here are the same default design.
"""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference_beam import Beam, lossless, matrix_exponential, scaled
from reference_beam import section as reference_section
from scipy.optimize import brentq

from tactile.actuator.beam import CrossSection, c_functions, transition
from tactile.actuator.bimorph import (
    Bimorph,
    active_segment,
    passive_segment,
    section,
    transfer_matrix,
)
from tactile.arrays import Complex

FREQUENCIES = np.geomspace(0.1, 60e3, 13)
LENGTHS = [5e-3, 20e-3, 45e-3]
AXIAL_FORCES = [0.0, 5.0, -5.0]
EPSILON = float(np.finfo(float).eps)
PAIRING = np.zeros((4, 4))
"""S with xᵀ S y = v F' + ψ̇ M' − F v' − M ψ̇', what reciprocity keeps along a passive beam."""
PAIRING[0, 3] = PAIRING[1, 2] = 1
PAIRING[2, 1] = PAIRING[3, 0] = -1


def pair(**changes: Any) -> tuple[Beam, Bimorph]:
    """Return the same geometry for the reference and for the code under test."""
    return replace(Beam(), **changes), replace(Bimorph(), **changes)


def undamped() -> tuple[Beam, Bimorph]:
    """Return the default design without its losses."""
    design = Bimorph()
    piezo = replace(design.piezo, quality_factor=np.inf, loss_tangent=0.0, piezo_loss_tangent=0.0)
    shim = replace(design.shim, quality_factor=np.inf)
    return lossless(Beam()), replace(design, piezo=piezo, shim=shim)


def distance(beam: Beam, design: Bimorph, frequency: float, axial_force: float = 0.0) -> float:
    """Return the distance of both matrices in the scaled norm, relative."""
    length = beam.length
    matrix = transfer_matrix(active_segment(design), [frequency], axial_force=axial_force)[0]
    found = scaled(matrix, beam, frequency, length)
    other = matrix_exponential(beam, length, frequency, axial_force)
    exact = scaled(other, beam, frequency, length)
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def scaled_matrices(length: float, axial_force: float, largest: float) -> list[Complex]:
    """Return the scaled matrices whose norm leaves a double some digits of their products."""
    beam, design = pair(length=length)
    all_ = transfer_matrix(active_segment(design), FREQUENCIES, axial_force=axial_force)
    matrices = [scaled(T, beam, f, length) for T, f in zip(all_, FREQUENCIES, strict=True)]
    kept = [T for T in matrices if np.linalg.norm(T) < largest]
    assert len(kept) > 6
    return kept


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("axial_force", AXIAL_FORCES)
def test_transfer_matrix_equals_the_matrix_exponential(length: float, axial_force: float) -> None:
    """0.1 Hz to 60 kHz; 1e-9 is asked for, 2e-13 measured, 1e-11 leaves room for other CPUs."""
    beam, design = pair(length=length)
    assert max(distance(beam, design, f, axial_force) for f in FREQUENCIES) < 1e-11


@pytest.mark.parametrize(
    ("length", "frequency", "axial_force"),
    [(5e-3, 0.1, 0.0), (20e-3, 0.1, -5.0), (20e-3, 930.0, 0.0), (45e-3, 5e3, 5.0)],
)
def test_each_entry_is_right_by_itself(length: float, frequency: float, axial_force: float) -> None:
    """Each is compared with 40 digits by itself, so that no small one hides (1e-11).

    Not row I and column U: they hold K (T − 1), which loses what T has in common with 1.
    """
    beam, design = pair(length=length)
    found = transfer_matrix(active_segment(design), [frequency], axial_force=axial_force)[0]
    exact = matrix_exponential(beam, length, frequency, axial_force, digits=40)
    assert np.max(np.abs(found[:4, :4] / exact[:4, :4] - 1)) < 1e-11


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("axial_force", AXIAL_FORCES)
def test_matrix_is_reciprocal(length: float, axial_force: float) -> None:
    """Two states of one segment obey the reciprocity theorem, voltage and current included.

    Integrated along the segment, the balances of two states of equal ω (the second primed) leave
    v F' + ψ̇ M' − F v' − M ψ̇', end less start, equal to U I' − I U'.
    """
    for T in scaled_matrices(length, axial_force, 1e4):
        mechanical = T[:4].T @ PAIRING @ T[:4]
        mechanical[:4, :4] -= PAIRING
        electrical = np.zeros((5, 5), complex)
        electrical[4] = T[4]
        limit = 10 * EPSILON * float(np.linalg.norm(T)) ** 2
        assert np.linalg.norm(mechanical - (electrical - electrical.T)) < limit


def test_passive_segment_is_the_mechanical_part_alone() -> None:
    """The same layers without drive: same 4 × 4 block, and nothing electrical at all."""
    design = Bimorph(length=11e-3)
    active = transfer_matrix(active_segment(design), FREQUENCIES)
    passive = transfer_matrix(passive_segment(design, 11e-3), FREQUENCIES)
    assert np.array_equal(passive[:, :4, :4], active[:, :4, :4])
    assert not passive[:, 4].any()
    assert not passive[:, :, 4].any()


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.83])
def test_cut_parts_multiply_to_the_whole(fraction: float) -> None:
    """Currents add, voltage is common; rounding grows with the norms of both parts (1e-10)."""
    beam, design = pair()
    whole = active_segment(design)
    first, second = (transfer_matrix(s, FREQUENCIES) for s in whole.cut(fraction))
    carried = first.copy()
    carried[:, 4] = [0, 0, 0, 0, 1]  # the voltage stays, where the matrix gives a current
    product = second @ carried
    product[:, 4] += first[:, 4]
    for found, exact, f in zip(
        product, transfer_matrix(whole, FREQUENCIES), FREQUENCIES, strict=True
    ):
        a, b = (scaled(T, beam, f, beam.length) for T in (found, exact))
        assert np.linalg.norm(a - b) < 1e-10 * np.linalg.norm(b)


def test_cross_section_constants_are_the_printed_integrals() -> None:
    """The reference sums EI, AG, m and ρI of the page's formulas in another way (1e-14)."""
    found, exact = section(Bimorph()), reference_section(Beam())
    pairs = [
        (found.EI, exact.bending),
        (found.AG, exact.shear),
        (found.m, exact.mass),
        (found.rhoI, exact.inertia),
    ]
    assert all(abs(a / b - 1) < 1e-14 for a, b in pairs)


def test_stiffening_adds_the_printed_bending_stiffness() -> None:
    """ΔEI = w h_p³/6 · (1/s11E) · k31²/(1−k31²), with the loss of the piezo layers."""
    plain, stiff = (section(Bimorph(layer_stiffening=flag)) for flag in (False, True))
    k2 = 320e-12**2 / (16.2e-12 * 3800 * 8.8541878128e-12)
    added = 2.1e-3 * 0.26e-3**3 / 6 / 16.2e-12 * k2 / (1 - k2) * (1 + 1j / 60)
    assert (stiff.EI - plain.EI) / added == pytest.approx(1, rel=1e-12)
    assert (stiff.AG, stiff.m, stiff.rhoI) == (plain.AG, plain.m, plain.rhoI)


def exact_c(z1: complex, z2: complex) -> list[complex]:
    """Return the page's c0…c3 with 50 digits."""
    mp = importlib.import_module("mpmath")
    with mp.workdps(50):
        x, y = mp.mpmathify(complex(z1)), mp.mpmathify(complex(z2))
        a, b = mp.sqrt(x), mp.sqrt(-y)
        sinh, sin = mp.sinh(a) / a if a else mp.mpf(1), mp.sin(b) / b if b else mp.mpf(1)
        cosh, cos, scale = mp.cosh(a), mp.cos(b), x - y
        numerators = x * cos - y * cosh, x * sin - y * sinh, cosh - cos, sinh - sin
        return [complex(n / scale) for n in numerators]


ROOTS = [
    (1e-9, -1e-9),  # the series, where the closed form would have lost all
    (0.25, -0.2499),
    (99.9, -99.9),  # either side of where the closed form takes over
    (99.9, -101),
    (100.1, -100.1),
    (0.1 + 0.01j, -99),  # the series, where strong compression makes its terms alternate
    (12.4 + 0.2j, -12.4 - 0.2j),  # the default beam at its first resonance
    (1e-8 + 1e-9j, -0.5),  # slow, in strong compression
    (190 + 6j, -230 - 7j),  # 60 kHz
    (-1e-9, -900.0),  # λ1 just imaginary
    (-40 + 1j, -900 - 20j),  # far above √(AG/ρI)
]


@pytest.mark.parametrize(("z1", "z2"), ROOTS)
def test_c_functions_have_all_their_digits(z1: complex, z2: complex) -> None:
    """λ1 is real or imaginary, in series or closed form, and 450 epsilon are allowed."""
    found = c_functions(np.array([z1 + z2], np.complex128), np.array([z1 * z2], np.complex128))
    limit = 1e-13
    for a, b in zip(found, exact_c(z1, z2), strict=True):
        assert abs(a[0] - b) < limit * abs(b)


@pytest.mark.parametrize("z2", [-0.5, -900.0])
def test_c_functions_pass_through_zero(z2: float) -> None:
    """λ1 = 0: the static beam in strong compression, and √(AG/ρI) of a lossless one."""
    found = c_functions(np.array([z2], complex), np.zeros(1, complex))
    assert np.allclose([c[0] for c in found], exact_c(0, z2), rtol=1e-13)


@pytest.mark.parametrize("length", [1e-3, 2e-3, 5e-3])
def test_matrix_passes_where_lambda1_turns_imaginary(length: float) -> None:
    """Frequencies lie about 1 MHz, from 0.1 to 3 times √(AG/ρI), with and without losses.

    Very close to it a lossless beam has λ1 → 0 and may lose epsilon/λ1: 1e-9 to within 1e-9 of it.
    """
    for beam, design in (pair(), undamped()):
        part = reference_section(beam)
        critical = float(np.sqrt(part.shear.real / part.inertia)) / (2 * np.pi)
        assert 0.9e6 < critical < 1.2e6
        own, same = replace(beam, length=length), replace(design, length=length)
        for ratio in (0.1, 0.9, 1 - 1e-6, 1 - 1e-9, 1 + 1e-9, 1 + 1e-6, 1.1, 3.0):
            assert distance(own, same, critical * ratio) < 1e-9


def test_without_shear_and_rotary_inertia_it_is_euler_and_bernoulli() -> None:
    """A clamped-free beam rings where cos q cosh q = −1: q = 1.8751, 4.6941, 7.8548, 10.9955.

    AG = 1e12 EI/l² and ρI = 0 leave σ = 1e-12 ω²; the roots are found to 1e-9.
    """
    beam = CrossSection(np.array(1.0 + 0j), np.array(1e12 + 0j), np.array(1.0), np.array(0.0))

    def free_tip(q: float) -> float:
        """Return the determinant of (M, F) at the tip from (M, F) at the clamp."""
        t = transition(beam, np.array(1.0), np.array([q**2]), np.zeros(1))
        return float((t.ff[0][0] * t.ff[1][1] - t.ff[0][1] * t.ff[1][0]).real[0])

    for near in (1.8751, 4.6941, 7.8548, 10.9955):
        low, high = near - 0.1, near + 0.1
        textbook = brentq(lambda q: np.cos(q) * np.cosh(q) + 1, low, high, xtol=1e-14)
        assert brentq(free_tip, low, high, xtol=1e-13) == pytest.approx(textbook, rel=1e-9)
