"""The C amplifier puts out what streams say, and gaps, lateness and faults as SPEC.md says."""

import math
import struct
from pathlib import Path

from c_amplifier_rig import (
    ARMED,
    CARRIERS,
    CLEAR_FAULT,
    FAULT,
    FAULTY,
    IDLE,
    LOG,
    MS,
    NAK,
    NOTHING,
    PCM,
    PERIOD,
    POLL,
    PULSE,
    RUNNING,
    SESSION,
    SPECTRUM,
    T0,
    Run,
    arm,
    clear,
    hello,
    owned,
    packet,
    pcm,
    playing,
    start,
)


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
