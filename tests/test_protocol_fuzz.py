"""Random bytes into every target of `protocol_fuzz`, seeded; atheris does it at length by hand."""

import random

import pytest
from protocol_fuzz import TARGETS

from firmware_protocol.packet import Packet, encode_packet

RUNS = {
    "packets": 4000,
    "serial": 4000,
    "can": 8000,
    "i2c": 8000,
    "formats": 2500,
    "windows": 2500,
    "amplifier": 400,
}
"""Number of runs of each kind, which take about 1.5 s each."""


def rubbish(rng: random.Random) -> bytes:
    """Return bytes, some of few values, so that delimiters and ids meet."""
    size = rng.choice((3, 20, 200, 2000))
    if rng.random() < 0.5:
        return rng.randbytes(rng.randrange(size))
    few = rng.randbytes(3) + b"\0\xff"
    return bytes(rng.choices(few, k=rng.randrange(size)))


@pytest.mark.parametrize("name", TARGETS)
def test_no_bytes_make_it_raise(name: str) -> None:
    rng = random.Random(f"{name} 1")
    for _ in range(RUNS[name]):
        TARGETS[name](rubbish(rng))


def test_the_targets_see_what_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """An encoder of packets that spoils one bit is found: the targets do compare."""

    def spoilt(packet: Packet) -> bytes:
        data = encode_packet(packet)
        return bytes([data[0] ^ 1]) + data[1:]

    good = encode_packet(Packet(0x0F, b""))
    TARGETS["packets"](good)
    monkeypatch.setattr("protocol_fuzz.encode_packet", spoilt)
    with pytest.raises(AssertionError):
        TARGETS["packets"](good)
