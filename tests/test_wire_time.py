"""Time on the wire: bits by hand and by the standards, and estimates that pace a link."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.can_link import CanEncoder
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import encode_frame
from tactile.bus.wire_time import (
    Can,
    I2c,
    Link,
    Uart,
    Usb,
    can_bits,
    can_crc,
    can_estimate,
    fd_bits,
    fd_estimate,
    i2c_bits,
    stuffed,
    uart_bits,
)

LINKS = [
    Uart(1e6), Uart(12e6), Usb(), Can(1e6), Can(1e6, extended=True), Can(1e6, 5e6), Can(1e6, 8e6),
    I2c(400e3), I2c(1e6), I2c(3.4e6), I2c(400e3, smbus=True),
]  # fmt: skip
IDENTIFIERS = st.integers(0, 0x7FF) | st.integers(0x800, 2**29 - 1)


def pcm_packet(size: int) -> bytes:
    """Return the bytes of a PCM packet of so many."""
    return encode_packet(Packet(m.Pcm.TYPE, bytes(size - 8)))


def exact_seconds(link: Link, packet: Packet) -> float:
    """Return the time of a packet with its own stuff bits and COBS codes."""
    data = encode_packet(packet)
    if isinstance(link, Can):
        encoder = CanEncoder(from_amplifier=False, fd=link.data is not None, extended=link.extended)
        frames = encoder.frames(packet)
        if link.data is None:
            return sum(can_bits(*frame) for frame in frames) / link.nominal
        return sum(fd_bits(*frame).seconds(link.nominal, link.data) for frame in frames)
    if isinstance(link, Uart):
        return 10 * len(encode_frame(data)) / link.bit_rate
    if isinstance(link, Usb):
        return len(encode_frame(data)) / link.bytes_per_s
    return link.seconds(data)


# Bits


def test_the_crc_of_can_is_the_catalogued_one() -> None:
    """CRC-15/CAN of "123456789" is 0x059E (Cook, Catalogue of parametrised CRC algorithms)."""
    bits = [byte >> k & 1 for byte in b"123456789" for k in range(7, -1, -1)]
    assert can_crc(bits) == 0x059E


def test_a_stuff_bit_follows_five_of_a_kind_and_begins_the_next_five() -> None:
    """ISO 11898-1, 10.5: 11111 0000 1111 0000 is the worst; six need one, ten need two."""
    assert sum(stuffed([0] * 4)) == 0
    assert sum(stuffed([0] * 6)) == 1
    assert sum(stuffed([0] * 10)) == 2
    assert sum(stuffed([1] * 5 + [0] * 4 + [1] * 4 + [0] * 4)) == 4
    assert sum(stuffed([0, 1] * 20)) == 0


@pytest.mark.parametrize(("size", "bits", "most"), [(0, 47, 8), (1, 55, 10), (8, 111, 24)])
def test_a_can_frame_has_44_bits_8_a_byte_and_3_between(size: int, bits: int, most: int) -> None:
    """135 bits at most for 8 bytes: Davis et al. 2007, equation 1."""
    assert can_estimate(size, "none") == bits == 44 + 8 * size + 3
    assert can_estimate(size) == bits + most
    assert bits <= can_bits(0x302, bytes(range(size))) <= bits + most


@pytest.mark.parametrize("identifier", [0x2AA, 0x0AAAAAAA])
def test_a_can_frame_of_its_own_bits_has_them_all(identifier: int) -> None:
    """No bit is stuffed where bits alternate, and the CRC happens to have no five of a kind."""
    frames = [b"\x55" * 7 + bytes([last]) for last in range(256)]
    least = min(can_bits(identifier, data) for data in frames)
    assert least == can_estimate(8, "none", extended=identifier > 0x7FF)


@pytest.mark.parametrize(("size", "check"), [(8, 27), (16, 27), (20, 32), (64, 32)])
def test_a_can_fd_frame_is_counted_by_its_two_phases(size: int, check: int) -> None:
    """17 + 13 nominal; ESI, DLC, data, and 4 + 17 + 6 or 4 + 21 + 7 of checks."""
    plain = fd_estimate(size, "none")
    assert plain == (30, 5 + 8 * size + check)
    assert plain.seconds(1e6, 5e6) == pytest.approx(30e-6 + (5 + 8 * size + check) / 5e6)
    own, most = fd_bits(0x302, bytes(size)), fd_estimate(size)
    assert plain.data < own.data <= most.data
    assert plain.nominal < own.nominal <= most.nominal


def test_bytes_take_10_bits_on_a_uart_and_9_on_i2c() -> None:
    assert uart_bits(7) == 70
    assert i2c_bits(7) == 1 + 9 * 8 + 1


# Times by hand


def test_a_packet_on_a_uart_is_its_bytes_and_cobs_and_a_zero() -> None:
    """786 bytes: 3 runs of 254 and a rest have 4 codes at most; 10 bits each with the 0x00."""
    assert Uart(1e6).seconds(pcm_packet(786)) == pytest.approx(10e-6 * (786 + 4 + 1))
    assert Usb(0.5e6).seconds(pcm_packet(786)) == pytest.approx(791 / 0.5e6)


def test_a_packet_on_can_is_fragments_of_7_bytes() -> None:
    """30 bytes and 2 of length: 4 frames of 8 bytes, 135 bits at most, and one of 5: 87 + 18."""
    can = Can(500e3)
    assert can.seconds(pcm_packet(30)) == pytest.approx((4 * 135 + 105) / 500e3)
    mean = 4 * (111 + 1 + 79 / 30) + 87 + 1 + 55 / 30
    assert can.mean_seconds(pcm_packet(30)) == pytest.approx(mean / 500e3)


def test_prompt_frames_on_can_have_neither_header_nor_crc() -> None:
    """HEARTBEAT has 3 bytes, 71 + 14 bits at most; PULSE has 8, ESTOP 1."""
    can = Can(1e6)
    for message, bits in ((m.Heartbeat(), 85), (m.Pulse(), 135), (m.Estop(), 55 + 10)):
        assert can.seconds(encode_packet(Packet.of(message))) == pytest.approx(bits * 1e-6)


def test_a_packet_on_can_fd_is_padded() -> None:
    """100 bytes and 2: a frame of 64 bytes, and one of 1 + 39, padded to 48."""
    first = 5 + 512 + 129 + 32
    last = 5 + 384 + 97 + 32
    expected = 2 * (17 + 4 + 13) / 1e6 + (first + last) / 5e6
    assert Can(1e6, 5e6).seconds(pcm_packet(100)) == pytest.approx(expected)


def test_identifiers_of_29_bits_have_20_more_bits_and_their_stuffing() -> None:
    """(54 + 64 − 1) // 4 = 29 stuff bits instead of 24 (Davis et al. 2007)."""
    assert can_estimate(8, "none", extended=True) == 131
    assert can_estimate(8, extended=True) == 160
    assert fd_estimate(8, "none", extended=True).nominal == 30 + 19
    assert Can(1e6, extended=True).seconds(pcm_packet(12)) == pytest.approx(320e-6)


def test_a_packet_on_i2c_is_a_transfer() -> None:
    """9 bits a byte, the address and start and stop; 87 bytes are the most within 800 bits."""
    i2c = I2c(400e3)
    assert i2c.seconds(pcm_packet(87)) == pytest.approx(794 / 400e3)
    assert i2c.largest() == 87
    assert i2c.answer_seconds(pcm_packet(16)) == pytest.approx((2 + 9 * 19) / 400e3)
    assert I2c(1e6).largest() == 221
    assert I2c(3.4e6).largest() == 255


def test_high_speed_i2c_begins_with_a_code_in_fast_mode() -> None:
    """The code is a start, 8 bits and no acknowledge at 400 kHz."""
    assert I2c(3.4e6).seconds(pcm_packet(99)) == pytest.approx(902 / 3.4e6 + 10 / 400e3, rel=0.03)


def test_a_packet_on_smbus_is_blocks() -> None:
    """40 bytes and 2: 31 and 11 with a first byte, after address, command and count."""
    smbus = I2c(100e3, smbus=True)
    assert smbus.seconds(pcm_packet(40)) == pytest.approx((2 + 9 * 35 + 2 + 9 * 15) / 100e3)
    reads = 3 + 9 * (4 + 32) + 3 + 9 * (4 + 12)
    assert smbus.answer_seconds(pcm_packet(40)) == pytest.approx(reads / 100e3)


# Estimates


@given(IDENTIFIERS, st.binary(max_size=8))
def test_a_can_frame_has_no_more_bits_than_the_most(identifier: int, data: bytes) -> None:
    extended = identifier > 0x7FF
    own = can_bits(identifier, data)
    assert can_estimate(len(data), "none", extended=extended) <= own
    assert own <= can_estimate(len(data), extended=extended)


@given(IDENTIFIERS, st.sampled_from([0, 8, 16, 20, 64]), st.booleans())
def test_an_fd_frame_has_no_more_bits_than_the_most(
    identifier: int, size: int, silent: bool
) -> None:
    extended = identifier > 0x7FF
    data = bytes(size) if silent else np.random.default_rng(identifier).bytes(size)
    own, most = fd_bits(identifier, data), fd_estimate(size, extended=extended)
    plain = fd_estimate(size, "none", extended=extended)
    assert plain.nominal <= own.nominal <= most.nominal
    assert plain.data <= own.data <= most.data


@pytest.mark.parametrize("identifier", [0x302, 0x304, 0x32A, 0x1D0B0302])
def test_the_mean_is_that_of_random_data(identifier: int) -> None:
    """Means agree within 1.5 %: the stuff bits of a head depend on the node, 0 to 2."""
    rng, extended = np.random.default_rng(0), identifier > 0x7FF
    classic = np.mean([can_bits(identifier, rng.bytes(8)) for _ in range(400)])
    assert can_estimate(8, "mean", extended=extended) == pytest.approx(classic, rel=0.015)
    fd = np.mean([fd_bits(identifier, rng.bytes(64)) for _ in range(100)], axis=0)
    estimate = fd_estimate(64, "mean", extended=extended)
    assert estimate.data == pytest.approx(fd[1], rel=0.005)
    assert estimate.nominal == pytest.approx(fd[0], abs=1)


@given(
    st.sampled_from(LINKS),
    st.sampled_from([m.Pcm.TYPE, m.Spectrum.TYPE, m.Heartbeat.TYPE, m.Start.TYPE, m.Estop.TYPE]),
    st.binary(max_size=300) | st.integers(0, 300).map(bytes),
    st.integers(1, 127),
)
def test_pacing_is_never_faster_than_the_wire(
    link: Link, kind: int, payload: bytes, node: int
) -> None:
    head = m.MESSAGES[kind].HEAD.size
    payload = (
        payload if kind in (m.Pcm.TYPE, m.Spectrum.TYPE) else payload.ljust(head, b"\0")[:head]
    )
    packet = Packet(kind, payload, node=node)
    assert link.seconds(encode_packet(packet)) >= exact_seconds(link, packet) * (1 - 1e-12)


@pytest.mark.parametrize("link", LINKS, ids=str)
def test_a_plan_at_the_cap_can_be_paced(link: Link) -> None:
    """The packets take less than the whole wire even with the most stuff bits."""
    packet = pcm_packet(link.largest())
    assert link.cap * link.seconds(packet) / link.mean_seconds(packet) < 0.87


@pytest.mark.parametrize("can", [Can(125e3), Can(1e6), Can(1e6, 5e6)])
def test_a_transfer_on_can_is_over_before_its_receiver_gives_up(can: Can) -> None:
    """20 ms, of which half is left for what comes in between."""
    assert can.seconds(pcm_packet(can.largest())) <= 10e-3
