"""The command ``tactile sheet``."""

from pathlib import Path
from typing import Annotated

import typer

import tactile
from tactile.cli.options import SpeedOption, check_plot, within
from tactile.cli.printing import progress_bar
from tactile.cli.show_command import SPEED
from tactile.cli.textures_command import DISPLAY, find_textures


def run(
    plot: Annotated[Path, typer.Argument(help="PNG, SVG or PDF file to write.")],
    category: Annotated[
        str | None, typer.Option(help="Draw only the textures of this category, such as wood.")
    ] = None,
    speed_mm_s: SpeedOption = None,
) -> None:
    """Draw an overview of the shipped textures.

    Each texture has a tile that shows its surface and a strip that shows its spectrum.

    Example: tactile sheet textures.png --category wood
    """
    from tactile.show.plots import save, sheet_figure
    from tactile.show.views import tile
    from tactile.strength.strength import SteadyStroke, conditions

    stroke = SteadyStroke(speed=within("--speed-mm-s", speed_mm_s, *SPEED) * 1e-3)
    display = tactile.load_display(DISPLAY)
    check_plot(plot)
    names = [descriptor.texture.id for descriptor in find_textures(category)]
    with progress_bar(visible=True) as bar:
        watched = bar.track(names, description="textures")
        tiles = [tile(tactile.load_texture(name), display, stroke) for name in watched]
    save(sheet_figure(tiles, conditions=conditions(display, stroke)), plot)
    print(f"drawn: {plot}, {len(tiles)} textures")
