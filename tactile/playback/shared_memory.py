"""Memory that the server and one playback process share: contacts go one way, a report the other.

Neither ever waits for the other. Contacts are a ring of entries, each with a number that is odd
while it is written (a sequence lock), so that a reader takes every whole one and knows how many it
missed. The report is one such entry, the latest. A trace tells which contacts each of the latest
blocks was rendered from, and when it is put out.

On Linux it is a memfd that the child inherits, of which nothing can be left behind; elsewhere a
file in the folder for temporary ones, which the server removes. A kill at any instant leaves at
worst one entry unfinished, which no reader takes.
"""

import mmap
import os
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from tactile.bus.base import BusCounters

CONTACTS, TRACES = 256, 8192
"""Entries of the rings: a quarter of a second at 1 kHz, and 16 s of blocks."""
DETAIL = 240
"""Bytes of its line."""


@dataclass
class PlaybackCounters(BusCounters):
    """Counters of one display's playback since it began, besides those of its bus.

    Attributes
    ----------
    limited_samples : samples that the limiter changed, or frames on a link that takes frames
    late_contacts, invalid_contacts : contacts that came too late or were not finite
    lost_contacts : contacts that were overwritten before playback read them
    skipped_samples : positions that playback left out because it was late
    dropped_waves : blocks of a client's waveforms, and transients, for which there was no time
    """

    limited_samples: int = 0
    late_contacts: int = 0
    invalid_contacts: int = 0
    lost_contacts: int = 0
    skipped_samples: int = 0
    dropped_waves: int = 0


COUNTERS = tuple(counter.name for counter in fields(PlaybackCounters))
"""Names of the counters, in the order of the report."""
NUMBER = struct.Struct("<Q")
CONTACT = struct.Struct("<QQddddddd?")
TRACE = struct.Struct("<QQQdd")
REPORT = struct.Struct(f"<Qd4BQ7d{len(COUNTERS)}Q{DETAIL}s")
HEADS = 64
"""Bytes before the rings: how many contacts and traces were written, the report's number, and how
many heartbeats of the server."""
AT_CONTACTS = HEADS
AT_TRACES = AT_CONTACTS + 128 * CONTACTS
AT_REPORT = AT_TRACES + 64 * TRACES
AT_ARRAYS = AT_REPORT + 1024
Ring = tuple[int, int, int, struct.Struct, int]
"""Where it begins, bytes and number of its entries, their form, and where their count is."""
CONTACT_RING: Ring = (AT_CONTACTS, 128, CONTACTS, CONTACT, 0)
TRACE_RING: Ring = (AT_TRACES, 64, TRACES, TRACE, 8)
State = Literal["disarmed", "armed", "estopped"]
STATES: tuple[State, ...] = get_args(State)


class Touch(NamedTuple):
    """A contact: of which client, when on the host's clock [s], where [m], how fast and hard."""

    client: int
    time: float
    arrival: float
    x: float
    y: float
    vx: float
    vy: float
    normal_force: float
    has_velocity: bool


class BlockTrace(NamedTuple):
    """A block: its position, contacts that had come, when it was rendered and when it is due."""

    position: int
    contacts: int
    time: float
    due: float


@dataclass
class PlaybackReport:
    """What a playback process tells of itself."""

    blocks: int = 0
    time: float = 0.0
    state: State = "disarmed"
    link: str = "down"
    running: bool = False
    touching: bool = False
    client: int = 0
    position: tuple[float, float] = (0.0, 0.0)
    velocity: tuple[float, float] = (0.0, 0.0)
    normal_force: float = 0.0
    sample_rate: float = 0.0
    latency: float = 0.0
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    detail: str = ""


class Shared:
    """The memory, mapped.

    Parameters
    ----------
    handle : of the memory, as its creator tells
    contactors : N
    """

    def __init__(self, handle: str, contactors: int) -> None:
        self.handle, kind = handle, handle.partition(":")[0]
        what = handle.partition(":")[2]
        descriptor = int(what) if kind == "fd" else os.open(what, os.O_RDWR)
        size = AT_ARRAYS + 8 * contactors
        self._map = mmap.mmap(descriptor, size)
        if kind != "fd":
            os.close(descriptor)
        arrays = np.frombuffer(self._map, np.float32, 2 * contactors, AT_ARRAYS)
        self.shear: NDArray[np.float32] = arrays[:contactors]
        self.drive: NDArray[np.float32] = arrays[contactors:]
        self._read = self._contact = self._trace = self._reported = 0
        self.lost_contacts = 0

    @classmethod
    def create(cls, contactors: int) -> "Shared":
        """Return new memory, all zero."""
        size = AT_ARRAYS + 8 * contactors
        if sys.platform == "linux":
            descriptor = os.memfd_create("tactile")
            handle = f"fd:{descriptor}"
        else:
            descriptor, name = tempfile.mkstemp(prefix="tactile-")
            handle = f"file:{name}"
        os.ftruncate(descriptor, size)
        if sys.platform != "linux":
            os.close(descriptor)
        return cls(handle, contactors)

    @property
    def descriptor(self) -> int | None:
        """What a child has to inherit."""
        kind, _, number = self.handle.partition(":")
        return int(number) if kind == "fd" else None

    def close(self) -> None:
        """Let go of it; who created it on other systems than Linux removes it by that."""
        self.shear = self.drive = np.zeros(0, np.float32)
        with suppress(BufferError):
            self._map.close()
        kind, _, what = self.handle.partition(":")
        with suppress(OSError):
            if kind == "fd":
                os.close(int(what))
            else:
                Path(what).unlink()

    # Signs of life

    def beat(self) -> None:
        """Give a sign of life of the server."""
        NUMBER.pack_into(self._map, 24, self.beats + 1)

    @property
    def beats(self) -> int:
        """Number of signs of life that the server has given."""
        return int(NUMBER.unpack_from(self._map, 24)[0])

    # Contacts

    def write_contact(self, touch: Touch) -> int:
        """Add a contact; return how many there have been."""
        self._contact = self._put(CONTACT_RING, self._contact, touch)
        return self._contact

    def contacts(self) -> Iterator[Touch]:
        """Yield the contacts that came since the last call."""
        head = NUMBER.unpack_from(self._map, 0)[0]
        first = max(self._read, head - CONTACTS + 8)
        self.lost_contacts += first - self._read
        self._read = head
        for n in range(first, head):
            found = CONTACT.unpack_from(self._map, AT_CONTACTS + 128 * (n % CONTACTS))
            if found[0] == 2 * n + 2:
                yield Touch(*found[1:])
            else:
                self.lost_contacts += 1

    @property
    def contacts_read(self) -> int:
        """How many contacts the reader has seen or missed."""
        return self._read

    def _put(self, ring: Ring, n: int, row: tuple[object, ...]) -> int:
        at, size, slots, form, head = ring
        place = at + size * (n % slots)
        NUMBER.pack_into(self._map, place, 2 * n + 1)
        form.pack_into(self._map, place, 2 * n + 1, *row)
        NUMBER.pack_into(self._map, place, 2 * n + 2)
        NUMBER.pack_into(self._map, head, n + 1)
        return n + 1

    # Traces

    def write_trace(self, trace: BlockTrace) -> None:
        """Add a block's trace."""
        self._trace = self._put(TRACE_RING, self._trace, trace)

    def traces(self, first: int) -> tuple[int, list[BlockTrace]]:
        """Return the traces from number ``first`` on that are still there, and the next number."""
        head = NUMBER.unpack_from(self._map, 8)[0]
        found = []
        for n in range(max(first, head - TRACES + 64), head):
            row = TRACE.unpack_from(self._map, AT_TRACES + 64 * (n % TRACES))
            if row[0] == 2 * n + 2:
                found.append(BlockTrace(*row[1:]))
        return head, found

    # The report

    def write_report(self, r: PlaybackReport) -> None:
        """Replace the report."""
        self._reported += 1
        NUMBER.pack_into(self._map, 16, 2 * self._reported - 1)
        REPORT.pack_into(
            self._map, AT_REPORT, r.blocks, r.time, STATES.index(r.state), r.link == "up",
            r.running, r.touching, r.client, *r.position, *r.velocity, r.normal_force,
            r.sample_rate, r.latency, *(r.counters[name] for name in COUNTERS),
            r.detail.encode()[:DETAIL],
        )  # fmt: skip
        NUMBER.pack_into(self._map, 16, 2 * self._reported)

    def report(self) -> PlaybackReport:
        """Return the latest whole report; that of a process that died while it wrote as it is."""
        for _ in range(100):
            before = NUMBER.unpack_from(self._map, 16)[0]
            row = REPORT.unpack_from(self._map, AT_REPORT)
            if before % 2 == 0 and before == NUMBER.unpack_from(self._map, 16)[0]:
                break
        counters = dict(zip(COUNTERS, row[-len(COUNTERS) - 1 : -1], strict=True))
        blocks, time, state, link, running, touching, client, *rest = row[: -len(COUNTERS) - 1]
        x, y, vx, vy, force, rate, late = rest
        return PlaybackReport(
            blocks, time, STATES[state], "up" if link else "down", bool(running), bool(touching),
            client, (x, y), (vx, vy), force, rate, late, counters,
            row[-1].rstrip(b"\0").decode(errors="replace"),
        )  # fmt: skip
