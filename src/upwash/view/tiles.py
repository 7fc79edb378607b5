"""Map tiles from elsewhere, where somebody asked for them."""

from __future__ import annotations

import re

import msgspec

from upwash.errors import UsageError

_URL = re.compile(r"(https?://[A-Za-z0-9.-]+(?::\d+)?)/[^\s\"'<>]*")


class Tiles(msgspec.Struct, frozen=True):
    """Tiles in Web Mercator, by a URL with {z}, {x} and {y}; `credit` is what their maker wants to be said."""

    url: str
    credit: str = ""

    def __post_init__(self) -> None:
        if _URL.fullmatch(self.url) is None or not all(part in self.url for part in ("{z}", "{x}", "{y}")):
            raise UsageError(
                f"{self.url!r} is no address of map tiles: write it as https://HOST/{{z}}/{{x}}/{{y}}.png"
            )

    @property
    def sources(self) -> tuple[str, ...]:
        """From where browsers must be allowed to load images; Leaflet blanks those it lets go of by a `data:` URL."""
        found = _URL.fullmatch(self.url)
        assert found is not None  # noqa: S101 - it was checked
        return found[1], "data:"
