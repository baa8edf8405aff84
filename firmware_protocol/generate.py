"""Generator of messages.py, c/tactile_messages.h and model/table.pml from schema.toml.

``python -m firmware_protocol.generate`` writes the files. With ``--check`` it writes nothing: it
names the files that differ from what it would write, and exits with code 1 if there are any.
"""

import sys
import tomllib
import zlib
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
"""Folder of the schema and of the generated Python module."""
SIZES = {"u8": 1, "u16": 2, "u32": 4, "u64": 8, "i16": 2, "char16": 16}
"""Size of each type on the wire [bytes]."""
STRUCT = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i16": "h", "char16": "16s"}
"""Code of each type in the format of Python's struct module."""
C_TYPES = {
    "u8": "uint8_t", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t", "i16": "int16_t",
}  # fmt: skip
"""C type of each type that is an integer."""
STATES = ("IDLE", "ARMED", "RUNNING", "RAMPDOWN", "SAFE", "FAULT", "ESTOP")
"""States in the order of the columns of the state table."""
REFUSED, STAYS = 0x80, 0x40
"""Entries of the state table: `REFUSED` with the NAK code in the low bits, `STAYS` alone, or
else state | next << 3, where next is the state that follows RAMPDOWN."""

Schema = dict[str, Any]
"""Content of schema.toml."""
Message = dict[str, Any]
"""Definition of a message in the schema."""


def load(path: Path = HERE / "schema.toml") -> Schema:
    """Load the schema.

    Parameters
    ----------
    path : Path
        Schema file.

    Returns
    -------
    dict
        Schema as plain data.
    """
    return tomllib.loads(path.read_text("utf-8"))


def schema_crc(schema: Schema) -> int:
    """Compute the CRC-32 of the message definitions (section 13 of SPEC.md).

    Parameters
    ----------
    schema : dict
        Schema.

    Returns
    -------
    int
        CRC-32.
    """
    lines = []
    for message in sorted(schema["message"], key=lambda m: m["id"]):
        parts = [message["name"], str(message["id"])]
        parts += [f"{name}:{kind}" for name, kind in message["fields"]]
        if "body" in message:
            parts.append(f"{message['body']}:body")
        lines.append(" ".join(parts) + "\n")
    return zlib.crc32("".join(lines).encode())


def entry(text: str, schema: Schema) -> int:
    """Encode a cell of the state table as one byte.

    Parameters
    ----------
    text : str
        Cell as in the schema.
    schema : dict
        Schema, for the numbers of states and NAK codes.

    Returns
    -------
    int
        Entry of the generated table.
    """
    states, naks = schema["enum"]["state"], schema["enum"]["nak"]
    if text == "=":
        return STAYS
    if text.startswith("!"):
        return REFUSED | int(naks[text[1:]])
    state, _, then = text.partition(":")
    return int(states[state]) | (int(states[then]) << 3 if then else 0)


def table(schema: Schema) -> dict[str, list[int]]:
    """Encode the state table.

    Parameters
    ----------
    schema : dict
        Schema.

    Returns
    -------
    dict of str to list of int
        For each event, an entry per state.
    """
    return {
        event: [entry(row[state], schema) for state in STATES]
        for event, row in schema["table"].items()
    }


def _title(name: str) -> str:
    """Return the name of an enumeration's class."""
    if name == "nak":
        return "NakCode"
    return "".join(word.capitalize() for word in name.split("_"))


def _upper(name: str) -> str:
    """Return a name in capitals, such as CLEAR_FAULT for ClearFault."""
    return "".join(f"_{c}" if c.isupper() and i else c for i, c in enumerate(name)).upper()


# Python


def _python_head(schema: Schema) -> list[str]:
    """Return the lines of messages.py before its enumerations."""
    texts = schema["texts"]["limits"]
    return [
        '"""Messages, codes and states of the protocol; written by generate.py from schema.toml.',
        "",
        "SPEC.md defines their meaning.",
        '"""',
        "",
        "from dataclasses import dataclass",
        "from enum import IntEnum",
        "from struct import Struct",
        "",
        "from firmware_protocol.layout import Message as Message",
        "",
        f"MAJOR, MINOR = {schema['protocol']['major']}, {schema['protocol']['minor']}",
        f"SCHEMA_CRC = 0x{schema_crc(schema):08X}",
        f"STAYS, REFUSED = 0x{STAYS:02X}, 0x{REFUSED:02X}",
        *(
            line
            for name, value in schema["limits"].items()
            for line in (f"{name} = {_number(value)}", f'"""{texts[name]}"""')
        ),
    ]


def python_text(schema: Schema) -> str:
    """Generate messages.py.

    Parameters
    ----------
    schema : dict
        Schema.

    Returns
    -------
    str
        Text of the module.
    """
    lines = _python_head(schema)
    for name, members in schema["enum"].items():
        lines += ["", "", f"class {_title(name)}(IntEnum):"]
        lines += [f'    """{schema["texts"]["enum"][name]}"""', ""]
        lines += [f"    {member} = {_number(value)}" for member, value in members.items()]
    lines += ["", "", "TABLE: dict[str, tuple[int, ...]] = {"]
    lines += [
        f'    "{event}": ({", ".join(f"0x{cell:02X}" for cell in cells)}),'
        for event, cells in table(schema).items()
    ]
    lines += [
        "}",
        '"""State table of section 6: for each event an entry per state, in the order of `State`.',
        "",
        "An entry is `STAYS`, `REFUSED` | NAK code, or state | next << 3, where next is the state",
        "that follows RAMPDOWN.",
        '"""',
    ]
    for message in schema["message"]:
        lines += ["", "", *_python_message(message)]
    lines += ["", "", "MESSAGES: dict[int, type[Message]] = {"]
    lines += [f"    0x{m['id']:02X}: {m['name']}," for m in schema["message"]]
    lines += ["}", '"""Classes of the messages by their type."""', ""]
    return "\n".join(lines)


def _number(value: int) -> str:
    """Return a number as source text, in hexadecimal above 4096 with two exceptions."""
    return f"0x{value:02X}" if value > 4096 and value != 10000 and value != 32767 else str(value)


def _python_message(message: Message) -> list[str]:
    """Return the lines of a message's class."""
    fields, body = message["fields"], message.get("body")
    code = "<" + "".join(STRUCT[kind] for _, kind in fields)
    types = {"char16": "bytes"}
    lines = ["@dataclass(frozen=True, slots=True)", f"class {message['name']}(Message):"]
    title = f"{_upper(message['name'])} from the {message['from']}: {message['text']}"
    lines += [f'    """{title} (section 4)."""', ""]
    lines += [
        f"    TYPE = 0x{message['id']:02X}",
        f"    CAN = CanClass.{message['can']}",
        f'    HEAD = Struct("{code}")',
        *(["    BODY = True"] if body else []),
        *([""] if fields else []),
    ]
    lines += [
        f"    {name}: {types.get(kind, 'int')} = {'b' + chr(34) * 2 if kind == 'char16' else 0}"
        for name, kind in fields
    ]
    if body:
        lines.append(f'    {body}: bytes = b""')
    return lines


# C


def c_text(schema: Schema) -> str:
    """Generate c/tactile_messages.h.

    Parameters
    ----------
    schema : dict
        Schema.

    Returns
    -------
    str
        Text of the header.
    """
    lines = [
        "/* Messages, codes and states of the protocol; written by generate.py from schema.toml.",
        " *",
        " * SPEC.md defines their meaning. tp_X_encode writes a payload and returns its size, or 0",
        " * if it does not fit. tp_X_decode decodes a payload: a missing tail reads as 0 and an",
        " * unknown tail is ignored. It returns false for a payload that is shorter than the head",
        " * of a message with a body. Bodies are pointers into the payload.",
        " */",
        "#ifndef TACTILE_MESSAGES_H",
        "#define TACTILE_MESSAGES_H",
        "",
        "#include <stdbool.h>",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "#include <string.h>",
        "",
        f"#define TP_MAJOR {schema['protocol']['major']}u",
        f"#define TP_MINOR {schema['protocol']['minor']}u",
        f"#define TP_SCHEMA_CRC 0x{schema_crc(schema):08X}u",
        f"#define TP_TABLE_STAYS 0x{STAYS:02X}u",
        f"#define TP_TABLE_REFUSED 0x{REFUSED:02X}u",
    ]
    lines += [f"#define TP_{name} {_number(value)}u" for name, value in schema["limits"].items()]
    for name, members in schema["enum"].items():
        lines += ["", "enum {"]
        lines += [f"    TP_{name.upper()}_{m} = {_number(v)}," for m, v in members.items()]
        lines[-1] = lines[-1].rstrip(",")
        lines.append("};")
    lines += ["", "/* State table of section 6: an entry per state. */"]
    for event, cells in table(schema).items():
        joined = ", ".join(f"0x{cell:02X}u" for cell in cells)
        lines.append(f"#define TP_TABLE_{event.upper()} {{{joined}}}")
    lines += ["", *C_HELPERS.splitlines()]
    for message in schema["message"]:
        lines += ["", *_c_message(message)]
    lines += ["", "#endif", ""]
    return "\n".join(lines)


C_HELPERS = """\
static inline void tp_put_le(uint8_t *out, uint64_t value, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        out[i] = (uint8_t)(value >> (8u * i));
    }
}

/* Bytes beyond the end read as 0. */
static inline uint64_t tp_get_le(const uint8_t *in, size_t length, size_t at, size_t size)
{
    uint64_t value = 0;
    for (size_t i = 0; i < size && at + i < length; i++) {
        value |= (uint64_t)in[at + i] << (8u * i);
    }
    return value;
}"""
"""Functions of the header that the coding functions use."""


def _c_message(message: Message) -> list[str]:
    """Return the lines of a message's structure and coding functions."""
    fields, body = message["fields"], message.get("body")
    upper, name = _upper(message["name"]), _upper(message["name"]).lower()
    size = sum(SIZES[kind] for _, kind in fields)
    lines = [f"#define TP_{upper} 0x{message['id']:02X}u", f"#define TP_{upper}_SIZE {size}u"]
    lines += ["typedef struct {"]
    for field, kind in fields:
        if kind == "char16":
            lines.append(f"    char {field}[16];")
        else:
            lines.append(f"    {C_TYPES[kind]} {field};")
    if body:
        lines += [f"    const uint8_t *{body};", f"    size_t {body}_size;"]
    if not fields and not body:
        lines.append("    uint8_t nothing;")
    lines += [f"}} tp_{name};", ""]
    lines += [*_c_encode(name, upper, fields, body, size), ""]
    return lines + _c_decode(name, upper, fields, body, size)


def _c_encode(
    name: str, upper: str, fields: list[list[str]], body: str | None, size: int
) -> list[str]:
    """Return the lines of a message's encoding function."""
    lines = [
        f"static inline size_t tp_{name}_encode(const tp_{name} *m, uint8_t *out, size_t room)",
        "{",
    ]
    if body:
        lines += [
            f"    if (room < TP_{upper}_SIZE || room - TP_{upper}_SIZE < m->{body}_size) {{",
        ]
    elif fields:
        lines += [f"    if (room < TP_{upper}_SIZE) {{"]
    else:
        return [*lines, "    (void)m;", "    (void)out;", "    (void)room;", "    return 0;", "}"]
    lines += ["        return 0;", "    }"]
    at = 0
    for field, kind in fields:
        if kind == "char16":
            lines.append(f"    memcpy(out + {at}, m->{field}, 16);")
        else:
            lines.append(f"    tp_put_le(out + {at}, (uint64_t)m->{field}, {SIZES[kind]});")
        at += SIZES[kind]
    if body:
        lines += [
            f"    if (m->{body}_size > 0) {{",
            f"        memcpy(out + TP_{upper}_SIZE, m->{body}, m->{body}_size);",
            "    }",
            f"    return TP_{upper}_SIZE + m->{body}_size;",
        ]
    else:
        lines.append(f"    return {size};")
    return [*lines, "}"]


def _c_decode(
    name: str, upper: str, fields: list[list[str]], body: str | None, size: int
) -> list[str]:
    """Return the lines of a message's decoding function."""
    lines = [
        f"static inline bool tp_{name}_decode(tp_{name} *m, const uint8_t *in, size_t length)",
        "{",
    ]
    if not fields and not body:
        nothing = ["    (void)in;", "    (void)length;", "    m->nothing = 0;", "    return true;"]
        return [*lines, *nothing, "}"]
    if body:
        lines += [f"    if (length < TP_{upper}_SIZE) {{", "        return false;", "    }"]
    at = 0
    for field, kind in fields:
        if kind == "char16":
            lines += [
                f"    memset(m->{field}, 0, 16);",
                f"    if (length > {at}) {{",
                f"        memcpy(m->{field}, in + {at}, length - {at} < 16 ? length - {at} : 16);",
                "    }",
            ]
        else:
            lines.append(
                f"    m->{field} = ({C_TYPES[kind]})tp_get_le(in, length, {at}, {SIZES[kind]});"
            )
        at += SIZES[kind]
    if body:
        lines += [f"    m->{body} = in + {size};", f"    m->{body}_size = length - {size};"]
    return [*lines, "    return true;", "}"]


# Promela

TIMES = ("WATCHDOG_MS", "FADE_MS", "INPUT_CLOSED_MS")
"""Limits of the schema that the model has."""


def _promela_cell(text: str) -> str:
    """Return a cell of the state table, as in the schema, as a Promela expression.

    It has no parentheses, which SPIN does not take after the arrow of a condition.
    """
    if text == "=":
        return "STAYS"
    state, _, then = text.partition(":")
    if state.startswith("!"):
        return f"REFUSED | NAK_{state[1:]}"
    return f"{state} | {then} << 3" if then else state


def promela_text(schema: Schema) -> str:
    """Generate model/table.pml.

    Parameters
    ----------
    schema : dict
        Schema.

    Returns
    -------
    str
        Text of the include file, in which the cells of an event are an expression of `state`.
    """
    lines = [
        "/* Times, messages, states, codes of NAK and the table of states of section 6, written by",
        " * generate.py from schema.toml. A cell is STAYS, REFUSED | code of NAK, or",
        " * state | next << 3, where next is the state that follows RAMPDOWN. */",
        f"#define STAYS {STAYS}",
        f"#define REFUSED {REFUSED}",
        *(f"#define {name} {schema['limits'][name]}" for name in TIMES),
        *(
            f"#define M_{_upper(message['name'])} {message['id']}"
            for message in schema["message"]
            if message["from"] == "host"
        ),
        *(f"#define {name} {value}" for name, value in schema["enum"]["state"].items()),
        *(f"#define NAK_{name} {value}" for name, value in schema["enum"]["nak"].items()),
    ]
    for event, row in schema["table"].items():
        lines += ["", f"#define TABLE_{event.upper()} ( \\"]
        lines += [f"    state == {s} -> {_promela_cell(row[s])} : ( \\" for s in STATES[:-1]]
        lines.append(f"    {_promela_cell(row[STATES[-1]])}{')' * len(STATES)}")
    return "\n".join([*lines, ""])


def outputs() -> dict[Path, str]:
    """Generate the text of each file.

    Returns
    -------
    dict of Path to str
        Texts by path.
    """
    schema = load()
    return {
        HERE / "messages.py": python_text(schema),
        HERE / "c" / "tactile_messages.h": c_text(schema),
        HERE / "model" / "table.pml": promela_text(schema),
    }


def main(arguments: list[str]) -> int:
    """Write the files, or name those that differ.

    Parameters
    ----------
    arguments : list of str
        Command line arguments.

    Returns
    -------
    int
        Exit code.
    """
    differing = [
        p for p, text in outputs().items() if not p.exists() or p.read_text("utf-8") != text
    ]
    for path in differing:
        if "--check" in arguments:
            print(f"{path.name} differs; run python -m firmware_protocol.generate", file=sys.stderr)
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(outputs()[path], "utf-8")
            print(f"wrote {path.name}")
    return int(bool(differing) and "--check" in arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
