"""The flight page as a document and as a file: it stands alone, runs its own scripts alone, and has all facts."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from tests.events import line
from tests.report.test_findings import BOX, flight
from tests.view.hostile_logs import hostile_log

from upwash.cli.main import main
from upwash.errors import UpwashError
from upwash.report.finding_files import as_csv
from upwash.report.record import read_records, reviewed_of
from upwash.services import solar_park
from upwash.view.document import document
from upwash.view.file import write_page

HOSTILE = "</title></script><script>alert('1')</script><img src=x onerror=alert(1)>&\"\x00]]>"
HERE = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
# As leafletjs.com/download has them for 1.9.4: somebody else packages Leaflet for Python.
LEAFLET = {
    "leaflet.js": "db49d009c841f5ca34a888c96511ae936fd9f5533e90d8b2c4d57596f4e5641a",
    "leaflet.css": "a7837102824184820dfa198d1ebcd109ff6d0ff9a2672a074b9a1b4d147d04c6",
}


class Reading(HTMLParser):
    """What a document refers to, what its elements have in them by kind, and what would run beside its scripts."""

    def __init__(self, document: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.handlers: list[str] = []
        self.content: dict[str, list[str]] = {}
        self.policy = ""
        self._open = ""
        self.feed(document)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.references += [value for name, value in attrs if name in {"src", "href", "action"} and value]
        self.handlers += [name for name in known if name.startswith("on") or name == "style"]
        self._open = f"{tag}#{known['id']}" if tag == "script" and "id" in known else tag
        if known.get("http-equiv"):
            self.policy = known["content"] or ""

    def handle_data(self, data: str) -> None:
        self.content.setdefault(self._open, []).append(data)

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def told(self) -> Sequence[Any]:
        """The messages that are in the document."""
        (told,) = self.content["script#told"]
        return list(json.loads(told))


def whole(*logs: Path) -> str:
    return b"".join(write_page(logs, read_records(logs))).decode()


def read(*logs: Path) -> Reading:
    return Reading(whole(*logs))


def log_of(file: Path, *events: tuple[float, str, Mapping[str, object]]) -> Path:
    file.write_bytes(b"".join(line(kind, t, **facts) for t, kind, facts in events))
    return file


def test_a_file_refers_to_nothing_outside_itself_and_runs_its_own_scripts_alone(
    logs: tuple[Path, Path],
) -> None:
    page = read(*logs)
    assert all(reference.startswith("data:image/") for reference in page.references)
    assert page.handlers == []
    assert page.policy.startswith("default-src 'none'; ")
    for kind in ("script", "style"):
        (content,) = page.content[kind]
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in page.policy
    assert "unsafe" not in page.policy
    assert "@import" not in page.content["style"][0]


def test_a_file_has_the_findings_with_their_pictures_and_as_files(tmp_path: Path) -> None:
    log = flight(tmp_path / "f.jsonl", {"row": 7.5}, [BOX], source="park 2")
    document = whole(log)
    (told,) = [facts for kind, facts in Reading(document).told() if kind == "findings"]
    assert [(each["words"], each["numbers"]) for each in told] == [
        ("2 findings: 1 hot-spot, 1 result", [1, 2])
    ]
    assert re.findall(r'<image id="(\S+)" href="data:image/jpeg;base64,', document) == ["crop-0-1"]
    (files,) = Reading(document).content["script#files"]
    assert json.loads(files)["findings.csv"] == as_csv(reviewed_of(read_records([log])).objects)
    assert set(json.loads(files)) == {"findings.csv", "findings.geojson", "findings.kml"}


def test_a_file_renders_each_photo_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[tuple[float, str, Mapping[str, object]]] = [(1.0, "mission_started", {"policy": "p"})]
    for number in range(20):
        place = {"east_m": 5.0 * number, "north_m": 0.0, "altitude_m": 20.0}
        events.append((10.0 * number + 2, "photo", {"source": "park 2", "position": place}))
        events.append((10.0 * number + 3, "notified", {"message": [BOX], "at": place}))
    rendered = []
    render = solar_park.photograph

    def noted(park: solar_park.Park, view: solar_park.View, *, shot: int) -> object:
        rendered.append(shot)
        return render(park, view, shot=shot)

    monkeypatch.setattr(solar_park, "photograph", noted)
    document = whole(log_of(tmp_path / "f.jsonl", *events))
    assert (document.count('<image id="crop-'), document.count('"source":"data:image/')) == (20, 20)
    assert len(rendered) == 20


def test_a_file_has_every_fact_and_ends(logs: tuple[Path, Path]) -> None:
    messages = read(*logs).told()
    assert [kind for kind, _ in messages if kind != "facts"] == [
        "page",
        "findings",
        "summaries",
        "elsewhere",
        "end",
    ]
    batches = [batch for kind, batch in messages if kind == "facts"]
    assert {batch["log"] for batch in batches} == {0, 1}
    assert all(batch["trouble"] == "" for batch in batches)
    for number, record in enumerate(read_records(logs)):
        facts = [fact for batch in batches if batch["log"] == number for fact in batch["facts"]]
        delays = [fact["delay_s"] for fact in facts if fact["fact"] == "call"]
        assert delays == [call.delay_s for call in record.calls]


def test_what_a_log_says_is_never_markup(tmp_path: Path) -> None:
    call = {"operation": HOSTILE, "place": HOSTILE, "decision": HOSTILE, "delay_s": 2.0}
    log = log_of(
        tmp_path / "<b>&.jsonl",
        (0.0, "planned", {"waypoints_m": [], "ranges": {HOSTILE: {"centre": HERE, "radius_m": 5}}}),
        (1.0, "mission_started", {"policy": HOSTILE, "waypoints": 1}),
        (2.0, "arrived", {"waypoint": 0, "east_m": 0.0, "north_m": 0.0}),
        (3.0, "call", call),
        (4.0, "notified", {"message": HOSTILE, "at": HERE}),
    )
    page = read(log)
    assert len(page.content["script"]) == 1
    assert page.handlers == []
    assert all(reference.startswith("data:image/") for reference in page.references)
    (fact,) = [
        fact
        for kind, batch in page.told()
        if kind == "facts"
        for fact in batch["facts"]
        if fact["fact"] == "call"
    ]
    assert fact["operation"] == HOSTILE


@pytest.mark.parametrize("seed", range(30))
def test_no_log_ends_in_a_traceback_or_becomes_markup(tmp_path: Path, seed: int) -> None:
    log = tmp_path / "hostile.jsonl"
    log.write_bytes(hostile_log(seed))
    try:
        page = read(log)
    except UpwashError:
        return
    assert (len(page.content["script"]), page.handlers) == (1, [])
    assert all(reference.startswith("data:image/") for reference in page.references)
    kinds = [kind for kind, _ in page.told()]
    assert (kinds[0], kinds[-1]) == ("page", "end")


def test_a_file_of_thousands_of_servers_stays_small(tmp_path: Path) -> None:
    ranges = {f"s{number}": {"centre": HERE, "radius_m": 5} for number in range(5_000)}
    planned = (0.0, "planned", {"waypoints_m": [], "ranges": ranges})
    log = log_of(tmp_path / "f.jsonl", planned, (1.0, "mission_started", {"policy": "p"}))
    assert len(whole(log)) < 1.5e6


def test_without_scripts_a_file_says_what_the_flight_came_to(logs: tuple[Path, Path]) -> None:
    document = whole(*logs)
    assert document.index("offloading saved", document.index('class="sheet"')) < document.index(
        '<script type="application/json"'
    )
    assert "<noscript>" in document


def test_a_flight_that_ended_before_its_first_call_has_a_page(tmp_path: Path) -> None:
    log = log_of(tmp_path / "early.jsonl", (1.0, "mission_started", {"policy": "p", "waypoints": 1}))
    assert "was not completed" in whole(log)


def test_each_module_is_a_part_of_the_script() -> None:
    script = "".join(document("any"))
    for module in (files("upwash.view") / "page").iterdir():
        if module.name.endswith(".js"):
            assert f'modules["{module.name}"] = ' in script
    assert not re.search(r"^(import|export) ", script, re.MULTILINE)


@pytest.mark.parametrize(("name", "sha256"), LEAFLET.items())
def test_the_map_library_is_what_its_makers_released(name: str, sha256: str) -> None:
    file = files("js_lib_leaflet") / "static" / "js_lib_leaflet" / name
    assert hashlib.sha256(file.read_bytes()).hexdigest() == sha256


def test_the_command_writes_the_page(logs: tuple[Path, Path], tmp_path: Path) -> None:
    assert main(["report", *map(str, logs), "-o", str(tmp_path / "page.html")]) == 0
    assert "with, without" in Reading((tmp_path / "page.html").read_text()).content["title"][0]
