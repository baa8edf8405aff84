"""Stimuli that begin at a time, and the clients to which their onsets are reported."""

import math
from collections.abc import Callable

from tactile.messages import BeginAt, OnsetMessage
from tactile.playback.commands import (
    AddFrames,
    AppendSamples,
    BeginEffect,
    OnsetReport,
    Order,
    PlayAt,
)

Stimulus = AppendSamples | BeginEffect | AddFrames
"""Order of what may begin at a time."""


class Stimuli:
    """Stimuli of one display on which playback has not reported.

    Parameters
    ----------
    display : str
        Name of the display.
    post : callable
        Function that is called with each `OnsetMessage` and the number of the client it is for.
    """

    def __init__(self, display: str, post: Callable[[OnsetMessage, int], None]) -> None:
        self._display, self._post = display, post
        self._waiting: dict[int, tuple[int, BeginAt]] = {}
        self._last = 0

    def timed(self, order: Stimulus, begin: BeginAt | None) -> Stimulus | PlayAt:
        """Return an order that is carried out at a time, and reported on then.

        Parameters
        ----------
        order : AppendSamples or BeginEffect or AddFrames
            What a client plays.
        begin : BeginAt or None
            Time at which it is to begin; None for at once.

        Returns
        -------
        AppendSamples or BeginEffect or AddFrames or PlayAt
            Order to playback.
        """
        if begin is None:
            return order
        self._last += 1
        self._waiting[self._last] = order.client, begin
        return PlayAt(
            self._last, order.client, begin.at_us * 1e-6, begin.drop_late, order, begin.marker
        )

    def report(self, report: OnsetReport) -> None:
        """Report to its client what became of a stimulus.

        Parameters
        ----------
        report : OnsetReport
            Report of playback.
        """
        if report.number in self._waiting:
            client, begin = self._waiting.pop(report.number)
            self._send(client, begin, report)

    def refuse(self, client: int, begin: BeginAt, reason: str) -> None:
        """Report that what was to begin at a time cannot be played.

        Parameters
        ----------
        client : int
            Number of the client.
        begin : BeginAt
            Time at which it was to begin.
        reason : str
            Reason in one line.
        """
        self._send(client, begin, OnsetReport(0, client, math.nan, math.nan, reason))

    def _send(self, client: int, begin: BeginAt, report: OnsetReport) -> None:
        message = OnsetMessage(
            display=self._display,
            number=begin.number,
            at_us=begin.at_us,
            onset_us=_microseconds(report.time),
            uncertainty_us=_microseconds(report.uncertainty),
            reason=report.reason,
            marker=report.marker,
        )
        self._post(message, client)

    def miss(self, order: Order, reason: str) -> None:
        """Report that an order was not carried out, if it was to be at a time.

        Parameters
        ----------
        order : Order
            Order to playback.
        reason : str
            Reason in one line.
        """
        if isinstance(order, PlayAt):
            self.report(OnsetReport(order.number, order.client, math.nan, math.nan, reason))

    def forget(self, order: Order) -> None:
        """Forget a stimulus that playback has refused: its client learns it by the answer.

        Parameters
        ----------
        order : Order
            Order to playback.
        """
        if isinstance(order, PlayAt):
            self._waiting.pop(order.number, None)

    def lose(self, reason: str) -> None:
        """Report that none of the stimuli is played.

        Parameters
        ----------
        reason : str
            Reason in one line.
        """
        for number, (client, _) in list(self._waiting.items()):
            self.report(OnsetReport(number, client, math.nan, math.nan, reason))


def _microseconds(seconds: float) -> float | None:
    """Return a time [µs]; None if it is not known, as JSON has neither NaN nor infinity."""
    return seconds * 1e6 if math.isfinite(seconds) else None
