"""The program that makes textures ready: drawing a surface takes a second that nobody may wait.

It answers each request with the pickle of the order that a playback process is to have, so that
the server only hands it on.
"""

import os
import pickle
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from tactile.display.display import Display
from tactile.errors import TactileError
from tactile.playback.commands import Keep, Texture
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.texture.surface import load_texture

NICE = 10


@dataclass(frozen=True)
class DrawingRequest:
    """A texture to be made ready for a display, under a number; frames where it takes them."""

    number: int
    display: Display
    texture: str
    seed: int
    sample_rate: float
    carriers: int
    frame_rate: float


@dataclass(frozen=True)
class Made:
    """The answer: the pickle of (number, `Keep`), or why there is none."""

    number: int
    order: bytes = b""
    failure: str = ""


def make(request: DrawingRequest) -> Texture:
    """Return a texture made ready.

    Raises
    ------
    TactileError
        Where its file cannot be used.
    """
    texture = load_texture(request.texture)
    if not request.carriers:
        return RealizedLayer(request.display, texture, seed=request.seed)
    return SpectrumRenderer(
        request.display, texture, carriers=request.carriers, frame_rate=request.frame_rate,
        sample_rate=request.sample_rate, seed=request.seed, whole_band=True,
    )  # fmt: skip


def main() -> None:
    """Make what is asked for on standard input."""
    pipe: Any = os.fdopen(os.dup(0), "rb")
    out: Any = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with suppress(AttributeError, OSError):
        os.nice(NICE)
    while True:
        try:
            request: DrawingRequest = pickle.load(pipe)
        except (EOFError, OSError, pickle.UnpicklingError):
            sys.exit(0)
        try:
            order = request.number, Keep(request.number, make(request))
            made = Made(request.number, pickle.dumps(order, protocol=5))
        except (TactileError, OSError) as error:
            made = Made(request.number, failure=str(error))
        try:
            out.write(pickle.dumps(made, protocol=5))
            out.flush()
        except OSError:
            sys.exit(0)
