"""Haptic file formats of others: .haptic, AHAP, .hjif, WAV, OpenXR, models of Penn and ONNX.

`load_effect` reads a file into the effect document (`document.Effect`), and `save_effect` writes
one in any of the formats, chosen by the suffix of the file. `synthesize` renders an effect as
samples. Textures, which are functions of space and not of time, are converted by `surface_effect`,
`hatt` and `level_model`. `conversion` combines all of these.
"""

from tactile.texture.formats.conversion import load_effect, save_effect
from tactile.texture.formats.document import Effect
from tactile.texture.formats.synthesis import synthesize

__all__ = ["Effect", "load_effect", "save_effect", "synthesize"]
