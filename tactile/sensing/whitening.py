"""Sums of windows and their prediction, whitened.

The noise of the converter and the errors of the model have variance 1 in each direction of the
whitened sums, so that the squares of what a load leaves of them say how well it explains them.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.sensing.correlation import SumWindow, step_products
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.population import CONSTANTS

STATES = CONSTANTS + 1
"""Number of states of a contactor: four constants of the load, and the factor of its capacitance,
all as logarithms."""
SMALLEST = 1e-9
"""Smallest eigenvalue of the products of the steps that carries information, relative to the
largest."""
TINY = 1e-30
"""Number added to the eigenvalues, so that a drive at rest has none of zero [V²]."""


@dataclass(frozen=True)
class AirFit:
    """Fit of the capacitance of N contactors that nothing touches.

    Attributes
    ----------
    drift : (N,) array of float
        Change of the logarithm of its factor.
    information : (N,) array of float
        One over the variance of that after the fit.
    residual : (N, J) array of float
        Whitened residual.
    """

    drift: Floats
    information: Floats
    residual: Floats


@dataclass(frozen=True)
class WhitenedSums:
    """Sums of N contactors and what a model predicts of them, in J whitened directions.

    Attributes
    ----------
    measured : (N, J) array of float
        Measured sums.
    electrical : (N, J) array of float
        Sums of the current of the dielectric.
    air : (N, J) array of float
        Sums of the mechanical current of tips that nothing touches.
    shared : (N, J, R) array of float
        Sums of the currents of the model's shared filters.
    """

    measured: Floats
    electrical: Floats
    air: Floats
    shared: Floats

    @classmethod
    def of(
        cls, model: CurrentModel, window: SumWindow, noise: float, model_error: float
    ) -> "WhitenedSums":
        """Whiten a window.

        Parameters
        ----------
        model : CurrentModel
            Current that the contactors draw.
        window : SumWindow
            Sums and drive of all contactors.
        noise : float
            Standard deviation of a sample of the measured current [A].
        model_error : float
            Error of the model, relative to the current.

        Returns
        -------
        WhitenedSums
            `LAGS` directions.
        """
        products = step_products(window.steps, window.played)
        sums = np.where(np.isfinite(window.sums), window.sums, 0)
        delayed = sliding_window_view(window.played, window.samples, axis=1)[:, ::-1].copy()
        size, axes = np.linalg.eigh(delayed @ delayed.transpose(0, 2, 1))
        size = np.maximum(size, SMALLEST * size[:, -1:] + TINY)
        turned = axes.transpose(0, 2, 1) / np.sqrt(size)[..., None]
        measured = np.einsum("njl,nl->nj", turned, sums)
        rounding = window.resolution[:, None] ** 2 / (12 * size)
        deviation = np.sqrt(noise**2 + (model_error * measured) ** 2 + rounding)
        turned = turned / deviation[..., None]
        through = turned @ products.transpose(0, 2, 1)
        return cls(
            measured / deviation,
            (through @ model.electrical[..., None])[..., 0],
            (turned @ model.air_sums(window)[..., None])[..., 0],
            through @ model.shared.T,
        )

    @classmethod
    def joined(
        cls, parts: Iterable["WhitenedSums"], used: Iterable[NDArray[np.bool_]]
    ) -> "WhitenedSums":
        """Put the directions of windows side by side.

        Parameters
        ----------
        parts : iterable of WhitenedSums
            Windows of the same contactors.
        used : iterable of (N,) array of bool
            Contactors of which each window counts; of others its directions become 0.

        Returns
        -------
        WhitenedSums
            All directions.
        """
        counted = [
            (
                part.measured * use[:, None], part.electrical * use[:, None],
                part.air * use[:, None], part.shared * use[:, None, None],
            )
            for part, use in zip(parts, used, strict=True)
        ]  # fmt: skip
        return cls(*(np.concatenate(column, axis=1) for column in zip(*counted, strict=True)))

    def residual(self, model: CurrentModel, state: Floats) -> Floats:
        """Compute what a state leaves of the sums.

        Parameters
        ----------
        model : CurrentModel
            Model with which the sums were whitened.
        state : (N, STATES) array of float
            State of each contactor.

        Returns
        -------
        (N, J) array of float
            Whitened residual.
        """
        electrical = self.electrical * np.exp(state[:, CONSTANTS, None])
        weights = model.weights(state[:, :CONSTANTS])
        return np.asarray(self.measured - electrical - (self.shared @ weights[..., None])[..., 0])

    def linearized(
        self, model: CurrentModel, state: Floats, contactors: NDArray[np.intp] | None = None
    ) -> tuple[Floats, Floats]:
        """Compute what a state leaves of the sums, and how the prediction changes with the state.

        Parameters
        ----------
        model : CurrentModel
            Model with which the sums were whitened.
        state : (K, STATES) array of float
            State of each contactor.
        contactors : (K,) array of int, optional
            Contactors; by default all N.

        Returns
        -------
        residual : (K, J) array of float
            Whitened residual.
        slope : (K, J, STATES) array of float
            Derivatives of the prediction.
        """
        rows = slice(None) if contactors is None else contactors
        weights, slopes = model.weights_and_slopes(state[:, :CONSTANTS], contactors)
        electrical = self.electrical[rows] * np.exp(state[:, CONSTANTS, None])
        shared = self.shared[rows]
        predicted = electrical + (shared @ weights[..., None])[..., 0]
        slope = np.concatenate([shared @ slopes.transpose(0, 2, 1), electrical[..., None]], axis=2)
        return self.measured[rows] - predicted, slope

    def in_air(self, factor: Floats, variance: Floats) -> "AirFit":
        """Fit the capacitance of contactors that nothing touches.

        Parameters
        ----------
        factor : (N,) array of float
            Logarithm of the factor of the capacitance that is expected.
        variance : (N,) array of float
            Its variance.

        Returns
        -------
        AirFit
            Fit.
        """
        electrical = self.electrical * np.exp(factor[:, None])
        residual = self.measured - electrical - self.air
        information = (electrical**2).sum(axis=1) + 1 / variance
        drift = (electrical * residual).sum(axis=1) / information
        return AirFit(drift, information, np.asarray(residual - drift[:, None] * electrical))
