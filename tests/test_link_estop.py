"""Tests of e-stops over links: in time, remembered, reported, and ended by a person alone."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from link_rig import LEVEL, MOST, SAMPLE, Bench, Linked, Panel, overheard

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import Fault, State
from firmware_protocol.packet import Packet
from tactile.errors import BusError, BusStateError

EVERY = pytest.mark.parametrize("link", MOST)
TO_ESTOP = 20e-3


SATURATED = {
    "serial": "mock:?link=serial&bit_rate=1000000&format=pcm16",
    "can": "mock:?link=can&format=pcm16",
    "canfd": "mock:?link=canfd&format=pcm16",
    "i2c": "mock:?link=i2c&bit_rate=1000000&format=pcm16",
}
CAPS_OF_USE = {"serial": 0.85, "can": 0.70, "canfd": 0.70, "i2c": 0.80}


def saturated(link: str, rate: float = 8000.0) -> Bench:
    """Return a link with as many channels as it carries."""
    best: Bench | None = None
    for channels in range(1, 40):
        try:
            one = Bench(SATURATED[link], Panel(channels=channels), rate)
        except Exception:
            break
        if best is not None:
            best.bus.close()
        best = one
    assert best is not None
    return best


@EVERY
def test_an_estop_is_at_0_volts_in_20_ms_on_a_full_link_again_and_again(link: str) -> None:
    rig = saturated(link)
    try:
        assert rig.bus.plan.use > 0.85 * CAPS_OF_USE[link]
        for press in range(6):
            rig.start()
            rig.play(0.06 + 0.007 * press)
            rig.write(16 + 5 * press)
            pressed = rig.clock.now()
            assert rig.at(pressed)[1::2].min() >= 0.9 * LEVEL
            rig.bus.estop()
            rig.model.run_alone(pressed + 0.06)
            took = rig.silence_after(pressed)
            assert 0 < took < TO_ESTOP
            assert (rig.bus.status.state, rig.bus.status.detail) == ("estopped", "")
            rig.bus.clear()
            assert (rig.bus.status.state, rig.bus.status.detail) == ("idle", "")
            rig.bus.clear()
    finally:
        rig.bus.close()
    rig.check_limits()


@EVERY
def test_copies_of_what_was_sent_before_an_estop_do_nothing_after_it(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, link: str
) -> None:
    """A link that delivers packets again, and late, neither arms nor stops what comes after."""
    sent = overheard(monkeypatch)
    rig = linked(link)
    rig.begin(0.2)
    (amplifier,) = rig.model.amplifiers
    copies = [packet for packet, _ in sent if packet.type != m.Hello.TYPE]
    assert {m.Arm.TYPE, m.Start.TYPE, m.Pcm.TYPE} <= {packet.type for packet in copies}
    former = amplifier.session
    rig.bus.estop()
    rig.idle(0.1)
    rig.bus.clear()
    assert amplifier.session not in (0, former)
    for packet in copies:
        amplifier.receive(packet, rig.model.tick(0))
        assert (amplifier.state, amplifier.high_voltage) == (State.IDLE, False)
    rig.begin(0.2)
    zero = rig.clock.now()
    for packet in copies:
        amplifier.receive(packet, rig.model.tick(0))
        rig.play(4e-3)
    assert rig.playing
    assert rig.bus.status.playing
    error, compared = rig.misplaced(since=zero)
    assert error <= SAMPLE
    assert compared > 100
    rig.check_limits()


def at_each_hello(monkeypatch: pytest.MonkeyPatch, act: Callable[[], None]) -> None:
    """Let something happen whenever a HELLO reaches an amplifier, before it is acted on."""
    usual = ReferenceAmplifier.receive

    def receive(self: ReferenceAmplifier, packet: Packet, now: int) -> None:
        if packet.type == m.Hello.TYPE:
            act()
        usual(self, packet, now)

    monkeypatch.setattr(ReferenceAmplifier, "receive", receive)


def stopped(rig: Bench) -> Bench:
    """Return a link that has played, and was stopped while its session is held by heartbeats."""
    rig.begin(0.2)
    rig.bus.estop()
    rig.idle(0.05)
    return rig


@EVERY
def test_a_host_that_clears_does_not_take_itself_for_another_one(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, link: str
) -> None:
    """The token of before holds the amplifier for 150 ms."""
    rig, details = stopped(linked(link)), list[str]()
    at_each_hello(monkeypatch, lambda: details.append(rig.bus.status.detail))
    rig.bus.clear()
    assert len(details) > 3
    assert set(details) == {""}


@EVERY
def test_a_clear_ends_with_the_link(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, link: str
) -> None:
    """Nothing is cleared once the link is back, when nobody expects it any more."""
    rig, once = stopped(linked(link)), [0.3]
    (amplifier,) = rig.model.amplifiers
    with monkeypatch.context() as unplugged:
        at_each_hello(unplugged, lambda: rig.model.unplug(once.pop()) if once else None)
        with pytest.raises(BusError, match="the link was lost meanwhile; it stays e-stopped"):
            rig.bus.clear()
    rig.idle(1.0)
    assert (rig.bus.state, amplifier.state) == ("estopped", State.ESTOP)
    rig.bus.clear()
    assert rig.bus.state == "idle"


@EVERY
@pytest.mark.parametrize("greeting", [1, 2])
def test_an_estop_of_another_host_within_a_clear_is_not_cleared(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, link: str, greeting: int
) -> None:
    """The person who clears does not know of it."""
    rig, greetings = stopped(linked(link)), iter(range(1, 100))
    (amplifier,) = rig.model.amplifiers

    def press() -> None:
        if next(greetings) == greeting:
            amplifier.receive(Packet.of(m.Estop(7), node=0, seq=0), rig.model.tick(0))

    with monkeypatch.context() as pressed:
        at_each_hello(pressed, press)
        with pytest.raises(BusError, match="stopped once more in the meantime"):
            rig.bus.clear()
    assert (rig.bus.state, amplifier.state) == ("estopped", State.ESTOP)
    rig.bus.clear()
    assert (rig.bus.state, amplifier.state) == ("idle", State.IDLE)
    rig.begin(0.2)
    assert rig.bus.status.playing


@EVERY
def test_an_estop_within_a_clear_holds_and_the_session_can_be_ended(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, link: str
) -> None:
    """The amplifier has not taken the new token yet, so that DISARM would be refused."""
    rig = stopped(linked(link))
    (amplifier,) = rig.model.amplifiers
    with monkeypatch.context() as pressed:
        at_each_hello(pressed, rig.bus.estop)
        with pytest.raises(BusStateError):
            rig.bus.clear()
    rig.idle(0.5)
    assert (rig.bus.state, amplifier.state) == ("estopped", State.ESTOP)
    rig.bus.close()
    assert rig.bus.counters.disconnects == 0


@pytest.mark.parametrize(
    ("link", "longest"),
    [
        pytest.param("serial", 4e-3 / 10e-6, id="serial"),  # 10 bits for a byte at 1 Mbit/s
        pytest.param("can", 4e-3 / 111e-6, id="can"),  # 111 bits for 8 bytes without stuffing
    ],
)
def test_no_more_than_4_ms_wait_for_a_full_link(link: str, longest: float) -> None:
    """The next message of a host, a heartbeat or an e-stop, comes soon (SPEC.md, 14, duty 3)."""
    rig, waiting = saturated(link), [0]
    listener = rig.model.on_output

    def look(board: int, run: PlayedRun) -> None:
        listener(board, run)
        units = rig.model.out.waiting(rig.clock.now())
        waiting.append(sum(len(unit) for unit in units) if link == "serial" else len(units))

    rig.model.on_output = look
    rig.begin(0.5)
    rig.bus.close()
    assert rig.misplaced()[1] > 1000
    assert longest / 4 < max(waiting) < longest


@pytest.mark.parametrize("link", ["serial", "can", "canfd"])
def test_an_estop_overtakes_what_waits_for_a_link_that_takes_nothing(
    link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The 4 ms that had left before the link stood still come first (SPEC.md, 14, duty 3)."""
    heard = overheard(monkeypatch)
    rig = saturated(link)
    rig.begin(0.1)
    rig.model.stall(0.06)
    ticks = rig.model.configs[0].tick_hz
    goes_on = rig.model.tick(0) + 0.06 * ticks
    rig.play(0.05)
    rig.bus.estop()
    rig.model.run_alone(rig.clock.now() + 0.03)
    rig.bus.close()
    stopped = next(tick for packet, tick in heard if packet.type == m.Estop.TYPE)
    assert 0 <= stopped - goes_on < 4.5e-3 * ticks


@EVERY
def test_an_estop_while_the_link_is_down_is_the_first_thing_said_when_it_is_back(
    linked: Linked, link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = overheard(monkeypatch)
    rig = linked(link)
    rig.begin(0.2)
    rig.model.unplug(0.08)
    rig.play(0.03)
    assert rig.bus.status.link == "down"
    heard.clear()
    rig.bus.estop()
    assert not heard
    rig.idle(0.5)
    assert heard[0][0].type == m.Estop.TYPE
    assert rig.model.amplifiers[0].state == State.ESTOP
    assert (rig.bus.status.state, rig.bus.status.link) == ("estopped", "up")
    rig.idle(1.0)
    assert rig.bus.counters.disconnects == 1
    rig.bus.clear()
    assert rig.bus.status.state == "idle"
    rig.begin(0.2)
    assert rig.misplaced(since=rig.zero)[0] < SAMPLE


@EVERY
@pytest.mark.parametrize(("extra", "running"), [("", True), ("&rearm=true", True), ("", False)])
def test_anothers_estop_holds_until_it_is_cleared_and_is_told(
    linked: Linked, link: str, extra: str, running: bool
) -> None:
    rig = linked(link, extra)
    if running:
        rig.start()
        rig.play(0.2)
    model, amplifier = rig.model, rig.model.amplifiers[0]
    amplifier.receive(Packet.of(m.Estop(7), node=0, seq=0), model.tick(0))
    pressed = rig.clock.now()
    rig.idle(0.4)
    assert rig.silence_after(pressed) < TO_ESTOP
    status = rig.bus.status
    assert (status.state, status.link) == ("estopped", "up")
    assert "e-stopped by another" in status.detail
    with pytest.raises(BusError, match="clear it first"):
        rig.bus.start()
    assert amplifier.state == State.ESTOP
    if running:
        rig.play(0.6)
        handed_over = rig.bus.due(rig.position) - rig.bus.ahead
        assert rig.clock.now() == pytest.approx(handed_over, abs=1e-3), "who writes waits as before"
    asked = rig.clock.now()
    rig.bus.clear()
    assert rig.clock.now() < asked + 0.5
    assert (rig.bus.status.state, rig.bus.status.detail) == ("idle", "")
    rig.begin(0.2)
    assert rig.misplaced(since=rig.zero)[0] < SAMPLE
    assert rig.misplaced(since=rig.zero)[1] > 100


@EVERY
def test_a_clear_that_no_amplifier_answers_leaves_all_stopped(
    linked: Linked, link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = linked(link)
    rig.begin(0.1)
    rig.bus.estop()
    receive = ReferenceAmplifier.receive

    def receive_no_clear(self: ReferenceAmplifier, packet: Packet, now: int) -> None:
        if packet.type != m.ClearFault.TYPE:
            receive(self, packet, now)

    with monkeypatch.context() as deaf:
        deaf.setattr(ReferenceAmplifier, "receive", receive_no_clear)
        with pytest.raises(BusError, match="clear: the link was lost meanwhile; it stays e-stop"):
            rig.bus.clear()
        rig.idle(0.5)
    assert (rig.bus.status.state, rig.bus.status.detail) == ("estopped", "")
    assert rig.model.amplifiers[0].state == State.ESTOP
    rig.bus.clear()
    rig.idle(0.5)
    assert (rig.bus.status.state, rig.bus.status.detail) == ("idle", "")


@EVERY
def test_a_fault_of_the_hardware_is_named_and_not_cleared_while_it_lasts(
    linked: Linked, link: str
) -> None:
    rig = linked(link)
    rig.begin(0.1)
    rig.model.amplifiers[0].fault(Fault.OVERTEMPERATURE, rig.model.tick(0))
    rig.idle(0.05)
    assert rig.bus.status.state == "estopped"
    assert "overtemperature" in rig.bus.status.detail
    for _ in range(2):
        with pytest.raises(BusError, match="FAULT"):
            rig.bus.clear()
        assert rig.bus.status.state == "estopped"
        assert "overtemperature" in rig.bus.status.detail
    rig.model.amplifiers[0].fault(0, rig.model.tick(0))
    rig.bus.clear()
    assert (rig.bus.status.state, rig.bus.status.detail) == ("idle", "")
    rig.model.amplifiers[0].fault(Fault.OVERCURRENT, rig.model.tick(0))
    rig.idle(0.05)
    assert (rig.bus.status.state, rig.bus.status.link) == ("estopped", "up")
    assert "overcurrent" in rig.bus.status.detail


@EVERY
@pytest.mark.parametrize("playing", [True, False])
def test_an_open_estop_input_asks_for_its_release_and_then_for_a_clear(
    linked: Linked, link: str, playing: bool
) -> None:
    """The release alone ends nothing, and a clear that was refused does not act afterwards."""
    rig = linked(link)
    if playing:
        rig.start()
        rig.play(0.2)
    model, amplifier = rig.model, rig.model.amplifiers[0]
    amplifier.estop_input(True, model.tick(0))
    pressed = rig.clock.now()
    rig.idle(0.4)
    assert rig.silence_after(pressed) < TO_ESTOP
    status = rig.bus.status
    assert (status.state, status.link) == ("estopped", "up")
    assert "e-stop input open: release the button, then clear" in status.detail
    for _ in range(2):
        with pytest.raises(BusError, match="release the button, then clear"):
            rig.bus.clear()
        assert rig.bus.status.state == "estopped"
    amplifier.estop_input(False, model.tick(0))
    rig.idle(0.6)
    assert amplifier.state == State.ESTOP
    assert rig.bus.status.detail == "node 1 was e-stopped by its e-stop input"
    rig.bus.clear()
    assert (rig.bus.status.state, rig.bus.status.detail) == ("idle", "")
    rig.begin(0.2)
    assert rig.misplaced(since=rig.zero)[1] > 100


@EVERY
def test_an_input_that_is_open_under_an_estop_of_this_host_is_told(
    linked: Linked, link: str
) -> None:
    rig = linked(link)
    rig.begin(0.1)
    rig.model.amplifiers[0].estop_input(True, rig.model.tick(0))
    rig.bus.estop()
    rig.idle(0.4)
    assert rig.bus.status.detail == "node 1: e-stop input open: release the button, then clear"
    rig.model.amplifiers[0].estop_input(False, rig.model.tick(0))
    rig.idle(0.6)
    assert (rig.bus.status.state, rig.bus.status.detail) == ("estopped", "")


def test_an_amplifier_of_version_1_0_is_played_on_with_a_warning(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The amplifier has other messages, and no e-stop input although it exceeds 60 V."""
    with caplog.at_level("WARNING", "tactile.bus"):
        linked("serial")
        assert caplog.messages == []
        pack = m.Caps.pack
        monkeypatch.setattr(
            m.Caps, "pack", lambda c: pack(replace(c, minor=0, schema=1, features=0))
        )
        rig = linked("serial")
    assert caplog.messages == [
        "node 1 can put out 100 V and has no e-stop input (SPEC.md, 6.3)",
        "node 1 has the messages of version 1.0 (schema 0x00000001), this host those of "
        f"1.{m.MINOR} (0x{m.SCHEMA_CRC:08X}); a field that either lacks reads as 0",
    ]
    rig.begin(0.2)
    assert rig.bus.status.state == "running"


@EVERY
def test_close_disarms_in_an_estop_as_well(linked: Linked, link: str) -> None:
    rig = linked(link)
    rig.begin(0.1)
    rig.bus.estop()
    before = rig.clock.now()
    rig.bus.close()
    assert rig.clock.now() < before + 0.2
    rig.model.run_alone(before + TO_ESTOP)
    assert rig.silent
    assert rig.model.amplifiers[0].state == State.ESTOP
    assert not rig.model.amplifiers[0].high_voltage
