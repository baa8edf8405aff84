"""Tests of the answers to messages that are no commands, in the words of the documentation."""

import json

import pytest

from tactile.messages import JSON_PROTOCOL, MSGPACK_PROTOCOL, ArmDisplay, Failure
from tactile.server.decoding import ENCODINGS, Encoding, failed, read

JSON, MSGPACK = ENCODINGS[JSON_PROTOCOL], ENCODINGS[MSGPACK_PROTOCOL]
LARGEST_ID = 9007199254740992
"""The largest integer up to which a double has them all, and with it JavaScript."""


def failure(**fields: object) -> Failure:
    found = read(json.dumps(fields), JSON)
    assert isinstance(found, Failure)
    return found


@pytest.mark.parametrize("number", [0, 1, 106, 107, 2**31, LARGEST_ID])
def test_a_failure_carries_the_id_of_its_request(number: int) -> None:
    found = failure(type="arm", id=number, display=5)
    assert (found.id, found.code, found.field) == (number, "invalid_field", "display")
    assert found.message == "display = 5: expected str, got int"


@pytest.mark.parametrize("number", [-1, LARGEST_ID + 1, True, False, "7", 1.5, [7], None])
def test_what_is_no_id_is_not_answered_as_one(number: object) -> None:
    assert failure(type="arm", id=number, display=5).id is None


def test_the_largest_id_is_the_largest_that_is_taken() -> None:
    fields = {"type": "arm", "display": "right"}
    assert isinstance(read(json.dumps({**fields, "id": LARGEST_ID}), JSON), ArmDisplay)
    found = failure(**fields, id=LARGEST_ID + 1)
    assert (found.code, found.field) == ("invalid_field", "id")


@pytest.mark.parametrize(
    ("fields", "code", "field", "message"),
    [
        ({"type": "arm", "id": 7}, "invalid_field", "display", "Object missing required field"),
        ({"id": 7}, "invalid_field", "type", "Object missing required field"),
        (
            {"type": "amr", "id": 7},
            "unknown_type",
            "type",
            "type = 'amr': no command; did you",
        ),
        ({"type": 5, "id": 7}, "unknown_type", "type", "type = 5: no command; there is: hello,"),
    ],
)
def test_a_missing_field_and_an_unknown_command_are_told_apart(
    fields: dict[str, object], code: str, field: str, message: str
) -> None:
    found = failure(**fields)
    assert (found.id, found.code, found.field) == (7, code, field)
    assert message in found.message


def test_a_value_that_is_not_plain_is_not_repeated() -> None:
    found = failure(type="arm", id=7, display={"a": [1] * 1000})
    assert found.message == "display: expected str, got object"


def test_a_long_text_is_cut_to_200_characters_of_one_line() -> None:
    found = failure(type="z\n" * 100, id=7)
    assert found.message.startswith("type = 'z\\nz\\n")
    assert len(found.message) == 200
    assert found.message.endswith("…")
    assert "\n" not in found.message
    assert failed("malformed", "y" * 200).message == "y" * 200
    assert failed("malformed", "y" * 201).message == "y" * 199 + "…"


def test_a_long_value_is_shown_by_its_first_60_characters() -> None:
    found = failure(type="arm", id="x" * 100, display="right")
    assert found.message == f"id = '{'x' * 59}: expected int | null, got str"


@pytest.mark.parametrize("letter", ["y", "µ", "𝄞"])
def test_the_largest_message_has_64_kib(letter: str) -> None:
    text = letter * (2**16 // len(letter.encode()))
    messages: list[tuple[str | bytes, Encoding]] = [
        (text, JSON), (text + "z", JSON), (b"\xc1" * 2**16, MSGPACK), (b"\xc1" * 65537, MSGPACK),
    ]  # fmt: skip
    found = [read(data, encoding) for data, encoding in messages]
    codes = [one.code for one in found if isinstance(one, Failure)]
    assert codes == ["malformed", "too_large", "malformed", "too_large"]


def test_text_and_bytes_are_not_taken_for_each_other() -> None:
    assert read(b"{}", JSON) == Failure(
        code="malformed", message="a binary message: must be text, as it is JSON"
    )
    assert read("{}", MSGPACK) == Failure(
        code="malformed", message="a text message: must be binary, as it is MessagePack"
    )


def test_a_text_with_half_a_character_is_malformed() -> None:
    """UTF-16, as a browser has it, may have a lone surrogate; no bytes on a WebSocket do."""
    found = read('{"type": "\ud800"}', JSON)
    assert isinstance(found, Failure)
    assert found.code == "malformed"
