"""Template of the messages as a header of C, with their encoding and decoding."""

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template

from clients.model import ApiModel, MessageField, NamedKind, Structure, ValueKind

SKELETON = Path(__file__).parent / "c" / "tactile_client.h.in"
"""Header without what the messages determine."""
STEMS = {
    "string": "text", "integer": "integer", "number": "number", "boolean": "boolean",
    "bytes": "bytes",
}  # fmt: skip
"""Stem of each scalar: the part of its names in C that follows ``tactile_``."""
TYPES = {"integer": "int64_t", "number": "double", "boolean": "bool"}
"""Type of each stem whose type is not its name behind ``tactile_``."""
WIDTH = 100
"""Maximum length of a line [characters]."""


@dataclass(frozen=True)
class _Member:
    """Field with the kinds of its values: the first, and any further ones but null."""

    field: MessageField
    kind: ValueKind
    alternatives: tuple[ValueKind, ...]
    nullable: bool

    @property
    def flagged(self) -> bool:
        """Whether a flag tells that the field is there, because zero is not its default."""
        return self.nullable or bool(self.field.default)


def c_header_text(model: ApiModel) -> str:
    """Render the messages as a header with their encoding and decoding.

    Parameters
    ----------
    model : ApiModel
        Messages of the API.

    Returns
    -------
    str
        Text of the header.
    """
    model = _named_as_in_c(model)
    structures = {one.name: one for one in model.structures}
    commands, answers = ([kind.name for kind in one.kind.of] for one in model.sums)
    parts = _parts([kind for one in model.sums for kind in one.kind.of], structures)
    pairs = [(kind, structures.get(kind.name)) for kind in parts.values()]
    constants = [
        f"{_comment(one.doc)}#define TACTILE_{one.name} {json.dumps(one.value)}\n"
        for one in model.constants
    ]
    types = [*map(_enumeration, model.enumerations), *(_type(*pair) for pair in pairs)]
    return Template(SKELETON.read_text("utf-8")).substitute(
        constants="\n".join(constants),
        types="\n".join(filter(None, types)),
        members="\n    ".join(f"tactile_{tag} {tag};" for tag in answers),
        tables="\n".join(filter(None, (_table(*pair) for pair in pairs))),
        encoders="\n".join(map(_encoder, commands)),
        answers=",\n      ".join(f"&tactile_shape_{tag}" for tag in answers),
    )


# Names


def _named_as_in_c(model: ApiModel) -> ApiModel:
    """Return a model whose names are those in C, with a name for each enumeration."""
    stems = {one.name: one.tag or _snake(one.name) for one in model.structures}
    stems |= {one.name: _snake(one.name) for one in model.enumerations}
    enumerations = list(model.enumerations)

    def renamed(kind: ValueKind, stem: str, field: str) -> ValueKind:
        if kind.form == "values":
            doc = f"Value of `{field}` of `tactile_{stem}`."
            enumerations.append(NamedKind(f"{stem}_{field}", doc, kind))
            return ValueKind("named", name=f"{stem}_{field}")
        parts = tuple(renamed(part, stem, field) for part in kind.of)
        return replace(kind, name=stems.get(kind.name, ""), of=parts)

    structures = []
    for one in model.structures:
        stem = stems[one.name]
        fields = (replace(f, kind=renamed(f.kind, stem, f.name)) for f in one.fields)
        structures.append(replace(one, name=stem, fields=tuple(fields)))
    sums = tuple(replace(one, kind=renamed(one.kind, "", "")) for one in model.sums)
    tags = ValueKind("values", values=tuple(one.name for one in sums[1].kind.of))
    enumerations.append(NamedKind("type", "Type of a message of the server.", tags))
    enumerations = [replace(one, name=_snake(one.name)) for one in enumerations]
    return ApiModel(model.constants, tuple(enumerations), tuple(structures), sums)


def _snake(name: str) -> str:
    """Return a name in lower case with underscores between its words."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def _stem(kind: ValueKind) -> str:
    """Return the part of the names of a kind that follows ``tactile_``."""
    match kind.form:
        case "named":
            return kind.name
        case "list":
            return f"{_stem(kind.of[0])}_list"
        case "map":
            return f"{_stem(kind.of[0])}_map"
        case "tuple" if [one.form for one in kind.of] == ["number", "number"]:
            return "pair"
        case form if form in STEMS:
            return STEMS[form]
    raise ValueError(f"the header has no type for {kind}")


def _type_name(stem: str) -> str:
    """Return the type of the values of a kind."""
    return TYPES.get(stem, f"tactile_{stem}")


def _members(structure: Structure) -> Iterator[_Member]:
    """Yield the fields of a structure as members."""
    for field in structure.fields:
        kinds = field.kind.of if field.kind.form == "any_of" else (field.kind,)
        first, *others = (kind for kind in kinds if kind.form != "null")
        yield _Member(field, first, tuple(others), ValueKind("null") in kinds)


def _parts(kinds: Iterable[ValueKind], structures: dict[str, Structure]) -> dict[str, ValueKind]:
    """Return all kinds that some consist of by their stems, each behind its own parts."""
    parts: dict[str, ValueKind] = {}
    for kind in kinds:
        inner = kind.of
        if kind.name in structures:
            members = list(_members(structures[kind.name]))
            inner = tuple(k for m in members for k in (m.kind, *m.alternatives))
        parts |= _parts(inner, structures)
        parts[_stem(kind)] = kind
    return parts


# Types


def _comment(doc: str, indent: str = "") -> str:
    """Return a documentation comment."""
    text = doc.replace("*/", "* /").replace("``", "`")
    line = f"{indent}/** {text} */\n"
    if "\n" not in text and len(line) <= WIDTH:
        return line
    lines = "".join(f"{indent} * {line}".rstrip() + "\n" for line in text.splitlines())
    return f"{indent}/**\n{lines}{indent} */\n"


def _enumeration(one: NamedKind) -> str:
    """Return the definition of an enumeration, and functions from and to its texts."""
    prefix, stem = f"TACTILE_{one.name.upper()}", one.name
    values = "".join(f",\n  {prefix}_{value.upper()}" for value in one.kind.values)
    names = "".join(f',\n    "{value}"' for value in one.kind.values)
    return f"""\
{_comment(one.doc)}typedef enum {{
  {prefix}_UNKNOWN{values}
}} tactile_{stem};

static const char *const tactile_names_{stem}[] = {{
    ""{names},
    NULL}};

/** Return the text of a value; empty if it is unknown. */
static inline const char *tactile_{stem}_name(tactile_{stem} value) {{
  return tactile_names_{stem}[value];
}}
"""


def _type(kind: ValueKind, structure: Structure | None) -> str:
    """Return the definition of the type of a kind, empty if the skeleton has it."""
    stem = _stem(kind)
    if structure is not None:
        members = "".join(map(_member_lines, _members(structure)))
        return f"{_comment(structure.doc)}typedef struct {{\n{members}}} tactile_{stem};\n"
    if kind.form == "list":
        return _array("List", _stem(kind.of[0]), stem)
    if kind.form == "map":
        item = _stem(kind.of[0])
        return (
            f"/** Entry of a map. */\ntypedef struct {{\n  tactile_text key;\n"
            f"  {_type_name(item)} value;\n}} tactile_{item}_entry;\n\n"
            + _array("Map", f"{item}_entry", stem)
        )
    return ""


def _array(noun: str, item: str, stem: str) -> str:
    """Return the definition of a type that points to items."""
    name = _type_name(item)
    return (
        f"/** {noun} of `{name}`. */\ntypedef struct {{\n  const {name} *items;\n"
        f"  size_t count;\n}} tactile_{stem};\n"
    )


def _member_lines(member: _Member) -> str:
    """Return the declarations of a field."""
    field = member.field
    default = f"\nDefault: {json.dumps(field.default)}." if field.default else ""
    lines = _comment(field.doc + default, "  ")
    lines += f"  bool has_{field.name};\n" if member.flagged else ""
    lines += f"  {_type_name(_stem(member.kind))} {field.name};\n"
    for stem in map(_stem, member.alternatives):
        lines += _comment(f"Alternative to `{field.name}`, which is used if the flag is set.", "  ")
        lines += f"  bool has_{field.name}_{stem};\n  {_type_name(stem)} {field.name}_{stem};\n"
    return lines


# Tables


def _table(kind: ValueKind, structure: Structure | None) -> str:
    """Return the table that describes a kind, empty if the skeleton has it."""
    stem = _stem(kind)
    if structure is not None:
        rows = [row for member in _members(structure) for row in _rows(stem, member)]
        if structure.positional:
            return _shape(stem, "TUPLE", rows)
        if not structure.tag:
            return _shape(stem, "STRUCTURE", rows)
        tag = f'static const char *const tactile_tag_{stem}[] = {{"{stem}"}};\n'
        return tag + _shape(stem, "STRUCTURE", rows, names=f"tactile_tag_{stem}")
    match kind.form:
        case "named":
            return _shape(stem, "ENUMERATION", names=f"tactile_names_{stem}")
        case "list":
            return _shape(stem, "LIST", of=f"&tactile_shape_{_stem(kind.of[0])}")
        case "map":
            item = _stem(kind.of[0])
            rows = [_field(f"{item}_entry", "key", "text"), _field(f"{item}_entry", "value", item)]
            entry = _shape(f"{item}_entry", "ENTRY", rows)
            return entry + _shape(stem, "MAP", of=f"&tactile_shape_{item}_entry")
    return ""


def _shape(
    stem: str, form: str, rows: Sequence[str] = (), of: str = "NULL", names: str = "NULL"
) -> str:
    """Return the definition of a shape, and of the fields that it has."""
    fields = f"tactile_fields_{stem}" if rows else "NULL"
    lines = "".join(f"    {row},\n" for row in rows)
    table = f"static const tactile_field {fields}[] = {{\n{lines}}};\n" if rows else ""
    return (
        f"{table}static const tactile_shape tactile_shape_{stem} = {{\n"
        f"    TACTILE_FORM_{form}, sizeof({_type_name(stem)}), {len(rows)},\n"
        f"    {of}, {names}, {fields}}};\n"
    )


def _rows(stem: str, member: _Member) -> Iterator[str]:
    """Yield the rows of a field, those of its alternatives first."""
    field, kind = member.field, _stem(member.kind)
    for other in map(_stem, member.alternatives):
        place = f"{field.name}_{other}"
        yield f'TACTILE_NAMED("{field.name}", {stem}, {place}, {other}, TACTILE_INSTEAD, 0)'
    rule = "TACTILE_OPTIONAL" if field.optional else "TACTILE_REQUIRED"
    if member.flagged:
        initial = float(field.default or 0)
        yield f"TACTILE_FLAGGED({stem}, {field.name}, {kind}, {rule}, {initial!r})"
    else:
        yield _field(stem, field.name, kind, rule)


def _field(stem: str, name: str, kind: str, rule: str = "TACTILE_REQUIRED") -> str:
    """Return the row of a field without a flag."""
    return f"TACTILE_FIELD({stem}, {name}, {kind}, {rule})"


def _encoder(tag: str) -> str:
    """Return the function that encodes a message."""
    return f"""\
static inline size_t tactile_encode_{tag}(
    const tactile_{tag} *message, uint8_t *out, size_t room) {{
  return tactile_encode(&tactile_shape_{tag}, message, out, room);
}}
"""
