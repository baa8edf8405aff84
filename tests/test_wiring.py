"""A bender wired in series, against finite elements that know of parallel wiring only.

In series each layer has half the voltage, and the charge of one is that of both. So the reference
tells what one volt does in series: displacement and force are half its own, the current a quarter.
What says so independently of that argument: the closed form of a bender without a shim, a plate
capacitor of two layers one behind the other, and the work of the field.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_beam import HIGH_FINGER, LOW_FINGER, Beam, Load, response

from tactile.actuator.bimorph import Bimorph, capacitance
from tactile.actuator.finger import FingerLoad
from tactile.actuator.plant import Plant
from tactile.actuator.response import blocked_force, tip_response
from tactile.arrays import Floats

FREQUENCIES = np.array([1.0, 60.0, 250.0, 930.0, 2000.0, 5000.0])
LOADS: dict[str, tuple[Load | None, FingerLoad]] = {
    "air": (None, FingerLoad.none()),
    "low": (LOW_FINGER, FingerLoad.low()),
    "high": (HIGH_FINGER, FingerLoad.high()),
}
SERIES = Bimorph(series=True)


@pytest.mark.parametrize("name", LOADS)
def test_one_volt_in_series_is_half_a_volt_on_each_layer(name: str) -> None:
    finger, load = LOADS[name]
    exact = response(Beam(), FREQUENCIES, load=finger)
    found = tip_response(SERIES, load, FREQUENCIES)
    np.testing.assert_allclose(found.displacement, exact.displacement / 2, rtol=1e-9)
    np.testing.assert_allclose(found.rotation, exact.rotation / 2, rtol=1e-9)
    np.testing.assert_allclose(found.force, exact.force / 2, rtol=1e-9)
    np.testing.assert_allclose(found.admittance, exact.admittance / 4, rtol=1e-9)


def test_static_deflection_without_shim_has_its_closed_form() -> None:
    """3 d31 L² U/(8 h_p²), Smits et al. 1991: half of the parallel 3 d31 L² U/(4 h_p²)."""
    bare = Bimorph(
        shim_height=0.0,
        series=True,
        piezo=replace(SERIES.piezo, quality_factor=np.inf, piezo_loss_tangent=0.0),
    )
    closed = 3 * 320e-12 * 20e-3**2 / (8 * 0.26e-3**2)
    found = tip_response(bare, FingerLoad.none(), [0.0]).displacement[0]
    assert found.real == pytest.approx(closed, rel=1e-9)


def test_blocked_capacitance_is_that_of_two_capacitors_one_behind_the_other() -> None:
    """Each layer is ε_S w l/h_p with ε_S = ε33T − d31²/s11E; two in series are half of one."""
    piezo = replace(SERIES.piezo, quality_factor=np.inf, loss_tangent=0.0, piezo_loss_tangent=0.0)
    clamped = 3800 * 8.8541878128e-12 - (320e-12) ** 2 / 16.2e-12
    one = clamped * 2.1e-3 * 20e-3 / 0.26e-3
    found = complex(capacitance(replace(SERIES, piezo=piezo), 20e-3))
    assert found == pytest.approx(1 / (1 / one + 1 / one), rel=1e-9)


def test_the_same_field_does_the_same_work() -> None:
    """Power taken is Re Y |U|²/2: 2 V in series take what 1 V takes in parallel."""
    at_resonance = [930.0]
    load = FingerLoad.low()
    series = tip_response(SERIES, load, at_resonance).admittance.real * 2.0**2
    parallel = tip_response(Bimorph(), load, at_resonance).admittance.real * 1.0**2
    np.testing.assert_allclose(series, parallel, rtol=1e-12)


def test_charge_of_a_push_is_the_displacement_of_a_volt() -> None:
    """Reciprocity: shorted, 1 N on the tip moves as much charge [C/N] as 1 V moves the tip [m/V].

    A soft spring pushes: what it changes of the charge, over its force.
    """
    soft = FingerLoad(k0=10.0, d0=0.0)
    air, held = (tip_response(SERIES, load, [1.0]) for load in (FingerLoad.none(), soft))
    charge = (held.admittance - air.admittance) / (2j * np.pi)
    np.testing.assert_allclose(-charge / held.force, air.displacement, rtol=1e-6)


def test_wiring_changes_neither_stiffness_nor_resonance() -> None:
    force, stiffness = blocked_force(SERIES, FREQUENCIES)
    parallel_force, parallel_stiffness = blocked_force(Bimorph(), FREQUENCIES)
    np.testing.assert_array_equal(stiffness, parallel_stiffness)
    np.testing.assert_allclose(force, parallel_force / 2, rtol=1e-12)


def test_wiring_may_differ_from_design_to_design() -> None:
    wired = Bimorph(series=np.array([False, True, True]), length=np.array([20e-3, 20e-3, 15e-3]))
    found = tip_response(wired, FingerLoad.low(), FREQUENCIES)
    for i, design in enumerate((Bimorph(), SERIES, replace(SERIES, length=15e-3))):
        one = tip_response(design, FingerLoad.low(), FREQUENCIES)
        np.testing.assert_allclose(found.displacement[i], one.displacement, rtol=1e-12)
        np.testing.assert_allclose(found.admittance[i], one.admittance, rtol=1e-12)


def test_in_time_twice_the_voltage_moves_the_same_and_takes_half_the_current() -> None:
    drive = 10 * np.sin(2 * np.pi * 200 * np.arange(400) / 8000)[:, None]

    def played(design: Bimorph, volts: Floats) -> tuple[Floats, Floats]:
        return Plant(design, FingerLoad.low(), 8000.0, contactors=1).step(volts)

    parallel, series = played(Bimorph(), drive), played(SERIES, 2 * drive)
    np.testing.assert_allclose(series[0], parallel[0], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(series[1], parallel[1] / 2, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("wrong", [1, "series", np.array([0.0, 1.0])])
def test_a_wiring_is_true_or_false(wrong: object) -> None:
    with pytest.raises(ValueError, match=r"series = .* is neither True nor False"):
        Bimorph(series=wrong)  # type: ignore[arg-type]
