"""Waveforms as they go over the wire: little-endian float32, so many at a time, without numpy."""

import sys
from array import array
from collections.abc import Iterable, Iterator
from itertools import islice

from tactile.client.wire import Appended, checked, to_index, to_items, to_number
from tactile.errors import InputError
from tactile.messages import MOST_SAMPLES, Append

SHORTEST_PAUSE, LONGEST_PAUSE = 0.005, 0.1
"""Limits of the time to wait before what the daemon had no room for is sent again [s]."""


def packed(samples: Iterable[float]) -> bytes:
    """Return at most `MOST_SAMPLES` of the samples, which are −1 … 1, as little-endian float32.

    Raises
    ------
    InputError
        Where one of them is outside, or not a number.
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
    """A waveform on its way: what is still to be sent, whatever the daemon takes at a time.

    Parameters
    ----------
    display : its name
    samples : any iterable of −1 … 1, also one without end; read as far as it is sent
    sample_rate : of the samples [Hz]
    amplitude : shear at 1 [m]
    contactors : those that play it, all where none is named
    append : whether it plays after what waits, or in its place
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
        self._rest = b""
        self._append = append
        self._head = Append(
            display=display,
            sample_rate_hz=to_number(sample_rate, "sample_rate [Hz]"),
            amplitude_um=to_number(amplitude, "amplitude [m]") * 1e6,
            samples=b"",
            contactors=tuple(
                to_index(contactor, f"contactors[{place}]")
                for place, contactor in enumerate(to_items(contactors, "contactors", 4096))
            ),
        )

    def message(self) -> Append | None:
        """Return the next message, or None where all was taken."""
        missing = MOST_SAMPLES - len(self._rest) // 4
        self._rest += packed(islice(self._samples, missing))
        if not self._rest:
            return None
        head = self._head
        return checked(
            Append(
                display=head.display,
                sample_rate_hz=head.sample_rate_hz,
                amplitude_um=head.amplitude_um,
                samples=self._rest,
                append=self._append,
                contactors=head.contactors,
            )
        )

    def taken(self, samples_consumed: int) -> None:
        """Leave away what the daemon took; what follows plays after it."""
        self._rest = self._rest[4 * samples_consumed :]
        if samples_consumed:
            self._append = True


def pause_after(message: Append, appended: Appended) -> float:
    """Return how long to wait before more of a waveform is sent.

    Parameters
    ----------
    message : Append
        What was sent.
    appended : Appended
        What the daemon took of it.

    Returns
    -------
    float
        Half of what waits to be played, within limits; 0 if all of the message was taken [s].
    """
    if appended.samples_consumed * 4 >= len(message.samples):
        return 0.0
    return min(max(appended.buffered / 2, SHORTEST_PAUSE), LONGEST_PAUSE)
