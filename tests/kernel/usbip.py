"""USB devices written in Python behind the kernel's vhci-hcd, to which its own drivers bind.

The kernel is told one end of a socket pair; what it sends over it is USB/IP, as of
Documentation/usb/usbip_protocol.rst.
"""

import errno
import socket
import struct
import threading
from collections import defaultdict, deque
from pathlib import Path

ATTACH = Path("/sys/devices/platform/vhci_hcd.0/attach")
HIGH_SPEED = 3

HEADER = struct.Struct(">5I")  # command, sequence number, device, direction, endpoint
SUBMIT = struct.Struct(">IiiiI8s")  # flags, length, start frame, packets, interval, setup
SUBMITTED = struct.Struct(">iiiii8x")  # status, length, start frame, packets, errors
UNLINKED = struct.Struct(">i24x")
SETUP = struct.Struct("<BBHHH")  # request type, request, value, index, length
CMD_SUBMIT, CMD_UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4

TYPE_MASK, STANDARD = 0x60, 0x00  # of the request type
GET_DESCRIPTOR = 6
DEVICE, CONFIGURATION, STRING = 1, 2, 3
ENGLISH = 0x0409


class UsbDevice:
    """A device of one interface with bulk endpoints, plugged in from the start.

    Parameters
    ----------
    port : port of vhci-hcd, 0 to 7
    """

    vendor = 0
    product = 0
    name = ""
    endpoints: tuple[int, ...] = ()
    """Addresses of the endpoints; 0x80 and above lead to the kernel."""

    def __init__(self, port: int) -> None:
        self._socket, kernels = socket.socketpair()
        self._lock = threading.Lock()
        self._waiting: defaultdict[int, deque[int]] = defaultdict(deque)
        self._data: defaultdict[int, deque[bytes]] = defaultdict(deque)
        with kernels:
            ATTACH.write_text(f"{port} {kernels.fileno()} {port + 1} {HIGH_SPEED}")
        self._plugged = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Pull the cable of the device."""
        with self._lock:
            self._plugged = False
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()

    def control(self, request: int, value: int, data: bytes) -> bytes:
        """Return what a vendor's or class's control transfer gives."""
        raise NotImplementedError

    def received(self, data: bytes) -> None:
        """Take what came in by the bulk endpoint."""
        raise NotImplementedError

    def send(self, endpoint: int, data: bytes) -> None:
        """Let the kernel read data from an endpoint, by its number."""
        with self._lock:
            self._data[endpoint].append(data)
            self._deliver(endpoint)

    def _deliver(self, endpoint: int) -> None:
        waiting, data = self._waiting[endpoint], self._data[endpoint]
        while waiting and data:
            self._answer(waiting.popleft(), data.popleft())

    def _answer(self, sequence: int, data: bytes = b"", length: int = 0, status: int = 0) -> None:
        if not self._plugged:
            return
        head = HEADER.pack(RET_SUBMIT, sequence, 0, 0, 0)
        self._socket.sendall(head + SUBMITTED.pack(status, len(data) or length, 0, 0, 0) + data)

    def _serve(self) -> None:
        with self._socket.makefile("rb") as stream:
            while len(head := stream.read(HEADER.size)) == HEADER.size:
                command, sequence, _, inward, endpoint = HEADER.unpack(head)
                body = stream.read(SUBMIT.size)
                if command == CMD_UNLINK:
                    self._unlink(sequence, *struct.unpack_from(">I", body))
                    continue
                _, length, _, _, _, setup = SUBMIT.unpack(body)
                data = b"" if inward else stream.read(length)
                if endpoint == 0:
                    self._control(sequence, setup, data)
                elif inward:
                    with self._lock:
                        self._waiting[endpoint].append(sequence)
                        self._deliver(endpoint)
                else:
                    with self._lock:
                        self._answer(sequence, length=length)
                    self.received(data)

    def _unlink(self, sequence: int, target: int) -> None:
        with self._lock:
            status = 0
            for waiting in self._waiting.values():
                if target in waiting:
                    waiting.remove(target)
                    status = -errno.ECONNRESET
            if not self._plugged:
                return
            head = HEADER.pack(RET_UNLINK, sequence, 0, 0, 0)
            self._socket.sendall(head + UNLINKED.pack(status))

    def _control(self, sequence: int, setup: bytes, data: bytes) -> None:
        kind, request, value, _, length = SETUP.unpack(setup)
        answer, status = b"", 0
        if kind & TYPE_MASK != STANDARD:
            answer = self.control(request, value, data)
        elif request == GET_DESCRIPTOR:
            answer = self._descriptor(value >> 8, value & 0xFF)
            status = 0 if answer else -errno.EPIPE
        with self._lock:
            self._answer(sequence, answer[:length], len(data), status)

    def _descriptor(self, kind: int, index: int) -> bytes:
        if kind == DEVICE:
            fields = (0x200, 0, 0, 0, 64, self.vendor, self.product, 0x100, 1, 2, 3, 1)
            return struct.pack("<BBHBBBBHHHBBBB", 18, DEVICE, *fields)
        if kind == CONFIGURATION:
            body = struct.pack("<9B", 9, 4, 0, 0, len(self.endpoints), 0xFF, 0, 0, 0)
            for endpoint in self.endpoints:
                body += struct.pack("<BBBBHB", 7, 5, endpoint, 2, 512, 0)
            return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1, 1, 0, 0x80, 50) + body
        if kind == STRING and index == 0:
            return struct.pack("<BBH", 4, STRING, ENGLISH)
        if kind == STRING:
            text = self.name.encode("utf-16-le")
            return struct.pack("<BB", 2 + len(text), STRING) + text
        return b""
