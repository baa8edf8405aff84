"""Ctrl-C in any phase of a command is one line on standard error and exit code 130."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from study_rig import study

from tactile.study.crews import PoolCrew, solve_part

PROGRAM = """
import os, signal, sys
from tactile.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
sys.argv = ["tactile", *{arguments!r}]
main()
"""
"""Program that interrupts itself, as Ctrl-C does, when it begins to load a module."""
BY_MAIN = (
    "import sys; before = set(sys.modules); import tactile.cli; print(*{*sys.modules} - before)"
)
PLAY = ["play", "wood-oak", "--seconds", "0.1"]
SERVE = ["serve", "--config", str(Path(__file__).parents[1] / "packaging" / "tactile.toml")]
STUDY = ["study", "length_mm=8:30:4"]


def interrupted(arguments: list[str], module: str, folder: Path) -> tuple[int, str, list[str]]:
    """Return exit code, output and lines of error of a command that is interrupted."""
    program = PROGRAM.format(arguments=arguments, module=module)
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder, env=os.environ | {"STATE_DIRECTORY": str(folder)}, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    return run.returncode, run.stdout, [line for line in run.stderr.splitlines() if line]


def test_nothing_is_loaded_before_an_interrupt_can_be_reported() -> None:
    run = subprocess.run(
        [sys.executable, "-c", BY_MAIN], check=True, capture_output=True, text=True
    )
    loaded = {name.partition(".")[0] for name in run.stdout.split()}
    assert loaded - set(sys.stdlib_module_names) == {"tactile"}
    assert {name for name in run.stdout.split() if name.startswith("tactile.")} == {"tactile.cli"}


@pytest.mark.parametrize("module", ["typer", "tactile.cli.app", "tactile.errors"])
def test_an_interrupt_while_the_parser_loads_is_one_line(module: str, tmp_path: Path) -> None:
    assert interrupted(PLAY, module, tmp_path) == (130, "", ["tactile: interrupted"])


@pytest.mark.ci
@pytest.mark.parametrize(
    ("arguments", "module"),
    [
        (PLAY, "tactile.cli.play_command"),
        (PLAY, "numpy"),
        (PLAY, "tactile.playback.runs"),
        (["fit", "a.wav"], "tactile.cli.fit_command"),
        (STUDY, "tactile.study.crews"),
        (SERVE, "tactile.server.server"),
        (SERVE, "tactile.server.listening"),
    ],
)
def test_an_interrupt_while_a_command_loads_is_one_line(
    arguments: list[str], module: str, tmp_path: Path
) -> None:
    assert interrupted(arguments, module, tmp_path) == (130, "", ["tactile: interrupted"])


@pytest.mark.ci
def test_workers_of_a_study_never_see_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The terminal interrupts them too, at any time; here as soon as they can run Python at all."""
    program = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
    (tmp_path / "sitecustomize.py").write_text(program)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    part = study(2)
    crew = PoolCrew(1)
    try:
        solved = crew.submit(part).result()
    finally:
        crew.close()
    expected = solve_part(part)
    assert {name: array.tobytes() for name, array in solved.items()} == {
        name: array.tobytes() for name, array in expected.items()
    }
    assert capfd.readouterr().err == ""
