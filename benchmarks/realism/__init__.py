"""Realism: whether strokes are told from recordings, and identified as what was recorded.

Entrants make strokes from recordings (`entrants`): the renderer from a texture that it fits, and
models to compare it with. Judgments compare the strokes with other recordings (`judgments`), by
features that share no band with a fit (`features`).

Fabrics are true waveforms, so that a classifier may see everything in them. The waveforms of the
BioTac are not, whose sign was lost and restored: spectra and statistics are compared, and
classifiers only identify materials.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.fit import FABRIC_NAMES, biotac, recordings
from benchmarks.realism.entrants import ENTRANTS, Entrant
from benchmarks.realism.judgments import (
    EVERYTHING,
    FAMILIES,
    Mean,
    Source,
    Split,
    drift,
    either_way,
    folds_of,
    mean_of,
    nearest_speeds,
    one_speed,
    own_speed,
    roughness,
)
from tactile.arrays import Floats
from tactile.bench.figures import Figure, not_measured

SPLITS = 3
"""Number of random splits of the recordings of each material into halves."""
IN_DETAIL = ("rendered", "replayed")
"""Entrants that are judged by each family of features alone."""
DISTANCES = ("one_stroke", "mean_of_strokes", "modulation")
"""Names of the distances from recordings held out."""


def measure_realism() -> Iterator[Figure]:
    """Judge all entrants, if there are recordings."""
    folder = recordings()
    if folder is None:
        reason = "needs recordings: set TACTILE_DATA to a folder with biotac and textsense"
        yield not_measured("realism.recordings", reason)
        return
    yield from _discriminated(folder)
    yield from _rough(folder)
    yield from _biotac(folder)


def _discriminated(folder: Path) -> Iterator[Figure]:
    """Yield how well strokes over fabrics are told from recordings, by families of features.

    The renderer is also judged with other recordings to fit, so that what it does to a spectrum is
    seen apart from what the recordings tell of another speed.
    """
    for name, entrant in ENTRANTS.items():
        alone = {family: (family,) for family in FAMILIES} if name in IN_DETAIL else {}
        yield from _areas(folder, name, entrant, EVERYTHING | alone, nearest_speeds)
    for source in (one_speed, own_speed):
        name = f"rendered.{source.__name__}"
        yield from _areas(folder, name, ENTRANTS["rendered"], {"all": FAMILIES}, source)


def _areas(
    folder: Path, name: str, entrant: Entrant, judged: dict[str, tuple[str, ...]], source: Source
) -> Iterator[Figure]:
    """Yield the areas under the curve of an entrant, by the label of the families judged."""
    rng = np.random.default_rng(0)
    folds = [fold for f in FABRIC_NAMES for fold in folds_of(folder, f, entrant, rng, source)]
    weights = [len(fold.unseen["level"]) for fold in folds]
    for label, families in judged.items():
        area = np.array([fold.area(families) for fold in folds])
        yield from _with_interval(f"realism.fabrics.{name}.{label}", mean_of(area, weights), "AUC")
        if label == "all":
            mean = mean_of(either_way(area), weights)
            yield from _with_interval(f"realism.fabrics.{name}.either_way", mean, "AUC")


def _rough(folder: Path) -> Iterator[Figure]:
    """Yield roughness of spectra and drift of level: of renderer, recordings and Gaussian noise."""
    rng = np.random.default_rng(0)
    for name in ("rendered", "replayed", "ar16"):
        groups = roughness(folder, ENTRANTS[name], rng)
        for length, values in zip(("windows", "strokes"), groups.T, strict=True):
            yield from _with_interval(f"realism.roughness.{name}.{length}", mean_of(values), "dB")
        drifting = mean_of(drift(folder, ENTRANTS[name], rng))
        yield from _with_interval(f"realism.drift.{name}", drifting, "dB")


def _biotac(folder: Path) -> Iterator[Figure]:
    """Yield distances from recordings held out, and shares of materials that are identified."""
    materials = {
        name: [slide.recorded for slide in measured.slides]
        for name, measured in biotac(folder).items()
    }
    rng = np.random.default_rng(0)
    splits = [Split(materials, rng) for _ in range(SPLITS)]
    shares: dict[str, Floats] = {}
    for name, entrant in ENTRANTS.items():
        strokes = [one.strokes(entrant, rng) for one in splits]
        distant = [one.distances(made) for one, made in zip(splits, strokes, strict=True)]
        for label, values in zip(DISTANCES, np.mean(distant, axis=0).T, strict=True):
            yield from _with_interval(f"realism.biotac.{name}.{label}", mean_of(values), "dB")
        identified = [one.identified(made) for one, made in zip(splits, strokes, strict=True)]
        shares[name] = np.mean(identified, axis=0)
        yield Figure(f"realism.biotac.{name}.identified", float(shares[name].mean()), "of 12")
    for name, share in shares.items():
        if name != "replayed":
            real = np.maximum(shares["replayed"], 1e-9)
            mean = mean_of(share / real, real)
            yield from _with_interval(f"realism.biotac.{name}.share", mean, "of recordings'")


def _with_interval(name: str, mean: Mean, unit: str) -> Iterator[Figure]:
    """Yield a mean and the ends of its interval."""
    yield Figure(name, mean.value, unit)
    yield Figure(f"{name}.low", mean.low, unit)
    yield Figure(f"{name}.high", mean.high, unit)
