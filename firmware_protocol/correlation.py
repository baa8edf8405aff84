"""Correlations of measured currents with the drive that was played (section 16 of SPEC.md).

`Correlator` is the amplifier's side: it adds up the sums of a window and encodes them. `decode` is
the host's side. All arithmetic is on integers.
"""

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.messages import CORRELATED_MOST, EXPONENT_MOST, FULL_SCALE_CODE, LAGS
from firmware_protocol.packet import SMALLEST, TURN

Ints = NDArray[np.int64]
"""Array of 64-bit integers."""

ENTRY = np.dtype(
    [("flags", "u1"), ("exponent", "u1"), ("energy", "<u2"), ("sums", "<i2", (LAGS,))]
)  # fmt: skip
"""Layout of the entry of a channel."""
MANTISSA_BITS = 10
"""Number of bits of the mantissa of an energy code."""
MOST_SAMPLES = 0xFFFF
"""Largest number of samples of a window."""
ENERGY_EXPONENT_MOST = 37
"""Largest exponent of an energy code, of 65535 samples at the ends of the range."""


class Sensor(Protocol):
    """What measures voltages and currents of an amplifier in memory.

    The amplifier calls `measure` with all that it puts out, in order and in every state.
    """

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
            Current codes that are known at these instants (16.1): of the same ones, or of those
            `AmplifierConfig.current_delay` before.
        """

    def readings(self) -> tuple[Ints, Ints]:
        """Return what SENSE tells of the latest instant.

        Returns
        -------
        voltages : (C,) array of int
            Voltages [sample codes].
        currents : (C,) array of int
            Currents [µA].
        """

    def choose(self, range_ua: int) -> None:
        """Switch to another range, one of those of the amplifier's configuration.

        Parameters
        ----------
        range_ua : int
            Range of the current [µA].
        """


# The amplifier's side


def window_samples(milliseconds: int, rate: int) -> int:
    """Compute the length of a window.

    Parameters
    ----------
    milliseconds : int
        CORRELATION_MS [ms].
    rate : int
        Sample rate [Hz].

    Returns
    -------
    int
        Length [samples].
    """
    return min(milliseconds * rate // 1000, MOST_SAMPLES)


def group_of(packet_limit: int) -> int:
    """Compute the largest number of channels of a CORRELATION.

    Parameters
    ----------
    packet_limit : int
        Largest packet [bytes].

    Returns
    -------
    int
        Number of channels.
    """
    room = packet_limit - SMALLEST - m.Correlation.HEAD.size
    return min(CORRELATED_MOST, room // ENTRY.itemsize)


def rounded(values: Ints, shift: NDArray[np.int64]) -> Ints:
    """Divide by powers of 2 and round to the nearest integer, halves up.

    Parameters
    ----------
    values : array of int
        Values of less than 2⁶² in magnitude.
    shift : array of int
        Exponents, 0 … 62.

    Returns
    -------
    array of int
        ⌊values / 2^shift + ½⌋.
    """
    half: Ints = (np.int64(1) << shift) >> 1
    quotient: Ints = (values + half) >> shift
    return quotient


def exponents(sums: Ints) -> Ints:
    """Compute the exponent of each channel.

    Parameters
    ----------
    sums : (C, L) array of int
        Correlations.

    Returns
    -------
    (C,) array of int
        The least exponent with which all rounded correlations lie within ±32767.
    """
    tried = np.arange(EXPONENT_MOST + 1)
    ends = np.stack([sums.max(axis=1), sums.min(axis=1)])
    within = np.abs(rounded(ends[..., None], tried)).max(axis=0) <= FULL_SCALE_CODE
    least: Ints = np.argmax(within, axis=1)
    return least


def energy_codes(energy: Ints) -> Ints:
    """Encode energies.

    Parameters
    ----------
    energy : (C,) array of int
        Sums of squares, 0 … 2⁴⁶.

    Returns
    -------
    (C,) array of int
        Codes: an exponent, and a mantissa of `MANTISSA_BITS`.
    """
    tried = np.arange(ENERGY_EXPONENT_MOST + 1)
    mantissas = rounded(energy[:, None], tried)
    least = np.argmax(mantissas < 1 << MANTISSA_BITS, axis=1)
    codes: Ints = least << MANTISSA_BITS | mantissas[np.arange(len(energy)), least]
    return codes


def encode(sums: Ints, energy: Ints, flags: Ints) -> bytes:
    """Encode the entries of channels.

    Parameters
    ----------
    sums : (C, L) array of int
        Correlations.
    energy : (C,) array of int
        Sums of squares.
    flags : (C,) array of int
        Bits of `Window`.

    Returns
    -------
    bytes
        Entries of CORRELATION.
    """
    entries = np.zeros(len(sums), ENTRY)
    shift = exponents(sums)
    entries["flags"] = flags
    entries["exponent"] = shift
    entries["energy"] = energy_codes(energy)
    entries["sums"] = rounded(sums, shift[:, None])
    return entries.tobytes()


class CompleteWindow(NamedTuple):
    """Window whose samples have all been put out.

    Attributes
    ----------
    position : int
        Position of its first sample, not wrapped.
    samples : int
        Number of its samples.
    entries : bytes
        Entries of all channels.
    """

    position: int
    samples: int
    entries: bytes


class Correlator:
    """Sums of the window under way.

    Parameters
    ----------
    channels : int
        Number of channels C.
    delay : int
        Number of instants by which currents are late, `AmplifierConfig.current_delay`.

    Attributes
    ----------
    currents : (S, C) array of int
        Current codes that were known after the last run, −32767 … 32767.
    """

    def __init__(self, channels: int, delay: int = 0) -> None:
        self._channels, self._delay = channels, delay
        self._left = self._samples = self._position = 0
        self.start()

    def start(self) -> None:
        """Forget the codes that were played and the window under way, as at START."""
        self._past: Ints = np.zeros((LAGS + self._delay, self._channels), np.int64)
        self._skipped = self._delay
        """Number of instants to come whose currents are of instants before START."""
        self.currents = self._played = self._past[:0]
        self.stop()

    def steps(self) -> Ints:
        """Return the steps of the drive that belong to `currents`.

        Returns
        -------
        (S + L − 1, C) array of int
            Steps of the sample codes, from L − 1 instants before the first current on.
        """
        return np.diff(self._played[: len(self.currents) + LAGS], axis=0)

    def stop(self) -> None:
        """End the window under way, which is not sent."""
        self._left = 0

    def add(
        self,
        position: int,
        codes: Ints,
        currents: Ints,
        length: int,
        *,
        guarded: NDArray[np.bool_] | None = None,
    ) -> list[CompleteWindow]:
        """Add a run of instants; a window begins where none is under way.

        Parameters
        ----------
        position : int
            Position of the first instant.
        codes : (S, C) array of int
            Sample codes that were put out.
        currents : (S, C) array of int
            Current codes that are known at these instants, of instants ``delay`` before; −32768
            reads as −32767.
        length : int
            Length of a window that begins in the run [samples]; 0 for none.
        guarded : (S, C) array of bool, optional
            Whether a guard held a channel down at each instant; by default none did.

        Returns
        -------
        list of CompleteWindow
            Windows that are complete.
        """
        played = np.concatenate([self._past, codes])
        self._past = played[len(codes) :]
        at = min(self._skipped, len(codes))
        self._skipped -= at
        currents = np.maximum(currents, -FULL_SCALE_CODE)
        self.currents, self._played = currents[at:], played[at:]
        if not self._left and not length:
            return []
        steps = np.diff(played, axis=0)
        position, complete = position - self._delay, []
        while at < len(codes) and (self._left or length):
            if not self._left:
                self._begin(position + at, length)
            count = min(self._left, len(codes) - at)
            self._accumulate(steps[at : at + count + LAGS - 1], currents[at : at + count])
            if guarded is not None:
                self._flags |= np.where(guarded[at : at + count].any(axis=0), m.Window.GUARDED, 0)
            at, self._left = at + count, self._left - count
            if not self._left:
                entries = encode(self._sums, self._energy, self._flags)
                complete.append(CompleteWindow(self._position, self._samples, entries))
        return complete

    def _begin(self, position: int, length: int) -> None:
        """Begin a window."""
        self._position, self._left, self._samples = position, length, length
        self._sums: Ints = np.zeros((self._channels, LAGS), np.int64)
        self._energy: Ints = np.zeros(self._channels, np.int64)
        self._flags: Ints = np.zeros(self._channels, np.int64)

    def _accumulate(self, steps: Ints, currents: Ints) -> None:
        """Add instants to the sums; the steps of the drive begin `LAGS` − 1 instants earlier."""
        count = len(currents)
        for lag in range(LAGS):
            first = LAGS - 1 - lag
            self._sums[:, lag] += (currents * steps[first : first + count]).sum(axis=0)
        self._energy += (currents**2).sum(axis=0)
        clipped = (np.abs(currents) == FULL_SCALE_CODE).any(axis=0)
        self._flags |= np.where(clipped, m.Window.CLIPPED, 0)


def messages_of(
    window: CompleteWindow, range_ua: int, packet_limit: int
) -> Iterator[m.Correlation]:
    """Divide a window into messages.

    Parameters
    ----------
    window : CompleteWindow
        Window.
    range_ua : int
        SENSE_RANGE_UA [µA].
    packet_limit : int
        Largest packet [bytes].

    Yields
    ------
    Correlation
        Messages in the order of the channels.
    """
    channels, group = len(window.entries) // ENTRY.itemsize, group_of(packet_limit)
    for first in range(0, channels, group):
        count = min(group, channels - first)
        entries = window.entries[first * ENTRY.itemsize : (first + count) * ENTRY.itemsize]
        yield m.Correlation(
            window.position % TURN, range_ua, window.samples, first, count, LAGS, entries
        )


# The host's side


class Entries(NamedTuple):
    """Entries of a CORRELATION, decoded.

    Attributes
    ----------
    flags : (N,) array of int
        Bits of `Window`.
    sums : (N, L) array of int
        Correlations [current code × sample code], as far as the exponents keep them.
    rounding : (N,) array of float
        Largest errors of the correlations, of rounding [current code × sample code].
    energy : (N,) array of int
        Sums of squares [current code²], within 0.1 %.
    """

    flags: NDArray[np.uint8]
    sums: Ints
    rounding: NDArray[np.float64]
    energy: Ints


def decode(message: m.Correlation) -> Entries | None:
    """Decode the entries of a CORRELATION, after the checks of section 16.4.

    Parameters
    ----------
    message : Correlation
        Message of an amplifier.

    Returns
    -------
    Entries or None
        Entries of its channels; None if the message is not valid.
    """
    count = message.channels
    if not (message.range_ua and message.samples and count) or message.lags != LAGS:
        return None
    size, rest = divmod(len(message.entries), count)
    if rest or size < ENTRY.itemsize:
        return None
    table = np.frombuffer(message.entries, np.uint8).reshape(count, size)
    entries = np.ascontiguousarray(table[:, : ENTRY.itemsize]).view(ENTRY)[:, 0]
    if entries["exponent"].max() > EXPONENT_MOST:
        return None
    codes = entries["energy"].astype(np.int64)
    mantissa, shift = codes & ((1 << MANTISSA_BITS) - 1), codes >> MANTISSA_BITS
    if shift.max() > ENERGY_EXPONENT_MOST:
        return None
    exponent = entries["exponent"].astype(np.int64)
    sums = entries["sums"].astype(np.int64) << exponent[:, None]
    rounding = ((np.int64(1) << exponent) >> 1).astype(np.float64)
    return Entries(entries["flags"].copy(), sums, rounding, mantissa << shift)
