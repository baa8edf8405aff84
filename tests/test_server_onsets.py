"""Tests of what the server reports of stimuli that begin at a time.

All of the server is real but time and the boundaries of processes (`virtual_server`).
"""

import asyncio
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs
from virtual_server import World, virtual_world

from tactile import messages as m
from tactile.playback.schedule import MOST_SCHEDULED
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig, ServerConfig

NAME = "left"
HOLD = m.PlayEffect(display=NAME, amplitude_um=1.0, amplitude=(m.Point(0.0, 1.0),))
WAVE = m.Append(display=NAME, sample_rate_hz=8000.0, amplitude_um=1.0, samples=(0.5,) * 400)
FRAMES = m.TactileFrames(
    display=NAME, frame_rate_hz=1000.0, amplitude_um=1.0, frames=(0.5,) * 24 * 20
)

NAMED = m.PlayNamedEffect(display=NAME, effect="hum")
HUM = """
[effect]
description = "160 Hz at half of 10 µm"
[[effect.perceptions]]
[[effect.perceptions.channels]]
[[effect.perceptions.channels.bands]]
kind = "wave"
[[effect.perceptions.channels.bands.segments]]
keyframes = [{ time_s = 0.0, amplitude = 0.5 }, { time_s = 0.5, amplitude = 0.5 }]
"""


@pytest.fixture
def world() -> Iterator[World]:
    with virtual_world(lambda playback, volts: None) as made:
        yield made


@pytest.fixture
def client(world: World, tmp_path: Path) -> Client:
    """Return a client of a server whose only display is armed and is worn, so that waves sound."""
    (tmp_path / "hum.toml").write_text(HUM)
    display = DisplayConfig(name=NAME, device="mock:", sample_rate_hz=8000.0, worn=True)
    server = ServerConfig(effects=str(tmp_path))
    assert world.start(Configuration(server=server, display=(display,)))
    assert world.host is not None
    client = world.host.connect("app", roles=m.ALL_ROLES)
    assert world.run(client.request(m.ArmDisplay(display=NAME))) == m.Done()
    world.run(asyncio.sleep(0.1))
    return client


def ahead(world: World, seconds: float, number: int = 1, *, drop_late: bool = False) -> m.BeginAt:
    at_us = round(1e6 * (world.clock.now() + seconds))
    return m.BeginAt(at_us=at_us, drop_late=drop_late, number=number)


def ask(world: World, client: Client, command: Any) -> m.Answer | None:
    """Send a request, or a message of a stream; return the answer, if there is one."""

    async def sent() -> m.Answer | None:
        if isinstance(command, m.TactileFrames):
            return client.stream(command, world.clock.now())
        return await client.request(command)

    return world.run(sent())


def sounds(world: World, client: Client) -> bool:
    async def looked() -> bool:
        return client.sounds

    return world.run(looked())


def onsets(client: Client) -> list[m.OnsetMessage]:
    queued = [client.outbox.get_nowait() for _ in range(client.outbox.qsize())]
    return [message for message in queued if isinstance(message, m.OnsetMessage)]


@pytest.mark.parametrize("command", [WAVE, HOLD, NAMED, FRAMES])
def test_an_onset_is_reported_to_its_client_alone(
    world: World, client: Client, command: Any
) -> None:
    assert world.host is not None
    other = world.host.connect("other", roles=m.ALL_ROLES)
    begin = ahead(world, 0.5, 7)
    ask(world, client, structs.replace(command, begin=structs.replace(begin, marker=0x81)))
    world.run(asyncio.sleep(0.7))
    assert onsets(client) == []
    world.run(asyncio.sleep(0.2))
    (onset,) = onsets(client)
    assert (onset.display, onset.number, onset.at_us, onset.reason) == (NAME, 7, begin.at_us, "")
    assert onset.onset_us == pytest.approx(begin.at_us, abs=0.5e6 / 8000 + 1)
    assert onset.uncertainty_us == 0, "the amplifier and the host have one clock"
    assert onset.marker == 0x81
    assert onsets(other) == []


@pytest.mark.parametrize("command", [WAVE, HOLD, NAMED, FRAMES])
@pytest.mark.parametrize(
    ("lines", "code", "text"),
    [
        (0, 1, "code 1; must be below 1, as the amplifier has 0 marker lines"),
        (1, 255, "code 255; must be below 2, as the amplifier has 1 marker line"),
        (3, 8, "code 8; must be below 8, as the amplifier has 3 marker lines"),
    ],
)
def test_a_marker_that_the_amplifier_does_not_have_is_refused(
    world: World, client: Client, command: Any, lines: int, code: int, text: str
) -> None:
    assert world.host is not None
    playing = world.host.playing[NAME]
    playing.how = dataclasses.replace(playing.how, marker_lines=lines)
    begin = structs.replace(ahead(world, 0.5), marker=code)
    refused = ask(world, client, structs.replace(command, begin=begin))
    assert isinstance(refused, m.Failure)
    assert (refused.field, refused.message) == ("begin.marker", text)
    reports = [(one.onset_us, one.reason) for one in onsets(client)]
    assert reports == [(None, text)] * isinstance(command, m.TactileFrames)


@pytest.mark.parametrize("command", [HOLD, FRAMES])
def test_a_client_sounds_until_what_it_has_scheduled_is_over(
    world: World, client: Client, command: Any
) -> None:
    """Signs of life are due from its program until then."""
    ask(world, client, structs.replace(command, begin=ahead(world, 2.0)))
    world.run(asyncio.sleep(1.9))
    assert sounds(world, client)
    world.run(asyncio.sleep(1.5))
    assert not sounds(world, client)


def test_frames_that_continue_a_stream_that_waits_sound_with_it(
    world: World, client: Client
) -> None:
    ask(world, client, structs.replace(FRAMES, begin=ahead(world, 2.0)))
    for _ in range(40):
        ask(world, client, FRAMES)
    world.run(asyncio.sleep(2.7))
    assert sounds(world, client)


@pytest.mark.parametrize("command", [WAVE, HOLD, NAMED, FRAMES])
def test_a_time_that_is_too_far_ahead_is_refused(
    world: World, client: Client, command: Any
) -> None:
    """Frames have no answer to be refused by, and are reported as well."""
    refused = ask(world, client, structs.replace(command, begin=ahead(world, 3600.0, 2)))
    assert isinstance(refused, m.Failure)
    assert refused.field == "begin.at_us"
    assert refused.message == "3600 s ahead; at most 60 s"
    reports = [(one.number, one.onset_us, one.reason) for one in onsets(client)]
    expected = (2, None, "3600 s ahead; at most 60 s")
    assert reports == [expected] * isinstance(command, m.TactileFrames)


def test_a_time_that_has_passed_is_reported(world: World, client: Client) -> None:
    ask(world, client, structs.replace(WAVE, begin=ahead(world, -5.0, 3, drop_late=True)))
    world.run(asyncio.sleep(0.1))
    (onset,) = onsets(client)
    assert (onset.number, onset.onset_us) == (3, None)
    assert onset.reason.startswith("late by 50")


def test_frames_with_a_time_for_a_display_that_is_not_armed_are_reported(
    world: World, client: Client
) -> None:
    ask(world, client, m.DisarmDisplay(display=NAME))
    world.run(asyncio.sleep(0.5))
    ask(world, client, structs.replace(FRAMES, begin=ahead(world, 0.5, 4)))
    (onset,) = onsets(client)
    assert (onset.number, onset.onset_us, onset.reason) == (4, None, "the display was not armed")


def test_a_stimulus_is_reported_at_once_when_the_display_is_disarmed(
    world: World, client: Client
) -> None:
    ask(world, client, structs.replace(HOLD, begin=ahead(world, 30.0, 5)))
    ask(world, client, m.DisarmDisplay(display=NAME))
    world.run(asyncio.sleep(0.5))
    (onset,) = onsets(client)
    assert (onset.number, onset.onset_us, onset.reason) == (5, None, "the display was not armed")


def test_a_request_to_a_playback_that_is_lost_is_refused_and_not_reported(
    world: World, client: Client
) -> None:
    (playback,) = world.playbacks()
    playback.kill()
    world.run(asyncio.sleep(0.2))
    refused = ask(world, client, structs.replace(HOLD, begin=ahead(world, 2.0, 6)))
    assert isinstance(refused, m.Failure)
    world.run(asyncio.sleep(3.0))
    assert onsets(client) == []


def test_stimuli_are_reported_when_playback_dies(world: World, client: Client) -> None:
    ask(world, client, structs.replace(HOLD, begin=ahead(world, 2.0, 3)))
    (playback,) = world.playbacks()
    playback.kill()
    world.run(asyncio.sleep(1.0))
    (onset,) = onsets(client)
    assert (onset.number, onset.onset_us, onset.reason) == (3, None, "playback was lost")


def test_a_stimulus_that_is_refused_is_not_reported_again(world: World, client: Client) -> None:
    for mark in range(MOST_SCHEDULED):
        command = structs.replace(HOLD, begin=ahead(world, 2.0, mark))
        assert ask(world, client, command) == m.Done()
    refused = ask(world, client, structs.replace(HOLD, begin=ahead(world, 2.0, 99)))
    assert isinstance(refused, m.Failure)
    assert "64 stimuli of this program wait" in refused.message
    (playback,) = world.playbacks()
    playback.kill()
    world.run(asyncio.sleep(1.0))
    assert sorted(onset.number for onset in onsets(client)) == list(range(MOST_SCHEDULED))
