"""Commands that show textures: ``show`` one, ``sheet`` of many."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import tactile
from tactile.cli.app import AsJson, DisplayOption, app, within

SPEED = (5.0, 1000.0, 80.0)
"""mm/s: least, most and default; at the least, waves of 4 mm are at 1 Hz."""
SpeedOption = Annotated[float | None, typer.Option(help="Of the finger, 80 by default.")]


@app.command("show")
def show_texture(
    texture: Annotated[str, typer.Argument(help="A texture's name, or a TOML file.")],
    display: DisplayOption = "reference-24",
    speed_mm_s: SpeedOption = None,
    plot: Annotated[Path | None, typer.Option(help="Draw it to a PNG, SVG or PDF.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show a texture's surface, and its spectrum against what is felt and what the display can do.

    Drawn to a file it also has a stroke, as the contactors of one row do it.

    Example: tactile show wood-oak --speed-mm-s 80 --plot oak.png
    """
    from tactile.show.views import view_figures, view_texture

    speed = within("--speed-mm-s", speed_mm_s, *SPEED) * 1e-3
    if plot is not None:
        from tactile.show.plots.style import check_file

        check_file(plot)
    shown = tactile.load_display(display)
    view = view_texture(tactile.load_texture(texture), shown, speed=speed)
    if plot is not None:
        from tactile.show.plots import plot_texture

        plot_texture(plot, view)
    if as_json:
        typer.echo(json.dumps(view_figures(view)))
    elif plot is not None:
        typer.echo(f"drawn: {plot}")
    else:
        from tactile.show.still import TextureScreen

        Console().print(TextureScreen(view))


@app.command("sheet")
def draw_sheet(
    plot: Annotated[Path, typer.Argument(help="A PNG, SVG or PDF to draw.")],
    category: Annotated[str | None, typer.Option(help="Only of this one, such as wood.")] = None,
    speed_mm_s: SpeedOption = None,
) -> None:
    """Draw a sheet of all textures, a tile of its surface and a strip of its spectrum for each.

    Example: tactile sheet textures.png --category wood
    """
    from rich.progress import track

    from tactile.show.plots import plot_sheet
    from tactile.show.plots.style import check_file
    from tactile.show.views import names_of, tile

    speed = within("--speed-mm-s", speed_mm_s, *SPEED) * 1e-3
    check_file(plot)
    names = names_of(category)
    watched = track(names, "textures", console=Console(stderr=True), transient=True)
    tiles = [tile(tactile.load_texture(name), speed=speed) for name in watched]
    plot_sheet(plot, tiles, speed=speed)
    typer.echo(f"drawn: {plot}, {len(tiles)} textures")
