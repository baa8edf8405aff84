"""Tests of a display's file: positions of parts, and refusals of what does not fit.

Geometry is checked against a brute force that samples points, the room that a bender needs
against the closed form of its static deflection, arrays against what is written in the file.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from display_files import FINGER, GRID, HEAD, LIMITS, contactors, load, number, refused

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import CFRP, PIEZO_3203HD
from tactile.display.display import DriveLimits, load_display
from tactile.errors import InputError

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
    limits = DriveLimits(voltage=100.0, slew=0.7e6, current=10e-3, fade=20e-3)
    assert vars(display.limits) == pytest.approx(vars(limits))


def test_the_reference_bender_has_the_capacitance_that_its_file_states() -> None:
    """12.8 nF, to the digits printed: 10 mA would give 0.78 V/µs, and 0.7 is what limits."""
    display = load_display("reference-24")
    assert display.capacitance == pytest.approx(12.8e-9, abs=0.05e-9)
    assert 10e-3 / display.capacitance == pytest.approx(0.78e6, abs=0.005e6)
    assert display.limits.step(8000.0, display.capacitance) == pytest.approx(87.5)


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
    """Openings at any angle are compared with points 0.05 mm apart or closer.

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
    """The voltage is taken as the message prints it."""
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
