"""What is common to files that keep, between flights, what was found at places: JSON around a home.

People can read and mend the files. Positions are relative to the home of the file: a later mission may have another
home.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.errors import ConfigError
from upwash.support.input_files import read_file, text_of, why_unreadable
from upwash.support.output_files import write_file

FORGOTTEN_AFTER = 5  # flights without a visit, after which a place is forgotten

_MOST_BYTES = 50_000_000
Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
T = TypeVar("T", bound=Struct)


class Home(Struct, forbid_unknown_fields=True):
    """Where on the Earth the file's metres count from."""

    latitude_deg: Annotated[float, Meta(ge=-90, le=90)]
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)]


class KeptMap:
    """A map and its file; a missing file is an empty map."""

    # No dataclass: msgspec would look for its fields in the configuration instead of asking how to read it.

    def __init__(self, file: Path, content: Struct, home: Home | None) -> None:
        self.file = file
        self._content = content
        self._home = home

    @property
    def has_home(self) -> bool:
        """Whether the map knows where on the Earth its places are."""
        return self._home is not None

    def __eq__(self, other: object) -> bool:
        """Whether it is the same file with the same content."""
        return isinstance(other, KeptMap) and (self.file, self._content) == (other.file, other._content)

    def __hash__(self) -> int:
        """By the file."""
        return hash(self.file)


def home_of(place: GeoPosition | None) -> Home | None:
    """The home that a file keeps."""
    return None if place is None else Home(place.latitude_deg, place.longitude_deg)


def shift(before: Home | None, home: GeoPosition | None) -> Position:
    """The position of the file's home, from the mission's home."""
    if before is None or home is None:
        return Position(0.0, 0.0)
    return LocalFrame(home).position(GeoPosition(before.latitude_deg, before.longitude_deg))


def read_kept(file: Path, kind: type[T], *, empty: T, name: str) -> T:
    """What the file keeps, `empty` for a missing file; raises ConfigError."""
    try:
        return msgspec.json.decode(text_of(read_file(file, most_bytes=_MOST_BYTES)), type=kind)
    except FileNotFoundError:
        return empty
    except msgspec.MsgspecError as error:
        problem = f"no {name} of upwash: {error}: restore the file, or delete it to begin anew"
        raise ConfigError(str(file), "", problem) from None
    except (OSError, ValueError) as error:
        problem = f"cannot be read ({why_unreadable(error)}): name a readable file, or delete this one to begin anew"
        raise ConfigError(str(file), "", problem) from None


def write_kept(file: Path, content: Struct) -> None:
    """Write what the file keeps; raises NotWritten."""
    write_file(file, msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n")
