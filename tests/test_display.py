"""A display's file says what stands where and what must never be exceeded; the rest is refused.

Geometry is checked against a brute force that samples points, the room that a bender needs
against the closed form of its static deflection, arrays against what is written in the file.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.materials import CFRP, PIEZO_3203HD
from tactile.actuator.response import tip_response
from tactile.display import Display, Limits, load_display, load_response
from tactile.errors import InputError, NotFoundError
from tactile.rendering.equalizer import design

Floats = NDArray[np.float64]

HEAD = '[display]\nid = "sample"\ndescription = "written by a test"\nopening_mm = [2.0, 3.0]\n'
GRID = "[grid]\ncolumns = 3\nrows = 2\npitch_mm = [2.5, 3.5]\n"
FINGER = '[finger]\npreset = "low"\n'
LIMITS = "[limits]\nvoltage_v = 100.0\n"


def contactors(*places: tuple[float, float, float]) -> str:
    """Return the tables of contactors at x and y [mm] that shear along an angle [deg]."""
    return "".join(
        f"[[contactor]]\nposition_mm = [{x!r}, {y!r}]\nchannel = {i}\nshear_direction_deg = {a!r}\n"
        for i, (x, y, a) in enumerate(places)
    )


def load(folder: Path, *parts: str) -> Display:
    """Load a display; a part is left as it is unless one with the same first line is given."""
    texts = {part.split("\n")[0]: part for part in (HEAD, GRID, FINGER, LIMITS, *parts)}
    if any(part.startswith("[[contactor]]") for part in parts):
        del texts["[grid]"]
    path = folder / "sample.toml"
    path.write_text("".join(texts.values()))
    return load_display(path)


def refused(folder: Path, *parts: str) -> str:
    """Return the one line that a display is refused with."""
    with pytest.raises(InputError) as caught:
        load(folder, *parts)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def number(message: str, before: str, after: str) -> float:
    """Return the number that a message prints between two words."""
    return float(message.split(before)[1].split(after)[0])


# What is shipped


@pytest.mark.parametrize(
    ("name", "columns", "rows"), [("reference-24", 6, 4), ("reference-64", 8, 8)]
)
def test_the_reference_displays_are_grids_around_the_origin(
    name: str, columns: int, rows: int
) -> None:
    display = load_display(name)
    count = columns * rows
    assert display.name == name
    assert display.contactors.shape == (count, 2)
    for i, (x, y) in enumerate(display.contactors * 1e3):
        assert x == pytest.approx(2.5 * (i % columns - (columns - 1) / 2), abs=1e-12)
        assert y == pytest.approx(3.5 * (i // columns - (rows - 1) / 2), abs=1e-12)
    np.testing.assert_allclose(display.contactors.mean(axis=0), 0, atol=1e-15)
    assert display.opening == pytest.approx((2e-3, 3e-3))
    assert display.channel.tolist() == list(range(count))
    assert display.channels == count
    assert display.polarity.tolist() == [1] * count
    assert display.shear_axes.tolist() == [[1, 0]] * count
    assert display.kind.tolist() == [0] * count
    assert display.measured == ()
    assert not display.projected
    assert display.load == FingerLoad.low()
    assert display.amplifier == Amplifier()
    assert vars(display.bimorph) == pytest.approx(vars(Bimorph()))
    limits = Limits(voltage=100.0, slew=0.7e6, current=10e-3, fade=20e-3)
    assert vars(display.limits) == pytest.approx(vars(limits))


def test_the_reference_bender_has_the_capacitance_that_its_file_states() -> None:
    """12.8 nF, to the digits printed: 10 mA would give 0.78 V/µs, and 0.7 is what limits."""
    display = load_display("reference-24")
    assert display.capacitance == pytest.approx(12.8e-9, abs=0.05e-9)
    assert 10e-3 / display.capacitance == pytest.approx(0.78e6, abs=0.005e6)
    assert display.limits.step(8000.0, display.capacitance) == pytest.approx(87.5)


def test_a_missing_display_is_answered_with_the_nearest() -> None:
    with pytest.raises(NotFoundError, match="did you mean 'reference-64'"):
        load_display("refrence-64")


def test_another_finger_may_be_given_when_loading() -> None:
    finger = FingerLoad(k0=1.0, d0=2.0)
    assert load_display("reference-24", load=finger).load is finger


# Where contactors stand


def test_a_grid_is_numbered_along_x_first_and_from_its_first_channel(tmp_path: Path) -> None:
    more = "first_channel = 7\nshear_direction_deg = 90.0\npolarity = -1\n"
    display = load(tmp_path, GRID.replace("[2.5, 3.5]", "[3.5, 2.5]") + more)
    expected = [(x, y) for y in (-1.25, 1.25) for x in (-3.5, 0.0, 3.5)]
    np.testing.assert_allclose(display.contactors * 1e3, expected, atol=1e-12)
    assert display.channel.tolist() == [7, 8, 9, 10, 11, 12]
    assert display.channels == 13
    assert display.polarity.tolist() == [-1] * 6
    np.testing.assert_allclose(display.shear_axes, [[0, 1]] * 6, atol=1e-15)


def test_contactors_stand_and_shear_as_each_is_told(tmp_path: Path) -> None:
    places = [(0.0, 0.0, 0.0), (5.0, -1.0, 30.0), (-5.0, 2.0, -120.0)]
    text = contactors(*places).replace("channel = 1\n", "channel = 9\npolarity = -1\n")
    display = load(tmp_path, HEAD + 'shear_projection = "motion"\n', text)
    np.testing.assert_allclose(display.contactors * 1e3, [place[:2] for place in places])
    for axis, (_, _, angle) in zip(display.shear_axes, places, strict=True):
        turn = math.radians(angle)
        assert axis == pytest.approx([math.cos(turn), math.sin(turn)], abs=1e-15)
    assert display.channel.tolist() == [0, 9, 2]
    assert display.polarity.tolist() == [1, -1, 1]
    assert display.projected


@pytest.mark.parametrize("parts", [GRID + contactors((20.0, 0.0, 0.0)), "[grid]"])
def test_a_display_has_either_a_grid_or_contactors(tmp_path: Path, parts: str) -> None:
    path = tmp_path / "sample.toml"
    path.write_text(HEAD + (parts if len(parts) > 6 else "") + FINGER + LIMITS)
    with pytest.raises(InputError, match=r"needs either \[grid\] or \[\[contactor\]\]"):
        load_display(path)


def test_a_grid_s_channels_are_in_the_same_range_as_a_contactor_s(tmp_path: Path) -> None:
    """Channels are below 4096; this grid would reach 4100."""
    assert "4096" in refused(tmp_path, GRID + "first_channel = 4095\n")


def test_drive_is_put_on_the_lines_of_its_contactors_and_the_others_rest(tmp_path: Path) -> None:
    text = contactors((0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (10.0, 0.0, 0.0))
    text = text.replace("channel = 0", "channel = 5").replace("channel = 2", "channel = 3")
    display = load(tmp_path, text)
    drive = np.arange(12.0).reshape(4, 3) + 1
    lines = display.to_channels(drive)
    assert lines.shape == (4, 6)
    for line, contactor in ((5, 0), (1, 1), (3, 2)):
        np.testing.assert_array_equal(lines[:, line], drive[:, contactor])
    assert not np.any(lines[:, [0, 2, 4]])
    assert display.to_channels(drive[:0]).shape == (0, 6)


def test_a_channel_that_is_used_twice_is_named(tmp_path: Path) -> None:
    text = contactors((0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (10.0, 0.0, 0.0))
    message = refused(tmp_path, text.replace("channel = 2", "channel = 1"))
    assert "channel 1 drives more than one contactor" in message


# What does not fit


def points_inside(
    inner: tuple[float, float, float], outer: tuple[float, float, float], *, grown: float
) -> bool:
    """Return whether one of 61 × 61 points of an opening lies within another, grown [mm]."""
    steps = np.linspace(-1, 1, 61)
    points = np.stack(np.meshgrid(1.0 * steps, 1.5 * steps), axis=-1).reshape(-1, 2)
    turn = math.radians(inner[2])
    x = inner[0] - outer[0] + points @ [math.cos(turn), -math.sin(turn)]
    y = inner[1] - outer[1] + points @ [math.sin(turn), math.cos(turn)]
    turn = math.radians(outer[2])
    along = np.abs(x * math.cos(turn) + y * math.sin(turn))
    across = np.abs(-x * math.sin(turn) + y * math.cos(turn))
    return bool(np.any((along < 1.0 + grown) & (across < 1.5 + grown)))


def test_openings_that_overlap_are_found_and_no_others(tmp_path: Path) -> None:
    """At any angle, against sampled points 0.05 mm apart or closer.

    A point of one in the other proves an overlap; none in the other grown by 0.05 mm, either way
    round, proves that there is none. Pairs between are not counted.
    """
    rng = np.random.default_rng(2)
    found = {True: 0, False: 0}
    far = (60.0, 0.0, 45.0)
    for _ in range(150):
        angle = rng.uniform(0, 2 * np.pi)
        away = rng.uniform(1.8, 3.6)
        one = (0.0, 0.0, float(rng.uniform(-180, 180)))
        other = (
            float(away * math.cos(angle)),
            float(away * math.sin(angle)),
            float(rng.choice([rng.uniform(-180, 180), one[2], one[2] - 90 * np.sign(one[2])])),
        )
        surely = points_inside(one, other, grown=0.0) or points_inside(other, one, grown=0.0)
        apart = not (points_inside(one, other, grown=0.05) or points_inside(other, one, grown=0.05))
        if surely == apart:
            continue
        found[surely] += 1
        if surely:
            message = refused(tmp_path, contactors(one, far, other))
            assert "contactors 0 and 2 overlap" in message
            assert "2 × 3 mm" in message
        else:
            load(tmp_path, contactors(one, far, other))
    assert min(found.values()) > 40


@pytest.mark.parametrize("pitch", ["[2.0, 3.0]", "[2.5, 3.0]"])
def test_openings_that_touch_do_not_overlap(tmp_path: Path, pitch: str) -> None:
    load(tmp_path, GRID.replace("[2.5, 3.5]", pitch))


@pytest.mark.parametrize("pitch", ["[1.999, 3.5]", "[2.5, 2.999]", "[0.0025, 0.0035]"])
def test_a_grid_that_is_too_narrow_for_its_openings_is_refused(tmp_path: Path, pitch: str) -> None:
    """The last one is in meters."""
    assert "overlap" in refused(tmp_path, GRID.replace("[2.5, 3.5]", pitch))


def static_travel(voltage: float) -> float:
    """Return the tip's static deflection in air [m]: K U l²/(2 EI), a uniform moment."""
    b, p = Bimorph(), PIEZO_3203HD
    w, hp, hs, length = (np.asarray(x) for x in (b.width, b.piezo_height, b.shim_height, b.length))
    both = 2 / 3 * ((hp + hs / 2) ** 3 - (hs / 2) ** 3)
    EI = w * (hs**3 / 12 / CFRP.s11 + both / p.s11E)
    K = w * np.abs(p.d31) * (hs + hp) / p.s11E
    return float(K * voltage * length**2 / (2 * EI))


@pytest.mark.parametrize("voltage", [40.0, 100.0])
def test_a_bender_needs_room_for_its_height_and_its_travel_both_ways(
    tmp_path: Path, voltage: float
) -> None:
    """0.72 mm and twice the deflection at full drive, which losses change by less than 0.1 %."""
    limits = LIMITS.replace("100.0", str(voltage))
    needs = 0.72 + 2e3 * static_travel(voltage)
    load(tmp_path, limits, HEAD.replace("2.0,", f"{needs * 1.001:.5f},"))
    message = refused(tmp_path, limits, HEAD.replace("2.0,", f"{needs * 0.999:.5f},"))
    for words in ("display.opening_mm", f"{needs * 0.999:g}"[:5], "mm along"):
        assert words in message
    assert number(message, "needs ", " mm") == pytest.approx(needs, abs=0.01)


def test_the_room_that_a_bender_needs_counts_the_amplifier_s_gain(tmp_path: Path) -> None:
    """5 V of drive through a gain of 20 bend it as 100 V do; the opening fits it at 5 V only."""
    needs = 0.72 + 2e3 * static_travel(100.0)
    parts = [LIMITS.replace("100.0", "5.0"), HEAD.replace("2.0,", f"{needs * 0.98:.5f},")]
    load(tmp_path, *parts)
    assert "display.opening_mm" in refused(tmp_path, *parts, "[amplifier]\ngain = 20.0\n")


@pytest.mark.parametrize(("across", "fits"), [(2.11, True), (2.09, False)])
def test_a_bender_needs_room_for_its_width(tmp_path: Path, across: float, fits: bool) -> None:
    head = HEAD.replace("3.0", str(across))
    if fits:
        load(tmp_path, head)
    else:
        message = refused(tmp_path, head)
        for words in ("display.opening_mm", "2.09 mm across"):
            assert words in message
        assert number(message, "needs ", " mm") == pytest.approx(2.1, abs=0.01)


@pytest.mark.parametrize(
    ("voltage", "gain", "height", "most"),
    [(104.0, 1.0, 0.26, 104), (10.4, 10.0, 0.26, 10.4), (80.0, 1.0, 0.20, 80)],
)
def test_no_drive_reaches_half_the_coercive_field(
    tmp_path: Path, voltage: float, gain: float, height: float, most: float
) -> None:
    """0.4 V/µm at the electrodes, after the amplifier's gain: 104 V on a layer of 0.26 mm."""
    head = HEAD.replace("[2.0,", "[4.0,")
    parts = [head, GRID.replace("2.5", "4.5"), f"[bimorph]\npiezo_height_mm = {height}\n"]
    parts.append(f"[amplifier]\ngain = {gain}\n")
    load(tmp_path, *parts, f"[limits]\nvoltage_v = {voltage * 0.999}\n")
    message = refused(tmp_path, *parts, f"[limits]\nvoltage_v = {voltage * 1.01}\n")
    for words in (f"limits.voltage_v = {voltage * 1.01:g}", "400 V/mm"):
        assert words in message
    assert number(message, "at most ", " V") == pytest.approx(most, abs=0.5)


@pytest.mark.parametrize(
    ("height", "gain"), [(0.26, 1.0), (0.262, 1.0), (0.26, 200.0), (0.26, 1000.0)]
)
def test_the_voltage_that_a_refusal_calls_the_most_is_accepted(
    tmp_path: Path, height: float, gain: float
) -> None:
    """As printed, and above nothing."""
    parts = [f"[bimorph]\npiezo_height_mm = {height}\n", f"[amplifier]\ngain = {gain}\n"]
    message = refused(tmp_path, *parts, "[limits]\nvoltage_v = 500.0\n")
    load(tmp_path, *parts, f"[limits]\nvoltage_v = {number(message, 'at most ', ' V')!r}\n")


def test_the_opening_that_a_refusal_calls_needed_is_accepted(tmp_path: Path) -> None:
    message = refused(tmp_path, HEAD.replace("2.0,", "0.5,"))
    load(tmp_path, HEAD.replace("2.0,", f"{number(message, 'needs ', ' mm')!r},"))


@pytest.mark.parametrize(
    "parts",
    [
        [contactors((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))],
        [contactors((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)).replace("channel = 1", "channel = 0")],
        [HEAD.replace("2.0,", "0.9,")],
        ["[limits]\nvoltage_v = 200.0\n"],
        ['[amplifier]\nhold = "zoh"\n'],
        ["[[group]]\nresponse = 'r.csv'\ncontactors = [99]\n"],
    ],
    ids=["overlap", "channel", "opening", "voltage", "hold", "group"],
)
def test_whatever_is_wrong_with_a_display_the_line_begins_with_its_file(
    tmp_path: Path, parts: list[str]
) -> None:
    assert refused(tmp_path, *parts).startswith(f"{tmp_path / 'sample.toml'}: ")


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
    assert "in the piezo layers, twice the drive's behind AC coupling, exceeds" in said
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
    limits = Limits(voltage=80.0, slew=0.25e6, current=2.5e-3, fade=35e-3)
    assert vars(load(tmp_path, text).limits) == pytest.approx(vars(limits))
    assert load(tmp_path).limits == Limits(voltage=100.0, slew=0.7e6, current=math.inf, fade=20e-3)


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
    """In its own kind each; the amplifier is in what was measured."""
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
    """It is looked for beside the display's file."""
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
