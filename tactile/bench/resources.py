"""Benchmarks of a host: rendering speed, memory of a long play, and lateness of a loop."""

import math
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tactile.bench.figures import (
    RATE,
    Figure,
    at_least,
    at_most,
    beside_machine,
    not_measured,
    seconds,
)
from tactile.clock import MONOTONIC, Clock
from tactile.display.display import Display, load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.descriptor import textures
from tactile.texture.surface import Texture, load_texture


def _grid(count: int) -> Display:
    """Return a square display with that many contactors."""
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
    """Measure how many times faster than real time a stroke at 80 mm/s is rendered.

    Parameters
    ----------
    display : Display
        Display to render for.
    texture : Texture
        Texture to render.
    block : int
        Block size [samples].
    shear : bool
        Whether the commanded shear is computed as well.

    Returns
    -------
    float
        Duration of the stroke divided by the time to render it.
    """
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
    """Time rendering on one core at 8 kHz, limiter included, drive alone.

    The plain surface consists of a field, a few waves and the laws of speed and force. The shipped
    textures have an envelope, and some of them sparse events or a grating; the goal is for the
    slowest of them.

    Yields
    ------
    Figure
        Speed of rendering relative to real time [×].
    """
    from msgspec.structs import replace as changed

    suede = load_texture("leather-calf")
    assert suede.descriptor.stochastic is not None
    without_envelope = changed(suede.descriptor.stochastic, am_depth=0.0, excess_kurtosis=0.0)
    plain = replace(suede, descriptor=changed(suede.descriptor, stochastic=without_envelope))
    grid_64, grid_1024 = _grid(64), _grid(1024)
    yield from _slowest_texture(grid_64)
    yield Figure("speed.64.blocks_of_64", times_real(grid_64, plain, 64, shear=False), "×")
    yield at_least("speed.64.blocks_of_16", times_real(grid_64, plain, 16, shear=False), "×", 20)
    yield at_least("speed.64.with_shear", times_real(grid_64, plain, 64, shear=True), "×", 15)
    yield at_least("speed.1024.blocks_of_64", times_real(grid_1024, plain, 64, shear=False), "×", 2)
    yield Figure("speed.1024.blocks_of_16", times_real(grid_1024, plain, 16, shear=False), "×")


def _slowest_texture(display: Display) -> Iterator[Figure]:
    """Yield the speed of the slowest shipped texture in blocks of 64, its name, and the median."""
    speeds = {name: times_real(display, load_texture(name), 64, shear=False) for name in textures()}
    slowest = min(speeds, key=speeds.__getitem__)
    yield at_least("speed.64.blocks_of_64.slowest", speeds[slowest], "×", 30)
    yield Figure(f"speed.64.blocks_of_64.slowest_is.{slowest}", speeds[slowest], "×")
    yield Figure("speed.64.blocks_of_64.median", float(np.median(list(speeds.values()))), "×")


def measure_memory(longest: int = 60) -> Iterator[Figure]:
    """Compare the resident memory of a long play with that of a play of 10 s.

    Parameters
    ----------
    longest : int
        Duration of the long play [s].

    Yields
    ------
    Figure
        Peak memory of the short play, and how much more the long one takes [MiB].
    """
    if sys.platform == "win32":
        yield not_measured("memory", "needs accounting of finished processes, which Windows lacks")
        return
    peaks = []
    for length in (10, longest):
        command = [sys.executable, "-m", "tactile", "play", "wood-oak"]
        command += ["--seconds", str(length), "--quiet"]
        peaks.append(peak_memory(command) / 2**20)
    yield Figure("memory.play_10_s", peaks[0], "MiB")
    yield at_most(f"memory.growth_10_to_{longest}_s", peaks[1] - peaks[0], "MiB", 2)


def measure_jitter(duration: float = 10.0, clock: Clock = MONOTONIC) -> Iterator[Figure]:
    """Measure how late a bare loop on each processor wakes for blocks of 2 ms.

    Parameters
    ----------
    duration : float
        Duration of the measurement [s].
    clock : Clock
        Clock that waits for its end.

    Yields
    ------
    Figure
        Percentiles of the lateness [ms], and how many of 10 000 blocks would be lost at each lead
        time that a link may have.
    """

    def wait() -> Iterator[Figure]:
        clock.sleep(duration)
        yield from ()

    yield from beside_machine("jitter", wait())


def peak_memory(command: list[str]) -> int:
    """Run a command and measure its peak resident memory.

    Parameters
    ----------
    command : list of str
        Command with its arguments.

    Returns
    -------
    int
        Peak resident memory [bytes].

    Raises
    ------
    subprocess.CalledProcessError
        If the command fails.
    """
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return resident_bytes(usage.ru_maxrss)


def resident_bytes(max_rss: int) -> int:
    """Convert ``ru_maxrss`` of a system's accounting to bytes.

    Parameters
    ----------
    max_rss : int
        Value of ``ru_maxrss``, which is in bytes on macOS and in KiB elsewhere.

    Returns
    -------
    int
        Memory [bytes].
    """
    return max_rss * (1 if sys.platform == "darwin" else 1024)
