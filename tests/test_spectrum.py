"""Spectrum frames: carriers and shares in closed form, frames against sums over waves and samples.

What carriers play between frames is written out in time here (straight lines times phasors); the
module knows it by its spectrum only.
"""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed
from scipy.special import i0

from benchmarks.spectrum import along, sampled
from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.response import tip_response
from tactile.arrays import Complex, Floats
from tactile.display.display import Display, load_display
from tactile.errors import InputError
from tactile.rendering.shear import Law
from tactile.rendering.spectrum import (
    SpectrumRenderer,
    carrier_frequencies,
    shares,
)
from tactile.texture.perception import detection_threshold
from tactile.texture.surface import Texture, load_texture, without_friction

RATE = 8000.0


def without_envelope(name: str) -> Texture:
    texture = load_texture(name)
    assert texture.descriptor.stochastic is not None
    even = changed(texture.descriptor.stochastic, am_depth=0.0, excess_kurtosis=0.0)
    return replace(texture, descriptor=changed(texture.descriptor, stochastic=even, events=()))


def straight(values: Complex, samples: int) -> Complex:
    """Return values (K, ...) joined by straight lines, ((K − 1) × samples, ...)."""
    part = (np.arange(samples) / samples).reshape(-1, *[1] * (values.ndim - 1))
    pieces = [a + (b - a) * part for a, b in pairwise(values)]
    return np.concatenate(pieces)


def played(frames: Complex, carriers: Floats, spacing: int) -> Floats:
    """Return what an amplifier makes of frames (K, N, P), first at sample 0."""
    envelope = straight(frames, spacing)
    time = np.arange(len(envelope)) / RATE
    line = envelope * np.exp(2j * np.pi * np.outer(time, carriers))[:, None]
    return np.asarray(line.real.sum(axis=2))


# Carriers


def test_sixteen_at_50_hz_are_six_third_octaves_above_even_ones() -> None:
    found = carrier_frequencies(16, 50.0)
    np.testing.assert_allclose(found[10:], 1000 * 10 ** (np.arange(-5, 1) / 10), rtol=1e-12)
    apart = 1000 * 10**-0.55 / 9.1  # nine more sub-bands up to the sixth third octave, the first
    np.testing.assert_allclose(found[1:10], apart * (np.arange(9) + 0.6), rtol=1e-12)  # shorter
    assert found[0] == 0
    assert apart <= 0.62 * 50


@given(st.integers(1, 64), st.floats(20, 400))
def test_any_number_of_carriers_ascends_from_0_hz_and_stays_in_the_band(
    count: int, frame_rate: float
) -> None:
    found = carrier_frequencies(count, frame_rate)
    assert found.shape == (count,)
    assert found[0] == 0
    assert np.all(np.diff(found) > 0)
    assert found[-1] < 1000 * 10**0.05, "the end of the third octave at 1 kHz"


def test_sub_bands_are_narrower_where_the_skin_is_more_sensitive() -> None:
    found = carrier_frequencies(16, 50.0)
    middle, width = (found[1:] + found[:-1]) / 2, np.diff(found)
    sensitive = (middle > 150) & (middle < 300)
    dull = middle > 500
    assert detection_threshold(middle[sensitive]).max() < detection_threshold(middle[dull]).min()
    assert width[sensitive].max() < 0.5 * width[dull].min()


# Shares


@pytest.mark.parametrize("offset", [0.0, 5.0, 25.0, 49.0, 120.0])
def test_one_carrier_alone_makes_up_for_what_straight_ramps_lose(offset: float) -> None:
    """2/3 + cos(2πδ/R)/3 of the power."""
    found = shares(np.array([300 + offset]), np.array([300.0]), 50.0)
    lost = 2 / 3 + np.cos(2 * np.pi * offset / 50) / 3
    np.testing.assert_allclose(found, 1 / np.sqrt(lost), rtol=1e-4)


@settings(max_examples=60)
@given(st.floats(0, 1200), st.sampled_from([(16, 50.0), (16, 100.0), (8, 100.0)]))
def test_a_partial_keeps_its_power_wherever_it_is(
    frequency: float, case: tuple[int, float]
) -> None:
    """Straight lines between frames, as seen from the partial, repeat in each frame."""
    carriers = carrier_frequencies(*case)
    share = shares(np.array([frequency]), carriers, case[1])[0]
    turn = np.exp(2j * np.pi * np.outer([0, 1], frequency - carriers) / case[1])
    envelope = straight(turn * share, 200)
    time = np.arange(200) / (200 * case[1])
    line = (envelope * np.exp(2j * np.pi * np.outer(time, carriers))).sum(axis=1)
    assert np.mean(np.abs(line) ** 2) == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("frequency", [17.0, 60.0, 104.0, 180.0, 233.0])
def test_neighbors_cancel_the_images_of_one_carrier_alone(frequency: float) -> None:
    """The partial's own line has all but 1/200 of the power; alone it would have half at worst."""
    carriers = carrier_frequencies(16, 50.0)
    share = shares(np.array([frequency]), carriers, 50.0)[0]
    own = (share * np.sinc((frequency - carriers) / 50) ** 2).sum()
    assert 1 - own**2 < 1 / 200


def test_a_partial_on_a_carrier_is_on_it_alone() -> None:
    carriers = carrier_frequencies(16, 50.0)
    np.testing.assert_allclose(shares(carriers, carriers, 50.0), np.eye(16), atol=1e-9)


def test_shares_do_not_jump_where_a_partial_crosses_an_edge() -> None:
    carriers = carrier_frequencies(16, 50.0)
    edges = (carriers[1:] + carriers[:-1]) / 2
    step = 1e-3
    change = shares(edges + step, carriers, 50.0) - shares(edges - step, carriers, 50.0)
    assert np.abs(change).max() < 2 * step * 0.5
    across = np.concatenate([edges - 10, edges + 10])
    assert np.abs(np.diff(shares(np.sort(across), carriers, 50.0), axis=0)).max() > 0.1


# Frames


def written_out(
    r: SpectrumRenderer, display: Display, texture: Texture, place: Floats, velocity: Floats
) -> Complex:
    """Return a frame at sample 0 as the sum over waves, at 0.5 N."""
    waves = texture.realize().partials
    rate = RATE / r.spacing
    total = np.zeros((len(display.contactors), len(r.carriers)), complex)
    for k, a, phi in zip(waves.wave_vector, waves.amplitude, waves.phase, strict=True):
        f = float(k @ velocity) / (2 * np.pi)
        if abs(f) >= 1250:
            continue
        weight = 1.0 if abs(f) <= 1000 else (1 + np.cos(np.pi * (abs(f) - 1000) / 250)) / 2
        response = tip_response(display.bimorph, display.load_at(0.5), [abs(f)]).displacement[0]
        phasor = a * np.exp(1j * ((place + display.contactors) @ k + phi))
        phasor = phasor.conj() if f < 0 else phasor
        total += np.outer(phasor, shares(np.array([abs(f)]), r.carriers, rate)) * weight / response
    law = Law(texture.descriptor)(np.array([velocity @ velocity]), np.array([0.5]))
    return np.asarray(total * law)


@pytest.mark.parametrize("velocity", [(0.08, 0.0), (-0.05, 0.03), (0.2, 0.1)])
def test_a_frame_is_the_sum_over_waves_on_their_carriers(velocity: tuple[float, float]) -> None:
    """Frames agree within 1 % of the largest value, which is what a table of 1 Hz makes of them.

    The table is within 0.5 % for each wave; waves may add up to less than they differ by.
    """
    display, texture = load_display("reference-24"), without_envelope("plastic-abs-vdi27")
    r = SpectrumRenderer(display, texture, carriers=16, frame_rate=50.0)
    place, v = np.array([0.0123, -0.004]), np.array(velocity)
    found = r.frame(place, v, 0.5)
    expected = written_out(r, display, texture, place, v)
    assert np.abs(found - expected).max() < 1e-2 * np.abs(expected).max()


def test_a_frame_turns_with_its_carrier_and_the_carrier_is_a_whole_increment() -> None:
    display, texture = load_display("reference-24"), without_envelope("leather-calf")
    r = SpectrumRenderer(display, texture, carriers=16, frame_rate=50.0)
    increments = r.carriers / RATE * 2**32
    np.testing.assert_array_equal(increments, np.rint(increments))
    first = r.frame((0.0, 0.0), (0.08, 0.0), 0.5)
    assert r.sample == r.spacing == 160
    second = r.frame((0.0, 0.0), (0.08, 0.0), 0.5)
    turns = np.exp(-2j * np.pi * (increments * 160 % 2**32) / 2**32)
    np.testing.assert_allclose(second, first * turns, rtol=1e-9)
    r.sample = 2**32
    np.testing.assert_array_equal(r.frame((0.0, 0.0), (0.08, 0.0), 0.5), first)


def test_a_finger_at_rest_is_a_constant() -> None:
    display, texture = load_display("reference-24"), load_texture("leather-suede")
    r = SpectrumRenderer(display, texture, carriers=16, frame_rate=50.0)
    frames = np.array([r.frame((0.01, 0.002), (0.0, 0.0), 0.5) for _ in range(3)])
    line = played(frames, r.carriers, r.spacing)
    assert line.std(axis=1).min() > 0.1
    assert np.abs(line - line[0]).max() < 1e-5 * np.abs(line).max()


def test_at_rest_the_envelope_of_each_contactors_place_multiplies() -> None:
    display, texture = load_display("reference-24"), load_texture("leather-suede")
    place, still = np.array([0.013, 0.002]), (0.0, 0.0)
    found = SpectrumRenderer(display, texture).frame(place, still, 0.5)[:, 0]
    plain = SpectrumRenderer(display, without_envelope("leather-suede")).frame(place, still, 0.5)
    slow = texture.realize().envelope
    envelope = np.exp(slow.at(place + display.contactors))
    envelope /= math.sqrt(np.prod(i0(2 * slow.amplitude)))
    assert envelope.std() > 0.03
    np.testing.assert_allclose(found.real, plain[:, 0].real * envelope, rtol=1e-4)


def test_a_reversal_changes_the_drive_as_little_as_the_velocity() -> None:
    display, texture = load_display("reference-24"), load_texture("leather-suede")
    place = (0.01, 0.002)
    lines = []
    for speed in (-1e-6, 1e-6):
        r = SpectrumRenderer(display, texture, carriers=16, frame_rate=50.0)
        lines.append(r.frame(place, (speed, 0.0), 0.5).real.sum(axis=1))
    assert np.abs(lines[1] - lines[0]).max() < 1e-3 * np.abs(lines[0]).max()


@pytest.mark.parametrize("count", [1, 2, 3, 99, 100, 101, 5000])
def test_along_a_line_it_is_the_same_as_at_each_of_its_places(count: int) -> None:
    waves = load_texture("wood-oak").partials
    step = np.array([13e-6, -21e-6])
    places = np.arange(count)[:, None] * step
    np.testing.assert_allclose(along(waves, step, count), waves.at(places), rtol=0, atol=1e-16)


@pytest.mark.parametrize(("speed", "least"), [(0.04, 18.0), (0.1, 14.0)])
def test_frames_play_nearly_the_samples(speed: float, least: float) -> None:
    """16 at 100 Hz, up to 40 × speed Hz; envelope, polarity and all, without the wire's codes."""
    display, texture = load_display("reference-24"), without_friction(load_texture("leather-suede"))
    display = replace(display, polarity=np.where(np.arange(24) % 2, 1.0, -1.0))
    samples = sampled(display, texture, speed, 0.6)
    r = SpectrumRenderer(display, texture, carriers=16, frame_rate=100.0)
    frames = [r.frame((speed * k / 100, 0.0), (speed, 0.0), 0.5) for k in range(61)]
    error = played(np.array(frames), r.carriers, r.spacing) - samples
    assert 10 * np.log10(np.mean(samples[80:] ** 2) / np.mean(error[80:] ** 2)) > least


def test_sidebands_of_the_envelope_are_played_at_their_own_place() -> None:
    """One wave at 250 Hz is played, which oak's envelope at 120 mm/s modulates with up to 40 Hz.

    21 dB; without sidebands of their own 14 dB, on the wrong sides 9.
    """
    display, oak = load_display("reference-24"), without_friction(load_texture("wood-oak"))
    nearest = np.argmin(np.abs(oak.wave_vector[:, 0] * 0.12 / (2 * np.pi) - 250))
    alone = np.where(np.arange(len(oak.amplitude)) == nearest, 1e-6, 0.0)
    texture = replace(oak, descriptor=changed(oak.descriptor, events=()), amplitude=alone)
    samples = sampled(display, texture, 0.12, 1.0)
    r = SpectrumRenderer(display, texture, carriers=16, frame_rate=50.0)
    frames = [r.frame((0.0024 * k, 0.0), (0.12, 0.0), 0.5) for k in range(51)]
    error = played(np.array(frames), r.carriers, r.spacing) - samples
    ratio = np.mean(samples[80:] ** 2) / np.mean(error[80:] ** 2)
    assert 10 * np.log10(ratio) > 18


def test_between_forces_of_the_table_inverses_are_mixed() -> None:
    loads = FingerTable(normal_force=(0.2, 1.0), loads=(FingerLoad.low(), FingerLoad.high()))
    texture = without_envelope("leather-calf")
    texture = replace(texture, descriptor=changed(texture.descriptor, laws=type(texture.laws)()))

    def frame(load: Any, force: float) -> Complex:
        display = load_display("reference-24", load=load)
        return SpectrumRenderer(display, texture).frame((0.01, 0.0), (0.08, 0.0), force)

    low, high = frame(FingerLoad.low(), 0.5), frame(FingerLoad.high(), 0.5)
    size = np.abs(high - low).max()
    assert size > 0.1 * np.abs(low).max()
    for force, part in ((0.1, 0.0), (0.2, 0.0), (0.4, 0.25), (1.0, 1.0), (3.0, 1.0)):
        np.testing.assert_allclose(
            frame(loads, force), low + part * (high - low), atol=2e-5 * np.abs(high).max()
        )


# Limits and mistakes


def test_no_sum_of_carriers_exceeds_the_voltage_even_rounded_up_by_the_wire() -> None:
    plain, texture = load_display("reference-24"), load_texture("wood-oak")
    display = replace(plain, limits=replace(plain.limits, voltage=3.0))
    r, whole = SpectrumRenderer(display, texture), SpectrumRenderer(plain, texture)
    ratios = []
    for k in range(40):
        stroke = (0.0008 * k, 0.0), (0.08, 0.0), 0.5
        found, free = r.frame(*stroke), whole.frame(*stroke)
        assert np.abs(found).sum(axis=1).max() * 10 ** (0.125 / 20) <= 3.0 * (1 + 1e-9)
        ratio = np.abs(found) / np.abs(free)
        ratios.append(ratio.min())
        assert ratio.max() - ratio.min() < 1e-6
    assert whole.limited_frames == 0
    assert r.limited_frames > 0
    assert min(ratios) < 0.5


def test_frames_are_turned_up_again_slowly() -> None:
    plain = load_display("reference-24")
    display = replace(plain, limits=replace(plain.limits, voltage=3.0))
    r = SpectrumRenderer(display, load_texture("wood-oak"), frame_rate=100.0)
    r.frame((0.0, 0.0), (0.08, 0.0), 2.0)
    held = []
    for _ in range(30):
        r.frame((0.0, 0.0), (0.08, 0.0), 0.0)
        held.append(r.limiter._held)
    np.testing.assert_allclose(np.divide(held[1:], held[:-1]), np.exp(-0.1), rtol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9])
def test_an_invalid_finger_is_lifted_and_counted(bad: float) -> None:
    r = SpectrumRenderer(load_display("reference-24"), load_texture("wood-oak"))
    r.frame((0.01, 0.0), (0.08, 0.0), 0.5)
    for mistake in (((bad, 0.0), (0.08, 0.0), 0.5), ((0.0, 0.0), (0.0, bad), 0.5)):
        assert not r.frame(*mistake).any()
    assert not r.frame((0.0, 0.0), (0.08, 0.0), bad).any()
    assert r.invalid_frames == 3
    assert r.frame((0.01, 0.0), (0.08, 0.0), 0.5).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"carriers": 0}, "carriers 0: must be 1 … 64"),
        ({"carriers": 65}, "carriers 65: must be 1 … 64"),
        ({"frame_rate": 19.0}, "frame_rate 19 Hz: must be 20 … 8000 Hz"),
        ({"sample_rate": 2000.0}, "sample_rate 2000 Hz: must be "),
    ],
)
def test_what_no_link_carries_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SpectrumRenderer(load_display("reference-24"), load_texture("wood-oak"), **options)
