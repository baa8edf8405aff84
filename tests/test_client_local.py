"""The SDK inside one process, and its outbox: what quiets comes first."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest
from client_rig import MESSAGES, Script, Twin, opened_session, plain
from msgspec import structs

from tactile import messages as m
from tactile.client import websocket
from tactile.client.outbox import MOST_FRAMES, MOST_TIMED, Outbox
from tactile.client.session import ClientSession
from tactile.errors import DisconnectedError
from tactile.server.decoding import ENCODINGS, read


class LocalTransport:
    """A display of this process: objects in, objects out, nothing encoded."""

    def __init__(self, script: Script) -> None:
        self.script = script
        self.heard: list[Any] = []

    is_local = True

    def open(self, session: ClientSession) -> None:
        self._session = session
        session.say_hello()

    def send(self, command: m.Command) -> None:
        self.heard.append(command)
        if (answer := self.script.answer(command)) is not None:
            self._session.received(answer)

    def close(self) -> "Future[None]":
        future: Future[None] = Future()
        future.set_result(None)
        return future


@pytest.mark.parametrize(("call", "message"), MESSAGES)
def test_a_display_in_the_same_process_is_the_same(
    twin: Twin, script: Script, call: Callable[[Any], Any], message: Any
) -> None:
    transport = LocalTransport(script)
    with twin.over(transport) as connection:
        call(connection.display())
    assert plain(message) in map(plain, transport.heard)


class Endless(LocalTransport):
    """A transport whose end never comes, and cannot be called off."""

    def close(self) -> "Future[None]":
        future: Future[None] = Future()
        future.set_running_or_notify_cancel()
        return future


def test_closing_ends_though_the_transports_end_never_comes(twin: Twin, script: Script) -> None:
    connection = twin.over(Endless(script))
    getattr(connection, "_inner", connection).timeout = 0.1
    closing = threading.Thread(target=connection.close, daemon=True)
    closing.start()
    closing.join(60)
    assert not closing.is_alive()


def test_an_arm_that_nobody_waits_for_is_not_sent_late_but_what_quiets_is() -> None:
    session, kept = opened_session()
    for request in (
        m.ArmDisplay(display="left"),
        m.EStop(display="left"),
        m.StopPlaying(display="left"),
    ):
        session.request(request).cancel()
    assert [session.is_pending(command) for command in kept] == [False, True, True]
    waiting = session.request(m.ArmDisplay(display="left"))
    assert session.is_pending(kept[-1])
    session.close()
    assert isinstance(waiting.exception(), DisconnectedError)


def test_an_outbox_sends_estop_first_and_of_contacts_the_newest() -> None:
    dropped: list[m.Streamed] = []
    outbox = Outbox(dropped.append)
    contacts = [
        m.Contact(display=name, position_mm=(x, 0.0), normal_force_n=0.5)
        for name, x in (("left", 1.0), ("right", 2.0), ("left", 3.0))
    ]
    gain, play, estop = m.SetGain(display="left", gain=1.0), m.Resume(display="left"), m.EStop()
    commands: list[m.Command] = [gain, play, *contacts, estop]
    assert [outbox.put(c) for c in commands] == [True, *[False] * 5]
    assert outbox.take() == [estop, contacts[2], contacts[1], gain]
    assert outbox.take() == [play]
    assert outbox.take() == []
    assert dropped == [contacts[0]]
    assert outbox.put(contacts[1]), "the sender sleeps again"
    assert outbox.take(streams=False) == []
    outbox.clear()
    assert outbox.take() == []
    assert dropped == [contacts[0], contacts[1]]


def frames(values: bytes, *, display: str = "left", latest: bool = False) -> m.TactileFrames:
    return m.TactileFrames(
        display=display, frame_rate_hz=1000.0, amplitude_um=5.0, frames=values, latest=latest
    )


def test_frames_that_wait_are_joined_in_order_and_the_newest_wins_if_only_it_counts() -> None:
    dropped: list[m.Streamed] = []
    outbox = Outbox(dropped.append)
    for k in range(3):
        outbox.put(frames(bytes([k]) * 8))
    for k in range(3):
        outbox.put(frames(bytes([k]) * 8, latest=True))
    outbox.put(frames(b"right...", display="right"))
    assert outbox.streams == 3
    assert outbox.take() == [
        frames(bytes(8) + bytes([1]) * 8 + bytes([2]) * 8),
        frames(bytes([2]) * 8, latest=True),
        frames(b"right...", display="right"),
    ]
    assert dropped == []


def test_frames_that_nobody_takes_stay_within_bounds_and_the_oldest_are_dropped() -> None:
    dropped: list[m.Streamed] = []
    outbox = Outbox(dropped.append)
    message = frames(bytes(4 * m.MOST_FRAME_VALUES))
    for _ in range(MOST_FRAMES + 2):
        outbox.put(message)
    assert dropped == [message, message]
    outbox.put(frames(b"last"))
    assert len(dropped) == 3
    *_, last = outbox.take()
    assert last == frames(b"last")


def test_frames_with_times_wait_in_messages_of_their_own_within_other_bounds() -> None:
    """Put what a sound card of long cycles sends at once, and more."""
    dropped: list[m.Streamed] = []
    outbox = Outbox(dropped.append)
    messages = [
        structs.replace(frames(bytes(4 * m.MOST_FRAME_VALUES)), time_us=1000 * k)
        for k in range(MOST_TIMED + 2)
    ]
    for message in messages:
        outbox.put(message)
    assert dropped == messages[:2]
    assert outbox.take() == messages[2:]


@pytest.mark.parametrize("protocol", [m.JSON_PROTOCOL, m.MSGPACK_PROTOCOL])
def test_frames_that_are_joined_to_the_largest_message_are_not_too_large(protocol: str) -> None:
    """What is larger, a server does not read, and closes the connection."""
    outbox = Outbox(lambda message: None)
    for _ in range(m.MOST_FRAME_VALUES // 24):
        outbox.put(frames(bytes(4 * 24), display="d" * 64))
    (joined,) = outbox.take()
    encoding = ENCODINGS[protocol]
    data = websocket._Codec(protocol).encode(joined)
    text = data.decode() if encoding.kind == "text" else data
    assert read(text, encoding) == joined
    assert len(data) <= m.LARGEST_MESSAGE
