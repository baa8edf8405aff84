"""What a link says of its amplifiers: the cause in one line, also after it has passed.

In virtual time; the faults are those of the model of the link, or of the amplifiers themselves.
"""

from collections.abc import Callable

import numpy as np
import pytest
from link_rig import MOST, Bench, Linked

from firmware_protocol import messages as m
from firmware_protocol.messages import Fault, State
from firmware_protocol.packet import Packet
from tactile.errors import BusStateError

EVERY = pytest.mark.parametrize("link", MOST)
WATCHDOG = "node 1 went to 0 V: no heartbeat reached it for 150 ms"


def ask(rig: Bench, message: m.Message) -> None:
    """Let another host send a message to the first amplifier."""
    rig.model.amplifiers[0].receive(Packet.of(message, node=1, seq=0), rig.model.tick(0))


def overheat(rig: Bench) -> None:
    rig.model.amplifiers[0].fault(Fault.OVERTEMPERATURE, rig.model.tick(0))


CAUSES: dict[str, tuple[Callable[[Bench], None], str]] = {
    "a fault": (overheat, "node 1 reports a fault: overtemperature"),
    "the e-stop of another": (lambda rig: ask(rig, m.Estop(7)), "node 1 was e-stopped by another"),
    "the e-stop input": (
        lambda rig: rig.model.amplifiers[0].estop_input(True, rig.model.tick(0)),
        "node 1 was e-stopped by its e-stop input",
    ),
    "the watchdog": (lambda rig: rig.model.run_alone(rig.clock.now() + 0.4), WATCHDOG),
    "a reset": (lambda rig: rig.model.power_cycle(), "node 1 was reset: "),
    "a cable": (lambda rig: rig.model.unplug(0.5), "the device is gone"),
}


# The latest fault


@EVERY
@pytest.mark.parametrize("what", CAUSES)
def test_the_latest_fault_while_playing_is_named_until_there_is_another(
    linked: Linked, link: str, what: str
) -> None:
    cause, line = CAUSES[what]
    rig = linked(link, "")
    rig.begin(0.2)
    assert rig.bus.status.last_fault == ""
    cause(rig)
    rig.play(0.6)
    assert rig.bus.counters.dropped_samples > 0
    assert line in rig.bus.status.last_fault
    assert "\n" not in rig.bus.status.last_fault
    rig.bus.stop()
    rig.idle(1.0)  # a cable is back by then
    assert line in rig.bus.status.last_fault


def test_a_fault_that_has_passed_is_still_the_latest_one(linked: Linked) -> None:
    rig = linked("serial", "&rearm=true")
    rig.begin(0.2)
    rig.model.run_alone(rig.clock.now() + 0.4)
    rig.play(0.6)
    assert (rig.bus.status.playing, rig.bus.status.detail) == (True, "")
    assert rig.bus.status.last_fault == WATCHDOG


def test_a_link_that_is_lost_while_nothing_plays_keeps_no_sample_from_being_put_out(
    linked: Linked,
) -> None:
    rig = linked("serial", "")
    rig.model.unplug(0.2)
    rig.idle(1.0)
    assert rig.bus.counters.disconnects == 1
    rig.begin(0.2)
    assert rig.bus.status.last_fault == ""


def test_an_estop_of_this_host_is_no_fault(linked: Linked) -> None:
    rig = linked("serial", "")
    rig.begin(0.2)
    rig.bus.estop()
    rig.play(0.2)
    assert rig.bus.counters.dropped_samples > 0
    assert rig.bus.status.last_fault == ""


# The cause that is named


@pytest.mark.parametrize("held", np.arange(0.1, 0.2, 0.004).round(3).tolist())
def test_the_watchdog_is_named_in_its_ramp_as_well(linked: Linked, held: float) -> None:
    """The ramp takes 20 ms from 150 ms after the latest heartbeat, 0 … 50 ms before, on."""
    rig = linked("serial", "")
    rig.begin(0.2)
    rig.model.run_alone(rig.clock.now() + held)
    rig.play(0.4)
    fell = rig.model.amplifiers[0].counters.watchdogs
    assert rig.bus.status.last_fault == (WATCHDOG if fell else "")
    assert (rig.bus.state == "idle") is bool(fell)


def test_a_stop_that_is_late_is_named(linked: Linked) -> None:
    """UDP may deliver the STOP of an earlier stroke after the START of the next one."""
    rig = linked("serial", "")
    rig.begin(0.2)
    ask(rig, m.Stop(rig.bus.peers[0].host.session))
    rig.model.run_alone(rig.clock.now() + 0.03)
    assert rig.model.amplifiers[0].state == State.ARMED
    rig.play(0.1)
    assert rig.bus.status.last_fault == "node 1 stopped: a STOP of this session reached it late"


def test_a_start_after_a_fault_names_it_and_what_to_do(linked: Linked) -> None:
    rig = linked("serial", "")
    rig.begin(0.2)
    overheat(rig)
    rig.idle(0.1)
    line = r"start: the bus is estopped \(node 1 reports a fault: overtemperature\), not idle; "
    with pytest.raises(BusStateError, match=line + "clear it first"):
        rig.bus.start()
    rig.model.amplifiers[0].fault(0, rig.model.tick(0))
    rig.bus.clear()
    rig.bus.estop()
    with pytest.raises(BusStateError, match="start: the bus is estopped, not idle; clear it first"):
        rig.bus.start()
