"""The command ``tactile fit``."""

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import typer

from tactile.cli.options import AsJson, Force, PlotOption, check_plot, emit
from tactile.cli.printing import print_facts, print_table, progress_bar, right, unwrapped
from tactile.cli.textures_command import CATEGORIES
from tactile.errors import InputError
from tactile.files import nearest
from tactile.texture.descriptor import About
from tactile.texture.descriptor_file import check_target, write
from tactile.texture.fitting import Fit
from tactile.texture.judging import Candidate, Verdict, fit_texture
from tactile.texture.recorded_slide import UNITS, load_recorded

STEPS = 8
"""Number of steps of the progress bar: four to read and fit, four to judge the fit."""


def run(
    recordings: Annotated[
        list[Path],
        typer.Argument(help="WAV, CSV or NPZ files of one surface, with one slide in each."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Texture file to write (.toml); its name becomes the texture's."
        ),
    ],
    category: Annotated[
        str, typer.Option(help="Category of the texture, such as wood, leather or textile.")
    ] = "test",
    speed_mm_s: Annotated[
        list[float] | None,
        typer.Option(
            help="Speed of the slide in mm/s. Give it once for all recordings, or once for each in "
            "order."
        ),
    ] = None,
    normal_force_n: Annotated[
        list[float] | None,
        typer.Option(
            help="Normal force of the slide in N. Give it once for all recordings, or once for "
            "each in order."
        ),
    ] = None,
    quantity: Annotated[
        str,
        typer.Option(
            help="Quantity that a WAV file contains: acceleration, velocity, displacement or force."
        ),
    ] = "acceleration",
    full_scale: Annotated[
        float | None,
        typer.Option(
            help="Value of a full-scale WAV sample in m/s², mm/s, µm or N. Without it, the level "
            "of the texture is assumed."
        ),
    ] = None,
    noise: Annotated[
        Path | None, typer.Option(help="Recording of the same sensor while nothing slides.")
    ] = None,
    reference_speed_mm_s: Annotated[
        float | None,
        typer.Option(
            help="Speed in mm/s at which the texture matches the recordings; by default their own "
            "speed."
        ),
    ] = None,
    description: Annotated[str, typer.Option(help="One-line description of the texture.")] = "",
    source: Annotated[str, typer.Option(help="Origin of the recordings.")] = "",
    license_: Annotated[
        str, typer.Option("--license", help="License of the texture file.")
    ] = "unstated",
    plot: PlotOption = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fit a texture to recordings of a sliding finger or sensor.

    The result is compared with recordings that were left out of the fit.

    Example: tactile fit denim1.wav denim2.wav --speed-mm-s 20 --speed-mm-s 30 --full-scale 104.6
    --category textile -o denim.toml --plot denim.png
    """
    about = _about(out, category, description, source, license_)
    check_target(out, about.id, force=force)
    check_plot(plot)
    if quantity not in UNITS:
        raise InputError(f"--quantity {quantity!r}: {nearest(quantity, list(UNITS))}")
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
    with progress_bar(visible=not as_json) as bar:
        task = bar.add_task("reading", total=STEPS)
        fit, verdict = fit_texture(
            slides, about, noise=silent, reference_speed=reference,
            progress=lambda step: bar.update(task, description=step, advance=1),
        )  # fmt: skip
    write(fit.descriptor, out, _comments(fit), force=force)
    if plot is not None:
        from tactile.show.plots import fit_figure, save

        save(fit_figure(fit, verdict), plot)
    emit(_facts(fit, verdict), as_json, lambda _: _print_report(fit, verdict))
    if not as_json:
        print(f"written: {out}" + (f"; drawn: {plot}" if plot else ""))


def _about(out: Path, category: str, description: str, source: str, license_: str) -> About:
    """Return the first table of the texture file."""
    fields = {
        "id": out.stem,
        "category": category,
        "description": description or out.stem,
        "provenance": "fitted",
        "source": source or "not stated; fitted by tactile fit",
        "license": license_,
    }
    try:
        return msgspec.convert(fields, About)
    except msgspec.ValidationError as error:
        if "category" in str(error):
            raise InputError(f"--category {category!r}: {nearest(category, CATEGORIES)}") from error
        raise InputError(
            f"{out}: the name of a texture consists of lower-case letters, digits and hyphens, for "
            "example denim-blue.toml"
        ) from error


def _one_each(
    values: list[float] | None, recordings: list[Path], name: str, unit: float
) -> list[float | None]:
    """Return the value of an option for each recording, in SI units."""
    if not values:
        return [None] * len(recordings)
    if len(values) not in (1, len(recordings)):
        raise InputError(
            f"{name} is given {len(values)} times for {len(recordings)} recordings; give it once "
            "for all, or once for each"
        )
    for value in values:
        if not 0 < value < math.inf:
            raise InputError(f"{name} {value:g}: must be greater than 0")
    whole = values * (len(recordings) if len(values) == 1 else 1)
    return [value * unit for value in whole]


def _comments(fit: Fit) -> dict[str, str]:
    """Return the comments of the texture file, by the path of the key they are about."""
    slides = ", ".join(
        f"{name} at {v * 1e3:.3g} mm/s" for name, v in zip(fit.names, fit.speed, strict=True)
    )
    speed_error, force_error = fit.exponent_error
    return {
        "": "\n".join([f"Fitted to {slides}.", *fit.notes]),
        "stochastic.level_db": "mean of the recordings, scaled to the reference by [laws]",
        "laws.speed_exponent": f"± {speed_error:.2f}",
        "laws.force_exponent": f"± {force_error:.2f}",
    }


def _facts(fit: Fit, verdict: Verdict) -> dict[str, Any]:
    """Return the texture, its errors and its comparison with other models."""
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
        "held_out_frequency_per_mm": _plain(verdict.center * 1e-3),
        "held_out_level_db": _plain(verdict.held_out),
        "held_out": {
            name: asdict(side) | {"level": _plain(side.level)}
            for name, side in _sides(verdict).items()
        },
        "notes": list(fit.notes),
    }


def _plain(values: Any) -> list[float | None]:
    """Return numbers for JSON, with None for those that are not finite."""
    return [round(float(x), 3) if math.isfinite(x) else None for x in values]


def _sides(verdict: Verdict) -> dict[str, Candidate]:
    """Return the models that are compared with the recordings, by name."""
    return {
        "this texture": verdict.rendering,
        "the recordings themselves": verdict.ceiling,
        "autoregressive, order 8": verdict.autoregressive,
        "white noise": verdict.white,
    }


def _print_report(fit: Fit, verdict: Verdict) -> None:
    """Print the parameters of the texture and its comparison with other models."""
    d, s = fit.descriptor, fit.descriptor.stochastic
    assert s is not None
    surface = (
        "isotropic"
        if s.direction_spread_deg is None
        else (
            f"along its direction, ± {s.direction_spread_deg:g}°; an isotropic surface would be "
            f"wrong by up to {np.abs(fit.isotropic_loss).max():.1f} dB"
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
        ) or "none found",
        "periodic envelopes": "; ".join(
            f"{m.wavelength_mm:g} mm, depth {m.depth:g}" for m in d.modulation
        ) or "none found",
        "events": "; ".join(
            f"{e.density_per_mm2:g}/mm², {e.amplitude_um:g} µm, {e.width_mm:g} mm" for e in d.events
        ) or "none found",
    }  # fmt: skip
    if d.friction is not None:
        rows["friction"] = (
            f"{d.friction.static_coefficient:g} at rest, {d.friction.kinetic_coefficient:g} sliding"
        )
    print_facts(rows, f"{d.texture.id}, from {len(fit.names)} recordings")
    columns = [unwrapped("model"), *right("rms dB", "mean abs. dB", "bias dB")]
    errors = [
        (name, f"{side.rms_db:.2f}", f"{side.absolute_db:.2f}", f"{side.bias_db:+.2f}")
        for name, side in _sides(verdict).items()
    ]
    print_table(columns, errors, "Difference from the recordings left out, 25–800 Hz")
    for note in fit.notes:
        print(f"note: {note}")
