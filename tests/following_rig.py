"""A playback loop that follows the finger of a simulated display, turned by hand in model time."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from display_files import contactors, load

from tactile.arrays import Floats
from tactile.bringup.calibrating import calibrate
from tactile.clock import ModelClock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.estop.latch import Latch, LatchWriter
from tactile.playback.commands import News, PlaybackSetup
from tactile.playback.estimates import Estimates, OwnEstimates
from tactile.playback.followed_finger import FollowedFinger
from tactile.playback.loop import PlaybackLoop
from tactile.playback.process import Message, Program, follow
from tactile.playback.shared_memory import PlaybackMemory
from tactile.rendering.layer import RealizedLayer
from tactile.sim import SimulatedDisplay
from tactile.texture.surface import load_texture
from tactile.tracking.finger_sample import FingerSample

RATE, BLOCK = 8000.0, 16
WINDOW = 200
"""Length of a window [samples]."""
PLACES = contactors((0.0, 0.0, 0.0), (2.5, 0.0, 0.0))
NAME, ME = "left", 1
SPEED = 0.08


def pair(folder: Path) -> tuple[Display, Path, Path]:
    """Return a display of two contactors, its file, and its calibration."""
    display = load(folder, PLACES)
    written = folder / "sample.sensing.npz"
    report, _ = calibrate("sim:?finger=air", folder / "sample.toml", write=written)
    assert report.faults == []
    return display, folder / "sample.toml", written


def setup_of(display: Display, device: str, calibration: Path | str) -> PlaybackSetup:
    """Return what a server tells playback of a display."""
    return PlaybackSetup(
        display, device, rearm=False, sample_rate=RATE, accept_unsafe_hold=False, gain=1.0,
        worn=False, memory="", latch="", calibration=str(calibration),
    )  # fmt: skip


@dataclass
class Stage:
    """A program whose loop a test turns, and the server's end of all that both map."""

    program: Program
    player: PlaybackLoop
    bus: SimulatedDisplay
    memory: PlaybackMemory
    latch: Latch
    said: list[Message]
    told: list[FollowedFinger | None] = field(default_factory=list)
    """Finger of each report that the server could have read."""
    origin: float = 0.0

    def play(self, seconds: float, *, slides: bool = False) -> Floats:
        """Play block after block; return what was put out (S, C) [V]."""
        before = len(self.bus.output)
        for _ in range(round(seconds * RATE / BLOCK)):
            now = self.player.clock.now()
            if slides:
                sample = FingerSample(now, now, SPEED * (now - 1), 0.0, 0.5, (SPEED, 0.0))
                self.memory.write_contact(ME, sample)
            self.program.turn()
            self.told.append(self.memory.report().finger)
        return self.bus.output[before:]

    @property
    def news(self) -> list[tuple[str, tuple[int, ...]]]:
        """Kinds and contactors of the touches that were told."""
        return [(n.kind, n.contactors) for n in self.said if isinstance(n, News) and n.contactors]


@contextmanager
def staged(
    display: Display,
    device: str,
    calibration: Path | str,
    estimates: type[Estimates] = OwnEstimates,
    *,
    texture: str | None = None,
) -> Iterator[Stage]:
    """Open a display as playback does, and arm it."""
    bus = open_bus(device, display, sample_rate=RATE)
    assert isinstance(bus, SimulatedDisplay)
    clock = bus._clock = ModelClock()
    following = follow(setup_of(display, device, calibration), bus, estimates)
    memory = PlaybackMemory.create(len(display.contactors))
    shared = PlaybackMemory(memory.handle, len(display.contactors))
    latch = Latch.open(device, Path())
    player = PlaybackLoop(display, bus, shared, clock=clock, following=following)
    if texture is not None:
        player.keep(1, RealizedLayer(display, load_texture(texture)))
        player.voice(ME).state.layers = ((1, 1.0),)
    said: list[Message] = []
    program = Program(player, Latch(latch.handle, LatchWriter.PLAYBACK), said.append)
    player.arm()
    yield Stage(program, player, bus, memory, latch, said)
    bus.close()
    memory.close()


def rms(volts: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(volts**2)))
