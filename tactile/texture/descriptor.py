"""Texture descriptor: the contents of a TOML file in ``textures/``.

A descriptor states **tangential skin displacement**, not surface height, at a reference speed and
force: the spatial spectrum of lateral skin displacement identifies a texture well (Wiertlewski,
Lozada & Hayward, IEEE T-RO 2011). Its 16 third-octave bands of spatial frequency become bands of
temporal frequency as the finger moves, frequency = spatial frequency × speed.
`docs/guide/rendering.md` explains why there are 16 bands. Field names carry their units, and
unknown keys are errors.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from tactile import files
from tactile.errors import InputError

BANDS = 16
"""Number of third-octave bands in the random part of a texture."""
THIRD_OCTAVE = 10**0.1
"""Ratio between the centers of adjacent bands."""

Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Number of limited magnitude, −1e6 to 1e6."""
Fraction = Annotated[float, Meta(ge=0, le=1)]
"""Fraction, 0 to 1."""
Degrees = Annotated[float, Meta(ge=-360, le=360)]
"""Angle, −360 to 360 [°]."""
SpatialFrequency = Annotated[float, Meta(ge=0.01, le=100)]
"""Spatial frequency, 0.01 to 100 [cycles/mm]."""
Level = Annotated[float, Meta(ge=-120, le=60)]
"""Level of a power spectral density, −120 to 60 [dB re 1 µm²·mm]."""
Micrometers = Annotated[float, Meta(ge=0, le=500)]
"""Peak amplitude of displacement, 0 to 500 [µm]."""
Speed = Annotated[float, Meta(gt=0, le=1000)]
"""Speed, above 0 and at most 1000 [mm/s]."""
Force = Annotated[float, Meta(gt=0, le=20)]
"""Normal force, above 0 and at most 20 [N]."""
Exponent = Annotated[float, Meta(ge=-4, le=4)]
"""Exponent of a power law, −4 to 4."""
SpreadLimit = Annotated[float, Meta(gt=0, le=60)]
"""Standard deviation of a direction, above 0 and at most 60 [°]."""


class _Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of the tables of a texture file, in which unknown keys are errors."""


class About(_Part, frozen=True, kw_only=True):
    """Table ``[texture]``: identity of a texture, and where its numbers come from.

    Attributes
    ----------
    id : str
        Name of the texture, which equals the file name without its suffix. Lowercase letters,
        digits and single hyphens.
    category : str
        Material: "wood", "leather", "plastic", "textile", "metal", "paper", "stone", "rubber",
        "foam", "abrasive", "glass" or "test".
    description : str
        One line that describes the texture to people.
    provenance : str
        Origin of the shape of the bands: "fitted" to recordings of this material, "published" where
        the length that determines it (grain, pitch, count, cell) is a printed number, or "authored"
        by hand.
    source : str
        Sources of the numbers, and what is assumed. Not empty.
    licence : str
        License of this file.
    """

    id: Annotated[str, Meta(pattern="^[a-z0-9]+(-[a-z0-9]+)*$")]
    category: Literal[
        "wood", "leather", "plastic", "textile", "metal", "paper",
        "stone", "rubber", "foam", "abrasive", "glass", "test",
    ]  # fmt: skip
    description: str
    provenance: Literal["fitted", "published", "authored"]
    source: Annotated[str, Meta(min_length=1)]
    license: str


class Reference(_Part, frozen=True, kw_only=True):
    """Table ``[reference]``: the stroke for which the numbers of a texture hold.

    Attributes
    ----------
    speed_mm_s : float
        Speed of the finger, above 0 and at most 1000 [mm/s].
    normal_force_n : float
        Normal force of the finger, above 0 and at most 20 [N].
    quantity : str
        Quantity that is described, always "tangential_skin_displacement" (the default).
    """

    speed_mm_s: Speed
    normal_force_n: Force
    quantity: Literal["tangential_skin_displacement"] = "tangential_skin_displacement"


class Stochastic(_Part, frozen=True, kw_only=True):
    """Table ``[stochastic]``: the random part of a texture, 16 bands along a straight stroke.

    Attributes
    ----------
    frequency_per_mm : tuple of float
        Centers of the 16 third-octave bands, each 0.01 to 100 [cycles/mm]. Each center is 10^0.1
        (1.26) times the one before it, within 5 %.
    level_db : tuple of float
        One-sided power spectral density of displacement in each of the 16 bands, −120 to 60
        [dB re 1 µm²·mm, that is µm² per cycle/mm]. The variance of a band is 10^(level/10) times
        its width.
    level_sd_db : tuple of float
        Standard deviation of each level from piece to piece of the material, 0 to 40 [dB]. 16
        values, or empty (the default) where it is unknown.
    excess_kurtosis : float
        Excess kurtosis of displacement, 0 to 30; 0 (the default) is Gaussian. A depth d of
        ``am_depth`` alone brings an excess kurtosis of 3 ((1 + d²)⁴ − 1), so that a smaller value
        cannot be realized with it.
    am_depth : float
        Depth of the amplitude modulation, 0 to 1, default 0: standard deviation over mean of the
        part of the envelope below ``am_corner_per_mm``.
    am_corner_per_mm : float
        Highest spatial frequency of the amplitude modulation, 0.01 to 1, default 0.1 [cycles/mm].
    direction_deg : float
        Direction of the stroke along which the bands hold, from the x axis, −360 to 360, default 0
        [°].
    direction_spread_deg : float or None
        Standard deviation of the directions of the wave vectors about ``direction_deg``, above 0
        and at most 60 [°]. Without this key the surface is isotropic, and the bands hold in every
        direction.

    Notes
    -----
    `tactile.texture.measures` defines ``excess_kurtosis``, ``am_depth`` and ``am_corner_per_mm`` as
    measurements of the displacement of this part within the bands along the direction, without the
    lines of ``[[periodic]]`` and without ``[[events]]``.
    """

    frequency_per_mm: tuple[SpatialFrequency, ...]
    level_db: tuple[Level, ...]
    level_sd_db: tuple[Annotated[float, Meta(ge=0, le=40)], ...] = ()
    excess_kurtosis: Annotated[float, Meta(ge=0, le=30)] = 0.0
    am_depth: Fraction = 0.0
    am_corner_per_mm: Annotated[float, Meta(ge=0.01, le=1)] = 0.1
    direction_deg: Degrees = 0.0
    direction_spread_deg: SpreadLimit | None = None

    def __post_init__(self) -> None:
        for name in ("frequency_per_mm", "level_db", "level_sd_db"):
            count = len(getattr(self, name))
            if count != BANDS and (count or name != "level_sd_db"):
                raise ValueError(f"{name} has {count} values, needs {BANDS}")
        ratio = np.divide(self.frequency_per_mm[1:], self.frequency_per_mm[:-1])
        if np.any(np.abs(ratio / THIRD_OCTAVE - 1) > 0.05):
            raise ValueError("frequency_per_mm must ascend in third octaves (× 1.26 each)")


class Periodic(_Part, frozen=True, kw_only=True):
    """Table ``[[periodic]]``: a grating whose harmonics have a fixed phase relative to place.

    The amplitude modulation of ``[stochastic]`` does not apply to a grating.

    Attributes
    ----------
    wavelength_mm : float
        Period of the pattern, 0.02 to 100 [mm].
    harmonics_um : tuple of float
        Peak amplitude of each harmonic, fundamental first, 1 to 32 values of 0 to 500 [µm].
    phases_deg : tuple of float
        Phase of each harmonic, a cosine with its origin at x = y = 0, −360 to 360 [°]. As many
        values as ``harmonics_um``, or empty (the default) for phases of 0. Not used where
        ``jitter`` is above 0, since phases are random then.
    jitter : float
        Relative standard deviation of the wavelength from place to place, 0 to 0.3, default 0.
    direction_deg : float
        Direction across the pattern, in which it repeats, from the x axis, −360 to 360, default 0
        [°].
    """

    wavelength_mm: Annotated[float, Meta(ge=0.02, le=100)]
    harmonics_um: Annotated[tuple[Micrometers, ...], Meta(min_length=1, max_length=32)]
    phases_deg: tuple[Degrees, ...] = ()
    jitter: Annotated[float, Meta(ge=0, le=0.3)] = 0.0
    direction_deg: Degrees = 0.0

    def __post_init__(self) -> None:
        if self.phases_deg and len(self.phases_deg) != len(self.harmonics_um):
            raise ValueError(
                f"phases_deg has {len(self.phases_deg)} values for "
                f"{len(self.harmonics_um)} harmonics"
            )


class Events(_Part, frozen=True, kw_only=True):
    """Table ``[[events]]``: sparse features such as pores, seams or grit, scattered on the surface.

    Attributes
    ----------
    density_per_mm2 : float
        Mean number of features per area, above 0 and at most 4 [1/mm²].
    amplitude_um : float
        Median of the peak displacement, above 0 and at most 500 [µm]. Amplitudes are log-normal,
        with either sign equally often.
    amplitude_sd : float
        Standard deviation of the natural logarithm of the amplitude, 0 to 2, default 0.
    width_mm : float
        Full width at half maximum, 0.1 to 5 [mm].
    shape : str
        "pulse" (the default) for displacement of one sign, or "edge" for its derivative along
        ``direction_deg``, which pushes one way and then the other.
    direction_deg : float
        Direction across an edge, from the x axis, −360 to 360, default 0 [°]. A pulse has none.
    """

    density_per_mm2: Annotated[float, Meta(gt=0, le=4)]
    amplitude_um: Annotated[float, Meta(gt=0, le=500)]
    amplitude_sd: Annotated[float, Meta(ge=0, le=2)] = 0.0
    width_mm: Annotated[float, Meta(ge=0.1, le=5)]
    shape: Literal["pulse", "edge"] = "pulse"
    direction_deg: Degrees = 0.0


class Laws(_Part, frozen=True, kw_only=True):
    """Table ``[laws]``: how the amplitude of displacement changes with speed and normal force.

    The amplitude is multiplied by (v/v0)^e of the speed v and by (N/N0)^e of the normal force N, v0
    and N0 being the reference. Beyond a range it is held at its value at the end of that range.

    Attributes
    ----------
    speed_exponent : float
        Exponent of the speed law, −4 to 4, default 0.
    speed_range_mm_s : tuple of float
        Lowest and highest speed at which the speed law holds, each above 0 and at most 1000,
        ascending, default 20 and 100 [mm/s].
    force_exponent : float
        Exponent of the force law, −4 to 4, default 0.
    force_range_n : tuple of float
        Lowest and highest normal force at which the force law holds, each above 0 and at most 20,
        ascending, default 0.2 and 2 [N].
    contact_length_mm : float
        Length l of a spatial low-pass 1/√(1 + (κ l)²) over the wave number κ [rad/mm], for
        descriptors whose bands do not include the effect of the contact area. 0.05 to 20, or 0 (the
        default) for no low-pass [mm].
    """

    speed_exponent: Exponent = 0.0
    speed_range_mm_s: tuple[Speed, Speed] = (20.0, 100.0)
    force_exponent: Exponent = 0.0
    force_range_n: tuple[Force, Force] = (0.2, 2.0)
    contact_length_mm: Annotated[float, Meta(ge=0, le=20)] = 0.0

    def __post_init__(self) -> None:
        for name in ("speed_range_mm_s", "force_range_n"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name} = [{low}, {high}] must ascend")
        if 0 < self.contact_length_mm < 0.05:
            raise ValueError(
                f"contact_length_mm = {self.contact_length_mm:g}: must be 0 or at least 0.05"
            )


class Friction(_Part, frozen=True, kw_only=True):
    """Table ``[friction]``: quasi-static friction force, rendered as skin stretch (`skin_stretch`).

    The coefficient follows the Stribeck law µk + (µs − µk) exp(−(v/vs)²) of the speed v.

    Attributes
    ----------
    static_coefficient : float
        Static coefficient µs at the reference force, above 0 and at most 5.
    kinetic_coefficient : float
        Kinetic coefficient µk at the reference force, above 0 and at most 5.
    force_exponent : float
        Exponent of the coefficient over the normal force, (N/N0)^e, −4 to 4, default −0.2.
    stribeck_speed_mm_s : float
        Speed vs over which friction falls from static to kinetic, above 0 and at most 1000,
        default 10 [mm/s].
    stick_slip : float
        Share of the contact that sticks and slips instead of sliding evenly, 0 to 1, default 0.
    """

    static_coefficient: Annotated[float, Meta(gt=0, le=5)]
    kinetic_coefficient: Annotated[float, Meta(gt=0, le=5)]
    force_exponent: Exponent = -0.2
    stribeck_speed_mm_s: Speed = 10.0
    stick_slip: Fraction = 0.0


class Descriptor(_Part, frozen=True, kw_only=True):
    """One texture, as it is stored in its file.

    At least one of ``stochastic``, ``periodic`` and ``events`` must be given.

    Attributes
    ----------
    texture : About
        Identity and provenance.
    reference : Reference
        Speed and force for which the numbers hold.
    stochastic : Stochastic or None
        Random part, default None.
    periodic : tuple of Periodic
        Gratings, default none.
    events : tuple of Events
        Kinds of sparse features, default none.
    laws : Laws
        Dependence on speed and force; by default the amplitude is constant.
    friction : Friction or None
        Friction, default None.
    """

    texture: About
    reference: Reference
    stochastic: Stochastic | None = None
    periodic: tuple[Periodic, ...] = ()
    events: tuple[Events, ...] = ()
    laws: Laws = Laws()
    friction: Friction | None = None

    def __post_init__(self) -> None:
        if self.stochastic is None and not self.periodic and not self.events:
            raise ValueError("needs at least one of [stochastic], [[periodic]], [[events]]")


def textures() -> list[str]:
    """List the names of the shipped textures.

    Returns
    -------
    list of str
        Names, sorted.
    """
    return list(files.shipped_names("textures"))


def load(name_or_path: str | Path) -> Descriptor:
    """Load the descriptor of a shipped texture or of a file.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a shipped texture (`textures`), or path of a TOML file.

    Returns
    -------
    Descriptor
        Texture whose ``id`` equals the name of its file.

    Raises
    ------
    NotFoundError
        If there is no such texture or file.
    InputError
        If the file is invalid. The message is one line with the file, field, value and limit.
    """
    path = files.find("textures", name_or_path)
    descriptor = files.read(path, Descriptor, adapt=_rename_license)
    if descriptor.texture.id != path.stem:
        raise InputError(
            f"{path}: texture.id = {descriptor.texture.id!r}: "
            f"must equal the file's name {path.stem!r}"
        )
    return descriptor


def _rename_license(content: dict[str, Any]) -> None:
    """Rename the key ``licence`` of files for version 0.1.0; remove this in version 0.2.

    Where both keys are present, the old one is left and refused as unknown.
    """
    about = content.get("texture")
    if isinstance(about, dict) and "licence" in about and "license" not in about:
        about["license"] = about.pop("licence")
