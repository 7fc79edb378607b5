"""What people decided about findings: one line of JSON for each review, in a file beside the log.

The log stays as the flight wrote it. The last line about a finding counts, and each line says all of its review.
"""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from upwash.errors import NotWritten, UsageError
from upwash.support.input_files import read_file, why_unreadable
from upwash.support.output_files import append_whole, flush_to_disk
from upwash.support.text import counted, printable

LONGEST_LABEL, LONGEST_NOTE, LONGEST_NAME = 100, 1000, 100  # characters
_MOST_BYTES = 2**23  # of a file: some 40,000 reviews
_ENDING = ".review.jsonl"
_LOG = ".jsonl"


class Verdict(StrEnum):
    """What a person decided; open is a verdict that the person took back."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    OPEN = "open"


class FindingKey(msgspec.Struct, frozen=True):
    """Which finding of a run: the second and the number of its message to the user, and its index in the message.

    Numbers and indexes count from 0. The log decides all three, so that a key stays the same when objects are joined
    or numbered in another way.
    """

    t_s: float
    message: Annotated[int, Meta(ge=0)]
    index: Annotated[int, Meta(ge=0)]


class Review(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One person's verdict about a finding, perhaps with another label and a note."""

    time: Annotated[datetime, Meta(tz=True)]
    finding: FindingKey
    verdict: Verdict
    label: Annotated[str, Meta(max_length=LONGEST_LABEL)] = ""
    note: Annotated[str, Meta(max_length=LONGEST_NOTE)] = ""
    reviewer: Annotated[str, Meta(max_length=LONGEST_NAME)] = ""

    @property
    def is_decided(self) -> bool:
        """Whether the finding is accepted or rejected."""
        return self.verdict is not Verdict.OPEN


@dataclass(frozen=True, slots=True)
class Ranked:
    """A review and its place in the order of reviews, which a clock that is set back does not change."""

    rank: tuple[datetime, int]
    review: Review


@dataclass(frozen=True, slots=True)
class Reviews:
    """The reviews of a log by finding, in their order; `remarks` are sentences about what could not be read."""

    file: str = ""
    by_finding: Mapping[FindingKey, Sequence[Ranked]] = field(default_factory=dict)
    remarks: Sequence[str] = ()


NO_REVIEWS = Reviews()


def review_file(log: Path) -> Path:
    """The file beside the log that has its reviews."""
    return log.with_name(f"{log.name.removesuffix(_LOG)}{_ENDING}")


def logs_among(files: Sequence[Path]) -> list[Path]:
    """The files without the reviews of others of them, which a pattern such as *.jsonl matches too."""
    reviews = {review_file(file) for file in files}
    return [file for file in files if file not in reviews]


def read_reviews(log: Path) -> Reviews:
    """The reviews beside the log; none if there is no such file, and UsageError if it cannot be read."""
    file = review_file(log)
    try:
        content = read_file(file, most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        return NO_REVIEWS
    except (OSError, ValueError) as error:
        raise UsageError(
            f"cannot read the reviews {file}: {why_unreadable(error)}; --unreviewed reports the findings without them"
        ) from error
    return _reviews_of(content, file.name)


def append_review(log: Path, review: Review) -> None:
    """Adds a line to the file beside the log, after a torn line a new one; raises NotWritten, and leaves no part."""
    file = review_file(log)
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
    try:
        descriptor = os.open(file, flags, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            about = os.fstat(descriptor)
            if not stat.S_ISREG(about.st_mode):
                raise OSError("it is no file")
            line = msgspec.json.encode(review) + b"\n"
            if about.st_size and os.pread(descriptor, 1, about.st_size - 1) != b"\n":
                line = b"\n" + line
            if about.st_size + len(line) > _MOST_BYTES:
                raise OSError(f"it would be larger than {_MOST_BYTES // 2**20} MiB")
            append_whole(descriptor, line)
            flush_to_disk(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise NotWritten(file, error, "the review was not kept") from error


class ReviewsBeside:
    """The reviews beside a log that people go on reviewing."""

    def __init__(self, log: Path) -> None:
        self.reviews = NO_REVIEWS
        self._log = log
        self._seen: tuple[int, int, int] | None = None

    def look(self) -> bool:
        """Reads the file if it has changed, and says whether it has; what cannot be read makes a remark."""
        try:
            about = review_file(self._log).stat()
            seen = (about.st_ino, about.st_size, about.st_mtime_ns)
        except OSError:
            seen = None
        if seen == self._seen:
            return False
        self._seen = seen
        try:
            self.reviews = read_reviews(self._log)
        except UsageError as error:
            self.reviews = Reviews(remarks=[str(error)])
        return True


def _reviews_of(content: bytes, name: str) -> Reviews:
    found: dict[FindingKey, list[Ranked]] = {}
    latest: datetime | None = None
    left_out: list[int] = []
    for number, line in enumerate(content.split(b"\n"), start=1):
        if not line.strip():
            continue
        try:
            review = _DECODER.decode(line)
        except (ValueError, RecursionError):
            left_out.append(number)
            continue
        latest = review.time if latest is None else max(latest, review.time)
        found.setdefault(review.finding, []).append(Ranked((latest, number), _in_one_line(review)))
    if not left_out:
        return Reviews(name, found)
    lines = counted(len(left_out), "line")
    which = f"line {left_out[0]}" if len(left_out) == 1 else f"the first is line {left_out[0]}"
    are = "is" if len(left_out) == 1 else "are"
    return Reviews(name, found, [f"{lines} of {printable(name)} {are} no review and left out: {which}"])


_DECODER = msgspec.json.Decoder(Review)


def _in_one_line(review: Review) -> Review:
    """The review in printed characters: any program may have written the file."""
    return msgspec.structs.replace(
        review,
        label=printable(review.label.strip()),
        note=printable(review.note.strip()),
        reviewer=printable(review.reviewer.strip()),
    )
