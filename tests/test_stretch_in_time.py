"""Skin stretch runs on whatever the finger and the stream do, and beside textures."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed
from scipy.interpolate import BSpline
from stretch_rig import (
    DISPLAY,
    GIVE,
    NODE_TIME,
    RATE,
    STROKE_SHARE,
    expected_stretch,
    law,
    rubbed,
    shear_of,
    static_shear,
    stroke,
)

from benchmarks.rendering import grating_texture
from tactile.actuator.finger import FingerLoad
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.renderer import Ramp, Renderer
from tactile.rendering.skin_stretch import (
    Bristles,
    Stretch,
    spline_weights,
)
from tactile.rendering.stroke import Motion

# In time


def test_between_nodes_runs_a_uniform_cubic_b_spline() -> None:
    """The reference is scipy's spline; values begin at their node and need no later one."""
    node = round(NODE_TIME * RATE)
    rows = spline_weights(node, 64)
    values = np.random.default_rng(4).normal(0, 1, 40)
    t = np.arange(4 * node, 36 * node)
    found = [rows[p % node, :4] @ values[p // node - 3 : p // node + 1] for p in t]
    expected = BSpline(np.arange(44), values, 3)(t / node)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    for k in (1, 3):
        np.testing.assert_allclose(rows[k * node :, k:][:node, :4], rows[:node, :4], atol=1e-7)


@pytest.mark.parametrize("sizes", [(1,), (7,), (16,), (160,), (3, 64, 1, 30, 17)])
def test_nothing_depends_on_how_the_stream_is_cut(sizes: tuple[int, ...]) -> None:
    """Slips, reversals and a lift are included; float32 sums in another order."""
    n = np.arange(2000)
    x = 2e-3 * np.sin(2 * np.pi * 2.6 * n / RATE) + 1e-5 * np.sin(n)
    place = np.column_stack([x, 0.4 * x])
    force = np.where((n > 1200) & (n < 1400), 0.0, 0.5 + 0.2 * np.sin(n / 300))
    display = DISPLAY
    turned = replace(display, shear_direction=np.linspace(0, 1, 24))
    texture = rubbed(stick_slip=0.6)
    shown = turned if len(sizes) > 1 else display
    whole = shear_of(texture, place, force, display=shown)
    cut = shear_of(texture, place, force, display=shown, sizes=sizes)
    assert np.mean((whole - cut) ** 2) < 1e-11 * np.mean(whole**2)  # -110 dB


@pytest.mark.parametrize("rate", [2500.0, 4000.0, 22050.0])
def test_another_sample_rate_asks_the_same_of_the_skin(rate: float) -> None:
    texture = rubbed()
    ways = [0.03 * np.abs(np.arange(round(0.2 * f)) / f - 0.1) for f in (RATE, rate)]
    a, b = (
        shear_of(texture, np.column_stack([way, 0 * way]), rate=f)[:, 0]
        for way, f in zip(ways, (RATE, rate), strict=True)
    )
    at = np.arange(0.0, 0.19, 1e-3)
    same = np.interp(at, np.arange(len(b)) / rate, b), np.interp(at, np.arange(len(a)) / RATE, a)
    # nodes are up to 20 % nearer where a sample is long: so much less late, and otherwise cut
    assert np.abs(same[0] - same[1]).max() < 0.06 * np.ptp(a)


def test_a_stop_holds_the_stretch_and_a_reversal_pulls_it_over() -> None:
    """Stretch is held to float32; after 4 GIVE μ back 1 − 2 e⁻⁴ of it is on the other side."""
    out = np.minimum(np.arange(8000) * 4e-6, 12e-3)
    held = shear_of(rubbed(), np.column_stack([out, 0 * out]))[:, 0]
    assert np.ptp(held[-2000:]) < 1e-6 * abs(held[-1])
    assert abs(held[-1]) > 3e-6
    back = np.concatenate([out, out[-1] - np.minimum(np.arange(4000) * 4e-6, 4 * GIVE * 0.5)])
    over = shear_of(rubbed(), np.column_stack([back, 0 * back]))[:, 0]
    display = DISPLAY
    at_static, other = (
        expected_stretch(f * 0.5, display, FingerLoad.low(), static_shear(display))
        for f in (0.5, 0.5 * (1 - 2 * math.exp(-4)))
    )
    assert over[7900] <= -at_static * (1 - 1e-3)
    assert over[-1] == pytest.approx(other, rel=0.05)
    middle = over[8000:]
    assert np.diff(middle).min() > -1e-9  # without turning back
    assert np.abs(np.diff(middle)).max() < 0.02 * np.ptp(middle)  # and without a step


@pytest.mark.parametrize("stick_slip", [0.0, 1.0])
def test_a_resting_finger_that_trembles_does_not_chatter(stick_slip: float) -> None:
    """20 µm rms of white noise, after a stroke: below 0.3 µm rms above 20 Hz."""
    rng = np.random.default_rng(1)
    x = np.minimum(np.arange(16000) * 5e-6, 20e-3)
    place = np.column_stack([x, 0 * x]) + rng.normal(0, 20e-6, (16000, 2))
    rest = shear_of(rubbed(stick_slip=stick_slip), place)[8000:, 0]
    power = np.abs(np.fft.rfft((rest - rest.mean()) * np.hanning(len(rest)))) ** 2
    power *= 2 / (np.hanning(len(rest)) ** 2).sum() / len(rest)
    above = np.fft.rfftfreq(len(rest), 1 / RATE) > 20
    assert math.sqrt(power[above].sum()) < 0.3e-6


def test_lift_off_lets_go_within_the_fade_and_landing_begins_from_nothing() -> None:
    display = DISPLAY
    x = stroke(0.04, 1.0)
    x[4000:, 0] += 0.01  # comes down elsewhere
    force = np.full(8000, 0.5)
    force[3000:4000] = 0.0
    found = shear_of(rubbed(stick_slip=0.5), x, force)[:, 0]
    gone = 3000 + round((display.limits.fade + 5 * NODE_TIME) * RATE)
    assert abs(found[2990]) > 3e-6
    assert not found[gone:4000].any()
    step = np.abs(np.diff(found[2900:4000])).max()
    assert step < 0.01 * abs(found[2990])
    assert np.abs(found[4000:4032]).max() < 0.2 * abs(found[2990])
    assert found[-1] == pytest.approx(found[2990], rel=1e-3)


def test_a_jump_of_place_is_no_motion() -> None:
    x = stroke(0.04, 0.5)
    smooth = shear_of(rubbed(), x)[:, 0]
    x[2000:, 0] -= 0.2
    jumped = shear_of(rubbed(), x)[:, 0]
    assert np.abs(jumped - smooth).max() < 0.15 * np.ptp(smooth)


def test_a_single_invalid_sample_is_hardly_felt() -> None:
    x = stroke(0.04, 0.5)
    whole = shear_of(rubbed(), x)[:, 0]
    x[16 * 100] = np.nan
    assert np.abs(shear_of(rubbed(), x)[:, 0] - whole).max() < 0.1 * np.ptp(whole)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**16),
    steps=st.floats(-9, 2),
    static=st.floats(1e-3, 5),
    kinetic=st.floats(1e-3, 5),
    exponent=st.floats(-4, 4),
    stick_slip=st.floats(0, 1),
    speed=st.floats(1e-3, 1000),
)
def test_no_way_of_a_finger_stretches_beyond_the_share(
    seed: int, steps: float, **friction: float
) -> None:
    friction_law = law(
        static_coefficient=friction["static"],
        kinetic_coefficient=friction["kinetic"],
        force_exponent=friction["exponent"],
        stick_slip=friction["stick_slip"],
        stribeck_speed_mm_s=friction["speed"],
    )
    rng = np.random.default_rng(seed)
    place = np.cumsum(rng.normal(0, 10**steps, (600, 2)), axis=0) * rng.choice([0, 1], (600, 1))
    force = np.abs(rng.normal(0, 10 ** rng.uniform(-3, 2), 600)) * (rng.random(600) > 0.02)
    force[rng.integers(600)] = -1.0
    place[rng.integers(600, size=3), 0] = rng.choice([np.nan, np.inf, 1e300], 3)
    motion, most = Motion(RATE), static_shear(DISPLAY)
    stretch, rubbing = Stretch(DISPLAY, np.array([most]), RATE, 64), Bristles(friction_law)
    for k in range(0, 600, 50):
        moved = motion(motion.rows(place[k : k + 50], force[k : k + 50]))
        assert moved is not None
        found = stretch(moved, [(rubbing, Ramp(0.01, 3.0))])
        assert found is not None
        assert np.isfinite(found).all()
        assert np.abs(found).max() <= STROKE_SHARE * most * (1 + 1e-6)


# Beside textures


def test_layers_add_up_with_their_gains_and_fade_over_smoothly() -> None:
    """The change to another texture takes as long as the fade."""
    few, many = (
        RealizedLayer(DISPLAY, rubbed(static_coefficient=mu, kinetic_coefficient=mu))
        for mu in (0.2, 0.6)
    )
    renderer = Renderer(DISPLAY, None)
    place, force = stroke(0.04, 1.0), np.full(8000, 0.5)
    renderer.play([(few, 0.5), (many, 0.5)])
    shear = [renderer.block(place[:3008], force[:3008], shear=True)[1]]
    renderer.play([(many, 1.0)])
    shear.append(renderer.block(place[3008:6000], force[3008:6000], shear=True)[1])
    renderer.play([])
    shear.append(renderer.block(place[6000:], force[6000:], shear=True)[1])
    found = np.concatenate(shear)[:, 0]
    attained = static_shear(DISPLAY)
    one, other = (
        expected_stretch(mu * 0.5, DISPLAY, FingerLoad.low(), attained) for mu in (0.2, 0.6)
    )
    assert found[3000] == pytest.approx(-(one + other) / 2, rel=1e-4)
    assert found[5900] == pytest.approx(-other, rel=1e-4)
    assert not found[-1000:].any()
    fade = DISPLAY.limits.fade * RATE
    assert np.abs(np.diff(found[2900:])).max() < 2 * other / fade


def test_a_layer_with_friction_goes_to_another_process_as_it_is() -> None:
    layer = RealizedLayer(DISPLAY, rubbed(stick_slip=0.3))
    sent = pickle.loads(pickle.dumps(layer))
    place, force = stroke(2e-3, 0.5), np.full(4000, 0.5)
    drives = []
    for one in (layer, sent):
        renderer = Renderer(DISPLAY, None)
        renderer.play([(one, 1.0)])
        drives.append(renderer.block(place, force))
    np.testing.assert_array_equal(drives[0], drives[1])


def test_friction_is_added_to_what_the_texture_does_and_nothing_else_changes() -> None:
    grating, only = grating_texture(5.0), rubbed(stick_slip=0.5)
    friction = only.descriptor.friction
    both = replace(grating, descriptor=changed(grating.descriptor, friction=friction))
    found = [shear_of(t, stroke(6e-3, 0.3)) for t in (both, grating, only)]
    np.testing.assert_allclose(found[0], found[1] + found[2], atol=2e-12)
    assert RealizedLayer(DISPLAY, grating).friction is None
