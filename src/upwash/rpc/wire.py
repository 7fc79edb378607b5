"""Which types can be sent, and MessagePack; any fault of received bytes raises one error.

The values of a message bound the receiver's time and memory, so their headers are counted before any is built: one
byte can mean a list, which takes a hundred bytes. Binary data and numbers are skipped, so a photo costs as much as
its few headers. A type whose values are hashed may have fewer values: a sender can choose numbers whose hashes
collide, and then the time grows with the square of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import msgspec
from msgspec import inspect as types

from upwash.errors import DeclarationError
from upwash.rpc.arrays import from_wire, is_array, require_arrays, to_wire
from upwash.support.text import printable

T = TypeVar("T")

_encoder = msgspec.msgpack.Encoder(enc_hook=to_wire)

MOST_TEXT_BYTES = 2**18  # in a message; texts below 32 bytes do not count, as their number is bounded
MOST_DEPTH = 100
_MOST_VALUES = 2**17
_MOST_OF_NUMBERS = 2**14  # where numbers are hashed
_MOST_OF_CLASSES = 2**10  # where objects are, which take longer to compare
_SEEDED = {  # types with few values, or with hashes that a sender cannot know
    *(types.StrType, types.BytesType, types.BoolType, types.NoneType, types.EnumType, types.LiteralType),
    *(types.TupleType, types.VarTupleType, types.UnionType),  # of other types, which count too
}
_NUMBERS = {
    *(types.IntType, types.FloatType, types.AnyType, types.NamedTupleType),
    *(types.DateTimeType, types.DateType, types.TimeType, types.TimeDeltaType),
}


class Encoding(Generic[T]):
    """Encodes and decodes values of one type."""

    def __init__(self, hint: type[T]) -> None:
        self.type = hint
        self._decoder = msgspec.msgpack.Decoder(hint, dec_hook=from_wire)
        parts = list(_parts(types.type_info(hint), set()))
        self._most_values = _most_values(parts)
        classes = [part.cls for part in parts if hasattr(part, "cls")]
        self._nests = len(set(classes)) < len(classes)

    def encode(self, value: object) -> bytes:
        """The value as MessagePack; raises TypeError for a type without encoding, ValueError above the bounds."""
        data = _encoder.encode(value)
        if why := self._too_much(data):
            raise ValueError(why)
        return data

    def decode(self, data: bytes) -> T:
        """The value, checked against the type; raises msgspec.MsgspecError for another type, or above the bounds.

        The error's text is escaped and cut, as it may quote what the other side sent.
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
    hashed = [part.key_type for part in parts if isinstance(part, types.DictType)]
    hashed += [part.item_type for part in parts if isinstance(part, (types.SetType, types.FrozenSetType))]
    kinds = {type(part) for found in hashed for part in _parts(found, set())}
    if kinds <= _SEEDED:
        return _MOST_VALUES
    return _MOST_OF_NUMBERS if kinds <= _SEEDED | _NUMBERS else _MOST_OF_CLASSES


def require_sendable(hint: Any, what: str) -> None:
    """Raises DeclarationError for a type whose values would not arrive as they were sent."""
    require_plain(hint, what, is_meant=is_array)
    require_arrays(hint, what)


def require_plain(hint: Any, what: str, *, is_meant: Callable[[type], bool]) -> None:
    """Raises DeclarationError for a type that has no encoding, except classes that `is_meant` accepts."""
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


# --- bounds -------------------------------------------------------------------------------------------------

_FROM_BINARY = (  # of a value's header: its bytes, and how many of them are a length; from 0xC4 on
    *((2, 1), (3, 2), (5, 4)),  # binary data
    *((3, 1), (4, 2), (6, 4)),  # extensions
    *((5, 0), (9, 0)),  # floats
    *((2, 0), (3, 0), (5, 0), (9, 0)),  # unsigned integers
    *((2, 0), (3, 0), (5, 0), (9, 0)),  # integers
    *((3, 0), (4, 0), (6, 0), (10, 0), (18, 0)),  # extensions of a fixed size
    *((2, 1), (3, 2), (5, 4)),  # texts
    *((3, 2), (5, 4)),  # lists
    *((3, 2), (5, 4)),  # maps
)
_BINARY, _TEXT, _LIST, _MAP, _NEGATIVE = 0xC4, 0xD9, 0xDC, 0xDE, 0xE0


def _layout(head: int) -> tuple[int, int, int]:
    """Of a value with that first byte: the bytes that this fixes, the bytes of its length, the values in it."""
    if 0x80 <= head < 0x90:
        return 1, 0, 2 * (head - 0x80)
    if 0x90 <= head < 0xA0:
        return 1, 0, head - 0x90
    if 0xA0 <= head < 0xC0:
        return 1 + head - 0xA0, 0, 0
    if _BINARY <= head < _NEGATIVE:
        return *_FROM_BINARY[head - _BINARY], 0
    return 1, 0, 0


_LAYOUTS = tuple(_layout(head) for head in range(256))


def too_much(message: bytes, most_values: int) -> str:
    """Which bound the message exceeds, "" for none; a message that is cut short is left to the decoder."""
    at, left, text_bytes = 0, 1, 0
    outer: list[int] = []  # how many values are left in each outer list and map
    for _ in range(most_values):
        if at >= len(message):
            return ""
        head = message[at]
        size, length_bytes, inside = _LAYOUTS[head]
        if length_bytes:
            length = int.from_bytes(message[at + 1 : at + 1 + length_bytes])
            if head >= _LIST:
                inside = 2 * length if head >= _MAP else length
            else:
                at += length
                text_bytes += length if head >= _TEXT else 0
        at += size
        left -= 1
        if inside:
            outer.append(left)
            left = inside
        if text_bytes > MOST_TEXT_BYTES:
            return f"more than {MOST_TEXT_BYTES} bytes of text in one message: send it as bytes"
        if len(outer) > MOST_DEPTH:
            return f"more than {MOST_DEPTH} lists or maps within each other"
        if left > most_values:
            break
        while not left:
            if not outer:
                return ""
            left = outer.pop()
    return f"more than {most_values} values in one message: send numbers as an array, or as bytes"
