"""Reading of a height map from a PNG, with the scale from gray levels to meters.

Whatever is doubtful about the picture becomes a note. A gray level alone does not tell a height. A
height map that was exported by a profilometer or a 3-D scanner comes with its scale, in µm per gray
level and mm per pixel. A photograph has none, since its brightness is light and shadow. Both scales
must therefore be given, and are taken as they are.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError, missing_extra

if TYPE_CHECKING:
    from PIL.Image import Image


SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG file."""
LONGEST_SIDE, SHORTEST_SIDE = 4096, 64
"""Largest and smallest side of a picture [pixels]. A side of 4096 takes 128 MB of numbers for each
of the steps."""
CLIPPED = 0.01
"""Share of pixels at one end of the gray scale above which clipping is reported."""
LUMINANCE = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in the luminance (ITU-R BT.601)."""
UM_PER_LEVEL = (1e-5, 1000.0)
"""Smallest and largest height of a gray level [µm]."""
MM_PER_PIXEL = (1e-4, 0.0625)
"""Smallest and largest side of a pixel [mm]. The largest one samples 8 cycles/mm, the center of the
finest band, twice per period."""
NO_SCALE = (
    "{name} is needed: gray is no height. A height map (profilometer, 3-D scanner) comes with {of};"
    " a photograph has none, measure the relief or write the texture by hand (textures/README.md)"
)
"""Template of the error message for a missing scale."""


@dataclass(frozen=True)
class HeightMap:
    """Relief of a surface, seen upright: x to the right, y up.

    Attributes
    ----------
    height : (R, C) array of float
        Height, with row 0 at the top, mean and tilt as in the picture [m].
    pixel : float
        Side of a pixel [m].
    level : float
        Height of one gray level [m].
    notes : tuple of str
        What was doubtful about the picture, one line each.
    """

    height: Floats
    pixel: float
    level: float
    notes: tuple[str, ...] = ()

    @property
    def side(self) -> float:
        """Shorter side of the picture [m]."""
        return float(min(self.height.shape) * self.pixel)


def read_height(path: Path, *, um_per_level: float | None, mm_per_pixel: float | None) -> HeightMap:
    """Read an 8- or 16-bit gray PNG as heights. Colors count by their luminance.

    Parameters
    ----------
    path : Path
        Picture to read.
    um_per_level : float or None
        Height of one gray level, 1e-5 to 1000 [µm].
    mm_per_pixel : float or None
        Side of one pixel, 1e-4 to 0.0625 [mm].

    Returns
    -------
    HeightMap
        Heights, and notes on the picture.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If a scale is missing or outside its limits, if the picture is not such a PNG, is too large
        or too small, flat, transparent or animated, or if Pillow is not installed.
    """
    level = _scale("--um-per-level", um_per_level, UM_PER_LEVEL, "µm per level") * 1e-6
    pixel = _scale("--mm-per-pixel", mm_per_pixel, MM_PER_PIXEL, "mm per pixel") * 1e-3
    gray, top, notes = _gray_levels(path)
    if gray.min() == gray.max():
        raise InputError(f"{path}: every pixel is {gray.flat[0]:g}: a flat picture has no relief")
    notes += [
        f"clipped: {share:.1%} of the pixels are at gray {end:g}, what lies beyond is lost"
        for end in (0.0, top)
        if (share := float(np.mean(gray == end))) > CLIPPED
    ]
    return HeightMap(gray * level, pixel, level, tuple(notes))


def _scale(name: str, value: float | None, limits: tuple[float, float], of: str) -> float:
    """Return a scale, or raise `InputError` if it is missing or outside its limits."""
    if value is None:
        raise InputError(NO_SCALE.format(name=name, of=of))
    low, high = limits
    if not low <= value <= high:
        raise InputError(f"{name} {value:g}: must be {low:g} … {high:g}")
    return value


def _gray_levels(path: Path) -> tuple[Floats, float, list[str]]:
    """Return gray levels (R, C), the highest level of the scale, and notes."""
    image = _open_png(path)
    if image.mode == "L":
        return np.asarray(image, np.float64), 255.0, []
    if image.mode.startswith("I"):
        return np.asarray(image, np.float64), 65535.0, []
    if image.mode not in ("RGB", "RGBA", "LA"):
        kind = {"P": "a palette", "1": "black and white only"}.get(image.mode, image.mode)
        raise InputError(f"{path}: {kind}: must be an 8- or 16-bit gray PNG")
    data = np.asarray(image, np.float64)
    if image.mode.endswith("A") and np.any(data[..., -1] < 255):
        raise InputError(f"{path}: has transparent pixels: fill them with heights first")
    if image.mode == "LA":
        return data[..., 0], 255.0, []
    note = "colors were turned into gray by luminance (ITU-R BT.601): is this a height map at all?"
    return data[..., :3] @ np.array(LUMINANCE), 255.0, [note]


def _open_png(path: Path) -> "Image":
    """Open and decode a PNG within the limits of size."""
    images: Any
    try:
        from PIL import Image as images  # noqa: N813
    except ImportError as error:
        raise missing_extra("a picture", "Pillow", "picture") from error
    if not files.is_file(path):
        raise NotFoundError(f"{path}: no such file")
    try:
        with (
            path.open("rb") as file,
            warnings.catch_warnings(action="ignore", category=images.DecompressionBombWarning),
        ):
            if file.read(len(SIGNATURE)) != SIGNATURE:
                raise InputError(f"{path}: not a PNG; export it as an 8- or 16-bit gray PNG")
            image: Image = images.open(file, formats=["PNG"])
            _check_size(path, image.size)
            if getattr(image, "is_animated", False):
                raise InputError(f"{path}: is animated: must be one picture")
            image.load()
    except images.DecompressionBombError as error:
        raise InputError(f"{path}: too large: {' '.join(str(error).split())}") from error
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    return image


def _check_size(path: Path, size: tuple[int, int]) -> None:
    """Raise `InputError` if a picture is too large or too small."""
    width, height = size
    if max(size) > LONGEST_SIDE:
        raise InputError(
            f"{path}: {width} × {height} pixels: at most {LONGEST_SIDE} a side; crop it"
        )
    if min(size) < SHORTEST_SIDE:
        raise InputError(f"{path}: {width} × {height} pixels: at least {SHORTEST_SIDE} a side")
