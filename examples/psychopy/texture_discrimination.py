"""Measure in PsychoPy how much stronger a texture must be to feel stronger.

    pip install psychopy .               # in a checkout
    tactile serve --config lab.toml      # with folder = "sessions" in the table [record]
    python examples/psychopy/texture_discrimination.py --participant 01

In each trial the participant feels two strokes over the same texture with different gains, and says
by the keys 1 and 2 which one was stronger. QUEST+ (Watson 2017, doi 10.1167/17.3.10) chooses the
difference of the next trial. The result is the Weber fraction of the gain at which 80 % of the
answers are right. The finger stays where it is: the program moves the surface, in the same way in
all trials. `session_to_bids.py` joins the answers with what the server recorded.

`--rehearse 0.2` answers in place of a participant whose Weber fraction is 0.2.
"""

import argparse
import csv
import math
import random
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import tactile
from tactile.client import Onset, RemoteDisplay

try:
    import psychopy
    from psychopy import data, logging
except ModuleNotFoundError as missing:
    sys.exit(f"{missing}: pip install psychopy")

STANDARD = 0.3  # gain of the weaker stroke, which leaves room for stronger ones
SPEED, FORCE = 0.08, 0.5  # of the finger on the surface: m/s, N
REST, STROKE, PAUSE = 0.3, 1.0, 0.5  # s: the finger rests, moves, and is lifted between strokes
CODES = {"standard": 1, "comparison": 2}  # on the marker lines of the amplifier, if it has some
LONGEST_GAP = 0.05  # s, between two contacts; the display bridges less
ATTEMPTS = 5  # at a trial that is not played as it should be

GUESS, LAPSE = 0.5, 0.02  # shares of right answers without a sensation, and of lapses (assumed)
RIGHT = 1 - LAPSE - (1 - GUESS - LAPSE) * math.exp(-1)  # at the threshold: 80 %
LEVELS = np.arange(-30.0, 8.0)  # dB, that is 20 log10 of Weber fractions from 0.03 to 2.2
SLOPES = np.geomspace(0.6, 6.0, 8)  # exponents of the Weibull function


class StoppedError(Exception):
    """End of the experiment before its last trial."""


class Screen:
    """Window and keyboard of the participant."""

    def __init__(self, full: bool) -> None:
        from psychopy import visual  # which need a screen already here
        from psychopy.hardware import keyboard

        self._window = visual.Window((800, 600), fullscr=full, units="height", color="black")
        self._text = visual.TextStim(self._window, height=0.05)
        self._keyboard = keyboard.Keyboard()

    def draw(self, text: str) -> None:
        """Draw a text for one frame."""
        self._text.text = text
        self._text.draw()
        self._window.flip()
        if self._pressed(["escape"]):
            raise StoppedError("Escape was pressed")
        if self._window.winHandle.has_exit:
            raise StoppedError("the window was closed")

    def wait(self, seconds: float) -> None:
        """Draw nothing for some time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.draw("")

    def ask(self, text: str, keys: list[str]) -> tuple[str, float]:
        """Draw a text until a key is pressed; return the key and the time that it took [s]."""
        question = logging.defaultClock.getTime()  # as of `tDown`
        while True:
            self.draw(text)
            for key in self._pressed(keys):
                if key.tDown >= question:  # and not before the question
                    return key.name, key.tDown - question

    def _pressed(self, keys: list[str]) -> list[Any]:
        """Return keys that were pressed, those that are still held first."""
        held = self._keyboard.getKeys(keys, waitRelease=False)
        return held + self._keyboard.getKeys(keys)

    def begin(self) -> None:
        """Explain the task."""
        self.ask(
            "Put your finger on the display. You feel two strokes.\n\nWhich one was stronger?\n"
            "Press 1 or 2.\n\nSpace begins, Escape ends.",
            ["space"],
        )

    def judge(self, gains: list[float]) -> tuple[str, float]:
        """Return the number of the stroke that was stronger, and the time that it took [s]."""
        return self.ask("Which one was stronger, 1 or 2?", ["1", "2"])


class Rehearsal(Screen):
    """Screen with answers of a participant of a given Weber fraction, in place of the keyboard.

    Sensation is the logarithm of the gain; Gaussian noise is added to the difference of two. Some
    answers are guesses, half of which are the lapses.
    """

    def __init__(self, full: bool, weber: float, seed: int) -> None:
        super().__init__(full)
        attended = (RIGHT - LAPSE) / (1 - 2 * LAPSE)  # share of right answers at the threshold
        self._noise = math.log1p(weber) / statistics.NormalDist().inv_cdf(attended)
        self._random = random.Random(seed)

    def begin(self) -> None:
        """Begin without a key."""

    def judge(self, gains: list[float]) -> tuple[str, float]:
        """Return the number of the stroke that was stronger, and no time."""
        if self._random.random() < 2 * LAPSE:
            return self._random.choice("12"), 0.0
        difference = math.log(gains[1] / gains[0]) + self._random.gauss(0.0, self._noise)
        return "12"[difference > 0], 0.0


@dataclass
class StrokeOutcome:
    """Outcome of a stroke that was played.

    Attributes
    ----------
    onset : Onset
        Time at which the finger began to move, by the clock of the amplifier.
    underruns : int
        Number of times that blocks came too late to be played.
    fault : str
        Why the stroke was not as it should be; empty if it was.
    """

    onset: Onset
    underruns: int
    fault: str


def late_blocks(display: RemoteDisplay) -> int:
    """Return how often blocks of a display came too late so far.

    Parameters
    ----------
    display : RemoteDisplay
        Display, which is armed.

    Returns
    -------
    int
        Number of times.

    Raises
    ------
    StoppedError
        If the display is not armed, after an e-stop or because its server was held up.
    """
    stats = display.stats()
    if stats.state != "armed":
        raise StoppedError(f"the display is {stats.state}")
    return stats.counters["underruns"]


def stroke(
    display: RemoteDisplay, texture: str, gain: float, code: int, draw: Callable[[], None]
) -> StrokeOutcome:
    """Play a stroke: a finger that rests, moves from its onset on, and is lifted.

    Parameters
    ----------
    display : RemoteDisplay
        Display, which is armed.
    texture : str
        Name of the texture.
    gain : float
        Gain of the texture.
    code : int
        Code that appears on the marker lines at the onset, if the amplifier has some.
    draw : callable
        Function that draws a frame on the screen; called between two contacts.

    Returns
    -------
    StrokeOutcome
        Onset, and whether the stroke was as it should be.

    Raises
    ------
    StoppedError
        If the display is not armed before or after the stroke.
    """
    display.select([(texture, gain)])
    before = late_blocks(display)
    begin = time.monotonic() + REST
    at = tactile.At(begin, marker=code if display.info.marker_lines else 0)
    display.append([0.0], sample_rate=1000.0, amplitude=0.0, at=at)  # silent, with an onset
    times = [time.monotonic()]
    while times[-1] < begin + STROKE:
        speed = SPEED if times[-1] >= begin else 0.0
        position = (speed * (times[-1] - begin), 0.0)
        display.touch(position, velocity=(speed, 0.0), normal_force=FORCE, time=times[-1])
        draw()
        times.append(time.monotonic())
    display.lift()
    onset, gap = at.onset(), max(b - a for a, b in pairwise(times))
    underruns = late_blocks(display) - before
    held_up = f"the program was held up for {gap:.2f} s" if gap > LONGEST_GAP else ""
    return StrokeOutcome(onset, underruns, onset.reason or held_up)


def both_strokes(
    display: RemoteDisplay, screen: Screen, texture: str, kinds: list[str], gains: dict[str, float]
) -> tuple[dict[str, StrokeOutcome], int]:
    """Play both strokes of a trial until they are as they should be.

    Parameters
    ----------
    display : RemoteDisplay
        Display, which is armed.
    screen : Screen
        Screen, which shows the number of the stroke.
    texture : str
        Name of the texture.
    kinds : list of str
        "standard" and "comparison" in their order.
    gains : dict
        Gain of each of them.

    Returns
    -------
    dict
        Outcome of each of them.
    int
        Number of times that the trial was played.

    Raises
    ------
    StoppedError
        If no attempt was as it should be, or the display is not armed.
    """
    fault = ""
    for attempt in range(1, ATTEMPTS + 1):
        played = {}
        for number, kind in enumerate(kinds, 1):
            screen.wait(PAUSE)
            draw = partial(screen.draw, str(number))
            played[kind] = stroke(display, texture, gains[kind], CODES[kind], draw)
        fault = "; ".join(one.fault for one in played.values() if one.fault)
        if not fault:
            return played, attempt
    raise StoppedError(f"a trial failed {ATTEMPTS} times: {fault}")


def begin_quest(trials: int) -> data.QuestPlusHandler:
    """Return the procedure that chooses the difference of each trial.

    Parameters
    ----------
    trials : int
        Number of trials.

    Returns
    -------
    QuestPlusHandler
        Procedure, whose levels are Weber fractions [dB].
    """
    return data.QuestPlusHandler(
        trials, LEVELS, LEVELS, SLOPES, [GUESS], [LAPSE], ["right", "wrong"], stimScale="dB"
    )


def run(
    display: RemoteDisplay,
    screen: Screen,
    quest: data.QuestPlusHandler,
    options: argparse.Namespace,
) -> None:
    """Run all trials, each of which is in the file before the next one begins.

    Parameters
    ----------
    display : RemoteDisplay
        Display, which is armed.
    screen : Screen
        Screen and keyboard, or a rehearsal.
    quest : QuestPlusHandler
        Procedure that chooses the differences, as `begin_quest` returns it.
    options : Namespace
        Options of the command line.

    Raises
    ------
    StoppedError
        If Escape was pressed, the display is not armed, or a trial fails again and again.
    """
    order = random.Random(options.seed)
    for number, level in enumerate(quest, 1):
        weber = 10 ** (level / 20)
        gains = {"standard": STANDARD, "comparison": STANDARD * (1 + weber)}
        kinds = order.sample(list(gains), 2)
        played, attempts = both_strokes(display, screen, options.texture, kinds, gains)
        question = time.monotonic()
        key, seconds = screen.judge([gains[kind] for kind in kinds])
        answer = kinds[int(key) - 1]
        quest.addResponse("right" if answer == "comparison" else "wrong")
        row = {"trial": number, "weber_fraction": weber, "attempts": attempts}
        for kind, gain in gains.items():
            one = played[kind]
            row |= {
                f"{kind}_gain": gain, f"{kind}_onset_s": one.onset.time,
                f"{kind}_uncertainty_s": one.onset.uncertainty,
                f"{kind}_marker": one.onset.marker, f"{kind}_underruns": one.underruns,
            }  # fmt: skip
        row |= {
            "question_s": question, "answer": answer, "response_time_s": seconds,
            "threshold": 10 ** (quest.paramEstimate["threshold"] / 20),
            "participant": options.participant, "rehearsed": options.rehearse or 0,
            "texture": options.texture, "seed": options.seed, "stroke_s": STROKE,
            "speed_m_s": SPEED, "normal_force_n": FORCE, "psychopy": psychopy.__version__,
        }  # fmt: skip
        append(options.file, row)


def append(path: Path, row: dict[str, object]) -> None:
    """Append a row to a table, which begins with the names of the columns.

    Parameters
    ----------
    path : Path
        File of the table.
    row : dict
        Values by the names of the columns.
    """
    begins = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, row, delimiter="\t", lineterminator="\n")
        if begins:
            table.writeheader()
        table.writerow(row)


def describe(quest: data.QuestPlusHandler) -> str:
    """Return the threshold with the interval of one standard deviation of its posterior.

    Parameters
    ----------
    quest : QuestPlusHandler
        Procedure after the last trial.

    Returns
    -------
    str
        Weber fraction and its interval.
    """
    share = quest.posterior["threshold"]
    mean = float(share @ LEVELS)
    deviation = math.sqrt(float(share @ (LEVELS - mean) ** 2))
    low, middle, high = (10 ** (level / 20) for level in (mean - deviation, mean, mean + deviation))
    return f"Weber fraction {middle:.3f} ({low:.3f} to {high:.3f}) at {RIGHT:.0%} right answers"


def parse_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--participant", required=True, help="letters and digits, as in BIDS")
    parser.add_argument("--run", type=int, default=1, help="number of the run, 1 by default")
    parser.add_argument("--texture", default="wood-oak")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--folder", type=Path, default=Path("answers"), help="for the answers")
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**31, help="of the order")
    parser.add_argument("--window", action="store_true", help="leave the rest of the screen free")
    parser.add_argument("--rehearse", type=float, metavar="WEBER", help="simulate a participant")
    parser.add_argument("--url", help="URL of the server; by default that of this machine")
    parser.add_argument("--display", help="name of the display, if there are several")
    options = parser.parse_args()
    if not (options.participant.isascii() and options.participant.isalnum()):
        parser.error(f"participant {options.participant!r}: letters and digits only")
    if options.run < 1:
        parser.error(f"run {options.run}: at least 1")
    if options.rehearse is not None and not 0.03 <= options.rehearse <= 2:
        parser.error(f"rehearse {options.rehearse}: a Weber fraction from 0.03 to 2")
    if options.trials < 1:
        parser.error(f"trials {options.trials}: at least 1")
    options.file = options.folder / (
        f"sub-{options.participant}_task-strength_run-{options.run:02}_beh.tsv"
    )
    if options.file.exists():
        parser.error(f"{options.file} exists; give another --run")
    return options


def main() -> None:
    """Run the experiment."""
    options = parse_options()
    logging.console.setLevel(logging.CRITICAL + 1)  # of PsychoPy; what matters is said here
    options.folder.mkdir(parents=True, exist_ok=True)
    quest = begin_quest(options.trials)
    try:
        with tactile.client.connect(options.url, display=options.display) as display:
            full = not options.window
            if options.rehearse is None:
                screen = Screen(full)
            else:
                screen = Rehearsal(full, options.rehearse, options.seed + 1)
            screen.begin()
            display.arm()  # high voltage on
            try:
                run(display, screen, quest, options)
            finally:
                display.disarm()
    except (StoppedError, tactile.TactileError) as error:
        kept = f"; what was answered is in {options.file}" if options.file.exists() else ""
        sys.exit(f"{error}{kept}")
    print(f"{describe(quest)}, {len(quest.data)} trials: {options.file}")


if __name__ == "__main__":
    main()
