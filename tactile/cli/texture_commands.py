"""Commands about textures: ``textures``."""

import json
from typing import Annotated, Any, get_args

import typer
from rich.console import Console, JustifyMethod
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app, print_table
from tactile.errors import NotFoundError
from tactile.files import nearest
from tactile.texture import descriptor
from tactile.texture.amplitudes import strength_of
from tactile.texture.descriptor import About, Descriptor

CATEGORIES = [str(name) for name in get_args(About.__annotations__["category"])]


@app.command()
def textures(
    name: Annotated[str | None, typer.Argument(help="Tell all of one texture.")] = None,
    category: Annotated[str | None, typer.Option(help="Only of one, such as wood.")] = None,
    search: Annotated[
        str | None, typer.Option(help="Only those whose id, description or source has this.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the textures, or tell what one is and what of it a surface can have.

    Example: tactile textures --category wood --search grain
    """
    if name is not None:
        _texture(name, as_json)
        return
    listed = _chosen(category, search)
    if as_json:
        typer.echo(json.dumps([_facts(d) for d in listed]))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "category", "rms µm", "provenance", "description"):
        side: JustifyMethod = "right" if heading == "rms µm" else "left"
        table.add_column(heading, justify=side, no_wrap=heading == "name")
    for d in listed:
        about = d.texture
        rms = f"{strength_of(d).rms_um:.2f}"
        table.add_row(about.id, about.category, rms, about.provenance, about.description)
    Console().print(table)


def _chosen(category: str | None, search: str | None) -> list[Descriptor]:
    """Return the shipped descriptors of a category that have the words searched for.

    Raises
    ------
    NotFoundError
        For a category that no descriptor can have, or where nothing is found.
    """
    if category is not None and category not in CATEGORIES:
        raise NotFoundError(f"no category {category!r}; {nearest(category, CATEGORIES)}")
    known = [descriptor.load(known) for known in descriptor.textures()]
    of_category = [d for d in known if category in (None, d.texture.category)]
    found = [d for d in of_category if search is None or _has(d, search)]
    if not found:
        where = f" of category {category!r}" if category else ""
        what = f" has {search!r} in its id, description or source" if search else " is shipped"
        raise NotFoundError(f"no texture{where}{what}")
    return found


def _has(d: Descriptor, words: str) -> bool:
    about = d.texture
    return words.casefold() in f"{about.id}\n{about.description}\n{about.source}".casefold()


def _facts(d: Descriptor) -> dict[str, Any]:
    """Return what is known of a texture without drawing its surface."""
    about = d.texture
    return {
        "name": about.id,
        "category": about.category,
        "description": about.description,
        "provenance": about.provenance,
        "source": about.source,
        "license": about.license,
        "rms_um": strength_of(d).rms_um,
    }


def _texture_facts(t: "tactile.Texture") -> dict[str, Any]:
    return _facts(t.descriptor) | {
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
    rows = {k: str(facts[k]).strip() for k in ("category", "provenance", "license", "source")}
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
