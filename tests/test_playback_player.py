"""Tests of playback of one display: rendering, the rule of mixing, and being held up.

The bus is the mock amplifier, the clock turns as playback waits.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from virtual_clock import LinkTime

from tactile.arrays import Floats, Singles
from tactile.bus.base import Wiring
from tactile.bus.simulated.mock_bus import MockBus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.clock import ModelClock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.playback.block_rendering import SamplePlayback
from tactile.playback.loop import PlaybackLoop
from tactile.playback.sample_ring import LENGTH
from tactile.playback.shared_memory import PlaybackMemory
from tactile.playback.voice import Begins, Voice
from tactile.playback.waves import Curve
from tactile.rendering.contact import Trajectory
from tactile.rendering.layer import RealizedLayer
from tactile.rendering.renderer import render
from tactile.sim import SimulatedDisplay
from tactile.texture.surface import load_texture
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

RATE = 8000.0
BLOCK = 16
"""Number of samples of a block, 2 ms at 8 kHz."""
BLOCK_WORK = 12_000
"""Units of 30 ns for the waves of a block: 0.36 of its 2 ms."""
SPEED = 0.08
ME, YOU = 1, 2


@pytest.fixture(scope="module")
def oak(display: Display) -> RealizedLayer:
    return RealizedLayer(display, load_texture("wood-oak"))


@pytest.fixture(scope="module")
def leather(display: Display) -> RealizedLayer:
    return RealizedLayer(display, load_texture("leather-calf"))


@dataclass
class Stage:
    """A player, whose clock is as far as it waited, and its bus."""

    clock: ModelClock

    player: PlaybackLoop
    bus: MockBus
    memory: PlaybackMemory

    @property
    def now(self) -> float:
        return self.player.write_time(self.player.position)

    def touch(
        self, x: float, force: float = 0.5, client: int = ME, velocity: float | None = SPEED
    ) -> None:
        now = self.now
        pair = None if velocity is None else (velocity, 0.0)
        self.memory.write_contact(client, FingerSample(now, now, x, 0.0, force, pair))

    def slide(self, seconds: float, force: float = 0.5, client: int = ME) -> Floats:
        """Play, the finger sliding at `SPEED` from the origin, a sample a block; return volts."""
        before = len(self.bus.output)
        begun = self.origin = self.now
        for _ in range(int(seconds * RATE / BLOCK)):
            self.touch(SPEED * (self.now - self.origin), force, client)
            self.player.step()
        assert self.now > begun
        return self.bus.output[before:]

    def rest(self, seconds: float) -> Floats:
        """Play without a word of any finger."""
        before = len(self.bus.output)
        for _ in range(int(seconds * RATE / BLOCK)):
            self.player.step()
        return self.bus.output[before:]

    origin: float = 0.0


@pytest.fixture
def stage(display: Display, oak: RealizedLayer, leather: RealizedLayer) -> Iterator[Stage]:
    memory = PlaybackMemory.create(len(display.contactors))
    reader = PlaybackMemory(memory.handle, len(display.contactors))
    clock = ModelClock()
    bus = MockBus(Wiring.of(display, RATE), keep="all", clock=clock)
    player = PlaybackLoop(display, bus, reader, clock=clock)
    built = Stage(clock, player, bus, memory)
    player.keep(1, oak)
    player.keep(2, leather)
    player.voice(ME).state.layers = ((1, 1.0),)
    player.arm()
    built.origin = built.now
    yield built
    bus.close()
    memory.close()


def rms(volts: Floats) -> float:
    return float(np.sqrt(np.mean(volts**2)))


def parts(volts: Floats) -> tuple[float, float]:
    """Return what vibrates, rms, and what is held, the mean."""
    return rms(volts - volts.mean(axis=0)), float(volts.mean())


def test_nothing_is_put_out_before_anything_touches(stage: Stage) -> None:
    assert not stage.rest(0.2).any()


def test_a_sliding_finger_feels_what_was_selected(stage: Stage, display: Display) -> None:
    """The level is that of the texture, as the renderer plays a stroke at the same place."""
    played = stage.slide(1.0)[2000:]
    stroke = Trajectory.line(speed=SPEED, duration=1.0, normal_force=0.5)
    wanted = render(display, load_texture("wood-oak"), stroke).drive[2000:]
    assert rms(played) == pytest.approx(rms(wanted), rel=0.01)


def test_the_place_is_that_of_the_time_at_which_a_block_is_put_out(stage: Stage) -> None:
    stage.slide(0.5)
    last = stage.player.position - 1
    put_out = stage.bus.due(last + stage.player.rendering.timed)
    assert stage.player.report.position[0] == pytest.approx(
        SPEED * (put_out - stage.origin), abs=2e-5
    )


def test_a_finger_that_lifts_or_is_silent_ends_in_0_volts(stage: Stage) -> None:
    stage.slide(0.3)
    lifted = stage.slide(0.1, force=0.0)
    assert rms(lifted[:80]) > 0
    assert not lifted[400:].any(), "50 ms later"
    stage.slide(0.3)
    silent = stage.rest(0.3)
    assert rms(silent[:400]) > 0
    assert not silent[int(0.15 * RATE) :].any(), "100 ms of silence, and the fade"


def test_only_the_fingers_client_is_felt_and_textures_add_up(stage: Stage) -> None:
    """The path is the same each time; powers add, but for what two have in common by chance.

    Over 0.25 s that is within a tenth. The stretch of friction, the mean, adds as it is.
    """
    alone = parts(stage.slide(0.5)[2000:])
    stage.player.voice(YOU).state.layers = ((1, 1.0), (2, 1.0))
    stage.player.refresh(YOU)
    stage.slide(0.1, force=0.0)
    assert parts(stage.slide(0.5)[2000:]) == pytest.approx(alone, rel=1e-3), "not your finger"
    stage.slide(0.1, force=0.0)
    yours = parts(stage.slide(0.5, client=YOU)[2000:])
    stage.slide(0.1, force=0.0, client=YOU)
    stage.player.voice(YOU).state.layers = ((2, 1.0),)
    stage.player.refresh(YOU)
    leather = parts(stage.slide(0.5, client=YOU)[2000:])
    assert yours[0] == pytest.approx(np.hypot(alone[0], leather[0]), rel=0.1)
    assert yours[1] == pytest.approx(alone[1] + leather[1], rel=0.1)


def test_gains_scale_and_stop_fades(stage: Stage) -> None:
    alone = rms(stage.slide(0.5)[2000:])
    stage.player.voice(ME).state.gain = 0.25
    stage.player.refresh(ME)
    stage.slide(0.1, force=0.0)
    assert rms(stage.slide(0.5)[2000:]) == pytest.approx(alone / 4, rel=1e-3)
    stage.player.voice(ME).state.sounds = False
    stage.player.refresh(ME)
    assert not stage.slide(0.1)[400:].any()


def test_waves_of_all_clients_add_up_and_a_forgotten_one_is_let_go(stage: Stage) -> None:
    stage.player.voice(ME).state.layers = ()
    stage.slide(0.1)
    tone = (1e-6 * np.sin(2 * np.pi * 200 * np.arange(8000) / RATE)).astype(np.float32)
    for client in (ME, YOU):
        stage.player.voice(client).queue.append(tone, RATE, ())
    both = rms(stage.slide(0.3)[800:])
    stage.player.forget(YOU)
    one = rms(stage.slide(0.3)[800:])
    assert both == pytest.approx(2 * one, rel=0.02)
    assert set(stage.player.voices) == {ME}


def test_in_air_waves_are_34_db_down_unless_the_display_is_worn(
    stage: Stage, display: Display
) -> None:
    tone = (1e-6 * np.sin(2 * np.pi * 200 * np.arange(8000) / RATE)).astype(np.float32)
    stage.player.voice(ME).queue.append(tone, RATE, ())
    air = rms(stage.rest(0.3)[800:])
    stage.player.voice(ME).state.layers = ()
    touched = rms(stage.slide(0.4)[800:])
    assert air / touched == pytest.approx(10 ** (-34 / 20), rel=0.05)
    bus = MockBus(Wiring.of(display, RATE), keep="all", clock=stage.clock)
    worn = PlaybackLoop(
        display, bus, PlaybackMemory(stage.memory.handle, 24), worn=True, clock=stage.clock
    )
    worn.arm()
    worn.voice(ME).queue.append(tone, RATE, ())
    for _ in range(150):
        worn.step()
    assert rms(bus.output[800:]) == pytest.approx(touched, rel=0.05)
    bus.close()


def test_what_was_to_sound_before_does_not_go_on_when_it_is_armed(stage: Stage) -> None:
    """The client that arms decides what sounds, after a disarm and after an e-stop."""
    stage.player.voice(ME).state.layers = ()
    stage.player.refresh(ME)
    tone = (1e-6 * np.sin(2 * np.pi * 200 * np.arange(8000) / RATE)).astype(np.float32)
    stage.player.voice(ME).queue.append(tone, RATE, ())
    assert stage.rest(0.1).any()
    stage.player.disarm()
    stage.player.arm()
    assert not stage.rest(0.3).any()


CODE = 100.0 / 32767
"""Voltage of one step of what goes over the wire [V]."""


def costliest(amplitude: float) -> Curve:
    """Return an effect of as many points and transients as there may be, which overlap."""
    time = np.linspace(0, 1, 500)
    full = np.ones(500)
    taps = np.column_stack([time / 4, full, 20 * full])
    return Curve(
        amplitude, np.column_stack([time, full]), np.column_stack([time, full]), taps, False
    )


def test_a_stroke_is_the_same_while_60_others_play_all_they_may(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others play at no amplitude; what they cost is counted as it is spent."""
    alone = stage.slide(0.5)[2000:]
    stage.slide(0.1, force=0.0)
    spent = [0]
    take = Voice.take

    def counted(voice: Voice, count: int, begins: Begins = ()) -> Singles | None:
        spent[-1] += voice.work(count)
        return take(voice, count, begins)

    monkeypatch.setattr(Voice, "take", counted)
    step = stage.player.step

    def crowded() -> None:
        for client in range(10, 70):
            voice = stage.player.voice(client)
            voice.queue.append(np.zeros(4000, np.float32), 48_000.0, (client % 24,))
        spent.append(0)
        step()

    for client in range(10, 70):
        stage.player.voice(client).effect.begin(costliest(0.0))
    monkeypatch.setattr(stage.player, "step", crowded)
    # arrays elsewhere in memory are summed in another order: what rounds may go to the next code
    np.testing.assert_allclose(stage.slide(0.5)[2000:], alone, rtol=0, atol=1.01 * CODE)
    assert BLOCK_WORK // 2 < max(spent) <= BLOCK_WORK
    stage.player.write_report()
    counters = stage.memory.report().counters
    assert counters["skipped_samples"] == counters["late_blocks"] == 0
    assert counters["dropped_waves"] > 250 * 40


def test_transients_that_are_too_many_at_once_are_counted(stage: Stage) -> None:
    curve = costliest(1e-6)
    stage.player.voice(YOU).effect.begin(curve)
    stage.rest(0.1)
    stage.player.write_report()
    assert stage.memory.report().counters["dropped_waves"] == curve.dropped > 0


def test_held_up_it_goes_on_in_step_fading_in_and_counts(stage: Stage, display: Display) -> None:
    stage.slide(0.3)
    stage.clock.sleep(BLOCK / RATE + 0.05)
    before = stage.player.position
    stage.player.step()
    assert stage.player.position - before == pytest.approx(0.05 * RATE + BLOCK, abs=2 * BLOCK)
    stage.player.write_report()
    assert stage.memory.report().counters["skipped_samples"] >= 0.05 * RATE - BLOCK
    played = stage.slide(0.2)
    step = min(display.slew / RATE, 200.0)
    assert np.abs(np.diff(stage.bus.output, axis=0)).max() <= step
    assert rms(played[-400:]) > 0


def test_the_share_that_was_put_out_counts_from_arming(stage: Stage) -> None:
    def share() -> float:
        stage.player.write_report()
        return stage.memory.report().put_out_share

    assert math.isnan(share())
    stage.slide(0.3)
    assert share() == 1.0
    stage.clock.sleep(BLOCK / RATE + 0.05)
    stage.slide(0.1)
    silent = max(board.amplifier.counters.lost_samples for board in stage.bus.boards)
    assert silent >= 0.05 * RATE - BLOCK
    assert share() == pytest.approx(1 - silent / stage.player.position, rel=1e-12)
    stage.player.disarm()
    stage.player.arm()
    assert math.isnan(share())
    stage.slide(0.1)
    assert share() == 1.0


def test_a_texture_that_is_changed_while_it_plays_makes_no_step(stage: Stage) -> None:
    steady = stage.slide(0.4)[1000:]
    largest = np.abs(np.diff(steady, axis=0)).max()
    stage.player.voice(ME).state.layers = ((2, 1.0),)
    stage.player.refresh(ME)
    change = stage.slide(0.1)
    assert np.abs(np.diff(change, axis=0)).max() < 1.5 * largest


def test_after_disarming_nothing_of_before_is_heard(stage: Stage) -> None:
    stage.slide(0.3)
    stage.player.disarm()
    stage.player.tracker = ContactTracker()
    before = len(stage.bus.output)
    stage.player.arm()
    for _ in range(60):
        stage.player.step()
    assert not stage.bus.output[before:].any()


def test_the_report_tells_what_is_played(stage: Stage) -> None:
    stage.slide(0.5)
    stage.player.write_report()
    report = stage.memory.report()
    assert (report.state, report.link, report.touching, report.client) == ("armed", "up", True, ME)
    assert report.blocks == 250
    assert report.velocity[0] == pytest.approx(SPEED, rel=0.05)
    assert report.normal_force == pytest.approx(0.5, rel=0.01)
    assert stage.memory.drive.any()
    assert stage.memory.shear.any()
    assert stage.player.position == 250 * BLOCK
    stage.player.disarm()
    stage.player.write_report()
    assert not stage.memory.drive.any()
    assert not stage.memory.shear.any()


def test_spectrum_frames_are_played_where_the_link_takes_them(display: Display) -> None:
    from tactile.rendering.spectrum import SpectrumRenderer

    memory = PlaybackMemory.create(24)
    url = "mock:?link=can&format=spectrum&keep=all"
    with open_bus(url, display) as bus:
        assert isinstance(bus, ModeledBus)
        assert bus.frames is not None
        texture = SpectrumRenderer(
            display, load_texture("wood-oak"), carriers=bus.frames.carriers,
            frame_rate=bus.frames.rate, whole_band=True,
        )  # fmt: skip
        player = PlaybackLoop(display, bus, PlaybackMemory(memory.handle, 24), clock=LinkTime(bus))
        player.keep(1, texture)
        player.voice(ME).state.layers = ((1, 1.0),)
        player.arm()
        begun = player.write_time(0)
        for k in range(30):
            now = player.write_time(k * player.rendering.spacing)
            x = SPEED * (now - begun)
            memory.write_contact(ME, FingerSample(now, now, x, 0.0, 0.5, (SPEED, 0.0)))
            player.step()
        assert not isinstance(player.rendering, SamplePlayback)
        assert bus.counters.faults() == {}
        put_out = bus.output
        assert rms(put_out[2000:]) > 0.5
        player.write_report()
        assert memory.report().put_out_share == 1.0
        bus.model.run_alone(bus.model.clock.now() + 0.1)
        player.step()
        player.write_report()
        skipped = memory.report().counters["skipped_samples"]
        assert skipped >= 0.1 * RATE - 2 * player.rendering.spacing
        assert memory.report().put_out_share <= 1 - skipped / player.position < 1
    memory.close()


def test_the_trace_is_the_commanded_shear_sample_by_sample(stage: Stage, display: Display) -> None:
    stage.slide(0.5)
    stage.player.write_report()
    first, shear = stage.memory.commanded.since(3, 2400)
    assert (first, len(shear)) == (2400, 1600)
    assert shear[-1] == stage.memory.shear[3]
    stroke = Trajectory.line(speed=SPEED, duration=0.5, normal_force=0.5)
    wanted = render(display, load_texture("wood-oak"), stroke).shear[:, 3]
    single = 2**-24 * np.abs(wanted).max()  # rounding
    np.testing.assert_allclose(shear, wanted[2400:], rtol=0, atol=4 * single)


def test_what_the_simulated_skin_does_is_what_is_commanded(
    display: Display, oak: RealizedLayer
) -> None:
    """Compare both rings after the delay at which they agree best, of less than 10 ms."""
    memory = PlaybackMemory.create(len(display.contactors))
    bus = SimulatedDisplay(display, RATE)
    clock = ModelClock()
    player = PlaybackLoop(display, bus, memory, clock=clock, played=bus.take_shear)
    player.keep(1, oak)
    player.voice(ME).state.layers = ((1, 1.0),)
    player.arm()
    Stage(clock, player, bus, memory).slide(0.5)
    for contactor in (0, 13):
        commanded = memory.commanded.since(contactor, 0)[1].astype(np.float64)
        played = memory.played.since(contactor, 0)[1].astype(np.float64)
        inner = commanded[100 : len(commanded) - 100]
        error = min(np.std(played[100 + lag : 100 + lag + len(inner)] - inner) for lag in range(80))
        assert error < 0.01 * np.std(inner)
    bus.close()
    memory.close()


@pytest.mark.parametrize("count", [BLOCK, 37, 3 * LENGTH // 2])
@pytest.mark.parametrize("name", ["commanded", "played"])
def test_of_a_ring_the_newer_half_is_read_and_its_samples_are_numbered(
    name: str, count: int
) -> None:
    """Add blocks that divide the ring, such as those of playback, and others."""
    memory = PlaybackMemory.create(2)
    writer = getattr(memory, name)
    reader = getattr(PlaybackMemory(memory.handle, 2), name)
    blocks = 2 * LENGTH // count + 3
    for k in range(blocks):
        number = k * count + np.arange(count, dtype=np.float64)
        writer.add(np.column_stack([number, -number]))
    end = blocks * count
    assert reader.count == end
    for contactor, sign in enumerate((1, -1)):
        first, shear = reader.since(contactor, end - 100)
        np.testing.assert_array_equal(sign * shear, np.arange(end - 100, end))
        assert first == end - 100
        first, shear = reader.since(contactor, 5)
        assert first == end - LENGTH // 2
        np.testing.assert_array_equal(sign * shear, np.arange(first, end))
    assert [len(reader.since(0, end + ahead)[1]) for ahead in (0, 1, 10**6)] == [0, 0, 0]
    memory.close()


def test_contacts_are_read_whole_and_once_and_lost_ones_are_counted() -> None:
    memory = PlaybackMemory.create(1)
    reader = PlaybackMemory(memory.handle, 1)
    one = FingerSample(1.0, 2.0, 3.0, 4.0, 0.5)
    sent = [
        (k, one._replace(time=float(k), velocity=(5.0, 6.0) if k % 2 else None)) for k in range(10)
    ]
    for client, sample in sent:
        memory.write_contact(client, sample)
    assert list(reader.contacts()) == sent
    assert list(reader.contacts()) == []
    for k in range(1000):
        memory.write_contact(1, one._replace(time=float(k)))
    times = [sample.time for _, sample in reader.contacts()]
    assert times == list(range(1000 - len(times), 1000))
    assert reader.lost_contacts == 1000 - len(times)
    memory.close()


@pytest.mark.parametrize("how", ["estop", "abort"])
def test_an_estop_or_a_fault_between_two_lines_of_a_block_is_no_error(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """The bus is watched by another thread, which may stop it after a step has looked at it."""
    take = stage.player._take_contacts

    def stopped() -> tuple[tuple[int, FingerSample], ...]:
        getattr(stage.bus, how)()
        return take()

    monkeypatch.setattr(stage.player, "_take_contacts", stopped)
    stage.player.step()
    assert not stage.player.running


@pytest.mark.parametrize("force", [0.0, 0.5])
def test_latency_is_the_time_from_a_contact_to_the_skin_whether_or_not_a_finger_touches(
    stage: Stage, force: float
) -> None:
    """A contact waits for half a block, rendering for its margin, and a sample for the limiter."""
    margin, look_ahead = 0.5e-3, 8
    expected = BLOCK / RATE / 2 + margin + stage.bus.ahead + look_ahead / RATE
    stage.slide(0.5, force)
    assert stage.memory.report().latency == pytest.approx(expected, abs=0.05e-3)


def test_latency_is_not_known_while_nothing_plays(stage: Stage) -> None:
    stage.slide(0.1)
    assert stage.memory.report().latency > 0
    stage.player.disarm()
    assert math.isnan(stage.memory.report().latency)
    stage.player.arm()
    assert math.isnan(stage.memory.report().latency)
    stage.slide(0.1)
    assert stage.memory.report().latency > 0
    stage.bus.estop()
    stage.player.write_report()
    assert math.isnan(stage.memory.report().latency)
