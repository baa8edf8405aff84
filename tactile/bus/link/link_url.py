"""The options of a URL whose device speaks the protocol, and the bus that they ask for."""

from collections.abc import Callable, Sequence

from firmware_protocol import messages as m
from tactile.bus.base import RATE, DisplayLike, Wiring
from tactile.bus.board import config_of
from tactile.bus.budget import Ability, Plan, plan
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.stream import LEAST_LEAD, LONGEST_LEAD
from tactile.bus.options import flag, number, sample_format
from tactile.bus.registry import Address
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Link

LINK_OPTIONS = ("format", "rearm", "lead_ms")
"""Of every device whose amplifiers speak the protocol."""


def open_link(
    address: Address,
    display: DisplayLike,
    sample_rate: float | None,
    link: Link,
    connect: Callable[[], Wire],
    *,
    nodes: Sequence[int] = (),
) -> LinkBus:
    """Open a bus for an address, which sends what fits its link, or what it asks for."""
    wiring = Wiring.of(display, sample_rate or RATE)
    config_of(wiring, 1, 1)
    choose = planner(address, display, sample_rate, link)
    return LinkBus(
        wiring, connect, choose, nodes=nodes, rearm=flag(address, "rearm"), lead=lead_of(address)
    )


def lead_of(address: Address) -> float | None:
    """Return the lead that is asked for [s], None where it is to be the least that will do."""
    lead = number(address, "lead_ms", 1e3 * LEAST_LEAD, 1e3 * LONGEST_LEAD)
    return None if lead is None else lead * 1e-3


def planner(
    address: Address, display: DisplayLike, sample_rate: float | None, link: Link
) -> Callable[[Sequence[m.Caps]], Plan]:
    """Return what makes the plan of what amplifiers say that they can."""
    wanted = sample_format(address, spectrum=True)

    def choose(caps: Sequence[m.Caps]) -> Plan:
        ability = Ability.of(caps)
        return plan(link, display.channels, ability, sample_rate=sample_rate, sample_format=wanted)

    return choose
