"""What measurements of the currents of a display have in common: a cautious bus, and listening.

Drive and electrodes never exceed 20 V, or the display's own limit where hysteresis is measured: the
bus is opened with that limit, so that host, bus and amplifier each enforce it on their own.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tactile.arrays import Floats
from tactile.bringup.probe import cautious
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.registry import with_default_option
from tactile.devices import open_bus
from tactile.display.display import Display, load_display
from tactile.errors import BusError, InputError
from tactile.playback.estop_guard import guarded
from tactile.playback.finger_following import WINDOW_MS
from tactile.playback.sum_windows import PlayedWindow, SumWindows
from tactile.sensing.bender import Bender, bender_of
from tactile.sensing.calibration import LARGEST, MeasuringLimits
from tactile.sensing.hysteresis import PlayModel

BLOCK = 64
"""Number of samples of a block."""
LISTENING = 0.3
"""Time at 0 V before a measurement, in which the amplifier tells its range, and after it, in which
the last windows come [s]."""

Progress = Callable[[float, float], None]
"""Function that is called with the time that has been played and the whole time [s]."""


class MeasuringDevice(NamedTuple):
    """Open device that measures currents, and what its drive has to keep.

    Attributes
    ----------
    bus : Bus
        The bus.
    display : Display
        The display, with its voltage limited.
    bender : Bender
        Design of its benders.
    """

    bus: Bus
    display: Display
    bender: Bender

    @property
    def rate(self) -> float:
        """Sample rate [Hz]."""
        return self.bus.wiring.sample_rate

    def limits(self) -> MeasuringLimits:
        """Listen to the range of the converter, and return all limits.

        Returns
        -------
        MeasuringLimits
            Limits of a drive.

        Raises
        ------
        BusError
            If no windows come.
        """
        windows = self.play(np.zeros(0))
        return MeasuringLimits(
            current=min(window.current_range for window in windows),
            voltage=self.display.limits.voltage,
            slew=self.display.slew,
        )

    def play(
        self,
        drive: Floats,
        progress: Progress | None = None,
        *,
        hysteresis: PlayModel | None = None,
    ) -> list[PlayedWindow]:
        """Play a drive on all contactors, and a while of 0 V.

        Parameters
        ----------
        drive : (S,) or (S, N) array of float
            Drive, the same for all N contactors or that of each [V].
        progress : callable, optional
            Function that is called with the time that has been played and the whole time.
        hysteresis : PlayModel, optional
            Hysteresis of the contactors, if it has been measured.

        Returns
        -------
        list of PlayedWindow
            Windows that came, at least one.

        Raises
        ------
        BusError
            If the device stops, or no windows come.
        """
        bus, display = self.bus, self.display
        rate, taken = self.rate, SumWindows(display, bus, hysteresis)
        each = drive[:, None] if drive.ndim == 1 else drive
        each = np.broadcast_to(each, (len(drive), len(display.contactors)))
        whole = np.concatenate([each, np.zeros((round(LISTENING * rate), each.shape[1]))])
        windows = []
        bus.start()
        for position in range(0, len(whole), BLOCK):
            volts = whole[position : position + BLOCK]
            bus.write(DriveBlock(position, display.to_channels(volts)))
            if bus.state != "running":
                raise BusError(bus.status.detail or "the device stopped during the measurement")
            taken.wrote(position, volts)
            windows += taken.take()
            if progress is not None:
                progress(position / rate, len(whole) / rate)
        bus.stop()
        if not windows:
            raise BusError("no windows of currents came: does the link lose packets?")
        return windows


@contextmanager
def measuring_device(
    url: str,
    source: str | Path,
    *,
    voltage: float = LARGEST,
    accept_unsafe_hold: bool = False,
) -> Iterator[MeasuringDevice]:
    """Open a device with a low limit of its voltage, to measure the currents of its contactors.

    Parameters
    ----------
    url : str
        URL of the device.
    source : str or Path
        Name or file of the display.
    voltage : float
        Largest voltage at drive and electrodes, besides the display's own limit [V].
    accept_unsafe_hold : bool
        As in `open_bus`.

    Yields
    ------
    MeasuringDevice
        Device, with `tactile estop` active.

    Raises
    ------
    TactileError
        If the device measures no currents, or device or display cannot be used.
    """
    display = cautious(load_display(source), voltage)
    asked = with_default_option(url, "correlation_ms", str(WINDOW_MS))
    with (
        open_bus(asked, display, accept_unsafe_hold=accept_unsafe_hold) as bus,
        guarded(bus, url),
    ):
        if not bus.correlates or bus.frames is not None:
            raise InputError(
                f"device {url!r}: measures no currents while it plays samples; an amplifier with "
                "the feature CORRELATES does"
            )
        bender = bender_of(display.bimorph, display.amplifier, bus.wiring.sample_rate)
        yield MeasuringDevice(bus, display, bender)
