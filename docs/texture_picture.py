"""Draw the pictures of textures: ``python docs/texture_picture.py``.

The same as ``tactile show wood-oak --plot docs/wood-oak.png`` and
``tactile sheet docs/textures.png``.
"""

from pathlib import Path

from PIL import Image

import tactile
from tactile.show.plots import plot_sheet, plot_texture
from tactile.show.views import tile, view_texture

HERE = Path(__file__).parent
SPEED = 0.08

display, oak = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
plot_texture(HERE / "wood-oak.png", view_texture(oak, display, speed=SPEED))
tiles = [tile(tactile.load_texture(name), speed=SPEED) for name in tactile.textures()]
plot_sheet(HERE / "textures.png", tiles, speed=SPEED)
for name in ("wood-oak.png", "textures.png"):  # a quarter of the size, no difference to be seen
    with Image.open(HERE / name) as picture:
        small = picture.convert("RGB").quantize(256)
    small.save(HERE / name, optimize=True)
