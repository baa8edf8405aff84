"""Host side of the connection to the audio player, the program that holds an audio card.

Whether that program crashes, hangs or ends, the host waits for it no longer than the given time,
and then kills it, which also ends the card's output.
"""

import os
import pickle
import select
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, cast

import numpy as np

from tactile.arrays import Floats
from tactile.bus.audio.devices import Device
from tactile.bus.audio.player import Failed, Order, PlayerStatus, StreamOpened
from tactile.clock import MONOTONIC
from tactile.errors import BusError, InputError, NotFoundError

OPENING = 20.0
"""Time limit for PortAudio to search for cards, which can be slow, and to open one [s]."""
ANSWER = 1.0
"""Time limit for the player to answer [s]."""
PROGRAM = "import sys; sys.path[:] = {!r}; from tactile.bus.audio.player import main; main()"
"""Program of the player, to be formatted with the host's path to import the same package."""
KINDS = {"InputError": InputError, "NotFoundError": NotFoundError}
"""Errors that the player reports by name; all others become a `BusError`."""


class AudioProcess:
    """The player's process, started on construction.

    Parameters
    ----------
    order : Order or None
        Description of the stream to be opened; None to list the devices.

    Attributes
    ----------
    opened : StreamOpened or None
        The open stream; None before that.
    told : Told or None
        Latest state that the player reported.
    status_time : float
        Time at which it was reported [s].
    failed : Failed or None
        Reason why no stream could be opened.
    listed : tuple of (list of Device, int) or None
        Output devices and number of the default one, if they were to be listed.
    output : (S, C) array of float or None
        Answer to the message "output" [V].
    ended : bool
        Whether the player's output has ended.
    """

    def __init__(self, order: Order | None) -> None:
        self.opened: StreamOpened | None = None
        self.status: PlayerStatus | None = None
        self.status_time = 0.0
        self.failed: Failed | None = None
        self.listed: tuple[list[Device], int] | None = None
        self.output: Floats | None = None
        self.ended, self._sent = False, 0
        self._sending, self._changed = threading.Lock(), threading.Condition()
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(sys.path)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            start_new_session=True, bufsize=0,
        )  # fmt: skip
        self._thread = threading.Thread(target=self._read, name="tactile-audio", daemon=True)
        self._thread.start()
        if os.name == "posix":
            os.set_blocking(cast(Any, self._process.stdin).fileno(), False)
        self._send(order, ANSWER)

    def _read(self) -> None:
        """Receive messages until the output of the program ends."""
        stream = open(cast(Any, self._process.stdout).fileno(), "rb", closefd=False)  # noqa: SIM115
        with stream:
            while not self.ended:
                try:
                    message = pickle.load(stream)
                except (EOFError, OSError, pickle.UnpicklingError):
                    message = None
                with self._changed:
                    self._store(message)
                    self._changed.notify_all()

    def _store(self, message: object) -> None:
        """Store a message, None for the end of the output."""
        if isinstance(message, PlayerStatus):
            self.status, self.status_time = message, MONOTONIC.now()
        elif isinstance(message, StreamOpened):
            self.opened = message
        elif isinstance(message, Failed):
            self.failed = message
        elif isinstance(message, np.ndarray):
            self.output = message
        elif isinstance(message, tuple):
            self.listed = cast(tuple[list[Device], int], message)
        else:
            self.ended = True

    def _send(self, message: object, seconds: float) -> None:
        """Write a message; kill a program that does not accept it in time."""
        data = memoryview(pickle.dumps(message, protocol=5))
        pipe = cast(Any, self._process.stdin)
        with suppress(OSError, ValueError):
            while data:
                data = data[pipe.write(data) or 0 :]
                if data and not select.select([], [pipe], [], seconds)[1]:
                    self._process.kill()
                    return

    def tell(self, kind: str, *rest: object, seconds: float = ANSWER) -> int:
        """Send a message without waiting for an answer.

        Parameters
        ----------
        kind : str
            Kind of the message.
        *rest : object
            Contents of the message.
        seconds : float
            Time limit for the player to accept the message, after which it is killed [s].

        Returns
        -------
        int
            Number of the message.
        """
        if not self._sending.acquire(timeout=seconds):
            self._process.kill()
            return self._sent
        try:
            self._sent += 1
            self._send((self._sent, kind, *rest), seconds)
            return self._sent
        finally:
            self._sending.release()

    def ask(self, kind: str = "ask", *, seconds: float = ANSWER) -> PlayerStatus | None:
        """Send a message and wait for the answer.

        Parameters
        ----------
        kind : str
            Kind of the message.
        seconds : float
            Time limit, for the message and for the answer each [s].

        Returns
        -------
        Told or None
            State of the player; None if it does not answer in time.
        """
        number = self.tell(kind, seconds=seconds)
        self.wait(lambda: self.status is not None and self.status.answered >= number, seconds)
        report = self.status
        return report if report is not None and report.answered >= number else None

    def wait(self, ready: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition holds, or the program has ended.

        Parameters
        ----------
        ready : callable
            Condition, which is evaluated after each message.
        seconds : float
            Time limit [s].

        Returns
        -------
        bool
            Whether the condition holds.
        """
        with self._changed:
            return self._changed.wait_for(lambda: ready() or self.ended, seconds) and ready()

    def settled(self, seconds: float, *, rest: bool = True) -> bool:
        """Wait until the card has taken all messages, and is at rest or not at rest as requested.

        Parameters
        ----------
        seconds : float
            Time limit [s].
        rest : bool
            Whether to wait for rest.

        Returns
        -------
        bool
            Whether the state was reached.
        """
        end = MONOTONIC.now() + seconds
        while (remaining := end - MONOTONIC.now()) > 0:
            report = self.ask(seconds=remaining)
            if report is None or self.ended or report.fault:
                return False
            if not report.waiting and (report.phase == "rest") == rest:
                return True
            MONOTONIC.sleep(5e-4)
        return False

    def exit_code(self) -> int:
        """Return the exit code of the program, which must have ended.

        Returns
        -------
        int
            Exit code; minus the number of the signal that ended it.
        """
        return self._process.wait(ANSWER)

    def kill(self) -> None:
        """Kill the program, after which the card puts out nothing."""
        self._process.kill()
        self.close(0.0)

    def close(self, seconds: float = ANSWER) -> None:
        """Let the program go to 0 V and end; kill it if it does not end in time.

        Parameters
        ----------
        seconds : float
            Time limit [s]; 0 waits without a limit.
        """
        with suppress(OSError):
            cast(Any, self._process.stdin).close()
        try:
            self._process.wait(seconds or None)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join(ANSWER)
        cast(Any, self._process.stdout).close()


def opened(player: AudioProcess) -> StreamOpened:
    """Return the stream that a player has opened.

    Parameters
    ----------
    player : AudioProcess
        Player that was started with an `Order`.

    Returns
    -------
    StreamOpened
        The open stream.

    Raises
    ------
    InputError
        If the order cannot be met, or the device is not found.
    BusError
        If the stream cannot be opened, the player crashes, or it does not answer within `OPENING`.
    """
    player.wait(lambda: player.opened is not None or player.failed is not None, OPENING)
    if player.opened is not None:
        return player.opened
    failed, ended = player.failed, player.ended
    if failed is not None:
        player.close()
        raise KINDS.get(failed.kind, BusError)(failed.text)
    player.kill()
    if ended:
        raise BusError(f"audio: PortAudio crashed (exit code {player.exit_code()})")
    raise BusError(f"audio: PortAudio finds no end in {OPENING:g} s; is its sound server alive?")
