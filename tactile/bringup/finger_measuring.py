"""Measurement of a finger that rests on a display: a quarter of a second at 20 V at most.

What the skin couples takes `coupling_measuring` 1.2 s more.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bringup.coupling_measuring import CouplingReport, check_neighbors, measure_neighbors
from tactile.bringup.current_measuring import MeasuringDevice, Progress, measuring_device
from tactile.bringup.finger_response import check_response_file, save_response, typical_stiffness
from tactile.display.display import Display, load_display
from tactile.errors import BusError, InputError
from tactile.playback.sum_windows import PlayedWindow
from tactile.sensing.baseline import Baseline
from tactile.sensing.baseline_file import Calibration
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.finger_drive import measuring_drive
from tactile.sensing.hysteresis import PlayModel
from tactile.sensing.population import Population, load_stiffness
from tactile.sensing.resting_load import LEAST_WINDOWS, MeasuredLoads, measure_loads
from tactile.sensing.uncertainty import (
    DECIBELS,
    FREQUENCY,
    shear_deviation,
    stiffness_deviation,
)

REPORTED = (30.0, 100.0, 300.0, 1000.0)
"""Frequencies for which a load is reported [Hz]."""
CONSTANTS = ("k0_n_per_m", "d0_n_s_per_m", "k1_n_per_m", "d1_n_s_per_m")
"""Names of the constants of a load, as `tactile adjust` names them."""

IN_AIR = "in air"
"""Note on a contactor that nothing touches."""


@dataclass
class TouchedContactor:
    """Finger on one contactor; names of attributes carry their units.

    Values of the load are None where nothing touches or no load explains the current. Deviations
    are standard deviations.

    Attributes
    ----------
    contactor, channel : int
        Contactor and its drive line.
    windows : int
        Number of windows that could be used.
    touching : bool
        Whether something touches the contactor.
    explained : bool
        Whether the load, or that nothing touches, explains the current.
    note : str
        Why the load is not known; empty if it is.
    stiffness_n_per_m, stiffness_deviation_n_per_m : list of float or None
        Real part of the dynamic stiffness k = jωZ of the load at each frequency of the report.
    damping_n_s_per_m, damping_deviation_n_s_per_m : list of float or None
        Im k/ω, the real part of the mechanical impedance, at each frequency of the report.
    constants, constants_deviation : dict of str to float, or None
        k = k0 + jω d0 + jω k1 d1/(k1 + jω d1). Deviations are relative to the constants.
    level_deviation_db : float or None
        Deviation of the level of the shear that is played with a filter for this load, 10–1000 Hz.
    fixed_level_db : float or None
        Mean level of the shear that is played with the fixed finger of the display file, re the
        commanded shear, 10–1000 Hz.
    """

    contactor: int
    channel: int
    windows: int
    touching: bool
    explained: bool
    note: str = ""
    stiffness_n_per_m: list[float] | None = None
    stiffness_deviation_n_per_m: list[float] | None = None
    damping_n_s_per_m: list[float] | None = None
    damping_deviation_n_s_per_m: list[float] | None = None
    constants: dict[str, float] | None = None
    constants_deviation: dict[str, float] | None = None
    level_deviation_db: float | None = None
    fixed_level_db: float | None = None


@dataclass
class FingerReport:
    """Result of a measurement; names of attributes carry their units.

    Attributes
    ----------
    display, device : str
        Name of the display and URL of the device.
    calibrated : str
        Date of the calibration in air.
    seconds : float
        Duration of the drive [s].
    voltage_v : float
        Largest magnitude of the drive [V].
    windows : int
        Number of windows that were due.
    frequency_hz : list of float
        Frequencies of the lists of a contactor [Hz].
    contactors : list of TouchedContactor
        Contactors in the order of the display.
    known : int
        Number of contactors with a load that is known.
    written : str or None
        File that was written; None if none was.
    coupling : CouplingReport or None
        Coupling of neighbors through the skin; None if it was not asked for. If it is known, the
        loads are those of contactors whose neighbors rest, and not of all that move alike.
    """

    display: str
    device: str
    calibrated: str
    seconds: float
    voltage_v: float
    windows: int
    frequency_hz: list[float] = field(default_factory=lambda: list(REPORTED))
    contactors: list[TouchedContactor] = field(default_factory=list)
    known: int = 0
    written: str | None = None
    coupling: CouplingReport | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data.

        Returns
        -------
        dict of str to Any
            Values that can be written as JSON, by the names of the attributes; without a coupling
            that was not asked for.
        """
        facts = asdict(self)
        if self.coupling is None:
            del facts["coupling"]
        return facts


def measure_finger(
    url: str,
    source: str | Path,
    calibration: Calibration,
    *,
    csv: Path | None = None,
    contactor: int | None = None,
    coupling: bool = False,
    force: bool = False,
    progress: Progress | None = None,
    accept_unsafe_hold: bool = False,
) -> tuple[FingerReport, MeasuredLoads]:
    """Measure the finger that rests on a display.

    Parameters
    ----------
    url : str
        URL of the device.
    source : str or Path
        Name or file of the display.
    calibration : Calibration
        What its contactors draw in air.
    csv : Path, optional
        File to write for `tactile adjust`, if a load is known.
    contactor : int, optional
        Contactor whose load is written; by default the median of those that are known.
    coupling : bool
        Whether to measure the coupling of neighbors too.
    force : bool
        Whether to overwrite that file.
    progress : callable, optional
        Function that is called with the time that has been played and the whole time.
    accept_unsafe_hold : bool
        As in `open_bus`.

    Returns
    -------
    report : FingerReport
        Findings.
    loads : MeasuredLoads
        Loads of all contactors.

    Raises
    ------
    TactileError
        If the device measures no currents, too few windows come, the calibration is of another
        display, or device or file cannot be used.
    """
    display = load_display(source)
    _check(display, csv, contactor, force=force)
    if coupling:
        check_neighbors(display)
    with measuring_device(url, source, accept_unsafe_hold=accept_unsafe_hold) as device:
        calibration.check_display(device.bender, len(display.contactors), device.rate)
        calibration.check_faults()
        drive = measuring_drive(device.bender, device.rate, device.limits())
        windows = _windows_of(device, drive, calibration.baseline.hysteresis, progress)
        loads = _loads_of(windows, calibration, device.rate)
        if coupling:
            coupled, loads = measure_neighbors(device, calibration, loads, progress)
    report = FingerReport(
        display.name, url, calibration.date, len(drive) / device.rate,
        float(np.abs(drive).max()), len(windows), coupling=coupled if coupling else None,
    )  # fmt: skip
    _add_contactors(report, loads, display, calibration.baseline, device.rate)
    known = loads.touching & loads.explained
    report.known = int(known.sum())
    if contactor is not None:
        known &= np.arange(len(known)) == contactor
    if csv is not None and known.any():
        save_response(csv, device.bender, typical_stiffness(loads, known), force=force)
        report.written = str(csv)
    return report, loads


def _check(display: Display, csv: Path | None, contactor: int | None, *, force: bool) -> None:
    """Raise InputError for a file that cannot be written, or a contactor that does not exist."""
    if csv is not None:
        check_response_file(csv, force=force)
    count = len(display.contactors)
    if contactor is not None and not 0 <= contactor < count:
        raise InputError(f"contactor {contactor}: the display has 0 … {count - 1}")


def _windows_of(
    device: MeasuringDevice, drive: Floats, hysteresis: PlayModel, progress: Progress | None
) -> list[PlayedWindow]:
    """Play the drive and return the windows in which it plays."""
    played = device.play(drive, progress, hysteresis=hysteresis)
    windows = [one for one in played if one.position < len(drive)]
    if not windows:
        raise BusError("no windows of currents came: does the link lose packets?")
    return windows


def _loads_of(windows: list[PlayedWindow], calibration: Calibration, rate: float) -> MeasuredLoads:
    """Return the loads that windows tell of; raise BusError if too few can be used."""
    population = Population.assumed()
    loads = measure_loads(
        CurrentModel(calibration.baseline, population, rate), population,
        [played.window for played in windows],
        noise=float(np.median(calibration.measured.noise)),
    )  # fmt: skip
    _check_windows(loads, windows)
    return loads


def _check_windows(loads: MeasuredLoads, windows: list[PlayedWindow]) -> None:
    """Raise BusError if no contactor has enough windows."""
    if loads.measured.any():
        return
    clipped = np.sum([played.clipped for played in windows], axis=0)
    why = (
        "the current was beyond the range of the converter"
        if clipped.max() > len(windows) - LEAST_WINDOWS
        else "the drive was disturbed, or the link loses packets"
    )
    raise BusError(
        f"of {len(windows)} windows of currents at most {loads.windows.max()} can be used, below "
        f"{LEAST_WINDOWS}: {why}"
    )


def _add_contactors(
    report: FingerReport, loads: MeasuredLoads, display: Display, baseline: Baseline, rate: float
) -> None:
    """Add the contactors to a report."""
    frequency = np.array(REPORTED)
    omega = 2 * np.pi * frequency
    stiffness = load_stiffness(loads.logarithms, frequency)
    deviation = stiffness_deviation(loads.logarithms, loads.covariance, frequency)
    relative = np.sqrt(np.einsum("nii->ni", loads.covariance))
    level = shear_deviation(baseline, loads.logarithms, loads.covariance)
    fixed = _fixed_level(loads, display, baseline, rate)
    for k in range(len(level)):
        note = _note(loads, k)
        one = TouchedContactor(
            k, int(display.channel[k]), int(loads.windows[k]), bool(loads.touching[k]),
            bool(loads.explained[k]), note,
        )  # fmt: skip
        if not note:
            one.stiffness_n_per_m = stiffness[k].real.tolist()
            one.stiffness_deviation_n_per_m = deviation[k].real.tolist()
            one.damping_n_s_per_m = (stiffness[k].imag / omega).tolist()
            one.damping_deviation_n_s_per_m = (deviation[k].imag / omega).tolist()
            constants = np.exp(loads.logarithms[k]).tolist()
            one.constants = dict(zip(CONSTANTS, constants, strict=True))
            one.constants_deviation = dict(zip(CONSTANTS, relative[k].tolist(), strict=True))
            one.level_deviation_db = float(level[k])
            one.fixed_level_db = float(fixed[k])
        report.contactors.append(one)


def _note(loads: MeasuredLoads, k: int) -> str:
    """Return why the load of a contactor is not known, or nothing."""
    if not loads.measured[k]:
        return f"only {loads.windows[k]} windows can be used, below {LEAST_WINDOWS}"
    if not loads.explained[k]:
        return "touched, or changed since the calibration: no load explains the current"
    return "" if loads.touching[k] else IN_AIR


def _fixed_level(
    loads: MeasuredLoads, display: Display, baseline: Baseline, rate: float
) -> NDArray[np.float64]:
    """Return the mean level (N,) of the shear that the display's fixed filters play [dB]."""
    expected = display.responses(FREQUENCY, rate)[len(display.load_forces) // 2][display.kind]
    force, stiffness = baseline.tip(FREQUENCY)
    moved = force / (stiffness + load_stiffness(loads.logarithms, FREQUENCY))
    moved = moved * baseline.bender.electrode_voltage(FREQUENCY)
    return np.asarray(DECIBELS * np.log(np.abs(moved / expected)).mean(axis=1))
