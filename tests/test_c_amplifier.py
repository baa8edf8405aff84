"""Tests of the C amplifier beyond the vectors: its own figures, and closed forms.

How it starts, fades, stops, counts and refuses is in `test_protocol_vectors_c`.
"""

import math
import re
import struct
import subprocess
import zlib
from pathlib import Path

import pytest
from c_amplifier_rig import (
    CAPS,
    CARRIERS,
    LIMITS,
    MS,
    NAK,
    PERIOD,
    POLL,
    SESSION,
    SOURCE,
    SPECTRUM,
    STATUS,
    STOP,
    T0,
    TIME_REPLY,
    Run,
    arm,
    hello,
    limits,
    owned,
    packet,
    pcm,
    start,
)


def test_self_test_of_the_core(build: Path) -> None:
    done = subprocess.run([build / "test_core"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_hello_is_answered_by_caps(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(5, hello())
    run.run(build, tmp_path, channels=24)
    ((tick, kind, caps),) = run.packets()
    fields = struct.unpack("<HBBIBBHHHHIIIIIIII16sB", caps)
    assert (tick, kind) == (5, CAPS)
    assert fields[:3] == (SESSION, 1, 4)
    assert fields[4:] == (
        24, 16, 15, 4, 4096, 1024, 1000000, 2500, 16000, 10**8, 10**8, 700000, 20000, 0x10000,
        b"virtual".ljust(16, b"\0"), 0,
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


def test_limits_reach_zero_in_20_ms(build: Path, tmp_path: Path) -> None:
    """Limits that would have taken 188 ms from the last heartbeat are refused."""
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


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            "--fifo 511 --rate-max 8000",
            "fifo_samples 511: must be 512 to 1024 (SPEC.md 4: 64 ms at --rate-max; and the room "
            "of this program): change --fifo or --rate-max",
        ),
        (
            "--slew-v-per-s 5103",  # enough at the lowest and the highest rate
            "slew_limit_v_per_s 5103: must be 5104 to 100000000 (SPEC.md 11.1: to 0 V from "
            "--voltage-limit-uv in 20 ms at every rate): change --slew-v-per-s",
        ),
        (
            "--fade-us 20001",
            "fade_limit_us 20001: must be 0 to 20000 (SPEC.md 11.1): change --fade-us",
        ),
        (
            "--packet-limit 135",
            "packet_limit 135: must be 136 to 4096 (SPEC.md 4): change --packet-limit",
        ),
        (
            "--tick-hz 159999",
            "tick_hz 159999: must be 160000 to 4294967295 (SPEC.md 4: 10 ticks a sample at "
            "--rate-max): change --tick-hz",
        ),
        (
            "--formats 0xFF00",
            "formats 65280: must be 1 to 15 (SPEC.md 4: one of the bits 0 to 3 is set): change "
            "--formats",
        ),
        (
            "--carriers 0",
            "carriers 0: must be 1 to 16 (SPEC.md 10: 1 at least with bit 3 of --formats; and the "
            "room of this program): change --carriers",
        ),
        (
            "--full-scale-uv 0",
            "full_scale_uv 0: must be 1 to 4294967295 (SPEC.md 4): change --full-scale-uv",
        ),
    ],
)
def test_hardware_that_the_specification_forbids(build: Path, options: str, line: str) -> None:
    command = [str(build / "virtual-amplifier"), "--replay", *options.split()]
    done = subprocess.run(command, input=b"", capture_output=True, check=False)
    assert done.returncode == 1
    assert done.stderr.decode() == f"virtual-amplifier: {line}\n"


def test_the_least_full_scale_that_there_is_is_allowed(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(5, hello())
    run.run(build, tmp_path, "--full-scale-uv", "1", "--voltage-limit-uv", "1")
    assert [kind for _, kind, _ in run.packets()] == [CAPS]


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
