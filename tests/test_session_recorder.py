"""Tests of the recorder of sessions as a process of its own, alone and beside a server."""

import queue
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tactile
import tactile.client
from benchmarks.server import wait_for
from tactile.bus.base import DriveBlock
from tactile.errors import ClientError
from tactile.files import SourceFile
from tactile.playback.commands import AppendSamples, DeviceOpened
from tactile.playback.mixer import BlockInput
from tactile.playback.session_messages import (
    NumberedOrder,
    RecorderAnswer,
    SessionHeader,
    SessionSetup,
)
from tactile.playback.session_recorder import MOST_TEXT
from tactile.playback.session_replay import replay_session
from tactile.playback.session_ring import SessionRing
from tactile.processes import ChildProcess, send

pytestmark = pytest.mark.ci

PATIENCE = 120.0
"""Longest wait for what takes a second on an idle machine [s]."""
HEADER = SessionHeader(
    name="left", device="mock:", display=SourceFile("four.toml", ""), voltage_limit_v=50.0,
    how=DeviceOpened(8000.0), gain=1.0, worn=False,
)  # fmt: skip


class Recorder:
    """Recorder in a process of its own, and the ring that it reads."""

    def __init__(self, folder: Path) -> None:
        self.ring = SessionRing.create()
        self._answers: queue.Queue[RecorderAnswer | None] = queue.Queue()
        inherited = () if self.ring.descriptor is None else (self.ring.descriptor,)
        self.process = ChildProcess(
            "tactile.playback.session_recorder", self._answers.put, inherited
        )
        self.send(SessionSetup(str(folder), self.ring.handle, HEADER))

    def send(self, message: object) -> None:
        send(self.process._pipe, message)

    def answer(self) -> RecorderAnswer | None:
        return self._answers.get(timeout=PATIENCE)

    def fill_a_part(self, number: int) -> None:
        """Send so much that a part is written before its time."""
        samples = np.zeros(MOST_TEXT // 4, np.float32)
        self.send(NumberedOrder(number, AppendSamples(1, samples, 8000.0, (), append=True)))

    def add_blocks(self, count: int) -> None:
        drive = DriveBlock(0, np.zeros((16, 4)))
        for k in range(count):
            self.ring.add_block(BlockInput(k, 16 * k, False, 1.0 + k, 1.01 + k, ()), drive)

    def close(self) -> None:
        self.process.kill()
        self.ring.close()


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    with closing(Recorder(tmp_path / "sessions")) as recorder:
        yield recorder


def begun(recorder: Recorder) -> Path:
    answer = recorder.answer()
    assert answer is not None
    assert answer.failure == ""
    return Path(answer.folder)


def blocks(session: Path) -> int:
    return len(tactile.load_session(session).blocks["due_s"])


def test_the_last_part_is_written_when_the_pipe_ends(recorder: Recorder) -> None:
    session = begun(recorder)
    recorder.add_blocks(100)
    recorder.process._pipe.close()
    assert recorder.answer() is None
    assert blocks(session) == 100


def test_a_kill_leaves_the_parts_before_it_complete(recorder: Recorder) -> None:
    session = begun(recorder)
    recorder.add_blocks(100)
    recorder.fill_a_part(1)
    wait_for("a part is written", (session / "part-000001.h5").exists)
    recorder.process.kill()
    recorder.add_blocks(7)  # which nobody reads
    assert blocks(session) == 100
    assert [path.name for path in session.iterdir()] == ["part-000001.h5"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs prlimit of Linux")
def test_a_disk_that_takes_no_more_ends_the_recorder_with_one_line(recorder: Recorder) -> None:
    import resource

    session = begun(recorder)
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (5000, 5000))
    recorder.fill_a_part(1)
    answer = recorder.answer()
    assert answer is not None
    assert answer.failure == f"{session.parent}: File too large"
    assert recorder.answer() is None
    assert list(session.iterdir()) == [], "nothing unfinished is left"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    config = tmp_path / "tactile.toml"
    config.write_text(
        '[server]\nport = 0\n[osc]\nport = 0\n[record]\nfolder = "sessions"\n'
        '[[display]]\nname = "left"\ndevice = "sim:"\nworn = true\n'
    )
    words = [sys.executable, "-m", "tactile", "serve", "--config", str(config)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline().split()[0]
        process.kill()


def armed(display: Any) -> Callable[[], bool]:
    """Return a function that arms a display unless the server stood still just then."""

    def arm() -> bool:
        try:
            display.arm()
        except ClientError:
            return False
        return True

    return arm


def test_what_a_real_server_played_is_rendered_again(
    server: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    process, url = server
    with tactile.client.connect(url, timeout=PATIENCE) as display:
        display.select("wood-oak")
        wait_for("it is armed", armed(display))
        for k in range(200):
            display.touch((1e-4 * k, 0.0), velocity=(0.08, 0.0), normal_force=0.5)
            display.stats()
    process.send_signal(signal.SIGTERM)
    process.wait(PATIENCE)
    (session,) = (tmp_path / "sessions").iterdir()
    wait_for("the recorder has written", (session / "part-000001.h5").exists)
    result = replay_session(session)
    assert result.is_identical, result
    assert result.compared_blocks > 0
    assert len(tactile.load_session(session).contacts["time_s"]) > 0
