"""The largest gain of a stroke: the drive comes to the named limit, and no sample beyond it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_rig import Command
from playback_rig import swing
from strength_rig import few

from tactile.display.display import Display
from tactile.errors import InputError
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.strength.strength import amplified
from tactile.texture.surface import Texture, load_texture


@pytest.mark.parametrize("trajectory", [Trajectory.line(speed=0.08, duration=2.0), swing(1.0)])
@pytest.mark.parametrize("seed", [0, 3])
def test_a_stroke_reaches_the_voltage_limit_and_is_not_limited(
    pair: Display, calf: Texture, trajectory: Trajectory, seed: int
) -> None:
    summary = run(pair, calf, trajectory, device="mock:", gain="auto", seed=seed)
    assert summary.gain_limit == "voltage"
    assert 0.985 * 100 < summary.peak_drive_v <= 100
    assert summary.limited_samples == 0
    louder = run(pair, calf, trajectory, device="mock:", gain=1.03 * summary.gain, seed=seed)
    assert louder.limited_samples > 0


@pytest.mark.parametrize("limit", ["slew", "current"])
def test_a_slow_amplifier_is_the_limit_that_is_named(pair: Display, limit: str) -> None:
    slow = {"slew": 2e4} if limit == "slew" else {"current": 2e4 * pair.capacitance}
    limited = replace(pair, limits=replace(pair.limits, **slow))
    line, suede = Trajectory.line(speed=0.08, duration=1.0), load_texture("leather-suede")
    summary = run(limited, suede, line, device="mock:", gain="auto")
    assert summary.gain_limit == limit
    assert summary.limited_samples == 0
    assert summary.peak_drive_v < 80
    louder = run(limited, suede, line, device="mock:", gain=1.03 * summary.gain)
    assert louder.limited_samples > 0


def test_a_stroke_plays_the_largest_gain_where_there_is_one_and_else_gain_1(
    command: Command, tmp_path: Path
) -> None:
    """Textures play the largest gain without the option, all else as its file says."""
    stroke = ["play", "leather-calf", "--device", "mock:", "--seconds", 0.2, "--json"]
    default, largest = (command(*stroke, *more).json for more in ([], ["--gain", "auto"]))
    assert default["gain"] == largest["gain"] > 1
    assert default["gain_limit"] == "voltage"
    (tmp_path / "rest.csv").write_text("time_s,x_mm,y_mm,normal_force_n\n0,0,0,0.5\n0.2,0,0,0.5\n")
    (tmp_path / "tap.ahap").write_text(
        '{"Pattern": [{"Event": {"Time": 0.0, "EventType": "HapticTransient"}}]}'
    )
    at_rest = ["leather-calf", "--path", tmp_path / "rest.csv"]
    for played in (at_rest, [tmp_path / "tap.ahap"]):
        summary = command("play", *played, "--device", "mock:", "--json").json
        assert (summary["gain"], summary["gain_limit"]) == (1.0, None)
        refused = command("play", *played, "--device", "mock:", "--gain", "auto")
        assert refused.code == 2
        assert "gain auto" in refused.err


def test_a_finger_at_rest_and_a_silent_texture_have_no_largest_gain(
    pair: Display, oak: Texture
) -> None:
    rest = Trajectory([0.0, 1.0], np.zeros((2, 2)), 0.5)
    with pytest.raises(InputError, match="the finger moves by 0 mm; needs at least 5 mm"):
        run(pair, oak, rest, device="mock:", gain="auto")
    line = Trajectory.line(speed=0.08, duration=0.2)
    with pytest.raises(InputError, match="nothing to play in this stroke"):
        run(few(pair, 0), amplified(oak, 0.0), line, device="mock:", gain="auto")
