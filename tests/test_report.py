"""Reports: whole HTML that needs nothing else, with every picture and number in it."""

import base64
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import xarray

from tactile.errors import InputError
from tactile.study.criteria import Conditions
from tactile.study.report import (
    Picture,
    Section,
    Table,
    front_report,
    study_report,
    write_report,
)
from tactile.study.report.page import html_of
from tactile.study.report.studies import chosen_design
from tactile.study.scenarios import draw_scenarios
from tactile.study.sweep import Study, solve_study

VOID = {"meta", "img", "br", "hr", "link", "input"}
LENGTH = np.arange(6.0, 39.0, 4.0)
FREQUENCY = np.arange(0.0, 1001.0, 100.0)


class Walk(HTMLParser):
    """Parser that checks that elements nest, and keeps references and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.links: list[str] = []
        self.names: set[str] = set()
        self.alternatives: list[str] = []
        self.rows: list[list[str]] = []
        self.words = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        told = dict(attrs)
        self.sources += [v for k in ("src", "srcset", "data", "action") if (v := told.get(k))]
        self.links += [v] if (v := told.get("href")) else []
        self.names |= {v} if (v := told.get("id")) else set()
        self.alternatives += [str(told.get("alt"))] if tag == "img" else []
        assert tag not in ("script", "link", "iframe", "object")
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" in self.open:
            assert "url(" not in data
            assert "@import" not in data
            return
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data
        self.words += data


def check_alone(text: str) -> Walk:
    """Return the walk of a page, after checking that it needs nothing else."""
    walk = Walk(text)
    assert {link.removeprefix("#") for link in walk.links} <= walk.names
    for source in walk.sources:
        head, data = source.split(",", 1)
        image = base64.b64decode(data, validate=True)
        if head == "data:image/png;base64":
            assert image.startswith(b"\x89PNG")
        else:
            assert head == "data:image/svg+xml;base64"
            root = ElementTree.fromstring(image)
            assert root.tag.endswith("svg")
            refs = [v for e in root.iter() for k, v in e.attrib.items() if k.endswith("href")]
            assert all(ref.startswith(("#", "data:")) for ref in refs)
    assert all(walk.alternatives)
    return walk


def test_words_are_kept_whatever_they_are() -> None:
    nasty = '<script>alert("1 & 2")</script>'
    picture = Picture(b"\x89PNG\r\n\x1a\n", nasty, nasty)
    table = Table((nasty, "n"), ((nasty, "1.5"), ("b", "2 … 3")), nasty)
    walk = check_alone(html_of(nasty, [Section(nasty, (nasty, picture, table))], subtitle=nasty))
    assert walk.words.count(nasty) == 10  # both titles twice, and once each of the six others
    assert walk.alternatives == [nasty]


def test_numbers_stand_right_and_words_left() -> None:
    table = Table(("a", "n", "w"), (("x", "1.5 mm", "low"), ("y", "−2 … 3", "high")))
    text = html_of("t", [Section("s", (table,))])
    assert '<td class="number">1.5 mm</td><td>low</td>' in text


def test_a_report_prints_and_knows_the_dark() -> None:
    text = html_of("t", [])
    assert "@media print" in text
    assert "prefers-color-scheme: dark" in text


@pytest.mark.ci
def test_a_study_is_told_in_full() -> None:
    study = Study(
        axes={"load": ["low", "high"], "length_mm": LENGTH, "width_mm": [1.0, 2.0]},
        frequency=FREQUENCY, criteria=("smallest_displacement",), responses=("displacement",),
        conditions=Conditions(band=(0, 1000)),
    )  # fmt: skip
    data = solve_study(study)
    walk = check_alone(html_of("t", study_report(data)))
    best = data["smallest_displacement_um_per_v"]
    for finger in ("low", "high"):
        told = [f"{finger} finger", f"{float(best.sel(load=finger).max()):.4g} µm/V"]
        assert any(row[1:3] == told for row in walk.rows)
    assert "shared by all" not in walk.words  # each finger's best has a width of its own
    assert "at width 2 mm" in walk.words
    assert ["base: piezo d31", "-320", "pm/V"] in walk.rows
    assert ["conditions: field", "400", "V/mm"] in walk.rows
    assert ["base: series", "false", ""] in walk.rows
    assert data.attrs["created"] in walk.words
    assert "Not drawn" not in walk.words
    assert len(walk.sources) == 4


def test_fingers_share_a_range_where_there_is_no_other_axis() -> None:
    """The paper's: 17.7 to 20.1 mm."""
    study = Study(
        axes={"load": ["low", "high"], "length_mm": np.arange(8, 30, 0.5)},
        frequency=np.arange(0, 1001, 50.0), criteria=("smallest_displacement",),
        conditions=Conditions(band=(0, 1000)),
    )  # fmt: skip
    walk = check_alone(html_of("t", study_report(solve_study(study))))
    (told,) = [row[1] for row in walk.rows if row[0] == "shared by all"]
    low, _, high, unit = told.split()
    assert (float(low), float(high)) == pytest.approx((17.7, 20.1), abs=0.11)
    assert unit == "mm"


def test_with_scenarios_a_design_is_judged_by_what_nineteen_of_twenty_attain() -> None:
    study = Study(
        axes={"length_mm": LENGTH}, frequency=FREQUENCY, criteria=("smallest_displacement",),
        conditions=Conditions(band=(0, 1000)), scenarios=draw_scenarios(32),
    )  # fmt: skip
    data = solve_study(study)
    values = np.sort(data["smallest_displacement_um_per_v"].values, axis=1)
    attained = np.array([np.interp(0.05 * 33, np.arange(1, 33), row) for row in values])
    walk = check_alone(html_of("t", study_report(data)))
    assert f"{attained.max():.4g} µm/V" in walk.words
    assert chosen_design(data) == {"length_mm": int(attained.argmax())}
    assert "Tolerance of the smallest displacement" in walk.words


def test_a_front_is_told_design_by_design() -> None:
    front = xarray.Dataset(
        {
            "footprint_mm2": ("design", [1.0, 2.0], {"units": "mm²", "long_name": "footprint"}),
            "drive_v": ("design", [30.0, 20.0], {"units": "V", "long_name": "drive"}),
        },
        {"length_mm": ("design", [11.0, 17.0], {"units": "mm", "long_name": "free length"})},
        {"objectives": "footprint_mm2 drive_v", "seed": 3, "bounds": '{"length_mm": [8, 30]}'},
    )
    walk = check_alone(html_of("t", front_report(front, recommended=1)))
    assert ["1", "11", "1", "30"] in walk.rows
    assert ["2 (recommended)", "17", "2", "20"] in walk.rows
    assert len(walk.sources) == 1
    with pytest.raises(InputError, match="names no objectives"):
        front_report(front.drop_attrs())


@pytest.mark.parametrize(
    ("name", "said"), [("a.txt", "ends in .html"), ("no/a.html", "No such file")]
)
def test_a_report_that_cannot_be_is_refused(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        write_report(tmp_path / name, "t", [])


def test_a_report_that_cannot_be_written_is_a_line(tmp_path: Path) -> None:
    (tmp_path / "a.html").mkdir()
    with pytest.raises(InputError, match="Is a directory"):
        write_report(tmp_path / "a.html", "t", [])
