"""Choice of a coding of the drive that fits a link.

A coding is a sample format, or spectrum frames, at a rate and for a number of channels.

The budget includes all that the host sends regularly: PCM or spectrum packets as the encoders make
them, HEARTBEAT and TIME. On media that both directions share, CAN and I²C, it also includes PULSE
and TIME_REPLY of each amplifier, and CORRELATION if that is asked for. Where replies have a
direction of their own, they are held against that. If CORRELATION is asked for and amplifiers have
guards, the budget also includes GUARD, as a host sends it that follows the finger on all channels.
Requests and the eight time probes before a start are not included, nor is GUARDED, which an
amplifier sends only when a finger has left a contactor, nor are MARK and MARKED, which are as rare
as stimuli. The number of CAN's stuff bits is the mean
for random data. A part of the wire remains free (`Link.cap`): for the stuff bits of quiet drive
(the maximum on CAN is a fifth more), for repetitions after errors, and for the jitter of the host.
"""

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from firmware_protocol import correlation, guard
from firmware_protocol import messages as m
from firmware_protocol.clock import INTERVAL
from firmware_protocol.host import pcm
from firmware_protocol.messages import HEARTBEAT_MS, PACKET_MAX, Feature, SampleFormat
from firmware_protocol.packet import SMALLEST, Packet, encode_packet
from tactile.bus.base import Wiring
from tactile.bus.wire_time import Link, above_zero
from tactile.errors import InputError

RATE = 8000
"""Sample rate that is tried first unless another is requested [Hz]."""
LOWER_RATES = (5000, 4000, 2500)
"""Lower sample rates that are tried next [Hz]."""
SAMPLES_PER_HERTZ = 2.5
"""Smallest ratio of the sample rate to the band that the samples must carry."""
PCM_FORMATS = (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8)
"""Sample formats in decreasing order of fidelity.

Their signal-to-error ratios with textures are 80, 60 and 43 dB (`python -m benchmarks protocol`).
"""
SPECTRA = ((16, 50.0), (8, 100.0))
"""Number of carriers and frame rate [Hz] of the spectrum codings."""
PACKET_SECONDS = (2e-3, 4e-3)
"""Duration that a packet of samples may have: a playback block of 16 at 8 kHz, or two [s]."""

PULSE_INTERVAL = 10e-3
"""Interval between PULSE messages of an amplifier (firmware_protocol/SPEC.md, parameter 2) [s].

On I²C the host is assumed to read as often, and once more for each TIME_REPLY.
"""
GUARD_INTERVAL = 50e-3
"""Interval between GUARD entries of a channel [s].

It is half of what firmware_protocol/SPEC.md, 17.2, allows while a finger is there, so that an entry
may be lost.
"""
GUARD_CHANNELS = 4
"""Largest number of channels of a GUARD.

A packet of 284 bytes then delays the drive by less than 1 ms on a UART of 3 Mbit/s and on CAN FD.
"""
GUARD_TIME = 1e-3
"""Time that a GUARD may take on a slow link, unless it has one channel only: so long the drive
waits for it, whose lead is 6 ms at least [s]."""
BOARD_CHANNELS = 255
"""Largest number of channels of an amplifier (u8).

Amplifiers that have not been asked are assumed to have as many.
"""
MOST_BOARDS = 127
"""Number of available addresses."""


# Abilities of amplifiers


@dataclass(frozen=True)
class Ability:
    """Common abilities of all amplifiers of a display; unlimited by default.

    Attributes
    ----------
    formats : frozenset of SampleFormat
        Sample formats that the amplifiers play.
    rate_min, rate_max : float
        Lowest and highest sample rate [Hz].
    carriers : int
        Largest number of carriers.
    packet_limit : int
        Largest size of a packet [bytes].
    channels : tuple of int
        Number of channels of each board, in the order of the display's channels.
    guards : bool
        Whether amplifiers have guards. One that has is enough, and all are then counted.
    """

    formats: frozenset[SampleFormat] = frozenset(SampleFormat)
    rate_min: float = 0.0
    rate_max: float = math.inf
    carriers: int = m.CARRIERS_MAX
    packet_limit: int = PACKET_MAX
    channels: tuple[int, ...] = ()
    guards: bool = True

    @classmethod
    def of(cls, boards: Sequence[m.Caps]) -> "Ability":
        """Return the common abilities of one or several amplifiers.

        Parameters
        ----------
        boards : sequence of Caps
            What each amplifier has reported.

        Returns
        -------
        Ability
            Abilities that all of them have.
        """
        return cls(
            formats=frozenset(f for f in SampleFormat if all(b.formats >> f & 1 for b in boards)),
            rate_min=max(b.rate_min_hz for b in boards),
            rate_max=min(b.rate_max_hz for b in boards),
            carriers=min(b.carriers for b in boards),
            packet_limit=min(b.packet_limit for b in boards),
            channels=tuple(b.channels for b in boards),
            guards=any(b.features & Feature.GUARDS for b in boards),
        )

    @property
    def rate(self) -> int:
        """Sample rate that is tried first: the one nearest to the usual rate [Hz]."""
        return int(min(max(RATE, self.rate_min), self.rate_max))

    def shares(self, channels: int) -> Iterator[int]:
        """Yield how many of the channels each board drives.

        If there are not enough boards, more boards like the last one are assumed.

        Parameters
        ----------
        channels : int
            Number of channels of the display.

        Yields
        ------
        int
            Number of channels of one board.
        """
        boards = [count for count in self.channels if count] or [BOARD_CHANNELS]
        while channels > 0:
            share = min(boards.pop(0) if len(boards) > 1 else boards[0], channels)
            yield share
            channels -= share


# Codings and their packets


def check_limits(wiring: Wiring, caps: Sequence[m.Caps]) -> None:
    """Check that the demands of a display are within the limits of its amplifiers.

    Parameters
    ----------
    wiring : Wiring
        Demands of the display.
    caps : sequence of Caps
        What each amplifier has reported.

    Raises
    ------
    InputError
        If the number of channels, the voltage or the slew exceeds what the amplifiers can do.
    """
    available = sum(c.channels for c in caps)
    if available < wiring.channels:
        raise InputError(f"the display has {wiring.channels} channels, the amplifiers {available}")
    for name, demand, limit, scale, unit in (
        ("voltage_v", wiring.voltage, min(c.voltage_limit_uv for c in caps), 1e-6, "V"),
        ("slew_v_per_us", wiring.slew, min(c.slew_limit_v_per_s for c in caps), 1.0, "V/s"),
    ):
        if int(demand / scale) > limit:  # LIMITS transmits whole units
            raise InputError(
                f"limits.{name}: the display's {demand:g} {unit} is more than the amplifier's "
                f"{limit * scale:g} {unit}; lower it in the display file"
            )


@dataclass(frozen=True)
class Coding:
    """Coding of the drive: samples in a format, or spectrum frames.

    Attributes
    ----------
    sample_format : SampleFormat
        Format of the samples; SPECTRUM8 for frames.
    sample_rate : int
        Sample rate [Hz].
    carriers : int
        Number of carriers of frames; 0 for samples.
    frame_rate : float
        Frames per second [Hz]; 0 for samples.
    """

    sample_format: SampleFormat
    sample_rate: int
    carriers: int = 0
    frame_rate: float = 0.0

    @property
    def name(self) -> str:
        """Name for messages, without the sample rate."""
        if self.carriers:
            return f"SPECTRUM {self.carriers} at {self.frame_rate:g} Hz"
        return self.sample_format.name

    def __str__(self) -> str:
        return self.name if self.carriers else f"{self.name} at {self.sample_rate} Hz"

    @property
    def packet_samples(self) -> tuple[int, ...]:
        """Numbers of samples that a packet may span, in increasing order."""
        if self.carriers:
            return (max(round(self.sample_rate / self.frame_rate), 1),)
        return tuple(max(round(self.sample_rate * s), 1) for s in PACKET_SECONDS)


@lru_cache(maxsize=256)
def packets_of(coding: Coding, samples: int, channels: int, limit: int) -> list[bytes]:
    """Return the packets with which one amplifier receives a number of samples.

    The content of the packets is zero.

    Parameters
    ----------
    coding : Coding
        Coding of the drive.
    samples : int
        Number of samples; it has no effect on spectrum frames.
    channels : int
        Number of channels of the amplifier.
    limit : int
        Largest size of a packet [bytes].

    Returns
    -------
    list of bytes
        Packets; empty if the limit is too small for any.
    """
    if coding.carriers:
        return list(_frames(coding.carriers, channels, limit))
    if limit < SMALLEST + m.Pcm.HEAD.size + 2:
        return []
    codes, kind = np.zeros((samples, channels), np.int16), coding.sample_format
    messages = pcm(0, codes, session=1, sample_format=kind, packet_limit=limit)
    return [_packet(message) for message in messages]


def spectrum_group(carriers: int, channels: int, limit: int) -> int:
    """Return how many channels a SPECTRUM message has.

    A frame is divided into as few messages as the limit allows.

    Parameters
    ----------
    carriers : int
        Number of carriers.
    channels : int
        Number of channels of the amplifier.
    limit : int
        Largest size of a packet [bytes].

    Returns
    -------
    int
        Number of channels; 0 if not even one fits into a packet.
    """
    most = (limit - SMALLEST - m.Spectrum.HEAD.size) // (2 * carriers)
    return math.ceil(channels / math.ceil(channels / most)) if most > 0 else 0


def _frames(carriers: int, channels: int, limit: int) -> Iterator[bytes]:
    """Yield the packets of a spectrum frame, which is divided by channels."""
    group = spectrum_group(carriers, channels, limit)
    for first in range(0, channels if group else 0, group or 1):
        count = min(group, channels - first)
        frame = m.Spectrum(channels=count, carriers=carriers, envelopes=bytes(2 * carriers * count))
        yield _packet(frame)


def _packet(message: m.Message) -> bytes:
    return encode_packet(Packet.of(message))


def _codings(rates: Sequence[int]) -> Iterator[Coding]:
    """Yield all codings in the order in which they are tried."""
    for rate in rates:
        yield from (Coding(kind, rate) for kind in PCM_FORMATS)
    for carriers, frame_rate in SPECTRA:
        yield Coding(SampleFormat.SPECTRUM8, rates[0], carriers, frame_rate)


@lru_cache(maxsize=64)
def correlations_of(channels: int, limit: int) -> tuple[bytes, ...]:
    """Return the packets in which one amplifier sends a window of correlated currents.

    The content of the entries is zero.

    Parameters
    ----------
    channels : int
        Number of channels of the amplifier.
    limit : int
        Largest size of a packet [bytes].

    Returns
    -------
    tuple of bytes
        Packets.
    """
    window = correlation.CompleteWindow(0, 1, bytes(correlation.ENTRY.itemsize * channels))
    return tuple(_packet(message) for message in correlation.messages_of(window, 1, limit))


def _correlation_use(
    link: Link, ability: "Ability", channels: int, milliseconds: int, seconds: Callable[..., float]
) -> float:
    """Return the fraction of a link that windows of some channels on one amplifier take."""
    if not milliseconds:
        return 0.0
    packets = correlations_of(channels, packet_limit(link, ability))
    return sum(map(seconds, packets)) / (milliseconds * 1e-3)


def reply_use(
    link: Link, channels: int, ability: "Ability", correlation_ms: int = 0
) -> tuple[float, float]:
    """Return the fraction of the direction to the host that amplifiers take.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.
    channels : int
        Number of channels of the display.
    ability : Ability
        Abilities of the amplifiers.
    correlation_ms : int
        Length of the windows of correlated currents [ms]; 0 for none.

    Returns
    -------
    correlations : float
        Fraction that CORRELATION takes, of the wire where both directions share it.
    total : float
        Fraction that this takes with PULSE and TIME_REPLY.
    """
    pulses = link.reply_seconds(_packet(m.Pulse())) / PULSE_INTERVAL
    each = pulses + link.reply_seconds(_packet(m.TimeReply())) / INTERVAL
    windows = others = 0.0
    for share in ability.shares(channels):
        windows += _correlation_use(link, ability, share, correlation_ms, link.reply_seconds)
        others += each
    return windows, windows + others


def guard_group(link: Link) -> int:
    """Return the largest number of channels of a GUARD, for which the drive has to wait.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.

    Returns
    -------
    int
        As many channels as take `GUARD_TIME`, `GUARD_CHANNELS` at most and one at least.
    """
    for channels in range(GUARD_CHANNELS, 1, -1):
        message = m.Guard(0, 0, channels, bytes(channels * guard.ENTRY.itemsize))
        if link.seconds(_packet(message)) <= GUARD_TIME:
            return channels
    return 1


def _guard_size(channels: int) -> int:
    """Return the length of a GUARD of some channels [bytes]."""
    return SMALLEST + m.Guard.HEAD.size + channels * guard.ENTRY.itemsize


@lru_cache(maxsize=64)
def guards_of(channels: int, limit: int, group: int = GUARD_CHANNELS) -> tuple[bytes, ...]:
    """Return the packets in which one amplifier receives the GUARD entries of all its channels.

    The content of the entries is zero.

    Parameters
    ----------
    channels : int
        Number of channels of the amplifier.
    limit : int
        Largest size of a packet [bytes].
    group : int
        Largest number of channels of a packet.

    Returns
    -------
    tuple of bytes
        Packets; empty if the limit is too small for one channel.
    """
    if limit < _guard_size(1):
        return ()
    entries, largest = np.zeros(channels, guard.ENTRY), min(limit, _guard_size(group))
    messages = guard.messages_of(1, entries, largest, channels=range(channels))
    return tuple(map(_packet, messages))


def guard_use(link: Link, channels: int, ability: Ability, correlation_ms: int) -> float:
    """Return the fraction of the direction to the amplifiers that GUARD takes.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.
    channels : int
        Number of channels of the display.
    ability : Ability
        Abilities of the amplifiers.
    correlation_ms : int
        Length of the windows of correlated currents [ms]; 0 for none, and then there is no GUARD.

    Returns
    -------
    float
        Fraction, of the wire where both directions share it.
    """
    if not (correlation_ms and ability.guards):
        return 0.0
    # an entry goes in one piece, even where the link prefers smaller packets
    limit = min(max(link.largest(), _guard_size(1)), ability.packet_limit)
    group, seconds = guard_group(link), 0.0
    for share, boards in Counter(ability.shares(channels)).items():
        seconds += boards * sum(map(link.mean_seconds, guards_of(share, limit, group)))
    return seconds / GUARD_INTERVAL


@lru_cache(maxsize=16)
def _overhead(link: Link) -> float:
    """Return the fraction of a link that each amplifier takes in addition to its stream."""
    probe = Packet(m.Time.TYPE, m.Time().pack().ljust(m.TimeReply.HEAD.size, b"\0"))
    heartbeats = link.mean_seconds(_packet(m.Heartbeat())) / (HEARTBEAT_MS * 1e-3)
    pulses = link.answer_seconds(_packet(m.Pulse())) / PULSE_INTERVAL
    exchange = link.mean_seconds(encode_packet(probe)) + link.answer_seconds(_packet(m.TimeReply()))
    return heartbeats + pulses + exchange / INTERVAL


def packet_limit(link: Link, ability: Ability) -> int:
    """Return the largest size of a packet.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.
    ability : Ability
        Abilities of the amplifiers.

    Returns
    -------
    int
        Size [bytes].
    """
    return min(link.largest(), ability.packet_limit)


def use(
    link: Link,
    channels: int,
    ability: Ability,
    coding: Coding,
    samples: int,
    correlation_ms: int = 0,
) -> float:
    """Return the fraction of the wire that a coding takes.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.
    channels : int
        Number of channels of the display.
    ability : Ability
        Abilities of the amplifiers.
    coding : Coding
        Coding of the drive.
    samples : int
        Number of samples in a packet.
    correlation_ms : int
        Length of the windows of correlated currents [ms]; 0 for none.

    Returns
    -------
    float
        Fraction of the wire; infinite if a packet cannot hold even one channel.
    """
    limit, total = packet_limit(link, ability), guard_use(link, channels, ability, correlation_ms)
    for share, boards in Counter(ability.shares(channels)).items():
        packets = packets_of(coding, samples, share, limit)
        if not packets:
            return math.inf
        stream = sum(map(link.mean_seconds, packets)) * coding.sample_rate / samples
        back = _correlation_use(link, ability, share, correlation_ms, link.answer_seconds)
        total += boards * (stream + back + _overhead(link))
    return total


def _most(link: Link, ability: Ability, coding: Coding, correlation_ms: int) -> int:
    """Return how many channels fit with the longest packets, on as many boards as needed."""
    board = ability.channels[-1] if ability.channels else BOARD_CHANNELS
    longest, highest, top = coding.packet_samples[-1], MOST_BOARDS * board, 1

    def load(channels: int) -> float:
        back = reply_use(link, channels, ability, correlation_ms)[1] if correlation_ms else 0.0
        return max(use(link, channels, ability, coding, longest, correlation_ms), back)

    while top < highest and load(top) <= link.cap:
        top = min(2 * top, highest)
    return bisect_right(range(1, top + 1), link.cap, key=load)


# Choice of a coding


@dataclass(frozen=True)
class Plan:
    """Coding and packets that fit a link.

    Attributes
    ----------
    sample_format : SampleFormat or None
        Format of the samples; None for spectrum frames.
    sample_rate : float
        Sample rate [Hz].
    packet_samples : int
        Number of samples that a packet of samples, or a frame, spans.
    packet_limit : int
        Largest size of a packet [bytes].
    carriers : int
        Number of carriers of spectrum frames; otherwise 0.
    frame_rate : float
        Spectrum frames per second [Hz]; otherwise 0.
    use : float
        Fraction of the wire.
    """

    sample_format: SampleFormat | None
    sample_rate: float
    packet_samples: int
    packet_limit: int
    carriers: int
    frame_rate: float
    use: float


@dataclass(frozen=True)
class BudgetRow:
    """Assessment of a coding on a link.

    Attributes
    ----------
    what : str
        Name of the coding.
    sample_rate : float
        Sample rate [Hz].
    use : float
        Fraction of the wire that the channels take, with the packets that `plan` would choose.
    most : int
        Largest number of channels that fit the link.
    why_not : str
        Reason why the coding does not fit; empty if it does.
    """

    what: str
    sample_rate: float
    use: float
    most: int
    why_not: str

    @property
    def fits(self) -> bool:
        """Whether the coding fits the link."""
        return not self.why_not


class BudgetError(InputError):
    """Error for channels that a link cannot carry.

    Parameters
    ----------
    message : str
        Error message.
    rows : list of BudgetRow
        Assessments of the codings.

    Attributes
    ----------
    rows : list of BudgetRow
        Assessments of the codings that were tried, followed by all others.
    """

    def __init__(self, message: str, rows: list[BudgetRow]) -> None:
        super().__init__(message)
        self.rows = rows


@dataclass(frozen=True)
class _Case:
    """Channels, amplifiers, band and windows for which a coding is to be found on a link."""

    link: Link
    channels: int
    ability: Ability
    band: float
    correlation_ms: int = 0

    def __post_init__(self) -> None:
        above_zero("band", self.band, "Hz")
        if self.channels < 1:
            raise InputError(f"{self.channels} channels: at least 1 is needed")

    def rates(self) -> list[int]:
        """Return the sample rates to try in decreasing order, the preferred one first."""
        lowest = math.ceil(SAMPLES_PER_HERTZ * self.band)
        lower = {*LOWER_RATES, min(lowest, *LOWER_RATES)}
        least, first = max(lowest, self.ability.rate_min), self.ability.rate
        return [first, *sorted((r for r in lower if least <= r < first), reverse=True)]

    def packet(self, coding: Coding) -> tuple[int, float]:
        """Return the number of samples in a packet and the fraction of the wire.

        They are those of the shortest packets that fit, or of the longest if none fit.
        """
        for samples in coding.packet_samples:
            fraction = use(
                self.link, self.channels, self.ability, coding, samples, self.correlation_ms
            )
            if fraction <= self.link.cap:
                break
        return samples, fraction

    def row(self, coding: Coding) -> BudgetRow:
        """Return the assessment of a coding."""
        fraction = self.packet(coding)[1]
        most = _most(self.link, self.ability, coding, self.correlation_ms)
        return BudgetRow(coding.name, coding.sample_rate, fraction, most, self.why_not(coding))

    def why_not(self, coding: Coding) -> str:
        """Return why a coding does not fit; empty if it fits.

        The text is a predicate with the coding as its subject.
        """
        fraction, cap = self.packet(coding)[1], self.link.cap
        reason = self.unable(coding) or self.crowded()
        if not reason and fraction == math.inf:
            reason = "does not go into packets so small, not even of one channel"
        if not reason and fraction > cap:
            taken = f"takes {100 * fraction:.0f} % of the wire{self.beside()}"
            reason = f"{taken}, {100 * cap:.0f} % may be used"
        return reason

    def beside(self) -> str:
        """Return in brackets what of the wire is not for the drive; empty without windows."""
        link, ability, milliseconds = self.link, self.ability, self.correlation_ms
        windows = sum(
            _correlation_use(link, ability, share, milliseconds, link.answer_seconds)
            for share in ability.shares(self.channels)
        )
        guards = guard_use(link, self.channels, ability, milliseconds)
        shares = {"CORRELATION": windows, "GUARD": guards}
        parts = ", ".join(f"{100 * x:.0f} % for {name}" for name, x in shares.items() if x)
        return parts and f" ({parts})"

    def crowded(self) -> str:
        """Return why the direction to the host cannot carry the windows; empty if it can."""
        windows, total = reply_use(self.link, self.channels, self.ability, self.correlation_ms)
        if not windows or total <= self.link.cap:
            return ""
        return (
            f"leaves no room for windows of {self.correlation_ms} ms, with which amplifiers take "
            f"{100 * total:.0f} % of their direction, of which {100 * self.link.cap:.0f} % may be "
            "used"
        )

    def unable(self, coding: Coding) -> str:
        """Return why the amplifiers cannot play a coding on any link; empty if they can."""
        ability, available = self.ability, sum(self.ability.channels)
        if ability.channels and self.channels > available:
            return f"would need {self.channels} channels, the amplifiers have {available}"
        if coding.sample_format not in ability.formats:
            return "is not played by the amplifier"
        if coding.carriers > ability.carriers:
            return f"has more carriers than the amplifier's {ability.carriers}"
        if not ability.rate_min <= coding.sample_rate <= ability.rate_max:
            return f"is not within the amplifier's {ability.rate_min:g} to {ability.rate_max:g} Hz"
        if coding.sample_rate < SAMPLES_PER_HERTZ * self.band:
            return f"carries only a band to {coding.sample_rate / SAMPLES_PER_HERTZ:g} Hz"
        return ""

    def refusal(self, tried: list[Coding]) -> BudgetError:
        """Return the error that tells why no coding that was tried fits, and which one would.

        The error names the tried coding that takes least of the wire among those that the
        amplifiers can play, or the first if they can play none.
        """
        codings = [*tried, *(c for c in _codings(self.rates()) if c not in tried)]
        rows = {coding: self.row(coding) for coding in codings}
        playable = [c for c in codings if not self.unable(c)]
        least = min([c for c in tried if c in playable] or tried[:1], key=lambda c: rows[c].use)
        hint = ""
        if fitting := next((c for c in playable if rows[c].fits), None):
            hint = f"; {fitting} fits"
        elif widest := max(playable, key=lambda c: rows[c].most, default=None):
            hint = f"; the most that fits is {rows[widest].most}, as {widest}"
        refused = f"{self.link.name} cannot carry {self.channels} channels"
        reason = f"{refused}: {least} {rows[least].why_not}{hint}"
        return BudgetError(reason, list(rows.values()))


def table(
    link: Link,
    channels: int,
    ability: Ability | None = None,
    *,
    band: float = 1000.0,
    correlation_ms: int = 0,
) -> list[BudgetRow]:
    """Assess each coding on a link, in the order in which `plan` tries them.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.
    channels : int
        Number of channels of the display.
    ability : Ability or None
        Abilities of the amplifiers; unlimited if None.
    band : float
        Band that the samples must carry [Hz].
    correlation_ms : int
        Length of the windows of correlated currents [ms]; 0 for none.

    Returns
    -------
    list of BudgetRow
        Assessments of the codings.

    Raises
    ------
    InputError
        If the band is not above 0, or there is no channel.
    """
    case = _Case(link, channels, ability or Ability(), band, correlation_ms)
    return [case.row(coding) for coding in _codings(case.rates())]


def plan(
    link: Link,
    channels: int,
    ability: Ability | None = None,
    *,
    sample_rate: float | None = None,
    sample_format: SampleFormat | None = None,
    band: float = 1000.0,
    correlation_ms: int = 0,
) -> Plan:
    """Choose the best coding that fits a link, beside CORRELATION and GUARD if there are windows.

    The order is PCM16, PCM12, BFP8 at 8 kHz; the same at 5, 4 and 2.5 kHz, and below that for a
    band of less than 1 kHz; then spectrum frames. Packets are as short as the link permits.

    Parameters
    ----------
    link : Link
        Link to the amplifiers.
    channels : int
        Number of channels of the display.
    ability : Ability or None
        Abilities of the amplifiers; unlimited if None.
    sample_rate : float or None
        The only acceptable sample rate [Hz]; None to choose it.
    sample_format : SampleFormat or None
        The only acceptable format; None to choose it.
    band : float
        Band that the samples must carry [Hz].
    correlation_ms : int
        Length of the windows of correlated currents [ms]; 0 for none.

    Returns
    -------
    Plan
        Coding and packets.

    Raises
    ------
    BudgetError
        If nothing fits; it has the assessments of all codings.
    InputError
        If the rate is not a whole number above 0, the band is not above 0, or there is no channel.
    """
    case = _Case(link, channels, ability or Ability(), band, correlation_ms)
    if sample_rate is not None and not (sample_rate > 0 and float(sample_rate).is_integer()):
        raise InputError(f"sample rate {sample_rate:g} Hz: must be a whole number above 0")
    rates = case.rates() if sample_rate is None else [int(sample_rate)]
    tried = [c for c in _codings(rates) if sample_format in (None, c.sample_format)]
    for coding in tried:
        if not case.why_not(coding):
            samples, fraction = case.packet(coding)
            return Plan(
                sample_format=None if coding.carriers else coding.sample_format,
                sample_rate=coding.sample_rate,
                packet_samples=samples,
                packet_limit=packet_limit(link, case.ability),
                carriers=coding.carriers,
                frame_rate=coding.frame_rate,
                use=fraction,
            )
    raise case.refusal(tried)
