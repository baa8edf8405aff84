"""Draw what becomes of a stroke whose cable is pulled: ``python docs/links_picture.py``.

Friction is left out: its steady drive would hide what the texture does.
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

from tactile.arrays import Floats

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FULL_SCALE_CODE
from tactile.bus.base import DriveBlock
from tactile.bus.registry import open_bus
from tactile.bus.simulated.modeled_bus import Heard, ModeledBus
from tactile.devices import KINDS
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import load_texture, without_friction

HERE = Path(__file__).parent
URL = "mock:?link=serial&bit_rate=3000000&rearm=true"
BLOCK, SECONDS, PULLED, AWAY = 16, 1.6, 0.5, 0.25
BLUE, RED, GRAY = "#0072B2", "#D55E00", "#666666"

runs: list[PlayedRun] = []


def listening(self: Heard, run: PlayedRun, begun: int, end: int | None) -> None:
    """Remember what is put out, with its ticks."""
    runs.append(run)


def played() -> tuple[Floats, int, int]:
    """Play while the cable is pulled and put back.

    Returns
    -------
    (S,) float64 ndarray  Drive of contactor 0 as rendered [V]
    int  The amplifier's tick [µs] at which the stroke begins
    int  Samples that were dropped
    """
    display = load_display("reference-24")
    renderer = Renderer(display, without_friction(load_texture("wood-oak")))
    renderer.fade_in()
    sent = []
    with open_bus(URL, display) as bus:
        assert isinstance(bus, ModeledBus)
        bus.start()
        begun = bus.peers[0].begun
        pulled = False
        for k, (place, force) in enumerate(
            Trajectory.line(speed=0.08, duration=SECONDS).blocks(8000, BLOCK)
        ):
            if k * BLOCK >= PULLED * 8000 and not pulled:
                pulled = True
                bus.model.unplug(AWAY)
            drive = display.to_channels(renderer.block(place, force))
            sent.append(drive[:, 0])
            bus.write(DriveBlock(k * BLOCK, drive))
        bus.stop()
        return np.concatenate(sent), begun, bus.counters.dropped_samples


def label(axes: Sequence[Axes], dropped: int) -> None:
    """Say what is seen."""
    axes[0].axvspan(PULLED * 1e3, (PULLED + AWAY) * 1e3, color=RED, alpha=0.12, lw=0)
    axes[0].text((PULLED + AWAY / 2) * 1e3, 9.4, "cable out", ha="center", va="center", color=RED)
    axes[0].legend(loc="upper right", ncols=2, frameon=False)
    axes[0].set_title(
        f"Oak over a UART of 3 Mbit/s whose cable is pulled for {AWAY * 1e3:.0f} ms: the amplifier "
        "fades by itself,\nthe host connects again, "
        f"{dropped / 8000 * 1e3:.0f} ms of samples are dropped and counted",
        fontsize=10, loc="left",
    )  # fmt: skip
    axes[1].set_title("It fades in at the position that the finger has reached", fontsize=10,
                      loc="left")  # fmt: skip
    axes[1].set_xlabel("time since the start of the stroke [ms]")


def main() -> None:
    """Play, pull the cable, put it back, and draw."""
    assert KINDS
    Heard.add = listening  # type: ignore[method-assign]
    wanted, begun, dropped = played()
    ticks = np.concatenate([run.ticks for run in runs])
    volts = np.concatenate([run.codes[:, 0] for run in runs]) * (100 / FULL_SCALE_CODE)
    time = (ticks - begun) * 1e-6
    figure, axes = plt.subplots(2, 1, figsize=(10, 5.2), layout="constrained")
    back = time[(time > PULLED + AWAY) & (volts != 0)].min()
    spans = ((0.3, 1.4), (back - 0.012, back + 0.048))
    for axis, (low, high) in zip(axes, spans, strict=True):
        at = np.arange(len(wanted)) / 8000
        axis.plot(at * 1e3, wanted, color=GRAY, lw=0.8, label="rendered")
        axis.plot(time * 1e3, volts, color=BLUE, lw=1.2, label="put out")
        axis.set_xlim(low * 1e3, high * 1e3)
        axis.set_ylabel("drive of contactor 0 [V]")
        axis.set_ylim(-11, 11)
    label(axes, dropped)
    figure.savefig(HERE / "links.png", dpi=110)


if __name__ == "__main__":
    main()
