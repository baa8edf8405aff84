"""Traces: input of an amplifier with its times, and everything that it put out and sent.

A `Rig` plays a trace on the Python amplifier while it is made, and keeps it; `replay` plays it on
the one in C.
"""

import pickle
import subprocess
from collections.abc import Iterable
from dataclasses import astuple
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from protocol_judge import LAYOUTS, TURN, Judge

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import State
from firmware_protocol.packet import decode_packet, encode_packet

PACKET, RUN, FAULT, INPUT, SWITCHED, MARKS = 3, 4, 5, 9, 10, 18
SHORT = 1_000_001
"""Load of a channel that is shorted."""
RECORD = Struct("<QBI")
MARK_RECORD = Struct("<IB")
"""Content of a record of kind `MARKS`: position, and the code on the marker lines from there on."""
KINDS = {name: (kind, layout) for kind, (name, layout, _) in LAYOUTS.items()}
RAMPING = (State.RUNNING, State.RAMPDOWN)
AFTER_RAMP = (State.IDLE, State.ARMED, State.SAFE)
POWERED = (State.ARMED, State.RUNNING, State.RAMPDOWN)
CONFIGS = {
    "as shipped": AmplifierConfig(channels=2),
    "slow ticks": AmplifierConfig(
        channels=1, tick_hz=32768, rate_min_hz=1000, rate_max_hz=1049, fifo=68, packet_limit=255,
        formats=0b0111, marker_lines=1,
    ),
    "fast ticks": AmplifierConfig(
        channels=5, tick_hz=48_000_000, rate_min_hz=1000, rate_max_hz=4411, fifo=300, carriers=3,
        full_scale_uv=150_000_000, slew_limit_v_per_s=40_000, fade_limit_us=12_345,
    ),
    "low slew": AmplifierConfig(
        channels=3, rate_min_hz=1000, rate_max_hz=1600, fifo=103, carriers=2, node=127,
        full_scale_uv=200_000_000, voltage_limit_uv=60_000_000, slew_limit_v_per_s=3_151,
        marker_lines=8,
    ),
    "few formats": AmplifierConfig(
        channels=4, tick_hz=999_983, rate_min_hz=1000, rate_max_hz=2000, fifo=128, carriers=1,
        formats=0b1010, packet_limit=136, fade_limit_us=0, slew_limit_v_per_s=6_000,
    ),
    "measures": AmplifierConfig(
        channels=5, rate_min_hz=1000, rate_max_hz=4000, fifo=260, carriers=2, packet_limit=140,
        slew_limit_v_per_s=90_000, sense_ranges_ua=(2500, 300, 65535),
        marker_lines=2,
    ),
}  # fmt: skip


LOADS_PF = (12_800, 0, 400_000, SHORT)
"""Loads of the channels of an amplifier that measures; the last of all that follow."""


class Loads:
    """Capacitors behind an amplifier, measured as `virtual-amplifier --load-pf` does.

    Parameters
    ----------
    config : configuration of the amplifier

    Attributes
    ----------
    rate : sample rate [Hz]
    """

    def __init__(self, config: AmplifierConfig) -> None:
        self.full_scale_uv, self.range_ua = config.full_scale_uv, config.sense_ranges_ua[0]
        loads = [*LOADS_PF, *[LOADS_PF[-1]] * config.channels][: config.channels]
        self.loads, self.rate = loads, 0
        self.last = self.before = [0] * config.channels

    def measure(self, codes: NDArray[np.int64], rate: int) -> NDArray[np.int64]:
        rows, self.rate = [], rate
        for row in codes.tolist():
            self.before, self.last = self.last, row
            rows.append([self._code(c) for c in range(len(row))])
        return np.array(rows)

    def readings(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        pairs = [self._reading(c) for c in range(len(self.loads))]
        volts, current = np.array(pairs).T
        return volts, current

    def choose(self, range_ua: int) -> None:
        self.range_ua = range_ua

    def _charging_fa(self, channel: int) -> int:
        """Return C dv/dt [fA]; divisions truncate as in C."""
        change = self.last[channel] - self.before[channel]
        uv_per_s = toward_zero(change * self.full_scale_uv, 32767) * self.rate
        return toward_zero(uv_per_s, 1000) * self.loads[channel]

    def _code(self, channel: int) -> int:
        if self.loads[channel] == SHORT:
            return 32767 * sign(self.last[channel])
        pa, full = toward_zero(self._charging_fa(channel), 1000), self.range_ua * 10**6
        return 32767 * sign(pa) if abs(pa) > full else toward_zero(pa * 32767, full)

    def _reading(self, channel: int) -> tuple[int, int]:
        last, before = self.last[channel], self.before[channel]
        if self.loads[channel] == SHORT:
            return 0, 32767 * sign(last)
        fa = self._charging_fa(channel)
        ua = toward_zero(fa + (-500_000_000 if fa < 0 else 500_000_000), 10**9)
        return toward_zero(last + before, 2), min(max(ua, -32767), 32767)


def sign(value: int) -> int:
    return (value > 0) - (value < 0)


def toward_zero(value: int, divisor: int) -> int:
    return sign(value) * (abs(value) // divisor)


class Record(NamedTuple):
    """Event: a packet came, a fault, the e-stop input moved, or time passed."""

    tick: int
    kind: int
    data: bytes = b""


def saved(records: Iterable[Record]) -> bytes:
    """Return a trace as `virtual-amplifier --replay` reads it."""
    return b"".join(RECORD.pack(r.tick, r.kind, len(r.data)) + r.data for r in records)


def packet(name: str, *fields: int, body: bytes = b"", node: int = 1, **head: int) -> bytes:
    """Return a packet by the name of its message; ``flags`` and ``seq`` go into its header."""
    kind, layout = KINDS[name]
    return sealed(kind, layout.pack(*fields) + body, node=node, **head)


def sealed(kind: int, payload: bytes, *, node: int, flags: int = 0x60, seq: int = 0) -> bytes:
    data = bytes([kind, flags, node, seq]) + payload
    return data + crc32(data).to_bytes(4, "little")


FIELDS = ("tick", "position", "state", "high_voltage", "codes")


def row_type(channels: int) -> np.dtype[Any]:
    return np.dtype(
        [("tick", "<u8"), ("position", "<u4"), ("state", "u1"), ("high_voltage", "u1"),
         ("codes", "<i2", (channels,))]
    )  # fmt: skip


class Rig:
    """A Python amplifier under trial.

    Parameters
    ----------
    config : configuration of the amplifier
    judged : hold everything against a `Judge`
    singly : put out instant by instant, not in runs
    """

    def __init__(
        self, config: AmplifierConfig, *, judged: bool = True, singly: bool = False
    ) -> None:
        self.config, self.singly, self.now = config, singly, 0
        self.loads = Loads(config) if config.sense_ranges_ua else None
        self.amplifier = ReferenceAmplifier(config, self.loads)
        self._take_rate()
        self.judge = Judge(config) if judged else None
        self.records: list[Record] = []
        self.sent: list[bytes] = []
        self.rows: list[NDArray[Any]] = []
        self.marks: list[Record] = []
        self._lines = 0
        self._state, self._high_voltage = State.IDLE, False
        self._counters = astuple(self.amplifier.counters)

    def _take_rate(self) -> None:
        """Let the loads know the sample rate, which changes while nothing is put out only."""
        if self.loads is not None:
            self.loads.rate = self.amplifier.rate

    def run(self, now: int) -> None:
        """Let time pass up to a tick, in pieces so that packets sent never wait long."""
        while self.now < now:
            due = self.amplifier.due()
            piece = due if self.singly else max(due, self.now + self.config.tick_hz // 10)
            self.now = min(now, piece)
            self.amplifier.run(self.now)
            self._take()

    def end(self) -> None:
        self.records.append(Record(self.now, RUN))

    def _settle(self) -> None:
        """Put out the instants up to now: a START may have set one."""
        self.amplifier.run(self.now)
        self._take()

    def feed(self, data: bytes, now: int) -> None:
        """Pass the bytes of a packet to the amplifier."""
        self.amplifier.run(now)
        packet = decode_packet(data, self.amplifier.counters, self.config.packet_limit)
        if packet is not None:
            self.amplifier.receive(packet, now)

    def packets(self) -> list[bytes]:
        """Return what the amplifier has sent since the last call."""
        return [encode_packet(packet) for packet in self.amplifier.take_sent()]

    def packet(self, data: bytes) -> None:
        self._settle()
        self.records.append(Record(self.now, PACKET, data))
        beyond = self.judge.packet(self.now, data) if self.judge else True
        future = self.amplifier.counters.future_samples
        self.feed(data, self.now)
        self._take_rate()
        assert beyond or self.amplifier.counters.future_samples == future
        self._take()

    def fault(self, code: int) -> None:
        self._settle()
        self.records.append(Record(self.now, FAULT, bytes([code])))
        if self.judge:
            self.judge.fault(code)
        self.amplifier.fault(code, self.now)
        self._take()

    def estop_input(self, contact_open: bool) -> None:
        self._settle()
        self.records.append(Record(self.now, INPUT, bytes([contact_open])))
        if self.judge:
            self.judge.estop_input(self.now, contact_open)
        self.amplifier.estop_input(contact_open, self.now)
        self._take()

    def _take(self) -> None:
        """Take what was put out and sent, and judge it."""
        played = self.amplifier.take_played()
        follow = [*(run.position for run in played[1:]), self.amplifier.position]
        rows = [self._expanded(run, at) for run, at in zip(played, follow, strict=False)]
        self._state = self.amplifier.state
        sent = self.packets()
        self.rows += rows
        self._mark(played)
        self.sent += sent
        assert len(sent) <= 256
        if self.judge is None:
            return
        for run in rows:
            for row in zip(*(run[name].tolist() for name in FIELDS), strict=True):
                self.judge.instant(*row)
        for data in sent:
            self.judge.sent(data, sum(map(len, rows)), self.now)
        self._compare(self.judge)

    def _mark(self, played: list[PlayedRun]) -> None:
        """Note changes of the marker lines, which come with the first instant of a run."""
        for run in played:
            if run.lines != self._lines:
                content = MARK_RECORD.pack(run.position, run.lines)
                self.marks.append(Record(int(run.ticks[0]), MARKS, content))
                self._lines = run.lines

    def _compare(self, judge: Judge) -> None:
        a, counters = self.amplifier, astuple(self.amplifier.counters)
        assert (a.state.name, a.session, a.node) == (judge.state, judge.session, judge.node)
        assert (a.position, a.due()) == (judge.position % TURN, judge.due)
        assert all(new >= old for new, old in zip(counters, self._counters, strict=True))
        self._counters = counters

    def _expanded(self, run: PlayedRun, following: int) -> NDArray[Any]:
        """Return a run with state and high voltage of each instant, not of the last alone.

        The position that follows tells whether it was held.
        """
        rows = np.zeros(len(run.codes), row_type(self.config.channels))
        rows["tick"], rows["codes"] = run.ticks, run.codes
        steps = 0 if following == run.position else np.arange(len(run.codes), dtype=np.int64)
        rows["position"] = (run.position + steps) % TURN
        rows["state"] = run.state
        if self._state in RAMPING and run.state in AFTER_RAMP:
            rows["state"][:-1] = State.RAMPDOWN
        powered = np.isin(rows["state"], POWERED)
        falling = (run.codes != 0).any(axis=1) & (self._high_voltage or self._state in POWERED)
        rows["high_voltage"] = powered | falling
        assert bool(rows["high_voltage"][-1]) == run.high_voltage
        self._state, self._high_voltage = run.state, run.high_voltage
        return rows

    def out(self) -> bytes:
        """Return what was put out, as `virtual-amplifier` writes it.

        After the records of ``--out`` come those of ``--sent`` for changes of the marker lines.
        """
        return np.concatenate(self.rows).tobytes() + saved(self.marks)

    def memory(self) -> int:
        """Return the bytes that the amplifier's state takes."""
        return len(pickle.dumps(self.amplifier))


def play(
    config: AmplifierConfig, records: Iterable[Record], *, judged: bool = True, singly: bool = False
) -> Rig:
    """Return a rig after a trace."""
    rig = Rig(config, judged=judged, singly=singly)
    for record in records:
        rig.run(record.tick)
        if record.kind == PACKET:
            rig.packet(record.data)
        elif record.kind == FAULT:
            rig.fault(record.data[0])
        elif record.kind == INPUT:
            rig.estop_input(record.data != b"\0")
    rig.end()
    return rig


# The amplifier in C


def replay(
    program: Path, config: AmplifierConfig, records: Iterable[Record], at: Path
) -> tuple[bytes, list[bytes]]:
    """Return what the amplifier in C puts out and sends on a trace; files go to a directory.

    What it puts out is in the form of `Rig.out`.
    """
    c = config
    options: dict[str, int | str] = {
        "channels": c.channels, "carriers": c.carriers, "formats": c.formats, "node": c.node,
        "packet-limit": c.packet_limit, "fifo": c.fifo, "tick-hz": c.tick_hz,
        "rate-min": c.rate_min_hz, "rate-max": c.rate_max_hz, "full-scale-uv": c.full_scale_uv,
        "voltage-limit-uv": c.voltage_limit_uv, "slew-v-per-s": c.slew_limit_v_per_s,
        "fade-us": c.fade_limit_us, "marker-lines": c.marker_lines,
    }  # fmt: skip
    if c.sense_ranges_ua:
        loads = ("short" if load == SHORT else str(load) for load in LOADS_PF)
        options |= {
            "sense-ranges-ua": ",".join(map(str, c.sense_ranges_ua)),
            "load-pf": ",".join(loads),
            "current-delay": c.current_delay,
        }
    arguments = [str(a) for name, value in options.items() for a in (f"--{name}", value)]
    out, sent = at / "out", at / "sent"
    files = ["--out", str(out), "--sent", str(sent)]
    subprocess.run(
        [str(program), "--replay", *files, *arguments], input=saved(records), check=True, timeout=60
    )
    written = loaded(sent.read_bytes())
    marks = saved(record for record in written if record.kind == MARKS)
    return out.read_bytes() + marks, [r.data for r in written if r.kind == PACKET]


def loaded(data: bytes) -> list[Record]:
    """Return the records of a file."""
    records, at = [], 0
    while at < len(data):
        tick, kind, size = RECORD.unpack_from(data, at)
        at += RECORD.size
        records.append(Record(tick, kind, data[at : at + size]))
        at += size
    return records
