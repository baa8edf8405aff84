"""Messages that are to be sent: requests, and of streams only what is not too old.

Of each finger only the newest contact is sent, and tactile frames that wait are joined to one
message.
"""

import threading
from collections import deque
from collections.abc import Callable

from msgspec import structs

from tactile.messages import MOST_FRAME_VALUES, Command, Contact, EStop, Streamed, TactileFrames

MOST_FRAMES = 8
"""Maximum number of messages of tactile frames without times that wait; older ones are dropped."""
MOST_TIMED = 512
"""Maximum number of messages of tactile frames, if the newest has a time: a sound card sends many
at once. They are half a second of blocks of a millisecond, and 25 MB at most."""


class Outbox:
    """Messages that wait to be sent; its methods never wait, and streams do not accumulate.

    E-stops come first, then streams, then one request at a time in the order in which they came.

    Parameters
    ----------
    dropped : Callable
        Function that takes each contact that a newer one replaced, and frames that are too old.
    """

    def __init__(self, dropped: Callable[[Streamed], None]) -> None:
        self._dropped = dropped
        self._lock = threading.Lock()
        self._urgent: deque[Command] = deque()
        self._contacts: dict[str, Contact] = {}
        self._frames: deque[TactileFrames] = deque()
        self._requests: deque[Command] = deque()
        self._awake = False

    def put(self, command: Command) -> bool:
        """Add a message.

        Parameters
        ----------
        command : Command
            Message to send.

        Returns
        -------
        bool
            Whether the sender has to be woken.
        """
        replaced: Streamed | None = None
        with self._lock:
            if isinstance(command, Contact):
                replaced = self._contacts.get(command.display)
                self._contacts[command.display] = command
            elif isinstance(command, TactileFrames):
                replaced = self._put_frames(command)
            elif isinstance(command, EStop):
                self._urgent.append(command)
            else:
                self._requests.append(command)
            wake, self._awake = not self._awake, True
        if replaced is not None:
            self._dropped(replaced)
        return wake

    def _put_frames(self, frames: TactileFrames) -> TactileFrames | None:
        """Add frames, to those of their stream if they wait; return what was dropped for them."""
        joined = _joined(self._frames[-1], frames) if self._frames else None
        if joined is not None:
            self._frames[-1] = joined
            return None
        self._frames.append(frames)
        most = MOST_FRAMES if frames.time_us is None else MOST_TIMED
        return self._frames.popleft() if len(self._frames) > most else None

    def take(self, streams: bool = True) -> list[Command]:
        """Take what is to be sent next.

        Parameters
        ----------
        streams : bool
            Whether messages of streams may be sent now.

        Returns
        -------
        list of Command
            Messages; none if the sender may sleep until it is woken.
        """
        with self._lock:
            batch = list(self._urgent)
            self._urgent.clear()
            if streams:
                batch += [*self._contacts.values(), *self._frames]
                self._contacts.clear()
                self._frames.clear()
            if self._requests:
                batch.append(self._requests.popleft())
            self._awake = bool(batch)
            return batch

    @property
    def streams(self) -> int:
        """Number of messages of streams that wait."""
        return len(self._contacts) + len(self._frames)

    def clear(self) -> None:
        """Forget all messages; streams count as dropped, and a session sends e-stops again."""
        with self._lock:
            streams: list[Streamed] = [*self._contacts.values(), *self._frames]
            self._urgent.clear()
            self._contacts.clear()
            self._frames.clear()
            self._requests.clear()
        for message in streams:
            self._dropped(message)


def _joined(first: TactileFrames, then: TactileFrames) -> TactileFrames | None:
    """Return the frames of two messages as one; None if they do not fit in one."""
    assert isinstance(first.frames, bytes)
    assert isinstance(then.frames, bytes)
    if structs.replace(first, frames=b"") != structs.replace(then, frames=b""):
        return None
    if then.latest:
        return then
    values = first.frames + then.frames
    return structs.replace(then, frames=values) if len(values) <= 4 * MOST_FRAME_VALUES else None
