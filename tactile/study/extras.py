"""Optional libraries that only studies need; they are imported where they are used."""

from collections.abc import Iterator
from contextlib import contextmanager

from tactile.errors import missing_extra


@contextmanager
def study_extra(what: str) -> Iterator[None]:
    """Turn the error of a missing library into one line that names the command to install it.

    Parameters
    ----------
    what : str
        Purpose of the library, for the message.

    Yields
    ------
    None
        Nothing; the block imports the library.

    Raises
    ------
    InputError
        If the block raises ImportError.
    """
    try:
        yield
    except ImportError as error:
        raise missing_extra(what, error.name or str(error), "study") from None
