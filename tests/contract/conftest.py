"""What the tests of the buses' contract share.

`bus_benches` says which buses there are, and what of them runs in real time. What only a bus can do
that plays as fast as it is written to is in `test_mock_bus`.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from bus_benches import Bench, bench_of, built
from bus_contract import SLOW, limited, planted, three

from tactile.display import Display


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("amplifier"))


@pytest.fixture(scope="module", autouse=True)
def _plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    yield from planted(tmp_path_factory)


@pytest.fixture(scope="module")
def display(tmp_path_factory: pytest.TempPathFactory) -> Display:
    return three(tmp_path_factory)


@pytest.fixture
def slow(display: Display) -> Display:
    """Give the same with a slew limit that ramps can be seen in."""
    return limited(display, slew=SLOW)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    yield from bench_of(request.param, request)


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let amplifiers in processes of their own take their time to answer and to start."""
    monkeypatch.setattr("tactile.bus.link_bus.OPENING", 60.0)
    monkeypatch.setattr("tactile.bus.link_bus.STARTING", 60.0)


@pytest.fixture(autouse=True)
def _no_wait_for_adapters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Open slcan without the 2 s that python-can gives an Arduino to boot."""
    clock = SimpleNamespace(time=time.time, sleep=lambda seconds: None)
    monkeypatch.setattr("can.interfaces.slcan.time", clock)
