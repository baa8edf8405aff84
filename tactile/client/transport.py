"""What carries messages between a session and a daemon: over a network, or inside one process.

A `Transport` takes `Command` objects and delivers `Answer` objects; whether it encodes them is its
own affair. A display in the same process needs nothing but this::

    class LocalTransport:
        def open(self, receiver: Receiver) -> None:
            self._receiver = receiver
            receiver.opened()

        def send(self, command: Command) -> None:
            for answer in self._daemon.handle(command):
                self._receiver.received(answer)

        def close(self) -> Future[None]: ...
"""

from concurrent.futures import Future
from typing import Protocol

from tactile.messages import Answer, Command, Pong, Welcome


class Receiver(Protocol):
    """What a transport tells; `tactile.client.session.Session` is one. From any thread."""

    def opened(self) -> "Future[Welcome]":
        """Say `Hello` over a new connection; the future is done when that is answered."""
        ...

    def received(self, answer: Answer) -> None:
        """Take what the daemon says."""
        ...

    def lost(self, reason: str, *, final: bool = False) -> None:
        """Forget the connection, or the attempt to make one; finally where no other follows."""
        ...

    def wanted(self, command: Command) -> bool:
        """Tell whether a message that waited to be sent is still to be sent."""
        ...

    def dropped(self, display: str) -> None:
        """Count a contact that was not sent, because a newer one came or there is no way."""
        ...

    def ignored(self, message: str) -> None:
        """Count an answer that cannot be read."""
        ...

    def ping(self) -> "Future[Pong]":
        """Ask what time it is there."""
        ...


class Transport(Protocol):
    """A way to a daemon.

    None of these blocks, and none raises for what the network does: that is told to the receiver.
    """

    def open(self, receiver: Receiver) -> None:
        """Begin to connect; `Receiver.opened` or `Receiver.lost` says how it went."""
        ...

    def send(self, command: Command) -> None:
        """Hand over a message, from any thread; of contacts, only the newest must arrive."""
        ...

    def close(self) -> "Future[None]":
        """Begin to close; the future is done when threads and sockets are. Idempotent."""
        ...
