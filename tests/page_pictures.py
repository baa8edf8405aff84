"""Pictures of the page in known states, so coarse that neither browser nor fonts matter.

A picture has a part for the window, and one for each part of the page, wherever that is in the
window: cells that hold the mean color of what they cover. ``python tests/page_pictures.py`` writes
those of the present page to the folder ``page_references``, as the ones to compare with. Look at
the page itself before, and commit them with the change that they follow.
"""

import asyncio
import io
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from browser_rig import Visitor, browsing, visiting
from numpy.typing import NDArray

from benchmarks.hostile_server import HostileServer, hostile_server

if TYPE_CHECKING:
    from playwright.async_api import Browser

Image = pytest.importorskip("PIL.Image")

REFERENCES = Path(__file__).parent / "page_references"
"""Folder of the pictures to compare with."""
PARTS = (
    "window", "#state", "#estop", "header", ".messages", "dialog[open]", ".pad", ".array",
    ".contactor", ".picker", ".health", ".log",
)  # fmt: skip
"""Parts of the page, by selector; the first one is the whole window."""
CHANGING = {"#log time": "10:00:00 AM", "[data-testid=round-trip]": "1.0 ms"}
"""Text that stands in elements whose own differs each time, by selector. They are covered too, but
the width of the text, such as that of an hour of one digit or two, decides where lines end."""
COVER = (128, 128, 128)
"""Color of what is covered."""
COLUMNS = 24
"""Number of cells along the width of a part."""
MOST_ROWS = 96
"""Largest number of cells along the height of a part."""
LINE = (255, 0, 255)
"""Color of the line that ends each part in a file."""
COLOR_TOLERANCE = 20.0
"""Difference of a cell's color to those of the same place and around it that is not counted; a
text in another font has about half of it. Assumed, of 255."""
SHARE_TOLERANCE = 0.06
"""Largest share of the cells of a part that may differ."""
HEIGHT_TOLERANCE = 0.2
"""Largest relative difference of a part's height: a line or two more of a text in another font."""
SIZES = ((320, 700), (1280, 800), (3840, 2160))
"""Sizes of the window [CSS px]."""
TEXTURE = "wood-oak"
"""Texture that is selected."""
SETTLED = """texture => {
  const list = document.getElementById("textures").getBoundingClientRect();
  const isDrawn = (canvas) => {
    const { top, bottom } = canvas.getBoundingClientRect();
    return bottom < list.top || top > list.bottom || canvas.dataset.drawn === "true";
  };
  const surface = document.getElementById("pad-surface");
  const thumbnails = [...document.querySelectorAll(".thumbnail")];
  return thumbnails.length > 0 && thumbnails.every(isDrawn) && surface.dataset.textures === texture
    && document.querySelector("[data-testid=blocks]") !== null;
}"""
"""JavaScript that returns whether everything is drawn."""
ADD_STYLE = """style => {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(style);
  document.adoptedStyleSheets = [sheet];
}"""
"""JavaScript that adds lines to the style sheet, as the policy of the page lets no element do."""
REPLACE_TEXTS = """texts => {
  for (const [selector, text] of Object.entries(texts))
    for (const element of document.querySelectorAll(selector)) element.textContent = text;
}"""
"""JavaScript that replaces the texts of elements."""
BOXES = """selectors => selectors.map(selector =>
  [...document.querySelectorAll(selector)].map(element => {
    const { left, top, width, height } = element.getBoundingClientRect();
    return [left + scrollX, top + scrollY, width, height];
  }))"""
"""JavaScript that returns where elements are on the page [CSS px]."""

Cells = NDArray[np.uint8]
"""Colors of cells, an array (rows, columns, 3)."""


@dataclass(frozen=True)
class View:
    """A state of the page in a window.

    Attributes
    ----------
    state : str
        "disarmed", "arming" (the question is open), "armed" or "estopped".
    size : pair of int
        Size of the window [CSS px].
    scheme : str
        "light" or "dark".
    """

    state: str
    size: tuple[int, int]
    scheme: str

    @property
    def name(self) -> str:
        """Name of the file with its picture, without suffix."""
        return f"{self.state}-{self.size[0]}-{self.scheme}"


VIEWS = tuple(
    View(state, size, scheme)
    for scheme in ("light", "dark")
    for state, sizes in (
        ("disarmed", SIZES),
        ("arming", SIZES[:2]),
        ("armed", SIZES[1:2]),
        ("estopped", SIZES[:2]),
    )
    for size in sizes
)
"""All views that are compared."""


# Pictures


def cells_of(image: Any, box: tuple[float, float, float, float]) -> Cells:
    """Return the cells of a box (left, top, width, height) in a screenshot; none if it is empty."""
    left, top, width, height = box
    if width < 1 or height < 1:
        return np.zeros((0, COLUMNS, 3), np.uint8)
    rows = min(max(round(COLUMNS * height / width), 1), MOST_ROWS)
    corners = (left, top, left + width, top + height)
    return np.asarray(image.resize((COLUMNS, rows), Image.Resampling.BOX, box=corners))


async def taken(visitor: Visitor) -> dict[str, Cells]:
    """Take a picture of the page; parts that are not shown have no cells."""
    page = visitor.page
    await page.evaluate(REPLACE_TEXTS, CHANGING)
    shot = await page.screenshot(full_page=True, animations="disabled", caret="hide", scale="css")
    image = Image.open(io.BytesIO(shot)).convert("RGB")
    for boxes in await page.evaluate(BOXES, [*CHANGING]):
        for left, top, width, height in boxes:
            image.paste(COVER, tuple(map(round, (left, top, left + width, top + height))))
    size = page.viewport_size
    assert size is not None
    picture = {PARTS[0]: cells_of(image, (0, 0, size["width"], size["height"]))}
    for part, boxes in zip(PARTS[1:], await page.evaluate(BOXES, PARTS[1:]), strict=True):
        picture[part] = cells_of(image, boxes[0] if boxes else (0, 0, 0, 0))
    return picture


def write(picture: dict[str, Cells], path: Path) -> None:
    """Write a picture: its parts one below the other, each with a line beneath it."""
    line = np.full((1, COLUMNS, 3), LINE, np.uint8)
    rows = np.concatenate([each for part in PARTS for each in (picture[part], line)])
    Image.fromarray(rows).save(path, optimize=True)


def read(path: Path) -> dict[str, Cells]:
    """Read a picture that `write` has written."""
    rows = np.asarray(Image.open(path).convert("RGB"))
    ends = np.flatnonzero((rows == LINE).all(axis=(1, 2)))
    begins = [0, *(ends[:-1] + 1)]
    return {p: rows[a:b] for p, a, b in zip(PARTS, begins, ends, strict=True)}


def differing(cells: Cells, others: Cells) -> float:
    """Return the share of cells whose color is not among those of the others around their place."""
    padded = np.pad(others.astype(float), ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))
    low, high = around.min(axis=(3, 4)), around.max(axis=(3, 4))
    beyond = np.maximum(cells - high, low - cells).max(axis=2)
    return float(np.mean(beyond > COLOR_TOLERANCE))


def differences(picture: dict[str, Cells], reference: dict[str, Cells]) -> list[str]:
    """Return a sentence on each part that differs more than browsers and fonts may make it."""
    sentences = []
    for part in PARTS:
        cells, expected = picture[part], reference[part]
        rows, wanted = len(cells), len(expected)
        if abs(rows - wanted) > 1 + HEIGHT_TOLERANCE * wanted or (rows == 0) != (wanted == 0):
            sentences.append(f"{part} has {rows} rows of cells instead of {wanted}")
        elif rows > 0:
            resized = Image.fromarray(cells).resize((COLUMNS, wanted), Image.Resampling.BILINEAR)
            same = np.asarray(resized)
            share = max(differing(same, expected), differing(expected, same))
            if share > SHARE_TOLERANCE:
                sentences.append(f"{share:.0%} of the cells of {part} differ")
    return sentences


# Views


@asynccontextmanager
async def viewing(
    browser: "Browser", view: View, style: str = ""
) -> AsyncIterator[tuple[HostileServer, Visitor]]:
    """Open the page of a server, that sends nothing wrong here, in a state.

    Parameters
    ----------
    browser : Browser
        Running browser.
    view : View
        State and window.
    style : str
        Lines that are added to the style sheet.
    """
    size = dict(zip(("width", "height"), view.size, strict=True))
    async with (
        hostile_server(HostileServer(0)) as server,
        visiting(
            browser, server.page, connected=False, viewport=size, color_scheme=view.scheme
        ) as visitor,
    ):
        await visitor.page.evaluate(ADD_STYLE, style)
        await show(server, visitor, view.state)
        yield server, visitor


async def show(server: HostileServer, visitor: Visitor, state: str) -> None:
    """Select a texture, and bring the page into a state."""
    await visitor.choose(TEXTURE)
    await visitor.page.wait_for_function(SETTLED, arg=TEXTURE)
    if state == "arming":
        await visitor.at("arm").click()
    else:
        server.state = state  # the page asks for it each second
        await visitor.state(state)
    await visitor.page.evaluate("scrollTo(0, 0)")


async def rewrite() -> None:
    """Write the pictures of all views of the present page."""
    REFERENCES.mkdir(exist_ok=True)
    for old in REFERENCES.glob("*.png"):
        old.unlink()
    async with browsing() as browser:
        for view in VIEWS:
            async with viewing(browser, view) as (_, visitor):
                write(await taken(visitor), REFERENCES / f"{view.name}.png")
            print(f"{view.name}.png")


if __name__ == "__main__":
    sys.exit(asyncio.run(rewrite()))
