"""``tactile play``: what it prints, what it writes, and what it draws on a terminal."""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_rig import KEYS, SHORT, Command, recorded, started

from tactile.bus import base
from tactile.files import shipped
from tactile.playback.outcome import Outcome
from tactile.playback.runs import Summary

# Play


def test_play_writes_a_recording_with_exactly_these_arrays(command: Command) -> None:
    result = command("play", "wood-oak", *SHORT, "--record", "oak.npz", "--quiet")
    assert (result.code, result.out, result.err) == (0, "", "")
    r = recorded(Path("oak.npz"))
    assert set(r) == KEYS
    assert {name: array.shape for name, array in r.items()} == {
        "drive_v": (800, 24),
        "shear_target_m": (800, 24),
        "shear_played_m": (800, 24),
        "time_s": (800,),
        "position_mm": (800, 2),
        "sample_rate_hz": (),
        "contactors_mm": (24, 2),
        "path_time_s": (2,),
        "path_position_m": (2, 2),
        "path_normal_force_n": (2,),
    }
    assert all(np.all(np.isfinite(array)) for array in r.values())
    assert os.listdir() == ["oak.npz"]


@pytest.mark.ci
def test_as_a_process_it_plays_records_and_prints_one_line_of_json(
    command: Command, tmp_path: Path
) -> None:
    """The same run in this process gives the same figures but for rounding in single precision."""
    arguments = ["play", "wood-oak", "--seconds", 0.2, "--json", "--record"]
    theirs = started(*arguments, "theirs.npz", cwd=tmp_path)
    assert theirs.code == 0, theirs.err
    assert theirs.err == ""
    assert len(theirs.out.splitlines()) == 1
    assert set(theirs.json) == set(Summary.__dataclass_fields__)
    ours = command(*arguments, "ours.npz")
    for key, value in ours.json.items():
        if key != "recording":
            expected = pytest.approx(value, rel=1e-5) if isinstance(value, float) else value
            assert theirs.json[key] == expected
    one, other = recorded(tmp_path / "ours.npz"), recorded(tmp_path / "theirs.npz")
    assert set(one) == set(other) == KEYS
    for name, array in one.items():
        scale = float(np.abs(array).max())
        np.testing.assert_allclose(other[name], array, rtol=0, atol=1e-6 * scale)
    assert sorted(os.listdir(tmp_path)) == ["ours.npz", "theirs.npz"]


def test_json_says_what_was_played(command: Command) -> None:
    s = command("play", "leather-suede", *SHORT, "--device", "mock:", "--json").json
    assert s["texture"] == "leather-suede"
    assert (s["display"], s["device"]) == ("reference-24", "mock:")
    assert (s["samples"], s["seconds"]) == (800, 0.1)
    assert s["recording"] is s["signal_to_error_db"] is s["peak_current_ma"] is None
    assert s["faults"] == {}


@pytest.mark.parametrize("device", ["sim:", "mock:"])
def test_quiet_prints_nothing(command: Command, device: str) -> None:
    result = command("play", "wood-oak", *SHORT, "--device", device, "--quiet")
    assert (result.code, result.out, result.err) == (0, "", "")
    assert os.listdir() == []


def test_the_report_tells_a_person_the_same(command: Command) -> None:
    result = command("play", "wood-oak", *SHORT, "--record", "oak.npz")
    assert (result.code, result.err) == (0, "")
    for part in (
        "reference-24 at sim:", "0.100 s, 800 samples", "peak of 100 V",
        "0 samples limited", "dB signal-to-error", "mA peak per contactor", "oak.npz",
    ):  # fmt: skip
        assert part in result.out
    assert "faults" not in result.out
    slow = command("play", "wood-oak", *SHORT, "--speed-mm-s", 20)
    assert "not measured: without its first 5 mm and the ramps, less than 0.02 s" in slow.out


def test_the_report_names_vibration_drag_peak_and_whether_it_is_felt(command: Command) -> None:
    """The lines say what the figures of the JSON say; the drag of oak is no vibration."""
    play = ["play", "wood-oak", "--seconds", 0.5, "--gain", 1]
    lines = dict(re.split(r"  +", line.strip(), maxsplit=1)
                 for line in command(*play).out.splitlines()[2:])  # fmt: skip
    s = command(*play, "--json").json
    commanded, played = s["commanded"], s["played"]
    assert lines["vibration"] == (
        f"{commanded['vibration_um_rms']:.2f} µm rms commanded, "
        f"{played['vibration_um_rms']:.2f} µm rms played, 20–1000 Hz"
    )
    for name in ("drag", "peak"):
        values = commanded[f"{name}_um"], played[f"{name}_um"]
        assert lines[name] == "{:.2f} µm commanded, {:.2f} µm played".format(*values)
    level, center = played["level_db_sl"], played["level_hz"]
    assert lines["sensation"] == f"felt: {level:.0f} dB above threshold at {center:g} Hz"
    assert 4 * commanded["vibration_um_rms"] < commanded["drag_um"]
    assert not {"rms_shear_um", "peak_shear_um"} & set(s)


def test_the_report_tells_what_a_bus_counted(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = {"lost_samples": 7, "repeated_samples": 3}
    monkeypatch.setattr(base.BusCounters, "faults", lambda self: counted)
    result = command("play", "wood-oak", *SHORT, "--device", "mock:")
    assert "7 lost_samples, 3 repeated_samples" in result.out


LOSING = "mock:?link=serial&bit_rate=3000000&disconnect_s=0.5"
"""URL of a device whose cable is pulled after half a second."""


def test_a_stroke_that_was_not_put_out_says_so_first_and_exits_with_1(command: Command) -> None:
    stroke = ["wood-oak", "--seconds", 2, "--device", LOSING]
    result = command("play", *stroke, "--json")
    s = result.json
    lost = s["outcome"]["planned_samples"] - s["outcome"]["put_out_samples"]
    assert result.code == 1
    assert lost >= s["faults"]["dropped_samples"] > 0.1 * s["samples"]
    assert s["put_out_share"] == pytest.approx(1 - lost / 16000)
    assert s["outcome"]["cause"] in result.err
    assert "the device is gone" in result.err
    assert result.err.count("\n") == 1
    text = command("play", *stroke)
    assert text.code == 1
    assert text.err == result.err
    title, first = [line.strip() for line in text.out.splitlines() if line.strip()][:2]
    percent = re.search(r"\d+\.\d\d %", title)
    assert percent is not None
    assert first.split() == ["put", "out", *percent[0].split(), "of", "2.00", "s"]


def test_a_stroke_that_was_not_put_out_exits_with_1_quietly_too(command: Command) -> None:
    result = command("play", "wood-oak", "--seconds", 2, "--device", LOSING, "--quiet")
    assert (result.code, result.out, result.err.count("\n")) == (1, "", 1)


def test_ctrl_c_says_in_one_line_what_was_put_out(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    put, blocks = base.Bus.write, list[object]()

    def interrupted(bus: base.Bus, block: base.DriveBlock) -> None:
        blocks.append(block)
        if len(blocks) == 5:
            raise KeyboardInterrupt
        put(bus, block)

    monkeypatch.setattr(base.Bus, "write", interrupted)
    result = command("play", "wood-oak", "--seconds", 2, "--device", "mock:", "--quiet")
    assert result.code == 130
    assert result.err.startswith("tactile: put out ")
    assert result.err.endswith(" % of 2.00 s: interrupted\n")


@pytest.mark.parametrize("share", ["1", "-1%", "101%", "much", "%", "nan%"])
def test_an_allowed_loss_is_a_share_in_percent(command: Command, share: str) -> None:
    result = command("play", "wood-oak", *SHORT, f"--allow-loss={share}")
    line = f"tactile: --allow-loss {share}: must be a share between 0% and 100%, such as 1%\n"
    assert (result.code, result.err) == (2, line)


def test_speed_angle_force_and_length_of_the_stroke_are_taken(command: Command) -> None:
    stroke = ["--gain", 1, "--speed-mm-s", 50, "--angle-deg", 30, "--normal-force-n", 0.2]
    stroke += ["--seconds", 0.2]
    command("play", "wood-oak", *stroke, "--device", "mock:", "--record", "a.npz", "--quiet")
    r = recorded(Path("a.npz"))
    direction = np.array([math.cos(math.radians(30)), math.sin(math.radians(30))])
    expected = 50 * np.arange(1600)[:, None] / 8000 * direction
    np.testing.assert_allclose(r["position_mm"], expected, rtol=0, atol=1e-9)
    command("play", "wood-oak", *stroke[:6], "--seconds", 0.2, "--device", "mock:", "--record",
            "b.npz", "--quiet")  # fmt: skip
    rms = [float(np.std(recorded(Path(name))["shear_target_m"])) for name in ("a.npz", "b.npz")]
    assert rms[0] != pytest.approx(rms[1], rel=0.1), "the force has its law"


def test_a_path_is_followed(command: Command) -> None:
    Path("path.csv").write_text(
        "time_s,x_mm,y_mm,normal_force_n\n1,0,0,0.5\n1.1,8,4,0.5\n1.2,0,8,0.4\n", "utf-8"
    )
    s = command("play", "wood-oak", "--path", "path.csv", "--record", "r.npz", "--json").json
    assert s["samples"] == 1600
    r = recorded(Path("r.npz"))
    # times near 1 s, places near 10 mm, in doubles
    assert r["time_s"][[0, -1]] == pytest.approx([1.0, 1.2 - 1 / 8000], abs=1e-12)
    assert r["position_mm"][800] == pytest.approx([8, 4], abs=1e-9)


def test_seed_and_sample_rate_are_taken(command: Command) -> None:
    for seed in (0, 5):
        command("play", "wood-oak", *SHORT, "--seed", seed, "--sample-rate-hz", 16000,
                "--device", "mock:", "--record", f"{seed}.npz", "--quiet")  # fmt: skip
    one, other = (recorded(Path(f"{seed}.npz")) for seed in (0, 5))
    assert one["sample_rate_hz"] == 16000
    assert len(one["time_s"]) == 1600
    assert not np.allclose(one["shear_target_m"], other["shear_target_m"], atol=1e-9)


def test_a_display_and_a_texture_may_be_files(command: Command) -> None:
    shown = next(shipped("displays").rglob("reference-24.toml"))
    felt = next(shipped("textures").rglob("wood-oak.toml"))
    Path("mine.toml").write_text(
        shown.read_text("utf-8").replace('id = "reference-24"', 'id = "mine"'), "utf-8"
    )
    Path("felt").mkdir()
    Path("felt/wood-oak.toml").write_text(felt.read_text("utf-8"), "utf-8")
    s = command("play", "felt/wood-oak.toml", "--display", "mine.toml", *SHORT, "--json").json
    assert (s["display"], s["texture"]) == ("mine", "wood-oak")


def test_an_existing_recording_is_replaced(command: Command) -> None:
    Path("r.npz").write_text("something else", "utf-8")
    assert command("play", "wood-oak", *SHORT, "--record", "r.npz", "--quiet").code == 0
    assert set(recorded(Path("r.npz"))) == KEYS


# On a terminal


@pytest.mark.ci
def test_on_a_terminal_a_picture_runs_while_it_plays(tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    parent, child = pty.openpty()
    line = [sys.executable, "-m", "tactile", "play", "wood-oak", "--seconds", "0.3"]
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"}
    process = subprocess.Popen(line, cwd=tmp_path, env=environment, stdout=child)
    os.close(child)
    shown = b""
    while True:
        try:
            part = os.read(parent, 1 << 16)
        except OSError:  # the other side is closed
            break
        if not part:
            break
        shown += part
    os.close(parent)
    assert process.wait() == 0
    text = shown.decode("utf-8")
    for part_of_it in ("tactile image", "wood-oak", "0.300 s, 2400 samples"):
        assert part_of_it in text
    assert text.rindex("tactile image") < text.rindex("2400 samples"), "the report comes last"


def test_watched_it_plays_in_real_time_otherwise_as_fast_as_it_can(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[bool, bool]] = []

    def run(*given: object, realtime: bool, watch: object, **options: object) -> Summary:
        asked.append((realtime, watch is not None))
        outcome = Outcome(8000, 8000)
        return Summary("wood-oak", "reference-24", "mock:", outcome=outcome, sample_rate_hz=8e3)

    monkeypatch.setattr("tactile.playback.runs.run", run)
    for terminal in (False, True):
        monkeypatch.setattr(sys.stdout, "isatty", lambda terminal=terminal: terminal)
        for option in ([], ["--quiet"], ["--json"]):
            assert command("play", "wood-oak", *option).code == 0
    assert asked == [(False, False)] * 3 + [(True, True)] + [(False, False)] * 2
