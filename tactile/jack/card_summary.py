"""Summary of what a sound card has done."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class SoundCardSummary:
    """Summary of what a sound card has done so far.

    Attributes
    ----------
    display : str
        Name of the display.
    client : str
        Name of the client of JACK; empty while there was none.
    rate : float or None
        Sample rate of JACK; None while nothing came [Hz].
    buffer : int or None
        Number of frames of a cycle of JACK; None while nothing came.
    full_scale : float
        Shear of a sample of 1 [m].
    delay : float
        Time from the begin of a cycle of JACK until the amplifier puts out its first frame [s].
    frames : int
        Number of frames that were sent to the display.
    missing : int
        Number of frames of JACK that did not reach the sound card.
    dropped : int
        Number of frames that were not played: those that the display dropped while the sound card
        played, of all programs, and those of the sound card that were not sent in time.
    gaps : int
        Number of times that the display held a frame while the sound card played, because the next
        one of some program was missing.
    xruns : int
        Number of times that JACK was late.
    invalid : int
        Number of samples that were no finite number, for which 0 was played.
    clipped : (N,) tuple of int
        Number of samples of each channel that were beyond full scale.
    peaks : (N,) tuple of float
        Largest shear of each channel that came from JACK, before it was clipped [m].
    """

    display: str
    client: str
    rate: float | None
    buffer: int | None
    full_scale: float
    delay: float
    frames: int
    missing: int
    dropped: int
    gaps: int
    xruns: int
    invalid: int
    clipped: tuple[int, ...]
    peaks: tuple[float, ...]

    @property
    def lost(self) -> int:
        """Number of missing and dropped frames."""
        return self.missing + self.dropped

    def as_dict(self) -> dict[str, Any]:
        """Return the summary in types that JSON has, with units in the names.

        Returns
        -------
        dict
            Values by name.
        """
        facts = asdict(self)
        return {
            "display": facts.pop("display"),
            "client": facts.pop("client"),
            "rate_hz": facts.pop("rate"),
            "buffer_frames": facts.pop("buffer"),
            "full_scale_um": 1e6 * facts.pop("full_scale"),
            "delay_ms": 1e3 * facts.pop("delay"),
            "peaks_um": [1e6 * peak for peak in facts.pop("peaks")],
            **facts,
        }
