"""Tests of the structure: rooms and their imports, uses of libraries, and lengths.

`MAP` says for each room (a package or module directly in `tactile`) which other rooms it may
import. A new room gets its line here.
"""

import ast
import graphlib
import importlib
import os
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

import firmware_protocol
import tactile

PACKAGE = Path(tactile.__file__).parent
PROJECT = Path(__file__).parents[1]

MAP: dict[str, set[str]] = {
    "arrays": set(),
    "errors": set(),
    "clock": set(),
    "machine_code": set(),
    "files": set(),
    "paths": set(),
    "messages": set(),
    "processes": set(),
    "actuator": set(),
    "display": {"actuator", "files"},
    "texture": {"files", "machine_code"},
    "rendering": {"display", "files", "machine_code", "texture"},
    "sensing": {"actuator", "files", "rendering"},
    "tracking": {"rendering"},
    "strength": {"display", "rendering", "texture"},
    "bus": {"clock", "files", "processes"},
    "sim": {"actuator", "bus", "display"},
    "devices": {"bus", "sim"},
    "estop": {"clock", "paths", "processes"},
    "playback": {
        "bus", "clock", "devices", "display", "estop", "files", "messages", "paths",
        "processes", "rendering", "sensing", "sim", "strength", "texture", "tracking",
    },
    "bringup": {"actuator", "bus", "devices", "display", "files", "playback", "sensing"},
    "server": {
        "clock", "display", "estop", "files", "messages", "paths", "playback",
        "processes", "rendering", "strength", "texture", "tracking",
    },
    "client": {"clock", "messages", "paths"},
    "local": {"client", "messages", "server"},
    "lsl": {"client", "clock"},
    "jack": {"client", "clock", "processes"},
    "show": {
        "actuator", "display", "files", "rendering", "sensing", "strength", "texture",
    },
    "study": {"actuator", "clock", "display", "files", "show"},
    "bench": {"bus", "clock", "devices", "display", "rendering", "texture"},
    "cli": {
        "bench", "bringup", "bus", "client", "devices", "display", "estop", "files",
        "jack", "lsl", "playback", "sensing", "server", "show", "strength", "study", "texture",
    },
    "__main__": {"cli"},
}  # fmt: skip
"""Rooms that a room may import besides itself and `EVERYWHERE`; `tactile/__init__.py` only names
where things live."""
EVERYWHERE = {"arrays", "errors"}
"""Rooms that every room may import."""
ALONE = {"rendering.equalizer": "takes a response array, never a beam or a finger"}
"""Modules that import nothing of tactile but the types of arrays."""
AT_HOME = {
    "PIL": {"texture.picture"},
    "numba": {"machine_code"},
    "onnxruntime": {"texture.formats.level_model"},
    "matplotlib": {"show", "study"},
    "jack": {"jack"},
    "pylsl": {"lsl"},
    "pymoo": {"study"},
    "rich": {"bench.__init__", "cli", "show.effect_view", "show.live", "show.still"},
    "typer": {"cli"},
}
"""Libraries that only some rooms or modules may import."""
PACKAGED = {
    "PIL": "pillow",
    "serial": "pyserial",
    "can": "python-can",
    "jack": "JACK-Client",
    "distributed": "dask",
    "prometheus_client": "prometheus-client",
    "tomli_w": "tomli-w",
}
"""Libraries whose package has another name."""
BY_NAME = {"__init__", "cli.app", "sim"}
"""Modules that may import by a name made at run time: lazily, a command, and a user's plant."""

PROTOCOL_MAY_IMPORT = {"numpy", "cobs"}
"""Packages besides the standard library that the protocol may import: it knows no physics and no
bus."""
PROTOCOL_IMPORTERS = {"bus", "sim"}
"""Rooms of tactile that know how drive goes over the wire."""
GENERATED = {"messages"}
"""Modules that a program writes, as long as they have to be."""

AWAITED = {"server.server": 2, "server.texture_store": 1, "server.tasks": 1}
"""Tasks that somebody waits for, that take their own exceptions, or that `start_task` watches, by
module."""

LONGEST_FUNCTION = 40

SOURCES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
"""Path by module, as "bus.base"; packages end in "__init__"."""
PROTOCOL = Path(firmware_protocol.__file__).parent
PROTOCOL_TREES = {
    path.stem: ast.parse(path.read_text("utf-8"))
    for path in sorted(PROTOCOL.glob("*.py"))
    if path.stem not in GENERATED
}
AROUND = [
    path
    for folder in ("tests", "docs", "examples", "benchmarks")
    for path in (PROJECT / folder).rglob("*.py")
]
"""Files outside the package that are held to its lengths."""
TREES = {module: ast.parse(path.read_text("utf-8")) for module, path in SOURCES.items()}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def room_of(module: str) -> str:
    return module.split(".")[0]


def is_module(name: str) -> bool:
    return name in SOURCES or f"{name}.__init__" in SOURCES


def imports(module: str) -> Iterator[str]:
    """Yield the full name of all that a module imports, wherever in it.

    ``from a.b import c`` is a.b.c, so that a module imported as a name is found as well.
    """
    parts = ["tactile", *module.split(".")]
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = parts[: len(parts) - node.level] if node.level else []
            origin = [*origin, *([node.module] if node.module else [])]
            yield from (".".join([*origin, alias.name]) for alias in node.names)


def own_imports(module: str) -> set[str]:
    """Return the modules of tactile that a module imports; "" for tactile itself."""
    found = set()
    for name in imports(module):
        first, _, inner = name.partition(".")
        if first == "tactile":
            while inner and not is_module(inner):
                inner = inner.rpartition(".")[0]
            found.add(inner)
    return found


def foreign_imports(module: str) -> set[str]:
    return {name.partition(".")[0] for name in imports(module)} - {"tactile"}


def functions(tree: ast.AST) -> Iterator[Function]:
    for node in ast.walk(tree):
        if isinstance(node, Function):
            yield node


# The map


def test_every_room_has_a_line_in_the_map_and_every_line_a_room() -> None:
    assert {room_of(module) for module in SOURCES} == {*MAP, "__init__"}


def test_the_map_points_one_way() -> None:
    order = list(graphlib.TopologicalSorter(MAP).static_order())
    assert set(order) == set(MAP), "a room that is imported has a line"


def test_a_module_imports_only_what_its_room_may_know() -> None:
    forbidden = {}
    for module in set(SOURCES) - {"__init__"}:  # which names where things live, as is tested below
        room = room_of(module)
        known = {room_of(name) for name in own_imports(module)} - {room}
        forbidden[module] = known - MAP[room] - EVERYWHERE - ({""} if room == "cli" else set())
    assert {module: rooms for module, rooms in forbidden.items() if rooms} == {}


@pytest.mark.parametrize("module", ALONE)
def test_a_module_that_stands_alone_imports_nothing_of_tactile(module: str) -> None:
    assert own_imports(module) <= {"arrays"}, ALONE[module]


@pytest.mark.parametrize("library", AT_HOME)
def test_a_library_is_imported_only_where_it_is_at_home(library: str) -> None:
    users = {module for module in SOURCES if library in foreign_imports(module)}
    homes = AT_HOME[library]
    assert {room_of(user) if room_of(user) in homes else user for user in users} == homes


def calls(module: str, name: str) -> list[ast.Call]:
    """Return the calls of a function or method of a name."""
    found = [node for node in ast.walk(TREES[module]) if isinstance(node, ast.Call)]
    return [
        call
        for call in found
        if name in (getattr(call.func, "attr", ""), getattr(call.func, "id", ""))
    ]


def test_only_clocks_read_the_time_and_let_it_pass() -> None:
    """Tests and the simulator pass a clock of their own; benchmarks measure the real one."""
    banned = {f"time.{name}" for name in ("monotonic", "monotonic_ns", "perf_counter", "sleep")}
    users = {
        module
        for module, tree in TREES.items()
        for node in ast.walk(tree)
        if (isinstance(node, ast.Attribute) and ast.unparse(node) in banned)
        or (isinstance(node, ast.ImportFrom) and node.module == "time")
    }
    assert {user for user in users if room_of(user) != "bench"} == {"clock"}


def test_nothing_waits_by_what_swallows_a_cancellation() -> None:
    """`asyncio.wait_for` of Python 3.11 does where a result comes in the same turn."""
    users = {
        module
        for module in SOURCES
        for call in calls(module, "wait_for")
        if isinstance(call.func, ast.Attribute) and getattr(call.func.value, "id", "") == "asyncio"
    }
    assert users == set()


def test_every_background_task_of_the_server_is_watched() -> None:
    """An exception would end an unwatched task in silence."""
    unwatched: Counter[str] = Counter()
    for module in SOURCES:
        if room_of(module) in ("server", "local"):
            unwatched.update([module] * len(calls(module, "create_task")))
    assert unwatched == AWAITED


def test_only_lazy_names_and_a_users_plant_are_imported_by_name() -> None:
    users = {
        module
        for module, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Name | ast.Attribute)
        and (node.id if isinstance(node, ast.Name) else node.attr)
        in ("import_module", "__import__", "find_spec", "exec_module")
    }
    assert users == BY_NAME


def test_nothing_is_imported_by_star_or_relatively() -> None:
    for module, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, module
                assert all(alias.name != "*" for alias in node.names), module


def test_the_protocol_imports_neither_tactile_nor_anything_that_does_io() -> None:
    for name, tree in PROTOCOL_TREES.items():
        found = {
            (alias.name if isinstance(node, ast.Import) else str(node.module)).partition(".")[0]
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom)
            for alias in node.names
        }
        known = {"firmware_protocol", *PROTOCOL_MAY_IMPORT, *sys.stdlib_module_names}
        assert found <= known, f"firmware_protocol.{name}"
        io = {"socket", "serial", "threading", "time", "asyncio", "os", "subprocess"}
        assert not found & io, f"firmware_protocol.{name} does I/O"


def test_only_buses_know_the_protocol() -> None:
    users = {m for m in SOURCES if "firmware_protocol" in foreign_imports(m)}
    assert {room_of(module) for module in users} <= PROTOCOL_IMPORTERS


@pytest.mark.parametrize("module", PROTOCOL_TREES)
def test_the_protocol_keeps_the_house_too(module: str) -> None:
    tree = PROTOCOL_TREES[module]
    assert (ast.get_docstring(tree) or "").strip()
    long = {f.name: length(f) for f in functions(tree) if length(f) > LONGEST_FUNCTION}
    assert long == {}


def test_every_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    declared = [
        *project["dependencies"],
        *extras["plot"],
        *extras["picture"],
        *extras["onnx"],
        *extras["lsl"],
        *extras["jack"],
        *extras["study"],
    ]
    names = {entry.partition(">")[0].partition("[")[0].strip() for entry in declared}
    used = {name for module in SOURCES for name in foreign_imports(module)} | {"cobs"}
    used -= set(sys.stdlib_module_names) | {"firmware_protocol"}
    assert {PACKAGED.get(name, name) for name in used} == names


# The front door


def test_the_front_door_imports_only_for_type_checkers() -> None:
    tree = TREES["__init__"]
    checked = [
        node
        for block in tree.body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for node in block.body
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("tactile"):
            assert node in checked


def test_each_public_class_has_a_name_of_its_own() -> None:
    """One name, one concept, also in benchmarks, examples and the programs of the pages."""
    homes = defaultdict(list)
    for folder in ("tactile", "firmware_protocol", "clients", "benchmarks", "examples", "docs"):
        for path in sorted((PROJECT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    homes[node.name].append(str(path.relative_to(PROJECT)))
    assert len(homes) > 300
    assert {name: files for name, files in homes.items() if len(files) > 1} == {}


def test_names_for_type_checkers_and_names_at_run_time_are_the_same() -> None:
    typed = {
        (str(node.module).removeprefix("tactile."), alias.name)
        for node in ast.walk(TREES["__init__"])
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("tactile")
        for alias in node.names
    }
    assert typed == {(home, name) for name, home in tactile._HOME.items()}
    assert set(tactile.__all__) == {name for _, name in typed}


def test_every_public_name_is_there_and_is_the_one_of_its_home() -> None:
    for name in tactile.__all__:
        home = importlib.import_module(f"tactile.{tactile._HOME[name]}")
        assert getattr(tactile, name) is getattr(home, name)
        assert name in dir(tactile)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'tactile' has no attribute 'rendr'"):
        _ = tactile.rendr


def loaded_after(statement: str) -> set[str]:
    """Return the packages that a fresh interpreter has after a statement."""
    code = f"import sys\n{statement}\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    run = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, env=os.environ
    )
    return set(run.stdout.split())


def test_import_tactile_alone_loads_neither_scipy_nor_numpy() -> None:
    assert loaded_after("import tactile") & {"numpy", "scipy", "msgspec", "rich", "typer"} == set()


def test_the_rendering_room_loads_no_drawing_and_no_command_line() -> None:
    loaded = loaded_after("import tactile; tactile.render, tactile.open_bus")
    assert "scipy" in loaded
    assert loaded & {"matplotlib", "rich", "typer", "threadpoolctl"} == set()


def test_a_client_loads_neither_rendering_nor_drivers() -> None:
    loaded = loaded_after("import tactile; tactile.connect")
    servers, drivers = {"starlette", "uvicorn"}, {"serial", "can", "smbus2", "sounddevice"}
    assert loaded & {"numpy", "scipy", "matplotlib", "rich", "typer", *servers, *drivers} == set()


def test_the_command_line_loads_no_plots_until_they_are_drawn() -> None:
    assert "matplotlib" not in loaded_after("import tactile.cli, tactile.show.plots")


# Names and sizes


def test_no_function_shares_its_name_with_a_module_or_package() -> None:
    """Functions of a module; a method is always seen behind its object."""
    modules = {part for name in SOURCES for part in name.split(".")} | {"tactile"}
    for module, tree in TREES.items():
        here = {node.name for node in tree.body if isinstance(node, Function)}
        assert here & modules == set(), module


def test_every_module_has_a_docstring() -> None:
    assert [name for name, tree in TREES.items() if not (ast.get_docstring(tree) or "")] == []


def length(function: Function) -> int:
    """Return the lines from the first after the docstring to the last."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    if not body:
        return 0
    first, last = body[0], body[-1]
    decorators = first.decorator_list if isinstance(first, Function | ast.ClassDef) else []
    start = min([first.lineno, *(node.lineno for node in decorators)])
    return (last.end_lineno or last.lineno) - start + 1


def test_no_function_is_longer_than_40_lines() -> None:
    long = {
        f"{module}: {f.name}": length(f)
        for module, tree in TREES.items()
        for f in functions(tree)
        if length(f) > LONGEST_FUNCTION
    }
    assert long == {}


def test_tests_and_examples_are_no_longer_than_what_they_are_of() -> None:
    texts = {str(path.relative_to(PROJECT)): path.read_text("utf-8") for path in AROUND}
    assert len(texts) > 100, "the checkout is whole"
    long = {
        f"{name}: {f.name}": length(f)
        for name, text in texts.items()
        for f in functions(ast.parse(text))
        if length(f) > LONGEST_FUNCTION
    }
    assert long == {}


def test_lengths_are_counted_from_after_the_docstring_to_the_last_line() -> None:
    text = 'def f():\n    """One\n\n    two."""\n    a = 1\n\n    return (\n        a\n    )\n'
    (function,) = functions(ast.parse(text))
    assert length(function) == 5


def test_imports_of_every_form_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests above would pass for nothing if an import were missed."""
    text = (
        "import tactile\nimport tactile.bus.registry as b\nfrom tactile import files\n"
        "from tactile.sim import Fidelity\nfrom ..texture import surface\nfrom . import limiter\n"
        "def f():\n    from tactile.bus import base\n    import scipy.signal\n"
    )
    monkeypatch.setitem(SOURCES, "rendering.example", PACKAGE / "rendering" / "example.py")
    monkeypatch.setitem(TREES, "rendering.example", ast.parse(text))
    assert own_imports("rendering.example") == {
        "", "bus.registry", "files", "sim", "texture.surface", "rendering.limiter", "bus.base",
    }  # fmt: skip
    assert foreign_imports("rendering.example") == {"scipy"}
