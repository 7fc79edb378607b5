"""What modelled services answer: nothing much, or something where the photo shows an event."""

from __future__ import annotations

import functools
from typing import Any

import msgspec
from msgspec import inspect as types

from upwash.rpc.arrays import array_hint
from upwash.rpc.service import Method
from upwash.rpc.wire import Encoding

EVENT = b"an event that the scenario put here"


def reply_to(method: Method, request: bytes) -> bytes:
    """A reply with the emptiest value of the method's result type, or a fuller one where the photo shows an event."""
    return _reply(method.reply, EVENT in request)


@functools.cache
def _reply(encoding: Encoding[Any], has_event: bool) -> bytes:
    reply = types.type_info(encoding.type)
    assert isinstance(reply, types.StructType)  # noqa: S101 - made by service.py
    value = next(field.type for field in reply.fields if field.name == "value")
    plain = {"value": _filled(value) if has_event else _empty(value)}
    return encoding.encode(msgspec.convert(plain, encoding.type, dec_hook=_smallest))


def _smallest(hint: Any, _: object) -> Any:
    """The smallest array that fits the type hint, which msgspec does not look into."""
    import numpy as np

    meant = array_hint(hint)
    return np.zeros([size or 0 for size in meant.shape or (None,)], meant.dtype)


def _filled(found: types.Type) -> Any:
    """A value that is true, as Python has it, where the type has any."""
    match found:
        case (
            types.ListType(item) | types.VarTupleType(item) | types.SetType(item) | types.FrozenSetType(item)
        ):
            return [_empty(item)]
        case types.DictType(key, value):
            return {_empty(key): _empty(value)}
        case types.BoolType():
            return True
        case types.IntType() | types.FloatType():
            return 1
        case types.StrType():
            return "event"
        case types.BytesType() | types.ByteArrayType() | types.MemoryViewType():
            return EVENT
        case types.UnionType(options):
            return _filled(
                next((each for each in options if not isinstance(each, types.NoneType)), options[0])
            )
    return _empty(found)


def _empty(found: types.Type) -> Any:
    match found:
        case types.NoneType():
            return None
        case types.ListType() | types.VarTupleType() | types.SetType() | types.FrozenSetType():
            return []
        case types.DictType() | types.CustomType():  # which is an array
            return {}
        case types.BoolType():
            return False
        case types.IntType() | types.FloatType():
            return 0
        case types.StrType():
            return ""
        case types.BytesType() | types.ByteArrayType() | types.MemoryViewType():
            return b""
        case types.UnionType(options):
            return None if any(isinstance(each, types.NoneType) for each in options) else _empty(options[0])
        case types.EnumType(cls):
            return next(iter(cls)).value
        case types.LiteralType(values):
            return values[0]
        case types.TupleType(items):
            return [_empty(item) for item in items]
        case types.StructType() | types.DataclassType() | types.TypedDictType() | types.NamedTupleType():
            return {field.encode_name: _empty(field.type) for field in found.fields if field.required}
    raise TypeError(f"no empty value of {found}")
