"""Writes docs/configuration-reference.md from the types of src/upwash/config: `python site/configuration.py`.

What a key means stands below its field, as a docstring; its type's description says what it may be.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
from msgspec import inspect as types

from upwash.config.daemon import DaemonConfig
from upwash.config.drone import DroneConfig

PAGE = Path(__file__).parents[1] / "docs" / "configuration-reference.md"

_HEAD = """\
# Every key of the configurations

<!-- written by site/configuration.py from the types of src/upwash/config: change those, then run `make docs` -->

Two TOML files: [the drone's](#the-drone), which is a scenario too, and [an edge daemon's](#the-edge-daemon). Examples
are on the pages [configuration](configuration.md) and [edge servers](servers.md). A key without a default may be left
out unless it is needed. Unknown keys and values that cannot be are refused with their place in the file. Paths are
relative to the file.

A name's ending is its unit: `_s` seconds, `_m` metres, `_m_s` metres per second, `_deg` degrees, `_w` watts, `_wh`
watt-hours, `_c` °C, `_bit_s` bits per second.
"""
_PARTS = (
    ("The drone", DroneConfig, "`upwash fly`, `check` and `simulate` read it."),
    ("The edge daemon", DaemonConfig, "`upwash serve` reads it."),
)
_ANY_TEXT = "a string that is not empty, without control characters"
_SIMPLE = {
    types.StrType: "text",
    types.IntType: "an integer",
    types.FloatType: "a number",
    types.BoolType: "true or false",
}


def page() -> str:
    """The page as it should be."""
    lines = [_HEAD]
    for title, config, read in _PARTS:
        anchor = title.lower().replace(" ", "-")
        lines += [f"## {title}", "", read, "", *_table(config, at="", anchor=anchor)]
    return "\n".join(lines).rstrip() + "\n"


def _table(config: type[msgspec.Struct], *, at: str, anchor: str) -> Iterator[str]:
    """The keys of a table, then the tables in it."""
    said = meanings(config)
    plain, tables = [], []
    for field in msgspec.structs.fields(config):
        inner, several = _struct(field.type)
        # A table whose own field has a docstring is written in one line of its parent's; both are listed.
        if inner is not None:
            tables.append((field, inner, several))
        if inner is None or said.get(field.name):
            plain.append(field)
    if plain:
        yield "| key | value | default | meaning |"
        yield "|---|---|---|---|"
        for field in plain:
            name = f"{at}{field.encode_name}"
            identity = re.sub(r"[^a-z0-9]+", "-", f"{anchor}-{name}".lower())
            key = f'<span id="{identity}"></span>`{field.encode_name}`'
            meaning = _cell(said.get(field.name, ""))
            yield f"| {key} | {_cell(_kind(field.type))} | {_default(field)} | {meaning} |"
        yield ""
    for field, inner, several in tables:
        name = f"{at}{field.encode_name}"
        written = f"[[{name}]]" if several else f"[{name}]"
        yield from (f"### `{written}` of {anchor.replace('-', ' ')}", "", _first(inner), "")
        yield from _table(inner, at=f"{name}.", anchor=anchor)


@cache
def meanings(config: type[msgspec.Struct]) -> dict[str, str]:
    """What each field of the type and of those that it extends means, by the docstrings below them."""
    said: dict[str, str] = {}
    for each in reversed(config.__mro__):
        if issubclass(each, msgspec.Struct) and each is not msgspec.Struct:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
            body = tree.body if isinstance(tree, ast.ClassDef) else []
            for field, below in itertools.pairwise(body):
                match field, below:
                    case (
                        ast.AnnAssign(target=ast.Name(id=name)),
                        ast.Expr(value=ast.Constant(value=str(text))),
                    ):
                        said[name] = " ".join(text.split())
    return said


def _struct(hint: Any) -> tuple[type[msgspec.Struct] | None, bool]:
    """The table that a field holds, if it holds one, and whether it may hold several."""
    for part in _alternatives(types.type_info(hint)):
        match part:
            case types.StructType(cls=cls):
                return cls, False
            case types.VarTupleType(item_type=types.StructType(cls=cls)):
                return cls, True
    return None, False


def _alternatives(found: types.Type) -> tuple[types.Type, ...]:
    match found:
        case types.Metadata(type=inner):
            return _alternatives(inner)
        case types.UnionType(types=parts):
            return tuple(alternative for part in parts for alternative in _alternatives(part))
    return (found,)


def _kind(hint: Any) -> str:
    """What may stand there, as refusals say it."""
    found = types.type_info(hint)
    if said := _description(found):
        return "text" if said == _ANY_TEXT else said
    return " or ".join(dict.fromkeys(filter(None, map(_of_type, _parts(found)))))


def _parts(found: types.Type) -> tuple[types.Type, ...]:
    return found.types if isinstance(found, types.UnionType) else (found,)


def _description(found: types.Type) -> str:
    match found:
        case types.Metadata(extra_json_schema=extra) if extra and "description" in extra:
            return str(extra["description"])
        case types.Metadata(type=inner):
            return _description(inner)
    return ""


def _of_type(found: types.Type) -> str:
    if said := _description(found):
        return "text" if said == _ANY_TEXT else said
    match found:
        case types.Metadata(type=inner):
            return _of_type(inner)
        case types.LiteralType(values=values):
            return ", ".join(f"`{value}`" for value in values)
        case types.StructType():
            return "a table"
        case types.NoneType():
            return ""
        case types.CustomType():
            return "a path"
    return _SIMPLE[type(found)]


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "needed"
    match field.default:
        case None | () | msgspec.NODEFAULT | msgspec.Struct():  # an empty table, or one of defaults
            return ""
        case bool(value):
            return f"`{str(value).lower()}`"
        case int(value):
            return f"`{value:_}`"
        case float(value):
            return f"`{value:g}`"
        case tuple(values):
            return "`[" + ", ".join(f'"{value}"' for value in values) + "]`"
        case value:
            return f"`{value}`"


def _first(config: type[msgspec.Struct]) -> str:
    return " ".join((config.__doc__ or "").split("\n\n")[0].split())


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE.name}\n")
