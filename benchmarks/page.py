"""The page of the server in Chromium, and its JavaScript client in node.

A window of the page is used as a person uses it: a texture is chosen, the display is armed, and
the mouse strokes over the pad 125 times a second. The mouse does not wait until the page has taken
a move, just as a real one does not. The latency is measured on the C amplifier on a pty as in
`benchmarks.latency`, from the time stamps that Chromium gave the pointer events.
"""

import asyncio
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, closing, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from unittest.mock import patch

import numpy as np

from benchmarks import traced_playback
from benchmarks.app import TEXTURE
from benchmarks.latency import latencies
from benchmarks.server import NAME, PATIENCE, POLL, ServerProcess, amplifier_and_folder
from benchmarks.tracing import traced
from benchmarks.virtual import NO_AMPLIFIER, VirtualAmplifier, can_be_built
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most, beside_machine, not_measured
from tactile.client import aio
from tactile.client.display import AsyncDisplay
from tactile.errors import ClientError
from tactile.messages import Contact, Failure, Streamed
from tactile.playback.block_rendering import BLOCK
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig, ServerConfig
from tactile.server.page import FOLDER
from tactile.server.server import running

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page

T = TypeVar("T")

MOVES = 125.0
"""Rate of the moves of the mouse, that of USB mice by default [1/s]."""
SECONDS = 10.0
"""Duration of a stroke [s]."""
FRAMES_SECONDS = 5.0
"""Duration in which frames are counted [s]."""
TURNS, SWING = 2.0, 0.4
"""Angular frequency of the stroke [rad/s], and its amplitude as a share of the pad's width."""
WIDTH, HEIGHT = 1280, 800
"""Size of the window [CSS px]."""
WINDOWS = 5
"""Number of windows that are open beside a playback whose late blocks are counted."""
PLAYED = 0.99
"""Share of the blocks that must be played: a stroke ends a little before or after its last one."""
TRIES = 3
"""Maximum number of strokes until the link is not lost during one."""
LOADS = 3
"""Number of times that the page is loaded, each time by a browser that has nothing of it yet."""
EXCHANGES = 200
"""Number of questions for the page's time, of which the quickest answer counts."""
RESOLUTION = 1e-4
"""Steps of the clock of a page that is not isolated from other origins, and of the time stamps of
its events, as the W3C's High Resolution Time has it [s]."""
CONTACTS, CONTACTS_SECONDS = 10_000, 5
"""Rate of the contacts of the client in node [1/s], and their duration [s]."""
WS = Path("/usr/share/nodejs/ws")
"""WebSocket for node before version 22, where Debian keeps it."""
STROKE = "from benchmarks.page import stroke_once; stroke_once({!r}, {!r})"
"""Code of the process with the browser."""
CHROMIUM = """#!/bin/sh
ordinary="setpriv --bounding-set=-sys_nice"
$ordinary true 2>/dev/null || ordinary=
exec $ordinary {} "$@"
"""
"""Program that runs the browser without the right to raise its own priority, which users other than
root do not have. As root, it draws with a nice value of -8, ahead of the server."""
SURFACES = """() => {
  const list = document.getElementById("textures").getBoundingClientRect();
  const isInSight = (canvas) => {
    const { top, bottom } = canvas.getBoundingClientRect();
    return bottom > list.top && top < list.bottom;
  };
  const pictures = [...document.querySelectorAll("canvas.thumbnail")];
  const [pad, selected] = ["pad-surface", "selected"].map((id) => document.getElementById(id));
  const isPadDrawn = selected.textContent.endsWith(pad.dataset.textures || ".");
  return isPadDrawn && pictures.filter(isInSight).every(({ dataset }) => dataset.drawn);
}"""
"""JavaScript that returns whether the selected surface and the small ones in sight are drawn."""
COUNT_FRAMES = """seconds => new Promise(done => {
  let begun, frames = 0;
  const count = now => {
    begun ??= now;
    if (now - begun >= 1000 * seconds) return done(1000 * frames / (now - begun));
    frames += 1;
    requestAnimationFrame(count);
  };
  requestAnimationFrame(count);
})"""
"""JavaScript that returns the frames per second."""
TRANSFERRED = """["navigation", "resource"].flatMap(kind => performance.getEntriesByType(kind))
  .reduce((sum, entry) => sum + entry.transferSize, 0)"""
"""JavaScript that returns the size of all that was loaded, with the headers [bytes]."""
FIRST_PAINT = """new Promise(done => {
  new PerformanceObserver(list => {
    for (const { startTime } of list.getEntriesByName("first-contentful-paint")) done(startTime);
  }).observe({ type: "paint", buffered: true });
})"""
"""JavaScript that returns when the page first showed something, from the navigation [ms]."""
SEND = """
import { createRequire } from "node:module";
const [folder, ws, url, rate, seconds] = process.argv.slice(1);
const { connect } = await import(`${folder}/client/index.js`);
const webSocket = globalThis.WebSocket ?? createRequire(import.meta.url)(ws);
const connection = connect({ url, webSocket });
await connection.ready();
const display = connection.display();
const begun = performance.now();
let sent = 0;
await new Promise((done) => {
  const timer = setInterval(() => {
    const due = Math.min(rate * seconds, ((performance.now() - begun) * rate) / 1000);
    for (; sent < due; sent += 1) display.touch([sent % 50, 0]);
    if (sent < rate * seconds) return;
    clearInterval(timer);
    done();
  }, 1);
});
await display.stats(); // the server answers it after the contacts
const lasted_ms = performance.now() - begun;
console.log(JSON.stringify({ sent, dropped: display.droppedContacts, seconds: lasted_ms / 1000 }));
process.exit();
"""
"""JavaScript of the client in node, which sends contacts and prints what it counted."""


def no_browser() -> str:
    """Return why the page cannot be opened here; empty if it can."""
    if sys.platform != "linux" or shutil.which("chromium") is None:
        return "needs Linux and chromium on PATH"
    return "" if find_spec("playwright") else "needs the package playwright, of the extra dev"


def no_node() -> str:
    """Return why the client cannot be run in node here; empty if it can."""
    node = shutil.which("node")
    if node is None:
        return "needs node on PATH"
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True)
    is_new = int(version.stdout.removeprefix("v").partition(".")[0]) >= 22
    return "" if is_new or WS.exists() else f"needs node 22, or ws in {WS}"


# The page in a window


class PageWindow:
    """The page in a window of Chromium, used as a person uses it.

    Parameters
    ----------
    page : playwright.async_api.Page
        The window.

    Attributes
    ----------
    page : playwright.async_api.Page
        The window.
    """

    def __init__(self, page: "Page") -> None:
        self.page = page

    async def open(self, url: str) -> None:
        """Open the page, and wait until it is connected."""
        await self.page.goto(url)
        await self.page.wait_for_selector('[data-testid=state]:not([data-state="offline"])')

    async def choose(self, texture: str) -> None:
        """Choose a texture, and wait until it is ready."""
        await self.page.locator(f'[data-testid=texture][data-name="{texture}"]').click()
        chosen = (
            "name => document.querySelector('[data-testid=selected]').textContent.includes(name)"
        )
        await self.page.wait_for_function(chosen, arg=texture)

    async def arm(self) -> None:
        """Arm the display, and wait until the page says so."""
        await self.page.get_by_test_id("arm").click()
        await self.page.get_by_test_id("arm-confirm").click()
        await self.page.wait_for_selector('[data-testid=state][data-state="armed"]')

    async def stroke(self, seconds: float) -> None:
        """Press the mouse on the pad, stroke to and fro, and release it."""
        box = await self.page.get_by_test_id("pad").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        await self.page.mouse.move(x, y)
        await self.page.mouse.down()
        browser = await self.page.context.new_cdp_session(self.page)
        move = {"type": "mouseMoved", "button": "left", "buttons": 1, "y": y}
        begun = time.monotonic()
        async with asyncio.TaskGroup() as moves:
            for k in range(int(seconds * MOVES)):
                await asyncio.sleep(max(begun + k / MOVES - time.monotonic(), 0))
                moved = x + SWING * box["width"] * math.sin(TURNS * k / MOVES)
                sent = browser.send("Input.dispatchMouseEvent", move | {"x": moved})
                moves.create_task(sent)
        await self.page.mouse.up()

    async def see_surfaces(self) -> None:
        """Wait until all surfaces that are in sight are drawn."""
        await self.page.wait_for_function(SURFACES)

    async def frames_per_second(self) -> float:
        """Return how many frames the page draws per second, counted for `FRAMES_SECONDS`."""
        return float(await self.page.evaluate(COUNT_FRAMES, FRAMES_SECONDS))

    async def clock(self) -> tuple[float, float]:
        """Return this program's monotonic clock less that of the page, and its uncertainty [s]."""
        quickest = math.inf, 0.0
        for _ in range(EXCHANGES):
            before = time.monotonic()
            page_time = 1e-3 * await self.page.evaluate("performance.now()")
            after = time.monotonic()
            quickest = min(quickest, ((after - before) / 2, (before + after) / 2 - page_time))
        return quickest[1], quickest[0] + RESOLUTION

    async def loaded(self) -> tuple[float, float]:
        """Return the size of what was loaded [kB] and the time of the first paint [ms]."""
        painted = await self.page.evaluate(FIRST_PAINT)
        return await self.page.evaluate(TRANSFERRED) / 1000, painted


@asynccontextmanager
async def chromium() -> AsyncIterator["Browser"]:
    """Run the browser of this machine, without a sandbox, which it does not have as root."""
    from playwright.async_api import async_playwright

    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "chromium"
        program.write_text(CHROMIUM.format(shutil.which("chromium")))
        program.chmod(0o700)
        async with async_playwright() as playwright:
            browser = await playwright.chromium.launch(
                executable_path=program, args=["--no-sandbox"]
            )
            try:
                yield browser
            finally:
                await browser.close()


@asynccontextmanager
async def window_of(browser: "Browser", url: str) -> AsyncIterator[PageWindow]:
    """Open the page in a window that shares nothing with others.

    Parameters
    ----------
    browser : playwright.async_api.Browser
        Running browser.
    url : str
        URL of the page.

    Yields
    ------
    PageWindow
        Window that is connected to the server.
    """
    context = await browser.new_context(viewport={"width": WIDTH, "height": HEIGHT})
    context.set_default_timeout(PATIENCE * 1e3)
    try:
        window = PageWindow(await context.new_page())
        await window.open(url)
        yield window
    finally:
        await context.close()


# Servers


class SimulatedServer(ServerProcess):
    """`tactile serve` in its own process, with 64 simulated contactors.

    Parameters
    ----------
    folder : Path
        Folder for its configuration and log.
    server : str
        Further lines of the table ``server``.
    """

    def __init__(self, folder: Path, *, server: str = "") -> None:
        self._config, self._stderr = folder / "tactile.toml", folder / "stderr"
        display = f'[[display]]\nname = "{NAME}"\ndisplay = "reference-64"\ndevice = "sim:"\n'
        self._config.write_text(f'[server]\nport = 0\n{server}\n[log]\nfile = "log"\n{display}')
        self.start()


@contextmanager
def simulated_server(server: str = "") -> Iterator[SimulatedServer]:
    """Run a server with folders of its own for state and sockets.

    Parameters
    ----------
    server : str
        Further lines of the table ``server``.

    Yields
    ------
    SimulatedServer
        Running server.
    """
    with tempfile.TemporaryDirectory(prefix="t-") as own:
        folders = {"STATE_DIRECTORY": f"{own}/state", "RUNTIME_DIRECTORY": f"{own}/run"}
        with (
            patch.dict(os.environ, folders),
            closing(SimulatedServer(Path(own), server=server)) as running_server,
        ):
            yield running_server


def page_of(server: ServerProcess) -> str:
    """Return the URL of a server's page.

    Parameters
    ----------
    server : ServerProcess
        Running server.

    Returns
    -------
    str
        URL for a browser.
    """
    return f"http://127.0.0.1:{server.port}/"


def processor_seconds(pid: int) -> float:
    """Return the processor time that a process has used.

    Parameters
    ----------
    pid : int
        Identifier of the process.

    Returns
    -------
    float
        Time of user and system [s].
    """
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


async def share_of_core(pid: int, work: Awaitable[T]) -> tuple[float, T]:
    """Measure which share of a core a process uses during some work.

    Parameters
    ----------
    pid : int
        Identifier of the process.
    work : awaitable
        Work to wait for.

    Returns
    -------
    share : float
        Share of a core [%].
    outcome : object
        What the work returns.
    """
    begun, used = time.monotonic(), processor_seconds(pid)
    outcome = await work
    return 100 * (processor_seconds(pid) - used) / (time.monotonic() - begun), outcome


# What is measured


def measure_page() -> Iterator[Figure]:
    """Measure the page and the JavaScript client."""
    yield from beside_machine("page", page_figures())


def page_figures() -> Iterator[Figure]:
    """Yield all figures, each with a value or with what is missing."""
    why = no_browser()
    amplifier = why or ("" if can_be_built() else NO_AMPLIFIER)
    if amplifier:
        yield not_measured("page.latency", amplifier)
        yield not_measured("page.late_blocks", amplifier)
    else:
        yield from _latency()
        yield from _late_blocks()
    if why:
        yield not_measured("page.frames_per_second", why)
    else:
        with simulated_server() as server:
            yield from asyncio.run(_one_window(server))
    if why := no_node():
        yield not_measured("page.client", why)
    else:
        yield from client_figures()


# Latency


def stroke_once(url: str, file: str) -> None:
    """Arm the display and stroke with the page, and store the offset of its clock.

    The display is disarmed when the window is closed.

    Parameters
    ----------
    url : str
        URL of the page.
    file : str
        File for the offset of the page's clock from the host's, and its uncertainty [s].
    """
    asyncio.run(_stroke_once(url, file))


async def _stroke_once(url: str, file: str) -> None:
    async with chromium() as browser, window_of(browser, url) as window:
        await window.choose(TEXTURE)
        await window.arm()
        clocks = [await window.clock()]
        await window.stroke(SECONDS)
        clocks.append(await window.clock())
        np.save(file, min(clocks, key=lambda clock: clock[1]))


class Strokes(NamedTuple):
    """What was recorded of a stroke.

    Attributes
    ----------
    trace : (B, 3) array of float
        Trace of `benchmarks.traced_playback`.
    pointed, arrived : (K,) array of float
        Time of each pointer event, and that at which its contact came to the server [s].
    uncertainty : float
        Largest error of the times of all pointer events [s].
    """

    trace: Floats
    pointed: Floats
    arrived: Floats
    uncertainty: float


async def _session(folder: Path, device: str) -> Strokes | None:
    """Play while a process with a browser strokes on the page; return None if the link was lost."""
    config = Configuration(
        server=ServerConfig(port=0, socket=""),
        display=(DisplayConfig(name=NAME, device=device),),
    )
    taken: list[tuple[float, float]] = []
    take = Client.stream

    def stream(client: Client, message: Streamed, arrival: float) -> Failure | None:
        failure = take(client, message, arrival)
        if failure is None and isinstance(message, Contact) and message.time_us is not None:
            taken.append((1e-6 * message.time_us, arrival))
        return failure

    with patch.object(Client, "stream", stream):
        async with running(config) as server:
            await _run_stroke(STROKE.format(server.page, str(folder / "clock.npy")))
    times = np.array(taken)
    offset, uncertainty = np.load(folder / "clock.npy")
    if not (folder / "trace.npy").exists():  # it is written when the display is disarmed
        return None
    trace = np.load(folder / "trace.npy")
    return Strokes(trace, times[:, 0] + offset, times[:, 1], float(uncertainty))


async def _run_stroke(code: str) -> None:
    """Run the process with the browser, which ends with this one."""
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", code)
    try:
        if await process.wait():
            raise subprocess.CalledProcessError(process.returncode or 1, "browser")
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


def _latency() -> Iterator[Figure]:
    """Yield the latency from the pointer to the amplifier, and in which parts it arises.

    The stroke is repeated if the link was lost, which says nothing about the page.
    """
    for tries in range(1, TRIES + 1):
        with amplifier_and_folder() as (amplifier, folder):
            with traced(traced_playback, folder / "trace.npy"):
                strokes = asyncio.run(_session(folder, f"serial://{amplifier.path}"))
            if strokes is not None:
                yield Figure("page.latency.tries", float(tries), "")
                time.sleep(0.1)  # until the amplifier has written its record
                yield from _latency_figures(strokes, amplifier)
                return
    yield not_measured("page.latency", f"the link was lost in each of {TRIES} tries")


def _latency_figures(strokes: Strokes, amplifier: VirtualAmplifier) -> Iterator[Figure]:
    records = amplifier.take()  # which both latencies need, and which can be read once
    with patch.object(amplifier, "take", lambda: records):
        late = 1e3 * latencies(strokes.trace, strokes.pointed, amplifier)
        from_server = 1e3 * latencies(strokes.trace, strokes.arrived, amplifier)
    to_server = 1e3 * (strokes.arrived - strokes.pointed)
    yield Figure("page.latency.events", float(len(late)), "")
    yield Figure("page.latency.uncertainty", 1e3 * strokes.uncertainty, "ms")
    for part, goal in ((50, 20), (99, 40)):
        yield at_most(f"page.latency.p{part}", float(np.percentile(late, part)), "ms", goal)
    for name, times in (("to_server", to_server), ("from_server", from_server)):
        for part in (50, 99):
            figure = f"page.latency.{name}.p{part}"
            yield Figure(figure, float(np.percentile(times, part)), "ms")


# Late blocks


def _late_blocks() -> Iterator[Figure]:
    """Yield how many more blocks are late while pages are open.

    A display that was disarmed meanwhile plays fewer blocks.
    """
    with (
        amplifier_and_folder() as (amplifier, folder),
        closing(ServerProcess(folder, amplifier.path)) as server,
    ):
        without, beside = asyncio.run(_in_turns(server))
    late = []
    due = 2 * SECONDS * RATE / BLOCK
    for name, (blocks, lost) in (("without", without), ("with", beside)):
        late.append(1e4 * lost / max(blocks, 1))
        yield at_least(f"page.late_blocks.{name}.blocks", blocks, "", PLAYED * due)
        yield Figure(f"page.late_blocks.{name}", late[-1], "of 10 000")
    yield at_most("page.late_blocks", late[1] - late[0], "of 10 000", 0)


async def _in_turns(server: ServerProcess) -> tuple[Floats, Floats]:
    """Return the blocks and the late ones without pages and with them.

    The turns are without, with, with, without. The stroke comes from a program in Python while
    there are no pages.
    """
    async with aio.connect(server.url, display=NAME, timeout=PATIENCE) as display:
        await display.select(TEXTURE, timeout=PATIENCE)
        without = await _blocks_while(display, _touch(display))
        beside = np.zeros(2)
        async with chromium() as browser, AsyncExitStack() as windows:
            for _ in range(WINDOWS):
                window = await windows.enter_async_context(window_of(browser, page_of(server)))
                await window.see_surfaces()
            await window.choose(TEXTURE)
            await window.see_surfaces()
            for _ in range(2):
                beside += await _blocks_while(display, window.stroke(SECONDS))
        without += await _blocks_while(display, _touch(display))
    return without, beside


async def _touch(display: AsyncDisplay) -> None:
    """Stroke like the page, but from this program."""
    begun = time.monotonic()
    for k in range(int(SECONDS * MOVES)):
        await asyncio.sleep(max(begun + k / MOVES - time.monotonic(), 0))
        await display.touch((0.045 * math.sin(TURNS * k / MOVES), 0.0), normal_force=0.5)
    await display.lift()


async def _blocks_while(display: AsyncDisplay, work: Awaitable[None]) -> Floats:
    """Return how many blocks were played meanwhile, and how many of them were late or skipped.

    The display is armed again if the amplifier gave it up, as it does if the machine stands still.
    """
    deadline = time.monotonic() + PATIENCE
    while (await display.stats(timeout=PATIENCE)).state != "armed":
        if time.monotonic() > deadline:
            raise TimeoutError(f"the display could not be armed within {PATIENCE:g} s")
        with suppress(ClientError):  # as long as the link is lost
            await display.arm(timeout=PATIENCE)
        await asyncio.sleep(POLL)
    before = (await display.stats(timeout=PATIENCE)).counters
    await work
    after = (await display.stats(timeout=PATIENCE)).counters
    names = ("blocks", "late_blocks", "skipped_samples")
    blocks, late, skipped = (after[name] - before[name] for name in names)
    return np.array([blocks, late + skipped / BLOCK])


# Frames, processor time and size


async def _one_window(server: ServerProcess) -> list[Figure]:
    """Return what one page loads, how fast it draws, and what it costs the server."""
    async with (
        aio.connect(server.url, display=NAME, timeout=PATIENCE) as display,
        chromium() as browser,
    ):
        await display.arm(timeout=PATIENCE)
        loads = []
        for _ in range(LOADS):
            async with window_of(browser, page_of(server)) as window:
                loads.append(await window.loaded())
        without, _ = await share_of_core(server.pid, asyncio.sleep(SECONDS))
        async with window_of(browser, page_of(server)) as window:
            await window.choose(TEXTURE)
            work = asyncio.gather(window.stroke(SECONDS), window.frames_per_second())
            beside, (_, frames) = await share_of_core(server.pid, work)
    sizes, paints = zip(*loads, strict=True)
    return [
        at_least("page.frames_per_second", frames, "1/s", 55),
        at_most("page.server_share", beside - without, "% of a core", 15),
        at_most("page.transferred", max(sizes), "kB", 250),
        at_most("page.first_paint", statistics.median(paints), "ms", 1000),
    ]


# The client in node


def client_figures() -> Iterator[Figure]:
    """Yield how many contacts per second the client sends, and what is lost of them.

    The server admits the most messages that its configuration allows.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        simulated_server("messages_per_second = 100000") as server,
    ):
        shutil.copytree(FOLDER / "client", Path(folder) / "client")
        (Path(folder) / "package.json").write_text('{"type": "module"}')
        words = [folder, str(WS), server.url, str(CONTACTS), str(CONTACTS_SECONDS)]
        printed = subprocess.run(
            ["node", "--input-type=module", "-e", SEND, *words],
            check=True, stdout=subprocess.PIPE, timeout=PATIENCE,
        )  # fmt: skip
        counted: dict[str, Any] = json.loads(printed.stdout)
        arrived = _contacts_of(server)
    lost = counted["sent"] - counted["dropped"] - arrived
    yield Figure("page.client.contacts", arrived / counted["seconds"], "1/s")
    yield at_most("page.client.lost", lost, "contacts", 0)
    yield at_most("page.client.dropped", float(counted["dropped"]), "contacts", 0)


def _contacts_of(server: ServerProcess) -> float:
    """Return the number of contacts that a server has handled."""
    with urllib.request.urlopen(f"{page_of(server)}metrics", timeout=PATIENCE) as response:
        lines = response.read().decode().splitlines()
    name = 'tactile_messages_total{transport="websocket",type="contact"} '
    return sum(float(line.removeprefix(name)) for line in lines if line.startswith(name))
