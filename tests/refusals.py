"""Checks of how a reader refuses a file: with one line, and never with another exception."""

from collections.abc import Callable

from hypothesis import settings

from tactile.errors import InputError

NO_PANIC = settings(max_examples=150)


def has(message: str, *words: str) -> None:
    missing = [word for word in words if word not in message]
    assert not missing, f"{missing} not in {message!r}"


def refusal(read: Callable[[], object]) -> str | None:
    """Return what an input is refused with, or None; any other exception passes."""
    try:
        read()
    except InputError as error:
        return str(error)
    return None
