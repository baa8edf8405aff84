"""Checks that the two references of ``reference_beam`` can be trusted as yardsticks.

The finite-element beam and the matrix exponential share no method, so their agreement is strong
evidence for both. Further tests compare them with the figures printed on the design page and
with textbook cases that have a solution in closed form. Nothing here touches the product's code.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_beam import (
    HIGH_FINGER,
    LOW_FINGER,
    Beam,
    Load,
    Response,
    dynamic_stiffness,
    electric,
    lossless,
    matrix_exponential,
    natural_frequencies,
    response,
    scaled,
    section,
)
from scipy.optimize import brentq

from tactile.arrays import Complex

BEAM = Beam()
FREQUENCIES = np.array([1.0, 30.0, 300.0, 930.0, 1000.0, 3000.0, 5000.0, 5783.0, 20000.0])
WALL: Load = (1e12, 0.0, ())
"""A spring so stiff that it blocks the tip: about 10^9 times the beam's own stiffness."""


def figures(result: Response) -> Complex:
    """Return all of a response in one array."""
    return np.array(
        [result.displacement, result.rotation, result.admittance, result.at_point], complex
    )


def difference(one: Complex, other: Complex) -> float:
    """Return the largest relative difference."""
    return float(np.max(np.abs(one / other - 1)))


def through_exponentials(
    chain: list[tuple[Beam, float]],
    frequency: float,
    load: Load | None,
    axial_force: float,
    rotational_load: Load | None = None,
) -> Complex:
    """Return displacement, rotation and current of the tip, per volt, from exponentials.

    The state of a section's end is linear in M and F at the clamp and in the voltage: three
    columns. The free or loaded tip then gives M and F.
    """
    omega = 2 * np.pi * frequency
    state = np.zeros((5, 3), complex)
    state[2, 0] = state[3, 1] = state[4, 2] = 1
    current = np.zeros(3, complex)
    for beam, length in chain:
        following = matrix_exponential(beam, length, frequency, axial_force) @ state
        current = current + following[4]
        state = np.vstack((following[:4], state[4]))
    skin = dynamic_stiffness(load, omega) / (1j * omega)
    twist = dynamic_stiffness(rotational_load, omega) / (1j * omega)
    tip = np.array([state[2] + twist * state[1], state[3] + skin * state[0]])
    clamp = np.append(np.linalg.solve(tip[:, :2], -tip[:, 2]), 1)
    velocity, turning = state[:2] @ clamp
    return np.array([velocity / (1j * omega), turning / (1j * omega), current @ clamp], complex)


def test_resonances_are_the_printed_ones() -> None:
    """The page prints 930 Hz and 5783 Hz; the loss moves the peaks by far less than 1 Hz."""
    assert natural_frequencies(BEAM, 2) == pytest.approx([930, 5783], abs=0.5)
    sweep = np.arange(900.0, 961.0)
    assert sweep[np.argmax(np.abs(response(BEAM, sweep).displacement))] == 930


@pytest.mark.parametrize(
    ("load", "printed", "digit"),
    [(None, 0.931, 0.0005), (LOW_FINGER, 0.56, 0.005), (HIGH_FINGER, 0.245, 0.0005)],
)
def test_static_displacement_is_the_printed_one(
    load: Load | None, printed: float, digit: float
) -> None:
    """One volt moves the tip by the printed micrometers in air and under both fingers."""
    moved = response(BEAM, 0, load=load).displacement[0].real
    assert moved * 1e6 == pytest.approx(printed, abs=digit)


def test_blocked_force_and_tip_stiffness_are_the_printed_ones() -> None:
    """A wall takes 1.43 mN/V; a known spring in place of the wall reveals 1535 N/m."""
    blocked = response(BEAM, 0, load=WALL).force[0]
    free = response(BEAM, 0).displacement[0]
    held = response(BEAM, 0, load=(1000.0, 0.0, ())).displacement[0]
    stiffness = 1000 * held / (free - held)
    assert blocked.real * 1e3 == pytest.approx(1.43, abs=0.005)
    assert stiffness.real == pytest.approx(1535, abs=0.5)
    assert abs(stiffness * free / blocked - 1) < 1e-8


def test_capacitances_are_the_printed_ones() -> None:
    """12.8 nF with a free tip; 11.0 nF once neither displacement nor rotation is possible."""
    slow = 2j * np.pi * 1.0
    free = response(BEAM, 1).admittance[0] / slow
    clamped = response(BEAM, 1, load=WALL, rotational_load=WALL).admittance[0] / slow
    assert free.real * 1e9 == pytest.approx(12.8, abs=0.05)
    assert clamped.real * 1e9 == pytest.approx(11.0, abs=0.05)
    layers = electric(BEAM)[1] * (BEAM.length + BEAM.clamped_length)
    assert abs(clamped / layers - 1) < 1e-8


@pytest.mark.parametrize("length", [5e-3, 20e-3, 45e-3])
def test_finer_elements_change_nothing(length: float) -> None:
    """Twice as many elements of a higher order agree to 1e-8 from 1 Hz to 20 kHz."""
    beam = replace(BEAM, length=length)
    usual = figures(response(beam, FREQUENCIES, point=0.7 * length))
    finer = figures(response(beam, FREQUENCIES, point=0.7 * length, segments=12, order=13))
    assert difference(usual, finer) < 1e-8


def test_error_falls_exponentially_with_the_order() -> None:
    """Two elements at 5 kHz: each two orders more gain at least a factor of 30."""
    exact = figures(response(BEAM, 5000.0))
    errors = [
        difference(figures(response(BEAM, 5000.0, segments=2, order=order)), exact)
        for order in (3, 5, 7, 9)
    ]
    gains = np.divide(errors[:-1], errors[1:])
    assert np.all(gains > 30)
    assert errors[-1] < 1e-8


@pytest.mark.parametrize("load", [None, LOW_FINGER, HIGH_FINGER])
@pytest.mark.parametrize("axial_force", [0.0, 5.0, -5.0])
def test_finite_elements_agree_with_the_exponential(load: Load | None, axial_force: float) -> None:
    """Two methods, one answer: displacement, rotation and current to 1e-9."""
    result = response(
        replace(BEAM, clamped_length=0.0), FREQUENCIES, load=load, axial_force=axial_force
    )
    other = [through_exponentials([(BEAM, 20e-3)], f, load, axial_force) for f in FREQUENCIES]
    assert difference(figures(result)[:3], np.array(other).T) < 1e-9


def test_chain_of_different_sections_agrees_with_exponentials() -> None:
    """Three sections with layers of their own, driven in parallel, tip under a finger."""
    thin = replace(BEAM, piezo_height=0.15e-3, shim_height=0.1e-3)
    parts = [(BEAM, 8e-3), (thin, 5e-3), (replace(BEAM, shim_height=0.4e-3), 9e-3)]
    result = response(
        replace(BEAM, clamped_length=0.0),
        FREQUENCIES,
        load=LOW_FINGER,
        axial_force=-1.0,
        chain=[(beam, length, True) for beam, length in parts],
    )
    other = [through_exponentials(parts, f, LOW_FINGER, -1.0) for f in FREQUENCIES]
    assert difference(figures(result)[:3], np.array(other).T) < 1e-9


def test_rotational_load_agrees_with_the_exponential() -> None:
    """A spring, damper and pair which hold the tip's rotation, besides a finger."""
    twist = (0.2, 1e-5, ((0.4, 3e-5),))
    result = response(
        replace(BEAM, clamped_length=0.0), FREQUENCIES, load=HIGH_FINGER, rotational_load=twist
    )
    other = [through_exponentials([(BEAM, 20e-3)], f, HIGH_FINGER, 0.0, twist) for f in FREQUENCIES]
    assert difference(figures(result)[:3], np.array(other).T) < 1e-9


def test_natural_frequencies_are_zeros_of_the_exponential() -> None:
    """Free vibration needs M = F = 0 at the tip for some M and F at the clamp."""
    beam = lossless(BEAM)

    def determinant(frequency: float) -> float:
        matrix = scaled(matrix_exponential(beam, 20e-3, frequency), beam, frequency, 20e-3)
        return float(np.linalg.det(matrix[2:4, 2:4]).real)

    for found in natural_frequencies(BEAM, 4):
        root = brentq(determinant, found * 0.99, found * 1.01, xtol=1e-9, rtol=1e-13)
        assert found == pytest.approx(root, rel=1e-9)


def test_slender_beam_has_the_textbook_frequencies() -> None:
    """The (beta l)^2 of a cantilever without shear and rotary inertia is 3.5160, 22.034, 61.697."""
    slender = replace(BEAM, length=1.0, s55E=44e-15, shim_s55=1 / 4.5e12)
    part = section(lossless(slender))
    unit = np.sqrt(part.bending.real / part.mass) / (2 * np.pi)
    textbook = np.array([3.51601527, 22.0344916, 61.6972144])
    assert natural_frequencies(slender, 3) == pytest.approx(textbook * unit, rel=2e-5)


def test_shimless_bimorph_deflects_by_the_textbook_formula() -> None:
    """A static two-layer bimorph moves by 3 |d31| l^2 U / (4 h^2), toward +z for d31 < 0."""
    bare = replace(lossless(BEAM), shim_height=0.0)
    expected = -3 * bare.d31 * bare.length**2 / (4 * bare.piezo_height**2)
    assert response(bare, 0).displacement[0] == pytest.approx(expected, rel=1e-9)


def test_losses_turn_the_phases_as_printed() -> None:
    """One material alone makes d lag by tan theta and the stiffness lead by 1/Q."""
    bare = replace(BEAM, shim_height=0.0)
    moved, still = (response(beam, 0).displacement[0] for beam in (bare, lossless(bare)))
    assert moved / still == pytest.approx(1 - 0.01j, rel=1e-9)
    lossy, elastic = (response(beam, 0, load=WALL).force[0] for beam in (bare, lossless(bare)))
    assert lossy / elastic == pytest.approx((1 - 0.01j) * (1 + 1j / 60), rel=1e-8)


def test_finger_is_soft_when_slow_and_stiff_when_fast() -> None:
    """A pair is a damper when slow, a spring when fast and k (1 + j)/2 at omega = k/d."""
    pair: Load = (0.0, 0.0, ((1300.0, 0.33),))
    assert dynamic_stiffness(pair, 1300 / 0.33) == pytest.approx(650 + 650j)
    slow, fast = dynamic_stiffness(LOW_FINGER, 1e-3), dynamic_stiffness(LOW_FINGER, 1e9)
    assert slow == pytest.approx(1000 + 1e-3j * (0.11 + 0.33))
    assert fast == pytest.approx(2300 + 1e9j * 0.11)
    assert dynamic_stiffness(LOW_FINGER, 0.0) == 1000


@pytest.mark.parametrize(
    ("load", "shaping", "volts"), [(None, 34, 11), (LOW_FINGER, 1.7, 20), (HIGH_FINGER, 5.4, 76)]
)
def test_equalizing_takes_the_printed_shaping(
    load: Load | None, shaping: float, volts: float
) -> None:
    """Decibels and volts that a flat 10 micrometers from 10 to 1000 Hz take (11 V: not printed)."""
    moved = np.abs(response(BEAM, np.arange(10.0, 1001.0, 10.0), load=load).displacement)
    spread = 20 * np.log10(np.max(moved) / np.min(moved))
    assert spread == pytest.approx(shaping, abs=0.5 if load is None else 0.05)
    assert 10e-6 / np.min(moved) == pytest.approx(volts, abs=0.5)


def test_point_lies_on_the_static_parabola() -> None:
    """The static moment without load is constant, so u(x) = u(l) (x/l)^2 at any x."""
    tip = response(BEAM, 0).displacement[0]
    for share in (0.0, 0.1, 1 / 3, 0.5, 0.95, 1.0):
        at = response(BEAM, 0, point=share * BEAM.length).at_point[0]
        assert abs(at - tip * share**2) < 1e-9 * abs(tip)
    with pytest.raises(ValueError, match="not on the beam"):
        response(BEAM, 0, point=0.021)


@pytest.mark.parametrize("axial_force", [5.0, -5.0])
def test_axial_force_acts_as_in_the_static_closed_form(axial_force: float) -> None:
    """The page's EI psi'' = N psi, with F = 0, gives sinh (tension) or sin (compression)."""
    part = section(BEAM)
    wave = np.sqrt(complex(axial_force) / part.bending)
    reach = wave * BEAM.length
    turn = part.coupling / part.bending * np.sinh(reach) / (wave * np.cosh(reach))
    move = -turn * (np.cosh(reach) - 1) / (wave * np.sinh(reach))
    result = response(BEAM, 0, axial_force=axial_force)
    assert abs(result.rotation[0] / turn - 1) < 1e-9
    assert abs(result.displacement[0] / move - 1) < 1e-9


def test_cutting_a_beam_into_sections_changes_nothing() -> None:
    """A chain of equal sections is the beam itself, and its measuring point stays in place."""
    whole = response(BEAM, FREQUENCIES, load=HIGH_FINGER, point=9e-3)
    cut = response(
        BEAM,
        FREQUENCIES,
        load=HIGH_FINGER,
        point=9e-3,
        chain=[(BEAM, 6e-3, True), (BEAM, 14e-3, True)],
    )
    assert difference(figures(whole), figures(cut)) < 1e-8


def test_passive_extension_goes_on_straight() -> None:
    """A section without voltage carries the static slope on, and draws no current."""
    alone = response(BEAM, 1e-3)
    longer = response(BEAM, 1e-3, chain=[(BEAM, 20e-3, True), (BEAM, 7e-3, False)])
    straight = alone.displacement - 7e-3 * alone.rotation
    assert abs(longer.displacement / straight - 1) < 1e-9
    assert abs(longer.admittance / alone.admittance - 1) < 1e-9


@pytest.mark.parametrize("load", [None, LOW_FINGER, WALL])
def test_bimorph_never_gives_power_away(load: Load | None) -> None:
    """The conductance with the page's signs of the losses is positive at every frequency."""
    frequencies = np.geomspace(1, 20e3, 60)
    assert np.all(response(BEAM, frequencies, load=load).admittance.real > 0)


@pytest.mark.parametrize("length", [5e-3, 45e-3])
@pytest.mark.parametrize("axial_force", [0.0, -5.0])
def test_exponential_is_good_to_twelve_digits(length: float, axial_force: float) -> None:
    """The scaled double-precision exponential equals the one found with 40 digits."""
    for frequency in (0.1, 1e3, 60e3):
        quick = matrix_exponential(BEAM, length, frequency, axial_force)
        exact = matrix_exponential(BEAM, length, frequency, axial_force, digits=40)
        quick, exact = (scaled(m, BEAM, frequency, length) for m in (quick, exact))
        assert np.linalg.norm(quick - exact) < 1e-12 * np.linalg.norm(exact)


def test_scaled_entries_are_dimensionless() -> None:
    """Halving every size at twice the frequency leaves the scaled matrix as it was."""
    small = replace(BEAM, width=1.05e-3, piezo_height=0.13e-3, shim_height=0.1e-3)
    large_matrix = scaled(matrix_exponential(BEAM, 20e-3, 800.0), BEAM, 800.0, 20e-3)
    small_matrix = scaled(matrix_exponential(small, 10e-3, 1600.0), small, 1600.0, 10e-3)
    assert np.allclose(large_matrix, small_matrix, rtol=1e-10, atol=0)
    assert 0.1 < np.min(np.abs(large_matrix)) < np.max(np.abs(large_matrix)) < 10
