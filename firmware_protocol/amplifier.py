"""Reference amplifier in Python: sessions, checks and answers (sections 4 and 5 of SPEC.md).

It takes packets and ticks and returns packets and the sample codes that it puts out at each sample
instant. It has neither I/O nor a clock of its own. It behaves as the amplifier in `c/` does, so
that tests and simulations need no compiler.
"""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol import guard, samples, spectrum
from firmware_protocol import messages as m
from firmware_protocol.config import LimitsInForce
from firmware_protocol.machine import NO_CARRIERS, Machine
from firmware_protocol.messages import (
    MAJOR,
    REFUSED,
    TABLE,
    EstopReason,
    Fault,
    Feature,
    Flag,
    Input,
    Message,
    Mode,
    NakCode,
    Parameter,
    SampleFormat,
    State,
)
from firmware_protocol.packet import TURN, Packet
from firmware_protocol.player import distance
from firmware_protocol.sources import PcmSource, Source, SpectrumSource

SESSION_FREE = (m.Hello, m.Time, m.Sync, m.Estop, m.Get, m.Identify, m.Poll)
"""Messages that are valid without a session."""
STREAMED = (m.Pcm, m.Spectrum, m.Guard, m.Mark)
"""Messages that are ignored unless the amplifier runs."""
SETTLED_STATES = (State.IDLE, State.SAFE)
"""States in which the node address may be changed."""


class Refusal(NamedTuple):
    """Refusal of a request.

    Attributes
    ----------
    code : NakCode
        Reason, as in NAK.
    detail : int
        Detail, as in NAK.
    counter : str
        Name of the counter that counts the refusal.
    """

    code: NakCode
    detail: int
    counter: str = "refused"


Reply = Message | Refusal | None
"""Reply to a request: a message, a refusal, or None where only an ACK may follow."""


class ReferenceAmplifier(Machine):
    """A complete amplifier except for its link.

    Parameters and attributes are those of `Machine`.
    """

    _addressed = True
    """Whether the present packet was addressed to this node alone."""

    def receive(self, packet: Packet, now: int) -> None:
        """Act on a received packet.

        Parameters
        ----------
        packet : Packet
            Packet from the host.
        now : int
            Time of reception [ticks].
        """
        self.run(now)
        if packet.node not in (self.node, 0):
            return
        node, state_before = self.node, self.state
        self._addressed = packet.node != 0
        reply = self._checked(packet)
        wants_answer = bool(packet.flags & Flag.ACK_REQUEST)
        if isinstance(reply, Refusal):
            counted = getattr(self.counters, reply.counter)
            setattr(self.counters, reply.counter, counted + 1)
            if wants_answer and packet.node:
                refusal = m.Nak(packet.type, packet.seq, reply.code, self.state, reply.detail)
                self._send(refusal, node)
        elif reply is not None:
            if packet.node or isinstance(reply, m.Caps):
                self._send(reply, node)
        elif wants_answer and packet.node:
            self._send(m.Ack(packet.type, packet.seq), node)
        if self.state != state_before:
            self._send_pulse()

    def _checked(self, packet: Packet) -> Reply:
        """Check a packet in the order of section 5, then act on it."""
        if packet.type != m.Estop.TYPE:
            if packet.flags >> 6 != MAJOR:
                return Refusal(NakCode.VERSION, MAJOR, "wrong_version")
            if packet.flags & Flag.INCOMPATIBLE:
                return Refusal(NakCode.UNSUPPORTED, packet.flags, "unsupported")
        kind = m.MESSAGES.get(packet.type)
        if kind is None or kind not in HANDLERS or self._lacks(kind):
            return Refusal(NakCode.UNKNOWN_TYPE, 0, "unknown_type")
        message = kind.unpack(packet.payload)
        if message is None:
            return Refusal(NakCode.LENGTH, len(packet.payload), "malformed")
        if not isinstance(message, SESSION_FREE) and not self._owned(message):
            return Refusal(NakCode.SESSION, 0, "foreign_session")
        event, handler = HANDLERS[kind]
        if isinstance(message, STREAMED) and self.state != State.RUNNING:
            return Refusal(NakCode.STATE, 0, "ignored")
        if event and (refusal := self._forbidden(event, message)):
            return refusal
        return handler(self, message)

    def _lacks(self, kind: type[Message]) -> bool:
        """Return whether a message is of a feature that the amplifier does not have."""
        if kind is m.Mark:
            return not self.config.marker_lines
        return kind is m.Guard and not self._correlates

    def _owned(self, message: Message) -> bool:
        """Return whether a message has the token of the present session."""
        return self.session != 0 and getattr(message, "session", 0) == self.session

    def _forbidden(self, event: str, message: Message) -> Refusal | None:
        """Return the refusal of an event that the state does not allow, or None."""
        cell = TABLE[event][self.state]
        if isinstance(message, m.Hello):
            if message.session in (0, self.session):
                return None
            if self._is_held:
                return Refusal(NakCode.BUSY, 0)
        if not cell & REFUSED or (isinstance(message, m.Start) and self._repeated(message)):
            return None
        return Refusal(NakCode(cell & ~REFUSED), 0)

    @property
    def _is_held(self) -> bool:
        """Whether another host must not take over yet, whatever the state (6.1)."""
        if not self._player.silent:
            return True
        return self._last_alive is not None and self._now < self._later(
            self._last_alive, m.WATCHDOG_MS
        )

    def _repeated(self, start: m.Start) -> bool:
        """Return whether a START repeats the one that is in effect."""
        return self.state == State.RUNNING and start.position == self._start_position

    def _hello(self, hello: m.Hello) -> Reply:
        """Handle HELLO: take a new session, and answer with CAPS."""
        if hello.major != MAJOR:
            return Refusal(NakCode.VERSION, MAJOR, "wrong_version")
        if hello.session not in (0, self.session):
            self.session = hello.session
            self._limit(LimitsInForce.of(self.config))
            self._increments, self._sync = NO_CARRIERS, (0, 0)
            if self._correlates:
                self._settings[Parameter.CORRELATION_MS] = 0
            self._pulsed = self._last_alive = None
        return self.config.caps(self.session, self._features)

    @property
    def _features(self) -> int:
        """Bits of `Feature` that the amplifier has."""
        senses = Feature.SENSES if self._sensor is not None else 0
        correlates = Feature.CORRELATES | Feature.GUARDS if self._correlates else 0
        return senses | correlates | (Feature.ESTOP_INPUT if self.config.estop_input else 0)

    def _time(self, time: m.Time) -> Reply:
        """Handle TIME."""
        return m.TimeReply(time.host_time, self._now, self._now)

    def _take_sync(self, sync: m.Sync) -> Reply:
        """Handle SYNC."""
        self._sync = (sync.index, self._now)
        return None

    def _arm(self, arm: m.Arm) -> Reply:
        """Handle ARM."""
        if arm.mode > Mode.SPECTRUM:
            return Refusal(NakCode.RANGE, 1)
        rate = arm.sample_rate_hz
        if not self.config.rate_min_hz <= rate <= self.config.rate_max_hz:
            return Refusal(NakCode.RANGE, 2)
        if not self._limits.in_time(rate):
            return Refusal(NakCode.RANGE, 2)
        if rate != self.rate:
            self._base, self._instant, self.rate = self._now, 0, rate
        self._mode, self._heartbeat = Mode(arm.mode), self._now
        self._last_alive = self._now
        self._limit(self._limits)
        self._to(TABLE["arm"][self.state])
        return None

    def _start(self, start: m.Start) -> Reply:
        """Handle START."""
        if self._repeated(start):
            return None
        if self._mode == Mode.SPECTRUM and not len(self._increments):
            return Refusal(NakCode.CARRIERS, 0)
        tick = start.time or self._now + self._ms(start.delay_ms)
        if start.time and not 0 <= tick - self._now <= self._ms(m.START_AHEAD_MS):
            return Refusal(NakCode.TIME, 0)
        self._to(TABLE["start"][self.state])
        self._start_tick, self._start_position = tick, start.position
        self._player.start(self._source(), start.position)
        self._correlator.start()
        self._marks.forget()
        self._player.guard.start(self.rate)
        return None

    def _stop(self, stop: m.Stop) -> Reply:
        """Handle STOP."""
        self._to(TABLE["stop"][self.state])
        if self.state == State.RAMPDOWN and stop.quick:
            self._player.ramp(quick=True)
        return None

    def _disarm(self, disarm: m.Disarm) -> Reply:
        """Handle DISARM."""
        self._to(TABLE["disarm"][self.state])
        return None

    def _estop(self, estop: m.Estop) -> Reply:
        """Handle ESTOP."""
        self.counters.trips += 1
        self._estop_reason = 0 if estop.reason == EstopReason.INPUT else estop.reason
        self._to(TABLE["estop"][self.state])
        return None

    def _clear_fault(self, clear: m.ClearFault) -> Reply:
        """Handle CLEAR_FAULT, which must know of the latest trip."""
        if self.state in (State.FAULT, State.ESTOP):
            if clear.trips != self.counters.trips % TURN:
                return Refusal(NakCode.STATE, self.counters.trips % TURN)
            if not self._player.silent:
                return Refusal(NakCode.STATE, 0)
            if self.input_open:
                return Refusal(NakCode.INPUT_OPEN, 0)
            if self._fault_now:
                return Refusal(NakCode.FAULT, self._fault_now)
            self._fault = int(Fault.NONE)
            self._to(TABLE["clear_fault"][self.state])
        return None

    def _take_heartbeat(self, heartbeat: m.Heartbeat) -> Reply:
        """Handle HEARTBEAT."""
        self._heartbeat = self._last_alive = self._now
        return None

    def _lower_limits(self, limits: m.Limits) -> Reply:
        """Handle LIMITS."""
        if not self._player.silent:
            return Refusal(NakCode.STATE, 0)
        lowered = self._limits.lowered(limits)
        if isinstance(lowered, int):
            return Refusal(NakCode.RANGE, lowered)
        if not lowered.in_time(self.rate):
            return Refusal(NakCode.RANGE, 2)
        self._limit(lowered)
        return None

    def _get(self, get: m.Get) -> Reply:
        """Handle GET."""
        if get.parameter == Parameter.UPTIME_S:
            return m.Value(get.parameter, self._now // self.config.tick_hz % TURN)
        if get.parameter not in self._settings:
            return Refusal(NakCode.PARAMETER, get.parameter)
        return m.Value(get.parameter, self._settings[Parameter(get.parameter)])

    def _set(self, setting: m.Set) -> Reply:
        """Handle SET."""
        key = setting.parameter
        if key == Parameter.UPTIME_S:
            return Refusal(NakCode.READ_ONLY, key)
        if key not in self._settings:
            return Refusal(NakCode.PARAMETER, key)
        if key == Parameter.NODE and (self.state not in SETTLED_STATES or not self._addressed):
            return Refusal(NakCode.STATE, 0)
        if not self._allows(Parameter(key), setting.value):
            return Refusal(NakCode.RANGE, 2)
        if self._settings[Parameter(key)] != setting.value:
            self._change(Parameter(key), setting.value)
        return None

    def _allows(self, key: Parameter, value: int) -> bool:
        """Return whether a parameter may have a value."""
        if key == Parameter.SENSE_RANGE_UA:
            return value in self.config.sense_ranges_ua
        low, high = SETTING_RANGES[key]
        return low <= value <= high or (value == 0 and key in MAY_BE_OFF)

    def _change(self, key: Parameter, value: int) -> None:
        """Give a parameter another value; a window under way ends by some (16.2)."""
        if key == Parameter.SENSE_MS and not self._settings[key]:
            self._sensed = None
        if key in (Parameter.CORRELATION_MS, Parameter.SENSE_RANGE_UA):
            self._correlator.stop()
        if key == Parameter.SENSE_RANGE_UA:
            assert self._sensor is not None
            self._sensor.choose(value)
        self._settings[key] = value
        self.node = self._settings[Parameter.NODE]

    def _identify(self, identify: m.Identify) -> Reply:
        """Handle IDENTIFY; there is no board to find."""
        return None

    def _poll(self, poll: m.Poll) -> Reply:
        """Handle POLL."""
        counters = {f.name: getattr(self.counters, f.name) % TURN for f in fields(self.counters)}
        return m.Status(
            state=self.state, phase=self.phase, fault=self._fault,
            estop_reason=self._estop_reason, session=self.session, position=self.position,
            time=self.due() if self._start_tick is None else self._start_tick,
            sync_index=self._sync[0], sync_time=self._sync[1],
            voltage_limit_uv=self._limits.voltage_uv,
            slew_limit_v_per_s=self._limits.slew_v_per_s, fade_us=self._limits.fade_us,
            inputs=Input.ESTOP_OPEN if self.input_open else 0, **counters,
        )  # fmt: skip

    # Streams

    def _channels_wrong(self, first: int, count: int) -> Refusal | None:
        """Return the refusal of a range of channels that does not exist, or None."""
        if not count or first + count > self.config.channels:
            return Refusal(NakCode.CHANNEL, first + count, "wrong_channel")
        return None

    def _pcm(self, pcm: m.Pcm) -> Reply:
        """Handle PCM."""
        known = pcm.format <= SampleFormat.BFP8 and self.config.formats >> pcm.format & 1
        source = self._player.source
        if not isinstance(source, PcmSource) or not known:
            return Refusal(NakCode.FORMAT, pcm.format, "wrong_format")
        if refusal := self._channels_wrong(pcm.first_channel, pcm.channels):
            return refusal
        size = samples.size(pcm.format, pcm.samples, pcm.channels)
        if not pcm.samples or len(pcm.data) != size:
            return Refusal(NakCode.LENGTH, m.Pcm.HEAD.size + len(pcm.data), "malformed")
        codes = samples.decode(pcm.format, pcm.data, pcm.samples, pcm.channels)
        player = self._player
        ahead = distance(pcm.position, player.position)
        source.write(player.position, ahead, pcm.first_channel, codes)
        self._count_dropped(source)
        return None

    def _count_dropped(self, source: Source) -> None:
        """Move the numbers of dropped positions from a source to the counters."""
        self.counters.late_samples += source.late
        self.counters.future_samples += source.future
        source.late = source.future = 0

    def _carriers(self, carriers: m.Carriers) -> Reply:
        """Handle CARRIERS."""
        if not 1 <= carriers.count <= self.config.carriers:
            return Refusal(NakCode.RANGE, 1)
        if len(carriers.increments) != 4 * carriers.count:
            size = m.Carriers.HEAD.size + len(carriers.increments)
            return Refusal(NakCode.LENGTH, size, "malformed")
        self._increments = np.frombuffer(carriers.increments, "<u4").astype(np.uint32)
        return None

    def _guard(self, message: m.Guard) -> Reply:
        """Handle GUARD."""
        if refusal := self._channels_wrong(message.first_channel, message.channels):
            return refusal
        entries = guard.decode(message)
        if entries is None:
            return Refusal(NakCode.LENGTH, m.Guard.HEAD.size + len(message.entries), "malformed")
        if max(entries["drive_shift"].max(), entries["change_shift"].max()) > guard.SHIFT_MOST:
            return Refusal(NakCode.RANGE, 1)
        self._player.guard.take(message.first_channel, entries)
        return None

    def _mark(self, mark: m.Mark) -> Reply:
        """Handle MARK."""
        if not 0 < mark.code < 1 << self.config.marker_lines:
            return Refusal(NakCode.RANGE, 2)
        if not mark.samples:
            return Refusal(NakCode.RANGE, 3)
        self._marks.keep(mark, self._player.position, self.config.fifo)
        return None

    def _spectrum(self, frame: m.Spectrum) -> Reply:
        """Handle SPECTRUM."""
        source, count = self._player.source, len(self._increments)
        known = frame.format == SampleFormat.SPECTRUM8 and self.config.formats >> frame.format & 1
        if not isinstance(source, SpectrumSource) or not known or frame.carriers != count:
            return Refusal(NakCode.FORMAT, frame.format, "wrong_format")
        if refusal := self._channels_wrong(frame.first_channel, frame.channels):
            return refusal
        if len(frame.envelopes) != 2 * frame.channels * count:
            size = m.Spectrum.HEAD.size + len(frame.envelopes)
            return Refusal(NakCode.LENGTH, size, "malformed")
        codes = np.frombuffer(frame.envelopes, np.uint8).reshape(frame.channels, count, 2)
        player = self._player
        ahead = distance(frame.position, player.position)
        envelopes = np.stack(spectrum.decode(codes), axis=1)
        source.write(player.position, ahead, frame.valid, frame.first_channel, envelopes)
        self._count_dropped(source)
        return None


SETTING_RANGES = {
    Parameter.NODE: (1, 127),
    Parameter.PULSE_MS: (1, 100),
    Parameter.LOG_LEVEL: (0, 4),
    Parameter.SENSE_MS: (10, 1000),
    Parameter.CORRELATION_MS: (10, 100),
}
"""Smallest and largest value of each parameter that can be set to any value between."""
MAY_BE_OFF = (Parameter.SENSE_MS, Parameter.CORRELATION_MS)
"""Parameters that may be 0 as well."""
Handler = Callable[[ReferenceAmplifier, Any], Reply]
"""Function that handles a message and returns the reply."""
HANDLERS: dict[type[Message], tuple[str, Handler]] = {
    m.Hello: ("hello_other", ReferenceAmplifier._hello),
    m.Time: ("", ReferenceAmplifier._time),
    m.Sync: ("", ReferenceAmplifier._take_sync),
    m.Start: ("start", ReferenceAmplifier._start),
    m.Stop: ("stop", ReferenceAmplifier._stop),
    m.Arm: ("arm", ReferenceAmplifier._arm),
    m.Disarm: ("disarm", ReferenceAmplifier._disarm),
    m.Estop: ("estop", ReferenceAmplifier._estop),
    m.ClearFault: ("clear_fault", ReferenceAmplifier._clear_fault),
    m.Heartbeat: ("", ReferenceAmplifier._take_heartbeat),
    m.Limits: ("limits", ReferenceAmplifier._lower_limits),
    m.Get: ("", ReferenceAmplifier._get),
    m.Set: ("", ReferenceAmplifier._set),
    m.Identify: ("", ReferenceAmplifier._identify),
    m.Poll: ("", ReferenceAmplifier._poll),
    m.Pcm: ("", ReferenceAmplifier._pcm),
    m.Carriers: ("carriers", ReferenceAmplifier._carriers),
    m.Spectrum: ("", ReferenceAmplifier._spectrum),
    m.Guard: ("", ReferenceAmplifier._guard),
    m.Mark: ("", ReferenceAmplifier._mark),
}
"""Event in the state table and handler of each message; "" for a message that is no event."""
