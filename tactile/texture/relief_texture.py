"""A texture's descriptor from a picture of its relief, and a report of what was found and lost.

Sharp lines become `[[periodic]]`, the rest 16 bands along a stroke, with a direction where it has
one. Levels and harmonics are what skin makes of the relief by the model in `skin`, whose docstring
says how little is known of it: shapes, wavelengths and directions are measured, levels are good to
a factor of 2. Pores and other sparse features are not told apart; they raise the kurtosis.
"""

import math
import re
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from tactile import files
from tactile.errors import InputError
from tactile.texture import skin
from tactile.texture.descriptor import About, Descriptor, Laws, Periodic, Reference, Stochastic
from tactile.texture.gratings import Grating, gather, take_lines
from tactile.texture.picture import HeightMap
from tactile.texture.relief import (
    CENTERS,
    EDGES,
    Orientation,
    Spectrum,
    first_measured,
    held_below,
    leveled,
    orientation_of,
    spectrum_of,
    stroke_levels,
    unsteadiness_of,
)

Floats = NDArray[np.float64]

SHORTEST = 8e-3
"""Meters of the shorter side: four periods of 0.5 cycles/mm, below which bands are assumed."""
ROUNDING = 0.5
"""Gray levels: a line's amplitude, and beside lines the rms of the rest, that is only rounding."""
NEAR_ROUNDING_DB = 6.0
UM = 1e6
SPEED_MM_S, FORCE_N = 40.0, 0.5


@dataclass(frozen=True)
class Relief:
    """What a picture of relief has become.

    Attributes
    ----------
    descriptor : the texture
    comments : for its file, by path as of `descriptor_file.as_toml`
    roughness_um : Ra of the leveled picture, and its rms
    rms_um : of the leveled picture
    sag_um : of the curvature that is left in it
    rms_slope : of all relief up to the finest band
    contact_share : of the skin that touches it there
    resultant : 0 for an isotropic surface, 1 for waves of one direction
    outside : shares of the relief's variance that are too coarse and too fine for the bands
    notes : what was doubtful, assumed or lost, a line each
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


def texture_of(relief: HeightMap, *, name: str, category: str, picture: str) -> Relief:
    """Make a texture of a height map.

    Parameters
    ----------
    relief : from a picture at least 8 mm wide and high
    name, category : of the texture
    picture : the picture's name, for the source line

    Raises
    ------
    InputError
        Where name or category is none a texture can have, or the picture is too small.
    """
    check_name(name, category)
    if relief.side < SHORTEST:
        raise InputError(
            f"{picture}: {relief.side * 1e3:.3g} mm on its shorter side: needs "
            f"{SHORTEST * 1e3:g} mm, four periods of 0.5 cycles/mm"
        )
    height, sag = leveled(relief.height[::-1])
    whole = spectrum_of(height, relief.pixel)
    lines, rest = take_lines(height, relief.pixel, finest=EDGES[-1], least=ROUNDING * relief.level)
    rest, gratings = leveled(rest)[0], gather(lines, relief.side)
    periodic = tuple(_periodic(one, whole) for one in gratings)
    random = not gratings or rest.std() > ROUNDING * relief.level
    notes = list(relief.notes)
    stochastic, orientation = None, Orientation(0.0, None, 0.0)
    if random:
        stochastic, orientation = _stochastic(rest, relief, whole, notes)
    else:
        notes.append("no random part: beside its gratings the picture holds only rounding")
    finest = float(whole.rms_slope(EDGES[-1:])[0])
    _remark_steepness(finest, notes)
    return Relief(
        descriptor=Descriptor(
            texture=_about(name, category, picture, relief),
            reference=Reference(speed_mm_s=SPEED_MM_S, normal_force_n=FORCE_N),
            stochastic=stochastic,
            periodic=periodic,
            laws=Laws(speed_exponent=-1.0, speed_range_mm_s=(20.0, 60.0), force_exponent=0.4),
        ),
        comments=_comments(stochastic, periodic, relief),
        roughness_um=float(np.mean(np.abs(height))) * UM,
        rms_um=float(height.std()) * UM,
        sag_um=sag * UM,
        rms_slope=finest,
        contact_share=float(skin.share_in_contact(finest)),
        resultant=orientation.resultant,
        outside=_outside(whole),
        notes=tuple(notes),
    )


def check_name(name: str, category: str) -> None:
    """See that a texture can have this name and category.

    Raises
    ------
    InputError
        Where not, with the nearest category.
    """
    known = [str(one) for one in get_args(About.__annotations__["category"])]
    if category not in known:
        raise InputError(f"category {category!r}: unknown; {files.nearest(category, known)}")
    if not re.fullmatch("[a-z0-9]+(-[a-z0-9]+)*", name):
        raise InputError(f"name {name!r}: must be small letters, digits and single hyphens")


def _periodic(grating: Grating, whole: Spectrum) -> Periodic:
    """Return a grating as skin follows it."""
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


def _stochastic(
    rest: Floats, relief: HeightMap, whole: Spectrum, notes: list[str]
) -> tuple[Stochastic, Orientation]:
    """Return the random part as skin follows it; adds to the notes what of it is assumed."""
    spectrum = spectrum_of(rest, relief.pixel)
    followed = spectrum.scaled(skin.skin_gain(whole.rms_slope(spectrum.number)))
    found = orientation_of(followed)
    direction = None if found.spread is None else found.direction
    first = first_measured(relief.side)
    measured = stroke_levels(followed, direction)
    if first:
        notes.append(
            f"bands below {CENTERS[first]:g} cycles/mm are assumed (constant rms): the picture "
            f"holds fewer than four periods"
        )
    grain = _rounding_levels(spectrum, relief.level, direction)
    height_levels = stroke_levels(spectrum, direction)
    rounded = [f"{c:g}" for c, near in zip(
        CENTERS, height_levels - grain < NEAR_ROUNDING_DB, strict=True) if near]  # fmt: skip
    if rounded:
        notes.append(f"bands at {', '.join(rounded)} cycles/mm hold mostly rounding of gray levels")
    unsteady = unsteadiness_of(rest, relief.pixel)
    if unsteady.am_depth is None:
        notes.append("am_depth is 0: the picture is too small to tell (needs 20 mm)")
    return Stochastic(
        frequency_per_mm=CENTERS,
        level_db=tuple(round(float(v), 2) for v in held_below(measured, first)),
        excess_kurtosis=min(round(unsteady.excess_kurtosis, 1), 30.0),
        am_depth=min(round(unsteady.am_depth or 0.0, 2), 1.0),
        am_corner_per_mm=0.2,
        direction_deg=round(math.degrees(found.direction), 1),
        direction_spread_deg=(
            None if found.spread is None else max(round(math.degrees(found.spread), 1), 1.0)
        ),
    ), found


def _rounding_levels(spectrum: Spectrum, level: float, direction: float | None) -> Floats:
    """Return the bands of the error of rounding to gray levels, white with variance level²/12."""
    count = np.where(spectrum.power > 0, 1.0, 0.0)
    white = count * level**2 / 12 / np.sum(count)
    flat = Spectrum(spectrum.x, spectrum.y, white, spectrum.side, spectrum.nyquist)
    return stroke_levels(flat, direction)


def _remark_steepness(rms_slope: float, notes: list[str]) -> None:
    if rms_slope > skin.STEEP:
        notes.append(
            f"steep: rms slope {rms_slope:.2g}, so that skin touches "
            f"{float(skin.share_in_contact(rms_slope)):.0%} of the finest relief; twice the height "
            "is less than twice the displacement"
        )


def _outside(spectrum: Spectrum) -> tuple[float, float]:
    """Return the shares of the variance of waves longer and shorter than those of all bands."""
    total = float(spectrum.power.sum())
    coarse = float(spectrum.power[spectrum.number < EDGES[0]].sum())
    fine = float(spectrum.power[spectrum.number > EDGES[-1]].sum())
    return coarse / total, fine / total


def _about(name: str, category: str, picture: str, relief: HeightMap) -> About:
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
    stochastic: Stochastic | None, periodic: tuple[Periodic, ...], relief: HeightMap
) -> dict[str, str]:
    comments = {
        "": "Made from a picture of relief: shapes are measured, levels come of a model of skin.",
        "reference.speed_mm_s": "of the reference skin spectrum that the model is held against",
        "reference.normal_force_n": "assumed",
        "laws.speed_exponent": "fabrics [Fradin 2023]; that it holds here is assumed",
        "laws.speed_range_mm_s": "speeds of those recordings",
        "laws.force_exponent": "assumed",
    }
    if stochastic is not None:
        first = first_measured(relief.side)
        below = f"; below {CENTERS[first]:g} cycles/mm assumed" if first else ""
        comments["stochastic.level_db"] = f"spectrum along a stroke, times the model's gain{below}"
    for i, _ in enumerate(periodic):
        comments[f"periodic[{i}].wavelength_mm"] = "measured"
        comments[f"periodic[{i}].direction_deg"] = "measured, x to the right and y up"
    return comments
