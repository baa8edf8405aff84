"""``sim:``, the simulated display: shear aligned with drive, and anyone's plant."""

import math
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from sim_rig import (
    CHANNEL,
    HIGH,
    LOW,
    POLARITY,
    RATE,
    SLOW_AMPLIFIER,
    THREE_FORCES,
    noise,
    on_wire,
    opened,
    play,
    shuffled,
)

from tactile.actuator.plant import Plant
from tactile.bus.base import DriveBlock, Wiring
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import InputError

pytestmark = pytest.mark.usefixtures("plant")


@pytest.fixture
def low_finger(tmp_path: Path) -> Display:
    """Return a display of shuffled lines on a finger that loads little."""
    return shuffled(tmp_path, LOW)


# Shear


@pytest.mark.parametrize(
    "rest", [LOW, HIGH, SLOW_AMPLIFIER], ids=["low finger", "high finger", "slow amplifier"]
)
@pytest.mark.parametrize(
    "tones",
    [(20.0, 55.0, 90.0, 120.0), (250.0, 320.0, 410.0, 500.0), (640.0, 760.0, 880.0, 1000.0)],
)
def test_a_tone_on_a_line_shears_its_contactor_as_the_response_says(
    tmp_path: Path, rest: str, tones: tuple[float, ...]
) -> None:
    """A tone per contactor proves alignment, channel map, polarity and response at once.

    Plant and response differ by at most 0.02 dB and 0.6° (see `tactile.actuator.plant`), and
    another 0.01 dB and 0.2° in an amplifier; a sample of misalignment is 45° at 1 kHz. All tones
    have whole cycles in the 0.2 s that are compared.
    """
    display = shuffled(tmp_path, rest)
    t = np.arange(round(0.4 * RATE)) / RATE
    volts = np.zeros((len(t), 6))
    for channel, f in zip(CHANNEL, tones, strict=True):
        volts[:, channel] = 40 * np.cos(2 * np.pi * f * t)
    volts[:, [2, 4]] = 77.0
    bus = opened(display)
    bus.start()
    shear = play(bus, volts, list(range(64, len(t), 64)))
    bus.settle()
    shear = np.concatenate([shear, bus.take_shear()])
    steady = slice(round(0.2 * RATE) - 80, round(0.4 * RATE) - 80)
    expected = display.responses(np.array(tones), RATE)[0, 0]
    for i, f in enumerate(tones):
        turn = np.exp(-2j * np.pi * f * t[steady])
        ratio = 2 * np.mean(shear[steady, i] * turn) / 40
        error = POLARITY[i] * ratio / expected[i]
        assert abs(20 * np.log10(abs(error))) < 0.05
        assert abs(np.degrees(np.angle(error))) < 0.8


def test_the_shear_is_that_of_the_displays_plant_with_its_delay_taken_off(
    low_finger: Display,
) -> None:
    volts = noise(1000)
    plant = Plant(low_finger.bimorph, low_finger.load_at(1.0), RATE, contactors=4)
    drive = np.concatenate([volts[:, CHANNEL], np.zeros((plant.delay, 4))])
    expected = plant.step(drive)[0][plant.delay :] * POLARITY
    bus = opened(low_finger)
    bus.start()
    first = play(bus, volts, [])
    assert len(first) == 1000 - plant.delay
    bus.settle()
    shear = np.concatenate([first, bus.take_shear()])
    # the same sums in another order
    np.testing.assert_allclose(shear, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_how_drive_is_cut_and_shear_is_taken_does_not_matter(low_finger: Display) -> None:
    volts = noise(700)
    results = []
    for edges in ([], list(range(1, 60)), list(range(64, 700, 64)), [3, 3, 17, 18, 500]):
        bus = opened(low_finger)
        bus.start()
        shear = play(bus, volts, edges)
        bus.stop()
        bus.settle()
        results.append(np.concatenate([shear, bus.take_shear()]))
        assert len(results[-1]) == 700 + 160
    for other in results[1:]:
        # the same sums in another order
        np.testing.assert_allclose(other, results[0], rtol=0, atol=1e-12 * np.abs(other).max())


def test_shear_is_taken_once(low_finger: Display) -> None:
    bus = opened(low_finger)
    assert bus.take_shear().shape == (0, 4)
    bus.start()
    assert len(play(bus, noise(100), [])) > 0
    assert bus.take_shear().shape == (0, 4)


def test_settling_brings_the_rest_and_the_skin_to_rest(low_finger: Display) -> None:
    bus = opened(low_finger)
    bus.start()
    play(bus, noise(500), [])
    bus.stop()
    bus.settle()
    plant = Plant(low_finger.bimorph, low_finger.load_at(1.0), RATE, contactors=4)
    assert len(bus.take_shear()) == 160 + plant.delay
    assert bus.take_shear().shape == (0, 4)


def test_a_second_stroke_after_settling_is_aligned_as_the_first(low_finger: Display) -> None:
    bus = opened(low_finger, "sim:?plant=plants_of_the_sim_test:late")
    gain = 1e-9 * np.arange(1, 5) * POLARITY
    for seed in (1, 2):
        volts = noise(400, seed)
        bus.start()
        shear = play(bus, volts, [])
        bus.stop()
        bus.settle()
        shear = np.concatenate([shear, bus.take_shear()])
        np.testing.assert_allclose(shear[:400], volts[:, CHANNEL] * gain, rtol=1e-12)


def test_gaps_ramps_and_clipped_volts_are_felt_as_they_are_put_out(low_finger: Display) -> None:
    bus = opened(low_finger, "sim:?keep=all&plant=plants_of_the_sim_test:at_once")
    volts = noise(100)
    volts[50:60] *= 4
    volts[70] = math.nan
    bus.start()
    bus.write(DriveBlock(0, volts))
    bus.write(DriveBlock(150, volts))
    bus.abort()
    gain = 1e-9 * np.arange(1, 5) * POLARITY
    expected = bus.output[:, CHANNEL] * gain
    assert len(expected) > 250
    np.testing.assert_allclose(bus.take_shear(), expected, rtol=1e-12, atol=0)


def test_memory_is_flat_while_shear_is_taken(low_finger: Display) -> None:
    bus = opened(low_finger)
    block = noise(64)
    bus.start()

    def blocks(start: int, count: int) -> None:
        for k in range(start, start + count):
            bus.write(DriveBlock(64 * k, block))
            bus.take_shear()

    blocks(0, 200)
    tracemalloc.start()
    try:
        blocks(200, 200)
        before = tracemalloc.get_traced_memory()[0]
        blocks(400, 400)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 0.05 * 400 * 64 * 4 * 8, "5 % of the shear that was taken"


def test_of_shear_that_nobody_takes_the_last_second_is_kept_and_the_rest_counted(
    low_finger: Display,
) -> None:
    bus = opened(low_finger, "sim:?plant=plants_of_the_sim_test:late")
    volts = noise(30000)
    bus.start()
    for start in range(0, len(volts), 100):
        bus.write(DriveBlock(start, volts[start : start + 100]))
    shear = bus.take_shear()
    assert RATE <= len(shear) <= RATE + 100
    assert len(shear) + bus.dropped_shear == 30000 - 3
    gain = 1e-9 * np.arange(1, 5) * POLARITY
    last = volts[bus.dropped_shear : 30000 - 3, CHANNEL]
    np.testing.assert_allclose(shear, last * gain, rtol=1e-12)
    bus.write(DriveBlock(30000, volts[:50]))
    assert len(bus.take_shear()) == 50


def test_with_keep_all_no_shear_is_dropped(low_finger: Display) -> None:
    bus = opened(low_finger, "sim:?keep=all&plant=plants_of_the_sim_test:at_once")
    bus.start()
    for start in range(0, 30000, 100):
        bus.write(DriveBlock(start, noise(100)))
    assert len(bus.take_shear()) == 30000
    assert bus.dropped_shear == 0


def test_a_table_of_fingers_stands_at_its_middle_force(tmp_path: Path) -> None:
    display = shuffled(tmp_path, THREE_FORCES)
    assert display.load_forces == (0.2, 0.7, 2.0)
    volts = noise(300)
    bus = opened(display)
    bus.start()
    shear = play(bus, volts, [])
    plant = Plant(display.bimorph, display.load_at(0.7), RATE, contactors=4)
    expected = plant.step(volts[:, CHANNEL])[0][plant.delay :] * POLARITY
    # the same sums in another order
    np.testing.assert_allclose(shear, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_the_simulation_needs_a_display_not_only_its_wiring(low_finger: Display) -> None:
    class Lines:
        channels = 6
        slew = 1e5
        limits = low_finger.limits
        amplifier = low_finger.amplifier

    assert Wiring.of(Lines(), RATE).channels == 6
    with pytest.raises(InputError, match="sim: needs a Display"):
        open_bus("sim:", Lines())


# Current


def test_the_peak_current_is_the_largest_so_far_of_any_contactor(low_finger: Display) -> None:
    plant = Plant(low_finger.bimorph, low_finger.load_at(1.0), RATE, contactors=4)
    bus = opened(low_finger)
    assert bus.peak_current == 0
    bus.start()
    peak = 0.0
    for k, size in enumerate([0.1, 1.0, 0.2, -1.09]):
        volts = on_wire(size * noise(200, k))
        volts[:, [2, 4]] = 99.0
        peak = max(peak, float(np.abs(plant.step(volts[:, CHANNEL])[1]).max()))
        bus.write(DriveBlock(200 * k, volts))
        assert bus.peak_current == pytest.approx(peak, rel=1e-9)


def test_at_low_frequency_the_peak_current_is_that_into_the_capacitance(
    low_finger: Display,
) -> None:
    """2πfC·V at 100 Hz; finger and beam change the capacitance by some per cent at most."""
    t = np.arange(4000) / RATE
    volts = np.zeros((4000, 6))
    volts[:, 3] = 50 * np.sin(2 * np.pi * 100 * t) * np.minimum(t / 0.1, 1)
    bus = opened(low_finger)
    bus.start()
    bus.write(DriveBlock(0, volts))
    assert bus.peak_current == pytest.approx(2 * np.pi * 100 * low_finger.capacitance * 50, rel=0.1)


# Anyone's plant


@pytest.mark.parametrize(("name", "delay"), [("late", 3), ("at_once", 0)])
def test_anyones_plant_may_stand_behind_the_drive(
    low_finger: Display, name: str, delay: int
) -> None:
    volts = noise(300)
    bus = opened(low_finger, f"sim:?plant=plants_of_the_sim_test:{name}")
    bus.start()
    shear = play(bus, volts, [1, 2, 64, 200])
    assert len(shear) == 300 - delay
    bus.settle()
    shear = np.concatenate([shear, bus.take_shear()])
    expected = volts[:, CHANNEL] * 1e-9 * np.arange(1, 5) * POLARITY
    np.testing.assert_allclose(shear, expected, rtol=1e-12)
    assert bus.peak_current == pytest.approx(1e-6 * np.abs(volts[:, CHANNEL]).max())


def test_a_factory_is_given_display_and_sample_rate(low_finger: Display) -> None:
    open_bus("sim:?plant=plants_of_the_sim_test:late", low_finger, sample_rate=5000.0)
    assert sys.modules["plants_of_the_sim_test"].given[-1] == (low_finger, 5000.0)


@pytest.mark.parametrize(
    "spec",
    [
        "no_such_module_here:make",
        "plants_of_the_sim_test:no_such_factory",
        "plants_of_the_sim_test.inner:make",
        "plants_of_the_sim_test",
        "plants_of_the_sim_test:",
        ":late",
        "",
        ".relative:make",
        "plants_of_the_sim_test:constant",
        "plants_of_the_sim_test:of_one_argument",
        "plants_of_the_sim_test:nothing",
        "plants_of_the_sim_test:without_step",
        "plants_of_the_sim_test:without_delay",
        "plants_of_the_sim_test:with_half_a_sample",
        "plants_of_the_sim_test:with_negative_delay",
    ],
)
def test_what_is_no_plant_is_one_line_that_names_it(low_finger: Display, spec: str) -> None:
    with pytest.raises(InputError, match="sim: plant = ") as found:
        open_bus(f"sim:?plant={spec}", low_finger)
    assert repr(spec) in str(found.value)
    assert "\n" not in str(found.value)
