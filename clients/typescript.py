"""Template of the messages as TypeScript."""

import json
from collections.abc import Iterator

from clients.model import ApiModel, MessageField, Structure, ValueKind

HEAD = """\
/**
 * Messages of the API with the names and units of tactile/messages.py; written by
 * `python -m clients.generate` from the JSON Schema of that module.
 *
 * A field with a `?` may be absent, which stands for its default.
 */
"""
"""Beginning of the file."""
TYPES = {
    "string": "string", "integer": "number", "number": "number", "boolean": "boolean",
    "bytes": "Uint8Array", "null": "null",
}  # fmt: skip
"""Type of each kind that is a scalar."""
WIDTH = 100
"""Maximum length of a line [characters]."""


def typescript_text(model: ApiModel) -> str:
    """Render the messages as a TypeScript module.

    Parameters
    ----------
    model : ApiModel
        Messages of the API.

    Returns
    -------
    str
        Text of the module.
    """
    parts = [HEAD]
    for constant in model.constants:
        value = json.dumps(constant.value)
        parts.append(f"{_comment(constant.doc)}export const {constant.name} = {value};\n")
    for enumeration in model.enumerations:
        parts.append(_comment(enumeration.doc) + _union(enumeration.name, enumeration.kind))
    parts += ["".join(_structure_lines(structure)) for structure in model.structures]
    parts += [_comment(one.doc) + _union(one.name, one.kind) for one in model.sums]
    return "\n".join(parts)


def _comment(doc: str, indent: str = "") -> str:
    """Return a documentation comment."""
    text = doc.replace("*/", "*\\/").replace("``", "`")
    line = f"{indent}/** {text} */\n"
    if "\n" not in text and len(line) <= WIDTH:
        return line
    lines = "".join(f"{indent} * {line}".rstrip() + "\n" for line in text.splitlines())
    return f"{indent}/**\n{lines}{indent} */\n"


def _union(name: str, kind: ValueKind) -> str:
    """Return the definition of a type that is one of several, with one on each line."""
    ways = [json.dumps(value) for value in kind.values] or [_type(one) for one in kind.of]
    return f"export type {name} =\n" + "\n".join(f"  | {way}" for way in ways) + ";\n"


def _type(kind: ValueKind) -> str:
    """Return the type of the values of a kind."""
    types = [_type(one) for one in kind.of]
    match kind.form:
        case "named":
            return kind.name
        case "values":
            return " | ".join(json.dumps(value) for value in kind.values)
        case "any_of":
            return " | ".join(types)
        case "tuple":
            return f"[{', '.join(types)}]"
        case "list":
            return f"({types[0]})[]" if " | " in types[0] else f"{types[0]}[]"
        case "map":
            return f"Record<string, {types[0]}>"
        case scalar:
            return TYPES[scalar]


def _structure_lines(structure: Structure) -> Iterator[str]:
    """Yield the lines of the definition of a structure, with their ends."""
    yield _comment(structure.doc)
    if structure.positional:
        yield f"export type {structure.name} = [\n"
    else:
        yield f"export interface {structure.name} {{\n"
    if structure.tag:
        yield f"  type: {json.dumps(structure.tag)};\n"
    for field in structure.fields:
        mark, end = "?" if field.optional else "", "," if structure.positional else ";"
        yield _comment(_field_doc(field), "  ")
        yield f"  {field.name}{mark}: {_type(field.kind)}{end}\n"
    yield "];\n" if structure.positional else "}\n"


def _field_doc(field: MessageField) -> str:
    """Return the description of a field with its default, if that is not nothing."""
    if field.default is None:
        return field.doc
    return f"{field.doc}\n@default {json.dumps(field.default)}"
