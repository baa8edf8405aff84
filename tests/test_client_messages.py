"""The SDK says each call as its message, and takes the server's answers, in both twins."""

import asyncio
import inspect
import math
import threading
import time
from collections.abc import Callable
from typing import Any, assert_type

import msgspec
import numpy as np
import pytest
from client_rig import MESSAGES, PATIENCE, Script, ScriptedServer, Twin, plain, stats, until

from tactile import client
from tactile import messages as m
from tactile.client import aio, waiting
from tactile.errors import ClientError, ClientTimeoutError, InputError, NotFoundError, RequestError


@pytest.mark.parametrize(("call", "message"), MESSAGES)
def test_each_call_says_its_message(
    remote: Any, server: ScriptedServer, call: Callable[[Any], Any], message: Any
) -> None:
    call(remote)
    (said,) = until(lambda: server.of(type(message)))
    assert plain(said) == plain(message)


def test_hello_comes_first_and_says_who_it_is(twin: Twin, server: ScriptedServer) -> None:
    with twin.connect(server.url, token="secret", client_name="game", timeout=PATIENCE):
        pass
    assert plain(server.heard[0]) == plain(m.ClientHello(client="game", token="secret"))


def test_time_is_our_monotonic_clock_where_none_is_given(
    remote: Any, server: ScriptedServer
) -> None:
    before = time.monotonic()
    remote.touch((0.0, 0.0))
    after = time.monotonic()
    (said,) = until(lambda: server.of(m.Contact))
    assert before - 1e-3 <= said.time_us * 1e-6 <= after + 1e-3
    assert said.velocity_mm_s is None


def test_positions_may_be_arrays_of_numpy(remote: Any, server: ScriptedServer) -> None:
    remote.touch(np.array([0.001, 0.002], np.float32), velocity=np.zeros(2))
    (said,) = until(lambda: server.of(m.Contact))
    assert list(said.position_mm) == pytest.approx([1.0, 2.0], rel=1e-6)  # of float32


@pytest.mark.parametrize(
    ("synchronous", "asynchronous"),
    [
        (client.Connection, aio.AsyncConnection),
        (client.RemoteDisplay, aio.AsyncDisplay),
        (client.TelemetryStream, aio.AsyncTelemetryStream),
        (client, aio),
    ],
)
def test_both_twins_have_the_same_calls(synchronous: Any, asynchronous: Any) -> None:
    """One twin is made of the other, so that only the line of a call could be missing."""

    def calls(twin: Any) -> dict[str, list[str]]:
        found = {name: getattr(twin, name) for name in dir(twin) if not name.startswith("_")}
        return {
            name: [str(parameter) for parameter in inspect.signature(call).parameters.values()]
            for name, call in found.items()
            if inspect.isfunction(call) and call.__doc__
        }

    expected = calls(asynchronous)
    expected.pop("open", None)  # which the synchronous one does when it is made
    assert calls(synchronous) == expected
    assert "close" in expected or "connect" in expected


def test_the_synchronous_twin_is_typed(server: ScriptedServer) -> None:
    """A type checker reads this as well, and an ignore that nothing needs is an error for it."""
    with client.connect(server.url, timeout=PATIENCE) as display:
        assert_type(display, client.RemoteDisplay)
        assert_type(display.connection.estop(), dict[str, int])
        assert_type(display.stats(timeout=PATIENCE), client.Stats)
        assert_type(display.play([0.5], sample_rate=8000, amplitude=1e-6), int)
        with pytest.raises(InputError):
            display.gain("loud")  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="loudness"):
            display.gain(loudness=0.5)  # type: ignore[call-arg]


def test_the_asyncio_twin_is_typed(server: ScriptedServer) -> None:
    async def main() -> None:
        async with aio.connect(server.url, timeout=PATIENCE) as display:
            assert_type(display, aio.AsyncDisplay)
            assert_type(await display.connection.estop(), dict[str, int])
            assert_type(await display.stats(timeout=PATIENCE), client.Stats)
            with pytest.raises(InputError):
                await display.gain("loud")  # type: ignore[arg-type]
        connection = await aio.open_connection(server.url, timeout=PATIENCE)
        assert_type(connection, aio.AsyncConnection)
        await connection.close()

    asyncio.run(main())


def test_what_would_be_suspended_for_good_in_the_synchronous_twin_is_an_error() -> None:
    ended: list[bool] = []

    async def suspended() -> None:
        try:
            await asyncio.sleep(0)
        finally:
            ended.append(True)

    with pytest.raises(RuntimeError, match="suspended"):
        waiting.finish(suspended())
    assert ended == [True]


# Answers


def test_what_the_server_tells_is_in_si(remote: Any) -> None:
    told = remote.info
    assert (told.name, told.waveforms, told.voltage_limit) == ("left", True, 100.0)
    assert told.contactors == ((-1e-3, 2e-3), (1e-3, 2e-3))
    assert told.shear_direction == pytest.approx((0.0, math.pi / 2))
    assert told.latency == pytest.approx(4e-3)
    stats = remote.stats()
    assert (stats.state, stats.latency, stats.counters) == ("armed", 0.004, {"underruns": 2})
    appended = remote.append([0.0] * 3, sample_rate=8000, amplitude=1e-6)
    assert (appended.samples_consumed, appended.buffered) == (3, 0.01)
    assert [texture.name for texture in remote.textures()] == ["wood-oak"]


def test_answers_out_of_order_find_their_questions(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    """The server keeps the first answer back until it has given the second."""
    script.displays = ("left", "right")
    kept: list[m.GetStats] = []

    def second_first(said: m.GetStats) -> None:
        kept.append(said)
        if len(kept) == 2:
            for asked in reversed(kept):
                server.say(stats(asked))

    script.answers[m.GetStats] = second_first
    with twin.open_connection(server.url, timeout=PATIENCE) as connection:
        told: dict[str, str] = {}

        def ask(name: str) -> None:
            told[name] = connection.display(name).stats().display

        threads = [threading.Thread(target=ask, args=(name,)) for name in script.displays]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert told == {"left": "left", "right": "right"}


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("unknown_texture", LookupError),
        ("unknown_texture", NotFoundError),
        ("invalid_field", ValueError),
        ("not_armed", RequestError),
    ],
)
def test_a_refusal_is_an_exception_with_code_and_field(
    remote: Any, script: Script, code: m.Code, kind: type[Exception]
) -> None:
    script.answers[m.Select] = lambda said: m.Failure(
        id=said.id,
        code=code,
        message="no 'oak'; did you mean 'wood-oak'?",
        field="layers[0].texture",
    )
    with pytest.raises(RequestError, match=r"layers\[0\].texture: no 'oak'; did") as caught:
        remote.select("oak")
    assert isinstance(caught.value, kind)
    assert (caught.value.code, caught.value.field) == (code, "layers[0].texture")


def test_an_answer_of_another_kind_is_an_error(remote: Any, script: Script) -> None:
    script.answers[m.GetStats] = lambda said: m.Done(id=said.id)
    with pytest.raises(ClientError, match="answered Done, not Stats"):
        remote.stats()


def test_a_server_that_is_silent_is_a_timeout_and_may_answer_the_next(
    remote: Any, script: Script, server: ScriptedServer
) -> None:
    asked: list[m.GetStats] = []
    script.answers[m.GetStats] = asked.append

    def ask() -> list[m.GetStats]:
        with pytest.raises(ClientTimeoutError, match=r"get_stats: no answer in 0.05 s"):
            remote.stats(timeout=0.05)
        return asked

    until(ask)  # once more where it was given up before it was even sent
    del script.answers[m.GetStats]
    server.say(stats(asked[0]))  # late: nobody waits for it
    assert remote.stats().display == "left"


def test_an_answer_of_a_later_version_fails_only_its_request(
    remote: Any, script: Script, server: ScriptedServer
) -> None:
    def later(said: m.GetStats) -> None:
        event = {"type": "event", "display": "left", "kind": "on fire", "detail": ""}
        server.last.send(msgspec.msgpack.encode({"type": "prophecy"}))
        server.last.send(msgspec.msgpack.encode(event))
        failure = {"type": "failure", "id": said.id, "code": "too_early", "message": "wait"}
        server.last.send(msgspec.msgpack.encode(failure))

    script.answers[m.GetStats] = later
    with pytest.raises(RequestError, match="wait") as caught:
        remote.stats()
    assert caught.value.code == "too_early"
    remote.gain(0.5)
    assert remote.connection.counters["ignored_messages"] == 1, "an event may be of any kind"
