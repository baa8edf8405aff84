"""Pictures of textures: that surface, spectrum and stroke are what the texture says they are."""

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage, imread

from tactile.arrays import Floats
from tactile.display.display import load_display
from tactile.errors import InputError
from tactile.show import views
from tactile.show.plots import save, sheet_figure, texture_figure
from tactile.show.views import Tile, View, view_texture
from tactile.strength.commanded import commanded_lines
from tactile.strength.strength import SteadyStroke
from tactile.texture.perception import band_sensation, detection_threshold
from tactile.texture.surface import Texture, load_texture

DISPLAY = load_display("reference-24")
REFERENCE = {"speed": 0.04, "normal_force": 0.5}
"""Speed [m/s] and force [N] at which the shipped textures' numbers hold: the laws' factor is
one."""
CENTER = 10 ** (np.arange(34) / 10)
EDGES = 10 ** ((np.arange(35) - 0.5) / 10)
"""Edges of the third octaves from 1 Hz to 2 kHz (IEC 61260-1) [Hz]."""

TEXT = """
[texture]
id = "{name}"
category = "test"
description = "made for a test"
provenance = "authored"
source = "assumed"
license = "CC0-1.0"

[reference]
speed_mm_s = 40.0
normal_force_n = 0.5
"""


@cache
def shipped(name: str) -> Texture:
    return load_texture(name)


@cache
def seen(name: str, speed: float = 0.08) -> View:
    return view_texture(shipped(name), DISPLAY, speed=speed)


def made(folder: Path, content: str) -> Texture:
    path = folder / "made.toml"
    path.write_text(TEXT.format(name="made") + content, encoding="utf-8")
    return load_texture(path)


def images(axes: Axes) -> list[tuple[Floats, tuple[float, float], list[float]]]:
    """Return the values, ends of the color scale and extent of what is drawn."""
    found = []
    for image in axes.get_images():
        assert isinstance(image, AxesImage)
        low, high = image.get_clim()
        assert low is not None
        assert high is not None
        found.append((np.asarray(image.get_array()), (low, high), list(image.get_extent())))
    return found


# Contents of a texture


def test_the_surface_is_the_random_part_times_its_envelope_and_the_gratings() -> None:
    texture = shipped("wood-pine-sanded")
    surface = texture.realize()
    patch = views.surface_patch(texture, side=4e-3, pixels=31, **REFERENCE)
    y, x = np.meshgrid(*[(np.arange(31) - 15) * 4e-3 / 31] * 2, indexing="ij")
    place = np.stack([x, y], axis=-1)
    spread = np.sum(surface.envelope.amplitude**2) / 2
    expected = surface.random_part(place) * np.exp(surface.envelope.at(place) - spread)
    expected += surface.split[1].at(place)
    np.testing.assert_allclose(patch, expected, atol=1e-4 * np.abs(expected).max())


def test_sparse_events_are_on_the_surface() -> None:
    texture = shipped("wood-oak")
    surface, pixels = texture.realize(), 80
    patch = views.surface_patch(texture, side=8e-3, pixels=pixels, **REFERENCE)
    place = (np.arange(pixels) + 0.5 - pixels / 2) * 8e-3 / pixels
    y, x = np.meshgrid(place, place, indexing="ij")
    at = np.stack([x, y], axis=-1)
    spread = np.sum(surface.envelope.amplitude**2) / 2
    waves = surface.random_part(at) * np.exp(surface.envelope.at(at) - spread)
    sigma = 0.25e-3 / np.sqrt(8 * np.log(2))
    expected = np.zeros_like(x)
    for (px, py), peak in zip(surface.event_place, surface.event_peak, strict=True):
        dx, dy = ((d + 12.8e-3) % 25.6e-3 - 12.8e-3 for d in (x - px, y - py))
        expected += peak * dx / sigma * np.exp(0.5 - (dx**2 + dy**2) / (2 * sigma**2))
    # pixels of the field and reading between them: 0.4 % of a peak each
    np.testing.assert_allclose(patch - waves, expected, atol=0.02 * np.abs(expected).max())


def test_third_octaves_are_those_of_a_long_stroke() -> None:
    """Compare with the mean periodogram of eight lines of 4 m over the field."""
    texture = shipped("plastic-acrylic-ribbed")
    step, samples = 0.05e-3, 80_000
    line = np.outer(np.arange(samples) * step, [1.0, 0.0])
    window, power = np.hanning(samples), np.zeros(samples // 2 + 1)
    for seed in range(8):
        met = texture.realize(seed).random_part(line)
        power += np.abs(np.fft.rfft(met * window)) ** 2 / (4 * samples * np.sum(window**2))
    frequency = np.fft.rfftfreq(samples, step) * 0.04
    s = views.texture_spectrum(texture, **REFERENCE)
    measured = np.sqrt(2 * np.histogram(frequency, EDGES, weights=power)[0])
    whole = (CENTER > 25) & (CENTER < 300)
    # a band of 25 Hz has 230 lines in all: its level is known to 3 %
    np.testing.assert_allclose(s.waves[whole], measured[whole], rtol=0.08)


@pytest.mark.parametrize(
    "shape",
    [
        'shape = "pulse"',
        pytest.param('shape = "edge"', marks=pytest.mark.ci),
        'shape = "edge"\ndirection_deg = 60.0',
    ],
)
def test_events_have_the_spectrum_of_many_of_them(shape: str, tmp_path: Path) -> None:
    """The reference is the Fourier transform of the tile that they repeat on, line by line."""
    texture = made(
        tmp_path,
        f"[[events]]\ndensity_per_mm2 = 0.5\namplitude_um = 3.0\nwidth_mm = 0.3\n{shape}\n",
    )
    tile, pixels = 25.6e-3, 256
    patch = views.surface_patch(texture, side=tile, pixels=pixels, **REFERENCE)
    power = 2 * np.mean(np.abs(np.fft.rfft(patch, axis=1) / pixels) ** 2, axis=0)
    power[0] /= 2
    frequency = np.arange(len(power)) / tile * 0.04
    s = views.texture_spectrum(texture, **REFERENCE)
    assert not s.waves.any()
    drawn = len(texture.realize().event_peak) / (0.5 * 25.6**2)
    # a tile has few lines in low bands, so octaves are compared
    found = np.histogram(frequency, EDGES[[10, 15, 18, 21, 24]], weights=power)[0]
    told = drawn * np.add.reduceat(s.events**2 / 2, [10, 15, 18, 21, 24])[:-1]
    strong = told > 0.05 * told.max()
    assert strong.sum() >= 2
    np.testing.assert_allclose(told[strong], found[strong], rtol=0.2)
    # some of 330 events overlap
    assert drawn * np.sum(s.events**2) / 2 == pytest.approx(np.mean(patch**2), rel=0.08)


def test_the_mean_square_of_events_is_that_of_those_drawn(tmp_path: Path) -> None:
    events = (
        "[[events]]\ndensity_per_mm2 = {}\namplitude_um = 3.0\namplitude_sd = {}\nwidth_mm = 0.3\n"
    )
    many = made(tmp_path, events.format(4.0, 0.4))
    one = made(tmp_path, events.format(1.0, 0.0))
    squares = np.sum(many.realize().event_peak ** 2) / (25.6**2 * 3e-6**2)
    many_power, one_power = (commanded_lines(t, **REFERENCE).power.sum() for t in (many, one))
    power = many_power / one_power
    # 2600 of them: 2 % in number, 2 % in mean square
    assert power == pytest.approx(squares, rel=0.08)


@pytest.mark.parametrize("speed", [0.02, 0.08, 0.2])
def test_a_grating_sounds_at_speed_over_wavelength(speed: float) -> None:
    s = views.texture_spectrum(shipped("plastic-acrylic-ribbed"), speed=speed)
    orders = np.arange(1, 6)
    np.testing.assert_allclose(s.grating_frequency, orders * speed / 1.69e-3)
    ratio = s.grating_peak / (np.array([2.4, 0.85, 0.46, 0.3, 0.21]) * 1e-6)
    np.testing.assert_allclose(ratio, ratio[0])


def test_a_grating_across_the_stroke_does_not_sound(tmp_path: Path) -> None:
    grating = "[[periodic]]\nwavelength_mm = 1.0\nharmonics_um = [2.0]\ndirection_deg = {}\n"
    along = views.texture_spectrum(made(tmp_path, grating.format(60.0)), **REFERENCE)
    np.testing.assert_allclose(along.grating_frequency, [20.0])
    np.testing.assert_allclose(along.grating_peak, [2e-6], rtol=1e-4)
    np.testing.assert_allclose(along.total[13], 2e-6, rtol=1e-4)
    across = views.texture_spectrum(made(tmp_path, grating.format(90.0)), **REFERENCE)
    assert not across.grating_frequency.size
    assert not len(views.shown_bands(across))


def test_just_felt_is_the_published_table_for_motion_along_the_skin_up_to_1_khz() -> None:
    """0.45 times that along the normal, straight between where both are logarithmic."""
    hz = np.array([10.0, 100.0, 250.0, np.sqrt(100 * 125), 1000.0, 0.1, 1001.0])
    normal = np.array([8.91, 0.562, 0.1, np.sqrt(0.562 * 0.355), 3.55, 25.1, np.inf])
    np.testing.assert_allclose(views.just_felt(hz), 0.45e-6 * normal)


@pytest.mark.parametrize("speed", [0.04, 0.12])
def test_show_and_strength_tell_the_same_level(speed: float, tmp_path: Path) -> None:
    """The level is that of a grating in its band, 46.8 or 140.4 Hz, before the display plays it."""
    grating = "[[periodic]]\nwavelength_mm = 0.8547\nharmonics_um = [3.0]\n"
    texture = made(tmp_path, grating + "[laws]\nspeed_exponent = 0.0\n")
    shown = views.texture_spectrum(texture, speed=speed)
    lines = commanded_lines(texture, speed=speed, normal_force=0.5)
    band = int(np.argmax(band_sensation(lines.frequency, lines.power)))
    (own,) = detection_threshold(np.array([speed / 0.8547e-3]))
    assert shown.level[band] == pytest.approx(20 * np.log10(3e-6 / own), abs=0.01)
    assert shown.threshold[band] == pytest.approx(own, rel=1e-3)
    assert np.argmax(shown.level) == band


@pytest.mark.parametrize(("micro", "felt"), [(0.0445, []), (0.0459, [250.0])])
def test_a_texture_is_felt_from_the_threshold_on(
    micro: float, felt: list[float], tmp_path: Path
) -> None:
    """One of 0.16 mm sounds at 250 Hz at 40 mm/s, where 0.45 × 0.1 µm is just felt."""
    content = f"[[periodic]]\nwavelength_mm = 0.16\nharmonics_um = [{micro}]\n"
    view = view_texture(made(tmp_path, content), DISPLAY, speed=0.04)
    figures = views.view_figures(view)
    assert figures["felt_hz"] == felt
    assert figures["third_octave_hz"] == [250.0]


def test_the_stroke_is_the_surface_under_each_contactor() -> None:
    view = seen("wood-pine-sanded", 0.04)
    sweep, surface = view.sweep, shipped("wood-pine-sanded").realize()
    assert sweep.contactor.tolist() == [6, 7, 8, 9, 10, 11]
    assert np.all(np.diff(sweep.place[:, 0]) > 0)
    place = np.stack(np.broadcast_arrays(
        sweep.place[:, None, 0] + sweep.position, sweep.place[:, None, 1]
    ), axis=-1)[:, ::10]  # fmt: skip
    spread = np.sum(surface.envelope.amplitude**2) / 2
    expected = surface.random_part(place) * np.exp(surface.envelope.at(place) - spread)
    expected += surface.split[1].at(place)
    # the renderer's phasors are within −73 dB
    np.testing.assert_allclose(sweep.shear[:, ::10], expected, atol=1e-3 * expected.std() * 5)
    assert np.ptp(sweep.position) == pytest.approx(1.5 * 12.5e-3, rel=0.01)


def test_of_a_stroke_are_kept_as_many_instants_as_can_be_seen() -> None:
    slow = view_texture(shipped("wood-pine-sanded"), DISPLAY, speed=0.004).sweep
    assert 1500 < len(slow.time) <= 3000
    np.testing.assert_allclose(np.diff(slow.position), np.diff(slow.time) * 0.004)


def test_the_row_is_the_longest_nearest_to_the_middle() -> None:
    column = np.array([[0.0, 3e-3], [0.0, 0.0], [0.0, 6e-3]])
    assert views.middle_row(column).tolist() == [0]
    ragged = np.array([[1e-3, 0.0], [5e-3, 4e-3], [3e-3, 4e-3], [0.0, 8e-3]])
    assert views.middle_row(ragged).tolist() == [2, 1]


def test_what_full_drive_attains_is_the_response_at_the_limit() -> None:
    view = seen("wood-oak")
    response = DISPLAY.responses(np.array([0.0, 250.0]), 8000.0)
    at = np.interp([0.0, 250.0], view.frequency, view.attainable)
    np.testing.assert_allclose(at, np.abs(response[0]).min(axis=0) * 100.0, rtol=1e-6)


# The figure


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in (*figure.texts, *(t for a in figure.axes for t in a.texts))]


def test_the_figure_draws_the_surface_to_scale() -> None:
    view = seen("wood-oak")
    surface, _, sweep = texture_figure(view).axes[:3]
    ((values, (low, high), extent),) = images(surface)
    np.testing.assert_array_equal(values, view.surface * 1e6)
    assert extent == [-4.0, 4.0, -4.0, 4.0]
    assert surface.get_images()[0].origin == "lower"
    assert low == -high
    assert np.mean(np.abs(values) <= high) > 0.99
    assert (surface.get_xlabel(), surface.get_ylabel()) == ("x [mm]", "y [mm]")
    assert "stroke, 80 mm/s" in [text.get_text() for text in surface.texts]
    (bar,) = surface.child_axes
    assert bar.get_ylabel() == "tangential displacement [µm]"
    assert {ends for _, ends, _ in images(sweep)} == {(low, high)}


def test_the_figure_draws_bands_stems_threshold_and_reach() -> None:
    view = seen("plastic-acrylic-ribbed", 0.4)
    axes = texture_figure(view).axes[1]
    lines = [np.asarray(line.get_xydata(), np.float64) for line in axes.lines]
    published = np.array([[1, 25.1], [40, 2.82], [250, 0.1], [630, 0.668], [1000, 3.55]])
    told = lines[0][np.isin(lines[0][:, 0], published[:, 0])]
    np.testing.assert_allclose(told, published * [1, 0.45])
    assert lines[0][-1, 0] == 1000
    stems = [line for line in lines[1:] if len(line) == 2]
    np.testing.assert_allclose([stem[0, 0] for stem in stems], np.arange(1, 6) * 400 / 1.69)
    np.testing.assert_allclose([stem[1, 1] for stem in stems], view.spectrum.grating_peak * 1e6)
    pale = [line.get_alpha() for line in axes.lines if len(np.asarray(line.get_xdata())) == 2]
    assert pale == [1.0, 1.0, 1.0, 1.0, 0.4]
    reach = lines[-1]
    assert reach[-1, 0] == 1000.0
    np.testing.assert_allclose(
        reach[:, 1], np.interp(reach[:, 0], view.frequency, view.attainable) * 1e6
    )
    steps = [p.get_data() for p in axes.patches if hasattr(p, "get_data")]
    np.testing.assert_allclose(steps[0].edges, EDGES, rtol=1e-12)
    inside = CENTER < 1001
    waves = np.maximum(view.spectrum.waves * 1e6, 1e-6)
    np.testing.assert_allclose(steps[0].values[inside], waves[inside])
    assert np.all(np.isnan(steps[0].values[~inside]))
    cut = next(p for p in axes.patches if p.get_hatch())
    assert cut.get_extents().transformed(axes.transData.inverted()).x0 == pytest.approx(1000.0)
    assert "not played" in texts(axes.figure.get_figure(root=True))
    assert axes.get_xscale() == axes.get_yscale() == "log"


def test_the_figure_follows_one_place_under_the_row() -> None:
    view = seen("wood-pine-sanded")
    sweep = view.sweep
    axes = texture_figure(view).axes[2]
    drawn = images(axes)
    for (values, _, extent), shear, place in zip(drawn, sweep.shear, sweep.place, strict=True):
        np.testing.assert_array_equal(values, shear[None] * 1e6)
        assert (extent[2] + extent[3]) / 2 == pytest.approx(place[0] * 1e3)
        assert extent[:2] == [sweep.time[0] * 1e3, sweep.time[-1] * 1e3]
    time, x = (np.asarray(side, np.float64) for side in axes.lines[0].get_data())
    np.testing.assert_allclose(np.diff(x) / np.diff(time), -80e-3, rtol=1e-6)
    felt = [
        np.interp(np.interp(-place * 1e3, -x, time), sweep.time * 1e3, shear)
        for place, shear in zip(sweep.place[:, 0], sweep.shear, strict=True)
    ]
    # between samples 0.01 mm apart the shortest wave of 0.25 mm bends
    np.testing.assert_allclose(felt, felt[-1], rtol=0.05)
    assert abs(felt[-1]) > 1.5 * sweep.shear.std()


def test_facts_are_told_above() -> None:
    view = seen("wood-oak")
    told = " ".join(texts(texture_figure(view)))
    commanded = view.commanded
    for fact in ("wood-oak on reference-24, 80 mm/s, 0.5 N, gain 1", "European oak",
                 f"vibration {commanded.vibration_um_rms:.2f} µm rms",
                 f"drag {commanded.drag_um:.2f} µm", f"peak {commanded.peak_um:.2f} µm",
                 "felt: 14 dB above threshold at 250 Hz", "authored",
                 "friction 0.5 at rest, 0.35 sliding", "source: Level: reference",
                 "sparse events, in the mean",
                 "tangential detection threshold ± 5 dB"):  # fmt: skip
        assert fact in told
    assert "gratings" not in told


@pytest.mark.parametrize(
    ("name", "speed"),
    [
        pytest.param("wood-oak", 0.08, marks=pytest.mark.ci),
        pytest.param("plastic-acrylic-ribbed", 0.4, marks=pytest.mark.ci),
    ],
)
def test_no_text_lies_on_another_or_beyond_the_page(name: str, speed: float) -> None:
    figure = texture_figure(seen(name, speed))
    figure.canvas.draw()
    labels = list(figure.texts)
    for axes in [*figure.axes, *(c for a in figure.axes for c in a.child_axes)]:
        assert isinstance(axes, Axes)
        labels += [*axes.texts, axes.xaxis.label, axes.yaxis.label]
        low, high = axes.get_ylim()
        labels += [t for t in axes.get_yticklabels() if low <= t.get_position()[1] <= high]
    boxes = [t.get_window_extent() for t in labels if t.get_text() and t.get_visible()]
    page = figure.bbox
    for box in boxes:
        assert page.x0 <= box.x0 < box.x1 <= page.x1
        assert page.y0 <= box.y0 < box.y1 <= page.y1
    for one, other in itertools.combinations(boxes, 2):
        assert not (one.overlaps(other) and one.shrunk(0.9, 0.9).overlaps(other.shrunk(0.9, 0.9)))


def test_a_texture_beyond_the_band_is_drawn_as_not_played(tmp_path: Path) -> None:
    fine = made(tmp_path, "[[periodic]]\nwavelength_mm = 0.05\nharmonics_um = [1.0]\n")
    view = view_texture(fine, DISPLAY, speed=0.08)
    assert np.abs(view.sweep.shear).max() < 1e-12
    assert views.view_figures(view)["felt_hz"] == []
    assert "not played" in texts(texture_figure(view))


# The sheet


@cache
def tiles() -> tuple[Tile, ...]:
    return tuple(
        views.tile(shipped(name), DISPLAY, SteadyStroke())
        for name in ("wood-pine-sanded", "plastic-acrylic-ribbed", "wood-oak")
    )


def many() -> list[Tile]:
    """Return 45 tiles of ten categories, one of them alone in its."""
    kinds = ["abrasive"] * 6 + ["foam"] + ["leather"] * 5 + ["metal"] * 5 + ["paper"] * 4
    kinds += ["plastic"] * 6 + ["rubber"] * 3 + ["stone"] * 3 + ["textile"] * 7 + ["wood"] * 5
    return [
        replace(tiles()[k % 3], category=kind, name=f"{kind}-number-{k:02d}")
        for k, kind in enumerate(kinds)
    ]


def test_a_sheet_has_surface_and_strip_of_each_by_category_and_name() -> None:
    figure = sheet_figure(tiles(), conditions="a display")
    ordered = sorted(tiles(), key=lambda one: one.name)
    assert ordered[0].name == "plastic-acrylic-ribbed"
    for surface, one in zip(figure.axes[::2], ordered, strict=True):
        ((values, _, _),) = images(surface)
        np.testing.assert_array_equal(values, one.surface)
    told = texts(figure)
    for words in ("plastic", "acrylic-ribbed", "wood", "oak", "pine-sanded", "3 textures"):
        assert words in told
    figures = ordered[1].figures
    assert f"{figures.vibration_um_rms:.2f} µm rms, {figures.level_db_sl:+.0f} dB" in told


def test_a_category_has_one_scale_that_is_named() -> None:
    figure = sheet_figure(tiles(), conditions="a display")
    plastic, oak, pine = (images(axes)[0][1] for axes in figure.axes[::2])
    assert oak == pine
    assert plastic != oak
    assert f"± {oak[1] * 1e6:.2g} µm" in texts(figure)
    strongest = max(np.quantile(np.abs(tiles()[k].surface), 0.995) for k in (0, 2))
    assert oak[1] == pytest.approx(strongest)


@pytest.mark.ci
def test_a_sheet_of_45_keeps_all_apart_and_on_the_page() -> None:
    figure = sheet_figure(many(), conditions="a display")
    assert len(figure.axes) == 90
    boxes = [axes.get_position() for axes in figure.axes]
    words = [t.get_window_extent().transformed(figure.transFigure.inverted()) for t in figure.texts]
    for box in [*boxes, *words]:
        assert 0 <= box.x0 < box.x1 <= 1
        assert 0 <= box.y0 < box.y1 <= 1
    for one, other in itertools.combinations([*boxes, *words], 2):
        assert not one.overlaps(other)
    assert len({round(box.x0, 6) for box in boxes}) == 9, "textures in a row"
    told = texts(figure)
    assert "leather …" in told
    assert "leather" in told


# Files


@pytest.mark.ci
def test_pictures_are_written(tmp_path: Path) -> None:
    save(texture_figure(seen("wood-oak")), tmp_path / "one.png")
    picture = imread(tmp_path / "one.png")
    assert picture.shape[:2] == (1410, 1500), "9.4 × 10 inches of 150 dots"
    save(sheet_figure(tiles()[:1], conditions="a display"), tmp_path / "all.svg")
    assert (tmp_path / "all.svg").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize(
    ("file", "message"),
    [("a.csv", r"a\.csv: must end in"), ("no/a.png", r"a\.png: No such file or directory$")],
)
def test_a_file_that_cannot_be_is_refused(file: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        save(sheet_figure(tiles()[:1], conditions="a display"), tmp_path / file)
