"""What a MessagePack message holds, counted by the headers of its values before any is built.

One byte can stand for a list, which costs a hundred bytes and its time: whoever sends bytes must not choose how long
the receiver is busy. Binary data and numbers are skipped, so a photo costs as much as its few headers.
"""

from __future__ import annotations

MOST_TEXT_BYTES = 2**18  # in a message; texts below 32 bytes do not count, as their number is bounded
MOST_DEPTH = 100

_FROM_BINARY = (  # the bytes before what a value holds, and how many of them are its length; from 0xC4 on
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
    """Of a value with that first byte: its bytes as far as that says, those of its length, the values in it."""
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
    """What the message has too much of, "" where that is nothing; of one that is cut short the decoder says so."""
    at, left, text_bytes = 0, 1, 0
    outer: list[int] = []  # of each list and map around this one, how many values are left
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
