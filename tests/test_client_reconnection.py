"""Tests of the SDK without its server: requests are restored, and nothing is armed unasked."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from client_rig import PATIENCE, Script, ScriptedServer, Twin, fill, plain, telemetry, until

from tactile import client
from tactile import messages as m
from tactile.client import websocket
from tactile.client.session import ClockOffset
from tactile.errors import DisconnectedError


def connected_again(server: ScriptedServer, hellos: int = 2) -> list[Any]:
    """Wait for another hello, and return the messages from then on."""
    until(lambda: len(server.of(m.ClientHello)) >= hellos)
    last = max(i for i, said in enumerate(server.heard) if isinstance(said, m.ClientHello))
    return server.heard[last:]


@pytest.mark.parametrize("rearm", [False, True])
def test_what_was_asked_is_restored_and_armed_only_where_that_was_asked(
    twin: Twin, server: ScriptedServer, rearm: bool
) -> None:
    events: list[client.Event] = []
    with twin.connect(server.url, timeout=PATIENCE, rearm=rearm) as display:
        display.on_event(events.append)
        display.select([("wood-oak", 0.5)])
        display.gain(0.25)
        display.stop()
        display.arm()
        stream = iter(display.telemetry(rate=50))
        with ThreadPoolExecutor() as pool:
            first = pool.submit(next, stream)
            until(lambda: server.of(m.Subscribe))
            server.say(telemetry(0))
            first.result()  # which comes only when the subscription has been answered
        server.drop()
        connected_again(server)
        until(lambda: [event.kind for event in events] == ["disconnected", "connected"])
        server.say(telemetry(1))
        next(stream)
        display.stats()
        said = [plain(each) for each in connected_again(server)[1:]]
        assert display.connection.counters["reconnections"] == 1
    restored = [
        m.Subscribe(display="left", rate_hz=50.0),
        m.SetGain(display="left", gain=0.25),
        m.Select(display="left", layers=(m.Layer(texture="wood-oak", gain=0.5),)),
        m.StopPlaying(display="left"),
        *([m.ArmDisplay(display="left")] if rearm else []),
    ]
    assert said[: len(restored) + 1] == [
        *map(plain, restored), plain(m.GetStats(display="left")),
    ]  # fmt: skip


def test_what_was_taken_back_is_not_restored(twin: Twin, server: ScriptedServer) -> None:
    """The program resumed after a stop, and somebody else disarmed."""
    events: list[client.Event] = []
    with twin.connect(server.url, timeout=PATIENCE, rearm=True) as display:
        display.on_event(events.append)
        display.arm()
        display.stop()
        display.resume()
        server.say(m.EventMessage(display="left", kind="disarmed", detail="by hand"))
        until(lambda: events)
        server.drop()
        until(lambda: events[-1].kind == "connected")
        display.stats()
        kinds = [type(said) for said in connected_again(server)]
    assert kinds[:2] == [m.ClientHello, m.GetStats]


def test_what_cannot_be_restored_is_an_event(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    events: list[client.Event] = []
    with twin.connect(server.url, timeout=PATIENCE) as display:
        display.on_event(events.append)
        display.select("wood-oak")
        script.answers[m.Select] = lambda said: m.Failure(
            id=said.id, code="unknown_texture", message="no 'wood-oak'"
        )
        server.drop()
        until(lambda: "refused" in [event.kind for event in events])
    assert "unknown_texture: no 'wood-oak'" in [event.detail for event in events]


def test_without_a_server_touch_is_counted_and_requests_fail_at_once(
    twin: Twin, server: ScriptedServer
) -> None:
    with twin.connect(server.url, timeout=PATIENCE, reconnect=False) as display:
        server.drop()
        until(lambda: not display.connected)
        display.touch((0.0, 0.0))
        display.lift()
        assert display.dropped_contacts == 2
        for call in (display.stats, display.estop, display.arm):
            with pytest.raises(DisconnectedError):
                call()
        until(lambda: display.connection._transport._closed.done())
    assert len(server.of(m.ClientHello)) == 1, "and it was not connected again"


def test_a_request_that_waits_fails_when_the_connection_does(
    remote: Any, script: Script, server: ScriptedServer
) -> None:
    def gone(said: m.GetStats) -> None:
        server.drop()

    script.answers[m.GetStats] = gone
    with pytest.raises(DisconnectedError):
        remote.stats()


def test_a_server_that_answers_no_ping_is_given_up(
    twin: Twin, script: Script, server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(websocket, "PING_INTERVAL", 0.01)
    monkeypatch.setattr(websocket, "SILENCE", 0.2)
    script.answers[m.Ping] = lambda said: None
    with twin.connect(server.url, timeout=PATIENCE):
        connected_again(server, 3)


@pytest.mark.ci
def test_a_server_that_does_not_read_is_given_up_and_found_again(
    twin: Twin, server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long timeout for answers does not prolong the wait for the farewell of a silent server."""
    events: list[str] = []
    with twin.connect(server.url, timeout=10 * PATIENCE) as display:
        display.on_event(lambda event: events.append(event.kind))
        monkeypatch.setattr(websocket, "SILENCE", 1.0)
        fill(server, display)
        until(lambda: events[-1:] == ["disconnected"])
        monkeypatch.setattr(websocket, "SILENCE", PATIENCE)
        server.reading.set()
        until(lambda: events[-1] == "connected")
        display.stats(timeout=PATIENCE)


def test_pings_measure_the_clocks(
    twin: Twin, script: Script, server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(websocket, "PING_INTERVAL", 0.01)
    with twin.connect(server.url, timeout=PATIENCE) as display:
        until(lambda: server.pings > 3)
        script.answers[m.Ping] = lambda said: None
        display.stats()  # all answers to pings have come
        connection = display.connection
        assert abs(connection.clock_offset - 5.0) <= connection.round_trip / 2 + 1e-5


def test_the_quickest_exchange_tells_the_clocks_best() -> None:
    clock = ClockOffset()
    clock.exchange(1.0, 11.9, 2.0)
    clock.exchange(3.0, 13.05, 3.1)
    clock.exchange(4.0, 14.9, 5.0)
    assert clock.seconds == pytest.approx(10.0)
    assert clock.round_trip == pytest.approx(0.1)
    assert clock.uncertainty(3.1) == pytest.approx(0.05)


def test_an_exchange_is_the_less_certain_the_older_it_is() -> None:
    """Two crystals drift from each other by up to 100 µs in a second."""
    clock = ClockOffset()
    clock.exchange(1.0, 11.0001, 1.0002)
    assert clock.uncertainty(2.0002) == pytest.approx(200e-6)
    clock.exchange(3.0, 13.0003, 3.0004)
    assert clock.seconds == pytest.approx(10.0001)
    assert clock.uncertainty(3.0004) == pytest.approx(200e-6)
    assert clock.round_trip == pytest.approx(200e-6)


def test_the_clock_of_this_machine_is_ours_unless_an_exchange_proves_the_opposite() -> None:
    """The address of this machine may be the end of a tunnel to another."""
    clock = ClockOffset(same_machine=True)
    for sent, theirs, received in [(1.0, 1.999999, 2.0), (3.0, 3.0, 3.1), (4.0, 4.9, 5.0)]:
        clock.exchange(sent, theirs, received)
    assert (clock.seconds, clock.uncertainty(9.0)) == (0.0, 1e-6)
    clock.exchange(6.0, 6.10001, 6.1)  # their answer came before they had sent it
    assert clock.seconds == pytest.approx(0.05001)
    assert clock.uncertainty(6.1) == pytest.approx(0.05)
    clock.exchange(7.0, 7.05, 7.1)
    assert not clock.same_machine
