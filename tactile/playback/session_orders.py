"""Orders of a session as JSON: a text that is complete and that any program reads."""

import base64
import dataclasses
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from tactile.display.display import Display
from tactile.errors import InputError
from tactile.files import SourceFile
from tactile.playback import commands
from tactile.playback.commands import PreparedTexture
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.strength.strength import amplified
from tactile.texture.surface import Texture


@dataclass(frozen=True)
class TextureDescription:
    """Description of the texture that `KeepTexture` carries.

    Attributes
    ----------
    number : int
        Number of the texture.
    seed : int
        Seed of its realization.
    source : SourceFile
        Text of its file.
    gain : float
        Gain that is part of the realization; sessions before there was one had gain 1.
    """

    number: int
    seed: int
    source: SourceFile
    gain: float = 1.0


SessionOrder = (
    TextureDescription | commands.DropTexture | commands.SetState | commands.AppendSamples
    | commands.AddFrames | commands.BeginEffect | commands.PlayAt | commands.EndWaves
    | commands.ForgetClient
)  # fmt: skip
"""Order to playback as a session holds it."""
KINDS: dict[str, type[SessionOrder]] = {
    "keep": TextureDescription,
    "drop": commands.DropTexture,
    "state": commands.SetState,
    "samples": commands.AppendSamples,
    "frames": commands.AddFrames,
    "effect": commands.BeginEffect,
    "at": commands.PlayAt,
    "end-waves": commands.EndWaves,
    "forget": commands.ForgetClient,
}
"""Names of the kinds of orders."""
_NAMES = {kind: name for name, kind in KINDS.items()}


def realized(
    display: Display, texture: Texture, seed: int, how: commands.DeviceOpened, *, gain: float
) -> PreparedTexture:
    """Realize a texture for a display.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to realize.
    seed : int
        Seed of its realization.
    how : DeviceOpened
        How the device plays.
    gain : float
        Gain of the texture.

    Returns
    -------
    PreparedTexture
        Texture for a link that takes samples, or for one that takes spectrum frames.
    """
    texture = amplified(texture, gain)
    if not how.carriers:
        return RealizedLayer(display, texture, seed=seed)
    return SpectrumRenderer(
        display, texture, carriers=how.carriers, frame_rate=how.frame_rate,
        sample_rate=how.sample_rate, seed=seed, whole_band=True,
    )  # fmt: skip


def encoded(number: int, order: SessionOrder) -> bytes:
    """Return an order as one line of JSON.

    Parameters
    ----------
    number : int
        Number of the order.
    order : SessionOrder
        Order to encode.

    Returns
    -------
    bytes
        JSON with a newline. Arrays are objects of type, shape and the bytes in base 64.
    """
    line = {"number": number, **_content(order)}
    return msgspec.json.encode(line, enc_hook=_array_text) + b"\n"


def _content(order: SessionOrder) -> dict[str, Any]:
    """Return an order with its kind; that within a `PlayAt` has a kind too."""
    content: dict[str, Any] = {"kind": _NAMES[type(order)], "order": order}
    if isinstance(order, commands.PlayAt):
        fields = {field.name: getattr(order, field.name) for field in dataclasses.fields(order)}
        content["order"] = fields | {"order": _content(order.order)}
    return content


def decoded(line: bytes) -> tuple[int, SessionOrder]:
    """Return the order that `encoded` has encoded.

    Parameters
    ----------
    line : bytes
        Line of JSON.

    Returns
    -------
    number : int
        Number of the order.
    order : SessionOrder
        The order.

    Raises
    ------
    InputError
        If the line is no order.
    """
    try:
        content = msgspec.json.decode(line)
        return int(content["number"]), _order(content)
    except (msgspec.MsgspecError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"an order cannot be read: {error!r}") from error


def _order(content: dict[str, Any]) -> SessionOrder:
    """Return the order of which `_content` has made a kind and its fields."""
    kind = KINDS[content["kind"]]
    if kind is commands.PlayAt:
        fields = content["order"]
        return commands.PlayAt(**fields | {"order": _order(fields["order"])})
    return msgspec.convert(content["order"], kind, dec_hook=_array)


def _array_text(value: object) -> dict[str, Any]:
    """Return an array as what JSON can hold."""
    if not isinstance(value, np.ndarray):
        raise NotImplementedError(type(value))
    text = base64.b64encode(value.tobytes()).decode()
    return {"dtype": value.dtype.str, "shape": value.shape, "base64": text}


def _array(_: type, value: Any) -> Any:
    """Return the array that `_array_text` has encoded."""
    data = np.frombuffer(base64.b64decode(value["base64"]), value["dtype"])
    return data.reshape(value["shape"]).copy()
