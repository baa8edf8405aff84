"""The C amplifier on terminals and sockets: all arrives, in order; nothing is said about when."""

import os
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import IO

import pytest
from c_amplifier_rig import (
    ACK,
    CAPS,
    CLEAR_FAULT,
    ESTOPPED,
    HEARTBEAT,
    LOG,
    NAK,
    PERIOD,
    POLL,
    PULSE,
    STATUS,
    TIME,
    TIME_REPLY,
    arm,
    clear,
    cobs,
    fragments,
    hello,
    join,
    owned,
    packet,
    parse,
    pcm,
    start,
    uncobs,
)


def collect(stream: int, until: int) -> list[tuple[int, bytes]]:
    """Return the packets from a terminal up to one of type `until`."""
    found: list[tuple[int, bytes]] = []
    data = b""
    while until not in [kind for kind, _ in found]:
        assert select.select([stream], [], [], 60)[0], "nothing came for 60 s"
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


@pytest.mark.realtime
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
    assert process.wait(60) == 0
    rows = list(struct.iter_unpack("<QIBB2h", (tmp_path / "out").read_bytes()))
    assert [b[0] > a[0] for a, b in pairwise(rows)] == [True] * (len(rows) - 1)
    assert rows[-1][3:] == (0, 0, 0)  # high voltage off, 0 V


@pytest.mark.realtime
def test_signals_pull_and_release_the_estop_button(
    terminal: tuple[int, "subprocess.Popen[bytes]"],
) -> None:
    stream, process = terminal
    os.write(stream, b"\0" + cobs(hello()) + cobs(arm()))
    collect(stream, ACK)
    process.send_signal(signal.SIGUSR1)
    collect(stream, LOG)
    os.write(stream, cobs(packet(POLL)))
    status = next(p for kind, p in collect(stream, STATUS) if kind == STATUS)
    assert (status[0], status[3], status[-1]) == (ESTOPPED, 255, 1)
    os.write(stream, cobs(clear(1)))
    assert collect(stream, NAK)[-1][1] == bytes([CLEAR_FAULT, 7, 18, ESTOPPED, 0, 0, 0, 0])
    process.send_signal(signal.SIGUSR2)
    while status[-1]:  # until it has been closed for 50 ms
        os.write(stream, cobs(packet(POLL)))
        status = next(p for kind, p in collect(stream, STATUS) if kind == STATUS)
    assert status[0] == ESTOPPED
    os.write(stream, cobs(clear(1)))
    collect(stream, ACK)


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
        timeout=60,
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


@pytest.mark.realtime
def test_can_socket(build: Path, tmp_path: Path) -> None:
    def frame(identifier: int, data: bytes) -> bytes:
        return struct.pack("<IBB2x64s", identifier, len(data), 0, data)

    path, own = tmp_path / "can", tmp_path / "host"
    process = subprocess.Popen([build / "virtual-amplifier", "--can", str(path), "--extended"])
    host = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    host.bind(str(own))
    host.settimeout(60)
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
        assert process.wait(60) == 0
        assert not path.exists()
    finally:
        host.close()
        process.kill()
        process.wait()
