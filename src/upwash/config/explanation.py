"""Puts msgspec's errors into words: which key, what was expected there, what was found.

Such an error names a path like `$.server[0].range_m`. What was expected is looked up in the types and what
was found in the document, so that every message has the same shape.
"""

from __future__ import annotations

import json
import re
from typing import Any

from msgspec import inspect

from upwash.config.problems import Document, Problem, listed, unknown

_WORDS = {
    inspect.BoolType: "true or false",
    inspect.FloatType: "a number",
    inspect.IntType: "an integer",
    inspect.StrType: "a string",
}
_LONGEST_SHOWN = 60


def explained(message: str, document: Document, kind: type) -> Problem:
    """The key that a message of msgspec's is about, and what to change there."""
    said, _, path = message.rpartition(" - at `$") if " - at `$" in message else (message, "", "")
    key = path.removesuffix("`").removeprefix(".").replace("[...]", "")  # [...] is an entry of a map
    steps = re.findall(r"[^.\[\]]+", key)
    expected = _type_at(inspect.type_info(kind), steps)
    named = re.search(r" field `(.*)`$", said, re.DOTALL)
    if named is None:
        return key, f"expected {_described(expected)}, found {_shown(_value_at(document, steps))}"
    name = named.group(1)
    inner_key = f"{key}.{name}" if key else name
    if said.startswith("Object missing"):
        return inner_key, f"missing: add {_described(_type_at(expected, [name]))}"
    return inner_key, unknown("key", name, _keys(expected))


def _type_at(info: inspect.Type, steps: list[str]) -> inspect.Type:
    for step in steps:
        match _bare(info):
            case inspect.StructType(fields=fields):
                info = next(field.type for field in fields if field.encode_name == step)
            case inspect.VarTupleType(item_type=item):
                info = item
            case inspect.TupleType(item_types=items):
                info = items[int(step)]
    return info


def _value_at(document: Document, steps: list[str]) -> object:
    value: Any = document
    for step in steps:
        value = value[int(step)] if isinstance(value, list) else value[step]
    return value


def _required(info: inspect.Type) -> inspect.Type:
    """The type without "or None", as TOML has no null."""
    if isinstance(info, inspect.UnionType):
        return next(inner for inner in info.types if not isinstance(inner, inspect.NoneType))
    return info


def _bare(info: inspect.Type) -> inspect.Type:
    info = _required(info)
    return info.type if isinstance(info, inspect.Metadata) else info


def _described(info: inspect.Type) -> str:
    match _required(info):
        case inspect.Metadata(extra_json_schema={"description": str(description)}):
            return description
        case inspect.LiteralType(values=values):
            return "one of " + listed(f'"{value}"' for value in values)
        case inspect.StructType() as table:
            return f"a table with the keys {listed(_keys(table))}"
        case plain:
            return _WORDS[type(plain)]


def _keys(info: inspect.Type) -> list[str]:
    table = _bare(info)
    return [field.encode_name for field in table.fields] if isinstance(table, inspect.StructType) else []


def _shown(value: object) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
