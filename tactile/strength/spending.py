"""Allocation of a limited drive to what is perceived: which parts of a texture to lower first.

If full strength needs more drive than there is, lowering all of a texture alike is not the best
choice: slow, large displacement takes most of the voltage and may lie below the threshold of touch.
The parts of a texture are rings of its stochastic waves, a third octave of wave number each, and
the harmonics of its gratings. Their weights w (on power) solve

    maximize Σ w f   subject to   Σ w c ≤ budget,   s l ≤ w ≤ s,   0 ≤ s ≤ 1

with the power f relative to the threshold of the channel that feels most, the power c of the drive,
a gain s common to all, and the least weight l that a part may keep. l is 0 for a part in bands that
are below threshold even at full strength, which no gain makes perceptible; otherwise it is
−`DISTANCE_DB`, so that the shape of the spectrum stays that close to the texture's own. This is a
linear program with the solution of a knapsack problem: parts are lowered in ascending order of f/c,
each to its least, until the budget is met or until the next part gives more per volt² than the
whole; what is still missing is taken from all parts alike. That last step is left to the gain
(`strength.automatic_gain`).

Weights depend on wave number, not on direction: an isotropic surface stays isotropic and is judged
by its mean over all directions of stroke.
"""

from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.rendering.equalizer import roll_off
from tactile.strength.commanded import LineSpectrum, law_factor
from tactile.strength.differences import LEVEL_JND
from tactile.strength.strength import (
    Reach,
    SteadyStroke,
    amplified,
    automatic_gain,
    reach,
)
from tactile.texture import perception
from tactile.texture.perception import CENTERS, TOUCH_CHANNELS, TouchChannel
from tactile.texture.surface import Texture, band_edges, grating, stroke_directions

DISTANCE_DB = LEVEL_JND
"""Amount by which a part that is felt may be lowered relative to the others [dB]: at most the just
noticeable difference of a level (`tactile.strength.differences`)."""
NEGLIGIBLE = 0.01
"""Fraction of a felt band's power up to which a part in it may be dropped: 0.04 dB."""


@dataclass(frozen=True)
class Parts:
    """Power, perceptual value and cost of each part of a texture, over directions of stroke.

    Attributes
    ----------
    power : (D, P, B + 1) array of float
        Mean square shear per direction, part and third octave; the last column is for what is
        outside all third octaves [m²].
    perceived : (P,) array of float
        Power relative to the threshold of one channel, in its bands above threshold.
    cost : (P,) array of float
        Mean square drive [V²].
    """

    power: Floats
    perceived: Floats
    cost: Floats

    @property
    def silent(self) -> NDArray[np.bool_]:
        """Whether each part (P,) is only in bands where nothing is felt, in every direction."""
        total = self.power.sum(axis=1, keepdims=True)
        audible = _felt_bands(total[..., :-1])
        matters = self.power[..., :-1] > NEGLIGIBLE * total[..., :-1]
        return np.asarray(~np.any(matters & audible, axis=(0, 2)))


def _felt_bands(power: Floats, channel: TouchChannel | None = None) -> NDArray[np.bool_]:
    """Return which third octaves of power (..., B) [m²] are above threshold.

    The lowest threshold within a band is taken, so that no felt band is missed.
    """
    threshold = perception.detection_threshold if channel is None else channel.threshold
    inside = CENTERS * 10 ** np.linspace(-0.05, 0.05, 9)[:, None]
    return np.asarray(2 * power > threshold(inside).min(axis=0) ** 2)


def weights(perceived: Floats, cost: Floats, least: Floats, budget: float) -> Floats:
    """Compute the weights on power that make best use of a budget, before a common gain.

    Parameters
    ----------
    perceived : (P,) array of float
        Perceptual value of each part at weight 1.
    cost : (P,) array of float
        Cost of each part at weight 1.
    least : (P,) array of float
        Least weight of each part, 0 … 1.
    budget : float
        Cost that all parts together may have.

    Returns
    -------
    (P,) array of float
        Weights, all 1 if the budget suffices. They either keep within the budget or have the shape
        that gives most per cost, to be scaled down to the budget.
    """
    result = np.ones(len(perceived))
    worth = perceived / np.maximum(cost, 1e-300)
    for part in np.argsort(worth, kind="stable"):
        excess = float(result @ cost) - budget
        if excess <= 0 or worth[part] * (result @ cost) >= result @ perceived:
            break
        result[part] = max(least[part], 1 - excess / max(cost[part], 1e-300))
    return result


def spend(
    display: Display, texture: Texture, stroke: SteadyStroke | None = None, *, gain: float = 1.0
) -> Texture:
    """Return a variant of a texture that spends a limited drive where it is felt.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke, optional
        Stroke of the finger, by default 80 mm/s at 0.5 N along x.
    gain : float
        Desired gain of the texture.

    Returns
    -------
    Texture
        The same texture if the display plays it at that gain within its limits. Otherwise one whose
        parts are lowered, none by more than `DISTANCE_DB` unless it lies below threshold, for the
        drive that the original texture may take; see `weights`. Events are unchanged. It is
        returned only if its level in this stroke is higher at the same rms drive.

    Raises
    ------
    InputError
        If nothing can be felt in this stroke at any gain, as in `automatic_gain`.
    """
    stroke = stroke or SteadyStroke()
    allowed = automatic_gain(display, texture, stroke)
    if allowed.value >= gain:
        return texture
    able = reach(display, stroke)
    parts = parts_of(amplified(texture, gain), stroke, able, TOUCH_CHANNELS[allowed.channel])
    if not len(parts.cost):
        return texture
    least = np.where(parts.silent, 0.0, 10 ** (-DISTANCE_DB / 10))
    budget = float(parts.cost.sum()) * (allowed.value / gain) ** 2
    candidate = weighted(texture, np.sqrt(weights(parts.perceived, parts.cost, least, budget)))
    drive = able.drive_rms(stroke.lines(texture).times(allowed.value))
    before, after = (level_at_drive(one, stroke, able, drive) for one in (texture, candidate))
    return candidate if after > before else texture


def level_at_drive(texture: Texture, stroke: SteadyStroke, able: Reach, drive: float) -> float:
    """Compute the level of a texture whose gain brings the drive to a given rms.

    Parameters
    ----------
    texture : Texture
        Texture to play.
    stroke : SteadyStroke
        Stroke of the finger.
    able : Reach
        Reach of the display in this stroke.
    drive : float
        Drive [V rms].

    Returns
    -------
    float
        Level of the channel that feels most [dB SL].
    """
    lines = stroke.lines(texture)
    delivered = able.delivered(lines.times(drive / able.drive_rms(lines)))
    return max(perception.channel_sensation(delivered.frequency, delivered.power).values())


def parts_of(texture: Texture, stroke: SteadyStroke, able: Reach, channel: TouchChannel) -> Parts:
    """Compute what the parts of a texture give and take: rings first, then harmonics.

    Bands that the unmodified texture leaves below the channel's threshold do not count in ``felt``.

    Parameters
    ----------
    texture : Texture
        Texture to divide into parts.
    stroke : SteadyStroke
        Stroke of the finger.
    able : Reach
        Reach of the display in this stroke.
    channel : TouchChannel
        Channel whose threshold counts.

    Returns
    -------
    Parts
        Power, perceptual value and cost of each part.
    """
    wave_vector, amplitude, part = _waves(texture)
    amplitude = amplitude * law_factor(texture, stroke.speed, stroke.normal_force)
    count = int(part.max(initial=-1)) + 1
    power = np.zeros((0, count, len(CENTERS) + 1))
    perceived, cost = np.zeros(count), np.zeros(count)
    directions = _directions(texture, stroke)
    for angle in directions:
        along = stroke.speed / (2 * np.pi) * np.array([np.cos(angle), np.sin(angle)])
        frequency = np.abs(wave_vector @ along)
        lines = LineSpectrum(frequency, (amplitude * roll_off(frequency)) ** 2 / 2)
        band = perception.band_of(frequency)
        by_band = np.zeros((count, len(CENTERS) + 1))
        np.add.at(by_band, (part, band), lines.power)
        audible = np.append(_felt_bands(by_band.sum(axis=0)[:-1], channel), False)[band]
        delivered = able.delivered(lines).power * audible
        share = delivered * 2 / channel.threshold(frequency) ** 2
        perceived += np.bincount(part, share, count) / len(directions)
        cost += np.bincount(part, able.cost(frequency) * lines.power, count) / len(directions)
        power = np.concatenate([power, by_band[None]])
    return Parts(power, perceived, cost)


def _directions(texture: Texture, stroke: SteadyStroke) -> Floats:
    """Return the directions to consider [rad]: all for an isotropic surface, else the stroke's."""
    stochastic = texture.descriptor.stochastic
    if stochastic is None or stochastic.direction_spread_deg is not None:
        return np.array([stroke.angle])
    return stroke_directions(stochastic)


def _rings(texture: Texture) -> NDArray[np.intp]:
    """Return the ring of each stochastic wave, counted from 0."""
    stochastic = texture.descriptor.stochastic
    if stochastic is None:
        return np.zeros(0, np.intp)
    edges = band_edges(stochastic)
    ring = np.digitize(np.linalg.norm(texture.wave_vector, axis=1), edges) - 1
    return np.asarray(np.clip(ring, 0, len(edges) - 2))


def _waves(texture: Texture) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Return wave vectors, amplitudes and parts of all waves, in the order of `Texture.realize`."""
    partials, rings = texture.realize().partials, _rings(texture)
    part, rng = [rings], np.random.default_rng(0)
    following = int(rings.max(initial=-1)) + 1
    for periodic in texture.descriptor.periodic:
        harmonics = len(periodic.harmonics_um)
        each = len(grating(periodic, rng).amplitude) // harmonics
        part.append(following + np.repeat(np.arange(harmonics), each))
        following += harmonics
    return partials.wave_vector, partials.amplitude, np.concatenate(part)


def weighted(texture: Texture, weight: Floats) -> Texture:
    """Return a texture whose parts have their amplitudes multiplied.

    Parameters
    ----------
    texture : Texture
        Texture to change.
    weight : (P,) array of float
        Factor on the amplitude of each part, in the order of `parts_of`.

    Returns
    -------
    Texture
        Texture with scaled waves and harmonics, which are played instead of a map.
    """
    rings = _rings(texture)
    place, periodic = int(rings.max(initial=-1)) + 1, []
    for part in texture.descriptor.periodic:
        factors = weight[place : place + len(part.harmonics_um)].tolist()
        place += len(factors)
        scaled = tuple(w * h for w, h in zip(factors, part.harmonics_um, strict=True))
        periodic.append(structs.replace(part, harmonics_um=scaled))
    descriptor = structs.replace(texture.descriptor, periodic=tuple(periodic), map=None)
    density = texture.density
    return replace(
        texture,
        amplitude=texture.amplitude * weight[rings],
        density=None if density is None else density.weighted(weight[: len(density.center)]),
        descriptor=descriptor,
    )
