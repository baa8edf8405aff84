"""The page with the C amplifier on a pty: what is put out is in the amplifier's own record.

How soon a pointer is felt is measured by ``python -m benchmarks page``; here, times are printed and
decide nothing.
"""

import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browser_rig import Visitor, browsing, visiting

from benchmarks.server import OutputRecorder, ServerProcess, last_after
from benchmarks.virtual import VirtualAmplifier

if TYPE_CHECKING:
    from playwright.async_api import Browser

pytestmark = pytest.mark.realtime

QUIET = 0.5
"""Length of the amplifier's record that must hold nothing but 0 V [s]."""


@pytest.fixture
def amplifier(tmp_path: Path, virtual_amplifier: Path) -> Iterator[VirtualAmplifier]:
    if sys.platform != "linux":
        pytest.skip("needs Linux")
    (tmp_path / "build").symlink_to(virtual_amplifier.parent)
    with closing(VirtualAmplifier(tmp_path, "--pty")) as amplifier:
        yield amplifier


@pytest.fixture
def server(tmp_path: Path, amplifier: VirtualAmplifier) -> Iterator[ServerProcess]:
    with closing(ServerProcess(tmp_path, str(amplifier.path))) as server:
        yield server


@pytest.fixture(scope="module")
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


async def stroke_until_it_is_loud(visitor: Visitor, recorder: OutputRecorder) -> None:
    """Arm as a person does, and stroke oak until the amplifier puts something out."""
    await visitor.choose("wood-oak")
    await visitor.arm()
    mouse = visitor.page.mouse
    await mouse.move(*await visitor.point(0.2, 0.5))
    await mouse.down()
    for k in range(100_000):
        await mouse.move(*await visitor.point(0.2 + 0.6 * abs((k / 40) % 2 - 1), 0.5))
        if recorder.read().is_loud.any():
            return
    raise AssertionError("nothing was put out")


@pytest.mark.parametrize("way", ["button", "escape", "disarm", "lift", "closed window"])
async def test_a_stroke_is_put_out_and_each_way_to_end_it_is_0_volts(
    browser: "Browser", amplifier: VirtualAmplifier, server: ServerProcess, way: str
) -> None:
    recorder = OutputRecorder(amplifier)
    async with visiting(browser, f"http://127.0.0.1:{server.port}/") as visitor:
        await stroke_until_it_is_loud(visitor, recorder)
        ended = time.monotonic()
        match way:
            case "escape":
                await visitor.page.keyboard.press("Escape")
            case "lift":
                await visitor.page.mouse.up()
            case "closed window":
                await visitor.page.close()
            case _:  # the finger stays on the pad: a mouse has one pointer
                await visitor.page.evaluate(
                    "name => document.querySelector(`[data-testid=${name}]`).click()",
                    "estop" if way == "button" else way,
                )
        output = recorder.read_until(
            lambda output: output.reaches(ended + 1.0) and not output.since(
                output.times[-1] - QUIET
            ).is_loud.any(),
            "it is silent",
        )  # fmt: skip
        after = 1e3 * last_after(output.times, output.is_loud, ended)
        print(f"\n{way}: 0 V after {after:.0f} ms")
