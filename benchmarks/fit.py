"""Fitting: agreement of fitted textures with recordings that the fit has not seen.

Fabrics are fitted at two speeds and rendered at two others. Strokes of the length of a recording
are measured as it is: in third octaves over time, 40–800 Hz, by Welch's method with windows of 0.2
s, as acceleration. Levels of strokes under the 24 contactors and over twelve surfaces are averaged.

The recordings (BioTac slides of Gao et al. 2020, denim and corduroy of Fradin et al. 2023) state no
license and are not shipped. Their figures are measured if the recordings are in ``shared/data``
next to the project, or in the folder that TACTILE_DATA names. Speed is measured on a synthetic
slide.
"""

import os
import time
from collections.abc import Iterable, Iterator
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import welch

from benchmarks.rendering import SKIPPED
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most, not_measured
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import render
from tactile.texture import measures
from tactile.texture.descriptor import About, Descriptor, Events, Reference, Stochastic
from tactile.texture.descriptor_file import write
from tactile.texture.fitting import RecordingMeasures, describe, measure_slides
from tactile.texture.judging import fit_texture, predict, rendered_strokes
from tactile.texture.recorded_slide import Recorded, load_recorded
from tactile.texture.surface import Texture, load_texture

ABOUT = About(
    id="bench", category="test", description="", provenance="fitted", source="bench",
    license="CC0-1.0",
)  # fmt: skip
"""Description of the fitted textures."""
CLICKS = (0.2, 14.0, 0.5), (0.1, 20.0, 0.3), (0.05, 30.0, 0.4)
"""Density [1/mm²], median peak [µm] and spread of the logarithm of synthetic clicks. Strokes of
120 mm over them have a median excess kurtosis of about 10, as those over polypropylene have."""
BIOTAC_SPEED = 0.019
"""Speed of the slides [m/s]."""
BIOTAC_STEADY = slice(1320, 7920)
"""Samples of 0.6–3.6 s, in which the robot moves evenly."""
FULL_SCALE = 9.81 / 0.0938
"""Full scale of the accelerometer, 93.8 mV/g at 1 V [m/s²]."""
FABRICS = {"v1": 0.02, "v2": 0.03, "v3": 0.05, "v4": 0.06}
"""Speeds of the recorded fabrics, by name [m/s]."""
SLOW, FAST = ("v1", "v2"), ("v3", "v4")
"""Names of the recordings at 20 and 30 mm/s, and of those at 50 and 60 mm/s."""
THIRDS = 10 ** (np.arange(16, 30) / 10)
"""Centers of the third octaves in which rendered fabrics are compared, 40–800 Hz [Hz]."""
FABRIC_NAMES = ("denim", "corduroy")
"""Fabrics that were recorded."""
WINDOW = 0.2
"""Length of a window of Welch's method [s]."""
SURFACES = 12
"""Number of surfaces that each fabric is rendered over. One surface differs from another by 0.2 dB
in its mean level."""
ERROR, BIAS = 3.1, 1.5
"""Largest permitted mean absolute error, and mean error, over third octaves and strokes [dB]. The
levels of recordings scatter by 3 dB, which leaves 1.5 dB in the mean of four."""


def recordings() -> Path | None:
    """Return the folder of recordings, or None if there is none."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_DATA", beside))
    return folder if (folder / "biotac").is_dir() else None


def biotac_slides(folder: Path) -> dict[str, list[Recorded]]:
    """Return each material's slides."""
    with np.load(folder / "biotac" / "biotac.npz") as archive:
        signal, material = archive["signal"].astype(np.float64), archive["material"]
        rate = float(archive["sample_rate_hz"])
    return {
        str(name): [
            Recorded(
                name=f"{name} {k}", signal=signal[k, BIOTAC_STEADY], quantity="displacement",
                sample_rate=rate, speed=np.full(6600, BIOTAC_SPEED), calibrated=False,
            )
            for k in np.flatnonzero(material == name)
        ]
        for name in np.unique(material)
    }  # fmt: skip


def biotac(folder: Path) -> dict[str, RecordingMeasures]:
    """Return the measures of each material's slides."""
    return {name: measure_slides(slides) for name, slides in biotac_slides(folder).items()}


def halvings(count: int) -> Iterator[tuple[list[int], list[int]]]:
    """Yield every way to split a number of recordings into halves, each once and in reverse."""
    for one in combinations(range(count), count // 2):
        yield list(one), [k for k in range(count) if k not in one]


def fabric(folder: Path, name: str, key: str) -> Recorded:
    """Return the recording of denim or corduroy at a speed."""
    path = folder / "textsense" / f"{name}_{key}.wav"
    return load_recorded(path, full_scale=FULL_SCALE, speed=FABRICS[key])


def third_octave_levels(signal: Floats, rate: float) -> Floats:
    """Return the levels (14, ...) of a signal (S, ...) in the bands of `THIRDS` over time [dB].

    Bins on an edge of a band are shared.
    """
    frequency, density = welch(signal, rate, nperseg=round(WINDOW * rate), axis=0)
    low, high = (THIRDS[:, None] * 10**side for side in (-0.05, 0.05))
    half = 0.5 / WINDOW
    inside = np.minimum(frequency + half, high) - np.maximum(frequency - half, low)
    share = np.maximum(inside, 0) / (high - low)
    return np.asarray(10 * np.log10(np.tensordot(share, density, 1)))


def acceleration(shear: Floats) -> Floats:
    """Return the second derivative of shear (S, N), through its spectrum [m/s²]."""
    omega = 2 * np.pi * np.fft.rfftfreq(len(shear), 1 / RATE)
    return np.fft.irfft(-np.fft.rfft(shear, axis=0) * omega[:, None] ** 2, len(shear), axis=0)


def texture_of(descriptor: Descriptor) -> Texture:
    """Return a texture as a user gets it, through its file."""
    with TemporaryDirectory() as target:
        file = Path(target) / f"{ABOUT.id}.toml"
        write(descriptor, file)
        return load_texture(file)


def rendered_errors(
    folder: Path, name: str, seen: tuple[str, ...], unseen: tuple[str, ...]
) -> Floats:
    """Fit a fabric at some speeds, render it at others, and compare with recordings there.

    The texture goes through its file, as for a user.

    Parameters
    ----------
    folder : Path
        Folder of recordings.
    name : str
        Name of the fabric.
    seen, unseen : tuple of str
        Names of the recordings that are fitted and of those that are compared.

    Returns
    -------
    (V, 14) array of float
        Level of the strokes above that of each recording in the bands of `THIRDS` [dB].
    """
    fit = describe(measure_slides([fabric(folder, name, key) for key in seen]), ABOUT)
    texture = texture_of(fit.descriptor)
    display, errors = load_display("reference-24"), []
    for key in unseen:
        recorded, speed = fabric(folder, name, key), FABRICS[key]
        path = Trajectory.line(speed=speed, duration=recorded.duration + 2 * SKIPPED / RATE)
        strokes = [
            acceleration(render(display, texture, path, seed=seed).shear)[SKIPPED:-SKIPPED]
            for seed in range(SURFACES)
        ]
        levels = third_octave_levels(np.concatenate(strokes, axis=1), RATE).mean(axis=1)
        errors.append(levels - third_octave_levels(recorded.signal, recorded.sample_rate))
    return np.array(errors)


def measure_fit() -> Iterator[Figure]:
    """Measure speed, and if there are recordings distance, identification and prediction."""
    yield _speed()
    yield from _clicked()
    folder = recordings()
    if folder is None:
        reason = "needs recordings: set TACTILE_DATA to a folder with biotac and textsense"
        yield not_measured("fit.recordings", reason)
        return
    materials = biotac(folder)
    yield from _distances(materials)
    gratings = sum(bool(measured.gratings) for measured in materials.values())
    yield at_most("fit.biotac.with_gratings", gratings, "of 12", 0)
    yield from _identified(materials)
    yield from _predicted(folder)


def _speed() -> Figure:
    """Time the fit of one minute at 10 kHz: the slide of a random walk, with ribs."""
    rng = np.random.default_rng(0)
    count = 600_000
    place = 0.04 * np.arange(count) / 10e3
    signal = np.cumsum(rng.standard_normal(count)) * 1e-3
    signal += np.sin(2 * np.pi * place / 2.6e-3)
    slide = Recorded(
        name="minute", signal=signal, quantity="acceleration", sample_rate=10e3,
        speed=np.full(count, 0.04),
    )  # fmt: skip
    begun = time.perf_counter()
    fit_texture([slide], ABOUT)
    return at_most("fit.one_minute", time.perf_counter() - begun, "s", 5)


def _distances(materials: dict[str, RecordingMeasures]) -> Iterator[Figure]:
    """Yield the distances of fitted textures from the recordings of the other half."""
    verdicts = [
        predict(found.part(one), found.part(other), ABOUT)
        for found in materials.values()
        for one, other in list(halvings(len(found.slides)))[:2]
    ]
    for name in ("rendering", "ceiling", "autoregressive", "white"):
        sides = [getattr(v, name) for v in verdicts]
        rms = float(np.mean([s.rms_db for s in sides]))
        absolute = float(np.mean([s.absolute_db for s in sides]))
        if name == "rendering":
            yield at_most("fit.biotac.held_out", rms, "dB rms", 1.4)
            yield at_most("fit.biotac.held_out_absolute", absolute, "dB", 1.4)
        else:
            yield Figure(f"fit.biotac.{name}", rms, "dB rms")


def clicking(density: float, amplitude: float, spread: float) -> Texture:
    """Return a texture of noise that falls by 6 dB per octave of density, with clicks of 0.2 mm."""
    center = 10 ** (np.arange(-3, 15) / 10)
    stochastic = Stochastic(
        frequency_per_mm=tuple(center.tolist()), level_db=tuple((-20 * np.log10(center)).tolist())
    )
    event = Events(
        density_per_mm2=density, amplitude_um=amplitude, amplitude_sd=spread, width_mm=0.2
    )
    reference = Reference(speed_mm_s=40, normal_force_n=0.5)
    return texture_of(
        Descriptor(texture=ABOUT, reference=reference, stochastic=stochastic, events=(event,))
    )


def strokes_over(texture: Texture, surfaces: Iterable[int]) -> list[Recorded]:
    """Return strokes of 3 s at 40 mm/s under every fourth contactor, as recordings.

    Their direction does not come back to the same place of a tile of events.
    """
    path = Trajectory.line(speed=0.04, duration=3 + 2 * SKIPPED / RATE, angle=0.5)
    display, slides = load_display("reference-24"), []
    for seed in surfaces:
        shear = render(display, texture, path, seed=seed).shear[SKIPPED:-SKIPPED, ::4]
        slides += [
            Recorded(
                name=f"{seed}", signal=u.astype(np.float64), quantity="displacement",
                sample_rate=RATE, speed=np.full(len(u), 0.04),
            )
            for u in shear.T
        ]  # fmt: skip
    return slides


def _clicked() -> Iterator[Figure]:
    """Yield how the kurtosis of strokes over fitted clicks compares with that of the clicks."""
    ratios = []
    for kind in CLICKS:
        low, median, high = np.quantile(click_kurtosis(clicking(*kind)), [0.25, 0.5, 0.75], axis=1)
        ratios.append([median[1] / median[0], (high - low)[1] / (high - low)[0]])
    for name, ratio in zip(("median", "spread"), np.transpose(ratios), strict=True):
        error = float(np.mean(np.abs(np.log(ratio))))
        yield at_most(f"fit.clicks.kurtosis_{name}", float(np.expm1(error)), "relative", 0.3)


def click_kurtosis(texture: Texture) -> tuple[Floats, Floats]:
    """Return the excess kurtosis of strokes (R,) over a texture, and over one that is fitted."""
    slides = strokes_over(texture, (0, 1))
    measured = measure_slides(slides)
    fitted = texture_of(describe(measured, ABOUT).descriptor)
    center, step = measured.center[measured.core], 0.04 / RATE
    first, second = (
        np.array([
            measures.excess_kurtosis(slide.signal, step, center=center)
            for slide in strokes_over(one, range(2, 12))
        ])
        for one in (texture, fitted)
    )  # fmt: skip
    return first, second


def _identified(materials: dict[str, RecordingMeasures]) -> Iterator[Figure]:
    """Yield how many of 12 materials are identified by their bands, by recordings and textures.

    The textures are fitted to one half of the recordings. The nearest mean (least rms over bands)
    of the other half's recordings is taken.
    """
    real, rendered = [], []
    for turn in (0, 1):
        known = np.array([m.level[1 - turn :: 2, m.core].mean(axis=0) for m in materials.values()])
        for k, found in enumerate(materials.values()):
            seen = found.part(range(len(found.slides))[turn::2])
            real += [_nearest(level, known) == k for level in seen.level[:, seen.core]]
            rendered += [_nearest(level, known) == k for level in _strokes(seen)]
    yield Figure("fit.biotac.identified_recordings", float(np.mean(real)), "of 12")
    share = float(np.mean(rendered) / np.mean(real))
    yield Figure("fit.biotac.identified_textures", float(np.mean(rendered)), "of 12")
    yield at_least("fit.biotac.identified_share", share, "of recordings'", 0.95)


def _nearest(level: Floats, known: Floats) -> int:
    """Return the index of the nearest mean."""
    return int(np.argmin(np.mean((known - level) ** 2, axis=1)))


def _strokes(seen: RecordingMeasures) -> list[Floats]:
    """Return the levels of strokes of a recording's length, at the level of the recordings.

    The strokes are rendered over the fitted texture. Uncalibrated textures are shifted to an
    assumed level, which is removed again.
    """
    stochastic = describe(seen, ABOUT).descriptor.stochastic
    assert stochastic is not None
    center = seen.center[seen.core]
    anchor = np.mean((np.asarray(stochastic.level_db) - seen.level.mean(axis=0))[seen.core])
    strokes, step = rendered_strokes(stochastic, center)
    size = len(seen.slides[0].bare[0])
    return [measures.band_spectrum(u[:size], step, center=center) - anchor for u in strokes]


def _predicted(folder: Path) -> Iterator[Figure]:
    """Fit fabrics at two speeds, and render them at the two others, faster and slower."""
    for way, seen, unseen in (("faster", SLOW, FAST), ("slower", FAST, SLOW)):
        error = np.stack([rendered_errors(folder, name, seen, unseen) for name in FABRIC_NAMES])
        for name, rows in zip(FABRIC_NAMES, error, strict=True):
            for key, row in zip(unseen, rows, strict=True):
                label = f"fit.{name}.rendered_at_{FABRICS[key] * 1e3:g}_mm_s"
                yield Figure(label, float(np.abs(row).mean()), "dB")
        yield from _errors(f"fit.fabrics.{way}", error)
        best = np.mean([least_error(rows, seen, unseen) for rows in error])
        yield Figure(f"fit.fabrics.{way}.best_law", float(best), "dB")


def least_error(error: Floats, seen: tuple[str, ...], unseen: tuple[str, ...]) -> float:
    """Return the mean absolute error with the best law of speed, chosen in hindsight.

    A law of speed with another exponent shifts all bands of a speed, by as much as that speed is
    from the fitted ones.

    Parameters
    ----------
    error : (V, 14) array of float
        Errors as `rendered_errors` returns them.
    seen, unseen : tuple of str
        Names of the recordings that were fitted and of those that were compared.

    Returns
    -------
    float
        Smallest mean absolute error that any exponent gives [dB].
    """
    fitted = np.mean([np.log10(FABRICS[key]) for key in seen])
    shift = 20 * (np.log10([FABRICS[key] for key in unseen]) - fitted)[:, None]
    return min(
        float(np.abs(error + exponent * shift).mean()) for exponent in np.linspace(-2, 2, 801)
    )


def _errors(name: str, error: Floats) -> Iterator[Figure]:
    """Yield mean absolute, mean and rms error, the first two with their goals."""
    absolute, bias = float(np.abs(error).mean()), float(error.mean())
    yield at_most(f"{name}.absolute", absolute, "dB", ERROR)
    yield at_most(f"{name}.bias", abs(bias), "dB", BIAS)
    yield Figure(f"{name}.rms", float(np.sqrt(np.mean(error**2))), "dB")
