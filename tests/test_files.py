"""Bad input becomes one line: file, field, value and what is allowed, whatever is wrong with it.

The files are written here, each with one fault; the property tests feed the reader what nobody
thought of. Messages are only searched for the words that a user needs.
"""

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import NO_PANIC, has, refusal

from tactile import files
from tactile.display.display import load_display
from tactile.display.tables import DisplayFile
from tactile.errors import InputError, NotFoundError
from tactile.texture import descriptor
from tactile.texture.descriptor import Descriptor

TEXTURE = """
[texture]
id = "sample"
category = "test"
description = "written by a test"
provenance = "authored"
source = "a test"
license = "CC0-1.0"
[reference]
speed_mm_s = 40.0
normal_force_n = 0.5
[stochastic]
frequency_per_mm = [0.25, 0.316, 0.4, 0.5, 0.63, 0.8, 1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8]
level_db = [0, -1, -2, -3, -4, -5, -6, -7, -8, -9, -10, -11, -12, -13, -14, -15]
am_depth = 0.1
[[periodic]]
wavelength_mm = 2.0
harmonics_um = [1.0, 0.5]
[[periodic]]
wavelength_mm = 3.0
harmonics_um = [2.0, 0.25]
phases_deg = [0.0, 90.0]
[[events]]
density_per_mm2 = 0.5
amplitude_um = 2.5
width_mm = 0.4
shape = "pulse"
[laws]
speed_range_mm_s = [20.0, 60.0]
contact_length_mm = 1.5
"""

DISPLAY = """
[display]
id = "sample"
description = "written by a test"
opening_mm = [2.0, 3.0]
shear_projection = "none"
[[contactor]]
position_mm = [0.0, 0.0]
channel = 0
[[contactor]]
position_mm = [2.5, 0.0]
channel = 1
polarity = 1
[bimorph]
width_mm = 2.1
length_mm = 20.0
clamped_length_mm = 5.0
piezo_height_mm = 0.26
shim_height_mm = 0.20
[[finger.table]]
normal_force_n = 0.2
k0_n_per_m = 1000.0
d0_n_s_per_m = 0.11
branches = [[1300.0, 0.33]]
[[finger.table]]
normal_force_n = 0.5
k0_n_per_m = 4300.0
d0_n_s_per_m = 0.55
branches = [[5000.0, 2.0]]
[amplifier]
hold = "none"
[limits]
voltage_v = 100.0
fade_ms = 20.0
"""


def refused(path: Path, text: str | bytes) -> str:
    """Write a file, load it, and return the one line that it is refused with, less its path."""
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    load = load_display if path.parent.name == "displays" else descriptor.load
    with pytest.raises(InputError) as caught:
        load(path)
    message = str(caught.value)
    assert len(message.splitlines()) == 1, message
    assert message.startswith(f"{path}: "), message
    assert not isinstance(caught.value, LookupError)
    return message.removeprefix(f"{path}: ")


def with_fault(folder: Path, kind: str, old: str, new: str) -> str:
    """Return the line that a texture or display is refused with for one changed line."""
    text = TEXTURE if kind == "textures" else DISPLAY
    assert old in text
    (folder / kind).mkdir()
    return refused(folder / kind / "sample.toml", text.replace(old, new, 1))


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 20_000) + " = 1", ". ".join(["a"] * 20_000) + " = 1",
        ".".join(['"a"'] * 20_000) + " = 1", "[" + ".".join("a" * 20_000) + "]",
        "x = {" + ".".join("a" * 20_000) + " = 1}", ".".join("a" * 33) + " = 1",
    ],
    ids=["bare", "spaced", "quoted", "table", "inline", "one too many"],
)  # fmt: skip
def test_a_key_of_too_many_parts_is_refused_before_it_is_parsed(tmp_path: Path, text: str) -> None:
    assert refused(tmp_path / "a.toml", text).startswith("has a key of more than 32 parts")


def test_dots_that_part_no_key_are_none(tmp_path: Path) -> None:
    """Dots stand in comments, in strings of each kind and in numbers; 32 parts are allowed."""
    words = ".".join("a" * 100)
    strings = "".join(f"{q}{words}{q}, " for q in ('"', "'", '"""', "'''"))
    numbers = "0.5, " * 100
    text = f"# {words}\nx = [{strings} {numbers}] # {words}\n"
    assert "x: unknown key" in refused(tmp_path / "a.toml", text)
    deep = ".".join(f"k{i}" for i in range(32))
    assert "k0: unknown key" in refused(tmp_path / "a.toml", f"{deep} = 1")


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """A device that never ends is not read any further either."""
    large = "#" * (1024 * 1024 + 1)
    assert "more than 1024 KiB" in refused(tmp_path / "a.toml", large)
    (tmp_path / "a.toml").write_text(large[:-1])
    assert files.read_text(tmp_path / "a.toml") == large[:-1]
    if Path("/dev/zero").exists():
        with pytest.raises(InputError, match=r"^/dev/zero: has more than 1024 KiB"):
            files.read(Path("/dev/zero"), DisplayFile)


def test_the_old_key_of_the_license_is_read_unless_the_new_one_is_there(tmp_path: Path) -> None:
    line = 'license = "CC0-1.0"'
    old = TEXTURE.replace(line, 'licence = "by hand"')
    assert old != TEXTURE
    (tmp_path / "sample.toml").write_text(old)
    assert descriptor.load(tmp_path / "sample.toml").texture.license == "by hand"
    both = TEXTURE.replace(line, f'{line}\nlicence = "by hand"')
    has(refused(tmp_path / "sample.toml", both), "texture.licence: unknown key", "'license'")


def test_what_is_said_of_a_long_value_is_short(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    said = refused(path, "a" * 100_000 + " = 1")
    assert len(f"{path}: {said}") == 1000


def test_the_files_that_the_faults_are_put_into_are_good(tmp_path: Path) -> None:
    (tmp_path / "sample.toml").write_text(TEXTURE)
    assert descriptor.load(tmp_path / "sample.toml").periodic[1].phases_deg == (0.0, 90.0)
    (tmp_path / "sample.toml").write_text(DISPLAY)
    assert load_display(tmp_path / "sample.toml").channels == 2


FAULTS: dict[str, list[tuple[str, ...]]] = {
    "an unknown key is named with its place and the nearest known": [
        ("textures", "[laws]", "[lews]", "lews: unknown key", "'laws'"),
        ("textures", "[[events]]", "[[event]]", "event: unknown key", "'events'"),
        ("textures", "am_depth", "am_dept", "stochastic.am_dept: unknown key", "'am_depth'"),
        ("textures", "speed_mm_s", "speed", "reference.speed: unknown key", "'speed_mm_s'"),
        ("textures", "phases_deg", "phase_deg",
         "periodic[1].phase_deg: unknown key", "'phases_deg'"),
        ("textures", "width_mm", "width_um", "events[0].width_um: unknown key", "'width_mm'"),
        ("textures", "am_depth", "zzz", "stochastic.zzz: unknown key", "am_corner_per_mm"),
        ("displays", "[limits]", "[limit]", "limit: unknown key", "'limits'"),
        ("displays", "voltage_v", "voltage_V", "limits.voltage_V: unknown key", "'voltage_v'"),
        ("displays", "polarity", "polarty", "contactor[1].polarty: unknown key", "'polarity'"),
        ("displays", "k0_n_per_m", "k_n_per_m",
         "finger.table[0].k_n_per_m: unknown key", "'k0_n_per_m'"),
    ],
    "a wrong type names field value and both types": [
        ("textures", "= 0.1\n", '= "much"\n',
         "stochastic.am_depth = 'much'", "expected float", "got str"),
        ("textures", "= 0.1\n", "= true\n",
         "stochastic.am_depth = True", "expected float", "got bool"),
        ("textures", "= 0.1\n", "= 2020-01-01\n",
         "stochastic.am_depth", "expected float", "got date"),
        ("textures", "= 0.1\n", "= [0.1]\n", "stochastic.am_depth", "expected float", "got array"),
        ("textures", "-3,", '"-3",', "stochastic.level_db[3] = '-3'", "expected float", "got str"),
        ("textures", "[2.0, 0.25]", "2.0",
         "periodic[1].harmonics_um = 2.0", "expected array", "got float"),
        ("textures", "[laws]", "[[laws]]", "laws", "expected object", "got array"),
        ("textures", "[[events]]", "[events]", "events", "expected array", "got object"),
        ("displays", "= 1\n", "= 1.5\n", "contactor[1].channel = 1.5", "expected int", "got float"),
        ("displays", "5000.0, 2.0", '5000.0, "a"',
         "finger.table[1].branches[0][1]", "expected float", "got str"),
    ],
    "out of range names field value and limit": [
        ("textures", "= 0.1\n", "= 1.01\n", "stochastic.am_depth = 1.01: ", "<= 1"),
        ("textures", "= 0.1\n", "= -0.01\n", "stochastic.am_depth = -0.01: ", ">= 0"),
        ("textures", "= 40.0", "= 0", "reference.speed_mm_s = 0: ", "> 0"),
        ("textures", "-3,", "-130,", "stochastic.level_db[3] = -130: ", ">= -120"),
        ("textures", "[0.0, 90.0]", "[0.0, 361.0]",
         "periodic[1].phases_deg[1] = 361.0: ", "<= 360"),
        ("textures", "= 2.5", "= 501", "events[0].amplitude_um = 501: ", "<= 500"),
        ("displays", "= 100.0", "= 1e6", "limits.voltage_v = 1000000.0: ", "<= 1000"),
        ("displays", "fade_ms = 20.0", "fade_ms = 0.02", "limits.fade_ms = 0.02: ", ">= 1"),
        ("displays", "channel = 1", "channel = -1", "contactor[1].channel = -1: ", ">= 0"),
        ("displays", "[2.5, 0.0]", "[2.5, 501]", "contactor[1].position_mm[1] = 501: ", "<= 500"),
        ("displays", "force_n = 0.5", "force_n = 51",
         "finger.table[1].normal_force_n = 51: ", "<= 50"),
    ],
    "a wrong number of values names how many and how many there must be": [
        ("textures", "[0, -1,", "[0,", "level_db", "15", "16"),
        ("textures", ", 8]", ", 8, 10]", "level_db", "16", "17"),
        ("textures", "am_depth = 0.1", "level_sd_db = [1.0]", "level_sd_db", "1 values", "16"),
        ("textures", "[0.0, 90.0]", "[0.0]", "periodic[1]", "phases_deg", "1 values", "2"),
        ("textures", "[1.0, 0.5]", "[]", "periodic[0].harmonics_um", ">= 1"),
        ("textures", "[20.0, 60.0]", "[20.0]", "laws.speed_range_mm_s", "2", "1"),
        ("displays", "[2.5, 0.0]", "[2.5, 0, 0]", "contactor[1].position_mm", "2", "3"),
        ("displays", "[2.0, 3.0]", "[2.0]", "display.opening_mm", "2", "1"),
        ("displays", "[[5000.0, 2.0]]", "[[5000.0]]", "finger.table[1].branches[0]", "2", "1"),
    ],
    "a missing key is named with the table that needs it": [
        ("textures", 'source = "a test"\n', "", "texture: Object missing required field source"),
        ("textures", "normal_force_n = 0.5\n", "",
         "reference: Object missing required field normal_force_n"),
        ("textures", "wavelength_mm = 3.0\n", "",
         "periodic[1]: Object missing required field wavelength_mm"),
        ("textures", "[reference]\nspeed_mm_s = 40.0\nnormal_force_n = 0.5\n", "",
         "Object missing required field reference"),
        ("displays", "channel = 1\n", "", "contactor[1]: Object missing required field channel"),
        ("displays", "d0_n_s_per_m = 0.55\n", "",
         "finger.table[1]: Object missing required field d0_n_s_per_m"),
        ("displays", "[limits]\nvoltage_v = 100.0\nfade_ms = 20.0\n", "",
         "Object missing required field limits"),
    ],
    "a length in meters is out of the range of a key in millimeters": [
        ("textures", "wavelength_mm = 2.0", "wavelength_mm = 0.002", "periodic[0].wavelength_mm"),
        ("textures", "width_mm = 0.4", "width_mm = 0.0004", "events[0].width_mm"),
        ("textures", "length_mm = 1.5", "length_mm = 0.0015", "laws.contact_length_mm"),
        ("displays", "width_mm = 2.1", "width_mm = 0.0021", "bimorph.width_mm"),
        ("displays", "length_mm = 20.0", "length_mm = 0.02", "bimorph.length_mm"),
        ("displays", "piezo_height_mm = 0.26", "piezo_height_mm = 0.00026", "bimorph.piezo_height"),
        ("displays", "clamped_length_mm = 5.0", "clamped_length_mm = 0.005", "clamped_length_mm"),
        ("displays", "shim_height_mm = 0.20", "shim_height_mm = 0.0002", "bimorph.shim_height_mm"),
        ("displays", "[2.0, 3.0]", "[0.002, 0.003]", "display.opening_mm"),
    ],
    "an unknown option is named with the nearest known": [
        ("textures", '"test"', '"wod"', "texture.category = 'wod'", "'wood'"),
        ("textures", '"pulse"', '"puls"', "events[0].shape = 'puls'", "'pulse'"),
        ("displays", "polarity = 1", "polarity = 2", "contactor[1].polarity = 2", "-1"),
        ("displays", '"none"\n[l', '"zho"\n[l', "amplifier.hold = 'zho'", "'zoh'"),
        ("displays", '"none"\n[[', '"motoin"\n[[', "display.shear_projection", "'motion'"),
    ],
}  # fmt: skip
"""Faults by what the refusal says: kind of file, text, its replacement, and words of the line that
refuses it."""


@pytest.mark.parametrize(
    "fault", [pytest.param(fault, id=rule) for rule, faults in FAULTS.items() for fault in faults]
)
def test_a_fault_in_a_file_is_refused_in_a_line_that_says(
    tmp_path: Path, fault: tuple[str, ...]
) -> None:
    kind, old, new, *words = fault
    has(with_fault(tmp_path, kind, old, new), *words)


@pytest.mark.parametrize("number", ["nan", "-nan", "inf", "-inf", "1e999"])
@pytest.mark.parametrize(
    ("kind", "old", "new", "field"),
    [
        ("textures", "am_depth = 0.1", "am_depth = {}", "stochastic.am_depth"),
        ("textures", "-15]", "{}]", "stochastic.level_db[15]"),
        ("textures", "[2.0, 0.25]", "[2.0, {}]", "periodic[1].harmonics_um[1]"),
        ("textures", "am_depth = 0.1", "unknown = [[0, {}]]", "stochastic.unknown[0][1]"),
        ("displays", "[[1300.0, 0.33]]", "[[1300.0, {}]]", "finger.table[0].branches[0][1]"),
        ("displays", "voltage_v = 100.0", "voltage_v = {}", "limits.voltage_v"),
    ],
)
def test_a_number_that_is_not_finite_is_refused_anywhere(
    tmp_path: Path, kind: str, old: str, new: str, field: str, number: str
) -> None:
    message = with_fault(tmp_path, kind, old, new.format(number))
    has(message, f"{field} = {float(number)}: ", "finite")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"\xff\xfe[texture]", ("cannot be read", "byte 0xff")),
        ("[texture\n", ("not valid TOML", "line 1")),
        ("[texture]\nid = leather\n", ("not valid TOML", "line 2")),
        ("[texture]\nid = 'a'\nid = 'b'\n", ("not valid TOML", "line 3")),
        ("", ("missing required field texture",)),
    ],
)
def test_what_is_no_toml_says_where(
    tmp_path: Path, text: str | bytes, words: tuple[str, ...]
) -> None:
    has(refused(tmp_path / "sample.toml", text), *words)


def test_a_file_that_cannot_be_opened_says_why(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing.toml"):
        with pytest.raises(InputError, match="cannot be read") as caught:
            files.read(path, Descriptor)
        assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    "number",
    [
        pytest.param("9" * 400, id="400 digits, beyond double precision"),
        pytest.param("9" * 5000, id="5000 digits, beyond what int() reads"),
        pytest.param("[" * 3000 + "]" * 3000, id="3000 nested arrays"),
    ],
)
def test_a_value_beyond_what_python_reads_is_refused_like_any_other(
    tmp_path: Path, number: str
) -> None:
    refused(tmp_path / "sample.toml", TEXTURE.replace("= 0.1\n", f"= {number}\n"))


def test_a_key_with_a_line_break_still_makes_one_line(tmp_path: Path) -> None:
    text = TEXTURE.replace("am_depth", '"am\\ndepth"')
    has(refused(tmp_path / "sample.toml", text), "unknown key")


@NO_PANIC
@given(content=st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
def test_whatever_a_file_holds_it_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "anything.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        files.read(path, Descriptor)
    assert "\n" not in str(caught.value).removeprefix(str(path))


def toml(value: object) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, list):
        return f"[{', '.join(toml(v) for v in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else '"x"'


@NO_PANIC
@given(
    data=st.data(),
    value=st.recursive(
        st.floats() | st.integers(-(2**63), 2**63 - 1) | st.booleans() | st.just("x"),
        lambda inner: st.lists(inner, max_size=4),
        max_leaves=6,
    ),
)
def test_whatever_value_a_key_is_given_it_is_taken_or_refused_by_name(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, value: object
) -> None:
    of_texture = data.draw(st.booleans())
    shape: type[msgspec.Struct] = Descriptor if of_texture else DisplayFile
    text = TEXTURE if of_texture else DISPLAY
    lines = text.splitlines()
    place = data.draw(st.sampled_from([i for i, row in enumerate(lines) if "=" in row]))
    key = lines[place].split(" = ")[0]
    lines[place] = f"{key} = {toml(value)}"
    path = tmp_path_factory.getbasetemp() / "sample.toml"
    path.write_text("\n".join(lines))
    message = refusal(lambda: files.read(path, shape))
    assert message is None or (key in message and "\n" not in message)


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("textures", "wood-oka", ("no texture 'wood-oka'", "did you mean 'wood-oak'?")),
        ("textures", "leather", ("no texture", "did you mean 'leather-")),
        ("textures", "zzz", ("no texture 'zzz'", "leather-calf", "wood-pine-sanded")),
        ("displays", "reference-46", ("no display", "did you mean 'reference-")),
        ("displays", "reference64", ("no display", "did you mean 'reference-64'?")),
        ("textures", "wood/none.toml", ("wood/none.toml: no such file",)),
        ("textures", "none.toml", ("none.toml: no such file",)),
    ],
)
def test_a_missing_name_is_answered_with_the_nearest(
    kind: str, name: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(NotFoundError) as caught:
        files.find(kind, name)
    has(str(caught.value), *words)
    assert isinstance(caught.value, InputError)
    assert isinstance(caught.value, LookupError)
    assert "\n" not in str(caught.value)


def test_a_name_too_long_for_a_file_is_missing_like_any_other() -> None:
    with pytest.raises(NotFoundError):
        files.find("textures", "a" * 300 + ".toml")


def test_a_descriptor_is_named_like_its_file(tmp_path: Path) -> None:
    has(refused(tmp_path / "other.toml", TEXTURE), "texture.id = 'sample'", "'other'")


def test_shipped_files_are_found_in_a_wheel_and_in_a_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wheel holds them inside of the package, a checkout beside it; the wheel's go first."""
    monkeypatch.setattr(files, "__file__", str(tmp_path / "tactile" / "files.py"))
    for folder, name in (("textures/b", "two"), ("textures/a", "three"), ("textures", "one")):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / f"{name}.toml").touch()
    assert list(files.shipped_names("textures")) == ["one", "three", "two"]
    assert files.find("textures", "two") == tmp_path / "textures/b/two.toml"
    inside = tmp_path / "tactile/_data/textures"
    inside.mkdir(parents=True)
    (inside / "four.toml").touch()
    assert files.shipped_names("textures") == {"four": inside / "four.toml"}
