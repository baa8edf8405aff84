"""Tests of the distance between textures, against numbers worked out by hand."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.special import i0, i1

import tactile
from tactile.strength import differences
from tactile.strength.differences import Impression, distance, largest_clique
from tactile.texture.descriptor import Modulation

PLAIN = Impression(10.0, 0.0, 200.0, 0.0, 8.0, 0.0, 8e-6)


@pytest.mark.parametrize(
    ("name", "changed", "jnd"),
    [
        ("pacini", {"pacini": 14.7}, 2.0),
        ("meissner", {"meissner": 4.7}, 2.0),
        ("centroid", {"centroid": 312.5}, 2.0),
        ("swing", {"swing": 4.7}, 2.0),
        ("events", {"events": 16.0}, 16 / np.hypot(4, 2)),
        ("stretch", {"stretch": 8e-6 * 10 ** (4.7 / 20)}, 2.0),
    ],
)
def test_each_quantity_is_counted_in_its_own_jnd(
    name: str, changed: dict[str, float], jnd: float
) -> None:
    """Two steps of 25 % lead from 200 to 312.5 Hz; 16 events have a counting error of 4."""
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

    Sidebands lie where the threshold differs: those 50 Hz beside the rest take 5 % of the swing.
    """
    display, calf = tactile.load_display("reference-24"), tactile.load_texture("leather-calf")
    assert calf.descriptor.stochastic is not None
    even = structs.replace(calf.descriptor.stochastic, excess_kurtosis=0.0, am_depth=0.0)
    for wavelength, rate in ((20.0, 4.0), (1.6, 50.0)):
        ribs = Modulation(wavelength_mm=wavelength, depth=2 * i1(1.0) / i0(1.0))
        ribbed = structs.replace(calf.descriptor, stochastic=even, modulation=(ribs,))
        felt = differences.impression(display, replace(calf, descriptor=ribbed))
        swing = 8.686 / math.sqrt(2) / math.hypot(1, rate / 50)
        assert felt.swing == pytest.approx(swing, rel=0.06)
        assert felt.swing_rate == pytest.approx(rate)


@pytest.mark.ci
def test_shipped_textures_are_distinct_and_reach_meissner_channels() -> None:
    display = tactile.load_display("reference-24")
    felt = {
        name: differences.impression(display, tactile.load_texture(name))
        for name in tactile.textures()
    }
    assert len(differences.most_distinct(felt)) >= 22
    assert sum(f.meissner > 0 for f in felt.values()) >= 27
