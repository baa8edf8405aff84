"""Power laws of speed and normal force, by which fits, their assessment and the renderer all go.

A texture states its displacement at a reference. At other speeds and forces it is multiplied by
(v/v0)^e, within a range, and held at the value at the end of the range outside it. The range of
speeds reaches `REACH` times beyond what was recorded: held right at the recorded speeds, the levels
of fabrics at twice the speed would be 5 dB too high (`python -m benchmarks fit`). Near rest the law
is constant, so that a surface stays where it is at a stop and a reversal.
"""

from typing import TypeVar

import numpy as np

from tactile.arrays import Floats
from tactile.texture.descriptor import Laws, Reference

REACH = 4.0
"""Factor by which a law of speed reaches beyond the recorded speeds on either side. Fits to two
speeds predict fabrics at 0.33–3 times these speeds, the widest ratio of those that were recorded;
that the law goes on to 4 is assumed."""
FASTEST = 1000.0
"""Highest speed of a range that a texture file may state [mm/s]."""

Number = TypeVar("Number", float, Floats)
"""One number or an array."""


def held_power_law(
    x: Number, reference: float, bounds: tuple[float, float], exponent: float
) -> Number:
    """Compute (x/reference)^exponent, held smoothly constant outside its bounds.

    x is first bent to stay within the bounds: x⁸ becomes 1/(1/(x⁸ + low⁸) + 1/high⁸), which is 0.75
    dB off the law exactly at a bound. The law is 1 at the reference, even, and smooth at 0, so that
    it has no jump at a stop or a reversal.

    Parameters
    ----------
    x : float or (...) array of float
        Argument, such as speed or force, in the unit of ``reference``.
    reference : float
        Argument at which the law is 1.
    bounds : tuple of 2 floats
        Lower and upper end of the range in which the law holds, in the unit of ``reference``.
    exponent : float
        Exponent of the power law.

    Returns
    -------
    float or (...) array of float
        Factors.
    """
    low, high = bounds[0] ** 8, bounds[1] ** -8
    at_reference = 1 / (1 / (reference**8 + low) + high)
    bent = 1 / (1 / (x**8 + low) + high)
    return (bent / at_reference) ** (exponent / 8)  # type: ignore[no-any-return]


def speed_factor(laws: Laws, reference: Reference, speed: Number) -> Number:
    """Compute the factor of a texture's displacement at a speed.

    Parameters
    ----------
    laws : Laws
        Laws of the texture.
    reference : Reference
        Speed and force at which its levels hold.
    speed : float or (...) array of float
        Speed [m/s].

    Returns
    -------
    float or (...) array of float
        Factors on displacement, 1 at the reference speed.
    """
    return held_power_law(
        speed * 1e3, reference.speed_mm_s, laws.speed_range_mm_s, laws.speed_exponent
    )


def force_factor(laws: Laws, reference: Reference, normal_force: Number) -> Number:
    """Compute the factor of a texture's displacement at a normal force.

    Parameters
    ----------
    laws : Laws
        Laws of the texture.
    reference : Reference
        Speed and force at which its levels hold.
    normal_force : float or (...) array of float
        Normal force [N].

    Returns
    -------
    float or (...) array of float
        Factors on displacement, 1 at the reference force.
    """
    return held_power_law(
        normal_force, reference.normal_force_n, laws.force_range_n, laws.force_exponent
    )


def level_shift(laws: Laws, reference: Reference, speed: Floats, normal_force: Floats) -> Floats:
    """Compute by how much the levels of a texture change with speed and force.

    Parameters
    ----------
    laws : Laws
        Laws of the texture.
    reference : Reference
        Speed and force at which its levels hold.
    speed : (...) array of float
        Speeds [m/s].
    normal_force : (...) array of float
        Normal forces [N].

    Returns
    -------
    (...) array of float
        Level there above that at the reference, as a function of place [dB].
    """
    factor = speed_factor(laws, reference, speed) * force_factor(laws, reference, normal_force)
    return np.asarray(20 * np.log10(factor))


def speed_range(slowest: float, fastest: float) -> tuple[float, float]:
    """Return the range of speeds over which a law is extrapolated.

    Parameters
    ----------
    slowest, fastest : float
        Lowest and highest recorded speed [m/s].

    Returns
    -------
    tuple of 2 floats
        Lower and upper end [mm/s].
    """
    return slowest * 1e3 / REACH, min(fastest * 1e3 * REACH, FASTEST)
