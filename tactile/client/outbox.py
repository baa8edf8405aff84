"""Messages that are to be sent: each request, and of each finger only the newest contact."""

import threading
from collections import deque
from collections.abc import Callable

from tactile.messages import Command, Contact, EStop


class Outbox:
    """Messages that wait to be sent; its methods never wait, and contacts do not accumulate.

    E-stops come first, then contacts, then one request at a time in the order in which they came.

    Parameters
    ----------
    dropped : Callable
        Function that takes the display's name for each contact that a newer one replaced.
    """

    def __init__(self, dropped: Callable[[str], None]) -> None:
        self._dropped = dropped
        self._lock = threading.Lock()
        self._urgent: deque[Command] = deque()
        self._contacts: dict[str, Contact] = {}
        self._requests: deque[Command] = deque()
        self._awake = False

    def put(self, command: Command) -> bool:
        """Add a message.

        Parameters
        ----------
        command : Command
            Message to send.

        Returns
        -------
        bool
            Whether the sender has to be woken.
        """
        replaced = False
        with self._lock:
            if isinstance(command, Contact):
                replaced = command.display in self._contacts
                self._contacts[command.display] = command
            elif isinstance(command, EStop):
                self._urgent.append(command)
            else:
                self._requests.append(command)
            wake, self._awake = not self._awake, True
        if replaced:
            self._dropped(command.display)  # type: ignore[union-attr, arg-type]
        return wake

    def take(self, contacts: bool = True) -> list[Command]:
        """Take what is to be sent next.

        Parameters
        ----------
        contacts : bool
            Whether contacts may be sent now.

        Returns
        -------
        list of Command
            Messages; none if the sender may sleep until it is woken.
        """
        with self._lock:
            batch = list(self._urgent)
            self._urgent.clear()
            if contacts:
                batch.extend(self._contacts.values())
                self._contacts.clear()
            if self._requests:
                batch.append(self._requests.popleft())
            self._awake = bool(batch)
            return batch

    @property
    def contacts(self) -> int:
        """Number of contacts that wait."""
        return len(self._contacts)

    def clear(self) -> None:
        """Forget all messages; contacts count as dropped, and a session sends e-stops again."""
        with self._lock:
            names = list(self._contacts)
            self._urgent.clear()
            self._contacts.clear()
            self._requests.clear()
        for name in names:
            self._dropped(name)
