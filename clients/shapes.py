"""Template of the shapes of what a server sends, by which the TypeScript client checks it."""

import json
from collections.abc import Iterator

from clients.model import ApiModel, MessageField, Structure, ValueKind

HEAD = """\
/**
 * Shapes of what a server sends, by which the client checks it; written by
 * `python -m clients.generate` from the JSON Schema of tactile/messages.py.
 */

/** Kind of a value. Enumerations are texts: a later server may have more of their values. */
export type Kind =
  | "string"
  | "integer"
  | "number"
  | "boolean"
  | "bytes"
  | "null"
  | { readonly list: Kind }
  | { readonly map: Kind }
  | { readonly tuple: readonly Kind[] }
  | { readonly anyOf: readonly Kind[] }
  | { readonly shape: string };

/** Kinds of the fields of a message, or of a structure in one. */
export interface Shape {
  readonly required: Readonly<Record<string, Kind>>;
  readonly optional: Readonly<Record<string, Kind>>;
}
"""
"""Beginning of the file."""
COMPOSED = {"list": "list", "map": "map", "tuple": "tuple", "any_of": "anyOf"}
"""Key of each form that is composed of other kinds."""


def shapes_text(model: ApiModel) -> str:
    """Render the shapes of all messages of a server, and of the structures in them.

    Parameters
    ----------
    model : ApiModel
        Messages of the API.

    Returns
    -------
    str
        Text of a TypeScript module.
    """
    structures = {one.name: one for one in model.structures}
    enumerations = {one.name for one in model.enumerations}
    (answers,) = (one.kind.of for one in model.sums if one.name == "Answer")
    tags = {structures[one.name].tag: one.name for one in answers}
    needed = dict.fromkeys(tags.values())
    for name in (pending := list(needed)):
        inner = _structures_in(structures[name], enumerations)
        pending += [one for one in inner if one not in needed]
        needed |= dict.fromkeys(inner)
    lines = [f"  {tag}: {json.dumps(name)},\n" for tag, name in tags.items()]
    shapes = [_shape(structures[name], enumerations) for name in needed]
    return (
        f"{HEAD}\n/** Shape of each message by its type. */\n"
        f"export const ANSWERS: Readonly<Record<string, string>> = {{\n{''.join(lines)}}};\n\n"
        "/** Shapes by name. */\n"
        f"export const SHAPES: Readonly<Record<string, Shape>> = {{\n{''.join(shapes)}}};\n"
    )


def _structures_in(structure: Structure, enumerations: set[str]) -> list[str]:
    """Return the names of the structures that the fields of a structure consist of."""
    pending, names = [field.kind for field in structure.fields], []
    for kind in pending:
        pending += kind.of
        if kind.form == "named" and kind.name not in enumerations:
            names.append(kind.name)
    return names


def _shape(structure: Structure, enumerations: set[str]) -> str:
    """Return the lines of a shape.

    Raises
    ------
    ValueError
        If the structure is an array on the wire, which no message of a server has.
    """
    if structure.positional:
        raise ValueError(f"{structure.name} is an array, for which there is no shape")
    required = (field for field in structure.fields if not field.optional)
    optional = (field for field in structure.fields if field.optional)
    return (
        f"  {structure.name}: {{\n"
        + "".join(_part("required", required, enumerations))
        + "".join(_part("optional", optional, enumerations))
        + "  },\n"
    )


def _part(name: str, fields: Iterator[MessageField], enumerations: set[str]) -> Iterator[str]:
    """Yield the lines of the required or the optional fields."""
    yield f"    {name}: {{\n"
    for field in fields:
        yield f"      {field.name}: {_kind(field.kind, enumerations)},\n"
    yield "    },\n"


def _kind(kind: ValueKind, enumerations: set[str]) -> str:
    """Return the expression of a kind."""
    kinds = [_kind(one, enumerations) for one in kind.of]
    if kind.form == "values" or (kind.form == "named" and kind.name in enumerations):
        return '"string"'
    if kind.form == "named":
        return f"{{ shape: {json.dumps(kind.name)} }}"
    if kind.form not in COMPOSED:
        return json.dumps(kind.form)
    inner = kinds[0] if kind.form in ("list", "map") else f"[{', '.join(kinds)}]"
    return f"{{ {COMPOSED[kind.form]}: {inner} }}"
