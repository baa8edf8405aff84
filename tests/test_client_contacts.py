"""The SDK gives contacts and waveforms at the server's pace, and no contact ever waits."""

import itertools
import threading
import time
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from client_rig import (
    PATIENCE,
    Script,
    ScriptedServer,
    Twin,
    count,
    fill,
    floats,
    samples_of,
    until,
)

from tactile import client
from tactile import messages as m
from tactile.client.waveform import pause_after
from tactile.client.wire import Appended
from tactile.clock import ModelClock
from tactile.errors import ClientTimeoutError


def test_touch_does_not_wait_for_a_server_that_does_not_read(
    remote: Any, server: ScriptedServer
) -> None:
    """More is sent than all buffers in between can hold; the newest arrives in the end."""
    said = fill(server, remote)
    assert remote.connected
    server.reading.set()
    newest = pytest.approx(said * 1e-3)
    until(lambda: (heard := server.of(m.Contact)) and heard[-1].position_mm[0] == newest)
    assert len(server.of(m.Contact)) + remote.dropped_contacts == said
    assert remote.stats().display == "left"  # and the connection has lived through it


def test_touch_from_several_threads(server: ScriptedServer) -> None:
    count, each = 4, 500
    with client.connect(server.url, timeout=PATIENCE) as display:

        def touch(thread: int) -> None:
            for number in range(each):
                display.touch((thread * 1e-3, number * 1e-6), normal_force=0.1)

        running = [threading.Thread(target=touch, args=(n,)) for n in range(count)]
        for thread in running:
            thread.start()
        for thread in running:
            thread.join()
        until(lambda: len(server.of(m.Contact)) + display.dropped_contacts == count * each)
    for number in range(count):
        heard = [c.position_mm for c in server.of(m.Contact) if round(c.position_mm[0]) == number]
        assert heard == sorted(heard), "each thread's contacts stay in order"


def test_contacts_keep_to_the_rate_that_the_server_takes(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    script.messages_per_second = 50
    with twin.connect(server.url, timeout=PATIENCE) as display:
        begun = time.monotonic()
        for number in range(100):
            display.touch((number * 1e-6, 0.0))
            time.sleep(0.002)
        last = until(lambda: [c for c in server.of(m.Contact) if c.position_mm[0] > 0.0989])
        assert len(server.of(m.Contact)) <= 2 + 50 * (time.monotonic() - begun)
    assert len(last) == 1


def test_a_refused_contact_is_an_event_and_not_at_its_rate(
    remote: Any, script: Script, server: ScriptedServer
) -> None:
    script.answers[m.Contact] = lambda said: m.Failure(code="not_armed", message="arm it first")
    clock = remote.connection._session.clock = ModelClock()
    events: list[client.Event] = []
    remote.on_event(events.append)
    for number in range(1, 5):
        clock.sleep(number // 4)  # the last one comes a second after the others
        remote.touch((0.0, 0.0))
        until(lambda: remote.connection.counters["refused_messages"] == number)  # noqa: B023
    until(lambda: len(events) >= 2)
    assert events == 2 * [client.Event("refused", "", "not_armed: arm it first")]


# Waveforms


@pytest.mark.parametrize(
    "made",
    [
        list, tuple, iter, lambda v: (x for x in v), lambda v: array("d", v),
        lambda v: memoryview(array("f", v)), np.array, lambda v: np.array(v, np.float32),
    ],
)  # fmt: skip
def test_samples_may_be_of_any_kind(
    server: ScriptedServer, made: Callable[[list[float]], Any]
) -> None:
    values = [0.0, 0.5, -0.25, 1.0, -1.0]
    with client.connect(server.url, timeout=PATIENCE) as display:
        display.append(made(values), sample_rate=8000, amplitude=1e-6)
    (said,) = server.of(m.Append)
    assert list(samples_of(said)) == values


def test_append_sends_one_message_and_cuts_what_is_beyond(
    remote: Any, server: ScriptedServer
) -> None:
    appended = remote.append([0.25] * 9000, sample_rate=8000, amplitude=1e-6)
    assert appended.samples_consumed == 4000, "XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB of OpenXR"
    assert [count(said) for said in server.of(m.Append)] == [4000]
    assert remote.append([], sample_rate=8000, amplitude=1e-6).samples_consumed == 0
    assert len(server.of(m.Append)) == 1


@pytest.mark.parametrize("most", [1000, 3999, 4000])
def test_play_hands_over_all_although_the_server_takes_only_part(
    remote: Any, script: Script, most: int
) -> None:
    """The server takes nothing at all every third time."""
    taken: list[float] = []
    replaced: list[bool] = []
    turns = itertools.count()

    def some(said: m.Append) -> m.AppendedReply:
        room = 0 if next(turns) % 3 == 0 else most
        replaced.append(not said.append)
        taken.extend(samples_of(said)[:room])
        return m.AppendedReply(id=said.id, samples_consumed=min(room, count(said)), buffered_ms=1.0)

    script.answers[m.Append] = some
    samples = np.sin(np.arange(10_001)).astype(np.float32)
    assert remote.play(samples, sample_rate=8000, amplitude=1e-6) == 10_001
    assert taken == samples.tolist()
    assert replaced[:3] == [True, True, False], "until something was taken"
    assert not any(replaced[2:])


@pytest.mark.parametrize(
    ("taken", "buffered_ms", "pause"),
    [(10, 500.0, 0.0), (0, 100.0, 0.05), (9, 100.0, 0.05), (0, 0.0, 0.005), (0, 5000.0, 0.1)],
)
def test_play_waits_for_half_of_what_is_buffered_before_it_sends_again(
    taken: int, buffered_ms: float, pause: float
) -> None:
    message = m.Append(
        display="left", sample_rate_hz=8000.0, amplitude_um=1.0, samples=floats(*[0.0] * 10)
    )
    assert pause_after(message, Appended(taken, buffered_ms * 1e-3)) == pytest.approx(pause)


def test_play_gives_up_where_nothing_is_taken(
    remote: Any, script: Script, server: ScriptedServer
) -> None:
    """The clock advances by almost half of the timeout with each answer."""
    clock = remote.connection._session.clock = ModelClock()

    def nothing(said: m.Append) -> m.AppendedReply:
        clock.sleep(PATIENCE / 2 - 1)
        return m.AppendedReply(id=said.id, samples_consumed=0, buffered_ms=1.0)

    script.answers[m.Append] = nothing
    with pytest.raises(ClientTimeoutError, match=r"no sample was taken in 60 s"):
        remote.play([0.0] * 10, sample_rate=8000, amplitude=1e-6, timeout=PATIENCE)
    assert len(server.of(m.Append)) == 3


def test_stop_ends_a_waveform_without_end(twin: Twin, server: ScriptedServer) -> None:
    with twin.connect(server.url, timeout=PATIENCE) as display:
        played: list[int] = []

        def play() -> None:
            samples = itertools.cycle([0.5, -0.5])
            played.append(display.play(samples, sample_rate=8000, amplitude=1e-6))

        thread = threading.Thread(target=play)
        thread.start()
        until(lambda: len(server.of(m.Append)) > 2)
        display.stop()
        thread.join(PATIENCE)
        assert played[0] == sum(count(said) for said in server.of(m.Append))


def test_waveforms_of_other_contactors_go_on_and_those_of_the_same_end(
    twin: Twin, server: ScriptedServer
) -> None:
    """Two without end play at the same time until a third one takes the contactor of the second."""
    played: dict[tuple[int, ...], int] = {}

    def sent(*contactors: int) -> list[m.Append]:
        return [said for said in server.of(m.Append) if said.contactors == contactors]

    with twin.connect(server.url, timeout=PATIENCE) as display:

        def play(*contactors: int) -> None:
            samples = itertools.cycle([0.5, -0.5])
            played[contactors] = display.play(
                samples, sample_rate=8000, amplitude=1e-6, contactors=contactors
            )

        threads = {}
        for contactors in ((0,), (1,), (1, 2)):
            threads[contactors] = threading.Thread(target=play, args=contactors)
            threads[contactors].start()
            until(lambda: len(sent(*contactors)) > 2)  # noqa: B023
        threads[1,].join(PATIENCE)
        assert set(played) == {(1,)}
        before = len(sent(0))
        until(lambda: len(sent(0)) > before + 2)
        display.stop()
        for thread in threads.values():
            thread.join(PATIENCE)
    assert played == {one: sum(map(count, sent(*one))) for one in threads}
