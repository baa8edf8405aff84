"""Exceptions of the package, in one tree; each is also the built-in error that fits its meaning."""


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
    """Base class of the exceptions that the SDK raises about the daemon or the connection to it."""


class RequestError(ClientError):
    """A request that the daemon refused.

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
    """A value that the daemon does not accept."""


class UnknownNameError(RequestError, NotFoundError):
    """A texture or display that the daemon does not have."""


class ClientTimeoutError(ClientError, TimeoutError):
    """A daemon that did not answer in time."""


class DisconnectedError(ClientError, ConnectionError):
    """A missing connection to the daemon: not yet made, interrupted, or closed."""
