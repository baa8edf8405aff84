"""Tests of the sound card: its parts one by one, and with a real JACK server.

`Listening` stands in for a display of the SDK, and keeps what it would play.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from jack_rig import (
    BITS,
    BUFFER,
    PATIENCE,
    RATE,
    SOURCE,
    JackServer,
    decoded,
    free_name,
    jack_server,
    until,
)

from tactile.arrays import Singles
from tactile.client import DisplayInfo, Event
from tactile.clock import MONOTONIC, Clock, MonotonicClock
from tactile.errors import DisconnectedError, InputError, RequestError
from tactile.jack import Meters, SoundCard, SoundCardSettings
from tactile.jack.card_messages import (
    CardFailed,
    CardOpened,
    CardOrder,
    CardSources,
    JackCycle,
    PortSources,
)
from tactile.jack.counter_growth import CounterGrowth
from tactile.jack.cycle_clock import JUMP, SHARE, CycleClock
from tactile.jack.delay import SETTLING, Delay
from tactile.jack.feed import CardFeed
from tactile.jack.frame_numbers import FrameNumbers, frames_between
from tactile.jack.library import load_jack
from tactile.jack.meters import FALL, to_decibels
from tactile.jack.patchbay import Patchbay
from tactile.jack.process import NO_SERVER, JackClient, work
from tactile.jack.refusals import RETRY
from tactile.jack.settings import FULL_SCALE
from tactile.jack.sound_card import LINES, NO_WAVES, STANDS_STILL, UNTOUCHED

CHANNELS = 3
COUNT = 48
"""Number of frames of a cycle that a test makes, which is enough to be sent at once."""
NOW = 1000.0
"""Time at which the clock of those tests stands still [s]."""
LATENCY = 5e-3
"""Latency of the display as its server measures it [s]."""


class Still(MonotonicClock):
    """A clock that stands still until a test turns it."""

    time = NOW

    def now(self) -> float:
        return self.time


class Listening:
    """A display that keeps what it is to play; a test sets its state."""

    def __init__(self, *, waveforms: bool = True) -> None:
        self.name, self.connected = "hand", True
        self.waveforms, self.contactors = waveforms, CHANNELS
        self.state, self.touching, self.latency = "disarmed", True, LATENCY
        self.refusal: Exception | None = None
        self.counters = {"dropped_frames": 7, "frame_gaps": 0}
        self.connection = SimpleNamespace(counters={"dropped_frames": 0})
        self.blocks: list[tuple[float, Singles]] = []
        self.writers: list[tuple[float, float]] = []
        self.events: list[Callable[[Event], Any]] = []
        self.on_event = self.events.append
        self.arms = self.looks = 0
        self.answers = threading.Event()
        self.answers.set()

    @property
    def info(self) -> DisplayInfo:
        return DisplayInfo(
            self.name, ((0.0, 0.0),) * self.contactors, (0.0,) * self.contactors, 8000.0, 100.0,
            self.waveforms, 9e-3,
        )  # fmt: skip

    def arm(self) -> None:
        self.arms += 1
        if self.refusal is not None:
            raise self.refusal
        self.state = "armed"

    def stats(self) -> Any:
        self.looks += 1
        self.answers.wait(PATIENCE)
        if not self.connected:
            raise DisconnectedError("the server is not there")
        return SimpleNamespace(
            state=self.state, touching=self.touching, latency=self.latency, counters=self.counters
        )

    def frames(self, rate: float, *, amplitude: float) -> "Listening":
        if rate > 192e3:
            raise InputError("rate: too high")
        self.writers.append((rate, amplitude))
        return self

    def write_block(self, frames: Singles, *, time: float) -> None:
        assert frames.dtype == np.float32
        assert frames.flags.c_contiguous
        self.blocks.append((time, frames))

    def say(self, event: Event) -> None:
        for call in self.events:
            call(event)

    def numbers(self, port: int = 0) -> Any:
        """Return the numbers of the frames that came, −1 where nothing was connected."""
        blocks = [frames for _, frames in list(self.blocks)]
        return decoded(np.concatenate(blocks)[:, port], port) if blocks else np.zeros(0, np.int64)


class RunningCard:
    """A sound card that runs in a thread until `end`."""

    def __init__(self, display: Any, clock: Clock = MONOTONIC, **settings: float) -> None:
        self.lines: list[str] = []
        chosen = SoundCardSettings(**settings)
        self.card = SoundCard(display, chosen, self.lines.append, clock)
        self.stop = threading.Event()
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.card.run(self.stop)
        except InputError as error:
            self.error = error

    def end(self) -> None:
        self.stop.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()

    def ended(self) -> bool:
        return not self._thread.is_alive()

    def says(self, text: str) -> bool:
        return any(text in line for line in list(self.lines))


@pytest.fixture
def display() -> Listening:
    return Listening()


@pytest.fixture
def card(
    display: Listening, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., RunningCard]]:
    """Yield what starts a sound card that bears a slow machine, which is ended with the test."""
    monkeypatch.setattr("tactile.jack.sound_card.STANDSTILL", np.inf)
    started: list[RunningCard] = []

    def start(full_scale: float = FULL_SCALE) -> RunningCard:
        started.append(RunningCard(display, full_scale=full_scale, headroom=0.45))
        return started[-1]

    yield start
    for one in started:
        one.end()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[JackServer]:
    with jack_server(tmp_path) as server:
        yield server


# With a real JACK server


def check_unbroken(display: Listening, lost: int) -> None:
    """See that each frame follows the one before, but for those that are counted as lost."""
    for port in range(CHANNELS):
        numbers = display.numbers(port)
        assert numbers.max() >= 0, "something was played"
        (played,) = np.nonzero(numbers >= 0)
        steps = np.diff(numbers[played[0] :]) % (1 << BITS)
        assert np.sum(steps[steps > 1] - 1) <= lost
        assert np.count_nonzero(steps == 0) <= lost, "a frame comes twice only to fill a hole"


def test_what_a_program_plays_arrives_frame_by_frame(
    server: JackServer, display: Listening, card: Callable[..., RunningCard]
) -> None:
    server.start()
    running = card(full_scale=20e-6)
    server.play("tactile hand")
    until(lambda: len(display.blocks) and np.count_nonzero(display.numbers() >= 0) > 20 * BUFFER)
    assert display.writers == [(RATE, 20e-6)]
    assert display.arms == 1
    running.end()
    summary = running.card.summary
    check_unbroken(display, summary.lost)
    assert summary.frames == sum(len(frames) for _, frames in display.blocks)
    assert (summary.client, summary.rate, summary.buffer) == ("tactile hand", RATE, BUFFER)
    for peak, port in zip(summary.peaks, range(CHANNELS), strict=True):
        assert 0 < peak <= 20e-6 / 2 * 0.5**port
    assert running.lines == [
        f"JACK client 'tactile hand': {CHANNELS} ports, {RATE} Hz, {BUFFER} frames"
    ]


def test_a_sound_card_waits_for_jack_and_goes_on_after_its_crash(
    server: JackServer, display: Listening, card: Callable[..., RunningCard]
) -> None:
    running = card()
    until(lambda: running.says(NO_SERVER))
    server.start()
    server.play("tactile hand")
    until(lambda: len(display.blocks) and np.any(display.numbers() >= 0))
    source = f"{SOURCE}:out_0"
    until(lambda: source in running.card._sources[0])
    server.kill()
    until(lambda: running.says("it is waited for"))
    server.end_sources()
    display.blocks.clear()
    server.start()
    server.play()  # connected to nothing, and found by its name
    until(lambda: len(display.blocks) and np.any(display.numbers() >= 0))
    running.end()
    assert len(running.lines) == 4, running.lines
    assert display.arms == 1
    assert display.writers == [(RATE, 10e-6)]


def test_a_source_that_comes_back_is_connected_again(
    server: JackServer, display: Listening, card: Callable[..., RunningCard]
) -> None:
    server.start()
    running = card()
    server.play("tactile hand")
    until(lambda: all(running.card._sources))
    server.end_sources()
    display.blocks.clear()
    server.play()
    until(lambda: len(display.blocks) and np.any(display.numbers() >= 0))


def test_jack_without_enough_ports_is_one_line(
    tmp_path: Path, display: Listening, card: Callable[..., RunningCard]
) -> None:
    """Take more channels than a JACK server has ports."""
    display.contactors = 300
    with jack_server(tmp_path, ports=128) as server:
        server.start()
        running = card()
        until(running.ended)
        assert "JACK has no ports for 300 contactors" in str(running.error)


def test_a_jack_server_that_cannot_start_is_a_failure_with_its_reason(server: JackServer) -> None:
    """Ask for a driver that there is not."""
    server._line[server._line.index("dummy")] = "nothing"
    with pytest.raises(AssertionError, match=r"no JACK server: (?s:.+)nothing"):
        server.start()


def test_a_killed_jack_server_leaves_its_place_to_another(tmp_path: Path) -> None:
    """Kill more servers than a machine has room for."""
    for _ in range(10):
        with jack_server(tmp_path) as server:
            server.start()
            server.kill()
            server._process = None  # as of a run of the tests that was killed with it


def test_a_jack_server_that_outlives_its_test_keeps_its_name(server: JackServer) -> None:
    server.start()
    server._lock.close()
    name, lock = free_name()
    lock.close()
    assert name != server.name


class FailingClient:
    """A client of JACK that cannot be activated, since JACK has ended or has no ports."""

    def __init__(self, *, lost: bool) -> None:
        self.lost = threading.Event()
        if lost:
            self.lost.set()

    def activate(self) -> None:
        raise ArithmeticError("registering failed")


@pytest.mark.parametrize("lost", [False, True])
def test_a_client_that_cannot_be_activated_since_jack_has_ended_is_no_mistake(
    lost: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = SimpleNamespace(
        JackError=ArithmeticError, set_error_function=print, set_info_function=print
    )
    monkeypatch.setattr("tactile.jack.process.load_jack", lambda: fake)
    client = FailingClient(lost=lost)
    monkeypatch.setattr("tactile.jack.process.open_client", lambda *_: client)
    monkeypatch.setattr("tactile.jack.process.CLOSING", 0.01)
    messages: SimpleQueue[object] = SimpleQueue()
    work(CardOrder("", (frozenset(),)), messages, threading.Event())
    failed = CardFailed("JACK has no ports for 1 contactors: registering failed")
    assert [messages.get() for _ in range(messages.qsize())] == [failed] * (not lost)


class CountedClient:
    """A client of JACK whose frames a test counts."""

    samplerate, last_frame_time, frame_time = RATE, 0, 0


def counted(count: int, messages: "SimpleQueue[Any]", clock: Clock) -> Any:
    """Return the client of the process of a sound card, without JACK."""
    client: Any = JackClient.__new__(JackClient)
    client._client, client._messages, client._clock = CountedClient(), messages, clock
    client._cycles, client._freewheels, client._xruns = CycleClock(), False, 0
    client._ports = [SimpleNamespace(get_array=lambda: np.zeros(count, np.float32))]
    return client


def test_the_times_of_cycles_are_even_though_a_reading_is_wrong() -> None:
    messages: SimpleQueue[JackCycle] = SimpleQueue()
    clock = Still()
    client = counted(256, messages, clock)
    for index in range(20):
        jack = client._client
        clock.time, jack.last_frame_time = NOW + index * 256 / RATE, index * 256
        jack.frame_time = jack.last_frame_time + (240 if index == 10 else 0)
        client._process(256)
    times = [messages.get().time for _ in range(20)]
    assert times == pytest.approx([NOW + k * 256 / RATE for k in range(20)], abs=1e-9)


def test_the_times_of_cycles_begin_anew_after_what_jack_plays_into_a_file() -> None:
    messages: SimpleQueue[Any] = SimpleQueue()
    clock = Still()
    client = counted(256, messages, clock)
    client._opened = CardOpened("tactile hand", RATE, 256)
    client._process(256)
    client._freewheel(True)
    client._process(256)
    client._freewheel(False)
    clock.time += 1.0
    client._process(256)
    first, opened, second = (messages.get() for _ in range(3))
    assert (first.time, opened, second.time) == (NOW, client._opened, NOW + 1.0)


@pytest.mark.parametrize(("count", "most"), [(16, 1500), (48, 500), (1024, 64)])
def test_cycles_wait_for_half_a_second_and_some_in_any_case(count: int, most: int) -> None:
    messages: SimpleQueue[Any] = SimpleQueue()
    client = counted(count, messages, Still())
    for _ in range(2000):
        client._process(count)
    assert messages.qsize() == most


# The display


class Played:
    """A sound card without a process, which a test gives the messages of one."""

    def __init__(self, display: Listening, monkeypatch: pytest.MonkeyPatch) -> None:
        self.display, self.orders = display, [CardOrder("", ())]
        self.running: RunningCard | None = None
        monkeypatch.setattr("tactile.jack.sound_card.JackProcess", self._process)
        monkeypatch.setattr("tactile.jack.sound_card.PAUSE", 0.001)

    def _process(self, order: CardOrder, on_message: Callable[[Any], None]) -> Any:
        self.orders.append(order)
        self.say = on_message
        return SimpleNamespace(kill=lambda: None, close=lambda: None)

    def start(self) -> RunningCard:
        self.clock = Still()
        self.running = RunningCard(self.display, self.clock)
        until(lambda: len(self.orders) > 1 or self.running is None or self.running.ended())
        return self.running

    def line(self, text: str) -> None:
        """Wait for a line with a text."""
        until(lambda: self.running is not None and self.running.says(text))

    def looked(self, times: int = 1) -> None:
        """Wait until the sound card has taken the state of the display, and looks once more."""
        self.display.looks = 0
        until(lambda: self.display.looks > times)


@pytest.fixture
def played(display: Listening, monkeypatch: pytest.MonkeyPatch) -> Iterator[Played]:
    played = Played(display, monkeypatch)
    yield played
    if played.running is not None:
        played.running.end()


def cycle(number: int = 0, rate: float = RATE, xruns: int = 0, frames: Any = None) -> JackCycle:
    if frames is None:
        frames = np.full((COUNT, CHANNELS), 0.5, np.float32)
    return JackCycle(NOW + number / rate, number, rate, frames.tobytes(), xruns)


def test_each_frame_is_put_out_later_by_the_same_delay(display: Listening, played: Played) -> None:
    """Add the headroom to the latency; the latency that the server describes is not used."""
    running = played.start()
    played.say(cycle(0))
    played.say(cycle(COUNT))
    delay = LATENCY + 8e-3
    times = [time for time, _ in display.blocks]
    assert times == pytest.approx([1000.0 + delay, 1000.0 + delay + COUNT / RATE], abs=1e-9)
    display.latency += 0.4e-3
    played.looked()
    assert running.card.summary.delay == delay
    display.latency += 0.2e-3
    played.looked()
    assert running.card.summary.delay == pytest.approx(delay + 0.6e-3)
    assert running.lines == ["the display needs more time: delay raised to 13.6 ms"]


def test_nothing_is_sent_to_a_display_that_is_not_armed(display: Listening, played: Played) -> None:
    """Go on when somebody arms it; the sound card arms once."""
    running = played.start()
    played.say(cycle(0))
    display.state = "estopped"
    display.say(Event("estopped", "hand"))
    played.looked()
    display.counters = {"dropped_frames": 50, "frame_gaps": 4}
    played.looked()
    played.say(cycle(COUNT))
    assert len(display.blocks) == 1
    display.state = "armed"
    display.say(Event("armed", "hand"))
    played.looked()
    played.say(cycle(2 * COUNT))
    assert len(display.blocks) == 2
    assert display.arms == 1
    assert running.lines == [f"hand: {LINES['estopped']}", f"hand: {LINES['armed']}"]
    summary = running.card.summary
    assert (summary.lost, summary.gaps) == (0, 0), "what is dropped meanwhile is meant"


def test_nothing_is_sent_from_the_event_of_an_estop_on(display: Listening, played: Played) -> None:
    """Say it while the server does not answer what state the display has."""
    played.start()
    display.answers.clear()
    played.looked(0)
    display.say(Event("estopped", "hand"))
    played.say(cycle())
    display.answers.set()
    assert display.blocks == []


def test_a_server_that_is_gone_is_waited_for(display: Listening, played: Played) -> None:
    running = played.start()
    display.connected = False
    display.say(Event("disconnected"))
    played.looked()
    played.say(cycle(0))
    assert display.blocks == []
    display.connected, display.state = True, "disarmed"
    display.say(Event("connected"))
    played.looked()
    played.say(cycle(COUNT))
    assert (display.blocks, display.arms) == ([], 1)
    assert running.lines == [f"hand: {LINES['disconnected']}", f"hand: {LINES['connected']}"]


def test_a_display_that_cannot_be_armed_is_played_on_when_it_is(
    display: Listening, played: Played
) -> None:
    display.refusal = RequestError("an e-stop holds", code="estopped")
    running = played.start()
    assert running.lines == ["hand: not armed: an e-stop holds; it plays when it is armed"]
    display.state = "armed"
    played.looked()
    played.say(cycle())
    assert len(display.blocks) == 1


def test_a_refusal_is_one_line_and_ends_the_sending(display: Listening, played: Played) -> None:
    running = played.start()
    for _ in range(3):
        display.say(Event("refused", detail="unauthorized: may not play"))
    played.looked()
    played.say(cycle())
    assert display.blocks == []
    assert running.lines == [
        "hand: the server refuses: unauthorized: may not play; nothing is sent until the display "
        "is armed again"
    ]
    played.clock.time += 10.0
    played.say(CardOpened("tactile hand", RATE, COUNT))
    played.looked()
    played.say(cycle())
    assert display.blocks == []
    display.say(Event("armed", "hand"))
    played.looked()
    played.say(JackCycle(played.clock.time, 0, RATE, cycle().data, 0))
    assert len(display.blocks) == 1
    assert running.lines[2:] == ["hand: armed"]


def test_a_refusal_that_passes_mutes_for_a_second(display: Listening, played: Played) -> None:
    running = played.start()
    for ahead in ("1.009", "1.017"):
        display.say(
            Event("refused", detail=f"invalid_field: time_us: {ahead} s ahead; at most 1 s")
        )
    played.looked()
    played.say(cycle())
    assert display.blocks == []
    played.clock.time += RETRY
    played.looked()
    played.say(JackCycle(played.clock.time, 0, RATE, cycle().data, 0))
    assert len(display.blocks) == 1
    assert running.lines == [
        "hand: the server refuses: invalid_field: time_us: 1.009 s ahead; at most 1 s"
    ]
    display.say(Event("refused", detail="invalid_field: time_us: 1.1 s ahead; at most 1 s"))
    played.say(CardOpened("tactile hand", RATE, COUNT))
    played.looked()
    played.say(JackCycle(played.clock.time, 0, RATE, cycle().data, 0))
    assert len(display.blocks) == 2, "another start of JACK"


def test_its_own_arming_is_no_line(display: Listening, played: Played) -> None:
    running = played.start()
    display.say(Event("armed", "hand"))
    display.say(Event("disarmed", "hand"))
    display.say(Event("armed", "hand"))
    assert running.lines == [f"hand: {LINES['disarmed']}", "hand: armed"]


def test_a_server_that_is_back_with_other_contactors_ends_the_sound_card(
    display: Listening, played: Played
) -> None:
    running = played.start()
    played.say(cycle(0))
    display.contactors = CHANNELS + 1
    until(running.ended)
    assert str(running.error) == (
        "display 'hand' has 4 contactors now, not 3; start the command again"
    )


def test_what_was_lost_just_before_an_estop_is_counted(display: Listening, played: Played) -> None:
    running = played.start()
    played.looked()
    display.answers.clear()
    played.looked(0)
    display.state, display.counters = "estopped", {"dropped_frames": 12, "frame_gaps": 1}
    display.say(Event("estopped", "hand"))
    display.answers.set()
    played.looked()
    assert (running.card.summary.dropped, running.card.summary.gaps) == (5, 1)


def test_the_counters_are_read_once_more_at_the_end(display: Listening, played: Played) -> None:
    running = played.start()
    before = display.stats

    def last() -> Any:
        stats = before()
        running.stop.set()
        display.counters = {"dropped_frames": 9, "frame_gaps": 0}
        return stats

    played.looked()
    display.stats = last  # type: ignore[method-assign]
    until(running.ended)
    assert running.card.summary.dropped == 2


def test_jack_that_stands_still_is_one_line_and_its_meters_fall(
    display: Listening, played: Played
) -> None:
    running = played.start()
    played.clock.time += 10.0
    played.looked(2)
    assert running.lines == [], "there is no JACK"
    played.say(CardOpened("tactile hand", RATE, COUNT))
    for time in (10.0, 20.0):
        played.say(JackCycle(NOW + time, 0, RATE, cycle().data, 0))
        played.clock.time += 10.0
        played.looked(2)
        assert running.card.meters.levels.tolist() == [0.0] * CHANNELS
        assert running.card.meters.peaks.tolist() == [0.5] * CHANNELS
    assert running.lines[1:] == [STANDS_STILL] * 2


def lose_frames(display: Listening, played: Played) -> None:
    """Let the display drop a frame, and wait until the sound card knows."""
    played.looked(2)
    display.counters = {"dropped_frames": display.counters["dropped_frames"] + 1, "frame_gaps": 0}
    played.looked(2)


def test_frames_that_come_too_late_raise_the_headroom(display: Listening, played: Played) -> None:
    running = played.start()
    raised = []
    for _ in range(11):
        lose_frames(display, played)
        raised.append(round(1e3 * running.card.summary.delay - 1e3 * LATENCY, 3))
        played.clock.time += SETTLING / 2
    assert raised == [8, 8, 12, 12, 18, 18, 27, 27, 40, 40, 40]
    assert running.lines[0] == "frames come too late: delay raised to 17.0 ms"
    assert len(running.lines) == 4


def test_frames_that_are_lost_while_nothing_is_sent_do_not_raise_the_headroom(
    display: Listening, played: Played
) -> None:
    running = played.start()
    display.state = "disarmed"
    played.clock.time += SETTLING
    lose_frames(display, played)
    assert running.lines == []


def test_frames_of_which_the_time_has_passed_are_dropped_and_raise_the_headroom(
    display: Listening, played: Played
) -> None:
    running = played.start()
    played.looked()
    played.clock.time += SETTLING
    played.say(cycle())
    played.line("frames come too late: delay raised to 17.0 ms")
    assert display.blocks == []
    assert running.card.summary.dropped == COUNT


def test_dropouts_of_the_server_are_counted_from_the_begin(
    display: Listening, played: Played
) -> None:
    """Count on over a restart of the server, which counts from 0."""
    running = played.start()
    played.say(cycle(0))
    played.say(cycle(COUNT + 10, xruns=2))
    display.counters = {"dropped_frames": 10, "frame_gaps": 2}
    played.looked()
    display.counters = {"dropped_frames": 1, "frame_gaps": 2}
    display.connection.counters["dropped_frames"] = 5
    played.looked()
    summary = running.card.summary
    assert (summary.missing, summary.dropped, summary.gaps) == (10, 3 + 1 + 5, 2)
    assert (summary.lost, summary.xruns) == (19, 2)


def test_another_rate_needs_another_stream(display: Listening, played: Played) -> None:
    running = played.start()
    played.say(cycle(0))
    played.say(cycle(COUNT, rate=44100.0))
    assert [rate for rate, _ in display.writers] == [RATE, 44100.0]
    played.say(CardOpened("tactile hand", 384e3, 256))
    played.say(cycle(2 * COUNT, rate=384e3))
    until(running.ended)
    assert str(running.error) == "JACK runs at 384000 Hz; a display takes at most 192000 Hz"
    assert len(display.writers) == 2
    assert running.card.summary.frames == 2 * COUNT


def test_a_process_that_crashes_is_started_again_with_its_connections(played: Played) -> None:
    running = played.start()
    opened = CardOpened("tactile hand", RATE, 256)
    sources: PortSources = (frozenset({"daw:out"}), frozenset(), frozenset())
    played.say(opened)
    played.say(CardSources(sources))
    played.say(cycle(0))
    played.say(None)
    until(lambda: len(played.orders) == 3)
    assert played.orders[1:] == [
        CardOrder("tactile hand", (frozenset(),) * CHANNELS), CardOrder("tactile hand", sources)
    ]  # fmt: skip
    played.say(opened)
    played.say(cycle(1000))
    assert running.card.summary.missing == 0
    assert running.lines == [
        "JACK client 'tactile hand': 3 ports, 48000 Hz, 256 frames",
        "the process of JACK has ended; it is started again",
    ]
    played.say(None)
    until(lambda: len(played.orders) == 4)
    played.say(None)
    until(running.ended)
    assert str(running.error) == "the process of JACK has ended at once"


def test_waves_that_are_weaker_without_a_finger_are_one_line(
    display: Listening, played: Played
) -> None:
    display.touching = False
    assert played.start().lines == [UNTOUCHED]


def test_a_link_without_waves_is_a_mistake() -> None:
    with pytest.raises(InputError, match=NO_WAVES):
        RunningCard(Listening(waveforms=False))


# Parts


def test_meters_measure_what_came_and_return_what_may_be_played() -> None:
    meters = Meters(3)
    frames = np.array([[0.5, -1.5, np.nan], [-0.25, 1.0, np.inf]], np.float32)
    np.testing.assert_array_equal(meters.take(frames, RATE), [[0.5, -1, 0], [-0.25, 1, 0]])
    assert meters.peaks.tolist() == [0.5, 1.5, 0.0]
    assert meters.clipped.tolist() == [0, 1, 0]
    assert meters.invalid == 2
    assert frames[0, 1] == -1.5, "what came is not changed"


def test_a_meter_falls_slowly_and_its_peak_stays() -> None:
    meters = Meters(1)
    meters.take(np.ones((1, 1), np.float32), RATE)
    for _ in range(10):
        meters.take(np.zeros((RATE // 10, 1), np.float32), RATE)
    assert to_decibels(meters.levels[0]) == pytest.approx(-FALL)
    assert meters.peaks[0] == 1


def test_silence_has_no_level() -> None:
    assert to_decibels(0.0) == -np.inf


def test_frames_are_counted_over_the_end_of_their_numbers() -> None:
    numbers = FrameNumbers()
    numbers.take(2**32 - 256, 128)
    numbers.take(2**32 - 128, 128)
    numbers.take(0, 128)
    assert numbers.missing == 0
    assert numbers.take(128 + 256, 128) == 256
    assert numbers.missing == 256
    assert numbers.take(5, 128) == 0, "an earlier one"
    numbers.take(133, 128)
    assert numbers.missing == 256
    numbers.restart()
    numbers.take(10_000, 128)
    assert numbers.missing == 256
    assert frames_between(2**32 - 1, 1) == 2
    assert frames_between(1, 2**32 - 1) == -2


def test_a_delay_is_first_measured_and_then_only_raised() -> None:
    delay = Delay(20e-3, 8e-3)
    assert delay.seconds == pytest.approx(28e-3)
    assert not delay.update(None, NOW)
    assert not delay.update(5e-3, NOW)
    assert delay.seconds == pytest.approx(13e-3)
    assert not delay.update(1e-3, NOW)
    assert not delay.update(5.4e-3, NOW)
    assert delay.seconds == pytest.approx(13e-3)
    assert delay.update(5.6e-3, NOW)
    assert delay.seconds == pytest.approx(13.6e-3)


def test_a_headroom_is_raised_by_half_but_not_beyond_what_is_bearable() -> None:
    delay, raised = Delay(5e-3, None), []
    delay.update(5e-3, NOW)
    for step in range(12):
        now = NOW + SETTLING * step
        assert delay.raise_headroom(now) == (1e3 * delay.seconds not in raised)
        assert not delay.raise_headroom(now + 0.9 * SETTLING), "it has just changed"
        raised.append(1e3 * delay.seconds)
    assert raised[:4] == pytest.approx([5 + 12, 5 + 18, 5 + 27, 5 + 40])
    assert raised[-1] == pytest.approx(45)
    assert delay.update(6e-3, now), "the headroom stays"
    assert delay.seconds == pytest.approx(46e-3)


def test_a_headroom_of_the_user_is_not_raised() -> None:
    delay = Delay(5e-3, 8e-3)
    assert not delay.raise_headroom(NOW)
    assert delay.seconds == pytest.approx(13e-3)


def test_the_first_measured_delay_settles_before_the_headroom_is_raised() -> None:
    delay = Delay(20e-3, None)
    delay.update(5e-3, NOW)
    assert not delay.raise_headroom(NOW + 0.9 * SETTLING)
    assert delay.raise_headroom(NOW + SETTLING)


def cycle_times(errors: Any, drift: float = 0.0, first: int = 0) -> Any:
    """Return by how much the times of cycles are wrong, with readings that are wrong [s]."""
    clock, count, wrong = CycleClock(), 256, []
    for index, error in enumerate(errors):
        true = NOW + index * count * (1 + drift) / RATE
        time = clock.take((first + index * count) % 2**32, true + error, RATE)
        wrong.append(time - true)
    return np.array(wrong)


def test_the_clock_of_cycles_follows_one_that_drifts_without_its_jitter() -> None:
    jitter = np.random.default_rng(1).uniform(-1e-4, 1e-4, 2000)
    wrong = cycle_times(jitter, drift=2e-4)
    lag = 2e-4 * 256 / RATE / SHARE
    assert np.mean(wrong[200:]) == pytest.approx(-lag, abs=2e-6)
    assert np.std(wrong[200:]) < 0.3 * np.std(jitter)


def test_the_clock_of_cycles_bears_wrong_readings_also_where_their_numbers_begin_anew() -> None:
    errors = np.zeros(100)
    errors[20] = 5e-3
    errors[40:47] = -3e-3
    errors[60:70] = np.where(np.arange(10) % 2, 4e-3, -4e-3)  # which do not agree
    assert np.abs(cycle_times(errors, first=2**32 - 50 * 256)).max() < 1e-9


def test_the_clock_of_cycles_jumps_when_enough_readings_agree() -> None:
    errors = np.zeros(60)
    errors[20:] = 20e-3
    wrong = cycle_times(errors)
    assert np.abs(wrong[: 20 + JUMP - 1]).max() < 1e-9
    assert wrong[20 + JUMP - 1 :] == pytest.approx(20e-3)


def test_growth_counts_only_when_it_shall() -> None:
    growth = CounterGrowth("x")
    steps = ((5, True), (7, True), (20, False), (21, True), (3, True))
    assert [growth.take({"x": now}, counts=counts) for now, counts in steps] == [0, 2, 0, 1, 3]
    assert growth.count == 2 + 1 + 3


def feed_of(display: Any, latency: float = 0.0) -> CardFeed:
    """Return a feed that is open, whose clock stands still at `NOW`."""
    feed = CardFeed(display, CHANNELS, 1e-6, Delay(latency, 0.0), Still())
    feed.open = True
    return feed


def ramp(number: int, count: int) -> JackCycle:
    """Return a cycle whose values are a thousandth of the numbers of the frames."""
    values = np.arange(number, number + count)[:, None] * np.full(CHANNELS, 1e-3)
    return cycle(number, frames=values.astype(np.float32))


def test_a_short_hole_is_filled_with_the_frame_before_it() -> None:
    display = Listening()
    feed = feed_of(display)
    feed.take(ramp(0, COUNT))
    feed.take(ramp(COUNT + 5, COUNT))
    (_, first), (time, second) = display.blocks
    assert time == pytest.approx(NOW + COUNT / RATE, abs=1e-9), "where the first one ends"
    np.testing.assert_array_equal(second[:5], np.repeat(first[-1:], 5, axis=0))
    np.testing.assert_allclose(second[5:, 0], 1e-3 * np.arange(COUNT + 5, 2 * COUNT + 5), rtol=1e-6)
    assert (feed.numbers.missing, feed.frames) == (5, 2 * COUNT + 5)


def test_a_long_hole_and_one_while_nothing_was_sent_stay() -> None:
    display = Listening()
    feed = feed_of(display)
    feed.take(ramp(0, COUNT))
    feed.take(ramp(RATE // 5, COUNT))
    feed.open = False
    feed.take(ramp(RATE // 5 + COUNT, COUNT))
    feed.open = True
    feed.take(ramp(RATE // 5 + 2 * COUNT + 5, COUNT))
    assert [len(frames) for _, frames in display.blocks] == [COUNT] * 3
    assert display.blocks[1][0] == pytest.approx(NOW + 0.2, abs=1e-9)


def test_short_cycles_are_joined() -> None:
    display = Listening()
    feed = feed_of(display)
    for number in range(0, 2 * COUNT, 16):
        feed.take(ramp(number, 16))
    assert [len(frames) for _, frames in display.blocks] == [COUNT, COUNT]
    times = [NOW, NOW + COUNT / RATE]
    assert [time for time, _ in display.blocks] == pytest.approx(times, abs=1e-9)
    values = np.concatenate([frames[:, 0] for _, frames in display.blocks])
    np.testing.assert_allclose(values, 1e-3 * np.arange(2 * COUNT), rtol=1e-6)
    feed.take(ramp(2 * COUNT, 16))
    feed.take(ramp(RATE // 5, COUNT))
    assert [len(frames) for _, frames in display.blocks[2:]] == [16, COUNT], "another time"


def test_frames_that_the_server_would_not_play_are_not_sent() -> None:
    display = Listening()
    for latency, late, early in ((0.85, 0, 0), (0.95, 0, COUNT), (-0.002, COUNT, 0)):
        feed = feed_of(display, latency)
        feed.take(cycle())
        assert (feed.late, feed.early) == (late, early)
    assert len(display.blocks) == 1


def test_xruns_of_processes_add_up() -> None:
    display: Any = Listening()
    feed = feed_of(display)
    for number, xruns in enumerate((1, 3, 0, 2)):
        feed.take(cycle(COUNT * number, xruns=xruns))
    assert feed.xruns == 5


def test_a_patchbay_connects_what_was_connected_before_when_it_is_there() -> None:
    patchbay = Patchbay([{"a:1"}, set()])
    assert patchbay.look([set(), set()], set()) == []
    assert patchbay.look([set(), set()], {"a:1", "b:1"}) == [(0, "a:1")]
    assert patchbay.look([{"a:1"}, {"b:1"}], {"a:1", "b:1"}) == []
    assert list(map(set, patchbay.sources)) == [{"a:1"}, {"b:1"}]


def test_a_patchbay_remembers_a_source_that_vanishes_and_forgets_one_that_is_cut() -> None:
    patchbay = Patchbay([set(), set()])
    there = {"a:1", "b:1"}
    patchbay.look([{"a:1"}, {"b:1"}], there)
    assert patchbay.look([set(), set()], there) == [], "maybe they are just vanishing"
    assert patchbay.look([set(), set()], {"b:1"}) == []
    assert list(map(set, patchbay.sources)) == [{"a:1"}, set()]
    assert patchbay.look([set(), set()], there) == [(0, "a:1")]


def test_a_patchbay_connects_a_source_that_was_away_only_between_two_looks() -> None:
    patchbay, there = Patchbay([set()]), {"a:1"}
    patchbay.look([there], there)
    assert patchbay.look([set()], there, there) == [(0, "a:1")]
    patchbay.look([there], there)
    assert patchbay.look([set()], there) == [], "it was vanishing"
    assert patchbay.look([set()], there, there) == [(0, "a:1")]


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"full_scale": 0.0}, "full scale 0 µm: must be above 0 and at most 500 µm"),
        ({"full_scale": 501e-6}, "full scale 501 µm"),
        ({"headroom": -1e-3}, "headroom -1 ms: must be between 0 and 500 ms"),
        ({"headroom": float("nan")}, "headroom nan ms"),
    ],
)
def test_a_wrong_setting_is_a_mistake(values: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        SoundCardSettings(**values)


def test_missing_libraries_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "jack", None)
    with pytest.raises(InputError, match=r"pip install 'tactile-display\[jack\]'"):
        load_jack()
    monkeypatch.delitem(sys.modules, "jack")
    (tmp_path / "jack.py").write_text("raise OSError('JACK library not found')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"libjack \(JACK library not found\): apt install jackd2"):
        load_jack()
