"""What a bridge offers and what it starts, as the user chose it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from tactile.errors import InputError

STREAMS = ("contacts", "shear", "drive", "markers")
"""Quantities that a bridge can offer as streams."""
LARGEST_DECIMATION = 64
"""Largest factor by which the rate of the drive is divided."""
DELAY, LONGEST_DELAY = 0.1, 30.0
"""Default and largest time from a marker to the stimulus that it starts [s]."""


@dataclass(frozen=True)
class BridgeSettings:
    """What a bridge offers, and which markers start effects.

    Attributes
    ----------
    streams : tuple of str
        Quantities that are offered, of `STREAMS`.
    decimate : int
        Factor by which the rate of the drive is divided, 1 … 64.
    start_from : str or None
        Name of the LSL stream whose markers start effects; None for none.
    starts : mapping of str to str
        Effect that each marker starts; a marker that is not in it starts the effect of its name.
    delay : float
        Time from a marker to the begin of the effect that it starts, 0 … 30 s [s].

    Raises
    ------
    InputError
        If a value is not one of these.
    """

    streams: tuple[str, ...] = STREAMS
    decimate: int = 1
    start_from: str | None = None
    starts: Mapping[str, str] = field(default_factory=dict)
    delay: float = DELAY

    def __post_init__(self) -> None:
        for name in self.streams:
            if name not in STREAMS:
                raise InputError(f"stream {name!r}: there are {', '.join(STREAMS)}")
        if not self.streams:
            raise InputError(f"no stream: name some of {', '.join(STREAMS)}")
        if not 1 <= self.decimate <= LARGEST_DECIMATION:
            raise InputError(
                f"decimation by {self.decimate}: must be between 1 and {LARGEST_DECIMATION}"
            )
        if self.decimate > 1 and "drive" not in self.streams:
            raise InputError(
                f"decimation by {self.decimate}: is of the drive, which is not offered"
            )
        if not 0 <= self.delay <= LONGEST_DELAY:
            raise InputError(f"delay {self.delay:g} s: must be between 0 and {LONGEST_DELAY:g} s")
        if self.start_from is None and self.starts:
            text = next(iter(self.starts))
            raise InputError(f"marker {text!r}: there is no stream that markers come from")
        if self.start_from is not None and {"'", '"'} <= set(self.start_from):
            raise InputError(
                f"stream {self.start_from!r}: LSL finds no name with quotes of both kinds"
            )


def parse_streams(text: str) -> tuple[str, ...]:
    """Return the quantities of a list that is separated by commas.

    Parameters
    ----------
    text : str
        List such as "contacts,markers".

    Returns
    -------
    tuple of str
        Each quantity once.
    """
    return tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def parse_starts(texts: Iterable[str]) -> dict[str, str]:
    """Return the effect of each marker.

    Parameters
    ----------
    texts : iterable of str
        Pairs such as "go=tap"; what comes before the last equals sign is the marker.

    Returns
    -------
    dict of str to str
        Name of the effect by the text of the marker.

    Raises
    ------
    InputError
        If a text is no such pair, or a marker has two effects.
    """
    starts: dict[str, str] = {}
    for text in texts:
        marker, equals, effect = text.rpartition("=")
        if not (marker and equals and effect):
            raise InputError(f"{text!r}: must be a marker and an effect, such as go=tap")
        if starts.setdefault(marker, effect) != effect:
            raise InputError(f"marker {marker!r}: starts {starts[marker]!r} already")
    return starts
