"""Each rule of the amplifier's safety alone, with its own numbers."""

from random import Random

import numpy as np
import pytest
from protocol_judge import BUSY, STATE, STATES, TURN, Limits, distance, ramp_bound
from protocol_story import NOBODY
from protocol_traces import CONFIGS, PACKET, Record, Rig, packet, play

from firmware_protocol.config import Config

NAMES = list(CONFIGS)
OWNER = 0x1234
LOUD = b"\xff\x7f"
NAK, UNASKED = 0x41, (0x45, 0x47, 0x48)


def loud(rig: Rig, rate: int) -> Rig:
    """Return it after it was taken, armed and started, and has played full scale for 100 ms."""
    node = rig.config.node
    for name, fields in (("HELLO", (1, 0, 0)), ("ARM", (0, rate)), ("START", (TURN - 5, 0, 0))):
        rig.packet(packet(name, OWNER, *fields, node=node))
    stream(rig, 100, beating=OWNER)
    assert rig.amplifier.state.name == "RUNNING"
    assert rig.rows[-1]["codes"][-1].all()
    return rig


def stream(rig: Rig, milliseconds: int, *, beating: int) -> None:
    """Send full scale for all channels, each millisecond as much as there is room for."""
    c = rig.config
    kind, eight = (0, 8 * LOUD) if c.formats & 1 else (1, 4 * b"\xff\xf7\x7f")
    sent = rig.amplifier.position
    for _ in range(milliseconds):
        rig.packet(packet("HEARTBEAT", beating, node=c.node))
        here = rig.amplifier.position
        for ahead in range(max(distance(sent, here), 0), c.fifo - 8, 8):
            sent = (here + ahead) % TURN
            head = sent, OWNER, 0, c.channels, kind, 8
            rig.packet(packet("PCM", *head, body=eight * c.channels, node=c.node))
        rig.run(rig.now + c.tick_hz // 1000)


def zero_after(rig: Rig) -> int:
    """Return the tick of the instant from which on all outputs are 0 and high voltage is off.

    The dead goes on streaming, and heartbeats come of a stranger.
    """
    stream(rig, 250, beating=NOBODY)
    rows = np.concatenate(rig.rows)
    alive = np.flatnonzero((rows["codes"] != 0).any(axis=1) | (rows["high_voltage"] != 0))
    return int(rows["tick"][alive[-1] + 1])


SILENT = [
    ("as shipped", 16_000, (0, 0, 0)),
    ("as shipped", 2_501, (0, 5_008, 0)),
    ("as shipped", 16_000, (50_000_000, 2_540, 1)),
    ("as shipped", 16_000, (10_000_000, 538, 0)),
    ("as shipped", 16_000, (1_900_000, 98, 1)),
    ("slow ticks", 1_049, (0, 0, 0)),
    ("slow ticks", 1_000, (30_000_000, 0, 19_999)),
    ("fast ticks", 4_411, (0, 0, 0)),
    ("low slew", 1_600, (0, 0, 0)),
    ("low slew", 1_049, (0, 0, 1)),
    ("few formats", 1_999, (0, 0, 0)),
]
"""Amplifier, rate, and what is lowered: slews the least that LIMITS takes, or a little above."""


def lowered(config: Config, rate: int, limits: tuple[int, int, int]) -> Rig:
    """Return a loud amplifier whose limits were lowered before it played."""
    rig = Rig(config)
    for name, fields in (("HELLO", (1, 0, 0)), ("ARM", (0, rate)), ("LIMITS", limits)):
        rig.packet(packet(name, OWNER, *fields, node=config.node))
        assert rig.sent[-1][0] != NAK
    return loud(rig, rate)


@pytest.mark.parametrize(("name", "rate", "limits"), SILENT)
def test_a_silent_owner_leaves_0_volt_in_170_ms_and_an_instant(
    name: str, rate: int, limits: tuple[int, int, int]
) -> None:
    """High voltage off as well. With 50 ms of heartbeats that lay queued that is 220 ms."""
    rig = lowered(CONFIGS[name], rate, limits)
    hz, judge = rig.config.tick_hz, rig.judge
    assert judge is not None
    heard = judge.heard
    assert (zero_after(rig) - heard - 1) * 1000 * rate <= (170 * rate + 1000) * hz
    assert judge.state == "SAFE"


@pytest.mark.parametrize(
    ("fade_us", "step", "fade", "instants"), [(0, 322, 32, 32), (1, 322, 1, 31)]
)
def test_what_bounds_the_fall_is_reached(fade_us: int, step: int, fade: int, instants: int) -> None:
    """The bound of RAMPDOWN is no guess: full scale in, the output follows it code for code."""
    rig = lowered(CONFIGS["low slew"], 1_600, (0, 0, fade_us))
    zero_after(rig)
    last, fall = 9830, []
    for k in range(instants):
        last = ramp_bound(9830, step, fade, k, last)
        fall.append(last)
    rows = np.concatenate(rig.rows)
    end = int(np.flatnonzero(rows["state"] == STATES.index("RAMPDOWN"))[-1]) + 2
    assert rows["codes"][end - instants : end, 0].tolist() == fall
    assert (fall[-2] > 0, fall[-1]) == (True, 0)


@pytest.mark.parametrize(("delay_ms", "fade"), [(0, 50), (1, 1)])
def test_who_is_late_for_its_start_fades_in(delay_ms: int, fade: int) -> None:
    """Samples sent right after START are in time for a delay, else late by an instant."""
    rig = Rig(CONFIGS["as shipped"])
    for name, fields in (("HELLO", (1, 0, 0)), ("ARM", (0, 2500)), ("START", (0, delay_ms, 0))):
        rig.packet(packet(name, OWNER, *fields))
    stream(rig, 40, beating=OWNER)
    rows = np.concatenate(rig.rows)
    first = int(rows["codes"][:, 0].nonzero()[0][0])
    assert rows["position"][first] == (1 if fade > 1 else 0)
    rise = [32767 * min(k, fade) // fade for k in range(1, 61)]
    assert rows["codes"][first : first + 60, 0].tolist() == rise


@pytest.mark.parametrize("name", NAMES)
def test_the_hardware_s_own_limits_are_armed_at_every_rate(name: str) -> None:
    """And are the least: "low slew" could not be armed at all rates with 1 V/s less."""
    c = CONFIGS[name]
    rates = range(c.rate_min_hz, c.rate_max_hz + 1)
    voltage, slew = c.voltage_limit_uv, c.slew_limit_v_per_s
    assert all(Limits(voltage, slew, 0).reach(c.full_scale_uv, rate) for rate in rates)
    least = all(Limits(voltage, slew - 1, 0).reach(c.full_scale_uv, rate) for rate in rates)
    assert least == (name != "low slew")


@pytest.mark.parametrize("rate", [1000, 1049, 1599, 1600])
def test_limits_are_taken_in_codes_at_the_rate(rate: int) -> None:
    """One code per step too little, and neither LIMITS nor ARM takes it: RANGE, 2."""
    config = CONFIGS["low slew"]
    least = -(-9830 // (rate // 50))
    slew = -(least * 200_000_000 * rate // -(32767 * 10**6))
    for wrong in (0, 1):
        rig = Rig(config)
        rig.packet(packet("HELLO", OWNER, 1, 0, 0, node=127))
        rig.packet(packet("ARM", OWNER, 0, rate, node=127))
        rig.packet(packet("LIMITS", OWNER, 0, slew - wrong, 0, node=127))
        assert refusal(rig) == ((11, 2) if wrong else None)
        rig.packet(packet("ARM", OWNER, 0, rate, node=127))
        assert refusal(rig) is None


def test_a_rate_at_which_the_limits_take_too_long_is_not_armed() -> None:
    """At 1600 Hz the fall may have 32 instants, at 1599 Hz it has 31."""
    rig = Rig(CONFIGS["low slew"])
    for name, *fields in (("HELLO", 1, 0, 0), ("ARM", 0, 1600), ("LIMITS", 0, 3_050, 0)):
        rig.packet(packet(str(name), OWNER, *map(int, fields), node=127))
    for rate, refused in ((1599, (11, 2)), (1049, (11, 2)), (1600, None)):
        rig.packet(packet("ARM", OWNER, 0, rate, node=127))
        assert refusal(rig) == refused


def refusal(rig: Rig) -> tuple[int, int] | None:
    """Return code and detail of the last answer, if it is NAK."""
    last = next(data for data in reversed(rig.sent) if data[0] not in UNASKED)
    return (last[6], int.from_bytes(last[8:12], "little")) if last[0] == NAK else None


@pytest.mark.parametrize("name", NAMES)
def test_estop_brings_0_volt_in_20_ms_and_stays_until_its_owner_clears_it(name: str) -> None:
    config = CONFIGS[name]
    rig, rate, node = loud(Rig(config), config.rate_max_hz), config.rate_max_hz, config.node
    begin = rig.now
    rig.packet(packet("ESTOP", 7, node=0))
    assert (zero_after(rig) - begin) * 1000 * rate <= (20 * rate + 1000) * config.tick_hz
    assert rig.judge is not None
    for session in (OWNER, NOBODY):
        for request, fields in (("ARM", (0, rate)), ("START", (0, 0, 0)), ("DISARM", ()),
                                ("HEARTBEAT", ()), ("STOP", (0,))):  # fmt: skip
            rig.packet(packet(request, session, *fields, node=node))
    rig.packet(packet("CLEAR_FAULT", NOBODY, 1, node=node))
    rig.packet(packet("ESTOP", 8, node=0))
    rig.run(rig.now + config.tick_hz)
    for trips in (0, 1, 3, TURN - 1):
        rig.packet(packet("CLEAR_FAULT", OWNER, trips, node=node))
        assert refusal(rig) == (STATE, 2)
    assert rig.amplifier.state.name == "ESTOP"
    rig.packet(packet("CLEAR_FAULT", OWNER, 2, node=node))
    assert rig.amplifier.state.name == "IDLE"


def test_a_clear_fault_from_before_a_second_estop_does_not_end_it() -> None:
    """Late, sent again, or on its way while the second came: it names what its host knew of."""
    rig = loud(Rig(CONFIGS["as shipped"]), 8000)
    clear = packet("CLEAR_FAULT", OWNER, 1)
    rig.packet(packet("ESTOP", 1, node=0))
    rig.run(rig.now + 30_000)
    rig.packet(packet("ESTOP", 2, node=0))
    for _ in range(3):
        rig.packet(clear)
        assert refusal(rig) == (STATE, 2)
        rig.run(rig.now + 50_000)
    rig.packet(packet("CLEAR_FAULT", OWNER, 2))
    assert rig.amplifier.state.name == "IDLE"
    rig.packet(packet("ESTOP", 3, node=0))
    for late in (clear, packet("CLEAR_FAULT", OWNER, 2)):
        rig.packet(late)
        assert refusal(rig) == (STATE, 3)
    rig.fault(4)
    rig.packet(packet("CLEAR_FAULT", OWNER, 3))
    assert refusal(rig) == (STATE, 4)
    rig.packet(packet("CLEAR_FAULT", OWNER, 4))
    assert refusal(rig) == (9, 4)
    rig.fault(0)
    rig.packet(packet("CLEAR_FAULT", OWNER, 4))
    assert rig.amplifier.state.name == "IDLE"


@pytest.mark.parametrize("flags", [0x00, 0x47, 0x58, 0x80, 0xFF])
def test_estop_is_taken_of_any_version(flags: int) -> None:
    """Its flags keep nothing else from being refused."""
    rig = loud(Rig(CONFIGS["as shipped"]), 8000)
    rig.packet(packet("STOP", OWNER, 1, flags=flags))
    assert (rig.amplifier.state.name == "RUNNING") == (flags != 0x47)
    rig.packet(packet("ESTOP", 5, flags=flags))
    assert rig.amplifier.state.name == "ESTOP"


def test_a_second_host_that_presses_estop_cannot_take_over_while_the_owner_lives() -> None:
    """The table lets HELLO in ESTOP: the owner's heartbeat and the output that falls do not."""
    rig = loud(Rig(CONFIGS["as shipped"]), 8000)
    second = packet("HELLO", NOBODY, 1, 0, 0)
    rig.packet(packet("ESTOP", 1))
    for _ in range(20):
        rig.packet(second)
        assert refusal(rig) == (BUSY, 0)
        rig.packet(packet("HEARTBEAT", OWNER))
        rig.run(rig.now + 50_000)
    assert rig.judge is not None
    rig.run(rig.judge.heard + 149_999)
    rig.packet(second)
    assert (refusal(rig), rig.amplifier.session) == ((BUSY, 0), OWNER)
    rig.run(rig.now + 1)
    rig.packet(second)
    assert (refusal(rig), rig.amplifier.session) == (None, NOBODY)
    rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    assert rig.amplifier.session == OWNER


def test_a_second_host_does_not_take_over_an_output_that_falls() -> None:
    """With its owner dead for 150 ms, an ESTOP or not: its limits would change on the way."""
    rig = lowered(CONFIGS["as shipped"], 16_000, (50_000_000, 2_540, 0))
    assert rig.judge is not None
    stream(rig, 148, beating=NOBODY)
    rig.packet(packet("ESTOP", 1))
    rig.run(rig.judge.heard + 151_000)
    assert any(rig.judge.codes)
    rig.packet(packet("HELLO", NOBODY, 1, 0, 0))
    assert refusal(rig) == (BUSY, 0)
    rig.run(rig.now + 20_000)
    rig.packet(packet("HELLO", NOBODY, 1, 0, 0))
    assert rig.amplifier.session == NOBODY


@pytest.mark.parametrize("state", STATES)
def test_the_address_changes_in_idle_and_safe_only(state: str) -> None:
    rig = Rig(CONFIGS["as shipped"])
    rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    if state not in ("IDLE", "FAULT"):
        loud(rig, 8000)
    if state == "ARMED":
        rig.packet(packet("STOP", OWNER, 1))
        rig.run(rig.now + 20_000)
    if state == "RAMPDOWN":
        rig.packet(packet("STOP", OWNER, 0))
    if state == "SAFE":
        rig.run(rig.now + 300_000)
    if state == "FAULT":
        rig.fault(1)
    if state == "ESTOP":
        rig.packet(packet("ESTOP", 1))
    assert rig.amplifier.state.name == state
    rig.packet(packet("SET", OWNER, 1, 9, node=0))
    assert rig.amplifier.node == 1
    rig.packet(packet("SET", OWNER, 1, 9))
    settled = state in ("IDLE", "SAFE")
    assert (rig.amplifier.node, refusal(rig)) == ((9, None) if settled else (1, (STATE, 0)))


@pytest.mark.parametrize("name", NAMES)
def test_limits_cannot_be_lowered_under_an_output_that_falls(name: str) -> None:
    """A slew of 1 V/s, taken in ESTOP, would leave the output where it is."""
    config = CONFIGS[name]
    rig = loud(Rig(config), config.rate_max_hz)
    rig.packet(packet("ESTOP", 1, node=0))
    begin = rig.now
    rig.packet(packet("LIMITS", OWNER, 1, 1, 0, node=config.node))
    assert rig.sent[-1][4:8] == bytes([0x0B, 0, 7, 6])
    assert zero_after(rig) - begin <= config.tick_hz * 23 // 1000


def test_a_second_host_changes_no_code_that_is_put_out() -> None:
    """It sends everything it can but ESTOP, to the address and to all, between any two packets."""
    config, rng = CONFIGS["fast ticks"], Random(5)
    rig = loud(Rig(config), 2_000)
    rig.packet(packet("STOP", OWNER, 0))
    rig.run(rig.now + config.tick_hz // 5)
    armed = next(k for k, r in enumerate(rig.records) if r.data[:1] == b"\x06")
    disturbed = []
    for k, record in enumerate(rig.records):
        disturbed.append(record)
        if k >= armed:
            name, *fields = rng.choice(
                [("HELLO", 1, 0, 0), ("START", 0, 0, 0), ("STOP", 1), ("ARM", 0, 1000), ("DISARM",),
                 ("CLEAR_FAULT", 0), ("HEARTBEAT",), ("LIMITS", 1, 0, 1), ("SET", 1, 9)]
            )  # fmt: skip
            data = packet(str(name), rng.choice([NOBODY, 0]), *map(int, fields),
                          node=rng.choice([0, 1]))  # fmt: skip
            later = rig.records[k + 1].tick if k + 1 < len(rig.records) else record.tick
            disturbed.append(Record(rng.randint(record.tick, later), PACKET, data))
            codes = packet("PCM", 0, NOBODY, 0, 5, 0, 1, body=LOUD * 5)
            disturbed.append(Record(later, PACKET, codes))
    again = play(config, [*disturbed, Record(rig.now, 4)])
    assert len(again.records) > 2 * len(rig.records)
    assert again.out() == rig.out()
    assert again.amplifier.session == OWNER


def test_a_host_that_never_reads_costs_no_memory() -> None:
    """What is sent and not taken is dropped and counted."""
    rig = Rig(CONFIGS["as shipped"], judged=False)
    rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    before = rig.memory()
    for k in range(3000):
        rig.port.feed(packet("POLL"), rig.now + 1000 * k)
        rig.amplifier.take_played()
    assert rig.memory() < before + 256 * 300
    assert len(rig.port.take()) == 256
    dropped = rig.amplifier.counters.dropped_replies
    assert dropped > 2700
    rig.port.feed(packet("POLL"), rig.amplifier.due() - 1)
    assert rig.port.take()[-1][3] == (1 + 256 + dropped) & 0xFF


def test_frames_without_end_cost_no_memory() -> None:
    """A queue holds four for each channel, whatever comes."""
    config = CONFIGS["as shipped"]
    rig = Rig(config)
    for name, *fields in (("HELLO", 1, 0, 0), ("ARM", 1, 8000)):
        rig.packet(packet(str(name), OWNER, *map(int, fields)))
    rig.packet(packet("CARRIERS", OWNER, 16, body=bytes(64)))
    rig.packet(packet("START", OWNER, 0, 40, 0))
    memory = []
    for position in range(900, 0, -1):
        rig.packet(packet("SPECTRUM", position, OWNER, 9, 0, 2, 3, 16, body=bytes(64)))
        memory.append(rig.memory())
    assert max(memory) == pytest.approx(memory[10], rel=0.05)
    assert rig.amplifier.counters.future_samples == 2 * (900 - 4)


@pytest.mark.parametrize(("name", "refused"), [("as shipped", None), ("slow ticks", (13, 3))])
def test_frames_are_played_by_what_says_so_in_caps(
    name: str, refused: tuple[int, int] | None
) -> None:
    rig = Rig(CONFIGS[name])
    rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    rig.packet(packet("ARM", OWNER, 1, rig.config.rate_max_hz))
    rig.packet(packet("CARRIERS", OWNER, 1, body=bytes([0, 0, 0, 8])))
    rig.packet(packet("START", OWNER, 0, 0, 0))
    rig.packet(packet("SPECTRUM", 20, OWNER, 60, 0, 1, 3, 1, body=b"\xff\0"))
    assert refusal(rig) == refused
    rig.run(rig.now + rig.config.tick_hz // 20)
    assert np.concatenate(rig.rows)["codes"].any() == (refused is None)


def test_nothing_is_armed_before_a_session_is_taken() -> None:
    """Token 0 is nobody's: requests with it, before and after there is an owner."""
    rig = Rig(CONFIGS["as shipped"])
    for _ in range(2):
        for name, *fields in (("ARM", 0, 8000), ("START", 0, 0, 0), ("LIMITS", 1, 1, 1),
                              ("SET", 1, 9), ("HEARTBEAT",), ("HELLO", 1, 0, 0)):  # fmt: skip
            rig.packet(packet(str(name), 0, *map(int, fields)))
        rig.run(rig.now + 50_000)
        assert rig.amplifier.state.name == "IDLE"
        assert not rig.amplifier.high_voltage
        rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    assert rig.amplifier.counters.foreign_session == 10


@pytest.mark.parametrize("rate", [1_000, 1_049])
def test_the_watchdog_acts_at_the_first_instant_150_ms_after_a_heartbeat(rate: int) -> None:
    """150 ms are 4915.2 ticks of 32768 Hz: heartbeats at all phases between two instants."""
    rig = Rig(CONFIGS["slow ticks"])
    rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    for phase in range(32768 // rate + 1):
        rig.packet(packet("ARM", OWNER, 0, rate))
        rig.run(rig.amplifier.due() + phase)
        rig.packet(packet("HEARTBEAT", OWNER))
        rig.run(rig.now + 5100)
        assert rig.amplifier.state.name == "SAFE"
