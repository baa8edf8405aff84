"""Learned models as ONNX files: textures that are made of them, and files that are refused."""

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from cli_rig import Command
from onnx import TensorProto, helper, numpy_helper

import tactile
from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError
from tactile.texture.formats import level_model
from tactile.texture.formats.conversion import convert_file
from tactile.texture.formats.level_model import load_level_model, texture_of_model

BANDS = (0.5, 0.63, 0.8, 1.0, 1.25, 1.6)
"""Centers of the bands [cycles/mm]."""
FALLING = np.linspace(-20, -45, len(BANDS))
"""Levels at 1 mm/s and 1 N, which fall as those of an isotropic surface may [dB]."""
LOG = [
    helper.make_node("Log", ["stroke"], ["lever"]),
    helper.make_node("MatMul", ["lever", "weight"], ["law"]),
    helper.make_node("Add", ["law", "bias"], ["level_db"]),
]
"""Graph of a power law: level = ln (v, N) · weight + bias."""
METADATA = {
    "frequency_per_mm": json.dumps(BANDS),
    "speed_range_mm_s": "[20, 80]",
    "normal_force_range_n": "[0.25, 1]",
    "quantity": "tangential_skin_displacement",
    "source": "a closed form",
    "category": "paper",
}


def power_law(speed_exponent: Any, force_exponent: Any) -> dict[str, Floats]:
    """Return the constants of `LOG` for exponents of displacement."""
    exponents = np.broadcast_arrays(speed_exponent, force_exponent, FALLING)[:2]
    return {"weight": 20 / math.log(10) * np.stack(exponents), "bias": FALLING}


def tensor(name: str, shape: list[Any], kind: int = TensorProto.FLOAT) -> Any:
    return helper.make_tensor_value_info(name, kind, shape)


def written(path: Path, nodes: list[Any] = LOG, **changed: Any) -> Path:
    """Write a model, by default that of a power law, with parts that are changed."""
    constants = changed.get("constants", power_law(-1.0, 0.4))
    tensors = [numpy_helper.from_array(np.asarray(v, np.float32), k) for k, v in constants.items()]
    graph = helper.make_graph(
        nodes, "levels", changed.get("inputs", [tensor("stroke", ["N", 2])]),
        changed.get("outputs", [tensor("level_db", ["N", len(BANDS)])]),
        tensors + changed.get("tensors", []),
    )  # fmt: skip
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("my.ops", 1)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=8)
    texts = METADATA | changed.get("metadata", {})
    helper.set_model_props(model, {k: v for k, v in texts.items() if v is not None})
    path.write_bytes(model.SerializeToString())
    return path


# Textures


def test_a_power_law_gives_a_texture_with_its_exponents_and_levels(tmp_path: Path) -> None:
    """The tolerance is that of levels rounded to 0.1 dB and of laws that bend beyond a range."""
    file = written(tmp_path / "law.onnx", constants=power_law(-0.97, 0.35))
    texture, notes, bands = texture_of_model(load_level_model(file))
    assert (texture.laws.speed_exponent, texture.laws.force_exponent) == (-0.97, 0.35)
    assert (texture.laws.speed_range_mm_s, texture.laws.force_range_n) == ((5, 320), (0.217, 1.15))
    assert (texture.reference.speed_mm_s, texture.reference.normal_force_n) == (40, 0.5)
    assert texture.stochastic is not None
    assert texture.stochastic.frequency_per_mm == BANDS
    at_reference = FALLING + 20 * (-0.97 * math.log10(40) + 0.35 * math.log10(0.5))
    np.testing.assert_allclose(texture.stochastic.level_db, at_reference, atol=0.08)
    assert max(abs(band.worst_db) for band in bands) < 0.25
    assert "dB rms from the model, at most" in notes[0]
    assert not any("assumed" in note for note in notes)


def test_bands_with_exponents_of_their_own_leave_the_closed_form_of_a_rest(tmp_path: Path) -> None:
    """Exponents -1 ± 0.5 leave ± 10 lg(v/v0) dB: at most 10 lg 2 at the ends of 20 … 80 mm/s."""
    turn = np.array([0.5, -0.5] * 3)
    file = written(tmp_path / "law.onnx", constants=power_law(-1 + turn, 0.0))
    texture, _, bands = texture_of_model(load_level_model(file))
    assert texture.laws.speed_exponent == -1
    off = 10 * np.log10(np.geomspace(0.5, 2, level_model.SPEEDS))
    for band, sign in zip(bands, -turn, strict=True):
        assert band.rms_db == pytest.approx(off.std(), abs=0.06)
        assert abs(band.worst_db) == pytest.approx(10 * math.log10(2), abs=0.06), sign


def test_a_level_that_bends_over_speed_is_farthest_at_the_ends(tmp_path: Path) -> None:
    """A level of 2 x² dB over x = ln(v/v0) has no slope; a constant lies below it at the ends."""
    bend = [
        LOG[0],
        helper.make_node("Sub", ["lever", "middle"], ["x"]),
        helper.make_node("Mul", ["x", "x"], ["square"]),
        helper.make_node("MatMul", ["square", "weight"], ["law"]),
        LOG[2],
    ]
    weight, middle = np.stack([np.full(len(BANDS), 2.0), np.zeros(len(BANDS))]), np.log([40, 1])
    constants = {"weight": weight, "middle": middle, "bias": FALLING}
    file = written(tmp_path / "bend.onnx", bend, constants=constants)
    texture, _, bands = texture_of_model(load_level_model(file))
    assert texture.laws.speed_exponent == 0
    square = 2 * np.linspace(-math.log(2), math.log(2), level_model.SPEEDS) ** 2
    for band in bands:
        assert band.worst_db == pytest.approx(square.mean() - square[0], abs=0.06)


def test_a_network_is_given_speed_in_mm_s_and_then_force_in_n(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 8)) / 10, rng.normal(size=(8, len(BANDS)))
    nodes = [
        helper.make_node("MatMul", ["stroke", "first"], ["sum"]),
        helper.make_node("Tanh", ["sum"], ["hidden"]),
        helper.make_node("MatMul", ["hidden", "second"], ["level_db"]),
    ]
    file = written(tmp_path / "net.onnx", nodes, constants={"first": first, "second": second})
    speed, force = np.array([0.02, 0.05]), np.array([0.3, 1.0])
    want = np.tanh(np.stack([speed * 1e3, force], axis=1) @ first) @ second
    made = load_level_model(file).levels(speed, force)
    np.testing.assert_allclose(made, want, atol=1e-4)  # float32


def test_a_reference_speed_is_that_of_the_levels(tmp_path: Path) -> None:
    file, target = written(tmp_path / "law.onnx"), tmp_path / "law.toml"
    convert_file(str(file), target, speed=0.08)
    texture = tactile.load_texture(target).descriptor
    assert texture.reference.speed_mm_s == 80
    assert texture.stochastic is not None
    at_80 = FALLING - 20 * math.log10(80) + 8 * math.log10(0.5)
    np.testing.assert_allclose(texture.stochastic.level_db, at_80, atol=0.08)


def test_a_range_without_extent_tells_no_exponent(tmp_path: Path) -> None:
    one = {"speed_range_mm_s": "[40, 40]", "normal_force_range_n": "[0.5, 0.55]"}
    file = written(tmp_path / "law.onnx", constants=power_law(-1.5, 1.0), metadata=one)
    texture, notes, _ = texture_of_model(load_level_model(file))
    assert (texture.laws.speed_exponent, texture.laws.force_exponent) == (-1, 0.4)
    assert sum("exponent is assumed" in note for note in notes) == 2


def test_a_peak_that_no_isotropic_surface_has_gets_a_direction(tmp_path: Path) -> None:
    peak = power_law(-1.0, 0.4) | {"bias": np.array([-60.0, -60, -60, -10, -60, -60])}
    texture, notes, _ = texture_of_model(
        load_level_model(written(tmp_path / "law.onnx", constants=peak))
    )
    assert texture.stochastic is not None
    assert texture.stochastic.direction_spread_deg == 15
    assert any("an isotropic surface would be wrong by" in note for note in notes)


def test_the_command_writes_a_texture_and_reports_each_band(
    command: Command, tmp_path: Path
) -> None:
    written(tmp_path / "law.onnx")
    done = command("convert", "law.onnx", "my-law.toml")
    assert (done.code, done.err) == (0, "")
    assert "largest error dB" in done.out
    facts = command("convert", "law.onnx", "my-law.toml", "--force", "--json").json
    assert [band["frequency_per_mm"] for band in facts["bands"]] == list(BANDS)
    about = tactile.load_texture(tmp_path / "my-law.toml").descriptor.texture
    assert (about.id, about.category) == ("my-law", "paper")
    assert about.source.endswith("law.onnx: a closed form")
    effect = command("convert", "law.onnx", "law.hjif", "--speed-mm-s", "40")
    assert effect.code == 0


# Files that are refused


def refusal(path: Path, read: Callable[[Path], object] = load_level_model) -> str:
    """Return the one line with which a file is refused, without its path."""
    with pytest.raises(InputError) as refused:
        read(path)
    line = str(refused.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    assert len(line) < 500
    return line.removeprefix(f"{path}: ")


@pytest.mark.parametrize("content", [b"", b"no model at all", b"\x08\x08\x12\x03", b"[1, 2]" * 99])
def test_what_is_no_onnx_file_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    path.write_bytes(content)
    assert refusal(path).startswith("not an ONNX model that can be read: ")


def test_a_file_that_is_cut_off_or_too_large_or_missing_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "x.onnx")
    path.write_bytes(path.read_bytes()[:-40])
    assert refusal(path).startswith("not an ONNX model that can be read: ")
    path.write_bytes(bytes(9 * 1024**2))
    assert refusal(path) == "is larger than 8 MiB"
    with pytest.raises(NotFoundError, match="no such file"):
        load_level_model(tmp_path / "y.onnx")


def test_a_missing_library_is_one_line_that_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "x.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"^a learned model needs onnxruntime: .*\[onnx\]'$"):
        load_level_model(path)


@pytest.mark.parametrize("domain", ["my.ops", ""])
def test_foreign_operators_are_named(domain: str, tmp_path: Path) -> None:
    foreign = [helper.make_node("Magic", ["stroke"], ["level_db"], domain=domain)]
    line = refusal(written(tmp_path / "x.onnx", foreign, constants={}))
    assert line.startswith(f"operator {domain}{':' * bool(domain)}Magic is not one of ONNX: export")


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"inputs": [tensor("stroke", ["N", 3])], "constants": {"weight": np.ones((3, 6)),
          "bias": FALLING}}, "input is tensor(float) ('N', 3): must be one tensor(float)"),
        ({"inputs": [tensor("stroke", [1, 2])]}, "input is tensor(float) (1, 2): must be one"),
        ({"inputs": [tensor("stroke", ["N", 2]), tensor("more", ["N", 2])]},
         "input is tensor(float) ('N', 2), tensor(float) ('N', 2): must be one"),
        ({"outputs": [tensor("level_db", ["N", 6]), tensor("law", ["N", 6])]},
         "output is tensor(float) ('N', 6), tensor(float) ('N', 6): must be one"),
        ({"inputs": [tensor("stroke", ["N", 2], TensorProto.DOUBLE)], "constants": {},
          "outputs": [tensor("level_db", ["N", 2], TensorProto.DOUBLE)],
          "nodes": [helper.make_node("Log", ["stroke"], ["level_db"])]},
         "input is tensor(double) ('N', 2): must be one tensor(float)"),
        ({"constants": {"weight": np.ones((3, 6)), "bias": FALLING}},
         "not an ONNX model that can be read: "),
    ],
)  # fmt: skip
def test_tensors_of_other_shapes_and_types_are_refused(
    changed: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    assert refusal(written(tmp_path / "x.onnx", **changed)).startswith(reason)


@pytest.mark.parametrize(
    ("metadata", "reason"),
    [
        ({name: None}, f"object missing required field {name}")
        for name in list(METADATA)[:5]
    ] + [
        ({"frequency_per_mm": "0.5 0.63"}, "frequency_per_mm = '0.5 0.63': must be a JSON array"),
        ({"frequency_per_mm": "[NaN, 1, 2, 3]"}, "frequency_per_mm = '[NaN, 1, 2, 3]': must be"),
        ({"frequency_per_mm": "[1, 2, 4, 8]"}, "frequency_per_mm must ascend in third octaves"),
        ({"frequency_per_mm": "[1]"}, "frequency_per_mm has 1 values, needs 4 to 41"),
        ({"speed_range_mm_s": "[20]"}, "speed_range_mm_s: expected array of length 2"),
        ({"speed_range_mm_s": "[80, 20]"}, "speed_range_mm_s = [80, 20] must ascend"),
        ({"normal_force_range_n": "[0, 1]"}, "normal_force_range_n[0] = 0: expected float > 0.0"),
        ({"quantity": "acceleration"}, "quantity = 'acceleration': unknown; there is: tangential_"),
        ({"category": "papers"}, "category = 'papers': unknown; did you mean 'paper'?"),
    ],
)  # fmt: skip
def test_metadata_that_is_missing_or_wrong_is_refused(
    metadata: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    line = refusal(written(tmp_path / "x.onnx", metadata=metadata))
    assert line.lower().startswith(f"metadata: {reason}".lower())


def texture_of_file(path: Path) -> object:
    return texture_of_model(load_level_model(path))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"constants": power_law(-1.0, math.nan)}, "level = nan dB at 20 mm/s and 0.25 N in the"),
        ({"constants": power_law(4.0, 0.0)}, "level = 84.0824 dB at 20 mm/s and 0.25 N in the"),
        ({"metadata": {"frequency_per_mm": "[1, 1.25, 1.6, 2]"}},
         "output has the shape (153, 6) for 153 strokes: must be (153, 4)"),
        ({"nodes": [helper.make_node("Reshape", ["stroke", "shape"], ["level_db"])],
          "constants": {}, "tensors": [helper.make_tensor("shape", TensorProto.INT64, [1], [7])]},
         "cannot be computed: "),
    ],
)  # fmt: skip
def test_a_model_that_computes_no_levels_is_refused(
    changed: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    assert refusal(written(tmp_path / "x.onnx", **changed), texture_of_file).startswith(reason)


def test_a_speed_for_which_it_was_not_trained_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "x.onnx")
    with pytest.raises(InputError, match=r"90 mm/s: the model was trained for 20 … 80 mm/s"):
        texture_of_model(load_level_model(path), 0.09)


def test_a_model_that_needs_too_much_memory_is_refused_when_it_computes(tmp_path: Path) -> None:
    """No process has 10¹⁶ numbers; a model that is only read does not compute them."""
    nodes = [
        helper.make_node("ConstantOfShape", ["size"], ["zeros"]),
        helper.make_node("ReduceSum", ["zeros"], ["sum"], keepdims=0),
        helper.make_node("Add", ["stroke", "sum"], ["level_db"]),
    ]
    size = helper.make_tensor("size", TensorProto.INT64, [2], [10**8, 10**8])
    outputs = [tensor("level_db", ["N", 2])]
    path = written(tmp_path / "x.onnx", nodes, constants={}, tensors=[size], outputs=outputs)
    assert refusal(path, texture_of_file).startswith("cannot be computed: ")


def test_a_loop_without_end_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    body = helper.make_graph(
        [helper.make_node("Identity", ["on"], ["again"]), helper.make_node("Exp", ["x"], ["y"])],
        "body",
        [tensor("i", [], TensorProto.INT64), tensor("on", [], TensorProto.BOOL), tensor("x", [])],
        [tensor("again", [], TensorProto.BOOL), tensor("y", [])],
    )
    loop = [helper.make_node("Loop", ["count", "true", "stroke"], ["level_db"], body=body)]
    for value in (body.input[2], body.output[1]):
        value.type.tensor_type.ClearField("shape")
    numbers = [
        helper.make_tensor("count", TensorProto.INT64, [], [2**62]),
        helper.make_tensor("true", TensorProto.BOOL, [], [True]),
    ]
    outputs = [tensor("level_db", ["N", 2])]
    path = written(tmp_path / "x.onnx", loop, constants={}, tensors=numbers, outputs=outputs)
    monkeypatch.setattr(level_model, "LONGEST", 0.2)
    assert refusal(path, texture_of_file) == "computes for more than 0.2 s"


@pytest.mark.parametrize("absolute", [True, False])
def test_a_model_reads_no_other_file(
    absolute: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights may stand in a file that the model names; it is beside the model and open to all."""
    monkeypatch.chdir(tmp_path)
    path, beside = written(tmp_path / "x.onnx"), tmp_path / "weight.bin"
    model = onnx.load(path)
    weight = model.graph.initializer[0]
    beside.write_bytes(weight.raw_data)
    weight.ClearField("raw_data")
    weight.data_location = TensorProto.EXTERNAL
    weight.external_data.add(key="location", value=str(beside) if absolute else beside.name)
    path.write_bytes(model.SerializeToString())
    assert refusal(path).startswith("not an ONNX model that can be read: ")
