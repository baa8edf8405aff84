"""A follower plays the stream at the times of another clock, and changes nothing without need."""

from contextlib import closing

import numpy as np
import pytest
from link_rig import Bench

from tactile.arrays import Floats
from tactile.bus.base import DriveBlock, Wiring
from tactile.bus.link.follower import Follower
from tactile.bus.registry import open_bus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import KINDS
from tactile.display.display import load_display

RATE = 8000.0
BLOCK = 16
HALF = 8
"""Samples after one that it waits for: 1 ms at 8 kHz."""
SLACK = 0.25
"""Samples that clocks may be apart before anything is moved: 31 µs at 8 kHz."""


def followed(volts: Floats, drift: float, rate: float = RATE) -> tuple[Floats, Floats, Floats]:
    """Return positions, what was read there, and the offsets, of a stream in blocks."""
    follower = Follower(rate)
    at, out, offset = [], [], []
    for k in range(0, len(volts), BLOCK):
        before = follower.offset
        for start, piece in follower.feed(k, volts[k : k + BLOCK], drift * k):
            at.append(start + np.arange(len(piece)))
            offset.append(np.linspace(before, follower.offset, len(piece), endpoint=False))
            out.append(piece[:, 0])
    return np.concatenate(at), np.concatenate(out), np.concatenate(offset)


@pytest.mark.parametrize("drift", [0.0, 1e-9])
def test_with_clocks_together_samples_pass_as_they_are(drift: float) -> None:
    noise = np.random.default_rng(0).uniform(-100, 100, (4000, 1))
    at, out, _ = followed(noise, drift)
    assert np.array_equal(at, np.arange(len(noise) - HALF))
    assert np.array_equal(out, noise[: len(out), 0])


@pytest.mark.ci
@pytest.mark.parametrize("ppm", [100, -100, 2000, -2000])
@pytest.mark.parametrize(
    ("hz", "rate", "error_db"),
    [(50, 8000, -85), (250, 8000, -85), (1000, 8000, -85), (500, 2500, -80), (1000, 2500, -24)],
)
def test_a_tone_is_itself_at_the_other_clocks_times(
    ppm: float, hz: float, rate: float, error_db: float
) -> None:
    """The closed form: a sine at position + offset."""
    n = np.arange(int(8 * rate))
    at, out, offset = followed(np.sin(2 * np.pi * hz * n / rate)[:, None], ppm * 1e-6, rate)
    wanted = np.sin(2 * np.pi * hz * (at + offset) / rate)
    error = np.abs(out - wanted)[4 * HALF :].max()
    assert 20 * np.log10(error) < error_db


@pytest.mark.ci
@pytest.mark.parametrize("ppm", [50, -100, 100])
def test_clocks_of_crystals_are_followed_within_half_a_sample(ppm: float) -> None:
    at, _, offset = followed(np.zeros((int(20 * RATE), 1)), ppm * 1e-6)
    assert np.array_equal(at, np.arange(len(at))), "none twice, none left out"
    apart = np.abs(ppm * 1e-6 * at - offset)
    late = abs(ppm) * 1e-6 * RATE * 0.25  # what is beyond the slack goes to 1/e in 0.25 s
    assert apart.max() == pytest.approx(SLACK + late, abs=0.01)


def test_a_gap_ends_one_stretch_and_begins_another() -> None:
    follower = Follower(RATE)
    volts = np.arange(1.0, 33.0)[:, None]
    first = follower.feed(0, volts, 0.0)
    second = follower.feed(100, volts, 0.0) + follower.feed(132, volts, 0.0)
    at = np.concatenate([start + np.arange(len(v)) for start, v in [*first, *second]])
    out = np.concatenate([v[:, 0] for _, v in [*first, *second]])
    assert np.array_equal(at, [*range(32), *range(100, 164 - HALF)])
    assert np.array_equal(out, [*volts[:, 0], *volts[:, 0], *volts[: 32 - HALF, 0]])


def test_what_was_flushed_is_neither_sent_again_nor_left_out() -> None:
    follower = Follower(RATE)
    volts = np.arange(1.0, 33.0)[:, None]
    pieces = follower.feed(0, volts, 0.0) + follower.flush() + follower.flush()
    pieces += follower.feed(32, volts, 0.0) + follower.flush()
    at = np.concatenate([start + np.arange(len(v)) for start, v in pieces])
    assert np.array_equal(at, np.arange(64))
    out = np.concatenate([v[:, 0] for _, v in pieces])
    assert np.array_equal(out, [*volts[:, 0], *volts[:, 0]])


def test_boards_wait_for_what_follows_also_at_the_least_lead_and_at_the_end() -> None:
    assert KINDS
    display = load_display("reference-24")
    url = "mock:?link=canfd&boards=2&drift_ppm=300&lead_ms=6"
    with open_bus(url, display, sample_rate=2500.0) as bus:
        assert isinstance(bus, ModeledBus)
        bus.start()
        assert bus.lead == pytest.approx(6e-3)
        for k in range(0, 1250, 5):
            bus.write(DriveBlock(k, np.full((5, 24), 20 * min(1.0, k / 500))))
        bus.stop()
        assert bus.counters.faults() == {}


@pytest.mark.ci
@pytest.mark.parametrize("drift", [1000, -1000])
def test_boards_whose_crystals_differ_play_on_together(drift: int) -> None:
    """Clocks part by 12 ms in 12 s, as two of 20 ppm in ten minutes: more than the lead."""
    assert KINDS
    url = f"mock:?link=canfd&boards=2&drift_ppm={drift}"
    display = load_display("reference-24")
    with open_bus(url, display, sample_rate=2500.0) as bus:
        assert isinstance(bus, ModeledBus)
        assert bus.wiring == Wiring.of(display, 2500.0)
        time = np.arange(12 * 2500) / 2500
        tone = (20 * np.sin(2 * np.pi * 50 * time) * np.minimum(time * 5, 1))[:, None]
        bus.start()
        for k in range(0, len(tone), 250):
            bus.write(DriveBlock(k, np.repeat(tone[k : k + 250], 24, axis=1)))
        assert bus.counters.faults() == {}
        bus.stop()
        assert bus.counters.faults() == {}


@pytest.mark.ci
def test_a_tone_on_a_board_that_follows_has_no_seams_between_packets() -> None:
    """All but the tone, by the first board's clock, is 40 dB below it."""
    drift = 1e-3
    bench = Bench(f"mock:?link=canfd&boards=2&drift_ppm={drift * 1e6:g}&format=pcm16")
    with closing(bench.bus) as bus:
        n = np.arange(round(5 * bench.rate))
        tone = 20 * np.sin(2 * np.pi * 250 * n / bench.rate) * np.minimum(n / 500, 1)
        bench.start()
        for k in range(0, len(n), BLOCK):
            bus.write(DriveBlock(k, np.repeat(tone[k : k + BLOCK, None], 2, axis=1)))
        bench.model.report_output()
        times, codes, _ = bench.heard[1][-1].together()
    late = (times > times[-1] - 0.3) & (times < times[-1] - 0.1)
    angle = 2 * np.pi * 250 * (1 + drift) * times[late]
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    parts, (rest,), *_ = np.linalg.lstsq(waves, codes[late, 0].astype(np.float64))
    assert rest / late.sum() < 1e-4 * np.sum(parts**2) / 2
