"""The SPIN model of `firmware_protocol/model`: what holds, what must not, and whether it is true.

SPIN visits every state that the model can reach. Each property is also checked on a model that was
broken, by a switch or by a cell of the table of states, and must then fail. Random traces of the
model are played on the amplifier in Python and on the one in C.
"""

import os
import re
import shutil
import subprocess
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from protocol_traces import CONFIGS, Rig, packet, replay

from firmware_protocol import generate
from firmware_protocol.messages import MESSAGES, State

MODEL = Path(generate.__file__).parent / "model"
MODEL_TEXT = (MODEL / "amplifier.pml").read_text()
LISTED = MODEL_TEXT.partition("/* Properties")[2].partition("#ifdef")[0]
PROPERTIES = {name: int(number) for name, number in re.findall(r"#define (\w+) (\d+) +/\*", LISTED)}
"""Number of each property, by its name in the model."""
SWITCHES = [
    (20, "ARMED_ONLY"), (20, "NO_RISE"), (12, "CLEAR_ONLY"), (2, "KNOWN_TRIPS"),
    (11, "KNOWN_TRIPS"), (15, "KNOWN_TRIPS"), (16, "KNOWN_TRIPS"), (8, "SETTLED_ONLY"),
    (9, "SETTLED_ONLY"), (18, "SETTLED_ONLY"), (3, "NO_TAKEOVER"), (4, "NO_TAKEOVER"),
    (1, "DEAD_MAN"), (6, "DEAD_MAN"), (13, "DEAD_MAN"), (17, "DEAD_MAN"), (10, "QUICK"),
    (21, "QUICK"), (5, "VOLTAGE"), (14, "VOLTAGE"), (7, "REPEATED"), (9, "OPEN_STOPS"),
    (19, "PLAYS_AGAIN"),
]  # fmt: skip
"""Switches that break the model (README.md), with a property that must fail."""
CELLS = [
    ("start", "IDLE", "RUNNING", "ARMED_ONLY"),
    ("disarm", "ESTOP", "IDLE", "CLEAR_ONLY"),
    ("arm", "FAULT", "ARMED", "CLEAR_ONLY"),
    ("fault", "RUNNING", "=", "CLEAR_ONLY"),
    ("estop", "RUNNING", "RAMPDOWN:IDLE", "CLEAR_ONLY"),
    ("hello_other", "ARMED", "=", "NO_TAKEOVER"),
    ("watchdog", "RUNNING", "=", "DEAD_MAN"),
    ("watchdog", "RAMPDOWN", "=", "DEAD_MAN"),
    ("arm", "RAMPDOWN", "ARMED", "AT_ZERO"),
    ("disarm", "RUNNING", "IDLE", "AT_ZERO"),
    ("estop_input", "FAULT", "=", "OPEN_STOPS"),
    ("arm", "ESTOP", "ARMED", "OPEN_REFUSES"),
    ("clear_fault", "ESTOP", "=", "PLAYS_AGAIN"),
    ("arm", "SAFE", "!STATE", "PLAYS_AGAIN"),
]
"""Cells of the table of states that are wrong, with a property that must fail."""
STEP, INPUT, FAULT, WATCHDOG, REST = 200, 201, 202, 203, 204
"""Events of a trace that are no messages."""
STEP_TICKS, REST_TICKS = 50_000, 25_000
NAMES = {kind: generate._upper(message.__name__) for kind, message in MESSAGES.items()}
ACTED = {1, 4, 5, 6, 7, 8, 9, 10, 11, 15}
"""Types of the messages that the model has."""
NAK, DONE = 0x41, 128


@pytest.fixture(scope="module", autouse=True)
def spin() -> None:
    """Skip without SPIN or gcc; where CI promises them their absence is a failure."""
    for tool in ("spin", "gcc"):
        if shutil.which(tool) is None:
            assert os.environ.get("CI") != "true", f"CI has no {tool}"
            pytest.skip(f"no {tool} on PATH (Debian: apt-get install {tool})")


def copied(at: Path, schema: generate.Schema | None = None) -> Path:
    """Return the model in a folder, with the table of a schema."""
    text = generate.promela_text(schema or generate.load())
    (at / "table.pml").write_text(text)
    (at / "amplifier.pml").write_text(MODEL_TEXT)
    return at


def checked(at: Path, *switches: str, optimize: str = "-O0", live: bool = False) -> str:
    """Return what SPIN reports of the model in a folder; ``live`` looks for cycles as well."""
    subprocess.run(
        ["spin", *switches, "-a", "amplifier.pml"], cwd=at, check=True, capture_output=True
    )
    kind = [] if live else ["-DSAFETY"]
    subprocess.run(
        ["gcc", "-w", optimize, *kind, "-DNOFAIR", "-o", "pan", "pan.c"], cwd=at, check=True
    )
    sizes = ["-m1000000", "-w24"] if optimize == "-O2" else ["-m300000", "-w20"]
    command = ["./pan", *(["-a"] if live else []), *sizes]
    done = subprocess.run(command, cwd=at, check=True, capture_output=True, text=True)
    return done.stdout


def assert_holds(report: str) -> None:
    """Check that the search has found no error, and that it was complete."""
    assert "errors: 0" in report
    assert "Search not completed" not in report
    assert "max search depth too small" not in report
    states = re.search(r"(\d+) states, stored", report)
    assert states is not None
    assert int(states[1]) > 500_000


def assert_fails(report: str, name: str) -> None:
    """Check that a property, which was the only one that was looked at, has failed."""
    number = PROPERTIES[name]
    assert f"assertion violated ((({number}!=0)&&({number}!={number}))" in report
    assert "errors: 1" in report


@pytest.mark.ci
def test_all_properties_hold_in_every_state(tmp_path: Path) -> None:
    report = checked(copied(tmp_path), optimize="-O2")
    assert_holds(report)
    unreached = re.findall(r"state \d+, \"(.*)\"", report)
    assert set(unreached) == {"-end-"}


@pytest.mark.ci
@pytest.mark.parametrize(("switch", "name"), SWITCHES)
def test_each_property_fails_when_the_model_is_broken(
    tmp_path: Path, switch: int, name: str
) -> None:
    only = f"-DONLY={PROPERTIES[name]}"
    assert_fails(checked(copied(tmp_path), f"-DBREAK={switch}", only), name)


@pytest.mark.ci
@pytest.mark.parametrize(("event", "state", "cell", "name"), CELLS)
def test_each_property_fails_when_the_table_is_wrong(
    tmp_path: Path, event: str, state: str, cell: str, name: str
) -> None:
    schema = deepcopy(generate.load())
    assert schema["table"][event][state] != cell
    schema["table"][event][state] = cell
    assert_fails(checked(copied(tmp_path, schema), f"-DONLY={PROPERTIES[name]}"), name)


@pytest.mark.ci
def test_the_host_always_plays_again(tmp_path: Path) -> None:
    copied(tmp_path)
    assert_holds(checked(tmp_path, "-DLIVENESS", optimize="-O2", live=True))
    hasty = checked(tmp_path, "-DLIVENESS", "-DBREAK=22", live=True)
    assert "acceptance cycle" in hasty
    assert "errors: 1" in hasty


@pytest.mark.ci
def test_a_late_arm_counts_after_an_estop(tmp_path: Path) -> None:
    """A limit of the protocol that README.md names: an ARM may be older than the ESTOP."""
    only = f"-DONLY={PROPERTIES['SENT_SINCE']}"
    assert_fails(checked(copied(tmp_path), "-DSTRICT", only), "SENT_SINCE")


def test_each_property_and_switch_is_tried() -> None:
    tried = {name for _, name in SWITCHES} | {name for *_, name in CELLS} | {"SENT_SINCE"}
    assert tried == set(PROPERTIES)
    numbers = {int(number) for number in re.findall(r"BREAK [!=]= (\d+)", MODEL_TEXT)}
    assert numbers == {number for number, _ in SWITCHES} | {22}


# Traces of the model, played on amplifiers


def traced(seed: int, at: Path) -> list[list[int]]:
    """Return the events of a random run: number, token, bits; then state, session, HV, answer."""
    command = ["spin", "-DPROMPT", "-T", f"-n{seed}", "-u30000", "amplifier.pml"]
    run = subprocess.run(command, cwd=at, check=True, capture_output=True, text=True)
    lines = (line.split() for line in run.stdout.splitlines())
    return [[int(word) for word in words[1:]] for words in lines if words and words[0] == "T"]


def data(rig: Rig, kind: int, token: int, bits: int) -> bytes:
    """Return the packet of an event."""
    fresh = rig.amplifier.counters.trips - (0 if bits & 2 else 1)
    fields = {
        "HELLO": (token, 1, 3, 0), "START": (token, (2 * token + (bits & 1)) << 20, 0, 0),
        "STOP": (token, 0), "ARM": (token, 0, 8000), "DISARM": (token,), "ESTOP": (1,),
        "CLEAR_FAULT": (token, fresh % (1 << 32)), "HEARTBEAT": (token,),
        "LIMITS": (token, 0, 0, 0), "POLL": (),
    }  # fmt: skip
    return packet(NAMES[kind], *fields[NAMES[kind]])


def stream(rig: Rig) -> None:
    """Send what is played for more than a step."""
    rig.amplifier.run(rig.now)
    for ahead in (1, 226):
        start = (rig.amplifier.position + ahead) % (1 << 32)
        body = np.full((2, 225), 20_000, "<i2").tobytes()
        rig.packet(packet("PCM", start, rig.amplifier.session, 0, 2, 0, 225, body=body))


def answered(sent: list[bytes]) -> int:
    """Return the code of the NAK among packets, or `DONE`."""
    codes = [one[6] for one in sent if one[0] == NAK]
    return codes[0] if codes else DONE


def act(rig: Rig, event: int, token: int, bits: int) -> int:
    """Do to an amplifier what an event did to the model, and return its answer."""
    if event == STEP:
        if rig.amplifier.state == State.RUNNING:
            stream(rig)
        rig.run((rig.now // STEP_TICKS + 1) * STEP_TICKS)
    elif event == REST:
        rig.run(rig.now + REST_TICKS)
    elif event == INPUT:
        rig.estop_input(bool(token))
    elif event == FAULT:
        rig.fault(token)
    elif event != WATCHDOG:
        before = len(rig.sent)
        rig.packet(data(rig, event, token, bits))
        return answered(rig.sent[before:])
    return 0


def followed(events: list[list[int]]) -> Rig:
    """Return an amplifier after a trace, in which it did what the model had done."""
    rig = Rig(CONFIGS["as shipped"])
    for (event, token, bits, *expected), following in zip(events, [*events[1:], [0]], strict=True):
        answer = act(rig, event, token, bits)
        a = rig.amplifier
        if following[0] != WATCHDOG:  # which the amplifier has done at the same tick
            assert [a.state, a.session, a.high_voltage, answer] == expected
    rig.run(rig.now + REST_TICKS)
    rig.end()
    return rig


def played(seed: int, at: Path, program: Path) -> list[list[int]]:
    """Play a random run on both amplifiers, and return its events."""
    events = traced(seed, at)
    rig = followed(events)
    out, sent = replay(program, rig.config, rig.records, at)
    same = out == rig.out() and sent == rig.sent
    assert same, f"seed {seed}"
    return events


def test_amplifiers_do_what_the_model_does(tmp_path: Path, virtual_amplifier: Path) -> None:
    assert len(played(0, copied(tmp_path), virtual_amplifier)) > 50


@pytest.mark.ci
def test_amplifiers_do_what_the_model_does_at_length(
    tmp_path: Path, virtual_amplifier: Path
) -> None:
    copied(tmp_path)
    events = [one for seed in range(1, 9) for one in played(seed, tmp_path, virtual_amplifier)]
    assert {event[3] for event in events} == set(State)
    assert set(NAMES) & {event[0] for event in events} == ACTED
    assert {STEP, INPUT, FAULT, WATCHDOG, REST} <= {event[0] for event in events}


def test_a_copy_of_arm_is_taken_after_an_estop() -> None:
    """Nobody has asked to arm since the ESTOP; hosts take another token (SPEC.md, 14, duty 7)."""
    rig = Rig(CONFIGS["as shipped"])
    arm = packet("ARM", 1, 0, 8000)
    for data in (packet("HELLO", 1, 1, 3, 0), arm, packet("ESTOP", 1)):
        rig.packet(data)
    rig.run(STEP_TICKS)
    rig.packet(packet("CLEAR_FAULT", 1, 1))
    assert rig.amplifier.state.name == "IDLE"
    rig.packet(arm)
    assert rig.amplifier.state.name == "ARMED"
    assert rig.amplifier.high_voltage
    rig.run(5 * STEP_TICKS)
    assert rig.amplifier.state.name == "SAFE"
