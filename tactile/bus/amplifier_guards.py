"""Guards of one amplifier as its host sees them: settings that wait to be sent, and reports.

`AmplifierGuards` converts what the caller of a bus sets to the codes of the amplifier, keeps it
until the link has time for it, and checks what the amplifier reports (SPEC.md, 17). It has neither
I/O nor a clock.
"""

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.guard import ENTRY, GROUP_MOST, Entries, encode, messages_of
from firmware_protocol.messages import FULL_SCALE_CODE, GuardFlag, GuardReason
from tactile.bus.correlations import CorrelationCounters
from tactile.bus.guards import GuardReport, GuardSettings

KEPT_FLAGS = 0xFF ^ GuardFlag.RELEASE
"""Flags of an entry whose release is taken back."""


class AmplifierGuards:
    """Guards of one amplifier since a START.

    Entries wait in the order in which their channels were first set, so that no channel is left
    out where the link does not keep up. A later entry of a channel takes the place of the earlier
    one, and with it a release that waits: the caller has asked for the release because of a trip
    that it knows, and need not ask again. A release is taken back when the amplifier reports a trip
    that came after it was asked for, since it must not undo what the caller did not know of.

    It has no lock; its owner calls it under its own.

    Parameters
    ----------
    counters : CorrelationCounters
        Counters of the bus.
    caps : Caps
        Capabilities of the amplifier.
    first_channel : int
        First channel of the amplifier on the display.
    start : int
        Position of the START, on the scale of the bus.
    """

    def __init__(
        self, counters: CorrelationCounters, caps: m.Caps, first_channel: int, start: int
    ) -> None:
        self._counters, self._caps = counters, caps
        self._first, self._start = first_channel, start
        self._entries: Entries = np.zeros(caps.channels, ENTRY)
        self._waiting: dict[int, None] = {}
        """Channels of the amplifier whose entries wait, in the order in which they are sent."""
        self._tripped = np.zeros(caps.channels, np.bool_)

    @property
    def waits(self) -> bool:
        """Whether an entry waits to be sent."""
        return bool(self._waiting)

    def forget(self) -> None:
        """Drop all entries that wait."""
        self._waiting.clear()
        self._entries["flags"] = 0

    def set(self, settings: GuardSettings, range_ua: int) -> None:
        """Let the settings of the amplifier's own channels wait to be sent.

        Parameters
        ----------
        settings : GuardSettings
            Settings of any channels of the display. Those of a channel that are not finite are
            left out.
        range_ua : int
            Range of the current of the amplifier [µA]; 0 if it is not known, upon which nothing
            is kept.
        """
        channels = np.asarray(settings.channels) - self._first
        own = (channels >= 0) & (channels < self._caps.channels) & _finite(settings)
        if not range_ua or not own.any():
            return
        channels, entries = channels[own], self._encoded(settings, own, range_ua)
        entries["flags"] |= self._entries["flags"][channels] & np.uint8(GuardFlag.RELEASE)
        self._entries[channels] = entries
        self._waiting.update(dict.fromkeys(channels.tolist()))

    def _encoded(self, settings: GuardSettings, own: NDArray[np.bool_], range_ua: int) -> Entries:
        """Return entries in current codes and sample codes."""
        ampere = range_ua * 1e-6 / FULL_SCALE_CODE
        volt = self._caps.full_scale_uv * 1e-6 / FULL_SCALE_CODE
        flags = settings.armed[own] * int(GuardFlag.ARMED)
        flags = flags + settings.release[own] * int(GuardFlag.RELEASE)
        return encode(
            flags,
            poles=settings.poles[own],
            drive=settings.drive[own] * (volt / ampere),
            change=settings.change[own] * (volt / ampere),
            limit=settings.limit[own] / ampere,
            share=np.full(len(flags), settings.share),
            floor=settings.floor[own] / ampere**2,
        )

    def take(self, session: int, most: int = GROUP_MOST) -> m.Guard | None:
        """Remove and return what is to be sent next.

        Parameters
        ----------
        session : int
            Token of the session.
        most : int
            Largest number of channels, at least 1; a small packet of the amplifier has fewer.

        Returns
        -------
        Guard or None
            Entries of channels that follow each other; None if nothing waits.
        """
        channels = list(islice(self._waiting, most))
        if not channels:
            return None
        limit = self._caps.packet_limit
        message = messages_of(session, self._entries, limit, channels=channels)[0]
        first, end = message.first_channel, message.first_channel + message.channels
        self._entries["flags"][first:end] = 0
        for channel in range(first, end):
            self._waiting.pop(channel, None)  # an e-stop may have emptied it meanwhile
        return message

    def decode(self, message: m.Guarded, position: int, reached: int) -> GuardReport | None:
        """Decode a report.

        Parameters
        ----------
        message : Guarded
            Message of the amplifier.
        position : int
            Its position on the scale of the bus.
        reached : int
            Position that the amplifier puts out next, as far as known.

        Returns
        -------
        GuardReport or None
            The report; None if it is from before the START, or cannot be right, which is counted.
        """
        caps = self._caps
        if len(message.reasons) != caps.channels or position > reached + caps.fifo_samples:
            self._counters.faults += 1
            return None
        if position < self._start:
            return None
        tripped = np.frombuffer(message.reasons, np.uint8) != GuardReason.NONE
        self._entries["flags"][tripped & ~self._tripped] &= np.uint8(KEPT_FLAGS)
        self._tripped = tripped
        return GuardReport(position, self._first, tripped)


def _finite(settings: GuardSettings) -> NDArray[np.bool_]:
    """Return which channels have finite settings."""
    tables = settings.poles, settings.drive, settings.change
    finite = np.isfinite(settings.limit) & np.isfinite(settings.floor) & np.isfinite(settings.share)
    for table in tables:
        finite &= np.isfinite(table).all(axis=1)
    return np.asarray(finite)
