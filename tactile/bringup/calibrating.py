"""Calibration of a display in air: each bender's current while a few tones play at a time.

Nothing may touch the display meanwhile. A calibration is written only if no contactor has a fault.
"""

import datetime
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactile.bringup.current_measuring import Progress, measuring_device
from tactile.display.display import Display
from tactile.playback.finger_following import WINDOW_MS
from tactile.playback.sum_windows import PlayedWindow
from tactile.sensing.admittance import AirWindows, measure_admittances
from tactile.sensing.baseline import fit_baseline
from tactile.sensing.baseline_file import (
    Calibration,
    check_calibration_file,
    save_calibration,
)
from tactile.sensing.calibration import CalibrationPlan, plan_calibration


@dataclass
class CalibratedContactor:
    """Calibration of one contactor; names of attributes carry their units.

    Attributes
    ----------
    contactor, channel : int
        Contactor and its drive line.
    capacitance_nf : float
        Capacitance at 300 Hz [nF].
    loss : float
        Loss factor tan δ at 300 Hz.
    resonance_hz : float
        Resonance in air [Hz].
    stiffness, d31, mechanical_loss : float
        Factors against the design.
    skew_us : float
        Time by which the current is sampled after the drive [µs].
    noise_ua : float
        Noise of a sample of the current, rms [µA].
    fault : str
        Why the contactor cannot be followed; empty if it can.
    """

    contactor: int
    channel: int
    capacitance_nf: float
    loss: float
    resonance_hz: float
    stiffness: float
    d31: float
    mechanical_loss: float
    skew_us: float
    noise_ua: float
    fault: str = ""


@dataclass
class CalibrationReport:
    """Result of a calibration; names of attributes carry their units.

    Attributes
    ----------
    display, device : str
        Name of the display and URL of the device.
    seconds : float
        Duration of the drive [s].
    voltage_v : float
        Largest magnitude of the drive [V].
    range_ma : float
        Current at the end of the converter's range [mA].
    design_capacitance_nf, design_resonance_hz : float
        Capacitance [nF] and resonance in air [Hz] of the design.
    contactors : list of CalibratedContactor
        Contactors in the order of the display.
    faults : list of str
        What is wrong, one line each.
    written : str or None
        File that was written; None if there are faults.
    """

    display: str
    device: str
    seconds: float = 0.0
    voltage_v: float = 0.0
    range_ma: float = 0.0
    design_capacitance_nf: float = 0.0
    design_resonance_hz: float = 0.0
    contactors: list[CalibratedContactor] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    written: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data.

        Returns
        -------
        dict of str to Any
            Values that can be written as JSON, by the names of the attributes.
        """
        return asdict(self)


def calibrate(
    url: str,
    source: str | Path,
    *,
    write: Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
    accept_unsafe_hold: bool = False,
) -> tuple[CalibrationReport, Calibration]:
    """Measure what the contactors of a display draw in air.

    Parameters
    ----------
    url : str
        URL of the device.
    source : str or Path
        Name or file of the display.
    write : Path, optional
        File to write, ending in ``.npz``.
    force : bool
        Whether to overwrite that file.
    progress : callable, optional
        Function that is called with the time that has been played and the whole time.
    accept_unsafe_hold : bool
        As in `open_bus`.

    Returns
    -------
    report : CalibrationReport
        Findings, with all faults.
    calibration : Calibration
        Calibration, which may have faults.

    Raises
    ------
    TactileError
        If the device measures no currents, or device or file cannot be used.
    """
    if write is not None:
        check_calibration_file(write, force=force)  # before anything is measured
    with measuring_device(url, source, accept_unsafe_hold=accept_unsafe_hold) as device:
        display, bender, rate, limits = device.display, device.bender, device.rate, device.limits()
        plan = plan_calibration(bender, rate, limits, window=round(WINDOW_MS * 1e-3 * rate))
        windows = device.play(plan.drive, progress)
    admittances = measure_admittances(plan, _air_windows(windows), plan.drive)
    baseline = fit_baseline(
        admittances.frequency, admittances.value, bender,
        deviation=admittances.deviation, clipped=admittances.clipped,
    )  # fmt: skip
    date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    calibration = Calibration(display.name, date, rate, limits.current, admittances, baseline)
    report = _report(calibration, display, url, plan)
    if write is not None and not report.faults:
        save_calibration(write, calibration, force=force)
        report.written = str(write)
    return report, calibration


def _air_windows(windows: list[PlayedWindow]) -> AirWindows:
    """Return windows as the estimate of the admittances takes them."""
    return AirWindows(
        np.array([window.position for window in windows]),
        np.stack([window.window.sums for window in windows]),
        np.stack([window.window.resolution / 2 for window in windows]),
        np.stack([window.window.valid for window in windows]),
        np.stack([window.clipped for window in windows]),
    )


def _report(
    calibration: Calibration, display: Display, url: str, plan: CalibrationPlan
) -> CalibrationReport:
    """Return the report on a calibration."""
    baseline = calibration.baseline
    report = CalibrationReport(
        display.name, url, plan.seconds, float(np.abs(plan.drive).max()),
        calibration.current_range * 1e3,
        baseline.bender.capacitance * 1e9, baseline.bender.resonance,
    )  # fmt: skip
    dielectric = baseline.capacitance[:, -1]
    for k, fault in enumerate(baseline.faults):
        farads = complex(dielectric[k])
        report.contactors.append(
            CalibratedContactor(
                k, int(display.channel[k]), farads.real * 1e9,
                -farads.imag / farads.real if farads.real else 0.0,
                float(baseline.resonance[k]), float(baseline.deviations.stiffness[k]),
                float(baseline.deviations.coupling[k]), float(baseline.deviations.loss[k]),
                float(baseline.skew[k]) * 1e6, float(calibration.measured.noise[k]) * 1e6, fault,
            )
        )  # fmt: skip
        if fault:
            report.faults.append(f"contactor {k}, channel {int(display.channel[k])}: {fault}")
    return report
