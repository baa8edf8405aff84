"""Folder with all that the paper shows and claims: images, data, a table, and one report."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile.errors import InputError
from tactile.show.plots import drawn, save
from tactile.show.plots.style import new_figure
from tactile.study.extras import study_extra
from tactile.study.findings import FREQUENCY
from tactile.study.paper import (
    FIGURES,
    KINDS,
    REFERENCE,
    SMALLEST,
    Claim,
    PaperFigure,
    claims,
    summarize,
)
from tactile.study.plots import length_map_figure, response_phase_figure
from tactile.study.report.page import Picture, Section, Table, write_report
from tactile.study.report.studies import provenance_sections
from tactile.study.storing import save as save_study
from tactile.study.sweep import solve_study

if TYPE_CHECKING:
    import xarray

TITLE = "A piezoelectric bender for a tactile display: the paper, and what we find"
"""Title of the report."""
SURROGATE = (
    "The paper's figure of parameters is not available as text. The design here is a surrogate "
    "from data sheets and assumptions, and the height of its shim was chosen to meet the paper's "
    "ranges of length. Of the paper's text only title, abstract and introduction were at hand; its "
    "numbers are quoted from the notes that this project began with. Where there are none, shapes "
    "can be compared, levels cannot."
)
"""Paragraph on the origin of the design."""
MET = {True: "yes", False: "no"}
"""Words in the column that says whether a claim is met."""


def write_paper(
    folder: str | Path, progress: Callable[[str], None] = lambda name: None
) -> list[Claim]:
    """Write every figure, its data, the claims and one report that holds all of them.

    Parameters
    ----------
    folder : str or Path
        Folder, created if it is missing; files of the same names are replaced.
    progress : callable
        Called with the name of each part before it is made.

    Returns
    -------
    list of Claim
        Claims as in ``claims.csv``.

    Raises
    ------
    InputError
        If the folder cannot be written, or matplotlib or xarray is missing.
    """
    folder = Path(folder)
    _prepare(folder)
    sections = []
    for entry in FIGURES:
        progress(entry.name)
        data = solve_study(entry.study())
        sections.append(_write_figure(folder, entry, data))
    progress("claims")
    results = claims()
    _write(folder / "claims.csv", _claims_csv(results))
    write_report(
        folder / "report.html",
        TITLE,
        [*_claim_sections(results), *sections, *provenance_sections(data)],
        subtitle=REFERENCE,
    )
    return results


def _prepare(folder: Path) -> None:
    """Check the libraries, create the folder, and check that it can be written."""
    with study_extra("a study"):
        import xarray  # noqa: F401
    new_figure(1.0, 1.0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "report.html").touch()
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error


def _write_figure(folder: Path, entry: PaperFigure, data: "xarray.Dataset") -> Section:
    """Write a figure and its data; return its section of the report."""
    figure = figure_of(entry, data)
    save(figure, folder / f"{entry.name}.png")
    image = drawn(figure)
    _write(folder / f"{entry.name}.svg", image)
    _write(folder / f"{entry.name}.csv", _table_of(entry, data))
    save_study(data, folder / f"{entry.name}.nc")
    picture = Picture(image, entry.title, entry.caption)
    files = f"Files: {entry.name}.png, .svg, .csv and .nc."
    return Section(entry.title, (picture, files))


def figure_of(entry: PaperFigure, data: "xarray.Dataset") -> Any:
    """Draw a figure of the paper from its data.

    Parameters
    ----------
    entry : PaperFigure
        Description of the figure.
    data : xarray.Dataset
        Data set of its study.

    Returns
    -------
    matplotlib.figure.Figure
        Figure.
    """
    if entry.is_map:
        return length_map_figure(data, entry.variable)
    return response_phase_figure(data, entry.variable)


def _table_of(entry: PaperFigure, data: "xarray.Dataset") -> bytes:
    """Return a figure's lines as CSV: magnitude and phase, or the smallest along the length."""
    if entry.is_map:
        columns = {"length_mm": data["length_mm"].values, SMALLEST: data[SMALLEST].values[0]}
    else:
        values = data[entry.variable].values[0]
        columns = {
            FREQUENCY: data[FREQUENCY].values,
            entry.variable: np.abs(values),
            "phase_deg": np.degrees(np.unwrap(np.angle(values))),
        }
    rows = zip(*([f"{x:.9g}" for x in column] for column in columns.values()), strict=True)
    return _csv([list(columns), *map(list, rows)])


HEADINGS = ("claim", "unit", "stated", "result", "difference", "within", "met", "source", "kind")
"""Headings of the table of claims."""


def _row(claim: Claim) -> tuple[str, ...]:
    """Return a claim as a row of the table of claims."""
    numbers = (claim.stated, claim.result, claim.difference, claim.limit)
    stated, result, difference, limit = (f"{number:.4g}" for number in numbers)
    return (
        claim.statement, claim.unit, stated, result, difference, limit, MET[claim.is_met],
        KINDS[claim.kind].source, claim.kind,
    )  # fmt: skip


def _claims_csv(results: list[Claim]) -> bytes:
    """Return all claims as CSV."""
    return _csv([list(HEADINGS), *(list(_row(claim)) for claim in results)])


def _claim_sections(results: list[Claim]) -> list[Section]:
    """Return the claims by kind, each kind with its meaning."""
    sections = [Section("What this is", (SURROGATE, summarize(results)))]
    headings = ("claim", "stated", "result", "difference", "within", "unit", "met")
    for name, kind in KINDS.items():
        rows = []
        for claim in results:
            if claim.kind == name:
                words, unit, *numbers, is_met, _, _ = _row(claim)
                rows.append((words, *numbers, unit, is_met))
        sections.append(Section(kind.title, (kind.meaning, Table(headings, tuple(rows)))))
    return sections


def _csv(rows: list[list[str]]) -> bytes:
    """Return rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _write(path: Path, content: bytes) -> None:
    """Write a file, or raise InputError."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
