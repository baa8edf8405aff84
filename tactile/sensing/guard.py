"""What the guards in an amplifier expect of contactors under their present loads.

An amplifier cannot wait for the host to notice that a contactor has lost the finger. It computes at
each sample n, from currents i and steps of the drive d[n] = u[n] − u[n − 1],

    residual = i[n − 2] + p₀ i[n − 3] + p₁ i[n − 4] − Σ a[l] d[n − l]
    change   = Σ b[l] d[n − l]                                          l = 0 … 12

(section 17 of the protocol's SPEC.md). The poles p and the taps a are fitted so that the residual
of a contactor under its load is as small as possible. The taps b pass the band of the pilot alone,
and give what the residual would be there if the tip were free.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Complex, Floats
from tactile.sensing.baseline import Baseline
from tactile.sensing.calibration import BAND
from tactile.sensing.excitation import TONES, VOLTS
from tactile.sensing.population import load_stiffness

TAPS, POLES = 13, 2
"""Number of steps of the drive, and of earlier currents, that a residual takes."""
OLDER = 2
"""Number of samples by which the current that is judged is older than the latest step."""
PILOT_BAND = 1380.0, 1900.0
"""Frequencies between which the pilot lies, with room for the width of a short window [Hz]."""
ABOVE, HIGHEST = 2000.0, 0.4875
"""Frequency above which little is played [Hz], and highest frequency at which the filters are
fitted, as a part of the sample rate."""
BELOW = np.concatenate([np.geomspace(10, 100, 12)[:-1], np.arange(100, ABOVE, 20)])
"""Frequencies below that at which they are fitted; above they are 50 Hz apart [Hz]."""
PILOT_WEIGHT, ABOVE_WEIGHT = 6.0, 0.02
"""Weights of the band of the pilot and of what lies above `ABOVE` in the fit of the residual; the
rest has 1. Clicks and what the limiter turns down reach above it: filters that could be anything
there left up to seven times the current, and a half sine of 10 µm and 2 ms made guards trip. With
this weight they leave a third of it, and no more than before below."""
REJECTED = 1000.0, 30.0, 300.0
"""Frequency below which nothing should pass the filter of the change [Hz], weight of that in its
fit, and frequency above which the weight falls as the drive does [Hz]."""
POLE_DAMPING = 0.02
"""Weight that keeps the poles small: each of them adds the noise of another current."""
DEVIATIONS = 6.0
"""Number of standard deviations of noise at which a lost contact is believed: once in 10⁹."""
LOUD = 6.0
"""Largest residual against its noise, both rms over 8 samples. Strokes under a swinging force reach
4.8, since the load is known for 50 ms ago."""
SHARE = 0.03**2
"""Square of the largest residual against the current. The filters leave up to 1.5 %; a lost
finger changes the current by 4 % at 50 Hz and by more than itself near the resonance."""
LOOK = 40
"""Number of samples over which the amplifier looks for a lost contact."""
WIDEST_LOOP = 0.02
"""Width of the hysteresis loop at the voltage limit up to which guards can judge. Their filters are
linear: a drive up to the limit made 24 guards trip without reason 129 times within 4 s at 4 %, and
13 times at 2 %. Oak, of 37 V, made none trip at either."""


@dataclass(frozen=True)
class GuardFilters:
    """What the guards of N contactors expect.

    Attributes
    ----------
    poles : (N, 2) array of float
        Coefficients of earlier currents, p.
    drive : (N, 13) array of float
        Coefficients of the expected current, a [A/V].
    change : (N, 13) array of float
        Coefficients of the change, b [A/V].
    limit : (N,) array of float
        Largest rms of the residual while the current is small [A].
    share : float
        Square of the largest ratio of the residual to the current.
    floor : (N,) array of float
        Least sum of residual times change that counts as a lost contact [A²].
    """

    poles: Floats
    drive: Floats
    change: Floats
    limit: Floats
    share: float
    floor: Floats


def _stacked(response: Complex) -> Floats:
    """Return real and imaginary parts side by side, of the last axis."""
    return np.concatenate([response.real, response.imag], axis=-1)


class GuardDesign:
    """Filters of the guards of N contactors, for any loads.

    Parameters
    ----------
    baseline : Baseline
        What the contactors draw in air.
    sample_rate : float
        Sample rate [Hz].
    noise : float
        Standard deviation of a sample of the measured current [A].
    """

    def __init__(self, baseline: Baseline, sample_rate: float, *, noise: float) -> None:
        above = np.arange(ABOVE, HIGHEST * sample_rate, 50)
        self._frequency = f = np.concatenate([BELOW, above])
        force, self._stiffness = baseline.tip(f)
        known = np.minimum(f, BAND[1])
        capacitance = baseline.charge(known) / baseline.measuring(known)
        self._electrical = 2j * np.pi * f * capacitance * baseline.measuring(f)
        self._mechanical = 2j * np.pi * f * force**2 * baseline.measuring(f)
        self._later = np.exp(-2j * np.pi * f / sample_rate)
        self._noise = noise
        lags = self._later ** np.arange(TAPS)[:, None] * (1 - self._later)
        low, high = PILOT_BAND
        inside = (f > low) & (f < high)
        weight = np.where(inside, PILOT_WEIGHT, np.where(f > ABOVE, ABOVE_WEIGHT, 1.0))
        self._weight = weight / np.abs(self._electrical).mean(axis=0)
        basis = _stacked(lags * self._weight).T
        self._onto, _ = np.linalg.qr(basis)
        self._taps = np.linalg.pinv(basis)
        edge, rejection, corner = REJECTED
        self._passed = f > edge
        falling = np.where(f < edge, rejection * np.minimum(1, corner / f), 1.0)
        self._selection = np.where(inside, 10.0, np.where(f > high, ABOVE_WEIGHT, falling))
        self._selected = np.linalg.pinv(_stacked(lags * self._selection).T, rcond=1e-4)
        tones = np.array(TONES)
        late = np.exp(-2j * np.pi * tones / sample_rate)
        self._tones = late ** np.arange(TAPS)[:, None] * (1 - late) * np.array(VOLTS)

    def filters(self, logarithms: Floats, capacitance: Floats) -> GuardFilters:
        """Compute the filters for loads.

        Parameters
        ----------
        logarithms : (N, 4) array of float
            Logarithms of the constants of each contactor's load.
        capacitance : (N,) array of float
            Logarithm of the capacitance against that of the calibration.

        Returns
        -------
        GuardFilters
            What the guards expect.
        """
        electrical = self._electrical * np.exp(capacitance)[:, None]
        touched = self._stiffness + load_stiffness(logarithms, self._frequency)
        late = self._later**OLDER
        expected = (electrical + self._mechanical / touched) * late
        poles = self._poles(expected)
        filtered = 1 + poles @ self._later ** np.arange(1, POLES + 1)[:, None]
        drive = _stacked(expected * filtered * self._weight) @ self._taps.T
        free = self._mechanical * (1 / self._stiffness - 1 / touched) * late * filtered
        change = _stacked(np.where(self._passed, free, 0) * self._selection) @ self._selected.T
        noise = self._noise * np.sqrt(1 + np.sum(poles**2, axis=1))
        energy = LOOK * np.sum(np.abs(change @ self._tones) ** 2, axis=1) / 2
        return GuardFilters(
            poles, drive, change, LOUD * noise, SHARE, DEVIATIONS * noise * np.sqrt(energy)
        )

    def _poles(self, expected: Complex) -> Floats:
        """Return the poles (N, 2) with which taps fit a current (N, F) best.

        Of Y (1 + p₀ z⁻¹ + p₁ z⁻²) = Σ a[l] z⁻ˡ (1 − z⁻¹), which is linear in p and a, the part
        that taps can make is taken off on both sides (Levy 1959).
        """
        columns = [expected * self._later**k for k in range(POLES + 1)]
        rows = _stacked(np.stack(columns, axis=1) * self._weight)
        rows = rows - rows @ self._onto @ self._onto.T
        left = rows[:, 1:]
        gram = left @ left.transpose(0, 2, 1) + POLE_DAMPING**2 * np.eye(POLES)
        return np.asarray(np.linalg.solve(gram, -(left @ rows[:, 0, :, None]))[..., 0])
