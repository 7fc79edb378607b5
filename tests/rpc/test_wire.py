"""Messages whose bytes would cost far more than their number: each is refused before it is built."""

from __future__ import annotations

import enum
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from typing import Any, Literal, NamedTuple
from uuid import UUID

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.waiting import million_steps_s

from upwash.errors import DeclarationError, GarbledReply
from upwash.rpc.service import make_stub, service, spec_of
from upwash.rpc.wire import MOST_DEPTH, MOST_TEXT_BYTES, Encoding, too_much

MOST_MILLIONS = 55  # of steps; what used to take hundreds to billions takes five
MOST_BYTES = 40e6
MEGABYTES_16 = 16_000_000
Decodes = Callable[[], object]


class Branch(msgspec.Struct):
    inner: list[Branch] = []


@dataclass(frozen=True)
class Cell:
    row: int


class Step(NamedTuple):
    row: int


class Colour(enum.Enum):
    RED = "red"


@dataclass
class Checked:
    value: int

    def __post_init__(self) -> None:
        raise KeyError("a class of the service's own")


def listed(values: int, value: bytes) -> bytes:
    """A list of one value, many times over."""
    return b"\xdd" + values.to_bytes(4) + value * values


def array(shape: list[int], data: bytes = bytes(4)) -> bytes:
    return msgspec.msgpack.encode({"dtype": "<f4", "shape": shape, "data": data})


def same_hash(values: int) -> list[str]:
    """Identifiers that all have one hash."""
    return [str(UUID(int=1 + number * (2**61 - 1))) for number in range(values)]


def colliding(values: int) -> list[int]:
    """Numbers of which each is looked for in the places of all before it."""
    bits = values.bit_length()
    chain = [0]
    while len(chain) < values:
        chain.append((5 * chain[-1] + 1) % 2**bits)
    return chain


BOMBS: dict[str, tuple[Any, Callable[[], bytes]]] = {  # made by the test that sends it: some have 16 MB
    "an array of many dimensions": (NDArray[np.float32], lambda: array([2**63 - 1] * 1_000_000)),
    "an array of 65 dimensions": (NDArray[np.float32], lambda: array([1] * 65)),
    "an array without a shape": (NDArray[np.float32], lambda: array([])[:-10] + b"\xa5shape\xa0"),
    "arrays of nothing": (list[NDArray[np.float32]], lambda: listed(MEGABYTES_16, b"\x80")),
    "lists in a list": (list[list[int]], lambda: listed(MEGABYTES_16, b"\x90")),
    "lists of lists": (list[list[list[int]]], lambda: listed(MEGABYTES_16 // 16, b"\x9f" + b"\x90" * 15)),
    "structs of defaults": (list[Branch], lambda: listed(MEGABYTES_16, b"\x80")),
    "numbers": (list[float], lambda: listed(MEGABYTES_16, b"\x00")),
    "texts": (list[str], lambda: listed(MEGABYTES_16, b"\xa0")),
    "a text": (str, lambda: msgspec.msgpack.encode("\x01" * MEGABYTES_16)),
    "a text of wide letters": (str, lambda: msgspec.msgpack.encode("\U0001f6f8" + "x" * MEGABYTES_16)),
    "a map by number": (dict[int, None], lambda: msgspec.msgpack.encode(dict.fromkeys(colliding(20_000)))),
    "a set of identifiers": (set[UUID], lambda: msgspec.msgpack.encode(same_hash(3000))),
    "a set of objects": (
        frozenset[Cell],
        lambda: msgspec.msgpack.encode([{"row": row} for row in range(1000)]),
    ),
    "a recursive struct": (Branch, lambda: b"\x81\xa5inner\x91" * 101 + b"\x80"),
    "more dimensions than a list may say": (list[int], lambda: b"\xdd\xff\xff\xff\xff"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_message_that_costs_more_than_its_bytes_is_refused_at_once(name: str) -> None:
    hint, made = BOMBS[name]
    message = made()
    encoding: Encoding[Any] = Encoding(hint)
    tracemalloc.start()
    began_s = time.process_time()
    with pytest.raises(msgspec.MsgspecError) as refused:
        encoding.decode(message)
    took_s = time.process_time() - began_s
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert took_s < MOST_MILLIONS * million_steps_s()
    assert peak_bytes < MOST_BYTES
    assert len(str(refused.value)) <= 1000


@pytest.mark.parametrize(
    ("hint", "value"),
    [
        (bytes, bytes(MEGABYTES_16)),
        (list[float], [0.5] * 100_000),
        (dict[str, list[int]], {str(number): [number] * 30 for number in range(4000)}),
        (dict[int, str], dict.fromkeys(range(8000), "x")),
        (str, "x" * 200_000),
        (Branch, Branch([Branch()] * 9)),
        (
            dict[tuple[str, bytes, bool | None, Colour, Literal[1], tuple[str, ...]], None],
            {(str(number), b"", None, Colour.RED, 1, ("",)): None for number in range(2000)},
        ),
    ],
    ids=["bytes", "numbers", "by name", "by number", "text", "recursive", "by few values"],
)
def test_what_a_service_has_to_say_arrives(hint: Any, value: object) -> None:
    encoding: Encoding[Any] = Encoding(hint)
    assert encoding.decode(encoding.encode(value)) == value


@pytest.mark.parametrize(
    ("hint", "value", "most"),
    [
        (dict[str, None], dict.fromkeys(map(str, range(2**16))), 2**17),
        (dict[int, None], dict.fromkeys(range(2**13)), 2**14),
        (frozenset[Cell], [{"row": row} for row in range(2**9)], 2**10),
    ],
)
def test_a_type_whose_values_are_hashed_has_fewer(hint: Any, value: object, most: int) -> None:
    with pytest.raises(msgspec.DecodeError, match=f"more than {most} values in one message"):
        Encoding(hint).decode(msgspec.msgpack.encode(value))


def test_an_array_as_large_as_a_message_arrives() -> None:
    encoding: Encoding[Any] = Encoding(NDArray[np.float32])
    sent = np.ones((1000, 4000), np.float32)
    assert np.array_equal(encoding.decode(encoding.encode(sent)), sent)


def test_a_class_that_raises_anything_makes_a_message_undecodable() -> None:
    with pytest.raises(msgspec.DecodeError, match="a value cannot be made: KeyError"):
        Encoding(Checked).decode(b"\x81\xa5value\x01")


@service
class Counts:
    def double(self, numbers: list[int]) -> list[int]:
        return numbers * 2

    def fail(self) -> None:
        raise ValueError("x" * 1_000_000)


def counts() -> Counts:
    methods = spec_of(Counts).methods
    return make_stub(
        Counts,
        lambda operation, method, request, _: method.decode(
            methods[operation.method].perform(Counts(), request)[1]
        ),
    )


def test_arguments_and_results_that_are_too_much_raise_where_they_are_sent() -> None:
    assert len(counts().double([1] * 50_000)) == 100_000
    for size in 100_000, 200_000:  # the result is too much, the argument is
        with pytest.raises(
            ValueError, match="more than 131072 values in one message: send numbers as an array"
        ):
            counts().double([1] * size)


def test_an_exception_with_a_long_message_arrives_cut() -> None:
    with pytest.raises(ValueError, match=r"^x{10000}$"):
        counts().fail()


def test_an_argument_that_is_too_much_is_named_to_the_caller() -> None:
    method = spec_of(Counts).methods["double"]
    _, reply = method.perform(Counts(), b"\x81\xa7numbers" + listed(1_000_000, b"\x01"))
    with pytest.raises(TypeError, match=r"double\(\): more than 131072 values"):
        method.result(method.decode(reply))


def test_a_reply_that_is_too_much_is_a_garbled_reply() -> None:
    method = spec_of(Counts).methods["double"]
    with pytest.raises(GarbledReply, match=r"counts\.double\(\).*more than 131072 values"):
        method.decode(b"\x81\xa5value" + listed(1_000_000, b"\x01"))


def test_decimals_cannot_be_sent_as_one_of_them_may_have_any_number_of_digits() -> None:
    def add(self: object, amounts: list[Decimal]) -> None: ...

    add.__annotations__ = {"amounts": list[Decimal], "return": None}
    with pytest.raises(DeclarationError, match="'amounts' cannot be sent: Decimal has no bound; use float"):
        service(type("Till", (), {"add": add}))


# --- headers ------------------------------------------------------------------------------------------------

ENOUGH = 10**6
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.binary(max_size=300)
    | st.text(max_size=300)
    | st.builds(msgspec.msgpack.Ext, st.integers(0, 127), st.binary(max_size=20))
    | st.datetimes().map(lambda found: found.replace(tzinfo=UTC))
)
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=40) | st.dictionaries(st.text(), inner, max_size=20)
)


def values_in(value: object) -> int:
    """How many values there are, the value itself included."""
    match value:
        case list():
            return 1 + sum(map(values_in, value))
        case dict():
            return 1 + sum(1 + values_in(each) for each in value.values())
    return 1


@given(VALUES)
def test_the_values_of_a_message_are_counted_exactly(value: Any) -> None:
    message = msgspec.msgpack.encode(value)
    assert too_much(message, values_in(value)) == ""
    if values_in(value) > 1:
        assert "more than" in too_much(message, values_in(value) - 1)


@pytest.mark.parametrize(
    "value",
    [
        *(b"x" * size for size in (0, 255, 256, 2**16)),
        *("x" * size for size in (0, 31, 32, 255, 256, 2**16)),
        *(msgspec.msgpack.Ext(5, b"x" * size) for size in (0, 1, 2, 3, 4, 8, 16, 17, 256, 2**16)),
        *([0] * size for size in (15, 16, 2**16)),
        *(dict.fromkeys(range(size)) for size in (15, 16, 2**16)),
        *(sign * 2**bits for bits in (0, 7, 8, 16, 32, 63) for sign in (1, -1)),
        datetime(2500, 1, 1, microsecond=1, tzinfo=UTC),
        1.5,
        msgspec.Raw(b"\xca\x01\x01\x01\x01"),  # a float of 32 bits, as programs in other languages send it
    ],
    ids=lambda value: f"{type(value).__name__} {len(str(value))}",
)
def test_every_format_of_messagepack_is_passed_over(value: object) -> None:
    message = msgspec.msgpack.encode([value, [["last"]]])  # read from a byte too far on, it has fewer values
    assert too_much(message, 4 + values_in(value)) == ""
    assert "more than" in too_much(message, 3 + values_in(value))


def test_binary_data_counts_as_one_value_and_texts_by_their_bytes() -> None:
    assert too_much(msgspec.msgpack.encode(bytes(10**7)), 1) == ""
    assert too_much(msgspec.msgpack.encode("x" * MOST_TEXT_BYTES), 1) == ""
    assert "bytes of text" in too_much(msgspec.msgpack.encode(["x" * MOST_TEXT_BYTES, "y" * 32]), ENOUGH)


def test_depth_is_bounded() -> None:
    assert too_much(b"\x91" * MOST_DEPTH + b"\xc0", ENOUGH) == ""
    assert "within each other" in too_much(b"\x91" * (MOST_DEPTH + 1) + b"\xc0", ENOUGH)


@pytest.mark.parametrize("head", [b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff"])
def test_a_header_alone_tells_that_it_is_too_much(head: bytes) -> None:
    assert "more than" in too_much(head, ENOUGH)


@given(st.binary())
def test_whatever_arrives_is_counted(message: bytes) -> None:
    assert isinstance(too_much(message, 1000), str)
