"""Calibration of a display in air: each bender's current while a few tones play at a time.

Nothing may touch the display meanwhile. At first the drive is at most 20 V. If no contactor has a
fault, a slow tone up to the display's limit measures the hysteresis, which is then taken into
account in what was measured before. A calibration is written only if no contactor has a fault.
"""

import datetime
import math
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactile.bringup.current_measuring import Progress, measuring_device
from tactile.display.display import Display
from tactile.playback.finger_following import WINDOW_MS
from tactile.playback.sum_windows import PlayedWindow
from tactile.sensing.admittance import Admittances, AirWindows, measure_admittances
from tactile.sensing.baseline import Baseline, fit_baseline
from tactile.sensing.baseline_file import (
    Calibration,
    check_calibration_file,
    save_calibration,
)
from tactile.sensing.bender import Bender
from tactile.sensing.calibration import CalibrationPlan, plan_calibration
from tactile.sensing.hysteresis import PlayModel
from tactile.sensing.loop_tones import fit_hysteresis, loop_faults, plan_loops


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
    hysteresis_percent : float
        Largest distance between the branches of the loop at the largest drive, as a part of its
        swing [%].
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
    hysteresis_percent: float
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
    reach = partial(measuring_device, url, source, accept_unsafe_hold=accept_unsafe_hold)
    with reach() as device:
        display, rate, limits = device.display, device.rate, device.limits()
        plan = plan_calibration(device.bender, rate, limits, window=round(WINDOW_MS * 1e-3 * rate))
        windows = _air_windows(device.play(plan.drive, progress))
    none = PlayModel.none(len(display.contactors))
    measured, baseline = _fitted(plan, windows, device.bender, none)
    seconds, volts = plan.seconds, float(np.abs(plan.drive).max())
    if not any(baseline.faults):
        with reach(voltage=math.inf) as device:
            loops = plan_loops(device.bender.capacitance, rate, device.limits(), window=plan.window)
            at_levels = _air_windows(device.play(loops.drive, progress))
        measured, baseline = _fitted(plan, windows, device.bender, fit_hysteresis(loops, at_levels))
        unknown = zip(loop_faults(loops, at_levels), baseline.faults, strict=True)
        baseline = replace(baseline, faults=tuple(first or then for first, then in unknown))
        seconds, volts = seconds + len(loops.drive) / rate, float(loops.levels[-1])
    date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    calibration = Calibration(display.name, date, rate, limits.current, measured, baseline)
    report = _report(calibration, display, url, volts)
    report.seconds = seconds
    if write is not None and not report.faults:
        save_calibration(write, calibration, force=force)
        report.written = str(write)
    return report, calibration


def _fitted(
    plan: CalibrationPlan, windows: AirWindows, bender: Bender, hysteresis: PlayModel
) -> tuple[Admittances, Baseline]:
    """Return what windows tell of contactors that have a hysteresis."""
    measured = measure_admittances(plan, windows, plan.drive, hysteresis)
    return measured, fit_baseline(
        measured.frequency, measured.value, bender,
        deviation=measured.deviation, clipped=measured.clipped, hysteresis=hysteresis,
    )  # fmt: skip


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
    calibration: Calibration, display: Display, url: str, voltage: float
) -> CalibrationReport:
    """Return the report on a calibration."""
    baseline = calibration.baseline
    report = CalibrationReport(
        display.name, url, voltage_v=voltage, range_ma=calibration.current_range * 1e3,
        design_capacitance_nf=baseline.bender.capacitance * 1e9,
        design_resonance_hz=baseline.bender.resonance,
    )  # fmt: skip
    width = baseline.hysteresis.loop_width(voltage)
    dielectric = baseline.capacitance[:, -1]
    for k, fault in enumerate(baseline.faults):
        farads = complex(dielectric[k])
        report.contactors.append(
            CalibratedContactor(
                k, int(display.channel[k]), farads.real * 1e9,
                -farads.imag / farads.real if farads.real else 0.0,
                float(baseline.resonance[k]), float(baseline.deviations.stiffness[k]),
                float(baseline.deviations.coupling[k]), float(baseline.deviations.loss[k]),
                100 * float(width[k]), float(baseline.skew[k]) * 1e6,
                float(calibration.measured.noise[k]) * 1e6, fault,
            )
        )  # fmt: skip
        if fault:
            report.faults.append(f"contactor {k}, channel {int(display.channel[k])}: {fault}")
    return report
