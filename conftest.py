"""Folders of their own for the state and the sockets of every test's daemons."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


def _in_folder(monkeypatch: pytest.MonkeyPatch, folder: str) -> None:
    for variable, name in (("STATE_DIRECTORY", "state"), ("RUNTIME_DIRECTORY", "run")):
        monkeypatch.setenv(variable, str(Path(folder) / name))


def _folder() -> Iterator[None]:
    with tempfile.TemporaryDirectory(prefix="t-") as folder, pytest.MonkeyPatch.context() as patch:
        _in_folder(patch, folder)
        yield


@pytest.fixture(scope="session", autouse=True)
def session_folders() -> Iterator[None]:
    """Keep daemons that several tests share away from the user's own."""
    yield from _folder()


@pytest.fixture(autouse=True)
def own_folders(session_folders: None) -> Iterator[None]:
    """Let no e-stop that a test leaves latched meet another test; short paths, as sockets want."""
    yield from _folder()
