"""Tests of bad links: each mistake is one line, the right error, and leaves nothing behind."""

import errno
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import can.interfaces.virtual
import pytest
import serial
from bus_benches import Amplifier, RealBench
from bus_contract import limited

from firmware_protocol import messages as m
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.bus.base import Bus
from tactile.bus.link.link_bus import LinkBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError, InputError

DEADLINE = 60.0
"""Time within which anything that is waited for must have happened [s]."""


def open_files() -> set[tuple[str, str]]:
    """Return the descriptors that this process has open, and what they lead to."""
    found = set()
    for number in os.listdir("/proc/self/fd"):
        with suppress(OSError):  # the listing's own
            found.add((number, os.readlink(f"/proc/self/fd/{number}")))
    return found


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let what answers take its time, and be silent meanwhile."""
    for limit in ("link_bus.OPENING", "link_bus.STARTING", "link_bus.ENDING", "session.SILENCE"):
        monkeypatch.setattr(f"tactile.bus.link.{limit}", DEADLINE)
    monkeypatch.setattr("tactile.bus.link.peer.TRIES", 40)


@pytest.fixture
def short_opening(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for an answer, where there is none, for 0.5 s rather than 2."""
    monkeypatch.setattr("tactile.bus.link.link_bus.OPENING", 0.5)


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    """See that no thread and no descriptor is left, whatever a test did."""
    threads, files = threading.active_count(), open_files()
    yield
    end = time.monotonic() + DEADLINE
    while threading.active_count() > threads and time.monotonic() < end:
        time.sleep(1e-3)  # of pyserial or python-can, which do not join
    assert threading.active_count() <= threads
    assert open_files() <= files  # what earlier tests left may end meanwhile


def refused(kind: type[Exception], url: str, display: Display) -> str:
    """Return why a device does not open: one line, with nothing left behind it."""
    threads, files = threading.active_count(), open_files()
    with pytest.raises(kind) as found:
        open_bus(url, display)
    assert isinstance(found.value, InputError) == (kind is InputError)
    assert threading.active_count() <= threads
    assert open_files() <= files
    said = str(found.value)
    assert said
    assert "\n" not in said
    assert len(said) < 250
    return said


# Ports that do not open


@contextmanager
def terminal() -> Iterator[tuple[int, str]]:
    """Yield the far end and the path of a terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(slave)
        os.close(master)


def test_a_port_that_another_program_holds_is_told_so(three: Display) -> None:
    with terminal() as (_, path), serial.Serial(path, exclusive=True):
        said = refused(BusError, f"serial://{path}", three)
    assert said == f"serial: {path}: another program holds the port; close it"


def denied(path: str, *_: Any, **__: Any) -> int:
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)


def test_a_port_without_permission_names_the_group_that_has_it(
    three: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    import grp

    with terminal() as (_, path):
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
        monkeypatch.setattr("serial.serialposix.os.open", denied)
        said = refused(BusError, f"serial://{path}", three)
        monkeypatch.undo()
    assert said == (
        f"serial: {path}: permission denied; sudo usermod -aG {group} $USER, then log in again"
    )


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("serial:///dev/ttyNONE0", "serial: /dev/ttyNONE0: no such port; there are: "),
        ("i2c:199?address=0x42", "i2c: /dev/i2c-199: no such bus; there are: "),
        (
            "can:socketkan/can0",
            "can: socketkan/can0: python-can has no interface 'socketkan'",
        ),
    ],
)
def test_what_does_not_exist_is_named_with_what_does(three: Display, url: str, why: str) -> None:
    assert refused(BusError, url, three).startswith(why)


def test_an_i2c_bus_without_permission_names_the_group(
    three: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smbus2.smbus2.os.open", denied)
    said = refused(BusError, "i2c:1", three)
    assert said.startswith("i2c: /dev/i2c-1: permission denied; sudo usermod -aG i2c $USER")


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("i2c:", "i2c: names no bus; as i2c:1?address=0x42"),
        ("i2c:1?address=0x99", "i2c: address = '0x99': must be 0x8 … 0x77"),
        ("i2c:1?adress=0x42", "i2c: unknown option 'adress'; did you mean 'address'"),
        ("serial:///dev/null?baud=fast", "serial: baud = 'fast': must be a number"),
        ("serial:///dev/null?baud=9", "serial: baud = '9': must be 1200 … 1e+08"),
        ("can:socketcan/can0?nodes=0", "can: nodes = '0': must be 1 … 127"),
        ("can:socketcan/can0?bitrate=2e6", "can: bitrate = '2e6': must be 10000 … 1e+06"),
        ("can:socketcan/can0?fd=perhaps", "can: fd = 'perhaps': must be true or false"),
    ],
)
def test_an_option_that_cannot_be_is_the_users_mistake(three: Display, url: str, why: str) -> None:
    assert refused(InputError, url, three).startswith(why)


def test_a_can_interface_that_does_not_exist_or_a_kernel_without_can_is_told_so(
    three: Display,
) -> None:
    said = refused(BusError, "can:socketcan/none0", three)
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        assert said.startswith("can: socketcan/none0: no such interface; there are: ")
    except OSError:
        assert said == "can: socketcan/none0: this kernel has no CAN"


# Other devices on the link


@contextmanager
def answering(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """Yield the path of a terminal on which what comes is answered."""
    ended = threading.Event()

    def run(master: int) -> None:
        while not ended.is_set():
            if select.select([master], [], [], 5e-3)[0]:
                with suppress(OSError):
                    os.write(master, answer(os.read(master, 4096)))

    with terminal() as (master, path):
        thread = threading.Thread(target=run, args=(master,))
        thread.start()
        try:
            yield path
        finally:
            ended.set()
            thread.join()


@pytest.mark.usefixtures("short_opening")
def test_a_line_on_which_nothing_answers_is_told_so(three: Display) -> None:
    with answering(lambda data: b"") as path:
        said = refused(BusError, f"serial://{path}", three)
    assert said == "nothing answers HELLO: is the amplifier powered, and is this its link?"


@pytest.mark.usefixtures("short_opening")
def test_a_can_bus_on_which_nothing_answers_is_told_so(three: Display) -> None:
    said = refused(BusError, "can:virtual/nobody", three)
    assert said == "nothing answers HELLO: is the amplifier powered, and is this its link?"


@pytest.mark.parametrize("noise", [bytes(range(1, 200)) + b"\0", b"\xff\x00" * 40, b"login: \0"])
def test_noise_is_told_from_silence(
    three: Display, noise: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    wait = LinkBus._wait

    def wait_for_noise(bus: LinkBus, ready: Callable[[], object], seconds: float) -> bool:
        assert wait(bus, lambda: not bus._silence().startswith("nothing"), seconds)
        return wait(bus, ready, 0.0)

    monkeypatch.setattr(LinkBus, "_wait", wait_for_noise)
    with answering(lambda data: noise) as path:
        said = refused(BusError, f"serial://{path}?baud=115200&format=spectrum", three)
    assert said.startswith("what comes is no packet of the protocol (")
    assert said.endswith(" so far): another bit rate, or another device")


@pytest.mark.usefixtures("short_opening")
def test_an_echo_is_no_amplifier(three: Display) -> None:
    with answering(lambda data: data) as path:
        refused(BusError, f"serial://{path}", three)


def test_an_amplifier_of_another_major_version_is_told_which(three: Display) -> None:
    """The packets have another version in their flags (SPEC.md, 4); their CRC-32 is right."""
    decoder = SerialDecoder()

    def answer(data: bytes) -> bytes:
        return b"".join(
            encode_frame(encode_packet(Packet(m.Caps.TYPE, m.Caps().pack(), 2 << 6, 1, 0)))
            for _ in decoder.feed(data)
        )

    with answering(answer) as path:
        said = refused(BusError, f"serial://{path}", three)
    assert said == (
        "node 1 speaks version 2 of the protocol, this host 1; update the older of the two"
    )


# Amplifiers that can less than the display asks for


@pytest.fixture
def pty_bench(virtual_amplifier: Path, tmp_path: Path) -> Iterator[RealBench]:
    bench = RealBench("pty", virtual_amplifier, tmp_path)
    yield bench
    bench.reset()


@pytest.mark.parametrize(
    ("channels", "options", "why"),
    [
        (2, (), "the display has 3 channels, the amplifiers 2"),
        (
            3,
            ("--voltage-limit-uv", "60000000"),
            "limits.voltage_v: the display's 100 V is more than the amplifier's 60 V; "
            "lower it in the display file",
        ),
    ],
)
def test_a_display_that_asks_for_more_than_the_amplifier_has_is_refused(
    three: Display, pty_bench: RealBench, channels: int, options: tuple[str, ...], why: str
) -> None:
    amplifier, path = pty_bench.pty(channels, *options)
    assert refused(InputError, f"serial://{path}", three) == why
    assert_disarmed(amplifier)


def test_a_display_that_is_steeper_than_the_amplifier_is_refused(
    three: Display, pty_bench: RealBench
) -> None:
    amplifier, path = pty_bench.pty(3)  # with 1e8 V/s
    said = refused(InputError, f"serial://{path}", limited(three, slew=1e9))
    assert said.startswith("limits.slew_v_per_us: the display's 1e+09 V/s is more than")
    assert_disarmed(amplifier)


def test_a_rate_or_format_that_the_line_cannot_carry_is_refused_with_what_it_can(
    three: Display, pty_bench: RealBench
) -> None:
    amplifier, path = pty_bench.pty(3)
    said = refused(InputError, f"serial://{path}?baud=115200&format=pcm16", three)
    assert "cannot carry 3 channels: PCM16 at" in said
    assert " fits" in said
    assert_disarmed(amplifier)


@pytest.mark.realtime
@pytest.mark.parametrize("end", ["close", "abort", "estop", "exception"])
def test_the_amplifier_is_disarmed_and_free_after_the_end(
    three: Display, pty_bench: RealBench, end: str
) -> None:
    amplifier, path = pty_bench.pty(3)

    def run(bus: Bus) -> None:
        bus.start()
        if end in ("abort", "estop"):
            getattr(bus, end)()
        if end == "exception":
            raise KeyboardInterrupt
        if end == "estop":
            bus.clear()

    with suppress(KeyboardInterrupt), open_bus(f"serial://{path}", three) as bus:
        run(bus)
    assert_disarmed(amplifier)
    open_bus(f"serial://{path}", three).close()


def assert_disarmed(amplifier: Amplifier) -> None:
    """See that it is IDLE, without high voltage, as what it put out last shows."""
    last = amplifier.settled()[-1]
    assert (last["state"], last["high_voltage"]) == (m.State.IDLE, 0)
    assert not last["codes"].any()


@pytest.mark.realtime
def test_no_thread_and_no_descriptor_is_left_by_use(three: Display, pty_bench: RealBench) -> None:
    _, path = pty_bench.pty(3)
    threads, files = threading.active_count(), open_files()
    for _ in range(3):
        with open_bus(f"serial://{path}", three) as bus:
            bus.start()
            assert threading.active_count() == threads + 1
        assert threading.active_count() <= threads
        assert open_files() <= files


@pytest.mark.usefixtures("short_opening")
def test_a_can_bus_is_shut_down_where_opening_fails(three: Display) -> None:
    refused(BusError, "can:virtual/shut", three)
    assert "shut" not in can.interfaces.virtual.channels
