"""Scene of an amplifier that measures currents, for the tests of sections 16 and 17 of SPEC.md."""

import struct
from collections.abc import Iterator
from random import Random
from typing import NamedTuple

import numpy as np
from protocol_traces import CONFIGS, Loads, Rig, packet

from firmware_protocol import messages as m
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.messages import State

OWNER = 0x1234
CORRELATION, VALUE, NAK = 0x49, 0x44, 0x41
CORRELATION_MS, SENSE_RANGE_UA, SENSE_MS = 8, 9, 3
MEASURES = CONFIGS["measures"]
RATE = 2000


class Entry(NamedTuple):
    """Entry of a channel, as section 16.3 defines it."""

    flags: int
    exponent: int
    energy: int
    sums: tuple[int, ...]


def rounded(value: int, exponent: int) -> int:
    """Return ⌊value / 2^exponent + ½⌋."""
    return (2 * value + (1 << exponent)) >> (exponent + 1)


def entry_of(played: dict[int, int], currents: dict[int, int]) -> Entry:
    """Return the entry of a channel by the definition of the sums, of values by position."""

    def code(n: int) -> int:
        return played.get(n % 2**32, 0)

    sums = [
        sum(i * (code(n - lag) - code(n - lag - 1)) for n, i in currents.items())
        for lag in range(16)
    ]
    exponent = next(e for e in range(60) if all(abs(rounded(r, e)) <= 32767 for r in sums))
    energy = sum(i * i for i in currents.values())
    x = next(x for x in range(60) if rounded(energy, x) <= 1023)
    clipped = any(abs(i) == 32767 for i in currents.values())
    codes = tuple(rounded(r, exponent) for r in sums)
    return Entry(int(clipped), exponent, x << 10 | rounded(energy, x), codes)


def column(rows: dict[int, list[int]], channel: int) -> dict[int, int]:
    """Return the values of a channel by position."""
    return {n: row[channel] for n, row in rows.items()}


class Change(NamedTuple):
    """Parameters from a tick on."""

    tick: int
    milliseconds: int
    range_ua: int


class Scene:
    """An amplifier that measures, and its host.

    Attributes
    ----------
    rig : amplifier and trace
    changes : parameters in the order in which they came into force
    """

    def __init__(self, config: AmplifierConfig = MEASURES, seed: int = 0) -> None:
        self.rig, self.rng = Rig(config), Random(seed)
        self.changes = [Change(0, 0, config.sense_ranges_ua[0])]
        self.sent_to = 0
        self.tell("HELLO", OWNER, 1, 0, 0)

    def tell(self, name: str, *fields: int, body: bytes = b"") -> None:
        self.rig.packet(packet(name, *fields, body=body))

    def set(self, parameter: int, value: int) -> None:
        """Set a parameter, to a value that is not in force."""
        self.tell("SET", OWNER, parameter, value)
        last = self.changes[-1]._replace(tick=self.rig.now)
        field = "milliseconds" if parameter == CORRELATION_MS else "range_ua"
        self.changes.append(last._replace(**{field: value}))

    def start(self, position: int = 0, *, delay_ms: int = 0, rate: int = RATE) -> None:
        self.tell("ARM", OWNER, 0, rate)
        self.tell("START", OWNER, position % 2**32, delay_ms, 0)
        self.sent_to = position

    def stream(self, milliseconds: int, *, loud: int = 32767, gaps: float = 0.0) -> None:
        """Send random samples a little ahead; some blocks are left out."""
        rig, channels = self.rig, self.rig.config.channels
        end = rig.now + milliseconds * rig.config.tick_hz // 1000
        while rig.now < end:
            self.tell("HEARTBEAT", OWNER)
            while (self.sent_to - rig.amplifier.position + 2**31) % 2**32 - 2**31 < 30:
                if self.rng.random() >= gaps:
                    codes = [self.rng.randint(-loud, loud) for _ in range(5 * channels)]
                    head = self.sent_to % 2**32, OWNER, 0, channels, 0, 5
                    self.tell("PCM", *head, body=struct.pack(f"<{len(codes)}h", *codes))
                    self.sent_to += 5
                else:
                    self.sent_to += self.rng.choice((5, 5, 100))
            rig.run(rig.now + 2 * rig.config.tick_hz // 1000)

    def wait(self, milliseconds: int) -> None:
        self.rig.run(self.rig.now + milliseconds * self.rig.config.tick_hz // 1000)

    def sent(self) -> list[m.Correlation]:
        """Return the CORRELATIONs that were sent."""
        found = [m.Correlation.unpack(p[4:-4]) for p in self.rig.sent if p[0] == CORRELATION]
        return [message for message in found if message is not None]

    def windows(self) -> Iterator[tuple[int, int, int, list[Entry]]]:
        """Yield position, range, length and entries of the windows that section 16 demands."""
        rows = np.concatenate(self.rig.rows)
        positions, states = rows["position"].tolist(), rows["state"].tolist()
        ticks, codes, config = rows["tick"].tolist(), rows["codes"].tolist(), self.rig.config
        loads, changes, rate = Loads(config), list(self.changes), self.rig.amplifier.rate
        present, played, late = changes.pop(0), dict[int, list[int]](), config.current_delay
        window: dict[int, list[int]] = {}
        length = 0
        for k, position in enumerate(positions):
            if changes and changes[0].tick < ticks[k]:
                while changes and changes[0].tick < ticks[k]:
                    present = changes.pop(0)
                window = {}
                loads.choose(present.range_ua)
            currents = loads.measure(np.array([codes[k]]), rate)[0].tolist()
            pending = k + 1 < len(positions) and positions[k + 1] == position
            if states[k] != State.RUNNING or pending:
                window, played = {}, {}
                continue
            played[position] = codes[k]
            if len(played) <= late:
                continue
            if not window:
                length = min(present.milliseconds * rate // 1000, 65535)
            if length:
                window[(position - late) % 2**32] = currents
            if length and len(window) == length:
                entries = [
                    entry_of(column(played, c), column(window, c)) for c in range(config.channels)
                ]
                yield next(iter(window)), present.range_ua, length, entries
                window = {}
