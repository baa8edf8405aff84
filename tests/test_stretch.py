"""Skin stretch by friction: closed forms of law, bristle, slip and split; the same ODE by scipy.

What the renderer does with it is read from its shear, with a texture of one wave so small that
friction is all there is.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strength_rig import few
from stretch_rig import (
    DISPLAY,
    GIVE,
    NODE_TIME,
    RATE,
    STROKE_SHARE,
    VS,
    expected_stretch,
    law,
    rubbed,
    shear_of,
    static_shear,
    stroke,
)

from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.plant import Plant
from tactile.arrays import Floats
from tactile.display.display import load_display
from tactile.rendering.renderer import Renderer
from tactile.rendering.skin_stretch import Bristles
from tactile.sim import Fidelity

SLIP = 2
"""Nodes that a slip takes: the steep half of a spline's step."""

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


@pytest.mark.parametrize("angle", [0.5 * math.pi, -0.5 * math.pi, math.pi, 0.7, 2.4, -2.0])
@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_friction_is_the_same_along_any_direction(angle: float, share: float) -> None:
    """The stretch turns as the motion does, in sticking, slipping and sliding, back and forth."""
    along, turned = Bristles(law(stick_slip=share)), Bristles(law(stick_slip=share))
    cos, sin = math.cos(angle), math.sin(angle)
    speeds = [0.002, 0.005, 0.03, -0.004, -0.002, 0.06, 0.003]
    for step in np.repeat(speeds, 80) * 2e-3:
        q, _ = along.move(step, 0.0, 2e-3)
        assert turned.move(step * cos, step * sin, 2e-3) == pytest.approx(
            (q * cos, q * sin), abs=1e-9
        )


def test_far_above_the_stribeck_speed_friction_is_kinetic() -> None:
    bristles = Bristles(law())
    for _ in range(100):
        q = bristles.move(1e-3, 0.0, 1e-3)
    assert q == pytest.approx((0.5, 0.0))


@pytest.mark.parametrize("exponent", [-0.3, 0.0, 0.4])
def test_force_grows_as_its_power_one_above_the_coefficients(exponent: float) -> None:
    """The force is N (N/N0)^e in the middle of 0.2 … 2 N, where the bent ends take below 1 %."""
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
    """The reference is LuGre by scipy after a mean of the motion over 5 ms, two nodes, 4 ms late.

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
        change = (amplitude * rate * math.cos(rate * t) - v) / 5e-3
        return np.array([change, (v - q * abs(v) / 0.6) / GIVE])

    times = n / RATE
    ode = solve_ivp(slope, (0, 0.7), [0, 0], t_eval=times, rtol=1e-7, atol=1e-9, max_step=2e-3)
    attained = static_shear(DISPLAY)
    scale = [expected_stretch(q * 0.5, DISPLAY, FingerLoad.low(), attained) for q in ode.y[1]]
    late = 2 * NODE_TIME - NODE_TIME / 2
    expected = -np.interp(times - late, times, scale)
    error = found[1000:] - expected[1000:]
    assert np.abs(error).max() < 0.02 * np.ptp(expected)


# Direction and size


@pytest.mark.parametrize("finger", ["low", "high"])
@pytest.mark.parametrize("angle_deg", [0.0, 60.0, 90.0, 180.0, 250.0])
def test_stretch_points_against_the_motion_and_is_projected_on_the_axis(
    finger: str, angle_deg: float
) -> None:
    """The speed is 40 mm/s, where 1e-7 of the weakening is left; the grating leaves 1e-9 m."""
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


@pytest.mark.parametrize("axis", [0.5, -1.1, 2.0, math.pi / 2])
def test_an_axis_that_all_share_may_lie_at_any_angle(axis: float) -> None:
    turned = replace(DISPLAY, shear_direction=np.full(24, axis))
    found = shear_of(rubbed(), stroke(0.04, 0.3, 0.7), display=turned)[-1]
    size = expected_stretch(0.25, DISPLAY, FingerLoad.low(), static_shear(DISPLAY))
    np.testing.assert_allclose(found, -size * np.cos(axis - 0.7), atol=1e-9)


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


@pytest.mark.parametrize(("speed", "slips"), [(13.0e-3, True), (13.4e-3, False)])
def test_what_would_slip_more_often_than_every_second_node_slides_evenly(
    speed: float, slips: bool
) -> None:
    """A drop of two nodes' way is 0.6 exp(−(v/vs)²) − 4 v = 4 v, 2 ms a node: v is 13.18 mm/s."""
    q, top, _ = saw(speed)
    late = q[len(q) // 2 :]
    if slips:
        assert np.ptp(late) > 0.01
    else:
        np.testing.assert_allclose(late, top, atol=1e-6)


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


def test_nodes_are_2_ms_apart() -> None:
    """The fourth difference of a cubic is nothing: what is left of it is at nodes alone."""
    found = shear_of(rubbed(stick_slip=1.0), stroke(3e-3, 1.0))[2000:, 0].astype(np.float64)
    bend = np.abs(np.diff(found, 4))
    at = np.flatnonzero(bend > 0.3 * bend.max())
    assert len(at) > 8
    assert len(set(at % round(NODE_TIME * RATE))) == 1


# On the skin


@pytest.mark.parametrize("finger", ["low", "high"])
def test_the_skin_follows_slow_stretch_within_a_percent(finger: str) -> None:
    """Errors of reversals at 1 Hz and slips are 40 dB down in the time-domain plant."""
    load = getattr(FingerLoad, finger)()
    display = few(load_display("reference-24", load=load), 0)
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
