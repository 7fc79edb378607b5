"""Text for logs, terminals and messages."""

from __future__ import annotations

import json
import math
import re
import shlex
import signal
from collections.abc import Sequence
from datetime import datetime

LONGEST_TEXT = 1000
_NUMBER = re.compile(r"[ \t]*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[ \t]*", re.ASCII)
_MINUTE_S = 60.0
_NO_MARGIN_S = 1e-6  # of equal numbers, whose mean is rounded
_LONGEST_NUMBER = 60  # characters of what is none
_PLURALS = {
    "person": "people",
    "sheep": "sheep",
    "mouse": "mice",
    "knife": "knives",
}  # of labels that people use


def escaped(text: str) -> str:
    """The text on one line, with an escape for each character that is not printed.

    Escaped are control characters, line ends, marks that turn the direction of writing, and half pairs of code units:
    none can move a cursor, forge a line of a log or hide what stands there.
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text
    )


def escaped_lines(text: str) -> str:
    """The text escaped, its line ends kept."""
    return "\n".join(map(escaped, text.split("\n")))


def printable(text: str, most: int = LONGEST_TEXT) -> str:
    """The text escaped, at most `most` characters; a mark stands for the rest."""
    shown = escaped(text[: most + 1])
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


def message_of(error: BaseException) -> str:
    """The message of an error; "" where the error's own code fails to make one."""
    try:
        return str(error)
    except Exception:  # noqa: BLE001 - of users' classes
        return ""


def worded(error: BaseException) -> str:
    """The type of an error, and its message if it has one."""
    kind, message = type(error).__name__, message_of(error)
    return f"{kind}: {message}" if message else kind


def clocks_apart(of: str, says: datetime, own: datetime) -> str:
    """What a clock says beside this computer's, and the difference."""
    behind_s = (own - says).total_seconds()
    side = "behind" if behind_s > 0 else "ahead"
    times = f"{says:%Y-%m-%d %H:%M:%S} UTC where this computer's says {own:%Y-%m-%d %H:%M:%S} UTC"
    return f"{of} says {times}: {abs(behind_s):.1f} s {side}"


def words_of(text: str) -> str:
    """The printed characters of the text on one line, with blanks for all others, such as colours."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()


def number_of(text: str) -> float:
    """The finite decimal number that is written there, in ASCII and without separators; raises ValueError."""
    if not _NUMBER.fullmatch(text) or not math.isfinite(number := float(text)):
        raise ValueError(f"{printable(text, _LONGEST_NUMBER)!r} is no finite number")
    return number


def named_twice(names: Sequence[str]) -> str:
    """A name that columns of a table share, "" without one; columns may have none."""
    seen: set[str] = set()
    for name in names:
        if name and name in seen:
            return name
        seen.add(name)
    return ""


def signal_name(number: int) -> str:
    """The name of a signal, such as SIGKILL, or its number if it has no name."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def by_name(name: str) -> tuple[Sequence[tuple[int, str]], str]:
    """The key that sorts names as people count: pole2 before pole10.

    A number is compared by its length and then by its digits, without the conversion of thousands of digits.
    """
    parts = re.split(r"([0-9]+)", name)
    numbers = (part.lstrip("0") if index % 2 else part for index, part in enumerate(parts))
    return [(len(part) if index % 2 else 0, part) for index, part in enumerate(numbers)], name


def json_line(line: bytes) -> bytes:
    """The same JSON value with JSON's escape for each character that is not printed."""
    text = line.decode()
    if text.isprintable():
        return line
    return "".join(letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in text).encode()


def command(*words: object) -> str:
    """The command line of these words, quoted for the shell, between backticks."""
    return f"`{shlex.join(map(str, words))}`"


def counted(number: int, noun: str) -> str:
    """A number with its noun: "1 call", "2 calls", "2 boxes"."""
    return f"{number} {noun if number == 1 else plural(noun)}"


def plural(noun: str) -> str:
    """Several of the noun, which may have words before it: "broken modules", "boxes", "people"."""
    *before, last = noun.split(" ")
    if last in _PLURALS:
        several = _PLURALS[last]
    elif last.endswith(("ss", "us", "x", "z", "ch", "sh")):
        several = f"{last}es"
    elif last.endswith("s"):  # skis, scissors
        several = last
    elif last.endswith("y") and last[-2:-1] not in "aeiou":
        several = f"{last[:-1]}ies"
    else:
        several = f"{last}s"
    return " ".join([*before, several])


def clock(seconds: float) -> str:
    """A second of the mission as the pages show it: "4:05", and from an hour on "1:04:05"."""
    minutes, second = divmod(max(0, int(seconds)), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"


def lasting(seconds: float, margin_s: float | None = None) -> str:
    """A duration, or a difference of durations, as on the flight page: "15.4 s", "3:46", "3:46 ± 1.2 s".

    A margin that is None, infinite (of one observation) or 0 (of equal ones) is left out.
    """
    is_sure = margin_s is None or math.isinf(margin_s) or margin_s < _NO_MARGIN_S
    margin = "" if is_sure else f" ± {margin_s:.1f} s"
    if abs(seconds) < _MINUTE_S:
        return f"{seconds:z.1f}{margin or ' s'}"
    return f"{'-' if seconds < 0 else ''}{clock(abs(seconds))}{margin}"


def duration(seconds: float) -> str:
    """Two units at most: 12 s, 3 min 4 s, 2 h 5 min, 6 d 7 h."""
    whole = round(seconds)
    for unit_s, unit, part_s, part in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= unit_s:
            return f"{whole // unit_s} {unit} {whole % unit_s // part_s} {part}"
    return f"{whole} s"
