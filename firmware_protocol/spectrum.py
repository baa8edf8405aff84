"""Synthesis of spectrum frames in exact integers (section 10 of SPEC.md).

The drive of a channel is a sum of P carriers of fixed frequency. Each carrier has a complex
envelope that the host sends a few times per second and that is interpolated linearly from frame to
frame. Every implementation of these rules yields the same codes to the last bit:

- The angle of a carrier at sample position n is increment × n mod 2³², with 2³² per turn. It does
  not drift, and it is the same after a lost frame and on another board.
- `SINE`, with 1024 steps per turn, is interpolated linearly with 16-bit fractions.
- An envelope is two bytes: the amplitude in steps of 0.25 dB below full scale, 0 for none, and the
  phase in 256ths of a turn. They are converted to I and Q in units of 1/256 sample code.
- A ramp over several samples has one integer step, rounded toward zero. It ends exactly at its
  frame, so that rounding errors do not accumulate.
- The output is Σ I cos θ − Q sin θ, rounded to sample codes, where ±32767 is full scale.

The envelope that a ramp has reached is an integer as well, so that a ramp can be continued at any
sample. All sums stay below 2⁴⁸ for 64 carriers.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_protocol.messages import FULL_SCALE_CODE
from firmware_protocol.packet import TURN

Codes = NDArray[np.uint8]
"""Array of coded envelopes."""
Complex = NDArray[np.complex128]
Increments = NDArray[np.uint32]
"""Array of phase increments [turns per sample × 2³²]."""
Integers = NDArray[np.int64]
"""Array of 64-bit integers."""

QUARTER = TURN // 4
"""Angle of a quarter turn."""
QUEUE = 4
"""Largest number of frames that are queued per channel (section 10.3)."""
SINE: Integers = np.rint(FULL_SCALE_CODE * np.sin(2 * np.pi * np.arange(1025) / 1024)).astype(
    np.int64
)
"""Table (1025,) of a full turn of the sine and its end, in sample codes."""
STEPS_PER_DECADE = 80
"""Number of amplitude steps per decade, 0.25 dB each."""
LOUDEST = 255
"""Amplitude code of full scale."""
AMPLITUDE: Integers = np.rint(
    FULL_SCALE_CODE * 256 * 10.0 ** ((np.arange(256) - LOUDEST) / STEPS_PER_DECADE)
).astype(np.int64)
"""Table (256,) of the amplitude by code [1/256 sample code]."""
AMPLITUDE[0] = 0


def sine(angle: ArrayLike) -> Integers:
    """Compute the sine.

    Parameters
    ----------
    angle : array_like of int
        Angles, 2³² per turn, taken modulo a turn.

    Returns
    -------
    array of int
        Sine, with a full scale of 32767.
    """
    theta = np.asarray(angle).astype(np.int64) % TURN
    index, fraction = theta >> 22, (theta >> 6) & 0xFFFF
    low = SINE[index]
    return np.asarray(low + (((SINE[index + 1] - low) * fraction + (1 << 15)) >> 16))


def cosine(angle: ArrayLike) -> Integers:
    """Compute the cosine, as the sine a quarter turn later.

    Parameters
    ----------
    angle : array_like of int
        Angles, 2³² per turn, taken modulo a turn.

    Returns
    -------
    array of int
        Cosine, with a full scale of 32767.
    """
    return sine(np.asarray(angle).astype(np.int64) % TURN + QUARTER)


def increments(frequency_hz: ArrayLike, sample_rate_hz: float) -> Increments:
    """Compute the phase increments of carriers.

    Parameters
    ----------
    frequency_hz : (P,) array_like of float
        Frequencies of the carriers [Hz].
    sample_rate_hz : float
        Sample rate [Hz].

    Returns
    -------
    (P,) array of int
        Nearest phase increments [turns per sample × 2³²].
    """
    turns = np.rint(np.asarray(frequency_hz, np.float64) / sample_rate_hz * TURN)
    return (turns.astype(np.int64) % TURN).astype(np.uint32)


def encode(envelope: Complex) -> Codes:
    """Encode envelopes, each as the nearest amplitude in dB and the nearest phase.

    An amplitude above full scale is encoded as full scale. An amplitude below the lowest code is
    encoded as the lowest one if it is less than half a step lower, otherwise as none.

    Parameters
    ----------
    envelope : (N, P) complex array
        Envelopes relative to full scale.

    Returns
    -------
    (N, P, 2) array of int
        Codes of amplitude and phase, as on the wire.
    """
    size = np.abs(envelope)
    steps = np.rint(LOUDEST + STEPS_PER_DECADE * np.log10(np.maximum(size, 1e-9)))
    turns = np.rint(np.angle(envelope) * (128 / np.pi)).astype(np.int64) & 0xFF
    return np.stack([np.clip(steps, 0, LOUDEST), turns], axis=-1).astype(np.uint8)


def decode(codes: Codes) -> tuple[Integers, Integers]:
    """Decode envelopes.

    Parameters
    ----------
    codes : (N, P, 2) array of int
        Codes of amplitude and phase.

    Returns
    -------
    in_phase, quadrature : (N, P) array of int
        I and Q [1/256 sample code].
    """
    amplitude = AMPLITUDE[codes[..., 0]]
    angle = codes[..., 1].astype(np.int64) << 24
    half = 1 << 14
    return (amplitude * cosine(angle) + half) >> 15, (amplitude * sine(angle) + half) >> 15


def truncated(numerator: Integers, denominator: Integers | int) -> Integers:
    """Divide integers, truncating toward zero.

    Parameters
    ----------
    numerator : array of int
        Numerator.
    denominator : int or array of int
        Denominator, above zero.

    Returns
    -------
    array of int
        Quotient.
    """
    return np.asarray(np.sign(numerator) * (np.abs(numerator) // denominator))


def ramp_step(start: Integers, end: Integers, samples: int) -> Integers:
    """Compute the change of an envelope per sample, rounded toward zero.

    Parameters
    ----------
    start, end : array of int
        Envelope at the first and at the last sample of the ramp [1/256 sample code].
    samples : int
        Length of the ramp [samples].

    Returns
    -------
    array of int
        Change per sample [1/256 sample code].
    """
    return truncated(end - start, samples)


def synthesize(
    in_phase: Integers,
    quadrature: Integers,
    step_i: Integers,
    step_q: Integers,
    increment: Increments,
    position: int,
    count: int,
) -> Integers:
    """Synthesize a piece of a ramp.

    Parameters
    ----------
    in_phase, quadrature : (N, P) array of int
        Envelopes at the first sample [1/256 sample code].
    step_i, step_q : (N, P) array of int
        Change of the envelopes per sample; zero where they hold [1/256 sample code].
    increment : (P,) array of int
        Phase increments of the carriers [turns per sample × 2³²].
    position : int
        Position of the first sample.
    count : int
        Number of samples S; the end of the ramp is not among them.

    Returns
    -------
    (S, N) array of int
        Sample codes, −32767 … 32767.
    """
    sample = np.arange(count)
    place = ((position + sample) % TURN).astype(np.uint64)
    angle = place[:, None] * increment.astype(np.uint64) % np.uint64(TURN)
    cos, sin = cosine(angle), sine(angle)
    total = cos @ in_phase.T - sin @ quadrature.T
    total += sample[:, None] * (cos @ step_i.T - sin @ step_q.T)
    return np.asarray(np.clip((total + (1 << 22)) >> 23, -FULL_SCALE_CODE, FULL_SCALE_CODE))
