"""Effects that clients play by name: the files of one folder, which is read at the start.

A name in a message selects among the effects that were read, and never reaches the file system.
"""

import logging
import re
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from tactile.arrays import Singles
from tactile.errors import InputError
from tactile.messages import EffectInfo, Name
from tactile.texture.formats.conversion import is_effect, load_named

log = logging.getLogger("tactile.effects")

SAMPLE_RATE = 8000.0
"""Rate of the samples of an effect, which playback resamples to that of the display [Hz]."""
LONGEST_EFFECT = 60.0
"""Longest duration of an effect, that of parametric effects [s]."""
LARGEST_SHEAR = 500e-6
"""Largest shear of an effect, that of waveforms in `tactile.messages` [m]."""
MOST_EFFECTS = 256
"""Largest number of effects, of which each takes 2 MB at most."""
NAME = re.compile(msgspec.json.schema(Name)["pattern"])
"""Pattern of a name in a message."""


@dataclass(frozen=True)
class StoredEffect:
    """Effect that is ready to be played.

    Attributes
    ----------
    info : EffectInfo
        Description for clients.
    shear : (S,) array of float32
        Shear at `SAMPLE_RATE` [m].
    """

    info: EffectInfo
    shear: Singles


def load_effects(folder: str | None) -> dict[str, StoredEffect]:
    """Read the effects of a folder; a file that cannot be used is only logged.

    Parameters
    ----------
    folder : str or None
        Folder with effect files; None for no effects.

    Returns
    -------
    dict of str to StoredEffect
        Effects by the name of their file without its suffix.

    Raises
    ------
    InputError
        If the folder cannot be read.
    """
    if folder is None:
        return {}
    try:
        paths = sorted(path for path in Path(folder).iterdir() if path.is_file())
    except OSError as error:
        raise InputError(
            f"server.effects = {folder!r}: cannot be read: {error.strerror}"
        ) from error
    effects: dict[str, StoredEffect] = {}
    for path in paths:
        try:
            if not is_effect(path):
                continue
            if path.stem in effects or len(effects) >= MOST_EFFECTS:
                raise InputError(f"{path}: left out; names must differ, {MOST_EFFECTS} at most")
            effects[path.stem] = _stored(path)
        except InputError as error:
            log.error("%s", error)
    return effects


def _stored(path: Path) -> StoredEffect:
    """Return the effect of a file."""
    if len(path.stem) > 64 or not NAME.search(path.stem):
        raise InputError(f"{path}: is no name that a message can hold: letters, digits, . _ -")
    effect = load_named(path)
    if effect.seconds > LONGEST_EFFECT:
        raise InputError(f"{path}: takes {effect.seconds:g} s: {LONGEST_EFFECT:g} s at most")
    shear = effect.shear(SAMPLE_RATE).astype(np.float32)
    if np.abs(shear).max() > LARGEST_SHEAR:
        raise InputError(f"{path}: goes beyond {LARGEST_SHEAR * 1e6:g} µm of shear")
    info = EffectInfo(name=path.stem, description=effect.description, seconds=effect.seconds)
    return StoredEffect(info, shear)
