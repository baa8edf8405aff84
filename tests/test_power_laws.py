"""The power laws of speed and force: one for fits, their assessment and the renderer.

Laws are compared with plain powers where they hold and with constants where they are held. What an
assessment predicts is compared with strokes that the renderer plays, measured by scipy.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch
from slides import Surface, slide

import tactile
from tactile.arrays import Floats
from tactile.rendering.shear import Law
from tactile.rendering.skin_stretch import FrictionLaw
from tactile.texture.descriptor import About, Descriptor
from tactile.texture.fitting import describe, measure_slides
from tactile.texture.judging import predict
from tactile.texture.power_laws import held_power_law, level_shift, speed_range
from tactile.texture.surface import Texture, stochastic_waves

EXPONENTS = [-4.0, -1.0, -0.5, 0.4, 1.0, 3.0]
RANGE = (10.0, 1000.0)
MIDDLE = 100.0
ABOUT = About(
    id="known", category="test", description="known", provenance="fitted", source="slides",
    license="CC0-1.0",
)  # fmt: skip


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_law_is_the_plain_power_in_the_middle_of_its_range(exponent: float) -> None:
    """The bend has 4⁻⁸/8 = 2e-6 left at four times either end, per unit of exponent."""
    x = np.geomspace(40, 250, 50)
    found = held_power_law(x, MIDDLE, RANGE, exponent)
    np.testing.assert_allclose(found, (x / MIDDLE) ** exponent, rtol=3e-6 * abs(exponent))


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("reference", [1.0, 30.0, MIDDLE, 5000.0])
def test_a_law_is_one_at_its_reference_wherever_that_is(exponent: float, reference: float) -> None:
    found = held_power_law(np.array([reference]), reference, RANGE, exponent)
    assert found == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_law_is_held_at_what_it_has_at_the_ends_of_its_range(exponent: float) -> None:
    """Ends are (10/100)^e from rest and (1000/100)^e up; 4⁻⁸/8 is left 4 times outside."""
    slow = held_power_law(np.array([0.0, 1e-9, 1.0, 2.5]), MIDDLE, RANGE, exponent)
    np.testing.assert_allclose(slow, 0.1**exponent, rtol=3e-6 * abs(exponent))
    fast = held_power_law(np.array([4e3, 1e5, 1e12]), MIDDLE, RANGE, exponent)
    np.testing.assert_allclose(fast, 10.0**exponent, rtol=3e-6 * abs(exponent))


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_law_is_three_quarters_of_a_decibel_off_right_at_an_end(exponent: float) -> None:
    """x⁸ + x⁸ is 2 x⁸: 2^(1/8), 0.753 dB, per unit of exponent, from whichever side."""
    at_ends = held_power_law(np.array(RANGE), MIDDLE, RANGE, exponent)
    plain = (np.array(RANGE) / MIDDLE) ** exponent
    decibels = 20 * np.log10(at_ends / plain)
    np.testing.assert_allclose(decibels, np.array([0.7526, -0.7526]) * exponent, atol=1e-3)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_law_is_even_and_flat_through_a_stop(exponent: float) -> None:
    """A reversal changes nothing: same from either side, and the seventh power near zero."""
    x = np.linspace(0, 50, 101)
    there = held_power_law(x, MIDDLE, RANGE, exponent)
    np.testing.assert_array_equal(held_power_law(-x, MIDDLE, RANGE, exponent), there)
    near = held_power_law(np.array([0.0, 0.5, 1.0]), MIDDLE, RANGE, exponent)
    assert np.ptp(near) / near[0] < 2e-8 * abs(exponent)


@settings(max_examples=100)
@given(
    low=st.floats(0.1, 50),
    ratio=st.floats(1.2, 100),
    reference=st.floats(0.1, 1000),
    exponent=st.floats(-4, 4),
)
def test_a_law_is_smooth_and_never_steeper_than_its_power(
    low: float, ratio: float, reference: float, exponent: float
) -> None:
    """The slope of its logarithm is between 0 and the exponent, and turns by ≤ 2 e per e-fold.

    The bend x⁸/(x⁸ + low⁸) is a logistic of 8 ln x, whose slope is at most 8/4.
    """
    log = np.linspace(math.log(low) - 3, math.log(low * ratio) + 3, 4001)
    law = np.log(held_power_law(np.exp(log), reference, (low, low * ratio), exponent))
    slope = np.diff(law) / np.diff(log)
    share = slope / exponent if abs(exponent) > 1e-3 else np.zeros(1)
    assert share.min() > -1e-6
    assert share.max() < 1 + 1e-6
    turn = np.diff(slope) / np.diff(log)[0]
    assert np.abs(turn).max() < 2.01 * abs(exponent) + 1e-4


def test_a_law_of_one_number_is_that_of_an_array() -> None:
    one = held_power_law(30.0, MIDDLE, RANGE, -1.0)
    assert isinstance(one, float)
    assert one == held_power_law(np.array([30.0]), MIDDLE, RANGE, -1.0)[0]


# One law


def test_a_law_of_speed_reaches_four_times_beyond_and_not_beyond_what_a_file_may_state() -> None:
    assert speed_range(0.02, 0.06) == pytest.approx((5.0, 240.0))
    assert speed_range(0.1, 0.5) == pytest.approx((25.0, 1000.0))


@pytest.mark.parametrize("name", tactile.textures())
def test_a_shipped_texture_keeps_its_law_from_40_to_120_mm_s(name: str) -> None:
    """The ends at 20 and 240 mm/s leave 0.01 dB of the bend at twice and half of them."""
    texture = tactile.load_texture(name)
    speed = np.array([0.04, 0.06, 0.08, 0.12])
    played = 20 * np.log10(Law(texture.descriptor)(speed**2, np.full(4, 0.5)))
    plain = 20 * texture.laws.speed_exponent * np.log10(speed / 0.04)
    np.testing.assert_allclose(played, plain, atol=0.02)


def levels(signal: Floats, rate: float, speed: float, center: Floats) -> Floats:
    """Return levels over place by scipy's Welch over time, of columns' mean [dB re 1 µm²·mm]."""
    frequency, density = welch(signal, rate, nperseg=4096, axis=0)
    place, density = frequency / speed, density.reshape(len(frequency), -1).mean(axis=1) * speed
    edges = center[:, None] * 10 ** np.array([-0.05, 0.05])
    inside = (place >= edges[:, :1]) & (place < edges[:, 1:])
    return np.asarray(10 * np.log10((inside @ density) / inside.sum(axis=1) * 1e15))


def stroke(descriptor: Descriptor, speed: float, force: float) -> Floats:
    """Return the shear that is rendered on a stroke of 4 s, without its start and end [m]."""
    stochastic = descriptor.stochastic
    assert stochastic is not None
    none = np.zeros(0)
    texture = Texture("known", descriptor, *stochastic_waves(stochastic, 384), none, none)
    path = tactile.Trajectory.line(speed=speed, duration=4.2, normal_force=force)
    shear = tactile.render(tactile.load_display("reference-24"), texture, path).shear
    return np.asarray(shear[800:-800], np.float64)


@pytest.mark.parametrize(
    ("seen", "unseen"),
    [
        pytest.param((0.02, 0.03), (0.05, 0.06), id="faster"),
        pytest.param((0.05, 0.06), (0.02, 0.03), id="slower"),
    ],
)
def test_what_is_judged_is_what_is_rendered_at_speeds_and_forces_beyond_the_recorded(
    seen: tuple[float, float], unseen: tuple[float, float]
) -> None:
    """The judge's error in each band is that of strokes at the speeds that were not fitted.

    Bands from 30 Hz to 800 Hz; above, the renderer rolls off. The judge's strokes leave 0.3 dB, and
    those of 100 periods and more under 24 contactors about as much.
    """
    forces = (0.5, 0.5, 1.0, 1.0)
    surface = Surface(level_db=-5, slope=-2.5)
    recordings = [
        slide(surface, v, seed=k, force=n, seconds=4.0)
        for k, (v, n) in enumerate(zip((*seen, *unseen), forces, strict=True))
    ]
    reference = math.sqrt(seen[0] * seen[1])
    whole = measure_slides(recordings, reference_speed=reference)
    known, new = whole.part([0, 1]), whole.part([2, 3])
    verdict = predict(known, new, ABOUT)
    descriptor = describe(known, ABOUT).descriptor
    misses = []
    for k, v in enumerate(unseen):
        center, recorded = verdict.center, new.level[k, new.core]
        audible = (center * v > 30) & (center * v < 800)
        rendered = levels(stroke(descriptor, v, 1.0), 8000.0, v, center[audible])
        misses.append(np.full(len(center), np.nan))
        misses[-1][audible] = rendered - recorded[audible]
    judged = verdict.rendering.level - verdict.held_out
    apart = np.mean(misses, axis=0) - judged
    apart = apart[np.isfinite(apart)]
    assert len(apart) >= 10
    assert abs(apart.mean()) < 0.3
    assert np.abs(apart).max() < 1.0


def test_the_renderer_s_tables_are_the_law_of_the_fit() -> None:
    """Tables and law agree within 2e-3 dB, in the range and beyond, where both are held."""
    descriptor = tactile.load_texture("wood-oak").descriptor
    grid = np.meshgrid(np.geomspace(1e-3, 0.9, 40), np.geomspace(0.05, 15, 40))
    speed, force = (side.ravel() for side in grid)
    table = 20 * np.log10(Law(descriptor)(speed**2, force))
    expected = level_shift(descriptor.laws, descriptor.reference, speed, force)
    np.testing.assert_allclose(table, expected, atol=2e-3)


def test_friction_is_rendered_over_the_forces_that_it_was_fitted_to() -> None:
    """µ = 0.4 (N/0.5)^−0.2, recorded at 0.2–0.8 N, is the rendered friction there within 3 %."""
    plain = slide(Surface(level_db=-5), 0.04, seconds=6.0)
    time = np.arange(len(plain.signal)) / plain.sample_rate
    normal = 0.5 + 0.3 * np.sin(2 * np.pi * 1.7 * time)
    tangential = 0.4 * (normal / 0.5) ** -0.2 * normal
    recorded = replace(plain, normal_force=normal, tangential_force=tangential)
    law = FrictionLaw(describe(measure_slides([recorded]), ABOUT).descriptor)
    for force in (0.25, 0.5, 0.75):
        expected = 0.4 * (force / 0.5) ** -0.2 * force
        assert law.kinetic * law.force(force) == pytest.approx(expected, rel=0.03)
