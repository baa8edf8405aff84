"""The command ``tactile``: its other commands print what they say, and its help is true."""

import importlib.metadata
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command, assert_mistake, started

import tactile
from tactile import bench, cli
from tactile.bench import link
from tactile.bench.figures import at_least, at_most, not_measured
from tactile.cli.app import COMMANDS, RENAMED, load_command
from tactile.files import shipped

# The other commands


def test_textures_lists_every_shipped_texture(command: Command) -> None:
    result = command("textures")
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    title = " ".join(result.out.split())
    assert title.startswith("Vibration (20–1000 Hz) and level above the detection threshold")
    assert "commanded on reference-24, 80 mm/s, 0.5 N, gain 1" in title
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
    assert facts["conditions"] == "reference-24, 80 mm/s, 0.5 N, gain 1"
    assert facts["commanded"]["vibration_um_rms"] > 0
    assert len(facts["band_frequency_per_mm"]) == len(facts["band_error_db"]) > 0
    for key in ("description", "provenance", "source", "license"):
        assert facts[key].strip()


def test_one_texture_tells_a_person_its_bands(command: Command) -> None:
    result = command("textures", "wood-oak")
    assert (result.code, result.err) == (0, "")
    for part in ("wood-oak:", "license", "µm rms commanded, 20–1000 Hz", "partials", "cycles/mm"):
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
    assert set(command("response", "--json").json) == {"display", "low", "high", "none"}


def test_response_shows_the_finger_of_the_display(command: Command) -> None:
    text = next(shipped("displays").rglob("reference-24.toml")).read_text("utf-8")
    own = "[finger]\nk0_n_per_m = 400.0\nd0_n_s_per_m = 0.1\n"
    Path("mine.toml").write_text(text.replace('[finger]\npreset = "low"\n', own), "utf-8")
    figures = command("response", "--display", "mine.toml", "--json").json
    load = tactile.FingerLoad(k0=400.0, d0=0.1)
    size = abs(tactile.tip_response(tactile.Bimorph(), load, [0.0]).displacement[0])
    assert figures["display"]["static_um_per_v"] == pytest.approx(size * 1e6)
    assert figures["display"] not in (figures["low"], figures["high"], figures["none"])
    row = "[[finger.table]]\nnormal_force_n = {}\nk0_n_per_m = {}\nd0_n_s_per_m = 0.1\n"
    rows = row.format(0.5, 400.0) + row.format(1.0, 900.0)
    Path("table.toml").write_text(text.replace('[finger]\npreset = "low"\n', rows), "utf-8")
    figures = command("response", "--display", "table.toml", "--load", "display", "--json").json
    assert list(figures) == ["display, 0.5 N", "display, 1 N"]
    assert figures["display, 0.5 N"]["static_um_per_v"] == pytest.approx(size * 1e6)


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
    drawing = Path("response.svg").read_text("utf-8")
    assert drawing.lstrip().startswith("<?xml")
    assert "Bimorph of reference-24" in drawing
    assert command("response", "--plot", "response.svg", "--json").json.keys() >= {"low"}
    assert "display = low" in Path("response.svg").read_text("utf-8")


@pytest.mark.ci
def test_bench_as_json_is_a_list_of_figures_with_their_goals(tmp_path: Path) -> None:
    result = started("bench", "memory", "--json", cwd=tmp_path)
    assert (result.code, result.err) == (0, "")
    figures = {figure["name"]: figure for figure in result.json}
    assert set(figures) == {"memory.play_10_s", "memory.growth_10_to_60_s"}
    growth = figures["memory.growth_10_to_60_s"]
    assert set(growth) == set(bench.Figure.__dataclass_fields__)
    assert (growth["goal"], growth["reached"]) == ("≤ 2", True)
    assert figures["memory.play_10_s"]["reached"] is None


def interrupted_benchmark() -> Any:
    yield at_most("two.missed", 2.0, "dB", 1.0)
    yield at_least("two.reached", 2.0, "dB", 1.0)
    yield not_measured("two.other", "needs another library: pip install other")
    raise KeyboardInterrupt


def test_bench_prints_each_figure_as_soon_as_it_is_measured(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "BENCHMARKS", {"two": interrupted_benchmark})
    result = command("bench")
    assert (result.code, result.err) == (130, "tactile: interrupted\n")
    lines = {line.split()[0]: line for line in result.out.splitlines()}
    assert lines["two.missed"].endswith("NOT REACHED")
    assert lines["two.reached"].endswith(" reached")
    assert lines["two.other"].endswith("not measured: needs another library: pip install other")


def test_bench_as_json_is_closed_when_it_is_interrupted(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "BENCHMARKS", {"two": interrupted_benchmark})
    figures = command("bench", "--json").json
    assert [figure["reached"] for figure in figures] == [False, True, None]
    assert [figure["value"] for figure in figures] == [2.0, 2.0, None]


def test_bench_measures_the_link_of_a_device(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A modeled link takes a few milliseconds at most for two time stamps."""
    monkeypatch.setattr(link, "DURATION", 0.0)
    result = command("bench", "--device", "mock:?link=canfd&boards=2", "--json")
    figures = {figure["name"]: figure["value"] for figure in result.json}
    trips = [value for name, value in figures.items() if name.endswith(".round_trip")]
    assert len(trips) == 2
    assert all(0 < trip < 20 for trip in trips)


def test_bench_says_that_a_device_without_the_protocol_has_no_round_trip(command: Command) -> None:
    result = command("bench", "--device", "sim:")
    assert (result.code, result.out) == (2, "")
    assert result.err == "tactile: sim:: has no amplifier that speaks the protocol\n"


# Help


GROUPS = {
    "Play and inspect textures": ["play", "replay", "sheet", "show", "strength", "textures"],
    "Create and convert textures": ["convert", "fit", "relief"],
    "Design displays": ["adjust", "materials", "optimize", "paper", "response", "study"],
    "Use devices": ["bench", "budget", "calibrate", "check", "conform", "devices", "finger"],
    "Run the server and stop displays": ["clear", "estop", "jack", "lsl", "serve"],
}


def test_help_lists_the_commands_in_groups_each_on_one_line(command: Command) -> None:
    listed = command("--help").out.partition("Options:")[2].split("\n\n")[1:]
    groups = {}
    for block in listed:
        heading, *lines = block.splitlines()
        groups[heading.removesuffix(":")] = dict(line.split(maxsplit=1) for line in lines)
    assert {heading: list(rows) for heading, rows in groups.items()} == GROUPS
    for rows in groups.values():
        for name, summary in rows.items():
            assert summary == COMMANDS[name].summary


@pytest.mark.parametrize("name", COMMANDS)
def test_a_commands_own_help_begins_as_the_list_says_and_has_an_example(
    command: Command, name: str
) -> None:
    assert (load_command(name).help or "").splitlines()[0] == COMMANDS[name].summary
    result = command(name, "--help")
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith(f"Usage: tactile {name} ")
    assert f"Example: tactile {name} " in " ".join(result.out.split())


def test_every_command_module_has_a_line_in_the_table() -> None:
    modules = Path(cli.__file__).parent.glob("*_command.py")
    assert {path.stem.removesuffix("_command") for path in modules} == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_a_help_text_that_is_a_phrase(name: str) -> None:
    for param in load_command(name).params:
        text = param.help or ""
        assert text.endswith("."), f"{name} {param.name}"
        assert text[0].isupper(), f"{name} {param.name}"
        assert len(text.split()) >= 3, f"{name} {param.name}"
        assert not text.startswith(("Of ", "As ", "At ", "In ", "On ")), f"{name} {param.name}"


HEAVY = {"matplotlib", "msgspec", "numpy", "rich", "scipy", "threadpoolctl"}


def loaded_by(*arguments: str) -> set[str]:
    """Return the modules that a process has loaded after the command."""
    code = (
        f"import sys\nsys.argv = {['tactile', *arguments]}\nfrom tactile.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    print('\\n', *sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return set(run.stdout.splitlines()[-1].split())


@pytest.mark.parametrize("option", ["--help", "--version", "estop --help"])
def test_what_must_be_quick_loads_only_what_it_needs(option: str) -> None:
    """A command's module is loaded when that command is called."""
    modules = loaded_by(*option.split())
    assert "typer" in modules
    assert {name.partition(".")[0] for name in modules} & HEAVY == set()
    commands = {name for name in modules if name.endswith("_command")}
    assert commands == ({"tactile.cli.estop_command"} if "estop" in option else set())


def test_the_version_is_that_of_the_package(command: Command) -> None:
    try:
        version = importlib.metadata.version("tactile-display")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("not installed")
    assert command("--version") == (0, f"tactile {version}\n", "")


def test_without_an_installed_package_there_is_no_version(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.path", [])
    assert_mistake(command("--version"), "the package tactile-display is not installed")


def test_an_old_option_is_taken_with_a_warning_and_not_shown(command: Command) -> None:
    new = command("budget", "reference-24", "mock:?link=can", "--band-hz", 500, "--json")
    for words in (["--band", "500"], ["--band=500"]):
        old = command("budget", "reference-24", "mock:?link=can", *words, "--json")
        assert (old.code, old.out) == (0, new.out)
        assert old.err == "tactile: --band is deprecated; use --band-hz\n"
    assert "--band " not in command("budget", "--help").out


@pytest.mark.parametrize(
    ("name", "old"),
    [
        ("check", "write"),
        ("fit", "licence"),
        ("optimize", "band"),
        ("optimize", "voltage"),
        ("relief", "output"),
        ("study", "band"),
        ("study", "frequency"),
        ("study", "voltage"),
    ],
)
def test_every_old_name_leads_to_an_option_of_its_command(name: str, old: str) -> None:
    options = {option for param in load_command(name).params for option in param.opts}
    assert f"--{RENAMED[old]}" in options
    assert f"--{old}" not in options


def test_every_example_of_a_help_text_can_be_asked_for(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run each command, the long ones without their work."""
    monkeypatch.setattr(bench, "BENCHMARKS", dict.fromkeys(bench.BENCHMARKS, list))
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
