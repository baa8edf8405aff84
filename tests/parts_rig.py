"""DRV2667 and BOS1921 on models of their registers, on a virtual clock."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from chip_models import (
    Bos1921Model,
    ChipModel,
    Drv2667Model,
    ModelBus,
    Tca9548aModel,
    VirtualRunner,
)

from tactile.arrays import Floats
from tactile.bus.base import DriveBlock, Wiring
from tactile.bus.chips.adapter import Place
from tactile.bus.chips.bos1921 import Bos1921Bus
from tactile.bus.chips.chip_bus import ChipBus
from tactile.bus.chips.drv2667 import Drv2667Bus

LSB = {"drv2667": 50 / 127, "bos1921": 3.6 * 31 / 2047}
"""Voltage of one code, at 100 V peak to peak and at ±95 V [V]."""
ROUNDING = 50 / 32767
"""Rounding of the amplifier in memory, which takes samples of 16 bits [V]."""
WIRING = Wiring(channels=1, sample_rate=8000.0, voltage=50.0, slew=80e3, fade=0.02)
"""Steps of 10 V a sample, 5 samples from the limit to 0 V."""
STEP = 10.0
KINDS = ("drv2667", "bos1921")
DRIFTS = (-0.01, 0.0, 0.01)
ESTOP = 20e-3
"""Longest time from an e-stop to 0 V [s]."""


@dataclass
class Rig:
    """A bus on models."""

    kind: str
    runner: VirtualRunner
    wire: ModelBus
    chips: list[Drv2667Model | Bos1921Model]
    bus: ChipBus

    @property
    def chip(self) -> Drv2667Model | Bos1921Model:
        return self.chips[0]

    @property
    def lsb(self) -> float:
        return LSB[self.kind]

    def write(self, volts: Floats, begin: int = 0, size: int = 16) -> None:
        for k in range(0, len(volts), size):
            self.bus.write(DriveBlock(begin + k, volts[k : k + size]))


def rig(kind: str, drift: float | list[float] = 0.0, wiring: Wiring = WIRING) -> Rig:
    """Return a bus with a chip for each drift of its clock, those of DRV2667 behind a mux."""
    drifts = drift if isinstance(drift, list) else [drift]
    wiring = replace(wiring, channels=len(drifts))
    runner = VirtualRunner()
    ports = tuple(range(len(drifts))) if len(drifts) > 1 else ()
    mux = 0x70 if ports else None
    chips: list[Drv2667Model | Bos1921Model] = []
    models: dict[int | tuple[int, int], ChipModel] = {0x70: Tca9548aModel()} if ports else {}
    address = 0x59 if kind == "drv2667" else 0x44
    for k, wrong in enumerate(drifts):
        model = Drv2667Model if kind == "drv2667" else Bos1921Model
        chips.append(model(runner, 8000 * (1 + wrong)))
        models[(k, address) if ports else address] = chips[-1]
    wire = ModelBus(runner, models, 400e3 if kind == "drv2667" else 1e6)
    place = Place("test", (address,) * len(drifts), mux, ports, 400_000)
    bus: ChipBus
    if kind == "drv2667":
        bus = Drv2667Bus(wiring, place, wire, runner, wide=100)
    else:
        bus = Bos1921Bus(wiring, place, wire, runner)
    return Rig(kind, runner, wire, chips, bus)


def link(built: Rig) -> str:
    return built.bus.status.link


def sine(count: int, frequency: float = 97.0, peak: float = 40.0) -> Floats:
    """Return (count, 1) samples that begin at 0 V [V]."""
    return peak * np.sin(2 * np.pi * frequency * np.arange(count) / 8000)[:, None]


def level(volts: float, count: int) -> Floats:
    """Return (count, 1) samples that rise within the slew limit, then stay [V]."""
    rise = np.minimum(np.arange(count) * (0.9 * STEP), abs(volts))
    return np.asarray(rise[:, None] * math.copysign(1, volts), np.float64)


def without_lead(played: list[float]) -> Floats:
    """Return what was played from the first sample that is not 0 V."""
    line = np.asarray(played)
    return line[np.flatnonzero(line)[0] :]


def assert_steps(line: Floats, bound: float, drops: list[int] | None = None) -> None:
    """See that no sample steps further, but where the chip went to 0 V by itself."""
    steps = np.abs(np.diff(line, prepend=0.0))
    for at in drops or []:
        steps[max(at - 1, 0) : at + 1] = 0
    assert steps.max(initial=0.0) <= bound


@dataclass
class FakeLimits:
    voltage: float = 50.0
    fade: float = 0.02


@dataclass
class FakeDisplay:
    channels: int = 1
    slew: float = 80e3
    limits: Any = None
    amplifier: Any = None

    def __post_init__(self) -> None:
        self.limits = self.limits or FakeLimits()
