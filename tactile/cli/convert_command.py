"""The command ``tactile convert``."""

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.options import AsJson, Force, emit, within


def run(
    source: Annotated[str, typer.Argument(help="File to read, or the name of a shipped texture.")],
    target: Annotated[Path, typer.Argument(help="File to write; its suffix selects the format.")],
    speed_mm_s: Annotated[
        float | None,
        typer.Option(
            help="Speed of the finger in mm/s at which a texture becomes an effect, or an effect a "
            "texture."
        ),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Convert haptic effects and textures to other formats.

    Reads .haptic, .ahap, .hjif, .wav, .toml and Penn texture models (.xml); writes .haptic, .ahap,
    .hjif, .wav, .toml and OpenXR buffers (.json). Everything that the target format cannot express
    is listed.

    Example: tactile convert wood-oak oak.hjif --speed-mm-s 80
    """
    from tactile.texture.formats.conversion import convert_file

    speed = None
    if speed_mm_s is not None:
        speed = within("--speed-mm-s", speed_mm_s, 1.0, 1000.0, 80.0) * 1e-3
    done = convert_file(source, target, speed=speed, force=force)
    facts: dict[str, Any] = {"target": str(target), "became": done.became, "lost": list(done.lost)}
    if done.became == "effect":
        facts |= {"channels": done.channels, "seconds": done.seconds}
    emit(facts, as_json, _print)


def _print(f: dict[str, Any]) -> None:
    """Print what was written and what was lost."""
    if f["became"] == "effect":
        print(f"{f['target']}: an effect, channels: {f['channels']}, {f['seconds']:.3g} s")
    else:
        print(f"{f['target']}: a {f['became']}")
    for line in f["lost"]:
        print(f"  {line}")
