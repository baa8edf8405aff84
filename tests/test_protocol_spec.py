"""SPEC.md and schema.toml say the same: tables, codes, counters and numbers.

SPEC.md is read as text; whoever changes one of the two and not the other fails here.
"""

import re
from pathlib import Path

import pytest
from slow_codec import slow_crc

from firmware_protocol import clock, generate, i2c_link
from firmware_protocol.messages import MAJOR, MESSAGES, MINOR, SCHEMA_CRC
from firmware_protocol.packet import decode_packet
from tactile.bus import wire
from tactile.bus.link import queries as aside
from tactile.bus.link import session, stream

SCHEMA = generate.load()
SPEC = re.sub(
    r"(?<=[^|\n])\n(?![|#\n]|- |\d\. |```) *",
    " ",
    (Path(generate.__file__).parent / "SPEC.md").read_text("utf-8"),
)
"""Text of SPEC.md with each of its paragraphs and items in one line."""


def section(number: str) -> str:
    """Return the text of a section of SPEC.md, subsections included."""
    level = "#" * (2 + number.count("."))
    to_next = rf".*?(?=^#{{2,{len(level)}}} |\Z)"
    found = re.search(rf"^{level} {re.escape(number)} {to_next}", SPEC, re.M | re.S)
    assert found, number
    return found[0]


def rows(text: str) -> list[list[str]]:
    """Return the cells of all table rows in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def counters_of_spec() -> list[str]:
    listed = section("12").split("of STATUS are, in order: ")[1].split(". They")[0]
    return [name.strip() for name in re.sub(r" \([^)]*\)", "", listed).split(",")]


def fields_of(text: str) -> list[list[str]]:
    """Return the names and types of the fields that a cell lists."""
    return [list(pair) for pair in re.findall(r"(\w+) ([ui]\d+|char16)\b", text)]


def messages_of_spec() -> dict[int, tuple[str, str, list[list[str]], str | None]]:
    """Return name, sender, fields and body by id, as the tables of section 4 give them."""
    found: dict[int, tuple[str, str, list[list[str]], str | None]] = {}
    for sender in ("host", "amplifier"):
        text = section("4").split(f"### From the {sender}")[1].split("###")[0]
        for cells in rows(text):
            if not re.fullmatch("[0-9A-F]{2}", cells[0]):
                continue
            body = re.search(r"\*(\w+)\*", cells[2])
            listed, *rest = cells[2].split("then a u32 for each counter of section 12")
            fields = fields_of(listed)
            for tail in rest:
                fields += [[name, "u32"] for name in counters_of_spec()] + fields_of(tail)
            found[int(cells[0], 16)] = (cells[1], sender, fields, body[1] if body else None)
    return found


def test_the_message_tables_of_the_spec_are_the_schema() -> None:
    schema = {
        d["id"]: (
            re.sub(r"\B([A-Z])", r"_\1", d["name"]).upper(),
            d["from"],
            d["fields"],
            d.get("body"),
        )
        for d in SCHEMA["message"]
    }
    assert messages_of_spec() == schema


def test_the_counters_of_the_spec_are_those_of_status() -> None:
    """All of STATUS but its head and what version 1.1 added at the end."""
    (status,) = (d for d in SCHEMA["message"] if d["name"] == "Status")
    names = [name for name, _ in status["fields"]]
    assert names[names.index("packets") : -1] == counters_of_spec()
    assert names[-1] == "inputs"


def test_the_state_table_of_the_spec_is_the_schema() -> None:
    events = {
        "HELLO of another session": "hello_other",
        "fault of the hardware": "fault",
        "e-stop input opens": "estop_input",
        **{e.upper(): e for e in SCHEMA["table"]},
        "watchdog": "watchdog",
    }
    table = section("6").split("| event |")[1]
    states, *lines = rows("| event |" + table)
    found = {events[cells[0]]: dict(zip(states[1:], cells[1:], strict=True)) for cells in lines[1:]}
    assert found == SCHEMA["table"]


def test_states_parameters_formats_and_classes_of_the_spec_are_the_schema() -> None:
    """The tables list number and name of each."""

    def named(text: str) -> dict[str, int]:
        return {c[1]: int(c[0]) for c in rows(text) if c[0].isdigit()}

    enums = SCHEMA["enum"]
    assert named(section("6").split("What each event does")[0]) == enums["state"]
    assert named(section("4").split("### Parameters")[1]) == enums["parameter"]
    assert named(section("3.2").split("Other combinations")[0]) == enums["can_class"]
    assert named(section("9")) == enums["sample_format"]
    phases = re.findall(r"\*\*([A-Z]+)\*\* \((\d)\)", section("8.2"))
    still = re.search(r"([A-Z]+) \((0)\)", section("8.2"))
    assert still
    found = {name: int(number) for name, number in [(still[1], still[2]), *phases]}
    assert found == enums["phase"]


def test_every_code_that_the_spec_names_is_in_the_schema() -> None:
    """Names of NAK codes stand in section 5 and in the table of section 6, their numbers in 5.1."""
    checks, values = section("5").split("Check 9 is, for each message in this order:")
    named = set(re.findall(r"[:.] ([A-Z_]{4,})(?: \(\w+\))?,", values))
    named |= set(re.findall(r"!([A-Z_]{4,})", section("6")))
    named |= set(re.findall(r"\| ([A-Z_]{4,}),", checks))
    named |= set(re.findall(r"NAK ([A-Z_]{4,})", SPEC))
    assert named == set(SCHEMA["enum"]["nak"])
    numbers = {name: int(code) for name, code, _ in rows(section("5.1"))[2:]}
    assert numbers == SCHEMA["enum"]["nak"]


def test_every_counter_that_the_checks_name_is_one() -> None:
    counted = {c[2].split(",")[0] for c in rows(section("5")) if c[0].isdigit()} - {"–", "as below"}
    counted |= set(re.findall(r"\((?:counted )?((?:wrong_|mal)\w+)\)", section("5")))
    assert counted <= set(counters_of_spec())
    assert counted >= {"crc_errors", "wrong_version", "wrong_format", "wrong_channel", "malformed"}


def test_numbers_that_the_spec_gives_are_those_of_the_schema() -> None:
    limits = SCHEMA["limits"]
    for number, text in (
        (limits["PACKET_MAX"], r"A packet is 8 … (\d+) bytes"),
        (limits["FRAGMENT_TIMEOUT_MS"], r"when (\d+) ms or more have passed since its start"),
        (limits["WATCHDOG_MS"], r"first sample instant \(7\.1\) (\d+) ms or more"),
        (limits["WATCHDOG_MS"], r"SAFE, and free, (\d+) ms after"),
        (limits["HEARTBEAT_MS"], r"HEARTBEAT every (\d+) ms"),
        (limits["INPUT_CLOSED_MS"], r"contact has been closed for (\d+) ms"),
        (limits["UNGUARDED_MOST_UV"] // 10**6, r"`full_scale_uv` is above (\d+) 000 000 MUST"),
        (SCHEMA["enum"]["estop_reason"]["INPUT"], r"0 for (\d+), which is the e-stop input's"),
        (limits["START_AHEAD_MS"] // 1000, r"or more than (\d+) s after: TIME"),
        (limits["FULL_SCALE_CODE"], r"integer −32767 … (\d+)"),
        (limits["CARRIERS_MAX"], r"\| carriers \| 0 \| (\d+) \|"),
        (1000 // limits["VALID_MS"], r"at most ⌊rate / (\d+)⌋"),
        (limits["LAGS"], r"lags: (\d+)\. Per channel an entry"),
        (limits["LAGS"] - 1, r"n = p … p \+ L − 1,  l = 0 … (\d+)"),
        (limits["CORRELATED_MOST"], r"each with min\((\d+), ⌊\(packet_limit − 19\) / 36⌋"),
        (limits["EXPONENT_MOST"], r"It is never above (\d+)"),
        (SCHEMA["protocol"]["major"], r"major version \((\d)\)"),
    ):
        found = re.search(text, SPEC)
        assert found, text
        assert number == int(found[1]), text
    assert f"0x{limits['CAN_PREFIX']:X} + the 11-bit" in SPEC
    for kind, name in (
        ("feature", "ESTOP_INPUT"),
        ("feature", "CORRELATES"),
        ("window", "CLIPPED"),
    ):
        bit = re.search(rf"bit (\d) `{name}`", SPEC)
        assert bit, name
        assert 1 << int(bit[1]) == SCHEMA["enum"][kind][name]
    assert SPEC.startswith(f"# The tactile amplifier protocol, version {MAJOR}.{MINOR}")


def test_numbers_that_the_spec_gives_are_those_of_the_host() -> None:
    words = {"three": 3, "four": 4, "ten": 10, "half": 0.5}
    for number, text in (
        (1e3 * stream.LEAD, r"A host starts with (\d+) ms of lead"),
        (1e3 * stream.MOST_LEAD, r"at an underrun, to (\d+) ms at most"),
        (1e3 * stream.LEAST_LEAD, r"per second to (\d+) ms at least"),
        (stream.RAISE, r"raises the lead by (\w+) at an underrun"),
        (1e3 * stream.LOWER, r"lowers it by ([\d.]+) ms per second"),
        (1e3 * aside.RETRY, r"sends the same packet, seq included, again after (\d+) ms"),
        (aside.TRIES, r"again after 50 ms, (\w+) times in all"),
        (clock.FIRST_PROBES, r"A host sends (\d+) at connection"),
        (1e3 * clock.INTERVAL, r"\(([\d.]+) ms does not\)"),
        (1e3 * session.QUEUED, r"while more than (\d+) ms of data are on their way"),
        (wire.REORDERED, r"A host that counts (\w+) in a second SHOULD say"),
        (i2c_link.WRITE_COMMAND, r"block writes with command 0x([0-9A-F]+)"),
        (i2c_link.READ_COMMAND, r"block reads with command 0x([0-9A-F]+)"),
        (i2c_link.SMBUS_BLOCK, r"carry fragments of at most (\d+) bytes"),
        (i2c_link.DEFAULT_LIMIT, r"`packet_limit` \(by default (\d+)\) bytes"),
    ):
        found = re.search(text, SPEC)
        assert found, text
        told = words.get(found[1]) or float(int(found[1], 16) if "0x" in text else found[1])
        told += text.startswith("raises")  # by half: one and a half times
        assert number == pytest.approx(told), text


def test_the_schema_crc_is_that_of_the_lines_of_section_13() -> None:
    """Build the lines from the tables of SPEC.md alone, and take the bitwise CRC."""
    lines = ""
    for number, (upper, _, fields, body) in sorted(messages_of_spec().items()):
        title = "".join(word.capitalize() for word in upper.split("_"))
        parts = [f"{name}:{kind}" for name, kind in fields] + ([f"{body}:body"] if body else [])
        lines += " ".join([title, str(number), *parts]) + "\n"
    assert slow_crc(lines.encode()) == SCHEMA_CRC
    text = section("13")
    assert f"of version {MAJOR}.{MINOR} is 0x{SCHEMA_CRC:08X}." in text
    examples = re.findall(r"`([A-Z][a-z]+ \d+[^`]*)`", text)
    assert len(examples) == 3
    assert {f"{example}\n" for example in examples} <= set(lines.splitlines(keepends=True))


def test_the_worked_packets_of_the_spec_are_of_the_messages_that_they_name() -> None:
    """Types and CRC-32 hold, every field survives decoding and encoding, no message is missing."""
    names = {number: name for number, (name, *_) in messages_of_spec().items()}
    seen = set()
    for cells in rows(section("15")):
        if cells[0] not in names.values():
            continue
        data = bytes.fromhex(cells[2].strip("`"))
        assert slow_crc(data[:-4]) == int.from_bytes(data[-4:], "little"), cells
        packet = decode_packet(data)
        assert packet is not None
        assert names[packet.type] == cells[0]
        message = MESSAGES[packet.type].unpack(packet.payload)
        assert message is not None
        assert message.pack() == packet.payload
        seen.add(packet.type)
    assert seen == set(names)
