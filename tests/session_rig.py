"""Rig of sessions: a server in model time that is recorded while two clients play everything."""

import asyncio
import math
from dataclasses import dataclass
from pathlib import Path

from virtual_server import World, small_display, virtual_world

from tactile import messages as m
from tactile.server.client import Client
from tactile.server.config import Configuration, DisplayConfig, RecordConfig

NAME = "left"
SERIAL = "mock:?link=serial&bit_rate=3000000&format=pcm16&disconnect_s=2"
"""Amplifier whose link is lost every 2 s."""
SPECTRUM = "mock:?link=can&format=spectrum"


@dataclass
class Story:
    """Server with one display that is recorded, and two clients of it."""

    world: World
    folder: Path

    def start(self, device: str, rate: float | None) -> tuple[Client, Client]:
        display = DisplayConfig(
            name=NAME, display=small_display(self.folder), device=device, sample_rate_hz=rate,
            gain=0.9, voltage_limit_v=50.0,
        )  # fmt: skip
        record = RecordConfig(folder=str(self.folder / "sessions"))
        assert self.world.start(Configuration(display=(display,), record=record))
        assert self.world.host is not None
        self.pause(0.2)
        return (
            self.world.host.connect("one", roles=m.ALL_ROLES),
            self.world.host.connect("two", roles=m.ALL_ROLES),
        )

    @property
    def sessions(self) -> list[Path]:
        return sorted((self.folder / "sessions").iterdir())

    def pause(self, seconds: float) -> None:
        self.world.run(asyncio.sleep(seconds))

    def ask(self, client: Client, command: m.Command) -> m.Answer:
        return self.world.run(client.request(command))

    def slide(self, client: Client, seconds: float, *, velocity: bool = False) -> None:
        """Slide a finger back and forth, 250 contacts a second, and lift it."""
        for k in range(round(250 * seconds)):
            t = k / 250
            pair = (60 * math.cos(t), -20 * math.sin(t)) if velocity else None
            place = 60 * math.sin(t), 20 * math.cos(t)
            self._touch(client, place, 0.5 + 0.2 * math.sin(9 * t), pair)
            self.pause(1 / 250)
        self._touch(client, (0.0, 0.0), 0.0, None)

    def _touch(
        self,
        client: Client,
        place: tuple[float, float],
        force: float,
        velocity: tuple[float, float] | None,
    ) -> None:
        contact = m.Contact(
            display=NAME, position_mm=place, normal_force_n=force, velocity_mm_s=velocity
        )
        client.stream(contact, self.world.clock.now())

    def play_everything(self, one: Client, two: Client) -> None:
        """Play textures, waveforms and effects, with an e-stop and two fingers."""
        wave = tuple(math.sin(k / 3) for k in range(1000))
        self.ask(one, m.Select(display=NAME, layers=(m.Layer(texture="wood-oak"),)))
        assert isinstance(self.ask(one, m.ArmDisplay(display=NAME)), m.Done)
        self.slide(one, 0.4)
        self.ask(one, m.SetGain(display=NAME, gain=0.4))
        layers = m.Layer(texture="leather-calf", gain=0.5), m.Layer(texture="wood-oak", seed=3)
        self.ask(two, m.Select(display=NAME, layers=layers))
        self.ask(one, m.Append(display=NAME, sample_rate_hz=5000, amplitude_um=3, samples=wave))
        self.slide(two, 0.4, velocity=True)
        self.ask(one, m.TactileFrames(
            display=NAME, frame_rate_hz=1000, amplitude_um=2, frames=wave[:960],
        ))  # fmt: skip
        self.ask(one, m.TactileFrames(
            display=NAME, frame_rate_hz=2000, amplitude_um=2, frames=wave[:960],
            time_us=round(1e6 * (self.world.clock.now() + 0.05)),
        ))  # fmt: skip
        soon = m.BeginAt(at_us=round(1e6 * (self.world.clock.now() + 0.1)))
        appended = self.ask(one, m.Append(
            display=NAME, sample_rate_hz=1000, amplitude_um=1, samples=wave[:100],
            contactors=(1,), begin=soon,
        ))  # fmt: skip
        assert isinstance(appended, m.AppendedReply)
        points = m.Point(time_ms=0.0, value=1.0), m.Point(time_ms=500.0, value=0.2)
        self.ask(two, m.PlayEffect(display=NAME, amplitude_um=2, amplitude=points))
        self.slide(one, 0.2)
        estop = self.ask(one, m.EStop())
        self.slide(one, 0.1)
        assert isinstance(estop, m.Done)
        number = estop.estops[NAME]
        assert isinstance(self.ask(one, m.ClearEstop(display=NAME, estop=number)), m.Done)
        assert isinstance(self.ask(two, m.ArmDisplay(display=NAME)), m.Done)
        self.slide(two, 0.3)
        self.ask(one, m.Append(
            display=NAME, sample_rate_hz=8000, amplitude_um=1, samples=wave, contactors=(1,),
        ))  # fmt: skip
        self.ask(one, m.StopPlaying(display=NAME))
        self.world.run(self._drop(one))
        self.slide(two, 0.3)

    async def _drop(self, client: Client) -> None:
        assert self.world.host is not None
        self.world.host.drop(client)


def recorded_session(folder: Path) -> Path:
    """Record a session on a serial link; return its folder."""
    with virtual_world(lambda playback, volts: None) as world:
        story = Story(world, folder)
        story.play_everything(*story.start(SERIAL, 8000.0))
        world.stop()
        (session,) = story.sessions
    return session
