"""Spending a limited drive where it is felt: which parts of a texture to lower first.

Where full strength asks for more drive than there is, lowering all of it alike is not the best:
slow, large displacement takes most volts and may lie below the threshold of touch. The parts are
rings of the stochastic waves, a third octave of wave number each, and the harmonics of gratings;
their weights w (on power) solve

    maximize Σ w f   subject to   Σ w c ≤ budget,   s l ≤ w ≤ s,   0 ≤ s ≤ 1

with f the power relative to the threshold of the channel that feels most, c the power of drive,
s a gain common to all, and l the least that a part may keep: nothing, where it lies in bands that
are below threshold even at full strength, so that no gain makes it felt; else −`DISTANCE_DB`, so
that the spectrum's shape stays as close as that to the texture's own. It is a linear program with
the solution of a knapsack: parts are lowered in ascending order of f/c, each to its least, until
the budget is met or until what comes next gives more per volt² than the whole; what is still
missing is taken from all alike. That last step is the gain's (`strength.automatic_gain`).

Weights depend on wave number, not on direction: an isotropic surface stays one, and is judged by
its mean over all directions of stroke.
"""

from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.rendering.equalizer import roll_off
from tactile.strength.commanded import LineSpectrum, law_factor
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

DISTANCE_DB = 2.5
"""By which a part that is felt may be lowered against the others: at most the just noticeable
difference of amplitude (`perception.AMPLITUDE_JND_DB`)."""
NEGLIGIBLE = 0.01
"""Of a felt band's power, what a part may hold there and still be dropped: 0.04 dB."""


@dataclass(frozen=True)
class Parts:
    """What each part of a texture sounds like, over directions of stroke.

    Attributes
    ----------
    power : (D, P, B + 1) mean square shear [m²] per direction, part and third octave; the last is
        what is in none
    felt : (P,) power relative to the threshold of one channel, in its bands above threshold
    cost : (P,) mean square drive [V²]
    """

    power: Floats
    felt: Floats
    cost: Floats

    @property
    def silent(self) -> NDArray[np.bool_]:
        """(P,) whether a part is only where nothing is felt, in every direction."""
        whole = self.power.sum(axis=1, keepdims=True)
        heard = _felt_bands(whole[..., :-1])
        matters = self.power[..., :-1] > NEGLIGIBLE * whole[..., :-1]
        return np.asarray(~np.any(matters & heard, axis=(0, 2)))


def _felt_bands(power: Floats, channel: TouchChannel | None = None) -> NDArray[np.bool_]:
    """Return which third octaves of power (..., B) [m²] are above threshold.

    The lowest threshold within the band is taken, so that none is missed.
    """
    limit = perception.detection_threshold if channel is None else channel.threshold
    inside = CENTERS * 10 ** np.linspace(-0.05, 0.05, 9)[:, None]
    return np.asarray(2 * power > limit(inside).min(axis=0) ** 2)


def weights(felt: Floats, cost: Floats, least: Floats, budget: float) -> Floats:
    """Return the weights (P,) on power that a budget is best spent with, before a common gain.

    Parameters
    ----------
    felt, cost : (P,) what each part gives and takes at weight 1
    least : (P,) what it must keep, 0 … 1
    budget : what all may take together

    Returns
    -------
    (P,) ndarray
        Ones where the budget suffices. They take no more than the budget, or are the shape that
        gives most per cost, to be scaled down to it.
    """
    found = np.ones(len(felt))
    worth = felt / np.maximum(cost, 1e-300)
    for part in np.argsort(worth, kind="stable"):
        excess = float(found @ cost) - budget
        if excess <= 0 or worth[part] * (found @ cost) >= found @ felt:
            break
        found[part] = max(least[part], 1 - excess / max(cost[part], 1e-300))
    return found


def spend(
    display: Display, texture: Texture, stroke: SteadyStroke | None = None, *, gain: float = 1.0
) -> Texture:
    """Return a texture that spends what drive there is where it is felt.

    Parameters
    ----------
    display, texture, stroke : as of `strength.texture_strength`
    gain : that the texture is wanted at

    Returns
    -------
    Texture
        The same, where the display plays it at that gain within its limits. Otherwise one whose
        parts are lowered, none by more than `DISTANCE_DB` unless it lies below threshold, for the
        drive that the texture as it was may take; see `weights`. Events stay as they are. It is
        only returned where at the same rms drive its level in this stroke is higher.

    Raises
    ------
    InputError
        As `automatic_gain`.
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
    spent = weighted(texture, np.sqrt(weights(parts.felt, parts.cost, least, budget)))
    drive = able.drive_rms(stroke.lines(texture).times(allowed.value))
    before, after = (level_at_drive(one, stroke, able, drive) for one in (texture, spent))
    return spent if after > before else texture


def level_at_drive(texture: Texture, stroke: SteadyStroke, able: Reach, drive: float) -> float:
    """Return the level [dB SL] of a texture whose gain brings the drive to an rms [V]."""
    lines = stroke.lines(texture)
    felt = able.delivered(lines.times(drive / able.drive_rms(lines)))
    return max(perception.channel_sensation(felt.frequency, felt.power).values())


def parts_of(texture: Texture, stroke: SteadyStroke, able: Reach, channel: TouchChannel) -> Parts:
    """Return what the parts of a texture give and take: rings first, then harmonics.

    Bands that the texture as it is leaves below the channel's threshold count nothing in ``felt``.
    """
    wave_vector, amplitude, part = _waves(texture)
    amplitude = amplitude * law_factor(texture, stroke.speed, stroke.normal_force)
    count = int(part.max(initial=-1)) + 1
    power = np.zeros((0, count, len(CENTERS) + 1))
    felt, cost = np.zeros(count), np.zeros(count)
    directions = _directions(texture, stroke)
    for angle in directions:
        along = stroke.speed / (2 * np.pi) * np.array([np.cos(angle), np.sin(angle)])
        frequency = np.abs(wave_vector @ along)
        lines = LineSpectrum(frequency, (amplitude * roll_off(frequency)) ** 2 / 2)
        band = perception.band_of(frequency)
        here = np.zeros((count, len(CENTERS) + 1))
        np.add.at(here, (part, band), lines.power)
        heard = np.append(_felt_bands(here.sum(axis=0)[:-1], channel), False)[band]
        delivered = able.delivered(lines).power * heard
        share = delivered * 2 / channel.threshold(frequency) ** 2
        felt += np.bincount(part, share, count) / len(directions)
        cost += np.bincount(part, able.cost(frequency) * lines.power, count) / len(directions)
        power = np.concatenate([power, here[None]])
    return Parts(power, felt, cost)


def _directions(texture: Texture, stroke: SteadyStroke) -> Floats:
    """Return the directions that count [rad]: all for an isotropic surface, else the stroke's."""
    stochastic = texture.descriptor.stochastic
    if stochastic is None or stochastic.direction_spread_deg is not None:
        return np.array([stroke.angle])
    return stroke_directions(stochastic)


def _rings(texture: Texture) -> NDArray[np.intp]:
    """Return the ring of each stochastic wave, 0 … 15."""
    stochastic = texture.descriptor.stochastic
    if stochastic is None:
        return np.zeros(0, np.intp)
    edges = band_edges(stochastic)
    ring = np.digitize(np.linalg.norm(texture.wave_vector, axis=1), edges) - 1
    return np.asarray(np.clip(ring, 0, len(edges) - 2))


def _waves(texture: Texture) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Return wave vectors, amplitudes and parts of all waves, as `Texture.realize` has them."""
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
    """Return a texture whose parts' amplitudes are multiplied, (P,) as of `parts_of`."""
    rings = _rings(texture)
    place, periodic = int(rings.max(initial=-1)) + 1, []
    for one in texture.descriptor.periodic:
        mine = weight[place : place + len(one.harmonics_um)].tolist()
        place += len(mine)
        scaled = tuple(w * h for w, h in zip(mine, one.harmonics_um, strict=True))
        periodic.append(structs.replace(one, harmonics_um=scaled))
    descriptor = structs.replace(texture.descriptor, periodic=tuple(periodic))
    return replace(texture, amplitude=texture.amplitude * weight[rings], descriptor=descriptor)
