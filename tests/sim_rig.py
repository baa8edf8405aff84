"""Displays, plants and drive for the simulated display."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from display_files import load

from tactile.arrays import Floats
from tactile.bus.base import DriveBlock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.sim import SimulatedDisplay

RATE = 8000.0
SHUFFLED = """[[contactor]]
position_mm = [0.0, 0.0]
channel = 5
[[contactor]]
position_mm = [3.0, 0.0]
channel = 0
polarity = -1
[[contactor]]
position_mm = [6.0, 0.0]
channel = 3
polarity = -1
[[contactor]]
position_mm = [9.0, 0.0]
channel = 1
"""
"""Four contactors on shuffled lines, two of them mounted the other way round."""
LOW = '[finger]\npreset = "low"\n'
HIGH = '[finger]\npreset = "high"\n'
THREE_FORCES = """[finger]
[[finger.table]]
normal_force_n = 0.2
k0_n_per_m = 200.0
d0_n_s_per_m = 0.1
[[finger.table]]
normal_force_n = 0.7
k0_n_per_m = 700.0
d0_n_s_per_m = 0.4
[[finger.table]]
normal_force_n = 2.0
k0_n_per_m = 2000.0
d0_n_s_per_m = 1.0
"""
SLOW_AMPLIFIER = LOW + (
    "[amplifier]\ngain = 0.5\nbandwidth_hz = 3000.0\noutput_resistance_ohm = 2000.0\n"
    "delay_us = 700.0\n"
)
CHANNEL = [5, 0, 3, 1]
POLARITY = np.array([1.0, -1.0, -1.0, 1.0])

PLANTS = '''
given = []


class Late:
    """1, 2, 3 and 4 nm/V, so many samples late; draws 1 µA/V."""

    def __init__(self, delay, contactors):
        self.delay, self._past = delay, [[0.0] * contactors] * delay

    def step(self, drive):
        import numpy as np

        line = np.concatenate([np.reshape(self._past, (-1, drive.shape[1])), drive])
        self._past = line[len(drive):]
        return 1e-9 * np.arange(1, 5) * line[: len(drive)], 1e-6 * drive


class Bare:
    pass


def late(display, sample_rate):
    given.append((display, sample_rate))
    return Late(3, len(display.contactors))


def at_once(display, sample_rate):
    return Late(0, len(display.contactors))


def nothing(display, sample_rate):
    return None


def without_step(display, sample_rate):
    plant = Bare()
    plant.delay = 3
    return plant


def without_delay(display, sample_rate):
    plant = Late(3, 4)
    del plant.delay
    return plant


def with_half_a_sample(display, sample_rate):
    plant = Late(3, 4)
    plant.delay = 0.5
    return plant


def with_negative_delay(display, sample_rate):
    plant = Late(3, 4)
    plant.delay = -3
    return plant


def of_one_argument(display):
    return Late(3, 4)


constant = 3.0
'''


def shuffled(folder: Path, rest: str) -> Display:
    return load(folder, SHUFFLED, rest)


def opened(display: Display, url: str = "sim:") -> SimulatedDisplay:
    bus = open_bus(url, display, sample_rate=RATE)
    assert isinstance(bus, SimulatedDisplay)
    return bus


def noise(count: int, seed: int = 0) -> Floats:
    """Return samples for six lines [V] that the wire carries exactly, within the slew limit."""
    return on_wire(np.random.default_rng(seed).uniform(-40, 40, (count, 6)))


def on_wire(volts: Floats) -> Floats:
    """Return volts rounded to the amplifier's codes, 32767 for the limit of 100 V."""
    return np.asarray(np.rint(volts * 327.67) / 327.67)


def play(bus: SimulatedDisplay, volts: Floats, edges: list[int]) -> Floats:
    """Write blocks that end at the edges, taking the shear after each; return all of it."""
    taken = []
    for start, end in pairwise([0, *edges, len(volts)]):
        bus.write(DriveBlock(start, volts[start:end]))
        taken.append(bus.take_shear())
    return np.concatenate(taken)
