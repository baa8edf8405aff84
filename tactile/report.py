"""Reports of design studies: one HTML file that needs nothing else, to read, print and send.

A report is a list of `Section`; pictures are in the file as SVG, style sheets as text. `study_report`
and `front_report` make the sections of a study and of a Pareto front, `write_report` the file.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Picture:
    """A drawing: SVG or PNG, what it shows in words, and the caption below."""

    image: bytes
    alternative: str
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of words under headings; the first column names the row."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a report: its title, and paragraphs (str), pictures and tables in order."""

    title: str
    content: tuple["str | Picture | Table", ...]


def write_report(
    path: str | Path, title: str, sections: Sequence[Section], *, subtitle: str = ""
) -> None:
    """Write a report to one HTML file.

    Raises
    ------
    InputError
        Where it cannot be written.
    """
    raise NotImplementedError


def study_report(data: "xarray.Dataset") -> list[Section]:
    """Return the sections of a study, as `tactile.study.sweep.solve_study` makes it."""
    raise NotImplementedError


def front_report(front: "xarray.Dataset") -> list[Section]:
    """Return the sections of a Pareto front."""
    raise NotImplementedError
