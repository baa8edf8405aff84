"""The current that a contactor draws per step of the drive, for any load, as FIR filters."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from tactile.arrays import Complex, Floats
from tactile.errors import InputError
from tactile.sensing.baseline import Baseline
from tactile.sensing.correlation import AFTER, BEFORE, EARLIER, SumWindow
from tactile.sensing.population import Population, load_stiffness, load_terms

FITTED = np.unique(np.concatenate([np.geomspace(8, 40, 9), np.arange(40.0, 2601.0, 10.0)]))
"""Frequencies at which the filters are fitted [Hz]. Drive has no parts above them."""
GRID = np.geomspace(12, 2600, 90)
"""Frequencies at which a load is compared with the shared filters [Hz]."""
SHARED = 16
"""Number of filters that all contactors share for the part of the current that depends on the
load."""
DRAWS = 400
"""Number of loads from which the shared filters are made."""
WIDER = 1.5
"""Factor by which these loads spread more than the population."""
DAMPING = 1e-5
"""Weight in the fit that keeps the taps small, relative to the largest singular value."""


ROLL_OFF = 2600.0, 3000.0
"""Frequencies between which the current of a tip in air is taken to vanish [Hz]."""
SPAN = 2048
"""Period in which its response decays [samples]."""
LOWEST_RATE, HIGHEST_RATE = 6000.0, 16000.0
"""Sample rates between which filters of `BEFORE` and `AFTER` samples reach up to 2600 Hz and last
longer than a loaded bender swings: their error is then below 0.1 % of the charge [Hz]."""


def _fitted_taps(response: Complex, sample_rate: float) -> Floats:
    """Return the taps (K, BEFORE + AFTER + 1) whose responses are nearest to (K, F) at `FITTED`."""
    delay = np.arange(-BEFORE, AFTER + 1)
    turns = np.exp(-2j * np.pi / sample_rate * np.outer(FITTED, delay))
    left = np.concatenate([turns.real, turns.imag])
    right = np.concatenate([response.real, response.imag], axis=1)
    u, s, vt = np.linalg.svd(left, full_matrices=False)
    return np.asarray((right @ u * (s / (s**2 + (DAMPING * s[0]) ** 2))) @ vt)


def _tip_in_air(baseline: Baseline, sample_rate: float) -> Floats:
    """Return what tips in air draw per step of the drive (N, T).

    The response begins `BEFORE` samples before the step. It is that of the frequency response up to
    `ROLL_OFF`, since drive has no parts above it.
    """
    frequency = np.fft.rfftfreq(SPAN, 1 / sample_rate)
    inside = np.maximum(np.minimum(frequency, ROLL_OFF[1]), 1.0)
    step = 1 - np.exp(-2j * np.pi * inside / sample_rate)
    force, stiffness = baseline.tip(inside)
    low, high = ROLL_OFF
    share = (1 + np.cos(np.pi * np.clip((frequency - low) / (high - low), 0, 1))) / 2
    charge = force**2 / stiffness * baseline.measuring(inside)
    begin = np.exp(-2j * np.pi * frequency / sample_rate * BEFORE)
    response = np.fft.irfft(2j * np.pi * inside / step * charge * share * begin, SPAN)
    return np.asarray(response[:, : BEFORE + AFTER + EARLIER + 1])


def _stacked(response: Complex) -> Floats:
    """Return real and imaginary parts side by side."""
    return np.concatenate([response.real, response.imag], axis=-1)


class CurrentModel:
    """Current of N contactors per step of the effective voltage.

    Parameters
    ----------
    baseline : Baseline
        What the contactors draw in air.
    population : Population
        Fingers that are to be expected.
    sample_rate : float
        Sample rate of the drive, `LOWEST_RATE` to `HIGHEST_RATE` [Hz].

    Raises
    ------
    InputError
        If the filters do not fit the sample rate.

    Attributes
    ----------
    electrical : (N, T) array of float
        Response of the dielectric to a step of the drive, from `BEFORE` samples before it [A/V].
    shared : (R, T) array of float
        Filters that span the responses of the loaded tips [A/V].
    air : (N, BEFORE + AFTER + EARLIER + 1) array of float
        Response of the tips that nothing touches [A/V].
    force, stiffness : (N, G) complex array
        Force of the held tips per volt [N/V], and dynamic stiffness of the undriven tips, at `GRID`
        [N/m].
    measuring : (N, G) complex array
        Measured current per step of the drive, for one coulomb per volt at the electrodes [A/C].
    """

    def __init__(self, baseline: Baseline, population: Population, sample_rate: float) -> None:
        if not LOWEST_RATE <= sample_rate <= HIGHEST_RATE:
            raise InputError(
                f"sample_rate {sample_rate:g} Hz: must be {LOWEST_RATE:g} … {HIGHEST_RATE:g} Hz"
            )
        rate = 2j * np.pi * FITTED / (1 - np.exp(-2j * np.pi * FITTED / sample_rate))
        self.electrical = _fitted_taps(rate * baseline.charge(FITTED), sample_rate)
        rng = np.random.default_rng(0)
        loads = rng.multivariate_normal(population.mean, WIDER**2 * population.covariance, DRAWS)
        force, stiffness = baseline.tip(FITTED)
        drawn = rng.integers(len(force), size=DRAWS)
        source = rate * force**2 * baseline.measuring(FITTED)
        self.air = _tip_in_air(baseline, sample_rate)
        self._air_spectra: dict[int, Complex] = {}
        responses = source[drawn] / (stiffness[drawn] + load_stiffness(loads, FITTED))
        _, _, span = np.linalg.svd(_stacked(responses), full_matrices=False)
        shared = span[:SHARED, : len(FITTED)] + 1j * span[:SHARED, len(FITTED) :]
        self.shared = _fitted_taps(shared, sample_rate)
        at_grid = np.array([np.interp(GRID, FITTED, row) for row in shared])
        self._weights = np.linalg.pinv(_stacked(at_grid))
        rate = 2j * np.pi * GRID / (1 - np.exp(-2j * np.pi * GRID / sample_rate))
        self.force, self.stiffness = baseline.tip(GRID)
        self.measuring = rate * baseline.measuring(GRID)
        self._source = rate * self.force**2 * baseline.measuring(GRID)

    def air_sums(self, window: SumWindow) -> Floats:
        """Predict the sums of the current that tips in air draw.

        Parameters
        ----------
        window : SumWindow
            Window with the drive; its sums are not read.

        Returns
        -------
        (N, LAGS) array of float
            Sums of the mechanical part of the current in air [A V].
        """
        steps = np.concatenate([window.earlier, window.steps], axis=1)
        length = next_fast_len(steps.shape[1], real=True)  # what wraps around ends before `begin`
        if length not in self._air_spectra:
            self._air_spectra[length] = rfft(self.air, length)
        drawn = irfft(rfft(steps, length) * self._air_spectra[length], length)
        begin = EARLIER + AFTER + BEFORE
        current = drawn[:, begin : begin + window.samples]
        lagged = sliding_window_view(window.played, window.samples, axis=1)
        return np.asarray(np.einsum("nls,ns->nl", lagged, current)[:, ::-1])

    def weights(self, logarithms: Floats) -> Floats:
        """Compute the weights of the shared filters for loads.

        Parameters
        ----------
        logarithms : (N, 4) array of float
            Logarithms of the constants of each contactor's load.

        Returns
        -------
        (N, R) array of float
            Weights of `shared`.
        """
        response = self._source / (self.stiffness + load_stiffness(logarithms, GRID))
        return self.weights_of(response)

    def weights_of(self, response: Complex) -> Floats:
        """Compute the weights of the shared filters that together are nearest to a response.

        Parameters
        ----------
        response : (..., G) complex array
            Current per step of the drive at `GRID`, of tips under loads [A/V].

        Returns
        -------
        (..., R) array of float
            Weights of `shared`.
        """
        return np.asarray(_stacked(response) @ self._weights)

    def weights_and_slopes(
        self, logarithms: Floats, contactors: NDArray[np.intp] | None = None
    ) -> tuple[Floats, Floats]:
        """Compute the weights of the shared filters for loads, and their derivatives.

        Parameters
        ----------
        logarithms : (K, 4) array of float
            Logarithms of the constants of each contactor's load.
        contactors : (K,) array of int, optional
            Contactors; by default all N.

        Returns
        -------
        weights : (K, R) array of float
            Weights of `shared`.
        slopes : (K, 4, R) array of float
            Derivatives to the logarithms.
        """
        rows = slice(None) if contactors is None else contactors
        terms = load_terms(logarithms, GRID)
        compliance = 1 / (self.stiffness[rows] + terms.sum(axis=1))
        response = self._source[rows] * compliance
        slope = -(response * compliance)[:, None] * terms
        return _stacked(response) @ self._weights, _stacked(slope) @ self._weights
