"""Stimuli that are to begin at a time, and the samples at which they began.

A `Schedule` holds the orders of all clients until the block in which their time falls. It knows no
clock: the times of the samples of a block are passed in.
"""

import bisect
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from tactile.arrays import Singles
from tactile.playback.commands import AddFrames, AppendSamples, BeginEffect, PlayAt
from tactile.playback.waveforms import GRID_WORK, LONGEST, SEGMENT_WORK, WEIGHTS_WORK

MOST_SCHEDULED, MOST_VALUES = 64, 1 << 19
"""Maximum numbers of stimuli of one client that wait for their time, and of their values: 2 MB, a
second of frames of 64 contactors at 8 kHz."""
MOST_FRAME_VALUES = 1 << 18
"""Maximum number of values of a stream of frames that waits for its time: 1 MB, which is allocated
at once."""
BEGIN_WORK, VALUES = 800, 100
"""Work of beginning a stimulus, and number of values that are moved with one unit of work; in units
of `tactile.playback.waves`."""
CUT_WORK = GRID_WORK + WEIGHTS_WORK + SEGMENT_WORK
"""Work of cutting a block in two, for each stimulus that has begun in it before."""


@dataclass(frozen=True)
class StimulusOutcome:
    """What became of a stimulus when its time had come.

    Attributes
    ----------
    number : int
        Number of the stimulus.
    client : int
        Number of the client.
    position : int or None
        Position of its first sample in the drive [samples]; None if it was dropped.
    reason : str
        Reason why it was dropped, or did not begin at its time; empty if it did.
    marker : int
        Code that the marker lines are to take with its first sample; 0 for none.
    """

    number: int
    client: int
    position: int | None
    reason: str = ""
    marker: int = 0


@dataclass(frozen=True)
class Begin:
    """Stimulus that begins in a block.

    Attributes
    ----------
    offset : int
        Sample of the block with which it begins.
    order : PlayAt
        The stimulus.
    late : float
        Time by which it is late; 0 if its time is within the block [s].
    """

    offset: int
    order: PlayAt
    late: float


@dataclass(frozen=True)
class QueuedStimulus:
    """Stimulus whose first sample has a position, at which its contactors are free.

    Attributes
    ----------
    order : PlayAt
        The stimulus.
    position : int
        Position of its first sample in the drive [samples].
    reason : str
        Reason why it does not begin at its time; empty if it does.
    """

    order: PlayAt
    position: int
    reason: str

    @property
    def outcome(self) -> StimulusOutcome:
        """What becomes of it if it is not dropped before."""
        order = self.order
        return StimulusOutcome(order.number, order.client, self.position, self.reason, order.marker)

    def waits_for(self, contactors: tuple[int, ...]) -> bool:
        """Return whether it is a waveform that plays on some of these contactors.

        Parameters
        ----------
        contactors : tuple of int
            Contactors; empty for all.

        Returns
        -------
        bool
            Whether one of them is its own; effects and frames wait for none.
        """
        order = self.order.order
        if not isinstance(order, AppendSamples):
            return False
        own = order.contactors
        return not own or not contactors or not set(own).isdisjoint(contactors)


@dataclass
class _Waiting:
    """Stimulus that waits for its time, with frames that continue it."""

    order: PlayAt
    rows: int
    values: int
    frames: Singles | None = None

    @property
    def whole(self) -> PlayAt:
        """The stimulus with the frames that continue it."""
        if self.frames is None or not isinstance(self.order.order, AddFrames):
            return self.order
        return replace(self.order, order=replace(self.order.order, frames=self.frames[: self.rows]))


class Schedule:
    """Stimuli that wait for their time."""

    def __init__(self) -> None:
        self._waiting: dict[int, list[_Waiting]] = {}

    def add(self, order: PlayAt) -> int | None:
        """Add a stimulus, of samples and frames as many as may wait.

        Parameters
        ----------
        order : PlayAt
            The stimulus.

        Returns
        -------
        int or None
            Number of samples, frames or points that were taken; None if there was no room.
        """
        own, stimulus = self._waiting.setdefault(order.client, []), order.order
        if isinstance(stimulus, AppendSamples):
            samples = stimulus.samples[: int(stimulus.longest * stimulus.sample_rate)]
            stimulus = replace(stimulus, samples=samples.copy())
        elif isinstance(stimulus, AddFrames):
            stimulus = replace(stimulus, frames=stimulus.frames[: _most_frames(stimulus)].copy())
        rows, values = _size(stimulus)
        if len(own) >= MOST_SCHEDULED or values > self._room(order.client):
            return None
        new = _Waiting(replace(order, order=stimulus), rows, values)
        bisect.insort(own, new, key=lambda waiting: waiting.order.time)
        return rows

    def _room(self, client: int) -> int:
        """Return the number of values that may still be added for a client."""
        return MOST_VALUES - sum(one.values for one in self._waiting.get(client, ()))

    def extend(self, order: AddFrames) -> int | None:
        """Add frames to the stream that they continue and that waits.

        Parameters
        ----------
        order : AddFrames
            Frames of the same rate and kind.

        Returns
        -------
        int or None
            Number of frames that were taken; None if nothing waits that they continue.
        """
        for waiting in reversed(self._waiting.get(order.client, ())):
            first = waiting.order.order
            if isinstance(first, AddFrames) and (first.frame_rate, first.latest) == (
                order.frame_rate, order.latest
            ):  # fmt: skip
                most, contactors = _most_frames(order), order.frames.shape[1]
                room = min(most - waiting.rows, self._room(order.client) // contactors)
                part = order.frames[: max(room, 0)]
                if waiting.frames is None:
                    waiting.frames = np.empty((most, contactors), np.float32)
                    waiting.frames[: waiting.rows] = first.frames
                waiting.frames[waiting.rows : waiting.rows + len(part)] = part
                waiting.rows += len(part)
                waiting.values += part.size
                return len(part)
        return None

    def take(
        self,
        first: float,
        count: int,
        sample_rate: float,
        work: float,
        voice_work: Callable[[int], int],
    ) -> tuple[dict[int, list[Begin]], int]:
        """Take the stimuli that begin in a block, or should have begun before it.

        Parameters
        ----------
        first : float
            Time at which the first sample of the block is put out [s].
        count : int
            Number of samples of the block.
        sample_rate : float
            Rate of the samples [Hz].
        work : float
            Work for which there is time. The stimuli beyond it begin late, in the next block.
        voice_work : Callable
            Function that returns the work of a client's block, by its number.

        Returns
        -------
        begins : dict of int to list of Begin
            Stimuli by the number of their client, in the order of their times.
        used : int
            Work of beginning them.

        Notes
        -----
        The first stimulus of each client comes before the second of any, so that none that has
        many makes others late. The clock of the amplifier is known a little better with each block:
        what is late by less than a sample is not late.
        """
        end = first + (count - 0.5) / sample_rate
        due = sorted(
            (number, waiting.order.time, client)
            for client, own in self._waiting.items()
            for number, waiting in enumerate(takewhile(lambda one: one.order.time < end, own))
        )
        begins: dict[int, list[Begin]] = {}
        full = set[int]()
        used = 0
        for _, time, client in due:
            if client in full:
                continue
            waiting, own = self._waiting[client][0], begins.get(client, [])
            offset = max(round((time - first) * sample_rate), 0)
            cost = BEGIN_WORK + waiting.values // VALUES
            if offset > (own[-1].offset if own else 0):
                cost += voice_work(client) + CUT_WORK * (1 + len(own))
            if used + cost > work:
                full.add(client)
                continue
            used += cost
            del self._waiting[client][0]
            late = first - time if (first - time) * sample_rate > 1 else 0.0
            begins.setdefault(client, own).append(Begin(offset, waiting.whole, late))
        return begins, used

    def drop(self, client: int | None = None) -> list[PlayAt]:
        """Take stimuli that will not be played.

        Parameters
        ----------
        client : int, optional
            Client whose stimuli are taken; by default those of all.

        Returns
        -------
        list of PlayAt
            Stimuli that were taken.
        """
        clients = list(self._waiting) if client is None else [client]
        return [one.order for number in clients for one in self._waiting.pop(number, [])]


def _most_frames(order: AddFrames) -> int:
    """Return the number of frames of a stream that may wait, as many as may when it plays."""
    return int(min(LONGEST * order.frame_rate, MOST_FRAME_VALUES / order.frames.shape[1]))


def _size(order: AppendSamples | AddFrames | BeginEffect) -> tuple[int, int]:
    """Return the numbers of samples, frames or points of an order, and of their values."""
    if isinstance(order, BeginEffect):
        curve = order.curve
        points = len(curve.amplitude) + len(curve.frequency) + len(curve.transients)
        return points, curve.amplitude.size + curve.frequency.size + curve.transients.size
    values = order.samples if isinstance(order, AppendSamples) else order.frames
    return len(values), values.size
