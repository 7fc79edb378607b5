"""What is common to files that keep, between flights, what was found at places: JSON around homes.

People can read and mend the files. Positions are relative to a home, and the field around each home keeps its own: a
mission elsewhere leaves what was found here as it is. A file that was damaged since it was written is put aside.
"""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Generic, Protocol, TypeVar

import msgspec
from msgspec import Meta, Struct

from upwash.core.geo import FARTHEST_M, GeoPosition, LocalFrame, Position, ground_distance_m
from upwash.errors import ConfigError, NotWritten
from upwash.support.input_files import read_file, text_of, why_unreadable
from upwash.support.output_files import write_file

FORGOTTEN_AFTER = 5  # flights without a visit, after which a place is forgotten
MOST_FIELDS = 100  # elsewhere; those where no flight was for longest are forgotten

_FIELD_M = 10_000.0  # between homes of one field, where the plane of positions is true to 0.1 %
_MOST_BYTES = 50_000_000
Count = Annotated[int, Meta(ge=0, le=2**53)]
F = TypeVar("F", bound="KeptField")


class Home(Struct, frozen=True, forbid_unknown_fields=True):
    """Where on the Earth a field's metres count from."""

    latitude_deg: Annotated[float, Meta(ge=-90, le=90)]
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)]


class KeptField(Protocol):
    """What was found around one home, or in missions without one."""

    home: Home | None


class KeptFile(Protocol[F]):
    """A file's content: the field of the last flight, and those elsewhere."""

    elsewhere: Sequence[F]


class KeptMap(Generic[F]):
    """The fields of a file, the latest first; a missing file and a damaged one have none.

    Raises ConfigError for a file that cannot be read, or that never was what it must be.
    """

    # No dataclass: msgspec would look for its fields in the configuration instead of asking how to read it.

    def __init__(self, file: Path, read: Callable[[str], list[F]], *, mark: str, name: str) -> None:
        self.file = file
        self._name = name
        self._read, self._mark = read, mark.encode()
        self._fields, self._damage = self._content()

    def __eq__(self, other: object) -> bool:
        """Whether it is the same file with the same content."""
        return isinstance(other, KeptMap) and (self.file, self._fields) == (other.file, other._fields)

    def __hash__(self) -> int:
        """By the file."""
        return hash(self.file)

    @property
    def notice(self) -> str:
        """What becomes of a damaged file; "" for any other."""
        if not self._damage:
            return ""
        return (
            f"{self.file} is a damaged {self._name} ({self._damage}): the flight begins an empty one, and its end "
            f"renames the damaged file {_aside(self.file).name}"
        )

    def _around(self, home: GeoPosition | None) -> Iterator[tuple[F, Position]]:
        """The fields that the home lies in, and where their homes are from it."""
        for field in self._fields:
            if (at := _shift(field.home, home)) is not None:
                yield field, at

    def _elsewhere(self, home: GeoPosition | None) -> list[F]:
        return [field for field in self._fields if _shift(field.home, home) is None][:MOST_FIELDS]

    def _write(self, content: KeptFile[F]) -> None:
        """Write what the file keeps, without the oldest fields if it would be too large; raises NotWritten."""
        while len(encoded := msgspec.json.format(msgspec.json.encode(content), indent=1)) >= _MOST_BYTES:
            if not content.elsewhere:
                raise NotWritten(self.file, OSError(errno.EFBIG, os.strerror(errno.EFBIG)), "it is unchanged")
            content.elsewhere = content.elsewhere[:-1]
        try:
            if self._content()[1]:
                self.file.rename(_aside(self.file))
        except (OSError, ConfigError) as error:
            problem = error if isinstance(error, OSError) else OSError(errno.EINVAL, str(error))
            raise NotWritten(self.file, problem, "it is unchanged") from error
        write_file(self.file, encoded + b"\n")

    def _content(self) -> tuple[list[F], str]:
        """The fields in the file as it is now, and how it was damaged."""
        content = b""
        try:
            content = read_file(self.file, most_bytes=_MOST_BYTES)
            return self._read(text_of(content)), ""
        except FileNotFoundError:
            return [], ""
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            if self._was_ours(content):
                return [], str(error) if content.strip(b"\0") else "nothing is in it"
            problem = f"no {self._name} of upwash: {error}: restore the file, or delete it to begin anew"
            raise ConfigError(str(self.file), "", problem) from None
        except (OSError, ValueError) as error:
            why = why_unreadable(error)
            problem = f"cannot be read ({why}): name a readable file, or delete this one to begin anew"
            raise ConfigError(str(self.file), "", problem) from None

    def _was_ours(self, content: bytes) -> bool:
        """Whether it begins as a file of the map does, or has the zeros that a power cut leaves."""
        begins = b"".join(content.strip(b"\0")[:100].split())
        ours = b'{"' + self._mark + b'":'
        return begins.startswith(ours) or ours.startswith(begins)


def home_of(place: GeoPosition | None) -> Home | None:
    """The home that a file keeps."""
    return None if place is None else Home(place.latitude_deg, place.longitude_deg)


def moved(east_m: float, north_m: float, by: Position) -> Position | None:
    """A field's place from the mission's home; None beyond the farthest position."""
    east_m, north_m = east_m + by.east_m, north_m + by.north_m
    return Position(east_m, north_m) if max(abs(east_m), abs(north_m)) <= FARTHEST_M else None


def _shift(before: Home | None, home: GeoPosition | None) -> Position | None:
    """The position of a field's home from the mission's home; None if it is elsewhere."""
    if before is None or home is None:
        return Position(0.0, 0.0) if before is None and home is None else None
    at = LocalFrame(home).position(GeoPosition(before.latitude_deg, before.longitude_deg))
    return at if ground_distance_m(at, Position(0.0, 0.0)) <= _FIELD_M else None


def _aside(file: Path) -> Path:
    names = (file.with_name(f"{file.name}.damaged{number or ''}") for number in itertools.count())
    return next(name for name in names if not os.path.lexists(name))
