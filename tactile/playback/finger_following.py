"""Playback that follows the finger: what the bus measures becomes filters of the renderer."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bus.base import Bus
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.playback.sum_windows import SumWindows
from tactile.rendering.limiter import LOOK_AHEAD
from tactile.sensing.baseline_file import Calibration
from tactile.sensing.bender import bender_of
from tactile.sensing.load_follower import FollowedLoads, LoadFollower

WINDOW_MS = 25
"""Length of the windows for which the estimator's constants hold [ms]."""


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
    """

    windows: int = 0
    dropped_windows: int = 0
    touched_share: float = 0.0
    deviation_db: float | None = None
    unexplained_share: float = 0.0
    lifted: int = 0
    touched: int = 0


class FingerFollowing:
    """Estimator and filters of a stroke, fed by what the bus measures.

    Parameters
    ----------
    display : Display
        Display with N contactors.
    bus : Bus
        Bus that drives it.
    calibration : Calibration
        What its contactors draw in air.

    Raises
    ------
    InputError
        If the bus does not measure currents, or the calibration is of another display or has
        faults.

    Attributes
    ----------
    follower : LoadFollower
        What turns shear into volts.
    loads : FollowedLoads or None
        Latest loads; None before the first.
    """

    def __init__(self, display: Display, bus: Bus, calibration: Calibration) -> None:
        if not bus.correlates:
            raise InputError(
                "finger follow: the device measures no currents; play with the fixed finger of the "
                "display, or use an amplifier with the feature CORRELATES"
            )
        rate = bus.wiring.sample_rate
        bender = bender_of(display.bimorph, display.amplifier, rate)
        calibration.check_display(bender, len(display.contactors), rate)
        calibration.check_faults()
        self.follower = LoadFollower(
            calibration.baseline,
            polarity=display.polarity,
            sample_rate=rate,
            noise=float(np.median(calibration.measured.noise)),
        )
        self.loads: FollowedLoads | None = None
        self._windows = SumWindows(display, bus)
        self._figures = FollowingFigures()
        self._deviations = 0, 0.0
        """Number of windows with a finger, and the sum of their median deviations [dB]."""

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
        end = position + len(drive) + LOOK_AHEAD
        for played in self._windows.take():
            loads = self.follower.take(played.window, lateness=end - played.end)
            self._count(loads, played.window.valid)
            self.loads = loads

    def _count(self, loads: FollowedLoads, valid: NDArray[np.bool_]) -> None:
        """Count a window in."""
        figures = self._figures
        if self.loads is not None:
            figures.lifted += int(np.sum(self.loads.touching & ~loads.touching))
            figures.touched += int(np.sum(~self.loads.touching & loads.touching))
        figures.windows += 1
        figures.dropped_windows += not valid.any()
        figures.touched_share += float(np.mean(loads.touching))
        figures.unexplained_share += float(np.mean(~loads.explained))
        if loads.touching.any():
            count, total = self._deviations
            median = float(np.median(loads.deviation[loads.touching]))
            self._deviations = count + 1, total + median

    @property
    def figures(self) -> FollowingFigures:
        """Figures of the stroke so far."""
        done, count = self._figures, max(self._figures.windows, 1)
        touched, deviations = self._deviations
        return FollowingFigures(
            windows=done.windows,
            dropped_windows=done.dropped_windows + self._windows.dropped,
            touched_share=done.touched_share / count,
            deviation_db=deviations / touched if touched else None,
            unexplained_share=done.unexplained_share / count,
            lifted=done.lifted,
            touched=done.touched,
        )
