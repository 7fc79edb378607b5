"""The version of a firmware, as AUTOPILOT_VERSION tells it."""

from __future__ import annotations

import re
from dataclasses import dataclass

OFFICIAL = 255
_KINDS = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", OFFICIAL: ""}  # FIRMWARE_VERSION_TYPE
_WRITTEN = re.compile(r"(\d{1,3})\.(\d{1,3})(?:\.(\d{1,3}))?(-[a-z]+)?")


@dataclass(frozen=True, slots=True, order=True)
class Version:
    """Three numbers and FIRMWARE_VERSION_TYPE; in development (0) it is older than the release (255)."""

    major: int
    minor: int
    patch: int = 0
    kind: int = OFFICIAL

    @classmethod
    def of(cls, number: int) -> Version | None:
        """The version in a field of AUTOPILOT_VERSION; None for 0, which is no version."""
        return (
            cls(number >> 24 & 0xFF, number >> 16 & 0xFF, number >> 8 & 0xFF, number & 0xFF)
            if number
            else None
        )

    @classmethod
    def read(cls, text: str) -> Version:
        """The version from a text such as `4.6.2` or `4.7.0-dev`; raises ValueError for other texts."""
        written = _WRITTEN.fullmatch(text)
        kinds = {ending: kind for kind, ending in _KINDS.items()}
        if written is None or (written[4] or "") not in kinds:
            raise ValueError(f'"{text}" is no version: write one such as 4.6.2 or 4.7.0-dev')
        major, minor, patch = (int(part or 0) for part in written.groups()[:3])
        if max(major, minor, patch) > 255:
            raise ValueError(f'"{text}" is no version: its numbers are at most 255')
        return cls(major, minor, patch, kinds[written[4] or ""])

    @property
    def numbers(self) -> tuple[int, int, int]:
        """The three numbers, without the kind."""
        return self.major, self.minor, self.patch

    @property
    def number(self) -> int:
        """The version as a field of AUTOPILOT_VERSION."""
        return self.major << 24 | self.minor << 16 | self.patch << 8 | self.kind

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.patch}{_KINDS.get(self.kind, '')}"
