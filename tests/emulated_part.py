"""The amplifier in C on a microcontroller that QEMU emulates (`ports/qemu/wire.c`)."""

import os
import select
import socket
import struct
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_amplifier_rig import SOURCE
from cobs import cobs
from protocol_traces import MARKS, PACKET, RECORD, SWITCHED, Record

from firmware_protocol.correlation import Sensor
from firmware_protocol.serial_link import encode_frame

MACHINES = {"m4": "mps2-an386", "m0": "mps2-an385"}
"""Machine of QEMU by the core that the program is compiled for; there is none with a Cortex-M0+."""
FIELDS = (
    "node", "channels", "carriers", "formats", "packet_limit", "fifo_samples", "tick_hz",
    "rate_min_hz", "rate_max_hz", "full_scale_uv", "voltage_limit_uv", "slew_limit_v_per_s",
    "fade_limit_us",
)  # fmt: skip
"""Values of a configuration, in the order in which the part takes them; sensor and marker lines
follow."""
SERIAL = 0
POWER_UP, PUT_OUT, AFTER, CURRENTS, SENSE, SENSE_RANGE, DONE = range(11, 18)
HANG = 120.0
"""Time after which a part that does not answer has failed [s]."""


def make(build: Path, *options: str, source: Path = SOURCE, ci: bool = True) -> tuple[int, str]:
    """Run `make` in the folder of the port; return its status and all that it printed."""
    environment = {k: v for k, v in os.environ.items() if k != "CI"}
    environment |= {"CI": "true"} if ci else {}
    command = ["make", "-C", str(source / "ports" / "qemu"), f"BUILD={build}", *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def made(build: Path, *options: str, source: Path = SOURCE) -> str:
    """Run `make`, which has to succeed; skip where a tool is missing, which is a failure in CI."""
    status, text = make(build, *options, source=source)
    if "skipped: there is no" in text:
        if os.environ.get("CI") == "true":
            pytest.fail(text)
        pytest.skip(text)
    assert status == 0, text
    return text


class Board:
    """Board around a part: what it measures, and what the part has put out and sent.

    Parameters
    ----------
    sensor : what measures voltages and currents; None for a board that does not
    ranges_ua : ranges of the currents

    Attributes
    ----------
    out : records of the instants, as `virtual-amplifier --out` writes them
    sent : packets that came over the wire, switching of the high voltage, and changes of the marker
        lines
    """

    def __init__(self, sensor: Sensor | None, ranges_ua: Sequence[int]) -> None:
        self._sensor, self._ranges = sensor, ranges_ua
        self._position = self._codes = self._currents = b""
        self.out, self.sent = bytearray(), list[Record]()

    def take(self, report: Record) -> bytes:
        """Take a report of the part; return the answer to it."""
        tick, kind, data = report
        if kind == SERIAL:
            self.sent.append(Record(tick, PACKET, cobs.decode(data[:-1])))
        elif kind in (SWITCHED, MARKS):
            self.sent.append(report)
        elif kind == PUT_OUT:
            self._put_out(data)
        elif kind == AFTER:
            self.out += struct.pack("<Q", tick) + self._position + data + self._codes
        else:
            return self._measured(kind, data)
        return b""

    def _put_out(self, data: bytes) -> None:
        self._position, self._codes = data[:4], data[8:]
        if self._sensor is not None:
            codes = np.frombuffer(self._codes, "<i2").astype(np.int64)
            measured = self._sensor.measure(codes[None], int.from_bytes(data[4:8], "little"))
            self._currents = measured[0].astype("<i2").tobytes()

    def _measured(self, kind: int, data: bytes) -> bytes:
        assert self._sensor is not None
        if kind == CURRENTS:
            return self._currents
        if kind == SENSE:
            return np.stack(self._sensor.readings())[:, data[0]].astype("<i2").tobytes()
        assert kind == SENSE_RANGE
        range_ua = int.from_bytes(data, "little")
        if range_ua not in self._ranges:
            return b"\0"
        self._sensor.choose(range_ua)
        return b"\1"


class EmulatedPart:
    """A microcontroller with a serial line and a line to its board, until it is closed.

    Parameters
    ----------
    program : program to boot
    machine : machine of QEMU
    folder : folder for its files, which is empty
    """

    def __init__(self, program: Path, machine: str, folder: Path) -> None:
        self._log = folder / "log"
        self._wire, wire = socket.socketpair()
        self._orders, orders = socket.socketpair()
        os.mkfifo(folder / "board")
        self._reports = os.open(folder / "board", os.O_RDONLY | os.O_NONBLOCK)
        self._waiting = bytearray()
        lines = []
        for name, line in (("wire", wire), ("orders", orders)):
            lines += ["-chardev", f"socket,id={name},fd={line.fileno()}"]
            lines += ["-serial", f"chardev:{name}"]
        with wire, orders, self._log.open("wb") as printed:
            self._qemu = subprocess.Popen(
                ["qemu-system-arm", "-M", machine, "-display", "none", "-monitor", "none", *lines,
                 "-chardev", "stdio,id=out",
                 "-semihosting-config", "enable=on,target=native,chardev=out", "-kernel", program],
                pass_fds=(wire.fileno(), orders.fileno()), cwd=folder,
                stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT,
            )  # fmt: skip
        for line in (self._wire, self._orders):
            line.settimeout(HANG)
        self._answers = self._wire.makefile("rb")

    def close(self) -> None:
        """End the emulation."""
        self._qemu.kill()
        self._qemu.wait()
        self._answers.close()
        self._wire.close()
        self._orders.close()
        os.close(self._reports)

    def _take_report(self, size: int) -> bytes:
        """Wait for bytes from the pipe."""
        while len(self._waiting) < size:
            if not select.select([self._reports], [], [], HANG)[0]:
                raise TimeoutError
            data = os.read(self._reports, 65536)
            if not data:
                raise EOFError
            self._waiting += data
        taken = bytes(self._waiting[:size])
        del self._waiting[:size]
        return taken

    def _take_answer(self, size: int) -> bytes:
        """Wait for bytes from the wire."""
        data = self._answers.read(size)
        if len(data) < size:
            raise EOFError
        return data

    def _report(self) -> Record:
        """Wait for the next record of the part; the content of an answer is on the wire."""
        tick, kind, size = RECORD.unpack(self._take_report(RECORD.size))
        take = self._take_answer if kind == SERIAL else self._take_report
        return Record(tick, kind, take(size))

    def _exchange(self, record: Record, board: Board) -> None:
        tick, kind, data = record
        self._orders.sendall(RECORD.pack(tick, kind, len(data)))
        (self._wire if kind == SERIAL else self._orders).sendall(data)
        while (report := self._report()).kind != DONE:
            if answer := board.take(report):
                self._orders.sendall(answer)

    def _do(self, record: Record, board: Board) -> None:
        """Let the part do what a record demands."""
        try:
            self._exchange(record, board)
        except (OSError, EOFError) as error:
            printed = self._log.read_text("utf-8")
            raise AssertionError(f"the part has ended or hangs: {printed}") from error

    def replay(
        self, config: Mapping[str, Any], records: Iterable[Record], sensor: Sensor | None = None
    ) -> tuple[bytes, list[Record]]:
        """Power the part up, and let it do what records demand.

        Parameters
        ----------
        config : values of its configuration
        records : trace; packets go over the wire, and so do bytes of kind `SERIAL`
        sensor : what measures on the board; None for a board that does not

        Returns
        -------
        bytes
            Records of the instants, as `virtual-amplifier --out` writes them.
        list of Record
            Packets that came over the wire, switching of the high voltage, and changes of the
            marker lines.
        """
        ranges = config.get("sense_ranges_ua", ())
        board = Board(sensor, ranges)
        values = [config[name] for name in FIELDS] + [*ranges, 0][:1] + [int(sensor is not None)]
        values.append(config.get("marker_lines", 0))
        self._do(Record(0, POWER_UP, struct.pack(f"<{len(values)}I", *values)), board)
        for record in records:
            if record.kind == PACKET:
                record = Record(record.tick, SERIAL, encode_frame(record.data))
            self._do(record, board)
        return bytes(board.out), board.sent
