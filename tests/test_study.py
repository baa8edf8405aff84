"""Sweeps of a design: what may be asked, how it is cut and solved, and what the answer carries.

The numbers are compared with the independent finite elements of `reference_beam` and with closed
forms; `tests/validation` compares them with the paper.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
import reference_beam as reference
import xarray
from hypothesis import given
from hypothesis import strategies as st

from tactile.actuator.bimorph import Bimorph, section
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import PIEZOS, SHIMS
from tactile.actuator.resonance import first_resonance
from tactile.actuator.response import tip_response
from tactile.errors import InputError
from tactile.study import sweep as sweeps
from tactile.study.criteria import CRITERIA, Conditions, variable
from tactile.study.parameters import (
    FINGERS,
    PARAMETERS,
    check_value,
    load_of_firmness,
    specimen,
    standard_value,
)
from tactile.study.ranges import Range, overlap, within
from tactile.study.scenarios import Scenarios, draw_scenarios
from tactile.study.sweep import RESPONSES, Study, blocks, solve_block, solve_study, variables

BAND = Conditions(band=(0.0, 1000.0))
FREQUENCY = np.arange(0.0, 1001.0, 50.0)
TOLERANCES = {
    "piezo_height_mm": 0.02, "shim_height_mm": 0.03, "piezo_modulus_gpa": 0.03,
    "shim_modulus_gpa": 0.05, "d31_pm_per_v": 0.05, "eps33t_relative": 0.07,
}  # fmt: skip
"""Relative standard deviations: a third of the limits of data sheets, which give 10 to 20 % for d31
and eps33T and 5 to 10 % for compliance; heights are those of lapped plates and prepreg."""


def study(**changes: Any) -> Study:
    asked: dict[str, Any] = {
        "axes": {"length_mm": [12.0, 20.0, 28.0], "load": ["low", "high"]},
        "frequency": FREQUENCY,
        "criteria": ("smallest_displacement",),
        "conditions": BAND,
    }
    return Study(**(asked | changes))


# Against finite elements

VARIED: dict[str, tuple[float, Callable[[float], dict[str, float]]]] = {
    "length_mm": (14.0, lambda v: {"length": v * 1e-3}),
    "width_mm": (3.7, lambda v: {"width": v * 1e-3}),
    "clamped_length_mm": (7.0, lambda v: {"clamped_length": v * 1e-3}),
    "piezo_height_mm": (0.19, lambda v: {"piezo_height": v * 1e-3}),
    "shim_height_mm": (0.31, lambda v: {"shim_height": v * 1e-3}),
    "shim_modulus_gpa": (70.0, lambda v: {"shim_s11": 1e-9 / v}),
    "shim_shear_modulus_gpa": (9.0, lambda v: {"shim_s55": 1e-9 / v}),
    "shim_density_kg_m3": (4000.0, lambda v: {"shim_density": v}),
    "shim_quality": (12.0, lambda v: {"shim_quality": v}),
    "piezo_modulus_gpa": (75.0, lambda v: {"s11E": 1e-9 / v}),
    "piezo_density_kg_m3": (7000.0, lambda v: {"piezo_density": v}),
    "piezo_quality": (200.0, lambda v: {"piezo_quality": v}),
    "d31_pm_per_v": (-180.0, lambda v: {"d31": v * 1e-12}),
    "eps33t_relative": (2500.0, lambda v: {"eps33T": v * reference.VACUUM_PERMITTIVITY}),
}


@pytest.mark.parametrize("name", VARIED)
def test_a_parameter_is_what_its_name_and_unit_say(name: str) -> None:
    value, meant = VARIED[name]
    found = solve_study(
        study(axes={name: [value]}, fixed={"load": "low"}, responses=("displacement", "admittance"))
    )
    fem = reference.response(
        reference.Beam(**meant(value)), np.array(FREQUENCY[1:]), load=reference.LOW_FINGER
    )
    ours = found.displacement_um_per_v.values[0, 1:]
    current = found.admittance_us.values[0, 1:]
    assert np.abs(ours / (fem.displacement * 1e6) - 1).max() < 1e-6
    assert np.abs(current / (fem.admittance * 1e6) - 1).max() < 1e-6


def test_curves_of_a_pressed_bender_at_a_point_are_those_of_finite_elements() -> None:
    fixed = {"load": "high", "axial_force_n": -0.4, "measuring_point_mm": 13.0}
    found = solve_study(
        study(axes={"length_mm": [18.0]}, fixed=fixed, criteria=(), responses=tuple(RESPONSES))
    )
    fem = reference.response(
        reference.Beam(length=18e-3),
        np.array(FREQUENCY[1:]),
        load=reference.HIGH_FINGER,
        axial_force=-0.4,
        point=13e-3,
    )
    rate = 2j * np.pi * FREQUENCY[1:]
    for name, theirs in {
        "displacement_um_per_v": fem.displacement * 1e6,
        "displacement_at_point_um_per_v": fem.at_point * 1e6,
        "velocity_mm_per_s_v": fem.displacement * rate * 1e3,
        "force_mn_per_v": fem.force * 1e3,
        "admittance_us": fem.admittance * 1e6,
    }.items():
        assert np.abs(found[name].values[0, 1:] / theirs - 1).max() < 1e-6, name


def test_criteria_are_those_of_finite_elements() -> None:
    """Each by its definition from the other model's curves, over a band within the frequencies."""
    f = np.arange(5.0, 1500.0, 5.0)
    conditions = Conditions(band=(100.0, 800.0), voltage=60.0, current=0.5e-3, amplitude=4e-6)
    found = solve_study(
        study(axes={"load": ["low"]}, frequency=f, criteria=tuple(CRITERIA), conditions=conditions)
    )
    beam, inside = reference.Beam(), f[(f >= 100) & (f <= 800)]
    fem = reference.response(beam, inside, load=reference.LOW_FINGER)
    size, force, current = (np.abs(x) for x in (fem.displacement, fem.force, fem.admittance))
    held = reference.response(beam, np.array([0.01]), load=(1e12, 0.0, ()))

    def mean(values: Any) -> float:
        return float(((values[1:] + values[:-1]) / 2).mean())

    expected = {
        "smallest_displacement": size.min() * 1e6,
        "mean_displacement": mean(size) * 1e6,
        "rms_displacement": mean(size**2) ** 0.5 * 1e6,
        "db_mean_displacement": 10 ** (mean(20 * np.log10(size)) / 20) * 1e6,
        "smallest_force": force.min() * 1e3,
        "mean_force": mean(force) * 1e3,
        "rms_force": mean(force**2) ** 0.5 * 1e3,
        "db_mean_force": 10 ** (mean(20 * np.log10(force)) / 20) * 1e3,
        "attainable": min(min(60.0, 0.5e-3 / c) * s for s, c in zip(size, current, strict=True))
        * 1e6,
        "drive": 4e-6 / size.min(),
        "field": 4e-6 / size.min() / 0.26,
        "current": (4e-6 / size * current).max() * 1e3,
        "shaping": 20 * np.log10(size.max() / size.min()),
        "blocked_force": abs(held.force[0]) * 1e3,
        "first_resonance": reference.natural_frequencies(beam, 1)[0],
        "footprint": 2.1 * 0.72,
        "standing": 25.0,
    }
    assert set(expected) == set(CRITERIA)
    for name, theirs in expected.items():
        assert float(found[variable(name)][0]) == pytest.approx(theirs, rel=2e-6), name


def test_unless_told_otherwise_a_drive_is_for_10_um_of_an_amplifier_of_100_v() -> None:
    """The current is unlimited, so that full voltage is what limits."""
    asked = ("drive", "attainable", "smallest_displacement")
    found = solve_study(study(axes={"load": ["none", "low"]}, criteria=asked))
    least = found.smallest_displacement_um_per_v.values
    assert found.drive_v.values == pytest.approx(10 / least, rel=1e-9)
    assert found.attainable_um.values == pytest.approx(100 * least, rel=1e-9)


def test_less_is_better_of_what_costs_and_more_of_what_is_gained() -> None:
    """Signs are exactly one: they turn values for a search, and must not weigh them."""
    costs = {"drive", "field", "current", "shaping", "footprint", "standing"}
    for name, criterion in CRITERIA.items():
        expected = -1 if name in costs else 0 if name == "first_resonance" else 1
        assert criterion.sign == expected, name


def test_a_thin_layer_bears_less_drive_and_twice_as_much_in_series() -> None:
    """0.4 MV/m: 40 V on 0.1 mm, 80 V in series, and never more than the drive's own 100 V."""
    axes = {"piezo_height_mm": [0.1, 0.24, 0.3], "wiring": ["parallel", "series"]}
    asked = ("attainable", "smallest_displacement", "field", "drive")
    found = solve_study(study(axes=axes, fixed={"load": "low"}, criteria=asked))
    volts = found.attainable_um / found.smallest_displacement_um_per_v
    assert volts.values == pytest.approx(np.array([[40, 80], [96, 100], [100, 100]]), rel=1e-9)
    share = np.array([[1.0, 0.5]]) / np.array([[0.1], [0.24], [0.3]])
    assert found.field_v_per_mm.values == pytest.approx(found.drive_v.values * share)


@pytest.mark.parametrize("length", [2e-3, 9e-3, 20e-3, 45e-3])
def test_first_resonance_is_that_of_finite_elements(length: float) -> None:
    """Beams are also short enough for shear to matter."""
    fem = reference.natural_frequencies(reference.Beam(length=length), 1)[0]
    assert first_resonance(Bimorph(length=length)) == pytest.approx(fem, rel=1e-9)


def test_first_resonance_follows_axial_force_up_to_buckling() -> None:
    """A clamped-free column buckles at π² EI/(4 l²) (Euler), but for its small shear."""
    stiff = Bimorph()
    euler = float(np.pi**2 * section(stiff).EI.real / (4 * 0.02**2))
    forces = np.array([-1.01, -0.97, -0.5, 0.0, 50.0]) * euler
    found = first_resonance(stiff, axial_force=forces)
    assert np.isnan(found[0])
    assert np.all(np.diff(found[1:]) > 0)
    for axial in (-0.5, 20.0):
        f = np.linspace(0.97, 1.03, 301) * first_resonance(stiff, axial_force=axial * euler)
        beam = reference.lossless(reference.Beam())
        peak = reference.response(beam, f, axial_force=axial * euler)
        assert abs(int(np.argmax(np.abs(peak.displacement))) - 150) <= 1


# Parameters


def test_named_materials_and_wiring_are_those_of_the_library() -> None:
    axes = {
        "piezo": ["pzt-5a", "3203hd"],
        "shim": ["brass", "cfrp"],
        "wiring": ["parallel", "series"],
    }
    found = solve_study(study(axes=axes, fixed={"load": "high"})).smallest_displacement_um_per_v
    for piezo, shim, wiring in itertools.product(*axes.values()):
        alone = Bimorph(piezo=PIEZOS[piezo], shim=SHIMS[shim], series=wiring == "series")
        size = np.abs(tip_response(alone, FingerLoad.high(), FREQUENCY).displacement)
        ours = found.sel(piezo=piezo, shim=shim, wiring=wiring)
        assert float(ours) == pytest.approx(size.min() * 1e6, rel=1e-12)


def test_a_constant_beside_a_named_material_replaces_that_of_the_material() -> None:
    named = specimen({"shim": ["brass", "steel"], "shim_density_kg_m3": 5000.0}).bimorph.shim
    assert np.array_equal(named.density, 5000.0)
    assert list(np.asarray(named.s11)) == [SHIMS["brass"].s11, SHIMS["steel"].s11]


def test_standard_values_are_the_default_design() -> None:
    base = Bimorph()
    own = {name: standard_value(name, base) for name, p in PARAMETERS.items() if p.part}
    again = specimen(own).bimorph
    for name in own:
        assert standard_value(name, again) == pytest.approx(own[name], rel=1e-14)
    assert (own["length_mm"], own["shim_modulus_gpa"]) == pytest.approx((20.0, 110.0))


@pytest.mark.parametrize(("firmness", "name"), [(0.0, "low"), (1.0, "high")])
def test_firmness_is_the_papers_fingers_at_its_ends(firmness: float, name: str) -> None:
    mixed, finger = load_of_firmness(firmness), FINGERS[name]
    assert (mixed.k0, mixed.d0) == pytest.approx((finger.k0, finger.d0))
    assert mixed.branches[0] == pytest.approx(finger.branches[0])


def test_firmness_is_the_geometric_mean_halfway() -> None:
    assert load_of_firmness(0.5).k0 == pytest.approx((1000 * 4300) ** 0.5)
    assert load_of_firmness(0.5).branches[0][1] == pytest.approx((0.33 * 2) ** 0.5)


def test_named_fingers_with_unequal_branches_are_each_themselves() -> None:
    fingers = {
        "two": FingerLoad(k0=500, d0=0.1, branches=((700, 0.2), (900, 2.0))),
        **FINGERS,
    }
    found = solve_study(study(axes={"load": list(fingers)}, fingers=fingers))
    for name in fingers:
        alone = solve_study(study(axes={"load": [name]}, fingers=fingers))
        assert (
            found.smallest_displacement_um_per_v.sel(load=name).values
            == alone.smallest_displacement_um_per_v.values[0]
        )
    stiffness = fingers["two"].stiffness(FREQUENCY)
    assert np.array_equal(
        specimen({"load": "two"}, fingers=fingers).load.stiffness(FREQUENCY), stiffness
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"axes": {}}, "needs an axis, as length_mm=8:30:0.5"),
        ({"axes": {"length_mm": []}}, "length_mm: the axis is empty"),
        ({"axes": {"lenght_mm": [3.0]}}, "no parameter 'lenght_mm'; did you mean 'length_mm'?"),
        ({"axes": {"length_mm": [3.0, -1.0]}}, "length_mm = -1: must be 0.5 … 200 mm"),
        ({"axes": {"length_mm": [np.nan]}}, "length_mm = nan: must be 0.5 … 200 mm"),
        ({"axes": {"length_mm": ["long"]}}, "length_mm = .*'long'.*: not a number"),
        ({"axes": {"load": ["hihg"]}}, "load = 'hihg': no such name; did you mean 'high'?"),
        ({"fixed": {"length_mm": 3.0}}, "length_mm: given twice"),
        ({"fixed": {"firmness": 1.0}}, "load and firmness: both are the finger"),
        ({"frequency": []}, "fewer than two frequencies in the band 0:1000 Hz"),
        ({"frequency": [10.0, 990.0]}, "go from 10 to 990 Hz; add the band's ends"),
        ({"axes": {"length_mm": [8.0, 8.0]}}, "length_mm: the axis has a value twice"),
        ({"frequency": [1.0, 1.0]}, "frequency_hz: must ascend"),
        ({"frequency": [-1.0, 1.0]}, "frequency_hz: must ascend from 0 Hz"),
        ({"conditions": Conditions()}, "smallest_displacement: needs a band"),
        ({"criteria": ("smallest",)}, "no criterion 'smallest'; did you mean 'smallest_force'?"),
        ({"criteria": (), "responses": ("speed",)}, "no response 'speed'"),
        ({"criteria": ()}, "needs a criterion or a response"),
        ({"criteria": (), "responses": ("force",), "frequency": []}, "force: needs frequencies"),
        ({"responses": ("displacement_at_point",)}, "displacement_at_point: needs measuring_point"),
        ({"scenarios": draw_scenarios(4)}, "load and firmness: both are the finger"),
    ],
)
def test_what_cannot_be_asked_is_said_in_one_line(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        study(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Conditions(band=(5.0, 5.0)), "band = 5:5 Hz: must ascend"),
        (lambda: Conditions(voltage=0.0), "voltage = 0: must be above 0"),
        (lambda: draw_scenarios(0), "scenarios = 0: must be 1 … 1048576"),
        (lambda: draw_scenarios(4, tolerances={"d31_pm_per_v": 2.0}), "tolerance of d31_pm_per_v"),
        (lambda: Scenarios(), "must be one length of at least 1"),
        (lambda: Scenarios(values={"length": np.ones(3)}), "no parameter 'length'"),
        (lambda: solve_study(study(fixed={"measuring_point_mm": 15.0})), "lies beyond the tip"),
        (
            lambda: solve_study(study(fixed={"axial_force_n": -26.0}, axes={"length_mm": [20.0]})),
            r"axial_force_n = -26: buckles a bender that bears 25\.\d N",
        ),
        (lambda: within(np.array([1.0]), np.array([1.0]), share=0.9), "two or more ascending"),
        (lambda: within(np.arange(3.0), np.arange(3.0), share=1.0), "share = 1"),
    ],
)
def test_bad_values_are_said_in_one_line(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_conditions_stay_as_they_were_checked() -> None:
    conditions = Conditions()
    with pytest.raises(FrozenInstanceError):
        conditions.voltage = 0.0  # type: ignore[misc]


def test_a_study_larger_than_memory_is_refused_before_it_begins() -> None:
    many = np.linspace(5, 40, 10**4)
    big = study(axes={"length_mm": many, "width_mm": many[:2000]}, responses=("displacement",))
    with pytest.raises(InputError, match=r"takes 6\.4 GiB, more than 2 GiB of memory; store it"):
        solve_study(big)


# Blocks


@given(st.lists(st.integers(1, 7), min_size=1, max_size=4), st.integers(1, 60))
def test_blocks_cover_every_design_once_and_are_no_larger_than_asked(
    shape: list[int], designs: int
) -> None:
    counted = np.zeros(shape, int)
    for block in blocks(tuple(shape), designs):
        assert counted[block].size <= designs
        counted[block] += 1
    assert np.all(counted == 1)


def test_however_it_is_cut_the_answer_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = study(
        axes={"length_mm": [8.0, 20.0, 30.0], "width_mm": [1.0, 3.0]},
        scenarios=draw_scenarios(6),
        responses=("displacement", "admittance"),
        criteria=tuple(CRITERIA),
    )
    whole = tuple(slice(0, n) for n in asked.shape)
    monkeypatch.setattr(sweeps, "PIECE_POINTS", 10**9)
    at_once = solve_block(asked, whole)
    monkeypatch.setattr(sweeps, "PIECE_POINTS", 84)
    cut = solve_block(asked, whole)
    assert set(at_once) == set(cut) == set(variables(asked))
    for name in cut:
        assert cut[name].shape == at_once[name].shape
        assert cut[name] == pytest.approx(at_once[name], rel=1e-12), name


# Scenarios


def test_scenarios_are_log_normal_fingers_and_parts_within_tolerance() -> None:
    drawn = draw_scenarios(4096)
    stiffness = np.log(np.asarray(load_of_firmness(drawn.values["firmness"]).k0))
    low, high = np.log(1000.0), np.log(4300.0)
    assert stiffness.mean() == pytest.approx((low + high) / 2, abs=0.01)
    assert stiffness.std() == pytest.approx((high - low) / 2, rel=0.02)
    skew = ((stiffness - stiffness.mean()) ** 3).mean() / stiffness.std() ** 3
    assert abs(skew) < 0.05
    assert drawn.factors.keys() == TOLERANCES.keys()
    for name, spread in TOLERANCES.items():
        factor = drawn.factors[name]
        assert (factor.mean(), factor.std()) == pytest.approx((1.0, spread), rel=0.02)
        assert np.abs(factor - 1).max() <= 3 * spread * (1 + 1e-12)
    together = np.corrcoef([drawn.values["firmness"], *drawn.factors.values()])
    assert np.abs(together - np.eye(len(together))).max() < 0.05


def test_each_scenario_is_the_design_that_it_says() -> None:
    """Scenarios are computed by hand: a factor multiplies the value of the axis or base design."""
    drawn = draw_scenarios(3, tolerances={"length_mm": 0.1, "shim_height_mm": 0.1})
    found = solve_study(study(axes={"length_mm": [15.0, 20.0]}, scenarios=drawn))
    for i, length in enumerate((15.0, 20.0)):
        for k in range(3):
            alone = solve_study(
                study(
                    axes={"length_mm": [length * drawn.factors["length_mm"][k]]},
                    fixed={
                        "shim_height_mm": 0.2 * drawn.factors["shim_height_mm"][k],
                        "firmness": drawn.values["firmness"][k],
                    },
                )
            )
            assert found.smallest_displacement_um_per_v.values[i, k] == pytest.approx(
                float(alone.smallest_displacement_um_per_v[0]), rel=1e-12
            )


def test_a_tolerance_is_of_the_material_that_is_named() -> None:
    drawn = Scenarios(
        factors={"d31_pm_per_v": np.array([1.1]), "shim_modulus_gpa": np.array([0.9])}
    )
    found = solve_study(study(axes={"piezo": ["pzt-5a"], "shim": ["brass"]}, scenarios=drawn))
    piezo = replace(PIEZOS["pzt-5a"], d31=1.1 * PIEZOS["pzt-5a"].d31)
    shim = replace(SHIMS["brass"], s11=SHIMS["brass"].s11 / 0.9)
    alone = tip_response(Bimorph(piezo=piezo, shim=shim), FingerLoad.none(), FREQUENCY)
    assert float(found.smallest_displacement_um_per_v.values[0, 0, 0]) == pytest.approx(
        np.abs(alone.displacement).min() * 1e6, rel=1e-12
    )


def test_same_seed_same_scenarios() -> None:
    one, same, other = (draw_scenarios(5, seed=s).values["firmness"] for s in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


# What an answer carries


def test_an_answer_carries_units_and_how_it_came_to_be() -> None:
    found = solve_study(study(responses=("force",), fixed={"width_mm": 3.0}))
    assert isinstance(found, xarray.Dataset)
    assert found.smallest_displacement_um_per_v.dims == ("length_mm", "load")
    assert found.force_mn_per_v.dims == ("length_mm", "load", "frequency_hz")
    for name in ("length_mm", "frequency_hz", "smallest_displacement_um_per_v", "force_mn_per_v"):
        assert {"units", "long_name"} <= set(found[name].attrs), name
    assert found.smallest_displacement_um_per_v.attrs["band"] == "0 … 1000 Hz"
    assert json.loads(found.attrs["fixed"]) == {"width_mm": 3.0}
    assert json.loads(found.attrs["base"])["piezo"]["s11E"] == 16.2e-12
    assert json.loads(found.attrs["fingers"])["low"]["branches"] == [[1300.0, 0.33]]
    json.loads(found.attrs["conditions"], parse_constant=pytest.fail)
    assert found.attrs["source"].startswith("tactile ")
    assert "10.1515/ehs-2014-0055" in found.attrs["model"]


# Ranges


def test_a_range_ends_where_a_parabola_falls_to_the_share() -> None:
    along = np.linspace(0, 10, 2001)
    found = within(along, 4 - (along - 6) ** 2 / 10, share=0.9)
    assert (found.low, found.high, found.best, found.value) == pytest.approx((4, 8, 6, 4), abs=1e-3)
    assert not found.is_cut


def test_a_range_of_what_should_be_small_ends_at_its_multiple() -> None:
    along = np.linspace(1, 10, 2001)
    found = within(along, along, share=0.5, sign=-1)
    assert (found.low, found.high, found.best) == pytest.approx((1, 2, 1), abs=2e-3)
    assert found.is_cut


def test_levels_are_good_enough_within_so_many_decibels() -> None:
    """85 % is 1.41 dB, also about 0 dB."""
    along = np.linspace(0, 10, 1001)
    found = within(along, along - 1.0, share=0.85, sign=-1, in_db=True)
    assert (found.low, found.high, found.value) == pytest.approx((0.0, 1.41, -1.0), abs=0.01)


def test_of_two_stretches_it_is_that_with_the_best() -> None:
    along = np.arange(9.0)
    found = within(along, np.array([9, 9, 1, 9, 10, 9, 1, 1, 9.0]), share=0.85)
    assert 2 < found.low < 3
    assert 5 < found.high < 6


def test_designs_that_failed_are_outside_a_range() -> None:
    found = within(np.arange(4.0), np.array([np.nan, 1, 1, np.nan]), share=0.5)
    assert (found.low, found.high) == (1, 2)


def test_overlap_is_what_all_share() -> None:
    def of(low: float, high: float) -> Range:
        return Range(low, high, low, 1.0, False)

    assert overlap([of(1, 5), of(3, 8)]) == (3, 5)
    assert overlap([of(1, 2), of(3, 8)]) is None


def test_names_and_limits_of_parameters_hold_their_own_standard() -> None:
    for name, parameter in PARAMETERS.items():
        if parameter.part:
            check_value(name, standard_value(name, Bimorph()))
