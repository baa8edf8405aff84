"""The command ``tactile adjust``."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import tactile
from tactile.cli.options import AsJson, DisplayOption, Finger, Force, PlotOption, check_plot, emit
from tactile.cli.printing import print_table, right
from tactile.display.edit import write_tables
from tactile.errors import InputError

if TYPE_CHECKING:
    from tactile.study.admittance_fit import BimorphFit
    from tactile.study.load_fit import LoadFit

STIFFNESS = "s11e_um2_per_n"
"""Key of the compliance s11E in a display file."""


def run(
    load: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with the response of the loaded tip. The load of the finger is fitted "
            "to it."
        ),
    ] = None,
    admittance: Annotated[
        Path | None,
        typer.Option(help="CSV file with the electrical admittance. The bimorph is fitted to it."),
    ] = None,
    velocity: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with the velocity or displacement of the tip. The bimorph is fitted to "
            "it."
        ),
    ] = None,
    finger: Annotated[
        Finger,
        typer.Option(
            help="Finger on the tip during the measurements of --admittance and --velocity."
        ),
    ] = Finger.AIR,
    stiffness: Annotated[
        bool,
        typer.Option(
            "--stiffness", help="Also fit the compliance s11E, which moves the resonance."
        ),
    ] = False,
    branches: Annotated[
        int | None,
        typer.Option(
            help="Number of branches of the load of the finger, 1 to 3; by default as many as the "
            "measurement supports."
        ),
    ] = None,
    display: DisplayOption = "reference-24",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Display file to write, with the fitted values and a name of its own.",
        ),
    ] = None,
    plot: PlotOption = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fit the finger or the bimorph of a display to measurements.

    The CSV files have the columns frequency_hz, magnitude, phase_deg and unit. Voltages are those
    at the electrodes of the bimorph.

    Example: tactile adjust --load finger.csv --display reference-24 --out mine.toml --plot fit.png
    """
    _check_options(load, admittance, velocity, stiffness=stiffness, branches=branches)
    check_plot(plot)
    loaded = tactile.load_display(display)
    result: LoadFit | BimorphFit
    if load is not None:
        result, tables = _fit_finger(loaded, load, branches)
    else:
        on_tip = getattr(tactile.FingerLoad, finger.value)()
        result, tables = _fit_bender(loaded, admittance, velocity, on_tip, stiffness=stiffness)
    if out is not None:
        write_tables(
            display, out, **tables, change=_change(load, admittance, velocity), force=force
        )
    if plot is not None:
        from tactile.show.plots import save
        from tactile.study.plots import adjusted_figure

        part = "Finger" if load is not None else "Bimorph"
        save(adjusted_figure(result.comparisons, title=f"{part} of {loaded.name}, fitted"), plot)
    emit(_facts(result), as_json, lambda _: _print(result, loaded.name))
    for done, path in (("written", out), ("drawn", plot)):
        if path is not None and not as_json:
            print(f"{done}: {path}")


def _change(load: Path | None, admittance: Path | None, velocity: Path | None) -> str:
    """Return what a display file has that the display before it had not."""
    if load is not None:
        return f"finger fitted to {load.name}"
    names = [path.name for path in (admittance, velocity) if path is not None]
    return f"bimorph fitted to {' and '.join(names)}"


def _check_options(
    load: Path | None,
    admittance: Path | None,
    velocity: Path | None,
    *,
    stiffness: bool,
    branches: int | None,
) -> None:
    """Raise InputError for options that cannot be combined."""
    electric = admittance is not None or velocity is not None
    if (load is not None) == electric:
        raise InputError("give either --load, or one or both of --admittance and --velocity")
    if branches is not None and load is None:
        raise InputError("--branches can only be used with --load")
    if stiffness and load is not None:
        raise InputError("--stiffness can only be used with --admittance and --velocity")


def _fit_finger(
    loaded: tactile.Display, path: Path, branches: int | None
) -> tuple["LoadFit", dict[str, Any]]:
    """Return the fit of a load, and the tables of a display file that contain it."""
    from tactile.study.load_fit import KINDS, fit_load
    from tactile.study.measurement import load_measurement

    measured = load_measurement(path, *KINDS)
    before = loaded.load_at(loaded.load_forces[0])
    fit = fit_load(loaded.bimorph, measured, branches=branches, before=before)
    k0, d0, *rest = (_rounded(c.value) for c in fit.constants)
    pairs = list(zip(rest[::2], rest[1::2], strict=True))
    return fit, {"finger": {"k0_n_per_m": k0, "d0_n_s_per_m": d0, "branches": pairs}}


def _fit_bender(
    loaded: tactile.Display,
    admittance: Path | None,
    velocity: Path | None,
    load: tactile.FingerLoad,
    *,
    stiffness: bool,
) -> tuple["BimorphFit", dict[str, Any]]:
    """Return the fit of a bimorph, and the tables of a display file that contain it."""
    from tactile.study.admittance_fit import ADJUSTED, fit_bimorph
    from tactile.study.measurement import load_measurement

    measurements = [
        None if admittance is None else load_measurement(admittance, "admittance"),
        None if velocity is None else load_measurement(velocity, "velocity", "displacement"),
    ]
    names = (*ADJUSTED, STIFFNESS) if stiffness else ADJUSTED
    measured = [(one, load) for one in measurements if one is not None]
    fit = fit_bimorph(loaded.bimorph, measured, names=names)
    return fit, {"bimorph": {c.name: _rounded(c.value) for c in fit.constants}}


def _rounded(value: float) -> float:
    """Return a value with six digits, which is more than the accuracy of any fit."""
    return float(f"{value:.6g}")


def _facts(fit: "LoadFit | BimorphFit") -> dict[str, Any]:
    """Return the fitted constants and the misfit of each measurement."""
    return {
        "constants": {
            c.name: {
                "value": c.value, "low": c.low, "high": c.high if math.isfinite(c.high) else None,
                "start": c.start, "known": c.known,
            }
            for c in fit.reported
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


def _print(fit: "LoadFit | BimorphFit", name: str) -> None:
    """Print the fitted constants and the misfit of each measurement."""
    from tactile.study.load_fit import EXACT_BENDER

    bender = len(fit.reported) != len(fit.constants)
    columns = right(*(["before"] if bender else []), "fitted", "95 % from", "to")
    rows = (
        (c.name, *(f"{v:.4g}" for v in (*([c.start] if bender else []), c.value, c.low, c.high)))
        for c in fit.reported
    )
    print_table(["constant", *columns], rows, f"{'Bimorph' if bender else 'Finger'} of {name}")
    misfits = (
        (
            one.measurement.name,
            *(f"{v:.3g}" for v in (one.start_rms_db, one.rms_db, one.worst_db)),
            str(len(one.measurement.frequency)),
        )
        for one in fit.comparisons
    )
    columns = right("before, rms dB", "rms dB", "worst dB", "points")
    print_table(["misfit of", *columns], misfits)
    for note in (*fit.notes, *([] if bender else [EXACT_BENDER])):
        print(f"note: {note}")
