"""Every command of the README, the quick start and the guide runs as it is written, in one folder.

The files that the commands name are made before. A device that is not there is replaced by the
modeled amplifier; what cannot be run stands in `NOT_RUN` with the reason. The tutorials are run by
test_tutorials.py.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
import wave
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_readme import DOCUMENTS, make_recording, make_session

import tactile
from benchmarks.realism.learned import BandRegression, write_model
from tactile.bringup.calibrating import calibrate
from tactile.files import shipped

WRITTEN = sorted(
    {
        " ".join(command.partition(" #")[0].split())
        for name, text in DOCUMENTS.items()
        if name in ("README.md", "docs/quickstart.md") or name.startswith("docs/guide/")
        for command in [
            *re.findall(r"(?<!`)`(tactile [^`]+ [^`]+)`", text),
            *re.findall(r"^(tactile .+)", text.replace("\\\n", " "), re.MULTILINE),
        ]
    }
)
COMMANDS = [c for c in WRITTEN if not any(other.startswith(f"{c} ") for other in WRITTEN)]
"""Commands of the documents, without those that another one begins with."""
NOT_RUN = {
    "tactile serve --config packaging/tactile.toml": "runs until it is ended (test_server_running)",
    "tactile serve --config lab.toml": "runs until it is ended (test_psychopy_example)",
    "tactile show wood-oak --live": "runs until it is ended (test_cli_show)",
    "tactile lsl left --start-from triggers --start go=tap": "runs until it is ended (test_lsl)",
    "tactile jack left": "runs until it is ended (test_jack)",
    "tactile clear --device URL": "a form and no command",
    "tactile play wood-oak --device serial://PATH": "a form and no command",
    "tactile study … -o study.zarr --scheduler tcp://host:8786": "needs a cluster",
}
"""Reason why a command is not run, by the command."""
REPLACED = {
    "serial:///dev/ttyACM0?": "mock:?link=serial&",
    "serial:///dev/ttyACM0": "mock:?link=serial",
    "package.module:": "plant:",
    "--finger follow": "--finger follow --calibration in-air.npz",
    "tactile finger ": "tactile finger --calibration in-air.npz ",
    "--load finger.csv": "--load measured.csv",
}
"""What replaces a part of a command that does not exist here, by that part."""
ENDS_WITH = {"tactile estop": (1, "no tactile program that can be stopped is running")}
"""Exit code and beginning of the error of a command that does not end with 0."""
PLANT = "from tactile.sim import default_plant as factory\n"
"""Module with the factory of a plant."""
TAP = {
    "Version": 1.0,
    "Pattern": [
        {
            "Event": {
                "Time": 0.0, "EventType": "HapticTransient",
                "EventParameters": [{"ParameterID": "HapticIntensity", "ParameterValue": 0.5}],
            }
        }
    ],
}  # fmt: skip
"""Effect of one tap in the format AHAP."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with every file that the commands name."""
    place = tmp_path_factory.mktemp("commands")
    display = next(shipped("displays").rglob("reference-24.toml"))
    shutil.copy(display, place / "my-display.toml")
    rows = (f"{t / 100},{0.8 * t},0,0.5\n" for t in range(31))
    (place / "slide.csv").write_text("time_s,x_mm,y_mm,normal_force_n\n" + "".join(rows))
    make_session(place)
    rng = np.random.default_rng(0)
    for name in ("a.wav", "b.wav"):
        with wave.open(str(place / name), "wb") as file:
            file.setparams((1, 2, 10_000, 0, "NONE", ""))
            file.writeframes(rng.normal(0, 1000, 40_000).astype("<i2").tobytes())
    (place / "plant.py").write_text(PLANT)
    (place / "tap.ahap").write_text(json.dumps(TAP))
    Image.fromarray(rng.integers(0, 255, (450, 450), np.uint8)).save(place / "map.png")
    falling = BandRegression(
        center=1e3 * 10 ** (np.arange(-3, 9) / 10), weight=np.full((2, 12), -1.0),
        level=np.linspace(-60, -90, 12), speed=(0.02, 0.06), force=(0.5, 0.5),
    )  # fmt: skip
    write_model(place / "model.onnx", falling, source="a straight line")
    make_recording(place / "oak.h5")
    (place / "measured.csv").write_text(measured())
    calibrate("sim:?finger=air&tolerance=1", "reference-24", write=place / "in-air.npz")
    return place


def measured() -> str:
    """Return a measurement of the tip of the default bender under a firm finger."""
    frequency = np.geomspace(10, 1000, 40)
    response = tactile.tip_response(tactile.Bimorph(), tactile.FingerLoad.high(), frequency)
    rows = (
        f"{f},{abs(x)},{np.degrees(np.angle(x))},m/V\n"
        for f, x in zip(frequency, response.displacement, strict=True)
    )
    return "frequency_hz,magnitude,phase_deg,unit\n" + "".join(rows)


@pytest.mark.ci
@pytest.mark.parametrize("command", COMMANDS)
def test_it_runs(
    command: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if command in NOT_RUN:
        pytest.skip(NOT_RUN[command])
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    run = command
    for part, replacement in REPLACED.items():
        run = run.replace(part, replacement)
    done = subprocess.run(
        [sys.executable, "-m", *shlex.split(run)],
        cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    code, error = ENDS_WITH.get(command, (0, ""))
    assert done.returncode == code, done.stderr
    assert done.stderr.startswith(error)


def test_what_is_not_run_stands_in_the_documents() -> None:
    assert set(NOT_RUN) <= set(COMMANDS)
    assert len(COMMANDS) > 25
