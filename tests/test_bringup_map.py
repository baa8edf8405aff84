"""Bring-up writes the answers about contactors into a display's file, and nothing else."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bringup_rig import FOUR, GRID, put_out, same

from tactile.bringup.bringup import bring_up
from tactile.bus.base import Bus
from tactile.display.display import load_display
from tactile.display.edit import Map, checked_target, write_map
from tactile.errors import InputError

# Answers of a person


class Person:
    """Sees what moves: channel k moves ``moves[k]``, positive volts along or against its direction.

    What is asked is kept; ``extra`` are answers given before the true one to the first question.
    """

    def __init__(self, bus: list[Bus], moves: dict[int, tuple[int, int]], *extra: str) -> None:
        self.asked: list[str] = []
        self._bus, self._moves, self._extra = bus, moves, list(extra)
        self._sign = 0.0
        self._now = (0, 0)

    def __call__(self, question: str) -> str:
        self.asked.append(question)
        if self._extra:
            return self._extra.pop(0)
        if "which contactor" in question:
            volts = put_out(self._bus[0])[-4000:]  # of the last train, 8000 samples long
            channel = int(np.abs(volts).max(axis=0).argmax())
            self._now, self._sign = self._moves[channel], np.sign(volts[:, channel].sum())
            return str(self._now[0])
        return "y" if self._sign * self._now[1] > 0 else "n"


AS_IN_FILE = {0: (0, 1), 1: (1, -1), 3: (2, 1), 4: (3, 1)}


def test_true_answers_about_a_right_file_change_nothing(
    four: Path, tmp_path: Path, opened: list[Bus]
) -> None:
    person, target = Person(opened, AS_IN_FILE), tmp_path / "new.toml"
    report = bring_up("mock:?keep=all", four, ask=person, write=target)
    assert report.faults == []
    assert report.written == str(target)
    same(load_display(target), load_display(four))
    assert len(person.asked) == 8
    assert person.asked[3] == "did it shear toward 30° and back? [Y/n] "


def test_what_moves_otherwise_is_written(four: Path, tmp_path: Path, opened: list[Bus]) -> None:
    """Two lines are swapped, and three of four benders are glued the other way round."""
    moves = {0: (1, 1), 1: (0, -1), 3: (2, 1), 4: (3, -1)}
    target = tmp_path / "new.toml"
    report = bring_up("mock:?keep=all", four, ask=Person(opened, moves), write=target)
    assert report.faults == []
    new, old = load_display(target), load_display(four)
    assert new.channel.tolist() == [1, 0, 3, 4]
    assert new.polarity.tolist() == [-1, 1, 1, -1]
    same(replace(new, channel=old.channel, polarity=old.polarity), old)


def test_without_write_another_map_is_a_fault(four: Path, opened: list[Bus]) -> None:
    moves = AS_IN_FILE | {4: (3, -1)}
    report = bring_up("mock:?keep=all", four, ask=Person(opened, moves))
    assert report.faults == ["the display file has another map than the display; see --out"]


def test_enter_is_as_in_the_file(four: Path, tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    assert bring_up("mock:", four, ask=lambda question: "", write=target).faults == []
    same(load_display(target), load_display(four))


def test_answers_that_are_none_are_asked_again(four: Path, opened: list[Bus]) -> None:
    person = Person(opened, AS_IN_FILE, "4", "zero", "r")
    report = bring_up("mock:?keep=all", four, ask=person)
    assert report.faults == []
    assert [q.partition("channel")[0] for q in person.asked[:4]] == [
        "", "'4': a number below 4, r, - or q\n", "'zero': a number below 4, r, - or q\n", "",
    ]  # fmt: skip
    sounds = np.abs(put_out(opened[0])[:, 0]) > 1
    assert np.count_nonzero(np.diff(sounds.astype(int)) == 1) > 4 * 5  # trains, and the tone


def test_one_contactor_for_two_channels_is_refused(four: Path, tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    answers = iter(["2", "y", "2", "y", "2", "y", "3", "y"])
    report = bring_up("mock:", four, ask=lambda question: next(answers), write=target)
    assert report.faults == [
        "contactor 2: channels 0 and 1 both move it",
        "contactor 2: channels 1 and 3 both move it",
        f"{target} was not written: nobody told the whole map",
    ]
    assert not target.exists()


def test_a_channel_that_moves_nothing_is_a_fault(four: Path, tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    answers = iter(["-", "", "", "", "n", "", ""])
    report = bring_up("mock:", four, ask=lambda question: next(answers), write=target)
    assert report.faults == ["channel 0 moved nothing"]
    assert load_display(target).polarity.tolist() == [1, -1, -1, 1]
    answers = iter(["-", "0", "", "", "", "", ""])
    report = bring_up("mock:", four, ask=lambda question: next(answers))
    assert "channel 0: what it moves is not known" in report.faults


@pytest.mark.parametrize("answers", [["", "", "q"], ["", "", ""], ["", "", "", "bad"]])
def test_who_goes_away_ends_the_questions(answers: list[str], four: Path, tmp_path: Path) -> None:
    """Either question ends by q, or by the end of input."""
    left = iter(answers)

    def ask(question: str) -> str:
        try:
            return next(left)
        except StopIteration:
            raise EOFError from None

    target = tmp_path / "new.toml"
    report = bring_up("mock:", four, ask=ask, write=target)
    assert report.notes[-1] == "from channel 1 on nobody told what moves"
    assert report.faults == [f"{target} was not written: nobody told the whole map"]
    assert not target.exists()


# The file


def rewritten(path: Path, told: Map | None = None) -> str:
    target = path.with_name("new.toml")
    write_map(path, target, told or Map.of(load_display(path)), force=True)
    return target.read_text("utf-8")


def test_a_grid_becomes_contactors(grid: Path) -> None:
    text = rewritten(grid)
    same(load_display(grid.with_name("new.toml")), load_display(grid))
    assert "[grid]" not in text
    assert text.count("[[contactor]]") == 6
    comments = re.findall("#.*", text)
    assert comments == re.findall("#.*", GRID)
    before, _, after = text.partition("[[contactor]]")
    assert before.startswith(GRID[: GRID.index("# the comment")])
    assert after.endswith(GRID[GRID.index("# the finger's") :])


def test_contactors_keep_their_comments_and_all_else_its_place(four: Path) -> None:
    text = rewritten(four)
    same(load_display(four.with_name("new.toml")), load_display(four))
    kept = [line for line in FOUR.splitlines() if line.lstrip().startswith("#")]
    assert all(line in text.splitlines() for line in kept)
    assert "# glued the other way round\n" in text
    for part in ('description = "A # that is none, and [grid] in a text"', "[finger]          "):
        assert part in text
    assert text.rindex("\n[[contactor]]") < text.index("[finger]"), "contactors are gathered"
    assert rewritten(four.with_name("new.toml")) == text


def test_the_shipped_displays_can_be_rewritten(tmp_path: Path) -> None:
    for name in ("reference-24", "reference-64"):
        target = tmp_path / f"{name}.toml"
        write_map(name, target, Map.of(load_display(name)), force=False)
        same(load_display(target), load_display(name))


def test_responses_stay_and_keep_the_folder(four: Path, tmp_path: Path) -> None:
    rows = "frequency_hz,magnitude,phase_deg,unit\n20,1,0,um/V\n1000,1,0,um/V\n"
    for name in ("one.csv", 'tw"o.csv'):
        (tmp_path / name).write_text(rows, encoding="utf-8")
    text = FOUR.replace("channel = 3", "channel = 3\nresponse = 'tw\"o.csv' # measured")
    group = '[[group]]\nresponse = "one.csv"\ncontactors = [0]\n'
    four.write_text(text + group, encoding="utf-8")
    new = rewritten(four)
    same(load_display(tmp_path / "new.toml"), load_display(four))
    assert "# measured\n" in new
    assert load_display(tmp_path / "new.toml").kind.tolist() == [1, 0, 2, 0]
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match=r"must be in .*, where the measured responses are"):
        checked_target(four, tmp_path / "other" / "new.toml", force=False)


INLINE = "{columns = 3, rows = 2, pitch_mm = [2.9, 3.7], polarity = -1, first_channel = 2}"
REST = re.sub(r"# the comment(.|\n)*first_channel = 2\n", "", GRID)
OTHER_FORMS = {
    "dotted": REST.replace(
        "# Rows",
        "grid.columns = 3 # x\ngrid.rows = 2\ngrid.pitch_mm = [2.9, 3.7]\ngrid.polarity = -1\n"
        "grid.first_channel = 2\n# Rows",
    ),
    "inline": REST.replace("# Rows", f"grid = {INLINE} # x\n# Rows"),
    "in a text": GRID.replace('"Two rows of three"', '"""\n[grid]\n"""').replace("along", "# x"),
    "quoted": GRID.replace("[grid]", '["grid"]').replace("along", "# x"),
}


@pytest.mark.parametrize("text", OTHER_FORMS.values(), ids=OTHER_FORMS)
def test_a_grid_in_any_form_becomes_contactors(text: str, grid: Path) -> None:
    grid.write_text(text, encoding="utf-8")
    new = rewritten(grid)
    same(load_display(grid.with_name("new.toml")), load_display(grid))
    assert new.count("[[contactor]]") == 6
    assert sorted(re.findall("#.*", new)) == sorted(re.findall("#.*", text))


def test_contactors_in_line_stay_in_line(four: Path) -> None:
    head, tail = FOUR.partition("# how")[0], FOUR[FOUR.index("# of the limits") :]
    rows = "contactor = [\n{position_mm = [0, 0], channel = 0}, # left\n"
    rows += "{position_mm = [3, 0], channel = 1},\n]\n"
    four.write_text(rows + head + '[finger]\npreset = "low"\n' + tail, encoding="utf-8")
    text = rewritten(four, Map((1, 0), (-1, 1)))
    new = load_display(four.with_name("new.toml"))
    assert (new.channel.tolist(), new.polarity.tolist()) == ([1, 0], [-1, 1])
    assert "{position_mm = [3, 0], channel = 0},\n" in text
    assert "# left" in text


def test_nothing_is_overwritten_without_force(four: Path, tmp_path: Path) -> None:
    target, told = tmp_path / "new.toml", Map.of(load_display(four))
    target.write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="already exists; --force overwrites it"):
        write_map(four, target, told, force=False)
    with pytest.raises(InputError, match="already exists"):
        bring_up("nothing:", four, ask=lambda question: "", write=target)
    assert target.read_text("utf-8") == "mine"
    write_map(four, target, told, force=True)
    same(load_display(target), load_display(four))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["four.toml", "new.toml"]


@pytest.mark.skipif(os.name != "posix", reason="needs modes of files")
def test_what_is_overwritten_can_still_be_read_by_others(four: Path, tmp_path: Path) -> None:
    """A regression: it had the mode of a temporary file. It stays where a link points to."""
    ordinary, target, link = tmp_path / "ordinary", tmp_path / "new.toml", tmp_path / "link.toml"
    ordinary.touch()
    link.symlink_to(target)
    for path, force in ((target, False), (target, True), (link, True)):
        write_map(four, path, Map.of(load_display(four)), force=force)
        assert target.stat().st_mode == ordinary.stat().st_mode
    assert link.is_symlink()


@pytest.mark.parametrize(
    ("name", "said"), [("new.txt", "must end in .toml"), ("no/new.toml", "no folder")]
)
def test_targets_that_cannot_be(name: str, said: str, four: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        checked_target(four, tmp_path / name, force=False)


def test_what_would_be_no_display_is_not_written(four: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="drives more than one contactor"):
        write_map(four, tmp_path / "new.toml", Map((0, 0, 3, 4), (1, 1, 1, 1)), force=False)
    assert [path.name for path in tmp_path.iterdir()] == ["four.toml"]
