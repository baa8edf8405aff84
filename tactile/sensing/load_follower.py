"""Equalizer that follows the finger on each contactor, and plays the pilot which it needs for that.

`LoadFollower` takes the place of the equalizer with fixed filters in a renderer. It adds the pilot
to the volts. Whenever the sums of a window have come, it estimates the loads and cross-fades to
filters for the loads that are to be expected when these filters play. It also computes what the
guards of an amplifier are to expect, which judge earlier than that.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats, Singles
from tactile.rendering.equalizer import FollowingEqualizer
from tactile.sensing.baseline import Baseline
from tactile.sensing.correlation import SumWindow
from tactile.sensing.current_model import CurrentModel
from tactile.sensing.estimator import CONSISTENT, LoadEstimator
from tactile.sensing.excitation import pilot, pilot_phases
from tactile.sensing.guard import GuardDesign, GuardFilters
from tactile.sensing.hysteresis import HysteresisStream
from tactile.sensing.inverse_mix import InverseMix
from tactile.sensing.population import Population
from tactile.sensing.uncertainty import shear_deviation

TAPS, DELAY = 32, 8
"""Length and delay of the filters [samples]."""
GUARD_WINDOWS = 2
"""Number of windows for which the guard of a contactor keeps what it expects."""
PATIENCE = 4
"""Number of windows in a row that a load may fail to explain before the population's mean takes its
place: 0.1 s of windows of 25 ms."""


@dataclass(frozen=True)
class FollowedLoads:
    """Loads of N contactors as they are known after a window.

    Attributes
    ----------
    touching : (N,) array of bool
        Whether a finger is on the contactor.
    logarithms : (N, 4) array of float
        Logarithms of k0 [N/m], d0 [N s/m], k1 [N/m] and d1 [N s/m].
    deviation : (N,) array of float
        Standard deviation of the level of the played shear that follows from that of the load [dB].
    explained : (N,) array of bool
        Whether the load explains the current. Where it does not, filters for the mean of the
        population play.
    """

    touching: NDArray[np.bool_]
    logarithms: Floats
    deviation: Floats
    explained: NDArray[np.bool_]


@dataclass(frozen=True)
class FilterUpdate:
    """Loads after a window, and the filters for them.

    Attributes
    ----------
    loads : FollowedLoads
        Loads in the middle of the window.
    taps : (N, T) array of float
        Filter of each contactor for the time at which it is to play [V/m].
    samples : int
        Length of the cross-fade to them [samples].
    guards : GuardFilters or None
        What guards are to expect until the next update; None without guards.
    judged : (N,) array of bool
        Whether the load of each contactor is known well enough for its guard to judge by.
    """

    loads: FollowedLoads
    taps: Floats
    samples: int
    guards: GuardFilters | None
    judged: NDArray[np.bool_]


class LoadFollower:
    """Runs a filter for each contactor over a stream, and replaces the filters as loads change.

    Parameters
    ----------
    baseline : Baseline
        What the N contactors draw in air, without faults.
    polarity : (N,) array of float
        Polarity of each contactor, 1 or −1.
    sample_rate : float
        Sample rate [Hz].
    noise : float
        Standard deviation of a sample of the measured current [A].
    guarded : bool
        Whether the amplifier has guards.

    Raises
    ------
    InputError
        If the sample rate is not one for which currents can be predicted.

    Attributes
    ----------
    delay : int
        Delay from shear to volts [samples].
    """

    delay = DELAY

    def __init__(
        self,
        baseline: Baseline,
        *,
        polarity: Floats,
        sample_rate: float,
        noise: float,
        guarded: bool = False,
    ) -> None:
        population = Population.assumed()
        count = len(polarity)
        self._baseline, self._polarity, self._rate = baseline, polarity, sample_rate
        self._mean = np.tile(population.mean, (count, 1))
        model = CurrentModel(baseline, population, sample_rate)
        self._estimator = LoadEstimator(model, population, noise=noise)
        self._mix = InverseMix(baseline, sample_rate, taps=TAPS, delay=DELAY)
        self._equalizer = FollowingEqualizer(self._taps(self._mean, np.ones(count, np.bool_)))
        self._drive_for = HysteresisStream(baseline.hysteresis.inverse())
        self._phases, self._position = pilot_phases(count), 0
        self._unexplained = np.zeros(count, np.intp)
        self._guards = GuardDesign(baseline, sample_rate, noise=noise) if guarded else None

    def __call__(self, shear: Singles, normal_force: Floats) -> Singles:
        """Return the volts (S, N) for shear (S, N) [m] that was commanded ``delay`` samples ago."""
        volts = self._equalizer(shear, normal_force)
        added = pilot(self._position, len(shear), self._rate, self._phases)
        self._position += len(shear)
        return self._drive_for(volts + added).astype(np.float32)

    def apply(self, update: FilterUpdate) -> None:
        """Begin to cross-fade to filters.

        Parameters
        ----------
        update : FilterUpdate
            Filters, of this follower or of another one for the same contactors.
        """
        self._equalizer.replace(update.taps, update.samples)

    def play_mean(self, samples: int) -> None:
        """Begin to cross-fade to the filters of the mean finger, because nothing is known.

        Parameters
        ----------
        samples : int
            Length of the cross-fade [samples].
        """
        every = np.ones(len(self._mean), np.bool_)
        self._equalizer.replace(self._taps(self._mean, every), samples)

    def forget(self) -> None:
        """Forget all fingers; what is known of the capacitances is kept."""
        self._estimator.restart(np.ones(len(self._mean), np.bool_))
        self._unexplained[:] = 0

    def lift(self, contactors: NDArray[np.bool_]) -> None:
        """Take note that contactors have lost the finger, as guards have noticed.

        Parameters
        ----------
        contactors : (N,) array of bool
            Contactors that have.
        """
        self._estimator.lift(contactors)

    def estimate(
        self, window: SumWindow, *, lateness: float, guard_lateness: float = 0.0
    ) -> FilterUpdate:
        """Estimate the loads in a window, and compute the filters for them; nothing plays yet.

        The cross-fade is to take as long as the window.

        Parameters
        ----------
        window : SumWindow
            Sums and drive of all contactors.
        lateness : float
            Time from the end of the window to the output of the next sample of this stream
            [samples].
        guard_lateness : float
            Time from the end of the window until guards get what they are to expect [samples]; they
            keep that for `GUARD_WINDOWS`.

        Returns
        -------
        FilterUpdate
            Loads, and their filters.
        """
        estimate = self._estimator.update(window)
        judged = np.isfinite(estimate.inconsistency)
        failed = judged & (estimate.inconsistency > CONSISTENT)
        self._unexplained = np.where(judged & ~failed, 0, self._unexplained + failed)
        explained = self._unexplained < PATIENCE
        # from the middle of the window to its end, until the fade begins, and until it has ended
        ahead = self._estimator.ahead(0.5 + lateness / window.samples + 1)
        used = np.where(explained[:, None], ahead, self._mean)
        deviation = shear_deviation(self._baseline, estimate.logarithms, estimate.covariance)
        loads = FollowedLoads(estimate.touching, estimate.logarithms, deviation, explained)
        guards = None
        if self._guards is not None:
            late = 0.5 + guard_lateness / window.samples + GUARD_WINDOWS / 2
            guards = self._guards.filters(self._estimator.ahead(late), estimate.capacitance)
        return FilterUpdate(
            loads, self._taps(used, estimate.touching), window.samples, guards,
            estimate.touching & judged & ~failed,
        )  # fmt: skip

    def _taps(self, logarithms: Floats, touching: NDArray[np.bool_]) -> Floats:
        """Return the filters (N, T) for loads."""
        return self._mix.taps(logarithms, touching) * self._polarity[:, None]
