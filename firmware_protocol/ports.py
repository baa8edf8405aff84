"""An amplifier behind a link: bytes or frames in, bytes or frames out.

What `c/host/virtual_amplifier.c` does with real devices, for tests and simulation.
"""

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.can_link import CanDecoder, CanEncoder, Frame
from firmware_protocol.i2c_link import I2cTarget, SmbusTarget
from firmware_protocol.packet import decode_packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame


class SerialPort:
    """An amplifier at the end of a serial line."""

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier
        self._decoder = SerialDecoder(amplifier.config.packet_limit, amplifier.counters)

    def feed(self, data: bytes, now: int) -> None:
        """Let bytes arrive at a tick."""
        self.amplifier.run(now)
        for packet in self._decoder.feed(data):
            self.amplifier.receive(packet, now)

    def take(self) -> bytes:
        """Return the bytes sent since the last call."""
        return b"".join(encode_frame(encode_packet(p)) for p in self.amplifier.take_sent())


class PacketPort:
    """An amplifier that is handed packets one by one."""

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier

    def feed(self, data: bytes, now: int) -> None:
        """Let a packet's bytes arrive at a tick."""
        self.amplifier.run(now)
        amplifier = self.amplifier
        packet = decode_packet(data, amplifier.counters, amplifier.config.packet_limit)
        if packet is not None:
            amplifier.receive(packet, now)

    def take(self) -> list[bytes]:
        """Return the packets sent since the last call."""
        return [encode_packet(p) for p in self.amplifier.take_sent()]


class CanPort:
    """An amplifier on a CAN bus.

    Parameters
    ----------
    amplifier : with its node address
    fd, extended : frames of up to 64 bytes; 29-bit identifiers
    """

    def __init__(self, amplifier: ReferenceAmplifier, *, fd: bool, extended: bool = False) -> None:
        self.amplifier = amplifier
        self._encoder = CanEncoder(from_amplifier=True, fd=fd, extended=extended)
        self._decoder = CanDecoder(
            from_amplifier=False,
            extended=extended,
            limit=amplifier.config.packet_limit,
            counters=amplifier.counters,
            tick_hz=amplifier.config.tick_hz,
        )

    def feed(self, identifier: int, data: bytes, now: int) -> None:
        """Let a frame arrive at a tick; the amplifier runs up to it when it ends a packet."""
        self._decoder.node = self.amplifier.node
        for packet in self._decoder.feed(identifier, data, now):
            self.amplifier.receive(packet, now)

    def take(self) -> list[Frame]:
        """Return the frames sent since the last call."""
        return [f for p in self.amplifier.take_sent() for f in self._encoder.frames(p)]


class I2cPort:
    """An amplifier as an I²C target, raw or by SMBus blocks."""

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier
        limit, counters = amplifier.config.packet_limit, amplifier.counters
        self._raw = I2cTarget(limit, counters)
        self._smbus = SmbusTarget(limit, counters, amplifier.config.tick_hz)

    def write(self, data: bytes, now: int) -> None:
        """Let a write transfer arrive at a tick."""
        self.amplifier.run(now)
        for packet in self._raw.write(data):
            self.amplifier.receive(packet, now)

    def read(self, size: int, now: int) -> bytes:
        """Return what a read transfer gets at a tick."""
        self._fill(self._raw, now)
        return self._raw.read(size)

    def write_block(self, block: bytes, now: int) -> None:
        """Let an SMBus block arrive at a tick."""
        self.amplifier.run(now)
        for packet in self._smbus.write(block, now):
            self.amplifier.receive(packet, now)

    def read_block(self, now: int) -> bytes:
        """Return what an SMBus block read gets at a tick."""
        self._fill(self._smbus, now)
        return self._smbus.read()

    def _fill(self, target: I2cTarget | SmbusTarget, now: int) -> None:
        self.amplifier.run(now)
        for packet in self.amplifier.take_sent():
            if not target.put(encode_packet(packet)):
                self.amplifier.counters.dropped_replies += 1
