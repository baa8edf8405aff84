"""Tests of waveforms and parametric effects: what is accepted, what is played, how they end."""

import numpy as np
import pytest

from tactile.arrays import Floats
from tactile.playback.sinc_interpolation import REMEMBERED, SincInterpolation
from tactile.playback.waveforms import WaveformQueue
from tactile.playback.waves import Curve, EffectPlayer

RATE = 8000.0
N = 3
BLOCK = 16
ENDING = 5e-3
"""Time in which what is replaced or ends early falls to nothing [s]."""


def drained(queue: WaveformQueue, most: int = 2000) -> Floats:
    parts = []
    for _ in range(most):
        part = queue.take(BLOCK)
        if part is None:
            break
        parts.append(part)
    return np.concatenate(parts or [np.zeros((0, N), np.float32)]).astype(np.float64)


@pytest.mark.parametrize("rate", [500.0, 1000.0, 8000.0, 11025.0, 44100.0, 48000.0])
def test_a_waveform_is_itself_at_the_drives_rate(rate: float) -> None:
    """A sine of 100 Hz, resampled, is that sine to 50 dB."""
    source = np.sin(2 * np.pi * 100 * np.arange(int(rate * 0.9)) / rate).astype(np.float32)
    queue = WaveformQueue(RATE, N)
    assert queue.append(source, rate, ()) == len(source)
    played = drained(queue)
    time = np.arange(len(played)) / RATE
    inside = (time > 0.05) & (time < 0.8)
    wanted = np.sin(2 * np.pi * 100 * time)
    assert np.abs(played[inside] - wanted[inside, None]).max() < 3e-3
    assert len(played) == pytest.approx(0.9 * RATE, abs=BLOCK)


def test_what_is_above_the_drives_band_is_not_folded_into_it() -> None:
    source = np.sin(2 * np.pi * 7000 * np.arange(24000) / 48000).astype(np.float32)
    queue = WaveformQueue(RATE, N)
    queue.append(source, 48000.0, ())
    assert np.abs(drained(queue)[200:-200]).max() < 1e-3


def test_a_waveform_is_the_same_however_it_is_cut_into_messages() -> None:
    source = np.random.default_rng(0).uniform(-1, 1, 900).astype(np.float32)
    whole, cut = WaveformQueue(RATE, N), WaveformQueue(RATE, N)
    whole.append(source, 1000.0, (1,))
    for k in range(0, 900, 77):
        cut.append(source[k : k + 77], 1000.0, (1,))
    np.testing.assert_array_equal(drained(whole), drained(cut))


def test_only_the_named_contactors_play_and_at_the_same_time_as_others() -> None:
    queue = WaveformQueue(RATE, N)
    queue.append(np.ones(100, np.float32), RATE, (0, 2))
    queue.append(np.full(150, 2, np.float32), RATE, (1,))
    played = drained(queue)
    np.testing.assert_allclose(played[50], [1, 2, 1], atol=1e-6)
    np.testing.assert_allclose(played[120], [0, 2, 0], atol=1e-6)
    assert len(played) == 160


def test_samples_wait_for_those_of_their_own_contactors_alone() -> None:
    """What is for several contactors begins on all of them at once, when the last one is free."""
    queue = WaveformQueue(RATE, N)
    queue.append(np.ones(80, np.float32), RATE, (0,))
    queue.append(np.full(40, 2, np.float32), RATE / 2, (0, 1))
    queue.append(np.full(16, 4, np.float32), RATE, (2,))
    assert [queue.waiting((k,)) * RATE for k in range(N)] == [160, 160, 16]
    played = drained(queue)
    np.testing.assert_allclose(played[8], [1, 0, 4], atol=1e-6)
    np.testing.assert_allclose(played[40], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(played[120], [2, 2, 0], atol=0.1)
    assert not played[:80, 1].any()
    assert not played[16:, 2].any()


@pytest.mark.parametrize("rate", [1000.0, 8000.0, 48000.0])
def test_each_contactor_has_its_own_samples_as_if_it_were_alone(rate: float) -> None:
    """Messages of one contactor each are what a queue of one plays."""
    samples = np.random.default_rng(5).uniform(-1, 1, (N, int(rate / 10))).astype(np.float32)
    queue = WaveformQueue(RATE, N)
    for part in np.array_split(samples, 7, axis=1):
        for k in range(N):
            assert queue.append(part[k], rate, (k,)) == part.shape[1]
    played = drained(queue)
    for k in range(N):
        alone = WaveformQueue(RATE, 1)
        alone.append(samples[k], rate, ())
        np.testing.assert_allclose(played[:, [k]], drained(alone), atol=1e-6)


def test_samples_are_dropped_for_the_named_contactors_alone() -> None:
    queue = WaveformQueue(RATE, N)
    queue.append(np.ones(400, np.float32), RATE, ())
    queue.append(np.ones(400, np.float32), RATE, (0, 1))
    queue.take(BLOCK)
    queue.clear((1,))
    assert [queue.waiting((k,)) * RATE for k in range(N)] == [784, 0, 384]
    assert queue.append(np.full(50, 3, np.float32), RATE, (1,)) == 50
    played = drained(queue)
    np.testing.assert_allclose(played[300], [1, 0, 1], atol=1e-6)
    np.testing.assert_allclose(played[600], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(played[45, 1], 3, atol=1e-6)
    np.testing.assert_allclose(np.diff(played[10:30, 1]), -1 / (ENDING * RATE), atol=1e-6)


@pytest.mark.parametrize("rate", [1000.0, 8000.0, 48000.0])
def test_what_does_not_fit_is_not_taken_and_fits_when_some_was_played(rate: float) -> None:
    queue = WaveformQueue(RATE, N)
    one = np.zeros(4000, np.float32)
    taken = 0
    for _ in range(20):
        taken += queue.append(one, rate, ())
    assert taken == int(rate), "a second"
    assert queue.append(one, rate, ()) == 0
    for _ in range(100):
        queue.take(BLOCK)
    room = min(100 * BLOCK / RATE * rate, len(one))
    assert queue.append(one, rate, ()) == pytest.approx(room, abs=2)


def test_more_than_a_second_waits_where_the_order_says_so() -> None:
    queue = WaveformQueue(RATE, N)
    long = np.ones(3 * int(RATE), np.float32)
    assert queue.append(long, RATE, (), 2.0) == 2 * RATE
    assert queue.waiting() == pytest.approx(2.0)
    assert queue.append(long, RATE, ()) == 0


def test_what_is_replaced_fades_within_its_time_and_without_a_step() -> None:
    queue = WaveformQueue(RATE, N)
    queue.append(np.ones(4000, np.float32), RATE, ())
    before = queue.take(BLOCK)
    assert before is not None
    queue.clear()
    after = drained(queue)
    both = np.concatenate([before, after])[8:]
    assert np.abs(np.diff(both, axis=0)).max() <= 1.01 / (ENDING * RATE)
    assert np.flatnonzero(after.any(axis=1))[-1] < ENDING * RATE
    assert queue.take(BLOCK) is None


def curve(
    amplitude: list[tuple[float, float]],
    frequency: list[tuple[float, float]] | None = None,
    transients: list[tuple[float, float, float]] | None = None,
    *,
    stream: bool = False,
) -> Curve:
    return Curve(
        2e-6,
        np.array(amplitude).reshape(-1, 2),
        np.array(frequency or []).reshape(-1, 2),
        np.array(transients or []).reshape(-1, 3),
        stream,
    )


def played(effect: EffectPlayer, seconds: float) -> Floats:
    parts = [effect.take(BLOCK) for _ in range(int(seconds * RATE / BLOCK))]
    zero = np.zeros((BLOCK, 1), np.float32)
    return np.concatenate([zero if p is None else p for p in parts])[:, 0].astype(np.float64)


@pytest.mark.parametrize("stream", [False, True])
def test_it_ends_with_its_last_point_or_is_held_where_it_streams(stream: bool) -> None:
    effect = EffectPlayer(RATE)
    effect.begin(curve([(0, 1), (0.1, 1)], stream=stream))
    wave = played(effect, 0.4)
    last = np.flatnonzero(wave)[-1] / RATE
    end = 0.1 + (0.05 if stream else 0) + ENDING  # held for 50 ms: the API (messages.py)
    assert end - 2e-3 < last <= end + BLOCK / RATE
    assert effect.take(BLOCK) is None


def test_a_stream_goes_on_without_a_step_in_amplitude_or_phase() -> None:
    effect = EffectPlayer(RATE)
    effect.begin(curve([(0, 1), (0.05, 1)], [(0, 100), (0.05, 100)], stream=True))
    first = played(effect, 0.03)
    effect.begin(curve([(0, 0.2), (0.05, 0.2)], [(0, 300), (0.05, 300)], stream=True))
    both = np.concatenate([first, played(effect, 0.03)])
    assert np.abs(np.diff(both)).max() < 2e-6 * 2 * np.pi * 300 / RATE


@pytest.mark.parametrize("rate", [1000.0, 11025.0, 12345.0, 48000.0])
def test_remembered_weights_are_those_of_the_same_times(rate: float) -> None:
    """The weights are exact to the nearest phase, and no more than `REMEMBERED` are kept."""
    interpolation = SincInterpolation(rate, RATE, zeros=8, shape=7.0)
    step, at, known = rate / RATE, 0.0, 0
    for _ in range(200):
        known += interpolation.remembers(at, step, BLOCK)
        dense = np.zeros((2, BLOCK, 400))
        times = np.asarray(at + step * np.arange(BLOCK), np.float64)
        for out, (first, weights) in zip(
            dense,
            (interpolation.equidistant_weights(at, step, BLOCK), interpolation.weights(times)),
            strict=True,
        ):
            begin = first - int(at) + 100
            out[:, begin : begin + weights.shape[1]] = weights
        np.testing.assert_allclose(dense[0], dense[1], atol=1e-5)
        at += step * BLOCK
    assert known == {1000.0: 199, 11025.0: 180, 12345.0: 0, 48000.0: 199}[rate]
    assert len(interpolation._remembered) == min(200 - known, REMEMBERED)
