"""Example of a learned model: levels of bands by regression on speed and force, as an ONNX file.

The level of each band is a + 20 (b lg v + c lg N), with exponents b and c of its own, whereas a
texture has one of each for all bands. They are those of a ridge regression toward the exponents
that a fit takes for known, -1 and 0.4, from which a few recordings hardly tell a band to differ.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from tactile.arrays import Floats
from tactile.texture.fitting import FORCE_PRIOR, SCATTER, SPEED_PRIOR, RecordingMeasures

OPSET, IR_VERSION = 17, 8
"""Versions of the operators and of the file format, which onnxruntime reads since 1.12 (2022)."""
LOUDEST = 20.0
"""Level that the loudest band of uncalibrated recordings is given at one of their speeds (assumed)
[dB re 1 µm²·mm]."""


@dataclass(frozen=True)
class BandRegression:
    """Levels of bands as straight lines over the logarithms of speed and force.

    Attributes
    ----------
    center : (B,) array of float
        Centers of the bands [cycles/m].
    weight : (2, B) array of float
        Exponents of speed and of force, on displacement.
    level : (B,) array of float
        Levels at 1 m/s and 1 N [dB re 1 µm²·mm].
    speed, force : tuple of 2 floats
        Lowest and highest recorded speed [m/s] and normal force [N].
    """

    center: Floats
    weight: Floats
    level: Floats
    speed: tuple[float, float]
    force: tuple[float, float]

    def at(self, speed: Floats, force: Floats) -> Floats:
        """Compute the levels (P, B) at speeds (P,) [m/s] and forces (P,) [N]."""
        lever = 20 * np.log10(np.stack([speed, force], axis=1))
        return np.asarray(lever @ self.weight + self.level)


def regression_of(measured: RecordingMeasures) -> BandRegression:
    """Learn the levels of the bands that recordings cover.

    Parameters
    ----------
    measured : RecordingMeasures
        Levels of recordings; those of uncalibrated ones are raised or lowered to `LOUDEST`.

    Returns
    -------
    BandRegression
        Ridge regression of each band over the recordings that cover it.
    """
    covered = np.isfinite(measured.level).any(axis=0)
    level = measured.level[:, covered]
    if not measured.slides[0].recorded.calibrated:
        level = level + LOUDEST - np.nanmax(level)
    lever = 20 * np.log10(np.stack([measured.speed, measured.force], axis=1))
    prior, spread = np.transpose([SPEED_PRIOR, FORCE_PRIOR])
    weight, constant = np.empty((2, level.shape[1])), np.empty(level.shape[1])
    for band, column in enumerate(level.T):
        known = np.isfinite(column)
        middle, mean = lever[known].mean(axis=0), column[known].mean()
        x, y = lever[known] - middle, column[known] - mean
        normal = x.T @ x + np.diag((SCATTER / spread) ** 2)
        weight[:, band] = prior + np.linalg.solve(normal, x.T @ (y - x @ prior))
        constant[band] = mean - middle @ weight[:, band]
    ends = ((float(s.min()), float(s.max())) for s in (measured.speed, measured.force))
    return BandRegression(measured.center[covered], weight, constant, *ends)


def write_model(path: Path, model: BandRegression, *, source: str, category: str = "test") -> None:
    """Write a model as an ONNX file that `tactile convert` reads.

    Parameters
    ----------
    path : Path
        File to write.
    model : BandRegression
        The model.
    source : str
        Origin of the recordings.
    category : str
        Category of the texture.
    """
    per_ln = 20 / np.log(10) * model.weight
    at_mm_s = model.level - 20 * np.log10(1e3) * model.weight[0]
    tensors = {"weight": per_ln, "bias": at_mm_s}
    sizes = {"stroke": 2, "level_db": len(model.level)}
    stroke, levels = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", size])
        for name, size in sizes.items()
    )
    nodes = [
        helper.make_node("Log", ["stroke"], ["lever"]),
        helper.make_node("MatMul", ["lever", "weight"], ["law"]),
        helper.make_node("Add", ["law", "bias"], ["level_db"]),
    ]
    constants = [numpy_helper.from_array(v.astype(np.float32), k) for k, v in tensors.items()]
    graph = helper.make_graph(nodes, "levels", [stroke], [levels], constants)
    file = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    helper.set_model_props(file, _metadata(model, source, category))
    onnx.save(file, path)


def _metadata(model: BandRegression, source: str, category: str) -> dict[str, str]:
    """Return the metadata of the file."""

    def rounded(values: Floats) -> str:
        return json.dumps([float(f"{value:.4g}") for value in values])

    return {
        "frequency_per_mm": rounded(model.center * 1e-3),
        "speed_range_mm_s": rounded(np.array(model.speed) * 1e3),
        "normal_force_range_n": rounded(np.array(model.force)),
        "quantity": "tangential_skin_displacement",
        "source": source,
        "category": category,
    }
