"""Entrants: makers of strokes from recordings of a surface, each a small class with one method.

Another one is added by writing such a class and naming it in `ENTRANTS`. All but the renderer
carry a recording to another speed by the law that was measured on fabrics: the spectral density of
acceleration is S(f; v) = (v/v0)·S0(f·v0/v). That is the same waveform played v/v0 times as fast,
v/v0 times as strong.
"""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.fit import ABOUT, texture_of
from benchmarks.realism.features import SKIN, resampled
from benchmarks.rendering import SKIPPED, first_contactors
from tactile.arrays import Floats
from tactile.bench.figures import RATE
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import render
from tactile.texture.fitting import describe, measure_slides
from tactile.texture.formats.conversion import convert_file
from tactile.texture.formats.hatt import polynomial
from tactile.texture.formats.surface_effect import effect_of
from tactile.texture.formats.synthesis import synthesize
from tactile.texture.recorded_slide import Recorded
from tactile.texture.slide_strokes import INTEGRATIONS
from tactile.texture.surface import Texture, load_texture

NARROW = SKIN.rate
"""Sample rate of recordings of which models are made [Hz]. A wider band would spend the poles of an
autoregressive model where a finger feels nothing."""
HATT_ORDER = 16
"""Number of poles of the models of `Penn`."""
SETTLING = 2000
"""Number of samples until a filter of noise has forgotten its beginning."""


class Entrant(Protocol):
    """Maker of strokes."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Make strokes over a surface of which there are recordings.

        Parameters
        ----------
        train : list of Recorded
            Recordings of the surface, all of one quantity.
        speed : float
            Speed of the strokes [m/s].
        duration : float
            Duration of a stroke [s].
        count : int
            Number of strokes, each over another part of the surface.
        rng : numpy.random.Generator
            Source of random numbers.

        Returns
        -------
        list of Recorded
            Strokes of the same quantity, at any sample rate.
        """
        ...


class RenderedTexture:
    """Texture that is fitted, written to a file, and rendered under a contactor."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Render strokes over a fitted texture, each over another surface; see `Entrant`."""
        texture = texture_of(describe(measure_slides(train), ABOUT).descriptor)
        return rendered_over(texture, train, speed, duration, rng.integers(1 << 31, size=count))


class TextureEffect:
    """Texture that is fitted and made an effect of MPEG-I Haptics, a second that repeats."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Synthesize an effect, each stroke from another time on; see `Entrant`."""
        fit = describe(measure_slides(train), ABOUT)
        samples = synthesize(effect_of(fit.descriptor, speed)[0], RATE)[: round(RATE), 0]
        size = round(duration * RATE) + 2 * SKIPPED
        starts = rng.integers(len(samples), size=count)
        shears = [np.resize(np.roll(samples, start), size) for start in starts]
        return strokes_of_shear(shears, train, speed)


class Penn:
    """Autoregressive models at each recorded speed, between which is interpolated.

    As in the Penn Haptic Texture Toolkit, line spectral frequencies and the variance of the noise
    are interpolated linearly, and held outside of the recorded speeds (Culbertson, Unwin &
    Kuchenbecker, IEEE ToH 2014).
    """

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Filter noise; see `Entrant`."""
        speeds = np.unique([float(recorded.speed.mean()) for recorded in train])
        rows = []
        for recorded_speed in speeds:
            near = nearest(train, recorded_speed)
            model, variance = burg([resampled(r, NARROW) for r in near], HATT_ORDER)
            rows.append([*line_spectral_frequencies(model), variance])
        *lsf, variance = (np.interp(speed, speeds, column) for column in np.transpose(rows))
        model, size = polynomial(np.array(lsf)), round(duration * NARROW)
        noises = rng.normal(0, np.sqrt(variance), (count, SETTLING + size))
        signals = lfilter([1.0], model, noises)[:, SETTLING:]
        return [stroke_like(train[0], signal, NARROW, speed) for signal in signals]


@dataclass(frozen=True)
class Autoregressive:
    """Autoregressive model of the recordings at the nearest speed, driven by Gaussian noise.

    Attributes
    ----------
    order : int
        Number of poles.
    """

    order: int

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Filter noise; see `Entrant`."""
        near = nearest(train, speed)
        model, variance = burg([resampled(recorded, NARROW) for recorded in near], self.order)
        size = stretched_size(near[0], speed, duration)

        def stroke() -> Recorded:
            noise = rng.normal(0, np.sqrt(variance), SETTLING + size)
            return at_speed(near[0], lfilter([1.0], model, noise)[SETTLING:], speed)

        return [stroke() for _ in range(count)]


class White:
    """White Gaussian noise at the level of the recordings at the nearest speed."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Draw noise; see `Entrant`."""
        near = nearest(train, speed)
        size = stretched_size(near[0], speed, duration)
        noise = [
            stroke_like(near[0], rng.standard_normal(size), NARROW, near[0].speed.mean())
            for _ in range(count)
        ]
        return [at_speed(near[0], stroke.signal, speed) for stroke in leveled(noise, near)]


class Replayed:
    """Recording at the nearest speed, replayed: the ceiling of what the recordings tell."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Replay the recordings at the nearest speed by turns, back and forth; see `Entrant`."""
        near = nearest(train, speed)
        size = stretched_size(near[0], speed, duration)
        strokes = []
        for k in range(count):
            signal = resampled(near[k % len(near)], NARROW)
            endless = np.pad(signal, (0, max(size - len(signal), 0)), "reflect")
            strokes.append(at_speed(near[0], endless[:size], speed))
        return strokes


class PhaseRandomized:
    """Recording whose spectral lines keep their powers, and are given other phases."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Randomize phases of the recordings at the nearest speed by turns; see `Entrant`."""
        near = nearest(train, speed)
        strokes = []
        for k in range(count):
            signal = resampled(near[k % len(near)], NARROW)
            spectrum = np.fft.rfft(signal)
            phase = np.exp(2j * np.pi * rng.uniform(size=len(spectrum)))
            endless = np.fft.irfft(np.abs(spectrum) * phase, len(signal))
            size = stretched_size(near[0], speed, duration)
            strokes.append(at_speed(near[0], np.resize(endless, size), speed))
        return strokes


class LearnedLevels:
    """Texture of a model that learned levels by speed, through an ONNX file."""

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Render strokes over the texture, each over another surface; see `Entrant`."""
        from benchmarks.realism.learned import regression_of, write_model

        with TemporaryDirectory() as folder:
            file, target = Path(folder) / "learned.onnx", Path(folder) / "learned.toml"
            write_model(file, regression_of(measure_slides(train)), source="bench")
            convert_file(str(file), target)
            texture = load_texture(target)
        return rendered_over(texture, train, speed, duration, rng.integers(1 << 31, size=count))


ENTRANTS: dict[str, Entrant] = {
    "rendered": RenderedTexture(),
    "replayed": Replayed(),
    "phase_randomized": PhaseRandomized(),
    "ar16": Autoregressive(16),
    "ar8": Autoregressive(8),
    "hatt": Penn(),
    "mpeg": TextureEffect(),
    "white": White(),
}
"""Entrants by name; a learned model needs onnx and onnxruntime."""
if find_spec("onnx") and find_spec("onnxruntime"):
    ENTRANTS["learned"] = LearnedLevels()


def rendered_over(
    texture: Texture, train: list[Recorded], speed: float, duration: float, seeds: NDArray[np.intp]
) -> list[Recorded]:
    """Render strokes under a contactor, each over another surface, like recordings."""
    display = first_contactors(load_display("reference-24"), 1)
    path = Trajectory.line(speed=speed, duration=duration + 2 * SKIPPED / RATE)
    shears = [render(display, texture, path, seed=int(seed)).shear[:, 0] for seed in seeds]
    return strokes_of_shear(shears, train, speed)


def stroke_like(recorded: Recorded, signal: Floats, rate: float, speed: float) -> Recorded:
    """Return a signal as a stroke of the quantity of a recording."""
    return replace(
        recorded, name="stroke", signal=signal, sample_rate=rate,
        speed=np.full(len(signal), speed), normal_force=None, tangential_force=None,
    )  # fmt: skip


def strokes_of_shear(shears: list[Floats], train: list[Recorded], speed: float) -> list[Recorded]:
    """Return shears (S,) as strokes of the quantity of recordings, without their ends.

    The level that a fit assumes for an uncalibrated recording is replaced by that of the recording.
    """
    times = INTEGRATIONS[train[0].quantity]
    strokes = [
        stroke_like(train[0], derivative(shear, times)[SKIPPED:-SKIPPED], RATE, speed)
        for shear in shears
    ]
    return strokes if train[0].calibrated else leveled(strokes, train)


def derivative(signal: Floats, times: int) -> Floats:
    """Return the derivative of a signal (S,) at the display's rate, through its spectrum."""
    omega = 2j * np.pi * np.fft.rfftfreq(len(signal), 1 / RATE)
    return np.fft.irfft(np.fft.rfft(signal) * omega**times, len(signal))


def leveled(strokes: list[Recorded], train: list[Recorded]) -> list[Recorded]:
    """Return strokes at the level that the recordings have in third octaves of 25–800 Hz."""
    recorded, made = (
        np.mean([SKIN.third_octaves(SKIN.signal(stroke)[None]) for stroke in side])
        for side in (train, strokes)
    )
    gain = float(10 ** ((recorded - made) / 20))
    return [replace(stroke, signal=gain * stroke.signal) for stroke in strokes]


def nearest(train: list[Recorded], speed: float) -> list[Recorded]:
    """Return the recordings at the speed that is nearest to another one."""
    distance = [abs(np.log(recorded.speed.mean() / speed)) for recorded in train]
    return [r for r, d in zip(train, distance, strict=True) if d < min(distance) + 0.05]


def stretched_size(recorded: Recorded, speed: float, duration: float) -> int:
    """Return the samples at the speed of a recording that last for a duration at another speed."""
    return round(duration * NARROW * speed / float(recorded.speed.mean()))


def at_speed(recorded: Recorded, signal: Floats, speed: float) -> Recorded:
    """Return a signal (S,) at the rate `NARROW` and the speed of a recording at another speed."""
    ratio = float(speed / recorded.speed.mean())
    return stroke_like(recorded, ratio * signal, NARROW * ratio, speed)


def burg(signals: list[Floats], order: int) -> tuple[Floats, float]:
    """Fit an autoregressive model to signals by Burg's method.

    Parameters
    ----------
    signals : list of (S,) array of float
        Signals of one process.
    order : int
        Number of poles.

    Returns
    -------
    model : (order + 1,) array of float
        Denominator of the filter, beginning with 1.
    variance : float
        Variance of the noise that drives it.
    """
    model = np.ones(1)
    variance = float(np.mean(np.concatenate(signals) ** 2))
    sides = [(signal[1:], signal[:-1]) for signal in signals]
    for _ in range(order):
        cross = sum(float(ahead @ behind) for ahead, behind in sides)
        power = sum(float(ahead @ ahead + behind @ behind) for ahead, behind in sides)
        turn = -2 * cross / power
        longer = np.append(model, 0.0)
        model = longer + turn * longer[::-1]
        variance *= 1 - turn**2
        sides = [
            ((ahead + turn * behind)[1:], (behind + turn * ahead)[:-1]) for ahead, behind in sides
        ]
    return model, variance


def line_spectral_frequencies(model: Floats) -> Floats:
    """Return the line spectral frequencies (P,) of a model (P + 1,), ascending [rad/sample]."""
    ahead, behind = np.append(model, 0.0), np.append(0.0, model[::-1])
    angles = np.angle(np.concatenate([np.roots(ahead + behind), np.roots(ahead - behind)]))
    return np.sort(angles[(angles > 1e-6) & (angles < np.pi - 1e-6)])
