"""Tests of the ports of the C amplifier: all are built, and those that QEMU has boot and answer.

QEMU counts instructions as time and skips idle time, so that a busy computer makes a port slow, but
never late by its own clock. No test but that of the vectors depends on how fast either is.
"""

import binascii
import os
import re
import select
import shutil
import socket
import struct
import subprocess
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from firmware_protocol import messages as m
from firmware_protocol.packet import Packet, encode_packet
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile import devices
from tactile.bus.conform import conformance
from tactile.bus.conform.scenarios import load_scenarios

assert devices.KINDS  # registers the kinds
PORTS = Path(__file__).parents[1] / "firmware_protocol" / "c" / "ports"
SESSION = 0x1234
PATIENCE_S = 120.0

pytestmark = pytest.mark.ci


@dataclass(frozen=True)
class Memory:
    """Where a part has its RAM and the flash of the program."""

    ram: int
    ram_kb: int
    flash: int
    flash_kb: int

    @property
    def top(self) -> int:
        return self.ram + 1024 * self.ram_kb


PARTS = {
    "qemu-m0": Memory(0x20000000, 16, 0, 256),
    "qemu-m3": Memory(0x20000000, 64, 0, 256),
    "qemu-m4": Memory(0x20000000, 4096, 0, 4096),
    "stm32g4": Memory(0x20000000, 128, 0x08000000, 512),
    "rp2040": Memory(0x20000000, 264, 0x10000000, 2048),
}
"""Memories of the parts by their data sheets."""


@dataclass(frozen=True)
class Machine:
    """Machine of QEMU, and the pin of its e-stop input: path, number, level of an open contact."""

    name: str
    pin: tuple[str, int, int] | None


MACHINES = {
    "qemu-m0": Machine("microbit", ("/machine/nrf51", 17, 0)),
    "qemu-m3": Machine("lm3s6965evb", ("/machine/unattached/device[9]", 5, 1)),
    "qemu-m4": Machine("mps2-an386", None),
}
EMULATED = pytest.mark.parametrize("port", MACHINES)


def make(build: Path, *options: str, ci: bool = True) -> tuple[int, str]:
    """Run `make` in the folder of the ports and return its status and all that it printed."""
    environment = {k: v for k, v in os.environ.items() if k != "CI"}
    environment |= {"CI": "true"} if ci else {}
    command = ["make", "--silent", "-C", str(PORTS), f"BUILD={build}", *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def lack(text: str) -> None:
    """Fail in CI for a tool that is missing, and skip elsewhere."""
    if os.environ.get("CI") == "true":
        pytest.fail(text)
    pytest.skip(text)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Build all ports and return the folder of the programs, and what was printed."""
    build = tmp_path_factory.mktemp("ports")
    status, text = make(build)
    if "skipped: there is no" in text:
        lack(text)
    assert status == 0, text
    return build, text


class Emulator:
    """A port in QEMU: its UART, and its e-stop input before and while it runs."""

    def __init__(self, port: str, program: Path, *, contact_open: bool) -> None:
        self.machine = MACHINES[port]
        self.test, test = socket.socketpair()
        self.monitor, monitor = socket.socketpair()
        self.test.settimeout(PATIENCE_S)
        command = [
            "qemu-system-arm", "-M", self.machine.name, "-kernel", str(program), "-S",
            "-accel", "tcg", "-icount", "shift=4,sleep=off", "-display", "none", "-serial", "stdio",
            "-chardev", f"socket,id=test,fd={test.fileno()}",
            "-object", "qtest,id=qtest,chardev=test",
            "-chardev", f"socket,id=monitor,fd={monitor.fileno()}", "-mon", "monitor",
        ]  # fmt: skip
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=(test.fileno(), monitor.fileno()),
        )
        test.close()
        monitor.close()
        self.move_contact(is_open=contact_open)
        self.monitor.sendall(b"cont\n")
        self.first = self.read()  # what comes before is lost, since the UART is not set up
        self.decoder = SerialDecoder()
        self.packets = self.decoder.feed(self.first)

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()
        self.test.close()
        self.monitor.close()

    def command(self, line: str) -> str:
        """Send a command of the protocol qtest and return its result."""
        self.test.sendall(f"{line}\n".encode())
        answer = self.test.recv(1000).decode().split()
        assert answer[0] == "OK"
        return answer[-1]

    def move_contact(self, *, is_open: bool) -> None:
        if self.machine.pin is not None:
            path, number, level_open = self.machine.pin
            level = level_open if is_open else 1 - level_open
            self.command(f"set_irq_in {path} unnamed-gpio-in {number} {level}")

    def read(self) -> bytes:
        """Return bytes of the UART as soon as there are any."""
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], PATIENCE_S)
        assert ready, "the port is silent"
        return os.read(self.process.stdout.fileno(), 4096)

    def send(self, raw: bytes) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(raw)
        self.process.stdin.flush()

    def send_slowly(self, raw: bytes) -> None:
        """Send bytes in parts, and let 10 ms of the port's own time pass after each.

        QEMU hands bytes over as fast as the port takes them, faster than a wire does, so that the
        ring of the UART would be too small.
        """
        for begin in range(0, len(raw), 128):
            self.send(raw[begin : begin + 128])
            self.wait_for(m.Pulse)
            self.wait_for(m.Pulse)

    def wait_for(self, *kinds: type[m.Message]) -> m.Message | None:
        """Return the next message of one of these kinds, None where its payload is too short."""
        ended = time.monotonic() + PATIENCE_S
        while time.monotonic() < ended:
            while self.packets:
                packet = self.packets.pop(0)
                for kind in kinds:
                    if packet.type == kind.TYPE:
                        return kind.unpack(packet.payload)
            self.packets += self.decoder.feed(self.read())
        raise AssertionError(f"none of {kinds} came")

    def wait_for_state(self, state: m.State) -> None:
        pulse = self.wait_for(m.Pulse)
        while not (isinstance(pulse, m.Pulse) and pulse.state == state):
            pulse = self.wait_for(m.Pulse)

    def ask(self, message: m.Message, answer: type[m.Message] = m.Ack) -> m.Message | None:
        """Send a request and return its answer."""
        self.send(encode_frame(encode_packet(Packet.of(message, node=1, ask=True))))
        return self.wait_for(answer, m.Nak)

    def refusal(self, message: m.Message) -> int:
        """Send a request that is refused and return the code."""
        answer = self.ask(message)
        assert isinstance(answer, m.Nak)
        return answer.code

    def status(self) -> m.Status:
        status = self.ask(m.Poll(), m.Status)
        assert isinstance(status, m.Status)
        return status

    def take(self) -> m.Caps:
        """Become the owner and return what CAPS tells."""
        caps = self.ask(m.Hello(session=SESSION, major=m.MAJOR, schema=m.SCHEMA_CRC), m.Caps)
        assert isinstance(caps, m.Caps)
        return caps


Boot = Callable[..., Emulator]


@pytest.fixture
def boot(built: tuple[Path, str]) -> Iterator[Boot]:
    """Return a function that boots a port in QEMU."""
    if shutil.which("qemu-system-arm") is None:
        lack("there is no qemu-system-arm")
    running: list[Emulator] = []

    def begin(port: str, program: Path | None = None, *, contact_open: bool = False) -> Emulator:
        program = program or built[0] / f"{port}.elf"
        running.append(Emulator(port, program, contact_open=contact_open))
        return running[-1]

    yield begin
    for emulator in running:
        emulator.close()


def loaded(elf: bytes) -> dict[int, bytes]:
    """Return the contents of the loadable segments of an ELF file, by their address in flash."""
    assert elf[:5] == b"\x7fELF\x01"
    (offset,) = struct.unpack_from("<I", elf, 28)
    size, count = struct.unpack_from("<HH", elf, 42)
    segments = {}
    for k in range(count):
        kind, at, _, address, length = struct.unpack_from("<5I", elf, offset + k * size)
        if kind == 1 and length > 0:
            segments[address] = elf[at : at + length]
    return segments


def test_every_port_is_built_and_fits_its_part(built: tuple[Path, str]) -> None:
    rows = re.findall(r"^(\S+) +(FLASH|RAM): +(\d+) of +(\d+)$", built[1], re.MULTILINE)
    folders = {path.parent.name for path in PORTS.glob("*/part.ld")}
    assert {port for port, _, _, _ in rows} == folders == set(PARTS)
    for port, memory, used, size in rows:
        part = PARTS[port]
        reserved = 256 if port == "rp2040" and memory == "FLASH" else 0
        whole = 1024 * (part.ram_kb if memory == "RAM" else part.flash_kb)
        assert 0 < int(used) < int(size) == whole - reserved


@pytest.mark.parametrize("port", PARTS)
def test_main_is_short(port: str) -> None:
    assert len((PORTS / port / "main.c").read_text("utf-8").splitlines()) <= 300


@pytest.mark.parametrize("port", PARTS)
def test_table_of_vectors_leads_to_the_program(port: str, built: tuple[Path, str]) -> None:
    part = PARTS[port]
    table = part.flash + (256 if port == "rp2040" else 0)
    segment = loaded((built[0] / f"{port}.elf").read_bytes())[table]
    stack, reset = struct.unpack_from("<II", segment)
    assert stack == part.top
    assert reset & 1, "Thumb code"
    assert table < reset < table + len(segment) < part.flash + 1024 * part.flash_kb


def test_second_stage_of_boot_has_the_checksum_that_the_boot_rom_expects(
    built: tuple[Path, str],
) -> None:
    """The CRC-32 is that of zlib with the bits of all bytes, and of the result, reversed."""
    stage = loaded((built[0] / "rp2040.elf").read_bytes())[PARTS["rp2040"].flash][:256]
    mirrored = bytes(int(f"{byte:08b}"[::-1], 2) for byte in stage[:252])
    inverse = binascii.crc32(mirrored) ^ 0xFFFFFFFF
    assert struct.unpack("<I", stage[252:]) == (int(f"{inverse:032b}"[::-1], 2),)
    assert any(stage[:252])


def test_codes_and_delimiters_keep_their_times(tmp_path: Path) -> None:
    """What the ports share is tested on this computer, whose compiler is `cc`."""
    if shutil.which("cc") is None:
        lack("there is no cc")
    assert make(tmp_path, "check")[0] == 0


@EMULATED
def test_port_boots_and_tells_what_it_is(port: str, boot: Boot) -> None:
    emulator = boot(port)
    assert emulator.first.startswith(b"\0"), "a sender that starts sends a delimiter first"
    caps = emulator.take()
    assert caps.name.rstrip(b"\0").decode() == port
    assert caps.session == SESSION
    assert caps.features & m.Feature.ESTOP_INPUT
    status = emulator.status()
    assert (status.state, status.session, status.inputs) == (m.State.IDLE, SESSION, 0)


@EMULATED
def test_clock_goes_on_and_answers_are_prompt_by_it(port: str, boot: Boot) -> None:
    emulator = boot(port)
    tick_hz = emulator.take().tick_hz
    latest = 0
    for k in range(5):
        reply = emulator.ask(m.Time(host_time=k), m.TimeReply)
        assert isinstance(reply, m.TimeReply)
        assert reply.host_time == k
        assert latest < reply.received <= reply.sent < reply.received + tick_hz // 500
        latest = reply.sent


@EMULATED
def test_bad_packets_are_counted_and_dropped(port: str, boot: Boot) -> None:
    emulator = boot(port)
    limit = emulator.take().packet_limit
    packet = encode_packet(Packet.of(m.Poll(), node=1, ask=True))
    damaged = packet[:-1] + bytes([packet[-1] ^ 1])
    emulator.send_slowly(encode_frame(damaged) + b"\5\1\0" + b"\0\0" + b"\xff" * 2 * limit + b"\0")
    status = emulator.status()
    assert (status.crc_errors, status.malformed, status.oversized) == (1, 1, 1)
    assert emulator.refusal(m.Arm(session=SESSION + 1)) == m.NakCode.SESSION


@EMULATED
def test_without_heartbeats_the_high_voltage_goes_off(port: str, boot: Boot) -> None:
    emulator = boot(port)
    rate = emulator.take().rate_max_hz
    assert isinstance(emulator.ask(m.Arm(session=SESSION, sample_rate_hz=rate)), m.Ack)
    emulator.wait_for_state(m.State.SAFE)
    assert emulator.status().watchdogs == 1


@pytest.mark.parametrize("port", [port for port in MACHINES if MACHINES[port].pin])
def test_open_contact_forbids_high_voltage(port: str, boot: Boot) -> None:
    emulator = boot(port, contact_open=True)
    rate = emulator.take().rate_max_hz
    arm = m.Arm(session=SESSION, sample_rate_hz=rate)
    status = emulator.status()
    assert (status.state, status.inputs, status.trips) == (m.State.ESTOP, 1, 1)
    assert status.estop_reason == m.EstopReason.INPUT
    clear = m.ClearFault(session=SESSION, trips=status.trips)
    assert emulator.refusal(arm) == m.NakCode.ESTOP
    assert emulator.refusal(clear) == m.NakCode.INPUT_OPEN
    emulator.move_contact(is_open=False)
    while isinstance(emulator.ask(clear), m.Nak):  # until the contact has been at rest
        pass
    assert isinstance(emulator.ask(arm), m.Ack)
    emulator.move_contact(is_open=True)
    emulator.wait_for_state(m.State.ESTOP)


@pytest.fixture
def terminal(built: tuple[Path, str]) -> Iterator[str]:
    """Boot the Cortex-M3 and return the path of its UART, which is kept open as QEMU demands."""
    if shutil.which("qemu-system-arm") is None:
        lack("there is no qemu-system-arm")
    command = ["qemu-system-arm", "-M", MACHINES["qemu-m3"].name, "-display", "none"]
    command += ["-monitor", "none", "-serial", "pty", "-kernel", str(built[0] / "qemu-m3.elf")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        path = process.stdout.readline().split()[4]
        line = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(line)
        poll = encode_frame(encode_packet(Packet.of(m.Poll(), node=1, ask=True)))
        ended = time.monotonic() + PATIENCE_S
        while not select.select([line], [], [], 0.2)[0] and time.monotonic() < ended:
            os.write(line, poll)  # until QEMU notices that the terminal is open
        yield path
        os.close(line)
        process.kill()


@pytest.mark.realtime
def test_vectors_pass_on_the_link(terminal: str, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"state-hello-idle", "state-hello-armed", "state-arm-idle", "state-start-idle"}
    chosen = [scenario for scenario in load_scenarios() if scenario.id in names]
    monkeypatch.setattr(conformance, "load_scenarios", lambda: chosen)
    with conformance.Conformance(f"serial://{terminal}") as test:
        report = test.run()
    assert {result.id: result.verdict for result in report.results} == dict.fromkeys(
        names, "passed"
    )


def test_forbidden_configuration_does_not_start_and_is_named(boot: Boot, tmp_path: Path) -> None:
    """The watchdog resets the part, so that the line comes again and again."""
    sizes = "qemu-m3_SIZES=-DTA_CHANNELS=24 -DTA_FIFO=100 -DTA_PACKET_MAX=1024"
    line = b"not started: fifo_samples is 100, and has to be at least 512\n"
    status, text = make(tmp_path, "qemu-m3", sizes)
    assert status == 0, text
    emulator = boot("qemu-m3", tmp_path / "qemu-m3.elf")
    emulator.send(encode_frame(encode_packet(Packet.of(m.Poll(), node=1, ask=True))))
    printed = emulator.first
    while printed.count(b"\n") < 2:
        printed += emulator.read()
    # a reader that was held up gets more than two lines at once
    assert set(printed.splitlines(keepends=True)[: printed.count(b"\n")]) == {line}
    assert int(emulator.command("readl 0x400053FC"), 16) & 0x10 == 0, "the high voltage"


@pytest.mark.parametrize("ci", [True, False])
def test_a_missing_tool_is_a_failure_in_ci_and_a_skip_elsewhere(tmp_path: Path, ci: bool) -> None:
    status, printed = make(tmp_path, "ARM=nosuch-", ci=ci)
    assert (status != 0) is ci
    assert printed.startswith("skipped: there is no nosuch-gcc\n")


def test_a_compiler_without_the_library_is_named(tmp_path: Path) -> None:
    """The compiler of the computer itself has no newlib."""
    assert make(tmp_path, "ARM=", ci=False) == (0, "skipped: there is no newlib for gcc\n")
