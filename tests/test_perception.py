"""What is felt: thresholds against the published table, levels against arithmetic."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest

from tactile.arrays import Floats
from tactile.texture.perception import (
    EDGES,
    TOUCH_CHANNELS,
    band_of,
    band_sensation,
    channel_sensation,
    detection_threshold,
    felt_level,
)

TABLE = Path(__file__).parents[2] / "shared" / "data" / "perception_thresholds.csv"
ROUNDED = 5e-3
"""Relative error: the table has three digits."""
CENTERS = 10 ** (np.arange(32) / 10)
"""Center frequencies of the third octaves from 1 Hz to 1 kHz, and one above (IEC 61260-1) [Hz]."""


def line(frequency: float, db_above: float) -> tuple[Floats, Floats]:
    """Return a sinusoid some dB above the threshold, as a spectrum of one line."""
    peak = detection_threshold(np.array([frequency])) * 10 ** (db_above / 20)
    return np.array([frequency]), peak**2 / 2


def published() -> tuple[Floats, Floats]:
    """Return the table's frequencies [Hz] and peaks along the normal [m]."""
    if not TABLE.is_file():
        assert os.environ.get("CI") != "true", f"{TABLE} is missing"
        pytest.skip(f"{TABLE} is missing: it may not be shipped with the project")
    with TABLE.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    decibels = np.array([float(row["disp_db_re_1um_peak"]) for row in rows])
    return np.array([float(row["f_hz"]) for row in rows]), 1e-6 * 10 ** (decibels / 20)


def test_the_threshold_is_the_published_table_at_its_points() -> None:
    frequency, peak = published()
    np.testing.assert_allclose(detection_threshold(frequency, factor=1.0), peak, rtol=ROUNDED)


def test_midway_between_two_points_it_is_their_geometric_mean() -> None:
    frequency, peak = published()
    middle = np.sqrt(frequency[1:] * frequency[:-1])
    found = detection_threshold(middle, factor=1.0)
    np.testing.assert_allclose(found, np.sqrt(peak[1:] * peak[:-1]), rtol=ROUNDED)


def test_the_threshold_is_that_of_the_literature_without_the_table_too() -> None:
    frequency = np.array([1.0, 10, 20, 40, 63, 100, 160, 250, 400, 500, 630, 800, 1000])
    micro = np.array([25, 8.9, 5, 2.8, 1.5, 0.56, 0.2, 0.1, 0.16, 0.32, 0.67, 1.6, 3.5])
    np.testing.assert_allclose(detection_threshold(frequency, 1.0), micro * 1e-6, rtol=0.02)


def test_below_1_hz_it_is_held_and_above_1_khz_it_goes_on_rising() -> None:
    found = detection_threshold(np.array([0.0, 0.4, 1.0, 1000.0, 1250.0]), factor=1.0)
    np.testing.assert_allclose(found[:3], 25.1e-6)
    assert found[4] / found[3] == pytest.approx(1.25 ** (np.log(3.55 / 1.58) / np.log(1.25)))


def test_tangential_motion_is_felt_at_a_part_of_the_normal() -> None:
    ratio = detection_threshold(CENTERS) / detection_threshold(CENTERS, factor=1.0)
    np.testing.assert_allclose(ratio, (0.3 + 0.6) / 2)  # 0.3 … 0.6: Biggs & Srinivasan 2002


@pytest.mark.parametrize("frequency", [1.3, 20.0, 79.0, 250.0, 900.0])
def test_a_sinusoid_has_its_peak_over_the_threshold_at_its_own_frequency(frequency: float) -> None:
    levels = band_sensation(*line(frequency, 17.0))
    assert levels.max() == pytest.approx(17.0)
    assert np.count_nonzero(np.isfinite(levels)) == 1


def test_noise_has_the_level_of_a_sinusoid_of_its_power() -> None:
    frequency = np.full(1000, 250.0)
    power = np.full(1000, (1e-6) ** 2 / 1000)
    one = band_sensation(np.array([250.0]), np.array([(1e-6) ** 2]))
    np.testing.assert_allclose(band_sensation(frequency, power), one)


def test_every_frequency_is_in_the_third_octave_around_the_nearest_center() -> None:
    frequency = np.geomspace(0.95, 1400, 3000)
    nearest = np.argmin(np.abs(np.log(frequency[:, None] / CENTERS)), axis=1)
    np.testing.assert_array_equal(band_of(frequency), nearest)
    np.testing.assert_allclose(EDGES[1:] / EDGES[:-1], 10**0.1)
    assert set(band_of(np.array([0.0, 0.5, 2000.0])).tolist()) == {len(CENTERS)}


def test_a_channel_adds_the_power_of_bands_above_threshold_and_of_no_other() -> None:
    assert felt_level(np.array([10.0, 10.0, -0.1, -np.inf])) == pytest.approx(10 + 3.0103, abs=1e-4)
    assert felt_level(np.array([-30.0, -4.0])) == -4.0


def test_the_most_sensitive_channel_sets_the_threshold() -> None:
    frequency = np.geomspace(0.4, 1250, 500)
    lowest = np.min([c.threshold(frequency) for c in TOUCH_CHANNELS.values()], axis=0)
    np.testing.assert_allclose(lowest, detection_threshold(frequency))


@pytest.mark.parametrize("name", TOUCH_CHANNELS)
def test_below_1_hz_a_channel_s_threshold_is_held_as_the_whole_s_is(name: str) -> None:
    """All channels have a point of their own at 1 Hz, and none has it twice."""
    channel = TOUCH_CHANNELS[name]
    held = channel.threshold(np.array([0.0, 0.4, 0.9, 1.0]))
    np.testing.assert_allclose(held, held[-1], rtol=1e-12)
    assert channel.knots[0, 0] == 1.0
    assert np.all(np.diff(channel.knots[:, 0]) > 0)


@pytest.mark.parametrize(
    ("name", "low", "high"), [("NP III", 0.4, 4), ("NP I", 4, 40), ("P", 40, 500)]
)
def test_each_channel_is_the_most_sensitive_in_its_published_range(
    name: str, low: float, high: float
) -> None:
    frequency = np.geomspace(low * 1.01, high * 0.99, 100)
    assert np.all(TOUCH_CHANNELS[name].selective_range_db(frequency) > 0)
    assert TOUCH_CHANNELS[name].reaches[0] == low


def test_ruffini_needs_a_high_level_everywhere() -> None:
    frequency = np.geomspace(15, 400, 100)
    assert TOUCH_CHANNELS["NP II"].selective_range_db(frequency).max() < -5


@pytest.mark.parametrize(("name", "slope"), [("P", -12.0), ("NP I", -5.0)])
def test_below_its_range_a_channel_goes_on_at_the_slope_it_has_there(
    name: str, slope: float
) -> None:
    """The table's own slope where the channel begins is within 3 dB per octave of it."""
    channel = TOUCH_CHANNELS[name]
    low = channel.reaches[0]
    below, above = np.diff(20 * np.log10(channel.threshold(low * np.array([0.5, 1.0, 2.0]))))
    assert below == pytest.approx(slope, abs=1e-6)
    assert above == pytest.approx(slope, abs=3.0)


def test_assumed_parts_of_the_curves_are_those_that_their_sources_state() -> None:
    """Peaks along the normal; a factor of four in an octave is 12 dB."""
    at = np.array([40.0, 70.0, 100.0, 200.0, 400.0])
    found = TOUCH_CHANNELS["NP I"].threshold(at, factor=1.0)
    np.testing.assert_allclose(found, 2.82e-6 * np.array([1, 1, 1, 4, 16]), rtol=1e-3)
    held = TOUCH_CHANNELS["NP III"].threshold(at, factor=1.0)
    np.testing.assert_allclose(held, detection_threshold(np.full(5, 4.0), factor=1.0), rtol=1e-9)
    found = TOUCH_CHANNELS["NP II"].threshold(np.array([62.5, 250.0, 500.0]), factor=1.0)
    expected = 3.16e-6 * 10 ** (np.array([10.0, 0.0, 6.0]) / 20)
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_channel_is_alone_up_to_the_threshold_of_the_next() -> None:
    """The range at 250 Hz is 0.1 to 3.16 µm, where the threshold of Ruffini's channel is."""
    at = np.array([250.0])
    assert TOUCH_CHANNELS["P"].selective_range_db(at) == pytest.approx(29.99, abs=0.01)
    assert TOUCH_CHANNELS["NP II"].selective_range_db(at) == pytest.approx(-29.99, abs=0.01)


@pytest.mark.parametrize(
    ("frequency", "level", "felt"),
    [
        (2.0, 2.0, {"NP III"}),
        (20.0, 6.0, {"NP I"}),
        (250.0, 25.0, {"P"}),
        (250.0, 35.0, {"P", "NP II"}),
        (40.0, 1.0, {"P", "NP I"}),
    ],
)
def test_receptors_can_be_excited_one_at_a_time(
    frequency: float, level: float, felt: set[str]
) -> None:
    levels = channel_sensation(*line(frequency, level))
    assert {name for name, found in levels.items() if found > 0} == felt
