"""Library of textures: rendered textures compared with their descriptors, and fidelity of playing.

**Rendered**: long straight cuts by the `RealizedLayer` that plays, at the reference speed and
without laws, are measured by the same methods by which a fit measures recordings. Only the part of
the bands is cut, under its envelope, because the numbers of ``[stochastic]`` refer to it; lines of
a grating are the same at all contactors except for their phase. An isotropic surface is cut in 16
directions, each with another seed, a grained one along its direction. **Played**: the commanded
shear of every texture is compared with the shear played on ``sim:``, with the same seed.

Figures name the worst texture; a texture beyond a goal has a figure of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from msgspec.structs import replace as changed

from benchmarks.rendering import SKIPPED
from tactile.arrays import Complex, Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most, not_measured
from tactile.display.display import Display, load_display
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.stroke import HISTORY, Stroke
from tactile.sim import Fidelity
from tactile.texture import measures
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import Laws, Stochastic, textures
from tactile.texture.surface import Partials, Texture, load_texture, stochastic_waves

STEP = 20e-6
"""Distance between samples of a cut, which resolves bands to 22.4 cycles/mm [m]."""
SEEDS, SPOTS = 16, 4
"""Number of surfaces, and of places on each that are too far apart to be correlated."""
LENGTH = 1.2
"""Length of a cut [m]; all cuts together are 77 m, 19 000 periods of the lowest band."""
SEGMENT = 80e-3
"""Length of a spectrum's segment, 20 periods of the lowest band [m]."""
DENSE = 1536
"""Number of plane waves that stand for a surface. Of the 384 of a texture, a band has so few that
they are coherent by chance."""
ALONG, ACROSS = 2.5e-3, 3.5e-3
"""Distance between contactors along and across the motion: the pitch of reference-24 [m]."""
SPEEDS = (0.04, 0.08)
"""Speeds of the played strokes [m/s]."""
KURTOSIS, DEPTH, LEVEL, COHERENCE = 0.5, 0.06, 1.0, 0.1
"""Largest permitted differences of descriptor and rendered cuts; the level is in dB."""
FIDELITY, SIMILARITY = 40.0, 0.99
"""Smallest permitted signal-to-error ratio [dB] and ST-SIM of played shear."""


def bands_alone(texture: Texture) -> Texture:
    """Return a texture's bands under the envelope of ``[stochastic]``, and nothing else."""
    only = changed(texture.descriptor, laws=Laws(), events=(), periodic=(), modulation=())
    return replace(texture, descriptor=only)


def directions(texture: Texture) -> Floats:
    """Return the direction of the stroke over the surface of each seed (`SEEDS`,) [rad]."""
    s = texture.descriptor.stochastic
    if s is None or s.direction_spread_deg is None:
        return (np.arange(SEEDS) + 0.37) * np.pi / SEEDS
    return np.full(SEEDS, np.radians(s.direction_deg))


def cut(
    texture: Texture, angle: float, seed: int, offsets: Floats, *, length: float = LENGTH
) -> Floats:
    """Return the shear that a layer commands on a straight stroke.

    Parameters
    ----------
    texture : Texture
        Texture to cut.
    angle : float
        Direction of the motion [rad].
    seed : int
        Seed of the surface.
    offsets : (N, 2) array of float
        Positions of the contactors along and across the motion [m].
    length : float
        Length of the stroke [m].

    Returns
    -------
    (N, S) array of float
        Shear, with a sample every `STEP` [m].
    """
    along = np.array([np.cos(angle), np.sin(angle)])
    turn = np.array([along, [-along[1], along[0]]])
    display = replace(load_display("reference-24"), contactors=offsets @ turn, projected=False)
    layer, reference = RealizedLayer(display, texture, seed=seed), texture.descriptor.reference
    count, parts = round(length / STEP), []
    for start in range(0, count, 2000):
        way = np.arange(start, min(start + 2000, count)) * STEP
        place = np.vstack([np.outer(along, way), np.ones(len(way))])
        speed = np.full(HISTORY + len(way), reference.speed_mm_s * 1e-3)
        force = np.full(len(way), reference.normal_force_n)
        parts.append(layer(Stroke(place, np.outer(along, speed), speed**2, force, start)))
    return np.concatenate(parts).T.astype(np.float64)


def spots(seed: int) -> Floats:
    """Return places (`SPOTS`, 2) on a surface that are meters apart [m]."""
    return np.random.default_rng(seed).uniform(-100, 100, (SPOTS, 2))


@dataclass(frozen=True)
class Statistics:
    """Statistics of long cuts, compared with the descriptor; differences are measured − stated.

    ``kurtosis_error`` and ``depth_error`` are half the difference between two halves of the cuts;
    their rms over many textures is the standard error of the estimate.
    """

    kurtosis: float
    depth: float
    level: Floats
    kurtosis_error: float
    depth_error: float


def statistics(
    texture: Texture, stated: Stochastic, *, seeds: int = SEEDS, length: float = LENGTH
) -> Statistics:
    """Return the statistics of a texture's bands from cuts of a length [m] over some seeds."""
    only, turn = bands_alone(texture), directions(texture)[:: SEEDS // seeds]
    cuts = [cut(only, turn[k], k, spots(k), length=length) for k in range(seeds)]
    halves = [np.concatenate(cuts[k::2]) for k in range(2)]
    corner = stated.am_corner_per_mm * 1e3
    kurtosis = np.array([measures.excess_kurtosis(half, STEP) for half in halves])
    depth = np.array([measures.am_depth(half, STEP, corner) for half in halves])
    center = np.asarray(stated.frequency_per_mm) * 1e3
    levels = np.concatenate([measures.band_spectrum(h, STEP, center=center) for h in halves])
    mean = 10 * np.log10(np.mean(10 ** (levels / 10), axis=0))
    return Statistics(
        float(kurtosis.mean() - stated.excess_kurtosis), float(depth.mean() - stated.am_depth),
        mean - np.asarray(stated.level_db),
        float(abs(np.diff(kurtosis)[0]) / 2), float(abs(np.diff(depth)[0]) / 2),
    )  # fmt: skip


def spectra(signal: Floats) -> Complex:
    """Return the transforms (..., P, F) of half overlapping Hann segments of 80 mm."""
    size = round(SEGMENT / STEP)
    window = np.hanning(size + 1)[:-1].astype(np.float32)
    starts = range(0, signal.shape[-1] - size + 1, size // 2)
    parts = [np.fft.rfft(signal[..., k : k + size] * window) for k in starts]
    return np.stack(parts, axis=-2)


def bands_of_bins(count: int) -> Floats:
    """Return (16, F) ones where a bin of `spectra` lies in a band from 0.25 to 8 cycles/mm."""
    frequency = np.arange(count) / SEGMENT
    band = np.digitize(frequency, third_octaves(measures.CENTERS)) - 1
    return np.asarray(band == np.arange(len(measures.CENTERS))[:, None], np.float64)


def rendered_coherence(one: Complex, other: Complex) -> Floats:
    """Return the coherence per band (B,) of two `spectra`.

    It is |⟨X* Y⟩|²/⟨|X|²⟩⟨|Y|²⟩, averaged over a band and all rows.
    """
    bands = bands_of_bins(one.shape[-1])

    def mean(x: Complex, y: Complex) -> Complex:
        return np.asarray(bands @ (np.conj(x) * y).reshape(-1, x.shape[-1]).mean(axis=0))

    power = mean(one, one).real * mean(other, other).real
    return np.asarray(np.abs(mean(one, other)) ** 2 / np.maximum(power, 1e-300))


def own_coherence(waves: Partials, turns: Floats, offset: Floats) -> Floats:
    """Return the magnitude-squared coherence of a surface itself, per band (B,).

    It is |Σ P exp jk·Δ|²/(Σ P)² over the waves in a band, with Δ from one contactor to the other. P
    is a² times the share of a line at k·u/2π that the Hann window of an estimate leaves in the
    band. The sums run over strokes in several directions u.

    Parameters
    ----------
    waves : Partials
        Waves of the surface.
    turns : array of float
        Directions of the strokes [rad].
    offset : (2,) array of float
        Distance from one contactor to the other along and across the motion [m].
    """
    bins = np.arange(round(SEGMENT / STEP) // 2 + 1)
    bands = bands_of_bins(len(bins))
    cross, power = np.zeros(len(bands), np.complex128), np.zeros(len(bands))
    for turn in turns:
        along = np.array([np.cos(turn), np.sin(turn)])
        signed = waves.wave_vector @ along
        gap = waves.wave_vector @ (offset @ np.array([along, [-along[1], along[0]]]))
        beside = bins[:, None] - np.abs(signed) / (2 * np.pi) * SEGMENT
        share = waves.amplitude**2 * (bands @ hann_power(beside))
        power += share.sum(axis=1)
        cross += share @ np.exp(1j * np.sign(signed) * gap)
    return np.asarray(np.abs(cross) ** 2 / np.maximum(power, 1e-300) ** 2)


def hann_power(bins: Floats) -> Floats:
    """Return |W|² of a Hann window, 1 at zero, at distances in bins (Harris 1978)."""
    shape = np.sinc(bins) + 0.5 * np.sinc(bins - 1) + 0.5 * np.sinc(bins + 1)
    return np.asarray(shape**2)


def coherence_misses(texture: Texture, *, seeds: int = SEEDS) -> dict[str, Floats]:
    """Return rendered − own coherence per band, for contactors along and across the motion."""
    assert texture.descriptor.stochastic is not None
    waves, turns = bands_alone(texture), directions(texture)[:: SEEDS // seeds]
    gaps = np.array([[0, 0], [ALONG, 0], [0, ACROSS]])
    rows = [
        spectra(cut(waves, turn, k, (gaps[:, None] + spots(k)).reshape(-1, 2), length=LENGTH / 2))
        for k, turn in enumerate(turns)
    ]
    base, *others = np.stack(rows, axis=1).reshape(3, SPOTS * seeds, -1, rows[0].shape[-1])
    surface = Partials(*stochastic_waves(texture.descriptor.stochastic, DENSE), np.zeros(DENSE))
    return {
        name: rendered_coherence(base, other) - own_coherence(surface, turns, gap)
        for name, other, gap in zip(("along", "across"), others, gaps[1:], strict=True)
    }


@dataclass(frozen=True)
class PlayedStroke:
    """Quality of a played stroke: signal-to-error ratio [dB] in 20–1000 Hz, ST-SIM, and the loss.

    ``similarity`` is NaN without the package ``vibromaf``. ``limited`` is the share of samples that
    the limiter attenuated, ``loss`` the level that the stroke lost by it [dB].
    """

    fidelity: float
    similarity: float
    limited: float
    loss: float


def played(
    texture: Texture, display: Display, speed: float, *, duration: float = 0.7
) -> PlayedStroke:
    """Play a stroke at the reference force on ``sim:`` and judge it.

    Parameters
    ----------
    texture : Texture
        Texture to play.
    display : Display
        Display to play on.
    speed : float
        Speed along the direction of the texture's bands [m/s].
    duration : float
        Duration of the stroke [s].
    """
    stochastic = texture.descriptor.stochastic
    path = Trajectory.line(
        speed=speed, angle=np.radians(stochastic.direction_deg if stochastic else 0.0),
        duration=duration, normal_force=texture.descriptor.reference.normal_force_n,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        file = Path(folder) / "stroke.npz"
        summary = run(display, texture, path, device="sim:", sample_rate=RATE, record=file)
        with np.load(file) as recorded:
            commanded, shear = recorded["shear_target_m"], recorded["shear_played_m"]
    judge = Fidelity(RATE)
    judge.add(commanded[SKIPPED:-SKIPPED], shear[SKIPPED:-SKIPPED])
    levels = [np.sqrt(np.mean(side[SKIPPED:-SKIPPED] ** 2)) for side in (shear, commanded)]
    return PlayedStroke(
        judge.signal_to_error_db,
        similarity(commanded[SKIPPED:-SKIPPED], shear[SKIPPED:-SKIPPED]),
        summary.limited_samples / summary.samples,
        float(20 * np.log10(levels[0] / levels[1])),
    )


def similarity(commanded: Floats, shear: Floats) -> float:
    """Return the lowest ST-SIM of any contactor (S, N); NaN without ``vibromaf``.

    ST-SIM takes 8 kHz and signals within ± 1, so both are scaled alike. For signals that oppose
    each other it is a complex number, which counts as zero here.
    """
    try:
        from vibromaf.metrics.stsim import st_sim
    except ImportError:
        return float("nan")
    scale = max(np.abs(commanded).max(), np.abs(shear).max())
    with np.errstate(divide="ignore"):
        scores = [st_sim(f / scale, c / scale) for f, c in zip(shear.T, commanded.T, strict=True)]
    return min(0.0 if isinstance(score, complex) else float(score) for score in scores)


def worst_figures(
    what: str, unit: str, limit: float, values: dict[str, float], *, least: bool = False
) -> Iterator[Figure]:
    """Yield the worst value with its goal and its name, and each value beyond the goal.

    With ``least`` the limit is the smallest permitted value, otherwise the largest.
    """
    if not values:
        return
    goal = at_least if least else at_most
    worst = (min if least else max)(values, key=values.__getitem__)
    yield goal(f"library.{what}.worst", values[worst], unit, limit)
    yield Figure(f"library.{what}.worst_is.{worst}", values[worst], unit)
    for name, value in values.items():
        if not goal("", value, "", limit).reached:
            yield Figure(f"library.{what}.beyond.{name}", value, unit)


def measure_library() -> Iterator[Figure]:
    """Measure each texture's rendered statistics and coherence, and how it is played."""
    library = {name: load_texture(name) for name in textures()}
    yield Figure("library.textures", len(library), "")
    yield from _statistics_figures(library)
    misses = {
        name: coherence_misses(texture)
        for name, texture in library.items()
        if texture.descriptor.stochastic is not None
    }
    for side in ("along", "across"):
        worst = {name: float(np.abs(found[side]).max()) for name, found in misses.items()}
        yield from worst_figures(f"coherence_{side}", "", COHERENCE, worst)
    display = load_display("reference-24")
    for speed in SPEEDS:
        yield from _played_figures(library, display, speed)


def _statistics_figures(library: dict[str, Texture]) -> Iterator[Figure]:
    """Yield the largest differences of the rendered statistics from the descriptors."""
    results: dict[str, Statistics] = {}
    for name, texture in library.items():
        if texture.descriptor.stochastic is not None:
            results[name] = statistics(texture, texture.descriptor.stochastic)
    kurtosis = {name: abs(s.kurtosis) for name, s in results.items()}
    depth = {name: abs(s.depth) for name, s in results.items()}
    level = {name: float(np.abs(s.level).max()) for name, s in results.items()}
    yield from worst_figures("kurtosis", "", KURTOSIS, kurtosis)
    yield from worst_figures("am_depth", "", DEPTH, depth)
    yield from worst_figures("level", "dB", LEVEL, level)
    errors = np.array([[s.kurtosis_error, s.depth_error] for s in results.values()])
    for what, error in zip(
        ("kurtosis", "am_depth"), np.sqrt(np.mean(errors**2, axis=0)), strict=True
    ):
        yield Figure(f"library.{what}.standard_error", float(error), "")


def _played_figures(
    library: dict[str, Texture], display: Display, speed: float
) -> Iterator[Figure]:
    """Yield the quality of all textures at a speed; those that the limiter attenuates, apart."""
    strokes = {name: played(texture, display, speed) for name, texture in library.items()}
    at = f"{speed * 1e3:g}_mm_s"
    whole = {name: stroke for name, stroke in strokes.items() if not stroke.limited}
    fidelity = {name: stroke.fidelity for name, stroke in whole.items()}
    yield from worst_figures(f"played.{at}.snr", "dB", FIDELITY, fidelity, least=True)
    like = {n: s.similarity for n, s in whole.items() if not np.isnan(s.similarity)}
    if not like:
        yield not_measured(f"library.played.{at}.st_sim", "needs vibromaf: pip install vibromaf")
    yield from worst_figures(f"played.{at}.st_sim", "", SIMILARITY, like, least=True)
    for name, stroke in strokes.items():
        if stroke.limited:
            yield Figure(f"library.played.{at}.limited.{name}", stroke.loss, "dB")
