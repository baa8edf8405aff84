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
