"""Response of the display's bender under a measured finger, as `tactile adjust` reads it.

The response is that of the bender as it is designed and not of a real one with its tolerances,
since `tactile adjust` fits the load of the finger to a design.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Complex
from tactile.display.display import COLUMNS
from tactile.errors import InputError
from tactile.files import check_target, write_whole
from tactile.sensing.bender import Bender, Deviations
from tactile.sensing.population import load_stiffness
from tactile.sensing.resting_load import MeasuredLoads

FREQUENCY = np.geomspace(10.0, 1000.0, 41)
"""Frequencies of a written response [Hz]."""


def typical_stiffness(loads: MeasuredLoads, contactors: NDArray[np.bool_]) -> Complex:
    """Compute the dynamic stiffness of a finger from that on some contactors.

    Parameters
    ----------
    loads : MeasuredLoads
        Loads of N contactors.
    contactors : (N,) array of bool
        Contactors that count, at least one.

    Returns
    -------
    (F,) complex array
        Median of its magnitude and of its phase at each of `FREQUENCY` [N/m].
    """
    logarithm = np.log(load_stiffness(loads.logarithms[contactors], FREQUENCY))
    level, phase = np.median(logarithm.real, axis=0), np.median(logarithm.imag, axis=0)
    return np.asarray(np.exp(level + 1j * phase))


def check_response_file(path: Path, *, force: bool = False) -> None:
    """Check that a response can be written to a file.

    Parameters
    ----------
    path : Path
        File to be written.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        If the file does not end in ``.csv``, its folder does not exist, or it exists already.
    """
    if path.suffix != ".csv":
        raise InputError(f"{path}: a response is a file that ends in .csv")
    check_target(path, force=force)


def save_response(path: Path, bender: Bender, stiffness: Complex, *, force: bool = False) -> None:
    """Write the tip displacement per volt at the electrodes of a design under a load.

    Parameters
    ----------
    path : Path
        File ending in ``.csv``.
    bender : Bender
        The design.
    stiffness : (F,) complex array
        Dynamic stiffness of the load at `FREQUENCY` [N/m].
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    InputError
        As `check_response_file`.
    """
    one = np.ones(1)
    blocked, own = bender.at(FREQUENCY, Deviations(one, one, one))
    response = (blocked / (own + stiffness))[0]
    rows = (
        f"{f:.6g},{abs(h):.6e},{np.degrees(np.angle(h)):.4f},m/V\n"
        for f, h in zip(FREQUENCY, response, strict=True)
    )
    text = ",".join(COLUMNS) + "\n" + "".join(rows)
    write_whole(path, text.encode(), force=force)
