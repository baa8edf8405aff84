"""``tactile conform``: right amplifiers pass, wrong ones fail where they are wrong.

The amplifiers are those of `mock:`, whose time advances only while somebody waits. The mutants are
the reference with one fault each; the vectors that name the fault are chosen by hand from SPEC.md.
"""

import json
import socket
import threading
from pathlib import Path
from typing import Any

import pytest
from bus_benches import RealBench

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier, Refusal
from firmware_protocol.messages import NakCode, State
from firmware_protocol.packet import Packet
from tactile import devices
from tactile.bus.conform import conformance
from tactile.bus.conform.conformance import Conformance, ConformanceReport
from tactile.bus.conform.reference import (
    LATENESS,
    Expected,
    Judge,
    carried,
    config_of_caps,
    on_link,
)
from tactile.bus.conform.scenarios import load_scenarios
from tactile.bus.simulated import line_model
from tactile.bus.wire_time import Can, Unlimited
from tactile.cli.execution import execute
from tactile.errors import BusError, InputError

assert devices.KINDS  # registers the kinds
SCENARIOS = {scenario.id: scenario for scenario in load_scenarios()}


def report_on(
    monkeypatch: pytest.MonkeyPatch,
    names: str,
    amplifier: type[ReferenceAmplifier] = ReferenceAmplifier,
    url: str = "mock:",
) -> ConformanceReport:
    """Run some vectors against an amplifier in memory."""
    chosen = [SCENARIOS[name] for name in names.split()]
    monkeypatch.setattr(conformance, "load_scenarios", lambda: chosen)
    monkeypatch.setattr(line_model, "ReferenceAmplifier", amplifier)
    with Conformance(url) as test:
        return test.run()


def verdicts(report: ConformanceReport) -> dict[str, str]:
    return {result.id: result.verdict for result in report.results}


class WrongCode(ReferenceAmplifier):
    """Amplifier that tells BUSY where the state forbids a message."""

    def _forbidden(self, event: str, message: m.Message) -> Refusal | None:
        refusal = super()._forbidden(event, message)
        return refusal and refusal._replace(code=NakCode.BUSY)


class StateFirst(ReferenceAmplifier):
    """Amplifier that checks the state before the session."""

    def _owned(self, message: m.Message) -> bool:
        return self.state not in (State.RUNNING, State.RAMPDOWN) or super()._owned(message)

    def _forbidden(self, event: str, message: m.Message) -> Refusal | None:
        refusal = super()._forbidden(event, message)
        owned = super()._owned(message)
        return refusal if refusal or owned else None


class Uncounted(ReferenceAmplifier):
    """Amplifier that does not count messages of other sessions."""

    def receive(self, packet: Packet, now: int) -> None:
        before = self.counters.foreign_session
        super().receive(packet, now)
        self.counters.foreign_session = before


class Unstoppable(ReferenceAmplifier):
    """Amplifier that acknowledges STOP and plays on."""

    def _to(self, cell: int) -> bool:
        stops = cell == m.TABLE["stop"][State.RUNNING] and self.state == State.RUNNING
        return False if stops else super()._to(cell)


class Displaced(ReferenceAmplifier):
    """Amplifier whose armed owner is displaced by any HELLO."""

    def _forbidden(self, event: str, message: m.Message) -> Refusal | None:
        return None if isinstance(message, m.Hello) else super()._forbidden(event, message)


class Unwatched(ReferenceAmplifier):
    """Amplifier without a watchdog."""

    def _watchdog(self) -> None:
        self._heartbeat = None


MUTANTS: list[tuple[type[ReferenceAmplifier], str, str]] = [
    (WrongCode, "state-start-idle state-arm-estop state-start-estop", "state-stop-idle get-set"),
    (StateFirst, "order-session-state", "state-arm-idle state-stop-idle"),
    (Uncounted, "check-session", "state-arm-idle"),
    (Unstoppable, "stop-bridge", "state-arm-idle state-stop-idle"),
    (Displaced, "state-hello-armed state-hello-running order-busy-version", "state-hello-idle"),
    (Unwatched, "state-watchdog-armed hello-after-watchdog", "state-arm-armed"),
]


@pytest.mark.parametrize(("mutant", "caught", "not_caught"), MUTANTS)
def test_a_mutant_fails_where_it_is_wrong(
    mutant: type[ReferenceAmplifier], caught: str, not_caught: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = verdicts(report_on(monkeypatch, f"{caught} {not_caught}", mutant))
    assert [name for name, verdict in results.items() if verdict == "failed"] == caught.split()
    assert {results[name] for name in not_caught.split()} == {"passed"}
    right = verdicts(report_on(monkeypatch, f"{caught} {not_caught}"))
    assert set(right.values()) == {"passed"}


def test_what_failed_is_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    (result,) = report_on(monkeypatch, "state-start-idle", WrongCode).results
    assert result.expected == "message 2: NAK (type 4, seq 2, state IDLE, detail 0, code NOT_ARMED)"
    assert result.got == "message 2: NAK (type 4, seq 2, state IDLE, detail 0, code BUSY)"


@pytest.mark.ci
@pytest.mark.parametrize("link", ["serial", "can", "canfd", "i2c"])
def test_a_right_amplifier_passes_on_every_link(link: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than a hundred vectors apply: 130 on a serial line at the time of writing."""
    report = report_on(monkeypatch, " ".join(SCENARIOS), url=f"mock:?link={link}")
    assert report.conforms, report.summary
    assert report.counts["passed"] > 100
    assert len(report.results) == len(SCENARIOS)
    assert all(r.reason for r in report.results if r.verdict == "not applicable")


def test_the_reason_names_what_does_not_apply() -> None:
    config = config_of_caps(caps_of_mock(), 1, 0)
    judge = Judge(config, senses=False, link=Unlimited())
    reasons = {name: judge.judge(SCENARIOS[name]) for name in (
        "state-fault-idle", "state-estop-input-idle", "pulse-cadence", "check-crc", "caps",
        "limit-hardware", "watchdog-exact", "pcm-format-not-offered",
    )}  # fmt: skip
    assert reasons == {
        "state-fault-idle": "needs a fault of the hardware",
        "state-estop-input-idle": "needs the e-stop input to be moved",
        "pulse-cadence": "is about the times of PULSE, which a link changes",
        "check-crc": "needs a damaged packet, which this host does not send",
        "caps": "needs an amplifier that was just powered up",
        "limit-hardware": "another configuration: needs voltage_limit_uv 60000000, not 100000000",
        "watchdog-exact": "depends on exact times",
        "pcm-format-not-offered": "another configuration: needs formats 1, not 15",
    }


def caps_of_mock() -> m.Caps:
    with Conformance("mock:") as test:
        return test.caps


def test_what_depends_on_time_is_left_open() -> None:
    """The position after START is that of START; the tick of SYNC is nobody's."""
    judge = Judge(config_of_caps(caps_of_mock(), 1, 0), senses=False, link=Unlimited())
    expected = judge.judge(SCENARIOS["clock-sync"])
    assert isinstance(expected, Expected)
    assert expected.late == LATENESS[0]
    named = {name for answer in expected.answers for name in answer.fields}
    assert "sync_index" in named
    assert "sync_time" not in named


def test_a_packet_of_another_node_and_a_prompt_frame_are_what_can_carries() -> None:
    heartbeat = Packet.of(m.Heartbeat(7), node=1, seq=9, ask=True)
    (arriving,) = carried(heartbeat, Can(1e6, None))
    assert (arriving.payload, arriving.flags, arriving.seq) == (heartbeat.payload, 0x40, 0)
    assert carried(heartbeat, Unlimited()) == [heartbeat]
    steps = SCENARIOS["state-estop-idle"].steps
    left = on_link(SCENARIOS["state-estop-idle"], Can(1e6, None)).steps
    assert [len(s.answers) for s in steps] == [1, 1, 1]
    assert [len(s.answers) for s in left] == [1, 0, 1]


# Amplifiers that do not take part


class Mute(ReferenceAmplifier):
    """Amplifier that never answers."""

    def receive(self, packet: Packet, now: int) -> None:
        """Ignore a packet."""


class Hanging(ReferenceAmplifier):
    """Amplifier that hangs at its first ESTOP."""

    def receive(self, packet: Packet, now: int) -> None:
        """Act on a packet until an ESTOP comes."""
        if packet.type != m.Estop.TYPE and not self.counters.trips:
            super().receive(packet, now)
        else:
            self.counters.trips += 1


class Bounced(ReferenceAmplifier):
    """Amplifier on which a person presses the e-stop at START."""

    def receive(self, packet: Packet, now: int) -> None:
        """Act on a packet, and open the contact after START."""
        super().receive(packet, now)
        if packet.type == m.Start.TYPE:
            self.estop_input(True, now)


def test_a_mute_amplifier_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BusError, match=r"^mock:: no answer to HELLO within 0\.75 s$"):
        report_on(monkeypatch, "get-set", Mute)


def test_an_amplifier_that_answers_garbage_is_one_line() -> None:
    """Three answers come to the first HELLO, each a frame with a wrong CRC-32."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))

        def answer() -> None:
            address = server.recvfrom(4096)[1]
            for _ in range(3):
                server.sendto(b"\x0agarbage!!\0", address)

        thread = threading.Thread(target=answer)
        thread.start()
        url = f"udp:127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(BusError, match=r"no valid answer to HELLO: 3 packets that came were"):
            Conformance(url)
        thread.join()


def test_an_amplifier_that_hangs_ends_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    report = report_on(monkeypatch, "get-set state-estop-idle state-arm-idle", Hanging)
    assert list(verdicts(report).values()) == ["passed", "failed", "not run"]
    assert report.summary == (
        "no answer to HELLO within 0.75 s, after state-estop-idle; the amplifier does not answer "
        "STOP and DISARM: switch it off; 1 passed, 1 failed, 1 not run"
    )
    assert not report.conforms


def test_an_e_stop_of_a_person_is_never_cleared(monkeypatch: pytest.MonkeyPatch) -> None:
    report = report_on(monkeypatch, "state-start-armed state-arm-idle", Bounced)
    assert list(verdicts(report).values()) == ["failed", "not run"]
    assert "not because of an ESTOP of this test (reason 255, fault 0)" in report.ended


def test_an_interrupt_leaves_the_amplifier_disarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The interrupt comes in the third vector, while the amplifier is armed."""
    made: list[ReferenceAmplifier] = []

    class Interrupted(ReferenceAmplifier):
        """Amplifier whose user presses Ctrl-C once it runs."""

        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(self)

        def receive(self, packet: Packet, now: int) -> None:
            """Act on a packet, and interrupt after the first START."""
            super().receive(packet, now)
            if packet.type == m.Start.TYPE and self.state == State.RUNNING and len(made) == 1:
                made.append(self)
                raise KeyboardInterrupt

    report = report_on(monkeypatch, "get-set state-start-armed state-arm-idle", Interrupted)
    assert list(verdicts(report).values()) == ["passed", "not run", "not run"]
    assert report.interrupted
    assert "interrupted; the amplifier was stopped and disarmed" in report.summary
    assert made[0].state in (State.IDLE, State.SAFE)
    assert not made[0].high_voltage


def test_a_link_that_is_too_late_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two delays of 60 ms each, in the mean, are beyond all bounds."""
    monkeypatch.setattr(conformance, "ATTEMPTS", 1)
    report = report_on(monkeypatch, "state-arm-idle", url="mock:?link=serial&delay_ms=60&seed=3")
    (result,) = report.results
    assert result.reason == "the link or this computer is later than 50 ms"
    assert report.summary == "no vector applies to this amplifier: nothing was tested"


def test_a_device_without_packets_is_refused() -> None:
    with pytest.raises(InputError, match="carries no packets"):
        Conformance("sim:")


# Against the C amplifier, and by the command


@pytest.mark.realtime
def test_the_c_amplifier_conforms(virtual_amplifier: Path, tmp_path: Path) -> None:
    """132 vectors apply; a machine that stands still makes steps late, which leaves some out."""
    bench = RealBench("pty", virtual_amplifier, tmp_path)
    try:
        _, path = bench.pty(24)
        with Conformance(f"serial://{path}") as test:
            report = test.run()
    finally:
        bench.reset()
    assert report.conforms, report.summary
    assert report.counts["passed"] > 80, report.summary


def test_the_command_prints_and_writes_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = [SCENARIOS[name] for name in ("state-arm-idle", "pcm-one-channel", "check-session")]
    monkeypatch.setattr(conformance, "load_scenarios", lambda: chosen)
    page = tmp_path / "report.html"
    assert execute(["conform", "mock:", "--report", str(page)]) == 0
    printed = capsys.readouterr()
    assert printed.err == (
        "switches the high voltage on and plays up to 100 V: keep away from the contactors\n"
    )
    assert "conforms to 1.4: 2 vectors apply and passed" in printed.out
    assert "depends on exact times" in printed.out
    text = page.read_text("utf-8")
    assert "conforms to 1.4" in text
    assert "the e-stop input: opening" in text
    assert execute(["conform", "mock:", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["counts"] == {"passed": 2, "not applicable": 1}
    monkeypatch.setattr(line_model, "ReferenceAmplifier", Uncounted)
    assert execute(["conform", "mock:"]) == 1
    assert "does not conform to 1.4: 1 of 2 vectors that apply failed" in capsys.readouterr().out
    monkeypatch.setattr(line_model, "ReferenceAmplifier", Mute)
    assert execute(["conform", "mock:"]) == 2
    assert capsys.readouterr().err == "tactile: mock:: no answer to HELLO within 0.75 s\n"
