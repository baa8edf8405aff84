"""Tests of the systemd unit of the server: its permissions, and that it is restarted."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNIT = Path(__file__).parents[1] / "packaging" / "systemd" / "tactile.service"
MOST_EXPOSED = 2.5
"""Largest exposure of 10, as systemd-analyze counts; it is 9.6 without any restriction."""


def values(name: str) -> list[str]:
    """Return what the unit says under a name, in the order in which it stands there."""
    return re.findall(rf"^{name}=(.*)$", UNIT.read_text("utf-8"), re.MULTILINE)


@pytest.mark.ci
def test_the_server_is_exposed_no_more_than_it_must_be() -> None:
    if shutil.which("systemd-analyze") is None:
        assert not os.environ.get("CI"), "no systemd-analyze on PATH (apt install systemd)"
        pytest.skip("no systemd-analyze")
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(UNIT)]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    level = re.search(r"Overall exposure level for tactile\.service: ([0-9.]+)", found.stdout)
    assert level is not None, found.stdout
    assert float(level[1]) <= MOST_EXPOSED
    assert not found.stderr, "what systemd ignores protects nothing"


def test_playback_may_run_in_real_time() -> None:
    """All that `tactile.playback.priority` does, though it is among what is usually forbidden."""
    assert values("RestrictRealtime") == []
    assert (values("LimitRTPRIO"), values("LimitMEMLOCK")) == (["50"], ["infinity"])
    filters = values("SystemCallFilter")
    assert "@resources" in filters[1]
    assert {"sched_setscheduler", "setpriority"} <= set(filters[2].split()), "allowed again"


def test_only_a_configuration_that_cannot_be_used_ends_it_for_good() -> None:
    assert values("Restart") == ["on-failure"]
    assert values("RestartPreventExitStatus") == ["2"]
    assert values("StartLimitIntervalSec") == ["0"]


def test_it_is_given_its_folders_and_the_groups_of_its_devices() -> None:
    for kind in ("StateDirectory", "RuntimeDirectory", "LogsDirectory"):
        assert values(kind) == ["tactile"]
    assert values("SupplementaryGroups") == ["dialout audio i2c"]
