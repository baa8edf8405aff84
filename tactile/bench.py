"""Every figure that the project promises, measured: accuracy, fidelity, speed and memory.

Each benchmark is a function that returns figures; a figure has a goal, or none where it is there to
compare with. Where another library does the same work it is measured in the same run. BLAS is held
to one thread.
"""

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.linalg import expm
from scipy.signal import dlsim
from threadpoolctl import threadpool_limits

from tactile.actuator.bimorph import Bimorph, active_segment, transfer_matrix
from tactile.actuator.finger import FingerLoad
from tactile.actuator.plant import Plant
from tactile.actuator.response import tip_response
from tactile.display import Display, load_display
from tactile.rendering import equalizer
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer, Rendering, render
from tactile.sim import Fidelity
from tactile.texture.descriptor import Descriptor, Laws, Periodic, textures
from tactile.texture.surface import Texture, band_levels, load_texture

Floats = NDArray[np.float64]

RATE = 8000.0
FINGERS = {"low": FingerLoad.low, "high": FingerLoad.high}
GRATING = 1e-3
"""m, the wavelength that is moved faster and faster."""


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes
    ----------
    name, value, unit : what was measured
    goal : as text; empty where there is none
    reached : None where there is no goal
    """

    name: str
    value: float
    unit: str
    goal: str = ""
    reached: bool | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


def at_most(name: str, value: float, unit: str, limit: float) -> Figure:
    """Return a figure that must not exceed a limit."""
    return Figure(name, value, unit, f"≤ {limit:g}", bool(value <= limit))


def at_least(name: str, value: float, unit: str, limit: float) -> Figure:
    """Return a figure that must reach a limit."""
    return Figure(name, value, unit, f"≥ {limit:g}", bool(value >= limit))


def seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Return the shortest of several timings [s]."""
    work()
    found = math.inf
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        found = min(found, time.perf_counter() - begun)
    return found


def _first_order(bimorph: Bimorph, omega: float, axial_force: float) -> NDArray[np.complex128]:
    """Return the beam's equations as x' = A x, x = (v, ψ̇, M, F, U, I)."""
    s = active_segment(bimorph)
    EI, AG, K = complex(s.section.EI), complex(s.section.AG), complex(s.coupling)
    A = np.zeros((6, 6), np.complex128)
    jw = 1j * omega
    A[0, 1], A[0, 3] = -1, jw / AG
    A[1, 2], A[1, 4] = jw / EI, jw * K / EI
    A[2, 3], A[2, 1] = 1, (axial_force - float(s.section.rhoI) * omega**2) / jw
    A[3, 0] = -float(s.section.m) * omega**2 / jw
    A[5, :] = K * A[1, :]
    A[5, 4] += jw * complex(s.capacitance) / float(s.length)
    return A


def measure_matrix() -> Iterator[Figure]:
    """Compare the transfer matrix with scipy's matrix exponential."""
    worst = 0.0
    for length in (5e-3, 20e-3, 45e-3):
        bimorph = Bimorph(length=length)
        unit = np.sqrt(float(np.abs(active_segment(bimorph).section.EI)))
        for force in (-5.0, 0.0, 5.0):
            for f in np.geomspace(0.1, 60e3, 25):
                ours = transfer_matrix(active_segment(bimorph), [f], axial_force=force)[0]
                A = _first_order(bimorph, 2 * np.pi * f, force) * length
                scale = _scales(A, unit)
                theirs = expm(A / scale[:, None] * scale)
                keep = [0, 1, 2, 3, 4], [0, 1, 2, 3, 5]
                theirs = theirs[np.ix_(keep[1], keep[0])]
                mine = ours / scale[keep[1]][:, None] * scale[keep[0]]
                worst = max(worst, float(np.linalg.norm(mine - theirs) / np.linalg.norm(theirs)))
    yield at_most("matrix.error_against_exponential", worst, "relative", 1e-9)
    segment, f = active_segment(Bimorph()), np.geomspace(1, 5000, 2000)
    generators = np.array([_first_order(Bimorph(), 2 * np.pi * x, 0.0) for x in f]) * 20e-3
    yield Figure(
        "matrix.speed_over_scipy_expm",
        seconds(lambda: expm(generators), 2) / seconds(lambda: transfer_matrix(segment, f)),
        "×",
    )


def _scales(A: NDArray[np.complex128], unit: float) -> Floats:
    """Return scales of the state that balance a matrix: rows and columns of like size."""
    scale = np.ones(len(A))
    size = np.abs(A) + np.abs(A).max() * 1e-300
    for _ in range(50):
        rows = (size / scale[:, None] * scale).sum(axis=1)
        columns = (size / scale[:, None] * scale).sum(axis=0)
        ok = (rows > 0) & (columns > 0) & (rows > 1e-200) & (columns > 1e-200)
        scale[ok] *= np.sqrt(rows[ok] / columns[ok])
    return scale


def measure_response() -> Iterator[Figure]:
    """Time the loaded response."""
    f = np.linspace(1, 5000, 20_000)
    taken = seconds(lambda: tip_response(Bimorph(), FingerLoad.low(), f))
    yield at_least("response.points_per_second", len(f) / taken, "1/s", 500_000)
    lengths = Bimorph(length=np.linspace(8e-3, 30e-3, 40))
    taken = seconds(lambda: tip_response(lengths, FingerLoad.low(), f[:500]))
    yield at_least("response.designs_points_per_second", 40 * 500 / taken, "1/s", 500_000)


def felt(display: Display, drive: Floats, load: FingerLoad | None = None) -> Floats:
    """Return the skin's shear (S, N) [m] for a drive, through the plant, its delay taken off."""
    finger = display.load_at(1.0) if load is None else load
    plant = Plant(display.bimorph, finger, RATE, contactors=drive.shape[1])
    rest = np.zeros((plant.delay, drive.shape[1]))
    return plant.step(np.concatenate([drive, rest]))[0][plant.delay :]


def grating_texture(amplitude_um: float) -> Texture:
    """Return a sinusoidal grating of 1 mm wavelength, without laws."""
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
        band_frequency=none, band_error_db=none,
    )  # fmt: skip


def one_contactor(load: FingerLoad) -> Display:
    """Return a display of one contactor under a finger."""
    whole = load_display("reference-24", load=load)
    return replace(
        whole, contactors=whole.contactors[:1], shear_direction=whole.shear_direction[:1],
        polarity=whole.polarity[:1], channel=np.zeros(1, np.intp), kind=whole.kind[:1],
    )  # fmt: skip


def transfer(display: Display, frequency: float, finger: FingerLoad, *, equalize: bool) -> complex:
    """Return played over commanded shear of the grating moved to give a frequency [Hz]."""
    stroke = Trajectory.line(speed=frequency * GRATING, duration=0.3 + 4 / frequency)
    r = render(display, grating_texture(5.0), stroke)
    drive = r.drive if equalize else r.shear / _static(display)
    played = felt(display, drive, finger)[:, 0]
    late = r.time > r.time[-1] - 3 / frequency
    turn = np.exp(-2j * np.pi * frequency * r.time[late])
    window = np.hanning(late.sum())
    return complex((played[late] * turn * window).sum() / (r.shear[late, 0] * turn * window).sum())


def _static(display: Display) -> float:
    """Return the shear per volt at rest [m/V]: what a display without equalizer goes by."""
    return float(np.abs(display.responses(np.zeros(1), RATE)[0, 0, 0]))


def measure_grating() -> Iterator[Figure]:
    """Move a grating so that it gives 10 … 1000 Hz, through the time-domain plant."""
    tones = np.geomspace(10, 1000, 25)
    for name, other in (("low", "high"), ("high", "low")):
        display, finger = one_contactor(FINGERS[name]()), FINGERS[name]()
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
            if case == "equalized":
                yield at_most(f"grating.{name}.{case}.level", worst_db, "dB", 0.1)
                yield at_most(f"grating.{name}.{case}.phase", worst_deg, "deg", 1.0)
            else:
                yield Figure(f"grating.{name}.{case}.level", worst_db, "dB")
                yield Figure(f"grating.{name}.{case}.phase", worst_deg, "deg")


def swing(acceleration: float = 1.0, duration: float = 4.0) -> Trajectory:
    """Return a path that starts, stops and turns: 1 Hz back and forth, peak 1 m/s²."""
    t = np.arange(0, duration, 1e-3)
    x = acceleration / (2 * np.pi) ** 2 * np.sin(2 * np.pi * t)
    return Trajectory(t, np.column_stack([x, 0 * x]), 0.5)


def ratio_db(commanded: Floats, played: Floats, skip: int = 800) -> float:
    """Return the signal-to-error ratio in 20–1000 Hz [dB], the first 0.1 s left out."""
    judge = Fidelity(RATE)
    judge.add(commanded[skip:], played[skip:])
    return judge.signal_to_error_db


def quasi_static(display: Display, texture: Texture, r: Rendering) -> Floats:
    """Return the drive of the other way to equalize: G(f_m) on each partial, as it sounds now.

    Exact for a steady stroke; laws, envelope and acceleration do not commute with it. Kept to
    measure the FIR inverse against; waves only.
    """
    surface = texture.realize()
    p = surface.partials
    velocity = np.gradient(r.position, 1 / RATE, axis=0)
    frequency = np.arange(0, equalizer.STOP_BAND + 1)
    gain = equalizer.inverse(
        display.responses(frequency, RATE)[0, 0], display.limits.voltage
    ) * equalizer.roll_off(frequency)
    signed = velocity @ p.wave_vector.T / (2 * np.pi)
    table = np.interp(np.abs(signed), frequency, gain.real) + 1j * np.sign(signed) * np.interp(
        np.abs(signed), frequency, gain.imag
    )
    turn = np.exp(1j * (r.position @ p.wave_vector.T)) * table
    place = p.amplitude[:, None] * np.exp(
        1j * (p.wave_vector @ display.contactors.T + p.phase[:, None])
    )
    waves = (turn @ place).real
    plain = r.position[:, None] + display.contactors
    envelope = np.exp(surface.envelope.at(plain) - (surface.envelope.amplitude**2).sum() / 2)
    return np.asarray(waves * envelope * _law_of(texture, velocity))


def _law_of(texture: Texture, velocity: Floats) -> Floats:
    from tactile.rendering.shear import Law

    squares = (velocity**2).sum(axis=1)
    return Law(texture.descriptor)(squares, np.full(len(squares), 0.5))[:, None]


def measure_wood() -> Iterator[Figure]:
    """Play a wood under acceleration, stop and reversal, through the time-domain plant."""
    texture, path = load_texture("wood-oak"), swing()
    for name, other in (("low", "high"), ("high", "low")):
        finger = FINGERS[name]()
        display = load_display("reference-24", load=finger)
        r = render(display, texture, path)
        played = felt(display, r.drive)
        yield at_least(f"wood.{name}.equalized", ratio_db(r.shear, played), "dB", 40)
        plain = felt(display, r.shear / _static(display))
        yield Figure(f"wood.{name}.not_equalized", ratio_db(r.shear, plain), "dB")
        foreign = felt(display, r.drive, FINGERS[other]())
        yield Figure(f"wood.{name}.on_{other}_finger", ratio_db(r.shear, foreign), "dB")
        air = felt(display, r.drive, FingerLoad.none())
        yield Figure(f"wood.{name}.in_air", ratio_db(r.shear, air), "dB")
        waves = replace(texture, descriptor=_without_events(texture.descriptor))
        r = render(display, waves, path)
        spectral = felt(display, quasi_static(display, waves, r))
        yield Figure(f"wood.{name}.quasi_static_inverse_instead", ratio_db(r.shear, spectral), "dB")


def _without_events(descriptor: Descriptor) -> Descriptor:
    from msgspec.structs import replace as changed

    return changed(descriptor, events=())


def measure_bands() -> Iterator[Figure]:
    """Compare line spectra of the realized surfaces with their descriptors."""
    for name in textures():
        t = load_texture(name)
        s = t.descriptor.stochastic
        if s is None:
            continue
        isotropic = s.direction_spread_deg is None
        turn = np.arange(36) * np.pi / 36 if isotropic else np.radians([s.direction_deg])
        error = band_levels(t.wave_vector, t.amplitude, s, turn) - np.asarray(s.level_db)
        kind = "36_directions" if isotropic else "along_reference"
        rms, worst = float(np.sqrt((error**2).mean())), float(np.abs(error).max())
        yield at_most(f"bands.{name}.{kind}.rms", rms, "dB", 1.0)
        yield at_most(f"bands.{name}.{kind}.worst", worst, "dB", 2.5)


def _streamed(texture: Texture, place: Floats, sizes: int = 64) -> tuple[Floats, Floats]:
    """Return drive and shear of one path of places along x, the delay taken off."""
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
    """See that the same place gives the same shear, and that block size changes nothing."""
    texture = load_texture("wood-oak")
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
        level = 10 * np.log10(np.mean((other - whole) ** 2) / np.mean(whole**2))
        yield at_most(f"place.blocks_of_{size}_against_64", float(level), "dB", -60)


def _grid(count: int) -> Display:
    """Return a square display of many contactors."""
    side = round(math.sqrt(count))
    base = load_display("reference-64")
    at = (np.arange(side) - (side - 1) / 2) * 3e-3
    places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    none = np.zeros(count, np.intp)
    return replace(
        base, contactors=places, shear_direction=np.zeros(count), polarity=np.ones(count),
        channel=np.arange(count), kind=none,
    )  # fmt: skip


def times_real(display: Display, texture: Texture, block: int, *, shear: bool) -> float:
    """Return how many times faster than real time a stroke at 80 mm/s is rendered."""
    blocks = list(Trajectory.line(speed=0.08, duration=1.0).blocks(RATE, block))
    renderer = Renderer(display, texture)

    def stroke() -> None:
        for position, force in blocks:
            if shear:
                renderer.block(position, force, shear=True)
            else:
                renderer.block(position, force)

    return 1 / seconds(stroke, 7)


def measure_speed() -> Iterator[Figure]:
    """Time rendering on one core, limiter included: 384 partials at 8 kHz, drive alone.

    The plain surface is waves and laws; the textures as shipped have an envelope, and two of them
    sparse events.
    """
    from msgspec.structs import replace as changed

    suede = load_texture("leather-calf")
    assert suede.descriptor.stochastic is not None
    even = changed(suede.descriptor.stochastic, am_depth=0.0, excess_kurtosis=0.0)
    plain = replace(suede, descriptor=changed(suede.descriptor, stochastic=even))
    many, more = _grid(64), _grid(1024)
    yield at_least("speed.64.blocks_of_64", times_real(many, plain, 64, shear=False), "×", 30)
    yield at_least("speed.64.blocks_of_16", times_real(many, plain, 16, shear=False), "×", 20)
    yield at_least("speed.64.with_shear", times_real(many, plain, 64, shear=True), "×", 15)
    yield at_least("speed.1024.blocks_of_64", times_real(more, plain, 64, shear=False), "×", 2)
    yield Figure("speed.1024.blocks_of_16", times_real(more, plain, 16, shear=False), "×")
    for name in textures():
        as_shipped = times_real(many, load_texture(name), 64, shear=False)
        yield Figure(f"speed.64.blocks_of_64.{name}", as_shipped, "×")


def measure_plant() -> Iterator[Figure]:
    """Time the plant beside scipy's simulation of the same system."""
    ours = Plant(Bimorph(), FingerLoad.low(), RATE, contactors=24)
    drive = np.random.default_rng(0).standard_normal((8000, 24))
    yield Figure("plant.24.times_real_time", 1 / seconds(lambda: ours.step(drive)), "×")
    s = ours.system
    theirs = (expm(s.A / RATE), s.B[:, None] / RATE, s.C_u[None], np.zeros((1, 1)), 1 / RATE)
    one = drive[:, :1]
    taken = seconds(lambda: dlsim(theirs, one), 2)
    yield Figure("plant.1.times_real_time_of_scipy_dlsim", 1 / taken, "×")


def measure_memory(longest: int = 60) -> Iterator[Figure]:
    """Compare resident memory of a long play with that of 10 s."""
    if sys.platform == "win32":  # no accounting of a finished process there
        return
    peaks = []
    for length in (10, longest):
        command = [sys.executable, "-m", "tactile", "play", "wood-oak"]
        command += ["--seconds", str(length), "--quiet"]
        peaks.append(_peak_memory(command) / 2**20)
    yield Figure("memory.play_10_s", peaks[0], "MiB")
    yield at_most(f"memory.growth_10_to_{longest}_s", peaks[1] - peaks[0], "MiB", 2)


def measure_soak() -> Iterator[Figure]:
    """Compare resident memory of ten minutes of play with that of 10 s."""
    yield from measure_memory(600)


def _peak_memory(command: list[str]) -> int:
    """Run a command and return the most memory it had resident [bytes]."""
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


BENCHMARKS: dict[str, Callable[[], Iterator[Figure]]] = {
    "matrix": measure_matrix,
    "response": measure_response,
    "grating": measure_grating,
    "wood": measure_wood,
    "bands": measure_bands,
    "place": measure_place,
    "speed": measure_speed,
    "plant": measure_plant,
    "memory": measure_memory,
}
LONG: dict[str, Callable[[], Iterator[Figure]]] = {"soak": measure_soak}
"""Those that take minutes."""


def measure(names: list[str]) -> list[Figure]:
    """Run benchmarks, with a progress bar on a terminal, and return their figures."""
    figures: list[Figure] = []
    known = BENCHMARKS | LONG
    with threadpool_limits(1):
        for name in track(names, "measuring", transient=True, disable=not sys.stdout.isatty()):
            figures.extend(known[name]())
    return figures
