"""Program that prepares and draws textures, which takes a second that nobody may wait for.

It answers each request for a texture with the pickle of the order for the playback process, so that
the server only passes it on.
"""

import os
import pickle
from collections.abc import Hashable
from contextlib import suppress
from dataclasses import dataclass

from tactile.display.display import Display
from tactile.errors import TactileError
from tactile.playback.commands import DeviceOpened, KeepTexture, PreparedTexture
from tactile.playback.session_orders import TextureDescription, realized
from tactile.processes import pipes_of_parent, received, send
from tactile.rendering.surface_picture import SurfacePicture, SurfaceSection, draw_surface
from tactile.strength.strength import gain_at_usual_speeds
from tactile.texture.surface import load_with_source

NICE = 10
"""Niceness of the process, so that it yields to playback."""
SMALL = 64 * 64
"""Maximum size of a picture that is kept, as every page asks for those of its list [pixels]."""
MOST_KEPT = 256
"""Maximum number of pictures that are kept."""
KEPT: dict[tuple[Hashable, ...], SurfacePicture] = {}
"""Small pictures by what they show and the content of the texture's file, the last ones at the
end."""


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
    how : DeviceOpened
        How the device of the display plays.
    largest : bool
        Whether to give the texture the gain of `gain_at_usual_speeds`.
    """

    number: int
    display: Display
    texture: str
    seed: int
    how: DeviceOpened
    largest: bool


@dataclass(frozen=True)
class Preparation:
    """Prepared texture, or why there is none: the answer to a request.

    Attributes
    ----------
    number : int
        Number of the request.
    order : bytes
        Pickle of the order for playback; empty after a failure.
    description : TextureDescription or None
        What the texture was realized from; None after a failure.
    failure : str
        Reason why there is no texture; empty if there is one.
    """

    number: int
    order: bytes = b""
    description: TextureDescription | None = None
    failure: str = ""


@dataclass(frozen=True)
class DrawingRequest:
    """Request to draw the surface of a texture.

    Attributes
    ----------
    number : int
        Number of the request.
    texture : str
        Name of the texture.
    seed : int
        Seed of its realization.
    section : SurfaceSection
        What to draw of the surface.
    """

    number: int
    texture: str
    seed: int
    section: SurfaceSection


@dataclass(frozen=True)
class Drawing:
    """Drawn surface, or why there is none: the answer to a request.

    Attributes
    ----------
    number : int
        Number of the request.
    picture : SurfacePicture or None
        The picture; None after a failure.
    failure : str
        Reason why there is no picture; empty if there is one.
    """

    number: int
    picture: SurfacePicture | None = None
    failure: str = ""


def order_number(texture: int) -> int:
    """Return the number of the order to keep a texture, which no other order has.

    Parameters
    ----------
    texture : int
        Number of the texture, from 1.

    Returns
    -------
    int
        Number of the order, below 0; nothing waits for its answer.
    """
    return -texture


def prepare(request: PreparationRequest) -> tuple[PreparedTexture, TextureDescription]:
    """Prepare a texture.

    Parameters
    ----------
    request : PreparationRequest
        What to prepare, and for what display.

    Returns
    -------
    texture : PreparedTexture
        Texture for a link that takes samples, or for one that takes spectrum frames.
    description : TextureDescription
        What it was realized from.

    Raises
    ------
    TactileError
        If the file of the texture cannot be used.
    """
    texture, source = load_with_source(request.texture)
    # which gain is the largest is not known for a finger that is still to be followed
    largest = request.largest and not request.how.follows
    gain = gain_at_usual_speeds(request.display, texture) if largest else 1.0
    prepared = realized(request.display, texture, request.seed, request.how, gain=gain)
    return prepared, TextureDescription(request.number, request.seed, source, gain)


def draw(request: DrawingRequest) -> SurfacePicture:
    """Draw the surface of a texture; small pictures are kept as long as its file is the same.

    Parameters
    ----------
    request : DrawingRequest
        What to draw.

    Returns
    -------
    SurfacePicture
        The picture.

    Raises
    ------
    TactileError
        If the file of the texture cannot be used.
    """
    texture, source = load_with_source(request.texture)
    section, seed = request.section, request.seed
    if section.columns * section.rows > SMALL:
        return draw_surface(texture, section, seed=seed)
    key = request.texture, source.text, *source.tables.values(), section, seed
    picture = KEPT.pop(key, None)
    if picture is None:
        picture = draw_surface(texture, section, seed=seed)
    KEPT[key] = picture  # used last, dropped last
    if len(KEPT) > MOST_KEPT:
        del KEPT[next(iter(KEPT))]
    return picture


def answer_to(request: PreparationRequest | DrawingRequest) -> Preparation | Drawing:
    """Prepare or draw a texture.

    Parameters
    ----------
    request : PreparationRequest or DrawingRequest
        What to prepare or to draw.

    Returns
    -------
    Preparation or Drawing
        Answer, with the reason if the texture cannot be used.
    """
    number = request.number
    try:
        if isinstance(request, DrawingRequest):
            return Drawing(number, draw(request))
        prepared, description = prepare(request)
    except (TactileError, OSError) as error:
        answer = Drawing if isinstance(request, DrawingRequest) else Preparation
        return answer(number, failure=str(error))
    order = order_number(number), KeepTexture(number, prepared)
    return Preparation(number, pickle.dumps(order, protocol=5), description)


def main() -> None:
    """Serve requests from standard input until it ends."""
    inward, outward = pipes_of_parent()
    with suppress(AttributeError, OSError):
        os.nice(NICE)
    for request in received(inward):
        try:
            send(outward, answer_to(request))
        except OSError:
            return
