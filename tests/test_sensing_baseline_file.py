"""Files of calibrations: what was written is read again, and every bad file gets one line."""

from __future__ import annotations

import zipfile
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensing_rig import exact_baseline, random_loads, tolerant_plant

from benchmarks.sensing_loop import RATE
from tactile.errors import InputError, NotFoundError
from tactile.sensing.admittance import Admittances
from tactile.sensing.baseline_file import (
    COLUMNS,
    Calibration,
    load_calibration,
    save_calibration,
)
from tactile.sensing.hysteresis import PlayModel

CHANNELS = 2


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    """Return a calibration of two channels, one of which was not measured."""
    baseline = exact_baseline(tolerant_plant(random_loads(CHANNELS)))
    baseline = replace(
        baseline, residual=np.array([0.001, np.inf]), faults=("", "no current — 10 Hz"),
        hysteresis=PlayModel(np.array([[1.0, 2.0]] * 2), np.array([[0.1, 0.0], [0.2, 0.3]])),
    )  # fmt: skip
    lines = np.array([10.0, 300.0, 900.0])
    value = np.array([[1e-6j, 2e-5j, 7e-5], [np.nan] * 3])
    clipped = np.array([[False] * 3, [True, False, True]])
    measured = Admittances(lines, value, 1e-8 * np.ones((2, 3)), np.array([1e-6, np.nan]), clipped)
    return Calibration("ring", "2026-01-31T12:00:00Z", RATE, 2.5e-3, measured, baseline)


@pytest.fixture
def path(tmp_path: Path, calibration: Calibration) -> Path:
    """Return the file of the calibration."""
    path = tmp_path / "ring.sensing.npz"
    save_calibration(path, calibration)
    return path


def changed(path: Path, **arrays: Any) -> Path:
    """Write the arrays of a file again, with changes; None leaves one out."""
    with np.load(path) as file:
        columns = {name: file[name] for name in file.files} | arrays
    other = path.with_name("changed.npz")
    kept = {name: column for name, column in columns.items() if column is not None}
    np.savez(other, **kept)
    return other


def same(a: Any, b: Any) -> None:
    """Compare two values, or two dataclasses field by field."""
    if hasattr(a, "__dataclass_fields__"):
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    else:
        np.testing.assert_array_equal(a, b)
        assert type(a) is type(b)


def test_what_was_written_is_read(path: Path, calibration: Calibration) -> None:
    """Compare every field, with NaN and infinity of the channel that was not measured."""
    same(load_calibration(path), calibration)


def test_a_file_is_not_overwritten_unless_told(path: Path, calibration: Calibration) -> None:
    """Write twice, and with another ending; nothing else stays in the folder."""
    other = replace(calibration, display="other")
    with pytest.raises(InputError, match="already exists"):
        save_calibration(path, other)
    assert load_calibration(path).display == "ring"
    save_calibration(path, other, force=True)
    assert load_calibration(path).display == "other"
    with pytest.raises(InputError, match=r"ends in \.npz"):
        save_calibration(path.with_suffix(".toml"), other)
    assert list(path.parent.iterdir()) == [path]


def test_no_such_file(tmp_path: Path) -> None:
    """Read a file that does not exist."""
    with pytest.raises(NotFoundError, match=r"none\.npz: no such file"):
        load_calibration(tmp_path / "none.npz")


@pytest.mark.parametrize("name", COLUMNS)
def test_missing_arrays_are_named(path: Path, name: str) -> None:
    """Leave out each array."""
    with pytest.raises(InputError, match=f"is not a calibration: it has no {name}"):
        load_calibration(changed(path, **{name: None}))


@pytest.mark.parametrize("name", COLUMNS)
def test_arrays_of_another_kind_or_shape_are_named(path: Path, name: str) -> None:
    """Replace each array by one of bytes, and by one of another shape."""
    with np.load(path) as file:
        column = file[name]
    shorter = column[..., :0] if column.ndim else np.stack([column, column])
    for wrong in (np.frombuffer(b"abc", "S1"), column[None], shorter):
        with pytest.raises(InputError, match=f"{name}: .*(not|where)") as caught:
            load_calibration(changed(path, **{name: wrong}))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "name", ["stiffness_factor", "capacitance_f", "skew_s", "design_force_n_v", "lines_hz"]
)
def test_values_that_are_not_finite_are_named(path: Path, name: str) -> None:
    """Put NaN and infinity into arrays that must be finite."""
    for wrong in (np.nan, np.inf):
        with np.load(path) as file:
            column = file[name].copy()
        column.flat[-1] = wrong
        with pytest.raises(InputError, match=f"{name}: holds NaN or infinity"):
            load_calibration(changed(path, **{name: column}))


def test_values_out_of_range_are_named(path: Path) -> None:
    """Give another format, lines that descend, and rates of zero."""
    for words, arrays in {
        "format 1, this version reads 2: calibrate again": {"format": np.array(1)},
        "hysteresis_radius_v: must be above 0": {"hysteresis_radius_v": np.zeros((2, 2))},
        "hysteresis_weight: must not be below 0": {"hysteresis_weight": np.full((2, 2), -0.1)},
        "lines_hz: must ascend": {"lines_hz": np.array([10.0, 5.0, 900.0])},
        "sample_rate_hz: must be above 0": {"sample_rate_hz": np.array(0.0)},
        "stiffness_factor: must be above 0": {"stiffness_factor": np.array([1.0, -1.0])},
    }.items():
        with pytest.raises(InputError, match=words):
            load_calibration(changed(path, **arrays))


def test_file_of_an_older_format_is_named_although_it_lacks_arrays(path: Path) -> None:
    """Read a file as it was before hysteresis was measured."""
    older = changed(path, format=np.array(1), hysteresis_radius_v=None, hysteresis_weight=None)
    with pytest.raises(InputError, match="format 1, this version reads 2: calibrate again"):
        load_calibration(older)


def test_damaged_files_are_refused(path: Path) -> None:
    """Cut the file anywhere, turn bytes of it, and read text, pickles and another archive."""
    whole = path.read_bytes()
    other = path.with_name("damaged.npz")
    rng = np.random.default_rng(0)
    for size in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        other.write_bytes(whole[:size])
        with pytest.raises(InputError, match="is not a calibration, or is damaged"):
            load_calibration(other)
    for place in rng.integers(len(whole), size=200):
        turned = bytearray(whole)
        turned[place] ^= 1 << rng.integers(8)
        other.write_bytes(turned)
        with suppress(InputError):
            load_calibration(other)
    with pytest.raises(InputError, match="is not a calibration, or is damaged"):
        load_calibration(changed(path, faults=np.array([{}, {}], object)))
    with zipfile.ZipFile(other, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("format.npy", bytes(80 * 1024**2))
    with pytest.raises(InputError, match="holds 80 MiB, above 64 MiB"):
        load_calibration(other)


def test_calibration_of_another_display_is_refused(calibration: Calibration) -> None:
    """Compare with the same display, and with others in each respect."""
    bender = calibration.baseline.bender
    calibration.check_display(bender, CHANNELS, RATE)
    with pytest.raises(InputError, match=r"ring, 2026-.*: of 2 channels, the display has 3"):
        calibration.check_display(bender, 3, RATE)
    with pytest.raises(InputError, match="at 8000 Hz, the display plays at 16000 Hz"):
        calibration.check_display(bender, CHANNELS, 16000.0)
    for name in ("force", "stiffness", "amplifier"):
        other = replace(bender, **{name: 1.001 * getattr(bender, name)})
        with pytest.raises(InputError, match=f"another {name} than the display's"):
            calibration.check_display(other, CHANNELS, RATE)
    short = replace(bender, force=bender.force[:-1])
    with pytest.raises(InputError, match="another force"):
        calibration.check_display(short, CHANNELS, RATE)
