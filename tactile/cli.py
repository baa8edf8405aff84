"""The command ``tactile``: parses and prints. A mistake is one line and exit code 2."""

import json
import math
import sys
from contextlib import nullcontext, suppress
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tactile
from tactile.errors import InputError, TactileError
from tactile.files import nearest
from tactile.printing import print_budget, print_check

app = typer.Typer(
    help="Textures on tactile displays made of piezoelectric bimorphs.\n\n"
    "Example: tactile play wood-oak --speed-mm-s 80 --seconds 5",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class Finger(StrEnum):
    """A finger that loads the contactor."""

    LOW = "low"
    HIGH = "high"
    AIR = "none"


STROKE = {
    "--speed-mm-s": (0.0, 2000.0, 80.0),
    "--seconds": (0.1, 86400.0, 5.0),
    "--angle-deg": (-360.0, 360.0, 0.0),
    "--normal-force-n": (0.0, 20.0, 0.5),
}
"""Least, most and default."""

DisplayOption = Annotated[
    str, typer.Option("--display", help="reference-24, reference-64, or a TOML file.")
]
AcceptHold = Annotated[
    bool,
    typer.Option(
        "--accept-unsafe-hold",
        help="Also on an amplifier that holds its last voltage when the host dies, or does nobody "
        "knows what.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print figures for machines.")]


def _print_table(rows: dict[str, str], title: str) -> None:
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    for name, value in rows.items():
        table.add_row(name, value)
    Console().print(table)


@app.command()
def play(
    texture: Annotated[str, typer.Argument(help="A texture's name, or a TOML file.")],
    speed_mm_s: Annotated[
        float | None, typer.Option(help="Straight stroke, 80 by default.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Length of the stroke, 5 by default.")
    ] = None,
    angle_deg: Annotated[
        float | None, typer.Option(help="Of the stroke, from the x axis; 0 by default.")
    ] = None,
    normal_force_n: Annotated[
        float | None, typer.Option(help="Of the finger, 0.5 by default.")
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(help="Follow a CSV (time_s, x_mm, y_mm, normal_force_n) instead."),
    ] = None,
    display: DisplayOption = "reference-24",
    device: Annotated[str, typer.Option(help="sim:, mock:, or another device's URL.")] = "sim:",
    record: Annotated[Path | None, typer.Option(help="Write an .npz of what was played.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the surface.")] = 0,
    sample_rate_hz: Annotated[
        float | None, typer.Option(help="Of the drive; by default the device's choice.")
    ] = None,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No picture and no report.")] = False,
) -> None:
    """Play a texture under a moving finger.

    Example: tactile play wood-oak --speed-mm-s 80 --seconds 5 --record oak.npz
    """
    from tactile.daemon.session import run

    stroke = {
        "--speed-mm-s": speed_mm_s,
        "--seconds": seconds,
        "--angle-deg": angle_deg,
        "--normal-force-n": normal_force_n,
    }
    trajectory = _trajectory(path, stroke)
    _within("--sample-rate-hz", sample_rate_hz, 2500, 200000, 8000)
    shown, felt = tactile.load_display(display), tactile.load_texture(texture)
    watched = sys.stdout.isatty() and not (quiet or as_json)
    live, watch = (
        _live(shown, texture, sample_rate_hz or 8000.0) if watched else (nullcontext(), None)
    )
    with live:
        summary = run(
            shown, felt, trajectory,
            device=device, sample_rate=sample_rate_hz, seed=seed, record=record,
            watch=watch, realtime=watched, accept_unsafe_hold=accept_unsafe_hold,
        )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(summary.as_dict()))
    elif not quiet:
        _print_table(_report(summary.as_dict()), f"Played {felt.descriptor.texture.description}")


def _trajectory(path: Path | None, stroke: dict[str, float | None]) -> "tactile.Trajectory":
    if path is not None:
        given = [name for name, value in stroke.items() if value is not None]
        if given:
            raise InputError(f"{given[0]} and --path exclude each other: the path says where to go")
        return tactile.Trajectory.from_csv(path)
    speed, seconds, angle, force = (
        _within(name, stroke[name], *bounds) for name, bounds in STROKE.items()
    )
    return tactile.Trajectory.line(
        speed=speed * 1e-3, duration=seconds, angle=math.radians(angle), normal_force=force
    )


def _within(name: str, value: float | None, low: float, high: float, default: float) -> float:
    if value is None:
        return default
    if not low <= value <= high:
        raise InputError(f"{name} {value:g}: must be {low:g} … {high:g}")
    return value


def _live(display: "tactile.Display", texture: str, sample_rate: float) -> tuple[Any, Any]:
    """Return a live terminal picture and what feeds it."""
    from rich.live import Live

    from tactile.daemon.playback import PlayedBlock
    from tactile.terminal import Picture

    picture = Picture(display, texture=texture, sample_rate=sample_rate)

    def watch(block: PlayedBlock, renderer: "tactile.Renderer") -> None:
        picture.update(
            float(block.time[-1]), block.position[-1], block.speed, float(block.normal_force[-1]),
            block.shear, block.drive, renderer.limiter.limited_samples,
        )  # fmt: skip

    return Live(picture, refresh_per_second=15, transient=True), watch


def _report(s: dict[str, Any]) -> dict[str, str]:
    rows = {
        "on": f"{s['display']} at {s['device']}, {s['sample_rate_hz']:g} Hz",
        "length": f"{s['seconds']:.3f} s, {s['samples']} samples",
    }
    rows |= _frames(s) if s["frames"] else _samples(s)
    if s["faults"] or s["invalid_samples"]:
        counted = s["faults"] | {"invalid_samples": s["invalid_samples"]}
        rows["faults"] = ", ".join(f"{n} {name}" for name, n in counted.items() if n)
    if s["status"]:
        rows["link"] = s["status"]
    if s["recording"]:
        rows["recorded"] = s["recording"]
    return rows


def _frames(s: dict[str, Any]) -> dict[str, str]:
    return {
        "frames": f"{s['frames']} of the spectrum, {s['limited_samples']} limited; without events",
    }


def _samples(s: dict[str, Any]) -> dict[str, str]:
    rows = {
        "shear": f"{s['rms_shear_um']:.2f} µm rms, {s['peak_shear_um']:.2f} µm peak; "
        f"full drive attains {s['attainable_um']:.1f} µm up to 1 kHz",
        "drive": f"{s['peak_drive_v']:.1f} V peak of {s['voltage_limit_v']:.0f} V, "
        f"{s['limited_samples']} samples limited",
        "equalizer": f"within {s['equalizer_error_db']:.2f} dB of the inverse, 10–1000 Hz",
    }
    if s["signal_to_error_db"] is not None:
        rows["played"] = (
            f"{s['signal_to_error_db']:.1f} dB signal-to-error against what was commanded, "
            "20–1000 Hz"
        )
    if s["peak_current_ma"] is not None:
        rows["current"] = f"{s['peak_current_ma']:.2f} mA peak per contactor"
    return rows


@app.command("devices")
def list_devices(as_json: AsJson = False) -> None:
    """List the devices that are there, each with the URL that opens it.

    Example: tactile devices
    """
    from tactile.devices import find_devices

    found = list(find_devices())
    if as_json:
        typer.echo(json.dumps([{"url": one.url, "about": one.about} for one in found]))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("device", no_wrap=True)
    table.add_column("what it is")
    for one in found:
        table.add_row(one.url, one.about)
    if found:
        Console().print(table)
    else:
        typer.echo("no device found; sim: and mock: are always there")


@app.command("budget")
def tell_budget(
    display: Annotated[str, typer.Argument(help="reference-24, reference-64, or a TOML file.")],
    url: Annotated[str, typer.Argument(help="Of the device; it is not opened.")],
    band_hz: Annotated[float, typer.Option(help="Highest frequency that is needed.")] = 1000.0,
    as_json: AsJson = False,
) -> None:
    """Tell what fits the link to a device: format, sample rate, spectrum frames.

    Example: tactile budget reference-24 "can:socketcan/can0?fd=true"
    """
    from tactile.bus.budget import BudgetError, plan, table
    from tactile.devices import link_at

    shown, link = tactile.load_display(display), link_at(url)
    chosen = None
    with suppress(BudgetError):
        chosen = plan(link, shown.channels, band=band_hz)
    rows = table(link, shown.channels, band=band_hz)
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "link": link.name,
                    "channels": shown.channels,
                    "cap": link.cap,
                    "plan": None if chosen is None else asdict(chosen),
                    "rows": [asdict(row) | {"fits": row.fits} for row in rows],
                }
            )
        )
        return
    title = f"{shown.channels} channels on {link.name}, {link.cap:.0%} of which may be used"
    print_budget(rows, title, first=chosen is not None)


@app.command("check")
def check_display(
    url: Annotated[str, typer.Argument(help="Of the device.")],
    display: DisplayOption = "reference-24",
    write: Annotated[
        Path | None, typer.Option(help="Write the display file with the map that was told.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite that file.")] = False,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
) -> None:
    """Bring up a display, at 5 V at most: who is there, is each line good, what does it move.

    Asks at a terminal which contactor each channel moves. Exit code 1 where faults were found.

    Example: tactile check sim:
    """
    from rich.progress import Progress

    from tactile.daemon.bringup import bring_up

    with Progress(console=Console(stderr=True), transient=True, disable=as_json) as bar:
        task = bar.add_task("channels", total=None)

        def ask(question: str) -> str:
            bar.stop()
            return input(question)

        report = bring_up(
            url, display, write=write, force=force, accept_unsafe_hold=accept_unsafe_hold,
            ask=ask if sys.stdin.isatty() and not as_json else None,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(report.as_dict()))
    else:
        print_check(report.as_dict())
    raise typer.Exit(1 if report.faults else 0)


@app.command("serve")
def serve_displays(
    config: Annotated[
        Path | None, typer.Option(help="TOML file; a simulated display without one.")
    ] = None,
) -> None:
    """Play for other programs, such as VR apps, which connect by WebSocket or OSC.

    Example: tactile serve --config tactile.toml
    """
    from tactile.daemon.config import load_config
    from tactile.daemon.server import serve

    told = load_config(config)
    names = ", ".join(f"{one.name} ({one.device})" for one in told.display)
    serve(told, lambda server: typer.echo(f"{server.url} plays {names}; Ctrl-C ends it"))


@app.command()
def textures(
    name: Annotated[str | None, typer.Argument(help="Tell all of one texture.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the textures, or tell what one is and what of it a surface can have.

    Example: tactile textures wood-oak
    """
    if name is not None:
        _texture(name, as_json)
        return
    listed = [tactile.load_texture(known) for known in tactile.textures()]
    if as_json:
        typer.echo(json.dumps([_texture_facts(t) for t in listed]))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "category", "rms µm", "provenance", "description"):
        table.add_column(heading, justify="right" if heading == "rms µm" else "left")
    for t in listed:
        about = t.descriptor.texture
        rms = f"{_texture_facts(t)['rms_um']:.2f}"
        table.add_row(t.name, about.category, rms, about.provenance, about.description)
    Console().print(table)


def _texture_facts(t: "tactile.Texture") -> dict[str, Any]:
    about = t.descriptor.texture
    return {
        "name": t.name,
        "category": about.category,
        "description": about.description,
        "provenance": about.provenance,
        "source": about.source,
        "licence": about.licence,
        "rms_um": float((t.partials.amplitude**2).sum() / 2) ** 0.5 * 1e6,
        "partials": len(t.partials.amplitude),
        "band_frequency_per_mm": [round(f * 1e-3, 4) for f in t.band_frequency],
        "band_error_db": [round(float(e), 3) for e in t.band_error_db],
    }


def _texture(name: str, as_json: bool) -> None:
    t = tactile.load_texture(name)
    facts = _texture_facts(t)
    if as_json:
        typer.echo(json.dumps(facts))
        return
    rows = {k: str(facts[k]).strip() for k in ("category", "provenance", "licence", "source")}
    d = t.descriptor
    rows["strength"] = f"{facts['rms_um']:.2f} µm rms at {d.reference.speed_mm_s:g} mm/s"
    rows["parts"] = (
        f"{facts['partials']} partials, {len(d.periodic)} gratings, {len(d.events)} kinds of events"
    )
    _print_table(rows, f"{t.name}: {d.texture.description}")
    if d.stochastic is None:
        return
    table = Table(title="Bands along a stroke", title_justify="left", box=None, pad_edge=False)
    for heading in ("cycles/mm", "level dB re 1 µm²·mm", "realized − descriptor dB"):
        table.add_column(heading, justify="right")
    for f, level, error in zip(
        d.stochastic.frequency_per_mm, d.stochastic.level_db, t.band_error_db, strict=True
    ):
        table.add_row(f"{f:g}", f"{level:.1f}", f"{error:+.2f}")
    Console().print(table)


@app.command("response")
def tell_response(
    load: Annotated[
        list[Finger] | None, typer.Option(help="Finger: low, high or none; may be repeated.")
    ] = None,
    display: DisplayOption = "reference-24",
    plot: Annotated[Path | None, typer.Option(help="Draw it to a PNG, SVG or PDF.")] = None,
    as_json: AsJson = False,
) -> None:
    """Tell how a display's bimorph moves under a finger.

    Example: tactile response --load low --load high --plot response.png
    """
    from tactile.study import response_figures

    shown = tactile.load_display(display)
    loads = {f.value: getattr(tactile.FingerLoad, f.value)() for f in load or list(Finger)}
    figures = response_figures(shown.bimorph, loads, shown.limits.voltage)
    if plot is not None:
        from tactile.plots import plot_response

        curves = {
            name: tactile.tip_response(shown.bimorph, finger, _plot_frequencies())
            for name, finger in loads.items()
        }
        plot_response(plot, curves, voltage=shown.limits.voltage)
    if as_json:
        typer.echo(json.dumps(figures))
        return
    table = Table(title=f"Bimorph of {shown.name}", title_justify="left", box=None, pad_edge=False)
    table.add_column("finger")
    for heading in next(iter(figures.values())):
        table.add_column(heading.replace("_", " "), justify="right")
    for name, row in figures.items():
        table.add_row(name, *(f"{value:.4g}" for value in row.values()))
    Console().print(table)
    if plot is not None:
        typer.echo(f"drawn: {plot}")


def _plot_frequencies() -> Any:
    import numpy as np

    return np.geomspace(1, 2000, 2000)


@app.command("bench")
def run_benchmarks(
    only: Annotated[
        list[str] | None, typer.Argument(help="Names of benchmarks; all of them by default.")
    ] = None,
    long: Annotated[bool, typer.Option("--long", help="Also those that take minutes.")] = False,
    as_json: AsJson = False,
) -> None:
    """Measure every figure this project promises, beside other libraries where there are any.

    Example: tactile bench --json
    """
    from tactile.bench import BENCHMARKS, LONG, measure

    for name in only or []:
        if name not in BENCHMARKS | LONG:
            known = [*BENCHMARKS, *LONG]
            raise InputError(f"no benchmark {name!r}; {nearest(name, known)}")
    figures = measure(only or [*BENCHMARKS, *(LONG if long else [])])
    if as_json:
        typer.echo(json.dumps([figure.as_dict() for figure in figures], indent=1))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("figure", "measured", "goal", ""):
        table.add_column(heading, justify="right" if heading == "measured" else "left")
    for f in figures:
        mark = "" if f.reached is None else ("reached" if f.reached else "NOT REACHED")
        table.add_row(f.name, f"{f.value:.4g} {f.unit}", f.goal, mark)
    Console().print(table)


def main() -> None:
    """Run the command line; exit code 2 where a device or what was asked cannot be used."""
    try:
        with threadpool_limits(1):
            status = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    except (TactileError, OSError) as error:
        status = _complain(f"tactile: {error}")
        if rows := getattr(error, "rows", None):
            print_budget(rows, "", console=Console(stderr=True))
    except Exception as error:
        if not hasattr(error, "format_message"):  # the parser's own kind; typer does not export it
            raise
        context = getattr(error, "ctx", None)
        where = "tactile" if context is None else context.command_path
        status = _complain(f"{where}: {' '.join(error.format_message().split())}")
    sys.exit(status if isinstance(status, int) else 0)


def _complain(message: str) -> int:
    print(message, file=sys.stderr)
    return 2
