"""Options of a device URL, as values; a mistake is one line that names option, value and limit."""

from firmware_protocol.messages import SampleFormat
from tactile.bus.registry import Address
from tactile.errors import InputError
from tactile.files import nearest

FORMATS = {f.name.lower(): f for f in (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8)}
FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def number(address: Address, name: str, low: float, high: float) -> float | None:
    """Return an option's number, None where it is not given; also in hexadecimal, as 0x42."""
    text = address.options.get(name)
    if text is None:
        return None
    try:
        value = float(int(text, 16)) if text.lower().startswith("0x") else float(text)
    except ValueError:
        raise InputError(f"{address.scheme}: {name} = {text!r}: must be a number") from None
    if not low <= value <= high:
        raise InputError(f"{address.scheme}: {name} = {value:g}: must be {low:g} … {high:g}")
    return value


def whole(address: Address, name: str, low: int, high: int) -> int | None:
    """Return an option's whole number, None where it is not given."""
    value = number(address, name, low, high)
    if value is not None and value != int(value):
        raise InputError(f"{address.scheme}: {name} = {value:g}: must be a whole number")
    return None if value is None else int(value)


def wholes(address: Address, name: str, low: int, high: int) -> tuple[int, ...]:
    """Return an option's whole numbers, which commas part; none where it is not given."""
    found = []
    for text in filter(None, address.options.get(name, "").split(",")):
        one = whole(Address(address.scheme, "", {name: text}), name, low, high)
        assert one is not None
        found.append(one)
    return tuple(found)


def flag(address: Address, name: str) -> bool:
    """Return whether an option is set; not, where it is not given."""
    text = address.options.get(name, "false").lower()
    if text not in FLAGS:
        raise InputError(f"{address.scheme}: {name} = {text!r}: must be true or false")
    return FLAGS[text]


def sample_format(address: Address, *, spectrum: bool = False) -> SampleFormat | None:
    """Return the format that is asked for, None where the link chooses; or ``spectrum`` frames."""
    known = FORMATS | ({"spectrum": SampleFormat.SPECTRUM8} if spectrum else {})
    name = address.options.get("format")
    if name is not None and name not in known:
        raise InputError(f"{address.scheme}: format = {name!r}: {nearest(name, list(known))}")
    return None if name is None else known[name]
