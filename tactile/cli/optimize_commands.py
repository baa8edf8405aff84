"""The command ``optimize``: bounds and wishes in, designs that none beats out."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app
from tactile.errors import InputError
from tactile.files import nearest
from tactile.study.asking import StudyBase, start_from
from tactile.study.criteria import CRITERIA, Conditions
from tactile.study.parameters import NAMED

if TYPE_CHECKING:
    import xarray

    from tactile.study.optimizing import Task

SHOWN = 10
"""Designs along a front that are printed."""
SCENARIOS = 64
"""Drawn for ``--robust`` where nobody says how many."""
UNSEEN = 4
"""Times as many are drawn anew, to tell what the choice of those was worth."""


@app.command("optimize")
def optimize_design(
    bounds: Annotated[list[str], typer.Argument(help="name=low:high of what may vary.")],
    objective: Annotated[list[str], typer.Option(help=f"One to three of {', '.join(CRITERIA)}.")],
    limit: Annotated[
        list[str] | None,
        typer.Option(
            help="criterion=value that must be kept; or low:high, either may be left out."
        ),
    ] = None,
    fix: Annotated[
        list[str] | None, typer.Option(help="name=value of a further parameter.")
    ] = None,
    load: Annotated[
        str | None, typer.Option(help="Finger: low, high, none or display; low by default.")
    ] = None,
    display: Annotated[
        str | None, typer.Option(help="Whose bender, finger and limits are the start.")
    ] = None,
    robust: Annotated[
        float | None,
        typer.Option(help="Share of fingers and parts that attain it, as 0.9; nominal without."),
    ] = None,
    scenarios: Annotated[
        int | None, typer.Option(help=f"Of fingers and tolerances, {SCENARIOS} by default.")
    ] = None,
    band: Annotated[
        str, typer.Option("--band-hz", "--band", help="low:high, in which criteria judge.")
    ] = "10:1000",
    voltage_v: Annotated[
        float | None, typer.Option("--voltage-v", "--voltage", help="Limit, 100 by default.")
    ] = None,
    current_ma: Annotated[float | None, typer.Option(help="Limit of one channel.")] = None,
    amplitude_um: Annotated[float, typer.Option(help="Flat shear that a drive is for.")] = 10.0,
    seed: Annotated[int, typer.Option(help="Of scenarios and search.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Store of the designs, .nc or .zarr.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Picture of the front: .png, .svg, .pdf.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="All of it, with pictures: one .html file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the designs that none beats in all that is asked for, and recommend one.

    Example: tactile optimize length_mm=8:40 width_mm=1:6 --objective attainable
    --objective footprint --limit drive=60
    """
    from tactile.study.optimizing import Task
    from tactile.study.scenarios import draw_scenarios

    start = StudyBase() if display is None else start_from(tactile.load_display(display))
    if scenarios is not None and robust is None:
        raise InputError("--scenarios: belongs to --robust, as --robust 0.9 --scenarios 64")
    fixed = {name: _number_or_name(name, text) for name, text in _pairs(fix or [])}
    if load is not None:
        if "load" in fixed:
            raise InputError("load: is given by --load and --fix; give one of them")
        fixed["load"] = load
    count = SCENARIOS if scenarios is None else scenarios
    drawn = None if robust is None else draw_scenarios(count, seed=seed)
    spans = {name: _span(name, text) for name, text in _pairs(bounds)}
    if drawn is None and not {"load", "firmness"} & (fixed.keys() | spans.keys()):
        fixed["load"] = start.meant[0]
    task = Task(
        bounds=spans,
        objectives=tuple(objective),
        fixed=fixed,
        limits=dict(_limit(name, text) for name, text in _pairs(limit or [])),
        conditions=Conditions(
            band=_span("band", band),
            voltage=start.voltage if voltage_v is None else voltage_v,
            current=start.current if current_ma is None else current_ma * 1e-3,
            amplitude=amplitude_um * 1e-6,
        ),
        scenarios=drawn,
        unseen=None if drawn is None else draw_scenarios(UNSEEN * count, seed=seed + 1),
        share=0.9 if robust is None else robust,
        fingers=start.fingers,
        base=start.base,
        seed=seed,
    )
    _check_files(task, out, plot, report)
    front = _find(task, shown=not as_json)
    _tell(front, as_json=as_json)
    _keep(front, out, plot, report, said=not as_json)


def _pairs(texts: Iterable[str]) -> list[tuple[str, str]]:
    """Return names and what stands behind their "=", each name once."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{text!r}: reads as name=value, as length_mm=8:40 or drive=100")
        if name in found:
            raise InputError(f"{name}: given twice")
        found[name] = value
    return list(found.items())


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name} = {text!r}: not a number") from None


def _number_or_name(name: str, text: str) -> Any:
    return text if name in NAMED else _number(name, text)


def _span(name: str, text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{name} = {text}: reads as low:high; fix one value with --fix {name}=…")
    return _number(name, low), _number(name, high)


def _limit(name: str, text: str) -> tuple[str, tuple[float, float]]:
    """Return a limit's ends; of one number the criterion says whether it is the least or most."""
    low, colon, high = text.partition(":")
    if colon:
        return name, (
            _number(name, low) if low else -math.inf,
            _number(name, high) if high else math.inf,
        )
    if name not in CRITERIA:
        raise InputError(f"no criterion {name!r} as limit; {nearest(name, list(CRITERIA))}")
    sign, value = CRITERIA[name].sign, _number(name, text)
    if not sign:
        raise InputError(
            f"limit {name} = {text}: say {name}={text}: for at least, :{text} for most"
        )
    return name, (value, math.inf) if sign > 0 else (-math.inf, value)


def _check_files(task: "Task", out: Path | None, plot: Path | None, report: Path | None) -> None:
    """Raise InputError for what cannot be written, before anything is computed for it."""
    if report is not None:
        from tactile.study.report import check_report

        check_report(report)
    if out is not None:
        from tactile.study.storing import check_store

        check_store(out)
        if out.suffix == ".zarr" and out.exists():
            raise InputError(f"{out}: is there already; remove it, or name another")
    if plot is not None:
        from tactile.show.plots import check_file

        check_file(plot)
        if len(task.objectives) == 1:
            raise InputError("--plot: shows a front, which takes two or three objectives")


def _find(task: "Task", *, shown: bool) -> "xarray.Dataset":
    """Find designs with a bar of the generations."""
    from tactile.study.optimizing import find_designs

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=Console(stderr=True), transient=True, disable=not shown,
    )  # fmt: skip
    with bar:
        row = bar.add_task("generations", total=None)
        return find_designs(task, lambda done, total: bar.update(row, completed=done, total=total))


def _tell(front: "xarray.Dataset", *, as_json: bool) -> None:
    """Print designs along the front and which is recommended."""
    from tactile.study.recommending import recommend

    advice = recommend(front)
    if as_json:
        columns = {
            name: values.values.tolist()
            for name, values in front.variables.items()
            if values.dims == ("design",)
        }
        facts = {"attributes": front.attrs, "designs": columns}
        typer.echo(json.dumps(facts | {"place": advice.place, "words": advice.words}))
        return
    count = front.sizes["design"]
    places = sorted({*np.linspace(0, count - 1, SHOWN).round().astype(int).tolist(), advice.place})
    title = f"{count} designs that none beats, of {front.attrs['evaluations']} tried"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    along = [str(name) for name in front.variables if front[name].dims == ("design",)]
    names = [name for name in along if f"robust_{name}" not in along]
    for name in names:
        table.add_column(name, justify="right")
    table.add_column("")
    for place in places:
        cells = (f"{float(front[name][place]):.4g}" for name in names)
        table.add_row(*cells, "recommended" if place == advice.place else "")
    Console().print(table)
    typer.echo(f"{advice.words}")
    error = front.attrs["sampling_error"]
    typer.echo(f"Between the frequencies that were solved, figures differ by {error:.2%} at most.")
    if (loss := front.attrs.get("unseen_loss")) is not None:
        worse = f"{loss:.1%} worse at most" if loss > 0 else "no worse"
        typer.echo(f"For fingers and parts that the search has not seen they are {worse}.")


def _keep(
    front: "xarray.Dataset", out: Path | None, plot: Path | None, report: Path | None, *, said: bool
) -> None:
    """Write the files that were asked for."""
    if out is not None:
        from tactile.study.storing import save

        save(front, out)
    if plot is not None:
        from tactile.study.plots import plot_pareto
        from tactile.study.recommending import recommend

        plot_pareto(plot, front, front.attrs["objectives"].split(), knee=recommend(front).place)
    if report is not None:
        from tactile.study.recommending import recommend
        from tactile.study.report import front_report, write_report

        advice = recommend(front)
        sections = front_report(front, knee=advice.place)
        write_report(report, "Designs that none beats", sections, subtitle=advice.words)
    if said:
        for path in (out, plot, report):
            if path is not None:
                typer.echo(f"written: {path}")
