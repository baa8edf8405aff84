"""The arithmetic of spectrum frames: against Python's own integers, against floats, at the wrap.

`slow_*` below is section 10 of the protocol's SPEC.md written out one number at a time; it shares
nothing with the module.
"""

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_protocol import spectrum as wire

TURN = 2**32
angles = st.integers(0, TURN - 1)


def slow_sine(theta: int) -> int:
    def entry(k: int) -> int:
        exact = 32767 * math.sin(2 * math.pi * k / 1024)
        return math.floor(abs(exact) + 0.5) * (1 if exact > 0 else -1)

    i, r = theta >> 22, (theta >> 6) & 0xFFFF
    return entry(i) + (((entry(i + 1) - entry(i)) * r + 2**15) >> 16)


def slow_cosine(theta: int) -> int:
    return slow_sine((theta + 2**30) % TURN)


def slow_output(i: list[int], q: list[int], increments: list[int], position: int) -> int:
    total = 0
    for a, b, increment in zip(i, q, increments, strict=True):
        angle = (increment * position) % TURN
        total += a * slow_cosine(angle) - b * slow_sine(angle)
    return max(-32767, min(32767, (total + 2**22) >> 23))


# Sine


def test_the_table_has_the_corners_of_a_sine_and_its_symmetries() -> None:
    assert wire.SINE[[0, 256, 512, 768, 1024]].tolist() == [0, 32767, 0, -32767, 0]
    assert wire.SINE[[128, 384]].tolist() == [23170, 23170]  # 32767/√2 = 23169.8
    np.testing.assert_array_equal(wire.SINE[:513], wire.SINE[512::-1])
    np.testing.assert_array_equal(wire.SINE[512:], -wire.SINE[:513])


@given(angles)
def test_sine_and_cosine_are_those_of_whole_numbers(theta: int) -> None:
    assert int(wire.sine(theta)) == slow_sine(theta)
    assert int(wire.cosine(theta)) == slow_cosine(theta)


def test_sine_is_within_one_and_a_quarter_codes_of_the_real_one() -> None:
    """Half a code of the table, 0.154 of a chord over 1/1024 turn, half a code of rounding."""
    theta = np.arange(0, TURN, 9973 * 31, dtype=np.uint64)
    exact = 32767 * np.sin(2 * np.pi * theta / TURN)
    assert np.abs(wire.sine(theta) - exact).max() < 1.16


def test_angles_are_taken_modulo_a_turn() -> None:
    theta = np.array([5, 2**31, TURN - 1])
    np.testing.assert_array_equal(wire.sine(theta + TURN), wire.sine(theta))
    np.testing.assert_array_equal(wire.cosine(theta + 3 * TURN // 4), wire.sine(theta))


# Carriers and envelopes


def test_increments_are_turns_per_sample() -> None:
    found = wire.increments([0.0, 1000.0, 2000.0, 1.0], 8000.0)
    assert found.dtype == np.uint32
    assert found.tolist() == [0, 2**29, 2**30, round(2**32 / 8000)]


def test_steps_of_amplitude_are_a_quarter_decibel_below_full_scale() -> None:
    assert wire.AMPLITUDE[255] == 32767 * 256
    assert wire.AMPLITUDE[175] == round(32767 * 256 / 10)  # 80 steps are 20 dB
    steps = 20 * np.log10(wire.AMPLITUDE[2:] / wire.AMPLITUDE[1:-1])
    np.testing.assert_allclose(steps, 0.25, atol=2e-3)  # 1 in 5606, rounded


@settings(max_examples=200)
@given(st.floats(-63.5, 0), st.floats(-math.pi, math.pi))
def test_an_envelope_comes_back_within_half_a_step_of_each_code(level: float, turn: float) -> None:
    """0.125 dB and π/256; I and Q are rounded to whole units, one in 5606 at the lowest code."""
    sent = 10 ** (level / 20) * np.exp(1j * turn)
    i, q = wire.decode(wire.encode(np.array([[sent]])))
    ratio = complex(i[0, 0], q[0, 0]) / (32767 * 256) / sent
    assert abs(20 * math.log10(abs(ratio))) < 0.125 + 3e-3
    assert abs(math.atan2(ratio.imag, ratio.real)) < math.pi / 256 + 3e-4


def test_what_is_too_small_is_off_and_what_is_too_large_is_full_scale() -> None:
    lowest = 10 ** (-254 / 80)
    half_a_step = 10 ** (1 / 160)
    sizes = [0, lowest / half_a_step * 0.999, lowest / half_a_step * 1.001, lowest, 1.0, 1.5, 1e9]
    codes = wire.encode(np.array([sizes], complex))[0]
    assert codes[:, 0].tolist() == [0, 0, 1, 1, 255, 255, 255]
    assert codes.dtype == np.uint8


def test_a_phase_just_short_of_a_turn_is_zero() -> None:
    assert wire.encode(np.array([[np.exp(-1e-3j)]]))[0, 0].tolist() == [255, 0]
    assert wire.encode(np.array([[-1.0]], complex))[0, 0].tolist() == [255, 128]
    assert wire.encode(np.array([[-1j]]))[0, 0].tolist() == [255, 192]


# Ramps and output


def test_a_ramps_step_is_rounded_toward_zero_on_either_side() -> None:
    start, end = np.array([[0, 0, 5, 5]]), np.array([[7, -7, -2, 12]])
    assert wire.ramp_step(start, end, 4).tolist() == [[1, -1, -1, 1]]
    assert wire.ramp_step(start, end, 8).tolist() == [[0, 0, 0, 0]]


def drawn(seed: int, channels: int, carriers: int, loudest: int) -> dict[str, NDArray[np.int64]]:
    """Return start, end and increments of a ramp at random."""
    rng = np.random.default_rng(seed)
    codes = rng.integers([loudest - 50, 0], [loudest + 1, 256], (2, channels, carriers, 2)).astype(
        np.uint8
    )
    (i0, q0), (i1, q1) = wire.decode(codes[0]), wire.decode(codes[1])
    increments = rng.integers(0, TURN // 8, carriers)
    return {"i0": i0, "q0": q0, "i1": i1, "q1": q1, "increments": increments}


@pytest.mark.parametrize("loudest", [180, 255])
@pytest.mark.parametrize("position", [0, 123_456_789, TURN - 9])
def test_output_is_that_of_whole_numbers_to_the_last_bit(position: int, loudest: int) -> None:
    """Positions cross their wrap, and some sums are clamped."""
    r, samples = drawn(position % 97 + loudest, 3, 5, loudest), 23
    increments = r["increments"].astype(np.uint32)
    step_i, step_q = (wire.ramp_step(r[f"{x}0"], r[f"{x}1"], samples) for x in "iq")
    found = wire.synthesize(r["i0"], r["q0"], step_i, step_q, increments, position, samples)
    for n in range(samples):
        for channel in range(3):
            i, q = (
                [
                    int(a) + n * math.trunc((int(b) - int(a)) / samples)
                    for a, b in zip(r[f"{x}0"][channel], r[f"{x}1"][channel], strict=True)
                ]
                for x in "iq"
            )
            place = (position + n) % TURN
            expected = slow_output(i, q, [int(x) for x in r["increments"]], place)
            assert found[n, channel] == expected
    if loudest == 255:
        assert np.abs(found).max() == 32767


def test_output_is_the_real_sum_within_two_codes() -> None:
    """Amplitudes sum to less than full scale: sines err by 1.16 of 32767, rounding by 0.5."""
    rng = random.Random(3)
    frequency = np.array([0.0, 63.0, 200.0, 404.5, 1000.0])
    sizes = np.array([0.1, 0.3, 0.2, 0.05, 0.25])
    turns = np.array([rng.uniform(-3, 3) for _ in sizes])
    increments = wire.increments(frequency, 8000.0)
    scale = 32767 * 256
    z = np.rint(sizes * scale * np.exp(1j * turns))
    i, q = z.real.astype(np.int64)[None], z.imag.astype(np.int64)[None]
    none = np.zeros_like(i)
    found = wire.synthesize(i, q, none, none, increments, 0, 800)[:, 0]
    n = np.arange(800)[:, None]
    exact = (z * np.exp(2j * np.pi * n * (increments / TURN))).real.sum(axis=1) / 256
    assert np.abs(found - exact).max() < 2.2
