"""Tests of the experiment in PsychoPy: its estimates, its keys, and the table of a session.

PsychoPy has an environment of its own in CI, as it asks for older versions of what the project
needs, and a screen without a picture (Xvfb).
"""

import csv
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from session_rig import NAME, Story
from virtual_server import virtual_world

from tactile import messages as m
from tactile.server.client import Client

EXAMPLE = Path(__file__).parents[1] / "examples" / "psychopy"
BESIDE = Path(sys.prefix).parent / "psychopy" / "bin"
"""Programs of the environment that .ci/provision makes for PsychoPy."""
PATIENCE = 600
"""Longest time that a program may take on a slow machine [s]."""
GAINS = {"standard": 0.3, "comparison": 0.45}
STROKE = 0.5


def needed(program: str, reason: str) -> str:
    """Return the path of a program, or skip; in CI its absence is a failure."""
    path = shutil.which(program, path=f"{BESIDE}{os.pathsep}{os.environ['PATH']}")
    if path is None:
        if os.environ.get("CI") == "true":
            pytest.fail(f"needs {reason}")
        pytest.skip(f"needs {reason}")
    return path


@pytest.fixture
def python(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the Python that has PsychoPy, whose settings are of this test alone."""
    monkeypatch.setenv("HOME", str(tmp_path_factory.mktemp("home")))
    if find_spec("psychopy") is not None:
        return sys.executable
    if (BESIDE / "python").exists():
        return str(BESIDE / "python")
    reason = "needs PsychoPy: pip install psychopy"
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)


def run(*line: object) -> subprocess.CompletedProcess[str]:
    """Run a program to its end."""
    words = [str(word) for word in line]
    return subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE, check=False)


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


# The table of a session


def move_once(story: Story, client: Client) -> None:
    """Move the finger for one stroke in model time, and lift it."""
    for k in range(round(250 * STROKE)):
        contact = m.Contact(
            display=NAME, position_mm=(80 * k / 250, 0.0), velocity_mm_s=(80.0, 0.0),
            normal_force_n=0.5,
        )  # fmt: skip
        client.stream(contact, story.world.clock.now())
        story.pause(1 / 250)
    lift = m.Contact(display=NAME, position_mm=(40.0, 0.0), normal_force_n=0.0)
    client.stream(lift, story.world.clock.now())


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the answers of one trial in model time, and its session, which ends with an e-stop."""
    folder = tmp_path_factory.mktemp("experiment")
    row: dict[str, object] = {}
    with virtual_world(lambda playback, volts: None) as world:
        story = Story(world, folder)
        one, _ = story.start("mock:", 8000.0)
        assert isinstance(story.ask(one, m.ArmDisplay(display=NAME)), m.Done)
        for kind, gain in GAINS.items():
            layers = (m.Layer(texture="wood-oak", gain=gain),)
            story.ask(one, m.Select(display=NAME, layers=layers))
            story.pause(0.5)
            row[f"{kind}_onset_s"] = world.clock.now()
            move_once(story, one)
            row |= {
                f"{kind}_gain": gain, f"{kind}_uncertainty_s": 1e-6, f"{kind}_marker": 1,
                f"{kind}_underruns": 0,
            }  # fmt: skip
        row |= {"question_s": world.clock.now(), "response_time_s": 0.4, "answer": "comparison"}
        story.pause(0.5)
        story.ask(one, m.EStop())
        story.pause(0.5)
        world.stop()
        (session,) = story.sessions
    row |= {
        "trial": 1, "attempts": 1, "weber_fraction": 0.5, "threshold": 0.3, "stroke_s": STROKE,
        "rehearsed": 0, "speed_m_s": 0.08, "normal_force_n": 0.5,
        "texture": "wood-oak", "psychopy": "2026.2.5",
    }  # fmt: skip
    answers = folder / "sub-01_task-strength_run-01_beh.tsv"
    with answers.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, row, delimiter="\t")
        writer.writeheader()
        writer.writerow(row)
    return answers, session


@pytest.fixture(scope="module")
def dataset(recorded: tuple[Path, Path]) -> Path:
    """Return the dataset of the trial."""
    folder = recorded[1].parents[1] / "dataset"
    done = run(sys.executable, EXAMPLE / "session_to_bids.py", *recorded, "--to", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert Path(done.stdout.strip()).exists()
    return folder


EVENTS = "sub-01/beh/sub-01_task-strength_run-01_events"


def test_the_drive_of_a_stroke_is_that_which_was_played(dataset: Path) -> None:
    """Compare with a closed form: drive that no limit touches is in proportion to the gain."""
    rows = table(dataset / f"{EVENTS}.tsv")
    strokes = {row["trial_type"]: row for row in rows if row["trial_type"] in GAINS}
    assert {kind: float(row["gain"]) for kind, row in strokes.items()} == GAINS
    for quantity in ("drive_rms", "drive_peak"):
        standard, comparison = (float(strokes[kind][quantity]) for kind in GAINS)
        assert standard > 0.1
        ratio = pytest.approx(1.5, rel=0.02)  # a stroke begins anywhere in a block of 2 ms
        assert comparison / standard == ratio


def test_rows_are_in_the_order_of_time_with_the_events_of_the_display(dataset: Path) -> None:
    rows = table(dataset / f"{EVENTS}.tsv")
    onsets = [float(row["onset"]) for row in rows]
    assert onsets == sorted(onsets)
    kinds = [row["trial_type"] for row in rows]
    assert kinds.index("armed") < kinds.index("standard") < kinds.index("comparison")
    assert kinds.index("comparison") < kinds.index("answer") < kinds.index("estopped")
    strokes = [onsets[kinds.index(kind)] for kind in GAINS]
    assert np.diff(strokes) == pytest.approx(STROKE + 0.5, abs=0.1)


def test_the_sidecar_describes_all_columns_and_the_display(dataset: Path) -> None:
    facts = json.loads((dataset / f"{EVENTS}.json").read_text())
    rows = table(dataset / f"{EVENTS}.tsv")
    assert set(rows[0]) <= set(facts)
    assert {row["trial_type"] for row in rows} == set(facts["trial_type"]["Levels"])
    assert facts["Device"] == "mock:"
    assert facts["VoltageLimit"] == 50.0
    assert facts["Rehearsed"] is False
    assert "numpy" in facts["Versions"]


def test_the_judge_of_bids_accepts_the_dataset(dataset: Path) -> None:
    judge = needed("bids-validator-deno", "the BIDS validator: pip install bids-validator-deno")
    done = run(judge, dataset, "--json")
    issues = json.loads(done.stdout)["issues"]["issues"]
    assert [one for one in issues if one["severity"] == "error"] == []
    assert issues, "it recommends more"


def test_the_session_of_another_run_is_one_line(
    recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    (row,) = table(recorded[0])
    row["comparison_onset_s"] = str(float(row["comparison_onset_s"]) + 1e4)
    other = tmp_path / recorded[0].name
    other.write_text("\t".join(row) + "\n" + "\t".join(row.values()) + "\n")
    done = run(sys.executable, EXAMPLE / "session_to_bids.py", other, recorded[1], "--to", tmp_path)
    assert done.returncode == 1
    assert "trial 1 is missing; was another run recorded?" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == [other], "nothing is written"


@pytest.mark.parametrize("text", ["", "trial\n1\n"])
def test_what_is_no_file_of_answers_is_one_line(
    recorded: tuple[Path, Path], tmp_path: Path, text: str
) -> None:
    other = tmp_path / "other.tsv"
    other.write_text(text)
    done = run(sys.executable, EXAMPLE / "session_to_bids.py", other, recorded[1])
    assert done.stderr.endswith("its name must begin with sub- and end with _beh.tsv\n")
    other = other.rename(tmp_path / recorded[0].name)
    done = run(sys.executable, EXAMPLE / "session_to_bids.py", other, recorded[1])
    assert done.stderr == f"{other}: is no file of answers of texture_discrimination.py\n"
    other.unlink()
    done = run(sys.executable, EXAMPLE / "session_to_bids.py", other, recorded[1])
    assert str(other) in done.stderr
    assert len(done.stderr.splitlines()) == 1


# The experiment

SIMULATION = """
import argparse, importlib.util, json, sys
from pathlib import Path
from types import SimpleNamespace
spec = importlib.util.spec_from_file_location("experiment", sys.argv[1])
experiment = importlib.util.module_from_spec(spec)
spec.loader.exec_module(experiment)
onset = SimpleNamespace(time=0.0, uncertainty=None, marker=0)
played = dict.fromkeys(("standard", "comparison"), experiment.StrokeOutcome(onset, 0, ""))
experiment.both_strokes = lambda display, screen, texture, kinds, gains: (played, 1)
experiment.Screen.__init__ = lambda self, full: None
results = []
for seed in range(int(sys.argv[4])):
    options = argparse.Namespace(
        trials=60, seed=seed, texture="wood-oak", participant="01",
        rehearse=float(sys.argv[3]), file=Path(sys.argv[2], f"{seed}.tsv"),
    )
    screen = experiment.Rehearsal(False, options.rehearse, seed + 1)
    quest = experiment.begin_quest(options.trials)
    experiment.run(None, screen, quest, options)
    results.append([quest.paramEstimate["threshold"], experiment.describe(quest)])
print(json.dumps(results))
"""
"""Program that runs the experiment with rehearsed participants and without a display."""


@pytest.mark.ci
@pytest.mark.parametrize("weber", [0.1, 0.3])
def test_the_estimate_is_the_weber_fraction_of_the_participant(
    python: str, tmp_path: Path, weber: float
) -> None:
    """Participants are Gaussian, which shares nothing with the Weibull function of QUEST+."""
    done = run(python, "-c", SIMULATION, EXAMPLE / "texture_discrimination.py", tmp_path, weber, 20)
    assert done.returncode == 0, done.stderr
    results = json.loads(done.stdout.splitlines()[0])
    errors = np.array([level for level, _ in results]) - 20 * np.log10(weber)
    print(f"error of the threshold: mean {errors.mean():.2f} dB, deviation {errors.std():.2f} dB")
    assert abs(errors.mean()) < 1.0  # twice the standard error of 20, whose deviation is 2.2 dB
    assert errors.std() < 3.0
    inside = 0
    for _, text in results:
        low, high = (float(word.strip("()")) for word in text.split()[3:6:2])
        inside += low <= weber <= high
    assert inside >= 0.5 * len(results), "some 68 % of the intervals hold the true one"


def test_the_file_has_each_trial(python: str, tmp_path: Path) -> None:
    done = run(python, "-c", SIMULATION, EXAMPLE / "texture_discrimination.py", tmp_path, 0.2, 1)
    assert done.returncode == 0, done.stderr
    rows = table(tmp_path / "0.tsv")
    assert [row["trial"] for row in rows] == [str(k) for k in range(1, 61)]
    assert {row["answer"] for row in rows} == {"standard", "comparison"}
    for row in rows:
        ratio = float(row["comparison_gain"]) / float(row["standard_gain"])
        assert ratio == pytest.approx(1 + float(row["weber_fraction"]))
        assert float(row["comparison_gain"]) <= 1


# On a screen

KEYS = """
import sys
import time
from Xlib import X, XK, display
from Xlib.ext import xtest
server = display.Display()
for name in sys.stdin:
    code = server.keysym_to_keycode(XK.string_to_keysym(name.strip()))
    for event in X.KeyPress, X.KeyRelease:
        xtest.fake_input(server, event, code)
        server.sync()
        time.sleep(0.05)
"""
"""Program that presses the keys whose names it reads, as the keyboard of the screen does."""


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let programs draw on a screen without a picture."""
    server = needed("Xvfb", "Xvfb: apt install xvfb libgl1-mesa-dri libgl1 libglu1-mesa")
    read, write = os.pipe()
    words = [server, "-displayfd", str(write), "-screen", "0", "800x600x24", "-nolisten", "tcp"]
    with subprocess.Popen(words, pass_fds=[write], stderr=subprocess.DEVNULL) as process:
        os.close(write)
        with os.fdopen(read) as numbers:
            number = numbers.readline().strip()
        assert number, "Xvfb has ended"
        monkeypatch.setenv("DISPLAY", f":{number}")
        yield
        process.terminate()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Yield the address of a server that records a simulated display, and its process."""
    config = tmp_path / "lab.toml"
    config.write_text(
        '[server]\nport = 0\nsocket = ""\n[record]\nfolder = "sessions"\n'
        '[[display]]\nname = "left"\ndevice = "sim:"\n'
    )
    words = [sys.executable, "-m", "tactile", "serve", "--config", str(config)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[0], process
        process.terminate()


def experiment(python: str, url: str, folder: Path, *words: str) -> list[str]:
    """Return the words that start the experiment."""
    program = str(EXAMPLE / "texture_discrimination.py")
    common = ["--participant", "01", "--url", url, "--folder", str(folder), "--window"]
    return [python, program, *common, *words]


def skip_if_held_up(said: str) -> None:
    """Skip if the machine was too slow for the experiment, which has ended with this line."""
    reasons = "a trial failed", "disarmed", "display is lost", "no answer", "not known"
    if any(reason in said for reason in reasons):
        pytest.skip(f"this machine is too slow: {said}")


@pytest.mark.realtime
def test_a_rehearsal_becomes_a_dataset(
    python: str,
    screen: None,
    server: tuple[str, "subprocess.Popen[str]"],
    tmp_path: Path,
) -> None:
    url, process = server
    line = experiment(python, url, tmp_path, "--rehearse", "0.2", "--trials", "3")
    done = run(*line)
    skip_if_held_up(done.stderr)
    assert done.returncode == 0, done.stderr
    assert "right answers, 3 trials: " in done.stdout
    process.terminate()
    process.wait(PATIENCE)
    (session,) = (tmp_path / "sessions").iterdir()
    (answers,) = tmp_path.glob("*_beh.tsv")
    made = run(
        sys.executable, EXAMPLE / "session_to_bids.py", answers, session, "--to", tmp_path / "bids"
    )
    assert made.returncode == 0, made.stderr
    rows = table(tmp_path / "bids" / f"{EVENTS}.tsv")
    for trial in "123":
        strokes = {row["trial_type"]: row for row in rows if row["trial"] == trial}
        standard, comparison = (strokes[kind] for kind in GAINS)
        assert (standard["marker"], comparison["marker"]) == ("1", "2")
        played = float(comparison["drive_rms"]) / float(standard["drive_rms"])
        print(f"drive {played:.3f}, gains {1 + float(standard['weber_fraction']):.3f}")
        assert played > 0


@pytest.mark.realtime
def test_a_participant_answers_with_keys_and_ends_with_escape(
    python: str,
    screen: None,
    server: tuple[str, "subprocess.Popen[str]"],
    tmp_path: Path,
) -> None:
    line = experiment(python, server[0], tmp_path, "--trials", "20")
    keys = subprocess.Popen([python, "-c", KEYS], stdin=subprocess.PIPE, text=True)
    begun = subprocess.Popen(line, stderr=subprocess.PIPE, text=True)
    answers = tmp_path / "sub-01_task-strength_run-01_beh.tsv"
    with keys, begun:
        assert keys.stdin is not None
        end = time.monotonic() + PATIENCE
        try:
            while begun.poll() is None and time.monotonic() < end:
                keys.stdin.write("Escape\n" if answers.exists() else "space\n2\n")
                keys.stdin.flush()
                time.sleep(0.3)
        finally:
            begun.kill()
            keys.kill()
        assert begun.stderr is not None
        said = begun.stderr.read()
    skip_if_held_up(said)
    assert begun.returncode == 1
    assert said == f"Escape was pressed; what was answered is in {answers}\n"
    row = table(answers)[0]
    assert float(row["response_time_s"]) >= 0
    assert row["answer"] in GAINS


SCENE = """
import importlib.util, sys, time
spec = importlib.util.spec_from_file_location("experiment", sys.argv.pop(1))
experiment = importlib.util.module_from_spec(spec)
spec.loader.exec_module(experiment)
scene, stroke = sys.argv.pop(1), experiment.stroke

def disturbed(display, texture, gain, code, draw):
    begin = time.monotonic() + experiment.REST + experiment.STROKE / 2
    pending = [code] if code == 2 else []
    if scene == "disarm" and pending:
        display.disarm()

    def draw_or_disturb():
        if pending and time.monotonic() > begin:
            pending.clear()
            display.estop() if scene == "estop" else time.sleep(0.4)
        draw()

    return stroke(display, texture, gain, code, draw_or_disturb)

experiment.stroke = disturbed
experiment.main()
"""
"""Program that runs the experiment and disturbs, or disarms before, each stroke of a comparison."""


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("scene", "text"),
    [
        ("estop", "the display is estopped"),
        ("disarm", "the display is disarmed"),
        ("stall", "a trial failed 5 times"),
    ],
)
def test_a_trial_that_is_disturbed_is_not_counted(
    python: str,
    screen: None,
    server: tuple[str, "subprocess.Popen[str]"],
    tmp_path: Path,
    scene: str,
    text: str,
) -> None:
    program, *words = experiment(python, server[0], tmp_path, "--rehearse", "0.2")[1:]
    line = [python, "-c", SCENE, program, scene, *words]
    done = run(*line)
    assert done.returncode == 1
    assert scene != "disarm" or "arm it first" not in done.stderr, "no stroke begins disarmed"
    if text not in done.stderr:
        skip_if_held_up(done.stderr)
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.glob("*_beh.tsv")) == [], "no trial counts"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--participant", "a-b"], "participant 'a-b': letters and digits only"),
        (["--rehearse", "5"], "rehearse 5.0: a Weber fraction from 0.03 to 2"),
        (["--participant", "é"], "participant 'é': letters and digits only"),
        (["--run", "0"], "run 0: at least 1"),
        (["--trials", "0"], "trials 0: at least 1"),
        (["--run", "7"], "run-07_beh.tsv exists; give another --run"),
    ],
)
def test_a_mistake_is_one_line(python: str, tmp_path: Path, words: list[str], text: str) -> None:
    (tmp_path / "sub-01_task-strength_run-07_beh.tsv").touch()
    done = run(*experiment(python, "ws://127.0.0.1:1/v1", tmp_path, *words))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(text)


@pytest.mark.ci
def test_without_a_server_the_experiment_is_one_line(
    python: str, screen: None, tmp_path: Path
) -> None:
    line = experiment(python, "ws://127.0.0.1:1/v1", tmp_path)
    done = run(*line)
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 1
