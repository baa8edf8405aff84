"""Tests with random messages: nothing breaks, and nothing is driven."""

import asyncio
import json
import random
import socket
from typing import Any

import msgspec
import pytest
from osc_faults import mutated as osc_mutated
from repeating import often
from server_rig import (
    BOTH,
    CONTACT,
    FRAMES,
    GOOD,
    Talker,
    each_encoding,
    figure,
    free_port,
    get,
    serving,
    talking,
    unread,
    until,
)

from tactile.messages import MSGPACK_PROTOCOL, ArmDisplay
from tactile.server import osc
from tactile.server.config import Configuration, OscConfig, ServerConfig
from tactile.server.server import running

pytestmark = pytest.mark.usefixtures("patient")


CORPUS = [message for message, _ in GOOD.values() if message["type"] != "arm"]
CORPUS += [CONTACT, FRAMES]
"""Messages that do not arm; the fuzz shows that nothing else arms either."""
ODD: list[Any] = [
    None, True, -1, 0, 2**63, 1e308, "", "right", "../x", "\0", [], {}, [[]], [0] * 5000, {"a": {}},
    "arm", "estop", -0.0, 1e-320, "x" * 70, 2**64 - 1,
]  # fmt: skip


def mutated(rng: random.Random, protocol: str, display: str = "right") -> str | bytes:
    """Return a message with a few faults in its content, in its bytes, or in nothing."""
    message: dict[str, Any] = json.loads(json.dumps(rng.choice(CORPUS)))
    if "display" in message:
        message["display"] = display
    for _ in range(rng.randrange(3)):
        key = rng.choice([*message, "id", "extra"])
        odd = rng.choice(ODD)
        if key == "type" and odd == "arm":
            continue
        message[key] = odd if rng.random() < 0.8 else [odd, odd]
        if rng.random() < 0.2:
            del message[rng.choice(list(message))]
    if protocol == MSGPACK_PROTOCOL:
        data = msgspec.msgpack.encode(message)
    else:
        data = json.dumps(message).encode()
    if rng.random() < 0.4:
        broken = bytearray(data)
        for _ in range(rng.randrange(1, 4)):
            broken[rng.randrange(len(broken))] = rng.randrange(256)
        data = bytes(broken[: rng.randrange(1, len(broken) + 1)])
    return data if protocol == MSGPACK_PROTOCOL else data.decode("utf-8", "replace")


@pytest.mark.parametrize("count", [2000, pytest.param(often(100_000), marks=pytest.mark.ci)])
@each_encoding
async def test_whatever_is_sent_nothing_breaks_and_nothing_is_armed(
    protocol: str, count: int
) -> None:
    rng = random.Random(f"{protocol} {count}")

    async def batch(talker: Talker, most: int) -> int:
        for _ in range(most):
            await talker.link.send(mutated(rng, protocol))
        await talker.send(type="get_stats", display="right", id=77_777)
        while (found := await talker.receive()).get("id") != 77_777:
            assert found["type"] in (
                "failure",
                "done",
                "textures",
                "texture_picture",
                "effects",
                "appended",
                "stats",
                "pong",
            )
        return most

    sent = 0
    async with serving(messages_per_second=100_000) as (there, hands):
        while sent < count:
            async with talking(there, protocol) as talker:
                sent += await batch(talker, min(count - sent, 50))
        async with talking(there, protocol) as talker:
            assert (await talker.ask(type="ping", time_us=1, id=5))["id"] == 5
        assert not hands.armed
        assert all(not isinstance(c, ArmDisplay) for hand in hands.clients for c in hand.commands)
        assert figure(there, "tactile_failures_total", code="internal") == 0
        assert figure(there, "tactile_failures_total", code="invalid_field") > count / 10
        assert figure(there, "tactile_failures_total", code="malformed") > count / 20


async def disturb(talker: Talker, link: socket.socket, rng: random.Random) -> None:
    """Send faulty messages and packets, and see that none arms."""
    for _ in range(100):
        await talker.link.send(mutated(rng, talker.protocol, "default"))
        link.send(osc_mutated(rng))
    await talker.send(type="get_stats", display="default", id=77_777)
    while (found := await talker.receive()).get("id") != 77_777:
        assert found.get("kind") != "armed"
        assert found.get("state", "disarmed") != "armed"


async def arm_and_touch(talker: Talker) -> None:
    """Do what an app does, and check that it is done."""
    estop = (await talker.asked(type="get_stats", display="default")).get("estop", 0)
    clear = {"type": "clear", "estop": max(estop, 1)}
    for request, state in ((clear, "disarmed"), ({"type": "arm"}, "armed")):
        if request is not clear or estop:
            assert (await talker.asked(**request, display="default"))["type"] == "done"
        while (await talker.asked(type="get_stats", display="default"))["state"] != state:
            await asyncio.sleep(0.01)
    layers = [{"texture": "wood-oak"}]
    await talker.asked(type="select", display="default", layers=layers)
    number, stats = 0, dict[str, Any]()
    while number < 50 or not stats.get("touching"):  # a slow machine may let a finger fall silent
        place = {"display": "default", "position_mm": [number * 0.8, 0], "time_us": None}
        await talker.send(**CONTACT | place)
        await asyncio.sleep(0.01)
        stats = await talker.asked(type="get_stats", display="default")
        number += 1
    assert (stats["state"], stats["owner"]) == ("armed", True)


@pytest.mark.realtime
async def test_the_real_host_takes_all_of_it_too_and_the_display_stays_disarmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Messages also come by OSC; then the host still does what it should, down to its drive."""
    rng = random.Random(5)
    monkeypatch.setattr(osc, "SILENCE", 0.2)
    monkeypatch.setattr(osc.log, "disabled", True)
    port = free_port()
    config = Configuration(
        server=ServerConfig(port=0, socket="", messages_per_second=100_000),
        osc=OscConfig(port=port),
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        async with running(config) as there:
            for protocol in 100 * BOTH:
                async with talking(there, protocol) as talker:
                    await disturb(talker, link, rng)
            await until(lambda: figure(there, "tactile_clients", transport="osc") == 0)
            async with talking(there) as talker:
                before = await talker.asked(type="get_stats", display="default")
                assert before["state"] in ("estopped", "disarmed")
                assert figure(there, "tactile_failures_total", code="internal") == 0
                await arm_and_touch(talker)
            assert (await get(there, "/healthz")).status_code == 200


async def test_bytes_that_are_no_http_and_no_frames_break_nothing() -> None:
    rng = random.Random(1)
    async with serving() as (there, _), talking(there) as other:
        for number in range(100):
            if number % 2:
                link = await unread(there)
                link.setblocking(False)
                head = b""
            else:
                link = socket.socket()
                link.setblocking(False)
                loop = asyncio.get_running_loop()
                await loop.sock_connect(link, ("127.0.0.1", there.port))
                head = rng.choice([b"GET /v1 HTTP/1.1\r\n", b"", b"GET http://[ HTTP/1.1\r\n"])
            with link:
                noise = rng.randbytes(rng.randrange(1, 300))
                await asyncio.get_running_loop().sock_sendall(link, head + noise)
            assert (await other.ask(type="ping", time_us=1, id=number))["id"] == number
        await until(lambda: len(there.site.places) == 1)
