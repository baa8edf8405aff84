"""Amplifiers behind a link: bytes or frames in, bytes or frames out.

They do what `c/host/virtual_amplifier.c` does with real devices, for tests and simulation.
"""

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.can_link import CanDecoder, CanEncoder, Frame
from firmware_protocol.i2c_link import I2cTarget, SmbusTarget
from firmware_protocol.packet import encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame


class SerialPort:
    """An amplifier at the end of a serial line.

    Parameters
    ----------
    amplifier : ReferenceAmplifier
        Amplifier that receives and answers.
    """

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier
        self._decoder = SerialDecoder(amplifier.config.packet_limit, amplifier.counters)

    def feed(self, data: bytes, now: int) -> None:
        """Receive bytes.

        Parameters
        ----------
        data : bytes
            Bytes from the line.
        now : int
            Time of reception [ticks].
        """
        self.amplifier.run(now)
        for packet in self._decoder.feed(data):
            self.amplifier.receive(packet, now)

    def take(self) -> bytes:
        """Return the bytes that were sent since the last call.

        Returns
        -------
        bytes
            Bytes to the line.
        """
        return b"".join(encode_frame(encode_packet(p)) for p in self.amplifier.take_sent())


class CanPort:
    """An amplifier on a CAN bus.

    Parameters
    ----------
    amplifier : ReferenceAmplifier
        Amplifier that receives and answers, with its node address.
    fd : bool
        Whether frames have up to 64 bytes (CAN FD).
    extended : bool
        Whether identifiers have 29 bits.
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
        """Receive a frame; the amplifier runs up to this time if the frame ends a packet.

        Parameters
        ----------
        identifier : int
            Identifier of the frame.
        data : bytes
            Payload of the frame.
        now : int
            Time of reception [ticks].
        """
        self._decoder.node = self.amplifier.node
        for packet in self._decoder.feed(identifier, data, now):
            self.amplifier.receive(packet, now)

    def take(self) -> list[Frame]:
        """Return the frames that were sent since the last call.

        Returns
        -------
        list of Frame
            Frames to the bus.
        """
        return [f for p in self.amplifier.take_sent() for f in self._encoder.frames(p)]


class I2cPort:
    """An amplifier as an I²C target, for raw transfers and SMBus blocks.

    Parameters
    ----------
    amplifier : ReferenceAmplifier
        Amplifier that receives and answers.
    """

    def __init__(self, amplifier: ReferenceAmplifier) -> None:
        self.amplifier = amplifier
        limit, counters = amplifier.config.packet_limit, amplifier.counters
        self._raw = I2cTarget(limit, counters)
        self._smbus = SmbusTarget(limit, counters, amplifier.config.tick_hz)

    def write(self, data: bytes, now: int) -> None:
        """Receive a write transfer.

        Parameters
        ----------
        data : bytes
            Data of the transfer.
        now : int
            Time of reception [ticks].
        """
        self.amplifier.run(now)
        for packet in self._raw.write(data):
            self.amplifier.receive(packet, now)

    def read(self, size: int, now: int) -> bytes:
        """Answer a read transfer.

        Parameters
        ----------
        size : int
            Number of bytes that the host reads.
        now : int
            Present time [ticks].

        Returns
        -------
        bytes
            Data of the transfer.
        """
        self._fill(self._raw, now)
        return self._raw.read(size)

    def write_block(self, block: bytes, now: int) -> None:
        """Receive an SMBus block write.

        Parameters
        ----------
        block : bytes
            Data of the block.
        now : int
            Time of reception [ticks].
        """
        self.amplifier.run(now)
        for packet in self._smbus.write(block, now):
            self.amplifier.receive(packet, now)

    def read_block(self, now: int) -> bytes:
        """Answer an SMBus block read.

        Parameters
        ----------
        now : int
            Present time [ticks].

        Returns
        -------
        bytes
            Data of the block.
        """
        self._fill(self._smbus, now)
        return self._smbus.read()

    def _fill(self, target: I2cTarget | SmbusTarget, now: int) -> None:
        """Move the packets that were sent to the queue of a target."""
        self.amplifier.run(now)
        for packet in self.amplifier.take_sent():
            if not target.put(encode_packet(packet)):
                self.amplifier.counters.dropped_replies += 1
