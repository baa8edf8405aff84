"""States, sample clock and spontaneous actions of an amplifier (sections 6 to 8 of SPEC.md).

Ticks go in, sample codes and packets come out. `ReferenceAmplifier` processes the messages of the
host and turns them into the transitions that the state table allows.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import messages as m
from firmware_protocol.capabilities import config_fault
from firmware_protocol.config import AmplifierConfig, LimitsInForce
from firmware_protocol.correlation import Correlator, Sensor, messages_of, window_samples
from firmware_protocol.marks import Marks
from firmware_protocol.messages import (
    INPUT_CLOSED_MS,
    REFUSED,
    STAYS,
    TABLE,
    EstopReason,
    Fault,
    LogLevel,
    Message,
    Mode,
    Parameter,
    Phase,
    State,
)
from firmware_protocol.packet import SMALLEST, TURN, LinkCounters, Packet
from firmware_protocol.player import SamplePlayer
from firmware_protocol.sources import Ints, PcmSource, Source, SpectrumSource

DEFAULT_RATE = 8000
"""Sample rate at power-up [Hz]."""
OUTBOX = 256
"""Largest number of packets that wait to be taken; further ones are dropped and counted."""
POWERED = (State.ARMED, State.RUNNING, State.RAMPDOWN)
"""States with high voltage, in which the watchdog runs."""
NO_CARRIERS = np.zeros(0, np.uint32)
"""Increments of the carriers before CARRIERS."""


@dataclass
class AmplifierCounters(LinkCounters):
    """Counters of STATUS (section 12), after those of the link."""

    wrong_version: int = 0
    unsupported: int = 0
    foreign_session: int = 0
    refused: int = 0
    ignored: int = 0
    wrong_channel: int = 0
    wrong_format: int = 0
    late_samples: int = 0
    future_samples: int = 0
    lost_samples: int = 0
    underruns: int = 0
    limited_samples: int = 0
    watchdogs: int = 0
    dropped_replies: int = 0
    trips: int = 0


class PlayedRun(NamedTuple):
    """A run of sample instants that were put out.

    Attributes
    ----------
    position : int
        Position of the first instant, modulo 2³².
    ticks : (S,) array of int
        Times of the instants [ticks].
    codes : (S, C) array of int
        Sample codes that were put out.
    state : State
        State after the last instant.
    high_voltage : bool
        Whether the high voltage is on after the last instant.
    lines : int
        Code on the marker lines at all instants of the run.
    """

    position: int
    ticks: Ints
    codes: NDArray[np.int16]
    state: State
    high_voltage: bool
    lines: int


class Machine:
    """An amplifier without communication.

    Parameters
    ----------
    config : AmplifierConfig
        Properties of the amplifier.
    sensor : Sensor or None
        What measures voltages and currents; None for an amplifier that does not.

    Attributes
    ----------
    config : AmplifierConfig
        The parameter of the same name.
    state : State
        Present state, as in STATUS.
    session : int
        Session token, 0 for none.
    node : int
        Node address.
    counters : AmplifierCounters
        Counters, as in STATUS.
    rate : int
        Sample rate [Hz].
    high_voltage : bool
        Whether the high voltage is on.

    Raises
    ------
    ValueError
        If SPEC.md does not allow the configuration, with the first field that it does not.
    """

    def __init__(self, config: AmplifierConfig, sensor: Sensor | None = None) -> None:
        if fault := config_fault(config):
            raise ValueError(fault)
        self.config, self.node = config, config.node
        self.state, self.session, self.high_voltage = State.IDLE, 0, False
        self.counters = AmplifierCounters()
        self.rate = min(max(DEFAULT_RATE, config.rate_min_hz), config.rate_max_hz)
        self._base = self._instant = 0
        self._start_tick: int | None = None
        self._start_position = 0
        self._heartbeat: int | None = None
        self._last_alive: int | None = None
        self._pulsed: int | None = None
        self._mode = Mode.PCM
        self._increments = NO_CARRIERS
        self._sync = (0, 0)
        self._fault = self._fault_now = self._estop_reason = int(Fault.NONE)
        self._contact_open = False
        self._contact_moved: int | None = None
        self._after_ramp = State.IDLE
        self._settings = {Parameter.NODE: config.node, Parameter.PULSE_MS: 10,
                          Parameter.LOG_LEVEL: int(LogLevel.WARNING)}  # fmt: skip
        self._attach(sensor)
        self._marks = Marks()
        self._seq = 0
        self._sent: deque[Packet] = deque()
        self._played: list[PlayedRun] = []
        self._now = 0
        self._player = SamplePlayer(self._source())
        self._limit(LimitsInForce.of(config))

    def _attach(self, sensor: Sensor | None) -> None:
        """Take the sensor, and the parameters that come with it."""
        self._sensor = sensor
        self._correlator = Correlator(self.config.channels, self.config.current_delay)
        self._sensed: int | None = None
        self._last_position = 0
        if sensor is not None:
            self._settings[Parameter.SENSE_MS] = 0
        if self._correlates:
            self._settings[Parameter.CORRELATION_MS] = 0
            self._settings[Parameter.SENSE_RANGE_UA] = self.config.sense_ranges_ua[0]

    # Output

    def take_sent(self) -> list[Packet]:
        """Return the packets that were sent since the last call.

        Returns
        -------
        list of Packet
            Packets to the host.
        """
        sent = list(self._sent)
        self._sent.clear()
        return sent

    def take_played(self) -> list[PlayedRun]:
        """Return the runs of sample instants since the last call; they accumulate until then.

        Returns
        -------
        list of PlayedRun
            Runs in order of time.
        """
        played, self._played = self._played, []
        return played

    @property
    def phase(self) -> Phase:
        """Phase of RUNNING; STILL in other states."""
        return self._player.phase

    @property
    def position(self) -> int:
        """Position that is put out next, modulo 2³²."""
        return self._player.position % TURN

    def due(self, count: int = 1) -> int:
        """Compute the time of a future sample instant.

        Parameters
        ----------
        count : int
            Number of the instant, 1 for the next one.

        Returns
        -------
        int
            Time of the instant [ticks].
        """
        if self._start_tick is not None:
            first = self._index(self._start_tick) - self._instant
            if count >= first:
                return self._start_tick + (count - first) * self.config.tick_hz // self.rate
        return self._tick(self._instant + count)

    # Sample clock

    def _tick(self, k: int) -> int:
        """Return the tick of instant k of the present sample clock."""
        return self._base + k * self.config.tick_hz // self.rate

    def _index(self, tick: int) -> int:
        """Return the first instant, from the next one on, at or after a tick."""
        k = -((tick - self._base) * self.rate // -self.config.tick_hz)
        return max(k, self._instant + 1)

    def run(self, now: int) -> None:
        """Put out all sample instants up to a time.

        Parameters
        ----------
        now : int
            Present time [ticks].
        """
        while True:
            tick = self._tick(self._instant + 1)
            if self._start_tick is not None and tick >= self._start_tick:
                tick = self._start_tick
                if tick > now:
                    break
                self._base, self._instant, self._start_tick = tick, -1, None
            if tick > now:
                break
            self._at_instant(tick)
            self._put_out(self._uneventful(now))
        self._now = max(self._now, now)

    def _at_instant(self, tick: int) -> None:
        """Do what precedes the sample at an instant: watchdog, PULSE and SENSE."""
        watchdog = self._watchdog_due
        if watchdog is not None and tick >= watchdog:
            self._watchdog()
        if self.session and tick >= self._pulse_due:
            self._send_pulse()
            self._pulsed = tick
        sense = self._sense_due
        if sense is not None and tick >= sense:
            self._send_senses()
            self._sensed = tick

    def _watchdog(self) -> None:
        """Let the watchdog expire."""
        state_before = self.state, self._after_ramp
        self._heartbeat = None
        self._to(TABLE["watchdog"][self.state])
        if self.state != state_before[0]:
            self._send_pulse()
        if (self.state, self._after_ramp) != state_before:
            self.counters.watchdogs += 1
            self._log(LogLevel.WARNING, "watchdog: no heartbeat")

    def _uneventful(self, now: int) -> int:
        """Return the number of instants, this one included, until anything else may happen."""
        end = self._index(now + 1)
        first = self._instant + 1
        pulse = self._pulse_due if self.session else None
        for tick in (self._watchdog_due, pulse, self._sense_due, self._start_tick):
            if tick is not None:
                end = min(end, self._index(tick))
        return max(end - first, 1)

    @property
    def _watchdog_due(self) -> int | None:
        """Tick from which the watchdog expires, once per heartbeat; None for never."""
        if self._heartbeat is None or self.state not in POWERED:
            return None
        return self._later(self._heartbeat, m.WATCHDOG_MS)

    @property
    def _pulse_due(self) -> int:
        """Tick from which a PULSE is due; 0, that is at once, after a session was taken."""
        since = self._pulsed
        return 0 if since is None else self._later(since, self._settings[Parameter.PULSE_MS])

    @property
    def _sense_due(self) -> int | None:
        """Tick from which a SENSE is due, 0 for the first one; None for never."""
        interval = self._settings.get(Parameter.SENSE_MS, 0)
        if not interval:
            return None
        return 0 if self._sensed is None else self._later(self._sensed, interval)

    @property
    def _correlates(self) -> bool:
        """Whether the amplifier has the feature CORRELATES."""
        return self._sensor is not None and bool(self.config.sense_ranges_ua)

    def _put_out(self, count: int) -> None:
        """Put out up to ``count`` instants."""
        position, pending = self.position, self._start_tick is not None
        player, first = self._player, self._player.position
        running = self.state == State.RUNNING and not pending
        if player.guard.active:
            count = min(count, player.guard.most)
        count = self._marks.longest(count, position, running=running)
        codes = player.advance(count, pending=pending)
        self._last_position = first + (0 if pending else len(codes) - 1)
        ticks = (
            self._base
            + (self._instant + 1 + np.arange(len(codes))) * self.config.tick_hz // self.rate
        )
        self._instant += len(codes)
        self._count_played()
        if self._sensor is not None:
            self._measure(self._sensor, first, codes, in_window=not pending)
        mark = self._marks.advance(
            len(codes), position, running=running, playing=player.phase == Phase.PLAYING
        )
        if mark is not None:
            self._send(m.Marked(mark.position, mark.code))
        if self.state == State.RAMPDOWN and not player.ramping:
            self._enter(self._after_ramp)
            self._send_pulse()
        if self.state not in POWERED and player.silent:
            self.high_voltage = False
        self._played.append(
            PlayedRun(position, ticks, codes.astype(np.int16), self.state, self.high_voltage,
                      self._marks.lines)
        )  # fmt: skip

    def _measure(self, sensor: Sensor, position: int, codes: Ints, *, in_window: bool) -> None:
        """Measure the currents of a run, and send the windows that it completes (section 16)."""
        currents = sensor.measure(codes, self.rate)
        if not (self._correlates and in_window and self.state == State.RUNNING):
            self._correlator.stop()
            return
        length = window_samples(self._settings[Parameter.CORRELATION_MS], self.rate)
        range_ua = self._settings[Parameter.SENSE_RANGE_UA]
        guard, held = self._player.guard, self._player.held
        windows = self._correlator.add(position, codes, currents, length, guarded=held)
        for window in windows:
            for message in messages_of(window, range_ua, self.config.packet_limit):
                self._send(message)
        steps = self._correlator.steps() if guard.active else None
        if guard.add(self._correlator.currents, steps):
            reasons = guard.reasons.astype(np.uint8).tobytes()
            self._send(m.Guarded(self._player.position % TURN, reasons))

    def _count_played(self) -> None:
        """Update the counters from those of the player."""
        for name in ("lost_samples", "underruns", "limited_samples"):
            setattr(self.counters, name, getattr(self._player, name))

    def _ms(self, milliseconds: int) -> int:
        """Return a duration in ticks."""
        return milliseconds * self.config.tick_hz // 1000

    def _later(self, tick: int, milliseconds: int) -> int:
        """Return the first tick at which a duration has passed since another tick."""
        return tick - milliseconds * self.config.tick_hz // -1000

    # States

    def _to(self, cell: int) -> bool:
        """Carry out a cell of the state table, and return whether the state changed."""
        if cell == STAYS or cell & REFUSED:
            return False
        before = self.state
        state, self._after_ramp = State(cell & 7), State(cell >> 3)
        if state != State.RAMPDOWN:
            self._enter(state)
        elif before != State.RAMPDOWN:
            self.state, self._start_tick = state, None
            self._player.ramp(quick=False)
        return self.state != before

    def _enter(self, state: State) -> None:
        """Enter a state other than RAMPDOWN."""
        self.state = state
        if state != State.RUNNING:
            self._start_tick = None
            self._player.go_to_rest()
        if state in POWERED:
            self.high_voltage = True
        elif self._player.silent:
            self.high_voltage = False

    def fault(self, code: int, now: int) -> None:
        """Report a fault of the hardware.

        Parameters
        ----------
        code : int
            Code of the fault; 0 when it is gone.
        now : int
            Present time [ticks].
        """
        self.run(now)
        self._fault_now = code
        if code:
            self.counters.trips += 1
            self._fault = code
            if self._to(TABLE["fault"][self.state]):
                self._send_pulse()
                self._log(LogLevel.ERROR, f"fault {code}")

    def estop_input(self, is_open: bool, now: int) -> None:
        """Report the contact of the e-stop input (section 6.3).

        At tick 0, before anything else, this is the reading at power-up. An amplifier without an
        input ignores it.

        Parameters
        ----------
        is_open : bool
            Whether the contact is open.
        now : int
            Present time [ticks].
        """
        self.run(now)
        if is_open == self._contact_open or not self.config.estop_input:
            return
        self._contact_open, self._contact_moved = is_open, self._now
        if is_open:
            self.counters.trips += 1
            self._estop_reason = int(EstopReason.INPUT)
            if self._to(TABLE["estop_input"][self.state]):
                self._send_pulse()
                self._log(LogLevel.ERROR, "e-stop input open")

    @property
    def input_open(self) -> bool:
        """Whether the e-stop input counts as open: until it has been closed for 50 ms."""
        since = self._contact_moved
        settling = since is not None and self._now < self._later(since, INPUT_CLOSED_MS)
        return self._contact_open or settling

    # Playback

    def _limit(self, limits: LimitsInForce) -> None:
        """Put limits in force at the present sample rate."""
        self._limits, player = limits, self._player
        player.limit, player.step = limits.code, limits.step(self.rate)
        player.fade = limits.fade(self.rate)

    def _source(self) -> Source:
        """Return a new source for the present mode."""
        c = self.config
        if self._mode == Mode.SPECTRUM:
            return SpectrumSource(c.channels, c.fifo, self.rate, self._increments)
        return PcmSource(c.channels, c.fifo, self.rate)

    # Messages to the host

    def _send(self, message: Message, node: int | None = None) -> None:
        """Queue a message to the host; ``node`` is its sender if not the present node."""
        seq, self._seq = self._seq, (self._seq + 1) & 0xFF
        if len(self._sent) >= OUTBOX:
            self.counters.dropped_replies += 1
            return
        sender = self.node if node is None else node
        self._sent.append(Packet.of(message, node=sender, seq=seq))

    def _send_pulse(self) -> None:
        """Send a PULSE if there is a session."""
        if not self.session:
            return
        player = self._player
        self._send(
            m.Pulse(
                (player.position + self.config.fifo) % TURN,
                self.state,
                player.phase,
                player.underruns & 0xFF,
                min(player.fill * 1000 // self.rate, 255),
            )
        )

    def _send_senses(self) -> None:
        """Send what was measured at the latest instant, in as few packets as possible."""
        assert self._sensor is not None
        pairs = np.stack(self._sensor.readings(), axis=1).astype("<i2")
        most = (self.config.packet_limit - SMALLEST - m.Sense.HEAD.size) // 4
        for first in range(0, len(pairs), most):
            part = pairs[first : first + most]
            self._send(m.Sense(self._last_position % TURN, first, len(part), part.tobytes()))

    def _log(self, level: int, text: str) -> None:
        """Send a LOG if there is a session and the level is high enough."""
        if self.session and level >= self._settings[Parameter.LOG_LEVEL]:
            self._send(m.Log(level, text.encode()))
