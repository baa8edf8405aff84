"""``mock:``, an amplifier that is not there but behaves: it decodes the frames a real one gets.

What is written goes as packets of the protocol over a serial line in memory to the amplifier of
`firmware_protocol`, whose sample clock stands still but for the samples that are written and the
ramps that end them. So gaps are bridged or fade, limits are the amplifier's, and what was put out
is what the wire could carry. It is remembered: the last second, or with ``?keep=all`` everything;
``?format=pcm16`` (the default), ``pcm12`` or ``bfp8`` chooses how samples are packed.
"""

from collections import deque

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.amplifier import Amplifier
from firmware_protocol.config import Config, LimitsInForce
from firmware_protocol.host import Host, codes_of, pcm, refusal
from firmware_protocol.machine import Played
from firmware_protocol.messages import FADE_MS, FULL_SCALE_CODE, HEARTBEAT_MS, SampleFormat, State
from firmware_protocol.packet import TURN, Packet, encode_packet
from firmware_protocol.ports import SerialPort
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.bus.base import Address, Bus, DriveBlock, Floats, Rig, Wiring, register_bus
from tactile.errors import BusError, InputError
from tactile.files import nearest

MOST_CHANNELS = 255
"""Of one amplifier; wider arrays have several."""
CHUNK = 64
"""Samples that are sent before they are played."""
SESSION = 1
"""Nobody else is on this line."""
SKIPPED = 1 << 20
"""Positions between what was sent before a START and what comes after it (SPEC.md, 8.1)."""
STEEPEST = 10**8
"""V/s, the most that the protocol tells."""
FORMATS = {f.name.lower(): f for f in (SampleFormat.PCM16, SampleFormat.PCM12, SampleFormat.BFP8)}


class Board:
    """One amplifier and the host's end of the line to it.

    Parameters
    ----------
    config : of the amplifier
    sample_format : of its samples
    """

    def __init__(self, config: Config, sample_format: SampleFormat) -> None:
        self.amplifier = Amplifier(config)
        self.host = Host(SESSION, config.node)
        self._port, self._decoder = SerialPort(self.amplifier), SerialDecoder()
        self._format = sample_format
        self._now = self._heartbeat = self._offset = self._sent = 0
        self.request(m.Hello(SESSION, m.MAJOR, m.MINOR, m.SCHEMA_CRC))

    def _send(self, packet: Packet) -> None:
        self._port.feed(encode_frame(encode_packet(packet)), self._now)
        for answer in self._decoder.feed(self._port.take()):
            self.host.receive(answer)

    def request(self, message: m.Message) -> None:
        """Send a request.

        Raises
        ------
        BusError
            Where the amplifier refuses it.
        """
        packet = self.host.ask(message)
        self._send(packet)
        answer = self.host.answer(packet)
        if isinstance(answer, m.Nak):
            raise BusError(refusal(answer))

    def start(self, position: int, rate: int) -> None:
        """Arm, and play from a position on, at once."""
        self.request(m.Arm(SESSION, m.Mode.PCM, rate))
        self._heartbeat = self._now
        self._offset = self._sent + SKIPPED - position
        self.request(m.Start(SESSION, (self._sent + SKIPPED) % TURN, time=self._now + 1))

    def send(self, position: int, volts: Floats) -> None:
        """Send samples (S, C) [V]."""
        config = self.amplifier.config
        codes = codes_of(volts, config.full_scale_uv * 1e-6)
        at = position + self._offset
        self._sent = max(self._sent, at + len(codes))
        for message in pcm(
            at, codes, session=SESSION,
            sample_format=self._format, packet_limit=config.packet_limit,
        ):  # fmt: skip
            self._send(self.host.tell(message))

    def play(self, count: int) -> Floats:
        """Let the amplifier put out samples; return them (S, C) [V]."""
        if self._now - self._heartbeat >= HEARTBEAT_MS * self.amplifier.config.tick_hz // 2000:
            self._send(self.host.tell(m.Heartbeat(SESSION)))
            self._heartbeat = self._now
        return self._volts(self._run(count))

    def end(self, *, quick: bool) -> Floats:
        """Stop, and return what is put out until the ramp has ended (S, C) [V]."""
        self.request(m.Stop(SESSION, quick))
        config = self.amplifier.config
        fade = config.fade_limit_us * config.rate_max_hz // 1_000_000 + 1
        runs: list[Played] = []
        while not runs or runs[-1].state == State.RAMPDOWN:
            runs += self._run(fade)
        ended = [run.state for run in runs].index(State.ARMED)
        return self._volts(runs[: ended + 1])

    def _run(self, count: int) -> list[Played]:
        self._now = self.amplifier.due(count)
        self.amplifier.run(self._now)
        for answer in self._decoder.feed(self._port.take()):
            self.host.receive(answer)
        return self.amplifier.take_played()

    def _volts(self, runs: list[Played]) -> Floats:
        codes = np.concatenate([run.codes for run in runs])
        return codes * (self.amplifier.config.full_scale_uv * 1e-6 / FULL_SCALE_CODE)


class MockBus(Bus):
    """Amplifiers in memory.

    Parameters
    ----------
    wiring : what they drive
    keep : "second" or "all" of the output
    sample_format : on the line

    Raises
    ------
    InputError
        Where the protocol cannot carry the sample rate, or its promise to be at 0 V in time not
        be kept within the slew limit.
    """

    on_host_death = "ramps"

    def __init__(
        self,
        wiring: Wiring,
        *,
        keep: str = "second",
        sample_format: SampleFormat = SampleFormat.PCM16,
    ) -> None:
        super().__init__(wiring)
        self._all = keep == "all"
        self._kept: deque[Floats] = deque()
        self._kept_samples = 0
        self._position = 0
        widths = [
            min(MOST_CHANNELS, wiring.channels - first)
            for first in range(0, wiring.channels, MOST_CHANNELS)
        ]
        self.boards = [
            Board(config_of(wiring, width, node), sample_format)
            for node, width in enumerate(widths, 1)
        ]

    @property
    def output(self) -> Floats:
        """Volts put out (S, C), what is kept of them [V]."""
        return np.concatenate([np.zeros((0, self.wiring.channels)), *self._kept])

    def _start(self, position: int) -> None:
        self._position = position
        for board in self.boards:
            board.start(position, round(self.wiring.sample_rate))

    def _write(self, block: DriveBlock) -> None:
        gap = block.position - self._position
        volts = block.volts
        if gap < 0:
            self.counters.repeated_samples += min(-gap, len(volts))
            volts, gap = volts[-gap:], 0
        self.counters.lost_samples += gap
        self.counters.blocks += 1
        self.counters.samples += len(volts)
        volts = self._allowed(volts)
        if gap > self.wiring.sample_rate * FADE_MS / 1000:
            self._play(gap)
            gap = 0
        for k in range(0, len(volts), CHUNK):
            part = volts[k : k + CHUNK]
            self._send(self._position + gap, part)
            self._play(gap + len(part))
            gap = 0

    def _allowed(self, volts: Floats) -> Floats:
        limit = self.wiring.voltage
        if np.abs(volts).max(initial=0.0) <= limit:
            return volts
        bad = ~np.isfinite(volts)
        volts = np.where(bad, 0.0, volts)
        self.counters.invalid_samples += int(bad.sum())
        self.counters.clipped_samples += int(np.count_nonzero(np.abs(volts) > limit))
        return np.clip(volts, -limit, limit)

    def _send(self, position: int, volts: Floats) -> None:
        for k, board in enumerate(self.boards):
            board.send(position, volts[:, k * MOST_CHANNELS : (k + 1) * MOST_CHANNELS])

    def _play(self, count: int) -> None:
        """Let time pass, a heartbeat's at a time at most."""
        longest = max(1, int(self.wiring.sample_rate) * HEARTBEAT_MS // 1000)
        for k in range(0, count, longest):
            parts = [board.play(min(longest, count - k)) for board in self.boards]
            self._position += len(parts[0])
            self._put(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1))
        self.counters.underruns = sum(b.amplifier.counters.underruns for b in self.boards)

    def _stop(self) -> None:
        self._end(quick=False)

    def _abort(self) -> None:
        self._end(quick=True)

    def _end(self, *, quick: bool) -> None:
        ends = [board.end(quick=quick) for board in self.boards]
        longest = max(len(end) for end in ends)
        self._put(np.hstack([np.pad(end, ((0, longest - len(end)), (0, 0))) for end in ends]))

    def _close(self) -> None:
        for board in self.boards:
            board.request(m.Disarm(SESSION))

    def _put(self, volts: Floats) -> None:
        """Put volts out; a driver with something behind it goes on from here."""
        self._kept.append(volts)
        self._kept_samples += len(volts)
        while not self._all and self._kept_samples - len(self._kept[0]) >= self.wiring.sample_rate:
            self._kept_samples -= len(self._kept.popleft())


def config_of(wiring: Wiring, channels: int, node: int) -> Config:
    """Return the amplifier that drives some channels of a display, its limits the display's."""
    rate = round(wiring.sample_rate)
    if rate != wiring.sample_rate:
        raise InputError(f"sample_rate {wiring.sample_rate:g} Hz: the protocol tells whole Hz")
    voltage = int(wiring.voltage * 1e6)
    config = Config(
        channels=channels, node=node, rate_min_hz=rate, rate_max_hz=rate,
        tick_hz=max(1_000_000, 10 * rate), fifo=max(2 * CHUNK, rate * 64 // 1000 + 1),
        full_scale_uv=voltage, voltage_limit_uv=voltage,
        slew_limit_v_per_s=int(min(wiring.slew, STEEPEST)),
        fade_limit_us=min(max(round(wiring.fade * 1e6), 1), FADE_MS * 1000),
    )  # fmt: skip
    if not LimitsInForce.of(config).in_time(rate):
        raise InputError(
            f"slew limit {wiring.slew:g} V/s: takes {wiring.voltage / wiring.slew * 1e3:.0f} ms "
            f"from {wiring.voltage:g} V to 0 V, {FADE_MS} ms are promised; lower the voltage limit"
        )
    return config


def options(address: Address) -> tuple[str, SampleFormat]:
    """Return the ``keep`` and ``format`` options of an address.

    Raises
    ------
    InputError
        For a value that may not be.
    """
    keep = address.options.get("keep", "second")
    if keep not in ("second", "all"):
        raise InputError(f"{address.scheme}: keep = {keep!r}: must be 'second' or 'all'")
    name = address.options.get("format", "pcm16")
    if name not in FORMATS:
        raise InputError(f"{address.scheme}: format = {name!r}: {nearest(name, list(FORMATS))}")
    return keep, FORMATS[name]


def _open(address: Address, rig: Rig, sample_rate: float) -> MockBus:
    address.only("keep", "format")
    keep, sample_format = options(address)
    return MockBus(Wiring.of(rig, sample_rate), keep=keep, sample_format=sample_format)


register_bus("mock", _open)
