"""Map tiles beneath the page's map: where they come from, what is refused, and which of them a document has."""

from __future__ import annotations

import asyncio
import gzip
import json
import os
import re
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from pmtiles.tile import Compression, TileType, deserialize_header, serialize_header, zxy_to_tileid
from pmtiles.writer import Writer
from starlette.types import ASGIApp, Message, Scope
from tests.events import line
from tests.maps import folder_with, picture

from upwash.cli.arguments import read_map
from upwash.cli.main import main
from upwash.core.geo import GeoPosition
from upwash.errors import UsageError
from upwash.report.photos import PhotoShelf
from upwash.view.app import application
from upwash.view.feed import Feed
from upwash.view.tiles import BaseMap, base_map, inlined

HOME = GeoPosition(39.3666, 22.9507)
ZOOMS = (14, 17)
AT_HOME = {14: (9236, 6240), 17: (73891, 49921)}  # by the formulas of Web Mercator, to the tile


def tiles() -> dict[tuple[int, int, int], bytes]:
    """A tile at home and its neighbours, at each zoom, each with a colour of its own."""
    return {
        (zoom, x + right, y + down): picture(zoom, 100 + right, 100 + down)
        for zoom, (x, y) in AT_HOME.items()
        for right in (-1, 0, 1)
        for down in (-1, 0, 1)
    }


def folder(where: Path) -> Path:
    return folder_with(tiles(), where / "map")


def mbtiles(where: Path) -> Path:
    with sqlite3.connect(where / "map.mbtiles") as database:
        database.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
        database.execute("CREATE TABLE tiles (zoom_level INT, tile_column INT, tile_row INT, tile_data BLOB)")
        database.executemany(
            "INSERT INTO metadata VALUES (?, ?)", [("format", "png"), ("attribution", "Maps: us")]
        )
        rows = [(z, x, 2**z - 1 - y, tile) for (z, x, y), tile in tiles().items()]
        database.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)
    database.close()
    return where / "map.mbtiles"


def pmtiles(where: Path, kind: TileType = TileType.PNG) -> Path:
    with (where / "map.pmtiles").open("wb") as file:
        writer = Writer(file)
        for number, tile in sorted((zxy_to_tileid(*place), tile) for place, tile in tiles().items()):
            writer.write_tile(number, tile)
        degrees = {f"{edge}_{axis}_e7": 0 for edge in ("min", "max", "center") for axis in ("lon", "lat")}
        header = {"tile_type": kind, "tile_compression": Compression.NONE, "center_zoom": 0, **degrees}
        writer.finalize(
            header | dict(zip(("min_zoom", "max_zoom"), ZOOMS, strict=True)), {"attribution": "Maps: us"}
        )
    return where / "map.pmtiles"


@pytest.mark.parametrize(("make", "credit"), [(folder, ""), (mbtiles, "Maps: us"), (pmtiles, "Maps: us")])
def test_each_tile_is_found_where_it_lies(make: Callable[[Path], Path], credit: str, tmp_path: Path) -> None:
    source = make(tmp_path)
    found = base_map(source)
    assert found.find is not None
    assert (found.tiles.from_zoom, found.tiles.to_zoom, found.tiles.credit) == (*ZOOMS, credit)
    assert {place: found.find(*place) for place in tiles()} == tiles()
    assert found.find(17, 1, 1) is None
    assert base_map(source, "Mine").tiles.credit == "Mine"


def test_a_url_is_told_and_only_its_images_are_allowed() -> None:
    found = base_map("https://tiles.example:8443/{z}/{x}/{y}.png", "Maps: them")
    assert found.find is None
    assert found.tiles.sources == ("https://tiles.example:8443", "data:")


def endless(file: str, view: str, columns: str, **tables: str) -> None:
    """An MBTiles file with a view that has no last row."""
    rows = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
    with sqlite3.connect(file) as database:
        database.execute(f"CREATE VIEW {view} AS {rows} SELECT {columns} FROM c")
        for name, those in tables.items():
            database.execute(f"CREATE TABLE {name} ({those})")
    database.close()


def inflated(file: Path) -> None:
    """Gives the file metadata of 4 MB, packed into some kilobytes."""
    header = deserialize_header(file.read_bytes()[:127])
    packed = gzip.compress(json.dumps({"attribution": " " * 2**22}).encode())
    header["metadata_offset"], header["metadata_length"] = file.stat().st_size, len(packed)
    file.write_bytes(serialize_header(header) + file.read_bytes()[127:] + packed)


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("https://tiles.example/{z}/{x}.png", "no address of map tiles"),
        ("https://tiles.example; script-src *//{z}/{x}/{y}.png", "no address of map tiles"),
        ("https://tiles.example/{z}/{x}/{y}.png\nX: y", "no address of map tiles"),
        ("file:///{z}/{x}/{y}.png", "is no map: give a folder"),
        ("missing.mbtiles", "there is no file"),
        ("missing.pmtiles", "there is no file"),
        ("pipe.mbtiles", "there is no file"),
        ("endless_names.mbtiles", "its tables do not end"),
        ("endless_tiles.mbtiles", "its tables do not end"),
        ("inflated.pmtiles", "a part has more than 1048576 bytes"),
        ("text.mbtiles", "is no MBTiles file"),
        ("text.pmtiles", "is no PMTiles file"),
        (".", "has no map tiles"),
        ("vector/map.pmtiles", "no vector tiles"),
    ],
)
def test_what_is_no_map_is_refused(
    source: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("text.mbtiles", "text.pmtiles"):
        Path(name).write_text("no map at all, and longer than the header of any of them " * 9)
    Path("vector").mkdir()
    pmtiles(Path("vector"), TileType.MVT)
    os.mkfifo("pipe.mbtiles")
    endless("endless_names.mbtiles", "metadata", "x AS name, x AS value", tiles="zoom_level")
    endless("endless_tiles.mbtiles", "tiles", "x AS zoom_level", metadata="name, value")
    inflated(pmtiles(Path()).rename("inflated.pmtiles"))
    with pytest.raises(UsageError, match=re.escape(why)):
        base_map(read_map(source))


def asked_for(app: ASGIApp, path: str) -> tuple[int, str, bytes]:
    """The status, the media type and the content of the answer."""
    sent: list[Message] = []
    scope: Scope = {
        "type": "http", "method": "GET", "path": path, "headers": [(b"host", b"127.0.0.1")], "query_string": b"",
    }  # fmt: skip

    async def receive() -> Message:
        return {"type": "http.request"}

    async def send(message: Message) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))  # type: ignore[arg-type]
    headers = dict(sent[0]["headers"])
    return (
        sent[0]["status"],
        headers.get(b"content-type", b"").decode(),
        b"".join(each["body"] for each in sent[1:]),
    )


def test_the_program_of_the_page_serves_its_tiles_and_no_other_file(tmp_path: Path) -> None:
    beneath = base_map(folder(tmp_path))
    (tmp_path / "map" / "17" / "1").mkdir()
    (tmp_path / "map" / "17" / "1" / "1.png").write_text("secret: no picture")
    app = application(Feed([]), PhotoShelf(None), beneath)
    z, (x, y) = 17, AT_HOME[17]
    assert asked_for(app, f"/tiles/{z}/{x}/{y}") == (200, "image/png", tiles()[z, x, y])
    for missing in (f"{z}/1/1", f"{z}/{x}/1", f"29/{x}/{y}", f"{z}/{10**300}/{y}", f"{10**300}/{x}/{y}"):
        assert asked_for(app, f"/tiles/{missing}") == (204, "", b"")
    for nowhere in (f"{z}/../../secret", f"{'9' * 5_000}/{x}/{y}"):
        assert asked_for(app, f"/tiles/{nowhere}")[0] == 404


def test_a_document_has_the_tiles_around_the_field_as_fine_as_there_is_room() -> None:
    asked = []

    def find(z: int, x: int, y: int) -> bytes:
        asked.append((z, x, y))
        return picture(z, x % 256, y % 256)

    tiles_of = base_map("https://tiles.example/{z}/{x}/{y}.png").tiles
    found, kept = inlined(BaseMap(tiles_of, find), [HOME, GeoPosition(39.3684, 22.9530)])
    assert set(kept) == {f"{z}/{x}/{y}" for z, x, y in asked}
    x, y = AT_HOME[17]
    assert f"17/{x}/{y}" in kept
    assert kept[f"17/{x}/{y}"].startswith("data:image/png;base64,")
    assert found.url == "" and found.to_zoom == 19
    less, fewer = inlined(BaseMap(tiles_of, find), [HOME], most_bytes=3_000)
    assert (found.from_zoom, less.from_zoom) == (15, 15)
    assert less.to_zoom < 19 and 0 < sum(map(len, fewer.values())) <= 3_000


def test_a_report_has_its_map_in_it_and_refuses_one_of_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "flight.jsonl"
    home = {"latitude_deg": HOME.latitude_deg, "longitude_deg": HOME.longitude_deg}
    log.write_bytes(
        line("log_opened", 0.0, time="2026-01-01T00:00:00+00:00", version=2)
        + line("planned", 0.0, home=home, waypoints_m=[(0.0, 40.0)])
        + line("mission_started", 0.0, drone="d", policy="look-ahead", waypoints=1)
        + line("mission_completed", 9.0)
    )
    made = tmp_path / "flight.html"
    map_file = pmtiles(tmp_path)
    assert main(["report", str(log), "-o", str(made), "--tiles", str(map_file)]) == 0
    (told,) = re.findall(r'<script type="application/json" id="tiles">(.*?)</script>', made.read_text())
    x, y = AT_HOME[17]
    assert f"17/{x}/{y}" in json.loads(told)
    assert (
        main(["report", str(log), "-o", str(made), "--tiles", "https://tiles.example/{z}/{x}/{y}.png"]) == 2
    )
    assert "refers to no other machine" in capsys.readouterr().err
    assert main(["report", str(log), "-o", str(map_file), "--tiles", str(map_file)]) == 2
    elsewhere = folder_with({(14, 1, 1): picture(0, 0, 0)}, tmp_path / "elsewhere")
    capsys.readouterr()
    assert main(["report", str(log), "-o", str(made), "--tiles", str(elsewhere)]) == 2
    assert "no tile around the flights" in capsys.readouterr().err
