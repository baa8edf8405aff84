"""Tests of README.md and docs/: Python lines and commands run, and linked files exist."""

import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import pytest
from session_rig import recorded_session
from test_architecture import MAP

import tactile
from tactile.cli.app import COMMANDS, load_command

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
DOCUMENTS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("docs/guide/*.md"),
        *ROOT.glob("docs/tutorials/*.md"),
    ]
}
"""Text by path. What is made of them when the site is built is not among them."""
LINKS = [(name, target) for name, text in DOCUMENTS.items() for target in
         re.findall(r"\]\(([^)#\s]+)[^)]*\)", text)]  # fmt: skip
MADE = ("generated/", "/generated/", "../generated/")
"""Beginnings of links to pages that `docs/generate.py` writes; Sphinx checks these."""
PYTHON = r"^```python\n(.*?)^```"
RUN = [name for name, text in DOCUMENTS.items() if "docs/tutorials" not in name and
       re.search(PYTHON, text, re.DOTALL | re.MULTILINE)]  # fmt: skip
MOST_WORDS = 1500


def make_recording(path: Path) -> None:
    """Make the recording that the documents read, of a short stroke."""
    words = ["play", "wood-oak", "--seconds", "0.2", "--record", path.name, "--quiet"]
    subprocess.run([sys.executable, "-m", "tactile", *words], cwd=path.parent, check=True)


def make_session(folder: Path) -> None:
    """Make the session of a server that the documents read."""
    with tempfile.TemporaryDirectory() as place:
        session = recorded_session(Path(place))
        shutil.copytree(session, folder / "sessions" / "right-20261125T101500Z")


@pytest.mark.realtime
@pytest.mark.parametrize("name", RUN)
def test_their_python_lines_run(name: str, tmp_path: Path) -> None:
    """Some play in real time, with the timeouts that programs have by default."""
    make_recording(tmp_path / "oak.h5")
    make_session(tmp_path)
    blocks = re.findall(PYTHON, DOCUMENTS[name], re.DOTALL | re.MULTILINE)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(blocks)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    if name == "README.md":
        assert "(8000, 24)" in done.stdout


@pytest.mark.parametrize(("name", "target"), LINKS)
def test_their_links_within_the_project_lead_somewhere(name: str, target: str) -> None:
    if target.startswith("https://") or (name.startswith("docs/") and target.startswith(MADE)):
        return
    assert (ROOT / name).parent.joinpath(target).exists()


def commands_in(text: str) -> list[tuple[str, list[str]]]:
    """Return the commands in quotes and blocks of code, each with its options."""
    blocks = re.findall(r"^```[^\n]*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    called = [
        re.match(r"tactile ([a-z]+)(.*)", line, re.DOTALL)
        for line in [*re.findall(r"`(tactile [^`]+)`", text), *lines]
    ]
    return [(m[1], re.findall(r"(?<!\S)--?[a-z][a-z-]*", m[2])) for m in called if m]


def test_they_name_commands_and_options_that_there_are() -> None:
    known = {
        name: {"--help"}.union(*(parameter.opts for parameter in load_command(name).params))
        for name in COMMANDS
    }
    said = [(name, *call) for name, text in DOCUMENTS.items() for call in commands_in(text)]
    assert len(said) > 100
    wrong = [
        (document, command, option)
        for document, command, options in said
        for option in options
        if option not in known.get(command, ())
    ]
    assert wrong == []
    assert {command for _, command, _ in said} <= set(known)


def test_the_map_of_the_rooms_is_the_one_that_is_tested() -> None:
    rows = re.findall(r"^\| `(\w+)/?` \|.*\| (.*) \|$", DOCUMENTS["docs/architecture.md"], re.M)
    told = {room: set(re.findall(r"`(\w+)`", imports)) for room, imports in rows if room in MAP}
    expected = {room: MAP[room] for room in set(MAP) - {"__main__"}}
    assert told == expected


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= MOST_WORDS


def test_the_version_is_the_same_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert tactile.__version__ == project["version"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\n## [{project['version']}]" in DOCUMENTS["CHANGELOG.md"]
