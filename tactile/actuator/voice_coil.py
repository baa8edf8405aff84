"""A voice coil, or any other actuator whose response under the finger was measured.

Nothing is modeled: the measurement is the response, and the electrical side is a resistance and an
inductance in series. The simulation in time is a filter that has the measured response.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tactile.actuator.actuator import ActuatorResponse
from tactile.actuator.amplifier import Amplifier
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Complex, Floats

TAPS, DELAY = 512, 128
"""Length of the filter of `MeasuredPlant` and its delay [samples]: 64 ms and 16 ms at 8 kHz, within
which a contactor on a finger has come to rest."""
FITTED = (5.0, 1100.0)
"""Band in which the filter has the measured response [Hz]: all that is felt, and a little more."""
BESIDE = 1e-2
"""Weight of the response beyond that band, which keeps the filter from rising there."""
SMALLEST = 1e-4
"""Smallest singular value, relative to the largest, that the taps are fitted with."""


@dataclass(frozen=True, kw_only=True)
class VoiceCoil:
    """Voice coil whose response under the finger was measured; an `Actuator`.

    Attributes
    ----------
    measured : callable
        Function from frequencies [Hz] to the shear displacement per volt at the terminals [m/V].
    resistance, inductance : float
        Resistance [Ω] and inductance [H] of the coil.
    largest_current : float
        Current that the coil withstands for good [A].
    room : tuple of float
        Size at rest along and across the shear direction [m].
    """

    measured: Callable[[Floats], Complex]
    resistance: float
    inductance: float
    largest_current: float
    room: tuple[float, float]

    @property
    def capacitance(self) -> float:
        """Capacitance, of which a coil has none [F]."""
        return 0.0

    @property
    def largest_travel(self) -> float:
        """Largest travel without a finger, of which nothing was measured: there is no limit [m].

        The response is that under a finger, so that a travel in air cannot be predicted. Nothing
        brittle bends: what a coil withstands is its current, which `overload` bounds.
        """
        return math.inf

    def response(self, load: FingerLoad, frequency: Floats) -> ActuatorResponse:
        """Return the measured response.

        Parameters
        ----------
        load : FingerLoad
            Load of the finger, without effect: the measurement was made under one.
        frequency : (F,) array of float
            Frequencies [Hz].

        Returns
        -------
        ActuatorResponse
            Displacement and admittance at each frequency.
        """
        f = np.asarray(frequency, np.float64)
        admittance = np.reciprocal(self.resistance + 2j * np.pi * f * self.inductance)
        return ActuatorResponse(self.measured(f), admittance)

    def overload(self, voltage: float) -> tuple[float, str]:
        """Compare the current with the largest that the coil withstands.

        Parameters
        ----------
        voltage : float
            Largest voltage at the terminals [V].

        Returns
        -------
        share : float
            Share of the largest current.
        reason : str
            Both currents.
        """
        current = voltage / self.resistance  # at low frequencies, where the inductance does nothing
        return current / self.largest_current, (
            f"{current:.3g} A through the coil exceeds {self.largest_current:g} A"
        )

    def size(self, voltage: float) -> tuple[float, float]:
        """Compute the room that the actuator needs in its opening.

        Parameters
        ----------
        voltage : float
            Largest voltage at the terminals [V].

        Returns
        -------
        tuple of float
            Size along the shear direction, with the largest travel of any frequency to both sides,
            and across it [m].
        """
        travel = voltage * float(np.abs(self.measured(np.geomspace(*FITTED, 200))).max())
        return self.room[0] + 2 * travel, self.room[1]

    def plant(
        self, load: FingerLoad, sample_rate: float, *, contactors: int, amplifier: Amplifier
    ) -> "MeasuredPlant":
        """Create the simulation of the actuators in time.

        Parameters
        ----------
        load : FingerLoad
            Load of the finger, without effect.
        sample_rate : float
            Sample rate of the drive [Hz].
        contactors : int
            Number of contactors N.
        amplifier : Amplifier
            Amplifier between drive and terminals.

        Returns
        -------
        MeasuredPlant
            Simulation of all contactors.
        """
        return MeasuredPlant(self, sample_rate, contactors=contactors, amplifier=amplifier)


class MeasuredPlant:
    """Simulation of contactors with a measured response: drive voltage in, shear and current out.

    Parameters
    ----------
    coil : VoiceCoil
        Actuator of every contactor.
    sample_rate : float
        Sample rate of the drive [Hz].
    contactors : int
        Number of contactors N.
    amplifier : Amplifier
        Amplifier between drive and terminals.

    Attributes
    ----------
    delay : int
        Delay of the outputs against the drive [samples].
    """

    def __init__(
        self, coil: VoiceCoil, sample_rate: float, *, contactors: int, amplifier: Amplifier
    ) -> None:
        # The import takes half a second, which displays of benders are spared.
        from scipy.signal import lfilter

        self._lfilter = lfilter
        frequency = np.arange(*FITTED, 2.0)
        frequency = np.append(frequency, np.arange(frequency[-1], sample_rate / 2, 20.0)[1:])
        r = coil.response(FingerLoad.none(), frequency)
        volts = amplifier.response(frequency, r.admittance, sample_rate)
        self.delay = DELAY
        self._displacement = filter_taps(r.displacement * volts, frequency, sample_rate)
        self._current = filter_taps(r.admittance * volts, frequency, sample_rate)
        self._states = np.zeros((2, TAPS - 1, contactors))

    def step(self, drive: Floats) -> tuple[Floats, Floats]:
        """Compute the response to further drive samples.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive of each contactor [V].

        Returns
        -------
        displacement : (S, N) array of float
            Shear displacement of the skin [m].
        current : (S, N) array of float
            Current into each contactor [A].
        """
        shear, self._states[0] = self._lfilter(
            self._displacement, [1.0], drive, axis=0, zi=self._states[0]
        )
        current, self._states[1] = self._lfilter(
            self._current, [1.0], drive, axis=0, zi=self._states[1]
        )
        return shear, current


def filter_taps(response: Complex, frequency: Floats, sample_rate: float) -> Floats:
    """Compute a filter that has a response, delayed by `DELAY` samples.

    The taps are the least-squares solution for the relative error over the frequencies, of which
    those beyond `FITTED` weigh less.

    Parameters
    ----------
    response : (F,) complex array
        Response at each frequency.
    frequency : (F,) array of float
        Frequencies [Hz].
    sample_rate : float
        Sample rate of the filter [Hz].

    Returns
    -------
    (TAPS,) array of float
        Taps, in the unit of the response.
    """
    weight = np.where(frequency <= FITTED[1], 1.0, BESIDE) / np.abs(response)
    turns = np.outer(frequency / sample_rate, np.arange(TAPS) - DELAY)
    matrix = weight[:, None] * np.exp(-2j * np.pi * turns)
    target = weight * response
    taps, *_ = np.linalg.lstsq(
        np.concatenate([matrix.real, matrix.imag]),
        np.concatenate([target.real, target.imag]),
        rcond=SMALLEST,
    )
    return np.asarray(taps)
