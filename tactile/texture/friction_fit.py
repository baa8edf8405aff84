"""Friction from a tangential and a normal force recorded while a finger slides.

The coefficient is their ratio, low-passed to what is quasi-static. Over speed it follows the
Stribeck law µ = µk + (µs − µk) exp(−(v/vs)²), over the normal force a power law; what a recording
does not tell, because it has one speed or one force, is left at what a descriptor assumes.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.descriptor import Friction
from tactile.texture.recorded_slide import Recorded

QUASI_STATIC = 0.05
"""s over which forces are averaged."""
PRESSED = 0.05
"""N from which a finger counts as pressing."""
SPEEDS = 3.0
"""Ratio of speeds from which a Stribeck law is told."""
FORCES = 1.5
"""Ratio of forces from which their exponent is told."""
USUAL = Friction(static_coefficient=1.0, kinetic_coefficient=1.0)
"""Where a descriptor's assumptions stand."""
EVEN, STICKING = 0.10, 0.25
"""Relative variation of friction in even sliding, at most, and in stick-slip, at least ("Stick-slip
phenomena in the friction of human skin"; textures/README.md)."""


def fit_friction(recordings: Sequence[Recorded], reference_force: float) -> Friction:
    """Fit friction to recordings that hold both forces.

    Parameters
    ----------
    recordings : with ``tangential_force`` and ``normal_force``
    reference_force : at which the coefficients are to hold [N]

    Raises
    ------
    InputError
        Where the finger never presses, or the coefficient is beyond a descriptor's limits.
    """
    speed, normal, ratio = np.concatenate([_slow(r) for r in recordings], axis=1)
    if len(ratio) < 3:
        raise InputError(f"{recordings[0].name}: normal_force_n never reaches {PRESSED:g} N")
    exponent = USUAL.force_exponent
    if np.quantile(normal, 0.9) > FORCES * np.quantile(normal, 0.1):
        exponent = float(np.polyfit(np.log(normal), np.log(ratio), 1)[0])
    level = ratio / (normal / reference_force) ** exponent
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


def _slow(recorded: Recorded) -> Floats:
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
    """Return static and kinetic coefficient and the Stribeck speed [m/s]."""
    usual = float(np.median(level))
    slow, fast = np.quantile(speed, [0.02, 0.98])
    if fast < SPEEDS * max(slow, 1e-9):
        return usual, usual, USUAL.stribeck_speed_mm_s * 1e-3
    start = [float(np.median(level[speed >= np.median(speed)])), 0.2 * usual, np.log(fast / 4)]

    def misses(p: Floats) -> Floats:
        return np.asarray(p[0] + p[1] * np.exp(-((speed / np.exp(p[2])) ** 2)) - level)

    bounds = [0, 0, np.log(max(slow, 1e-4))], [np.inf, np.inf, np.log(fast)]
    kinetic, drop, logarithm = least_squares(misses, start, bounds=bounds, loss="soft_l1").x
    return float(kinetic + drop), float(kinetic), float(np.exp(logarithm))
