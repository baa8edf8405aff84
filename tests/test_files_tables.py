"""A bad table becomes one line: file, line, column and value."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import NO_PANIC, has, refusal

from tactile import files
from tactile.errors import InputError, NotFoundError


def table(path: Path, text: str | bytes) -> list[list[float]]:
    """Read the columns a and b_mm of a CSV file."""
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    names = ("a", "b_mm")
    return files.numbers(path, names, files.read_columns(path, names)).tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    "text",
    [
        "a,b_mm\n1,2\n3,4e0\n",
        "b_mm,a\r\n2,1\r\n4,3\r\n",
        "note,a,b_mm\nx,1, 2\ny,3,4",
        "\ufeffa,b_mm\n1,2\n3,4\n",
        '"a","b_mm"\n"1","2"\n\n3,4\n',
    ],
    ids=["plain", "other order", "more columns", "byte order mark", "quotes, empty line"],
)
def test_a_table_is_read_by_its_header(tmp_path: Path, text: str) -> None:
    assert table(tmp_path / "t.csv", text) == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b_m\n1,2\n", ("no column 'b_mm'", "did you mean 'b_m'?")),
        ("x,y\n1,2\n", ("no column 'a'", "x, y")),
        ("", ("no column 'a'", "nothing")),
        ("a,b_mm\n1,2\n3,four\n", ("line 3", "b_mm = 'four'", "finite number")),
        ("a,b_mm\n1,2\n3,\n", ("line 3", "b_mm = ''", "finite number")),
        ("a,b_mm\n1,2\n3\n", ("line 3", "b_mm = None", "finite number")),
        ("a,b_mm\nnan,2\n", ("line 2", "a = 'nan'", "finite number")),
        ("a,b_mm\n1,-inf\n", ("line 2", "b_mm = '-inf'", "finite number")),
        ("a,b_mm\n1,1e999\n", ("line 2", "b_mm = '1e999'", "finite number")),
        ('a,b_mm\n1,"2\n3"\n', ("b_mm = '2\\n3'", "finite number")),
        (b"a,b_mm\n1,\xff\n", ("cannot be read", "byte 0xff")),
    ],
)
def test_a_bad_table_names_line_column_and_value(
    tmp_path: Path, text: str | bytes, words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        table(tmp_path / "t.csv", text)
    has(str(caught.value), f"{tmp_path / 't.csv'}: ", *words)
    assert "\n" not in str(caught.value)


def test_the_line_that_is_named_counts_empty_lines(tmp_path: Path) -> None:
    """An editor shows the "x" on line 5."""
    with pytest.raises(InputError, match="line 5"):
        table(tmp_path / "t.csv", "a,b_mm\n1,2\n\n\n3,x\n")


def test_a_missing_table_is_not_found(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(NotFoundError, match="no such file"):
            files.read_columns(path, ("a",))


@NO_PANIC
@given(content=st.binary(max_size=40) | st.text('a,b_m123.e-\n"', max_size=40).map(str.encode))
def test_whatever_a_table_holds_its_numbers_are_finite_or_it_is_refused(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path, text = tmp_path_factory.getbasetemp() / "anything.csv", b"a,b_mm\n" + content
    message = refusal(lambda: np.testing.assert_array_less(np.abs(table(path, text)), np.inf))
    assert message is None or "\n" not in message


def test_a_table_that_is_too_large_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "LARGEST_TABLE", 16)
    assert table(tmp_path / "t.csv", "a,b_mm\n1,2\n3,4\n"[:15]) == [[1, 2], [3, 4]]
    with pytest.raises(InputError, match="is larger than 0 MiB"):
        table(tmp_path / "t.csv", "a,b_mm\n1,2\n3,42\n5,6\n")
