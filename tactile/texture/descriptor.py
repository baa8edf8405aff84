"""The texture descriptor: what a TOML file in ``textures/`` may say.

It describes **tangential skin displacement**, not surface height, at a reference speed and force:
the spatial spectrum of lateral skin displacement identifies a texture well (Wiertlewski, Lozada &
Hayward, IEEE T-RO 2011). Its 16 third-octave bands in space become frequencies as the finger
moves, frequency = spatial frequency × speed. Why 16 bands: `textures/README.md`.
Field names carry their units; unknown keys are errors.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from tactile import files
from tactile.errors import InputError

BANDS = 16
THIRD_OCTAVE = 10**0.1

Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]
SpatialFrequency = Annotated[float, Meta(ge=0.01, le=100)]
Level = Annotated[float, Meta(ge=-120, le=60)]
Micrometers = Annotated[float, Meta(ge=0, le=500)]
Speed = Annotated[float, Meta(gt=0, le=1000)]
Force = Annotated[float, Meta(gt=0, le=20)]
Exponent = Annotated[float, Meta(ge=-4, le=4)]
SpreadLimit = Annotated[float, Meta(gt=0, le=60)]


class _Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file."""


class About(_Part, frozen=True, kw_only=True):
    """Whose texture this is and where its numbers come from."""

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
    """The stroke that the numbers hold for."""

    speed_mm_s: Speed
    normal_force_n: Force
    quantity: Literal["tangential_skin_displacement"] = "tangential_skin_displacement"


class Stochastic(_Part, frozen=True, kw_only=True):
    """The random part: 16 third-octave bands of spatial frequency along a straight stroke.

    ``level_db`` is the one-sided power spectral density in dB re 1 µm²·mm (µm² per cycle/mm), so
    that a band's variance is 10^(level/10) times its width. Bands hold along ``direction_deg``;
    wave vectors scatter about it with standard deviation ``direction_spread_deg``, and without
    that key the surface is isotropic and the bands hold in every direction.

    ``excess_kurtosis``, ``am_depth`` and ``am_corner_per_mm`` are what `tactile.texture.measures`
    reads from this part's displacement within the bands along the direction, without the lines of
    ``[[periodic]]`` and without ``[[events]]``. A depth d alone brings an excess kurtosis of
    3 ((1 + d²)⁴ − 1): less cannot be had with it.
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
    """A grating: peak amplitude and phase of each harmonic, locked to place.

    ``jitter`` is the relative standard deviation of its wavelength from place to place. The
    envelope of ``[stochastic]`` leaves a grating as it is.
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
    """Sparse features scattered over the surface: pores, seams, grit.

    ``amplitude_um`` is the median of a log-normal whose logarithm has the standard deviation
    ``amplitude_sd``, its sign as often one as the other; ``width_mm`` the full width at half
    maximum. A "pulse" pushes one way and back, an "edge" pushes and pulls (along
    ``direction_deg``).
    """

    density_per_mm2: Annotated[float, Meta(gt=0, le=4)]
    amplitude_um: Annotated[float, Meta(gt=0, le=500)]
    amplitude_sd: Annotated[float, Meta(ge=0, le=2)] = 0.0
    width_mm: Annotated[float, Meta(ge=0.1, le=5)]
    shape: Literal["pulse", "edge"] = "pulse"
    direction_deg: Degrees = 0.0


class Laws(_Part, frozen=True, kw_only=True):
    """How displacement changes with speed and force: (v/v0)^e (N/N0)^e within the ranges.

    Beyond the ranges the amplitude is held. ``contact_length_mm`` low-passes the surface in space
    by 1/√(1 + (κ l)²), where a descriptor's bands do not already include the contact's.
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
    """The quasi-static force that the finger meets, rendered as skin stretch (`skin_stretch`)."""

    static_coefficient: Annotated[float, Meta(gt=0, le=5)]
    kinetic_coefficient: Annotated[float, Meta(gt=0, le=5)]
    force_exponent: Exponent = -0.2
    stribeck_speed_mm_s: Speed = 10.0
    stick_slip: Fraction = 0.0


class Descriptor(_Part, frozen=True, kw_only=True):
    """One texture, as in its file."""

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
    """Return the names of the shipped textures, sorted."""
    return list(files.shipped_names("textures"))


def load(name_or_path: str | Path) -> Descriptor:
    """Return the descriptor of a shipped texture, or of a file.

    Raises
    ------
    NotFoundError, InputError
        One line: file, field, value and limit.
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
