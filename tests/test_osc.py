"""Tests of OSC: packets of engines, read as python-osc writes them, and bad packets.

The judge of what is OSC is python-osc, where it comes to an end; it hangs on one packet here.
"""

import asyncio
import math
import random
import socket
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from osc_faults import bundle, mutated, packet
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder, build_msg
from pythonosc.osc_packet import OscPacket
from repeating import often
from server_rig import PATIENCE, Hands, figure, free_port, serving, until

from tactile.errors import InputError
from tactile.messages import (
    ArmDisplay,
    ClearEstop,
    Contact,
    EStop,
    Failure,
    Select,
    SetGain,
    StopPlaying,
)
from tactile.server import osc
from tactile.server.osc import read_estops, read_packet, to_command
from tactile.server.server import Server

pytestmark = pytest.mark.usefixtures("patient")

MOST_SENDERS = 16
"""Senders that are told apart at a time; each takes a client's place."""
MOST_USED = 32
"""Packets that are used before anything else gets its turn."""


@asynccontextmanager
async def sending(**options: Any) -> AsyncIterator[tuple[Server, Hands, socket.socket]]:
    """Run a server, and a socket that sends to its OSC port."""
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        async with serving(osc=port, **options) as (there, hands):
            yield there, hands, link


# Decoding


@pytest.mark.parametrize(
    "values", [(), (1.5,), (1, 2, 3), ("a", 1.0, "", 7), ("wood-oak",), (2**40, -(2**40))]
)
def test_messages_are_read_as_python_osc_reads_them(values: tuple[Any, ...]) -> None:
    data = packet("/tactile/x", *values)
    (judged,) = OscPacket(data).messages
    assert read_packet(data) == [(judged.message.address, list(judged.message.params))]
    assert read_packet(data) == [("/tactile/x", list(values))]


def test_doubles_are_read() -> None:
    builder = OscMessageBuilder("/a")
    builder.add_arg(math.pi, "d")
    assert read_packet(builder.build().dgram) == [("/a", [math.pi])]


def test_bundles_in_bundles_are_read_in_their_order() -> None:
    inner = OscBundleBuilder(IMMEDIATELY)
    for number in (2, 3):
        inner.add_content(build_msg("/b", [number]))
    outer = OscBundleBuilder(IMMEDIATELY)
    outer.add_content(build_msg("/a", [1]))
    outer.add_content(inner.build())
    outer.add_content(build_msg("/a", [4]))
    data = outer.build().dgram
    found = [(one.message.address, list(one.message.params)) for one in OscPacket(data).messages]
    assert read_packet(data) == found
    assert [values for _, values in found] == [[1], [2], [3], [4]]


BAD_PACKETS = {
    "nothing": b"",
    "no address": b"tactile\0",
    "address without end": b"/tactile",
    "types without comma": b"/a\0\0i\0\0\0\0\0\0\1",
    "value missing": b"/a\0\0,i\0\0",
    "value cut": b"/a\0\0,i\0\0\0\0",
    "string without end": b"/a\0\0,s\0\0abcd",
    "many values": b"/a\0\0," + b"i" * 9 + b"\0\0" + b"\0\0\0\1" * 9,
    "unknown type": b"/a\0\0,b\0\0\0\0\0\1x\0\0\0",
    "no ASCII": b"/\xff\0\0,\0\0\0",
    "bundle cut": b"#bundle\0\0\0",
    "element of -4 bytes": b"#bundle\0" + bytes(7) + b"\1" + b"\xff\xff\xff\xfc",
    "element of 0 bytes": b"#bundle\0" + bytes(7) + b"\1" + bytes(4) + packet("/a"),
    "element too long": b"#bundle\0" + bytes(7) + b"\1" + b"\0\0\1\0" + packet("/a"),
    "element of 5 bytes": b"#bundle\0" + bytes(7) + b"\1" + b"\0\0\0\5" + packet("/a") + b"\0",
    "too large": packet("/a") + bytes(5000),
}


@pytest.mark.parametrize("name", BAD_PACKETS)
def test_what_is_no_osc_is_refused_and_comes_to_an_end(name: str) -> None:
    """python-osc 1.10 reads an element of −4 bytes for ever."""
    with pytest.raises(InputError):
        read_packet(BAD_PACKETS[name])


def test_bundles_nested_as_deep_as_a_packet_holds_are_read() -> None:
    data = packet("/a")
    while len(data) + 20 <= 4096:
        data = bundle(data)
    assert read_packet(data) == [("/a", [])]
    with pytest.raises(InputError, match="4097 bytes: at most 4096"):
        read_packet(bytes(4097))


# Meaning


@pytest.mark.parametrize(
    ("address", "values", "expected"),
    [
        (
            "/tactile/contact", [1.0, 2.0, 0.5],
            Contact(display="right", position_mm=(1.0, 2.0), normal_force_n=0.5),
        ),
        (
            "/tactile/left/contact", [1, 2, 0, 80.0, -3],
            Contact(
                display="left", position_mm=(1, 2), normal_force_n=0, velocity_mm_s=(80.0, -3)
            ),
        ),
        ("/tactile/gain", [0.25], SetGain(display="right", gain=0.25)),
        ("/tactile/stop", [], StopPlaying(display="right")),
        ("/tactile/stop", [1], StopPlaying(display="right")),
        ("/tactile/left/estop", [], EStop(display="left")),
        ("/tactile/texture", [], Select(display="right", layers=())),
        ("/tactile/texture", [""], Select(display="right", layers=())),
    ],
)  # fmt: skip
def test_messages_become_commands(address: str, values: list[Any], expected: Any) -> None:
    assert to_command(address, values, "right") == expected


def test_textures_become_layers() -> None:
    command = to_command("/tactile/texture", ["wood-oak", "silk"], "right")
    assert isinstance(command, Select)
    assert [layer.texture for layer in command.layers] == ["wood-oak", "silk"]


BAD_MESSAGES: list[tuple[str, list[Any]]] = [
    ("/tactile/contact", []),
    ("/tactile/contact", [1.0, 2.0]),
    ("/tactile/contact", [1.0, 2.0, 0.5, 80.0]),
    ("/tactile/contact", [math.nan, 2.0, 0.5]),
    ("/tactile/contact", [1.0, math.inf, 0.5]),
    ("/tactile/contact", [1.0, 2.0, math.nan]),
    ("/tactile/contact", [1.0, 2.0, -0.5]),
    ("/tactile/contact", [1.0, 2.0, 51.0]),
    ("/tactile/contact", [1e9, 2.0, 0.5]),
    ("/tactile/contact", [1.0, 2.0, 0.5, math.nan, 0.0]),
    ("/tactile/contact", ["1", 2.0, 0.5]),
    ("/tactile/../contact", [1.0, 2.0, 0.5, 0.0, 0.0, 0.0]),
    ("/tactile/gain", [1.5]),
    ("/tactile/gain", []),
    ("/tactile/gain", ["1"]),
    ("/tactile/texture", [5]),
    ("/tactile/texture", ["../../etc/passwd"]),
    ("/tactile/texture", ["a", "b", "c", "d", "e"]),
    ("/tactile/arm", []),
    ("/tactile/right/arm", [1]),
    ("/tactile/clear", []),
    ("/tactile/disarm", []),
    ("/tactile/append", [1.0]),
    ("/tactile", []),
    ("/", []),
    ("/other/contact", [1.0, 2.0, 0.5]),
    ("/avatar/parameters/x", [1.0]),
    ("/tactile/*", []),
    ("/tactile/{stop,arm}", []),
]


@pytest.mark.parametrize(("address", "values"), BAD_MESSAGES)
def test_what_cannot_be_meant_is_a_failure(address: str, values: list[Any]) -> None:
    assert isinstance(to_command(address, values, "right"), Failure)


# Over a socket


async def test_what_is_sent_reaches_the_display_by_a_client_that_may_not_arm() -> None:
    async with sending() as (there, hands, link):
        link.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
        link.send(packet("/tactile/left/contact", 3.0, 4.0, 0.5))
        link.send(bundle(packet("/tactile/gain", 0.5), packet("/tactile/estop")))
        await until(lambda: len(hands.log) == 4)
        stopping, hand = hands.clients
        assert stopping.roles == set()
        assert hand.roles == {"play"}
        assert [c.display for c in hand.contacts] == ["right", "left"]
        assert [type(c) for c in hand.commands] == [SetGain]
        assert stopping.commands == [EStop(display="right")]
        assert figure(there, "tactile_clients", transport="osc") == 1


async def test_a_bundle_of_the_future_is_carried_out_at_once_and_keeps_nobody_waiting() -> None:
    async with sending() as (_, hands, link):
        link.send(bundle(packet("/tactile/contact", 1.0, 2.0, 0.5), time=4e9))
        await until(lambda: len(hands.log) == 1)


async def test_what_is_wrong_is_counted_and_logged_in_bounds_and_nothing_is_armed(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(osc, "MOST_USED", osc.MOST_READ)
    async with sending() as (there, hands, link):
        for data in BAD_PACKETS.values():
            link.send(data)
        for address, values in BAD_MESSAGES:
            link.send(packet(address, *values))
        link.send(packet("/tactile/right/contact", 1.0, 2.0, 0.5))
        await until(lambda: len(hands.log) == 1)
        assert figure(there, "tactile_failures_total", code="malformed") == len(BAD_PACKETS)
        wrong = figure(there, "tactile_failures_total", transport="osc")
        assert wrong == len(BAD_PACKETS) + len(BAD_MESSAGES)
        assert figure(there, "tactile_failures_total", code="internal") == 0
        assert not hands.armed
    complaints = [record for record in caplog.records if "not used" in record.message]
    assert len(complaints) == len(BAD_PACKETS) + len(BAD_MESSAGES)
    assert all("\n" not in str(record.__dict__["fields"]) for record in complaints)


async def test_contacts_on_a_display_that_is_not_armed_are_logged_once_per_sender_and_disarming(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def lines() -> list[dict[str, str]]:
        warned = [record for record in caplog.records if record.message.endswith("no effect")]
        return [record.__dict__["fields"] for record in warned]

    async with sending() as (_, hands, link):

        async def touch(*, armed: bool) -> None:
            hands.armed, before = armed, len(hands.log)
            link.send(packet("/tactile/left/contact", 1.0, 2.0, 0.5))
            await until(lambda: len(hands.log) > before)

        for armed in (False, False, True, True, False, False):
            await touch(armed=armed)
    assert [line["display"] for line in lines()] == ["left", "left"]
    assert lines()[0]["state"] == "disarmed"
    assert "arm_on_start" in lines()[0]["remedy"]


async def test_a_host_that_breaks_is_counted_and_what_follows_is_heard() -> None:
    async with sending() as (there, hands, link):
        hands.broken = True
        link.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
        await until(lambda: figure(there, "tactile_failures_total", code="internal") == 1)
        hands.broken = False
        link.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
        await until(lambda: len(hands.log) == 1)


async def test_a_sender_that_sends_too_fast_loses_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(osc, "loop_time", lambda: 1000.0)
    async with sending(messages_per_second=1) as (there, hands, link):
        for _ in range(100):
            link.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
        reason = {"transport": "osc", "reason": "too_fast"}
        await until(lambda: figure(there, "tactile_dropped_messages_total", **reason) == 98)
        assert len(hands.clients[1].contacts) == 2, "the one that it came with, and one more"


async def test_senders_are_bounded_and_those_that_are_silent_make_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(osc, "YIELDS_AFTER", 1e9)
    monkeypatch.setattr(osc, "SILENCE", 1e6)
    async with sending() as (there, hands, link):
        links = []
        for _ in range(MOST_SENDERS + 1):
            other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            other.connect(link.getpeername())
            other.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
            links.append(other)
        code = "too_many_clients"
        await until(lambda: figure(there, "tactile_failures_total", code=code) == 1)
        assert len(hands.clients) == 1 + MOST_SENDERS
        monkeypatch.setattr(osc, "YIELDS_AFTER", 0.0)
        for other in links[1:]:
            other.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
        await until(lambda: len(hands.clients) == 1 + MOST_SENDERS + 1)
        closed = [hand.closed for hand in hands.clients[1:]]
        assert closed == [1] + [0] * MOST_SENDERS, "the one that was silent longest"
        for other in links:
            other.close()


async def test_a_silent_sender_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(osc, "SILENCE", 0.05)
    async with sending() as (there, hands, link):
        link.send(packet("/tactile/contact", 1.0, 2.0, 0.5))
        await until(lambda: [hand.closed for hand in hands.clients] == [0, 1])
        assert figure(there, "tactile_clients", transport="osc") == 0


async def test_it_listens_on_loopback_only_and_a_port_that_is_taken_is_one_line() -> None:
    async with sending() as (_, __, link):
        assert link.getpeername()[0] == "127.0.0.1"
        port = link.getpeername()[1]
        with pytest.raises(InputError, match=rf"osc\.port = {port}: .*; 0 is off"):
            async with serving(osc=port):
                pass
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as elsewhere:
            elsewhere.bind(("127.0.0.2", port))  # free: not all addresses were taken


# E-stops


def as_one(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let so many packets lie in the socket's buffer together, which the kernel may delay."""
    waiting, deadline, missing = osc.OscProtocol._waiting, time.monotonic() + PATIENCE, count - 1

    def look(self: osc.OscProtocol) -> Iterator[tuple[bytes, osc.Address]]:
        nonlocal missing
        while True:
            for one in waiting(self):
                missing -= 1
                yield one
            if missing <= 0 or time.monotonic() > deadline:
                return

    monkeypatch.setattr(osc.OscProtocol, "_waiting", look)


STOP = packet("/tactile/estop")
CONTACT = packet("/tactile/contact", 1.0, 2.0, 0.5)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (STOP, ["right"]),
        (packet("/tactile/left/estop"), ["left"]),
        (packet("/tactile/estop", 1.0, "x"), ["right"]),
        (bundle(CONTACT, bundle(STOP, packet("/tactile/left/estop"))), ["right", "left"]),
        (bundle(packet("/tactile/gain", 7.0), packet("/nope"), STOP), ["right"]),
        (bundle(b"/a\0\0,b\0\0\0\0\0\1x\0\0\0", STOP), ["right"]),
        (bundle(STOP)[:-4] + b"", []),
        (bundle(STOP) + b"\xff\xff\xff\xfc", []),
        (bundle(bundle(STOP), b"nope"), ["right"]),
        (packet("/tactile/texture", "estop"), []),
        (packet("/tactile/estops"), []),
        (packet("/other/estop"), []),
        (packet("/tactile/estop") + bytes(5000), []),
    ],
)
def test_estops_are_found_in_whatever_a_packet_holds_besides(
    data: bytes, expected: list[str]
) -> None:
    assert [stop.display for stop in read_estops(data, "right")] == expected


async def test_an_estop_is_carried_out_for_a_sender_too_many_and_behind_a_senders_own_flood() -> (
    None
):
    async with sending(messages_per_second=10) as (there, hands, link):
        links = []
        for _ in range(MOST_SENDERS):
            other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            other.connect(link.getpeername())
            other.send(CONTACT)
            links.append(other)
        await until(lambda: len(hands.clients) == 1 + MOST_SENDERS)
        link.send(STOP)
        await until(lambda: len(hands.clients[0].commands) == 1)
        for _ in range(50):
            links[0].send(CONTACT)
        links[0].send(bundle(CONTACT, STOP))
        await until(lambda: len(hands.clients[0].commands) == 2)
        assert len(hands.clients) == 1 + MOST_SENDERS
        assert figure(there, "tactile_failures_total", transport="osc") == 0
        for other in links:
            other.close()


async def test_an_estop_comes_before_the_packets_that_wait_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    as_one(101, monkeypatch)
    async with sending() as (there, hands, link):
        for _ in range(100):
            link.send(CONTACT)
        link.send(STOP)
        await until(lambda: len(hands.log) > MOST_USED)
        assert isinstance(hands.clients[0].commands[0], EStop)
        await asyncio.sleep(0)
        contacts = [command for _, command in hands.log if isinstance(command, Contact)]
        assert len(contacts) == MOST_USED, "the rest of what was read is dropped"
        reason = {"transport": "osc", "reason": "too_fast"}
        dropped = figure(there, "tactile_dropped_messages_total", **reason)
        assert dropped == 100 + 1 - MOST_USED


async def test_estops_of_displays_that_there_are_not_keep_no_real_one_waiting() -> None:
    async with sending() as (_, hands, link):
        made_up = [packet(f"/tactile/x{k}/estop") for k in range(60)]
        link.send(bundle(*made_up, STOP))
        await until(lambda: len(hands.clients[0].commands) > 0)
        assert hands.clients[0].commands == [EStop(display="right")]


async def test_many_estops_at_once_are_one_for_each_display(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    as_one(100, monkeypatch)
    async with sending() as (_, hands, link):
        for _ in range(50):
            link.send(STOP)
            link.send(packet("/tactile/left/estop"))
        await until(lambda: len(hands.clients[0].commands) > 0)
        link.send(packet("/tactile/gain", 0.5))
        await until(lambda: len(hands.clients) == 2 and len(hands.clients[1].commands) == 1)
        displays = [command.display for command in hands.clients[0].commands]  # type: ignore[union-attr]
        assert displays == ["right", "left"]


# Fuzz


@pytest.mark.parametrize("count", [2000, pytest.param(often(100_000), marks=pytest.mark.ci)])
async def test_whatever_is_sent_nothing_breaks_and_nothing_is_armed(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(count)
    monkeypatch.setattr(osc.log, "disabled", True)

    def heard(hands: Hands) -> int:
        said = [c for hand in hands.clients for c in hand.commands]
        return sum(1 for c in said if isinstance(c, SetGain) and c.gain == 0.125)

    async with sending(messages_per_second=100_000) as (there, hands, link):
        for number in range(count):
            link.send(mutated(rng))
            if number % 20 == 19:  # as many as a socket's buffer surely holds
                seen = heard(hands)
                while heard(hands) == seen:  # sent again where all before it fill the queue
                    link.send(packet("/tactile/gain", 0.125))
                    await asyncio.sleep(0.005)
        assert figure(there, "tactile_failures_total", code="internal") == 0
        assert figure(there, "tactile_failures_total", code="malformed") > count / 10
        assert figure(there, "tactile_failures_total", code="invalid_field") > count / 10
        assert not hands.armed
        found = {type(c) for hand in hands.clients for c in hand.commands}
        assert not found & {ArmDisplay, ClearEstop}
        assert found >= {SetGain, StopPlaying, EStop}
