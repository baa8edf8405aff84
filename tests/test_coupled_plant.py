"""The simulated contactors that the skin couples, against closed forms and the uncoupled plant."""

from pathlib import Path

import numpy as np
import pytest
from display_files import contactors, load

import tactile
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.coupled_plant import CoupledTouchedPlant
from tactile.actuator.finger import FingerLoad
from tactile.actuator.population import random_finger
from tactile.actuator.response import blocked_force
from tactile.actuator.tolerances import Tolerances
from tactile.actuator.touch import Touch
from tactile.actuator.touched_plant import TouchedPlant
from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.sim import SimOptions, changing_plant

RATE = 8000.0


def tone(plant: TouchedPlant, frequency: float, volts: Floats) -> tuple[Complex, Complex]:
    """Return shear and current (N,) of a cosine with amplitudes (N,), once settled."""
    k = np.arange(3200)
    shear, current = plant.step(np.cos(2 * np.pi * frequency / RATE * k)[:, None] * volts)
    turn = 2 * np.exp(-2j * np.pi * frequency / RATE * (k - plant.delay))[-800:, None]
    return (shear[-800:] * turn).mean(axis=0), (current[-800:] * turn).mean(axis=0)


def test_without_coupling_the_plant_is_the_other_one() -> None:
    """Play noise on four contactors that differ, under a finger that differs."""
    tolerances = Tolerances.drawn(4, 1)
    touch, drive = Touch(load=random_finger(2, 4)), np.random.default_rng(0).normal(0, 1, (300, 4))
    alone = TouchedPlant(Bimorph(), touch, RATE, contactors=4, tolerances=tolerances)
    plant = CoupledTouchedPlant(
        Bimorph(), touch, RATE, coupling=np.zeros((4, 4)), contactors=4, tolerances=tolerances
    )
    for own, other in zip(plant.step(drive), alone.step(drive), strict=True):
        np.testing.assert_allclose(own, other, atol=1e-11 * np.abs(other).max())


@pytest.mark.parametrize("frequency", [50.0, 300.0, 700.0])
def test_two_contactors_move_and_draw_what_the_closed_form_says(frequency: float) -> None:
    """Play both alike and against each other: their loads are k (1 − c) and k (1 + c).

    Half the difference of the currents is jω F² c k/((S + k)² − c² k²). Loss factors at each mode's
    own frequency instead of the present one make 0.5 % of shear, as they do without coupling.
    """
    finger, c = FingerLoad.high(), 0.2
    at = np.array([frequency])
    (F,), (S,), (k,) = *blocked_force(Bimorph(), at), finger.stiffness(at)
    moved, drawn = [], []
    for sign in (1.0, -1.0):
        plant = CoupledTouchedPlant(
            Bimorph(), Touch(load=finger), RATE, contactors=2, coupling=c * (1 - np.eye(2))
        )
        shear, current = tone(plant, frequency, np.array([1.0, sign]))
        moved.append(shear[0])
        drawn.append(current[0])
        assert shear[0] == pytest.approx(F / (S + k * (1 - c * sign)), rel=0.01)
    mutual = 2j * np.pi * frequency * F**2 * c * k / ((S + k) ** 2 - (c * k) ** 2)
    assert (drawn[0] - drawn[1]) / 2 == pytest.approx(mutual, rel=0.015)


def test_couplings_that_exceed_the_loads_are_refused() -> None:
    """Couple three contactors by 0.6 each, so that all that move alike have a load of −0.2 k."""
    with pytest.raises(ValueError, match="exceed the loads"):
        CoupledTouchedPlant(
            Bimorph(), Touch(load=FingerLoad.low()), RATE, contactors=3,
            coupling=0.6 * (1 - np.eye(3)),
        )  # fmt: skip


def test_the_simulated_display_couples_its_contactors(tmp_path: Path) -> None:
    """Move two contactors alike under a load of k (1 − 0.1), and refuse a force that swings."""
    load(tmp_path, contactors((0.0, 0.0, 0.0), (2.5, 0.0, 0.0)))
    (file,) = tmp_path.glob("*.toml")
    display = tactile.load_display(file)
    with pytest.raises(InputError, match="needs a force that is steady"):
        changing_plant(display, RATE, SimOptions(coupling=0.1, force="0.2:2"))
    plant = changing_plant(display, RATE, SimOptions(coupling=0.1, finger="high"))
    assert isinstance(plant, CoupledTouchedPlant)
    (F,), (S,) = blocked_force(display.bimorph, np.array([50.0]))
    (k,) = FingerLoad.high().stiffness(np.array([50.0]))
    shear, _ = tone(plant, 50.0, np.ones(2))
    np.testing.assert_allclose(shear, F / (S + 0.9 * k), rtol=0.01)
