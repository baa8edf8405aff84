"""Settings of a sound card, as the user chose them."""

from dataclasses import dataclass

from tactile.errors import InputError

FULL_SCALE, LARGEST_FULL_SCALE = 10e-6, 500e-6
"""Default and largest shear of a sample of 1 [m]. Assumed: a default that is felt clearly at 100 to
300 Hz and is within the voltage of the reference displays there; the largest is that of the API."""
LARGEST_HEADROOM = 0.5
"""Largest time by which frames come earlier than the display needs them [s]. It keeps frames within
the second that the server lets them wait."""


@dataclass(frozen=True)
class SoundCardSettings:
    """Settings of a sound card: what it plays, and how much later.

    Attributes
    ----------
    full_scale : float
        Shear of a sample of 1, above 0 and up to 500 µm [m].
    headroom : float or None
        Time that is added to the latency of the display, 0 … 0.5 s; None for one that is raised
        when frames come too late [s].

    Raises
    ------
    InputError
        If a value is not one of these.
    """

    full_scale: float = FULL_SCALE
    headroom: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.full_scale <= LARGEST_FULL_SCALE:
            raise InputError(
                f"full scale {1e6 * self.full_scale:g} µm: must be above 0 and at most "
                f"{1e6 * LARGEST_FULL_SCALE:g} µm"
            )
        if self.headroom is not None and not 0 <= self.headroom <= LARGEST_HEADROOM:
            raise InputError(
                f"headroom {1e3 * self.headroom:g} ms: must be between 0 and "
                f"{1e3 * LARGEST_HEADROOM:g} ms"
            )
