"""Position that a pointer on the page gives the amplifier: its arithmetic, and one real stroke.

How exactly the position follows is measured by ``python -m benchmarks page-position``; here, that
is printed and decides nothing, since it depends on the pace of the machine. Where the finger comes
to rest does not: the grating tells the place on it, and both kinds of pointers must reach it.
"""

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from node_rig import miss

from benchmarks import BENCHMARKS, page_position
from benchmarks.page import TRIES, no_browser
from benchmarks.page_position import (
    GRATING,
    REST,
    TURN,
    WAVELENGTH,
    PlayedPosition,
    PointerStroke,
    WantedStroke,
    errors_of,
    grating_offered,
    played_position,
    strokes_played,
    to_and_fro,
)
from benchmarks.virtual import NO_AMPLIFIER, Records, can_be_built
from firmware_protocol.messages import FULL_SCALE_CODE, State
from tactile.arrays import Floats
from tactile.bench.figures import RATE
from tactile.display.display import Display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Rendering, render
from tactile.texture.surface import load_texture

SPEED, SPAN, SECONDS = 0.2, 0.09, 4.0
"""Speed [m/s], distance between the turns [m] and duration [s] of the strokes."""


def place(times: Floats) -> Floats:
    """Return a place that rests, goes to and fro, and rests again (S,) [m]."""
    return 0.013 + to_and_fro(SPEED, SPAN, np.clip(times - 2 * REST, 0.0, SECONDS))


@pytest.fixture
def stroke() -> PointerStroke:
    times = np.arange(0, SECONDS + 4 * REST, 0.008)
    end = float(times[-1])
    wanted = WantedStroke("mouse", SPEED, SECONDS)
    return PointerStroke(
        wanted, times, place(times), np.full(len(times), 0.002), np.array([end, end])
    )


def test_positions_are_measured_by_default() -> None:
    """Check that the benchmark is among those that run by default."""
    assert BENCHMARKS["page-position"] is page_position.measure_page_position


def test_without_a_browser_the_figure_says_what_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that one figure without a value names the missing program."""
    monkeypatch.setattr(shutil, "which", lambda name: None)
    (figure,) = page_position.position_figures()
    assert math.isnan(figure.value)
    assert "chromium" in figure.reason


def test_the_path_has_its_speed_between_turns_at_the_ends_of_its_span() -> None:
    """A turn of a tenth of a second adds at each end what the finger goes while it brakes."""
    times = np.arange(0, 3.0, 1e-3)
    path = to_and_fro(SPEED, SPAN, times)
    speed = np.abs(np.gradient(path, times))
    assert speed.max() == pytest.approx(SPEED, rel=1e-3)
    assert np.mean(speed > 0.99 * SPEED) > 1 - TURN / (SPAN / SPEED)
    assert path.min() == pytest.approx(0, abs=1e-4)
    assert path.max() == pytest.approx(SPAN + SPEED * TURN * 2 / math.pi, abs=1e-3)
    assert to_and_fro(SPEED, SPAN, np.array([-1.0, 0.0])).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("latency", [0.0, 0.004, 0.015])
def test_a_latency_is_no_error_and_what_is_beside_the_pointer_is(
    stroke: PointerStroke, latency: float
) -> None:
    """Play late, and 0.2 mm beside the pointer, a multiple of the wavelength away.

    Steps of 8 ms on a straight path leave no error of interpolation.
    """
    times = np.arange(0, stroke.rested[1], 1 / RATE)
    beside = 2e-4 * np.sin(2 * np.pi * 40 * times) * (times > 2 * REST) * (times < 2 * REST + 4)
    played = PlayedPosition(times, place(times - latency) + beside + 7 * WAVELENGTH)
    errors = errors_of(stroke, played)
    assert errors.latency == pytest.approx(latency, abs=2e-5)
    assert np.abs(errors.steady).max() == pytest.approx(2e-4, rel=0.02)
    assert len(errors.steady) > RATE
    assert np.abs(errors.resting).max() < 1e-6
    assert errors.unknown == pytest.approx(0, abs=1e-3)


def test_what_was_not_played_is_unknown_and_has_no_errors(stroke: PointerStroke) -> None:
    """Check that a display that played only the first rest leaves the rest of a stroke unknown."""
    times = np.arange(0, 2 * REST, 1 / RATE)
    errors = errors_of(stroke, PlayedPosition(times, place(times)))
    assert math.isnan(errors.latency)
    assert not len(errors.resting)
    assert errors.unknown > 0.8


def rendered(display: Display, folder: Path) -> Rendering:
    """Render the stroke over the grating, without a server."""
    with grating_offered(folder):
        texture = load_texture(GRATING)
    times = np.arange(0, SECONDS + 4 * REST, 0.002)
    position = np.stack([place(times), np.zeros(len(times))], axis=1)
    return render(display, texture, Trajectory(times, position, 0.5))


def test_the_position_is_found_in_the_drive(
    display: Display, stroke: PointerStroke, tmp_path: Path
) -> None:
    """Render the stroke without a server: the drive is early by the response of the display.

    That is 0.18 ms. What is left is below 2 µm: codes of 0.1 ‰ of the grating, and the response at
    the frequencies beside that of a constant speed.
    """
    drive = rendered(display, tmp_path).drive
    count = len(drive)
    codes = np.rint(drive / display.limits.voltage * FULL_SCALE_CODE).astype(np.int16)
    states = np.full(count, State.RUNNING, np.uint8)
    states[-10:] = State.IDLE  # of these nothing may be taken
    ticks = np.rint(np.arange(count) * 1e6 / RATE).astype(np.uint64)
    positions = np.arange(count, dtype=np.uint32)
    halves = (slice(0, count // 2), slice(count // 2, count))
    record = [Records(ticks[h], positions[h], states[h], codes[h], states[h]) for h in halves]
    played = played_position(record, 5.0)
    assert len(played.times) == count - 10
    assert played.times[0] == 5.0
    errors = errors_of(stroke, PlayedPosition(played.times - 5.0, played.places))
    assert errors.latency == pytest.approx(-1.8e-4, abs=2e-5)
    assert np.abs(errors.steady).max() < 1e-5
    assert np.abs(errors.resting).max() < 1e-5


@pytest.mark.realtime
def test_mouse_and_touch_bring_the_amplifier_to_the_place_of_the_pointer() -> None:
    """A resting finger is known to its last event; the tracker takes it for still within 0.13 mm.

    Strokes are repeated while the display does not play at their end, as where a link is lost.
    """
    if why := no_browser() or ("" if can_be_built() else NO_AMPLIFIER):
        if sys.platform != "linux":
            pytest.skip(why)
        miss(why)
    wanted = [WantedStroke(pointer, 0.1, 1.6) for pointer in ("mouse", "touch")]
    for _ in range(TRIES):
        played = strokes_played(wanted)
        if all(len(errors.resting) for _, errors in played):
            break
    for stroke, errors in played:
        steady = 1e3 * np.abs(errors.steady)
        if not len(errors.resting):
            print(f"\n{stroke.wanted.pointer}: the link was lost {TRIES} times")
            continue
        assert len(stroke.handed_over) > 20
        assert abs(stroke.places[-1] - stroke.places[0]) % WAVELENGTH > 1e-3
        assert np.abs(np.median(errors.resting)) < 3e-4
        part95 = np.percentile(steady, 95) if len(steady) else math.nan
        latency = 1e3 * errors.latency
        print(f"\n{stroke.wanted.pointer}: {latency:.1f} ms late, 95 % within {part95:.2f} mm")
