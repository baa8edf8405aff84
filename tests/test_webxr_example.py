"""The WebXR example in Chromium, worn with an emulated headset, and what the server gets of it.

The emulator iwer replaces the headset: its controllers and hands are put to places, and everything
behind `navigator.xr` follows. Nothing here depends on how many frames are drawn: each place is held
until the server has it.
"""

import asyncio
import hashlib
import math
import re
import sys
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from browser_rig import PATIENCE_S, browsing
from node_rig import miss
from PIL import Image
from server_rig import Hands, serving, until
from test_page import Daemon, contacts

from tactile.client import Telemetry, aio
from tactile.files import shipped
from tactile.messages import ArmDisplay, Command, DisarmDisplay, EStop, Select

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page, ViewportSize

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("patient")]

PROJECT = Path(__file__).parents[1]
EXAMPLE = PROJECT / "examples" / "webxr"
BESIDE = Path(sys.prefix).parent
"""Folder of the environment, in which npm puts its packages."""
IWER = BESIDE / "node_modules" / "iwer" / "build" / "iwer.min.js"
"""Emulator of WebXR, one file that needs no other."""
DIGEST = "23d8640949f19db4b1e70398b30e084e4aa555f3a81e4329da3fac1a70b39542"
"""SHA-256 of that file in iwer 2.5.0."""
CENTER_M, TILT = (0.0, 1.1, -0.45), math.radians(30)
"""Pose of the board as in the README: center [m], and angle by which it is tilted back [rad]."""
AHEAD_MS = 25
"""Time by which the emulated headset predicts a pose [ms], as long as in real ones (assumed)."""
VIEWPORT: "ViewportSize" = {"width": 480, "height": 320}
"""Size of the window [CSS px], which the emulator draws: small, as no graphics card does it."""
EMULATION = """
window.device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.position.set(0, 1.4, 0);
device.quaternion.set(-0.26, 0, 0, 0.97);  // looks down at the board
for (const inputs of [device.controllers, device.hands]) inputs.left.connected = false;
window.predicted_us = [];
const frameTime = Object.getOwnPropertyDescriptor(XRFrame.prototype, "predictedDisplayTime").get;
Object.defineProperty(XRFrame.prototype, "predictedDisplayTime", { get() {
  const time = frameTime.call(this) + AHEAD_MS;
  predicted_us.push(Math.round(1000 * time));
  return time;
} });
""".replace("AHEAD_MS", str(AHEAD_MS))
"""JavaScript that replaces `navigator.xr`. The emulator predicts nothing by itself."""
TIP_OF_HAND = """async () => {
  const session = device.activeSession, { hand } = device.hands.right.inputSource;
  const floor = await session.requestReferenceSpace("local-floor");
  return new Promise((done) => session.requestAnimationFrame((_, frame) => {
    const { transform, radius } = frame.getJointPose(hand.get("index-finger-tip"), floor);
    const { x, y, z } = transform.position, wrist = device.hands.right.position;
    done([x - wrist.x, y - wrist.y, z - wrist.z, radius]);
  }));
}"""
"""JavaScript that returns where a fingertip is in a hand, and its radius [m]."""
SHOWS = """text => {
  const shown = document.getElementById("status").textContent;
  return [shown, ...shown.split(/[,:;] /)].some(part => part.startsWith(text));
}"""
"""JavaScript that returns whether the status on the page, or a part of it, begins with a text."""
PUT = "([kind, point]) => device[kind].right.position.set(...point)"
"""JavaScript that puts an input to a point [m]."""
HIDE = """() => {
  const prototype = XRSession.prototype, request = prototype.requestAnimationFrame, waiting = [];
  prototype.requestAnimationFrame = (callback) => waiting.push(callback);
  window.reveal = () => {
    prototype.requestAnimationFrame = request;
    device.updateVisibilityState("visible");
    for (const callback of waiting) device.activeSession.requestAnimationFrame(callback);
  };
  return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {
    device.updateVisibilityState("hidden");
    done();
  })));
}"""
"""JavaScript that hides a session, which then has no frames; by itself the emulator goes on."""
SQUEEZE = "() => device.controllers.right.updateButtonValue('squeeze', 1)"
"""JavaScript that squeezes the grip of a controller."""
SECOND = """() => {
  const { left, right } = device.controllers;
  left.position.copy(right.position);
  left.position.x = -0.1;
  left.connected = true;
}"""
"""JavaScript that puts the other controller to the left of the first one."""
GRAY, RED, YELLOW = (0x37, 0x47, 0x4F), (0xB0, 0x00, 0x20), (255, 204, 0)
"""Colors of a board that is disarmed, of one without a server, and of a finger that touches."""
FEW_PIXELS = 8
"""Number of pixels of a color that must be seen; a fingertip has some 20."""
PATH = [(-210.0, 40.0, 2.0), (-190.0, 35.0, 4.0), (-170.0, -20.0, 6.0), (-165.0, -90.0, 9.0)]
"""Places on the board [mm] with the depth of the finger in it [mm]."""


@pytest.fixture(scope="module")
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


@pytest.fixture(scope="module")
def emulator() -> Path:
    """Return the emulator, after its content was compared."""
    if not IWER.exists():
        miss(f"needs iwer: npm install --no-save --ignore-scripts --prefix {BESIDE} iwer@2.5.0")
    assert hashlib.sha256(IWER.read_bytes()).hexdigest() == DIGEST, f"{IWER} is not iwer 2.5.0"
    return IWER


class QuietFiles(SimpleHTTPRequestHandler):
    """What ``python -m http.server`` serves, without its log."""

    def log_request(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def origin() -> Iterator[str]:
    """Yield the origin at which the checkout is served, as the README says."""
    handler = partial(QuietFiles, directory=str(PROJECT))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as files:
        threading.Thread(target=files.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{files.server_address[1]}"
        files.shutdown()


class Headset:
    """The example in a window of a browser, and the emulated headset that shows it."""

    def __init__(self, page: "Page") -> None:
        self.page = page
        self.mistakes: list[str] = []
        self._kind, self._tip, self._radius = "controllers", (0.0, 0.0, 0.0), 0.0
        page.on("pageerror", lambda error: self.mistakes.append(str(error)))
        page.on("console", lambda m: self.mistakes.append(m.text) if m.type == "error" else None)

    async def arm(self) -> None:
        """Press the button until the display is armed, as it is disarmed if it is held up."""
        async with asyncio.timeout(PATIENCE_S):
            while "armed" not in (await self.page.inner_text("#status")).split(", ")[0].split():
                await self.page.evaluate("() => document.getElementById('arm').click()")
                await asyncio.sleep(0.1)

    async def shows(self, text: str) -> None:
        """Wait until the status on the page, or a part of it, begins with a text."""
        await self.page.wait_for_function(SHOWS, arg=text)

    async def enter(self, mode: str = "immersive-vr") -> None:
        """Press the button that begins a session, and wait for a frame of it."""
        await self.shows("disarmed")
        await self.page.click(f"#{mode}:not([disabled])")
        await self.page.wait_for_function("() => device.activeSession && predicted_us.length > 0")

    async def use_hand(self) -> None:
        """Lay the controller down, so that the hand is tracked."""
        await self.page.evaluate("() => { device.primaryInputMode = 'hand' }")
        *tip, radius = await self.page.evaluate(TIP_OF_HAND)
        assert radius > 0.002
        self._kind, self._tip, self._radius = "hands", (tip[0], tip[1], tip[2]), radius

    async def put(self, x: float, y: float, depth: float) -> None:
        """Put the fingertip to a place on the board, with its skin at a depth in the board [mm]."""
        out = self._radius - depth / 1000
        up, sine, cosine = y / 1000, math.sin(TILT), math.cos(TILT)
        place = (x / 1000, up * cosine + out * sine, out * cosine - up * sine)
        point = [c + p - t for c, p, t in zip(CENTER_M, place, self._tip, strict=True)]
        await self.page.evaluate(PUT, [self._kind, point])

    async def lose(self) -> None:
        """Take the controller or the hand out of the sight of the cameras."""
        await self.page.evaluate("kind => { device[kind].right.connected = false }", self._kind)

    async def sees(self, color: tuple[int, int, int]) -> None:
        """Wait until a color is in what the headset shows."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                picture = Image.open(BytesIO(await self.page.screenshot())).convert("RGB")
                differences = np.abs(np.asarray(picture, np.int64) - color).max(axis=2)
                if np.count_nonzero(differences <= 3) >= FEW_PIXELS:
                    return

    async def end(self) -> None:
        """End the session, as the person does in the headset's menu."""
        await self.page.evaluate("() => device.activeSession.end()")


@asynccontextmanager
async def wearing(
    browser: "Browser", emulator: Path, origin: str, server: str
) -> AsyncIterator[Headset]:
    """Open the example in a browser that has a headset."""
    context = await browser.new_context(viewport=VIEWPORT)
    context.set_default_timeout(PATIENCE_S * 1e3)
    try:
        page = await context.new_page()
        await page.add_init_script(path=emulator)
        await page.add_init_script(EMULATION)
        headset = Headset(page)
        await page.goto(f"{origin}/examples/webxr/?server={server}")
        yield headset
    finally:
        await context.close()


Worn = tuple[Headset, Hands]
"""Headset in which the session has begun, and what the server got."""


@pytest.fixture
async def worn(browser: "Browser", emulator: Path, origin: str) -> AsyncIterator[Worn]:
    """Yield a headset that shows the board, and a server that notes what it gets."""
    async with (
        serving(origins=(origin,)) as (there, hands),
        wearing(browser, emulator, origin, there.url) as headset,
    ):
        await headset.enter()
        yield headset, hands
        assert headset.mistakes == []


@asynccontextmanager
async def playing(folder: Path, origin: str) -> AsyncIterator[Daemon]:
    """Run `tactile serve` with a simulated display, which admits the page."""
    running = Daemon(folder, "right")
    text = running.config.read_text()
    running.config.write_text(text.replace("[server]", f'[server]\norigins = ["{origin}"]'))
    await running.start()
    try:
        yield running
    finally:
        await running.kill()


def socket_of(daemon: Daemon) -> str:
    """Return the address of a daemon's WebSocket for pages."""
    return daemon.page.replace("http:", "ws:") + "v1"


def commands(hands: Hands, kind: type[Command]) -> list[Any]:
    """Return the commands of a kind that the server got."""
    return [command for _, command in hands.log if isinstance(command, kind)]


def times_us(hands: Hands) -> list[int]:
    """Return the times of all contacts [µs]."""
    return [contact.time_us or 0 for contact in contacts(hands)]


async def touch(headset: Headset, hands: Hands, x: float, y: float, depth: float) -> None:
    """Put the fingertip to a place on the board, and wait until the server has it."""
    await headset.put(x, y, depth)
    here = pytest.approx((x, y), abs=0.01)
    await until(lambda: bool(contacts(hands)) and contacts(hands)[-1].position_mm == here)


async def lifted(hands: Hands) -> None:
    """Wait until the finger was lifted, where it was and not before its last contact."""
    await until(lambda: contacts(hands)[-1].normal_force_n == 0)
    before, last = contacts(hands)[-2:]
    assert before.normal_force_n > 0
    assert last.position_mm == before.position_mm
    assert times_us(hands)[-1] > times_us(hands)[-2]


# Touching


@pytest.mark.parametrize(
    ("mode", "with_hand"),
    [("immersive-vr", False), ("immersive-ar", False), ("immersive-vr", True)],
)
async def test_a_path_is_played_in_its_order_with_the_force_of_its_depth(
    browser: "Browser", emulator: Path, origin: str, mode: str, with_hand: bool
) -> None:
    """Compare all contacts with the places of a controller and of a hand; no touch arms."""
    async with (
        serving(origins=(origin,)) as (there, hands),
        wearing(browser, emulator, origin, there.url) as headset,
    ):
        await headset.enter(mode)
        if with_hand:
            await headset.use_hand()
        for place in PATH:
            await touch(headset, hands, *place)
        await headset.put(*PATH[-1][:2], -20.0)
        await lifted(hands)
        played = [(*c.position_mm, c.normal_force_n) for c in contacts(hands)[:-1]]
        places = [place for place, _ in groupby(played)]
        assert places == [pytest.approx((x, y, 0.1 * depth), abs=0.01) for x, y, depth in PATH]
        assert commands(hands, ArmDisplay) == []
        assert headset.mistakes == []


async def test_contact_begins_one_millimeter_deep_and_ends_at_the_surface(worn: Worn) -> None:
    """Press a finger in and out slowly: what trembles at the surface must not flicker."""
    headset, hands = worn
    for k, depth in enumerate((0.5, 0.9, 1.1, 0.5, 0.1, -0.1, 0.9, 1.2)):
        await headset.put(-200.0, k, depth)
        await headset.page.evaluate(
            "() => new Promise(done => device.activeSession.requestAnimationFrame(done))"
        )
    await until(lambda: bool(contacts(hands)) and contacts(hands)[-1].position_mm[1] > 6.5)
    played = [(round(c.position_mm[1]), c.normal_force_n) for c in contacts(hands)]
    expected = [(2, 0.11), (3, 0.05), (4, 0.01), (4, 0.0), (7, 0.12)]
    places = [place for place, _ in groupby(played)]
    assert places == [pytest.approx(one, abs=1e-4) for one in expected]


async def test_the_force_is_limited_and_nothing_behind_the_board_touches(worn: Worn) -> None:
    """Press far into the board, and through it."""
    headset, hands = worn
    await touch(headset, hands, -200.0, 0.0, 30.0)
    assert contacts(hands)[-1].normal_force_n == pytest.approx(1.0)
    await headset.put(-200.0, 0.0, 51.0)
    await lifted(hands)


async def test_a_contact_has_the_time_for_which_its_pose_was_predicted(worn: Worn) -> None:
    """Compare the times of the contacts with those of the headset's frames."""
    headset, hands = worn
    for place in PATH:
        await touch(headset, hands, *place)
    times = times_us(hands)
    assert set(times) <= set(await headset.page.evaluate("predicted_us"))
    assert times == sorted(times)


async def test_a_second_finger_waits_until_the_first_is_lifted(worn: Worn) -> None:
    """Touch with both controllers: the display has one finger, which must not jump between them."""
    headset, hands = worn
    await touch(headset, hands, 100.0, 0.0, 5.0)
    await headset.page.evaluate(SECOND)
    await touch(headset, hands, 120.0, 0.0, 5.0)
    assert min(contact.position_mm[0] for contact in contacts(hands)) > 0
    await headset.put(120.0, 0.0, -20.0)
    await until(lambda: contacts(hands)[-1].position_mm[0] < 0)
    assert 0.0 in [contact.normal_force_n for contact in contacts(hands)]


async def test_touching_a_tile_selects_its_texture(worn: Worn) -> None:
    """Cross an edge, tremble on it, and go on: each texture is selected once."""
    headset, hands = worn
    for x in (-249.0, -151.0, -148.0, -152.0, -148.0, -140.0, -148.0, 0.0, 249.0):
        await touch(headset, hands, x, 0.0, 5.0)
    names = ["wood-oak", "textile-corduroy", "metal-knurled-rge08", "stone-granite-flamed"]
    await until(lambda: len(commands(hands, Select)) >= len(names))
    assert [select.layers[0].texture for select in commands(hands, Select)] == names


async def test_the_board_shows_the_state_and_the_finger(worn: Worn) -> None:
    """Look at what the headset shows: the color of the state, and a finger that touches."""
    headset, hands = worn
    await headset.sees(GRAY)
    await touch(headset, hands, 0.0, 0.0, 5.0)
    await headset.sees(YELLOW)


def test_all_tiles_are_textures_of_the_server() -> None:
    """Compare the names of the tiles with the textures that come with tactile."""
    names = re.findall(r'texture: "([^"]+)"', (EXAMPLE / "board.js").read_text())
    assert len(set(names)) == 5
    assert set(names) <= {path.stem for path in shipped("textures").rglob("*.toml")}


# Lifting


@pytest.mark.parametrize(("x", "y"), [(-251.0, 0.0), (-200.0, 101.0), (-200.0, -101.0)])
async def test_a_finger_beside_the_board_is_lifted(worn: Worn, x: float, y: float) -> None:
    """Leave the tiles by each edge, still deep enough to touch."""
    headset, hands = worn
    await touch(headset, hands, -240.0, 0.0, 5.0)
    await headset.put(x, y, 5.0)
    await lifted(hands)
    await headset.shows("lifted")


@pytest.mark.parametrize("with_hand", [False, True])
async def test_a_controller_or_a_hand_that_is_lost_is_lifted(worn: Worn, with_hand: bool) -> None:
    """Lose what touches, in the middle of the board."""
    headset, hands = worn
    if with_hand:
        await headset.use_hand()
    await touch(headset, hands, -200.0, 0.0, 5.0)
    await headset.lose()
    await lifted(hands)
    await headset.shows("no hand or controller is tracked")


async def test_a_session_that_is_hidden_is_lifted(worn: Worn) -> None:
    """Open the headset's menu, under which there are no frames, and close it again."""
    headset, hands = worn
    await touch(headset, hands, -200.0, 0.0, 5.0)
    await headset.page.evaluate(HIDE)
    await lifted(hands)
    await headset.shows("paused")
    await headset.page.evaluate("() => reveal()")
    await touch(headset, hands, -190.0, 0.0, 5.0)


async def test_the_end_of_a_session_lifts_and_disarms(worn: Worn) -> None:
    """End a session, whose last contacts are ahead of now, and begin another."""
    headset, hands = worn
    await touch(headset, hands, -200.0, 0.0, 5.0)
    await headset.end()
    await lifted(hands)
    await until(lambda: len(commands(hands, DisarmDisplay)) == 1)
    await headset.enter()
    await touch(headset, hands, -190.0, 0.0, 5.0)


# Stopping


@pytest.mark.parametrize("way", ["button", "escape", "squeeze", "pinch"])
async def test_an_estop_is_always_in_reach(worn: Worn, way: str) -> None:
    """Touch, and stop in each way that the page names."""
    headset, hands = worn
    if way == "pinch":
        await headset.use_hand()
    await touch(headset, hands, -200.0, 0.0, 5.0)
    assert commands(hands, EStop) == []
    if way == "button":  # which the emulator covers with what the headset shows
        await headset.page.evaluate("() => document.getElementById('estop').click()")
    elif way == "escape":
        await headset.page.keyboard.press("Escape")
    elif way == "squeeze":
        await headset.page.evaluate(SQUEEZE)
    else:
        await headset.page.evaluate("() => device.hands.right.updatePinchValue(1)")
    await until(lambda: len(commands(hands, EStop)) == 1)


async def test_a_trigger_is_no_estop(worn: Worn) -> None:
    """Pull the trigger of a controller, which must not be taken for a pinch."""
    headset, hands = worn
    for value in (1, 0):
        await headset.page.evaluate(
            "value => device.controllers.right.updateButtonValue('trigger', value)", value
        )
        await touch(headset, hands, -200.0, float(value), 5.0)
    assert commands(hands, EStop) == []


# A display that plays


async def shown(display: aio.AsyncDisplay, condition: Callable[[Telemetry], bool]) -> None:
    """Wait until the telemetry of a display is as it should be.

    A display that is held up is disarmed, and then armed again.
    """
    async with asyncio.timeout(PATIENCE_S):
        async for item in display.telemetry(rate=60, timeout=PATIENCE_S):
            if condition(item):
                return
            if item.state == "disarmed":
                await display.arm()


def at(x: float, y: float, depth: float) -> Callable[[Telemetry], bool]:
    """Return the condition that a finger is at a place [mm] with the force of its depth [mm]."""
    expected = pytest.approx((x / 1000, y / 1000, 0.1 * depth), abs=1e-4)
    return lambda item: (*item.position, item.normal_force) == expected


@pytest.mark.realtime  # high voltage ends if the programs are held up
async def test_the_display_plays_where_and_how_hard_the_finger_is(
    browser: "Browser", emulator: Path, origin: str, tmp_path: Path
) -> None:
    """Follow playback of the simulated display along the path, and to the lift at its end."""
    async with (
        playing(tmp_path, origin) as daemon,
        wearing(browser, emulator, origin, socket_of(daemon)) as headset,
        aio.connect(daemon.url) as display,
    ):
        await headset.enter()
        for x, y, depth in PATH:
            await headset.put(x, y, depth)
            await shown(display, at(x, y, depth))
        await headset.lose()
        await shown(display, lambda item: item.state == "armed" and item.normal_force == 0)
        assert headset.mistakes == []


@pytest.mark.realtime  # high voltage ends if the browser is held up
async def test_a_stroke_drives_the_display_until_a_squeeze_stops_it(
    browser: "Browser", emulator: Path, origin: str, tmp_path: Path
) -> None:
    """Arm by the button, stroke oak, squeeze, and clear; the drive is that of the display."""
    async with (
        playing(tmp_path, origin) as daemon,
        wearing(browser, emulator, origin, socket_of(daemon)) as headset,
        aio.connect(daemon.url) as display,
    ):
        await headset.shows("disarmed")
        await headset.arm()
        await headset.page.click("#immersive-vr")
        strongest, k = 0.0, 0
        stream = display.telemetry(rate=60, timeout=PATIENCE_S)
        async with asyncio.timeout(PATIENCE_S):
            while strongest < 1.0:
                k += 1
                await headset.put(-240.0 + 80.0 * abs((k / 40) % 2 - 1), 0.0, 5.0)
                item = await anext(stream)
                if item.state == "disarmed":  # because it was held up
                    await display.arm()
                strongest = max(strongest, *map(abs, item.drive))
        await headset.page.evaluate(SQUEEZE)
        await shown(display, lambda item: item.state == "estopped" and not any(item.drive))
        await headset.shows("estopped")
        await headset.end()
        await headset.page.click("#clear")
        await headset.shows("disarmed")


@pytest.mark.realtime  # high voltage ends if the programs are held up
async def test_a_server_that_goes_is_shown_and_comes_back_disarmed(
    browser: "Browser", emulator: Path, origin: str, tmp_path: Path
) -> None:
    """Kill the server while a finger touches: the board says so, and nothing arms it afterwards."""
    async with (
        playing(tmp_path, origin) as daemon,
        wearing(browser, emulator, origin, socket_of(daemon)) as headset,
    ):
        await headset.shows("disarmed")
        await headset.arm()
        await headset.page.click("#immersive-vr")
        await headset.put(-200.0, 0.0, 5.0)
        await headset.shows("on wood-oak")
        await daemon.kill()
        await headset.shows("no server")
        await headset.sees(RED)
        await daemon.start()
        await headset.shows("disarmed, on wood-oak")
        async with aio.connect(daemon.url) as display:
            assert (await display.stats()).state == "disarmed"
            await shown(display, at(-200.0, 0.0, 5.0))


async def test_a_page_that_the_server_does_not_name_is_not_admitted(
    browser: "Browser", emulator: Path, origin: str
) -> None:
    """Leave the page's origin out of the configuration: the page names what is missing."""
    async with (
        serving() as (there, hands),
        wearing(browser, emulator, origin, there.url) as headset,
    ):
        await headset.shows(f'is {origin} among its "origins"?')
        await until(lambda: any("403" in text for text in headset.mistakes))
        assert hands.clients == []
