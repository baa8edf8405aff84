"""Material constants are found from what finite elements measure, with honest intervals."""

from dataclasses import replace

import numpy as np
import pytest
from reference_beam import LOW_FINGER, VACUUM_PERMITTIVITY, Beam, Response, electric, response
from scipy.stats import binom

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.errors import InputError
from tactile.study.admittance_fit import ADJUSTED, CONSTANTS, BimorphFit, fit_bimorph
from tactile.study.measurement import Kind, Measurement

FREQUENCY = np.unique(
    np.concatenate([np.geomspace(100, 700, 12), np.linspace(800, 1050, 30), [1500, 2000, 3000]])
)
BEAM = Beam(
    d31=-280e-12,
    eps33T=3300 * VACUUM_PERMITTIVITY,
    piezo_quality=85.0,
    shim_quality=45.0,
    loss_tangent=0.016,
)
TRUTH = {
    "piezo_quality": 85.0,
    "shim_quality": 45.0,
    "d31_pm_per_v": -280.0,
    "eps33t_relative": 3300.0,
    "loss_tangent": 0.016,
    "s11e_um2_per_n": 17.0,
}
SOFT = replace(BEAM, s11E=17.0e-12)
AIR = FingerLoad.none()
WHOLE = response(BEAM, FREQUENCY)
WHOLE_SOFT = response(SOFT, FREQUENCY)
RATE = 2j * np.pi * FREQUENCY


def measured(
    told: Response, kind: Kind, seed: int | None = None, noise: float = 0.01
) -> Measurement:
    value = told.admittance if kind == "admittance" else RATE * told.displacement
    if seed is not None:
        one = np.random.default_rng(seed).standard_normal((2, len(value)))
        value = value * (1 + noise * (one[0] + 1j * one[1]))
    name = "electrical.csv" if kind == "admittance" else "mechanical.csv"
    return Measurement(name, kind, FREQUENCY, np.asarray(value))


def both(told: Response, seed: int | None = None) -> list[tuple[Measurement, FingerLoad]]:
    other = None if seed is None else seed + 10000
    return [
        (measured(told, "admittance", seed), AIR),
        (measured(told, "velocity", other), AIR),
    ]


def value(fit: BimorphFit, name: str) -> float:
    return next(c.value for c in fit.reported if c.name == name)


def test_all_constants_are_recovered_from_clean_data_without_a_good_start() -> None:
    fit = fit_bimorph(Bimorph(), both(WHOLE_SOFT), names=tuple(CONSTANTS))
    for c in fit.constants:
        assert c.value == pytest.approx(TRUTH[c.name], rel=1e-3), c.name
    assert max(c.worst_db for c in fit.comparisons) < 1e-3
    assert max(c.start_rms_db for c in fit.comparisons) > 1.0
    assert fit.notes == ()


def test_coupling_and_capacitance_are_those_of_the_reference() -> None:
    fit = fit_bimorph(Bimorph(), both(WHOLE))
    K, per_length = electric(BEAM)
    assert value(fit, "coupling_un_m_per_v") == pytest.approx(abs(K) * 1e6, rel=1e-4)
    whole = abs(per_length) * (BEAM.length + BEAM.clamped_length)
    assert value(fit, "capacitance_nf") == pytest.approx(whole * 1e9, rel=1e-4)


def test_the_fitted_bimorph_is_the_one_of_the_constants() -> None:
    bimorph = fit_bimorph(Bimorph(), both(WHOLE)).bimorph
    assert isinstance(bimorph.piezo.d31, float)
    assert bimorph.piezo.d31 == pytest.approx(-280e-12, rel=1e-4)
    assert bimorph.shim.quality_factor == pytest.approx(45.0, rel=1e-2)
    assert bimorph.piezo.s11E == Bimorph().piezo.s11E


def test_a_response_under_a_known_load_tells_too() -> None:
    loaded = response(BEAM, FREQUENCY, load=LOW_FINGER)
    fit = fit_bimorph(Bimorph(), [(measured(loaded, "velocity"), FingerLoad.low())])
    assert value(fit, "d31_pm_per_v") == pytest.approx(-280.0, rel=1e-3)


def test_a_fit_is_better_than_the_start_that_a_hand_adjusted() -> None:
    by_hand = Bimorph(piezo=replace(Bimorph().piezo, d31=-285e-12, eps33T=3350 * 8.854e-12))
    fit = fit_bimorph(by_hand, both(WHOLE, 1))
    for c in fit.comparisons:
        assert c.rms_db < 0.15 < c.start_rms_db


@pytest.mark.ci
def test_intervals_cover_the_truth_19_times_of_20() -> None:
    """Counts lie within bounds that intervals of 95 % exceed once in a thousand runs."""
    count, within = 30, dict.fromkeys(ADJUSTED, 0)
    for seed in range(count):
        for c in fit_bimorph(Bimorph(), both(WHOLE, seed)).constants:
            low, high = sorted((c.low, c.high))
            within[c.name] += low <= TRUTH[c.name] <= high
    least, most = binom.interval(1 - 1e-3, count, 0.95)
    assert all(least <= hits <= most for hits in within.values()), within


# Constants that cannot be known


def test_motion_alone_tells_nothing_of_capacitance_and_its_loss() -> None:
    fit = fit_bimorph(Bimorph(), [(measured(WHOLE, "velocity", 1), AIR)])
    assert {"eps33t_relative", "loss_tangent"}.isdisjoint({c.name for c in fit.reported})
    assert fit.notes[0].startswith("eps33t_relative and loss_tangent stay as they were")
    assert fit.bimorph.piezo.eps33T == Bimorph().piezo.eps33T


def test_two_quality_factors_are_not_told_apart_by_one_noisy_resonance() -> None:
    one = measured(WHOLE, "velocity", 4, noise=0.05)
    fit = fit_bimorph(Bimorph(), [(one, AIR)])
    assert any("quality" in note and "cannot be told" in note for note in fit.notes)


def test_a_band_without_a_resonance_is_called_out() -> None:
    m = measured(WHOLE, "velocity", 1)
    low = FREQUENCY < 500
    short = Measurement("low.csv", "velocity", FREQUENCY[low], m.value[low])
    fit = fit_bimorph(Bimorph(), [(short, AIR)])
    assert any(
        note.startswith("low.csv: has no resonance: the first is at 9") for note in fit.notes
    )
    assert not all(c.known for c in fit.constants)


@pytest.mark.parametrize("kind", ["velocity", "admittance"])
def test_a_resonance_elsewhere_is_called_out_where_it_may_not_move(kind: Kind) -> None:
    fit = fit_bimorph(Bimorph(), [(measured(WHOLE_SOFT, kind, 1), AIR)])
    assert any("fit s11e_um2_per_n as well" in note for note in fit.notes), fit.notes


# Bad input


def refused(*told: tuple[Measurement, FingerLoad], names: tuple[str, ...] = ADJUSTED) -> str:
    with pytest.raises(InputError) as caught:
        fit_bimorph(Bimorph(), told, names=names)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_cannot_be_fitted_is_refused_in_a_line() -> None:
    m = measured(WHOLE, "velocity")
    turned = replace(m, value=-m.value)
    few = Measurement("few.csv", "velocity", FREQUENCY[:3], m.value[:3])
    assert "needs an electrical admittance or a response" in refused()
    assert "mechanical.csv: is reversed" in refused((turned, AIR))
    assert "few.csv: 3 points for 3 constants" in refused((few, AIR))
    assert "did you mean 'piezo_quality'" in refused((m, AIR), names=("piezo_qualty",))
    assert "only an electrical admittance" in refused((m, AIR), names=("loss_tangent",))
