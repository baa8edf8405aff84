"""Exceptions of the package, in one tree; each is also the built-in error that fits its meaning.

`locate_mistake` and `show_field` describe a value that msgspec does not accept.
"""

import re
from typing import Any

MISTAKE = re.compile(r"(?s)(.*?)(?: - at `(?:key` in `)?\$\.?([^`]*)`)?")
"""Problem and path in an error of msgspec."""


class TactileError(Exception):
    """Base class of all exceptions that this package raises on purpose."""


class InputError(TactileError, ValueError):
    """A file, value or option that cannot be used.

    The message states where it is, what it is, the limit, and what would be valid.
    """


class NotFoundError(InputError, LookupError):
    """A texture, display, file or driver that does not exist; the message names the nearest."""


class BusError(TactileError, OSError):
    """A device that cannot be opened or that has failed."""


class BusStateError(BusError, RuntimeError):
    """A call that the state of the device does not allow, such as writing before it was started."""


class ClientError(TactileError):
    """Base class of the exceptions that the SDK raises about the server or the connection to it."""


class RequestError(ClientError):
    """A request that the server refused.

    Parameters
    ----------
    message : str
        Explanation for the user.
    code : str
        Reason of the refusal, as a code of the API.
    field : str
        Path of the offending field in the request; empty if there is none.

    Attributes
    ----------
    code, field : str
        The parameters of the same names.
    """

    def __init__(self, message: str, *, code: str, field: str = "") -> None:
        super().__init__(message)
        self.code, self.field = code, field


class RefusedInputError(RequestError, InputError):
    """A value that the server does not accept."""


class UnknownNameError(RequestError, NotFoundError):
    """A texture or display that the server does not have."""


class ClientTimeoutError(ClientError, TimeoutError):
    """A server that did not answer in time."""


class DisconnectedError(ClientError, ConnectionError):
    """A missing connection to the server: not yet made, interrupted, or closed."""


def locate_mistake(error: str) -> tuple[str, str]:
    """Split an error of msgspec into the field that it is about and the problem.

    Parameters
    ----------
    error : str
        Error such as "Expected `float` - at `$.layers[0].gain`".

    Returns
    -------
    tuple of 2 str
        Path of the field, such as "layers[0].gain", empty if the error names none; and problem,
        such as "expected float".
    """
    match = MISTAKE.fullmatch(error)
    problem, field = (match[1], match[2] or "") if match else (error, "")
    return field, problem.replace("Expected", "expected").replace("`", "")


def show_field(data: Any, field: str, longest: int = 1000) -> str:
    """Return a field and its value as the beginning of an error message.

    Parameters
    ----------
    data : Any
        Nested data that the field is in.
    field : str
        Path of the field; it may be empty.
    longest : int
        Maximum length of the value [characters].

    Returns
    -------
    str
        "field = value: "; "field: " if the value is missing, a table or an array; "" for no field.
    """
    for key in re.findall(r"[^.\[\]]+", field):
        try:
            data = data[int(key)] if isinstance(data, list | tuple) else data[key]
        except (LookupError, TypeError, ValueError):
            data = None
    plain = isinstance(data, int | float | str) and field
    return f"{field} = {repr(data)[:longest]}: " if plain else f"{field}: " if field else ""


def missing_extra(what: str, library: str, extra: str) -> InputError:
    """Create the error about a library that an extra of the package installs.

    Parameters
    ----------
    what : str
        Purpose of the library.
    library : str
        Name of the library.
    extra : str
        Name of the extra.

    Returns
    -------
    InputError
        Error that names the command to install the extra.
    """
    return InputError(
        f"{what} needs {library}: pip install 'tactile-display[{extra}]', or in a checkout "
        f"pip install '.[{extra}]'"
    )
