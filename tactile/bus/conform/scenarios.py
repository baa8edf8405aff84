"""Scenarios of `behavior.json`, and their words for an amplifier that is not at power-up.

A vector describes an amplifier that powers up at tick 0 as node 1. A live one has its own node, its
counters have counted before, and its clock runs. `Translation` rewrites the packets of a vector for
it, and its answers into the words of the vector.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from typing import Any

from firmware_protocol import messages as m
from firmware_protocol.layout import Message
from firmware_protocol.machine import AmplifierCounters
from firmware_protocol.messages import NakCode, Parameter
from firmware_protocol.packet import TURN, Packet, decode_packet

COUNTERS = tuple(field.name for field in fields(AmplifierCounters))
"""Names of the counters of STATUS, which a vector counts from 0."""
UNASKED = (m.Pulse, m.Sense, m.Correlation, m.Guarded)
"""Messages that come by themselves, at times that depend on the link; they are not compared."""
LOGS = (b"watchdog: no heartbeat", b"fault ", b"e-stop input open")
"""Beginnings of the LOGs that SPEC.md demands; an amplifier may send others."""
OWN_CAPS = ("session", "major", "minor")
"""Fields of CAPS that a vector can demand of every amplifier of this version."""
POWER_UP_NODE = 1
"""Node of a vector whose configuration names none."""

Fields = dict[str, int | str]
"""Fields of a message by name; bodies are hexadecimal."""


@dataclass(frozen=True)
class Answer:
    """A message of the amplifier, or what a vector expects of one.

    Attributes
    ----------
    message : str
        Name of the message, as in the tables of SPEC.md.
    fields : dict of str to int or str
        Its fields, or those that the vector demands.
    node : int or None
        Node in its header; None where the vector demands none.
    """

    message: str
    fields: Fields
    node: int | None = None

    def differs(self, got: "Answer") -> bool:
        """Return whether another message is not what this one demands.

        Parameters
        ----------
        got : Answer
            Message of an amplifier.

        Returns
        -------
        bool
            Whether its name, a field that this one names, or its node differs.
        """
        if self.message != got.message or (self.node is not None and self.node != got.node):
            return True
        return any(got.fields.get(name) != value for name, value in self.fields.items())

    def __str__(self) -> str:
        """Return the message as one line for people."""
        words = [f"{name} {_word(name, value)}" for name, value in self.fields.items()]
        if self.node is not None:
            words.append(f"from node {self.node}")
        return f"{self.message} ({', '.join(words)})" if words else self.message


def _word(name: str, value: int | str) -> str:
    """Return a value for people: codes, states and texts by name."""
    if name == "code" and value in set(NakCode):
        return NakCode(int(value)).name
    if name == "state" and value in set(m.State):
        return m.State(int(value)).name
    if name == "text":
        return repr(bytes.fromhex(str(value)).decode("utf-8", "replace"))
    return str(value)


@dataclass(frozen=True)
class Step:
    """A step of a scenario.

    Attributes
    ----------
    time : float
        Time since power-up [s].
    tick : int
        The same [ticks of the vector].
    packet : Packet or None
        Packet that the host sends; None where nothing is sent, or no valid packet.
    answers : tuple of Answer
        Messages that must have come since the step before, in order.
    needs : str
        What this step does besides sending a packet, which a host cannot do; empty for nothing.
    """

    time: float
    tick: int
    packet: Packet | None
    answers: tuple[Answer, ...]
    needs: str = ""


@dataclass(frozen=True)
class Scenario:
    """A vector of `behavior.json`.

    Attributes
    ----------
    id, why, section : str
        Name, reason, and section of SPEC.md.
    config : mapping of str to object
        Configuration of its amplifier, as far as it is not the usual one.
    steps : tuple of Step
        Steps in order.
    needs : str
        What it needs that no host on a link has; empty for nothing.
    unseen : bool
        Whether it also describes the output or the high voltage, which no link shows.
    """

    id: str
    why: str
    section: str
    config: Mapping[str, Any]
    steps: tuple[Step, ...]
    needs: str
    unseen: bool

    @property
    def node(self) -> int:
        """Node of the amplifier of the vector."""
        return int(self.config.get("node", POWER_UP_NODE))

    @property
    def tick_hz(self) -> int:
        """Frequency of the clock of the vector [Hz]."""
        return int(self.config.get("tick_hz", 1_000_000))

    @property
    def parameters(self) -> set[int]:
        """Parameters that it gets or sets."""
        places = {m.Get.TYPE: slice(0, 2), m.Set.TYPE: slice(2, 4)}
        packets = (s.packet for s in self.steps if s.packet and s.packet.type in places)
        return {int.from_bytes(p.payload[places[p.type]], "little") for p in packets}

    @property
    def sessions(self) -> set[int]:
        """Tokens that its hosts take."""
        hellos = (s.packet for s in self.steps if s.packet and s.packet.type == m.Hello.TYPE)
        return {int.from_bytes(packet.payload[:2], "little") for packet in hellos}


def load_scenarios() -> list[Scenario]:
    """Read the behavior vectors that are part of this package.

    Returns
    -------
    list of Scenario
        Vectors in their order.
    """
    path = files("firmware_protocol") / "vectors" / "behavior.json"
    return [_scenario(vector) for vector in json.loads(path.read_text("utf-8"))["vectors"]]


def _scenario(vector: dict[str, Any]) -> Scenario:
    """Return a vector as a scenario."""
    hertz = vector["config"].get("tick_hz", 1_000_000)
    steps = tuple(_step(step, hertz) for step in vector["steps"])
    needs = next((step.needs for step in steps if step.needs), "")
    if vector["pulses"] or "last_pulse" in vector:
        needs = needs or "is about the times of PULSE, which a link changes"
    unseen = any("output" in step or "high_voltage" in step for step in vector["steps"])
    return Scenario(
        vector["id"], vector["why"], vector["section"], vector["config"], steps, needs, unseen
    )


def _step(step: dict[str, Any], hertz: int) -> Step:
    """Return a step of a vector."""
    needs, packet = "", None
    if "fault" in step:
        needs = "needs a fault of the hardware"
    elif "input" in step:
        needs = "needs the e-stop input to be moved"
    elif "packet" in step:
        packet = decode_packet(bytes.fromhex(step["packet"]))
        needs = "" if packet else "needs a damaged packet, which this host does not send"
    answers = tuple(
        Answer(a["message"], _demanded(a["message"], a["fields"]), a.get("node"))
        for a in step.get("answers", [])
    )
    return Step(step["tick"] / hertz, step["tick"], packet, answers, needs)


def _demanded(name: str, given: Fields) -> Fields:
    """Return the fields that a vector can demand of every amplifier."""
    if name == "CAPS":
        return {field: value for field, value in given.items() if field in OWN_CAPS}
    return _uptime_apart(name, given)


def _uptime_apart(name: str, given: Fields) -> Fields:
    """Return the fields of a VALUE with a name of its own for the uptime, which always grows."""
    if name == "VALUE" and given.get("parameter") == Parameter.UPTIME_S and "value" in given:
        return {"parameter": given["parameter"], "uptime_s": given["value"]}
    return dict(given)


def is_compared(message: Message) -> bool:
    """Return whether a message of an amplifier is compared with those of a vector.

    Parameters
    ----------
    message : Message
        Message of an amplifier.

    Returns
    -------
    bool
        Whether it is an answer, or a LOG that SPEC.md demands.
    """
    if isinstance(message, m.Log):
        return message.text.startswith(LOGS)
    return not isinstance(message, UNASKED)


@dataclass(frozen=True)
class Translation:
    """Words of a vector for an amplifier with its own node, counters and clock.

    Attributes
    ----------
    vector_node, node : int
        Node of the amplifier in the vector, and its own.
    vector_tick_hz, tick_hz : int
        Frequencies of the clocks in the vector and in the amplifier [Hz].
    counters : dict of str to int
        Counters before the scenario.
    uptime : int
        Value of UPTIME_S before the scenario [s].
    """

    vector_node: int = POWER_UP_NODE
    node: int = POWER_UP_NODE
    vector_tick_hz: int = 1_000_000
    tick_hz: int = 1_000_000
    counters: Mapping[str, int] | None = None
    uptime: int = 0

    def outgoing(self, step: Step, tick: int) -> Packet:
        """Return the packet of a step for the amplifier.

        Parameters
        ----------
        step : Step
            Step that sends a packet.
        tick : int
            Tick of the amplifier from which a START with a time counts.

        Returns
        -------
        Packet
            Packet with the node, the times and the counters of the amplifier.
        """
        assert step.packet is not None
        packet = step.packet
        return replace(packet, node=self.swapped(packet.node), payload=self._payload(step, tick))

    def _payload(self, step: Step, tick: int) -> bytes:
        """Return the payload of a step for the amplifier; a tail that is missing stays so."""
        packet = step.packet
        assert packet is not None
        payload = packet.payload
        kind = m.MESSAGES.get(packet.type)
        if kind not in (m.Start, m.ClearFault, m.Set) or len(payload) < kind.HEAD.size:
            return payload
        message = kind.unpack(payload)
        if isinstance(message, m.Start) and message.time:
            ahead = (message.time - step.tick) * self.tick_hz // self.vector_tick_hz
            message = replace(message, time=max(tick + ahead, 1))
        elif isinstance(message, m.ClearFault):
            message = replace(message, trips=(message.trips + self._before("trips")) % TURN)
        elif isinstance(message, m.Set) and message.parameter == Parameter.NODE:
            message = replace(message, value=self.swapped(message.value))
        assert message is not None
        return message.pack() + payload[kind.HEAD.size :]

    def incoming(self, packet: Packet, message: Message) -> Answer:
        """Return a message of the amplifier in the words of the vector.

        Parameters
        ----------
        packet : Packet
            Packet that it sent.
        message : Message
            Message of that packet.

        Returns
        -------
        Answer
            The message with all its fields.
        """
        name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", type(message).__name__).upper()
        values: Fields = {
            field: value.hex() if isinstance(value, bytes) else int(value)
            for field in message.__match_args__
            if isinstance(value := getattr(message, field), int | bytes)
        }
        if isinstance(message, m.Status):
            values |= {c: (getattr(message, c) - self._before(c)) % TURN for c in COUNTERS}
        elif isinstance(message, m.Value) and message.parameter == Parameter.NODE:
            values["value"] = self.swapped(message.value)
        elif isinstance(message, m.Value) and message.parameter == Parameter.UPTIME_S:
            values["value"] = (message.value - self.uptime) % TURN
        elif isinstance(message, m.Nak) and _tells_trips(message):
            values["detail"] = (message.detail - self._before("trips")) % TURN
        return Answer(name, _uptime_apart(name, values), self.swapped(packet.node))

    def _before(self, counter: str) -> int:
        """Return a counter before the scenario."""
        return (self.counters or {}).get(counter, 0)

    def swapped(self, node: int) -> int:
        """Exchange the node of the vector and that of the amplifier.

        Parameters
        ----------
        node : int
            Node in the words of one of them.

        Returns
        -------
        int
            Node in the words of the other one.
        """
        pair = {self.vector_node: self.node, self.node: self.vector_node}
        return pair.get(node, node)


def _tells_trips(nak: m.Nak) -> bool:
    """Return whether the detail of a NAK is the counter of trips."""
    return nak.type == m.ClearFault.TYPE and nak.code == NakCode.STATE and nak.detail != 0
