"""The command ``tactile show``."""

import tactile
from tactile.cli.options import (
    AsJson,
    DisplayOption,
    PlotOption,
    SpeedOption,
    TextureArgument,
    check_plot,
    emit,
    within,
)
from tactile.cli.printing import plain_console

SPEED = (5.0, 1000.0, 80.0)
"""Least, greatest and default speed in mm/s; at the least one, waves of 4 mm are at about 1 Hz."""


def run(
    texture: TextureArgument,
    display: DisplayOption = "reference-24",
    speed_mm_s: SpeedOption = None,
    plot: PlotOption = None,
    as_json: AsJson = False,
) -> None:
    """Show the surface and the spectrum of a texture.

    The spectrum is compared with the detection threshold and with what the display can play. A plot
    also shows the motion of the contactors of one row during a stroke.

    Example: tactile show wood-oak --speed-mm-s 80 --plot oak.png
    """
    from tactile.show.still import TextureScreen
    from tactile.show.views import view_figures, view_texture

    speed = within("--speed-mm-s", speed_mm_s, *SPEED) * 1e-3
    check_plot(plot)
    loaded = tactile.load_display(display)
    view = view_texture(tactile.load_texture(texture), loaded, speed=speed)
    if plot is not None:
        from tactile.show.plots import save, texture_figure

        save(texture_figure(view), plot)
        emit(view_figures(view), as_json, lambda _: print(f"drawn: {plot}"))
    else:
        emit(view_figures(view), as_json, lambda _: plain_console().print(TextureScreen(view)))
