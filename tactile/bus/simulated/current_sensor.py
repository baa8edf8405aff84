"""Measurement of the currents of a simulated amplifier, with the errors of a real one.

What a load draws is a model of the caller's: a function of the volts that are put out. This module
adds what a board does to it: the time at which it samples, the noise and the steps of its ADC, and
the ends of its range.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_protocol.correlation import Ints
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile.arrays import Floats
from tactile.errors import InputError

CurrentModel = Callable[[Floats, float], Floats]
"""Load of an amplifier: a function that is called with the drive (S, C) [V] of each run of samples
that is put out, in order, and with their rate [Hz]. It returns the currents (S, C) [A] at the same
instants."""

CODE_BITS = 16
"""Number of bits of a current code."""
BACKWARD = np.array([25 / 12, -4.0, 3.0, -4 / 3, 1 / 4])
"""Weights of the latest samples in the derivative, the newest first (Fornberg 1988, order 4)."""


@dataclass(frozen=True, kw_only=True)
class SensorDesign:
    """How a board measures currents.

    Attributes
    ----------
    ranges : tuple of float
        Currents at the end of its ranges, that at power-up first [A]. The default is what a design
        study asks for: 2.5 mA (assumed).
    bits : int
        Number of bits of the ADC, 8 … 16.
    noise : float
        Noise of the ADC, rms [steps of the ADC].
    skew : float
        Time by which the current is sampled after the drive, of a small part of a sample [s].
    delay : int
        Number of samples by which the load's currents are late, which the board takes off.
    seed : int
        Seed of the noise.
    """

    ranges: tuple[float, ...] = (2.5e-3,)
    bits: int = 12
    noise: float = 1.0
    skew: float = 0.0
    delay: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 8 <= self.bits <= CODE_BITS:
            raise InputError(f"bits {self.bits}: an ADC has 8 … {CODE_BITS}")
        for value in self.ranges:
            if not 1 <= round(value * 1e6) <= 0xFFFF:
                raise InputError(f"range {value * 1e3:g} mA: the protocol tells 0.001 … 65.535 mA")

    @property
    def ranges_ua(self) -> tuple[int, ...]:
        """Ranges as the protocol tells them [µA]."""
        return tuple(round(value * 1e6) for value in self.ranges)


class CurrentSensor:
    """Sensor of an amplifier in memory, as `ReferenceAmplifier` takes it.

    Parameters
    ----------
    model : CurrentModel
        Load of the amplifier.
    design : SensorDesign
        Range, ADC, noise and skew.
    channels : int
        Number of channels, C.
    full_scale : float
        Voltage of the largest sample code [V].
    """

    def __init__(
        self, model: CurrentModel, design: SensorDesign, *, channels: int, full_scale: float
    ) -> None:
        self._model, self._design = model, design
        self._volts = full_scale / FULL_SCALE_CODE
        self._random = np.random.default_rng(design.seed)
        self._past = np.zeros((len(BACKWARD) - 1, channels))
        self._range_ua = design.ranges_ua[0]
        self._latest: tuple[Ints, Ints] = np.zeros(channels, np.int64), np.zeros(channels, np.int64)

    def choose(self, range_ua: int) -> None:
        """Switch to another range.

        Parameters
        ----------
        range_ua : int
            Range of the current [µA].
        """
        self._range_ua = range_ua

    def measure(self, codes: Ints, rate: int) -> Ints:
        """Measure the currents of a run of instants.

        Parameters
        ----------
        codes : (S, C) array of int
            Sample codes that were put out.
        rate : int
            Sample rate [Hz].

        Returns
        -------
        (S, C) array of int
            Current codes (SPEC.md, 16.1); ±32767 where the ADC is at an end of its range.
        """
        volts: Floats = np.asarray(codes * self._volts)
        currents = self._late(self._model(volts, rate), rate)
        measured = self._converted(currents)
        step = self._range_ua / FULL_SCALE_CODE
        self._latest = codes[-1], np.rint(measured[-1] * step).astype(np.int64)
        return measured

    def readings(self) -> tuple[Ints, Ints]:
        """Return what SENSE tells of the latest instant.

        Returns
        -------
        voltages : (C,) array of int
            Voltages [sample codes].
        currents : (C,) array of int
            Currents [µA].
        """
        voltages, currents = self._latest
        return voltages, np.clip(currents, -FULL_SCALE_CODE, FULL_SCALE_CODE)

    def _late(self, currents: Floats, rate: int) -> Floats:
        """Return the currents as they are sampled after the drive, to first order of the skew."""
        line = np.concatenate([self._past, currents])
        self._past = line[-len(self._past) :]
        if not self._design.skew:
            return currents
        last = len(BACKWARD) - 1
        slope = sum(w * line[last - k : len(line) - k] for k, w in enumerate(BACKWARD))
        return np.asarray(currents + self._design.skew * rate * slope)

    def _converted(self, currents: Floats) -> Ints:
        """Return the codes of an ADC whose steps are shifted up to 16 bits."""
        shift, most = CODE_BITS - self._design.bits, 1 << (self._design.bits - 1)
        step = self._range_ua * 1e-6 / FULL_SCALE_CODE * (1 << shift)
        noise = self._design.noise * self._random.standard_normal(currents.shape)
        steps = np.clip(np.rint(currents / step + noise), -most, most - 1).astype(np.int64)
        inside = (steps > -most) & (steps < most - 1) & (np.abs(steps << shift) < FULL_SCALE_CODE)
        return np.where(inside, steps << shift, FULL_SCALE_CODE * np.sign(steps))


class CapacitiveLoad:
    """Load of equal capacitors, for links without a display behind them.

    Parameters
    ----------
    capacitance : float
        Capacitance of each channel [F].
    channels : int
        Number of channels, C.
    """

    def __init__(self, capacitance: float, channels: int) -> None:
        self._capacitance, self._last = capacitance, np.zeros((1, channels))

    def __call__(self, volts: Floats, sample_rate: float) -> Floats:
        """Return the currents C dv/dt of the steps from each sample to the next.

        Parameters
        ----------
        volts : (S, C) array of float
            Drive [V].
        sample_rate : float
            Sample rate [Hz].

        Returns
        -------
        (S, C) array of float
            Currents [A].
        """
        steps = np.diff(volts, axis=0, prepend=self._last)
        self._last = volts[-1:].copy()
        return steps * (self._capacitance * sample_rate)
