"""Driver and texture renderer for tactile displays made of piezoelectric bimorph arrays.

>>> import tactile
>>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
>>> played = tactile.render(display, texture, tactile.Trajectory.line(speed=0.08, duration=0.1))
>>> played.drive.shape
(800, 24)

All quantities are in SI units. Names are loaded when they are first used, so that ``import
tactile`` costs almost nothing, and a program that does not render never loads the renderer.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactile.actuator.amplifier import Amplifier as Amplifier
    from tactile.actuator.benders import BENDERS as BENDERS
    from tactile.actuator.benders import bender_figures as bender_figures
    from tactile.actuator.bimorph import Bimorph as Bimorph
    from tactile.actuator.finger import FingerLoad as FingerLoad
    from tactile.actuator.finger import FingerTable as FingerTable
    from tactile.actuator.material_notes import MATERIAL_NOTES as MATERIAL_NOTES
    from tactile.actuator.materials import PIEZOS as PIEZOS
    from tactile.actuator.materials import SHIMS as SHIMS
    from tactile.actuator.materials import PiezoMaterial as PiezoMaterial
    from tactile.actuator.materials import ShimMaterial as ShimMaterial
    from tactile.actuator.plant import Plant as Plant
    from tactile.actuator.response import TipResponse as TipResponse
    from tactile.actuator.response import blocked_force as blocked_force
    from tactile.actuator.response import chain_response as chain_response
    from tactile.actuator.response import tip_response as tip_response
    from tactile.bus.base import DriveBlock as DriveBlock
    from tactile.bus.base import DriveFrame as DriveFrame
    from tactile.client.connection import connect as connect
    from tactile.client.onsets import At as At
    from tactile.devices import find_devices as find_devices
    from tactile.devices import open_bus as open_bus
    from tactile.display.display import Display as Display
    from tactile.display.display import load_display as load_display
    from tactile.errors import BusError as BusError
    from tactile.errors import BusStateError as BusStateError
    from tactile.errors import ClientError as ClientError
    from tactile.errors import ClientTimeoutError as ClientTimeoutError
    from tactile.errors import DisconnectedError as DisconnectedError
    from tactile.errors import InputError as InputError
    from tactile.errors import NotFoundError as NotFoundError
    from tactile.errors import RequestError as RequestError
    from tactile.errors import TactileError as TactileError
    from tactile.local import open_display as open_display
    from tactile.playback.estop_guard import guarded as guarded
    from tactile.playback.recording_reader import Recording as Recording
    from tactile.playback.recording_reader import load_recording as load_recording
    from tactile.playback.session_reader import Session as Session
    from tactile.playback.session_reader import load_session as load_session
    from tactile.rendering.contact import Trajectory as Trajectory
    from tactile.rendering.renderer import Renderer as Renderer
    from tactile.rendering.renderer import Rendering as Rendering
    from tactile.rendering.renderer import render as render
    from tactile.rendering.spectrum import SpectrumRenderer as SpectrumRenderer
    from tactile.strength.spending import spend as spend
    from tactile.strength.strength import EqualGains as EqualGains
    from tactile.strength.strength import Gain as Gain
    from tactile.strength.strength import SteadyStroke as SteadyStroke
    from tactile.strength.strength import Strength as Strength
    from tactile.strength.strength import amplified as amplified
    from tactile.strength.strength import automatic_gain as automatic_gain
    from tactile.strength.strength import equal_gain as equal_gain
    from tactile.strength.strength import texture_strength as texture_strength
    from tactile.texture.descriptor import textures as textures
    from tactile.texture.descriptor_file import as_toml as as_toml
    from tactile.texture.formats import load_effect as load_effect
    from tactile.texture.judging import fit_texture as fit_texture
    from tactile.texture.perception import TOUCH_CHANNELS as TOUCH_CHANNELS
    from tactile.texture.perception import TouchChannel as TouchChannel
    from tactile.texture.perception import detection_threshold as detection_threshold
    from tactile.texture.recorded_slide import Recorded as Recorded
    from tactile.texture.recorded_slide import load_recorded as load_recorded
    from tactile.texture.surface import Texture as Texture
    from tactile.texture.surface import load_texture as load_texture

_HOMES = {
    "actuator.amplifier": ("Amplifier",),
    "actuator.benders": ("BENDERS", "bender_figures"),
    "actuator.bimorph": ("Bimorph",),
    "actuator.finger": ("FingerLoad", "FingerTable"),
    "actuator.material_notes": ("MATERIAL_NOTES",),
    "actuator.materials": ("PIEZOS", "SHIMS", "PiezoMaterial", "ShimMaterial"),
    "actuator.plant": ("Plant",),
    "actuator.response": ("TipResponse", "blocked_force", "chain_response", "tip_response"),
    "bus.base": ("DriveBlock", "DriveFrame"),
    "client.connection": ("connect",),
    "client.onsets": ("At",),
    "devices": ("find_devices", "open_bus"),
    "display.display": ("Display", "load_display"),
    "errors": (
        "BusError",
        "BusStateError",
        "ClientError",
        "ClientTimeoutError",
        "DisconnectedError",
        "InputError",
        "NotFoundError",
        "RequestError",
        "TactileError",
    ),
    "local": ("open_display",),
    "playback.estop_guard": ("guarded",),
    "playback.recording_reader": ("Recording", "load_recording"),
    "playback.session_reader": ("Session", "load_session"),
    "rendering.contact": ("Trajectory",),
    "rendering.renderer": ("Renderer", "Rendering", "render"),
    "rendering.spectrum": ("SpectrumRenderer",),
    "strength.spending": ("spend",),
    "strength.strength": (
        "EqualGains",
        "Gain",
        "SteadyStroke",
        "Strength",
        "amplified",
        "automatic_gain",
        "equal_gain",
        "texture_strength",
    ),
    "texture.descriptor": ("textures",),
    "texture.descriptor_file": ("as_toml",),
    "texture.judging": ("fit_texture",),
    "texture.perception": ("TOUCH_CHANNELS", "TouchChannel", "detection_threshold"),
    "texture.recorded_slide": ("Recorded", "load_recorded"),
    "texture.formats": ("load_effect",),
    "texture.surface": ("Texture", "load_texture"),
}
"""Names of the package's interface, by the module that defines them."""
_HOME = {name: home for home, names in _HOMES.items() for name in names}
"""Module that defines each name."""

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("tactile-display")
    if name not in _HOME:
        raise AttributeError(f"module 'tactile' has no attribute {name!r}")
    return getattr(import_module(f"tactile.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__", *globals()]
