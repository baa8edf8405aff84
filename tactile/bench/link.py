"""The link to an amplifier: its round trip, and the drift of the amplifier's clock."""

from collections.abc import Iterator

from tactile.bench.figures import Figure
from tactile.bus.link.inspection import amplifiers
from tactile.clock import MONOTONIC, Clock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import InputError

DURATION = 10.0
"""Time in which the link exchanges time stamps before they are read [s]."""


def measure_link(device: str, display: Display, clock: Clock = MONOTONIC) -> Iterator[Figure]:
    """Measure the link of a device at rest, at 0 V and without high voltage.

    Parameters
    ----------
    device : URL of the device
    display : display that the device drives
    clock : clock by which to wait

    Yields
    ------
    Figure
        For each amplifier the shortest recent round trip of a time stamp [ms], and the drift of its
        clock against the host's [ppm].

    Raises
    ------
    InputError
        If no amplifier behind the device speaks the protocol.
    BusError
        If the device cannot be opened.
    """
    with open_bus(device, display) as bus:
        clock.sleep(DURATION)
        known = amplifiers(bus)
    if not known:
        raise InputError(f"{device}: no amplifier there speaks the protocol, so none answers")
    for one in known:
        yield Figure(f"link.node_{one.node}.round_trip", 1e3 * one.round_trip, "ms")
        yield Figure(f"link.node_{one.node}.drift", one.drift_ppm, "ppm")
