"""Tests of the distance between textures, against numbers worked out by hand."""

import itertools
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from msgspec import structs
from scipy.special import i0, i1

import tactile
from tactile.strength import differences
from tactile.strength.differences import MASKED, Impression, distance, largest_clique
from tactile.strength.strength import SteadyStroke
from tactile.texture.descriptor import Events, Modulation

PLAIN = Impression(10.0, 0.0, 200.0, 0.0, 8.0, 0.0, 3.0)


@pytest.mark.parametrize(
    ("name", "changed", "jnd"),
    [
        ("pacini", {"pacini": 15.0}, 2.0),
        ("meissner", {"meissner": 5.0}, 2.0),
        ("centroid", {"centroid": 312.5}, 2.0),
        ("swing", {"swing": 5.0}, 2.0),
        ("events", {"events": 8.0}, 8 / 3),
        ("events", {"events": 0.5}, 0.5),
        ("stretch", {"stretch": 8.0}, 2.0),
    ],
)
def test_each_quantity_is_counted_in_its_own_jnd(
    name: str, changed: dict[str, float], jnd: float
) -> None:
    """Two steps of 25 % lead from 200 to 312.5 Hz; 8 events have errors of √8 and of 1."""
    other = replace(PLAIN, **changed)
    by_name = differences.quantity_differences(PLAIN, other)
    assert by_name.pop(name) == pytest.approx(jnd)
    assert max(by_name.values()) == 0
    assert distance(PLAIN, other) == pytest.approx(jnd)
    assert distance(other, PLAIN) == pytest.approx(jnd)


def test_what_is_not_felt_has_no_centroid_and_a_faint_swing_has_no_rate() -> None:
    silent = replace(PLAIN, centroid=float("nan"))
    assert distance(PLAIN, silent) == 0
    assert distance(replace(PLAIN, swing=2.0), replace(PLAIN, swing=2.0, swing_rate=80.0)) == 0
    fast = replace(PLAIN, swing=3.0, swing_rate=18.0)
    assert distance(replace(PLAIN, swing=3.0), fast) == pytest.approx(2.0)


def test_a_masked_finger_notices_less() -> None:
    """Divide by 3.63 dB, and take the logarithm to the base 1.60."""
    louder = replace(PLAIN, pacini=10.0 + 7.26, stretch=3.0 + 3.63)
    by_name = differences.quantity_differences(PLAIN, louder, MASKED)
    assert by_name["pacini"] == pytest.approx(2.0)
    assert by_name["stretch"] == pytest.approx(1.0)
    higher = replace(PLAIN, centroid=200 * 1.6**2)
    assert distance(PLAIN, higher, MASKED) == pytest.approx(2.0)
    felt = {"plain": PLAIN, "louder": replace(PLAIN, pacini=16.0)}
    assert len(differences.most_distinct(felt)) == 2
    assert len(differences.most_distinct(felt, MASKED)) == 1


def test_a_largest_clique_is_as_large_as_trying_all_sets_gives() -> None:
    draw = np.random.default_rng(0)
    for density in (0.2, 0.5, 0.8):
        upper = np.triu(draw.random((11, 11)) < density, 1)
        joined = upper | upper.T
        clique = largest_clique(joined)
        assert all(joined[a, b] for a, b in itertools.combinations(clique, 2))
        larger = itertools.combinations(range(11), len(clique) + 1)
        assert not any(all(joined[a, b] for a, b in itertools.combinations(s, 2)) for s in larger)


def test_gain_raises_levels_by_its_decibels_and_leaves_the_swing() -> None:
    display, calf = tactile.load_display("reference-24"), tactile.load_texture("leather-calf")
    one, ten = (differences.impression(display, calf, gain=g) for g in (1.0, 10.0))
    assert 20 <= ten.pacini - one.pacini < 21  # more bands are above threshold
    assert ten.swing == pytest.approx(one.swing)


def test_ribs_swing_by_the_exponent_of_their_envelope_as_far_as_a_finger_follows() -> None:
    """An envelope exp(cos 2πx/λ) swings by 8.69/√2 dB, and has the depth 2 I₁(1)/I₀(1).

    Sidebands lie where the threshold differs: those 50 Hz beside the rest take 5 % of the swing. At
    the gain 10 the level stays above threshold all the time.
    """
    display, calf = tactile.load_display("reference-24"), tactile.load_texture("leather-calf")
    assert calf.descriptor.stochastic is not None
    even = structs.replace(calf.descriptor.stochastic, excess_kurtosis=0.0, am_depth=0.0)
    for wavelength, rate in ((20.0, 4.0), (1.6, 50.0)):
        ribs = Modulation(wavelength_mm=wavelength, depth=2 * i1(1.0) / i0(1.0))
        ribbed = structs.replace(calf.descriptor, stochastic=even, modulation=(ribs,))
        felt = differences.impression(display, replace(calf, descriptor=ribbed), gain=10.0)
        swing = 8.686 / math.sqrt(2) / math.hypot(1, rate / 50)
        assert felt.swing == pytest.approx(swing, rel=0.06)
        assert felt.swing_rate == pytest.approx(rate)
        along_ribs = SteadyStroke(angle=math.pi / 2)
        unmoved = differences.impression(display, replace(calf, descriptor=ribbed), along_ribs)
        assert unmoved.swing == 0
        faint = differences.impression(display, replace(calf, descriptor=ribbed), gain=0.01)
        assert faint.swing == pytest.approx(0, abs=0.01)


def test_a_swing_below_threshold_is_none() -> None:
    """Compare with the normal distribution, integrated, and with what is all or half felt.

    The mean of a level in dB is below the level of its mean power, for a normal one of 6 dB rms by
    36/8.686 dB. Half felt, its standard deviation is √(1/2 − 1/2π) of that.
    """
    below = 36 / 8.685889638
    x = np.linspace(-60, 60, 200_001)
    weight = np.exp(-((x / 6) ** 2) / 2)
    for mean in (-12.0, -3.0, 0.0, 5.0, 40.0):
        level = np.maximum(mean + x, 0)
        variance = np.average(level**2, weights=weight) - np.average(level, weights=weight) ** 2
        felt = differences._felt_swing(mean + below, 6.0)
        assert felt == pytest.approx(math.sqrt(variance), rel=1e-6)
    assert differences._felt_swing(60.0, 6.0) == pytest.approx(6.0)
    half = math.sqrt(1 / 2 - 1 / (2 * math.pi))
    assert differences._felt_swing(below, 6.0) == pytest.approx(6 * half)
    assert differences._felt_swing(-math.inf, 6.0) == 0
    assert differences._felt_swing(20.0, 0.0) == 0


def test_stretch_counts_above_the_threshold_of_a_slow_cycle() -> None:
    """Compare with 25.1 µm × 0.45 at 1 Hz, which 16 dB lower thresholds bring within reach."""
    display, calf = tactile.load_display("reference-24"), tactile.load_texture("leather-calf")
    drag = SteadyStroke().friction(display, calf).drag
    level = 20 * math.log10(drag / (25.1e-6 * 0.45))
    assert differences.impression(display, calf, raised_db=16.0).stretch == 0
    felt = differences.impression(display, calf, raised_db=-16.0)
    assert felt.stretch == pytest.approx(level + 16.0)


def test_thresholds_raised_and_gain_lowered_alike_are_felt_alike() -> None:
    display, oak = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    plain = differences.impression(display, oak)
    raised = differences.impression(display, oak, gain=2.0, raised_db=20 * math.log10(2))
    for name, value in asdict(replace(raised, stretch=plain.stretch)).items():
        assert value == pytest.approx(getattr(plain, name)), name


def test_a_finger_counts_up_to_eight_events_a_second() -> None:
    """Play 30 strong events a second of 0.5 mm: density × width × 80 mm/s, of which 8 count."""
    display, calf = tactile.load_display("reference-24"), tactile.load_texture("leather-calf")
    for rate, counted in ((30.0, 8.0), (6.0, 6.0)):
        kind = Events(density_per_mm2=rate / 40, width_mm=0.5, amplitude_um=500.0)
        pored = structs.replace(calf.descriptor, events=(kind,))
        felt = differences.impression(display, replace(calf, descriptor=pored))
        assert felt.events == pytest.approx(counted)


@pytest.mark.ci
def test_as_many_shipped_textures_as_documented_are_distinct_and_reach_meissner_channels() -> None:
    """Count what textures/README.md states for gain 1, less than `benchmarks.distinct` demands."""
    display = tactile.load_display("reference-24")
    felt = {
        name: differences.impression(display, tactile.load_texture(name))
        for name in tactile.textures()
    }
    assert len(differences.most_distinct(felt)) >= 13
    assert sum(f.meissner > 0 for f in felt.values()) >= 17
