"""Figures of merit of a bimorph under a finger."""

import numpy as np

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.study.criteria import Conditions, Solved, numbers_of
from tactile.study.parameters import Specimen

BAND = (10.0, 1000.0)
"""Band in which the shear is to be flat [Hz]."""
CRITERION_NAMES = {
    "smallest_um_per_v": "smallest_displacement",
    "shaping_db": "shaping",
    "attainable_um": "attainable",
    "blocked_force_mn_per_v": "blocked_force",
}
"""Criteria by the names that the figures have here."""


def response_figures(
    bimorph: Bimorph, loads: dict[str, FingerLoad], voltage: float
) -> dict[str, dict[str, float]]:
    """Compute the figures of merit of one design under several fingers.

    Parameters
    ----------
    bimorph : Bimorph
        One design.
    loads : dict of str to FingerLoad
        Finger loads by name.
    voltage : float
        Limit of the drive [V].

    Returns
    -------
    dict of str to dict of str to float
        Figures by load and name: the static displacement per volt [µm/V], the frequency of the
        largest displacement below 5 kHz [Hz], and for 10 Hz to 1 kHz, as `tactile.study.criteria`
        defines them, the smallest displacement per volt [µm/V], the shaping that a flat response
        needs [dB], and the shear that is attainable everywhere at the limits of drive and field
        [µm]; also the static blocked force [mN/V].
    """
    frequency = np.arange(0.0, 5001.0)
    band = frequency[(frequency >= BAND[0]) & (frequency <= BAND[1])]
    conditions = Conditions(band=BAND, voltage=voltage)
    figures = {}
    for name, load in loads.items():
        size = np.abs(tip_response(bimorph, load, frequency).displacement)
        solved = Solved(
            Specimen(bimorph=bimorph, load=load), tip_response(bimorph, load, band), conditions
        )
        values = numbers_of(CRITERION_NAMES.values(), solved)
        figures[name] = {
            "static_um_per_v": float(size[0]) * 1e6,
            "peak_hz": float(frequency[size.argmax()]),
            **{name: float(values[criterion]) for name, criterion in CRITERION_NAMES.items()},
        }
    return figures
