"""Outlets of LSL: streams that are offered, with the metadata that the XDF specification names."""

import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.lsl.decimation import ATTENUATION_DB, PASSBAND, RIPPLE_DB, STOPBAND
from tactile.lsl.library import load_pylsl

BUFFERED = 60
"""Time for which LSL keeps samples for a recorder that does not fetch them [s]."""
BUFFERED_MARKERS = 10
"""Number of markers that LSL keeps for a recorder that does not fetch them [hundreds]."""


@dataclass(frozen=True)
class OutletChannel:
    """A channel of a stream.

    Attributes
    ----------
    label, kind, unit : str
        Name of the channel, its type, and its unit in the words of the XDF specification.
    location : (2,) tuple of float or None
        Position of the contactor in the display [m]; None for a channel that has no place.
    """

    label: str
    kind: str
    unit: str
    location: tuple[float, float] | None = None


@dataclass(frozen=True)
class OutletDescription:
    """Description of a stream, as recorders store it.

    Attributes
    ----------
    display : str
        Name of the display.
    quantity : str
        Quantity that the stream holds, such as "drive".
    kind : str
        Content type of the stream.
    rate : float
        Nominal rate of its samples; 0 for markers, which have none [Hz].
    channels : tuple of OutletChannel
        Channels.
    format : str
        Type of the values: "float32" or "string".
    lag : float
        Delay of the filter that made the samples, for which their times are compensated; 0 without
        a filter [s].
    """

    display: str
    quantity: str
    kind: str
    rate: float
    channels: tuple[OutletChannel, ...]
    format: Literal["float32", "string"] = "float32"
    lag: float = 0.0

    @property
    def name(self) -> str:
        """Name of the stream."""
        return f"tactile {self.display} {self.quantity}"

    @property
    def source_id(self) -> str:
        """Identity of the stream, the same after a restart, by which recorders find it again."""
        return f"tactile:{socket.gethostname()}:{self.display}:{self.quantity}"


def describe_contacts(display: str, rate: float) -> OutletDescription:
    """Describe the stream of the finger.

    Parameters
    ----------
    display : str
        Name of the display.
    rate : float
        Rate of the blocks [Hz].

    Returns
    -------
    OutletDescription
        Description.
    """
    channels = (
        OutletChannel("x", "PositionX", "millimeters"),
        OutletChannel("y", "PositionY", "millimeters"),
        OutletChannel("velocity x", "VelocityX", "millimeters/second"),
        OutletChannel("velocity y", "VelocityY", "millimeters/second"),
        OutletChannel("normal force", "NormalForce", "newtons"),
        OutletChannel("touching", "Touching", "boolean"),
    )
    return OutletDescription(display, "contacts", "MoCap", rate, channels)


def describe_contactors(
    display: str,
    quantity: Literal["shear", "drive"],
    rate: float,
    contactors: Sequence[tuple[float, float]],
    lag: float = 0.0,
) -> OutletDescription:
    """Describe a stream that has a channel for each contactor.

    Parameters
    ----------
    display : str
        Name of the display.
    quantity : str
        Quantity of the contactors: "shear" or "drive".
    rate : float
        Rate of the samples [Hz].
    contactors : (N, 2) sequence of float
        Positions of the contactors [m].
    lag : float
        Delay of the filter that made the samples, which is compensated [s].

    Returns
    -------
    OutletDescription
        Description.
    """
    kind, unit = {"shear": ("Shear", "microns"), "drive": ("Voltage", "volts")}[quantity]
    channels = tuple(
        OutletChannel(f"contactor {index}", kind, unit, (x, y))
        for index, (x, y) in enumerate(contactors)
    )
    return OutletDescription(display, quantity, "Haptics", rate, channels, lag=lag)


def describe_markers(display: str) -> OutletDescription:
    """Describe the stream of the markers.

    Parameters
    ----------
    display : str
        Name of the display.

    Returns
    -------
    OutletDescription
        Description.
    """
    channels = (OutletChannel("marker", "Marker", "none"),)
    return OutletDescription(display, "markers", "Markers", 0.0, channels, format="string")


class Outlet:
    """A stream that recorders find and fetch; any thread may add to it.

    Parameters
    ----------
    description : OutletDescription
        Description of the stream.

    Attributes
    ----------
    description : OutletDescription
        Description of the stream.
    samples : int
        Number of samples that were added.
    """

    def __init__(self, description: OutletDescription) -> None:
        self.description, self.samples = description, 0
        lsl = load_pylsl()
        info = lsl.StreamInfo(
            description.name, description.kind, len(description.channels), description.rate,
            description.format, description.source_id,
        )  # fmt: skip
        _add_metadata(info.desc(), description)
        self._lock = threading.Lock()
        buffered = BUFFERED if description.rate else BUFFERED_MARKERS
        self._outlet: Any = lsl.StreamOutlet(info, max_buffered=buffered)

    def push(self, times: Floats, values: NDArray[np.floating]) -> None:
        """Add samples, each with its own time.

        Parameters
        ----------
        times : (S,) array
            Time of each sample on the clock of LSL [s].
        values : (S, C) array
            Samples of each channel.
        """
        # a copy: some versions of pylsl are quick only with arrays that may be written to
        rows = np.array(values, np.float32, order="C")
        with self._lock:
            if self._outlet is not None and len(rows):
                self._outlet.push_chunk(rows, times.tolist())
                self.samples += len(rows)

    def push_marker(self, text: str, time: float) -> None:
        """Add a marker.

        Parameters
        ----------
        text : str
            Marker.
        time : float
            Time of the marker on the clock of LSL [s].
        """
        with self._lock:
            if self._outlet is not None:
                self._outlet.push_sample([text], time)
                self.samples += 1

    def close(self) -> None:
        """Withdraw the stream; what is added afterwards is ignored."""
        with self._lock:
            self._outlet = None


def _add_metadata(root: Any, description: OutletDescription) -> None:
    """Add the metadata of a stream to its description in XML."""
    acquisition = root.append_child("acquisition")
    acquisition.append_child_value("manufacturer", "tactile")
    acquisition.append_child_value("model", description.display)
    acquisition.append_child_value("compensated_lag", repr(description.lag))
    synchronization = root.append_child("synchronization")
    synchronization.append_child_value("offset_mean", "0")
    synchronization.append_child_value("can_drop_samples", "true")
    channels = root.append_child("channels")
    for channel in description.channels:
        element = channels.append_child("channel")
        element.append_child_value("label", channel.label)
        element.append_child_value("type", channel.kind)
        element.append_child_value("unit", channel.unit)
        if channel.location is not None:
            location = element.append_child("location")
            for axis, position in zip("XY", channel.location, strict=True):
                location.append_child_value(axis, f"{position * 1e3:.6g}")
    if description.lag:
        lowpass = root.append_child("filtering").append_child("lowpass")
        lowpass.append_child_value("type", "FIR")
        lowpass.append_child_value("design", "Kaiser window, linear phase")
        lowpass.append_child_value("lower", f"{PASSBAND * description.rate:g}")
        lowpass.append_child_value("upper", f"{STOPBAND * description.rate:g}")
        lowpass.append_child_value("ripple", f"{RIPPLE_DB:g}")
        lowpass.append_child_value("attenuation", f"{ATTENUATION_DB:g}")
