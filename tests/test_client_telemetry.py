"""Tests of telemetry and events in the SDK; a program that does not listen delays no other."""

import asyncio
import struct
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from itertools import chain
from typing import Any

import msgspec
import pytest
from client_rig import PATIENCE, Script, ScriptedServer, Twin, server_time_us, telemetry, until

from tactile import client
from tactile import messages as m
from tactile.client import websocket, wire
from tactile.errors import ClientTimeoutError


def then_one(server: "ScriptedServer") -> Callable[[m.Subscribe], m.Answer]:
    """Return what answers a subscription, and gives the first telemetry at once."""

    def answer(said: m.Subscribe) -> m.Answer:
        server.say(m.Done(id=said.id))
        return telemetry(0)

    return answer


def test_telemetry_comes_in_si_and_on_our_clock(remote: Any, server: ScriptedServer) -> None:
    server.script.answers[m.Subscribe] = lambda said: m.Done(id=said.id)
    stream = remote.telemetry(rate=20)
    numbers = iter(stream)

    def say_when_asked() -> None:
        until(lambda: server.of(m.Subscribe))
        server.say(telemetry(server_time_us()))

    until_asked = threading.Thread(target=say_when_asked)
    until_asked.start()
    told = next(numbers)
    until_asked.join()
    now = time.monotonic()
    assert abs(told.time - now) < PATIENCE
    assert list(told.position) == pytest.approx([1e-3, 2e-3])
    assert list(told.velocity) == pytest.approx([0.08, 0.0])
    assert list(told.shear) == pytest.approx([3e-6, -3e-6])
    assert (told.drive, told.normal_force) == ((50.0, -50.0), 0.5)
    stream.close()
    asked = until(lambda: len(server.of(m.Subscribe)) == 2 and server.of(m.Subscribe))
    assert [said.rate_hz for said in asked] == [20.0, 0.0]


def packed(kind: str, *values: float) -> bytes:
    return struct.pack(f"<{len(values)}{kind}", *values)


SAMPLES = m.TelemetrySamples(
    first=32, sample_rate_hz=8000.0, block_samples=2, times_us=packed("d", 5e6, 5.00025e6),
    uncertainty_us=30.0, finger_times_us=packed("d", 5.003e6, 5.00325e6),
    position_mm=packed("f", 1.0, 2.0, 1.5, 2.0), velocity_mm_s=packed("f", 80.0, 0.0, 90.0, -1.0),
    normal_force_n=packed("f", 0.5, 0.25), touching=(True, False),
    shear_um=packed("f", *range(12)), drive_v=packed("f", *range(0, -12, -1)),
)  # fmt: skip
"""Two blocks of two samples of three contactors."""


def test_samples_come_in_si_and_on_our_clock() -> None:
    """The server's clock is 2 s ahead, and the offset of both is uncertain by 10 µs."""
    message = msgspec.structs.replace(telemetry(5_000_000), samples=SAMPLES)
    received = wire.to_telemetry(message, 2.0, 10e-6)
    samples = received.samples
    assert samples is not None
    assert received.time == pytest.approx(3.0)
    assert (samples.first, samples.sample_rate, samples.block_samples) == (32, 8000.0, 2)
    assert samples.times == pytest.approx([3.0, 3.00025])
    assert samples.finger_times == pytest.approx([3.003, 3.00325])
    assert samples.uncertainty == pytest.approx(40e-6)
    assert [*chain(*samples.position)] == pytest.approx([1e-3, 2e-3, 1.5e-3, 2e-3])
    assert [*chain(*samples.velocity)] == pytest.approx([0.08, 0.0, 0.09, -1e-3])
    assert samples.normal_force == (0.5, 0.25)
    assert samples.touching == (True, False)
    assert samples.shear is not None
    assert samples.drive is not None
    assert samples.shear.shape == samples.drive.shape == (4, 3)
    assert samples.shear[3, 1] == pytest.approx(10e-6)
    assert samples.drive[1, 0] == -3.0


def test_samples_without_shear_or_without_blocks_have_none() -> None:
    frames = msgspec.structs.replace(SAMPLES, shear_um=None, drive_v=None, uncertainty_us=None)
    nothing = msgspec.structs.replace(
        SAMPLES, times_us=b"", finger_times_us=b"", position_mm=b"", velocity_mm_s=b"",
        normal_force_n=b"", touching=(), shear_um=b"", drive_v=b"",
    )  # fmt: skip
    for message, blocks in ((frames, 2), (nothing, 0)):
        whole = msgspec.structs.replace(telemetry(1), samples=message)
        samples = wire.to_telemetry(whole, 0.0, 10e-6).samples
        assert samples is not None
        assert samples.shear is samples.drive is None
        assert len(samples.times) == len(samples.position) == blocks
    assert wire.to_telemetry(telemetry(1), 0.0, 0.0).samples is None


def test_one_stream_with_samples_gives_them_to_all_streams(
    remote: Any, server: ScriptedServer
) -> None:
    server.script.answers[m.Subscribe] = then_one(server)
    plain, whole = remote.telemetry(rate=20), remote.telemetry(rate=10, samples=True)
    next(iter(plain))
    next(iter(whole))
    whole.close()
    asked = until(lambda: len(server.of(m.Subscribe)) == 3 and server.of(m.Subscribe))
    assert [said.samples for said in asked] == [False, True, False]
    plain.close()


def test_what_the_server_does_not_know_is_none() -> None:
    known = telemetry(1)
    unknown = msgspec.structs.replace(known, shear_um=None, put_out_share=0.75)
    assert wire.from_message(wire.Telemetry, known).put_out_share is None
    told = wire.from_message(wire.Telemetry, unknown)
    assert (told.shear, told.put_out_share) == (None, 0.75)


def test_the_trace_of_a_contactor_is_in_si() -> None:
    trace = m.TelemetryTrace(
        contactor=3, sample_rate_hz=8000.0, first=16, shear_um=struct.pack("<3f", 1.0, -2.5, 0.0)
    )
    told = wire.from_message(wire.Telemetry, msgspec.structs.replace(telemetry(1), trace=trace))
    assert told.trace is not None
    assert (told.trace.contactor, told.trace.sample_rate, told.trace.first) == (3, 8000.0, 16)
    assert told.trace.shear == pytest.approx((1e-6, -2.5e-6, 0.0))
    assert wire.from_message(wire.Telemetry, telemetry(1)).trace is None


def test_the_contactor_that_was_given_last_is_traced(remote: Any, server: ScriptedServer) -> None:
    """One subscription serves all streams of a display."""
    server.script.answers[m.Subscribe] = then_one(server)
    first, second = remote.telemetry(rate=20, contactor=3), remote.telemetry(rate=10, contactor=5)
    for stream in (first, second):
        next(iter(stream))
    second.close()
    first.close()
    asked = until(lambda: len(server.of(m.Subscribe)) >= 4 and server.of(m.Subscribe))
    assert [said.contactor for said in asked[:4]] == [3, 5, 3, None]


def test_telemetry_that_nobody_reads_is_dropped_and_then_ended(
    server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(websocket, "PING_INTERVAL", 10 * PATIENCE)  # none measures the clocks anew
    with client.connect(server.url, timeout=PATIENCE) as display:
        stream = display.telemetry(rate=20)
        server.script.answers[m.Subscribe] = then_one(server)
        next(stream)
        for number in range(1, 101):
            server.say(telemetry(number * 1_000_000))
        display.stats()  # all of it has come
        assert display.connection.counters["dropped_telemetry"] == 36
        offset = display.connection.clock_offset
        assert next(stream).time == pytest.approx(37 - offset), "the newest 64"
        del stream
        server.script.answers.clear()
        server.say(telemetry(0))
        server.say(telemetry(0))
        until(lambda: [said.rate_hz for said in server.of(m.Subscribe)] == [20.0, 0.0])


def test_two_readers_get_the_higher_rate_until_one_leaves(server: ScriptedServer) -> None:
    server.script.answers[m.Subscribe] = then_one(server)
    with client.connect(server.url, timeout=PATIENCE) as display:
        slow, fast = display.telemetry(rate=10), display.telemetry(rate=60)
        for stream in (slow, fast):
            assert next(stream).display == "left"
        fast.close()
        until(lambda: [said.rate_hz for said in server.of(m.Subscribe)] == [10.0, 60.0, 10.0])
        assert next(slow).display == "left"


def test_telemetry_that_does_not_come_is_a_timeout_and_may_be_waited_for_again(
    twin: Twin, server: ScriptedServer
) -> None:
    with twin.connect(server.url, timeout=PATIENCE) as display:
        stream = display.telemetry(rate=100)
        inner = getattr(stream, "_inner", stream)
        server.script.answers[m.Subscribe] = then_one(server)

        def read() -> Any:
            return twin.run(inner.__anext__()) if twin.name == "asyncio" else next(inner)

        assert read().display == "left"
        inner._timeout = 0.05
        with pytest.raises(ClientTimeoutError, match="telemetry: no answer in"):
            read()
        server.say(telemetry(1))
        inner._timeout = PATIENCE
        assert read().display == "left"


def test_telemetry_ends_with_the_connection(twin: Twin, server: ScriptedServer) -> None:
    display = twin.connect(server.url, timeout=PATIENCE)
    server.script.answers[m.Subscribe] = then_one(server)
    got = []
    for told in display.telemetry(rate=50):
        got.append(told)
        display.close()
    assert len(got) == 1


def test_a_callback_may_ask_and_may_fail(
    remote: Any, server: ScriptedServer, twin: Twin, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[str] = []

    def fail(event: client.Event) -> None:
        raise RuntimeError("a mistake of the program")

    def answer(event: client.Event) -> None:
        seen.append(remote.stats().state)

    async def aanswer(event: client.Event) -> None:
        seen.append((await remote._inner.stats()).state)

    remote.on_event(fail)
    remote.on_event(aanswer if twin.name == "asyncio" else answer)
    for _ in range(2):
        server.say(m.EventMessage(display="left", kind="fault", detail="channel 3 open"))
    until(lambda: seen == ["armed", "armed"])
    assert "a mistake of the program" in caplog.text


def test_events_go_to_the_display_that_they_are_of(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    script.displays = ("left", "right")
    left: list[client.Event] = []
    both: list[client.Event] = []
    with twin.open_connection(server.url, timeout=PATIENCE) as connection:
        connection.display("left").on_event(left.append)
        connection.on_event(both.append)
        for name in script.displays:
            server.say(m.EventMessage(display=name, kind="underrun", detail="4 blocks"))
        until(lambda: len(both) == 2)
    assert left == [client.Event("underrun", "left", "4 blocks")]


@pytest.mark.parametrize("callbacks", [1, 2])
def test_events_that_a_slow_callback_does_not_take_are_dropped(
    twin: Twin, server: ScriptedServer, callbacks: int
) -> None:
    """All callbacks wait until the end, so that the first 256 events are those that are kept."""
    go_on: Future[None] = Future()

    async def wait(event: client.Event) -> None:
        await asyncio.shield(asyncio.wrap_future(go_on))

    with twin.connect(server.url, timeout=PATIENCE) as display:
        for _ in range(callbacks):  # each is another function, so that none is added twice
            if twin.name == "asyncio":
                display.on_event(lambda event: wait(event))
            else:
                display.on_event(lambda event: go_on.result(PATIENCE))
        for _ in range(400):
            server.say(m.EventMessage(display="left", kind="underrun"))
        display.stats()  # all of them have come
        assert display.connection.counters["dropped_events"] == 400 - 256
        go_on.set_result(None)
