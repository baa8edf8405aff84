"""The e-stop's own way in: a process and a socket that share nothing with ordinary clients.

It trips the latches, which playback watches, by itself: an e-stop sent here works while the server
is flooded, hangs or is stopped, and while playback is started again. Requests are datagrams: there
is no connection that anyone could keep open. Whoever may write to the socket may stop.

A request is ``{"estop": null}`` for all displays or ``{"estop": "right"}`` for one, as JSON; the
answer ``{"estops": {"right": 3}}`` names the number that was latched for each, or holds an
``"error"``. Requests with the same ``"id"`` are one, so that it may be sent again.
"""

import json
import logging
import os
import pickle
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

log = logging.getLogger("tactile.estop")

LONGEST_ID, MOST_ANSWERED = 64, 256
"""Characters of a request's id; requests that are known again when they come once more."""
CREDENTIALS = struct.Struct("3i")
"""Process, user and group of a sender, as Linux tells them (unix(7), SCM_CREDENTIALS)."""


@dataclass(frozen=True)
class EstopSetup:
    """The latches that an e-stop process trips: the handle of each by the display's name."""

    latches: dict[str, str]


@dataclass(frozen=True)
class EstopReady:
    """The first answer of an e-stop process: the address of its socket, or why it has none."""

    address: str = ""
    failure: str = ""


def bind(name: str) -> tuple[socket.socket, str]:
    """Return a socket for requests and its address, as `tactile estop` looks for it.

    Parameters
    ----------
    name : part of the address that no other socket of this machine has

    Raises
    ------
    OSError
        Where it cannot be made.
    """
    folder = runtime_folder()
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    path = folder / f"estop-{name}.sock"
    if hasattr(socket, "AF_UNIX"):
        link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        path.unlink(missing_ok=True)
        link.bind(str(path))
        path.chmod(0o666)  # whoever reaches the folder may stop
    else:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.bind(("127.0.0.1", 0))
        path.write_text(str(link.getsockname()[1]))
    if hasattr(socket, "SO_PASSCRED"):
        link.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
    return link, str(path)


class Desk:
    """Carries out requests.

    Parameters
    ----------
    latches : by the name of the display
    """

    def __init__(self, latches: dict[str, Latch]) -> None:
        self._latches = latches
        self._answered: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._new = threading.Event()

    def answer(self, request: bytes, sender: str) -> dict[str, Any]:
        """Carry out a request and return the answer.

        Parameters
        ----------
        request : as of the module's docstring
        sender : who asks, for the note in the latch
        """
        try:
            content = json.loads(request)
            wanted, number = content["estop"], str(content.get("id", ""))[:LONGEST_ID]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {"error": 'no request; {"estop": null} stops all displays'}
        if number and number in self._answered:
            return self._answered[number]
        answer = self._carry_out(wanted, sender)
        if number:
            self._answered[number] = answer
            if len(self._answered) > MOST_ANSWERED:
                self._answered.popitem(last=False)
        return answer

    def _carry_out(self, wanted: object, sender: str) -> dict[str, Any]:
        if wanted is None:
            chosen = self._latches
        elif isinstance(wanted, str) and wanted in self._latches:
            chosen = {wanted: self._latches[wanted]}
        else:
            names = ", ".join(self._latches)
            error = f"no display {str(wanted)[:64]!r}; there are {names}"
            return {"error": error, "unknown": True}
        return {"estops": {name: latch.trip(sender) for name, latch in chosen.items()}}

    def serve(self, link: socket.socket) -> None:
        """Wait for a request, carry it out and answer it."""
        extra: list[tuple[int, int, bytes]] = []
        try:
            if hasattr(link, "recvmsg"):
                space = socket.CMSG_SPACE(CREDENTIALS.size)
                request, extra, _, address = link.recvmsg(LARGEST_REQUEST, space)
            else:
                request, address = link.recvfrom(LARGEST_REQUEST)
        except OSError as error:  # Windows tells of what an earlier answer met
            log.warning("a request could not be read: %s", error)
            return
        answer = json.dumps(self.answer(request, f"by tactile estop{_user(extra)}")).encode()
        if address:
            with suppress(OSError):  # who does not read the answer needs none
                link.sendto(answer, getattr(socket, "MSG_DONTWAIT", 0), address)
        self._new.set()

    def save(self) -> None:
        """Write e-stops to the disk as they come, for ever; latched they are before."""
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
    """End this process when its standard input does."""
    while pipe.read(1):
        continue
    Path(address).unlink(missing_ok=True)
    os._exit(0)


def main() -> None:
    """Serve until standard input ends, which is when the server does."""
    pipe: Any = os.fdopen(os.dup(0), "rb", buffering=0)
    out: Any = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        setup: EstopSetup = pickle.load(pipe)
        link, address = bind(str(os.getppid()))
    except (EOFError, pickle.UnpicklingError):
        sys.exit(1)
    except OSError as error:
        pickle.dump(EstopReady(failure=str(error)), out)
        out.flush()
        sys.exit(1)
    desk = Desk({name: Latch(h, LatchWriter.ESTOP_PROCESS) for name, h in setup.latches.items()})
    pickle.dump(EstopReady(address), out)
    out.flush()
    threading.Thread(target=desk.save, daemon=True).start()
    threading.Thread(target=_end_with, args=(pipe, address), daemon=True).start()
    while True:
        desk.serve(link)
