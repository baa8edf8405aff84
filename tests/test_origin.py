"""Tests of what a recording says about its origin, and of recordings that were interrupted."""

import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import KEYS, SHORT, Command, provenance_of, recorded
from playback_rig import RATE, stroke, swing

from tactile.arrays import Floats
from tactile.display import display as displays
from tactile.display.display import Display
from tactile.files import shipped_names
from tactile.playback.origin import Sources
from tactile.playback.recording import Recorder
from tactile.playback.runs import run
from tactile.texture import surface
from tactile.texture.surface import Texture

KINDS = pytest.mark.parametrize("kind", [".h5", ".npz"])


@KINDS
def test_a_recording_says_what_it_was_rendered_from(command: Command, kind: str) -> None:
    played = [
        "--gain", 1.7, "--seed", 3, "--sample-rate-hz", 16000, "--device", "mock:?keep=all",
        "--display", "reference-64",
    ]  # fmt: skip
    target = Path(f"oak{kind}")
    assert command("play", "wood-oak", *SHORT, *played, "--record", target, "--quiet").code == 0
    p = provenance_of(target)
    assert (p["format"], p["texture"], p["display"]) == (1, "wood-oak", "reference-64")
    assert (p["device"], p["gain"], p["seed"]) == ("mock:?keep=all", 1.7, 3)
    assert p["sample_rate_hz"] == 16000
    assert p["limits"] == {
        "voltage_v": 100.0,
        "slew_v_per_us": pytest.approx(0.7, rel=1e-15),
        "current_ma": pytest.approx(10.0, rel=1e-15),
        "fade_ms": 20.0,
    }
    assert p["outcome"]["planned_samples"] == p["outcome"]["put_out_samples"] == 1600
    assert (p["outcome"]["ending"], p["outcome"]["cause"]) == ("complete", "")
    assert p["counters"]["samples"] >= 1600
    assert p["counters"]["dropped_samples"] == 0
    for name in ("numpy", "scipy"):
        assert p["versions"][name] == version(name)
    assert p["versions"]["python"] == platform.python_version()
    for kind_of, name in (("displays", "reference-64"), ("textures", "wood-oak")):
        source = p["sources"][kind_of[:-1]]
        assert source["name"] == f"{name}.toml"
        assert source["text"] == shipped_names(kind_of)[name].read_text("utf-8")


@KINDS
def test_the_path_of_the_finger_is_stored_bit_for_bit(
    display: Display, oak: Texture, tmp_path: Path, kind: str
) -> None:
    trajectory, target = swing(0.1, begin=2.0), tmp_path / f"r{kind}"
    run(display, oak, trajectory, device="mock:", record=target)
    r = recorded(target)
    assert r["path_time_s"].tobytes() == trajectory.time.tobytes()
    assert r["path_position_m"].tobytes() == trajectory.position.tobytes()
    assert r["path_normal_force_n"].tobytes() == trajectory.normal_force.tobytes()
    assert provenance_of(target)["sources"] is None


def interrupting(monkeypatch: pytest.MonkeyPatch, call: int, *, after: bool) -> None:
    """Interrupt a call of `Recorder.add`, before or after it has added."""
    add: Callable[..., None] = Recorder.add
    calls: list[int] = []

    def interrupted(self: Recorder, **arrays: Floats) -> None:
        calls.append(1)
        if len(calls) != call or after:
            add(self, **arrays)
        if len(calls) == call:
            raise KeyboardInterrupt

    monkeypatch.setattr(Recorder, "add", interrupted)


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("device", ["sim:", "mock:"])
@KINDS
def test_an_interrupted_recording_is_a_beginning_of_the_whole_one(
    display: Display,
    oak: Texture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    device: str,
    after: bool,
) -> None:
    """A block on ``sim:`` that waits for its shear must not follow the one that is missing."""
    whole, target = tmp_path / f"whole{kind}", tmp_path / f"r{kind}"
    run(display, oak, stroke(0.2), device=device, record=whole)
    interrupting(monkeypatch, 6, after=after)
    run(display, oak, stroke(0.2), device=device, record=target)
    r, expected = recorded(target), recorded(whole)
    count = len(r["time_s"])
    assert 0 < count < round(0.2 * RATE)
    assert set(r) == set(expected)
    for name in ("time_s", "position_mm", "drive_v", "shear_target_m"):
        assert np.array_equal(r[name], expected[name][:count])
    outcome = provenance_of(target)["outcome"]
    assert (outcome["ending"], outcome["cause"]) == ("interrupted", "interrupted")


@KINDS
def test_a_recording_that_ends_before_its_first_row_has_all_of_its_arrays(
    display: Display,
    oak: Texture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
) -> None:
    target = tmp_path / f"r{kind}"
    interrupting(monkeypatch, 2, after=False)
    run(display, oak, stroke(0.2), device="sim:", record=target)
    r = recorded(target)
    assert set(r) == KEYS
    assert r["drive_v"].shape == r["shear_played_m"].shape == (0, 24)


@KINDS
def test_a_recording_says_why_it_is_incomplete_when_the_link_dies(
    display: Display, oak: Texture, tmp_path: Path, kind: str
) -> None:
    """Samples after the loss are rendered and recorded as well, but dropped by the bus."""
    target = tmp_path / f"r{kind}"
    device = "mock:?link=serial&bit_rate=3000000&disconnect_s=0.5"
    summary = run(display, oak, stroke(1.0), device=device, record=target)
    p = provenance_of(target)
    assert p["outcome"] == summary.as_dict()["outcome"]
    assert p["outcome"]["link"] == "down"
    assert "the device is gone" in p["outcome"]["cause"]
    assert p["outcome"]["put_out_samples"] < p["outcome"]["planned_samples"] == 8000
    faults = {name: n for name, n in p["counters"].items() if n and name in summary.faults}
    assert faults == summary.faults
    assert p["counters"]["disconnects"] > 0
    assert len(recorded(target)["drive_v"]) == 8000


def test_the_texts_are_those_that_were_read(tmp_path: Path) -> None:
    display, display_source = displays.load_with_source("reference-24")
    texture, texture_source = surface.load_with_source("wood-oak")
    target = tmp_path / "r.h5"
    run(
        display, texture, stroke(0.05), device="mock:", record=target,
        sources=Sources(display_source, texture_source),
    )  # fmt: skip
    stored: Any = provenance_of(target)["sources"]
    assert stored["display"]["text"] == display_source.text
    assert stored["texture"]["text"] == texture_source.text
