"""The library of textures: what is rendered is what each descriptor says, and what is played.

**Rendered**: long straight cuts by the `RealizedLayer` that plays, at the reference speed and
without laws, measured with what a fit measures recordings with. The bands' part alone is cut, under
its envelope, as the numbers of ``[stochastic]`` are about it; lines of a grating are the same at
all contactors but for their phase. An isotropic surface is cut in 16 directions, each of another
seed, a grained one along its direction. **Played**: every texture on ``sim:``, shear commanded
against shear played, of the same seed.

Figures name the worst texture; one beyond a goal has a figure of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from msgspec.structs import replace as changed

from tactile.arrays import Complex, Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most
from tactile.display.display import Display, load_display
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.stroke import HISTORY, Stroke
from tactile.sim import Fidelity
from tactile.texture import measures
from tactile.texture.bands import third_octaves
from tactile.texture.descriptor import Laws, Stochastic, textures
from tactile.texture.surface import Partials, Texture, load_texture

STEP = 50e-6
"""m between samples of a cut."""
SEEDS, SPOTS = 16, 4
"""Cuts: so many surfaces, and places on each too far apart to have anything in common."""
LENGTH = 1.2
"""m of a cut; all are 77 m, 19 000 periods of the lowest band."""
SEGMENT = 80e-3
"""m of a spectrum's segment, 20 periods of the lowest band."""
ALONG, ACROSS = 2.5e-3, 3.5e-3
"""m between contactors along and across the motion: the pitch of reference-24."""
SPEEDS = (0.04, 0.08)
"""m/s of what is played."""
SKIPPED = 800
"""Samples until a played stroke has faded in and filters have settled."""
KURTOSIS, DEPTH, LEVEL, COHERENCE = 0.5, 0.06, 1.0, 0.1
"""What may lie between descriptor and rendered cuts; level in dB."""
FIDELITY, SIMILARITY = 40.0, 0.99
"""What played shear must reach: signal-to-error ratio [dB] and ST-SIM."""


def bands_alone(texture: Texture) -> Texture:
    """Return a texture's bands under their envelope, without laws, gratings and events."""
    only = changed(texture.descriptor, laws=Laws(), events=(), periodic=())
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
    """Return what a layer asks of contactors on a straight stroke.

    Parameters
    ----------
    texture : what
    angle : of the motion [rad]
    seed : of the surface
    offsets : (N, 2) of the contactors along and across the motion [m]
    length : of the stroke [m]

    Returns
    -------
    (N, S) ndarray
        Shear [m], a sample every `STEP`.
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
    """Return places (`SPOTS`, 2) on a surface, meters apart [m]."""
    return np.random.default_rng(seed).uniform(-100, 100, (SPOTS, 2))


@dataclass(frozen=True)
class Statistics:
    """What long cuts have, against the descriptor; differences are measured − stated.

    ``kurtosis_error`` and ``depth_error`` are half of what lies between two halves of the cuts:
    over many textures their rms is the standard error of the estimate.
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
    """Return (16, F) ones where a bin of `spectra` lies in a band."""
    frequency = np.arange(count) / SEGMENT
    band = np.digitize(frequency, third_octaves(measures.CENTERS)) - 1
    return np.asarray(band == np.arange(len(measures.CENTERS))[:, None], np.float64)


def rendered_coherence(one: Complex, other: Complex) -> Floats:
    """Return |⟨X* Y⟩|²/⟨|X|²⟩⟨|Y|²⟩ per band (16,) of `spectra`, mean over a band and all rows."""
    bands = bands_of_bins(one.shape[-1])

    def mean(x: Complex, y: Complex) -> Complex:
        return np.asarray(bands @ (np.conj(x) * y).reshape(-1, x.shape[-1]).mean(axis=0))

    power = mean(one, one).real * mean(other, other).real
    return np.asarray(np.abs(mean(one, other)) ** 2 / np.maximum(power, 1e-300))


def own_coherence(waves: Partials, turns: Floats, offset: Floats) -> Floats:
    """Return the magnitude-squared coherence of a surface itself, per band (16,).

    |Σ P exp jk·Δ|²/(Σ P)² over the waves in a band, Δ from one contactor to the other, P = a²
    times what of a line at k·u/2π the Hann window of an estimate leaves in the band; sums over
    strokes in several directions u.

    Parameters
    ----------
    waves : of the surface
    turns : directions of the strokes [rad]
    offset : (2,) from one contactor to the other along and across the motion [m]
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
    """Return |W|² of a Hann window, one at zero, at distances in bins (Harris 1978)."""
    shape = np.sinc(bins) + 0.5 * np.sinc(bins - 1) + 0.5 * np.sinc(bins + 1)
    return np.asarray(shape**2)


def coherence_misses(texture: Texture, *, seeds: int = SEEDS) -> dict[str, Floats]:
    """Return rendered − own coherence per band, of contactors along and across the motion."""
    waves, turns = bands_alone(texture), directions(texture)[:: SEEDS // seeds]
    gaps = np.array([[0, 0], [ALONG, 0], [0, ACROSS]])
    rows = [
        spectra(cut(waves, turn, k, (gaps[:, None] + spots(k)).reshape(-1, 2), length=LENGTH / 2))
        for k, turn in enumerate(turns)
    ]
    base, *others = np.stack(rows, axis=1).reshape(3, SPOTS * seeds, -1, rows[0].shape[-1])
    surface = waves.realize().partials
    return {
        name: rendered_coherence(base, other) - own_coherence(surface, turns, gap)
        for name, other, gap in zip(("along", "across"), others, gaps[1:], strict=True)
    }


@dataclass(frozen=True)
class PlayedStroke:
    """How a stroke was played: signal-to-error ratio [dB] in 20–1000 Hz, ST-SIM, and what is lost.

    ``similarity`` is NaN without the package ``vibromaf``. ``limited`` is the share of samples
    that the limiter turned down, ``loss`` what the stroke lost by it [dB].
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
    texture, display : what on what
    speed : along the direction of its bands [m/s]
    duration : [s]
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
            commanded, felt = recorded["shear_target_m"], recorded["shear_played_m"]
    judge = Fidelity(RATE)
    judge.add(commanded[SKIPPED:-SKIPPED], felt[SKIPPED:-SKIPPED])
    heard = [np.sqrt(np.mean(shear[SKIPPED:-SKIPPED] ** 2)) for shear in (felt, commanded)]
    return PlayedStroke(
        judge.signal_to_error_db,
        similarity(commanded[SKIPPED:-SKIPPED], felt[SKIPPED:-SKIPPED]),
        summary.limited_samples / summary.samples,
        float(20 * np.log10(heard[0] / heard[1])),
    )


def similarity(commanded: Floats, felt: Floats) -> float:
    """Return the lowest ST-SIM of any contactor (S, N); NaN without ``vibromaf``.

    It takes 8 kHz and signals within ± 1, so that both are scaled alike. Where signals oppose each
    other it is a complex number, here zero.
    """
    try:
        from vibromaf.metrics.stsim import st_sim
    except ImportError:
        return float("nan")
    scale = max(np.abs(commanded).max(), np.abs(felt).max())
    with np.errstate(divide="ignore"):
        scores = [st_sim(f / scale, c / scale) for f, c in zip(felt.T, commanded.T, strict=True)]
    return min(0.0 if isinstance(score, complex) else float(score) for score in scores)


def told(
    what: str, unit: str, limit: float, values: dict[str, float], *, least: bool = False
) -> Iterator[Figure]:
    """Yield the worst value with its goal, whose it is, and each one beyond the goal.

    With ``least`` the limit is to be reached, else not to be exceeded.
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
        yield from told(f"coherence_{side}", "", COHERENCE, worst)
    display = load_display("reference-24")
    for speed in SPEEDS:
        yield from _played_figures(library, display, speed)


def _statistics_figures(library: dict[str, Texture]) -> Iterator[Figure]:
    found: dict[str, Statistics] = {}
    for name, texture in library.items():
        if texture.descriptor.stochastic is not None:
            found[name] = statistics(texture, texture.descriptor.stochastic)
    kurtosis = {name: abs(s.kurtosis) for name, s in found.items()}
    depth = {name: abs(s.depth) for name, s in found.items()}
    level = {name: float(np.abs(s.level).max()) for name, s in found.items()}
    yield from told("kurtosis", "", KURTOSIS, kurtosis)
    yield from told("am_depth", "", DEPTH, depth)
    yield from told("level", "dB", LEVEL, level)
    errors = np.array([[s.kurtosis_error, s.depth_error] for s in found.values()])
    for what, error in zip(
        ("kurtosis", "am_depth"), np.sqrt(np.mean(errors**2, axis=0)), strict=True
    ):
        yield Figure(f"library.{what}.standard_error", float(error), "")


def _played_figures(
    library: dict[str, Texture], display: Display, speed: float
) -> Iterator[Figure]:
    """Yield how all are played at a speed; those that the drive's limit turns down, apart."""
    strokes = {name: played(texture, display, speed) for name, texture in library.items()}
    at = f"{speed * 1e3:g}_mm_s"
    whole = {name: stroke for name, stroke in strokes.items() if not stroke.limited}
    fidelity = {name: stroke.fidelity for name, stroke in whole.items()}
    yield from told(f"played.{at}.snr", "dB", FIDELITY, fidelity, least=True)
    like = {n: s.similarity for n, s in whole.items() if not np.isnan(s.similarity)}
    yield from told(f"played.{at}.st_sim", "", SIMILARITY, like, least=True)
    for name, stroke in strokes.items():
        if stroke.limited:
            yield Figure(f"library.played.{at}.limited.{name}", stroke.loss, "dB")
