"""The interface of what carries messages to a server: over a network, or inside one process.

A `Transport` takes `Command` objects and delivers `Answer` objects, whether or not it encodes them.
One that encodes nothing is `tactile.local.LocalTransport`, for a display in the same process.
"""

from concurrent.futures import Future
from typing import TYPE_CHECKING, Protocol

from tactile.messages import Command

if TYPE_CHECKING:
    from tactile.client.session import ClientSession


class Transport(Protocol):
    """A way to a server.

    No method blocks or raises for what the network does: the session learns of that.
    """

    @property
    def is_local(self) -> bool:
        """Whether the server is on this machine, as far as its address says."""
        ...

    def open(self, session: "ClientSession") -> None:
        """Begin to connect; `ClientSession.say_hello` or `ClientSession.lost` is called then.

        Parameters
        ----------
        session : ClientSession
            Session that takes the messages of the server, from any thread.
        """
        ...

    def send(self, command: Command) -> None:
        """Hand over a message, from any thread.

        Parameters
        ----------
        command : Command
            Message to send; of contacts, only the newest must arrive, and frames may be joined.
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
