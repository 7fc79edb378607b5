"""Put msgspec's errors into words: which key, what was expected there, what was found.

An error names a path such as `$.server[0].range_m`. The types tell what was expected and the document what was found,
so that every message has the same shape.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec import ValidationError, inspect

from upwash.config.problems import Problem, listed, unknown
from upwash.support.camera_source import shown_source

_WORDS = {
    inspect.BoolType: "true or false",
    inspect.FloatType: "a number",
    inspect.IntType: "an integer",
    inspect.StrType: "a string",
    inspect.ListType: "an array",
    inspect.VarTupleType: "an array",
    inspect.TupleType: "an array",
    inspect.SetType: "an array",
    inspect.DictType: "a table",
}
_LONGEST_SHOWN = 60


def explained(error: ValidationError, document: Mapping[str, object], kind: type) -> Problem:
    """The key that an error of msgspec names, and what to change there."""
    message = str(error)
    said, _, path = message.rpartition(" - at `$") if " - at `$" in message else (message, "", "")
    key = path.removesuffix("`").removeprefix(".").replace("[...]", "")  # [...] is an entry of a map
    steps = re.findall(r"[^.\[\]]+", key)
    expected = _type_at(inspect.type_info(kind), steps)
    if isinstance(error.__cause__, ValueError) and str(error.__cause__):
        return key, str(error.__cause__)  # a table that was checked by its own class
    named = re.search(r" field `(.*)`$", said, re.DOTALL)
    if named is None:
        problem = f"expected {_described(expected)}, found {shown_source(_shown(_value_at(document, steps)))}"
        return key, problem
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
            case inspect.ListType(item_type=item) | inspect.SetType(item_type=item):
                info = item
            case inspect.DataclassType(fields=fields):
                info = next(field.type for field in fields if field.encode_name == step)
    return info


def _value_at(document: Mapping[str, object], steps: list[str]) -> object:
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
        case inspect.EnumType(cls=cls):
            return "one of " + listed(json.dumps(member.value) for member in cls)
        case inspect.StructType() | inspect.DataclassType() as table:
            return f"a table with the keys {listed(_keys(table))}"
        case inspect.CustomType(cls=cls) if cls is Path:
            return "a file's path, absolute or from this file's folder"
        case plain:
            return _WORDS.get(type(plain), "another kind of value")


def _keys(info: inspect.Type) -> list[str]:
    table = _bare(info)
    if not isinstance(table, inspect.StructType | inspect.DataclassType):
        return []
    return [field.encode_name for field in table.fields]


def _shown(value: object) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
