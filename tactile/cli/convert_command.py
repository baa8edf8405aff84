"""The command ``tactile convert``."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.options import AsJson, Force, emit, within
from tactile.cli.printing import print_table, right


def run(
    source: Annotated[str, typer.Argument(help="File to read, or the name of a shipped texture.")],
    target: Annotated[Path, typer.Argument(help="File to write; its suffix selects the format.")],
    speed_mm_s: Annotated[
        float | None,
        typer.Option(
            help="Speed of the finger in mm/s at which a texture becomes an effect, an effect a "
            "texture, or a model states its levels."
        ),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Convert haptic effects and textures to other formats.

    Reads .haptic, .ahap, .hjif, .wav, .toml, Penn texture models (.xml) and learned models (.onnx);
    writes .haptic, .ahap, .hjif, .wav, .toml and OpenXR buffers (.json). Everything that the target
    format cannot express is listed.

    A learned model has one float32 input (N, 2), speed in mm/s and normal force in N, and one
    float32 output (N, B), levels of third octaves in dB re 1 µm²·mm. Its metadata has the JSON
    arrays frequency_per_mm, speed_range_mm_s and normal_force_range_n, and the texts quantity
    ("tangential_skin_displacement") and source, and may have category and license. It needs the
    extra onnx.

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
    if done.bands:
        facts["bands"] = [asdict(band) for band in done.bands]
    emit(facts, as_json, _print)


def _print(f: dict[str, Any]) -> None:
    """Print what was written and what was lost."""
    if f["became"] == "effect":
        print(f"{f['target']}: an effect, channels: {f['channels']}, {f['seconds']:.3g} s")
    else:
        print(f"{f['target']}: a {f['became']}")
    for line in f["lost"]:
        print(f"  {line}")
    if "bands" in f:
        columns = right("cycles/mm", "level dB re 1 µm²·mm", "error dB rms", "largest error dB")
        rows = (
            (f"{b['frequency_per_mm']:g}", f"{b['level_db']:.1f}", f"{b['rms_db']:.2f}",
             f"{b['worst_db']:+.2f}")
            for b in f["bands"]
        )  # fmt: skip
        print_table(columns, rows, "Texture, and its difference from the model")
