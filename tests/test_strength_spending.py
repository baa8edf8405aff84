"""Tests of how drive is spent on what is felt: optimal by linear programming, and no more."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog
from strength_rig import STROKE, authored, felt, few

from tactile.display.display import Display
from tactile.strength import spending
from tactile.strength.strength import automatic_gain, reach
from tactile.texture.perception import band_sensation
from tactile.texture.surface import Texture

pytestmark = pytest.mark.usefixtures("brief")

DISTANCE_DB = 2.5
"""Level by which a part may be lowered, a just noticeable difference of amplitude [dB]."""


@pytest.mark.parametrize("seed", range(12))
def test_the_weights_solve_the_linear_program(seed: int) -> None:
    """The result, over weights and the common gain, is compared with scipy's solver."""
    rng = np.random.default_rng(seed)
    count = 8
    value, cost = rng.lognormal(0, 2, count), rng.lognormal(0, 1, count)
    value[rng.random(count) < 0.2] = 0.0
    least = np.where(value > 0, rng.uniform(0.2, 0.9), 0.0)
    budget = rng.uniform(0.05, 1.1) * cost.sum()
    found = spending.weights(value, cost, least, budget)
    found = found * min(1.0, budget / (found @ cost))
    scale = np.ones((count, 1))
    above = np.hstack([np.eye(count), -scale])
    below = np.hstack([-np.eye(count), least[:, None]])
    rows = np.vstack([above, below, np.append(cost, 0.0)])
    right = np.append(np.zeros(2 * count), budget)
    best = linprog(np.append(-value, 0.0), A_ub=rows, b_ub=right, bounds=[(0, 1)] * (count + 1))
    assert best.fun is not None
    assert found @ value == pytest.approx(-best.fun, rel=1e-7)


def test_nothing_changes_where_the_drive_suffices(pair: Display, calf: Texture) -> None:
    assert spending.spend(pair, calf) is calf
    np.testing.assert_array_equal(spending.weights(np.ones(3), np.ones(3), np.zeros(3), 3.0), 1.0)


@pytest.mark.parametrize("volts", [4.0, 1.0])
def test_what_is_dropped_is_below_threshold_and_more_is_felt_for_the_same_drive(
    suede: Texture, pair: Display, volts: float
) -> None:
    """Bands that are dropped lie below 0 dB SL at full strength already.

    The automatic gain depends on the highest peak of a trial, which takes some tenths of a decibel.
    """
    weak = few(pair, 0, volts=volts)
    spent = spending.spend(weak, suede)
    before, after = STROKE.lines(suede), STROKE.lines(spent)
    own, left = (band_sensation(one.frequency, one.power) for one in (before, after))
    some = np.isfinite(own)
    dropped = np.zeros(len(own), bool)
    dropped[some] = own[some] - left[some] > DISTANCE_DB + 0.1
    assert dropped.any()
    assert own[dropped].max() < 0
    able = reach(weak, STROKE)
    same = able.drive_rms(before) / able.drive_rms(after)
    at_once = able.delivered(before.times(0.1)), able.delivered(after.times(0.1 * same))
    plain, better = (felt(one.frequency, one.power) for one in at_once)
    assert better > plain + 0.5
    assert automatic_gain(weak, spent).level > automatic_gain(weak, suede).level + 0.1


def test_a_part_that_is_felt_is_lowered_by_no_more_than_the_distance(
    pair: Display, calf: Texture
) -> None:
    """The gain is one at which everything between 20 and 640 Hz is felt."""
    spent = spending.spend(pair, calf, gain=60.0)
    ratio = 20 * np.log10(spent.amplitude[calf.amplitude > 0] / calf.amplitude[calf.amplitude > 0])
    assert ratio.min() == pytest.approx(-DISTANCE_DB)
    assert ratio.max() == pytest.approx(0, abs=1e-12)


def test_an_isotropic_texture_stays_isotropic(pair: Display, calf: Texture) -> None:
    """The weight of a wave goes with its wave number alone."""
    spent = spending.spend(few(pair, 0, volts=2.0), calf)
    size = np.linalg.norm(calf.wave_vector, axis=1)
    some = calf.amplitude > 0
    ratio, order = (spent.amplitude[some] / calf.amplitude[some]), np.argsort(size[some])
    changes = np.count_nonzero(np.abs(np.diff(ratio[order])) > 1e-9)
    assert 1 <= changes < 16
    np.testing.assert_array_equal(spent.wave_vector, calf.wave_vector)


def test_harmonics_below_threshold_are_dropped_and_the_felt_one_is_kept(
    tmp_path: Path, pair: Display
) -> None:
    """10 Hz of 1 µm is below threshold and takes most of the drive, 250 Hz of 0.5 µm is felt."""
    both = authored(
        tmp_path,
        "[[periodic]]\nwavelength_mm = 8.0\nharmonics_um = [1.0]\n"
        "[[periodic]]\nwavelength_mm = 0.32\nharmonics_um = [0.5]\n",
    )
    spent = spending.spend(few(pair, 0, volts=1.0), both)
    slow, fast = (part.harmonics_um[0] for part in spent.descriptor.periodic)
    assert slow == 0
    assert fast == 0.5
