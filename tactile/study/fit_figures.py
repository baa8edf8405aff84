"""How well the fits find what is known: figures for the benchmarks.

Responses come from the model itself with noise added, complex and in proportion to the response.
That the model is right is for the tests, which fit what finite elements say.
"""

import numpy as np

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.arrays import Complex
from tactile.study.adjusted import decibel
from tactile.study.load_fit import LoadFit, fit_load
from tactile.study.measurement import Measurement

FREQUENCY = np.geomspace(10.0, 1000.0, 60)
NOISE = 0.01
SPREAD = 0.5
"""Standard deviation of the logarithms of a random load about one of the paper's two (assumed)."""


def random_load(generator: np.random.Generator) -> FingerLoad:
    """Return a load of one branch, log-normal about one of the paper's two."""
    middle = FingerLoad.low() if generator.integers(2) else FingerLoad.high()
    (k, d), *_ = middle.branches
    k0, d0, k1, d1 = np.array([middle.k0, middle.d0, k, d]) * np.exp(
        SPREAD * generator.standard_normal(4)
    )
    return FingerLoad(k0=k0, d0=d0, branches=((k1, d1),))


def load_fit_figures(count: int, seed: int = 0) -> dict[str, float]:
    """Return how well loads are found.

    Parameters
    ----------
    count : of noisy responses: one of each of the paper's loads, the rest of random loads
    seed : of loads and noise

    Returns
    -------
    dict
        "worst_db", the largest error of a predicted response over 10 … 1000 Hz, the noise being
        1 %; "clean_percent", the largest error of a constant of the paper's two loads without
        noise; "covered_percent", how many of the 95 % intervals hold the truth, the branches being
        told; "one_branch_percent", how often as many are chosen as there are.
    """
    generator = np.random.default_rng(seed)
    paper = [FingerLoad.low(), FingerLoad.high()]
    loads = [*paper, *(random_load(generator) for _ in range(count - len(paper)))]
    worst, chosen = 0.0, 0
    covered: list[bool] = []
    for load in loads:
        truth = _response(load)
        noise = generator.standard_normal((2, len(FREQUENCY)))
        noisy = truth * (1 + NOISE * (noise[0] + 1j * noise[1]))
        fit, told = _fit(noisy), _fit(noisy, branches=1)
        worst = max(worst, float(np.abs(decibel(fit.comparison.predicted / truth)).max()))
        chosen += len(fit.load.branches) == 1
        covered += [
            c.low <= true <= c.high for c, true in zip(told.constants, _flat(load), strict=True)
        ]
    clean = [
        abs(c.value / true - 1)
        for load in paper
        for c, true in zip(_fit(_response(load)).constants, _flat(load), strict=True)
    ]
    return {
        "worst_db": worst,
        "clean_percent": 100 * max(clean),
        "covered_percent": 100 * float(np.mean(covered)),
        "one_branch_percent": 100 * chosen / len(loads),
    }


def _response(load: FingerLoad) -> Complex:
    return tip_response(Bimorph(), load, FREQUENCY).displacement


def _fit(value: Complex, branches: int | None = None) -> LoadFit:
    measured = Measurement("figures", "displacement", FREQUENCY, value)
    return fit_load(Bimorph(), measured, branches=branches)


def _flat(load: FingerLoad) -> list[float]:
    values = [load.k0, load.d0, *(value for branch in load.branches for value in branch)]
    return [float(value) for value in values]
