"""A load is found from what the tip does under it, with honest intervals.

Responses come from the finite elements of `reference_beam`, loads are those of the paper and
random ones, noise is complex and in proportion to the response. A load's own response, where only
it differs, is the reference's F/(S + k): both taken from finite elements, in air and loaded.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from reference_beam import HIGH_FINGER, LOW_FINGER, Beam, Load, dynamic_stiffness, response
from scipy.stats import binom

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.study import load_fit
from tactile.study.adjusted import Constant
from tactile.study.fit_figures import load_fit_figures
from tactile.study.load_fit import LoadFit, corner_frequency, fit_load
from tactile.study.measurement import Kind, Measurement

FREQUENCY = np.geomspace(10, 1000, 40)
AIR = response(Beam(), FREQUENCY).displacement
KNOWN = response(Beam(), FREQUENCY, load=LOW_FINGER).displacement
LOW_STIFFNESS = np.array([dynamic_stiffness(LOW_FINGER, w) for w in 2 * np.pi * FREQUENCY])
TIP = LOW_STIFFNESS * KNOWN / (AIR - KNOWN)
"""Stiffness S of the tip: AIR = F/S and KNOWN = F/(S + k)."""


def moved(load: Load) -> Complex:
    """Return the tip's displacement under a load, by two finite-element solutions."""
    k = np.array([dynamic_stiffness(load, w) for w in 2 * np.pi * FREQUENCY])
    return np.asarray(AIR * TIP / (TIP + k))


def noisy(value: Complex, seed: int, noise: float = 0.01) -> Complex:
    one = np.random.default_rng(seed).standard_normal((2, len(value)))
    return np.asarray(value * (1 + noise * (one[0] + 1j * one[1])))


def fitted(value: Complex, branches: int | None = None, kind: Kind = "displacement") -> LoadFit:
    return fit_load(Bimorph(), Measurement("m.csv", kind, FREQUENCY, value), branches=branches)


def flat(load: Load) -> list[float]:
    return [load[0], load[1], *(value for pair in load[2] for value in pair)]


def errors(fit: LoadFit, load: Load) -> Floats:
    """Return each constant's relative error."""
    values = [c.value for c in fit.constants]
    return np.abs(np.array(values) / flat(load) - 1)


def error_db(fit: LoadFit, truth: Complex) -> float:
    return float(np.abs(20 * np.log10(np.abs(fit.comparison.predicted / truth))).max())


def random_load(generator: np.random.Generator, branches: int) -> Load:
    """Return constants over a factor ten each, corners in the band and apart."""
    k0, d0 = 10 ** generator.uniform([2.7, -1.5], [3.7, -0.3])
    corners = 10 ** np.sort(generator.uniform(1.7, 2.7, branches))
    k = 10 ** generator.uniform(2.7, 3.7, branches)
    return (k0, d0, tuple(zip(k, k / (2 * np.pi * corners), strict=True)))


def test_the_two_ways_to_the_reference_agree() -> None:
    direct = response(Beam(), FREQUENCY, load=HIGH_FINGER).displacement
    np.testing.assert_allclose(moved(HIGH_FINGER), direct, rtol=1e-7)


@pytest.mark.parametrize("load", [LOW_FINGER, HIGH_FINGER])
@pytest.mark.parametrize("kind", ["displacement", "velocity", "force"])
def test_the_papers_loads_are_recovered_from_clean_data(load: Load, kind: Kind) -> None:
    told = response(Beam(), FREQUENCY, load=load)
    rate = 2j * np.pi * FREQUENCY
    value = {
        "displacement": told.displacement,
        "velocity": rate * told.displacement,
        "force": told.force,
    }
    fit = fitted(value[kind], kind=kind)
    assert errors(fit, load).max() < 1e-4
    assert fit.comparison.worst_db < 1e-4
    assert fit.notes == ()


@pytest.mark.parametrize("load", [LOW_FINGER, HIGH_FINGER])
def test_a_noisy_response_is_predicted_within_0_3_db(load: Load) -> None:
    truth = moved(load)
    assert max(error_db(fitted(noisy(truth, seed)), truth) for seed in range(2)) < 0.3


@pytest.mark.ci
@pytest.mark.parametrize("branches", [1, 2, 3])
def test_random_loads_are_predicted_within_0_3_db(branches: int) -> None:
    generator = np.random.default_rng(branches)
    worst = 0.0
    for seed in range(10):
        truth = moved(random_load(generator, branches))
        worst = max(worst, error_db(fitted(noisy(truth, seed)), truth))
    assert worst < 0.3


@pytest.mark.ci
@pytest.mark.parametrize("load", [LOW_FINGER, HIGH_FINGER])
def test_intervals_cover_the_truth_19_times_of_20(load: Load) -> None:
    """Counts per constant lie in bounds that 95 % intervals leave once in a thousand runs."""
    count, truth = 100, moved(load)
    within = np.zeros(4)
    for seed in range(count):
        fit = fitted(noisy(truth, 100 + seed), branches=1)
        pairs = zip(fit.constants, flat(load), strict=True)
        within += [c.low <= true <= c.high for c, true in pairs]
    low, high = binom.interval(1 - 1e-3, count, 0.95)
    assert within.min() >= low
    assert within.max() <= high


def test_the_noise_is_found() -> None:
    """The median size of complex noise of 1 % in each part is 1 % × √(2 ln 2)."""
    found = [fitted(noisy(moved(LOW_FINGER), s), 1).comparison.noise for s in range(5)]
    assert np.mean(found) == pytest.approx(0.01177, rel=0.15)


def test_the_band_of_the_prediction_holds_the_truth() -> None:
    truth, inside = moved(HIGH_FINGER), []
    for seed in range(6):
        c = fitted(noisy(truth, seed), 1).comparison
        off = 20 * np.log10(np.abs(c.predicted / truth))
        inside.append(np.mean(np.abs(off) <= c.band_db))
        turn = np.degrees(np.angle(c.predicted / truth))
        inside.append(np.mean(np.abs(turn) <= c.band_deg))
    assert 0.85 < np.mean(inside) <= 1.0


@pytest.mark.parametrize("branches", [1, 2])
def test_as_many_branches_are_chosen_as_there_are(branches: int) -> None:
    load: Load = (1000.0, 0.05, ((1500.0, 6.0), (2000.0, 0.6))[:branches])
    chosen = [len(fitted(noisy(moved(load), s, 0.002)).load.branches) for s in range(2)]
    assert chosen == [branches] * 2


def test_branches_come_by_ascending_corner() -> None:
    load: Load = (1000.0, 0.05, ((1500.0, 6.0), (2000.0, 0.6)))
    fit = fitted(moved(load), 2)
    assert errors(fit, load).max() < 1e-3
    corners = [corner_frequency(k, d) for k, d in fit.load.branches]
    assert corners == sorted(corners)


# Loads that cannot be known


def unknown(fit: LoadFit) -> set[str]:
    return {c.name for c in fit.constants if not c.known}


@pytest.mark.parametrize("corner", [110.0, 160.0])
def test_a_small_damping_is_found_where_the_first_guess_says_that_there_is_none(
    corner: float,
) -> None:
    """The guess has corners on a grid; beside one of these it has no d0 at all."""
    load = (1000.0, 0.008, ((2000.0, 2000.0 / (2 * np.pi * corner)),))
    assert errors(fitted(moved(load), 1), load).max() < 1e-3


@pytest.mark.parametrize("kind", ["displacement", "velocity", "force"])
def test_a_point_s_stiffness_is_weighed_by_what_it_changes_of_the_response(kind: Kind) -> None:
    """Weights are relative differences of the response of two loads a millionth apart."""
    blank = Measurement("m.csv", kind, FREQUENCY, KNOWN)
    tip = load_fit._checked(Bimorph(), replace(blank, kind="displacement"), 1)
    tip = replace(tip, measurement=blank)
    k, weight = tip.pointwise(tip.response(LOW_STIFFNESS))
    np.testing.assert_allclose(k, LOW_STIFFNESS, rtol=1e-9)
    step = 1e-6 * LOW_STIFFNESS
    change = tip.response(k + step) / tip.response(k) - 1
    np.testing.assert_allclose(np.abs(change / step), weight, rtol=1e-5)


def test_one_branch_too_many_is_called_out() -> None:
    fit = fitted(noisy(moved(LOW_FINGER), 3), 2)
    assert {"k1_n_per_m", "d1_n_s_per_m"} & unknown(fit)
    assert any("cannot be told" in note for note in fit.notes)


def test_a_constant_that_is_zero_is_said_to_be_at_most_something() -> None:
    fit = fitted(noisy(moved((1000.0, 0.0, ((1300.0, 0.33),))), 1), 1)
    d0 = fit.constants[1]
    assert d0.high < 0.05
    assert not d0.known
    assert any(note.startswith("d0_n_s_per_m cannot be told from 0: at most") for note in fit.notes)


@pytest.mark.parametrize(
    ("corner", "acts"), [(4000.0, "a damper, and adds to d0"), (2.0, "a spring, and adds to k0")]
)
def test_a_branch_that_turns_outside_the_band_is_called_out(corner: float, acts: str) -> None:
    pair = (3000.0, 3000.0 / (2 * np.pi * corner))
    fit = fitted(noisy(moved((1000.0, 0.01, (pair,))), 2, 1e-4), 1)
    assert any(acts in note for note in fit.notes), fit.notes


def test_two_branches_at_one_place_are_called_out() -> None:
    fit = fitted(moved(LOW_FINGER), 2)
    assert any("turn at the same place" in note for note in fit.notes)


def test_a_misfit_that_is_not_noise_is_called_out() -> None:
    odd = moved(LOW_FINGER) * (1 + 0.1 * np.sin(np.log(FREQUENCY) * 4))
    fit = fitted(noisy(odd, 1), 1)
    assert any("runs on from point to point" in note for note in fit.notes)


def test_a_response_below_the_noise_is_called_out() -> None:
    fit = fitted(noisy(moved(LOW_FINGER), 1, 0.6), 1)
    assert any("most of it is noise" in note for note in fit.notes)


def test_an_interval_as_wide_as_a_factor_of_two_is_known() -> None:
    assert Constant("k", 1.0, 1.0, 0.51, 1.99).known
    assert not Constant("k", 1.0, 1.0, 0.49, 1.9).known
    assert Constant("d31", -1.0, -1.0, -0.6, -1.9).known


# Bad input


@pytest.mark.parametrize(
    ("count", "branches", "kind", "said"),
    [
        (3, None, "displacement", "has 3 points; a load of 1 branches has 4 constants"),
        (5, 2, "displacement", "has 5 points; a load of 2 branches has 6 constants"),
        (40, 4, "displacement", "branches = 4: must be 1 … 3"),
        (40, 1, "admittance", "is admittance; a load is fitted to one of displacement"),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_a_line(
    count: int, branches: int | None, kind: Kind, said: str
) -> None:
    measured = Measurement("m.csv", kind, FREQUENCY[:count], KNOWN[:count])
    with pytest.raises(InputError, match=re.escape(said)):
        fit_load(Bimorph(), measured, branches=branches)


def test_a_reversed_response_is_refused() -> None:
    with pytest.raises(InputError, match=r"m\.csv: is reversed"):
        fitted(-KNOWN)


def test_the_load_before_is_compared() -> None:
    measured = Measurement("m.csv", "displacement", FREQUENCY, KNOWN)
    c = fit_load(Bimorph(), measured, before=FingerLoad.low()).comparison
    np.testing.assert_allclose(c.started, KNOWN, rtol=1e-7)
    c = fit_load(Bimorph(), measured).comparison
    np.testing.assert_allclose(c.started, AIR, rtol=1e-6)


@pytest.mark.ci
def test_the_figures_for_the_benchmark_reach_their_goals() -> None:
    figures = load_fit_figures(3)
    assert figures["worst_db"] < 0.3
    assert figures["clean_percent"] < 1.0
    assert figures["one_branch_percent"] > 60
    assert figures["covered_percent"] > 70


@pytest.mark.parametrize(("load", "shift"), [(LOW_FINGER, 0.12), (HIGH_FINGER, 0.06)])
@pytest.mark.parametrize("error", [0.95, 1.05])
def test_a_bimorph_that_is_off_shifts_the_stiffness_as_the_note_says(
    load: Load, shift: float, error: float
) -> None:
    """One finite-element beam is measured, another is the one that the fit takes it for."""
    measured = response(Beam(d31=Beam().d31 * error), FREQUENCY, load=load).displacement
    k0 = fitted(measured, branches=1).constants[0].value
    assert abs(k0 / load[0] - 1) == pytest.approx(shift, abs=0.015)
    assert (k0 > load[0]) == (error < 1)
