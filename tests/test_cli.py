"""The command ``tactile``: what it prints, what it writes, and that a mistake is one line.

Most runs call `tactile.cli.main` in this process, which is quicker; some start the command.
"""

import errno
import importlib.metadata
import json
import math
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tactile
from tactile import bench, cli
from tactile.bus import base, registry
from tactile.bus.base import Bus, Rig
from tactile.bus.registry import Address
from tactile.daemon.session import Summary
from tactile.errors import BusError
from tactile.files import shipped
from tactile.recording import Recorder

Floats = NDArray[np.float64]

KEYS = {
    "drive_v", "shear_target_m", "shear_played_m", "time_s", "position_mm", "sample_rate_hz",
    "contactors_mm",
}  # fmt: skip
SHORT = ["--seconds", "0.1"]


@dataclass(frozen=True)
class Result:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Read all of what was printed as strict JSON, without NaN and infinity."""

        def refuse(name: str) -> float:
            raise AssertionError(f"{name} is no JSON")

        return json.loads(self.out, parse_constant=refuse)


Command = Callable[..., Result]


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Run the command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["tactile", *map(str, arguments)])
        monkeypatch.setattr(sys.modules["__main__"], "__package__", None)  # a script's
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main()
        out, err = capsys.readouterr()
        assert isinstance(left.value.code, int)
        return Result(left.value.code, out, err)

    return run


def started(*arguments: object, cwd: Path) -> Result:
    """Run the command as a process of its own, warnings being errors."""
    line = [sys.executable, "-W", "error", "-m", "tactile", *map(str, arguments)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    p = subprocess.run(
        line, cwd=cwd, env=environment, capture_output=True, encoding="utf-8", check=False
    )
    return Result(p.returncode, p.stdout, p.stderr)


def recorded(path: Path) -> dict[str, Floats]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def assert_mistake(result: Result, *said: str) -> None:
    """See that it is one line on standard error, and exit code 2."""
    assert result.code == 2, result
    assert result.out == ""
    assert result.err.endswith("\n")
    assert len(result.err.splitlines()) == 1, result.err
    assert result.err.startswith(("tactile", "python -m tactile"))
    assert "Traceback" not in result.err
    for part in said:
        assert part in result.err


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
        "reference-24 at sim:", "0.100 s, 800 samples", "µm rms", "peak of 100 V",
        "0 samples limited", "dB signal-to-error", "mA peak per contactor", "oak.npz",
    ):  # fmt: skip
        assert part in result.out
    assert "faults" not in result.out


def test_the_report_tells_what_a_bus_counted(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = {"lost_samples": 7, "repeated_samples": 3}
    monkeypatch.setattr(base.Counters, "faults", lambda self: counted)
    result = command("play", "wood-oak", *SHORT, "--device", "mock:")
    assert "7 lost_samples, 3 repeated_samples" in result.out


def test_speed_angle_force_and_length_of_the_stroke_are_taken(command: Command) -> None:
    stroke = ["--speed-mm-s", 50, "--angle-deg", 30, "--normal-force-n", 0.2, "--seconds", 0.2]
    command("play", "wood-oak", *stroke, "--device", "mock:", "--record", "a.npz", "--quiet")
    r = recorded(Path("a.npz"))
    direction = np.array([math.cos(math.radians(30)), math.sin(math.radians(30))])
    expected = 50 * np.arange(1600)[:, None] / 8000 * direction
    np.testing.assert_allclose(r["position_mm"], expected, rtol=0, atol=1e-9)
    command("play", "wood-oak", *stroke[:4], "--seconds", 0.2, "--device", "mock:", "--record",
            "b.npz", "--quiet")  # fmt: skip
    rms = [float(np.std(recorded(Path(name))["shear_target_m"])) for name in ("a.npz", "b.npz")]
    assert rms[0] != pytest.approx(rms[1], rel=0.01), "the force has its law"


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
        return Summary("wood-oak", "reference-24", "mock:")

    monkeypatch.setattr("tactile.daemon.session.run", run)
    for terminal in (False, True):
        monkeypatch.setattr(sys.stdout, "isatty", lambda terminal=terminal: terminal)
        for option in ([], ["--quiet"], ["--json"]):
            assert command("play", "wood-oak", *option).code == 0
    assert asked == [(False, False)] * 3 + [(True, True)] + [(False, False)] * 2


# The other commands


def test_textures_lists_every_shipped_texture(command: Command) -> None:
    result = command("textures")
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0].split()[:2] == ["name", "category"]
    for name in tactile.textures():
        assert any(line.startswith(name) for line in lines)


def test_textures_as_json_is_a_list_of_facts(command: Command) -> None:
    listed = command("textures", "--json").json
    assert [t["name"] for t in listed] == list(tactile.textures())
    oak = command("textures", "wood-oak", "--json").json
    (same,) = (t for t in listed if t["name"] == "wood-oak")
    assert same.items() <= oak.items()


def test_textures_are_listed_by_category_and_by_words(command: Command) -> None:
    def names(*options: str) -> list[str]:
        return [t["name"] for t in command("textures", *options, "--json").json]

    wood = [name for name in tactile.textures() if name.startswith("wood-")]
    assert names("--category", "wood") == wood
    assert names("--category", "wood", "--search", "PORES") == ["wood-oak"]
    assert names("--search", "quarter dollar") == ["metal-coin-reeded"]  # in its description
    assert "abrasive-p80" in names("--search", "[Buchholz 1988]")  # in its source


def test_a_category_that_is_none_is_answered_with_the_nearest(command: Command) -> None:
    result = command("textures", "--category", "wod")
    assert (result.code, result.out) == (2, "")
    assert result.err == "tactile: no category 'wod'; did you mean 'wood'?\n"
    result = command("textures", "--category", "glass", "--search", "no such word")
    assert (result.code, result.out) == (2, "")
    assert "no texture of category 'glass' has 'no such word'" in result.err


def test_one_texture_as_json_says_what_a_surface_can_have(command: Command) -> None:
    facts = command("textures", "wood-oak", "--json").json
    texture = tactile.load_texture("wood-oak")
    assert facts["name"] == "wood-oak"
    assert facts["category"] == "wood"
    assert facts["partials"] == len(texture.partials.amplitude)
    waves = math.sqrt(float(np.sum(texture.partials.amplitude**2)) / 2) * 1e6
    assert facts["rms_um"] == pytest.approx(math.hypot(waves, 0.50), rel=0.01)  # README: 0.50 pores
    assert len(facts["band_frequency_per_mm"]) == len(facts["band_error_db"]) > 0
    for key in ("description", "provenance", "source", "licence"):
        assert facts[key].strip()


def test_one_texture_tells_a_person_its_bands(command: Command) -> None:
    result = command("textures", "wood-oak")
    assert (result.code, result.err) == (0, "")
    for part in ("wood-oak:", "licence", "µm rms at", "partials", "cycles/mm"):
        assert part in result.out


def test_response_as_json_gives_the_figures_of_each_finger_asked_for(command: Command) -> None:
    figures = command("response", "--load", "low", "--json").json
    assert set(figures) == {"low"}
    display, low = tactile.load_display("reference-24"), figures["low"]
    r = tactile.tip_response(display.bimorph, tactile.FingerLoad.low(), np.arange(10.0, 1001.0))
    size = np.abs(r.displacement)
    assert low["smallest_um_per_v"] == pytest.approx(size.min() * 1e6)
    assert low["attainable_um"] == pytest.approx(size.min() * 1e6 * 100)
    assert low["shaping_db"] == pytest.approx(20 * np.log10(size.max() / size.min()))
    rest = tactile.tip_response(display.bimorph, tactile.FingerLoad.low(), [0.0]).displacement[0]
    assert low["static_um_per_v"] == pytest.approx(abs(rest) * 1e6)
    assert low["blocked_force_mn_per_v"] > 0
    assert 10 < low["peak_hz"] < 5000
    both = command("response", "--load", "high", "--load", "low", "--json").json
    assert list(both) == ["high", "low"]
    assert both["low"] == low
    assert set(command("response", "--json").json) == {"low", "high", "none"}


def test_response_tells_a_person_a_line_per_finger(command: Command) -> None:
    result = command("response")
    assert (result.code, result.err) == (0, "")
    words = result.out.split()
    assert {"low", "high", "none"} <= set(words)


def test_response_draws_a_plot(command: Command) -> None:
    pytest.importorskip("matplotlib")
    result = command("response", "--load", "low", "--plot", "response.svg")
    assert result.code == 0
    assert "drawn: response.svg" in result.out
    assert Path("response.svg").read_text("utf-8").lstrip().startswith("<?xml")
    assert command("response", "--plot", "response.svg", "--json").json.keys() >= {"low"}


@pytest.mark.ci
def test_bench_as_json_is_a_list_of_figures_with_their_goals(tmp_path: Path) -> None:
    result = started("bench", "matrix", "--json", cwd=tmp_path)
    assert (result.code, result.err) == (0, "")
    figures = {figure["name"]: figure for figure in result.json}
    error = figures["matrix.error_against_exponential"]
    assert set(error) == set(bench.Figure.__dataclass_fields__)
    assert error["reached"] is True
    assert 0 <= error["value"] <= 1e-9
    assert figures["matrix.speed_over_scipy_expm"]["reached"] is None


def test_bench_tells_a_person_what_was_not_reached(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def two() -> Any:
        yield bench.at_most("two.missed", 2.0, "dB", 1.0)
        yield bench.at_least("two.reached", 2.0, "dB", 1.0)

    monkeypatch.setattr(bench, "BENCHMARKS", {"two": two})
    result = command("bench")
    lines = {line.split()[0]: line for line in result.out.splitlines()}
    assert lines["two.missed"].rstrip().endswith("NOT REACHED")
    assert lines["two.reached"].rstrip().endswith(" reached")


# Help


@pytest.mark.parametrize(
    ("arguments", "example"),
    [
        (["--help"], "Example: tactile play"),
        (["play", "--help"], "Example: tactile play wood-oak"),
        (["textures", "--help"], "Example: tactile textures"),
        (["response", "--help"], "Example: tactile response --load"),
        (["bench", "--help"], "Example: tactile bench"),
    ],
)
def test_every_help_text_has_an_example(
    command: Command, arguments: list[str], example: str
) -> None:
    result = command(*arguments)
    assert (result.code, result.err) == (0, "")
    assert example in result.out
    assert result.out.startswith("Usage: tactile")


def test_every_command_is_among_these(command: Command) -> None:
    listed = command("--help").out.partition("Commands:")[2]
    names = {line.split()[0] for line in listed.splitlines() if line.startswith("  ")}
    wanted = {
        "bench",
        "budget",
        "check",
        "convert",
        "devices",
        "fit",
        "play",
        "relief",
        "response",
        "serve",
    }
    wanted |= {"response", "serve", "sheet", "show", "strength", "textures"}
    assert names == wanted


def test_every_example_of_a_help_text_can_be_asked_for(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run each, the long ones with the work taken out."""
    monkeypatch.setattr(bench, "BENCHMARKS", {})
    examples = set()
    for name in ([], ["play"], ["textures"], ["response"], ["bench"]):
        text = " ".join(command(*name, "--help").out.split())
        example = text.partition("Example: tactile ")[2]
        examples.add(example.partition(" Options:")[0].partition(" Arguments:")[0])
    assert len(examples) == 5
    for example in examples:
        words = ["0.1" if word == "5" else word for word in example.split()]
        result = command(*words)
        assert result.code == 0, example


def test_without_arguments_help_is_printed_and_all_is_well(
    command: Command, tmp_path: Path
) -> None:
    asked, none = command("--help"), command()
    assert none == asked
    assert (none.code, none.err) == (0, "")
    assert "Usage: tactile [OPTIONS] COMMAND" in none.out
    process = started(cwd=tmp_path)
    assert (process.code, process.err) == (0, "")
    assert "tactile [OPTIONS] COMMAND" in process.out


def test_the_installed_command_is_this_one() -> None:
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))
    assert project["project"]["scripts"] == {"tactile": "tactile.cli:main"}
    try:
        points = importlib.metadata.distribution("tactile-display").entry_points
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("not installed")
    (point,) = (p for p in points if p.group == "console_scripts")
    assert (point.name, point.load()) == ("tactile", cli.main)


# Mistakes


GOOD_PATH = "time_s,x_mm,y_mm,normal_force_n\n0,0,0,0.5\n0.1,8,0,0.5\n0.2,16,0,0.5\n"
DISPLAY = next(shipped("displays").rglob("reference-24.toml")).read_text("utf-8")
TEXTURE = next(shipped("textures").rglob("wood-oak.toml")).read_text("utf-8")


def display_with(old: str, new: str) -> str:
    assert old in DISPLAY
    return DISPLAY.replace(old, new)


FILES = {
    "good.csv": GOOD_PATH,
    "backwards.csv": GOOD_PATH.replace("0.2,16", "0.05,16"),
    "twice.csv": GOOD_PATH.replace("0.2,16", "0.1,16"),
    "nan.csv": GOOD_PATH.replace("0.1,8", "0.1,nan"),
    "inf.csv": GOOD_PATH.replace("0.1,8", "0.1,inf"),
    "word.csv": GOOD_PATH.replace("0.1,8", "0.1,eight"),
    "missing-cell.csv": GOOD_PATH.replace("0.1,8,0,0.5", "0.1,8"),
    "missing-column.csv": GOOD_PATH.replace("y_mm", "y_cm"),
    "negative-force.csv": GOOD_PATH.replace("0.1,8,0,0.5", "0.1,8,0,-0.5"),
    "too-fast.csv": GOOD_PATH.replace("0.1,8,0", "0.1,8000,0"),
    "one-row.csv": GOOD_PATH[: GOOD_PATH.index("0.1,8")],
    "header.csv": GOOD_PATH[: GOOD_PATH.index("0,0,0")],
    "empty.csv": "",
    "unknown-key.toml": display_with("length_mm = 20.0", "lenght_mm = 20.0"),
    "unknown-key-of-two-lines.toml": DISPLAY + '\n[bimorph."a\\nb"]\n',
    "negative-length.toml": display_with("\nlength_mm = 20.0", "\nlength_mm = -20.0"),
    "nan.toml": display_with("\nlength_mm = 20.0", "\nlength_mm = nan"),
    "inf.toml": display_with("voltage_v = 100.0", "voltage_v = inf"),
    "high-voltage.toml": display_with("voltage_v = 100.0", "voltage_v = 150.0"),
    "word.toml": display_with("voltage_v = 100.0", 'voltage_v = "high"'),
    "no-limits.toml": DISPLAY[: DISPLAY.index("[limits]")],
    "overlap.toml": display_with("pitch_mm = [2.5, 3.5]", "pitch_mm = [1.5, 3.5]"),
    "no-toml.toml": DISPLAY + "\n[[[\n",
    "empty.toml": "",
    "texture.toml": TEXTURE.replace("[reference]", "[referenc]"),
}
BINARY = b"\xff\xfe\x00\x01" * 100

PLAY = {
    "no texture": ([], "Missing argument"),
    "two textures": (["wood-oak", "wood-oak"], "extra argument"),
    "unknown texture": (["wood-ok"], "no texture 'wood-ok'; did you mean 'wood-oak'?"),
    "texture like nothing": (["xyzzy"], "no texture 'xyzzy'; there is: "),
    "missing texture file": (["my/wood.toml"], "my/wood.toml: no such file"),
    "texture file with a slip": (["texture.toml"], "texture.toml: referenc: unknown key"),
    "unknown option": (["wood-oak", "--speed", "3"], "--speed-mm-s"),
    "unknown short option": (["wood-oak", "-x"], "-x"),
    "option without value": (["wood-oak", "--seed"], "--seed"),
    "seed below 0": (["wood-oak", "--seed", "-1"], "--seed"),
    "seed of a half": (["wood-oak", "--seed", "0.5"], "--seed"),
    "negative seconds": (["wood-oak", "--seconds", "-1"], "--seconds -1: must be 0.1 … 86400"),
    "no seconds": (["wood-oak", "--seconds", "0"], "--seconds 0: must be"),
    "nan seconds": (["wood-oak", "--seconds", "nan"], "--seconds nan: must be"),
    "infinite seconds": (["wood-oak", "--seconds", "inf"], "--seconds inf: must be"),
    "seconds in words": (["wood-oak", "--seconds", "five"], "--seconds"),
    "negative speed": (["wood-oak", "--speed-mm-s", "-1"], "--speed-mm-s -1: must be 0 … 2000"),
    "nan speed": (["wood-oak", "--speed-mm-s", "nan"], "--speed-mm-s nan"),
    "nan angle": (["wood-oak", "--angle-deg", "nan"], "--angle-deg nan"),
    "negative force": (["wood-oak", "--normal-force-n", "-0.1"], "--normal-force-n -0.1: must be"),
    "large force": (["wood-oak", "--normal-force-n", "21"], "--normal-force-n 21: must be 0 … 20"),
    "low rate": (["wood-oak", "--sample-rate-hz", "2499"], "--sample-rate-hz 2499: must be 2500"),
    "nan rate": (["wood-oak", "--sample-rate-hz", "nan"], "--sample-rate-hz nan"),
    "path and speed": (
        ["wood-oak", "--path", "good.csv", "--speed-mm-s", "80"],
        "--speed-mm-s and --path exclude each other",
    ),
    "path and seconds": (["wood-oak", "--path", "good.csv", *SHORT], "--seconds and --path"),
    "path and angle": (["wood-oak", "--path", "good.csv", "--angle-deg", "0"], "--angle-deg and"),
    "path and force": (["wood-oak", "--path", "good.csv", "--normal-force-n", "1"], "exclude each"),
    "missing path": (["wood-oak", "--path", "none.csv"], "none.csv: no such file"),
    "folder as path": (["wood-oak", "--path", "folder"], "folder: no such file"),
    "binary path": (["wood-oak", "--path", "binary.csv"], "binary.csv: cannot be read"),
    "unknown display": (["wood-oak", "--display", "reference-25"], "did you mean 'reference-24'"),
    "missing display": (["wood-oak", "--display", "none.toml"], "none.toml: no such file"),
    "folder as display": (["wood-oak", "--display", "./folder"], "folder"),
    "binary display": (["wood-oak", "--display", "binary.toml"], "binary.toml: cannot be read"),
    "unknown device": (["wood-oak", "--device", "moc:"], "did you mean 'mock:'"),
    "device without colon": (["wood-oak", "--device", "sim"], "did you mean 'sim:'"),
    "no device": (["wood-oak", "--device", ""], "no such kind"),
    "unknown device option": (["wood-oak", "--device", "sim:?plan=a:b"], "did you mean 'plant'"),
    "broken device option": (["wood-oak", "--device", "sim:?plant"], "options are name=value"),
    "malformed device": (["wood-oak", "--device", "sim://["], "sim://["),
    "missing plant": (["wood-oak", "--device", "sim:?plant=no.such:thing"], "no.such:thing"),
    "no plant": (["wood-oak", "--device", "sim:?plant=math:pi"], "math:pi"),
}
PATHS = {
    "backwards.csv": "time, sample 3: 0.05 s after 0.1 s; must ascend",
    "twice.csv": "must ascend",
    "nan.csv": "line 3: x_mm = 'nan': must be a finite number",
    "inf.csv": "line 3: x_mm = 'inf': must be a finite number",
    "word.csv": "line 3: x_mm = 'eight': must be a finite number",
    "missing-cell.csv": "line 3: y_mm",
    "missing-column.csv": "no column 'y_mm'; did you mean 'y_cm'?",
    "negative-force.csv": "normal_force -0.5 N: must be 0 … 50 N",
    "too-fast.csv": "limits 500 m and 10 m/s",
    "one-row.csv": "has 1 rows, needs at least 2",
    "header.csv": "has 0 rows, needs at least 2",
    "empty.csv": "no column 'time_s'",
}
DISPLAYS = {
    "unknown-key.toml": "bimorph.lenght_mm: unknown key; did you mean 'length_mm'?",
    "unknown-key-of-two-lines.toml": "unknown key",
    "negative-length.toml": "bimorph.length_mm = -20.0: expected",
    "nan.toml": "bimorph.length_mm = nan: must be a finite number",
    "inf.toml": "limits.voltage_v = inf: must be a finite number",
    "high-voltage.toml": "limits.voltage_v = 150",
    "word.toml": "limits.voltage_v = 'high'",
    "no-limits.toml": "limits",
    "overlap.toml": "overlap",
    "no-toml.toml": "no valid TOML",
    "empty.toml": "empty.toml",
}
RECORDS = {
    "missing folder": ("missing/r.npz", "missing/r.npz: cannot be written"),
    "file as folder": ("good.csv/r.npz", "good.csv/r.npz: cannot be written"),
    "folder": ("folder", "folder: is a folder"),
    "this folder": (".", "is a folder"),
    "too long": (f"{'long' * 100}.npz", "long"),
}
OTHERS = {
    "unknown command": (["paly", "wood-oak"], "'play'"),
    "unknown option of all": (["--jsno"], "--jsno"),
    "unknown finger": (["response", "--load", "lwo"], "'low', 'high', 'none'"),
    "display of response": (["response", "--display", "reference-25"], "'reference-24'"),
    "plot into a missing folder": (["response", "--plot", "missing/a.png"], "missing/a.png"),
    "plot of an unknown kind": (["response", "--plot", "a.xyz"], "a.xyz"),
    "texture to tell of": (["textures", "wood-ok", "--json"], "did you mean 'wood-oak'?"),
    "unknown benchmark": (["bench", "matrx"], "no benchmark 'matrx'; did you mean 'matrix'?"),
    "second benchmark": (["bench", "matrix", "xyzzy"], "no benchmark 'xyzzy'; there is: "),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Hold good and bad files, and a good recording of old."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "binary.csv").write_bytes(BINARY)
    (tmp_path / "binary.toml").write_bytes(BINARY)
    (tmp_path / "folder").mkdir()
    (tmp_path / "old.npz").write_bytes(b"of old")
    return tmp_path


def content(folder: Path) -> dict[str, bytes | None]:
    """Return all that lies in a folder, hidden and inner ones included."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


@pytest.mark.parametrize("target", ["new.npz", "old.npz"])
@pytest.mark.parametrize("case", PLAY)
def test_a_mistake_is_one_line_and_nothing_is_written(
    command: Command, folder: Path, case: str, target: str
) -> None:
    arguments, said = PLAY[case]
    before = content(folder)
    assert_mistake(command("play", *arguments, "--record", target), said)
    assert content(folder) == before


@pytest.mark.parametrize("name", PATHS)
def test_a_path_that_cannot_be_followed_is_one_line_that_names_it(
    command: Command, folder: Path, name: str
) -> None:
    before = content(folder)
    result = command("play", "wood-oak", "--path", name, "--record", "new.npz")
    assert_mistake(result, f"{name}: ", PATHS[name])
    assert content(folder) == before


@pytest.mark.parametrize("name", DISPLAYS)
def test_a_display_that_cannot_be_is_one_line_that_names_it(
    command: Command, folder: Path, name: str
) -> None:
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--display", name, "--record", "new.npz")
    assert_mistake(result, f"{name}: ", DISPLAYS[name])
    assert content(folder) == before
    assert_mistake(command("response", "--display", name, "--json"), DISPLAYS[name])


@pytest.mark.parametrize("case", RECORDS)
def test_a_recording_that_cannot_be_written_is_one_line(
    command: Command, folder: Path, case: str
) -> None:
    target, said = RECORDS[case]
    before = content(folder)
    assert_mistake(command("play", "wood-oak", *SHORT, "--record", target), said)
    assert content(folder) == before


@pytest.mark.parametrize("option", ["--display", "--path"])
def test_a_name_that_no_file_can_have_is_one_line(
    command: Command, folder: Path, option: str
) -> None:
    before = content(folder)
    assert_mistake(command("play", "wood-oak", option, f"{'long' * 100}.toml"))
    assert content(folder) == before


@pytest.mark.parametrize("case", OTHERS)
def test_a_mistake_in_another_command_is_one_line(
    command: Command, folder: Path, case: str
) -> None:
    arguments, said = OTHERS[case]
    before = content(folder)
    assert_mistake(command(*arguments), said)
    assert content(folder) == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["play", "wood-oak", "--sped", "3", "--record", "new.npz"], "--sped"),
        (["play", "wood-oak", *SHORT, "--record", "missing/r.npz"], "cannot be written"),
    ],
)
def test_as_a_process_a_mistake_is_one_line_and_exit_code_2(
    folder: Path, arguments: list[str], said: str
) -> None:
    before = content(folder)
    assert_mistake(started(*arguments, cwd=folder), said)
    assert content(folder) == before


# What is nobody's mistake


def test_a_device_that_fails_to_open_is_one_line_and_exit_code_2(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(address: Address, rig: Rig, sample_rate: float | None) -> Bus:
        raise BusError("absent: the amplifier does not answer")

    monkeypatch.setitem(registry._drivers, "absent", registry.Driver(absent, "ramps", tuple))
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--device", "absent:", "--record", "new.npz")
    assert result.err == "tactile: absent: the amplifier does not answer\n"
    assert result.out == ""
    assert content(folder) == before
    assert result.code == 2


def test_interrupted_it_leaves_nothing_and_says_so_by_its_exit_code(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []
    add = Recorder.add

    def interrupted(self: Recorder, **arrays: Floats) -> None:
        calls.append(1)
        if len(calls) == 5:
            raise KeyboardInterrupt
        add(self, **arrays)

    monkeypatch.setattr(Recorder, "add", interrupted)
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--record", "old.npz")
    assert result.code == 130
    assert "Traceback" not in result.err
    assert content(folder) == before


def test_a_full_disk_is_one_line_and_leaves_nothing(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Recorder, **arrays: Floats) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "new.npz")

    monkeypatch.setattr(Recorder, "add", full)
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--record", "new.npz")
    assert result.code in (1, 2)
    assert len(result.err.splitlines()) == 1
    assert "No space left on device" in result.err
    assert content(folder) == before


def test_a_mistake_of_our_own_is_not_hidden(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever finds one can report where it is."""

    def broken(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("tactile.daemon.session.run", broken)
    monkeypatch.setattr(sys, "argv", ["tactile", "play", "wood-oak"])
    with pytest.raises(ZeroDivisionError):
        cli.main()
