"""Decoding of messages: bytes become a command, or a `Failure` that says what is wrong and where.

Nothing here raises, whatever the bytes are.
"""

import re
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import msgspec

from tactile.clock import MONOTONIC
from tactile.errors import locate_mistake, show_field
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
"""Maximum length of a text in a failure [characters]."""
LONGEST_VALUE = 60
"""Maximum length of a value in a failure [characters]."""
MISSING = re.compile(r"Object missing required field (\w+)")
"""Error of msgspec about a missing field."""
KINDS = [str(kind.__struct_config__.tag) for kind in get_args(Command)]
"""Types of the messages that a client may send."""
WRONG = (msgspec.MsgspecError, UnicodeError, RecursionError)
"""Exceptions that msgspec raises for bytes that hold no message."""


HINTS = TokenBucket(20)
"""Limit on the rate at which the whole server searches for similar names, as one search takes a
millisecond."""


class Encoding(NamedTuple):
    """Encoding of messages, as chosen by the subprotocol.

    Attributes
    ----------
    name : str
        Name of the encoding.
    kind : str
        Kind of the WebSocket frames, "text" or "bytes".
    decode : callable
        Function from the contents of a frame to a command.
    decode_estop : callable
        Function from the contents of a frame to an e-stop.
    decode_any : callable
        Function from the contents of a frame to plain data.
    encode : callable
        Function from an answer to bytes.
    """

    name: str
    kind: Literal["text", "bytes"]
    decode: Callable[[str | bytes], Command]
    decode_estop: Callable[[str | bytes], EStop]
    decode_any: Callable[[str | bytes], Any]
    encode: Callable[[Answer], bytes]


def _encoding(name: str, kind: Literal["text", "bytes"], codec: Any) -> Encoding:
    """Return the encoding of a module of msgspec."""
    return Encoding(
        name, kind, codec.Decoder(Command).decode, codec.Decoder(EStop).decode,
        codec.Decoder().decode, codec.Encoder().encode,
    )  # fmt: skip


ENCODINGS = {
    JSON_PROTOCOL: _encoding("JSON", "text", msgspec.json),
    MSGPACK_PROTOCOL: _encoding("MessagePack", "bytes", msgspec.msgpack),
}
"""Encodings by subprotocol."""


def read(data: str | bytes, encoding: Encoding) -> Command | Failure:
    """Decode a message.

    Parameters
    ----------
    data : str or bytes
        Contents of a WebSocket frame.
    encoding : Encoding
        Encoding of the connection.

    Returns
    -------
    Command or Failure
        The command, or what is wrong with the message.
    """
    if isinstance(data, str) is not (encoding.kind == "text"):
        received = "text" if isinstance(data, str) else "binary"
        required = (
            "text, as it is JSON" if encoding.kind == "text" else "binary, as it is MessagePack"
        )
        return failed("malformed", f"a {received} message: must be {required}")
    if is_too_large(data):
        return failed("too_large", f"must be at most {LARGEST_MESSAGE} bytes")
    try:
        return encoding.decode(data)
    except msgspec.ValidationError as error:
        return _invalid(data, encoding, str(error))
    except WRONG as error:
        return failed("malformed", f"no {encoding.name}: {error}")


def read_estop(data: str | bytes, encoding: Encoding) -> EStop | None:
    """Decode a message if it is an e-stop, with as little work as possible.

    Parameters
    ----------
    data : str or bytes
        Contents of a WebSocket frame.
    encoding : Encoding
        Encoding of the connection.

    Returns
    -------
    EStop or None
        The e-stop; None for any other message.
    """
    if isinstance(data, str) is not (encoding.kind == "text") or is_too_large(data):
        return None
    try:
        return encoding.decode_estop(data)
    except WRONG:
        return None


def hint(name: str, known: list[str]) -> str:
    """Suggest a known name in place of an unknown one, no more often than `HINTS` allows.

    Parameters
    ----------
    name : str
        Unknown name.
    known : list of str
        Names that exist.

    Returns
    -------
    str
        Part of a message that names similar or all known names.
    """
    if HINTS.take(MONOTONIC.now()):
        return nearest(name, known)
    return "similar names are looked for 20 times a second at most"


def is_too_large(data: str | bytes) -> bool:
    """Check whether a message exceeds `LARGEST_MESSAGE`.

    Parameters
    ----------
    data : str or bytes
        Contents of a WebSocket frame; a character takes 1 to 4 bytes.

    Returns
    -------
    bool
        Whether it is too large.
    """
    if isinstance(data, str) and 4 * len(data) > LARGEST_MESSAGE:
        return len(data.encode("utf-8", "surrogatepass")) > LARGEST_MESSAGE
    return len(data) > LARGEST_MESSAGE


def failed(code: Code, message: str, *, field: str = "", to: int | None = None) -> Failure:
    """Create a failure whose text is one line of bounded length.

    Parameters
    ----------
    code : Code
        Kind of the failure.
    message : str
        Explanation.
    field : str
        Path of the offending field.
    to : int, optional
        Id of the request.

    Returns
    -------
    Failure
        The failure.
    """
    line = " ".join(message.split())
    if len(line) > LONGEST_TEXT:
        line = line[: LONGEST_TEXT - 1] + "…"
    return Failure(id=to, code=code, message=line, field=field[:LONGEST_TEXT])


def _invalid(data: str | bytes, encoding: Encoding, error: str) -> Failure:
    """Return a failure that says, by an error of msgspec, which field and value are invalid."""
    field, problem = locate_mistake(error)
    if missing := MISSING.match(problem):
        field = f"{field}.{missing[1]}".removeprefix(".")
    try:
        content = encoding.decode_any(data)
    except msgspec.ValidationError:  # an invalid number somewhere in the message
        content = None
    except WRONG as worse:
        return failed("malformed", f"no {encoding.name}: {worse}")
    request_id = content.get("id") if isinstance(content, dict) else None
    good = type(request_id) is int and 0 <= request_id <= 2**53
    code: Code = "unknown_type" if field == "type" and not missing else "invalid_field"
    if code == "unknown_type":
        kind = str(content.get("type"))[:60] if isinstance(content, dict) else ""
        problem = f"no command; {hint(kind, KINDS)}"
    text = show_field(content, field, LONGEST_VALUE) + problem
    return failed(code, text, field=field, to=request_id if good else None)
