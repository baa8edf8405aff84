"""Stream of a session: positions that all amplifiers of a link put out at the same time.

Samples are packed as they are written, and sent as fast as the wire takes them, ahead of their time
by `lead`. Samples that are late already are not sent: the amplifiers go on at the position that is
due now. While the link is down, positions pass by the clock as before, so that playing continues in
step when the link is back.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
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
from tactile.bus.link.follower import HALF, SLACK, Follower, Piece
from tactile.bus.link.peer import Peer
from tactile.bus.marks import AmplifierMarks, MarkReport

LEAD, LEAST_LEAD, MOST_LEAD = 8e-3, 6e-3, 24e-3
"""Time by which samples are sent before they are put out: at first, at least and at most
(SPEC.md, 8.1) [s]."""
LONGEST_LEAD = 100e-3
"""Longest lead that may be asked for; amplifiers have room for at least 64 ms, which the credit
keeps [s]."""
RAISE, LOWER = 1.5, 0.1e-3
"""Factor by which the lead grows at an underrun, and rate at which it falls [s/s]."""

LATEST = 4e-3
"""Time before they are due at which samples are sent that wait for others to fill a packet [s]."""
HOLD = 25e-3
"""Time for which the last sample is held at the end; STOP arrives in it, and the ramp begins at
that sample [s]."""


@dataclass
class LinkBusCounters(BusCounters):
    """Counters of a bus whose amplifiers speak the protocol, in addition to those of every bus.

    Attributes
    ----------
    credit_faults : int
        Number of PULSEs whose credit is further from the amplifier's own position than its buffer
        is long.
    """

    credit_faults: int = 0


class PendingSamples(NamedTuple):
    """Samples that wait to be sent.

    Attributes
    ----------
    start, end : int
        First position, and the position after the last one.
    packets : list of tuple of Peer, int and list of Packet
        Amplifiers, each with the wire position after its samples and with its packets.
    """

    start: int
    end: int
    packets: list[tuple[Peer, int, list[Packet]]]


def _room(plan: Plan) -> float:
    """Return the longest lead for which amplifiers have room, apart from their credit [s].

    A frame is sent before its position by its spacing, its time on the wire and the lead. With four
    spacings in all, no frame finds the queue of an amplifier full (SPEC.md, 8.1).
    """
    if not plan.carriers:
        return math.inf
    return (spectrum.QUEUE - 1 - plan.use) * plan.packet_samples / plan.sample_rate


class LinkStream:
    """Samples or frames that wait to be sent, and the times at which they are due.

    It has no lock; `LinkBus` changes it under its own.

    Parameters
    ----------
    peers : sequence of Peer
        Amplifiers in the order of channels, each with as many as its CAPS says.
    plan : Plan
        How samples are packed.
    channels : int
        Number of channels of what is written, C.
    counters : LinkBusCounters
        Counters of underruns, late blocks, dropped samples and faults of the credit.
    lead : float or None
        Lead that is kept [s]; None for one that adapts to underruns.

    Attributes
    ----------
    lead : float
        Time by which samples are sent before they are put out; for frames no longer than the
        amplifiers have room for [s].
    end : int
        Position after what was written.
    no_credit : str
        One line on the amplifier for want of whose credit the latest samples were dropped; empty if
        they were not.
    """

    def __init__(
        self,
        peers: Sequence[Peer],
        plan: Plan,
        channels: int,
        counters: LinkBusCounters,
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
        """Packets that wait to be sent."""
        self._partial: Floats = np.zeros((0, channels))
        """Samples that wait for others to fill their packet."""
        self._partial_start = self.end = 0
        self._last: Floats | None = None
        """Sample that was packed last."""
        self._playing = self._blocked = False
        """Whether positions pass by the amplifiers' clock, and whether credit is lacking."""
        self._tail: int | None = None
        """Position after the samples that followers have; they still need `HALF` more."""
        # A position and its host time, for when the amplifiers' clock is out of reach; and the
        # first position that may be written.
        self._anchor, self._from = (0, 0.0), 0
        self._underruns, self._late, self._lowered = 0, 0, math.inf
        self._credit_faults, self.no_credit = 0, ""
        self._marks = AmplifierMarks(plan.sample_rate)
        self._held = 0
        """Number of positions after what was written that have something to play."""

    # Time

    def begin(self, position: int, time: float, *, fade_in: bool = False) -> list[m.Start]:
        """Begin to play, and return the START of each amplifier.

        Parameters
        ----------
        position : int
            Position that is put out first.
        time : float
            Host time at which it is put out [s].
        fade_in : bool
            Whether to leave out the first sample, upon which the gain of an amplifier rises from 0
            (SPEC.md, 8.2).

        Returns
        -------
        list of Start
            Messages in the order of the amplifiers.
        """
        self.clear()
        self._marks = AmplifierMarks(self._plan.sample_rate)
        self._from = position + fade_in
        self._anchor, self._playing, self.end = (position, time), True, position
        self._lowered = time
        # A frame is in force for two spacings (`add_frame`).
        self._held = 2 * self._plan.packet_samples if self._plan.carriers else 0
        for follower in self._followers:
            follower.begin(position)
        return [peer.start(position, time, self._plan.sample_rate) for peer in self._peers]

    def due(self, position: int) -> float:
        """Return the host time at which a position is put out.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Host time by the clock of the first amplifier, or by that of the host while the
            amplifiers do not play or cannot be reached [s].
        """
        if self._playing and not self._peers[0].reset_evidence:
            return self._peers[0].due(position)
        return self._anchor[1] + (position - self._anchor[0]) / self._plan.sample_rate

    def due_uncertainty(self, position: int) -> float:
        """Return half of an interval around `due` that holds the true time.

        Parameters
        ----------
        position : int
            Position of a sample.

        Returns
        -------
        float
            Half of the interval; NaN while the amplifiers cannot be reached [s].
        """
        if not self._playing or self._peers[0].reset_evidence:
            return math.nan
        apart = SLACK / self._plan.sample_rate if len(self._peers) > 1 else 0.0
        return max(peer.due_uncertainty(position) for peer in self._peers) + apart

    def position_at(self, time: float) -> int:
        """Return the first position that is due at a host time or later.

        Parameters
        ----------
        time : float
            Host time [s].

        Returns
        -------
        int
            Position of a sample.
        """
        at, when = self._anchor
        at += math.ceil((time - when) * self._plan.sample_rate - 1e-9)
        return at + math.ceil((time - self.due(at)) * self._plan.sample_rate - 1e-9)

    @property
    def ahead(self) -> float:
        """Time by which samples have to be written before they are put out [s].

        It is the sum of the lead, the time that a packet or a frame takes on the wire, and the time
        of the samples that the amplifiers after the first wait for to follow its clock.
        """
        plan = self._plan
        waits = HALF if len(self._peers) > 1 and not plan.carriers else 0
        return self.lead + (plan.use * plan.packet_samples + waits) / plan.sample_rate

    def freeze(self, now: float) -> None:
        """Let positions pass by the clock of the host, since the amplifiers' is out of reach.

        Samples that wait are dropped and counted.

        Parameters
        ----------
        now : float
            Host time [s].
        """
        self._set_anchor(now)
        self._playing = False
        self.clear()

    def _set_anchor(self, now: float) -> None:
        """Remember the position of now, for when the amplifiers' clock is lost or began anew."""
        if self._playing and not self._peers[0].reset_evidence:
            at = self.position_at(now)
            self._anchor = (at, self.due(at))

    def resume(self) -> None:
        """Let positions pass by the amplifiers' clock again, as they played on during a freeze."""
        self._playing = True

    @property
    def underruns(self) -> int:
        """Number of underruns of all amplifiers."""
        return sum(peer.underruns for peer in self._peers)

    @property
    def credit_faults(self) -> int:
        """Number of PULSEs of all amplifiers with a credit that cannot be right."""
        return sum(peer.credit_faults for peer in self._peers)

    @property
    def late(self) -> int:
        """Number of samples that were too late for their amplifiers, as far as reported."""
        return sum(peer.late for peer in self._peers)

    def control(self, now: float, *, running: bool) -> None:
        """Count new underruns, late samples and faults of the credit, and adapt the lead.

        Parameters
        ----------
        now : float
            Host time [s].
        running : bool
            Whether the session is in `SessionPhase.RUN`; the lead adapts only then.
        """
        self._blocked = False
        self._set_anchor(now)
        fresh, self._underruns = self.underruns - self._underruns, self.underruns
        self._counters.underruns += fresh
        late, self._late = self.late - self._late, self.late
        self._counters.late_blocks -= -late // self._plan.packet_samples
        self._counters.credit_faults += self.credit_faults - self._credit_faults
        self._credit_faults = self.credit_faults
        if running and fresh:
            self.lead = min(self.lead * RAISE, self._most)
        elif running and now > self._lowered:
            self.lead = max(self.lead - LOWER * (now - self._lowered), self._least)
        self._lowered = max(now, self._lowered)

    def unplayed(self, first: int, written: int, *, running: bool) -> int:
        """Return how many positions since playing began are not known to have been put out.

        Parameters
        ----------
        first, written : int
            Position with which playing began, and position after what was written.
        running : bool
            Whether positions that have not passed yet may still be put out.

        Returns
        -------
        int
            Number of positions, for the amplifier that lost most.
        """
        return max(
            peer.unplayed(first, written, self._held, running=running) for peer in self._peers
        )

    # What waits

    def add(self, position: int, volts: Floats) -> None:
        """Pack samples, which then wait to be sent.

        Samples that do not fill a packet wait for the next ones. Positions before the start are
        dropped and counted.

        Parameters
        ----------
        position : int
            Position of the first sample.
        volts : (S, C) array of float
            Drive voltage [V].
        """
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
        # A copy, since the caller may reuse its array.
        self._partial, self._partial_start = volts[whole:].copy(), start + whole

    def hold(self) -> int:
        """Repeat the last sample for `HOLD`.

        Returns
        -------
        int
            Position after what was written, without the repetitions.
        """
        end = self.end
        self._flush()
        self._marks.forget()  # what is repeated was not written
        if self._last is not None:
            self._held = math.ceil(HOLD * self._plan.sample_rate)
            held, size = end + self._held, self._plan.packet_samples
            for at in range(end, held, size):
                self._pack(at, np.tile(self._last, (min(size, held - at), 1)))
        return end

    def _flush(self) -> None:
        """Pack the samples that wait for others to fill their packet."""
        volts, self._partial = self._partial, self._partial[:0]
        if len(volts):
            self._pack(self._partial_start, volts)

    def _pack(self, position: int, volts: Floats) -> None:
        """Pack samples for all amplifiers, those after the first resampled to their clocks."""
        self._last = volts[-1].copy()
        first, *others = self._peers
        packets = self._packed_marks(position, position + len(volts))
        packets += self._packed(first, [(position, volts[:, self._spans[0]])])
        for follower, peer, span in zip(self._followers, others, self._spans[1:], strict=True):
            apart = self._clock_lead(peer, position)
            packets += self._packed(peer, follower.feed(position, volts[:, span], apart))
        self._parts.append(PendingSamples(position, position + len(volts), packets))
        self._tail = position + len(volts) if others else None

    def _packed(self, peer: Peer, pieces: list[Piece]) -> list[tuple[Peer, int, list[Packet]]]:
        """Return packets of pieces for an amplifier, each with the wire position after it."""
        kind, packets = self._plan.sample_format, []
        assert kind is not None
        for start, piece in pieces:
            at = peer.wire_position(start, len(piece))
            messages = pcm(
                at, codes_of(piece, peer.caps.full_scale_uv * 1e-6), session=peer.host.session,
                sample_format=kind, packet_limit=self._plan.packet_limit,
            )  # fmt: skip
            packets.append((peer, at + len(piece), self._packets_of(peer, messages)))
        return packets

    # Marks

    @property
    def marker(self) -> Peer | None:
        """First amplifier that has marker lines, which shows the marks; None if none has."""
        return next((peer for peer in self._peers if peer.caps.marker_lines), None)

    def mark(self, position: int, code: int) -> None:
        """Let a mark wait until its sample is packed, ahead of which it is sent.

        Parameters
        ----------
        position : int
            Position of a sample or a frame that has not been added yet.
        code : int
            Code for the marker lines.
        """
        self._marks.add(position, code)

    def marked(self, peer: Peer, message: m.Marked) -> MarkReport | None:
        """Return what an amplifier reports of a mark.

        Parameters
        ----------
        peer : Peer
            Amplifier.
        message : Marked
            Its message.

        Returns
        -------
        MarkReport or None
            The report; None if it is of no mark that was sent to it since START.
        """
        return self._marks.report(message) if peer is self.marker else None

    def _packed_marks(self, start: int, end: int) -> list[tuple[Peer, int, list[Packet]]]:
        """Return packets of the marks of positions, as `_packed` does those of samples."""
        peer = self.marker
        if peer is None:
            return []

        def wire(position: int) -> int:
            return peer.wire_end(position - self._early(peer, position))

        messages = self._marks.take(start, end, peer.host.session, wire)
        return [(peer, mark.position + 1, self._packets_of(peer, [mark])) for mark in messages]

    def _early(self, peer: Peer, position: int) -> int:
        """Return how many positions before its own an amplifier is sent a sample or a frame."""
        k = self._peers.index(peer)
        if k == 0:
            return 0
        if self._plan.carriers:
            return round(self._clock_lead(peer, position))
        return round(self._followers[k - 1].offset)

    def _flush_followers(self) -> None:
        """Pack what the followers keep back for samples that do not come."""
        packets = []
        for follower, peer in zip(self._followers, self._peers[1:], strict=True):
            packets += self._packed(peer, follower.flush())
        assert self._tail is not None
        self._parts.append(PendingSamples(self._tail - HALF, self._tail, packets))
        self._tail = None

    def _clock_lead(self, peer: Peer, position: int) -> float:
        """Return the lead of the first amplifier over another one at a position [samples]."""
        if not self._playing or peer.reset_evidence or self._peers[0].reset_evidence:
            return 0.0
        return (peer.due(position) - self._peers[0].due(position)) * self._plan.sample_rate

    def add_frame(self, position: int, volts: Complex, carriers: Floats) -> None:
        """Pack a frame, which then waits to be sent.

        That of the start is left out: all envelopes are 0 there.

        Parameters
        ----------
        position : int
            Position of the frame.
        volts : (C, P) array of complex
            Envelopes [V].
        carriers : (P,) array of float
            Frequencies of the carriers [Hz].
        """
        if position <= self._from:
            return
        plan, packets = self._plan, self._packed_marks(self.end, position + 1)
        increment = spectrum.increments(carriers, plan.sample_rate).astype(np.int64)
        spacing = plan.packet_samples
        valid = 2 * spacing  # 40 ms at the fewest frames a second; 50 are allowed (SPEC.md, 10.2)
        self.end = position
        for peer, span in zip(self._peers, self._spans, strict=True):
            at = peer.wire_position(position - self._early(peer, position), 1)
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
            packets.append((peer, at, self._packets_of(peer, messages)))
        self._parts.append(PendingSamples(position - spacing, position, packets))

    @staticmethod
    def _packets_of(peer: Peer, messages: Iterable[Message]) -> list[Packet]:
        """Return messages to an amplifier as packets that want no answer."""
        return [peer.host.packet(message) for message in messages]

    def clear(self, now: float = math.inf) -> None:
        """Drop what waits to be sent.

        Parameters
        ----------
        now : float
            Host time of a stop, before which samples were due that count as dropped; by default all
            count [s].
        """
        self._flush()
        for part in self._parts:
            if self.due(part.end) <= now:
                self._drop(part)
        self._parts.clear()
        self._marks.forget()
        self._last = self._tail = None
        self.no_credit = ""

    def _drop(self, part: PendingSamples) -> None:
        """Count samples that are not sent: a frame as one, and repetitions of `hold` as none."""
        samples = 1 if self._plan.carriers else max(min(part.end, self.end) - part.start, 0)
        self._counters.dropped_samples += samples

    @property
    def deadline(self) -> float:
        """Host time at which `take` has something to send, -inf for now and inf for never [s]."""
        if self._parts:
            return self.due(self._parts[0].end) if self._blocked else -math.inf
        partial = self.due(self._partial_start) if len(self._partial) else math.inf
        tail = math.inf if self._tail is None else self.due(self._tail - HALF)
        return min(partial, tail) - LATEST

    def take(self, now: float) -> list[Packet]:
        """Return the next packets, if the amplifiers have room for them.

        Samples whose time has passed are dropped and counted, for want of credit or not.

        Parameters
        ----------
        now : float
            Host time [s].

        Returns
        -------
        list of Packet
            Packets of the same positions for all amplifiers; empty if nothing can be sent now.
        """
        # The times are those of `deadline`.
        if len(self._partial) and now >= self.due(self._partial_start) - LATEST:
            self._flush()
        if self._tail is not None and now >= self.due(self._tail - HALF) - LATEST:
            self._flush_followers()
        while self._parts:
            part = self._parts[0]
            full = next(((p, end) for p, end, _ in part.packets if not p.has_credit(end)), None)
            passed = self.due(part.end) <= now
            self._blocked = full is not None and not passed
            if self._blocked:
                return []
            self._parts.popleft()
            self._counters.late_blocks += self.due(part.start) < now
            self.no_credit = "" if full is None else full[0].no_credit(full[1], now)
            if not passed:
                return [packet for _, _, packets in part.packets for packet in packets]
            self._drop(part)
        return []
