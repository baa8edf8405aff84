"""Tests of the bridge to the Lab Streaming Layer: real streams of liblsl over loopback.

`Shown` stands in for a display of the SDK. Each test has a display of a name of its own, because
all programs of this machine see all streams.
"""

import itertools
import queue
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lsl_rig import loopback as loopback
from lsl_rig import pylsl

from tactile.client import At, DisplayInfo, Event, Onset
from tactile.client.wire import CommandedSamples
from tactile.errors import ClientTimeoutError, DisconnectedError, InputError, NotFoundError
from tactile.lsl import Bridge, BridgeSettings, stimuli
from tactile.lsl.continuity import JUMP, Continuity
from tactile.lsl.decimation import Decimator
from tactile.lsl.library import load_pylsl
from tactile.lsl.outlets import Outlet
from tactile.lsl.settings import parse_starts, parse_streams
from tactile.lsl.timing import LslClock, measure_clock

PATIENCE = 30.0
"""Longest wait for something that takes milliseconds on an idle machine [s]."""
RATE, BLOCK = 8000.0, 32
CONTACTORS = ((-1e-3, 2e-3), (1.25e-3, 2e-3), (0.0, 0.0))
STREAMS = ("contacts", "shear", "drive", "markers")
END = object()


class Shown:
    """A display whose telemetry and events a test says."""

    def __init__(self) -> None:
        self.name = f"hand-{uuid.uuid4().hex}"
        self.said: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.event_callbacks: list[Callable[[Event], Any]] = []
        self.played: queue.SimpleQueue[tuple[str, At]] = queue.SimpleQueue()
        self.refusal: Exception | None = None
        self.on_event = self.event_callbacks.append

    @property
    def info(self) -> DisplayInfo:
        return DisplayInfo(self.name, CONTACTORS, (0.0,) * 3, RATE, 100.0, True, 5e-3)

    def telemetry(self, rate: float, *, samples: bool) -> "Shown":
        assert samples
        return self

    def __enter__(self) -> "Shown":
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def __next__(self) -> Any:
        said = self.said.get(timeout=PATIENCE)
        if said is END:
            raise StopIteration
        if isinstance(said, Exception):
            raise said
        return said

    def say(self, samples: CommandedSamples | None, *, spectrum: bool = False) -> None:
        shear = None if spectrum else (0.0,) * 3
        self.said.put(SimpleNamespace(samples=samples, shear=shear))

    def effects(self) -> list[Any]:
        return [SimpleNamespace(name=name) for name in ("tap", "hum")]

    def play_effect(self, name: str, *, at: At) -> None:
        self.played.put((name, at))
        if self.refusal is not None:
            raise self.refusal


class Running:
    """A bridge that runs in a thread until `end`."""

    def __init__(self, display: Shown, **settings: Any) -> None:
        self.display = display
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.bridge = Bridge(display, BridgeSettings(**settings), self.lines.put)  # type: ignore[arg-type]
        self.stop = threading.Event()
        self._thread = threading.Thread(target=self.bridge.run, args=(self.stop,))
        self._thread.start()

    def end(self) -> None:
        self.display.said.put(END)
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()

    def line(self) -> str:
        return self.lines.get(timeout=PATIENCE)

    def inlet(self, quantity: str) -> Any:
        """Return an inlet of a stream that gets all that is added from now on."""
        sampled = self.bridge._sampled
        outlets = {} if sampled is None else dict(sampled.outlets)
        if self.bridge._markers is not None:
            outlets["markers"] = self.bridge._markers
        return received(outlets[quantity])


def received(outlet: Outlet) -> Any:
    """Return an inlet of an outlet that gets all that is added from now on."""
    found = pylsl.resolve_byprop("name", outlet.description.name, timeout=PATIENCE)
    assert len(found) == 1
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(PATIENCE)
    assert outlet._outlet.wait_for_consumers(PATIENCE)
    return inlet


def pulled(inlet: Any, count: int) -> tuple[Any, Any]:
    """Return times and values of the next samples of a stream."""
    pairs = [inlet.pull_sample(PATIENCE) for _ in range(count)]
    assert all(values is not None for values, _ in pairs), "all came"
    return np.array([time for _, time in pairs]), np.array([values for values, _ in pairs])


def marker(inlet: Any) -> Any:
    """Return text and time of the next marker."""
    values, time = inlet.pull_sample(PATIENCE)
    assert values is not None, "it came"
    return values[0], time


def commanded(first: int, times: tuple[float, ...], **changed: Any) -> CommandedSamples:
    """Return blocks whose values all differ."""
    count = len(times)
    rows: Any = np.arange(first, first + count * BLOCK)[:, None] + np.arange(3) / 4
    values: dict[str, Any] = {
        "first": first,
        "sample_rate": RATE,
        "block_samples": BLOCK,
        "times": times,
        "uncertainty": 4e-6,
        "finger_times": tuple(time + 1.1e-3 for time in times),
        "position": tuple((1e-3 * k, -2e-3 * k) for k in range(count)),
        "velocity": tuple((0.08 + k, -0.5) for k in range(count)),
        "normal_force": tuple(0.25 + k for k in range(count)),
        "touching": tuple(k % 2 == 0 for k in range(count)),
        "shear": memoryview((1e-6 * rows).astype(np.float32)) if count else None,
        "drive": memoryview((rows / 8).astype(np.float32)) if count else None,
    }
    return CommandedSamples(**(values | changed))


NOTHING = commanded(0, ())


@pytest.fixture
def display() -> Shown:
    return Shown()


@pytest.fixture
def running(display: Shown) -> Iterator[Callable[..., Running]]:
    """Yield what starts a bridge, which is ended with the test."""
    started: list[Running] = []

    def start(**settings: Any) -> Running:
        started.append(Running(display, **settings))
        return started[-1]

    yield start
    for one in started:
        one.end()


@pytest.fixture
def offered(display: Shown, running: Callable[..., Running]) -> Running:
    """Return a bridge that offers all streams, and has said so."""
    return offer(running(), display)


def offer(bridge: Running, display: Shown, lines: int = len(STREAMS)) -> Running:
    display.say(NOTHING)
    for _ in range(lines):
        bridge.line()
    return bridge


# Samples


def test_every_sample_has_the_time_at_which_it_is_put_out(display: Shown, offered: Running) -> None:
    """Blocks do not follow one another by the nominal rate, and recorders see that."""
    start = 1000.0
    times = (start, start + BLOCK / RATE + 7.3e-6, start + 2 * BLOCK / RATE + 11.9e-6)
    inlets = {name: offered.inlet(name) for name in ("contacts", "shear", "drive")}
    display.say(commanded(640, times))
    offset = offered.bridge._clock.offset
    expected = np.ravel(np.array(times)[:, None] + np.arange(BLOCK) / RATE)
    rows = np.arange(640, 640 + 3 * BLOCK)[:, None] + np.arange(3) / 4
    for name, scale in (("shear", 1.0), ("drive", 1 / 8)):
        got, values = pulled(inlets[name], 3 * BLOCK)
        assert np.max(np.abs(got - offset - expected)) < 1e-9
        np.testing.assert_allclose(values, scale * rows, rtol=1e-6)
    got, values = pulled(inlets["contacts"], 3)
    assert np.max(np.abs(got - offset - np.array(times) - 1.1e-3)) < 1e-9, "that of the finger"
    contacts = [[k, -2 * k, 80 + 1e3 * k, -500, 0.25 + k, k % 2 == 0] for k in range(3)]
    np.testing.assert_allclose(values, contacts, rtol=1e-6)


def test_the_clock_of_lsl_is_that_of_this_program() -> None:
    """The limit is far above what an idle machine has, for one that stands still in between."""
    clock = measure_clock(pylsl.local_clock)
    assert abs(clock.offset) < 1e-6
    assert clock.uncertainty < 1e-3


def test_an_offset_of_clocks_is_that_of_the_shortest_reading() -> None:
    steps = itertools.cycle([4e-3, 2e-6, 1e-3, 5e-4])

    class Stepping:
        time = 0.0

        def now(self) -> float:
            self.time += next(steps)
            return self.time

    ticking: Any = Stepping()
    clock = measure_clock(lambda: ticking.time + 123.0, ticking)
    assert clock.uncertainty == pytest.approx(1e-6)
    assert clock.offset == pytest.approx(123.0, abs=1.01e-6)
    assert clock.to_monotonic(clock.to_lsl(5.0)) == pytest.approx(5.0)


def test_an_offset_that_may_be_0_is_0() -> None:
    class Stepping:
        time = 0.0

        def now(self) -> float:
            self.time += 1e-3
            return self.time

    ticking: Any = Stepping()
    clock = measure_clock(lambda: ticking.time, ticking)
    assert clock == LslClock(0.0, clock.uncertainty)


def test_streams_are_described_as_xdf_names_it(display: Shown, offered: Running) -> None:
    infos = {name: offered.inlet(name).info(PATIENCE) for name in STREAMS}
    forms = {
        name: (one.type(), one.channel_count(), one.nominal_srate()) for name, one in infos.items()
    }
    assert forms == {
        "contacts": ("MoCap", 6, RATE / BLOCK),
        "shear": ("Haptics", 3, RATE),
        "drive": ("Haptics", 3, RATE),
        "markers": ("Markers", 1, pylsl.IRREGULAR_RATE),
    }
    for name, info in infos.items():
        assert info.name() == f"tactile {display.name} {name}"
        assert info.desc().child("acquisition").child_value("manufacturer") == "tactile"
        assert info.desc().child("acquisition").child_value("model") == display.name
        assert info.desc().child("synchronization").child_value("can_drop_samples") == "true"
    assert channels(infos["drive"]) == [
        ("contactor 0", "Voltage", "volts", "-1", "2"),
        ("contactor 1", "Voltage", "volts", "1.25", "2"),
        ("contactor 2", "Voltage", "volts", "0", "0"),
    ]
    assert {channel[1:3] for channel in channels(infos["shear"])} == {("Shear", "microns")}
    assert [channel[:3] for channel in channels(infos["contacts"])][:3] == [
        ("x", "PositionX", "millimeters"),
        ("y", "PositionY", "millimeters"),
        ("velocity x", "VelocityX", "millimeters/second"),
    ]
    assert infos["markers"].channel_format() == pylsl.cf_string


def channels(info: Any) -> list[tuple[str, ...]]:
    """Return label, type, unit and location of each channel."""
    element, found = info.desc().child("channels").child("channel"), []
    while not element.empty():
        location = element.child("location")
        texts = [element.child_value(name) for name in ("label", "type", "unit")]
        found.append((*texts, location.child_value("X"), location.child_value("Y")))
        element = element.next_sibling("channel")
    return found


def test_a_stream_is_the_same_after_a_restart(
    display: Shown, running: Callable[..., Running]
) -> None:
    """Recorders find it again by its identity."""
    identities = []
    for _ in range(2):
        bridge = running(streams=("contacts",))
        offer(bridge, display, 1)
        identities.append(bridge.inlet("contacts").info(PATIENCE).source_id())
        bridge.end()
    assert identities[0] == identities[1]
    assert display.name in identities[0]


def test_only_the_chosen_streams_are_offered(
    display: Shown, running: Callable[..., Running]
) -> None:
    bridge = running(streams=("drive",))
    display.say(commanded(0, (1.0,)))
    assert bridge.line() == f"tactile {display.name} drive: Haptics, 3 channels, 8000 Hz"
    assert [one.name for one in bridge.bridge.summary.streams] == [f"tactile {display.name} drive"]


def test_a_link_of_spectrum_frames_has_contacts_and_markers(
    display: Shown, running: Callable[..., Running]
) -> None:
    bridge = running()
    display.say(commanded(0, (), block_samples=80), spectrum=True)
    assert bridge.line() == f"tactile {display.name} markers: Markers, 1 channel, no rate"
    assert bridge.line() == f"tactile {display.name} contacts: MoCap, 6 channels, 100 Hz"
    assert bridge.line().startswith("no shear and drive: the link takes spectrum frames")
    inlet = bridge.inlet("contacts")
    samples = commanded(0, (1.0, 1.01), block_samples=80, shear=None, drive=None)
    display.say(samples, spectrum=True)
    _, values = pulled(inlet, 2)
    assert values[:, 0].tolist() == [0, 1]


def test_streams_are_offered_anew_at_another_rate(display: Shown, offered: Running) -> None:
    display.say(commanded(0, (), sample_rate=4000.0))
    assert offered.line() == f"tactile {display.name} contacts: MoCap, 6 channels, 125 Hz"
    assert offered.line() == f"tactile {display.name} shear: Haptics, 3 channels, 4000 Hz"


def test_missing_samples_are_counted_and_marked(display: Shown, offered: Running) -> None:
    markers = offered.inlet("markers")
    numbers = (0, 0), (BLOCK, 1), (5 * BLOCK, 5), (0, 6), (BLOCK + 7, 9)
    for first, place in numbers:
        display.say(commanded(first, (1.0 + place * BLOCK / RATE,)))
    begun = 1.0 + offered.bridge._clock.offset
    third, fifth = begun + 5 * BLOCK / RATE, begun + 9 * BLOCK / RATE
    assert marker(markers) == ("missing 96 samples", pytest.approx(third, abs=1e-9))
    assert marker(markers) == ("missing 7 samples", pytest.approx(fifth, abs=1e-9))
    assert offered.bridge.summary.missing == 103


def test_the_numbers_of_a_server_that_has_restarted_are_others(
    display: Shown, offered: Running
) -> None:
    """Continue with a higher number after a connection, 4 s later."""
    markers = offered.inlet("markers")
    display.say(commanded(0, (1.0,)))
    display.say(commanded(BLOCK + 1, (1.0 + BLOCK / RATE,)))
    assert marker(markers)[0] == "missing 1 sample"
    for call in display.event_callbacks:
        call(Event("connected"))
    assert marker(markers)[0] == "connected"
    display.say(commanded(8000, (1.0 + 2 * BLOCK / RATE + 4,)))
    assert marker(markers)[0] == "time jumps by 4000 ms"
    assert offered.bridge.summary.missing == 1


def test_jumps_of_time_are_marked_and_steps_of_a_clock_are_not() -> None:
    """Leave out 8 ms within an item and between two, beside steps of just less than `JUMP`."""
    length, step = BLOCK / RATE, 0.99 * JUMP
    times = [1.0, 1.0 + length + step, 1.0 + 2 * length, 1.008 + 3 * length]
    continuity = Continuity()
    assert continuity.take(commanded(0, tuple(times))) == [("time jumps by 8 ms", times[3])]
    later = times[3] + length - step
    assert continuity.take(commanded(4 * BLOCK, (later,))) == []
    last = later + length + 8e-3
    assert continuity.take(commanded(5 * BLOCK, (last,))) == [("time jumps by 8 ms", last)]
    assert continuity.missing == 0


def test_a_bridge_goes_on_while_the_server_is_not_there(display: Shown, offered: Running) -> None:
    contacts = offered.inlet("contacts")
    display.said.put(ClientTimeoutError("telemetry: nothing came"))
    display.said.put(DisconnectedError("no connection"))
    display.say(None)
    display.say(commanded(0, (1.0,)))
    assert pulled(contacts, 1)[1].shape == (1, 6)


def test_a_summary_tells_the_largest_uncertainty(display: Shown, offered: Running) -> None:
    contacts = offered.inlet("contacts")
    for k, uncertainty in enumerate((4e-6, 9e-6, 2e-6)):
        display.say(commanded(k * BLOCK, (1.0 + k,), uncertainty=uncertainty))
    pulled(contacts, 3)
    summary = offered.bridge.summary
    assert summary.uncertainty == 9e-6
    assert summary.as_dict()["uncertainty_us"] == pytest.approx(9.0)
    display.say(commanded(3 * BLOCK, (5.0,), uncertainty=None))
    pulled(contacts, 1)
    assert offered.bridge.summary.uncertainty is None


# Decimation


def decimated(
    decimator: Decimator, frequency: float, lengths: list[int], first: int = 0
) -> tuple[Any, Any]:
    """Return the output for a sine and a cosine at a frequency that come in pieces."""
    outputs, number = [], first
    for length in lengths:
        times = 50.0 + np.arange(number, number + length) / RATE
        values = waves(frequency, times).astype(np.float32)
        outputs.append(decimator.push(number, times, values))
        number += length
    return np.concatenate([one[0] for one in outputs]), np.concatenate([one[1] for one in outputs])


def waves(frequency: float, times: Any) -> Any:
    phase = 2 * np.pi * frequency * (times - 50.0)
    return np.column_stack((np.sin(phase), np.cos(phase)))


PIECES = [1, 2000, 7, 320, 0, 3, 4000, 160, 160]


@pytest.mark.parametrize("factor", [2, 3, 8, 64])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.31, 0.4])
def test_decimation_keeps_amplitude_and_phase_in_the_passband(factor: int, share: float) -> None:
    """The output is the wave itself at the times of the output, within 0.1 dB."""
    frequency = share * RATE / factor
    pieces = PIECES * (factor // 8 + 1)
    times, values = decimated(Decimator(factor, RATE, 2), frequency, pieces)
    assert len(times) > 50
    np.testing.assert_allclose(np.diff(times), factor / RATE, rtol=1e-6)
    assert np.max(np.abs(values - waves(frequency, times))) < 10 ** (0.1 / 20) - 1


@pytest.mark.parametrize("factor", [2, 3, 8, 64])
@pytest.mark.parametrize("share", [0.5, 0.513, 0.61, 0.87, 1.0])
def test_decimation_attenuates_what_is_above_the_new_band_by_80_db(
    factor: int, share: float
) -> None:
    pieces = PIECES * (factor // 8 + 1)
    frequency = min(share * RATE / factor, RATE / 2)
    _, values = decimated(Decimator(factor, RATE, 2), frequency, pieces)
    assert np.max(np.hypot(*values.T)) < 10 ** (-80 / 20)


def test_decimation_does_not_depend_on_the_pieces() -> None:
    whole = decimated(Decimator(5, RATE, 2), 300.0, [sum(PIECES)])
    parts = decimated(Decimator(5, RATE, 2), 300.0, PIECES)
    np.testing.assert_array_equal(whole[0], parts[0])
    np.testing.assert_allclose(whole[1], parts[1], atol=1e-12)


def test_decimation_keeps_the_samples_of_the_same_numbers_after_a_gap() -> None:
    decimator = Decimator(8, RATE, 2)
    before, _ = decimated(decimator, 100.0, [2000])
    after, values = decimated(decimator, 100.0, [2000], first=5003)
    half = decimator.half_length
    numbers = (after - 50.0) * RATE
    assert numbers[0] == pytest.approx(-(-(5003 + half) // 8) * 8, abs=1e-3), "not across the gap"
    np.testing.assert_allclose(numbers / 8, np.round(numbers / 8), atol=1e-3)
    assert (before[-1] - 50.0) * RATE <= 2000 - 1 - half + 1e-3
    np.testing.assert_allclose(values, waves(100.0, after), atol=1e-3)


def test_decimation_begins_anew_where_only_the_numbers_jump() -> None:
    decimator = Decimator(4, RATE, 1)
    times = np.arange(1002) / RATE
    ones = np.ones((1000, 1), np.float32)
    decimator.push(0, times[:1000], ones)
    kept, _ = decimator.push(1003, times[1000:], ones[:2])
    assert len(kept) == 0


@pytest.mark.parametrize(("jump", "resets"), [(7, False), (-7, False), (9, True), (-9, True)])
def test_decimation_begins_anew_where_the_time_jumps(jump: float, *, resets: bool) -> None:
    decimator = Decimator(4, RATE, 1)
    times = np.arange(4000) / RATE
    times[2000:] += jump / RATE
    kept, values = decimator.push(0, times, np.ones((4000, 1), np.float32))
    np.testing.assert_allclose(values, 1.0, atol=1e-5)
    gap = float(np.max(np.diff(kept))) * RATE
    assert (gap > 2 * decimator.half_length - 8) is resets
    again, _ = decimator.push(4000, times[-1] + jump / RATE + np.arange(1, 2) / RATE,
                              np.ones((1, 1), np.float32))  # fmt: skip
    more, _ = decimator.push(4001, times[-1] + jump / RATE + np.arange(2, 12) / RATE,
                             np.ones((10, 1), np.float32))  # fmt: skip
    assert (len(again) + len(more) == 0) is resets, "also between pieces"


def test_a_decimated_drive_is_offered_at_its_rate_and_times(
    display: Shown, running: Callable[..., Running]
) -> None:
    bridge = offer(running(decimate=4, streams=("drive",)), display, 1)
    inlet = bridge.inlet("drive")
    info = inlet.info(PATIENCE)
    assert info.nominal_srate() == RATE / 4
    lowpass = info.desc().child("filtering").child("lowpass")
    assert [lowpass.child_value(name) for name in ("lower", "upper")] == ["800", "1000"]
    half = Decimator(4, RATE, 3).half_length
    lag = float(info.desc().child("acquisition").child_value("compensated_lag"))
    assert lag == pytest.approx(half / RATE)
    times = tuple(7.0 + k * BLOCK / RATE for k in range(40))
    display.say(commanded(0, times))
    got, values = pulled(inlet, 10)
    numbers = np.round((got - bridge.bridge._clock.offset - 7.0) * RATE)
    assert np.max(np.abs(got - bridge.bridge._clock.offset - 7.0 - numbers / RATE)) < 1e-9
    np.testing.assert_allclose(np.diff(numbers), 4)
    ramp = (numbers[:, None] + np.arange(3) / 4) / 8
    np.testing.assert_allclose(values, ramp, rtol=1e-4)


# Markers


def onset(at: float, time: float | None, reason: str = "", code: int = 0) -> Onset:
    return Onset("left", at, time, None, reason, code)


def test_markers_of_the_amplifier_are_marked_at_their_onsets(
    display: Shown, offered: Running
) -> None:
    markers = offered.inlet("markers")
    (call,) = display.event_callbacks
    reports = (
        onset(2.0, 2.5, code=129),
        onset(3.0, None, "late", code=4),
        onset(4.0, 4.0),
        onset(5.0, 5.0, code=7),
    )
    for report in reports:
        call(Event("onset", display.name, report.reason, onset=report))
    offset = offered.bridge._clock.offset
    assert marker(markers) == ("129", pytest.approx(2.5 + offset, abs=1e-9))
    assert marker(markers) == ("stimulus: late", pytest.approx(3.0 + offset, abs=1e-9))
    assert marker(markers) == ("7", pytest.approx(5.0 + offset, abs=1e-9))


def test_events_of_the_display_are_marked_when_they_are_received(
    display: Shown, offered: Running
) -> None:
    markers = offered.inlet("markers")
    (call,) = display.event_callbacks
    before = pylsl.local_clock()
    kinds = ("armed", "touched", "estopped", "lifted", "cleared", "underrun", "disconnected")
    for kind in kinds:
        call(Event(kind, display.name))
    after = pylsl.local_clock()
    got = [marker(markers) for _ in range(4)]
    assert [text for text, _ in got] == ["armed", "estopped", "cleared", "disconnected"]
    assert all(before - 1e-3 <= time <= after + 1e-3 for _, time in got)


def test_what_comes_after_the_end_is_ignored(
    display: Shown, running: Callable[..., Running]
) -> None:
    bridge = running()
    bridge.end()
    (call,) = display.event_callbacks
    call(Event("armed", display.name))
    assert [one.samples for one in bridge.bridge.summary.streams] == [0]


# Markers that start effects


class Triggers:
    """An outlet of markers, as an experiment has it."""

    def __init__(self, name: str, source: str = "experiment", kind: str = "string") -> None:
        info = pylsl.StreamInfo(name, "Markers", 1, pylsl.IRREGULAR_RATE, kind, source)
        self.outlet = pylsl.StreamOutlet(info)
        assert self.outlet.wait_for_consumers(PATIENCE)

    def send(self, value: Any, time: float) -> None:
        self.outlet.push_sample([value], time)


@pytest.fixture
def corrected(monkeypatch: pytest.MonkeyPatch) -> float:
    """Return the correction for the clock of the other machine, which has one here [s]."""
    monkeypatch.setattr(pylsl.StreamInlet, "time_correction", lambda *_: 0.25)
    return 0.25


@pytest.fixture
def name() -> str:
    return f"triggers-{uuid.uuid4().hex}"


@pytest.fixture
def started(
    display: Shown, running: Callable[..., Running], corrected: float, name: str
) -> tuple[Running, Triggers]:
    """Return a bridge that starts effects, and the stream of markers, which appears later."""
    bridge = running(
        streams=("markers",), start_from=name, starts={"go": "tap", "7": "hum"}, delay=0.125
    )
    return bridge, Triggers(name)


def test_a_marker_starts_its_effect_a_constant_time_later(
    display: Shown, started: tuple[Running, Triggers], corrected: float
) -> None:
    bridge, triggers = started
    for text, time in (("go", 100.0), ("what?", 101.0), ("hum", 102.0), ("", 103.0), ("7", 104.0)):
        triggers.send(text, time)
    delay = corrected + 0.125 - bridge.bridge._clock.offset
    for effect, time in (("tap", 100.0), ("hum", 102.0), ("hum", 104.0)):
        name, at = display.played.get(timeout=PATIENCE)
        assert name == effect
        assert at.time == pytest.approx(time + delay, abs=1e-9)
        assert at.drop_late, "a late stimulus spoils a trial"
    assert bridge.bridge.summary.ignored == 2


def test_a_marker_that_cannot_be_read_is_counted(
    display: Shown, started: tuple[Running, Triggers]
) -> None:
    bridge, triggers = started
    triggers.send(b"\xff", 100.0)  # no UTF-8
    triggers.send("go", float("nan"))
    triggers.send("go", float("inf"))
    triggers.send("hum", 100.0)
    assert display.played.get(timeout=PATIENCE)[0] == "hum"
    assert bridge.bridge.summary.ignored == 3


def test_a_marker_may_be_a_whole_number(
    display: Shown, running: Callable[..., Running], name: str
) -> None:
    running(start_from=name, starts={"7": "hum"})
    triggers = Triggers(name, kind="int32")
    triggers.send(7, 100.0)
    assert display.played.get(timeout=PATIENCE)[0] == "hum"


def test_what_became_of_a_stimulus_is_marked(
    display: Shown, started: tuple[Running, Triggers], corrected: float
) -> None:
    bridge, triggers = started
    markers = bridge.inlet("markers")
    outcomes = [
        (50.0, "", [("go", 50.0)]),
        (None, "late by 3 ms", [("go: dropped, late by 3 ms", 100.0 + corrected + 0.125)]),
        (51.0, "the link was down", [("go", 51.0), ("go: the link was down", 51.0)]),
    ]
    offset = bridge.bridge._clock.offset
    for time, reason, expected in outcomes:
        triggers.send("go", 100.0)
        _, at = display.played.get(timeout=PATIENCE)
        at._onset.set_result(onset(at.time, time, reason))
        display.say(None)
        for text, stamp in expected:
            shift = 0.0 if "dropped" in text else offset
            assert marker(markers) == (text, pytest.approx(stamp + shift, abs=1e-9))
    assert (bridge.bridge.summary.begun, bridge.bridge.summary.dropped) == (2, 1)


def test_a_stimulus_that_is_refused_is_marked(
    display: Shown, started: tuple[Running, Triggers]
) -> None:
    bridge, triggers = started
    markers = bridge.inlet("markers")
    display.refusal = DisconnectedError("no connection:\nit is lost")
    triggers.send("go", 100.0)
    display.played.get(timeout=PATIENCE)
    assert told(bridge, markers) == "go: dropped, no connection: it is lost"
    assert bridge.bridge.summary.dropped == 1


def told(bridge: Running, markers: Any) -> str:
    """Return the next marker, while telemetry goes on."""
    for _ in range(300):
        bridge.display.say(None)
        values, _ = markers.pull_sample(0.1)
        if values is not None:
            return str(values[0])
    raise AssertionError("it did not come")


def test_a_stimulus_whose_onset_is_never_reported_is_given_up(
    display: Shown, started: tuple[Running, Triggers]
) -> None:
    """An answer that did not come in time does not mean that it is not played."""
    bridge, triggers = started
    markers = bridge.inlet("markers")
    display.refusal = ClientTimeoutError("no answer")
    triggers.send("go", 0.5 + bridge.bridge._clock.offset)  # long ago
    assert told(bridge, markers) == "go: dropped, its onset was not reported"


def test_a_stimulus_that_waits_at_the_end_is_counted(
    display: Shown, started: tuple[Running, Triggers]
) -> None:
    bridge, triggers = started
    for seconds in (100.0, 200.0):
        triggers.send("go", seconds)
    _, begun = display.played.get(timeout=PATIENCE)
    display.played.get(timeout=PATIENCE)
    begun._onset.set_result(onset(begun.time, begun.time))
    bridge.end()
    assert (bridge.bridge.summary.begun, bridge.bridge.summary.dropped) == (1, 1)


def test_at_most_64_stimuli_wait(
    display: Shown, started: tuple[Running, Triggers], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stimuli, "PATIENCE", 1e9)
    bridge, triggers = started
    markers = bridge.inlet("markers")
    for _ in range(65):
        triggers.send("go", 100.0)
    assert told(bridge, markers) == "go: dropped, 64 stimuli wait already"
    assert display.played.qsize() == 64


@pytest.mark.parametrize("source", ["", "experiment"])
def test_a_stream_that_comes_back_starts_effects_again(
    display: Shown, running: Callable[..., Running], name: str, source: str
) -> None:
    """One without an identity is lost for LSL, and is looked for again."""
    running(start_from=name)
    for effect in ("tap", "hum"):
        triggers = Triggers(name, source)
        triggers.send(effect, 100.0)
        assert display.played.get(timeout=PATIENCE)[0] == effect
        del triggers


@pytest.mark.parametrize(
    ("form", "fault"),
    [
        ((2, 0.0, "string"), "has 2 channels; one of markers has 1"),
        ((1, 10.0, "string"), "has a rate of 10 Hz; one of markers has none"),
        ((1, 0.0, "float32"), "has values that are neither texts nor whole numbers"),
    ],
)
def test_a_stream_that_is_none_of_markers_is_said_once(
    running: Callable[..., Running],
    display: Shown,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    form: Any,
    fault: str,
) -> None:
    looks: queue.SimpleQueue[int] = queue.SimpleQueue()
    resolve = pylsl.resolve_bypred

    def look(*arguments: Any, **named: Any) -> Any:
        found = resolve(*arguments, **named)
        looks.put(len(found))
        return found

    monkeypatch.setattr(pylsl, "resolve_bypred", look)
    count, rate, kind = form
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "Markers", count, rate, kind, "experiment"))
    bridge = running(streams=("contacts",), start_from=name)
    assert bridge.line() == f"stream {name!r}: {fault}"
    assert sum(looks.get(timeout=PATIENCE) for _ in range(4)) > 1, "it was found again"
    del outlet
    triggers = Triggers(name)
    triggers.send("tap", 100.0)
    assert display.played.get(timeout=PATIENCE)[0] == "tap"
    assert bridge.line().startswith(f"markers of {name!r} on "), "the fault was said once"


def test_an_effect_that_the_server_does_not_have_is_a_mistake(display: Shown) -> None:
    settings = BridgeSettings(start_from="triggers", starts={"go": "tab"})
    with pytest.raises(NotFoundError, match="no effect 'tab' on the server; there are: tap, hum"):
        Bridge(display, settings, print)  # type: ignore[arg-type]


def test_the_markers_of_a_bridge_start_nothing_on_it(display: Shown) -> None:
    settings = BridgeSettings(start_from=f"tactile {display.name} markers")
    with pytest.raises(InputError, match="its markers are those of this bridge"):
        Bridge(display, settings, print)  # type: ignore[arg-type]


# Settings and the library


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"streams": ("shears",)}, "stream 'shears': there are contacts, shear, drive, markers"),
        ({"streams": ()}, "no stream: name some of contacts"),
        ({"decimate": 0}, "decimation by 0: must be between 1 and 64"),
        ({"decimate": 65}, "decimation by 65: must be between 1 and 64"),
        ({"decimate": 2, "streams": ("shear",)}, "is of the drive, which is not offered"),
        ({"delay": -0.1}, "delay -0.1 s: must be between 0 and 30 s"),
        ({"delay": float("nan")}, "delay nan s: must be between 0 and 30 s"),
        ({"starts": {"go": "tap"}}, "marker 'go': there is no stream that markers come from"),
        ({"start_from": "'\""}, "LSL finds no name with quotes of both kinds"),
    ],
)
def test_settings_that_cannot_be_used_are_a_mistake(settings: Any, text: str) -> None:
    with pytest.raises(InputError) as refused:
        BridgeSettings(**settings)
    assert text in str(refused.value)


def test_lists_of_the_command_line_are_read() -> None:
    assert parse_streams("drive, contacts,drive,") == ("drive", "contacts")
    assert parse_starts(["go=tap", "a=b=hum", "go=tap"]) == {"go": "tap", "a=b": "hum"}
    for text in ("go", "go=", "=tap"):
        with pytest.raises(InputError, match="must be a marker and an effect, such as go=tap"):
            parse_starts([text])
    with pytest.raises(InputError, match="marker 'go': starts 'tap' already"):
        parse_starts(["go=tap", "go=hum"])


def test_a_missing_library_is_named_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(InputError) as missing:
        load_pylsl()
    assert "needs pylsl: pip install 'tactile-display[lsl]'" in str(missing.value)


def test_a_liblsl_that_cannot_be_loaded_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The error is that of pylsl, which loads the library when it is imported."""
    broken = tmp_path / "liblsl.so"
    broken.write_text("no library")
    monkeypatch.setenv("PYLSL_LIB", str(broken))
    for loaded in [one for one in sys.modules if one.partition(".")[0] == "pylsl"]:
        monkeypatch.delitem(sys.modules, loaded)
    with pytest.raises(InputError) as missing:
        load_pylsl()
    assert "needs liblsl (liblsl library " in str(missing.value)
    assert "mismatch): pip install" in str(missing.value), "its own advice is left out"
    assert "pip install 'tactile-display[lsl]'" in str(missing.value)
    assert len(str(missing.value).splitlines()) == 1


@pytest.mark.parametrize("place", ["lsl_api.cfg", "lsl_api/lsl_api.cfg", "elsewhere.cfg"])
def test_the_configuration_of_the_user_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, place: str
) -> None:
    given: list[str] = []
    monkeypatch.setattr(pylsl, "set_config_content", given.append)
    monkeypatch.delenv("LSLAPICFG")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    load_pylsl()
    assert given == ["[log]\nlevel = -2\n"], "liblsl logs errors only"
    if place == "elsewhere.cfg":
        monkeypatch.setenv("LSLAPICFG", place)
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text("[lab]\nSessionID = ours\n")
    load_pylsl()
    assert len(given) == 1
