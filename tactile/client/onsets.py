"""Stimuli that begin at a time, and the times at which they began."""

import asyncio
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future, InvalidStateError
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from typing import Any

from tactile.client.wire import Onset, to_microseconds, to_number, to_onset
from tactile.clock import MONOTONIC, Clock
from tactile.errors import ClientTimeoutError, DisconnectedError, InputError
from tactile.messages import FARTHEST, BeginAt, OnsetMessage

PATIENCE = 5.0
"""Longest wait for a report after the time of a stimulus, unless another timeout is given [s]. It
comes after 0.3 s, and a little later the report of one that began late."""
FORGOTTEN = 120.0
"""Time since a stimulus was sent after which it is forgotten if no report came [s]."""


class At:
    """Time at which a stimulus is to begin, and the onset that is reported of it.

    Parameters
    ----------
    time : float
        Time on the clock of `time.monotonic`, at most 60 s ahead [s].
    drop_late : bool
        Whether the stimulus is dropped if it cannot begin at that time; by default it begins as
        soon as possible.
    marker : int
        Code that the marker lines of the amplifier take with its first sample, for 10 ms, so that
        a recorder sees it: below 2 to the power of `DisplayInfo.marker_lines`; 0 for none.

    Attributes
    ----------
    time : float
        Time at which the stimulus is to begin [s].
    drop_late : bool
        Whether it is dropped if it cannot.
    marker : int
        Code that the marker lines take with its first sample.
    used : bool
        Whether a stimulus has this time, as only one may.

    Raises
    ------
    InputError
        If the time is not a finite number, or the marker none of 0 … 255.
    """

    def __init__(self, time: float, *, drop_late: bool = False, marker: int = 0) -> None:
        if marker not in range(1 << 8):
            raise InputError(f"marker {marker!r}: a code of 8 lines is one of 0 … 255")
        self.time, self.drop_late = to_number(time, "at [s]"), drop_late
        self.marker = int(marker)
        self.used = False
        self._onset: Future[Onset] = Future()

    @property
    def known(self) -> bool:
        """Whether it is known what became of the stimulus."""
        return self._onset.done()

    def onset(self, timeout: float | None = None) -> Onset:
        """Wait until it is known what became of the stimulus.

        That is a third of a second after it began. Under asyncio, await this object instead.

        Parameters
        ----------
        timeout : float, optional
            Longest wait; by default until 5 s after the time [s].

        Returns
        -------
        Onset
            Time at which it began, or why it did not.

        Raises
        ------
        ClientTimeoutError
            If it is not known within the timeout.
        DisconnectedError
            If the connection was lost meanwhile.
        """
        longest = self._patience() if timeout is None else timeout
        try:
            return self._onset.result(longest)
        except FutureTimeoutError:
            raise ClientTimeoutError(f"onset: not known after {longest:g} s") from None

    def __await__(self) -> Generator[Any, None, Onset]:
        return self._awaited().__await__()

    async def _awaited(self) -> Onset:
        longest = self._patience()
        # the future is shielded, so that a program may wait for it again
        waiting = asyncio.shield(asyncio.wrap_future(self._onset))
        try:
            async with asyncio.timeout(longest):
                return await waiting
        except TimeoutError:
            raise ClientTimeoutError(f"onset: not known after {longest:g} s") from None

    def _patience(self) -> float:
        return max(self.time - MONOTONIC.now(), 0.0) + PATIENCE

    @property
    def dropped(self) -> bool:
        """Whether it is known that the stimulus did not begin."""
        if not self._onset.done():
            return False
        return self._onset.exception() is not None or self._onset.result().time is None


class Onsets:
    """Stimuli of a session whose onsets are not known yet.

    Parameters
    ----------
    clock : Clock
        Clock of the program.
    offset : Callable
        Function that returns the server's clock less the program's, and the uncertainty of that
        [s].
    """

    def __init__(self, clock: Clock, offset: Callable[[], tuple[float, float]]) -> None:
        self._clock, self._offset = clock, offset
        self._lock = threading.Lock()
        self._last = 0
        self._waiting: dict[int, tuple[float, At]] = {}
        """Stimuli by their numbers, each with the time at which it was sent."""

    def begin(self, at: "float | At | None") -> BeginAt | None:
        """Return the part of a message that says when a stimulus is to begin.

        Parameters
        ----------
        at : float or At or None
            Time on the program's clock [s]; None for as soon as possible.

        Returns
        -------
        BeginAt or None
            Time on the server's clock.

        Raises
        ------
        InputError
            If it is not a finite number, too far ahead, or has been used for another stimulus.
        """
        if at is None:
            return None
        stimulus, now = at if isinstance(at, At) else At(at), self._clock.now()
        if stimulus.time - now > FARTHEST:
            ahead = f"{stimulus.time - now:.6g} s ahead"
            raise InputError(f"at [s]: {ahead}; at most {FARTHEST:g} s, of time.monotonic()")
        with self._lock:
            if stimulus.used:
                raise InputError("at: it belongs to another stimulus; make an At for each")
            stimulus.used = True
            for number, (sent, _) in list(self._waiting.items()):
                if sent > now - FORGOTTEN:
                    break
                del self._waiting[number]
            self._last += 1
            self._waiting[self._last] = now, stimulus
        time_us = to_microseconds(stimulus.time + self._offset()[0])
        return BeginAt(
            at_us=time_us, drop_late=stimulus.drop_late, number=self._last, marker=stimulus.marker
        )

    def refused(self, begin: BeginAt | None, error: Exception) -> None:
        """Report that the server does not play a stimulus.

        Parameters
        ----------
        begin : BeginAt or None
            Beginning as `begin` returned it.
        error : Exception
            Reason, which `At.onset` raises.
        """
        stimulus = self._take(begin.number) if begin is not None else None
        if stimulus is not None:
            with suppress(InvalidStateError):
                stimulus._onset.set_exception(error)

    def received(self, message: OnsetMessage) -> None:
        """Take the report on a stimulus.

        Parameters
        ----------
        message : OnsetMessage
            Report of the server.
        """
        onset = to_onset(message, *self._offset())
        stimulus = self._take(message.number)
        if stimulus is not None:
            with suppress(InvalidStateError):
                stimulus._onset.set_result(onset)

    def lost(self, reason: str) -> None:
        """Report that no onset is going to be known any more, as the connection was lost.

        Parameters
        ----------
        reason : str
            Why there is no connection.
        """
        with self._lock:
            waiting, self._waiting = list(self._waiting.values()), {}
        for _, stimulus in waiting:
            with suppress(InvalidStateError):
                stimulus._onset.set_exception(DisconnectedError(reason))

    def _take(self, number: int) -> At | None:
        with self._lock:
            return self._waiting.pop(number, (0.0, None))[1]
