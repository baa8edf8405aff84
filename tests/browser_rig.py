"""The page in Chromium, driven by Playwright as a person would drive it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from node_rig import miss

from benchmarks.page import PageWindow, chromium, no_browser

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page

PATIENCE_S = 300.0
"""Longest wait for anything on the page; the first texture compiles the inner loops [s]."""
VIEWPORT = {"width": 1280, "height": 800}
"""Size of the window [CSS px]."""


@asynccontextmanager
async def browsing() -> "AsyncIterator[Browser]":
    """Run the browser of this machine."""
    if why := no_browser():
        miss(why)
    async with chromium() as browser:
        yield browser


class Visitor(PageWindow):
    """A window with the page, and all that went wrong in it.

    Attributes
    ----------
    mistakes : list of str
        Errors of the page's console, and what its scripts threw.
    requests : list of str
        Addresses of all that the page has loaded.
    """

    def __init__(self, page: "Page") -> None:
        super().__init__(page)
        self.mistakes: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._log)
        page.on("pageerror", lambda error: self.mistakes.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def _log(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.mistakes.append(message.text)

    def at(self, name: str) -> Any:
        """Return the element with a `data-testid`."""
        return self.page.get_by_test_id(name)

    async def state(self, state: str) -> None:
        """Wait until the page says that the display has a state."""
        await self.page.wait_for_selector(f'[data-testid=state][data-state="{state}"]')

    async def point(self, x: float, y: float) -> tuple[float, float]:
        """Return where a share of the pad's width and height is in the window [CSS px]."""
        box = await self.at("pad").bounding_box()
        return box["x"] + x * box["width"], box["y"] + y * box["height"]


@asynccontextmanager
async def visiting(
    browser: "Browser", url: str, *, connected: bool = True, **options: Any
) -> AsyncIterator[Visitor]:
    """Open the page in a window of its own; by default wait until it is connected."""
    context = await browser.new_context(**{"viewport": VIEWPORT, **options})
    context.set_default_timeout(PATIENCE_S * 1e3)
    try:
        visitor = Visitor(await context.new_page())
        await visitor.page.goto(url)
        if connected:
            await visitor.page.wait_for_selector('[data-testid=state]:not([data-state="offline"])')
        yield visitor
    finally:
        await context.close()
