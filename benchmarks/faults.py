"""Faulty links: packets lost for each error, and accepted packets that were never sent.

Every packet that is sent is unique; received packets are looked up among them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from firmware_protocol.can_link import CanDecoder, CanEncoder, Frame
from firmware_protocol.messages import Pcm
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.bench.figures import Figure, at_most

Rng = np.random.Generator
Spoil = Callable[[Rng, bytearray, int, int], None]
Harm = Callable[[Rng, list[Frame], int], None]

ERRORS = 10_000
"""Number of errors of each kind."""
APART = 3
"""Number of packets per error, so that errors stay separate."""
BURST = 8
"""Largest number of bytes of a burst."""
FRAME_US = 130
"""Interval between CAN frames: one of 8 bytes at 1 Mbit/s [µs]."""


def packets(count: int, rng: Rng) -> list[Packet]:
    """Return PCM packets of 30 to 300 bytes: one half noise, the other with many zeros."""
    result = []
    for k in range(count):
        data = rng.bytes(int(rng.integers(12, 283)))
        if k % 2:
            data = bytes(np.frombuffer(data, np.uint8) >> 5)
        message = Pcm(position=k, session=4711, data=data)
        result.append(Packet.of(message, node=1 + k % 3, seq=k))
    return result


@dataclass
class Account:
    """Counts of packets that were lost, wrong or received twice."""

    errors: int = 0
    lost: int = 0
    wrong: int = 0
    twice: int = 0

    def add(self, sent: list[Packet], received: list[Packet], errors: int) -> None:
        """Compare received packets with those that were sent, by content."""
        known, there = set(map(encode_packet, sent)), set(map(encode_packet, received))
        self.errors += errors
        self.lost += len(known - there)
        self.wrong += len(there - known)
        self.twice += len(received) - len(there)

    def figures(self, name: str) -> Iterator[Figure]:
        """Yield the counts per error."""
        yield at_most(f"{name}.lost_per_error", self.lost / self.errors, "packets", 1.2)
        yield at_most(f"{name}.wrong", self.wrong, "packets", 0)


# Serial


def _flip(rng: Rng, stream: bytearray, at: int, length: int) -> None:
    for k in range(at, at + length):
        stream[k] ^= 1 << int(rng.integers(8))


def _replace(rng: Rng, stream: bytearray, at: int, length: int) -> None:
    for k in range(at, at + length):
        stream[k] ^= int(rng.integers(1, 256))


def _insert(rng: Rng, stream: bytearray, at: int, length: int) -> None:
    stream[at:at] = rng.bytes(length)


def _delete(rng: Rng, stream: bytearray, at: int, length: int) -> None:
    del stream[at : at + length]


SPOILERS: dict[str, Spoil] = {
    "flip": _flip, "replace": _replace, "insert": _insert, "delete": _delete,
}  # fmt: skip
"""Errors of a serial stream, by name."""


def spoilt_stream(spoil: Spoil, errors: int, *, longest: int, seed: int) -> Account:
    """Return the counts for a stream with errors of 1 … ``longest`` bytes."""
    rng, account, decoder = np.random.default_rng(seed), Account(), SerialDecoder()
    for start in range(0, errors, 100):
        count = min(100, errors - start)
        sent = packets(APART * count, rng)
        frames = [encode_frame(encode_packet(p)) for p in sent]
        stream = bytearray()
        for k in range(0, len(frames), APART):
            part = bytearray(b"".join(frames[k : k + APART]))
            length = int(rng.integers(1 if longest == 1 else 2, longest + 1))
            spoil(rng, part, int(rng.integers(len(part) - length)), length)
            stream += part
        stream += b"\0"
        account.add(sent, decoder.feed(bytes(stream)), count)
    return account


# CAN


def _lose(rng: Rng, frames: list[Frame], at: int) -> None:
    del frames[at]


def _repeat(rng: Rng, frames: list[Frame], at: int) -> None:
    frames.insert(at, frames[at])


def _reorder(rng: Rng, frames: list[Frame], at: int) -> None:
    """Delay a frame by one to three places."""
    frames.insert(at + int(rng.integers(1, 4)), frames.pop(at))


def _corrupt(rng: Rng, frames: list[Frame], at: int) -> None:
    """Replace a byte, which a controller's own CRC hardly ever lets pass."""
    identifier, data = frames[at]
    spoilt = bytearray(data)
    spoilt[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))
    frames[at] = identifier, bytes(spoilt)


HARMS: dict[str, Harm] = {
    "lost": _lose, "repeated": _repeat, "reordered": _reorder, "corrupted": _corrupt,
}  # fmt: skip
"""Errors of CAN frames, by name."""


def harmed_frames(harm: Harm, errors: int, *, fd: bool, seed: int) -> Account:
    """Return the counts for packets of which one frame in every three packets is harmed."""
    rng, account, now = np.random.default_rng(seed), Account(), 0
    encoder = CanEncoder(from_amplifier=False, fd=fd)
    decoder = CanDecoder(from_amplifier=False)
    for start in range(0, errors, 100):
        count = min(100, errors - start)
        sent, received = packets(APART * count, rng), []
        for k in range(0, len(sent), APART):
            frames = [frame for p in sent[k : k + APART] for frame in encoder.frames(p)]
            harm(rng, frames, int(rng.integers(len(frames))))
            for frame in frames:
                now += FRAME_US
                received += decoder.feed(*frame, now)
        account.add(sent, received, count)
    return account


def measure_faults(errors: int = ERRORS) -> Iterator[Figure]:
    """Measure single errors and bursts in a serial stream, and errors of CAN frames."""
    for seed, (kind, spoil) in enumerate(SPOILERS.items()):
        for name, longest in (("single", 1), ("burst", BURST)):
            account = spoilt_stream(spoil, errors, longest=longest, seed=seed)
            yield from account.figures(f"faults.serial.{kind}.{name}")
    for seed, (kind, harm) in enumerate(HARMS.items()):
        for name, fd in (("can", False), ("can_fd", True)):
            account = harmed_frames(harm, errors, fd=fd, seed=seed)
            yield from account.figures(f"faults.{name}.{kind}")
            if account.twice:
                yield Figure(f"faults.{name}.{kind}.came_twice", account.twice, "packets")
