"""How a line is tried: signals of 5 V at most on one channel, and what its readings say of it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tactile.arrays import Floats
from tactile.bus.base import Bus, DriveBlock, DriveFrame
from tactile.display.display import Display

TEST_VOLTAGE = 5.0
"""V that nothing here exceeds: 1/20 of full drive, 19 V/mm in a layer of 0.26 mm; still 4 µm of
shear in air on the default design, which a fingertip feels and any vibrometer sees."""
LEVEL = 0.98
"""Of the limit: what rounding to codes adds (0.125 dB at most in a spectrum frame) stays below."""
INTERVAL = 10e-3
"""s between readings, the shortest that there is (SPEC.md, SENSE_MS)."""
FREQUENCY = 161.8
"""Hz: 1.618 turns from reading to reading, by the golden ratio ever other phases; far enough below
the resonance that the motion adds 0.3 % to the capacitance in air (the default design)."""
TONE = 0.1
"""s at full level: 10 readings; so short that a busy machine keeps up with some of them."""
TONES = 3
"""Tones without any fault of the link that a line is measured by."""
LEAST_READINGS = 12
"""Without which nothing is said; of three unknowns for each of voltage and current."""
PULSES, PULSE, EDGE = 5, 0.2, 5e-3
"""Pulses of a train, s from one to the next (half of it up), s of an edge."""
BLOCK = 64

OPEN = 0.25
"""Of the display's own capacitance, below which a line is open: cable and connector have some."""
TOLERANCE = 0.25
"""Of it, by which a bimorph may be off: ±20 % of the makers' (assumed), and a finger on it −8 %."""
SHORT = 10.0
"""Times the current that the display's own capacitance would draw, from which a line is short."""
COLLAPSED = 0.5
"""Of the drive, below which the voltage has not come up."""
VOLTAGE_TOLERANCE = 0.1
"""Of the drive, by which the voltage may be off (assumed)."""
LOSS = 0.3
"""tan δ from which a line leaks: soft PZT has 0.02, and a board that reads current 50 µs after
voltage seems to have 0.05 more (assumed)."""

Verdict = Literal[
    "good", "open", "short", "no voltage", "wrong voltage", "off", "leaks", "stopped",
    "not measured",
]  # fmt: skip


def cautious(display: Display) -> Display:
    """Return a display whose limit is the test's: neither drive nor electrodes see more."""
    most = TEST_VOLTAGE / max(display.amplifier.peak, 1.0)
    voltage = min(display.limits.voltage, most)
    return replace(display, limits=replace(display.limits, voltage=voltage))


@dataclass(frozen=True)
class Signal:
    """``envelope`` (of time [s], in volts) × cos 2πft."""

    frequency: float
    duration: float
    envelope: Callable[[Floats], Floats]

    def at(self, time: Floats) -> Floats:
        """Return volts at times (S,) [s]."""
        return self.envelope(time) * np.cos(2 * np.pi * self.frequency * time)


@dataclass(frozen=True)
class LineLoad:
    """What hangs on a line.

    Attributes
    ----------
    voltage, current : amplitudes [V], [A]
    admittance : current over voltage [S]
    error : of the capacitance, relative, one standard deviation
    """

    voltage: float
    current: float
    admittance: complex
    error: float

    @property
    def capacitance(self) -> float:
        """In parallel with a resistance [F]."""
        return self.admittance.imag / (2 * np.pi * FREQUENCY)

    @property
    def loss(self) -> float:
        """Current in phase with the voltage over that a quarter turn ahead, tan δ."""
        y = self.admittance
        return max(y.real, 0.0) / y.imag if y.imag > 0 else math.inf


def tone(display: Display) -> Signal:
    """Return the tone that lines are measured by, faded in and out by the display's fade."""
    fade = display.limits.fade
    steepest = display.slew / (2 * np.pi * FREQUENCY)
    level = LEVEL * min(display.limits.voltage, steepest)
    duration = TONE + 2 * fade

    def envelope(time: Floats) -> Floats:
        gain = np.minimum(time, duration - time) / fade
        return level * np.clip(gain, 0.0, 1.0)

    return Signal(FREQUENCY, duration, envelope)


def train(display: Display, polarity: float) -> Signal:
    """Return pulses to one side of 0 V: of positive volts, or negative for a polarity of −1."""
    level = LEVEL * min(display.limits.voltage, display.slew * EDGE) * polarity

    def envelope(time: Floats) -> Floats:
        place = np.mod(time, PULSE)
        gain = np.minimum(place, PULSE / 2 - place) / EDGE
        return np.asarray(level * np.clip(gain, 0.0, 1.0))

    return Signal(0.0, PULSES * PULSE, envelope)


def sound(bus: Bus, signal: Signal, channel: int) -> None:
    """Play a signal on one channel, all others at 0 V; the bus is idle before and after."""
    if bus.frames is not None:
        _sound_frames(bus, signal, channel)
        return
    rate = bus.wiring.sample_rate
    count = round(signal.duration * rate)
    bus.start()
    for first in range(0, count, BLOCK):
        time = np.arange(first, min(first + BLOCK, count)) / rate
        lines = np.zeros((len(time), bus.wiring.channels))
        lines[:, channel] = signal.at(time)
        bus.write(DriveBlock(first, lines))
    bus.stop()


def _sound_frames(bus: Bus, signal: Signal, channel: int) -> None:
    assert bus.frames is not None
    rate = bus.wiring.sample_rate
    spacing = round(rate / bus.frames.rate)
    bus.tune(np.array([signal.frequency]))
    bus.start()
    last = math.ceil(signal.duration * rate / spacing)
    for k in range(1, last + 1):
        lines = np.zeros((bus.wiring.channels, 1), np.complex128)
        if k < last:
            lines[channel] = signal.envelope(np.array([k * spacing / rate]))
        bus.write_frame(DriveFrame(k * spacing, lines))
    bus.stop()


def load_of(position: Floats, volts: Floats, current: Floats, *, sample_rate: float) -> LineLoad:
    """Return what hangs on a line, from pairs of voltage and current at known positions.

    With i = C dv/dt + v/R and v = Re V exp jωt it is I/V = 1/R + jωC. V and I are the least squares
    of (1, cos ωt, sin ωt) at the readings' times. A delay that both have in common cancels; a
    current read τ later than its voltage takes 1 − cos ωτ off C and adds tan ωτ to the loss. The
    relative standard error of C is √(2/n) √(s_v²/|V|² + s_i²/|I|²), s the scatter about the sines:
    with current in whole µA and 65 µA of it 0.1 % of 30 readings.

    Parameters
    ----------
    position : (n,) samples
    volts, current : (n,) [V], [A], read together
    sample_rate : [Hz]
    """
    omega = 2 * np.pi * FREQUENCY
    angle = omega * np.asarray(position) / sample_rate
    basis = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    pairs = np.stack([volts, current], axis=1)
    fit = np.linalg.lstsq(basis, pairs, rcond=None)[0]
    scatter = np.sqrt(np.sum((pairs - basis @ fit) ** 2, axis=0) / (len(pairs) - 3))
    v, i = fit[1] - 1j * fit[2]
    size = np.abs([v, i])
    if not size.min() > 0:
        return LineLoad(float(size[0]), float(size[1]), 0j, math.inf)
    error = math.sqrt(2 / len(pairs)) * float(np.hypot(*(scatter / size)))
    return LineLoad(float(size[0]), float(size[1]), complex(i / v), error)


def judge(load: LineLoad, *, drive: float, capacitance: float) -> Verdict:
    """Return what a load says of its line.

    Parameters
    ----------
    load : as measured
    drive : amplitude that was sent [V]
    capacitance : that it should have, at the drive [F]
    """
    expected = 2 * np.pi * FREQUENCY * capacitance * drive
    if load.voltage < COLLAPSED * drive:
        return "short" if load.current > expected else "no voltage"
    if load.current > SHORT * expected:
        return "short"
    if load.current < OPEN * expected:
        return "open"
    if abs(load.voltage / drive - 1) > VOLTAGE_TOLERANCE:
        return "wrong voltage"
    if load.loss > LOSS:
        return "leaks"
    return "good" if abs(load.capacitance / capacitance - 1) <= TOLERANCE else "off"
