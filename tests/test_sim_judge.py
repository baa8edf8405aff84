"""The judge of what a simulated display did: shear played against shear wanted."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from sim_rig import RATE

from tactile.arrays import Floats
from tactile.sim import Fidelity


def direct(commanded: Floats, played: Floats) -> float:
    """Return the ratio in 20–1000 Hz of whole recordings [dB], by scipy alone."""
    sos = butter(4, [20, 1000], "bandpass", fs=RATE, output="sos")
    signal = sosfilt(sos, commanded, axis=0)
    error = sosfilt(sos, played - commanded, axis=0)
    return float(10 * np.log10(np.sum(signal**2) / np.sum(error**2)))


@pytest.mark.parametrize(
    "edges", [[], [1, 2, 3], list(range(64, 4000, 64)), [0, 0, 7, 3999]], ids=str
)
def test_fidelity_is_that_of_the_whole_recording_however_it_is_cut(edges: list[int]) -> None:
    rng = np.random.default_rng(0)
    commanded = np.cumsum(rng.normal(0, 1e-7, (4000, 3)), axis=0)
    played = 1.01 * commanded + rng.normal(0, 1e-8, (4000, 3))
    judge = Fidelity(RATE)
    for start, end in pairwise([0, *edges, 4000]):
        judge.add(commanded[start:end], played[start:end])
    # a filter's state carries rounding, no more
    assert judge.signal_to_error_db == pytest.approx(direct(commanded, played), abs=1e-6)


@pytest.mark.parametrize(
    ("gain", "ratio"), [(1.01, 40.0), (0.9, 20.0), (0.0, 0.0), (-1.0, -6.0206)]
)
def test_a_wrong_gain_is_told_exactly(gain: float, ratio: float) -> None:
    commanded = np.random.default_rng(0).normal(0, 1e-6, (1000, 2))
    judge = Fidelity(RATE)
    judge.add(commanded, gain * commanded)
    assert judge.signal_to_error_db == pytest.approx(ratio, abs=1e-3)


def test_errors_that_are_not_heard_do_not_count() -> None:
    """Offset and drift lie below 20 Hz, a tone at 3 kHz is 45 dB down in the judge's filter."""
    t = np.arange(16000)[:, None] / RATE
    commanded = 1e-6 * np.sin(2 * np.pi * 200 * t)
    heard = 1e-8 * np.sin(2 * np.pi * 300 * t)
    ramped = np.minimum(t / 0.5, 1)
    unheard = 1e-7 * ramped * (1 + np.sin(2 * np.pi * 3000 * t) + np.sin(2 * np.pi * 0.5 * t))
    judge = Fidelity(RATE)
    judge.add(commanded, commanded + heard + unheard)
    # 1 % of error alone is 40 dB
    assert judge.signal_to_error_db == pytest.approx(40.0, abs=0.3)


def test_fidelity_is_nan_before_any_signal() -> None:
    judge = Fidelity(RATE)
    assert math.isnan(judge.signal_to_error_db)
    judge.add(np.zeros((0, 3)), np.zeros((0, 3)))
    assert math.isnan(judge.signal_to_error_db)
    judge.add(np.zeros((100, 3)), np.zeros((100, 3)))
    assert math.isnan(judge.signal_to_error_db)


def test_what_is_played_without_error_is_infinitely_good() -> None:
    commanded = np.random.default_rng(0).normal(0, 1e-6, (1000, 2))
    judge = Fidelity(RATE)
    judge.add(commanded, commanded)
    assert judge.signal_to_error_db == math.inf


def test_fidelity_leaves_its_arguments_alone() -> None:
    commanded, played = np.ones((10, 2)), np.zeros((10, 2))
    Fidelity(RATE).add(commanded, played)
    assert np.all(commanded == 1)
    assert not played.any()
