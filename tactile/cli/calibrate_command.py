"""The command ``tactile calibrate``."""

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.options import AcceptHold, AsJson, DisplayOption, Force, PlotOption, emit
from tactile.cli.printing import print_table, progress_bar, right

COLUMNS = {
    "contactor": ("contactor", "d"),
    "channel": ("channel", "d"),
    "capacitance_nf": ("C nF", ".2f"),
    "loss": ("tan δ", ".3f"),
    "resonance_hz": ("f1 Hz", ".1f"),
    "stiffness": ("stiffness", ".3f"),
    "d31": ("d31", ".3f"),
    "mechanical_loss": ("damping", ".2f"),
    "hysteresis_percent": ("hysteresis %", ".1f"),
    "skew_us": ("skew µs", ".2f"),
    "noise_ua": ("noise µA", ".2f"),
}
"""Heading and format of each value that is printed of a contactor."""


def run(
    url: Annotated[str, typer.Argument(help="URL of the device that drives the display.")],
    display: DisplayOption = "reference-24",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="File to write, ending in .npz; by default the name of the display with "
            ".sensing.npz, where tactile play looks for it.",
        ),
    ] = None,
    plot: PlotOption = None,
    force: Force = False,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """Measure the benders of a display in air.

    What they draw in air is what `tactile play --finger follow` needs to know. Take your hands off
    the display: nothing may touch it. The drive is at most 20 V, and then, if no contactor has a
    fault, a tone of 40 Hz up to the limit of the display, which measures the hysteresis.
    Stiffness, d31 and damping are printed as factors against the design. The exit code is 1, and
    nothing is written, if a contactor has a fault.

    Example: tactile calibrate sim:?finger=air --plot calibration.png
    """
    from tactile.bringup.calibrating import calibrate
    from tactile.cli.options import check_plot
    from tactile.display.display import load_display
    from tactile.playback.finger_following import default_calibration

    check_plot(plot)
    target = out or default_calibration(load_display(display).name)
    with progress_bar(visible=not as_json) as bar:
        task = bar.add_task("hands off: measuring in air", total=None)
        report, calibration = calibrate(
            url, display, write=target, force=force, accept_unsafe_hold=accept_unsafe_hold,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    if plot is not None:
        from tactile.show.plots import calibration_figure, save

        save(calibration_figure(calibration), plot)
    emit(report.as_dict(), as_json, _print)
    if plot is not None and not as_json:
        print(f"drawn: {plot}")
    raise typer.Exit(1 if report.faults else 0)


def _print(r: dict[str, Any]) -> None:
    """Print the contactors and the faults of a report."""
    from tactile.sensing.guard import WIDEST_LOOP

    title = (
        f"{r['display']} at {r['device']}, in air: {r['seconds']:.1f} s, {r['voltage_v']:.1f} V "
        f"and {r['range_ma']:g} mA at most"
    )
    rows = (
        [format(one[name], kind) for name, (_, kind) in COLUMNS.items()] for one in r["contactors"]
    )
    print_table(right(*(heading for heading, _ in COLUMNS.values())), rows, title)
    print(
        f"design: {r['design_capacitance_nf']:.2f} nF, resonance "
        f"{r['design_resonance_hz']:.1f} Hz in air"
    )
    if max(one["hysteresis_percent"] for one in r["contactors"]) > 100 * WIDEST_LOOP:
        print(
            f"hysteresis above {WIDEST_LOOP:.0%}: guards of amplifiers are not set, the limiter "
            "bounds the travel of free tips"
        )
    for fault, contactors in _by_fault(r["contactors"]).items():
        print(f"fault: contactor{'s' * (len(contactors) > 1)} {', '.join(contactors)}: {fault}")
    print(f"written: {r['written']}" if r["written"] else "not written, because of the faults")


def _by_fault(contactors: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return the numbers of the contactors that have each fault."""
    faults: dict[str, list[str]] = {}
    for one in contactors:
        if one["fault"]:
            faults.setdefault(one["fault"], []).append(str(one["contactor"]))
    return faults
