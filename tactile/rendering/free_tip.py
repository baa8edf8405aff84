"""Model of a contactor without a finger: how far a drive would swing its tip.

A bender in air is a resonator. Its first mode, driven by u and at rest at z = u, is

    z[n+1] = λ z[n] + (1 − λ) u[n]

with complex z and one pole λ. The real part of z is the tip's displacement, in units of that of one
volt at rest, and the imaginary part its velocity, in the same units at the resonance. |z| is
therefore the travel that the stored energy amounts to: no displacement exceeds it, and without
drive it never grows.

The pole is chosen so that a sinusoid of the resonance swings as far as the response in air says,
which includes the amplifier. A pole with the damping of the mode alone would swing further, by an
eighth for the default design, since other modes do a part of the displacement at rest. It would
also ring down more slowly in that proportion, and for envelopes slower than a period the two errors
cancel: what holds the limit here holds it there.
"""

import cmath
import math
from dataclasses import dataclass

import numpy as np

from tactile.arrays import Complex, Floats
from tactile.display.display import Display
from tactile.machine_code import compiled

LOWEST, GRID = 1e-4, 1000
"""Lowest of the frequencies among which a resonance is sought, as a part of half the sample rate,
and their number: they are 0.9 % apart."""
ZOOMED, ZOOMS = 40, 3
"""Number of frequencies between the neighbors of the best among which it is sought again, and
number of times that this is done."""


@dataclass(frozen=True)
class FreeTip:
    """Model of the free tip, and how far it may swing.

    Attributes
    ----------
    pole : complex
        Pole λ of the first mode at the sample rate.
    largest : float
        Largest travel, as the drive that gives it at rest [V].
    """

    pole: complex
    largest: float

    def swing(self, drive: Floats, state: Complex) -> Complex:
        """Compute how the tips of N contactors swing.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive, at least one sample [V].
        state : (N,) array of complex
            State z before the first sample [V].

        Returns
        -------
        (S, N) array of complex
            States after each sample [V].
        """
        return _swing(np.ascontiguousarray(drive, np.float64), state, self.pole)


@compiled("complex128[:, ::1](float64[:, ::1], complex128[::1], complex128)")
def _swing(drive: Floats, state: Complex, pole: complex) -> Complex:
    """Return the states (S, N) after each sample of a drive."""
    swing = np.empty(drive.shape, np.complex128)
    for n in range(len(drive)):
        for c in range(len(state)):
            before = swing[n - 1, c] if n else state[c]
            swing[n, c] = pole * before + (1 - pole) * drive[n, c]
    return swing


def free_tip_of(display: Display, sample_rate: float) -> FreeTip | None:
    """Compute the model of a display's contactors.

    Parameters
    ----------
    display : Display
        Display that plays.
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    FreeTip or None
        Model, whose largest travel is that which the actuator survives, or that at rest at the
        voltage limit if this is more: a display that was accepted can be driven at rest. None for
        an actuator whose travel has no limit.

    Examples
    --------
    The tip of the default design may swing by 141 µm, one and a half times what 100 V give at rest.

    >>> import tactile
    >>> from tactile.rendering.free_tip import free_tip_of
    >>> round(free_tip_of(tactile.load_display("reference-24"), 8000.0).largest)
    152
    """
    if math.isinf(display.actuator.largest_travel):
        return None
    resonance, at_rest, highest = _peak(display, sample_rate)
    angle = 2 * math.pi * resonance / sample_rate
    largest = max(display.actuator.largest_travel / at_rest, display.limits.voltage)
    return FreeTip(_pole(angle, highest / at_rest), largest)


def travel_voltage(display: Display, frequency: Floats, sample_rate: float) -> Floats:
    """Compute the amplitude with which a sinusoid swings a free tip to its largest travel.

    Parameters
    ----------
    display : Display
        Display that plays.
    frequency : (F,) array of float
        Frequencies [Hz].
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    (F,) array of float
        Amplitude of the drive; infinite for an actuator whose travel has no limit [V].

    Examples
    --------
    >>> import numpy as np
    >>> import tactile
    >>> from tactile.rendering.free_tip import travel_voltage
    >>> display = tactile.load_display("reference-24")
    >>> travel_voltage(display, np.array([0.0, 250.0, 930.0]), 8000.0).round(1).tolist()
    [151.8, 141.9, 2.9]
    """
    tip = free_tip_of(display, sample_rate)
    if tip is None:
        return np.full(len(frequency), np.inf)
    size = np.abs(display.response_in_air(np.append(0.0, frequency), sample_rate))
    return np.asarray(tip.largest * size[0] / size[1:])


def _peak(display: Display, sample_rate: float) -> tuple[float, float, float]:
    """Return the resonance in air [Hz], and the travel per volt at rest and there [m/V].

    The grid is so fine that a frequency of it is nearer to the first resonance than others, whose
    peaks are lower, could make up for.
    """
    frequency = np.append(0.0, np.geomspace(LOWEST, 1, GRID) * sample_rate / 2)
    first = size = np.abs(display.response_in_air(frequency, sample_rate))
    for _ in range(ZOOMS):
        best = int(size.argmax())
        low, high = frequency[max(best - 1, 0)], frequency[min(best + 1, len(size) - 1)]
        frequency = np.linspace(low, high, ZOOMED)
        size = np.abs(display.response_in_air(frequency, sample_rate))
    best = int(size.argmax())
    return float(frequency[best]), float(first[0]), float(size[best])


def _pole(angle: float, peak: float) -> complex:
    """Return the pole at an angle whose |z| comes up to a peak under a sinusoid of that angle.

    A sinusoid is two phasors, one of which is at resonance: the peak is |1 − λ|/2 times 1/(1 − |λ|)
    + 1/|λ − exp(−j angle)|, and rises with |λ|.
    """
    turn = cmath.exp(1j * angle)
    low, high = 0.0, 1.0
    for _ in range(60):
        radius = (low + high) / 2
        pole = radius * turn
        reached = abs(1 - pole) / 2 * (1 / (1 - radius) + 1 / abs(pole - turn.conjugate()))
        low, high = (radius, high) if reached < peak else (low, radius)
    return low * turn


@compiled()
def share_of_one(held: complex, added: complex, largest: float) -> float:
    """Compute how much may be added to one state, for compiled code; see `largest_share`.

    Parameters
    ----------
    held, added : complex
        State without the addition, and the addition.
    largest : float
        Largest magnitude.

    Returns
    -------
    float
        Largest share, 0 … infinity.
    """
    square = added.real * added.real + added.imag * added.imag
    if not square > 0:
        return np.inf
    along = held.real * added.real + held.imag * added.imag
    room = largest * largest - held.real * held.real - held.imag * held.imag
    return max((math.sqrt(along * along + square * max(room, 0.0)) - along) / square, 0.0)


def largest_share(held: Complex, added: Complex, largest: float) -> float:
    """Compute how much may be added to states without any exceeding a magnitude.

    Parameters
    ----------
    held, added : (...) array of complex
        States without the addition, none of which exceeds the magnitude, and the addition.
    largest : float
        Largest magnitude.

    Returns
    -------
    float
        Largest s ≥ 0 with |held + s added| ≤ largest everywhere; infinite if nothing is added.
    """
    return _largest_share(np.ravel(held), np.ravel(added), largest)


@compiled("float64(complex128[::1], complex128[::1], float64)")
def _largest_share(held: Complex, added: Complex, largest: float) -> float:
    """Return the least of the shares of one state each."""
    least = np.inf
    for k in range(len(held)):
        least = min(least, share_of_one(held[k], added[k], largest))
    return least
