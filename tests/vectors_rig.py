"""Vectors of firmware_protocol, and decoded messages in their words."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.messages import MESSAGES
from firmware_protocol.packet import Packet
from firmware_protocol.sources import Ints

PROTOCOL = Path(__file__).parents[1] / "firmware_protocol"
FILES = (
    "messages", "packets", "serial", "can", "i2c", "samples", "spectrum", "correlation",
    "guard", "behavior", "capabilities",
)  # fmt: skip
COUNTERS = (
    "packets", "crc_errors", "malformed", "oversized", "fragments_dropped", "unknown_type",
)  # fmt: skip
DEFAULTS = {
    "channels": 2, "carriers": 4, "formats": 15, "packet_limit": 4096, "fifo_samples": 1024,
    "tick_hz": 1000000, "rate_min_hz": 2500, "rate_max_hz": 16000, "full_scale_uv": 100000000,
    "voltage_limit_uv": 100000000, "slew_limit_v_per_s": 700000, "fade_limit_us": 20000, "node": 1,
}  # fmt: skip
OPTIONS = {
    "fifo_samples": "fifo", "rate_min_hz": "rate-min", "rate_max_hz": "rate-max",
    "slew_limit_v_per_s": "slew-v-per-s", "fade_limit_us": "fade-us",
}  # fmt: skip
HEAD, ACK, PULSE = 4, 0x40, 0x45

Vector = dict[str, Any]


def load(name: str) -> Any:
    return json.loads((PROTOCOL / "vectors" / f"{name}.json").read_text("utf-8"))


VECTORS: dict[str, list[Vector]] = {name: load(name)["vectors"] for name in FILES}


def vectors(file: str, *kinds: str, **having: object) -> pytest.MarkDecorator:
    """Run a test on the vectors of a file, of some kinds, with some values."""
    chosen = [
        v
        for v in VECTORS[file]
        if (not kinds or v["kind"] in kinds) and all(v.get(k) == x for k, x in having.items())
    ]
    return pytest.mark.parametrize("vector", chosen, ids=[v["id"] for v in chosen])


def plain(value: Any) -> Any:
    """Return a field of a message as the vectors write it."""
    return bytes(value).hex() if isinstance(value, bytes | bytearray | memoryview) else int(value)


def told(message: Any, fields: Vector) -> Vector:
    """Return those fields of a message that a vector names."""
    values = {name: getattr(message, name) for name in fields}
    return {
        name: bytes(value).rstrip(b"\0").decode() if name == "name" else plain(value)
        for name, value in values.items()
    }


def whole(vector: Vector) -> Packet:
    return Packet(
        vector["type"], bytes.fromhex(vector["payload"]), vector["flags"], vector["node"],
        vector["seq"],
    )  # fmt: skip


def counted(counters: object, vector: Vector) -> None:
    assert {n: getattr(counters, n) for n in vector["counters"]} == vector["counters"]


def framed(vector: Vector) -> list[tuple[int, str]]:
    return [(f["id"], f["data"]) for f in vector["frames"]]


def same_prompt(packet: Packet, vector: Vector) -> None:
    assert (packet.type, packet.node, packet.flags) == (vector["type"], vector["node"], 0x40)
    assert told(MESSAGES[packet.type].unpack(packet.payload), vector["fields"]) == vector["fields"]


Instants = dict[int, tuple[int | None, int | None, list[int], int]]
"""Instants by tick: position and state, None where they are not known, codes, and code on the
marker lines."""


def check_answers(step: Vector, sent: list[Packet]) -> None:
    answers, expected = [p for p in sent if p.type != PULSE], step.get("answers", [])
    names = [MESSAGES[p.type].__name__.upper() for p in answers]
    assert names == [a["message"].replace("_", "") for a in expected], step
    for packet, answer in zip(answers, expected, strict=True):
        fields = told(MESSAGES[packet.type].unpack(packet.payload), answer["fields"])
        assert fields == answer["fields"], step
        assert packet.node == answer.get("node", packet.node), step


def check_pulses(step: Vector, sent: list[Packet]) -> None:
    pulses = [MESSAGES[p.type].unpack(p.payload) for p in sent if p.type == PULSE]
    expected = [{k: v for k, v in p.items() if k != "tick"} for p in step["pulses"]]
    assert [told(p, e) for p, e in zip(pulses, expected, strict=False)] == expected, step
    assert len(pulses) == len(expected), step


def check_output(step: Vector, instants: Instants) -> None:
    for expected in step.get("output", []):
        position, state, codes, lines = instants[expected["tick"]]
        assert codes == expected["codes"], (step, expected)
        assert lines == expected.get("lines", lines), (step, expected)
        assert position in (None, expected.get("position", position)), (step, expected)
        assert state in (None, expected.get("state", state)), (step, expected)


def check_last_pulse(vector: Vector, sent: Iterable[Packet]) -> None:
    if "last_pulse" in vector:
        last = [p for p in sent if p.type == PULSE][-1]
        fields = vector["last_pulse"]
        assert told(MESSAGES[PULSE].unpack(last.payload), fields) == fields


def config_of(vector: Vector) -> dict[str, Any]:
    own: dict[str, Any] = vector["config"]
    return DEFAULTS | own


class Output:
    """Sensor of an amplifier that measures what it puts out, and no current."""

    def __init__(self, channels: int) -> None:
        self.last = np.zeros(channels, np.int64)

    def measure(self, codes: Ints, rate: int) -> Ints:
        self.last = codes[-1].copy()
        return np.zeros_like(codes)

    def readings(self) -> tuple[Ints, Ints]:
        return self.last, np.zeros_like(self.last)

    def choose(self, range_ua: int) -> None:
        raise AssertionError(range_ua)
