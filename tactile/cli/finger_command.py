"""The command ``tactile finger``."""

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.options import (
    AcceptHold,
    AsJson,
    DisplayOption,
    Force,
    PlotOption,
    check_plot,
    emit,
    read_calibration,
)
from tactile.cli.printing import print_table, progress_bar, right
from tactile.errors import InputError

PRINTED = (100.0, 300.0)
"""Frequencies of which the load is printed [Hz]."""
NOTHING = "nothing touches the display: rest a finger on it, and measure again"
"""Line for a measurement without a finger."""


LEGEND = "k: stiffness Re k in N/m, d: damping Im k/ω in N s/m, ±: one standard deviation"
"""Line below the table."""


def run(
    url: Annotated[str, typer.Argument(help="URL of the device that drives the display.")],
    display: DisplayOption = "reference-24",
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="File of tactile calibrate; by default the name of the display with .sensing.npz."
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            help="Write the response of the display's bender under this finger to this CSV file, "
            "which tactile adjust --load reads. It is the median of the touched contactors.",
        ),
    ] = None,
    contactor: Annotated[
        int | None,
        typer.Option(help="Contactor whose load is written by --csv instead of the median."),
    ] = None,
    coupling: Annotated[
        bool,
        typer.Option(
            "--coupling",
            help="Also measure how strongly the skin couples neighboring contactors: 1.2 s more.",
        ),
    ] = False,
    plot: PlotOption = None,
    force: Force = False,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """Measure the finger that rests on a display.

    Rest a finger on the display and keep it still: for 0.25 s it buzzes softly, at 20 V or less.
    For each touched contactor it prints the real part of the dynamic stiffness of the load, its
    damping Im k/ω, and how well they are known, as one standard deviation. "level" is the same of
    the shear that is played for this load, and "fixed" the mean level at which the fixed finger of
    the display file plays. It needs the file that tactile calibrate has measured in air. The exit
    code is 1 if the load is known on no contactor, or not on that of --contactor.

    With --coupling it buzzes for 1.2 s more and prints how much of its own load a contactor feels
    from each neighbor that moves. The loads are then those of contactors whose neighbors rest.

    Example: tactile finger sim:?finger=mid --csv finger.csv --plot finger.png
    """
    from tactile.bringup.finger_measuring import measure_finger
    from tactile.display.display import load_display

    check_plot(plot)
    if contactor is not None and csv is None:
        raise InputError("--contactor: is used with --csv only")
    loaded = load_display(display)
    measured = read_calibration(calibration, loaded.name)
    with progress_bar(visible=not as_json) as bar:
        task = bar.add_task("keep still: measuring the finger", total=None)
        report, loads = measure_finger(
            url, display, measured, csv=csv, contactor=contactor, coupling=coupling, force=force,
            accept_unsafe_hold=accept_unsafe_hold,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    drawn = plot is not None and report.known > 0
    if plot is not None and drawn:
        from tactile.show.plots import finger_figure, save

        save(finger_figure(loads, loaded), plot)
    facts = report.as_dict()
    emit(facts, as_json, _print)
    if not as_json:
        _print_files(facts, csv, contactor, plot if drawn else None)
    known = report.known and (report.coupling is None or report.coupling.pairs)
    raise typer.Exit(0 if known and (csv is None or report.written) else 1)


def _print(r: dict[str, Any]) -> None:
    """Print the contactors of a report, or that nothing touches them."""
    from tactile.bringup.finger_measuring import IN_AIR

    if all(one["note"] == IN_AIR for one in r["contactors"]):
        print(NOTHING)
        return
    title = (
        f"{r['display']} at {r['device']}: finger on {r['known']} of {len(r['contactors'])} "
        "contactors"
    )
    places = [r["frequency_hz"].index(frequency) for frequency in PRINTED]
    headings = [f"{x}({f:g} Hz)" for f in PRINTED for x in "kd"]
    columns = right("contactor", *headings, "level dB", "fixed dB")
    rows = (_cells(one, places) for one in r["contactors"] if not one["note"])
    if r["known"]:
        print_table(columns, rows, title)
        print(LEGEND)
    for note, contactors in _by_note(r["contactors"]).items():
        print(f"contactor{'s' * (len(contactors) > 1)} {', '.join(contactors)}: {note}")
    if r.get("coupling"):
        _print_coupling(r["coupling"])


def _print_coupling(coupling: dict[str, Any]) -> None:
    """Print the couplings by direction and what they do, or why they are not known."""
    if coupling["note"]:
        print(f"coupling: {coupling['note']}")
        return
    for one in coupling["directions"]:
        x, y = one["along_x_mm"], one["along_y_mm"]
        where = f"{x:g} mm along x" if not y else f"{y:g} mm along y"
        where = f"{x:g} mm along x and {y:g} mm along y" if x and y else where
        pairs = f"{one['pairs']} pair{'s' * (one['pairs'] > 1)}"
        value = f"{one['coupling']:.3f} ± {one['deviation']:.3f}"
        print(f"coupling to the neighbor {where}: {value} ({pairs})")
    mean, worst = (round(coupling[name], 1) + 0 for name in ("together_db", "most_together_db"))
    print(
        f"where all contactors move alike, filters for each alone play {mean:+.1f} dB, and "
        f"{worst:+.1f} dB on the contactor that is farthest off"
    )


def _cells(one: dict[str, Any], places: list[int]) -> list[str]:
    """Return the cells of a contactor."""
    cells = [str(one["contactor"])]
    for place in places:
        k, spread_k, d, spread_d = (
            one[name][place]
            for name in (
                "stiffness_n_per_m", "stiffness_deviation_n_per_m",
                "damping_n_s_per_m", "damping_deviation_n_s_per_m",
            )
        )  # fmt: skip
        cells += [f"{k:.0f} ± {spread_k:.0f}", f"{d:.2f} ± {spread_d:.2f}"]
    return [*cells, f"± {one['level_deviation_db']:.2f}", f"{one['fixed_level_db']:+.1f}"]


def _by_note(contactors: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return the numbers of the contactors that have each note."""
    notes: dict[str, list[str]] = {}
    for one in contactors:
        if one["note"]:
            notes.setdefault(one["note"], []).append(str(one["contactor"]))
    return notes


def _print_files(
    r: dict[str, Any], csv: Path | None, contactor: int | None, plot: Path | None
) -> None:
    """Print which files were written, and why the response was not."""
    if r["written"] is not None:
        print(f"written: {r['written']}")
    elif csv is not None:
        of = "no contactor" if contactor is None else f"not contactor {contactor},"
        print(f"{csv}: not written, since {of} has a load that is known")
    if plot is not None:
        print(f"drawn: {plot}")
