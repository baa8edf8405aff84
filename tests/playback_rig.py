"""Runs that are played once and examined by many tests."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tactile.arrays import Floats
from tactile.bus.base import DriveBlock
from tactile.bus.simulated.mock_bus import MockBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.playback.trajectory_playback import PlayedBlock, play
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import Texture

RATE = 8000.0
FADE = 160
SINGLE = 1e-6
"""Relative rounding error: shear is computed in single precision."""
FIDELITY = 45.0
"""Smallest fidelity [dB]. 55 dB are measured; the damping of finger and beam accounts for most of
the error (see the plant)."""
SLIDE = Path(__file__).parents[2] / "shared" / "data" / "paths" / "slide.csv"


def stroke(duration: float, begin: float = 0.0) -> Trajectory:
    """Return a straight stroke at 80 mm/s."""
    return Trajectory([begin, begin + duration], [[0.0, 0.0], [0.08 * duration, 0.0]], 0.5)


def swing(duration: float, begin: float = 0.0) -> Trajectory:
    """Return 1 Hz back and forth, peak 1 m/s² and 0.16 m/s, the force between 0.3 and 0.7 N."""
    t = np.arange(0, duration + 5e-4, 1e-3)
    x = np.sin(2 * np.pi * t) / (2 * np.pi) ** 2
    force = 0.5 + 0.2 * np.sin(2 * np.pi * 1.7 * t)
    return Trajectory(t + begin, np.column_stack([x, -0.5 * x]), force)


TRAJECTORIES = {
    "half a second": stroke(0.5),
    "no whole block": stroke(0.1234),
    "begins late": swing(0.3, begin=5.0),
    "there and back": swing(1.0),
    "one block": stroke(64 / RATE),
    "two fades": stroke(2 * FADE / RATE),
    "a fade": stroke(FADE / RATE),
    "a fade and a sample": stroke((FADE + 1) / RATE),
    "shorter than a fade": stroke(0.013),
    "shorter than the delay": stroke(0.001),
    "one sample": stroke(1 / RATE),
}


@dataclass(frozen=True)
class Played:
    """Outcome of a trajectory."""

    blocks: list[PlayedBlock]
    written: list[DriveBlock]
    bus: MockBus
    delay: int

    def all(self, name: str) -> Floats:
        return np.concatenate([getattr(block, name) for block in self.blocks])


def played(display: Display, texture: Texture, trajectory: Trajectory) -> Played:
    """Play on ``mock:?keep=all`` and note what is written to it."""
    renderer = Renderer(display, texture, sample_rate=RATE)
    bus = open_bus("mock:?keep=all", display, sample_rate=RATE)
    assert isinstance(bus, MockBus)
    blocks: list[PlayedBlock] = []
    written: list[DriveBlock] = []
    write = bus.write

    def noting(block: DriveBlock) -> None:
        written.append(DriveBlock(block.position, block.volts.copy()))
        write(block)

    with pytest.MonkeyPatch.context() as patch, bus:
        patch.setattr(bus, "write", noting)
        play(display, renderer, trajectory, bus, sample_rate=RATE, listen=blocks.append)
        assert bus.state == "idle"
    return Played(blocks, written, bus, renderer.delay)
