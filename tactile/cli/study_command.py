"""The command ``tactile study``."""

from pathlib import Path
from typing import Annotated, Any

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
from tactile.cli.printing import print_table, progress_bar
from tactile.study.criteria import CRITERIA, variable
from tactile.study.findings import Figures, summarize
from tactile.study.ranges import SHARE, check_share
from tactile.study.runs import fitting_workers, run_study
from tactile.study.study_request import StudyRequest, requested_study, start_from
from tactile.study.sweep import RESPONSES, Study


def run(
    axes: Annotated[
        list[str],
        typer.Argument(
            help="Parameters to sweep, each as name=start:stop:step or name=value,value."
        ),
    ],
    frequency_hz: Annotated[
        str | None,
        typer.Option(
            help="Frequencies in Hz at which the responses are computed, as start:stop:step or "
            "value,value; by default evenly spaced over the band."
        ),
    ] = None,
    criterion: Annotated[
        list[str] | None,
        typer.Option(
            help="Criterion by which designs are compared. May be given several times: "
            f"{', '.join(CRITERIA)}. By default smallest_displacement."
        ),
    ] = None,
    band_hz: Annotated[
        str | None,
        typer.Option(
            help="Frequency band in Hz over which criteria are evaluated, as low:high; by default "
            "0:1000 for the default criterion."
        ),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(
            help="Response to store for every frequency. May be given several times: "
            f"{', '.join(RESPONSES)}."
        ),
    ] = None,
    fix: Fixed = None,
    scenarios: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number of random fingers and tolerances with which each design is computed.",
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random scenarios.")] = 0,
    voltage_v: VoltageLimit = None,
    current_ma: CurrentLimit = None,
    amplitude_um: Amplitude = 10.0,
    within: Annotated[
        float,
        typer.Option(
            help="Share of the best value, between 0 and 1, that a design must reach to be in the "
            "range of good designs."
        ),
    ] = SHARE,
    display: StartDisplay = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Data file to write: .nc (NetCDF), or .zarr, which is written during the study so "
            "that an interrupted study can be continued by the same command.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, help="Number of processes; by default chosen by the size of the study."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler that runs the study, such as tcp://host:8786."
        ),
    ] = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    as_json: AsJson = False,
) -> None:
    """Sweep the parameters of a bender and compare the designs.

    The best design of each criterion is reported, and the range of designs that are nearly as good.
    Without a load among the parameters, each design is computed for a low and a high finger.

    Example: tactile study length_mm=8:30:0.25 load=low,high --report study.html
    """
    request = StudyRequest(
        axes=axes,
        fixed=fix or (),
        frequency=frequency_hz,
        band=band_hz,
        criteria=tuple(criterion or ()),
        keep=tuple(keep or ()),
        scenarios=scenarios,
        seed=seed,
        voltage=voltage_v,
        current=current_ma,
        amplitude=amplitude_um,
    )
    start = None if display is None else start_from(tactile.load_display(display))
    study = requested_study(request, start)
    check_share(within)
    check_outputs(out, plot, report)
    data = _run(study, out, workers, scheduler, visible=not as_json)
    if out is not None and not as_json:
        print(f"stored: {out}")
    facts = summarize(data, share=within) | {"stored": None if out is None else str(out)}
    emit(facts, as_json, _print)
    _draw(data, study, plot, report, share=within)
    for path in (plot, report):
        if path is not None and not as_json:
            print(f"written: {path}")


def _draw(data: Any, study: Study, plot: Path | None, report: Path | None, *, share: float) -> None:
    """Write the plot and the report, if they were asked for."""
    if plot is not None:
        from tactile.show.plots import save
        from tactile.study.plots import criterion_figure, response_phase_figure

        if study.criteria:
            figure = criterion_figure(data, variable(study.criteria[0]), share=share)
        else:
            figure = response_phase_figure(data, RESPONSES[study.responses[0]].variable)
        save(figure, plot)
    if report is not None:
        from tactile.study.report import study_report, write_report

        write_report(
            report,
            "Study of a bender",
            study_report(data, share=share),
            subtitle=data.attrs["title"],
        )


def _run(
    study: Study, out: Path | None, workers: int | None, scheduler: str | None, *, visible: bool
) -> Any:
    """Run a study with a progress bar that counts blocks of designs."""
    with progress_bar(visible=visible) as bar:
        task = bar.add_task(f"{study.designs} designs", total=None)
        return run_study(
            study,
            store=out,
            workers=workers or fitting_workers(study),
            scheduler=scheduler,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )


def _print(f: Figures) -> None:
    """Print the best designs, the ranges of good designs and the criteria of the best one."""
    swept = ", ".join(f"{name} ({len(values)})" for name, values in f["axes"].items())
    drawn = f", each in {f['scenarios']} scenarios" if f["scenarios"] else ""
    title = f"{f['designs']} designs over {swept}{drawn}"
    best = [
        (b["criterion"], _finger(b["finger"]), f"{b['value']:.4g} {b['unit']}", _place(b["at"]))
        for b in f["best"]
    ]
    spans = [(s["criterion"], f"{s['low']:.4g}", f"{s['high']:.4g}", s["unit"]) for s in f["spans"]]
    ranges = [
        (r["criterion"], _place(r["at"]), _span(r) + (" (cut)" if r["is_cut"] else ""))
        for r in f["ranges"]
    ]
    shared = [(o["criterion"], _place({"load": "all", **o["at"]}), _span(o)) for o in f["overlaps"]]
    figures = [
        (name, f"{one['value']:.4g} {one['unit']}", one["means"])
        for name, one in f["figures"].items()
    ]
    of_best = f"criteria of the design at {_place(f['best'][0]['at'])}" if best else "criteria"
    tables = (
        (title, ("best", "finger", "value", "at"), best),
        ("" if best else title, ("over all designs", "from", "to", "unit"), spans),
        (f"within {100 * f['share']:g} % of the best", ("criterion", "of", "range"),
         ranges + shared),
        (of_best, ("criterion", "value", "meaning"), figures if len(figures) > 1 else []),
    )  # fmt: skip
    for title, headings, rows in tables:
        if rows:
            print_table(headings, rows, title)


def _finger(name: str | None) -> str:
    """Return the name of a finger for a person."""
    return "suits all" if name == "all" else name or ""


def _place(at: dict[str, Any]) -> str:
    """Return the values of the parameters of a design as text."""
    return ", ".join(f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in at.items())


def _span(one: dict[str, Any]) -> str:
    """Return the range of a parameter as text."""
    if one["low"] is None:
        return "nothing"
    return f"{one['along']} {one['low']:.3g} … {one['high']:.3g}"
