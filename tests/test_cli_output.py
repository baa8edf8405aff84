"""Output of the command ``tactile`` in narrow terminals and in encodings that lack characters."""

import io
import sys

import pytest
from cli_rig import Command

from tactile import cli
from tactile.cli.encoding import REPLACEMENTS
from tactile.cli.printing import print_table, right, unwrapped

PRINTING = {
    "textures": ["textures"],
    "texture": ["textures", "wood-oak"],
    "show": ["show", "wood-oak"],
    "materials": ["materials"],
    "strength": ["strength", "wood-oak"],
    "response": ["response"],
    "play": ["play", "wood-oak", "--seconds", "0.1"],
    "help": ["--help"],
}
"""Commands that print characters beyond ASCII, or much."""


ALL_TEXTURES = pytest.param("textures", marks=pytest.mark.ci)
"""The list of all textures, which takes some seconds to make."""
OTHERS = [name for name in PRINTING if name != "textures"]
"""Commands whose output takes less time."""


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
@pytest.mark.parametrize("name", [ALL_TEXTURES, *OTHERS])
def test_every_character_has_a_replacement_where_the_encoding_lacks_it(
    name: str, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, encoding))
    monkeypatch.setattr(sys, "argv", ["tactile", *PRINTING[name]])
    with pytest.raises(SystemExit) as ending:
        cli.main()
    sys.stdout.flush()
    assert ending.value.code == 0
    text = printed.getvalue().decode(encoding)
    assert "?" not in text
    assert len(text) > 100


def test_replacements_are_ascii() -> None:
    assert "".join(REPLACEMENTS.values()).isascii()


@pytest.mark.parametrize("name", [ALL_TEXTURES, "texture", "materials", "strength", "response"])
def test_a_narrow_terminal_breaks_no_word_and_no_line_is_too_long(
    name: str, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "500")
    words = {*command(*PRINTING[name]).out.split()}
    for width in (40, 60, 80, 100):
        monkeypatch.setenv("COLUMNS", str(width))
        lines = command(*PRINTING[name]).out.splitlines()
        assert {*" ".join(lines).split()} <= words, width
        assert max(map(len, lines)) <= width


def test_a_table_that_is_too_wide_is_printed_row_by_row(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    print_table([unwrapped("name"), *right("long heading")], [["oak " * 4, "1.5"]], "Woods")
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert lines == ["Woods", "oak oak oak oak", "  long heading  1.5"]


def test_the_first_columns_get_their_width_before_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "18")
    print_table(["name", "text"], [["oak wood", "sanded to 120"]])
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert lines == ["name      text", "oak wood  sanded", "          to 120"]
