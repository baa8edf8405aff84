"""Judgments of strokes: told from recordings or not, identified or not, how far away.

What is averaged is grouped: windows by recording and speed, strokes by material. The groups are
resampled for the intervals of 95 %.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.fit import FABRIC_NAMES, FABRICS, fabric
from benchmarks.realism.entrants import Entrant
from benchmarks.realism.features import FABRIC, SKIN, WHOLE, Families
from tactile.arrays import Floats
from tactile.texture.recorded_slide import Recorded

TREES = 100
"""Number of trees of a classifier."""
SURFACES = 4
"""Number of strokes, each over another surface, for each recording of a fabric."""
STROKES = 6
"""Number of strokes for each half of the recordings under a BioTac."""
RESAMPLED = 2000
"""Number of times that groups are resampled for an interval."""
FAMILIES = ("fine", "thirds", "distribution", "modulation", "across", "level")
"""Families of features, by which strokes of fabrics are told from recordings."""
EVERYTHING = {"all": FAMILIES, "all_but_spectrum": FAMILIES[2:]}
"""Families that are judged together, by the name of the figure."""
IDENTIFYING = ("level", "thirds", "distribution", "modulation", "across")
"""Families by which materials are identified."""


@dataclass(frozen=True)
class Mean:
    """Mean over groups, with an interval of 95 %."""

    value: float
    low: float
    high: float


def mean_of(
    groups: Sequence[float] | Floats, weights: Sequence[float] | Floats | None = None
) -> Mean:
    """Return the mean over groups, weighted if so wished, and resample them for the interval."""
    values = np.asarray(groups, dtype=np.float64)
    weight = np.ones(len(values)) if weights is None else np.asarray(weights, dtype=np.float64)
    draw = np.random.default_rng(0).integers(len(values), size=(RESAMPLED, len(values)))
    means = (values * weight)[draw].sum(axis=1) / weight[draw].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Mean(float(np.average(values, weights=weight)), float(low), float(high))


def area_under_curve(positive: Floats, negative: Floats) -> float:
    """Return the share of pairs in which the positive one has the larger score (ties: half)."""
    above = positive[:, None] - negative
    return float(np.mean((above > 0) + 0.5 * (above == 0)))


def either_way(area: Floats) -> Floats:
    """Return how well windows are told apart (...) if a classifier may mistake each for the other.

    A classifier that takes nearly all recordings for made strokes has an area near 0, and tells
    them apart as well as one with an area near 1. The mean of both would be that of chance.
    """
    return np.maximum(area, 1 - area)


class Classifier(Protocol):
    """Trained classifier of scikit-learn."""

    def predict_proba(self, features: Floats) -> Floats:
        """Return the probabilities (W, C) of each class, for features (W, F)."""
        ...


def trees(features: Floats, label: NDArray[np.intp]) -> Classifier:
    """Return extremely randomized trees that are trained on features (W, F) with labels (W,)."""
    from sklearn.ensemble import ExtraTreesClassifier  # The import takes a second.

    forest = ExtraTreesClassifier(
        TREES, min_samples_leaf=2, class_weight="balanced", random_state=0
    )
    fitted: Classifier = forest.fit(features, label)
    return fitted


# Fabrics: real or made?


@dataclass(frozen=True)
class Fold:
    """Windows of one fabric, of which one speed is left out of training.

    Attributes
    ----------
    seen, made : (W, F) by family
        Windows of the recordings at the other speeds, and of strokes there.
    unseen, test : (W, F) by family
        Windows of the recording that is left out, and of strokes at its speed.
    """

    seen: Families
    made: Families
    unseen: Families
    test: Families

    def area(self, families: Sequence[str]) -> float:
        """Return how well trees tell made windows from real ones at the speed that is left out.

        Parameters
        ----------
        families : sequence of str
            Families of features that the trees are given.

        Returns
        -------
        float
            Area under the curve of true against false alarms: 0.5 is chance.
        """
        real, made, unseen, test = (
            np.hstack([windows[family] for family in families])
            for windows in (self.seen, self.made, self.unseen, self.test)
        )
        label = np.repeat([0, 1], [len(real), len(made)])
        forest = trees(np.concatenate([real, made]), label)
        scores = [forest.predict_proba(windows)[:, 1] for windows in (test, unseen)]
        return area_under_curve(*scores)


Source = Callable[[dict[str, Recorded], str], list[Recorded]]
"""Choice of the recordings by name from which strokes at the speed of one of them are made."""


def nearest_speeds(recordings: dict[str, Recorded], key: str, count: int = 2) -> list[Recorded]:
    """Return the recordings at the other speeds that are nearest to that of a name."""
    others = [other for other in recordings if other != key]
    others.sort(key=lambda other: abs(np.log(FABRICS[other] / FABRICS[key])))
    return [recordings[other] for other in others[:count]]


def one_speed(recordings: dict[str, Recorded], key: str) -> list[Recorded]:
    """Return the recording at the one other speed that is nearest to that of a name."""
    return nearest_speeds(recordings, key, 1)


def own_speed(recordings: dict[str, Recorded], key: str) -> list[Recorded]:
    """Return the recording of a name: nothing about another speed is to be predicted."""
    return [recordings[key]]


def folds_of(
    folder: Path, name: str, entrant: Entrant, rng: Generator, source: Source = nearest_speeds
) -> Iterator[Fold]:
    """Yield the windows of a fabric, with one speed after another left out.

    Strokes are made from the recordings that ``source`` chooses. Those for training are not made
    from the recording that is left out, which would make that one look like them.
    """
    recordings = {key: fabric(folder, name, key) for key in FABRICS}
    real = {key: unit_features(recorded) for key, recorded in recordings.items()}

    def strokes_at(key: str, left: str) -> Families:
        usable = {k: r for k, r in recordings.items() if k == key or k != left}
        train, duration = source(usable, key), recordings[key].duration
        strokes = entrant.strokes(train, FABRICS[key], duration, SURFACES, rng)
        return together([unit_features(stroke) for stroke in strokes])

    for left in FABRICS:
        others = [key for key in FABRICS if key != left]
        yield Fold(
            seen=together([real[key] for key in others]),
            made=together([strokes_at(key, left) for key in others]),
            unseen=real[left],
            test=strokes_at(left, left),
        )


def together(strokes: Sequence[Families]) -> Families:
    """Return the windows of several strokes as one."""
    return {family: np.concatenate([s[family] for s in strokes]) for family in strokes[0]}


def unit_features(stroke: Recorded) -> Families:
    """Return the features of a stroke of a fabric, at an rms of 1."""
    signal = FABRIC.signal(stroke)
    return FABRIC.features(signal / signal.std())


def strokes_over_fabrics(
    folder: Path, entrant: Entrant, rng: Generator
) -> Iterator[list[Recorded]]:
    """Yield strokes over each fabric at each speed, made from recordings at two other speeds."""
    for name in FABRIC_NAMES:
        recordings = {key: fabric(folder, name, key) for key in FABRICS}
        for key, recorded in recordings.items():
            train = nearest_speeds(recordings, key)
            yield entrant.strokes(train, FABRICS[key], recorded.duration, SURFACES, rng)


def roughness(folder: Path, entrant: Entrant, rng: Generator) -> Floats:
    """Return how rough the spectra of strokes over fabrics are, (G, 2) array [dB].

    The standard deviation of the periodogram within third octaves is averaged over bands, of
    windows and of whole strokes, for each fabric and speed.
    """
    return np.array(
        [
            np.mean([stroke_roughness(stroke) for stroke in strokes], axis=0)
            for strokes in strokes_over_fabrics(folder, entrant, rng)
        ]
    )


def drift(folder: Path, entrant: Entrant, rng: Generator) -> Floats:
    """Return how the level drifts along strokes over fabrics, (G,) array [dB].

    The standard deviation of the level over the windows of a stroke is averaged over the strokes of
    each fabric and speed.
    """
    return np.array(
        [
            np.mean([unit_features(stroke)["level"].std(ddof=1) for stroke in strokes])
            for strokes in strokes_over_fabrics(folder, entrant, rng)
        ]
    )


def stroke_roughness(stroke: Recorded) -> tuple[float, float]:
    """Return the roughness of a stroke over a fabric: of its windows, and as a whole [dB]."""
    signal = FABRIC.signal(stroke)
    parts = FABRIC.windows(signal), signal[None]
    short, whole = (float(FABRIC.roughness(part).mean()) for part in parts)
    return short, whole


# Slides of a BioTac: how far away, and identified or not?


class Split:
    """Random halves of the recordings of materials, of which one is held out to judge by.

    Parameters
    ----------
    materials : dict of list of Recorded
        Recordings of 3 s by material.
    rng : numpy.random.Generator
        Source of random numbers.
    """

    def __init__(self, materials: dict[str, list[Recorded]], rng: Generator) -> None:
        self.train: list[list[Recorded]] = []
        held_out: list[list[Recorded]] = []
        for recordings in materials.values():
            mixed = [recordings[k] for k in rng.permutation(len(recordings))]
            half = len(mixed) // 2
            self.train.append(mixed[:half])
            held_out.append(mixed[half:])
        self._whole = [whole_features(side) for side in held_out]
        known = [np.concatenate([windows_of(r) for r in side]) for side in held_out]
        label = np.repeat(np.arange(len(known)), [len(windows) for windows in known])
        self._forest = trees(np.concatenate(known), label)

    def strokes(self, entrant: Entrant, rng: Generator) -> list[list[Recorded]]:
        """Return strokes over each material, at the speed and of the length of a recording."""
        return [
            entrant.strokes(side, float(side[0].speed.mean()), side[0].duration, STROKES, rng)
            for side in self.train
        ]

    def distances(self, strokes: list[list[Recorded]]) -> Floats:
        """Compute the distances of strokes from the recordings that were held out.

        Parameters
        ----------
        strokes : list of list of Recorded
            Strokes over each material.

        Returns
        -------
        (M, 3) array of float
            Rms difference over third octaves from the mean level of those held out: of one stroke,
            and of the mean of strokes; mean absolute difference of the modulation spectra in
            octaves of 1–64 Hz, which are averaged over strokes and octaves of vibration [dB].
        """
        rows = []
        for side, real in zip(strokes, self._whole, strict=True):
            made = whole_features(side)
            error = levels(made) - levels(real).mean(axis=0)
            one_stroke = np.sqrt(np.mean(error**2, axis=1)).mean()
            mean_of_strokes = np.sqrt(np.mean(error.mean(axis=0) ** 2))
            modulation = np.abs(mean_modulation(made) - mean_modulation(real)).mean()
            rows.append((one_stroke, mean_of_strokes, modulation))
        return np.array(rows)

    def identified(self, strokes: list[list[Recorded]]) -> Floats:
        """Compute the shares (M,) of strokes over each material that are identified.

        Trees are trained on windows of the recordings that were held out. What they expect of the
        windows of a stroke is averaged.
        """
        shares = []
        for k, side in enumerate(strokes):
            parts = [windows_of(stroke) for stroke in side]
            scores = self._forest.predict_proba(np.concatenate(parts))
            expected = scores.reshape(len(parts), -1, len(strokes)).mean(axis=1)
            shares.append(np.mean(expected.argmax(axis=1) == k))
        return np.array(shares)


def whole_features(strokes: Sequence[Recorded]) -> Families:
    """Return the features of strokes of 3 s, each as one window."""
    return together([WHOLE.features(WHOLE.signal(stroke)) for stroke in strokes])


def levels(windows: Families) -> Floats:
    """Return the levels (W, K) of third octaves [dB]."""
    return windows["level"] + windows["thirds"]


def mean_modulation(windows: Families) -> Floats:
    """Return the modulation spectrum (M,), averaged over windows and octaves [dB]."""
    return np.asarray(windows["modulation"].reshape(-1, len(WHOLE.modulations)).mean(axis=0))


def windows_of(stroke: Recorded) -> Floats:
    """Return the features (W, F) by which materials are identified."""
    windows = SKIN.features(SKIN.signal(stroke))
    return np.hstack([windows[family] for family in IDENTIFYING])
