"""Marks come on the marker lines of an amplifier with the samples for which they were set.

What the lines show is what the amplifiers of `firmware_protocol` put on them, instant by instant,
beside the drive; the first instant that is kept is that of the start.
"""

from collections.abc import Callable
from typing import cast

import numpy as np
import pytest
from link_rig import Panel, overheard
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.packet import Packet
from tactile.arrays import Floats
from tactile.bus import correlations, marks
from tactile.bus.base import Bus, DriveBlock, DriveFrame
from tactile.bus.board import config_of
from tactile.bus.link.inspection import amplifiers as facts_of
from tactile.bus.marks import AmplifierMarks, MarkReport
from tactile.bus.simulated import mock_bus, modeled_bus
from tactile.bus.simulated.mock_bus import MockBus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.display.display import load_display

LINKS = {
    "none": "mock:?keep=all",
    "serial": "mock:?link=serial&bit_rate=3000000&keep=all",
    "can": "mock:?link=can&keep=all",
    "canfd": "mock:?link=canfd&keep=all",
    "i2c": "mock:?link=i2c&bit_rate=1000000&keep=all",
}
BEGINS = {"none": -500, "serial": 10**10, "can": 0, "canfd": 2**32 - 100, "i2c": 7}
"""Position of the start on each link."""
BOARDS = "mock:?link=canfd&data_bit_rate=8000000&boards=2&keep=all"
EVERY = pytest.mark.parametrize("link", LINKS)
BLOCK = 40
LONG = 80
"""Length of a mark of 10 ms at 8 kHz [samples]."""


def amplifiers(bus: Bus) -> list[ReferenceAmplifier]:
    """Return the amplifiers of a bus in memory."""
    if isinstance(bus, MockBus):
        return [board.amplifier for board in bus.boards]
    return list(cast(ModeledBus, bus).model.amplifiers)


def play(
    bus: Bus,
    begin: int,
    count: int,
    wanted: dict[int, int] = {},  # noqa: B006
    level: float = 10.0,
) -> int:
    """Write a constant level, each mark just before its block; return the position that follows."""
    for k in range(begin, begin + count, BLOCK):
        for position, code in wanted.items():
            if k <= position < k + BLOCK:
                bus.mark(position, code)
        bus.write(DriveBlock(k, np.full((BLOCK, bus.wiring.channels), level)))
    return begin + count


def lines_of(bus: Bus) -> NDArray[np.uint8]:
    """Return the codes on the lines, with each sample of the output."""
    memory = cast(MockBus, bus)
    assert len(memory.lines) == len(memory.output)
    assert memory.lines.dtype == np.uint8
    return memory.lines


def shown(bus: Bus, begin: int = 0) -> list[tuple[int, int]]:
    """Return the changes of the lines: positions and codes."""
    lines = lines_of(bus).astype(int)
    return [(begin + int(k), int(lines[k])) for k in np.flatnonzero(np.diff(lines, prepend=0))]


def without_lines(monkeypatch: pytest.MonkeyPatch, *nodes: int) -> None:
    """Let amplifiers with these nodes have no marker lines."""

    def config(*arguments: object, marker_lines: int = 0, **named: object) -> AmplifierConfig:
        lines = 0 if arguments[2] in nodes else marker_lines
        make = cast(Callable[..., AmplifierConfig], config_of)
        return make(*arguments, marker_lines=lines, **named)

    for module in (mock_bus, modeled_bus):
        monkeypatch.setattr(module, "config_of", config)


# What is shown


@EVERY
def test_a_mark_is_on_the_lines_with_its_sample_for_10_ms_and_reported(link: str) -> None:
    begin = BEGINS[link]
    wanted = {begin: 1, begin + 417: 5, begin + 1000: 255, begin + 1039: 3}
    with open_bus(LINKS[link], Panel()) as bus:
        assert bus.marker_lines == 8
        bus.start(begin)
        play(bus, begin, 2000, wanted)
        bus.stop()
        expected = np.zeros(2000, np.uint8)
        for position, code in wanted.items():
            expected[position - begin :][:LONG] = code
        assert np.array_equal(lines_of(bus)[:2000], expected)
        assert not lines_of(bus)[2000:].any()
        assert [(r.position, r.code) for r in bus.take_marks()] == list(wanted.items())
        assert bus.take_marks() == []
        assert bus.counters.faults() == {}
        assert [a.counters.future_samples for a in amplifiers(bus)] == [0]


@EVERY
def test_marks_change_nothing_of_the_drive(link: str) -> None:
    outputs: list[Floats] = []
    for wanted in ({}, {400: 5, 417: 7, 1200: 9}):
        with open_bus(LINKS[link], Panel()) as bus:
            bus.start()
            random = np.random.default_rng(1)
            for k in range(0, 1600, 16):
                for position, code in wanted.items():
                    if k <= position < k + 16:
                        bus.mark(position, code)
                bus.write(DriveBlock(k, random.uniform(-2, 2, (16, 2))))
            bus.stop()
            outputs.append(cast(MockBus, bus).output)
    assert np.array_equal(outputs[0], outputs[1])


def test_a_simulated_display_has_lines_too() -> None:
    """Where currents are measured, the plant plays ahead of what is put out."""
    for url in ("sim:?keep=all", "sim:?keep=all&correlation_ms=25"):
        with open_bus(url, load_display("reference-24")) as bus:
            bus.start()
            play(bus, 0, 800, {321: 6}, level=0.0)
            bus.stop()
            assert shown(bus) == [(321, 6), (321 + LONG, 0)]
            assert bus.take_marks() == [MarkReport(321, 6)]


def test_only_the_last_second_is_kept_of_lines_as_of_the_output() -> None:
    with open_bus("mock:", Panel(), sample_rate=2500) as bus:
        bus.start()
        play(bus, 0, 5000, {40: 1, 4800: 2})
        lines = lines_of(bus)
        assert len(lines) < 3000
        assert np.flatnonzero(lines[::-1] == 2).tolist() == list(range(175, 200))
        assert not (lines == 1).any()


@pytest.mark.parametrize("begin", [0, 2**32 - 300])
def test_frames_are_marked_between_two_of_them_as_well(begin: int) -> None:
    with open_bus("mock:?link=serial&format=spectrum&keep=all", Panel()) as bus:
        assert bus.frames is not None
        spacing = round(bus.wiring.sample_rate / bus.frames.rate)
        bus.tune(np.array([100.0, 200.0]))
        bus.start(begin)
        wanted = [(begin + 3 * spacing - 1, 1), (begin + 5 * spacing, 2), (begin + 19 * spacing, 4)]
        for k in range(20):
            position = begin + k * spacing
            for at, code in wanted:
                if position - spacing < at <= position:
                    bus.mark(at, code)
            bus.write_frame(DriveFrame(position, np.full((2, 2), 5.0 + 0j)))
        bus.stop()
        changes = [change for at, code in wanted for change in ((at, code), (at + LONG, 0))]
        assert shown(bus, begin)[:-1] == changes[:-1]  # the stop is in the last one
        assert [(r.position, r.code) for r in bus.take_marks()] == wanted


def test_a_mark_far_ahead_waits_for_its_sample() -> None:
    """The later one is further ahead than the buffer of an amplifier is long."""
    for url in LINKS.values():
        with open_bus(url, Panel()) as bus:
            bus.start()
            bus.mark(3210, 2)
            bus.mark(800, 1)
            play(bus, 0, 4000)
            bus.stop()
            assert shown(bus) == [(800, 1), (800 + LONG, 0), (3210, 2), (3210 + LONG, 0)]
            assert [r.position for r in bus.take_marks()] == [800, 3210]


@EVERY
def test_the_pulse_goes_on_when_playing_ends(link: str) -> None:
    with open_bus(LINKS[link], Panel()) as bus:
        bus.start()
        play(bus, 0, 400, {390: 3})
        bus.stop()
        assert shown(bus)[0] == (390, 3)
        assert np.count_nonzero(lines_of(bus)) >= LONG // 2
        assert bus.take_marks() == [MarkReport(390, 3)]


@EVERY
def test_a_mark_goes_directly_before_its_samples(
    link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = overheard(monkeypatch)
    with open_bus(LINKS[link], Panel()) as bus:
        bus.start(BEGINS[link])
        bus.mark(BEGINS[link] + 1000, 5)
        play(bus, BEGINS[link], 2000)
        bus.stop()
    packets = [packet for packet, _ in heard]
    (k,) = [k for k, packet in enumerate(packets) if packet.type == m.Mark.TYPE]
    assert not packets[k].flags & m.Flag.ACK_REQUEST
    mark = m.Mark.unpack(packets[k].payload)
    following = next(packet for packet in packets[k:] if packet.type == m.Pcm.TYPE)
    pcm = m.Pcm.unpack(following.payload)
    assert mark is not None
    assert pcm is not None
    assert (mark.code, mark.samples) == (5, LONG)
    assert 0 <= (mark.position - pcm.position) % 2**32 < pcm.samples


# Who shows


def test_the_first_board_with_lines_shows_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = overheard(monkeypatch)
    with open_bus(BOARDS, Panel(channels=4), sample_rate=4000) as bus:
        assert bus.marker_lines == 8
        bus.start()
        play(bus, 0, 800, {300: 1})
        bus.stop()
        assert shown(bus) == [(300, 1), (340, 0)]
        assert bus.take_marks() == [MarkReport(300, 1)]
    assert [p.node for p, _ in heard if p.type == m.Mark.TYPE] == [1]


@pytest.mark.parametrize("drift", [1000, -1000])
def test_a_board_that_follows_shows_marks_with_its_sample(
    drift: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same value is put out some positions away, after a while."""
    without_lines(monkeypatch, 1)
    with open_bus(f"{BOARDS}&drift_ppm={drift}", Panel(channels=4), sample_rate=4000) as bus:
        assert bus.marker_lines == 8
        bus.start()
        wanted = {300: 1, 12000: 2, 19000: 3}
        for k in range(0, 20000, BLOCK):
            for position, code in wanted.items():
                if k <= position < k + BLOCK:
                    bus.mark(position, code)
            ramp = np.arange(k, k + BLOCK)[:, None] * 4e-3
            bus.write(DriveBlock(k, np.repeat(ramp, 4, axis=1)))
        bus.stop()
        assert [code for _, code in shown(bus)] == [1, 0, 2, 0, 3, 0]
        assert [r.position for r in bus.take_marks()] == list(wanted)
        assert bus.counters.late_blocks == 0
    record = cast(ModeledBus, bus)._records[1]
    for position, code in wanted.items():
        edge = int(np.flatnonzero(record.lines == code)[0])
        assert abs(record.volts[edge, 0] / 4e-3 - position) <= 0.8
    assert abs(edge - 19000) > 5, "the clocks are apart"


@EVERY
def test_a_bus_without_lines_does_nothing(link: str, monkeypatch: pytest.MonkeyPatch) -> None:
    without_lines(monkeypatch, 1)
    heard = overheard(monkeypatch)
    with open_bus(LINKS[link], Panel()) as bus:
        assert bus.marker_lines == 0
        bus.start()
        play(bus, 0, 400, {100: 1})
        bus.stop()
        assert not lines_of(bus).any()
        assert bus.take_marks() == []
    assert m.Mark.TYPE not in {packet.type for packet, _ in heard}


def test_the_facts_of_an_amplifier_have_its_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    without_lines(monkeypatch, 2)
    with open_bus(BOARDS, Panel(channels=4), sample_rate=4000) as bus:
        facts = facts_of(bus)
    assert [one.marker_lines for one in facts] == [8, 0]
    assert [one.as_dict()["marker_lines"] for one in facts] == [8, 0]


# What is not shown


def test_a_driver_is_told_only_while_the_bus_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[int, int]] = []
    with open_bus(LINKS["none"], Panel()) as bus:
        monkeypatch.setattr(bus, "_mark", lambda *mark: told.append(mark))
        bus.mark(100, 1)
        assert told == []
        bus.start()
        bus.mark(100, 1)
        assert told == [(100, 1)]
        bus.estop()
        bus.mark(200, 1)
    bus.mark(200, 1)
    assert told == [(100, 1)]


@EVERY
def test_what_cannot_be_shown_is_ignored(link: str) -> None:
    with open_bus(LINKS[link], Panel()) as bus:
        bus.mark(100, 1)  # before the start
        bus.start()
        at = play(bus, 0, 400)
        for position, code in ((at - 1, 1), (0, 1), (at, 0), (at, 256), (at, -1), (-5, 1)):
            bus.mark(position, code)
        play(bus, at, 400)
        bus.stop()
        bus.mark(bus.next_position, 1)
        assert not lines_of(bus).any()
        assert bus.take_marks() == []
        assert bus.counters.faults() == {}


@EVERY
def test_a_position_that_is_never_written_is_not_marked(link: str) -> None:
    """The gap is bridged, and the last sample is repeated at a stop."""
    with open_bus(LINKS[link], Panel()) as bus:
        bus.start()
        at = play(bus, 0, 400)
        bus.mark(at + 20, 1)
        at = play(bus, at + 40, 400)
        bus.mark(at, 2)
        bus.mark(at + 10, 3)
        bus.stop()
        assert bus.counters.lost_samples == 40
        assert not lines_of(bus).any()
        assert bus.take_marks() == []


@pytest.mark.parametrize("end", ["stop", "abort", "estop"])
@EVERY
def test_what_waits_is_forgotten_when_playing_ends(link: str, end: str) -> None:
    with open_bus(LINKS[link], Panel()) as bus:
        bus.start()
        at = play(bus, 0, 400)
        for k in range(8):
            bus.mark(at + 40 * k, 1)
        getattr(bus, end)()
        bus.clear()
        bus.start(at)
        play(bus, at, 800, {at + 400: 2})
        bus.stop()
        assert [code for _, code in shown(bus)] == [2, 0]
        assert bus.take_marks() == [MarkReport(at + 400, 2)]


def test_what_waits_is_forgotten_when_the_link_breaks() -> None:
    with open_bus(LINKS["serial"], Panel()) as bus:
        bus.start()
        at = play(bus, 0, 400)
        bus.mark(at + 2400, 1)
        cast(ModeledBus, bus).model.unplug(0.02)
        at = play(bus, at, 1600)
        assert bus.counters.disconnects == 1
        assert bus.status.playing
        play(bus, at, 1600, {at + 1200: 2})
        bus.stop()
        assert [code for _, code in shown(bus)] == [2, 0]
        assert [r.code for r in bus.take_marks()] == [2]


def test_nothing_is_sent_after_an_estop(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = overheard(monkeypatch)
    with open_bus(LINKS["serial"], Panel()) as bus:
        bus.start()
        at = play(bus, 0, 400)
        bus.mark(at, 1)
        bus.estop()
        play(bus, at, 400, {at + 80: 1})
    assert m.Mark.TYPE not in {packet.type for packet, _ in heard}


def test_a_later_mark_takes_the_place_of_one_for_the_same_position() -> None:
    with open_bus(LINKS["serial"], Panel()) as bus:
        bus.start()
        bus.mark(100, 1)
        bus.mark(100, 2)
        play(bus, 0, 400)
        bus.stop()
        assert shown(bus) == [(100, 2), (180, 0)]
        assert bus.take_marks() == [MarkReport(100, 2)]


@EVERY
def test_eight_marks_wait_at_most(link: str) -> None:
    with open_bus(LINKS[link], Panel()) as bus:
        bus.start()
        for k in range(10):
            bus.mark(200 * (k + 1), k + 1)
        bus.mark(400, 99)
        play(bus, 0, 2400)
        bus.stop()
        codes = [1, 99, 3, 4, 5, 6, 7, 8]
        assert [r.code for r in bus.take_marks()] == codes
        assert [code for _, code in shown(bus) if code] == codes


# What is reported


@pytest.mark.parametrize("link", ["none", "serial", "can"])
def test_reports_of_no_mark_are_ignored(link: str, monkeypatch: pytest.MonkeyPatch) -> None:
    heard = overheard(monkeypatch)
    with open_bus(LINKS[link], Panel()) as bus:
        bus.start()
        at = play(bus, 0, 400, {200: 1})
        (amplifier,) = amplifiers(bus)
        reports = bus.take_marks()
        amplifier._send(m.Marked(amplifier.position, 1))
        (mark,) = [m.Mark.unpack(p.payload) for p, _ in heard if p.type == m.Mark.TYPE]
        assert mark is not None
        amplifier._send(m.Marked(mark.position, 1))  # once more
        amplifier._send(m.Marked((amplifier.position + 2**31) % 2**32, 1))
        amplifier._sent.append(Packet(m.Marked.TYPE, b"\0\0\0", node=amplifier.node))
        play(bus, at, 400)
        assert reports == [MarkReport(200, 1)]
        assert bus.take_marks() == []
        assert bus.status.detail == ""


def test_a_report_of_an_earlier_start_is_ignored() -> None:
    with open_bus(LINKS["serial"], Panel()) as bus:
        bus.start()
        play(bus, 0, 400, {200: 1})
        bus.stop()
        peer = cast(ModeledBus, bus).peers[0]
        before = m.Marked(peer.wire_end(200), 1)
        stream = cast(ModeledBus, bus)._session.stream
        assert stream is not None
        stream._marks._sent[before.position] = 200  # as if the report had not come yet
        bus.start(0)
        (amplifier,) = amplifiers(bus)
        amplifier._send(before)
        play(bus, 0, 400)
        assert bus.take_marks() == [MarkReport(200, 1)]


def test_a_board_that_shows_no_marks_reports_none() -> None:
    with open_bus(BOARDS, Panel(channels=4), sample_rate=4000) as bus:
        bus.start()
        bus.mark(700, 1)
        at = play(bus, 0, 400)
        peer = cast(ModeledBus, bus).peers[0]
        stream = cast(ModeledBus, bus)._session.stream
        assert stream is not None
        stream._marks._sent[peer.wire_end(700)] = 700
        amplifiers(bus)[1]._send(m.Marked(peer.wire_end(700), 1))
        at = play(bus, at, 200)
        assert bus.take_marks() == []
        play(bus, at, 400)
        assert bus.take_marks() == [MarkReport(700, 1)]


def test_what_is_reported_was_shown_also_if_packets_are_lost() -> None:
    with open_bus(LINKS["serial"] + "&loss=0.05&seed=3", Panel()) as bus:
        bus.start()
        wanted = {400 * k + 100: k % 255 + 1 for k in range(60)}
        play(bus, 0, 24000, wanted)
        bus.stop()
        risen = {position for position, code in shown(bus) if code}
        reports = bus.take_marks()
    assert {(r.position, r.code) for r in reports} <= set(wanted.items())
    assert {r.position for r in reports} <= risen <= set(wanted)
    assert 30 < len(reports) < len(wanted)


def test_only_the_newest_reports_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correlations, "MOST_WINDOWS", 4)
    with open_bus(LINKS["none"], Panel()) as bus:
        bus.start()
        play(bus, 0, 1200, {200 * k: k for k in range(1, 6)})
        assert [r.code for r in bus.take_marks()] == [2, 3, 4, 5]


# Marks of one amplifier


def test_marks_without_a_report_are_forgotten_one_day(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(marks, "MOST_SENT", 3)
    waiting = AmplifierMarks(8000.0)
    for k in range(5):
        waiting.add(k, 1)
        assert len(waiting.take(k, k + 1, 9, lambda position: position + 100)) == 1
    found = [waiting.report(m.Marked(k + 100, 7)) for k in range(5)]
    assert found == [None, None, *(MarkReport(k, 7) for k in (2, 3, 4))]


def test_a_mark_lasts_10_ms_and_one_sample_at_least() -> None:
    for rate, samples in ((8000.0, 80), (2500.0, 25), (44100.0, 441), (1.0, 1)):
        waiting = AmplifierMarks(rate)
        waiting.add(5, 3)
        assert waiting.take(0, 6, 9, lambda position: position) == [m.Mark(9, 5, 3, samples)]


def test_marks_of_passed_positions_are_dropped_and_later_ones_stay() -> None:
    waiting = AmplifierMarks(8000.0)
    for position in (30, 10, 20):
        waiting.add(position, position)
    assert [mark.code for mark in waiting.take(15, 30, 9, lambda position: position)] == [20]
    assert [mark.code for mark in waiting.take(30, 40, 9, lambda position: position)] == [30]
    assert waiting.take(0, 100, 9, lambda position: position) == []
