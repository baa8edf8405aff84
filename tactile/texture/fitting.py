"""Fit of a descriptor to recordings: bands, gratings, events, statistics, laws and friction.

Each recording becomes strokes of displacement over place. Lines that recordings at different speeds
share are gratings and are subtracted, and then sparse clicks. Lines that their envelopes share are
periodic envelopes, by which the strokes are divided. What is left is measured in third octaves of
spatial frequency, from 10 Hz at the fastest speed to 800 Hz at the slowest or at 20 mm/s, and the
noise of the sensor is subtracted as power. The differences between the levels at different speeds
and forces give the exponents, which are held near known values where the recordings tell little.
What remains from recording to recording is the spread of the bands.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as changed

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture import measures
from tactile.texture.bands import BELOW, third_octaves
from tactile.texture.clicks import Clicks, find_clicks
from tactile.texture.descriptor import (
    FEWEST_BANDS,
    FINEST_GRATING,
    About,
    Descriptor,
    Events,
    Friction,
    Laws,
    Periodic,
    Reference,
    Stochastic,
)
from tactile.texture.friction_fit import PRESSED, fit_friction
from tactile.texture.lines import (
    APART,
    HarmonicLines,
    common_lines,
    differ,
    find_gratings,
    without,
)
from tactile.texture.modulation_fit import EnvelopeLine, find_modulations, without_modulations
from tactile.texture.power_laws import Number, level_shift, speed_range
from tactile.texture.recorded_slide import Recorded
from tactile.texture.slide_strokes import (
    LOWEST,
    OVERSAMPLING,
    steady_parts,
    strokes_of,
)
from tactile.texture.surface import band_levels, stochastic_waves, stroke_directions

CORE = 25.0, 800.0
"""Centers of the lowest and the highest band at the reference speed that every fit has. An assumed
level and the kurtosis are those of the bands between them: below, a hand and a short recording
count [Hz]."""
SHORT = 0.1
"""Largest part of a band by which bands may end below the one around the higher frequency of
`CORE`."""
SLOWEST = 0.02
"""Speed at which bands reach the higher frequency of `CORE` where no recording is slower, so that a
texture of fast strokes is not silent in slow ones [m/s]."""
OUTER = -20, 20
"""Lowest and highest band of a texture file, 0.01 and 100 cycles/mm, as tenths of the decimal
logarithm."""
OCTAVE = 3
"""Number of bands that are measured together, in segments that suit the lowest of them."""
SPEED_PRIOR = (-1.0, 0.15)
"""Prior mean and standard deviation of the speed exponent: −0.84 and −0.97 were found for denim and
corduroy at 20–60 mm/s, from four recordings each (Fradin et al., World Haptics 2023), that is 0.1
apart."""
FORCE_PRIOR = (0.4, 0.3)
"""Prior mean and standard deviation of the force exponent (assumed; vibration does grow with
force)."""
SCATTER = 3.0
"""Rms difference between the levels of recordings (assumed; 2–4 dB in those of Fradin et al.)
[dB]."""
DEFAULT_FORCE = 0.5
"""Normal force where none is given (assumed) [N]."""
ANCHOR = 1.0
"""Rms displacement that an uncalibrated texture is given (assumed: about that of the shipped ones)
[µm]."""
SPREAD = 15.0
"""Spread of a surface that has a direction (assumed, as in the shipped woods) [°]."""
SMOOTHEST = 0.5
"""Smallest rms second difference of levels that a spectrum is taken to have (assumed; those of 12
materials under a BioTac have 3–6 dB, those of two fabrics less than their recordings tell) [dB]."""
LARGEST_LOSS = 1.0
"""Largest error in any band with which a surface is taken as isotropic [dB]."""
USUAL_CORNER = 100.0
"""Corner of the modulation where none is found [cycles/m], which is the default of a descriptor."""
BURIED = 0.1
"""Smallest share of the power of a band that is left when noise is subtracted."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A texture fitted to recordings.

    Attributes
    ----------
    descriptor : Descriptor
        The texture.
    names : tuple of str
        File names of the R recordings.
    speed : (R,) array of float
        Mean speed of each recording [m/s].
    center : (B,) array of float
        Band centers [cycles/m].
    level : (R, B) array of float
        Level of each recording at its own speed, NaN where it does not cover a band
        [dB re 1 µm²·mm].
    gratings : tuple of HarmonicLines
        Gratings that were found.
    exponent_error : tuple of float
        Standard errors of the speed exponent and of the force exponent.
    isotropic_loss : (B,) array of float
        Level of the nearest isotropic surface above that of the bands [dB].
    notes : tuple of str
        What a reader must know, one line each.
    """

    descriptor: Descriptor
    names: tuple[str, ...]
    speed: Floats
    center: Floats
    level: Floats
    gratings: tuple[HarmonicLines, ...]
    exponent_error: tuple[float, float]
    isotropic_loss: Floats
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Slide:
    """One recording with its strokes.

    Attributes
    ----------
    recorded : Recorded
        The recording.
    speed : float
        Mean speed [m/s].
    force : float
        Mean normal force [N].
    strokes : list of (S,) array of float
        Displacement at even steps of place [m].
    bare : list of (S,) array of float
        Strokes without their gratings, clicks and periodic envelopes [m].
    """

    recorded: Recorded
    speed: float
    force: float
    strokes: list[Floats]
    bare: list[Floats]


@dataclass(frozen=True)
class RecordingMeasures:
    """Measurements of recordings of one surface, from which a texture can be made.

    Attributes
    ----------
    slides : list of Slide
        The R recordings.
    reference : float
        Reference speed [m/s].
    step : float
        Distance between samples of a stroke [m].
    center : (B,) array of float
        Band centers [cycles/m].
    level : (R, B) array of float
        Level of each recording, as in `Fit` [dB re 1 µm²·mm].
    gratings : list of HarmonicLines
        Gratings that most strokes have.
    lines : int
        Number of lines of recordings at a single speed, which tell no rib from a hum. They are left
        in the bands.
    clicks : Clicks or None
        Clicks of all strokes.
    modulations : list of EnvelopeLine
        Periodic envelopes that most strokes have.
    """

    slides: list[Slide]
    reference: float
    step: float
    center: Floats
    level: Floats
    gratings: list[HarmonicLines]
    lines: int
    clicks: Clicks | None = None
    modulations: list[EnvelopeLine] = field(default_factory=list)

    def part(self, rows: Sequence[int]) -> "RecordingMeasures":
        """Select some of the recordings.

        Parameters
        ----------
        rows : sequence of int
            Indices of the recordings.

        Returns
        -------
        RecordingMeasures
            Measurements of these recordings, at the same reference speed, with the same gratings
            and periodic envelopes, and their own clicks.
        """
        owner = np.repeat(np.arange(len(self.slides)), [len(s.strokes) for s in self.slides])
        strokes = np.concatenate([np.flatnonzero(owner == k) for k in rows])
        return changed(
            self,
            slides=[self.slides[k] for k in rows],
            level=self.level[list(rows)],
            gratings=[changed(g, heights=g.heights[strokes]) for g in self.gratings],
            clicks=self.clicks and self.clicks.part(strokes),
            modulations=[changed(m, depths=m.depths[strokes]) for m in self.modulations],
        )

    @property
    def core(self) -> slice:
        """Bands at the frequencies of `CORE` at the reference speed."""
        low, high = _core(self.reference)
        first = round(10 * np.log10(self.center[0] * 1e-3))
        return slice(low - first, high - first + 1)

    @property
    def speed(self) -> Floats:
        """Mean speed of each recording, (R,) array [m/s]."""
        return np.array([s.speed for s in self.slides])

    @property
    def force(self) -> Floats:
        """Mean normal force of each recording, (R,) array [N]."""
        return np.array([s.force for s in self.slides])


def measure_slides(
    recordings: Sequence[Recorded],
    *,
    noise: Recorded | None = None,
    reference_speed: float | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> RecordingMeasures:
    """Measure the bands, gratings, clicks and periodic envelopes of recordings of one surface.

    Parameters
    ----------
    recordings : sequence of Recorded
        Slides over one surface, at one or several speeds and forces.
    noise : Recorded or None
        Recording of the same sensor with nothing sliding.
    reference_speed : float or None
        Speed at which the texture holds [m/s], by default the geometric mean of the recordings.
    progress : callable
        Function that is called with the name of each step.

    Returns
    -------
    RecordingMeasures
        Strokes, levels, gratings, clicks and periodic envelopes.

    Raises
    ------
    InputError
        If the recordings differ in quantity or calibration, are not steady, are too short, or are
        too slow for the bands of a texture.
    """
    _check_together(recordings, noise)
    progress("strokes")
    median_speeds = np.array([np.median(r.speed[r.speed > 0]) for r in recordings])
    reference = reference_speed or float(np.exp(np.log(median_speeds).mean()))
    center = _centers(median_speeds, reference)
    step = 1 / (2 * OVERSAMPLING * third_octaves(center)[-1])
    shortest = measures.SHORTEST / _numbered(_core(reference)[0])
    slides = [_slide(r, step, shortest) for r in recordings]
    progress("lines")
    strokes = [u for s in slides for u in s.strokes]
    speed = np.array([s.speed for s in slides for _ in s.strokes])
    finest = min(third_octaves(center)[-1], FINEST_GRATING * 1e3)
    lines = common_lines(strokes, step, speed, finest)
    gratings = find_gratings(strokes, step, speed, lines)
    slides = [changed(s, bare=[without(u, step, gratings) for u in s.strokes]) for s in slides]
    progress("bands")
    measured = RecordingMeasures(
        slides, reference, step, center, np.zeros(0), gratings, 0 if differ(speed) else len(lines)
    )
    level = np.array([_level(s, measured, noise) for s in slides])
    progress("clicks")
    measured = _without_clicks(changed(measured, level=level))
    progress("envelope")
    measured = _without_modulations(measured)
    if measured.clicks or measured.modulations:
        level = np.array([_level(s, measured, noise) for s in measured.slides])
    first = min(int(np.argmax(np.isfinite(level).any(axis=0))), measured.core.start)
    return changed(measured, center=center[first:], level=level[:, first:])


def _core(reference: float) -> tuple[int, int]:
    """Return the lowest and highest band at the frequencies of `CORE`, numbered as in `OUTER`."""
    low, high = (round(10 * np.log10(f / reference * 1e-3)) for f in CORE)
    if low > OUTER[1] - 3:
        raise InputError(
            f"{reference * 1e3:.3g} mm/s: too slow to fit; at least 0.5 mm/s bring {CORE[0]:g} Hz "
            "into the bands of a texture"
        )
    return low, high


def _centers(speed: Floats, reference: float) -> Floats:
    """Return the exact band centers (IEC 61260-1) for recordings at given speeds [cycles/m]."""
    low, high = _core(reference)
    low = min(low, int(np.ceil(10 * np.log10(LOWEST / BELOW / speed.max() * 1e-3))))
    highest = 10 * np.log10(CORE[1] / min(speed.min(), SLOWEST) * 1e-3)
    high = max(high, int(np.ceil(highest - SHORT)))
    return _numbered(np.arange(max(low, OUTER[0]), min(high, OUTER[1]) + 1.0))


def _numbered(band: Number) -> Number:
    """Return the centers of bands by their numbers [cycles/m]."""
    return 1e3 * 10 ** (band / 10)


def _check_together(recordings: Sequence[Recorded], noise: Recorded | None) -> None:
    """Raise `InputError` if recordings differ in quantity or calibration, or if there are none."""
    if not recordings:
        raise InputError("no recording; give at least one")
    first = recordings[0]
    for other in [*recordings, *([noise] if noise else [])]:
        if (other.quantity, other.calibrated) != (first.quantity, first.calibrated):
            raise InputError(
                f"{other.name}: {other.quantity}, {'' if other.calibrated else 'un'}calibrated; "
                f"{first.name} is {first.quantity}, {'' if first.calibrated else 'un'}calibrated: "
                "recordings of one texture are of one kind"
            )


def _slide(recorded: Recorded, step: float, shortest: float) -> Slide:
    """Return a recording with its strokes, gratings included."""
    parts = steady_parts(recorded, shortest)
    speed = float(np.mean([recorded.speed[part].mean() for part in parts]))
    force = recorded.normal_force
    pressed = DEFAULT_FORCE if force is None else float(np.mean([force[p].mean() for p in parts]))
    if pressed <= 0:
        raise InputError(
            f"{recorded.name}: normal force is {pressed:.3g} N; the finger must press: check its "
            "sign and offset"
        )
    return Slide(recorded, speed, pressed, strokes_of(recorded, step, shortest), [])


def _level(slide: Slide, measured: RecordingMeasures, noise: Recorded | None) -> Floats:
    """Return the levels (B,) of one recording, NaN where it does not cover a band."""
    center = measured.center
    power = _mean_power(slide.bare, measured)
    if noise is not None:
        standing = changed(noise, speed=np.full(len(noise.signal), slide.speed))
        shortest = measures.SHORTEST / center[measured.core.start]
        own = _mean_power(strokes_of(standing, measured.step, shortest), measured)
        power = np.maximum(power - own, BURIED * power)
    edges = third_octaves(center) * slide.speed
    covered = (edges[:-1] >= 0.9 * LOWEST) & (edges[1:] <= 0.4 * slide.recorded.sample_rate)
    return np.where(covered, 10 * np.log10(np.maximum(power, 1e-30)), np.nan)


def _covered(measured: RecordingMeasures) -> Floats:
    """Return the centers of the bands of `CORE` that all recordings cover [cycles/m]."""
    covered = np.isfinite(measured.level[:, measured.core]).all(axis=0)
    return np.asarray(measured.center[measured.core][covered])


def _with_bare(measured: RecordingMeasures, rest: Sequence[Floats]) -> list[Slide]:
    """Return the slides with the rest of their strokes."""
    ends = np.cumsum([len(slide.bare) for slide in measured.slides])
    return [
        changed(slide, bare=list(rest[end - len(slide.bare) : end]))
        for slide, end in zip(measured.slides, ends, strict=True)
    ]


def _without_clicks(measured: RecordingMeasures) -> RecordingMeasures:
    """Return measurements with the clicks in the bands of `CORE`, and slides without them."""
    center = _covered(measured)
    if len(center) < FEWEST_BANDS:
        return measured
    strokes = [u for slide in measured.slides for u in slide.bare]
    ends = np.cumsum([len(slide.bare) for slide in measured.slides])
    groups = [list(range(k - len(s.bare), k)) for s, k in zip(measured.slides, ends, strict=True)]
    clicks, rest = find_clicks(strokes, measured.step, center, groups)
    return changed(measured, slides=_with_bare(measured, rest), clicks=clicks)


def _without_modulations(measured: RecordingMeasures) -> RecordingMeasures:
    """Return measurements with the periodic envelopes of `CORE`, and slides without them."""
    center, step = _covered(measured), measured.step
    if len(center) < FEWEST_BANDS:
        return measured
    strokes = [u for slide in measured.slides for u in slide.bare]
    speed = np.array([slide.speed for slide in measured.slides for _ in slide.bare])
    modulations = find_modulations(strokes, step, speed, center)
    rest = [
        without_modulations(u, step, v, center, modulations)
        for u, v in zip(strokes, speed, strict=True)
    ]
    return changed(measured, slides=_with_bare(measured, rest), modulations=modulations)


def _mean_power(strokes: list[Floats], measured: RecordingMeasures) -> Floats:
    """Return the mean density (B,) of strokes, weighted by their length [µm²·mm].

    An octave is measured on strokes of ten periods of its lowest band, and NaN without one. Octaves
    begin at the lowest band of `CORE`.
    """
    center, step = measured.center, measured.step

    def density(octave: Floats) -> Floats:
        used = [u for u in strokes if len(u) * step * octave[0] >= measures.SHORTEST]
        if not used:
            return np.full(len(octave), np.nan)
        levels = np.array([measures.band_spectrum(u, step, center=octave) for u in used])
        return np.asarray(np.average(10 ** (levels / 10), axis=0, weights=[len(u) for u in used]))

    starts = range(measured.core.start % OCTAVE or OCTAVE, len(center), OCTAVE)
    return np.concatenate([density(octave) for octave in np.split(center, list(starts))])


def exponents(speed: Floats, force: Floats, level: Floats) -> tuple[Floats, Floats]:
    """Fit the exponents of the speed and force laws to the levels of recordings.

    Parameters
    ----------
    speed : (R,) array of float
        Mean speed of each recording [m/s].
    force : (R,) array of float
        Mean normal force of each recording [N].
    level : (R,) array of float
        Mean level of each recording [dB].

    Returns
    -------
    exponent : (2,) array of float
        Exponents of speed and force.
    error : (2,) array of float
        Their standard errors.

    Notes
    -----
    This is a least-squares fit of level = 20 (a lg v + b lg N) + c, combined with the prior values,
    each weighted by its inverse variance. The scatter of levels is that of the recordings about
    their own line, with `SCATTER` as two more of them.
    """
    lever = 20 * np.log10(np.stack([speed, force], axis=1))
    lever, deviation = lever - lever.mean(axis=0), level - level.mean()
    line = np.linalg.lstsq(lever, deviation, rcond=None)[0]
    squared_error = float(np.sum((deviation - lever @ line) ** 2))
    scatter = (2 * SCATTER**2 + squared_error) / max(len(level), 2)
    prior, spread = np.transpose([SPEED_PRIOR, FORCE_PRIOR])
    covariance = np.linalg.inv(lever.T @ lever / scatter + np.diag(spread**-2))
    estimate = covariance @ (lever.T @ deviation / scatter + prior / spread**2)
    return estimate, np.sqrt(np.diag(covariance))


def describe(
    measured: RecordingMeasures, about: About, progress: Callable[[str], None] = lambda step: None
) -> Fit:
    """Make a texture of measurements.

    Parameters
    ----------
    measured : RecordingMeasures
        Measurements by `measure_slides`.
    about : About
        Identity and provenance for the descriptor.
    progress : callable
        Function that is called with the name of each step.

    Returns
    -------
    Fit
        Descriptor, with the measurements that it is made of.

    Raises
    ------
    InputError
        If the recordings have no band in common, or the forces do not give a coefficient of
        friction.
    """
    mean = _over_common_bands(measured.level)
    exponent, error = exponents(measured.speed, measured.force, mean)
    pressed = float(np.exp(np.log(measured.force).mean()))
    reference = Reference(
        speed_mm_s=_digits(measured.reference * 1e3), normal_force_n=_digits(pressed)
    )
    laws = _laws(measured, exponent)
    law = level_shift(laws, reference, measured.speed, measured.force)
    bands, spread = _bands(measured.level - law[:, None], measured)
    calibrated = measured.slides[0].recorded.calibrated
    anchor = 0.0 if calibrated else _anchor(bands, measured)
    gain = np.repeat(10 ** ((anchor - law) / 20), [len(s.strokes) for s in measured.slides])
    progress("statistics")
    stochastic = _stochastic(measured, bands + anchor, spread)
    progress("surface")
    stochastic, loss = with_direction(stochastic)
    descriptor = Descriptor(
        texture=about,
        reference=reference,
        stochastic=stochastic,
        modulation=tuple(line.modulation for line in measured.modulations),
        periodic=tuple(_periodic(g, gain) for g in measured.gratings),
        events=_events(measured.clicks, gain),
        laws=laws,
        friction=_friction(measured.slides, reference, laws),
    )
    return Fit(
        descriptor=descriptor,
        names=tuple(s.recorded.name for s in measured.slides),
        speed=measured.speed,
        center=measured.center,
        level=measured.level,
        gratings=tuple(measured.gratings),
        exponent_error=(float(error[0]), float(error[1])),
        isotropic_loss=loss,
        notes=tuple(_notes(measured)),
    )


def _digits(value: float, count: int = 4) -> float:
    """Return a number rounded to a few significant digits."""
    return float(f"{value:.{count}g}")


def _over_common_bands(level: Floats) -> Floats:
    """Return the mean level (R,) over the bands that every recording covers [dB]."""
    common = np.isfinite(level).all(axis=0)
    if not common.any():
        raise InputError("recordings cover no band in common; fit them one by one")
    return np.asarray(level[:, common].mean(axis=1))


def _bands(level: Floats, measured: RecordingMeasures) -> tuple[Floats, Floats]:
    """Return mean and spread (B,) over recordings, extended linearly where none covers a band.

    The mean is that of recordings brought to their common level, so that it has no step where one
    of them ends.
    """
    known = np.isfinite(level).any(axis=0)
    strength = _over_common_bands(level)[:, None]
    count = np.isfinite(level).sum(axis=0)
    even = level - strength + strength.mean()
    mean = np.where(np.isfinite(level), even, 0).sum(axis=0) / np.maximum(count, 1)
    square = np.where(np.isfinite(level), (level - mean) ** 2, 0).sum(axis=0)
    spread = np.sqrt(square / np.maximum(count - 1, 1))
    x = np.log10(measured.center)
    slope = np.polyfit(x[known], mean[known], 1)[0] if known.sum() > 1 else -10.0
    ends = np.flatnonzero(known)[[0, -1]]
    precise = np.isfinite(level).all(axis=0) & (np.arange(len(x)) >= measured.core.start)
    held = np.interp(x, x[known], _smoothed(mean[known], level[:, known], precise[known]))
    held += slope * np.minimum(x - x[ends[0]], 0) + slope * np.maximum(x - x[ends[1]], 0)
    return held, spread


def _smoothed(mean: Floats, level: Floats, precise: NDArray[np.bool_]) -> Floats:
    """Return the mean (B,) of levels (R, B), smoothed as far as their scatter hides its shape.

    Second differences of the mean have the variance of those of the true spectrum, r², plus 6 times
    the variance s² of the mean, which the recordings tell in the bands (B,) that are precise, each
    without its own mean level. The most probable spectrum then minimizes Σ (x − mean)²/s² + Σ
    (second difference of x)²/r². One recording tells no scatter, and its bands stay as they are.
    """
    if len(level) < 2 or precise.sum() < 3:
        return mean
    shape = level[:, precise] - level[:, precise].mean(axis=1, keepdims=True)
    variance = float(shape.var(axis=0, ddof=1).mean()) / len(level)
    rough = float(np.mean(np.diff(mean[precise], 2) ** 2)) - 6 * variance
    second = np.diff(np.eye(len(mean)), 2, axis=0)
    stiffness = variance / max(rough, SMOOTHEST**2)
    return np.asarray(np.linalg.solve(np.eye(len(mean)) + stiffness * second.T @ second, mean))


def _anchor(bands: Floats, measured: RecordingMeasures) -> float:
    """Return the gain that brings uncalibrated bands to `ANCHOR` [dB]."""
    width = np.diff(third_octaves(measured.center)) * 1e-3
    power = (10 ** (bands / 10) * width)[measured.core]
    return float(20 * np.log10(ANCHOR) - 10 * np.log10(np.sum(power)))


def _stochastic(measured: RecordingMeasures, bands: Floats, spread: Floats) -> Stochastic:
    """Return the random part. Its kurtosis is at least that of its modulation alone."""
    strokes = [u for slide in measured.slides for u in slide.bare]
    lengths, step = [len(u) for u in strokes], measured.step
    center = measured.center[measured.core]
    corners = [measures.am_corner(u, step, center=center) for u in strokes]
    corner = float(np.clip(np.nanmedian([*corners, USUAL_CORNER]), 10.0, 1000.0))
    depths = [measures.am_depth(u, step, corner, center=center) for u in strokes]
    depth = float(np.clip(np.average(depths, weights=lengths), 0, 1))
    peaked = [measures.excess_kurtosis(u, step, center=center) for u in strokes]
    kurtosis = float(np.average(peaked, weights=lengths))
    alone = 3 * ((1 + depth**2) ** 4 - 1)
    return Stochastic(
        frequency_per_mm=tuple(_digits(c * 1e-3) for c in measured.center),
        level_db=tuple(np.round(bands, 1).tolist()),
        level_sd_db=tuple(np.round(spread, 1).tolist()) if len(measured.slides) > 2 else (),
        excess_kurtosis=round(float(np.clip(kurtosis, alone, 30)), 2),
        am_depth=round(depth, 2),
        am_corner_per_mm=round(corner * 1e-3, 3),
    )


def with_direction(stochastic: Stochastic) -> tuple[Stochastic, Floats]:
    """Give a random part a direction if an isotropic surface misses its bands by too much.

    Parameters
    ----------
    stochastic : Stochastic
        Isotropic random part.

    Returns
    -------
    stochastic : Stochastic
        The same bands, with a spread of directions if the error is above `LARGEST_LOSS` in a band.
    loss : (B,) array of float
        Level of the nearest isotropic surface above that of the bands [dB].
    """
    waves = stochastic_waves(stochastic, 8 * len(stochastic.level_db))
    levels = band_levels(*waves, stochastic, stroke_directions(stochastic))
    loss = 10 * np.log10(np.mean(10 ** (levels / 10), axis=0)) - np.asarray(stochastic.level_db)
    if np.abs(loss).max() <= LARGEST_LOSS:
        return stochastic, loss
    return replace(stochastic, direction_spread_deg=SPREAD), loss


def _periodic(grating: HarmonicLines, gain: Floats) -> Periodic:
    """Return a grating as it is at the reference speed and force.

    ``gain`` (R,) is the factor that brings each stroke there.
    """
    place = np.array(grating.orders) - 1
    heights, phases = np.zeros((2, place[-1] + 1))
    heights[place] = np.sqrt(np.nanmean((grating.heights * gain[:, None]) ** 2, axis=0)) * 1e6
    phases[place] = np.degrees(grating.phases)
    return Periodic(
        wavelength_mm=_digits(1e3 / grating.frequency),
        harmonics_um=tuple(_digits(h, 3) for h in heights),
        phases_deg=tuple(np.round(phases).tolist()),
    )


def _events(clicks: Clicks | None, gain: Floats) -> tuple[Events, ...]:
    """Return the events that strokes, brought to the reference by ``gain`` (R,), meet as clicks."""
    events = clicks and clicks.events(gain)
    return (events,) if events else ()


def _laws(measured: RecordingMeasures, exponent: Floats) -> Laws:
    """Return laws of speed, extrapolated, and of force, held 15 % beyond what was recorded."""
    slow, fast = speed_range(float(measured.speed.min()), float(measured.speed.max()))
    forces = np.concatenate([_force_span(slide) for slide in measured.slides])
    light, firm = float(forces.min()) / APART, float(forces.max()) * APART
    return Laws(
        speed_exponent=round(float(exponent[0]), 2),
        speed_range_mm_s=(_digits(slow, 3), _digits(fast, 3)),
        force_exponent=round(float(exponent[1]), 2),
        force_range_n=(round(light, 3), round(firm, 3)),
    )


def _force_span(slide: Slide) -> Floats:
    """Return the mean force of a recording, and what 90 % of its pressed time lie between [N]."""
    force = slide.recorded.normal_force
    pressed = np.zeros(0) if force is None else force[force > PRESSED]
    ends = np.quantile(pressed, [0.05, 0.95]) if len(pressed) else pressed
    return np.append(ends, slide.force)


def _friction(slides: list[Slide], reference: Reference, laws: Laws) -> Friction | None:
    """Return the friction of the recordings that have both forces, or None if there are none."""
    with_forces = [
        s.recorded
        for s in slides
        if s.recorded.tangential_force is not None and s.recorded.normal_force is not None
    ]
    return fit_friction(with_forces, reference, laws) if with_forces else None


def _notes(measured: RecordingMeasures) -> Iterator[str]:
    """Yield what a reader of the descriptor must know."""
    first, speed, force = measured.slides[0].recorded, measured.speed, measured.force
    if not first.calibrated:
        yield f"uncalibrated: its level is assumed, {ANCHOR:g} µm rms; give --full-scale"
    if first.quantity == "force":
        yield "from force through 1 N/mm of skin: too strong above 100 Hz"
    if not differ(speed):
        yield f"one speed: the speed exponent is assumed, {SPEED_PRIOR[0]:g}"
        if measured.lines:
            lines = f"{measured.lines} line{'s' * (measured.lines > 1)}"
            yield f"one speed: {lines} left in the bands; record a second speed"
    if first.normal_force is None:
        yield f"normal force not told: {DEFAULT_FORCE:g} N assumed"
    elif not differ(force):
        yield f"one force: the force exponent is assumed, {FORCE_PRIOR[0]:g}"
    unknown = ~np.isfinite(measured.level).any(axis=0)
    if unknown.any():
        bands = ", ".join(f"{c * 1e-3:.3g}" for c in measured.center[unknown])
        yield f"bands at {bands} cycles/mm were not recorded: they go on straight"
    total = sum(s.recorded.duration for s in measured.slides)
    if total < 3.0:
        yield f"{total:.1f} s in all: bands want 3 s or more"
    if len(measured.slides) < 3:
        yield f"{len(measured.slides)} recordings: three or more tell how bands spread"
