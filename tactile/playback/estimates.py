"""Estimates of loads and filters for them, made where they are asked for or in another process.

An update of 64 contactors takes 9 ms each 25 ms (``python -m benchmarks sensing``). A stroke that
one program plays waits for that (`OwnEstimates`). The playback loop of a server cannot: its blocks
are 2 ms long and are written 8 ms ahead. A thread of it would take turns with it at Python's
interpreter, for which both together need more than there is. So a process estimates for it
(`ProcessEstimates`). Its answers come 10 to 20 ms later, which the next requests allow for.
"""

import pickle
import queue
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tactile.processes import ChildProcess, pipes_of_parent, received, send
from tactile.sensing.correlation import SumWindow
from tactile.sensing.load_follower import FilterUpdate, LoadFollower

MOST_REQUESTS = 2
"""Largest number of windows that wait to be sent for an estimate, 50 ms; more are dropped."""
GONE = "the process that estimates the finger has ended; the filters of the mean finger play"
"""Failure of `ProcessEstimates`."""


@dataclass(frozen=True)
class EstimateRequest:
    """Request for the loads in a window.

    Attributes
    ----------
    generation : int
        Number that changes when the finger is to be forgotten.
    end : int
        Position after the latest drive when it was made.
    window : SumWindow
        Sums and drive of all contactors.
    lateness : float
        Time from the end of the window to the output of the sample from which on the filters are to
        play [samples].
    guard_lateness : float
        Time from the end of the window until guards are to know the loads [samples].
    trips : (N,) array of int
        Number of times that the guard of each contactor has tripped.
    """

    generation: int
    end: int
    window: SumWindow
    lateness: float
    guard_lateness: float
    trips: NDArray[np.intp]


@dataclass(frozen=True)
class EstimateAnswer:
    """Answer to an `EstimateRequest`.

    Attributes
    ----------
    generation, end : int
        Those of the request.
    trips : (N,) array of int
        Those of the request.
    update : FilterUpdate
        Loads, and filters for them.
    """

    generation: int
    end: int
    trips: NDArray[np.intp]
    update: FilterUpdate


class WindowEstimator:
    """Estimator of one display that answers requests.

    Parameters
    ----------
    follower : LoadFollower
        Follower that estimates.
    """

    def __init__(self, follower: LoadFollower) -> None:
        self._follower, self._generation = follower, 0
        self._trips = np.zeros((), np.intp)
        """Number of trips of each contactor by the latest request."""

    def answer(self, request: EstimateRequest) -> EstimateAnswer:
        """Estimate the loads in a window.

        Parameters
        ----------
        request : EstimateRequest
            Request.

        Returns
        -------
        EstimateAnswer
            Loads and filters.
        """
        if request.generation != self._generation:
            self._generation = request.generation
            self._follower.forget()
        self._follower.lift(request.trips != self._trips)
        self._trips = request.trips
        update = self._follower.estimate(
            request.window, lateness=request.lateness, guard_lateness=request.guard_lateness
        )
        return EstimateAnswer(request.generation, request.end, request.trips, update)


class Estimates(Protocol):
    """Place where loads are estimated.

    Attributes
    ----------
    dropped : int
        Number of windows that were dropped, because too many waited.
    """

    dropped: int

    @property
    def failure(self) -> str:
        """Reason why nothing is estimated any more; empty if it is."""

    def begin(self, follower: LoadFollower) -> None:
        """Get ready for a display.

        Parameters
        ----------
        follower : LoadFollower
            Follower of the display.
        """

    def ask(self, request: EstimateRequest) -> None:
        """Ask for the loads in a window; this neither waits nor raises.

        Parameters
        ----------
        request : EstimateRequest
            Request.
        """

    def take(self) -> list[EstimateAnswer]:
        """Remove and return the answers that have come.

        Returns
        -------
        list of EstimateAnswer
            Answers in the order of their requests.
        """


class OwnEstimates:
    """Estimates that are made at once, where they are asked for.

    Attributes
    ----------
    dropped : int
        Number of dropped windows, 0.
    failure : str
        Empty.
    """

    dropped = 0
    failure = ""

    def __init__(self) -> None:
        self._answers: list[EstimateAnswer] = []
        self._estimator: WindowEstimator

    def begin(self, follower: LoadFollower) -> None:
        """Get ready, as in `Estimates`."""
        self._estimator = WindowEstimator(follower)

    def ask(self, request: EstimateRequest) -> None:
        """Estimate the loads in a window, as in `Estimates`."""
        self._answers.append(self._estimator.answer(request))

    def take(self) -> list[EstimateAnswer]:
        """Return the answers, as in `Estimates`."""
        taken, self._answers = self._answers, []
        return taken


class ProcessEstimates(ChildProcess):
    """Estimates of a process of its own. One thread writes to it and another one reads.

    It must be started before this process gets a real-time priority, which it would inherit.

    Attributes
    ----------
    dropped : int
        Number of windows that were dropped, because too many waited.
    """

    def __init__(self) -> None:
        self._requests: queue.Queue[object] = queue.Queue(MOST_REQUESTS)
        self._answers: deque[EstimateAnswer] = deque()
        self._ended = threading.Event()
        self.dropped = 0
        super().__init__("tactile.playback.estimates", self._receive)
        self._begin_thread(self._write, "tactile-estimates:write")

    @property
    def failure(self) -> str:
        """Reason why nothing is estimated any more; empty if it is."""
        return GONE if self._ended.is_set() else ""

    def begin(self, follower: LoadFollower) -> None:
        """Get ready, as in `Estimates`."""
        self._requests.put_nowait(follower)

    def ask(self, request: EstimateRequest) -> None:
        """Ask for the loads in a window, as in `Estimates`; drop it if too many wait."""
        try:
            self._requests.put_nowait(request)
        except queue.Full:
            self.dropped += 1

    def take(self) -> list[EstimateAnswer]:
        """Return the answers, as in `Estimates`."""
        return [self._answers.popleft() for _ in range(len(self._answers))]

    def _receive(self, answer: Any) -> None:
        """Keep an answer; None means that the process has ended."""
        if answer is None:
            self._ended.set()
        else:
            self._answers.append(answer)

    def _write(self) -> None:
        """Write requests until the process is gone; later ones stay in the queue."""
        with suppress(OSError, ValueError):
            while (request := self._requests.get()) is not None:
                data = memoryview(pickle.dumps(request, protocol=5))
                while data:
                    data = data[self._pipe.write(data) :]

    def kill(self) -> None:
        """Kill the process at once, and close its threads and pipes."""
        with suppress(queue.Full):
            self._requests.put_nowait(None)
        super().kill()


def main() -> None:
    """Answer the requests of the parent until it ends; the first message is a `LoadFollower`."""
    inward, outward = pipes_of_parent()
    messages = received(inward)
    estimator = WindowEstimator(next(messages))
    for request in messages:
        send(outward, estimator.answer(request))
