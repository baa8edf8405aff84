"""Each rule of the amplifier's safety alone, with its own numbers."""

from random import Random

import numpy as np
import pytest
from protocol_judge import STATE, STATES, TURN, Limits, distance, ramp_bound
from protocol_story import NOBODY
from protocol_traces import CONFIGS, PACKET, Record, Rig, packet, play

from firmware_protocol.config import AmplifierConfig

NAMES = list(CONFIGS)
OWNER = 0x1234
LOUD = b"\xff\x7f"
NAK, UNASKED = 0x41, (0x45, 0x47, 0x48, 0x49)


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


def lowered(config: AmplifierConfig, rate: int, limits: tuple[int, int, int]) -> Rig:
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
    """High voltage is off as well. With 50 ms of heartbeats that were queued it takes 220 ms."""
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


@pytest.mark.parametrize("name", NAMES)
def test_the_hardware_s_own_limits_are_armed_at_every_rate(name: str) -> None:
    """The limits are the least: "low slew" could not be armed at all rates with 1 V/s less."""
    c = CONFIGS[name]
    rates = range(c.rate_min_hz, c.rate_max_hz + 1)
    voltage, slew = c.voltage_limit_uv, c.slew_limit_v_per_s
    assert all(Limits(voltage, slew, 0).reach(c.full_scale_uv, rate) for rate in rates)
    least = all(Limits(voltage, slew - 1, 0).reach(c.full_scale_uv, rate) for rate in rates)
    assert least == (name != "low slew")


@pytest.mark.parametrize("rate", [1000, 1049, 1599, 1600])
def test_limits_are_taken_in_codes_at_the_rate(rate: int) -> None:
    """A slew of one code per step too little is refused by LIMITS and ARM: RANGE, 2."""
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


def test_a_second_host_changes_no_code_that_is_put_out() -> None:
    """The second host sends all it can but ESTOP, to the address and to all, between packets."""
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
    """Packets that are sent and not taken are dropped and counted."""
    rig = Rig(CONFIGS["as shipped"], judged=False)
    rig.packet(packet("HELLO", OWNER, 1, 0, 0))
    before = rig.memory()
    for k in range(3000):
        rig.feed(packet("POLL"), rig.now + 1000 * k)
        rig.amplifier.take_played()
    assert rig.memory() < before + 256 * 300
    assert len(rig.packets()) == 256
    dropped = rig.amplifier.counters.dropped_replies
    assert dropped > 2700
    rig.feed(packet("POLL"), rig.amplifier.due() - 1)
    assert rig.packets()[-1][3] == (1 + 256 + dropped) & 0xFF


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
