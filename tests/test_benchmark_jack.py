"""The benchmark of JACK: delay, level and phase, from made records, without JACK or a server."""

import numpy as np
import pytest

from benchmarks.jack import split_counts, undisturbed
from benchmarks.tones import (
    CHANNELS,
    HIGHEST,
    JACK_RATE,
    LOWEST,
    FrameClock,
    ToneFit,
    delay_of,
    fit_seconds,
    fit_tones,
    tone_frequencies,
    tone_phasors,
    tone_table,
    tone_values,
    wanted_drive,
)
from tactile.arrays import Complex, Floats
from tactile.display.display import load_display
from tactile.rendering.renderer import Renderer

RATE = 8000.0
BEGUN = 100.0
"""Time of frame 0 of the made clock [s]."""
FASTER = 1 + 2.5e-4
"""Rate of the made clock over the nominal one, as JACK's dummy card rounds its period."""
DELAY = 0.0173
GAIN = 100.0
"""Codes of the made records at full scale."""


def frame_clock(seconds: float = 5.0) -> FrameClock:
    """Return a clock whose frames begin a little faster than the nominal rate says."""
    frames = np.arange(0, seconds * JACK_RATE, 128.0)
    return FrameClock(frames, BEGUN + frames / (JACK_RATE * FASTER))


def made(times: Floats, delay: float = DELAY) -> Floats:
    """Return a record of the tones (S, 24), late by a delay."""
    return GAIN * tone_values((times - delay - BEGUN) * JACK_RATE * FASTER)


def instants(seconds: float, begin: float = BEGUN + 1.0) -> Floats:
    """Return the times of the samples of an amplifier, which come unevenly by a microsecond."""
    uneven = np.random.default_rng(0).uniform(-1e-6, 1e-6, int(seconds * RATE))
    return np.asarray(begin + np.arange(len(uneven)) / RATE + uneven)


def ratio_for(delay: float) -> Complex:
    """Return the ratios of tones that are late, of a half of their level."""
    return np.asarray(0.5 * np.exp(-2j * np.pi * tone_frequencies() * delay))


def test_the_tones_are_all_different_and_cover_the_band() -> None:
    rising = np.sort(tone_frequencies().ravel())
    assert (rising[0], rising[-1]) == (LOWEST, HIGHEST)
    assert np.diff(rising).min() >= 1
    assert np.diff(tone_frequencies(), axis=1).min() > 30, "of a channel, a second tells them apart"


def test_a_second_of_the_table_is_the_tones_and_repeats() -> None:
    table = tone_table()
    frames = np.array([0.0, 17.0, 47_999.0, 48_003.0])
    assert pytest.approx(tone_values(frames), abs=1e-6) == table[:, frames.astype(int)].T
    assert table[:, JACK_RATE:] == pytest.approx(table[:, : table.shape[1] - JACK_RATE], abs=1e-6)
    assert np.abs(table).max() < 0.2, "far below full scale"


@pytest.mark.parametrize("delay", [0.0, 1e-7, 0.0173, -0.06, 0.0999])
def test_a_delay_is_recovered_from_phases(delay: float) -> None:
    assert delay_of(ratio_for(delay)) == pytest.approx(delay, abs=1e-9)


def test_each_second_of_a_record_has_its_delay_level_and_no_noise() -> None:
    times = instants(3.0)
    fits = fit_seconds(frame_clock(), times, made(times), GAIN * tone_phasors())
    assert len(fits) == 2, "whole seconds between the first and the last sample"
    for fit in fits:
        assert fit.delay == pytest.approx(DELAY, abs=1e-9)
        assert fit.without(DELAY) == pytest.approx(np.ones((CHANNELS, 4)), abs=1e-5)
        assert fit.noise < 1e-9


def test_a_second_that_was_not_put_out_in_full_has_no_fit() -> None:
    times = instants(4.5)
    kept = np.abs(times - times[0] - 1.5) > 0.02
    fits = fit_seconds(frame_clock(), times[kept], made(times)[kept], GAIN * tone_phasors())
    assert [round(fit.begin - times[0], 2) for fit in fits] == [0.0, 2.0, 3.0]
    assert fit_seconds(frame_clock(), times[:0], made(times)[:0], GAIN * tone_phasors()) == []


def test_a_second_that_is_later_is_seen_as_later() -> None:
    times = instants(3.0)
    values = np.where(times[:, None] < times[0] + 1, made(times), made(times, DELAY + 30e-6))
    first, second = fit_seconds(frame_clock(), times, values, GAIN * tone_phasors())
    assert second.delay - first.delay == pytest.approx(30e-6, abs=1e-8)
    apart = np.abs(second.without(DELAY) - np.exp(-2j * np.pi * tone_frequencies() * 30e-6))
    assert apart.max() < 1e-4


def test_a_millisecond_without_sound_is_noise_above_the_limit() -> None:
    times = instants(1.0)
    values = made(times)
    values[4000:4008] = 0.0
    fit = fit_tones(frame_clock(), times, values, GAIN * tone_phasors(), DELAY)
    assert fit.noise > 1e-3
    assert fit.delay == pytest.approx(DELAY, abs=5e-6), "the rest of the second has its delay"


def log_rows(seconds: float) -> tuple[Floats, Floats]:
    """Return a log of cycles whose frames wrap, and the times at which they really began.

    JACK's clock is a quarter of a second behind and slips by 20 ppm, and every tenth reading was
    held up for a millisecond between the monotonic clock and it.
    """
    count = int(seconds * JACK_RATE / 128)
    frames = (2.0**32 - 1280 + 128 * np.arange(count)) % 2.0**32
    begun = BEGUN + 128 * np.arange(count) / JACK_RATE
    before = begun + 3e-4
    held = np.where(np.arange(count) % 10 == 0, 1e-3, 0.0)

    def clock_of_jack(times: Floats) -> Floats:
        return 1e6 * (times - 0.25 - 20e-6 * (times - BEGUN))

    now = clock_of_jack(before + held + 1e-6)
    rows = np.stack([frames, clock_of_jack(begun), before, now, before + held + 2e-6], axis=1)
    return rows, begun


def test_the_times_of_frames_come_from_the_quickest_readings() -> None:
    rows, begun = log_rows(20.0)
    clock = FrameClock.of(rows)
    assert np.diff(clock.frames) == pytest.approx(128), "also where the number wraps"
    inside = slice(375, -375)  # from the first of the quickest readings to the last
    assert np.abs(clock.times - begun)[inside].max() < 2e-7
    between = (begun[400] + begun[401]) / 2
    assert clock.at(np.array([between]))[0] - clock.frames[400] == pytest.approx(64, abs=0.1)


def test_the_clock_wanders_by_what_its_times_are_off_a_line() -> None:
    clock = frame_clock(20.0)
    assert clock.wander(BEGUN, BEGUN + 12) == pytest.approx(np.zeros(12), abs=1e-9)
    late = FrameClock(clock.frames, clock.times + 1e-4 * np.sin(np.pi * (clock.times - BEGUN)))
    off = late.wander(BEGUN, BEGUN + 12)
    assert off[::2] == pytest.approx(np.full(6, 6.4e-5), abs=2e-5)
    assert off[1::2] == pytest.approx(np.full(6, -6.4e-5), abs=2e-5)


def test_a_line_ends_where_jack_was_late() -> None:
    clock = frame_clock(40.0)
    later = clock.times > BEGUN + 15
    broken = FrameClock(clock.frames + 256 * later, clock.times + 8e-3 * later)
    assert broken.breaks() == pytest.approx([BEGUN + 15.008], abs=2e-3)
    assert FrameClock(clock.frames, broken.times).breaks().size == 1, "a clock that began anew"
    assert FrameClock(broken.frames, clock.times).breaks().size == 1, "cycles that were left out"
    assert clock.breaks().size == 0
    off = broken.wander(BEGUN + 1, BEGUN + 36)
    assert len(off) == 14 + 21
    assert np.abs(off).max() < 1e-9
    assert broken.wander(BEGUN + 10, BEGUN + 20).size == 0, "too short for a line"


def second(begin: float, noise: float = 0.0) -> ToneFit:
    """Return the fit of a second."""
    return ToneFit(ratio_for(0.0), 0.0, noise, begin)


def test_seconds_count_unless_jack_was_late_and_are_whole_unless_something_is_missing() -> None:
    fits = [second(k, noise=0.1 if k == 7 else 1e-7) for k in range(10)]
    calm, whole = undisturbed(fits, np.array([3.5]))
    assert [fit.begin for fit in calm] == [0, 1, 2, 6, 7, 8, 9]
    assert [fit.begin for fit in whole] == [0, 1, 2, 6, 8, 9]


def test_what_is_counted_while_jack_was_late_is_told_apart() -> None:
    samples = [(float(t), {"gaps": count}) for t, count in enumerate((5, 5, 7, 7, 8, 8))]
    assert split_counts(samples, "gaps", np.array([1.3])) == (1, 2)
    assert split_counts(samples, "gaps", np.array([])) == (3, 0)


def test_the_wanted_drive_gives_the_shear_of_the_source() -> None:
    """Compare with the renderer, which plays the tones of a channel within its own accuracy."""
    display, full_scale = load_display("reference-24"), 10e-6
    renderer, blocks = Renderer(display, None, sample_rate=RATE), 1100
    times = BEGUN + 0.5 + np.arange(16 * blocks) / RATE
    shear = (full_scale / GAIN * made(times, 0.0)).astype(np.float32)
    rest = np.zeros((16, 2)), np.full(16, 0.5)
    drive = np.concatenate([
        renderer.block(*rest, waveform=shear[16 * k : 16 * (k + 1)]) for k in range(blocks)
    ])  # fmt: skip
    fits = fit_seconds(frame_clock(), times[800:], drive[800:], wanted_drive(display, full_scale))
    assert fits[0].delay == pytest.approx(renderer.delay / RATE, abs=2e-6)
    ratio = fits[0].without(fits[0].delay)
    assert np.abs(20 * np.log10(np.abs(ratio))).max() < 0.1
    assert np.abs(np.degrees(np.angle(ratio))).max() < 1
