"""Conversion between a texture, a function of space, and an effect, one of time, by a speed.

A stroke at a steady speed turns every wave of the surface into an oscillation, whose frequency is
the spatial frequency along the stroke times the speed. An effect made in this way is one second
that repeats. Its oscillations are those of the waves of the surface in whole Hz; waves that fall on
the same frequency are added in power. In the other direction each oscillation becomes a grating.
"""

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.descriptor import About, Descriptor, Periodic, Reference
from tactile.texture.formats import reading
from tactile.texture.formats.document import (
    Band,
    Effect,
    EffectChannel,
    Keyframe,
    KeyframeSegment,
    Perception,
    ReferenceDevice,
)
from tactile.texture.formats.effect_shear import reach_of
from tactile.texture.formats.synthesis import PLAIN, points, resolved, without_control
from tactile.texture.power_laws import speed_factor
from tactile.texture.surface import JITTER_LINES, Partials, Texture, stochastic_waves

MODALITY = "Vibrotactile Texture"
"""Modality of textures in MPEG-I Haptics."""
KEYWORDS = {
    "wood": "Wood", "metal": "Metal", "plastic": "Plastic", "stone": "Rock", "abrasive": "Sand",
}  # fmt: skip
"""Texture keyword of MPEG for a category. There is none for the others."""
CATEGORIES = {
    "Wood": "wood", "Metal": "metal", "Plastic": "plastic", "Rock": "stone", "Gravel": "stone",
    "Sand": "abrasive",
}  # fmt: skip
"""Category for a texture keyword of MPEG."""
SECONDS = 1.0
"""Duration of the effect of a texture [s]."""
TOP = 1000
"""Highest frequency of the effect of a texture [Hz]."""
PARTIALS = 384
"""Number of waves of a surface, as in `load_texture`."""
MOST_GRATINGS = 300
"""Largest number of gratings of a texture made of an effect."""


def effect_of(texture: Descriptor, speed: float) -> tuple[Effect, list[str]]:
    """Convert a texture to the effect of a stroke along x.

    Parameters
    ----------
    texture : Descriptor
        Texture to convert.
    speed : float
        Speed of the stroke, 0.001 to 1 [m/s].

    Returns
    -------
    effect : Effect
        One second of oscillations, which repeats.
    lost : list of str
        One line for each thing that is lost.

    Raises
    ------
    InputError
        If the speed is out of range, or no wave of the texture lies between 1 and 1000 Hz.
    """
    if not 1e-3 <= speed <= 1.0:
        raise InputError(f"--speed-mm-s {speed * 1e3:g}: must be 1 … 1000")
    hertz, amplitude, phase, share = _lines(_partials(texture), speed)
    if not len(hertz):
        raise InputError(f"{texture.texture.id}: nothing sounds at {speed * 1e3:g} mm/s")
    amplitude = amplitude * speed_factor(texture.laws, texture.reference, speed)
    time = np.arange(8000) / 8000
    reach = np.abs(np.sin(2 * np.pi * np.outer(time, hertz) + phase) @ amplitude).max()
    keyword = KEYWORDS.get(texture.texture.category)
    segments = tuple(
        KeyframeSegment(
            phase_rad=float(p), base_signal="Sine",
            keywords=None if keyword is None else f"Texture/{keyword}",
            keyframes=tuple(
                Keyframe(time_s=t, amplitude=float(a / reach), frequency_hz=float(f))
                for t in (0.0, SECONDS)
            ),
        )
        for f, a, p in zip(hertz, amplitude, phase, strict=True)
    )  # fmt: skip
    device = ReferenceDevice(
        id=0, name="piezoelectric bimorph", type="Piezo", minimum_frequency_hz=1.0,
        maximum_frequency_hz=float(TOP), maximum_displacement_mm=float(reach * 1e3),
    )  # fmt: skip
    perception = Perception(
        description=texture.texture.description, modality=MODALITY, reference_devices=(device,),
        channels=(EffectChannel(
            description=texture.texture.id, reference_device_id=0,
            bands=(Band(kind="wave", upper_frequency_hz=TOP, segments=segments),),
        ),),
    )  # fmt: skip
    effect = Effect(description=texture.texture.description, origin="texture",
                    perceptions=(perception,))  # fmt: skip
    return effect, _losses(texture, speed, float(reach), share)


def _partials(texture: Descriptor) -> Partials:
    """Return the waves of a texture with seed 0."""
    gratings = sum(
        len(p.harmonics_um) * (JITTER_LINES if p.jitter else 1) for p in texture.periodic
    )
    stochastic_part = np.zeros((0, 2)), np.zeros(0)
    if texture.stochastic:
        stochastic_part = stochastic_waves(
            texture.stochastic, max(PARTIALS - gratings, PARTIALS // 2)
        )
    return Texture(texture.texture.id, texture, *stochastic_part, np.zeros(0), np.zeros(0)).partials


def _lines(partials: Partials, speed: float) -> tuple[Floats, Floats, Floats, float]:
    """Return whole Hz, peaks [m], phases of a sine [rad], and the share of power left out."""
    signed = partials.wave_vector[:, 0] * speed / (2 * np.pi)
    rounded = np.rint(np.abs(signed)).astype(np.intp)
    phase = np.where(signed < 0, -partials.phase, partials.phase) + np.pi / 2
    in_range = (rounded >= 1) & (rounded <= TOP) & (partials.amplitude > 0)
    power = np.bincount(rounded[in_range], partials.amplitude[in_range] ** 2, TOP + 1)
    order = np.argsort(partials.amplitude)
    strongest = np.zeros(TOP + 1)
    ascending = order[in_range[order]]
    strongest[rounded[ascending]] = phase[ascending]
    hertz = np.flatnonzero(power)
    share = 1 - power.sum() / max(float(np.sum(partials.amplitude**2)), 1e-30)
    turned = (strongest[hertz] + np.pi) % (2 * np.pi) - np.pi
    return hertz.astype(np.float64), np.sqrt(power[hertz]), turned, float(share)


def _losses(texture: Descriptor, speed: float, reach: float, share: float) -> list[str]:
    """Return what an effect does not have of its texture."""
    lost = [
        f"a texture is rendered at {speed * 1e3:g} mm/s along x, 1 s that repeats, in whole Hz",
        f"an amplitude of 1 is {reach * 1e6:.3g} µm of displacement",
    ]
    if share > 0.001:
        lost.append(f"{share:.1%} of its power is below 1 or above {TOP} Hz and left out")
    if texture.texture.category not in KEYWORDS:
        lost.append(f"MPEG has no texture keyword for {texture.texture.category}: none is written")
    stochastic = texture.stochastic
    if stochastic and (stochastic.am_depth or stochastic.excess_kurtosis or texture.modulation):
        lost.append("amplitude modulation and kurtosis are left out: the waves are steady")
    if texture.events:
        lost.append("sparse events are left out")
    if texture.friction:
        lost.append("friction is left out")
    return lost


def texture_from(
    effect: Effect, speed: float, name: str, source: str
) -> tuple[Descriptor, list[str]]:
    """Convert an effect to a texture of gratings.

    Parameters
    ----------
    effect : Effect
        Effect with a perception of modality "Vibrotactile Texture".
    speed : float
        Speed at which the effect was made, 0.001 to 1 [m/s].
    name : str
        Id of the texture.
    source : str
        Name of the file of the effect, for the source line and messages.

    Returns
    -------
    texture : Descriptor
        The texture.
    notes : list of str
        One line for each thing that was assumed or lost.

    Raises
    ------
    InputError
        If the speed is out of range, the effect has no such perception, or no oscillation of it can
        be a grating.
    """
    if not 1e-3 <= speed <= 1.0:
        raise InputError(f"--speed-mm-s {speed * 1e3:g}: must be 1 … 1000")
    perceptions = [p for p in effect.perceptions if p.modality == MODALITY and p.channels]
    if not perceptions:
        raise InputError(f"{source}: has no perception {MODALITY!r}; leave out --speed-mm-s")
    perception, channel = perceptions[0], perceptions[0].channels[0]
    lost = [f"each oscillation is a grating, as at {speed * 1e3:g} mm/s"]
    others = sum(len(p.channels) for p in effect.perceptions) - 1
    if others:
        lost.append(f"a texture is one surface: {others} more channels left out")
    reach, assumed = reach_of(perception, channel)
    gratings, dropped = _gratings(perception, channel, speed * 1e3, reach * abs(channel.gain))
    if not gratings:
        raise InputError(f"{source}: has no oscillation that could be a grating")
    category, category_notes = _category(perception, channel)
    texture = Descriptor(
        texture=About(
            id=name, category=category, provenance="authored", source=reading.one_line(source),  # type: ignore[arg-type]
            description=reading.one_line(effect.description) or name, license="as of its source",
        ),
        reference=Reference(speed_mm_s=speed * 1e3, normal_force_n=1.0),
        periodic=tuple(gratings),
    )  # fmt: skip
    return texture, lost + assumed + dropped + category_notes


def _gratings(
    perception: Perception, channel: EffectChannel, speed_mm_s: float, reach_um: float
) -> tuple[list[Periodic], list[str]]:
    """Return a grating for each oscillation, at its mean amplitude and frequency."""
    gratings, wrong, varying = [], 0, 0
    for band in without_control(perception, channel).bands:
        for segment in (resolved(perception, s) for s in band.segments):
            if band.kind != "wave":
                wrong += 1
                continue
            size, low = _mean(segment, "amplitude", 1.0)
            pitch, high = _mean(segment, "frequency_hz", PLAIN)
            varying += low or high
            wavelength = speed_mm_s / pitch if pitch > 0 else 0.0
            if not 0.02 <= wavelength <= 100 or not 0 < abs(size) * reach_um <= 500:
                wrong += 1
                continue
            turn = np.degrees(segment.phase_rad or 0.0) - 90 + (180 if size < 0 else 0)
            gratings.append(Periodic(
                wavelength_mm=wavelength, harmonics_um=(abs(size) * reach_um,),
                phases_deg=(float((turn + 180) % 360 - 180),),
            ))  # fmt: skip
    gratings.sort(key=lambda p: -p.harmonics_um[0])
    lost = []
    if wrong or len(gratings) > MOST_GRATINGS:
        dropped = wrong + max(len(gratings) - MOST_GRATINGS, 0)
        lost.append(f"{dropped} effects are no grating of 0.02 … 100 mm, or too many: left out")
    if varying:
        lost.append(f"{varying} oscillations change over time: their mean is taken")
    return gratings[:MOST_GRATINGS], lost


def _mean(segment: KeyframeSegment, name: str, empty: float) -> tuple[float, bool]:
    """Return the mean of a curve over time, and whether the curve varies."""
    at, value = points(segment.keyframes, name)
    if not len(at):
        return empty, False
    if at[-1] <= at[0]:
        return float(value[-1]), False
    return float(np.trapezoid(value, at) / (at[-1] - at[0])), bool(np.ptp(value) > 0)


def _category(perception: Perception, channel: EffectChannel) -> tuple[str, list[str]]:
    """Return the category by the texture keywords, and a note if there are none."""
    words = [
        resolved(perception, s).keywords or s.keywords or ""
        for band in channel.bands for s in band.segments
    ]  # fmt: skip
    for word in words:
        last = word.rpartition("/")[2]
        if last in CATEGORIES:
            return CATEGORIES[last], []
    return "test", ["it has no texture keyword: its category is test"]
