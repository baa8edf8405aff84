"""Program that prepares textures, as realizing a surface takes a second that nobody may wait for.

It answers each request with the pickle of the order for the playback process, so that the server
only passes it on.
"""

import os
import pickle
from contextlib import suppress
from dataclasses import dataclass

from tactile.display.display import Display
from tactile.errors import TactileError
from tactile.playback.commands import KeepTexture, PreparedTexture
from tactile.processes import pipes_of_parent, received, send
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.texture.surface import load_texture

NICE = 10
"""Niceness of the process, so that it yields to playback."""


@dataclass(frozen=True)
class PreparationRequest:
    """Request to prepare a texture for a display.

    Attributes
    ----------
    number : int
        Number of the request and of the texture.
    display : Display
        Display that the texture is for.
    texture : str
        Name or file of the texture.
    seed : int
        Seed of its realization.
    sample_rate : float
        Rate of the drive [Hz].
    carriers : int
        Number of carriers of a spectrum frame; 0 for a link that takes samples.
    frame_rate : float
        Rate of spectrum frames [Hz].
    """

    number: int
    display: Display
    texture: str
    seed: int
    sample_rate: float
    carriers: int
    frame_rate: float


@dataclass(frozen=True)
class Preparation:
    """Prepared texture, or why there is none: the answer to a request.

    Attributes
    ----------
    number : int
        Number of the request.
    order : bytes
        Pickle of (number, `KeepTexture`); empty after a failure.
    failure : str
        Reason why there is no texture; empty if there is one.
    """

    number: int
    order: bytes = b""
    failure: str = ""


def prepare(request: PreparationRequest) -> PreparedTexture:
    """Prepare a texture.

    Parameters
    ----------
    request : PreparationRequest
        What to prepare, and for what display.

    Returns
    -------
    PreparedTexture
        Texture for a link that takes samples, or for one that takes spectrum frames.

    Raises
    ------
    TactileError
        If the file of the texture cannot be used.
    """
    texture = load_texture(request.texture)
    if not request.carriers:
        return RealizedLayer(request.display, texture, seed=request.seed)
    return SpectrumRenderer(
        request.display, texture, carriers=request.carriers, frame_rate=request.frame_rate,
        sample_rate=request.sample_rate, seed=request.seed, whole_band=True,
    )  # fmt: skip


def main() -> None:
    """Serve requests from standard input until it ends."""
    inward, outward = pipes_of_parent()
    with suppress(AttributeError, OSError):
        os.nice(NICE)
    request: PreparationRequest
    for request in received(inward):
        try:
            order = request.number, KeepTexture(request.number, prepare(request))
            answer = Preparation(request.number, pickle.dumps(order, protocol=5))
        except (TactileError, OSError) as error:
            answer = Preparation(request.number, failure=str(error))
        try:
            send(outward, answer)
        except OSError:
            return
