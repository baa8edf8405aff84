"""Header of C against msgspec: both encode and decode the same messages, and hostile bytes.

A program is generated from the Python types, of which the template knows only the schema. Its first
argument is "encode", for the messages that are constants in it, or "decode", for packets from the
standard input. A packet begins with its size in four bytes.
"""

import json
import random
import re
import shutil
import struct
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from javascript_rig import PROJECT, examples
from msgspec import inspect
from node_rig import tool

from clients import generate
from clients.model import api_model
from tactile import messages
from tactile.messages import Answer, Command

FOLDER = PROJECT / "clients" / "c"
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", f"-I{FOLDER}"]
SANITIZED = [
    "-std=c99",
    "-g",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
    f"-I{FOLDER}",
]
COMMANDS = {kind.__name__: kind for kind in get_args(Command)}
ANSWERS = {kind.__name__: kind for kind in get_args(Answer)}
OK, UNKNOWN_TYPE, MALFORMED, INVALID, NO_MEMORY = range(5)
"""Values of `tactile_status`."""
EDGES = [
    number for power in (5, 7, 8, 15, 16, 31, 32, 53, 62) for near in (2**power, 2**power - 1)
    for number in (near, -near, -near - 1)
]  # fmt: skip
"""Integers at which the encoding changes."""
LENGTHS = [0, 15, 16, 31, 32, 255, 256, 65_535, 65_536]
"""Lengths at which the encoding changes."""
NUMBERS = {inspect.IntType: "int64_t", inspect.FloatType: "double", inspect.BoolType: "bool"}
NAMED = {messages.Role: "role", messages.Code: "code"}
PIPE = Path(__file__).with_name("c_client_pipe.c")


# The program that is generated


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def stem(info: Any, place: str = "") -> str:
    """Return the name of a type in the header behind ``tactile_``."""
    match info:
        case inspect.StructType():
            return str(info.cls.__struct_config__.tag or "") or snake(info.cls.__name__)
        case inspect.LiteralType():
            return {frozenset(get_args(k)): v for k, v in NAMED.items()}.get(
                frozenset(info.values), place
            )
        case inspect.TupleType():
            return "pair"
    raise NotImplementedError(info)


def c_type(info: Any) -> str:
    return NUMBERS.get(type(info)) or f"tactile_{stem(info)}"


def without_null(info: Any) -> tuple[Any, bool]:
    """Return a type without null, and whether there was null."""
    if not isinstance(info, inspect.UnionType):
        return info, False
    types = [one for one in info.types if not isinstance(one, inspect.NoneType)]
    return (types[0] if len(types) == 1 else info), len(types) < len(info.types)


def expression(info: Any, value: Any) -> str:
    """Return the initializer of a plain value."""
    match info:
        case inspect.StructType():
            names = [field.name for field in info.fields]
            plain = dict(zip(names, value, strict=False)) if info.array_like else value
            members = [m for f in info.fields for m in initializers(f, plain.get(f.name))]
            return f"{{{', '.join(members) or '0'}}}"
        case inspect.VarTupleType():
            items = ", ".join(expression(info.item_type, item) for item in value)
            array = f"(const {c_type(info.item_type)}[]){{{items}}}"
            return f"{{{array if value else 'NULL'}, {len(value)}}}"
        case inspect.TupleType():
            return f"{{{', '.join(map(repr, map(float, value)))}}}"
        case inspect.StrType() | inspect.BytesType():
            raw = value.encode() if isinstance(value, str) else value
            string = '"' + "".join(f"\\{byte:03o}" for byte in raw) + '"'
            kind = "char" if isinstance(value, str) else "uint8_t"
            return f"{{(const {kind} *){string}, {len(raw)}}}"
        case inspect.BoolType():
            return str(value).lower()
        case inspect.IntType():
            return f"{value}LL"
        case inspect.FloatType():
            return repr(float(value))
    raise NotImplementedError(info)


def initializers(field: inspect.Field, value: Any) -> Iterator[str]:
    """Yield the initializers of a field, if it is there."""
    if value is None:
        return
    kind, nullable = without_null(field.type)
    if nullable or (not field.required and field.default not in (msgspec.NODEFAULT, "", 0, ())):
        yield f".has_{field.name} = true"
    if isinstance(kind, inspect.UnionType):
        by_type = {type(one): one for one in kind.types}
        if isinstance(value, bytes):
            yield f".has_{field.name}_bytes = true"
            text = expression(by_type[inspect.BytesType], value)
            yield f".{field.name}_bytes = {text}"
            return
        kind = by_type[inspect.VarTupleType]
    yield f".{field.name} = {expression(kind, value)}"


def printing(info: Any, value: str, place: str = "") -> str:
    """Return statements that print a value as `shown` has it; `place` names its type if need be."""
    match info:
        case inspect.StructType():
            return f"print_{stem(info)}(&{value});"
        case inspect.VarTupleType():
            return f"EACH({value}.count, {printing(info.item_type, f'{value}.items[i]')})"
        case inspect.DictType():
            item = printing(info.value_type, f"{value}.items[i].value")
            return f"EACH({value}.count, LIST(print_text({value}.items[i].key);, {item}))"
        case inspect.TupleType():
            first, second = (f"print_number({value}.{part});" for part in ("first", "second"))
            return f"LIST({first}, {second})"
        case inspect.LiteralType():
            return f"print_text(tactile_text_of(tactile_{stem(info, place)}_name({value})));"
        case inspect.StrType():
            return f"print_text({value});"
        case inspect.BytesType():
            return f"print_bytes({value}.data, {value}.size);"
        case inspect.IntType():
            return f'printf("%" PRId64, {value});'
        case inspect.FloatType():
            return f"print_number({value});"
        case inspect.BoolType():
            return f'printf({value} ? "true" : "false");'
    raise NotImplementedError(info)


def printer(info: Any) -> Iterator[str]:
    """Yield the lines of a function that prints a structure."""
    yield f"static void print_{stem(info)}(const tactile_{stem(info)} *m) {{ putchar('[');"
    for number, field in enumerate(info.fields):
        kind, nullable = without_null(field.type)
        text = printing(kind, f"m->{field.name}", f"{stem(info)}_{field.name}")
        yield "putchar(',');" if number else ""
        yield f'if (m->has_{field.name}) {{ {text} }} else printf("null");' if nullable else text
    yield "putchar(']'); }"


def program(cases: Iterable[tuple[str, dict[str, Any]]]) -> str:
    """Return cases.h of c_client_pipe.c."""
    names = [one.name for one in api_model().structures if one.name not in COMMANDS]
    infos = [inspect.type_info(getattr(messages, name)) for name in names]
    lines = [line for info in infos for line in printer(info)]
    lines += ["static void print_answer(const tactile_answer *answer) { switch (answer->type) {"]
    for kind in map(inspect.type_info, ANSWERS.values()):
        name = stem(kind)
        lines += [f'case TACTILE_TYPE_{name.upper()}: printf("[\\"{name}\\",");']
        lines += [f"print_{name}(&answer->as.{name}); putchar(']'); break;"]
    lines += ['default: REQUIRE(!"the type is known"); }}']
    calls = []
    for number, (name, value) in enumerate(cases):
        info = inspect.type_info(COMMANDS[name])
        text = f"SEND({stem(info)}, {expression(info, value)});"
        lines += [f"static void case_{number}(void) {{ {text} }}"]
        calls += [f"case_{number}();"]
    return "\n".join([*lines, "static void send_cases(void) {", *calls, "}\n"])


def shown(value: Any) -> Any:
    """Return a value of a message as the program prints it."""
    match value:
        case msgspec.Struct():
            return [shown(getattr(value, field)) for field in value.__struct_fields__]
        case tuple():
            return [shown(item) for item in value]
        case dict():
            return [[shown(key), shown(item)] for key, item in value.items()]
        case str():
            return value.encode().hex()
        case bytes():
            return value.hex()
        case float():
            return struct.pack(">d", value).hex()
    return value


def compiled(folder: Path, *arguments: str | Path, compiler: str = "gcc") -> Path:
    """Compile a program, and return its path."""
    path = folder / "program"
    command = [tool(compiler), *map(str, arguments), "-o", str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr
    return path


@pytest.fixture(scope="module", params=[["gcc", "-fshort-enums"], ["clang"]], ids=" ".join)
def pipe(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the program with sanitizers, once with enumerations as small as on Cortex-M."""
    compiler, *options = request.param
    folder = tmp_path_factory.mktemp(compiler)
    (folder / "cases.h").write_text(program([*commands(), *edges()]))
    return compiled(folder, *SANITIZED, *options, f"-I{folder}", PIPE, compiler=compiler)


def run(command: list[Any], data: bytes = b"") -> bytes:
    done = subprocess.run(command, input=data, capture_output=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    return done.stdout


def commands() -> list[tuple[str, dict[str, Any]]]:
    """Return random messages of each type of a client."""
    cases = examples(random.Random("commands"), 8)
    return [(name, value) for name, value in cases if name in COMMANDS]


def edges() -> list[tuple[str, dict[str, Any]]]:
    """Return messages with the numbers and lengths at which the encoding changes."""
    data = {"type": "append", "display": "d", "sample_rate_hz": 100.0, "amplitude_um": 1.0}
    return [
        *(("Ping", {"type": "ping", "time_us": number}) for number in EDGES),
        *(("ClientHello", {"type": "hello", "client": "a" * n}) for n in LENGTHS),
        *(("Append", {**data, "samples": bytes(n)}) for n in LENGTHS),
        *(("Append", {**data, "samples": b"", "contactors": [1] * n}) for n in LENGTHS[1:-2]),
    ]


def answers(seed: str, count: int) -> list[tuple[str, dict[str, Any]]]:
    """Return random messages of each type of the server."""
    cases = examples(random.Random(seed), count)
    return [(name, value) for name, value in cases if name in ANSWERS]


def decoded(pipe: Path, packets: Iterable[bytes]) -> list[Any]:
    """Let the program decode packets: the type and fields of a message, or a status."""
    data = b"".join(struct.pack(">I", len(packet)) + packet for packet in packets)
    return [json.loads(line) for line in run([pipe, "decode"], data).splitlines()]


def answer_shown(message: Any) -> list[Any]:
    return [message.__struct_config__.tag, shown(message)]


def exceeds(value: Any, limit: int) -> bool:
    """Return whether an integer in a value is larger than a limit."""
    if isinstance(value, list):
        return any(exceeds(item, limit) for item in value)
    return isinstance(value, int) and value > limit


# Compilation


def test_the_header_is_current(capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.ci
@pytest.mark.parametrize(
    ("compiler", "options"),
    [
        ("gcc", ["-std=c99"]),
        ("clang", ["-std=c99"]),
        ("gcc", ["-std=c11", "-Os"]),
        ("g++", ["-xc++", "-std=c++17"]),
        ("clang++", ["-xc++", "-std=c++17"]),
    ],
)
def test_the_header_compiles_without_warnings(
    tmp_path: Path, compiler: str, options: list[str]
) -> None:
    """Compile two units that share it, of which one uses all of it."""
    if "++" in compiler and shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} on PATH")
    for name, entry in {"a.c": "int main(void) { return 0; }", "b.c": uses()}.items():
        (tmp_path / name).write_text(f'#include "tactile_client.h"\n{entry}\n')
    compiled(tmp_path, *options, *STRICT, tmp_path / "a.c", tmp_path / "b.c", compiler=compiler)


def uses() -> str:
    """Return a function that calls all that is public."""
    names = [kind.__struct_config__.tag for kind in COMMANDS.values()]
    calls = "".join(f"tactile_encode_{n}((const tactile_{n} *)in, out, 9) + " for n in names)
    return (
        "size_t use(const void *in, uint8_t *out, tactile_answer *answer);\n"
        "size_t use(const void *in, uint8_t *out, tactile_answer *answer) {\n"
        f"return {calls}(size_t)tactile_decode(out, 9, answer, out, 9); }}"
    )


@pytest.mark.ci
def test_the_example_prints_what_it_decodes(tmp_path: Path) -> None:
    source = FOLDER / "example.c"
    lines = run([compiled(tmp_path, "-std=c99", *STRICT, source)]).decode().splitlines()
    assert lines[-3:] == ["welcome as a1", "right: armed", "finger at 12, 8 mm"]
    packets = [bytes.fromhex(line.partition(" ")[2]) for line in lines[:-3]]
    assert [msgspec.msgpack.decode(packet, type=Command) for packet in packets] == [
        messages.ClientHello(client="example"),
        messages.Select(display="right", layers=(messages.Layer(texture="wood-oak", gain=0.5),)),
        messages.ArmDisplay(display="right"),
        messages.Contact(display="right", position_mm=(12, 8), normal_force_n=0.5),
        messages.EStop(),
    ]


# Against msgspec


@pytest.mark.ci
def test_messages_are_encoded_so_that_msgspec_decodes_the_same(pipe: Path) -> None:
    """Encode them also into memory of every smaller size, which c_client_pipe.c checks."""
    data, packets = run([pipe, "encode"]), []
    while data:
        (size,) = struct.unpack_from(">I", data)
        packets.append(data[4 : 4 + size])
        data = data[4 + size :]
    cases, of_edges = commands(), edges()
    assert {name for name, _ in cases} == set(COMMANDS)
    for (name, value), packet in zip(cases, packets[: len(cases)], strict=True):
        message = msgspec.msgpack.decode(packet, type=Command)
        assert message == msgspec.convert(value, COMMANDS[name])
    pairs = zip(of_edges, packets[len(cases) :], strict=True)
    wrong = [number for number, ((_, v), p) in enumerate(pairs) if p != msgspec.msgpack.encode(v)]
    assert wrong == [], "of `edges`"


@pytest.mark.ci
def test_messages_of_msgspec_are_decoded_to_the_same_values(pipe: Path) -> None:
    cases = answers("answers", 40)
    assert {name for name, _ in cases} == set(ANSWERS)
    results = decoded(pipe, (msgspec.msgpack.encode(value) for _, value in cases))
    for (name, value), result in zip(cases, results, strict=True):
        assert result == answer_shown(msgspec.convert(value, ANSWERS[name]))


@pytest.mark.ci
def test_unknown_fields_are_ignored_and_the_type_may_come_last(pipe: Path) -> None:
    rng = random.Random("unknown")
    unknown: list[Any] = [
        None,
        2**64 - 1,
        -1.5,
        "t",
        b"b" * 300,
        [[], {"a": [1, {}]}],
        {"a": {"b": []}},
    ]
    unknown += [msgspec.msgpack.Ext(5, b"e" * size) for size in (0, 1, 2, 4, 8, 16, 300, 70_000)]
    deep: Any = 0
    for _ in range(900):
        deep = [deep]
    cases, packets = answers("unknown", len(unknown) + 1), []
    for (_, value), extra in zip(cases, [*unknown, deep] * len(ANSWERS), strict=True):
        items = [*value.items(), ("new", extra)]
        rng.shuffle(items)
        packets.append(msgspec.msgpack.encode(dict(items)))
    results = decoded(pipe, packets)
    assert results == [answer_shown(msgspec.convert(v, ANSWERS[n])) for n, v in cases]


# What is no answer


@pytest.mark.ci
def test_each_failure_has_its_status(pipe: Path) -> None:
    event = {"type": "event", "display": "d", "kind": "k"}
    cases: list[tuple[Any, Any]] = [
        ({"type": "later", "a": [1]}, UNKNOWN_TYPE),
        ({"display": "d"}, INVALID),
        ({"type": 5}, INVALID),
        ([event], INVALID),
        ({"type": "event", "display": "d"}, INVALID),
        ({**event, "kind": None}, INVALID),
        ({**event, "estop": 1.5}, INVALID),
        ({**event, "estop": 2**63}, INVALID),
        ({**event, "contactors": {}}, INVALID),
        ({**event, "contactors": [True]}, INVALID),
        ({**event, "contactors": [1] * 10}, ["event", [*map(shown, ("d", "k", "")), 0, [1] * 10]]),
        ({"type": "failure", "code": "later", "message": ""}, ["failure", [None, "", "", ""]]),
    ]
    packets = [msgspec.msgpack.encode(value) for value, _ in cases]
    whole = msgspec.msgpack.encode(event)
    packets += [b"", b"\xc1", whole + b"\0", b"\x81\xa1a\xc1", b"\x91" * 2**20]
    packets += [b"\xdf\xff\xff\xff\xff", b"\x81\xa1a\xdd\xff\xff\xff\xff", b"\x81\xa4type\xdb\xff"]
    results = decoded(pipe, packets)
    assert results[: len(cases)] == [status for _, status in cases]
    assert results[len(cases) :] == [MALFORMED] * 4 + [INVALID] + [MALFORMED] * 3


@pytest.mark.ci
def test_hostile_bytes_are_a_failure_or_what_msgspec_has(pipe: Path) -> None:
    """Cut messages everywhere, change single bytes, and make random ones.

    Integers of msgspec have no limit, those of the header have 64 bits.
    """
    rng = random.Random("hostile")
    whole = [msgspec.msgpack.encode(value) for _, value in answers("hostile", 6)]
    cut = [packet[:size] for packet in whole for size in range(min(len(packet), 600))]
    hostile = [rng.randbytes(rng.randrange(40)) for _ in range(3000)]
    for packet in (rng.choice(whole) for _ in range(20_000)):
        place = rng.randrange(len(packet))
        hostile.append(packet[:place] + rng.randbytes(1) + packet[place + 1 :])
    results = decoded(pipe, [*cut, *hostile])
    assert set(results[: len(cut)]) == {MALFORMED}
    agreed = 0
    for packet, result in zip(hostile, results[len(cut) :], strict=True):
        try:
            message = msgspec.msgpack.decode(packet, type=Answer)
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
        agreed += 1
        expected = answer_shown(message)
        assert result == (INVALID if exceeds(expected, 2**63 - 1) else expected), packet
    assert agreed > 0.2 * len(hostile)
