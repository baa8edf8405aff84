"""Requests for an e-stop, as `tactile estop` sends them to every program of this machine."""

import json
import os
import secrets
import select
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile.clock import MONOTONIC
from tactile.paths import estop_sockets

LARGEST_REQUEST = 1024
"""Largest size of a request [bytes]."""
LARGEST_ANSWER = 65_536
"""Largest size of an answer [bytes]; `tactile.estop.process` describes both."""
WITHIN = 1.0
"""Time in which a program must answer [s]; it normally takes milliseconds."""
GONE = "nobody listens there any more"
"""Failure of a request to a socket that a process left behind."""
ATTEMPT = 0.25
"""Time after which a request is repeated [s], as some systems lose datagrams to a full socket."""


@dataclass(frozen=True)
class EstopAnswer:
    """Result of a request to one program.

    Attributes
    ----------
    socket : str
        Path of the program's e-stop socket.
    estops : dict of str to int
        Number of the e-stop that was latched, by name of the display.
    failure : str
        Reason why nothing was latched; empty if it was.
    unknown : bool
        Whether the program runs but drives no display of that name.
    seconds : float
        Time from the request to the answer [s].
    """

    socket: str
    estops: dict[str, int] = field(default_factory=dict)
    failure: str = ""
    unknown: bool = False
    seconds: float = 0.0

    @property
    def is_gone(self) -> bool:
        """Whether the socket was left behind by a process that was killed."""
        return self.failure == GONE


def request_estop(display: str | None = None, *, within: float = WITHIN) -> list[EstopAnswer]:
    """Request an e-stop from all programs of this machine that this user can reach, all at once.

    Parameters
    ----------
    display : str, optional
        Name of the only display to stop, or URL of its device if it is driven without a server; by
        default all displays.
    within : float
        Time in which each program must answer [s].

    Returns
    -------
    list of EstopAnswer
        One answer for each program; empty if no program runs.
    """
    request = json.dumps({"estop": display, "id": secrets.token_hex(8)}).encode()
    begun, answers = MONOTONIC.now(), dict[str, EstopAnswer]()
    waiting = {str(path): path for path in estop_sockets()}
    with _reply_sockets(len(waiting)) as links:
        by_link = dict(zip(links, list(waiting), strict=True))
        while by_link and (remaining := begun + within - MONOTONIC.now()) > 0:
            for link, name in list(by_link.items()):
                if (failure := _send(link, waiting[name], request)) is not None:
                    answers[name] = EstopAnswer(name, failure=failure)
                    del by_link[link]
            attempt = MONOTONIC.now() + min(ATTEMPT, remaining)
            while by_link and (rest := attempt - MONOTONIC.now()) > 0:
                for link in select.select(list(by_link), [], [], rest)[0]:
                    name = by_link.pop(link)
                    answers[name] = _answer(name, link, MONOTONIC.now() - begun)
    silent = f"no answer within {within:g} s"
    return [answers.get(name, EstopAnswer(name, failure=silent)) for name in waiting]


def _send(link: socket.socket, path: Path, request: bytes) -> str | None:
    """Send a request; return why it cannot be sent, or None if it was or may be sent again."""
    try:
        if hasattr(socket, "AF_UNIX"):
            link.sendto(request, str(path))
        else:
            link.sendto(request, ("127.0.0.1", int(path.read_text())))
    except BlockingIOError:
        return None
    except (ConnectionError, FileNotFoundError):
        with suppress(OSError):
            path.unlink()  # left behind by a killed process
        return GONE
    except (OSError, ValueError) as error:
        return str(error)
    return None


def _answer(name: str, link: socket.socket, seconds: float) -> EstopAnswer:
    """Return the answer that has arrived, or what is wrong with it."""
    try:
        reply: Any = json.loads(link.recv(LARGEST_ANSWER))
        if "error" in reply:
            unknown = bool(reply.get("unknown"))
            return EstopAnswer(name, failure=str(reply["error"]), unknown=unknown, seconds=seconds)
        estops = {str(display): int(number) for display, number in reply["estops"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return EstopAnswer(name, failure=f"no answer of an e-stop process: {error}")
    return EstopAnswer(name, estops, seconds=seconds)


@contextmanager
def _reply_sockets(count: int) -> Iterator[list[socket.socket]]:
    """Provide sockets that answers can be sent to.

    On Linux they have names outside the file system, because a service may not see this user's
    folders.
    """
    names = list[Path]()
    links = [
        socket.socket(getattr(socket, "AF_UNIX", socket.AF_INET), socket.SOCK_DGRAM)
        for _ in range(count)
    ]
    try:
        for k, link in enumerate(links):
            link.setblocking(False)
            if sys.platform == "linux":
                link.bind("")
            elif hasattr(socket, "AF_UNIX"):
                names.append(Path(tempfile.gettempdir()) / f"tactile-{os.getpid()}-{k}.estop")
                names[-1].unlink(missing_ok=True)
                link.bind(str(names[-1]))
                names[-1].chmod(0o666)  # the server may run as another user
        yield links
    finally:
        for link in links:
            link.close()
        for name in names:
            name.unlink(missing_ok=True)
