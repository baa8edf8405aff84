"""The command ``tactile textures``."""

from dataclasses import asdict
from typing import Annotated, Any, get_args

import typer

import tactile
from tactile.cli.options import AsJson, emit
from tactile.cli.printing import print_bands, print_facts, print_table, right, unwrapped
from tactile.errors import NotFoundError
from tactile.files import nearest
from tactile.texture import descriptor
from tactile.texture.descriptor import About, Descriptor

DISPLAY = "reference-24"
"""Display for which figures are given."""
CATEGORIES = [str(name) for name in get_args(About.__annotations__["category"])]


def run(
    name: Annotated[
        str | None,
        typer.Argument(help="Texture to describe: name or TOML file. Without it, list all."),
    ] = None,
    category: Annotated[
        str | None, typer.Option(help="List only the textures of this category, such as wood.")
    ] = None,
    search: Annotated[
        str | None,
        typer.Option(
            help="List only the textures whose name, description or source has this text."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the shipped textures, or describe one of them.

    The description of one texture includes the spectrum that its surface realizes.

    Example: tactile textures --category wood --search grain
    """
    display = tactile.load_display(DISPLAY)
    if name is not None:
        texture = tactile.load_texture(name)
        emit(
            _texture_facts(texture, display), as_json, lambda facts: _print_texture(texture, facts)
        )
    else:
        listed = [
            _facts(d) | _stroke_facts(tactile.load_texture(d.texture.id), display)
            for d in find_textures(category, search)
        ]
        emit(listed, as_json, _print_list)


def find_textures(category: str | None, search: str | None = None) -> list[Descriptor]:
    """Return the shipped descriptors of a category that contain the text searched for.

    Parameters
    ----------
    category : category of the textures, or None for all
    search : text to search for, or None

    Returns
    -------
    list of Descriptor
        At least one descriptor.

    Raises
    ------
    NotFoundError
        If there is no such category, or no such texture.
    """
    if category is not None and category not in CATEGORIES:
        raise NotFoundError(f"no category {category!r}; {nearest(category, CATEGORIES)}")
    known = [descriptor.load(known) for known in descriptor.textures()]
    of_category = [d for d in known if category in (None, d.texture.category)]
    matches = [d for d in of_category if search is None or _has(d, search)]
    if not matches:
        where = f" of category {category!r}" if category else ""
        what = f" has {search!r} in its name, description or source" if search else " is shipped"
        raise NotFoundError(f"no texture{where}{what}")
    return matches


def _has(d: Descriptor, words: str) -> bool:
    """Return whether a descriptor contains a text, in any case of letters."""
    about = d.texture
    return words.casefold() in f"{about.id}\n{about.description}\n{about.source}".casefold()


def _facts(d: Descriptor) -> dict[str, Any]:
    """Return what the descriptor of a texture states."""
    about = d.texture
    return {
        "name": about.id,
        "category": about.category,
        "description": about.description,
        "provenance": about.provenance,
        "source": about.source,
        "license": about.license,
    }


def _stroke_facts(texture: "tactile.Texture", display: "tactile.Display") -> dict[str, Any]:
    """Return what a texture commands in the stroke that is assumed unless another is given."""
    from tactile.strength.strength import SteadyStroke, commanded_figures, conditions

    stroke = SteadyStroke()
    return {
        "conditions": conditions(display, stroke),
        "commanded": asdict(commanded_figures(display, texture, stroke)),
    }


def _texture_facts(t: "tactile.Texture", display: "tactile.Display") -> dict[str, Any]:
    """Return what the descriptor of a texture states and what its surface realizes."""
    return (
        _facts(t.descriptor)
        | _stroke_facts(t, display)
        | {
            "partials": len(t.partials.amplitude),
            "band_frequency_per_mm": [round(f * 1e-3, 4) for f in t.band_frequency],
            "band_error_db": [round(float(e), 3) for e in t.band_error_db],
        }
    )


def _print_list(listed: list[dict[str, Any]]) -> None:
    """Print a line for each texture."""
    columns = [unwrapped("name"), *right("µm rms", "dB SL"), "provenance", "description"]
    rows = (
        (
            t["name"], f"{t['commanded']['vibration_um_rms']:.2f}",
            f"{round(t['commanded']['level_db_sl']):+d}", t["provenance"], t["description"],
        )
        for t in listed
    )  # fmt: skip
    title = "Vibration (20–1000 Hz) and level above the detection threshold, commanded on "
    print_table(columns, rows, title + listed[0]["conditions"])


def _print_texture(t: "tactile.Texture", facts: dict[str, Any]) -> None:
    """Print the description, the figures and the bands of a texture."""
    from tactile.strength.figures import ShearFigures, figure_rows

    rows = {k: str(facts[k]).strip() for k in ("category", "provenance", "license", "source")}
    d = t.descriptor
    rows["on"] = facts["conditions"]
    rows |= figure_rows(ShearFigures(**facts["commanded"]), None)
    rows["parts"] = (
        f"{facts['partials']} partials, {len(d.periodic)} gratings, {len(d.events)} kinds of events"
    )
    print_facts(rows, f"{t.name}: {d.texture.description}")
    if d.stochastic is not None:
        print_bands(d.stochastic.frequency_per_mm, d.stochastic.level_db, t.band_error_db)
