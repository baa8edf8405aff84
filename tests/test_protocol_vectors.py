"""The vectors of firmware_protocol, through the implementation in Python.

`firmware_protocol/vectors/README.md` says what a vector means. They are written from SPEC.md alone:
where one fails, the implementation is wrong or SPEC.md is, and the vector is only changed together
with it.
"""

import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest
from vectors_rig import (
    FILES,
    PROTOCOL,
    VECTORS,
    Instants,
    Output,
    Vector,
    check_answers,
    check_last_pulse,
    check_output,
    check_pulses,
    config_of,
    counted,
    framed,
    load,
    same_prompt,
    told,
    vectors,
    whole,
)

from firmware_protocol import correlation, guard, samples, spectrum
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.can_link import CanDecoder, CanEncoder
from firmware_protocol.capabilities import caps_fault
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.i2c_link import I2cTarget, SmbusTarget
from firmware_protocol.messages import MESSAGES
from firmware_protocol.packet import LinkCounters, Packet, decode_packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame

# The files


@pytest.mark.ci
@pytest.mark.parametrize("name", FILES)
def test_follows_the_schema(name: str) -> None:
    schema = load("schema")
    jsonschema.Draft202012Validator.check_schema(schema)
    # the definition of this file: its errors name the vector, those of oneOf do not
    own = {"$ref": f"#/$defs/{name}", "$defs": schema["$defs"]}
    validator = jsonschema.Draft202012Validator(own)
    for vector in VECTORS[name]:
        assert not [e.message for e in validator.iter_errors(vector)], vector["id"]
    jsonschema.Draft202012Validator(schema).validate(load(name))


@pytest.mark.parametrize("name", FILES)
def test_ids_are_unique(name: str) -> None:
    assert [i for i, n in Counter(v["id"] for v in VECTORS[name]).items() if n > 1] == []


def test_every_section_named_exists() -> None:
    text = (PROTOCOL / "SPEC.md").read_text("utf-8")
    headings = {line.split()[1] for line in text.splitlines() if line.startswith("##")}
    assert {v["section"] for name in FILES for v in VECTORS[name]} <= headings


def test_every_cell_of_the_state_table_has_a_scenario() -> None:
    assert sum(v["id"].startswith("state-") for v in VECTORS["behavior"]) == 7 * 12


@vectors("spectrum", "angle")
def test_angle(vector: Vector) -> None:
    assert vector["increment"] * vector["position"] % 2**32 == vector["theta"]


def test_worked_packets_of_the_spec() -> None:
    section = (PROTOCOL / "SPEC.md").read_text("utf-8").partition("## 15 ")[2]
    rows = re.findall(r"^\| ([A-Z_]+) \|.*\| `([0-9a-f ]+)` \|$", section, re.MULTILINE)
    vectors = {v["id"]: v["packet"] for v in VECTORS["packets"]}
    assert rows
    for name, spaced in rows:
        data = spaced.replace(" ", "")
        packet = decode_packet(bytes.fromhex(data))
        assert packet is not None, name
        kind = MESSAGES[packet.type]
        assert kind.__name__.upper() == name.replace("_", "")
        assert kind.unpack(packet.payload) is not None, name
        if name in ("HELLO", "TIME", "SYNC"):
            assert vectors[f"worked-{name.lower()}"] == data


# Messages


@vectors("messages")
def test_message(vector: Vector) -> None:
    kind = MESSAGES[vector["type"]]
    message = kind.unpack(bytes.fromhex(vector["payload"]))
    if not vector["valid"]:
        assert message is None
        return
    assert told(message, vector["fields"]) == vector["fields"]
    if vector["canonical"]:
        assert message is not None
        assert message.pack().hex() == vector["payload"]


@vectors("capabilities")
def test_capabilities(vector: Vector) -> None:
    caps = m.Caps.unpack(bytes.fromhex(vector["payload"]))
    assert caps is not None
    fault, refused = caps_fault(caps, vector["session"]), vector["refused"]
    assert fault.startswith(f"its CAPS has {refused} " if refused else "")
    assert bool(fault) == bool(refused)


# Packets and links


@vectors("packets")
def test_packet(vector: Vector) -> None:
    data = bytes.fromhex(vector["packet"])
    counters = LinkCounters()
    found = decode_packet(data, counters)
    if vector["valid"]:
        assert found == whole(vector)
        assert encode_packet(whole(vector)) == data
        assert counters == LinkCounters(packets=1)
    else:
        assert found is None
        name = "crc_errors" if vector["reason"] == "crc" else vector["reason"]
        expected = LinkCounters()
        setattr(expected, name, 1)
        assert counters == expected


@vectors("serial", "frame")
def test_serial_frame(vector: Vector) -> None:
    packet, coded = bytes.fromhex(vector["packet"]), bytes.fromhex(vector["coded"])
    assert [encode_packet(p) for p in SerialDecoder().feed(coded)] == [packet]
    if vector["encode"]:
        assert encode_frame(packet) == coded


@vectors("serial", "stream")
def test_serial_stream(vector: Vector) -> None:
    decoder = SerialDecoder(vector["limit"])
    found = [p for chunk in vector["chunks"] for p in decoder.feed(bytes.fromhex(chunk))]
    assert [encode_packet(p).hex() for p in found] == vector["packets"]
    counted(decoder.counters, vector)


@vectors("can", "transfer")
def test_can_transfer(vector: Vector) -> None:
    end, packet = vector["from_amplifier"], bytes.fromhex(vector["packet"])
    decoded = decode_packet(packet)
    assert decoded is not None
    if vector["encode"]:
        encoder = CanEncoder(from_amplifier=end, fd=vector["fd"], extended=vector["extended"])
        assert [(i, bytes(d).hex()) for i, d in encoder.frames(decoded)] == framed(vector)
    decoder = CanDecoder(from_amplifier=end, extended=vector["extended"])
    found = [p for i, d in framed(vector) for p in decoder.feed(i, bytes.fromhex(d), 0)]
    assert found == [decoded]


@vectors("can", "prompt")
def test_can_prompt(vector: Vector) -> None:
    end, frame = vector["from_amplifier"], vector["frame"]
    if vector["encode"]:
        packet = decode_packet(bytes.fromhex(vector["packet"]))
        assert packet is not None
        encoder = CanEncoder(from_amplifier=end, fd=False, extended=vector["extended"])
        assert [(i, bytes(d).hex()) for i, d in encoder.frames(packet)] == [
            (frame["id"], frame["data"])
        ]
    data = bytes.fromhex(frame["data"])
    decoder = CanDecoder(from_amplifier=end, extended=vector["extended"])
    (found,) = decoder.feed(frame["id"], data, 0)
    same_prompt(found, vector)


@vectors("can", "sequence")
def test_can_sequence(vector: Vector) -> None:
    decoder = CanDecoder(
        from_amplifier=vector["from_amplifier"],
        extended=all(frame["id"] > 0x7FF for frame in vector["frames"]),
        limit=vector["limit"],
    )
    found = [
        p for f in vector["frames"] for p in decoder.feed(f["id"], bytes.fromhex(f["data"]), f["t"])
    ]
    assert len(found) == len(vector["packets"])
    for packet, expected in zip(found, vector["packets"], strict=True):
        if "fields" in expected:
            same_prompt(packet, expected)
        else:
            assert packet == whole(expected)
    counted(decoder.counters, vector)


@vectors("i2c", "raw-write", "smbus-write")
def test_i2c_write(vector: Vector) -> None:
    raw, block = I2cTarget(vector["limit"]), SmbusTarget(vector["limit"])
    if vector["kind"] == "raw-write":
        found = [p for t in vector["transfers"] for p in raw.write(bytes.fromhex(t))]
    else:
        found = [p for t in vector["blocks"] for p in block.write(bytes.fromhex(t), 0)]
    assert [encode_packet(p).hex() for p in found] == vector["packets"]


@vectors("i2c", "raw-read")
def test_i2c_read(vector: Vector) -> None:
    target = I2cTarget()
    for packet in vector["waiting"]:
        target.put(bytes.fromhex(packet))
    for read in vector["reads"]:
        assert bytes(target.read(read["size"])).hex() == read["data"]


@vectors("i2c", "smbus-read")
def test_smbus_read(vector: Vector) -> None:
    target = SmbusTarget()
    for packet in vector["waiting"]:
        target.put(bytes.fromhex(packet))
    assert [bytes(target.read()).hex() for _ in vector["blocks"]] == vector["blocks"]


# Samples and spectrum frames


@vectors("samples", "samples")
def test_samples(vector: Vector) -> None:
    data, codes = bytes.fromhex(vector["data"]), np.array(vector["codes"], np.int16)
    encoders = (samples.encode_pcm16, samples.encode_pcm12, samples.encode_bfp8)
    if vector["direction"] != "decode":
        assert encoders[vector["format"]](codes) == data
    if vector["direction"] != "encode":
        found = samples.decode(vector["format"], data, vector["samples"], vector["channels"])
        np.testing.assert_array_equal(found, codes)


@vectors("samples", "size")
def test_samples_size(vector: Vector) -> None:
    size = samples.size(vector["format"], vector["samples"], vector["channels"])
    assert size == vector["size"]


def one_frame(codes: Iterable[Iterable[int]]) -> tuple[Any, Any]:
    return spectrum.decode(np.array([list(codes)], np.uint8))


@vectors("spectrum", "table", "sine", "amplitude", "envelope", "value")
def test_spectrum(vector: Vector) -> None:
    v = vector
    if v["kind"] == "table":
        assert spectrum.SINE[v["k"]] == v["value"]
    elif v["kind"] == "sine":
        assert (spectrum.sine(v["theta"]), spectrum.cosine(v["theta"])) == (v["sin"], v["cos"])
    elif v["kind"] == "amplitude":
        assert spectrum.AMPLITUDE[v["c"]] == v["A"]
    elif v["kind"] == "envelope":
        i, q = one_frame([[v["c"], v["p"]]])
        assert (i[0, 0], q[0, 0]) == (v["I"], v["Q"])
    else:
        i, q = one_frame(v["codes"])
        increments, still = np.array(v["increments"], np.uint32), np.zeros_like(i)
        code = spectrum.synthesize(i, q, still, still, increments, v["position"], 1)
        assert code[0, 0] == v["value"]


@vectors("correlation")
def test_correlation(vector: Vector) -> None:
    correlator, column = correlation.Correlator(1), vector["before"]
    before = np.array(column, np.int64).reshape(-1, 1)
    codes = np.array(vector["codes"], np.int64).reshape(-1, 1)
    currents = np.array(vector["currents"], np.int64).reshape(-1, 1)
    correlator.add(0, before, np.zeros_like(before), 0)
    (window,) = correlator.add(len(before), codes, currents, len(codes))
    assert window == (len(before), len(codes), bytes.fromhex(vector["entry"]))
    message = m.Correlation(0, 2500, len(codes), 0, 1, 16, window.entries)
    entries = correlation.decode(message)
    assert entries is not None
    half = (1 << window.entries[1]) // 2
    assert np.abs(entries.sums[0] - vector["sums"]).max() <= half
    assert abs(entries.energy[0] - vector["energy"]) <= 1e-3 * vector["energy"]
    assert entries.flags[0] == window.entries[0]


@vectors("guard")
def test_guard(vector: Vector) -> None:
    """The entry comes at START, and is in force after the first block."""
    correlator, guards = correlation.Correlator(1), guard.ChannelGuards(1)
    guards.take(0, np.frombuffer(bytes.fromhex(vector["entry"]), guard.ENTRY))
    columns = (np.array(vector[name], np.int64) for name in ("codes", "currents"))
    codes, currents = (column.reshape(-1, 1) for column in columns)
    reasons = []
    for first in range(0, len(codes), m.GUARD_BLOCK):
        block = slice(first, first + m.GUARD_BLOCK)
        correlator.add(first, codes[block], currents[block], 0)
        before = int(guards.reasons[0])
        changed = guards.add(correlator.currents, correlator.steps())
        assert changed == (before != guards.reasons[0])
        reasons.append(int(guards.reasons[0]))
    assert reasons == vector["reasons"]


def played(amplifier: ReferenceAmplifier) -> Instants:
    instants: Instants = {}
    for run in amplifier.take_played():
        for k, (tick, codes) in enumerate(zip(run.ticks, run.codes, strict=True)):
            last = k == len(run.ticks) - 1
            position = run.position if k == 0 else None
            state = int(run.state) if last else None
            instants[int(tick)] = position, state, codes.tolist(), run.lines
    return instants


@vectors("behavior")
def test_behavior(vector: Vector) -> None:
    config = config_of(vector)
    config["fifo"] = config.pop("fifo_samples")
    sensor = Output(config["channels"]) if config.pop("sense", False) else None
    amplifier = ReferenceAmplifier(AmplifierConfig(**config), sensor)
    everything: list[Packet] = []
    for step in vector["steps"]:
        amplifier.run(step["tick"])
        if "packet" in step:
            data = bytes.fromhex(step["packet"])
            packet = decode_packet(data, amplifier.counters, config["packet_limit"])
            if packet is not None:
                amplifier.receive(packet, step["tick"])
        elif "fault" in step:
            amplifier.fault(step["fault"], step["tick"])
        elif "input" in step:
            amplifier.estop_input(step["input"] == 1, step["tick"])
        sent = amplifier.take_sent()
        everything += sent
        check_answers(step, sent)
        if vector["pulses"]:
            check_pulses(step, sent)
        check_output(step, played(amplifier))
        assert amplifier.high_voltage == step.get("high_voltage", amplifier.high_voltage), step
    check_last_pulse(vector, everything)
