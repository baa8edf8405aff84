"""Learned models of the random part of a texture, as ONNX files from other people's training.

A model gives the levels of third-octave bands for a speed and a normal force. Its file has

- one input, a float32 tensor (N, 2) for any N: speed in mm/s and normal force in N;
- one output, a float32 tensor (N, B): levels in dB re 1 µm²·mm of B bands, as in `Stochastic`;
- the metadata of `LevelMetadata`, numbers as JSON arrays;
- operators of ONNX alone (the domains ai.onnx and ai.onnx.ml), and no data in other files.

A texture has one exponent for speed and one for force. They are fitted to the levels over the
ranges in which the model was trained, and what is left between model and texture is reported.
"""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any, Literal

import msgspec
import numpy as np

from tactile import files
from tactile.arrays import Floats
from tactile.errors import InputError, missing_extra
from tactile.texture.descriptor import (
    About,
    Category,
    Descriptor,
    Force,
    Laws,
    Reference,
    SpatialFrequency,
    Speed,
    Stochastic,
)
from tactile.texture.fitting import FORCE_PRIOR, SPEED_PRIOR, with_direction
from tactile.texture.formats import reading
from tactile.texture.lines import APART, differ
from tactile.texture.power_laws import level_shift, speed_range

SPEEDS, FORCES = 17, 9
"""Numbers of speeds and of forces, in even ratios over the ranges, at which a model is evaluated:
16 steps of a quarter octave cover a ratio of 16."""
LEVELS = -120.0, 60.0
"""Lowest and highest level that a texture file may state [dB re 1 µm²·mm]."""
STRONGEST = 20.0
"""Highest force of a range that a texture file may state [N]."""
LONGEST = 10.0
"""Time after which a model that still computes is stopped [s]. A network of 8 MiB takes less than
1 s for all speeds and forces."""
FOREIGN = re.compile(r"No Op registered for (\S+)|error: (\S+)\(-?\d+\) is not a registered")
"""Parts of the messages of onnxruntime that name an operator which it does not have."""


class LevelMetadata(msgspec.Struct, frozen=True, kw_only=True):
    """Metadata of a model, by their keys in the ONNX file.

    Attributes
    ----------
    frequency_per_mm : tuple of float
        Centers of the bands in cycles/mm, 4 to 41 third octaves in ascending order.
    speed_range_mm_s : tuple of float
        Lowest and highest speed with which the model was trained; they may be equal.
    normal_force_range_n : tuple of float
        Lowest and highest normal force with which the model was trained; they may be equal.
    quantity : str
        What the levels describe; there is one choice.
    source : str
        Origin of the model and of the recordings.
    category : str
        Category of the texture.
    license : str
        License of the model, which that of the texture follows.
    """

    frequency_per_mm: tuple[SpatialFrequency, ...]
    speed_range_mm_s: tuple[Speed, Speed]
    normal_force_range_n: tuple[Force, Force]
    quantity: Literal["tangential_skin_displacement"]
    source: str
    category: Category = "test"
    license: str = "unstated"

    def __post_init__(self) -> None:
        Stochastic(
            frequency_per_mm=self.frequency_per_mm, level_db=(0.0,) * len(self.frequency_per_mm)
        )
        for name in ("speed_range_mm_s", "normal_force_range_n"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] must ascend")


NUMBERS = ("frequency_per_mm", "speed_range_mm_s", "normal_force_range_n")
"""Keys of the metadata whose values are JSON arrays of numbers. The others are texts."""


@dataclass(frozen=True)
class LevelModel:
    """Model that was read from a file.

    Attributes
    ----------
    path : Path
        File, for messages.
    metadata : LevelMetadata
        Bands, ranges and origin.
    session : onnxruntime.InferenceSession
        Model, ready to run.
    """

    path: Path
    metadata: LevelMetadata
    session: Any

    def levels(self, speed: Floats, normal_force: Floats) -> Floats:
        """Compute the levels of the bands.

        Parameters
        ----------
        speed : (P,) array of float
            Speeds [m/s].
        normal_force : (P,) array of float
            Normal forces [N].

        Returns
        -------
        (P, B) array of float
            Levels [dB re 1 µm²·mm].

        Raises
        ------
        InputError
            If the model fails, takes more than 10 s, or gives levels of another shape, levels that
            are not numbers, or levels beyond what a texture file may state.
        """
        stroke = np.stack([speed * 1e3, normal_force], axis=1).astype(np.float32)
        level = np.asarray(self._output(stroke), dtype=np.float64)
        shape = len(stroke), len(self.metadata.frequency_per_mm)
        if level.shape != shape:
            raise InputError(
                f"{self.path}: output has the shape {level.shape} for {shape[0]} strokes: must be "
                f"{shape}, a level for each of frequency_per_mm"
            )
        wrong = np.argwhere(~((level >= LEVELS[0]) & (level <= LEVELS[1])))
        if len(wrong):
            row, band = wrong[0]
            raise InputError(
                f"{self.path}: level = {level[row, band]:g} dB at {stroke[row, 0]:g} mm/s and "
                f"{stroke[row, 1]:g} N in the band of {self.metadata.frequency_per_mm[band]:g} "
                f"cycles/mm: must be {LEVELS[0]:g} … {LEVELS[1]:g} dB re 1 µm²·mm"
            )
        return level

    def _output(self, stroke: Any) -> Any:
        """Return the output for an input, or raise `InputError` if it takes too long."""
        from onnxruntime import RunOptions

        options = RunOptions()
        options.log_severity_level = 4
        timer = Timer(LONGEST, setattr, (options, "terminate", True))
        timer.start()
        try:
            (name,) = (node.name for node in self.session.get_inputs())
            return self.session.run(None, {name: stroke}, options)[0]
        except Exception as error:  # The exceptions of onnxruntime have no other base class.
            if options.terminate:
                raise InputError(f"{self.path}: computes for more than {LONGEST:g} s") from error
            raise InputError(f"{self.path}: cannot be computed: {_reason(error)}") from error
        finally:
            timer.cancel()


@dataclass(frozen=True)
class BandError:
    """Band of a texture that was made from a model, and how far its laws are from the model.

    Attributes
    ----------
    frequency_per_mm : float
        Center of the band in cycles/mm.
    level_db : float
        Level at the reference in dB re 1 µm²·mm.
    rms_db : float
        Rms difference from the model over speeds and forces in dB.
    worst_db : float
        Level of the texture above that of the model where they differ most, in dB.
    """

    frequency_per_mm: float
    level_db: float
    rms_db: float
    worst_db: float


# Reading of a file


def load_level_model(path: Path) -> LevelModel:
    """Read a model from an ONNX file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    LevelModel
        The model.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is no model of levels, is larger than 8 MiB, or onnxruntime is not installed.
        The message is one line with the file, what is wrong and what is allowed.
    """
    content = reading.contents(path)
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise missing_extra("a learned model", "onnxruntime", "onnx") from error
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # Optimization would already compute parts of the model, for as long as they take.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    # A model that has data in other files would read them from the working folder.
    options.add_session_config_entry(
        "session.model_external_initializers_file_folder_path", os.devnull
    )
    try:
        session = onnxruntime.InferenceSession(content, options, ["CPUExecutionProvider"])
    except Exception as error:  # The exceptions of onnxruntime have no other base class.
        raise InputError(f"{path}: {_unreadable(error)}") from error
    _check_tensors(path, session)
    metadata = _metadata(path, session.get_modelmeta().custom_metadata_map)
    return LevelModel(path, metadata, session)


def _unreadable(error: Exception) -> str:
    """Return the reason why onnxruntime did not accept a model."""
    reason = _reason(error)
    if foreign := FOREIGN.search(reason):
        return (
            f"operator {foreign[1] or foreign[2]} is not one of ONNX: export the model with "
            "operators of ai.onnx and ai.onnx.ml alone"
        )
    return f"not an ONNX model that can be read: {reason}"


def _reason(error: Exception) -> str:
    """Return a message of onnxruntime in one line, without its codes."""
    return reading.one_line(re.sub(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ", "", str(error)))


def _check_tensors(path: Path, session: Any) -> None:
    """Raise `InputError` unless a model has one input (N, 2) and one output, both float32."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    shape = list(inputs[0].shape) if len(inputs) == 1 else []
    if (
        [node.type for node in inputs] != ["tensor(float)"]
        or len(shape) != 2
        or isinstance(shape[0], int)
        or shape[1] != 2
    ):
        raise InputError(
            f"{path}: input is {_shown(inputs)}: must be one tensor(float) of the shape (N, 2) for "
            "any N, speed_mm_s and normal_force_n"
        )
    if [node.type for node in outputs] != ["tensor(float)"]:
        raise InputError(
            f"{path}: output is {_shown(outputs)}: must be one tensor(float) of the shape (N, B), "
            "levels of B bands"
        )


def _shown(nodes: Any) -> str:
    """Return the types and shapes of inputs or outputs."""
    text = ", ".join(f"{node.type} {tuple(node.shape)}" for node in nodes)
    return reading.one_line(text or "missing")


def _metadata(path: Path, texts: dict[str, str]) -> LevelMetadata:
    """Return the metadata of a model."""
    data: dict[str, Any] = dict(texts)
    for name in NUMBERS:
        try:
            if name in texts:
                data[name] = msgspec.json.decode(texts[name])
        except msgspec.DecodeError as error:
            raise InputError(
                reading.one_line(
                    f"{path}: metadata: {name} = {texts[name][:100]!r}: must be a JSON array of "
                    "numbers, such as [20, 60]"
                )
            ) from error
    known = {name: data[name] for name in LevelMetadata.__struct_fields__ if name in data}
    return files.shaped(known, f"{path}: metadata", LevelMetadata)


# Conversion to a texture


def texture_of_model(
    model: LevelModel, speed: float | None = None
) -> tuple[Descriptor, list[str], tuple[BandError, ...]]:
    """Fit the bands and laws of a texture to a model over its ranges of speed and force.

    The exponents are those of the least-squares fit of level = c + 20 (a lg v + b lg N) in dB, with
    a constant for each band. A range whose ends differ by less than 15 % tells no exponent; that of
    `tactile.texture.fitting` is assumed.

    Parameters
    ----------
    model : LevelModel
        The model.
    speed : float or None
        Reference speed of the texture [m/s], by default the geometric mean of the range.

    Returns
    -------
    texture : Descriptor
        The texture, whose reference force is the geometric mean of the range.
    notes : list of str
        What was lost or assumed, one line each.
    bands : tuple of BandError
        Distance from the model by band.

    Raises
    ------
    InputError
        If the reference speed is outside of the range of the model, or as in `LevelModel.levels`.
    """
    about, (slow, fast) = model.metadata, model.metadata.speed_range_mm_s
    light, firm = about.normal_force_range_n
    if speed is not None and not slow <= speed * 1e3 <= fast:
        raise InputError(
            f"{model.path}: {speed * 1e3:g} mm/s: the model was trained for {slow:g} … {fast:g} "
            "mm/s"
        )
    speeds, forces = (
        axis.ravel()
        for axis in np.meshgrid(
            np.geomspace(slow, fast, SPEEDS) * 1e-3, np.geomspace(light, firm, FORCES)
        )
    )
    level = model.levels(speeds, forces)
    reference = Reference(
        speed_mm_s=float(f"{speed * 1e3 if speed else np.sqrt(slow * fast):.4g}"),
        normal_force_n=float(f"{np.sqrt(light * firm):.4g}"),
    )
    laws = _laws(about, speeds, forces, level.mean(axis=1))
    law = level_shift(laws, reference, speeds, forces)[:, None]
    center = np.round((level - law).mean(axis=0), 1)
    stochastic = Stochastic(
        frequency_per_mm=about.frequency_per_mm, level_db=tuple(center.tolist())
    )
    stochastic, loss = with_direction(stochastic)
    error = center + law - level
    texture = Descriptor(
        texture=_about(model), reference=reference, stochastic=stochastic, laws=laws
    )
    notes = [_distance(about, speeds, forces, error), *_notes(about, stochastic, loss)]
    return texture, notes, tuple(_band_errors(stochastic, error))


def _laws(about: LevelMetadata, speed: Floats, force: Floats, level: Floats) -> Laws:
    """Return the laws for the mean levels (P,) of all bands at speeds [m/s] and forces [N]."""
    ranges = np.array([about.speed_range_mm_s, about.normal_force_range_n])
    varied = np.array([differ(ends) for ends in ranges])
    lever = 20 * np.log10(np.stack([speed, force], axis=1))
    lever, deviation = lever - lever.mean(axis=0), level - level.mean()
    exponent = np.array([SPEED_PRIOR[0], FORCE_PRIOR[0]])
    # All speeds come with all forces, so that one exponent does not depend on the other.
    exponent[varied] = np.linalg.lstsq(lever[:, varied], deviation, rcond=None)[0]
    exponent = np.clip(exponent, -4, 4).round(2)
    (slow, fast), (light, firm) = ranges
    return Laws(
        speed_exponent=float(exponent[0]),
        speed_range_mm_s=speed_range(slow * 1e-3, fast * 1e-3),
        force_exponent=float(exponent[1]),
        force_range_n=(round(light / APART, 3), round(min(firm * APART, STRONGEST), 3)),
    )


def _about(model: LevelModel) -> About:
    """Return the identity of the texture; the file that is written gives it its name."""
    about, name = model.metadata, reading.one_line(model.path.name)
    return About(
        id=re.sub("[^a-z0-9]+", "-", model.path.stem.lower()).strip("-") or "texture",
        category=about.category,
        description=f"Learned model {name}",
        provenance="fitted",
        source=reading.one_line(f"Fitted to the levels of the model {name}: {about.source}"),
        license=reading.one_line(about.license),
    )


def _distance(about: LevelMetadata, speed: Floats, force: Floats, error: Floats) -> str:
    """Return the note on the distance (P, B) of the texture from the model."""
    row, band = np.unravel_index(np.abs(error).argmax(), error.shape)
    return (
        f"levels follow one exponent of speed and one of force: {_rms(error):.2f} dB rms from the "
        f"model, at most {abs(error[row, band]):.2f} dB ({about.frequency_per_mm[band]:g} "
        f"cycles/mm at {speed[row] * 1e3:.3g} mm/s and {force[row]:.3g} N)"
    )


def _notes(about: LevelMetadata, stochastic: Stochastic, loss: Floats) -> Iterator[str]:
    """Yield what was assumed."""
    if not differ(np.array(about.speed_range_mm_s)):
        yield f"trained at one speed: the speed exponent is assumed, {SPEED_PRIOR[0]:g}"
    if not differ(np.array(about.normal_force_range_n)):
        yield f"trained at one force: the force exponent is assumed, {FORCE_PRIOR[0]:g}"
    if stochastic.direction_spread_deg is not None:
        yield (
            f"waves go along the stroke, ± {stochastic.direction_spread_deg:g}°: an isotropic "
            f"surface would be wrong by up to {np.abs(loss).max():.1f} dB"
        )
    yield "a model has levels alone: Gaussian noise without envelope, gratings, events and friction"


def _band_errors(stochastic: Stochastic, error: Floats) -> Iterator[BandError]:
    """Yield the bands with the distance (P, B) of the texture from the model."""
    bands = zip(stochastic.frequency_per_mm, stochastic.level_db, error.T, strict=True)
    for frequency, level, off in bands:
        yield BandError(frequency, level, _rms(off), float(off[np.abs(off).argmax()]))


def _rms(error: Floats) -> float:
    """Return the root mean square of errors."""
    return float(np.sqrt(np.mean(error**2)))
