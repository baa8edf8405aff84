"""The plant of self-sensing's figures, against the finite elements that it is made of.

`reference_beam` solves the loaded beam at each frequency; the plant has two of its modes and steps
through time. In the loaded plant tanθ is left out, which makes 0.57° of phase.
"""

from __future__ import annotations

import numpy as np
import pytest
from reference_beam import HIGH_FINGER, LOW_FINGER, Beam, Load, response

from benchmarks.sensing_plant import (
    RELAXATIONS,
    Converter,
    Fingers,
    PlantTolerances,
    SensingPlant,
    debye,
)
from tactile.arrays import Complex

RATE = 8000.0
SINES = np.arange(10.0, 1001.0, 90.0)
"""Frequencies [Hz], whole multiples of 10, so that 0.1 s holds whole periods."""
ALL = np.ones(len(SINES))
EXACT = Converter(range=1.0, bits=40, noise=0.0)

each_finger = pytest.mark.parametrize("load", [LOW_FINGER, HIGH_FINGER])


def plant_under(load: Load) -> SensingPlant:
    """Return a plant of one contactor per frequency, as designed, under the same load."""
    k0, d0, ((k1, d1),) = load
    loads = Fingers(k0 * ALL, d0 * ALL, k1 * ALL, d1 * ALL)
    return SensingPlant(loads, PlantTolerances.none(len(SINES)), converter=EXACT, sample_rate=RATE)


def departure(ratio: Complex) -> tuple[float, float]:
    """Return the largest departure of a ratio from one in dB and degrees."""
    decibels = 20 * np.log10(np.abs(ratio))
    return float(np.abs(decibels).max()), float(np.degrees(np.abs(np.angle(ratio))).max())


def sinusoids(plant: SensingPlant, seconds: float = 0.4) -> tuple[Complex, Complex]:
    """Return shear and current per volt at `SINES`, one contactor each, once settled."""
    k = np.arange(round(seconds * RATE))
    shear, current = plant.step(np.cos(2 * np.pi * np.outer(k / RATE, SINES)))
    turn = 2 * np.exp(-2j * np.pi * np.outer((k - plant.delay) / RATE, SINES))[-800:]
    return np.asarray((shear[-800:] * turn).mean(0)), np.asarray((current[-800:] * turn).mean(0))


@each_finger
@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_modes_give_the_response_of_all_elements(load: Load, scale: float) -> None:
    """Compare shear per volt in the frequency domain, under a finger and in air."""
    own = np.diagonal(plant_under(load).response(SINES, scale * ALL))
    reference = response(Beam(), SINES, load=load if scale else None).displacement
    decibels, degrees = departure(own / reference)
    assert decibels < 0.05
    assert degrees < 0.7


@pytest.mark.ci
@each_finger
def test_steps_in_time_give_the_response_over_frequency(load: Load) -> None:
    """Compare settled sinusoids with the closed form of the same modes, shear and current."""
    plant = plant_under(load)
    shear, current = sinusoids(plant)
    decibels, degrees = departure(shear / np.diagonal(plant.response(SINES, ALL)))
    assert decibels < 0.01
    assert degrees < 0.1
    admittance = np.diagonal(plant.admittance(SINES, ALL))
    assert np.abs(current / admittance - 1).max() < 3e-3


def test_blocks_of_any_size_give_the_same() -> None:
    """Divide a drive into blocks while the load changes."""
    rng = np.random.default_rng(0)
    drive = rng.standard_normal((300, len(SINES)))
    scale = np.repeat(np.linspace(0, 1, 300)[:, None], len(SINES), axis=1)
    whole = plant_under(LOW_FINGER).step(drive, scale)
    plant = plant_under(LOW_FINGER)
    parts = [plant.step(drive[a:b], scale[a:b]) for a, b in ((0, 1), (1, 90), (90, 300))]
    for side in (0, 1):
        np.testing.assert_allclose(
            np.concatenate([part[side] for part in parts]), whole[side], rtol=1e-9, atol=2e-12
        )


def test_static_load_shears_by_its_stiffness() -> None:
    """Compare the end of a step with the static response of the finite elements."""
    plant = plant_under(LOW_FINGER)
    shear, _ = plant.step(np.full((2400, len(SINES)), 10.0))
    static = response(Beam(), [0.0], load=LOW_FINGER).displacement[0].real
    np.testing.assert_allclose(shear[-1], 10 * static, rtol=1e-3)


def test_a_finger_that_returns_begins_without_force() -> None:
    """Let the finger leave and return to a bent tip, which must stay where it is."""
    plant = plant_under(HIGH_FINGER)
    held = np.full((2400, len(SINES)), 10.0)  # free vibration decays by 50/s
    plant.step(held, 0 * held)
    held = held[:400]
    air, _ = plant.step(held, 0 * held)
    touched, _ = plant.step(held, np.ones_like(held))
    np.testing.assert_allclose(touched[-1], air[-1], rtol=1e-3)


def test_dielectric_is_causal() -> None:
    """Compare the fall of the capacitance per decade with that which Kramers and Kronig demand."""
    frequency = np.array([30.0, 300.0])
    epsilon = 1 + debye(0.02) @ (1 / (1 + 1j * frequency / RELAXATIONS[:, None]))
    assert epsilon[0].imag / epsilon[0].real == pytest.approx(-0.02, rel=0.02)
    # dε'/d ln f = −(2/π) ε'' for a nearly constant loss tangent
    fall = 1 - epsilon[1].real / epsilon[0].real
    assert fall == pytest.approx(2 / np.pi * 0.02 * np.log(10), rel=0.05)


def test_converter_rounds_and_clips() -> None:
    """Drive a large step into a small range."""
    loads = Fingers(*np.ones((4, 1)))
    converter = Converter(range=1e-3, bits=12, noise=0.0)
    plant = SensingPlant(loads, PlantTolerances.none(1), converter=converter, sample_rate=RATE)
    _, current = plant.step(np.repeat([[0.0], [90.0]], 100, axis=0))
    assert current.max() == converter.step * 2047
    np.testing.assert_allclose(current / converter.step, np.rint(current / converter.step))
