"""Self-contained HTML page: images as data, its style sheet as text, and no scripts.

The page follows the reader's choice of light or dark, but images keep their white background so
that colors mean the same. It prints on white paper without breaking an image or a row.
"""

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template

from tactile.errors import InputError

PNG = b"\x89PNG"
"""First bytes of a PNG file."""
NUMBER = re.compile(r"[<>≤≥≈±+−\-\d.,… e]*\d[\d.,… e×µm/VNHzFSdB°%²³]*|–|")
"""Pattern of cells that are aligned to the right: numbers, ranges, and nothing."""

PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { color-scheme: light dark; --ink: #1b1b1b; --dim: #5a5a5a; --ground: #ffffff;
  --line: #d4d4d4; --band: #f4f5f7; --link: #00538a; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --dim: #a6a6a6; --ground: #15171a;
  --line: #3a3d42; --band: #1e2125; --link: #7cc0f0; } }
body { margin: 0 auto; max-width: 52rem; padding: 2rem 1.2rem 4rem; color: var(--ink);
  background: var(--ground); font: 1rem/1.55 system-ui, "Segoe UI", "Noto Sans", sans-serif; }
h1 { font-size: 1.8rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-top: .6rem;
  border-top: 1px solid var(--line); }
.subtitle, figcaption, caption { color: var(--dim); }
nav ol { padding-left: 1.2rem; } a { color: var(--link); }
figure { margin: 1.4rem 0; break-inside: avoid; }
figure img { display: block; width: 100%; height: auto; background: #ffffff;
  border: 1px solid var(--line); border-radius: 4px; }
figcaption, caption { font-size: .9rem; text-align: left; padding: .4rem 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; margin: .8rem 0; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid var(--line); text-align: left;
  vertical-align: top; }
thead th { border-bottom: 2px solid var(--line); } tbody tr:nth-child(even) {
  background: var(--band); }
tbody th { font-weight: 600; overflow-wrap: anywhere; } td { overflow-wrap: break-word; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
@media print { :root { --ink: #000; --dim: #333; --ground: #fff; --line: #999; --band: #fff;
  --link: #000; } body { max-width: none; padding: 0; font-size: 10pt; } nav { display: none; }
  tr { break-inside: avoid; } h2 { break-after: avoid; } .wide { overflow: visible; } }
</style>
</head>
<body>
<header>
<h1>$title</h1>
<p class="subtitle">$subtitle</p>
</header>
<nav aria-label="Contents">
<ol>
$contents
</ol>
</nav>
<main>
$body
</main>
</body>
</html>
""")
"""Template of the page."""


@dataclass(frozen=True)
class Picture:
    """An image of a report.

    Attributes
    ----------
    image : bytes
        Content of an SVG or PNG file.
    alternative : str
        Description of the image for those who cannot see it.
    caption : str
        Caption below the image.
    """

    image: bytes
    alternative: str
    caption: str


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes
    ----------
    headings : tuple of str
        Headings of the columns.
    rows : tuple of tuple of str
        Cells by row; the first cell names the row.
    caption : str
        Caption of the table.
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A section of a report.

    Attributes
    ----------
    title : str
        Title.
    content : tuple of str or Picture or Table
        Paragraphs, images and tables in order.
    """

    title: str
    content: tuple[str | Picture | Table, ...]


def check_report(path: str | Path) -> None:
    """Check that a path can be a report, before anything is computed for it.

    Parameters
    ----------
    path : str or Path
        Path of a .html file.

    Raises
    ------
    InputError
        If its name or folder is not possible.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path}: a report is a file that ends in .html")
    if not Path(path).parent.is_dir():
        raise InputError(f"{path}: No such file or directory")


def write_report(
    path: str | Path, title: str, sections: Sequence[Section], *, subtitle: str = ""
) -> None:
    """Write a report as a single HTML file without external resources.

    Parameters
    ----------
    path : str or Path
        Path of a .html file.
    title : str
        Title of the report.
    sections : sequence of Section
        Sections in order.
    subtitle : str
        Line below the title.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    check_report(path)
    try:
        Path(path).write_text(html_of(title, sections, subtitle=subtitle), "utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error


def html_of(title: str, sections: Sequence[Section], *, subtitle: str = "") -> str:
    """Return a report as HTML.

    Parameters
    ----------
    title : str
        Title of the report.
    sections : sequence of Section
        Sections in order.
    subtitle : str
        Line below the title.

    Returns
    -------
    str
        HTML document.
    """
    contents = [
        f'<li><a href="#part-{k}">{escape(s.title)}</a></li>' for k, s in enumerate(sections, 1)
    ]
    return PAGE.substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        contents="\n".join(contents),
        body="\n".join(_section(s, f"part-{k}") for k, s in enumerate(sections, 1)),
    )


def _section(section: Section, name: str) -> str:
    """Return a section as HTML."""
    parts = "\n".join(_part(part) for part in section.content)
    return f'<section id="{name}">\n<h2>{escape(section.title)}</h2>\n{parts}\n</section>'


def _part(part: str | Picture | Table) -> str:
    """Return a paragraph, image or table as HTML."""
    if isinstance(part, Picture):
        return _picture(part)
    return _table(part) if isinstance(part, Table) else f"<p>{escape(part)}</p>"


def _picture(picture: Picture) -> str:
    """Return an image as HTML, with its data inside."""
    kind = "image/png" if picture.image.startswith(PNG) else "image/svg+xml"
    data = base64.b64encode(picture.image).decode("ascii")
    return (
        f'<figure>\n<img alt="{escape(picture.alternative)}" src="data:{kind};base64,{data}">\n'
        f"<figcaption>{escape(picture.caption)}</figcaption>\n</figure>"
    )


def _table(table: Table) -> str:
    """Return a table as HTML; columns of numbers are aligned to the right."""
    right = [
        all(NUMBER.fullmatch(cell) for cell in column) for column in zip(*table.rows, strict=True)
    ]
    look = ['class="number"' if flag and k else "" for k, flag in enumerate(right)]
    look = look or [""] * len(table.headings)
    heads = "".join(
        _cell("th", text, f'scope="col" {how}')
        for text, how in zip(table.headings, look, strict=True)
    )
    rows = "\n".join(
        "<tr>"
        + _cell("th", row[0], 'scope="row"')
        + "".join(_cell("td", text, how) for text, how in zip(row[1:], look[1:], strict=True))
        + "</tr>"
        for row in table.rows
    )
    caption = f"<caption>{escape(table.caption)}</caption>\n" if table.caption else ""
    return (
        f'<div class="wide"><table>\n{caption}<thead><tr>{heads}</tr></thead>\n'
        f"<tbody>\n{rows}\n</tbody>\n</table></div>"
    )


def _cell(kind: str, text: str, how: str) -> str:
    """Return a cell of a table as HTML, with attributes given as text."""
    return f"<{' '.join(filter(None, (kind, how.strip())))}>{escape(text)}</{kind}>"
