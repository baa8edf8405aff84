"""Tests of the example of a learned model: the regression, its ONNX file, and its training."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fit import FABRICS, fabric, recordings
from benchmarks.realism.learned import (
    LOUDEST,
    BandRegression,
    regression_of,
    write_model,
)
from benchmarks.realism.train import held_out
from tactile.arrays import Floats
from tactile.texture.fitting import (
    FORCE_PRIOR,
    SCATTER,
    SPEED_PRIOR,
    RecordingMeasures,
    Slide,
    measure_slides,
)
from tactile.texture.formats.level_model import load_level_model
from tactile.texture.recorded_slide import Recorded

CENTER = 1e3 * 10 ** (np.arange(-3, 3) / 10)
"""Centers of six bands [cycles/m]."""
SPEED, FORCE = np.array([0.02, 0.03, 0.05, 0.06]), np.array([0.3, 0.6, 0.5, 1.0])
"""Speeds [m/s] and normal forces [N] of four recordings."""
FALLING = np.linspace(-60, -70, len(CENTER))
"""Levels at 1 m/s and 1 N [dB]."""


def measures_of(level: Floats, *, calibrated: bool = True) -> RecordingMeasures:
    """Return measurements of four recordings with given levels (4, 6)."""
    slides = [
        Slide(
            Recorded(
                name="made", signal=np.zeros(4), quantity="displacement", sample_rate=1e3,
                speed=np.full(4, v), calibrated=calibrated,
            ), v, n, [np.zeros(4)], [np.zeros(4)],
        )
        for v, n in zip(SPEED, FORCE, strict=True)
    ]  # fmt: skip
    return RecordingMeasures(slides, 0.035, 1e-4, CENTER, level, [], 0)


def law(speed_exponent: float, force_exponent: float) -> Floats:
    """Return the levels (4, 6) of a power law."""
    shift = 20 * (speed_exponent * np.log10(SPEED) + force_exponent * np.log10(FORCE))
    return np.asarray(FALLING + shift[:, None])


def test_levels_of_the_known_law_are_learned_exactly_even_with_gaps() -> None:
    level = law(SPEED_PRIOR[0], FORCE_PRIOR[0])
    level[0, 2] = level[1:, 4] = np.nan
    learned = regression_of(measures_of(level))
    np.testing.assert_allclose(learned.weight.T, [(SPEED_PRIOR[0], FORCE_PRIOR[0])] * 6)
    np.testing.assert_allclose(learned.level, FALLING)
    assert (learned.speed, learned.force) == ((0.02, 0.06), (0.3, 1.0))


def test_a_band_that_no_recording_covers_is_left_out() -> None:
    level = law(-1.0, 0.4)
    level[:, 0] = np.nan
    np.testing.assert_allclose(regression_of(measures_of(level)).center, CENTER[1:])


def test_another_exponent_is_learned_as_far_as_the_recordings_tell_it() -> None:
    """A ridge regression on one lever shrinks the step from the prior by S/(S + (σ/s)²)."""
    level = FALLING + 20 * (-2.0 * np.log10(SPEED) + FORCE_PRIOR[0] * np.log10(0.5))[:, None]
    measured = measures_of(level)
    slides = [Slide(s.recorded, s.speed, 0.5, s.strokes, s.bare) for s in measured.slides]
    one_force = RecordingMeasures(slides, 0.035, 1e-4, CENTER, level, [], 0)
    lever = 20 * np.log10(SPEED)
    power = float(np.sum((lever - lever.mean()) ** 2))
    share = power / (power + (SCATTER / SPEED_PRIOR[1]) ** 2)
    learned = regression_of(one_force)
    np.testing.assert_allclose(learned.weight[0], SPEED_PRIOR[0] * (1 + share))
    np.testing.assert_allclose(learned.weight[1], FORCE_PRIOR[0])


def test_uncalibrated_recordings_are_brought_to_an_assumed_level() -> None:
    learned = regression_of(measures_of(law(-1.0, 0.4) - 300, calibrated=False))
    assert learned.at(SPEED, FORCE).max() == pytest.approx(LOUDEST)


def test_the_file_gives_the_levels_of_the_regression(tmp_path: Path) -> None:
    """The tolerance is that of float32."""
    weight = np.stack([np.linspace(-1.5, -0.5, 6), np.linspace(0.2, 0.6, 6)])
    learned = BandRegression(CENTER, weight, FALLING, (0.02, 0.06), (0.3, 1.0))
    write_model(tmp_path / "x.onnx", learned, source="a test", category="wood")
    model = load_level_model(tmp_path / "x.onnx")
    levels = model.levels(SPEED, FORCE)
    np.testing.assert_allclose(levels, learned.at(SPEED, FORCE), atol=1e-4)
    assert model.metadata.speed_range_mm_s == (20, 60)
    assert model.metadata.normal_force_range_n == (0.3, 1)
    assert (model.metadata.source, model.metadata.category) == ("a test", "wood")


def test_a_recording_that_is_held_out_does_not_tell_its_own_level() -> None:
    """Raised by 6 dB, it is 6 dB off; each other one is off by a share of that."""
    level = law(SPEED_PRIOR[0], FORCE_PRIOR[0])
    level[1] += 6
    errors = list(held_out(measures_of(level)))
    assert errors[1] == pytest.approx(6)
    assert 0 < max(errors[0], errors[2], errors[3]) < 3


# Recordings


@pytest.fixture
def folder() -> Path:
    if (data := recordings()) is None:
        assert os.environ.get("CI") != "true", "the recordings are missing"
        pytest.skip("the recordings are missing: they may not be shipped with the project")
    return data


@pytest.mark.ci
def test_a_model_of_denim_predicts_the_recording_left_out(folder: Path) -> None:
    """Two recordings of a fabric are 3 dB apart (`SCATTER`) after the law of speed."""
    errors = list(held_out(measure_slides([fabric(folder, "denim", key) for key in FABRICS])))
    assert np.mean(errors) < 3


@pytest.mark.ci
def test_the_program_trains_a_model_that_the_command_converts(folder: Path, tmp_path: Path) -> None:
    environment = os.environ | {"TACTILE_DATA": str(folder)}
    for module, *arguments in (
        ["benchmarks.realism.train", "denim", str(tmp_path / "denim.onnx")],
        ["tactile", "convert", str(tmp_path / "denim.onnx"), str(tmp_path / "denim.toml")],
    ):
        done = subprocess.run(
            [sys.executable, "-m", module, *arguments],
            cwd=Path(__file__).parents[1], env=environment, capture_output=True, text=True,
            timeout=600, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert "dB rms from the model" in done.stdout
    assert (tmp_path / "denim.toml").exists()


@pytest.mark.ci
def test_the_program_refuses_an_unknown_fabric_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "biotac").mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.realism.train", "denims", str(tmp_path / "x.onnx")],
        cwd=Path(__file__).parents[1], env=os.environ | {"TACTILE_DATA": str(tmp_path)},
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "'denims': did you mean 'denim'?" in done.stderr
