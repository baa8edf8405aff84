"""The page in a browser: a person looks, strokes, arms and stops; what goes wrong is a sentence.

The server is a process of its own with the simulated display. Nothing here says how soon anything
happens: each step waits until the page shows what it must show.
"""

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from socket import SOCK_STREAM
from typing import TYPE_CHECKING, Any

import pytest
from browser_rig import PATIENCE_S, browsing, visiting
from server_rig import Hands, free_port, serving, until

from tactile.client import aio
from tactile.messages import (
    Command,
    Contact,
    EStop,
    EventMessage,
    Select,
    TextureInfo,
    Textures,
)
from tactile.server.config import TokenConfig
from tactile.server.page import FOLDER

if TYPE_CHECKING:
    from playwright.async_api import Browser

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("patient")]

LARGEST_PAGE = 250_000
"""Maximum size of all that a browser loads of the page [bytes]."""


@pytest.fixture(scope="module")
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


class Daemon:
    """The server as a process of its own, with displays of the simulator."""

    def __init__(self, folder: Path, *names: str) -> None:
        self.config = folder / "tactile.toml"
        tables = "".join(f'[[display]]\nname = "{n}"\ndevice = "sim:"\n' for n in names)
        socket = folder / "socket"
        port = free_port(SOCK_STREAM)
        head = f'[server]\nport = {port}\nsocket = "{socket}"\n[osc]\nport = 0\n'
        self.config.write_text(head + tables)
        self.url = f"ws+unix://{socket}"
        self.page = ""

    async def start(self) -> None:
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "tactile", "serve", "--config", str(self.config),
            stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        assert self._process.stdout is not None
        line = await asyncio.wait_for(self._process.stdout.readline(), PATIENCE_S)
        self.page = next(word for word in line.decode().split() if word.startswith("http:"))

    async def kill(self) -> None:
        self._process.kill()
        await self._process.wait()


@asynccontextmanager
async def daemon(folder: Path, *names: str) -> AsyncIterator[Daemon]:
    running = Daemon(folder, *(names or ("right",)))
    await running.start()
    try:
        yield running
    finally:
        await running.kill()


async def test_the_page_shows_the_display_and_loads_nothing_from_elsewhere(
    browser: "Browser", tmp_path: Path
) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.state("disarmed")
        await visitor.at("texture").first.wait_for()
        assert await visitor.at("texture").count() >= 50
        assert all(url.startswith((there.page, "data:", "blob:")) for url in visitor.requests)
        assert visitor.mistakes == []


def test_the_page_is_small() -> None:
    sizes = {file: file.stat().st_size for file in FOLDER.rglob("*") if file.is_file()}
    assert sum(sizes.values()) <= LARGEST_PAGE, sizes


@pytest.mark.realtime  # high voltage ends if the browser is held up
async def test_a_stroke_with_the_mouse_plays_the_texture_that_was_chosen(
    browser: "Browser", tmp_path: Path
) -> None:
    """Watch with the SDK what the display is commanded: not with the page itself."""
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.at("search").fill("oak")
        await visitor.choose("wood-oak")
        await visitor.arm()
        strongest, speeds = 0.0, 0.0
        async with aio.connect(there.url) as watching:

            async def watch() -> None:
                nonlocal strongest, speeds
                async for told in watching.telemetry(rate=60):
                    strongest = max(strongest, *map(abs, told.drive))
                    speeds = max(speeds, abs(told.velocity[0]))

            task = asyncio.create_task(watch())
            mouse = visitor.page.mouse
            await mouse.move(*await visitor.point(0.2, 0.5))
            await mouse.down()
            k = 0
            async with asyncio.timeout(PATIENCE_S):
                while strongest < 1.0 or speeds < 0.01:
                    k += 1
                    share = 0.2 + 0.6 * abs((k / 40) % 2 - 1)
                    await mouse.move(*await visitor.point(share, 0.5))
            await mouse.up()
            task.cancel()
        assert visitor.mistakes == []


async def test_touch_strokes_and_lifts(browser: "Browser", tmp_path: Path) -> None:
    async with serving() as (there, hands), visiting(browser, there.page, has_touch=True) as v:
        x, y = await v.point(0.5, 0.5)
        await v.page.touchscreen.tap(x, y)
        await until(lambda: any(contact.normal_force_n == 0 for contact in contacts(hands)))
        first, last = contacts(hands)[0], contacts(hands)[-1]
        assert first.normal_force_n > 0
        assert last.normal_force_n == 0
        assert v.mistakes == []


def contacts(hands: Hands) -> list[Contact]:
    return [command for _, command in hands.log if isinstance(command, Contact)]


async def test_a_pixel_is_the_millimeter_that_css_says(browser: "Browser", tmp_path: Path) -> None:
    """Positions of contacts are those of the pointer, with y upwards from the lower left corner."""
    async with serving() as (there, hands), visiting(browser, there.page) as visitor:
        box = await visitor.at("pad").bounding_box()
        assert box is not None
        x, y = box["x"] + 100, box["y"] + box["height"] - 60
        await visitor.page.mouse.move(x, y)
        await visitor.page.mouse.down()
        await until(lambda: bool(contacts(hands)))
        await visitor.page.mouse.up()
        await until(lambda: contacts(hands)[-1].normal_force_n == 0)
        mm = 25.4 / 96
        assert contacts(hands)[0].position_mm == pytest.approx((100 * mm, 60 * mm), abs=2 * mm)
        assert contacts(hands)[0].normal_force_n == pytest.approx(0.5)  # of a mouse


async def test_a_finger_that_rests_is_repeated_until_it_is_lifted(
    browser: "Browser", tmp_path: Path
) -> None:
    """Send what the server needs to not take it for lifted."""
    async with serving() as (there, hands), visiting(browser, there.page) as visitor:
        await visitor.page.mouse.move(*await visitor.point(0.5, 0.5))
        await visitor.page.mouse.down()
        await until(lambda: len(contacts(hands)) >= 5)
        assert len({contact.position_mm for contact in contacts(hands)}) == 1
        await visitor.page.mouse.up()
        await until(lambda: contacts(hands)[-1].normal_force_n == 0)


async def test_the_keyboard_does_all_that_a_mouse_does(browser: "Browser", tmp_path: Path) -> None:
    async with serving() as (there, hands), visiting(browser, there.page) as visitor:
        await visitor.at("pad").focus()
        await visitor.page.keyboard.down("ArrowRight")
        await until(lambda: len(contacts(hands)) >= 5)
        await visitor.page.keyboard.up("ArrowRight")
        moving = [c for c in contacts(hands) if c.normal_force_n > 0]
        assert moving[-1].position_mm[0] > moving[0].position_mm[0]
        assert moving[-1].position_mm[1] == moving[0].position_mm[1]
        await visitor.page.keyboard.press("Escape")
        await until(lambda: any(isinstance(command, EStop) for _, command in hands.log))


@pytest.mark.realtime  # high voltage ends if the browser is held up
async def test_arming_takes_two_steps_and_disarming_one(browser: "Browser", tmp_path: Path) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.at("arm").click()
        await visitor.at("arm-cancel").click()
        await visitor.state("disarmed")
        await visitor.at("arm").click()
        await visitor.at("arm-confirm").click()
        await visitor.state("armed")
        await visitor.at("disarm").click()
        await visitor.state("disarmed")
        assert visitor.mistakes == []


@pytest.mark.parametrize(
    "way",
    [
        pytest.param("button", marks=pytest.mark.realtime),  # as high voltage ends if the browser
        pytest.param("escape", marks=pytest.mark.realtime),  # is held up
        "escape in the dialog",
        "button in the dialog",
    ],
)
async def test_the_estop_is_always_in_reach(browser: "Browser", tmp_path: Path, way: str) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.arm() if "dialog" not in way else await visitor.at("arm").click()
        if "button" in way:
            await visitor.at("estop").click()
        else:
            await visitor.page.keyboard.press("Escape")
        await visitor.state("estopped")
        async with aio.connect(there.url, timeout=PATIENCE_S) as program:
            assert (await program.stats()).state == "estopped"
        await visitor.at("clear").click()
        await visitor.at("clear-confirm").click()
        await visitor.state("disarmed")


@pytest.mark.realtime  # high voltage ends if the browser is held up
async def test_a_server_that_dies_is_reported_and_comes_back_disarmed(
    browser: "Browser", tmp_path: Path
) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.choose("wood-oak")
        await visitor.arm()
        await there.kill()
        await visitor.state("offline")
        assert "disarmed" in await visitor.at("banner").inner_text()
        await there.start()
        await visitor.state("disarmed")
        await visitor.page.wait_for_selector("[data-testid=banner]", state="hidden")
        assert "wood-oak" in await visitor.at("selected").inner_text()


async def test_an_estop_without_a_server_is_not_confirmed_and_then_sent(
    browser: "Browser", tmp_path: Path
) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await there.kill()
        await visitor.state("offline")
        await visitor.page.keyboard.press("Escape")
        await visitor.page.get_by_text("could not be confirmed").first.wait_for()
        await there.start()
        await visitor.state("estopped")


@pytest.mark.realtime  # high voltage ends if the browser is held up
async def test_two_pages_and_a_program_see_the_same(browser: "Browser", tmp_path: Path) -> None:
    async with (
        daemon(tmp_path) as there,
        visiting(browser, there.page) as one,
        visiting(browser, there.page) as other,
        aio.connect(there.url, timeout=PATIENCE_S) as program,
    ):
        await one.arm()
        await other.state("armed")
        assert (await program.stats()).state == "armed"
        await program.estop()
        await one.state("estopped")
        await other.state("estopped")
        await other.at("clear").click()
        await other.at("clear-confirm").click()
        await one.state("disarmed")


@pytest.mark.realtime  # high voltage ends if the browser is held up
async def test_another_display_can_be_chosen(browser: "Browser", tmp_path: Path) -> None:
    async with (
        daemon(tmp_path, "right", "left") as there,
        visiting(browser, there.page) as visitor,
        aio.connect(there.url, display="left") as left,
    ):
        await visitor.page.get_by_role("combobox", name="Display").select_option("left")
        await visitor.arm()
        assert (await left.stats()).state == "armed"


# Who may do what


async def test_a_token_is_asked_for(browser: "Browser", tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text("correct horse battery staple\n")
    path.chmod(0o600)
    table = TokenConfig(file=str(path), roles=("watch", "play"))
    async with (
        serving(token=(table,)) as (there, hands),
        visiting(browser, there.page, connected=False) as visitor,
    ):
        await visitor.at("token").fill("wrong")
        await visitor.at("token-send").click()
        await visitor.page.get_by_text("wrong token").first.wait_for()
        await visitor.at("token").fill("correct horse battery staple")
        await visitor.at("token-send").click()
        await visitor.state("disarmed")
        assert hands.clients[-1].roles == {"watch", "play"}
        assert await visitor.at("arm").is_disabled()
        assert "correct horse" not in await visitor.page.evaluate(
            "JSON.stringify([{...localStorage}, {...sessionStorage}, document.cookie])"
        )


INTRUDER = """<!doctype html><script>
const socket = new WebSocket("URL", "tactile.v1.json");
socket.onopen = () => document.title = "in"; socket.onerror = () => document.title = "out";
</script><iframe src="PAGE"></iframe>"""


async def test_a_page_of_another_origin_gets_neither_in_nor_over_the_page(
    browser: "Browser", tmp_path: Path
) -> None:
    """Lay an invisible frame over the button that arms, and connect from a page of another port."""

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        body = INTRUDER.replace("URL", there.url).replace("PAGE", there.page).encode()
        head = f"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: {len(body)}\r\n\r\n"
        writer.write(head.encode() + body)
        await writer.drain()
        writer.close()

    async with serving() as (there, hands):
        intruder = await asyncio.start_server(answer, "127.0.0.1", 0)
        port = intruder.sockets[0].getsockname()[1]
        async with intruder, visiting(browser, f"http://127.0.0.1:{port}/", connected=False) as v:
            await v.page.wait_for_function("document.title !== ''")
            assert await v.page.title() == "out"
            await until(lambda: any("frame" in text or "403" in text for text in v.mistakes))
            frame = v.page.frames[1]
            assert await frame.locator("[data-testid=arm]").count() == 0
        assert hands.clients == []


# What goes wrong

MARKUP = "<img src=x onerror=\"document.title='pwned'\"><script>document.title='pwned'</script>"


class HostileHands(Hands):
    """A host whose textures, events and failures hold markup."""

    def connect(self, name: str, **options: Any) -> Any:
        hand = super().connect(name, **options)
        reply = hand._reply

        def hostile(command: Command) -> Any:
            answer = reply(command)
            if not isinstance(answer, Textures):
                return answer
            info = TextureInfo(
                name="wood-oak", category=MARKUP, description=MARKUP, provenance=MARKUP
            )
            return Textures(textures=(info,))

        hand._reply = hostile  # type: ignore[method-assign]
        event = EventMessage(display="right", kind="fault", detail=MARKUP)
        hand.outbox.put_nowait(event)
        return hand


async def test_markup_in_names_is_text(browser: "Browser", tmp_path: Path) -> None:
    async with (
        serving(hands=HostileHands()) as (there, _),
        visiting(browser, there.page) as visitor,
    ):
        await visitor.at("texture").first.wait_for()
        await visitor.page.get_by_text("onerror=").first.wait_for()
        assert await visitor.page.locator("img[src=x]").count() == 0
        assert await visitor.page.title() != "pwned"
        assert visitor.mistakes == []


async def test_a_texture_that_fails_to_load_is_a_sentence(
    browser: "Browser", tmp_path: Path
) -> None:
    async with serving() as (there, hands), visiting(browser, there.page) as visitor:
        hands.codes[Select] = "unavailable"
        await visitor.at("texture").first.click()
        await visitor.page.get_by_text("as told").first.wait_for()
        assert visitor.mistakes == []


# Everywhere


@pytest.mark.parametrize("size", [(320, 640), (768, 1024), (1280, 800), (3840, 2160)])
async def test_nothing_is_cut_off_at_any_width(
    browser: "Browser", tmp_path: Path, size: tuple[int, int]
) -> None:
    viewport = {"width": size[0], "height": size[1]}
    async with serving() as (there, _), visiting(browser, there.page, viewport=viewport) as v:
        await v.at("texture").first.wait_for()
        widths = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
        content, window = await v.page.evaluate(widths)
        assert content <= window
        assert await v.at("estop").is_visible()
        box = await v.at("estop").bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 44  # WCAG 2.5.5
        await v.page.evaluate("scrollTo(0, document.body.scrollHeight)")
        after = await v.at("estop").bounding_box()
        assert after is not None
        assert 0 <= after["y"] <= size[1] - after["height"]
