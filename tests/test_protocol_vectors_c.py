"""The vectors of firmware_protocol, through the implementation in C."""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from behavior_rig import check_replayed, trace
from c_amplifier_rig import compiler
from protocol_traces import loaded, saved
from vectors_rig import (
    COUNTERS,
    OPTIONS,
    PROTOCOL,
    VECTORS,
    Vector,
    config_of,
    framed,
    told,
    vectors,
    whole,
)

from firmware_protocol.messages import MESSAGES
from firmware_protocol.packet import encode_packet


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
    """Return the lines that C prints for each vector of messages.json."""
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


@vectors("correlation")
def test_correlation_in_c(vector: Vector, core: Core) -> None:
    pairs = zip(vector["codes"], vector["currents"], strict=True)
    before, codes = vector["before"], [x for pair in pairs for x in pair]
    numbers = [len(before), *before, len(vector["codes"]), *codes]
    assert core("correlate " + " ".join(map(str, numbers))) == vector["entry"]


@vectors("guard")
def test_guard_in_c(vector: Vector, core: Core) -> None:
    pairs = zip(vector["codes"], vector["currents"], strict=True)
    numbers = [len(vector["codes"]), *(x for pair in pairs for x in pair)]
    reasons = core(f"guard {vector['entry']} " + " ".join(map(str, numbers)))
    assert reasons.split() == [str(reason) for reason in vector["reasons"]]


@vectors("behavior")
def test_behavior_in_c(vector: Vector, build: Path, tmp_path: Path) -> None:
    config = config_of(vector)
    senses = ["--sense"] if config.pop("sense", False) else []
    options = senses + [
        word
        for name, value in config.items()
        for word in (f"--{OPTIONS.get(name, name.replace('_', '-'))}", str(value))
    ]
    out, sent_file = tmp_path / "out", tmp_path / "sent"
    run(
        build / "virtual-amplifier", "--replay", "--link", "packet", "--out", out,
        "--sent", sent_file, *options, input=saved(trace(vector)),
    )  # fmt: skip
    check_replayed(vector, out.read_bytes(), loaded(sent_file.read_bytes()))
