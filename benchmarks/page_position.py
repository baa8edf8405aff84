"""Position that is played while a pointer strokes over the page, in the amplifier's own record.

A grating of one wavelength is stroked with the mouse and with a finger on the screen, to and fro,
with a constant speed between the turns. Two contactors a quarter of a wavelength apart get, at each
instant, the real and the imaginary part of a phasor whose phase is the position of the finger on
the grating. This analytic signal needs no filter, goes through turns, and knows nothing of the
renderer. What the inverse of the display's response adds is a constant phase at a constant speed;
in strokes to and fro it counts as latency, of which it takes off 0.2 ms.

The page itself logs the time stamp and the place of each pointer event. The latency of a stroke is
the median of its offset in time where the speed is constant, and the error is what remains: the
position that is played less that of the pointer so many milliseconds before.

The time stamps are those at which the pointer was moved, as the driver of a mouse gives them,
however much later the browser hands the event over. The mouse of a screen without scaling is at
whole pixels; that of the third strokes is so too, and is compared with what it is rounded from.
"""

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.page import MOVES, PageWindow, chromium, no_browser, window_of
from benchmarks.server import NAME, PATIENCE, amplifier_and_folder
from benchmarks.virtual import NO_AMPLIFIER, Records, can_be_built
from firmware_protocol.messages import State
from tactile import files
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_most, beside_machine, not_measured
from tactile.display.display import load_display
from tactile.server import preparation_queue, preparing
from tactile.server.children import Child
from tactile.server.config import Configuration, DisplayConfig, ServerConfig
from tactile.server.server import running

if TYPE_CHECKING:
    from playwright.async_api import CDPSession

WAVELENGTH = 20e-3
"""Wavelength of the grating [m]: half of it is what a finger of 200 mm/s moves in 50 ms."""
PAIR = (0, 2)
"""Contactors of the reference display that are a quarter of it apart along x."""
FILE = "TACTILE_BENCHMARK_GRATING"
"""Environment variable with the path of the texture's file."""
GRATING = "page-grating"
"""Name of the texture."""
TEXTURE = """[texture]
id = "{}"
category = "test"
description = "A sinusoidal grating across x"
provenance = "authored"
source = "The benchmark of positions"
license = "CC0-1.0"
[reference]
speed_mm_s = 100.0
normal_force_n = 0.5
[[periodic]]
wavelength_mm = {:g}
harmonics_um = [5.0]
"""
"""Texture file."""
SPEEDS = (0.05, 0.1, 0.2)
"""Speeds of the strokes [m/s]."""
POINTERS = ("mouse", "touch", "whole_pixels")
"""Kinds of pointers."""
SECONDS = 8.0
"""Duration of the motion of a stroke [s]."""
REST = 0.5
"""Duration of the finger's rest before and after the motion [s]."""
TURN = 0.1
"""Duration of a turn [s]."""
SPAN = 0.8
"""Distance between the turns, as a share of the pad's width."""
SETTLED = 0.15
"""Time after a turn, and before one, that the steady part of a stroke leaves out [s]: a tracker has
to learn that the finger does not accelerate any more."""
PAUSE = 0.5
"""Time that arming may take before it is tried again [s]."""
STRAIGHT = 0.97
"""Share of the way at full speed that the pointer makes at least in `SETTLED` before and after."""
CLOCK = 3.0
"""Time from the first touch on in which the server may still learn how late the page's messages
are [s]: the window of its clock map, and 20 ms at the rate at which that moves."""
GOAL, JUDGED = 0.3, 200.0
"""Largest error [mm], and the speed for which it is the goal [mm/s]."""
PIXEL = 25.4e-3 / 96
"""Length of a CSS pixel, by definition [m]."""
FAINT = 0.5
"""Magnitude of the phasor, relative to its median, below which the position is not known."""
LOG = """() => {
  globalThis.logged = [];
  const log = event => {
    const { left } = document.querySelector("[data-testid=pad]").getBoundingClientRect();
    const coalesced = event.getCoalescedEvents?.() ?? [];
    for (const { timeStamp, clientX } of coalesced.length ? coalesced : [event]) {
      logged.push([timeStamp, clientX - left, performance.now()]);
    }
  };
  for (const kind of ["pointerdown", "pointerrawupdate"]) addEventListener(kind, log, true);
}"""
"""JavaScript that logs the pointer events of the page: their time stamps [ms], their distances from
the pad's left edge [CSS px], and when they were handled [ms]."""
ARM = """() => {
  for (const name of ["arm", "arm-confirm"]) {
    document.querySelector(`[data-testid=${name}]`).click();
  }
}"""
"""JavaScript that arms the display while the pointer stays on the pad."""
BROWSE = "from benchmarks.page_position import browse; browse({!r}, {!r}, {!r})"
"""Code of the process with the browser."""


# The pointer


class WantedStroke(NamedTuple):
    """A stroke that is wanted.

    Attributes
    ----------
    pointer : str
        One of `POINTERS`.
    speed : float
        Speed between the turns [m/s].
    seconds : float
        Duration of the motion [s].
    """

    pointer: str
    speed: float
    seconds: float = SECONDS


def to_and_fro(speed: float, span: float, times: Floats) -> Floats:
    """Return a path that begins with a rest and turns smoothly.

    Parameters
    ----------
    speed : float
        Speed between the turns [m/s].
    span : float
        Distance between the turns [m].
    times : (K,) array of float
        Times after the beginning of the motion [s].

    Returns
    -------
    (K,) array of float
        Distances from the beginning of the path [m].
    """
    half = span / speed + TURN  # with half a turn at each end
    grid = np.arange(0, max(float(times.max()), 0.0) + 1e-3, 1e-4)
    from_turn = np.minimum(grid % half, half - grid % half)
    ramp = np.sin(np.pi / 2 * np.minimum(from_turn / (TURN / 2), 1))
    velocity = speed * ramp * (1 - 2 * (np.floor(grid / half) % 2))
    places = np.concatenate([[0.0], np.cumsum(velocity[:-1]) * 1e-4])
    return np.asarray(np.interp(times, grid, places))


class Pointer:
    """A mouse, or a finger on the screen, that the browser is told of as by a driver.

    Parameters
    ----------
    browser : playwright.async_api.CDPSession
        Connection to the browser's own protocol.
    kind : str
        One of `POINTERS`.
    path : callable
        Function from a time on the monotonic clock [s] to a place in the window [CSS px].
    y : float
        Height in the window [CSS px].

    Attributes
    ----------
    moved : list of (float, float)
        Times on the monotonic clock [s], and places before they were rounded [CSS px].
    """

    def __init__(
        self, browser: "CDPSession", kind: str, path: Callable[[float], float], y: float
    ) -> None:
        self._browser, self._kind, self._path, self._y = browser, kind, path, y
        self.moved: list[tuple[float, float]] = []

    async def down(self) -> None:
        """Touch at the present place of the path."""
        await self._send("mousePressed", "touchStart")

    async def move(self) -> None:
        """Move to the present place of the path."""
        await self._send("mouseMoved", "touchMove")

    async def up(self) -> None:
        """Lift at the present place of the path."""
        await self._send("mouseReleased", "touchEnd")

    async def _send(self, mouse: str, touch: str) -> None:
        now, stamp = time.monotonic(), time.time()
        x = self._path(now)
        self.moved.append((now, x))
        if self._kind == "touch":
            points = [] if touch == "touchEnd" else [{"x": x, "y": self._y, "force": 0.5}]
            event: dict[str, Any] = {"type": touch, "touchPoints": points, "timestamp": stamp}
            await self._browser.send("Input.dispatchTouchEvent", event)
            return
        x = round(x) if self._kind == "whole_pixels" else x
        event = {"type": mouse, "x": x, "y": self._y, "timestamp": stamp}
        event |= {"button": "left", "buttons": 1, "clickCount": int(mouse != "mouseMoved")}
        await self._browser.send("Input.dispatchMouseEvent", event)


async def arm_again(window: PageWindow) -> None:
    """Arm the display unless it is armed: it is not after the machine stood still.

    Parameters
    ----------
    window : PageWindow
        Window of the page.

    Raises
    ------
    TimeoutError
        If the page does not say in time that it is armed.
    """
    shown = window.page.get_by_test_id("state")
    async with asyncio.timeout(PATIENCE):
        while (state := await shown.get_attribute("data-state")) != "armed":
            if state == "disarmed":
                await window.page.evaluate(ARM)
            await asyncio.sleep(PAUSE)


async def stroke(window: PageWindow, wanted: WantedStroke) -> dict[str, Floats]:
    """Stroke over the pad to and fro.

    Parameters
    ----------
    window : PageWindow
        Window of the page, which logs its pointer events.
    wanted : WantedStroke
        How to stroke.

    Returns
    -------
    dict of str to array of float
        What the page logged, where the pointer was moved, both relative to the pad [CSS px], and
        from when to when it rested after that [s].
    """
    page = window.page
    box = await page.get_by_test_id("pad").bounding_box()
    assert box is not None
    left = box["x"] + (1 - SPAN) / 2 * box["width"]
    begun = time.monotonic() + 2 * REST
    grid = np.arange(0, wanted.seconds + 0.1, 1e-3)
    grown = left + to_and_fro(wanted.speed, SPAN * box["width"] * PIXEL, grid) / PIXEL

    def path(now: float) -> float:
        return float(np.interp(min(now - begun, wanted.seconds), grid, grown))

    browser, y = await page.context.new_cdp_session(page), round(box["y"] + box["height"] / 2)
    pointer = Pointer(browser, wanted.pointer, path, y)
    await page.evaluate("() => { logged.length = 0 }")
    await pointer.down()
    async with asyncio.TaskGroup() as moves:
        for due in begun + np.arange(-REST, wanted.seconds + REST, 1 / MOVES):
            await asyncio.sleep(max(due - time.monotonic(), 0))
            moves.create_task(pointer.move())
    await arm_again(window)
    rested = [time.monotonic()]  # the page has handled all moves
    await asyncio.sleep(REST)
    rested.append(time.monotonic())
    await pointer.up()
    logged = np.array(await page.evaluate("() => logged"))
    moved = np.array(pointer.moved[:-1]) - [0.0, box["x"]]
    return {"logged": logged, "moved": moved, "rested": np.array(rested)}


def browse(url: str, file: str, wanted: list[tuple[str, float, float]]) -> None:
    """Stroke with the page of the server, and store what the page logged.

    Parameters
    ----------
    url : str
        URL of the page.
    file : str
        Path of the file to store to.
    wanted : list of (str, float, float)
        Fields of each `WantedStroke`.
    """
    asyncio.run(_browse(url, file, [WantedStroke(*each) for each in wanted]))


async def _browse(url: str, file: str, wanted: list[WantedStroke]) -> None:
    stored: dict[str, Any] = {}
    async with chromium() as browser, window_of(browser, url) as window:
        await window.page.evaluate(LOG)
        await window.choose(GRATING)
        await arm_again(window)
        clocks = [await window.clock()]
        for k, each in enumerate(wanted):
            for name, array in (await stroke(window, each)).items():
                stored[f"{name}{k}"] = array
        clocks.append(await window.clock())
    np.savez(file, clock=min(clocks, key=lambda clock: clock[1]), **stored)


# The display


def textures_with(grating: Path) -> Callable[[str], dict[str, Path]]:
    """Return `files.shipped_names` with the grating among the textures.

    Parameters
    ----------
    grating : Path
        Path of the texture's file.

    Returns
    -------
    callable
        Function that returns the paths of a kind of files by name.
    """
    shipped = files.shipped_names

    def names(kind: str) -> dict[str, Path]:
        return shipped(kind) | ({GRATING: grating} if kind == "textures" else {})

    return names


@contextmanager
def grating_offered(folder: Path) -> Iterator[None]:
    """Let servers of this process offer the grating beside the shipped textures.

    Parameters
    ----------
    folder : Path
        Folder for the texture's file.

    Yields
    ------
    None
        While it is offered.
    """
    path = folder / f"{GRATING}.toml"
    path.write_text(TEXTURE.format(GRATING, 1e3 * WAVELENGTH))
    with (
        patch.object(files, "shipped_names", textures_with(path)),
        patch.object(preparation_queue, "Child", partial(preparing_child, Child)),
        patch.dict(os.environ, {FILE: str(path)}),
    ):
        yield


def preparing_child(child: type[Child], module: str, *rest: Any) -> Child:
    """Start `main` in place of the process that prepares textures.

    Parameters
    ----------
    child : type of Child
        Class of the process.
    module : str
        Module that would be started.
    *rest : object
        Other arguments of the class.

    Returns
    -------
    Child
        Process that was started.
    """
    assert module == preparing.__name__
    return child(__name__, *rest)


def main() -> None:
    """Prepare textures as the server orders on standard input, among them the grating."""
    setattr(files, "shipped_names", textures_with(Path(os.environ[FILE])))  # noqa: B010
    preparing.main()


async def _play(device: str, file: Path, wanted: Sequence[WantedStroke]) -> None:
    """Run a server while a process with a browser strokes on its page."""
    display = DisplayConfig(name=NAME, device=device, levels="file", rearm=True)
    config = Configuration(server=ServerConfig(port=0, socket=""), display=(display,))
    async with running(config) as server:
        code = BROWSE.format(server.page, str(file), [tuple(each) for each in wanted])
        browser = await asyncio.create_subprocess_exec(sys.executable, "-c", code)
        try:
            if await browser.wait():
                raise subprocess.CalledProcessError(browser.returncode or 1, "browser")
        finally:
            if browser.returncode is None:
                browser.kill()
                await browser.wait()


# The record


class PlayedPosition(NamedTuple):
    """Position of the finger that the amplifier put out, while it played.

    Attributes
    ----------
    times : (K,) array of float
        Times on the monotonic clock [s].
    places : (K,) array of float
        Positions, known but for a multiple of `WAVELENGTH` [m].
    """

    times: Floats
    places: Floats


def played_position(record: Iterable[Records], powered_up: float) -> PlayedPosition:
    """Compute the position from the drive of the contactors of `PAIR`.

    Parameters
    ----------
    record : iterable of Records
        Record of an amplifier, in parts.
    powered_up : float
        Time on the monotonic clock at which the clock of the record was 0 [s].

    Returns
    -------
    PlayedPosition
        Position wherever the drive is that of a finger on the grating.
    """
    display, number, pair = load_display("reference-24"), 2 * np.pi / WAVELENGTH, list(PAIR)
    turns = np.exp(-1j * number * display.contactors[pair, 0])
    parts = [(np.zeros(0), np.zeros(0, complex))]
    for records in record:
        playing = records.state == State.RUNNING
        codes = records.codes[playing][:, display.channel[pair]].astype(np.float64)
        times = powered_up + records.tick[playing].astype(np.float64) * 1e-6
        parts.append((times, codes @ turns))
    times, phasor = (np.concatenate(column) for column in zip(*parts, strict=True))
    size = np.abs(phasor)
    known = size > FAINT * np.median(size[size > 0]) if size.any() else size > 0
    return PlayedPosition(times[known], np.angle(phasor[known]) / number)


class PointerStroke(NamedTuple):
    """A stroke that the page was given.

    Attributes
    ----------
    wanted : WantedStroke
        How it was to be.
    times, places : (K,) array of float
        Times on the monotonic clock [s] and places of the pointer on the pad [m].
    handed_over : (E,) array of float
        Time from the time stamp of each event to its handling by the page [s].
    rested : (2,) array of float
        Time from which on the page had handled all events, and that at which the pointer was
        lifted [s].
    """

    wanted: WantedStroke
    times: Floats
    places: Floats
    handed_over: Floats
    rested: Floats

    def at(self, times: Floats) -> Floats:
        """Return where the pointer was at given times (S,) [s] as an array (S,) [m]."""
        return np.asarray(np.interp(times, self.times, self.places))


def strokes_of(file: Path, wanted: Sequence[WantedStroke]) -> list[PointerStroke]:
    """Read the strokes that `browse` stored.

    Parameters
    ----------
    file : Path
        Path of the file.
    wanted : sequence of WantedStroke
        How each stroke was to be.

    Returns
    -------
    list of PointerStroke
        The strokes.
    """
    stored, strokes = np.load(file), []
    for k, each in enumerate(wanted):
        stamped, place, handled = stored[f"logged{k}"].T
        stamped, first = np.unique(stamped, return_index=True)
        times, places = 1e-3 * stamped + stored["clock"][0], place[first] * PIXEL
        if each.pointer == "whole_pixels":
            times, places = stored[f"moved{k}"].T * [[1.0], [PIXEL]]
        handed_over = 1e-3 * (handled[first] - stamped)
        strokes.append(PointerStroke(each, times, places, handed_over, stored[f"rested{k}"]))
    return strokes


class StrokeErrors(NamedTuple):
    """Errors of the position that is played, relative to that of the pointer.

    Attributes
    ----------
    latency : float
        Median of the offset in time [s].
    steady : (K,) array of float
        Errors after this latency, where the speed is constant [m].
    settled : (L,) array of float
        Those of them that are later than `CLOCK` [m].
    resting : (K,) array of float
        Errors while the finger rests at the end [m].
    unknown : float
        Share of the time in which the position is not known.
    """

    latency: float
    steady: Floats
    settled: Floats
    resting: Floats
    unknown: float


def errors_of(stroke: PointerStroke, played: PlayedPosition) -> StrokeErrors:
    """Compare what was played with a stroke.

    Parameters
    ----------
    stroke : PointerStroke
        Stroke of the pointer.
    played : PlayedPosition
        Position that was played.

    Returns
    -------
    StrokeErrors
        Errors; those of a part that was not played are empty arrays. Without a steady part in both
        directions, latency and errors are NaN.
    """
    begun, ended = stroke.times[0] + REST, stroke.rested[1]
    inside = (played.times > begun) & (played.times < ended)
    times = played.times[inside]
    apart = _folded(played.places[inside] - stroke.at(times))
    along = stroke.at(times + SETTLED) - stroke.at(times - SETTLED)
    straight = np.abs(along) > STRAIGHT * 2 * SETTLED * stroke.wanted.speed
    ways = [apart[straight & (sign * along > 0)] * sign for sign in (1, -1)]
    ahead = np.mean([np.median(way) for way in ways]) if all(map(len, ways)) else np.nan
    latency = -float(ahead) / stroke.wanted.speed
    behind = _folded(apart + stroke.at(times) - stroke.at(times - latency))
    resting = times > ended - REST / 2
    settled = straight & (times > stroke.times[0] + CLOCK)
    unknown = 1 - len(times) / ((ended - begun) * RATE)
    return StrokeErrors(latency, behind[straight], behind[settled], apart[resting], unknown)


def _folded(places: Floats) -> Floats:
    """Return differences of places (K,) to within half a wavelength around 0 [m]."""
    return np.asarray((places + WAVELENGTH / 2) % WAVELENGTH - WAVELENGTH / 2)


# What is measured


def measure_page_position() -> Iterator[Figure]:
    """Measure the position that is played while a pointer strokes over the page."""
    yield from beside_machine("page_position", position_figures())


def position_figures() -> Iterator[Figure]:
    """Yield the errors of each kind of pointer at each speed, or what is missing."""
    why = no_browser() or ("" if can_be_built() else NO_AMPLIFIER)
    if why:
        yield not_measured("page_position", why)
        return
    wanted = [WantedStroke(pointer, speed) for pointer in POINTERS for speed in SPEEDS]
    for stroke, errors in strokes_played(wanted):
        yield from _stroke_figures(stroke, errors)


def strokes_played(wanted: Sequence[WantedStroke]) -> list[tuple[PointerStroke, StrokeErrors]]:
    """Stroke over the page of a server that plays on the C amplifier.

    Parameters
    ----------
    wanted : sequence of WantedStroke
        Strokes, one after the other.

    Returns
    -------
    list of (PointerStroke, StrokeErrors)
        Each stroke, and by what the position that was played differs.
    """
    with amplifier_and_folder() as (amplifier, folder), grating_offered(folder):
        file = folder / "strokes.npz"
        asyncio.run(_play(f"serial://{amplifier.path}", file, wanted))
        time.sleep(0.1)  # until the amplifier has written its record
        played = played_position(amplifier.chunks(), amplifier.powered_up)
        return [(each, errors_of(each, played)) for each in strokes_of(file, wanted)]


def _stroke_figures(stroke: PointerStroke, errors: StrokeErrors) -> Iterator[Figure]:
    speed = 1e3 * stroke.wanted.speed
    name = f"page_position.{stroke.wanted.pointer}.{speed:g}_mm_s"
    yield Figure(f"{name}.events", float(len(stroke.handed_over)), "")
    for part in (50, 99):
        handed_over = 1e3 * float(np.percentile(stroke.handed_over, part))
        yield Figure(f"{name}.handed_over.p{part}", handed_over, "ms")
    yield Figure(f"{name}.unknown", 100 * errors.unknown, "%")
    if len(errors.resting):
        yield Figure(f"{name}.resting", 1e3 * float(np.abs(errors.resting).max()), "mm")
    if not np.isfinite(errors.latency):
        yield not_measured(f"{name}.rms", "the display did not play while the speed was constant")
        return
    yield Figure(f"{name}.latency", 1e3 * errors.latency, "ms")
    goal = GOAL if speed == JUDGED else None
    for part_name, distances in ((name, errors.steady), (f"{name}.settled", errors.settled)):
        if len(distances):
            yield from _size_figures(part_name, 1e3 * np.abs(distances), goal)


def _size_figures(name: str, distances: Floats, goal: float | None) -> Iterator[Figure]:
    """Yield rms, 95th percentile and maximum of distances [mm], and how long they were seen."""
    yield Figure(f"{name}.seconds", len(distances) / RATE, "s")
    yield Figure(f"{name}.rms", float(np.sqrt(np.mean(distances**2))), "mm")
    yield at_most(f"{name}.p95", float(np.percentile(distances, 95)), "mm", goal)
    yield Figure(f"{name}.most", float(distances.max()), "mm")
