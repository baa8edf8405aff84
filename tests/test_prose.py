"""Tests of the language: how docstrings begin, and that the public interface is documented.

A docstring is understandable with the line above it hidden. It begins with a verb (functions) or a
noun (values), never with a preposition, a pronoun, a conjunction or a bare unit. Every public
function has sections for what it takes, returns and yields, which numpydoc's own validator checks.
"""

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
ROOTS = ("tactile", "firmware_protocol", "clients", "benchmarks")
AROUND = ("tests", ".ci", "docs", "examples")
"""Folders beside the product whose docstrings are to begin like those of the product."""
DANGLING = {
    "about", "above", "across", "after", "against", "along", "among", "around", "as", "at",
    "before", "behind", "below", "beneath", "beside", "besides", "between", "beyond", "by",
    "despite", "down", "during", "for", "from", "in", "inside", "into", "like", "near", "of",
    "off", "on", "onto", "out", "outside", "over", "past", "since", "than", "through", "till",
    "to", "toward", "towards", "under", "until", "up", "upon", "with", "within", "without",
    "he", "her", "hers", "his", "it", "its", "she", "that", "their", "them", "they", "this",
    "these", "those", "which", "who", "whom", "whose",
    "also", "and", "because", "but", "else", "nor", "or", "otherwise", "so",
}  # fmt: skip
"""Words that no docstring begins with: prepositions, pronouns and conjunctions."""
UNITS = {
    "s", "ms", "µs", "us", "ns", "Hz", "kHz", "MHz", "V", "mV", "mA", "m", "mm", "µm", "um",
    "nm", "N", "mN", "rad", "deg", "dB", "F", "nF", "Pa", "GPa", "kg", "ppm", "m/s", "V/s", "m/V",
}  # fmt: skip
"""Units that no docstring begins with; the unit stands in brackets behind the noun."""
COVERAGE = 0.95
"""Share of the public functions that the validator has nothing to say against."""
CHECKED = {"GL08", "PR01", "PR02", "PR03", "PR07", "RT01", "RT03", "YD01"}
"""Checks of numpydoc's validator: there is a docstring, it documents all parameters and no others,
in their order and with a description, and what is returned or yielded."""


def sources(roots: Iterable[str] = ROOTS) -> dict[str, Path]:
    """Return the path of each module in some folders by its name in files."""
    paths = [path for root in roots for path in sorted((PROJECT / root).rglob("*.py"))]
    return {path.relative_to(PROJECT).as_posix(): path for path in paths}


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of each docstring, also those that follow an assignment."""
    for node in ast.walk(tree):
        for field in ("body", "orelse", "finalbody"):
            statements = getattr(node, field, None)
            if not isinstance(statements, list):
                continue
            for statement in statements:
                if (
                    isinstance(statement, ast.Expr)
                    and isinstance(statement.value, ast.Constant)
                    and isinstance(statement.value.value, str)
                ):
                    yield statement.lineno, statement.value.value


def is_dangling(docstring: str) -> bool:
    """Return whether a docstring begins with a word that needs the line above it."""
    words = re.findall(r"[^\s,;:.()]+", docstring)
    return bool(words) and (words[0] in UNITS or words[0].lower() in DANGLING)


@pytest.mark.parametrize(
    ("docstring", "dangling"),
    [
        ("Of a client, that wait.", True),
        ("s between looks at the queue.", True),
        ("Hz of the bus.", True),
        ("V/s of the display.", True),
        ("Also at rest.", True),
        ("In a row.", True),
        ("Its name.", True),
        ("Maximum number of requests that one client may have queued.", False),
        ("Interval between looks at the queue [s].", False),
        ("Sample rate [Hz].", False),
        ("``udp:``, amplifiers on a local network.", False),
    ],
)
def test_a_docstring_that_hangs_in_the_air_is_seen(docstring: str, *, dangling: bool) -> None:
    assert is_dangling(docstring) is dangling


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    begun = [
        f"{name}:{line}: {text.splitlines()[0]}"
        for name, path in sources((*ROOTS, *AROUND)).items()
        for line, text in docstrings(ast.parse(path.read_text("utf-8")))
        if is_dangling(text)
    ]
    assert begun == []


def public_functions() -> Iterator[str]:
    """Yield the dotted names of public functions and methods of the packages.

    Commands of the command line are left out, whose docstrings are their help texts.
    """
    for name, path in sources().items():
        package = name.partition("/")[0]
        if package == "benchmarks" or name.startswith("tactile/cli/") or "__main__" in name:
            continue
        module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for node in ast.parse(path.read_text("utf-8")).body:
            members = node.body if isinstance(node, ast.ClassDef) else [node]
            prefix = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
            if prefix.startswith("_"):
                continue
            for member in members:
                if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef):
                    marks = " ".join(map(ast.unparse, member.decorator_list))
                    private = member.name.startswith("_")
                    if not (private or re.search(r"property|setter|overload", marks)):
                        yield f"{module}.{prefix}{member.name}"


@pytest.mark.ci
def test_public_functions_document_what_they_take_and_return() -> None:
    """Print the functions that are not documented in full; a few may be left."""
    validate = pytest.importorskip("numpydoc.validate").validate
    names = list(public_functions())
    assert len(names) > 1000
    faults = {name: {code for code, _ in validate(name)["errors"]} & CHECKED for name in names}
    left = {name: sorted(codes) for name, codes in faults.items() if codes}
    for name, codes in left.items():
        print(name, *codes)
    assert len(left) <= (1 - COVERAGE) * len(names)
