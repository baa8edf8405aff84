"""Playback that follows the finger: what the bus measures becomes filters of the renderer."""

from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bus.base import Bus
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.playback.estimates import EstimateAnswer, EstimateRequest, Estimates, OwnEstimates
from tactile.playback.followed_finger import FollowedFinger
from tactile.playback.guard_keeping import GuardKeeping
from tactile.playback.sum_windows import SumWindows
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.sensing.baseline_file import Calibration
from tactile.sensing.bender import bender_of
from tactile.sensing.guard import WIDEST_LOOP, GuardFilters
from tactile.sensing.load_follower import FollowedLoads, LoadFollower
from tactile.sensing.population import load_stiffness

WINDOW_MS = 25
"""Length of the windows for which the estimator's constants hold [ms]."""
LONGEST_GAP = 0.25
"""Time without loads after which the filters of the mean finger play: no currents come, or nothing
estimates them [s]."""
STIFFNESS_AT = 100.0
"""Frequency of the stiffness in `FollowedFinger` [Hz]."""
MOST_CHANGES = 64
"""Largest number of changes that wait to be taken; the oldest are dropped."""


def default_calibration(display: str) -> Path:
    """Return the file in which a display's calibration is looked for.

    Parameters
    ----------
    display : str
        Name of the display.

    Returns
    -------
    Path
        File in the present folder.
    """
    return Path(f"{display}.sensing.npz")


@dataclass
class FollowingFigures:
    """Figures of a stroke that followed the finger; names of attributes carry their units.

    Attributes
    ----------
    windows : int
        Number of windows of which loads were estimated.
    dropped_windows : int
        Number of windows that could not be used by any contactor.
    touched_share : float
        Share of the contactors on which a finger was, in the mean of all windows.
    deviation_db : float or None
        Standard deviation of the level of the played shear that follows from that of the loads:
        mean over windows of the median of the contactors.
    unexplained_share : float
        Share of contactors and windows whose current no load explained.
    lifted, touched : int
        Number of times that a contactor lost its finger, and that it was touched again.
    guarded : int
        Number of times that a guard in an amplifier turned a contactor down.
    """

    windows: int = 0
    dropped_windows: int = 0
    touched_share: float = 0.0
    deviation_db: float | None = None
    unexplained_share: float = 0.0
    lifted: int = 0
    touched: int = 0
    guarded: int = 0


@dataclass(frozen=True)
class TouchChange:
    """Contactors that a finger has touched, or from which it has lifted.

    Attributes
    ----------
    kind : str
        "touched" or "lifted".
    contactors : tuple of int
        Contactors in ascending order.
    """

    kind: Literal["touched", "lifted"]
    contactors: tuple[int, ...]


class FingerFollowing:
    """Filters of what plays, which follow what the bus measures.

    Parameters
    ----------
    display : Display
        Display with N contactors.
    bus : Bus
        Bus that drives it.
    calibration : Calibration
        What its contactors draw in air.
    estimates : Estimates, optional
        Where loads are estimated; by default as windows come.

    Raises
    ------
    InputError
        If the bus does not measure currents, or the calibration is of another display or has
        faults.

    Attributes
    ----------
    follower : LoadFollower
        What turns shear into volts.
    guards : bool
        Whether guards in the amplifier judge whether contactors still have the finger: it has some,
        and no hysteresis is wider than `WIDEST_LOOP`.
    loads : FollowedLoads or None
        Latest loads; None before the first, and when none have come for `LONGEST_GAP`.
    finger : FollowedFinger or None
        The same loads, for the server.
    """

    def __init__(
        self,
        display: Display,
        bus: Bus,
        calibration: Calibration,
        estimates: Estimates | None = None,
    ) -> None:
        if not bus.correlates:
            raise InputError(
                "finger follow: the device measures no currents; play with the fixed finger of the "
                "display, or use an amplifier with the feature CORRELATES"
            )
        self._rate = rate = bus.wiring.sample_rate
        bender = bender_of(display.bimorph, display.amplifier, rate)
        calibration.check_display(bender, len(display.contactors), rate)
        calibration.check_faults()
        widths = calibration.baseline.hysteresis.loop_width(display.limits.voltage)
        self.guards = bus.guards and bool(widths.max() <= WIDEST_LOOP)
        self.follower = LoadFollower(
            calibration.baseline,
            polarity=display.polarity,
            sample_rate=rate,
            noise=float(np.median(calibration.measured.noise)),
            guarded=self.guards,
        )
        self._estimates = estimates or OwnEstimates()
        self._estimates.begin(self.follower)
        self.loads: FollowedLoads | None = None
        self.finger: FollowedFinger | None = None
        self._bus = bus
        self._windows = SumWindows(display, bus, calibration.baseline.hysteresis)
        self._keeping = GuardKeeping(display)
        self._guards: GuardFilters | None = None
        """What guards expected last; None if none is armed."""
        self._disarming = False
        """Whether all guards are to be disarmed."""
        self._figures = FollowingFigures()
        self._deviations = 0, 0.0
        """Number of windows with a finger, and the sum of their median deviations [dB]."""
        self._unexplained = 0
        self._changes: deque[TouchChange] = deque(maxlen=MOST_CHANGES)
        self._generation = self._delay = self._latest = 0
        """Number of times that all was forgotten; time from the latest request to its answer, and
        position at which loads came last [samples]."""
        self._reconnects = bus.counters.reconnects

    def restart(self) -> None:
        """Forget the finger and all that was measured, before the bus begins another stream."""
        self._bus.take_correlations()
        self._windows.restart()
        self._latest = 0
        self._keeping.restart()
        self._guards = None
        self._forget(0)

    def _forget(self, written: int) -> None:
        """Forget the finger; the filters of the mean one fade in, and guards will be disarmed."""
        self._keeping.forget(written)
        self._disarming = self._guards is not None
        self._generation += 1
        self.loads = self.finger = None
        self.follower.play_mean(round(WINDOW_MS * 1e-3 * self._rate))

    def wrote(self, position: int, drive: Floats) -> None:
        """Note drive that was written, and follow what has been measured by now.

        Parameters
        ----------
        position : int
            Position of the first sample.
        drive : (S, N) array of float
            Drive of each contactor [V].
        """
        self._windows.wrote(position, drive)
        end = position + len(drive)
        if self._bus.counters.reconnects != self._reconnects:
            self._reconnects = self._bus.counters.reconnects
            self._windows.gains.restart()  # as amplifiers do that were started again
            self._forget(end)
        gains = self._windows.gains
        for played in self._windows.take():
            self._figures.dropped_windows += not played.window.valid.any()
            late = end + self._delay - played.end
            self._estimates.ask(
                EstimateRequest(
                    self._generation, end, played.window, late + LOOK_AHEAD,
                    late - self._ahead, gains.trips,
                )
            )  # fmt: skip
            self._follow(end)
        self._follow(end)
        if self.finger is not None and self.finger.guarded is not gains.tripped:
            self.finger = replace(self.finger, guarded=gains.tripped)
        if self.loads is not None and end - self._latest > LONGEST_GAP * self._rate:
            self._forget(end)
        if self._disarming:
            self._disarm(end)

    def _follow(self, end: int) -> None:
        """Begin to play the filters that have been computed by now."""
        for answer in self._estimates.take():
            if answer.generation == self._generation:
                self._delay, self._latest = end - answer.end, end
                self.follower.apply(answer.update)
                self._count(answer.update.loads)
                self.loads = answer.update.loads
                self.finger = _finger_of(self.loads, self._windows.gains.tripped)
                self._guard(answer, end)

    @property
    def watched(self) -> NDArray[np.bool_]:
        """Whether guards watch over the travel of each contactor, array (N,).

        What they have turned down moves by a thirtieth of what the drive says.
        """
        return self._keeping.relied_on | self._windows.gains.tripped

    @property
    def _ahead(self) -> int:
        """Number of samples that are written before they are put out."""
        return round(self._bus.ahead * self._rate)

    def _guard(self, answer: EstimateAnswer, end: int) -> None:
        """Tell guards what to expect under the loads of an answer."""
        gains = self._windows.gains
        settings = self._keeping.settings(
            answer.update, tripped=gains.tripped, known=answer.trips == gains.trips,
            written=end, put_out=end - self._ahead,
        )  # fmt: skip
        self._guards, self._disarming = answer.update.guards, False
        if settings is not None:
            self._bus.set_guards(settings)

    def _disarm(self, end: int) -> None:
        """Disarm all guards as soon as what is put out has been bounded by the limiter."""
        assert self._guards is not None
        settings = self._keeping.disarm(self._guards, put_out=end - self._ahead)
        if settings is not None:
            self._bus.set_guards(settings)
            self._guards, self._disarming = None, False

    def _count(self, loads: FollowedLoads) -> None:
        """Count the loads of a window in."""
        figures = self._figures
        if self.loads is not None:
            before = self.loads.touching
            figures.lifted += self._note("lifted", before & ~loads.touching)
            figures.touched += self._note("touched", ~before & loads.touching)
        figures.windows += 1
        figures.touched_share += float(np.mean(loads.touching))
        figures.unexplained_share += float(np.mean(~loads.explained))
        self._unexplained += int(np.sum(~loads.explained))
        if loads.touching.any():
            count, total = self._deviations
            median = float(np.median(loads.deviation[loads.touching]))
            self._deviations = count + 1, total + median

    def _note(self, kind: Literal["touched", "lifted"], changed: NDArray[np.bool_]) -> int:
        """Note contactors whose touch has changed; return their number."""
        contactors = tuple(np.flatnonzero(changed).tolist())
        if contactors:
            self._changes.append(TouchChange(kind, contactors))
        return len(contactors)

    def take_changes(self) -> list[TouchChange]:
        """Remove and return the changes that nobody has taken.

        Returns
        -------
        list of TouchChange
            Changes in order.
        """
        taken = list(self._changes)
        self._changes.clear()
        return taken

    @property
    def failure(self) -> str:
        """Reason why loads are not estimated any more; empty if they are."""
        return self._estimates.failure

    @property
    def counters(self) -> dict[str, int]:
        """Counters by name: windows, those that could not be used, and what they told."""
        figures = self.figures
        return {
            "finger_windows": figures.windows,
            "dropped_finger_windows": figures.dropped_windows,
            "touched_contactors": figures.touched,
            "lifted_contactors": figures.lifted,
            "unexplained_loads": self._unexplained,
            "guarded_contactors": figures.guarded,
        }

    @property
    def figures(self) -> FollowingFigures:
        """Figures of the stroke so far."""
        done, count = self._figures, max(self._figures.windows, 1)
        touched, deviations = self._deviations
        return FollowingFigures(
            windows=done.windows,
            dropped_windows=(
                done.dropped_windows + self._windows.dropped + self._estimates.dropped
            ),
            touched_share=done.touched_share / count,
            deviation_db=deviations / touched if touched else None,
            unexplained_share=done.unexplained_share / count,
            lifted=done.lifted,
            touched=done.touched,
            guarded=int(self._windows.gains.trips.sum()),
        )


def _finger_of(loads: FollowedLoads, guarded: NDArray[np.bool_]) -> FollowedFinger:
    """Return the loads with which others are served."""
    stiffness = np.abs(load_stiffness(loads.logarithms, np.array([STIFFNESS_AT])))[:, 0]
    touching = loads.touching
    return FollowedFinger(
        touching,
        np.where(touching, stiffness, 0.0),
        np.where(touching, loads.deviation, 0.0),
        loads.explained,
        guarded,
    )
