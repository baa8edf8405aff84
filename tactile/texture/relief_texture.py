"""Descriptor of a texture from a picture of its relief, with a report of what was found and lost.

Sharp lines of the spectrum become `[[periodic]]`. The rest becomes bands along a stroke, with a
direction where there is one. They end at 8 cycles/mm, or at 25 where the picture resolves that.
Levels and harmonics are what skin makes of the relief by the model in `skin`, whose docstring says
how little is known of it: shapes, wavelengths and directions are measured, levels are good to a
factor of 2. Pores and other sparse features are not separated; they raise the kurtosis.
"""

import math
import re
from dataclasses import dataclass
from typing import get_args

import numpy as np

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import skin
from tactile.texture.descriptor import (
    About,
    Descriptor,
    Laws,
    Periodic,
    Reference,
    SkinMap,
    Stochastic,
)
from tactile.texture.gratings import HarmonicWaves, gather, take_lines
from tactile.texture.picture import HeightMap
from tactile.texture.relief import (
    CENTERS,
    EDGES,
    FEWEST,
    Orientation,
    ReliefSpectrum,
    first_measured,
    held_below,
    leveled,
    orientation_of,
    spectrum_of,
    stroke_levels,
    unsteadiness_of,
)
from tactile.texture.relief_map import map_of

SHORTEST = 8e-3
"""Smallest shorter side of a picture [m]: four periods of 0.5 cycles/mm, below which bands are
assumed."""
ROUNDING = 0.5
"""Amplitude of a line, and rms of what is left beside lines, up to which they are only rounding
[gray levels]."""
NEAR_ROUNDING_DB = 6.0
"""Level above that of rounding below which a band is reported as mostly rounding [dB]."""
WHOLE = 0.64
"""Smallest share of the area of a picture that a map of all of it has."""
UM = 1e6
"""Micrometers per meter."""
SPEED_MM_S, FORCE_N = 40.0, 0.5
"""Reference speed [mm/s] and normal force [N] of the descriptor."""


@dataclass(frozen=True)
class Relief:
    """Texture made of a picture of relief.

    Attributes
    ----------
    descriptor : Descriptor
        The texture.
    comments : dict of str to str
        Comments for its file by path, as in `descriptor_file.as_toml`.
    roughness_um : float
        Mean absolute height Ra of the leveled picture [µm].
    rms_um : float
        Rms height of the leveled picture [µm].
    sag_um : float
        Range of the curvature that is left in the picture [µm].
    rms_slope : float
        Rms slope of all relief up to the finest band.
    contact_share : float
        Share of the skin that touches this relief, 0 to 1.
    resultant : float
        0 for an isotropic surface, 1 for waves of one direction.
    outside : tuple of float
        Shares of the variance of the relief that are too coarse and too fine for the bands, 0 to 1.
    notes : tuple of str
        What was doubtful, assumed or lost, one line each.
    """

    descriptor: Descriptor
    comments: dict[str, str]
    roughness_um: float
    rms_um: float
    sag_um: float
    rms_slope: float
    contact_share: float
    resultant: float
    outside: tuple[float, float]
    notes: tuple[str, ...]


def texture_of(
    relief: HeightMap, *, name: str, category: str, picture: str, with_map: bool = False
) -> Relief:
    """Make a texture from a height map.

    Parameters
    ----------
    relief : HeightMap
        Heights of a picture of at least 8 mm on its shorter side.
    name : str
        Id of the texture.
    category : str
        Category of the texture.
    picture : str
        Name of the picture, which is written to the source line.
    with_map : bool
        Whether the texture plays the relief itself, as a map, instead of bands and gratings.

    Returns
    -------
    Relief
        Descriptor, with what was measured and what was lost.

    Raises
    ------
    InputError
        If a texture cannot have this name or category, if the picture is too small, or if a height
        is not a number.
    """
    check_name(name, category)
    _check_heights(relief, picture)
    height, sag = leveled(relief.height[::-1])
    spectrum = spectrum_of(height, relief.pixel)
    finest = spectrum.edges[-1]
    lines, rest = take_lines(height, relief.pixel, finest=finest, least=ROUNDING * relief.level)
    rest, gratings = leveled(rest)[0], gather(lines, relief.side)
    periodic = tuple(_periodic(grating, spectrum) for grating in gratings)
    has_random_part = not gratings or rest.std() > ROUNDING * relief.level
    notes = list(relief.notes)
    stochastic, orientation, first = None, Orientation(0.0, None, 0.0), 0
    if has_random_part:
        first = 0 if with_map else first_measured(relief.side)
        stochastic, orientation = _stochastic(rest, relief, spectrum, first, notes)
    else:
        notes.append("no random part: beside its gratings the picture holds only rounding")
    slope = float(spectrum.rms_slope(spectrum.edges[-1:])[0])
    _note_steepness(slope, notes)
    return Relief(
        descriptor=Descriptor(
            texture=_about(name, category, picture, relief),
            reference=Reference(speed_mm_s=SPEED_MM_S, normal_force_n=FORCE_N),
            stochastic=stochastic,
            periodic=periodic,
            map=_map(height, relief, spectrum, stochastic, gratings, notes) if with_map else None,
            laws=Laws(speed_exponent=-1.0, force_exponent=0.4),
        ),
        comments=_comments(stochastic, periodic, first, with_map=with_map),
        roughness_um=float(np.mean(np.abs(height))) * UM,
        rms_um=float(height.std()) * UM,
        sag_um=sag * UM,
        rms_slope=slope,
        contact_share=float(skin.share_in_contact(slope)),
        resultant=orientation.resultant,
        outside=_outside(spectrum),
        notes=tuple(notes),
    )


def check_name(name: str, category: str) -> None:
    """Check that a texture can have a given name and category.

    Parameters
    ----------
    name : str
        Id of the texture.
    category : str
        Category of the texture.

    Raises
    ------
    InputError
        If it cannot. The message names the nearest category.
    """
    categories = [str(known) for known in get_args(About.__annotations__["category"])]
    if category not in categories:
        raise InputError(f"category {category!r}: unknown; {files.nearest(category, categories)}")
    if not re.fullmatch("[a-z0-9]+(-[a-z0-9]+)*", name):
        raise InputError(f"name {name!r}: must be small letters, digits and single hyphens")


def _check_heights(relief: HeightMap, picture: str) -> None:
    """Raise `InputError` if a height is not a number or the picture is too small."""
    holes = np.count_nonzero(~np.isfinite(relief.height))
    if holes:
        raise InputError(f"{picture}: {holes} heights are not numbers: fill them first")
    if relief.side < SHORTEST:
        raise InputError(
            f"{picture}: {relief.side * 1e3:.3g} mm on its shorter side: needs "
            f"{SHORTEST * 1e3:g} mm, four periods of 0.5 cycles/mm"
        )


def _periodic(grating: HarmonicWaves, whole: ReliefSpectrum) -> Periodic:
    """Return a grating with the amplitudes of the skin that follows it."""
    fundamental = float(np.hypot(*grating.frequency))
    order = np.arange(1.0, len(grating.amplitude) + 1)
    gain = skin.skin_gain(whole.rms_slope(np.asarray(order * fundamental, np.float64)))
    turn = math.degrees(math.atan2(grating.frequency[1], grating.frequency[0]))
    return Periodic(
        wavelength_mm=float(f"{1e3 / fundamental:.5g}"),
        harmonics_um=tuple(float(f"{a:.3g}") for a in grating.amplitude * gain * UM),
        phases_deg=tuple(round(float(p), 1) for p in np.degrees(grating.phase)),
        direction_deg=round(turn, 2),
    )


def _map(
    height: Floats, relief: HeightMap, spectrum: ReliefSpectrum, stochastic: Stochastic | None,
    gratings: list[HarmonicWaves], notes: list[str],
) -> SkinMap:  # fmt: skip
    """Return the map up to where bands and gratings end, and append to the notes what it lacks."""
    bands = len(stochastic.frequency_per_mm) if stochastic else FEWEST
    finest = [float(np.hypot(*g.frequency)) * len(g.amplitude) for g in gratings]
    highest = EDGES[max(bands, *np.searchsorted(EDGES, finest), 0)]
    played = map_of(height, relief.pixel, spectrum, float(highest))
    if played.width_mm * played.height_mm < WHOLE * height.size * (relief.pixel * 1e3) ** 2:
        notes.append(
            f"the map is the middle of the picture: up to {highest * 1e-3:.3g} cycles/mm, a file "
            f"holds {played.width_mm:.3g} × {played.height_mm:.3g} mm"
        )
    return played


def _stochastic(
    rest: Floats, relief: HeightMap, whole: ReliefSpectrum, first: int, notes: list[str]
) -> tuple[Stochastic, Orientation]:
    """Return the random part as skin follows it, and append to the notes what of it is assumed.

    Bands below the number ``first`` are assumed.
    """
    spectrum = spectrum_of(rest, relief.pixel)
    followed = spectrum.scaled(skin.skin_gain(whole.rms_slope(spectrum.number)))
    orientation = orientation_of(followed)
    direction = None if orientation.spread is None else orientation.direction
    measured = stroke_levels(followed, direction)
    if first:
        notes.append(
            f"bands below {CENTERS[first]:g} cycles/mm are assumed (constant rms): the picture "
            f"holds fewer than four periods"
        )
    rounding = _rounding_levels(spectrum, relief.level, direction)
    bands = _noting_rounding(stroke_levels(spectrum, direction) - rounding, notes)
    unsteady = unsteadiness_of(rest, relief.pixel, EDGES[bands])
    if unsteady.am_depth is None:
        notes.append("am_depth is 0: the picture is too small to tell (needs 20 mm)")
    return Stochastic(
        frequency_per_mm=CENTERS[:bands],
        level_db=tuple(round(float(v), 2) for v in held_below(measured, first)[:bands]),
        excess_kurtosis=min(round(unsteady.excess_kurtosis, 1), 30.0),
        am_depth=min(round(unsteady.am_depth or 0.0, 2), 1.0),
        am_corner_per_mm=0.2,
        direction_deg=round(math.degrees(orientation.direction), 1),
        direction_spread_deg=(
            None
            if orientation.spread is None
            else max(round(math.degrees(orientation.spread), 1), 1.0)
        ),
    ), orientation


def _noting_rounding(above: Floats, notes: list[str]) -> int:
    """Return the number of bands, and append to the notes which of them hold mostly rounding.

    ``above`` are the levels above those of rounding. Bands beyond those that every picture has end
    before the first one of mere rounding.
    """
    rounded = above < NEAR_ROUNDING_DB
    bands = FEWEST + int(np.argmax(np.append(rounded[FEWEST:], True)))
    names = [f"{CENTERS[k]:g}" for k in np.flatnonzero(rounded[:bands])]
    if names:
        notes.append(f"bands at {', '.join(names)} cycles/mm hold mostly rounding of gray levels")
    return bands


def _rounding_levels(spectrum: ReliefSpectrum, level: float, direction: float | None) -> Floats:
    """Return the band levels of rounding to gray levels: white noise of variance level²/12."""
    count = np.where(spectrum.power > 0, 1.0, 0.0)
    white = count * level**2 / 12 / np.sum(count)
    flat = ReliefSpectrum(spectrum.x, spectrum.y, white, spectrum.side, spectrum.nyquist)
    return stroke_levels(flat, direction)


def _note_steepness(rms_slope: float, notes: list[str]) -> None:
    """Append a note if the relief is too steep for skin to follow in proportion."""
    if rms_slope > skin.STEEP:
        notes.append(
            f"steep: rms slope {rms_slope:.2g}, so that skin touches "
            f"{float(skin.share_in_contact(rms_slope)):.0%} of the finest relief; twice the height "
            "is less than twice the displacement"
        )


def _outside(spectrum: ReliefSpectrum) -> tuple[float, float]:
    """Return the shares of the variance in waves longer and shorter than those of all bands."""
    total = float(spectrum.power.sum())
    coarse = float(spectrum.power[spectrum.number < EDGES[0]].sum())
    fine = float(spectrum.power[spectrum.number > spectrum.edges[-1]].sum())
    return coarse / total, fine / total


def _about(name: str, category: str, picture: str, relief: HeightMap) -> About:
    """Return the identity of the texture, with the source line."""
    rows, columns = relief.height.shape
    readable = picture.encode("utf-8", "replace").decode()
    return About(
        id=name,
        category=category,  # type: ignore[arg-type]
        description=f"Relief in {readable}",
        provenance="fitted",
        source=(
            f"Fitted to the relief in {readable}: {columns} × {rows} pixels of "
            f"{relief.pixel * 1e3:g} mm, {relief.level * UM:g} µm per gray level, both as given. "
            f"Wavelengths, directions and shapes are measured; skin displacement is a model "
            f"(tactile/texture/skin.py): an elastic half-space under mean pressure moves in "
            f"proportion to the relief it touches, {skin.GAIN:.3f} µm per µm, and bridges what is "
            f"too steep for it. Assumed there: friction {skin.FRICTION:g}, pressure "
            f"{skin.PRESSURE * 1e-3:g} kPa, contact modulus {skin.MODULUS * 1e-3:g} kPa, patch "
            f"{skin.PATCH:g} times the skin beside it. Levels are known within a factor of 2. "
            "Speed and force laws: assumed, as for the shipped textures."
        ),
        license="not stated",
    )


def _comments(
    stochastic: Stochastic | None, periodic: tuple[Periodic, ...], first: int, *, with_map: bool
) -> dict[str, str]:
    """Return the comments for the file by path."""
    comments = {
        "": "Made from a picture of relief: shapes are measured, levels come of a model of skin.",
        "reference.speed_mm_s": "of the reference skin spectrum that the model is held against",
        "reference.normal_force_n": "assumed",
        "laws.speed_exponent": "fabrics [Fradin 2023]; that it holds here is assumed",
        "laws.force_exponent": "assumed",
    }
    if stochastic is not None:
        below = f"; below {CENTERS[first]:g} cycles/mm assumed" if first else ""
        comments["stochastic.level_db"] = f"spectrum along a stroke, times the model's gain{below}"
    for i, _ in enumerate(periodic):
        comments[f"periodic[{i}].wavelength_mm"] = "measured"
        comments[f"periodic[{i}].direction_deg"] = "measured, x to the right and y up"
    if with_map:
        comments["map"] = "Played instead of the bands and gratings above, which describe it."
    return comments
