"""The host's end of the line to the program that holds an audio card, `audio_player`.

Whatever that program does, crash, hang or end, the host waits for it no longer than it says, and
then ends it; with it ends the card's output.
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
from tactile.bus.audio.player import Failed, Order, StreamOpened, Told
from tactile.clock import MONOTONIC
from tactile.errors import BusError, InputError, NotFoundError

OPENING = 20.0
"""s for PortAudio to look for cards, some of which take long, and to open one."""
ANSWER = 1.0
"""s for the player to answer."""
PROGRAM = "import sys; sys.path[:] = {!r}; from tactile.bus.audio.player import main; main()"
"""With the host's path, so that the same tactile is found."""
KINDS = {"InputError": InputError, "NotFoundError": NotFoundError}


class AudioProcess:
    """The program that holds the card.

    Parameters
    ----------
    order : what it opens; None to list the cards

    Attributes
    ----------
    opened : what it has opened, None until then
    told, told_at : the latest of what it told, and when [s]
    failed : why there is no card
    ended : whether it says no more
    """

    def __init__(self, order: Order | None) -> None:
        self.opened: StreamOpened | None = None
        self.told: Told | None = None
        self.told_at = 0.0
        self.failed: Failed | None = None
        self.listed: tuple[list[Device], int] | None = None
        self.output: Floats | None = None
        self.ended, self._sent = False, 0
        self._sending, self._news = threading.Lock(), threading.Condition()
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
        stream = open(cast(Any, self._process.stdout).fileno(), "rb", closefd=False)  # noqa: SIM115
        with stream:
            while not self.ended:
                try:
                    message = pickle.load(stream)
                except (EOFError, OSError, pickle.UnpicklingError):
                    message = None
                with self._news:
                    self._take(message)
                    self._news.notify_all()

    def _take(self, message: object) -> None:
        if isinstance(message, Told):
            self.told, self.told_at = message, MONOTONIC.now()
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
        """Write a message; a program that does not take it in time is ended."""
        data = memoryview(pickle.dumps(message, protocol=5))
        pipe = cast(Any, self._process.stdin)
        with suppress(OSError, ValueError):
            while data:
                data = data[pipe.write(data) or 0 :]
                if data and not select.select([], [pipe], [], seconds)[1]:
                    self._process.kill()
                    return

    def tell(self, kind: str, *rest: object, seconds: float = ANSWER) -> int:
        """Send a message; return its number."""
        if not self._sending.acquire(timeout=seconds):
            self._process.kill()
            return self._sent
        try:
            self._sent += 1
            self._send((self._sent, kind, *rest), seconds)
            return self._sent
        finally:
            self._sending.release()

    def ask(self, kind: str = "ask", *, seconds: float = ANSWER) -> Told | None:
        """Send a message that is answered, and return the answer; None where there is none."""
        number = self.tell(kind, seconds=seconds)
        self.wait(lambda: self.told is not None and self.told.answered >= number, seconds)
        told = self.told
        return told if told is not None and told.answered >= number else None

    def wait(self, ready: Callable[[], bool], seconds: float) -> bool:
        """Wait until something was told, or the program has ended."""
        with self._news:
            return self._news.wait_for(lambda: ready() or self.ended, seconds) and ready()

    def settled(self, seconds: float, *, rest: bool = True) -> bool:
        """Wait until the card has taken all and is at rest, or is not; tell whether it is so."""
        end = MONOTONIC.now() + seconds
        while (left := end - MONOTONIC.now()) > 0:
            told = self.ask(seconds=left)
            if told is None or self.ended or told.fault:
                return False
            if not told.waiting and (told.phase == "rest") == rest:
                return True
            MONOTONIC.sleep(5e-4)
        return False

    def exit_code(self) -> int:
        """Return how the program that has ended did so."""
        return self._process.wait(ANSWER)

    def kill(self) -> None:
        """End the program now; cards then put out nothing."""
        self._process.kill()
        self.close(0.0)

    def close(self, seconds: float = ANSWER) -> None:
        """Let the program end, at 0 V; where it does not within some seconds end it."""
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
    """Return what a player has opened.

    Raises
    ------
    InputError, BusError
        Where it has opened nothing, and why.
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
