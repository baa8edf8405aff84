"""Self-sensing in parts: what the current says of the load, against models that share no code.

Benders and their currents come from the finite elements of `reference_beam`, by way of the plant of
the benchmarks; loads are `FingerLoad`; sums and products are written out by their definitions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_beam import HIGH_FINGER, LOW_FINGER, Beam, Load, response
from sensing_rig import CONTACTORS, exact_baseline, random_loads, tolerant_plant

from benchmarks.sensing_loop import DELAY, FREQUENCY, RATE, TAPS, design, lag_sums, level
from firmware_protocol.correlation import Correlator, decode, messages_of
from firmware_protocol.messages import PACKET_MAX
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import blocked_force
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.sensing.bender import Bender, Deviations
from tactile.sensing.correlation import AFTER, BEFORE, LAGS, MARGIN, during, step_products
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.excitation import TONES, VOLTS, pilot, pilot_phases
from tactile.sensing.inverse_mix import InverseMix
from tactile.sensing.population import Population, load_stiffness, load_terms
from tactile.sensing.uncertainty import shear_deviation

ONE = np.ones(1)
PAPER = {"low": FingerLoad.low(), "high": FingerLoad.high()}


def logarithms_of(load: FingerLoad) -> Floats:
    """Return the logarithms (4,) of a load's constants."""
    (k1, d1), *_ = load.branches
    return np.log([float(load.k0), float(load.d0), float(k1), float(d1)])


@pytest.mark.parametrize("load", [LOW_FINGER, HIGH_FINGER])
def test_charge_and_shear_follow_from_the_held_tip(load: Load) -> None:
    """Check q/U = C + F²/(S + k) and u/U = F/(S + k) with the finite elements."""
    force, stiffness = design().at(FREQUENCY, Deviations(ONE, ONE, ONE))
    k0, d0, ((k1, d1),) = load
    k = load_stiffness(np.log([k0, d0, k1, d1]), FREQUENCY)
    loaded, air = response(Beam(), FREQUENCY, load=load), response(Beam(), FREQUENCY)
    shear = (force / (stiffness + k))[0]
    assert np.abs(shear / loaded.displacement - 1).max() < 1e-3
    rate = 2j * np.pi * FREQUENCY
    change = (force**2 / (stiffness + k) - force**2 / stiffness)[0]
    expected = (loaded.admittance - air.admittance) / rate
    assert np.abs(change - expected).max() < 2e-3 * np.abs(expected).max()


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_stiffer_material_moves_the_resonance_by_its_root(factor: float) -> None:
    """Compare a deviation of the stiffness with a bimorph whose compliances are divided by it."""
    stock = Bimorph()
    piezo = replace(stock.piezo, s11E=stock.piezo.s11E / factor, s55E=stock.piezo.s55E / factor)
    shim = replace(
        stock.shim,
        s11=stock.shim.s11 / factor,
        s55=stock.shim.s55 / factor,
    )
    force, stiffness = blocked_force(replace(stock, piezo=piezo, shim=shim), FREQUENCY)
    own_force, own_stiffness = design().at(FREQUENCY, Deviations(factor * ONE, ONE, ONE))
    assert np.abs(own_force[0] / force - 1).max() < 1e-3
    assert np.abs(own_stiffness[0] - stiffness).max() < 1e-3 * np.abs(stiffness).max()


def test_design_resonates_at_930_hz() -> None:
    """Compare the resonance in air with the default design's."""
    assert design().resonance == pytest.approx(930, abs=5)


@pytest.mark.parametrize("name", PAPER)
def test_terms_of_a_load_add_up_to_it(name: str) -> None:
    """Compare with `FingerLoad`, and the terms with differences."""
    load, at = PAPER[name], logarithms_of(PAPER[name])
    np.testing.assert_allclose(load_stiffness(at, FREQUENCY), load.stiffness(FREQUENCY), rtol=1e-12)
    terms = load_terms(at, FREQUENCY)
    for constant, step in enumerate(1e-6 * np.eye(4)):
        slope = load_stiffness(at + step, FREQUENCY) - load_stiffness(at - step, FREQUENCY)
        np.testing.assert_allclose(slope / 2e-6, terms[constant], rtol=1e-5, atol=1e-4)


def test_population_covers_the_fingers_of_the_paper() -> None:
    """Check that low and high finger lie within two standard deviations of the mean."""
    population = Population.assumed()
    for load in PAPER.values():
        away = logarithms_of(load) - population.mean
        assert away @ np.linalg.solve(population.covariance, away) < 2**2


def test_sums_and_products_by_their_definitions() -> None:
    """Write out sums over a window, and check that a filter's sums are its products' sums.

    The drive differs from the effective voltage, as with hysteresis.
    """
    rng = np.random.default_rng(0)
    samples, begin = 37, AFTER
    steps = rng.standard_normal((2, AFTER + samples + MARGIN))
    window = np.arange(begin, begin + samples)
    drive = rng.standard_normal(steps.shape)
    products = step_products(steps, during(drive))
    for m in (-BEFORE, -1, 0, 5, AFTER):
        for lag in (0, 1, LAGS - 1):
            expected = (steps[:, window - m] * drive[:, window - lag]).sum(axis=1)
            np.testing.assert_allclose(products[:, BEFORE + m, lag], expected, atol=1e-9)
    taps = rng.standard_normal(BEFORE + AFTER + 1)
    current = np.array(
        [[taps @ row[n + BEFORE - np.arange(len(taps))] for n in window] for row in steps]
    )
    sums = lag_sums(current, drive[:, begin - LAGS + 1 : begin + samples])
    np.testing.assert_allclose(sums, products.transpose(0, 2, 1) @ taps, rtol=1e-9, atol=1e-9)


def test_baseline_finds_deviations_and_capacitance() -> None:
    """Fit contactors with tolerances in air, and compare with what the plant was made of."""
    plant = tolerant_plant(random_loads(CONTACTORS))
    baseline = exact_baseline(plant)
    made = plant.tip
    # of the first mode: ω² goes with stiffness/mass
    nominal = design().resonance * 2 * np.pi
    np.testing.assert_allclose(
        baseline.deviations.stiffness, (made.omega[0] / nominal) ** 2, rtol=0.012
    )
    np.testing.assert_allclose(baseline.resonance, made.omega[0] / 2 / np.pi, rtol=0.006)
    rate = 2j * np.pi * FREQUENCY
    air = plant.admittance(FREQUENCY, np.zeros(CONTACTORS)) / rate
    force, stiffness = baseline.tip(FREQUENCY)
    own = baseline.charge(FREQUENCY) + force**2 / stiffness * baseline.measuring(FREQUENCY)
    away = np.abs(FREQUENCY / 930 - 1) > 0.12
    assert np.abs(own / air - 1)[:, away].max() < 2e-3


def test_baseline_finds_the_skew_of_the_converter() -> None:
    """Delay the current by 2 µs; tanθ, which the plant lacks, shifts both fits alike."""
    plant = tolerant_plant(random_loads(CONTACTORS))
    late, prompt = exact_baseline(plant, skew=2e-6), exact_baseline(plant)
    np.testing.assert_allclose(late.skew - prompt.skew, 2e-6, atol=0.1e-6)


def test_known_load_gives_the_shear_to_a_tenth_of_a_decibel() -> None:
    """Compare shear per volt of the baseline's tips with the plant's, under random fingers.

    The mass has ±1 % of tolerance, which no current shows; it makes 0.05 dB.
    """
    loads = random_loads(8)
    plant = tolerant_plant(loads)
    force, stiffness = exact_baseline(plant).tip(FREQUENCY)
    own = force / (stiffness + load_stiffness(loads, FREQUENCY))
    error = 20 * np.log10(np.abs(own / plant.response(FREQUENCY, np.ones(8))))
    assert np.abs(error).max() < 0.12


def test_filters_of_the_current_have_the_response_of_the_formula() -> None:
    """Compare the taps of random loads with the charge over frequency, and the slopes."""
    loads = random_loads(CONTACTORS, seed=3)
    plant = tolerant_plant(loads)
    baseline = exact_baseline(plant)
    model = CurrentModel(baseline, Population.assumed(), RATE)
    weights, slopes = model.weights_and_slopes(loads)
    np.testing.assert_allclose(model.weights(loads), weights, rtol=1e-12)
    frequency = np.arange(60.0, 2400.0, 37.0)
    turns = np.exp(-2j * np.pi / RATE * np.outer(np.arange(-BEFORE, AFTER + 1), frequency))
    steps = 1 - np.exp(-2j * np.pi * frequency / RATE)
    own = (model.electrical + weights @ model.shared) @ turns * steps
    force, stiffness = baseline.tip(frequency)
    tip = force**2 / (stiffness + load_stiffness(loads, frequency))
    charge = baseline.charge(frequency) + tip * baseline.measuring(frequency)
    error = own / (2j * np.pi * frequency) - charge
    # one load is so soft (368 N/m) that its resonance is narrow
    assert np.abs(error).max() < 1e-2 * plant.tip.capacitance.min()
    assert np.sqrt(np.mean(np.abs(error) ** 2)) < 1.5e-3 * plant.tip.capacitance.min()
    for constant, step in enumerate(1e-5 * np.eye(4)):
        change = model.weights(loads + step) - model.weights(loads - step)
        np.testing.assert_allclose(
            change / 2e-5, slopes[:, constant], atol=1e-4 * np.abs(slopes).max()
        )


def test_mixed_filters_invert_any_load() -> None:
    """Compare mixed filters with random loads on the design, where the load alone is unknown."""
    loads = random_loads(200, seed=5)
    plant = tolerant_plant(loads[:1])
    baseline = exact_baseline(plant)
    one = Deviations(*np.ones((3, len(loads))))
    many = replace(
        baseline, deviations=one, skew=np.zeros(len(loads)),
        capacitance=np.zeros((len(loads), baseline.capacitance.shape[1]), np.complex128),
    )  # fmt: skip
    force, stiffness = many.tip(FREQUENCY)
    exact = force / (stiffness + load_stiffness(loads, FREQUENCY))
    error = np.abs(level(InverseMix(many, RATE, taps=TAPS, delay=DELAY).taps(loads), exact))
    assert np.percentile(error, 95) < 0.2
    assert error.max() < 0.4


def test_amplifier_is_inverted_too() -> None:
    """Give the amplifier a gain of 20: drive and charge per volt of drive change by it."""
    plant = tolerant_plant(random_loads(1))
    plain = exact_baseline(plant)
    bender: Bender = replace(plain.bender, amplifier=20 * plain.bender.amplifier)
    loud = replace(plain, bender=bender)
    np.testing.assert_allclose(loud.charge(FREQUENCY), 20 * plain.charge(FREQUENCY), rtol=1e-9)
    loads = random_loads(1)
    soft, full = (InverseMix(b, RATE, taps=TAPS, delay=DELAY).taps(loads) for b in (loud, plain))
    np.testing.assert_allclose(20 * soft, full, rtol=1e-6, atol=1e-6 * np.abs(full).max())


def test_stated_deviation_is_that_of_random_loads() -> None:
    """Compare the linearized deviation with the spread of shear over random loads nearby."""
    at, covariance = random_loads(1)[0], 0.05**2 * np.eye(4)
    plant = tolerant_plant(at[None])
    baseline = exact_baseline(plant)
    rng = np.random.default_rng(1)
    loads = rng.multivariate_normal(at, covariance, 4000)
    frequency = np.geomspace(10, 1000, 40)
    _, stiffness = baseline.tip(frequency)
    spread = -20 * np.log10(np.abs(stiffness + load_stiffness(loads, frequency)))
    expected = np.sqrt(spread.var(axis=0).mean())
    own = shear_deviation(baseline, at[None], covariance[None])
    assert own[0] == pytest.approx(expected, rel=0.05)


def test_pilot_is_its_tones_in_one_stream() -> None:
    """Compare the pilot with written-out cosines, and two parts with the whole."""
    phases = pilot_phases(3)
    whole = pilot(0, 100, RATE, phases)
    time = np.arange(100) / RATE
    expected = sum(
        volts * np.cos(2 * np.pi * tone * time[:, None] + phase)
        for tone, volts, phase in zip(TONES, VOLTS, phases, strict=True)
    )
    np.testing.assert_allclose(whole, expected, atol=1e-12)
    np.testing.assert_allclose(pilot(60, 40, RATE, phases), whole[60:], atol=1e-12)


@pytest.mark.parametrize("sample_rate", [4000.0, 48000.0])
def test_rates_that_the_filters_do_not_fit_are_refused(sample_rate: float) -> None:
    """Ask for a model below and above the range."""
    baseline = exact_baseline(tolerant_plant(random_loads(1)))
    with pytest.raises(InputError, match=f"sample_rate {sample_rate:g} Hz: must be 6000 … 16000"):
        CurrentModel(baseline, Population.assumed(), sample_rate)


def test_amplifier_sends_the_sums_that_are_predicted() -> None:
    """Let the reference amplifier correlate codes, and compare with the sums by the definition."""
    rng = np.random.default_rng(0)
    codes, currents = rng.integers(-20000, 20000, (2, LAGS + 200, 3))
    correlator = Correlator(3)
    correlator.add(0, codes[:LAGS], currents[:LAGS], 0)
    (window,) = correlator.add(LAGS, codes[LAGS:], currents[LAGS:], 200)
    (message,) = messages_of(window, 2500, PACKET_MAX)
    entries = decode(message)
    assert entries is not None
    steps = np.diff(codes, axis=0).T.astype(np.float64)
    sums = lag_sums(currents[LAGS:].T.astype(np.float64), steps)
    assert np.all(np.abs(entries.sums - sums) <= entries.rounding[:, None])
