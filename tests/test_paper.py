"""The paper in one command: its claims beside ours, its figures, and what the folder holds."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_report import check_alone

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import blocked_force, tip_response
from tactile.cli import paper_command
from tactile.cli.app import app
from tactile.errors import InputError
from tactile.study.paper import FIGURES, KINDS, Claim, PaperFigure, claims, summarize
from tactile.study.report import paper_folder, write_paper
from tactile.study.storing import load_study
from tactile.study.sweep import solve_study


@pytest.fixture(scope="module")
def found() -> dict[str, Claim]:
    return {claim.statement: claim for claim in claims()}


def test_every_claim_is_met(found: dict[str, Claim]) -> None:
    assert [words for words, claim in found.items() if not claim.is_met] == []
    assert {claim.kind for claim in found.values()} == set(KINDS)


def test_claims_are_counted_by_kind_and_never_added_up(found: dict[str, Claim]) -> None:
    """The paper states two ranges and where they meet: each is fitted, or predicts the other."""
    text = summarize(list(found.values()))
    assert text.startswith(
        "10 claims are stated by the paper: 5 fitted (5 met), 5 checked (5 met). "
        "19 are records of this program's own results, of which 19 are unchanged"
    )
    assert "29" not in text


@pytest.mark.parametrize(
    ("kind", "counts"),
    [("fitted", [2, 1, 0, 1, 1, 1, 1]), ("checked", [2, 1, 1, 1, 0, 1, 1]),
     ("record", [2, 1, 1, 1, 1, 1, 0])],
)  # fmt: skip
def test_a_claim_that_is_not_met_counts_against_its_own_kind(kind: str, counts: list[int]) -> None:
    met = [Claim("a", "mm", 1.0, 1.0, 0.1, name) for name in KINDS]
    rows = [replace(row, result=1.2) if row.kind == kind else row for row in met]
    assert [int(number) for number in re.findall(r"\d+", summarize(rows))] == counts


def test_a_claim_that_the_design_was_fitted_to_is_no_check(found: dict[str, Claim]) -> None:
    """Only a prediction from the other finger, or a trend over all shims, checks the model."""
    for words, claim in found.items():
        if claim.kind == "checked":
            assert "finger alone" in words or "shims of" in words
        is_own = KINDS[claim.kind].source == "this program"
        assert is_own == (claim.kind == "record")


def test_either_finger_predicts_the_other(found: dict[str, Claim]) -> None:
    """The shim chosen from one finger's range alone meets the other's ends to 1 mm."""
    rows = {words: row for words, row in found.items() if "finger alone" in words}
    assert len(rows) == 4
    for claim in rows.values():
        assert claim.kind == "checked"
        assert claim.result == pytest.approx(claim.stated, abs=1.0)


def test_the_wrong_sign_is_that_of_two_springs_at_rest(
    found: dict[str, Claim],
) -> None:
    """The tip's spring k and the finger's S give (k + S)/(k − S) at rest; motion adds 0.1 dB."""
    k, S = blocked_force(Bimorph(), 0)[1][0].real, 1000.0
    value = found["most that the printed sign of the load is wrong by"].result
    assert 0 <= value - 20 * np.log10((k + S) / (k - S)) < 0.1


@pytest.mark.parametrize("entry", FIGURES[:4], ids=[f.name for f in FIGURES[:4]])
def test_the_data_of_a_figure_is_the_model_s(entry: PaperFigure) -> None:
    data = solve_study(entry.study())
    finger = {"none": FingerLoad.none, "low": FingerLoad.low, "high": FingerLoad.high}
    tip = tip_response(Bimorph(), finger[str(data["load"].item())](), data["frequency_hz"].values)
    name, scale = {
        "velocity_mm_per_s_v": ("velocity", 1e3), "admittance_us": ("admittance", 1e6),
        "displacement_um_per_v": ("displacement", 1e6),
    }[entry.variable]  # fmt: skip
    assert np.allclose(data[entry.variable].values[0], getattr(tip, name) * scale, rtol=1e-12)


def test_each_claim_is_printed_beside_its_own_numbers(
    found: dict[str, Claim], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All claims are in one of three tables with the same columns."""
    monkeypatch.setenv("COLUMNS", "200")
    paper_command._print(list(found.values()), Path("out"))
    cells = [re.split(r"\s{2,}", line.strip()) for line in capsys.readouterr().out.splitlines()]
    printed = {row[0]: row[1:3] for row in cells if len(row) == 6}
    for words, claim in found.items():
        assert printed[words] == [f"{claim.stated:.4g}", f"{claim.result:.4g}"]


def test_numbers_are_written_as_they_are_drawn() -> None:
    entry = FIGURES[2]
    data = solve_study(entry.study())
    rows = list(csv.reader(paper_folder._table_of(entry, data).decode().splitlines()))
    assert rows[0] == ["frequency_hz", "displacement_um_per_v", "phase_deg"]
    numbers = np.array(rows[1:], np.float64)
    size, phase = paper_folder.figure_of(entry, data).axes
    for axes, column in ((size, 1), (phase, 2)):
        assert np.allclose(np.array(axes.lines[0].get_xydata()), numbers[:, [0, column]], rtol=1e-8)


@pytest.mark.parametrize("inside", ["", "deeper"])
def test_a_folder_that_cannot_be_is_a_line(tmp_path: Path, inside: str) -> None:
    (tmp_path / "taken").touch()
    with pytest.raises(InputError, match="taken"):
        write_paper(tmp_path / "taken" / inside)


@pytest.mark.ci
def test_one_command_writes_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app(["paper", str(tmp_path / "out"), "--json"], standalone_mode=False)
    told = json.loads(capsys.readouterr().out)
    assert all(claim["is_met"] for claim in told["claims"])
    assert "5 fitted (5 met), 5 checked (5 met)" in told["summary"]
    names = {Path(file).name for file in told["files"]}
    made = {f"{f.name}{s}" for f in FIGURES for s in (".png", ".svg", ".csv", ".nc")}
    assert names == made | {"report.html", "claims.csv"}
    walk = check_alone((tmp_path / "out" / "report.html").read_text("utf-8"))
    assert len(walk.sources) == len(FIGURES)
    for claim in told["claims"]:
        assert claim["statement"] in walk.words
    assert "surrogate" in walk.words
    assert told["summary"] in walk.words
    data, again = load_study(tmp_path / "out" / "length-low.nc"), solve_study(FIGURES[-2].study())
    assert data["smallest_displacement_um_per_v"].attrs["units"] == "µm/V"
    assert np.array_equal(data["displacement_um_per_v"], again["displacement_um_per_v"])
