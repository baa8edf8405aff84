"""The C amplifier starts, fades, stops and takes owners as SPEC.md says."""

import re
import struct
import subprocess
import zlib
from itertools import pairwise
from pathlib import Path

import pytest
from c_amplifier_rig import (
    ACK,
    ARM,
    ARMED,
    CAPS,
    CARRIERS,
    CLEAR_FAULT,
    DISARM,
    ESTOP,
    ESTOPPED,
    FAULT,
    FAULTY,
    HEARTBEAT,
    HELLO,
    IDLE,
    INPUT,
    LIMITS,
    LOG,
    MS,
    NAK,
    NOTHING,
    PERIOD,
    POLL,
    RAMPDOWN,
    RUNNING,
    SAFE,
    SESSION,
    SET,
    SOURCE,
    SPECTRUM,
    STATUS,
    STOP,
    T0,
    TIME_REPLY,
    Run,
    arm,
    clear,
    hello,
    limits,
    owned,
    packet,
    pcm,
    playing,
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
    fields = struct.unpack("<HBBIBBHHHHIIIIIIII16s", caps)
    assert (tick, kind) == (5, CAPS)
    assert fields[:3] == (SESSION, 1, 1)
    assert fields[4:] == (
        24, 16, 15, 4, 4096, 1024, 1000000, 2500, 16000, 10**8, 10**8, 700000, 20000, 0x10000,
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
    assert (before[0], before[119:123]) == (ESTOPPED, struct.pack("<I", 3))
    assert (after[0], after[119:123]) == (IDLE, struct.pack("<I", 5))


def test_an_open_input_ends_at_0_volt_and_is_not_ended_by_its_closing(
    build: Path, tmp_path: Path
) -> None:
    """5100 V/s: 20000 codes at 208 a sample."""
    run = playing([20000] * 200)
    opened = T0 + 110 * PERIOD + 60  # between two instants
    run.feed(opened, b"\1", INPUT)
    run.feed(opened + 1 * MS, b"\0", INPUT)
    run.feed(opened + 30 * MS, clear(1))
    run.feed(opened + 60 * MS, packet(POLL))
    run.feed(opened + 60 * MS, clear(1))
    run.feed(opened + 61 * MS, kind=NOTHING)
    run.run(build, tmp_path, "--slew-v-per-s", "5100")
    after = [x for x in run.instants if x.tick > opened]
    fall = [max(20000 - 208 * k, 0) for k in range(1, 98)]
    assert [x.codes[0] for x in after[:97]] == fall
    assert [x.high_voltage for x in after[:97]] == [1] * 96 + [0]
    assert not any(x.codes[0] or x.high_voltage for x in after[97:])
    assert [n[2] for n in run.naks(CLEAR_FAULT)] == [18]
    assert run.packets(STATUS)[0][2][:4] == bytes([ESTOPPED, 0, 0, 255])
    assert run.instants[-1].state == IDLE


def test_estop_is_taken_whatever_its_flags(build: Path, tmp_path: Path) -> None:
    run = Run()
    for flags in (0x00, 0x80, 0xC0, 0x58, 0xFF):  # versions 0, 2, 3; INCOMPATIBLE; all
        run.feed(0, packet(ESTOP, bytes([flags & 0x7F]), flags=flags))
    run.feed(0, packet(POLL))
    run.run(build, tmp_path)
    assert [kind for _, kind, _ in run.packets()] == [ACK, STATUS]  # 0xFF asks for an answer
    assert run.packets(STATUS)[0][2][:4] == bytes([ESTOPPED, 0, 0, 0x7F])
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
