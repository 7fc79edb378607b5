"""What can be sent: which types, and MessagePack where everything wrong with foreign bytes is one error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import msgspec
from msgspec import inspect as types

from upwash.errors import DeclarationError
from upwash.rpc.arrays import from_wire, is_array, require_arrays, to_wire
from upwash.support.text import printable

T = TypeVar("T")


_encoder = msgspec.msgpack.Encoder(enc_hook=to_wire)


def encode(value: object) -> bytes:
    """The value as MessagePack; raises TypeError for what has no encoding."""
    return _encoder.encode(value)


def decoder(hint: type[T]) -> msgspec.msgpack.Decoder[T]:
    """What decodes values of that type."""
    return msgspec.msgpack.Decoder(hint, dec_hook=from_wire)


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


def require_sendable(hint: Any, what: str) -> None:
    """Raises DeclarationError for a type that would not arrive as it was sent."""
    require_plain(hint, what, is_meant=is_array)
    require_arrays(hint, what)


def require_plain(hint: Any, what: str, *, is_meant: Callable[[type], bool]) -> None:
    """Raises DeclarationError for a type that has no encoding and is not meant to have any of these."""
    try:
        found = types.type_info(hint)
    except TypeError as error:
        raise DeclarationError(f"{what} cannot be sent: {error}") from error
    for part in _parts(found, set()):
        if isinstance(part, types.AnyType):
            raise DeclarationError(f"{what} cannot be sent as {hint}: say which types it may have")
        if isinstance(part, types.CustomType) and is_meant(part.cls):
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
