"""The devices that a URL can name, all kinds registered: `open_bus`."""

from tactile import sim
from tactile.bus import can_bus, i2c_bus, mock_bus, serial_bus
from tactile.bus.registry import find_devices, open_bus

__all__ = ["can_bus", "find_devices", "i2c_bus", "mock_bus", "open_bus", "serial_bus", "sim"]
