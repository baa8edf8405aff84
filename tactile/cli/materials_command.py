"""The command ``tactile materials``."""

from typing import Any

import tactile
from tactile.cli.options import AsJson, emit
from tactile.cli.printing import print_facts, print_table, right, unwrapped

VACUUM_PF_PER_M = 8.8541878128
"""Permittivity of vacuum in pF/m, CODATA 2018."""
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
"""Heading of each value that is printed."""


def run(as_json: AsJson = False) -> None:
    """List the known piezoceramics, shims and benders.

    A display file names them in its table [bimorph] by the keys piezo, shim and bender; a study
    varies piezo and shim.

    Example: tactile materials
    """
    facts = {
        "piezos": {name: _piezo(piezo) | _note(name) for name, piezo in tactile.PIEZOS.items()},
        "shims": {name: _shim(shim) | _note(name) for name, shim in tactile.SHIMS.items()},
        "benders": {name: _bender(bender) for name, bender in tactile.BENDERS.items()},
    }
    emit(facts, as_json, _print)


def _piezo(piezo: "tactile.PiezoMaterial") -> dict[str, Any]:
    """Return the constants of a piezoceramic."""
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
    """Return the constants of a shim."""
    return {
        "e_gpa": 1e-9 / float(shim.s11),
        "g_gpa": 1e-9 / float(shim.s55),
        "density_kg_m3": float(shim.density),
        "quality": float(shim.quality_factor),
    }


def _note(name: str) -> dict[str, Any]:
    """Return the description, the source and for a piezoceramic the coercive field."""
    note = tactile.MATERIAL_NOTES[name]
    field = {} if name in tactile.SHIMS else {"coercive_v_per_mm": _per_mm(note.coercive_field)}
    return {**field, "description": note.description, "source": note.source}


def _per_mm(field: float | None) -> float | None:
    """Convert a field from V/m to V/mm."""
    return None if field is None else field * 1e-3


def _bender(bender: "tactile.Bimorph") -> dict[str, Any]:
    """Return the dimensions and the performance of a bender."""
    return {
        "width_mm": float(bender.width) * 1e3,
        "length_mm": float(bender.length) * 1e3,
        "height_mm": float(bender.height) * 1e3,
        "wiring": "series" if bender.series else "parallel",
        **tactile.bender_figures(bender),
    }


def _print(facts: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Print a table of each kind, and the source of each material."""
    _print_kind("Piezoceramics", facts["piezos"])
    _print_kind("Shims", facts["shims"])
    _print_kind("Benders that a display file can name, computed by the model", facts["benders"])
    notes = {
        name: f"{note.description}. Source: {note.source}."
        for name, note in tactile.MATERIAL_NOTES.items()
    }
    print_facts(notes, "What they are")


def _print_kind(title: str, rows: dict[str, dict[str, Any]]) -> None:
    """Print the values of all materials or benders of one kind."""
    names = [name for name in next(iter(rows.values())) if name in HEADINGS]
    columns = [unwrapped(""), *right(*(HEADINGS[name] for name in names))]
    cells = ((name, *(_cell(row[key]) for key in names)) for name, row in rows.items())
    print_table(columns, cells, title)


def _cell(value: Any) -> str:
    """Return a value as text; an unknown one is empty."""
    return "" if value is None else value if isinstance(value, str) else f"{value:.4g}"
