"""The stream of a session: positions put out at the same time by all amplifiers of a link.

Samples are packed as they are written and go out, a little ahead of their time (`lead`), as fast as
the wire takes them. What is late already is not sent: the amplifiers go on at what is due by now.
While the link is down positions pass as they did, so that playing goes on in step when it is back.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol import spectrum
from firmware_protocol.host import codes_of, pcm
from firmware_protocol.messages import Message, SampleFormat
from firmware_protocol.packet import TURN, Packet
from tactile.arrays import Complex, Floats
from tactile.bus.base import BusCounters
from tactile.bus.budget import Plan, spectrum_group
from tactile.bus.link.follower import HALF, Follower, Piece
from tactile.bus.link.peer import Peer

LEAD, LEAST_LEAD, MOST_LEAD = 8e-3, 6e-3, 24e-3
"""s that samples are sent before they are put out: at first, and between what (SPEC.md, 8.1)."""
LONGEST_LEAD = 100e-3
"""s that may be asked for. Amplifiers have room for 64 ms at least, which the credit keeps."""
RAISE, LOWER = 1.5, 0.1e-3
"""By which the lead grows at an underrun, and s by which it falls in a second."""

LATEST = 4e-3
"""s before its time at which samples go that wait for others to fill their packet."""
HOLD = 25e-3
"""s for which the last sample is held at the end, in which STOP comes: the ramp begins there."""


class PendingSamples(NamedTuple):
    """Positions from ``start`` to before ``end`` that wait to be sent.

    ``packets`` are an amplifier's, with the wire position after them.
    """

    start: int
    end: int
    packets: list[tuple[Peer, int, list[Packet]]]


def _room(plan: Plan) -> float:
    """Return the longest lead for which amplifiers have room besides their credit [s].

    A frame sets out by its spacing, the time that it takes on the wire, and the lead before its
    position. Four spacings are the most of which none finds the queue full (SPEC.md, 8.1).
    """
    if not plan.carriers:
        return math.inf
    return (spectrum.QUEUE - 1 - plan.use) * plan.packet_samples / plan.sample_rate


class LinkStream:
    """What waits, and when it is due.

    Parameters
    ----------
    peers : the amplifiers, each with as many channels as its CAPS says, in order
    plan : how samples are packed
    channels : C of what is written
    counters : to count in what is late and what is dropped
    lead : one that is kept [s]; None for one that goes with underruns

    Attributes
    ----------
    lead : [s], of frames no longer than amplifiers have room for
    end : position after what was written
    """

    def __init__(
        self,
        peers: Sequence[Peer],
        plan: Plan,
        channels: int,
        counters: BusCounters,
        lead: float | None = None,
    ) -> None:
        first, least, most = (LEAD, LEAST_LEAD, MOST_LEAD) if lead is None else (lead, lead, lead)
        self._most = min(most, _room(plan))
        self._least, self.lead = min(least, self._most), min(first, self._most)
        self._plan, self._counters = plan, counters
        ends = np.minimum(np.cumsum([peer.caps.channels for peer in peers]), channels).tolist()
        starts = [0, *ends[:-1]]
        self._spans = [slice(a, b) for a, b in zip(starts, ends, strict=True) if a < b]
        self._peers = peers[: len(self._spans)]
        self._followers = [Follower(plan.sample_rate) for _ in self._peers[1:]]
        self._parts: deque[PendingSamples] = deque()
        self._partial: Floats = np.zeros((0, channels))
        self._partial_start = self.end = 0
        self._last: Floats | None = None
        self._playing = self._blocked = False
        self._tail: int | None = None
        self._anchor, self._from = (0, 0.0), 0
        self._underruns, self._late, self._lowered = 0, 0, math.inf

    # Time

    def begin(self, position: int, time: float, *, fade_in: bool = False) -> list[m.Start]:
        """Return each amplifier's START that plays a position at a host time [s].

        To ``fade_in`` the first sample is kept back: an amplifier's gain rises then (SPEC.md, 8.2).
        """
        self.clear()
        self._from = position + fade_in
        self._anchor, self._playing, self.end = (position, time), True, position
        self._lowered = time
        for follower in self._followers:
            follower.begin(position)
        return [peer.start(position, time) for peer in self._peers]

    def due(self, position: int) -> float:
        """Return the host time at which a position is put out [s]."""
        rate = self._plan.sample_rate
        if self._playing and not self._peers[0].forgot:
            return self._peers[0].due(position, rate)
        return self._anchor[1] + (position - self._anchor[0]) / rate

    def position_at(self, time: float) -> int:
        """Return the first position that is due at a host time [s] or later."""
        at, when = self._anchor
        at += math.ceil((time - when) * self._plan.sample_rate - 1e-9)
        return at + math.ceil((time - self.due(at)) * self._plan.sample_rate - 1e-9)

    @property
    def ahead(self) -> float:
        """By which samples are to be handed over before they are put out [s].

        That is the lead, the time that a packet, or a frame, takes on the wire, and what boards
        after the first wait for to follow its clock.
        """
        plan = self._plan
        waits = HALF if len(self._peers) > 1 and not plan.carriers else 0
        return self.lead + (plan.use * plan.packet_samples + waits) / plan.sample_rate

    def freeze(self, now: float) -> None:
        """Let positions pass by the host's clock, since the amplifiers' is out of reach."""
        self._set_anchor(now)
        self._playing = False
        self.clear()

    def _set_anchor(self, now: float) -> None:
        """Remember where it is, for when the amplifiers' clock is out of reach, or another."""
        if self._playing and not self._peers[0].forgot:
            at = self.position_at(now)
            self._anchor = (at, self.due(at))

    def resume(self) -> None:
        """Go on by the amplifiers' clock, after a freeze that they have played through."""
        self._playing = True

    @property
    def underruns(self) -> int:
        """Of all amplifiers."""
        return sum(peer.underruns for peer in self._peers)

    @property
    def late(self) -> int:
        """Samples that came too late to all amplifiers, as far as they have told."""
        return sum(peer.late for peer in self._peers)

    def control(self, now: float, *, running: bool) -> None:
        """Count underruns, and adapt the lead to those that come while all is running."""
        self._blocked = False
        self._set_anchor(now)
        fresh, self._underruns = self.underruns - self._underruns, self.underruns
        self._counters.underruns += fresh
        late, self._late = self.late - self._late, self.late
        self._counters.late_blocks -= -late // self._plan.packet_samples
        if running and fresh:
            self.lead = min(self.lead * RAISE, self._most)
        elif running and now > self._lowered:
            self.lead = max(self.lead - LOWER * (now - self._lowered), self._least)
        self._lowered = max(now, self._lowered)

    # What waits

    def add(self, position: int, volts: Floats) -> None:
        """Let samples (S, C) [V] wait, in packets of as many as the plan says."""
        early = min(max(self._from - position, 0), len(volts))
        self._counters.dropped_samples += early
        position, volts = position + early, volts[early:]
        if not len(volts):
            return
        if len(self._partial) and position != self.end:
            self._flush()
        self.end = position + len(volts)
        if len(self._partial):
            volts = np.concatenate([self._partial, volts])
        start, size = self.end - len(volts), self._plan.packet_samples
        whole = len(volts) // size * size
        for k in range(0, whole, size):
            self._pack(start + k, volts[k : k + size])
        self._partial, self._partial_start = volts[whole:].copy(), start + whole  # the caller's

    def hold(self) -> int:
        """Let the last sample go on for `HOLD`; return the position after what was written."""
        end = self.end
        self._flush()
        if self._last is not None:
            held, size = end + math.ceil(HOLD * self._plan.sample_rate), self._plan.packet_samples
            for at in range(end, held, size):
                self._pack(at, np.tile(self._last, (min(size, held - at), 1)))
        return end

    def _flush(self) -> None:
        volts, self._partial = self._partial, self._partial[:0]
        if len(volts):
            self._pack(self._partial_start, volts)

    def _pack(self, position: int, volts: Floats) -> None:
        self._last = volts[-1].copy()
        first, *others = self._peers
        packets = self._packed(first, [(position, volts[:, self._spans[0]])])
        for follower, peer, span in zip(self._followers, others, self._spans[1:], strict=True):
            apart = self._apart(peer, position)
            packets += self._packed(peer, follower.feed(position, volts[:, span], apart))
        self._parts.append(PendingSamples(position, position + len(volts), packets))
        self._tail = position + len(volts) if others else None

    def _packed(self, peer: Peer, pieces: list[Piece]) -> list[tuple[Peer, int, list[Packet]]]:
        kind, packets = self._plan.sample_format, []
        assert kind is not None
        for start, piece in pieces:
            at = peer.wire_position(start, len(piece))
            messages = pcm(
                at, codes_of(piece, peer.caps.full_scale_uv * 1e-6), session=peer.host.session,
                sample_format=kind, packet_limit=self._plan.packet_limit,
            )  # fmt: skip
            packets.append((peer, at + len(piece), self._told(peer, messages)))
        return packets

    def _flush_followers(self) -> None:
        """Send what waits for samples that do not come."""
        packets = []
        for follower, peer in zip(self._followers, self._peers[1:], strict=True):
            packets += self._packed(peer, follower.flush())
        assert self._tail is not None
        self._parts.append(PendingSamples(self._tail - HALF, self._tail, packets))
        self._tail = None

    def _apart(self, peer: Peer, position: int) -> float:
        """Return by how many samples the first clock is ahead of another at a position."""
        if not self._playing or peer.forgot or self._peers[0].forgot:
            return 0.0
        rate = self._plan.sample_rate
        return (peer.due(position, rate) - self._peers[0].due(position, rate)) * rate

    def add_frame(self, position: int, volts: Complex, carriers: Floats) -> None:
        """Let a frame (C, P) [V] wait; not that of the start, where all envelopes are 0."""
        if position <= self._from:
            return
        plan, packets = self._plan, []
        increment = spectrum.increments(carriers, plan.sample_rate).astype(np.int64)
        spacing = plan.packet_samples
        valid = 2 * spacing  # 40 ms at the fewest frames a second; 50 are allowed (SPEC.md, 10.2)
        self.end = position
        for k, (peer, span) in enumerate(zip(self._peers, self._spans, strict=True)):
            early = round(self._apart(peer, position)) if k else 0
            at = peer.wire_position(position - early, 1)
            turns = increment * ((at - position) % TURN) % TURN / TURN
            codes = spectrum.encode(
                volts[span] * np.exp(-2j * np.pi * turns) / (peer.caps.full_scale_uv * 1e-6)
            )
            group = spectrum_group(len(carriers), len(codes), plan.packet_limit)
            messages = (
                m.Spectrum(
                    at % TURN, peer.host.session, valid, first, len(part),
                    SampleFormat.SPECTRUM8, len(carriers), part.tobytes(),
                )
                for first in range(0, len(codes), group)
                for part in [codes[first : first + group]]
            )  # fmt: skip
            packets.append((peer, at, self._told(peer, messages)))
        self._parts.append(PendingSamples(position - spacing, position, packets))

    @staticmethod
    def _told(peer: Peer, messages: Iterable[Message]) -> list[Packet]:
        return [peer.host.tell(message) for message in messages]

    def clear(self, *, wanted: bool = False) -> None:
        """Forget what waits, and count it, unless whoever wrote it wants it gone."""
        self._flush()
        for part in () if wanted else self._parts:
            self._drop(part)
        self._parts.clear()
        self._last = self._tail = None

    def _drop(self, part: PendingSamples) -> None:
        """Count what is not sent: a frame as one sample, and nothing of what was held."""
        samples = 1 if self._plan.carriers else max(min(part.end, self.end) - part.start, 0)
        self._counters.dropped_samples += samples

    @property
    def deadline(self) -> float:
        """Host time at which something has to go at the latest [s]."""
        if self._parts:
            return math.inf if self._blocked else -math.inf
        partial = self.due(self._partial_start) if len(self._partial) else math.inf
        tail = math.inf if self._tail is None else self.due(self._tail - HALF)
        return min(partial, tail) - LATEST

    def take(self, now: float) -> list[Packet]:
        """Return the packets that are next, if the amplifiers have room for them."""
        if len(self._partial) and now >= self.due(self._partial_start) - LATEST:  # as `deadline`
            self._flush()
        if self._tail is not None and now >= self.due(self._tail - HALF) - LATEST:
            self._flush_followers()
        while self._parts:
            part = self._parts[0]
            self._blocked = not all(peer.has_credit(end) for peer, end, _ in part.packets)
            if self._blocked:
                return []
            self._parts.popleft()
            self._counters.late_blocks += self.due(part.start) < now
            if self.due(part.end) > now:
                return [packet for _, _, packets in part.packets for packet in packets]
            self._drop(part)
        return []
