"""The C amplifier, built with sanitizers and driven by packets that are made by hand here.

Nothing of our own codec is used: ``struct`` and ``zlib`` say what SPEC.md says, so that a mistake
which codec and firmware share cannot hide.
"""

import os
import shutil
import struct
import subprocess
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "firmware_protocol" / "c"
SESSION = 0x1234
HELLO, TIME, SYNC, START, STOP, ARM, DISARM, ESTOP, CLEAR_FAULT, HEARTBEAT = range(1, 11)
LIMITS, GET, SET, IDENTIFY, POLL, PCM, CARRIERS, SPECTRUM = range(11, 19)
ACK, NAK, CAPS, TIME_REPLY, VALUE, PULSE, STATUS, SENSE, LOG = range(0x40, 0x49)
IDLE, ARMED, RUNNING, RAMPDOWN, SAFE, FAULT, ESTOPPED = range(7)
SERIAL, CAN, I2C_WRITE, PACKET, NOTHING, FAULTY, I2C_READ, SMBUS_WRITE, SMBUS_READ = range(9)
COUNTERS = (
    "packets", "crc_errors", "malformed", "oversized", "fragments_dropped", "wrong_version",
    "unsupported", "unknown_type", "foreign_session", "refused", "ignored", "wrong_channel",
    "wrong_format", "late_samples", "future_samples", "lost_samples", "underruns",
    "limited_samples", "watchdogs", "dropped_replies", "trips",
)  # fmt: skip
MS = 1000  # ticks
PERIOD = 125  # ticks of a sample at 8 kHz


def compiler() -> str:
    """Return a C compiler, or skip; where CI promises one its absence is a failure."""
    for name in (os.environ.get("CC", ""), "gcc", "clang"):
        if name and shutil.which(name) and shutil.which("make"):
            return name
    if os.environ.get("CI") == "true":
        pytest.fail("no C compiler or no make on PATH")
    pytest.skip("no C compiler or no make on PATH")


def make(directory: Path, target: str) -> None:
    """Build the amplifier in a directory."""
    command = ["make", "-j2", "-C", str(SOURCE), f"BUILD={directory}", f"CC={compiler()}"]
    made = subprocess.run([*command, target], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr


# Packets and records, by hand


def packet(
    kind: int, payload: bytes = b"", *, seq: int = 7, flags: int = 0x60, node: int = 1
) -> bytes:
    body = bytes([kind, flags, node, seq]) + payload
    return body + struct.pack("<I", zlib.crc32(body))


def parse(data: bytes) -> tuple[int, bytes]:
    """Return type and payload of a packet, and check its CRC-32."""
    assert struct.unpack("<I", data[-4:])[0] == zlib.crc32(data[:-4])
    assert data[1] == 0x40
    return data[0], data[4:-4]


def cobs(data: bytes) -> bytes:
    """Encode packets of less than 254 bytes."""
    return b"".join(bytes([len(part) + 1]) + part for part in data.split(b"\0")) + b"\0"


def uncobs(coded: bytes) -> bytes:
    out, at = bytearray(), 0
    while at < len(coded):
        out += coded[at + 1 : at + coded[at]]
        at += coded[at]
        if at < len(coded):
            out.append(0)
    return bytes(out)


def fragments(data: bytes, transfer: int, room: int) -> list[bytes]:
    data = struct.pack("<H", len(data)) + data
    parts = [data[i : i + room - 1] for i in range(0, len(data), room - 1)]
    first = [
        (i == 0) << 7 | (i == len(parts) - 1) << 6 | (i % 2) << 5 | transfer
        for i in range(len(parts))
    ]
    return [bytes([f]) + part for f, part in zip(first, parts, strict=True)]


def join(parts: list[bytes]) -> bytes:
    """Join the fragments of one transfer, and check their first bytes."""
    for i, part in enumerate(parts):
        assert part[0] >> 5 == (i == 0) << 2 | (i == len(parts) - 1) << 1 | i % 2
    data = b"".join(part[1:] for part in parts)
    return data[2 : 2 + struct.unpack("<H", data[:2])[0]]


def hello(session: int = SESSION) -> bytes:
    return packet(HELLO, struct.pack("<HBBI", session, 1, 0, 0))


def arm(mode: int = 0, rate: int = 8000) -> bytes:
    return packet(ARM, struct.pack("<HBI", SESSION, mode, rate))


def clear(trips: int) -> bytes:
    return owned(CLEAR_FAULT, struct.pack("<I", trips))


def limits(voltage_uv: int, slew_v_per_s: int = 0, fade_us: int = 0) -> bytes:
    return owned(LIMITS, struct.pack("<III", voltage_uv, slew_v_per_s, fade_us))


def start(position: int = 0, delay_ms: int = 0, time: int = 0) -> bytes:
    return packet(START, struct.pack("<HIBQ", SESSION, position, delay_ms, time))


def pcm(position: int, codes: list[int], channels: int = 1, first: int = 0) -> bytes:
    head = struct.pack("<IHBBBB", position, SESSION, first, channels, 0, len(codes) // channels)
    return packet(PCM, head + struct.pack(f"<{len(codes)}h", *codes))


def owned(kind: int, tail: bytes = b"", session: int = SESSION) -> bytes:
    return packet(kind, struct.pack("<H", session) + tail)


@dataclass
class Instant:
    tick: int
    position: int
    state: int
    high_voltage: int
    codes: tuple[int, ...]


@dataclass
class Run:
    """Records that are fed to the amplifier, and its output."""

    records: list[bytes] = field(default_factory=list)
    instants: list[Instant] = field(default_factory=list)
    sent: list[tuple[int, int, bytes]] = field(default_factory=list)

    def feed(self, tick: int, data: bytes = b"", kind: int = PACKET) -> None:
        self.records.append(struct.pack("<QBI", tick, kind, len(data)) + data)

    def run(self, build: Path, directory: Path, *options: str, channels: int = 2) -> None:
        out, sent = directory / "out", directory / "sent"
        command = [build / "virtual-amplifier", "--replay", "--out", out, "--sent", sent]
        records = sorted(self.records, key=lambda r: int.from_bytes(r[:8], "little"))
        done = subprocess.run(
            [*map(str, command), "--channels", str(channels), *options],
            input=b"".join(records),
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr.decode()
        layout = struct.Struct(f"<QIBB{channels}h")
        self.instants = [
            Instant(row[0], row[1], row[2], row[3], row[4:])
            for row in layout.iter_unpack(out.read_bytes())
        ]
        data, at = sent.read_bytes(), 0
        while at < len(data):
            tick, kind, size = struct.unpack_from("<QBI", data, at)
            self.sent.append((tick, kind, data[at + 13 : at + 13 + size]))
            at += 13 + size

    def packets(self, *kinds: int) -> list[tuple[int, int, bytes]]:
        """(tick, type, payload) of packets sent without a link, of some types only."""
        found = [(tick, *parse(data)) for tick, link, data in self.sent if link == PACKET]
        return [p for p in found if not kinds or p[1] in kinds]

    def naks(self, *kinds: int) -> list[bytes]:
        """Return the payloads of the NAKs to requests of some types."""
        return [p for _, _, p in self.packets(NAK) if p[0] in kinds]

    def values(self, channel: int = 0) -> list[int]:
        return [i.codes[channel] for i in self.instants]

    def status(self) -> dict[str, int]:
        """Return the counters of the last STATUS."""
        payload = self.packets(STATUS)[-1][2]
        return dict(zip(COUNTERS, struct.unpack_from("<21I", payload, 39), strict=True))


def playing(codes: list[int], position: int = 0) -> Run:
    """ARM, START at 1 ms plus 10 ms, codes for channel 0 at the pace they are played."""
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm())
    run.feed(1 * MS, start(position, 10))
    for i in range(0, len(codes), 200):
        at = (position + i) % 2**32
        run.feed(1 * MS + i * PERIOD, pcm(at, codes[i : i + 200]))
    return run


T0 = 11 * MS  # tick of START in `playing`
