"""Skin stretch by friction: closed forms of law, bristle, slip and spline; the same ODE by scipy.

What the renderer does with it is read from its shear, with a texture of one wave so small that
friction is all there is.
"""

import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline

from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.plant import Plant
from tactile.bench.friction import STICKY, friction_only
from tactile.bench.rendering import grating_texture
from tactile.display import Display, load_display
from tactile.rendering.layer import Layer
from tactile.rendering.renderer import Ramp, Renderer
from tactile.rendering.skin_stretch import (
    AVERAGED,
    GIVE,
    NODE_TIME,
    SLIP,
    STROKE_SHARE,
    Bristles,
    FrictionLaw,
    Stretch,
    spline_weights,
)
from tactile.rendering.stroke import Motion
from tactile.sim import Fidelity
from tactile.texture.descriptor import Friction
from tactile.texture.surface import Texture

Floats = NDArray[np.float64]
RATE = 8000.0
DISPLAY = load_display("reference-24")
STICKY_ONLY = friction_only(STICKY)
VS = 10e-3
"""m/s, Stribeck speed of the shipped textures and of those here."""


def rubbed(**friction: Any) -> Texture:
    """Return a texture with next to nothing but friction; its reference force is 0.5 N."""
    values = {"static_coefficient": 0.8, "kinetic_coefficient": 0.5, "force_exponent": 0.0}
    changes = Friction(**(values | friction))
    return replace(STICKY_ONLY, descriptor=changed(STICKY_ONLY.descriptor, friction=changes))


def law(**friction: Any) -> FrictionLaw:
    return FrictionLaw(rubbed(**friction).descriptor)


def shear_of(
    texture: Texture,
    place: Floats,
    force: Any = 0.5,
    *,
    display: Display | None = None,
    sizes: tuple[int, ...] = (64,),
    rate: float = RATE,
) -> Floats:
    """Return what the renderer asks of the skin, the delay taken off, for places (S, 2) [m]."""
    renderer = Renderer(display or load_display("reference-24"), texture, sample_rate=rate)
    force = np.broadcast_to(np.asarray(force, np.float64), len(place))
    place = np.concatenate([place, np.repeat(place[-1:], renderer.delay, axis=0)])
    force = np.concatenate([force, np.repeat(force[-1:], renderer.delay)])
    parts, at, k = [], 0, 0
    while at < len(place):
        size = sizes[k % len(sizes)]
        block = slice(at, at + size)
        parts.append(renderer.block(place[block], force[block], shear=True)[1])
        at, k = at + size, k + 1
    return np.concatenate(parts)[renderer.delay :]


def stroke(speed: float, duration: float, angle: float = 0.0) -> Floats:
    way = speed * np.arange(round(duration * RATE)) / RATE
    return np.column_stack([way * math.cos(angle), way * math.sin(angle)])


def expected_stretch(force: float, display: Display, load: FingerLoad, attainable: float) -> float:
    """Return share × tanh of what each contactor's part of a force does to the load's spring."""
    most = STROKE_SHARE * attainable
    own = force / len(display.contactors) / float(load.k0)
    return most * math.tanh(own / most)


# Stribeck


@pytest.mark.parametrize(
    ("ratio", "expected"), [(0.0, 0.8), (1.0, 0.5 + 0.3 / math.e), (2.0, 0.5 + 0.3 / math.e**4)]
)
def test_friction_falls_from_static_to_kinetic_as_a_gaussian_of_speed(
    ratio: float, expected: float
) -> None:
    """The bristle slides for 20 mm: what it mobilizes is μ(v), and no less in any direction."""
    for angle in (0.0, 2.1, -1.0):
        bristles, step = Bristles(law()), 1e-5
        duration = step / (ratio * VS) if ratio else 1e9
        for _ in range(2000):
            q = bristles.move(step * math.cos(angle), step * math.sin(angle), duration)
        assert q == pytest.approx((expected * math.cos(angle), expected * math.sin(angle)))


def test_far_above_the_stribeck_speed_friction_is_kinetic() -> None:
    bristles = Bristles(law())
    for _ in range(100):
        q = bristles.move(1e-3, 0.0, 1e-3)
    assert q == pytest.approx((0.5, 0.0))


@pytest.mark.parametrize("exponent", [-0.3, 0.0, 0.4])
def test_force_grows_as_its_power_one_above_the_coefficients(exponent: float) -> None:
    """N (N/N0)^e in the middle of the range 0.2 … 2 N, where the bent ends take below 1 %."""
    found = [law(force_exponent=exponent).force(n) for n in (0.4, 0.5, 1.0)]
    expected = [n * (n / 0.5) ** exponent for n in (0.4, 0.5, 1.0)]
    assert found == pytest.approx(expected, rel=0.01)
    assert found[1] == pytest.approx(0.5, rel=1e-12)
    assert law(force_exponent=-4.0).force(0.0) == 0.0


# The bristle


def by_scipy(path: Any, velocity: Any, mu: Any, end: float) -> Floats:
    """Return q at the end of a way (t → velocity (2,)), from LuGre's differential equation."""

    def rate(t: float, q: Floats) -> Floats:
        v = velocity(t)
        speed = math.hypot(*v)
        return np.asarray((v - q * speed / mu(speed)) / GIVE)

    found = solve_ivp(rate, (0, end), path, rtol=1e-9, atol=1e-11)
    return np.asarray(found.y[:, -1])


def test_a_way_of_straight_pieces_is_exact_whatever_their_length() -> None:
    """Each at its own speed and in its own direction, some as long as all that the skin gives."""
    rng = np.random.default_rng(2)
    bristles, q = Bristles(law()), np.zeros(2)
    for _ in range(30):
        v, time = rng.normal(0, 0.01, 2), 10 ** rng.uniform(-3, -1)
        found = bristles.move(float(v[0] * time), float(v[1] * time), time)
        q = by_scipy(
            q,
            lambda _, v=v: v,
            lambda speed: 0.5 + 0.3 * math.exp(-((speed / VS) ** 2)),
            time,
        )
        assert found == pytest.approx(tuple(q), abs=1e-8)


def test_a_swing_draws_dahls_loop() -> None:
    """Each half cycle of x = A sin(t) in closed form.

    From −q0 at a turn the bristle is at μ − (μ + q0) exp(−s/(μ GIVE)) after the way s, so that the
    loop closes at q0 = μ tanh(A/(μ GIVE)).
    """
    mu, amplitude, steps = 0.5, 0.4e-3, 500
    bristles = Bristles(law(static_coefficient=mu, kinetic_coefficient=mu))
    x = amplitude * np.sin(2 * np.pi * np.arange(6 * steps + 1) / steps)
    q = np.array([bristles.move(dx, 0.0, 1e-3)[0] for dx in np.diff(x)])
    turn = mu * math.tanh(amplitude / (mu * GIVE))
    fall, rise = slice(5 * steps + steps // 4, 5 * steps + 3 * steps // 4), slice(-steps // 4, None)
    way = amplitude - x[1:][fall]
    expected = -mu + (mu + turn) * np.exp(-way / (mu * GIVE))
    np.testing.assert_allclose(q[fall], expected, atol=1e-6)
    way = x[1:][rise] + amplitude
    expected = mu - (mu + turn) * np.exp(-way / (mu * GIVE))
    np.testing.assert_allclose(q[rise], expected, atol=1e-6)


def test_a_swing_through_the_renderer_is_the_ode_read_late() -> None:
    """LuGre after a first-order mean of the motion, by scipy; two nodes and 4 ms late.

    Nodes take the mean velocity of 2 ms, half a node late; the spline's own width and the mean's
    steps leave 2 % of a swing of 2 Hz.
    """
    amplitude, rate = 2e-3, 2 * math.pi * 2.0
    n = np.arange(5000)
    x = amplitude * np.sin(rate * n / RATE)
    texture = rubbed(static_coefficient=0.6, kinetic_coefficient=0.6)
    found = shear_of(texture, np.column_stack([x, 0 * x]))[:, 0]

    def slope(t: float, state: Floats) -> Floats:
        v, q = state
        change = (amplitude * rate * math.cos(rate * t) - v) / AVERAGED
        return np.array([change, (v - q * abs(v) / 0.6) / GIVE])

    times = n / RATE
    ode = solve_ivp(slope, (0, 0.7), [0, 0], t_eval=times, rtol=1e-7, atol=1e-9, max_step=2e-3)
    attained = static_shear(DISPLAY)
    scale = [expected_stretch(q * 0.5, DISPLAY, FingerLoad.low(), attained) for q in ode.y[1]]
    late = 2 * NODE_TIME - NODE_TIME / 2
    expected = -np.interp(times - late, times, scale)
    error = found[1000:] - expected[1000:]
    assert np.abs(error).max() < 0.02 * np.ptp(expected)


def static_shear(display: Display) -> float:
    """Return what full drive attains at rest [m]."""
    return float(np.abs(display.responses(np.zeros(1), RATE)[0, 0, 0])) * display.limits.voltage


# Direction and size


@pytest.mark.parametrize("finger", ["low", "high"])
@pytest.mark.parametrize("angle_deg", [0.0, 60.0, 90.0, 180.0, 250.0])
def test_stretch_points_against_the_motion_and_is_projected_on_the_axis(
    finger: str, angle_deg: float
) -> None:
    """At 40 mm/s, where 1e-7 of the weakening is left; the grating leaves 1e-9 m."""
    load = getattr(FingerLoad, finger)()
    display = load_display("reference-24", load=load)
    angle = math.radians(angle_deg)
    found = shear_of(rubbed(), stroke(0.04, 0.3, angle), display=display)[-100:]
    size = expected_stretch(0.5 * 0.5, display, load, static_shear(display))
    assert size > 1e-6
    np.testing.assert_allclose(found, -size * math.cos(angle), atol=1e-4 * size + 2e-10)


def test_each_contactor_has_its_own_axis() -> None:
    display = DISPLAY
    turned = replace(display, shear_direction=np.linspace(0, 6, 24))
    found = shear_of(rubbed(), stroke(0.04, 0.3, 0.7), display=turned)[-1]
    size = expected_stretch(0.25, display, FingerLoad.low(), static_shear(display))
    np.testing.assert_allclose(found, -size * np.cos(turned.shear_direction - 0.7), atol=1e-9)


def test_where_the_pads_stiffness_grows_with_force_each_force_has_its_own_stretch() -> None:
    low, high = FingerLoad.low(), FingerLoad.high()
    table = FingerTable(normal_force=(0.3, 1.0), loads=(low, high))
    display = load_display("reference-24", load=table)
    for force, load in ((0.3, low), (1.0, high)):
        alone = load_display("reference-24", load=load)
        found = shear_of(rubbed(), stroke(0.04, 0.3), force, display=display)[-1, 0]
        expected = expected_stretch(0.5 * force, alone, load, static_shear(alone))
        assert found == pytest.approx(-expected, rel=2e-3)


def test_a_load_without_stiffness_is_no_skin() -> None:
    display = load_display("reference-24", load=FingerLoad.none())
    assert np.abs(shear_of(rubbed(), stroke(0.04, 0.1), display=display)).max() < 2e-9


# Stick-slip


def saw(speed: float, **friction: Any) -> tuple[Floats, float, float]:
    """Return q along x at nodes 2 ms apart, and the tops' level and weakening at this speed."""
    one = law(**({"stick_slip": 1.0} | friction))
    bristles, over = Bristles(one), 0.3 * math.exp(-((speed / VS) ** 2))
    step = speed * NODE_TIME
    q = np.array([bristles.move(step, 0.0, NODE_TIME)[0] for _ in range(round(20e-3 / step))])
    return q, 0.5 + over, over


@pytest.mark.parametrize("speed", [0.5e-3, 2e-3, 5e-3])
def test_the_skin_slips_once_every_force_difference_over_stiffness(speed: float) -> None:
    """The way from slip to slip is that of the drop, 1/GIVE per meter; over 20 mm of it."""
    q, top, over = saw(speed)
    drop = 2 * over - SLIP * speed * NODE_TIME / GIVE
    slips = np.flatnonzero((np.diff(q) < 0) & (np.append(1, np.diff(q[:-1])) >= 0))
    way = np.diff(slips).mean() * speed * NODE_TIME
    assert way == pytest.approx(drop * GIVE, rel=0.01)
    late = q[slips[0] + 1 :]
    assert late.max() <= top + 1e-12
    assert late.max() == pytest.approx(top, abs=1.1 * speed * NODE_TIME / GIVE)
    assert late.min() == pytest.approx(top - drop, abs=2.1 * speed * NODE_TIME / GIVE)
    assert late.min() < 0.5  # below the kinetic level


def test_slips_come_at_times_between_nodes() -> None:
    """Each node is the mean of a saw-tooth over its part of the way, but for half of its slope.

    The first slip is where the skin that follows whole reaches the top, others a drop further.
    """
    speed = 4.3e-3
    q, top, over = saw(speed)
    follows = speed * NODE_TIME / GIVE
    drop = 2 * over - SLIP * follows
    reached = (np.arange(400 * len(q)) + 0.5) / 400 * follows
    tooth = np.where(reached < top, reached, top - drop + (reached - top) % drop)
    expected = tooth.reshape(-1, 400).mean(axis=1) + follows / 2
    np.testing.assert_allclose(q, expected, atol=drop / 400)


def test_depth_follows_stick_slip_and_is_nothing_without() -> None:
    depth = {share: np.ptp(saw(1e-3, stick_slip=share)[0][-2000:]) for share in (0.0, 0.25, 1.0)}
    assert depth[0.0] < 1e-6
    assert depth[0.25] == pytest.approx(depth[1.0] / 4, rel=1e-4)


def test_above_the_stribeck_speed_the_skin_slides_evenly() -> None:
    slow, fast = saw(4e-3)[0], saw(1.5 * VS)[0]
    assert np.ptp(slow[len(slow) // 2 :]) > 0.2
    assert np.ptp(fast[len(fast) // 2 :]) < 1e-6


def test_where_static_friction_is_not_above_kinetic_nothing_slips() -> None:
    q = saw(2e-3, static_coefficient=0.4)[0]
    assert np.all(np.diff(q) >= -1e-12)


def test_a_slip_is_smooth_and_within_a_kilohertz() -> None:
    """A step between nodes through the spline: below 1e-3 of a hertz's share from 1 kHz up.

    Its slope is at most 2/3 of the step per node.
    """
    found = shear_of(rubbed(stick_slip=1.0), stroke(3e-3, 1.0))[2000:, 0]
    over = 0.3 * math.exp(-((3e-3 / VS) ** 2))
    high, low = (
        expected_stretch(q * 0.5, DISPLAY, FingerLoad.low(), static_shear(DISPLAY))
        for q in (0.5 + over, 0.5 - over)
    )
    steepest = np.abs(np.diff(found)).max() * NODE_TIME * RATE
    assert 3e-6 < np.ptp(found) < high - low
    assert steepest < (2 / 3) * (high - low)
    power = np.abs(np.fft.rfft(np.diff(found) * np.hanning(len(found) - 1))) ** 2
    frequency = np.fft.rfftfreq(len(found) - 1, 1 / RATE)
    assert power[frequency > 1000].sum() < 1e-5 * power.sum()


# In time


def test_between_nodes_runs_a_uniform_cubic_b_spline() -> None:
    """Scipy's; a node's own values begin at it, so that no later one is needed."""
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
    """Slips, reversals and a lift included; float32 sums in another order."""
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
    """Held to float32; after 4 GIVE μ of the way back 1 − 2 e⁻⁴ of it is on the other side."""
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


@settings(deadline=None, max_examples=25, derandomize=True)
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
        moved = motion(motion.taken(place[k : k + 50], force[k : k + 50]))
        assert moved is not None
        found = stretch(moved, [(rubbing, Ramp(0.01, 3.0))])
        assert found is not None
        assert np.isfinite(found).all()
        assert np.abs(found).max() <= STROKE_SHARE * most * (1 + 1e-6)


# Beside textures


def test_layers_add_up_with_their_gains_and_fade_over_smoothly() -> None:
    """Going over to another takes the fade."""
    few, many = (
        Layer(DISPLAY, rubbed(static_coefficient=mu, kinetic_coefficient=mu)) for mu in (0.2, 0.6)
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
    layer = Layer(DISPLAY, rubbed(stick_slip=0.3))
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
    assert Layer(DISPLAY, grating).friction is None


# On the skin


@pytest.mark.parametrize("finger", ["low", "high"])
def test_the_skin_follows_slow_stretch_within_a_percent(finger: str) -> None:
    """Through the time-domain plant, reversals at 1 Hz and slips, down to 0 Hz; 40 dB above."""
    load = getattr(FingerLoad, finger)()
    display = one(load_display("reference-24", load=load))
    n = np.arange(16000)
    x = 2.5e-3 * np.sin(2 * np.pi * n / RATE)
    renderer = Renderer(display, rubbed(stick_slip=1.0))
    drive, shear = renderer.block(np.column_stack([x, 0 * x]), np.full(len(n), 0.5), shear=True)
    plant = Plant(display.bimorph, load, RATE, contactors=1)
    played = plant.step(drive)[0][plant.delay + renderer.delay :]
    wanted = shear[renderer.delay : renderer.delay + len(played)]
    assert np.abs(played - wanted)[800:].max() < 0.01 * np.abs(wanted).max()
    judge = Fidelity(RATE)
    judge.add(wanted[800:], played[800:])
    assert judge.signal_to_error_db > 40
    assert np.abs(drive).max() < (STROKE_SHARE + 0.05) * display.limits.voltage


def one(display: Display) -> Display:
    """Return the display's first contactor alone."""
    return replace(
        display,
        contactors=display.contactors[:1],
        shear_direction=display.shear_direction[:1],
        polarity=display.polarity[:1],
        channel=np.zeros(1, np.intp),
        kind=display.kind[:1],
    )
