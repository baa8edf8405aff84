"""Locks of threads on the virtual clock."""

from collections.abc import Callable
from functools import partial

import pytest
from virtual_clock import VirtualClock, VirtualLock


@pytest.fixture
def clock() -> VirtualClock:
    clock = VirtualClock()
    clock.time = 0.0
    return clock


@pytest.fixture
def had() -> list[tuple[str, float]]:
    """Return who had the lock, and from when [s]."""
    return []


@pytest.fixture
def hold(
    clock: VirtualClock, had: list[tuple[str, float]]
) -> Callable[[VirtualLock, str, float], None]:
    """Return what a thread does that comes at a time and holds a lock for a second."""

    def hold(lock: VirtualLock, name: str, comes: float) -> None:
        clock.sleep(comes - clock.now())
        with lock:
            had.append((name, clock.now()))
            clock.sleep(1.0)

    return hold


def test_they_are_had_in_the_order_in_which_threads_came(
    clock: VirtualClock, hold: Callable[..., None], had: list[tuple[str, float]]
) -> None:
    lock = VirtualLock(clock)

    def again() -> None:
        for _ in range(2):
            hold(lock, "again", clock.now())

    clock.start(again)
    clock.start(partial(hold, lock, "late", 0.2))
    clock.start(partial(hold, lock, "early", 0.1))
    clock.advance(10.0)
    assert had == [("again", 0.0), ("early", 1.0), ("late", 2.0), ("again", 3.0)]
    assert not lock.locked()


def test_who_waits_for_long_enough_goes_without(
    clock: VirtualClock, hold: Callable[..., None], had: list[tuple[str, float]]
) -> None:
    lock, answers = VirtualLock(clock), []

    def impatient() -> None:
        clock.sleep(0.5)
        answers.append((lock.acquire(0.25), clock.now()))

    clock.start(partial(hold, lock, "first", 0.0))
    clock.start(impatient)
    clock.start(partial(hold, lock, "last", 0.6))
    clock.advance(10.0)
    assert answers == [(False, 0.75)]
    assert had == [("first", 0.0), ("last", 1.0)]


@pytest.mark.parametrize("killed", ["holder", "waiting"])
def test_who_is_killed_neither_has_it_nor_waits(
    clock: VirtualClock, hold: Callable[..., None], had: list[tuple[str, float]], killed: str
) -> None:
    lock = VirtualLock(clock)
    threads = {
        "holder": clock.start(partial(hold, lock, "holder", 0.0)),
        "waiting": clock.start(partial(hold, lock, "waiting", 0.1)),
    }
    clock.start(partial(hold, lock, "last", 0.2))
    clock.advance(0.5)
    clock.kill(threads[killed])
    clock.advance(10.0)
    others = {"holder": [("waiting", 0.5), ("last", 1.5)], "waiting": [("last", 1.0)]}
    assert had == [("holder", 0.0), *others[killed]]


def test_who_has_one_takes_it_again_if_it_may(clock: VirtualClock) -> None:
    again, once = VirtualLock(clock), VirtualLock(clock, reentrant=False)
    with again:
        with again:
            pass
        assert again.locked()
    assert not again.locked()
    with once, pytest.raises(RuntimeError, match="a lock that it has itself"), once:
        pass


def test_who_is_killed_once_it_was_handed_the_lock_hands_it_on(
    clock: VirtualClock, hold: Callable[..., None], had: list[tuple[str, float]]
) -> None:
    lock = VirtualLock(clock)
    with lock:
        waiting = clock.start(partial(hold, lock, "waiting", 0.0))
        clock.start(partial(hold, lock, "last", 0.1))
        clock.advance(0.5)
    clock.kill(waiting)
    clock.advance(10.0)
    assert had == [("last", 0.5)]
