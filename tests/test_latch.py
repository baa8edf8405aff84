"""Tests of the e-stop latch: what sets it, what ends it, and which deaths it survives."""

import errno
import os
import signal
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing
from itertools import permutations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile.clock import ModelClock
from tactile.errors import BusError, InputError
from tactile.estop import latch as module
from tactile.estop.latch import CLEARED, Latch, LatchWriter, file_name, inherit_estops

DEVICE = "serial:///dev/ttyACM0?rearm=true"
WRITERS = list(LatchWriter)
SIZE = 8 * 8 + 3 * 256
"""Bytes of a file: eight words, and a time and a note for each of three writers. One of another
size is damaged, and so an e-stop: a file of an earlier version would be one."""
LOCK_WITHIN = 3.0
"""Time in which what is left of a killed server has to release its file [s]."""


def opened(folder: Path, device: str = DEVICE) -> AbstractContextManager[Latch]:
    """Open the latch as a server that starts does, and close it in the end."""
    return closing(Latch.open(device, folder))


@pytest.fixture
def latch(tmp_path: Path) -> Iterator[Latch]:
    with opened(tmp_path) as latch:
        yield latch


def test_a_new_latch_holds_nothing(latch: Latch) -> None:
    assert (latch.number, latch.holds, latch.reason) == (0, 0, "")


def test_an_e_stop_holds_until_its_number_is_cleared(latch: Latch) -> None:
    assert latch.trip("by a person") == 1
    assert latch.holds == 1
    assert latch.reason.startswith("by a person, 20")
    latch.clear(1)
    assert (latch.number, latch.holds) == (1, 0)
    assert latch.trip("again") == 2
    latch.clear(1)
    assert latch.holds == 2, "a clear of an older e-stop ends no newer one"
    latch.clear(99)
    assert latch.holds == 0
    assert latch.trip("once more") == latch.holds == 3, "nor one that was yet to come"


def test_it_holds_over_a_restart_of_the_server(tmp_path: Path) -> None:
    with opened(tmp_path) as latch:
        latch.trip("by a person")
        latch.save()
    with opened(tmp_path) as latch:
        assert latch.holds == 1
        assert "by a person" in latch.reason
        latch.clear(1)
    with opened(tmp_path) as latch:
        assert latch.holds == 0


@given(st.lists(st.sampled_from([*WRITERS, "clear latest", "clear older"]), max_size=30))
def test_whoever_trips_it_all_see_the_same(steps: list[object]) -> None:
    """Three writers, each with a mapping of its own, are compared with plain counting."""
    server = Latch.open("sim:", Path())
    views = {writer: Latch(f"fd:{os.dup(_fd(server))}", writer) for writer in WRITERS}
    number = cleared = 0
    for step in steps:
        if isinstance(step, LatchWriter):
            number += 1
            assert views[step].trip(step.name) == number
            assert step.name in views[LatchWriter.SERVER].reason
        else:
            names = number if step == "clear latest" else max(number - 1, 0)
            views[LatchWriter.SERVER].clear(names)
            cleared = max(cleared, names)
        expected = number if number > cleared else 0
        assert {view.holds for view in views.values()} == {expected}
    for view in [*views.values(), server]:
        view.close()


def test_each_that_trips_it_counts_in_a_word_of_its_own(tmp_path: Path) -> None:
    """None ever waits for another, nor loses an e-stop to it; and the note of each stays.

    Three words after the first, then the one that holds what was cleared.
    """
    longest = {writer: f"{writer.name} " + 300 * writer.name[0] for writer in WRITERS}
    with opened(tmp_path) as server:
        for count, writer in enumerate(WRITERS, start=1):
            with closing(Latch(f"fd:{os.dup(_fd(server))}", writer)) as view:
                for _ in range(count):
                    view.trip(longest[writer])
                note = view.reason.rpartition(", ")[0]
                assert note == longest[writer][:248], "as much of it as there is room for"
        server.clear(4)
    content = (tmp_path / file_name(DEVICE)).read_bytes()
    assert struct.unpack_from("<4Q", content, 8) == (1, 2, 3, 4)
    for note in longest.values():
        assert note[:248].encode() in content


def _fd(latch: Latch) -> int:
    assert latch.descriptor is not None
    return latch.descriptor


@pytest.mark.parametrize(
    "content",
    [b"x", bytes(SIZE), bytes(SIZE - 1), bytes(SIZE + 1), b"\xff" * SIZE],
    ids=["short", "zeros", "cut", "long", "noise"],
)
def test_a_damaged_file_is_an_e_stop(tmp_path: Path, content: bytes) -> None:
    (tmp_path / file_name(DEVICE)).write_bytes(content)
    with opened(tmp_path) as latch:
        assert latch.holds == 1
        assert "damaged" in latch.reason
        latch.clear(1)
    with opened(tmp_path) as latch:
        assert latch.holds == 0


def test_a_file_that_says_more_was_cleared_than_tripped_is_damaged(tmp_path: Path) -> None:
    with opened(tmp_path) as latch:
        latch._words[CLEARED] = 9
    with opened(tmp_path) as latch:
        assert latch.holds == 1


def test_all_blocks_are_there_from_the_beginning(latch: Latch, tmp_path: Path) -> None:
    """A disk that is full must not keep an e-stop from being written."""
    path = tmp_path / file_name(DEVICE)
    assert path.stat().st_size == SIZE
    assert path.stat().st_blocks > 0
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_second_server_does_not_get_it(
    latch: Latch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LOCK_WITHIN", 0.0)
    with pytest.raises(BusError, match="another program has it"):
        Latch.open(DEVICE, tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="needs locks of files")
def test_who_closes_it_lets_the_next_server_in_though_a_child_still_has_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LOCK_WITHIN", -1.0)
    with opened(tmp_path) as server:
        child = Latch(f"fd:{os.dup(_fd(server))}", LatchWriter.PLAYBACK)
    with closing(child), opened(tmp_path) as server:
        child.trip("by a child")
        assert server.holds == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs modes of files")
def test_its_folder_is_made_for_its_user_alone(tmp_path: Path) -> None:
    usual = os.umask(0)
    try:
        with opened(tmp_path / "state"):
            assert (tmp_path / "state").stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(usual)


def test_a_simulated_display_has_one_that_nobody_else_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with opened(tmp_path, "sim:") as first, opened(tmp_path, "sim:") as second:
        first.trip("by a person")
        assert (first.holds, second.holds) == (1, 0)
        if sys.platform != "win32":  # which lets nobody remove a file that is open
            assert not list(tmp_path.iterdir()), "not even while it is used"


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    with pytest.raises(InputError, match=r"e-stop latch of serial.*STATE_DIRECTORY") as caught:
        Latch.open(DEVICE, blocked / "folder")
    assert "\n" not in str(caught.value)


def test_file_names_differ_as_devices_do_and_are_short() -> None:
    long = [f"serial:{'x' * k}" for k in (300, 301)]
    devices = ["mock:", "mock:?a=1", "can:a/b", "can:a_b", *long]
    names = [file_name(device) for device in devices]
    assert len(set(names)) == len(names)
    assert all(len(name) < 255 and "/" not in name for name in names)


EDITED = DEVICE + "&baud=9600"
LONG = f"serial:///dev/{'x' * 150}?format="


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (DEVICE, EDITED),
        (EDITED, "serial:///dev/ttyACM0"),
        (EDITED, "serial:/dev/ttyACM0"),
        (LONG + "a" * 60, LONG + "b" * 60),
    ],
)
def test_an_e_stop_holds_though_the_options_of_the_url_were_edited(
    tmp_path: Path, before: str, after: str
) -> None:
    with opened(tmp_path, before) as latch:
        latch.trip("by a person")
    with opened(tmp_path, after) as latch:
        inherit_estops({after: latch}, [after], tmp_path)
        assert latch.holds == 1
        assert latch.reason.startswith("by a person, 20")
        assert "edited" in latch.reason
        latch.clear(1)
        inherit_estops({after: latch}, [after], tmp_path)
        assert latch.holds == 0, "taken over once"
    with opened(tmp_path, before) as latch:
        assert latch.holds == 0


@pytest.mark.skipif(sys.platform == "win32", reason="needs links")
def test_an_e_stop_holds_though_the_device_is_named_by_another_link(tmp_path: Path) -> None:
    port, by_id, by_path = (tmp_path / name for name in ("ttyACM0", "by-id", "by-path"))
    port.touch()
    by_id.symlink_to(port)
    by_path.symlink_to(by_id)
    names = [f"serial://{path}" for path in (port, by_id, by_path)]
    for before, after in permutations(names, 2):
        with opened(tmp_path, before) as latch:
            latch.trip("by a person")
        with opened(tmp_path, after) as latch:
            inherit_estops({after: latch}, [after], tmp_path)
            assert latch.holds
            latch.clear(latch.holds)
    with opened(tmp_path, names[1]) as latch:
        latch.trip("by a person")
    by_id.unlink()
    by_id.symlink_to(tmp_path / "ttyACM1")
    with opened(tmp_path, names[0]) as latch:
        inherit_estops({names[0]: latch}, [names[0]], tmp_path)
        assert latch.holds == 0, "of the device that the link leads to now"


@pytest.mark.parametrize("other", ["serial:///dev/ttyACM01", "serial:///dev/ttyACM", "mock:"])
def test_the_e_stop_of_another_device_stays_there(tmp_path: Path, other: str) -> None:
    with opened(tmp_path, other) as latch:
        latch.trip("by a person")
    with opened(tmp_path) as latch:
        inherit_estops({DEVICE: latch}, [DEVICE], tmp_path)
        assert latch.holds == 0
    with opened(tmp_path, other) as latch:
        assert latch.holds == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs locks of files")
@pytest.mark.parametrize("servers", [1, 2])
def test_displays_on_one_bus_keep_their_own_e_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, servers: int
) -> None:
    """The displays are those of one server, which does not wait for itself, and those of two."""

    class Impatient(ModelClock):
        def sleep(self, seconds: float) -> None:
            pytest.fail("waits for a lock")

    if servers == 2:
        monkeypatch.setattr(module, "LOCK_WITHIN", -1.0)
    with opened(tmp_path, EDITED) as other, opened(tmp_path) as latch:
        other.trip("by a person")
        used = [DEVICE, EDITED][: 3 - servers]
        inherit_estops({DEVICE: latch}, used, tmp_path, clock=Impatient())
        assert (other.holds, latch.holds) == (1, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="needs locks of files")
def test_an_e_stop_is_taken_over_from_a_server_that_dies_slowly(tmp_path: Path) -> None:
    """The rest of a server that was killed has the lock for almost as long as is waited."""
    dying = Latch.open(DEVICE, tmp_path)
    dying.trip("by a person")

    class Dying(ModelClock):
        def sleep(self, seconds: float) -> None:
            super().sleep(seconds)
            if self.time > 1.0 + 0.9 * LOCK_WITHIN:
                dying.close()

    with opened(tmp_path, EDITED) as latch:
        inherit_estops({EDITED: latch}, [EDITED], tmp_path, clock=Dying())
        assert latch.holds == 1


def test_a_file_that_cannot_be_read_is_an_e_stop(tmp_path: Path) -> None:
    """A file that no server made is no e-stop."""
    for name in ("mock%3A%2F%2F[", "serial%3A%2F%2F%2F%00"):
        (tmp_path / f"{name}.estop").touch()
    with opened(tmp_path, EDITED) as latch:
        inherit_estops({EDITED: latch}, [EDITED], tmp_path)
        assert latch.holds == 0
        path = tmp_path / file_name(DEVICE)
        path.mkdir()
        inherit_estops({EDITED: latch}, [EDITED], tmp_path)
        assert latch.holds == 1
        assert "Is a directory" in latch.reason


def test_an_e_stop_that_is_not_saved_stays_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with opened(tmp_path) as latch:
        latch.trip("by a person")
    with opened(tmp_path, EDITED) as latch:
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", fail)
            inherit_estops({EDITED: latch}, [EDITED], tmp_path)
        assert latch.holds
        assert "Input/output error" in latch.reason
    with opened(tmp_path) as latch:
        assert latch.holds == 1


KILLED = """
import os, sys
from pathlib import Path
from tactile.estop.latch import Latch
latch = Latch.open("mock:", Path(sys.argv[1]))
print(latch.trip("by a program that is killed"), flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_what_a_killed_server_latched_holds(tmp_path: Path) -> None:
    words = [sys.executable, "-c", KILLED, str(tmp_path)]
    for number in (1, 2, 3):
        with subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as server:
            assert server.stdout is not None
            assert server.stdout.readline() == f"{number}\n"
            server.send_signal(signal.SIGKILL)
    with opened(tmp_path, "mock:") as latch:
        assert latch.holds == 3
