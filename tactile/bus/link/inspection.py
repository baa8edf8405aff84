"""Inspection of the amplifiers on a bus: their capabilities, their identity, their measurements.

Only amplifiers that speak the protocol can be inspected. For other buses every result is empty or
False. Functions that make a request wait for its answer, `ANSWERING` of `link_bus` at most, and
may be called while the bus plays; call them from one thread at a time.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.messages import FULL_SCALE_CODE, Feature, Parameter
from firmware_protocol.player import distance
from tactile.arrays import Floats
from tactile.bus.base import Bus
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.peer import Peer
from tactile.bus.options import FORMATS

TRIES = 5
"""Maximum number of requests to begin or to end measuring; a busy computer may miss the answers to
all repetitions of one request."""


@dataclass(frozen=True)
class AmplifierFacts:
    """Capabilities of one amplifier by its CAPS, and the state of its clock.

    Attributes
    ----------
    node : int
        Address on the link.
    name : str
        Name that its maker gave it.
    firmware : int
        Version of the firmware, by the numbering of its maker.
    first_channel, channels : int
        First of its drive lines, and their number.
    formats : tuple of str
        Names of the sample formats that it takes, as in a URL.
    carriers : int
        Maximum number of carriers of a spectrum frame.
    rates : tuple of int
        Lowest and highest sample rate [Hz].
    full_scale, voltage_limit : float
        Output at the largest sample code, and the limit of its hardware [V].
    slew_limit : float
        Limit of the rate of change [V/s].
    fade_limit : float
        Limit of the length of a fade [s].
    buffer : int
        Number of samples that it can keep.
    measures : bool
        Whether it measures voltage and current of its channels.
    marker_lines : int
        Number of its marker lines.
    holds : bool
        Whether it holds each sample until the next one (zero-order hold) and does not interpolate.
    drift_ppm : float
        Drift of its clock against that of the host, positive if it is faster [ppm].
    round_trip : float
        Shortest time of a recent exchange of timestamps with it [s]; infinite before the first
        exchange.
    """

    node: int
    name: str
    firmware: int
    first_channel: int
    channels: int
    formats: tuple[str, ...]
    carriers: int
    rates: tuple[int, int]
    full_scale: float
    voltage_limit: float
    slew_limit: float
    fade_limit: float
    buffer: int
    measures: bool
    marker_lines: int
    holds: bool
    drift_ppm: float
    round_trip: float

    def has(self, channel: int) -> bool:
        """Return whether a drive line belongs to this amplifier.

        Parameters
        ----------
        channel : int
            Channel of the display.

        Returns
        -------
        bool
            Whether it does.
        """
        return 0 <= channel - self.first_channel < self.channels

    def as_dict(self) -> dict[str, Any]:
        """Return the facts as plain data, such as for JSON.

        Returns
        -------
        dict of str to object
            Values by names that carry their units; without `round_trip`.
        """
        return {
            "node": self.node,
            "name": self.name,
            "firmware": self.firmware,
            "first_channel": self.first_channel,
            "channels": self.channels,
            "formats": list(self.formats),
            "carriers": self.carriers,
            "rates_hz": list(self.rates),
            "full_scale_v": self.full_scale,
            "voltage_limit_v": self.voltage_limit,
            "slew_limit_v_per_us": self.slew_limit * 1e-6,
            "fade_limit_ms": self.fade_limit * 1e3,
            "buffer_samples": self.buffer,
            "measures": self.measures,
            "marker_lines": self.marker_lines,
            "holds": self.holds,
            "drift_ppm": self.drift_ppm,
        }


@dataclass(frozen=True)
class Readings:
    """Measurements of an amplifier at one instant.

    Attributes
    ----------
    position : int
        Position that was put out, on the scale of the blocks since the latest start.
    first_channel : int
        Channel of the display to which the first values belong.
    volts : (C,) array of float
        Voltages [V].
    current : (C,) array of float
        Currents [A].
    """

    position: int
    first_channel: int
    volts: Floats
    current: Floats


def amplifiers(bus: Bus) -> tuple[AmplifierFacts, ...]:
    """Return the amplifiers on a bus.

    Parameters
    ----------
    bus : Bus
        Open bus.

    Returns
    -------
    tuple of AmplifierFacts
        Amplifiers in the order of channels; empty if the bus does not carry the protocol.
    """
    if not isinstance(bus, LinkBus):
        return ()
    facts, first = [], 0
    for peer in bus.peers:
        facts.append(_facts(peer, first))
        first += peer.caps.channels
    return tuple(facts)


def _facts(peer: Peer, first: int) -> AmplifierFacts:
    """Return the facts of an amplifier whose first channel is given."""
    caps = peer.caps
    return AmplifierFacts(
        node=peer.host.node,
        name=caps.name.rstrip(b"\0").decode("utf-8", "replace"),
        firmware=caps.firmware,
        first_channel=first,
        channels=caps.channels,
        formats=tuple(name for name, bit in FORMATS.items() if caps.formats >> bit & 1),
        carriers=caps.carriers,
        rates=(caps.rate_min_hz, caps.rate_max_hz),
        full_scale=caps.full_scale_uv * 1e-6,
        voltage_limit=caps.voltage_limit_uv * 1e-6,
        slew_limit=float(caps.slew_limit_v_per_s),
        fade_limit=caps.fade_limit_us * 1e-6,
        buffer=caps.fifo_samples,
        measures=bool(caps.features & Feature.SENSES),
        marker_lines=caps.marker_lines,
        holds=bool(caps.features & Feature.ZERO_ORDER_HOLD),
        drift_ppm=0.0 if peer.clock is None else peer.clock.drift_ppm,
        round_trip=0.0 if peer.clock is None else peer.clock.round_trip,
    )


def identify(bus: Bus, node: int, seconds: int) -> bool:
    """Make an amplifier blink, or show otherwise which board it is.

    Parameters
    ----------
    bus : Bus
        Open bus.
    node : int
        Address of one of its amplifiers.
    seconds : int
        Time for which to blink, 0 … 255 [s].

    Returns
    -------
    bool
        Whether the amplifier acknowledged.

    Raises
    ------
    InputError
        If no amplifier has that node.
    """
    return isinstance(bus, LinkBus) and isinstance(bus.request(m.Identify(seconds), node), m.Ack)


@contextmanager
def measuring(bus: Bus, interval: float) -> Iterator[set[int]]:
    """Make the amplifiers measure while the context lasts.

    At its end the bus is stopped, or aborted after an exception, before the amplifiers are told to
    measure no more.

    Parameters
    ----------
    bus : Bus
        Open bus.
    interval : float
        Interval between measurements, 10 ms … 1 s [s].

    Yields
    ------
    set of int
        Nodes of the amplifiers that acknowledged to measure.
    """
    nodes = [facts.node for facts in amplifiers(bus) if facts.measures]
    try:
        yield {node for node in nodes if _measure(bus, node, round(interval * 1e3))}
    except BaseException:
        bus.abort()
        raise
    finally:
        bus.stop()
        for node in nodes:
            _measure(bus, node, 0)


def _measure(bus: Bus, node: int, milliseconds: int) -> bool:
    """Set the interval of measurements, 0 for none; return whether it was acknowledged."""
    assert isinstance(bus, LinkBus)
    setting = m.Set(bus.peer(node).host.session, Parameter.SENSE_MS, milliseconds)
    answers = (bus.request(setting, node) for _ in range(TRIES))
    return isinstance(next((a for a in answers if a is not None), None), m.Ack)


def readings(bus: Bus) -> list[Readings]:
    """Return the measurements since the last call.

    Parameters
    ----------
    bus : Bus
        Open bus.

    Returns
    -------
    list of Readings
        Measurements, those of each amplifier in order; only the newest if the last call was more
        than `SENSES` of `queries` packets ago.
    """
    if not isinstance(bus, LinkBus):
        return []
    first = {facts.node: facts.first_channel for facts in amplifiers(bus)}
    measured = []
    for peer, sense in bus.take_senses():
        pairs = np.frombuffer(sense.readings, "<i2", 2 * (len(sense.readings) // 4)).reshape(-1, 2)
        scale = peer.caps.full_scale_uv * 1e-6 / FULL_SCALE_CODE
        at = distance(sense.position, peer.wire_end(0))
        channel = first[peer.host.node] + sense.first_channel
        measured.append(Readings(at, channel, pairs[:, 0] * scale, pairs[:, 1] * 1e-6))
    return measured
