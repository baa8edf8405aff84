"""Judgments of strokes: told from recordings or not, identified or not, how far away.

What is averaged is grouped: windows by recording and speed, strokes by material. The groups are
resampled for the intervals of 95 %.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.fit import FABRIC_NAMES, FABRICS, fabric
from benchmarks.realism.entrants import Entrant
from benchmarks.realism.features import FABRIC, SKIN, Families
from tactile.arrays import Floats
from tactile.texture.recorded_slide import Recorded

TREES = 200
"""Number of trees of a classifier."""
SURFACES = 4
"""Number of strokes, each over another surface, for each recording of a fabric."""
RESAMPLED = 2000
"""Number of times that groups are resampled for an interval."""
FAMILIES = ("fine", "thirds", "distribution", "modulation", "across", "level")
"""Families of features, by which strokes of fabrics are told from recordings."""
EVERYTHING = {"all": FAMILIES, "all_but_spectrum": FAMILIES[2:]}
"""Families that are judged together, by the name of the figure."""


@dataclass(frozen=True)
class Mean:
    """Mean over groups, with an interval of 95 %."""

    value: float
    low: float
    high: float


def mean_of(groups: Sequence[float] | Floats, weights: Sequence[float] | Floats, rng: Generator
) -> Mean:
    """Return the weighted mean over groups, which are resampled for the interval."""
    values, weight = np.asarray(groups, float), np.asarray(weights, float)
    draw = rng.integers(len(values), size=(RESAMPLED, len(values)))
    means = (values * weight)[draw].sum(axis=1) / weight[draw].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Mean(float(np.average(values, weights=weight)), float(low), float(high))


def ratio_of(upper: Floats, lower: Floats, rng: Generator) -> Mean:
    """Return the ratio of two means over the same groups, which are resampled together."""
    draw = rng.integers(len(upper), size=(RESAMPLED, len(upper)))
    low, high = np.quantile(upper[draw].sum(axis=1) / lower[draw].sum(axis=1), [0.025, 0.975])
    return Mean(float(upper.sum() / lower.sum()), float(low), float(high))


def area_under_curve(positive: Floats, negative: Floats) -> float:
    """Return the share of pairs in which the positive one has the larger score (ties: half)."""
    above = positive[:, None] - negative
    return float(np.mean((above > 0) + 0.5 * (above == 0)))


def trees(x: Floats, y: NDArray[np.intp], seed: int = 0):  # type: ignore[no-untyped-def]
    """Return extremely randomized trees that are trained on features (W, F) and labels (W,)."""
    from sklearn.ensemble import ExtraTreesClassifier  # The import takes a second.

    forest = ExtraTreesClassifier(
        TREES, min_samples_leaf=2, class_weight="balanced", random_state=seed
    )
    return forest.fit(x, y)


# Fabrics: real or made?


@dataclass(frozen=True)
class Fold:
    """Windows of one fabric, of which one speed is left out of training.

    Attributes
    ----------
    fabric, speed : str
        Names of the fabric and of the speed that is left out.
    seen, made : list of (W, F) by family
        Windows of the recordings at the other speeds, and of strokes there.
    unseen, test : (W, F) by family
        Windows of the recording that is left out, and of strokes at its speed.
    """

    fabric: str
    speed: str
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


def folds_of(folder: Path, name: str, entrant: Entrant, rng: Generator) -> Iterator[Fold]:
    """Yield the windows of a fabric, with one speed after another left out.

    Strokes are made from recordings at the two other speeds that are nearest. Those for training
    are not made from the recording that is left out, which would make that one look like them.
    """
    recordings = {key: fabric(folder, name, key) for key in FABRICS}
    real = {key: [unit_features(recorded)] for key, recorded in recordings.items()}

    def strokes_at(key: str, others: set[str]) -> list[Families]:
        near = sorted(others, key=lambda other: abs(np.log(FABRICS[other] / FABRICS[key])))[:2]
        train, duration = [recordings[other] for other in near], recordings[key].duration
        strokes = entrant.strokes(train, FABRICS[key], duration, SURFACES, rng)
        return [unit_features(stroke) for stroke in strokes]

    for left in FABRICS:
        others = set(FABRICS) - {left}
        made = [strokes_at(key, others - {key}) for key in sorted(others)]
        yield Fold(
            fabric=name, speed=left,
            seen=together(sum((real[key] for key in sorted(others)), [])),
            made=together(sum(made, [])),
            unseen=together(real[left]),
            test=together(strokes_at(left, others)),
        )  # fmt: skip


def together(strokes: Sequence[Families]) -> Families:
    """Return the windows of several strokes as one."""
    return {family: np.concatenate([s[family] for s in strokes]) for family in strokes[0]}


def unit_features(stroke: Recorded) -> Families:
    """Return the features of a stroke of a fabric, at an rms of 1."""
    signal = FABRIC.signal(stroke)
    return FABRIC.features(signal / signal.std())
