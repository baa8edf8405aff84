"""``sim:`` with fingers that change: its options, what it tells of the finger, and its currents."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sim_rig import CHANNEL, HIGH, POLARITY, RATE, THREE_FORCES, noise, opened, play, shuffled

from tactile.actuator.finger import FingerLoad
from tactile.actuator.hysteresis import Hysteresis
from tactile.actuator.plant import Plant
from tactile.actuator.population import random_finger
from tactile.actuator.response import tip_response
from tactile.actuator.tolerances import Tolerances
from tactile.actuator.touch import NormalForce, Touch
from tactile.actuator.touched_plant import TouchedPlant
from tactile.actuator.voice_coil import VoiceCoil
from tactile.arrays import Floats
from tactile.bus.base import DriveBlock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.sim import SimulatedDisplay

pytestmark = pytest.mark.usefixtures("plant")


@pytest.fixture
def display(tmp_path: Path) -> Display:
    """Return a display of shuffled lines on a finger that loads much."""
    return shuffled(tmp_path, HIGH)


def played(bus: SimulatedDisplay, count: int = 1600) -> Floats:
    """Return the shear of noise at contactors 0 … 3."""
    bus.start()
    return play(bus, noise(count), list(range(64, count, 64)))


def expected(display: Display, touch: Touch, hysteresis: Hysteresis | None = None) -> Floats:
    """Return the shear that a plant of this touch has under the same drive."""
    plant = TouchedPlant(display.bimorph, touch, RATE, contactors=4, hysteresis=hysteresis)
    return np.asarray(plant.step(noise(1600)[:, CHANNEL])[0][plant.delay :] * POLARITY)


CASES = {
    "finger=low": Touch(load=FingerLoad.low()),
    "finger=mid&force=2": Touch(load=FingerLoad.mid(), force=NormalForce(low=2.0, high=2.0)),
    "force=0.2:2": Touch(load=FingerLoad.high(), force=NormalForce(low=0.2, high=2.0)),
    "finger=random:7&force=0.2:2&period=0.1": Touch(
        load=random_finger(7, 4), force=NormalForce(low=0.2, high=2.0, period=0.1)
    ),
    "liftoff=0.05&retouch=0.1": Touch(
        load=FingerLoad.high(), force=NormalForce(liftoff=0.05, retouch=0.1)
    ),
    "finger=air": Touch(load=FingerLoad.none()),
}


@pytest.mark.parametrize("options", CASES)
def test_options_are_the_touch_that_they_name(display: Display, options: str) -> None:
    """The shear is that of a plant made by hand, but for the order of the sums."""
    found = played(opened(display, f"sim:?{options}"))
    exact = expected(display, CASES[options])
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11 * np.abs(exact).max())


def test_tolerance_is_the_seed_of_the_benders(display: Display) -> None:
    bus = opened(display, "sim:?tolerance=5")
    plant = TouchedPlant(
        display.bimorph, Touch(load=FingerLoad.high()), RATE,
        contactors=4, tolerances=Tolerances.drawn(4, 5),
    )  # fmt: skip
    exact = plant.step(noise(1600)[:, CHANNEL])[0][plant.delay :] * POLARITY
    np.testing.assert_allclose(played(bus), exact, rtol=0, atol=1e-11 * np.abs(exact).max())


@pytest.mark.parametrize(("limit", "rounding"), [(100.0, 1e-11), (60.0, 1e-4)])
def test_hysteresis_is_full_at_the_largest_voltage(
    display: Display, limit: float, rounding: float
) -> None:
    """The loop is that of the ceramic and does not change with the limit of the display.

    400 V/mm are 104 V over the default layers of 0.26 mm. The drive is in whole codes of 100 V,
    which those of 60 V round.
    """
    display = replace(display, limits=replace(display.limits, voltage=limit))
    found = played(opened(display, "sim:?hysteresis=0.12"))
    hysteresis = Hysteresis(width=0.12, full_drive=104.0)
    exact = expected(display, Touch(load=FingerLoad.high()), hysteresis)
    np.testing.assert_allclose(found, exact, rtol=0, atol=rounding * np.abs(exact).max())
    linear = expected(display, Touch(load=FingerLoad.high()))
    assert np.abs(found - linear).max() > 0.01 * np.abs(linear).max()


def test_table_of_fingers_begins_at_its_middle_force_and_swings(tmp_path: Path) -> None:
    display = shuffled(tmp_path, THREE_FORCES)
    for options, force in {
        "liftoff=9": NormalForce(low=0.7, high=0.7, liftoff=9.0),
        "force=0.2:2&period=0.1": NormalForce(low=0.2, high=2.0, period=0.1),
    }.items():
        found = played(opened(display, f"sim:?{options}"))
        exact = expected(display, Touch(load=display.load, force=force))
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11 * np.abs(exact).max())


def test_without_options_nothing_has_changed(display: Display) -> None:
    """The plant is the static one, which takes one load for all."""
    bus = opened(display)
    plant = Plant(display.bimorph, FingerLoad.high(), RATE, contactors=4)
    exact = plant.step(noise(1600)[:, CHANNEL])[0][plant.delay :] * POLARITY
    np.testing.assert_allclose(played(bus), exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    assert bus.touching.tolist() == [True] * 4
    assert bus.finger == FingerLoad.high()


def test_finger_can_be_read_while_it_changes(display: Display) -> None:
    """A lift-off is seen where it happens, and the load of each contactor is that of its draw."""
    bus = opened(display, "sim:?finger=random:3&force=4&liftoff=0.1&retouch=0.15")
    drawn = np.asarray(random_finger(3, 4).k0)
    bus.start()
    seen = {}
    for k in range(30):
        bus.write(DriveBlock(80 * k, np.zeros((80, 6))))
        seen[k] = bus.touching.all(), np.asarray(bus.finger.k0).copy()
    assert [bool(seen[k][0]) for k in (5, 12, 28)] == [True, False, True]
    assert seen[5][1] == pytest.approx(2 * drawn)
    assert seen[12][1].tolist() == [0, 0, 0, 0]
    assert seen[28][1] == pytest.approx(2 * drawn)


def test_air_touches_nothing(display: Display) -> None:
    bus = opened(display, "sim:?finger=air")
    bus.start()
    bus.write(DriveBlock(0, noise(200)))
    assert not bus.touching.any()


@pytest.mark.parametrize("options", ["", "?finger=high"])
def test_currents_belong_to_the_samples_of_the_drive(display: Display, options: str) -> None:
    """A sinusoid on each line draws 2πfC of it, without delay: to 3 % (tan δ) and 1°.

    A sample of misalignment would be 8° at 170 Hz. All 0.2 s that are compared hold whole cycles.
    """
    t = np.arange(3200) / RATE
    volts = np.zeros((len(t), 6))
    volts[:, CHANNEL] = 40 * np.cos(2 * np.pi * 170 * t)[:, None]
    bus = opened(display, f"sim:{options}")
    bus.start()
    currents = []
    for k in range(0, len(t), 64):
        bus.write(DriveBlock(k, volts[k : k + 64]))
        currents.append(bus.take_currents())
    bus.settle()
    found = np.concatenate([*currents, bus.take_currents()])
    assert found.shape == (3200, 4)
    turn = np.exp(-2j * np.pi * 170 * t[1400:3000])
    ratio = 2 * (found[1400:3000] * turn[:, None]).mean(0) / 40
    admittance = tip_response(display.bimorph, FingerLoad.high(), [170.0]).admittance[0]
    assert np.abs(ratio / admittance) == pytest.approx(np.ones(4), rel=0.03)
    assert np.degrees(np.angle(ratio / admittance)) == pytest.approx(np.zeros(4), abs=1.5)


def test_currents_are_those_of_the_plant_from_the_first_sample_on(display: Display) -> None:
    bus = opened(display, "sim:?finger=high")
    played(bus)
    plant = TouchedPlant(display.bimorph, Touch(load=FingerLoad.high()), RATE, contactors=4)
    exact = plant.step(noise(1600)[:, CHANNEL])[1][plant.delay :]
    found = bus.take_currents()
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("options", "level"), [("finger=high", 0.05), ("plant=plants_of_the_sim_test:late", 1.0)]
)
def test_windows_of_currents_belong_to_the_drive(
    display: Display, options: str, level: float
) -> None:
    """Sums over the currents at the instants of the drive, in a second stroke as well.

    Noise and steps of the converter are 1.3 µA rms, so that a sum of 80 samples is off by 1.3 µA
    √80 times the rms of the steps; six times that are allowed. A sample of misalignment would
    change the sums by their size.
    """
    bus = opened(display, f"sim:?keep=all&correlation_ms=10&{options}")
    assert bus.correlates
    volts = level * noise(1600)
    steps = np.diff(volts, axis=0, prepend=np.zeros((17, 6)))
    allowed = 6 * 1.3e-6 * np.sqrt(80) * steps.std()
    for _ in range(2):
        bus.start()
        bus.settle()
        bus.take_currents()
        for start in range(0, 1600, 64):
            bus.write(DriveBlock(start, volts[start : start + 64]))
        windows, currents = bus.take_correlations(), bus.take_currents()
        assert [w.position for w in windows] == list(range(0, 80 * len(windows), 80))
        assert len(windows) >= 18
        for w in windows:
            span = np.arange(w.position, w.position + 80)
            for lag in range(16):
                sums = np.einsum("sn,sn->n", currents[span], steps[span + 16 - lag][:, CHANNEL])
                assert np.abs(w.sums[CHANNEL, lag] - sums).max() < allowed
        bus.stop()
    assert np.abs(w.sums[CHANNEL]).max() > 3 * allowed


def test_what_the_amplifier_measures_does_not_change_the_shear(display: Display) -> None:
    """Two strokes with a rest between them, which is a sample longer where it is measured."""
    found = []
    for options in ("?finger=mid", "?finger=mid&correlation_ms=25"):
        bus = opened(display, f"sim:{options}")
        first = played(bus)
        bus.stop()
        found.append((first, bus.take_shear(), played(bus)))
    (first, rest, second), (same, longer, alike) = found
    np.testing.assert_array_equal(same, first)
    np.testing.assert_array_equal(longer[: len(rest)], rest)
    np.testing.assert_allclose(alike[100:], second[101:], rtol=0, atol=1e-3 * np.abs(second).max())


def test_of_currents_that_nobody_takes_the_last_second_is_kept(display: Display) -> None:
    bus = opened(display, "sim:?keep=all&plant=plants_of_the_sim_test:at_once")
    bus.start()
    for start in range(0, 20000, 100):
        bus.write(DriveBlock(start, noise(100)))
    assert RATE <= len(bus.take_currents()) <= RATE + 100
    assert len(bus.take_shear()) == 20000
    assert bus.take_currents().shape == (0, 4)


def test_load_of_another_plant_is_not_known(display: Display) -> None:
    bus = opened(display, "sim:?plant=plants_of_the_sim_test:late")
    with pytest.raises(InputError, match="sim: the load of another plant is not known"):
        _ = bus.touching


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("finger=medium", "sim: finger = 'medium': must be low, mid, high, air or random:SEED"),
        ("finger=random", "random:SEED"),
        ("finger=random:", "random:SEED"),
        ("finger=random:-1", "random:SEED"),
        ("finger=random:x", "random:SEED"),
        ("force=0", "sim: force = '0': must be newtons or low:high, 0.001 … 16 N"),
        ("force=2:0.2", "sim: force = '2:0.2'"),
        ("force=1:2:3", "sim: force"),
        ("force=nan", "sim: force"),
        ("force=1e3", "sim: force"),
        ("force=a:b", "sim: force"),
        ("force=", "sim: force"),
        ("period=2", "sim: period: needs a force that swings"),
        ("force=1&period=2", "sim: period: needs a force that swings"),
        ("force=1:2&period=0", "sim: period = '0': must be 0.05 … 3600"),
        ("liftoff=-1", "sim: liftoff = '-1': must be 0 … 86400"),
        ("retouch=1", "sim: retouch = 1 s: must be 5 ms after liftoff or later"),
        ("liftoff=1&retouch=1.001", "sim: retouch = 1.001 s: must be 5 ms after liftoff"),
        ("tolerance=-1", "sim: tolerance = '-1': must be 0 … 2.14748e+09"),
        ("tolerance=0.5", "sim: tolerance = '0.5': must be a whole number"),
        ("hysteresis=0.5", "sim: hysteresis = '0.5': must be 0 … 0.3"),
        ("finger=air&force=1", "sim: force: a finger in air has none"),
        ("finger=air&liftoff=1", "sim: liftoff: a finger in air has none"),
        ("plant=plants_of_the_sim_test:late&finger=low", "sim: plant: has a finger of its own"),
    ],
)
def test_mistakes_are_one_line(display: Display, options: str, said: str) -> None:
    with pytest.raises(InputError) as found:
        opened(display, f"sim:?{options}")
    assert said in str(found.value)
    assert "\n" not in str(found.value)


def test_actuators_that_are_no_bimorphs_have_no_such_finger(display: Display) -> None:
    coil = VoiceCoil(
        measured=lambda f: 1e-6 * np.ones(len(f), np.complex128), resistance=8.0, inductance=1e-4,
        largest_current=1.0, room=(1e-3, 1e-3),
    )  # fmt: skip
    with pytest.raises(InputError, match="its actuators are not bimorphs"):
        open_bus("sim:?finger=mid", replace(display, actuator=coil))
