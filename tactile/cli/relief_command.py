"""The command ``tactile relief``."""

from pathlib import Path
from typing import Annotated, Any

import typer

import tactile
from tactile.cli.options import AsJson, Force, emit
from tactile.cli.printing import print_bands, print_facts

LOST_DB = 1.0
"""Error in dB above which a band that the surface cannot realize is listed."""


def run(
    picture: Annotated[
        Path,
        typer.Argument(
            help="Height map: PNG file with 8 or 16 bits of gray, in which brighter is higher."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Texture file to write (.toml); its name becomes the texture's."
        ),
    ],
    category: Annotated[str, typer.Option(help="Category of the texture, such as wood.")],
    um_per_level: Annotated[
        float | None, typer.Option(help="Height of one gray level in µm. Required.")
    ] = None,
    mm_per_pixel: Annotated[
        float | None,
        typer.Option(
            help="Width of one pixel in mm, at most 0.0625 to resolve 8 cycles/mm. Required."
        ),
    ] = None,
    with_map: Annotated[
        bool,
        typer.Option(
            "--map",
            help="Play the height map itself, which the texture then contains, instead of bands "
            "and gratings.",
        ),
    ] = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Create a texture from a height map of a surface.

    A model of skin that follows relief converts heights to skin displacement. Wavelengths,
    directions and shapes are measured in the picture; levels are accurate to a factor of 2. The
    texture is a random surface with the same spectrum; with --map it is the relief in the picture,
    which repeats without a seam.

    Example: tactile relief bark.png -o bark.toml --um-per-level 0.5 --mm-per-pixel 0.02
    --category wood
    """
    from tactile.texture import descriptor_file
    from tactile.texture.picture import read_height
    from tactile.texture.relief_texture import check_name, texture_of

    check_name(out.stem, category)
    descriptor_file.check_target(out, out.stem, force=force)
    heights = read_height(picture, um_per_level=um_per_level, mm_per_pixel=mm_per_pixel)
    result = texture_of(
        heights, name=out.stem, category=category, picture=picture.name, with_map=with_map
    )
    descriptor_file.write(result.descriptor, out, result.comments, force=force)
    emit(_facts(result, tactile.load_texture(out), out), as_json, _print)


def _facts(result: Any, texture: "tactile.Texture", out: Path) -> dict[str, Any]:
    """Return what was measured in the picture and what the surface realizes."""
    random, played = result.descriptor.stochastic, result.descriptor.map
    return {
        "file": str(out),
        "name": texture.name,
        "roughness_um": result.roughness_um,
        "rms_um": result.rms_um,
        "sag_um": result.sag_um,
        "rms_slope": result.rms_slope,
        "contact_share": result.contact_share,
        "skin_rms_um": float((texture.partials.amplitude**2).sum() / 2) ** 0.5 * 1e6,
        "periodic": [
            {
                "wavelength_mm": part.wavelength_mm,
                "direction_deg": part.direction_deg,
                "harmonics_um": part.harmonics_um,
            }
            for part in result.descriptor.periodic
        ],
        "direction_deg": None if random is None else random.direction_deg,
        "direction_spread_deg": None if random is None else random.direction_spread_deg,
        "resultant": result.resultant,
        "excess_kurtosis": None if random is None else random.excess_kurtosis,
        "am_depth": None if random is None else random.am_depth,
        "frequency_per_mm": [] if random is None else random.frequency_per_mm,
        "level_db": [] if random is None else random.level_db,
        "band_error_db": [round(float(e), 3) for e in texture.band_error_db],
        "map": played
        and {name: getattr(played, name) for name in ("width_mm", "height_mm", "columns", "rows")},
        "coarser_share": result.outside[0],
        "finer_share": result.outside[1],
        "notes": result.notes,
    }


def _print(f: dict[str, Any]) -> None:
    """Print the measured relief, the parts of the texture and its bands."""
    rows = {
        "relief": f"Ra {f['roughness_um']:.3g} µm, {f['rms_um']:.3g} µm rms after "
        f"leveling; a curvature of {f['sag_um']:.3g} µm remains",
        "contact": f"rms slope {f['rms_slope']:.2g}; the skin touches {f['contact_share']:.0%} of "
        "the finest relief",
        "skin": f"{f['skin_rms_um']:.2g} µm rms, accurate to a factor of 2",
    }
    for i, part in enumerate(f["periodic"], 1):
        harmonics = ", ".join(f"{a:g}" for a in part["harmonics_um"])
        rows[f"periodic {i}"] = (
            f"every {part['wavelength_mm']:.4g} mm across {part['direction_deg']:g}°, "
            f"harmonics {harmonics} µm"
        )
    rows["random"] = _random(f)
    if f["map"]:
        rows["map"] = (
            "{width_mm:.3g} × {height_mm:.3g} mm in {columns} × {rows} pixels, then it repeats"
        ).format(**f["map"])
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
        rows["lost"] = f"bands in cycles/mm that the surface cannot realize: {', '.join(lost)}"
    rows |= {f"note {i}": note for i, note in enumerate(f["notes"], 1)}
    print_facts(rows, f"{f['file']}: a texture from relief")
    if f["level_db"]:
        print_bands(f["frequency_per_mm"], f["level_db"], f["band_error_db"])


def _random(f: dict[str, Any]) -> str:
    """Return the description of the random part."""
    if f["direction_deg"] is None:
        return "none"
    unsteady = f"excess kurtosis {f['excess_kurtosis']:g}, envelope {f['am_depth']:g} deep"
    if f["direction_spread_deg"] is None:
        return f"isotropic (resultant {f['resultant']:.2f}), {unsteady}"
    return f"across {f['direction_deg']:g}° ± {f['direction_spread_deg']:g}°, {unsteady}"
