"""Scenarios that a design has to meet: many fingers, and benders with manufacturing tolerances.

A scenario is one finger and one set of tolerances. Fingers are log-normal around the paper's two:
a normally distributed `firmness` of mean 1/2 and standard deviation 1/2 puts the low and the high
finger one standard deviation to either side (assumed: two fingers are all that is published).
Tolerances are normally distributed factors, truncated at three standard deviations. Scenarios are
drawn from scrambled Sobol points, so that a few dozen already represent the distribution, and all
designs are judged in the same scenarios.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.files import nearest
from tactile.study.parameters import PARAMETERS

FIRMNESS = (0.5, 0.5)
"""Mean and standard deviation of the fingers' firmness; see the module's docstring."""
TOLERANCES = {
    "piezo_height_mm": 0.02,
    "shim_height_mm": 0.03,
    "piezo_modulus_gpa": 0.03,
    "shim_modulus_gpa": 0.05,
    "d31_pm_per_v": 0.05,
    "eps33t_relative": 0.07,
}
"""Relative standard deviations of heights, moduli, d31 and eps33T.

These are assumed. Data sheets of ceramics give limits of 10 to 20 % for d31 and eps33T and of about
5 to 10 % for compliance; the limits are taken for three standard deviations. The heights are those
of lapped plates and prepreg.
"""
MOST = 2**20
"""Largest number of scenarios."""
LIMIT = 3.0
"""Number of standard deviations beyond which parts are sorted out."""


@dataclass(frozen=True, kw_only=True)
class Scenarios:
    """Values and factors of parameters, with one entry for each scenario.

    Attributes
    ----------
    values : mapping of str to (S,) array of float
        Values by parameter, in the unit that the parameter's name ends in.
    factors : mapping of str to (S,) array of float
        Factors by parameter, by which a design's own value is multiplied.

    Raises
    ------
    InputError
        If there is no scenario, the lengths differ, or a parameter is unknown.
    """

    values: Mapping[str, Floats] = field(default_factory=dict)
    factors: Mapping[str, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in (*self.values, *self.factors):
            if name not in PARAMETERS:
                raise InputError(f"no parameter {name!r}; {nearest(name, list(PARAMETERS))}")
        lengths = {np.size(array) for array in (*self.values.values(), *self.factors.values())}
        if len(lengths) != 1 or lengths == {0}:
            raise InputError(
                f"scenarios: lengths {sorted(lengths)}: must be one length of at least 1"
            )

    @property
    def count(self) -> int:
        """Number of scenarios."""
        return next(np.size(a) for a in (*self.values.values(), *self.factors.values()))


def draw_scenarios(
    count: int,
    *,
    firmness: tuple[float, float] = FIRMNESS,
    tolerances: Mapping[str, float] = TOLERANCES,
    seed: int = 0,
) -> Scenarios:
    """Draw fingers and tolerances.

    Parameters
    ----------
    count : int
        Number of scenarios, at least 1. A power of two covers the distribution most evenly.
    firmness : (float, float)
        Mean and standard deviation of the finger's firmness.
    tolerances : mapping of str to float
        Relative standard deviation by parameter, 0 to 0.3.
    seed : int
        Seed of the random generator, 0 or above. The same seed gives the same scenarios.

    Returns
    -------
    Scenarios
        Firmness of the finger as a value, and tolerances as factors.

    Raises
    ------
    InputError
        If the number of scenarios, the seed or a tolerance is out of range, or a parameter is
        unknown.
    """
    from scipy.stats import norm, qmc  # The import takes a second, which workers are spared.

    if not 1 <= count <= MOST:
        raise InputError(f"scenarios = {count}: must be 1 … {MOST}")
    if seed < 0:
        raise InputError(f"seed = {seed}: must be 0 or above")
    for name, spread in tolerances.items():
        if not 0 <= spread <= 0.3:
            raise InputError(f"tolerance of {name} = {spread:g}: must be 0 … 0.3 of its value")
    sobol = qmc.Sobol(1 + len(tolerances), rng=np.random.default_rng(seed))
    points = sobol.random_base2(int(np.ceil(np.log2(count))))[:count]
    edge = norm.cdf(LIMIT)
    finger, *parts = norm.ppf((1 - edge) + points * (2 * edge - 1)).T
    mean, deviation = firmness
    return Scenarios(
        values={"firmness": mean + deviation * finger},
        factors={
            name: 1 + spread * part
            for (name, spread), part in zip(tolerances.items(), parts, strict=True)
        },
    )
