"""Tests of recordings that are read and rendered again: alone, interrupted, damaged, of others."""

import json
import shutil
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from cli_rig import Command, assert_mistake, provenance_of, recorded
from playback_rig import stroke
from test_origin import interrupting
from test_sources import measured_display
from threadpoolctl import threadpool_limits

import tactile
from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.files import shipped_names
from tactile.playback.replaying import replay
from tactile.playback.runs import run
from tactile.texture.surface import Texture

KINDS = pytest.mark.parametrize("kind", [".h5", ".npz"])
PATH = "time_s,x_mm,y_mm,normal_force_n\n1,0,0,0.5\n1.05,3,1,0.6\n1.1,0,2,0.4\n"


Change = Callable[[dict[str, Any], dict[str, Any]], object]
"""Function that changes the arrays and the provenance of a recording."""


def rewrite(path: Path, change: Change) -> None:
    """Change arrays and provenance of a recording, and write it by other means than ours."""
    arrays: dict[str, Any] = dict(recorded(path))
    facts = provenance_of(path)
    change(arrays, facts)
    arrays["provenance"] = json.dumps(facts)
    if path.suffix == ".npz":
        np.savez(path, allow_pickle=False, **arrays)
        return
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values


@pytest.fixture(scope="module", params=[".h5", ".npz"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a tenth of a second on ``mock:``, played once."""
    from tactile.display.display import load_with_source as load_display
    from tactile.playback.origin import Sources
    from tactile.texture.surface import load_with_source as load_texture

    target = Path(tmp_path_factory.mktemp("whole") / f"oak{request.param}")
    display, display_source = load_display("reference-24")
    texture, texture_source = load_texture("wood-oak")
    sources = Sources(display_source, texture_source)
    run(display, texture, stroke(0.1), device="mock:", record=target, sources=sources)
    return target


@pytest.fixture
def recording(whole: Path, tmp_path: Path) -> Path:
    """Return a copy of the recording that a test may change."""
    return Path(shutil.copy(whole, tmp_path))


# Replay


@pytest.mark.parametrize("device", ["sim:", "mock:", "mock:?link=serial&bit_rate=3000000"])
@KINDS
def test_a_recording_alone_is_enough_to_render_its_drive_bit_for_bit(
    command: Command, tmp_path: Path, kind: str, device: str
) -> None:
    """The display has measured responses; all files are gone or changed afterwards."""
    measured_display(tmp_path)
    texture = tmp_path / "textile-denim.toml"
    shutil.copy(shipped_names("textures")["textile-denim"], texture)
    (tmp_path / "path.csv").write_text(PATH, "utf-8")
    played = [
        "--display", "display/sample.toml", "--path", "path.csv", "--gain", 0.7, "--seed", 5,
        "--device", device, "--quiet", "--allow-loss=100%",
    ]  # fmt: skip
    target = tmp_path / f"r{kind}"
    assert command("play", texture, *played, "--record", target).code == 0
    shutil.rmtree(tmp_path / "display")
    for file in tmp_path.glob("*.csv"):
        file.unlink()
    texture.write_text("changed", "utf-8")
    result = command("replay", target)
    assert (result.code, result.err) == (0, "")
    assert result.out == "800 samples of 3 contactors are identical\n"
    facts = command("replay", target, "--json").json
    assert facts["is_identical"] is True
    assert facts["compared_samples"] == facts["planned_samples"] == len(recorded(target)["drive_v"])
    assert np.abs(recorded(target)["drive_v"]).max() > 0.1, "which zeros would not be worth"


def test_the_first_bit_that_differs_is_found(command: Command, recording: Path) -> None:
    def change(arrays: dict[str, Any], facts: dict[str, Any]) -> None:
        arrays["drive_v"][700, 3] = np.nextafter(arrays["drive_v"][700, 3], 1e9)
        arrays["drive_v"][710, 2] += 0.25

    rewrite(recording, change)
    result = command("replay", recording)
    assert (result.code, result.out) == (1, "800 samples of 24 contactors are not identical\n")
    said = "the drive differs from sample 700, contactor 3 on, by at most 0.25 V"
    assert result.err == f"tactile: {recording}: {said}\n"
    facts = command("replay", recording, "--json").json
    assert (facts["is_identical"], facts["differing_values"]) == (False, 2)
    assert (facts["first_sample"], facts["first_contactor"]) == (700, 3)
    assert facts["largest_difference_v"] == pytest.approx(0.25, rel=1e-12)


def test_a_long_recording_is_compared_to_its_end(command: Command) -> None:
    """Two seconds are read in two blocks; the bit is in the second."""
    command("play", "wood-oak", "--seconds", 2, "--device", "mock:", "--record", "r.npz")
    assert replay("r.npz").is_identical

    def change(arrays: dict[str, Any], facts: dict[str, Any]) -> None:
        arrays["drive_v"][15_000, 23] = np.nextafter(arrays["drive_v"][15_000, 23], 1e9)

    rewrite(Path("r.npz"), change)
    result = replay("r.npz")
    assert (result.compared_samples, result.differing_values) == (16_000, 1)
    assert (result.first_sample, result.first_contactor) == (15_000, 23)


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "seed": lambda facts: facts.update(seed=1),
    "gain": lambda facts: facts.update(gain=1.0000001),
    "texture": lambda facts: facts["sources"]["texture"].update(
        text=facts["sources"]["texture"]["text"].replace("excess_kurtosis = 1.2", "")
    ),
    "display": lambda facts: facts["sources"]["display"].update(
        text=facts["sources"]["display"]["text"].replace("fade_ms = 20.0", "fade_ms = 21.0")
    ),
}


@pytest.mark.parametrize("case", CHANGES)
def test_all_that_the_drive_depends_on_is_taken_from_the_recording(
    recording: Path, case: str
) -> None:
    assert replay(recording).is_identical
    rewrite(recording, lambda arrays, facts: CHANGES[case](facts))
    result = replay(recording)
    assert not result.is_identical
    assert result.largest_difference_v > 0


def test_a_path_that_is_slower_is_another_drive(recording: Path) -> None:
    def change(arrays: dict[str, Any], facts: dict[str, Any]) -> None:
        arrays["path_position_m"] = arrays["path_position_m"] * 0.999

    rewrite(recording, change)
    assert not replay(recording).is_identical


@KINDS
def test_an_interrupted_recording_is_replayed_as_far_as_it_goes(
    command: Command, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    interrupting(monkeypatch, 6, after=False)
    target = Path(f"r{kind}")
    result = command("play", "wood-oak", "--seconds", 0.2, "--record", target, "--quiet")
    assert result.code == 130
    count = len(recorded(target)["drive_v"])
    result = command("replay", target)
    assert (result.code, result.err) == (0, "")
    assert result.out == (
        f"{count} samples of 24 contactors are identical; the recording ends before sample 1600 of "
        "the stroke; the stroke was incomplete: interrupted\n"
    )


def test_the_number_of_threads_changes_no_bit(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    """Regression: two threads of BLAS gave drives that differed by 8 µV."""
    drives = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            run(display, oak, stroke(0.5), device="mock:", record=tmp_path / "r.npz")
        drives.append(recorded(tmp_path / "r.npz")["drive_v"])
    assert np.array_equal(drives[0], drives[1])


# Recordings of other versions


def test_other_versions_are_named_when_the_drive_differs(command: Command, recording: Path) -> None:
    def older(arrays: dict[str, Any], facts: dict[str, Any]) -> None:
        facts["versions"]["numpy"] = "1.0"
        facts["later"] = "which this version does not know"

    rewrite(recording, older)
    assert replay(recording).other_versions == {"numpy": ("1.0", np.__version__)}
    assert command("replay", recording).code == 0
    rewrite(recording, lambda arrays, facts: facts.update(seed=1))
    result = command("replay", recording)
    assert result.code == 1
    assert result.err.endswith(f" V; numpy 1.0 is {np.__version__} here\n")
    assert result.err.count("\n") == 1


def without(*names: str) -> Change:
    """Return a change that removes arrays or facts."""

    def change(arrays: dict[str, Any], facts: dict[str, Any]) -> None:
        for name in names:
            (arrays if name in arrays else facts).pop(name)

    return change


def with_facts(**new: Any) -> Change:
    """Return a change that replaces facts."""
    return lambda arrays, facts: facts.update(new)


def with_arrays(**new: Any) -> Change:
    """Return a change that replaces arrays."""
    return lambda arrays, facts: arrays.update(new)


def with_broken_text(arrays: dict[str, Any], facts: dict[str, Any]) -> None:
    facts["sources"]["texture"]["text"] += "\n[new_in_a_later_version]\n"


UNFIT: dict[str, tuple[Change, str]] = {
    "newer form": (with_facts(format=2), "is a recording of form 2; this version of tactile reads"),
    "newer texture": (with_broken_text, "wood-oak.toml: new_in_a_later_version: unknown key"),
    "no form": (without("format"), "provenance: Object missing required field `format`"),
    "no seed": (without("seed"), "provenance: Object missing required field `seed`"),
    "text as seed": (with_facts(seed="a"), "Expected `int`, got `str` - at `$.seed`"),
    "no texts": (with_facts(sources=None), "its display or texture was not loaded from a file"),
    "negative gain": (with_facts(gain=-1.0), "cannot be replayed: gain"),
    "no rate": (with_facts(sample_rate_hz=0.0), "Expected `float` > 0"),
    "huge rate": (with_facts(sample_rate_hz=1e300), "sample_rate 1e+300 Hz"),
    "no drive": (without("drive_v"), "drive_v is missing"),
    "no path": (without("path_time_s"), "path_time_s is missing"),
    "flat drive": (with_arrays(drive_v=np.zeros(800)), "by their shapes"),
    "short times": (with_arrays(time_s=np.zeros(3)), "by their shapes"),
    "other contactors": (with_arrays(drive_v=np.zeros((800, 23))), "(800, 23)"),
    "single precision": (with_arrays(drive_v=np.zeros((800, 24), np.float32)), "drive_v is not"),
    "backward path": (with_arrays(path_time_s=np.array([1.0, 0.0])), "must ascend"),
    "no number": (with_arrays(drive_v=np.full((800, 24), np.nan)), "values that are not finite"),
    "longer than its path": (
        with_arrays(path_time_s=np.array([0.0, 0.05])), "the stroke has 400 samples"
    ),
    "empty": (
        with_arrays(
            drive_v=np.zeros((0, 24)), shear_target_m=np.zeros((0, 24)), time_s=np.zeros(0),
            position_mm=np.zeros((0, 2)),
        ),
        "holds no samples",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", UNFIT)
def test_a_recording_that_cannot_be_replayed_is_refused_in_one_line(
    command: Command, recording: Path, case: str
) -> None:
    change, said = UNFIT[case]
    rewrite(recording, change)
    assert_mistake(command("replay", recording), f"tactile: {recording}", said)


@pytest.mark.parametrize("name", ["a.h5", "a.npz"])
def test_a_missing_recording_is_not_found(command: Command, name: str) -> None:
    assert_mistake(command("replay", name), f"tactile: {name}: no such file\n")


def test_a_file_of_another_kind_is_refused_in_one_line(command: Command, whole: Path) -> None:
    for name in ("a.wav", "a"):
        assert_mistake(command("replay", name), "has this suffix; use .h5, .hdf5, .npz")
    other = Path("a.npz" if whole.suffix == ".h5" else "a.h5")
    shutil.copy(whole, other)
    assert_mistake(command("replay", other), f"tactile: {other}: is not a recording, or is damaged")
    for name in ("a.h5", "a.npz"):
        Path(name).write_text("hello", "utf-8")
        assert_mistake(command("replay", name), f"tactile: {name}: is not a recording")


def test_a_truncated_recording_is_refused_in_one_line(recording: Path) -> None:
    content = recording.read_bytes()
    for size in np.linspace(0, len(content) - 1, 40, dtype=int):
        recording.write_bytes(content[:size])
        with pytest.raises(InputError, match="is not a recording, or is damaged") as caught:
            replay(recording)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("at", ["descr", "<f8", "False", "shape", "}", "\\x93NUMPY", "NUMPY\\x02"])
@pytest.mark.parametrize("whole", [".npz"], indirect=True)
def test_an_array_with_a_damaged_header_is_refused_in_one_line(recording: Path, at: str) -> None:
    """Regression: numpy raised an error of the tokenizer."""
    content = recording.read_bytes()
    mark = at.encode().decode("unicode_escape").encode("latin-1")
    for new in (b"(", b"'", b"0", b"\xff", b"\x00"):
        recording.write_bytes(content.replace(mark, mark[:-1] + new))
        with pytest.raises(InputError, match="is not a recording, or is damaged") as caught:
            replay(recording)
        assert "\n" not in str(caught.value)


def test_an_archive_with_a_damaged_array_is_refused(recording: Path) -> None:
    """NPZ has a checksum of each array; in HDF5 the damage is a drive that differs."""
    content = bytearray(recording.read_bytes())
    drive = recorded(recording)["drive_v"][400:410].tobytes()
    content[content.index(drive) + 6] ^= 1
    recording.write_bytes(content)
    if recording.suffix == ".npz":
        with pytest.raises(InputError, match="Bad CRC-32"):
            replay(recording)
    else:
        assert replay(recording).first_sample == 400


@pytest.mark.parametrize("whole", [".npz"], indirect=True)
def test_an_array_that_is_shorter_than_it_says_is_refused_before_it_is_read(
    tmp_path: Path, whole: Path
) -> None:
    """Reading such rows would take 192 TB of memory."""
    target = tmp_path / "r.npz"
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 24)}
    with zipfile.ZipFile(whole) as archive, zipfile.ZipFile(target, "w") as changed:
        for name in archive.namelist():
            with changed.open(name, "w") as member:
                if name == "drive_v.npy":
                    np.lib.format.write_array_header_2_0(member, header)
                else:
                    member.write(archive.read(name))
    with pytest.raises(InputError, match="drive_v has 0 bytes, its shape is"):
        tactile.load_recording(target)


@pytest.mark.parametrize("whole", [".h5"], indirect=True)
def test_an_array_in_another_file_is_refused(tmp_path: Path, recording: Path) -> None:
    drive = recorded(recording)["drive_v"]
    for case in ("link", "external", "virtual"):
        target = tmp_path / f"{case}.h5"
        shutil.copy(recording, target)
        with h5py.File(target, "r+") as file:
            del file["drive_v"]
            if case == "link":
                file["drive_v"] = h5py.ExternalLink(str(recording), "drive_v")
            elif case == "external":
                (tmp_path / "raw").write_bytes(drive.tobytes())
                raw = [(str(tmp_path / "raw"), 0, drive.nbytes)]
                file.create_dataset("drive_v", drive.shape, "<f8", external=raw)
            else:
                layout = h5py.VirtualLayout(drive.shape, "<f8")
                layout[:] = h5py.VirtualSource(str(recording), "drive_v", drive.shape)
                file.create_virtual_dataset("drive_v", layout)
        with pytest.raises(InputError, match="drive_v is not an array of this file"):
            replay(target)


# Reading


def test_arrays_are_read_as_other_programs_read_them(whole: Path) -> None:
    recording, expected = tactile.load_recording(whole), recorded(whole)
    assert set(recording) == set(expected)
    for name, array in recording.items():
        assert array.shape == expected[name].shape == recording.shape(name)
        assert array.tobytes() == expected[name].tobytes()
    drive = expected["drive_v"]
    for size in (1, 7, 799, 800, 10_000):
        blocks = list(recording.blocks("drive_v", size))
        assert max(map(len, blocks)) <= size
        assert np.array_equal(np.concatenate(blocks), drive)
    assert (len(recording), recording.samples, recording.incomplete) == (len(expected), 800, "")
    with pytest.raises(KeyError):
        recording["drive"]
    assert recording.units == {
        "drive_v": "V", "shear_target_m": "m", "time_s": "s", "position_mm": "mm",
        "sample_rate_hz": "Hz", "contactors_mm": "mm", "path_time_s": "s", "path_position_m": "m",
        "path_normal_force_n": "N",
    }  # fmt: skip
    if whole.suffix == ".h5":
        with h5py.File(whole) as file:
            assert {name: file[name].attrs["unit"] for name in recording} == recording.units
    facts = provenance_of(whole)
    for name in ("texture", "display", "device", "gain", "seed", "limits", "versions", "counters"):
        assert getattr(recording.provenance, name) == facts[name]
    assert recording.provenance.outcome.planned_samples == 800


def test_a_recording_of_another_program_may_be_compressed(recording: Path) -> None:
    """Files that other programs have packed again are read as well."""
    arrays: dict[str, Floats] = recorded(recording)
    text = json.dumps(provenance_of(recording))
    if recording.suffix == ".npz":
        np.savez_compressed(recording, allow_pickle=False, provenance=text, **arrays)
    else:
        with h5py.File(recording, "w") as file:
            file["provenance"] = text
            for name, array in arrays.items():
                packed = {"compression": "gzip"} if array.ndim else {}
                file.create_dataset(name, data=array, **packed)
    assert replay(recording).is_identical


@KINDS
def test_a_long_recording_takes_no_memory(
    display: Display, oak: Texture, tmp_path: Path, kind: str
) -> None:
    """A recording of 12 MB is read in less than 2 MB: a block of 1024 rows takes 0.2 MB."""
    target = tmp_path / f"r{kind}"
    run(display, oak, stroke(4.0), device="mock:", record=target)
    list(tactile.load_recording(target).blocks("time_s", 1024))  # loads what is loaded lazily
    tracemalloc.start()
    try:
        total = sum(len(block) for block in tactile.load_recording(target).blocks("drive_v", 1024))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert total == 32_000
    assert peak < 2e6
