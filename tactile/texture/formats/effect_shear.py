"""Effect as the shear that all contactors of a display give to the skin.

An amplitude of 1 is the ``maximum_displacement`` of the device that the effect was made for. The
channels of an effect are mixed to one signal: their mean, weighted by ``mixing_coefficient``.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.formats.document import Effect, EffectChannel, Perception, channels_of
from tactile.texture.formats.synthesis import duration, synthesize, unplayed

ASSUMED_REACH_UM = 10.0
"""Displacement of an amplitude of 1 if no device states its maximum_displacement (assumed) [µm]."""


def reach_of(perception: Perception, channel: EffectChannel) -> tuple[float, list[str]]:
    """Return the displacement that an amplitude of 1 stands for.

    Parameters
    ----------
    perception : Perception
        Perception with the reference devices.
    channel : EffectChannel
        Channel of the perception.

    Returns
    -------
    reach : float
        Displacement [µm].
    notes : list of str
        One line if it is assumed, otherwise none.
    """
    for device in perception.reference_devices:
        reach = device.maximum_displacement_mm
        if device.id == channel.reference_device_id and reach is not None:
            return reach * 1e3, []
    return ASSUMED_REACH_UM, [
        f"an amplitude of 1 is taken as {ASSUMED_REACH_UM:g} µm (assumed: no maximum_displacement)"
    ]


@dataclass(frozen=True)
class NamedEffect:
    """Effect that can be played.

    Attributes
    ----------
    name : str
        Name of the effect.
    effect : Effect
        The effect.
    gain : float
        Factor of the displacement.
    """

    name: str
    effect: Effect
    gain: float = 1.0

    @property
    def description(self) -> str:
        """Description for people, or the name if the effect has none."""
        return self.effect.description or self.name

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return duration(self.effect)

    @property
    def notes(self) -> list[str]:
        """One line for each thing that is assumed, or left out of the effect."""
        channels = channels_of(self.effect)
        assumed = [note for pair in channels for note in reach_of(*pair)[1]]
        mixed = [f"{len(channels)} channels are mixed to one"] if len(channels) > 1 else []
        return [*dict.fromkeys(assumed), *mixed, *unplayed(self.effect)]

    def shear(self, sample_rate: float) -> Floats:
        """Compute the shear over time.

        Parameters
        ----------
        sample_rate : float
            Sample rate, 100 to 192000 [Hz].

        Returns
        -------
        (S,) array of float
            Shear from the beginning of the effect to its end [m].

        Raises
        ------
        InputError
            If there is nothing to play, the rate is out of range, or the effect is too long.
        """
        signals = synthesize(self.effect, sample_rate)
        if not signals.size:
            raise InputError(f"{self.name}: has nothing to play")
        channels = channels_of(self.effect)
        reach = np.array([reach_of(*pair)[0] for pair in channels]) * 1e-6
        weight = np.array([channel.mixing_coefficient for _, channel in channels])
        total = float(np.abs(weight).sum()) or 1.0
        return np.asarray(signals @ (reach * weight) * (self.gain / total))
