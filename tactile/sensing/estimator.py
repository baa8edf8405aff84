"""Estimator of the load on each contactor, from the current that it draws while it plays.

The state of a contactor is the logarithms of the four constants of its load and of a factor of its
capacitance, which drifts with temperature. Each window of lag sums (`correlation`) updates it by
the maximum a posteriori estimate, by Gauss–Newton iterations: the sums are whitened, so that the
noise of the converter has the same variance in each of them, and the errors of the model are taken
as a part of the current. Each contactor is estimated by itself; a design study gained hardly
anything by a joint estimate at a converter range of 2.5 mA. They share only the rate at which their
loads change, since they are under one finger.

A contactor that nothing touches draws the current of the baseline. Of each window it is tested
whether that explains the current better than any finger does: if so, the contactor is in air, its
load is forgotten, and its capacitance is followed.

The constants below are per window of 25 ms. Those that are neither measured nor derived were chosen
on the benchmark `sensing`, within a range that changes its figures by less than 0.1 dB.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.sensing.correlation import LAGS, SumWindow
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.population import CONSTANTS, Population, spread
from tactile.sensing.whitening import STATES, AirFit, WhitenedSums

CAPACITANCE_SPREAD = 0.02
"""Standard deviation of ln of the capacitance against the baseline at the start (assumed:
some kelvins of a soft ceramic)."""
CAPACITANCE_DRIFT = 1e-4
"""Standard deviation by which ln of the capacitance changes in a window (assumed)."""
CONSISTENT = 3.0
"""Mean square of the whitened residual up to which a contactor counts for the common rate."""
COMMON_DRIFT, OWN_DRIFT = 0.05, 0.01
"""Standard deviations by which the load's logarithms change in a window: in common, since the
normal force changes all constants, and besides. A force that swings between 0.2 and 2 N every 1.5 s
changes the logarithms by at most 0.06 in 25 ms if the load grows with its square root."""
FORGETTING = 0.003
"""Part of the prior covariance of a load that each window adds, and part of the posterior that it
takes away."""
MODEL_ERROR = 0.003
"""Error of the model of the current, relative to it, since errors of the baseline (0.1 % of the
charge) are no information about the finger."""
FIRST_WINDOWS = 7
"""Number of windows after a touch that get `FAR_ITERATIONS`."""
FAR_ITERATIONS, ITERATIONS = 4, 2
"""Number of iterations of a load that may be far from what is expected, and of all after that."""
LARGEST_STEP = 1.5
"""Largest change of a state in an iteration."""
FARTHEST = 3.0
"""Distance from the population's mean to which a state is clamped, in standard deviations."""
SWINGING_WINDOWS = 6
"""Number of windows for which a tip may swing after a lift-off that an amplifier has noticed."""
SETTLING_WINDOWS = 3
"""Number of windows after a touch whose changes say nothing about the rate of the load."""
DECISIVE = 12.0
"""Difference of the squares of two whitened residuals from which the one with the smaller residual
is believed: a likelihood ratio of 400."""
CONVERGED = 2
"""Number of windows after a touch from which on a finger is said to have lifted, since the estimate
of the first one may still be far off."""
RATE_GAIN = 0.35
"""Share of the latest change of the mean scale in its smoothed rate."""


@dataclass(frozen=True)
class Estimate:
    """Loads of N contactors after a window.

    Attributes
    ----------
    logarithms : (N, 4) array of float
        Logarithms of k0 [N/m], d0 [N s/m], k1 [N/m] and d1 [N s/m].
    covariance : (N, 4, 4) array of float
        Their posterior covariance.
    inconsistency : (N,) array of float
        Mean square of the whitened residual: up to about 1 where the model explains the current,
        and infinite where a window was not valid.
    touching : (N,) array of bool
        Whether a finger is on the contactor. Where none is, the load is that of the population.
    capacitance : (N,) array of float
        Logarithm of the capacitance against that of the calibration.
    """

    logarithms: Floats
    covariance: Floats
    inconsistency: Floats
    touching: NDArray[np.bool_]
    capacitance: Floats


def prior_of(population: Population) -> tuple[Floats, Floats]:
    """Return what is known of a contactor before its current is.

    Parameters
    ----------
    population : Population
        Fingers that are to be expected.

    Returns
    -------
    mean : (STATES,) array of float
        Mean of the state.
    covariance : (STATES, STATES) array of float
        Covariance of the state.
    """
    covariance = np.zeros((STATES, STATES))
    covariance[:CONSTANTS, :CONSTANTS] = population.covariance
    covariance[CONSTANTS, CONSTANTS] = CAPACITANCE_SPREAD**2
    return np.append(population.mean, 0.0), covariance


@dataclass(frozen=True)
class _Fit:
    """Maximum a posteriori fit of the states of N contactors to a window.

    Attributes
    ----------
    model, whitened : CurrentModel, WhitenedSums
        Prediction and measurement.
    expected : (N, STATES) array of float
        Expected states.
    information : (N, STATES, STATES) array of float
        Inverse of their covariance.
    valid : (N,) array of bool
        Whether the measurement counts.
    """

    model: CurrentModel
    whitened: WhitenedSums
    expected: Floats
    information: Floats
    valid: NDArray[np.bool_]

    def iterate(
        self, state: Floats, contactors: NDArray[np.intp] | None = None, *, weighted: bool = True
    ) -> tuple[Floats, Floats]:
        """Return states (K, STATES) after a step of Gauss–Newton, and its Hessian.

        Where it is ``weighted``, what the model does not explain counts less.
        """
        rows = slice(None) if contactors is None else contactors
        residual, slope = self.whitened.linearized(self.model, state, contactors)
        inconsistency = np.mean(residual**2, axis=1) if weighted else np.zeros(len(state))
        weight = (self.valid[rows] / np.maximum(1, inconsistency))[:, None, None]
        information, turned = self.information[rows], slope.transpose(0, 2, 1)
        hessian = weight * (turned @ slope) + information
        pull = weight * (turned @ residual[..., None])
        pull += information @ (self.expected[rows] - state)[..., None]
        move = np.linalg.solve(hessian, pull)[..., 0]
        return state + np.clip(move, -LARGEST_STEP, LARGEST_STEP), np.asarray(hessian)


class LoadEstimator:
    """Follows the loads of N contactors from window to window.

    Parameters
    ----------
    model : CurrentModel
        Current that the contactors draw.
    population : Population
        Fingers that are to be expected.
    noise : float
        Standard deviation of a sample of the measured current [A].
    """

    def __init__(self, model: CurrentModel, population: Population, *, noise: float) -> None:
        self._model, self._noise = model, noise
        n = len(model.electrical)
        self._mean, self._prior = prior_of(population)
        self._added = FORGETTING * self._prior
        self._added[:CONSTANTS, :CONSTANTS] += spread(COMMON_DRIFT, OWN_DRIFT)
        self._added[CONSTANTS, CONSTANTS] = CAPACITANCE_DRIFT**2
        self._reach = FARTHEST * np.sqrt(np.diag(self._prior))
        self._state = np.tile(self._mean, (n, 1))
        self._covariance = np.tile(self._prior, (n, 1, 1))
        self._windows, self._rate = np.zeros(n, np.intp), 0.0
        self._touching = np.ones(n, np.bool_)
        self._swinging = np.zeros(n, np.intp)
        """Number of windows for which a tip still swings after an amplifier noticed a lift-off."""

    def restart(self, contactors: NDArray[np.bool_]) -> None:
        """Forget the finger on some contactors, for instance because they have been touched again.

        What is known of their capacitance is kept.

        Parameters
        ----------
        contactors : (N,) array of bool
            Contactors to start again.
        """
        self._state[contactors, :CONSTANTS] = self._mean[:CONSTANTS]
        kept = self._covariance[contactors, CONSTANTS, CONSTANTS]
        self._covariance[contactors] = self._prior
        self._covariance[contactors, CONSTANTS, CONSTANTS] = kept
        self._windows[contactors] = 0
        if contactors.all():
            self._rate = 0.0

    def lift(self, contactors: NDArray[np.bool_]) -> None:
        """Take note that contactors have lost the finger, as an amplifier's guard has noticed.

        Parameters
        ----------
        contactors : (N,) array of bool
            Contactors that have.
        """
        self._touching = self._touching & ~contactors
        self._swinging[contactors] = SWINGING_WINDOWS
        self.restart(contactors)

    def update(self, window: SumWindow) -> Estimate:
        """Take the sums of a window of 25 ms.

        Parameters
        ----------
        window : SumWindow
            Sums and drive of all contactors.

        Returns
        -------
        Estimate
            Loads at the middle of the window.
        """
        valid = window.valid & np.isfinite(window.sums).all(axis=1)
        whitened = WhitenedSums.of(self._model, window, self._noise, MODEL_ERROR)
        before = self._state
        expected = np.concatenate([self.ahead(1), before[:, CONSTANTS:]], axis=1)
        predicted = (1 - FORGETTING) * self._covariance + self._added
        air = whitened.in_air(before[:, CONSTANTS], predicted[:, CONSTANTS, CONSTANTS])
        information = np.asarray(np.linalg.inv(predicted))
        fit = _Fit(self._model, whitened, expected, information, valid)
        far = self._may_be_far(np.sum(air.residual**2, axis=1)) & valid
        state, self._covariance = self._solved(fit, np.flatnonzero(far))
        self._state = state
        residual = whitened.residual(self._model, state)
        inconsistency = np.where(valid, np.mean(residual**2, axis=1), np.inf)
        counted = (self._windows >= SETTLING_WINDOWS) & (inconsistency <= CONSISTENT)
        self._windows += valid
        lifted = self._test_air(air, valid, before[:, CONSTANTS], np.sum(residual**2, axis=1))
        inconsistency = np.where(np.isnan(lifted), inconsistency, lifted)
        counted &= self._touching
        if counted.any():
            change = float(np.mean((state - before)[counted, :CONSTANTS]))
            self._rate += RATE_GAIN * (change - self._rate)
        else:
            self._rate *= 1 - RATE_GAIN  # nobody knows any more how the loads change
        return Estimate(
            self._state[:, :CONSTANTS].copy(),
            self._covariance[:, :CONSTANTS, :CONSTANTS].copy(),
            inconsistency,
            self._touching.copy(),
            self._state[:, CONSTANTS].copy(),
        )

    def _solved(self, fit: _Fit, far: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return the states (N, STATES) of a fit, and their covariances.

        Loads of the contactors ``far`` (K,) may be far from what is expected.
        """
        state = fit.expected.copy()
        for _ in range(FAR_ITERATIONS if len(far) else 0):
            moved, _ = fit.iterate(state[far], far, weighted=False)
            state[far] = self._clamped(moved)
        for _ in range(ITERATIONS):
            moved, hessian = fit.iterate(state)
            state = self._clamped(moved)
        return state, np.asarray(np.linalg.inv(hessian))

    def _may_be_far(self, squares: Floats) -> NDArray[np.bool_]:
        """Return which contactors' loads may be far from what is expected.

        They are those that were touched lately, and those in air whose current air does not
        explain: ``squares`` (N,) are the squares of the residuals in air.
        """
        return np.where(self._touching, self._windows < FIRST_WINDOWS, squares > LAGS + DECISIVE)

    def _clamped(self, state: Floats) -> Floats:
        """Return states within reach of the population's mean."""
        return np.asarray(self._mean + np.clip(state - self._mean, -self._reach, self._reach))

    def _test_air(
        self, air: AirFit, valid: NDArray[np.bool_], factor: Floats, touched: Floats
    ) -> Floats:
        """Decide which contactors are in air, and let them follow their capacitance.

        ``factor`` (N,) are the logarithms of their capacitances that were expected, and ``touched``
        (N,) the squares of the residuals under a finger. Return the mean square of the residual of
        each contactor in air, and NaN of the others.
        """
        residual = air.residual
        squares = np.sum(residual**2, axis=1)
        better = squares - touched
        sure = valid & (np.abs(better) > DECISIVE)
        sure &= ~self._touching | (self._windows >= CONVERGED)
        # after lift-off a tip swings as neither model says: what explains nothing is no finger
        explained = touched <= CONSISTENT * residual.shape[1]
        sure &= self._touching | explained | (self._swinging == 0)
        self._swinging = np.maximum(self._swinging - 1, 0)
        self._touching = np.where(sure, better > 0, self._touching)
        free = ~self._touching & valid
        self.restart(~self._touching)
        farthest = self._reach[CONSTANTS]
        drifted = np.clip(factor + air.drift, -farthest, farthest)
        self._state[free, CONSTANTS] = drifted[free]
        self._covariance[free, CONSTANTS, CONSTANTS] = 1 / air.information[free]
        return np.where(free, squares / residual.shape[1], np.nan)

    def ahead(self, windows: float) -> Floats:
        """Extrapolate the loads by the present rate of their common change.

        Parameters
        ----------
        windows : float
            Time from the middle of the last window [windows].

        Returns
        -------
        (N, 4) array of float
            Logarithms of the constants.
        """
        settled = (self._windows >= SETTLING_WINDOWS)[:, None]
        return np.asarray(self._state[:, :CONSTANTS] + windows * self._rate * settled)
