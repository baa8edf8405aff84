"""Calibration in air: what a bender draws when nothing touches it.

The current of a loaded bender differs from that in air by a few percent, so that the capacitance
must be known to about 0.1 %, as a function of frequency: a causal dielectric with a loss tangent of
0.02 loses 2.9 % of its capacitance per decade, as much as the whole effect of a stiff finger. It is
therefore measured and not modeled. The mechanical part F²/S of the air's charge is fitted first,
from the resonance; what is left is the capacitance, smoothed by a polynomial in log f.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tactile.arrays import Complex, Floats
from tactile.sensing.bender import Bender, Deviations
from tactile.sensing.hysteresis import PlayModel

REFERENCE = 300.0
"""Frequency to which the logarithms of frequencies refer [Hz]."""
ORDER = 6
"""Order of the polynomial in log f that is the capacitance."""
NEAR = 0.12
"""Distance from the resonance, relative to it, within which the capacitance is not fitted: there
the mechanical part is large, and so are its errors."""
PLAUSIBLE = {
    "capacitance": (0.5, 2.0),
    "stiffness": (0.7, 1.4),
    "d31": (0.5, 2.0),
    "mechanical loss": (0.3, 3.0),
}
"""Factors against the design between which a bender is plausible (assumed). A tip that is touched
is stiffer and loses more."""
DEAD, OPEN = 0.002, 0.3
"""Parts of the design's capacitance below which no current was measured, and below which it is that
of a cable without a bender (assumed): cables have about 1 %."""
LARGEST_SKEW = 20e-6
"""Largest plausible delay of the current, 16 % of a sample at 8 kHz (assumed) [s]. An error of a
sample is beyond it at all sample rates."""
BLUNT = 1e-3
"""Error of the polynomial, relative to the capacitance; lines are weighted by it and by the noise.
The fit is the better the lower it is down to here, and then stays (measured with the benchmark's
benders)."""
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
    hysteresis : PlayModel
        Effective voltage to which all this refers.
    """

    bender: Bender
    deviations: Deviations
    skew: Floats
    capacitance: Complex
    resonance: Floats
    residual: Floats
    faults: tuple[str, ...]
    hysteresis: PlayModel

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


class _Fit(NamedTuple):
    """Deviations, skew, capacitance, resonance and residual of a channel, as in `Baseline`."""

    stiffness: float
    coupling: float
    loss: float
    skew: float
    capacitance: Complex
    resonance: float
    residual: float


_NOTHING = _Fit(1.0, 0.0, 1.0, 0.0, np.zeros(ORDER + 1, np.complex128), 0.0, np.inf)
"""Fit of a channel without a bender."""
_TOUCHED = "is it touched, or another bender than the display's?"
"""Question about a channel that has the capacitance of a bender, but not its resonance."""


def fit_baseline(
    frequency: Floats,
    admittance: Complex,
    bender: Bender,
    *,
    deviation: Floats | None = None,
    clipped: NDArray[np.bool_] | None = None,
    hysteresis: PlayModel | None = None,
) -> Baseline:
    """Fit the baseline to admittances that were measured in air.

    Parameters
    ----------
    frequency : (F,) array of float
        Frequencies of the lines, ascending from above zero, densest near the resonance [Hz].
    admittance : (N, F) complex array
        Measured current per volt of effective voltage, of each channel; NaN where it is unknown
        [S].
    bender : Bender
        The design.
    deviation : (N, F) array of float, optional
        Standard deviations of the admittances, by which the lines of the capacitance are weighted
        [S].
    clipped : (N, F) array of bool, optional
        Whether the converter clipped at a line.
    hysteresis : PlayModel, optional
        Hysteresis of the channels; by default they have none.

    Returns
    -------
    Baseline
        Baseline of all channels.
    """
    per_charge = 2j * np.pi * frequency * bender.electrode_voltage(frequency)
    charge = admittance / per_charge
    spread = np.zeros(charge.shape) if deviation is None else deviation / np.abs(per_charge)
    beyond = np.zeros(charge.shape, np.bool_) if clipped is None else clipped
    fits, faults = [], []
    for row, deviates, clips in zip(charge, spread, beyond, strict=True):
        fault = _without_bender(frequency, row, clips, bender)
        weights = 1 / np.hypot(deviates, BLUNT * bender.capacitance)
        fit = _NOTHING if fault else _fit_one(frequency, row, weights, bender)
        fits.append(fit)
        faults.append(fault or _implausible(fit))
    columns = [np.array(column) for column in zip(*fits, strict=True)]
    stiffness, coupling, loss, skew, capacitance, resonance, residual = columns
    return Baseline(
        bender, Deviations(stiffness, coupling, loss), skew, capacitance, resonance, residual,
        tuple(faults), hysteresis or PlayModel.none(len(charge)),
    )  # fmt: skip


def _without_bender(
    frequency: Floats, charge: Complex, clipped: NDArray[np.bool_], bender: Bender
) -> str:
    """Return why there is no current of a bender to be fitted, or nothing."""
    missing = ~np.isfinite(charge)
    if missing.any():
        first = f"at {frequency[np.argmax(missing)]:.0f} Hz"
        if clipped[missing].any():
            return f"current beyond the range of the converter {first}: measure in a wider range"
        return f"no current was measured {first}, or too few windows of it came"
    low = frequency < (1 - SURROUNDINGS) * bender.resonance
    force, stiffness = bender.at(frequency[low], Deviations(*np.ones((3, 1))))
    due = float(np.median((bender.capacitance + force**2 / stiffness).real))
    farads = float(np.median(charge.real[low]))
    part = farads / due
    if abs(part) < DEAD:
        return "no current: the channel or its sensor is dead"
    if abs(part) < OPEN:
        return f"no bender: {_picofarads(farads)} where {_picofarads(due)} are due"
    if part < 0:
        return "current of wrong sign: its sensor is connected the wrong way round"
    lowest, highest = PLAUSIBLE["capacitance"]
    if not lowest <= part <= highest:
        return f"capacitance {part:.2g} times the design's, not {lowest:g} … {highest:g} times"
    return ""


def _picofarads(farads: float) -> str:
    """Return a capacitance for people."""
    return f"{1e12 * farads:.0f} pF"


def _implausible(fit: _Fit) -> str:
    """Return why no bender in air draws such a current, or nothing."""
    if not abs(fit.skew) <= LARGEST_SKEW:
        return (
            f"current {1e6 * fit.skew:.0f} µs late, not within ±{1e6 * LARGEST_SKEW:.0f} µs: the "
            "converter must run on the clock of the drive"
        )
    factors = {"stiffness": fit.stiffness, "d31": fit.coupling, "mechanical loss": fit.loss}
    for name, factor in factors.items():
        lowest, highest = PLAUSIBLE[name]
        if not lowest <= factor <= highest:
            return (
                f"{name} {factor:.2g} times the design's, not {lowest:g} … {highest:g} times: "
                f"{_TOUCHED}"
            )
    if not fit.residual <= LARGEST_RESIDUAL:
        return (
            f"current {100 * fit.residual:.2g} % off that of a bender, above "
            f"{LARGEST_RESIDUAL:.0%}: {_TOUCHED}"
        )
    return ""


def _late(frequency: Floats, skew: float) -> Complex:
    """Return the factor of a delay."""
    return np.asarray(np.exp(-2j * np.pi * frequency * skew))


def _fit_one(frequency: Floats, charge: Complex, weights: Floats, bender: Bender) -> _Fit:
    """Fit one channel, whose lines have weights in the fit of the capacitance."""
    nominal, size = bender.resonance, float(np.abs(charge).mean())
    near = np.abs(frequency / nominal - 1) < SURROUNDINGS
    weight = np.where(near, 1.0, FAR_WEIGHT) / size

    def parts(x: Floats) -> tuple[Complex, Complex]:
        """Return mechanical and dielectric charge of ln e, ln d, ln loss, skew [µs], C and β."""
        one = Deviations(*(np.exp([v]) for v in x[:3]))
        force, stiffness = bender.at(frequency, one)
        late = _late(frequency, x[3] * 1e-6)
        dielectric = size * x[4] * (1j * frequency / nominal) ** -x[5]
        return (force**2 / stiffness)[0] * late, dielectric * late

    def departure(x: Floats) -> Floats:
        """Return the weighted error of charge, real part and imaginary part."""
        error = (sum(parts(x)) - charge) * weight
        return np.concatenate([error.real, error.imag])

    # Far from its resonance the charge is in phase, but for the delay. Near it the tip moves most,
    # and most of the charge in quadrature is its motion.
    phase = np.unwrap(np.angle(charge[~near]))
    delay = -float(np.polyfit(frequency[~near], phase, 1)[0]) / 2e-6 / np.pi
    prompt = charge[near] / _late(frequency[near], delay * 1e-6)
    peak = frequency[near][np.argmin(prompt.imag)]
    start = [2 * np.log(peak / nominal), 0.0, 0.0, delay, 1.0, 0.01]
    x = least_squares(departure, start, x_scale=[0.01, 0.1, 0.3, 1.0, 0.1, 0.01]).x
    mechanical, _ = parts(x)
    resonance = nominal * float(np.exp(x[0] / 2))
    away = np.abs(frequency / resonance - 1) > NEAR
    rest = (charge - mechanical) / _late(frequency, x[3] * 1e-6)
    powers = np.vander(np.log(frequency / REFERENCE), ORDER + 1)
    weighted = weights[away, None] * powers[away]
    solved = np.linalg.lstsq(weighted, weights[away] * rest[away], rcond=None)
    capacitance = np.asarray(solved[0])
    left = (rest - powers @ capacitance) / size
    residual = float(np.sqrt(np.mean(np.abs(left[away]) ** 2)))
    e, d, loss = np.exp(x[:3])
    return _Fit(e, d, loss, x[3] * 1e-6, capacitance, resonance, residual)
