"""Maps: the relief of a picture as it is played, against the picture itself.

The spectra of strokes are compared with those of the rows and columns of the height map, by
one-dimensional periodograms that share no code with the map.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from relief_rig import PIXEL, bands_of, field, isotropic, made, plane_wave

import tactile
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.strength.commanded import commanded_lines
from tactile.strength.spending import weighted
from tactile.texture.descriptor import Descriptor, Laws, SkinMap, parse
from tactile.texture.descriptor_file import as_toml
from tactile.texture.map_pixels import packed, unpacked
from tactile.texture.relief import EDGES, leveled
from tactile.texture.relief_texture import Relief
from tactile.texture.skin import GAIN
from tactile.texture.surface import Texture, load_texture, map_field

BANDS = EDGES[:17]
"""Edges of the 16 bands that pixels of 53.5 µm resolve [cycles/m]."""


def within_bands(number: Floats, direction: Floats) -> Floats:
    """Return an isotropic spectrum without waves coarser than the bands, which leak into rows."""
    return np.asarray(isotropic(number, direction) * (number > EDGES[0]))


def stored(result: Relief, folder: Path) -> Texture:
    """Return the texture that is read from the text of a descriptor."""
    path = folder / "some-relief.toml"
    path.write_text(as_toml(result.descriptor, result.comments))
    return load_texture(path)


def skin_map(result: Relief) -> SkinMap:
    assert result.descriptor.map is not None
    return result.descriptor.map


def levels(strokes: Floats, step: float) -> Floats:
    """Return the band levels of strokes (K, S) [dB re 1 µm²·mm]."""
    window = np.hanning(strokes.shape[1])
    power = 2 * np.abs(np.fft.rfft(strokes * window)) ** 2 * step / np.sum(window**2)
    fine = np.array([np.linspace(a, b, 20) for a, b in pairwise(BANDS)])
    number = np.fft.rfftfreq(strokes.shape[1], step)
    return np.asarray(
        10 * np.log10(np.interp(fine, number, power.mean(axis=0)).mean(axis=1) * 1e15)
    )


def strokes_over(played: SkinMap, degrees: float, count: int) -> Floats:
    """Return 200 strokes of a number of picture pixels over a map, from random places [m]."""
    turn = np.radians(degrees)
    way = np.outer(np.arange(count) * PIXEL, [np.cos(turn), np.sin(turn)])
    start = np.random.default_rng(0).uniform(0, 0.1, (200, 1, 2))
    return map_field(played, 0.0).at(start + way)


# Against the picture


@pytest.mark.parametrize("degrees", [0, 90])
def test_strokes_have_the_spectrum_of_rows_and_columns_of_the_picture(degrees: float) -> None:
    """Compare noise with a slanted grating; a tenth is cut off, which leaves chance of 1 dB."""
    height = field(3, within_bands, 1e-6) + plane_wave(1.3e-3, 20, 3e-6)
    own = leveled(height)[0] * GAIN
    rows = levels(own if degrees == 0 else own.T, PIXEL)
    played = levels(strokes_over(skin_map(made(height, with_map=True)), degrees, len(own)), PIXEL)
    assert np.sqrt(np.mean((played - rows) ** 2)) < 0.6
    assert np.abs(played - rows).max() < 1.5


def test_the_bands_of_the_file_are_those_of_the_map() -> None:
    """Compare in four directions; the lowest bands have few waves, and the map a part of them."""
    result = made(field(5, isotropic, 1e-6), with_map=True)
    strokes = [strokes_over(skin_map(result), degrees, 384) for degrees in (0, 45, 90, 135)]
    difference = levels(np.concatenate(strokes), PIXEL) - bands_of(result)
    assert np.abs(difference[:4]).max() < 3
    assert np.abs(difference[4:]).max() < 1


def test_a_map_plays_the_heights_of_the_picture_place_by_place() -> None:
    """Compare beyond the blended strip; the mean of the picture and coarse waves are left out."""
    height = field(3, within_bands, 2e-6)
    played = skin_map(made(height, with_map=True))
    rows, columns = (round(s / PIXEL * 1e-3) for s in (played.height_mm, played.width_mm))
    y, x = np.mgrid[50:rows, 50:columns]
    shown = map_field(played, 0.0).at(np.stack([x, y], axis=-1) * PIXEL)
    own = (leveled(height)[0][::-1] * GAIN)[50:rows, 50:columns]
    assert np.corrcoef(shown.ravel(), own.ravel())[0, 1] > 0.99
    assert shown.std() == pytest.approx(own.std(), rel=0.05)


# Seam


def roughness(signal: Floats) -> Floats:
    """Return the second differences, which a jump raises most."""
    return np.diff(signal, 2, axis=-1)


@pytest.mark.parametrize("turned", [False, True])
def test_a_stroke_across_the_seam_meets_no_click(turned: bool) -> None:
    """Compare second differences near the seam with all others.

    They are twice as large where the map, without its last pixels, is put edge to edge.
    """
    played = skin_map(made(field(3, within_bands, 2e-6), with_map=True))
    values = played.displacement.T if turned else played.displacement
    twice = roughness(np.concatenate([values, values[:, :40]], axis=1))
    end = values.shape[1] - 2
    seam, inside = twice[:, end - 1 : end + 3], twice[:, 40 : end - 40]
    assert np.abs(seam).max() < 1.2 * np.abs(inside).max()
    assert seam.std() == pytest.approx(inside.std(), rel=0.15)
    cut = values[:, : end - 30]
    jump = roughness(np.concatenate([cut[:, -2:], cut[:, :2]], axis=1))
    assert jump.std() > 2 * inside.std()


def test_the_blended_strip_is_as_strong_as_the_rest() -> None:
    """Compare fine noise in the middle of the strip, where a linear blend is 3 dB weaker.

    Some hundred grains of noise leave 5 % of chance.
    """
    fine = field(8, lambda number, _: np.where(number > 3e3, 1 / np.maximum(number, 1), 0), 1e-6)
    values = skin_map(made(fine, with_map=True)).displacement
    for rows in (values, values.T):
        assert rows[13:24].std() == pytest.approx(rows[50:].std(), rel=0.12)


def test_ribs_continue_across_the_seam() -> None:
    """Look at ten turns around the map: a slip of phase would take power from the line."""
    played = skin_map(made(plane_wave(1.3e-3, 20, 5e-6), with_map=True))
    step = played.width_mm * 1e-3 / 256
    way = np.outer(np.arange(2560), [step, 0.0])
    power = np.abs(np.fft.rfft(map_field(played, 0.0).at(way))) ** 2
    line = 10 * round(played.width_mm * np.cos(np.radians(20)) / 1.3)
    assert power.argmax() == line
    assert power[line] > 0.98 * power.sum()


# Playing


@pytest.fixture(scope="module")
def relief(tmp_path_factory: pytest.TempPathFactory) -> Texture:
    """Texture with a map of noise and ribs, without laws."""
    result = made(field(3, within_bands, 1e-6) + plane_wave(1.3e-3, 20, 3e-6), with_map=True)
    plain = structs.replace(result.descriptor, laws=Laws())
    path = tmp_path_factory.mktemp("map") / "some-relief.toml"
    path.write_text(as_toml(plain))
    return load_texture(path)


@pytest.fixture(scope="module")
def display() -> tactile.Display:
    return tactile.load_display("reference-24")


def test_shear_is_the_map_at_each_contactor(display: tactile.Display, relief: Texture) -> None:
    path = tactile.Trajectory.line(speed=0.05, angle=0.4, duration=0.25)
    r = tactile.render(display, relief, path)
    assert relief.descriptor.map is not None
    wanted = map_field(relief.descriptor.map, 0.0).at(r.position[:, None] + display.contactors)
    assert np.std(r.shear - wanted) < 1e-4 * np.std(wanted)
    other = tactile.render(display, relief, path, seed=3)
    assert np.array_equal(other.shear, r.shear)


def test_a_way_back_over_a_map_meets_what_the_way_there_met(
    display: tactile.Display, relief: Texture
) -> None:
    there = tactile.Trajectory.line(speed=0.05, duration=0.25)
    back = tactile.Trajectory(there.time, there.position[::-1], 0.5)
    one, other = (tactile.render(display, relief, path).shear for path in (there, back))
    # sample n of one way is at the place of sample 2000 - n of the other
    assert np.abs(one[1:] - other[:0:-1]).max() < 1e-5 * one.std()


@pytest.mark.parametrize("size", [1, 7, 160])
def test_a_map_does_not_depend_on_how_the_stream_is_cut(
    display: tactile.Display, relief: Texture, size: int
) -> None:
    place = np.stack([np.linspace(0, 0.04, 1600), np.linspace(0, 0.01, 1600)], axis=1)
    force = np.full(len(place), 0.5)
    whole, cut = (
        np.concatenate(
            [
                renderer.block(place[k : k + n], force[k : k + n], shear=True)[1]
                for k in range(0, len(place), n)
            ]
        )
        for renderer, n in (
            (tactile.Renderer(display, relief), 64),
            (tactile.Renderer(display, relief), size),
        )
    )
    assert np.std(whole - cut) < 1e-5 * np.std(whole)


@pytest.mark.parametrize("angle", [0.0, np.pi / 4])
def test_nothing_above_the_stop_band_is_commanded(
    display: tactile.Display, relief: Texture, angle: float
) -> None:
    """Move so fast that the finest waves of the map would be at 1.8 kHz and more.

    The finer of the two levels that are mixed ends at 1 to 1.26 kHz.
    """
    path = tactile.Trajectory.line(speed=0.2, angle=angle, duration=0.6)
    shear = tactile.render(display, relief, path).shear[800:-400, 0]
    power = np.abs(np.fft.rfft(shear * np.hanning(len(shear)))) ** 2
    frequency = np.fft.rfftfreq(len(shear), 1 / 8000)
    assert power[frequency > 1260].sum() < 1e-6 * power.sum()
    assert power[(frequency > 500) & (frequency < 900)].sum() > 1e-4 * power.sum()


def test_closed_forms_tell_what_a_stroke_over_the_map_has(
    display: tactile.Display, relief: Texture
) -> None:
    """Compare third octaves from 25 Hz on: a stroke of 0.16 m has few periods of the lower ones."""
    speed, edges = 0.08, 10 ** (np.arange(13.5, 28) / 10)
    shear = tactile.render(
        display, relief, tactile.Trajectory.line(speed=speed, duration=2.0)
    ).shear[800:]
    power = 2 * np.abs(np.fft.rfft(shear.T * np.hanning(len(shear)))) ** 2
    power = power.mean(axis=0) / (len(shear) * np.sum(np.hanning(len(shear)) ** 2))
    played = np.histogram(np.fft.rfftfreq(len(shear), 1 / 8000), edges, weights=power)[0]
    lines = commanded_lines(relief, speed=speed, normal_force=0.5)
    told = np.histogram(lines.frequency, edges, weights=lines.power)[0]
    difference = 10 * np.log10(played / told)
    assert np.sqrt(np.mean(difference**2)) < 1.5
    assert np.abs(difference).max() < 3.5


def test_a_gain_multiplies_the_map_and_the_waves_beside_it(relief: Texture) -> None:
    place = np.random.default_rng(1).uniform(-1, 1, (50, 2))
    one, twice = (t.realize().random_part(place) for t in (relief, tactile.amplified(relief, 2)))
    assert twice == pytest.approx(2 * one, rel=1e-5, abs=1e-12)
    waves = tactile.amplified(relief, 2).partials.at(place)
    assert waves == pytest.approx(2 * relief.partials.at(place), rel=1e-9, abs=1e-15)


def test_a_texture_with_other_amplitudes_plays_its_parts_instead_of_the_map(
    relief: Texture,
) -> None:
    changed = weighted(relief, np.full(17, 0.5))
    assert changed.descriptor.map is None
    assert changed.amplitude == pytest.approx(0.5 * relief.amplitude)


def test_the_contact_takes_from_short_waves_of_a_map() -> None:
    """Compare a grating of 1.3 mm with the factor 1/√(1 + (κ l)²) of a length of 0.3 mm."""
    played = skin_map(made(plane_wave(1.3e-3, 0, 5e-6), with_map=True))
    place = np.random.default_rng(1).uniform(0, 0.1, (500, 2))
    hard, soft = (map_field(played, length).at(place).std() for length in (0.0, 0.3e-3))
    assert soft / hard == pytest.approx(1 / np.hypot(1, 2 * np.pi * 0.3 / 1.3), rel=0.01)


# Storage and limits


def test_pixels_are_read_as_they_were_written() -> None:
    rng = np.random.default_rng(0)
    for shape in ((16, 40), (1, 7), (33, 20)):
        levels = rng.integers(-32768, 32768, shape).astype(np.int16)
        text = packed(levels)
        assert np.array_equal(unpacked(text, *shape), levels)
        assert max(map(len, text.splitlines())) <= 96


@pytest.mark.ci
def test_a_file_holds_the_middle_of_a_large_fine_picture() -> None:
    """Make a map up to 25 cycles/mm: 9 mm of 13 mm, in less than a file may have."""
    height = np.tile(field(2, isotropic, 1e-6), (2, 2))
    result = made(height, 17e-6, 1e-10, with_map=True)
    played = skin_map(result)
    assert 8 < played.height_mm < 9.5
    assert 190_000 < played.rows * played.columns <= 1 << 18
    assert len(as_toml(result.descriptor)) < 1 << 20
    assert any(note.startswith("the map is the middle of the picture") for note in result.notes)


def text_with(**changes: object) -> str:
    """Return the text of a file with a map of 20 × 20 pixels, some keys of it changed."""
    table: dict[str, object] = {
        "width_mm": 1.0, "height_mm": 1.0, "columns": 20, "rows": 20, "level_um": 1e-4,
        "pixels": packed(np.arange(400, dtype=np.int16).reshape(20, 20)),
    } | changes  # fmt: skip
    oak = tactile.load_texture("wood-oak").descriptor
    assert oak.stochastic is not None
    bands = {
        key: getattr(oak.stochastic, key)[:16]  # to 8 cycles/mm
        for key in ("frequency_per_mm", "level_db", "level_sd_db")
    }
    coarse = structs.replace(oak, stochastic=structs.replace(oak.stochastic, **bands))
    plain = as_toml(coarse).replace("wood-oak", "some-relief")
    keys = [
        f'{key} = """{value}"""' if isinstance(value, str) else f"{key} = {value}"
        for key, value in table.items()
    ]
    return plain + "\n".join(["[map]", *keys])


def read(text: str) -> Descriptor:
    return parse(text, Path("some-relief.toml"))


PIXELS = packed(np.arange(400, dtype=np.int16).reshape(20, 20))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pixels": PIXELS[:-1]}, r"map\.pixels: not base64, or cut short: "),
        ({"pixels": PIXELS[:-8]}, r"map\.pixels: hold \d+ of 20 × 20 pixels: cut short"),
        ({"pixels": "ä" + PIXELS}, r"map\.pixels: not base64"),
        ({"pixels": "AAAA" + PIXELS}, r"map\.pixels: damaged: "),
        ({"rows": 21}, r"map\.pixels: hold 400 of 20 × 21 pixels: cut short, or of another map"),
        ({"rows": 19}, r"map\.pixels: hold more than 20 × 19 pixels"),
        ({"columns": 6000, "rows": 6000}, r"map\.columns = 6000: times 6000 rows is more than 26"),
        ({"level_um": float("nan")}, r"map\.level_um = nan: must be a finite number"),
        (
            {"width_mm": 4.0},
            r"map: resolves 2\.5 cycles/mm: needs 8\.9\d?, where \[stochastic\] en",
        ),
    ],
)
def test_a_bad_map_is_refused_in_one_line(changes: dict[str, object], message: str) -> None:
    assert read(text_with()).map is not None
    with pytest.raises(InputError, match=rf"^some-relief\.toml: {message}") as caught:
        read(text_with(**changes))
    assert "\n" not in str(caught.value)


def test_a_map_needs_bands_or_gratings_beside_it() -> None:
    text = text_with()
    start, end = text.index("[stochastic]"), text.index("[laws]")
    events = "[[events]]\ndensity_per_mm2 = 0.1\namplitude_um = 1.0\nwidth_mm = 0.5\n"
    with pytest.raises(InputError, match=r"map: needs \[stochastic\] or \[\[periodic\]\] beside"):
        read(text[:start] + events + text[end:])


def test_heights_that_are_not_numbers_are_refused() -> None:
    height = field(1, isotropic)
    height[3, 4] = np.nan
    with pytest.raises(InputError, match=r"some\.png: 1 heights are not numbers: fill them first"):
        made(height, with_map=True)
