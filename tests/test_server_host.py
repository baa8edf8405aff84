"""Tests of the host's requests, answered by real playback of a simulated display.

Playback and the host bear with each other for as long as a slow machine takes; when they do not is
tested in virtual time (`test_playback_process`, `test_estop_model`).
"""

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar, get_args

import numpy as np
import pytest
from msgspec import structs

from tactile import messages as m
from tactile import processes
from tactile.errors import BusError, InputError
from tactile.playback.commands import AddFrames, DeviceOpened
from tactile.playback.shared_memory import PlaybackMemory
from tactile.rendering.surface_picture import SurfaceSection, draw_surface
from tactile.server import client as client_module
from tactile.server import playing as playing_module
from tactile.server import telemetry as telemetry_module
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig, ServerConfig
from tactile.server.effects import load_effects
from tactile.server.host import Host
from tactile.server.playing import MOST_FRAME_ORDERS
from tactile.texture.surface import load_texture

T = TypeVar("T")
NAME = "right"
PATIENCE = 60.0
"""Time until a test gives up [s]; nothing that is tested depends on it."""
PATIENT = "from tactile.playback import process as p; p.SILENCE = 600.0; main()"
"""Program that a process runs: playback that waits long for the server's heartbeats."""


@pytest.fixture(scope="module", autouse=True)
def _patient() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        program = processes.PROGRAM.replace("main()", PATIENT)
        patch.setattr(processes, "PROGRAM", program)
        patch.setattr(playing_module, "PLAYBACK_SILENCE", 600.0)
        patch.setattr(playing_module, "ANSWER", PATIENCE)
        yield


class Loop:
    """An event loop that runs all the time, as a server's does."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(2 * PATIENCE)

    def call(self, work: Callable[[], T]) -> T:
        async def called() -> T:
            return work()

        return self.run(called())

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


@pytest.fixture(scope="module")
def runner() -> Iterator[Loop]:
    with closing(Loop()) as runner:
        yield runner


HUM = """
[effect]
description = "ten seconds of 160 Hz at half of 10 µm"
[[effect.perceptions]]
[[effect.perceptions.channels]]
[[effect.perceptions.channels.bands]]
kind = "wave"
[[effect.perceptions.channels.bands.segments]]
keyframes = [{ time_s = 0.0, amplitude = 0.5 }, { time_s = 10.0, amplitude = 0.5 }]
"""
"""Contents of an effect file."""


@pytest.fixture(scope="module")
def host(runner: Loop, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    folder = tmp_path_factory.mktemp("effects")
    (folder / "hum.toml").write_text(HUM)
    (folder / "broken.toml").write_text("[effect]\nx = 1\n")
    (folder / "öl.toml").write_text(HUM)
    (folder / "notes.txt").write_text("no effect")
    host = Host(
        Configuration(
            server=ServerConfig(effects=str(folder)),
            display=(DisplayConfig(name=NAME, device="sim:", voltage_limit_v=60.0),),
        )
    )
    runner.run(host.start())
    yield host
    runner.run(host.close())


class Program:
    """A client, and the loop that it lives in."""

    def __init__(self, runner: Loop, host: Host, *, roles: frozenset[m.Role] = m.ALL_ROLES) -> None:
        self.runner = runner
        self.client: Client = runner.call(lambda: host.connect("test", roles=roles))

    def ask(self, *commands: m.Command) -> list[m.Answer]:
        async def all_at_once() -> list[m.Answer]:
            return await asyncio.gather(*(self.client.request(c) for c in commands))

        return self.runner.run(all_at_once())

    def close(self) -> None:
        async def closed() -> None:
            self.client.close()
            await asyncio.sleep(0.05)

        self.runner.run(closed())

    def touch(
        self, force: float = 0.5, x: float = 0.0, *, arrival: float | None = None
    ) -> m.Failure | None:
        contact = m.Contact(display=NAME, position_mm=(x, 0.0), normal_force_n=force)
        came = time.monotonic() if arrival is None else arrival
        return self.runner.call(lambda: self.client.stream(contact, came))

    def stats(self) -> m.StatsReply:
        (answer,) = self.ask(m.GetStats(display=NAME))
        assert isinstance(answer, m.StatsReply)
        return answer

    def until(self, happens: Callable[[m.StatsReply], bool]) -> m.StatsReply:
        deadline = time.monotonic() + PATIENCE
        while not happens(stats := self.stats()):
            assert time.monotonic() < deadline, stats
            self.runner.run(asyncio.sleep(0.02))
        return stats


@pytest.fixture
def program(runner: Loop, host: Host) -> Iterator[Program]:
    program = Program(runner, host)
    yield program
    program.close()


def children() -> set[str]:
    """Return the processes that this one has started."""
    if not Path("/proc/self/task").exists():
        pytest.skip("needs Linux")
    threads = Path("/proc/self/task").glob("*/children")
    return {pid for one in threads for pid in one.read_text().split()}


def failure(answers: list[m.Answer]) -> m.Failure:
    (answer,) = answers
    assert isinstance(answer, m.Failure)
    assert "\n" not in answer.message
    return answer


OAK = m.Select(display=NAME, layers=(m.Layer(texture="wood-oak"),))
WAVE = m.Append(display=NAME, sample_rate_hz=1000.0, amplitude_um=1.0, samples=(0.5,) * 100)


def test_many_requests_at_once_are_each_answered(program: Program) -> None:
    assert program.ask(*[OAK] * 50) == [m.Done()] * 50


@pytest.mark.parametrize("name", ["wood-oka", "displays", "..", "oak.toml", "C", "a b"])
def test_a_name_chooses_among_what_there_is_and_nothing_else(program: Program, name: str) -> None:
    layers = (m.Layer(texture="wood-oak"), m.Layer(texture=name))
    told = failure(program.ask(m.Select(display=NAME, layers=layers)))
    assert (told.code, told.field) == ("unknown_texture", "layers[1].texture")


def test_more_textures_at_a_time_than_a_client_may_select_are_refused(program: Program) -> None:
    """All requests come at once, of seeds that are new: the fifth finds four that are made."""
    asked = [
        m.Select(display=NAME, layers=(m.Layer(texture="wood-oak", seed=seed),))
        for seed in range(1000, 1005)
    ]
    *answers, last = program.ask(*asked)
    assert answers == [m.Done()] * 4
    assert failure([last]).code == "busy"


def test_an_unknown_display_is_named_with_the_nearest(program: Program) -> None:
    told = failure(program.ask(m.ArmDisplay(display="rihgt")))
    assert (told.code, told.field) == ("unknown_display", "display")
    assert "'right'" in told.message
    contact = m.Contact(display="left", position_mm=(0, 0), normal_force_n=0.5)
    assert isinstance(program.client.stream(contact, 0.0), m.Failure)
    assert failure(program.ask(m.EStop(display="left"))).code == "unknown_display"


def disarm(program: Program) -> None:
    """Disarm the display, which an earlier test may have left armed."""
    program.ask(m.DisarmDisplay(display=NAME))
    program.until(lambda stats: stats.state == "disarmed")


def test_waves_need_an_armed_display_and_contactors_that_there_are(program: Program) -> None:
    effect = m.PlayEffect(display=NAME, amplitude_um=1.0, amplitude=(m.Point(0.0, 1.0),))
    disarm(program)
    assert failure(program.ask(WAVE)).code == "not_armed"
    assert failure(program.ask(effect)).code == "not_armed"
    assert program.ask(m.ArmDisplay(display=NAME)) == [m.Done()]
    program.until(lambda stats: stats.state == "armed")
    (taken,) = program.ask(WAVE)
    assert isinstance(taken, m.AppendedReply)
    assert taken.samples_consumed == 100
    assert 50 < taken.buffered_ms <= 100
    assert program.ask(effect) == [m.Done()]
    far = m.Append(
        display=NAME, sample_rate_hz=1e3, amplitude_um=1.0, samples=(0.5,), contactors=(24,)
    )
    assert failure(program.ask(far)).field == "contactors"
    back = m.PlayEffect(
        display=NAME, amplitude_um=1.0, amplitude=(m.Point(5.0, 1.0), m.Point(1.0, 1.0))
    )
    assert failure(program.ask(back)).field == "amplitude"
    for bad in (b"abc", b"\0\0\xc0\x7f", b"\0\0\0\x40"):
        wave = m.Append(display=NAME, sample_rate_hz=1e3, amplitude_um=1.0, samples=bad)
        assert failure(program.ask(wave)).field == "samples"


def frames(values: bytes | tuple[float, ...], **options: Any) -> m.TactileFrames:
    return m.TactileFrames(
        display=NAME, frame_rate_hz=1e3, amplitude_um=5.0, frames=values, **options
    )


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((0.0,) * 25, "25 values are no whole number of frames for 24 contactors"),
        (b"abc", "needs float32, at most 12000 of them"),
        (b"\0\0\xc0\x7f" * 24, "must be −1 … 1 throughout"),
        (b"\0\0\0\x40" * 24, "must be −1 … 1 throughout"),
    ],
)
def test_frames_that_do_not_fit_are_refused(
    program: Program, values: bytes | tuple[float, ...], text: str
) -> None:
    told = failure(program.ask(frames(values)))
    assert (told.code, told.field, told.message) == ("invalid_field", "frames", text)


def test_frames_for_no_display_and_for_spectrum_frames_are_refused(
    program: Program, host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    unknown = structs.replace(frames(()), display="rihgt")
    assert failure(program.ask(unknown)).code == "unknown_display"
    playing = host.playing[NAME]
    monkeypatch.setattr(playing, "how", replace(playing.how, carriers=4))
    assert failure(program.ask(frames(()))).code == "unsupported"


def test_frames_are_played_while_the_display_is_armed_and_counted_otherwise(
    program: Program, host: Host
) -> None:
    """Each contactor has a shear of its own: k / 24 of 5 µm."""
    disarm(program)
    before = program.stats().counters["dropped_frames"]
    values = tuple(k / 24 for k in range(24))
    assert program.ask(frames(values * 3)) == [m.Done()]
    assert program.stats().counters["dropped_frames"] == before + 3
    assert program.ask(m.ArmDisplay(display=NAME)) == [m.Done()]
    program.until(lambda stats: stats.state == "armed")
    memory = host.playing[NAME].memory

    def is_reached(_: m.StatsReply) -> bool:
        program.touch()
        program.ask(frames(values * 480))  # half a second, however slow this machine is
        return bool(np.allclose(memory.shear, 5e-6 * np.array(values), rtol=0.005, atol=1e-9))

    program.until(is_reached)
    program.until(lambda _: not memory.shear.any())  # the source has stopped
    before = program.stats().counters["dropped_frames"]
    program.ask(m.StopPlaying(display=NAME))
    program.ask(frames(values * 2))
    program.until(lambda stats: stats.counters["dropped_frames"] == before + 2)


def test_the_latency_is_null_while_nothing_plays(program: Program) -> None:
    disarm(program)
    assert program.stats().latency_ms is None
    program.ask(m.ArmDisplay(display=NAME))
    program.until(lambda stats: (stats.latency_ms or 0) > 0)
    disarm(program)
    program.until(lambda stats: stats.latency_ms is None)


def test_frames_that_playback_does_not_take_are_dropped_for_their_client_alone(
    runner: Loop, host: Host, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing grows while playback takes no orders."""
    other = Program(runner, host)
    assert program.ask(m.ArmDisplay(display=NAME)) == [m.Done()]
    program.until(lambda stats: stats.state == "armed")
    before = program.stats().counters["dropped_frames"]
    sent: list[Any] = []
    message = frames((0.0,) * 48)
    with monkeypatch.context() as patch:
        patch.setattr(host.playing[NAME].child, "send", sent.append)
        for one in (program, other):
            one.runner.call(lambda: [one.client.stream(message, 0.0) for _ in range(100)])  # noqa: B023
    assert [order.client for _, order in sent] == (
        [program.client.number] * MOST_FRAME_ORDERS + [other.client.number] * MOST_FRAME_ORDERS
    )
    assert all(isinstance(order, AddFrames) for _, order in sent)
    dropped = 2 * 2 * (100 - MOST_FRAME_ORDERS)
    assert program.stats().counters["dropped_frames"] == before + dropped
    other.close()


def test_effects_are_the_files_of_a_folder_that_can_be_played(program: Program) -> None:
    (listed,) = program.ask(m.ListEffects())
    description = "ten seconds of 160 Hz at half of 10 µm"
    info = m.EffectInfo(name="hum", description=description, seconds=10.0)
    assert listed == m.Effects(effects=(info,))


@pytest.mark.parametrize("name", ["hmu", "..", "hum.toml", "broken", "notes"])
def test_a_name_chooses_among_the_effects_and_nothing_else(program: Program, name: str) -> None:
    told = failure(program.ask(m.PlayNamedEffect(display=NAME, effect=name)))
    assert (told.code, told.field) == ("unknown_effect", "effect")
    assert "'hum'" in told.message or "there is: hum" in told.message


def test_an_effect_plays_by_its_name_until_it_is_stopped(program: Program, host: Host) -> None:
    """The shear is 5 µm at a gain of 1 and 2.5 µm at a half, on an armed display only."""

    def shear(least: float, most: float) -> None:
        memory = host.playing[NAME].memory

        def happens(_: m.StatsReply) -> bool:
            program.touch()
            return least <= float(np.abs(memory.shear).max()) * 1e6 <= most

        program.until(happens)

    hum = m.PlayNamedEffect(display=NAME, effect="hum")
    disarm(program)
    assert failure(program.ask(hum)).code == "not_armed"
    program.ask(m.ArmDisplay(display=NAME))
    program.until(lambda stats: stats.state == "armed")
    assert program.ask(hum) == [m.Done()]
    shear(4.0, 5.1)
    assert program.ask(m.PlayNamedEffect(display=NAME, effect="hum", gain=0.5)) == [m.Done()]
    shear(2.0, 2.6)
    assert program.runner.call(lambda: program.client.sounds)
    program.ask(m.StopPlaying(display=NAME))
    shear(0.0, 1e-6)
    program.ask(hum)
    (done,) = program.ask(m.EStop())
    assert isinstance(done, m.Done)
    assert failure(program.ask(hum)).code == "estopped"
    program.ask(m.ClearEstop(display=NAME, estop=done.estops[NAME]))
    program.ask(m.Resume(display=NAME))


def test_a_folder_of_effects_that_is_missing_is_refused_in_a_line() -> None:
    with pytest.raises(InputError, match=r"server\.effects = '/nowhere': cannot be read"):
        load_effects("/nowhere")


def test_an_e_stop_holds_until_it_is_cleared_and_needs_arming_then(program: Program) -> None:
    program.ask(m.ArmDisplay(display=NAME))
    (done,) = program.ask(m.EStop())
    assert isinstance(done, m.Done)
    number = done.estops[NAME]
    assert program.stats().estop == number
    assert program.until(lambda stats: stats.state == "estopped")
    assert failure(program.ask(m.ArmDisplay(display=NAME))).code == "estopped"
    assert failure(program.ask(WAVE)).code == "estopped"
    assert program.ask(m.ClearEstop(display=NAME, estop=number)) == [m.Done()]
    assert program.stats().state == "disarmed"
    assert program.ask(m.ArmDisplay(display=NAME)) == [m.Done()]


def test_a_clear_ends_the_e_stop_that_it_names_and_no_newer_one(program: Program) -> None:
    (first,), (second,) = program.ask(m.EStop()), program.ask(m.EStop())
    assert isinstance(first, m.Done)
    assert isinstance(second, m.Done)
    old, new = first.estops[NAME], second.estops[NAME]
    assert new == old + 1
    late = failure(program.ask(m.ClearEstop(display=NAME, estop=old)))
    assert (late.code, late.field) == ("estopped", "estop")
    assert f"e-stop {new} holds" in late.message
    never = failure(program.ask(m.ClearEstop(display=NAME, estop=new + 1)))
    assert (never.code, never.field) == ("invalid_field", "estop")
    assert program.stats().estop == new
    assert program.ask(m.ClearEstop(display=NAME, estop=new)) == [m.Done()]
    assert program.ask(m.ClearEstop(display=NAME, estop=old)) == [m.Done()], "ended long ago"
    assert program.stats().estop == 0


def test_who_may_not_arm_may_stop(runner: Loop, host: Host, program: Program) -> None:
    osc = Program(runner, host, roles=frozenset({"play", "stop"}))
    assert failure(osc.ask(m.ArmDisplay(display=NAME))).code == "unauthorized"
    assert failure(osc.ask(m.ClearEstop(display=NAME, estop=1))).code == "unauthorized"
    program.ask(m.ArmDisplay(display=NAME))
    assert osc.ask(m.DisarmDisplay(display=NAME)) == [m.Done()]
    program.until(lambda stats: stats.state == "disarmed")
    osc.ask(m.EStop())
    program.ask(m.ClearEstop(display=NAME, estop=program.stats().estop))
    osc.close()


PICTURE = m.DrawTexture(
    texture="wood-oak", left_mm=-10.0, bottom_mm=20.0, pixel_mm=0.5, columns=30, rows=20
)
"""Request for a picture that is wider than high, far from the origin."""


def test_a_picture_is_that_of_the_surface(program: Program) -> None:
    (picture,) = program.ask(PICTURE)
    assert isinstance(picture, m.TexturePicture)
    texture, section = load_texture("wood-oak"), SurfaceSection(-0.01, 0.02, 0.5e-3, 30, 20)
    drawn = draw_surface(texture, section)
    assert picture.pixels == drawn.pixels.tobytes()
    assert picture.lowest_um == pytest.approx(drawn.lowest * 1e6)
    assert picture.highest_um == pytest.approx(drawn.highest * 1e6)
    (other,) = program.ask(structs.replace(PICTURE, seed=1))
    assert isinstance(other, m.TexturePicture)
    assert other.pixels != picture.pixels


def test_what_cannot_be_drawn_is_one_line(program: Program) -> None:
    unknown = failure(program.ask(structs.replace(PICTURE, texture="wood-oka")))
    assert unknown.code == "unknown_texture"
    assert "wood-oak" in unknown.message
    large = failure(program.ask(structs.replace(PICTURE, columns=513, rows=512)))
    assert (large.code, large.field) == ("invalid_field", "columns")
    assert "262144" in large.message


PERMISSIONS: dict[Any, set[str]] = {
    m.ListTextures(): set(),
    PICTURE: set(),
    m.Ping(time_us=0): set(),
    m.EStop(): set(),
    m.Subscribe(display=NAME, rate_hz=0.0): set(),
    m.GetStats(display=NAME): set(),
    m.Contact(display=NAME, position_mm=(0.0, 0.0), normal_force_n=0.0): {"play"},
    m.Select(display=NAME, layers=()): {"play"},
    m.Resume(display=NAME): {"play"},
    m.StopPlaying(display=NAME): {"play"},
    m.SetGain(display=NAME, gain=1.0): {"play"},
    m.Append(display=NAME, sample_rate_hz=1000.0, amplitude_um=1.0, samples=(0.0,)): {"play"},
    m.TactileFrames(display=NAME, frame_rate_hz=1e3, amplitude_um=1.0, frames=()): {"play"},
    m.PlayEffect(display=NAME, amplitude_um=1.0): {"play"},
    m.ListEffects(): set(),
    m.PlayNamedEffect(display=NAME, effect="tap"): {"play"},
    m.DisarmDisplay(display=NAME): {"arm", "stop"},
    m.ArmDisplay(display=NAME): {"arm"},
    m.ClearEstop(display=NAME, estop=1): {"arm"},
}
"""Roles of which one allows a command; none if every client may give it."""


def test_each_command_needs_its_role(runner: Loop, host: Host, program: Program) -> None:
    """There is no command that needs none because nobody thought of it."""
    said = {type(command) for command in PERMISSIONS} | {m.ClientHello}
    assert said == set(get_args(m.Command))
    for role in (None, *get_args(m.Role)):
        client = Program(runner, host, roles=frozenset({role} - {None}))
        for command, roles in PERMISSIONS.items():
            (answer,) = client.ask(command)
            refused = isinstance(answer, m.Failure) and answer.code == "unauthorized"
            assert refused == bool(roles and role not in roles), (role, command)
        client.close()
    program.ask(m.ClearEstop(display=NAME, estop=program.stats().estop))


def test_the_finger_is_who_touches_first_until_it_lifts_or_is_silent(
    runner: Loop, host: Host, program: Program
) -> None:
    other = Program(runner, host)
    now, silence = time.monotonic(), 0.1  # s, as docs/guide/server.md says
    program.touch(arrival=now)
    other.touch(arrival=now + 0.9 * silence)
    assert (program.stats().owner, other.stats().owner) == (True, False)
    program.touch(0.0, arrival=now + silence)
    other.touch(arrival=now + silence)
    assert (program.stats().owner, other.stats().owner) == (False, True)
    program.touch(arrival=now + 1.9 * silence)
    assert (program.stats().owner, other.stats().owner) == (False, True)
    program.touch(arrival=now + 2.1 * silence)
    assert (program.stats().owner, other.stats().owner) == (True, False)
    program.close()
    other.touch()
    assert other.stats().owner
    other.close()


def test_a_display_is_disarmed_when_the_last_client_that_armed_it_has_gone(
    runner: Loop, host: Host, program: Program
) -> None:
    first, second = Program(runner, host), Program(runner, host)
    program.close()
    watching = Program(runner, host, roles=frozenset({"play", "stop"}))
    first.ask(m.ArmDisplay(display=NAME))
    second.ask(m.ArmDisplay(display=NAME))
    first.close()
    assert host.playing[NAME].owners.clients == {second.client.number}
    second.close()
    watching.until(lambda stats: stats.state == "disarmed")
    watching.close()


def test_limits_may_only_be_lowered(host: Host) -> None:
    (display,) = host.displays
    assert display.voltage_limit_v == 60.0
    higher = DisplayConfig(name=NAME, device="sim:", voltage_limit_v=101.0)

    async def opened() -> None:
        await Host(Configuration(display=(higher,))).start()

    with pytest.raises(InputError, match="voltage_limit_v = 101 is above"):
        asyncio.run(opened())


def test_a_device_that_cannot_be_opened_is_one_line_and_nothing_stays_open() -> None:
    bad = DisplayConfig(name=NAME, device="serial:///dev/nothing")
    good = DisplayConfig(name="left", device="sim:")

    async def opened() -> None:
        host = Host(Configuration(display=(good, bad)))
        with pytest.raises(BusError, match="no such port") as caught:
            await host.start()
        assert "\n" not in str(caught.value)
        assert children() <= before

    before = children()
    asyncio.run(opened())


def test_telemetry_comes_as_often_as_asked_and_a_full_outbox_drops_the_oldest(
    runner: Loop, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time between passes at once, and is noted."""
    between: list[float] = []

    async def sleep(seconds: float) -> None:
        between.append(seconds)
        await asyncio.sleep(0)

    timeless = SimpleNamespace(sleep=sleep, create_task=asyncio.create_task)
    monkeypatch.setattr(client_module, "asyncio", timeless)
    program.ask(m.Subscribe(display=NAME, rate_hz=100.0))
    outbox = 64  # messages: 0.6 s of telemetry at 100 Hz, for a client that does not read
    program.until(lambda _: len(between) > outbox)
    assert set(between) == {0.01}
    assert runner.call(program.client.outbox.qsize) == outbox
    runner.call(lambda: program.client.post(m.EventMessage(display=NAME, kind="fault")))
    program.ask(m.Subscribe(display=NAME, rate_hz=0.0))
    found = [program.client.outbox.get_nowait() for _ in range(outbox)]
    assert any(isinstance(one, m.EventMessage) and one.kind == "fault" for one in found)
    told = next(one for one in found if isinstance(one, m.TelemetryMessage))
    assert told.shear_um is not None
    assert len(told.shear_um) == len(told.drive_v) == 24


def telemetry(program: Program) -> list[m.TelemetryMessage]:
    """Return the telemetry that has come to a program."""
    outbox = program.client.outbox
    came = program.runner.call(lambda: [outbox.get_nowait() for _ in range(outbox.qsize())])
    return [message for message in came if isinstance(message, m.TelemetryMessage)]


def traces(program: Program) -> list[m.TelemetryTrace]:
    """Return the traces of commanded shear that have come to a program."""
    return [message.trace for message in telemetry(program) if message.trace is not None]


def test_the_shear_of_one_contactor_comes_sample_by_sample(program: Program) -> None:
    """Play a sinusoid of 160 Hz and 5 µm, which also is what the simulated skin does.

    Nothing comes before the display is armed.
    """
    program.ask(m.Subscribe(display=NAME, rate_hz=100.0, contactor=7))
    program.until(lambda _: program.client.outbox.qsize() > 3)
    assert {trace.shear_um for trace in traces(program)} == {b""}
    program.ask(m.ArmDisplay(display=NAME))
    program.until(lambda stats: stats.state == "armed")
    program.ask(m.PlayNamedEffect(display=NAME, effect="hum"))
    came: list[m.TelemetryMessage] = []

    def played(_: m.StatsReply) -> bool:
        program.touch()
        came.extend(telemetry(program))
        return sum(len(one.trace.shear_um) // 4 for one in came if one.trace is not None) > 4000

    program.until(played)
    for found in ([one.trace for one in came], [one.played for one in came]):
        sent = [trace for trace in found if trace is not None]
        assert {(trace.contactor, trace.sample_rate_hz) for trace in sent} == {(7, 8000.0)}
        shear = np.concatenate([np.frombuffer(trace.shear_um, "<f4") for trace in sent])
        strongest = max(
            range(0, len(shear) - 400, 50), key=lambda k: float(np.std(shear[k : k + 400]))
        )
        wave = shear[strongest : strongest + 400]
        assert np.std(wave) * np.sqrt(2) == pytest.approx(5.0, rel=0.02)
        assert np.argmax(np.abs(np.fft.rfft(wave))) == 160 * 400 // 8000
    program.ask(m.Subscribe(display=NAME, rate_hz=0.0))


def test_another_rate_of_telemetry_makes_no_gap_in_a_trace(host: Host, program: Program) -> None:
    """Add samples while the display is disarmed, so that nothing else adds any."""
    memory = host.playing[NAME].memory
    disarm(program)
    program.ask(m.Subscribe(display=NAME, rate_hz=100.0, contactor=7))
    program.until(lambda _: program.client.outbox.qsize() > 1)
    traces(program)
    program.runner.call(lambda: memory.commanded.add(np.full((100, 24), 1e-6)))
    program.ask(m.Subscribe(display=NAME, rate_hz=50.0, contactor=7))
    program.until(lambda _: program.client.outbox.qsize() > 1)
    assert sum(len(trace.shear_um) // 4 for trace in traces(program)) == 100
    program.ask(m.Subscribe(display=NAME, rate_hz=0.0))


def test_a_contactor_that_is_none_is_refused_and_the_telemetry_goes_on(program: Program) -> None:
    program.ask(m.Subscribe(display=NAME, rate_hz=100.0))
    told = failure(program.ask(m.Subscribe(display=NAME, rate_hz=50.0, contactor=24)))
    assert (told.code, told.field) == ("invalid_field", "contactor")
    assert told.message == "contactor 24 is not below 24"
    traces(program)
    program.until(lambda _: program.client.outbox.qsize() > 3)
    assert traces(program) == []
    program.ask(m.Subscribe(display=NAME, rate_hz=0.0))


def test_what_is_not_known_is_null_and_not_0(
    host: Host, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was due yet, and frames have no commanded shear."""
    playing = host.playing[NAME]
    with monkeypatch.context() as patch:
        patch.setattr(playing, "memory", PlaybackMemory.create(24))  # no report has come
        assert telemetry_module.snapshot(playing).shear_um == (0.0,) * 24
        assert program.stats().lead_ms == 0.0  # of a simulated display
        patch.setattr(playing, "how", replace(playing.how, ahead=0.0125))
        assert program.stats().lead_ms == 12.5
        patch.setattr(playing, "how", DeviceOpened(why_not="unplugged"))
        assert program.stats().lead_ms is None
        patch.setattr(playing, "how", replace(playing.how, carriers=8))
        assert telemetry_module.snapshot(playing).shear_um is None
        assert telemetry_module.snapshot(playing).put_out_share is None
        assert program.stats().put_out_share is None
        playing.memory.close()
    program.ask(m.ArmDisplay(display=NAME))
    share = program.until(lambda stats: (stats.put_out_share or 0.0) > 0).put_out_share
    assert share is not None
    assert share <= 1


def test_reloading_makes_what_is_selected_anew_and_lets_go_of_the_old(
    runner: Loop, host: Host, program: Program
) -> None:
    program.ask(OAK, m.Select(display=NAME, layers=(m.Layer(texture="leather-calf"),)))
    program.ask(OAK)
    playing = host.playing[NAME]
    (state,) = playing.states.values()
    before = state.layers
    runner.run(host.reload())
    assert host.playing[NAME] is playing
    assert state.layers != before, "made anew"
    assert list(playing._texture_store.ready) == [("wood-oak", 0)], "what nobody selects is let go"
    told = [program.client.outbox.get_nowait() for _ in range(program.client.outbox.qsize())]
    assert "textures" in {one.kind for one in told if isinstance(one, m.EventMessage)}
    program.ask(m.ArmDisplay(display=NAME))
    begun, drives = time.monotonic(), set[bytes]()

    def plays(_: m.StatsReply) -> bool:
        program.touch(x=80 * (time.monotonic() - begun))
        drives.add(playing.memory.drive.tobytes())
        return len(drives) > 5

    program.until(plays)
    assert host.healthy()
    assert host.figures()[NAME]["playback_alive"] == 1.0
