"""``audio:``, amplifiers connected to the outputs of an audio card.

``audio:NAME?channels=24`` opens the output device whose name contains NAME, or whose number is
NAME; ``audio:`` opens the default device. The drive is rendered at the card's own sample rate
unless another rate is requested that the card supports. By default as many channels are opened as
the display has. Additional channels stay at 0 V.

An audio card has no limits, fades or e-stop. The last stage of the amplifier therefore runs in
memory, in step with the card (`tactile.bus.audio.player`): if the program that writes goes silent,
the drive fades within its fade time, and the same happens when the host process dies. What a card
does when the whole computer dies is unknown.

The display file contains the calibration: ``[amplifier] audio_full_scale_v`` is the drive voltage
at digital full scale. ``ac_coupling_hz`` is the corner frequency of the high-pass filter of an
AC-coupled output; without it DC coupling is assumed. The high-pass is not equalized, because the
equalizer's filter of a few milliseconds has no effect at 10 Hz (its error there would be 13 % for a
corner of 1 Hz, whereas the error without equalization is 10 %). Behind the high-pass the electrodes
return to rest as exp(−2π corner t) after the drive does, also in an e-stop, and may reach twice the
voltage limit of the drive; `AudioBus.status` and the check of the display file's field report that.
"""

import math
import threading
from collections.abc import Iterator
from dataclasses import replace
from urllib.parse import quote, unquote

import numpy as np

from tactile.arrays import Floats
from tactile.bus.audio import process as audio_process
from tactile.bus.audio.player import Order, PlayerStatus
from tactile.bus.audio.process import ANSWER, AudioProcess, opened_stream
from tactile.bus.base import Bus, BusStatus, DisplayLike, DriveBlock, Wiring
from tactile.bus.board import MOST_CHANNELS
from tactile.bus.options import Options
from tactile.bus.registry import Address, FoundDevice, register_bus
from tactile.errors import BusError, InputError

PIECE = 256
"""Number of samples that are sent to the player at once."""
SILENT = 0.3
"""Time without a buffer request after which a card counts as lost [s].

Four times the card's latency is added to it.
"""
ESTOP = 0.1
"""Time limit for the card to take an e-stop, after which its player is killed [s].

Killing the player ends the card's output.
"""
FRESH = 20e-3
"""Longest time for which the player's reported state is extrapolated [s]."""
RETRY = 1.0
"""Interval between attempts to reopen a card that was lost [s]."""
BAND_START = 20.0
"""Lower limit of a display's frequency band [Hz]."""
MISSING = (
    "audio: the display file lacks [amplifier] audio_full_scale_v: play a 100 Hz sine at digital "
    "full scale with no bimorph connected, and give the peak at the amplifier's output [V] "
    "divided by its gain in the file"
)
"""Error message for a display file without calibration."""


class AudioBus(Bus):
    """Amplifiers connected to an audio card.

    Parameters
    ----------
    order : Order
        Description of the stream to be opened.
    coupling : float
        Corner frequency of the outputs' high-pass filter [Hz]; 0 for DC-coupled outputs.

    Attributes
    ----------
    device : str
        Name of the card and of its sound system.
    latency : float
        Latency of the card's own buffers [s]. Samples are written ahead of it by
        `PlayerStatus.lead`.

    Raises
    ------
    InputError
        If the order cannot be met, or the device is not found.
    BusError
        If the card cannot be opened.
    """

    on_host_death = "unknown"

    def __init__(self, order: Order, coupling: float = 0.0) -> None:
        player = AudioProcess(order)
        stream = opened_stream(player)
        super().__init__(stream.wiring)
        self.device, self.latency = stream.device, stream.latency
        self._order = replace(order, sample_rate=stream.wiring.sample_rate)
        self._coupling = coupling
        self._player: AudioProcess | None = player
        self._opening: AudioProcess | None = None
        self._guard = threading.RLock()
        self._retry_at, self._problem, self._last_fault = 0.0, "", ""
        self._counted = (0, 0, 0)
        self._started_player: AudioProcess | None = None
        self._block = 0
        self._recent_output: Floats = np.zeros((0, stream.wiring.channels))

    # State

    @property
    def output(self) -> Floats:
        """Drive voltages of the last second outside of rest, array (S, C) [V]."""
        player = self._player
        if player is not None:
            player.output = None
            player.request("output")
            if player.output is not None:
                self._recent_output = player.output
        return self._recent_output

    @property
    def about(self) -> str:
        """Description of the card and the stream in one line."""
        coupled = f"AC coupled at {self._coupling:g} Hz" if self._coupling else "assumed DC coupled"
        return (
            f"{self.device}: {self._order.channels} channels at {self.wiring.sample_rate:g} Hz, "
            f"{self.latency * 1e3:.1f} ms in the card, {coupled}"
        )

    @property
    def player_status(self) -> PlayerStatus | None:
        """Present state of the player; None if the card is lost."""
        player = self._checked_player()
        if player is None:
            return None
        report = player.request()
        self._count(report)
        return report

    @property
    def status(self) -> BusStatus:
        """Present state of the bus."""
        if self.state != "closed" and self.player_status is None:
            self._checked_player()
        state, up = self.state, self._player is not None
        detail = self._problem or self._coupling_remark()
        playing = state == "running" and up
        return BusStatus(state, "up" if up else "down", detail, playing, self._last_fault)

    def _has_fallen(self) -> bool:
        return self._checked_player() is not self._started_player

    def _coupling_remark(self) -> str:
        """Return a remark on AC coupling, empty for DC-coupled outputs."""
        if not self._coupling:
            return ""
        loss = 10 * math.log10(1 + (self._coupling / BAND_START) ** 2)
        settling = 3 / (2 * math.pi * self._coupling)
        return (
            f"AC coupled at {self._coupling:g} Hz, not equalized: {BAND_START:g} Hz is "
            f"{loss:.1f} dB weak, and after the drive, also in an e-stop, electrodes take "
            f"{settling:.2g} s to 5 %"
        )

    def _count(self, report: PlayerStatus | None) -> None:
        """Add what the player has counted since the last report to the counters."""
        if report is None:
            return
        late, dropped, underruns = self._counted
        self._counted = report.late_blocks, report.dropped_samples, report.underruns + report.xruns
        self.counters.late_blocks += self._counted[0] - late
        self.counters.dropped_samples += self._counted[1] - dropped
        self.counters.underruns += self._counted[2] - underruns

    @property
    def ahead(self) -> float:
        """Lead over the card, plus the latency of the card's own buffers [s]."""
        player = self._player
        report = None if player is None else player.status
        return self.latency + (report.lead / self.wiring.sample_rate if report is not None else 0.0)

    # Loss and recovery of the card

    def _checked_player(self) -> AudioProcess | None:
        """Return the player; give up one that has failed, and try to open another."""
        with self._guard:
            player = self._player
            if player is not None:
                report = player.status
                if player.ended:
                    self._lose("its player has ended")
                elif report is not None and report.fault:
                    self._lose(f"its player gave up: {report.fault}")
                elif report is not None and report.age > SILENT + 4 * self.latency:
                    self._lose("it asks for nothing")
            elif self.state != "closed":
                self._reopen()
            return self._player

    def _lose(self, why: str) -> None:
        """Kill the player and count the card as lost."""
        with self._guard:
            player, self._player = self._player, None
            if player is None:
                return
            self._problem = f"{self.device} is lost: {why}"
            if player is self._started_player:
                self._last_fault = self._problem
            self.counters.disconnects += 1
            self._retry_at = self._clock.now() + RETRY
            player.kill()

    def _reopen(self) -> None:
        """Open the card again without waiting; what played before stays at rest."""
        trial, now = self._opening, self._clock.now()
        if trial is None:
            if now >= self._retry_at:
                self._opening, self._retry_at = (
                    AudioProcess(self._order),
                    now + audio_process.OPENING,
                )
        elif trial.stream is not None:
            self._player, self._opening, self._counted = trial, None, (0, 0, 0)
            self.counters.reconnects += 1
            self._problem = f"{self.device} was lost; stop and start to play on"
        elif trial.ended or now >= self._retry_at:
            self._opening, self._retry_at = None, now + RETRY
            trial.kill()

    # Calls of the base class

    def _start(self, position: int) -> None:
        player = self._checked_player()
        if player is None:
            raise BusError(f"start: the link is down: {self._problem}")
        self._problem = ""
        player.send("start", position)
        if not player.wait_for_card(ANSWER, rest=False) and self.state != "estopped":
            self._lose("it does not start")
            raise BusError(f"start: {self._problem}")
        self._started_player = player

    def _write(self, block: DriveBlock) -> None:
        self._block += 1
        for k in range(0, len(block.volts), PIECE):
            volts = block.volts[k : k + PIECE]
            player = self._wait_for_room(block.position + k)
            if player is None:
                self._drop(block.position + k, len(volts))
            else:
                player.send("samples", block.position + k, self._block, volts)

    def _drop(self, position: int, count: int) -> None:
        self._checked_player()
        super()._drop(position, count)

    def _wait_for_room(self, position: int) -> AudioProcess | None:
        """Wait until a position may be sent; return None if the card does not play."""
        rate = self.wiring.sample_rate
        while self.state == "running":
            player = self._started_player
            if player is None:
                return None
            report = (
                player.status
                if self._clock.now() - player.status_time < FRESH
                else self.player_status
            )
            if report is None:
                self._lose("its player does not answer")
                return None
            playing = report.phase == "playing"
            since = report.age + self._clock.now() - player.status_time if playing else 0.0
            ahead = (
                position - report.lead - report.position - min(since, FRESH + self.latency) * rate
            )
            if ahead <= 0:
                return player
            if report.phase == "waiting":
                player.send("go")
                player.status_time = 0.0
            self._clock.sleep(min(max(ahead / rate, 5e-4), ANSWER / 10))
        return None

    def _stop(self) -> None:
        report = self.player_status
        queued = 0 if report is None else max(0, self._next - report.position)
        self._end_playback("stop", ANSWER + queued / self.wiring.sample_rate)

    def _abort(self) -> None:
        self._end_playback("abort", ANSWER)

    def _estop(self) -> None:
        self._end_playback("estop", ESTOP)

    def _end_playback(self, how: str, seconds: float) -> None:
        """Send a message that ends playback; kill the player if it is not at rest in time."""
        player = self._player
        if player is None:
            return
        player.send(how, seconds=seconds)
        if not player.wait_for_card(seconds):
            self._lose(f"it did not {how} in {seconds:.1f} s")
        self._count(player.status)
        self._started_player = None

    def _clear(self) -> None:
        player = self._checked_player()
        if player is None:
            raise BusError(f"clear: the link is down: {self._problem}")
        player.send("clear")
        cleared, report = player.wait_for_card(ANSWER), player.status
        if not cleared or report is None or report.refused:
            why = report.refused if report is not None and report.refused else "no answer"
            raise BusError(f"clear: {why}; it stays e-stopped")

    def _close(self) -> None:
        with self._guard:
            _ = self.output
            for player in (self._player, self._opening):
                if player is not None:
                    player.close()
            self._player = self._opening = None


def find() -> Iterator[FoundDevice]:
    """Yield the output devices of PortAudio; none if PortAudio is missing.

    Yields
    ------
    FoundDevice
        URL and description of an output device.
    """
    player = AudioProcess(None)
    player.wait(
        lambda: player.listed is not None or player.failed is not None, audio_process.OPENING
    )
    player.close()
    devices, default = player.listed or ([], -1)
    names = [d.name for d in devices]
    for d in devices:
        name = d.name if names.count(d.name) == 1 else str(d.number)
        usual = ", the default" if d.number == default else ""
        yield FoundDevice(
            f"audio:{quote(name, safe=' :,()')}",
            f"{d.name} ({d.api}), {d.channels} channels, {d.rate:g} Hz{usual}",
        )


class AudioOptions(Options, frozen=True, kw_only=True):
    """Options of a URL ``audio:NAME?option=value&…``.

    Attributes
    ----------
    channels : int or None
        Number of outputs that are opened, at least and by default the channels of the display.
    """

    channels: int | None = None


def _channels(options: AudioOptions, display: DisplayLike) -> int:
    """Return how many channels to open for a display."""
    count = display.channels if options.channels is None else options.channels
    if count < display.channels:
        raise InputError(f"audio: channels = {count}: must be a number from {display.channels} up")
    if display.channels > MOST_CHANNELS:
        raise InputError(f"audio: {display.channels} channels; {MOST_CHANNELS} at most")
    return count


def _open(
    address: Address[AudioOptions], display: DisplayLike, sample_rate: float | None
) -> AudioBus:
    """Open a bus for a display, at a sample rate [Hz] or at the card's own."""
    channels = _channels(address.options, display)
    full_scale = display.amplifier.audio_full_scale
    if full_scale is None:
        raise InputError(MISSING)
    if display.limits.voltage > full_scale:
        raise InputError(
            f"audio: limits.voltage_v = {display.limits.voltage:g} exceeds audio_full_scale_v = "
            f"{full_scale:g}: the card would clip; lower the limit"
        )
    order = Order(
        device=unquote(address.path), channels=channels, sample_rate=sample_rate,
        wiring=Wiring.of(display, sample_rate or math.nan), full_scale=full_scale,
    )  # fmt: skip
    return AudioBus(order, display.amplifier.ac_coupling)


register_bus("audio", _open, AudioOptions, takes_path=True, on_host_death="unknown", find=find)
