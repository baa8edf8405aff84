"""The C amplifier checks what comes in order, and speaks each link, byte by byte."""

import struct
from pathlib import Path

import pytest
from c_amplifier_rig import (
    ACK,
    ARMED,
    CAN,
    CAPS,
    ESTOPPED,
    HEARTBEAT,
    I2C_READ,
    I2C_WRITE,
    MS,
    NOTHING,
    POLL,
    RUNNING,
    SENSE,
    SERIAL,
    SESSION,
    SET,
    SMBUS_READ,
    SMBUS_WRITE,
    START,
    STATUS,
    Run,
    arm,
    cobs,
    fragments,
    hello,
    join,
    owned,
    packet,
    parse,
    pcm,
    playing,
    uncobs,
)


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


def test_serial_finds_its_way_back(build: Path, tmp_path: Path) -> None:
    run = Run()
    run.feed(0, b"\0\0" + cobs(hello())[:9], SERIAL)
    run.feed(1, cobs(hello())[9:] + b"\7abc\0" + b"\4abc\0" + b"x" * 5000 + b"\0", SERIAL)
    run.feed(2, cobs(packet(POLL)), SERIAL)
    run.run(build, tmp_path)
    answers = [parse(uncobs(data[:-1])) for _, link, data in run.sent if link == SERIAL]
    assert [kind for kind, _ in answers] == [CAPS, STATUS]
    counters = struct.unpack_from("<21I", answers[1][1], 39)
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
    for size in (10, 2 + 75, 64):
        run.feed(1, struct.pack("<H", size), I2C_READ)
    for piece in fragments(hello(), 0, 32):
        run.feed(2, piece, SMBUS_WRITE)
    for _ in range(4):
        run.feed(3, kind=SMBUS_READ)
    run.run(build, tmp_path, "--packet-limit", "255")
    reads = [data for _, link, data in run.sent if link == I2C_WRITE]
    assert reads[1][:10] == reads[0]  # read again from its beginning
    assert struct.unpack("<H", reads[1][:2])[0] == 75
    assert parse(reads[1][2:77])[0] == CAPS
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
