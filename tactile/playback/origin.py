"""Provenance of a recording: all that its drive was rendered from, and what became of the stroke.

It is stored as one JSON text, which holds the texts of the display and texture files, so that the
recording is rendered again from itself alone.
"""

import math
import platform
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

import msgspec
from threadpoolctl import threadpool_info

from tactile.bus.base import BusCounters
from tactile.display.display import DriveLimits
from tactile.files import SourceFile
from tactile.playback.outcome import Outcome

FORMAT = 1
"""Number of the form of recordings; it grows when older programs cannot read a recording."""
PACKAGES = {"tactile": "tactile-display", "numpy": "numpy", "scipy": "scipy"}
"""Packages that the bits of the drive depend on, by the name that a recording gives them."""


class Sources(msgspec.Struct, frozen=True):
    """Files that a stroke was rendered from.

    Attributes
    ----------
    display : SourceFile
        Display file with its measured responses.
    texture : SourceFile or None
        Texture file; None for an effect, whose shear is the array ``waveform_m``.
    """

    display: SourceFile
    texture: SourceFile | None = None


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """Origin of a recording; the names of numbers carry their units.

    Attributes
    ----------
    format : int
        Number of the form of the recording.
    texture, display : str
        Names of the texture and of the display.
    device : str
        URL of the device.
    gain : float
        Factor on the displacement of the texture or effect.
    seed : int
        Seed of the surface's realization.
    sample_rate_hz : float
        Sample rate of the drive.
    limits : dict of str to float or None
        Limits of the drive, by their keys in a display file; None for no limit.
    versions : dict of str to str
        Versions of the program, of Python and of the libraries that computed the drive.
    sources : Sources or None
        Files that the drive was rendered from; None if a program made display or texture itself.
    outcome : Outcome
        What became of the stroke.
    counters : dict of str to int
        Events that the bus counted, as in `BusCounters`.
    """

    format: int = FORMAT
    texture: str
    display: str
    device: str
    gain: float
    seed: Annotated[int, msgspec.Meta(ge=0)]
    sample_rate_hz: Annotated[float, msgspec.Meta(gt=0)]
    limits: dict[str, float | None]
    versions: dict[str, str]
    sources: Sources | None
    outcome: Outcome = Outcome()
    counters: dict[str, int] = {}


def limits_of(limits: DriveLimits) -> dict[str, float | None]:
    """Return the limits of a drive as a recording holds them.

    Parameters
    ----------
    limits : DriveLimits
        Limits of the drive.

    Returns
    -------
    dict of str to float or None
        Limits by their keys in a display file; None for a current that is not limited.
    """
    return {
        "voltage_v": limits.voltage,
        "slew_v_per_us": limits.slew * 1e-6,
        "current_ma": limits.current * 1e3 if math.isfinite(limits.current) else None,
        "fade_ms": limits.fade * 1e3,
    }


def counts_of(counters: BusCounters) -> dict[str, int]:
    """Return all counters of a bus.

    Parameters
    ----------
    counters : BusCounters
        Counters of the bus, with those of its own kind.

    Returns
    -------
    dict of str to int
        Value of each counter by its name.
    """
    return {field.name: int(getattr(counters, field.name)) for field in fields(counters)}


def present_versions() -> dict[str, str]:
    """Return the versions of all that the bits of the drive depend on.

    Returns
    -------
    dict of str to str
        Versions of tactile, Python, numpy, scipy and the BLAS libraries in use, and the kind of
        processor that these chose their kernels for.
    """
    versions = {name: _version(package) for name, package in PACKAGES.items()}
    libraries = {
        f"{info['internal_api']} {info['version']} {info.get('architecture', '')}".strip()
        for info in threadpool_info()
        if info["user_api"] == "blas"
    }
    return versions | {
        "python": platform.python_version(),
        "blas": ", ".join(sorted(libraries)),
        "machine": platform.machine(),
    }


def other_versions(before: dict[str, str]) -> dict[str, tuple[str, str]]:
    """Return the versions that differ from those of a recording.

    Parameters
    ----------
    before : dict of str to str
        Versions at the time of the recording.

    Returns
    -------
    dict of str to (str, str)
        Versions at the time of the recording and now, where they differ.
    """
    now = present_versions()
    pairs = {name: (before.get(name, "unknown"), now.get(name, "unknown")) for name in before | now}
    return {name: (one, other) for name, (one, other) in pairs.items() if one != other}


def _version(package: str) -> str:
    """Return the version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:  # of a checkout that is not installed
        return "unknown"
