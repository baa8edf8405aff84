"""Child processes, which exchange pickled messages with their parent on the standard streams.

A child runs the same tactile as its parent, and stands in a session of its own, so that no signal
of a terminal reaches it. When the parent ends, for whatever reason, the messages to the child end,
and the child with them.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import IO, Any, BinaryIO, cast

PROGRAM = "import sys; sys.path[:] = {!r}; from {} import main; main()"
"""Program of a child, to be formatted with the path of its parent and the module to run."""
REAPING = 5.0
"""Time limit for a process that was killed to end [s]."""
JOINING = 1.0
"""Time limit for the threads of a child that was killed to end [s]."""
BUFFER = 1 << 16
"""Number of bytes that a process reads from a pipe at once, as many as a pipe of Linux holds."""


class ChildProcess:
    """Child process as its parent knows it; it is started on construction.

    Parameters
    ----------
    module : str
        Module whose ``main`` the child runs.
    on_message : callable
        Function that is called with each message of the child, and with None when they end, in the
        thread that reads them.
    inherited : tuple of int
        File descriptors that the child inherits.
    stderr : int or None
        Standard error of the child, as `subprocess.Popen` takes it; that of the parent if None.
    """

    def __init__(
        self,
        module: str,
        on_message: Callable[[Any], None],
        inherited: tuple[int, ...] = (),
        stderr: int | None = None,
    ) -> None:
        self._on_message = on_message
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(sys.path, module)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, bufsize=0,
            start_new_session=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            pass_fds=inherited if os.name == "posix" else (),
        )  # fmt: skip
        self._pipe: Any = self._process.stdin
        self._threads: list[threading.Thread] = []
        self._begin_thread(self._read, f"{module}:read")

    def _begin_thread(self, work: Callable[[], None], name: str) -> None:
        """Run a function in a thread, which has to end soon after the process."""
        thread = threading.Thread(target=work, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _read(self) -> None:
        """Pass on the messages until they end."""
        pipe: Any = self._process.stdout
        # A reader of its own, since closing one that another thread reads from would wait for it.
        with open(pipe.fileno(), "rb", BUFFER, closefd=False) as reader:
            for message in received(reader):
                self._on_message(message)
        self._on_message(None)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Kill the process at once, and close its threads and pipes."""
        with suppress(OSError):
            self._process.kill()
        with suppress(subprocess.TimeoutExpired):  # a disk may hold up even one that was killed
            self._process.wait(REAPING)
        for thread in self._threads:
            thread.join(JOINING)
        for pipe in (self._pipe, cast(Any, self._process.stdout)):
            with suppress(OSError):
                pipe.close()


def received(pipe: IO[bytes]) -> Iterator[Any]:
    """Yield the messages that come from another process, until it is gone.

    Parameters
    ----------
    pipe : binary file
        Pipe to read from.

    Yields
    ------
    object
        Message.
    """
    while True:
        try:
            message = pickle.load(pipe)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            return
        yield message


def send(pipe: IO[bytes], message: object) -> None:
    """Send a message to another process.

    Parameters
    ----------
    pipe : binary file
        Pipe to write to.
    message : object
        Message, which is pickled.

    Raises
    ------
    OSError
        If the other process is gone.
    """
    pickle.dump(message, pipe, protocol=5)
    pipe.flush()


def pipes_of_parent() -> tuple[BinaryIO, BinaryIO]:
    """Return the pipes from and to the parent, in a child.

    What the child prints from then on goes to standard error, and an interrupt does not end it.

    Returns
    -------
    tuple of binary file
        Pipe to read messages from, and pipe to write messages to.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipes = os.fdopen(os.dup(0), "rb", BUFFER), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return pipes
