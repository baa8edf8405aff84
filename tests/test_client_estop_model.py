"""No schedule of calls, losses and late answers arms against the user, or loses an e-stop.

A session with its outbox is driven by a random schedule; the server is a few lines that latch. What
must hold is asserted where a message is handed over or sent.
"""

from concurrent.futures import Future
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from repeating import often

from tactile import messages as m
from tactile.client.outbox import Outbox
from tactile.client.session import ClientSession
from tactile.clock import ModelClock
from tactile.errors import ClientError, DisconnectedError

DISPLAYS = ("left", "right")
displays = st.sampled_from(DISPLAYS)
all_or_one = st.sampled_from((None, *DISPLAYS))


def of(display: str | None) -> tuple[str, ...]:
    return DISPLAYS if display is None else (display,)


class Schedule(RuleBasedStateMachine):
    """A program, its session, a connection that may be lost, and a server that answers late."""

    def __init__(self) -> None:
        super().__init__()
        self.outbox = Outbox(lambda message: None)
        self.session = ClientSession(
            self, m.ClientHello(client="test"), clock=ModelClock(), rearm=True
        )
        self.futures: list[Future[Any]] = []
        self.handed: dict[int, int] = {}  # place in the order by id
        self.unarmed: set[str] = set(DISPLAYS)  # where nobody wishes to be armed
        self.overtaken: set[int] = set()  # ids of what may not be sent any more
        self.waiting: list[Any] = []  # requests in the order in which they were handed over
        self.owed: dict[str | None, int] = {}  # e-stops, each with the place of its last call
        self.linked = self.refusing = False
        self.numbers = dict.fromkeys(DISPLAYS, 0)

    # The transport

    is_local = True

    def open(self, session: ClientSession) -> None:
        raise NotImplementedError

    def close(self) -> "Future[None]":
        raise NotImplementedError

    def send(self, command: Any) -> None:
        assert not (isinstance(command, m.ArmDisplay) and command.display in self.unarmed)
        if isinstance(command, m.EStop):
            self.first.discard(command.display)
        else:
            assert not self.first, "an e-stop that is owed is handed over first"
        self.handed[command.id] = len(self.handed)
        self.waiting.append(command)
        self.outbox.put(command)

    # The network

    @precondition(lambda self: not self.linked)
    @rule()
    def connect(self) -> None:
        self.linked = True
        self.outbox.clear()
        self.batch: list[Any] = []
        self.answers: list[Any] = []
        self.sent: list[Any] = []
        self.due: set[str | None] = set()
        self.first: set[str | None] = set()
        self.session.say_hello()

    @precondition(lambda self: self.linked)
    @rule()
    def lose(self) -> None:
        self.linked = False
        self.outbox.clear()
        self.session.lost("gone")

    @precondition(lambda self: self.linked)
    @rule()
    def carry(self) -> None:
        """Send the next message, or fetch what is to be sent next."""
        if not self.batch:
            self.batch = self.outbox.take()
            return
        command = self.batch.pop(0)
        if not self.session.is_pending(command):
            return
        assert command.id not in self.overtaken
        assert isinstance(command, m.ClientHello) == (not self.sent), "hello is first, and once"
        if isinstance(command, m.EStop):
            self.due.discard(command.display)
        else:
            assert not self.due, "an e-stop that is owed comes first"
        self.sent.append(command)
        self.answers.append(self.server(command))

    @precondition(lambda self: self.linked and self.answers)
    @rule(data=st.data())
    def answer(self, data: st.DataObject) -> None:
        self.deliver(data.draw(st.integers(0, len(self.answers) - 1)))

    def deliver(self, index: int) -> None:
        command, answer = self.answers.pop(index)
        if isinstance(answer, m.Welcome):
            self.due, self.first = set(self.owed), set(self.owed)
            for info in answer.displays:
                if info.estop:
                    self.unarmed.add(info.name)
        confirmed = isinstance(command, m.EStop) and isinstance(answer, m.Done)
        if confirmed and self.handed[command.id] >= self.owed.get(command.display, 0):
            self.owed.pop(command.display, None)
        if isinstance(answer, m.EventMessage):
            self.unarmed.add(answer.display)
        self.session.received(answer)

    @precondition(lambda self: self.linked)
    @rule(turns=st.integers(1, 30))
    def settle(self, turns: int) -> None:
        """Send, and answer in order, as long as nothing goes wrong."""
        for _ in range(turns):
            self.carry()
            if self.answers:
                self.deliver(0)

    # The server

    def server(self, command: Any) -> tuple[Any, Any]:
        answer: Any = m.Done(id=command.id)
        match command:
            case m.ClientHello():
                answer = welcome(command, self.numbers)
            case m.EStop() if self.refusing:
                answer = m.Failure(id=command.id, code="internal", message="no")
            case m.EStop():
                self.numbers.update({name: self.numbers[name] + 1 for name in of(command.display)})
                answer = m.Done(id=command.id, estops=dict(self.numbers))
            case m.ArmDisplay() if self.numbers[command.display]:
                answer = m.Failure(id=command.id, code="estopped", message="no")
            case m.ClearEstop() if self.numbers[command.display] == command.estop:
                self.numbers[command.display] = 0
        return command, answer

    @precondition(lambda self: self.linked and self.sent)
    @rule(display=displays, kind=st.sampled_from(("estopped", "disarmed", "lost")))
    def happen(self, display: str, kind: str) -> None:
        self.answers.append((None, m.EventMessage(display=display, kind=kind, estop=9)))

    @rule(refusing=st.booleans())
    def refuse(self, refusing: bool) -> None:
        self.refusing = refusing

    # The program

    def ask(self, request: m.Request) -> bool:
        try:
            self.futures.append(self.session.request(request))
        except DisconnectedError:
            return False
        return True

    @rule(display=displays)
    def arm(self, display: str) -> None:
        before = set(self.unarmed)
        self.unarmed.discard(display)
        if not self.ask(m.ArmDisplay(display=display)):
            self.unarmed = before

    @rule(display=displays, kind=st.sampled_from((m.Resume, m.StopPlaying)))
    def play(self, display: str, kind: Any) -> None:
        self.ask(kind(display=display))

    @rule(display=displays, number=st.integers(1, 3))
    def clear(self, display: str, number: int) -> None:
        self.ask(m.ClearEstop(display=display, estop=number))

    @rule(display=displays)
    def disarm(self, display: str) -> None:
        self.withdraw((display,), m.ArmDisplay)
        self.ask(m.DisarmDisplay(display=display))

    @rule(display=all_or_one)
    def estop(self, display: str | None) -> None:
        self.withdraw(of(display), m.ArmDisplay | m.ClearEstop | m.Resume)
        self.owed[display] = len(self.handed)
        assert self.ask(m.EStop(display=display)) == self.session.connected

    def withdraw(self, names: tuple[str, ...], kinds: Any) -> None:
        self.unarmed.update(names)
        raising = [c for c in self.waiting if isinstance(c, kinds) and c.display in names]
        self.overtaken.update(command.id for command in raising)

    @precondition(lambda self: self.futures)
    @rule(data=st.data())
    def give_up(self, data: st.DataObject) -> None:
        self.futures.pop(data.draw(st.integers(0, len(self.futures) - 1))).cancel()

    def teardown(self) -> None:
        """Let the server be back for good: each e-stop that is owed is latched."""
        owed = {name for display in self.owed for name in of(display)}
        self.refusing = False
        if self.linked:
            self.lose()
        self.connect()
        self.settle(3 * len(self.handed) + 50)
        assert self.owed == {}
        assert all(self.numbers[name] for name in owed)


def welcome(hello: m.ClientHello, numbers: dict[str, int]) -> m.Welcome:
    infos = tuple(
        m.DisplayDescription(
            name=name, contactors_mm=(), shear_direction_deg=(), sample_rate_hz=8000.0,
            voltage_limit_v=100.0, waveforms=True, latency_ms=4.0, estop=number,
        )
        for name, number in numbers.items()
    )  # fmt: skip
    return m.Welcome(
        id=hello.id, server="test", version=1, session="s", displays=infos, may_arm=True, time_us=0
    )


def test_no_schedule_arms_against_the_user_or_loses_an_estop() -> None:
    run_state_machine_as_test(Schedule, settings=settings(max_examples=150, stateful_step_count=60))


@pytest.mark.ci
def test_no_schedule_of_many_does() -> None:
    run_state_machine_as_test(
        Schedule, settings=settings(max_examples=often(1500), stateful_step_count=100)
    )


def test_the_schedule_reaches_a_display_that_is_armed_again() -> None:
    """The schedule would otherwise hold for nothing."""
    schedule = Schedule()
    schedule.connect()
    schedule.settle(20)
    schedule.arm("left")
    schedule.settle(20)
    schedule.lose()
    schedule.connect()
    schedule.settle(20)
    assert [type(said) for said in schedule.sent] == [m.ClientHello, m.ArmDisplay]
    schedule.arm("right")
    schedule.estop("right")
    with pytest.raises(ClientError, match=r"arm: withdrawn by estop\(\) meanwhile"):
        schedule.futures[-2].result(0)
    schedule.settle(20)
    assert [type(said) for said in schedule.sent] == [m.ClientHello, m.ArmDisplay, m.EStop]
