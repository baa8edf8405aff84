"""Texture descriptor: the contents of a TOML file in ``textures/``.

A descriptor states **tangential skin displacement**, not surface height, at a reference speed and
force: the spatial spectrum of lateral skin displacement identifies a texture well (Wiertlewski,
Lozada & Hayward, IEEE T-RO 2011). Its third-octave bands of spatial frequency become bands of
temporal frequency as the finger moves, frequency = spatial frequency × speed.
`docs/guide/rendering.md` explains why it is third octaves. Field names carry their units, and
unknown keys are errors.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.map_pixels import unpacked

FEWEST_BANDS, MOST_BANDS = 4, 41
"""Limits of the number of third-octave bands in the random part of a texture. Four bands are more
than an octave; 41 cover all spatial frequencies that a file may state, 0.01 to 100 cycles/mm."""
FINEST_GRATING = 50
"""Highest spatial frequency of a grating [cycles/mm]."""
LARGEST_MAP = 1 << 18
"""Maximum number of pixels of a map, which take 700 kB of the 1 MiB that a file may have. They
cover a square of 28 mm up to 8 cycles/mm, of 9 mm up to 25 cycles/mm."""
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

Category = Literal[
    "wood", "leather", "plastic", "textile", "metal", "paper",
    "stone", "rubber", "foam", "abrasive", "glass", "test",
]  # fmt: skip
"""Material of a texture, which is the name of its folder."""


class _Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of the tables of a texture file, in which unknown keys are errors."""


class About(_Part, frozen=True, kw_only=True):
    """Table ``[texture]``: identity of a texture, and where its numbers come from.

    Attributes
    ----------
    id : str
        Name of the texture, which is the name of its file.
    category : str
        Material, which is the name of its folder.
    description : str
        One line for people.
    provenance : str
        `fitted`: the shape of the bands was fitted to recordings of that material; `published`:
        the length that makes it what it is is a printed number; `authored`: put together by
        hand.
    source : str
        Where the numbers come from and what is assumed.
    license : str
        License of the file.
    """

    id: Annotated[str, Meta(pattern="^[a-z0-9]+(-[a-z0-9]+)*$")]
    category: Category
    description: str
    provenance: Literal["fitted", "published", "authored"]
    source: Annotated[str, Meta(min_length=1)]
    license: str


class Reference(_Part, frozen=True, kw_only=True):
    """Table ``[reference]``: the stroke for which the numbers of a texture hold.

    Attributes
    ----------
    speed_mm_s : float
        Speed of the stroke at which all levels and amplitudes hold.
    normal_force_n : float
        Normal force at which they hold.
    quantity : str
        What is described; there is one choice.
    """

    speed_mm_s: Speed
    normal_force_n: Force
    quantity: Literal["tangential_skin_displacement"] = "tangential_skin_displacement"


class Stochastic(_Part, frozen=True, kw_only=True):
    """Table ``[stochastic]``: the random part of a texture, in bands along a straight stroke.

    Attributes
    ----------
    frequency_per_mm : tuple of float
        Centers of 4 to 41 third-octave bands in cycles/mm, ascending by 10^(1/10). What moves at
        20 mm/s needs bands to 40 cycles/mm to reach 800 Hz.
    level_db : tuple of float
        One-sided power spectral density of displacement in dB re 1 µm² mm, one value for each
        band. The variance of a band is 10^(level/10) × 0.231 × its center.
    level_sd_db : tuple of float
        Spread of the level from piece to piece, one value for each band.
    excess_kurtosis : float
        Excess kurtosis of this part's displacement within the bands: 0 is Gaussian, more is
        spikier. An envelope of depth d alone brings 3 ((1 + d²)⁴ − 1), and less cannot be had
        with it. What ``[[modulation]]`` adds does not count.
    am_depth : float
        Standard deviation ÷ mean of the envelope below its corner, without ``[[modulation]]``.
    am_corner_per_mm : float
        Highest spatial frequency of the envelope, in cycles/mm.
    direction_deg : float
        Direction of the stroke along which the bands hold.
    direction_spread_deg : float or None
        Standard deviation of the direction of the wave vectors; without this key the surface is
        isotropic.
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
        bands = len(self.frequency_per_mm)
        if not FEWEST_BANDS <= bands <= MOST_BANDS:
            raise ValueError(
                f"frequency_per_mm has {bands} values, needs {FEWEST_BANDS} to {MOST_BANDS}"
            )
        for name in ("level_db", "level_sd_db"):
            count = len(getattr(self, name))
            if count != bands and (count or name != "level_sd_db"):
                raise ValueError(f"{name} has {count} values, needs {bands}")
        ratio = np.divide(self.frequency_per_mm[1:], self.frequency_per_mm[:-1])
        if np.any(np.abs(ratio / THIRD_OCTAVE - 1) > 0.05):
            raise ValueError("frequency_per_mm must ascend in third octaves (× 1.26 each)")


class Modulation(_Part, frozen=True, kw_only=True):
    """Table ``[[modulation]]``: a periodic envelope of the random part, as ribs and dots make it.

    The envelope is exp(a cos 2πx/λ), scaled to a mean square of one so that bands keep their
    levels. It is strongest where a grating of the same wavelength and a phase of 0 peaks.

    Attributes
    ----------
    wavelength_mm : float
        Period λ of the envelope.
    depth : float
        Amplitude of the envelope's fundamental ÷ its mean, 2 I₁(a)/I₀(a).
    direction_deg : float
        Direction across the pattern.
    """

    wavelength_mm: Annotated[float, Meta(ge=0.2, le=100)]
    depth: Annotated[float, Meta(gt=0, le=1)]
    direction_deg: Degrees = 0.0


class Periodic(_Part, frozen=True, kw_only=True):
    """Table ``[[periodic]]``: a grating whose harmonics have a fixed phase relative to place.

    The amplitude modulation of ``[stochastic]`` does not apply to a grating.

    Attributes
    ----------
    wavelength_mm : float
        Period of the grating.
    harmonics_um : tuple of float
        Peak amplitude of each harmonic, the fundamental first; 1 to 32 values.
    phases_deg : tuple of float
        Phase of each harmonic.
    jitter : float
        Relative standard deviation of the wavelength from place to place.
    direction_deg : float
        Direction across the pattern.
    """

    wavelength_mm: Annotated[float, Meta(ge=1 / FINEST_GRATING, le=100)]
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
        Mean number per area.
    amplitude_um : float
        Median of the peak amplitude; amplitudes are log-normal, of either sign as often.
    amplitude_sd : float
        Standard deviation of the logarithm of the amplitude.
    width_mm : float
        Full width at half maximum.
    shape : str
        `pulse`: a bump of one sign; `edge`: its derivative, a push and then a pull.
    direction_deg : float
        Direction along which an edge pushes and pulls.
    """

    density_per_mm2: Annotated[float, Meta(gt=0, le=4)]
    amplitude_um: Annotated[float, Meta(gt=0, le=500)]
    amplitude_sd: Annotated[float, Meta(ge=0, le=2)] = 0.0
    width_mm: Annotated[float, Meta(ge=0.1, le=5)]
    shape: Literal["pulse", "edge"] = "pulse"
    direction_deg: Degrees = 0.0


class SkinMap(_Part, frozen=True, kw_only=True):
    """Table ``[map]``: displacement pixel by pixel, which is played instead of bands and gratings.

    The map repeats along x and y without a seam. It is the same for every seed. What is computed
    without a stroke, and frames of spectra, use the bands and gratings of the file, which must
    therefore describe the map.

    Attributes
    ----------
    width_mm : float
        Way along x after which the map repeats.
    height_mm : float
        Way along y after which it repeats.
    columns : int
        Number of pixels along x.
    rows : int
        Number of pixels along y. There are at most 262 144 pixels.
    level_um : float
        Displacement of one level; pixels have levels of −32 767 to 32 767.
    pixels : str
        Levels, row by row from the lowest y on, as written by `tactile relief --map`.
    """

    width_mm: Annotated[float, Meta(ge=1, le=1000)]
    height_mm: Annotated[float, Meta(ge=1, le=1000)]
    columns: Annotated[int, Meta(ge=16, le=16384)]
    rows: Annotated[int, Meta(ge=16, le=16384)]
    level_um: Annotated[float, Meta(ge=0, le=0.02)]
    pixels: str

    def __post_init__(self) -> None:
        if self.columns * self.rows > LARGEST_MAP:
            raise ValueError(
                f"columns = {self.columns}: times {self.rows} rows is more than {LARGEST_MAP} "
                "pixels, the most that may be: cut out a smaller piece"
            )
        unpacked(self.pixels, self.rows, self.columns)

    @property
    def highest_per_mm(self) -> float:
        """Highest spatial frequency, which two pixels resolve [cycles/mm]."""
        return min(self.columns / self.width_mm, self.rows / self.height_mm) / 2

    @property
    def displacement(self) -> Floats:
        """Displacement of each pixel, (rows, columns) [m]."""
        levels = unpacked(self.pixels, self.rows, self.columns)
        return levels.astype(np.float64) * (self.level_um * 1e-6)


class Laws(_Part, frozen=True, kw_only=True):
    """Table ``[laws]``: how the amplitude of displacement changes with speed and normal force.

    The amplitude is multiplied by (v/v0)^e of the speed v and by (N/N0)^e of the normal force N, v0
    and N0 being the reference. Beyond a range it is held at its value at the end of that range. It
    bends smoothly at both ends, and is constant near rest.

    Attributes
    ----------
    speed_exponent : float
        The amplitude is proportional to (speed ÷ reference speed) to this power.
    speed_range_mm_s : tuple of float
        Range of speeds within which that holds; outside it the amplitude is held. It reaches beyond
        the speeds that were recorded: four times in fits, from 20–60 to 20–240 mm/s in the shipped
        textures.
    force_exponent : float
        The amplitude is proportional to (force ÷ reference force) to this power.
    force_range_n : tuple of float
        Range of forces within which that holds.
    contact_length_mm : float
        Length l of an additional low-pass of the contact in space, 1/√(1 + (κ l)²): 0 where the
        bands include it already, else at least 0.05.
    """

    speed_exponent: Exponent = 0.0
    speed_range_mm_s: tuple[Speed, Speed] = (20.0, 240.0)
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
        Coefficient of static friction at the reference force.
    kinetic_coefficient : float
        Coefficient of kinetic friction at the reference force.
    force_exponent : float
        The coefficients are proportional to (force ÷ reference force) to this power.
    stribeck_speed_mm_s : float
        Speed over which friction falls from static to kinetic.
    stick_slip : float
        Share of the contact that sticks and slips: 0 slides evenly.
    """

    static_coefficient: Annotated[float, Meta(gt=0, le=5)]
    kinetic_coefficient: Annotated[float, Meta(gt=0, le=5)]
    force_exponent: Exponent = -0.2
    stribeck_speed_mm_s: Speed = 10.0
    stick_slip: Fraction = 0.0


class Descriptor(_Part, frozen=True, kw_only=True):
    """One texture, as it is stored in its file.

    A texture file is a TOML file that describes how the skin of a sliding finger is moved
    tangentially, as a function of place. Its name without `.toml` must equal ``texture.id``. Units
    are part of the name of each key, unknown keys are errors, and every number must be finite. [The
    textures](/generated/textures.md) page tells how to write one and how the shipped ones came to
    be.

    At least one of ``stochastic``, ``periodic`` and ``events`` must be given, and ``stochastic`` if
    there is a ``modulation``.

    Attributes
    ----------
    texture : About
        Identity and provenance.
    reference : Reference
        Speed and force for which the numbers hold.
    stochastic : Stochastic or None
        Random part, default None.
    modulation : tuple of Modulation
        Periodic envelopes of the random part, default none.
    periodic : tuple of Periodic
        Gratings, default none.
    events : tuple of Events
        Kinds of sparse features, default none.
    laws : Laws
        Dependence on speed and force; by default the amplitude is constant.
    friction : Friction or None
        Friction, default None.
    map : SkinMap or None
        Displacement pixel by pixel, default None.
    """

    texture: About
    reference: Reference
    stochastic: Stochastic | None = None
    modulation: tuple[Modulation, ...] = ()
    periodic: tuple[Periodic, ...] = ()
    events: tuple[Events, ...] = ()
    laws: Laws = Laws()
    friction: Friction | None = None
    map: SkinMap | None = None

    def __post_init__(self) -> None:
        if self.stochastic is None and not self.periodic and not self.events:
            raise ValueError("needs at least one of [stochastic], [[periodic]], [[events]]")
        if self.stochastic is None and self.modulation:
            raise ValueError("[[modulation]] has nothing to modulate; needs [stochastic]")
        if self.map is not None:
            _check_map(self.map, self.stochastic, self.periodic)


def _check_map(
    played: SkinMap, stochastic: Stochastic | None, periodic: tuple[Periodic, ...]
) -> None:
    """Raise ValueError unless there are bands or gratings beside a map, which it resolves."""
    if stochastic is None and not periodic:
        raise ValueError(
            "map: needs [stochastic] or [[periodic]] beside it, which tell its spectrum"
        )
    needed = 0.0
    if stochastic is not None:
        needed = stochastic.frequency_per_mm[-1] * THIRD_OCTAVE**0.5
    if played.highest_per_mm < 0.99 * needed:
        raise ValueError(
            f"map: resolves {played.highest_per_mm:.3g} cycles/mm: needs {needed:.3g}, where "
            "[stochastic] ends; leave out bands or give a finer map"
        )


def textures() -> list[str]:
    """List the names of the shipped textures.

    Returns
    -------
    list of str
        Names, sorted.

    Examples
    --------
    >>> import tactile
    >>> [name for name in tactile.textures() if name.startswith("wood-")]
    ['wood-cork', 'wood-oak', 'wood-paulownia', 'wood-pine-sanded', 'wood-spruce-sawn']
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
    return parse(files.read_text(path), path)


def parse(text: str, path: Path) -> Descriptor:
    """Parse the text of a texture file.

    Parameters
    ----------
    text : str
        Content of the file.
    path : Path
        File that the text comes from, whose name must be the texture's ``id``.

    Returns
    -------
    Descriptor
        Texture that the text describes.

    Raises
    ------
    InputError
        If the text is invalid. The message is one line with the file, field, value and limit.
    """
    descriptor = files.parse(text, path, Descriptor, adapt=_rename_license)
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
