"""Calibration in air: what a bender draws when nothing touches it.

The current of a loaded bender differs from that in air by a few percent, so that the capacitance
must be known to about 0.1 %, as a function of frequency: a causal dielectric with a loss tangent of
0.02 loses 2.9 % of its capacitance per decade, as much as the whole effect of a stiff finger. It is
therefore measured and not modeled. The mechanical part F²/S of the air's charge is fitted first,
from the resonance; what is left is the capacitance, smoothed by a polynomial in log f.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from tactile.arrays import Complex, Floats
from tactile.sensing.bender import Bender, Deviations

REFERENCE = 300.0
"""Frequency to which the logarithms of frequencies refer [Hz]."""
ORDER = 6
"""Order of the polynomial in log f that is the capacitance."""
NEAR = 0.12
"""Distance from the resonance, relative to it, within which the capacitance is not fitted: there
the mechanical part is large, and so are its errors."""
PLAUSIBLE = {"stiffness": (0.7, 1.4), "d31": (0.5, 2.0), "mechanical loss": (0.3, 3.0)}
"""Factors against the design between which a bender is plausible (assumed). A tip that is touched
is stiffer and loses more; a channel without a bender has no d31."""
LARGEST_RESIDUAL = 0.05
"""Largest residual of a plausible fit (assumed); with noise of the converter it is 0.3 %."""
SURROUNDINGS = 0.25
"""Distance from the resonance, relative to it, within which its parameters are fitted in full."""
FAR_WEIGHT = 0.2
"""Weight of the fit's errors farther from the resonance, where a power law is a coarse model of the
capacitance."""


@dataclass(frozen=True)
class Baseline:
    """What N benders draw, but for the finger.

    Attributes
    ----------
    bender : Bender
        The design.
    deviations : Deviations
        Deviations of each bender from it.
    skew : (N,) array of float
        Delay of the measured current against the drive [s].
    capacitance : (N, ORDER + 1) complex array
        Coefficients of the capacitance as a polynomial in ln(f/`REFERENCE`), highest order first
        [F].
    resonance : (N,) array of float
        Resonance in air [Hz].
    residual : (N,) array of float
        Root mean square of what the fit leaves of the charge, relative to the capacitance.
    faults : tuple of N str
        Why the baseline of a channel must not be used; empty if it may be.
    """

    bender: Bender
    deviations: Deviations
    skew: Floats
    capacitance: Complex
    resonance: Floats
    residual: Floats
    faults: tuple[str, ...]

    def charge(self, frequency: Floats) -> Complex:
        """Compute the charge of the dielectric as it is measured.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies, above zero [Hz].

        Returns
        -------
        (N, F) complex array
            Charge per volt of drive [C/V].
        """
        powers = np.vander(np.log(frequency / REFERENCE), ORDER + 1)
        return np.asarray(self.capacitance @ powers.T * self.measuring(frequency))

    def measuring(self, frequency: Floats) -> Complex:
        """Compute what amplifier and skew make of a charge per volt at the electrodes.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].

        Returns
        -------
        (N, F) complex array
            Measured charge per volt of drive, for one coulomb per volt at the electrodes.
        """
        late = np.exp(-2j * np.pi * frequency * self.skew[:, None])
        return np.asarray(self.bender.electrode_voltage(frequency) * late)

    def tip(self, frequency: Floats) -> tuple[Complex, Complex]:
        """Compute force of the held tip and stiffness of the tip of each bender.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].

        Returns
        -------
        force : (N, F) complex array
            Force of the held tip per volt [N/V].
        stiffness : (N, F) complex array
            Dynamic stiffness of the undriven tip [N/m].
        """
        return self.bender.at(frequency, self.deviations)


def fit_baseline(frequency: Floats, admittance: Complex, bender: Bender) -> Baseline:
    """Fit the baseline to admittances that were measured in air.

    Parameters
    ----------
    frequency : (F,) array of float
        Frequencies of the lines, ascending from above zero, densest near the resonance [Hz].
    admittance : (N, F) complex array
        Measured current per volt of drive, of each channel [S].
    bender : Bender
        The design.

    Returns
    -------
    Baseline
        Baseline of all channels.
    """
    per_charge = 2j * np.pi * frequency * bender.electrode_voltage(frequency)
    fits = [_fit_one(frequency, row, bender) for row in admittance / per_charge]
    columns = [np.array(column) for column in zip(*fits, strict=True)]
    stiffness, coupling, loss, skew, capacitance, resonance, residual = columns
    return Baseline(
        bender, Deviations(stiffness, coupling, loss), skew, capacitance, resonance, residual,
        tuple(_fault(*fit) for fit in zip(stiffness, coupling, loss, residual, strict=True)),
    )  # fmt: skip


def _fault(stiffness: float, coupling: float, loss: float, residual: float) -> str:
    """Return why no bender in air draws such a current, or nothing."""
    for name, factor in (("stiffness", stiffness), ("d31", coupling), ("mechanical loss", loss)):
        lowest, highest = PLAUSIBLE[name]
        if not lowest <= factor <= highest:
            return f"{name} {factor:.2g} times the design's, not {lowest:g} … {highest:g} times"
    if not residual <= LARGEST_RESIDUAL:
        return f"current {100 * residual:.2g} % off that of a bender, above {LARGEST_RESIDUAL:.0%}"
    return ""


def _fit_one(
    frequency: Floats, charge: Complex, bender: Bender
) -> tuple[float, float, float, float, Complex, float, float]:
    """Fit one channel; return deviations, skew, capacitance, resonance and residual."""
    if not (np.isfinite(charge).all() and charge.any()):
        nothing = np.zeros(ORDER + 1, np.complex128)
        return 1.0, 0.0, 1.0, 0.0, nothing, bender.resonance, np.inf
    nominal, size = bender.resonance, float(np.abs(charge).mean())
    near = np.abs(frequency / nominal - 1) < SURROUNDINGS
    weight = np.where(near, 1.0, FAR_WEIGHT) / size

    def parts(x: Floats) -> tuple[Complex, Complex]:
        """Return mechanical and dielectric charge of ln e, ln d, ln loss, skew [µs], C and β."""
        one = Deviations(*(np.exp([v]) for v in x[:3]))
        force, stiffness = bender.at(frequency, one)
        late = np.exp(-2j * np.pi * frequency * x[3] * 1e-6)
        dielectric = size * x[4] * (1j * frequency / nominal) ** -x[5]
        return (force**2 / stiffness)[0] * late, dielectric * late

    def departure(x: Floats) -> Floats:
        """Return the weighted error of charge, real part and imaginary part."""
        error = (sum(parts(x)) - charge) * weight
        return np.concatenate([error.real, error.imag])

    # Near its resonance the tip moves most, and most of the charge in quadrature is its motion.
    peak = frequency[near][np.argmin(charge.imag[near])]
    start = [2 * np.log(peak / nominal), 0.0, 0.0, 0.0, 1.0, 0.01]
    x = least_squares(departure, start, x_scale=[0.01, 0.1, 0.3, 1.0, 0.1, 0.01]).x
    mechanical, _ = parts(x)
    late = np.exp(-2j * np.pi * frequency * x[3] * 1e-6)
    resonance = nominal * float(np.exp(x[0] / 2))
    away = np.abs(frequency / resonance - 1) > NEAR
    rest = (charge - mechanical) / late
    powers = np.vander(np.log(frequency / REFERENCE), ORDER + 1)
    capacitance = np.linalg.lstsq(powers[away], rest[away], rcond=None)[0]
    left = (rest - powers @ capacitance) / size
    residual = float(np.sqrt(np.mean(np.abs(left[away]) ** 2)))
    e, d, loss = np.exp(x[:3])
    return e, d, loss, x[3] * 1e-6, capacitance, resonance, residual
