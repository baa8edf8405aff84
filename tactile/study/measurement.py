"""Measurement of a bimorph: a complex response over frequency, read from a CSV file.

The columns are those of a display's measured responses: frequency_hz, magnitude, phase_deg, unit.
The unit says what was measured. In contrast to a display's responses, any band is accepted. A volt
is one at the bimorph's electrodes, and phase is that of exp(+jωt): a delay has a negative phase.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from tactile.arrays import Complex, Floats
from tactile.display.display import COLUMNS
from tactile.errors import InputError
from tactile.files import Row, nearest, numbers, read_columns

Kind: TypeAlias = Literal["displacement", "velocity", "force", "admittance"]
"""Kind of measurement."""

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
"""Kind of measurement and size in SI of each unit; µ may be written instead of u."""


@dataclass(frozen=True)
class Measurement:
    """A measured response.

    Attributes
    ----------
    name : str
        Name of the file.
    kind : str
        "displacement" [m/V], "velocity" [m/(s V)] or "force" into the skin [N/V], each of the tip
        along the skin, or the electrical "admittance" [S].
    frequency : (F,) array of float
        Ascending frequencies, above zero [Hz].
    value : (F,) array of complex
        Response, nowhere zero [SI].
    """

    name: str
    kind: Kind
    frequency: Floats
    value: Complex


def load_measurement(path: str | Path, *kinds: Kind) -> Measurement:
    """Read a measurement from a CSV file with frequency_hz, magnitude, phase_deg and unit.

    Parameters
    ----------
    path : str or Path
        Path of the file.
    *kinds : str
        Accepted kinds of measurement; all if none are given.

    Returns
    -------
    Measurement
        Measured response.

    Raises
    ------
    NotFoundError
        If the file does not exist.
    InputError
        If the file is not a measurement of an accepted kind. The message has one line: file, line,
        value and what is allowed.
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
    """Return kind and size of a row's unit, or raise InputError."""
    text = row.cells[3] or ""
    plain = text.strip().replace("\u00b5", "u").replace("\u03bc", "u")
    if plain not in UNITS:
        raise InputError(
            f"{path}: line {row.line}: unit = {text!r}: unknown; {nearest(plain, list(UNITS))}"
        )
    return UNITS[plain]


def _check_points(path: Path, rows: list[Row], table: Floats) -> None:
    """Raise InputError if frequencies do not ascend or a magnitude is not above zero."""
    last = 0.0
    for row, (frequency, magnitude, _) in zip(rows, table.tolist(), strict=True):
        if frequency <= last:
            raise InputError(
                f"{path}: line {row.line}: frequency_hz = {frequency:g}: must be above {last:g}, "
                "frequencies ascend from above 0"
            )
        if magnitude <= 0:
            raise InputError(
                f"{path}: line {row.line}: magnitude = {magnitude:g}: must be above 0; "
                "a sign belongs into phase_deg, as 180"
            )
        last = frequency
