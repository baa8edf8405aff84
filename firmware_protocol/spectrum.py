"""Spectrum frames in exact integers: sine, envelopes, ramps and output (SPEC.md, section 10).

A channel's drive is a sum of P carriers of fixed frequency, each with a complex envelope that the
host sends a few times a second and that runs straight from frame to frame. Whoever computes it so
gets the same codes to the last bit:

- A carrier's angle at sample position n is increment × n mod 2³², 2³² to the turn: it drifts
  nowhere, and after a lost frame, or on another board, it is the same.
- `SINE`, 1024 steps to the turn, is read between its entries in 16-bit fractions.
- An envelope is two bytes: amplitude in steps of 0.25 dB below full scale, 0 for none, and phase in
  256ths of a turn. It becomes I and Q in units of 1/256 sample code.
- A ramp over several samples has one integer step, rounded toward zero; it ends exactly at its
  frame, so that rounding never adds up.
- The output is Σ I cos θ − Q sin θ, rounded to sample codes, where ±32767 is full scale.

The envelope that a ramp has reached is a whole number as well: a ramp may be taken up at any
sample from what it has reached there. All sums stay below 2⁴⁸ for 64 carriers.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Codes = NDArray[np.uint8]
Complex = NDArray[np.complex128]
Increments = NDArray[np.uint32]
Integers = NDArray[np.int64]

FULL_SCALE = 32767
TURN = 1 << 32
QUARTER = TURN // 4
QUEUE = 4
"""Frames that wait for their turn, per channel (section 10.3)."""
SINE: Integers = np.rint(FULL_SCALE * np.sin(2 * np.pi * np.arange(1025) / 1024)).astype(np.int64)
"""(1025,) sample codes, one turn and its end."""
STEPS_PER_DECADE = 80
"""Of amplitude: 0.25 dB each."""
LOUDEST = 255
AMPLITUDE: Integers = np.rint(
    FULL_SCALE * 256 * 10.0 ** ((np.arange(256) - LOUDEST) / STEPS_PER_DECADE)
).astype(np.int64)
"""(256,) by code, in 1/256 sample code."""
AMPLITUDE[0] = 0


def sine(angle: ArrayLike) -> Integers:
    """Return the sine of angles (2³² to the turn, taken modulo that), full scale 32767."""
    theta = np.asarray(angle).astype(np.int64) % TURN
    index, fraction = theta >> 22, (theta >> 6) & 0xFFFF
    low = SINE[index]
    return np.asarray(low + (((SINE[index + 1] - low) * fraction + (1 << 15)) >> 16))


def cosine(angle: ArrayLike) -> Integers:
    """Return the cosine: the sine a quarter of a turn on."""
    return sine(np.asarray(angle).astype(np.int64) % TURN + QUARTER)


def increments(frequency_hz: ArrayLike, sample_rate_hz: float) -> Increments:
    """Return the nearest turns per sample × 2³² of carriers (P,) [Hz]."""
    turns = np.rint(np.asarray(frequency_hz, np.float64) / sample_rate_hz * TURN)
    return (turns.astype(np.int64) % TURN).astype(np.uint32)


def encode(envelope: Complex) -> Codes:
    """Return envelopes as bytes.

    Parameters
    ----------
    envelope : (N, P) of full scale

    Returns
    -------
    (N, P, 2) ndarray
        Code of amplitude and of phase, as they are on the wire: the nearest in dB and in angle.
        Above full scale the amplitude is full scale; less than half a step under the lowest code
        counts for that code, anything below for nothing.
    """
    size = np.abs(envelope)
    steps = np.rint(LOUDEST + STEPS_PER_DECADE * np.log10(np.maximum(size, 1e-9)))
    turns = np.rint(np.angle(envelope) * (128 / np.pi)).astype(np.int64) & 0xFF
    return np.stack([np.clip(steps, 0, LOUDEST), turns], axis=-1).astype(np.uint8)


def decode(codes: Codes) -> tuple[Integers, Integers]:
    """Return I and Q, (N, P) each in 1/256 sample code, of codes (N, P, 2)."""
    amplitude = AMPLITUDE[codes[..., 0]]
    angle = codes[..., 1].astype(np.int64) << 24
    half = 1 << 14
    return (amplitude * cosine(angle) + half) >> 15, (amplitude * sine(angle) + half) >> 15


def ramp_step(start: Integers, end: Integers, samples: int) -> Integers:
    """Return what an envelope changes by per sample, rounded toward zero."""
    change = end - start
    return np.asarray(np.sign(change) * (np.abs(change) // samples))


def synthesize(
    in_phase: Integers,
    quadrature: Integers,
    step_i: Integers,
    step_q: Integers,
    increment: Increments,
    position: int,
    count: int,
) -> Integers:
    """Return the output codes of a piece of one ramp.

    Parameters
    ----------
    in_phase, quadrature : (N, P) envelopes at the first sample
    step_i, step_q : (N, P) what they change by per sample; zero where they hold
    increment : (P,) of the carriers
    position : of the first sample
    count : S; the ramp's end is none of them

    Returns
    -------
    (S, N) int64 ndarray
        Sample codes, −32767 … 32767.
    """
    sample = np.arange(count)
    place = ((position + sample) % TURN).astype(np.uint64)
    angle = place[:, None] * increment.astype(np.uint64) % np.uint64(TURN)
    cos, sin = cosine(angle), sine(angle)
    total = cos @ in_phase.T - sin @ quadrature.T
    total += sample[:, None] * (cos @ step_i.T - sin @ step_q.T)
    return np.asarray(np.clip((total + (1 << 22)) >> 23, -FULL_SCALE, FULL_SCALE))
