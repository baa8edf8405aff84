"""A CAN adapter that the kernel's driver gs_usb runs, written in Python.

Its registers and frames are those of the driver, drivers/net/can/usb/gs_usb.c. The bus behind it
ends in a function.
"""

import struct
import threading
from collections import deque
from collections.abc import Callable

from usbip import UsbDevice

BITTIMING, MODE, CONSTANTS, CONFIG = 1, 2, 4, 5  # control requests
RECEIVED = 0xFFFFFFFF  # echo identifier of a frame that is not our own
FRAME = struct.Struct("<IIBBBB8s")  # echo and frame identifiers, length, channel, flags, -, data
LISTEN_ONLY, LOOP_BACK, ONE_SHOT = 1, 2, 8  # features
CLOCK_HZ = 48_000_000
TIMING_LIMITS = (1, 16, 1, 8, 4, 1, 1024, 1)  # segment 1, segment 2, jump width, prescaler

ERROR, BUS_OFF, RESTARTED, CONTROLLER = 0x20000000, 0x40, 0x100, 0x4  # linux/can/error.h
WARNING, PASSIVE, ACTIVE = 0x0C, 0x30, 0x40


class GsUsb(UsbDevice):
    """The adapter, plugged in from the start.

    Parameters
    ----------
    port : port of vhci-hcd
    on_frame : called with identifier (flags as in SocketCAN) and data of a frame on the bus
    """

    vendor = 0x1D50
    product = 0x606F
    name = "gs_usb"
    endpoints = (0x81, 0x02)

    def __init__(self, port: int, on_frame: Callable[[int, bytes], None]) -> None:
        self.on_frame = on_frame
        self.bit_timing: tuple[int, ...] = ()
        self._held: deque[bytes] | None = None
        self._off = False
        self._order = threading.RLock()
        super().__init__(port)

    def inject(self, identifier: int, data: bytes) -> None:
        """Let a frame arrive from the bus."""
        if not self._off:
            self._tell(identifier, data)

    def _tell(self, identifier: int, data: bytes) -> None:
        self.send(1, FRAME.pack(RECEIVED, identifier, len(data), 0, 0, 0, data))

    def error_passive(self) -> None:
        """Tell that too many frames were not acknowledged."""
        self.inject(ERROR | CONTROLLER, bytes([0, PASSIVE, 0, 0, 0, 0, 128, 128]))

    def bus_off(self) -> None:
        """Leave the bus, and tell so; the interface has to be set down and up."""
        self._off = True
        self._tell(ERROR | BUS_OFF, bytes(8))

    def restarted(self) -> None:
        """Tell that the bus was entered again, as an adapter that recovers by itself does."""
        self._off = False
        self.inject(ERROR | RESTARTED, bytes(8))

    def hold(self) -> None:
        """Let the bus be busy: frames wait in the adapter until `release`."""
        with self._order:
            self._held = deque()

    def release(self) -> None:
        """Let the bus be free again."""
        with self._order:
            held, self._held = self._held or deque(), None
            for frame in held:
                self._transmit(frame)

    def control(self, request: int, value: int, data: bytes) -> bytes:
        """Answer the driver's set-up."""
        if request == CONFIG:
            return struct.pack("<4B2I", 0, 0, 0, 0, 2, 1)  # one channel
        if request == CONSTANTS:
            features = LISTEN_ONLY | LOOP_BACK | ONE_SHOT
            return struct.pack("<10I", features, CLOCK_HZ, *TIMING_LIMITS)
        if request == MODE:
            self._off = False
        if request == BITTIMING:
            self.bit_timing = struct.unpack("<5I", data)
        return b""

    def received(self, data: bytes) -> None:
        """Send a frame of the host's on the bus."""
        with self._order:
            if self._off:
                return
            if self._held is None:
                self._transmit(data)
            else:
                self._held.append(data)

    def _transmit(self, frame: bytes) -> None:
        self.send(1, frame)  # the echo tells the driver that it was acknowledged
        _, identifier, length, _, _, _, payload = FRAME.unpack(frame[: FRAME.size])
        self.on_frame(identifier, payload[:length])
