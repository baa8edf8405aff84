"""What holds for all tests: folders for their daemons, and examples that depend on no clock."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

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
    """Keep daemons that several tests share away from the user's own."""
    yield from _folder()


@pytest.fixture(autouse=True)
def own_folders(session_folders: None) -> Iterator[None]:
    """Let no e-stop that a test leaves latched meet another test; short paths, as sockets want."""
    yield from _folder()
