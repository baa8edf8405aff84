"""No sequence of messages, losses and delays makes the amplifier unsafe; the one in C is the same.

`protocol_judge` computes from SPEC.md what may be put out at each instant, `protocol_story` makes
up what hosts and links may do. Here both meet: in a state machine that hypothesis drives and
shrinks, and in long stories from seeds. Each story is played again on the amplifier in C, which has
to put out the same codes at the same ticks in the same states, and to send the same bytes.

Time is virtual throughout. What a failure leaves behind is `rig.records`; `saved` makes it a file
for `virtual-amplifier --replay`.
"""

from pathlib import Path
from random import Random

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)
from protocol_judge import SPEC, STATES, TABLE
from protocol_story import Story, told
from protocol_traces import CONFIGS, Rig, loaded, play, replay, saved
from repeating import LONG

NAMES = list(CONFIGS)
CHANCE = st.integers(0, 1 << 20).map(Random)
STEPS = settings(stateful_step_count=40)
C = SPEC.parent / "c"


def assert_same(rig: Rig, program: Path, at: Path) -> None:
    """Compare what a rig recorded with what the amplifier in C makes of the same trace."""
    out, sent = replay(program, rig.config, rig.records, at)
    assert rig.out() == out
    assert rig.sent == sent


def assert_bounded(rig: Rig) -> None:
    """Check that nothing received is kept for longer than its use."""
    c = rig.config
    frames = 5 * c.channels * (16 * c.carriers + 300)
    assert rig.memory() < 10_000 + 20 * c.fifo * c.channels + frames


# Whatever happens


class Trial(RuleBasedStateMachine):
    """An amplifier, an owner, a second host and a link, in the hands of hypothesis."""

    @initialize(name=st.sampled_from(NAMES), trouble=st.sampled_from([0.0, 0.2]), one=st.booleans())
    def power_up(self, name: str, trouble: float, one: bool) -> None:
        self.rig = Rig(CONFIGS[name], singly=one)
        self.story = Story(self.rig, Random(0), trouble)

    def chance(self, rng: Random) -> Story:
        self.story.rng = rng
        return self.story

    @rule(rng=CHANCE)
    def owner_takes_arms_and_starts(self, rng: Random) -> None:
        self.chance(rng).ready()

    @rule(rng=CHANCE)
    def owner_streams(self, rng: Random) -> None:
        self.chance(rng).stream(self.story.some(5, 15, 30))

    @rule(rng=CHANCE)
    def owner_sends_data_anywhere(self, rng: Random) -> None:
        self.chance(rng).data()

    @rule(rng=CHANCE)
    def owner_beats(self, rng: Random) -> None:
        self.chance(rng).beat()

    @rule(rng=CHANCE, name=st.sampled_from(["hello", "arm", "start", "tune", "clear", "poll"]))
    def owner_prepares(self, rng: Random, name: str) -> None:
        getattr(self.chance(rng), name)()

    @rule(rng=CHANCE, name=st.sampled_from(["stop", "disarm", "limits", "ask"]))
    def owner_asks(self, rng: Random, name: str) -> None:
        getattr(self.chance(rng), name)()

    @rule(rng=CHANCE)
    def second_host_tries(self, rng: Random) -> None:
        self.chance(rng).foreign()

    @rule(rng=CHANCE)
    def anybody_stops(self, rng: Random) -> None:
        self.chance(rng).estop()

    @rule(rng=CHANCE)
    def noise_comes(self, rng: Random) -> None:
        self.chance(rng).raw()

    @rule(rng=CHANCE)
    def hardware_fails_or_recovers(self, rng: Random) -> None:
        self.chance(rng).fault()

    @rule(rng=CHANCE)
    def somebody_moves_the_button(self, rng: Random) -> None:
        self.chance(rng).button()

    @rule(rng=CHANCE)
    def time_passes(self, rng: Random) -> None:
        self.chance(rng).pause()

    @precondition(lambda self: self.rig.judge.state in ("ARMED", "RUNNING", "RAMPDOWN"))
    @rule(rng=CHANCE)
    def owner_dies(self, rng: Random) -> None:
        self.chance(rng).silence()

    def teardown(self) -> None:
        if hasattr(self, "rig"):
            self.rig.run(self.rig.now + self.story.ms(40))
            assert_bounded(self.rig)


def test_no_sequence_of_events_breaks_a_rule_of_safety() -> None:
    """The judge sees every instant, every packet that comes and every one that is sent."""
    run_state_machine_as_test(Trial, settings=settings(STEPS, max_examples=25))


@pytest.mark.ci
def test_no_long_sequence_of_events_breaks_a_rule_of_safety() -> None:
    long = settings(STEPS, max_examples=120, stateful_step_count=100)
    run_state_machine_as_test(Trial, settings=long)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", NAMES)
def test_no_story_breaks_a_rule_of_safety(name: str, seed: int) -> None:
    rig = told(CONFIGS[name], seed, 1.0, judged=True)
    assert rig.judge is not None
    assert rig.judge.instants == sum(map(len, rig.rows)) > 400
    assert_bounded(rig)


@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_no_long_story_breaks_a_rule_of_safety(name: str) -> None:
    for seed in range(100, 115):
        assert_bounded(told(CONFIGS[name], seed, 1.0, judged=True))


def test_the_table_of_states_is_read_whole() -> None:
    """The judge has its table of states from the document: 12 events in 7 states."""
    assert STATES == ("IDLE", "ARMED", "RUNNING", "RAMPDOWN", "SAFE", "FAULT", "ESTOP")
    assert len(TABLE) == 12
    assert all(len(cells) == len(STATES) for cells in TABLE.values())
    assert TABLE["watchdog"][2] == "RAMPDOWN:SAFE"


# The same in C, to the last bit


@pytest.mark.parametrize("seed", range(1000, 1008))
@pytest.mark.parametrize("name", NAMES)
def test_the_amplifier_in_c_does_the_same(
    name: str, seed: int, virtual_amplifier: Path, tmp_path: Path
) -> None:
    assert_same(told(CONFIGS[name], seed, 1.0, judged=False), virtual_amplifier, tmp_path)


@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_the_amplifier_in_c_does_the_same_for_long(
    name: str, virtual_amplifier: Path, tmp_path: Path
) -> None:
    """40 stories of 2 s for each amplifier; with ``TACTILE_LONG=1`` 10 000 of 0.5 s in all."""
    stories, seconds = (10_000 // len(NAMES) + 1, 0.5) if LONG else (40, 2.0)
    for seed in range(2000, 2000 + stories):
        assert_same(told(CONFIGS[name], seed, seconds, judged=False), virtual_amplifier, tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_runs_and_single_instants_are_the_same(name: str) -> None:
    rig = told(CONFIGS[name], 7, 0.4, judged=False)
    single = play(CONFIGS[name], rig.records, judged=False, singly=True)
    assert (single.out(), single.sent) == (rig.out(), rig.sent)


def test_a_saved_trace_is_what_was_told() -> None:
    rig = told(CONFIGS["slow ticks"], 3, 0.2, judged=False)
    assert loaded(saved(rig.records)) == rig.records
    assert play(rig.config, loaded(saved(rig.records))).out() == rig.out()
