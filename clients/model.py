"""Model of the API's messages that is independent of a language, made from their JSON Schema.

A template, such as `clients.typescript`, renders it as the source text of one language.
"""

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from tactile import messages

CONSTANTS = (
    "API_VERSION", "MSGPACK_PROTOCOL", "PATH", "LARGEST_MESSAGE", "MOST_LAYERS", "MOST_SAMPLES",
    "MOST_POINTS", "SILENCE",
)  # fmt: skip
"""Names of the constants that a client needs."""
SUMS = {"Command": "client", "Answer": "server"}
"""Key in the schema of each type that is one of several messages."""
ATTRIBUTE = re.compile(r"^(\w+) : .*\n((?:(?:    .*)?(?:\n|$))+)", re.MULTILINE)
"""Name and description of a field in the section Attributes of a docstring."""

Names = dict[tuple[str, ...], str]
"""Names of enumerations by their values in alphabetical order."""
Form = Literal[
    "string", "integer", "number", "boolean", "bytes", "null", "list", "map", "tuple", "any_of",
    "values", "named",
]  # fmt: skip
"""Form of a `ValueKind`: a scalar, a composition of other kinds, values of text, or a name."""


@dataclass(frozen=True)
class ValueKind:
    """Kind of the values that a field holds.

    Attributes
    ----------
    form : str
        Form of the kind.
    of : tuple of ValueKind
        Kinds that it is composed of: the items of a list, the values of a map by text, the members
        of a tuple, or the alternatives of "any_of".
    name : str
        Name of the structure or enumeration of the form "named".
    values : tuple of str
        Values that the form "values" allows.
    """

    form: Form
    of: tuple["ValueKind", ...] = ()
    name: str = ""
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class MessageField:
    """Field of a message or structure.

    Attributes
    ----------
    name : str
        Name on the wire, with its unit.
    kind : ValueKind
        Kind of its values.
    doc : str
        Description.
    optional : bool
        Whether it may be absent, which stands for its default.
    default : any
        Default; None without one.
    """

    name: str
    kind: ValueKind
    doc: str
    optional: bool
    default: Any = None


@dataclass(frozen=True)
class Structure:
    """Message, or a structure within messages.

    Attributes
    ----------
    name : str
        Name of the class.
    doc : str
        Description.
    fields : tuple of MessageField
        Fields without the tag.
    tag : str
        Value of the field ``type``, empty for what is no message.
    positional : bool
        Whether it is an array on the wire, in the order of the fields.
    """

    name: str
    doc: str
    fields: tuple[MessageField, ...]
    tag: str
    positional: bool


@dataclass(frozen=True)
class NamedKind:
    """Kind that has a name of its own: an enumeration, or one of several messages.

    Attributes
    ----------
    name : str
        Name.
    doc : str
        Description.
    kind : ValueKind
        Kind that it stands for.
    """

    name: str
    doc: str
    kind: ValueKind


@dataclass(frozen=True)
class ApiConstant:
    """Constant of the API.

    Attributes
    ----------
    name : str
        Name.
    doc : str
        Description.
    value : int, float or str
        Value.
    """

    name: str
    doc: str
    value: int | float | str


@dataclass(frozen=True)
class ApiModel:
    """Messages of the API with all that they consist of, in the order of their definition.

    Attributes
    ----------
    constants : tuple of ApiConstant
        Constants that a client needs.
    enumerations : tuple of NamedKind
        Sets of texts.
    structures : tuple of Structure
        Messages and the structures in them.
    sums : tuple of NamedKind
        Types that are one of several messages.
    """

    constants: tuple[ApiConstant, ...]
    enumerations: tuple[NamedKind, ...]
    structures: tuple[Structure, ...]
    sums: tuple[NamedKind, ...]


def api_model() -> ApiModel:
    """Make the model of the present API.

    Returns
    -------
    ApiModel
        Model.
    """
    schema = messages.schema()
    docs = dict(_docs_of_values())
    names = _enumerations()
    order = list(vars(messages))
    return ApiModel(
        tuple(ApiConstant(name, docs[name], getattr(messages, name)) for name in CONSTANTS),
        tuple(
            NamedKind(
                name, docs[name], ValueKind("values", values=get_args(getattr(messages, name)))
            )
            for name in names.values()
        ),
        tuple(
            _structure(name, schema["$defs"][name], names)
            for name in sorted(schema["$defs"], key=order.index)
        ),
        tuple(NamedKind(name, docs[name], _kind(schema[key], names)) for name, key in SUMS.items()),
    )


def _docs_of_values() -> Iterator[tuple[str, str]]:
    """Yield name and docstring of each value of the module."""
    body = ast.parse(Path(messages.__file__).read_text("utf-8")).body
    for assignment, after in pairwise(body):
        if not isinstance(assignment, ast.Assign | ast.AnnAssign):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            for node in ast.walk(assignment):
                if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    yield node.id, inspect.cleandoc(str(after.value.value))


def _enumerations() -> dict[tuple[str, ...], str]:
    """Return the name of each enumeration that has one, by its values in alphabetical order."""
    return {
        tuple(sorted(get_args(value))): name
        for name, value in vars(messages).items()
        if get_origin(value) is Literal
    }


def _structure(name: str, definition: dict[str, Any], names: Names) -> Structure:
    """Return the model of a structure."""
    doc, docs = _documentation(getattr(messages, name))
    if positional := definition["type"] == "array":
        properties = dict(zip(docs, definition["prefixItems"], strict=True))
        required = list(docs)[: definition["minItems"]]
    else:
        properties, required = definition["properties"], definition["required"]
    tag = properties.get("type", {}).get("enum", [""])[0]
    fields = (
        MessageField(key, _kind(value, names), docs[key], key not in required, value.get("default"))
        for key, value in properties.items()
        if not (tag and key == "type")
    )
    return Structure(name, doc, tuple(fields), tag, positional)


def _documentation(structure: type) -> tuple[str, dict[str, str]]:
    """Return the description of a structure, and those of its fields, also of inherited ones."""
    docs: dict[str, str] = {}
    for base in reversed(structure.__mro__):
        attributes = inspect.cleandoc(base.__doc__ or "").partition("\nAttributes\n")[2]
        docs |= {name: inspect.cleandoc(doc) for name, doc in ATTRIBUTE.findall(attributes)}
    text = inspect.cleandoc(structure.__doc__ or "")
    return text.partition("\nAttributes\n")[0].rstrip(), docs


def _kind(schema: dict[str, Any], names: Names) -> ValueKind:
    """Return the kind that the schema of a value describes."""
    match schema:
        case {"$ref": reference}:
            return ValueKind("named", name=reference.rpartition("/")[2])
        case {"anyOf": alternatives}:
            return ValueKind("any_of", tuple(_kind(one, names) for one in alternatives))
        case {"enum": values}:
            name = names.get(tuple(sorted(values)))
            return (
                ValueKind("named", name=name) if name else ValueKind("values", values=tuple(values))
            )
        case {"contentEncoding": "base64"}:
            return ValueKind("bytes")
        case {"prefixItems": items}:
            return ValueKind("tuple", tuple(_kind(item, names) for item in items))
        case {"items": item}:
            return ValueKind("list", (_kind(item, names),))
        case {"additionalProperties": value}:
            return ValueKind("map", (_kind(value, names),))
        case {"type": "string" | "integer" | "number" | "boolean" | "null" as form}:
            return ValueKind(form)
    raise ValueError(f"the model has no kind for {schema}")
