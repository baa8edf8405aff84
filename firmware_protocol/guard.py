"""Guard against a contactor that leaves the finger (section 17 of SPEC.md).

`ChannelGuards` is the amplifier's side: it compares each current with what the host expects of a
contactor that touches, and turns a channel down where they part. `encode` is the host's side. All
arithmetic of the amplifier is on integers.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.correlation import Ints, rounded
from firmware_protocol.messages import (
    FULL_SCALE_CODE,
    GUARD_BLOCK,
    GUARD_BLOCKS,
    GUARD_LEAST,
    GUARD_TAPS,
    LAGS,
    GuardFlag,
    GuardReason,
)
from firmware_protocol.packet import SMALLEST

ENTRY = np.dtype(
    [("flags", "u1"), ("drive_shift", "u1"), ("change_shift", "u1"), ("zero", "u1"),
     ("limit", "<u2"), ("share", "<u2"), ("floor", "<u4"), ("poles", "<i2", (2,)),
     ("drive", "<i2", (GUARD_TAPS,)), ("change", "<i2", (GUARD_TAPS,))]
)  # fmt: skip
"""Layout of the entry of a channel."""
SHIFT_MOST = 31
"""Largest shift of an entry."""
POLE_BITS = 14
"""Number of binary places of the coefficients `poles`."""
OLDER = 2
"""Number of instants by which the current that is judged is older than the latest one."""
PAST = OLDER + 2
"""Number of earlier currents that a residual takes."""
FULL = 1 << 15
"""Gain of a channel whose guard has not tripped."""
FALL_HZ, RISE_HZ = 1000, 20
"""Inverses of the time in which the gain falls to its least, and in which it rises again [Hz]."""
GROUP_MOST = 12
"""Largest number of channels of a GUARD that `messages_of` makes."""

Floats = NDArray[np.float64]
"""Array of doubles."""
Entries = NDArray[np.void]
"""Entries of channels, an array of `ENTRY`."""


def _clamped(values: Ints) -> Ints:
    """Return values within those of a current code."""
    within: Ints = np.clip(values, -FULL_SCALE_CODE, FULL_SCALE_CODE)
    return within


def moved(gain: Ints, tripped: NDArray[np.bool_], *, rate: int, count: int) -> Ints:
    """Return the gains of channels at the next instants (section 17.4).

    Parameters
    ----------
    gain : (C,) array of int
        Present gain of each channel, `GUARD_LEAST` … `FULL`.
    tripped : (C,) array of bool
        Whether the guard of each channel has tripped.
    rate : int
        Sample rate [Hz].
    count : int
        Number of instants, S.

    Returns
    -------
    (S, C) array of int
        Gains in 1/`FULL`.
    """
    fall, rise = (-((GUARD_LEAST - FULL) // max(1, rate // hertz)) for hertz in (FALL_HZ, RISE_HZ))
    moves = np.arange(1, count + 1)[:, None]
    falling = np.maximum(gain - fall * moves, GUARD_LEAST)
    gains: Ints = np.where(tripped, falling, np.minimum(gain + rise * moves, FULL))
    return gains


class ChannelGuards:
    """Guards of all channels.

    Parameters
    ----------
    channels : int
        Number of channels C.

    Attributes
    ----------
    gain : (C,) array of int
        Present gain of each channel, `GUARD_LEAST` … `FULL`.
    reasons : (C,) array of int
        Reason for which each channel has tripped (`GuardReason`).
    active : bool
        Whether a channel is armed or held down, or an entry waits.
    """

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self.start(1)

    def start(self, rate: int) -> None:
        """Forget all entries, and set all gains to full, as at START.

        Parameters
        ----------
        rate : int
            Sample rate [Hz].
        """
        n = self._channels
        self.gain: Ints = np.full(n, FULL, np.int64)
        self.reasons: Ints = np.zeros(n, np.int64)
        self._rate = rate
        self._entries: Entries = np.zeros(n, ENTRY)
        self._pending: Entries = np.zeros(n, ENTRY)
        self._waits = np.zeros(n, np.bool_)
        self._currents: Ints = np.zeros((PAST, n), np.int64)
        self._left, self.active = GUARD_BLOCK, False
        self._sums: Ints = np.zeros((4, n), np.int64)
        self._blocks: Ints = np.zeros((GUARD_BLOCKS, 4, n), np.int64)
        self._complete: Ints = np.zeros(n, np.int64)
        self._doubted = np.zeros(n, np.bool_)

    def take(self, first: int, entries: Entries) -> None:
        """Keep entries until the block under way is over.

        Parameters
        ----------
        first : int
            First channel.
        entries : (N,) array of ENTRY
            Entries.
        """
        self._pending[first : first + len(entries)] = entries
        self._waits[first : first + len(entries)] = True
        self.active = True

    @property
    def most(self) -> int:
        """Number of instants that may be put out before the guards judge them."""
        return self._left

    @property
    def _armed(self) -> NDArray[np.bool_]:
        """Whether each channel is armed and has not tripped."""
        armed = self._entries["flags"] & GuardFlag.ARMED != 0
        return np.asarray(armed & (self.reasons == GuardReason.NONE))

    def move(self, count: int, *, ramping: bool) -> Ints:
        """Move the gains of active guards on with each instant, unless a ramp is under way.

        Parameters
        ----------
        count : int
            Number of instants, S.
        ramping : bool
            Whether RAMPDOWN is under way.

        Returns
        -------
        (S, C) array of int
            Gains at each instant, in 1/`FULL`.
        """
        tripped = self.reasons != GuardReason.NONE
        if ramping:
            return np.tile(self.gain, (count, 1))
        gains = moved(self.gain, tripped, rate=self._rate, count=count)
        self.gain = gains[-1]
        return gains

    def add(self, currents: Ints, steps: Ints | None) -> bool:
        """Judge the currents of a run that reaches to the end of a block at most.

        Parameters
        ----------
        currents : (S, C) array of int
            Current codes that are known, −32767 … 32767.
        steps : (S + L − 1, C) array of int or None
            Steps of the sample codes, from L − 1 instants before the first current on; None is
            enough for guards that are not `active`.

        Returns
        -------
        bool
            Whether a channel has tripped or was released.
        """
        count = len(currents)
        line = np.concatenate([self._currents, currents])
        self._currents = line[count:]
        if not count:
            return False
        ended = count >= self._left
        self._left = (self._left - count - 1) % GUARD_BLOCK + 1
        if steps is None:
            return False
        if self._armed.any():
            self._accumulate(line, steps, count)
        if not ended:
            return False
        tripped = bool(self._armed.any()) and self._judge()
        released = self._begin()
        held = (self.reasons != GuardReason.NONE) | (self.gain < FULL)
        self.active = bool((self._armed | held).any())
        return released or tripped

    def _begin(self) -> bool:
        """Begin a block, with the entries that have come during the last one.

        Return whether a channel that had tripped is released.
        """
        self._sums[:] = 0
        new = self._waits
        if not new.any():
            return False
        fresh = new & ~self._armed
        self._complete[fresh], self._doubted[fresh] = 0, False
        released = new & (self._pending["flags"] & GuardFlag.RELEASE != 0)
        released &= self.reasons != GuardReason.NONE
        self.reasons = np.where(released, GuardReason.NONE, self.reasons)
        self._entries[new] = self._pending[new]
        self._waits = np.zeros_like(new)
        return bool(released.any())

    def _accumulate(self, line: Ints, steps: Ints, count: int) -> None:
        """Add the squares of a run; currents begin `PAST`, steps LAGS − 1 instants earlier."""
        entries = self._entries
        drive, change = (entries[name].astype(np.int64) for name in ("drive", "change"))
        poles = entries["poles"].astype(np.int64)
        expected, gone = np.zeros((2, count, self._channels), np.int64)
        for lag in range(GUARD_TAPS):
            delayed = steps[LAGS - 1 - lag : LAGS - 1 - lag + count]
            expected += delayed * drive[:, lag]
            gone += delayed * change[:, lag]
        now = line[2 : 2 + count] << POLE_BITS
        now += line[1 : 1 + count] * poles[:, 0] + line[:count] * poles[:, 1]
        shifts = (entries[name].astype(np.int64) for name in ("drive_shift", "change_shift"))
        expected, gone = map(rounded, (expected, gone), shifts)
        residual = _clamped(rounded(now, np.full(1, POLE_BITS)) - expected)
        gone, current = _clamped(gone), line[2 : 2 + count]
        products = residual**2, current**2, residual * gone, gone**2
        self._sums += np.stack([each.sum(axis=0) for each in products])

    def _judge(self) -> bool:
        """Decide at the end of a block; return whether a channel has tripped."""
        self._blocks = np.concatenate([self._blocks[1:], self._sums[None]])
        armed = self._armed
        self._complete = np.where(armed, np.minimum(self._complete + 1, GUARD_BLOCKS), 0)
        limit = self._entries["limit"].astype(np.int64)
        share, floor = (self._entries[name].astype(np.int64) for name in ("share", "floor"))
        residual, current = self._sums[:2]
        loud = residual > GUARD_BLOCK * limit**2 + (share * current >> 16)
        product, square = self._blocks[:, 2:].sum(axis=0)
        lost = (self._complete >= GUARD_BLOCKS) & (5 * product > 3 * square) & (product > floor)
        sure = lost & self._doubted
        self._doubted = lost
        reasons = np.where(loud, GuardReason.RESIDUAL, np.where(sure, GuardReason.LOST, 0))
        self.reasons = np.where(armed, reasons, self.reasons)
        return bool((armed & (reasons != 0)).any())


# The host's side


def encode(
    flags: Ints,
    *,
    poles: Floats,
    drive: Floats,
    change: Floats,
    limit: Floats,
    share: Floats,
    floor: Floats,
) -> Entries:
    """Encode what the guards of N channels expect.

    Parameters
    ----------
    flags : (N,) array of int
        Bits of `GuardFlag`.
    poles : (N, 2) array of float
        Coefficients of earlier currents, above −2 and below 2; others are clipped.
    drive, change : (N, 13) array of float
        Coefficients of the expected current and of the change [current codes per sample code].
    limit : (N,) array of float
        Largest rms of the residual while the current is small [current codes].
    share : (N,) array of float
        Square of the largest ratio of the residual to the current, below 1.
    floor : (N,) array of float
        Least sum of residual times change that counts as a lost contact [current codes²].

    Returns
    -------
    (N,) array of ENTRY
        Entries. Limit, share and floor are rounded up: a guard rather trips later than without
        reason.
    """
    entries = np.zeros(len(flags), ENTRY)
    entries["flags"] = flags
    entries["poles"] = np.clip(np.rint(poles * (1 << POLE_BITS)), -FULL_SCALE_CODE, FULL_SCALE_CODE)
    for name, taps in (("drive", drive), ("change", change)):
        largest = np.maximum(np.abs(taps).max(axis=1), 2.0**-SHIFT_MOST)
        shift = np.clip(np.floor(np.log2(FULL_SCALE_CODE / largest)), 0, SHIFT_MOST)
        entries[f"{name}_shift"] = shift
        scaled = np.rint(taps * 2.0 ** shift[:, None])
        entries[name] = np.clip(scaled, -FULL_SCALE_CODE, FULL_SCALE_CODE)
    for name, values, most in (
        ("limit", limit, 0xFFFF), ("share", share * 2**16, 0xFFFF), ("floor", floor, 0xFFFFFFFF),
    ):  # fmt: skip
        entries[name] = np.clip(np.ceil(values), 0, most)
    return entries


def decode(message: m.Guard) -> Entries | None:
    """Decode the entries of a GUARD.

    Parameters
    ----------
    message : Guard
        Message of a host.

    Returns
    -------
    (N,) array of ENTRY or None
        Entries of its channels; None if their length is wrong.
    """
    if len(message.entries) != message.channels * ENTRY.itemsize:
        return None
    return np.frombuffer(message.entries, ENTRY)


def messages_of(
    session: int, entries: Entries, packet_limit: int, *, channels: Sequence[int]
) -> list[m.Guard]:
    """Divide entries into messages.

    Parameters
    ----------
    session : int
        Token of the session.
    entries : (C,) array of ENTRY
        Entries of all channels.
    packet_limit : int
        Largest packet [bytes].
    channels : sequence of int
        Channels of which entries are sent, in ascending order.

    Returns
    -------
    list of Guard
        Messages, each with channels that follow each other.
    """
    most = min(GROUP_MOST, (packet_limit - SMALLEST - m.Guard.HEAD.size) // ENTRY.itemsize)
    runs: list[list[int]] = []
    for channel in channels:
        if runs and runs[-1][-1] == channel - 1 and len(runs[-1]) < most:
            runs[-1].append(channel)
        else:
            runs.append([channel])
    return [m.Guard(session, run[0], len(run), entries[run].tobytes()) for run in runs]
