"""The one exception tree. Each class is also the built-in error that a caller may expect."""


class TactileError(Exception):
    """Anything that this package raises on purpose."""


class InputError(TactileError, ValueError):
    """A file, value or option that cannot be used: where, what, the limit, what would do."""


class NotFoundError(InputError, LookupError):
    """A texture, display, file or driver that is not there; names the nearest."""


class BusError(TactileError, OSError):
    """A device that cannot be opened, or that failed."""


class BusStateError(BusError, RuntimeError):
    """A call that the device's state does not allow, such as writing before it was started."""


class ClientError(TactileError):
    """Anything that the SDK raises because of the daemon or the connection to it."""


class RequestError(ClientError):
    """What the daemon refused: ``code`` says why, ``field`` where in the message, as a path."""

    def __init__(self, message: str, *, code: str, field: str = "") -> None:
        super().__init__(message)
        self.code, self.field = code, field


class RefusedInputError(RequestError, InputError):
    """A value that the daemon does not take."""


class UnknownNameError(RequestError, NotFoundError):
    """A texture or display that the daemon does not have."""


class ClientTimeoutError(ClientError, TimeoutError):
    """The daemon did not answer in time."""


class DisconnectedError(ClientError, ConnectionError):
    """There is no connection to the daemon: not yet, not at present, or closed."""
