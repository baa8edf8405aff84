"""Waveforms as they go over the wire: little-endian float32, in parts, without numpy."""

import sys
from array import array
from collections.abc import Iterable, Iterator
from itertools import islice

import msgspec

from tactile.client.wire import Appended, checked, to_index, to_items, to_number
from tactile.errors import InputError
from tactile.messages import MOST_SAMPLES, Append

SHORTEST_PAUSE, LONGEST_PAUSE = 0.005, 0.1
"""Limits of the time to wait before what the server had no room for is sent again [s]."""


def packed(samples: Iterable[float]) -> bytes:
    """Return samples as little-endian float32.

    Parameters
    ----------
    samples : iterable of float
        Samples −1 … 1, of which at most `MOST_SAMPLES` are taken.

    Returns
    -------
    bytes
        Four bytes for each sample.

    Raises
    ------
    InputError
        If a sample is outside −1 … 1, or not a number.
    """
    try:
        values = array("f", islice(samples, MOST_SAMPLES))
    except (TypeError, OverflowError) as error:
        raise InputError(f"samples: {error}") from None
    for index, value in enumerate(values):
        if not -1.0 <= value <= 1.0:
            raise InputError(f"samples[{index}]: {value} is outside −1 … 1 of the amplitude")
    if sys.byteorder == "big":
        values.byteswap()
    return values.tobytes()


class Waveform:
    """A waveform that is being sent, in as many parts as the server takes.

    Parameters
    ----------
    display : str
        Name of the display.
    samples : iterable of float
        Samples −1 … 1, also without end; they are read as they are sent.
    sample_rate : float
        Sample rate [Hz].
    amplitude : float
        Shear of a sample of 1 [m].
    contactors : iterable of int
        Contactors that play it; all if none is named.
    append : bool
        Whether it plays after what waits, or in place of that.

    Raises
    ------
    InputError
        If an argument is not of that kind.
    """

    def __init__(
        self,
        display: str,
        samples: Iterable[float],
        *,
        sample_rate: float,
        amplitude: float,
        contactors: Iterable[int] = (),
        append: bool = False,
    ) -> None:
        self._samples: Iterator[float] = to_items(samples, "samples")
        self._message = Append(
            display=display,
            sample_rate_hz=to_number(sample_rate, "sample_rate [Hz]"),
            amplitude_um=to_number(amplitude, "amplitude [m]") * 1e6,
            samples=b"",
            append=append,
            contactors=tuple(
                to_index(contactor, f"contactors[{place}]")
                for place, contactor in enumerate(to_items(contactors, "contactors", 4096))
            ),
        )
        self._rest = b""

    @property
    def contactors(self) -> tuple[int, ...]:
        """Contactors that play it; all if there is none."""
        return self._message.contactors

    def message(self) -> Append | None:
        """Return the next message.

        Returns
        -------
        Append or None
            Message with as many samples as one may hold; None if all of them were taken.

        Raises
        ------
        InputError
            If a value is not one that may be sent.
        """
        missing = MOST_SAMPLES - len(self._rest) // 4
        self._rest += packed(islice(self._samples, missing))
        if not self._rest:
            return None
        return checked(msgspec.structs.replace(self._message, samples=self._rest))

    def consume(self, samples_consumed: int) -> None:
        """Leave out what the server took; the rest plays after it.

        Parameters
        ----------
        samples_consumed : int
            Number of samples that it took of the last message.
        """
        self._rest = self._rest[4 * samples_consumed :]
        if samples_consumed:
            self._message = msgspec.structs.replace(self._message, append=True)


def pause_after(message: Append, appended: Appended) -> float:
    """Return how long to wait before more of a waveform is sent.

    Parameters
    ----------
    message : Append
        What was sent.
    appended : Appended
        What the server took of it.

    Returns
    -------
    float
        Half of what waits to be played, within limits; 0 if all of the message was taken [s].
    """
    if appended.samples_consumed * 4 >= len(message.samples):
        return 0.0
    return min(max(appended.buffered / 2, SHORTEST_PAUSE), LONGEST_PAUSE)
