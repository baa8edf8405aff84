"""Tests of `make proof`: Frama-C proves the core, and no longer does so once the core is broken."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "firmware_protocol" / "c"

MUTANTS = [
    ("last_stage", "step_to", "player.c", "last + ta_clamp(want - last, step)", "want"),
    ("last_stage", "ta_clamp", "core.h", "value > limit ? limit", "value > limit ? limit + 1"),
    ("last_stage", "bound", "player.c", "ta_clamp(value, limit), step", "value, step"),
    (
        "last_stage",
        "portion",
        "player.c",
        "return value * part / whole",
        "return value * whole / part",
    ),
    ("instant", "move_gain", "player.c", "p->gain < p->gain_full ? 1u : 0u", "1u"),
    ("instant", "take_samples", "player.c", "*value = p->values", "*value = p->codes"),
    ("limits", "derive", "amplifier.c", "gain > 0 ? (uint32_t)gain : 1u", "(uint32_t)gain"),
    ("guard", "moved", "guard.c", "higher < TA_GAIN_FULL ? higher : TA_GAIN_FULL", "higher"),
    ("packet", "cobs_block", "packet.c", "most = most < room ? most : room;", ""),
    ("samples", "", "samples.c", "value < -FULL_SCALE ? -FULL_SCALE : value", "value"),
]
"""Units, the function that is to be proven where not all are, and what a mutant changes."""

pytestmark = pytest.mark.ci


def prove(source: Path, build: Path, *options: str, ci: bool = True) -> tuple[int, str]:
    """Run `make` in the folder of the proofs and return its status and all that it printed."""
    environment = {k: v for k, v in os.environ.items() if k != "CI"}
    environment |= {"CI": "true"} if ci else {}
    command = ["make", "-C", str(source / "proof"), f"BUILD={build}", *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module", autouse=True)
def provers() -> None:
    """Skip without the provers; where CI promises them their absence is a failure."""
    for tool in ("frama-c", "why3", "z3"):
        if shutil.which(tool) is None:
            assert os.environ.get("CI") != "true", f"CI has no {tool}"
            pytest.skip(f"no {tool} on PATH (Debian: apt-get install frama-c-base why3 z3)")


def test_nothing_of_the_core_is_open(tmp_path: Path) -> None:
    status, printed = prove(SOURCE, tmp_path)
    assert status == 0, printed
    goals = re.findall(r"^\w+: (\d+) of (\d+) goals proven", printed, re.MULTILINE)
    assert goals
    assert all(0 < int(proven) == int(scheduled) for proven, scheduled in goals)
    assert re.search(r"^samples: 0 alarms", printed, re.MULTILINE)


@pytest.mark.parametrize(("unit", "function", "file", "before", "after"), MUTANTS)
def test_a_broken_core_is_not_proven(
    tmp_path: Path, unit: str, function: str, file: str, before: str, after: str
) -> None:
    source = tmp_path / "c"
    shutil.copytree(SOURCE, source, ignore=shutil.ignore_patterns("build"))
    changed = source / f"tactile_{file}"
    text = changed.read_text("utf-8")
    assert before in text
    changed.write_text(text.replace(before, after), "utf-8")
    only = [f"{unit.upper()}={function}"] if function else []
    status, printed = prove(source, tmp_path / "build", unit, *only)
    assert status != 0
    assert re.search(rf"^{unit}: .*(goals proven|alarms)", printed, re.MULTILINE), printed


@pytest.mark.parametrize("ci", [True, False])
def test_a_missing_tool_is_a_failure_in_ci_and_a_skip_elsewhere(tmp_path: Path, ci: bool) -> None:
    status, printed = prove(SOURCE, tmp_path, "FRAMA_C=nosuch", ci=ci)
    assert (status != 0) is ci
    assert "skipped: there is no nosuch" in printed
