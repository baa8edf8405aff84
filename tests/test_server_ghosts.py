"""Tests that a client that is gone leaves no place taken, no host client, no endless request."""

import asyncio
import random
import time
from contextlib import suppress
from typing import Any

import pytest
from server_rig import GOOD, PATIENCE, SELECT, Hands, figure, serving, talking, until

from tactile.messages import ArmDisplay, Command, DisarmDisplay, EStop, Select
from tactile.server import requests
from tactile.server.connection import ServerConnection
from tactile.server.metrics import Metrics
from tactile.server.requests import Requests
from tactile.server.server import Server

pytestmark = pytest.mark.usefixtures("patient")


KINDS = ["gain", "select", "arm", "disarm", "estop", "effect"]


class Hesitation:
    """A host that takes random turns of the event loop, and swallows cancellations at times."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng

    async def __call__(self) -> None:
        for _ in range(self._rng.randrange(6)):
            await asyncio.sleep(0)
        if self._rng.random() < 0.3:
            result = asyncio.get_running_loop().create_future()
            asyncio.get_running_loop().call_soon(result.set_result, None)
            await asyncio.wait_for(result, PATIENCE)  # in Python 3.11 this swallows a cancellation
        if self._rng.random() < 0.1:
            try:
                await asyncio.sleep(0.001)
            except asyncio.CancelledError:
                await asyncio.sleep(0)


async def hang_up(there: Server, rng: random.Random) -> None:
    """Connect, send some requests, and hang up politely, at once, or at any turn between."""
    async with talking(there) as talker:
        for _ in range(rng.randrange(6)):
            await talker.send(**GOOD[rng.choice(KINDS)][0])
            for _ in range(rng.randrange(3)):
                await asyncio.sleep(0)
        for _ in range(rng.randrange(8)):
            await asyncio.sleep(0)
        if rng.random() < 0.7:
            talker.link.transport.abort()


def nobody_is_left(there: Server, hands: Hands) -> bool:
    gauge = figure(there, "tactile_clients", transport="websocket")
    return len(there.site.places) == 0 and gauge == 0 and all(hand.closed for hand in hands.clients)


@pytest.mark.parametrize("count", [100, pytest.param(2000, marks=pytest.mark.ci)])
async def test_hang_ups_at_random_moments_leave_no_ghosts(count: int) -> None:
    rng = random.Random(count)
    async with serving(most_clients=8) as (there, hands):
        hands.pause = Hesitation(rng)
        before = asyncio.all_tasks()
        while len(hands.clients) < count:
            # A place is free only once its client's requests have ended: four must be left.
            await until(lambda: len(there.site.places) <= 4)
            await asyncio.gather(*(hang_up(there, rng) for _ in range(4)))
        await until(lambda: nobody_is_left(there, hands))
        await until(lambda: asyncio.all_tasks() <= before)
        assert [hand.closed for hand in hands.clients] == [1] * len(hands.clients)
        for _ in range(8):
            async with talking(there) as talker:
                assert (await talker.ask(**SELECT))["type"] == "done"
        assert "arm" in hands.clients[-1].roles


async def test_a_request_that_never_ends_keeps_no_place(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The same holds for one that cannot be cancelled, and for an e-stop that hangs."""
    monkeypatch.setattr(requests, "FINISH_WITHIN", 0.05)
    async with serving(most_clients=2) as (there, hands):
        end = asyncio.Event()

        async def hang() -> None:
            while not end.is_set():
                try:
                    await end.wait()
                except asyncio.CancelledError:
                    continue

        hands.pause = hang
        for _ in range(6):
            async with talking(there) as talker:
                await talker.send(**SELECT)
                await talker.send(type="disarm", display="right")
                await talker.send(type="estop")
                talker.link.transport.abort()
            await until(lambda: nobody_is_left(there, hands))
        assert all("arm" in hand.roles for hand in hands.clients), "a full place each time"
        end.set()
    assert "requests of a client that is gone did not end" in caplog.text


class Slow:
    """A client of the host whose requests wait, and one kind of which cannot be cancelled."""

    def __init__(self) -> None:
        self.carried_out: list[Command] = []
        self.begun = asyncio.Event()
        self.go_on = asyncio.Event()

    async def request(self, command: Command) -> Any:
        if isinstance(command, Select):
            self.begun.set()
            with suppress(asyncio.CancelledError):  # as `asyncio.wait_for` does beside a result
                await self.go_on.wait()
        self.carried_out.append(command)
        return None


@pytest.mark.parametrize("in_the_same_turn", [False, True])
async def test_a_cancellation_that_is_lost_carries_out_no_more(in_the_same_turn: bool) -> None:
    """The worker goes on after the request, and finds that it has ended."""
    slow = Slow()
    waiting = Requests(slow, Metrics(Hands()).of("test"), lambda answer: None)  # type: ignore[arg-type]
    commands: list[Command] = [
        Select(display="a", layers=()),
        ArmDisplay(display="a"),
        DisarmDisplay(display="a"),
    ]
    for command in commands:
        waiting.offer(command)
    await slow.begun.wait()
    waiting.offer(EStop(display="a"))
    if in_the_same_turn:
        slow.go_on.set()
    await waiting.finish()
    await asyncio.wait({waiting._worker})
    kinds = [type(command) for command in slow.carried_out]
    assert ArmDisplay not in kinds
    assert kinds.count(DisarmDisplay) == kinds.count(EStop) == 1


async def test_a_part_of_a_connection_that_fails_ends_it_and_is_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(*_: Any) -> Any:
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(ServerConnection, "_receive", fail)
    async with serving() as (there, hands), talking(there) as talker:
        assert (await talker.closed())[0] == 1011
        await until(lambda: nobody_is_left(there, hands))
    assert any("on purpose" in str(record.exc_info) for record in caplog.records)


async def test_a_client_that_cannot_be_closed_keeps_no_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(self: Any) -> None:
        raise ZeroDivisionError("on purpose")

    async with serving() as (there, hands):
        async with talking(there) as talker:
            await talker.ask(type="ping", time_us=time.monotonic_ns() // 1000)
            monkeypatch.setattr(type(hands.clients[0]), "close", fail)
        await until(lambda: len(there.site.places) == 0)
