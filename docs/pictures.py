"""Draw the pictures of README.md: ``python docs/pictures.py``."""

from pathlib import Path

import numpy as np

import tactile
from tactile.show.plots import plot_played, plot_response
from tactile.texture.surface import without_friction

HERE = Path(__file__).parent
FINGERS = {
    "low": tactile.FingerLoad.low(),
    "high": tactile.FingerLoad.high(),
    "none": tactile.FingerLoad.none(),
}

display = tactile.load_display("reference-24")
played = tactile.render(
    display,
    without_friction(tactile.load_texture("wood-oak")),
    tactile.Trajectory.line(speed=0.08, duration=1.0),
)
plant = tactile.Plant(display.bimorph, display.load_at(0.5), played.sample_rate, contactors=24)
rest = np.zeros((plant.delay, 24))
shear, _ = plant.step(np.concatenate([played.drive, rest]))
plot_played(
    HERE / "played.png",
    display=display,
    time=played.time,
    position=played.position,
    shear_target=played.shear,
    shear_played=shear[plant.delay :],
    drive=played.drive,
    title="wood-oak on reference-24: 80 mm/s, 0.5 N, friction left out",
)
frequency = np.geomspace(1, 2000, 2000)
plot_response(
    HERE / "response.png",
    {
        name: tactile.tip_response(display.bimorph, finger, frequency)
        for name, finger in FINGERS.items()
    },
    voltage=display.limits.voltage,
)
