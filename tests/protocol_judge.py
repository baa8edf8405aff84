"""Judge of an amplifier: bounds on its behavior that are computed from SPEC.md alone.

The judge is told every packet and fault before the amplifier is, and every instant after it was put
out. It foresees states, session, limits, sample clock and position, and bounds the output; what the
output is within those bounds it leaves to others. The table of states is read from the document,
all arithmetic is on whole numbers, and nothing of the code under test is called.
"""

from collections.abc import Callable
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

from firmware_protocol.config import AmplifierConfig

SPEC = Path(__file__).parents[1] / "firmware_protocol" / "SPEC.md"
TURN = 1 << 32
WATCHDOG_MS, FADE_MS, SETTLED_MS = 150, 20, 50
POWERED = ("ARMED", "RUNNING", "RAMPDOWN")
LATCHED = ("FAULT", "ESTOP")
SETTLED = ("IDLE", "SAFE")
"""States in which the node may change (section 5)."""
BUSY, STATE, FAULT, INPUT_OPEN = 6, 7, 9, 18
"""Codes of NAK."""
HELLO, ESTOP, CLEAR_FAULT = 0x01, 0x08, 0x09
OF_INPUT = 255
"""Reason of an ESTOP that stands for the e-stop input."""
SESSION_FREE = ("HELLO", "TIME", "SYNC", "ESTOP", "GET", "IDENTIFY", "POLL")
LAYOUTS = {
    0x01: ("HELLO", Struct("<HBBI"), False),
    0x02: ("TIME", Struct("<Q"), False),
    0x03: ("SYNC", Struct("<B"), False),
    0x04: ("START", Struct("<HIBQ"), False),
    0x05: ("STOP", Struct("<HB"), False),
    0x06: ("ARM", Struct("<HBI"), False),
    0x07: ("DISARM", Struct("<H"), False),
    0x08: ("ESTOP", Struct("<B"), False),
    0x09: ("CLEAR_FAULT", Struct("<HI"), False),
    0x0A: ("HEARTBEAT", Struct("<H"), False),
    0x0B: ("LIMITS", Struct("<HIII"), False),
    0x0C: ("GET", Struct("<H"), False),
    0x0D: ("SET", Struct("<HHI"), False),
    0x0E: ("IDENTIFY", Struct("<B"), False),
    0x0F: ("POLL", Struct("<"), False),
    0x10: ("PCM", Struct("<IHBBBB"), True),
    0x11: ("CARRIERS", Struct("<HB"), True),
    0x12: ("SPECTRUM", Struct("<IHHBBBB"), True),
    0x13: ("GUARD", Struct("<HBB"), True),
    0x14: ("MARK", Struct("<HIBH"), False),
}
"""Name, fixed part, and whether a body follows (section 4)."""
STATUS = Struct("<4BHIQBQ3I")
"""Layout of STATUS without its counters."""
COUNTER = Struct("<I")
COUNTERS = 21
PULSE = Struct("<IBBBB")
NAK = Struct("<BBBBI")


def distance(a: int, b: int) -> int:
    """Return a − b of two positions (section 1)."""
    return (a - b + TURN // 2) % TURN - TURN // 2


def table_of_states() -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Return the states in their order, and by event what follows in each (section 6)."""
    rows = [
        [cell.strip() for cell in line.strip("|\n ").split("|")]
        for line in SPEC.read_text().splitlines()
        if line.startswith("|") and line.count("|") == 9
    ]
    at = next(k for k, row in enumerate(rows) if row[0] == "event")
    table = {row[0].partition(" (")[0]: tuple(row[1:]) for row in rows[at + 2 : at + 14]}
    return tuple(rows[at][1:]), table


STATES, TABLE = table_of_states()


class Limits(NamedTuple):
    """Limits in force (section 11.1)."""

    voltage_uv: int
    slew_v_per_s: int
    fade_us: int

    def code(self, full_scale_uv: int) -> int:
        return min(self.voltage_uv * 32767 // full_scale_uv, 32767)

    def step(self, full_scale_uv: int, rate: int) -> int:
        return min(self.slew_v_per_s * 32767 * 10**6 // (full_scale_uv * rate), 65534)

    def reach(self, full_scale_uv: int, rate: int) -> bool:
        """Return whether the limits reach 0 V in 20 ms."""
        return self.code(full_scale_uv) <= self.step(full_scale_uv, rate) * (rate // 50)

    def fade(self, rate: int) -> int:
        return max(1, (self.fade_us * rate + 500_000) // 1_000_000)


def ramp_bound(limit: int, step: int, fade: int, k: int, last: int) -> int:
    """Return what an output that was at most ``last`` may be at instant k of RAMPDOWN.

    The gain of the limit bounds what is wanted; what is beyond that comes nearer by a step.
    """
    wanted = limit * max(fade - 1 - k, 0) // fade
    return max(wanted, last - step, 0)


class Judge:
    """Model of what an amplifier has to be after the messages that it received.

    Attributes
    ----------
    state, session, limits, node : values that the amplifier must have
    position, due : position and tick of the next instant
    heard : tick of the last HEARTBEAT or ARM
    alive : tick of the owner's last HEARTBEAT or ARM, which a new session forgets
    trips : ESTOPs, faults of the hardware and openings of the e-stop input so far
    contact_open, closed : the contact of the e-stop input, and the tick from which it was closed
    reason : reason of the latest ESTOP
    instants : how many were judged
    gain : largest gain that may have been reached since START, in `fade` instants
    """

    def __init__(self, config: AmplifierConfig) -> None:
        c = self.config = config
        self.state, self.then, self.session, self.node = "IDLE", "IDLE", 0, c.node
        self.hardware = Limits(c.voltage_limit_uv, c.slew_limit_v_per_s, c.fade_limit_us)
        self.limits, self.mode, self.carriers = self.hardware, 0, 0
        self.rate = min(max(8000, c.rate_min_hz), c.rate_max_hz)
        self.base = self.k = self.position = self.instants = 0
        self.start_tick: int | None = None
        self.start_position = 0
        self.heard, self.watched, self.addressed = 0, False, False
        self.alive: int | None = None
        self.high_voltage, self.quick = False, False
        self.fed = [False] * c.channels
        self.kept: dict[int, int] = {}
        self.newest = [0] * c.channels
        self.joined, self.gain = False, 0
        self.fault_now = self.ramped = self.bound = self.trips = 0
        self.contact_open, self.reason = False, 0
        self.closed: int | None = None
        self.answer: tuple[int, int] | None = None
        self.seq: int | None = None
        self.codes = [0] * c.channels
        self.credit: int | None = None
        self.counters: list[int] = []

    # What it is told

    def fault(self, code: int) -> None:
        self.fault_now = code
        if code:
            self.trips += 1
            self._follow("fault of the hardware")

    def estop_input(self, tick: int, contact_open: bool) -> None:
        if contact_open and not self.contact_open:
            self.trips, self.reason = self.trips + 1, OF_INPUT
            self._follow("e-stop input opens")
        elif self.contact_open and not contact_open:
            self.closed = tick
        self.contact_open = contact_open

    def _input_open(self, tick: int) -> bool:
        """Return whether the input counts as open (6.3)."""
        enough = SETTLED_MS * self.config.tick_hz
        recent = self.closed is not None and (tick - self.closed) * 1000 < enough
        return self.contact_open or recent

    def packet(self, tick: int, data: bytes) -> bool:
        """Foresee what a packet does; return whether it may have been too early for the buffer."""
        self.answer = None
        if not 8 <= len(data) <= self.config.packet_limit:
            return True
        if crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
            return True
        kind, flags, node, _ = data[:4]
        if node not in (0, self.node) or kind not in LAYOUTS:
            return True
        if kind != ESTOP and flags & 0xD8 != 0x40:
            return True
        self.addressed = node != 0
        name, layout, has_body = LAYOUTS[kind]
        payload = data[4:-4]
        if has_body and len(payload) < layout.size:
            return True
        fields = layout.unpack(payload[: layout.size].ljust(layout.size, b"\0"))
        if name not in SESSION_FREE:
            token = fields[1 if name in ("PCM", "SPECTRUM") else 0]
            if not token or token != self.session:
                return True
        act: Callable[..., Any] | None = getattr(self, "_" + name.lower(), None)
        if act is not None:
            act(tick, fields, max(len(payload) - layout.size, 0))
        return name != "PCM" or not self._within_credit(fields)

    def _within_credit(self, pcm: tuple[int, ...]) -> bool:
        """Return whether all samples of a packet lie before the credit since START."""
        position, _, _, _, _, samples = pcm
        ahead = distance(position, self.position)
        return self.credit is not None and self.position + ahead + samples <= self.credit

    def _cell(self, event: str) -> str:
        return TABLE[event][STATES.index(self.state)]

    def _follow(self, event: str) -> bool:
        """Follow the table of states; return whether it forbids nothing."""
        cell = self._cell(event)
        if cell.startswith("!"):
            return False
        if cell != "=":
            before = self.state
            self.state, _, then = cell.partition(":")
            self.then = then or self.state
            if self.state == "RAMPDOWN" != before:
                self.ramped, self.quick = 0, False
                self.bound = max(map(abs, self.codes))
            if self.state != "RUNNING":
                self.start_tick = None
        return True

    def _hello(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        token, major, _, _ = fields
        if token in (0, self.session):
            return
        lives = self.alive is not None and (tick - self.alive) * 1000 < self._watchdog
        if self._cell("HELLO of another session").startswith("!") or any(self.codes) or lives:
            self.answer = BUSY, 0
        elif major == 1:
            self.session, self.limits, self.carriers = token, self.hardware, 0
            self.alive = None

    def _arm(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        _, mode, rate = fields
        c = self.config
        if self._cell("ARM").startswith("!") or mode > 1:
            return
        in_range = c.rate_min_hz <= rate <= c.rate_max_hz
        if in_range and self.limits.reach(c.full_scale_uv, rate):
            if rate != self.rate:
                self.base, self.k, self.rate = tick, 0, rate
            self.mode, self.heard, self.watched = mode, tick, True
            self.alive = tick
            self._follow("ARM")

    def _start(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        _, position, delay_ms, time = fields
        hz = self.config.tick_hz
        if self._cell("START").startswith("!") or (self.mode == 1 and not self.carriers):
            return
        if time and not tick <= time <= tick + 10 * hz:
            return
        self._follow("START")
        self.start_tick = time or tick + delay_ms * hz // 1000
        self.start_position = self.position = position
        self.fed, self.credit = [False] * self.config.channels, None
        self.kept, self.newest = {}, [position] * self.config.channels
        self.joined, self.gain = False, 0

    def _stop(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        self._follow("STOP")
        self.quick |= self.state == "RAMPDOWN" and fields[1] != 0

    def _disarm(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        self._follow("DISARM")

    def _estop(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        self.trips, self.reason = self.trips + 1, fields[0] % OF_INPUT
        self._follow("ESTOP")

    def _clear_fault(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        if self.state not in LATCHED:
            return
        if fields[1] != self.trips % TURN:
            self.answer = STATE, self.trips % TURN
        elif any(self.codes):
            self.answer = STATE, 0
        elif self._input_open(tick):
            self.answer = INPUT_OPEN, 0
        elif self.fault_now:
            self.answer = FAULT, self.fault_now
        else:
            self._follow("CLEAR_FAULT")

    def _heartbeat(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        self.heard, self.alive, self.watched = tick, tick, True

    def _limits(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        old = self.limits
        new = Limits(*(a or b for a, b in zip(fields[1:], old, strict=True)))
        lower = all(a <= b for a, b in zip(new, old, strict=True))
        in_time = new.reach(self.config.full_scale_uv, self.rate)
        if lower and in_time and not any(self.codes) and self._follow("LIMITS"):
            self.limits = new

    def _set(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        _, parameter, value = fields
        if parameter == 1 and 1 <= value <= 127 and self.state in SETTLED and self.addressed:
            self.node = value

    def _pcm(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        position, _, first, channels, kind, samples = fields
        if self.mode or kind > 2 or not samples:
            return
        count = samples * channels
        size = (2 * count, (3 * count + 1) // 2, channels * (samples - samples // -32))[kind]
        ahead = distance(position, self.position)
        kept = ahead < self.config.fifo and ahead + samples > 0
        if body == size and kept and self._feed(kind, first, channels):
            bits = (1 << channels) - 1 << first
            for at in range(max(ahead, 0), min(ahead + samples, self.config.fifo)):
                self.kept[self.position + at] = self.kept.get(self.position + at, 0) | bits

    def _spectrum(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        position, _, _, first, channels, kind, carriers = fields
        ahead = distance(position, self.position)
        right = self.mode == 1 and kind == 3 and carriers == self.carriers
        kept = 0 < ahead < self.config.fifo
        if right and body == 2 * channels * carriers and kept and self._feed(kind, first, channels):
            for channel in range(first, first + channels):
                self.newest[channel] = max(self.newest[channel], self.position + ahead)

    def _feed(self, kind: int, first: int, channels: int) -> bool:
        """Let channels be active (8.2), and return whether: something may have been kept."""
        c = self.config
        if not (self.state == "RUNNING" and c.formats >> kind & 1):
            return False
        if first + channels > c.channels:
            return False
        self.fed[first : first + channels] = [True] * channels
        return True

    def _carriers(self, tick: int, fields: tuple[int, ...], body: int) -> None:
        _, count = fields
        if not self._cell("CARRIERS").startswith("!") and body == 4 * count:
            self.carriers = count if 1 <= count <= self.config.carriers else self.carriers

    # What it does

    @property
    def _watchdog(self) -> int:
        """Return what a thousand times the ticks since the owner was heard is compared with."""
        return WATCHDOG_MS * self.config.tick_hz

    @property
    def due(self) -> int:
        """Return the tick of the next instant (7.1)."""
        tick = self.base + (self.k + 1) * self.config.tick_hz // self.rate
        return tick if self.start_tick is None else min(tick, self.start_tick)

    def instant(
        self, tick: int, position: int, state: int, high_voltage: int, codes: list[int]
    ) -> None:
        """Judge an instant, with what was put out and how it left state and high voltage."""
        assert tick == self.due
        waiting = False
        if tick == self.start_tick:
            self.base, self.k, self.start_tick = tick, 0, None
        else:
            self.k, waiting = self.k + 1, self.start_tick is not None
        assert position == self.position % TURN
        self.position += not waiting
        silent = (tick - self.heard) * 1000 >= self._watchdog
        if self.watched and silent and self.state in POWERED:
            self.watched = False
            self._follow("watchdog")
        self._move_gain(waiting)
        self._judge_codes(codes, waiting)
        self._judge_state(STATES[state], codes)
        assert self.state == "ESTOP" or not self._input_open(tick)
        self.codes = codes
        powered = self.state in POWERED
        self.high_voltage = powered or (self.high_voltage and any(codes))
        assert high_voltage == self.high_voltage
        self._judge_deadline(tick)
        self.instants += 1

    def _move_gain(self, waiting: bool) -> None:
        """Update the largest gain that is possible (8.3); a host that is late fades in."""
        if self.state != "RUNNING" or waiting:
            return
        n = self.position - 1
        late = n != self.start_position
        if not self.joined and self._may_join(n):
            self.joined, self.gain = True, 0 if late else self.limits.fade(self.rate)
        self.gain = min(self.gain + self.joined, self.limits.fade(self.rate))
        self.kept.pop(n, None)

    def _may_join(self, n: int) -> bool:
        """Return whether WAITING may end at a position; that a queue was full is not foreseen."""
        if self.mode:
            ready = [newest > n for newest in self.newest]
        else:
            ready = [bool(self.kept.get(n, 0) >> c & 1) for c in range(self.config.channels)]
        return any(self.fed) and all(r or not f for r, f in zip(ready, self.fed, strict=True))

    def _judge_codes(self, codes: list[int], waiting: bool) -> None:
        limit = self.limits.code(self.config.full_scale_uv)
        step = self.limits.step(self.config.full_scale_uv, self.rate)
        for last, code, fed in zip(self.codes, codes, self.fed, strict=True):
            assert abs(code - last) <= step
            assert abs(code) <= limit
            if self.state in LATCHED:
                assert code == max(abs(last) - step, 0) * (1 if last > 0 else -1)
            assert fed or not code
            if self.state == "RUNNING":
                assert abs(code) <= limit * self.gain // self.limits.fade(self.rate)
        if self.state not in (*LATCHED, "RUNNING", "RAMPDOWN") or waiting:
            assert not any(codes)
        if self.state == "RAMPDOWN":
            fade = 1 if self.quick else self.limits.fade(self.rate)
            self.bound = ramp_bound(limit, step, fade, self.ramped, self.bound)
            self.ramped += 1
            assert max(map(abs, codes)) <= self.bound

    def _judge_state(self, state: str, codes: list[int]) -> None:
        fade = self.limits.fade(self.rate)
        if self.state == "RAMPDOWN" and not any(codes):
            over = self.quick or self.ramped >= fade
            assert state == self.then or (state == self.state and not over)
            self.state = state
        assert state == self.state

    def _judge_deadline(self, tick: int) -> None:
        """Check that all is at 0 V 150 ms, 20 ms and an instant after the last heartbeat."""
        if self.high_voltage or any(self.codes):
            since, rate = tick - self.heard - 1, self.rate
            most = (WATCHDOG_MS + FADE_MS) * rate + 1000
            assert since * 1000 * rate < most * self.config.tick_hz

    # What it says

    def sent(self, data: bytes, instants: int, now: int) -> None:
        """Judge a packet of the amplifier, sent in the last so many instants before a tick."""
        assert crc32(data[:-4]) == int.from_bytes(data[-4:], "little")
        kind, payload = data[0], data[4:-4]
        assert self.seq in (None, data[3])
        self.seq = (data[3] + 1) & 0xFF
        assert self.session or kind not in (0x45, 0x48)
        if kind == 0x45:
            credit, state, *_ = PULSE.unpack(payload)
            ahead = distance(credit, self.position)
            assert -instants <= ahead - self.config.fifo <= 0
            assert state < len(STATES)
            self.credit = self.position + ahead
        if kind == 0x42:
            assert int.from_bytes(payload[:2], "little") == self.session
            assert self.answer is None
        if kind in (0x40, 0x41) and payload[0] in (HELLO, CLEAR_FAULT):
            self._judge_answer(kind, payload)
        if kind == 0x46:
            state, _, _, reason, session, position, due, _, _, *limits = STATUS.unpack_from(payload)
            counters = [n for (n,) in COUNTER.iter_unpack(payload[STATUS.size : -1])]
            assert (STATES[state], session) == (self.state, self.session)
            assert (reason, payload[-1]) == (self.reason, self._input_open(now))
            assert (position, due) == (self.position % TURN, self.start_tick or self.due)
            assert tuple(limits) == self.limits
            assert len(counters) == COUNTERS
            assert counters[-1] == self.trips % TURN
            assert all(a >= b for a, b in zip(counters, self.counters, strict=False))
            self.counters = counters

    def _judge_answer(self, kind: int, payload: bytes) -> None:
        """Judge ACK or NAK of the packet that came last."""
        code, detail = (0, 0) if kind == 0x40 else NAK.unpack(payload)[2::2]
        if code in (0, BUSY, STATE, FAULT, INPUT_OPEN):
            assert (code, detail) == (self.answer or (0, 0))
        if kind == 0x41:
            assert STATES[payload[3]] == self.state
