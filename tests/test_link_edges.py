"""Tests of rare moments of the host's side of a link: halts, last messages, back-off."""

import math
import secrets
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from link_rig import LEVEL, RATE, SAMPLE, Bench, Linked, Panel, fade_in, overheard, recover

from firmware_protocol import messages as m
from firmware_protocol.messages import State
from firmware_protocol.packet import Packet
from tactile.bus.base import DriveFrame, Wiring
from tactile.bus.budget import Plan
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.phases import SessionPhase
from tactile.bus.link.session import LinkSession
from tactile.bus.link.stream import LinkBusCounters
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Unlimited
from tactile.devices import open_bus
from tactile.errors import BusError

WATCHDOG = 0.15
"""Time without a heartbeat after which an amplifier ramps to 0 V (SPEC.md, 14) [s]."""


def no_plan(caps: Sequence[m.Caps]) -> Plan:
    raise AssertionError("no amplifier has answered")


class Faulty(Wire):
    """A wire whose driver has a fault of its own."""

    closed = False

    def send(self, packet: Packet) -> float:
        return 0.0

    def send_urgent(self, packet: Packet) -> None:
        """Do as `send` does."""

    def receive(self, until: float) -> list[Packet]:
        raise ZeroDivisionError("a fault of the driver")

    def wake(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        self.closed = True


def test_an_estop_before_any_amplifier_has_answered_is_sent_to_all() -> None:
    session = LinkSession(
        Wiring.of(Panel(), RATE), token=1, choose=no_plan, counters=LinkBusCounters()
    )
    first, second = session.estop(0.0), session.estop(0.0)
    assert first.type == second.type == m.Estop.TYPE
    assert first.node == second.node == 0
    session.connected(0.0)
    session.clear(0.0)
    assert session.phase is SessionPhase.SEARCH
    assert second.seq == (first.seq + 1) % 256, "it counts packets (SPEC.md, 2)"


def test_an_amplifier_that_takes_55_ms_to_answer_a_hello_to_all_is_found_as_well() -> None:
    """Another takes 10 ms; 5 ms after the slow one the session begins with both."""
    session = LinkSession(
        Wiring.of(Panel(), RATE), token=1, choose=no_plan, counters=LinkBusCounters()
    )
    wire, slow, quick = Faulty(Unlimited()), 1, 2
    answers = {10: quick, 55: slow}
    session.connected(0.0)
    for now in range(0, 65, 5):
        if now in answers:
            caps = Packet.of(m.Caps(), node=answers[now], seq=0)
            session.receive([caps], now * 1e-3, 0)
        assert not session.peers
        session.poll(now * 1e-3, wire)
    assert [peer.host.node for peer in session.peers] == [slow, quick]


class Noting(Faulty):
    """A wire that notes what is sent."""

    def __init__(self) -> None:
        super().__init__(Unlimited())
        self.sent: list[Packet] = []

    def send(self, packet: Packet) -> float:
        self.sent.append(packet)
        return 0.0


@pytest.mark.parametrize(("code", "waits"), [(m.NakCode.BUSY, True), (m.NakCode.FAULT, False)])
def test_an_amplifier_that_another_host_holds_is_waited_for_and_no_other_that_refuses(
    code: m.NakCode, waits: bool
) -> None:
    session = LinkSession(
        Wiring.of(Panel(), RATE), token=1, choose=no_plan, counters=LinkBusCounters(), nodes=[1]
    )
    wire = Noting()
    session.connected(0.0)
    session.poll(0.0, wire)
    (hello,) = wire.sent
    session.receive([Packet.of(m.Nak(hello.type, hello.seq, code), node=1, seq=0)], 0.01, 0)
    wire.sent.clear()
    again = []
    for tick in range(200):
        session.poll(1e-3 * tick, wire)
        again += [tick for packet in wire.sent if packet.type == m.Hello.TYPE]
        wire.sent.clear()
    assert (session.trouble == "another host holds the amplifier") is waits
    assert bool(session.refusal) is not waits
    assert again[:1] == ([50] if waits else [])


def test_an_estop_is_sent_though_an_amplifier_has_answered_no_hello() -> None:
    """Another thread may e-stop before that of the link has let go of the wire."""
    session = LinkSession(
        Wiring.of(Panel(), RATE), token=1, choose=no_plan, counters=LinkBusCounters(), nodes=[1]
    )
    wire = Noting()
    session.connected(0.0)
    for tick in range(100):
        session.poll(0.01 * tick, wire)
    assert session.lost(1.0) == "the amplifier does not answer"
    wire.sent.clear()
    wire.send(session.estop(1.0))
    session.poll(1.0, wire)
    assert wire.sent[0].type == m.Estop.TYPE


@pytest.mark.parametrize("session", [1, 0xFFFF])
def test_any_session_that_is_drawn_is_one_of_16_bits_and_not_0(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, session: int
) -> None:
    """The lowest and the highest that can be; 0 only asks (SPEC.md, 4)."""
    monkeypatch.setattr(secrets, "randbelow", lambda count: 0 if session == 1 else count - 1)
    rig = linked("serial")
    assert rig.bus.peers[0].host.session == session
    rig.start()
    rig.play(0.05)
    assert rig.playing


def test_a_request_aside_is_waited_for_until_its_third_try_can_be_answered(
    linked: Linked,
) -> None:
    """Tries go out at 0, 50 and 100 ms; the link takes 80 ms."""
    rig = linked("serial")
    rig.model.back.hold(0.18, rig.clock.now())
    answer = rig.bus.request(m.Get(m.Parameter.PULSE_MS), 1)
    assert answer == m.Value(m.Parameter.PULSE_MS, 10)  # as at power-up (SPEC.md, 4)


def test_an_amplifier_that_never_starts_is_told_after_2_s(
    linked: Linked, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The amplifier finds each START too late; it is tried again, and never refused for good."""
    rig = linked("serial")
    amplifier, begun = rig.model.amplifiers[0], rig.clock.now()
    usual = amplifier.receive

    def late(packet: Packet, now: int) -> None:
        if packet.type == m.Start.TYPE:
            amplifier._send(m.Nak(packet.type, packet.seq, m.NakCode.TIME))
        else:
            usual(packet, now)

    monkeypatch.setattr(amplifier, "receive", late)
    with pytest.raises(BusError, match="start: the amplifier does not start"):
        rig.bus.start()
    assert rig.clock.now() - begun == pytest.approx(2.0, abs=0.05)
    rig.idle(2 * WATCHDOG)
    assert (rig.bus.state, rig.silent) == ("idle", True)
    assert not amplifier.high_voltage
    monkeypatch.undo()
    rig.start()
    rig.play(0.05)
    assert rig.playing


def test_an_estop_forgets_what_waits_and_counts_nothing_as_lost(
    linked: Linked,
) -> None:
    """The samples are fewer than a packet has, and wait for others to fill it."""
    rig = linked("serial")
    rig.start()
    rig.write(3)
    rig.bus.estop()
    rig.bus.clear()
    rig.start()
    assert rig.bus.counters.dropped_samples == 0
    rig.play(0.1)
    assert rig.misplaced(since=rig.zero)[0] < SAMPLE


@pytest.mark.parametrize("end", ["abort", "stop"])
def test_what_waits_when_playing_is_ended_is_not_counted_as_lost(linked: Linked, end: str) -> None:
    rig = linked("serial")
    for count in (3, 1003):
        rig.start()
        rig.write(count)
        getattr(rig.bus, end)()
    assert rig.bus.counters.dropped_samples == 0
    assert rig.bus.counters.faults() == {}


def test_samples_that_come_too_late_are_counted_in_blocks(linked: Linked) -> None:
    """The amplifier counts samples: no fewer blocks than those fill, and no more than there are."""
    rig = linked("serial")
    rig.begin(0.2)
    rig.model.stall(0.03)
    rig.play(0.6)
    late = rig.faults()["late_samples"]
    assert late > 2 * rig.bus.plan.packet_samples
    assert late / rig.bus.plan.packet_samples <= rig.bus.counters.late_blocks <= late


@pytest.mark.parametrize("quick", [True, False])
def test_amplifiers_that_still_play_when_the_link_is_back_are_stopped_first(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, quick: bool
) -> None:
    """The stroke was ended while the link was down; the amplifiers have not noticed yet."""
    heard = overheard(monkeypatch)
    rig = linked("serial", extra="&lead_ms=100&fifo_ms=200")
    rig.begin(0.2)
    rig.model.unplug(0.02)
    lost = rig.clock.now()
    rig.play(0.01)
    assert rig.bus.status.link == "down"
    heard.clear()
    (rig.bus.abort if quick else rig.bus.stop)()
    assert rig.model.amplifiers[0].state == State.RUNNING
    rig.idle(0.3)
    first = {packet.type: rig.model.time_of(0, tick) for packet, tick in reversed(heard)}
    at_rest = lost + rig.silence_after(lost)
    assert first[m.Stop.TYPE] < at_rest <= first[m.Limits.TYPE]
    assert at_rest < lost + 0.06, "before the samples that it had run out"
    assert (rig.bus.status.state, rig.bus.status.link) == ("idle", "up")
    rig.begin(0.1)
    assert rig.misplaced(since=rig.zero)[0] < SAMPLE


@pytest.mark.parametrize("away", np.arange(0.02, 0.26, 0.01).round(3).tolist())
def test_however_long_the_link_was_away_all_play_again_in_place(
    linked: Linked, away: float
) -> None:
    """The amplifier is in the middle of its watchdog's ramp at 0.15 to 0.17 s."""
    rig = linked("serial")
    rig.begin(0.2)
    rig.model.unplug(away)
    recover(rig, 0, np.random.default_rng(1))
    back = rig.clock.now()
    fade_in(rig)
    rig.play(0.1)
    worst, count = rig.misplaced(since=back)
    assert worst < SAMPLE
    assert count > 0.05 * RATE


@pytest.mark.parametrize("block", [7, 16, 500])
def test_every_sample_reaches_the_amplifier_once_in_its_place_or_is_counted_as_dropped(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    """Samples before the position at which the link fades in again count as well."""
    heard = overheard(monkeypatch)
    rig = linked("serial")
    rig.start()
    rig.play(0.2, block=block)
    rig.idle(1e-3)  # nothing is on the wire
    rig.model.unplug(0.2)
    rig.play(0.6, block=block)
    back = rig.clock.now()
    rig.play(0.4, block=block)
    rig.bus.stop()
    pieces = [m.Pcm.unpack(packet.payload) for packet, _ in heard if packet.type == m.Pcm.TYPE]
    delivered = sum(piece.samples for piece in pieces if piece is not None)
    held = math.ceil(0.025 * RATE)  # the last sample, until STOP has come
    assert delivered - held + rig.bus.counters.dropped_samples == rig.position
    assert "late_samples" not in rig.faults()
    worst, count = rig.misplaced(since=back)
    assert worst < SAMPLE
    assert count > 0.2 * RATE


def test_a_wire_that_stays_away_is_tried_less_and_less_often(linked: Linked) -> None:
    """50 ms at first, twice as long each time, and each second in the end."""
    rig = linked("serial")
    tries: list[float] = []
    usual = rig.model.open

    def counted() -> None:
        tries.append(rig.clock.now())
        usual()

    rig.model.open = counted  # type: ignore[method-assign]
    rig.begin(0.1)
    rig.model.unplug(6.0)
    lost = rig.clock.now()
    rig.idle(5.5)
    rig.idle(1.5)
    pauses = [b - a for a, b in pairwise([lost, *tries])]
    assert pauses[:8] == pytest.approx([0.05, 0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0], abs=0.03)


def test_a_renderer_that_is_late_with_its_frames_is_alive_all_the_same() -> None:
    """The renderer has no time to wait, which is when signs of life are otherwise given."""
    bus = open_bus("mock:?link=can&format=spectrum", Panel(), sample_rate=RATE)
    with bus:
        assert isinstance(bus, LinkBus)
        assert bus.frames is not None
        spacing = round(bus.wiring.sample_rate / bus.frames.rate)
        bus.tune(np.array([100.0]))
        bus.start()
        model = bus.model  # type: ignore[attr-defined]
        for k in range(1, round(4 * WATCHDOG * bus.frames.rate)):
            model.run_alone(bus.due((k - 1) * spacing) - bus.ahead + 1e-4)
            bus.write_frame(DriveFrame(k * spacing, np.full((2, 1), LEVEL, np.complex128)))
        (amplifier,) = model.amplifiers
        assert amplifier.state == State.RUNNING
        assert amplifier.counters.watchdogs == 0


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_fault_in_the_links_own_thread_is_told_and_lets_go_of_the_wire() -> None:
    wire = Faulty(Unlimited())
    with pytest.raises(BusError, match="internal error: ZeroDivisionError"):
        LinkBus(Wiring.of(Panel(), RATE), lambda: wire, no_plan)
    assert wire.closed


def test_boards_that_follow_are_handed_their_samples_earlier(linked: Linked) -> None:
    """The difference is eight samples, half of those that interpolation uses."""
    one = Bench("mock:?link=can&format=pcm16", Panel(channels=4))
    two = Bench("mock:?link=can&boards=2&format=pcm16", Panel(channels=4))
    per_packet = [rig.bus.plan.use * rig.bus.plan.packet_samples / RATE for rig in (one, two)]
    leads = [rig.bus.ahead - rig.bus.lead for rig in (one, two)]
    assert leads[0] == pytest.approx(per_packet[0])
    assert leads[1] - per_packet[1] == pytest.approx(8 / RATE)
    for rig in (one, two):
        rig.bus.close()
