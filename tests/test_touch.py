"""Loads over the normal force, its course, and the population of fingers."""

import numpy as np
import pytest

from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.hysteresis import Hysteresis
from tactile.actuator.population import random_finger
from tactile.actuator.touch import NormalForce, Touch


def test_constants_grow_with_the_root_of_the_force() -> None:
    """Constants at 4 N are twice those at 1 N, and zero at 0 N."""
    touch = Touch(load=FingerLoad.low())
    for force, factor in ((1.0, 1.0), (4.0, 2.0), (0.0, 0.0)):
        load = touch.load_at(force)
        ((k, d),) = load.branches
        found = [float(value) for value in (load.k0, load.d0, k, d)]
        assert found == pytest.approx([1000 * factor, 0.11 * factor, 1300 * factor, 0.33 * factor])


def test_table_is_the_law_where_there_is_one() -> None:
    """The table holds its lowest load down to the smallest force, and has none at 0 N."""
    table = FingerTable(normal_force=(0.5, 1.0), loads=(FingerLoad.low(), FingerLoad.high()))
    found = Touch(load=table).load_at(np.array([0.0, 1e-3, 0.75, 7.0])).k0
    assert np.asarray(found).tolist() == [0, 1000, 2650, 4300]


def test_force_swings_lifts_off_and_comes_back() -> None:
    """A raised cosine from low to high in half a period, to 0 N and back in 5 ms each."""
    force = NormalForce(low=0.2, high=2.0, period=0.4, liftoff=1.0, retouch=1.2)
    assert force(np.array([0.0, 0.1, 0.2, 0.4])) == pytest.approx([0.2, 1.1, 2.0, 0.2])
    assert force(np.array([1.0025])) == pytest.approx([0.99965], abs=1e-5)  # half of 1.9993 N
    assert force(np.array([1.006, 1.1, 1.2])).tolist() == [0, 0, 0]
    assert force(np.array([1.6])) == pytest.approx([0.2])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"low": 2.0, "high": 1.0}, "ascend"),
        ({"low": -0.1}, "ascend"),
        ({"high": np.inf}, "ascend"),
        ({"period": 0.0}, "period"),
        ({"liftoff": 1.0, "retouch": 1.001}, "retouch"),
        ({"retouch": 1.0}, "retouch"),
    ],
)
def test_impossible_forces_are_refused(wrong: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        NormalForce(**wrong)


@pytest.mark.parametrize("wrong", [{"width": -0.1}, {"width": 0.5}, {"full_drive": 0.0}])
def test_impossible_hysteresis_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="Hysteresis: "):
        Hysteresis(**{"width": 0.12, "full_drive": 100.0, **wrong})


def test_middle_finger_is_the_geometric_mean() -> None:
    """The stiffness at every corner is that of √(low · high) for each constant."""
    mid = FingerLoad.mid()
    ((k, d),) = mid.branches
    expected = [(1000 * 4300) ** 0.5, (0.11 * 0.55) ** 0.5, (1300 * 5000) ** 0.5, (0.33 * 2) ** 0.5]
    assert [float(x) for x in (mid.k0, mid.d0, k, d)] == pytest.approx(expected)


def test_population_has_the_stated_spread() -> None:
    """2000 fingers: ln k0 is normal about that of `mid` with σ² = 0.76² + 0.30² + 0.15².

    ln k0 − ln d0 has only the own parts, σ² = 2 · 0.30²; two contactors differ by σ² = 2 · 0.15²,
    in all constants alike. Sampling leaves 1.6 % of each σ; the limits are 4 times that.
    """
    fingers = [random_finger(seed, 2) for seed in range(2000)]
    k0 = np.log([np.asarray(finger.k0) for finger in fingers])
    d0 = np.log([np.asarray(finger.d0) for finger in fingers])
    assert k0[:, 0].mean() == pytest.approx(np.log(1000 * 4300) / 2, abs=0.08)
    assert k0[:, 0].std() == pytest.approx(np.hypot(np.hypot(0.76, 0.30), 0.15), rel=0.065)
    assert (k0 - d0)[:, 0].std() == pytest.approx(0.30 * 2**0.5, rel=0.065)
    assert (k0[:, 0] - k0[:, 1]).std() == pytest.approx(0.15 * 2**0.5, rel=0.065)
    assert k0[:, 0] - k0[:, 1] == pytest.approx(d0[:, 0] - d0[:, 1])


def test_seed_is_the_finger() -> None:
    one, same, other = random_finger(4, 3), random_finger(4, 3), random_finger(5, 3)
    assert np.array_equal(one.k0, same.k0)
    assert not np.array_equal(one.k0, other.k0)
