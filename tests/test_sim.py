"""``sim:``, the simulated display: shear aligned with drive, anyone's plant, and the judge."""

import math
import sys
import tracemalloc
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from tactile.actuator.plant import Plant
from tactile.bus.base import DriveBlock, Wiring
from tactile.devices import open_bus
from tactile.display import Display, load_display
from tactile.errors import InputError
from tactile.sim import Fidelity, SimulatedDisplay

Floats = NDArray[np.float64]

RATE = 8000.0
DISPLAY = """
[display]
id = "shuffled"
description = "Four contactors on shuffled lines, two of them mounted the other way round"
opening_mm = [2.0, 3.0]
[[contactor]]
position_mm = [0.0, 0.0]
channel = 5
[[contactor]]
position_mm = [3.0, 0.0]
channel = 0
polarity = -1
[[contactor]]
position_mm = [6.0, 0.0]
channel = 3
polarity = -1
[[contactor]]
position_mm = [9.0, 0.0]
channel = 1
[limits]
voltage_v = 100.0
"""
LOW = '[finger]\npreset = "low"\n'
HIGH = '[finger]\npreset = "high"\n'
THREE_FORCES = """
[finger]
[[finger.table]]
normal_force_n = 0.2
k0_n_per_m = 200.0
d0_n_s_per_m = 0.1
[[finger.table]]
normal_force_n = 0.7
k0_n_per_m = 700.0
d0_n_s_per_m = 0.4
[[finger.table]]
normal_force_n = 2.0
k0_n_per_m = 2000.0
d0_n_s_per_m = 1.0
"""
SLOW_AMPLIFIER = LOW + (
    "[amplifier]\ngain = 0.5\nbandwidth_hz = 3000.0\noutput_resistance_ohm = 2000.0\n"
    "delay_us = 700.0\n"
)
CHANNEL = [5, 0, 3, 1]
POLARITY = np.array([1.0, -1.0, -1.0, 1.0])

PLANTS = '''
given = []


class Late:
    """1, 2, 3 and 4 nm/V, so many samples late; draws 1 µA/V."""

    def __init__(self, delay, contactors):
        self.delay, self._past = delay, [[0.0] * contactors] * delay

    def step(self, drive):
        import numpy as np

        line = np.concatenate([np.reshape(self._past, (-1, drive.shape[1])), drive])
        self._past = line[len(drive):]
        return 1e-9 * np.arange(1, 5) * line[: len(drive)], 1e-6 * drive


class Bare:
    pass


def late(display, sample_rate):
    given.append((display, sample_rate))
    return Late(3, len(display.contactors))


def at_once(display, sample_rate):
    return Late(0, len(display.contactors))


def nothing(display, sample_rate):
    return None


def without_step(display, sample_rate):
    plant = Bare()
    plant.delay = 3
    return plant


def without_delay(display, sample_rate):
    plant = Late(3, 4)
    del plant.delay
    return plant


def with_half_a_sample(display, sample_rate):
    plant = Late(3, 4)
    plant.delay = 0.5
    return plant


def with_negative_delay(display, sample_rate):
    plant = Late(3, 4)
    plant.delay = -3
    return plant


def of_one_argument(display):
    return Late(3, 4)


constant = 3.0
'''


@pytest.fixture(scope="module", autouse=True)
def _plants(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("plants")
    (folder / "plants_of_the_sim_test.py").write_text(PLANTS, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield
    sys.modules.pop("plants_of_the_sim_test", None)


def shuffled(folder: Path, rest: str) -> Display:
    path = folder / "shuffled.toml"
    path.write_text(DISPLAY + rest, encoding="utf-8")
    return load_display(path)


@pytest.fixture
def display(tmp_path: Path) -> Display:
    return shuffled(tmp_path, LOW)


def opened(display: Display, url: str = "sim:") -> SimulatedDisplay:
    bus = open_bus(url, display, sample_rate=RATE)
    assert isinstance(bus, SimulatedDisplay)
    return bus


def noise(count: int, seed: int = 0) -> Floats:
    """Return samples for six lines [V] that the wire carries exactly, within the slew limit."""
    return on_wire(np.random.default_rng(seed).uniform(-40, 40, (count, 6)))


def on_wire(volts: Floats) -> Floats:
    """Return volts rounded to the amplifier's codes, 32767 for the limit of 100 V."""
    return np.asarray(np.rint(volts * 327.67) / 327.67)


def play(bus: SimulatedDisplay, volts: Floats, edges: list[int]) -> Floats:
    """Write blocks that end at the edges, taking the shear after each; return all of it."""
    taken = []
    for start, end in pairwise([0, *edges, len(volts)]):
        bus.write(DriveBlock(start, volts[start:end]))
        taken.append(bus.take_shear())
    return np.concatenate(taken)


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


def test_the_shear_is_that_of_the_displays_plant_with_its_delay_taken_off(display: Display) -> None:
    volts = noise(1000)
    plant = Plant(display.bimorph, display.load_at(1.0), RATE, contactors=4)
    drive = np.concatenate([volts[:, CHANNEL], np.zeros((plant.delay, 4))])
    expected = plant.step(drive)[0][plant.delay :] * POLARITY
    bus = opened(display)
    bus.start()
    first = play(bus, volts, [])
    assert len(first) == 1000 - plant.delay
    bus.settle()
    shear = np.concatenate([first, bus.take_shear()])
    # the same sums in another order
    np.testing.assert_allclose(shear, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_how_drive_is_cut_and_shear_is_taken_does_not_matter(display: Display) -> None:
    volts = noise(700)
    results = []
    for edges in ([], list(range(1, 60)), list(range(64, 700, 64)), [3, 3, 17, 18, 500]):
        bus = opened(display)
        bus.start()
        shear = play(bus, volts, edges)
        bus.stop()
        bus.settle()
        results.append(np.concatenate([shear, bus.take_shear()]))
        assert len(results[-1]) == 700 + 160
    for other in results[1:]:
        # the same sums in another order
        np.testing.assert_allclose(other, results[0], rtol=0, atol=1e-12 * np.abs(other).max())


def test_shear_is_taken_once(display: Display) -> None:
    bus = opened(display)
    assert bus.take_shear().shape == (0, 4)
    bus.start()
    assert len(play(bus, noise(100), [])) > 0
    assert bus.take_shear().shape == (0, 4)


def test_settling_brings_the_rest_and_the_skin_to_rest(display: Display) -> None:
    bus = opened(display)
    bus.start()
    play(bus, noise(500), [])
    bus.stop()
    bus.settle()
    assert len(bus.take_shear()) == pytest.approx(160 + bus._plant.delay)
    assert bus.take_shear().shape == (0, 4)


def test_a_second_stroke_after_settling_is_aligned_as_the_first(display: Display) -> None:
    bus = opened(display, "sim:?plant=plants_of_the_sim_test:late")
    gain = 1e-9 * np.arange(1, 5) * POLARITY
    for seed in (1, 2):
        volts = noise(400, seed)
        bus.start()
        shear = play(bus, volts, [])
        bus.stop()
        bus.settle()
        shear = np.concatenate([shear, bus.take_shear()])
        np.testing.assert_allclose(shear[:400], volts[:, CHANNEL] * gain, rtol=1e-12)


def test_gaps_ramps_and_clipped_volts_are_felt_as_they_are_put_out(display: Display) -> None:
    bus = opened(display, "sim:?keep=all&plant=plants_of_the_sim_test:at_once")
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


def test_memory_is_flat_while_shear_is_taken(display: Display) -> None:
    bus = opened(display)
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
    display: Display,
) -> None:
    bus = opened(display, "sim:?plant=plants_of_the_sim_test:late")
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


def test_with_keep_all_no_shear_is_dropped(display: Display) -> None:
    bus = opened(display, "sim:?keep=all&plant=plants_of_the_sim_test:at_once")
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


def test_the_simulation_needs_a_display_not_only_its_wiring(display: Display) -> None:
    class Lines:
        channels = 6
        slew = 1e5
        limits = display.limits
        amplifier = display.amplifier

    assert Wiring.of(Lines(), RATE).channels == 6
    with pytest.raises(InputError, match="sim: needs a Display"):
        open_bus("sim:", Lines())


# Current


def test_the_peak_current_is_the_largest_so_far_of_any_contactor(display: Display) -> None:
    plant = Plant(display.bimorph, display.load_at(1.0), RATE, contactors=4)
    bus = opened(display)
    assert bus.peak_current == 0
    bus.start()
    peak = 0.0
    for k, size in enumerate([0.1, 1.0, 0.2, -1.09]):
        volts = on_wire(size * noise(200, k))
        volts[:, [2, 4]] = 99.0
        peak = max(peak, float(np.abs(plant.step(volts[:, CHANNEL])[1]).max()))
        bus.write(DriveBlock(200 * k, volts))
        assert bus.peak_current == pytest.approx(peak, rel=1e-9)


def test_at_low_frequency_the_peak_current_is_that_into_the_capacitance(display: Display) -> None:
    """2πfC·V at 100 Hz; finger and beam change the capacitance by some per cent at most."""
    t = np.arange(4000) / RATE
    volts = np.zeros((4000, 6))
    volts[:, 3] = 50 * np.sin(2 * np.pi * 100 * t) * np.minimum(t / 0.1, 1)
    bus = opened(display)
    bus.start()
    bus.write(DriveBlock(0, volts))
    assert bus.peak_current == pytest.approx(2 * np.pi * 100 * display.capacitance * 50, rel=0.1)


# Anyone's plant


@pytest.mark.parametrize(("name", "delay"), [("late", 3), ("at_once", 0)])
def test_anyones_plant_may_stand_behind_the_drive(display: Display, name: str, delay: int) -> None:
    volts = noise(300)
    bus = opened(display, f"sim:?plant=plants_of_the_sim_test:{name}")
    bus.start()
    shear = play(bus, volts, [1, 2, 64, 200])
    assert len(shear) == 300 - delay
    bus.settle()
    shear = np.concatenate([shear, bus.take_shear()])
    expected = volts[:, CHANNEL] * 1e-9 * np.arange(1, 5) * POLARITY
    np.testing.assert_allclose(shear, expected, rtol=1e-12)
    assert bus.peak_current == pytest.approx(1e-6 * np.abs(volts[:, CHANNEL]).max())


def test_a_factory_is_given_display_and_sample_rate(display: Display) -> None:
    open_bus("sim:?plant=plants_of_the_sim_test:late", display, sample_rate=5000.0)
    assert sys.modules["plants_of_the_sim_test"].given[-1] == (display, 5000.0)


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
def test_what_is_no_plant_is_one_line_that_names_it(display: Display, spec: str) -> None:
    with pytest.raises(InputError, match="sim: plant = ") as found:
        open_bus(f"sim:?plant={spec}", display)
    assert repr(spec) in str(found.value)
    assert "\n" not in str(found.value)


# The judge


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
