"""Libraries that studies alone need: imported where they are used, and missed in one line."""

from collections.abc import Iterator
from contextlib import contextmanager

from tactile.errors import InputError

EXTRA = "pip install 'tactile-display[study]'"


@contextmanager
def study_extra(what: str) -> Iterator[None]:
    """Turn the lack of a library into one line that says what would do."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what} needs {error.name or error}; {EXTRA}") from None
