"""The decision which scenarios apply to a live amplifier, by the reference amplifier.

A scenario applies where the reference, with the properties of the live amplifier and brought to
rest in the same way, answers as the vector says whenever its steps come later by any times up to
one of `LATENESS`. Every right amplifier then answers so, on every link that is not later than that.
"""

import copy
import math
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.can_link import CanDecoder, CanEncoder
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.correlation import Sensor
from firmware_protocol.messages import Feature, Flag
from firmware_protocol.packet import Packet, decode_packet, encode_packet
from firmware_protocol.sources import Ints
from tactile.bus.conform.rig import Rig, Trace
from tactile.bus.conform.scenarios import Answer, Fields, Scenario, Step, Translation
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Can, Link
from tactile.clock import ModelClock

LATENESS = (50e-3, 20e-3, 10e-3)
"""Times by which each step of a scenario may come later than its vector says [s]. A scenario is
played with the longest of them with which it applies."""
STRETCHINGS = 8
"""Number of random stretchings of each scenario, besides four simple ones."""
PASTS = 3
"""Number of different pasts of the reference before its scenarios."""
GRID = 0.1
"""Interval after which the instants of all rates that are multiples of 10 Hz repeat [s]."""
TIMES = frozenset(("position", "time", "sync_time", "received", "sent"))
"""Fields that depend on the clock; they are compared where they do not."""
PASSING = TIMES | frozenset(
    (
        "lost_samples", "underruns", "late_samples", "future_samples", "limited_samples",
        "estop_reason", "uptime_s",
    )
)  # fmt: skip
"""Fields that a scenario may leave open without being about nothing else."""
UNCOMPARED = TIMES | {"dropped_replies"}
"""Fields of STATUS that are not compared after a scenario; a link may drop PULSEs."""
DEFAULTS = {
    "channels": 2, "carriers": 4, "formats": 15, "packet_limit": 4096, "fifo_samples": 1024,
    "tick_hz": 1_000_000, "rate_min_hz": 2500, "rate_max_hz": 16000, "full_scale_uv": 100_000_000,
    "voltage_limit_uv": 100_000_000, "slew_limit_v_per_s": 700_000, "fade_limit_us": 20_000,
    "features": int(Feature.ESTOP_INPUT), "marker_lines": 0,
}  # fmt: skip
"""Configuration of a vector that names none (`vectors/README.md`), as CAPS tells it."""


class SilentSensor:
    """A sensor of an amplifier that draws no current."""

    def __init__(self, channels: int) -> None:
        self._zeros = np.zeros(channels, np.int64)

    def measure(self, codes: Ints, rate: int) -> Ints:
        """Return currents of 0 for a run of instants."""
        return np.zeros_like(codes)

    def readings(self) -> tuple[Ints, Ints]:
        """Return voltages and currents of 0."""
        return self._zeros, self._zeros

    def choose(self, range_ua: int) -> None:
        """Do nothing; every range reads 0."""


class ReferenceWire(Wire):
    """Wire to a reference amplifier, which receives what the link would carry to it, and at once.

    Parameters
    ----------
    amplifier : ReferenceAmplifier
        The amplifier, at power-up.
    clock : ModelClock
        Its clock, on which it powered up at 0 s.
    link : Link
        Link whose packets it receives; on CAN some go in prompt frames.
    """

    def __init__(self, amplifier: ReferenceAmplifier, clock: ModelClock, link: Link) -> None:
        super().__init__(link)
        self.amplifier, self.clock = amplifier, clock

    def _now(self) -> int:
        return round(self.clock.now() * self.amplifier.config.tick_hz)

    def send(self, packet: Packet) -> float:
        """Pass a packet to the amplifier, as the link carries it."""
        if isinstance(self.link, Can) and packet.node not in (self.amplifier.node, 0):
            return 0.0  # its controller ignores the identifiers of others (3.2)
        for each in carried(packet, self.link):
            data, limit = encode_packet(each), self.amplifier.config.packet_limit
            decoded = decode_packet(data, self.amplifier.counters, limit)
            if decoded is not None:
                self.amplifier.receive(decoded, self._now())
        return 0.0

    def send_urgent(self, packet: Packet) -> None:
        """Pass a packet to the amplifier; nothing waits before it."""
        self.send(packet)

    def receive(self, until: float) -> list[Packet]:
        """Let the amplifier run up to a time, and return what it sent."""
        self.clock.sleep(until - self.clock.now())
        self.amplifier.run(self._now())
        self.amplifier.take_played()
        return self.amplifier.take_sent()

    def wake(self) -> None:
        """Do nothing, since nobody waits."""

    def close(self) -> None:
        """Do nothing, since nothing is open."""


def carried(packet: Packet, link: Link) -> list[Packet]:
    """Return what an amplifier receives of a packet; a prompt frame of CAN has no header.

    Parameters
    ----------
    packet : Packet
        Packet of the host.
    link : Link
        Link on which it goes.

    Returns
    -------
    list of Packet
        Packet that arrives; empty if the link cannot carry it.
    """
    if not isinstance(link, Can):
        return [packet]
    if packet.type not in m.MESSAGES:
        return []
    encoder = CanEncoder(from_amplifier=False, fd=link.data is not None, extended=link.extended)
    decoder = CanDecoder(from_amplifier=False, extended=link.extended)
    return [p for i, data in encoder.frames(packet) for p in decoder.feed(i, data, 0)]


def can_carry(scenario: Scenario, link: Link) -> bool:
    """Return whether a link carries all packets of a scenario.

    Parameters
    ----------
    scenario : Scenario
        Scenario.
    link : Link
        Link to the amplifier.

    Returns
    -------
    bool
        Whether it does; CAN has classes for the types that exist only.
    """
    return all(carried(step.packet, link) for step in scenario.steps if step.packet is not None)


def on_link(scenario: Scenario, link: Link) -> Scenario:
    """Return a scenario without the answers that a link cannot ask for.

    Parameters
    ----------
    scenario : Scenario
        Scenario.
    link : Link
        Link to the amplifier; on CAN a prompt frame gets neither ACK nor NAK.

    Returns
    -------
    Scenario
        The same steps, with what is left of their answers.
    """
    return replace(scenario, steps=tuple(_answered(step, link) for step in scenario.steps))


def _answered(step: Step, link: Link) -> Step:
    """Return a step without the answer that its packet does not ask for on a link."""
    packet = step.packet
    arriving = [] if packet is None else carried(packet, link)
    if packet is None or not arriving or arriving[0].flags & Flag.ACK_REQUEST:
        return step
    lost = {"type": packet.type, "seq": packet.seq}
    left = (a for a in step.answers if not lost.items() <= a.fields.items())
    return replace(step, answers=tuple(left))


def config_of_caps(caps: m.Caps, node: int, range_ua: int) -> AmplifierConfig:
    """Return the configuration of an amplifier by its CAPS.

    Parameters
    ----------
    caps : Caps
        Its CAPS.
    node : int
        Its node.
    range_ua : int
        Its SENSE_RANGE_UA, if it correlates [µA].

    Returns
    -------
    AmplifierConfig
        Configuration of a reference amplifier that is like it.
    """
    same = {f.name for f in fields(AmplifierConfig)} & set(caps.__match_args__)
    values = {name: getattr(caps, name) for name in same - {"name"}}
    return AmplifierConfig(
        **values, fifo=caps.fifo_samples, node=node,
        estop_input=bool(caps.features & Feature.ESTOP_INPUT),
        sense_ranges_ua=(range_ua,) if caps.features & Feature.CORRELATES else (),
    )  # fmt: skip


@dataclass(frozen=True)
class Expected:
    """What a scenario demands of the live amplifier.

    Attributes
    ----------
    answers : tuple of Answer
        Messages in order, with the fields that do not depend on the times of the steps.
    status : dict of str to int or str
        Fields of STATUS after the last step, where they do not depend on them either.
    late : float
        Longest time by which a step may come later than its vector says [s].
    """

    answers: tuple[Answer, ...]
    status: Fields
    late: float


class Judge:
    """Decision which scenarios apply to an amplifier.

    Parameters
    ----------
    config : AmplifierConfig
        Its configuration.
    senses : bool
        Whether it measures.
    link : Link
        Link to it.
    """

    def __init__(self, config: AmplifierConfig, *, senses: bool, link: Link) -> None:
        self._config, self._senses, self._link = config, senses, link
        self._pasts: list[Rig] = []

    def judge(self, scenario: Scenario) -> Expected | str:
        """Decide whether a scenario applies.

        Parameters
        ----------
        scenario : Scenario
            Scenario.

        Returns
        -------
        Expected or str
            What it demands, or the reason why it does not apply.
        """
        if scenario.needs:
            return scenario.needs
        if not can_carry(scenario, self._link):
            return f"needs packets that {self._link.name} does not carry"
        if wrong := self._misfit(scenario):
            return wrong
        self._pasts = self._pasts or [self._past(seed) for seed in range(PASTS)]
        if not _agrees(scenario, self._in_step(scenario), PASSING):
            return "needs an amplifier that was just powered up"
        for late in LATENESS:
            if expected := self._stretched(scenario, late):
                return expected
        return "depends on exact times"

    def _in_step(self, scenario: Scenario) -> Trace:
        """Return what the reference does after a past, with the instants of power-up."""
        rig = copy.deepcopy(self._pasts[0])
        words = rig.translation(scenario)
        rig.wait(math.ceil(rig.clock.now() / GRID) * GRID)
        return rig.play(scenario, words, lambda gap: 0.0)

    def _stretched(self, scenario: Scenario, late: float) -> Expected | None:
        """Return what a scenario demands if all its steps may be late; None if it depends on it."""
        traces = list[Trace]()
        for stretch in _stretchings(random.Random(scenario.id), late):
            rig = copy.deepcopy(self._pasts[len(traces) % PASTS])
            trace = rig.play(scenario, rig.translation(scenario), stretch)
            if not _agrees(scenario, trace, PASSING):
                return None
            traces.append(trace)
        return _common(scenario, traces, late)

    def _reference(self, config: AmplifierConfig) -> Rig:
        """Return a rig with a reference amplifier at power-up."""
        sensor: Sensor | None = SilentSensor(config.channels) if self._senses else None
        clock = ModelClock()
        clock.time = 0.0
        wire = ReferenceWire(ReferenceAmplifier(config, sensor), clock, self._link)
        rig = Rig(wire, clock, patience=0.0)
        rig.node = rig.home = config.node
        rig.caps = replace(m.Caps(), **{
            name: getattr(config, name) for name in ("tick_hz", "rate_min_hz", "rate_max_hz")
        })  # fmt: skip
        return rig

    def _past(self, seed: int) -> Rig:
        """Return a rig whose amplifier has been in use for some time and is at rest."""
        rig = self._reference(self._config)
        rig.wait(random.Random(seed).uniform(0.2, 2.0))
        rig.find()
        rig.rest()
        for reason in range(1, seed + 1):
            rig.emergency(reason)
            rig.rest()
        return rig

    def _misfit(self, scenario: Scenario) -> str:
        """Return why a scenario is about another configuration; empty if it is not."""
        if self._fits(scenario, self._config):
            return ""
        own = {**DEFAULTS, **scenario.config}
        wrong = [
            f"{name} {own[name]}, not {value}"
            for name, value in self._caps_values().items()
            if value != own.get(name, value) and not self._fits(scenario, self._like(own, name))
        ]
        return "another configuration: needs " + ("; ".join(wrong) or "that of the vector")

    def _caps_values(self) -> dict[str, int]:
        """Return the configuration of the amplifier by the names of CAPS."""
        c = self._config
        values = {name: getattr(c, name) for name in DEFAULTS if hasattr(c, name)}
        return values | {"fifo_samples": c.fifo}

    def _like(self, own: dict[str, Any], name: str) -> AmplifierConfig:
        """Return the configuration of a vector with one value of the amplifier."""
        mixed = {**own, name: self._caps_values()[name]}
        known: dict[str, Any] = {key: value for key, value in mixed.items() if key in KNOWN}
        return replace(self._config, **known, fifo=mixed["fifo_samples"])

    def _fits(self, scenario: Scenario, config: AmplifierConfig) -> bool:
        """Return whether the reference with a configuration passes the vector from power-up on."""
        try:
            rig = self._reference(config)
        except ValueError:  # no amplifier can have this mixture
            return False
        words = Translation(scenario.node, config.node, scenario.tick_hz, config.tick_hz)
        return _agrees(scenario, rig.play(scenario, words, lambda gap: 0.0), frozenset())


KNOWN = {field.name for field in fields(AmplifierConfig)}
"""Names of the values of a configuration."""


def _stretchings(dice: random.Random, late: float) -> Iterable[Callable[[float], float]]:
    """Yield functions that draw by how much later each step comes."""
    yield lambda gap: 0.0
    yield lambda gap: late
    yield lambda gap: dice.uniform(0.0, late)
    yield lambda gap: dice.choice((0.0, late))
    for _ in range(STRETCHINGS):
        yield lambda gap: dice.choice((0.0, late, dice.uniform(0.0, late)))


def _agrees(scenario: Scenario, trace: Trace, passing: frozenset[str]) -> bool:
    """Return whether a trace is what a vector says, but for fields that may be left open."""
    wanted = [answer for step in scenario.steps for answer in step.answers]
    if len(wanted) != len(trace.answers):
        return False
    return not any(
        without(want, passing).differs(got) for want, got in zip(wanted, trace.answers, strict=True)
    )


def without(answer: Answer, names: frozenset[str]) -> Answer:
    """Return an answer without some of its fields.

    Parameters
    ----------
    answer : Answer
        Answer.
    names : frozenset of str
        Names of the fields to leave out.

    Returns
    -------
    Answer
        The same with the other fields.
    """
    kept = {name: value for name, value in answer.fields.items() if name not in names}
    return replace(answer, fields=kept)


def _common(scenario: Scenario, traces: list[Trace], late: float) -> Expected:
    """Return what a vector and all traces have in common."""
    wanted = [answer for step in scenario.steps for answer in step.answers]
    answers = []
    for k, want in enumerate(wanted):
        got = [trace.answers[k].fields for trace in traces]
        open_ = {n for n, value in want.fields.items() if any(g.get(n) != value for g in got)}
        answers.append(without(want, frozenset(open_)))
    first = traces[0].status
    status = {
        name: value
        for name, value in first.items()
        if name not in UNCOMPARED and all(t.status.get(name) == value for t in traces)
    }
    return Expected(tuple(answers), status, late)
