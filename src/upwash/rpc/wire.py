"""What can be sent: which types, and MessagePack where everything wrong with foreign bytes is one error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec
from msgspec import inspect as types

from upwash.errors import DeclarationError
from upwash.support.text import printable

T = TypeVar("T")


def decode(data: bytes, decoder: msgspec.msgpack.Decoder[T]) -> T:
    """The value, checked against the decoder's type; raises msgspec.MsgspecError for anything else.

    What the error says can be shown: it may quote a name or a value of the other side's.
    """
    try:
        return decoder.decode(data)
    except msgspec.MsgspecError as error:
        raise type(error)(printable(str(error))) from error
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(f"text that is not UTF-8: {error}") from error
    except RecursionError as error:
        raise msgspec.DecodeError("nested too deeply") from error


def require_sendable(hint: Any, what: str, *, besides: tuple[type, ...] = ()) -> None:
    """Raises DeclarationError for a type, other than `besides`, that would not arrive as it was sent."""
    try:
        found = types.type_info(hint)
    except TypeError as error:
        raise DeclarationError(f"{what} cannot be sent: {error}") from error
    for part in _parts(found, set()):
        if isinstance(part, types.AnyType):
            raise DeclarationError(f"{what} cannot be sent as {hint}: say which types it may have")
        if isinstance(part, types.CustomType) and part.cls in besides:
            continue
        if isinstance(part, (types.CustomType, types.RawType, types.ExtType)):
            raise DeclarationError(
                f"{what} cannot be sent: {getattr(part, 'cls', hint)} has no encoding; use dataclasses, msgspec "
                "structs, enums, lists, dicts, numbers, strings, bytes or None"
            )


def _parts(found: types.Type, seen: set[type]) -> Iterator[types.Type]:
    """The type and every type within it, recursive classes once."""
    yield found
    cls = getattr(found, "cls", None)
    if cls is not None:
        if cls in seen:
            return
        seen.add(cls)
    inner = [
        *getattr(found, "types", ()),
        *getattr(found, "item_types", ()),
        *(field.type for field in getattr(found, "fields", ())),
    ]
    inner += [
        getattr(found, name) for name in ("item_type", "key_type", "value_type") if hasattr(found, name)
    ]
    for part in inner:
        yield from _parts(part, seen)
