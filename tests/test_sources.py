"""Tests of displays and textures that are built from the texts of their files alone."""

from pathlib import Path

import numpy as np
import pytest
from display_files import FINGER, GRID, HEAD, LIMITS

from tactile.display import display as displays
from tactile.display.display import Display, display_of, load_display
from tactile.errors import InputError
from tactile.files import SourceFile
from tactile.texture import surface
from tactile.texture.surface import load_texture, texture_of

CONTACTOR = "[[contactor]]\nposition_mm = [{x}, 0.0]\nchannel = {channel}\n"
RESPONSE = "frequency_hz,magnitude,phase_deg,unit\r\n10,{size},0,um/V\r\n2000,0.1,-90,um/V\r\n"


def measured_display(folder: Path) -> Path:
    """Write a display whose contactors have responses in files of several folders."""
    (folder / "display").mkdir()
    tables = {"own.csv": 0.5, "../group.csv": 0.6, str(folder / "absolute.csv"): 0.7}
    for name, size in tables.items():
        (folder / "display" / name).write_bytes(RESPONSE.format(size=size).encode())
    parts = [
        HEAD,
        CONTACTOR.format(x=0.0, channel=0) + 'response = "own.csv"\n',
        CONTACTOR.format(x=10.0, channel=1),
        CONTACTOR.format(x=20.0, channel=2) + f'response = "{folder / "absolute.csv"}"\n',
        '[[group]]\nresponse = "../group.csv"\n',
        '[[group]]\nresponse = "no-such.csv"\ncontactors = [0]\n',  # which has one of its own
        FINGER,
        LIMITS,
    ]
    path = folder / "display" / "sample.toml"
    path.write_text("".join(parts), "utf-8")
    return path


def assert_same(one: Display, other: Display) -> None:
    """Compare all that rendering takes from two displays."""
    frequency = np.geomspace(5, 4000, 50)
    assert (
        one.responses(frequency, 8000.0).tobytes() == other.responses(frequency, 8000.0).tobytes()
    )
    for name in ("contactors", "shear_direction", "polarity", "channel", "kind"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    for name in ("name", "opening", "projected", "load", "amplifier", "limits"):
        assert getattr(one, name) == getattr(other, name)


def test_a_display_is_built_from_its_texts_after_its_files_are_gone(tmp_path: Path) -> None:
    path = measured_display(tmp_path)
    loaded, source = displays.load_with_source(path)
    assert source.name == "sample.toml"
    assert source.text == path.read_text("utf-8")
    assert set(source.tables) == {"own.csv", "../group.csv", str(tmp_path / "absolute.csv")}
    assert source.tables["own.csv"] == RESPONSE.format(size=0.5)
    assert len(loaded.measured) == 3
    assert_same(loaded, load_display(path))
    for file in (path, *tmp_path.rglob("*.csv")):
        file.unlink()
    assert_same(display_of(source, Path("elsewhere")), loaded)


def test_a_text_that_is_missing_or_wrong_is_one_line(tmp_path: Path) -> None:
    _, source = displays.load_with_source(measured_display(tmp_path))
    with pytest.raises(InputError, match=r"^r\.h5/sample\.toml: the text of .* is missing$"):
        display_of(SourceFile(source.name, source.text), Path("r.h5"))
    tables = source.tables | {"own.csv": "frequency_hz,magnitude,phase_deg,unit\n10,x,0,um/V\n"}
    with pytest.raises(InputError, match=r"^r\.h5/own\.csv: line 2: magnitude = 'x'"):
        display_of(SourceFile(source.name, source.text, tables), Path("r.h5"))
    with pytest.raises(InputError, match=r"^r\.h5/sample\.toml: not valid TOML"):
        display_of(SourceFile(source.name, "[display", {}), Path("r.h5"))


def test_the_actuator_of_a_voice_coil_is_among_the_texts(tmp_path: Path) -> None:
    coil = '[voice_coil]\nresponse = "coil.csv"\nresistance_ohm = 8.0\ncurrent_a = 1.0\n'
    limits = "[limits]\nvoltage_v = 5.0\n"
    (tmp_path / "coil.csv").write_text(RESPONSE.format(size=0.5), "utf-8")
    path = tmp_path / "coil.toml"
    path.write_text("".join([HEAD, GRID, coil, "size_mm = [1.0, 1.0]\n", FINGER, limits]), "utf-8")
    loaded, source = displays.load_with_source(path)
    (tmp_path / "coil.csv").unlink()
    assert set(source.tables) == {"coil.csv"}
    assert_same(display_of(source, tmp_path), loaded)


def test_a_texture_is_built_from_its_text_as_from_its_file() -> None:
    loaded, source = surface.load_with_source("wood-oak")
    built, original = texture_of(source, Path("r.h5")), load_texture("wood-oak")
    for texture in (loaded, built):
        assert texture.descriptor == original.descriptor
        assert texture.wave_vector.tobytes() == original.wave_vector.tobytes()
        assert texture.amplitude.tobytes() == original.amplitude.tobytes()
    renamed = SourceFile("other.toml", source.text)
    with pytest.raises(InputError, match=r"^r\.h5/other\.toml: texture\.id = 'wood-oak'"):
        texture_of(renamed, Path("r.h5"))
