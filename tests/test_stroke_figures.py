"""Figures of a stroke: against arithmetic on made shear, and against filters on a recording."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_rig import recorded
from playback_rig import RATE, stroke, swing
from scipy.signal import butter, sosfiltfilt

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.strength.figures import ShearFigures, StrokeMeter
from tactile.texture.surface import Texture

SPEED = 0.08
SECONDS = 2.0
TIME = np.arange(round(SECONDS * RATE)) / RATE
ALONG = np.outer(SPEED * TIME, [1.0, 0.0])
TONE = 1e-6 * np.sin(2 * np.pi * 250 * TIME)
"""Vibration at which the published threshold of motion along the skin is 0.45 × 0.1 µm [m]."""


def measured(
    display: Display, position: Floats, shear: Floats, played: Floats | None = None, block: int = 64
) -> StrokeMeter:
    """Return the meter of a stroke that is on a ramp in its first and last tenth of a second."""
    meter = StrokeMeter(display, RATE, 0.1, SECONDS - 0.1)
    for k in range(0, len(TIME), block):
        part = slice(k, k + block)
        meter.add(TIME[part], position[part], shear[part], None if played is None else played[part])
    return meter


def figures(display: Display, position: Floats, shear: Floats, block: int = 64) -> ShearFigures:
    result = measured(display, position, shear, block=block).commanded
    assert result is not None
    return result


def wide(display: Display, shear: Floats) -> Floats:
    """Return one shear at every contactor."""
    return np.repeat(shear[:, None], len(display.contactors), axis=1)


# Made shear


@pytest.mark.parametrize("block", [1, 64, 1000, 16000])
def test_a_tone_on_a_drag_is_told_apart_however_it_is_cut(pair: Display, block: int) -> None:
    """Tolerances are those of a tone's onset in a filter, and of its mean over 1.8 s."""
    result = figures(pair, ALONG, wide(pair, TONE - 5e-6), block)
    assert result.vibration_um_rms == pytest.approx(1 / np.sqrt(2), rel=2e-3)
    assert result.drag_um == pytest.approx(5.0, rel=1e-6)
    assert result.peak_um == pytest.approx(6.0, rel=1e-9)
    assert result.level_db_sl == pytest.approx(20 * np.log10(1 / 0.045), abs=0.05)
    assert result.level_hz == 250.0


@pytest.mark.parametrize(("frequency", "counts"), [(15.0, False), (25.0, True), (950.0, True),
                                                   (1050.0, False)])  # fmt: skip
def test_vibration_is_from_20_to_1000_hz(pair: Display, frequency: float, counts: bool) -> None:
    """What leaks over 5 Hz through the window of half a second is below 2 %."""
    tone = 1e-6 * np.sin(2 * np.pi * frequency * TIME)
    result = figures(pair, ALONG, wide(pair, tone)).vibration_um_rms
    assert result == pytest.approx(counts / np.sqrt(2), abs=0.03)


def test_what_differs_between_contactors_is_a_mean_in_power(pair: Display) -> None:
    shear = np.stack([TONE, 3 * TONE], axis=1)
    result = figures(pair, ALONG, shear)
    assert result.vibration_um_rms == pytest.approx(np.sqrt((1 + 9) / 2 / 2), rel=2e-3)
    assert result.peak_um == pytest.approx(3.0, rel=1e-6)


def test_drag_is_against_the_motion_wherever_it_goes(pair: Display) -> None:
    """Half a second each way, with a contactor along x and one across, which drags nothing."""
    turned = replace(pair, shear_direction=np.radians([0.0, 90.0]))
    there = np.where((TIME * 2).astype(int) % 2 == 0, 1.0, -1.0)
    position = np.cumsum(np.outer(there * SPEED / RATE, [1.0, 0.0]), axis=0)
    shear = np.stack([-5e-6 * there, np.full_like(there, 2e-6)], axis=1)
    assert figures(turned, position, shear).drag_um == pytest.approx(5.0 / 2, rel=1e-3)


@pytest.mark.parametrize("change", [
    lambda shear: shear.__setitem__(slice(0, 500), 1e-3),  # the first 5 mm are 62.5 ms
    lambda shear: shear.__setitem__(slice(0, 800), 1e-3),  # and the ramp 100 ms
    lambda shear: shear.__setitem__(slice(-800, None), 1e-3),
])  # fmt: skip
def test_onset_and_ramps_count_in_the_peak_alone(
    pair: Display, change: Callable[[Floats], None]
) -> None:
    steady = wide(pair, TONE - 5e-6)
    jumping = steady.copy()
    change(jumping)
    result = figures(pair, ALONG, jumping)
    assert result == replace(figures(pair, ALONG, steady), peak_um=result.peak_um)
    assert result.peak_um == pytest.approx(1000.0)


def test_a_finger_that_begins_late_has_its_onset_there(pair: Display) -> None:
    """The shear is another in the second in which it rests.

    A tone that does not begin at a zero rings in the filter, which takes its first value for what
    was always there: by less than 1 % of the mean over 0.8 s.
    """
    position = np.outer(SPEED * np.maximum(TIME - 1.0, 0.0), [1.0, 0.0])
    late = np.where(TIME < 1.0625, 7e-6, TONE - 5e-6)
    result = figures(pair, position, wide(pair, late))
    assert result.drag_um == pytest.approx(5.0, rel=1e-3)
    assert result.vibration_um_rms == pytest.approx(1 / np.sqrt(2), rel=1e-2)


def test_a_stroke_without_a_steady_part_has_no_figures(pair: Display) -> None:
    resting = measured(pair, np.zeros((len(TIME), 2)), wide(pair, TONE), wide(pair, TONE))
    assert resting.commanded is None
    assert resting.played is None


def test_what_is_played_is_measured_on_the_same_samples(pair: Display) -> None:
    """The filter rings at the beginning by less than 1 % of the mean."""
    meter = measured(pair, ALONG, wide(pair, TONE - 5e-6), wide(pair, TONE / 2 - 4e-6))
    assert meter.played is not None
    assert meter.played.vibration_um_rms == pytest.approx(0.5 / np.sqrt(2), rel=1e-2)
    assert (meter.played.drag_um, meter.played.peak_um) == pytest.approx((4.0, 4.5), rel=1e-6)


@pytest.mark.parametrize(("micro", "text"), [
    (0.16, "felt: 11 dB above threshold at 250 Hz"),
    (0.036, "not felt: 2 dB below threshold at 250 Hz"),
    (0.0, "not felt: no vibration"),
])  # fmt: skip
def test_whether_it_is_felt_is_said_with_the_distance_to_the_threshold(
    pair: Display, micro: float, text: str
) -> None:
    assert figures(pair, ALONG, wide(pair, micro * TONE)).sensation == text


# A recording


@pytest.mark.parametrize("trajectory", [stroke(2.0), swing(2.0)], ids=["stroke", "swing"])
def test_a_run_tells_what_filters_find_in_its_recording(
    display: Display, oak: Texture, tmp_path: Path, trajectory: Trajectory
) -> None:
    """Another filter, forward and backward on the whole steady part, and a plain mean.

    A window weighs the middle of a stroke more than its ends, where noise is by chance stronger or
    weaker by 0.1 dB.
    """
    summary = run(display, oak, trajectory, record=tmp_path / "r.npz")
    r = recorded(tmp_path / "r.npz")
    way = np.cumsum(np.hypot(*np.diff(r["position_mm"], axis=0, prepend=0.0).T))
    first = max(int(np.argmax(way >= 5.0)), round(0.02 * RATE))
    steady = slice(first, -round(0.02 * RATE))
    direction = np.sign(np.gradient(r["position_mm"][:, 0]))[steady, None]
    sos = butter(20, [20, 1000], "bandpass", fs=RATE, output="sos")
    for result, name in ((summary.commanded, "target"), (summary.played, "played")):
        assert result is not None
        shear = r[f"shear_{name}_m"][steady] * 1e6
        vibration = np.sqrt(np.mean(sosfiltfilt(sos, shear, axis=0) ** 2))
        assert 20 * np.log10(result.vibration_um_rms / vibration) == pytest.approx(0, abs=0.2)
        assert result.drag_um == pytest.approx(np.mean(-direction * shear), rel=1e-3)
