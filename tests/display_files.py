"""A display's file in parts, to write displays that are right or refused."""

from pathlib import Path

import pytest

from tactile.display.display import Display, load_display
from tactile.errors import InputError

HEAD = '[display]\nid = "sample"\ndescription = "written by a test"\nopening_mm = [2.0, 3.0]\n'
GRID = "[grid]\ncolumns = 3\nrows = 2\npitch_mm = [2.5, 3.5]\n"
FINGER = '[finger]\npreset = "low"\n'
LIMITS = "[limits]\nvoltage_v = 100.0\n"


def contactors(*places: tuple[float, float, float]) -> str:
    """Return the tables of contactors at x and y [mm] that shear along an angle [deg]."""
    return "".join(
        f"[[contactor]]\nposition_mm = [{x!r}, {y!r}]\nchannel = {i}\nshear_direction_deg = {a!r}\n"
        for i, (x, y, a) in enumerate(places)
    )


def load(folder: Path, *parts: str) -> Display:
    """Load a display; a part is left as it is unless one with the same first line is given."""
    texts = {part.split("\n")[0]: part for part in (HEAD, GRID, FINGER, LIMITS, *parts)}
    if any(part.startswith("[[contactor]]") for part in parts):
        del texts["[grid]"]
    path = folder / "sample.toml"
    path.write_text("".join(texts.values()))
    return load_display(path)


def refused(folder: Path, *parts: str) -> str:
    """Return the one line that a display is refused with."""
    with pytest.raises(InputError) as caught:
        load(folder, *parts)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def number(message: str, before: str, after: str) -> float:
    """Return the number that a message prints between two words."""
    return float(message.split(before)[1].split(after)[0])
