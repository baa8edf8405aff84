"""Tests of signs of life: counting of silence without a clock, and real connections."""

import pytest
from server_rig import serving, talking, until

from tactile.server import listening, liveness
from tactile.server.liveness import Due, SignsOfLife

pytestmark = pytest.mark.usefixtures("patient")

TICK = 0.025
"""Interval between looks [s]; the ping of docs/guide/server.md, each 50 ms, is every second one."""


def steps(signs: SignsOfLife, count: int, *, passed: float = TICK) -> list[Due]:
    """Return what is due in ticks in which nothing is received."""
    return [signs.step(passed, 7, at_stake=True) for _ in range(count)]


def first(found: list[Due], what: str) -> list[int]:
    """Return in which ticks something is due."""
    return [k for k, due in enumerate(found) if getattr(due, what)]


def test_a_silent_client_is_quiet_after_150_ms_and_given_up_after_500_each_once() -> None:
    signs = SignsOfLife()
    signs.step(TICK, 7, at_stake=True)
    found = steps(signs, 100)
    assert first(found, "quiet") == [5]  # 6 ticks of 25 ms
    assert first(found, "give_up") == [19]  # 20 of them


def test_a_sign_of_life_ends_the_silence_and_another_one_counts_anew() -> None:
    signs = SignsOfLife()
    signs.step(TICK, 7, at_stake=True)
    assert first(steps(signs, 30), "quiet") == [5]
    assert signs.step(TICK, 8, at_stake=True)[1:] == (False, False)
    signs.step(TICK, 7, at_stake=True)
    found = steps(signs, 30)
    assert (first(found, "quiet"), first(found, "give_up")) == ([5], [19])


def test_a_client_that_says_something_in_each_tick_is_left_alone() -> None:
    signs = SignsOfLife()
    for k in range(1000):
        due = signs.step(TICK, k, at_stake=True)
        assert (due.quiet, due.give_up) == (False, False)


def test_pings_go_out_in_every_second_tick_and_only_while_something_is_at_stake() -> None:
    signs = SignsOfLife()
    assert [signs.step(TICK, 7, at_stake=False) for _ in range(50)] == [Due()] * 50
    assert [due.ping for due in steps(signs, 6)] == [True, False, True, False, True, False]
    assert signs.step(TICK, 7, at_stake=False) == Due()
    assert signs.step(TICK, 7, at_stake=True).ping, "at once, where something is at stake again"


def test_silence_with_nothing_at_stake_does_not_count() -> None:
    signs = SignsOfLife()
    for _ in range(1000):
        signs.step(TICK, 7, at_stake=False)
    assert first(steps(signs, 10), "quiet") == [5]


@pytest.mark.parametrize("stall", [1.0, 3600.0])
def test_time_in_which_the_loop_stood_still_counts_as_two_ticks(stall: float) -> None:
    signs = SignsOfLife()
    signs.step(TICK, 7, at_stake=True)
    assert signs.step(stall, 7, at_stake=True)[1:] == (False, False)
    assert signs.step(TICK, 8, at_stake=True)[1:] == (False, False)
    signs.step(stall, 8, at_stake=True)
    found = [signs.step(stall, 8, at_stake=True) for _ in range(10)]
    assert first(found, "quiet") == [1], "150 ms are three times two ticks"


async def test_a_real_client_answers_pings_and_one_that_reads_nothing_is_given_up() -> None:
    async with serving() as (there, hands), talking(there) as talker:
        (one,) = there.site.places
        before = one._link.received
        hands.clients[0].sounds = hands.clients[0].holds_voltage = True
        await until(lambda: one._link.received > before + 10)  # pongs: it says nothing
        hands.clients[0].sounds = hands.clients[0].holds_voltage = True
        gave_up = hands.clients[0].gave_up
        talker.link.transport.pause_reading()
        await until(lambda: hands.clients[0].gave_up > gave_up)
        assert hands.clients[0].quieted >= hands.clients[0].gave_up, "quiet first"
        talker.link.transport.resume_reading()
        assert (await talker.ask(type="ping", time_us=1))["type"] == "pong"
        assert hands.clients[0].closed == 0


async def test_a_client_with_nothing_at_stake_is_not_pinged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(listening, "PING_EVERY", 3600.0)
    monkeypatch.setattr(liveness, "QUIET_AFTER", 3600.0)
    monkeypatch.setattr(liveness, "GIVE_UP_AFTER", 3600.0)
    async with serving() as (there, hands), talking(there) as calm, talking(there) as other:
        await calm.ask(type="ping", time_us=1)
        await other.ask(type="ping", time_us=1)
        calm_link, other_link = (one._link for one in there.site.places)
        names = [hand.name for hand in hands.clients]
        assert names == ["test", "test"]
        before = calm_link.received, other_link.received
        hands.clients[0].sounds = True
        await until(lambda: calm_link.received + other_link.received > sum(before) + 10)
        grown = sorted([calm_link.received - before[0], other_link.received - before[1]])
        assert grown[0] == 0
        assert grown[1] > 10
