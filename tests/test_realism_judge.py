"""Tests of the judge of realism: features against closed forms, and entrants on synthetic signals.

The recordings are judged only in CI, because they are not shipped and take minutes.
"""

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.random import Generator
from scipy.io import wavfile
from scipy.signal import freqz, lfilter
from scipy.special import polygamma

from benchmarks.fit import FABRICS, recordings
from benchmarks.realism import measure_realism
from benchmarks.realism.entrants import (
    ENTRANTS,
    NARROW,
    Autoregressive,
    Penn,
    PhaseRandomized,
    Replayed,
    White,
    burg,
    line_spectral_frequencies,
)
from benchmarks.realism.features import FABRIC, SKIN, WHOLE, amplitudes
from benchmarks.realism.judgments import (
    FAMILIES,
    Fold,
    Source,
    Split,
    area_under_curve,
    either_way,
    folds_of,
    mean_of,
    nearest_speeds,
    one_speed,
    own_speed,
)
from tactile.arrays import Floats
from tactile.texture.formats.hatt import polynomial
from tactile.texture.recorded_slide import Quantity, Recorded

GAUSSIAN = 10 / np.log(10) * np.sqrt(polygamma(1, 1))
"""Standard deviation of the level of a periodogram of Gaussian noise, whose power is exponentially
distributed: the variance of its logarithm is trigamma(1) = π²/6. It is 5.57 dB."""
MODEL = np.array([1.0, -1.1, 0.7, -0.2])
"""Denominator of a stable autoregressive process."""


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(1)


def recorded(
    signal: Floats, *, rate: float = NARROW, quantity: Quantity = "acceleration"
) -> Recorded:
    """Return a signal as an uncalibrated recording at 20 mm/s."""
    return Recorded(
        name="synthetic", signal=signal, quantity=quantity, sample_rate=rate,
        speed=np.full(len(signal), 0.02), calibrated=False,
    )  # fmt: skip


def process(rng: Generator, count: int) -> Floats:
    """Return samples of the process of `MODEL`."""
    return np.asarray(lfilter([1.0], MODEL, rng.standard_normal(500 + count))[500:])


def lines(count: int) -> Floats:
    """Return samples of sines of equal power, 20 Hz apart."""
    time = np.arange(count) / FABRIC.rate
    return np.asarray(sum(np.sin(2 * np.pi * 20 * k * time + k**2) for k in range(1, 31)))


# Features


def test_spectra_of_gaussian_noise_are_as_rough_as_an_exponential_distribution(
    rng: Generator,
) -> None:
    """Neighboring bins under a Hann window are alike, which lowers it in narrow bands."""
    analysis = WHOLE  # 30 to 600 bins for each band but the lowest
    rough = analysis.roughness(rng.standard_normal((60, round(3 * analysis.rate))))
    assert abs(rough[:, 6:].mean() - GAUSSIAN) < 0.1


def test_roughness_does_not_depend_on_the_slope_of_the_spectrum(rng: Generator) -> None:
    """The steep spectrum rises by 8 dB over a third octave."""
    noise = rng.standard_normal(80_000)
    steep = np.fft.irfft(np.fft.rfft(noise) * np.arange(40_001.0) ** 4)
    flat, sloped = (FABRIC.roughness(FABRIC.windows(side))[:, 3:].mean() for side in (noise, steep))
    assert abs(flat - sloped) < 0.2


def test_lines_are_rougher_than_noise() -> None:
    assert FABRIC.roughness(lines(800)[None]).mean() > 2 * GAUSSIAN


def test_third_octaves_hold_the_power_of_noise_and_of_a_sine(rng: Generator) -> None:
    """White noise of variance 1 has a density of 2/rate; a sine lies in one third octave.

    The lowest bands hold few bins, and the mean of the logarithm of their power is lower.
    """
    level = SKIN.third_octaves(rng.standard_normal((400, 2200))).mean(axis=0)
    np.testing.assert_allclose(level[10:], 10 * np.log10(2 / SKIN.rate), atol=0.15)
    tone = np.sin(2 * np.pi * 100 * np.arange(2200) / SKIN.rate)[None]
    assert SKIN.third_octaves(tone).argmax() == 20 - SKIN.first


def test_modulation_of_an_amplitude_is_measured_in_its_octave() -> None:
    """An envelope 1 + m·sin has power m²/2, spread over an octave of width 0.71 f."""
    time = np.arange(round(WHOLE.window * WHOLE.rate)) / WHOLE.rate
    envelope = (1 + 0.4 * np.sin(2 * np.pi * 8 * time))[None, None]
    spectrum = WHOLE.modulation(envelope)[0, 0]
    assert spectrum.argmax() == 3
    assert spectrum[3] == pytest.approx(10 * np.log10(0.4**2 / 2 / (8 * np.sqrt(0.5))), abs=0.3)


def test_kurtosis_of_known_distributions(rng: Generator) -> None:
    gaussian, laplacian = rng.standard_normal((1, 200_000)), rng.laplace(size=(1, 200_000))
    sine = np.sin(np.arange(200_000))[None]
    assert [float(amplitudes(x)[0, 0]) for x in (gaussian, laplacian, sine)] == pytest.approx(
        [0, 3, -1.5], abs=0.2
    )


def test_bursts_that_all_bands_share_are_seen_across_bands(rng: Generator) -> None:
    noise = rng.standard_normal(8000)
    bursts = noise * (1 + 0.9 * np.sin(2 * np.pi * 6 * np.arange(8000) / FABRIC.rate))
    steady, shared = (FABRIC.features(x)["across"].mean() for x in (noise, bursts))
    assert abs(steady) < 0.15
    assert shared > 0.4


def test_features_do_not_depend_on_the_sample_rate(rng: Generator) -> None:
    """A signal is the same at 4 and at 8 kHz, even if that has a tone which 2 kHz would alias."""
    time = np.arange(24_000) / 8000
    frequency = rng.uniform(60, 500, (50, 1))
    signal = np.sin(2 * np.pi * frequency * time + rng.uniform(0, 6.28, (50, 1))).sum(axis=0)
    every = FABRIC.signal(recorded(signal + np.sin(2 * np.pi * 3800 * time), rate=8000.0))
    half = FABRIC.signal(recorded(signal[::2], rate=4000.0))
    inside = slice(200, -200)
    assert np.std((every - half)[inside]) < 0.01 * np.std(every)


# Judgments


def test_area_under_the_curve_counts_pairs() -> None:
    assert area_under_curve(np.array([2.0, 3.0]), np.array([1.0, 2.0])) == (3 + 0.5) / 4


def test_an_interval_contains_the_mean_in_95_of_100_cases(rng: Generator) -> None:
    means = [mean_of(rng.normal(7, 2, 30)) for _ in range(200)]
    assert 0.88 < np.mean([m.low < 7 < m.high for m in means]) < 0.99


def fold(real: Floats, made: Floats) -> Fold:
    """Return a fold whose halves are those of some signals (S,)."""
    half = len(real) // 2
    parts = [FABRIC.features(part) for side in (real, made) for part in (side[:half], side[half:])]
    return Fold(seen=parts[0], unseen=parts[1], made=parts[2], test=parts[3])


def test_noise_is_not_told_from_noise_but_lines_are(rng: Generator) -> None:
    """Equal distributions have an area of 0.5, with a standard error of 0.05 for 80 windows each.

    The lines have the level of the noise.
    """
    noise, other = rng.standard_normal((2, 64_000))
    assert abs(fold(noise, other).area(FAMILIES) - 0.5) < 0.15
    assert fold(noise, lines(64_000) / np.sqrt(15)).area(("fine",)) > 0.99


@pytest.mark.ci
def test_materials_are_identified_by_their_own_recordings_only(rng: Generator) -> None:
    """Strokes over the wrong material are identified as that, and are far away."""
    smooth = [recorded(process(rng, 6600)) for _ in range(4)]
    rough = [recorded(rng.standard_normal(6600)) for _ in range(4)]
    judge = Split({"smooth": smooth, "rough": rough}, rng)
    right = judge.strokes(Replayed(), rng)
    np.testing.assert_array_equal(judge.identified(right), 1)
    np.testing.assert_array_equal(judge.identified(right[::-1]), 0)
    near, far = judge.distances(right), judge.distances(right[::-1])
    assert near[:, 0].max() < 1.5 < far[:, :2].min()
    assert np.all(near[:, 1] <= near[:, 0])


# Entrants


def test_burg_recovers_a_process_and_its_noise(rng: Generator) -> None:
    model, variance = burg([process(rng, 20_000), process(rng, 20_000)], 3)
    np.testing.assert_allclose(model, MODEL, atol=0.02)
    assert variance == pytest.approx(1, abs=0.02)


def test_line_spectral_frequencies_are_inverted_by_the_importer_of_the_toolkit() -> None:
    np.testing.assert_allclose(polynomial(line_spectral_frequencies(MODEL)), MODEL, atol=1e-9)
    even = np.convolve(MODEL, [1.0, 0.3])
    np.testing.assert_allclose(polynomial(line_spectral_frequencies(even)), even, atol=1e-9)


@pytest.mark.parametrize("entrant", [Autoregressive(16), PhaseRandomized(), Penn()])
def test_models_have_the_spectrum_of_the_process_that_was_recorded(
    entrant: Autoregressive | PhaseRandomized | Penn, rng: Generator
) -> None:
    train = [recorded(process(rng, 22_000)) for _ in range(3)]
    strokes = entrant.strokes(train, 0.02, 10.0, 6, rng)
    signals = [SKIN.signal(stroke) for stroke in strokes]
    measured = np.mean([SKIN.third_octaves(SKIN.windows(s)).mean(axis=0) for s in signals], axis=0)
    center = 10 ** (np.arange(SKIN.first, SKIN.last + 1) / 10)
    _, response = freqz([1.0], MODEL, worN=center, fs=NARROW)
    exact = 10 * np.log10(2 / NARROW * np.abs(response) ** 2)
    assert np.abs((measured - exact)[6:-1]).max() < 0.8


def test_strokes_at_twice_the_speed_have_the_law_of_fabrics(rng: Generator) -> None:
    """S(f; v) = (v/v0)·S0(f·v0/v): a line of 100 Hz moves to 200 Hz, and is twice as high."""
    tone = np.sin(2 * np.pi * 100 * np.arange(8800) / NARROW)
    (stroke,) = Replayed().strokes([recorded(tone)], 0.04, 1.0, 1, rng)
    assert stroke.duration == pytest.approx(1.0)
    signal = SKIN.signal(stroke)[300:-300]
    spectrum = np.abs(np.fft.rfft(signal))
    assert spectrum.argmax() * SKIN.rate / len(signal) == pytest.approx(200, abs=1)
    assert np.std(signal) == pytest.approx(2 * np.sqrt(0.5), rel=0.02)


def test_white_noise_has_the_level_of_the_recording(rng: Generator) -> None:
    train = [recorded(0.01 * process(rng, 6600))]
    sides = [[stroke] for stroke in White().strokes(train, 0.02, 3.0, 4, rng)]
    made = np.mean([SKIN.third_octaves(SKIN.signal(s)[None]) for (s,) in sides])
    assert made == pytest.approx(SKIN.third_octaves(SKIN.signal(train[0])[None]).mean(), abs=0.1)


@pytest.mark.ci
@pytest.mark.parametrize("name", ["rendered", "mpeg", "learned"])
def test_textures_have_about_the_spectrum_of_the_process_that_was_recorded(
    name: str, rng: Generator
) -> None:
    """The texture is fitted to recordings of displacement, whose unit is not known."""
    train = [recorded(1e3 * process(rng, 6600), quantity="displacement") for _ in range(3)]
    strokes = ENTRANTS[name].strokes(train, 0.02, 3.0, 3, rng)
    made, real = (
        np.mean([SKIN.third_octaves(SKIN.signal(s)[None])[0] for s in side], axis=0)
        for side in (strokes, train)
    )
    assert strokes[0].duration == pytest.approx(3.0)
    assert np.abs(made - real)[2:-1].max() < 3.0
    assert abs(np.mean(made - real)) < 0.1


# Folds


def test_a_classifier_that_errs_on_all_windows_tells_them_apart() -> None:
    np.testing.assert_allclose(either_way(np.array([0.1, 0.5, 0.9])), [0.9, 0.5, 0.9])


@dataclass
class Witness:
    """Entrant that replays a recording, and keeps at which speeds recordings it was given.

    Attributes
    ----------
    given : list of tuple
        Speed of the strokes, and those of the recordings [m/s].
    """

    given: list[tuple[float, list[float]]] = field(default_factory=list)

    def strokes(
        self, train: list[Recorded], speed: float, duration: float, count: int, rng: Generator
    ) -> list[Recorded]:
        """Return a recording as the only stroke."""
        self.given.append((speed, [float(r.speed.mean()) for r in train]))
        return train[:1]


@pytest.mark.parametrize(
    ("source", "trained", "tested"),
    [
        (nearest_speeds, [[0.05, 0.06], [0.06, 0.03], [0.05, 0.03]], [0.03, 0.05]),
        (one_speed, [[0.05], [0.06], [0.05]], [0.03]),
        (own_speed, [[0.03], [0.05], [0.06]], [0.02]),
    ],
)
def test_strokes_are_made_from_the_recordings_that_are_chosen(
    source: Source, trained: list[list[float]], tested: list[float], tmp_path: Path, rng: Generator
) -> None:
    """The recording at 20 mm/s is left out first: no other stroke is made from it."""
    (tmp_path / "textsense").mkdir()
    for key in FABRICS:
        noise = (3000 * rng.standard_normal(6000)).astype(np.int16)
        wavfile.write(tmp_path / "textsense" / f"denim_{key}.wav", 10_000, noise)
    witness = Witness()
    next(folds_of(tmp_path, "denim", witness, rng, source))
    assert [speed for speed, _ in witness.given] == pytest.approx([0.03, 0.05, 0.06, 0.02])
    for (_, given), expected in zip(witness.given, [*trained, tested], strict=True):
        assert given == pytest.approx(expected)


# Recordings


@pytest.mark.ci
def test_the_judge_knows_recordings_from_noise_and_lines() -> None:
    if recordings() is None:
        assert os.environ.get("CI") != "true", "the recordings are missing"
        pytest.skip("the recordings are missing: they may not be shipped with the project")
    value = {figure.name: figure.value for figure in measure_realism()}
    assert value["realism.fabrics.white.all"] > 0.8
    assert value["realism.fabrics.mpeg.all"] > 0.8
    assert 0.3 < value["realism.fabrics.replayed.all"] < 0.75, "a recording passes for one"
    assert value["realism.fabrics.rendered.own_speed.all"] < 0.65, "the speed is what tells"
    assert value["realism.fabrics.hatt.either_way"] > value["realism.fabrics.hatt.all"]
    assert abs(value["realism.roughness.ar16.windows"] - GAUSSIAN) < 0.6
    assert value["realism.biotac.replayed.identified"] > 0.85
    for distance in ("one_stroke", "mean_of_strokes", "modulation"):
        real, made = (value[f"realism.biotac.{n}.{distance}"] for n in ("replayed", "white"))
        assert real < made
