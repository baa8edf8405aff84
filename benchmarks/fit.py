"""Fitting: agreement of fitted textures with recordings that the fit has not seen.

The recordings (BioTac slides of Gao et al. 2020, denim and corduroy of Fradin et al. 2023) state no
license and are not shipped. Their figures are measured if the recordings are in ``shared/data``
next to the project, or in the folder that TACTILE_DATA names. Speed is measured on a synthetic
slide.
"""

import os
import time
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_least, at_most, not_measured
from tactile.texture import measures
from tactile.texture.descriptor import About
from tactile.texture.fitting import RecordingMeasures, describe, measure_slides
from tactile.texture.judging import fit_texture, predict, rendered_strokes
from tactile.texture.recorded_slide import Recorded, load_recorded

ABOUT = About(
    id="bench", category="test", description="", provenance="fitted", source="bench",
    license="CC0-1.0",
)  # fmt: skip
"""Description of the fitted textures."""
BIOTAC_SPEED = 0.019
"""Speed of the slides [m/s]."""
BIOTAC_STEADY = slice(1320, 7920)
"""Samples of 0.6–3.6 s, in which the robot moves evenly."""
FULL_SCALE = 9.81 / 0.0938
"""Full scale of the accelerometer, 93.8 mV/g at 1 V [m/s²]."""
FABRICS = {"v1": 0.02, "v2": 0.03, "v3": 0.05, "v4": 0.06}
"""Speeds of the recorded fabrics, by name [m/s]."""


def recordings() -> Path | None:
    """Return the folder of recordings, or None if there is none."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_DATA", beside))
    return folder if (folder / "biotac").is_dir() else None


def biotac(folder: Path) -> dict[str, RecordingMeasures]:
    """Return the measures of each material's slides."""
    with np.load(folder / "biotac" / "biotac.npz") as archive:
        signal, material = archive["signal"].astype(np.float64), archive["material"]
        rate = float(archive["sample_rate_hz"])
    measured = {}
    for name in np.unique(material):
        slides = [
            Recorded(
                name=f"{name} {k}", signal=signal[k, BIOTAC_STEADY], quantity="displacement",
                sample_rate=rate, speed=np.full(6600, BIOTAC_SPEED), calibrated=False,
            )
            for k in np.flatnonzero(material == name)
        ]  # fmt: skip
        measured[str(name)] = measure_slides(slides)
    return measured


def halvings(count: int) -> Iterator[tuple[list[int], list[int]]]:
    """Yield every way to split a number of recordings into halves, each once and in reverse."""
    for one in combinations(range(count), count // 2):
        yield list(one), [k for k in range(count) if k not in one]


def fabric(folder: Path, name: str, speeds: tuple[str, ...], reference: float) -> RecordingMeasures:
    """Return the measures of denim or corduroy at some speeds."""
    slides = [
        load_recorded(
            folder / "textsense" / f"{name}_{key}.wav", full_scale=FULL_SCALE, speed=FABRICS[key]
        )
        for key in speeds
    ]
    return measure_slides(slides, reference_speed=reference)


def measure_fit() -> Iterator[Figure]:
    """Measure speed, and if there are recordings distance, identification and prediction."""
    yield _speed()
    folder = recordings()
    if folder is None:
        reason = "needs recordings: set TACTILE_DATA to a folder with biotac and textsense"
        yield not_measured("fit.recordings", reason)
        return
    materials = biotac(folder)
    yield from _distances(materials)
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


def _identified(materials: dict[str, RecordingMeasures]) -> Iterator[Figure]:
    """Yield how many of 12 materials are identified by their bands, by recordings and textures.

    The textures are fitted to one half of the recordings. The nearest mean (least rms over bands)
    of the other half's recordings is taken.
    """
    real, rendered = [], []
    for turn in (0, 1):
        known = np.array([m.level[1 - turn :: 2].mean(axis=0) for m in materials.values()])
        for k, found in enumerate(materials.values()):
            seen = found.part(range(len(found.slides))[turn::2])
            real += [_nearest(level, known) == k for level in seen.level]
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
    anchor = np.mean(np.asarray(stochastic.level_db) - seen.level.mean(axis=0))
    strokes, step = rendered_strokes(stochastic, seen.center)
    size = len(seen.slides[0].bare[0])
    return [measures.band_spectrum(u[:size], step, center=seen.center) - anchor for u in strokes]


def _predicted(folder: Path) -> Iterator[Figure]:
    """Fit fabrics at 20 and 30 mm/s, and predict their recordings at 50 and 60 mm/s."""
    sides = []
    for name in ("denim", "corduroy"):
        reference = float(np.sqrt(FABRICS["v1"] * FABRICS["v2"]))
        whole = fabric(folder, name, tuple(FABRICS), reference)
        for k in (2, 3):
            side = predict(whole.part([0, 1]), whole.part([k]), ABOUT).rendering
            yield Figure(f"fit.{name}.{list(FABRICS.values())[k] * 1e3:g}_mm_s", side.rms_db, "dB")
            sides.append(side)
        yield Figure(f"fit.{name}.lines", float(len(whole.gratings)), "")
    absolute, rms, bias = (
        float(np.mean([getattr(s, k) for s in sides])) for k in ("absolute_db", "rms_db", "bias_db")
    )
    yield at_most("fit.fabrics.predicted_absolute", absolute, "dB", 3.3)
    yield at_most("fit.fabrics.predicted_rms", rms, "dB", 3.3)
    yield at_most("fit.fabrics.predicted_bias", abs(bias), "dB", 1.0)
