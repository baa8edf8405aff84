"""Replacement of characters that the encoding of a terminal or of a pipe does not have.

Output that is redirected on Windows has a code page such as cp1252, and that of the C locale may be
ASCII; neither has all of ``µ``, ``≤`` and the blocks of pictures.
"""

import codecs
import sys
from io import TextIOWrapper

REPLACEMENTS = {
    "µ": "u", "μ": "u", "ε": "eps", "δ": "delta", "θ": "theta", "Ω": "ohm", "²": "2", "³": "3",
    "−": "-", "–": "-", "×": "x", "·": "*", "±": "+-", "≤": "<=", "≥": ">=", "→": "->", "°": "deg",
    "…": "...", "½": "1/2", "ö": "oe", "é": "e",
    "│": "|", "─": "-", "╭": "+", "╮": "+", "╰": "+", "╯": "+", "▀": "#",
} | dict(zip("▁▂▃▄▅▆▇█", "_.:-=+*#", strict=True)) | dict.fromkeys("▉▊▋▌▍▎▏", "|")  # fmt: skip
"""Text for each character that the output has and some encodings lack."""
BRAILLE = range(0x2800, 0x2900)
"""Braille patterns, the dots of the live picture; the first one has none."""


def _replaced(error: UnicodeError) -> tuple[str, int]:
    """Return the text for characters that cannot be encoded, and the place where to go on."""
    assert isinstance(error, UnicodeEncodeError)
    characters = error.object[error.start : error.end]
    return "".join(map(_replacement, characters)), error.end


def _replacement(character: str) -> str:
    """Return the ASCII text that replaces a character."""
    if ord(character) in BRAILLE:
        return "*" if ord(character) > BRAILLE[0] else " "
    return REPLACEMENTS.get(character, "?")


def replace_missing_characters() -> None:
    """Make standard output and standard error replace what their encodings do not have."""
    codecs.register_error("tactile", _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # not what a test or an embedding program put there
            stream.reconfigure(errors="tactile")
