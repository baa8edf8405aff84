"""The command ``tactile optimize``."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import tactile
from tactile.cli.options import (
    Amplitude,
    AsJson,
    CurrentLimit,
    Fixed,
    PlotOption,
    ReportOption,
    StartDisplay,
    VoltageLimit,
    check_outputs,
    emit,
)
from tactile.cli.printing import print_table, progress_bar, right
from tactile.errors import InputError
from tactile.files import nearest
from tactile.study.criteria import CRITERIA, Conditions
from tactile.study.parameters import NAMED
from tactile.study.study_request import StudyBase, assignments, parse_number, parse_span, start_from

if TYPE_CHECKING:
    import xarray

    from tactile.study.optimizing import Task
    from tactile.study.recommending import Recommendation

PRINTED = 10
"""Number of designs along the front that are printed."""
SCENARIOS = 64
"""Number of scenarios for ``--robust`` if none is given."""
UNSEEN = 4
"""Ratio of the scenarios that only check the result to those of the search."""


def run(
    bounds: Annotated[
        list[str], typer.Argument(help="Parameters that may vary, each as name=low:high.")
    ],
    objective: Annotated[
        list[str],
        typer.Option(
            help=f"Criterion to optimize. May be given up to three times: {', '.join(CRITERIA)}."
        ),
    ],
    limit: Annotated[
        list[str] | None,
        typer.Option(
            help="Limit of a criterion, as criterion=value or criterion=low:high, where low or "
            "high may be omitted. May be given several times."
        ),
    ] = None,
    fix: Fixed = None,
    load: Annotated[
        str | None,
        typer.Option(
            help="Finger that loads the bender: low, high, none or display. By default the finger "
            "of the display, or else low."
        ),
    ] = None,
    display: StartDisplay = None,
    robust: Annotated[
        float | None,
        typer.Option(
            help="Share of random fingers and tolerances, such as 0.9, that must reach the value "
            "of an objective. Without it, only the nominal design is computed."
        ),
    ] = None,
    scenarios: Annotated[
        int | None,
        typer.Option(
            help=f"Number of random fingers and tolerances for --robust; {SCENARIOS} by default."
        ),
    ] = None,
    band_hz: Annotated[
        str,
        typer.Option(help="Frequency band in Hz over which criteria are evaluated, as low:high."),
    ] = "10:1000",
    voltage_v: VoltageLimit = None,
    current_ma: CurrentLimit = None,
    amplitude_um: Amplitude = 10.0,
    seed: Annotated[int, typer.Option(help="Seed of the random scenarios and of the search.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Data file to write the designs to (.nc or .zarr)."),
    ] = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    as_json: AsJson = False,
) -> None:
    """Find the Pareto-optimal designs for the given objectives.

    No other design is better in one of the objectives without being worse in another. One of the
    designs is recommended if the front has a knee.

    Example: tactile optimize length_mm=8:40 width_mm=1:6 --objective attainable
    --objective footprint --limit drive=60
    """
    from tactile.study.optimizing import Task
    from tactile.study.recommending import recommend
    from tactile.study.scenarios import draw_scenarios

    if scenarios is not None and robust is None:
        raise InputError("--scenarios can only be used with --robust, for example --robust 0.9")
    start = StudyBase() if display is None else start_from(tactile.load_display(display))
    count = SCENARIOS if scenarios is None else scenarios
    drawn = None if robust is None else draw_scenarios(count, seed=seed)
    spans = {
        name: _bounds(name, text) for name, text in assignments(bounds, "length_mm=8:40").items()
    }
    fixed = _fixed(fix, load)
    if drawn is None and not {"load", "firmness"} & (fixed.keys() | spans.keys()):
        fixed["load"] = start.default_loads[0]
    limits = assignments(limit or [], "drive=60")
    task = Task(
        bounds=spans,
        objectives=tuple(objective),
        fixed=fixed,
        limits={name: _limit(name, text) for name, text in limits.items()},
        conditions=_conditions(start, band_hz, voltage_v, current_ma, amplitude_um),
        scenarios=drawn,
        unseen=None if drawn is None else draw_scenarios(UNSEEN * count, seed=seed + 1),
        share=0.9 if robust is None else robust,
        fingers=start.fingers,
        base=start.base,
        seed=seed,
    )
    _check_files(task, out, plot, report)
    front = _find(task, visible=not as_json)
    advice = recommend(front)
    emit(_facts(front, advice), as_json, lambda _: _print(front, advice))
    _write_files(front, advice, out, plot, report)
    for path in (out, plot, report):
        if path is not None and not as_json:
            print(f"written: {path}")


def _conditions(
    start: StudyBase,
    band_hz: str,
    voltage_v: float | None,
    current_ma: float | None,
    amplitude_um: float,
) -> Conditions:
    """Return the band, the limits and the amplitude for the criteria, in SI units."""
    return Conditions(
        band=parse_span("band", band_hz, "in Hz, for example 10:1000"),
        voltage=start.voltage if voltage_v is None else voltage_v,
        current=start.current if current_ma is None else current_ma * 1e-3,
        amplitude=amplitude_um * 1e-6,
    )


def _fixed(fix: list[str] | None, load: str | None) -> dict[str, Any]:
    """Return the values of the parameters that do not vary, by name."""
    texts = assignments(fix or [], "width_mm=2")
    fixed: dict[str, Any] = {
        name: text if name in NAMED else parse_number(name, text) for name, text in texts.items()
    }
    if load is not None:
        if "load" in fixed:
            raise InputError("load: is given by --load and by --fix; use only one of them")
        fixed["load"] = load
    return fixed


def _bounds(name: str, text: str) -> tuple[float, float]:
    """Return the bounds of a parameter."""
    return parse_span(name, text, f"or a fixed value: --fix {name}={text}")


def _limit(name: str, text: str) -> tuple[float, float]:
    """Return the limits of a criterion; a single number is the one on its unfavorable side."""
    if name not in CRITERIA:
        raise InputError(f"--limit {name}={text}: no such criterion; {nearest(name, [*CRITERIA])}")
    low, colon, high = text.partition(":")
    if colon:
        return (
            parse_number(name, low) if low else -math.inf,
            parse_number(name, high) if high else math.inf,
        )
    sign, value = CRITERIA[name].sign, parse_number(name, text)
    if not sign:
        raise InputError(
            f"--limit {name}={text}: use {name}={text}: for at least {text}, or {name}=:{text} for "
            f"at most {text}"
        )
    return (value, math.inf) if sign > 0 else (-math.inf, value)


def _check_files(task: "Task", out: Path | None, plot: Path | None, report: Path | None) -> None:
    """Check that the output files can be written, before anything is computed."""
    check_outputs(out, plot, report)
    if out is not None and out.suffix == ".zarr" and out.exists():
        raise InputError(f"{out}: already exists; remove it, or choose another name")
    if plot is not None and len(task.objectives) == 1:
        raise InputError("--plot: needs two or three objectives, of which it shows the front")


def _find(task: "Task", *, visible: bool) -> "xarray.Dataset":
    """Find the designs with a progress bar that counts generations."""
    from tactile.study.optimizing import find_designs

    with progress_bar(visible=visible) as bar:
        row = bar.add_task("generations", total=None)
        return find_designs(task, lambda done, total: bar.update(row, completed=done, total=total))


def _facts(front: "xarray.Dataset", advice: "Recommendation") -> dict[str, Any]:
    """Return the designs, and which of them is recommended, if any is."""
    columns = {name: front[name].values.tolist() for name in _columns(front)}
    return {
        "attributes": front.attrs, "designs": columns, "place": advice.place, "words": advice.words,
    }  # fmt: skip


def _columns(front: "xarray.Dataset") -> list[str]:
    """Return the names of the values that each design has."""
    return [str(name) for name, values in front.variables.items() if values.dims == ("design",)]


def _print(front: "xarray.Dataset", advice: "Recommendation") -> None:
    """Print designs along the front, the recommended one and how reliable they are."""
    count = front.sizes["design"]
    along_front = np.linspace(0, count - 1, PRINTED).round().astype(int).tolist()
    places = sorted({*along_front, *([] if advice.place is None else [advice.place])})
    along = _columns(front)
    names = [name for name in along if f"robust_{name}" not in along]
    rows = (
        (
            *(f"{float(front[name][place]):.4g}" for name in names),
            "recommended" if place == advice.place else "",
        )
        for place in places
    )
    title = f"{count} Pareto-optimal designs of {front.attrs['evaluations']} evaluated"
    print_table([*right(*names), ""], rows, title)
    print(f"{advice.words}")
    error = front.attrs["sampling_error"]
    print(f"Between the computed frequencies, the criteria differ by at most {error:.2%}.")
    if (loss := front.attrs.get("unseen_loss")) is not None:
        worse = f"at most {loss:.1%} worse" if loss > 0 else "not worse"
        print(f"With fingers and tolerances that the search did not use, they are {worse}.")


def _write_files(
    front: "xarray.Dataset",
    advice: "Recommendation",
    out: Path | None,
    plot: Path | None,
    report: Path | None,
) -> None:
    """Write the files that were asked for."""
    if out is not None:
        from tactile.study.storing import save

        save(front, out)
    if plot is not None:
        from tactile.show.plots import save as save_figure
        from tactile.study.plots import pareto_figure

        objectives = front.attrs["objectives"].split()
        save_figure(pareto_figure(front, objectives, recommended=advice.place), plot)
    if report is not None:
        from tactile.study.report import front_report, write_report

        sections = front_report(front, recommended=advice.place)
        write_report(report, "Pareto-optimal designs", sections, subtitle=advice.words)
