"""Contactors that nothing touches, on the finite-element plant: they are noticed.

The plant shares no code with the estimator. A finger touches, lifts off and touches again.
"""

import numpy as np
import pytest

from benchmarks.sensing_loop import RATE, WINDOW, Case, Loop, Moment, draw_case
from benchmarks.sensing_plant import Converter
from tactile.arrays import Floats

COUNT = 4
LIFTED, AGAIN = 0.5, 0.9
"""Times at which the finger lifts off and touches again [s]."""


@pytest.fixture(scope="module")
def case() -> Case:
    return draw_case(1, COUNT, Converter(), seed=11)


def between(time: Floats) -> Floats:
    """Return a force of 1 N [N], but for the time in air."""
    return np.where((time >= LIFTED) & (time < AGAIN), 0.0, 1.0)


def windows(moments: list[Moment]) -> list[Moment]:
    """Return the last moment of each window."""
    return moments[2::3]


@pytest.mark.ci
def test_lift_off_and_touch_are_noticed_in_two_windows(case: Case) -> None:
    """The estimate of a window is known when the next one has been played.

    In air the filters are those of the free bender: its shear is as commanded, which under the
    filters of the finger would be 20 dB too much at the resonance. Until they have faded in, what
    oak commands at 640–1000 Hz rings there, which no load explains.
    """
    loop = Loop(case, Converter(), force=between, seconds=1.3)
    seconds = WINDOW / RATE
    latest = windows(list(loop.run()))
    known = [m for m in latest if m.estimate is not None]
    for m in known:
        assert m.estimate is not None
        touching = m.estimate.touching
        if m.time < LIFTED or m.time > AGAIN + 3 * seconds:
            assert touching.all()
        elif LIFTED + 4 * seconds < m.time < AGAIN:
            assert not touching.any()
            if m.time > LIFTED + 5 * seconds:
                assert np.all(m.estimate.inconsistency < 3)
    in_air = [m for m in known if LIFTED + 5 * seconds < m.time < AGAIN]
    assert len(in_air) > 5
    assert np.median(np.abs(in_air[-1].error)) < 0.5
    assert np.abs(in_air[-1].error).max() < 6
    assert np.median(np.abs(known[-1].error)) < 1.0


@pytest.mark.ci
def test_what_never_touches_is_in_air_from_the_first_windows_on(case: Case) -> None:
    loop = Loop(case, Converter(), force=np.zeros_like, seconds=0.5)
    known = [m.estimate for m in windows(list(loop.run())) if m.estimate is not None]
    assert not any(estimate.touching.any() for estimate in known[2:])
