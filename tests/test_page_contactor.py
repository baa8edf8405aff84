"""The computations behind the panel of one contactor: spectrum, third octaves and loudspeaker.

node runs the modules that need no browser as they are compiled in the wheel; numpy and closed forms
judge. The panel itself is tried in a browser.
"""

import asyncio
import json
import shutil
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from browser_rig import PATIENCE_S, browsing, visiting
from msgspec import structs
from node_rig import tool
from numpy.typing import NDArray
from server_rig import Hands, serving, until
from test_page import daemon

from tactile.messages import DisplayDescription, Subscribe, TelemetryMessage, TelemetryTrace
from tactile.server.page import FOLDER
from tactile.texture.perception import CENTERS, NOMINAL, band_sensation, detection_threshold

if TYPE_CHECKING:
    from playwright.async_api import Browser

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("patient")]

RATE = 8000.0
"""Sample rate of the traces [Hz]."""
SHOWN = slice(10, 31)
"""Bands of `CENTERS` that the page shows: 10 Hz to 1 kHz."""
THRESHOLD_UM = np.column_stack([CENTERS, 1e6 * detection_threshold(CENTERS)])


IMPORTS = """
import { FourierTransform } from "./fft.js";
import { LineSpectrum } from "./line_spectrum.js";
import { BANDS, bandPower } from "./third_octaves.js";
import { Threshold } from "./threshold.js";
import { TraceWindow } from "./trace_window.js";
import { ContactorSpectrum } from "./contactor_spectrum.js";
import { Schedule } from "./schedule.js";
"""


class Modules:
    """Modules of the page that need no browser, run by node."""

    def __init__(self, folder: Path) -> None:
        self._folder = shutil.copytree(FOLDER / "page", folder / "page")
        (folder / "package.json").write_text('{"type": "module"}')

    def run(self, source: str, **values: Any) -> Any:
        """Return what the body of a JavaScript function returns; `values` are constants in it."""
        main = self._folder / "main.js"
        constants = "".join(f"const {k} = {json.dumps(v)};\n" for k, v in values.items())
        body = f"console.log(JSON.stringify((() => {{ {source} }})()));\n"
        main.write_text(IMPORTS + constants + body)
        command = [tool("node"), str(main)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)


@pytest.fixture
def modules(tmp_path: Path) -> Modules:
    return Modules(tmp_path)


# Fourier transform


@pytest.mark.parametrize("length", [2, 8, 64, 4096])
def test_the_fourier_transform_is_that_of_numpy(modules: Modules, length: int) -> None:
    """Both round in double precision; 1e-9 of the largest value is far above that."""
    rng = np.random.default_rng(length)
    values = rng.normal(size=length) + 1j * rng.normal(size=length)
    source = """
    const [real, imaginary] = [Float64Array.from(re), Float64Array.from(im)];
    new FourierTransform(re.length).transform(real, imaginary);
    return [[...real], [...imaginary]];
    """
    re, im = modules.run(source, re=values.real.tolist(), im=values.imag.tolist())
    expected = np.fft.fft(values)
    assert np.abs(np.array(re) + 1j * np.array(im) - expected).max() < 1e-9 * np.abs(expected).max()


def test_a_length_that_is_no_power_of_two_is_an_error(modules: Modules) -> None:
    source = "try { new FourierTransform(1000) } catch (error) { return error.message }"
    assert "1000" in modules.run(source)


# Third octaves


def bands(
    modules: Modules, shear_um: NDArray[np.float64], rate: float = RATE
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the peak [µm] and level [dB SL] of each band of a trace."""
    source = """
    const spectrum = new ContactorSpectrum(rate, new Threshold(threshold));
    spectrum.take(0, Float32Array.from(shear));
    spectrum.update(0.1);
    return spectrum.bands.map(({ peak_um, level_db }) => [peak_um, level_db]);
    """
    threshold = THRESHOLD_UM.tolist()
    shear = shear_um.tolist()
    values = modules.run(source, shear=shear, rate=rate, threshold=threshold)
    peak, level = np.array(values).T
    return peak, level


def sinusoid(frequency: float, peak_um: float) -> NDArray[np.float64]:
    time = np.arange(4096) / RATE
    return np.asarray(peak_um * np.sin(2 * np.pi * frequency * time + 0.3))


@pytest.mark.parametrize("frequency", [40.0, 160.0, 250.0, 800.0])
def test_the_band_of_a_sinusoid_has_its_peak_and_the_others_next_to_nothing(
    modules: Modules, frequency: float
) -> None:
    """The lines of a Hann window fall by 18 dB per octave beyond four lines."""
    peak, _ = bands(modules, sinusoid(frequency, 3.0))
    own = int(np.argmin(np.abs(NOMINAL[SHOWN] - frequency)))
    assert 20 * np.log10(peak[own] / 3.0) == pytest.approx(0, abs=0.2)
    assert np.delete(peak, own).max() < 3.0 * 10 ** (-30 / 20)
    far = peak[np.abs(np.arange(len(peak)) - own) > 2]
    assert far.max() < 3.0 * 10 ** (-60 / 20)


@pytest.mark.parametrize("frequency", [25.0, 63.0, 230.0, 900.0])
def test_levels_are_those_of_the_server(modules: Modules, frequency: float) -> None:
    """A sinusoid has the level of its own frequency, wherever in a band it is.

    The window shares it among lines, and at 25 Hz among bands, which add up to it but for the
    difference of the thresholds within 4 Hz.
    """
    _, level = bands(modules, sinusoid(frequency, 3.0))
    power = np.array([0.5 * 3e-6**2])
    expected = band_sensation(np.array([frequency]), power).max()
    assert 10 * np.log10(np.sum(10 ** (level / 10))) == pytest.approx(expected, abs=0.4)


def test_white_noise_has_a_power_in_proportion_to_the_width_of_each_band(modules: Modules) -> None:
    """The power of a band is the mean of N lines in M windows, of which 2 in 3 are independent.

    Its relative standard deviation is 1/sqrt(2/3 N M) at most (exponentially distributed lines); 5
    of these are the tolerance. The windows do not overlap.
    """
    runs = 40
    noise = np.random.default_rng(3).normal(scale=2.0, size=(runs, 4096))
    source = """
    const { length } = noise[0];
    const spectrum = new LineSpectrum(length);
    const means = BANDS.map(() => 0);
    for (const samples of noise) {
      const lines = spectrum.powers(Float32Array.from(samples));
      BANDS.forEach((band, k) => {
        means[k] += bandPower(lines, rate / length, band) / noise.length;
      });
    }
    return means;
    """
    powers = np.array(modules.run(source, noise=noise.tolist(), rate=RATE))
    width = CENTERS[SHOWN] * (10**0.05 - 10**-0.05)
    expected = 2.0**2 * width / (RATE / 2)
    lines = np.maximum(width / (RATE / 4096), 1)
    assert np.all(np.abs(powers / expected - 1) < 5 / np.sqrt(2 / 3 * lines * runs))


def test_bands_above_half_the_sample_rate_are_left_out(modules: Modules) -> None:
    peak, _ = bands(modules, np.ones(4096), rate=1000.0)
    assert len(peak) == 17  # up to 400 Hz


def test_a_constant_shear_is_in_no_band(modules: Modules) -> None:
    peak, _ = bands(modules, np.full(4096, 5.0))
    assert peak.max() < 1e-5


def test_silence_and_a_gap_have_no_spectrum(modules: Modules) -> None:
    source = """
    const spectrum = new ContactorSpectrum(8000, new Threshold([[1, 1], [2000, 1]]));
    const update = (first, value) => {
      spectrum.take(first, new Float32Array(4096).fill(0).map((_, k) => value * (k % 16)));
      spectrum.update(0.1);
      return spectrum.bands.length;
    };
    const counts = [update(0, 0), update(4096, 1), update(8192, 0), update(12288, 1)];
    spectrum.clear();
    spectrum.take(16384, Float32Array.of(1));
    spectrum.update(0.1);
    return [...counts, spectrum.bands.length];
    """
    assert modules.run(source) == [0, 21, 0, 21, 0]


def test_samples_on_both_sides_of_a_gap_are_not_joined(modules: Modules) -> None:
    source = """
    const window = new TraceWindow(8);
    const fill = (first, ...samples) => {
      window.take(first, Float32Array.from(samples));
      return window.isFull ? [...window.samples] : null;
    };
    return [
      fill(10, 1, 2, 3, 4, 5), fill(15, 6, 7, 8), fill(18, 9), fill(20, 1, 2, 3),
      fill(23, 4, 5, 6, 7, 8), fill(0, 1, 2), fill(2, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10),
    ];
    """
    assert modules.run(source) == [
        None, [1, 2, 3, 4, 5, 6, 7, 8], [2, 3, 4, 5, 6, 7, 8, 9], None,
        [1, 2, 3, 4, 5, 6, 7, 8], None, [3, 4, 5, 6, 7, 8, 9, 10],
    ]  # fmt: skip


def test_a_spectrum_is_smoothed_in_power(modules: Modules) -> None:
    """Reach 1 − 1/e of a step after one time constant of a quarter of a second."""
    step = np.concatenate([sinusoid(500.0, 1.0), sinusoid(500.0, 3.0)])
    source = """
    const spectrum = new ContactorSpectrum(8000, new Threshold([[1, 1], [2000, 1]]));
    spectrum.take(0, Float32Array.from(shear.slice(0, 4096)));
    spectrum.update(0.25);
    spectrum.take(4096, Float32Array.from(shear.slice(4096)));
    spectrum.update(0.25);
    return [spectrum.strongest.band.nominal_hz, spectrum.strongest.peak_um ** 2];
    """
    nominal, power = modules.run(source, shear=step.tolist())
    assert nominal == 500
    assert power == pytest.approx(9 - 8 * np.exp(-1), rel=0.01)


def test_the_threshold_is_that_of_the_server(modules: Modules) -> None:
    """The server's own knots lie between the pairs, where lines cut their corners."""
    frequency = np.geomspace(1.0, 1100.0, 60)
    source = "const t = new Threshold(pairs); return frequency.map((f) => t.at(f));"
    pairs = THRESHOLD_UM.tolist()
    threshold = modules.run(source, pairs=pairs, frequency=frequency.tolist())
    assert threshold == pytest.approx(1e6 * detection_threshold(frequency), rel=0.03)


def test_bands_are_those_of_the_server(modules: Modules) -> None:
    source = "return BANDS.map((b) => [b.center_hz, b.nominal_hz, b.from_hz, b.to_hz]);"
    center, nominal, low, high = np.array(modules.run(source)).T
    assert center == pytest.approx(CENTERS[SHOWN])
    assert nominal == pytest.approx(NOMINAL[SHOWN])
    assert low[1:] == pytest.approx(high[:-1])
    assert (low[0], high[-1]) == pytest.approx((10**0.95, 10**3.05))


# Schedule of the loudspeaker

LIMITS = {"target": 640, "most": 1600, "least": 240}
"""Limits of the queue at 8 kHz [samples]."""

Chunk = tuple[int, int, bool]
"""Sample that is played when a chunk comes, the length of the chunk, and whether it follows."""


def schedule(modules: Modules, chunks: list[Chunk]) -> tuple[list[Any], int]:
    """Return the place (begin, begins) of each chunk, None for a skipped one, and the gaps."""
    source = """
    const schedule = new Schedule(limits);
    const places = chunks.map(([now, length, follows]) => schedule.place(now, length, follows));
    return [places.map((place) => (place ? [place.begin, place.begins] : null)), schedule.gaps];
    """
    places, gaps = modules.run(source, limits=LIMITS, chunks=chunks)
    return places, gaps


def test_regular_chunks_are_played_without_gaps_and_overlaps(modules: Modules) -> None:
    """Chunks of 133 or 134 samples come up to 30 ms late."""
    rng = np.random.default_rng(1)
    starts = (np.arange(3000) * 400) // 3
    lengths = np.diff(starts, append=400_000)
    late = starts + rng.integers(0, 240, len(starts))
    now = np.maximum.accumulate(late)
    chunks = [(int(n), int(size), True) for n, size in zip(now, lengths, strict=True)]
    places, gaps = schedule(modules, chunks)
    begin = np.array([place[0] for place in places])
    assert np.array_equal(np.diff(begin), lengths[:-1])
    assert np.all(begin > now)
    assert begin[0] == now[0] + LIMITS["target"]
    assert [place[1] for place in places] == [True] + [False] * (len(places) - 1)
    assert gaps == 0


def test_playing_begins_again_at_the_target_after_a_pause(modules: Modules) -> None:
    chunks = [(0, 133, False), (133, 133, True), (5000, 133, True), (5133, 133, True)]
    places, gaps = schedule(modules, chunks)
    assert places == [[640, True], [773, False], [5640, True], [5773, False]]
    assert gaps == 1


def test_a_chunk_that_comes_too_late_for_a_fade_begins_anew(modules: Modules) -> None:
    end = 640 + 133
    in_time = schedule(modules, [(0, 133, False), (end - 240, 133, True)])
    too_late = schedule(modules, [(0, 133, False), (end - 239, 133, True)])
    assert in_time == ([[640, True], [773, False]], 0)
    assert too_late == ([[640, True], [end - 239 + 640, True]], 1)


def test_missing_samples_are_a_gap_that_takes_no_time(modules: Modules) -> None:
    places, gaps = schedule(modules, [(0, 133, False), (133, 133, True), (266, 133, False)])
    assert places == [[640, True], [773, False], [906, True]]
    assert gaps == 1


@pytest.mark.parametrize("speed", [1.01, 1.5, 10.0])
def test_the_delay_is_bounded_when_chunks_come_too_fast(modules: Modules, speed: float) -> None:
    """Chunks of 133 samples come too fast; what is played never overlaps."""
    chunks = [(int(k * 133 / speed), 133, True) for k in range(4000)]
    places, gaps = schedule(modules, chunks)
    played = [(now, *place) for (now, _, _), place in zip(chunks, places, strict=True) if place]
    begin = np.array([b for _, b, _ in played])
    delay = begin + 133 - np.array([now for now, _, _ in played])
    assert delay.max() <= LIMITS["most"]
    assert np.all(np.diff(begin) == 133)
    resumed = [b - now for now, b, begins in played if begins]
    assert max(resumed) <= LIMITS["target"]
    assert gaps == len(resumed) - 1 > 0


def test_a_chunk_longer_than_the_longest_delay_is_skipped(modules: Modules) -> None:
    places, _ = schedule(modules, [(0, 2048, False), (133, 2048, True), (266, 133, True)])
    assert places == [None, None, [906, True]]


# The panel in a browser


class SoundingHands(Hands):
    """A host of displays with a threshold, that sends traces."""

    @property
    def displays(self) -> tuple[DisplayDescription, ...]:
        pairs = tuple(map(tuple, THRESHOLD_UM.tolist()))
        return tuple(structs.replace(each, threshold_um=pairs) for each in super().displays)

    @property
    def contactor(self) -> int | None:
        """Contactor that the page wants to have the shear of."""
        wanted = [c.contactor for _, c in self.log if isinstance(c, Subscribe)]
        return wanted[-1] if wanted else None

    def send(
        self,
        first: int,
        shear_um: NDArray[np.float64],
        played_um: NDArray[np.float64] | None = None,
    ) -> None:
        """Send samples of commanded shear and, if there are any, of that of the skin."""

        def trace(samples: NDArray[np.float64]) -> TelemetryTrace:
            return TelemetryTrace(
                contactor=self.contactor or 0, sample_rate_hz=RATE, first=first,
                shear_um=samples.astype("<f4").tobytes(),
            )  # fmt: skip

        self.clients[-1].outbox.put_nowait(
            TelemetryMessage(
                display="right", time_us=first, state="armed", position_mm=(0.0, 0.0),
                velocity_mm_s=(0.0, 0.0), normal_force_n=0.5, shear_um=(0.0, 0.0),
                drive_v=(0.0, 0.0), counters={}, trace=trace(shear_um),
                played=None if played_um is None else trace(played_um),
            )
        )  # fmt: skip


@pytest.fixture
async def browser() -> "AsyncIterator[Browser]":
    async with browsing() as running:
        yield running


async def test_the_strongest_band_is_a_sentence(browser: "Browser") -> None:
    """A sinusoid of ten times the threshold is 20 dB above it; one of half of it is below."""
    hands = SoundingHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await until(lambda: hands.contactor == 0)
        at_threshold = float(1e6 * detection_threshold(np.array([250.0]))[0])
        wanted = {10 * at_threshold: "20 dB above threshold at 250 Hz", at_threshold / 2: "Below"}
        first = 0
        for peak_um, sentence in wanted.items():
            async with asyncio.timeout(PATIENCE_S):
                while sentence not in await visitor.at("spectrum-summary").inner_text():
                    hands.send(first, sinusoid(250.0, peak_um))  # 128 periods
                    first += 4096
                    await asyncio.sleep(0.1)
        await visitor.page.get_by_text("Nothing plays").wait_for()  # no more samples come
        assert visitor.mistakes == []


async def test_what_the_skin_does_is_shown_beside_what_is_commanded(browser: "Browser") -> None:
    """Shear of the skin with half the commanded amplitude is 6 dB lower."""
    hands = SoundingHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await until(lambda: hands.contactor == 0)
        commanded = 10 * float(1e6 * detection_threshold(np.array([250.0]))[0])
        samples, first, label = sinusoid(250.0, commanded), 0, ""
        async with asyncio.timeout(PATIENCE_S):
            while "20 dB above threshold at 250 Hz, 14 dB on the skin" not in label:
                hands.send(first, samples, samples / 2)
                first += 4096
                await asyncio.sleep(0.1)
                label = await visitor.at("spectrum").get_attribute("aria-label") or ""
        assert visitor.mistakes == []


async def test_a_contactor_is_chosen_by_a_click_and_by_keys(browser: "Browser") -> None:
    hands = SoundingHands()
    async with serving(hands=hands) as (there, _), visiting(browser, there.page) as visitor:
        await until(lambda: hands.contactor == 0)
        box = await visitor.at("array").bounding_box()
        assert box is not None
        await visitor.at("array").click(position={"x": 0.9 * box["width"], "y": box["height"] / 2})
        await until(lambda: hands.contactor == 1)
        assert await visitor.at("contactor").input_value() == "1"
        await visitor.at("contactor").press("ArrowUp")
        await until(lambda: hands.contactor == 0)
        assert "contactor 0 at x 0.0 mm" in await visitor.at("spectrum").get_attribute("aria-label")
        assert visitor.mistakes == []


HIDE = """
Object.defineProperty(document, "hidden", { value: true, configurable: true });
document.dispatchEvent(new Event("visibilitychange"));
delete document.hidden;
"""


async def test_listening_is_off_until_a_click_and_ends_when_nobody_looks(
    browser: "Browser", tmp_path: Path
) -> None:
    async with daemon(tmp_path) as there, visiting(browser, there.page) as visitor:
        listen = visitor.page.locator("[data-testid=listen]")
        on = visitor.page.locator("[data-testid=listen][aria-pressed=true]")
        off = visitor.page.locator("[data-testid=listen][aria-pressed=false]")
        await off.wait_for()
        await listen.click()
        await on.wait_for()
        await listen.click()
        await off.wait_for()
        await listen.click()
        await visitor.page.evaluate(HIDE)
        await off.wait_for()
        await listen.click()
        await on.wait_for()
        await there.kill()
        await off.wait_for()
        assert await listen.is_disabled()
        await there.start()
        await visitor.state("disarmed")
        assert await listen.is_enabled()
        assert await off.count() == 1


PLAY = """async (first) => {
  const { Speaker } = await import("/page/speaker.js");
  let context;
  window.AudioContext = function ({ sampleRate }) {
    return (context = new OfflineAudioContext(1, 4000, sampleRate));
  };
  const speaker = new Speaker(8000, 1);
  for (const [k, samples] of shear_um.entries()) speaker.take(first[k], Float32Array.from(samples));
  return [...(await context.startRendering()).getChannelData(0)];
}"""


@pytest.mark.parametrize("missing", [0, 1])
async def test_chunks_are_joined_sample_by_sample_and_fade_at_gaps(
    browser: "Browser", missing: int
) -> None:
    """Render what would be heard, in single precision; the first of it is 80 ms late."""
    chunks = np.random.default_rng(2).uniform(-12, 12, (7, 133))
    first = [133 * k + missing * (k > 3) for k in range(7)]
    async with serving() as (there, _), visiting(browser, there.page) as visitor:
        source = PLAY.replace("shear_um", json.dumps(chunks.tolist()))
        sound = np.array(await visitor.page.evaluate(source, first))
    fade = np.arange(32) / 32  # 4 ms
    expected = np.ones(7 * 133)
    expected[:32], expected[-32:] = fade, 1 - fade
    if missing:
        expected[4 * 133 - 32 : 4 * 133], expected[4 * 133 : 4 * 133 + 32] = 1 - fade, fade
    expected *= np.clip(chunks.ravel() / 10, -1, 1)
    played = sound[640 : 640 + 7 * 133]
    assert played == pytest.approx(expected, abs=1e-6)
    assert not sound[:640].any()
    assert not sound[640 + 7 * 133 :].any()
