"""Outcome of a stroke: the share of it that the amplifier put out, and how it ended.

A sample counts as put out unless it is known that it was not (`Bus.unplayed`). What a bus can know
differs: an amplifier of the protocol reports which positions passed while it played, and how many
of them it bridged or left silent; what it does not confirm before its link is lost was not put out.
Other buses count what they drop themselves. Samples with which the output fades in again after a
gap count as put out.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from tactile.bus.base import Bus, BusStatus

Ending = Literal["complete", "failed", "interrupted"]
"""How a stroke ended: by its own end, by a failure of the bus, or by Ctrl-C."""


def share_put_out(due_samples: int, lost_samples: int) -> float:
    """Return the share of samples that was put out.

    Parameters
    ----------
    due_samples : int
        Number of samples that were due.
    lost_samples : int
        Number of those that were not put out.

    Returns
    -------
    float
        Share from 0 to 1; NaN if nothing was due.
    """
    return max(due_samples - lost_samples, 0) / due_samples if due_samples else math.nan


@dataclass(frozen=True)
class Outcome:
    """What became of a stroke.

    Attributes
    ----------
    planned_samples : int
        Length of the stroke [samples].
    put_out_samples : int
        Number of samples that were put out as they were written, as far as it is known.
    link : {"up", "down"}
        Whether the amplifier could be reached at the end of the stroke.
    playing : bool
        Whether the amplifier was known to play at the end of the stroke.
    ending : Ending
        How the stroke ended.
    cause : str
        One line on what kept samples from being put out; empty if all were.
    """

    planned_samples: int = 0
    put_out_samples: int = 0
    link: Literal["up", "down"] = "up"
    playing: bool = True
    ending: Ending = "complete"
    cause: str = ""

    @property
    def lost_samples(self) -> int:
        """Number of samples of the stroke that were not put out."""
        return self.planned_samples - self.put_out_samples

    @property
    def percent(self) -> str:
        """Share that was put out, as text in percent; "100 %" only if nothing was lost."""
        if not self.lost_samples:
            return "100 %"
        return f"{self.put_out_samples * 10_000 // self.planned_samples / 100:.2f} %"

    def is_within(self, allowed_percent: Fraction | float) -> bool:
        """Return whether the stroke was played, with no more than some loss.

        Parameters
        ----------
        allowed_percent : Fraction or float
            Largest share that may be lost [%].

        Returns
        -------
        bool
            Whether the stroke came to its own end with the link up, and no more was lost.
        """
        few = 100 * self.lost_samples <= allowed_percent * self.planned_samples
        return few and self.link == "up" and self.ending == "complete"


def outcome_of(
    planned: int,
    bus: Bus,
    at_end: BusStatus,
    *,
    delay: int = 0,
    spacing: int = 1,
    ending: Ending = "complete",
    error: str = "",
) -> Outcome:
    """Compute the outcome of a stroke on a bus that was opened for it.

    Parameters
    ----------
    planned : int
        Length of the stroke [samples].
    bus : Bus
        Bus, stopped.
    at_end : BusStatus
        Status of the bus at the end of the stroke, before it was stopped.
    delay : int
        Number of positions that are written in addition to those of the stroke.
    spacing : int
        Length of what the bus counts as one sample, more than 1 for spectrum frames [samples].
    ending : Ending
        How the stroke ended.
    error : str
        Error that ended it; empty if there was none.

    Returns
    -------
    Outcome
        The outcome; its cause is the error, or the latest fault that the bus names, or what was
        counted.
    """
    put_out = min(bus.next_position - delay, planned) - bus.unplayed * spacing
    put_out = max(put_out, 0)
    cause = ""
    if put_out < planned or at_end.link == "down" or ending != "complete":
        counted = ", ".join(f"{count} {name}" for name, count in bus.counters.faults().items())
        interruption = "interrupted" if ending == "interrupted" else ""
        lines = [error, interruption, at_end.last_fault, at_end.detail, bus.status.detail, counted]
        unit = "samples" if spacing == 1 else "frames"
        gaps = f"{bus.unplayed} {unit} did not reach the amplifier in time"
        cause = next(filter(None, lines), gaps)
    return Outcome(planned, put_out, at_end.link, at_end.playing, ending, cause)
