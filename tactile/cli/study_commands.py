"""The command ``study``: a question about a design, to a table and a data set."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app
from tactile.study.asking import Words, ask, start_from
from tactile.study.criteria import CRITERIA, variable
from tactile.study.findings import Figures, summarize
from tactile.study.ranges import SHARE, check_share
from tactile.study.runs import fitting_workers, run_study
from tactile.study.storing import check_store
from tactile.study.sweep import RESPONSES, Study


@app.command("study")
def study_design(
    axes: Annotated[
        list[str], typer.Argument(help="name=values each: start:stop:step, or a list with commas.")
    ],
    frequency: Annotated[
        str | None, typer.Option("--frequency-hz", "--frequency", help="Values as of an axis.")
    ] = None,
    criterion: Annotated[
        list[str] | None, typer.Option(help=f"Any of {', '.join(CRITERIA)}.")
    ] = None,
    band: Annotated[
        str | None,
        typer.Option("--band-hz", "--band", help="low:high, in which criteria judge."),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(help=f"Response to store over frequency: any of {', '.join(RESPONSES)}."),
    ] = None,
    fix: Annotated[
        list[str] | None, typer.Option(help="name=value of a further parameter.")
    ] = None,
    scenarios: Annotated[
        int, typer.Option(min=0, help="Draw so many fingers and tolerances for every design.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of the scenarios.")] = 0,
    voltage_v: Annotated[
        float | None, typer.Option("--voltage-v", "--voltage", help="Limit, 100 by default.")
    ] = None,
    current_ma: Annotated[float | None, typer.Option(help="Limit of one channel.")] = None,
    amplitude_um: Annotated[float, typer.Option(help="Flat shear that a drive is for.")] = 10.0,
    within: Annotated[float, typer.Option(help="Share of the best that is good enough.")] = SHARE,
    display: Annotated[
        str | None, typer.Option(help="Whose bender, finger and limits are the start.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=".nc; or .zarr: stored as it goes, resumed if run again."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; by default as many as pay.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask cluster that solves, as tcp://host:8786.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Picture of the first criterion: .png, .svg, .pdf.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="All that it says, with pictures: one .html file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Sweep parameters of a bender, and tell which are best, and what is nearly as good.

    Example: tactile study length_mm=8:30:0.25 load=low,high --report study.html

    Without criterion, band and frequencies it is the smallest displacement in 0 to 1000 Hz; without
    a finger, under the low and the high one.
    """
    words = Words(
        axes=axes,
        fixed=fix or (),
        frequency=frequency,
        band=band,
        criteria=tuple(criterion or ()),
        keep=tuple(keep or ()),
        scenarios=scenarios,
        seed=seed,
        voltage=voltage_v,
        current=current_ma,
        amplitude=amplitude_um,
    )
    study = ask(words, None if display is None else start_from(tactile.load_display(display)))
    check_share(within)
    _check_files(out, plot, report)
    data = _run(study, out, workers, scheduler, shown=not as_json)
    if out is not None and not as_json:
        typer.echo(f"stored: {out}")
    figures = summarize(data, share=within)
    if as_json:
        typer.echo(json.dumps(figures | {"stored": None if out is None else str(out)}))
    else:
        _print(figures)
    _draw(data, study, plot, report, share=within)
    for path in (plot, report):
        if path is not None and not as_json:
            typer.echo(f"written: {path}")


def _check_files(out: Path | None, plot: Path | None, report: Path | None) -> None:
    """Raise InputError for what cannot be written, before anything is computed for it."""
    if out is not None:
        check_store(out)
    if plot is not None:
        from tactile.show.plots import check_file

        check_file(plot)
    if report is not None:
        from tactile.study.report import check_report

        check_report(report)


def _draw(data: Any, study: Study, plot: Path | None, report: Path | None, *, share: float) -> None:
    if plot is not None:
        from tactile.study.plots import plot_criterion, plot_response_phase

        if study.criteria:
            plot_criterion(plot, data, variable(study.criteria[0]), share=share)
        else:
            plot_response_phase(plot, data, RESPONSES[study.responses[0]].variable)
    if report is not None:
        from tactile.study.report import study_report, write_report

        write_report(
            report,
            "Study of a bender",
            study_report(data, share=share),
            subtitle=data.attrs["title"],
        )


def _run(
    study: Study, out: Path | None, workers: int | None, scheduler: str | None, *, shown: bool
) -> Any:
    """Run a study with a bar of its blocks."""
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=console, transient=True, disable=not (shown and console.is_terminal),
    )  # fmt: skip
    with bar:
        task = bar.add_task(f"{study.designs} designs", total=None)
        return run_study(
            study,
            store=out,
            workers=workers or fitting_workers(study),
            scheduler=scheduler,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )


def _print(f: Figures) -> None:
    swept = ", ".join(f"{name} ({len(values)})" for name, values in f["axes"].items())
    drawn = f", each in {f['scenarios']} scenarios" if f["scenarios"] else ""
    title = f"{f['designs']} designs over {swept}{drawn}"
    rows = [
        (one["criterion"], _finger(one["finger"]), f"{one['value']:.4g} {one['unit']}",
         _place(one["at"]))
        for one in f["best"]
    ]  # fmt: skip
    _table(title, ("best", "finger", "value", "at"), rows)
    spans = [
        (one["criterion"], f"{one['low']:.4g}", f"{one['high']:.4g}", one["unit"])
        for one in f["spans"]
    ]
    _table("" if rows else title, ("over all designs", "from", "to", ""), spans)
    ranges = [
        (one["criterion"], _place(one["at"]), _span(one) + (" (cut)" if one["is_cut"] else ""))
        for one in f["ranges"]
    ]
    shared = [(one["criterion"], _place({"load": "all", **one["at"]}), _span(one))
              for one in f["overlaps"]]  # fmt: skip
    _table(f"within {100 * f['share']:g} % of the best", ("", "of", "range"), ranges + shared)
    if len(f["figures"]) > 1:
        figures = [
            (name, f"{one['value']:.4g} {one['unit']}", one["means"])
            for name, one in f["figures"].items()
        ]
        at = _place(f["best"][0]["at"]) if f["best"] else ""
        _table(f"figures of {at}" if at else "figures", ("", "value", ""), figures)


def _table(title: str, headings: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    if not rows:
        return
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    Console().print(table, highlight=False, markup=False)


def _finger(name: str | None) -> str:
    return "suits all" if name == "all" else name or ""


def _place(at: dict[str, Any]) -> str:
    return ", ".join(f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in at.items())


def _span(one: dict[str, Any]) -> str:
    if one["low"] is None:
        return "nothing"
    return f"{one['along']} {one['low']:.3g} … {one['high']:.3g}"
