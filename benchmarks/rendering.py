"""Rendering: the skin's shear compared with the commanded one, through the time-domain plant."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as changed

from tactile.actuator.finger import FingerLoad
from tactile.actuator.plant import Plant
from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most
from tactile.display.display import Display, load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer, render
from tactile.sim import Fidelity
from tactile.texture.descriptor import Descriptor, Laws, Periodic, textures
from tactile.texture.surface import Surface, Texture, load_texture, without_friction

FINGERS = {"low": FingerLoad.low, "high": FingerLoad.high}
"""The paper's two finger loads, by name."""
GRATING = 1e-3
"""Wavelength of the grating that is moved at increasing speed [m]."""
SKIPPED = 800
"""Number of samples until a played stroke has faded in and filters have settled."""


def played_shear(display: Display, drive: Floats, load: FingerLoad | None = None) -> Floats:
    """Return the skin's shear for a drive, through the time-domain plant, with its delay removed.

    Parameters
    ----------
    display : Display
        Display whose benders and load are taken.
    drive : (S, N) array of float
        Drive at `RATE` [V].
    load : FingerLoad, optional
        Load on all contactors; the display's own by default.

    Returns
    -------
    (S, N) array of float
        Shear [m].
    """
    finger = display.load_at(1.0) if load is None else load
    plant = Plant(display.bimorph, finger, RATE, contactors=drive.shape[1])
    rest = np.zeros((plant.delay, drive.shape[1]))
    return plant.step(np.concatenate([drive, rest]))[0][plant.delay :]


def grating_texture(amplitude_um: float) -> Texture:
    """Return a sinusoidal grating of 1 mm wavelength, whose amplitude depends on nothing.

    Parameters
    ----------
    amplitude_um : float
        Amplitude of the shear [µm].

    Returns
    -------
    Texture
        Grating along x.
    """
    oak = load_texture("wood-oak")
    grating = Periodic(wavelength_mm=GRATING * 1e3, harmonics_um=(amplitude_um,))
    bare = Descriptor(
        texture=oak.descriptor.texture,
        reference=oak.descriptor.reference,
        periodic=(grating,),
        laws=Laws(),
    )
    none = np.zeros(0)
    return replace(
        oak, descriptor=bare, wave_vector=np.zeros((0, 2)), amplitude=none,
        band_frequency=none, band_error_db=none, density=None,
    )  # fmt: skip


def first_contactors(display: Display, count: int) -> Display:
    """Return a display of the first contactors of another one, each with a channel of its own.

    Parameters
    ----------
    display : Display
        Other display.
    count : int
        Number of contactors.

    Returns
    -------
    Display
        Display with ``count`` contactors and channels.
    """
    return replace(
        display, contactors=display.contactors[:count],
        shear_direction=display.shear_direction[:count], polarity=display.polarity[:count],
        channel=np.arange(count), kind=display.kind[:count],
    )  # fmt: skip


def transfer(display: Display, frequency: float, finger: FingerLoad, *, equalize: bool) -> complex:
    """Return the ratio of played to commanded shear of the grating at a frequency.

    Parameters
    ----------
    display : Display
        Display whose equalizer is measured.
    frequency : float
        Frequency at which the finger meets the waves of the grating [Hz].
    finger : FingerLoad
        Finger on which the drive is played.
    equalize : bool
        Whether the display's equalizer makes the drive; if not, it is the commanded shear over the
        static shear per volt.

    Returns
    -------
    complex
        Ratio of the first contactor's amplitudes over the last three periods.
    """
    stroke = Trajectory.line(speed=frequency * GRATING, duration=0.3 + 4 / frequency)
    r = render(display, grating_texture(0.2), stroke)  # the limiter leaves it as it is
    drive = r.drive if equalize else r.shear / _static(display)
    played = played_shear(display, drive, finger)[:, 0]
    late = r.time > r.time[-1] - 3 / frequency
    turn = np.exp(-2j * np.pi * frequency * r.time[late])
    window = np.hanning(late.sum())
    return complex((played[late] * turn * window).sum() / (r.shear[late, 0] * turn * window).sum())


def _static(display: Display) -> float:
    """Return the static shear per volt, which a display without equalizer uses [m/V]."""
    return float(np.abs(display.responses(np.zeros(1), RATE)[0, 0, 0]))


def measure_grating() -> Iterator[Figure]:
    """Measure the transfer of a grating at 10 … 1000 Hz, through the time-domain plant."""
    tones = np.geomspace(10, 1000, 25)
    for name, other in (("low", "high"), ("high", "low")):
        finger = FINGERS[name]()
        display = first_contactors(load_display("reference-24", load=finger), 1)
        cases = {
            "equalized": (finger, True),
            "not_equalized": (finger, False),
            f"on_{other}_finger": (FINGERS[other](), True),
            "in_air": (FingerLoad.none(), True),
        }
        for case, (on, equalize) in cases.items():
            ratio = np.array([transfer(display, f, on, equalize=equalize) for f in tones])
            level, angle = 20 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
            worst_db, worst_deg = float(np.abs(level).max()), float(np.abs(angle).max())
            limits = (0.1, 1.0) if case == "equalized" else (None, None)
            yield at_most(f"grating.{name}.{case}.level", worst_db, "dB", limits[0])
            yield at_most(f"grating.{name}.{case}.phase", worst_deg, "deg", limits[1])


def swing() -> Trajectory:
    """Return a path of 4 s that starts, stops and turns: 1 Hz, 1 m/s² at the peak."""
    t = np.arange(0, 4.0, 1e-3)
    x = np.sin(2 * np.pi * t) / (2 * np.pi) ** 2
    return Trajectory(t, np.column_stack([x, 0 * x]), 0.5)


def ratio_db(commanded: Floats, played: Floats) -> float:
    """Return the signal-to-error ratio in 20–1000 Hz, without the first `SKIPPED` samples.

    Parameters
    ----------
    commanded : (S, N) array of float
        Commanded shear at `RATE` [m].
    played : (S, N) array of float
        Shear of the skin [m].

    Returns
    -------
    float
        Ratio [dB].
    """
    judge = Fidelity(RATE)
    judge.add(commanded[SKIPPED:], played[SKIPPED:])
    return judge.signal_to_error_db


def measure_wood() -> Iterator[Figure]:
    """Measure wood under acceleration, stop and reversal, through the time-domain plant."""
    texture, path = load_texture("wood-oak"), swing()
    for name, other in (("low", "high"), ("high", "low")):
        finger = FINGERS[name]()
        display = load_display("reference-24", load=finger)
        r = render(display, texture, path)
        played = played_shear(display, r.drive)
        yield at_least(f"wood.{name}.equalized", ratio_db(r.shear, played), "dB", 40)
        plain = played_shear(display, r.shear / _static(display))
        yield Figure(f"wood.{name}.not_equalized", ratio_db(r.shear, plain), "dB")
        foreign = played_shear(display, r.drive, FINGERS[other]())
        yield Figure(f"wood.{name}.on_{other}_finger", ratio_db(r.shear, foreign), "dB")
        air = played_shear(display, r.drive, FingerLoad.none())
        yield Figure(f"wood.{name}.in_air", ratio_db(r.shear, air), "dB")


def without_events(descriptor: Descriptor) -> Descriptor:
    """Return a descriptor whose textures have no events, such as pores, but only waves.

    Parameters
    ----------
    descriptor : Descriptor
        Descriptor that may have events.

    Returns
    -------
    Descriptor
        The same without them.
    """
    return changed(descriptor, events=())


def stroke_levels(surface: Surface, turn: float, length: float = 1.0) -> Floats:
    """Return the levels of all bands along a stroke over the random part of a surface.

    Parameters
    ----------
    surface : Surface
        Realized surface that has a random part.
    turn : float
        Direction of the stroke, counterclockwise from x [rad].
    length : float
        Length of the stroke [m].

    Returns
    -------
    (B,) array of float
        Mean spectral density in each of B bands [dB re 1 µm²·mm].
    """
    assert surface.density is not None
    edges = surface.density.edges
    step = 0.25 / edges[-1]
    count = round(length / step)
    way = np.outer(step * np.arange(count), [np.cos(turn), np.sin(turn)])
    met = surface.random_part(way)
    window = np.hanning(count)
    power = 2 * np.abs(np.fft.rfft(met * window)) ** 2 * step / np.sum(window**2)
    total = np.histogram(np.fft.rfftfreq(count, step), edges, weights=power)[0] / (count * step)
    return np.asarray(10 * np.log10(total / np.diff(edges) * 1e15))


def measure_bands() -> Iterator[Figure]:
    """Compare strokes over realized surfaces with their descriptors.

    Powers are averaged over six surfaces, which leaves 0.3 dB of chance in a band.
    """
    for name in textures():
        t = load_texture(name)
        s = t.descriptor.stochastic
        if s is None:
            continue
        isotropic = s.direction_spread_deg is None
        turns = np.arange(12) * np.pi / 12 if isotropic else np.radians([s.direction_deg])
        surfaces = [t.realize(seed) for seed in range(6)]
        power = [
            np.mean([10 ** (stroke_levels(one, turn) / 10) for one in surfaces], axis=0)
            for turn in turns
        ]
        error = 10 * np.log10(power) - np.asarray(s.level_db)
        kind = "12_directions" if isotropic else "along_reference"
        rms, worst = float(np.sqrt((error**2).mean())), float(np.abs(error).max())
        yield at_most(f"bands.{name}.{kind}.rms", rms, "dB", 0.5)
        yield at_most(f"bands.{name}.{kind}.worst", worst, "dB", 2.0)


def _streamed(texture: Texture, place: Floats, sizes: int = 64) -> tuple[Floats, Floats]:
    """Return drive and shear for a path of positions along x, with the delay removed."""
    renderer = Renderer(load_display("reference-24"), texture)
    path = np.column_stack([place, 0 * place])
    path = np.concatenate([path, np.repeat(path[-1:], renderer.delay, axis=0)])
    parts = [
        renderer.block(path[k : k + sizes], np.full(len(path[k : k + sizes]), 0.5), shear=True)
        for k in range(0, len(path), sizes)
    ]
    drive = np.concatenate([p[0] for p in parts])[renderer.delay :]
    return drive, np.concatenate([p[1] for p in parts])[renderer.delay :]


def measure_place() -> Iterator[Figure]:
    """Measure that the same place gives the same shear, and that block size has no influence."""
    texture = without_friction(load_texture("wood-oak"))
    n = np.arange(8001)
    _, shear = _streamed(texture, 0.08 / RATE * np.minimum(n, 8000 - n))
    k = np.arange(20, 3980)
    rms = float(np.sqrt(np.mean(shear**2)))
    error = np.sqrt(np.mean((shear[k] - shear[8000 - k]) ** 2))
    yield at_most("place.out_and_back_at_equal_speed", float(error) / rms, "of rms", 1e-6)
    _, shear = _streamed(texture, 0.0127 * np.cos(2 * np.pi * n / RATE))
    rms = float(np.sqrt(np.mean(shear**2)))
    error = np.sqrt(np.mean((shear[k] - shear[8000 - k]) ** 2))
    yield at_most("place.out_and_back_through_a_turn", float(error) / rms, "of rms", 3e-3)
    path = 0.02 * np.sin(2 * np.pi * 1.3 * n / RATE)
    whole, _ = _streamed(texture, path, 64)
    for size in (1, 7, 16, 160):
        other, _ = _streamed(texture, path, size)
        ratio = np.mean((other - whole) ** 2) / np.mean(whole**2)
        level = 10 * np.log10(max(float(ratio), 1e-30))  # equal to the last bit on some processors
        yield at_most(f"place.blocks_of_{size}_against_64", float(level), "dB", -60)
