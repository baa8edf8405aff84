"""Commands about what benders are made of: ``materials``."""

import json
from typing import Any

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app

VACUUM_PF_PER_M = 8.8541878128
"""ε0, CODATA 2018."""
HEADINGS = {
    "d31_pm_per_v": "d31 pm/V",
    "eps33t_relative": "ε33T/ε0",
    "k31": "k31",
    "y11e_gpa": "Y11E GPa",
    "e_gpa": "E GPa",
    "g_gpa": "G GPa",
    "density_kg_m3": "kg/m³",
    "quality": "Q",
    "loss_tangent": "tanδ",
    "coercive_v_per_mm": "Ec V/mm",
    "width_mm": "w mm",
    "length_mm": "free mm",
    "height_mm": "h mm",
    "wiring": "wired",
    "displacement_um_per_v": "µm/V",
    "blocked_force_mn_per_v": "mN/V",
    "stiffness_n_per_m": "N/m",
    "capacitance_nf": "nF",
    "first_resonance_hz": "Hz",
}
"""Of the columns that are printed."""


@app.command("materials")
def list_materials(as_json: AsJson = False) -> None:
    """List piezoceramics, shims and benders that a display or a study can name.

    Example: tactile materials
    """
    piezos = {name: _piezo(piezo) | _note(name) for name, piezo in tactile.PIEZOS.items()}
    shims = {name: _shim(shim) | _note(name) for name, shim in tactile.SHIMS.items()}
    benders = {name: _bender(bender) for name, bender in tactile.BENDERS.items()}
    if as_json:
        typer.echo(json.dumps({"piezos": piezos, "shims": shims, "benders": benders}))
        return
    _print("Piezoceramics", piezos)
    _print("Shims", shims)
    _print("Benders, as the model has them", benders)
    for name, note in tactile.MATERIAL_NOTES.items():
        typer.echo(f"{name}: {note.description}. Source: {note.source}.")


def _piezo(piezo: "tactile.PiezoMaterial") -> dict[str, Any]:
    return {
        "d31_pm_per_v": float(piezo.d31) * 1e12,
        "eps33t_relative": float(piezo.eps33T) * 1e12 / VACUUM_PF_PER_M,
        "k31": float(piezo.coupling_squared) ** 0.5,
        "y11e_gpa": 1e-9 / float(piezo.s11E),
        "density_kg_m3": float(piezo.density),
        "quality": float(piezo.quality_factor),
        "loss_tangent": float(piezo.loss_tangent),
    }


def _shim(shim: "tactile.ShimMaterial") -> dict[str, Any]:
    return {
        "e_gpa": 1e-9 / float(shim.s11),
        "g_gpa": 1e-9 / float(shim.s55),
        "density_kg_m3": float(shim.density),
        "quality": float(shim.quality_factor),
    }


def _note(name: str) -> dict[str, Any]:
    note = tactile.MATERIAL_NOTES[name]
    field = {} if name in tactile.SHIMS else {"coercive_v_per_mm": _per_mm(note.coercive_field)}
    return {**field, "description": note.description, "source": note.source}


def _per_mm(field: float | None) -> float | None:
    return None if field is None else field * 1e-3


def _bender(bender: "tactile.Bimorph") -> dict[str, Any]:
    return {
        "width_mm": float(bender.width) * 1e3,
        "length_mm": float(bender.length) * 1e3,
        "height_mm": float(bender.height) * 1e3,
        "wiring": "series" if bender.series else "parallel",
        **tactile.bender_figures(bender),
    }


def _print(title: str, rows: dict[str, dict[str, Any]]) -> None:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    names = [name for name in next(iter(rows.values())) if name in HEADINGS]
    table.add_column("", no_wrap=True)
    for name in names:
        table.add_column(HEADINGS[name], justify="right")
    for name, row in rows.items():
        table.add_row(name, *(_cell(row[key]) for key in names))
    Console().print(table)


def _cell(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.4g}"
