"""Playing: aligned blocks over exactly the duration, fades at both ends, nothing sent twice."""

from dataclasses import replace

import numpy as np
import pytest
from playback_rig import FADE, RATE, SINGLE, TRAJECTORIES, Played, played, stroke

from firmware_protocol.messages import Fault
from tactile.clock import ModelClock
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.trajectory_playback import PlayedBlock, play
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer, render
from tactile.texture.surface import Texture

# Blocks


@pytest.fixture(scope="module", params=TRAJECTORIES)
def case(
    request: pytest.FixtureRequest, display: Display, oak: Texture
) -> tuple[Trajectory, Played]:
    trajectory = TRAJECTORIES[request.param]
    return trajectory, played(display, oak, trajectory)


def test_blocks_cover_exactly_the_duration(case: tuple[Trajectory, Played]) -> None:
    trajectory, p = case
    count = round(trajectory.duration * RATE)
    assert all(len(block.time) > 0 for block in p.blocks)
    # times near 5 s, in doubles
    expected = trajectory.time[0] + np.arange(count) / RATE
    np.testing.assert_allclose(p.all("time"), expected, rtol=0, atol=1e-12)
    for block in p.blocks:
        size = len(block.time)
        assert block.position.shape == (size, 2)
        assert block.normal_force.shape == (size,)
        assert block.drive.shape == block.shear.shape == (size, 24)


def test_place_and_force_belong_to_their_time(case: tuple[Trajectory, Played]) -> None:
    trajectory, p = case
    position, force = trajectory.at(p.all("time"))
    np.testing.assert_allclose(p.all("position"), position, rtol=0, atol=1e-15)
    np.testing.assert_allclose(p.all("normal_force"), force, rtol=1e-12)


def test_the_speed_is_the_fingers_at_the_blocks_end(case: tuple[Trajectory, Played]) -> None:
    """Errors are what kinks of a path, up to 10 m/s² apart, leave of a difference of samples."""
    trajectory, p = case
    for block in p.blocks:
        before, after = (trajectory.at(block.time[-1] + side)[0] for side in (-1e-5, 1e-5))
        speed = float(np.hypot(*(after - before))) / 2e-5
        assert block.speed == pytest.approx(speed, abs=1e-3)


def test_every_position_is_written_exactly_once_and_in_order(
    case: tuple[Trajectory, Played],
) -> None:
    trajectory, p = case
    positions = [
        n for b in p.written for n in range(b.position, b.position + len(b.volts))
    ]  # fmt: skip
    assert positions == list(range(round(trajectory.duration * RATE) + p.delay))
    assert p.bus.counters.faults() == {}
    assert p.bus.counters.samples == len(positions)


def test_what_is_handed_out_is_what_the_bus_put_out(
    case: tuple[Trajectory, Played], display: Display
) -> None:
    trajectory, p = case
    count = round(trajectory.duration * RATE)
    out = p.bus.output
    assert len(out) == count + p.delay + FADE
    lsb = display.limits.voltage / 32767
    put_out = out[p.delay : p.delay + count][:, display.channel]
    np.testing.assert_allclose(put_out, p.all("drive"), rtol=0, atol=0.51 * lsb)


def test_drive_and_shear_are_those_of_the_renderer_between_the_fades(
    case: tuple[Trajectory, Played], display: Display, oak: Texture
) -> None:
    """The drive is that of the renderer too, but for the 16 taps on either side of a fade."""
    trajectory, p = case
    r = render(display, oak, trajectory, sample_rate=RATE)
    n = np.arange(len(r.shear))
    up, down = np.minimum(n / FADE, 1), np.clip((len(n) - n) / FADE, 0, 1)
    if len(n) >= 2 * FADE:
        weight = (1 - np.cos(np.pi * np.minimum(up, down))) / 2
        scale = np.abs(r.shear).max()
        np.testing.assert_allclose(
            p.all("shear"), r.shear * weight[:, None], rtol=0, atol=SINGLE * scale
        )
    middle = slice(FADE + 32, len(n) - FADE - 32)
    np.testing.assert_allclose(
        p.all("drive")[middle], r.drive[middle], rtol=0, atol=SINGLE * 10 * np.abs(r.drive).max()
    )


# Fades


def test_target_and_drive_begin_and_end_at_0(case: tuple[Trajectory, Played]) -> None:
    """The last sample is one before the fade's end, where half a cosine has 1e-4 left.

    The drive runs ahead of the target by the inverse's taps, a few samples at 1 % and less.
    """
    _, p = case
    shear, drive = p.all("shear"), p.all("drive")
    assert not shear[0].any()
    assert np.abs(shear[-1]).max() <= 1.01e-4 * max(np.abs(shear).max(), 20e-6)
    for end in (drive[0], drive[-1]):
        assert np.abs(end).max() <= 1e-3 * max(np.abs(drive).max(), 10.0)
    assert not p.bus.output[0].any()
    assert not p.bus.output[-1].any()


def test_no_jump_is_put_out_at_either_end(display: Display, oak: Texture) -> None:
    """The largest step of the fades of a steady stroke is no larger than that between them."""
    p = played(display, oak, stroke(0.5))
    step = np.abs(np.diff(p.bus.output, axis=0)).max(axis=1)
    usual = step[FADE + 32 : -2 * FADE - 32].max()
    assert step[: FADE + 32].max() <= usual
    assert step[-2 * FADE - 32 :].max() <= usual


def test_a_stroke_shorter_than_two_fades_never_reaches_full_shear(
    display: Display, oak: Texture
) -> None:
    """The fade comes to half of its way in 30 ms, where half a cosine is one half."""
    trajectory = stroke(0.03)
    shear = played(display, oak, trajectory).all("shear")
    full = render(display, oak, trajectory, sample_rate=RATE).shear
    weight = np.abs(shear).max(axis=1) / np.abs(full).max(axis=1)
    assert weight.max() == pytest.approx(0.5, abs=1e-3)
    assert weight.argmax() == 80


@pytest.mark.parametrize("limit", [1.0, 20.0])
def test_a_shorter_or_longer_fade_of_the_display_is_kept(
    display: Display, oak: Texture, limit: float
) -> None:
    quick = replace(display, limits=replace(display.limits, fade=limit * 1e-3))
    trajectory = stroke(0.2)
    full = render(quick, oak, trajectory, sample_rate=RATE).shear
    p = played(quick, oak, trajectory)
    weight = np.abs(p.all("shear")).max(axis=1) / np.abs(full).max(axis=1)
    fade = round(limit * 8)
    whole = np.flatnonzero(weight > 1 - 1e-6)
    assert whole[0] == pytest.approx(fade, abs=0.02 * FADE)
    assert whole[-1] == pytest.approx(1600 - fade, abs=0.02 * FADE)


# The clock


class CountedClock(ModelClock):
    """Time that passes only where somebody waits or works."""

    slept = 0.0

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        self.slept += max(seconds, 0.0)


@pytest.mark.parametrize("work", [0.0, 0.005, 0.02])
def test_in_real_time_blocks_keep_absolute_deadlines(
    display: Display, oak: Texture, work: float
) -> None:
    """Less work than the 8 ms of a block leaves no drift; with more nobody waits at all.

    Two blocks are shorter than 64 samples, so that work may be late by itself once.
    """
    clock = CountedClock()
    begins: list[float] = []

    def listen(block: PlayedBlock) -> None:
        begins.append(clock.time)
        clock.time += work

    renderer = Renderer(display, oak, sample_rate=RATE)
    with open_bus("mock:", display, sample_rate=RATE) as bus:
        play(
            display, renderer, stroke(0.4), bus, sample_rate=RATE, listen=listen, clock=clock
        )  # fmt: skip
    if work < 0.008:
        cut = 3200 - FADE  # an edge where the fade begins, besides the blocks' own
        edges = sorted({*range(64, 3216, 64), cut, 3216})
        # the first block begins at once, each other one when its predecessors have been played
        expected = [1.0, *(1.0 + edge / RATE for edge in edges[:-1])]
        np.testing.assert_allclose(begins, expected, rtol=0, atol=work + 1e-9)
        assert clock.time == pytest.approx(1.0 + 3216 / RATE, abs=work + 1e-9)
    else:
        assert clock.slept == 0
        assert clock.time == pytest.approx(1.0 + work * len(begins), abs=1e-9)


def test_a_bus_that_waits_is_not_waited_for_besides(display: Display, oak: Texture) -> None:
    clock = CountedClock()
    renderer = Renderer(display, oak, sample_rate=RATE)
    with open_bus("mock:", display, sample_rate=RATE) as bus:
        vars(bus)["paced"] = True
        play(
            display, renderer, stroke(0.2), bus, sample_rate=RATE, listen=lambda block: None,
            clock=clock,
        )  # fmt: skip
    assert clock.slept == 0


def test_a_stroke_that_a_fault_of_the_hardware_ends_says_so_and_not_e_stopped(
    display: Display, oak: Texture
) -> None:
    def overheat(block: PlayedBlock) -> None:
        if block.time[0] > 0.1:
            (amplifier,) = bus.model.amplifiers  # type: ignore[attr-defined]
            amplifier.fault(Fault.OVERTEMPERATURE, bus.model.tick(0))  # type: ignore[attr-defined]

    with open_bus("mock:?link=serial&format=pcm16", display, sample_rate=RATE) as bus:
        renderer = Renderer(display, oak, sample_rate=RATE)
        with pytest.raises(BusError, match=r"^node 1 reports a fault: "):
            play(display, renderer, stroke(0.4), bus, sample_rate=RATE, listen=overheat)
