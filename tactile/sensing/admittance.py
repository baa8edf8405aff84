"""Admittances of contactors, from the lag sums of their currents while a calibration plays.

In the steady part of a segment the current is i[n] = Re Σ_k Y_k U_k exp(jω_k n/fs), of the lines'
complex amplitudes U_k in the drive. The lag sums of a window are then linear in the real and
imaginary parts of Y_k, with coefficients that follow from the drive. They are solved by least
squares over the windows of the segment. White noise of variance σ² of the current has the
covariance σ² D Dᵀ in the sums of a window, of the delayed steps D (LAGS, S); their rounding adds to
it. The noise itself is found from what the solution leaves. What is solved are admittances to the
drive; those to the effective voltage follow from how much of each line this has (`hysteresis`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactile.arrays import Complex, Floats
from tactile.sensing.calibration import FEWEST, CalibrationPlan, ToneSegment, segments_of
from tactile.sensing.correlation import LAGS
from tactile.sensing.hysteresis import HysteresisStream, PlayModel

SMALLEST = 1e-12
"""Smallest eigenvalue of D Dᵀ that carries information, relative to the largest."""
EXPECTED = 2.0**-11
"""Noise that is expected at first, of a converter of 12 bits, as a part of its range (assumed)."""
QUIETEST = 1e-4
"""Lowest noise that is found, as a part of that."""


@dataclass(frozen=True)
class AirWindows:
    """Lag sums of W windows that came while a calibration was played.

    Attributes
    ----------
    positions : (W,) array of int
        Positions of the first samples of the windows, from the first sample of the drive on.
    sums : (W, N, LAGS) array of float
        Lag sums of each contactor [A V].
    rounding : (W, N) array of float
        Largest error of the sums that comes from their transmission [A V].
    valid : (W, N) array of bool
        Whether the sums may be used. They may not where no report came, and where the drive that
        was played is not known.
    clipped : (W, N) array of bool
        Whether the converter was at an end of its range.
    """

    positions: NDArray[np.int64]
    sums: Floats
    rounding: Floats
    valid: NDArray[np.bool_]
    clipped: NDArray[np.bool_]


@dataclass(frozen=True)
class Admittances:
    """Measured admittances of N contactors at the lines of a calibration.

    Attributes
    ----------
    frequency : (F,) array of float
        Frequencies, ascending [Hz].
    value : (N, F) complex array
        Current per volt of effective voltage; NaN where too few windows were usable [S].
    deviation : (N, F) array of float
        Standard deviation of the complex value [S].
    noise : (N,) array of float
        Standard deviation of the noise of a sample of the current; NaN if nothing was usable [A].
    clipped : (N, F) array of bool
        Whether the converter clipped while a line was played.
    """

    frequency: Floats
    value: Complex
    deviation: Floats
    noise: Floats
    clipped: NDArray[np.bool_]


def measure_admittances(
    plan: CalibrationPlan, windows: AirWindows, played: Floats, hysteresis: PlayModel
) -> Admittances:
    """Estimate the admittances from lag sums.

    Parameters
    ----------
    plan : CalibrationPlan
        What was played.
    windows : AirWindows
        What came back; windows in no steady part are left out.
    played : (S,) array of float
        The plan's drive as it was played, rounded to the codes of the link [V].
    hysteresis : PlayModel
        Hysteresis of the N contactors.

    Returns
    -------
    Admittances
        Admittances of all contactors.
    """
    belongs = segments_of(plan, windows.positions)
    systems = [
        _System.of(plan, segment, windows, np.flatnonzero(belongs == number), played)
        for number, segment in enumerate(plan.segments)
    ]
    contactors = windows.sums.shape[1]
    expected = np.full(contactors, EXPECTED * plan.limits.current)
    noise = _noise(systems, expected)
    solved = [system.solve(noise) for system in systems]
    value, deviation = (np.concatenate(column, axis=1) for column in zip(*solved, strict=True))
    gain = _gains(plan, played, hysteresis)
    value, deviation = value / gain, deviation / np.abs(gain)
    clipped = [
        np.repeat(windows.clipped[belongs == number].any(axis=0)[:, None], len(segment.lines), 1)
        for number, segment in enumerate(plan.segments)
    ]
    order = np.argsort(np.concatenate([segment.lines for segment in plan.segments]))
    return Admittances(
        plan.lines, value[:, order], deviation[:, order], noise,
        np.concatenate(clipped, axis=1)[:, order],
    )  # fmt: skip


def _gains(plan: CalibrationPlan, played: Floats, hysteresis: PlayModel) -> Complex:
    """Return the effective voltage per volt of drive of each line (N, F), segment by segment."""
    drive = np.repeat(played[:, None], len(hysteresis.radii), axis=1)
    effective, gains = HysteresisStream(hysteresis)(drive), []
    for segment in plan.segments:
        turn = np.asarray(2j * np.pi / plan.sample_rate * segment.lines)
        amplitude = _amplitudes(played[:, None], segment, turn)
        gains.append(_amplitudes(effective, segment, turn) / amplitude)
    return np.concatenate(gains).T


def _noise(systems: list["_System"], expected: Floats) -> Floats:
    """Return the noise (N,) of the current from what the solutions leave [A].

    It is that of the median segment, since free vibration is left in some of them.
    """
    shares = np.array([system.left(expected) for system in systems])
    middle = np.full(len(expected), np.nan)
    known = np.isfinite(shares).any(axis=0)
    middle[known] = np.nanmedian(shares[:, known], axis=0)
    return np.asarray(expected * np.sqrt(np.maximum(middle, QUIETEST**2)))


@dataclass(frozen=True)
class _System:
    """Linear system of a segment, in the directions in which noise of the sums is independent.

    Attributes
    ----------
    matrix : (W, LAGS, 2K) array of float
        Sums per real part of each admittance, and per imaginary part.
    sums : (W, LAGS, N) array of float
        Measured sums; 0 where they are not usable.
    size : (W, LAGS) array of float
        Variance of the sums for noise of the current of variance 1.
    rounding : (W, N) array of float
        Variance of the rounding.
    usable : (W, N) array of bool
        Whether the sums may be used.
    """

    matrix: Floats
    sums: Floats
    size: Floats
    rounding: Floats
    usable: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        plan: CalibrationPlan,
        segment: ToneSegment,
        windows: AirWindows,
        which: NDArray[np.int64],
        played: Floats,
    ) -> "_System":
        """Set up the system of a segment from the windows that lie in its steady part."""
        turn = np.asarray(2j * np.pi / plan.sample_rate * segment.lines)
        position = windows.positions[which]
        tones = _amplitudes(played[:, None], segment, turn)[:, 0] * np.exp(
            (position[:, None] + np.arange(plan.window))[..., None] * turn
        )
        steps = np.diff(played, prepend=np.zeros(LAGS))  # that at n is steps[n + LAGS − 1]
        delayed = sliding_window_view(steps, plan.window)
        rows = delayed[position[:, None] + LAGS - 1 - np.arange(LAGS)]
        size, axes = np.linalg.eigh(rows @ rows.transpose(0, 2, 1))
        turned = axes.transpose(0, 2, 1)
        product = turned @ (rows @ tones)
        sums = windows.sums[which]
        usable = windows.valid[which] & ~windows.clipped[which] & np.isfinite(sums).all(axis=2)
        sums = np.where(usable[..., None], sums, 0)
        return cls(
            np.concatenate([product.real, -product.imag], axis=2),
            turned @ sums.transpose(0, 2, 1),
            np.maximum(size, SMALLEST * size[:, -1:]),
            np.where(usable, windows.rounding[which], 0) ** 2 / 3,
            usable,
        )

    def _weights(self, noise: Floats) -> Floats:
        """Return the weight (W, LAGS, N) of each row, 1/variance."""
        variance = noise**2 * self.size[..., None] + self.rounding[:, None]
        return np.asarray(self.usable[:, None] / variance)

    def _solution(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return solution (N, 2K) and covariance (N, 2K, 2K); 1 for channels with few windows."""
        normal = np.einsum("wja,wjn,wjb->nab", self.matrix, weights, self.matrix, optimize=True)
        few = self.usable.sum(axis=0) < FEWEST
        normal[few] = np.eye(normal.shape[1])
        covariance = np.linalg.inv(normal)
        pull = np.einsum("wja,wjn,wjn->na", self.matrix, weights, self.sums, optimize=True)
        return np.einsum("nab,nb->na", covariance, pull), covariance

    def solve(self, noise: Floats) -> tuple[Complex, Floats]:
        """Return admittances (N, K) and their deviations for noise (N,); NaN for few windows."""
        few = self.usable.sum(axis=0) < FEWEST
        x, covariance = self._solution(self._weights(np.where(few, 1.0, noise)))
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        half = x.shape[1] // 2
        value = np.where(few[:, None], np.nan, x[:, :half] + 1j * x[:, half:])
        deviation = np.sqrt(variance[:, :half] + variance[:, half:])
        return value, np.where(few[:, None], np.nan, deviation)

    def left(self, noise: Floats) -> Floats:
        """Return the variance (N,) that is left, relative to that of noise (N,); NaN if unknown."""
        weights = self._weights(noise)
        x, _ = self._solution(weights)
        error = self.sums - np.einsum("wja,na->wjn", self.matrix, x)
        counts = self.usable[:, None] & (noise**2 * self.size[..., None] > self.rounding[:, None])
        count = counts.sum(axis=(0, 1))
        enough = (self.usable.sum(axis=0) >= FEWEST) & (count > x.shape[1])
        squares = np.where(counts, error**2 * weights, 0).sum(axis=(0, 1))
        return np.where(enough, squares / np.maximum(count - x.shape[1], 1), np.nan)


def _amplitudes(played: Floats, segment: ToneSegment, turn: Complex) -> Complex:
    """Return the complex amplitudes (K, N) of a segment's lines in voltages (S, N) [V]."""
    span = slice(segment.first, segment.end)
    tones = np.exp(np.arange(segment.first, segment.end)[:, None] * turn)
    left = np.concatenate([tones.real, -tones.imag], axis=1)
    parts = np.linalg.lstsq(left, played[span], rcond=None)[0]
    half = len(parts) // 2
    return np.asarray(parts[:half] + 1j * parts[half:])
