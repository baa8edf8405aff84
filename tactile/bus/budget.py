"""What fits a link: which coding of the drive, at which rate, for how many channels.

Counted is all that the host sends in a second: PCM or spectrum packets as the encoders make them,
HEARTBEAT and TIME; on media that both sides share, CAN and I²C, also PULSE and TIME_REPLY of each
amplifier. The eight probes before a start and requests are not. CAN's stuff bits are the mean of
random data. A part of the wire stays free, `Link.cap`: for stuff bits of quiet drive (CAN's most
are a fifth more), what is sent again after an error, and the host's own jitter.
"""

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.clock import INTERVAL
from firmware_protocol.host import pcm
from firmware_protocol.messages import HEARTBEAT_MS, PACKET_MAX, SampleFormat
from firmware_protocol.packet import SMALLEST, Packet, encode_packet
from tactile.bus.base import Wiring
from tactile.bus.wire_time import Can, I2c, Link, Uart, Unlimited, Usb, above_zero
from tactile.errors import InputError

__all__ = [
    "Ability",
    "BudgetError",
    "BudgetRow",
    "Can",
    "I2c",
    "Link",
    "Plan",
    "Uart",
    "Unlimited",
    "Usb",
    "check_limits",
    "plan",
    "spectrum_group",
    "table",
]

RATE = 8000
"""Hz that are wanted where nobody says otherwise."""
LOWER_RATES = (5000, 4000, 2500)
SAMPLES_PER_HERTZ = 2.5
"""Least sample rate over the band that it is to carry."""
PCM_FORMATS = (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8)
"""In order of what they keep of a texture: 80, 60 and 43 dB (`python -m benchmarks protocol`)."""
SPECTRA = ((16, 50.0), (8, 100.0))
"""Carriers and frames a second."""
PACKET_SECONDS = (2e-3, 4e-3)
"""That a packet of samples may last: the playback block of 16 at 8 kHz, or two."""

PULSE_INTERVAL = 10e-3
"""s (SPEC.md, parameter 2). On I²C the host reads as often (assumed), and for each TIME_REPLY."""
BOARD_CHANNELS = 255
"""Most of one amplifier (u8), which one that was not asked is taken to have."""
MOST_BOARDS = 127
"""Addresses that there are."""


# What amplifiers can


@dataclass(frozen=True)
class Ability:
    """What all amplifiers of a display can; everything, before they were asked.

    Attributes
    ----------
    formats : that they play
    rate_min, rate_max : sample rates [Hz]
    carriers : most of them
    packet_limit : bytes of a packet
    channels : of each board, in the order of the display's channels
    """

    formats: frozenset[SampleFormat] = frozenset(SampleFormat)
    rate_min: float = 0.0
    rate_max: float = math.inf
    carriers: int = m.CARRIERS_MAX
    packet_limit: int = PACKET_MAX
    channels: tuple[int, ...] = ()

    @classmethod
    def of(cls, boards: Sequence[m.Caps]) -> "Ability":
        """Return what one or several amplifiers said that they can."""
        return cls(
            formats=frozenset(f for f in SampleFormat if all(b.formats >> f & 1 for b in boards)),
            rate_min=max(b.rate_min_hz for b in boards),
            rate_max=min(b.rate_max_hz for b in boards),
            carriers=min(b.carriers for b in boards),
            packet_limit=min(b.packet_limit for b in boards),
            channels=tuple(b.channels for b in boards),
        )

    @property
    def rate(self) -> int:
        """The rate [Hz] that is tried first: the nearest to the usual one."""
        return int(min(max(RATE, self.rate_min), self.rate_max))

    def shares(self, channels: int) -> Iterator[int]:
        """Yield the channels of each board; beyond those there are, boards like the last."""
        boards = [count for count in self.channels if count] or [BOARD_CHANNELS]
        while channels > 0:
            share = min(boards.pop(0) if len(boards) > 1 else boards[0], channels)
            yield share
            channels -= share


# What is sent


def check_limits(wiring: Wiring, caps: Sequence[m.Caps]) -> None:
    """See that a display's demands are within what its amplifiers can.

    Raises
    ------
    InputError
        Where they are not: for channels, voltage or slew.
    """
    have = sum(c.channels for c in caps)
    if have < wiring.channels:
        raise InputError(f"the display has {wiring.channels} channels, the amplifiers {have}")
    for name, wanted, limit, scale, unit in (
        ("voltage_v", wiring.voltage, min(c.voltage_limit_uv for c in caps), 1e-6, "V"),
        ("slew_v_per_us", wiring.slew, min(c.slew_limit_v_per_s for c in caps), 1.0, "V/s"),
    ):
        if int(wanted / scale) > limit:  # whole units are what LIMITS tells
            raise InputError(
                f"limits.{name}: the display's {wanted:g} {unit} is more than the amplifier's "
                f"{limit * scale:g} {unit}; lower it in the display file"
            )


@dataclass(frozen=True)
class Coding:
    """How drive is sent: samples in a format, or spectrum frames.

    Attributes
    ----------
    sample_format : SPECTRUM8 for frames
    sample_rate : [Hz]
    carriers, frame_rate : of frames, and frames a second
    """

    sample_format: SampleFormat
    sample_rate: int
    carriers: int = 0
    frame_rate: float = 0.0

    @property
    def name(self) -> str:
        """For people, without the rate of the samples."""
        if self.carriers:
            return f"SPECTRUM {self.carriers} at {self.frame_rate:g} Hz"
        return self.sample_format.name

    def __str__(self) -> str:
        return self.name if self.carriers else f"{self.name} at {self.sample_rate} Hz"

    @property
    def packet_samples(self) -> tuple[int, ...]:
        """Samples that a packet may span, fewest first."""
        if self.carriers:
            return (max(round(self.sample_rate / self.frame_rate), 1),)
        return tuple(max(round(self.sample_rate * s), 1) for s in PACKET_SECONDS)


@lru_cache(maxsize=256)
def packets_of(coding: Coding, samples: int, channels: int, limit: int) -> list[bytes]:
    """Return the packets that one amplifier gets for so many samples; none where none can be.

    Their content is zero.
    """
    if coding.carriers:
        return list(_frames(coding.carriers, channels, limit))
    if limit < SMALLEST + m.Pcm.HEAD.size + 2:
        return []
    codes, kind = np.zeros((samples, channels), np.int16), coding.sample_format
    messages = pcm(0, codes, session=1, sample_format=kind, packet_limit=limit)
    return [_packet(message) for message in messages]


def spectrum_group(carriers: int, channels: int, limit: int) -> int:
    """Return the channels that a SPECTRUM has, so that as few as the limit allows make a frame.

    It is 0 where not one goes into a packet.
    """
    most = (limit - SMALLEST - m.Spectrum.HEAD.size) // (2 * carriers)
    return math.ceil(channels / math.ceil(channels / most)) if most > 0 else 0


def _frames(carriers: int, channels: int, limit: int) -> Iterator[bytes]:
    """Yield the packets of a spectrum frame, cut by channels."""
    group = spectrum_group(carriers, channels, limit)
    for first in range(0, channels if group else 0, group or 1):
        count = min(group, channels - first)
        frame = m.Spectrum(channels=count, carriers=carriers, envelopes=bytes(2 * carriers * count))
        yield _packet(frame)


def _packet(message: m.Message) -> bytes:
    return encode_packet(Packet.of(message))


def _codings(rates: Sequence[int]) -> Iterator[Coding]:
    """Yield all that there are, in the order in which they are tried."""
    for rate in rates:
        yield from (Coding(kind, rate) for kind in PCM_FORMATS)
    for carriers, frame_rate in SPECTRA:
        yield Coding(SampleFormat.SPECTRUM8, rates[0], carriers, frame_rate)


@lru_cache(maxsize=16)
def _overhead(link: Link) -> float:
    """Return the fraction of a link that each amplifier takes beside its stream."""
    probe = Packet(m.Time.TYPE, m.Time().pack().ljust(m.TimeReply.HEAD.size, b"\0"))
    heartbeats = link.mean_seconds(_packet(m.Heartbeat())) / (HEARTBEAT_MS * 1e-3)
    pulses = link.answer_seconds(_packet(m.Pulse())) / PULSE_INTERVAL
    exchange = link.mean_seconds(encode_packet(probe)) + link.answer_seconds(_packet(m.TimeReply()))
    return heartbeats + pulses + exchange / INTERVAL


def packet_limit(link: Link, ability: Ability) -> int:
    """Return the most bytes of a packet."""
    return min(link.largest(), ability.packet_limit)


def use(link: Link, channels: int, ability: Ability, coding: Coding, samples: int) -> float:
    """Return the fraction of the wire that packets of so many samples take.

    It is infinite where no packet can hold a channel.
    """
    limit, total = packet_limit(link, ability), 0.0
    for share, boards in Counter(ability.shares(channels)).items():
        packets = packets_of(coding, samples, share, limit)
        if not packets:
            return math.inf
        stream = sum(map(link.mean_seconds, packets)) * coding.sample_rate / samples
        total += boards * (stream + _overhead(link))
    return total


def _most(link: Link, ability: Ability, coding: Coding) -> int:
    """Return the most channels of which the longest packets fit, on as many boards as need be."""
    board = ability.channels[-1] if ability.channels else BOARD_CHANNELS
    longest, highest, top = coding.packet_samples[-1], MOST_BOARDS * board, 1

    def taken(channels: int) -> float:
        return use(link, channels, ability, coding, longest)

    while top < highest and taken(top) <= link.cap:
        top = min(2 * top, highest)
    return bisect_right(range(1, top + 1), link.cap, key=taken)


# What fits


@dataclass(frozen=True)
class Plan:
    """What to send.

    Attributes
    ----------
    sample_format : None for spectrum frames
    sample_rate : [Hz]
    packet_samples : that a packet of samples, or a frame, spans
    packet_limit : bytes of a packet at most
    carriers, frame_rate : of spectrum frames, else 0
    use : fraction of the wire
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
    """Whether a coding fits.

    Attributes
    ----------
    what : coding
    sample_rate : [Hz]
    use : fraction of the wire that the channels take, in the packets that `plan` would choose
    most : channels of which it fits the link
    why_not : empty where it fits
    """

    what: str
    sample_rate: float
    use: float
    most: int
    why_not: str

    @property
    def fits(self) -> bool:
        """Whether it does."""
        return not self.why_not


class BudgetError(InputError):
    """Channels that a link cannot carry.

    Attributes
    ----------
    rows : what was tried, and all else that there is
    """

    def __init__(self, message: str, rows: list[BudgetRow]) -> None:
        super().__init__(message)
        self.rows = rows


@dataclass(frozen=True)
class _Case:
    """What is to fit, and where."""

    link: Link
    channels: int
    ability: Ability
    band: float

    def __post_init__(self) -> None:
        above_zero("band", self.band, "Hz")
        if self.channels < 1:
            raise InputError(f"{self.channels} channels: at least 1 is needed")

    def rates(self) -> list[int]:
        """Return the sample rates to try, highest first."""
        lowest = math.ceil(SAMPLES_PER_HERTZ * self.band)
        lower = {*LOWER_RATES, min(lowest, *LOWER_RATES)}
        least, first = max(lowest, self.ability.rate_min), self.ability.rate
        return [first, *sorted((r for r in lower if least <= r < first), reverse=True)]

    def packet(self, coding: Coding) -> tuple[int, float]:
        """Return the samples and the use of the shortest packets that fit, or of the longest."""
        for samples in coding.packet_samples:
            taken = use(self.link, self.channels, self.ability, coding, samples)
            if taken <= self.link.cap:
                break
        return samples, taken

    def row(self, coding: Coding) -> BudgetRow:
        """Return what there is to say about a coding."""
        taken, most = self.packet(coding)[1], _most(self.link, self.ability, coding)
        return BudgetRow(coding.name, coding.sample_rate, taken, most, self.why_not(coding))

    def why_not(self, coding: Coding) -> str:
        """Return why a coding cannot be, "" where it can; the coding is the subject."""
        taken, cap = self.packet(coding)[1], self.link.cap
        reason = self.unable(coding)
        if not reason and taken == math.inf:
            reason = "does not go into packets so small, not even of one channel"
        if not reason and taken > cap:
            reason = f"takes {100 * taken:.0f} % of the wire, {100 * cap:.0f} % may be used"
        return reason

    def unable(self, coding: Coding) -> str:
        """Return what keeps the amplifiers from a coding on any link."""
        able, boards = self.ability, sum(self.ability.channels)
        if able.channels and self.channels > boards:
            return f"would need {self.channels} channels, the amplifiers have {boards}"
        if coding.sample_format not in able.formats:
            return "is not played by the amplifier"
        if coding.carriers > able.carriers:
            return f"has more carriers than the amplifier's {able.carriers}"
        if not able.rate_min <= coding.sample_rate <= able.rate_max:
            return f"is not within the amplifier's {able.rate_min:g} to {able.rate_max:g} Hz"
        if coding.sample_rate < SAMPLES_PER_HERTZ * self.band:
            return f"carries only a band to {coding.sample_rate / SAMPLES_PER_HERTZ:g} Hz"
        return ""

    def refusal(self, tried: list[Coding]) -> BudgetError:
        """Return the error that says why nothing of what was tried fits, and what would.

        Named is the leanest of what was tried and the amplifiers can, else the first.
        """
        codings = [*tried, *(c for c in _codings(self.rates()) if c not in tried)]
        rows = {coding: self.row(coding) for coding in codings}
        able = [c for c in codings if not self.unable(c)]
        least = min([c for c in tried if c in able] or tried[:1], key=lambda c: rows[c].use)
        hint = ""
        if fitting := next((c for c in able if rows[c].fits), None):
            hint = f"; {fitting} fits"
        elif widest := max(able, key=lambda c: rows[c].most, default=None):
            hint = f"; the most that fits is {rows[widest].most}, as {widest}"
        refused = f"{self.link.name} cannot carry {self.channels} channels"
        reason = f"{refused}: {least} {rows[least].why_not}{hint}"
        return BudgetError(reason, list(rows.values()))


def table(
    link: Link, channels: int, ability: Ability | None = None, *, band: float = 1000.0
) -> list[BudgetRow]:
    """Return whether each coding fits, in the order in which `plan` tries them.

    Parameters
    ----------
    link : to the amplifiers
    channels : of the display
    ability : of the amplifiers; by default they can do everything
    band : that samples must carry [Hz]
    """
    case = _Case(link, channels, ability or Ability(), band)
    return [case.row(coding) for coding in _codings(case.rates())]


def plan(
    link: Link,
    channels: int,
    ability: Ability | None = None,
    *,
    sample_rate: float | None = None,
    sample_format: SampleFormat | None = None,
    band: float = 1000.0,
) -> Plan:
    """Return what to send: the best that fits.

    That is PCM16, PCM12, BFP8 at 8 kHz; the same at 5, 4 and 2.5 kHz, and below for a band of less
    than 1 kHz; then spectrum frames. Packets are as short as fits.

    Parameters
    ----------
    link, channels, ability, band : as of `table`
    sample_rate, sample_format : the only one that will do [Hz]

    Raises
    ------
    BudgetError
        Where nothing fits, with the table.
    InputError
        For a rate or a band that is none.
    """
    case = _Case(link, channels, ability or Ability(), band)
    if sample_rate is not None and not (sample_rate > 0 and float(sample_rate).is_integer()):
        raise InputError(f"sample rate {sample_rate:g} Hz: must be a whole number above 0")
    rates = case.rates() if sample_rate is None else [int(sample_rate)]
    tried = [c for c in _codings(rates) if sample_format in (None, c.sample_format)]
    for coding in tried:
        if not case.why_not(coding):
            samples, taken = case.packet(coding)
            return Plan(
                sample_format=None if coding.carriers else coding.sample_format,
                sample_rate=coding.sample_rate,
                packet_samples=samples,
                packet_limit=packet_limit(link, case.ability),
                carriers=coding.carriers,
                frame_rate=coding.frame_rate,
                use=taken,
            )
    raise case.refusal(tried)
