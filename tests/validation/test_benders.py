"""Benders on the market: printed and measured values, compared with the model.

| bender | figure | printed or measured | model |
|---|---|---|---|
| t226-a4-503x, 12 g on its tip | resonance, short circuit | 45.6 Hz | 45.8 Hz |
| | resonance, open circuit | 48.4 Hz | 47.8 Hz (48.3 Hz with layer stiffening) |
| mtp35x2.1x0.7 | nF of a layer | 10 ± 20 % | 8.2 |
| mtp49x2.3x0.8 | | 12 ± 20 % | 10.4 |
| mtp60x20x0.7 | | 120 ± 20 % | 135 |
| mtp35x2.1x0.7 | blocked force, 200 V | ≥ 0.14 N | 0.168 N |
| mtp49x2.3x0.8 | 200 V | ≥ 0.15 N | 0.151 N |
| mtp60x20x0.7 | 150 V | ≥ 0.50 N | 0.635 N |
| mtp35x2.1x0.7 | displacement | ≥ 1.4 mm | 0.33 mm |
| mtp49x2.3x0.8 | | ≥ 1.5 mm | 0.46 mm |
| mtp60x20x0.7 | | ≥ 2.6 mm | 0.89 mm |

The t226 was measured by Erturk & Inman, "An experimentally validated bimorph cantilever model for
piezoelectric energy harvesting from base excitations", Smart Mater. Struct. 18, 2009, 025009
(both frequencies quoted at second hand). The mtp benders are from a maker's sheet,
rphotronics.com/b/product05/1536.

The finding: the sheet's displacements are 2.9 to 4.2 times the model's, while force and
capacitance agree. The sheet's stiffness is its force over its displacement, so it is as much
below the model's. Of a bender of these dimensions no elasticity of PZT and metal makes that
stiffness; what would explain it is a displacement from −U to +U (twice), at fields of
0.6 … 0.8 kV/mm, where d31 of a soft ceramic is 1.5 to 2 times that of small signals (assumed). The
model is of small signals; the tests below hold the finding fast, they do not explain it away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.benders import BENDERS, bender_figures
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response

PRINTED = {
    "mtp35x2.1x0.7": (200.0, 10.0, 1.4, 0.14),
    "mtp49x2.3x0.8": (200.0, 12.0, 1.5, 0.15),
    "mtp60x20x0.7": (150.0, 120.0, 2.6, 0.50),
}
"""Printed values: voltage [V], capacitance of one layer (±20 %) [nF], free deflection (±20 %) [mm],
blocked force [N]."""

each_mtp = pytest.mark.parametrize("name", PRINTED)


@dataclass(frozen=True, kw_only=True)
class TipMass(FingerLoad):
    """A mass on the tip instead of a finger."""

    mass: float

    def stiffness(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        omega = 2 * np.pi * np.asarray(frequency, np.float64)
        return np.asarray(-self.mass * omega**2, np.complex128)


def resonances(bender: Bimorph, mass: float) -> tuple[float, float]:
    """Return the frequencies of most and least charge per volt: short and open circuit [Hz]."""
    frequency = np.arange(40.0, 55.0, 0.02)
    r = tip_response(bender, TipMass(k0=0.0, d0=0.0, mass=mass), frequency)
    charge = np.abs(r.admittance / frequency)
    return float(frequency[charge.argmax()]), float(frequency[charge.argmin()])


@pytest.mark.parametrize("stiffened", [False, True])
def test_a_bender_with_a_mass_resonates_where_it_was_measured(stiffened: bool) -> None:
    """Both agree to 2 %: the last printed digit of the height, 0.01 of 0.66 mm, makes 1.5 %.

    How far apart they are tells the coupling, squared: 6.1 % measured, 4.4 % found. The model
    counts the capacitance of the clamped fifth; without it 5.4 % would be found, and d31 is given
    to ±10 %, of which the distance shows twice as much. Wiring, series here, moves neither.
    """
    bender = replace(BENDERS["t226-a4-503x"], layer_stiffening=stiffened)
    short, open_ = resonances(bender, 12e-3)
    assert short == pytest.approx(45.6, rel=0.02)
    assert open_ == pytest.approx(48.4, rel=0.02)
    assert 0.035 < open_ / short - 1 < 0.07


@each_mtp
def test_capacitance_is_as_printed(name: str) -> None:
    """±20 % is the maker's own limit; both layers in parallel are two of them."""
    found = bender_figures(BENDERS[name])["capacitance_nf"] / 2
    assert found == pytest.approx(PRINTED[name][1], rel=0.2)


@each_mtp
def test_blocked_force_is_at_least_as_printed(name: str) -> None:
    """The maker prints a smallest one; the model, of small signals, exceeds it by 0 to 30 %."""
    volts, _, _, newtons = PRINTED[name]
    found = bender_figures(BENDERS[name])["blocked_force_mn_per_v"] * volts * 1e-3
    assert 1.0 <= found / newtons <= 1.3


@each_mtp
def test_printed_displacement_is_three_to_four_times_the_models(name: str) -> None:
    """The finding of the table above, held fast: the sheet's figure is not one of small signals."""
    volts, _, millimeters, _ = PRINTED[name]
    found = bender_figures(BENDERS[name])["displacement_um_per_v"] * volts * 1e-3
    assert 2.8 <= millimeters / found <= 4.3


def test_the_default_design_has_the_figures_of_its_page() -> None:
    """Record: 0.931 µm/V, 1.43 mN/V, 1535 N/m, 12.8 nF, 930 Hz."""
    found = bender_figures(Bimorph())
    assert found["displacement_um_per_v"] == pytest.approx(0.931, abs=0.0005)
    assert found["blocked_force_mn_per_v"] == pytest.approx(1.43, abs=0.005)
    assert found["stiffness_n_per_m"] == pytest.approx(1535, abs=0.5)
    assert found["capacitance_nf"] == pytest.approx(12.8, abs=0.05)
    assert found["first_resonance_hz"] == pytest.approx(930, abs=0.5)
