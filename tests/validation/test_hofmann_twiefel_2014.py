"""Hofmann & Twiefel 2014: values of the paper, compared with the default design.

"Optimization of a Piezoelectric Bending Actuator for a Tactile Virtual Reality Display", Energy
Harvesting and Systems, doi 10.1515/ehs-2014-0055.

The paper's parameter figure is not available as text, so the default design is a surrogate, and
one number of it, the shim height of 0.20 mm, was chosen to meet the paper's optimum ranges of
length. Each test says which of three kinds it is:

* fitted: the paper prints it, and the shim height was chosen to meet it,
* checked: the paper prints it, and that choice could not have made it so by itself,
* record: an earlier result of this program with the surrogate and, for all we know, not in the
  paper; it guards the default design against unnoticed change.

Where nothing else is said limits are half the last digit printed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactile.actuator.bimorph import Bimorph, capacitance
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import CFRP
from tactile.actuator.response import tip_response
from tactile.arrays import Floats

DESIGN = Bimorph()
AIR, LOW, HIGH = FingerLoad.none(), FingerLoad.low(), FingerLoad.high()
BAND = np.arange(0.0, 1001.0, 10.0)
"""Frequencies of the paper's band [Hz]. No resonance of a loaded bender is narrower than the
grid."""


def moved(design: Bimorph, load: FingerLoad, axial_force: float = 0.0) -> Floats:
    """Return the size of the tip's displacement per volt over BAND."""
    return np.abs(tip_response(design, load, BAND, axial_force=axial_force).displacement)


def change(design: Bimorph, load: FingerLoad, axial_force: float = 0.0) -> Floats:
    """Return in dB what a change of the default design or of the force does over BAND."""
    return np.asarray(20 * np.log10(moved(design, load, axial_force) / moved(DESIGN, load)))


@pytest.mark.parametrize(
    ("load", "surrogate", "printed"),
    [(LOW, (17.7, 27.7), (18, 27)), (HIGH, (9.4, 20.1), (10, 20))],
    ids=["low", "high"],
)
def test_optimum_lengths(
    load: FingerLoad, surrogate: tuple[float, float], printed: tuple[float, float]
) -> None:
    """Fitted and checked: the smallest amplitude in 0-1000 Hz is at least 85 % of the best one.

    One number was fitted and four are met, to 1 mm: what is left over is a check of the model and
    of both fingers. The surrogate's own ends are a record, to the page's digit and the grid.
    """
    lengths = np.arange(5e-3, 45e-3, 0.05e-3)
    smallest = moved(Bimorph(length=lengths), load).min(axis=-1)
    good = lengths[smallest >= 0.85 * smallest.max()] * 1e3
    assert len(good) == round((good[-1] - good[0]) / 0.05) + 1  # one range, without a gap
    assert (good[0], good[-1]) == pytest.approx(surrogate, abs=0.1)
    assert (good[0], good[-1]) == pytest.approx(printed, abs=1.0)


def test_optimum_lengths_of_both_fingers_meet_at_20_mm() -> None:
    """Fitted: the paper's compromise, about 20 mm, keeps 85 % of the best under either finger."""
    lengths = np.append(np.arange(5e-3, 45e-3, 0.1e-3), 20e-3)
    for load in (LOW, HIGH):
        smallest = moved(Bimorph(length=lengths), load).min(axis=-1)
        assert smallest[-1] >= 0.85 * smallest.max()


def test_shim_density_hardly_matters() -> None:
    """Record: twice the shim's density changes no loaded amplitude by more than 0.35 dB.

    Found is 0.354 dB, at 1000 Hz under the low finger: hence 0.36.
    """
    heavy = replace(DESIGN, shim=replace(CFRP, density=2 * CFRP.density))
    for load in (LOW, HIGH):
        assert np.max(np.abs(change(heavy, load))) < 0.36
    assert np.max(np.abs(change(heavy, AIR))) > 10  # in air it shifts the resonance


def test_width_pays_under_load() -> None:
    """Record: twice the width gives 1.9 to 6.8 dB over both fingers and the band.

    In air none at all, since the bimorph's own stiffness and mass widen alike.
    """
    wide = replace(DESIGN, width=4.2e-3)
    gains = np.array([change(wide, load) for load in (LOW, HIGH)])
    assert (gains.min(), gains.max()) == pytest.approx((1.9, 6.8), abs=0.06)
    assert change(wide, AIR) == pytest.approx(0, abs=1e-9)


def test_pressing_hardly_matters() -> None:
    """Record: a finger's 0.1 N along the beam (N = −0.1 N) changes 0.02 dB when loaded."""
    largest = max(np.max(np.abs(change(DESIGN, load, -0.1))) for load in (LOW, HIGH))
    assert largest == pytest.approx(0.02, abs=0.005)


def test_resonances_in_air() -> None:
    """Record: 930 and 5783 Hz, undamped; losses of Q = 40 move the peaks by f/8Q² < 1 Hz."""
    for printed in (930.0, 5783.0):
        sweep = np.arange(printed - 20, printed + 20, 0.1)
        peak = sweep[np.argmax(np.abs(tip_response(DESIGN, AIR, sweep).displacement))]
        assert peak == pytest.approx(printed, abs=1)


@pytest.mark.parametrize(
    ("load", "printed", "digit"), [(LOW, 0.56, 0.005), (HIGH, 0.245, 0.0005)], ids=["low", "high"]
)
def test_static_displacement(load: FingerLoad, printed: float, digit: float) -> None:
    """Record: displacements in micrometers per volt."""
    still = tip_response(DESIGN, load, 0).displacement[0]
    assert still.real * 1e6 == pytest.approx(printed, abs=digit)


def test_the_capacitance_of_a_blocked_bimorph() -> None:
    """Record: 11.0 nF with bending blocked, clamped length included."""
    assert float(capacitance(DESIGN, 25e-3).real) * 1e9 == pytest.approx(11.0, abs=0.05)


@pytest.mark.parametrize(
    ("load", "shaping", "limit"),
    [(LOW, 1.7, 0.05), (HIGH, 5.4, 0.05), (AIR, 34, 0.5)],
    ids=["low", "high", "air"],
)
def test_shaping_for_flat_displacement(load: FingerLoad, shaping: float, limit: float) -> None:
    """Record: the largest over the smallest displacement in 10-1000 Hz, in dB."""
    size = moved(DESIGN, load)[1:]
    assert 20 * np.log10(size.max() / size.min()) == pytest.approx(shaping, abs=limit)


@pytest.mark.parametrize(("load", "volts"), [(LOW, 20), (HIGH, 76)], ids=["low", "high"])
def test_volts_for_ten_micrometers(load: FingerLoad, volts: float) -> None:
    """Record: the drive that a flat 10 µm takes where the response is least, 10-1000 Hz."""
    assert 10e-6 / moved(DESIGN, load)[1:].min() == pytest.approx(volts, abs=0.5)
