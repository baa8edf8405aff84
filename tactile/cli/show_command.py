"""The command ``tactile show``."""

from pathlib import Path

import tactile
from tactile.cli.options import (
    AsJson,
    DisplayOption,
    PlotOption,
    SpeedOption,
    TextureOrEffect,
    check_plot,
    emit,
    within,
)
from tactile.cli.printing import plain_console
from tactile.errors import InputError

SPEED = (5.0, 1000.0, 80.0)
"""Least, greatest and default speed in mm/s; at the least one, waves of 4 mm are at about 1 Hz."""


def run(
    texture: TextureOrEffect,
    display: DisplayOption = "reference-24",
    speed_mm_s: SpeedOption = None,
    plot: PlotOption = None,
    as_json: AsJson = False,
) -> None:
    """Show a texture with its surface and spectrum, or an effect.

    The spectrum is compared with the detection threshold and with what the display can play. A plot
    also shows the motion of the contactors of one row during a stroke. An effect is shown as its
    shear over time and the spectrum of that.

    Example: tactile show wood-oak --speed-mm-s 80 --plot oak.png
    """
    from tactile.texture.formats.conversion import is_effect

    if is_effect(texture):
        if speed_mm_s is not None:
            raise InputError(f"--speed-mm-s cannot be used with {texture}, which is an effect")
        _show_effect(texture, plot, as_json)
        return
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


def _show_effect(source: str, plot: Path | None, as_json: bool) -> None:
    """Show an effect."""
    from tactile.show.effect_view import EffectScreen, effect_figures, view_effect
    from tactile.texture.formats.conversion import load_named

    check_plot(plot)
    view = view_effect(load_named(source))
    if plot is not None:
        from tactile.show.plots import effect_figure, save

        save(effect_figure(view), plot)
        emit(effect_figures(view), as_json, lambda _: print(f"drawn: {plot}"))
    else:
        emit(effect_figures(view), as_json, lambda _: plain_console().print(EffectScreen(view)))
