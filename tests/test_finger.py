"""A finger that rests on the display is measured, and `tactile adjust` takes it over.

The simulated display is the product's own model of it, `TouchedPlant`, whose currents come through
the protocol. Figures on an independent plant are those of ``python -m benchmarks finger``.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command
from display_files import contactors, load
from finger_rig import calibrated, display_file, display_in, options

import tactile
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.population import random_finger
from tactile.actuator.response import tip_response
from tactile.bringup import current_measuring
from tactile.bringup.finger_measuring import REPORTED, measure_finger
from tactile.bringup.finger_response import FREQUENCY, save_response, typical_stiffness
from tactile.bus.base import Bus
from tactile.devices import open_bus
from tactile.errors import BusError, InputError
from tactile.playback.sum_windows import PlayedWindow, SumWindows
from tactile.sensing.baseline_file import Calibration
from tactile.sensing.bender import bender_of
from tactile.sensing.population import CONSTANTS
from tactile.sensing.resting_load import MeasuredLoads
from tactile.study.measurement import load_measurement

WITHIN = 1.0
"""Largest error of the response of an adjusted display [dB]: a stiff finger is known to 0.5 dB."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a display of four contactors, and its calibration."""
    return display_in(tmp_path_factory.mktemp("finger"))


@pytest.fixture(scope="module")
def calibration(folder: Path) -> Calibration:
    """Return a calibration of benders with tolerances."""
    return calibrated(folder)


def known(logarithms: list[list[float]]) -> MeasuredLoads:
    """Return loads that are known exactly."""
    n = len(logarithms)
    return MeasuredLoads(
        np.full(n, 10), np.ones(n, np.bool_), np.array(logarithms),
        np.zeros((n, CONSTANTS, CONSTANTS)), np.zeros(n),
    )  # fmt: skip


# Measurement


@pytest.mark.ci
@pytest.mark.parametrize("finger", ["low", "high"])
def test_the_report_covers_the_finger(folder: Path, calibration: Calibration, finger: str) -> None:
    """Find Re k and Im k/ω within three stated deviations, which are small.

    At 1000 Hz, near the resonance where the baseline is not fitted, four are accepted: of the
    stiffest finger two do not hold for 80 % there.
    """
    url = f"sim:?finger={finger}&tolerance=1"
    report, _ = measure_finger(url, display_file(folder), calibration)
    assert report.known == 4
    assert report.voltage_v <= 20
    assert (report.seconds, report.windows) == (0.25, 10)
    frequency = np.array(REPORTED)
    true = getattr(FingerLoad, finger)().stiffness(frequency)
    for one in report.contactors:
        assert (one.touching, one.explained, one.note, one.windows) == (True, True, "", 10)
        for values, deviations, exact in (
            (one.stiffness_n_per_m, one.stiffness_deviation_n_per_m, true.real),
            (
                one.damping_n_s_per_m, one.damping_deviation_n_s_per_m,
                true.imag / (2 * np.pi * frequency),
            ),
        ):  # fmt: skip
            most = np.where(frequency < 1000, 3, 4) * np.array(deviations)
            assert np.all(np.abs(values - exact) < most)
            assert np.all(np.array(deviations)[1:] < 0.25 * exact[1:])
        assert one.level_deviation_db is not None
        assert 0.05 < one.level_deviation_db < 0.6


@pytest.mark.ci
def test_the_level_of_the_fixed_finger_is_that_of_the_displays_own(
    folder: Path, calibration: Calibration
) -> None:
    """Compare a stiff finger with the low one of the display file, on each true bender.

    A bender's own d31 and stiffness are in the level: ±10 % of d31 are ±0.9 dB. Here it is computed
    from the fitted deviations, which `tactile calibrate` is tested to find.
    """
    url = "sim:?finger=high&tolerance=1"
    report, _ = measure_finger(url, display_file(folder), calibration)
    frequency = np.geomspace(10, 1000, 25)
    force, stiffness = calibration.baseline.tip(frequency)
    own = force / (stiffness + FingerLoad.high().stiffness(frequency))
    expected = tip_response(Bimorph(), FingerLoad.low(), frequency).displacement
    level = 20 * np.log10(np.abs(own / expected)).mean(axis=1)
    found = [one.fixed_level_db for one in report.contactors]
    assert found == pytest.approx(level, abs=0.5)
    assert max(level) < -4


@pytest.mark.ci
def test_adjust_takes_over_the_finger(
    folder: Path, calibration: Calibration, command: Command
) -> None:
    """Play with an adjusted display as with the true finger, within `WITHIN`."""
    random = random_finger(3, 4)
    said = command(
        "finger", "sim:?finger=random:3&tolerance=1", *options(folder), "--csv", "finger.csv",
        "--plot", "finger.png",
    )  # fmt: skip
    assert said.code == 0
    assert "finger on 4 of 4 contactors" in " ".join(said.out.split())
    assert "written: finger.csv" in said.out
    assert Path("finger.png").read_bytes().startswith(b"\x89PNG")
    source = str(display_file(folder))
    command("adjust", "--load", "finger.csv", "--display", source, "--out", "mine.toml")
    frequency = np.geomspace(10, 1000, 30)
    played = tactile.load_display("mine.toml").responses(frequency, 8000.0)[0, 0]
    true = tip_response(Bimorph(), random, frequency).displacement
    median = np.median(20 * np.log10(np.abs(true)), axis=0)
    assert 20 * np.log10(np.abs(played)) == pytest.approx(median, abs=WITHIN)
    before = tactile.load_display(source).responses(frequency, 8000.0)[0, 0]
    assert np.abs(20 * np.log10(np.abs(before)) - median).max() > 5 * WITHIN


@pytest.mark.ci
def test_a_chosen_contactor_is_written(
    folder: Path, calibration: Calibration, command: Command
) -> None:
    """Write the third contactor alone, and refuse one that does not exist."""
    url, also = "sim:?finger=random:3&tolerance=1", options(folder)
    said = command("finger", url, *also, "--csv", "a.csv", "--contactor", "2", "--json")
    assert said.code == 0
    third = said.json["contactors"][2]
    constants = [third["constants"][name] for name in third["constants"]]
    written = load_measurement("a.csv", "displacement")
    k0, d0, k1, d1 = constants
    own = FingerLoad(k0=k0, d0=d0, branches=((k1, d1),))
    exact = tip_response(Bimorph(), own, written.frequency).displacement
    np.testing.assert_allclose(written.value, exact, rtol=2e-3)  # splines of the design
    said = command("finger", url, *also, "--csv", "b.csv", "--contactor", "4")
    assert (said.code, said.err) == (2, "tactile: contactor 4: the display has 0 … 3\n")


@pytest.mark.ci
def test_without_a_finger_one_line_says_so(
    folder: Path, calibration: Calibration, command: Command
) -> None:
    """Write neither response nor picture."""
    said = command(
        "finger", "sim:?finger=air&tolerance=1", *options(folder), "--csv", "a.csv",
        "--plot", "a.png",
    )  # fmt: skip
    assert said.code == 1
    assert said.out.splitlines() == [
        "nothing touches the display: rest a finger on it, and measure again",
        "a.csv: not written, since no contactor has a load that is known",
    ]
    assert not Path("a.csv").exists()
    assert not Path("a.png").exists()
    said = command("finger", "sim:?finger=air&tolerance=1", *options(folder), "--json")
    assert said.code == 1
    assert said.json["known"] == 0
    assert [one["touching"] for one in said.json["contactors"]] == [False] * 4
    assert [one["stiffness_n_per_m"] for one in said.json["contactors"]] == [None] * 4


@pytest.mark.ci
def test_a_finger_that_lifts_meanwhile_is_no_load(
    folder: Path, calibration: Calibration, command: Command
) -> None:
    """Lift 0.15 s after the begin of the drive, which 0.3 s at 0 V precede."""
    url = "sim:?finger=mid&tolerance=1&liftoff=0.45"
    said = command("finger", url, *options(folder))
    assert said.code == 1
    assert "contactors 0, 1, 2, 3: touched, or changed since the calibration" in said.out


# What cannot be measured


@pytest.mark.ci
def test_a_calibration_of_another_display_or_with_a_fault_is_refused(
    folder: Path, tmp_path: Path, calibration: Calibration
) -> None:
    load(tmp_path, contactors((0.0, 0.0, 0.0), (2.5, 0.0, 0.0)))
    with pytest.raises(InputError, match="of 4 channels, the display has 2"):
        measure_finger("sim:", display_file(tmp_path), calibration)
    faulty = replace(calibration.baseline, faults=("", "no bender", "", ""))
    with pytest.raises(InputError, match="has faults: contactor 1: no bender"):
        measure_finger("sim:", display_file(folder), replace(calibration, baseline=faulty))


@pytest.mark.ci
def test_currents_beyond_the_range_are_named(folder: Path, calibration: Calibration) -> None:
    """Drive capacitors that draw eight times what the drive allows for."""
    with pytest.raises(BusError, match=r"at most 0 can be used, below 5: the current was beyond"):
        measure_finger("mock:?load_pf=100000", display_file(folder), calibration)


@pytest.mark.ci
def test_windows_of_a_disturbed_drive_are_named(
    folder: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Take windows as they are when the amplifier has bridged samples: none is valid."""
    take = SumWindows.take

    def doubted(self: SumWindows) -> list[PlayedWindow]:
        return [
            replace(one, window=replace(one.window, valid=np.zeros(4, np.bool_)))
            for one in take(self)
        ]

    monkeypatch.setattr(SumWindows, "take", doubted)
    with pytest.raises(BusError, match="the drive was disturbed, or the link loses packets"):
        measure_finger("sim:?finger=mid", display_file(folder), calibration)


@pytest.mark.ci
def test_the_bus_is_opened_with_20_v(
    folder: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is that of the wiring, which the amplifier enforces too."""
    opened: list[Bus] = []

    def open_and_keep(*arguments: Any, **named: Any) -> Bus:
        opened.append(open_bus(*arguments, **named))
        return opened[-1]

    monkeypatch.setattr(current_measuring, "open_bus", open_and_keep)
    with pytest.raises(InputError, match="measures no currents"):
        measure_finger("mock:?format=pcm12", display_file(folder), calibration)
    measure_finger("sim:?finger=mid&tolerance=1", display_file(folder), calibration)
    assert [bus.wiring.voltage for bus in opened] == [20.0, 20.0]
    assert [bus.state for bus in opened] == ["closed", "closed"]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("there.csv", "already exists; --force overwrites it"),
        ("there.txt", "ends in .csv"),
        ("nowhere/there.csv", "no folder"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_played(
    folder: Path, tmp_path: Path, calibration: Calibration, name: str, why: str
) -> None:
    """Name a device that does not exist: it is never opened."""
    (tmp_path / "there.csv").touch()
    with pytest.raises(InputError, match=why):
        measure_finger("nothing:", display_file(folder), calibration, csv=tmp_path / name)


def test_what_the_command_needs_is_said_in_one_line(command: Command) -> None:
    said = command("finger", "sim:")
    assert said.code == 2
    assert "reference-24.sensing.npz: no such file" in said.err
    assert "tactile calibrate DEVICE --display reference-24" in said.err
    said = command("finger", "sim:", "--contactor", "1")
    assert (said.code, said.err) == (2, "tactile: --contactor: is used with --csv only\n")
    said = command("finger", "sim:", "--plot", "nowhere/a.png")
    assert said.code == 2
    assert "nowhere/a.png" in said.err


# Response


def test_a_response_is_that_of_the_design_under_the_load(tmp_path: Path) -> None:
    """Write the median of three loads, of which the middle one is the paper's stiff finger.

    The bender's splines over steps of 5 Hz are exact to 1e-4; digits in the file to 1e-6.
    """
    high = np.log([4300.0, 0.55, 5000.0, 2.0])
    loads = known([list(high - 0.7), list(high), list(high + 0.2)])
    display = tactile.load_display("reference-24")
    bender = bender_of(display.bimorph, display.amplifier, 8000.0)
    stiffness = typical_stiffness(loads, np.ones(3, np.bool_))
    save_response(tmp_path / "a.csv", bender, stiffness)
    written = load_measurement(tmp_path / "a.csv", "displacement")
    assert written.frequency == pytest.approx(FREQUENCY, rel=1e-5)
    exact = tip_response(display.bimorph, FingerLoad.high(), written.frequency).displacement
    np.testing.assert_allclose(written.value, exact, rtol=1e-3)
    softest = typical_stiffness(loads, np.array([True, False, False]))
    np.testing.assert_allclose(softest, stiffness * np.exp(-0.7), rtol=1e-9)
