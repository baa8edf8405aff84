"""Files of calibrations: what the channels of one display draw in air, as arrays in an ``.npz``.

Names of arrays end in their units. No array holds Python objects, so that a file of another person
runs no code.
"""

import struct
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats
from tactile.errors import InputError, NotFoundError
from tactile.files import check_target, write_whole
from tactile.sensing.admittance import Admittances
from tactile.sensing.baseline import ORDER, Baseline
from tactile.sensing.bender import Bender, Deviations
from tactile.sensing.hysteresis import PlayModel

FORMAT = 2
"""Version of the format."""
LARGEST_FILE = 64 * 1024 * 1024
"""Maximum size of a file and of its content, ten times that of 4096 channels [bytes]."""
AGREEMENT = 1e-6
"""Difference up to which two designs are the same, relative to the largest value."""
DAMAGE = (
    OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, MemoryError,
    SyntaxError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""Exceptions of numpy and zipfile for a file that is damaged or is no ``.npz``."""
COLUMNS = {
    "format": ("i", ""),
    "display": ("U", ""),
    "date": ("U", ""),
    "sample_rate_hz": ("f", ""),
    "current_range_a": ("f", ""),
    "design_frequency_hz": ("f", "K"),
    "design_force_n_v": ("c", "K"),
    "design_stiffness_n_m": ("c", "K"),
    "design_amplifier_v_v": ("c", "K"),
    "design_capacitance_f": ("f", ""),
    "stiffness_factor": ("f", "N"),
    "coupling_factor": ("f", "N"),
    "loss_factor": ("f", "N"),
    "skew_s": ("f", "N"),
    "capacitance_f": ("c", "NP"),
    "resonance_hz": ("f", "N"),
    "residual": ("f", "N"),
    "faults": ("U", "N"),
    "hysteresis_radius_v": ("f", "NR"),
    "hysteresis_weight": ("f", "NR"),
    "lines_hz": ("f", "F"),
    "admittance_s": ("c", "NF"),
    "deviation_s": ("f", "NF"),
    "noise_a": ("f", "N"),
    "clipped": ("b", "NF"),
}
"""Kind of each array of a file and its dimensions: N channels, K frequencies of the design, F
lines, P coefficients and R play operators."""
UNMEASURED = frozenset({"admittance_s", "deviation_s", "noise_a", "residual"})
"""Arrays that may hold NaN or infinity, for channels that could not be measured."""


@dataclass(frozen=True)
class Calibration:
    """Calibration in air of the channels of a display.

    Attributes
    ----------
    display : str
        Name of the display.
    date : str
        Date and time, as in ISO 8601.
    sample_rate : float
        Sample rate at which it was measured [Hz].
    current_range : float
        Current at the end of the converter's range [A].
    measured : Admittances
        What was measured.
    baseline : Baseline
        What was fitted to it.
    """

    display: str
    date: str
    sample_rate: float
    current_range: float
    measured: Admittances
    baseline: Baseline

    def check_display(self, bender: Bender, channels: int, sample_rate: float) -> None:
        """Check that the calibration is of a display.

        Parameters
        ----------
        bender : Bender
            Design of the display's benders.
        channels : int
            Number of its channels.
        sample_rate : float
            Sample rate at which it plays [Hz].

        Raises
        ------
        InputError
            If it is of another one.
        """
        own, of = self.baseline.bender, f"calibration of {self.display}, {self.date}"
        if len(self.baseline.faults) != channels:
            raise InputError(
                f"{of}: of {len(self.baseline.faults)} channels, the display has {channels}"
            )
        if self.sample_rate != sample_rate:
            raise InputError(
                f"{of}: at {self.sample_rate:g} Hz, the display plays at {sample_rate:g} Hz"
            )
        pairs = {
            "force": (own.force, bender.force),
            "stiffness": (own.stiffness, bender.stiffness),
            "amplifier": (own.amplifier, bender.amplifier),
        }
        for name, (ours, theirs) in pairs.items():
            if not _same(ours, theirs):
                raise InputError(
                    f"{of}: for benders or an amplifier of another {name} than the display's; "
                    "calibrate again"
                )

    def check_faults(self) -> None:
        """Check that the calibration has no faults.

        Raises
        ------
        InputError
            If a contactor has one; the first is named.
        """
        faults = [f"contactor {k}: {f}" for k, f in enumerate(self.baseline.faults) if f]
        if faults:
            raise InputError(f"calibration of {self.display}, {self.date}: has faults: {faults[0]}")


def _same(ours: Complex, theirs: Complex) -> bool:
    """Return whether two arrays agree."""
    if ours.shape != theirs.shape:
        return False
    return bool(np.abs(ours - theirs).max() <= AGREEMENT * np.abs(theirs).max())


def check_calibration_file(path: Path, *, force: bool = False) -> None:
    """Check that a calibration can be written to a file.

    Parameters
    ----------
    path : Path
        File to be written.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If the file does not end in ``.npz``, its folder does not exist, or it exists already.
    """
    if path.suffix != ".npz":
        raise InputError(f"{path}: a calibration is a file that ends in .npz")
    check_target(path, force=force)


def save_calibration(path: Path, calibration: Calibration, *, force: bool = False) -> None:
    """Write a calibration, completely or not at all.

    Parameters
    ----------
    path : Path
        File ending in ``.npz``.
    calibration : Calibration
        Calibration.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        As `check_calibration_file`.
    """
    check_calibration_file(path, force=force)
    content = BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, column in _columns(calibration).items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, column, allow_pickle=False)
    write_whole(path, content.getvalue(), force=force)


def _columns(calibration: Calibration) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of a file."""
    b, m = calibration.baseline, calibration.measured
    values = (
        FORMAT, calibration.display, calibration.date, calibration.sample_rate,
        calibration.current_range, b.bender.frequency, b.bender.force, b.bender.stiffness,
        b.bender.amplifier, b.bender.capacitance, b.deviations.stiffness, b.deviations.coupling,
        b.deviations.loss, b.skew, b.capacitance, b.resonance, b.residual, list(b.faults),
        b.hysteresis.radii, b.hysteresis.weights,
        m.frequency, m.value, m.deviation, m.noise, m.clipped,
    )  # fmt: skip
    return {name: np.asarray(value) for name, value in zip(COLUMNS, values, strict=True)}


def load_calibration(path: Path) -> Calibration:
    """Read a calibration.

    Parameters
    ----------
    path : Path
        File of `save_calibration`.

    Returns
    -------
    Calibration
        Calibration.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is not a calibration; the message names what is wrong with it.
    """
    try:
        columns = _read(path)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise NotFoundError(f"{path}: no such file") from error
    except DAMAGE as error:
        what = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: is not a calibration, or is damaged: {what}") from error
    _check(path, columns)
    return _calibration(columns)


def _read(path: Path) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of a file."""
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > LARGEST_FILE:
        raise InputError(
            f"{path}: holds {size / 1024**2:.0f} MiB, above {LARGEST_FILE // 1024**2} MiB"
        )
    with np.load(path, allow_pickle=False) as file:
        missing = [name for name in COLUMNS if name not in file.files]
        version = np.asarray(file["format"]) if "format" in file.files else np.zeros(0)
        if version.dtype.kind == "i" and version.ndim == 0 and version != FORMAT:
            raise InputError(
                f"{path}: format {version}, this version reads {FORMAT}: calibrate again"
            )
        if missing:
            raise InputError(f"{path}: is not a calibration: it has no {missing[0]}")
        return {name: file[name] for name in COLUMNS}


def _check(path: Path, columns: dict[str, NDArray[np.generic]]) -> None:
    """Raise InputError for an array of another kind or shape, or that is not finite."""
    sizes = {"P": ORDER + 1}
    for name, (kind, dimensions) in COLUMNS.items():
        column = columns[name]
        if column.dtype.kind != kind or column.ndim != len(dimensions):
            raise InputError(
                f"{path}: {name}: {column.dtype} of {column.ndim} dimensions, not {kind!r} of "
                f"{len(dimensions)}"
            )
        for dimension, size in zip(dimensions, column.shape, strict=True):
            if size == 0 or sizes.setdefault(dimension, size) != size:
                raise InputError(
                    f"{path}: {name}: shape {column.shape}, where {dimension} = "
                    f"{sizes.get(dimension, 0)}"
                )
        if kind in "fc" and name not in UNMEASURED and not np.isfinite(column).all():
            raise InputError(f"{path}: {name}: holds NaN or infinity")
    for name in ("design_frequency_hz", "lines_hz"):
        if not (np.diff(_floats(columns[name])) > 0).all():
            raise InputError(f"{path}: {name}: must ascend")
    for name in ("sample_rate_hz", "current_range_a", "stiffness_factor", "hysteresis_radius_v"):
        if not (_floats(columns[name]) > 0).all():
            raise InputError(f"{path}: {name}: must be above 0")
    if not (_floats(columns["hysteresis_weight"]) >= 0).all():
        raise InputError(f"{path}: hysteresis_weight: must not be below 0")


def _floats(column: NDArray[np.generic]) -> Floats:
    """Return a column in double precision."""
    return np.asarray(column, np.float64)


def _complex(column: NDArray[np.generic]) -> Complex:
    """Return a complex column in double precision."""
    return np.asarray(column, np.complex128)


def _calibration(columns: dict[str, NDArray[np.generic]]) -> Calibration:
    """Return the calibration that columns of a file are of."""
    f = {name: _floats(columns[name]) for name, (kind, _) in COLUMNS.items() if kind == "f"}
    c = {name: _complex(columns[name]) for name, (kind, _) in COLUMNS.items() if kind == "c"}
    bender = Bender(
        f["design_frequency_hz"], c["design_force_n_v"], c["design_stiffness_n_m"],
        c["design_amplifier_v_v"], float(f["design_capacitance_f"]),
    )  # fmt: skip
    deviations = Deviations(f["stiffness_factor"], f["coupling_factor"], f["loss_factor"])
    baseline = Baseline(
        bender, deviations, f["skew_s"], c["capacitance_f"], f["resonance_hz"], f["residual"],
        tuple(map(str, columns["faults"])),
        PlayModel(f["hysteresis_radius_v"], f["hysteresis_weight"]),
    )  # fmt: skip
    measured = Admittances(
        f["lines_hz"], c["admittance_s"], f["deviation_s"], f["noise_a"],
        np.asarray(columns["clipped"], np.bool_),
    )  # fmt: skip
    return Calibration(
        str(columns["display"]), str(columns["date"]), float(f["sample_rate_hz"]),
        float(f["current_range_a"]), measured, baseline,
    )  # fmt: skip
