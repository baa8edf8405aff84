"""The C amplifier on the host: built, run, and read while it plays."""

import gc
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import firmware_protocol
from firmware_protocol.can_link import Frame
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile.bench.figures import RATE, Figure, at_most, beside_machine, not_measured
from tactile.bus.base import Wiring
from tactile.bus.budget import Ability, plan
from tactile.bus.can_bus import CanChannel, CanWire
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.stream import LONGEST_LEAD
from tactile.bus.wire import WireError
from tactile.bus.wire_time import Can
from tactile.clock import MONOTONIC, Clock
from tactile.display.display import Display
from tactile.rendering.contact import Trajectory

CAN_FRAME = struct.Struct("<IBBxx64s")
"""Layout of struct canfd_frame."""
FD = 0x04
"""Flag of a CAN FD frame."""
CHUNK = 1 << 22
"""Number of bytes of records that are read at a time."""
PRIORITY = 5
"""Real-time priority of the measuring process.

A process of normal priority is held up by others for milliseconds.
"""


STROKE = 0.05
"""Amplitude of a finger that moves back and forth [m]."""
PERIOD = 1.7
"""Period of a finger that moves back and forth [s]."""


def to_and_fro(duration: float) -> Trajectory:
    """Return the path of a finger that moves back and forth, and rests at each turn."""
    t = np.arange(0, duration + 0.1, 0.02)
    x = STROKE * np.sin(2 * np.pi * t / PERIOD)
    return Trajectory(t, np.stack([x, 0.3 * x], axis=1), 0.5)


class Records(NamedTuple):
    """Output of the amplifier, instant by instant."""

    tick: NDArray[np.uint64]
    position: NDArray[np.uint32]
    state: NDArray[np.uint8]
    codes: NDArray[np.int16]
    high_voltage: NDArray[np.uint8]


class VirtualAmplifier:
    """The running C amplifier.

    Parameters
    ----------
    folder : Path
        Folder for its output.
    options : str
        Options of its command line.
    channels : int
        Number of channels C.

    Attributes
    ----------
    path : str
        Path of its pty.
    powered_up : float
        Time on the monotonic clock at which its clock was 0 [s].
    """

    def __init__(self, folder: Path, *options: str, channels: int = 24) -> None:
        self._out = folder / "out"
        command = [str(build(folder)), *options, "--channels", str(channels)]
        self._process = subprocess.Popen(
            [*command, "--out", str(self._out)], stdout=subprocess.PIPE, text=True
        )
        urgent(self._process.pid)
        assert self._process.stdout is not None
        self.path = self._process.stdout.readline().strip() if "--pty" in options else ""
        self.powered_up = float(self._process.stdout.readline().split()[-2])
        self._kind = np.dtype(
            [("tick", "<u8"), ("at", "<u4"), ("state", "u1"), ("hv", "u1"), ("v", "<i2", channels)]
        )
        while not self._out.exists():
            time.sleep(0.01)
        self._file = self._out.open("rb")
        self._rest = b""

    def take(self, most: int = -1) -> Records:
        """Return the output since the last call, or at most ``most`` bytes of it."""
        data = self._rest + self._file.read(most)
        whole = len(data) // self._kind.itemsize * self._kind.itemsize
        self._rest = data[whole:]
        rows = np.frombuffer(data[:whole], self._kind)
        return Records(rows["tick"], rows["at"], rows["state"], rows["v"], rows["hv"])

    def chunks(self) -> Iterator[Records]:
        """Yield the output since the last call, in parts of bounded size."""
        while len((records := self.take(CHUNK)).tick):
            yield records

    def close(self) -> None:
        """End the amplifier."""
        self._process.terminate()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._file.close()


def urgent(process: int | None = None, *, ended: bool = False) -> bool:
    """Give all threads of a process real-time priority if permitted; return whether it is.

    ``ended`` takes the priority away again. All threads need it, because a thread without it that
    holds Python's lock would have to be waited for.
    """
    policy, priority = (os.SCHED_OTHER, 0) if ended else (os.SCHED_RR, PRIORITY)
    with suppress(OSError, AttributeError):
        for thread in Path(f"/proc/{process or os.getpid()}/task").iterdir():
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))
        return True
    return False


@contextmanager
def real_time() -> Iterator[bool]:
    """Run with real-time priority and, like the playback process, without garbage collection.

    A collection over all that a benchmark keeps for comparison takes longer than a lead.
    """
    gc.collect()
    gc.disable()
    granted = urgent()
    try:
        yield granted
    finally:
        gc.enable()
        if granted:
            urgent(ended=True)


def build(folder: Path) -> Path:
    """Return the path of the amplifier's program, which is built if it is missing."""
    program = folder / "build" / "virtual-amplifier"
    if not program.exists():
        source = Path(firmware_protocol.__file__).parent / "c"
        command = ["make", "-s", "-C", str(source), f"BUILD={folder / 'build'}"]
        subprocess.run(command, check=True, capture_output=True)
    return program


NO_AMPLIFIER = "needs Linux, make and a C compiler"
"""Reason why nothing can be measured with the amplifier."""


def can_be_built() -> bool:
    """Tell whether the tools for the build are there."""
    return os.name == "posix" and all(shutil.which(name) for name in ("make", "cc"))


def beside_amplifier(name: str, measured: Iterator[Figure]) -> Iterator[Figure]:
    """Measure beside the machine, if the amplifier can be built and observed here."""
    if sys.platform == "linux" and can_be_built():
        yield from beside_machine(name, measured)
    else:
        yield not_measured(name, NO_AMPLIFIER)


@contextmanager
def workshop() -> Iterator[Path]:
    """Yield a folder to build and record in."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


class VirtualSocketCan(CanChannel):
    """CAN channel to an amplifier's datagram socket."""

    def __init__(self, folder: Path, *, fd: bool) -> None:
        self._fd = fd
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        mine = folder / "host"
        mine.unlink(missing_ok=True)
        self._socket.bind(str(mine))
        while not (folder / "can").exists():
            time.sleep(0.01)
        self._socket.connect(str(folder / "can"))
        self._woken = socket.socketpair()

    def send(self, frame: Frame) -> bool:
        """Send a frame; return whether it was accepted."""
        identifier, data = frame
        flags = FD if self._fd else 0
        packed = CAN_FRAME.pack(identifier, len(data), flags, data.ljust(64, b"\0"))
        try:
            return self._socket.send(packed, socket.MSG_DONTWAIT) > 0
        except BlockingIOError:
            return False
        except OSError as error:
            raise WireError(str(error)) from error

    def send_urgent(self, frame: Frame) -> None:
        """Send an urgent frame."""
        self.send(frame)

    def receive(self, until: float) -> list[Frame]:
        """Return the frames received until a deadline on the monotonic clock [s]."""
        import select

        left = max(until - time.monotonic(), 0.0)
        ready, _, _ = select.select([self._socket, self._woken[0]], [], [], left)
        if self._woken[0] in ready:
            self._woken[0].recv(4096)
        frames: list[Frame] = []
        with suppress(BlockingIOError):
            while True:
                identifier, size, _, data = CAN_FRAME.unpack(
                    self._socket.recv(CAN_FRAME.size, socket.MSG_DONTWAIT)
                )
                frames.append((identifier, data[:size]))
        return frames

    def wake(self) -> None:
        """Make `receive` return."""
        self._woken[1].send(b"\0")

    def close(self) -> None:
        """Close the socket."""
        for each in (self._socket, *self._woken):
            each.close()


def can_bus(
    folder: Path,
    display: Display,
    link: Can,
    wire: Callable[[CanChannel, Can, Clock], CanWire] = CanWire,
    *,
    rearm: bool = False,
) -> LinkBus:
    """Return a bus to the amplifier that serves CAN frames on a socket in a folder."""
    return LinkBus(
        Wiring.of(display, RATE),
        lambda: wire(VirtualSocketCan(folder, fd=link.data is not None), link, MONOTONIC),
        lambda caps: plan(link, display.channels, Ability.of(caps)),
        nodes=[1],
        rearm=rearm,
        lead=LONGEST_LEAD,
    )


def bus_figures(name: str, bus: LinkBus, unit: str, size: int) -> Iterator[Figure]:
    """Yield what a bus counted during a stream of units of a number of samples."""
    counters = bus.counters
    late = 1e4 * counters.late_blocks / max(counters.blocks, 1)
    yield Figure(f"{name}.wire", 100 * bus.plan.use, "%")
    yield at_most(f"{name}.lost_{unit}", float(counters.dropped_samples / size), unit, 0)
    yield at_most(f"{name}.late_{unit}", late, "of 10 000", 1)
    yield at_most(f"{name}.disconnects", float(counters.disconnects), "", 0)
    yield Figure(f"{name}.underruns", float(counters.underruns), "")


def largest_step(name: str, step: int, display: Display, rate: float = RATE) -> Figure:
    """Return the figure of the largest step of an output [codes], relative to the slew limit."""
    limit = min(display.slew / rate / display.limits.voltage, 2.0) * FULL_SCALE_CODE
    return at_most(f"{name}.largest_step", step / limit, "of slew", 1)
