"""Tests of waveforms for single contactors, from a client's request to the commanded shear.

All of the server is real but time and the boundaries of processes (`virtual_server`).
"""

import asyncio
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from virtual_server import World, virtual_world

from tactile import messages as m
from tactile.arrays import Floats
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig

NAME = "left"
RATE = 8000.0
BLOCK = 16
"""Number of samples of a block."""
COUNT = 24
"""Number of contactors."""
SIZE = 2e-6
"""Amplitude of all waves [m]."""


@pytest.fixture
def world() -> Iterator[World]:
    with virtual_world(lambda playback, volts: None) as made:
        yield made


@pytest.fixture
def client(world: World) -> Client:
    """Return a client of a server whose only display is armed and is worn, so that waves sound."""
    display = DisplayConfig(name=NAME, device="mock:", sample_rate_hz=RATE, worn=True)
    assert world.start(Configuration(display=(display,)))
    assert world.host is not None
    client = world.host.connect("app", roles=m.ALL_ROLES)
    assert world.run(client.request(m.ArmDisplay(display=NAME))) == m.Done()
    world.run(asyncio.sleep(0.1))
    return client


def sine(frequency: float, seconds: float, rate: float = RATE) -> Floats:
    """Return a sine that begins with 0."""
    return np.asarray(np.sin(2 * np.pi * frequency * np.arange(round(seconds * rate)) / rate))


def wave(samples: Floats, *contactors: int, rate: float = RATE) -> m.Append:
    """Return a request to play samples from −1 to 1 on some contactors."""
    return m.Append(
        display=NAME, sample_rate_hz=rate, amplitude_um=1e6 * SIZE, contactors=contactors,
        samples=struct.pack(f"<{len(samples)}f", *samples),
    )  # fmt: skip


def append(world: World, client: Client, *waves: m.Append) -> list[m.AppendedReply]:
    """Append waves one after the other, not waiting for the answers in between."""

    async def all_of_them() -> list[m.Answer]:
        return await asyncio.gather(*(client.request(one) for one in waves))

    answers = world.run(all_of_them())
    assert all(isinstance(answer, m.AppendedReply) for answer in answers), answers
    return [answer for answer in answers if isinstance(answer, m.AppendedReply)]


def commanded(world: World, seconds: float) -> Floats:
    """Let time pass, and return the shear of all contactors that was commanded last (S, N) [m]."""
    assert world.host is not None
    world.run(asyncio.sleep(seconds))
    ring = world.host.playing[NAME].memory.commanded
    shear = np.stack([ring.since(k, 0)[1] for k in range(COUNT)], axis=1)
    assert not shear[0].any()
    assert not shear[-1].any()
    return shear.astype(np.float64)


def sounding(shear: Floats) -> slice:
    """Return the samples from the first to the last at which there is shear."""
    loud = np.flatnonzero(np.abs(shear) > 1e-3 * SIZE)
    return slice(int(loud[0]), int(loud[-1]) + 1)


def test_24_sines_for_24_contactors_are_taken_whole_and_play_at_the_same_time(
    world: World, client: Client
) -> None:
    """Each has a whole number of periods in 0.1 s, so that its line alone has power.

    The window of the interpolation has 70 dB, which is an error of 3e-4.
    """
    seconds, frequencies = 0.1, 60.0 + 20.0 * np.arange(COUNT)
    answers = append(world, client, *(
        wave(sine(f, seconds, 4000.0), k, rate=4000.0) for k, f in enumerate(frequencies)
    ))  # fmt: skip
    assert [answer.samples_consumed for answer in answers] == [400] * COUNT
    assert max(answer.buffered_ms for answer in answers) <= 1e3 * seconds
    shear, length = commanded(world, 0.15), round(seconds * RATE)
    parts = [sounding(shear[:, k]) for k in range(COUNT)]
    together = min(part.stop for part in parts) - max(part.start for part in parts)
    assert together > 0.9 * length, "not one after the other"
    for k, part in enumerate(parts):
        power = np.abs(np.fft.rfft(shear[part.start : part.start + length, k])) ** 2
        line = round(frequencies[k] * seconds)
        assert power.argmax() == line
        assert power[line] > 0.9999 * power.sum()
        assert 2 * np.sqrt(power[line]) / length == pytest.approx(SIZE, rel=3e-4)


@pytest.mark.parametrize(("rate", "error"), [(RATE, 1e-6), (RATE / 2, 0.06)])
def test_sets_that_overlap_play_one_after_the_other_on_the_contactor_of_both(
    world: World, client: Client, rate: float, error: float
) -> None:
    """The second wave begins on both of its contactors when the first one has ended.

    A third one, of another contactor, waits for neither. What is interpolated is least exact where
    it begins and ends, since there are no samples beyond.
    """
    seconds = 0.05
    one, other, third = sine(200.0, seconds), sine(320.0, seconds, rate), sine(480.0, seconds)
    answers = append(world, client, wave(one, 0, 1), wave(other, 1, 2, rate=rate), wave(third, 3))
    assert [answer.samples_consumed for answer in answers] == [len(one), len(other), len(third)]
    assert answers[1].buffered_ms > 1e3 * seconds, "both wait for the shared contactor"
    assert answers[2].buffered_ms <= 1e3 * seconds
    shear = commanded(world, 0.15) / SIZE
    count, begin = len(one), sounding(SIZE * shear[:, 0]).start - 1
    wanted = np.zeros((2 * count, 3))
    wanted[:count, [0, 1]] = one[:, None]
    wanted[count:, [1, 2]] = sine(320.0, seconds)[:, None]
    np.testing.assert_allclose(shear[begin : begin + 2 * count, :3], wanted, rtol=0, atol=error)
    assert not shear[begin + 2 * count + BLOCK :, :3].any()
    assert sounding(SIZE * shear[:, 3]).start < begin + count, "during the first wave"
    assert not shear[:, 4:].any()
