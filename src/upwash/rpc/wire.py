"""What can be sent: which types, and MessagePack where everything wrong with foreign bytes is one error.

The values of a message bound the receiver's time and memory: `rpc/headers.py` counts them before any is built. A type
whose values are hashed may have fewer: a sender can choose numbers whose hashes collide, and then the time grows with
the square of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import msgspec
from msgspec import inspect as types

from upwash.errors import DeclarationError
from upwash.rpc.arrays import from_wire, is_array, require_arrays, to_wire
from upwash.rpc.headers import too_much
from upwash.support.text import printable

T = TypeVar("T")


_encoder = msgspec.msgpack.Encoder(enc_hook=to_wire)

_MOST_VALUES = 2**17
_MOST_OF_NUMBERS = 2**14  # where numbers are hashed
_MOST_OF_CLASSES = 2**10  # where objects are, which take longer to compare
_SEEDED = {  # types with few values, or with hashes that nobody else can know
    *(types.StrType, types.BytesType, types.BoolType, types.NoneType, types.EnumType, types.LiteralType),
    *(types.TupleType, types.VarTupleType, types.UnionType),  # of other types, which count too
}
_NUMBERS = {
    *(types.IntType, types.FloatType, types.AnyType, types.NamedTupleType),
    *(types.DateTimeType, types.DateType, types.TimeType, types.TimeDeltaType),
}


class Encoding(Generic[T]):
    """How values of one type travel."""

    def __init__(self, hint: type[T]) -> None:
        self.type = hint
        self._decoder = msgspec.msgpack.Decoder(hint, dec_hook=from_wire)
        parts = list(_parts(types.type_info(hint), set()))
        self._most_values = _most_values(parts)
        classes = [part.cls for part in parts if hasattr(part, "cls")]
        self._nests = len(set(classes)) < len(classes)

    def encode(self, value: object) -> bytes:
        """The value as MessagePack; raises TypeError for what has no encoding, ValueError for what is too much."""
        data = _encoder.encode(value)
        if why := self._too_much(data):
            raise ValueError(why)
        return data

    def decode(self, data: bytes) -> T:
        """The value, checked against the type; raises msgspec.MsgspecError for one of another type, or too much.

        The error's text is escaped and cut, as it may quote a name or a value of the other side's.
        """
        if why := self._too_much(data):
            raise msgspec.DecodeError(why)
        try:
            return self._decoder.decode(data)
        except msgspec.MsgspecError as error:
            raise type(error)(printable(str(error))) from error
        except UnicodeDecodeError as error:
            raise msgspec.DecodeError(f"text that is not UTF-8: {error}") from error
        except RecursionError as error:
            raise msgspec.DecodeError("nested too deeply") from error
        except Exception as error:  # a value's own class can raise any
            raise msgspec.DecodeError(f"a value cannot be made: {type(error).__name__}") from error

    def _too_much(self, data: bytes) -> str:
        is_small = len(data) <= self._most_values and not self._nests  # each value has a byte
        return "" if is_small else too_much(data, self._most_values)


def _most_values(parts: list[types.Type]) -> int:
    """How many values a message of a type with these parts may have."""
    hashed = [part.key_type for part in parts if isinstance(part, types.DictType)]
    hashed += [part.item_type for part in parts if isinstance(part, (types.SetType, types.FrozenSetType))]
    kinds = {type(part) for each in hashed for part in _parts(each, set())}
    if kinds <= _SEEDED:
        return _MOST_VALUES
    return _MOST_OF_NUMBERS if kinds <= _SEEDED | _NUMBERS else _MOST_OF_CLASSES


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
        if isinstance(part, types.DecimalType):  # int(Decimal('1e999999999')) has a billion digits
            raise DeclarationError(f"{what} cannot be sent: Decimal has no bound; use float, int or str")


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
