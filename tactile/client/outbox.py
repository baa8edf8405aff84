"""What is to be sent: everything that was asked, and of each finger only the newest contact."""

import threading
from collections import deque
from collections.abc import Callable

from tactile.messages import Command, Contact, EStop


class Outbox:
    """Messages on their way out; never waits, does not grow with time.

    E-stops come first, then contacts, then one request at a time in the order they came.

    Parameters
    ----------
    dropped : called with the display's name for each contact that a newer one replaced
    """

    def __init__(self, dropped: Callable[[str], None]) -> None:
        self._dropped = dropped
        self._lock = threading.Lock()
        self._urgent: deque[Command] = deque()
        self._contacts: dict[str, Contact] = {}
        self._requests: deque[Command] = deque()
        self._told = False

    def put(self, command: Command) -> bool:
        """Add a message and return whether the sender is to be woken."""
        replaced = False
        with self._lock:
            if isinstance(command, Contact):
                replaced = command.display in self._contacts
                self._contacts[command.display] = command
            elif isinstance(command, EStop):
                self._urgent.append(command)
            else:
                self._requests.append(command)
            wake, self._told = not self._told, True
        if replaced:
            self._dropped(command.display)  # type: ignore[union-attr, arg-type]
        return wake

    def take(self, contacts: bool = True) -> list[Command]:
        """Return what is to be sent next, nothing where the sender may sleep until it is woken."""
        with self._lock:
            batch = list(self._urgent)
            self._urgent.clear()
            if contacts:
                batch.extend(self._contacts.values())
                self._contacts.clear()
            if self._requests:
                batch.append(self._requests.popleft())
            self._told = bool(batch)
            return batch

    @property
    def contacts(self) -> int:
        """How many contacts wait."""
        return len(self._contacts)

    def clear(self) -> None:
        """Forget all of it; contacts count as dropped, and a session sends its e-stops again."""
        with self._lock:
            names = list(self._contacts)
            self._urgent.clear()
            self._contacts.clear()
            self._requests.clear()
        for name in names:
            self._dropped(name)
