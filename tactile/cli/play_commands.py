"""Commands that play: ``play`` and ``serve``."""

import json
import math
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

import tactile
from tactile.cli.app import AcceptHold, AsJson, DisplayOption, app, print_table, within
from tactile.errors import BusError, InputError

STROKE = {
    "--speed-mm-s": (0.0, 2000.0, 80.0),
    "--seconds": (0.1, 86400.0, 5.0),
    "--angle-deg": (-360.0, 360.0, 0.0),
    "--normal-force-n": (0.0, 20.0, 0.5),
}
"""Least, most and default."""
LARGEST_GAIN = 1e3


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
    gain: Annotated[
        str, typer.Option(help="Of the texture, or auto: the largest within the limits.")
    ] = "1",
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
    from tactile.playback.runs import run

    stroke = {
        "--speed-mm-s": speed_mm_s,
        "--seconds": seconds,
        "--angle-deg": angle_deg,
        "--normal-force-n": normal_force_n,
    }
    trajectory = _trajectory(path, stroke)
    within("--sample-rate-hz", sample_rate_hz, 2500, 200000, 8000)
    shown, felt = tactile.load_display(display), tactile.load_texture(texture)
    factor = _gain(gain, shown, felt, stroke, path)
    watched = sys.stdout.isatty() and not (quiet or as_json)
    live, watch = (
        _live(shown, texture, sample_rate_hz or 8000.0) if watched else (nullcontext(), None)
    )
    with live:
        summary = run(
            shown, felt, trajectory,
            device=device, gain=factor, sample_rate=sample_rate_hz, seed=seed, record=record,
            watch=watch, realtime=watched, accept_unsafe_hold=accept_unsafe_hold,
        )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(summary.as_dict()))
    elif not quiet:
        print_table(_report(summary.as_dict()), f"Played {felt.descriptor.texture.description}")


def _trajectory(path: Path | None, stroke: dict[str, float | None]) -> "tactile.Trajectory":
    if path is not None:
        given = [name for name, value in stroke.items() if value is not None]
        if given:
            raise InputError(f"{given[0]} and --path exclude each other: the path says where to go")
        return tactile.Trajectory.from_csv(path)
    speed, seconds, angle, force = (
        within(name, stroke[name], *bounds) for name, bounds in STROKE.items()
    )
    return tactile.Trajectory.line(
        speed=speed * 1e-3, duration=seconds, angle=math.radians(angle), normal_force=force
    )


def _gain(
    told: str,
    display: "tactile.Display",
    texture: "tactile.Texture",
    stroke: dict[str, float | None],
    path: Path | None,
) -> float:
    """Return the gain that was told, or for "auto" the largest for the stroke."""
    if told != "auto":
        try:
            return within("--gain", float(told), 0.0, LARGEST_GAIN, 1.0)
        except ValueError:
            raise InputError(
                f"--gain {told}: must be auto or a number 0 … {LARGEST_GAIN:g}"
            ) from None
    if path is not None:
        raise InputError(
            "--gain auto and --path exclude each other: it is found for a straight stroke; "
            "`tactile strength` tells it for any speed"
        )
    speed, _, angle, force = (within(name, stroke[name], *STROKE[name]) for name in STROKE)
    line = tactile.SteadyStroke(speed=speed * 1e-3, normal_force=force, angle=math.radians(angle))
    return tactile.automatic_gain(display, texture, line).value


def _live(display: "tactile.Display", texture: str, sample_rate: float) -> tuple[Any, Any]:
    """Return a live terminal picture and what feeds it."""
    from rich.live import Live

    from tactile.playback.offline import PlayedBlock
    from tactile.show.live import LivePicture

    picture = LivePicture(display, texture=texture, sample_rate=sample_rate)

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
    if s["gain"] != 1:
        rows["gain"] = f"{s['gain']:.3g}"
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


@app.command("serve")
def serve_displays(
    config: Annotated[
        Path | None, typer.Option(help="TOML file; a simulated display without one.")
    ] = None,
) -> None:
    """Play for other programs, such as VR apps, which connect by WebSocket or OSC.

    Example: tactile serve --config tactile.toml
    """
    from tactile.server.config import load_config
    from tactile.server.server import serve

    told = load_config(config)
    names = ", ".join(f"{one.name} ({one.device})" for one in told.display)
    try:
        serve(told, lambda server: typer.echo(f"{server.url} plays {names}; Ctrl-C ends it"))
    except BusError as error:  # not 2: a device may be there when systemd tries again
        typer.echo(f"tactile: {error}", err=True)
        raise typer.Exit(1) from error
