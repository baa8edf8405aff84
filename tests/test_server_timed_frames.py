"""Tests of tactile frames that have times, through the server.

All of the server is real but time and the boundaries of processes (`virtual_server`).
"""

import asyncio
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from virtual_server import World, virtual_world

from tactile import messages as m
from tactile.arrays import Floats
from tactile.client import wire
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig

NAME, N, RATE = "left", 24, 8000.0
CARD, PERIOD, TONE = 48_000.0, 128, 155.0
"""Rate of a sound card [Hz], number of frames of its period, and frequency that it plays [Hz]."""
DELAY = 50e-3
"""Time from a frame to its sample [s]."""
FRAMES = m.TactileFrames(
    display=NAME, frame_rate_hz=CARD, amplitude_um=2.0, frames=(0.5,) * N, time_us=0
)


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
    for request in (
        m.Subscribe(display=NAME, rate_hz=50.0, samples=True), m.ArmDisplay(display=NAME),
    ):  # fmt: skip
        assert world.run(client.request(request)) == m.Done()
    world.run(asyncio.sleep(0.1))
    return client


def stream(world: World, client: Client, message: m.TactileFrames) -> m.Answer | None:
    """Send frames; return the answer, if there is one."""

    async def sent() -> m.Answer | None:
        return client.stream(message, world.clock.now())

    return world.run(sent())


async def play_tone(world: World, client: Client, seconds: float) -> None:
    """Send what a sound card plays, which comes in periods; its tone is 0 at time 0."""
    first = world.clock.now()
    for number in range(0, round(seconds * CARD), PERIOD):
        times = first + (number + np.arange(PERIOD)) / CARD
        values = np.repeat(np.sin(2 * np.pi * TONE * times)[:, None], N, axis=1)
        message = structs.replace(
            FRAMES,
            frames=values.astype("<f4").tobytes(),
            time_us=round(1e6 * (times[0] + DELAY)),
        )
        assert client.stream(message, world.clock.now()) is None
        await asyncio.sleep(first + (number + PERIOD) / CARD - world.clock.now())


def played(client: Client) -> tuple[Floats, Floats]:
    """Return the times of all samples [s] and their shear (S, N) [m]."""
    queued = [client.outbox.get_nowait() for _ in range(client.outbox.qsize())]
    items = [
        wire.to_telemetry(message, 0.0, 0.0)
        for message in queued
        if isinstance(message, m.TelemetryMessage)
    ]
    samples = [item.samples for item in items if item.samples is not None and item.samples.times]
    starts = np.concatenate([one.times for one in samples])
    shear = np.concatenate([np.asarray(one.shear) for one in samples])
    times = starts[:, None] + np.arange(len(shear) // len(starts)) / RATE
    return times.ravel(), shear


def sounds_after(world: World, client: Client, seconds: float) -> bool:
    async def look() -> bool:
        await asyncio.sleep(seconds)
        return client.sounds

    return world.run(look())


def stats(world: World, client: Client) -> m.StatsReply:
    answer = world.run(client.request(m.GetStats(display=NAME)))
    assert isinstance(answer, m.StatsReply)
    return answer


def test_each_frame_is_played_at_its_time(world: World, client: Client) -> None:
    """Compare the shear that is commanded with the tone at the times of its samples."""
    world.run(play_tone(world, client, 1.0))
    times, shear = played(client)
    count = int(0.5 * RATE)
    expected = 2e-6 * np.sin(2 * np.pi * TONE * (times[-count:] - DELAY))
    np.testing.assert_allclose(shear[-count:], np.repeat(expected[:, None], N, axis=1), atol=2e-8)
    counters = stats(world, client).counters
    assert (counters["dropped_frames"], counters["frame_gaps"]) == (0, 0)


def test_frames_do_not_join_others_that_wait_for_their_time(world: World, client: Client) -> None:
    begin = m.BeginAt(at_us=round(1e6 * (world.clock.now() + 0.5)))
    waiting = structs.replace(FRAMES, frames=(-0.5,) * N * 400, time_us=None, begin=begin)
    soon = structs.replace(
        FRAMES, frames=(0.5,) * N * 400, time_us=round(1e6 * (world.clock.now() + 0.05))
    )
    for message in (waiting, soon):
        assert stream(world, client, message) is None
    world.run(asyncio.sleep(0.3))
    _, shear = played(client)
    assert shear.max() > 0


def test_frames_after_their_time_are_dropped_and_counted(world: World, client: Client) -> None:
    late = structs.replace(FRAMES, time_us=round(1e6 * (world.clock.now() - 1)))
    assert stream(world, client, late) is None
    world.run(asyncio.sleep(0.5))
    _, shear = played(client)
    assert not shear.any()
    counters = stats(world, client).counters
    assert (counters["dropped_frames"], counters["frame_gaps"]) == (1, 1)


def test_frames_that_wait_are_not_played_after_an_estop(world: World, client: Client) -> None:
    """Clear it and arm again before their time: nothing of them is left."""
    soon = structs.replace(
        FRAMES, frames=(0.5,) * N * 400, time_us=round(1e6 * (world.clock.now() + 0.8))
    )
    assert stream(world, client, soon) is None
    estop = world.run(client.request(m.EStop()))
    assert isinstance(estop, m.Done)
    world.run(asyncio.sleep(0.3))
    clear = m.ClearEstop(display=NAME, estop=estop.estops[NAME])
    assert world.run(client.request(clear)) == m.Done()
    assert world.run(client.request(m.ArmDisplay(display=NAME))) == m.Done()
    world.run(asyncio.sleep(1.0))
    _, shear = played(client)
    assert not shear.any()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"latest": True}, "neither latest nor begin fits it"),
        ({"begin": m.BeginAt(at_us=0)}, "neither latest nor begin fits it"),
        ({"time_us": 2**62}, "s ahead; at most 1 s"),
    ],
)
def test_a_time_that_does_not_fit_is_refused(
    world: World, client: Client, options: dict[str, Any], text: str
) -> None:
    refused = stream(world, client, structs.replace(FRAMES, **options))
    assert isinstance(refused, m.Failure)
    assert (refused.code, refused.field) == ("invalid_field", "time_us")
    assert text in refused.message


def test_a_client_sounds_while_its_frames_wait(world: World, client: Client) -> None:
    """Signs of life are due from its program until they have been played."""
    stream(world, client, structs.replace(FRAMES, time_us=round(1e6 * (world.clock.now() + 0.5))))
    assert [sounds_after(world, client, passed) for passed in (0.4, 0.1, 0.1)] == [
        True, True, False,
    ]  # fmt: skip
