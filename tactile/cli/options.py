"""Options that several commands take, and what they do."""

import json
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from tactile.errors import InputError

if TYPE_CHECKING:
    from tactile.sensing.baseline_file import Calibration

Facts = TypeVar("Facts")

TextureArgument = Annotated[
    str, typer.Argument(help="Name of a shipped texture, or path of a texture file (TOML).")
]
TextureOrEffect = Annotated[
    str,
    typer.Argument(
        help="Name of a shipped texture, or path of a texture file (TOML) or of an effect file."
    ),
]
DisplayOption = Annotated[
    str,
    typer.Option(
        "--display",
        help="Name of a shipped display (reference-24, reference-64), or path of a display file "
        "(TOML).",
    ),
]
SpeedOption = Annotated[
    float | None, typer.Option(help="Speed of the finger in mm/s; 80 by default.")
]
ForceOption = Annotated[
    float | None, typer.Option(help="Normal force of the finger in N; 0.5 by default.")
]
AngleOption = Annotated[
    float | None,
    typer.Option(help="Direction of the stroke in degrees from the x axis; 0 by default."),
]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", help="Write a plot to this PNG, SVG or PDF file.")
]
ReportOption = Annotated[
    Path | None,
    typer.Option("--report", help="Write a report with all results and plots to this HTML file."),
]
Force = Annotated[
    bool, typer.Option("--force", help="Overwrite the output file if it already exists.")
]
AcceptHold = Annotated[
    bool,
    typer.Option(
        "--accept-unsafe-hold",
        help="Accept an amplifier that keeps its last voltage when the host stops, or for which "
        "this is not known.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]

# Options of the commands about designs
Fixed = Annotated[
    list[str] | None,
    typer.Option(
        "--fix", help="Set a parameter to one value, as name=value. May be given several times."
    ),
]
StartDisplay = Annotated[
    str | None,
    typer.Option(
        "--display",
        help="Display whose bender, finger and limits are used where nothing else is given: name "
        "or TOML file.",
    ),
]
VoltageLimit = Annotated[
    float | None,
    typer.Option(
        help="Largest drive voltage in V; by default the limit of the display, or else 100."
    ),
]
CurrentLimit = Annotated[
    float | None,
    typer.Option(
        help="Largest current of one channel in mA; by default the limit of the display, or else "
        "none."
    ),
]
Amplitude = Annotated[
    float,
    typer.Option(help="Shear displacement in µm for which the drive voltage is computed."),
]


class Finger(StrEnum):
    """A finger that loads the tip of a bender, or none."""

    LOW = "low"
    HIGH = "high"
    AIR = "none"


def emit(facts: Facts, as_json: bool, show: Callable[[Facts], object]) -> None:
    """Print the result of a command, as JSON or for a person.

    Parameters
    ----------
    facts : the result, made of types that JSON has
    as_json : whether the option ``--json`` was given
    show : function that prints the result for a person
    """
    if as_json:
        print(json.dumps(facts))
    else:
        show(facts)


def within(name: str, value: float | None, low: float, high: float, default: float) -> float:
    """Return the value of an option after checking its limits.

    Parameters
    ----------
    name : name of the option, for the error message
    value : the value given by the user, or None
    low, high : least and greatest value that is allowed
    default : the value if none was given

    Returns
    -------
    float
        The value, or the default.

    Raises
    ------
    InputError
        If the value is outside the limits or is not a number.
    """
    if value is None:
        return default
    if not low <= value <= high:
        raise InputError(f"{name} {value:g}: must be between {low:g} and {high:g}")
    return value


def check_plot(plot: Path | None) -> None:
    """Check that a plot can be written, before anything is computed for it.

    Parameters
    ----------
    plot : file of the option ``--plot``, or None

    Raises
    ------
    InputError
        If matplotlib is not installed, the suffix is unknown or the folder does not exist.
    """
    if plot is not None:
        from tactile.show.plots import check_file

        check_file(plot)


def read_calibration(file: Path | None, display: str) -> "Calibration":
    """Read the calibration of a display, and say how to make it if there is none.

    Parameters
    ----------
    file : file of the option ``--calibration``, or None for where `tactile calibrate` writes it
    display : name of the display

    Returns
    -------
    Calibration
        Calibration.

    Raises
    ------
    InputError
        If there is no such file, or it is not a calibration.
    """
    from tactile.playback.finger_following import default_calibration
    from tactile.sensing.baseline_file import load_calibration

    path = file or default_calibration(display)
    if not path.exists():
        raise InputError(
            f"{path}: no such file; measure the display in air first: tactile calibrate DEVICE "
            f"--display {display}"
        )
    return load_calibration(path)


def check_outputs(out: Path | None, plot: Path | None, report: Path | None) -> None:
    """Check that the files of a study can be written, before anything is computed.

    Parameters
    ----------
    out : data file of the option ``--out``, or None
    plot : file of the option ``--plot``, or None
    report : file of the option ``--report``, or None

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    if out is not None:
        from tactile.study.storing import check_store

        check_store(out)
    check_plot(plot)
    if report is not None:
        from tactile.study.report import check_report

        check_report(report)
