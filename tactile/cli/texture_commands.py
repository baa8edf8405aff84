"""Commands about textures: ``textures``."""

import json
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app, print_table


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
    print_table(rows, f"{t.name}: {d.texture.description}")
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
