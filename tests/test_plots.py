"""Tests of the figures: their lines, the files that are written, and a missing matplotlib."""

import itertools
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.image import imread

from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.arrays import Floats
from tactile.display.display import load_display
from tactile.errors import InputError
from tactile.show import plots

DISPLAY = load_display("reference-24")
FREQUENCY = np.geomspace(0.5, 4000, 90)
FINGERS = {
    name: tip_response(DISPLAY.bimorph, load, FREQUENCY)
    for name, load in (("light", FingerLoad.low()), ("heavy", FingerLoad.high()))
}
SPEED, RATE = 0.08, 8000.0


def played(*, gain: float = 20e6) -> plots.Played:
    """Return a wave of the surface under a finger that moves along x; 1 % is missing."""
    time = np.arange(2400) / RATE
    position = np.stack([SPEED * time, np.zeros_like(time)], axis=1)
    place = position[:, None] + DISPLAY.contactors
    target = 2e-6 * np.cos(2 * np.pi * (place[..., 0] / 11e-3 + place[..., 1] / 17e-3))
    return plots.Played(DISPLAY, time, target, 0.99 * target, gain * target, position)


def line(axes: Axes, number: int) -> tuple[Floats, Floats]:
    x, y = axes.lines[number].get_data()
    return np.asarray(x, np.float64), np.asarray(y, np.float64)


def words(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_magnitude_phase_and_reach() -> None:
    figure = plots.response_figure(FINGERS, voltage=100.0)
    size, phase, reach = figure.axes
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "tip per volt [µm/V]",
        "phase [°]",
        "peak shear at 100 V [µm]",
    ]
    assert reach.get_xlabel() == "frequency [Hz]"
    assert {axes.get_xscale() for axes in figure.axes} == {"log"}
    assert size.get_xlim() == (1, 2000)  # Hz, an octave beyond what is felt
    for number, response in enumerate(FINGERS.values()):
        inside = (FREQUENCY >= 1) & (FREQUENCY <= 2000)
        frequency, micro = line(size, number)
        np.testing.assert_array_equal(frequency, FREQUENCY[inside])
        np.testing.assert_allclose(micro, np.abs(response.displacement[inside]) * 1e6)
        np.testing.assert_allclose(line(reach, number)[1], 100 * micro)
        turned = np.exp(1j * np.radians(line(phase, number)[1])) * micro * 1e-6
        np.testing.assert_allclose(turned, response.displacement[inside], rtol=1e-9)
    assert np.abs(np.diff(line(phase, 0)[1])).max() < 90


def test_lines_are_named_in_their_color_without_a_legend() -> None:
    figure = plots.response_figure(FINGERS, voltage=100.0)
    for axes in figure.axes:
        assert axes.get_legend() is None
        colors = {text.get_text(): text.get_color() for text in axes.texts}
        for number, name in enumerate(FINGERS):
            assert colors[name] == axes.lines[number].get_color()


def test_names_are_kept_apart_in_the_order_of_their_lines() -> None:
    same = {f"finger {k}": FINGERS["light"] for k in range(4)}
    same["heavy"] = FINGERS["heavy"]
    figure = plots.response_figure(same, voltage=100.0)
    height = {t.get_text(): t.get_position()[1] for t in figure.axes[0].texts}
    assert np.diff(sorted(height.values())).min() > 0.9 * 0.07  # of the axes: a line of text
    assert min(height, key=lambda name: height[name]) == "heavy"


def test_the_threshold_is_drawn_with_its_spread() -> None:
    reach = plots.response_figure(FINGERS, voltage=50.0).axes[2]
    frequency, micro = line(reach, len(FINGERS))
    assert dict(zip(frequency, micro, strict=True))[250.0] == pytest.approx(0.45 * 0.1)
    assert micro.min() == pytest.approx(0.45 * 0.1)
    assert frequency.max() == 1000.0
    assert "tangential detection threshold ± 5 dB" in words(reach)
    (band,) = reach.collections
    corners = band.get_paths()[0].vertices
    at_best = np.asarray(corners)[np.asarray(corners)[:, 0] == 250.0, 1]
    assert 20 * np.log10(at_best.max() / at_best.min()) == pytest.approx(10.0)


def test_a_response_beside_the_band_is_refused() -> None:
    far = tip_response(DISPLAY.bimorph, FingerLoad.low(), [3000.0, 4000.0])
    with pytest.raises(InputError, match=r"^far: has no frequency in 1 … 2000 Hz$"):
        plots.response_figure({"far": far}, voltage=100.0)


def images(figure: Figure) -> list[tuple[Axes, PatchCollection, list[PatchCollection]]]:
    """Return axes, contactors and frames of the tactile images."""
    found = []
    for axes in figure.axes[:4]:
        drawn = [c for c in axes.collections if isinstance(c, PatchCollection)]
        found.append((axes, drawn[0], drawn[1:]))
    return found


def middle(collection: PatchCollection) -> Floats:
    """Return the middles of the patches [mm]."""
    return np.array([np.asarray(path.vertices)[:4].mean(axis=0) for path in collection.get_paths()])


def test_the_images_show_the_played_shear_where_the_contactors_stand() -> None:
    play = played()
    figure = plots.played_figure(play, title="a wave")
    assert figure.get_suptitle() == "a wave"
    for axes, contactors, _ in images(figure):
        assert axes.get_xlabel() == "x [mm]"
        milliseconds = float(axes.get_title().split(": ")[1].split(" ms")[0])
        sample = round(milliseconds * 1e-3 * RATE)
        shear = np.asarray(contactors.get_array())
        np.testing.assert_allclose(shear, play.played[sample] * 1e6)
        np.testing.assert_allclose(middle(contactors), DISPLAY.contactors * 1e3, atol=1e-9)
        low, high = contactors.get_clim()
        assert high == -low
        assert high is not None
        assert np.abs(shear).max() <= high
    assert figure.axes[0].get_ylabel() == "y [mm]"
    (scale,) = figure.axes[3].child_axes
    assert scale.get_ylabel() == "shear [µm]"


def test_the_pattern_moves_by_one_contactor_and_the_frame_follows_it() -> None:
    figure = plots.played_figure(played(), title="a wave")
    shear = [np.reshape(np.asarray(c.get_array()), (4, 6)) for _, c, _ in images(figure)]
    for before, after in itertools.pairwise(shear):
        # both are at the nearest sample, so that 10 µm may be between them: waves of 2 µm and 11 mm
        np.testing.assert_allclose(after[:, :-1], before[:, 1:], atol=2 * 2 * np.pi * 0.010 / 11)
    frames = [middle(frame)[0] for _, _, (frame,) in images(figure)]
    np.testing.assert_allclose(np.diff(frames, axis=0), [[-2.5, 0]] * 3, atol=1e-9)


def test_a_finger_across_the_array_is_followed_as_well() -> None:
    play = played()
    assert play.position is not None
    up = replace(play, position=play.position[:, ::-1])
    frames = [middle(f[0])[0] for _, _, f in images(plots.played_figure(up, title="up")) if f]
    np.testing.assert_allclose(np.diff(frames, axis=0), [[0, -3.5]] * 3, atol=1e-9)


@pytest.mark.parametrize("where", ["unknown", "at rest"])
def test_without_a_stroke_the_images_lie_in_the_traces(where: str) -> None:
    still = None if where == "unknown" else np.zeros((2400, 2))
    figure = plots.played_figure(replace(played(), position=still), title="a wave")
    assert [len(frames) for _, _, frames in images(figure)] == [1, 0, 0, 0]
    marks = [word.strip() for word in words(figure.axes[4]) if "image" in word and "," not in word]
    assert marks == ["image 1", "image 2", "image 3", "image 4"]


def test_traces_are_of_the_framed_contactor() -> None:
    play = played()
    figure = plots.played_figure(play, title="a wave")
    shear, error, drive = figure.axes[4:7]
    assert [a.get_ylabel() for a in (shear, error, drive)] == [
        "shear [µm]",
        "error × 100 [µm]",
        "drive [V]",
    ]
    assert drive.get_xlabel() == "time [ms]"
    framed = middle(images(figure)[0][2][0])[0] * 1e-3
    contactor = int(np.argmin(np.linalg.norm(DISPLAY.contactors - framed, axis=1)))
    assert f"contactor {contactor}, framed in image 1:" in words(shear)
    assert {"commanded", "played"} <= set(words(shear))
    time, commanded = line(shear, 0)
    assert time[-1] - time[0] == pytest.approx(40, abs=0.2)  # ms
    samples = np.rint(time * 1e-3 * RATE).astype(int)
    np.testing.assert_allclose(commanded, play.target[samples, contactor] * 1e6)
    np.testing.assert_allclose(line(shear, 1)[1], play.played[samples, contactor] * 1e6)
    np.testing.assert_allclose(line(error, 0)[1], -commanded, rtol=1e-9)
    assert "error rms 1.00% of the commanded shear" in words(error)
    assert error.get_ylim() == shear.get_ylim()
    np.testing.assert_allclose(line(drive, 0)[1], play.drive[samples, contactor])


@pytest.mark.parametrize(("gain", "limits"), [(2e6, 0), (45e6, 2)])
def test_the_limits_are_drawn(gain: float, limits: int) -> None:
    figure = plots.played_figure(played(gain=gain), title="a wave")
    drive = figure.axes[6]
    (gauge,) = drive.child_axes
    assert gauge.get_ylim() == (-100.0, 100.0)
    volts = line(drive, 0)[1]
    (bar,) = gauge.patches
    low, high = bar.get_extents().transformed(gauge.transData.inverted()).intervaly
    assert (low, high) == pytest.approx((volts.min(), volts.max()))
    assert [label.get_text() for label in gauge.get_yticklabels()][::2] == [
        "−100 V limit",
        "100 V limit",
    ]
    across = [y for y in (line(drive, k)[1] for k in range(1, len(drive.lines))) if len(y) == 2]
    assert [y[0] for y in across] == [-100.0, 100.0][:limits]
    assert f"drive: at most {np.abs(volts).max():.1f} V of ± 100 V" in words(drive)


def test_rows_that_stand_half_a_pitch_apart_are_stepped_by_a_whole_one() -> None:
    places = DISPLAY.contactors + np.where(np.arange(24) // 6 % 2, 1.25e-3, 0.0)[:, None] * [1, 0]
    play = replace(played(), display=replace(DISPLAY, contactors=places))
    frames = [middle(f[0])[0] for _, _, f in images(plots.played_figure(play, title="hexagonal"))]
    np.testing.assert_allclose(np.diff(frames, axis=0), [[-2.5, 0]] * 3, atol=1e-9)


def test_silence_is_white() -> None:
    play = played()
    nothing = np.zeros_like(play.target)
    quiet = plots.Played(DISPLAY, play.time, nothing, nothing, nothing, play.position)
    figure = plots.played_figure(quiet, title="silence")
    for _, contactors, _ in images(figure):
        contactors.update_scalarmappable()
        assert np.asarray(contactors.get_facecolor())[:, :3].min() > 0.95


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("drive", np.zeros((2400, 7)), r"drive is \(2400, 7\): must be \(2400, 24\)"),
        ("target", np.zeros((9, 24)), r"target is \(9, 24\): must be \(2400, 24\)"),
        ("position", np.zeros((2400, 3)), r"position is \(2400, 3\): must be \(2400, 2\)"),
    ],
)
def test_shapes_that_differ_are_refused(part: str, value: Floats, message: str) -> None:
    sides: dict[str, Any] = {part: value}
    with pytest.raises(InputError, match=message):
        replace(played(), **sides)


def test_too_few_samples_are_refused() -> None:
    few = np.zeros((3, 24))
    with pytest.raises(InputError, match="3 samples: needs at least 8"):
        plots.Played(DISPLAY, np.arange(3.0), few, few, few)


def save_response(path: Path) -> None:
    plots.save(plots.response_figure(FINGERS, voltage=100.0), path)


def save_played(path: Path) -> None:
    plots.save(plots.played_figure(played(), title="a wave"), path)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("save", "inches"),
    [
        (save_response, (7.0, 9.0)),
        pytest.param(save_played, (9.0, 0), marks=pytest.mark.ci),
    ],
)
def test_a_png_has_150_dots_per_inch_and_is_not_blank(
    save: Any, inches: tuple[float, float], tmp_path: Path
) -> None:
    save(tmp_path / "a.png")
    picture = imread(tmp_path / "a.png")
    assert picture.shape[1] == inches[0] * 150
    assert not inches[1] or picture.shape[0] == inches[1] * 150
    assert 0.01 < np.mean(picture[..., :3].min(axis=2) < 0.9) < 0.5


@pytest.mark.parametrize(("suffix", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
@pytest.mark.ci
def test_other_files(suffix: str, start: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    save_response(path)
    assert path.read_bytes().startswith(start)
    assert path.stat().st_size > 5000


def test_a_file_that_is_no_figure_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.csv: must end in \.png, \.svg, \.pdf$"):
        save_response(tmp_path / "a.csv")
    with pytest.raises(InputError, match=r"a\.png: No such file or directory$"):
        save_response(tmp_path / "nowhere" / "a.png")


@pytest.mark.parametrize("save", [save_response, save_played])
def test_without_matplotlib_one_line_tells_what_to_install(
    save: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("matplotlib")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError) as caught:
        save(tmp_path / "a.png")
    expected = "a figure needs matplotlib: pip install 'tactile-display[plot]'"
    assert str(caught.value).startswith(expected)
    assert not list(tmp_path.iterdir())


@pytest.mark.ci
def test_matplotlib_is_imported_late_and_its_state_left_alone() -> None:
    script = (
        "import sys, tactile.show.plots as p\n"
        "assert not [m for m in sys.modules if m.startswith('matplotlib')]\n"
        "p.response_figure({}, voltage=1.0)\n"
        "assert 'matplotlib.figure' in sys.modules\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
