"""Draw what an amplifier does when something is lost: ``python docs/protocol_picture.py``."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.host import AmplifierHost, codes_of, pcm
from firmware_protocol.messages import FULL_SCALE_CODE, State

HERE = Path(__file__).parent
RATE, BLOCK, LEAD = 8000, 32, 64
SESSION = 0x1234
BLUE, RED, GRAY = "#0072B2", "#D55E00", "#666666"


class Scene:
    """A host that streams a sine of 60 V to one amplifier, as far as it is told to."""

    def __init__(self) -> None:
        self.amplifier = ReferenceAmplifier(AmplifierConfig(channels=1))
        self.host = AmplifierHost(SESSION, 1)
        self.now = 0
        for message in (
            m.Hello(SESSION, m.MAJOR, m.MINOR, m.SCHEMA_CRC),
            m.Arm(SESSION, m.Mode.PCM, RATE),
            m.Start(SESSION, 0, time=1),
        ):
            self.amplifier.receive(self.host.ask(message), 0)

    def stream(
        self, until_ms: float, *, send: bool = True, beat: bool = True, lost: int = -1
    ) -> None:
        """Go on to a time, block by block; the block ``lost`` never arrives."""
        while self.now < until_ms * 1000:
            position = self.now * RATE // 1_000_000
            start = position + (LEAD if position else 0)
            n = start + np.arange(BLOCK + (0 if position else LEAD))
            volts = 60 * np.sin(2 * np.pi * 60 * n / RATE)[:, None]
            if send and position // BLOCK != lost:
                for message in pcm(
                    start,
                    codes_of(volts, 100.0),
                    session=SESSION,
                    sample_format=0,
                    packet_limit=4096,
                ):
                    self.amplifier.receive(self.host.tell(message), self.now)
            if beat:
                self.amplifier.receive(self.host.tell(m.Heartbeat(SESSION)), self.now)
            self.now += BLOCK * 1_000_000 // RATE
            self.amplifier.run(self.now)

    def traces(self) -> tuple[np.ndarray, np.ndarray, float | None]:
        """Return time [ms], volts, and when high voltage went off."""
        runs = self.amplifier.take_played()
        time = np.concatenate([run.ticks for run in runs]) / 1000
        codes = np.concatenate([run.codes[:, 0] for run in runs])
        off = next((run.ticks[-1] / 1000 for run in runs if run.state == State.SAFE), None)
        return time, codes * (100 / FULL_SCALE_CODE), off


def scenes() -> dict[str, tuple[Scene, float, float]]:
    """Return each scene with the time that it is about and the time that is shown [ms]."""
    lost, late, dead, stop = Scene(), Scene(), Scene(), Scene()
    lost.stream(100, lost=12)
    late.stream(60)
    late.stream(100, send=False)
    late.stream(220)
    dead.stream(60)
    dead.stream(300, send=False, beat=False)
    stop.stream(60)
    stop.amplifier.receive(stop.host.tell(m.Estop(1)), stop.now)
    stop.amplifier.run(stop.now + 5000)
    return {
        "A packet of 4 ms is lost:\na straight line bridges it": (lost, 56, 100),
        "The host is 40 ms late:\nfade out, fade in, at the same position": (late, 60, 220),
        "The host dies: fade out, and 150 ms after\nits last heartbeat high voltage off": (
            dead,
            60,
            300,
        ),
        "ESTOP: to 0 V at the slew limit,\nlatched until someone clears it": (stop, 60, 63),
    }


def draw() -> None:
    """Save the picture beside this file."""
    figure, axes = plt.subplots(1, 4, figsize=(14, 3.2), sharey=True)
    for place, (title, (scene, about, end)) in zip(axes, scenes().items(), strict=True):
        time, volts, off = scene.traces()
        shown = (time > about - (end - about)) & (time > 20) & (time < end)
        place.plot(time[shown], volts[shown], color=BLUE, lw=1.4)
        place.axvline(about, color=RED, lw=0.9, ls="--")
        if off is not None:
            place.axvline(off, color=GRAY, lw=0.9, ls=":")
            place.text(off + 3, 48, "high voltage\noff: SAFE", color=GRAY, fontsize=8)
        place.set_title(title, fontsize=9, loc="left")
        place.set_xlabel("ms", fontsize=8)
        place.tick_params(labelsize=8)
        place.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("output, V", fontsize=8)
    figure.tight_layout()
    figure.savefig(HERE / "protocol.png", dpi=110)


if __name__ == "__main__":
    draw()
