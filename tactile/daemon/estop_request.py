"""What `tactile estop` does: it asks the e-stop process of every daemon of this machine."""

import json
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tactile.daemon.paths import estop_sockets

LARGEST_REQUEST = 1024
"""Bytes of a request or an answer; `tactile.daemon.estop_process` says what they hold."""
WITHIN = 1.0
"""s in which a daemon must answer; it does so within milliseconds."""
ATTEMPT = 0.25
"""s after which a request is sent once more: a flooded socket loses datagrams on some systems."""


@dataclass(frozen=True)
class EstopAnswer:
    """What came of a request to one daemon.

    Attributes
    ----------
    socket : path of the daemon's e-stop socket
    estops : number of the e-stop that was latched, by display
    failure : why nothing was latched; empty where it was
    seconds : from the request to the answer [s]
    """

    socket: str
    estops: dict[str, int] = field(default_factory=dict)
    failure: str = ""
    seconds: float = 0.0


def request_estop(display: str | None = None, *, within: float = WITHIN) -> list[EstopAnswer]:
    """Ask all daemons of this machine that this user can reach for an e-stop.

    Parameters
    ----------
    display : name of the only display to stop; None for all
    within : time in which each must answer [s]

    Returns
    -------
    list of EstopAnswer
        One for each daemon; none where no daemon runs.
    """
    request = json.dumps({"estop": display}).encode()
    return [_ask(path, request, within) for path in estop_sockets()]


def _ask(path: Path, request: bytes, within: float) -> EstopAnswer:
    begun = time.monotonic()
    with _link() as link:
        link.settimeout(min(ATTEMPT, within))
        while time.monotonic() - begun < within:
            try:
                link.sendto(request, _address(path))
                answer = json.loads(link.recv(LARGEST_REQUEST))
            except TimeoutError:
                continue
            except (ConnectionError, FileNotFoundError):
                return EstopAnswer(str(path), failure="nobody listens there any more")
            except (OSError, ValueError) as error:
                return EstopAnswer(str(path), failure=str(error))
            took = time.monotonic() - begun
            return EstopAnswer(
                str(path), answer.get("estops", {}), str(answer.get("error", "")), took
            )
    return EstopAnswer(str(path), failure=f"no answer within {within:g} s")


def _address(path: Path) -> str | tuple[str, int]:
    if hasattr(socket, "AF_UNIX"):
        return str(path)
    return "127.0.0.1", int(path.read_text())


@contextmanager
def _link() -> Iterator[socket.socket]:
    """Provide a socket that answers can be sent to."""
    if not hasattr(socket, "AF_UNIX"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            yield link
        return
    name = Path(tempfile.gettempdir()) / f"tactile-estop-{os.getpid()}-{time.monotonic_ns()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(name))
        with suppress(OSError):
            name.chmod(0o666)  # the daemon's user is another one
        try:
            yield link
        finally:
            name.unlink(missing_ok=True)
