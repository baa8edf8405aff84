"""The feed of a display: what JACK plays in each cycle, on its way to the display."""

from typing import Any

import numpy as np

from tactile.arrays import Singles
from tactile.client import RemoteDisplay
from tactile.clock import MONOTONIC, Clock
from tactile.jack.card_messages import JackCycle
from tactile.jack.delay import Delay
from tactile.jack.frame_numbers import FrameNumbers
from tactile.jack.meters import Meters

SHORTEST = 1e-3
"""Duration of the frames that are sent at once, at least [s], since each message costs the server
some work. Assumed: a small part of the headroom."""
FARTHEST = 0.9
"""Longest time by which frames are sent before they are put out [s]; the server takes 1 s."""
FILLED = 0.1
"""Longest hole in what comes from JACK that is filled with the frame before it [s]. Assumed: longer
than a machine stands still as a rule; the display holds a frame that is missing just as well, but
then begins anew."""
CONTINUED = 1e-3
"""Largest difference between the times of frames that are one stream [s], as for the server."""


class CardFeed:
    """Feed of a display with the cycles of JACK.

    Parameters
    ----------
    display : RemoteDisplay
        Display that plays.
    channels : int
        Number of contactors.
    full_scale : float
        Shear of a sample of 1 [m].
    delay : Delay
        Delay from JACK to the skin.
    clock : Clock
        Monotonic clock.

    Attributes
    ----------
    open : bool
        Whether cycles are sent; others are measured only.
    meters : Meters
        Meters of all channels.
    numbers : FrameNumbers
        Numbers of the frames that came.
    frames : int
        Number of frames that were sent, with those that fill holes.
    late, early : int
        Number of frames that were not sent because their time had passed, or was too far ahead.
    rate : float or None
        Sample rate of the last cycle; None before the first one [Hz].
    buffer : int or None
        Number of frames of the last cycle.
    xruns : int
        Number of times that JACK was late.
    """

    def __init__(
        self,
        display: RemoteDisplay,
        channels: int,
        full_scale: float,
        delay: Delay,
        clock: Clock = MONOTONIC,
    ) -> None:
        self._display, self._channels = display, channels
        self._full_scale, self._delay, self._clock = full_scale, delay, clock
        self._writer: Any = None
        self._earlier_xruns = self._card_xruns = 0
        self._last: Singles | None = None
        """Last frame that came while the feed was open (1, N)."""
        self._joined: list[Singles] = []
        """Frames that are not sent yet, because they are few."""
        self._begin = 0.0
        """Time of the first of them in JACK [s]."""
        self.open = False
        self.meters, self.numbers = Meters(channels), FrameNumbers()
        self.frames = self.late = self.early = 0
        self.rate: float | None = None
        self.buffer: int | None = None

    @property
    def xruns(self) -> int:
        """Number of times that JACK was late."""
        return self._earlier_xruns + self._card_xruns

    def restart(self) -> None:
        """Take the next cycle for the first of another sequence."""
        self.numbers.restart()
        self._forget()

    def take(self, cycle: JackCycle) -> None:
        """Measure a cycle, and send it to the display if the feed is open.

        Parameters
        ----------
        cycle : JackCycle
            What came into the ports.

        Raises
        ------
        InputError
            If the display takes no frames of that rate, or has other contactors than it had.
        """
        frames = np.frombuffer(cycle.data, np.float32).reshape(-1, self._channels)
        self.buffer = len(frames)
        missing = self.numbers.take(cycle.number, len(frames))
        if cycle.xruns < self._card_xruns:  # of another process
            self._earlier_xruns += self._card_xruns
        self._card_xruns = cycle.xruns
        frames = self.meters.take(frames, cycle.rate)
        if self._writer is None or cycle.rate != self.rate:
            self._forget()
            self._writer = self._display.frames(cycle.rate, amplitude=self._full_scale)
            self.rate = cycle.rate
        if not self.open:
            self._forget()
            return
        time, last = cycle.time, self._last
        self._last = frames[-1:]
        if last is not None and 0 < missing <= FILLED * cycle.rate:
            frames = np.concatenate([np.repeat(last, missing, axis=0), frames])
            time -= missing / cycle.rate
        self._join(frames, time, cycle.rate)

    def _forget(self) -> None:
        """Forget what came before."""
        self._last = None
        self._joined.clear()

    def _join(self, frames: Singles, time: float, rate: float) -> None:
        """Send frames (F, N) with their time in JACK [s], as soon as there are enough of them."""
        count = sum(map(len, self._joined))
        if count and abs(time - self._begin - count / rate) > CONTINUED:
            self._send(rate)
            count = 0
        if not count:
            self._begin = time
        self._joined.append(frames)
        if count + len(frames) >= SHORTEST * rate:
            self._send(rate)

    def _send(self, rate: float) -> None:
        """Send the frames that were joined, unless the display could not play them."""
        frames = self._joined[0] if len(self._joined) == 1 else np.concatenate(self._joined)
        self._joined.clear()
        time, now = self._begin + self._delay.seconds, self._clock.now()
        if time + len(frames) / rate < now:
            self.late += len(frames)
        elif time > now + FARTHEST:
            self.early += len(frames)
        else:
            self._writer.write_block(frames, time=time)
            self.frames += len(frames)
