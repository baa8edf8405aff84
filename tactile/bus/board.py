"""An amplifier in memory and the host's end of the line to it.

Its sample clock stands still but for the samples that are played and the ramps that end them, so
that whoever holds it says how fast it runs: the mock as fast as it is written to, an audio card or
a chip without firmware as fast as they play. What is put out has passed the amplifier's own last
stage: bridges, fades, limits.
"""

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig, LimitsInForce
from firmware_protocol.host import AmplifierHost, codes_of, pcm, refusal
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FADE_MS, FULL_SCALE_CODE, HEARTBEAT_MS, SampleFormat, State
from firmware_protocol.packet import TURN, Packet, encode_packet
from firmware_protocol.ports import SerialPort
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.arrays import Floats
from tactile.bus.base import Wiring
from tactile.errors import BusError, InputError

MOST_CHANNELS = 255
"""Of one amplifier; wider arrays have several."""
CHUNK = 64
"""Samples that are sent before they are played."""
SESSION = 1
"""Nobody else is on this line."""
SKIPPED = 1 << 20
"""Positions between what was sent before a START and what comes after it (SPEC.md, 8.1)."""
REASON = 1
"""Of an ESTOP, told by STATUS: a host's."""
STEEPEST = 10**8
"""V/s, the most that the protocol tells."""


class Board:
    """One amplifier and the host's end of the line to it.

    Parameters
    ----------
    config : of the amplifier
    sample_format : of its samples
    """

    def __init__(self, config: AmplifierConfig, sample_format: SampleFormat) -> None:
        self.amplifier = ReferenceAmplifier(config)
        self.host = AmplifierHost(SESSION, config.node)
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
        """Stop, and return what is put out until it is at 0 V (S, C) [V], also in an e-stop."""
        self.request(m.Stop(SESSION, quick))
        config = self.amplifier.config
        fade = config.fade_limit_us * config.rate_max_hz // 1_000_000 + 1
        runs: list[PlayedRun] = []
        while not runs or not _rests(runs[-1]):
            runs += self._run(fade)
        ended = [_rests(run) for run in runs].index(True)
        return self._volts(runs[: ended + 1])

    def estop(self) -> Floats:
        """Stop for good, and return what is put out until it is at 0 V (S, C) [V]."""
        self._send(self.host.tell(m.Estop(REASON)))
        runs = self._run(1)
        while runs[-1].codes[-1].any():
            runs += self._run(1)
        return self._volts(runs)

    def clear(self) -> None:
        """End an e-stop; raises BusError where the amplifier refuses."""
        self._send(self.host.ask(m.Poll()))
        assert self.host.status is not None
        self.request(m.ClearFault(SESSION, self.host.status.trips))

    def disarm(self) -> None:
        """Take high voltage away."""
        self.request(m.Disarm(SESSION))

    def _run(self, count: int) -> list[PlayedRun]:
        self._now = self.amplifier.due(count)
        self.amplifier.run(self._now)
        for answer in self._decoder.feed(self._port.take()):
            self.host.receive(answer)
        return self.amplifier.take_played()

    def _volts(self, runs: list[PlayedRun]) -> Floats:
        codes = np.concatenate([run.codes for run in runs])
        return codes * (self.amplifier.config.full_scale_uv * 1e-6 / FULL_SCALE_CODE)


def _rests(run: PlayedRun) -> bool:
    """Tell whether a run of instants ended the ramp, or came after it."""
    return run.state not in (State.RUNNING, State.RAMPDOWN) and not run.codes[-1].any()


def config_of(
    wiring: Wiring,
    channels: int,
    node: int,
    *,
    rates: tuple[int, int] | None = None,
    fifo_ms: float = 64.0,
) -> AmplifierConfig:
    """Return the amplifier that drives some channels of a display, its limits the display's.

    It plays the display's sample rate, or ``rates`` from the one to the other [Hz], and keeps
    ``fifo_ms`` of the highest.

    Raises
    ------
    InputError
        Where the protocol cannot carry the sample rate, or its promise to be at 0 V in time not
        be kept within the slew limit.
    """
    rate = round(wiring.sample_rate)
    if rate != wiring.sample_rate:
        raise InputError(f"sample_rate {wiring.sample_rate:g} Hz: the protocol tells whole Hz")
    lowest, highest = rates or (rate, rate)
    voltage = int(wiring.voltage * 1e6)
    config = AmplifierConfig(
        channels=channels, node=node, rate_min_hz=lowest, rate_max_hz=highest,
        tick_hz=max(1_000_000, 10 * highest),
        fifo=max(2 * CHUNK, int(highest * fifo_ms) // 1000 + 1),
        full_scale_uv=voltage, voltage_limit_uv=voltage,
        slew_limit_v_per_s=int(min(wiring.slew, STEEPEST)),
        fade_limit_us=min(max(round(wiring.fade * 1e6), 1), FADE_MS * 1000),
    )  # fmt: skip
    limits = LimitsInForce.of(config)
    if not all(limits.in_time(one) for one in (lowest, rate, highest)):
        raise InputError(
            f"slew limit {wiring.slew:g} V/s: takes {wiring.voltage / wiring.slew * 1e3:.0f} ms "
            f"from {wiring.voltage:g} V to 0 V, {FADE_MS} ms are promised; lower the voltage limit"
        )
    return config
