"""Ribs: periodic envelopes that a fit finds in strokes, and false alarms where there are none.

Strokes are rendered over noise under a periodic envelope, at three speeds that are even or waver by
5 %, and fitted as recordings. False alarms are counted on noise under random envelopes, and on
recordings: of fabrics in every choice of their speeds, and of the slides of a BioTac with speeds
that are drawn at random, between which nothing that repeats in them moves as ribs do.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path

import numpy as np

from benchmarks.fit import (
    ABOUT,
    BIOTAC_SPEED,
    FABRIC_NAMES,
    FABRICS,
    biotac_slides,
    fabric,
    recordings,
    texture_of,
)
from benchmarks.rendering import SKIPPED
from tactile.bench.figures import RATE, Figure, at_least, at_most
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import render
from tactile.texture.descriptor import Descriptor, Modulation, Reference, Stochastic
from tactile.texture.fitting import describe, measure_slides
from tactile.texture.recorded_slide import Recorded
from tactile.texture.surface import Texture

WAVELENGTHS_MM, DEPTHS = (0.7, 1.3, 2.4, 4.0), (0.3, 0.5, 0.8)
"""Wavelengths [mm] and depths of the envelopes, which are combined."""
SPEEDS = 0.02, 0.035, 0.06
"""Speeds of the strokes over one surface [m/s]."""
WANDERS = 0.0, 0.05
"""Largest relative deviations of the speed."""
RANDOM = (0.0, 0.0, 0.1), (0.3, 1.2, 0.1), (0.2, 3.0, 0.3), (0.4, 4.0, 0.2)
"""Depth, excess kurtosis and corner [cycles/mm] of random envelopes."""
SURFACES = 5
"""Number of surfaces under each random envelope."""
DRAWS = 3
"""Number of random speeds that each slide of a BioTac is given."""
SPAN = 3.0
"""Ratio of the fastest of these speeds to the slowest."""


def noise_under(
    modulation: tuple[Modulation, ...], depth: float, kurtosis: float, corner: float
) -> Texture:
    """Return a texture of noise under envelopes, which falls by 6 dB per octave of density."""
    center = 10 ** (np.arange(-5, 15) / 10)
    stochastic = Stochastic(
        frequency_per_mm=tuple(center.tolist()), level_db=tuple((-20 * np.log10(center)).tolist()),
        excess_kurtosis=kurtosis, am_depth=depth, am_corner_per_mm=corner,
    )  # fmt: skip
    reference = Reference(speed_mm_s=40, normal_force_n=0.5)
    return texture_of(
        Descriptor(texture=ABOUT, reference=reference, stochastic=stochastic, modulation=modulation)
    )


def strokes_at(texture: Texture, seed: int, wander: float) -> list[Recorded]:
    """Return strokes of 3 s along x under one contactor, as recordings that know their speed.

    The speed swings about its mean once in 1.7 s.
    """
    time = np.arange(round(3 * RATE) + 2 * SKIPPED + 1) / RATE
    turn, slides = 2 * np.pi / 1.7, []
    for k, speed in enumerate(SPEEDS):
        along = speed * (time - wander / turn * np.cos(turn * time + k))
        path = Trajectory(time, np.outer(along, [1, 0]), 0.5)
        shear = render(load_display("reference-24"), texture, path, seed=seed).shear[:, 7 * k]
        kept = slice(SKIPPED, len(shear) - SKIPPED)
        slides.append(
            Recorded(
                name=f"{seed} {k}", signal=shear[kept].astype(np.float64), sample_rate=RATE,
                quantity="displacement",
                speed=speed * (1 + wander * np.sin(turn * time + k))[kept],
            )
        )  # fmt: skip
    return slides


def fitted(slides: Sequence[Recorded]) -> Descriptor:
    """Return the descriptor that a fit makes of recordings."""
    return describe(measure_slides(slides), ABOUT).descriptor


def measure_ribs() -> Iterator[Figure]:
    """Measure how well ribs are fitted, and false alarms."""
    yield from _ribs()
    alarms = [
        bool(fitted(strokes_at(noise_under((), *kind), seed, WANDERS[1])).modulation)
        for kind in RANDOM
        for seed in range(SURFACES)
    ]
    yield at_most("fit.ribs.alarms_on_noise", float(np.mean(alarms)), f"of {len(alarms)}", 0.05)
    folder = recordings()
    if folder is not None:
        alarms = list(recorded_alarms(folder))
        share = float(np.mean(alarms))
        yield at_most("fit.ribs.alarms_on_recordings", share, f"of {len(alarms)}", 0.05)


def _ribs() -> Iterator[Figure]:
    """Yield the share of ribs that a fit finds alone, and errors of their wavelength and depth.

    The fitted texture is rendered and fitted again, and compared with itself.
    """
    found, errors, again = [], [], []
    for seed, (length, depth, wander) in enumerate(product(WAVELENGTHS_MM, DEPTHS, WANDERS)):
        table = Modulation(wavelength_mm=length, depth=depth)
        texture = noise_under((table,), 0.2, 1.0, 0.1)
        descriptor = fitted(strokes_at(texture, seed, wander))
        found.append([abs(m.wavelength_mm / length - 1) < 0.01 for m in descriptor.modulation])
        if found[-1] != [True]:
            continue
        first = descriptor.modulation[0]
        errors.append(differences(first, table))
        second = fitted(strokes_at(texture_of(descriptor), seed, wander)).modulation
        again.append(differences(second[0], first) if len(second) == 1 else (1.0, 1.0))
    share = float(np.mean([one == [True] for one in found]))
    yield at_least("fit.ribs.found", share, f"of {len(found)}", 0.95)
    for name, rows in (("", errors), ("again_", again)):
        length, depth = np.abs(rows).max(axis=0)
        yield at_most(f"fit.ribs.{name}wavelength", float(length), "relative", 0.01)
        yield at_most(f"fit.ribs.{name}depth", float(depth), "", 0.1)


def differences(fitted_one: Modulation, known: Modulation) -> tuple[float, float]:
    """Return the relative difference of the wavelengths of two envelopes, and that of depths."""
    return fitted_one.wavelength_mm / known.wavelength_mm - 1, fitted_one.depth - known.depth


def recorded_alarms(folder: Path) -> Iterator[bool]:
    """Yield whether fits of recordings, in which nothing moves as ribs do, have any."""
    for name in FABRIC_NAMES:
        slides = [fabric(folder, name, key) for key in FABRICS]
        for count in (2, 3, 4):
            for chosen in combinations(slides, count):
                yield bool(fitted(chosen).modulation)
    rng = np.random.default_rng(0)
    for slides in biotac_slides(folder).values():
        for _ in range(DRAWS):
            drawn = BIOTAC_SPEED * SPAN ** rng.uniform(0, 1, len(slides))
            pretended = [
                replace(slide, speed=np.full(len(slide.speed), speed))
                for slide, speed in zip(slides, drawn, strict=True)
            ]
            yield bool(measure_slides(pretended).modulations)
