"""A display is calibrated in air, and what plays then follows the finger; the commands for both.

The simulated display is the product's own model of it, `TouchedPlant`, which shares neither
admittances nor loads with the estimator, and its currents come through the protocol. Figures on an
independent plant are those of ``python -m benchmarks sensing``.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command
from display_files import contactors, load

from tactile.actuator.finger import FingerLoad
from tactile.actuator.hysteresis import RADII, Hysteresis
from tactile.actuator.tolerances import Tolerances
from tactile.arrays import Floats
from tactile.bringup import current_measuring
from tactile.bringup.calibrating import CalibrationReport, calibrate
from tactile.bringup.current_measuring import MeasuringDevice
from tactile.bringup.finger_measuring import REPORTED, measure_finger
from tactile.bus.base import Bus
from tactile.devices import open_bus
from tactile.errors import InputError
from tactile.playback.runs import Summary, run
from tactile.rendering.contact import Trajectory
from tactile.sensing.baseline_file import Calibration, load_calibration
from tactile.texture.surface import load_texture

PLACES = contactors((0.0, 0.0, 0.0), (2.5, 0.0, 0.0), (5.0, 0.0, 0.0), (7.5, 0.0, 0.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a display of four contactors."""
    at = tmp_path_factory.mktemp("calibrated")
    load(at, PLACES)
    return at


def display_file(folder: Path) -> Path:
    (found,) = folder.glob("*.toml")
    return found


@pytest.fixture(scope="module")
def calibrated(folder: Path) -> tuple[CalibrationReport, Calibration]:
    """Return a calibration of benders with tolerances."""
    url = "sim:?finger=air&tolerance=5"
    return calibrate(url, display_file(folder), write=folder / "four.sensing.npz")


def stroke(folder: Path, device: str, calibration: Calibration | None, seconds: float) -> Summary:
    display = load(folder, PLACES)
    trajectory = Trajectory.line(speed=0.08, duration=seconds)
    texture = load_texture("wood-oak")
    return run(display, texture, trajectory, device=device, calibration=calibration)


def level(summary: Summary) -> float:
    """Return the level of the played vibration re the commanded one [dB]."""
    assert summary.played is not None
    assert summary.commanded is not None
    return 20 * float(
        np.log10(summary.played.vibration_um_rms / summary.commanded.vibration_um_rms)
    )


# Calibration


@pytest.mark.ci
def test_the_calibration_finds_the_benders(
    folder: Path, calibrated: tuple[CalibrationReport, Calibration]
) -> None:
    """Resonances move with the root of stiffness over mass; cables add to the capacitance.

    Of d31 and mass, current tells only d31² over the mass, so that 1 % of mass is 0.5 % of d31.
    """
    report, calibration = calibrated
    true = Tolerances.drawn(4, 5)
    assert report.faults == []
    assert report.written == str(folder / "four.sensing.npz")
    resonance = [one.resonance_hz / report.design_resonance_hz for one in report.contactors]
    assert resonance == pytest.approx(np.sqrt(true.stiffness / true.mass), rel=2e-3)
    d31 = [one.d31 for one in report.contactors]
    assert d31 == pytest.approx(true.d31 / np.sqrt(true.mass), rel=0.02)
    noise = [one.noise_ua for one in report.contactors]
    assert noise == pytest.approx(np.full(4, 2500 / 2**11 * np.sqrt(1 + 1 / 12)), rel=0.15)
    assert report.voltage_v == 100
    assert [one.hysteresis_percent for one in report.contactors] == [0.0] * 4
    loaded = load_calibration(folder / "four.sensing.npz")
    assert np.array_equal(loaded.baseline.capacitance, calibration.baseline.capacitance)


@pytest.fixture(scope="module")
def looped(folder: Path) -> tuple[CalibrationReport, Calibration]:
    """Return a calibration of the same benders with a hysteresis of 13 % at 104 V."""
    return calibrate("sim:?finger=air&tolerance=5&hysteresis=0.13", display_file(folder))


@pytest.mark.ci
def test_hysteresis_is_measured_and_changes_nothing_else(
    calibrated: tuple[CalibrationReport, Calibration],
    looped: tuple[CalibrationReport, Calibration],
) -> None:
    """Compare with the loop of the plant's own plays, and with benders that have none."""
    plays = Hysteresis(width=0.13, full_drive=104.0)
    radii, limit = np.minimum(104.0 * RADII, 100.0), 100.0
    apart = plays.weights @ np.minimum(radii, limit - radii)
    width = apart / (limit + plays.weights @ (limit - radii))
    report, plain = looped[0], calibrated[0]
    assert report.faults == []
    assert [one.hysteresis_percent for one in report.contactors] == pytest.approx(
        [100 * width] * 4, abs=0.2
    )
    for name in ("capacitance_nf", "d31", "resonance_hz", "stiffness"):
        found, true = ([getattr(one, name) for one in each.contactors] for each in (report, plain))
        assert found == pytest.approx(true, rel=6e-3)


@pytest.mark.ci
def test_hysteresis_that_could_not_be_measured_is_a_fault(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lose the windows of the second measurement: nothing is said to have no hysteresis."""
    played = MeasuringDevice.play

    def lossy(device: MeasuringDevice, drive: Floats, *rest: Any, **named: Any) -> Any:
        windows = played(device, drive, *rest, **named)
        if np.abs(drive).max(initial=0) > 20:
            windows = [replace(w, clipped=~w.clipped) for w in windows]
        return windows

    monkeypatch.setattr(MeasuringDevice, "play", lossy)
    target = folder / "lossy.npz"
    report, _ = calibrate("sim:?finger=air", display_file(folder), write=target)
    assert len(report.faults) == 4
    assert all("hysteresis not known" in fault for fault in report.faults)
    assert not target.exists()


@pytest.mark.ci
def test_what_follows_inverts_the_hysteresis(
    folder: Path, looped: tuple[CalibrationReport, Calibration]
) -> None:
    """Play oak: neither vibration nor stretch grows with the loop, and no guard judges.

    Without the inverse the stretch of the skin is a third too large.
    """
    device = "sim:?finger=random:3&tolerance=5&hysteresis=0.13"
    follows = stroke(folder, device, looped[1], 1.5)
    assert abs(level(follows)) < 0.3
    assert follows.played is not None
    assert follows.commanded is not None
    assert follows.played.drag_um == pytest.approx(follows.commanded.drag_um, rel=0.06)
    figures = follows.following
    assert figures is not None
    assert figures.unexplained_share < 0.02
    assert (figures.touched_share, figures.lifted, figures.guarded) == (1.0, 0, 0)


@pytest.mark.ci
@pytest.mark.parametrize("finger", ["low", "high"])
def test_finger_is_measured_in_spite_of_hysteresis(
    folder: Path, looped: tuple[CalibrationReport, Calibration], finger: str
) -> None:
    """Find the stiffness at 100 Hz within 12 % with a loop of 13 %, where none was found before."""
    device = f"sim:?finger={finger}&tolerance=5&hysteresis=0.13"
    report, _ = measure_finger(device, display_file(folder), looped[1])
    at = REPORTED.index(100)
    true = getattr(FingerLoad, finger)().stiffness(np.array([100.0])).real
    assert report.known == 4
    found = [(one.stiffness_n_per_m or [])[at] for one in report.contactors]
    assert found == pytest.approx(list(true) * 4, rel=0.12)


@pytest.mark.ci
def test_a_display_that_is_touched_is_refused(folder: Path, command: Command) -> None:
    """Each contactor is named, nothing is written, and no more than 20 V have been played."""
    source = str(display_file(folder))
    said = command("calibrate", "sim:?finger=mid", "--display", source, "--out", "touched.npz")
    assert float(re.findall(r"([\d.]+) V", said.out)[0]) <= 20
    assert said.code == 1
    named = re.findall(r"fault: contactors? ([\d, ]+):", said.out)
    assert sorted(", ".join(named).split(", ")) == ["0", "1", "2", "3"]
    assert "touched" in said.out
    assert "not written" in said.out
    assert not Path("touched.npz").exists()


@pytest.mark.ci
def test_the_command_writes_a_file_and_a_picture(folder: Path, command: Command) -> None:
    source = str(display_file(folder))
    said = command(
        "calibrate", "sim:?finger=air", "--display", source, "--out", "my.npz", "--plot", "my.png",
        "--json",
    )  # fmt: skip
    assert said.code == 0
    facts = json.loads(said.out)
    assert facts["written"] == "my.npz"
    assert [one["contactor"] for one in facts["contactors"]] == [0, 1, 2, 3]
    assert Path("my.npz").exists()
    assert Path("my.png").read_bytes().startswith(b"\x89PNG")


def test_the_bus_is_opened_with_20_v(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is that of the wiring, which the amplifier enforces too."""
    opened: list[Bus] = []

    def open_and_keep(*arguments: Any, **named: Any) -> Bus:
        opened.append(open_bus(*arguments, **named))
        return opened[-1]

    monkeypatch.setattr(current_measuring, "open_bus", open_and_keep)
    with pytest.raises(InputError):
        calibrate("mock:", display_file(folder))
    assert opened[0].wiring.voltage == 20.0
    assert opened[0].state == "closed"


def test_what_measures_no_currents_cannot_be_calibrated(folder: Path) -> None:
    with pytest.raises(InputError, match="measures no currents"):
        calibrate("mock:", display_file(folder))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("there.npz", "already exists; --force overwrites it"),
        ("there.txt", "ends in .npz"),
        ("nowhere/there.npz", "no folder"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_played(
    folder: Path, tmp_path: Path, name: str, why: str
) -> None:
    """Name a device that does not exist: it is never opened."""
    (tmp_path / "there.npz").touch()
    with pytest.raises(InputError, match=why):
        calibrate("nothing:", display_file(folder), write=tmp_path / name)


# Following


@pytest.mark.ci
@pytest.mark.parametrize("options", ["finger=random:3", "finger=random:8&force=0.5:1&period=1"])
def test_what_follows_the_finger_plays_what_is_commanded(
    folder: Path, calibrated: tuple[CalibrationReport, Calibration], options: str
) -> None:
    """Vibration within 0.5 dB, where it is off by 2 dB with the finger of the display file."""
    device = f"sim:?{options}&tolerance=5"
    fixed = stroke(folder, device, None, 1.5)
    follows = stroke(folder, device, calibrated[1], 1.5)
    assert fixed.following is None
    assert abs(level(fixed)) > 2
    assert abs(level(follows)) < 0.5
    assert follows.device == device
    figures = follows.following
    assert figures is not None
    assert figures.windows >= 55
    assert figures.dropped_windows == 0
    assert figures.unexplained_share < 0.02
    assert (figures.touched_share, figures.lifted, figures.touched) == (1.0, 0, 0)
    assert figures.deviation_db is not None
    assert 0.1 < figures.deviation_db < 2.0


@pytest.mark.ci
def test_lift_off_and_touch_are_counted(
    folder: Path, calibrated: tuple[CalibrationReport, Calibration]
) -> None:
    """Lift off from 0.5 s to 0.8 s of 1.2 s, on each of four contactors."""
    device = "sim:?finger=mid&liftoff=0.5&retouch=0.8&tolerance=5"
    figures = stroke(folder, device, calibrated[1], 1.2).following
    assert figures is not None
    assert (figures.lifted, figures.touched) == (4, 4)
    assert figures.touched_share == pytest.approx(0.75, abs=0.05)


@pytest.mark.ci
def test_the_command_tells_how_the_finger_was_followed(
    folder: Path, calibrated: tuple[CalibrationReport, Calibration], command: Command
) -> None:
    assert calibrated[0].written is not None
    said = command(
        "play", "wood-oak", "--seconds", "0.5", "--display", str(display_file(folder)),
        "--device", "sim:?finger=low&tolerance=5", "--finger", "follow",
        "--calibration", calibrated[0].written,
    )  # fmt: skip
    assert said.code == 0
    assert re.search(r"^gain +1 *$", said.out, re.MULTILINE)
    assert "follows the finger, to ± " in said.out
    assert "on 100% of the contactors" in said.out


@pytest.mark.ci
def test_a_calibration_is_that_of_the_display_and_of_the_device(
    folder: Path, tmp_path: Path, calibrated: tuple[CalibrationReport, Calibration]
) -> None:
    """Another display, a device without currents, and a recording are refused in one line."""
    other = load(tmp_path, contactors((0.0, 0.0, 0.0), (2.5, 0.0, 0.0)))
    texture, path = load_texture("wood-oak"), Trajectory.line(speed=0.08, duration=0.2)
    with pytest.raises(InputError, match="of 4 "):
        run(other, texture, path, calibration=calibrated[1])
    with pytest.raises(InputError, match="the device measures no currents"):
        stroke(folder, "mock:", calibrated[1], 0.2)
    with pytest.raises(InputError, match="--record"):
        run(load(folder, PLACES), texture, path, calibration=calibrated[1], record="a.npz")


def test_options_of_following_that_do_not_fit(command: Command) -> None:
    said = command("play", "wood-oak", "--finger", "follow", "--seconds", "0.2")
    assert said.code == 2
    assert "reference-24.sensing.npz: no such file" in said.err
    assert "tactile calibrate DEVICE --display reference-24" in said.err
    said = command("play", "wood-oak", "--calibration", "a.npz", "--seconds", "0.2")
    assert said.code == 2
    assert "--calibration: is used with --finger follow only" in said.err
