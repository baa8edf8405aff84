"""Write the events of an experiment as BIDS does, from its answers and the recorded session.

    python examples/psychopy/session_to_bids.py answers/sub-01_task-strength_run-01_beh.tsv
        sessions/left-20261125T101500Z

Run it when the server has ended, which then writes the last part of the session. It adds a table to
the folder `dataset` with the strokes, the answers, and the events of the display meanwhile, such as
an e-stop or blocks that were late, and a sidecar that describes the columns, the experiment and the
display. The drive of each stroke is rendered again from the session: the table has the voltage that
was sent to the amplifier, and not only the gain that was commanded.
"""

import argparse
import csv
import json
import re
import sys
from pathlib import Path

import numpy as np

import tactile

COLUMNS = {
    "onset": ("time since SessionBegin, of a stroke by the clock of the amplifier", "s"),
    "duration": ("duration, of an answer the time from the question to the key", "s"),
    "trial_type": ("what happened: a stroke, an answer, or an event of the display", None),
    "trial": ("number of the trial, from 1", None),
    "attempts": ("number of times that the trial was played; only the last one counts", None),
    "weber_fraction": ("relative difference of both gains of the trial", None),
    "gain": ("gain of the texture that was commanded", None),
    "drive_rms": ("RMS of the drive of all contactors in the stroke", "V"),
    "drive_peak": ("largest magnitude of the drive in the stroke", "V"),
    "underruns": ("number of times that blocks of the stroke came too late to be played", None),
    "uncertainty": ("half of the interval around the onset that holds the true one", "s"),
    "marker": ("code that the amplifier has confirmed on its marker lines, 0 for none", None),
    "answer": ("stroke that was said to be stronger", None),
    "threshold": ("weber_fraction of 80 % right answers, as estimated after the answer", None),
    "detail": ("details of an event of the display", None),
}
MISSING = 0.1  # s, at the end of a stroke, that are too much to be late blocks
STROKES = "standard", "comparison"
LEVELS = {
    "standard": "stroke with the standard gain",
    "comparison": "stroke with a higher gain",
    "answer": "key of the participant",
}
Row = dict[str, str | int | float]


def read_trials(path: Path) -> list[dict[str, str]]:
    """Return the trials of a file of answers.

    Parameters
    ----------
    path : Path
        File that `texture_discrimination.py` wrote.

    Returns
    -------
    list of dict
        A row for each trial, by the names of the columns.
    """
    with path.open(newline="", encoding="utf-8") as file:
        trials = list(csv.DictReader(file, delimiter="\t"))
    if not trials or "standard_onset_s" not in trials[0]:
        sys.exit(f"{path}: is no file of answers of texture_discrimination.py")
    return trials


def strokes_of(trials: list[dict[str, str]], begun: float) -> list[Row]:
    """Return a row for each stroke.

    Parameters
    ----------
    trials : list of dict
        Trials as `read_trials` returns them.
    begun : float
        Time at which the session began [s].

    Returns
    -------
    list of dict
        Rows by the names in `COLUMNS`, without the drive.
    """
    return [
        {
            "onset": float(trial[f"{kind}_onset_s"]) - begun,
            "duration": float(trial["stroke_s"]),
            "trial_type": kind,
            "trial": trial["trial"],
            "weber_fraction": trial["weber_fraction"],
            "gain": trial[f"{kind}_gain"],
            "underruns": trial[f"{kind}_underruns"],
            "uncertainty": trial[f"{kind}_uncertainty_s"],
            "marker": trial[f"{kind}_marker"],
        }
        for trial in trials
        for kind in STROKES
    ]


def answers_of(trials: list[dict[str, str]], begun: float) -> list[Row]:
    """Return a row for each answer.

    Parameters
    ----------
    trials : list of dict
        Trials as `read_trials` returns them.
    begun : float
        Time at which the session began [s].

    Returns
    -------
    list of dict
        Rows by the names in `COLUMNS`.
    """
    return [
        {
            "onset": float(trial["question_s"]) - begun,
            "duration": float(trial["response_time_s"]),
            "trial_type": "answer",
            "trial": trial["trial"],
            "attempts": trial["attempts"],
            "weber_fraction": trial["weber_fraction"],
            "answer": trial["answer"],
            "threshold": trial["threshold"],
        }
        for trial in trials
    ]


def events_of(session: tactile.Session, first: float, last: float) -> list[Row]:
    """Return a row for each event from arming before the first row to disarming after the last.

    Parameters
    ----------
    session : Session
        Recorded session.
    first, last : float
        Onsets of the first and the last row, from the beginning of the session [s].

    Returns
    -------
    list of dict
        Rows by the names in `COLUMNS`.
    """
    begun = session.header.begun_s
    times = [(event["time_s"] - begun, event["kind"]) for event in session.messages]
    begin = max((t for t, kind in times if kind == "armed" and t <= first), default=first)
    ends = (t for t, kind in times if kind in ("disarmed", "estopped", "lost") and t >= last)
    end = min(ends, default=last)
    return [
        {
            "onset": event["time_s"] - begun,
            "duration": 0.0,
            "trial_type": event["kind"],
            "detail": " ".join(str(event["detail"]).split()),
        }
        for event in session.messages
        if begin <= event["time_s"] - begun <= end
    ]


def add_drive(strokes: list[Row], session: tactile.Session) -> None:
    """Add the voltage that was played in each stroke.

    Parameters
    ----------
    strokes : list of dict
        Rows of the strokes, to which the RMS and the peak of the drive are added [V].
    session : Session
        Recorded session, whose drive is rendered again.
    """
    times, powers, peaks = [], [], []
    for due, block in session.drives():
        if not isinstance(block, tactile.DriveBlock):
            sys.exit(f"{session.folder}: the link takes spectrum frames, which have no samples")
        times.append(due - session.header.begun_s)
        powers.append(np.mean(block.volts**2))
        peaks.append(np.max(np.abs(block.volts)))
    for row in strokes:
        stop = row["onset"] + row["duration"]
        begin, end = np.searchsorted(times, (row["onset"], stop))
        if begin == end or times[end - 1] < stop - MISSING:
            sys.exit(
                f"{session.folder}: trial {row['trial']} is missing; was another run recorded?"
            )
        row["drive_rms"] = float(np.sqrt(np.mean(powers[begin:end])))
        row["drive_peak"] = float(np.max(peaks[begin:end]))


def sidecar(trial: dict[str, str], kinds: set[str], session: tactile.Session) -> dict[str, object]:
    """Return the description of the table, the experiment and the display.

    Parameters
    ----------
    trial : dict
        A trial as `read_trials` returns it; what is taken from it is the same in all.
    kinds : set of str
        Values of `trial_type` in the table.
    session : Session
        Recorded session.

    Returns
    -------
    dict
        Contents of the sidecar as BIDS defines it.
    """
    columns: dict[str, object] = {
        name: {"Description": text} | ({"Units": unit} if unit else {})
        for name, (text, unit) in COLUMNS.items()
    }
    levels = {kind: LEVELS.get(kind, "event of the display") for kind in sorted(kinds)}
    columns["trial_type"] = {"Description": COLUMNS["trial_type"][0], "Levels": levels}
    header = session.header
    return columns | {
        "TaskName": "strength",
        "TaskDescription": "Two strokes over one texture are felt; which one is stronger?",
        "StimulusPresentation": {
            "SoftwareName": "PsychoPy",
            "SoftwareRRID": "RRID:SCR_006571",
            "SoftwareVersion": trial["psychopy"],
        },
        "Texture": trial["texture"],
        "FingerSpeed": float(trial["speed_m_s"]),
        "NormalForce": float(trial["normal_force_n"]),
        "Rehearsed": float(trial["rehearsed"]) > 0,
        "Session": session.folder.name,
        "SessionBegin": header.begun_utc,
        "Device": header.device,
        "SampleRate": header.how.sample_rate,
        "VoltageLimit": header.voltage_limit_v,
        "Display": header.display.text,
        "Versions": header.versions,
    }


def write(folder: Path, name: str, rows: list[Row], facts: dict[str, object]) -> Path:
    """Write the table and its sidecar, and the description of the dataset if there is none.

    Parameters
    ----------
    folder : Path
        Folder of the dataset.
    name : str
        Name of the file of answers, from which the names of the others follow.
    rows : list of dict
        Rows by the names in `COLUMNS`, in any order.
    facts : dict
        Contents of the sidecar.

    Returns
    -------
    Path
        File of the table.
    """
    path = folder / name.partition("_")[0] / "beh" / name.replace("_beh.tsv", "_events.tsv")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, restval="n/a", delimiter="\t", lineterminator="\n")
        table.writeheader()
        for row in sorted(rows, key=lambda row: row["onset"]):
            table.writerow({key: "n/a" if value == "" else value for key, value in row.items()})
    path.with_suffix(".json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    about = folder / "dataset_description.json"
    if not about.exists():
        text = {"Name": "Strength of textures", "BIDSVersion": "1.10.0", "DatasetType": "raw"}
        about.write_text(json.dumps(text, indent=2) + "\n", encoding="utf-8")
    return path


def main() -> None:
    """Write the events of one run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("answers", type=Path, help="file that texture_discrimination.py wrote")
    parser.add_argument("session", type=Path, help="folder of the session that the server recorded")
    parser.add_argument("--to", type=Path, default=Path("dataset"), help="folder of the dataset")
    options = parser.parse_args()
    if not re.fullmatch(r"sub-[A-Za-z0-9]+_.+_beh\.tsv", options.answers.name):
        parser.error(f"{options.answers}: its name must begin with sub- and end with _beh.tsv")
    trials, session = read_trials(options.answers), tactile.load_session(options.session)
    begun = session.header.begun_s
    strokes = strokes_of(trials, begun)
    add_drive(strokes, session)
    rows = strokes + answers_of(trials, begun)
    onsets = [row["onset"] for row in rows]
    rows += events_of(session, min(onsets), max(onsets))
    facts = sidecar(trials[0], {str(row["trial_type"]) for row in rows}, session)
    print(write(options.to, options.answers.name, rows, facts))


if __name__ == "__main__":
    try:
        main()
    except (OSError, tactile.TactileError) as error:
        sys.exit(f"{error}")
