"""The inlet of LSL: a stream of markers that another program offers."""

import math
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from tactile.lsl.library import load_pylsl

LOOK = 0.5
"""Longest wait before it is looked whether the bridge ends [s]."""
PATIENCE = 5.0
"""Longest wait for a stream that was found [s]."""


class StampedMarker(NamedTuple):
    """A marker with its time on the clock of LSL of this machine [s]."""

    text: str
    time: float


class MarkerInlet:
    """Reader of a stream of markers, which may appear later, vanish and come back.

    Parameters
    ----------
    name : str
        Name of the stream: of one channel of texts or whole numbers, without a rate.
    tell : Callable
        Function that takes a line about the stream for the user.

    Attributes
    ----------
    unreadable : int
        Number of markers that are no text in UTF-8, or have no time.
    """

    def __init__(self, name: str, tell: Callable[[str], None]) -> None:
        self._name, self._tell = name, tell
        self._lsl = load_pylsl()
        self._last_fault = ""
        self.unreadable = 0

    def read(self, stop: threading.Event) -> Iterator[StampedMarker]:
        """Read markers until an event is set.

        Parameters
        ----------
        stop : threading.Event
            Event that ends the reading.

        Yields
        ------
        StampedMarker
            Next marker.
        """
        errors = self._lsl.util.LostError, self._lsl.util.TimeoutError
        while not stop.is_set():
            try:
                info = self._find()
                if info is not None:
                    yield from self._read_stream(info, stop)
                elif self._last_fault:
                    stop.wait(LOOK)  # a stream that cannot be used is found at once each time
            except errors as error:
                self._tell(f"stream {self._name!r}: {error}")

    def _find(self) -> Any:
        """Return a stream of the name, or None if there is none now that can be used."""
        quote = '"' if "'" in self._name else "'"
        predicate = f"name={quote}{self._name}{quote}"
        found = self._lsl.resolve_bypred(predicate, timeout=LOOK)
        faults = [self._fault_of(info) for info in found]
        if "" in faults:
            self._last_fault = ""
            return found[faults.index("")]
        if faults and faults[0] != self._last_fault:
            self._last_fault = faults[0]
            self._tell(f"stream {self._name!r}: {faults[0]}")
        return None

    def _fault_of(self, info: Any) -> str:
        """Return why a stream is none of markers, or nothing."""
        lsl = self._lsl
        formats = lsl.cf_string, lsl.cf_int8, lsl.cf_int16, lsl.cf_int32, lsl.cf_int64
        if info.channel_count() != 1:
            return f"has {info.channel_count()} channels; one of markers has 1"
        if info.nominal_srate() != lsl.IRREGULAR_RATE:
            return f"has a rate of {info.nominal_srate():g} Hz; one of markers has none"
        if info.channel_format() not in formats:
            return "has values that are neither texts nor whole numbers"
        return ""

    def _read_stream(self, info: Any, stop: threading.Event) -> Iterator[StampedMarker]:
        """Yield the markers of a stream until it is lost for good."""
        inlet = self._lsl.StreamInlet(info, recover=True)
        inlet.open_stream(PATIENCE)
        inlet.time_correction(PATIENCE)  # the first takes a while, for which no marker is to wait
        self._tell(f"markers of {self._name!r} on {info.hostname()} start effects")
        while not stop.is_set():
            try:
                sample, stamp = inlet.pull_sample(LOOK)
            except UnicodeDecodeError:
                self.unreadable += 1
                continue
            if sample is None:
                continue
            if math.isfinite(stamp):
                yield StampedMarker(str(sample[0]), stamp + inlet.time_correction(PATIENCE))
            else:
                self.unreadable += 1
