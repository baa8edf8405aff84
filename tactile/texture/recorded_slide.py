"""Reading and checking of one recorded slide of a finger or sensor over a surface.

A recording holds what a sensor measured while something slid: acceleration, velocity, displacement
or tangential force, with the speed of the slide. A WAV file holds the signal alone, so that speed
and scale are given as options. The columns of a CSV file, or the arrays of an NPZ file, are
identified by their names:

    time_s, acceleration_m_s2 | velocity_mm_s | displacement_um | force_n,
    and where known speed_mm_s, normal_force_n, tangential_force_n

An NPZ file has ``sample_rate_hz`` in place of the time. Whatever cannot be fitted is rejected here:
silence, clipping, a sample rate that is too low, values that are not numbers, a truncated file.
"""

import io
import math
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.io import wavfile

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError
from tactile.texture.formats import reading

Quantity = Literal["acceleration", "velocity", "displacement", "force"]
"""Quantity that a sensor records."""

COLUMNS: dict[str, tuple[Quantity, float]] = {
    "acceleration_m_s2": ("acceleration", 1.0),
    "velocity_mm_s": ("velocity", 1e-3),
    "displacement_um": ("displacement", 1e-6),
    "force_n": ("force", 1.0),
}
"""Quantity, and SI value of the unit, for each name that the signal of a file may have."""
UNITS: dict[Quantity, tuple[str, float]] = {
    quantity: (name.partition("_")[2], scale) for name, (quantity, scale) in COLUMNS.items()
}
"""Name of the unit, and its SI value, for each quantity."""
SIDES = {"speed_mm_s": 1e-3, "normal_force_n": 1.0, "tangential_force_n": 1.0}
"""SI value of the unit for each quantity that may be recorded beside the signal."""
LOWEST_RATE = 2000.0
"""Lowest sample rate [Hz]."""
LONGEST = 1 << 26
"""Largest number of samples of one file: 1.8 hours at 10 kHz."""
LARGEST_WAV = 8 * LONGEST
"""Largest size of a WAV file, with that many samples in double precision [bytes]."""
MOST_CLIPPED = 1e-3
"""Largest share of clipped samples."""
QUIETEST = 3.0
"""Smallest standard deviation of a signal, in steps of the converter, taken as the smallest steps
that occur."""
JITTER = 0.02
"""Largest deviation of a sampling interval in a CSV file, relative to the median interval."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A recorded slide.

    Attributes
    ----------
    name : str
        Name of the file.
    signal : (S,) array of float
        Signal in the SI unit of its quantity, or in an unknown unit.
    quantity : str
        Recorded quantity: "acceleration", "velocity", "displacement" or "force".
    sample_rate : float
        Sample rate [Hz].
    speed : (S,) array of float
        Speed along the surface [m/s].
    normal_force : (S,) array of float or None
        Normal force, if known [N].
    tangential_force : (S,) array of float or None
        Tangential force, if known [N].
    calibrated : bool
        Whether the unit of the signal is known.
    """

    name: str
    signal: Floats
    quantity: Quantity
    sample_rate: float
    speed: Floats
    normal_force: Floats | None = None
    tangential_force: Floats | None = None
    calibrated: bool = True

    @property
    def duration(self) -> float:
        """Duration of the recording [s]."""
        return len(self.signal) / self.sample_rate


def load_recorded(
    path: str | Path,
    *,
    quantity: Quantity = "acceleration",
    full_scale: float | None = None,
    speed: float | None = None,
    normal_force: float | None = None,
) -> Recorded:
    """Read and check a recording.

    Parameters
    ----------
    path : str or Path
        A mono ``.wav``, a ``.csv`` or an ``.npz`` file.
    quantity : str
        Quantity of a WAV file: "acceleration", "velocity", "displacement" or "force". The other
        files state it.
    full_scale : float or None
        Value that the full scale of a WAV file stands for, in the SI unit of its quantity. Without
        it the recording counts as uncalibrated.
    speed : float or None
        Speed, for files that do not state it [m/s].
    normal_force : float or None
        Normal force, for files that do not state it [N].

    Returns
    -------
    Recorded
        Signal with speed and forces.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file cannot be read or fitted. The message is one line with the file, what is wrong
        with it, and what would help.
    """
    path = Path(path)
    if not files.is_file(path):
        raise NotFoundError(f"{path}: no such file")
    if quantity not in get_args(Quantity):
        raise InputError(f"quantity {quantity!r}; {files.nearest(quantity, list(UNITS))}")
    readers = {".wav": _wav, ".csv": _csv, ".npz": _npz}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path}: is not a recording; must be a .wav, .csv or .npz file")
    columns, rate = readers[path.suffix.lower()](path, quantity)
    name, column = next((n, c) for n, c in COLUMNS.items() if n in columns)
    signal = columns[name] * column[1]
    is_wav = path.suffix.lower() == ".wav"
    _check(path, signal, rate)
    scale = (full_scale if full_scale is not None else 1.0) / column[1] if is_wav else 1.0
    sides = {side: columns[side] * unit for side, unit in SIDES.items() if side in columns}
    return Recorded(
        name=path.name,
        signal=signal * scale,
        quantity=column[0],
        sample_rate=rate,
        speed=_side(path, "speed_mm_s", sides, speed, signal),
        normal_force=_side(path, "normal_force_n", sides, normal_force, signal, needed=False),
        tangential_force=sides.get("tangential_force_n"),
        calibrated=not is_wav or full_scale is not None,
    )


def _side(
    path: Path,
    name: str,
    sides: dict[str, Floats],
    option_value: float | None,
    signal: Floats,
    needed: bool = True,
) -> Floats:
    """Return a quantity beside the signal for each sample, from the file or from the option."""
    if name in sides:
        return sides[name]
    option = f"--{name.replace('_', '-')}"
    if option_value is None:
        if needed:
            raise InputError(f"{path}: speed is missing; give {option}, or a column {name}")
        return None  # type: ignore[return-value]
    if not (math.isfinite(option_value) and option_value > 0):
        raise InputError(f"{path}: {option} {option_value:g}: must be above 0")
    return np.full(len(signal), option_value)


def _wav(path: Path, quantity: Quantity) -> tuple[dict[str, Floats], float]:
    """Read a WAV file, full scale 1, and return its column and sample rate [Hz]."""
    raw = reading.contents(path, LARGEST_WAV)  # the size is limited whatever its header claims
    with warnings.catch_warnings(record=True) as warnings_raised:
        warnings.simplefilter("always", wavfile.WavFileWarning)
        try:
            rate, data = wavfile.read(io.BytesIO(raw))
        except Exception as error:  # scipy raises many types, struct.error among them
            raise InputError(f"{path}: not a readable WAV file: {_line(error)}") from error
    if any("EOF" in str(warning.message) for warning in warnings_raised):
        raise InputError(f"{path}: is truncated; copy it again")
    if data.ndim != 1:
        raise InputError(f"{path}: has {data.shape[1]} channels; must have one")
    zero = 128 if data.dtype == np.uint8 else 0
    full = -float(np.iinfo(data.dtype).min) if data.dtype.kind == "i" else 1.0
    full = 128.0 if data.dtype == np.uint8 else full
    name = next(n for n, (known, _) in COLUMNS.items() if known == quantity)
    return {name: (data.astype(np.float64) - zero) / full}, float(rate)


def _csv(path: Path, quantity: Quantity) -> tuple[dict[str, Floats], float]:
    """Read a CSV file and return its columns, without the time, and the sample rate [Hz]."""
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
        header = [cell.strip() for cell in lines.readline(4096).split(",")]
    signal = _signal_of(path, header)
    names = ("time_s", signal, *(side for side in SIDES if side in header))
    table = files.numbers(path, names, files.read_columns(path, names))
    if len(table) < 2:
        raise InputError(f"{path}: has {len(table)} rows; must have at least 2")
    step = np.diff(table[:, 0])
    median_step = float(np.median(step))
    worst = int(np.argmax(np.abs(step - median_step)))
    if median_step <= 0 or abs(step[worst] - median_step) > JITTER * median_step + 1e-6:
        raise InputError(
            f"{path}: line {worst + 3}: time_s increases by {step[worst]:g} s, elsewhere by "
            f"{median_step:g} s; must be even"
        )
    rate = (len(table) - 1) / float(table[-1, 0] - table[0, 0])
    return {name: table[:, i] for i, name in enumerate(names) if i}, rate


def _npz(path: Path, quantity: Quantity) -> tuple[dict[str, Floats], float]:
    """Read an NPZ file and return its arrays, each (S,), and the sample rate [Hz]."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            name = _signal_of(path, archive.files)
            if "sample_rate_hz" not in archive.files:
                raise InputError(f"{path}: no array 'sample_rate_hz'")
            arrays = {n: np.asarray(archive[n]) for n in (name, *SIDES) if n in archive.files}
            rate = float(archive["sample_rate_hz"])
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a readable NPZ file: {_line(error)}") from error
    for n, array in arrays.items():
        if array.dtype.kind not in "iuf" or array.ndim > 1 or (n == name and array.ndim != 1):
            raise InputError(f"{path}: {n} is {array.dtype} {array.shape}: must be numbers (S,)")
        if array.ndim and array.shape != arrays[name].shape:
            raise InputError(
                f"{path}: {n} has {array.shape[0]} values for {len(arrays[name])} samples"
            )
    count = len(arrays[name])
    columns = {n: np.broadcast_to(a.astype(np.float64), (count,)) for n, a in arrays.items()}
    return columns, rate


def _signal_of(path: Path, names: list[str]) -> str:
    """Return the one name in a list that denotes a signal."""
    signals = [name for name in COLUMNS if name in names]
    if len(signals) != 1:
        problem = "no signal" if not signals else f"{' and '.join(signals)}: which is it"
        raise InputError(f"{path}: {problem}; needs one of {', '.join(COLUMNS)}")
    return signals[0]


def _line(error: BaseException) -> str:
    """Return the message of an error as one line."""
    return " ".join(str(error).split()) or type(error).__name__


def _check(path: Path, signal: Floats, rate: float) -> None:
    """Raise `InputError` if a signal cannot be fitted."""
    if not (math.isfinite(rate) and rate >= LOWEST_RATE):
        raise InputError(
            f"{path}: {rate:g} samples per second: must be at least {LOWEST_RATE:g}, because a "
            "finger feels up to 1 kHz; record faster"
        )
    if len(signal) > LONGEST:
        raise InputError(f"{path}: {len(signal)} samples: at most {LONGEST}; cut it")
    bad = np.flatnonzero(~np.isfinite(signal))
    if len(bad):
        raise InputError(
            f"{path}: sample {bad[0]} ({bad[0] / rate:.3f} s) is {signal[bad[0]]}: must be finite; "
            f"invalid samples: {len(bad)}"
        )
    steps = np.abs(np.diff(signal))
    if np.std(signal) <= QUIETEST * steps[steps > 0].min(initial=np.inf):
        raise InputError(
            f"{path}: is silent; check the sensor's gain, or that the right channel was recorded"
        )
    if share := _clipped(signal):
        raise InputError(
            f"{path}: {share:.2%} of its samples are at {np.abs(signal).max():.3g}, the "
            "largest value: clipped; record with less gain"
        )


def _clipped(signal: Floats) -> float:
    """Return the share of samples in runs of three or more at an extreme, or 0 if there are few."""
    clipped = 0
    for extreme in (signal.max(), signal.min()):
        at = signal == extreme
        runs = at[:-2] & at[1:-1] & at[2:]
        clipped += int(np.count_nonzero(runs))
    share = clipped / len(signal)
    return share if share > MOST_CLIPPED else 0.0
