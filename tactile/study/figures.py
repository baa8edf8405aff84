"""Figures of a design: what a bimorph gives under a finger."""

import numpy as np

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.study.criteria import Conditions, Solved, numbers_of
from tactile.study.parameters import Specimen

BAND = (10.0, 1000.0)
"""Hz in which shear is to be flat."""
TOLD = {
    "smallest_um_per_v": "smallest_displacement",
    "shaping_db": "shaping",
    "attainable_um": "attainable",
    "blocked_force_mn_per_v": "blocked_force",
}
"""Criteria by what they are called here."""


def response_figures(
    bimorph: Bimorph, loads: dict[str, FingerLoad], voltage: float
) -> dict[str, dict[str, float]]:
    """Return the figures of one design under several fingers.

    Parameters
    ----------
    bimorph : one design
    loads : by name
    voltage : the drive's limit [V]

    Returns
    -------
    dict of dict
        By load: static displacement per volt [µm/V], the frequency of the largest below 5 kHz [Hz],
        and from 10 Hz to 1 kHz what `tactile.study.criteria` says: the smallest displacement per
        volt [µm/V], the shaping [dB] that a flat response needs, the shear [µm] that is attainable
        everywhere at the limits of drive and field; and the blocked force [mN/V].
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
        found = numbers_of(TOLD.values(), solved)
        figures[name] = {
            "static_um_per_v": float(size[0]) * 1e6,
            "peak_hz": float(frequency[size.argmax()]),
            **{name: float(found[criterion]) for name, criterion in TOLD.items()},
        }
    return figures
