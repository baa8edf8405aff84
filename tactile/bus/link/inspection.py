"""What a device can tell of itself: who its amplifiers are, which one is which, what they measure.

Only amplifiers that speak the protocol tell; of other buses everything here is empty, and says so
by being empty.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.messages import FULL_SCALE_CODE, Feature, Parameter, SampleFormat
from firmware_protocol.player import distance
from tactile.arrays import Floats
from tactile.bus.base import Bus
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.peer import Peer

TRIES = 5
"""Requests to begin or to end measuring; a busy machine may miss all repetitions of one."""


@dataclass(frozen=True)
class AmplifierFacts:
    """One amplifier, by its CAPS and its clock.

    Attributes
    ----------
    node, name, firmware : address, and what its maker says
    first_channel, channels : the drive lines that are its
    formats : of samples that it takes
    carriers : of spectrum frames, at most
    rates : least and most [Hz]
    full_scale, voltage_limit : [V]
    slew_limit : [V/s]
    fade_limit : [s]
    buffer : samples that it keeps
    measures, holds : voltage and current of its channels; each sample until the next (zero-order)
    drift_ppm : of its clock against the host's, as known by now
    round_trip : shortest time of a recent exchange of time stamps with it [s]; 0 if none is known
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
    holds: bool
    drift_ppm: float
    round_trip: float

    def has(self, channel: int) -> bool:
        """Tell whether a drive line is its."""
        return 0 <= channel - self.first_channel < self.channels

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data; keys carry their units."""
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
            "holds": self.holds,
            "drift_ppm": self.drift_ppm,
        }


@dataclass(frozen=True)
class Readings:
    """What an amplifier measured at one instant.

    Attributes
    ----------
    position : that was put out, counted as that of blocks since the latest start
    first_channel : of the display
    volts, current : (C,) [V], [A]
    """

    position: int
    first_channel: int
    volts: Floats
    current: Floats


def amplifiers(bus: Bus) -> tuple[AmplifierFacts, ...]:
    """Return who is on a bus, in the order of channels; nobody, where devices do not tell."""
    if not isinstance(bus, LinkBus):
        return ()
    found, first = [], 0
    for peer in bus.peers:
        found.append(_facts(peer, first))
        first += peer.caps.channels
    return tuple(found)


def _facts(peer: Peer, first: int) -> AmplifierFacts:
    caps = peer.caps
    return AmplifierFacts(
        node=peer.host.node,
        name=caps.name.rstrip(b"\0").decode("utf-8", "replace"),
        firmware=caps.firmware,
        first_channel=first,
        channels=caps.channels,
        formats=tuple(f.name.lower() for f in SampleFormat if caps.formats >> f & 1),
        carriers=caps.carriers,
        rates=(caps.rate_min_hz, caps.rate_max_hz),
        full_scale=caps.full_scale_uv * 1e-6,
        voltage_limit=caps.voltage_limit_uv * 1e-6,
        slew_limit=float(caps.slew_limit_v_per_s),
        fade_limit=caps.fade_limit_us * 1e-6,
        buffer=caps.fifo_samples,
        measures=bool(caps.features & Feature.SENSES),
        holds=bool(caps.features & Feature.ZERO_ORDER_HOLD),
        drift_ppm=0.0 if peer.clock is None else peer.clock.drift_ppm,
        round_trip=0.0 if peer.clock is None else peer.clock.round_trip,
    )


def identify(bus: Bus, node: int, seconds: int) -> bool:
    """Let an amplifier blink; return whether it said that it would."""
    return isinstance(bus, LinkBus) and isinstance(bus.ask(m.Identify(seconds), node), m.Ack)


@contextmanager
def measuring(bus: Bus, interval: float) -> Iterator[set[int]]:
    """Let the amplifiers that can measure at an interval [s]; yield the nodes of those that do.

    However it ends, the bus is at 0 V before they are told to measure no more.
    """
    asked = [facts.node for facts in amplifiers(bus) if facts.measures]
    try:
        yield {node for node in asked if _measure(bus, node, round(interval * 1e3))}
    except BaseException:
        bus.abort()
        raise
    finally:
        bus.stop()
        for node in asked:
            _measure(bus, node, 0)


def _measure(bus: Bus, node: int, milliseconds: int) -> bool:
    assert isinstance(bus, LinkBus)
    session = next(peer.host.session for peer in bus.peers if peer.host.node == node)
    setting = m.Set(session, Parameter.SENSE_MS, milliseconds)
    answers = (bus.ask(setting, node) for _ in range(TRIES))
    return isinstance(next((a for a in answers if a is not None), None), m.Ack)


def readings(bus: Bus) -> list[Readings]:
    """Return what was measured since the last call; the newest, where that is long."""
    if not isinstance(bus, LinkBus):
        return []
    first = {facts.node: facts.first_channel for facts in amplifiers(bus)}
    found = []
    for peer, sense in bus.sensed():
        pairs = np.frombuffer(sense.readings, "<i2", 2 * (len(sense.readings) // 4)).reshape(-1, 2)
        scale = peer.caps.full_scale_uv * 1e-6 / FULL_SCALE_CODE
        at = distance(sense.position, peer.wire_end(0))
        channel = first[peer.host.node] + sense.first_channel
        found.append(Readings(at, channel, pairs[:, 0] * scale, pairs[:, 1] * 1e-6))
    return found
