"""Settings of all tests, fixtures that several files share, and the summary of a run.

All tests have folders of their own for servers, and examples that depend on no clock. What a
fixture needs is imported in it, so that a run of one file, or of the checks in a guest of `kernel`,
imports no more than it uses. `usefixtures` names those that give nothing.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    import bringup_rig
    import cli_rig
    import client_rig
    import link_rig
    import parts_rig
    from bus_benches import Bench

    from tactile.bus.base import Bus
    from tactile.display.display import Display
    from tactile.texture.surface import Texture

# pytest-xdist takes all processors already, and OpenBLAS spins while it waits for its threads; it
# reads this when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The same examples on every machine, however slow it is: Hypothesis's limits of time would fail
# where one is held up. Fixtures that several examples share are folders.
settings.register_profile(
    "replay", derandomize=True, deadline=None, database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)  # fmt: skip
settings.load_profile("replay")
# Other examples each time, by --hypothesis-profile=explore --hypothesis-seed=N: see .ci/nightly.
settings.register_profile("explore", settings.get_profile("replay"), derandomize=False)


def _in_folder(monkeypatch: pytest.MonkeyPatch, folder: str) -> None:
    for variable, name in (("STATE_DIRECTORY", "state"), ("RUNTIME_DIRECTORY", "run")):
        monkeypatch.setenv(variable, str(Path(folder) / name))


def _folder() -> Iterator[None]:
    with tempfile.TemporaryDirectory(prefix="t-") as folder, pytest.MonkeyPatch.context() as patch:
        _in_folder(patch, folder)
        yield


@pytest.fixture(scope="session", autouse=True)
def session_folders() -> Iterator[None]:
    """Keep servers that several tests share away from the user's own."""
    yield from _folder()


@pytest.fixture(autouse=True)
def own_folders(session_folders: None) -> Iterator[None]:
    """Let no e-stop that a test leaves latched meet another test; short paths, as sockets want."""
    yield from _folder()


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """Return which event loop the tests that are coroutines run in."""
    return "asyncio"


# Displays and textures


@pytest.fixture(scope="session")
def display() -> Display:
    """Return the display that most of what needs any is tested with."""
    from tactile.display.display import load_display

    return load_display("reference-24")


@pytest.fixture(scope="session")
def three(tmp_path_factory: pytest.TempPathFactory) -> Display:
    """Return the display of three contactors that every bus is tested with."""
    from bus_contract import DISPLAY

    from tactile.display.display import load_display

    path = tmp_path_factory.mktemp("displays") / "three.toml"
    path.write_text(DISPLAY, encoding="utf-8")
    return load_display(path)


@pytest.fixture(scope="session")
def slow(three: Display) -> Display:
    """Return the same with a slew limit that ramps can be seen in."""
    from bus_contract import SLOW, limited

    return limited(three, slew=SLOW)


@pytest.fixture(scope="session")
def pair() -> Display:
    """Return two contactors of the reference display."""
    from strength_rig import few

    from tactile.display.display import load_display

    return few(load_display("reference-24"), 0, 13)


@pytest.fixture(scope="session")
def oak() -> Texture:
    from tactile.texture.surface import load_texture

    return load_texture("wood-oak")


@pytest.fixture(scope="session")
def suede() -> Texture:
    from strength_rig import smooth

    return smooth("leather-suede")


@pytest.fixture(scope="session")
def calf() -> Texture:
    from strength_rig import smooth

    return smooth("leather-calf")


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Shorten the trial of strength, for time; the full one is for CI."""
    if request.node.get_closest_marker("ci") is None:
        monkeypatch.setattr("tactile.strength.strength.PLACES", 4)


# The amplifier in C


@pytest.fixture(scope="session")
def virtual_amplifier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the program, which is built once for all files of a process."""
    from c_amplifier_rig import make

    folder = tmp_path_factory.mktemp("amplifier")
    make(folder, "virtual-amplifier")
    return folder / "virtual-amplifier"


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of what `make sanitize` builds, once for all files of a process."""
    from c_amplifier_rig import make

    folder = tmp_path_factory.mktemp("sanitized-amplifier")
    make(folder, "sanitize")
    return folder / "sanitize"


# Buses


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """Yield a bench by its name, and close what it opened."""
    from bus_benches import bench_of

    yield from bench_of(request.param, request)


@pytest.fixture
def linked() -> Iterator[link_rig.Linked]:
    """Yield what makes benches of modeled links, and close those, which end at 0 V."""
    from link_rig import LINKS, Bench

    made: list[Bench] = []

    def make(link: str, extra: str = "&rearm=true", **named: Any) -> Bench:
        made.append(Bench(LINKS[link] + extra, **named))
        return made[-1]

    yield make
    for one in made:
        one.bus.close()
        one.check_limits()
        assert one.silent


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Put the plants of the buses' contract and of the simulated display where they are found."""
    from bus_contract import PLANT
    from sim_rig import PLANTS

    folder = tmp_path_factory.mktemp("plants")
    plants = {"plant_of_the_bus_contract": PLANT, "plants_of_the_sim_test": PLANTS}
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        for name, text in plants.items():
            (folder / f"{name}.py").write_text(text, encoding="utf-8")
        yield
    for name in plants:
        sys.modules.pop(name, None)


@pytest.fixture
def unhurried_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let amplifiers in processes of their own take their time to answer and to start.

    Slcan opens without the 2 s that python-can gives an Arduino to boot.
    """
    monkeypatch.setattr("tactile.bus.link.link_bus.OPENING", 60.0)
    monkeypatch.setattr("tactile.bus.link.link_bus.STARTING", 60.0)
    clock = SimpleNamespace(time=time.time, sleep=lambda seconds: None)
    monkeypatch.setattr("can.interfaces.slcan.time", clock)


@pytest.fixture
def impatient() -> Iterator[None]:
    """Let threads have their turn at every other instruction."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.fixture(params=["drv2667", "bos1921"])
def one(request: pytest.FixtureRequest) -> Iterator[parts_rig.Rig]:
    """Yield a bus with one chip, on a model of its registers."""
    from parts_rig import rig

    built = rig(request.param)
    yield built
    built.bus.close()


# Bring-up


@pytest.fixture
def four(tmp_path: Path) -> Path:
    """Return a file of four contactors in a row."""
    from bringup_rig import FOUR

    path = tmp_path / "four.toml"
    path.write_text(FOUR, encoding="utf-8")
    return path


@pytest.fixture
def grid(tmp_path: Path) -> Path:
    """Return a file of two rows of three."""
    from bringup_rig import GRID

    path = tmp_path / "six.toml"
    path.write_text(GRID, encoding="utf-8")
    return path


@pytest.fixture
def serve(
    virtual_amplifier: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., bringup_rig.Served]]:
    """Yield what starts amplifiers, which a slow machine may hold up for longer than a link."""
    from bringup_rig import serving

    for limit in ("session.SILENCE", "link_bus.OPENING", "link_bus.STARTING"):
        monkeypatch.setattr(f"tactile.bus.link.{limit}", 60.0)
    monkeypatch.setattr("tactile.bus.link.peer.TRIES", 40)
    with serving(virtual_amplifier, tmp_path / "out") as start:
        yield start


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Bus]:
    """Return the buses that a bring-up opens, as it does."""
    from tactile.bringup import bringup
    from tactile.devices import open_bus

    found: list[Bus] = []

    def open_and_keep(*arguments: Any, **named: Any) -> Bus:
        found.append(open_bus(*arguments, **named))
        return found[-1]

    monkeypatch.setattr(bringup, "open_bus", open_and_keep)
    return found


# The command, servers and clients


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> cli_rig.Command:
    """Return what runs ``tactile`` in this process, in an empty folder."""
    from cli_rig import runner

    return runner(tmp_path, monkeypatch, capsys)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a server long timeouts, so that it drops nobody because the machine stood still."""
    for limit in (
        "connection.HELLO_WITHIN", "connection.READ_WITHIN", "listening.PONG_WITHIN",
        "osc.SILENCE", "requests.FINISH_WITHIN", "sockets.REQUEST_WITHIN",
    ):  # fmt: skip
        monkeypatch.setattr(f"tactile.server.{limit}", 600.0)


@pytest.fixture
def patient_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no client give up a server because the machine stood still."""
    monkeypatch.setattr("tactile.client.websocket.SILENCE", 60.0)


@pytest.fixture(params=["thread", "asyncio"])
def twin(request: pytest.FixtureRequest) -> Iterator[client_rig.Twin]:
    """Yield either of the two clients."""
    from client_rig import Twin

    twin = Twin(request.param)
    yield twin
    twin.close()


@pytest.fixture
def script() -> client_rig.Script:
    """Return what the scripted server answers."""
    from client_rig import Script

    return Script()


@pytest.fixture
def server(script: client_rig.Script, patient_client: None) -> Iterator[client_rig.ScriptedServer]:
    """Yield a scripted server."""
    from client_rig import ScriptedServer

    server = ScriptedServer(script)
    yield server
    server.close()


@pytest.fixture
def remote(twin: client_rig.Twin, server: client_rig.ScriptedServer) -> Iterator[Any]:
    """Yield a display of the scripted server, as a client has it."""
    from client_rig import PATIENCE

    with twin.connect(server.url, timeout=PATIENCE) as remote:
        yield remote


# Skipped tests


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Count the skipped tests by their reasons; say nothing where none were skipped."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(reason_of(report) for report in skipped)
    if reasons:
        terminalreporter.section("skipped")
        for reason, count in sorted(reasons.items(), key=lambda item: (-item[1], item[0])):
            terminalreporter.line(f"{count:6d}  {reason}")


def reason_of(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Return why a test or file was skipped."""
    told = report.longrepr
    reason = told[2] if isinstance(told, tuple) else getattr(report, "wasxfail", "no reason given")
    return str(reason).removeprefix("Skipped: ")
