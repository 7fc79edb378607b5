"""Map tiles of a test's own: pictures of one pixel."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

Tile = tuple[int, int, int]  # zoom, and the place from the west and from the north


def picture(*colour: int) -> bytes:
    """A PNG of one pixel."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    header = struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes([0, *colour]))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def tiles_around(latitude_deg: float, longitude_deg: float, zooms: Iterable[int]) -> dict[Tile, bytes]:
    """The tile of the place at each zoom, and two more on each side."""
    found: dict[Tile, bytes] = {}
    for zoom in zooms:
        latitude = math.radians(latitude_deg)
        from_south = math.log(math.tan(latitude) + 1 / math.cos(latitude)) / math.pi
        x, y = int((longitude_deg + 180) / 360 * 2**zoom), int((1 - from_south) / 2 * 2**zoom)
        found |= {
            (zoom, x + right, y + down): picture(0, 128, 0) for right in range(-2, 3) for down in range(-2, 3)
        }
    return found


def folder_with(tiles: Mapping[Tile, bytes], folder: Path) -> Path:
    """The folder, with the tiles as ZOOM/X/Y.png."""
    for (z, x, y), tile in tiles.items():
        column = folder / str(z) / str(x)
        column.mkdir(parents=True, exist_ok=True)
        (column / f"{y}.png").write_bytes(tile)
    return folder
