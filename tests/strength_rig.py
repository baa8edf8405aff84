"""Textures, displays and measured shear for the tests of strength.

Measured shear is the drive of `render` through the display's own response, by Fourier transform,
which is no part of what is tested.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import welch

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Rendering, render
from tactile.strength.strength import SteadyStroke
from tactile.texture.perception import channel_sensation
from tactile.texture.surface import Texture, load_texture, without_friction

RATE = 8000.0
STROKE = SteadyStroke()
HEAD = """
[texture]
id = "authored"
category = "test"
description = "for a test"
provenance = "authored"
source = "a test"
license = "CC0-1.0"

[reference]
speed_mm_s = 80.0
normal_force_n = 0.5
"""


def few(display: Display, *which: int, volts: float | None = None) -> Display:
    """Return a display with some of its contactors, and another limit."""
    index = list(which)
    limits = display.limits if volts is None else replace(display.limits, voltage=volts)
    return replace(
        display,
        contactors=display.contactors[index],
        shear_direction=display.shear_direction[index],
        polarity=display.polarity[index],
        channel=np.arange(len(index), dtype=np.intp),
        kind=display.kind[index],
        limits=limits,
    )


def smooth(name: str) -> Texture:
    """Return a texture of few partials without what friction adds."""
    return without_friction(load_texture(name, partials=192))


def authored(folder: Path, parts: str) -> Texture:
    """Return a texture of some parts."""
    (folder / "authored.toml").write_text(HEAD + parts, encoding="utf-8")
    return load_texture(folder / "authored.toml")


def ribs(folder: Path, frequency: float, micro: float) -> Texture:
    """Return a grating that sounds at a frequency [Hz] at 80 mm/s."""
    return authored(
        folder, f"[[periodic]]\nwavelength_mm = {80 / frequency}\nharmonics_um = [{micro}]\n"
    )


def played(display: Display, texture: Texture, seconds: float) -> Rendering:
    line = Trajectory.line(speed=0.08, duration=seconds, normal_force=0.5)
    return render(display, texture, line)


def skin(display: Display, drive: Floats) -> Floats:
    """Return the shear (S, N) [m] that drive makes, by the model's response."""
    frequency = np.fft.rfftfreq(len(drive), 1 / RATE)
    grid = np.append(np.arange(0, 1500, 2.0), 4000.0)
    response = display.responses(grid, RATE)[0, 0]
    at = np.interp(frequency, grid, response.real) + 1j * np.interp(frequency, grid, response.imag)
    return np.fft.irfft(np.fft.rfft(drive, axis=0) * at[:, None], len(drive), axis=0)


def spectrum(shear: Floats, segment: int = 32768) -> tuple[Floats, Floats]:
    """Return frequencies and powers of a shear's spectrum, mean over contactors."""
    frequency, density = welch(shear.T, RATE, nperseg=segment)
    return frequency, np.asarray(density.mean(axis=0) * frequency[1])


def felt(frequency: Floats, power: Floats) -> float:
    return max(channel_sensation(frequency, power).values())
