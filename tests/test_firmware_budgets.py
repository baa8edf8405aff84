"""Tests of `make qemu`, which holds the core to its budgets on emulated microcontrollers."""

import re
import shutil
from pathlib import Path

import pytest
from c_amplifier_rig import SOURCE
from emulated_part import made, make

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def counts(tmp_path_factory: pytest.TempPathFactory) -> str:
    return made(tmp_path_factory.mktemp("qemu"))


def test_every_figure_has_a_budget_and_keeps_it(counts: str) -> None:
    rows = re.findall(r"^(\w+) (\d+) (\d+)$", counts, re.MULTILINE)
    budgets = (SOURCE / "ports" / "qemu" / "budgets.h").read_text("utf-8")
    names = [*re.findall(r'BUDGET\("(\w+)"', budgets), "flash", "flash_all_links", "ram"]
    assert sorted(name for name, _, _ in rows) == sorted(2 * names)
    assert all(0 < int(value) <= int(most) for _, value, most in rows)


def test_counts_are_the_same_in_every_run(counts: str, tmp_path: Path) -> None:
    """Instructions are counted, not time: no other load of the machine changes them."""
    _, again = make(tmp_path, "budget-m4")
    (first,) = re.findall(r"^cortex-m4\n((?:\w+ \d+ \d+\n)+)", counts, re.MULTILINE)[:1]
    assert first in again


def test_a_figure_above_its_budget_fails_and_is_named(counts: str, tmp_path: Path) -> None:
    source = tmp_path / "c"
    shutil.copytree(SOURCE, source)
    budgets = source / "ports" / "qemu" / "budgets.h"
    text = budgets.read_text("utf-8")
    budgets.write_text(re.sub(r'("pcm16_worst", )\d+', r"\g<1>1000", text), "utf-8")
    status, printed = make(tmp_path / "build", "budget-m4", source=source)
    assert status != 0
    assert re.search(r"^pcm16_worst \d+ 1000 over its budget$", printed, re.MULTILINE)
    assert printed.count("over its budget") == 1


@pytest.mark.parametrize(
    ("file", "locked", "harm"),
    [
        pytest.param(
            "tactile_actions.c", "ta_lock(amp);\n            ta_player_keep_row",
            "other codes at the position", id="row",
        ),
        pytest.param(
            "tactile_actions.c", "ta_lock(amp);\n        if (cleared",
            "an instant within START begins it", id="start",
        ),
        pytest.param(
            "tactile_requests.c", "ta_lock(amp);\n    ta_announce",
            "an instant within START changes the number of PULSEs", id="announce",
        ),
        pytest.param(
            "tactile_actions.c", "ta_lock(amp);\n        ta_guard_take",
            "an instant within GUARD takes half an entry", id="guard",
        ),
    ],
)  # fmt: skip
def test_what_is_done_without_its_lock_is_noticed(
    counts: str, tmp_path: Path, file: str, locked: str, harm: str
) -> None:
    """Interrupts come anywhere, also in the midst of what only a lock keeps whole."""
    source = tmp_path / "c"
    shutil.copytree(SOURCE, source)
    text = (source / file).read_text("utf-8")
    assert text.count(locked) == 1
    unlocked = locked.removeprefix("ta_lock(amp);\n")
    (source / file).write_text(text.replace(locked, unlocked), "utf-8")
    status, printed = make(tmp_path / "build", "contexts-m4", source=source)
    assert status != 0
    assert f"pcm16, two contexts: {harm}" in printed


@pytest.mark.parametrize("ci", [True, False])
@pytest.mark.parametrize("tool", ["ARM=nosuch-", "QEMU=nosuch"])
@pytest.mark.parametrize("target", ["all", "wire"])
def test_a_missing_tool_is_a_failure_in_ci_and_a_skip_elsewhere(
    tmp_path: Path, target: str, tool: str, ci: bool
) -> None:
    status, printed = make(tmp_path, target, tool, ci=ci)
    assert (status != 0) is ci
    assert "skipped: there is no nosuch" in printed


def test_a_compiler_without_the_library_is_named(tmp_path: Path) -> None:
    """The compiler of the computer itself has no newlib."""
    status, printed = make(tmp_path, "ARM=", ci=False)
    assert status == 0
    assert "skipped: there is no newlib for gcc" in printed
