"""Amplifier in memory, with the host's end of the line to it.

Its sample clock advances only by the samples that are played and by the ramps that end playing, so
its owner sets the speed: the mock bus plays as fast as it is written to, an audio card or a chip
without firmware as fast as the hardware plays. The samples that it returns have passed the output
stage of the amplifier, which bridges gaps, fades and keeps the limits.
"""

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.capabilities import config_fault
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.correlation import Sensor
from firmware_protocol.host import BY_HOST, SKIPPED, AmplifierHost, codes_of, pcm, refusal
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FADE_MS, FULL_SCALE_CODE, HEARTBEAT_MS, SampleFormat, State
from firmware_protocol.packet import TURN, Packet, encode_packet
from firmware_protocol.player import distance
from firmware_protocol.ports import SerialPort
from firmware_protocol.serial_link import SerialDecoder, encode_frame
from tactile.arrays import Floats
from tactile.bus.amplifier_guards import AmplifierGuards
from tactile.bus.base import Wiring
from tactile.bus.correlations import MeasurementQueue, WindowDecoder
from tactile.bus.guards import GuardSettings
from tactile.bus.marks import AmplifierMarks
from tactile.errors import BusError, InputError

MOST_CHANNELS = 255
"""Maximum number of channels of one amplifier; wider arrays have several."""
CHUNK = 64
"""Number of samples that are sent before they are played."""
SESSION = 1
"""Session token; it need not be random, because no other host is on this line."""
STEEPEST = 10**8
"""Largest slew limit that is sent to an amplifier [V/s]."""


class Board:
    """One amplifier in memory and the host's end of the line to it.

    Methods return at once, and are called by one thread at a time.

    Parameters
    ----------
    config : AmplifierConfig
        Capabilities and limits of the amplifier.
    sample_format : SampleFormat
        Format in which samples are sent to it.
    sensor : Sensor or None
        What measures its currents; None if it does not.
    windows : MeasurementQueue or None
        Queue that takes the windows of correlated currents, and what guards and marker lines
        report.

    Attributes
    ----------
    amplifier : ReferenceAmplifier
        The amplifier.
    host : AmplifierHost
        Host's side of the session, which has the latest answers.
    lines : (S,) array of int
        Codes on the marker lines during the samples that were returned last.
    """

    def __init__(
        self,
        config: AmplifierConfig,
        sample_format: SampleFormat,
        sensor: Sensor | None = None,
        windows: MeasurementQueue | None = None,
    ) -> None:
        self.amplifier = ReferenceAmplifier(config, sensor)
        self._windows = windows or MeasurementQueue()
        self._window_decoder = WindowDecoder(self._windows.counters, 0)
        self.host = AmplifierHost(SESSION, config.node)
        self._port, self._decoder = SerialPort(self.amplifier), SerialDecoder()
        self._format = sample_format
        self._now = self._heartbeat = self._offset = self._sent = 0
        self._marks = AmplifierMarks(1.0)
        self.lines: NDArray[np.uint8] = np.zeros(0, np.uint8)
        self.request(m.Hello(SESSION, m.MAJOR, m.MINOR, m.SCHEMA_CRC))
        self._guards = self._guards_from(0)

    @property
    def _caps(self) -> m.Caps:
        """Capabilities of the amplifier, which HELLO has asked for."""
        assert self.host.caps is not None
        return self.host.caps

    def _guards_from(self, position: int) -> AmplifierGuards:
        """Return the guards since a START at a position."""
        return AmplifierGuards(self._windows.counters, self._caps, 0, position)

    def _send(self, packet: Packet) -> None:
        """Pass a packet to the amplifier, and its answers to the host."""
        self._port.feed(encode_frame(encode_packet(packet)), self._now)
        self._receive()

    def _receive(self) -> None:
        """Take what the amplifier has sent."""
        for packet in self._decoder.feed(self._port.take()):
            message = self.host.receive(packet)
            if isinstance(message, m.Correlation):
                self._add_window(message)
            elif isinstance(message, m.Guarded):
                self._add_report(message)
            elif isinstance(message, m.Marked) and (mark := self._marks.report(message)):
                self._windows.add(mark)
        if self.amplifier.config.sense_ranges_ua:
            counters = self.amplifier.counters
            self._windows.counters.disturbed = counters.lost_samples + counters.limited_samples

    def _add_window(self, message: m.Correlation) -> None:
        """Add a window of correlated currents to the queue, if it is right."""
        position = self._position_of(message.position)
        window = self._window_decoder.decode(message, self._caps, position, 0)
        if window is not None:
            self._windows.add(window)

    def _add_report(self, message: m.Guarded) -> None:
        """Add what guards have reported to the queue, if it is right."""
        reached = self._position_of(self.amplifier.position)
        report = self._guards.decode(message, self._position_of(message.position), reached)
        if report is not None:
            self._windows.add(report)

    def _position_of(self, wire: int) -> int:
        """Return the position of the owner for one on the wire."""
        return self._sent + distance(wire, self._sent % TURN) - self._offset

    def request(self, message: m.Message) -> None:
        """Send a request.

        Parameters
        ----------
        message : Message
            Request that the amplifier acknowledges or refuses.

        Raises
        ------
        BusError
            If the amplifier refuses it.
        """
        packet = self.host.request(message)
        self._send(packet)
        answer = self.host.answer(packet)
        if isinstance(answer, m.Nak):
            raise BusError(refusal(answer))

    def ask_for_windows(self, milliseconds: int) -> None:
        """Ask for windows of correlated currents.

        Parameters
        ----------
        milliseconds : int
            Length of a window [ms].

        Raises
        ------
        BusError
            If the amplifier does not measure.
        """
        self.request(m.Set(SESSION, m.Parameter.CORRELATION_MS, milliseconds))

    @property
    def guards(self) -> bool:
        """Whether the amplifier has guards."""
        return bool(self._caps.features & m.Feature.GUARDS)

    def set_guards(self, settings: GuardSettings) -> None:
        """Send settings to the guards, if a window of currents has come since the start.

        Parameters
        ----------
        settings : GuardSettings
            Settings of channels.
        """
        self._guards.set(settings, self._window_decoder.range_ua)
        while message := self._guards.take(SESSION):
            self._send(self.host.packet(message))

    def start(self, position: int, rate: int) -> None:
        """Arm the amplifier and begin playing at its next tick.

        Parameters
        ----------
        position : int
            Position of the first sample.
        rate : int
            Sample rate [Hz].

        Raises
        ------
        BusError
            If the amplifier refuses, as it does in an e-stop.
        """
        self.request(m.Arm(SESSION, m.Mode.PCM, rate))
        self._heartbeat = self._now
        self._offset = self._sent + SKIPPED - position
        begin = (self._sent + SKIPPED) % TURN
        self._window_decoder = WindowDecoder(self._windows.counters, begin)
        self._guards = self._guards_from(position)
        self._marks = AmplifierMarks(rate)
        self.request(m.Start(SESSION, begin, time=self._now + 1))

    def mark(self, position: int, code: int) -> None:
        """Let a mark wait until its sample is sent.

        Parameters
        ----------
        position : int
            Position of a sample that has not been sent.
        code : int
            Code for the marker lines.
        """
        self._marks.add(position, code)

    def send(self, position: int, volts: Floats) -> None:
        """Send samples, which wait in the amplifier until `play` puts them out, and their marks.

        Parameters
        ----------
        position : int
            Position of the first sample.
        volts : (S, C) array of float
            Drive voltage, finite and within the full scale [V].
        """
        config = self.amplifier.config
        codes = codes_of(volts, config.full_scale_uv * 1e-6)
        at = position + self._offset
        self._sent = max(self._sent, at + len(codes))
        for mark in self._marks.take(
            position, position + len(codes), SESSION, lambda place: (place + self._offset) % TURN
        ):
            self._send(self.host.packet(mark))
        for message in pcm(
            at, codes, session=SESSION,
            sample_format=self._format, packet_limit=config.packet_limit,
        ):  # fmt: skip
            self._send(self.host.packet(message))

    def play(self, count: int) -> Floats:
        """Put out samples, and feed the watchdog of the amplifier.

        Parameters
        ----------
        count : int
            Number of samples, S.

        Returns
        -------
        (S, C) array of float
            Output of the amplifier [V].
        """
        if self._now - self._heartbeat >= HEARTBEAT_MS * self.amplifier.config.tick_hz // 2000:
            self._send(self.host.packet(m.Heartbeat(SESSION)))
            self._heartbeat = self._now
        return self._volts(self._run(count))

    def end(self, *, quick: bool) -> Floats:
        """Stop, and put out samples until the output is at 0 V; allowed in an e-stop as well.

        Parameters
        ----------
        quick : bool
            Whether to ramp at the slew limit, and not within the fade.

        Returns
        -------
        (S, C) array of float
            Output of the amplifier up to the first run of samples at rest [V].
        """
        self.request(m.Stop(SESSION, quick))
        config = self.amplifier.config
        fade = config.fade_limit_us * config.rate_max_hz // 1_000_000 + 1
        runs: list[PlayedRun] = []
        while not runs or not _is_at_rest(runs[-1]):
            runs += self._run(fade)
        ended = [_is_at_rest(run) for run in runs].index(True)
        return self._volts(runs[: ended + 1])

    def estop(self) -> Floats:
        """Send an e-stop, and put out samples until the output is at 0 V.

        Returns
        -------
        (S, C) array of float
            Output of the amplifier [V]; its last sample is 0 V.
        """
        self._send(self.host.packet(m.Estop(BY_HOST)))
        runs = self._run(1)
        while runs[-1].codes[-1].any():
            runs += self._run(1)
        return self._volts(runs)

    def clear(self) -> None:
        """End an e-stop.

        Raises
        ------
        BusError
            If the amplifier refuses.
        """
        self._send(self.host.request(m.Poll()))
        assert self.host.status is not None
        self.request(m.ClearFault(SESSION, self.host.status.trips))

    def disarm(self) -> None:
        """Switch high voltage off."""
        self.request(m.Disarm(SESSION))

    def _run(self, count: int) -> list[PlayedRun]:
        """Advance the sample clock; return what was put out meanwhile."""
        self._now = self.amplifier.due(count)
        self.amplifier.run(self._now)
        self._receive()
        return self.amplifier.take_played()

    def _volts(self, runs: list[PlayedRun]) -> Floats:
        """Return the output of runs as voltages, and keep their codes on the marker lines."""
        self.lines = np.repeat(
            [run.lines for run in runs], [len(run.codes) for run in runs]
        ).astype(np.uint8)
        codes = np.concatenate([run.codes for run in runs])
        return codes * (self.amplifier.config.full_scale_uv * 1e-6 / FULL_SCALE_CODE)


def _is_at_rest(run: PlayedRun) -> bool:
    """Return whether a run of samples ended the ramp or came after it."""
    return run.state not in (State.RUNNING, State.RAMPDOWN) and not run.codes[-1].any()


def config_of(
    wiring: Wiring,
    channels: int,
    node: int,
    *,
    rates: tuple[int, int] | None = None,
    fifo_ms: float = 64.0,
    sense_ranges_ua: tuple[int, ...] = (),
    marker_lines: int = 0,
) -> AmplifierConfig:
    """Return the configuration of an amplifier with the limits of a display.

    Parameters
    ----------
    wiring : Wiring
        Properties of the display.
    channels : int
        Number of channels of the amplifier, which may be a part of those of the display.
    node : int
        Address of the amplifier, 1 … 127.
    rates : tuple of int, optional
        Lowest and highest sample rate that it plays [Hz]; by default only that of the wiring.
    fifo_ms : float
        Length of its buffer at the highest rate [ms].
    sense_ranges_ua : tuple of int
        Ranges of the current that it measures [µA]; empty if it does not.
    marker_lines : int
        Number of its marker lines.

    Returns
    -------
    AmplifierConfig
        Configuration of the amplifier.

    Raises
    ------
    InputError
        If the sample rate is not a whole number of Hz, an amplifier with this slew limit would not
        be at 0 V within the 20 ms that the protocol promises, or SPEC.md allows no such amplifier.
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
        sense_ranges_ua=sense_ranges_ua, marker_lines=marker_lines,
    )  # fmt: skip
    fault = config_fault(config)
    if fault.startswith("slew_limit_v_per_s"):
        raise InputError(
            f"slew limit {wiring.slew:g} V/s: takes {wiring.voltage / wiring.slew * 1e3:.0f} ms "
            f"from {wiring.voltage:g} V to 0 V, {FADE_MS} ms are promised; lower the voltage limit"
        )
    if fault:
        raise InputError(f"{fault}: the protocol allows no such amplifier (SPEC.md, section 4)")
    return config
