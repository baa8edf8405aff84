"""Accuracy of the fits on data whose true constants are known: figures for the benchmarks.

The responses come from the model itself, with complex noise in proportion to the response added.
Whether the model is right is the subject of the tests, which fit results of finite elements.
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
"""Frequencies of the simulated measurements [Hz]."""
NOISE = 0.01
"""Standard deviation of the noise, in the real and the imaginary part each, relative to the
response."""
SPREAD = 0.5
"""Standard deviation of the logarithms of a random load about one of the paper's two (assumed)."""


def random_load(generator: np.random.Generator) -> FingerLoad:
    """Draw a load of one branch, log-normal about one of the paper's two.

    Parameters
    ----------
    generator : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    FingerLoad
        Random load.
    """
    middle = FingerLoad.low() if generator.integers(2) else FingerLoad.high()
    (k, d), *_ = middle.branches
    k0, d0, k1, d1 = np.array([middle.k0, middle.d0, k, d]) * np.exp(
        SPREAD * generator.standard_normal(4)
    )
    return FingerLoad(k0=k0, d0=d0, branches=((k1, d1),))


def load_fit_figures(count: int) -> dict[str, float]:
    """Compute how accurately loads are found.

    Parameters
    ----------
    count : int
        Number of noisy responses: one for each of the paper's two loads, the rest for random loads.

    Returns
    -------
    dict of str to float
        ``worst_db``: the largest error of a predicted response over 10 … 1000 Hz, with 1 % noise
        [dB]. ``clean_percent``: the largest error of a constant of the paper's two loads without
        noise [%]. ``covered_percent``: the share of 95 % intervals that hold the true value, with
        the number of branches given [%]. ``one_branch_percent``: how often the right number of
        branches, one, is chosen [%].
    """
    generator = np.random.default_rng(0)
    paper = [FingerLoad.low(), FingerLoad.high()]
    loads = [*paper, *(random_load(generator) for _ in range(count - len(paper)))]
    worst, correct = 0.0, 0
    covered: list[bool] = []
    for load in loads:
        truth = _response(load)
        noise = generator.standard_normal((2, len(FREQUENCY)))
        noisy = truth * (1 + NOISE * (noise[0] + 1j * noise[1]))
        fit, one_branch = _fit(noisy), _fit(noisy, branches=1)
        worst = max(worst, float(np.abs(decibel(fit.comparison.predicted / truth)).max()))
        correct += len(fit.load.branches) == 1
        covered += [
            c.low <= true <= c.high
            for c, true in zip(one_branch.constants, _constants(load), strict=True)
        ]
    clean = [
        abs(c.value / true - 1)
        for load in paper
        for c, true in zip(_fit(_response(load)).constants, _constants(load), strict=True)
    ]
    return {
        "worst_db": worst,
        "clean_percent": 100 * max(clean),
        "covered_percent": 100 * float(np.mean(covered)),
        "one_branch_percent": 100 * correct / len(loads),
    }


def _response(load: FingerLoad) -> Complex:
    """Return the displacement of a loaded tip per volt [m/V]."""
    return tip_response(Bimorph(), load, FREQUENCY).displacement


def _fit(value: Complex, branches: int | None = None) -> LoadFit:
    measured = Measurement("figures", "displacement", FREQUENCY, value)
    return fit_load(Bimorph(), measured, branches=branches)


def _constants(load: FingerLoad) -> list[float]:
    """Return the constants of a load in the order of a fit."""
    values = [load.k0, load.d0, *(value for branch in load.branches for value in branch)]
    return [float(value) for value in values]
