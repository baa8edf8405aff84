"""A measurement of a bimorph: a complex response over frequency, read from a CSV file.

The columns are those of a display's measured responses, frequency_hz, magnitude, phase_deg, unit;
the unit says what was measured. Unlike there, any band will do. A volt is one at the bimorph's
electrodes, and phase is that of exp(+jωt): what comes late has a negative one.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tactile.display.display import COLUMNS
from tactile.errors import InputError
from tactile.files import Row, nearest, numbers, read_columns

Floats: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Kind: TypeAlias = Literal["displacement", "velocity", "force", "admittance"]

UNITS: dict[str, tuple[Kind, float]] = {
    "m/V": ("displacement", 1.0),
    "mm/V": ("displacement", 1e-3),
    "um/V": ("displacement", 1e-6),
    "nm/V": ("displacement", 1e-9),
    "m/s/V": ("velocity", 1.0),
    "mm/s/V": ("velocity", 1e-3),
    "um/s/V": ("velocity", 1e-6),
    "N/V": ("force", 1.0),
    "mN/V": ("force", 1e-3),
    "uN/V": ("force", 1e-6),
    "S": ("admittance", 1.0),
    "mS": ("admittance", 1e-3),
    "uS": ("admittance", 1e-6),
    "nS": ("admittance", 1e-9),
}
"""What a unit measures, and its size in SI; µ may be written for u."""


@dataclass(frozen=True)
class Measurement:
    """A response that was measured.

    Attributes
    ----------
    name : of the file
    kind : "displacement" [m/V], "velocity" [m/(s V)] or "force" into the skin [N/V], each of the
        tip along the skin, or the electrical "admittance" [S]
    frequency : (F,) ascending, above zero [Hz]
    value : (F,) complex, nowhere zero [SI]
    """

    name: str
    kind: Kind
    frequency: Floats
    value: Complex


def load_measurement(path: str | Path, *kinds: Kind) -> Measurement:
    """Read a measurement: a CSV of frequency_hz, magnitude, phase_deg, unit.

    Parameters
    ----------
    path : of the file
    kinds : that will do; any, where none are named

    Raises
    ------
    NotFoundError, InputError
        One line: file, line, value and what is allowed.
    """
    path = Path(path)
    rows = read_columns(path, COLUMNS)
    if not rows:
        raise InputError(f"{path}: has a header and no measured points")
    table = numbers(path, COLUMNS[:3], rows)
    units = [_unit(path, row) for row in rows]
    kind = units[0][0]
    for row, (other, _) in zip(rows, units, strict=True):
        if other != kind:
            raise InputError(
                f"{path}: line {row.line}: unit = {row.cells[3]!r}: is {other}, "
                f"the first line's is {kind}; one file holds one of them"
            )
    if kinds and kind not in kinds:
        known = ", ".join(unit for unit, (k, _) in UNITS.items() if k in kinds)
        raise InputError(f"{path}: unit = {rows[0].cells[3]!r}: is {kind}, must be one of {known}")
    _check_points(path, rows, table)
    size = table[:, 1] * [scale for _, scale in units]
    value = size * np.exp(1j * np.radians(table[:, 2]))
    return Measurement(path.name, kind, table[:, 0], np.asarray(value, np.complex128))


def _unit(path: Path, row: Row) -> tuple[Kind, float]:
    told = row.cells[3] or ""
    plain = told.strip().replace("\u00b5", "u").replace("\u03bc", "u")
    if plain not in UNITS:
        raise InputError(
            f"{path}: line {row.line}: unit = {told!r}: unknown; {nearest(plain, list(UNITS))}"
        )
    return UNITS[plain]


def _check_points(path: Path, rows: list[Row], table: Floats) -> None:
    """Refuse what is no response: frequencies that do not ascend, magnitudes of zero."""
    before = 0.0
    for row, (frequency, magnitude, _) in zip(rows, table.tolist(), strict=True):
        if frequency <= before:
            raise InputError(
                f"{path}: line {row.line}: frequency_hz = {frequency:g}: must be above {before:g}, "
                "frequencies ascend from above 0"
            )
        if magnitude <= 0:
            raise InputError(
                f"{path}: line {row.line}: magnitude = {magnitude:g}: must be above 0; "
                "a sign belongs into phase_deg, as 180"
            )
        before = frequency
