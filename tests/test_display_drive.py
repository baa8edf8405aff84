"""Tests of the drive in a display's file: finger, amplifier, limits, measured responses."""

import math
from pathlib import Path

import numpy as np
import pytest
from display_files import FINGER, contactors, load, refused
from scipy.signal import lfilter

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.response import tip_response
from tactile.display.display import DriveLimits, load_response
from tactile.errors import InputError, NotFoundError
from tactile.rendering.equalizer import design

# The finger

TABLE = """[finger]
[[finger.table]]
normal_force_n = 0.2
k0_n_per_m = 1000.0
d0_n_s_per_m = 0.1
branches = [[1300.0, 0.33]]
[[finger.table]]
normal_force_n = 0.8
k0_n_per_m = 4000.0
d0_n_s_per_m = 0.5
branches = [[5000.0, 2.0]]
"""


@pytest.mark.parametrize("name", ["low", "high", "none"])
def test_a_finger_by_its_preset(tmp_path: Path, name: str) -> None:
    display = load(tmp_path, FINGER.replace("low", name))
    assert display.load == getattr(FingerLoad, name)()
    assert display.load_forces == (1.0,)
    assert display.load_at(0.1) is display.load


def test_a_finger_by_its_constants(tmp_path: Path) -> None:
    text = "[finger]\nk0_n_per_m = 500.0\nd0_n_s_per_m = 0.25\nbranches = [[1.5, 2.5], [3, 4]]\n"
    branches = ((1.5, 2.5), (3.0, 4.0))
    assert load(tmp_path, text).load == FingerLoad(k0=500.0, d0=0.25, branches=branches)


def test_a_finger_by_a_table_over_its_force(tmp_path: Path) -> None:
    """Each constant runs straight between the table's forces: a third of the way at 0.4 N."""
    display = load(tmp_path, TABLE)
    assert isinstance(display.load, FingerTable)
    assert display.load_forces == (0.2, 0.8)
    between = display.load_at(0.4)
    assert (between.k0, between.d0) == pytest.approx((2000.0, 0.1 + 0.4 / 3))
    assert between.branches[0] == pytest.approx((1300 + 3700 / 3, 0.33 + 1.67 / 3))
    frequency = np.array([10.0, 250.0])
    responses = display.responses(frequency, 8000.0)
    assert responses.shape == (2, 1, 2)
    for k, force in enumerate((0.2, 0.8)):
        tip = tip_response(display.bimorph, display.load.at(force), frequency).displacement
        np.testing.assert_allclose(responses[k, 0], tip, rtol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "[finger]\n",
        "[finger]\nk0_n_per_m = 500.0\n",
        FINGER + "k0_n_per_m = 500.0\nd0_n_s_per_m = 0.25\n",
        TABLE.replace("[finger]\n", FINGER),
        TABLE.replace("[finger]\n", "[finger]\nk0_n_per_m = 1.0\nd0_n_s_per_m = 1.0\n"),
    ],
    ids=["nothing", "half", "preset and constants", "preset and table", "constants and table"],
)
def test_a_finger_is_given_in_one_way(tmp_path: Path, text: str) -> None:
    assert "finger: needs either preset, or" in refused(tmp_path, text)


@pytest.mark.parametrize(
    "text",
    [
        FINGER + "branches = [[1.0, 2.0]]\n",
        FINGER + "k0_n_per_m = 500.0\n",
        TABLE.replace("[finger]\n", "[finger]\nbranches = [[1.0, 2.0]]\n"),
        TABLE.replace("[finger]\n", "[finger]\nd0_n_s_per_m = 1.0\n"),
    ],
    ids=["preset, branches", "preset, k0", "table, branches", "table, d0"],
)
def test_a_finger_s_key_that_would_go_unused_is_refused(tmp_path: Path, text: str) -> None:
    assert "finger" in refused(tmp_path, text)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("force_n = 0.8", "force_n = 0.1", "does not ascend"),
        ("[[5000.0, 2.0]]", "[]", "branches"),
    ],
)
def test_a_finger_s_table_that_makes_no_sense_is_refused(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert words in refused(tmp_path, TABLE.replace(old, new))


# The amplifier


def test_an_amplifier_is_as_in_its_table(tmp_path: Path) -> None:
    text = "gain = 20.0\nbandwidth_hz = 5e3\noutput_resistance_ohm = 1e3\nhold = 'zoh'\n"
    display = load(tmp_path, f"[amplifier]\n{text}delay_us = 50.0\n", "[limits]\nvoltage_v = 5.0\n")
    amplifier = Amplifier(gain=20.0, bandwidth=5e3, output_resistance=1e3, hold="zoh", delay=50e-6)
    assert vars(display.amplifier) == pytest.approx(vars(amplifier))
    frequency = np.array([10.0, 400.0, 1000.0])
    tip = tip_response(display.bimorph, display.load_at(1.0), frequency)
    held = np.sinc(frequency / 8000) * np.exp(-1j * np.pi * frequency / 8000)
    late = np.exp(-2j * np.pi * frequency * 50e-6)
    volts = 20 * held * late / (1 + 1j * frequency / 5e3) / (1 + 1e3 * tip.admittance)
    np.testing.assert_allclose(
        display.responses(frequency, 8000.0)[0, 0], tip.displacement * volts, rtol=1e-12
    )


def test_a_hold_that_would_draw_infinite_current_is_refused(tmp_path: Path) -> None:
    assert "infinite current" in refused(tmp_path, "[amplifier]\nhold = 'zoh'\n")


# What an audio card needs to know


def test_a_card_is_calibrated_in_the_table_of_the_amplifier(tmp_path: Path) -> None:
    text = "[amplifier]\naudio_full_scale_v = 125.0\nac_coupling_hz = 2.0\n"
    amplifier = load(tmp_path, text, "[limits]\nvoltage_v = 50.0\n").amplifier
    assert (amplifier.audio_full_scale, amplifier.ac_coupling) == (125.0, 2.0)
    amplifier = load(tmp_path).amplifier
    assert (amplifier.audio_full_scale, amplifier.ac_coupling) == (None, 0.0)


@pytest.mark.parametrize(
    "line", ["audio_full_scale_v = 0.0", "ac_coupling_hz = 0.0", "ac_coupling_hz = 51.0"]
)
def test_a_card_out_of_range_is_named(tmp_path: Path, line: str) -> None:
    assert line.partition(" ")[0] in refused(tmp_path, f"[amplifier]\n{line}\n")


def test_behind_ac_coupling_electrodes_may_see_twice_the_drive() -> None:
    """A first-order high-pass of a drive at one limit, long, then at the other."""
    corner, rate = 2.0, 8000.0
    drive = np.repeat([-1.0, 1.0], 8 * round(rate / corner))
    pole = np.exp(-2 * np.pi * corner / rate)
    electrodes = lfilter([(1 + pole) / 2, -(1 + pole) / 2], [1, -pole], drive)
    amplifier = Amplifier(gain=3.0, ac_coupling=corner)
    assert 3 * np.abs(electrodes).max() == pytest.approx(amplifier.peak, rel=1e-3)
    assert Amplifier(gain=3.0).peak == 3.0


def test_the_check_of_the_field_counts_it(tmp_path: Path) -> None:
    coupled = "[amplifier]\nac_coupling_hz = 2.0\n"
    said = refused(tmp_path, coupled, "[limits]\nvoltage_v = 100.0\n")
    assert ", twice that behind AC coupling: " in said
    assert "at most 52 V" in said


@pytest.mark.ci
def test_the_coupling_is_not_in_the_response_for_no_filter_of_the_equalizer_inverts_it() -> None:
    """Left alone 1 Hz costs |1/(1 − 0.1j) − 1| ≈ 0.1 at 10 Hz; designed for, it costs as much."""
    frequency = np.arange(0, 1251, 10, dtype=np.float64)
    admittance = np.zeros(len(frequency), np.complex128)
    coupled, direct = Amplifier(ac_coupling=1.0), Amplifier()
    assert np.array_equal(
        coupled.response(frequency, admittance, 8000.0),
        direct.response(frequency, admittance, 8000.0),
    )
    high_pass = np.array([1.0, *1 / (1 + 1 / (1j * frequency[1:]))])
    assert abs(high_pass[1] - 1) == pytest.approx(0.0995, abs=1e-4)
    response = np.asarray(1e-6 * high_pass[None, None], np.complex128)
    assert design(response, 100.0, 8000.0).error > 0.05


def test_limits_are_as_in_their_table(tmp_path: Path) -> None:
    text = "[limits]\nvoltage_v = 80.0\nslew_v_per_us = 0.25\ncurrent_ma = 2.5\nfade_ms = 35.0\n"
    limits = DriveLimits(voltage=80.0, slew=0.25e6, current=2.5e-3, fade=35e-3)
    assert vars(load(tmp_path, text).limits) == pytest.approx(vars(limits))
    assert load(tmp_path).limits == DriveLimits(
        voltage=100.0, slew=0.7e6, current=math.inf, fade=20e-3
    )


# Measured responses

ROWS = ["10,2.0,0,um/V", "100,1.0,-30,um/V", "1000,4.0,-170,um/V", "2000,0.5,170,um/V"]


def response_file(folder: Path, rows: list[str], name: str = "r.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(["frequency_hz,magnitude,phase_deg,unit", *rows]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("unit", "scale"), [("m/V", 1.0), ("um/V", 1e6), ("µm/V", 1e6), ("nm/V", 1e9)]
)
def test_a_measured_response_is_in_the_unit_that_it_states(
    tmp_path: Path, unit: str, scale: float
) -> None:
    rows = [f"{f},{3e-6 * scale!r},90,{unit}" for f in (20, 1000)]
    measured = load_response(response_file(tmp_path, rows))
    np.testing.assert_allclose(measured.at(np.array([20.0, 1000.0])), 3e-6j, rtol=1e-12)


def test_every_row_of_a_measured_response_has_its_own_unit(tmp_path: Path) -> None:
    rows = ["20,3e-6,0,m/V", "200,3.0,0,um/V", "1000,3000,0,nm/V"]
    measured = load_response(response_file(tmp_path, rows))
    np.testing.assert_allclose(measured.magnitude, 3e-6, rtol=1e-12)


def test_a_measured_response_runs_straight_in_decibels_and_unwrapped_phase(tmp_path: Path) -> None:
    """Half way between 1000 and 2000 Hz: √(4 × 0.5) µm/V, and −170° → −190°, not through 0."""
    measured = load_response(response_file(tmp_path, ROWS))
    middle = measured.at(np.array([55.0, 550.0, 1500.0]))
    np.testing.assert_allclose(np.abs(middle), np.sqrt([2.0, 4.0, 2.0]) * 1e-6, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(np.angle(-middle[2:])), 0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(np.angle(middle[:2])), [-15, -100], atol=1e-9)
    ends = measured.at(np.array([0.0, 10.0, 2000.0, 9000.0]))
    np.testing.assert_allclose(
        ends, 1e-6 * np.array([2, 2, *[0.5 * np.exp(2j * np.pi * 170 / 360)] * 2])
    )


def test_a_measured_response_replaces_the_model_for_a_group_and_for_one_contactor(
    tmp_path: Path,
) -> None:
    """Each replaces the response of its own kind; the measurement includes the amplifier."""
    response_file(tmp_path, ROWS, "one.csv")
    response_file(tmp_path, [row.replace("um/V", "nm/V") for row in ROWS], "group.csv")
    places = [(5.0 * i, 0.0, 0.0) for i in range(5)]
    text = contactors(*places).replace("channel = 3\n", 'channel = 3\nresponse = "one.csv"\n')
    group = '[[group]]\nresponse = "group.csv"\ncontactors = [0, 2]\n'
    limits = "[limits]\nvoltage_v = 50.0\n"
    display = load(tmp_path, text, group, limits, "[amplifier]\ngain = 2.0\n")
    assert len(display.measured) == 2
    assert len(set(display.kind[[0, 2]])) == 1
    assert display.kind[[1, 4]].tolist() == [0, 0]
    responses = display.responses(np.array([10.0, 100.0]), 8000.0)
    assert responses.shape == (1, 3, 2)
    turn = np.exp(1j * np.radians([0, -30]))
    np.testing.assert_allclose(responses[0, display.kind[3]], [2e-6, 1e-6] * turn, rtol=1e-12)
    np.testing.assert_allclose(responses[0, display.kind[0]], [2e-9, 1e-9] * turn, rtol=1e-12)
    tip = tip_response(display.bimorph, display.load_at(1.0), [10.0, 100.0]).displacement
    np.testing.assert_allclose(responses[0, 0], 2 * tip, rtol=1e-12)


def test_a_group_without_members_is_all_contactors_and_one_file_is_one_kind(
    tmp_path: Path,
) -> None:
    response_file(tmp_path, ROWS)
    display = load(tmp_path, '[[group]]\nresponse = "r.csv"\n')
    assert display.kind.tolist() == [1] * 6
    assert len(display.measured) == 1


def test_a_measured_response_does_not_depend_on_the_finger_s_force(tmp_path: Path) -> None:
    response_file(tmp_path, ROWS)
    display = load(tmp_path, '[[group]]\nresponse = "r.csv"\ncontactors = [0]\n', TABLE)
    responses = display.responses(np.array([100.0]), 8000.0)
    assert responses.shape == (2, 2, 1)
    assert responses[0, 1, 0] == responses[1, 1, 0]
    assert responses[0, 0, 0] != responses[1, 0, 0]


def test_a_group_names_only_contactors_that_there_are(tmp_path: Path) -> None:
    response_file(tmp_path, ROWS)
    message = refused(tmp_path, '[[group]]\nresponse = "r.csv"\ncontactors = [0, 6]\n')
    assert "group[0].contactors: 6 is not below 6" in message


def test_a_measured_response_that_is_missing_is_not_found(tmp_path: Path) -> None:
    """The file is looked for beside that of the display."""
    with pytest.raises(NotFoundError, match=r"none\.csv: no such file"):
        load(tmp_path, '[[group]]\nresponse = "none.csv"\n')


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (ROWS[1:], ("frequency_hz", "covers 100 … 2000 Hz", "must cover 20 … 1000 Hz")),
        (ROWS[:2], ("frequency_hz", "covers 10 … 100 Hz", "must cover 20 … 1000 Hz")),
        ([ROWS[0], ROWS[2], ROWS[1], ROWS[3]], ("ascending frequencies",)),
        ([ROWS[0], ROWS[2], ROWS[2], ROWS[3]], ("ascending frequencies",)),
        ([ROWS[0], "100,0,0,um/V", ROWS[3]], ("magnitudes above 0",)),
        ([ROWS[0], "100,-1,0,um/V", ROWS[3]], ("magnitudes above 0",)),
        (ROWS[:1], ("two or more",)),
        ([], ("two or more",)),
        ([ROWS[0], "100,1,0,mm/V", ROWS[3]], ("line 3", "unit = 'mm/V'", "m/V, um/V, µm/V, nm/V")),
        ([ROWS[0], "100,1,0", ROWS[3]], ("line 3", "unit = None")),
        ([ROWS[0], "100,nan,0,um/V", ROWS[3]], ("line 3", "magnitude = 'nan'", "finite")),
        ([ROWS[0], "100,1,inf,um/V", ROWS[3]], ("line 3", "phase_deg = 'inf'", "finite")),
        ([ROWS[0], "x,1,0,um/V", ROWS[3]], ("line 3", "frequency_hz = 'x'", "finite")),
    ],
)
def test_a_measured_response_that_cannot_be_used_is_refused(
    tmp_path: Path, rows: list[str], words: tuple[str, ...]
) -> None:
    path = response_file(tmp_path, rows)
    with pytest.raises(InputError) as caught:
        load_response(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("column", ["frequency_hz", "magnitude", "phase_deg", "unit"])
def test_a_measured_response_without_a_column_is_refused_by_its_name(
    tmp_path: Path, column: str
) -> None:
    path = response_file(tmp_path, ROWS)
    path.write_text(path.read_text(encoding="utf-8").replace(column, "other"), encoding="utf-8")
    with pytest.raises(InputError, match=f"no column '{column}'"):
        load_response(path)
