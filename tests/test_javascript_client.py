"""The JavaScript client against the server: requests, reconnection, e-stops, contacts, clocks."""

import asyncio
import socket
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, TypeVar

import pytest
from node_rig import Node, NodeError, node
from server_rig import CONTACT, Hands, free_port, serving, until

from tactile.messages import (
    ApiMessage,
    ArmDisplay,
    BeginAt,
    Contact,
    EStop,
    EventMessage,
    OnsetMessage,
    PlayEffect,
    Select,
    SetGain,
    Subscribe,
    TactileFrames,
)
from tactile.server.config import TokenConfig

pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("patient")]

C = TypeVar("C", bound=ApiMessage)
OPEN = """
kept.c = connect({url, webSocket: WebSocket, client: "node", ...options});
kept.states = []; kept.events = []; kept.failures = [];
kept.c.on("state", (c) => kept.states.push(c.state));
kept.c.on("event", (event) => kept.events.push(event));
kept.c.on("failure", (failure) => kept.failures.push(failure));
"""
READY = "const welcome = await kept.c.ready(); kept.d = kept.c.display('right'); return welcome;"
SETTLED = "while ({}) await new Promise((r) => setTimeout(r, 5));"
"""JavaScript that waits until something is so."""


@pytest.fixture
async def javascript(tmp_path: Path) -> AsyncIterator[Node]:
    async with node(tmp_path) as running:
        yield running


async def opened(javascript: Node, url: str, **options: Any) -> Any:
    await javascript.run(OPEN, url=url, options=options)
    return await javascript.run(READY)


def commands(hands: Hands, kind: type[C]) -> list[C]:
    return [command for _, command in hands.log if isinstance(command, kind)]


REQUESTS = {
    "select": "kept.d.select(['wood-oak', {texture: 'plastic', gain: 0.5, seed: 3}])",
    "gain": "kept.d.gain(0.25)",
    "stop": "kept.d.stop()",
    "play": "kept.d.resume()",
    "arm": "kept.d.arm()",
    "disarm": "kept.d.disarm()",
    "clear": "kept.d.clear(4)",
    "effect": "kept.d.effect({amplitude_um: 5, amplitude: [[0, 1], [9, 0]]})",
    "play_effect": "kept.d.playEffect('tap', 0.5)",
    "append": "kept.d.append(new Float32Array([0, 0.5, -1]), "
    "{sample_rate_hz: 8000, amplitude_um: 5})",
    "get_stats": "kept.d.stats()",
    "list_textures": "kept.c.textures()",
    "list_effects": "kept.c.effects()",
    "estop": "kept.d.estop()",
}


async def test_each_request_arrives_and_is_answered(javascript: Node) -> None:
    async with serving() as (there, hands):
        welcome = await opened(javascript, there.url)
        assert [info["name"] for info in welcome["displays"]] == ["right", "left"]
        replies = {k: await javascript.run(f"return await {v}") for k, v in REQUESTS.items()}
        arrived = [type(command).__struct_config__.tag for _, command in hands.log if command]
        assert arrived == list(REQUESTS)
        assert [layer.texture for layer in commands(hands, Select)[0].layers] == [
            "wood-oak", "plastic",
        ]  # fmt: skip
        assert replies["append"]["samples_consumed"] == 12  # the bytes of three numbers
        assert replies["list_textures"][0]["name"] == "wood-oak"
        assert replies["list_effects"][0]["name"] == "tap"
        assert replies["get_stats"]["counters"] == {"underruns": 0}


async def test_a_failure_rejects_with_its_code_and_field(javascript: Node) -> None:
    async with serving() as (there, hands):
        await opened(javascript, there.url)
        hands.codes[ArmDisplay] = "estopped"
        with pytest.raises(NodeError, match="display: as told") as caught:
            await javascript.run("await kept.d.arm()")
        assert (caught.value.name, caught.value.code) == ("RequestError", "estopped")
        with pytest.raises(NodeError, match='no display "middle"; there are: right, left'):
            await javascript.run("kept.c.display('middle')")


async def test_contacts_arrive_as_they_were_sent(javascript: Node) -> None:
    async with serving() as (there, hands):
        await opened(javascript, there.url)
        await javascript.run(
            "kept.d.touch([1, 2], {normal_force_n: 0.5, velocity_mm_s: [80, 0], time_us: 5});"
            "kept.d.lift(6); await kept.c.request({type: 'ping', time_us: 1})"
        )
        first, second = commands(hands, Contact)
        assert {
            "type": "contact",
            **{name: getattr(first, name) for name in first.__struct_fields__},
        } == {**CONTACT, "position_mm": (1.0, 2.0), "velocity_mm_s": (80.0, 0.0)}
        assert (second.position_mm, second.normal_force_n, second.time_us) == ((1.0, 2.0), 0.0, 6)


async def test_too_many_contacts_are_counted_here_and_none_is_refused_there(
    javascript: Node,
) -> None:
    async with serving(messages_per_second=200) as (there, hands):
        await opened(javascript, there.url)
        dropped = await javascript.run(
            "for (let k = 0; k < 5000; k++) kept.d.touch([k / 1000, 0]);"
            "kept.d.lift(); await kept.d.stats(); return kept.d.droppedContacts"
        )
        contacts = commands(hands, Contact)
        assert len(contacts) + dropped == 5001
        assert dropped > 4000
        assert contacts[-1].normal_force_n == 0  # the finger is lifted all the same
        assert await javascript.run("return kept.failures") == []


async def test_frames_arrive_as_they_were_sent_and_too_many_are_counted(javascript: Node) -> None:
    stream = "{frame_rate_hz: 1000, amplitude_um: 5, latest: true}"
    async with serving(messages_per_second=200) as (there, hands):
        await opened(javascript, there.url)
        dropped = await javascript.run(
            f"kept.d.frames(new Float32Array([0.5, -1]), {stream});"
            f"kept.d.frames([0.25], {stream});"
            f"for (let k = 0; k < 5000; k++) kept.d.frames([0], {stream});"
            "await kept.d.stats(); return kept.d.droppedFrames"
        )
        frames = commands(hands, TactileFrames)
        assert len(frames) + dropped == 5002
        assert dropped > 4000
        first, second = frames[:2]
        assert (first.frames, second.frames) == (struct.pack("<2f", 0.5, -1.0), (0.25,))
        assert (first.frame_rate_hz, first.amplitude_um, first.latest) == (1000.0, 5.0, True)
        assert await javascript.run("return kept.failures") == []


async def test_a_contact_that_is_refused_is_a_failure_without_a_request(javascript: Node) -> None:
    async with serving() as (there, _):
        await opened(javascript, there.url)
        await javascript.run("kept.d.touch([1e9, 0]);" + SETTLED.format("!kept.failures.length"))
        (failure,) = await javascript.run("return kept.failures")
        assert (failure["code"], failure["field"]) == ("invalid_field", "position_mm[0]")


async def test_the_report_on_what_began_at_a_time_comes_to_all_who_listen(javascript: Node) -> None:
    async with serving() as (there, hands):
        await opened(javascript, there.url)
        await javascript.run("kept.onsets = []; kept.c.on('onset', (o) => kept.onsets.push(o));")
        await javascript.run(
            "kept.d.effect({amplitude_um: 5, transients: [[0, 1, 160]],"
            " begin: {at_us: 7000000, drop_late: true, number: 3}})"
        )
        (effect,) = commands(hands, PlayEffect)
        assert effect.begin == BeginAt(at_us=7_000_000, drop_late=True, number=3)
        report = OnsetMessage(
            display="right", number=3, at_us=7_000_000, onset_us=7_000_040.5, uncertainty_us=30.0
        )
        hands.clients[0].outbox.put_nowait(report)
        await javascript.run(SETTLED.format("!kept.onsets.length"))
        (onset,) = await javascript.run("return kept.onsets")
        assert (onset["number"], onset["onset_us"], onset["uncertainty_us"]) == (3, 7_000_040.5, 30)


async def test_events_and_telemetry_come_to_all_who_listen(javascript: Node) -> None:
    async with serving() as (there, hands):
        await opened(javascript, there.url)
        for rate in (20, 60, 20):
            await javascript.run(
                "kept.ends ??= []; kept.got ??= [];"
                "kept.ends.push(kept.d.telemetry(rate, (t) => kept.got.push([rate, t.time_us])))",
                rate=rate,
            )
        await javascript.run(SETTLED.format("kept.got.length < 6"))
        rates = [c.rate_hz for c in commands(hands, Subscribe)]
        assert rates == [20, 60, 60]
        await javascript.run("kept.ends.forEach((end) => end()); await kept.d.stats()")
        rates = [c.rate_hz for c in commands(hands, Subscribe)]
        assert rates[3:] == [60, 20, 0]
        hands.clients[0].outbox.put_nowait(EventMessage(display="right", kind="estopped", estop=3))
        await javascript.run(SETTLED.format("!kept.events.length"))
        assert await javascript.run("return [kept.events[0].kind, kept.d.estopped]") == [
            "estopped", 3,
        ]  # fmt: skip
        hands.clients[0].outbox.put_nowait(EventMessage(display="right", kind="cleared", estop=3))
        await javascript.run(SETTLED.format("kept.events.length < 2"))
        assert await javascript.run("return kept.d.estopped") == 0


async def test_a_reconnection_restores_what_plays_and_arms_nothing(javascript: Node) -> None:
    port = free_port(socket.SOCK_STREAM)
    async with serving(port=port) as (there, hands):
        await opened(javascript, there.url)
        await javascript.run(
            "await kept.d.gain(0.5); await kept.d.select('wood-oak'); await kept.d.arm();"
            "kept.d.telemetry(30, () => {}); await kept.d.stats()"
        )
        assert hands.armed
    await javascript.run(SETTLED.format("kept.c.state === 'connected'"))
    with pytest.raises(NodeError, match="not connected") as caught:
        await javascript.run("await kept.d.arm()")
    assert caught.value.name == "DisconnectedError"
    await javascript.run("kept.d.touch([1, 2]);")
    async with serving(port=port) as (_, hands):
        await javascript.run(READY)
        await javascript.run("await kept.d.stats()")
        arrived = [type(command) for _, command in hands.log]
        assert set(arrived[:3]) == {SetGain, Select, Subscribe}
        assert ArmDisplay not in arrived
        assert Contact not in arrived
        states = await javascript.run("return kept.states")
        assert (states[0], states[1], states[-1]) == ("connected", "connecting", "connected")
        assert await javascript.run("return kept.d.droppedContacts") == 1


async def test_an_estop_without_a_server_is_sent_first_to_the_next(javascript: Node) -> None:
    port = free_port(socket.SOCK_STREAM)
    async with serving(port=port) as (there, _):
        await opened(javascript, there.url)
        await javascript.run("await kept.d.gain(0.5)")
    await javascript.run(SETTLED.format("kept.c.state === 'connected'"))
    for call in ("kept.c.estop()", "kept.d.estop()", "kept.d.estop()"):
        with pytest.raises(NodeError, match="the e-stop is kept and will be sent first"):
            await javascript.run(f"await {call}")
    async with serving(port=port) as (_, hands):
        await javascript.run(READY)
        await javascript.run("await kept.d.stats()")
        assert [type(command) for _, command in hands.log[:3]] == [EStop, EStop, SetGain]
        assert [c.display for c in commands(hands, EStop)] == [
            None, "right",
        ]  # fmt: skip


async def test_an_estop_that_is_refused_is_sent_to_the_next_server(javascript: Node) -> None:
    port = free_port(socket.SOCK_STREAM)
    async with serving(port=port) as (there, hands):
        await opened(javascript, there.url)
        hands.codes[EStop] = "internal"
        with pytest.raises(NodeError, match="as told"):
            await javascript.run("await kept.d.estop()")
    async with serving(port=port) as (_, hands):
        await until(lambda: bool(commands(hands, EStop)))


async def test_a_wrong_token_is_refused_for_good(javascript: Node, tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text("correct horse battery staple\n")
    path.chmod(0o600)
    token = TokenConfig(file=str(path))
    async with serving(token=(token,)) as (there, _):
        await javascript.run(OPEN, url=there.url, options={"token": "wrong"})
        with pytest.raises(NodeError, match="wrong token: must be one of") as caught:
            await javascript.run(READY)
        assert caught.value.name == "DisconnectedError"
        assert await javascript.run("return [kept.c.state, kept.states]") == [
            "refused", ["refused"],
        ]  # fmt: skip
        await opened(javascript, there.url, token="correct horse battery staple")


async def test_what_a_listener_throws_harms_no_other(javascript: Node) -> None:
    async with serving() as (there, hands):
        await opened(javascript, there.url)
        await javascript.run(
            "kept.thrown = []; process.on('uncaughtException', (e) => kept.thrown.push(e.message));"
            "const second = [...kept.c.listeners.event];"
            "kept.c.listeners.event.clear();"
            "kept.c.on('event', () => { throw new Error('mine'); });"
            "second.forEach((listener) => kept.c.on('event', listener))"
        )
        hands.clients[0].outbox.put_nowait(EventMessage(display="right", kind="armed"))
        await javascript.run(SETTLED.format("!kept.events.length || !kept.thrown.length"))
        assert await javascript.run("return kept.thrown") == ["mine"]
        assert (await javascript.run("return await kept.d.stats()"))["type"] == "stats"


async def test_the_servers_clock_is_known_to_half_a_round_trip(javascript: Node) -> None:
    async with serving() as (there, _):
        await opened(javascript, there.url)
        before = asyncio.get_running_loop().time() * 1e6
        theirs, round_trip_ms = await javascript.run(
            "return [kept.c.serverTime_us(), kept.c.roundTrip_ms]"
        )
        after = asyncio.get_running_loop().time() * 1e6
        half = round_trip_ms * 1e3 / 2 + 1
        assert before - half <= theirs <= after + half


async def test_an_address_that_is_none_is_refused_in_a_sentence(javascript: Node) -> None:
    await javascript.run(OPEN, url="nonsense", options={})
    with pytest.raises(NodeError, match="cannot connect to nonsense: "):
        await javascript.run(READY)


async def test_close_ends_all(javascript: Node) -> None:
    async with serving() as (there, hands):
        await opened(javascript, there.url)
        await javascript.run("kept.c.close()")
        with pytest.raises(NodeError, match="closed by this program"):
            await javascript.run("await kept.d.gain(1)")
        await until(lambda: bool(hands.clients[0].closed))
