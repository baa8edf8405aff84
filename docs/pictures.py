"""Draw the pictures of the documentation, all of them or those that are named.

    python docs/pictures.py
    python docs/pictures.py played links

Each function of `PICTURES` writes the file of its name beside this one. It needs the extras plot,
picture and study, and for "web-page" Playwright and Chromium. Friction is left out of strokes whose
drive is drawn: its steady part would hide what the texture does.
"""

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from PIL import Image

import tactile
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.host import AmplifierHost, codes_of, pcm
from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import FULL_SCALE_CODE, State
from tactile.arrays import Floats
from tactile.bus.simulated.modeled_bus import AmplifierRecord, ModeledBus
from tactile.show.plots import Played, played_figure, save
from tactile.study.paper import FINGERS, over_length
from tactile.study.plots import length_map_figure
from tactile.study.sweep import solve_study
from tactile.texture.surface import without_friction
from tactile.tracking.clock_map import ClockMap
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

HERE = Path(__file__).parent
BLUE, RED, GRAY = "#0072B2", "#D55E00", "#666666"
RATE, BLOCK = 8000, 16


def command(*words: str) -> None:
    """Run a command of tactile."""
    subprocess.run([sys.executable, "-m", "tactile", *words], check=True)


# What commands draw


def response(path: Path) -> None:
    """Draw the response of the default bimorph under two fingers and in air."""
    command("response", "--plot", str(path))


def wood_oak(path: Path) -> None:
    """Draw oak."""
    command("show", "wood-oak", "--plot", str(path))


def textures(path: Path) -> None:
    """Draw all textures, at two thirds of the size, which is a third of the bytes."""
    command("sheet", str(path))
    with Image.open(path) as picture:
        smaller = picture.convert("RGB").resize(
            (picture.width * 2 // 3, picture.height * 2 // 3), Image.Resampling.LANCZOS
        )
    smaller.save(path, optimize=True)


def pareto(path: Path) -> None:
    """Draw the benders that no other beats in shear and footprint."""
    command(
        "optimize", "length_mm=8:40", "width_mm=1:6", "--objective", "attainable",
        "--objective", "footprint", "--plot", str(path),
    )  # fmt: skip


# Others


def played(path: Path) -> None:
    """Draw a stroke over oak on the simulated display."""
    display = tactile.load_display("reference-24")
    stroke = tactile.Trajectory.line(speed=0.08, duration=1.0)
    oak = without_friction(tactile.load_texture("wood-oak"))
    made = tactile.render(display, oak, stroke)
    plant = tactile.Plant(display.bimorph, display.load_at(0.5), made.sample_rate, contactors=24)
    rest = np.zeros((plant.delay, 24))
    shear, _ = plant.step(np.concatenate([made.drive, rest]))
    play = Played(display, made.time, made.shear, shear[plant.delay :], made.drive, made.position)
    title = "wood-oak on reference-24: 80 mm/s, 0.5 N, friction left out"
    save(played_figure(play, title=title), path)


def length_study(path: Path) -> None:
    """Draw how far benders of 5 to 45 mm shear the skin; 2 Hz apart, so that no notch is missed."""
    study = replace(over_length(*FINGERS), frequency=np.arange(0.0, 1001.0, 2.0))
    save(length_map_figure(solve_study(study)), path)


# A cable is pulled


CABLE = "mock:?link=serial&bit_rate=3000000&rearm=true"
SECONDS, PULLED, AWAY = 1.6, 0.5, 0.25


def links(path: Path) -> None:
    """Draw what becomes of a stroke whose cable is pulled."""
    runs: list[PlayedRun] = []

    def listening(self: AmplifierRecord, run: PlayedRun, begun: int, end: int | None) -> None:
        runs.append(run)

    AmplifierRecord.add_run = listening  # type: ignore[method-assign]
    wanted, begun, dropped = with_pulled_cable()
    volts = np.concatenate([run.codes[:, 0] for run in runs]) * (100 / FULL_SCALE_CODE)
    time = (np.concatenate([run.ticks for run in runs]) - begun) * 1e-6
    back = time[(time > PULLED + AWAY) & (volts != 0)].min()
    figure, (whole, close) = plt.subplots(2, 1, figsize=(10, 5.2), layout="constrained")
    for axes, low, high in ((whole, 0.3, 1.4), (close, back - 0.012, back + 0.048)):
        at = 1e3 * np.arange(len(wanted)) / RATE
        axes.plot(at, wanted, color=GRAY, lw=0.8, label="rendered")
        axes.plot(time * 1e3, volts, color=BLUE, lw=1.2, label="put out")
        axes.set(xlim=(low * 1e3, high * 1e3), ylim=(-11, 11), ylabel="drive of contactor 0 [V]")
    whole.axvspan(PULLED * 1e3, (PULLED + AWAY) * 1e3, color=RED, alpha=0.12, lw=0)
    whole.text((PULLED + AWAY / 2) * 1e3, 9.4, "cable out", ha="center", va="center", color=RED)
    whole.legend(loc="upper right", ncols=2, frameon=False)
    lost = f"{dropped / RATE * 1e3:.0f} ms of samples are dropped and counted"
    whole.set_title(
        f"Oak over a UART of 3 Mbit/s whose cable is pulled for {AWAY * 1e3:.0f} ms: the amplifier "
        f"fades by itself,\nthe host connects again, {lost}",
        fontsize=10, loc="left",
    )  # fmt: skip
    place = "It fades in at the position that the finger has reached"
    close.set_title(place, fontsize=10, loc="left")
    close.set_xlabel("time since the start of the stroke [ms]")
    figure.savefig(path, dpi=110)


def with_pulled_cable() -> tuple[Floats, int, int]:
    """Play while the cable is pulled and put back.

    Returns
    -------
    ndarray
        (S,) drive of contactor 0 as rendered [V].
    int
        The amplifier's tick [µs] at which the stroke begins.
    int
        Samples that were dropped.
    """
    display = tactile.load_display("reference-24")
    renderer = tactile.Renderer(display, without_friction(tactile.load_texture("wood-oak")))
    renderer.fade_in()
    stroke = tactile.Trajectory.line(speed=0.08, duration=SECONDS)
    sent = []
    with tactile.open_bus(CABLE, display) as bus:
        assert isinstance(bus, ModeledBus)
        bus.start()
        begun = bus.peers[0].begun
        for k, (place, force) in enumerate(stroke.blocks(RATE, BLOCK)):
            if k == round(PULLED * RATE / BLOCK):
                bus.model.unplug(AWAY)
            drive = display.to_channels(renderer.block(place, force))
            sent.append(drive[:, 0])
            bus.write(tactile.DriveBlock(k * BLOCK, drive))
        bus.stop()
        return np.concatenate(sent), begun, bus.counters.dropped_samples


# What an amplifier does when something is lost


PACKET, LEAD, SESSION = 32, 64, 0x1234


class LinkScene:
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
            self.amplifier.receive(self.host.request(message), 0)

    def stream(
        self, until_ms: float, *, send: bool = True, beat: bool = True, lost: int = -1
    ) -> None:
        """Go on to a time, packet by packet; the packet ``lost`` never arrives."""
        while self.now < until_ms * 1000:
            position = self.now * RATE // 1_000_000
            if send and position // PACKET != lost:
                self.send(position + (LEAD if position else 0), PACKET + (0 if position else LEAD))
            if beat:
                self.amplifier.receive(self.host.packet(m.Heartbeat(SESSION)), self.now)
            self.now += PACKET * 1_000_000 // RATE
            self.amplifier.run(self.now)

    def send(self, start: int, count: int) -> None:
        """Send some samples of the sine."""
        volts = 60 * np.sin(2 * np.pi * 60 * (start + np.arange(count)) / RATE)[:, None]
        codes = codes_of(volts, 100.0)
        for message in pcm(start, codes, session=SESSION, sample_format=0, packet_limit=4096):
            self.amplifier.receive(self.host.packet(message), self.now)

    def traces(self) -> tuple[Floats, Floats, float | None]:
        """Return time [ms], volts, and when high voltage went off."""
        runs = self.amplifier.take_played()
        time = np.concatenate([run.ticks for run in runs]) / 1000
        codes = np.concatenate([run.codes[:, 0] for run in runs])
        off = next((run.ticks[-1] / 1000 for run in runs if run.state == State.SAFE), None)
        return time, codes * (100 / FULL_SCALE_CODE), off


def scenes() -> dict[str, tuple[LinkScene, float, float]]:
    """Return each scene with the time that it is about and the last that is shown [ms]."""
    lost, late, dead, stop = LinkScene(), LinkScene(), LinkScene(), LinkScene()
    lost.stream(100, lost=12)
    late.stream(60)
    late.stream(100, send=False)
    late.stream(220)
    dead.stream(60)
    dead.stream(300, send=False, beat=False)
    stop.stream(60)
    stop.amplifier.receive(stop.host.packet(m.Estop(1)), stop.now)
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


def protocol(path: Path) -> None:
    """Draw what an amplifier does when something is lost."""
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
    figure.savefig(path, dpi=110)


# How a swinging finger is followed


LATENCY = 12e-3
SWING, SAMPLES, JITTER, NOISE = 0.2 / (2 * np.pi), 90.0, 5e-3, 5e-5
BEGIN, END = 2.0, 2.8


def swinging(time: Floats) -> Floats:
    """Return where the finger is [m]: 1 Hz, 200 mm/s at most."""
    return np.asarray(SWING * np.sin(2 * np.pi * time))


def followed(taken: Floats, came: Floats, told: Floats) -> tuple[Floats, Floats, Floats]:
    """Return times [s], places that are rendered and the newest samples then [m], (S,) each."""
    clock, tracker, waiting = ClockMap(), ContactTracker(), list(np.argsort(came))
    times, places, plain = [], [], []
    newest = 0.0
    for now in np.arange(0.05, END - LATENCY, BLOCK / RATE):
        while waiting and came[waiting[0]] <= now:
            k = waiting.pop(0)
            arrival, newest = float(came[k]), float(told[k])
            when = clock(float(taken[k]) - 1000.0, arrival)  # its clock is another
            tracker.add(FingerSample(when, arrival, newest, 0.0, 0.5))
        put_out = now + LATENCY + np.arange(BLOCK) / RATE
        times.append(put_out)
        places.append(tracker.at(put_out, float(now))[0][:, 0])
        plain.append(np.full(BLOCK, newest))
    return np.concatenate(times), np.concatenate(places), np.concatenate(plain)


def tracking(path: Path) -> None:
    """Draw how a swinging finger is followed."""
    rng = np.random.default_rng(1)
    taken = np.arange(0, END, 1 / SAMPLES)
    came = taken + np.abs(rng.normal(0, JITTER, len(taken)))
    told = swinging(taken) + rng.normal(0, NOISE, len(taken))
    time, place, last = followed(taken, came, told)
    inside = (time >= BEGIN) & (time < END - 2 * LATENCY)
    time, place, last = time[inside], place[inside], last[inside]
    shown = (came >= BEGIN) & (came < time[-1])
    above: Axes
    below: Axes
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9, 5), sharex=True, height_ratios=(3, 2), constrained_layout=True
    )
    above.plot(time, 1e3 * swinging(time), color=GRAY, lw=4, alpha=0.4, label="finger")
    above.plot(came[shown], 1e3 * told[shown], ".", color=RED, label="samples, when they come")
    above.plot(time, 1e3 * place, color=BLUE, lw=1.2, label="place each block is rendered for")
    above.set(ylabel="place in mm")
    above.set_title("1 Hz, 200 mm/s; 90 samples a second, 5 ms jitter, 0.05 mm noise; 12 ms ahead")
    below.plot(time, 1e3 * (last - swinging(time)), color=RED, lw=1, label="newest sample")
    below.plot(time, 1e3 * (place - swinging(time)), color=BLUE, lw=1.2, label="tracked")
    below.set(xlabel="time in s", ylabel="off the finger in mm")
    for axes in (above, below):
        axes.legend(loc="upper right")
    figure.savefig(path, dpi=110)


# The page of the server


def served(folder: str) -> "subprocess.Popen[str]":
    """Start a server of the simulated display at a free port."""
    config = Path(folder) / "tactile.toml"
    config.write_text(
        f'[server]\nport = 0\nsocket = "{folder}/socket"\n[osc]\nport = 0\n'
        '[[display]]\nname = "right"\ndevice = "sim:"\n'
    )
    words = [sys.executable, "-m", "tactile", "serve", "--config", str(config)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def web_page(path: Path) -> None:
    """Draw the page of the server while a mouse strokes oak."""
    from playwright.sync_api import sync_playwright

    with TemporaryDirectory() as folder, served(folder) as server, sync_playwright() as running:
        assert server.stdout is not None
        address = next(word for word in server.stdout.readline().split() if "http" in word)
        browser = running.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        window = browser.new_page(viewport={"width": 1280, "height": 800}, device_scale_factor=1.5)
        window.goto(address)
        window.locator("[data-name=wood-oak]").click()
        window.wait_for_selector("#pad-surface[data-textures=wood-oak]")
        window.wait_for_selector("[data-name=wood-pine-sanded] canvas[data-drawn]")  # the last one
        window.get_by_test_id("arm").click()
        window.get_by_test_id("arm-confirm").click()
        window.wait_for_selector("[data-state=armed]")
        box = window.get_by_test_id("pad").bounding_box()
        assert box is not None
        middle = box["y"] + box["height"] / 2
        window.mouse.move(box["x"] + 40, middle)
        window.mouse.down()
        for k in range(100):  # 2.5 CSS px in 8 ms are 80 mm/s
            window.mouse.move(box["x"] + 40 + 2.5 * k, middle + 20 * np.sin(k / 12))
            window.wait_for_timeout(8)
        window.screenshot(path=path)
        browser.close()
        server.terminate()


PICTURES: dict[str, Callable[[Path], None]] = {
    draw.__name__.replace("_", "-"): draw
    for draw in (
        played, response, textures, wood_oak, length_study, pareto, protocol, links, tracking,
        web_page,
    )
}  # fmt: skip


def main() -> None:
    """Draw what is named."""
    names = sys.argv[1:] or list(PICTURES)
    if unknown := set(names) - set(PICTURES):
        sys.exit(f"no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    for name in names:
        PICTURES[name](HERE / f"{name}.png")
        print(f"docs/{name}.png")


if __name__ == "__main__":
    main()
