"""From bytes to a command, or to a `Failure` that says what is wrong, where, and what is allowed.

Nothing raises here, whatever the bytes are.
"""

import re
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import msgspec

from tactile.clock import MONOTONIC
from tactile.files import nearest
from tactile.messages import (
    JSON_PROTOCOL,
    LARGEST_MESSAGE,
    MSGPACK_PROTOCOL,
    Answer,
    Code,
    Command,
    EStop,
    Failure,
)
from tactile.server.rates import TokenBucket

LONGEST_TEXT = 200
"""Characters of a text in a failure."""
PATH = re.compile(r"(?s)(.*?)(?: - at `(?:key` in `)?\$\.?([^`]*)`)?")
MISSING = re.compile(r"Object missing required field `(\w+)`")
KINDS = [str(kind.__struct_config__.tag) for kind in get_args(Command)]
WRONG = (msgspec.MsgspecError, UnicodeError, RecursionError)
"""What msgspec raises for bytes that hold no message."""


HINTS = TokenBucket(20)
"""Of the whole daemon: a search for a similar name takes a millisecond."""


class Encoding(NamedTuple):
    """How messages are bytes, as the subprotocol says."""

    name: str
    kind: Literal["text", "bytes"]
    decode: Callable[[str | bytes], Command]
    decode_estop: Callable[[str | bytes], EStop]
    decode_any: Callable[[str | bytes], Any]
    encode: Callable[[Answer], bytes]


ENCODINGS = {
    JSON_PROTOCOL: Encoding(
        "JSON",
        "text",
        msgspec.json.Decoder(Command).decode,
        msgspec.json.Decoder(EStop).decode,
        msgspec.json.Decoder().decode,
        msgspec.json.Encoder().encode,
    ),
    MSGPACK_PROTOCOL: Encoding(
        "MessagePack",
        "bytes",
        msgspec.msgpack.Decoder(Command).decode,  # type: ignore[arg-type]
        msgspec.msgpack.Decoder(EStop).decode,  # type: ignore[arg-type]
        msgspec.msgpack.Decoder().decode,  # type: ignore[arg-type]
        msgspec.msgpack.Encoder().encode,
    ),
}


def read(data: str | bytes, encoding: Encoding) -> Command | Failure:
    """Return the command that a message holds, or what is wrong with it."""
    if isinstance(data, str) is not (encoding.kind == "text"):
        found = "text" if isinstance(data, str) else "binary"
        wanted = (
            "text, as it is JSON" if encoding.kind == "text" else "binary, as it is MessagePack"
        )
        return failed("malformed", f"a {found} message: must be {wanted}")
    if is_too_large(data):
        return failed("too_large", f"must be at most {LARGEST_MESSAGE} bytes")
    try:
        return encoding.decode(data)
    except msgspec.ValidationError as error:
        return _invalid(data, encoding, str(error))
    except WRONG as error:
        return failed("malformed", f"no {encoding.name}: {error}")


def read_estop(data: str | bytes, encoding: Encoding) -> EStop | None:
    """Return the e-stop that a message holds, if it does, without reading more than it must."""
    if isinstance(data, str) is not (encoding.kind == "text") or is_too_large(data):
        return None
    try:
        return encoding.decode_estop(data)
    except WRONG:
        return None


def hint(name: str, known: list[str]) -> str:
    """Return which known name was meant, or which there are; no more often than `HINTS` allows."""
    if HINTS.take(MONOTONIC.now()):
        return nearest(name, known)
    return "similar names are looked for 20 times a second at most"


def is_too_large(data: str | bytes) -> bool:
    """Return whether a message is larger than one may be; a character has 1 to 4 bytes."""
    if isinstance(data, str) and 4 * len(data) > LARGEST_MESSAGE:
        return len(data.encode("utf-8", "surrogatepass")) > LARGEST_MESSAGE
    return len(data) > LARGEST_MESSAGE


def failed(code: Code, message: str, *, field: str = "", to: int | None = None) -> Failure:
    """Return a failure whose text is one line of bounded length, to the request with an id."""
    line = " ".join(message.split())
    if len(line) > LONGEST_TEXT:
        line = line[: LONGEST_TEXT - 1] + "…"
    return Failure(id=to, code=code, message=line, field=field[:LONGEST_TEXT])


def _invalid(data: str | bytes, encoding: Encoding, error: str) -> Failure:
    """Tell what does not fit, as msgspec said it, with the value that stands there."""
    found = PATH.fullmatch(error)
    problem, field = (found[1], found[2] or "") if found else (error, "")
    if missing := MISSING.match(problem):
        field = f"{field}.{missing[1]}".removeprefix(".")
    try:
        content = encoding.decode_any(data)
    except msgspec.ValidationError:  # a number that is none, somewhere in it
        content = None
    except WRONG as worse:
        return failed("malformed", f"no {encoding.name}: {worse}")
    asked = content.get("id") if isinstance(content, dict) else None
    good = type(asked) is int and 0 <= asked <= 2**53
    code: Code = "unknown_type" if field == "type" and not missing else "invalid_field"
    if code == "unknown_type":
        said = str(content.get("type"))[:60] if isinstance(content, dict) else ""
        problem = f"no command; {hint(said, KINDS)}"
    text = f"{_shown(content, field)}{problem.replace('Expected', 'expected').replace('`', '')}"
    return failed(code, text, field=field, to=asked if good else None)


def _shown(value: Any, field: str) -> str:
    """Return "field = value: ", without a value that is none or not a plain one."""
    if not field:
        return ""
    for key in re.findall(r"[^.\[\]]+", field):
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, IndexError, TypeError, ValueError):
            value = None
    plain = isinstance(value, int | float | str)
    return f"{field} = {repr(value)[:60]}: " if plain else f"{field}: "
