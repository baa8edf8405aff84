"""The command ``optimize``: designs and a recommendation, files, and mistakes in one line."""

import json
from functools import partial
from pathlib import Path

import pytest
from cli_rig import Command, assert_mistake


@pytest.fixture
def optimize(command: Command) -> Command:
    """Return what runs this command."""
    return partial(command, "optimize")


QUICK = ["length_mm=8:40", "--objective", "attainable"]
FRONT = [*QUICK, "width_mm=1:6", "--objective", "footprint"]


def test_the_best_of_one_objective_is_told_in_words(optimize: Command) -> None:
    code, out, err = optimize(*QUICK)
    assert (code, err.strip()) == (0, "")
    assert "attainable_um" in out
    assert "recommended" in out
    assert "Nothing else within the bounds is better in anything that was asked for." in out


@pytest.mark.ci
def test_a_displays_finger_and_limits_are_the_start(optimize: Command) -> None:
    """The reference display's finger is the low one and its limit 100 V: as without a display."""
    alone, with_display = (
        json.loads(optimize(*QUICK, *more, "--json")[1])["designs"]["attainable_um"]
        for more in ((), ("--display", "reference-24"))
    )
    assert with_display == pytest.approx(alone)
    halved = optimize(*QUICK, "--display", "reference-24", "--voltage-v", "50", "--json")[1]
    assert json.loads(halved)["designs"]["attainable_um"][0] == pytest.approx(alone[0] / 2)


@pytest.mark.ci
def test_fingers_limits_and_json(optimize: Command) -> None:
    code, out, _ = optimize(
        *QUICK, "--robust", "0.8", "--scenarios", "4", "--limit", "standing=25",
        "--limit", "first_resonance=300:", "--fix", "width_mm=3", "--json",
    )  # fmt: skip
    assert code == 0
    told = json.loads(out)
    assert told["attributes"]["share"] == 0.8
    assert 0 <= told["attributes"]["unseen_loss"] < 1
    assert told["attributes"]["objectives"] == "robust_attainable_um"
    assert json.loads(told["attributes"]["fixed"]) == {"width_mm": 3.0}
    assert told["designs"]["robust_standing_mm"][told["place"]] <= 25
    assert told["designs"]["first_resonance_hz"][0] >= 300


@pytest.mark.ci
def test_a_front_is_printed_stored_and_drawn(optimize: Command, tmp_path: Path) -> None:
    import xarray

    code, out, _ = optimize(*FRONT, "--out", "front.nc", "--plot", "front.png")
    assert code == 0
    rows = [line for line in out.splitlines() if line.split()[:1] and line.lstrip()[0].isdigit()]
    assert 10 <= len(rows) <= 12
    assert "Against the best in attainable" in out
    assert "written: front.nc" in out
    with xarray.open_dataset(tmp_path / "front.nc", engine="h5netcdf") as front:
        assert front["attainable_um"].attrs["units"] == "µm"
        assert front.attrs["objectives"] == "attainable_um footprint_mm2"
    assert (tmp_path / "front.png").read_bytes().startswith(b"\x89PNG")


def test_a_store_that_is_there_is_refused_and_left(optimize: Command, tmp_path: Path) -> None:
    study = tmp_path / "study.zarr" / "zarr.json"
    study.parent.mkdir()
    study.write_text("{}")
    refused = optimize(*QUICK, "--out", "study.zarr")
    assert_mistake(refused, "study.zarr: already exists; remove it, or choose another name")
    assert study.read_text() == "{}"


BAD = {
    "length_mm = 20: must be low:high, or a fixed value: --fix length_mm=20": ["length_mm=20"],
    "length_mm = 40:8: bounds must be finite and ascend": ["length_mm=40:8"],
    "'length_mm': must be name=value, for example length_mm=8:40": ["length_mm"],
    "length_mm: is given twice": [*QUICK, "length_mm=8:9"],
    "length_mm = 'a': must be a finite number": ["length_mm=a:9"],
    "--limit drives=3: no such criterion; did you mean 'drive'": [*QUICK, "--limit", "drives=3"],
    "--limit first_resonance=300: use first_resonance=300: for at least 300": [
        *QUICK, "--limit", "first_resonance=300",
    ],
    "--scenarios can only be used with --robust": [*QUICK, "--scenarios", "8"],
    "load = 'low': the scenarios draw the finger": [*QUICK, "--robust", "0.9", "--load", "low"],
    "load: is given by --load and by --fix": [*QUICK, "--fix", "load=low", "--load", "low"],
    "--plot: needs two or three objectives": [*QUICK, "--plot", "front.png"],
    "band = 1000:10 Hz: must ascend": [*QUICK, "--band-hz", "1000:10"],
}  # fmt: skip


@pytest.mark.parametrize("line", BAD)
def test_a_mistake_is_one_line(optimize: Command, line: str) -> None:
    words = BAD[line]
    assert_mistake(optimize(*words, *([] if "--objective" in words else QUICK[1:])), line)
