"""The page looks as it did: its pictures are near those in ``page_references``, which are coarse.

The same comparison must see a page that is broken, and pass one with other fonts. Both are tried
here with lines that are added to the style sheet.
"""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from browser_rig import browsing
from page_pictures import (
    REFERENCES,
    REPLACE_TEXTS,
    VIEWS,
    View,
    differences,
    read,
    taken,
    viewing,
    write,
)

if TYPE_CHECKING:
    from playwright.async_api import Browser

pytestmark = pytest.mark.ci

WIDE = {state: View(state, (1280, 800), "light") for state in ("disarmed", "armed", "estopped")}
"""Views on which changes are tried, by state."""
NARROW = View("disarmed", (320, 700), "light")
"""View with one column."""


@pytest.fixture(scope="module")
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


async def changes(browser: "Browser", view: View, folder: Path, style: str = "") -> list[str]:
    """Return how a view differs from its reference; its picture is kept in a folder."""
    async with viewing(browser, view, style) as (_, visitor):
        picture = await taken(visitor)
    write(picture, folder / f"{view.name}.png")
    return differences(picture, read(REFERENCES / f"{view.name}.png"))


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
async def test_the_page_looks_as_it_did(browser: "Browser", view: View, tmp_path: Path) -> None:
    """Compare with the reference, which ``python tests/page_pictures.py`` writes anew."""
    assert await changes(browser, view, tmp_path) == []


def test_each_reference_is_that_of_a_view() -> None:
    """Find no file that nothing is compared with, and none that is large."""
    files = {path.stem: path.stat().st_size for path in REFERENCES.iterdir()}
    assert set(files) == {view.name for view in VIEWS}
    assert max(files.values()) < 20_000


@pytest.mark.parametrize(
    "style",
    [
        "body { font-family: serif; }",
        "body { letter-spacing: 0.02em; }",
        "body { line-height: 1.45; }",
        "body { -webkit-font-smoothing: none; font-weight: 500; }",
    ],
)
@pytest.mark.parametrize("view", [WIDE["disarmed"], NARROW], ids=lambda view: view.name)
async def test_another_font_makes_no_difference(
    browser: "Browser", tmp_path: Path, view: View, style: str
) -> None:
    """Change the fonts more than another rasterizer or version of the browser does."""
    assert await changes(browser, view, tmp_path, style) == []


async def test_the_time_of_day_makes_no_difference(browser: "Browser") -> None:
    """Write hours of one digit and of two, which end the lines of the log at other places."""
    pictures = []
    async with viewing(browser, NARROW) as (_, visitor):
        for time in ("1:02:03 AM", "11:52:24 PM"):
            await visitor.page.evaluate(REPLACE_TEXTS, {"#log time": time})
            pictures.append((await taken(visitor))[".log"])
    assert np.array_equal(pictures[0], pictures[1])


ELSEWHERE = """main {
  grid-template-areas: "array array pad picker" "contactor log health picker" !important;
}"""
"""Style sheet in which parts of the page are in each other's places."""
BROKEN = {
    "no panel of one contactor": (NARROW, ".contactor { display: none; }", ".contactor"),
    "no health": (WIDE["disarmed"], ".health { display: none; }", ".health"),
    "no e-stop": (WIDE["disarmed"], "#estop { visibility: hidden; }", "#estop"),
    "parts elsewhere": (WIDE["disarmed"], ELSEWHERE, "window"),
    "no pad": (WIDE["disarmed"], "#pad, #pad-surface { opacity: 0; }", ".pad"),
    "no contactors": (WIDE["disarmed"], "#array { opacity: 0; }", ".array"),
    "armed as disarmed": (WIDE["armed"], "#state { background: none !important; }", "#state"),
    "armed as e-stop": (WIDE["armed"], ":root { --warning: #b3121d !important; }", "#state"),
    "e-stop as armed": (WIDE["estopped"], ":root { --danger: #ffe4ad !important; }", "#state"),
    "no e-stop panel": (WIDE["estopped"], "#estop-panel { display: none; }", ".messages"),
    "dark panels": (WIDE["disarmed"], ":root { --panel: #1b1f24 !important; }", "window"),
    "all at the left": (NARROW, "main { width: 60%; }", "window"),
}
"""View, what breaks the page, and a part in which that must be seen, by what is wrong."""


@pytest.mark.parametrize("wrong", BROKEN)
async def test_a_broken_page_is_seen(browser: "Browser", tmp_path: Path, wrong: str) -> None:
    """Break one thing at a time."""
    view, style, part = BROKEN[wrong]
    assert any(part in sentence for sentence in await changes(browser, view, tmp_path, style))


async def test_a_page_without_its_style_sheet_is_seen(browser: "Browser", tmp_path: Path) -> None:
    """Switch the style sheet off, as a page has it whose sheet did not come."""
    async with viewing(browser, WIDE["disarmed"]) as (_, visitor):
        await visitor.page.evaluate("document.styleSheets[0].disabled = true")
        picture = await taken(visitor)
    assert differences(picture, read(REFERENCES / f"{WIDE['disarmed'].name}.png")) != []
