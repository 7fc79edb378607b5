"""Lines of streams, longer ones than a stream keeps at once included."""

from __future__ import annotations

import asyncio

import pytest

from upwash.support.lines import lines_of


def read(data: bytes, *, limit: int = 8) -> list[bytes]:
    async def main() -> list[bytes]:
        stream = asyncio.StreamReader(limit=limit)
        stream.feed_data(data)
        stream.feed_eof()
        return [line async for line in lines_of(stream)]

    return asyncio.run(main())


@pytest.mark.parametrize(
    ("data", "lines"),
    [
        (b"", []),
        (b"one\ntwo\n", [b"one\n", b"two\n"]),
        (b"one\n\nlast", [b"one\n", b"\n", b"last"]),
    ],
)
def test_lines_come_one_by_one(data: bytes, lines: list[bytes]) -> None:
    assert read(data) == lines


@pytest.mark.parametrize("data", [b"x" * 100 + b"\nshort\n", b"x" * 100, b"a\n" + b"y" * 9 + b"\nz"])
def test_a_line_beyond_the_limit_comes_in_pieces_and_ends_nothing(data: bytes) -> None:
    assert b"".join(read(data)) == data
