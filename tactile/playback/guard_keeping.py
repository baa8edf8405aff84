"""What the guards of a display's amplifiers are told while playback follows the finger."""

import numpy as np
from numpy.typing import NDArray

from tactile.bus.guards import GuardSettings
from tactile.display.display import Display
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.sensing.guard import GuardFilters
from tactile.sensing.load_follower import GUARD_WINDOWS, FilterUpdate

NEVER = 1 << 62
"""Position after all others."""
SURE = GUARD_WINDOWS + 1
"""Number of updates in a row that must have armed a guard before it is relied on. Its settings have
then been sent at least twice."""


class GuardKeeping:
    """Decides which guards get new settings, and when a contactor that was turned down comes back.

    Guards get what they are to expect in turns, each of them in one of `GUARD_WINDOWS` windows, and
    at once where one is armed, disarmed or released. A contactor is released as soon as the filters
    of the free bender play, which then are harmless to it and let the next touch be noticed.

    Either a guard or the limiter of the host watches over the travel of a contactor at any time.
    The limiter stops only when the guard is sure to be armed, and a guard is disarmed only when
    drive is put out that the limiter has bounded again.

    Parameters
    ----------
    display : Display
        Display with N contactors.
    """

    def __init__(self, display: Display) -> None:
        self._channel = display.channel
        self._order = np.argsort(display.channel)
        self.restart()

    def restart(self) -> None:
        """Begin anew, as amplifiers do when they start: no guard is armed."""
        count = len(self._channel)
        self._armed = np.zeros(count, np.bool_)
        self._updates = np.zeros(count, np.intp)
        """Number of updates in a row that have armed each guard."""
        self._bounded_from = np.full(count, -NEVER)
        """Position from which the limiter bounds the travel of each contactor again."""
        self._free_from = np.full(count, NEVER)
        """Position from which the filters of the free bender play on contactors turned down."""
        self._turn = 0

    @property
    def relied_on(self) -> NDArray[np.bool_]:
        """Whether the guard of each contactor is sure to be armed, array (N,)."""
        return np.asarray(self._updates >= SURE)

    def settings(
        self,
        update: FilterUpdate,
        *,
        tripped: NDArray[np.bool_],
        known: NDArray[np.bool_],
        written: int,
        put_out: int,
    ) -> GuardSettings | None:
        """Return what guards are to be told after an update of the filters.

        Parameters
        ----------
        update : FilterUpdate
            Filters, which begin to play at the position `written`.
        tripped : (N,) array of bool
            Whether a guard has turned each contactor down.
        known : (N,) array of bool
            Whether the update was made with the knowledge of that.
        written : int
            Position after the latest drive that was written.
        put_out : int
            Position that is put out now.

        Returns
        -------
        GuardSettings or None
            Settings of some channels; None if there are none.
        """
        if update.guards is None:
            return None
        free = tripped & known
        plays = written + update.samples + LOOK_AHEAD
        self._free_from = np.where(free, np.minimum(self._free_from, plays), NEVER)
        release = free & (put_out >= self._free_from)
        wanted = update.judged & (~tripped | release)
        self._stop_relying(~wanted, written)
        self._updates[wanted] += 1
        staying = self._armed & ~wanted & ~tripped & (put_out < self._bounded_from)
        armed = wanted | staying
        turn = np.arange(len(armed)) % GUARD_WINDOWS == self._turn
        self._turn = (self._turn + 1) % GUARD_WINDOWS
        due = (turn | release | (armed != self._armed)) & ~staying
        self._armed = armed
        return self._of(update.guards, due, armed, release) if due.any() else None

    def _stop_relying(self, contactors: NDArray[np.bool_], written: int) -> None:
        """Let the limiter bound the travel of contactors from a position on."""
        self._bounded_from[contactors & self.relied_on] = written
        self._updates[contactors] = 0

    def forget(self, written: int) -> None:
        """Rely on no guard any more, since no load is known.

        Parameters
        ----------
        written : int
            Position after the latest drive that was written.
        """
        self._stop_relying(np.ones_like(self._armed), written)

    def disarm(self, guards: GuardFilters, *, put_out: int) -> GuardSettings | None:
        """Return settings that disarm all guards, after `forget`.

        Parameters
        ----------
        guards : GuardFilters
            What they expected last.
        put_out : int
            Position that is put out now.

        Returns
        -------
        GuardSettings or None
            Settings of all channels. What was turned down stays so. None while drive is put out
            that the limiter has not bounded.
        """
        if (put_out < self._bounded_from).any():
            return None
        none = np.zeros_like(self._armed)
        self._armed = none
        return self._of(guards, ~none, none, none)

    def _of(
        self,
        guards: GuardFilters,
        due: NDArray[np.bool_],
        armed: NDArray[np.bool_],
        release: NDArray[np.bool_],
    ) -> GuardSettings:
        """Return the settings of the contactors that are due, in the order of their channels."""
        rows = self._order[due[self._order]]
        return GuardSettings(
            self._channel[rows], armed[rows], release[rows], guards.poles[rows],
            guards.drive[rows], guards.change[rows], guards.limit[rows], guards.share,
            guards.floor[rows],
        )  # fmt: skip
