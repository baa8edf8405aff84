"""The state of a bus on a link is what its amplifiers do, not what the host believes they do.

In virtual time; what the amplifiers did is read from their models. High voltage is off by the
amplifier's own rule where it heard no heartbeat for 150 ms, was reset, or is in FAULT or ESTOP.
"""

from collections.abc import Callable

import pytest
from link_rig import MOST, SAMPLE, Bench, Linked, Panel, overheard

from firmware_protocol import messages as m
from firmware_protocol.messages import Fault, NakCode, State
from firmware_protocol.packet import Packet
from tactile.errors import BusStateError

EVERY = pytest.mark.parametrize("link", MOST)
PLAIN, REARM = "", "&rearm=true"
STEP = 5e-3
"""Interval between looks at the state [s]."""
TOLD = 0.1
"""Time within which the state that is told is true [s]."""
HELD_UP = 0.4
"""Time for which a host does nothing [s]."""


def playing(rig: Bench) -> Bench:
    """Return a link that has played for a while, and is known to."""
    rig.begin(0.2)
    assert (rig.bus.state, rig.bus.status.playing) == ("running", True)
    return rig


def hold_up(rig: Bench) -> None:
    """Let the host do nothing for longer than the watchdog waits."""
    rig.model.run_alone(rig.clock.now() + HELD_UP)
    rig.position += round(HELD_UP * rig.rate)


def until(rig: Bench, reached: Callable[[], bool], within: float = 2.0) -> float:
    """Write until something is so; return how long that took [s]."""
    begun = rig.clock.now()
    while not reached():
        assert rig.clock.now() < begun + within, rig.bus.status
        rig.play(STEP)
    return rig.clock.now() - begun


def assert_over(rig: Bench) -> None:
    """See that it is idle at 0 V, that who writes does not know, and that a start plays again."""
    assert rig.bus.state == rig.bus.status.state == "idle"
    assert not rig.bus.status.playing
    assert "start again, or rearm=true" in rig.bus.status.detail
    before = rig.bus.counters.dropped_samples
    rig.play(0.2)
    assert rig.bus.counters.dropped_samples == before + round(0.2 * rig.rate)
    assert rig.silent
    assert not any(amplifier.high_voltage for amplifier in rig.model.amplifiers)
    assert rig.bus.state == "idle"
    rig.bus.stop()
    with pytest.raises(BusStateError, match="write: the bus is idle"):
        rig.write(16)
    rig.begin(0.2)
    assert (rig.bus.status.state, rig.bus.status.detail) == ("running", "")
    assert rig.bus.status.playing
    assert rig.misplaced(since=rig.zero)[1] > 100
    assert rig.misplaced(since=rig.zero)[0] < SAMPLE


@EVERY
def test_after_the_watchdog_the_bus_is_idle(linked: Linked, link: str) -> None:
    rig = playing(linked(link, PLAIN))
    hold_up(rig)
    assert rig.model.amplifiers[0].state == State.SAFE
    assert until(rig, lambda: rig.bus.state != "running") <= TOLD
    assert_over(rig)


@EVERY
def test_with_rearm_the_status_tells_when_it_plays_again(linked: Linked, link: str) -> None:
    rig = playing(linked(link, REARM))
    hold_up(rig)
    assert (rig.bus.status.state, rig.bus.status.playing) == ("running", False)
    until(rig, lambda: rig.bus.status.playing)
    assert rig.playing
    assert rig.bus.state == "running"


@EVERY
def test_over_a_link_that_is_lost_the_bus_is_idle(linked: Linked, link: str) -> None:
    rig = playing(linked(link, PLAIN))
    rig.model.unplug(1.0)
    until(rig, lambda: rig.bus.status.link == "down")
    assert rig.bus.status.detail
    assert not rig.bus.status.playing
    assert until(rig, lambda: rig.bus.state != "running") <= TOLD
    until(rig, lambda: "is back" in rig.bus.status.detail)
    assert "not armed again" in rig.bus.status.detail
    assert rig.bus.status.link == "up"
    assert (rig.bus.counters.disconnects, rig.bus.counters.reconnects) == (1, 1)
    assert_over(rig)


@EVERY
def test_over_a_link_that_is_lost_it_does_not_play_with_rearm_until_it_is_back(
    linked: Linked, link: str
) -> None:
    rig = playing(linked(link, REARM))
    rig.model.unplug(1.0)
    rig.play(0.5)
    assert (rig.bus.state, rig.bus.status.playing) == ("running", False)
    until(rig, lambda: rig.bus.status.playing)
    assert rig.playing


def test_a_link_that_goes_silent_does_not_play_and_is_lost(linked: Linked) -> None:
    """Nothing comes back, though the device is there and takes what is sent."""
    rig = playing(linked("serial", PLAIN))
    rig.model.back.hold(10.0, rig.clock.now())
    assert until(rig, lambda: not rig.bus.status.playing) <= TOLD + STEP
    rest = until(rig, lambda: rig.bus.state != "running")
    assert rest <= 0.25 - TOLD + 2 * STEP, "25 PULSEs at 10 ms did not come"
    assert rig.bus.status.detail
    rig.model.run_alone(rig.clock.now() + HELD_UP)
    assert rig.silent


@EVERY
def test_after_a_reset_of_the_amplifier_the_bus_is_idle(linked: Linked, link: str) -> None:
    rig = playing(linked(link, PLAIN))
    rig.model.power_cycle()
    assert until(rig, lambda: not rig.bus.status.playing) <= TOLD
    assert until(rig, lambda: rig.bus.state != "running") <= TOLD
    until(rig, lambda: "is back" in rig.bus.status.detail)
    assert_over(rig)


@EVERY
@pytest.mark.parametrize("extra", [PLAIN, REARM])
def test_anothers_estop_or_a_fault_is_one_of_the_bus_while_one_writes(
    linked: Linked, link: str, extra: str
) -> None:
    boards = 1 if link == "serial" else 2
    for what in ("estop", "fault"):
        rig = playing(linked(link, f"{extra}&boards={boards}", panel=Panel(channels=2 * boards)))
        model, amplifier = rig.model, rig.model.amplifiers[-1]
        if what == "estop":
            amplifier.receive(Packet.of(m.Estop(7), node=0, seq=0), model.tick(boards - 1))
        else:
            amplifier.fault(Fault.OVERCURRENT, model.tick(boards - 1))
        states: list[str] = []

        def tripped(rig: Bench = rig, states: list[str] = states) -> bool:
            states.append(rig.bus.state)
            return states[-1] == "estopped"

        assert until(rig, tripped) <= TOLD
        assert set(states) == {"running", "estopped"}
        rig.play(0.3)
        assert not rig.bus.status.playing
        told = "e-stopped by another" if what == "estop" else "overcurrent"
        assert told in rig.bus.status.detail
        assert rig.silent
        amplifier.fault(0, model.tick(boards - 1))
        rig.bus.clear()
        rig.bus.stop()
        rig.start()
        rig.play(0.1)
        assert rig.bus.status.playing


def test_an_arming_that_is_refused_ends_the_wish_to_play(
    linked: Linked, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = playing(linked("serial", REARM))
    amplifier = rig.model.amplifiers[0]
    usual = amplifier.receive

    def refuse(packet: Packet, now: int) -> None:
        if packet.type == m.Arm.TYPE:
            amplifier._send(m.Nak(packet.type, packet.seq, NakCode.STATE))
        else:
            usual(packet, now)

    monkeypatch.setattr(amplifier, "receive", refuse)
    hold_up(rig)
    until(rig, lambda: rig.bus.state == "idle")
    rig.play(0.1)
    assert rig.silent


# An amplifier that lost its power while it was e-stopped


@EVERY
@pytest.mark.parametrize("pressed", ["here", "there"])
@pytest.mark.parametrize("away", [0.0, 0.3])
def test_an_estop_is_cleared_also_where_the_amplifier_has_forgotten_it(
    linked: Linked, link: str, pressed: str, away: float
) -> None:
    rig = playing(linked(link, PLAIN))
    if pressed == "here":
        rig.bus.estop()
    else:
        rig.model.amplifiers[0].receive(Packet.of(m.Estop(7), node=0, seq=0), rig.model.tick(0))
    rig.idle(0.2)
    assert rig.bus.state == "estopped"
    rig.model.power_cycle()
    if away:
        rig.model.unplug(away)
    rig.idle(1.0)
    assert rig.bus.state == "estopped"
    expected = State.ESTOP if pressed == "here" else State.IDLE
    assert rig.model.amplifiers[0].state == expected
    rig.bus.clear()
    assert (rig.bus.status.state, rig.bus.status.link) == ("idle", "up")
    rig.bus.stop()
    rig.begin(0.2)
    assert rig.bus.status.playing
    assert rig.misplaced(since=rig.zero)[1] > 100


@EVERY
def test_an_estop_at_once_after_a_reset_is_cleared_as_well(linked: Linked, link: str) -> None:
    """The host does not know yet that its session is gone."""
    rig = playing(linked(link, PLAIN))
    rig.model.power_cycle()
    rig.bus.estop()
    rig.idle(0.5)
    rig.bus.clear()
    assert rig.bus.state == "idle"


# E-stops beside other calls of the session


@EVERY
@pytest.mark.parametrize("call", ["start", "stop", "clear"])
def test_an_estop_in_the_middle_of_a_call_holds_on_the_amplifier(
    linked: Linked, link: str, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = linked(link, PLAIN)
    if call == "stop":
        playing(rig)
    if call == "clear":
        rig.bus.estop()
    heard, wait = overheard(monkeypatch), rig.bus._wait

    def wait_late(*arguments: object) -> bool:
        monkeypatch.setattr(rig.bus, "_wait", wait)
        rig.idle(5e-3)
        rig.bus.estop()
        return wait(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(rig.bus, "_wait", wait_late)
    begun = rig.clock.now()
    if call == "stop":
        rig.bus.stop()
    else:
        with pytest.raises(BusStateError, match=f"{call}: the bus was e-stopped meanwhile"):
            getattr(rig.bus, call)()
    assert rig.clock.now() < begun + TOLD, "it waits for what cannot come"
    rig.idle(0.3)
    assert rig.bus.state == "estopped"
    assert rig.model.amplifiers[0].state == State.ESTOP
    assert m.Estop.TYPE in [packet.type for packet, _ in heard]
    rig.bus.clear()
    rig.bus.stop()
    rig.begin(0.1)
    assert rig.bus.status.playing


def test_an_estop_without_a_link_is_not_forgotten_for_a_stop_after_it(
    linked: Linked,
) -> None:
    rig = playing(linked("serial", REARM))
    rig.model.unplug(0.3)
    rig.play(2 * TOLD)
    stop = rig.bus._stop

    def stop_late() -> None:
        rig.bus.estop()
        stop()

    rig.bus._stop = stop_late  # type: ignore[method-assign]
    rig.bus.stop()
    rig.idle(1.0)
    assert rig.model.amplifiers[0].state == State.ESTOP
    assert rig.bus.state == "estopped"
