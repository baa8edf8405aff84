"""Conversion between files, whose formats follow from their suffixes, with a report of losses.

A texture is a function of space and an effect one of time; a speed converts one to the other. So a
texture (the name of a shipped one, a ``.toml`` with ``[texture]``, a Penn model, a learned model)
becomes an effect at a stated speed. A .hjif becomes a texture where its target is ``.toml`` and a
speed is stated. Without a speed it stays an effect, in a ``.toml`` with ``[effect]``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec
import tomli_w

from tactile import files
from tactile.errors import InputError, NotFoundError
from tactile.texture import descriptor as descriptors
from tactile.texture import descriptor_file
from tactile.texture.descriptor import Descriptor
from tactile.texture.formats import ahap, haptic_clip, hatt, hjif, pcm, reading, surface_effect
from tactile.texture.formats.document import Effect, EffectFile, channels_of, segments_of
from tactile.texture.formats.effect_shear import NamedEffect
from tactile.texture.formats.synthesis import duration

if TYPE_CHECKING:
    from tactile.texture.formats.level_model import BandError

Loaded = tuple[Effect, list[str]]
"""Effect of a file, and notes on what was ignored or changed."""
Saved = tuple[bytes, list[str]]
"""Contents of a file, and notes on what was lost."""


def _load_toml(path: Path) -> Loaded:
    """Read an effect from a TOML file."""
    reading.contents(path, 4 * reading.LARGEST_FILE)
    return files.read(path, EffectFile).effect, []


def _saved_toml(effect: Effect) -> Saved:
    """Format an effect as a TOML file."""
    data = _without_none(msgspec.to_builtins(EffectFile(effect=effect)))
    return tomli_w.dumps(data).encode(), []


LOADERS: dict[str, Callable[[Path], Loaded]] = {
    ".haptic": haptic_clip.load_clip,
    ".ahap": ahap.load_ahap,
    ".hjif": hjif.load_hjif,
    ".wav": pcm.load_wav,
    ".toml": _load_toml,
}
"""Readers of effects by the suffix of a file."""
SAVERS: dict[str, Callable[[Effect], Saved]] = {
    ".haptic": haptic_clip.saved_clip,
    ".ahap": ahap.saved_ahap,
    ".hjif": hjif.saved_hjif,
    ".wav": pcm.saved_wav,
    ".json": pcm.saved_openxr,
    ".toml": _saved_toml,
}
"""Writers of effects by the suffix of a file."""
FORMAT_FIELDS = {
    "version", "profile", "level", "date", "unit_exponent", "perception_unit_exponent",
    "sample_count", "block_length", "wavelet_stream",
}  # fmt: skip
"""Fields that state how a .hjif file is written and nothing else about the effect."""


@dataclass(frozen=True)
class Conversion:
    """Result of a conversion.

    Attributes
    ----------
    became : str
        What was written, "effect" or "texture".
    lost : tuple of str
        One line for each thing in which the target differs from the source.
    channels : int
        Number of channels of an effect.
    seconds : float
        Duration of an effect [s].
    bands : tuple of BandError
        Distance by band between a learned model and the texture made of it.
    """

    became: Literal["effect", "texture"]
    lost: tuple[str, ...]
    channels: int = 0
    seconds: float = 0.0
    bands: "tuple[BandError, ...]" = ()


class _Source(NamedTuple):
    """Texture that a source is, or None if it is an effect, with notes and distances by band."""

    texture: Descriptor | None
    notes: list[str]
    bands: "tuple[BandError, ...]" = ()


def load_effect(path: str | Path) -> Effect:
    """Read the effect of a .haptic, .ahap, .hjif, .wav or .toml file.

    Parameters
    ----------
    path : str or Path
        File to read.

    Returns
    -------
    Effect
        The effect.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is invalid. The message is one line with the file, field, value and limit.
    """
    return _loaded(Path(path))[0]


def is_effect(source: str | Path) -> bool:
    """Tell whether a source is an effect, a function of time, and not a texture.

    Parameters
    ----------
    source : str or Path
        Name of a shipped texture, or path of a file. That of a TOML file is decided by its content.

    Returns
    -------
    bool
        Whether `load_effect` reads it. A name, and a file of an unknown kind, is no effect.

    Raises
    ------
    NotFoundError
        If there is no such TOML file.
    InputError
        If a TOML file is neither, or cannot be read.
    """
    path = Path(source)
    if path.suffix.lower() != ".toml":
        return path.suffix.lower() in LOADERS
    if not files.is_file(path):
        raise NotFoundError(f"{path}: no such file")
    tables = files.read_toml(path)
    if "effect" not in tables and "texture" not in tables:
        raise InputError(
            f"{path}: neither a texture nor an effect: has no [texture] and no [effect]"
        )
    return "texture" not in tables


def load_named(path: str | Path) -> NamedEffect:
    """Read an effect to play it, under the name of its file.

    Parameters
    ----------
    path : str or Path
        File to read, as in `load_effect`.

    Returns
    -------
    NamedEffect
        The effect.

    Raises
    ------
    NotFoundError, InputError
        As in `load_effect`.
    """
    return NamedEffect(Path(path).stem, load_effect(path))


def _loaded(path: Path) -> Loaded:
    """Read the effect of a file by its suffix, with notes."""
    suffix = path.suffix.lower()
    if suffix not in LOADERS:
        raise InputError(f"{path}: cannot be read; {files.nearest(suffix, list(LOADERS))}")
    return LOADERS[suffix](path)


def save_effect(effect: Effect, path: str | Path, *, force: bool = False) -> list[str]:
    """Write an effect as .haptic, .ahap, .hjif, .wav, .json (OpenXR) or .toml.

    Parameters
    ----------
    effect : Effect
        Effect to write.
    path : str or Path
        File to create, whose suffix selects the format.
    force : bool
        Whether to overwrite an existing file.

    Returns
    -------
    list of str
        One line for each thing that the format cannot express.

    Raises
    ------
    InputError
        If the format cannot hold the effect, the folder does not exist, or the file exists already
        and ``force`` is false.
    """
    path = Path(path)
    _checked_target(path, force=force)
    try:
        content, lost = SAVERS[path.suffix.lower()](effect)
    except (OverflowError, TypeError, UnicodeEncodeError) as error:
        raise InputError(reading.one_line(f"{path}: cannot be written: {error}")) from error
    files.write_whole(path, content, force=force)
    return _lost_fields(effect, path.suffix.lower()) + lost


def _lost_fields(effect: Effect, suffix: str) -> list[str]:
    """Return lines on what only the format that the effect came from can hold."""
    if suffix in (".toml", f".{effect.origin}"):
        return []
    parts: list[Any] = [effect, *effect.perceptions]
    for perception in effect.perceptions:
        parts += [*perception.reference_devices, *perception.library, *perception.channels]
        parts += [*(b for c in perception.channels for b in c.bands), *segments_of(perception)]
    names = [k for part in parts for k, v in part.other.items() if v and k not in FORMAT_FIELDS]
    return reading.notes_on(f"{suffix} has no place for", names) + (
        _lost_features(effect, suffix) if suffix != ".hjif" else []
    )


def _lost_features(effect: Effect, suffix: str) -> list[str]:
    """Return lines on what only .hjif and the TOML form of an effect can hold."""
    segments = [s for p in effect.perceptions for s in [*p.library, *segments_of(p)]]
    channels = [channel for _, channel in channels_of(effect)]
    words = [s.keywords for s in segments if s.keywords]
    lost = reading.notes_on(f"{suffix} has no place for keywords", words)
    if any(perception.reference_devices for perception in effect.perceptions):
        lost.append(f"{suffix} has no place for reference devices")
    if any(c.description or c.body_part_mask or c.mixing_coefficient != 1 for c in channels):
        lost.append(f"{suffix} has no place for descriptions, body parts and mixing of channels")
    if effect.description and suffix in (".wav", ".json"):
        lost.append(f"{suffix} has no place for a description")
    return lost


def convert_file(
    source: str, target: Path, *, speed: float | None = None, force: bool = False
) -> Conversion:
    """Convert a file, or a shipped texture by its name.

    Parameters
    ----------
    source : str
        File to read, whose suffix selects the format, or name of a shipped texture.
    target : Path
        File to create, whose suffix selects the format.
    speed : float or None
        Speed of the finger, where space becomes time or time becomes space [m/s].
    force : bool
        Whether to overwrite an existing file.

    Returns
    -------
    Conversion
        What was written, and what was lost.

    Raises
    ------
    NotFoundError
        If there is no such file or texture.
    InputError
        If the file cannot be converted. The message is one line with what, where, and what would
        help.
    """
    _checked_target(target, force=force)
    path = Path(source)
    texture, notes, bands = _texture_of(source, path, speed)
    if texture is None:
        effect, notes = _loaded(path)
        if speed is None or target.suffix != ".toml":
            if speed is not None:
                raise InputError("--speed-mm-s: cannot be used to convert an effect to an effect")
            lost = notes + save_effect(effect, target, force=force)
            return _effect_conversion(effect, lost)
        texture, further_notes = surface_effect.texture_from(effect, speed, target.stem, path.name)
        notes += further_notes
    if target.suffix == ".toml":
        identity = msgspec.structs.replace(texture.texture, id=target.stem)
        texture = msgspec.structs.replace(texture, texture=identity)
        descriptor_file.write(texture, target, force=force)
        return Conversion("texture", tuple(notes), bands=bands)
    if speed is None:
        raise InputError(
            f"{target}: --speed-mm-s must give the speed of the finger over the texture"
        )
    effect, further_notes = surface_effect.effect_of(texture, speed)
    return _effect_conversion(
        effect, notes + further_notes + save_effect(effect, target, force=force)
    )


def _effect_conversion(effect: Effect, lost: list[str]) -> Conversion:
    """Return the result of a conversion to an effect."""
    return Conversion("effect", tuple(lost), len(channels_of(effect)), duration(effect))


def _texture_of(source: str, path: Path, speed: float | None) -> _Source:
    """Return what a source is."""
    if path.suffix == ".xml":
        model = hatt.load_model(path)
        return _Source(*hatt.texture_from(model, speed or hatt.REFERENCE_SPEED))
    if path.suffix == ".onnx":
        # Servers, which read effects, are spared the import of the fit.
        from tactile.texture.formats.level_model import load_level_model, texture_of_model

        return _Source(*texture_of_model(load_level_model(path), speed))
    if source in descriptors.textures():
        return _Source(descriptors.load(source), [])
    if path.suffix == "" and not files.is_file(path):
        raise NotFoundError(
            f"{source}: neither a file nor a texture; "
            f"{files.nearest(source, descriptors.textures())}"
        )
    if path.suffix == ".toml" and not is_effect(path):
        return _Source(descriptors.load(path), [])
    return _Source(None, [])


def _checked_target(path: Path, *, force: bool) -> None:
    """Raise `InputError` if a file cannot be written."""
    if path.suffix.lower() not in SAVERS:
        raise InputError(f"{path}: cannot be written; {files.nearest(path.suffix, list(SAVERS))}")
    files.check_target(path, force=force)


def _without_none(value: Any) -> Any:
    """Return data without None, which TOML does not have."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
