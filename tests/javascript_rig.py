"""Random messages of the API as plain values, and where the JavaScript client is.

The messages are made from the Python types, of which the TypeScript ones know only by the schema.
"""

import random
import string
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from msgspec import inspect

from tactile.messages import Answer, Command

PROJECT = Path(__file__).parents[1]
CLIENT = PROJECT / "clients" / "javascript"
WEB = PROJECT / "tactile" / "server" / "web"
MESSAGES: tuple[Any, ...] = (*get_args(Command), *get_args(Answer))
"""Classes of all messages."""
TEXTS = string.ascii_letters + string.digits + "._ -"
"""Characters of names."""


def examples(rng: random.Random, count: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield class names and plain values of messages of each type, with the tag.

    The first of each type has all of its fields, the second only those without a default.
    """
    for kind in MESSAGES:
        for number in range(count):
            optional = {0: 1.0, 1: 0.0}.get(number, 0.5)
            plain = structure(inspect.type_info(kind), rng, optional)
            yield kind.__name__, {"type": kind.__struct_config__.tag, **plain}


def structure(info: Any, rng: random.Random, optional: float) -> Any:
    """Return random fields of a structure; a field with a default is there with a probability."""
    fields = {
        field.encode_name: value_of(field.type, rng)
        for field in info.fields
        if field.required or rng.random() < optional or info.array_like
    }
    return list(fields.values()) if info.array_like else fields


def value_of(info: Any, rng: random.Random) -> Any:
    """Return a random plain value of a type within its limits."""
    match info:
        case inspect.StructType():
            return structure(info, rng, 0.5)
        case inspect.UnionType():
            return value_of(rng.choice(info.types), rng)
        case inspect.LiteralType():
            return rng.choice(sorted(info.values, key=str))
        case inspect.TupleType():
            return [value_of(item, rng) for item in info.item_types]
        case inspect.VarTupleType():
            return [value_of(info.item_type, rng) for _ in range(rng.choice((0, 1, 3, 4)))]
        case inspect.DictType():
            return {
                text(rng): value_of(info.value_type, rng) for _ in range(rng.choice((0, 1, 40)))
            }
        case _:
            return scalar(info, rng)


def scalar(info: Any, rng: random.Random) -> Any:
    """Return a random scalar of a type within its limits, integers up to 2**53."""
    match info:
        case inspect.NoneType():
            return None
        case inspect.BoolType():
            return rng.random() < 0.5
        case inspect.IntType():
            low = -(2**53) if info.ge is None else max(info.ge, -(2**53))
            high = 2**53 if info.le is None else min(info.le, 2**53)
            number = rng.choice((-1, 1)) * rng.randrange(2 ** rng.randrange(54))
            return min(max(number, low), high)
        case inspect.FloatType():
            least, most = (-1e6 if info.ge is None else info.ge), (info.le or 1e6)
            return rng.choice((rng.uniform(least, most), least, most))
        case inspect.StrType():
            return text(rng) if info.pattern is None else rng.choice(("right", "wood-oak", "a b.c"))
        case inspect.BytesType():
            return rng.randbytes(4 * rng.randrange(100))
    raise NotImplementedError(info)


def text(rng: random.Random) -> str:
    """Return a random text, the first character of which is a letter, in any of five alphabets."""
    letters = rng.choice((TEXTS, TEXTS, "aµ", "a−漢", "a😀\n"))
    return "t" + "".join(rng.choice(letters) for _ in range(rng.choice((0, 3, 30, 31, 32, 60))))
