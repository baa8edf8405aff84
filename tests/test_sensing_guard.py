"""Filters of guards, against the finite-element plant that shares no code with them."""

import numpy as np
import pytest
from sensing_rig import exact_baseline, random_loads, tolerant_plant

from benchmarks.sensing_guard import GuardedLoop
from benchmarks.sensing_loop import RATE, draw_case, steady, swinging
from benchmarks.sensing_plant import Converter, SensingPlant
from firmware_protocol import guard
from firmware_protocol.messages import GuardReason
from tactile.arrays import Complex, Floats
from tactile.sensing.excitation import TONES
from tactile.sensing.guard import OLDER, TAPS, GuardDesign, GuardFilters

COUNT = 12
NOISE = 1e-6


@pytest.fixture(scope="module")
def loads() -> Floats:
    return random_loads(COUNT, seed=4)


@pytest.fixture(scope="module")
def plant(loads: Floats) -> SensingPlant:
    return tolerant_plant(loads)


@pytest.fixture(scope="module")
def filters(plant: SensingPlant, loads: Floats) -> GuardFilters:
    design = GuardDesign(exact_baseline(plant), RATE, noise=NOISE)
    return design.filters(loads, np.zeros(COUNT))


def residual(filters: GuardFilters, admittance: Complex, frequency: Floats) -> Complex:
    """Return the residual (N, F) of contactors that draw a current, per volt."""
    z = np.exp(-2j * np.pi * frequency / RATE)
    steps = z ** np.arange(TAPS)[:, None] * (1 - z)
    earlier = 1 + filters.poles @ np.stack([z, z**2])
    return np.asarray(admittance * z**OLDER * earlier - filters.drive @ steps)


def test_a_finger_leaves_a_small_residual_and_air_a_large_one(
    filters: GuardFilters, plant: SensingPlant
) -> None:
    """The residual is below 2 % of the current from 20 Hz up; without a finger, 20 % at 920 Hz."""
    frequency = np.geomspace(20, 1900, 60)
    touched, air = (plant.admittance(frequency, np.full(COUNT, s)) for s in (1.0, 0.0))
    kept = np.abs(residual(filters, touched, frequency) / touched)
    assert kept.max() < 0.02
    near = np.array([920.0])
    free = plant.admittance(near, np.zeros(COUNT))
    assert np.abs(residual(filters, free, near) / free).min() > 0.2
    assert air.shape == touched.shape


def test_what_is_above_the_band_leaves_little_more_than_the_current(
    filters: GuardFilters, plant: SensingPlant
) -> None:
    """Jumps and clicks reach there. Filters that were free above left 14 times the current."""
    frequency = np.linspace(2000, 3600, 60)
    touched = plant.admittance(frequency, np.ones(COUNT))
    assert np.abs(residual(filters, touched, frequency) / touched).max() < 1.5


def test_the_change_is_what_a_lost_finger_adds_in_the_band_of_the_pilot(
    filters: GuardFilters, plant: SensingPlant
) -> None:
    """The change is within 15 % the residual in air at the pilot, and a 30th below 300 Hz."""
    tones = np.array(TONES)
    air = residual(filters, plant.admittance(tones, np.zeros(COUNT)), tones)

    def change(frequency: Floats) -> Complex:
        z = np.exp(-2j * np.pi * frequency / RATE)
        return np.asarray(filters.change @ (z ** np.arange(TAPS)[:, None] * (1 - z)))

    apart = np.linalg.norm(change(tones) - air, axis=1) / np.linalg.norm(air, axis=1)
    assert apart.max() < 0.15
    slow = np.abs(change(np.geomspace(10, 300, 20))).max(axis=1)
    assert np.all(slow < np.abs(change(tones)).max(axis=1) / 30)


def test_a_larger_capacitance_is_expected_to_draw_more(plant: SensingPlant, loads: Floats) -> None:
    """The residual is the same with 5 % more capacitance than in the calibration."""
    design = GuardDesign(exact_baseline(plant), RATE, noise=NOISE)
    warm = design.filters(loads, np.full(COUNT, np.log(1.05)))
    frequency = np.geomspace(20, 1900, 60)
    electrical = plant.tip.capacitance
    plant.tip.capacitance = 1.05 * electrical
    touched = plant.admittance(frequency, np.ones(COUNT))
    plant.tip.capacitance = electrical
    assert np.abs(residual(warm, touched, frequency) / touched).max() < 0.02


def test_encoded_filters_are_within_their_rounding(filters: GuardFilters) -> None:
    """Entries give back the filters; limits are rounded up."""
    amperes, volts = 2.5e-3 / 32767, 100 / 32767
    entries = guard.encode(
        np.ones(COUNT, np.int64), poles=filters.poles, drive=filters.drive * volts / amperes,
        change=filters.change * volts / amperes, limit=filters.limit / amperes,
        share=np.full(COUNT, filters.share), floor=filters.floor / amperes**2,
    )  # fmt: skip
    np.testing.assert_allclose(entries["poles"] / 2**14, filters.poles, atol=2**-15)
    for name, exact in (("drive", filters.drive), ("change", filters.change)):
        scale = 2.0 ** entries[f"{name}_shift"][:, None] * volts / amperes
        np.testing.assert_allclose(entries[name] / scale, exact, atol=0.5 / scale.min())
        assert np.abs(entries[name]).max(axis=1).min() > 16383
    assert np.all(entries["limit"] >= filters.limit / amperes)
    assert np.all(entries["floor"] >= filters.floor / amperes**2)


@pytest.mark.ci
def test_lift_offs_trip_and_strokes_do_not() -> None:
    """Contactors under two fingers play oak; all trip within 12 ms after they lost it, none before.

    The figures on ten fingers are measured by ``python -m benchmarks guard``.
    """
    converter = Converter()
    case = draw_case(2, 8, converter, seed=11)
    count = len(case.logarithms)
    never = GuardedLoop(
        case, converter, lift=np.full(count, np.inf), force=swinging(0.8), seconds=1.2
    ).play()
    assert np.isnan(never.tripped).all()
    lift = np.linspace(0.6, 0.7, count)
    lifted = GuardedLoop(case, converter, lift=lift, force=steady, seconds=0.8).play()
    late = lifted.tripped - lift
    assert np.all((late > 0) & (late < 0.012))
    assert set(lifted.reason) <= {GuardReason.RESIDUAL, GuardReason.LOST}
