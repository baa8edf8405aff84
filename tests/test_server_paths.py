"""Tests of the folders of sockets and state, by systemd and by the user's environment."""

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tactile import paths

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Unix sockets of Linux")


@pytest.fixture
def listening() -> Iterator[list[socket.socket]]:
    made: list[socket.socket] = []
    yield made
    for each in made:
        each.close()


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a runtime folder of this user, beside an empty one of the system."""
    run, system = tmp_path / "run", tmp_path / "system"
    run.mkdir(mode=0o700)
    system.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(run))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setattr(paths, "SYSTEM_FOLDER", system)
    return run


def listen(path: Path, listening: list[socket.socket]) -> Path:
    path.parent.mkdir(exist_ok=True)
    made = socket.socket(socket.AF_UNIX)
    made.bind(str(path))
    listening.append(made)
    return path


def test_systemd_says_where_a_service_keeps_things(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/tactile:/run/other")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/tactile")
    assert paths.runtime_folder() == Path("/run/tactile")
    assert paths.state_folder() == Path("/var/lib/tactile")


def test_elsewhere_they_are_the_users(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", "/home/a/.local/state")
    assert paths.runtime_folder() == run / "tactile"
    assert paths.state_folder() == Path("/home/a/.local/state/tactile")


def test_a_session_without_a_runtime_folder_is_no_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    assert paths.runtime_folder().name == "tactile"


def test_the_users_own_socket_comes_before_the_systems(
    run: Path, listening: list[socket.socket]
) -> None:
    assert paths.find_sockets() == []
    system = listen(paths.SYSTEM_FOLDER / "tactile.sock", listening)
    assert paths.find_sockets() == [system]
    own = listen(paths.runtime_folder() / "tactile.sock", listening)
    assert paths.find_sockets() == [own, system]
    assert paths.find_sockets("estop.sock") == []


def test_the_systems_socket_is_where_the_packaged_configuration_has_it() -> None:
    text = (Path(__file__).parents[1] / "packaging" / "tactile.toml").read_text("utf-8")
    assert f'socket = "{(paths.SYSTEM_FOLDER / paths.API_SOCKET).as_posix()}"' in text


def test_what_is_no_socket_is_left_out(run: Path) -> None:
    (paths.SYSTEM_FOLDER / "tactile.sock").write_text("")
    assert paths.find_sockets() == []


def test_a_socket_in_another_users_folder_is_left_out(
    run: Path, listening: list[socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    own = listen(paths.runtime_folder() / "tactile.sock", listening)
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(own.parent))
    assert paths.find_sockets() == [own]
    real = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: real + 1)
    assert paths.find_sockets() == []
