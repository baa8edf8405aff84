"""The vectors of firmware_protocol, through the implementations in Python and in C.

`firmware_protocol/vectors/README.md` says what a vector means. They are written from SPEC.md alone:
where one fails, the implementation is wrong or SPEC.md is, and the vector is only changed together
with it.
"""

import json
import os
import re
import shutil
import struct
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest

from firmware_protocol import samples, spectrum
from firmware_protocol.amplifier import Amplifier
from firmware_protocol.can_link import CanDecoder, CanEncoder
from firmware_protocol.config import Config
from firmware_protocol.i2c_link import I2cTarget, SmbusTarget
from firmware_protocol.messages import MESSAGES
from firmware_protocol.packet import LinkCounters, Packet, decode_packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame

PROTOCOL = Path(__file__).parents[1] / "firmware_protocol"
FILES = (
    "messages", "packets", "serial", "can", "i2c", "samples", "spectrum", "behavior",
)  # fmt: skip
COUNTERS = (
    "packets", "crc_errors", "malformed", "oversized", "fragments_dropped", "unknown_type",
)  # fmt: skip
DEFAULTS = {
    "channels": 2, "carriers": 4, "formats": 15, "packet_limit": 4096, "fifo_samples": 1024,
    "tick_hz": 1000000, "rate_min_hz": 2500, "rate_max_hz": 16000, "full_scale_uv": 100000000,
    "voltage_limit_uv": 100000000, "slew_limit_v_per_s": 700000, "fade_limit_us": 20000, "node": 1,
}  # fmt: skip
OPTIONS = {
    "fifo_samples": "fifo", "rate_min_hz": "rate-min", "rate_max_hz": "rate-max",
    "slew_limit_v_per_s": "slew-v-per-s", "fade_limit_us": "fade-us",
}  # fmt: skip
HEAD, ACK, PULSE = 4, 0x40, 0x45
RECORD_PACKET, RECORD_RUN, RECORD_FAULT = 3, 4, 5

Vector = dict[str, Any]


def load(name: str) -> Any:
    return json.loads((PROTOCOL / "vectors" / f"{name}.json").read_text("utf-8"))


VECTORS: dict[str, list[Vector]] = {name: load(name)["vectors"] for name in FILES}


def vectors(file: str, *kinds: str, **having: object) -> pytest.MarkDecorator:
    """Run a test on the vectors of a file, of some kinds, with some values."""
    chosen = [
        v
        for v in VECTORS[file]
        if (not kinds or v["kind"] in kinds) and all(v.get(k) == x for k, x in having.items())
    ]
    return pytest.mark.parametrize("vector", chosen, ids=[v["id"] for v in chosen])


# The files


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
    assert sum(v["id"].startswith("state-") for v in VECTORS["behavior"]) == 7 * 11


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


def plain(value: Any) -> Any:
    """Return a field of a message as the vectors write it."""
    return bytes(value).hex() if isinstance(value, bytes | bytearray | memoryview) else int(value)


def told(message: Any, fields: Vector) -> Vector:
    """Return those fields of a message that a vector names."""
    values = {name: getattr(message, name) for name in fields}
    return {
        name: bytes(value).rstrip(b"\0").decode() if name == "name" else plain(value)
        for name, value in values.items()
    }


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


# Packets and links


def whole(vector: Vector) -> Packet:
    return Packet(
        vector["type"], bytes.fromhex(vector["payload"]), vector["flags"], vector["node"],
        vector["seq"],
    )  # fmt: skip


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


def counted(counters: object, vector: Vector) -> None:
    assert {n: getattr(counters, n) for n in vector["counters"]} == vector["counters"]


@vectors("serial", "stream")
def test_serial_stream(vector: Vector) -> None:
    decoder = SerialDecoder(vector["limit"])
    found = [p for chunk in vector["chunks"] for p in decoder.feed(bytes.fromhex(chunk))]
    assert [encode_packet(p).hex() for p in found] == vector["packets"]
    counted(decoder.counters, vector)


def framed(vector: Vector) -> list[tuple[int, str]]:
    return [(f["id"], f["data"]) for f in vector["frames"]]


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


def same_prompt(packet: Packet, vector: Vector) -> None:
    assert (packet.type, packet.node, packet.flags) == (vector["type"], vector["node"], 0x40)
    assert told(MESSAGES[packet.type].unpack(packet.payload), vector["fields"]) == vector["fields"]


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


# Behavior

Instants = dict[int, tuple[int | None, int | None, list[int]]]
"""By tick: position, state, codes; None where they are not known."""


def check_answers(step: Vector, sent: list[Packet]) -> None:
    answers, expected = [p for p in sent if p.type != PULSE], step.get("answers", [])
    names = [MESSAGES[p.type].__name__.upper() for p in answers]
    assert names == [a["message"].replace("_", "") for a in expected], step
    for packet, answer in zip(answers, expected, strict=True):
        fields = told(MESSAGES[packet.type].unpack(packet.payload), answer["fields"])
        assert fields == answer["fields"], step
        assert packet.node == answer.get("node", packet.node), step


def check_pulses(step: Vector, sent: list[Packet]) -> None:
    pulses = [MESSAGES[p.type].unpack(p.payload) for p in sent if p.type == PULSE]
    expected = [{k: v for k, v in p.items() if k != "tick"} for p in step["pulses"]]
    assert [told(p, e) for p, e in zip(pulses, expected, strict=False)] == expected, step
    assert len(pulses) == len(expected), step


def check_output(step: Vector, instants: Instants) -> None:
    for expected in step.get("output", []):
        position, state, codes = instants[expected["tick"]]
        assert codes == expected["codes"], (step, expected)
        assert position in (None, expected.get("position", position)), (step, expected)
        assert state in (None, expected.get("state", state)), (step, expected)


def check_last_pulse(vector: Vector, sent: Iterable[Packet]) -> None:
    if "last_pulse" in vector:
        last = [p for p in sent if p.type == PULSE][-1]
        fields = vector["last_pulse"]
        assert told(MESSAGES[PULSE].unpack(last.payload), fields) == fields


def config_of(vector: Vector) -> dict[str, Any]:
    own: dict[str, Any] = vector["config"]
    return DEFAULTS | own


def played(amplifier: Amplifier) -> Instants:
    instants: Instants = {}
    for run in amplifier.take_played():
        for k, (tick, codes) in enumerate(zip(run.ticks, run.codes, strict=True)):
            last = k == len(run.ticks) - 1
            position = run.position if k == 0 else None
            state = int(run.state) if last else None
            instants[int(tick)] = position, state, codes.tolist()
    return instants


@vectors("behavior")
def test_behavior(vector: Vector) -> None:
    config = config_of(vector)
    config["fifo"] = config.pop("fifo_samples")
    amplifier = Amplifier(Config(**config))
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
        sent = amplifier.take_sent()
        everything += sent
        check_answers(step, sent)
        if vector["pulses"]:
            check_pulses(step, sent)
        check_output(step, played(amplifier))
        assert amplifier.high_voltage == step.get("high_voltage", amplifier.high_voltage), step
    check_last_pulse(vector, everything)


# The same in C


def compiler() -> str:
    found = shutil.which(os.environ.get("CC", "cc"))
    if found is None:
        if os.environ.get("CI") == "true":
            pytest.fail("CI has no C compiler")
        pytest.skip("no C compiler")
    return found


def run(*command: str | Path, **options: Any) -> bytes:
    done = subprocess.run(command, capture_output=True, check=False, timeout=300, **options)
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    return bytes(done.stdout)


@pytest.fixture(scope="session")
def core(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], str]]:
    """Give a function that has run_vectors do a command."""
    program = tmp_path_factory.mktemp("vectors") / "run_vectors"
    # run_vectors.c has the links in it
    sources = [p for p in (PROTOCOL / "c").glob("tactile_*.c") if p.stem != "tactile_link"]
    run(
        compiler(), "-std=c99", "-O1", "-Wall", "-Werror", "-DTA_CARRIERS=64", "-o", program,
        PROTOCOL / "c/test/run_vectors.c", *sources,
    )  # fmt: skip
    with subprocess.Popen(
        [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        given, answers = process.stdin, process.stdout
        assert given is not None
        assert answers is not None

        def ask(command: str) -> str:
            given.write(command + "\n")
            given.flush()
            return answers.readline().strip()

        yield ask
        given.close()


@pytest.fixture(scope="session")
def decoded_in_c(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """Of each vector of messages.json the lines that C says about it."""
    folder = tmp_path_factory.mktemp("messages")
    (folder / "messages.c").write_text(messages_program(), "utf-8")
    run(
        compiler(), "-std=c99", "-O1", "-Wall", "-Werror", f"-I{PROTOCOL / 'c'}", "-o",
        folder / "messages", folder / "messages.c",
    )  # fmt: skip
    found: dict[str, list[str]] = {}
    for line in run(folder / "messages").decode().splitlines():
        name, _, rest = line.partition(" ")
        found.setdefault(name, []).append(rest)
    return found


def messages_program() -> str:
    """Return a C program that decodes and encodes every payload and prints the fields."""
    text = ['#include <stdio.h>\n#include "tactile_messages.h"\n']
    text.append("static void show(const uint8_t *b, size_t n)")
    text.append('{ for (size_t i = 0; i < n; i++) printf("%02x", b[i]); printf("\\n"); }')
    text.append("int main(void) { static uint8_t out[8192];")
    for vector in VECTORS["messages"]:
        name, identity = vector["message"].lower(), vector["id"]
        payload = bytes.fromhex(vector["payload"])
        data = ",".join(map(str, payload + b"\0"))
        text.append(f"{{ static const uint8_t in[] = {{{data}}}; tp_{name} m;")
        text.append(f"if (!tp_{name}_decode(&m, in, {len(payload)})) ")
        text.append(f'printf("{identity} invalid\\n"); else {{')
        for field, value in vector.get("fields", {}).items():
            text.append(f'printf("{identity} {field} ");')
            if field == "name":
                text.append("show((const uint8_t *)m.name, 16);")
            elif isinstance(value, str):
                text.append(f"show(m.{field}, m.{field}_size);")
            else:
                text.append(f'printf("%llu\\n", (unsigned long long)m.{field});')
        text.append(f'printf("{identity} payload ");')
        text.append(f"show(out, tp_{name}_encode(&m, out, sizeof out)); }} }}")
    return "\n".join([*text, "return 0; }\n"])


@vectors("messages")
def test_message_in_c(vector: Vector, decoded_in_c: dict[str, list[str]]) -> None:
    if not vector["valid"]:
        assert decoded_in_c[vector["id"]] == ["invalid"]
        return
    lines = [line.partition(" ")[::2] for line in decoded_in_c[vector["id"]]]
    expected = {
        name: value.encode().ljust(16, b"\0").hex() if name == "name" else str(value)
        for name, value in vector["fields"].items()
    }
    if vector["canonical"]:
        expected["payload"] = vector["payload"]
    assert dict(lines) | expected == dict(lines)


Core = Callable[[str], str]


def dash(text: str) -> str:
    return text or "-"


def came(answer: str) -> tuple[list[tuple[str, ...]], dict[str, int]]:
    """Return the packets and prompts, and the counters, of what run_vectors says."""
    words = answer.split()
    end = words.index("counters")
    found: list[tuple[str, ...]] = []
    k = 0
    while k < end:
        size = {"packet": 2, "prompt": 3}[words[k]]
        found.append(tuple(words[k : k + size]))
        k += size
    return found, dict(zip(COUNTERS, map(int, words[end + 1 :]), strict=True))


def packets_in(answer: str) -> list[str]:
    return [item[1] for item in came(answer)[0]]


@vectors("packets")
def test_packet_in_c(vector: Vector, core: Core) -> None:
    if vector.get("reason") == "oversized":
        pytest.skip("the link drops it before")
    found = core(f"packet {dash(vector['packet'])}")
    if not vector["valid"]:
        assert found == "none"
        return
    head = " ".join(str(vector[k]) for k in ("type", "flags", "node", "seq"))
    assert found == f"{head} {dash(vector['payload'])}"
    assert core(f"seal {head} {dash(vector['payload'])}") == vector["packet"]


@vectors("serial")
def test_serial_in_c(vector: Vector, core: Core) -> None:
    if vector["kind"] == "frame":
        assert packets_in(core(f"serial 4096 {vector['coded']}")) == [vector["packet"]]
        if vector["encode"]:
            assert core(f"cobs {vector['packet']}") == vector["coded"]
        return
    answer = core(f"serial {vector['limit']} " + " ".join(map(dash, vector["chunks"])))
    assert packets_in(answer) == vector["packets"]
    counters = came(answer)[1]
    assert {n: counters[n] for n in vector["counters"] if n != "unknown_type"} == vector["counters"]


def feed(frames: list[Vector], node: int = 1, limit: int = 4096) -> str:
    words = (f"{f.get('t', 0)} {f['id']} {dash(f['data'])}" for f in frames)
    extended = all(frame["id"] > 0x7FF for frame in frames)
    return f"can {limit} {node or 1} {extended:d} {' '.join(words)}"


@vectors("can", "transfer")
def test_can_transfer_in_c(vector: Vector, core: Core) -> None:
    data, packet = [f["data"] for f in vector["frames"]], vector["packet"]
    room = 64 if vector["fd"] else 8
    assert core(f"cut {room} {vector['fd']:d} 0 {packet}").split() == data
    if vector["from_amplifier"]:
        node = int(packet[4:6], 16)
        words = [str(x) for frame in framed(vector) for x in frame]
        sent = core(f"send {vector['fd']:d} {vector['extended']:d} {node} {packet}")
        assert sent.split() == words
    else:
        assert packets_in(core(feed(vector["frames"]))) == [packet]


@vectors("can", "prompt")
def test_can_prompt_in_c(vector: Vector, core: Core) -> None:
    frame = vector["frame"]
    if vector["from_amplifier"]:
        sent = core(f"send 0 {vector['extended']:d} {vector['node']} {vector['packet']}")
        assert sent == f"{frame['id']} {frame['data']}"
        return
    ((kind, type_, payload),) = came(core(feed([frame], vector["node"])))[0]
    assert (kind, int(type_)) == ("prompt", vector["type"])
    message = MESSAGES[vector["type"]].unpack(bytes.fromhex(payload.strip("-")))
    assert told(message, vector["fields"]) == vector["fields"]


@vectors("can", "sequence", from_amplifier=False)
def test_can_sequence_in_c(vector: Vector, core: Core) -> None:
    found, counters = came(core(feed(vector["frames"], limit=vector["limit"])))
    expected = [
        ("prompt", str(p["type"])) if "fields" in p else ("packet", encode_packet(whole(p)).hex())
        for p in vector["packets"]
    ]
    assert [item[:2] for item in found] == expected
    # what came whole is then refused by an amplifier without a session: not the link's count
    named = vector["counters"]
    assert {n: counters[n] for n in named} == named


@vectors("i2c")
def test_i2c_in_c(vector: Vector, core: Core) -> None:
    kind = vector["kind"]
    if kind.endswith("write"):
        data = vector["transfers"] if kind == "raw-write" else vector["blocks"]
        command = {"raw-write": "i2c-write", "smbus-write": "smbus-write"}[kind]
        answer = core(f"{command} {vector['limit']} " + " ".join(map(dash, data)))
        assert packets_in(answer) == vector["packets"]
        return
    waiting = " ".join([str(len(vector["waiting"])), *vector["waiting"]])
    if kind == "raw-read":
        sizes = " ".join(str(r["size"]) for r in vector["reads"])
        expected = [r["data"] for r in vector["reads"]]
        assert core(f"i2c-read {waiting} {sizes}").split() == expected
    else:
        count = len(vector["blocks"])
        assert core(f"smbus-read {waiting} {count}").split() == vector["blocks"]


@vectors("samples")
def test_samples_in_c(vector: Vector, core: Core) -> None:
    what = f"{vector['format']} {vector['samples']} {vector['channels']}"
    if vector["kind"] == "size":
        assert int(core(f"size {what}")) == vector["size"]
        return
    codes = [str(code) for row in vector["codes"] for code in row]
    if vector["direction"] != "decode":
        assert core(f"encode {what} {' '.join(codes)}") == vector["data"]
    if vector["direction"] != "encode":
        assert core(f"decode {what} {vector['data']}").split() == codes


@vectors("spectrum", "sine", "amplitude", "envelope", "value")
def test_spectrum_in_c(vector: Vector, core: Core) -> None:
    v = vector
    if v["kind"] == "sine":
        assert core(f"sine {v['theta']}") == f"{v['sin']} {v['cos']}"
    elif v["kind"] == "amplitude":
        assert core(f"amplitude {v['c']}") == str(v["A"])
    elif v["kind"] == "envelope":
        assert core(f"phasor {v['c']} {v['p']}") == f"{v['I']} {v['Q']}"
    else:
        numbers = [v["position"], len(v["codes"]), *v["increments"]]
        numbers += [x for pair in v["codes"] for x in pair]
        assert core("value " + " ".join(map(str, numbers))) == str(v["value"])


@pytest.fixture(scope="session")
def virtual_amplifier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler()
    if shutil.which("make") is None:
        if os.environ.get("CI") == "true":
            pytest.fail("CI has no make")
        pytest.skip("no make")
    build = tmp_path_factory.mktemp("build")
    run("make", "-C", PROTOCOL / "c", f"BUILD={build}", "virtual-amplifier")
    return build / "virtual-amplifier"


def records(vector: Vector) -> bytes:
    out = bytearray()
    for step in vector["steps"]:
        kind, data = RECORD_RUN, b""
        if "packet" in step:
            kind, data = RECORD_PACKET, bytes.fromhex(step["packet"])
        elif "fault" in step:
            kind, data = RECORD_FAULT, bytes([step["fault"]])
        out += struct.pack("<QBI", step["tick"], kind, len(data)) + data
    return bytes(out)


def split_sent(data: bytes) -> Iterator[tuple[int, Packet]]:
    at = 0
    while at < len(data):
        tick, _, size = struct.unpack_from("<QBI", data, at)
        packet = decode_packet(data[at + 13 : at + 13 + size])
        assert packet is not None
        yield tick, packet
        at += 13 + size


@vectors("behavior")
def test_behavior_in_c(vector: Vector, virtual_amplifier: Path, tmp_path: Path) -> None:
    config = config_of(vector)
    options = [
        word
        for name, value in config.items()
        for word in (f"--{OPTIONS.get(name, name.replace('_', '-'))}", str(value))
    ]
    out, sent_file = tmp_path / "out", tmp_path / "sent"
    run(
        virtual_amplifier, "--replay", "--link", "packet", "--out", out, "--sent", sent_file,
        *options, input=records(vector),
    )  # fmt: skip
    row = struct.Struct(f"<QIBB{config['channels']}h")
    rows = list(row.iter_unpack(out.read_bytes()))
    instants: Instants = {t: (n, s, list(codes)) for t, n, s, _, *codes in rows}
    sent = list(split_sent(sent_file.read_bytes()))
    since = -1
    for step in vector["steps"]:
        # steps are at different ticks, so what a step caused has its tick
        new = [packet for tick, packet in sent if since < tick <= step["tick"]]
        check_answers(step, new)
        if vector["pulses"]:
            check_pulses(step, new)
            ticks = [t for t, p in sent if since < t <= step["tick"] and p.type == PULSE]
            assert ticks == [p["tick"] for p in step["pulses"]], step
        check_output(step, instants)
        before = [r[3] for r in rows if r[0] <= step["tick"]]
        assert step.get("high_voltage") in (None, *before[-1:]), step
        since = step["tick"]
    check_last_pulse(vector, (p for _, p in sent))
