"""Commands about other people's formats: ``convert``."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.app import AsJson, app, within


@app.command()
def convert(
    source: Annotated[str, typer.Argument(help="A file, or a texture's name.")],
    target: Annotated[Path, typer.Argument(help="The file to write.")],
    speed_mm_s: Annotated[
        float | None,
        typer.Option(help="Of the finger, where a texture becomes an effect, or the other way."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the target.")] = False,
    as_json: AsJson = False,
) -> None:
    """Convert effects and textures; the suffixes say between which formats.

    Reads .haptic, .ahap, .hjif, .wav, .toml and Penn texture models (.xml), writes .haptic,
    .ahap, .hjif, .wav, .toml and OpenXR buffers (.json). What the target cannot say is told.

    Example: tactile convert wood-oak oak.hjif --speed-mm-s 80
    """
    from tactile.texture.formats.conversion import convert_file

    speed = None
    if speed_mm_s is not None:
        speed = within("--speed-mm-s", speed_mm_s, 1.0, 1000.0, 80.0) * 1e-3
    done = convert_file(source, target, speed=speed, force=force)
    if as_json:
        facts: dict[str, Any] = {
            "target": str(target),
            "became": done.became,
            "lost": list(done.lost),
        }
        if done.became == "effect":
            facts |= {"channels": done.channels, "seconds": done.seconds}
        typer.echo(json.dumps(facts))
        return
    size = f", channels: {done.channels}, {done.seconds:.3g} s" if done.became == "effect" else ""
    typer.echo(f"{target}: {'an' if done.became == 'effect' else 'a'} {done.became}{size}")
    for line in done.lost:
        typer.echo(f"  {line}")
