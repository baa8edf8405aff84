"""Material, wiring and adjusted constants in a display's file, and writing them into it."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactile.actuator.benders import BENDERS
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import PIEZOS, SHIMS
from tactile.display.display import load_display
from tactile.display.edit import write_tables
from tactile.errors import InputError

TEXT = """\
# A display of one contactor
[display]
id = "one"
description = "A # that is none, and [bimorph] in a text"
opening_mm = [2.0, 3.0]   # along and across

[[contactor]]
position_mm = [0.0, 0.0]
channel = 0

# the bender
[bimorph]                 # as delivered
width_mm = 2.1            # measured
length_mm = 20.0
# of the layers
piezo_height_mm = 0.26

# under the thumb
[finger]                  # of one person
k0_n_per_m = 1500.0       # guessed
d0_n_s_per_m = 0.2
branches = [
    [1300.0, 0.33],       # slow
]

[limits]
voltage_v = 100.0
"""
FITTED: dict[str, Any] = {"d31_pm_per_v": -283.5, "piezo_quality": 41.0, "length_mm": 19.8}
LOAD: dict[str, Any] = {
    "k0_n_per_m": 900.0, "d0_n_s_per_m": 0.125, "branches": [[1200.0, 0.3], [50.0, 0.01]],
}  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "one.toml"
    file.write_text(TEXT, encoding="utf-8")
    return file


def with_keys(path: Path, *lines: str) -> Path:
    path.write_text(TEXT.replace("length_mm = 20.0", "\n".join(("length_mm = 20.0", *lines))))
    return path


def tables(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text("utf-8"))


# Contents of a file


def test_a_bender_is_of_the_materials_and_the_wiring_that_its_file_names(path: Path) -> None:
    with_keys(path, 'piezo = "pzt-8"', 'shim = "brass"', 'wiring = "series"')
    bimorph = load_display(path).bimorph
    assert bimorph.piezo == PIEZOS["pzt-8"]
    assert bimorph.shim == SHIMS["brass"]
    assert bimorph.series is True


def test_adjusted_constants_go_before_those_of_the_material(path: Path) -> None:
    with_keys(
        path, "d31_pm_per_v = -250.0", "eps33t_relative = 3000.0", "piezo_quality = 40.0",
        "shim_quality = 20.0", "loss_tangent = 0.03", "s11e_um2_per_n = 15.0",
    )  # fmt: skip
    bimorph = load_display(path).bimorph
    assert bimorph.piezo.d31 == pytest.approx(-250e-12)
    assert bimorph.piezo.eps33T == pytest.approx(3000 * 8.8541878128e-12)
    assert bimorph.piezo.quality_factor == 40.0
    assert bimorph.piezo.loss_tangent == 0.03
    assert bimorph.piezo.s11E == pytest.approx(15e-12)
    assert bimorph.piezo.s55E == PIEZOS["3203hd"].s55E
    assert bimorph.shim.quality_factor == 20.0
    assert bimorph.shim.s11 == SHIMS["cfrp"].s11


def test_a_bender_in_series_bears_twice_the_voltage(path: Path) -> None:
    """The limit is one of field, and each layer has half the voltage: 104 V become 208 V."""
    high = TEXT.replace("voltage_v = 100.0", "voltage_v = 200.0")
    path.write_text(high)
    with pytest.raises(InputError, match=r"at most 104 V"):
        load_display(path)
    path.write_text(high.replace("length_mm = 20.0", 'length_mm = 20.0\nwiring = "series"'))
    series = load_display(path)
    assert series.limits.voltage == 200.0
    path.write_text(TEXT)
    assert series.capacitance == pytest.approx(load_display(path).capacitance / 4, rel=1e-9)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('piezo = "pzt-5"', r"one.toml: bimorph.piezo = 'pzt-5': unknown; did you mean 'pzt-5"),
        ('bender = "mtp"', r"bimorph.bender = 'mtp': unknown; "),
        ('shim = "bras"', r"one.toml: bimorph.shim = 'bras': unknown; did you mean 'brass'\?"),
        ('wiring = "serial"', r"bimorph.wiring = 'serial': unknown; did you mean 'series'\?"),
        ("d31_pm_per_v = 320.0", r"bimorph.d31_pm_per_v = 320.0: expected `?float`? <= -1"),
        ("eps33t_relative = 3e-8", r"bimorph.eps33t_relative = 3e-08: expected"),
        ("piezo_quality = 0.5", r"bimorph.piezo_quality = 0.5: expected"),
        ("loss_tangent = 2.0", r"bimorph.loss_tangent = 2.0: expected"),
        ("d31_pm_per_v = -2000.0", r"k31² = d31²/\(s11E eps33T\) must be a number below 1"),
    ],
)
def test_what_no_bender_can_be_is_refused(line: str, said: str, path: Path) -> None:
    with pytest.raises(InputError, match=said) as caught:
        load_display(with_keys(path, line))
    assert "\n" not in str(caught.value)


def test_a_display_names_a_bender_and_replaces_parts_of_it(path: Path) -> None:
    text = TEXT.replace("[bimorph]                 #", '[bimorph]\nbender = "mtp35x2.1x0.7" #')
    named = re.sub("^(width|length|piezo_h).*\n", "", text, flags=re.MULTILINE)
    path.write_text(named, encoding="utf-8")
    assert load_display(path).bimorph == BENDERS["mtp35x2.1x0.7"]
    path.write_text(named.replace("bender =", 'shim = "steel"\nbender ='), encoding="utf-8")
    changed = replace(BENDERS["mtp35x2.1x0.7"], shim=SHIMS["steel"])
    assert load_display(path).bimorph == changed


# Writing


def test_keys_of_the_bender_are_set_and_all_else_stays(path: Path) -> None:
    target = path.with_name("new.toml")
    write_tables(path, target, bimorph=FITTED, force=False)
    before, after = tables(path), tables(target)
    assert after["bimorph"] == before["bimorph"] | FITTED
    assert after["display"] == before["display"] | {"id": "new"}
    for parts in (before, after):
        del parts["bimorph"], parts["display"]
    assert after == before
    old, new = TEXT.splitlines(), target.read_text("utf-8").splitlines()
    assert [line for line in old if line not in new] == ['id = "one"', "length_mm = 20.0"]
    assert len(new) == len(old) + 2
    assert path.read_text("utf-8") == TEXT


def test_the_description_ends_with_what_was_changed(path: Path) -> None:
    """A change of the same part replaces the one before it."""
    before = tables(path)["display"]["description"]
    for number, part in enumerate(("finger", "bimorph", "finger")):
        change = f"{part} fitted to {number}.csv"
        write_tables(path, path, finger=LOAD, change=change, force=True)
    after = tables(path)["display"]
    ending = "; adjusted: bimorph fitted to 1.csv, finger fitted to 2.csv"
    assert after == {**after, "id": "one", "description": before + ending}


@pytest.mark.parametrize(
    ("file", "name"), [("My Hand_2.toml", "my-hand-2"), ("µ.toml", "display"), ("a.b.toml", "a-b")]
)
def test_a_new_file_names_its_display_after_itself(path: Path, file: str, name: str) -> None:
    target = path.with_name(file)
    write_tables(path, target, finger=LOAD, force=False)
    assert load_display(target).name == name


def test_a_key_that_is_set_keeps_its_comment(path: Path) -> None:
    write_tables(path, path, bimorph={"width_mm": 2.05, "wiring": "series"}, force=True)
    assert re.search(r"^width_mm = 2.05 +# measured$", path.read_text("utf-8"), re.MULTILINE)
    assert load_display(path).bimorph.series is True


def test_the_finger_is_replaced_and_its_comments_stay(path: Path) -> None:
    write_tables(path, path, finger=LOAD, force=True)
    text = path.read_text("utf-8")
    assert tables(path)["finger"] == LOAD
    assert sorted(re.findall("#.*", text)) == sorted(re.findall("#.*", TEXT))
    load = load_display(path).load
    assert load == FingerLoad(k0=900.0, d0=0.125, branches=((1200.0, 0.3), (50.0, 0.01)))
    again = path.read_text("utf-8")
    write_tables(path, path, finger=LOAD, force=True)
    assert path.read_text("utf-8") == again


def test_a_preset_and_a_table_of_fingers_give_way_as_well(path: Path) -> None:
    row = "[[finger.table]]\nnormal_force_n = {}\nk0_n_per_m = 1.0\nd0_n_s_per_m = 1.0 # row\n"
    start, end = TEXT.index("[finger]"), TEXT.index("[limits]")
    rows = row.format(0.5) + row.format(1.0)
    for old in ('[finger]\npreset = "high"\n', rows):
        path.write_text(TEXT[:start] + old + TEXT[end:], encoding="utf-8")
        write_tables(path, path, finger=LOAD, force=True)
        assert tables(path)["finger"] == LOAD
        assert path.read_text("utf-8").count("# row") == old.count("# row")


def test_a_table_that_is_not_there_is_added(tmp_path: Path) -> None:
    path = tmp_path / "one.toml"
    start, end = TEXT.index("# the bender"), TEXT.index("# under the thumb")
    path.write_text(TEXT[:start] + TEXT[end:], encoding="utf-8")
    write_tables(path, path, bimorph=FITTED, finger=LOAD, force=True)
    assert tables(path)["bimorph"] == FITTED
    assert load_display(path).bimorph.length == pytest.approx(19.8e-3)


def test_a_shipped_display_takes_what_was_fitted(tmp_path: Path) -> None:
    target = tmp_path / "mine.toml"
    values = {"d31_pm_per_v": np.float64(-300.25)}
    write_tables("reference-24", target, bimorph=values, finger=LOAD, force=False)
    assert load_display(target).bimorph.piezo.d31 == pytest.approx(-300.25e-12)
    assert load_display("reference-24").bimorph.piezo.d31 == -320e-12


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"bimorph": {"piezzo": "pzt-8"}}, r"new.toml: not written: bimorph.piezzo: unknown key"),
        ({"bimorph": {"piezo": "pzt-9"}}, r"bimorph.piezo = 'pzt-9': unknown; did you mean"),
        ({"bimorph": {"d31_pm_per_v": 300.0}}, r"bimorph.d31_pm_per_v = 300.0: expected"),
        ({"bimorph": {"loss_tangent": float("nan")}}, r"must be a finite number"),
        ({"finger": {"k0_n_per_m": 1.0}}, r"finger: needs either preset, or k0_n_per_m"),
        ({"finger": {"k0_n_per_m": -1.0, "d0_n_s_per_m": 1.0}}, r"finger.k0_n_per_m = -1.0"),
    ],
)
def test_what_would_be_no_display_is_not_written(
    changes: dict[str, Any], said: str, path: Path
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        write_tables(path, path.with_name("new.toml"), **changes, force=False)
    assert "\n" not in str(caught.value)
    assert ".tactile-" not in str(caught.value)
    assert [file.name for file in path.parent.iterdir()] == ["one.toml"]


NO_BENDER = re.sub(r"# the bender(.|\n)*0\.26\n", "", TEXT)


@pytest.mark.parametrize(
    "keys",
    [
        "bimorph = {length_mm = 20.0, width_mm = 2.1} # as delivered\n",
        "bimorph.length_mm = 20.0\nbimorph.width_mm = 2.1 # as delivered\n",
        "bimorph.width_mm = 2.1 # as delivered\n",
    ],
    ids=["inline", "dotted", "one"],
)
def test_a_bender_in_another_form_takes_keys_as_well(keys: str, path: Path) -> None:
    path.write_text(keys + NO_BENDER, encoding="utf-8")
    write_tables(path, path, bimorph=FITTED, finger=LOAD, force=True)
    assert tables(path)["bimorph"] == {"width_mm": 2.1} | FITTED
    assert "# as delivered\n" in path.read_text("utf-8")


def test_a_finger_in_another_form_gives_way_as_well(path: Path) -> None:
    start, end = TEXT.index("# under the thumb"), TEXT.index("[limits]")
    for old in ('finger = {preset = "high"} # row\n', 'finger.preset = "high" # row\n'):
        path.write_text(old + TEXT[:start] + TEXT[end:], encoding="utf-8")
        write_tables(path, path, finger=LOAD, force=True)
        assert tables(path)["finger"] == LOAD
        assert "# row\n" in path.read_text("utf-8")


def test_a_key_that_is_added_stands_above_the_comment_of_the_next_table(path: Path) -> None:
    write_tables(path, path, bimorph={"piezo_quality": 41.0}, force=True)
    assert "piezo_height_mm = 0.26\npiezo_quality = 41.0\n\n# under" in path.read_text("utf-8")


def test_nothing_is_overwritten_without_force(path: Path) -> None:
    with pytest.raises(InputError, match="already exists; --force overwrites it"):
        write_tables(path, path, bimorph=FITTED, force=False)
    assert path.read_text("utf-8") == TEXT
