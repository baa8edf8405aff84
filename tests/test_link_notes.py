"""Lines of the log that come from a link: LOG messages, and amplifiers that nobody asked for."""

import logging
from itertools import pairwise

import pytest
from link_rig import Bench, Linked

from firmware_protocol import messages as m
from firmware_protocol.messages import Fault
from firmware_protocol.packet import Packet
from tactile.bus.link.inspection import amplifiers, identify
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.notes import LEVELS, LinkNotes
from tactile.bus.options import FORMATS
from tactile.errors import InputError

LOGGER = "tactile.bus"


def told(caplog: pytest.LogCaptureFixture) -> list[tuple[int, str]]:
    return [(r.levelno, r.getMessage()) for r in caplog.records if r.name == LOGGER]


def say(rig: Bench, level: int, text: bytes) -> None:
    """Let the first amplifier send a LOG."""
    rig.model.amplifiers[0]._send(m.Log(level, text))


# LOG


@pytest.mark.parametrize(("level", "expected"), [*enumerate(LEVELS), (4, 40), (255, 40)])
def test_a_log_of_an_amplifier_is_logged_at_its_level_by_its_node(
    linked: Linked, caplog: pytest.LogCaptureFixture, level: int, expected: int
) -> None:
    rig = linked("can")
    with caplog.at_level(logging.DEBUG, LOGGER):
        say(rig, level, "supply 104 V, ±2 V".encode())
        rig.idle(0.1)
    assert told(caplog) == [(expected, "node 1 says: supply 104 V, ±2 V")]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (b"", "node 1 says: "),
        (b"two\nlines\r\n", "node 1 says: two lines"),
        (b"\x1b[2J\x07cleared", "node 1 says: [2J cleared"),
        (b"bad \xff\xc3 text", "node 1 says: bad �� text"),
        ("\u2028\u202etxt".encode(), "node 1 says: txt"),
        (b"%s %d {0}", "node 1 says: %s %d {0}"),
    ],
)
def test_whatever_an_amplifier_says_is_one_line_that_can_be_printed(
    linked: Linked, caplog: pytest.LogCaptureFixture, text: bytes, line: str
) -> None:
    rig = linked("serial")
    say(rig, m.LogLevel.ERROR, text)
    rig.idle(0.1)
    assert told(caplog) == [(logging.ERROR, line)]


def test_a_fault_of_the_hardware_is_logged_as_the_amplifier_words_it(
    linked: Linked, caplog: pytest.LogCaptureFixture
) -> None:
    rig = linked("serial", "")
    rig.begin(0.2)
    rig.model.amplifiers[0].fault(Fault.OVERTEMPERATURE, rig.model.tick(0))
    rig.play(0.1)
    assert (logging.ERROR, "node 1 says: fault 2") in told(caplog)


def test_of_a_flood_ten_lines_a_second_are_logged_and_the_others_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    notes, times = LinkNotes(), []
    for k in range(5000):
        notes.add(logging.WARNING, f"line {k}", 1e-3 * k)
        before = len(caplog.records)
        notes.write()
        times += [1e-3 * k] * (len(caplog.records) - before)
    lines = [line for _, line in told(caplog)]
    assert len(lines) == 50
    assert all(b - a >= 1.0 - 1e-9 for a, b in zip(times, times[10:], strict=False))
    kept = [int(line.split()[1]) for line in lines]
    for (before, after), line in zip(pairwise(kept), lines[1:], strict=True):
        left_out = after - before - 1
        suffix = f" (after {left_out} lines that are left out)" if left_out else ""
        assert line == f"line {after}{suffix}"


def test_a_flood_over_a_link_does_not_keep_it_from_playing(
    linked: Linked, caplog: pytest.LogCaptureFixture
) -> None:
    rig = linked("serial", "")
    rig.start()
    for _ in range(100):
        for _ in range(5):
            say(rig, m.LogLevel.WARNING, b"x" * 200)
        rig.play(0.01)
    assert 10 <= len(told(caplog)) <= 20
    assert rig.bus.counters.faults() == {}


def test_lines_below_the_level_of_the_log_take_no_place(
    caplog: pytest.LogCaptureFixture,
) -> None:
    notes = LinkNotes()
    with caplog.at_level(logging.WARNING, LOGGER):
        for _ in range(20):
            notes.add(logging.INFO, "detail", 0.0)
        notes.add(logging.WARNING, "what matters", 0.0)
        notes.write()
    assert told(caplog) == [(logging.WARNING, "what matters")]


# Amplifiers that are not of the bus


@pytest.mark.parametrize("message", [m.Pulse(), m.Status()])
def test_a_report_of_another_node_is_one_line_however_often_it_comes(
    linked: Linked, caplog: pytest.LogCaptureFixture, message: m.Message
) -> None:
    rig = linked("can", "&boards=2")
    for node in (9, 9, 200, 9):
        packet = Packet.of(message, node=node, seq=0)
        rig.bus._session.receive([packet], rig.clock.now(), 0)
        rig.idle(0.01)
    line = "node {} reports as well, and is no amplifier of this bus, which has 1, 2"
    assert told(caplog) == [(logging.WARNING, line.format(node)) for node in (9, 200)]
    rig.begin(0.1)


def test_a_credit_that_cannot_be_is_told_once(
    linked: Linked, caplog: pytest.LogCaptureFixture
) -> None:
    rig = linked("serial", "")
    rig.begin(0.4)
    now, running = rig.clock.now(), m.State.RUNNING
    for offset in (10_000, 20_000):
        pulse = m.Pulse(rig.bus.peers[0].wire_end(rig.position + offset), running)
        rig.bus._session.receive([Packet.of(pulse, node=1, seq=0)], now, 0)
        rig.play(0.1)
    assert rig.bus.counters.credit_faults == 2
    assert told(caplog) == [
        (
            logging.WARNING,
            "node 1: the credit_position of its PULSE is more than fifo_samples (1025) from that "
            "by its clock (SPEC.md, 8.1); correct its firmware",
        )
    ]


def test_a_node_that_no_amplifier_has_is_named_with_those_that_are(linked: Linked) -> None:
    bus: LinkBus = linked("can", "&boards=2").bus
    for call in (lambda: identify(bus, 3, 1), lambda: bus.request(m.Get(1), 3)):
        with pytest.raises(InputError, match=r"^node 3: the amplifiers of this bus have 1, 2$"):
            call()
    assert identify(bus, 2, 1)


def test_formats_are_called_as_the_option_of_a_url(linked: Linked) -> None:
    (facts,) = amplifiers(linked("serial").bus)
    assert facts.formats == ("pcm16", "pcm12", "bfp8", "spectrum") == tuple(FORMATS)
