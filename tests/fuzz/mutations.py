"""Inputs that are nearly understood: valid ones with changes that know the structure of the format.

The structure is found in the bytes: JSON (whole, or line by line), MessagePack, lines and words of text, segments of
a JPEG. All else is bytes with numbers.
"""

from __future__ import annotations

import copy
import functools
import itertools
import json
import random
import re
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from upwash.support.jpeg import segments_of

LONGEST_BYTES = 1_000_000
_REPEATED_BYTES = 200_000  # few decoders need more to show that they are quadratic
_DEEP = 3_000
_EDGES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)
_WORDS = (
    *(b"", *b"0 -1 1e999 -0.0 nan inf".split(), b"9" * 25, b"9" * 400, b"9" * 5000, b"1e-320", b"0x10"),
    *(*b'null true "" [] {}'.split(), b"x" * 5000, b"\0", b"\x1b[2J", "\u202e\ud7ff".encode(), b"\xff\xfe"),
    *(*b"../../x * %s a.b [[ [ { \" ' # = ,".split(), b"\n", b"\r\n", b"\t"),
)
_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 2**31, 2**53 + 1, 2**63 - 1, 2**64 - 1, 10**30, 10**400, 1e308, 5e-324, -0.0),
    *(float("nan"), float("inf"), "", "x", "x" * 5000, "\0", "\x1b[2J", "\u202e", "0", "1e999"),
    *([], {}, [[]], {"": {}}),
)
_NUMBER = re.compile(rb"[-+]?[0-9][0-9.eE_+-]*")
_WORD = re.compile(rb"[\w.+-]+")

Way = Callable[[random.Random, bytes, Sequence[bytes]], bytes]


def mutated(chance: random.Random, valid: Sequence[bytes]) -> bytes:
    """One of the valid inputs after one to six changes, at most LONGEST_BYTES long."""
    data = chance.choice(valid)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        data = chance.choice(_ways(data))(chance, data, valid)[:LONGEST_BYTES]
    return data


@functools.lru_cache(1024)
def _ways(data: bytes) -> tuple[Way, ...]:
    """The changes that the input has the structure for; those of its own structure are the most likely."""
    ways: list[Way] = [_flip, _cut, _remove, _splice, _repeat, _edge]
    if _json_parts(data):
        ways += 2 * [_json] + [_deep_json]
    elif _packed(data) is not None:
        ways += 4 * [_msgpack]
    if data.startswith(b"\xff\xd8"):
        ways += 4 * [_segments]
    elif data.isascii() or _is_text(data):
        ways += [_word, _number, _lines, _lines, _repeat_lines]
    return tuple(ways)


# --- bytes ------------------------------------------------------------------------------------------------------


def _span(chance: random.Random, data: bytes) -> tuple[int, int]:
    start = chance.randint(0, len(data))
    return start, min(len(data), start + chance.choice((1, 2, 4, 8, 64, 1024)))


def _flip(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    changed = bytearray(data)
    for _bit in range(chance.choice((1, 1, 4)) if data else 0):
        changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _cut(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    return data[: chance.randint(0, len(data))]


def _remove(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    start, end = _span(chance, data)
    return data[:start] + data[end:]


def _splice(chance: random.Random, data: bytes, valid: Sequence[bytes]) -> bytes:
    start, end = _span(chance, data)
    other = chance.choice(valid)
    from_, to = _span(chance, other)
    return data[:start] + other[from_:to] + data[chance.choice((start, end)) :]


def _repeat(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    start, end = _span(chance, data)
    times = min(chance.choice((2, 10, 100, 100_000)), _REPEATED_BYTES // max(1, end - start))
    return data[:start] + data[start:end] * times + data[end:]


def _edge(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """A number at the edge of what its bytes hold: as a length, a count, an offset."""
    size = chance.choice((1, 2, 4, 8))
    number = chance.choice(_EDGES) & ((1 << 8 * size) - 1)
    start = chance.randint(0, len(data))
    encoded = number.to_bytes(size)
    return data[:start] + chance.choice((encoded, encoded[::-1])) + data[start + size :]


# --- text -------------------------------------------------------------------------------------------------------


def _is_text(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def _in_place_of(pattern: re.Pattern[bytes], chance: random.Random, data: bytes) -> bytes:
    found = list(pattern.finditer(data[:20_000]))
    if not found:
        return data
    start, end = chance.choice(found).span()
    another = chance.choice(found).group() if chance.random() < 0.3 else chance.choice(_WORDS)
    return data[:start] + another + data[end:]


def _word(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    return _in_place_of(_WORD, chance, data)


def _number(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    return _in_place_of(_NUMBER, chance, data)


def _lines(chance: random.Random, data: bytes, valid: Sequence[bytes]) -> bytes:
    """A line removed, doubled, moved, or another's."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    line = lines[chance.randrange(len(lines))]
    match chance.randrange(4):
        case 0:
            lines.remove(line)
        case 1:
            lines.insert(chance.randrange(len(lines)), line)
        case 2:
            lines.remove(line)
            lines.insert(chance.randint(0, len(lines)), line)
        case _:
            lines.insert(
                chance.randrange(len(lines)), chance.choice(chance.choice(valid).splitlines(True) or [b""])
            )
    return b"".join(lines)


def _repeat_lines(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """Some lines again and again, each time with other numbers: names that are told apart."""
    lines = data.splitlines(keepends=True)
    start = chance.randint(0, len(lines))
    block = b"".join(lines[start : start + chance.choice((1, 2, 5, 20))])
    times = min(chance.choice((3, 30, 3000)), _REPEATED_BYTES // max(1, len(block)))
    again = (re.sub(rb"(?<=[a-z])\d+\b", b"%d" % number, block) for number in range(times))
    return b"".join(lines[:start]) + b"".join(again) + b"".join(lines[start:])


# --- trees ------------------------------------------------------------------------------------------------------


@functools.lru_cache(256)
def _json_parts(data: bytes) -> tuple[tuple[int, int], ...]:
    """Where JSON stands: the whole, or up to 200 of the lines."""
    if data.lstrip()[:1] not in (b"{", b"["):
        return ()
    spans, at = [(0, len(data))], 0
    for line in data.splitlines(keepends=True)[:200]:
        spans.append((at, at + len(line)))
        at += len(line)
    return tuple(span for span in spans if _json_of(data[slice(*span)]) is not None)


def _json_of(text: bytes) -> Any:
    return _tree(json.loads, text)


def _packed(data: bytes) -> Any:
    return _tree(msgspec.msgpack.decode, data)


def _tree(decode: Callable[[bytes], Any], data: bytes) -> Any:
    """What the bytes hold, where that has parts."""
    try:
        found = decode(data)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict | list) else None


def _json(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    parts = _json_parts(data)
    if not parts:
        return data
    start, end = chance.choice(parts)
    end_of_line = b"\n" if data[start:end].endswith(b"\n") else b""
    try:
        written = json.dumps(_changed(chance, _json_of(data[start:end])), ensure_ascii=chance.random() < 0.5)
    except (ValueError, RecursionError):
        return data
    return data[:start] + written.encode(errors="surrogatepass") + end_of_line + data[end:]


def _deep_json(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """One value nested without end."""
    opening, closing = chance.choice(((b"[", b"]"), (b'{"a":', b"}"), (b'{"type":', b"}")))
    depth = chance.choice((13, 100, 1000, _DEEP, 50_000))
    found = list(re.finditer(rb"(?<=[:\[,])\s*[-\w\".]+", data[:20_000]))
    start, end = chance.choice(found).span() if found else (0, len(data))
    return data[:start] + opening * depth + b"1" + closing * depth + data[end:]


def _msgpack(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    if chance.random() < 0.1:
        start, end = _span(chance, data)
        return (
            data[:start]
            + chance.choice((b"\x91", b"\x81\xa1a", b"\xdd\xff\xff\xff\xff")) * _DEEP
            + data[end:]
        )
    tree = _packed(data)
    try:
        return data if tree is None else msgspec.msgpack.encode(_changed(chance, tree))
    except (ValueError, OverflowError, RecursionError, TypeError):
        return data


def _changed(chance: random.Random, tree: Any) -> Any:
    """The tree with one part removed, doubled, renamed, repeated or replaced."""
    tree = copy.deepcopy(tree)
    places = _places(tree)
    if not places:
        return chance.choice(_VALUES)
    holder, key = chance.choice(places)
    match chance.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        case 1:
            holder[chance.choice(("", "a", "type", "x" * 300, f"{key}2"))] = holder.pop(key)
        case 2 if isinstance(holder[key], list) and holder[key]:
            holder[key] = holder[key] * chance.choice((2, 100, 10_000 // len(holder[key]) + 1))
        case 3:
            other_holder, other = chance.choice(places)
            holder[key] = copy.deepcopy(other_holder[other])
        case _:
            holder[key] = copy.deepcopy(chance.choice(_VALUES))
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Each container with each of its keys, at most some thousands."""
    found: list[tuple[Any, Any]] = []
    waiting = [tree]
    while waiting and len(found) < 5000:
        holder = waiting.pop()
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        found += [(holder, key) for key in keys[:1000]]
        waiting += [holder[key] for key in keys[:1000] if isinstance(holder[key], dict | list)]
    return found


# --- pictures ---------------------------------------------------------------------------------------------------


def _segments(chance: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """A segment of a JPEG removed, repeated or moved, with the compressed data behind it."""
    starts = [segment.start for segment in segments_of(data)]
    parts = [data[start:end] for start, end in itertools.pairwise([*starts, len(data)])]
    if not parts:
        return data
    index = chance.randrange(len(parts))
    match chance.randrange(3):
        case 0:
            del parts[index]
        case 1:
            times = min(chance.choice((2, 15, 2000)), _REPEATED_BYTES // len(parts[index]) + 1)
            parts[index] *= times
        case _:
            parts.insert(chance.randrange(len(parts)), parts.pop(index))
    return data[: starts[0]] + b"".join(parts)
