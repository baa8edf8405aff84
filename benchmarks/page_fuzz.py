"""The page in Chromium on a server that sends mutated messages, for as long as one wants.

Messages come in batches. Each batch is followed by a correct event, and the next one comes when the
page has logged that event, over a new connection if the batch ended the old one. So what is counted
depends on no pace, and the page has recovered after each batch.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from websockets.exceptions import ConnectionClosed

from benchmarks.hostile_server import HostileServer, hostile_server
from benchmarks.page import PageWindow, chromium, no_browser, window_of
from benchmarks.server import growth
from tactile.bench.figures import Figure, at_most, not_measured

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page

SECONDS = 600.0
"""Duration of the benchmark [s]."""
SEED = 20
"""Seed of the benchmark."""
BATCH = 20
"""Number of messages after which the page must log a correct one."""
RESEND = 0.1
"""Time after which the correct event is sent again, as its connection may have ended [s]."""
CALM_EVERY = 50
"""Number of batches between two measurements of memory."""
LOG_ENTRIES = 20
"""Number of entries in the log of the page, which correct ones replace before a measurement."""
LOGGED = "text => document.getElementById('log').textContent.includes(text)"
"""JavaScript that returns whether the page has logged a text."""
UNTOUCHED = """() => document.title.endsWith("tactile")
  && document.querySelectorAll("script").length === 1 && document.querySelector("img") === null"""
"""JavaScript that returns whether no text of the server was taken for HTML."""


class FuzzedPage(NamedTuple):
    """A page, its server, and what went wrong in it.

    Attributes
    ----------
    server : HostileServer
        Server of the page.
    window : PageWindow
        The page.
    faults : list of str
        Uncaught exceptions, rejections that nothing handled, and what the page's policy forbade.
    """

    server: HostileServer
    window: PageWindow
    faults: list[str]

    async def fuzz(self, batches: int, first: int = 0) -> int:
        """Send batches of mutated messages.

        Parameters
        ----------
        batches : int
            Number of batches.
        first : int
            Number of batches that were sent before.

        Returns
        -------
        int
            Number of messages in batches that were sent to their end. After one that made the page
            connect anew, it drops what is still on its way.
        """
        self.server.is_hostile = True
        taken = 0
        for number in range(first, first + batches):
            link = await self.server.welcomed()
            with suppress(ConnectionClosed):
                await self.server.send_batch(link, BATCH)
                taken += BATCH - 1
            await self.log(f"batch {number};", "textures")
        return taken

    async def log(self, marker: str, kind: str = "note") -> None:
        """Send a correct event until the page has logged it.

        Parameters
        ----------
        marker : str
            Text of the event, which is that of no other one.
        kind : str
            Kind of the event.
        """
        await self.send_until(LOGGED, marker, kind)

    async def send_until(self, condition: str, marker: str, kind: str = "note") -> None:
        """Send correct telemetry and a correct event until something is so.

        Parameters
        ----------
        condition : str
            JavaScript function of the event's text that returns whether it is so.
        marker : str
            Text of the event.
        kind : str
            Kind of the event.
        """
        page = self.window.page
        fulfilled = asyncio.ensure_future(page.wait_for_function(condition, arg=marker))
        try:
            while not fulfilled.done():
                await self.server.send_correct(marker, kind)
                await asyncio.wait({fulfilled}, timeout=RESEND)
            await fulfilled
        finally:
            fulfilled.cancel()

    async def show(self, state: str) -> None:
        """Report a state correctly until the page shows it.

        Parameters
        ----------
        state : str
            State of the display.
        """
        self.server.is_hostile = False
        self.server.state = state
        await self.log(f"now {state}; {self.server.connections}")
        await self.window.page.wait_for_selector(f'[data-testid=state][data-state="{state}"]')

    async def is_untouched(self) -> bool:
        """Return whether no text of the server was taken for HTML."""
        return bool(await self.window.page.evaluate(UNTOUCHED))

    async def memory(self) -> tuple[float, float]:
        """Return the size of the page's heap [MiB] and its number of nodes, after correct messages.

        Their log replaces that of long texts.
        """
        self.server.is_hostile = False
        for number in range(LOG_ENTRIES):
            await self.log(f"calm {number} {self.server.sent};", "textures")
        browser = await self.window.page.context.new_cdp_session(self.window.page)
        await browser.send("HeapProfiler.collectGarbage")
        heap = await browser.send("Runtime.getHeapUsage")
        counters = await browser.send("Memory.getDOMCounters")
        await browser.detach()
        return heap["usedSize"] / 2**20, float(counters["nodes"])


@asynccontextmanager
async def fuzzed_page(browser: "Browser", seed: int) -> AsyncIterator[FuzzedPage]:
    """Open the page of a server of its own.

    Parameters
    ----------
    browser : playwright.async_api.Browser
        Running browser.
    seed : int
        Seed of what the server sends.

    Yields
    ------
    FuzzedPage
        The page, which is connected.
    """
    async with (
        hostile_server(HostileServer(seed)) as server,
        window_of(browser, server.page) as window,
    ):
        faults: list[str] = []
        watch(window.page, faults)
        await window.choose("wood-oak")
        yield FuzzedPage(server, window, faults)


def watch(page: "Page", faults: list[str]) -> None:
    """Note what goes wrong in a page; a connection that is broken off is no fault of it.

    Parameters
    ----------
    page : playwright.async_api.Page
        The page.
    faults : list of str
        List that the faults are added to.
    """

    def note(message: Any) -> None:
        if message.type == "error" and not message.text.startswith("WebSocket "):
            faults.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: faults.append(f"{error}\n{error.stack}"))
    page.on("crash", lambda _: faults.append("the page crashed"))
    page.on("dialog", lambda dialog: faults.append(dialog.message))


def measure_page_fuzz(seconds: float = SECONDS) -> Iterator[Figure]:
    """Measure what is left of the page after a while of mutated messages.

    Parameters
    ----------
    seconds : float
        Duration [s].

    Yields
    ------
    Figure
        Numbers of messages, connections and faults, and the growth of the page's memory.
    """
    if why := no_browser():
        yield not_measured("page-fuzz", why)
    else:
        yield from asyncio.run(_measured(seconds))


async def _measured(seconds: float) -> list[Figure]:
    end = time.monotonic() + seconds
    taken = batches = 0
    sizes: list[tuple[float, float]] = []
    async with chromium() as browser, fuzzed_page(browser, SEED) as fuzzed:
        while time.monotonic() < end:
            taken += await fuzzed.fuzz(CALM_EVERY, batches)
            batches += CALM_EVERY
            sizes.append(await fuzzed.memory())
        await fuzzed.show("armed")
        is_untouched = await fuzzed.is_untouched()
    server = fuzzed.server
    for fault in dict.fromkeys(fuzzed.faults):
        print(fault)
    heaps, nodes = zip(*sizes, strict=True)
    return [
        Figure("page-fuzz.sent", float(server.sent), "messages"),
        Figure("page-fuzz.taken", float(taken), "messages"),
        Figure("page-fuzz.reconnections", float(server.connections - 1), ""),
        at_most("page-fuzz.faults", float(len(fuzzed.faults)), "", 0),
        at_most("page-fuzz.executed", float(not is_untouched), "", 0),
        Figure("page-fuzz.heap", heaps[-1], "MiB"),
        growth("page-fuzz.heap", list(heaps)),
        Figure("page-fuzz.nodes", nodes[-1], ""),
    ]
