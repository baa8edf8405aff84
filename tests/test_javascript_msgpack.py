"""MessagePack of the JavaScript client against that of msgspec, and against hostile bytes."""

import json
import math
import random
import shutil
import struct
import subprocess
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest
from javascript_rig import MESSAGES, WEB, examples
from node_rig import tool

PIPE = Path(__file__).with_name("msgpack_pipe.mjs")
BY_NAME = {kind.__name__: kind for kind in MESSAGES}
DEEPEST = 64
"""Maximum depth of msgpack.ts."""
EDGES = [
    0, 1, -1, -32, -33, 127, 128, -128, -129, 255, 256, 32767, 32768, -32768, -32769, 65535, 65536,
    2**31 - 1, 2**31, -(2**31), -(2**31) - 1, 2**32 - 1, 2**32, -(2**32), 2**53, -(2**53),
]  # fmt: skip
"""Integers at which the encoding changes, up to the largest that JavaScript has exactly."""
LENGTHS = [0, 1, 15, 16, 31, 32, 255, 256, 4090, 4096, 5000, 65535, 65536, 150_000]
"""Lengths at which the encoding changes, and at which the buffer of the encoder grows."""

MALFORMED = {
    b"": "1 bytes are due, and 0 are left",
    b"\x01\x02": "1 bytes follow the value",
    b"\xc1": "0xc1 begins no value of the API",
    b"\xdd\xff\xff\xff\xff\x00": "4294967295 values are due, and 1 bytes are left",
    b"\xdf\x80\x00\x00\x00\x00": "4294967296 values are due, and 1 bytes are left",
    b"\xc6\xff\xff\xff\xff\x00": "4294967295 bytes are due, and 1 are left",
    b"\xdb\xff\xff\xff\xff\x00": "4294967295 bytes are due, and 1 are left",
    b"\x91" * 65 + b"\x00": f"values are nested deeper than {DEEPEST}",
    b"\x81\xa1a" * 65 + b"\x00": f"values are nested deeper than {DEEPEST}",
    b"\x81" * 65 + b"\x00": f"values are nested deeper than {DEEPEST}",
    b"\x81\x01\x02": "a key of a map is not a text",
    b"\xa2\xc0\x80": "a text is not UTF-8",
    b"\xa1\x80": "a text is not UTF-8",
    b"\xa3\xed\xa0\x80": "a text is not UTF-8",
    b"\xd9\x28" + b"a" * 39 + b"\xff": "a text is not UTF-8",
}
"""Bytes that are no value, with the error that says why."""
HEADS = [bytes([code]) for code in (0x81, 0x8F, 0x91, 0x9F, 0xDC, 0xDD, 0xDE, 0xDF, 0xFF)]
"""First bytes of which a row is no value: arrays and maps, and numbers behind a number."""


def run(requests: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Let one process of node answer all requests of msgpack_pipe.mjs."""
    lines = "".join(json.dumps(request) + "\n" for request in requests)
    with TemporaryDirectory() as folder:
        module = shutil.copy(WEB / "client" / "msgpack.js", Path(folder) / "msgpack.mjs")
        command = [tool("node"), str(PIPE), str(module)]
        done = subprocess.run(
            command, input=lines, capture_output=True, text=True, check=False, timeout=300
        )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.split("\n")[:-1]]  # texts have line separators


def decoded(packets: Iterable[bytes]) -> list[dict[str, Any]]:
    return run({"decode": packet.hex()} for packet in packets)


def encoded(values: Iterable[Any]) -> list[bytes]:
    return [bytes.fromhex(answer["bytes"]) for answer in run({"encode": shown(v)} for v in values)]


def shown(value: Any) -> Any:
    """Return a value as msgpack_pipe.mjs writes it."""
    match value:
        case list() | tuple():
            return ["list", *map(shown, value)]
        case dict():
            return ["map", *([key, shown(field)] for key, field in value.items())]
        case bytes():
            return ["bytes", value.hex()]
        case float() if not math.isfinite(value):
            return ["number", {math.inf: "Infinity", -math.inf: "-Infinity"}.get(value, "NaN")]
        case float() if value == 0 and math.copysign(1, value) < 0:
            return ["number", "-0"]
    return value


# Against msgspec


def test_messages_of_msgspec_are_decoded_to_the_same_values() -> None:
    cases = [value for _, value in examples(random.Random("decode"), 20)]
    answers = decoded(map(msgspec.msgpack.encode, cases))
    assert [answer.get("value", answer) for answer in answers] == [shown(case) for case in cases]


def test_messages_are_encoded_so_that_msgspec_decodes_the_same() -> None:
    cases = list(examples(random.Random("encode"), 20))
    packets = encoded(value for _, value in cases)
    for (name, value), packet in zip(cases, packets, strict=True):
        message = msgspec.msgpack.decode(packet, type=BY_NAME[name])
        assert message == msgspec.convert(value, BY_NAME[name])
        assert msgspec.msgpack.decode(packet) == value


def test_integers_are_as_short_as_those_of_msgspec() -> None:
    assert encoded(EDGES) == [msgspec.msgpack.encode(value) for value in EDGES]
    answers = decoded(map(msgspec.msgpack.encode, EDGES))
    assert [answer["value"] for answer in answers] == EDGES


def test_larger_integers_become_the_nearest_number() -> None:
    values = [2**53 + 1, 2**62, -(2**63), 2**63 - 1, 2**64 - 1]
    answers = decoded(map(msgspec.msgpack.encode, values))
    assert [float(answer["value"]) for answer in answers] == [float(value) for value in values]


def test_floats_are_kept_to_the_last_bit() -> None:
    values = [0.1, -1e-320, 1e300, 2.0**53 + 2, math.inf, -math.inf, math.nan, math.pi]
    packets = encoded(values)
    assert packets == [b"\xcb" + struct.pack(">d", value) for value in values]
    answers = decoded(
        [*packets, b"\xca" + struct.pack(">f", 0.1), b"\xcb" + struct.pack(">d", -0.0)]
    )
    (single,) = struct.unpack("f", struct.pack("f", 0.1))
    assert [answer["value"] for answer in answers] == [shown(v) for v in [*values, single, -0.0]]


def test_texts_of_all_lengths_are_those_of_msgspec() -> None:
    values: list[Any] = ["a\x85\u2028\r\n\0"]
    for unit in ("a", "µ", "漢", "😀"):
        values += [unit * length for length in LENGTHS]
        values += ["a" * 30 + unit, "\ufeff" + unit, {unit * 40: unit}]
    packets = encoded(values)
    assert packets == [msgspec.msgpack.encode(value) for value in values]
    assert [answer["value"] for answer in decoded(packets)] == [shown(value) for value in values]


@pytest.mark.ci
def test_containers_of_all_lengths_are_those_of_msgspec() -> None:
    rng = random.Random("containers")
    values: list[Any] = [rng.randbytes(length) for length in LENGTHS]
    values += [[rng.choice(EDGES) for _ in range(length)] for length in LENGTHS]
    values += [{f"k{i}": None for i in range(length)} for length in LENGTHS]
    rng.shuffle(values)
    packets = encoded(values)
    assert packets == [msgspec.msgpack.encode(value) for value in values]
    assert [answer["value"] for answer in decoded(packets)] == [shown(value) for value in values]


def test_every_kind_of_value_may_be_the_one_for_which_the_buffer_grows() -> None:
    """A fresh encoder has room for 4096 bytes, which end in each byte of a value."""
    tails: list[Any] = [None, 7, 200, 1000, 70_000, 2**40, 0.5, "ab", "µ", "a" * 40, "a" * 300]
    tails += ["a" * 70_000, b"abc", bytes(300), [1] * 20, {"a": 1}, {f"k{i}": i for i in range(20)}]
    values = [[bytes(size), tail] for tail in tails for size in range(4080, 4094)]
    requests = ({"encode": shown(value), "fresh": i} for i, value in enumerate(values))
    packets = [bytes.fromhex(answer["bytes"]) for answer in run(requests)]
    assert packets == [msgspec.msgpack.encode(value) for value in values]


# What has no encoding, and what is left out


def test_fields_that_are_undefined_are_left_out() -> None:
    (answer,) = run([{"encode": ["map", ["a", ["undefined"]], ["b", ["list", ["undefined"]]]]}])
    assert bytes.fromhex(answer["bytes"]) == msgspec.msgpack.encode({"b": [None]})


def test_what_has_no_encoding_is_a_type_error_and_leaves_nothing_behind() -> None:
    deepest: Any = 0
    for _ in range(DEEPEST):
        deepest = [deepest]
    wrong = [["function"], ["new", "Float32Array"], ["new", "ArrayBuffer"], shown([deepest])]
    answers = run({"encode": value} for value in [shown(deepest), *wrong, 1])
    assert bytes.fromhex(answers[0]["bytes"]) == b"\x91" * DEEPEST + b"\0"
    assert [answer["error"] for answer in answers[1:-1]] == ["TypeError"] * len(wrong)
    assert answers[-1] == {"bytes": "01"}


# Hostile bytes


def failures(answers: list[dict[str, Any]]) -> int:
    """Return how many inputs were no value; every other must have one."""
    wrong = [answer for answer in answers if "error" in answer]
    assert {answer["error"] for answer in wrong} <= {"DecodeError"}
    assert all("value" in answer for answer in answers if "error" not in answer)
    return len(wrong)


def test_truncated_messages_are_errors() -> None:
    whole = [msgspec.msgpack.encode(value) for _, value in examples(random.Random("cut"), 2)]
    cut = [packet[:length] for packet in whole for length in range(min(len(packet), 400))]
    assert failures(decoded(cut)) == len(cut)


def test_each_first_byte_is_a_value_or_an_error() -> None:
    """Nothing, zeros or ones follow it; msgspec judges."""
    tails = (b"", b"\0", b"\0" * 4, b"\0" * 8, b"\0" * 40, b"\xff" * 4, b"\xff" * 40)
    packets = [bytes([code]) + tail for tail in tails for code in range(256)]
    answers = decoded(packets)
    failures(answers)
    assert ["value" in answer for answer in answers] == [is_value(packet) for packet in packets]


def is_value(packet: bytes) -> bool:
    """Return whether bytes are one value of the types of the API, by msgspec."""
    try:
        value = msgspec.msgpack.decode(packet)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return False
    keys = value if isinstance(value, dict) else {}
    known = not isinstance(value, msgspec.msgpack.Ext) and packet[0] not in range(0xC7, 0xCA)
    return known and packet[0] not in range(0xD4, 0xD9) and all(isinstance(k, str) for k in keys)


def test_malformed_bytes_are_one_error_that_says_why() -> None:
    messages = [{"error": "DecodeError", "message": message} for message in MALFORMED.values()]
    assert decoded(MALFORMED) == messages


@pytest.mark.ci
def test_what_is_deepest_is_decoded_and_a_megabyte_of_heads_is_not() -> None:
    answers = decoded([b"\x91" * DEEPEST + b"\x00", *(code * 2**20 for code in HEADS)])
    assert failures(answers) == len(HEADS)
    assert "value" in answers[0]


def test_keys_with_a_meaning_in_javascript_are_fields_as_any() -> None:
    """Decoding them changes no prototype, which msgpack_pipe.mjs checks after each."""
    keys = ("__proto__", "constructor", "prototype", "toString", "hasOwnProperty")
    values = [{key: {"polluted": 1, "x": None}} for key in keys]
    answers = decoded([msgspec.msgpack.encode(value) for value in values])
    assert [answer.get("value", answer) for answer in answers] == [shown(v) for v in values]


@pytest.mark.parametrize("count", [3000, pytest.param(30_000, marks=pytest.mark.ci)])
def test_changed_and_random_bytes_are_values_or_errors(count: int) -> None:
    rng = random.Random(count)
    whole = [msgspec.msgpack.encode(value) for _, value in examples(rng, 3)]
    whole = [packet for packet in whole if len(packet) < 1000]
    packets = []
    for number in range(count):
        packet = bytearray(rng.choice(whole) if number % 2 else rng.randbytes(rng.randrange(40)))
        for _ in range(rng.randrange(4) if packet else 0):
            packet[rng.randrange(len(packet))] = rng.randrange(256)
        packets.append(bytes(packet))
    wrong = failures(decoded(packets))
    assert 0.2 * count < wrong < 0.95 * count
