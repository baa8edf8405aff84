"""Write the pages of the site that are made of the code and of other files; `conf.py` calls it.

The display file, the texture file and the device URLs come from their schemas and the docstrings of
these, the command line from the commands, and the Python interface from the names that `tactile`
and its rooms make public. Documents from elsewhere in the checkout become pages as they are, with
links that lead to the site or to the repository.
"""

import ast
import importlib
import inspect
import re
import sys
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec.inspect
import typer
from numpydoc.docscrape import NumpyDocString

import tactile
from tactile import devices
from tactile.bus import registry
from tactile.bus.options import HEXADECIMAL, Options
from tactile.cli.app import COMMANDS, load_command
from tactile.display.tables import DisplayFile
from tactile.texture.descriptor import Descriptor

CHECKOUT = Path(__file__).resolve().parents[1]
REPOSITORY = "https://github.com/tactile-display/tactile/blob/main"

COPIED = {
    "textures/README.md": "textures.md",
    "firmware_protocol/SPEC.md": "specification.md",
    "firmware_protocol/c/README.md": "c-amplifier.md",
    "firmware_protocol/vectors/README.md": "vectors.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
"""Documents that are pages of the site as well."""

UNITS = {
    "_a": "A", "_db": "dB", "_deg": "°", "_hz": "Hz", "_n_per_m": "N/m", "_n_s_per_m": "N s/m",
    "_ma": "mA", "_mh": "mH", "_mm": "mm", "_mm_s": "mm/s", "_ms": "ms", "_n": "N", "_ohm": "Ω",
    "_per_mm": "1/mm", "_per_mm2": "1/mm²", "_pm_per_v": "pm/V", "_ppm": "ppm", "_s": "s",
    "_um": "µm", "_um2_per_n": "µm²/N", "_us": "µs", "_v": "V", "_v_per_us": "V/µs",
    "branches": "N/m, N s/m",
}  # fmt: skip
"""Unit by the suffix of a key or its whole name; the longest that fits counts."""

UNITLESS = {
    "address", "am_depth", "amplitude_sd", "boards", "channel", "channels", "columns", "contactors",
    "corrupt", "coupling", "depth", "eps33t_relative", "excess_kurtosis", "first_channel",
    "force_exponent", "gain", "hysteresis", "jitter", "kinetic_coefficient", "loss", "loss_tangent",
    "mux", "nodes", "parcap", "piezo_quality", "ports", "reorder", "rows", "seed", "shim_quality",
    "speed_exponent", "static_coefficient", "stick_slip", "sup_rise", "tolerance",
}  # fmt: skip
"""Keys of numbers that have no unit; any other number without a known unit is an error."""

ROOMS = {
    "display": "Displays",
    "texture": "Textures",
    "rendering": "Rendering",
    "strength": "Strength",
    "actuator": "Actuator and finger",
    "devices": "Devices",
    "playback": "Devices",
    "bus": "Devices",
    "client": "Programs on a server",
    "local": "Programs on a server",
    "errors": "Errors",
}
"""Page of each room that has names in `tactile`."""

MODULES = {
    "Devices": ("tactile.bus.base", "tactile.bus.registry", "tactile.sim"),
    "Programs on a server": ("tactile.client", "tactile.client.aio"),
    "Studies": (
        "tactile.study.sweep",
        "tactile.study.criteria",
        "tactile.study.scenarios",
        "tactile.study.ranges",
        "tactile.study.optimizing",
        "tactile.study.recommending",
        "tactile.study.measurement",
        "tactile.study.load_fit",
        "tactile.study.admittance_fit",
    ),
    "File formats": ("tactile.texture.formats", "tactile.texture.formats.document"),
    "Pictures": ("tactile.show.plots", "tactile.study.plots"),
    "Protocol": (
        "firmware_protocol.packet",
        "firmware_protocol.serial_link",
        "firmware_protocol.can_link",
        "firmware_protocol.i2c_link",
        "firmware_protocol.host",
        "firmware_protocol.amplifier",
    ),
}
"""Modules whose public names belong on a page, after those of `tactile`."""


def generate(folder: Path) -> None:
    """Write all generated pages into a folder; what is the same already stays as it is."""
    pages = {
        "display-file.md": file_page(
            "The display file", DisplayFile, "`displays/reference-24.toml`"
        ),
        "texture-file.md": file_page(
            "The texture file", Descriptor, "`textures/wood/wood-oak.toml`"
        ),
        "device-urls.md": device_page(),
        "command-line.md": command_page(),
        **python_pages(),
        **{page: copied(source) for source, page in COPIED.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    for old in set(folder.iterdir()) - {folder / name for name in pages}:
        old.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


# Documents


def copied(source: str) -> str:
    """Return a document of the checkout with links that lead somewhere from the site."""

    def link(found: re.Match[str]) -> str:
        target, _, part = found[1].partition("#")
        if not target or "://" in target:
            return found[0]
        path = (CHECKOUT / source).parent.joinpath(target).resolve()
        name = path.relative_to(CHECKOUT).as_posix()
        if name in COPIED:
            return f"]({COPIED[name]}{'#' * bool(part)}{part})"
        inside = name.startswith("docs/") and name.endswith(".md")
        return f"](/{name[5:]})" if inside else f"]({REPOSITORY}/{name})"

    return re.sub(r"\]\(([^)\s]+)\)", link, (CHECKOUT / source).read_text("utf-8"))


# Files


def file_page(title: str, schema: type, example: str) -> str:
    """Return the reference of a TOML file, a section for each of its tables."""
    lines = [f"# {title}", "", *prose(schema), "", f"A complete example is {example}.", ""]
    for heading, struct, needed in tables(schema):
        meanings = meanings_of(struct)
        lines += [f"## `{heading}`", "", *prose(struct), "", *([needed, ""] if needed else [])]
        lines += ["| key | unit | value | default | meaning |", "|---|---|---|---|---|"]
        for field in msgspec.inspect.type_info(struct).fields:  # type: ignore[attr-defined]
            if struct_of(field.type) is None:
                default = "*required*" if field.required else shown(field.default)
                lines.append(row(field, values(field.type), default, meanings[field.name]))
        lines.append("")
    return "\n".join(lines)


def meanings_of(struct: type) -> dict[str, str]:
    """Return what each attribute of a struct means, as its docstring says.

    Attributes that share a description are left out: each key has a meaning of its own.
    """
    documented = NumpyDocString(inspect.getdoc(struct) or "")["Attributes"]
    return {a.name: " ".join(line.strip() for line in a.desc) for a in documented}


def tables(schema: type, prefix: str = "") -> Iterator[tuple[str, type, str]]:
    """Yield each table's heading, its struct, and a line on whether it must be there."""
    for field in msgspec.inspect.type_info(schema).fields:  # type: ignore[attr-defined]
        struct = struct_of(field.type)
        if struct is None:
            continue
        name = f"{prefix}{field.encode_name}"
        many = isinstance(field.type, msgspec.inspect.VarTupleType)
        needed = "This table is required." if field.required else ""
        yield (f"[[{name}]]" if many else f"[{name}]"), struct, needed
        yield from tables(struct, f"{name}.")


def struct_of(kind: msgspec.inspect.Type) -> type | None:
    """Return the struct of a table or of an array of tables, None of anything else."""
    if isinstance(kind, msgspec.inspect.StructType):
        return kind.cls
    if isinstance(kind, msgspec.inspect.VarTupleType):
        return struct_of(kind.item_type)
    if isinstance(kind, msgspec.inspect.UnionType):
        return next((found for t in kind.types if (found := struct_of(t)) is not None), None)
    return None


def prose(struct: type) -> list[str]:
    """Return what a struct's docstring says before its first section, as Markdown."""
    told = NumpyDocString(inspect.getdoc(struct) or "")
    return markdown([*told["Summary"], "", *told["Extended Summary"]])


def markdown(lines: list[str]) -> list[str]:
    """Return lines of a docstring with its literals and names as code of Markdown."""
    return [re.sub(r"`+([^`]+)`+", r"`\1`", line) for line in lines]


def row(field: msgspec.inspect.Field, allowed: str, default: str, meaning: str) -> str:
    """Return the line of a key in its table; a unit in brackets in its meaning gets a cell."""
    stated = re.search(r" \[([^\]]+)\](?!\()", meaning)  # no link
    unit = unit_of(field, stated[1] if stated else "")
    meaning = meaning.replace(stated[0], "", 1) if stated else meaning
    cells = (f"`{field.encode_name}`", unit, allowed, default, *markdown([meaning.strip()]))
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def unit_of(field: msgspec.inspect.Field, stated: str = "") -> str:
    """Return the unit of a key by its suffix, or the one that its meaning states.

    Raises
    ------
    ValueError
        If the two differ, or if the key is that of a number that has neither and is not listed as
        unitless.
    """
    name = field.encode_name
    suffixes = [suffix for suffix in UNITS if name.endswith(suffix)]
    unit = UNITS[max(suffixes, key=len)] if suffixes else stated
    if stated not in ("", unit):
        raise ValueError(f"{name}: its suffix means {unit}, its docstring says [{stated}]")
    if not unit and is_number(field.type) and name not in UNITLESS:
        raise ValueError(f"{name}: no unit; add its suffix to UNITS, or the key to UNITLESS")
    return unit


def is_number(kind: msgspec.inspect.Type) -> bool:
    """Return whether a value is a number with a range, or a list of such."""
    match kind:
        case msgspec.inspect.UnionType():
            return any(map(is_number, kind.types))
        case msgspec.inspect.TupleType():
            return any(map(is_number, kind.item_types))
        case msgspec.inspect.VarTupleType():
            return is_number(kind.item_type)
        case msgspec.inspect.Metadata():
            return is_number(kind.type)
    return isinstance(kind, msgspec.inspect.IntType | msgspec.inspect.FloatType)


def shown(default: Any) -> str:
    """Return a default as TOML has it; nothing where a key may be left out."""
    if default is None or default in ((), ""):
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple):
        return f"`[{', '.join(f'{value:g}' for value in default)}]`"
    return f'`"{default}"`' if isinstance(default, str) else f"`{default:.12g}`"


def values(kind: msgspec.inspect.Type) -> str:
    """Return what a key may be: its type and range."""
    match kind:
        case msgspec.inspect.LiteralType():
            return ", ".join(f'`"{v}"`' if isinstance(v, str) else f"`{v}`" for v in kind.values)
        case msgspec.inspect.UnionType():
            return ", ".join(
                values(t) for t in kind.types if not isinstance(t, msgspec.inspect.NoneType)
            )
        case msgspec.inspect.TupleType():
            first, *others = kind.item_types
            same = all(other == first for other in others)
            told = [values(first)] if same else [values(t) for t in kind.item_types]
            return f"list of {len(kind.item_types)}: {'; '.join(told)}"
        case msgspec.inspect.VarTupleType():
            return f"list, each: {values(kind.item_type)}"
        case msgspec.inspect.StrType():
            return "text" if kind.pattern is None else f"text like `{kind.pattern}`"
        case msgspec.inspect.BoolType():
            return "`true`, `false`"
        case msgspec.inspect.IntType() | msgspec.inspect.FloatType():
            noun = "integer" if isinstance(kind, msgspec.inspect.IntType) else "number"
            return f"{noun}{limits(kind)}"
    raise TypeError(f"no words for {kind}")


def limits(kind: msgspec.inspect.IntType | msgspec.inspect.FloatType) -> str:
    """Return the range of a number, such as "> 0 and ≤ 200"."""
    bounds = {">": kind.gt, "≥": kind.ge, "<": kind.lt, "≤": kind.le}
    told = " and ".join(
        f"{sign} {bound:.12g}" for sign, bound in bounds.items() if bound is not None
    )
    return f" {told}" if told else ""


# Devices


def device_page() -> str:
    """Return the reference of device URLs, a section for each driver."""
    lines = [
        "# Device URLs",
        "",
        "A device is named by a URL: its kind, a colon, the name of the device where a kind has "
        "several, and after a question mark options as `name=value`, separated by `&`. Every "
        "option may be left out. The values of a list are separated by commas, numbers may be "
        "hexadecimal as in `0x42`, and `yes` and `1` stand for `true`, `no` and `0` for `false`. "
        "An unknown option and a value that is not allowed are errors. The guide to "
        "[devices](/guide/devices.md) tells which kind is for what.",
        "",
    ]
    for scheme, driver in sorted(drivers().items()):
        lines += [f"## `{scheme}:`", "", *device_section(driver)]
    return "\n".join(lines)


def drivers() -> dict[str, registry.Driver[Any]]:
    """Return the drivers that belong to the package, by scheme."""
    modules = {module.__name__ for module in devices.KINDS}
    return {s: d for s, d in registry._drivers.items() if d.factory.__module__ in modules}


def device_section(driver: registry.Driver[Any]) -> Iterator[str]:
    """Yield what a driver is, how its URLs are written, and its options, its own first.

    The first two paragraphs of the driver's module say what it is.
    """
    module = inspect.getdoc(sys.modules[driver.factory.__module__]) or ""
    yield "\n\n".join(markdown(module.split("\n\n")[:2]))
    yield from ["", "\n".join(prose(driver.options)).strip(), ""]
    yield from ["| option | unit | value | default | meaning |", "|---|---|---|---|---|"]
    declaring = [s for s in driver.options.__mro__ if issubclass(s, Options)]
    meanings = ChainMap(*map(meanings_of, declaring))
    for field in options_of(driver):
        allowed, default = option_values(field.type), option_default(field)
        yield row(field, allowed, default, meanings[field.name])
    yield ""


def options_of(driver: registry.Driver[Any]) -> list[msgspec.inspect.Field]:
    """Return the options of a driver, those that it shares with other drivers last."""
    fields = msgspec.inspect.type_info(driver.options).fields  # type: ignore[attr-defined]
    return sorted(fields, key=lambda field: field.name not in driver.options.__annotations__)


def option_values(kind: msgspec.inspect.Type) -> str:
    """Return what an option may be: its type and range, as a URL has them."""
    match kind:
        case msgspec.inspect.Metadata(type=msgspec.inspect.IntType() as number):
            assert kind.extra == HEXADECIMAL
            assert number.ge is not None
            assert number.le is not None
            if number.ge == number.le:
                return f"`{number.ge:#x}`"
            return f"integer ≥ {number.ge:#x} and ≤ {number.le:#x}"
        case msgspec.inspect.LiteralType():
            ordered = sorted(kind.values, key=lambda v: (int(v) if v.isdecimal() else 0, v))
            return ", ".join(f"`{v}`" for v in ordered)
        case msgspec.inspect.UnionType():
            (kind,) = (t for t in kind.types if not isinstance(t, msgspec.inspect.NoneType))
            return option_values(kind)
        case msgspec.inspect.VarTupleType():
            return f"list, each: {option_values(kind.item_type)}"
    return values(kind)


def option_default(field: msgspec.inspect.Field) -> str:
    """Return a default as a URL has it; nothing where its meaning tells."""
    if field.default in (None, ()):
        return ""
    if isinstance(field.default, tuple):
        return f"`{','.join(f'{value:#x}' for value in field.default)}`"
    return shown(field.default).replace('"', "")


# Command line


def command_page() -> str:
    """Return the reference of the command line."""
    lines = [
        "# The command line",
        "",
        "A mistake in an option or a file is reported in one line that names the file, the field, "
        "the value and the limit, and the exit code is then 2. `tactile --help` lists all commands "
        "in a terminal.",
        "",
    ]
    for heading in dict.fromkeys(entry.group for entry in COMMANDS.values()):
        lines += [f"## {heading}", ""]
        for name, entry in COMMANDS.items():
            if entry.group == heading:
                section = command_section(f"tactile {name}", load_command(name))
                lines += [f"### tactile {name}", "", *section]
    return "\n".join(lines)


def command_section(name: str, command: Any) -> Iterator[str]:
    """Yield what a command does, how it is called, and its arguments and options."""
    context = typer.Context(command, info_name=name)
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        head, _, example = " ".join(paragraph.split()).partition("Example: ")
        yield from [plain(head), ""] if head else []
        yield from ["```sh", example, "```", ""] if example else []
    usage = command.get_usage(context).split(": ", 1)[1]
    yield from ["Usage:", "", "```text", " ".join(usage.split()), "```", ""]
    records = [record for p in command.params if (record := p.get_help_record(context))]
    yield from ["| argument or option | |", "|---|---|"]
    for term, text in records:
        yield f"| `{term.replace('|', chr(92) + '|')}` | {plain(text)} |"
    yield ""


def plain(text: str) -> str:
    """Return text with what Markdown would read as markup escaped."""
    return re.sub(r"([\\*_<>|\[\]`$])", r"\\\1", text)


# Python


def python_pages() -> dict[str, str]:
    """Return the pages of the Python interface, by name of file."""
    pages: dict[str, list[str]] = {}
    for name in tactile.__all__:
        room = tactile._HOME[name].partition(".")[0]
        pages.setdefault(ROOMS[room], []).append(name)
    titles = [*pages, *(title for title in MODULES if title not in pages)]
    files = {f"python-{'-'.join(title.lower().split())}.rst": title for title in titles}
    return {
        name: "\n".join(python_page(title, pages.get(title, []))) for name, title in files.items()
    }


def python_page(title: str, names: list[str]) -> Iterator[str]:
    """Yield the lines of a page on some names of `tactile` and on some modules."""
    yield from [title, "=" * len(title), ""]
    for name in names:
        yield from entry("tactile", name, getattr(tactile, name))
    for module in MODULES.get(title, ()):
        yield from [f"``{module}``", "-" * (len(module) + 4), ""]
        loaded = importlib.import_module(module)
        yield from [inspect.getdoc(loaded) or "", ""]
        for name, value in public(loaded):
            yield from entry(module, name, value)


def public(module: Any) -> Iterator[tuple[str, Any]]:
    """Yield the classes and functions of a module that `tactile` itself does not name.

    They are those that it defines, and those that it imports in the form ``X as X`` or lists in its
    ``__all__``.
    """
    exported = getattr(module, "__all__", ())
    for node in ast.parse(inspect.getsource(module)).body:
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
                names = [node.name]
            case ast.ImportFrom():
                names = [a.name for a in node.names if a.asname == a.name or a.name in exported]
            case ast.Assign():
                names = [target.id for target in node.targets if isinstance(target, ast.Name)]
            case _:
                names = []
        for name in names:
            value = getattr(module, name)
            named = name in tactile._HOME and getattr(tactile, name) is value
            listed = inspect.isclass(value) or inspect.isfunction(value)
            if listed and not named and not name.startswith("_"):
                yield name, value


def entry(module: str, name: str, value: Any) -> list[str]:
    """Return the directive that documents a name."""
    if inspect.isclass(value):
        inherited = [] if issubclass(value, Exception) else ["   :inherited-members: object"]
        kind = "autoexception" if issubclass(value, Exception) else "autoclass"
        return [f".. {kind}:: {module}.{name}", "   :members:", *inherited, ""]
    if inspect.isroutine(value):
        return [f".. autofunction:: {module}.{name}", ""]
    text = [f".. py:data:: {module}.{name}", ""]
    if isinstance(value, Mapping):
        text += [f"   A mapping with the keys {', '.join(f'``{key}``' for key in value)}.", ""]
    return text
