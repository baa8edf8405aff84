"""Tests that names in single backticks in docstrings are names of the product.

Checked are dotted names that begin with a package, `module.name` and `ClassName.member`, and single
identifiers, which must occur in the code at least. What is written in double backticks is literal
text, and is not checked.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache

import pytest
from test_prose import ROOTS, docstrings, sources

import tactile

TREES = {name: ast.parse(path.read_text("utf-8")) for name, path in sources().items()}
"""Syntax tree of each file of the product."""
QUOTED = re.compile(r"(?<![`\w])`([A-Za-z_]\w*(?:\.\w+)*)(?:\(\))?`(?![`\w])")
"""A name in single backticks."""


def module_of(file: str) -> str:
    """Return the dotted name of the module in a file."""
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def defined(body: list[ast.stmt]) -> Iterator[str]:
    """Yield the names that statements define or import, also those below an ``if`` or ``try``."""
    for node in body:
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
                yield node.name
            case ast.Import() | ast.ImportFrom():
                yield from ((alias.asname or alias.name).partition(".")[0] for alias in node.names)
            case ast.Assign() | ast.AnnAssign() | ast.AugAssign() | ast.For() | ast.With():
                yield from (n.id for n in ast.walk(node) if isinstance(n, ast.Name))
            case ast.If() | ast.Try():
                yield from defined([*node.body, *node.orelse])


def of_class(node: ast.ClassDef) -> set[str]:
    """Return the members of a class itself, with the attributes that its methods assign."""
    own = set(defined(node.body))
    for inner in ast.walk(node):
        match inner:
            case ast.Attribute(value=ast.Name(id="self"), ctx=ast.Store()):
                own.add(inner.attr)
    return own


BARE = {"ABC", "Enum", "Generic", "IntEnum", "NamedTuple", "Protocol", "Struct"}
"""Base classes from elsewhere that have no members which docstrings would name."""
MODULES = {module_of(file): set(defined(tree.body)) for file, tree in TREES.items()}
"""Names in each module."""
MODULES["tactile"] |= set(tactile.__all__)
CLASSES: dict[str, list[tuple[set[str], list[str]]]] = defaultdict(list)
"""Members and bases of the classes of each name."""
CODE: set[str] = {part for module in MODULES for part in module.split(".")}
"""Identifiers that occur in the code, names of modules, and values of a ``Literal``."""
for _tree in TREES.values():
    for _node in ast.walk(_tree):
        match _node:
            case ast.ClassDef():
                _bases = [re.sub(r"\[.*|\w+\.", "", ast.unparse(base)) for base in _node.bases]
                CLASSES[_node.name].append((of_class(_node), _bases))
                CODE.add(_node.name)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                CODE.add(_node.name)
            case ast.Name():
                CODE.add(_node.id)
            case ast.Attribute():
                CODE.add(_node.attr)
            case ast.arg() | ast.keyword() if _node.arg:
                CODE.add(_node.arg)
            case ast.Subscript(value=ast.Name(id="Literal")):
                CODE.update(str(n.value) for n in ast.walk(_node) if isinstance(n, ast.Constant))
            case ast.alias():
                CODE.update((_node.asname or _node.name).split("."))


@cache
def has_member(name: str, member: str) -> bool:
    """Return whether a class of that name, or one of its bases, has a member.

    A class from elsewhere is assumed to have whatever is said of it.
    """
    return name not in CLASSES or any(
        member in members
        or any(has_member(base, member) for base in bases if base not in (name, *BARE))
        for members, bases in CLASSES[name]
    )


def exists(name: str) -> bool:
    """Return whether a name, with or without dots, is one of the product or may be of elsewhere."""
    first, _, rest = name.partition(".")
    if not rest:
        return first in CODE
    if first in ROOTS:
        return is_path(name)
    if first in CLASSES:
        return has_member(first, rest.partition(".")[0])
    homes = [module for module in MODULES if module.rpartition(".")[2] == first]
    return not homes or any(is_path(f"{home}.{rest}") for home in homes)


def is_path(name: str) -> bool:
    """Return whether a dotted name leads from a package to a module, a name in it, or a member."""
    if name in MODULES:
        return True
    module, _, last = name.rpartition(".")
    if module in MODULES:
        return last in MODULES[module]
    package, _, owner = module.rpartition(".")
    return package in MODULES and owner in MODULES[package] and has_member(owner, last)


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("tactile.bus.base.Bus", True),
        ("tactile.bus.base.Bus.write", True),
        ("tactile.local.LocalTransport", True),
        ("tactile.open_bus", True),
        ("firmware_protocol.host", True),
        ("Bus.estop", True),
        ("SerialOptions.format", True),
        ("materials.PIEZOS", True),
        ("time.monotonic", True),
        ("texture_figure", True),
        ("tactile.bus.base.Buss", False),
        ("tactile.bus.base.Bus.writes", False),
        ("tactile.bus.nothing", False),
        ("Bus.estopped", False),
        ("SerialOptions.forms", False),
        ("materials.write_block", False),
        ("plot_of_a_texture", False),
    ],
)
def test_a_name_that_is_not_there_is_noticed(name: str, *, there: bool) -> None:
    assert exists(name) is there


def test_names_in_docstrings_are_there() -> None:
    wrong = [
        f"{file}:{line}: {name}"
        for file, tree in TREES.items()
        for line, text in docstrings(tree)
        for name in QUOTED.findall(text)
        if not exists(name)
    ]
    assert wrong == []
