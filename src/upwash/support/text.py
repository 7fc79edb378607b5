"""Text from elsewhere, made fit for logs and terminals."""

from __future__ import annotations

import json
import signal

LONGEST_TEXT = 1000


def escaped(text: str) -> str:
    """The text on one line, with whatever is not printed written as an escape.

    That is every control character, line ends, what turns the direction of writing, and half of a pair of code
    units: none of them can move a cursor, forge a line of a log or hide what stands there.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def escaped_lines(text: str) -> str:
    """The same, with the ends of lines left as they are."""
    return "\n".join(map(escaped, text.split("\n")))


def printable(text: str, most: int = LONGEST_TEXT) -> str:
    """The text escaped, of that many characters at most; what is cut off leaves a mark."""
    shown = escaped(text[: most + 1])
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


def words_of(text: str) -> str:
    """The words of the text on one line, with blanks for the rest: of what a service prints, colours say nothing."""
    return "".join(each if each.isprintable() else " " for each in text).strip()


def signal_name(number: int) -> str:
    """The name of a signal, such as SIGKILL; its number where it has none, as most real-time signals."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def json_line(line: bytes) -> bytes:
    """The same JSON with whatever is not printed written as JSON's own escapes: it reads as the same value."""
    text = line.decode()
    if text.isprintable():
        return line
    return "".join(each if each.isprintable() else json.dumps(each)[1:-1] for each in text).encode()
