"""Measurement of how strongly the skin couples neighboring contactors: 1.2 s at 20 V at most."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bringup.current_measuring import MeasuringDevice, Progress
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.playback.finger_following import WINDOW_MS
from tactile.sensing.baseline_file import Calibration
from tactile.sensing.coupling_drive import CouplingPlan, plan_coupling
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.neighbors import neighbor_pairs, sign_patterns
from tactile.sensing.population import Population
from tactile.sensing.resting_load import MeasuredLoads
from tactile.sensing.skin_coupling import (
    MeasuredCoupling,
    SlotWindow,
    level_together,
    measure_coupling,
    touched_pairs,
)

UNTOUCHED = "no two neighboring contactors are touched: rest the finger on more of the display"
"""Note of a measurement that was not made."""
UNKNOWN = "of no two neighboring contactors the load is known: keep the finger still"
"""Note of a measurement that told nothing."""


@dataclass
class CoupledPair:
    """Coupling of two neighbors; names of attributes carry their units.

    Attributes
    ----------
    contactors : tuple of int
        Both contactors.
    along_x_mm, along_y_mm : float
        Their distance along each axis [mm].
    coupling : float
        Coupling c: the skin between them has −c times the geometric mean of both loads. It is that
        of shears along the direction of each contactor.
    deviation : float
        Standard deviation of c.
    """

    contactors: tuple[int, int]
    along_x_mm: float
    along_y_mm: float
    coupling: float
    deviation: float


@dataclass
class CouplingDirection:
    """Couplings of all neighbors that are equally far apart; names of attributes carry their units.

    Attributes
    ----------
    along_x_mm, along_y_mm : float
        Distance along each axis [mm].
    pairs : int
        Number of pairs.
    coupling : float
        Median of the couplings.
    deviation : float
        Median of the standard deviations of the pairs, which the median does not exceed.
    """

    along_x_mm: float
    along_y_mm: float
    pairs: int
    coupling: float
    deviation: float


@dataclass
class CouplingReport:
    """Couplings of neighbors; names of attributes carry their units.

    Attributes
    ----------
    seconds : float
        Duration of the drive [s]; 0 if nothing was played.
    pairs : list of CoupledPair
        Pairs of neighbors whose loads are known.
    directions : list of CouplingDirection
        The same by their distance along both axes.
    together_db, most_together_db : float or None
        Level of the shear, re the commanded one, that an equalizer without coupling plays when all
        contactors are to move alike, 10–1000 Hz: mean over contactors, and that of the contactor
        that is farthest off. None without pairs.
    note : str
        Why there are no pairs; empty if there are.
    """

    seconds: float = 0.0
    pairs: list[CoupledPair] = field(default_factory=list)
    directions: list[CouplingDirection] = field(default_factory=list)
    together_db: float | None = None
    most_together_db: float | None = None
    note: str = ""


def check_neighbors(display: Display) -> None:
    """Check that a display has neighbors.

    Parameters
    ----------
    display : Display
        The display.

    Raises
    ------
    InputError
        If it has one contactor only.
    """
    if len(display.contactors) < 2:
        raise InputError(f"display {display.name!r}: its only contactor has no neighbors")


def measure_neighbors(
    device: MeasuringDevice,
    calibration: Calibration,
    alike: MeasuredLoads,
    progress: Progress | None = None,
) -> tuple[CouplingReport, MeasuredLoads]:
    """Measure the couplings of the touched contactors of a display.

    Parameters
    ----------
    device : MeasuringDevice
        Open device.
    calibration : Calibration
        What its contactors draw in air.
    alike : MeasuredLoads
        Loads that were measured while all contactors moved alike.
    progress : callable, optional
        Function that is called with the time that has been played and the whole time.

    Returns
    -------
    report : CouplingReport
        Findings.
    loads : MeasuredLoads
        Loads of contactors whose neighbors rest; ``alike`` if nothing was played.

    Raises
    ------
    BusError
        If the device stops, or no windows come.
    """
    display = device.display
    pairs = neighbor_pairs(display.contactors)
    if not len(touched_pairs(pairs, alike)):
        return CouplingReport(note=UNTOUCHED), alike
    plan = plan_coupling(
        device.bender, device.rate, device.limits(), sign_patterns(display.contactors, pairs),
        window=round(WINDOW_MS * 1e-3 * device.rate),
    )  # fmt: skip
    slots = _slots(device, plan, calibration, progress)
    model = CurrentModel(calibration.baseline, Population.assumed(), device.rate)
    measured = measure_coupling(
        model, Population.assumed(), slots, plan.signs, pairs,
        noise=float(np.median(calibration.measured.noise)),
    )  # fmt: skip
    report = _report(measured, display, calibration)
    report.seconds = len(plan.drive) / device.rate
    return report, measured.loads


def _slots(
    device: MeasuringDevice,
    plan: CouplingPlan,
    calibration: Calibration,
    progress: Progress | None,
) -> list[SlotWindow]:
    """Play the drive and return the windows that lie within one slot."""
    played = device.play(plan.drive, progress, hysteresis=calibration.baseline.hysteresis)
    length, slots = len(plan.tones), len(plan.signs)
    return [
        SlotWindow(one.position // length, one.position % length, one.window)
        for one in played
        if one.position // length == (one.end - 1) // length < slots
    ]


def _report(
    measured: MeasuredCoupling, display: Display, calibration: Calibration
) -> CouplingReport:
    """Return the report on couplings, as those of shears along the contactors' directions."""
    pairs, polarity = measured.pairs, display.polarity
    if not len(pairs):
        return CouplingReport(note=UNKNOWN)
    value = measured.value * polarity[pairs].prod(axis=1)
    apart = 1e3 * np.abs(display.contactors[pairs[:, 0]] - display.contactors[pairs[:, 1]])
    report = CouplingReport()
    for (i, j), (x, y), c, spread in zip(pairs, apart, value, measured.deviation, strict=True):
        report.pairs.append(CoupledPair((int(i), int(j)), float(x), float(y), c, spread))
    places, which = np.unique(np.round(apart, 1), axis=0, return_inverse=True)
    for number in np.argsort(np.hypot(*places.T), kind="stable"):
        x, y = places[number]
        report.directions.append(_direction(x, y, which.ravel() == number, value, measured))
    level = level_together(calibration.baseline, measured, polarity)
    report.together_db = float(level.mean())
    report.most_together_db = float(level[np.argmax(np.abs(level))])
    return report


def _direction(
    x: float, y: float, which: NDArray[np.bool_], value: Floats, measured: MeasuredCoupling
) -> CouplingDirection:
    """Return the couplings of some of the pairs."""
    return CouplingDirection(
        float(x), float(y), int(which.sum()), float(np.median(value[which])),
        float(np.median(measured.deviation[which])),
    )  # fmt: skip
