"""Commercial benders, as far as their manufacturers publish what the model needs.

`BENDERS` holds each bender as mounted according to its data sheet or in the measurement that it is
taken from: its free length, its clamped length and its wiring. tests/validation/test_benders.py
compares printed and measured values with those of the model. For the MTP benders it finds
capacitance and blocked force near the printed values, but a third to a quarter of the printed
displacement, so that a design based on their data sheet alone may promise too much.
"""

from dataclasses import replace

import numpy as np

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import PIEZOS, SHIMS, VACUUM_PERMITTIVITY
from tactile.actuator.resonance import first_resonance
from tactile.actuator.response import blocked_force, tip_response

_MTP_PIEZO = replace(PIEZOS["pzt-5h"], eps33T=3300 * VACUUM_PERMITTIVITY, loss_tangent=0.022)
"""Ceramic of the MTP benders: the sheet prints ε33T 3300 and tanδ 2.2 % for a "PZT5"; all other
constants are those of PZT-5H (assumed)."""


def _mtp(
    width: float, total: float, free: float, piezo_height: float, shim_height: float
) -> Bimorph:
    """Return a bender of the MTP kind, clamped over all but its free length (dimensions in m)."""
    return Bimorph(
        width=width,
        length=free,
        clamped_length=total - free,
        piezo_height=piezo_height,
        shim_height=shim_height,
        piezo=_MTP_PIEZO,
        shim=SHIMS["brass"],
    )


BENDERS = {
    "mtp35x2.1x0.7": _mtp(2.1e-3, 35e-3, 28e-3, 0.25e-3, 0.20e-3),
    "mtp49x2.3x0.8": _mtp(2.3e-3, 49e-3, 38e-3, 0.30e-3, 0.20e-3),
    "mtp60x20x0.7": _mtp(20e-3, 60e-3, 53e-3, 0.25e-3, 0.20e-3),
    "t226-a4-503x": Bimorph(
        width=31.8e-3,
        length=50.8e-3,
        clamped_length=12.7e-3,
        piezo_height=0.26e-3,
        shim_height=0.14e-3,
        piezo=PIEZOS["5a4e"],
        shim=SHIMS["brass"],
        series=True,
    ),
}
"""Benders by name.

mtp…: the data sheet at rphotronics.com/b/product05/1536 prints total size, free length and
material. It does not print the layers: equal piezo layers around 0.2 mm of brass are assumed. The
default design is of the class of the first of these benders.

t226-a4-503x: by Piezo Systems, mounted as in Erturk & Inman, Smart Mater. Struct. 18, 2009, 025009:
brass between 5A4E, wired in series, the 63.5 mm part with 50.8 mm free (quoted at second hand)."""


def bender_figures(bimorph: Bimorph) -> dict[str, float]:
    """Compute the figures that a data sheet gives for a bender in air.

    Parameters
    ----------
    bimorph : Bimorph
        One design (numbers, not arrays).

    Returns
    -------
    dict of str to float
        Static displacement [µm/V] and blocked force per volt [mN/V], tip stiffness [N/m],
        capacitance with the clamped length included [nF], and first resonance [Hz].

    Examples
    --------
    Twice the length makes a quarter of the first resonance. The data sheet of the bender below
    prints at least 140 mN at 200 V.

    >>> import tactile
    >>> [round(tactile.bender_figures(tactile.Bimorph(length=length))["first_resonance_hz"])
    ...  for length in (20e-3, 40e-3)]
    [930, 233]
    >>> figures = tactile.bender_figures(tactile.BENDERS["mtp35x2.1x0.7"])
    >>> round(200 * figures["blocked_force_mn_per_v"])
    168
    """
    r = tip_response(bimorph, FingerLoad.none(), [0.0, 1.0])
    force, stiffness = blocked_force(bimorph, [0.0])
    return {
        "displacement_um_per_v": float(np.abs(r.displacement[0])) * 1e6,
        "blocked_force_mn_per_v": float(np.abs(force[0])) * 1e3,
        "stiffness_n_per_m": float(stiffness[0].real),
        "capacitance_nf": float((r.admittance[1] / (2j * np.pi)).real) * 1e9,
        "first_resonance_hz": float(first_resonance(bimorph)),
    }
