"""Description of a display for clients."""

import math

from tactile.display.display import Display
from tactile.estop.latch import Latch
from tactile.messages import DisplayDescription
from tactile.playback.commands import DeviceOpened
from tactile.texture.perception import CENTERS, detection_threshold

THRESHOLD_UM: list[float] = (detection_threshold(CENTERS) * 1e6).tolist()
"""Peak of a shear that is just felt at each of `CENTERS` [µm]."""


def describe(
    name: str, display: Display, how: DeviceOpened, *, latency: float, latch: Latch
) -> DisplayDescription:
    """Describe an open display for clients.

    Parameters
    ----------
    name : str
        Name of the display for clients.
    display : Display
        The display.
    how : DeviceOpened
        How its device plays.
    latency : float
        Latency from a contact to the skin [s].
    latch : Latch
        E-stop latch of the display.

    Returns
    -------
    DisplayDescription
        Description in the units of the API.
    """
    return DisplayDescription(
        name=name,
        contactors_mm=tuple((float(x) * 1e3, float(y) * 1e3) for x, y in display.contactors),
        shear_direction_deg=tuple(math.degrees(a) for a in display.shear_direction.tolist()),
        sample_rate_hz=how.sample_rate,
        voltage_limit_v=display.limits.voltage,
        waveforms=not how.carriers,
        latency_ms=1e3 * latency,
        estop=latch.holds,
        latest_estop=latch.number,
        follows=how.follows,
        threshold_um=tuple(zip(CENTERS.tolist(), THRESHOLD_UM, strict=True)),
        marker_lines=how.marker_lines,
    )
