"""The C amplifier, built with sanitizers and driven by packets that are made by hand here.

Nothing of our own codec is used: ``struct`` and ``zlib`` say what SPEC.md says, so that a mistake
which codec and firmware share cannot hide.
"""

import math
import os
import re
import select
import shutil
import socket
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO

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


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of what `make sanitize` builds."""
    directory = tmp_path_factory.mktemp("c")
    command = ["make", "-j2", "-C", str(SOURCE), f"BUILD={directory}", f"CC={compiler()}"]
    made = subprocess.run([*command, "sanitize"], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    return directory / "sanitize"


# Packets and records, by hand


def packet(
    kind: int, payload: bytes = b"", *, seq: int = 7, flags: int = 0x60, node: int = 1
) -> bytes:
    body = bytes([kind, flags, node, seq]) + payload
    return body + struct.pack("<I", zlib.crc32(body))


def parse(data: bytes) -> tuple[int, bytes]:
    """Type and payload of a packet whose CRC-32 holds."""
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
    """Records that are fed, and what came of them."""

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
        """Payloads of NAK of requests of some types."""
        return [p for _, _, p in self.packets(NAK) if p[0] in kinds]

    def values(self, channel: int = 0) -> list[int]:
        return [i.codes[channel] for i in self.instants]

    def status(self) -> dict[str, int]:
        """Counters of the last STATUS."""
        payload = self.packets(STATUS)[-1][2]
        return dict(zip(COUNTERS, struct.unpack("<21I", payload[39:]), strict=True))


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


# Core


def test_self_test_of_the_core(build: Path) -> None:
    done = subprocess.run([build / "test_core"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_hello_is_answered_by_caps(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(5, hello())
    run.run(build, tmp_path, channels=24)
    ((tick, kind, caps),) = run.packets()
    fields = struct.unpack("<HBBIBBHHHHIIIIIIII16s", caps)
    assert (tick, kind) == (5, CAPS)
    assert fields[:3] == (SESSION, 1, 0)
    assert fields[4:] == (
        24, 16, 15, 0, 4096, 1024, 1000000, 2500, 16000, 10**8, 10**8, 700000, 20000, 0x10000,
        b"virtual".ljust(16, b"\0"),
    )  # fmt: skip


def worked(name: str) -> list[bytes]:
    """Payloads of the worked packets of section 15 of a type, after their CRC-32 was checked."""
    text = (SOURCE.parent / "SPEC.md").read_text("utf-8").split("## 15")[1]
    rows = re.findall(rf"^\| {name} \|.*`([0-9a-f ]+)` \|$", text, re.MULTILINE)
    packets = [bytes.fromhex(row) for row in rows]
    assert packets
    assert all(zlib.crc32(p[:-4]) == struct.unpack("<I", p[-4:])[0] for p in packets)
    return packets


def test_worked_packets_of_the_specification(build: Path, tmp_path: Path) -> None:
    run = Run()
    for i, name in enumerate(["HELLO", "TIME", "LIMITS", "SET", "GET", "ARM", "HEARTBEAT"]):
        run.feed(500 + i, worked(name)[0])
    run.feed(600, worked("START")[0])  # at tick 2 000 000
    for data in worked("PCM"):
        run.feed(601, data)
    run.feed(602, worked("SPECTRUM")[0])  # the mode is PCM
    run.feed(603, worked("STOP")[0])
    run.feed(1 * MS, worked("DISARM")[0])
    run.feed(1 * MS, worked("CARRIERS")[0])
    for name in ("SYNC", "ESTOP", "CLEAR_FAULT", "IDENTIFY", "POLL"):
        run.feed(2 * MS, worked(name)[0])
    run.run(build, tmp_path, channels=24)
    (caps,), (time_reply,) = (run.packets(kind) for kind in (CAPS, TIME_REPLY))
    spec = worked("CAPS")[0][4:-4]
    assert caps[2][:4] + caps[2][8:] == spec[:4] + spec[8:]  # but for the schema
    assert time_reply[2] == struct.pack("<3Q", 1000000, 501, 501)
    assert run.packets(NAK) == []
    counters = {k: v for k, v in run.status().items() if v}
    assert counters == {"packets": 20, "wrong_format": 1, "trips": 1}


def test_codes_come_out_at_their_positions(build: Path, tmp_path: Path) -> None:
    codes = [100 * i for i in range(80)]
    run = playing(codes, position=2**32 - 20)  # wraps on the way
    run.feed(20 * MS, packet(POLL))
    run.run(build, tmp_path)
    first = next(i for i, x in enumerate(run.instants) if x.tick == T0)
    played = run.instants[first : first + 72]
    assert [x.tick for x in played] == [T0 + k * PERIOD for k in range(72)]
    assert [x.position for x in played] == [(2**32 - 20 + k) % 2**32 for k in range(72)]
    assert [x.codes for x in played] == [(c, 0) for c in codes[:72]]
    assert {x.position for x in run.instants[8:first]} == {2**32 - 20}  # held
    assert not any(any(x.codes) for x in run.instants[:first])
    assert all(x.state == RUNNING and x.high_voltage for x in played)
    counters = run.status()
    assert counters["packets"] == 5
    assert sum(counters.values()) == 5


def test_start_replaces_the_first_instant_at_or_after_its_tick(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm())
    run.feed(200, start(77, time=1060))
    run.feed(2000, kind=NOTHING)
    run.run(build, tmp_path)
    assert [x.tick for x in run.instants[6:12]] == [875, 1000, 1060, 1185, 1310, 1435]
    assert [x.position for x in run.instants[6:12]] == [77, 77, 77, 78, 79, 80]


def test_stop_before_its_tick_forgets_start(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm())
    run.feed(200, start(77, time=1060))
    run.feed(300, packet(POLL))
    run.feed(600, owned(STOP))
    run.feed(2000, packet(POLL))
    run.run(build, tmp_path)
    assert [x.tick for x in run.instants] == [PERIOD * k for k in range(1, 17)]
    assert [x.position for x in run.instants[1:8]] == [77, 77, 77, 77, 78, 79, 80]
    due = [struct.unpack_from("<IQ", p, 6) for _, _, p in run.packets(STATUS)]
    assert due == [(77, 1060), (run.instants[-1].position + 1, 2125)]


def test_frames_that_come_too_late_or_too_early(build: Path, tmp_path: Path) -> None:
    def frame(channel: int, position: int) -> bytes:
        head = struct.pack("<IHHBBBB", position, SESSION, 80, channel, 1, 3, 1)
        return packet(SPECTRUM, head + b"\xff\x00")

    run = Run()
    run.feed(0, hello())
    run.feed(0, owned(CARRIERS, b"\1" + bytes(4)))  # 0 Hz: the envelope itself
    run.feed(0, arm(mode=1))
    run.feed(1 * MS, start(0, 10))
    for position in (10, 20, 60, 70, 80):  # the fifth has no place
        run.feed(1 * MS, frame(0, position))
    for position in (0, 1024):  # dropped: channel 1 is not active by them, and not waited for
        run.feed(1 * MS, frame(1, position))
    run.feed(T0 + 29 * PERIOD, frame(1, 40))
    run.feed(T0 + 50 * PERIOD, packet(POLL))
    run.run(build, tmp_path, "--slew-v-per-s", "100000000")
    values = {x.position: x.codes for x in run.instants if x.tick >= T0}
    for n in range(51):
        assert abs(values[n][0] - 32766 * min(1, n / 10)) <= 2
        assert abs(values[n][1] - 32766 * max(0, min(1, (n - 30) / 10))) <= 2
    counters = run.status()
    assert (counters["late_samples"], counters["future_samples"]) == (1, 2)


def test_a_rate_that_does_not_divide_the_tick(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(10, arm(rate=7000))
    run.feed(30 * MS, kind=NOTHING)
    run.run(build, tmp_path)
    ticks = [x.tick for x in run.instants]
    assert ticks == [10 + k * 1000000 // 7000 for k in range(1, len(ticks) + 1)]


def test_stop_fades_linearly(build: Path, tmp_path: Path) -> None:
    run = playing([16000] * 1000)
    run.feed(T0 + 100 * PERIOD, owned(STOP))
    run.feed(T0 + 50 * MS, kind=NOTHING)
    run.run(build, tmp_path)
    first = next(i for i, x in enumerate(run.instants) if x.tick == T0)
    fade = run.instants[first + 101 : first + 262]
    assert [x.codes[0] for x in fade] == [*(16000 * g // 160 for g in range(159, -1, -1)), 0]
    assert [x.state for x in fade] == [RAMPDOWN] * 159 + [ARMED] * 2
    assert all(x.high_voltage for x in fade)


def test_stop_quick_goes_at_the_slew_limit(build: Path, tmp_path: Path) -> None:
    run = playing([20000] * 400)
    run.feed(T0 + 100 * PERIOD, owned(STOP, b"\1"))
    run.feed(T0 + 40 * MS, kind=NOTHING)
    run.run(build, tmp_path, "--slew-v-per-s", "5100")
    step = 5100 * 32767 * 10**6 // (10**8 * 8000)
    first = next(i for i, x in enumerate(run.instants) if x.tick == T0)
    values = run.values()[first:]
    assert values[:3] == [step, 2 * step, 3 * step]
    down = values[101:]
    assert down[: down.index(0) + 1] == [max(0, 20000 - step * k) for k in range(1, 98)]
    assert run.instants[first + 101 + down.index(0)].state == ARMED


@pytest.mark.parametrize("last", [0, 40 * MS])
def test_watchdog(build: Path, tmp_path: Path, last: int) -> None:
    run = playing([16000] * 3000)
    if last:
        run.feed(last, owned(HEARTBEAT))
    run.feed(400 * MS, packet(POLL))
    run.run(build, tmp_path, "--fifo", "1000")
    fading = [x for x in run.instants if x.state == RAMPDOWN]
    assert fading[0].tick == next(x.tick for x in run.instants if x.tick >= last + 150 * MS)
    assert len(fading) == 159  # and the one that ends it
    end = [x for x in run.instants if x.tick > fading[-1].tick]
    assert {(x.state, x.high_voltage, x.codes) for x in end} == {(SAFE, 0, (0, 0))}
    assert end[0].tick <= last + 170 * MS + PERIOD
    assert [p[2] for p in run.packets(LOG)] == [b"\2watchdog: no heartbeat"]
    assert run.status()["watchdogs"] == 1


def test_estop_latches_until_cleared(build: Path, tmp_path: Path) -> None:
    run = playing([30000] * 400)
    tick = T0 + 100 * PERIOD
    run.feed(tick, packet(ESTOP, b"\5"))
    run.feed(tick, clear(1))  # not yet at 0 V
    run.feed(tick + 5 * MS, arm())
    run.feed(tick + 5 * MS, hello())
    run.feed(tick + 6 * MS, clear(1))
    run.feed(tick + 7 * MS, packet(POLL))
    run.run(build, tmp_path)
    after = [x for x in run.instants if x.tick > tick]
    assert [x.codes[0] for x in after[:3]] == [30000 - 28671, 0, 0]
    assert [(x.state, x.high_voltage) for x in after[:3]] == [
        (ESTOPPED, 1), (ESTOPPED, 0), (ESTOPPED, 0),
    ]  # fmt: skip
    assert [(n[0], n[2], n[3]) for n in run.naks(CLEAR_FAULT, ARM)] == [
        (CLEAR_FAULT, 7, ESTOPPED), (ARM, 10, ESTOPPED),
    ]  # fmt: skip
    assert run.packets(STATUS)[-1][2][:4] == bytes([IDLE, 0, 0, 5])


def test_clear_fault_names_the_trips_that_it_clears(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, clear(9))  # nothing to clear
    run.feed(1 * MS, packet(ESTOP, b"\1", flags=0x40))
    run.feed(1 * MS, packet(ESTOP, b"\1", flags=0x40))
    run.feed(1 * MS, clear(1))  # sent before the second was known of
    run.feed(2 * MS, b"\3", FAULTY)  # counts in ESTOP too, where it changes no state
    run.feed(2 * MS, clear(2))
    run.feed(2 * MS, clear(3))  # the fault persists
    run.feed(3 * MS, b"\0", FAULTY)  # over: not another
    run.feed(3 * MS, packet(POLL))
    run.feed(3 * MS, clear(3))
    run.feed(4 * MS, b"\3", FAULTY)
    run.feed(4 * MS, b"\3", FAULTY)
    run.feed(4 * MS, b"\0", FAULTY)
    run.feed(4 * MS, clear(4))
    run.feed(4 * MS, clear(5))
    run.feed(5 * MS, packet(POLL))
    run.run(build, tmp_path)
    naks = [(*n[2:4], *struct.unpack("<I", n[4:])) for n in run.naks(CLEAR_FAULT)]
    assert naks == [
        (7, ESTOPPED, 2), (7, ESTOPPED, 3), (9, ESTOPPED, 3), (7, FAULT, 5),
    ]  # fmt: skip
    acks = [p for _, _, p in run.packets(ACK) if p[0] == CLEAR_FAULT]
    assert len(acks) == 3
    before, after = (p for _, _, p in run.packets(STATUS))
    assert (before[0], before[-4:]) == (ESTOPPED, struct.pack("<I", 3))
    assert (after[0], after[-4:]) == (IDLE, struct.pack("<I", 5))


def test_estop_is_taken_whatever_its_flags(build: Path, tmp_path: Path) -> None:
    run = Run()
    for flags in (0x00, 0x80, 0xC0, 0x58, 0xFF):  # versions 0, 2, 3; INCOMPATIBLE; all
        run.feed(0, packet(ESTOP, bytes([flags]), flags=flags))
    run.feed(0, packet(POLL))
    run.run(build, tmp_path)
    assert [kind for _, kind, _ in run.packets()] == [ACK, STATUS]  # 0xFF asks for an answer
    assert run.packets(STATUS)[0][2][:4] == bytes([ESTOPPED, 0, 0, 0xFF])
    assert {k: v for k, v in run.status().items() if v} == {"packets": 6, "trips": 5}


def test_limits_do_not_slow_a_way_to_zero_that_has_begun(build: Path, tmp_path: Path) -> None:
    run = playing([20000] * 200)
    tick = T0 + 110 * PERIOD
    run.feed(tick, packet(ESTOP))
    run.feed(tick, limits(1, 25))  # would be 1 code a sample
    run.feed(tick + 20 * MS, limits(1, 25))
    run.feed(tick + 20 * MS, packet(POLL))
    run.run(build, tmp_path, "--slew-v-per-s", "5100")
    assert [n[2:4] for n in run.naks(LIMITS)] == [bytes([7, ESTOPPED])]
    assert max(run.values()) == 20000
    assert run.instants[-1].codes == (0, 0)
    assert run.packets(STATUS)[0][2][27:35] == struct.pack("<II", 1, 25)


def test_anyone_may_stop_and_no_one_else_may_feed(build: Path, tmp_path: Path) -> None:
    run = playing([16000] * 3000)
    for tick in range(20 * MS, 300 * MS, 20 * MS):
        run.feed(tick, owned(HEARTBEAT, session=0x4321))
    run.feed(30 * MS, hello(0x4321))
    run.feed(400 * MS, hello(0x4321))
    run.feed(400 * MS, packet(POLL))
    run.run(build, tmp_path)
    naks = {(n[0], n[2]) for n in run.naks(HEARTBEAT, HELLO)}
    assert naks == {(HEARTBEAT, 5), (HELLO, 6)}  # SESSION, BUSY
    assert run.status()["foreign_session"] == 14
    assert next(x.tick for x in run.instants if x.state == RAMPDOWN) == 150 * MS
    sessions = [struct.unpack_from("<H", p[2])[0] for p in run.packets(CAPS)]
    assert sessions == [SESSION, 0x4321]  # SAFE is free


def test_last_stage_bounds_value_and_slope(build: Path, tmp_path: Path) -> None:
    square = ([32767] * 20 + [-32767] * 20) * 10
    run = Run()
    run.feed(0, hello())
    run.feed(0, limits(50_000_000, 60_000))
    run.feed(0, limits(60_000_000))  # no way up
    run.feed(0, arm())
    run.feed(1 * MS, start(0, 10))
    run.feed(1 * MS, pcm(0, square[:200]))
    run.feed(2 * MS, pcm(200, square[200:]))
    run.feed(50 * MS, packet(POLL))
    run.run(build, tmp_path)
    limit, step = 32767 // 2, 60000 * 32767 * 10**6 // (10**8 * 8000)
    values = run.values()
    assert max(values) == limit
    assert min(values) == -limit
    assert max(abs(b - a) for a, b in pairwise(values)) == step
    assert [(n[0], n[2], n[4]) for _, _, n in run.packets(NAK)] == [(LIMITS, 11, 1)]
    assert run.status()["limited_samples"] == sum(x.tick >= T0 for x in run.instants)


def test_the_clamp_comes_before_the_gain(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, limits(50_000_000))
    run.feed(0, arm())
    run.feed(1 * MS, start(0, 10))
    run.feed(1 * MS, pcm(0, [32767] * 200))
    run.feed(T0 + 10 * PERIOD, owned(STOP))
    run.feed(T0 + 175 * PERIOD, packet(POLL))
    run.run(build, tmp_path)
    values = [x.codes[0] for x in run.instants if x.tick >= T0]
    fade = [16383 * g // 160 for g in range(159, -1, -1)]
    assert values == [16383] * 11 + fade + [0] * 5
    assert run.status()["limited_samples"] == 11 + 159  # at gain 0 there is nothing to clamp


def test_limits_reach_zero_in_20_ms(build: Path, tmp_path: Path) -> None:
    """Refused are those that would have taken 188 ms from the last heartbeat."""
    rate, period = 16000, 63
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm(rate=rate))
    run.feed(0, limits(10_000_000, 500, 20_000))  # 3276 codes at 10 a sample: 328 samples
    run.feed(0, limits(9_768_000, 500, 20_000))  # 3200 codes: 320
    run.feed(0, start(0))
    square = ([32767] * 700 + [-32767] * 700) * 2
    for i in range(0, len(square), 200):
        run.feed(i * 50, pcm(i, square[i : i + 200]))
    run.feed(200 * MS, packet(POLL))
    run.run(build, tmp_path)
    assert [(n[0], n[2], n[4]) for _, _, n in run.packets(NAK)] == [(LIMITS, 11, 2)]
    assert max(run.values()) == 3200
    assert run.packets(STATUS)[0][2][27:35] == struct.pack("<II", 9_768_000, 500)
    silent = [x for x in run.instants if x.tick >= 170 * MS + period]
    assert silent
    assert {(x.codes, x.high_voltage) for x in silent} == {((0, 0), 0)}
    assert any(x.codes[0] for x in run.instants if x.tick > 160 * MS)


def test_arm_checks_the_limits_at_its_own_rate(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm(rate=2500))
    run.feed(0, limits(9_860_000, 500))  # 3230 codes: 65 x 50 reach, 10 x 320 do not
    run.feed(0, arm(rate=16000))
    run.feed(0, arm(rate=2500))
    run.run(build, tmp_path)
    assert [(n[0], n[2], n[4]) for _, _, n in run.packets(NAK)] == [(ARM, 11, 2)]


@pytest.mark.parametrize(
    "options",
    [
        ["--slew-v-per-s", "5003"],  # enough at 20 000 a second, but not in whole codes
        ["--fade-us", "20001"],
        ["--packet-limit", "135"],
    ],
)
def test_hardware_that_section_11_1_forbids(build: Path, options: list[str]) -> None:
    command = [str(build / "virtual-amplifier"), "--replay", *options]
    done = subprocess.run(command, input=b"", capture_output=True, check=False)
    assert done.returncode == 1
    assert b"11.1" in done.stderr


def test_who_lives_is_not_taken_over(build: Path, tmp_path: Path) -> None:
    other, third = 0x4321, 0x5555
    run = Run()
    run.feed(0, hello())
    run.feed(1, hello(other))  # its owner never was heard
    run.feed(2, hello())
    run.feed(10 * MS, owned(HEARTBEAT))
    run.feed(20 * MS, hello(0))  # only asks
    run.feed(20 * MS, hello())  # its own
    run.feed(160 * MS - 1, hello(other))
    run.feed(160 * MS, hello(other))
    run.feed(160 * MS, hello(third))  # the other was not heard either
    run.feed(160 * MS, packet(POLL))
    run.run(build, tmp_path)
    naks = [(tick, n[0], n[2], n[4:]) for tick, _, n in run.packets(NAK)]
    assert naks == [(160 * MS - 1, HELLO, 6, bytes(4))]
    sessions = [struct.unpack_from("<H", p)[0] for _, _, p in run.packets(CAPS)]
    assert sessions == [SESSION, other, SESSION, SESSION, SESSION, other, third]
    assert run.status()["refused"] == 1


def test_an_output_that_moves_is_not_taken_over(build: Path, tmp_path: Path) -> None:
    run = playing([30000] * 1184)
    run.feed(149 * MS, packet(ESTOP))
    run.feed(155 * MS, hello(0))
    run.feed(155 * MS, hello(0x4321))
    run.feed(170 * MS, hello(0x4321))
    run.run(build, tmp_path, "--slew-v-per-s", "5100")
    assert next(x.codes[0] for x in run.instants if x.tick >= 155 * MS) > 0
    assert [(tick, n[2], n[3]) for tick, _, n in run.packets(NAK)] == [(155 * MS, 6, ESTOPPED)]
    sessions = [struct.unpack_from("<H", p)[0] for _, _, p in run.packets(CAPS)]
    assert sessions == [SESSION, SESSION, 0x4321]


def test_node_is_set_at_rest_and_of_one_only(build: Path, tmp_path: Path) -> None:
    def node(value: int, to: int = 1) -> bytes:
        return packet(SET, struct.pack("<HHI", SESSION, 1, value), node=to)

    run = Run()
    run.feed(0, hello())
    run.feed(0, node(5, to=0))
    run.feed(0, node(128))
    run.feed(0, arm())
    run.feed(0, node(128))  # STATE comes before RANGE
    run.feed(0, owned(DISARM))
    run.feed(0, node(9))
    run.feed(0, packet(POLL, node=9))
    run.run(build, tmp_path)
    assert [(n[2], n[3], n[4]) for n in run.naks(SET)] == [(11, IDLE, 2), (7, ARMED, 0)]
    assert run.status()["refused"] == 3


# Streams


def test_a_short_gap_is_bridged_and_a_long_one_fades(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm())
    run.feed(1 * MS, start(0, 10))
    run.feed(1 * MS, pcm(0, [1000] * 40))
    run.feed(1 * MS, pcm(50, [3200] * 50))  # 10 are missing
    run.feed(T0 + 400 * PERIOD, pcm(440, [8000] * 200))
    run.feed(T0 + 500 * PERIOD, packet(POLL))
    run.run(build, tmp_path)
    values = [x.codes[0] for x in run.instants if x.tick >= T0]
    assert values[39:51] == [1000 + 200 * k for k in range(12)]
    assert values[99] == 3200
    assert values[100:260] == [3200 * g // 160 for g in range(159, -1, -1)]
    assert set(values[260:440]) == {0}
    assert values[440:500] == [8000 * g // 160 for g in range(1, 61)]
    counters = run.status()
    assert counters["underruns"] == 1
    assert counters["lost_samples"] == 10 + 340


def test_samples_too_late_and_too_early_are_counted(build: Path, tmp_path: Path) -> None:
    run = playing([1000] * 200)
    run.feed(T0 + 100 * PERIOD, pcm(91, [5] * 20, channels=2))  # 91 ... 100: put out
    run.feed(T0 + 100 * PERIOD, pcm(1115, [5] * 20))  # 101 + 1024 is the first that has no place
    run.feed(T0 + 100 * PERIOD, pcm(1125, [5] * 4, channels=2))
    run.feed(T0 + 110 * PERIOD, packet(POLL))
    run.run(build, tmp_path)
    counters = run.status()
    assert (counters["late_samples"], counters["future_samples"]) == (10, 12)
    assert counters["underruns"] == 0  # nothing was kept of channel 1: it is not active
    assert counters["ignored"] == 0


def test_stream_packets_that_do_not_fit(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm())
    run.feed(0, pcm(0, [1]))  # not RUNNING
    run.feed(0, start(0, 10))
    run.feed(0, pcm(0, [1, 1], channels=2, first=1))
    run.feed(0, packet(PCM, struct.pack("<IHBBBB", 0, SESSION, 0, 1, 3, 1) + b"\0\0"))
    run.feed(0, packet(PCM, struct.pack("<IHBBBB", 0, SESSION, 0, 1, 1, 1) + b"\0"))
    run.feed(0, packet(PCM, b"\0" * 9))
    run.feed(0, packet(POLL))
    run.run(build, tmp_path)
    naks = [(n[2], n[3], struct.unpack("<I", n[4:])[0]) for _, _, n in run.packets(NAK)]
    assert naks == [
        (7, ARMED, 0), (12, RUNNING, 3), (13, RUNNING, 3), (4, RUNNING, 11), (4, RUNNING, 9),
    ]  # fmt: skip
    counters = run.status()
    assert [counters[c] for c in ("ignored", "wrong_channel", "wrong_format", "malformed")] == [
        1, 1, 1, 2,
    ]  # fmt: skip


def test_packed_formats(build: Path, tmp_path: Path) -> None:
    head = struct.Struct("<IHBBBB")
    run = Run()
    run.feed(0, hello())
    run.feed(0, arm())
    run.feed(1 * MS, start(0, 10))
    # 0x123 and -2 of channels 0 and 1, then 0x7FF and -2048
    pcm12 = bytes([0x23, 0xE1, 0xFF, 0xFF, 0x07, 0x80])
    run.feed(1 * MS, packet(PCM, head.pack(0, SESSION, 0, 2, 1, 2) + pcm12))
    bfp8 = bytes([3, 1, 0xFF]) + bytes([200, 127, 0x80])
    run.feed(1 * MS, packet(PCM, head.pack(2, SESSION, 0, 2, 2, 2) + bfp8))
    run.feed(T0 + 3 * PERIOD, kind=NOTHING)
    run.run(build, tmp_path, "--slew-v-per-s", "100000000")
    assert [x.codes for x in run.instants[-4:]] == [
        (0x1230, -32), (32752, -32752), (8, 32512), (-8, -32767),
    ]  # fmt: skip


def test_spectrum_is_the_sum_of_its_carriers(build: Path, tmp_path: Path) -> None:
    increments = [round(f / 8000 * 2**32) for f in (200, 450)]
    codes = bytes([200, 0, 190, 64])  # amplitude and phase of each carrier
    amplitudes = [32767 * 10 ** (-(255 - c) / 80) for c in (200, 190)]
    run = Run()
    run.feed(0, hello())
    run.feed(0, owned(CARRIERS, bytes([2]) + struct.pack("<2I", *increments)))
    run.feed(0, arm(mode=1))
    run.feed(1 * MS, start(1000, 10))
    for k in range(4):
        at = 1080 + 80 * k
        frame = struct.pack("<IHHBBBB", at, SESSION, 100, 1, 1, 3, 2) + codes
        run.feed(1 * MS, packet(SPECTRUM, frame))
    run.feed(T0 + 800 * PERIOD, packet(POLL))
    run.run(build, tmp_path)

    def exact(n: int) -> float:
        turns = [i * n / 2**32 for i in increments]
        return amplitudes[0] * math.cos(2 * math.pi * turns[0]) - amplitudes[1] * math.sin(
            2 * math.pi * turns[1]
        )

    values = {x.position: x.codes for x in run.instants if x.tick >= T0}
    for n in range(1000, 1420):  # rises for 80, then stays; the last frame is in force for 100
        want = exact(n) * min(1.0, (n - 1000) / 80)
        # rounding: 1/2 of the sum, 1.5 of each sine, 32767 for 32768 in cos
        assert abs(values[n][1] - want) <= 2.5
        assert values[n][0] == 0
    for n in range(1420, 1580):  # starved: the envelope stays, the gain falls
        assert abs(values[n][1] - exact(n) * (1579 - n) / 160) <= 2.5
    assert run.status()["underruns"] == 1


def test_fault_of_the_hardware(build: Path, tmp_path: Path) -> None:
    run = playing([16000] * 400)
    tick = T0 + 100 * PERIOD
    run.feed(tick, b"\2", FAULTY)
    run.feed(tick + 5 * MS, clear(1))
    run.feed(tick + 6 * MS, b"\0", FAULTY)
    run.feed(tick + 6 * MS, clear(1))
    run.run(build, tmp_path)
    assert [x.codes[0] for x in run.instants if x.tick > tick][:2] == [0, 0]
    (nak,) = run.naks(CLEAR_FAULT)
    assert (nak[0], nak[2], nak[3], nak[4]) == (CLEAR_FAULT, 9, FAULT, 2)
    assert run.packets(LOG)[0][2] == b"\3fault 2"
    states = [p[2][4] for p in run.packets(PULSE)]
    assert states[-1] == IDLE


# Checks and links


def test_checks_are_made_in_order_and_counted(build: Path, tmp_path: Path) -> None:
    broken = bytearray(hello())
    broken[5] ^= 1
    run = Run()
    run.feed(0, bytes(broken))
    run.feed(0, packet(POLL, node=2))
    run.feed(0, packet(0x33, flags=0xB8))  # version before flags before type
    run.feed(0, packet(0x33, flags=0x78))
    run.feed(0, packet(0x33))
    run.feed(0, packet(0x33, flags=0x40))  # no answer asked for
    run.feed(0, packet(0x33, node=0))  # never refused
    run.feed(0, owned(SET, struct.pack("<HI", 99, 0), session=0))
    run.feed(0, packet(GET, struct.pack("<H", 99)))
    run.feed(0, hello())
    run.feed(0, owned(SET, struct.pack("<HI", 5, 0)))
    run.feed(0, owned(SET, struct.pack("<HI", 2, 101)))
    run.feed(0, packet(GET, struct.pack("<H", 2)))
    run.feed(0, packet(POLL))
    run.run(build, tmp_path)
    naks = [(n[2], struct.unpack("<I", n[4:])[0]) for _, _, n in run.packets(NAK)]
    assert naks == [(2, 1), (3, 0x78), (1, 0), (5, 0), (14, 99), (15, 5), (11, 2)]
    assert run.packets(VALUE)[0][2] == struct.pack("<HI", 2, 10)
    counters = {k: v for k, v in run.status().items() if v}
    assert counters == {
        "packets": 13, "crc_errors": 1, "wrong_version": 1, "unsupported": 1, "unknown_type": 3,
        "foreign_session": 1, "refused": 3,
    }  # fmt: skip


def test_pulse_comes_at_once_and_then_each_10_ms(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(1, hello())
    run.feed(50 * MS, kind=NOTHING)
    run.run(build, tmp_path)
    pulses = run.packets(PULSE)
    assert [p[0] for p in pulses] == [PERIOD + 10 * MS * k for k in range(5)]
    assert [struct.unpack_from("<I", p[2])[0] for p in pulses] == [80 * k + 1024 for k in range(5)]


def test_sense_tells_what_was_put_out(build: Path, tmp_path: Path) -> None:
    run = playing([])
    for position in range(0, 100, 20):
        run.feed(1 * MS, pcm(position, [3000] * 20))
    run.feed(1 * MS, owned(SET, struct.pack("<HI", 3, 9)))
    run.feed(1 * MS, owned(SET, struct.pack("<HI", 3, 20)))
    run.feed(25 * MS, kind=NOTHING)
    run.run(build, tmp_path, "--sense", "--packet-limit", "136", channels=33)
    assert [n[2] for n in run.naks(SET)] == [11]
    senses = run.packets(SENSE)  # of 30 channels and of 3, which the packet limit asks for
    assert [(tick, p[4], p[5], len(p)) for tick, _, p in senses] == [
        (at, *part) for at in (1125, 21125) for part in ((0, 30, 126), (30, 3, 18))
    ]
    put_out = next(x for x in run.instants if x.tick == 21000)
    assert senses[2][2][:10] == struct.pack("<IBBhh", put_out.position, 0, 30, 3000, 0)


def test_nothing_is_told_before_a_session(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(1 * MS, packet(ESTOP, b"\1", flags=0x40))
    run.feed(2 * MS, b"\1", FAULTY)
    run.feed(50 * MS, packet(POLL))
    run.run(build, tmp_path)
    assert [kind for _, kind, _ in run.packets()] == [STATUS]
    assert run.packets(STATUS)[0][2][:4] == bytes([ESTOPPED, 0, 1, 1])


def test_serial_finds_its_way_back(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, b"\0\0" + cobs(hello())[:9], SERIAL)
    run.feed(1, cobs(hello())[9:] + b"\7abc\0" + b"\4abc\0" + b"x" * 5000 + b"\0", SERIAL)
    run.feed(2, cobs(packet(POLL)), SERIAL)
    run.run(build, tmp_path)
    answers = [parse(uncobs(data[:-1])) for _, link, data in run.sent if link == SERIAL]
    assert [kind for kind, _ in answers] == [CAPS, STATUS]
    counters = struct.unpack("<21I", answers[1][1][39:])
    assert counters[:4] == (2, 0, 2, 1)


@pytest.mark.parametrize(("room", "options"), [(8, []), (64, ["--fd"])])
def test_can(build: Path, tmp_path: Path, room: int, options: list[str]) -> None:
    run = Run()

    def send(tick: int, group: int, data: bytes, node: int = 1) -> None:
        run.feed(tick, struct.pack("<I", group << 8 | node << 1) + data, CAN)

    for i, part in enumerate([hello(), arm()]):
        for piece in fragments(part, i, room):
            send(0, 4, piece)
    send(0, 1, struct.pack("<BHIB", START, SESSION, 5, 2), node=0)
    send(100 * MS, 1, struct.pack("<BH", HEARTBEAT, SESSION))
    send(160 * MS, 0, b"\7", node=0)
    for piece in fragments(packet(POLL), 2, room):
        send(161 * MS, 4, piece)
    broken = fragments(hello(), 3, 8)
    for piece in [*broken[:1], *broken[2:]]:  # the second is lost
        send(162 * MS, 4, piece)
    run.feed(163 * MS, b"", NOTHING)
    for piece in fragments(packet(POLL), 4, room):
        send(164 * MS, 4, piece)
    run.run(build, tmp_path, *options)
    frames = [(struct.unpack("<I", d[:4])[0], d[4:]) for _, link, d in run.sent if link == CAN]
    assert {len(d) for _, d in frames} <= {*range(9), 12, 16, 20, 24, 32, 48, 64}
    assert {f for f, _ in frames} == {0x203, 0x503}
    transfers: list[list[bytes]] = []
    for identifier, data in frames:
        if identifier == 0x503:
            if data[0] & 0x80:
                transfers.append([])
            transfers[-1].append(data)
    assert [t[0][0] & 0x1F for t in transfers] == [0, 1, 2, 3]
    answers = [parse(join(t)) for t in transfers]
    assert [kind for kind, _ in answers] == [CAPS, ACK, STATUS, STATUS]
    assert answers[2][1][:4] == bytes([ESTOPPED, 0, 0, 7])
    assert struct.unpack_from("<21I", answers[3][1], 39)[4] == 1
    pulses = [d for f, d in frames if f == 0x203]
    assert [p[4] for p in pulses][:4] == [ARMED, RUNNING, RUNNING, RUNNING]
    assert all(len(p) == 8 for p in pulses)


@pytest.mark.parametrize("extended", [False, True])
def test_can_identifiers_are_of_one_length(build: Path, tmp_path: Path, *, extended: bool) -> None:
    short, long, foreign = 0, 0x80000000 | 0x1D0B0000, 0x80000000 | 0x1D0A0000
    own, others = (long, (short, foreign)) if extended else (short, (long, foreign))
    run = Run()
    run.feed(0, struct.pack("<IB", own, 1), CAN)
    for prefix in others:
        run.feed(0, struct.pack("<IB", prefix, 2), CAN)  # ESTOP of all nodes
    for kind in (2, 5, 6, 7):  # none of the host's classes
        run.feed(0, struct.pack("<IB8s", own | kind << 8 | 2, 0xC0, bytes(8)), CAN)
    run.feed(0, struct.pack("<IB", own | 1, 3), CAN)  # of an amplifier
    for piece in fragments(packet(POLL), 0, 8):
        run.feed(0, struct.pack("<I", own | 0x402) + piece, CAN)
    run.feed(0, struct.pack("<IB", others[0], 2), CAN)  # does not switch the form of what follows
    run.feed(0, packet(POLL))
    run.run(build, tmp_path, *["--extended"] * extended)
    frames = [(struct.unpack("<I", d[:4])[0], d[4:]) for _, link, d in run.sent if link == CAN]
    assert {identifier for identifier, _ in frames} == {own | 0x503}
    assert parse(join([data for _, data in frames]))[1][:4] == bytes([ESTOPPED, 0, 0, 1])
    assert {k: v for k, v in run.status().items() if v} == {"packets": 3, "trips": 1}


def test_prompt_pulses_use_up_their_seq(build: Path, tmp_path: Path) -> None:
    run = Run()
    for i, tick in enumerate((0, 25 * MS)):
        for piece in fragments(hello(), i, 8):
            run.feed(tick, struct.pack("<I", 0x402) + piece, CAN)
    run.run(build, tmp_path)
    frames = [(*struct.unpack("<I", d[:4]), d[4:]) for _, link, d in run.sent if link == CAN]
    answers = [d for identifier, d in frames if identifier == 0x503 and d[0] & 0x80]
    assert sum(identifier == 0x203 for identifier, _ in frames) == 3
    assert [d[6] for d in answers] == [0, 4]


def test_fragments_wait_20_ms(build: Path, tmp_path: Path) -> None:
    run = Run()
    first, *rest = fragments(packet(POLL), 0, 8)
    for begin, wait in ((0, 19_999), (100 * MS, 20_000)):
        run.feed(begin, struct.pack("<I", 0x402) + first, CAN)
        for piece in rest:
            run.feed(begin + wait, struct.pack("<I", 0x402) + piece, CAN)
    run.feed(200 * MS, packet(POLL))
    run.run(build, tmp_path)
    assert sum(link == CAN and bool(data[4] & 0x80) for _, link, data in run.sent) == 1
    assert run.status()["fragments_dropped"] == 1 + len(rest)


def test_i2c_and_smbus(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, hello(), I2C_WRITE)
    for size in (10, 2 + 74, 64):
        run.feed(1, struct.pack("<H", size), I2C_READ)
    for piece in fragments(hello(), 0, 32):
        run.feed(2, piece, SMBUS_WRITE)
    for _ in range(4):
        run.feed(3, kind=SMBUS_READ)
    run.run(build, tmp_path, "--packet-limit", "255")
    reads = [data for _, link, data in run.sent if link == I2C_WRITE]
    assert reads[1][:10] == reads[0]  # read again from its beginning
    assert struct.unpack("<H", reads[1][:2])[0] == 74
    assert parse(reads[1][2:76])[0] == CAPS
    assert reads[2][:2] == b"\0\0"
    blocks = [data for _, link, data in run.sent if link == SMBUS_READ]
    assert parse(join(blocks[:3]))[0] == CAPS
    assert blocks[3] == b"\0"


def test_the_same_records_give_the_same_files(build: Path, tmp_path: Path) -> None:
    run = playing([(7919 * i) % 65535 - 32767 for i in range(2000)])
    run.feed(300 * MS, kind=NOTHING)
    files = []
    for _ in range(2):
        run.run(build, tmp_path)
        files.append(((tmp_path / "out").read_bytes(), (tmp_path / "sent").read_bytes()))
    assert files[0] == files[1]


# Real time: everything arrives, in order; nothing is said about when


def collect(stream: int, until: int) -> list[tuple[int, bytes]]:
    """Packets from a terminal up to one of type `until`."""
    found: list[tuple[int, bytes]] = []
    data = b""
    while until not in [kind for kind, _ in found]:
        assert select.select([stream], [], [], 20)[0], "nothing came for 20 s"
        data += os.read(stream, 4096)
        *frames, data = data.split(b"\0")
        found += [parse(uncobs(frame)) for frame in frames if frame]
    return found


@pytest.fixture
def terminal(build: Path, tmp_path: Path) -> Iterator[tuple[int, "subprocess.Popen[bytes]"]]:
    out = ["--out", str(tmp_path / "out"), "--channels", "2"]
    process = subprocess.Popen([build / "virtual-amplifier", "--pty", *out], stdout=subprocess.PIPE)
    output: IO[bytes] | None = process.stdout
    assert output is not None
    stream = os.open(output.readline().decode().strip(), os.O_RDWR | os.O_NOCTTY)
    try:
        yield stream, process
    finally:
        os.close(stream)
        process.kill()
        process.wait()
        output.close()


def test_pty(terminal: tuple[int, "subprocess.Popen[bytes]"], tmp_path: Path) -> None:
    stream, process = terminal
    every_byte = bytes(range(256))  # 17 and 19, 10 and 13 pass as they are
    echo = struct.unpack("<Q", every_byte[10:18])[0]
    os.write(stream, b"\0" + cobs(hello()))
    assert collect(stream, CAPS)[-1][0] in (CAPS, PULSE)
    os.write(stream, cobs(packet(TIME, struct.pack("<Q", echo))))
    reply = next(p for kind, p in collect(stream, TIME_REPLY) if kind == TIME_REPLY)
    host_time, received, sent = struct.unpack("<3Q", reply)
    assert host_time == echo
    assert received <= sent
    os.write(stream, cobs(arm()) + cobs(start(0, 20)) + cobs(pcm(0, [9000] * 100)))
    os.write(stream, cobs(owned(HEARTBEAT)) + cobs(packet(POLL)))
    kinds = [kind for kind, _ in collect(stream, STATUS) if kind not in (PULSE, LOG)]
    assert kinds == [ACK, ACK, ACK, ACK, STATUS]
    process.terminate()
    assert process.wait(20) == 0
    rows = list(struct.iter_unpack("<QIBB2h", (tmp_path / "out").read_bytes()))
    assert [b[0] > a[0] for a, b in pairwise(rows)] == [True] * (len(rows) - 1)
    assert rows[-1][3:] == (0, 0, 0)  # high voltage off, 0 V


def test_out_has_whole_records_while_it_runs(
    terminal: tuple[int, "subprocess.Popen[bytes]"], tmp_path: Path
) -> None:
    _, process = terminal
    out, size, seen = tmp_path / "out", struct.calcsize("<QIBB2h"), [0]
    while len(seen) < 5:
        assert process.poll() is None
        if out.stat().st_size > seen[-1]:
            seen.append(out.stat().st_size)
        select.select([], [], [], 0.005)
    assert [n % size for n in seen] == [0] * 5
    ticks = [row[0] for row in struct.iter_unpack("<QIBB2h", out.read_bytes()[: seen[-1]])]
    assert ticks == [PERIOD * k for k in range(1, len(ticks) + 1)]


def refused(build: Path, *options: str) -> str:
    """Return what virtual-amplifier says to options that it does not take."""
    done = subprocess.run(
        [build / "virtual-amplifier", *options], capture_output=True, text=True, check=False,
        timeout=20,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    return done.stderr


@pytest.mark.parametrize(
    "options", [[], ["--pty", "--replay"], ["--socketcan", "none0", "--can", "x"]]
)
def test_it_serves_one_link(build: Path, options: list[str]) -> None:
    first, *_ = refused(build, *options).splitlines()
    assert first == "virtual-amplifier: one of --pty, --can, --socketcan and --replay"


def test_socketcan_without_its_interface(build: Path) -> None:
    why = "No such device" if sys.platform == "linux" else "only on Linux"
    said = refused(build, "--socketcan", "none0")
    assert said == f"virtual-amplifier: --socketcan none0: {why}\n"
    assert refused(build, "--socketcan").startswith("virtual-amplifier: --socketcan: unknown, or ")


@pytest.mark.skipif(sys.platform != "linux", reason="no SocketCAN")
def test_socketcan_on_what_is_no_can_interface(build: Path) -> None:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        why = "No such device"
    except OSError:
        why = "no CAN in this kernel"
    assert refused(build, "--socketcan", "lo") == f"virtual-amplifier: --socketcan lo: {why}\n"


def test_can_socket(build: Path, tmp_path: Path) -> None:
    def frame(identifier: int, data: bytes) -> bytes:
        return struct.pack("<IBB2x64s", identifier, len(data), 0, data)

    path, own = tmp_path / "can", tmp_path / "host"
    process = subprocess.Popen([build / "virtual-amplifier", "--can", str(path), "--extended"])
    host = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    host.bind(str(own))
    host.settimeout(20)
    try:
        while not path.exists():
            assert process.poll() is None
            select.select([], [], [], 0.01)
        for piece in fragments(hello(), 0, 8):
            host.sendto(frame(0x80000000 | 0x1D0B0402, piece), str(path))
        parts: list[bytes] = []
        pulses = 0
        while not pulses or not parts or not parts[-1][0] & 0x40:
            identifier, size, _, data = struct.unpack("<IBB2x64s", host.recv(72))
            pulses += identifier == 0x80000000 | 0x1D0B0203
            if identifier == 0x80000000 | 0x1D0B0503:
                parts.append(data[:size])
        assert parse(join(parts))[0] == CAPS
        process.terminate()
        assert process.wait(20) == 0
        assert not path.exists()
    finally:
        host.close()
        process.kill()
        process.wait()
