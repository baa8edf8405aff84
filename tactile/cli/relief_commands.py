"""The command ``relief``: a texture from a picture of a surface's relief."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app, print_table

LOST_DB = 1.0
"""A band that the realized surface misses by more is named."""


@app.command("relief")
def make_relief(
    picture: Annotated[
        Path, typer.Argument(help="Height map: PNG of 8- or 16-bit gray, bright is high.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="TOML file; its name becomes the texture's.")
    ],
    category: Annotated[str, typer.Option(help="Of the material, such as wood.")],
    um_per_level: Annotated[
        float | None, typer.Option(help="Height of one gray level; there is no default.")
    ] = None,
    mm_per_pixel: Annotated[
        float | None, typer.Option(help="At most 0.0625, for 8 cycles/mm.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
    as_json: AsJson = False,
) -> None:
    """Make a texture from a height map, by a model of how skin follows relief.

    Wavelengths, directions and shapes are measured; levels are good to a factor of 2.

    Example: tactile relief bark.png -o bark.toml --um-per-level 0.5 --mm-per-pixel 0.02
    --category wood
    """
    from tactile.texture import descriptor_file
    from tactile.texture.picture import read_height
    from tactile.texture.relief_texture import check_name, texture_of

    check_name(output.stem, category)
    descriptor_file.check_target(output, output.stem, force=force)
    heights = read_height(picture, um_per_level=um_per_level, mm_per_pixel=mm_per_pixel)
    made = texture_of(heights, name=output.stem, category=category, picture=picture.name)
    descriptor_file.write(made.descriptor, output, made.comments, force=force)
    facts = _facts(made, tactile.load_texture(output), output)
    if as_json:
        typer.echo(json.dumps(facts))
    else:
        _print(facts)


def _facts(made: Any, texture: "tactile.Texture", output: Path) -> dict[str, Any]:
    random = made.descriptor.stochastic
    return {
        "file": str(output),
        "name": texture.name,
        "roughness_um": made.roughness_um,
        "rms_um": made.rms_um,
        "sag_um": made.sag_um,
        "rms_slope": made.rms_slope,
        "contact_share": made.contact_share,
        "skin_rms_um": float((texture.partials.amplitude**2).sum() / 2) ** 0.5 * 1e6,
        "periodic": [
            {
                "wavelength_mm": part.wavelength_mm,
                "direction_deg": part.direction_deg,
                "harmonics_um": part.harmonics_um,
            }
            for part in made.descriptor.periodic
        ],
        "direction_deg": None if random is None else random.direction_deg,
        "direction_spread_deg": None if random is None else random.direction_spread_deg,
        "resultant": made.resultant,
        "excess_kurtosis": None if random is None else random.excess_kurtosis,
        "am_depth": None if random is None else random.am_depth,
        "frequency_per_mm": [] if random is None else random.frequency_per_mm,
        "level_db": [] if random is None else random.level_db,
        "band_error_db": [round(float(e), 3) for e in texture.band_error_db],
        "coarser_share": made.outside[0],
        "finer_share": made.outside[1],
        "notes": made.notes,
    }


def _print(f: dict[str, Any]) -> None:
    rows = {
        "relief": f"Ra {f['roughness_um']:.3g} µm, {f['rms_um']:.3g} µm rms, leveled; "
        f"a curvature of {f['sag_um']:.3g} µm is left in it",
        "contact": f"rms slope {f['rms_slope']:.2g}: skin touches {f['contact_share']:.0%} of the "
        "finest relief",
        "skin": f"{f['skin_rms_um']:.2g} µm rms, known within a factor of 2",
    }
    for i, part in enumerate(f["periodic"], 1):
        harmonics = ", ".join(f"{a:g}" for a in part["harmonics_um"])
        rows[f"periodic {i}"] = (
            f"every {part['wavelength_mm']:.4g} mm across {part['direction_deg']:g}°, "
            f"harmonics {harmonics} µm"
        )
    rows["random"] = _random(f)
    rows["outside"] = (
        f"{f['coarser_share']:.1%} of the relief's variance is coarser than the bands, "
        f"{f['finer_share']:.1%} finer"
    )
    lost = [
        f"{c:g} ({e:+.1f} dB)"
        for c, e in zip(f["frequency_per_mm"], f["band_error_db"], strict=True)
        if abs(e) > LOST_DB
    ]
    if lost:
        rows["lost"] = f"bands that such a surface cannot have, in cycles/mm: {', '.join(lost)}"
    rows |= {f"note {i}": note for i, note in enumerate(f["notes"], 1)}
    print_table(rows, f"{f['file']}: a texture from relief")
    _print_bands(f)


def _random(f: dict[str, Any]) -> str:
    if f["direction_deg"] is None:
        return "none"
    unsteady = f"excess kurtosis {f['excess_kurtosis']:g}, envelope {f['am_depth']:g} deep"
    if f["direction_spread_deg"] is None:
        return f"isotropic (resultant {f['resultant']:.2f}), {unsteady}"
    return f"across {f['direction_deg']:g}° ± {f['direction_spread_deg']:g}°, {unsteady}"


def _print_bands(f: dict[str, Any]) -> None:
    if not f["level_db"]:
        return
    table = Table(title="Bands along a stroke", title_justify="left", box=None, pad_edge=False)
    for heading in ("cycles/mm", "level dB re 1 µm²·mm", "realized − descriptor dB"):
        table.add_column(heading, justify="right")
    for c, level, error in zip(
        f["frequency_per_mm"], f["level_db"], f["band_error_db"], strict=True
    ):
        table.add_row(f"{c:g}", f"{level:.1f}", f"{error:+.2f}")
    Console().print(table)
