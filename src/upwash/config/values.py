"""The kinds of value that configuration files hold.

Each kind carries its own description, which is what an error message says was expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from upwash import kinds
from upwash.core.geo import GeoPosition

Name = Annotated[
    str,
    Meta(pattern=r"^[A-Za-z0-9._-]+\Z", description="a name of letters, digits, '.', '_' and '-'"),
]
# No control characters, and nothing that turns the direction of writing: the text stands in logs and on terminals.
_PRINTED = r"[^\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]"
InterfaceName = Annotated[
    str,
    Meta(
        pattern=rf"^((?!\s|/){_PRINTED}){{1,15}}\Z",
        description='the name of a network interface like "wlan1"',
    ),
]
Text = Annotated[
    str,
    Meta(
        min_length=1,
        pattern=rf"^{_PRINTED}*\Z",
        description="a string that is not empty, without control characters",
    ),
]
Command = Annotated[tuple[Text, ...], Meta(description="an array of words, the program first")]
Names = Annotated[tuple[str, ...], Meta(description="an array of names")]
ImportPath = Annotated[
    str,
    Meta(
        pattern=r"^([A-Za-z_]\w*(\.[A-Za-z_]\w*)*|.+\.py):[A-Za-z_]\w*\Z",
        description='an import path like "package.module:Class", or "path/to/file.py:Class" from this file\'s folder',
    ),
]
ClassSettings = Annotated[
    Mapping[str, str | int | float | bool], Meta(description="a table of what the class takes")
]
FilePath = Annotated[Path, Meta(description="a file's path, absolute or from this file's folder")]


class NamedFile:
    """A file that a configuration names, read as the configuration is; a key of a kind below has its path."""

    # No dataclass: msgspec would look for its fields in the configuration instead of asking how to read it.

    def __init__(self, file: Path) -> None:
        self.file = file


class SettingsTable:
    """A table whose keys the constructor of the service's class defines, and the file that it was read from."""

    # No dataclass, for the same reason.

    def __init__(self, file: Path, values: Mapping[str, object]) -> None:
        self.file = file
        self.values = values


Settings = Annotated[SettingsTable, Meta(description="a table of what the service's constructor takes")]

Positive = kinds.Positive
NotNegative = kinds.NotNegative
Fraction = Annotated[float, Meta(ge=0, le=1, description="a number from 0 to 1")]
Tilt = Annotated[float, Meta(ge=-90, le=90, description="a number from -90 to 90, in degrees")]
Turn = Annotated[float, Meta(ge=-180, le=180, description="a number from -180 to 180, in degrees")]
Share = kinds.Share
Percent = Annotated[float, Meta(gt=0, lt=100, description="a number above 0 and below 100, in percent")]
Latitude = Annotated[float, Meta(ge=-90, le=90, description="degrees from -90 to 90")]
Longitude = Annotated[float, Meta(ge=-180, le=180, description="degrees from -180 to 180")]
Count = Annotated[int, Meta(ge=1, description="an integer of at least 1")]
CountFromZero = Annotated[int, Meta(ge=0, description="an integer of at least 0")]
Slots = Annotated[
    Annotated[int, Meta(ge=1)] | Literal["auto"], Meta(description='an integer of at least 1, or "auto"')
]
TurnSeconds = Annotated[
    float, Meta(ge=5, description="a number of at least 5, in seconds, or inf for turns that never end")
]
Range = Annotated[
    Annotated[float, Meta(gt=0)] | Literal["measured"],
    Meta(description='a number above 0, in metres, or "measured"'),
]
GridCount = Annotated[int, Meta(ge=1, le=1000, description="an integer from 1 to 1000")]
PhotoCount = Annotated[int, Meta(ge=1, le=10_000, description="an integer from 1 to 10,000")]
PixelCount = Annotated[int, Meta(ge=1, le=100_000, description="an integer from 1 to 100,000")]
VideoSource = Annotated[
    Annotated[int, Meta(ge=0)] | Annotated[str, Meta(min_length=1)],
    Meta(description="a video device's number, such as 0, or its path, the URL of a stream, or a pipeline"),
]
_MOST_BYTES = 2**31 - 1  # gRPC counts a message's bytes in 32 bits
START_TIMEOUT_S = 60.0  # a detector's model may take long to load from an SD card
MessageBytes = Annotated[
    int, Meta(ge=1024, le=_MOST_BYTES, description=f"an integer from 1024 to {_MOST_BYTES}, in bytes")
]
Bytes = Annotated[int, Meta(ge=0, description="an integer of at least 0, in bytes")]

KeysByKey = Annotated[
    Mapping[str, Text],
    Meta(description='a table of profile keys, each with its lighter one, such as { heavy = "light" }'),
]
SecondsByKey = Annotated[
    Mapping[str, NotNegative],
    Meta(description="seconds of at least 0: one number, or one for each profile key"),
]
SharesByKey = Annotated[
    Mapping[str, NotNegative],
    Meta(description="numbers of at least 0: one, or one for each profile key"),
]
FractionsByKey = Annotated[
    Mapping[str, Fraction],
    Meta(min_length=1, description="numbers from 0 to 1: one, or one for each profile key"),
]
SecondsOfEachKey = Annotated[
    Mapping[str, NotNegative],
    Meta(min_length=1, description="seconds of at least 0: one number, or one for each profile key"),
]
SecondsByService = Annotated[
    Mapping[str, SecondsByKey],
    Meta(description="seconds of at least 0 for each profile key, or for each service and profile key"),
]


class KeysConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The certificates that both ends check."""

    authority: FilePath
    """The certificate of the authority that signed the certificates of both ends."""
    certificate: FilePath
    """The certificate of this drone or daemon."""
    key: FilePath
    """The private key of that certificate."""


class HomeConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The place on the Earth where east and north are 0."""

    latitude_deg: Latitude
    """Degrees north of the equator."""
    longitude_deg: Longitude
    """Degrees east of Greenwich."""

    @classmethod
    def at(cls, place: GeoPosition) -> HomeConfig:
        """The home at that place."""
        return cls(latitude_deg=place.latitude_deg, longitude_deg=place.longitude_deg)

    @property
    def place(self) -> GeoPosition:
        """The place on the ground."""
        return GeoPosition(self.latitude_deg, self.longitude_deg)


_EVERYWHERE = ("", "*")  # in place of a host: every address of this computer
MDNS = "mdns"  # in place of an address: it is found by multicast DNS


def is_address(text: str) -> bool:
    """Whether the text is `host:port` or `unix:path`."""
    host, _, port = text.rpartition(":")
    if text.startswith("unix:"):
        return len(text) > len("unix:")
    is_ipv6 = host.startswith("[") and host.endswith("]")
    is_port = port.isascii() and port.isdecimal() and len(port) <= 5 and int(port) <= 65535
    return is_port and host not in _EVERYWHERE and (is_ipv6 or ":" not in host)


def is_listening_address(text: str) -> bool:
    """Whether a socket can listen there: an address; no host, or `*`, is every address of this computer."""
    host, colon, port = text.rpartition(":")
    return is_address(f"any:{port}" if colon and host in _EVERYWHERE else text)


def is_on_this_machine(address: str) -> bool:
    """Whether a `host:port` or `unix:path` can only be reached from this machine itself."""
    import ipaddress  # only needed where certificates are not

    host = address.rpartition(":")[0].strip("[]")
    if address.startswith("unix:") or host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
