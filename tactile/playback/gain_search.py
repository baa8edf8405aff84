"""Largest gain at which a stroke stays within the limits of a display.

Everything before the limiter is linear in the gain: the drive is g v + f, with the drive v of the
texture at gain 1 and the drive f of its friction, which has no gain. Both are rendered, and the
gain is the largest at which no sample exceeds the voltage limit, no step the slew limit, and no
free tip would travel further than it survives.
"""

from dataclasses import dataclass, replace

import numpy as np

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.playback.trajectory_playback import rendered
from tactile.rendering.contact import Trajectory
from tactile.rendering.free_tip import FreeTip, free_tip_of, largest_share
from tactile.rendering.renderer import Renderer
from tactile.strength.figures import ONSET
from tactile.strength.strength import FAINT, amplified
from tactile.texture.surface import Texture, without_friction

LIMIT_SHARE = 0.99
"""Share of the limits that is used; the rest covers rounding."""
LONGEST = 60.0
"""Longest part of a stroke that is rendered for its gain [s]. What comes later is held within the
limits by the limiter."""
SILENT = 1e-9
"""Drive below which a texture counts as silent [V]."""


@dataclass(frozen=True)
class LargestGain:
    """Gain that reaches a limit.

    Attributes
    ----------
    value : float
        Gain of the texture.
    limit : str
        Limit that is reached: "voltage", "slew", or "current" where it bounds the slew rate, or
        "travel" of a tip without a finger.
    """

    value: float
    limit: str


class _Bound:
    """Largest gain at which no value of a sum exceeds a limit, so far.

    Parameters
    ----------
    limit : float
        Largest magnitude of the sum.

    Attributes
    ----------
    gain : float
        Largest gain; infinite as long as there is nothing to multiply.
    highest : float
        Largest magnitude of what the gain multiplies.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self.gain, self.highest = np.inf, 0.0

    def add(self, scaled: Floats, fixed: Floats) -> None:
        """Add values of a sum: those that the gain multiplies, and the others, of one shape."""
        size = np.abs(scaled)
        room = self._limit - np.sign(scaled) * fixed
        self.gain = min(self.gain, float(np.min(room / np.maximum(size, 1e-30))))
        self.highest = max(self.highest, float(size.max()))


class _TravelBound:
    """Largest gain at which no free tip swings further than a limit, so far.

    Parameters
    ----------
    tip : FreeTip or None
        Model of the tip; None if nothing bounds its travel.
    contactors : int
        Number of contactors.

    Attributes
    ----------
    gain : float
        Largest gain; infinite as long as there is nothing to multiply.
    """

    def __init__(self, tip: FreeTip | None, contactors: int) -> None:
        self._tip, self.gain = tip, np.inf
        self._states = np.zeros((2, contactors), np.complex128)

    def add(self, scaled: Floats, fixed: Floats) -> None:
        """Add samples of a drive: what the gain multiplies, and the rest, both (S, N)."""
        if self._tip is not None:
            added = self._tip.swing(scaled, self._states[0])
            held = self._tip.swing(fixed, self._states[1])
            self._states = np.stack([added[-1], held[-1]])
            share = largest_share(held, added, LIMIT_SHARE * self._tip.largest)
            self.gain = min(self.gain, share)


def largest_gain(
    display: Display,
    texture: Texture,
    trajectory: Trajectory,
    *,
    sample_rate: float,
    seed: int = 0,
) -> LargestGain:
    """Compute the largest gain at which a stroke stays within the limits.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    trajectory : Trajectory
        Path of the finger, of which `LONGEST` is rendered.
    sample_rate : float
        Sample rate of the drive [Hz].
    seed : int
        Seed of the surface's realization.

    Returns
    -------
    LargestGain
        Gain and the limit that it reaches, less 1 %.

    Raises
    ------
    InputError
        If the finger is at rest or the texture is silent.
    """
    way = float(np.linalg.norm(np.diff(trajectory.position, axis=0), axis=1).sum())
    if way < ONSET:
        raise InputError(
            f"gain auto: the finger moves by {way * 1e3:g} mm; needs at least {ONSET * 1e3:g} mm"
        )
    faint = Renderer(
        display, amplified(without_friction(texture), FAINT), sample_rate=sample_rate, seed=seed
    )
    smooth = replace(
        amplified(texture, 0.0), wave_vector=np.zeros((0, 2)), amplitude=np.zeros(0), density=None
    )
    friction = Renderer(display, smooth, sample_rate=sample_rate, seed=seed)
    voltage = _Bound(LIMIT_SHARE * display.limits.voltage)
    slew = _Bound(LIMIT_SHARE * display.slew / sample_rate)
    travel = _TravelBound(free_tip_of(display, sample_rate), len(display.contactors))
    last = np.zeros((2, 1, len(display.contactors)))
    samples = 0
    for (vibrating, _), (rubbing, _) in zip(
        rendered(display, faint, trajectory, sample_rate=sample_rate),
        rendered(display, friction, trajectory, sample_rate=sample_rate),
        strict=True,
    ):
        drive = np.stack([vibrating / FAINT, rubbing])
        voltage.add(*drive)
        slew.add(*np.diff(drive, axis=1, prepend=last))
        travel.add(*drive)
        last = drive[:, -1:]
        samples += drive.shape[1]
        if samples >= LONGEST * sample_rate:
            break
    if voltage.highest < SILENT:
        raise InputError(f"{texture.name}: leaves {display.name} nothing to play in this stroke")
    name = "slew" if display.slew >= display.limits.slew else "current"
    return min(
        LargestGain(voltage.gain, "voltage"), LargestGain(slew.gain, name),
        LargestGain(travel.gain, "travel"),
        key=lambda gain: gain.value,
    )  # fmt: skip
