"""Friction from a tangential and a normal force that were recorded while a finger slides.

The coefficient is the ratio of the two forces, low-passed to its quasi-static part. It follows the
Stribeck law µ = µk + (µs − µk) exp(−(v/vs)²) of the speed and a power law of the normal force, held
outside the range of forces as it is in rendering. What a recording does not tell, because it has
one speed or one force, keeps the default of a descriptor.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.descriptor import Friction, Laws, Reference
from tactile.texture.power_laws import held_power_law
from tactile.texture.recorded_slide import Recorded

QUASI_STATIC = 0.05
"""Time over which forces are averaged [s]."""
PRESSED = 0.05
"""Normal force above which a finger counts as pressing [N]."""
SPEEDS = 3.0
"""Ratio of speeds from which on a Stribeck law is fitted."""
FORCES = 1.5
"""Ratio of forces from which on their exponent is fitted."""
USUAL = Friction(static_coefficient=1.0, kinetic_coefficient=1.0)
"""Friction that holds the defaults of a descriptor."""
EVEN, STICKING = 0.10, 0.25
"""Relative variation of friction: the largest one in even sliding and the smallest one in
stick-slip ("Stick-slip phenomena in the friction of human skin"; textures/README.md)."""


def fit_friction(recordings: Sequence[Recorded], reference: Reference, laws: Laws) -> Friction:
    """Fit friction to recordings that hold both forces.

    Parameters
    ----------
    recordings : sequence of Recorded
        Recordings with ``tangential_force`` and ``normal_force``.
    reference : Reference
        Stroke whose normal force is that at which the coefficients hold.
    laws : Laws
        Laws of the texture, whose range of forces is that of the friction as well.

    Returns
    -------
    Friction
        Table of a descriptor.

    Raises
    ------
    InputError
        If the finger never presses, or a coefficient is outside the limits of a descriptor.
    """
    speed, normal, ratio = np.concatenate([_quasi_static(r) for r in recordings], axis=1)
    if len(ratio) < 3:
        raise InputError(f"{recordings[0].name}: normal_force_n never reaches {PRESSED:g} N")
    exponent = USUAL.force_exponent
    if np.quantile(normal, 0.9) > FORCES * np.quantile(normal, 0.1):
        exponent = float(np.polyfit(np.log(normal), np.log(ratio), 1)[0])
    bounds = laws.force_range_n
    level = ratio / held_power_law(normal, reference.normal_force_n, bounds, exponent)
    static, kinetic, stribeck = _stribeck(speed, level)
    moving = speed > 0.5 * np.quantile(speed, 0.9)
    model = kinetic + (static - kinetic) * np.exp(-((speed / stribeck) ** 2))
    variation = float(np.std((level / model)[moving]))
    if not 0 < kinetic <= static <= 5:
        raise InputError(
            f"{recordings[0].name}: friction comes out as {kinetic:.2g} sliding, {static:.2g} at "
            "rest: must be 0 … 5; check both forces' signs and offsets"
        )
    return Friction(
        static_coefficient=round(static, 3),
        kinetic_coefficient=round(kinetic, 3),
        force_exponent=round(float(np.clip(exponent, -4, 4)), 2),
        stribeck_speed_mm_s=round(stribeck * 1e3, 2),
        stick_slip=round(float(np.clip((variation - EVEN) / (STICKING - EVEN), 0, 1)), 2),
    )


def _quasi_static(recorded: Recorded) -> Floats:
    """Return speed, normal force and coefficient (3, K) where the finger presses and moves."""
    assert recorded.tangential_force is not None
    assert recorded.normal_force is not None
    size = max(round(QUASI_STATIC * recorded.sample_rate), 1)
    speed, normal, tangential = (
        uniform_filter1d(side, size, mode="nearest")[size // 2 :: size]
        for side in (np.abs(recorded.speed), recorded.normal_force, recorded.tangential_force)
    )
    good = (normal > PRESSED) & (np.abs(tangential) > 0) & (speed > 0)
    return np.stack([speed[good], normal[good], np.abs(tangential[good]) / normal[good]])


def _stribeck(speed: Floats, level: Floats) -> tuple[float, float, float]:
    """Return the static and the kinetic coefficient and the Stribeck speed [m/s]."""
    median_level = float(np.median(level))
    slow, fast = np.quantile(speed, [0.02, 0.98])
    if fast < SPEEDS * max(slow, 1e-9):
        return median_level, median_level, USUAL.stribeck_speed_mm_s * 1e-3
    start = [
        float(np.median(level[speed >= np.median(speed)])),
        0.2 * median_level,
        np.log(fast / 4),
    ]

    def misses(p: Floats) -> Floats:
        return np.asarray(p[0] + p[1] * np.exp(-((speed / np.exp(p[2])) ** 2)) - level)

    bounds = [0, 0, np.log(max(slow, 1e-4))], [np.inf, np.inf, np.log(fast)]
    kinetic, drop, log_speed = least_squares(misses, start, bounds=bounds, loss="soft_l1").x
    return float(kinetic + drop), float(kinetic), float(np.exp(log_speed))
