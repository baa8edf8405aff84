"""Effects that markers start, and what became of them."""

import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from tactile.client import At, RemoteDisplay
from tactile.clock import MONOTONIC
from tactile.errors import ClientTimeoutError, NotFoundError, TactileError
from tactile.lsl.inlet import StampedMarker
from tactile.lsl.timing import LslClock

MOST_PENDING = 64
"""Maximum number of stimuli whose onsets are not known yet, as many as the server takes."""
PATIENCE = 10.0
"""Time after which a stimulus is given up whose onset is not reported [s]."""


@dataclass(eq=False)
class _Pending:
    """A stimulus whose onset is not known yet, and the marker that started it."""

    text: str
    at: At


class StimulusStarter:
    """Starter of the effects that markers name.

    An effect begins a fixed time after its marker, so that the latency is constant. One that would
    begin later than that is dropped, because a late stimulus spoils a trial.

    Parameters
    ----------
    display : RemoteDisplay
        Display that plays the effects.
    clock : LslClock
        Clock of LSL.
    starts : mapping of str to str
        Effect that each marker starts; one that is not in it starts the effect of its name.
    delay : float
        Time from a marker to its effect [s].

    Attributes
    ----------
    begun, dropped, ignored : int
        Number of effects that began, of those that did not, and of markers that name no effect.

    Raises
    ------
    NotFoundError
        If the server has no effect of a name.
    """

    def __init__(
        self, display: RemoteDisplay, clock: LslClock, starts: Mapping[str, str], delay: float
    ) -> None:
        self._display, self._clock, self._delay = display, clock, delay
        names = [effect.name for effect in display.effects()]
        self._starts = {name: name for name in names} | dict(starts)
        for effect in self._starts.values():
            if effect not in names:
                listed = ", ".join(names) or "none"
                raise NotFoundError(f"no effect {effect!r} on the server; there are: {listed}")
        self._lock = threading.Lock()
        self._pending: list[_Pending] = []
        self._reports: list[StampedMarker] = []
        self.begun = self.dropped = self.ignored = 0

    def start(self, marker: StampedMarker) -> None:
        """Start the effect that a marker names; a marker that names none is counted only.

        Parameters
        ----------
        marker : StampedMarker
            Marker.
        """
        effect = self._starts.get(marker.text)
        if effect is None:
            self.ignored += 1
            return
        time = self._clock.to_monotonic(marker.time) + self._delay
        stimulus = _Pending(marker.text, At(time, drop_late=True))
        with self._lock:
            is_full = len(self._pending) >= MOST_PENDING
            self._pending.append(stimulus)
        if is_full:
            self._drop(stimulus, f"{MOST_PENDING} stimuli wait already")
            return
        try:
            # what is not answered in time may be played, and its onset is reported then
            with suppress(ClientTimeoutError):
                self._display.play_effect(effect, at=stimulus.at)
        except TactileError as error:
            self._drop(stimulus, str(error))

    def take_reports(self) -> Iterable[StampedMarker]:
        """Return markers about the stimuli of which it has become known what became of them.

        Returns
        -------
        iterable of StampedMarker
            The marker that started each at the time of its onset, and what there is to say of it.
        """
        now = MONOTONIC.now()
        with self._lock:
            waiting = list(self._pending)
        for stimulus in waiting:
            if stimulus.at.known:
                self._settle(stimulus)
            elif now > stimulus.at.time + PATIENCE:
                self._drop(stimulus, "its onset was not reported")
        with self._lock:
            reports, self._reports = self._reports, []
        return reports

    def finish(self) -> None:
        """Give up the stimuli whose onsets are not known yet."""
        with self._lock:
            waiting = list(self._pending)
        for stimulus in waiting:
            if stimulus.at.known:
                self._settle(stimulus)
            else:
                self._drop(stimulus, "its onset was not known at the end")

    def _settle(self, stimulus: _Pending) -> None:
        """Report a stimulus whose onset is known."""
        try:
            onset = stimulus.at.onset(0.0)
        except TactileError as error:
            self._drop(stimulus, str(error))
            return
        if onset.time is None:
            self._drop(stimulus, onset.reason)
            return
        time = self._clock.to_lsl(onset.time)
        reports = [StampedMarker(stimulus.text, time)]
        if onset.reason:
            reports.append(StampedMarker(f"{stimulus.text}: {onset.reason}", time))
        with self._lock:
            if stimulus in self._pending:
                self._pending.remove(stimulus)
                self._reports += reports
                self.begun += 1

    def _drop(self, stimulus: _Pending, reason: str) -> None:
        """Report at its time that a stimulus did not begin."""
        text = f"{stimulus.text}: dropped, {' '.join(reason.split())}"
        with self._lock:
            if stimulus in self._pending:  # the other thread may have reported it
                self._pending.remove(stimulus)
                self._reports.append(StampedMarker(text, self._clock.to_lsl(stimulus.at.time)))
                self.dropped += 1
