"""Host side of the connection to the audio player, the program that holds an audio card.

Whether that program crashes, hangs or ends, the host waits for it no longer than the given time,
and then kills it, which also ends the card's output.
"""

import os
import pickle
import select
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import cast

import numpy as np

from tactile.arrays import Floats
from tactile.bus.audio.devices import Device
from tactile.bus.audio.player import Failed, Order, PlayerStatus, StreamOpened
from tactile.clock import MONOTONIC
from tactile.errors import BusError, InputError, NotFoundError
from tactile.processes import ChildProcess

OPENING = 20.0
"""Time limit for PortAudio to search for cards, which can be slow, and to open one [s]."""
ANSWER = 1.0
"""Time limit for the player to answer [s]."""
KINDS = {"InputError": InputError, "NotFoundError": NotFoundError}
"""Errors that the player reports by name; all others become a `BusError`."""


class AudioProcess(ChildProcess):
    """The player's process, started on construction.

    Parameters
    ----------
    order : Order or None
        Description of the stream to be opened; None to list the devices.

    Attributes
    ----------
    stream : StreamOpened or None
        The open stream; None before that.
    status : PlayerStatus or None
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
        self.stream: StreamOpened | None = None
        self.status: PlayerStatus | None = None
        self.status_time = 0.0
        self.failed: Failed | None = None
        self.listed: tuple[list[Device], int] | None = None
        self.output: Floats | None = None
        self.ended, self._sent = False, 0
        self._sending, self._changed = threading.Lock(), threading.Condition()
        super().__init__("tactile.bus.audio.player", self._receive, stderr=subprocess.DEVNULL)
        if os.name == "posix":
            os.set_blocking(self._pipe.fileno(), False)
        self._write(order, ANSWER)

    def _receive(self, message: object) -> None:
        """Store a message, None for the end of the output, and wake who waits for it."""
        with self._changed:
            self._store(message)
            self._changed.notify_all()

    def _store(self, message: object) -> None:
        """Store a message, None for the end of the output."""
        if isinstance(message, PlayerStatus):
            self.status, self.status_time = message, MONOTONIC.now()
        elif isinstance(message, StreamOpened):
            self.stream = message
        elif isinstance(message, Failed):
            self.failed = message
        elif isinstance(message, np.ndarray):
            self.output = message
        elif isinstance(message, tuple):
            self.listed = cast(tuple[list[Device], int], message)
        else:
            self.ended = True

    def _write(self, message: object, seconds: float) -> None:
        """Write a message; kill a program that does not accept it in time."""
        data = memoryview(pickle.dumps(message, protocol=5))
        with suppress(OSError, ValueError):
            while data:
                data = data[self._pipe.write(data) or 0 :]
                if data and not select.select([], [self._pipe], [], seconds)[1]:
                    self._process.kill()
                    return

    def send(self, kind: str, *rest: object, seconds: float = ANSWER) -> int:
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
            self._write((self._sent, kind, *rest), seconds)
            return self._sent
        finally:
            self._sending.release()

    def request(self, kind: str = "status", *, seconds: float = ANSWER) -> PlayerStatus | None:
        """Send a message and wait for the answer.

        Parameters
        ----------
        kind : str
            Kind of the message.
        seconds : float
            Time limit, for the message and for the answer each [s].

        Returns
        -------
        PlayerStatus or None
            State of the player; None if it does not answer in time.
        """
        number = self.send(kind, seconds=seconds)
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

    def wait_for_card(self, seconds: float, *, rest: bool = True) -> bool:
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
            report = self.request(seconds=remaining)
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

    def close(self) -> None:
        """Let the program go to 0 V and end; kill it if it does not end within `ANSWER`."""
        with suppress(OSError):
            self._pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ANSWER)
        self.kill()


def opened_stream(player: AudioProcess) -> StreamOpened:
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
    player.wait(lambda: player.stream is not None or player.failed is not None, OPENING)
    if player.stream is not None:
        return player.stream
    failed, ended = player.failed, player.ended
    if failed is not None:
        player.close()
        raise KINDS.get(failed.kind, BusError)(failed.text)
    player.kill()
    if ended:
        raise BusError(f"audio: PortAudio crashed (exit code {player.exit_code()})")
    raise BusError(f"audio: PortAudio finds no end in {OPENING:g} s; is its sound server alive?")
