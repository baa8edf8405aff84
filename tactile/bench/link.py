"""Benchmark of the link to an amplifier: its round trip, and the drift of the amplifier's clock."""

from collections.abc import Iterator

from tactile.bench.figures import Figure
from tactile.bus.link.inspection import amplifiers
from tactile.clock import MONOTONIC, Clock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import InputError

DURATION = 10.0
"""Time during which the link exchanges timestamps before they are evaluated [s]."""


def measure_link(device: str, display: Display, clock: Clock = MONOTONIC) -> Iterator[Figure]:
    """Measure the link of a device at rest, at 0 V and without high voltage.

    Parameters
    ----------
    device : str
        URL of the device.
    display : Display
        Display that the device drives.
    clock : Clock
        Clock that waits for the exchange of timestamps.

    Yields
    ------
    Figure
        For each amplifier the shortest recent round trip of a timestamp [ms], and the drift of its
        clock against the host's [ppm].

    Raises
    ------
    InputError
        If no amplifier behind the device speaks the protocol.
    BusError
        If the device cannot be opened.
    """
    with open_bus(device, display) as bus:
        if not amplifiers(bus):
            raise InputError(f"{device}: has no amplifier that speaks the protocol")
        clock.sleep(DURATION)
        inspected = amplifiers(bus)
    for amplifier in inspected:
        yield Figure(f"link.node_{amplifier.node}.round_trip", 1e3 * amplifier.round_trip, "ms")
        yield Figure(f"link.node_{amplifier.node}.drift", amplifier.drift_ppm, "ppm")
