"""``audio:``, amplifiers behind the outputs of an audio card.

``audio:NAME?channels=24`` opens the output whose name contains NAME, or has that number;
``audio:`` the default one. Drive is rendered at the card's own sample rate unless another is asked
for that it plays. ``channels`` are opened, the display's by default; spare ones stay at 0 V.

A card knows nothing of limits, fades or an e-stop, so the amplifier's last stage runs in memory, at
the card's pace (`audio_player`): a writer that goes silent fades within its fade time, and so does
a host that dies. What a card does whose computer dies nobody knows.

The display file calibrates it: ``[amplifier] audio_full_scale_v`` are the volts of drive that
digital full scale stands for. ``ac_coupling_hz`` is the corner of the high-pass of an output that
is not DC coupled; without it DC coupling is assumed. It is not equalized: the equalizer's filter of
a few milliseconds has no hold on 10 Hz (its error there would be 13 % for a corner of 1 Hz, where
leaving it alone costs 10 %). Behind it electrodes come to rest exp(−2π corner t) after the drive
does, also in an e-stop, and may see twice the drive's limit; `status` and the display's check of
its field say so.
"""

import math
import threading
from collections.abc import Iterator
from dataclasses import replace
from urllib.parse import quote, unquote

import numpy as np

from tactile.arrays import Floats
from tactile.bus.audio import process as audio_process
from tactile.bus.audio.player import Order, Told
from tactile.bus.audio.process import ANSWER, AudioProcess, opened
from tactile.bus.base import Bus, BusStatus, DisplayLike, DriveBlock, Wiring
from tactile.bus.board import MOST_CHANNELS
from tactile.bus.options import Options
from tactile.bus.registry import Address, Found, register_bus
from tactile.errors import BusError, InputError

PIECE = 256
"""Samples that are handed on at once."""
SILENT = 0.3
"""s, and four of its buffers, that a card may ask for nothing."""
ESTOP = 0.1
"""s after which an e-stop that the card has not taken ends its player, and so its output."""
FRESH = 20e-3
"""s for which what the player told is extrapolated."""
RETRY = 1.0
"""s between attempts to open a card again that was lost."""
HEARD = 20.0
"""Hz, where a display's band begins."""
MISSING = (
    "audio: the display file lacks [amplifier] audio_full_scale_v: play a 100 Hz sine at digital "
    "full scale with no bimorph connected, and give the peak at the amplifier's output [V] "
    "divided by its gain in the file"
)


class AudioBus(Bus):
    """Amplifiers behind an audio card.

    Parameters
    ----------
    order : what to open
    coupling : corner of the outputs' high-pass [Hz], 0 for DC coupled ones

    Attributes
    ----------
    device : the card's name and sound system
    latency : of the card's own buffers, beside which `Told.lead` is written ahead [s]

    Raises
    ------
    InputError, BusError
        Where it cannot be opened.
    """

    on_host_death = "unknown"

    def __init__(self, order: Order, coupling: float = 0.0) -> None:
        player = AudioProcess(order)
        found = opened(player)
        super().__init__(found.wiring)
        self.device, self.latency = found.device, found.latency
        self._order = replace(order, sample_rate=found.wiring.sample_rate)
        self._coupling = coupling
        self._player: AudioProcess | None = player
        self._opening: AudioProcess | None = None
        self._guard = threading.RLock()
        self._retry_at, self._trouble = 0.0, ""
        self._base = (0, 0, 0)
        self._begun: AudioProcess | None = None
        self._block = 0
        self._kept: Floats = np.zeros((0, found.wiring.channels))

    # What is told

    @property
    def output(self) -> Floats:
        """Volts put out (S, C), the last second of what was not rest [V]."""
        player = self._player
        if player is not None:
            player.output = None
            player.ask("output")
            if player.output is not None:
                self._kept = player.output
        return self._kept

    @property
    def about(self) -> str:
        """What is played on, one line."""
        coupled = f"AC coupled at {self._coupling:g} Hz" if self._coupling else "assumed DC coupled"
        return (
            f"{self.device}: {self._order.channels} channels at {self.wiring.sample_rate:g} Hz, "
            f"{self.latency * 1e3:.1f} ms in the card, {coupled}"
        )

    @property
    def told(self) -> Told | None:
        """How the player stands now; None where the card is lost."""
        player = self._tended()
        if player is None:
            return None
        told = player.ask()
        self._count(told)
        return told

    @property
    def status(self) -> BusStatus:
        """How it stands now."""
        if self.state != "closed" and self.told is None:
            self._tended()
        state, up = self.state, self._player is not None
        detail = self._trouble or self._remark()
        return BusStatus(state, "up" if up else "down", detail, state == "running" and up)

    def _has_fallen(self) -> bool:
        return self._tended() is not self._begun

    def _remark(self) -> str:
        if not self._coupling:
            return ""
        loss = 10 * math.log10(1 + (self._coupling / HEARD) ** 2)
        rest = 3 / (2 * math.pi * self._coupling)
        return (
            f"AC coupled at {self._coupling:g} Hz, not equalized: {HEARD:g} Hz is {loss:.1f} dB "
            f"weak, and after the drive, also in an e-stop, electrodes take {rest:.2g} s to 5 %"
        )

    def _count(self, told: Told | None) -> None:
        if told is None:
            return
        late, dropped, underruns = self._base
        self._base = told.late_blocks, told.dropped_samples, told.underruns + told.xruns
        self.counters.late_blocks += self._base[0] - late
        self.counters.dropped_samples += self._base[1] - dropped
        self.counters.underruns += self._base[2] - underruns

    @property
    def ahead(self) -> float:
        """The lead over the card, and the card's own buffers [s]."""
        player = self._player
        told = None if player is None else player.told
        return self.latency + (told.lead / self.wiring.sample_rate if told is not None else 0.0)

    # The card comes and goes

    def _tended(self) -> AudioProcess | None:
        """Return the player; see to one that has failed, and to another one."""
        with self._guard:
            player = self._player
            if player is not None:
                told = player.told
                if player.ended:
                    self._lose("its player has ended")
                elif told is not None and told.fault:
                    self._lose(f"its player gave up: {told.fault}")
                elif told is not None and told.age > SILENT + 4 * self.latency:
                    self._lose("it asks for nothing")
            elif self.state != "closed":
                self._reopen()
            return self._player

    def _lose(self, why: str) -> None:
        with self._guard:
            player, self._player = self._player, None
            if player is None:
                return
            self._trouble = f"{self.device} is lost: {why}"
            self.counters.disconnects += 1
            self._retry_at = self._clock.now() + RETRY
            player.kill()

    def _reopen(self) -> None:
        """Open the card again, without waiting; what played stays at rest."""
        trial, now = self._opening, self._clock.now()
        if trial is None:
            if now >= self._retry_at:
                self._opening, self._retry_at = (
                    AudioProcess(self._order),
                    now + audio_process.OPENING,
                )
        elif trial.opened is not None:
            self._player, self._opening, self._base = trial, None, (0, 0, 0)
            self.counters.reconnects += 1
            self._trouble = f"{self.device} was lost; stop and start to play on"
        elif trial.ended or now >= self._retry_at:
            self._opening, self._retry_at = None, now + RETRY
            trial.kill()

    # Who calls

    def _start(self, position: int) -> None:
        player = self._tended()
        if player is None:
            raise BusError(f"start: the link is down: {self._trouble}")
        self._trouble = ""
        player.tell("start", position)
        if not player.settled(ANSWER, rest=False) and self.state != "estopped":
            self._lose("it does not start")
            raise BusError(f"start: {self._trouble}")
        self._begun = player

    def _write(self, block: DriveBlock) -> None:
        self._block += 1
        for k in range(0, len(block.volts), PIECE):
            volts = block.volts[k : k + PIECE]
            player = self._room(block.position + k)
            if player is None:
                self._drop(block.position + k, len(volts))
            else:
                player.tell("samples", block.position + k, self._block, volts)

    def _drop(self, position: int, count: int) -> None:
        self._tended()
        super()._drop(position, count)

    def _room(self, position: int) -> AudioProcess | None:
        """Wait until a position is near; None where the card does not play."""
        rate = self.wiring.sample_rate
        while self.state == "running":
            player = self._begun
            if player is None:
                return None
            told = player.told if self._clock.now() - player.told_at < FRESH else self.told
            if told is None:
                self._lose("its player does not answer")
                return None
            playing = told.phase == "playing"
            since = told.age + self._clock.now() - player.told_at if playing else 0.0
            ahead = position - told.lead - told.position - min(since, FRESH + self.latency) * rate
            if ahead <= 0:
                return player
            if told.phase == "waiting":
                player.tell("go")
                player.told_at = 0.0
            self._clock.sleep(min(max(ahead / rate, 5e-4), ANSWER / 10))
        return None

    def _stop(self) -> None:
        told = self.told
        queued = 0 if told is None else max(0, self._next - told.position)
        self._end("stop", ANSWER + queued / self.wiring.sample_rate)

    def _abort(self) -> None:
        self._end("abort", ANSWER)

    def _estop(self) -> None:
        self._end("estop", ESTOP)

    def _end(self, how: str, seconds: float) -> None:
        player = self._player
        if player is None:
            return
        player.tell(how, seconds=seconds)
        if not player.settled(seconds):
            self._lose(f"it did not {how} in {seconds:.1f} s")
        self._count(player.told)

    def _clear(self) -> None:
        player = self._tended()
        if player is None:
            raise BusError(f"clear: the link is down: {self._trouble}")
        player.tell("clear")
        settled, told = player.settled(ANSWER), player.told
        if not settled or told is None or told.refused:
            why = told.refused if told is not None and told.refused else "no answer"
            raise BusError(f"clear: {why}; it stays e-stopped")

    def _close(self) -> None:
        with self._guard:
            _ = self.output
            for player in (self._player, self._opening):
                if player is not None:
                    player.close()
            self._player = self._opening = None


def find() -> Iterator[Found]:
    """Yield the outputs of audio cards; none where PortAudio is missing."""
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
        yield Found(
            f"audio:{quote(name, safe=' :,()')}",
            f"{d.name} ({d.api}), {d.channels} channels, {d.rate:g} Hz{usual}",
        )


class AudioOptions(Options, frozen=True, kw_only=True):
    """Options of an ``audio:`` URL.

    Attributes
    ----------
    channels : int or None
        Number of outputs that are opened; None for as many as the display has.
    """

    channels: int | None = None


def _channels(options: AudioOptions, display: DisplayLike) -> int:
    count = display.channels if options.channels is None else options.channels
    if count < display.channels:
        raise InputError(f"audio: channels = {count}: must be a number from {display.channels} up")
    if display.channels > MOST_CHANNELS:
        raise InputError(f"audio: {display.channels} channels; {MOST_CHANNELS} at most")
    return count


def _open(
    address: Address[AudioOptions], display: DisplayLike, sample_rate: float | None
) -> AudioBus:
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
