"""OSC packets as an engine writes them, and with a few faults."""

import math
import random
import struct
from typing import Any

from pythonosc.osc_bundle_builder import IMMEDIATELY
from pythonosc.osc_message_builder import build_msg

from tactile.server import osc


def packet(address: str, *values: Any) -> bytes:
    return bytes(build_msg(address, values).dgram)


def bundle(*parts: bytes, time: float = IMMEDIATELY) -> bytes:
    """Return a bundle, written from the specification."""
    head = b"#bundle\0" + struct.pack(">Q", 1 if time == IMMEDIATELY else int(time) << 32)
    return head + b"".join(struct.pack(">i", len(part)) + part for part in parts)


def mutated(rng: random.Random) -> bytes:
    """Return a packet with a few faults, or with none."""
    verbs = [*osc.VERBS, "arm", "clear", "disarm", "right/contact", "left/arm", "x/y/z", ""]
    odd = [0.0, 1.0, -1.0, math.nan, math.inf, 1e9, 7, -1, "", "wood-oak", "../x", "a" * 100, True]
    values = [rng.choice(odd) for _ in range(rng.randrange(7))]
    data = bytes(packet(f"/tactile/{rng.choice(verbs)}", *values))
    while rng.random() < 0.3:
        data = bundle(*[data] * rng.randrange(1, 4))
    if rng.random() < 0.5:
        broken = bytearray(data)
        for _ in range(rng.randrange(1, 5)):
            broken[rng.randrange(len(broken))] = rng.randrange(256)
        data = bytes(broken[: rng.randrange(len(broken) + 1)])
    return data[: osc.LARGEST_PACKET + 1]
