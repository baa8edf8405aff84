"""A display of voice coils: given by measured responses, rendered and simulated like any other.

The measurement is that of a mass on a spring, whose response is known in closed form.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from display_files import GRID, HEAD
from scipy.signal import lsim

import tactile
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Complex, Floats
from tactile.bringup.probe import FREQUENCY, judge, load_of
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.playback.runs import run
from tactile.sim import default_plant

RATE = 8000.0
MASS, DAMPING, STIFFNESS, FORCE = 2e-3, 1.5, 1200.0, 0.1
"""Mass [kg], damping [N s/m] and stiffness [N/m] of coil and skin, and force per volt [N/V]."""
COIL = """[voice_coil]
response = "coil.csv"
resistance_ohm = 8.0
inductance_mh = 0.2
current_a = 0.5
size_mm = [1.4, 1.4]
"""
FINGER = '[finger]\npreset = "low"\n'
LIMITS = "[limits]\nvoltage_v = 3.0\nslew_v_per_us = 0.1\n"


def exact(frequency: Floats) -> Complex:
    """Return displacement per volt of the mass on the spring [m/V]."""
    omega = 2 * np.pi * frequency
    return np.asarray(FORCE / (STIFFNESS - MASS * omega**2 + 1j * omega * DAMPING))


def coil_display(
    folder: Path, *, coil: str = COIL, limits: str = LIMITS, more: str = ""
) -> Display:
    """Return a display of voice coils, written as a file with its measurement."""
    frequency = np.geomspace(15, 1200, 400)
    response = exact(frequency)
    lines = [
        f"{f},{abs(r) * 1e6},{np.degrees(np.angle(r))},um/V"
        for f, r in zip(frequency, response, strict=True)
    ]
    text = "\n".join(["frequency_hz,magnitude,phase_deg,unit", *lines])
    (folder / "coil.csv").write_text(text, encoding="utf-8")
    path = folder / "coils.toml"
    path.write_text("\n".join([HEAD, GRID, FINGER, limits, coil, more]), encoding="utf-8")
    return tactile.load_display(path)


def test_the_equalizer_is_given_the_measured_response(tmp_path: Path) -> None:
    display, frequency = coil_display(tmp_path), np.linspace(20, 1000, 300)
    assert display.responses(frequency, RATE)[0, 0] == pytest.approx(exact(frequency), rel=2e-3)
    assert display.slew == display.limits.slew, "no capacitance is charged"
    with pytest.raises(InputError, match="its actuators are not bimorphs"):
        _ = display.bimorph


def test_the_simulation_has_the_measured_response(tmp_path: Path) -> None:
    """The reference is the equation of motion of the mass, integrated by scipy."""
    display = coil_display(tmp_path)
    plant = default_plant(display, RATE)
    time = np.arange(8000) / RATE
    drive = np.sin(2 * np.pi * (20 * time + 240 * time**2)) * np.hanning(len(time))  # to 500 Hz
    _, moved, _ = lsim(([FORCE], [MASS, DAMPING, STIFFNESS]), drive, time)
    count = len(display.contactors)
    padded = np.pad(drive, (0, plant.delay))[:, None] * np.ones(count)
    parts = [plant.step(part) for part in np.array_split(padded, 37)]
    shear = np.concatenate([shear for shear, _ in parts])[plant.delay :]
    assert shear.shape == (len(drive), count)
    error = np.sqrt(np.mean((shear[:, 0] - moved) ** 2) / np.mean(moved**2))
    assert error < 0.01
    current = np.concatenate([current for _, current in parts])[plant.delay :, 0]
    _, exact_current, _ = lsim(([1.0], [0.2e-3, 8.0]), drive, time)
    assert current == pytest.approx(exact_current, abs=0.01 * np.abs(exact_current).max())


def test_a_texture_is_played_as_commanded(tmp_path: Path) -> None:
    display = coil_display(tmp_path)
    line = tactile.Trajectory.line(speed=0.08, duration=1.0)
    texture = tactile.load_texture("wood-oak")
    drive = tactile.render(display, texture, line).drive
    assert 0.01 < np.abs(drive).max() <= 3.0
    summary = run(display, tactile.amplified(texture, 0.2), line, device="sim:")
    assert summary.signal_to_error_db is not None
    stated = 10 ** (summary.equalizer_error_db / 20) - 1
    assert stated < 0.05
    assert summary.signal_to_error_db > -20 * np.log10(stated)
    assert json.dumps(summary.as_dict())


def test_more_than_the_coil_withstands_is_refused(tmp_path: Path) -> None:
    limits = LIMITS.replace("3.0", "4.4")
    with pytest.raises(InputError) as caught:
        coil_display(tmp_path, limits=limits)
    refused = "limits.voltage_v = 4.4: 0.55 A through the coil exceeds 0.5 A; at most 4 V"
    assert str(caught.value).endswith(refused)


def test_the_current_limit_of_the_amplifier_holds_for_a_coil_too(tmp_path: Path) -> None:
    """A slew limit holds the current into a capacitance, but not that into a coil."""
    coil_display(tmp_path, limits=LIMITS + "current_ma = 375.0\n")
    with pytest.raises(InputError) as caught:
        coil_display(tmp_path, limits=LIMITS + "current_ma = 100.0\n")
    refused = "limits.voltage_v = 3: 0.375 A through the coil exceeds 0.1 A; at most 0.8 V"
    assert str(caught.value).endswith(refused)


def test_a_coil_that_does_not_fit_its_opening_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the actuator with its travel needs"):
        coil_display(tmp_path, coil=COIL.replace("[1.4, 1.4]", "[20.0, 2.0]"))


def test_a_display_has_one_kind_of_actuator(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has both \[bimorph\] and \[voice_coil\]"):
        coil_display(tmp_path, more="[bimorph]\nlength_mm = 20.0\n")


def test_a_line_is_judged_by_the_coils_admittance(tmp_path: Path) -> None:
    display = coil_display(tmp_path)
    free = display.actuator.response(FingerLoad.none(), np.array([FREQUENCY]))
    admittance = complex(free.admittance[0])
    positions: Floats = np.arange(200, dtype=np.float64) * 13.0
    angle: Floats = 2 * np.pi * FREQUENCY * positions / RATE
    for share, verdict in (
        (1.0, "good"),
        (1.05, "good"),
        (3.0, "off"),
        (20.0, "short"),
        (0.01, "open"),
    ):
        turned: Floats = share * abs(admittance) * np.cos(angle + np.angle(admittance))
        load = load_of(positions, 3.0 * np.cos(angle), 3.0 * turned, sample_rate=RATE)
        assert judge(load, drive=3.0, admittance=admittance) == verdict, share
