"""The interface of what carries messages to a daemon: over a network, or inside one process.

A `Transport` takes `Command` objects and delivers `Answer` objects, whether or not it encodes them.
A display in the same process needs only this::

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
    """Interface that a transport calls, from any thread; `ClientSession` implements it."""

    def opened(self) -> "Future[Welcome]":
        """Say hello over a new connection.

        Returns
        -------
        Future
            Future that is done when the daemon has answered.
        """
        ...

    def received(self, answer: Answer) -> None:
        """Take a message of the daemon.

        Parameters
        ----------
        answer : Answer
            Answer, event or telemetry.
        """
        ...

    def lost(self, reason: str, *, final: bool = False) -> None:
        """Take note that a connection, or the attempt to make one, has failed.

        Parameters
        ----------
        reason : str
            Why there is no connection.
        final : bool
            Whether no other connection follows.
        """
        ...

    def wanted(self, command: Command) -> bool:
        """Return whether a message that waited to be sent is still to be sent.

        Parameters
        ----------
        command : Command
            Message that is about to be sent.

        Returns
        -------
        bool
            Whether to send it.
        """
        ...

    def dropped(self, display: str) -> None:
        """Count a contact that was not sent: a newer one came, or there is no connection.

        Parameters
        ----------
        display : str
            Name of its display.
        """
        ...

    def ignored(self, message: str) -> None:
        """Count a message of the daemon that cannot be read.

        Parameters
        ----------
        message : str
            What is wrong with it.
        """
        ...

    def ping(self) -> "Future[Pong]":
        """Ask for the time of the daemon.

        Returns
        -------
        Future
            Future of its answer.
        """
        ...


class Transport(Protocol):
    """A way to a daemon.

    No method blocks or raises for what the network does: the receiver learns of that.
    """

    def open(self, receiver: Receiver) -> None:
        """Begin to connect; `Receiver.opened` or `Receiver.lost` is called with the outcome.

        Parameters
        ----------
        receiver : Receiver
            Receiver of the messages of the daemon.
        """
        ...

    def send(self, command: Command) -> None:
        """Hand over a message, from any thread.

        Parameters
        ----------
        command : Command
            Message to send; of contacts, only the newest must arrive.
        """
        ...

    def close(self) -> "Future[None]":
        """Begin to close; idempotent.

        Returns
        -------
        Future
            Future that is done when threads and sockets are closed.
        """
        ...
