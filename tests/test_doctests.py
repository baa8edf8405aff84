"""Examples in docstrings give what they show, and the most used names have one.

Examples that would open a display, or need a server, are marked ``# doctest: +SKIP``.
"""

import doctest
import inspect
from importlib import import_module
from pathlib import Path

import pytest

import tactile

PACKAGE = Path(tactile.__file__).parent
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if ">>> " in path.read_text("utf-8")
)
"""Modules with examples."""
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
FEWEST = 20
"""Number of public names that have an example, at least."""


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_a_module(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    module = import_module(name)
    failed, tried = doctest.testmod(module, optionflags=FLAGS)
    assert tried > 0, f"{name}: its examples are in no docstring that doctest reads"
    assert failed == 0, capsys.readouterr().out


def has_example(thing: object) -> bool:
    """Return whether a function, or a class or one of its methods, has an example."""
    return any(test.examples for test in doctest.DocTestFinder().find(thing, name="it"))


def test_the_most_used_names_have_an_example() -> None:
    things = [getattr(tactile, name) for name in tactile.__all__]
    documented = [thing for thing in things if inspect.isclass(thing) or inspect.isroutine(thing)]
    assert sum(map(has_example, documented)) >= FEWEST
