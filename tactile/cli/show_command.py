"""The command ``tactile show``."""

import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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

if TYPE_CHECKING:
    from tactile.server.server import Server

SPEED = (5.0, 1000.0, 80.0)
"""Least, greatest and default speed in mm/s; at the least one, waves of 4 mm are at about 1 Hz."""


def run(
    texture: TextureOrEffect,
    display: DisplayOption = "reference-24",
    speed_mm_s: SpeedOption = None,
    plot: PlotOption = None,
    as_json: AsJson = False,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="Open a page in the browser, on which a mouse or a finger strokes a shipped "
            "texture on the simulated display, until Ctrl-C.",
        ),
    ] = False,
) -> None:
    """Show a texture with its surface and spectrum, or an effect.

    The spectrum is compared with the detection threshold and with what the display can play. A plot
    also shows the motion of the contactors of one row during a stroke. An effect is shown as its
    shear over time and the spectrum of that.

    Example: tactile show wood-oak --speed-mm-s 80 --plot oak.png
    """
    from tactile.texture.formats.conversion import is_effect

    if live:
        given = {"--speed-mm-s": speed_mm_s, "--plot": plot, "--json": as_json or None}
        refused = [option for option, value in given.items() if value is not None]
        if refused:
            raise InputError(f"{refused[0]} cannot be used with --live, which shows a page")
        _show_live(texture, display)
        return
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


def _show_live(texture: str, display: str) -> None:
    """Serve the page with a texture on a simulated display, and open it in the browser."""
    from tactile.server.config import Configuration, DisplayConfig, ServerConfig
    from tactile.server.server import serve
    from tactile.texture.descriptor import textures

    if texture not in textures():
        tactile.load_texture(texture)  # which says what is wrong with a name
        raise InputError(f"{texture} is no shipped texture, and --live plays no others")
    settings = Configuration(
        server=ServerConfig(port=0, socket=""),  # beside any other server
        display=(DisplayConfig(name="simulated", display=display),),
    )

    def open_page(server: "Server") -> None:
        page = f"{server.page}#texture={texture}"
        print(f"{page} shows {texture} on a simulated display; Ctrl-C ends it", flush=True)
        # in a thread, as a browser in the terminal returns when it is left
        threading.Thread(target=webbrowser.open, args=(page,), daemon=True).start()

    serve(settings, open_page)
