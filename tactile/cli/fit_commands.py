"""The command ``fit``: from recordings to a texture."""

import json
import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tactile.cli.app import AsJson, app, print_table
from tactile.errors import InputError
from tactile.files import nearest
from tactile.texture.descriptor import About
from tactile.texture.descriptor_file import check_target, write
from tactile.texture.fitting import Fit
from tactile.texture.judging import Candidate, Verdict, fit_texture
from tactile.texture.recorded_slide import UNITS, load_recorded

STEPS = 8
"""Of the progress bar: strokes, lines and bands twice, statistics and surface."""


@app.command("fit")
def fit_recordings(
    recordings: Annotated[
        list[Path], typer.Argument(help="WAV, CSV or NPZ files of one surface, one slide each.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="TOML file; its name is the texture's.")],
    category: Annotated[str, typer.Option(help="wood, leather, plastic, textile, …")] = "test",
    speed_mm_s: Annotated[
        list[float] | None, typer.Option(help="Of each recording in turn, or one for all.")
    ] = None,
    normal_force_n: Annotated[
        list[float] | None, typer.Option(help="Of each recording in turn, or one for all.")
    ] = None,
    quantity: Annotated[
        str, typer.Option(help="In a WAV: acceleration, velocity, displacement or force.")
    ] = "acceleration",
    full_scale: Annotated[
        float | None,
        typer.Option(help="Of a WAV, in m/s², mm/s, µm or N; without it the level is assumed."),
    ] = None,
    noise: Annotated[
        Path | None, typer.Option(help="The same sensor with nothing sliding.")
    ] = None,
    reference_speed_mm_s: Annotated[
        float | None, typer.Option(help="At which it is to be true; by default the recordings'.")
    ] = None,
    description: Annotated[str, typer.Option(help="For people.")] = "",
    source: Annotated[str, typer.Option(help="Where the recordings come from.")] = "",
    license: Annotated[str, typer.Option(help="Of the texture.")] = "unstated",
    plot: Annotated[Path | None, typer.Option(help="Draw the fit to a PNG, SVG or PDF.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
    as_json: AsJson = False,
) -> None:
    """Fit a texture to recordings of a finger or a sensor that slides over it.

    Example: tactile fit denim1.wav denim2.wav --speed-mm-s 20 --speed-mm-s 30 --full-scale 104.6
    --category textile -o denim.toml --plot denim.png
    """
    about = _about(out, category, description, source, license)
    check_target(out, about.id, force=force)
    if plot is not None:
        from tactile.show.plots import check_file

        check_file(plot)
    if quantity not in UNITS:
        raise InputError(f"--quantity {quantity!r}; {nearest(quantity, list(UNITS))}")
    scale = None if full_scale is None else full_scale * UNITS[quantity][1]
    read = partial(load_recorded, quantity=quantity, full_scale=scale)
    speeds = _one_each(speed_mm_s, recordings, "--speed-mm-s", 1e-3)
    forces = _one_each(normal_force_n, recordings, "--normal-force-n", 1.0)
    slides = [
        read(path, speed=v, normal_force=n)
        for path, v, n in zip(recordings, speeds, forces, strict=True)
    ]
    silent = None if noise is None else read(noise, speed=1.0)
    reference = None if reference_speed_mm_s is None else reference_speed_mm_s * 1e-3
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(),
        console=Console(stderr=True), transient=True, disable=as_json,
    )  # fmt: skip
    with bar:
        task = bar.add_task("reading", total=STEPS)
        fit, verdict = fit_texture(
            slides, about, noise=silent, reference_speed=reference,
            progress=lambda step: bar.update(task, description=step, advance=1),
        )  # fmt: skip
    write(fit.descriptor, out, _comments(fit), force=force)
    if plot is not None:
        from tactile.show.plots import plot_fit

        plot_fit(plot, fit, verdict)
    if as_json:
        typer.echo(json.dumps(_facts(fit, verdict)))
        return
    _print_report(fit, verdict)
    typer.echo(f"written: {out}" + (f"; drawn: {plot}" if plot else ""))


def _about(out: Path, category: str, description: str, source: str, license: str) -> About:
    told = {
        "id": out.stem,
        "category": category,
        "description": description or out.stem,
        "provenance": "fitted",
        "source": source or "not told; fitted by tactile fit",
        "license": license,
    }
    try:
        return msgspec.convert(told, About)
    except msgspec.ValidationError as error:
        if "category" in str(error):
            known = list(get_args(get_type_hints(About)["category"]))
            raise InputError(f"--category {category!r}; {nearest(category, known)}") from error
        raise InputError(
            f"{out}: a texture is named in lower case and hyphens, as in denim-blue.toml"
        ) from error


def _one_each(
    given: list[float] | None, recordings: list[Path], name: str, unit: float
) -> list[float | None]:
    """Return an option's value for each recording."""
    if not given:
        return [None] * len(recordings)
    if len(given) not in (1, len(recordings)):
        raise InputError(
            f"{name} is given {len(given)} times for {len(recordings)} recordings: "
            "once for all, or for each in turn"
        )
    for value in given:
        if not 0 < value < math.inf:
            raise InputError(f"{name} {value:g}: must be above 0")
    whole = given * (len(recordings) if len(given) == 1 else 1)
    return [value * unit for value in whole]


def _comments(fit: Fit) -> dict[str, str]:
    """Return what the file says of its numbers."""
    slides = ", ".join(
        f"{name} at {v * 1e3:.3g} mm/s" for name, v in zip(fit.names, fit.speed, strict=True)
    )
    speed_error, force_error = fit.exponent_error
    return {
        "": "\n".join([f"Fitted to {slides}.", *fit.notes]),
        "stochastic.level_db": "mean over recordings, brought to the reference by the laws",
        "laws.speed_exponent": f"± {speed_error:.2f}",
        "laws.force_exponent": f"± {force_error:.2f}",
    }


def _facts(fit: Fit, verdict: Verdict) -> dict[str, Any]:
    return {
        "descriptor": msgspec.to_builtins(fit.descriptor),
        "recordings": [
            {"name": name, "speed_mm_s": v * 1e3, "level_db": _plain(level)}
            for name, v, level in zip(fit.names, fit.speed, fit.level, strict=True)
        ],
        "frequency_per_mm": _plain(fit.center * 1e-3),
        "speed_exponent_error": fit.exponent_error[0],
        "force_exponent_error": fit.exponent_error[1],
        "isotropic_loss_db": _plain(fit.isotropic_loss),
        "held_out_level_db": _plain(verdict.held_out),
        "held_out": {
            name: asdict(side) | {"level": _plain(side.level)}
            for name, side in _sides(verdict).items()
        },
        "notes": list(fit.notes),
    }


def _plain(values: Any) -> list[float | None]:
    return [round(float(x), 3) if math.isfinite(x) else None for x in values]


def _sides(verdict: Verdict) -> dict[str, Candidate]:
    return {
        "this texture": verdict.rendering,
        "the recordings themselves": verdict.ceiling,
        "autoregressive, order 8": verdict.autoregressive,
        "white noise": verdict.white,
    }


def _print_report(fit: Fit, verdict: Verdict) -> None:
    d, s = fit.descriptor, fit.descriptor.stochastic
    assert s is not None
    surface = (
        "isotropic"
        if s.direction_spread_deg is None
        else (
            f"along its direction, ± {s.direction_spread_deg:g}°; an isotropic surface would be "
            f"off by {np.abs(fit.isotropic_loss).max():.1f} dB"
        )
    )
    rows = {
        "bands": f"{s.frequency_per_mm[0]:g} … {s.frequency_per_mm[-1]:g} cycles/mm, {surface}",
        "at": f"{d.reference.speed_mm_s:g} mm/s, {d.reference.normal_force_n:g} N",
        "statistics": f"excess kurtosis {s.excess_kurtosis:g}, AM depth {s.am_depth:g} up to "
        f"{s.am_corner_per_mm:g} cycles/mm",
        "laws": f"speed^{d.laws.speed_exponent:g} ± {fit.exponent_error[0]:.2f}, "
        f"force^{d.laws.force_exponent:g} ± {fit.exponent_error[1]:.2f}",
        "gratings": "; ".join(
            f"{p.wavelength_mm:g} mm, {max(p.harmonics_um):.3g} µm" for p in d.periodic
        ) or "none stands out",
    }  # fmt: skip
    if d.friction is not None:
        rows["friction"] = (
            f"{d.friction.static_coefficient:g} at rest, {d.friction.kinetic_coefficient:g} sliding"
        )
    print_table(rows, f"{d.texture.id}, from {len(fit.names)} recordings")
    table = Table(title="Against recordings held out, 16 bands", title_justify="left", box=None)
    table.add_column("", no_wrap=True)
    for heading in ("rms dB", "mean abs. dB", "bias dB"):
        table.add_column(heading, justify="right")
    for name, side in _sides(verdict).items():
        table.add_row(name, f"{side.rms_db:.2f}", f"{side.absolute_db:.2f}", f"{side.bias_db:+.2f}")
    Console().print(table)
    for note in fit.notes:
        typer.echo(f"note: {note}")
