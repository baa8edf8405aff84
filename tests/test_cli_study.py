"""The command ``study``: the paper's answer by default, tables, JSON, and mistakes in one line."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cli_rig import Command, assert_mistake

from tactile.study.storing import load_study
from tactile.study.study_request import parse_values


@pytest.fixture
def study(command: Command) -> Command:
    """Return what runs this command."""
    return partial(command, "study")


def test_by_default_it_is_the_papers_question_and_answer(study: Command) -> None:
    """Ranges are those of the paper with the documented surrogate: 17.7–27.7 and 9.4–20.1 mm."""
    code, out, _ = study("length_mm=8:30:0.5", "load=low,high")
    assert code == 0
    for words in ("90 designs", "17.7 … 27.7", "9.45 … 20.1", "17.7 … 20.1", "smallest_displ"):
        assert words in out


def test_figures_for_machines_are_those_of_the_data_set(study: Command) -> None:
    code, out, _ = study(
        "length_mm=12:24:4", "width_mm=2,3", "load=low,high", "--criterion", "mean_force",
        "--criterion", "footprint", "--frequency-hz", "0:1000:50", "--band-hz", "100:900",
        "--fix", "shim_height_mm=0.25", "--keep", "velocity", "--within", "0.9",
        "--out", "s.nc", "--json",
    )  # fmt: skip
    assert code == 0
    told, data = json.loads(out), load_study("s.nc")
    assert told["designs"] == 16
    assert told["stored"] == "s.nc"
    assert data["velocity_mm_per_s_v"].dtype == np.complex128
    low = next(b for b in told["best"] if b["finger"] == "low" and b["criterion"] == "mean_force")
    assert low["value"] == float(data["mean_force_mn_per_v"].sel(load="low").max())
    assert low["value"] == float(data["mean_force_mn_per_v"].sel(low["at"]))
    worst = next(b for b in told["best"] if b["finger"] == "all")
    share = np.array(
        [v / v.max() for v in data["mean_force_mn_per_v"].transpose("load", ...).values]
    )
    assert worst["value"] == pytest.approx(100 * share.min(axis=0).max())
    least = next(b for b in told["best"] if b["criterion"] == "footprint")
    assert least["value"] == pytest.approx(2 * 0.77)
    force = [r for r in told["ranges"] if r["criterion"] == "mean_force"]
    assert [r["at"] for r in force] == [
        {"width_mm": w, "load": f} for w in (2.0, 3.0) for f in ("low", "high")
    ]
    assert told["figures"]["footprint_mm2"]["unit"] == "mm²"


def test_curves_are_kept_beside_the_default_criterion(study: Command) -> None:
    code, _, _ = study("length_mm=18,20", "--scenarios", 4, "--keep", "displacement",
                         "--out", "s.zarr")  # fmt: skip
    assert code == 0
    data = load_study("s.zarr")
    curves = abs(data["displacement_um_per_v"]).min("frequency_hz")
    assert np.allclose(curves, data["smallest_displacement_um_per_v"])


def test_what_is_neither_good_nor_bad_is_told_from_where_to_where(study: Command) -> None:
    """A slender cantilever's resonance goes with 1/l²: 930.3 Hz at 20 mm (finite elements)."""
    code, out, _ = study("length_mm=20,40", "--criterion", "first_resonance", "--json")
    assert code == 0
    (span,) = json.loads(out)["spans"]
    assert (span["low"], span["high"]) == pytest.approx((930.3 / 4, 930.3), rel=5e-3)
    code, out, _ = study("length_mm=20,40", "--criterion", "first_resonance")
    assert code == 0
    assert "930.3" in out


def test_a_picture_and_a_report_come_with_it(study: Command) -> None:
    code, out, _ = study("length_mm=12:24:4", "load=low,high", "--plot", "s.svg", "--report",
                           "s.html")  # fmt: skip
    assert code == 0
    assert "written: s.html" in out
    assert Path("s.svg").read_text().count("<svg") == 1
    assert "free length" in Path("s.html").read_text()


def test_scenarios_count_by_what_all_but_the_worst_reach(study: Command) -> None:
    code, out, _ = study("length_mm=16,20", "--scenarios", 16, "--seed", 3, "--out", "s.zarr",
                           "--frequency-hz", "0:1000:100", "--band-hz", "0:1000", "--json",
                           "--criterion", "smallest_displacement")  # fmt: skip
    assert code == 0
    told, data = json.loads(out), load_study("s.zarr")
    values = data["smallest_displacement_um_per_v"].values
    assert values.shape == (2, 16)
    assert told["best"][0]["value"] == pytest.approx(values.min(axis=1).max())
    assert told["scenarios"] == 16


def test_a_displays_bender_finger_and_limits_are_the_start(study: Command) -> None:
    arguments = ("--display", "reference-24", "--criterion", "attainable", "--band-hz", "10:1000")
    code, out, _ = study("length_mm=20", *arguments, "--json")
    assert code == 0
    half = study("length_mm=20", *arguments, "--voltage-v", 10, "--json")[1]
    with_limit, with_ten = (json.loads(o)["best"][0]["value"] for o in (out, half))
    assert with_limit > with_ten > 0


def test_a_displays_own_finger_is_kept_where_parts_are_drawn(study: Command) -> None:
    code, out, _ = study("length_mm=18,20", "--display", "reference-24", "--scenarios", 8,
                           "--json")  # fmt: skip
    assert code == 0
    assert json.loads(out)["axes"]["load"] == ["display"]


def test_ranges_have_their_stop_and_no_noise() -> None:
    assert parse_values("x", "8:9:0.1", is_named=False).tolist() == [
        8.0, 8.1, 8.2, 8.3, 8.4, 8.5, 8.6, 8.7, 8.8, 8.9, 9.0,
    ]  # fmt: skip
    assert parse_values("x", "1:2:0.4", is_named=False).tolist() == [1.0, 1.4, 1.8]
    assert parse_values("x", "3:3:1", is_named=False).tolist() == [3.0]
    assert parse_values("load", "low, high", is_named=True).tolist() == ["low", "high"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["length_mm=8:5:1"], "length_mm = 8:5:1: is empty, as 5 is below 8"),
        (["length_mm=8:9:0"], "step 0: must be above 0"),
        (["length_mm=8:9:-1"], "step -1: must be above 0"),
        (["length_mm=8:9"], "a range reads as start:stop:step"),
        (["length_mm="], "length_mm: the axis is empty"),
        (["length_mm=8,x"], "length_mm = 'x': must be a finite number"),
        (["length_mm=8,8.0,8"], "has a value twice"),
        (["length_mm"], "'length_mm': must be name=value, for example length_mm=8:30:0.5"),
        (["length_mm=8", "length_mm=9"], "length_mm: is given twice"),
        (["length_mm=8", "--fix", "length_mm=9"], "length_mm: given twice"),
        (["length_mm=8", "--fix", "width_mm=2,3"], "width_mm: a fixed parameter has one value"),
        (["length_mm=0:8:1"], "length_mm = 0: must be 0.5 … 200 mm"),
        (["lenght_mm=8"], "no parameter 'lenght_mm'; did you mean 'length_mm'?"),
        (["load=lo"], "load = 'lo': no such name; did you mean 'low'?"),
        (["load=low", "--criterion", "mean_forc"], "no criterion 'mean_forc'; did you mean"),
        (["load=low", "--keep", "forc"], "no response 'forc'; did you mean 'force'?"),
        (["load=low", "--criterion", "mean_force"], "mean_force: needs a band"),
        (["load=low", "--band-hz", "10"], "band = 10: must be low:high, in Hz, for"),
        (["load=low", "--band-hz", "100:10"], "band = 100:10 Hz: must ascend"),
        (["load=low", "--band-hz", "10:20", "--frequency-hz", "5,15", "--criterion", "mean_force"],
         "mean_force: fewer than two frequencies in the band 10:20 Hz"),
        (["load=low", "--within", "1.5"], "share = 1.5: must be above 0 and below 1"),
        (["load=low", "--out", "s.txt"], "s.txt: must end in .nc or .zarr"),
        (["load=low", "--out", "no/s.nc"], "no/s.nc: cannot be written: No such file"),
        (["length_mm=5", "--fix", "measuring_point_mm=9"], "lies beyond the tip of a bender"),
        (["length_mm=8:30:1e-4", "width_mm=1:40:0.01"], "store it as it goes (--out study.zarr)"),
        (["length_mm=1:100:1e-9"], "has 9.9e+10 values, more than 1e+08"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(study: Command, arguments: list[str], words: str) -> None:
    assert_mistake(study(*arguments), words)
