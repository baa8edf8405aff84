"""What there is to see of a texture: a piece of its surface, its spectrum, a stroke on a display.

Strokes go along x, as the shipped displays shear and as a texture's bands hold. The surface is
told in full; what a display plays of it ends at 1 kHz and is what `tactile.render` commands.

A third octave is told as the peak of the sinusoid that has its power, √2 times its rms, so that it
stands beside a grating's harmonics, the detection threshold and what full drive attains.
"""

import textwrap
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.files import nearest
from tactile.rendering.contact import Trajectory
from tactile.rendering.equalizer import PASS_BAND
from tactile.rendering.renderer import BLOCK, Renderer
from tactile.rendering.shear import EventField
from tactile.strength.commanded import law_factor
from tactile.texture import descriptor as descriptors
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import Events, Periodic
from tactile.texture.event_power import mean_square, power_below
from tactile.texture.perception import detection_threshold
from tactile.texture.surface import Partials, Surface, Texture, without_friction

BANDS = 34
"""Third octaves from 1 Hz to 2 kHz."""
CENTER = 10 ** (np.arange(BANDS) / 10)
EDGES = third_octaves(CENTER)
"""Hz; centers and edges of base ten (IEC 61260-1)."""
NORMAL_FORCE = 0.5
"""N."""
SIDE, PIXELS = 8e-3, 240
"""m and pixels of a piece of surface: 4 pixels to the shortest wave of the bands, 0.125 mm."""
TILE_SIDE, TILE_PIXELS = 6e-3, 180
"""The same of a tile, one of many."""
SWEPT = 1.5
"""How far a stroke goes, in lengths of the row of contactors that it is shown on."""
SAMPLE_RATE = 8000.0
COLUMNS = 3000
"""Instants of a stroke that are kept at most."""
SETTLED = 16
"""Samples of a stroke's start that are left out, until the finger's velocity is known."""
SLOWEST = 0.1
"""Hz; a grating that sounds below it is not crossed but followed."""


def just_felt(frequency: Floats) -> Floats:
    """Return the peak of motion along the skin that is just felt at frequencies (...) [Hz], [m].

    Infinite beyond 1 kHz, where no display plays and nothing normally is felt.
    """
    inside = frequency <= PASS_BAND * (1 + 1e-9)
    return np.where(inside, detection_threshold(frequency), np.inf)


@dataclass(frozen=True)
class StrokeSpectrum:
    """What a stroke along x does to the skin at one place.

    Attributes
    ----------
    waves : (34,) peak of each third octave of the stochastic part [m]
    events : (34,) the same of the sparse events, in the mean over surfaces [m]
    grating_frequency, grating_peak : (H,) of each harmonic [Hz] and [m]
    """

    waves: Floats
    events: Floats
    grating_frequency: Floats
    grating_peak: Floats

    @cached_property
    def total(self) -> Floats:
        """Peak of each third octave with all that is in it, (34,) [m]."""
        gratings = _by_band(self.grating_frequency, self.grating_peak**2)
        return np.sqrt(self.waves**2 + self.events**2 + gratings)

    @cached_property
    def excess_db(self) -> Floats:
        """Of each third octave above the detection threshold, (34,); −inf beyond 1 kHz."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(self.total / just_felt(CENTER)))


@dataclass(frozen=True)
class Sweep:
    """A stroke as the contactors of one row are commanded to move, friction left out.

    Attributes
    ----------
    time : (S,) [s]
    position : (S,) of the finger along x [m]
    contactor : (K,) their numbers, from the least x to the greatest
    place : (K, 2) where they stand under the finger [m]
    shear : (K, S) [m]
    """

    time: Floats
    position: Floats
    contactor: NDArray[np.intp]
    place: Floats
    shear: Floats


@dataclass(frozen=True)
class View:
    """All of a texture on a display at one speed.

    Attributes
    ----------
    texture, display, speed, normal_force : of which; speed [m/s] and force [N]
    surface : (P, P) displacement [m] over `SIDE` × `SIDE` about the origin, y by x, both ascending
    spectrum : at this speed and force
    frequency, attainable : (F,) [Hz] and peak [m] of a sinusoid at the voltage limit, on the
        contactor that moves least, under the finger of the display's table nearest in force
    sweep : a stroke
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

    @property
    def rms(self) -> float:
        """Of the displacement at this speed and force, beyond 1 kHz included [m]."""
        return texture_rms(self.texture, self.speed, self.normal_force)


def view_texture(
    texture: Texture, display: Display, *, speed: float, normal_force: float = NORMAL_FORCE
) -> View:
    """Return what there is to see of a texture on a display.

    Parameters
    ----------
    texture, display : which
    speed, normal_force : of the finger [m/s] and [N]
    """
    renderer = Renderer(display, without_friction(texture), sample_rate=SAMPLE_RATE)
    finger = int(np.argmin(np.abs(np.asarray(display.load_forces) - normal_force)))
    return View(
        texture, display, speed, normal_force,
        surface=surface_patch(texture, speed=speed, normal_force=normal_force),
        spectrum=texture_spectrum(texture, speed=speed, normal_force=normal_force),
        frequency=renderer.frequency,
        attainable=renderer.attainable[finger].min(axis=0),
        sweep=_sweep(renderer, display, speed, normal_force),
    )  # fmt: skip


@dataclass(frozen=True)
class Tile:
    """What there is to see of one texture among many.

    Attributes
    ----------
    name, category : of the texture
    rms : of its displacement [m]
    surface : (P, P) displacement [m] over `TILE_SIDE` × `TILE_SIDE`, y by x
    spectrum : of a stroke along x
    """

    name: str
    category: str
    rms: float
    surface: Floats
    spectrum: StrokeSpectrum


def names_of(category: str | None) -> list[str]:
    """Return the names of the shipped textures of a category, or of all.

    Raises
    ------
    InputError
        Where none is of that category, with the nearest.
    """
    names = descriptors.textures()
    if category is None:
        return names
    known: dict[str, str] = {name: descriptors.load(name).texture.category for name in names}
    if category not in known.values():
        listed = sorted(set(known.values()))
        raise InputError(f"no texture is of category {category!r}; {nearest(category, listed)}")
    return [name for name in names if known[name] == category]


def tile(texture: Texture, *, speed: float) -> Tile:
    """Return what there is to see of one texture among many, at a speed [m/s]."""
    return Tile(
        texture.name,
        texture.descriptor.texture.category,
        texture_rms(texture, speed, NORMAL_FORCE),
        surface_patch(texture, speed=speed, side=TILE_SIDE, pixels=TILE_PIXELS),
        texture_spectrum(texture, speed=speed),
    )


def texture_rms(texture: Texture, speed: float, normal_force: float) -> float:
    """Return the root mean square of the displacement at a speed [m/s] and a force [N], [m].

    Of the realized waves and gratings, what lies below the lowest band and ``contact_length_mm``
    included, and of events; `tactile.texture.amplitudes.strength_of` is what a descriptor says at
    its reference, without either.
    """
    waves = float(np.sum(texture.partials.amplitude**2)) / 2
    events = sum(mean_square(kind) for kind in _kinds(texture))
    return law_factor(texture, speed, normal_force) * float(np.sqrt(waves + events))


def surface_patch(
    texture: Texture,
    *,
    speed: float,
    normal_force: float = NORMAL_FORCE,
    side: float = SIDE,
    pixels: int = PIXELS,
) -> Floats:
    """Return the displacement [m] over a square about the origin, (pixels, pixels) as y by x.

    Parameters
    ----------
    texture : realized with seed 0
    speed, normal_force : for the laws [m/s] and [N]
    side : of the square [m]; values are those at the pixels' middles
    """
    surface = texture.realize()
    place = pixel_places(side, pixels)
    bands, gratings = surface.split
    field = _waves_on(bands, place)
    if len(surface.envelope.amplitude):
        mean_square = np.sum(surface.envelope.amplitude**2) / 2
        field *= np.exp(_waves_on(surface.envelope, place) - mean_square)
    field += _waves_on(gratings, place)
    if len(surface.event_peak):
        field += _events_on(surface, _kinds(texture), place)
    return law_factor(texture, speed, normal_force) * field


def pixel_places(side: float, pixels: int) -> Floats:
    """Return where the middles of a patch's pixels are along either axis, (pixels,) [m]."""
    return np.asarray(((np.arange(pixels) + 0.5) / pixels - 0.5) * side)


def _waves_on(partials: Partials, place: Floats) -> Floats:
    """Return Σ a cos(k·p + φ) [m] on a square grid: a product of two matrices, y by x."""
    along_x, along_y = np.exp(1j * partials.wave_vector.T[:, None, :] * place[:, None])
    phasor = partials.amplitude * np.exp(1j * partials.phase)
    return np.asarray(((along_y * phasor) @ along_x.T).real)


def _events_on(surface: Surface, kinds: tuple[Events, ...], place: Floats) -> Floats:
    """Return the sparse events [m] on a square grid, y by x."""
    y, x = np.meshgrid(place, place, indexing="ij")
    field = EventField(surface, kinds, np.zeros((1, 2)))
    return field.at(np.stack([x.ravel(), y.ravel()]))[:, 0].reshape(x.shape).astype(np.float64)


def texture_spectrum(
    texture: Texture, *, speed: float, normal_force: float = NORMAL_FORCE
) -> StrokeSpectrum:
    """Return what a stroke along x does to the skin at one place, per third octave.

    Partials keep their frequencies: that the slow envelope widens each by its own is left out.

    Parameters
    ----------
    texture : which
    speed, normal_force : of the finger [m/s] and [N]
    """
    factor = law_factor(texture, speed, normal_force)
    drawn, count = texture.partials, len(texture.amplitude)
    sounds = np.abs(drawn.wave_vector[:count, 0]) * speed / (2 * np.pi)
    waves = _by_band(sounds, drawn.amplitude[:count] ** 2)
    events = np.zeros(BANDS)
    for kind in _kinds(texture):
        events += 2 * np.diff(power_below(kind, 2 * np.pi * EDGES / speed))
    frequency, peak = _gratings(texture, speed)
    return StrokeSpectrum(
        factor * np.sqrt(waves), factor * np.sqrt(events), frequency, factor * peak
    )


def _kinds(texture: Texture) -> tuple[Events, ...]:
    return texture.descriptor.events


def _by_band(frequency: Floats, power: Floats) -> Floats:
    """Return the sums of what lies in each third octave, (34,)."""
    return np.histogram(frequency, EDGES, weights=power)[0]


def _gratings(texture: Texture, speed: float) -> tuple[Floats, Floats]:
    """Return frequency [Hz] and peak [m] of each harmonic that a stroke along x crosses.

    One that wavers (``jitter``) is told at its mean frequency with all of its power.
    """
    length = texture.laws.contact_length_mm
    sides = [np.zeros((2, 0))]
    sides += [_harmonics(part, speed, length) for part in texture.descriptor.periodic]
    frequency, peak = np.concatenate(sides, axis=1)
    crossed = frequency >= SLOWEST
    return frequency[crossed], peak[crossed]


def _harmonics(part: Periodic, speed: float, contact_length_mm: float) -> Floats:
    per_mm = np.arange(1, len(part.harmonics_um) + 1) / part.wavelength_mm
    passed = 1 / np.hypot(1, 2 * np.pi * per_mm * contact_length_mm)
    frequency = speed * 1e3 * per_mm * abs(np.cos(np.radians(part.direction_deg)))
    return np.stack([frequency, np.asarray(part.harmonics_um) * 1e-6 * passed])


def _sweep(renderer: Renderer, display: Display, speed: float, normal_force: float) -> Sweep:
    """Play a stroke along x that ends a little after a place has passed under the whole row."""
    row = middle_row(display.contactors)
    x = display.contactors[row, 0]
    way = max(SWEPT * float(np.ptp(x)), SIDE)
    trajectory = Trajectory.line(
        speed=speed, duration=way / speed + SETTLED / SAMPLE_RATE, normal_force=normal_force
    )
    blocks = trajectory.blocks(SAMPLE_RATE, BLOCK, extra=renderer.delay)
    shear = np.concatenate([renderer.block(*block, shear=True)[1][:, row] for block in blocks])
    shear = shear[renderer.delay + SETTLED :]
    step = -(-len(shear) // COLUMNS)
    time = np.arange(len(shear))[::step] / SAMPLE_RATE
    position = speed * (time + SETTLED / SAMPLE_RATE)
    return Sweep(time, position, row, display.contactors[row], shear[::step].T)


def middle_row(places: Floats) -> NDArray[np.intp]:
    """Return the contactors of the row along x nearest to the middle, from left to right.

    Of several rows the longest; contactors at (N, 2) [m] are of one row where their y differs by
    less than 0.1 mm.
    """
    middle = (places[:, 1].min() + places[:, 1].max()) / 2
    rows = [np.flatnonzero(np.abs(places[:, 1] - y) < 1e-4) for y in np.unique(places[:, 1])]
    best = min(rows, key=lambda row: (-len(row), abs(places[row[0], 1] - middle)))
    return best[np.argsort(places[best, 0])]


def facts(view: View, width: int) -> list[str]:
    """Return strength, kind, friction and source in two lines, the last cut to a width."""
    d = view.texture.descriptor
    told = [
        f"{view.rms * 1e6:.2f} µm rms at {view.speed * 1e3:g} mm/s and {view.normal_force:g} N",
        d.texture.category,
        d.texture.provenance,
    ]
    if d.friction is not None:
        told.append(
            f"friction {d.friction.static_coefficient:g} at rest, "
            f"{d.friction.kinetic_coefficient:g} sliding"
        )
    source = textwrap.shorten(d.texture.source, width, placeholder=" …")
    return ["  ·  ".join(told), f"source: {source}"]


def view_figures(view: View) -> dict[str, object]:
    """Return what a view shows as plain figures, for machines.

    Third octaves are those of `shown_bands`, told in micrometers peak.
    """
    s, about = view.spectrum, view.texture.descriptor.texture
    shown = shown_bands(s)
    center = CENTER[shown]
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
        "rms_um": view.rms * 1e6,
        "peak_shear_um": float(np.abs(view.sweep.shear).max()) * 1e6,
        "static_friction": None if friction is None else friction.static_coefficient,
        "kinetic_friction": None if friction is None else friction.kinetic_coefficient,
        "third_octave_hz": [round(float(f), 2) for f in center],
        "third_octave_um": (s.total[shown] * 1e6).tolist(),
        "threshold_um": (just_felt(center) * 1e6).tolist(),
        "attainable_um": (np.interp(center, view.frequency, view.attainable) * 1e6).tolist(),
        "felt_hz": [round(float(f), 2) for f in center[s.excess_db[shown] >= 0]],
        "grating_hz": s.grating_frequency.tolist(),
        "grating_um": (s.grating_peak * 1e6).tolist(),
    }


def shown_bands(spectrum: StrokeSpectrum) -> NDArray[np.intp]:
    """Return the third octaves up to 1 kHz between the outermost within 40 dB of what is felt most.

    What counts is how far each is above the detection threshold, or below it.
    """
    told = np.flatnonzero(spectrum.excess_db >= spectrum.excess_db.max() - 40)
    known = np.isfinite(spectrum.excess_db[told]).any()
    return np.arange(told[0], told[-1] + 1) if known else told[:0]
