"""Tests of whole runs: movement of the skin, recordings, reports, and faults.

The whole chain is judged by its end: what the simulated skin did against what it was to do.
"""

import math
import os
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import recorded
from numpy.typing import NDArray
from playback_rig import FIDELITY, RATE, SLIDE, played, stroke, swing
from scipy.signal import butter, sosfilt

from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.arrays import Floats
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.simulated.mock_bus import MockBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError, InputError, TactileError
from tactile.playback import runs
from tactile.playback.outcome import Outcome
from tactile.playback.runs import Summary, run
from tactile.playback.trajectory_playback import PlayedBlock
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import Texture

# Movement of the skin


def heard(shear: Floats) -> Floats:
    """Return shear in 20–1000 Hz."""
    sos = butter(4, [20, 1000], "bandpass", fs=RATE, output="sos")
    return np.asarray(sosfilt(sos, shear, axis=0))


def signal_to_error(target: Floats, skin: Floats) -> float:
    """Return the ratio in 20–1000 Hz over a whole recording [dB]."""
    return float(
        10 * np.log10(np.sum(heard(target) ** 2) / np.sum(heard(skin - target) ** 2))
    )  # fmt: skip


@pytest.mark.parametrize("trajectory", [stroke(1.0), swing(1.5)], ids=["stroke", "swing"])
def test_the_skin_follows_an_oak_over_the_whole_recording(
    display: Display, oak: Texture, tmp_path: Path, trajectory: Trajectory
) -> None:
    target = tmp_path / "oak.npz"
    summary = run(display, oak, trajectory, device="sim:", record=target)
    r = recorded(target)
    count = round(trajectory.duration * RATE)
    assert len(r["shear_played_m"]) == len(r["shear_target_m"]) == count
    ratio = signal_to_error(r["shear_target_m"], r["shear_played_m"])
    assert ratio >= FIDELITY
    # the filter's state carries rounding, no more
    assert summary.signal_to_error_db == pytest.approx(ratio, abs=1e-6)


def test_one_sample_of_misalignment_would_be_noticed(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    """The same recording, shifted by one sample of 125 µs, fails the 45 dB."""
    run(display, oak, stroke(1.0), device="sim:", record=tmp_path / "oak.npz")
    r = recorded(tmp_path / "oak.npz")
    for shift in (-1, 1):
        skin = np.roll(r["shear_played_m"], shift, axis=0)
        assert signal_to_error(r["shear_target_m"], skin) < FIDELITY - 10


def test_a_recorded_slide_of_a_finger_is_followed(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    if not SLIDE.is_file():
        assert os.environ.get("CI") != "true", f"{SLIDE} is missing"
        pytest.skip(f"{SLIDE} is missing: it may not be shipped with the project")
    slide = Trajectory.from_csv(SLIDE)
    target = tmp_path / "slide.npz"
    summary = run(display, oak, slide, device="sim:", record=target)
    r = recorded(target)
    assert summary.faults == {}
    assert summary.limited_samples == summary.invalid_samples == 0
    assert summary.seconds == pytest.approx(slide.duration, abs=1 / RATE)
    assert signal_to_error(r["shear_target_m"], r["shear_played_m"]) >= FIDELITY
    place = slide.at(r["time_s"])[0] * 1e3
    np.testing.assert_allclose(r["position_mm"], place, rtol=0, atol=1e-9)
    assert np.ptp(r["position_mm"][:, 0]) == pytest.approx(91, abs=1)


@pytest.mark.parametrize("missing", ["true", ""])
def test_under_ci_a_missing_slide_is_a_failure_elsewhere_it_is_skipped(
    display: Display, oak: Texture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setattr(sys.modules[__name__], "SLIDE", tmp_path / "none.csv")
    monkeypatch.setenv("CI", missing)
    expected = AssertionError if missing else pytest.skip.Exception
    with pytest.raises(expected, match="missing"):
        test_a_recorded_slide_of_a_finger_is_followed(display, oak, tmp_path)


# A run


KEYS = {
    "drive_v", "shear_target_m", "time_s", "position_mm", "sample_rate_hz", "contactors_mm",
    "path_time_s", "path_position_m", "path_normal_force_n",
}  # fmt: skip


def test_the_recording_holds_what_was_played(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    trajectory = swing(0.3, begin=2.0)
    run(display, oak, trajectory, device="sim:", record=tmp_path / "r.npz")
    r = recorded(tmp_path / "r.npz")
    p = played(display, oak, trajectory)
    assert set(r) == KEYS | {"shear_played_m"}
    assert np.array_equal(r["drive_v"], p.all("drive"))
    assert np.array_equal(r["shear_target_m"], p.all("shear"))
    assert np.array_equal(r["time_s"], p.all("time"))
    np.testing.assert_allclose(r["position_mm"], p.all("position") * 1e3, rtol=1e-15)
    assert r["sample_rate_hz"] == RATE
    np.testing.assert_allclose(r["contactors_mm"], display.contactors * 1e3, rtol=1e-15)


def in_air(display: Display, frequency: Floats) -> Floats:
    """Return the size of the response of a free tip [m/V]."""
    return np.asarray(
        np.abs(tip_response(display.bimorph, FingerLoad.none(), frequency).displacement)
    )


def test_the_summary_says_what_the_recording_holds(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    target = tmp_path / "r.npz"
    s = run(display, oak, swing(0.5), device="sim:", record=target)
    r = recorded(target)
    assert (s.texture, s.display, s.device) == ("wood-oak", "reference-24", "sim:")
    assert (s.seconds, s.samples, s.voltage_limit_v) == (0.5, 4000, 100.0)
    assert s.peak_drive_v == np.abs(r["drive_v"]).max()
    for figures, name in ((s.commanded, "shear_target_m"), (s.played, "shear_played_m")):
        assert figures is not None
        assert figures.peak_um == pytest.approx(np.abs(r[name]).max() * 1e6, rel=1e-12)
    assert s.limited_samples == s.invalid_samples == 0
    assert s.faults == {}
    assert s.recording == str(target)
    frequency = np.arange(0.0, 1001.0, 10.0)
    response = np.abs(display.responses(frequency, RATE))
    volts = np.minimum(100, display.actuator.largest_travel / in_air(display, frequency))
    assert s.attainable_um == pytest.approx((response * volts).min() * 1e6, rel=1e-9)
    assert 0 < s.equalizer_error_db < 0.1, "the equalizer's docstring says 0.04 dB"
    assert s.peak_current_ma is not None
    assert 0 < s.peak_current_ma < 10, "the display's limit"
    assert s.outcome == Outcome(4000, 4000)
    fields = {name: getattr(s, name) for name in Summary.__dataclass_fields__}
    assert s.commanded is not None
    assert s.played is not None
    nested = {
        "outcome": asdict(s.outcome), "commanded": asdict(s.commanded), "played": asdict(s.played),
    }  # fmt: skip
    assert s.as_dict() == fields | nested


def test_without_a_simulated_skin_there_is_no_played_shear(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    trajectory, target = swing(0.3), tmp_path / "mock.npz"
    s = run(display, oak, trajectory, device="mock:", record=target)
    assert s.signal_to_error_db is None
    assert s.played is None
    assert s.peak_current_ma is None
    assert s.device == "mock:"
    r = recorded(target)
    assert set(r) == KEYS
    run(display, oak, trajectory, device="sim:", record=tmp_path / "sim.npz")
    simulated = recorded(tmp_path / "sim.npz")
    for name in KEYS:
        assert np.array_equal(r[name], simulated[name])


def test_all_of_the_shear_is_recorded_however_short_the_fade(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    """The last shear is felt a plant's delay of 16 samples later than a fade of 8 samples ends."""
    quick = replace(display, limits=replace(display.limits, fade=1e-3))
    run(quick, oak, stroke(0.1), device="sim:", record=tmp_path / "r.npz")
    r = recorded(tmp_path / "r.npz")
    assert len(r["shear_played_m"]) == len(r["drive_v"]) == 800


def test_without_a_recording_the_summary_is_the_same(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    with_one = run(display, oak, swing(0.2), record=tmp_path / "r.npz")
    without = run(display, oak, swing(0.2))
    assert without.recording is None
    assert replace(with_one, recording=None) == without


def test_another_seed_is_another_surface_and_the_same_seed_the_same(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    shears = []
    for k, seed in enumerate((0, 7, 7)):
        run(display, oak, stroke(0.2), device="mock:", seed=seed, record=tmp_path / f"{k}.npz")
        shears.append(recorded(tmp_path / f"{k}.npz")["shear_target_m"])
    assert np.array_equal(shears[1], shears[2])
    # two independent surfaces differ by √2 of their size
    assert np.std(shears[0] - shears[1]) > 0.5 * np.std(shears[1])


@pytest.mark.parametrize("rate", [4000.0, 16000.0])
def test_another_sample_rate_is_followed_as_well(
    display: Display, oak: Texture, tmp_path: Path, rate: float
) -> None:
    s = run(display, oak, stroke(0.5), sample_rate=rate, record=tmp_path / "r.npz")
    r = recorded(tmp_path / "r.npz")
    assert r["sample_rate_hz"] == rate
    assert s.samples == len(r["time_s"]) == round(0.5 * rate)
    assert s.seconds == 0.5
    assert s.signal_to_error_db is not None
    # 4 kHz leave the equalizer a narrower free band
    assert s.signal_to_error_db >= (FIDELITY if rate > 8000 else 35.0)


def test_whoever_watches_sees_each_block_with_the_renderer(display: Display, oak: Texture) -> None:
    seen: list[tuple[int, int]] = []

    def watch(block: PlayedBlock, renderer: Renderer) -> None:
        seen.append((len(block.time), renderer.limiter.limited_samples))

    s = run(display, oak, stroke(0.2), device="mock:", watch=watch)
    assert sum(size for size, _ in seen) == s.samples == 1600
    assert {count for _, count in seen} == {0}


def test_an_oak_that_is_too_strong_is_limited_and_the_summary_says_so(
    display: Display, oak: Texture
) -> None:
    weak = replace(display, limits=replace(display.limits, voltage=5.0))
    s = run(weak, oak, stroke(0.3), device="mock:")
    assert s.limited_samples > 0
    assert s.peak_drive_v <= s.voltage_limit_v == 5.0
    assert s.faults == {}, "the limiter keeps what the bus allows"


@pytest.mark.ci
def test_memory_does_not_grow_with_the_length_of_a_run(
    display: Display, oak: Texture, tmp_path: Path
) -> None:
    """Another 0.3 s beyond the second that the bus keeps would be 1.4 MB of drive, two shears."""
    used: list[int] = []

    def watch(block: PlayedBlock, renderer: Renderer) -> None:
        used.append(tracemalloc.get_traced_memory()[0])

    tracemalloc.start()
    try:
        run(display, oak, stroke(1.5), device="sim:", record=tmp_path / "r.npz", watch=watch)
    finally:
        tracemalloc.stop()
    early, late = round(1.1 * RATE / 64), round(1.4 * RATE / 64)
    assert used[late] - used[early] < 0.1e6


# Faults


class Failing:
    """Plays on ``mock:?keep=all``, whose bus it keeps to be looked at, and fails on the way."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bus: MockBus | None = None
        monkeypatch.setattr(runs, "open_bus", self._open)

    def _open(self, url: str, display: Display, **_: object) -> Bus:
        bus = open_bus("mock:?keep=all", display)
        assert isinstance(bus, MockBus)
        self.bus = bus
        return bus

    def assert_aborted(self, display: Display, blocks: int) -> None:
        assert self.bus is not None
        assert self.bus.state == "closed"
        assert not self.bus.output[-1].any()
        slew = display.limits.slew / RATE
        longest = math.ceil(display.limits.voltage / slew)
        assert 64 * blocks < len(self.bus.output) <= 64 * blocks + longest, "not the fade"


@pytest.mark.parametrize("kind", [ValueError, InputError])
def test_whatever_goes_wrong_aborts_the_stream_and_leaves_no_recording(
    display: Display,
    oak: Texture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: type[BaseException],
) -> None:
    failing, seen = Failing(monkeypatch), []

    def watch(block: PlayedBlock, renderer: Renderer) -> None:
        seen.append(block)
        if len(seen) == 20:
            raise kind("no more")

    with pytest.raises(kind, match="no more"):
        run(display, oak, stroke(0.5), record=tmp_path / "r.npz", watch=watch)
    failing.assert_aborted(display, 20)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_aborts_the_stream_and_keeps_what_was_played(
    display: Display, oak: Texture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing, seen = Failing(monkeypatch), list[PlayedBlock]()

    def watch(block: PlayedBlock, renderer: Renderer) -> None:
        seen.append(block)
        if len(seen) == 20:
            raise KeyboardInterrupt

    summary = run(display, oak, stroke(0.5), record=tmp_path / "r.npz", watch=watch)
    failing.assert_aborted(display, 20)
    drive = np.concatenate([block.drive for block in seen])
    outcome = summary.outcome
    assert (outcome.ending, outcome.cause) == ("interrupted", "interrupted")
    assert (outcome.planned_samples, outcome.put_out_samples) == (4000, len(drive))
    recording = recorded(tmp_path / "r.npz")["drive_v"]
    assert np.array_equal(recording, drive[: len(recording)])
    assert len(drive) - len(recording) <= 64, "the last block may have no played shear yet"


def test_ctrl_c_before_the_first_block_is_passed_on(
    display: Display, oak: Texture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(bus: MockBus, position: int = 0) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(MockBus, "_start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(display, oak, stroke(0.5), record=tmp_path / "r.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_bus_that_fails_is_reported_with_what_was_put_out(
    display: Display, oak: Texture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = Failing(monkeypatch)
    put: Callable[[MockBus, Floats, NDArray[np.uint8]], None] = MockBus._put

    def unplugged(bus: MockBus, volts: Floats, lines: NDArray[np.uint8]) -> None:
        if bus.counters.blocks == 10 and bus.state == "running":
            raise BusError("the amplifier is gone")
        put(bus, volts, lines)

    monkeypatch.setattr(MockBus, "_put", unplugged)
    outcome = run(display, oak, stroke(0.5), record=tmp_path / "r.npz").outcome
    failing.assert_aborted(display, 9)
    assert (outcome.ending, outcome.cause) == ("failed", "the amplifier is gone")
    assert outcome.planned_samples == 4000
    assert 64 * 8 <= outcome.put_out_samples <= 64 * 10
    assert 0 < len(recorded(tmp_path / "r.npz")["drive_v"]) <= 64 * 10


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"device": "moc:"}, "did you mean 'mock:'"),
        ({"device": "mock:?kep=all"}, "did you mean 'keep'"),
        ({"record": Path("missing-folder") / "r.npz"}, "cannot be written"),
        ({"sample_rate": 1000.0}, "sample_rate 1000 Hz"),
    ],
)
def test_what_cannot_be_used_is_a_tactile_error_before_anything_plays(
    display: Display,
    oak: Texture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: dict[str, Any],
    error: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    written: list[DriveBlock] = []
    monkeypatch.setattr(MockBus, "_write", lambda bus, block: written.append(block))
    with pytest.raises(TactileError, match=error) as found:
        run(display, oak, stroke(0.2), **{"record": Path("r.npz"), **options})
    assert "\n" not in str(found.value)
    assert written == []
    assert list(tmp_path.iterdir()) == []
