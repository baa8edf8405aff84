"""Optimization against brute force, closed forms and random numbers of the tests' own."""

import functools
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import tip_response
from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.study.criteria import Conditions
from tactile.study.optimizing import Task, attained, find_designs, judge
from tactile.study.parameters import load_of_firmness
from tactile.study.recommending import bulges, recommend
from tactile.study.scenarios import TOLERANCES, draw_scenarios
from tactile.study.sweep import Study, solve_study

BAND = Conditions(band=(10.0, 1000.0))
AT_REST = Conditions(band=(0.0, 0.1))
LENGTHS, WIDTHS = (8.0, 40.0), (1.0, 6.0)
WISHES = ("attainable", "footprint")
LOSSLESS = replace(
    Bimorph(),
    clamped_length=0.0,
    piezo=replace(Bimorph().piezo, piezo_loss_tangent=0.0, quality_factor=1e9),
    shim=replace(Bimorph().shim, quality_factor=1e9),
)


@functools.cache
def nominal_front() -> xarray.Dataset:
    """Return the front of attainable shear against footprint under the low finger."""
    return find_designs(
        Task(
            bounds={"length_mm": LENGTHS, "width_mm": WIDTHS},
            objectives=WISHES,
            fixed={"load": "low"},
            conditions=BAND,
        )
    )


@functools.cache
def grid() -> Floats:
    """Return attainable shear and footprint (N, 2) of a dense grid, by a sweep."""
    study = Study(
        axes={"length_mm": np.linspace(*LENGTHS, 65), "width_mm": np.linspace(*WIDTHS, 51)},
        fixed={"load": "low"},
        frequency=np.linspace(10, 1000, 40),
        criteria=WISHES,
        conditions=BAND,
    )
    data = solve_study(study)
    pairs = xarray.broadcast(data["attainable_um"], data["footprint_mm2"])
    return np.stack([values.values.ravel() for values in pairs], axis=-1)


def objectives_of(front: xarray.Dataset) -> Floats:
    return np.stack([front["attainable_um"].values, front["footprint_mm2"].values], axis=-1)


def area(points: Floats, corner: tuple[float, float]) -> float:
    """Return the area that points (more, less) dominate down to a corner, strip by strip."""
    total, reached = 0.0, corner[0]
    for more, less in sorted(map(tuple, points), key=lambda p: (p[1], -p[0])):
        if more > reached and less < corner[1]:
            total += (more - reached) * (corner[1] - less)
            reached = more
    return total


def test_a_front_dominates_as_much_as_a_dense_grid() -> None:
    corner = (0.0, float(grid()[:, 1].max()) * 1.1)
    assert area(objectives_of(nominal_front()), corner) >= 0.99 * area(grid(), corner)


def test_no_design_of_a_front_is_beaten_by_a_grid_by_more_than_two_percent() -> None:
    more, less = grid().T
    for shear, footprint in objectives_of(nominal_front()):
        assert not np.any((more > 1.02 * shear) & (less < footprint / 1.02))


def test_no_design_of_a_front_beats_another() -> None:
    shear, footprint = objectives_of(nominal_front()).T
    beats = (shear[:, None] > shear) & (footprint[:, None] <= footprint)
    assert not beats.any()
    assert np.all(np.diff(shear) <= 0), "the best of the first objective comes first"


@pytest.mark.ci
def test_a_front_reaches_as_far_as_each_objective_does_alone() -> None:
    """A third number makes room that NSGA-II by itself enters last: it falls 0.7 % short there."""
    task = Task(
        bounds={"length_mm": LENGTHS, "width_mm": WIDTHS, "piezo_height_mm": (0.12, 0.4)},
        objectives=WISHES,
        fixed={"load": "low"},
        conditions=BAND,
    )
    alone = find_designs(replace(task, objectives=WISHES[:1]))
    front = find_designs(task)
    assert float(front.attainable_um.max()) >= 0.999 * float(alone.attainable_um[0])
    assert float(front.footprint_mm2.min()) == pytest.approx(1.0 * (2 * 0.12 + 0.2))


def test_more_generations_never_lose_what_was_dominated() -> None:
    """The population holds twice what is bred, so that losses by thinning stay below 1 %."""
    volume = nominal_front()["hypervolume"].values
    assert np.all(np.diff(volume) > -0.01)
    assert volume[-1] > volume[0]
    assert volume[-1] - volume[-10] < 0.01, "it has converged"


def test_the_default_frequencies_suffice() -> None:
    assert nominal_front().attrs["sampling_error"] < 1e-3


@pytest.mark.ci
def test_coarse_frequencies_are_told_of() -> None:
    """Three points over the resonance of a bender in air see neither its top nor its foot."""
    task = Task(
        bounds={"length_mm": (15.0, 25.0)},
        objectives=("mean_displacement",),
        fixed={"load": "none"},
        frequency=[10.0, 505.0, 1000.0],
        conditions=BAND,
    )
    assert find_designs(task).attrs["sampling_error"] > 0.1


@pytest.mark.ci
def test_the_same_seed_finds_the_same_designs() -> None:
    task = Task(bounds={"length_mm": LENGTHS}, objectives=("standing", "blocked_force"), seed=3)
    first, second = find_designs(task), find_designs(task)
    xarray.testing.assert_equal(first, second)


@pytest.mark.parametrize("load", ["low", "high"])
def test_one_objective_ends_where_a_sweep_has_its_best(load: str) -> None:
    lengths = np.arange(8, 40.01, 0.25)
    frequency = np.linspace(10, 1000, 32)
    fixed = {"load": load}
    task = Task(
        bounds={"length_mm": LENGTHS},
        objectives=("attainable",),
        fixed=fixed,
        frequency=frequency,
        conditions=BAND,
    )
    found = find_designs(task)
    swept = solve_study(
        Study(
            axes={"length_mm": lengths},
            fixed=fixed,
            frequency=frequency,
            criteria=("attainable",),
            conditions=BAND,
        )
    )["attainable_um"].values
    assert abs(float(found["length_mm"][0]) - lengths[swept.argmax()]) <= 0.25
    assert float(found["attainable_um"][0]) >= swept.max()
    assert float(found["attainable_um"][0]) == pytest.approx(swept.max(), rel=5e-3)


def test_a_limit_is_kept_and_binds() -> None:
    """Shear grows with length up to 25 mm, so that 20 mm of standing length (5 clamped) is met."""
    task = Task(
        bounds={"length_mm": LENGTHS},
        objectives=("attainable",),
        fixed={"load": "low"},
        limits={"standing": (-np.inf, 20.0)},
        conditions=BAND,
    )
    best = find_designs(task)
    assert float(best["standing_mm"][0]) <= 20.0
    assert float(best["length_mm"][0]) == pytest.approx(15.0, rel=1e-4)


# Closed forms


@pytest.mark.ci
def test_two_layers_at_rest_follow_the_closed_form_all_along_the_front() -> None:
    """Shear depends on length as u = 3 d31 L²/(4 h²) per volt, without shim, load and losses."""
    height = 0.3
    task = Task(
        bounds={"length_mm": LENGTHS},
        objectives=("smallest_displacement", "standing"),
        fixed={"shim_height_mm": 0.0, "piezo_height_mm": height},
        conditions=AT_REST,
        base=LOSSLESS,
    )
    front = find_designs(task)
    length = front["standing_mm"].values
    expected = 3 / 4 * 320e-12 * (length / height) ** 2 * 1e6
    assert front["smallest_displacement_um_per_v"].values == pytest.approx(expected, rel=1e-5)
    assert length.min() < 8.5
    assert length.max() > 39.5


@pytest.mark.ci
def test_shear_against_footprint_follows_a_spring_and_a_cantilever() -> None:
    """Shear per volt is u0 k/(k + k0), 1/k = l³/3EI + l/AG, with EI and AG as the width."""
    length, height = 20e-3, 0.3e-3
    task = Task(
        bounds={"width_mm": WIDTHS},
        objectives=("smallest_displacement", "footprint"),
        fixed={"shim_height_mm": 0.0, "piezo_height_mm": height * 1e3, "load": "high"},
        conditions=AT_REST,
        base=LOSSLESS,
    )
    front = find_designs(task)
    width = front["footprint_mm2"].values * 1e-6 / (2 * height)
    p = Bimorph().piezo
    bending = width * (2 * height) ** 3 / 12 / p.s11E
    shear = 5 / 6 * width * 2 * height / p.s55E
    spring = 1 / (length**3 / (3 * bending) + length / shear)
    free = 3 / 4 * 320e-12 * (length / height) ** 2
    expected = free * spring / (spring + FingerLoad.high().k0) * 1e6
    assert front["smallest_displacement_um_per_v"].values == pytest.approx(expected, rel=1e-4)
    assert np.ptp(width) > 0.98 * 5e-3


# Fingers and tolerances


@pytest.mark.ci
def test_a_robust_figure_is_that_of_random_fingers_and_parts() -> None:
    """Independent draws are the reference, up to the error of a quantile of as many scenarios."""
    count, draws, share = 256, 4000, 0.9
    scenarios = draw_scenarios(count)
    task = Task(
        bounds={"length_mm": LENGTHS},
        objectives=("attainable",),
        conditions=BAND,
        scenarios=scenarios,
        share=share,
    )
    ours = float(attained(judge(task, np.array([[20.0]]))["attainable"], share, 1)[0])
    rng = np.random.default_rng(42)
    random = {name: 1 + spread * rng.standard_normal(draws) for name, spread in TOLERANCES.items()}
    b = Bimorph()
    bender = replace(
        b,
        piezo_height=b.piezo_height * random["piezo_height_mm"],
        shim_height=b.shim_height * random["shim_height_mm"],
        piezo=replace(
            b.piezo,
            s11E=b.piezo.s11E / random["piezo_modulus_gpa"],
            d31=b.piezo.d31 * random["d31_pm_per_v"],
        ),
        shim=replace(b.shim, s11=b.shim.s11 / random["shim_modulus_gpa"]),
    )
    finger = load_of_firmness(rng.normal(0.5, 0.5, draws))
    size = np.abs(tip_response(bender, finger, np.linspace(10, 1000, 32)).displacement)
    attainable = 100e6 * size.min(axis=-1)
    theirs = float(np.quantile(attainable, 0.1))
    again = rng.choice(attainable, (400, count))
    error = float(np.quantile(again, 0.1, axis=1).std())
    assert abs(ours - theirs) < 2 * error
    assert error < 0.1 * theirs, "else it would prove nothing"


def test_what_a_share_attains_is_the_low_end_of_more_and_the_high_end_of_less() -> None:
    """The k-th lowest of n draws has k/(n + 1) below it on average (Weibull): 1.2, 10.8 of 11."""
    values = np.arange(11.0)[None]
    assert attained(values, 0.9, 1) == pytest.approx([0.2])
    assert attained(values, 0.9, -1) == pytest.approx([9.8])
    assert np.isfinite(attained(np.array([[1.0, np.inf]]), 0.9, -1)).all()


def test_a_robust_optimum_attains_less_than_the_middle_and_says_both() -> None:
    task = Task(
        bounds={"length_mm": LENGTHS},
        objectives=("attainable",),
        frequency=np.linspace(10, 1000, 9),
        conditions=BAND,
        scenarios=draw_scenarios(16),
    )
    best = find_designs(task)
    assert float(best["robust_attainable_um"][0]) < 0.8 * float(best["attainable_um"][0])
    assert best.attrs["objectives"] == "robust_attainable_um"
    assert (best.attrs["scenarios"], best.attrs["share"]) == (16, 0.9)
    assert "in the middle" in recommend(best).words


@pytest.mark.parametrize("count", [4, 64])
def test_what_unseen_fingers_lose_is_that_of_a_sweep_of_their_own(count: int) -> None:
    """A few fingers make an optimum that others do not have; many tell the truth."""
    unseen = draw_scenarios(256, seed=8)
    task = Task(
        bounds={"length_mm": (12.0, 30.0)},
        objectives=("attainable",),
        frequency=np.linspace(10, 1000, 9),
        conditions=BAND,
        scenarios=draw_scenarios(count, seed=7),
        unseen=unseen,
    )
    best = find_designs(task)
    study = Study(
        axes={"length_mm": best.length_mm.values}, frequency=task.frequency,
        criteria=("attainable",), conditions=BAND, scenarios=unseen,
    )  # fmt: skip
    swept = float(attained_by_90(solve_study(study)["attainable_um"].values[0]))
    loss = 1 - swept / float(best["robust_attainable_um"][0])
    assert best.attrs["unseen_loss"] == pytest.approx(loss, rel=1e-9, abs=1e-12)
    assert abs(loss) < 0.06 if count == 64 else loss > 0.06


def attained_by_90(values: Floats) -> float:
    """Return the 10 % quantile after Weibull: at place 0.1 (n + 1) of n in order, from 1 on."""
    place = 0.1 * (len(values) + 1) - 1
    return float(np.interp(place, np.arange(len(values)), np.sort(values)))


# What is recommended


def test_the_knee_of_a_hyperbola_is_where_it_lies_farthest_from_its_chord() -> None:
    """The chord of y = 1/x from 1/4 to 4 has slope −1, and so has the curve at x = 1."""
    x = np.geomspace(0.25, 4, 401)
    front = xarray.Dataset(
        {
            "drive_v": ("design", x, {"units": "V", "criterion": "drive"}),
            "footprint_mm2": ("design", 1 / x, {"units": "mm²", "criterion": "footprint"}),
        },
        coords={"length_mm": ("design", x * 10)},
        attrs={"objectives": "drive_v footprint_mm2"},
    )
    advice = recommend(front)
    assert x[advice.place] == pytest.approx(1)
    assert advice.words == (
        "free length 10 mm: drive 1 V and footprint 1 mm². "
        "Against the best in drive (free length 2.5 mm) it has 4 times the drive and "
        "75% less footprint. "
        "Against the best in footprint (free length 40 mm) it has 75% less drive and "
        "4 times the footprint."
    )


def straight_front(bend: float) -> xarray.Dataset:
    """Return a front y = 1 − x that is bent toward the ideal point by a share of its range."""
    x = np.linspace(0, 1, 101)
    y = 1 - x - bend * 4 * x * (1 - x)
    return xarray.Dataset(
        {
            "drive_v": ("design", 1 + x, {"units": "V", "criterion": "drive"}),
            "footprint_mm2": ("design", 1 + y, {"units": "mm²", "criterion": "footprint"}),
        },
        coords={"length_mm": ("design", 10 + x)},
        attrs={"objectives": "drive_v footprint_mm2"},
    )


@pytest.mark.parametrize(("bend", "place"), [(0.0, None), (0.09, None), (0.11, 50)])
def test_a_front_that_is_nearly_straight_has_no_knee(bend: float, place: int | None) -> None:
    advice = recommend(straight_front(bend))
    assert advice.place == place
    if place is None:
        assert advice.words.startswith("No design is recommended")
        assert "Best in footprint is free length 11 mm: drive 2 V and footprint 1 mm²." in (
            advice.words
        )


def test_bulges_of_three_objectives_are_distances_from_the_plane_through_the_ends() -> None:
    """The plane through (0, 1, 1), (1, 0, 1) and (1, 1, 0) is x + y + z = 2."""
    scaled = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0], [1 / 3] * 3, [2 / 3] * 3])
    assert bulges(scaled) == pytest.approx([0, 0, 0, 0.5, 0])


# Bad input


def test_without_xarray_the_extra_is_named_before_anything_is_searched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def progress(done: int, total: int) -> None:
        raise AssertionError("the search began")

    monkeypatch.setitem(sys.modules, "xarray", None)
    task = Task(
        bounds={"length_mm": (8.0, 40.0)}, objectives=("attainable",),
        conditions=Conditions(band=(10.0, 1000.0)), fixed={"load": "low"},
    )  # fmt: skip
    with pytest.raises(InputError, match=r"an optimization needs xarray: pip install"):
        find_designs(task, progress)


BOUNDS = {"length_mm": LENGTHS}
BAD: dict[str, dict[str, Any]] = {
    "length_mm = 40:8: bounds must be finite and ascend": {"bounds": {"length_mm": (40.0, 8.0)}},
    "length_mm = 8:inf: bounds must be finite": {"bounds": {"length_mm": (8.0, np.inf)}},
    "length_mm = 300: must be 0.5 … 200 mm": {"bounds": {"length_mm": (8.0, 300.0)}},
    "no numerical parameter 'lenght_mm'; did you mean": {"bounds": {"lenght_mm": (8, 9)}},
    "nothing may vary": {"bounds": {}},
    "length_mm: is fixed and has bounds": {"fixed": {"length_mm": 20.0}},
    "no criterion 'footprnt' as objective; did you mean 'footprint'": {"objectives": ("footprnt",)},
    "objective footprint: is given twice": {"objectives": ("footprint", "footprint")},
    "objective first_resonance: neither more nor less": {"objectives": ("first_resonance",)},
    "4 objectives: must be 1 … 3": {"objectives": ("drive", "current", "shaping", "footprint")},
    "no criterion 'drives' as limit; did you mean 'drive'": {"limits": {"drives": (0, 1)}},
    "limit drive = 9:3: must ascend": {"limits": {"drive": (9.0, 3.0)}},
    "share = 1.5: must be above 0 and below 1": {"share": 1.5},
    "load = 'low': the scenarios draw the finger": {
        "fixed": {"load": "low"},
        "scenarios": draw_scenarios(4),
    },
    "attainable: needs a band": {"objectives": ("attainable",)},
    "lies beyond the tip": {"fixed": {"measuring_point_mm": 12.0}},
}


@pytest.mark.parametrize("line", BAD)
def test_what_cannot_be_asked_is_one_clear_line(line: str) -> None:
    with pytest.raises(InputError) as error:
        Task(**{"bounds": BOUNDS, "objectives": ("footprint",), **BAD[line]})
    assert line in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("objectives", [("footprint",), pytest.param(WISHES, marks=pytest.mark.ci)])
def test_a_limit_that_nothing_meets_comes_with_the_nearest(objectives: tuple[str, ...]) -> None:
    """The standing length is the free length and 5 mm of clamp, at least 13 mm."""
    task = Task(
        bounds=BOUNDS,
        objectives=objectives,
        fixed={"load": "low"},
        limits={"standing": (-np.inf, 10.0)},
        frequency=[10.0, 1000.0],
        conditions=BAND,
    )
    message = r"standing ≤ 10 mm: no design .* meets it; the nearest has 13(\.\d+)? mm"
    with pytest.raises(InputError, match=message):
        find_designs(task)
