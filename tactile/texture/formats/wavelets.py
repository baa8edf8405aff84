"""Wavelet blocks of MPEG-I Haptics (ISO/IEC 23090-31), decoded to samples.

A block is a string of base64 characters of 6 bits each, the most significant first. An adaptive
binary arithmetic coder with seven contexts gives decisions from these bits, and a set partitioning
in hierarchical trees (SPIHT; Said and Pearlman, IEEE Trans. Circuits Syst. Video Technol. 6(3),
1996) gives wavelet coefficients from the decisions, one bit plane after the other. The coefficients
are those of the biorthogonal 9/7 wavelet with whole-sample symmetric extension, whose inverse is
computed by lifting (Daubechies and Sweldens, J. Fourier Anal. Appl. 4(3), 1998).
"""

import string
from collections.abc import Iterator
from itertools import chain, repeat

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError

SHORTEST, LONGEST = 16, 2**14
"""Smallest and largest number of samples of a block, a power of two."""
BASE64 = string.ascii_uppercase + string.ascii_lowercase + string.digits + "+/"
"""Characters of a stream, in order of their values."""
HEADER, SIGN, PIXEL, TREE, CHILD, SUBTREE, REFINEMENT = range(7)
"""Contexts of the arithmetic coder."""
DIGITS = 10
"""Number of bits of the range of the arithmetic coder."""
FULL = 2**DIGITS
"""Range of the arithmetic coder."""
PLANES_BITS, SCALE_BITS = 4, 7
"""Lengths of the header's number of bit planes and of its scale [bits]."""
ALPHA, BETA, GAMMA, DELTA = -1.586134342, -0.052980118, 0.882911075, 0.443506852
"""Lifting coefficients of the 9/7 wavelet, at which the low band has a gain of `ZETA`."""
ZETA = 1.149604398
"""Scale of the low band, and inverse scale of the high band, after lifting."""


class _Decoder:
    """Adaptive binary arithmetic decoder of the bits of a stream, which zeros follow."""

    def __init__(self, stream: str) -> None:
        values = (BASE64.index(character) for character in stream)
        bits = (value >> shift & 1 for value in values for shift in range(5, -1, -1))
        self._bits: Iterator[int] = chain(bits, repeat(0))
        self._value = 0
        for _ in range(DIGITS):
            self._value = self._value << 1 | next(self._bits)
        self._low, self._high = 0, FULL
        self._zeros, self._total = [8] * 7, [16] * 7

    def bit(self, context: int) -> int:
        """Return the next decision in a context."""
        span, total = self._high - self._low, self._total[context]
        chance = (2 * FULL * self._zeros[context] + total) // (2 * total)
        split = self._low + min(max(span * chance // FULL, 1), span - 1)
        one = self._value >= split
        if one:
            self._low = split
        else:
            self._high = split
            self._zeros[context] += 1
        self._total[context] += 1
        self._widen()
        return int(one)

    def _widen(self) -> None:
        """Double the range about 0, its middle or its end for as long as it fits."""
        while True:
            if self._high <= FULL // 2:
                offset = 0
            elif self._low >= FULL // 2:
                offset = FULL // 2
            elif self._low >= FULL // 4 and self._high <= 3 * FULL // 4:
                offset = FULL // 4
            else:
                return
            self._low, self._high = 2 * (self._low - offset), 2 * (self._high - offset)
            self._value = 2 * (self._value - offset) | next(self._bits)

    def number(self, length: int) -> int:
        """Return a number of the header, whose least significant bit comes first."""
        return sum(self.bit(HEADER) << k for k in range(length))


def decoded(stream: str, count: int) -> Floats:
    """Decode one block.

    Parameters
    ----------
    stream : str
        Block in base64, without padding.
    count : int
        Number of samples, a power of two from 16 to 16384.

    Returns
    -------
    (count,) array of float
        Samples, where 1 is the maximum of the device.

    Raises
    ------
    InputError
        If the stream is not base64 or the number of samples not possible.
    """
    if not SHORTEST <= count <= LONGEST or count & count - 1:
        raise InputError(
            f"has blocks of {count} samples: must be a power of two, {SHORTEST} … {LONGEST}"
        )
    if wrong := set(stream) - set(BASE64):
        raise InputError(f"wavelet_stream has {min(wrong)!r}: must be base64")
    decoder = _Decoder(stream)
    planes = decoder.number(PLANES_BITS)
    large = decoder.bit(HEADER)
    scale = decoder.number(SCALE_BITS) / (2**4 if large else 2**7) + large
    coefficients = _Trees(decoder, count).coefficients(planes)
    return _inverse(np.array(coefficients, np.float64) * scale / 2**planes)


class _Trees:
    """Coefficients of a block, as set partitioning in hierarchical trees refines them.

    The children of coefficient k are 2k and 2k + 1. The first eight coefficients are roots, and
    those from the fourth on have children.
    """

    def __init__(self, decoder: _Decoder, count: int) -> None:
        self._bit, self._count = decoder.bit, count
        self._values = [0] * count
        self._insignificant = list(range(8))
        self._sets = [(k, False) for k in range(4, 8)]
        self._significant: list[int] = []

    def coefficients(self, planes: int) -> list[int]:
        """Return the coefficients after all bit planes, from the highest one down to 0."""
        for plane in range(planes, -1, -1):
            known = len(self._significant)
            self._sort(1 << plane)
            for k in self._significant[:known]:
                if self._bit(REFINEMENT):
                    self._values[k] += (1 << plane) if self._values[k] > 0 else -(1 << plane)
        return self._values

    def _sort(self, size: int) -> None:
        """Find the coefficients that become significant in a bit plane."""
        waiting, self._insignificant = self._insignificant, []
        for k in waiting:
            self._examine(k, size, PIXEL)
        sets, self._sets = self._sets, []
        for k, beyond_children in sets:  # grows meanwhile
            if not self._bit(SUBTREE if beyond_children else TREE):
                self._sets.append((k, beyond_children))
            elif beyond_children:
                sets += [(2 * k, False), (2 * k + 1, False)]
            else:
                self._examine(2 * k, size, CHILD)
                self._examine(2 * k + 1, size, CHILD)
                if 4 * k + 3 < self._count:
                    sets.append((k, True))

    def _examine(self, k: int, size: int, context: int) -> None:
        """Read whether a coefficient becomes significant, and its sign."""
        if self._bit(context):
            self._values[k] = size if self._bit(SIGN) else -size
            self._significant.append(k)
        else:
            self._insignificant.append(k)


def _inverse(coefficients: Floats) -> Floats:
    """Return the samples of which an array holds the transform, the lowest four values first."""
    signal = coefficients[:4]
    while len(signal) < len(coefficients):
        low, high = signal / ZETA, -ZETA * coefficients[len(signal) : 2 * len(signal)]
        low = low - DELTA * (high + np.append(high[0], high[:-1]))
        high = high - GAMMA * (low + np.append(low[1:], low[-1]))
        low = low - BETA * (high + np.append(high[0], high[:-1]))
        high = high - ALPHA * (low + np.append(low[1:], low[-1]))
        signal = np.stack([low, high], axis=1).ravel()
    return signal
