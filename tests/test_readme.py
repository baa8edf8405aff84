"""README.md says what runs: its Python lines, and commands and files that exist."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.realtime
def test_its_python_lines_run() -> None:
    """One plays in real time, with the timeouts that programs have by default."""
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert blocks
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(blocks)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "(8000, 24)" in done.stdout


@pytest.mark.parametrize("target", re.findall(r"\]\(([^)#]+)\)", README))
def test_its_links_within_the_project_lead_somewhere(target: str) -> None:
    assert target.startswith("https://") or (ROOT / target).exists()


def test_it_names_the_commands_that_there_are() -> None:
    said = set(re.findall(r"tactile (\w+)", " ".join(re.findall(r"`(tactile [^`]+)`", README))))
    shown = subprocess.run(
        [sys.executable, "-m", "tactile", "--help"], capture_output=True, text=True, check=True
    ).stdout
    commands = set(re.findall(r"^  (\w+) {2,}", shown, re.MULTILINE))
    assert said
    assert said <= commands
