"""Runs of the checks of `in_*.py` inside kernels that have the drivers.

Every check is a line of its own here, so that one that was not run counts as failed. They run where
what they test has changed since they last passed (`tested.py`), and with KERNEL=1.
"""

import ast
import ctypes.util
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import pytest
from tested import RECORD, digest

HERE = Path(__file__).parent
PROJECT = HERE.parents[1]
HANGING = 20
"""Time in a guest after which a check is taken to hang and reports its place [s]; the longest takes
5 s."""
FETCHING = ("apt-get", "dpkg-deb", "depmod")
RESULT = re.compile(r"^([A-Z]+) \S*?(\w+\.py)::(\w+)", re.MULTILINE)
TITLE = re.compile(r"^(?:_{3,}|={3,}) (.+) (?:_{3,}|={3,})$", re.MULTILINE)

pytestmark = pytest.mark.ci


@dataclass(frozen=True)
class Machine:
    """A guest: what starts it, what that needs, and the checks that run in it."""

    script: str
    scripts: tuple[str, ...]
    modules: str
    seconds: int
    tools: tuple[str, ...]

    def checks(self) -> list[str]:
        """Return the names of the checks, as "in_uml.py::test_classic_frames"."""
        found = []
        for script in self.scripts:
            for node in ast.parse((HERE / script).read_text("utf-8")).body:
                if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                    found.append(f"{script}::{node.name}")
        return found


UML = Machine(
    script="uml.sh",
    scripts=("in_uml.py", "in_i2c.py"),
    modules="vcan can-raw i2c-dev i2c-stub:chip_addr=0x48 cuse",
    seconds=1200,
    tools=("ip", "busybox", "modprobe"),
)
QEMU_TOOLS = ("ip", "busybox", "modprobe", "cpio", "qemu-system-x86_64")
DEVICES = Machine(
    script="guest.sh",
    scripts=("in_guest.py", "in_serial.py", "in_audio.py"),
    modules="can-raw gs_usb vhci-hcd dummy_hcd libcomposite cdc-acm snd-aloop",
    seconds=3600,
    tools=QEMU_TOOLS,
)
BUSES = Machine(
    script="guest.sh",
    scripts=("in_can.py", "in_adapter.py", "in_i2c_bus.py"),
    modules="can-raw vcan gs_usb vhci-hcd i2c-dev cuse",
    seconds=3600,
    tools=QEMU_TOOLS,
)


def missing(what: str) -> NoReturn:
    """Skip a test because something is missing; in CI, which promises it, fail."""
    if os.environ.get("CI") == "true":
        pytest.fail(what)
    pytest.skip(what)


def need(tools: tuple[str, ...]) -> None:
    """Skip or fail unless all tools are there."""
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    if lacking := [tool for tool in tools if not shutil.which(tool, path=path)]:
        missing(f"not on PATH: {', '.join(lacking)}")


def unless_they_passed_before() -> None:
    """Skip the test if nothing has changed since all checks passed."""
    if os.environ.get("KERNEL") != "1" and RECORD.read_text("ascii").strip() == digest():
        pytest.skip("what the guests test is as it was when they passed; KERNEL=1 runs them")


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment of the guests, after the kernels were fetched and the amplifier was built."""
    unless_they_passed_before()
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    kernels = os.environ.get("TACTILE_KERNELS") or str(cache / "tactile" / "kernels")
    need(FETCHING)
    fetched = subprocess.run(
        [HERE / "kernels.sh", kernels], capture_output=True, text=True, check=False
    )
    if fetched.returncode:
        missing(f"no kernels: {fetched.stderr}")
    need(("make", "cc"))
    build = tmp_path_factory.mktemp("amplifier")
    source = PROJECT / "firmware_protocol" / "c"
    subprocess.run(["make", "--silent", "-C", source, f"BUILD={build}"], check=True)
    own = {
        "TACTILE_KERNELS": kernels,
        "TACTILE_VIRTUAL_AMPLIFIER": str(build / "virtual-amplifier"),
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }
    return os.environ | own


Results = tuple[dict[str, set[str]], str]
"""Outcomes of each check, and everything that was written."""


def run(machine: Machine, environment: dict[str, str]) -> Results:
    """Boot a machine and run its checks."""
    need(machine.tools)
    boot = [str(HERE / machine.script), "--seconds", str(machine.seconds)]
    boot += ["--modules", machine.modules]
    boot += ["--", sys.executable, "-m", "pytest", "-p", "anyio", "-vv", "-rA", "--color=no"]
    boot += ["-p", "no:cacheprovider", "-o", f"faulthandler_timeout={HANGING}"]
    done = subprocess.run(
        [*boot, *(str(HERE / script) for script in machine.scripts)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=environment,
        cwd=PROJECT,
        check=False,
    )
    results: dict[str, set[str]] = defaultdict(set)
    for outcome, script, check in RESULT.findall(done.stdout):
        results[f"{script}::{check}"].add(outcome)
    assert results, done.stdout
    return results, done.stdout


Ran = dict[Machine, Future[Results]]
"""The machines, which run side by side."""


@pytest.fixture(scope="module")
def ran(environment: dict[str, str]) -> Iterator[Ran]:
    with ThreadPoolExecutor() as pool:
        yield {machine: pool.submit(run, machine, environment) for machine in (UML, DEVICES, BUSES)}


def judge(results: Results, check: str) -> None:
    outcomes, output = results
    titled = TITLE.split(output)[1:]
    name = check.partition("::")[2]
    about = [text for title, text in zip(titled[::2], titled[1::2], strict=True) if name in title]
    assert outcomes[check] == {"PASSED"}, "".join(about) or output


@pytest.mark.parametrize("check", UML.checks())
def test_in_user_mode_linux(ran: Ran, check: str) -> None:
    judge(ran[UML].result(), check)


@pytest.mark.parametrize("check", BUSES.checks())
def test_buses(ran: Ran, check: str) -> None:
    judge(ran[BUSES].result(), check)


@pytest.mark.parametrize("check", DEVICES.checks())
def test_devices(ran: Ran, check: str) -> None:
    if not ctypes.util.find_library("portaudio"):
        missing("no PortAudio")
    judge(ran[DEVICES].result(), check)
