"""Windows of CORRELATION are the sums that section 16 of SPEC.md defines, of what was put out.

Streams with gaps, limits and changes of the parameters are played on an amplifier with capacitors
behind it. What it sends is compared with sums over what it put out, in Python's own integers, and
with what the amplifier in C sends on the same trace.
"""

import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c_amplifier_rig import SOURCE, compiler
from measuring_scene import (
    CORRELATION_MS,
    MEASURES,
    NAK,
    OWNER,
    SENSE_MS,
    SENSE_RANGE_UA,
    VALUE,
    Entry,
    Scene,
    rounded,
)
from protocol_traces import CONFIGS, LOADS_PF, Loads, replay

from firmware_protocol import correlation
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.messages import LAGS, Feature, State
from firmware_protocol.packet import Packet, encode_packet


def packets_of(window: tuple[int, int, int, list[Entry]], group: int) -> list[m.Correlation]:
    """Return the messages of a window, with so many channels each."""
    position, range_ua, length, entries = window
    messages = []
    for first in range(0, len(entries), group):
        part = entries[first : first + group]
        body = b"".join(
            struct.pack("<BBH16h", e.flags, e.exponent, e.energy, *e.sums) for e in part
        )
        messages.append(m.Correlation(position, range_ua, length, first, len(part), 16, body))
    return messages


def eventful(seed: int, late: int) -> Scene:
    """Return a scene with all that may befall windows, with currents late by some instants."""
    scene = Scene(replace(MEASURES, current_delay=late), seed=seed)
    scene.set(CORRELATION_MS, 25)
    scene.start(2**32 - 57, delay_ms=7)
    scene.stream(130)
    scene.stream(150, gaps=0.4)
    scene.set(SENSE_RANGE_UA, 300)
    scene.stream(60)
    scene.set(CORRELATION_MS, 10)
    scene.stream(71)
    scene.set(CORRELATION_MS, 0)
    scene.stream(31)
    scene.set(SENSE_RANGE_UA, 65535)
    scene.set(CORRELATION_MS, 33)
    scene.stream(90, loud=300)
    scene.tell("STOP", OWNER, 0)
    scene.wait(40)
    scene.start(1000, delay_ms=5)
    scene.stream(80)
    scene.tell("ESTOP", 1)
    scene.wait(60)
    scene.rig.end()
    return scene


@pytest.mark.parametrize(("seed", "late"), [(0, 0), (1, 0), (2, 3), (3, 60)])
def test_windows_are_the_sums_of_what_was_put_out(
    seed: int, late: int, virtual_amplifier: Path, tmp_path: Path
) -> None:
    """The packet limit of 140 leaves room for 3 channels in a packet: 19 + 3 × 36 = 127."""
    scene = eventful(seed, late)
    expected = [message for window in scene.windows() for message in packets_of(window, 3)]
    assert scene.sent() == expected
    counters = scene.rig.amplifier.counters
    assert counters.underruns > 0
    assert counters.limited_samples > 0
    entries = np.frombuffer(b"".join(w.entries for w in expected), correlation.ENTRY)
    assert set(entries["flags"].tolist()) == {0, 1}
    assert len(set(entries["exponent"].tolist())) > 5
    assert {(w.samples, w.range_ua) for w in expected} == {
        (50, 2500), (50, 300), (20, 300), (66, 65535),
    }  # fmt: skip
    out, sent = replay(virtual_amplifier, scene.rig.config, scene.rig.records, tmp_path)
    assert scene.rig.out() == out
    assert scene.rig.sent == sent


def test_windows_follow_each_other_from_the_position_of_start_on() -> None:
    """One begins where the last one ended; the one under way at STOP is not sent."""
    scene = Scene()
    scene.set(CORRELATION_MS, 10)
    scene.start(500, delay_ms=3)
    scene.stream(105)
    scene.tell("STOP", OWNER, 0)
    scene.wait(60)
    whole = [w.position for w in scene.sent() if w.first_channel == 0]
    assert whole == list(range(500, 500 + 20 * 10, 20))
    scene.start(9000)
    scene.wait(31)
    later = [w.position for w in scene.sent() if w.first_channel == 0][len(whole) :]
    assert later == [9000, 9020, 9040]


def test_a_set_to_the_value_in_force_changes_nothing() -> None:
    """A request that is repeated does not begin a window anew."""
    scene = Scene()
    scene.set(CORRELATION_MS, 20)
    scene.start(0)
    for _ in range(9):
        scene.wait(7)
        scene.tell("SET", OWNER, CORRELATION_MS, 20)
        scene.tell("SET", OWNER, SENSE_RANGE_UA, 2500)
    assert [w.position for w in scene.sent() if w.first_channel == 0] == [0, 40, 80]


def test_another_session_gets_no_windows_unless_it_asks() -> None:
    """The token in force changes nothing; the range stays in any case."""
    scene = Scene()
    scene.set(CORRELATION_MS, 20)
    scene.set(SENSE_RANGE_UA, 300)
    for session in (OWNER, 0, 0x4321):
        scene.tell("HELLO", session, 1, 0, 0)
        scene.tell("GET", CORRELATION_MS)
    scene.tell("GET", SENSE_RANGE_UA)
    assert [struct.unpack("<HI", v) for v in answers(scene, VALUE)] == [
        (8, 20), (8, 20), (8, 0), (9, 300),
    ]  # fmt: skip


def test_nothing_is_sent_unless_it_is_asked_for() -> None:
    scene = Scene()
    scene.start(0)
    scene.stream(120)
    assert scene.sent() == []


def test_a_window_is_no_longer_than_its_count_can_tell() -> None:
    """100 ms at 1 MHz would be 100 000 samples."""
    assert correlation.window_samples(100, 1_000_000) == 65535
    assert correlation.window_samples(100, 655_350) == 65535
    assert correlation.window_samples(25, 8000) == 200
    assert correlation.window_samples(33, 1049) == 34


def test_the_largest_sums_fit() -> None:
    """65 535 samples at both ends of all ranges: the exponents are 32 and 37, and not more."""
    codes = np.resize(np.array([32767, -32767]), (65535, 1)).astype(np.int64)
    (window,) = correlation.Correlator(1).add(0, codes, codes, 65535)
    (entry,) = np.frombuffer(window.entries, correlation.ENTRY)
    total = 32767 * 32767 + 65534 * 32767 * 65534
    assert entry["exponent"] == 32
    assert entry["sums"][0] == rounded(total, 32) == 32765
    assert entry["energy"] == 37 << 10 | rounded(65535 * 32767**2, 37)
    assert correlation.decode(m.Correlation(0, 1, 65535, 0, 1, 16, window.entries)) is not None


# Parameters and features


def answers(scene: Scene, kind: int) -> list[bytes]:
    return [p[4:-4] for p in scene.rig.sent if p[0] == kind]


def test_parameters_of_an_amplifier_that_measures() -> None:
    scene = Scene()
    for value in (1, 9, 101, 2**32 - 1):
        scene.tell("SET", OWNER, CORRELATION_MS, value)
    for value in (0, 301, 2499, 2500 + 65536):
        scene.tell("SET", OWNER, SENSE_RANGE_UA, value)
    naks = [struct.unpack("<BBBBI", n)[2:] for n in answers(scene, NAK)]
    assert naks == [(m.NakCode.RANGE, State.IDLE, 2)] * 8
    scene.tell("SET", OWNER, CORRELATION_MS, 100)
    scene.tell("SET", OWNER, SENSE_RANGE_UA, 300)
    for parameter in (SENSE_MS, CORRELATION_MS, SENSE_RANGE_UA):
        scene.tell("GET", parameter)
    assert [struct.unpack("<HI", v) for v in answers(scene, VALUE)] == [(3, 0), (8, 100), (9, 300)]


@pytest.mark.parametrize(
    ("config", "measured", "features"),
    [
        (MEASURES, True, Feature.SENSES | Feature.CORRELATES | Feature.GUARDS),
        (CONFIGS["as shipped"], True, Feature.SENSES),
        (MEASURES, False, 0),
    ],
)
def test_caps_tells_what_is_measured(
    config: AmplifierConfig, measured: bool, features: int
) -> None:
    """What is not measured has no parameters: NAK PARAMETER, its id."""
    amplifier = ReferenceAmplifier(config, Loads(MEASURES) if measured else None)
    for message in (m.Hello(OWNER, 1), *(m.Get(p) for p in (3, 8, 9))):
        amplifier.receive(Packet.of(message, node=1, ask=True), 0)
    found = [m.MESSAGES[p.type].unpack(p.payload) for p in amplifier.take_sent()]
    caps = found[0]
    assert isinstance(caps, m.Caps)
    assert caps.features == features | Feature.ESTOP_INPUT
    has = [bool(features & Feature.SENSES), *[bool(features & Feature.CORRELATES)] * 2]
    assert [isinstance(answer, m.Value) for answer in found[1:]] == has
    refused = [a.detail for a in found[1:] if isinstance(a, m.Nak)]
    assert refused == [p for p, there in zip((3, 8, 9), has, strict=True) if not there]


@pytest.mark.parametrize(
    ("limit", "channels"), [(136, 3), (140, 3), (163, 4), (451, 12), (4096, 12)]
)
def test_as_many_channels_as_the_packet_limit_allows(limit: int, channels: int) -> None:
    """Twelve at most: 8 + 11 + 12 × 36 = 451 bytes."""
    assert correlation.group_of(limit) == channels
    (first, *_) = correlation.messages_of(
        correlation.CompleteWindow(5, 20, bytes(36 * 13)), 2500, limit
    )
    assert first.channels == channels
    assert len(encode_packet(Packet.of(first))) <= limit


def test_sense_tells_the_latest_instant_in_python_and_c(
    virtual_amplifier: Path, tmp_path: Path
) -> None:
    """Intervals of 33 ms at 2 kHz, off and on again, in the same bytes as C sends."""
    scene = Scene(seed=4)
    scene.start(77)
    scene.tell("SET", OWNER, SENSE_MS, 33)
    scene.stream(120)
    scene.tell("SET", OWNER, SENSE_MS, 0)
    scene.stream(50)
    scene.tell("SET", OWNER, SENSE_MS, 10)
    scene.stream(25)
    scene.rig.end()
    senses = [p for p in scene.rig.sent if p[0] == 0x47]
    assert len(senses) == 4 + 3
    _, sent = replay(virtual_amplifier, MEASURES, scene.rig.records, tmp_path)
    assert scene.rig.sent == sent
    assert LOADS_PF[0] > 0
    assert any(struct.unpack("<h", p[12:14])[0] for p in senses)


# The host's side


def message(**changed: object) -> m.Correlation:
    """Return a valid CORRELATION of two channels, in which some fields are changed."""
    entries = np.zeros(2, correlation.ENTRY)
    entries["exponent"], entries["sums"], entries["energy"] = (3, 0), 7, 2 << 10 | 600
    fields = {
        "position": 5, "range_ua": 2500, "samples": 200, "first_channel": 0, "channels": 2,
        "lags": 16, "entries": entries.tobytes(),
    }  # fmt: skip
    return m.Correlation(**(fields | changed))  # type: ignore[arg-type]


def test_entries_are_decoded() -> None:
    found = correlation.decode(message())
    assert found is not None
    assert found.sums.tolist() == [[56] * LAGS, [7] * LAGS]
    assert found.energy.tolist() == [2400, 2400]
    assert found.flags.tolist() == [0, 0]


def test_bytes_of_a_later_version_are_ignored() -> None:
    """An entry may grow at its end; all grow alike."""
    whole = message().entries
    longer = whole[:36] + b"abc" + whole[36:] + b"def"
    found, same = correlation.decode(message(entries=longer)), correlation.decode(message())
    assert found is not None
    assert same is not None
    assert np.array_equal(found.sums, same.sums)


@pytest.mark.parametrize(
    "changed",
    [
        {"range_ua": 0}, {"samples": 0}, {"channels": 0}, {"channels": 0, "entries": b""},
        {"lags": 0}, {"lags": 15}, {"lags": 17}, {"channels": 3}, {"channels": 4},
        {"entries": b""}, {"entries": message().entries[:-1]},
        {"entries": message().entries + b"1"},
        {"entries": b"\0\x21" + message().entries[2:]},
        {"entries": b"\0\0\0\xff" + message().entries[4:]},
    ],
    ids=repr,
)  # fmt: skip
def test_what_cannot_be_is_not_decoded(changed: dict[str, object]) -> None:
    """Counts, lengths and exponents: 33 of the sums, 63 of the energy."""
    assert correlation.decode(message()) is not None
    assert correlation.decode(message(**changed)) is None


# The amplifier in C


@pytest.mark.parametrize("option", ["", "0", "2500,", ",1", "65536", "1,2,3,4,5,6,7,8,9", "2.5"])
def test_ranges_that_the_virtual_amplifier_does_not_take(
    virtual_amplifier: Path, option: str
) -> None:
    command = [str(virtual_amplifier), "--replay", "--sense-ranges-ua", option]
    done = subprocess.run(command, input=b"", capture_output=True, check=False)
    assert (done.returncode, b"--sense-ranges-ua" in done.stderr) == (1, True)


@pytest.mark.ci
def test_an_amplifier_may_be_built_without_windows(tmp_path: Path) -> None:
    """A board with TA_CORRELATES 0 has neither feature nor parameters, whatever its HAL has."""
    folder = tmp_path / "build"
    command = ["make", "-C", str(SOURCE), f"BUILD={folder}", f"CC={compiler()}"]
    subprocess.run(
        [*command, "CFLAGS=-O1 -DTA_CORRELATES=0", "virtual-amplifier"],
        check=True, capture_output=True,
    )  # fmt: skip
    scene = Scene()
    for parameter in (SENSE_MS, CORRELATION_MS, SENSE_RANGE_UA):
        scene.tell("GET", parameter)
    scene.rig.end()
    _, sent = replay(folder / "virtual-amplifier", MEASURES, scene.rig.records, tmp_path)
    caps, value, *naks = [m.MESSAGES[p[0]].unpack(p[4:-4]) for p in sent if p[0] != 0x45]
    assert isinstance(caps, m.Caps)
    assert caps.features == Feature.SENSES | Feature.ESTOP_INPUT
    assert value == m.Value(SENSE_MS, 0)
    assert [n.detail for n in naks if isinstance(n, m.Nak)] == [CORRELATION_MS, SENSE_RANGE_UA]
