"""Test of one drive line: a signal of at most 5 V, and what the readings say of the line."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tactile.arrays import Floats
from tactile.bus.base import Bus, DriveBlock, DriveFrame
from tactile.display.display import Display

TEST_VOLTAGE = 5.0
"""Limit of all signals of a test [V]: 1/20 of full drive, or 19 V/mm in a layer of 0.26 mm. It
still gives 4 µm of shear in air on the default design, which a fingertip feels and any vibrometer
sees."""
LEVEL = 0.98
"""Level of a signal relative to the limit; the margin covers rounding to codes, which adds at most
0.125 dB in a spectrum frame."""
INTERVAL = 10e-3
"""Interval between readings, the shortest that there is (SPEC.md, SENSE_MS) [s]."""
FREQUENCY = 161.8
"""Frequency of the tone [Hz]. It makes 1.618 turns from reading to reading, so that by the golden
ratio phases never repeat; it is so far below the resonance that motion adds 0.3 % to the
capacitance in air (default design)."""
TONE = 0.1
"""Time of a tone at full level [s]: 10 readings, and short enough for a busy machine to keep up
with some of the tones."""
TONES = 3
"""Number of tones without any fault of the link from which a line is measured."""
LEAST_READINGS = 12
"""Minimum number of readings for a verdict; three unknowns are fitted to each of voltage and
current."""
PULSES, PULSE, EDGE = 5, 0.2, 5e-3
"""Number of pulses of a train, their period, of which half is up [s], and the duration of an edge
[s]."""
BLOCK = 64
"""Number of samples of a block."""

OPEN = 0.25
"""Current relative to that of the display's own capacitance below which a line is open; cable and
connector have some capacitance too."""
TOLERANCE = 0.25
"""Relative deviation of the capacitance that is accepted: ±20 % by the makers (assumed), and −8 %
by a finger on the bimorph."""
SHORT = 10.0
"""Current relative to that of the display's own capacitance above which a line is short."""
COLLAPSED = 0.5
"""Voltage relative to the drive below which the voltage has not come up."""
VOLTAGE_TOLERANCE = 0.1
"""Relative deviation of the voltage from the drive that is accepted (assumed)."""
LOSS = 0.3
"""Loss factor tan δ above which a line leaks. Soft PZT has 0.02, and a board that reads the current
50 µs after the voltage seems to have 0.05 more (assumed)."""

Verdict = Literal[
    "good", "open", "short", "no voltage", "wrong voltage", "off", "leaks", "stopped",
    "not measured",
]  # fmt: skip
"""Result of the test of a line."""


def cautious(display: Display, most: float = TEST_VOLTAGE) -> Display:
    """Return a display limited to a low voltage, at the drive as well as at the electrodes.

    Parameters
    ----------
    display : Display
        Display with the limits of its file.
    most : float
        Largest voltage [V].

    Returns
    -------
    Display
        The same display with a voltage limit of at most ``most``.
    """
    limit = most / max(display.amplifier.peak, 1.0)
    voltage = min(display.limits.voltage, limit)
    return replace(display, limits=replace(display.limits, voltage=voltage))


@dataclass(frozen=True)
class Signal:
    """Signal with the value envelope(t) · cos 2πft.

    Attributes
    ----------
    frequency : float
        Frequency f [Hz].
    duration : float
        Duration [s].
    envelope : callable
        Function from times [s] to amplitudes [V].
    """

    frequency: float
    duration: float
    envelope: Callable[[Floats], Floats]

    def at(self, time: Floats) -> Floats:
        """Compute the signal.

        Parameters
        ----------
        time : (S,) array of float
            Times since the beginning [s].

        Returns
        -------
        (S,) array of float
            Drive [V].
        """
        return self.envelope(time) * np.cos(2 * np.pi * self.frequency * time)


@dataclass(frozen=True)
class LineLoad:
    """Electrical load of a drive line at the frequency of the tone.

    Attributes
    ----------
    voltage, current : float
        Amplitudes of voltage [V] and current [A].
    admittance : complex
        Current divided by voltage [S].
    error : float
        Relative standard deviation of the capacitance.
    """

    voltage: float
    current: float
    admittance: complex
    error: float

    @property
    def capacitance(self) -> float:
        """Capacitance in parallel with a resistance [F]."""
        return self.admittance.imag / (2 * np.pi * FREQUENCY)

    @property
    def loss(self) -> float:
        """Loss factor tan δ: ratio of the currents in phase and in quadrature with voltage."""
        y = self.admittance
        return max(y.real, 0.0) / y.imag if y.imag > 0 else math.inf


def tone(display: Display) -> Signal:
    """Return the tone with which lines are measured, faded in and out by the display's fade.

    Parameters
    ----------
    display : Display
        Display with test limits, see `cautious`.

    Returns
    -------
    Signal
        Tone at `FREQUENCY` that respects the limits of voltage and slew rate.
    """
    fade = display.limits.fade
    steepest = display.slew / (2 * np.pi * FREQUENCY)
    level = LEVEL * min(display.limits.voltage, steepest)
    duration = TONE + 2 * fade

    def envelope(time: Floats) -> Floats:
        gain = np.minimum(time, duration - time) / fade
        return level * np.clip(gain, 0.0, 1.0)

    return Signal(FREQUENCY, duration, envelope)


def train(display: Display, polarity: float) -> Signal:
    """Return pulses to one side of 0 V, by which a person sees what moves.

    Parameters
    ----------
    display : Display
        Display with test limits, see `cautious`.
    polarity : float
        1 for positive pulses, −1 for negative ones.

    Returns
    -------
    Signal
        Pulses that respect the limits of voltage and slew rate.
    """
    level = LEVEL * min(display.limits.voltage, display.slew * EDGE) * polarity

    def envelope(time: Floats) -> Floats:
        place = np.mod(time, PULSE)
        gain = np.minimum(place, PULSE / 2 - place) / EDGE
        return np.asarray(level * np.clip(gain, 0.0, 1.0))

    return Signal(0.0, PULSES * PULSE, envelope)


def sound(bus: Bus, signal: Signal, channel: int) -> None:
    """Play a signal on one channel, with all others at 0 V.

    The bus is idle before and after.

    Parameters
    ----------
    bus : Bus
        Idle bus.
    signal : Signal
        Signal to play.
    channel : int
        Index of the drive line.
    """
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
    """Play a signal on a link that takes spectrum frames."""
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
    """Fit the load of a line to pairs of voltage and current at known positions.

    With i = C dv/dt + v/R and v = Re V exp jωt, I/V = 1/R + jωC. V and I are the least-squares fit
    of (1, cos ωt, sin ωt) at the times of the readings. A delay that both have in common cancels; a
    current read τ later than its voltage reduces C by the factor cos ωτ and adds tan ωτ to the
    loss. The relative standard error of C is √(2/n) √(s_v²/|V|² + s_i²/|I|²), where s is the
    scatter about the sines: 0.1 % for 30 readings of 65 µA with the current in whole µA.

    Parameters
    ----------
    position : (n,) array of float
        Positions of the readings [samples].
    volts, current : (n,) array of float
        Voltage [V] and current [A], read together.
    sample_rate : float
        Sample rate of the positions [Hz].

    Returns
    -------
    LineLoad
        The load; its admittance is 0 and its error infinite if voltage or current is 0.
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


def judge(load: LineLoad, *, drive: float, admittance: complex) -> Verdict:
    """Judge a line by its load.

    Parameters
    ----------
    load : LineLoad
        Measured load.
    drive : float
        Amplitude that was sent [V].
    admittance : complex
        Admittance that the line should have, seen at the drive [A/V].

    Returns
    -------
    Verdict
        Verdict on the line.
    """
    expected = abs(admittance) * drive
    if load.voltage < COLLAPSED * drive:
        return "short" if load.current > expected else "no voltage"
    if load.current > SHORT * expected:
        return "short"
    if load.current < OPEN * expected:
        return "open"
    if abs(load.voltage / drive - 1) > VOLTAGE_TOLERANCE:
        return "wrong voltage"
    if admittance.imag > abs(admittance.real) and load.loss > LOSS:
        return "leaks"
    deviation = abs(load.admittance) / abs(admittance) - 1
    return "good" if abs(deviation) <= TOLERANCE else "off"
