"""Surfaces counted from their waves, by another definition of the bands than the package's.

Third octaves are the exact base-10 ones here (IEC 61260-1).
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tactile.arrays import Floats
from tactile.texture.descriptor import Stochastic
from tactile.texture.surface import Texture

CENTERS = 10 ** (np.arange(-6, 10) / 10)
"""Cycles/mm, exact."""
EDGES = 10 ** (np.arange(-6.5, 10) / 10)
FALLING = tuple(-1.5 * n for n in range(16))
"""Levels [dB] that an isotropic surface can have."""
BETWEEN: Floats = 1.25 + 5.0 * np.arange(36, dtype=np.float64)
"""36 directions [deg], each halfway between two of those that a surface is fitted in."""
WITH_BANDS = ["leather-calf", "leather-suede", "plastic-abs-vdi27", "plastic-acrylic-ribbed",
              "wood-oak", "wood-pine-sanded"]  # fmt: skip


def write(path: Path, **tables: Mapping[str, object] | Sequence[Mapping[str, object]]) -> Path:
    """Write a descriptor of the given tables and return its path."""
    lines = [
        f'[texture]\nid = "{path.stem}"\ncategory = "test"\ndescription = ""',
        'provenance = "authored"\nsource = "a test"\nlicense = "CC0-1.0"',
        "[reference]\nspeed_mm_s = 40.0\nnormal_force_n = 0.5",
    ]
    for name, content in tables.items():
        for table in [content] if isinstance(content, Mapping) else content:
            lines.append(f"[{name}]" if isinstance(content, Mapping) else f"[[{name}]]")
            lines += [f"{k} = {v!r}".replace("(", "[").replace(")", "]") for k, v in table.items()]
    path.write_text("\n".join(lines))
    return path


def bands(levels: tuple[float, ...] = FALLING, **more: object) -> dict[str, object]:
    """Return the table of a stochastic part at the exact centers."""
    return {"frequency_per_mm": tuple(CENTERS.tolist()), "level_db": levels, **more}


def counted(
    wave_vector: Floats, amplitude: Floats, degrees: float, edges: Floats = EDGES
) -> Floats:
    """Return the band levels [dB re 1 µm²·mm] along a direction, wave by wave."""
    power, lowest = np.zeros(len(edges) - 1), 10 * math.log10(edges[0])
    for (kx, ky), a in zip(wave_vector, amplitude, strict=True):
        along = kx * math.cos(math.radians(degrees)) + ky * math.sin(math.radians(degrees))
        band = math.floor(10 * math.log10(abs(along) / (2 * math.pi) * 1e-3 + 1e-9) - lowest)
        if 0 <= band < len(power):
            power[band] += (a * 1e6) ** 2 / 2
    return np.asarray(10 * np.log10(np.maximum(power / np.diff(edges), 1e-12)))


def edges_of(stochastic: Stochastic) -> Floats:
    """Return the exact edges (B + 1,) of a descriptor's third octaves [cycles/mm]."""
    first = round(10 * math.log10(stochastic.frequency_per_mm[0]))
    return 10 ** ((np.arange(len(stochastic.frequency_per_mm) + 1) + first - 0.5) / 10)


def misses(texture: Texture, degrees: Floats) -> Floats:
    """Return by how much [dB] each band along each direction differs from the descriptor."""
    assert texture.descriptor.stochastic is not None
    wanted = np.asarray(texture.descriptor.stochastic.level_db)
    edges, waves = edges_of(texture.descriptor.stochastic), (texture.wave_vector, texture.amplitude)
    lines = (counted(*waves, d, edges) for d in degrees)
    return np.array([row - wanted for row in lines])


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
