"""Tests of the e-stop process: its answers, who gets them, and attempts to block it."""

import errno
import json
import os
import pickle
import select
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile.clock import ModelClock
from tactile.estop import request as estop_request
from tactile.estop.latch import Latch
from tactile.estop.process import Desk, EstopReady, EstopSetup, bind
from tactile.estop.request import EstopAnswer, request_estop
from tactile.paths import estop_sockets, runtime_folder

pytestmark = pytest.mark.skipif(
    not hasattr(socket, "AF_UNIX"), reason="datagrams of a Unix socket are read here"
)
PATIENCE = 60.0
"""Time until a request gives up [s]; nothing that is tested depends on it."""


@pytest.fixture
def latches(tmp_path: Path) -> Iterator[dict[str, Latch]]:
    latches = {name: Latch.open("sim:", tmp_path) for name in ("right", "left")}
    yield latches
    for latch in latches.values():
        latch.close()


@pytest.fixture
def desk(latches: dict[str, Latch]) -> Desk:
    return Desk(latches)


@pytest.fixture
def served(desk: Desk) -> Iterator[Path]:
    """Serve in a thread of this process."""
    link, address = bind("test")
    ending = threading.Event()

    def serve() -> None:
        while not ending.is_set():
            desk.serve(link)

    thread = threading.Thread(target=serve)
    thread.start()
    yield Path(address)
    ending.set()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
        last.sendto(b"end", address)
    thread.join()
    link.close()


def holds(latches: dict[str, Latch]) -> dict[str, int]:
    return {name: latch.holds for name, latch in latches.items()}


def test_all_displays_or_one_are_stopped(desk: Desk, latches: dict[str, Latch]) -> None:
    assert desk.answer(b'{"estop": "left"}', "me") == {"estops": {"left": 1}}
    assert holds(latches) == {"right": 0, "left": 1}
    assert desk.answer(b'{"estop": null}', "me") == {"estops": {"right": 1, "left": 2}}
    assert latches["left"].reason.startswith("me, ")


def test_a_request_that_is_sent_again_is_one_e_stop(desk: Desk, latches: dict[str, Latch]) -> None:
    for _ in range(3):
        answer = desk.answer(b'{"estop": "left", "id": "abc"}', "me")
        assert answer == {"estops": {"left": 1}}
    assert desk.answer(b'{"estop": "left", "id": "def"}', "me") == {"estops": {"left": 2}}
    for k in range(1000):
        desk.answer(b'{"estop": "left", "id": "%d"}' % k, "me")
    answer = desk.answer(b'{"estop": "left", "id": "abc"}', "me")
    assert answer == {"estops": {"left": 1003}}, "memory is bounded: it is taken for another"


class WaitsForDeaf(ModelClock):
    """Time that passes where one of two processes is waited for that never answers."""

    def select(self, links: list[Any], _: object, __: object, seconds: float) -> Any:
        if len(links) > 1:
            return select.select(links, [], [], PATIENCE)
        self.sleep(seconds)
        return [], [], []


def test_one_server_that_hangs_holds_up_no_other(
    served: Path, latches: dict[str, Latch], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer tells of both: the one that was stopped, and the one that did not answer."""
    path, clock = served.with_name("estop-1.sock"), WaitsForDeaf()
    begun = clock.now()
    monkeypatch.setattr(estop_request, "MONOTONIC", clock)
    monkeypatch.setattr(estop_request, "select", SimpleNamespace(select=clock.select))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as deaf:
        deaf.bind(str(path))
        silent, stopped = request_estop(within=2.0)
        deaf.setblocking(False)
        requests = [deaf.recv(1000) for _ in range(8)]
    assert clock.now() - begun == pytest.approx(2.0)
    assert len(set(requests)) == 1, "it is sent again and again"
    assert (silent.socket, silent.failure) == (str(path), "no answer within 2 s")
    assert stopped.estops == {"right": 1, "left": 1}
    assert latches["right"].number == 1, "sent again to one, it was no second e-stop of the other"


def test_what_a_killed_process_has_left_is_removed(served: Path) -> None:
    path = served.with_name("estop-1.sock")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as gone:
        gone.bind(str(path))
    first, second = request_estop(within=PATIENCE)
    assert first.failure == "nobody listens there any more"
    assert second.estops
    assert not path.exists()


def test_an_unknown_display_is_named(desk: Desk, latches: dict[str, Latch]) -> None:
    answer = desk.answer(b'{"estop": "rihgt"}', "me")
    assert answer == {"error": "no display 'rihgt'; there are right, left", "unknown": True}
    assert holds(latches) == {"right": 0, "left": 0}


@given(
    st.one_of(
        st.binary(max_size=200),
        st.recursive(
            st.none() | st.integers() | st.text(),
            lambda x: st.lists(x) | st.dictionaries(st.text(), x),
            max_leaves=5,
        ).map(lambda value: json.dumps(value).encode()),
        st.dictionaries(st.just("estop"), st.integers() | st.lists(st.integers())).map(
            lambda value: json.dumps(value).encode()
        ),
    )
)
def test_what_is_no_request_is_answered_and_stops_nothing(request: bytes) -> None:
    with closing(Latch.open("sim:", Path())) as latch:
        answer = Desk({"right": latch}).answer(request, "me")
        assert "error" in answer
        assert latch.holds == 0


def test_a_program_of_another_process_finds_it_and_is_named(
    served: Path, latches: dict[str, Latch]
) -> None:
    assert estop_sockets() == [served]
    assert served.parent == runtime_folder()
    (answer,) = request_estop(within=PATIENCE)
    assert answer.estops == {"right": 1, "left": 1}
    assert not answer.failure
    assert f"user {os.getuid()}, process {os.getpid()}" in latches["right"].reason


def test_others_may_write_to_the_socket(served: Path) -> None:
    assert served.stat().st_mode & 0o777 == 0o666


def test_others_may_enter_the_folder_of_the_socket_but_not_change_it() -> None:
    """The server makes the folder, whatever its umask takes away from files that it creates."""
    assert not runtime_folder().exists()
    usual = os.umask(0)
    try:
        link, _ = bind("test")
    finally:
        os.umask(usual)
    link.close()
    assert runtime_folder().stat().st_mode & 0o777 == 0o755


class Awaited(threading.Event):
    """Events that the saving thread waits for: two e-stops, and the end."""

    def __init__(self, story: list[str]) -> None:
        super().__init__()
        self._story, self._left = story, 2

    def wait(self, timeout: float | None = None) -> bool:
        """Tell that it is waited for; what was set must have been cleared."""
        assert not self.is_set()
        self.set()
        self._story.append("waits")
        if not self._left:
            raise EOFError
        self._left -= 1
        return True


def test_every_e_stop_is_saved_once_in_each_latch(
    desk: Desk, latches: dict[str, Latch], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An e-stop that cannot be saved keeps no other from being saved."""
    story: list[str] = []

    def save(name: str) -> None:
        story.append(name)
        assert len(story) < 20, "it saves what nobody changed"
        if name == "right":
            raise OSError(errno.EIO, "Input/output error")

    for name, latch in latches.items():
        monkeypatch.setattr(latch, "save", partial(save, name))
    monkeypatch.setattr(desk, "_new", Awaited(story))
    with pytest.raises(EOFError):
        desk.save()
    assert story == ["waits", "right", "left", "waits", "right", "left", "waits"]


PROGRAM = "from tactile.estop.process import main; main()"


def test_the_process_ends_with_the_server_whatever_became_of_that(
    latches: dict[str, Latch],
) -> None:
    """The standard input of the process ends; nobody is left who could kill it."""
    files = {name: latch.descriptor for name, latch in latches.items()}
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        pass_fds=[file for file in files.values() if file is not None],
    ) as process:  # fmt: skip
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            setup = EstopSetup({name: latch.handle for name, latch in latches.items()})
            process.stdin.write(pickle.dumps(setup))
            process.stdin.flush()
            assert select.select([process.stdout], [], [], PATIENCE)[0], "it says nothing"
            ready = pickle.load(process.stdout)
            assert ready == EstopReady(str(runtime_folder() / f"estop-{os.getpid()}.sock"))
            (answer,) = request_estop(within=PATIENCE)
            assert answer.estops == {"right": 1, "left": 1}
            process.stdin.close()
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()
    assert estop_sockets() == []


def test_a_process_that_has_no_socket_says_why_and_ends() -> None:
    runtime_folder().write_text("no folder")
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM], input=pickle.dumps(EstopSetup({})),
        capture_output=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert process.returncode == 1
    told = pickle.loads(process.stdout)
    assert told.address == ""
    assert "File exists" in told.failure


def test_who_reads_no_answers_holds_up_nobody(served: Path, latches: dict[str, Latch]) -> None:
    """The queue of answers runs full, and further answers are discarded."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as deaf:
        deaf.bind("")
        for _ in range(1000):
            deaf.sendto(b'{"estop": "left"}', str(served))
        (answer,) = request_estop("right", within=PATIENCE)
    assert answer.estops == {"right": 1}
    assert latches["left"].number == 1000


def test_rubbish_and_datagrams_that_are_too_long_hold_up_nobody(served: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        for size in (0, 1, 100, 60_000):
            link.sendto(b"\xff" * size, str(served))
    (answer,) = request_estop(within=PATIENCE)
    assert answer.estops == {"right": 1, "left": 1}


def test_a_server_that_is_gone_is_told_apart_from_one_that_stops(latches: dict[str, Latch]) -> None:
    link, address = bind("test")
    link.close()
    (answer,) = request_estop(within=PATIENCE)
    assert answer == EstopAnswer(address, failure="nobody listens there any more")


def test_what_a_process_that_was_killed_has_left_hinders_no_other() -> None:
    addresses = []
    for _ in range(2):
        link, address = bind("test")
        link.close()
        addresses.append(address)
    assert addresses[0] == addresses[1]


def test_where_no_server_runs_there_is_no_answer() -> None:
    assert request_estop() == []
