"""A descriptor written to a file reads back as itself, whatever it says.

The judge is the reader (`tomllib` and the schema), which shares nothing with the writer.
"""

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile.errors import InputError
from tactile.texture import descriptor as descriptors
from tactile.texture.descriptor import Descriptor, Periodic, Stochastic
from tactile.texture.descriptor_file import as_toml, write

CENTERS = tuple((10 ** (np.arange(-20, 21) / 10)).tolist())


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high)


def several(count: int, low: float, high: float) -> st.SearchStrategy[tuple[float, ...]]:
    return st.lists(floats(low, high), min_size=count, max_size=count).map(tuple)


LINES = st.text(st.sampled_from("aµ \"\\\n\t#\r\x00\x7f'")) | st.text()
ABOUT = st.builds(
    descriptors.About,
    id=st.from_regex("[a-z0-9]{1,4}(-[a-z0-9]{1,4})?", fullmatch=True),
    category=st.sampled_from(["wood", "test"]),
    description=LINES,
    provenance=st.sampled_from(["fitted", "published", "authored"]),
    source=LINES.filter(bool) | st.lists(LINES, min_size=20).map(" ".join),
    license=LINES,
)
REFERENCE = st.builds(
    descriptors.Reference, speed_mm_s=floats(1e-9, 1000), normal_force_n=floats(1e-9, 20)
)
STOCHASTIC = st.integers(4, 41).flatmap(
    lambda count: st.builds(
        Stochastic,
        frequency_per_mm=st.just(CENTERS[:count]),
        level_db=several(count, -120, 60),
        level_sd_db=st.just(()) | several(count, 0, 40),
        excess_kurtosis=floats(0, 30),
        am_depth=floats(0, 1),
        am_corner_per_mm=floats(0.01, 1),
        direction_deg=floats(-360, 360),
        direction_spread_deg=st.none() | floats(1e-9, 60),
    )
)
HARMONICS = st.integers(1, 32).flatmap(
    lambda n: st.tuples(
        st.lists(floats(0, 500), min_size=n, max_size=n).map(tuple),
        st.just(()) | st.lists(floats(-360, 360), min_size=n, max_size=n).map(tuple),
    )
)
PERIODIC = st.builds(
    lambda wavelength, parts, jitter, direction: Periodic(
        wavelength_mm=wavelength, harmonics_um=parts[0], phases_deg=parts[1], jitter=jitter,
        direction_deg=direction,
    ),
    floats(0.02, 100), HARMONICS, floats(0, 0.3), floats(-360, 360),
)  # fmt: skip
EVENTS = st.builds(
    descriptors.Events,
    density_per_mm2=floats(1e-9, 4),
    amplitude_um=floats(1e-9, 500),
    amplitude_sd=floats(0, 2),
    width_mm=floats(0.1, 5),
    shape=st.sampled_from(["pulse", "edge"]),
    direction_deg=floats(-360, 360),
)
LAWS = st.builds(
    descriptors.Laws,
    speed_exponent=floats(-4, 4),
    speed_range_mm_s=st.tuples(floats(1, 20), floats(21, 1000)),
    contact_length_mm=st.just(0.0) | floats(0.05, 20),
)
FRICTION = st.builds(
    descriptors.Friction, static_coefficient=floats(0.1, 5), kinetic_coefficient=floats(0.1, 5)
)
DESCRIPTORS = st.builds(
    Descriptor,
    texture=ABOUT,
    reference=REFERENCE,
    stochastic=STOCHASTIC,
    periodic=st.lists(PERIODIC, max_size=3).map(tuple),
    events=st.lists(EVENTS, max_size=2).map(tuple),
    laws=st.just(descriptors.Laws()) | LAWS,
    friction=st.none() | FRICTION,
)
CALF = descriptors.load("leather-calf")


def read_back(text: str) -> Descriptor:
    return msgspec.convert(tomllib.loads(text), Descriptor)


@settings(max_examples=30)
@given(DESCRIPTORS)
def test_any_descriptor_reads_back_as_itself(descriptor: Descriptor) -> None:
    assert read_back(as_toml(descriptor)) == descriptor


@pytest.mark.parametrize("name", descriptors.textures())
def test_a_shipped_texture_written_again_is_the_same_texture(name: str, tmp_path: Path) -> None:
    known = descriptors.load(name)
    write(known, tmp_path / f"{name}.toml")
    assert descriptors.load(tmp_path / f"{name}.toml") == known
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.toml"]


def test_the_text_is_laid_out_as_the_shipped_files_are() -> None:
    text = as_toml(CALF)
    rows = text.split("frequency_per_mm = [\n")[1].split("]")[0].splitlines()
    assert [row.count(",") for row in rows] == [8, 8, 4]
    assert len({len(row) for row in rows[:2]}) == 1, "columns are aligned"
    assert 'source = """\nLevel: reference' in text
    assert max(map(len, text.splitlines())) <= 100
    assert "direction_deg" not in text, "defaults are left out"
    assert not text.startswith("\n")
    assert "\n\n\n" not in text


def test_comments_stand_with_what_they_are_about_and_change_nothing() -> None:
    comments = {
        "": "Two lines\nabove all.",
        "stochastic": "the bands",
        "stochastic.level_db": "measured\x7f twice",
        "reference.speed_mm_s": "as recorded",
    }
    text = as_toml(CALF, comments)
    assert text.startswith("# Two lines\n# above all.\n\n[texture]\n")
    assert "\n# the bands\n[stochastic]\n" in text
    assert "\n# measured  twice\nlevel_db = [\n" in text
    assert "\nspeed_mm_s = 40.0  # as recorded\n" in text
    assert read_back(text) == CALF


def test_a_comment_about_nothing_that_is_written_is_a_mistake() -> None:
    with pytest.raises(ValueError, match=r"not written: stochastic\.color$"):
        as_toml(CALF, {"stochastic.color": "red"})


def test_what_cannot_be_a_descriptor_is_not_written(tmp_path: Path) -> None:
    target = tmp_path / "leather-calf.toml"
    part = Periodic(wavelength_mm=float("nan"), harmonics_um=(1.0,))
    with pytest.raises(InputError, match=r"periodic\[0\].wavelength_mm = nan: must be a finite"):
        write(msgspec.structs.replace(CALF, periodic=(part,)), target)
    part = Periodic(wavelength_mm=200.0, harmonics_um=(1.0,))
    with pytest.raises(
        InputError, match=r"not written: periodic\[0\]\.wavelength_mm = 200.0: .* <= 100"
    ):
        write(msgspec.structs.replace(CALF, periodic=(part,)), target)
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_name_or_already_there_is_refused(tmp_path: Path) -> None:
    for name, problem in (
        ("calf.toml", "must be named after its texture: leather-calf.toml"),
        ("leather-calf.json", "must end in .toml"),
        ("nowhere/leather-calf.toml", "no folder"),
    ):
        with pytest.raises(InputError, match=problem):
            write(CALF, tmp_path / name)
    target = tmp_path / "leather-calf.toml"
    target.write_text("mine")
    with pytest.raises(InputError, match="already exists; --force overwrites it"):
        write(CALF, target)
    assert target.read_text() == "mine"
    write(CALF, target, force=True)
    assert descriptors.load(target) == CALF
