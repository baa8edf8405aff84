"""The command ``tactile``: a mistake is one line, and leaves nothing."""

import errno
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_rig import SHORT, Command, assert_mistake, started

from tactile import cli
from tactile.arrays import Floats
from tactile.bus import registry
from tactile.bus.base import Bus, DisplayLike
from tactile.bus.options import Options
from tactile.bus.registry import Address
from tactile.errors import BusError
from tactile.files import shipped
from tactile.playback.recording import Recorder

# Mistakes


GOOD_PATH = "time_s,x_mm,y_mm,normal_force_n\n0,0,0,0.5\n0.1,8,0,0.5\n0.2,16,0,0.5\n"
DISPLAY = next(shipped("displays").rglob("reference-24.toml")).read_text("utf-8")
TEXTURE = next(shipped("textures").rglob("wood-oak.toml")).read_text("utf-8")


def display_with(old: str, new: str) -> str:
    assert old in DISPLAY
    return DISPLAY.replace(old, new)


FILES = {
    "good.csv": GOOD_PATH,
    "backwards.csv": GOOD_PATH.replace("0.2,16", "0.05,16"),
    "word.csv": GOOD_PATH.replace("0.1,8", "0.1,eight"),
    "missing-column.csv": GOOD_PATH.replace("y_mm", "y_cm"),
    "header.csv": GOOD_PATH[: GOOD_PATH.index("0,0,0")],
    "unknown-key.toml": display_with("length_mm = 20.0", "lenght_mm = 20.0"),
    "unknown-key-of-two-lines.toml": DISPLAY + '\n[bimorph."a\\nb"]\n',
    "high-voltage.toml": display_with("voltage_v = 100.0", "voltage_v = 150.0"),
    "overlap.toml": display_with("pitch_mm = [2.5, 3.5]", "pitch_mm = [1.5, 3.5]"),
    "no-toml.toml": DISPLAY + "\n[[[\n",
    "texture.toml": TEXTURE.replace("[reference]", "[referenc]"),
}
BINARY = b"\xff\xfe\x00\x01" * 100

PLAY = {
    "no texture": ([], "Missing argument"),
    "two textures": (["wood-oak", "wood-oak"], "extra argument"),
    "unknown texture": (["wood-ok"], "no texture 'wood-ok'; did you mean 'wood-oak'?"),
    "texture like nothing": (["xyzzy"], "no texture 'xyzzy'; there is: "),
    "missing texture file": (["my/wood.toml"], "my/wood.toml: no such file"),
    "texture file with a slip": (["texture.toml"], "texture.toml: referenc: unknown key"),
    "unknown option": (["wood-oak", "--speed", "3"], "--speed-mm-s"),
    "unknown short option": (["wood-oak", "-x"], "-x"),
    "option without value": (["wood-oak", "--seed"], "--seed"),
    "seed below 0": (["wood-oak", "--seed", "-1"], "--seed"),
    "seed of a half": (["wood-oak", "--seed", "0.5"], "--seed"),
    "negative seconds": (
        ["wood-oak", "--seconds", "-1"],
        "--seconds -1: must be between 0.1 and 86400",
    ),
    "no seconds": (["wood-oak", "--seconds", "0"], "--seconds 0: must be"),
    "nan seconds": (["wood-oak", "--seconds", "nan"], "--seconds nan: must be"),
    "infinite seconds": (["wood-oak", "--seconds", "inf"], "--seconds inf: must be"),
    "seconds in words": (["wood-oak", "--seconds", "five"], "--seconds"),
    "negative speed": (
        ["wood-oak", "--speed-mm-s", "-1"],
        "--speed-mm-s -1: must be between 0 and 2000",
    ),
    "nan speed": (["wood-oak", "--speed-mm-s", "nan"], "--speed-mm-s nan"),
    "nan angle": (["wood-oak", "--angle-deg", "nan"], "--angle-deg nan"),
    "negative force": (["wood-oak", "--normal-force-n", "-0.1"], "--normal-force-n -0.1: must be"),
    "large force": (
        ["wood-oak", "--normal-force-n", "21"],
        "--normal-force-n 21: must be between 0 and 20",
    ),
    "low rate": (
        ["wood-oak", "--sample-rate-hz", "2499"],
        "--sample-rate-hz 2499: must be between 2500 and",
    ),
    "nan rate": (["wood-oak", "--sample-rate-hz", "nan"], "--sample-rate-hz nan"),
    "path and speed": (
        ["wood-oak", "--path", "good.csv", "--speed-mm-s", "80"],
        "--speed-mm-s cannot be used with --path",
    ),
    "path and seconds": (
        ["wood-oak", "--path", "good.csv", *SHORT],
        "--seconds cannot be used with --path",
    ),
    "path and angle": (
        ["wood-oak", "--path", "good.csv", "--angle-deg", "0"],
        "--angle-deg cannot be",
    ),
    "path and force": (
        ["wood-oak", "--path", "good.csv", "--normal-force-n", "1"],
        "cannot be used with",
    ),
    "missing path": (["wood-oak", "--path", "none.csv"], "none.csv: no such file"),
    "folder as path": (["wood-oak", "--path", "folder"], "folder: no such file"),
    "binary path": (["wood-oak", "--path", "binary.csv"], "binary.csv: cannot be read"),
    "unknown display": (["wood-oak", "--display", "reference-25"], "did you mean 'reference-24'"),
    "missing display": (["wood-oak", "--display", "none.toml"], "none.toml: no such file"),
    "folder as display": (["wood-oak", "--display", "./folder"], "folder"),
    "binary display": (["wood-oak", "--display", "binary.toml"], "binary.toml: cannot be read"),
    "unknown device": (["wood-oak", "--device", "moc:"], "did you mean 'mock:'"),
    "device without colon": (["wood-oak", "--device", "sim"], "did you mean 'sim:'"),
    "no device": (["wood-oak", "--device", ""], "no such kind"),
    "unknown device option": (["wood-oak", "--device", "sim:?plan=a:b"], "did you mean 'plant'"),
    "broken device option": (["wood-oak", "--device", "sim:?plant"], "options are name=value"),
    "malformed device": (["wood-oak", "--device", "sim://["], "sim://["),
    "missing plant": (["wood-oak", "--device", "sim:?plant=no.such:thing"], "no.such:thing"),
    "no plant": (["wood-oak", "--device", "sim:?plant=math:pi"], "math:pi"),
}
PATHS = {
    "backwards.csv": "time, sample 3: 0.05 s after 0.1 s; must ascend",
    "word.csv": "line 3: x_mm = 'eight': must be a finite number",
    "missing-column.csv": "no column 'y_mm'; did you mean 'y_cm'?",
    "header.csv": "has 0 rows, needs at least 2",
}
DISPLAYS = {
    "unknown-key.toml": "bimorph.lenght_mm: unknown key; did you mean 'length_mm'?",
    "unknown-key-of-two-lines.toml": "unknown key",
    "high-voltage.toml": "limits.voltage_v = 150",
    "overlap.toml": "overlap",
    "no-toml.toml": "not valid TOML",
}
RECORDS = {
    "missing folder": ("missing/r.npz", "missing/r.npz: cannot be written"),
    "file as folder": ("good.csv/r.npz", "good.csv/r.npz: cannot be written"),
    "folder": ("folder", "folder: is a folder"),
    "this folder": (".", "is a folder"),
    "too long": (f"{'long' * 100}.npz", "long"),
}
OTHERS = {
    "unknown command": (["paly", "wood-oak"], "'play'"),
    "unknown option of all": (["--jsno"], "--jsno"),
    "unknown finger": (["response", "--load", "lwo"], "'low', 'high', 'none'"),
    "display of response": (["response", "--display", "reference-25"], "'reference-24'"),
    "plot into a missing folder": (["response", "--plot", "missing/a.png"], "missing/a.png"),
    "plot of an unknown kind": (["response", "--plot", "a.xyz"], "a.xyz"),
    "texture to tell of": (["textures", "wood-ok", "--json"], "did you mean 'wood-oak'?"),
    "unknown benchmark": (["bench", "memry"], "no benchmark 'memry'; did you mean 'memory'?"),
    "picture without a scale": (
        ["relief", "a.png", "-o", "a.toml", "--category", "wood"],
        "--um-per-level is needed",
    ),
    "second benchmark": (["bench", "memory", "xyzzy"], "no benchmark 'xyzzy'; there is: "),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Hold good and bad files, and a good recording of old."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "binary.csv").write_bytes(BINARY)
    (tmp_path / "binary.toml").write_bytes(BINARY)
    (tmp_path / "folder").mkdir()
    (tmp_path / "old.npz").write_bytes(b"of old")
    return tmp_path


def content(folder: Path) -> dict[str, bytes | None]:
    """Return all that lies in a folder, hidden and inner ones included."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


MISTAKES: dict[str, tuple[list[str], tuple[str, ...]]] = {
    **{
        f"{case}, {target}": (["play", *arguments, "--record", target], (said,))
        for case, (arguments, said) in PLAY.items()
        for target in ("new.npz", "old.npz")
    },
    **{
        f"path {name}": (
            ["play", "wood-oak", "--path", name, "--record", "new.npz"], (f"{name}: ", said)
        )
        for name, said in PATHS.items()
    },
    **{
        f"display {name}": (
            ["play", "wood-oak", *SHORT, "--display", name, "--record", "new.npz"],
            (f"{name}: ", said),
        )
        for name, said in DISPLAYS.items()
    },
    **{
        f"response {name}": (["response", "--display", name, "--json"], (said,))
        for name, said in DISPLAYS.items()
    },
    **{
        f"recording {case}": (["play", "wood-oak", *SHORT, "--record", target], (said,))
        for case, (target, said) in RECORDS.items()
    },
    **{
        f"no file's name, {option}": (["play", "wood-oak", option, f"{'long' * 100}.toml"], ())
        for option in ("--display", "--path")
    },
    **{case: (arguments, (said,)) for case, (arguments, said) in OTHERS.items()},
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line_and_nothing_is_written(
    command: Command, folder: Path, case: str
) -> None:
    """The line names the file that is at fault, if there is one."""
    arguments, said = MISTAKES[case]
    before = content(folder)
    assert_mistake(command(*arguments), *said)
    assert content(folder) == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["play", "wood-oak", "--sped", "3", "--record", "new.npz"], "--sped"),
        (["play", "wood-oak", *SHORT, "--record", "missing/r.npz"], "cannot be written"),
    ],
)
def test_as_a_process_a_mistake_is_one_line_and_exit_code_2(
    folder: Path, arguments: list[str], said: str
) -> None:
    before = content(folder)
    assert_mistake(started(*arguments, cwd=folder), said)
    assert content(folder) == before


# No mistakes


def test_a_device_that_fails_to_open_is_one_line_and_exit_code_2(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(address: Address[Options], rig: DisplayLike, sample_rate: float | None) -> Bus:
        raise BusError("absent: the amplifier does not answer")

    monkeypatch.setitem(registry._drivers, "absent", registry.Driver(absent, Options))
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--device", "absent:", "--record", "new.npz")
    assert result.err == "tactile: absent: the amplifier does not answer\n"
    assert result.out == ""
    assert content(folder) == before
    assert result.code == 2


def test_interrupted_it_keeps_what_was_recorded_and_says_so_by_its_exit_code(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []
    add = Recorder.add

    def interrupted(self: Recorder, **arrays: Floats) -> None:
        calls.append(1)
        if len(calls) == 5:
            raise KeyboardInterrupt
        add(self, **arrays)

    monkeypatch.setattr(Recorder, "add", interrupted)
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--record", "old.npz")
    assert result.code == 130
    assert result.err.startswith("tactile: put out ")
    assert result.err.endswith(": interrupted\n")
    with np.load(folder / "old.npz") as recording:
        assert 0 < len(recording["drive_v"]) == len(recording["time_s"]) < 800
    after = content(folder)
    assert after.pop("old.npz") != before.pop("old.npz")
    assert after == before


def test_a_full_disk_is_one_line_and_leaves_nothing(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Recorder, **arrays: Floats) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "new.npz")

    monkeypatch.setattr(Recorder, "add", full)
    before = content(folder)
    result = command("play", "wood-oak", *SHORT, "--record", "new.npz")
    assert result.code in (1, 2)
    assert len(result.err.splitlines()) == 1
    assert "No space left on device" in result.err
    assert content(folder) == before


def test_a_mistake_of_our_own_is_not_hidden(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bug of ours shows where it is, so that it can be reported."""

    def broken(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("tactile.playback.runs.run", broken)
    monkeypatch.setattr(sys, "argv", ["tactile", "play", "wood-oak"])
    with pytest.raises(ZeroDivisionError):
        cli.main()
