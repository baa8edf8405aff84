"""Options of a device URL, which each driver declares in one Struct.

`decode` checks the text of all options once and returns typed values. The error of a mistake is one
line that names the option, its value and what is allowed.
"""

from collections.abc import Mapping
from typing import Any, Literal, TypeVar

import msgspec
from msgspec import inspect

from firmware_protocol.messages import SampleFormat
from tactile.bus.wire_time import Link
from tactile.errors import InputError
from tactile.files import nearest

FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
"""Values of a bool option by their texts, in lower case."""
FORMATS = {
    "pcm16": SampleFormat.PCM16,
    "pcm12": SampleFormat.PCM12,
    "bfp8": SampleFormat.BFP8,
    "spectrum": SampleFormat.SPECTRUM8,
}
"""Sample formats on a link by their names in a URL."""
HEXADECIMAL = {"hexadecimal": True}
"""Mark of an integer, in `msgspec.Meta.extra`, whose limits are printed in hexadecimal."""

SampleFormatName = Literal["pcm16", "pcm12", "bfp8"]
"""Name of a format that carries samples."""
FormatName = Literal["pcm16", "pcm12", "bfp8", "spectrum"]
"""Name of any format."""
Keep = Literal["second", "all"]
"""Amount of output that a simulated amplifier keeps: the last second, or all of it."""


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """Options of a device URL; a driver that has none uses this base class itself.

    A field is a bool, a str, an int or float with limits, a Literal, or a tuple of int, which the
    URL separates by commas. Each has a default.
    """

    @property
    def medium(self) -> Link | None:
        """Medium by which packets go; None for a bus that does not carry the protocol."""
        return None


O = TypeVar("O", bound=Options)  # noqa: E741


def decode(scheme: str, texts: Mapping[str, str], shape: type[O]) -> O:
    """Decode the options of a device URL.

    Parameters
    ----------
    scheme : str
        Scheme of the URL, which errors name.
    texts : mapping of str to str
        Text of each option by its name.
    shape : type of Options
        Struct that declares the options which the driver has.

    Returns
    -------
    Options
        An instance of ``shape``; options that have no text have their defaults.

    Raises
    ------
    InputError
        If the driver has no such option, or a value is not within its limits.
    """
    kinds = option_types(shape)
    values: dict[str, Any] = {}
    for name, text in texts.items():
        if name not in kinds:
            raise InputError(f"{scheme}: unknown option {name!r}; {nearest(name, list(kinds))}")
        try:
            values[name] = _value(text, kinds[name])
        except ValueError as error:
            raise InputError(f"{scheme}: {name} = {text!r}: {error}") from None
    return shape(**values)


def option_types(shape: type[Options]) -> dict[str, inspect.Type]:
    """Return the types of a driver's options.

    Parameters
    ----------
    shape : type of Options
        Struct that declares the options.

    Returns
    -------
    dict of str to msgspec.inspect.Type
        Type of each option by its name.
    """
    info = inspect.type_info(shape)
    assert isinstance(info, inspect.StructType)
    return {field.name: field.type for field in info.fields}


def _value(text: str, kind: inspect.Type) -> Any:
    """Return the value of an option; raise ValueError with what would be allowed."""
    hexadecimal = False
    if isinstance(kind, inspect.UnionType):
        (kind,) = (member for member in kind.types if not isinstance(member, inspect.NoneType))
    if isinstance(kind, inspect.Metadata):
        hexadecimal = kind.extra == HEXADECIMAL
        kind = kind.type
    match kind:
        case inspect.VarTupleType():
            return tuple(_value(part, kind.item_type) for part in text.split(",") if part)
        case inspect.LiteralType():
            return _choice(
                text, sorted(map(str, kind.values), key=lambda value: (len(value), value))
            )
        case inspect.BoolType():
            if text.lower() not in FLAGS:
                raise ValueError("must be true or false")
            return FLAGS[text.lower()]
        case inspect.IntType() | inspect.FloatType():
            return _number(text, kind, hexadecimal=hexadecimal)
        case _:
            return text


def _choice(text: str, allowed: list[str]) -> str:
    """Return the text if it is allowed; raise ValueError with what would be."""
    if text in allowed:
        return text
    if all(value.isdecimal() for value in allowed):
        raise ValueError(f"must be one of {', '.join(allowed)}")
    if len(allowed) > 2:
        raise ValueError(nearest(text, allowed))
    raise ValueError(f"must be {' or '.join(map(repr, allowed))}")


def _number(
    text: str, kind: inspect.IntType | inspect.FloatType, *, hexadecimal: bool
) -> int | float:
    """Return a number within the limits of its type; raise ValueError with the limits."""
    try:
        value = float(int(text, 16)) if text.lower().startswith("0x") else float(text)
    except ValueError:
        raise ValueError("must be a number") from None
    if kind.ge is not None and kind.le is not None and not kind.ge <= value <= kind.le:
        low, high = (
            (hex(int(kind.ge)), hex(int(kind.le)))
            if hexadecimal
            else (f"{kind.ge:g}", f"{kind.le:g}")
        )
        raise ValueError(f"must be {low} … {high}")
    if isinstance(kind, inspect.FloatType):
        return value
    if value != int(value):
        raise ValueError("must be a whole number")
    return int(value)
