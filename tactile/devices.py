"""Access to devices by URL, with all kinds registered: `open_bus`, `find_devices`, `link_at`."""

from tactile import sim
from tactile.bus import can_bus, i2c_bus, serial_bus, udp_bus
from tactile.bus.audio import audio_bus
from tactile.bus.chips import bos1921, drv2667
from tactile.bus.registry import find_devices, link_at, open_bus
from tactile.bus.simulated import mock_bus

KINDS = (audio_bus, bos1921, can_bus, drv2667, i2c_bus, mock_bus, serial_bus, sim, udp_bus)
"""Modules of the device kinds; importing them registers the kinds."""

__all__ = ["KINDS", "find_devices", "link_at", "open_bus"]
