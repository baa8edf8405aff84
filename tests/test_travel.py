"""No drive swings a tip without a finger further than it survives.

What tips do is taken from `Plant` and `TouchedPlant`, which know five modes of a beam and share no
code with the one pole of the limiter. Bounds on the plants are met within 1 %, which is what the
other modes and the course between samples make of a travel; those of the model itself are exact.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strength_rig import few

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.benders import BENDERS
from tactile.actuator.bimorph_actuator import BimorphActuator
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import LARGEST_STRESS
from tactile.actuator.plant import Plant, beam_modes
from tactile.actuator.response import tip_response
from tactile.actuator.touch import Touch
from tactile.actuator.touched_plant import TouchedPlant
from tactile.arrays import Floats
from tactile.display.display import Display, load_display
from tactile.playback.gain_search import largest_gain
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.rendering.free_tip import FreeTip, free_tip_of, largest_share, travel_voltage
from tactile.rendering.limiter import Limiter
from tactile.rendering.renderer import Renderer, limiter_of
from tactile.rendering.spectrum import FrameLimiter, band_carriers
from tactile.rendering.travel import TravelStage
from tactile.strength.strength import SteadyStroke, automatic_gain, texture_strength
from tactile.texture.surface import load_texture

RATE = 8000.0
RESONANCE = 930.0
"""First resonance of the default design in air, to a hertz [Hz]."""
OTHER_MODES = 1.01
"""Part of the largest travel up to which the plants may swing."""


def limited(display: Display, volts: Floats, size: int = 64) -> tuple[Floats, Limiter]:
    """Return what the limiter makes of a drive (S, N) in blocks, with its delay removed."""
    device = limiter_of(display, RATE)
    line = np.concatenate([volts, np.zeros((device.delay, volts.shape[1]))])
    parts = [device(line[k : k + size]) for k in range(0, len(line), size)]
    return np.concatenate(parts)[device.delay :], device


def in_air(display: Display, volts: Floats) -> Floats:
    """Return the travel (S, N) of free tips for a drive, and of the time after its end [m]."""
    plant = Plant(
        display.bimorph, FingerLoad.none(), RATE,
        contactors=volts.shape[1], amplifier=display.amplifier,
    )  # fmt: skip
    rest = np.zeros((200 + plant.delay, volts.shape[1]))
    return plant.step(np.concatenate([volts, rest]))[0][plant.delay :]


def tone(frequency: float, amplitude: float, seconds: float = 1.0) -> Floats:
    """Return a sinusoid (S, 1)."""
    time = np.arange(round(seconds * RATE)) / RATE
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency * time)[:, None])


@pytest.fixture
def one(pair: Display) -> Display:
    """Return one contactor of the reference display."""
    return few(pair, 0)


# How far a tip may swing


def test_the_largest_travel_stresses_the_outer_fiber_as_far_as_it_withstands() -> None:
    """Curvature at the clamp from the shape of an Euler-Bernoulli cantilever, by differences."""
    bimorph = load_display("reference-24").bimorph
    root, length = 1.87510407, float(bimorph.length)
    x = np.linspace(0, 1, 100_001)
    ratio = (math.cosh(root) + math.cos(root)) / (math.sinh(root) + math.sin(root))
    shape = np.cosh(root * x) - np.cos(root * x) - ratio * (np.sinh(root * x) - np.sin(root * x))
    curvature = np.diff(shape[:200], 2).mean() / (x[1] * length) ** 2 / shape[-1]
    travel = BimorphActuator(bimorph).largest_travel
    strain = curvature * travel * float(bimorph.height) / 2
    assert strain / float(bimorph.piezo.s11E) == pytest.approx(LARGEST_STRESS, rel=4e-3)
    assert travel == pytest.approx(141e-6, rel=5e-3)


def test_a_display_can_be_driven_at_rest_up_to_its_voltage_limit(one: Display) -> None:
    """A bender at 180 V bends further at rest than it may swing: that is its limit then."""
    strong = few(one, 0, volts=180.0)
    at_rest = 180 * abs(strong.response_in_air(np.zeros(1), RATE)[0])
    assert strong.actuator.largest_travel < at_rest
    tip = free_tip_of(strong, RATE)
    assert tip is not None
    assert tip.largest == 180.0
    slowly = 179.9999 * (1 - np.cos(np.linspace(0, np.pi, 32_000))[:, None]) / 2
    volts = np.concatenate([slowly, np.full((8000, 1), slowly[-1, 0])])
    device = limiter_of(strong, RATE)
    np.testing.assert_array_equal(device(volts)[8:], volts[:-8])
    assert device.limited_samples == 0


# The model


@pytest.mark.parametrize("rate", [4000.0, 8000.0, 48_000.0])
def test_the_model_swings_as_the_response_in_air_says(one: Display, rate: float) -> None:
    """Rest and resonance are met exactly; |z| ripples by half a turn's damping, 2 %."""
    tip = free_tip_of(one, rate)
    assert tip is not None
    time = np.arange(round(rate)) / rate
    at_rest = abs(one.response_in_air(np.zeros(1), rate)[0])
    for frequency in (1.0, RESONANCE):
        swing = tip.swing(np.cos(2 * np.pi * frequency * time)[:, None], np.zeros(1, complex))
        size = abs(one.response_in_air(np.array([frequency]), rate)[0]) / at_rest
        most = np.abs(swing[len(time) // 2 :]).max()
        assert most == pytest.approx(size, rel=0.02)


def test_the_swing_is_that_of_the_recursion_and_never_grows_without_drive(one: Display) -> None:
    tip = free_tip_of(one, RATE)
    assert tip is not None
    drive = np.random.default_rng(1).normal(0, 30, (300, 2))
    drive[200:] = 0.0
    state, found = np.array([3 + 1j, -2j]), []
    swing = tip.swing(drive, state)
    for row in drive:
        state = tip.pole * state + (1 - tip.pole) * row
        found.append(state)
    np.testing.assert_allclose(swing, found, rtol=1e-10)
    np.testing.assert_allclose(np.abs(swing[201:]), abs(tip.pole) * np.abs(swing[200:-1]))


@pytest.mark.parametrize("bender", sorted(BENDERS))
def test_the_resonance_is_found_for_every_bender(one: Display, bender: str) -> None:
    """The phase of a pole is its frequency; modes of the beam are found in another way."""
    design = replace(one, actuator=BimorphActuator(BENDERS[bender]))
    tip, rate = free_tip_of(design, 48_000.0), 48_000.0
    assert tip is not None
    first = beam_modes(BENDERS[bender]).frequency[0]
    assert np.angle(tip.pole) * rate == pytest.approx(first, rel=2e-3)


def test_an_amplifier_that_turns_the_resonance_down_allows_more_drive(one: Display) -> None:
    """A low-pass at 93 Hz leaves a tenth of it at 930 Hz."""
    slow = replace(one, amplifier=Amplifier(bandwidth=93.0))
    at = np.array([RESONANCE])
    ratio = travel_voltage(slow, at, RATE) / travel_voltage(one, at, RATE)
    assert ratio == pytest.approx(math.hypot(1, 10), rel=1e-6)


def test_what_may_be_added_ends_at_the_limit() -> None:
    random = np.random.default_rng(3)
    held, added = np.array([1, 1j]) @ random.normal(size=(2, 2, 40))
    held *= 0.99 / np.abs(held).max()
    share = largest_share(held, added, 1.0)
    assert np.abs(held + share * added).max() == pytest.approx(1.0, rel=1e-12)
    assert np.abs(held + 0.999 * share * added).max() < 1
    assert largest_share(held, np.zeros(40, complex), 1.0) == np.inf
    assert largest_share(np.ones(1, complex), np.ones(1, complex), 1.0) == 0


# What is put out


@pytest.mark.parametrize("amplitude", [6.0, 100.0])
def test_a_steady_tone_at_the_resonance_ends_at_the_limit(one: Display, amplitude: float) -> None:
    out, device = limited(one, tone(RESONANCE, amplitude))
    travel = np.abs(in_air(one, out))[:, 0]
    most = one.actuator.largest_travel
    assert travel.max() <= OTHER_MODES * most
    assert travel[4000:8000].max() == pytest.approx(most, rel=0.02)
    assert device.limited_samples > 7000


def test_without_the_limit_that_tone_would_break_the_bender(one: Display) -> None:
    travel = np.abs(in_air(one, tone(RESONANCE, 100.0))).max()
    assert travel > 30 * one.actuator.largest_travel


def test_a_turned_down_tone_stays_a_tone(one: Display) -> None:
    """Gain moves in steps of the release, a hundredth in each period: −20 dB of the small rest."""
    out, _ = limited(one, tone(RESONANCE, 100.0, 2.0))
    spectrum = np.abs(np.fft.rfft(out[-8000:, 0] * np.hanning(8000))) ** 2
    near = spectrum[900:961].sum()
    assert (spectrum.sum() - near) / near < 0.02


@pytest.mark.parametrize(
    ("frequency", "amplitude"), [(20.0, 99.9), (250.0, 99.9), (700.0, 60.0), (930.0, 2.8)]
)
def test_what_a_free_tip_survives_leaves_bit_for_bit(
    one: Display, frequency: float, amplitude: float
) -> None:
    volts = tone(frequency, amplitude) * np.linspace(0, 1, 8000)[:, None] ** 2
    out, device = limited(one, volts)
    np.testing.assert_array_equal(out, volts)
    assert device.limited_samples == 0


def test_the_gain_recovers_and_drive_leaves_bit_for_bit_again(one: Display) -> None:
    quiet = tone(250.0, 30.0, 3.0)
    out, _ = limited(one, np.concatenate([tone(RESONANCE, 99.0, 0.2), quiet]))
    assert not np.array_equal(out[1600:4000], quiet[:2400])
    np.testing.assert_array_equal(out[-8000:], quiet[-8000:])


def test_channels_keep_their_ratios_and_the_furthest_decides(one: Display, pair: Display) -> None:
    loud = tone(RESONANCE, 100.0, 0.3)
    out, _ = limited(pair, loud * [0.1, -1.0])
    alone, _ = limited(one, loud)
    np.testing.assert_allclose(out[:, :1], -0.1 * out[:, 1:], atol=1e-9)
    np.testing.assert_allclose(out[:, 1:], -alone, atol=1e-6)


def test_the_limit_can_be_left_to_the_amplifier(one: Display) -> None:
    volts = tone(RESONANCE, 40.0)
    device = limiter_of(one, RATE)
    device.leave_travel(np.ones(1, np.bool_))
    np.testing.assert_array_equal(device(volts)[8:], volts[:-8])


@pytest.mark.parametrize("size", [16, 64, 400])
def test_a_contactor_that_no_guard_watches_any_more_is_bounded(pair: Display, size: int) -> None:
    """The other contactor, at an eightieth of the drive, is bounded all the time and never near."""
    volts = tone(RESONANCE, 90.0) * np.array([1 / 80, 1.0])
    device, parts = limiter_of(pair, RATE), []
    for k in range(0, len(volts), size):
        device.leave_travel(np.array([False, k < 4000]))
        parts.append(device(volts[k : k + size]))
    out = np.concatenate(parts)[device.delay :]
    left = 4000 // size * size - device.delay
    np.testing.assert_array_equal(out[:left], volts[:left])
    assert device.limited_samples > 3000
    settled = out[6000:]
    np.testing.assert_allclose(settled[:, 1], 80 * settled[:, 0], atol=1e-9)
    tip = free_tip_of(pair, RATE)
    assert tip is not None
    start = -(-4000 // size) * size - device.delay
    swung = tip.swing(out[start:], out[start - 1].astype(complex))
    assert np.abs(swung).max() <= tip.largest, "from the first sample on"
    swing = np.abs(in_air(pair, settled))[1000:-300, 1]
    assert swing.max() == pytest.approx(pair.actuator.largest_travel, rel=0.02)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("slew", "volts"), [(7e5, 90.0), (3e5, 45.0), (1e5, 12.0)])
def test_a_contactor_that_a_guard_watches_has_no_part_in_the_travel(
    one: Display, pair: Display, slew: float, volts: float, seed: int
) -> None:
    """The other one leaves as it would alone: bursts of its resonance, and noise.

    Where the limit holds a drive, a difference in rounding grows tenfold in about 400 samples.
    """
    random = np.random.default_rng(seed)
    bursts = _gated(random, np.arange(1000) / RATE) * random.uniform(20, 100)
    loud = np.concatenate([bursts, 100 * _noise(random, np.zeros(1000)), np.zeros(1000)])[:, None]
    both = np.hstack([loud, tone(RESONANCE, volts, len(loud) / RATE)])
    limits = replace(pair.limits, slew=slew)
    alone, _ = limited(replace(one, limits=limits), loud)
    device, parts = limiter_of(replace(pair, limits=limits), RATE), []
    device.leave_travel(np.array([False, True]))
    line = np.concatenate([both, np.zeros((device.delay, 2))])
    for k in range(0, len(line), 64):
        parts.append(device(line[k : k + 64]))
    out = np.concatenate(parts)[device.delay :]
    assert device.limited_samples > 2000
    np.testing.assert_allclose(out[:, :1], alone, atol=1e-6)


def test_a_contactor_returns_to_the_limiter_at_rest_under_its_drive(one: Display) -> None:
    """A finger held the tip until then: what a free tip would have swung is not taken for true."""
    volts = np.concatenate([tone(RESONANCE, 60.0, 0.5), np.full((4000, 1), 0.0)])
    volts[4000:] = 30 * np.sin(2 * np.pi * 100 * np.arange(4000)[:, None] / RATE)
    device = limiter_of(one, RATE)
    device.leave_travel(np.ones(1, np.bool_))
    first = device(volts[:4008])  # and nothing of the tone waits to be put out
    device.leave_travel(np.zeros(1, np.bool_))
    out = np.concatenate([first, device(volts[4008:])])
    np.testing.assert_array_equal(out[8:], volts[:-8])
    assert device.limited_samples == 0


# Whatever comes in


def _gated(random: np.random.Generator, time: Floats) -> Floats:
    frequency, gate = random.uniform(900, 960), random.uniform(5, 200)
    return np.asarray((np.sin(2 * np.pi * gate * time) > 0) * np.sin(2 * np.pi * frequency * time))


def _square(random: np.random.Generator, time: Floats) -> Floats:
    odd = RESONANCE / random.choice([1, 3, 5, 93])
    return np.asarray(np.sign(np.sin(2 * np.pi * odd * time + random.uniform(0, 6))))


def _noise(random: np.random.Generator, time: Floats) -> Floats:
    return random.uniform(-1, 1, len(time))


def _signs(random: np.random.Generator, time: Floats) -> Floats:
    return np.sign(random.normal(size=len(time)))


def _holes(random: np.random.Generator, time: Floats) -> Floats:
    trouble = random.choice([math.nan, math.inf, -math.inf, 1e308], len(time))
    return np.where(random.uniform(size=len(time)) < 0.1, trouble / 1e3, _gated(random, time))


def _chirp(random: np.random.Generator, time: Floats) -> Floats:
    return np.sin(2 * np.pi * (200 * time + random.uniform(200, 2000) * time**2))


DRIVES: list[Callable[[np.random.Generator, Floats], Floats]] = [
    _gated, _square, _noise, _signs, _holes, _chirp,
]  # fmt: skip


@st.composite
def streams(draw: st.DrawFn) -> tuple[float, list[Floats], list[int]]:
    """Return the largest step [V], drives (S, 2) of two contactors and how they are cut."""
    step = draw(st.sampled_from([2.0, 10.0, 40.0, 87.5, 300.0]))
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    parts = []
    for kind in draw(st.lists(st.integers(0, len(DRIVES) - 1), min_size=1, max_size=4)):
        time = np.arange(random.integers(1, 1200)) / RATE
        size = 10 ** random.uniform(0, 3)
        parts.append(size * np.stack([DRIVES[kind](random, time) for _ in range(2)], axis=1))
    sizes = draw(st.lists(st.integers(0, 300), min_size=1, max_size=6))
    return step, parts, sizes


def _cut(device: Limiter, volts: Floats, sizes: list[int]) -> Floats:
    """Return what comes out of a limiter in blocks of changing sizes."""
    out, at, turn = [np.zeros((0, volts.shape[1]))], 0, 0
    while at < len(volts):
        size = max(sizes[turn % len(sizes)], int(max(sizes) == 0))
        out.append(device(volts[at : at + size]))
        at, turn = at + size, turn + 1
    return np.concatenate(out)


@pytest.mark.ci
@settings(max_examples=60)
@given(stream=streams())
def test_whatever_comes_in_no_free_tip_swings_too_far(
    pair: Display, stream: tuple[float, list[Floats], list[int]]
) -> None:
    """Voltage, step and the model's travel hold exactly, and the plant's within 1 %."""
    step, parts, sizes = stream
    display = replace(pair, limits=replace(pair.limits, slew=step * RATE, current=math.inf))
    volts = np.concatenate([*parts, np.zeros((8, 2))])
    with np.errstate(invalid="ignore", over="ignore"):
        out = _cut(limiter_of(display, RATE), volts, sizes)
    assert np.abs(out).max() <= 100
    assert np.abs(np.diff(out, axis=0, prepend=np.zeros((1, 2)))).max() <= step
    tip = free_tip_of(display, RATE)
    assert tip is not None
    assert np.abs(tip.swing(out, np.zeros(2, complex))).max() <= tip.largest
    assert np.abs(in_air(display, out)).max() <= OTHER_MODES * display.actuator.largest_travel


def _stage(
    display: Display, step: float, ahead: int = 0, voltage: float = 100.0
) -> tuple[FreeTip, TravelStage]:
    """Return the model and the stage of two contactors, whose gain recovers at once."""
    tip = free_tip_of(display, RATE)
    assert tip is not None
    return tip, TravelStage(tip, voltage, step, recovery=0.9, ahead=ahead, channels=2)


@pytest.mark.parametrize("step", [5.0, 12.0, 30.0, 60.0, 90.0])
def test_a_way_out_is_left_for_what_nobody_foresees(one: Display, step: float) -> None:
    """A drive of full voltage, without look-ahead, may turn at any sample; steps are exact, too."""
    for seed in range(40):
        random = np.random.default_rng(seed)
        tip, stage = _stage(one, step)
        turns = random.integers(1, 12, 60)
        volts = np.repeat(random.choice([-99.0, 0.0, 50.0, 99.0], (60, 2)), turns, axis=0)
        if seed % 2:  # steps that are small enough to pass as they are
            volts = np.cumsum(np.clip(np.diff(volts, axis=0), -step, step) * 0.7, axis=0)
            volts *= 99 / max(np.abs(volts).max(), 99)
        out, last = [], np.zeros(2)
        for part in np.array_split(volts, len(volts) // 3):
            out.append(stage(part, np.ones(len(part)), last).drive)
            last = out[-1][-1]
        drive = np.concatenate(out)
        assert np.abs(tip.swing(drive, np.zeros(2, complex))).max() <= tip.largest
        assert np.abs(np.diff(drive, axis=0, prepend=0.0)).max() <= step * (1 + 1e-12)
        assert np.abs(drive).max() <= 99.0 * (1 + 1e-12)


def test_what_passes_leaves_a_way_out_at_each_sample(one: Display) -> None:
    """The way out falls by 0.3 a sample; tones near the limit pass if they leave that way."""
    passed = 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        turns = random.uniform(0.1, 0.13, 2) * np.arange(24)[:, None] + random.uniform(size=2)
        volts = np.sin(2 * np.pi * turns)
        tip, stage = _stage(one, 30.0)
        rest = np.zeros(2, complex)
        volts *= random.uniform(0.6, 1) * tip.largest / np.abs(tip.swing(volts, rest)).max()
        if stage.passes(volts, np.zeros(2)):
            passed += 1
            for n in range(1, 25):
                out = volts[n - 1] * 0.7 ** np.arange(1, 60)[:, None]
                swing = tip.swing(np.concatenate([volts[:n], out]), rest)
                assert np.abs(swing).max() <= tip.largest
    assert 5 < passed < 60


def test_what_exceeds_the_travel_at_one_sample_does_not_pass(one: Display) -> None:
    """Noise whose swing exceeds the limit by 0.5 % at one sample, and by nothing elsewhere."""
    for seed in range(40):
        volts = np.random.default_rng(seed).normal(size=(40 + seed % 7, 2))
        tip, stage = _stage(one, 1000.0, ahead=8, voltage=1000.0)
        volts *= 1.005 * tip.largest / np.abs(tip.swing(volts, np.zeros(2, complex))).max()
        assert not stage.passes(volts, np.zeros(2))
        assert stage.passes(0.99 * volts, np.zeros(2))


@pytest.mark.parametrize("at", range(20))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308, 100.5, 80.0])
def test_no_sample_beyond_voltage_or_step_passes(one: Display, bad: float, at: int) -> None:
    """Steps to and from 80 V are larger than the 60 V that are allowed."""
    for contactor in range(2):
        _, stage = _stage(one, 60.0, ahead=8)
        volts = np.full((20, 2), 15.0)
        volts[at, contactor] = bad
        assert not stage.passes(volts, np.full(2, 15.0))
        assert stage.passes(np.full((20, 2), 15.0), np.full(2, 15.0))
        assert not stage.passes(np.full((20, 2), 15.0), np.full(2, -50.0))


@pytest.mark.parametrize("at", range(1, 20))
def test_a_jump_on_a_slope_does_not_pass(one: Display, at: int) -> None:
    """A slope of 3 V a sample passes; a step of 21 V in it does not, where 20 V are allowed."""
    _, stage = _stage(one, 20.0, ahead=8)
    slope = np.linspace(-30, 27, 20)[:, None] * np.ones(2)
    assert stage.passes(slope, slope[0])
    _, stage = _stage(one, 20.0, ahead=8)
    slope[at:, 1] += 18 if at < 10 else -24
    assert not stage.passes(slope, slope[0])


@pytest.mark.ci
@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), sizes=st.lists(st.integers(0, 300), min_size=1, max_size=6))
@example(seed=0, sizes=[1])
@example(seed=1, sizes=[0, 8, 9])
def test_what_leaves_does_not_depend_on_how_the_stream_is_cut(
    pair: Display, seed: int, sizes: list[int]
) -> None:
    """Outputs agree within rounding, which the feedback keeps below a millionth."""
    random = np.random.default_rng(seed)
    time = np.arange(1500) / RATE
    kinds = random.integers(len(DRIVES), size=2)
    volts = 10 ** random.uniform(1, 2.5) * np.stack([DRIVES[k](random, time) for k in kinds], 1)
    whole, cut = limiter_of(pair, RATE), limiter_of(pair, RATE)
    np.testing.assert_allclose(_cut(cut, volts, sizes), whole(volts), atol=1e-4)
    assert abs(cut.limited_samples - whole.limited_samples) <= 3


class Definition:
    """What the limiter is to do, sample by sample, for a display of 100 V."""

    def __init__(self, display: Display, contactors: int) -> None:
        tip = free_tip_of(display, RATE)
        assert tip is not None
        self.tip, self.largest = tip, tip.largest * (1 - 5e-10)
        self.voltage, self.step = 100 * (1 - 1e-9), display.slew / RATE * (1 - 1e-9)
        self.falls = max(1 - self.step / self.voltage, 0.0) ** np.arange(200)[:, None]
        self.release = math.exp(-1 / (0.1 * RATE))
        self.state, self.last = np.zeros(contactors, complex), np.zeros(contactors)
        self.needed, self.held, self.reduction = [1.0] * 8, [1.0] * 8, 0.0
        self.limited = self.guarded = 0

    def released(self, reduction: float) -> float:
        return reduction * self.release if reduction * self.release >= 1e-6 else 0.0

    def share(self, start: Floats, more: Floats, keep: float, ahead: Floats) -> float:
        """Return how much of a sample beside a start a free tip survives, and of a look-ahead."""
        drives = [(self.falls * start, self.falls * more), (0 * ahead, ahead)]
        held = np.concatenate([self.tip.swing(d, self.state) for d, _ in drives])
        added = np.concatenate([self.tip.swing(d, 0 * self.state) for _, d in drives])
        over = np.abs(held + keep * added) > self.largest
        over[len(self.falls) : -1] = False  # of the look-ahead, its end
        return largest_share(held[over], added[over], self.largest)

    def put_out(self, seen: Floats) -> Floats:
        """Return the next sample; ``seen`` are it and the eight after it."""
        step = np.abs(seen[-1] - seen[-2]).max() / self.step
        self.needed.append(1 / max(np.abs(seen[-1]).max() / self.voltage, step, 1.0))
        self.held.append(min(*self.needed[-9:], 1 - self.released(1 - self.held[-1])))
        gain, reduction = np.mean(self.held[-9:]), self.released(self.reduction)
        share = self.share(0 * seen[0], gain * seen[0], 1 - reduction, gain * seen)
        self.reduction = max(reduction, 1 - share)
        gain *= 1 - self.reduction
        self.limited += int(gain < 1 - 1e-6)
        sample, farthest = gain * seen[0], np.abs(gain * seen[0] - self.last).max()
        if farthest > self.step:
            sample = self.last + (sample - self.last) * self.step / farthest
            start = self.falls[1] * self.last
            share = self.share(start, sample - start, 1.0, 0 * seen)
            sample = start + min(1.0, share) * (sample - start)
            self.guarded += 1
        self.state = self.tip.pole * self.state + (1 - self.tip.pole) * sample
        self.last = np.asarray(sample)
        return self.last


@pytest.mark.parametrize("step", [10.0, 40.0, 87.5, 300.0])
@pytest.mark.parametrize("seed", range(6))
def test_what_leaves_is_what_the_definition_says(pair: Display, step: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    display = replace(pair, limits=replace(pair.limits, slew=step * RATE, current=math.inf))
    kinds = [_gated, _square, _noise, _signs, _chirp]
    make = [kinds[k] for k in random.integers(len(kinds), size=2)]
    volts = 10 ** random.uniform(1, 2.5) * np.stack(
        [f(random, np.arange(300) / RATE) for f in make], 1
    )
    volts[:20], volts[250:] = 0.0, 0.0
    device, definition = limiter_of(display, RATE), Definition(display, 2)
    line = np.concatenate([np.zeros((9, 2)), volts])
    expected = [definition.put_out(line[n + 1 : n + 10]) for n in range(300)]
    out = _cut(device, volts, [16, 64, 5])
    np.testing.assert_allclose(out, expected, atol=1e-6)
    assert device.limited_samples == definition.limited
    assert device.guarded_samples == definition.guarded


# When the finger leaves


def lift_off(display: Display, volts: Floats, at: float) -> Floats:
    """Return the displacement of tips that lose a stiff finger within 5 ms."""

    def force(time: Floats) -> Floats:
        return np.clip(1 - (time - at) / 5e-3, 0, 1)

    plant = TouchedPlant(
        display.bimorph, Touch(load=FingerLoad.high(), force=force), RATE,
        contactors=volts.shape[1],
    )  # fmt: skip
    return plant.step(np.concatenate([volts, np.zeros((plant.delay, volts.shape[1]))]))[0]


def test_a_tip_that_loses_the_finger_does_not_swing_too_far(one: Display) -> None:
    """2 µm at 920 Hz under a stiff finger, and at 930 Hz, swing a free tip by over 500 µm.

    The finger's leaving adds a transient, which beats with a tone beside the resonance.
    """
    for frequency, beats in ((920.0, 1.07), (RESONANCE, OTHER_MODES)):
        loaded = tip_response(one.bimorph, FingerLoad.high(), [frequency]).displacement[0]
        volts = tone(frequency, 2e-6 / abs(loaded))
        assert np.abs(lift_off(one, volts, 0.3)).max() > 500e-6
        out, _ = limited(one, volts)
        travel = np.abs(lift_off(one, out, 0.3)).max()
        assert travel <= beats * one.actuator.largest_travel


# Who else counts it


@pytest.mark.parametrize("frequency", [700.0, RESONANCE])
def test_what_is_attainable_is_what_is_played(one: Display, frequency: float) -> None:
    """A tone of three times the drive comes out at the drive that the display can attain."""
    attained = Renderer(one, None).attainable[0, 0, round(frequency / 10)]
    response = abs(one.responses(np.array([frequency]), RATE)[0, 0, 0])
    out, _ = limited(one, tone(frequency, 3 * attained / response, 2.0))
    played = np.sqrt(2) * out[8000:].std()
    assert played == pytest.approx(attained / response, rel=0.15)
    assert attained < 90 * response


def test_the_automatic_gain_names_the_travel(pair: Display) -> None:
    """A grating that plays 930 Hz under a stiff finger."""
    stiff = replace(pair, load=FingerLoad.high())
    coin = load_texture("metal-coin-reeded", partials=192)
    stroke = SteadyStroke(speed=0.2)
    gain = automatic_gain(stiff, coin, stroke)
    assert gain.limit == "travel"
    assert texture_strength(stiff, coin, stroke, gain=gain.value).limited_share == 0
    assert texture_strength(stiff, coin, stroke, gain=2 * gain.value).limited_share > 0


def test_the_largest_gain_of_a_stroke_names_the_travel(pair: Display) -> None:
    stiff = replace(pair, load=FingerLoad.high())
    coin, line = load_texture("metal-coin-reeded"), Trajectory.line(speed=0.2, duration=1.0)
    found = largest_gain(stiff, coin, line, sample_rate=RATE)
    assert found.limit == "travel"
    assert run(stiff, coin, line, device="mock:", gain=found.value).limited_samples == 0
    assert run(stiff, coin, line, device="mock:", gain=1.05 * found.value).limited_samples > 0


@pytest.mark.parametrize("frequency", [900.0, RESONANCE, 980.0])
@pytest.mark.parametrize("frame_rate", [50.0, 100.0])
def test_frames_do_not_swing_a_free_tip_too_far(
    one: Display, frequency: float, frame_rate: float
) -> None:
    """A partial on its nearest carrier, of an envelope that turns from frame to frame."""
    carriers = band_carriers(16, frame_rate, RATE)
    spacing = round(RATE / frame_rate)
    nearest = int(np.abs(carriers - frequency).argmin())
    turn = 2 * np.pi * (frequency - carriers[nearest]) * np.arange(60) / frame_rate
    frames = np.zeros((60, 1, len(carriers)), complex)
    frames[:, 0, nearest] = 60 * np.exp(1j * turn)
    device = FrameLimiter(one, carriers, frame_rate, RATE)
    sent = np.array([device(frame) for frame in frames])[:, 0, nearest]
    at = np.arange(59 * spacing) / spacing
    envelope = np.interp(at, np.arange(60), sent.real) + 1j * np.interp(
        at, np.arange(60), sent.imag
    )
    volts = (envelope * np.exp(2j * np.pi * carriers[nearest] * at / frame_rate)).real[:, None]
    assert np.abs(in_air(one, volts)).max() <= OTHER_MODES * one.actuator.largest_travel
    assert device.limited_frames > 0
