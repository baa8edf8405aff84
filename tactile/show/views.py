"""Contents of a still picture of a texture: part of its surface, its spectrum, and a stroke.

Strokes go along x, the direction in which the shipped displays shear and for which a texture's
bands hold. The surface is shown in full; what a display plays of it ends at 1 kHz and is what
`tactile.render` commands.

The level of a third octave is given as the peak of the sinusoid that has its power, √2 times its
rms, so that it is comparable to a grating's harmonics, the detection threshold and what full drive
attains.
"""

import textwrap
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.rendering.contact import Trajectory
from tactile.rendering.equalizer import PASS_BAND
from tactile.rendering.renderer import BLOCK, Renderer
from tactile.rendering.surface_picture import surface_heights
from tactile.strength.commanded import commanded_lines, law_factor, random_lines
from tactile.strength.figures import ShearFigures
from tactile.strength.strength import SteadyStroke, commanded_figures, conditions, texture_strength
from tactile.texture.bands import nominal_centers, third_octaves
from tactile.texture.descriptor import Periodic
from tactile.texture.event_power import power_below
from tactile.texture.perception import band_sensation, detection_threshold
from tactile.texture.surface import Texture, without_friction

BANDS = 34
"""Number of third octaves, from 1 Hz to 2 kHz."""
CENTER = 10 ** (np.arange(BANDS) / 10)
"""Centers of the third octaves, base ten (IEC 61260-1) [Hz]."""
NOMINAL = nominal_centers(CENTER)
"""Nominal centers of the third octaves, by which they are named [Hz]."""
EDGES = third_octaves(CENTER)
"""Edges of the third octaves, base ten (IEC 61260-1) [Hz]."""
NORMAL_FORCE = 0.5
"""Normal force of strokes, unless another is given [N]."""
SIDE, PIXELS = 8e-3, 240
"""Side of a surface patch [m] and its number of pixels: 4 pixels to the shortest wave of the bands,
0.125 mm."""
TILE_SIDE, TILE_PIXELS = 6e-3, 180
"""Side of a surface patch of one tile among many [m], and its number of pixels."""
SWEPT = 1.5
"""Length of a stroke, relative to the row of contactors that it is shown on."""
SAMPLE_RATE = 8000.0
"""Sample rate of strokes [Hz]."""
COLUMNS = 3000
"""Largest number of instants of a stroke that are kept."""
SETTLING = 16
"""Samples at the start of a stroke that are left out, until the finger's velocity is known."""
SLOWEST = 0.1
"""Frequency below which a grating is taken as followed, not crossed [Hz]."""


def just_felt(frequency: Floats) -> Floats:
    """Compute the peak of tangential motion that is just felt.

    Parameters
    ----------
    frequency : (...) array of float
        Frequencies [Hz].

    Returns
    -------
    (...) array of float
        Peak displacement [m]; infinite beyond 1 kHz, where no display plays and normally nothing is
        felt.
    """
    inside = frequency <= PASS_BAND * (1 + 1e-9)
    return np.where(inside, detection_threshold(frequency), np.inf)


@dataclass(frozen=True)
class StrokeSpectrum:
    """Effect of a stroke along x on the skin at one place.

    Attributes
    ----------
    waves : (34,) array of float
        Peak of each third octave of the stochastic part [m].
    events : (34,) array of float
        Peak of each third octave of the sparse events, as a mean over surfaces [m].
    grating_frequency : (H,) array of float
        Frequency of each harmonic of the gratings [Hz].
    grating_peak : (H,) array of float
        Peak of each harmonic [m].
    level : (34,) array of float
        Sensation level of each third octave with all parts of the texture, −inf beyond 1 kHz
        [dB SL].
    """

    waves: Floats
    events: Floats
    grating_frequency: Floats
    grating_peak: Floats
    level: Floats

    @cached_property
    def total(self) -> Floats:
        """Peak of each third octave with all parts of the texture, (34,) [m]."""
        gratings = by_band(self.grating_frequency, self.grating_peak**2)
        return np.sqrt(self.waves**2 + self.events**2 + gratings)

    @cached_property
    def threshold(self) -> Floats:
        """Peak of each third octave at which it is just felt, (34,) [m].

        It is that of the frequencies that the band holds, or of its center if it is empty.
        """
        own = self.total * 10 ** (-np.maximum(self.level, -300) / 20)
        return np.where(np.isfinite(self.level), own, just_felt(CENTER))


@dataclass(frozen=True)
class Sweep:
    """Stroke as it is commanded to the contactors of one row, without friction.

    Attributes
    ----------
    time : (S,) array of float
        Times [s].
    position : (S,) array of float
        Position of the finger along x [m].
    contactor : (K,) array of int
        Numbers of the contactors, in ascending order of x.
    place : (K, 2) array of float
        Places of these contactors [m].
    shear : (K, S) array of float
        Commanded shear [m].
    """

    time: Floats
    position: Floats
    contactor: NDArray[np.intp]
    place: Floats
    shear: Floats


@dataclass(frozen=True)
class View:
    """Everything about a texture on a display at one speed.

    Attributes
    ----------
    texture : Texture
        Texture that is shown.
    display : Display
        Display that plays it.
    speed : float
        Speed of the finger [m/s].
    normal_force : float
        Normal force [N].
    surface : (P, P) array of float
        Displacement over `SIDE` × `SIDE` about the origin, as y by x, both ascending [m].
    spectrum : StrokeSpectrum
        Spectrum at this speed and force.
    frequency : (F,) array of float
        Frequencies of ``attainable`` [Hz].
    attainable : (F,) array of float
        Peak of a sinusoid at the voltage limit on the contactor that moves least, for the finger of
        the display's table that is nearest in force [m]. Near the resonance in air the limiter
        allows less.
    sweep : Sweep
        Stroke at this speed and force.
    commanded, played : ShearFigures
        Figures of the commanded and of the played shear.
    """

    texture: Texture
    display: Display
    speed: float
    normal_force: float
    surface: Floats
    spectrum: StrokeSpectrum
    frequency: Floats
    attainable: Floats
    sweep: Sweep
    commanded: ShearFigures
    played: ShearFigures

    @property
    def conditions(self) -> str:
        """Display and stroke for which the figures hold."""
        return conditions(self.display, SteadyStroke(self.speed, self.normal_force))


def view_texture(
    texture: Texture, display: Display, *, speed: float, normal_force: float = NORMAL_FORCE
) -> View:
    """Compute the view of a texture on a display.

    Parameters
    ----------
    texture : Texture
        Texture to show.
    display : Display
        Display to play it.
    speed : float
        Speed of the finger [m/s].
    normal_force : float
        Normal force [N].

    Returns
    -------
    View
        Surface, spectrum, reach and stroke.
    """
    renderer = Renderer(display, without_friction(texture), sample_rate=SAMPLE_RATE)
    strength = texture_strength(display, texture, SteadyStroke(speed, normal_force))
    finger = int(np.argmin(np.abs(np.asarray(display.load_forces) - normal_force)))
    response = display.responses(renderer.frequency, SAMPLE_RATE)
    return View(
        texture, display, speed, normal_force,
        surface=surface_patch(texture, speed=speed, normal_force=normal_force),
        spectrum=texture_spectrum(texture, speed=speed, normal_force=normal_force),
        frequency=renderer.frequency,
        attainable=np.abs(response[finger, display.kind]).min(axis=0) * display.limits.voltage,
        sweep=_sweep(renderer, display, speed, normal_force),
        commanded=strength.figures,
        played=strength.played_figures,
    )  # fmt: skip


@dataclass(frozen=True)
class Tile:
    """Summary of one texture among many.

    Attributes
    ----------
    name : str
        Name of the texture.
    category : str
        Category of the texture.
    figures : ShearFigures
        Figures of the commanded shear.
    surface : (P, P) array of float
        Displacement over `TILE_SIDE` × `TILE_SIDE`, as y by x [m].
    spectrum : StrokeSpectrum
        Spectrum of a stroke along x.
    """

    name: str
    category: str
    figures: ShearFigures
    surface: Floats
    spectrum: StrokeSpectrum


def tile(texture: Texture, display: Display, stroke: SteadyStroke) -> Tile:
    """Compute the summary of one texture among many.

    Parameters
    ----------
    texture : Texture
        Texture to show.
    display : Display
        Display to play it.
    stroke : SteadyStroke
        Stroke along x.

    Returns
    -------
    Tile
        Surface, figures and spectrum.
    """
    motion = {"speed": stroke.speed, "normal_force": stroke.normal_force}
    return Tile(
        texture.name,
        texture.descriptor.texture.category,
        commanded_figures(display, texture, stroke),
        surface_patch(texture, **motion, side=TILE_SIDE, pixels=TILE_PIXELS),
        texture_spectrum(texture, **motion),
    )


def surface_patch(
    texture: Texture,
    *,
    speed: float,
    normal_force: float = NORMAL_FORCE,
    side: float = SIDE,
    pixels: int = PIXELS,
) -> Floats:
    """Compute the displacement over a square about the origin, at the centers of its pixels.

    Parameters
    ----------
    texture : Texture
        Texture to show, realized with seed 0.
    speed : float
        Speed of the finger, for the law of speed [m/s].
    normal_force : float
        Normal force, for the law of force [N].
    side : float
        Side of the square [m].
    pixels : int
        Number of pixels along a side.

    Returns
    -------
    (pixels, pixels) array of float
        Displacement as y by x [m].
    """
    place = pixel_places(side, pixels)
    return law_factor(texture, speed, normal_force) * surface_heights(texture, place, place)


def pixel_places(side: float, pixels: int) -> Floats:
    """Compute the centers of a patch's pixels along either axis.

    Parameters
    ----------
    side : float
        Side of the patch [m].
    pixels : int
        Number of pixels along a side.

    Returns
    -------
    (pixels,) array of float
        Coordinates, symmetric about 0 [m].
    """
    return np.asarray(((np.arange(pixels) + 0.5) / pixels - 0.5) * side)


def texture_spectrum(
    texture: Texture, *, speed: float, normal_force: float = NORMAL_FORCE
) -> StrokeSpectrum:
    """Compute the effect of a stroke along x on the skin at one place, per third octave.

    The broadening of the random part by the slow envelope is left out.

    Parameters
    ----------
    texture : Texture
        Texture to show.
    speed : float
        Speed of the finger [m/s].
    normal_force : float
        Normal force [N].

    Returns
    -------
    StrokeSpectrum
        Peaks of waves, events and gratings.
    """
    factor = law_factor(texture, speed, normal_force)
    waves = np.zeros(BANDS)
    if texture.density is not None:
        random = random_lines(texture.density, np.array([speed, 0.0]))
        waves = by_band(random.frequency, 2 * random.power)
    events = np.zeros(BANDS)
    for kind in texture.descriptor.events:
        events += 2 * np.diff(power_below(kind, 2 * np.pi * EDGES / speed))
    frequency, peak = _gratings(texture, speed)
    lines = commanded_lines(texture, speed=speed, normal_force=normal_force)
    level = felt_levels(lines.frequency, lines.power)
    return StrokeSpectrum(
        factor * np.sqrt(waves), factor * np.sqrt(events), frequency, factor * peak, level
    )


def felt_levels(frequency: Floats, power: Floats) -> Floats:
    """Compute the sensation level of each third octave that is played.

    Parameters
    ----------
    frequency : (K,) array of float
        Frequencies of the lines of a spectrum [Hz].
    power : (K,) array of float
        Mean square displacement of each line [m²].

    Returns
    -------
    (34,) array of float
        Sensation levels, −inf for an empty band and beyond 1 kHz [dB SL].
    """
    level = np.full(BANDS, -np.inf)
    played = CENTER <= PASS_BAND * (1 + 1e-9)
    level[played] = band_sensation(frequency, power)[: np.count_nonzero(played)]
    return level


def by_band(frequency: Floats, power: Floats) -> Floats:
    """Sum power in each third octave.

    Parameters
    ----------
    frequency : (P,) array of float
        Frequencies [Hz].
    power : (P,) array of float
        Power at each, in any unit.

    Returns
    -------
    (34,) array of float
        Sums, in the same unit.
    """
    return np.histogram(frequency, EDGES, weights=power)[0]


def _gratings(texture: Texture, speed: float) -> tuple[Floats, Floats]:
    """Return frequency [Hz] and peak [m] of each harmonic that a stroke along x crosses.

    A grating that wavers (``jitter``) is listed at its mean frequency with all of its power.
    """
    length = texture.laws.contact_length_mm
    sides = [np.zeros((2, 0))]
    sides += [_harmonics(part, speed, length) for part in texture.descriptor.periodic]
    frequency, peak = np.concatenate(sides, axis=1)
    crossed = frequency >= SLOWEST
    return frequency[crossed], peak[crossed]


def _harmonics(part: Periodic, speed: float, contact_length_mm: float) -> Floats:
    """Return frequencies [Hz] and peaks [m] of the harmonics of a grating, (2, H)."""
    per_mm = np.arange(1, len(part.harmonics_um) + 1) / part.wavelength_mm
    passed = 1 / np.hypot(1, 2 * np.pi * per_mm * contact_length_mm)
    frequency = speed * 1e3 * per_mm * abs(np.cos(np.radians(part.direction_deg)))
    return np.stack([frequency, np.asarray(part.harmonics_um) * 1e-6 * passed])


def _sweep(renderer: Renderer, display: Display, speed: float, normal_force: float) -> Sweep:
    """Render a stroke along x that ends soon after a place has passed under the whole row."""
    row = middle_row(display.contactors)
    x = display.contactors[row, 0]
    way = max(SWEPT * float(np.ptp(x)), SIDE)
    trajectory = Trajectory.line(
        speed=speed, duration=way / speed + SETTLING / SAMPLE_RATE, normal_force=normal_force
    )
    blocks = trajectory.blocks(SAMPLE_RATE, BLOCK, extra=renderer.delay)
    shear = np.concatenate([renderer.block(*block, shear=True)[1][:, row] for block in blocks])
    shear = shear[renderer.delay + SETTLING :]
    step = -(-len(shear) // COLUMNS)
    time = np.arange(len(shear))[::step] / SAMPLE_RATE
    position = speed * (time + SETTLING / SAMPLE_RATE)
    return Sweep(time, position, row, display.contactors[row], shear[::step].T)


def middle_row(places: Floats) -> NDArray[np.intp]:
    """Find the contactors of the row along x that is nearest to the middle.

    The longest rows are preferred. Contactors belong to one row if their y differ by less than
    0.1 mm.

    Parameters
    ----------
    places : (N, 2) array of float
        Places of the contactors [m].

    Returns
    -------
    (K,) array of int
        Numbers of the contactors, from left to right.
    """
    middle = (places[:, 1].min() + places[:, 1].max()) / 2
    rows = [np.flatnonzero(np.abs(places[:, 1] - y) < 1e-4) for y in np.unique(places[:, 1])]
    best = min(rows, key=lambda row: (-len(row), abs(places[row[0], 1] - middle)))
    return best[np.argsort(places[best, 0])]


def facts(view: View, width: int) -> list[str]:
    """Describe a texture in three lines: figures, sensation and kind, and source.

    Parameters
    ----------
    view : View
        View of the texture.
    width : int
        Largest width of the text of the source [characters].

    Returns
    -------
    list of str
        Three lines.
    """
    d, commanded = view.texture.descriptor, view.commanded
    figures = [
        f"vibration {commanded.vibration_um_rms:.2f} µm rms",
        f"drag {commanded.drag_um:.2f} µm",
        f"peak {commanded.peak_um:.2f} µm",
    ]
    values = [view.played.sensation, d.texture.category, d.texture.provenance]
    if d.friction is not None:
        values.append(
            f"friction {d.friction.static_coefficient:g} at rest, "
            f"{d.friction.kinetic_coefficient:g} sliding"
        )
    source = textwrap.shorten(d.texture.source, width, placeholder=" …")
    return ["  ·  ".join(figures), "  ·  ".join(values), f"source: {source}"]


def view_figures(view: View) -> dict[str, object]:
    """Return the contents of a view as plain figures, for programs.

    The third octaves are those of `shown_bands`; their levels are peaks.

    Parameters
    ----------
    view : View
        View of the texture.

    Returns
    -------
    dict of str to object
        Figures, with the unit at the end of each name.
    """
    s, about = view.spectrum, view.texture.descriptor.texture
    bands = shown_bands(s)
    center = CENTER[bands]
    friction = view.texture.descriptor.friction
    return {
        "name": view.texture.name,
        "display": view.display.name,
        "category": about.category,
        "description": about.description,
        "provenance": about.provenance,
        "source": " ".join(about.source.split()),
        "speed_mm_s": view.speed * 1e3,
        "normal_force_n": view.normal_force,
        "gain": 1.0,
        "commanded": asdict(view.commanded),
        "played": asdict(view.played),
        "static_friction": None if friction is None else friction.static_coefficient,
        "kinetic_friction": None if friction is None else friction.kinetic_coefficient,
        "attainable_um": (np.interp(center, view.frequency, view.attainable) * 1e6).tolist(),
        **band_figures(s),
        "grating_hz": s.grating_frequency.tolist(),
        "grating_um": (s.grating_peak * 1e6).tolist(),
    }


def band_figures(spectrum: StrokeSpectrum) -> dict[str, object]:
    """Return the third octaves of a spectrum that are shown as plain figures, for programs.

    Parameters
    ----------
    spectrum : StrokeSpectrum
        Spectrum.

    Returns
    -------
    dict of str to object
        Nominal centers, peaks, thresholds and sensation levels, and which bands are felt.
    """
    bands = shown_bands(spectrum)
    level = spectrum.level[bands]
    return {
        "third_octave_hz": NOMINAL[bands].tolist(),
        "third_octave_um": (spectrum.total[bands] * 1e6).tolist(),
        "threshold_um": (spectrum.threshold[bands] * 1e6).tolist(),
        "level_db_sl": [float(x) if np.isfinite(x) else None for x in level],
        "felt_hz": NOMINAL[bands][level > 0].tolist(),
    }


def shown_bands(spectrum: StrokeSpectrum) -> NDArray[np.intp]:
    """Select the third octaves that a spectrum shows.

    These are the ones up to 1 kHz between the outermost that are within 40 dB of the highest level
    relative to the detection threshold.

    Parameters
    ----------
    spectrum : StrokeSpectrum
        Spectrum to show.

    Returns
    -------
    (K,) array of int
        Indices of consecutive third octaves.
    """
    strong = np.flatnonzero(spectrum.level >= spectrum.level.max() - 40)
    known = np.isfinite(spectrum.level[strong]).any()
    return np.arange(strong[0], strong[-1] + 1) if known else strong[:0]
