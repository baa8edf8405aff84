"""``tactile adjust`` reads measurements of finite elements and writes a display that has them."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cli_rig import Command, assert_mistake
from numpy.typing import NDArray
from reference_beam import LOW_FINGER, Beam, response

from tactile.display.display import load_display


@pytest.fixture
def adjust(command: Command) -> Command:
    """Return what runs this command."""
    return partial(command, "adjust")


FREQUENCY = np.concatenate([np.geomspace(10, 800, 25), np.linspace(850, 1050, 20)])


def written(path: Path, value: NDArray[np.complex128], unit: str, scale: float) -> str:
    one = np.random.default_rng(1).standard_normal((2, len(value)))
    value = value * (1 + 0.003 * (one[0] + 1j * one[1])) * scale
    rows = [
        f"{f},{abs(v)},{np.degrees(np.angle(v))},{unit}\n"
        for f, v in zip(FREQUENCY, value, strict=True)
    ]
    path.write_text("frequency_hz,magnitude,phase_deg,unit\n" + "".join(rows), "utf-8")
    return str(path)


@pytest.fixture
def loaded(tmp_path: Path) -> str:
    value = response(Beam(), FREQUENCY, load=LOW_FINGER).displacement
    return written(tmp_path / "loaded.csv", value, "um/V", 1e6)


@pytest.fixture
def in_air(tmp_path: Path) -> list[str]:
    told = response(Beam(d31=-280e-12, piezo_quality=90.0), FREQUENCY)
    speed = 2j * np.pi * FREQUENCY * told.displacement
    return [
        "--admittance", written(tmp_path / "electrical.csv", told.admittance, "uS", 1e6),
        "--velocity", written(tmp_path / "mechanical.csv", speed, "mm/s/V", 1e3),
    ]  # fmt: skip


def test_a_finger_is_fitted_and_written(tmp_path: Path, loaded: str, adjust: Command) -> None:
    out = tmp_path / "mine.toml"
    code, said, _ = adjust("--load", loaded, "--out", out)
    assert code == 0
    assert "k0_n_per_m" in said
    assert "loaded.csv" in said
    load = load_display(out).load_at(1.0)
    assert load.k0 == pytest.approx(1000, rel=0.02)
    assert load.branches[0][1] == pytest.approx(0.33, rel=0.05)


@pytest.mark.ci
def test_a_fit_is_drawn(tmp_path: Path, in_air: list[str], adjust: Command) -> None:
    plot = tmp_path / "fit.png"
    assert adjust(*in_air, "--plot", plot).code == 0
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_bimorph_is_fitted_and_written(
    tmp_path: Path, in_air: list[str], adjust: Command
) -> None:
    out = tmp_path / "mine.toml"
    told = adjust(*in_air, "--out", out, "--json").json
    assert told["constants"]["d31_pm_per_v"]["value"] == pytest.approx(-280, rel=0.005)
    assert set(told["misfit"]) == {"electrical.csv", "mechanical.csv"}
    assert load_display(out).bimorph.piezo.d31 == pytest.approx(-280e-12, rel=0.005)
    again = adjust(*in_air, "--stiffness", "--out", out, "--force", "--json")
    softer = again.json["constants"]["s11e_um2_per_n"]["value"]
    assert load_display(out).bimorph.piezo.s11E == pytest.approx(softer * 1e-12, rel=1e-5)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "give either --load, or one or both of --admittance and --velocity"),
        (["--load", "a.csv", "--velocity", "b.csv"], "give either --load, or"),
        (["--velocity", "b.csv", "--branches", "2"], "--branches can only be used with --load"),
        (["--load", "a.csv", "--stiffness"], "--stiffness can only be used with"),
        (["--load", "a.csv", "--plot", "fit.doc"], "fit.doc: must end in"),
        (["--load", "none.csv"], "none.csv: no such file"),
    ],
)
def test_a_mistake_is_one_line(words: list[str], said: str, adjust: Command) -> None:
    assert_mistake(adjust(*words), said)
