"""The SDK's e-stop in both twins: never lost, named by `clear`, and nothing is armed again."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest
from client_rig import PATIENCE, Script, ScriptedServer, Twin, opened_session, until

from tactile import messages as m
from tactile.client import address, waiting, websocket
from tactile.errors import ClientError, DisconnectedError, InputError


def said_since_hello(server: ScriptedServer) -> list[m.Command]:
    last = max(i for i, said in enumerate(server.heard) if isinstance(said, m.ClientHello))
    return server.heard[last + 1 :]


@pytest.mark.parametrize(
    ("call", "first"),
    [
        (lambda d: d.estop(), [m.EStop]),
        (lambda d: d.connection.estop(), [m.EStop]),
        (lambda d: d.disarm(), []),
    ],
)
def test_what_is_called_without_a_server_holds_when_it_is_back(
    twin: Twin,
    script: Script,
    server: ScriptedServer,
    call: Callable[[Any], Any],
    first: list[type],
) -> None:
    with twin.connect(server.url, timeout=PATIENCE, rearm=True) as display:
        display.gain(0.5)
        display.arm()
        script.answers[m.ClientHello] = lambda said: m.Failure(
            id=said.id, code="busy", message="no"
        )
        server.drop()
        until(lambda: not display.connected)
        with pytest.raises(DisconnectedError, match="will be sent first" if first else "connected"):
            call(display)
        del script.answers[m.ClientHello]
        until(lambda: display.connected)
        display.stats()
        assert [type(said) for said in said_since_hello(server)] == [*first, m.SetGain, m.GetStats]


def test_an_estop_that_was_not_confirmed_is_sent_again(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    with twin.connect(server.url, timeout=PATIENCE) as display:
        display.gain(0.5)
        script.answers[m.EStop] = lambda said: server.drop()
        with pytest.raises(DisconnectedError, match="will be sent first"):
            display.estop()
        del script.answers[m.EStop]
        until(lambda: display.connected)
        until(lambda: display.estopped == 7)
        display.stats()
        assert [type(said) for said in said_since_hello(server)] == [m.EStop, m.SetGain, m.GetStats]


def test_a_display_that_was_estopped_meanwhile_is_not_armed_again(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    with twin.connect(server.url, timeout=PATIENCE, rearm=True) as display:
        display.arm()
        script.estop = 4
        server.drop()
        until(lambda: display.estopped == 4)
        display.stats()
        assert [type(said) for said in said_since_hello(server)] == [m.GetStats]


def test_a_display_whose_estop_was_cleared_meanwhile_is_not_armed_again(
    twin: Twin, script: Script, server: ScriptedServer
) -> None:
    """The display is disarmed then, as a clear promises, though no e-stop holds any more."""
    with twin.connect(server.url, timeout=PATIENCE, rearm=True) as display:
        display.arm()
        script.latest = 4
        server.drop()
        until(lambda: len(said_since_hello(server)) == 0 and display.connected)
        display.stats()
        assert [type(said) for said in said_since_hello(server)] == [m.GetStats]
        display.arm()
        server.drop()
        until(lambda: len(said_since_hello(server)) == 1)
        display.stats()
        assert [type(said) for said in said_since_hello(server)] == [m.ArmDisplay, m.GetStats]


def test_what_makes_quieter_is_never_too_much() -> None:
    session, kept = opened_session()
    for _ in range(256):
        session.request(m.SetGain(display="left", gain=0.5))
    with pytest.raises(ClientError, match="256 requests are already waiting"):
        session.request(m.ArmDisplay(display="left"))
    session.request(m.EStop())
    session.request(m.DisarmDisplay(display="left"))
    assert [type(said) for said in kept[256:]] == [m.EStop, m.DisarmDisplay]


@pytest.mark.parametrize("timeout", ["soon", float("nan"), -1])
def test_an_estop_is_sent_whatever_is_wrong_with_its_timeout(
    remote: Any, server: ScriptedServer, timeout: Any
) -> None:
    with pytest.raises(InputError, match="timeout"):
        remote.estop(timeout=timeout)
    with pytest.raises(InputError, match="timeout"):
        remote.arm(timeout=timeout)
    remote.stats()
    assert [type(said) for said in said_since_hello(server)] == [m.EStop, m.GetStats]


# Numbers


@pytest.mark.parametrize("how", ["stats", "event", "estop", "welcome"])
def test_clear_names_the_estop_that_was_reported(
    twin: Twin, script: Script, server: ScriptedServer, how: str
) -> None:
    script.estop = 7 if how == "welcome" else 0
    with twin.connect(server.url, timeout=PATIENCE) as display:
        assert display.estopped == script.estop
        if how == "event":
            server.say(m.EventMessage(display="left", kind="estopped", estop=7))
        elif how == "estop":
            assert display.estop() == 7
        elif how == "stats":
            script.estop = 7
            assert display.stats().estop == 7
        until(lambda: display.estopped == 7)
        display.clear()
        assert [said.estop for said in server.of(m.ClearEstop)] == [7]
        server.say(m.EventMessage(display="left", kind="cleared"))
        until(lambda: display.estopped == 0)


@pytest.mark.parametrize(("estop", "cleared"), [(0, []), (3, [3])])
def test_clear_asks_where_no_estop_is_known(
    remote: Any, script: Script, server: ScriptedServer, estop: int, cleared: list[int]
) -> None:
    script.estop = estop
    remote.clear()
    assert [said.estop for said in server.of(m.ClearEstop)] == cleared
    assert len(server.of(m.GetStats)) == 1


def test_a_program_reads_its_roles(remote: Any) -> None:
    assert remote.connection.roles == frozenset({"watch", "arm"})


# Signs of life


def test_a_cancellation_that_comes_with_the_result_is_not_lost() -> None:
    async def wait(waiting: Callable[[Future[int]], Any]) -> None:
        future: Future[int] = Future()
        task = asyncio.create_task(waiting(future))
        await asyncio.sleep(0)
        future.set_result(1)
        asyncio.get_running_loop().call_soon(task.cancel)  # before the task hears of the result
        with pytest.raises(asyncio.CancelledError):
            await task

    async def main() -> None:
        transport = websocket.TaskTransport(address.EXAMPLE_URL, timeout=PATIENCE)
        await wait(lambda future: waiting.suspend(future, PATIENCE, "it"))
        await wait(lambda future: transport._answer(future, PATIENCE, "it"))

    asyncio.run(main())


def test_sending_without_end_leaves_others_their_turn() -> None:
    """One of the others is the reader, which answers the server's pings."""
    contact = m.Contact(display="left", position_mm=(0.0, 0.0), normal_force_n=0.5)

    async def main() -> None:
        transport = websocket.TaskTransport(address.EXAMPLE_URL, timeout=PATIENCE)
        transport._session = opened_session()[0]
        sent: list[Any] = []

        class Endless:
            streams = 1

            def take(self, streams: bool) -> list[Any]:
                assert len(sent) < 100, "nobody else had a turn"
                return [contact]

        class Quick:
            async def send(self, data: bytes, text: bool) -> None:
                sent.append(data)

        transport._outbox = Endless()  # type: ignore[assignment]
        transport._more.set()
        writing = asyncio.create_task(transport._write(Quick()))  # type: ignore[arg-type]
        for _ in range(5):
            await asyncio.sleep(0)
        assert sent
        writing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writing

    asyncio.run(main())


def test_a_callback_that_waits_keeps_no_ping_unanswered(server: ScriptedServer) -> None:
    """Only the threaded twin is tested: a callback of asyncio must not block its loop anyway."""
    twin = Twin("thread")
    with twin.connect(server.url, timeout=PATIENCE) as display:
        entered: Future[None] = Future()
        leave: Future[None] = Future()

        def wait(event: Any) -> None:
            entered.set_result(None)
            leave.result(PATIENCE)

        display.on_event(wait)
        server.say(m.EventMessage(display="left", kind="fault"))
        entered.result(PATIENCE)
        assert server.last.ping().wait(PATIENCE)
        display.gain(0.5)
        leave.set_result(None)
