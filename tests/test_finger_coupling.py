"""`tactile finger --coupling`: how strongly the skin couples neighbors, on the simulated display.

Figures on an independent plant are those of ``python -m benchmarks coupling``.
"""

from pathlib import Path

import numpy as np
import pytest
from cli_rig import Command
from display_files import contactors, load
from finger_rig import calibrated, display_file, display_in, options
from sensing_rig import exact_baseline, random_loads, tolerant_plant

from tactile.actuator.finger import FingerLoad
from tactile.bringup.finger_measuring import FingerReport, measure_finger
from tactile.errors import InputError
from tactile.sensing.baseline_file import Calibration
from tactile.sensing.population import CONSTANTS, load_stiffness
from tactile.sensing.resting_load import MeasuredLoads
from tactile.sensing.skin_coupling import MeasuredCoupling, level_together
from tactile.sensing.uncertainty import FREQUENCY


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a display of four contactors, and its calibration."""
    return display_in(tmp_path_factory.mktemp("coupling"))


@pytest.fixture(scope="module")
def calibration(folder: Path) -> Calibration:
    """Return a calibration of benders with tolerances."""
    return calibrated(folder)


@pytest.mark.ci
def test_contactors_that_are_not_coupled_have_couplings_of_nothing(
    folder: Path, calibration: Calibration, command: Command
) -> None:
    """Find 0 within four stated deviations, of which none is above 0.01, on all four sides."""
    url = "sim:?finger=mid&tolerance=1"
    said = command("finger", url, *options(folder), "--coupling", "--json")
    assert said.code == 0
    coupling = said.json["coupling"]
    assert [one["contactors"] for one in coupling["pairs"]] == [[0, 1], [0, 2], [1, 3], [2, 3]]
    for one in coupling["pairs"]:
        assert abs(one["coupling"]) < 4 * one["deviation"]
        assert one["deviation"] < 0.01
    assert [(one["along_x_mm"], one["along_y_mm"]) for one in coupling["directions"]] == [
        (2.5, 0.0), (0.0, 3.5),
    ]  # fmt: skip
    assert abs(coupling["together_db"]) < 0.1
    assert coupling["seconds"] == 1.2
    assert "coupling" not in command("finger", url, *options(folder), "--json").json


@pytest.mark.ci
def test_the_command_prints_the_coupling_of_the_simulated_skin(
    folder: Path, calibration: Calibration, command: Command
) -> None:
    """Find couplings of 0.2 along x and 0.2 · (2.5/3.5)^4.8 = 0.04 along y.

    The median of two is within 0.01 and 0.004, two stated deviations. If the couplings of both
    diagonals were left out, that along y would be 0.05. The load of the paper's soft finger
    is that of a contactor whose neighbors rest; for all that move alike it is a quarter less.
    """
    url = "sim:?finger=mid&tolerance=1&coupling=0.2"
    report, _ = measure_finger(url, display_file(folder), calibration, coupling=True)
    assert report.coupling is not None
    along, across = report.coupling.directions
    assert (along.pairs, across.pairs) == (2, 2)
    assert along.coupling == pytest.approx(0.2, abs=0.01)
    assert across.coupling == pytest.approx(0.04, abs=0.004)
    exact = FingerLoad.mid().stiffness(np.array([300.0])).real[0]
    at = report.frequency_hz.index(300.0)

    def stiffness(one: FingerReport) -> float:
        """Return the mean stiffness of all contactors at 300 Hz."""
        known = [contactor.stiffness_n_per_m for contactor in one.contactors]
        return float(np.mean([values[at] for values in known if values is not None]))

    assert stiffness(report) == pytest.approx(exact, rel=0.05)
    alike, _ = measure_finger(url, display_file(folder), calibration)
    assert stiffness(alike) == pytest.approx(0.76 * exact, rel=0.08)
    said = command("finger", url, *options(folder), "--coupling")
    assert said.code == 0
    lines = said.out.splitlines()
    assert lines[-3].startswith(f"coupling to the neighbor 2.5 mm along x: {along.coupling:.3f} ±")
    assert lines[-2].startswith(f"coupling to the neighbor 3.5 mm along y: {across.coupling:.3f} ±")
    level = f"filters for each alone play {report.coupling.together_db:+.1f} dB"
    assert level in lines[-1]
    assert report.coupling.together_db is not None
    assert report.coupling.together_db > 0.5


@pytest.mark.ci
def test_without_neighbors_under_the_finger_one_line_says_so(
    folder: Path, calibration: Calibration, tmp_path: Path, command: Command
) -> None:
    """Measure in air, and refuse a display of one contactor before anything is opened."""
    url = "sim:?finger=air&tolerance=1"
    said = command("finger", url, *options(folder), "--coupling")
    assert (said.code, said.out) == (
        1, "nothing touches the display: rest a finger on it, and measure again\n",
    )  # fmt: skip
    report, _ = measure_finger(url, display_file(folder), calibration, coupling=True)
    assert report.coupling is not None
    assert report.coupling.note.startswith("no two neighboring contactors are touched")
    assert report.coupling.seconds == 0
    load(tmp_path, contactors((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="its only contactor has no neighbors"):
        measure_finger("nothing:", display_file(tmp_path), calibration, coupling=True)


@pytest.mark.parametrize("polarity", [(1.0, 1.0), (1.0, -1.0)])
def test_the_level_of_two_that_move_alike_is_that_of_the_closed_form(
    polarity: tuple[float, float],
) -> None:
    """Solve the two equations of motion of contactors that differ, by Cramer's rule.

    With the other polarity of the second one, the coupling per volt has the other sign, and that
    of shears is the same.
    """
    loads = random_loads(2, seed=3)
    baseline = exact_baseline(tolerant_plant(loads))
    known = MeasuredLoads(
        np.full(2, 10), np.ones(2, np.bool_), loads, np.zeros((2, CONSTANTS, CONSTANTS)),
        np.zeros(2),
    )  # fmt: skip
    c = 0.2 * np.prod(polarity)
    measured = MeasuredCoupling(np.array([[0, 1]]), np.array([c]), np.zeros(1), known)
    _, S = baseline.tip(FREQUENCY)
    k = load_stiffness(loads, FREQUENCY)
    own, across = S + k, 0.2 * np.sqrt(k[0] * k[1])
    moved = own[::-1] * (own + across) / (own[0] * own[1] - across**2)
    expected = 20 * np.log10(np.abs(moved)).mean(axis=1)
    level = level_together(baseline, measured, np.array(polarity))
    np.testing.assert_allclose(level, expected, rtol=1e-9)
    assert np.all(level > 0.2)
