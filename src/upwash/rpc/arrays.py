"""Numpy's arrays in calls, with their dtype and dimensions in the type hint, as numpy itself writes them.

Hints are `NDArray[np.float32]`, or `np.ndarray[tuple[int, Literal[3]], np.dtype[np.uint8]]` with fixed dimensions. An
array is sent as a map of `dtype` (numpy's, little-endian), `shape` and `data` (its bytes, the last index fastest). An
array that does not fit the hint is refused. Only services that use numpy need numpy.
"""

from __future__ import annotations

import functools
import math
import sys
import typing
from dataclasses import dataclass
from typing import Any, Literal

from upwash.errors import DeclarationError

_NUMBERS = "biufc"  # numpy's kinds of bool, integers, floats and complex numbers
_MOST_DIMENSIONS = 64  # numpy's own; the product of many sizes takes hours


@dataclass(frozen=True, slots=True)
class ArrayHint:
    """The type hint of an array: its dtype, and the size of each dimension, or None for any."""

    dtype: Any
    shape: tuple[int | None, ...] | None  # None: any number of dimensions

    def fits(self, shape: tuple[int, ...]) -> bool:
        """Whether the hint allows that shape."""
        return self.shape is None or (
            len(shape) == len(self.shape)
            and all(size in (None, given) for size, given in zip(self.shape, shape, strict=True))
        )


def is_array(cls: object) -> bool:
    """Whether the class is numpy's array class."""
    numpy = sys.modules.get("numpy")
    return numpy is not None and cls is numpy.ndarray


def require_arrays(hint: Any, what: str, seen: set[Any] | None = None) -> None:
    """Raises DeclarationError if an array in the type hint, or in a class within it, has no dtype."""
    seen = set() if seen is None else seen
    alias = typing.get_origin(hint) or hint
    if hasattr(alias, "__value__"):  # a type alias of Python 3.12; numpy 2.5 declares NDArray as one
        if hint not in seen:
            seen.add(hint)
            arguments = typing.get_args(hint)
            require_arrays(alias.__value__[arguments] if arguments else alias.__value__, what, seen)
        return
    if is_array(hint) or is_array(typing.get_origin(hint)):
        try:
            array_hint(hint)
        except (TypeError, ValueError) as error:
            raise DeclarationError(f"{what} cannot be sent: {error}") from error
        return
    inner = list(typing.get_args(hint))
    if isinstance(hint, type) and hint not in seen and hint.__module__ != "builtins":
        seen.add(hint)
        try:
            inner += typing.get_type_hints(hint).values()
        except (NameError, TypeError):  # `require_plain` judges this class
            return
    for part in inner:
        require_arrays(part, what, seen)


@functools.cache
def array_hint(hint: Any) -> ArrayHint:
    """The dtype and dimensions in an array's type hint; raises TypeError without a dtype of numbers."""
    import numpy as np

    shape, dtype = typing.get_args(hint) or (Any, Any)
    scalar = next(iter(typing.get_args(dtype)), Any)
    if not (isinstance(scalar, type) and issubclass(scalar, np.generic)):
        raise TypeError("an array needs its dtype in the type hint, such as NDArray[np.float32]")
    found = np.dtype(scalar)
    if found.type is not scalar or found.kind not in _NUMBERS:
        raise TypeError(
            f"an array of {scalar.__name__} has no encoding: use a dtype of numbers such as np.float32"
        )
    sizes = typing.get_args(shape)
    if not sizes or Ellipsis in sizes:
        return ArrayHint(found.newbyteorder("<"), None)
    return ArrayHint(found.newbyteorder("<"), tuple(_size(size) for size in sizes))


def _size(hint: Any) -> int | None:
    return int(typing.get_args(hint)[0]) if typing.get_origin(hint) is Literal else None


def to_wire(value: Any) -> Any:
    """A numpy array or number as plain values for a message; raises TypeError for any other type."""
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(value, numpy.ndarray):
        whole = numpy.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        return {
            "dtype": whole.dtype.str,
            "shape": list(value.shape),
            "data": memoryview(whole.reshape(-1)).cast("B") if whole.size else b"",
        }
    if numpy is not None and isinstance(value, numpy.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no encoding")


def from_wire(hint: Any, sent: Any) -> Any:
    """The array from a message's plain values, as a copy; raises ValueError if it does not fit the type hint."""
    import numpy as np

    meant = array_hint(hint)
    match sent:
        case {"dtype": str(dtype), "shape": [*sizes], "data": bytes(data)} if len(sent) == 3:
            shape = tuple(sizes)
        case _:
            raise ValueError("expected an array: a map of dtype, shape and data")
    if dtype != meant.dtype.str:
        raise ValueError(f"expected an array of {meant.dtype.name}, found dtype {dtype!r}")
    if len(shape) > _MOST_DIMENSIONS:
        raise ValueError(f"expected an array of at most {_MOST_DIMENSIONS} dimensions, found {len(shape)}")
    if not all(type(size) is int and 0 <= size <= sys.maxsize for size in shape) or not meant.fits(shape):
        raise ValueError(f"expected an array of shape {_written(meant)}, found {shape}")
    if math.prod(shape) * meant.dtype.itemsize != len(data):
        raise ValueError(f"an array of shape {shape} and {len(data)} bytes cannot be")
    return np.frombuffer(data, meant.dtype).reshape(shape).astype(meant.dtype.newbyteorder("="))


def _written(meant: ArrayHint) -> str:
    sizes = ", ".join("any" if size is None else str(size) for size in meant.shape or ())
    return f"({sizes})" if meant.shape is not None else "any"
