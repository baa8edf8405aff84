"""Tests of what guards have held down, and of what they are told while a finger is followed."""

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.guard import ChannelGuards
from tactile.bus.guard_gains import BEFORE_ALL, GuardGains
from tactile.display.display import Display, load_display
from tactile.playback.guard_keeping import SURE, GuardKeeping
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.sensing.guard import GuardFilters
from tactile.sensing.load_follower import FilterUpdate, FollowedLoads

RATE = 8000
COUNT = 3
FALL, RISE = 31744 / 32768 / 8, 80 / 32768
"""Changes of a gain in a sample at 8 kHz: of 31/32 in 1 ms, and ⌈31744/400⌉ of 32768."""
LEAST = 1 / 32
ALL = np.ones(COUNT, np.bool_)
NONE = np.zeros(COUNT, np.bool_)


def of(*contactors: int) -> NDArray[np.bool_]:
    """Return which contactors are among some."""
    return np.isin(np.arange(COUNT), contactors)


def reported(*reports: tuple[int, NDArray[np.bool_]]) -> GuardGains:
    gains = GuardGains(COUNT, RATE)
    for position, tripped in reports:
        gains.report(position, ALL, tripped)
    return gains


def test_without_a_report_all_gains_are_full() -> None:
    gains = reported()
    assert gains.gains(-100, 1000) is None
    assert gains.gains(10**9, 1000) is None
    assert not gains.tripped.any()
    assert (gains.latest == BEFORE_ALL).all()


def test_a_gain_falls_within_a_millisecond_and_rises_within_fifty() -> None:
    """The figures are those of section 17.4, computed here by hand."""
    played = reported((1000, of(1)), (1100, NONE)).gains(990, 600)
    assert played is not None
    np.testing.assert_array_equal(played[:, [0, 2]], 1.0)
    one = played[:, 1]
    np.testing.assert_array_equal(one[:10], 1.0)
    np.testing.assert_allclose(one[10:18], 1 - FALL * np.arange(1, 9), atol=1e-12)
    np.testing.assert_array_equal(one[18:110], LEAST)
    np.testing.assert_allclose(one[110:506], LEAST + RISE * np.arange(1, 397), atol=1e-12)
    np.testing.assert_array_equal(one[507:], 1.0)


def test_gains_are_those_of_the_amplifier() -> None:
    """The reference amplifier plays a random story of trips and releases, in random pieces."""
    random = np.random.default_rng(3)
    amplifier, gains = ChannelGuards(COUNT), GuardGains(COUNT, RATE)
    amplifier.start(RATE)
    played, position = [], 0
    for _ in range(60):
        reasons = amplifier.reasons.copy()
        amplifier.reasons = np.where(random.random(COUNT) < 0.3, 1 - (reasons > 0), reasons)
        if (amplifier.reasons != reasons).any():
            gains.report(position, ALL, amplifier.reasons > 0)
        count = int(random.integers(1, 200))
        played.append(amplifier.move(count, ramping=False) / 32768)
        position += count
    expected = np.concatenate(played)
    begin = 0
    while begin < position - 300:
        piece = gains.gains(begin, 300)
        piece = np.ones((300, COUNT)) if piece is None else piece
        np.testing.assert_array_equal(piece, expected[begin : begin + 300])
        begin += int(random.integers(1, 200))


def test_trips_are_counted_once() -> None:
    gains = reported((100, of(0)), (200, of(0, 1)), (300, of(1)), (400, of(0, 1)))
    assert gains.trips.tolist() == [2, 1, 0]
    assert gains.latest.tolist() == [400, 200, BEFORE_ALL]
    assert gains.tripped.tolist() == [True, True, False]
    gains.restart()
    assert gains.trips.tolist() == [2, 1, 0], "which never falls"
    assert not gains.tripped.any()
    assert gains.gains(500, 100) is None


def test_an_old_report_that_comes_late_does_not_undo_a_newer_one() -> None:
    gains = reported((400, NONE), (300, of(0)))
    assert not gains.tripped.any()
    played = gains.gains(200, 1000)
    assert played is not None
    assert played[100 + 50, 0] == LEAST
    assert played[-1, 0] == 1


def test_reports_of_other_contactors_change_nothing() -> None:
    gains = GuardGains(COUNT, RATE)
    gains.report(100, of(0), of(0))
    gains.report(100, of(1, 2), NONE)
    assert gains.tripped.tolist() == [True, False, False]


def test_where_a_report_was_lost_the_flags_of_the_window_tell() -> None:
    """Lose the report of a trip: the gain falls as the window begins, and is exact later."""
    gains = reported()
    assert gains.correct(800, 200, of(2))
    assert gains.trips.tolist() == [0, 0, 1]
    assert gains.latest[2] == 800
    played = gains.gains(1000, 200)
    assert played is not None
    np.testing.assert_array_equal(played[:, 2], LEAST)
    assert not gains.correct(1000, 200, of(2))
    # and after a lost release nothing is held any more
    assert gains.correct(1200, 200, NONE)
    assert gains.gains(1201, 200) is None
    assert not gains.tripped.any()


def test_flags_of_currents_that_come_late_correct_nothing() -> None:
    """Flags may be of instants up to 200 samples after those of the window."""
    gains = reported((1000, of(1)), (1400, NONE))
    assert gains.gains(800, 100) is None
    for position in range(800, 2200, 100):
        for flags in (NONE, of(1)):
            # as the gain is at any instant from the window to 200 samples after it
            past = [position + late for late in range(0, 201, 40)]
            true = [any(1000 <= p + k < 1797 for k in range(100)) for p in past]
            if any(held == flags[1] for held in true):
                assert not gains.correct(position, 100, flags)


def test_memory_does_not_grow_without_windows() -> None:
    gains = GuardGains(COUNT, RATE)
    for k in range(10_000):
        gains.report(10 * k, ALL, of(k % COUNT))
    assert len(gains._changes) <= 64
    assert gains.gains(10**6, 100) is not None


# What guards are told


@pytest.fixture
def display() -> Display:
    """Display whose contactors are on channels in another order."""
    return load_display("reference-24")


def updated(count: int, judged: NDArray[np.bool_], *, guarded: bool = True) -> FilterUpdate:
    """Return an update whose filters have the number of the contactor in them."""
    numbers = np.arange(count, dtype=np.float64)
    filters = GuardFilters(
        np.tile(numbers[:, None], 2), np.tile(numbers[:, None], 13),
        np.tile(numbers[:, None], 13), numbers, 0.01, numbers,
    )  # fmt: skip
    loads = FollowedLoads(judged, np.zeros((count, 4)), numbers, judged)
    return FilterUpdate(loads, np.zeros((count, 32)), 200, filters if guarded else None, judged)


class Keeper:
    """Keeping of a display's guards, asked window by window."""

    def __init__(self, display: Display, ahead: int = 80) -> None:
        self.count, self.ahead = len(display.contactors), ahead
        self.keeping, self.written = GuardKeeping(display), 0
        self.armed: NDArray[np.int64] = np.full(display.channel.max() + 1, -1)

    def turn(
        self, judged: NDArray[np.bool_], tripped: NDArray[np.bool_], *, known: bool = True
    ) -> tuple[list[int], list[int]]:
        """Play a window; return the channels that are told something, and those released."""
        self.written += 200
        settings = self.keeping.settings(
            updated(self.count, judged), tripped=tripped, known=np.full(self.count, known),
            written=self.written, put_out=self.written - self.ahead,
        )  # fmt: skip
        if settings is None:
            return [], []
        self.armed[settings.channels] = settings.armed
        return settings.channels.tolist(), settings.channels[settings.release].tolist()


def test_each_guard_is_told_in_every_second_window(display: Display) -> None:
    keeper = Keeper(display)
    every = np.ones(keeper.count, np.bool_)
    keeper.turn(every, ~every)  # when all are armed
    for _ in range(3):
        first, second = keeper.turn(every, ~every)[0], keeper.turn(every, ~every)[0]
        assert sorted(first + second) == sorted(display.channel.tolist())
        assert first == sorted(first)
        assert abs(len(first) - len(second)) <= 1


def test_settings_are_of_the_contactor_on_each_channel(display: Display) -> None:
    count = len(display.contactors)
    keeping = GuardKeeping(display)
    every = np.ones(count, np.bool_)
    settings = keeping.settings(
        updated(count, every), tripped=~every, known=every, written=200, put_out=200
    )
    assert settings is not None
    contactor = {int(c): k for k, c in enumerate(display.channel)}
    expected = [contactor[c] for c in settings.channels.tolist()]
    for values in (settings.poles, settings.drive, settings.change):
        np.testing.assert_array_equal(values[:, 0], expected)
    np.testing.assert_array_equal(settings.limit, expected)


def test_a_change_is_told_at_once(display: Display) -> None:
    keeper = Keeper(display)
    every = np.ones(keeper.count, np.bool_)
    none = ~every
    assert len(keeper.turn(every, none)[0]) == keeper.count
    one = np.arange(keeper.count) == 3
    for _ in range(2):  # in either turn
        assert display.channel[3] in keeper.turn(~one, none)[0]
        assert keeper.armed[display.channel[3]] == 0
        assert display.channel[3] in keeper.turn(every, none)[0]
        assert keeper.armed[display.channel[3]] == 1
        keeper.turn(every, none)


def test_a_contactor_comes_back_only_when_the_free_filters_have_faded_in(display: Display) -> None:
    """What an update without knowledge of the trip plays is no free filter."""
    keeper = Keeper(display)
    every = np.ones(keeper.count, np.bool_)
    keeper.turn(every, ~every)
    one = np.arange(keeper.count) == 5
    channel = int(display.channel[5])
    for _ in range(5):
        assert keeper.turn(every, one, known=False)[1] == []
        assert keeper.armed[channel] == 0, "and what is turned down is not armed"
    plays = keeper.written + 200 + 200 + LOOK_AHEAD
    while keeper.written + 200 - 80 < plays:
        assert keeper.turn(~one, one)[1] == []
    assert keeper.turn(~one, one)[1] == [channel]
    assert keeper.turn(~one, one)[1] == [channel], "and again until the amplifier has reported it"
    assert keeper.turn(~one, ~every)[1] == []
    assert keeper.turn(~one, one)[1] == [], "another trip waits anew"


def test_without_guards_nothing_is_told(display: Display) -> None:
    count = len(display.contactors)
    every = np.ones(count, np.bool_)
    update = updated(count, every, guarded=False)
    keeping = GuardKeeping(display)
    assert keeping.settings(update, tripped=~every, known=every, written=200, put_out=200) is None


def test_all_guards_are_disarmed_where_no_load_is_known(display: Display) -> None:
    count = len(display.contactors)
    every = np.ones(count, np.bool_)
    keeping, update = GuardKeeping(display), updated(count, every)
    assert update.guards is not None
    for written in range(200, 200 * (SURE + 1), 200):
        keeping.settings(update, tripped=~every, known=every, written=written, put_out=written - 80)
    keeping.forget(800)
    assert not keeping.relied_on.any()
    assert keeping.disarm(update.guards, put_out=799) is None, "drive without a limit is put out"
    settings = keeping.disarm(update.guards, put_out=800)
    assert settings is not None
    assert len(settings.channels) == count
    assert not settings.armed.any()
    assert not settings.release.any(), "what was turned down stays so"


def test_a_guard_is_relied_on_when_its_settings_have_been_sent_twice(display: Display) -> None:
    """One message may be lost; a contactor that is turned down, or not judged, is not watched."""
    keeper = Keeper(display)
    every = np.ones(keeper.count, np.bool_)
    sent = np.zeros(display.channel.max() + 1, np.intp)
    for _ in range(SURE):
        assert not keeper.keeping.relied_on.any()
        sent[keeper.turn(every, ~every)[0]] += 1
    assert keeper.keeping.relied_on.all()
    assert sent[display.channel].min() >= 2
    one = np.arange(keeper.count) == 3
    keeper.turn(every, one)
    np.testing.assert_array_equal(keeper.keeping.relied_on, ~one)
    keeper.keeping.restart()
    assert not keeper.keeping.relied_on.any()


@pytest.mark.parametrize("ahead", [80, 300])
def test_a_guard_stays_armed_until_its_contactor_is_bounded(display: Display, ahead: int) -> None:
    """Limit and guard overlap by what is written ahead, and no settings are sent meanwhile."""
    keeper = Keeper(display, ahead)
    every = np.ones(keeper.count, np.bool_)
    one = np.arange(keeper.count) == 3
    channel = display.channel[3]
    for _ in range(SURE):
        keeper.turn(every, ~every)
    bounded = keeper.written + 200
    while keeper.written + 200 - ahead < bounded:
        assert channel not in keeper.turn(~one, ~every)[0]
        np.testing.assert_array_equal(keeper.keeping.relied_on, ~one)
        assert keeper.armed[channel] == 1
    assert channel in keeper.turn(~one, ~every)[0]
    assert keeper.armed[channel] == 0
