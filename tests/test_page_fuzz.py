"""The page on a server that sends mutated messages: nothing is thrown, and all comes back.

What decides is what the server receives and what the page shows. `benchmarks.page_fuzz` does the
same for ten minutes, and measures the memory.
"""

import random
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import test_page_contactor
from browser_rig import browsing
from test_page_contactor import Modules

from benchmarks import LONG, page_fuzz
from benchmarks.hostile_server import mutated, unasked
from benchmarks.page_fuzz import fuzzed_page

if TYPE_CHECKING:
    from playwright.async_api import Browser

pytestmark = pytest.mark.ci

BATCHES = 50
"""Number of batches for each seed; with three seeds, there are 3000 messages."""
LISTED = "() => document.querySelectorAll('[data-testid=texture]').length === 4"
"""JavaScript that returns whether the page has the correct list of textures."""
COUNTED = "() => document.querySelector('[data-testid=blocks]').textContent === '4,711'"
"""JavaScript that returns whether the page has the correct counters."""
SPECTRUM = """() => /^Strongest: \\d+ dB above/.test(
  document.querySelector('[data-testid=spectrum-summary]').textContent)"""
"""JavaScript that returns whether the spectrum is one of numbers."""
SCALE = """() => /^\\d{1,3} µm are drawn as 1 mm/.test(
  document.getElementById("array-scale").textContent)"""
"""JavaScript that returns whether the scale of shears is one that a display may have."""


@pytest.fixture(scope="module")
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


@pytest.mark.parametrize("seed", [1, 2, 3])
async def test_a_page_outlasts_a_server_that_sends_nonsense(browser: "Browser", seed: int) -> None:
    """Press the e-stop while nonsense comes, and clear it when correct messages come again."""
    async with fuzzed_page(browser, seed) as fuzzed:
        server, page = fuzzed.server, fuzzed.window.page
        taken = await fuzzed.fuzz(BATCHES)
        await page.get_by_test_id("estop").click()
        await server.requested("estop")
        await fuzzed.fuzz(1, BATCHES)
        assert server.connections > 1
        print(
            f"\n{server.sent} messages, {taken} of whole batches, {server.connections} connections"
        )
        await fuzzed.show("estopped")
        await page.get_by_test_id("clear").click()
        await page.get_by_test_id("clear-confirm").click()
        await server.requested("clear")
        await page.wait_for_selector('[data-testid=state][data-state="disarmed"]')
        await fuzzed.show("armed")
        for number, condition in enumerate((SPECTRUM, SCALE, COUNTED, LISTED)):
            await fuzzed.send_until(condition, f"calm {number};", "textures")
        await fuzzed.show("disarmed")
        await page.wait_for_selector("[data-testid=banner]", state="hidden")
        assert await fuzzed.is_untouched()
        assert fuzzed.faults == []


def test_without_a_browser_the_benchmark_says_what_is_needed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Find it among the long benchmarks, with a reason in place of its figures."""
    assert LONG["page-fuzz"] is page_fuzz.measure_page_fuzz
    monkeypatch.setattr(page_fuzz, "no_browser", lambda: "needs chromium")
    (figure,) = page_fuzz.measure_page_fuzz()
    assert (figure.name, figure.reason) == ("page-fuzz", "needs chromium")


def test_a_seed_makes_the_same_messages() -> None:
    """Mutate with two generators of one seed, and find most messages changed."""
    one, other = random.Random(5), random.Random(5)
    made = [[mutated(rng, unasked(rng, 3)) for _ in range(300)] for rng in (one, other)]
    texts = [list(map(repr, messages)) for messages in made]
    assert texts[0] == texts[1]
    assert len(set(texts[0])) > 250


# What odd values leave behind


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Modules:
    """Run modules of the page in node, with the scale of shears among them."""
    scale = 'import { ShearScale } from "./shear_scale.js";\n'
    monkeypatch.setattr(test_page_contactor, "IMPORTS", test_page_contactor.IMPORTS + scale)
    return Modules(tmp_path)


@pytest.mark.parametrize("odd", ["NaN", "Infinity", "-Infinity", "3e38"])
def test_an_odd_sample_leaves_a_spectrum_within_seconds(modules: Modules, odd: str) -> None:
    """Find a sinusoid of 1 µm again after 5 s, which are 20 time constants."""
    source = """
    const spectrum = new ContactorSpectrum(8000, new Threshold([[1, 1], [2000, 1]]));
    const sine = Float32Array.from({ length: 4096 }, (_, n) => Math.sin(2 * Math.PI * n / 16));
    spectrum.take(0, sine.map((sample, n) => (n === 7 ? ODD : sample)));
    spectrum.update(0.1);
    for (let k = 1; k <= 50; k++) {
      spectrum.take(4096 * k, sine);
      spectrum.update(0.1);
    }
    return [spectrum.strongest.band.nominal_hz, spectrum.strongest.peak_um];
    """.replace("ODD", odd)
    nominal, peak = modules.run(source)
    assert nominal == 500
    assert peak == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("rate", ["0", "-1", "5e-324", "1e308", "1e9"])
def test_an_odd_sample_rate_is_no_error(modules: Modules, rate: str) -> None:
    """Compute what can be computed, in an array that is not larger than needed."""
    source = """
    const spectrum = new ContactorSpectrum(RATE, new Threshold([[1, 1], [2000, 1]]));
    spectrum.take(0, new Float32Array(2 ** 16).fill(1));
    spectrum.update(0.1);
    return spectrum.bands.length;
    """.replace("RATE", rate)
    assert modules.run(source) in (0, 21)


@pytest.mark.parametrize("odd", ["Infinity", "1e308"])
def test_an_odd_shear_leaves_the_scale_within_seconds(modules: Modules, odd: str) -> None:
    """Draw 5 µm as usual again half a minute after it, which are ten time constants."""
    source = """
    const scale = new ShearScale(1);
    const usual = new ShearScale(1);
    scale.take(ODD, 0);
    for (const each of [scale, usual]) for (let t = 0; t <= 30; t++) each.take(5, 1000 * t);
    return [scale.um_per_mm, usual.um_per_mm];
    """.replace("ODD", odd)
    after, usual = modules.run(source)
    assert after == usual
