"""A measurement is read in its unit, or refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from tactile.errors import InputError, NotFoundError
from tactile.study.measurement import Measurement, load_measurement

HEADER = "frequency_hz,magnitude,phase_deg,unit\n"


def written(folder: Path, *lines: str) -> Path:
    path = folder / "m.csv"
    path.write_text(HEADER + "".join(f"{line}\n" for line in lines), "utf-8")
    return path


@pytest.mark.parametrize(
    ("unit", "kind", "size"),
    [
        ("m/V", "displacement", 2.0),
        ("mm/V", "displacement", 2e-3),
        ("um/V", "displacement", 2e-6),
        ("µm/V", "displacement", 2e-6),
        ("\u03bcm/V", "displacement", 2e-6),
        ("nm/V", "displacement", 2e-9),
        ("m/s/V", "velocity", 2.0),
        ("mm/s/V", "velocity", 2e-3),
        ("um/s/V", "velocity", 2e-6),
        ("N/V", "force", 2.0),
        ("mN/V", "force", 2e-3),
        ("uN/V", "force", 2e-6),
        ("S", "admittance", 2.0),
        ("mS", "admittance", 2e-3),
        ("µS", "admittance", 2e-6),
        ("nS", "admittance", 2e-9),
    ],
)
def test_a_unit_tells_kind_and_size(tmp_path: Path, unit: str, kind: str, size: float) -> None:
    read = load_measurement(written(tmp_path, f"5,2,90,{unit}", f"7,2,-180,{unit}"))
    assert (read.kind, read.name) == (kind, "m.csv")
    np.testing.assert_array_equal(read.frequency, [5.0, 7.0])
    np.testing.assert_allclose(read.value, [1j * size, -size], rtol=1e-12, atol=1e-12 * size)


def test_units_of_one_kind_may_be_mixed(tmp_path: Path) -> None:
    read: Measurement = load_measurement(written(tmp_path, "5,2000,0,nm/V", "7,2,0,um/V"))
    np.testing.assert_allclose(read.value, 2e-6)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "m.csv: has a header and no measured points"),
        (["5,2,0,um/v"], "line 2: unit = 'um/v': unknown; did you mean 'um/V'?"),
        (["5,2,0"], "line 2: unit = '': unknown"),
        (["5,2,0,um/V", "7,2,0,S"], "line 3: unit = 'S': is admittance, the first line's is dis"),
        (["5,2,0,um/V", "5,2,0,um/V"], "line 3: frequency_hz = 5: must be above 5"),
        (["0,2,0,um/V"], "line 2: frequency_hz = 0: must be above 0"),
        (["5,0,0,um/V"], "line 2: magnitude = 0: must be above 0"),
        (["5,-2,0,um/V"], "line 2: magnitude = -2: must be above 0; a sign belongs into phase_deg"),
        (["5,nan,0,um/V"], "line 2: magnitude = 'nan': must be a finite number"),
    ],
)
def test_what_is_no_measurement_is_refused_in_a_line(
    tmp_path: Path, lines: list[str], said: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_measurement(written(tmp_path, *lines))
    assert said in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_another_kind_than_asked_for_is_refused_with_the_units_that_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is admittance, must be one of N/V, mN/V, uN/V"):
        load_measurement(written(tmp_path, "5,2,0,S"), "force")


def test_a_file_that_is_not_there_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="no such file"):
        load_measurement(tmp_path / "none.csv")
