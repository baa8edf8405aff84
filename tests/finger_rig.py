"""A display of four contactors with its calibration, on which fingers are measured."""

from pathlib import Path

from display_files import contactors, load

from tactile.bringup.calibrating import calibrate
from tactile.sensing.baseline_file import Calibration

PLACES = contactors((0.0, 0.0, 0.0), (2.5, 0.0, 0.0), (0.0, 3.5, 0.0), (2.5, 3.5, 0.0))


def display_in(folder: Path) -> Path:
    """Write the display into a folder, and return the folder."""
    load(folder, PLACES)
    return folder


def calibrated(folder: Path) -> Calibration:
    """Return the calibration of benders with tolerances, which is written beside the display."""
    url = "sim:?finger=air&tolerance=1"
    return calibrate(url, display_file(folder), write=folder / "four.sensing.npz")[1]


def display_file(folder: Path) -> Path:
    """Return the display's file."""
    (file,) = folder.glob("*.toml")
    return file


def options(folder: Path) -> list[str]:
    """Return the options that name display and calibration."""
    return [
        "--display", str(display_file(folder)),
        "--calibration", str(folder / "four.sensing.npz"),
    ]  # fmt: skip
