"""Checks in user-mode Linux: I²C, by the kernel's stub and by targets of ours."""

import errno
from collections.abc import Iterator

import pytest
from cuse_i2c import CuseI2c
from guest_tools import refused
from i2c_targets import AmplifierTarget, I2cBus, Registers
from smbus2 import SMBus, i2c_msg

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.fragments import Cutter, Reassembler
from firmware_protocol.host import AmplifierHost
from firmware_protocol.i2c_link import (
    DEFAULT_LIMIT,
    NOTHING,
    READ_COMMAND,
    SMBUS_BLOCK,
    WRITE_COMMAND,
    decode_read,
)
from firmware_protocol.messages import Hello
from firmware_protocol.packet import LinkCounters, encode_packet

STUB = 0  # the number of i2c-stub's bus
STUB_CHIP = 0x48
NUMBER, AMPLIFIER, CHIP, NOBODY = 7, 0x2A, 0x50, 0x33
SESSION = 0x1234


@pytest.fixture
def bus() -> Iterator[I2cBus]:
    bus = I2cBus(
        {AMPLIFIER: AmplifierTarget(ReferenceAmplifier(AmplifierConfig())), CHIP: Registers()}
    )
    with CuseI2c(NUMBER, bus):
        yield bus


@pytest.fixture
def master(bus: I2cBus) -> Iterator[SMBus]:
    with SMBus(NUMBER) as master:
        yield master


def test_the_stub_keeps_bytes_and_words() -> None:
    with SMBus(STUB) as master:
        master.write_byte_data(STUB_CHIP, 1, 0xAB)
        master.write_word_data(STUB_CHIP, 2, 0x1234)
        assert master.read_byte_data(STUB_CHIP, 1) == 0xAB
        assert master.read_word_data(STUB_CHIP, 2) == 0x1234
        with refused(errno.ENODEV):
            master.read_byte_data(NOBODY, 0)


def test_raw_transfers(master: SMBus) -> None:
    data = bytes(7 * i % 256 for i in range(254))
    master.i2c_rdwr(i2c_msg.write(CHIP, b"\1" + data))
    read = i2c_msg.read(CHIP, 254)
    master.i2c_rdwr(i2c_msg.write(CHIP, [1]), read)
    assert bytes(read) == data


def test_smbus_transfers(master: SMBus) -> None:
    master.write_quick(CHIP)
    master.write_byte_data(CHIP, 1, 0xAB)
    master.write_word_data(CHIP, 2, 0x1234)
    master.write_i2c_block_data(CHIP, 0x10, list(range(32)))
    master.write_block_data(CHIP, 0x40, [5, 6, 7])
    assert master.read_byte_data(CHIP, 1) == 0xAB
    assert master.read_word_data(CHIP, 2) == 0x1234
    assert master.read_i2c_block_data(CHIP, 0x10, 32) == list(range(32))
    assert master.read_block_data(CHIP, 0x40) == [5, 6, 7]
    master.write_byte(CHIP, 0x41)
    assert master.read_byte(CHIP) == 5


def test_what_no_one_acknowledges(bus: I2cBus, master: SMBus) -> None:
    with refused(errno.ENXIO):
        master.i2c_rdwr(i2c_msg.write(NOBODY, [0]))
    with refused(errno.ENXIO):
        master.read_byte_data(NOBODY, 0)
    for code in (errno.EREMOTEIO, errno.ETIMEDOUT):
        bus.refusals.append(code)
        with refused(code):
            master.i2c_rdwr(i2c_msg.write(CHIP, [0]))
    master.i2c_rdwr(i2c_msg.write(CHIP, [0]))


def test_a_bus_that_goes_away() -> None:
    with CuseI2c(NUMBER, I2cBus({CHIP: Registers()})) as cuse:
        master = SMBus(NUMBER)
        master.write_byte_data(CHIP, 1, 2)
    with refused(errno.ENOTCONN, errno.ECONNABORTED, errno.ENODEV):
        master.read_byte_data(CHIP, 1)
    master.close()
    assert not cuse.path.exists()


def test_the_amplifier_answers_raw_packets(master: SMBus) -> None:
    host = AmplifierHost(SESSION, node=1)
    request = host.request(Hello(session=SESSION, major=1))
    master.i2c_rdwr(i2c_msg.write(AMPLIFIER, encode_packet(request)))
    while host.caps is None:
        read = i2c_msg.read(AMPLIFIER, 2 + DEFAULT_LIMIT)
        master.i2c_rdwr(read)
        packet = decode_read(bytes(read))
        assert packet is not None
        host.receive(packet)
    assert host.caps.channels == 24


def test_the_amplifier_answers_smbus_blocks(master: SMBus) -> None:
    host = AmplifierHost(SESSION, node=1)
    request = encode_packet(host.request(Hello(session=SESSION, major=1)))
    for block in Cutter(SMBUS_BLOCK).fragments(WRITE_COMMAND, request):
        master.write_block_data(AMPLIFIER, WRITE_COMMAND, block)
    answers = Reassembler(DEFAULT_LIMIT, LinkCounters())
    while host.caps is None:
        block = bytes(master.read_block_data(AMPLIFIER, READ_COMMAND))
        assert block != NOTHING
        packet = answers.feed(READ_COMMAND, block, now=0)
        if packet is not None:
            host.receive(packet)
    assert host.caps.channels == 24
