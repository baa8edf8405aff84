"""Tests of sessions: what a server played is rendered again from its recording alone."""

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from cli_rig import Command
from session_rig import NAME, SERIAL, SPECTRUM, Story, recorded_session
from virtual_server import RecorderProcess, virtual_world

import tactile
from tactile import messages as m
from tactile.bus.base import DriveBlock, DriveFrame
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.errors import InputError, NotFoundError
from tactile.files import SourceFile
from tactile.playback.commands import DeviceOpened
from tactile.playback.mixer import BlockInput
from tactile.playback.session_messages import SessionHeader
from tactile.playback.session_parts import (
    SessionBlock,
    SessionEvent,
    SessionPart,
    part_files,
    write_part,
)
from tactile.playback.session_recorder import LEAST_FREE, SessionRecorder
from tactile.playback.session_replay import render_session, replay_session
from tactile.playback.session_ring import DUE_PLACES, RECORDS, Kind, SessionRing
from tactile.server.config import Configuration, DisplayConfig, RecordConfig
from tactile.server.session_recording import prepare_folder
from tactile.tracking.finger_sample import FingerSample, rounded


@pytest.fixture
def story(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Story]:
    with virtual_world(lambda playback, volts: None) as world:
        yield Story(world, tmp_path)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the session of a story on a serial link."""
    return recorded_session(tmp_path_factory.mktemp("session"))


def rendered(session: Path) -> list[tuple[SessionBlock, DriveBlock | DriveFrame]]:
    """Return the blocks of a session and their drives, rendered again."""
    return [
        (what, drive)
        for what, drive in render_session(session)
        if isinstance(what, SessionBlock) and drive is not None
    ]


def test_what_was_written_to_the_link_is_rendered_again_bit_for_bit(
    story: Story, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, written = ModeledBus.write, []

    def write(bus: ModeledBus, block: DriveBlock) -> None:
        written.append((block.position, block.volts.copy()))
        real(bus, block)

    monkeypatch.setattr(ModeledBus, "write", write)
    story.play_everything(*story.start(SERIAL, 8000.0))
    story.world.stop()
    (session,) = story.sessions
    again = rendered(session)
    assert len(again) == len(written) > 500
    for (position, volts), (_, drive) in zip(written, again, strict=True):
        assert drive.position == position
        np.testing.assert_array_equal(drive.volts, volts)
    loud = sum(bool(volts.any()) for _, volts in written)
    assert loud > 400
    result = replay_session(session)
    assert result.is_identical
    assert result.compared_blocks == len(written)


def test_a_session_on_a_link_that_takes_frames_is_rendered_again(story: Story) -> None:
    one, two = story.start(SPECTRUM, None)
    story.ask(one, m.Select(display=NAME, layers=(m.Layer(texture="wood-oak"),)))
    assert isinstance(story.ask(one, m.ArmDisplay(display=NAME)), m.Done)
    story.slide(one, 0.4)
    story.ask(two, m.Select(display=NAME, layers=(m.Layer(texture="leather-calf"),)))
    story.slide(two, 0.4)
    story.world.stop()
    (session,) = story.sessions
    result = replay_session(session)
    assert result.is_identical
    assert result.compared_blocks > 20
    assert max(float(np.abs(drive.volts).max()) for _, drive in rendered(session)) > 0.1


def test_each_start_of_playback_is_a_session_of_its_own(story: Story) -> None:
    one, _ = story.start("mock:", 8000.0)
    story.ask(one, m.Select(display=NAME, layers=(m.Layer(texture="wood-oak"),)))
    story.ask(one, m.ArmDisplay(display=NAME))
    story.slide(one, 0.2)
    (playback,) = story.world.playbacks()
    playback.kill()
    story.pause(3.0)
    assert isinstance(story.ask(one, m.ArmDisplay(display=NAME)), m.Done)
    story.slide(one, 0.2)
    story.world.stop()
    assert len(story.sessions) == 2
    for session in story.sessions:
        assert replay_session(session).is_identical
        assert max(float(np.abs(drive.volts).max()) for _, drive in rendered(session)) > 1.0


def test_a_killed_server_leaves_a_session_that_is_complete(story: Story) -> None:
    one, _ = story.start("mock:", 8000.0)
    story.ask(one, m.ArmDisplay(display=NAME))
    story.slide(one, 0.2)
    story.world.kill()
    story.world.clock.advance(1.0)
    (session,) = story.sessions
    assert replay_session(session).is_identical
    assert replay_session(session).compared_blocks > 50


def test_a_full_disk_ends_the_recording_and_nothing_else(
    story: Story, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    one, _ = story.start("mock:", 8000.0)
    story.ask(one, m.ArmDisplay(display=NAME))
    story.slide(one, 0.2)
    host = story.world.host
    assert host is not None
    assert host.figures()[NAME]["recording"] == 1
    full = shutil.disk_usage(story.folder)._replace(free=LEAST_FREE - 1)
    monkeypatch.setattr("shutil.disk_usage", lambda path: full)
    monkeypatch.setattr("tactile.playback.session_recorder.PART", 0.5)
    story.slide(one, 1.0)
    lines = [record.message for record in caplog.records if "nothing is recorded" in record.message]
    assert lines == ["left: nothing is recorded any more: less than 256 MiB of the disk are free"]
    before = host.figures()[NAME]
    assert before["recording"] == 0
    story.slide(one, 0.2)
    assert host.figures()[NAME]["blocks_total"] > before["blocks_total"]


def test_a_folder_that_takes_no_file_is_refused_at_the_start(story: Story) -> None:
    (story.folder / "file").write_text("")
    folder = str(story.folder / "file" / "sessions")
    config = Configuration(
        display=(DisplayConfig(name=NAME, device="mock:"),), record=RecordConfig(folder=folder)
    )
    assert not story.world.start(config)
    with pytest.raises(InputError, match=r"record\.folder = .*: no file can be created in it"):
        prepare_folder(folder)


def test_news_are_recorded_with_their_times(session: Path) -> None:
    news = tactile.load_session(session).messages
    kinds = [one["kind"] for one in news]
    assert {"armed", "estopped", "cleared", "link"} <= set(kinds)
    times = [one["time_s"] for one in news]
    assert times == sorted(times)


def test_a_session_is_loaded_as_arrays(session: Path) -> None:
    loaded = tactile.load_session(session)
    contacts: dict[str, Any] = loaded.contacts
    blocks: dict[str, Any] = loaded.blocks
    assert loaded.header.name == NAME
    assert 300 < len(contacts["time_s"]) <= 431, "those that playback used of what was sent"
    x, y = contacts["x_m"], contacts["y_m"]
    touching = contacts["normal_force_n"] > 0
    np.testing.assert_allclose(np.hypot(x / 0.06, y / 0.02)[touching], 1.0, atol=1e-6)
    known = np.isfinite(contacts["velocity_x_m_s"])
    assert set(contacts["client"][known]) == {contacts["client"][101]}
    np.testing.assert_allclose(contacts["velocity_x_m_s"][known], 3 * y[known], atol=1e-5)
    assert (np.diff(contacts["arrival_s"]) >= 0).all()
    assert (blocks["due_s"] > blocks["rendered_s"]).all()
    drives = list(loaded.drives())
    assert [due for due, _ in drives] == blocks["due_s"].tolist()
    assert [drive.position for _, drive in drives] == blocks["position"].tolist()


def changed(session: Path, folder: Path, change: Callable[[h5py.File], None]) -> Path:
    """Return a copy of a session of one part, whose file was changed."""
    copy = folder / "copy"
    copy.mkdir()
    path = copy / "part-000001.h5"
    path.write_bytes((session / "part-000001.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        change(file)
    return copy


def test_a_contact_that_differs_shows_at_the_block_that_took_it(
    session: Path, tmp_path: Path
) -> None:
    def change(file: h5py.File) -> None:
        file["contacts/x_10nm"][50] += 100_000  # 1 mm, of this contact and all after it

    result = replay_session(changed(session, tmp_path, change))
    assert not result.is_identical
    part = SessionPart(*part_files(session))
    taken = np.cumsum(
        [len(what.rendered_from.contacts) for what in part if isinstance(what, SessionBlock)]
    )
    assert result.first_block is not None
    # A contact changes the course from the block that took it on, at first by almost nothing.
    assert 0 <= result.first_block - int(np.argmax(taken > 50)) < 5


def test_sessions_that_cannot_be_replayed_say_why(session: Path, tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"part-000001\.h5"):
        replay_session(tmp_path)

    def forget_orders(file: h5py.File) -> None:
        del file["orders"]
        file["orders"] = np.zeros(0, np.uint8)

    missing = replay_session(changed(session, tmp_path, forget_orders))
    assert not missing.is_identical
    assert missing.missing.startswith("order ")
    (tmp_path / "copy" / "part-000001.h5").rename(tmp_path / "copy" / "part-000003.h5")
    with pytest.raises(InputError, match=r"part-000001\.h5 is missing"):
        replay_session(tmp_path / "copy")
    (tmp_path / "copy" / "part-000003.h5").rename(tmp_path / "copy" / "part-000001.h5")
    (tmp_path / "copy" / "part-000001.h5").write_bytes(b"no HDF5")
    with pytest.raises(InputError, match="is no part of a session, or damaged"):
        replay_session(tmp_path / "copy")


@pytest.mark.parametrize(
    ("column", "change", "why"),
    [
        ("contacts/x_10nm", lambda c: c[:-1], "the columns of 'contacts' differ in length"),
        ("blocks/contacts", lambda c: c + 1, "the blocks took more or fewer contacts"),
        ("events/kind", lambda c: c + 9, "there is an unknown kind of event"),
        ("blocks/due_100ns", lambda c: c * 0.5, "a column of 'blocks' is no list of integers"),
        ("events/number", lambda c: c[None], "a column of 'events' is no list of integers"),
    ],
)
def test_a_damaged_part_is_refused_with_one_line(
    session: Path, tmp_path: Path, column: str, change: Callable[[Any], Any], why: str
) -> None:
    def damage(file: h5py.File) -> None:
        values = file[column][:]
        del file[column]
        file[column] = change(values)

    with pytest.raises(InputError, match=rf"part-000001\.h5: .*{why}"):
        replay_session(changed(session, tmp_path, damage))


def test_a_session_of_a_newer_version_is_refused_by_its_format(
    session: Path, tmp_path: Path
) -> None:
    def renew(file: h5py.File) -> None:
        text = bytes(file["header"][:]).replace(b'"format":1', b'"format":2')
        del file["header"], file["blocks"]
        file["header"] = np.frombuffer(text, np.uint8)

    with pytest.raises(InputError, match=r"part-000001\.h5: has format 2, must be 1; use the ver"):
        replay_session(changed(session, tmp_path, renew))


def test_the_command_exits_with_1_and_names_the_first_block_that_differs(
    session: Path, tmp_path: Path, command: Command
) -> None:
    same = command("replay", session)
    assert (same.code, same.err) == (0, "")
    assert same.out.endswith(" are identical\n")

    def change(file: h5py.File) -> None:
        file["blocks/digest"][7] ^= 1

    other = command("replay", changed(session, tmp_path, change), "--json")
    assert other.code == 1
    assert "the drive differs from block 7 on, at 0.01" in other.err
    assert other.json["first_block"] == 7
    nothing = command("replay", tmp_path)
    assert (nothing.code, nothing.out) == (2, "")
    assert "holds no session" in nothing.err


def test_what_follows_lost_records_is_not_compared(session: Path, tmp_path: Path) -> None:
    def change(file: h5py.File) -> None:
        kinds = file["events/kind"][:]
        kinds[-1] = Kind.LOST
        file["events/kind"][:] = kinds

    copy = changed(session, tmp_path, change)
    result = replay_session(copy)
    assert result.missing.endswith(" records")
    assert not result.is_identical
    with h5py.File(copy / "part-000001.h5") as file:
        assert result.compared_blocks == np.sum(file["events/before_block"][:])


def block(number: int, *contacts: FingerSample) -> BlockInput:
    taken = tuple((7, sample) for sample in contacts)
    return BlockInput(number, 16 * number, False, 1.0, 1.01, taken)


def test_a_full_ring_never_waits_and_tells_how_much_it_lost() -> None:
    ring, drive = SessionRing.create(), DriveBlock(0, np.zeros((16, 2)))
    reader = SessionRing(ring.handle)
    for k in range(RECORDS + 10):
        ring.add_block(block(k), drive)
    assert ring.lost == 10
    rows = reader.take()
    assert rows["number"].tolist() == list(range(RECORDS))
    ring.add_block(block(99), drive)
    kinds = [(Kind(row["kind"]), int(row["number"])) for row in reader.take()]
    assert kinds == [(Kind.LOST, 10), (Kind.BLOCK, 99)]
    assert len(reader.take()) == 0
    ring.close()


def header() -> SessionHeader:
    return SessionHeader(
        name=NAME, device="mock:", display=SourceFile("four.toml", ""), voltage_limit_v=50.0,
        how=DeviceOpened(8000.0), gain=1.0, worn=False,
    )  # fmt: skip


def written(folder: Path, ring: SessionRing) -> SessionPart:
    write_part(folder, 1, header(), ring.take(), b"", b"")
    return SessionPart(folder / "part-000001.h5")


def test_a_block_that_is_lost_takes_its_contacts_with_it(tmp_path: Path) -> None:
    drive = DriveBlock(0, np.zeros((16, 2)))
    with closing(SessionRing.create()) as ring:
        for k in range(RECORDS - 1):
            ring.add_block(block(k), drive)
        ring.add_block(block(99, FingerSample(1.0, 1.0, 0.0, 0.0, 0.5)), drive)
        assert ring.lost == 2
        ring.add_order(5)  # there is no room for the record about those that were lost, and this
        assert ring.lost == 3
        part = written(tmp_path, ring)
        assert len(part.blocks()["due_s"]) == RECORDS - 1
        ring.add_silence()
        events = [what for what in written(tmp_path, ring) if isinstance(what, SessionEvent)]
    assert [(event.kind, event.number) for event in events] == [(Kind.LOST, 3), (Kind.SILENCE, 0)]


@pytest.mark.parametrize("days", [0.01, 50, 120, 400, 2000])
def test_times_are_read_as_they_were_rendered_however_long_the_host_runs(
    tmp_path: Path, days: float
) -> None:
    rng, drive = np.random.default_rng(0), DriveBlock(0, np.zeros((16, 2)))
    inputs = []
    with closing(SessionRing.create()) as ring:
        for k, now in enumerate((86400 * days + np.cumsum(rng.uniform(0, 0.01, 3000))).tolist()):
            sample = rounded(FingerSample(now - 1e-3 * rng.random(), now, *rng.random(3).tolist()))
            due = round(now + 0.01, DUE_PLACES)
            inputs.append(BlockInput(k, 16 * k, False, round(now, 6), due, ((7, sample),)))
            ring.add_block(inputs[-1], drive)
        part = written(tmp_path, ring)
    assert [what.rendered_from for what in part if isinstance(what, SessionBlock)] == inputs


def test_a_display_that_does_nothing_writes_nothing(tmp_path: Path) -> None:
    with closing(SessionRing.create()) as ring:
        recorder = SessionRecorder(tmp_path, header(), ring)
        ring.add_block(block(0), DriveBlock(0, np.zeros((16, 2))))
        for minute in range(10):
            recorder.turn(60.0 * minute)
    assert [path.name for path in tmp_path.iterdir()] == ["part-000001.h5"]


def test_nothing_waits_for_a_recorder_that_hangs(
    story: Story, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, _ = story.start("mock:", 8000.0)
    monkeypatch.setattr(RecorderProcess, "finish", lambda process: None)
    story.ask(one, m.ArmDisplay(display=NAME))
    (playback,) = story.world.playbacks()
    playback.kill()
    story.pause(3.0)
    assert isinstance(story.ask(one, m.ArmDisplay(display=NAME)), m.Done)
    begun = story.world.clock.now()
    story.world.stop()
    assert story.world.clock.now() - begun < 5.0, "systemd would kill the server"


def test_any_numbers_of_a_contact_are_rounded_to_what_is_stored() -> None:
    sample = FingerSample(1.23456789, 2.3456789, -1e-9, 0.123456789, 0.56789, (0.0123456, -1e-9))
    assert rounded(sample) == (1.234568, 2.345679, 0.0, 0.12345679, 0.5679, (0.01235, 0.0))
    assert math.copysign(1.0, rounded(sample).x) == 1.0, "integers have no negative zero"
    wild = rounded(FingerSample(math.nan, math.inf, 1e300, -math.inf, 0.0))
    assert math.isnan(wild.time)
    assert wild[1:4] == (math.inf, 1e300, -math.inf)
