"""The finger's way: continuous with its velocity, never beyond its samples, refused where absurd.

Between samples a trajectory is checked by its own values at close times, not by its formula.
"""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError
from tactile.rendering.contact import Trajectory

TIME: Floats = np.array([0.5, 0.6, 0.65, 0.9, 1.0, 1.1])
PLACE: Floats = np.array([[0, 0], [5, 2], [6, 2], [6, 2], [1, 9], [-4, 9]]) * 1e-3
FORCE: Floats = np.array([0.2, 0.5, 0.5, 1.0, 1.0, 0.0])
"""A finger that rests from 0.65 to 0.9 s, and turns round after it."""


def trajectory() -> Trajectory:
    return Trajectory(TIME, PLACE, FORCE)


def values(way: Trajectory, time: Floats) -> Floats:
    """Return x, y and force (S, 3)."""
    position, force = way.at(time)
    return np.column_stack([position, force])


# Between samples


def test_it_passes_through_its_samples() -> None:
    position, force = trajectory().at(TIME)
    np.testing.assert_allclose(position, PLACE, atol=1e-17)
    np.testing.assert_allclose(force, FORCE, atol=1e-15)
    assert trajectory().duration == pytest.approx(0.6)


def test_position_is_continuous_with_its_velocity() -> None:
    """Neither place nor velocity jumps from 1 µs before each sample to 1 µs after it.

    In 1 µs a finger below 1 m/s moves by less than 1 µm. A cubic between samples 50 ms apart has
    accelerations below 10 m/s²: 20 µm/s in 2 µs; a broken line would jump by 10 mm/s and more.
    """
    way, d = trajectory(), 1e-6
    for t in TIME[1:-1]:
        around = values(way, t + d * np.array([-2, -1, 0, 1, 2]))[:, :2]
        assert np.abs(np.diff(around, axis=0)).max() < 1e-6
        before, after = (around[1] - around[0]) / d, (around[4] - around[3]) / d
        assert np.abs(after - before).max() < 1e-4
    knots = np.diff(PLACE, axis=0) / np.diff(TIME)[:, None]
    assert np.abs(np.diff(knots, axis=0)).max() > 10e-3


@settings(max_examples=60)
@given(data=st.data(), count=st.integers(2, 12))
def test_it_never_goes_beyond_the_samples_on_either_side(data: st.DataObject, count: int) -> None:
    """Each coordinate and the force is monotone between two samples, without reversals."""
    steps = data.draw(st.lists(st.floats(0.01, 1), min_size=count - 1, max_size=count - 1))
    time = np.cumsum([data.draw(st.floats(-5, 5)), *steps])
    some = st.lists(st.floats(-0.03, 0.03), min_size=count, max_size=count)  # at most 8.5 m/s
    x, y, force = (np.array(data.draw(some)) for _ in range(3))
    way = Trajectory(time, np.column_stack([x, y]), np.abs(force))
    samples = np.column_stack([x, y, np.abs(force)])
    for (begin, end), (first, last) in zip(pairwise(time), pairwise(samples), strict=True):
        between = values(way, np.linspace(begin, end, 40))
        assert np.all(between >= np.minimum(first, last) - 1e-12)
        assert np.all(between <= np.maximum(first, last) + 1e-12)
        way_there = np.diff(between, axis=0) * np.sign(last - first)
        assert np.all(way_there >= -1e-12)


@pytest.mark.parametrize("force", [5e-324, 2.2e-313])
def test_forces_below_all_normal_numbers_are_taken_without_a_warning(force: float) -> None:
    """The slopes of such forces have no finite inverse in double precision."""
    way = Trajectory(TIME[:3], np.zeros((3, 2)), [0.0, 0.0, force])
    _, between = way.at(np.linspace(TIME[0], TIME[2], 50))
    assert np.all((between >= 0) & (between <= force))


def test_a_finger_that_rests_stays_at_rest() -> None:
    """The place stays the same to the last bit: any movement would sound."""
    position, _ = trajectory().at(np.linspace(0.65, 0.9, 1001))
    assert np.all(position == PLACE[2])


def test_a_steady_stroke_is_steady() -> None:
    """Samples on a line at irregular times give the line, to rounding."""
    way = Trajectory(TIME, np.outer(TIME, [0.04, -0.01]), 0.5)
    t = np.linspace(0.5, 1.1, 777)
    position, force = way.at(t)
    np.testing.assert_allclose(position, np.outer(t, [0.04, -0.01]), atol=1e-15)
    assert np.all(force == 0.5)


def test_any_shape_of_times_is_answered_in_kind() -> None:
    position, force = trajectory().at(0.55)
    assert position.shape == (2,)
    assert force.shape == ()
    position, force = trajectory().at(np.full((3, 4), 2.0))
    assert position.shape == (3, 4, 2)
    assert force.shape == (3, 4)


# Beyond its ends


def test_beyond_either_end_the_finger_goes_on_as_it_was_and_its_force_is_held() -> None:
    """The finger goes on straight, at the velocity that the last (first) microsecond had."""
    way, d = trajectory(), 1e-7
    for end, inward in ((0.5, 1), (1.1, -1)):
        at_end, inside = values(way, np.array([end, end + inward * d]))
        velocity = (inside - at_end)[:2] / (inward * d)
        for away in (1e-3, 0.1, 3.0):
            position, force = way.at(end - inward * away)
            expected = at_end[:2] - inward * away * velocity
            np.testing.assert_allclose(position, expected, atol=1e-5 * away)
            assert force == at_end[2]
    assert np.linalg.norm(way.at(2.1)[0] - PLACE[-1]) > 1e-3


def test_velocity_is_how_position_changes_with_time_also_beyond_the_ends() -> None:
    """Differences over 2 µs bend by less than 1e-10 m/s, 1 ms and more away from samples."""
    way, d = trajectory(), 1e-6
    t = np.concatenate([np.linspace(0.501, 1.099, 60), [0.0, 0.4, 1.2, 5.0]])
    ahead, behind = way.at(t + d)[0], way.at(t - d)[0]
    np.testing.assert_allclose(way.velocity(t), (ahead - behind) / (2 * d), atol=1e-9)
    assert np.array_equal(way.velocity(7.0), way.velocity(1.1))
    assert np.all(way.velocity(np.linspace(0.65, 0.9, 11)) == 0)
    assert np.linalg.norm(way.velocity(0.55)) > 10e-3


# Strokes


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0])
def test_a_line_is_a_straight_stroke_from_the_origin(angle: float) -> None:
    way = Trajectory.line(speed=0.08, angle=angle, duration=2.5, normal_force=0.7)
    t = np.linspace(-1, 4, 101)
    position, force = way.at(t)
    np.testing.assert_allclose(
        position, 0.08 * np.outer(t, [math.cos(angle), math.sin(angle)]), atol=1e-15
    )
    assert np.all(force == 0.7)
    assert way.duration == 2.5


@pytest.mark.parametrize(
    ("rate", "size", "extra", "count"),
    [
        (8000.0, 64, 0, 4800),  # 0.6 s
        (8000.0, 64, 16, 4816),
        (8000.0, 7, 3, 4803),
        (8000.0, 10_000, 0, 4800),
        (44_100.0, 1000, 1, 26_461),
        (1000.5, 1, 0, 600),  # 600.3
        (999.5, 50, 0, 600),  # 599.7
    ],
)
def test_blocks_cover_the_duration_and_the_extra_samples_exactly(
    rate: float, size: int, extra: int, count: int
) -> None:
    """Sample k is at time[0] + k/fs in blocks of any size; the finger goes on after the end."""
    blocks = list(trajectory().blocks(rate, size, extra=extra))
    lengths = [len(force) for _, force in blocks]
    assert sum(lengths) == count
    assert all(n == size for n in lengths[:-1])
    assert 1 <= lengths[-1] <= size
    played = np.concatenate([np.column_stack(block) for block in blocks])
    np.testing.assert_array_equal(played, values(trajectory(), 0.5 + np.arange(count) / rate))


# What is refused

NAN_PLACE = PLACE.copy()
NAN_PLACE[3, 1] = math.nan
BACK = TIME.copy()
BACK[2] = 0.55
TWICE = TIME.copy()
TWICE[2] = 0.6


@pytest.mark.parametrize(
    ("time", "position", "force", "words"),
    [
        (BACK, PLACE, FORCE, ("time, sample 3", "0.55 s after 0.6 s", "must ascend")),
        (TWICE, PLACE, FORCE, ("time, sample 3", "0.6 s after 0.6 s", "must ascend")),
        (TIME * math.nan, PLACE, FORCE, ("time, sample 1", "finite")),
        (TIME, NAN_PLACE, FORCE, ("position, sample 4", "finite")),
        (TIME, PLACE, FORCE / 0.5 + math.inf, ("normal_force, sample 1", "finite")),
        (TIME, PLACE, -0.1, ("normal_force -0.1 N", "0 … 50 N")),
        (TIME, PLACE, 51.0, ("normal_force 51 N", "0 … 50 N")),
        (TIME, PLACE * 1e3, FORCE, ("position", "9 m", "86.0233 m/s", "10 m/s", "millimeters?")),
        (TIME * 1e5, PLACE * 1e6, FORCE, ("position", "9000 m", "millimeters?")),
        (TIME / 1e3, PLACE, FORCE, ("m/s", "10 m/s")),
        (TIME[:1], PLACE[:1], FORCE[:1], ("needs time (T,) and position (T, 2) with T ≥ 2",)),
        (TIME, PLACE[:5], FORCE, ("needs time (T,) and position (T, 2)",)),
        (TIME, PLACE[:, :1], FORCE, ("needs time (T,) and position (T, 2)",)),
        (TIME[None], PLACE, 0.5, ("needs time (T,) and position (T, 2)",)),
        (TIME, PLACE, FORCE[:3], ("normal_force", "as many as time")),
    ],
    ids=[
        "time backwards", "time twice", "time NaN", "position NaN", "force infinite",
        "force negative", "force too large", "position in millimeters, too fast",
        "position in millimeters, too far", "time in kiloseconds, too fast", "one sample",
        "fewer positions", "positions of one axis", "time of two axes", "fewer forces",
    ],
)  # fmt: skip
def test_samples_that_are_no_way_of_a_finger_are_refused_in_one_line(
    time: Floats, position: Floats, force: Floats | float, words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        Trajectory(time, position, force)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("far", [1e160, 1e300], ids=["its square overflows", "beyond reason"])
def test_a_place_beyond_reason_is_refused_without_a_warning(far: float) -> None:
    """A warning is an error in tests."""
    with pytest.raises(InputError, match="position: reaches"):
        Trajectory([0.0, 1.0], [[0.0, 0.0], [far, 0.0]], 0.5)


HEADER = "time_s,x_mm,y_mm,normal_force_n\n"


def test_a_table_is_read_in_its_units(tmp_path: Path) -> None:
    """Columns may stand in any order; millimeters become meters."""
    path = tmp_path / "way.csv"
    path.write_text("x_mm,note,y_mm,normal_force_n,time_s\n0,a,1,0.5,10\n40,b,-1,0.75,11\n")
    way = Trajectory.from_csv(path)
    np.testing.assert_array_equal(way.time, [10, 11])
    np.testing.assert_allclose(way.position, [[0, 1e-3], [40e-3, -1e-3]])
    np.testing.assert_array_equal(way.normal_force, [0.5, 0.75])
    assert Trajectory.from_csv(str(path)).duration == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEADER + "0,0,0,1\n1,1,0,1\n0.5,2,0,1\n", ("time, sample 3", "0.5 s after 1 s", "ascend")),
        (HEADER + "0,0,0,1\n1,nan,0,1\n", ("line 3", "x_mm = 'nan'", "finite")),
        (HEADER + "0,0,0,1\n1,0,inf,1\n", ("line 3", "y_mm = 'inf'", "finite")),
        (HEADER + "0,0,0,1\n1,0,0,hard\n", ("line 3", "normal_force_n = 'hard'", "finite")),
        (HEADER + "0,0,0,1\n1,0,0\n", ("line 3", "normal_force_n = None", "finite")),
        ("time_s,x_m,y_m,normal_force_n\n0,0,0,1\n", ("no column 'x_mm'", "did you mean 'x_m'?")),
        ("time_s,x_mm,y_mm\n0,0,0\n1,0,0\n", ("no column 'normal_force_n'",)),
        (HEADER, ("has 0 rows", "at least 2")),
        (HEADER + "0,0,0,1\n", ("has 1 rows", "at least 2")),
        (HEADER + "0,0,0,1\n1,0,0,500\n", ("normal_force 500 N", "0 … 50 N")),
        (HEADER + "0,0,0,1\n1,0,0,-1\n", ("normal_force -1 N", "0 … 50 N")),
        (HEADER + "0,0,0,1\n1,40000,0,1\n", ("position", "40 m", "40 m/s", "10 m/s")),
        (HEADER + "0,0,0,1\n0.001,40,0,1\n", ("position", "40 m/s", "10 m/s")),
    ],
    ids=[
        "time backwards", "not a number", "infinite", "text", "a cell missing", "meters",
        "a column missing", "nothing", "one row", "force in grams", "force negative",
        "position in micrometers", "time in kiloseconds",
    ],
)  # fmt: skip
def test_a_table_that_is_no_way_of_a_finger_is_refused_with_its_name(
    tmp_path: Path, text: str, words: tuple[str, ...]
) -> None:
    path = tmp_path / "way.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Trajectory.from_csv(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_table_that_is_missing_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"none\.csv: no such file"):
        Trajectory.from_csv(tmp_path / "none.csv")
