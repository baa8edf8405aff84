"""Tests of telemetry that holds all that is played, sample by sample.

All of the server is real but time and the boundaries of processes (`virtual_server`).
"""

import asyncio
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray
from virtual_server import World, virtual_world

from tactile import messages as m
from tactile.arrays import Floats
from tactile.client import wire
from tactile.playback.block_rendering import BLOCK
from tactile.playback.block_ring import BLOCKS, BlockRecord
from tactile.playback.commands import DeviceOpened
from tactile.playback.sample_ring import LENGTH
from tactile.playback.shared_memory import PlaybackMemory
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig
from tactile.server.telemetry import MOST_BYTES, SamplesReader

NAME, N, RATE = "left", 24, 8000.0
WAVE = m.Append(display=NAME, sample_rate_hz=RATE, amplitude_um=1.0, samples=(0.5,) * 400)
STEP = 100 / 0x7FFF
"""Step of the drive on the link, and of the record of the amplifier [V]."""
HOW = DeviceOpened(sample_rate=RATE)


@pytest.fixture
def put_out() -> list[Floats]:
    """Return what the amplifier has put out since it was armed [V]."""
    return []


@pytest.fixture
def world(put_out: list[Floats]) -> Iterator[World]:
    with virtual_world(lambda playback, volts: put_out.append(volts.copy())) as made:
        yield made


@pytest.fixture
def client(world: World) -> Client:
    """Return a client of a server whose only display is worn, so that waves sound."""
    display = DisplayConfig(name=NAME, device="mock:", sample_rate_hz=RATE, worn=True)
    assert world.start(Configuration(display=(display,)))
    assert world.host is not None
    return world.host.connect("app", roles=m.ALL_ROLES)


def subscribe(world: World, client: Client, rate: float = 20.0) -> None:
    command = m.Subscribe(display=NAME, rate_hz=rate, samples=True)
    assert world.run(client.request(command)) == m.Done()


def arm(world: World, client: Client) -> None:
    assert world.run(client.request(m.ArmDisplay(display=NAME))) == m.Done()


def take(client: Client) -> tuple[list[wire.CommandedSamples], list[m.OnsetMessage]]:
    """Return the samples and the onsets that have come to a client."""
    queued = [client.outbox.get_nowait() for _ in range(client.outbox.qsize())]
    items = [
        wire.to_telemetry(message, 0.0, 0.0)
        for message in queued
        if isinstance(message, m.TelemetryMessage)
    ]
    samples = [item.samples for item in items if item.samples is not None]
    return samples, [message for message in queued if isinstance(message, m.OnsetMessage)]


def joined(samples: list[wire.CommandedSamples], name: str) -> NDArray[np.float64]:
    """Return the rows of all items, one after the other."""
    return np.concatenate(
        [np.asarray(rows) for one in samples if (rows := getattr(one, name)) is not None]
    )


def test_all_that_is_played_comes_sample_by_sample_with_its_times(
    world: World, client: Client, put_out: list[Floats]
) -> None:
    """Compare the drive with the record of the amplifier, and the shear with what was appended.

    The waveform begins at a time, so that the report on it, which does not pass through these
    samples, says when its first sample was put out.
    """
    subscribe(world, client)
    arm(world, client)
    put_out.clear()  # nothing has been put out but 0 V
    at_us = round(1e6 * (world.clock.now() + 0.3))
    begin = m.BeginAt(at_us=at_us, drop_late=True, number=1)
    world.run(client.request(structs.replace(WAVE, begin=begin)))
    world.run(asyncio.sleep(1.0))
    samples, (onset,) = take(client)
    played = [one for one in samples if one.times]
    assert [one.first for one in played[1:]] == [
        one.first + BLOCK * len(one.times) for one in played[:-1]
    ]
    drive, shear = joined(played, "drive"), joined(played, "shear")
    record = np.concatenate(put_out)
    loud = np.flatnonzero(np.abs(record).max(axis=1) > 0)
    start = np.flatnonzero(np.abs(drive).max(axis=1) > STEP / 2)[0]
    count = loud[-1] - loud[0] + 1
    assert count > 400
    np.testing.assert_allclose(
        drive[start : start + count], record[loud[0] : loud[-1] + 1], atol=STEP / 2 + 1e-5
    )
    times = np.concatenate([np.asarray(one.times) for one in played])
    begun = int(np.flatnonzero(shear[:, 0] > 0)[0])
    np.testing.assert_allclose(shear[begun : begun + 400], 0.5e-6, rtol=1e-6)
    assert onset.onset_us is not None
    first = times[begun // BLOCK] + begun % BLOCK / RATE
    assert first == pytest.approx(onset.onset_us * 1e-6, abs=1e-6)
    assert {one.uncertainty for one in played} == {0.0}, "the amplifier and the host have one clock"


def test_what_does_not_fit_into_a_message_follows_at_once(world: World, client: Client) -> None:
    """Take half a second of samples at a time, three messages of them."""
    subscribe(world, client, 2.0)
    arm(world, client)
    world.run(asyncio.sleep(5.0))
    played = [one for one in take(client)[0] if one.times]
    assert [one.first for one in played[1:]] == [
        one.first + BLOCK * len(one.times) for one in played[:-1]
    ]
    assert world.clock.now() - played[-1].times[-1] < 0.51
    assert len(played) == pytest.approx(30, abs=4)


def test_each_block_has_the_finger_that_it_was_rendered_for(world: World, client: Client) -> None:
    """Move a finger at 80 mm/s from 1 mm on, and press with 0.5 N."""
    subscribe(world, client)
    arm(world, client)
    began = world.clock.now()

    async def stroke() -> None:
        for _ in range(250):
            now = world.clock.now()
            contact = m.Contact(
                display=NAME, time_us=round(now * 1e6), normal_force_n=0.5,
                position_mm=(1.0 + 80.0 * (now - began), 2.0), velocity_mm_s=(80.0, 0.0),
            )  # fmt: skip
            client.stream(contact, now)
            await asyncio.sleep(0.004)

    world.run(stroke())
    samples, _ = take(client)
    times = np.concatenate([np.asarray(one.finger_times) for one in samples])
    place = np.array([place for one in samples for place in one.position])
    steady = (times > began + 0.5) & (times < began + 1.0)
    assert np.count_nonzero(steady) > 200
    expected = 1e-3 + 0.08 * (times[steady] - began)
    np.testing.assert_allclose(place[steady, 0], expected, atol=2e-6)
    np.testing.assert_allclose(place[steady, 1], 2e-3, atol=1e-6)
    velocity = np.array([one for item in samples for one in item.velocity])[steady]
    np.testing.assert_allclose(velocity, [[0.08, 0.0]] * len(velocity), atol=1e-4)
    force = np.array([one for item in samples for one in item.normal_force])[steady]
    np.testing.assert_allclose(force, 0.5, rtol=1e-3)
    assert all(np.array([one for item in samples for one in item.touching])[steady])


def test_nothing_comes_without_samples_and_what_was_played_before_is_old(
    world: World, client: Client
) -> None:
    arm(world, client)
    world.run(client.request(m.Subscribe(display=NAME, rate_hz=20.0)))
    world.run(asyncio.sleep(0.2))
    assert take(client)[0] == []
    subscribe(world, client)
    world.run(asyncio.sleep(0.01))
    (first,) = take(client)[0]
    assert len(first.times) < 10, "it begins with the subscription"
    subscribe(world, client, 50.0)
    world.run(asyncio.sleep(0.3))
    later = [one for one in take(client)[0] if one.times]
    assert later[0].first == first.first + BLOCK * len(first.times), "another rate makes no gap"
    world.run(client.request(m.Subscribe(display=NAME, rate_hz=0.0)))
    take(client)
    world.run(asyncio.sleep(0.2))
    assert take(client) == ([], [])


def test_who_observes_a_display_learns_the_onsets_of_others(world: World, client: Client) -> None:
    assert world.host is not None
    watcher, other = (world.host.connect(name, roles=m.ALL_ROLES) for name in ("watcher", "other"))
    subscribe(world, watcher)
    world.run(other.request(m.Subscribe(display=NAME, rate_hz=20.0)))
    arm(world, client)
    at_us = round(1e6 * (world.clock.now() + 0.2))
    begin = m.BeginAt(at_us=at_us, drop_late=False, number=7, marker=3)
    world.run(client.request(structs.replace(WAVE, begin=begin)))
    world.run(asyncio.sleep(1.0))
    (own,) = take(client)[1]
    assert (own.client, own.number, own.marker) == (None, 7, 3)
    assert take(watcher)[1] == [structs.replace(own, client=client.number)]
    assert take(other)[1] == []


# The rings


def fill(memory: PlaybackMemory, count: int, *, first: int | None = None) -> None:
    """Add blocks whose samples are their own numbers [µm and V]."""
    for _ in range(count):
        number = memory.commanded.count if first is None else first
        first = None
        rows = (number + np.arange(float(BLOCK)))[:, None] * np.ones(N)
        memory.commanded.add(rows * 1e-6, number)
        memory.driven.add(rows, number)
        place = number / RATE
        memory.blocks.add(BlockRecord(number, place, 1e-5, place, (0, 0), (0, 0), 0.5, True))


def numbers(message: m.TelemetrySamples) -> list[Any]:
    """Return the first number of a message and those that its samples hold."""
    assert message.drive_v is not None
    assert message.shear_um is not None
    drive = np.frombuffer(message.drive_v, "<f4").reshape(-1, N)
    np.testing.assert_allclose(np.frombuffer(message.shear_um, "<f4").reshape(-1, N), drive)
    np.testing.assert_allclose(
        np.frombuffer(message.times_us, "<f8"), drive[::BLOCK, 0] / RATE * 1e6
    )
    return [message.first, *drive[:, 0].astype(int)]


def test_more_than_fits_into_a_message_comes_in_the_next_ones() -> None:
    memory = PlaybackMemory.create(N)
    reader = SamplesReader(memory)
    most = MOST_BYTES // (8 * N * BLOCK)
    fill(memory, most + 3)
    first, second, third = (numbers(reader.read(memory, HOW)) for _ in range(3))
    assert first == [0, *range(most * BLOCK)]
    assert second == [most * BLOCK, *range(most * BLOCK, (most + 3) * BLOCK)]
    assert third == [(most + 3) * BLOCK]
    memory.close()


def test_samples_that_nobody_read_in_time_are_missing_and_no_others() -> None:
    memory = PlaybackMemory.create(N)
    reader = SamplesReader(memory)
    fill(memory, BLOCKS + 100)
    came = numbers(reader.read(memory, HOW))
    begin = (BLOCKS + 100 - BLOCKS // 2) * BLOCK
    assert came[:2] == [begin, begin]
    assert LENGTH == BLOCKS * BLOCK
    memory.close()


def test_a_block_lost_with_its_playback_process_ends_a_message() -> None:
    """Add shear without its drive and its block, as a kill between them leaves it."""
    memory = PlaybackMemory.create(N)
    reader = SamplesReader(memory)
    fill(memory, 2)
    memory.commanded.add(np.zeros((BLOCK, N)))
    fill(memory, 2)
    assert numbers(reader.read(memory, HOW)) == [0, *range(2 * BLOCK)]
    assert numbers(reader.read(memory, HOW)) == [3 * BLOCK, *range(3 * BLOCK, 5 * BLOCK)]
    memory.close()


def test_a_display_that_was_opened_anew_has_another_memory_and_numbers() -> None:
    memory = PlaybackMemory.create(N)
    reader = SamplesReader(memory)
    fill(memory, 3)
    assert numbers(reader.read(memory, HOW))[0] == 0
    memory.close()
    other = PlaybackMemory.create(N)
    fill(other, 2)
    assert numbers(reader.read(other, HOW)) == [0, *range(2 * BLOCK)]
    other.close()


def test_a_link_that_takes_frames_has_the_finger_and_no_samples() -> None:
    memory = PlaybackMemory.create(N)
    reader = SamplesReader(memory)
    how = DeviceOpened(sample_rate=RATE, carriers=8, frame_rate=100.0)
    for k in range(3):
        block = BlockRecord(80 * k, k / 100, math.nan, k / 100, (1e-3, 0), (0, 0), 0.5, True)
        memory.blocks.add(block)
    message = reader.read(memory, how)
    assert (message.first, message.block_samples, message.uncertainty_us) == (0, 80, None)
    assert not reader.is_behind
    assert message.shear_um is message.drive_v is None
    assert np.frombuffer(message.position_mm, "<f4")[::2] == pytest.approx([1.0] * 3)
    assert reader.read(memory, how).touching == ()
    memory.close()
