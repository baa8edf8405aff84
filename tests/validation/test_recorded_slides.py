"""Tests of the promises of the benchmark about fits of recorded slides.

BioTac on 12 materials (Gao, Taunyazov, Lin & Wu, IROS 2020), a bare finger on denim and corduroy
(Fradin, Haliyo & Gueorguiev, World Haptics 2023). The recordings state no licence and are not
shipped.
"""

import os
from pathlib import Path

import pytest

from benchmarks import fit
from tactile.bench.figures import Figure
from tactile.texture.fitting import measure_slides

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def folder() -> Path:
    found = fit.recordings()
    if found is None:
        assert os.environ.get("CI") != "true", "the recordings are missing"
        pytest.skip("the recordings are missing: they may not be shipped with the project")
    return found


@pytest.fixture(scope="module")
def figures(folder: Path) -> dict[str, Figure]:
    """Return what the benchmark measures of them."""
    return {figure.name: figure for figure in fit.measure_fit()}


def test_biotac_slides_are_met_and_told_apart_on_the_half_that_was_held_out(
    folder: Path, figures: dict[str, Figure]
) -> None:
    assert len(fit.biotac(folder)) == 12
    assert figures["fit.biotac.held_out"].value <= 1.0, "the goal; 1.4 was to be reached"
    assert figures["fit.biotac.identified_share"].reached
    assert figures["fit.biotac.identified_recordings"].value > 0.8, "chance is 1 of 12"
    assert figures["fit.biotac.autoregressive"].value > figures["fit.biotac.held_out"].value


def test_fabrics_fitted_at_two_speeds_are_rendered_as_they_are_at_others(
    figures: dict[str, Figure],
) -> None:
    """Strokes are within 3.1 dB of recordings at twice the speed, and at half of it.

    One recording predicts another one, by the exact law, within 3.3 dB.
    """
    for way in ("faster", "slower"):
        assert figures[f"fit.fabrics.{way}.absolute"].reached
        assert figures[f"fit.fabrics.{way}.bias"].reached


def test_the_hum_of_a_robot_at_one_speed_is_no_rib(figures: dict[str, Figure]) -> None:
    """Ten lines of these materials lie at 560–610 Hz, whatever the material."""
    assert figures["fit.biotac.with_gratings"].value == 0


@pytest.mark.parametrize("name", fit.FABRIC_NAMES)
def test_no_rib_of_a_fabric_stands_out_and_none_is_made_up(folder: Path, name: str) -> None:
    """Spectra of whole strokes at four speeds share no line; no pitch of theirs is published."""
    recordings = [fit.fabric(folder, name, key) for key in fit.FABRICS]
    assert measure_slides(recordings, reference_speed=0.04).gratings == []
