"""Figures of a design: what a bimorph gives under a finger."""

import numpy as np

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import blocked_force, tip_response

BAND = (10.0, 1000.0)
"""Hz in which shear is to be flat."""


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
        By load: static and smallest displacement per volt to 1 kHz [µm/V], the frequency of the
        largest below 5 kHz [Hz], the shaping in dB that a flat response from 10 Hz to 1 kHz needs,
        the shear [µm] that full drive attains everywhere to 1 kHz, blocked force [mN/V].
    """
    frequency = np.arange(1.0, 5001.0)
    band = (frequency >= BAND[0]) & (frequency <= BAND[1])
    force = float(np.abs(blocked_force(bimorph, [0.0])[0])[0])
    figures = {}
    for name, load in loads.items():
        size = np.abs(tip_response(bimorph, load, np.append(frequency, 0.0)).displacement)
        static, size = float(size[-1]), size[:-1]
        low, high = float(size[band].min()), float(size[band].max())
        figures[name] = {
            "static_um_per_v": static * 1e6,
            "smallest_um_per_v": low * 1e6,
            "peak_hz": float(frequency[size.argmax()]),
            "shaping_db": 20 * float(np.log10(high / low)),
            "attainable_um": low * voltage * 1e6,
            "blocked_force_mn_per_v": force * 1e3,
        }
    return figures
