"""The command ``adjust``: a display's finger or bimorph, fitted to what was measured of it."""

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, DisplayOption, app
from tactile.display.edit import write_tables
from tactile.errors import InputError

if TYPE_CHECKING:
    from tactile.study.admittance_fit import BimorphFit
    from tactile.study.load_fit import LoadFit

STIFFNESS = "s11e_um2_per_n"


class Tip(StrEnum):
    """What is on the tip while a bimorph is measured."""

    LOW = "low"
    HIGH = "high"
    AIR = "none"


@app.command("adjust")
def adjust_display(
    load: Annotated[
        Path | None, typer.Option(help="CSV of the loaded tip: fits the finger's load.")
    ] = None,
    admittance: Annotated[
        Path | None, typer.Option(help="CSV of the electrical admittance: fits the bimorph.")
    ] = None,
    velocity: Annotated[
        Path | None, typer.Option(help="CSV of the tip's motion: fits the bimorph.")
    ] = None,
    finger: Annotated[
        Tip, typer.Option(help="On the tip with --admittance and --velocity: low, high or none.")
    ] = Tip.AIR,
    stiffness: Annotated[
        bool, typer.Option("--stiffness", help="Fit s11E too, so that the resonance may move.")
    ] = False,
    branches: Annotated[
        int | None, typer.Option(help="Of the load, 1 to 3; as many as tell by default.")
    ] = None,
    display: DisplayOption = "reference-24",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Display file to write, with the result.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw it to a PNG, SVG or PDF.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
    as_json: AsJson = False,
) -> None:
    """Fit a display's finger, or its bimorph, to CSVs of frequency_hz, magnitude, phase_deg, unit.

    Volts are those at the bimorph's electrodes.

    Example: tactile adjust --load finger.csv --display reference-24 --out mine.toml --plot fit.png
    """
    _check_options(load, admittance, velocity, stiffness=stiffness, branches=branches)
    if plot is not None:
        from tactile.show.plots import check_file

        check_file(plot)
    shown = tactile.load_display(display)
    result: LoadFit | BimorphFit
    if load is not None:
        result, tables = _fit_finger(shown, load, branches)
    else:
        air = getattr(tactile.FingerLoad, finger.value)()
        result, tables = _fit_bender(shown, admittance, velocity, air, stiffness=stiffness)
    if out is not None:
        write_tables(display, out, **tables, force=force)
    if plot is not None:
        from tactile.study.plots import plot_adjusted

        plot_adjusted(plot, result.comparisons)
    if as_json:
        typer.echo(json.dumps(_facts(result)))
        return
    _print_result(result, shown.name)
    for done, path in (("written", out), ("drawn", plot)):
        if path is not None:
            typer.echo(f"{done}: {path}")


def _check_options(
    load: Path | None,
    admittance: Path | None,
    velocity: Path | None,
    *,
    stiffness: bool,
    branches: int | None,
) -> None:
    """Refuse options that do not go together."""
    electric = admittance is not None or velocity is not None
    if (load is not None) == electric:
        raise InputError("needs either --load, or --admittance or --velocity or both")
    if branches is not None and load is None:
        raise InputError("--branches is for --load")
    if stiffness and load is not None:
        raise InputError("--stiffness is for --admittance and --velocity")


def _fit_finger(
    shown: tactile.Display, path: Path, branches: int | None
) -> tuple["LoadFit", dict[str, Any]]:
    """Return the fit of a load, and what it says in a display file."""
    from tactile.study.load_fit import KINDS, fit_load
    from tactile.study.measurement import load_measurement

    measured = load_measurement(path, *KINDS)
    before = shown.load_at(shown.load_forces[0])
    fit = fit_load(shown.bimorph, measured, branches=branches, before=before)
    k0, d0, *rest = (_rounded(c.value) for c in fit.constants)
    pairs = list(zip(rest[::2], rest[1::2], strict=True))
    return fit, {"finger": {"k0_n_per_m": k0, "d0_n_s_per_m": d0, "branches": pairs}}


def _fit_bender(
    shown: tactile.Display,
    admittance: Path | None,
    velocity: Path | None,
    load: tactile.FingerLoad,
    *,
    stiffness: bool,
) -> tuple["BimorphFit", dict[str, Any]]:
    """Return the fit of a bimorph, and what it says in a display file."""
    from tactile.study.admittance_fit import ADJUSTED, fit_bimorph
    from tactile.study.measurement import load_measurement

    told = [
        None if admittance is None else load_measurement(admittance, "admittance"),
        None if velocity is None else load_measurement(velocity, "velocity", "displacement"),
    ]
    names = (*ADJUSTED, STIFFNESS) if stiffness else ADJUSTED
    measured = [(one, load) for one in told if one is not None]
    fit = fit_bimorph(shown.bimorph, measured, names=names)
    return fit, {"bimorph": {c.name: _rounded(c.value) for c in fit.constants}}


def _rounded(value: float) -> float:
    """Return a value with six digits, more than any fit tells."""
    return float(f"{value:.6g}")


def _facts(fit: "LoadFit | BimorphFit") -> dict[str, Any]:
    return {
        "constants": {
            c.name: {
                "value": c.value, "low": c.low, "high": c.high if math.isfinite(c.high) else None,
                "start": c.start, "known": c.known,
            }
            for c in fit.told
        },
        "misfit": {
            c.measurement.name: {
                "rms_db": c.rms_db, "worst_db": c.worst_db, "start_rms_db": c.start_rms_db,
                "noise": c.noise, "points": len(c.measurement.frequency),
            }
            for c in fit.comparisons
        },
        "notes": list(fit.notes),
    }  # fmt: skip


def _print_result(fit: "LoadFit | BimorphFit", name: str) -> None:
    from tactile.study.load_fit import EXACT_BENDER

    bender = len(fit.told) != len(fit.constants)
    title = f"{'Bimorph' if bender else 'Finger'} of {name}"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("constant")
    for heading in (*(["before"] if bender else []), "fitted", "95 % from", "to"):
        table.add_column(heading, justify="right")
    for c in fit.told:
        values = [*([c.start] if bender else []), c.value, c.low, c.high]
        table.add_row(c.name, *(f"{value:.4g}" for value in values))
    Console().print(table)
    table = Table(box=None, pad_edge=False)
    table.add_column("misfit of")
    for heading in ("before, rms dB", "rms dB", "worst dB", "points"):
        table.add_column(heading, justify="right")
    for one in fit.comparisons:
        figures = (f"{value:.3g}" for value in (one.start_rms_db, one.rms_db, one.worst_db))
        table.add_row(one.measurement.name, *figures, str(len(one.measurement.frequency)))
    Console().print(table)
    for note in (*fit.notes, *([] if bender else [EXACT_BENDER])):
        typer.echo(f"note: {note}")
