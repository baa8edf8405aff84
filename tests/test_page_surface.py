"""The surfaces on the page: beneath the pad, in the list of textures, and side by side."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from browser_rig import browsing, visiting
from numpy.typing import NDArray
from server_rig import Hands, serving, until
from test_page import daemon

from tactile.messages import Command, Contact, DrawTexture, Select, TextureInfo, Textures
from tactile.rendering.surface_picture import SurfaceSection, draw_surface
from tactile.texture.surface import load_texture

if TYPE_CHECKING:
    from playwright.async_api import Browser

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("patient")]

MM_PER_PIXEL = 25.4 / 96
"""Length of a CSS pixel, by definition [mm]."""
DARKEST, LIGHTEST = 176, 250
"""Grays of the lowest and highest displacement on a light page."""
OAK, TOWEL, LEATHER = "wood-oak", "textile-towel", "leather-calf"
DRAWN = """canvas => {
  const { width, height } = canvas;
  const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
  return { width, height, gray: [...data].filter((_, k) => k % 4 === 0) };
}"""
"""JavaScript that returns the red of all pixels of a canvas."""
SHOWS = """names => {
  const canvas = document.querySelector("[data-testid=pad-surface]");
  return canvas.dataset.textures === names;
}"""
"""JavaScript that returns whether the pad shows the surfaces of textures."""


@pytest.fixture(scope="module")
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


async def grays(canvas: Any) -> NDArray[np.int64]:
    """Return the gray of each pixel of a canvas, rows from the top."""
    drawn = await canvas.evaluate(DRAWN)
    return np.array(drawn["gray"]).reshape(drawn["height"], drawn["width"])


def expected(texture: str, section: SurfaceSection) -> NDArray[np.float64]:
    """Return the gray that each pixel of a picture must have."""
    pixels = draw_surface(load_texture(texture), section).pixels
    return DARKEST + (LIGHTEST - DARKEST) * (pixels / 255)


async def test_the_selected_surface_is_beneath_the_pad_where_the_finger_meets_it(
    browser: "Browser", tmp_path: Path
) -> None:
    """Draw the surface again with the function of Python, from the lower left of the pad."""
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.choose(OAK)
        await visitor.page.wait_for_function(SHOWS, arg=OAK)
        drawn = await grays(visitor.at("pad-surface"))
        rows, columns = drawn.shape
        section = SurfaceSection(0.0, 0.0, MM_PER_PIXEL * 1e-3, columns, rows)
        np.testing.assert_allclose(drawn, expected(OAK, section), atol=1)
        scale = await visitor.at("pad-surface-scale").inner_text()
        picture = draw_surface(load_texture(OAK), section)
        assert f"light {picture.highest * 1e6:.1f} µm" in scale
        assert visitor.mistakes == []


async def test_each_half_shows_its_own_surface(browser: "Browser", tmp_path: Path) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        await visitor.choose(OAK)
        await visitor.at("beside").select_option(TOWEL)
        await visitor.page.wait_for_function(SHOWS, arg=f"{OAK} {TOWEL}")
        drawn = await grays(visitor.at("pad-surface"))
        rows, columns = drawn.shape
        half = columns // 2
        section = SurfaceSection(0.0, 0.0, MM_PER_PIXEL * 1e-3, columns, rows)
        left, right = expected(OAK, section), expected(TOWEL, section)
        beside = slice(half + 4, columns)
        np.testing.assert_allclose(left[:, : half - 4], drawn[:, : half - 4], atol=6)
        # the scale of a half is that of its own pixels
        assert np.corrcoef(drawn[:, beside].ravel(), right[:, beside].ravel())[0, 1] > 0.98
        await visitor.at("beside").select_option("")
        await visitor.page.wait_for_function(SHOWS, arg=OAK)
        assert visitor.mistakes == []


async def test_small_pictures_are_drawn_as_the_list_is_scrolled(
    browser: "Browser", tmp_path: Path
) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        for name in ("abrasive-p80", "wood-spruce-sawn"):  # near the beginning, and at the end
            row = visitor.page.locator(f'[data-testid=texture][data-name="{name}"]')
            await row.scroll_into_view_if_needed()
            thumbnail = row.locator("canvas[data-drawn]")
            await thumbnail.wait_for()
            drawn = await grays(thumbnail)
            section = SurfaceSection(-6e-3, -6e-3, 0.25e-3, 48, 48)
            np.testing.assert_allclose(drawn, expected(name, section), atol=1)
        drawn_number = await visitor.page.locator("canvas[data-drawn]").count()
        assert drawn_number < await visitor.at("texture").count()  # none that nobody has seen
        assert visitor.mistakes == []


async def test_the_address_selects_a_texture(browser: "Browser", tmp_path: Path) -> None:
    async with (
        daemon(tmp_path) as there,
        visiting(browser, f"{there.page}#texture={TOWEL}") as visitor,
    ):
        await visitor.page.wait_for_function(SHOWS, arg=TOWEL)
        assert TOWEL in await visitor.at("selected").inner_text()


# With a host that notes what the page sends


class ThreeTextureHands(Hands):
    """A host with three textures."""

    def connect(self, name: str, **options: Any) -> Any:
        hand = super().connect(name, **options)
        reply = hand._reply

        def answer(command: Command) -> Any:
            answered = reply(command)
            if not isinstance(answered, Textures):
                return answered
            infos = (
                TextureInfo(name=name, category="", description="", provenance="authored")
                for name in (OAK, TOWEL, LEATHER)
            )
            return Textures(textures=tuple(infos))

        hand._reply = answer  # type: ignore[method-assign]
        return hand

    @property
    def gains(self) -> list[dict[str, float]]:
        """Gain of each texture, by each selection."""
        selections = [command for _, command in self.log if isinstance(command, Select)]
        return [{layer.texture: layer.gain for layer in each.layers} for each in selections]

    @property
    def contacts(self) -> int:
        """Number of contacts that the page sent."""
        return sum(isinstance(command, Contact) for _, command in self.log)


async def test_a_finger_that_crosses_the_middle_meets_the_other_texture(
    browser: "Browser",
) -> None:
    """Both stay ready: one of them has the gain 0."""
    hands = ThreeTextureHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await visitor.choose(OAK)
        await visitor.at("beside").select_option(TOWEL)
        await until(lambda: len(hands.gains) == 2)
        assert hands.gains == [{OAK: 1.0}, {OAK: 1.0, TOWEL: 0.0}]
        mouse = visitor.page.mouse
        await mouse.move(*await visitor.point(0.3, 0.5))
        await mouse.down()
        await until(lambda: hands.contacts > 0)
        await mouse.move(*await visitor.point(0.45, 0.5))
        await mouse.move(*await visitor.point(0.55, 0.5))
        await until(lambda: len(hands.gains) == 3)
        await mouse.move(*await visitor.point(0.7, 0.5))
        await mouse.move(*await visitor.point(0.2, 0.5))
        await until(lambda: len(hands.gains) == 4)
        await mouse.up()
        assert hands.gains[2:] == [{OAK: 0.0, TOWEL: 1.0}, {OAK: 1.0, TOWEL: 0.0}]
        assert visitor.mistakes == []


async def test_a_display_that_is_shown_again_plays_the_half_that_the_finger_was_in(
    browser: "Browser",
) -> None:
    """Cross the middle on another display meanwhile."""
    hands = ThreeTextureHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        choice = visitor.page.locator("#display-choice")
        for display in ("right", "left"):
            await choice.select_option(display)
            await visitor.choose(OAK)
            await visitor.at("beside").select_option(TOWEL)
            await until(lambda: hands.gains[-1:] == [{OAK: 1.0, TOWEL: 0.0}])
        await visitor.page.mouse.move(*await visitor.point(0.3, 0.5))
        await visitor.page.mouse.down()
        await visitor.page.mouse.move(*await visitor.point(0.8, 0.5))
        await until(lambda: hands.gains[-1] == {OAK: 0.0, TOWEL: 1.0})
        await visitor.page.mouse.up()
        before = len(hands.gains)
        await choice.select_option("right")
        await until(lambda: len(hands.gains) > before)
        selected = [command for _, command in hands.log if isinstance(command, Select)]
        assert (selected[-1].display, hands.gains[-1]) == ("right", {OAK: 0.0, TOWEL: 1.0})


async def test_a_choice_is_kept_although_the_finger_crosses_while_it_is_prepared(
    browser: "Browser",
) -> None:
    hands = ThreeTextureHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await visitor.choose(OAK)
        hands.gate.clear()  # selections wait, as if textures were being prepared
        await visitor.at("beside").select_option(TOWEL)
        await visitor.page.locator(f'[data-testid=texture][data-name="{LEATHER}"]').click()
        await visitor.page.mouse.move(*await visitor.point(0.3, 0.5))
        await visitor.page.mouse.down()
        await visitor.page.mouse.move(*await visitor.point(0.8, 0.5))
        await until(lambda: hands.contacts > 1)
        hands.gate.set()
        await until(lambda: hands.gains[-1:] == [{LEATHER: 0.0, TOWEL: 1.0}])
        await visitor.page.mouse.up()


async def test_a_texture_that_fails_leaves_the_halves_as_they_were(browser: "Browser") -> None:
    hands = ThreeTextureHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await visitor.choose(OAK)
        hands.codes[Select] = "unavailable"
        await visitor.at("beside").select_option(TOWEL)
        problem = visitor.page.locator("#select-problem")
        await problem.wait_for()
        assert f"“{TOWEL}” cannot be played" in await problem.inner_text()
        assert await visitor.at("beside").input_value() == ""
        assert await visitor.at("selected").inner_text() == f"Selected: {OAK}"
        del hands.codes[Select]
        await visitor.choose(LEATHER)
        assert hands.gains[-1] == {LEATHER: 1.0}


async def test_a_surface_that_cannot_be_drawn_is_a_sentence(browser: "Browser") -> None:
    hands = ThreeTextureHands()
    hands.codes[DrawTexture] = "unavailable"
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await visitor.choose(OAK)
        scale = visitor.at("pad-surface-scale")
        await scale.filter(has_text="could not be drawn").wait_for()
        mouse = visitor.page.mouse
        await mouse.move(*await visitor.point(0.3, 0.5))
        await mouse.down()
        await until(lambda: hands.contacts > 0)  # it is stroked all the same
        await mouse.up()
        assert visitor.mistakes == []
