"""Travel: how far a tip that loses the finger swings, with and without the limit in the host.

The tips are those of the plants in time, which share no code with the model of the limiter.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.rendering import first_contactors, played_shear
from benchmarks.sensing_guard import DISPLACEMENT, LOSS, TONE
from tactile.actuator.finger import FingerLoad
from tactile.actuator.touch import Touch
from tactile.actuator.touched_plant import TouchedPlant
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_most, seconds
from tactile.display.display import Display, load_display
from tactile.rendering.renderer import Renderer, limiter_of
from tactile.texture.descriptor import textures
from tactile.texture.surface import load_texture

RESONANCE = 930.0
"""First resonance of the default design in air [Hz]."""
TONES = (500.0, 600.0, 700.0, 800.0, 900.0, 960.0, 1000.0)
"""Tones beside the resonance that play as loud as the limits allow [Hz]."""
MOMENTS = 8
"""Number of moments within a period at which the finger begins to leave."""
LIFT = 0.4
"""Time of the first of these [s]."""
PLAYED = 1.0
"""Length of each tone and of each stroke of a texture [s]."""
BLOCK = 64
"""Length of the blocks that are timed [samples]."""


def tone(frequency: float, amplitude: float) -> Floats:
    """Return a tone (S, 1) [V]."""
    time = np.arange(round(PLAYED * RATE)) / RATE
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency * time)[:, None])


def limited(display: Display, volts: Floats) -> Floats:
    """Return the drive that the limiter of a display puts out, with its delay."""
    return limiter_of(display, RATE)(volts)


def lift_off(display: Display, volts: Floats, frequency: float) -> float:
    """Return the largest travel of a tip that loses a stiff finger at any part of a period [m]."""
    begin = LIFT + np.arange(MOMENTS) / (MOMENTS * frequency)

    def force(time: Floats) -> Floats:
        """Return the normal force (S, N) [N]."""
        return np.clip(1 - (time[:, None] - begin) / LOSS, 0, 1)

    touch = Touch(load=FingerLoad.high(), force=force)
    plant = TouchedPlant(display.bimorph, touch, RATE, contactors=MOMENTS)
    return float(np.abs(plant.step(np.repeat(volts, MOMENTS, axis=1))[0]).max())


def measure_travel() -> Iterator[Figure]:
    """Measure the travel of free tips with and without the limit, and what the limit costs."""
    display = first_contactors(load_display("reference-24", load=FingerLoad.high()), 1)
    most = display.actuator.largest_travel
    yield Figure("travel, that a free tip of the default design survives", 1e6 * most, "µm")
    full = tone(RESONANCE, display.limits.voltage)
    for name, drive in (("", limited(display, full)), (", without the limit", full)):
        travel = float(np.abs(played_shear(display, drive, FingerLoad.none())).max())
        bound = None if name else 1.01 * 1e6 * most
        yield at_most(f"travel, 100 V at 930 Hz in air{name}", 1e6 * travel, "µm", bound)
    response = np.abs(display.responses(np.array([TONE]), RATE))[0, 0, 0]
    wanted = tone(TONE, DISPLACEMENT / response)
    for name, drive in (("", limited(display, wanted)), (", without the limit", wanted)):
        travel = lift_off(display, drive, TONE)
        name = f"travel, 2 µm at 920 Hz under a high finger, at lift-off{name}"
        yield Figure(name, 1e6 * travel, "µm")
    loudest = [
        lift_off(display, limited(display, tone(f, display.limits.voltage)), f) for f in TONES
    ]
    name = "travel, loudest tones at 500–1000 Hz, at lift-off, re what is survived"
    yield Figure(name, max(loudest) / most, "×")
    yield from _library()
    yield from _cost()


def _library() -> Iterator[Figure]:
    """Yield the number of shipped textures that the limit changes at gain 1."""
    for finger in ("low", "high"):
        display = load_display("reference-24", load=getattr(FingerLoad, finger)())
        for speed in (0.08, 0.2):
            changed = 0
            for name in textures():
                texture = load_texture(name)
                place = np.outer(np.arange(round(PLAYED * RATE)) * speed / RATE, [1.0, 0.0])
                force = np.full(len(place), 0.5)
                plain, bounded = Renderer(display, texture), Renderer(display, texture)
                plain.limiter.leave_travel(np.ones(24, np.bool_))
                drive = plain.block(place, force)
                changed += not np.array_equal(drive, bounded.block(place, force))
            case = f"{finger} finger, {1e3 * speed:g} mm/s"
            limit = 0 if speed < 0.1 else None
            yield at_most(f"travel, textures that it changes, {case}", changed, "", limit)


def _cost() -> Iterator[Figure]:
    """Yield the duration of the limiter for a block of 24 contactors."""
    display = load_display("reference-24")
    cases = {"quiet": 5.0, "60 V at 250 Hz": 60.0, "turned down": 100.0}
    for case, amplitude in cases.items():
        volts = tone(RESONANCE if case == "turned down" else 250.0, amplitude)
        volts = volts * np.linspace(0.5, 1, 24)
        for guarded in (False, True):
            limiter = limiter_of(display, RATE)
            limiter.leave_travel(np.full(24, guarded))

            def play(limiter=limiter, volts=volts) -> None:  # type: ignore[no-untyped-def]
                """Limit a tone in blocks."""
                for k in range(0, len(volts), BLOCK):
                    limiter(volts[k : k + BLOCK])

            duration = 1e6 * seconds(play, 5) * BLOCK / len(volts)
            name = f"travel, limiter of 24 contactors, 64 samples, {case}"
            yield Figure(f"{name}, without the limit" if guarded else name, duration, "µs")
