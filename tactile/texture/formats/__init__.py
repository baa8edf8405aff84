"""Other people's formats: .haptic, AHAP, .hjif, WAV, OpenXR and Penn's texture models.

`load_effect` reads a file into the effect document (`document.Effect`) and `save_effect` writes it
in any format, each chosen by its suffix; `synthesize` renders it. Textures, which live in space and
not in time, go through `surface_effect` and `hatt`; `conversion` puts all of it together.
"""

from tactile.texture.formats.conversion import load_effect, save_effect
from tactile.texture.formats.document import Effect
from tactile.texture.formats.synthesis import synthesize

__all__ = ["Effect", "load_effect", "save_effect", "synthesize"]
