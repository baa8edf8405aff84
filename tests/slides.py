"""Slides over surfaces that are known, as a sensor would record them; shares no code with the fit.

A stroke is displacement over place, drawn in the frequency domain from a power law; what a sensor
sees of it at a speed is derived in time by the closed form of a Fourier series.
"""

from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.texture.recorded_slide import Quantity, Recorded

RATE = 10e3
ORDERS = {"acceleration": 2, "velocity": 1, "displacement": 0, "force": 0}


@dataclass(frozen=True)
class Surface:
    """Density 10^(level/10) (k/k0)^slope µm²·mm at k cycles/mm, and a grating."""

    level_db: float = 0.0
    slope: float = -2.0
    wavelength_mm: float = 0.0
    harmonics_um: tuple[float, ...] = ()
    phases: tuple[float, ...] = ()
    exponent: float = -1.0
    force_exponent: float = 0.4

    def density(self, per_mm: Floats) -> Floats:
        """Return µm²·mm."""
        return np.asarray(10 ** (self.level_db / 10) * per_mm**self.slope)


def slide(
    surface: Surface,
    speed: float,
    *,
    seconds: float = 3.0,
    quantity: Quantity = "acceleration",
    seed: int = 0,
    force: float | None = None,
    reference: float = 0.04,
    rate: float = RATE,
    noise: float = 0.0,
    hum_hz: float = 0.0,
) -> Recorded:
    """Return what a sensor says of a slide [SI]; white ``noise`` rms, and a hum of 20 times it."""
    rng = np.random.default_rng(seed)
    count = round(seconds * rate)
    frequency = np.fft.rfftfreq(count, 1 / rate)
    per_mm = np.maximum(frequency, 1.0) / speed * 1e-3
    law = (speed / reference) ** surface.exponent
    law *= ((force or 0.5) / 0.5) ** surface.force_exponent
    # µm²/(cycle/mm) to m²/Hz: 1e-12 and 1/(1000 v) cycles/mm per Hz
    density = surface.density(per_mm) * 1e-15 / speed * law**2
    real, imaginary = rng.standard_normal((2, len(frequency)))
    spectrum = np.sqrt(density * rate * count / 2 / 2) * (real + 1j * imaginary)
    spectrum[frequency < 2] = 0
    omega = 2j * np.pi * frequency
    signal = np.fft.irfft(spectrum * omega ** ORDERS[quantity], count)
    time = np.arange(count) / rate
    start = rng.uniform(0, 2 * np.pi)
    for k, height in enumerate(surface.harmonics_um, 1):
        own = 2j * np.pi * k * speed * 1e3 / surface.wavelength_mm
        phase = k * start + (surface.phases[k - 1] if surface.phases else 0.0)
        wave = law * height * 1e-6 * np.exp(own * time + 1j * phase)
        signal += np.real(wave * own ** ORDERS[quantity])
    if noise:
        signal += noise * rng.standard_normal(count)
        signal += 20 * noise * np.sin(2 * np.pi * hum_hz * time) * (hum_hz > 0)
    if quantity == "force":
        signal = signal * 1e3
    return Recorded(
        name=f"slide{seed}", signal=signal, quantity=quantity, sample_rate=rate,
        speed=np.full(count, speed), normal_force=None if force is None else np.full(count, force),
    )  # fmt: skip
