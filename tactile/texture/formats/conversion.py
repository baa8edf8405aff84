"""From one file to another, told by their suffixes, with a line for each thing that is lost.

A texture lives in space and an effect in time; a speed turns one into the other. So a texture
(a shipped one's name, a ``.toml`` with ``[texture]``, a Penn model) becomes an effect at a stated
speed, and a .hjif becomes a texture where its target is ``.toml`` and a speed is stated; without
one it stays an effect, in a ``.toml`` with ``[effect]``.
"""

import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import tomli_w

from tactile import files
from tactile.errors import InputError, NotFoundError
from tactile.texture import descriptor as descriptors
from tactile.texture.descriptor import Descriptor
from tactile.texture.formats import ahap, haptic_clip, hatt, hjif, pcm, reading, surface_effect
from tactile.texture.formats.document import Effect, EffectFile, channels_of, segments_of
from tactile.texture.formats.synthesis import duration

Loaded = tuple[Effect, list[str]]
Saved = tuple[bytes, list[str]]


def _load_toml(path: Path) -> Loaded:
    reading.contents(path, 4 * reading.LARGEST_FILE)
    return files.read(path, EffectFile).effect, []


def _saved_toml(effect: Effect) -> Saved:
    return _as_toml(EffectFile(effect=effect)), []


LOADERS: dict[str, Callable[[Path], Loaded]] = {
    ".haptic": haptic_clip.load_clip,
    ".ahap": ahap.load_ahap,
    ".hjif": hjif.load_hjif,
    ".wav": pcm.load_wav,
    ".toml": _load_toml,
}
SAVERS: dict[str, Callable[[Effect], Saved]] = {
    ".haptic": haptic_clip.saved_clip,
    ".ahap": ahap.saved_ahap,
    ".hjif": hjif.saved_hjif,
    ".wav": pcm.saved_wav,
    ".json": pcm.saved_openxr,
    ".toml": _saved_toml,
}
UNTOLD = {
    "version", "profile", "level", "date", "unit_exponent", "perception_unit_exponent",
    "sample_count", "block_length",
}  # fmt: skip
"""Fields that say how a .hjif is written, and nothing of the effect."""


@dataclass(frozen=True)
class Conversion:
    """What was done.

    Attributes
    ----------
    became : "effect" or "texture"
    lost : a line for each thing that the target does not have as the source had it
    channels, seconds : of an effect
    """

    became: Literal["effect", "texture"]
    lost: tuple[str, ...]
    channels: int = 0
    seconds: float = 0.0


def load_effect(path: str | Path) -> Effect:
    """Return the effect of a .haptic, .ahap, .hjif, .wav or .toml file.

    Raises
    ------
    NotFoundError, InputError
        One line: file, field, value and limit.
    """
    return _loaded(Path(path))[0]


def _loaded(path: Path) -> Loaded:
    suffix = path.suffix.lower()
    if suffix not in LOADERS:
        raise InputError(f"{path}: cannot be read; {files.nearest(suffix, list(LOADERS))}")
    return LOADERS[suffix](path)


def save_effect(effect: Effect, path: str | Path, *, force: bool = False) -> list[str]:
    """Write an effect as .haptic, .ahap, .hjif, .wav, .json (OpenXR) or .toml.

    Returns
    -------
    list of str
        A line for each thing that the format cannot say.

    Raises
    ------
    InputError
        Where the format cannot hold it, or the file is there already; ``force`` overwrites it.
    """
    path = Path(path)
    _checked_target(path, force=force)
    try:
        content, lost = SAVERS[path.suffix.lower()](effect)
    except (OverflowError, TypeError, UnicodeEncodeError) as error:
        raise InputError(reading.one_line(f"{path}: cannot be written: {error}")) from error
    _write(path, content, force=force)
    return _foreign(effect, path.suffix.lower()) + lost


def _foreign(effect: Effect, suffix: str) -> list[str]:
    """Return a line for what only the effect's own format has a place for."""
    if suffix in (".toml", f".{effect.origin}"):
        return []
    parts: list[Any] = [effect, *effect.perceptions]
    for perception in effect.perceptions:
        parts += [*perception.reference_devices, *perception.library, *perception.channels]
        parts += [*(b for c in perception.channels for b in c.bands), *segments_of(perception)]
    names = [k for part in parts for k, v in part.other.items() if v and k not in UNTOLD]
    return reading.told(f"{suffix} has no place for", names) + (
        _unsaid(effect, suffix) if suffix != ".hjif" else []
    )


def _unsaid(effect: Effect, suffix: str) -> list[str]:
    """Return a line for what .hjif and ours alone can say."""
    segments = [s for p in effect.perceptions for s in [*p.library, *segments_of(p)]]
    channels = [channel for _, channel in channels_of(effect)]
    words = [s.keywords for s in segments if s.keywords]
    lost = reading.told(f"{suffix} has no place for keywords", words)
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
    source, target : of a format each, told by the suffix
    speed : of the finger [m/s], where space becomes time or time becomes space
    force : overwrite the target

    Raises
    ------
    NotFoundError, InputError
        One line: what, where, and what would do.
    """
    _checked_target(target, force=force)
    path = Path(source)
    texture, told = _texture_of(source, path, speed)
    if texture is None:
        effect, told = _loaded(path)
        if speed is None or target.suffix != ".toml":
            if speed is not None:
                raise InputError("--speed-mm-s: has no use where an effect stays an effect")
            lost = told + save_effect(effect, target, force=force)
            return _effect_done(effect, lost)
        texture, more = surface_effect.texture_from(effect, speed, target.stem, path.name)
        told += more
    if target.suffix == ".toml":
        _save_texture(texture, target, force=force)
        return Conversion("texture", tuple(told))
    if speed is None:
        raise InputError(
            f"{target}: a texture lives in space: --speed-mm-s says how fast the finger moves"
        )
    effect, more = surface_effect.effect_of(texture, speed)
    return _effect_done(effect, told + more + save_effect(effect, target, force=force))


def _effect_done(effect: Effect, lost: list[str]) -> Conversion:
    return Conversion("effect", tuple(lost), len(channels_of(effect)), duration(effect))


def _texture_of(
    source: str, path: Path, speed: float | None
) -> tuple[Descriptor | None, list[str]]:
    """Return the texture that a source is, or None where it is an effect."""
    if path.suffix == ".xml":
        model = hatt.load_model(path)
        return hatt.texture_from(model, speed or hatt.REFERENCE_SPEED)
    if source in descriptors.textures():
        return descriptors.load(source), []
    if path.suffix == "" and not files.is_file(path):
        raise NotFoundError(
            f"{source}: neither a file nor a texture; "
            f"{files.nearest(source, descriptors.textures())}"
        )
    if path.suffix == ".toml" and _has_texture(path):
        return descriptors.load(path), []
    return None, []


def _has_texture(path: Path) -> bool:
    """Return whether a TOML file says [texture] somewhere at the beginning of a line."""
    lines = reading.contents(path, 4 * reading.LARGEST_FILE).splitlines()
    return any(line.strip() == b"[texture]" for line in lines)


def _checked_target(path: Path, *, force: bool) -> None:
    if path.suffix.lower() not in SAVERS:
        raise InputError(f"{path}: cannot be written; {files.nearest(path.suffix, list(SAVERS))}")
    if not path.parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}")
    if path.exists() and not force:
        raise InputError(f"{path}: is there already; --force overwrites it")


def _save_texture(texture: Descriptor, target: Path, *, force: bool) -> None:
    """Write a texture under its file's name, and see that it can be read."""
    about = msgspec.structs.replace(texture.texture, id=target.stem)
    content = _as_toml(msgspec.structs.replace(texture, texture=about))
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / target.name
        trial.write_bytes(content)
        try:
            descriptors.load(trial)
        except InputError as error:
            raise InputError(str(error).replace(str(trial), str(target))) from error
    _write(target, content, force=force)


def _as_toml(part: msgspec.Struct) -> bytes:
    """Return a Struct as TOML, without what it leaves to its defaults."""
    return tomli_w.dumps(_set_fields(msgspec.to_builtins(part))).encode()


def _set_fields(value: Any) -> Any:
    """Return data without None, which TOML does not have."""
    if isinstance(value, dict):
        return {k: _set_fields(v) for k, v in value.items() if v is not None}
    return [_set_fields(v) for v in value] if isinstance(value, list | tuple) else value


def _write(path: Path, content: bytes, *, force: bool) -> None:
    """Write a file whole or not at all."""
    handle, name = tempfile.mkstemp(prefix=".tactile-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(name, 0o644)
        if path.exists() and not force:
            raise InputError(f"{path}: is there already; --force overwrites it")
        os.replace(name, path)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(name)
