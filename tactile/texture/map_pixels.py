"""Pixels of a map as text, so that a texture remains a single file.

Each pixel is stored as its difference from the one before it in the row, as 16 bits that wrap; the
high bytes of all pixels precede the low ones, which makes them easier to compress. The bytes are
compressed by zlib (RFC 1950) and written in base64 (RFC 4648).
"""

import base64
import binascii
import zlib

import numpy as np
from numpy.typing import NDArray

LINE = 96
"""Number of characters in a line of text."""


def packed(levels: NDArray[np.int16]) -> str:
    """Write pixels as text.

    Parameters
    ----------
    levels : (R, C) array of int16
        Levels of the pixels.

    Returns
    -------
    str
        Lines of base64.
    """
    steps = np.diff(levels, axis=1, prepend=np.int16(0)).astype(">i2")
    content = zlib.compress(steps.reshape(-1, 1).view(np.uint8).T.tobytes(), 9)
    text = base64.b64encode(content).decode()
    return "\n".join(text[i : i + LINE] for i in range(0, len(text), LINE))


def unpacked(text: str, rows: int, columns: int) -> NDArray[np.int16]:
    """Read pixels that `packed` has written.

    Parameters
    ----------
    text : str
        Base64, in which white space does not count.
    rows, columns : int
        Numbers of rows and columns.

    Returns
    -------
    (R, C) array of int16
        Levels of the pixels.

    Raises
    ------
    ValueError
        If the text is not base64, is damaged or cut short, or holds another number of pixels. The
        message names the key ``pixels``.
    """
    size, reader = 2 * rows * columns, zlib.decompressobj()
    try:
        compressed = base64.b64decode("".join(text.split()).encode("ascii"), validate=True)
        content = reader.decompress(compressed, size + 1)
    except (binascii.Error, UnicodeError) as error:
        raise ValueError(f"pixels: not base64, or cut short: {error}") from error
    except zlib.error as error:
        raise ValueError(f"pixels: damaged: {error}") from error
    if len(content) != size or not reader.eof:
        amount = "more than" if len(content) > size else f"{len(content) // 2} of"
        raise ValueError(
            f"pixels: hold {amount} {columns} × {rows} pixels: cut short, or of another map"
        )
    steps = np.frombuffer(content, np.uint8).reshape(2, -1).T.copy().view(">i2")
    return np.cumsum(steps.reshape(rows, columns), axis=1, dtype=np.int16)
