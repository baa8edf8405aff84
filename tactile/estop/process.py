"""E-stop process, whose process and socket are shared with no ordinary client.

It trips the latches, which playback watches. An e-stop that is sent here therefore works while the
server is flooded, hangs or is stopped, and while playback is being restarted. Requests are
datagrams, so that there is no connection that anyone could keep open. Whoever may write to the
socket may trigger an e-stop.

A request is ``{"estop": null}`` for all displays or ``{"estop": "right"}`` for one, as JSON. The
answer ``{"estops": {"right": 3}}`` gives the number that was latched for each display, or holds an
``"error"``. Requests with the same ``"id"`` count as one, so that a request may be repeated.
"""

import json
import logging
import os
import socket
import struct
import sys
import threading
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile.estop.latch import Latch, LatchWriter
from tactile.estop.request import LARGEST_REQUEST
from tactile.paths import runtime_folder
from tactile.processes import pipes_of_parent, received, send

log = logging.getLogger("tactile.estop")

LONGEST_ID, MOST_ANSWERED = 64, 256
"""Maximum length of a request's id [characters], and number of answered requests whose repetition
is recognized."""
CREDENTIALS = struct.Struct("3i")
"""Process, user and group of a sender, as Linux passes them (unix(7), SCM_CREDENTIALS)."""


@dataclass(frozen=True)
class EstopSetup:
    """Latches that an e-stop process trips.

    Attributes
    ----------
    latches : dict of str to str
        Handle of the latch by name of the display.
    """

    latches: dict[str, str]


@dataclass(frozen=True)
class EstopReady:
    """First answer of an e-stop process.

    Attributes
    ----------
    address : str
        Address of its socket; empty if it has none.
    failure : str
        Reason why it has no socket; empty if it has one.
    """

    address: str = ""
    failure: str = ""


def bind(name: str) -> tuple[socket.socket, str]:
    """Create a socket for requests at an address where `tactile estop` finds it.

    Parameters
    ----------
    name : str
        Part of the address that no other socket of this machine has.

    Returns
    -------
    tuple of socket and str
        The socket and its address.

    Raises
    ------
    OSError
        If the socket cannot be created.
    """
    folder = runtime_folder()
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    path = folder / f"estop-{name}.sock"
    if hasattr(socket, "AF_UNIX"):
        link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        path.unlink(missing_ok=True)
        link.bind(str(path))
        path.chmod(0o666)  # whoever can reach the folder may trigger an e-stop
    else:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.bind(("127.0.0.1", 0))
        path.write_text(str(link.getsockname()[1]))
    if hasattr(socket, "SO_PASSCRED"):
        link.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
    return link, str(path)


class Desk:
    """Executor of e-stop requests.

    Parameters
    ----------
    latches : dict of str to Latch
        Latches by name of the display.
    """

    def __init__(self, latches: dict[str, Latch]) -> None:
        self._latches = latches
        self._answers: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._new = threading.Event()

    def answer(self, request: bytes, sender: str) -> dict[str, Any]:
        """Carry out a request and return the answer.

        Parameters
        ----------
        request : bytes
            Request as in the module docstring.
        sender : str
            Who asks, for the note in the latch.

        Returns
        -------
        dict of str to Any
            Answer as in the module docstring; an error about an unknown display also has
            ``"unknown"``.
        """
        try:
            content = json.loads(request)
            target, request_id = content["estop"], str(content.get("id", ""))[:LONGEST_ID]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {"error": 'no request; {"estop": null} stops all displays'}
        if request_id and request_id in self._answers:
            return self._answers[request_id]
        answer = self._carry_out(target, sender)
        if request_id:
            self._answers[request_id] = answer
            if len(self._answers) > MOST_ANSWERED:
                self._answers.popitem(last=False)
        return answer

    def _carry_out(self, target: object, sender: str) -> dict[str, Any]:
        if target is None:
            chosen = self._latches
        elif isinstance(target, str) and target in self._latches:
            chosen = {target: self._latches[target]}
        else:
            names = ", ".join(self._latches)
            error = f"no display {str(target)[:64]!r}; there are {names}"
            return {"error": error, "unknown": True}
        return {"estops": {name: latch.trip(sender) for name, latch in chosen.items()}}

    def serve(self, link: socket.socket) -> None:
        """Wait for one request, carry it out and answer it.

        Parameters
        ----------
        link : socket
            Socket as created by `bind`.
        """
        extra: list[tuple[int, int, bytes]] = []
        try:
            if hasattr(link, "recvmsg"):
                space = socket.CMSG_SPACE(CREDENTIALS.size)
                request, extra, _, address = link.recvmsg(LARGEST_REQUEST, space)
            else:
                request, address = link.recvfrom(LARGEST_REQUEST)
        except OSError as error:  # Windows reports here that an earlier answer did not arrive
            log.warning("a request could not be read: %s", error)
            return
        answer = json.dumps(self.answer(request, f"by tactile estop{_user(extra)}")).encode()
        if address:
            with suppress(OSError):  # the sender may be gone, or not read the answer
                link.sendto(answer, getattr(socket, "MSG_DONTWAIT", 0), address)
        self._new.set()

    def save(self) -> None:
        """Write e-stops to the disk as they come, forever; they are latched before that."""
        while True:
            self._new.wait()
            self._new.clear()
            for latch in self._latches.values():
                try:
                    latch.save()
                except OSError as error:
                    log.error("the e-stop latch was not saved: %s", error)


def _user(extra: list[tuple[int, int, bytes]]) -> str:
    """Return which user sent a datagram, as far as its ancillary data tell."""
    for _, kind, data in extra:
        if kind == getattr(socket, "SCM_CREDENTIALS", None) and len(data) >= CREDENTIALS.size:
            process, user, _ = CREDENTIALS.unpack_from(data)
            return f" of user {user}, process {process}"
    return ""


def _end_with(pipe: Any, address: str) -> None:
    """End this process when its standard input ends."""
    while pipe.read(1):
        continue
    Path(address).unlink(missing_ok=True)
    os._exit(0)


def main() -> None:
    """Serve requests until standard input ends, which is when the server ends."""
    inward, outward = pipes_of_parent()
    setup: EstopSetup | None = next(received(inward), None)
    if setup is None:
        sys.exit(1)
    try:
        link, address = bind(str(os.getppid()))
    except OSError as error:
        send(outward, EstopReady(failure=str(error)))
        sys.exit(1)
    desk = Desk({name: Latch(h, LatchWriter.ESTOP_PROCESS) for name, h in setup.latches.items()})
    send(outward, EstopReady(address))
    threading.Thread(target=desk.save, daemon=True).start()
    threading.Thread(target=_end_with, args=(inward, address), daemon=True).start()
    while True:
        desk.serve(link)
