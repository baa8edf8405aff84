"""Memory that the server and one playback process share: contacts go one way, a report the other.

Neither side ever waits for the other. Contacts are a ring of entries, each with a number that is
odd while the entry is written (a sequence lock), so that a reader takes only complete entries and
knows how many it missed. The report is a single such entry, the latest. Shear and drive are in
rings of their own (`SampleRing`), as are the blocks in which they were played (`BlockRing`).

On Linux the memory is a memfd that the child inherits, which leaves nothing behind; elsewhere it is
a file in the folder for temporary files, which the server removes. A kill at any instant leaves at
worst one unfinished entry, which no reader takes.
"""

import math
import mmap
import os
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tactile.bus.base import BusCounters
from tactile.playback.block_ring import BLOCKS, ROW, BlockRing
from tactile.playback.followed_finger import FollowedFinger
from tactile.playback.sample_ring import LENGTH, NUMBER, SampleRing
from tactile.tracking.finger_sample import FingerSample, rounded

CONTACTS = 256
"""Length of the ring of contacts: a quarter of a second at 1 kHz [entries]."""
DETAIL = 240
"""Space for the line of detail of a report [bytes]."""


@dataclass
class PlaybackCounters(BusCounters):
    """Counters of one display's playback since it began, in addition to those of its bus.

    Attributes
    ----------
    limited_samples : int
        Number of samples that the limiter changed, or of frames on a link that takes frames.
    late_contacts : int
        Number of contacts that came too late.
    invalid_contacts : int
        Number of contacts that were not finite or out of range.
    lost_contacts : int
        Number of contacts that were overwritten before playback read them.
    skipped_samples : int
        Number of positions that playback left out because it was late.
    dropped_waves : int
        Number of blocks of a client's waves, and of transients, for which there was no time.
    dropped_frames : int
        Number of tactile frames that were not played.
    frame_gaps : int
        Number of times that tactile frames came too late, so that the one before them was held.
    finger_windows, dropped_finger_windows : int
        Number of windows of current from which loads were estimated, and of those that could not be
        used.
    touched_contactors, lifted_contactors : int
        Number of times that a contactor was touched, and that it lost its finger.
    unexplained_loads : int
        Number of contactors in windows whose current no load explained.
    guarded_contactors : int
        Number of times that a guard in an amplifier turned a contactor down.
    """

    limited_samples: int = 0
    late_contacts: int = 0
    invalid_contacts: int = 0
    lost_contacts: int = 0
    skipped_samples: int = 0
    dropped_waves: int = 0
    dropped_frames: int = 0
    frame_gaps: int = 0
    finger_windows: int = 0
    dropped_finger_windows: int = 0
    touched_contactors: int = 0
    lifted_contactors: int = 0
    unexplained_loads: int = 0
    guarded_contactors: int = 0


COUNTERS = tuple(counter.name for counter in fields(PlaybackCounters))
"""Names of the counters, in the order of the report."""
CONTACT = struct.Struct("<QQddddd?dd")
"""Format of an entry of the ring of contacts: its number, the client, and a `FingerSample`, in
which a flag tells whether there is a velocity."""
CONTACT_SPACE = 128
"""Distance between two entries of the ring of contacts [bytes]."""
REPORT = struct.Struct(f"<Qd5BQ8d{len(COUNTERS)}Q{DETAIL}s")
"""Format of the report."""
AT_HEAD, AT_REPORTED, AT_BEATS, AT_COMMANDED, AT_PLAYED, AT_DRIVE, AT_BLOCK_COUNT = range(0, 56, 8)
"""Offsets of the number of contacts that were written, the number of the report, the number of
heartbeats of the server, and the numbers of samples of commanded shear, played shear and drive, and
of blocks [bytes]."""
AT_CONTACTS = 64
"""Offset of the ring of contacts [bytes]."""
AT_REPORT = AT_CONTACTS + CONTACT_SPACE * CONTACTS
"""Offset of the report [bytes]."""
AT_BLOCKS = AT_REPORT + 1024
"""Offset of the ring of blocks [bytes]."""
AT_ARRAYS = AT_BLOCKS + BLOCKS * ROW.itemsize
"""Offset of the arrays of shear and drive, of those of the finger, and of the rings of samples
[bytes]."""
FOLLOWED = 5
"""Number of values that are told of each contactor's load, the attributes of `FollowedFinger`."""
ROWS = 2 + FOLLOWED + 3 * LENGTH
"""Number of values of each contactor."""
State = Literal["disarmed", "armed", "estopped"]
"""State of playback."""
STATES: tuple[State, ...] = get_args(State)
"""All states, in the order of their codes in the report."""


@dataclass
class PlaybackReport:
    """Report of a playback process on itself.

    Attributes
    ----------
    blocks : int
        Number of blocks that were played.
    time : float
        Time of the report, in the host's clock [s].
    state : State
        State of playback.
    link : str
        "up" or "down".
    running : bool
        Whether there are blocks to play.
    touching : bool
        Whether the finger touches the surface.
    client : int
        Number of the client to which the finger belongs.
    position : tuple of 2 floats
        Position of the finger [m].
    velocity : tuple of 2 floats
        Velocity of the finger [m/s].
    normal_force : float
        Normal force [N].
    sample_rate : float
        Sample rate of the drive [Hz].
    latency : float
        Mean time from the arrival of a contact to the output of the first sample that it affects,
        whether or not any arrives; NaN while nothing plays [s].
    put_out_share : float
        Share that was put out of what was due since playing began, from 0 to 1, as far as the
        amplifiers have reported; NaN if nothing was due.
    counters : dict of str to int
        Value of each counter.
    detail : str
        One line on what is wrong; empty if nothing is.
    finger : FollowedFinger or None
        Loads of the contactors; None if they are not known.
    """

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
    latency: float = math.nan
    put_out_share: float = math.nan
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    detail: str = ""
    finger: FollowedFinger | None = field(default=None, compare=False)


class SharedFile:
    """File of shared memory, mapped into the process.

    Parameters
    ----------
    handle : str
        Handle of the memory, from the process that created it.
    size : int
        Size of the memory [bytes].

    Attributes
    ----------
    handle : str
        Handle of the memory, "fd:" with a descriptor or "file:" with a path.
    """

    def __init__(self, handle: str, size: int) -> None:
        self.handle = handle
        kind, _, target = handle.partition(":")
        descriptor = int(target) if kind == "fd" else os.open(target, os.O_RDWR)
        self._map = mmap.mmap(descriptor, size)
        if kind != "fd":
            os.close(descriptor)

    @staticmethod
    def new_file(size: int) -> str:
        """Create memory full of zeros.

        Parameters
        ----------
        size : int
            Size of the memory [bytes].

        Returns
        -------
        str
            Handle of the memory.
        """
        if sys.platform == "linux":
            descriptor = os.memfd_create("tactile")
            handle = f"fd:{descriptor}"
        else:
            descriptor, name = tempfile.mkstemp(prefix="tactile-")
            handle = f"file:{name}"
        os.ftruncate(descriptor, size)
        if sys.platform != "linux":
            os.close(descriptor)
        return handle

    @property
    def descriptor(self) -> int | None:
        """Descriptor that a child process has to inherit; None for a file."""
        kind, _, number = self.handle.partition(":")
        return int(number) if kind == "fd" else None

    def close(self) -> None:
        """Release the memory; on systems other than Linux this also removes its file."""
        with suppress(BufferError):
            self._map.close()
        kind, _, target = self.handle.partition(":")
        with suppress(OSError):
            if kind == "fd":
                os.close(int(target))
            else:
                Path(target).unlink()


class PlaybackMemory(SharedFile):
    """Shared memory of a display: contacts, signs of life and the report.

    Parameters
    ----------
    handle : str
        Handle of the memory, from the process that created it.
    contactors : int
        Number of contactors, N.

    Attributes
    ----------
    shear : (N,) array of float32
        Last commanded shear [m].
    drive : (N,) array of float32
        Last drive [V].
    commanded : SampleRing
        Commanded shear, sample by sample.
    played : SampleRing
        Shear of the skin, which only a simulated display knows.
    driven : SampleRing
        Drive that commands the shear, sample by sample.
    blocks : BlockRing
        Blocks to which the samples of ``commanded`` and ``driven`` belong.
    lost_contacts : int
        Number of contacts that were overwritten before they were read.
    """

    def __init__(self, handle: str, contactors: int) -> None:
        super().__init__(handle, _size(contactors))
        rows = np.frombuffer(self._map, np.float32, ROWS * contactors, AT_ARRAYS)
        arrays = rows.reshape(-1, contactors)
        self.shear: NDArray[np.float32] = arrays[0]
        self.drive: NDArray[np.float32] = arrays[1]
        self._finger: NDArray[np.float32] = arrays[2 : 2 + FOLLOWED]
        rings = arrays[2 + FOLLOWED :].reshape(3, LENGTH, contactors)
        self.commanded = SampleRing(self._map, AT_COMMANDED, rings[0])
        self.played = SampleRing(self._map, AT_PLAYED, rings[1])
        self.driven = SampleRing(self._map, AT_DRIVE, rings[2])
        self.blocks = BlockRing(self._map, AT_BLOCK_COUNT, AT_BLOCKS)
        self._read = self._written = self._reported = 0
        self.lost_contacts = 0

    @classmethod
    def create(cls, contactors: int) -> "PlaybackMemory":
        """Create memory without contacts, with the report of a display that has not played.

        Parameters
        ----------
        contactors : int
            Number of contactors, N.

        Returns
        -------
        PlaybackMemory
            New memory.
        """
        memory = cls(cls.new_file(_size(contactors)), contactors)
        memory.write_report(PlaybackReport())
        return memory

    def close(self) -> None:
        """Release the memory, as `SharedFile.close` does."""
        self.shear = self.drive = self._finger = np.zeros(0, np.float32)
        for ring in (self.commanded, self.played, self.driven, self.blocks):
            ring.close()
        super().close()

    # Signs of life

    def beat(self) -> None:
        """Count one more sign of life of the server."""
        NUMBER.pack_into(self._map, AT_BEATS, self.beats + 1)

    @property
    def beats(self) -> int:
        """Number of signs of life that the server has given."""
        return int(NUMBER.unpack_from(self._map, AT_BEATS)[0])

    # Contacts

    def write_contact(self, client: int, sample: FingerSample) -> None:
        """Add a contact, rounded so that a session holds exactly what is played.

        Parameters
        ----------
        client : int
            Number of the client that the finger belongs to.
        sample : FingerSample
            Sample of the finger.
        """
        *numbers, velocity = rounded(sample)
        n, place = self._written, _place(self._written)
        NUMBER.pack_into(self._map, place, 2 * n + 1)
        CONTACT.pack_into(
            self._map, place, 2 * n + 1, client, *numbers,
            velocity is not None, *(velocity or (0.0, 0.0)),
        )  # fmt: skip
        NUMBER.pack_into(self._map, place, 2 * n + 2)
        self._written = n + 1
        NUMBER.pack_into(self._map, AT_HEAD, self._written)

    def contacts(self) -> Iterator[tuple[int, FingerSample]]:
        """Yield the contacts that came since the last call.

        Contacts that could not be read whole are counted as lost.

        Yields
        ------
        client : int
            Number of the client that the finger belongs to.
        sample : FingerSample
            Sample of the finger.
        """
        head = NUMBER.unpack_from(self._map, AT_HEAD)[0]
        first = max(self._read, head - CONTACTS + 8)
        self.lost_contacts += first - self._read
        self._read = head
        for n in range(first, head):
            row = CONTACT.unpack_from(self._map, _place(n))
            number, client, time, arrival, x, y, force, has_velocity, vx, vy = row
            if number == 2 * n + 2:
                velocity = (vx, vy) if has_velocity else None
                yield client, FingerSample(time, arrival, x, y, force, velocity)
            else:
                self.lost_contacts += 1

    # The report

    def write_report(self, r: PlaybackReport) -> None:
        """Replace the report.

        Parameters
        ----------
        r : PlaybackReport
            Report to write.
        """
        self._reported += 1
        NUMBER.pack_into(self._map, AT_REPORTED, 2 * self._reported - 1)
        REPORT.pack_into(
            self._map, AT_REPORT, r.blocks, r.time, STATES.index(r.state), r.link == "up",
            r.running, r.touching, r.finger is not None, r.client, *r.position, *r.velocity,
            r.normal_force, r.sample_rate, r.latency, r.put_out_share,
            *(r.counters[name] for name in COUNTERS),
            r.detail.encode()[:DETAIL],
        )  # fmt: skip
        if r.finger is not None:
            f = r.finger
            self._finger[:] = f.touching, f.stiffness, f.deviation, f.explained, f.guarded
        NUMBER.pack_into(self._map, AT_REPORTED, 2 * self._reported)

    def report(self) -> PlaybackReport:
        """Return the latest complete report.

        If a process died while it wrote the report, the incomplete one is returned.

        Returns
        -------
        PlaybackReport
            Report of the playback process.
        """
        for _ in range(100):
            before = NUMBER.unpack_from(self._map, AT_REPORTED)[0]
            row = REPORT.unpack_from(self._map, AT_REPORT)
            finger = self._finger.copy()
            if before % 2 == 0 and before == NUMBER.unpack_from(self._map, AT_REPORTED)[0]:
                break
        counters = dict(zip(COUNTERS, row[-len(COUNTERS) - 1 : -1], strict=True))
        blocks, time, state, link, running, touching, known, client = row[:8]
        x, y, vx, vy, force, rate, late, share = row[8:16]
        return PlaybackReport(
            blocks, time, STATES[state], "up" if link else "down", bool(running), bool(touching),
            client, (x, y), (vx, vy), force, rate, late, share, counters,
            row[-1].rstrip(b"\0").decode(errors="replace"), _followed(finger) if known else None,
        )  # fmt: skip


def _size(contactors: int) -> int:
    """Return the size of the memory of a display [bytes]."""
    return AT_ARRAYS + 4 * ROWS * contactors


def _followed(rows: NDArray[np.float32]) -> FollowedFinger:
    """Return the finger of rows as `PlaybackMemory.write_report` writes them."""
    touching, stiffness, deviation, explained, guarded = rows.astype(np.float64)
    return FollowedFinger(touching > 0, stiffness, deviation, explained > 0, guarded > 0)


def _place(n: int) -> int:
    """Return the offset of entry ``n`` of the ring of contacts [bytes]."""
    return AT_CONTACTS + CONTACT_SPACE * (n % CONTACTS)
