"""The devices that a URL can name, all kinds registered: `open_bus`."""

from tactile import sim
from tactile.bus import mock_bus
from tactile.bus.base import find_devices, open_bus

__all__ = ["find_devices", "mock_bus", "open_bus", "sim"]
