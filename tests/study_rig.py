"""Small study of several blocks, and its bits, for the tests of runs."""

from typing import TYPE_CHECKING

import numpy as np

from tactile.study.criteria import Conditions
from tactile.study.sweep import Study

if TYPE_CHECKING:
    import xarray as xr

SMALL = 2**9
"""Points of a block: five lengths of `study`."""


def study(lengths: int = 24) -> Study:
    """Return a study of five blocks, or of others for other numbers of lengths."""
    return Study(
        axes={"length_mm": np.linspace(8, 30, lengths), "load": ["low", "high"]},
        frequency=np.linspace(0, 1000, 51),
        criteria=("smallest_displacement", "blocked_force"),
        responses=("displacement",),
        conditions=Conditions(band=(0, 1000)),
    )


def bits(data: "xr.Dataset") -> dict[str, bytes]:
    """Return all values by name, to the last bit."""
    return {str(name): v.values.tobytes() for name, v in data.variables.items()}
