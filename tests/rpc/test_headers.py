"""What a message holds, counted by its headers: as much as is built, and nothing for what is skipped."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.rpc.wire import MOST_DEPTH, MOST_TEXT_BYTES, too_much

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
    ],
    ids=lambda value: f"{type(value).__name__} {len(str(value))}",
)
def test_every_format_of_messagepack_is_passed_over(value: object) -> None:
    message = msgspec.msgpack.encode([value, "last"])
    assert too_much(message, 2 + values_in(value)) == ""
    assert "more than" in too_much(message, 1 + values_in(value))


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
