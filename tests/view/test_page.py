"""`upwash view` as other programs of this machine meet it: what it serves, to whom, and how it ends."""

from __future__ import annotations

import http.client
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from tests.report.test_findings import BOX, flight

from upwash.cli.main import main
from upwash.launch.processes import ready_program

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]


PATHS = ["/", "/events", "/photos/0/1/0.jpg", "/crops/0/0/0.jpg", "/findings.csv", "/findings.zip"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("logs") / "demonstration.jsonl"
    assert main(["simulate", str(ROOT / "scenarios" / "demonstration.toml"), "--log", str(file)]) == 0
    return file


@pytest.fixture(scope="module")
def address(log: Path) -> Iterator[str]:
    with ready_program("view", log.parent, "view", str(log), "--port", "0") as address:
        yield address


def ask(
    address: str, path: str, method: str = "GET", **headers: str
) -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
    try:
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        return response, response.read(1_000_000 if path != "/events" else 300)
    finally:
        connection.close()


@pytest.mark.parametrize("path", [*PATHS, "/nothing"])
def test_a_browser_is_told_to_load_and_run_nothing_else(address: str, path: str) -> None:
    response, _ = ask(address, path)
    policy = response.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; connect-src 'self'; ")
    assert re.search("script-src 'sha256-[^ ]+'; style-src 'sha256-[^ ]+'; img-src 'self' data:$", policy)
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert response.headers["Cross-Origin-Resource-Policy"] == "same-origin"


@pytest.mark.parametrize("host", ["upwash.example", "127.0.0.1.example:80", "", "192.0.2.7"])
@pytest.mark.parametrize("path", PATHS)
def test_a_name_of_elsewhere_is_turned_away(address: str, host: str, path: str) -> None:
    response, body = ask(address, path, Host=host)
    assert response.status == 421
    assert b"fact" not in body


ELSEWHERE = [
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site"},  # another port of this machine
    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"},
    {"Origin": "https://elsewhere.example"},
    {"Origin": "http://127.0.0.1:1"},
    {"Origin": "null"},
]


@pytest.mark.parametrize("headers", ELSEWHERE, ids=range(len(ELSEWHERE)))
@pytest.mark.parametrize("path", PATHS)
def test_a_page_from_elsewhere_is_answered_nothing(address: str, headers: dict[str, str], path: str) -> None:
    response, body = ask(address, path, **headers)
    assert response.status == 403
    assert response.headers["Connection"] == "close"
    assert b"fact" not in body


def test_the_page_itself_and_a_link_to_it_are_answered(address: str) -> None:
    own = {"Origin": address.rstrip("/"), "Sec-Fetch-Site": "same-origin"}
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert b"event: page" in ask(address, "/events", **own)[1]
    for headers in own, link, {"Sec-Fetch-Site": "none"}, {}:
        assert ask(address, "/", **headers)[0].status == 200


def stream(address: str) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
    """A connection that hears of the flight, and has heard the first of it."""
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
    connection.request("GET", "/events")
    response = connection.getresponse()
    assert response.status == 200
    assert response.readline() == b"retry: 1000\n"
    return connection, response


def test_the_oldest_of_many_streams_makes_room(address: str) -> None:
    streams = [stream(address) for _ in range(70)]
    try:
        assert ask(address, "/")[0].status == 200
        assert "IncompleteRead" in _end_of(streams[0][1])
        newest = stream(address)
        streams.append(newest)
        assert newest[1].readline() == b"event: page\n"
    finally:
        for connection, _ in streams:
            connection.close()


def _end_of(response: http.client.HTTPResponse) -> str:
    """How a stream ended."""
    try:
        response.read()
    except (http.client.HTTPException, OSError) as error:
        return repr(error).replace("ConnectionResetError", "IncompleteRead")
    return "whole"


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
@pytest.mark.parametrize("path", PATHS)
def test_nothing_can_be_written(address: str, method: str, path: str) -> None:
    assert ask(address, path, method)[0].status == 405


@pytest.mark.parametrize(
    "path",
    [
        "/../app.py", "/%2e%2e/app.py", "/..%2fapp.py", "//etc/passwd", "/page.py", "/photos/7/1/0.jpg",
        "/photos/0/9/0.jpg", "/photos/0/1/9999.jpg", "/photos/0/1/-1.jpg", "/photos/0/1/../../../app.py",
    ],
)  # fmt: skip
def test_nothing_else_is_served(address: str, path: str) -> None:
    assert ask(address, path)[0].status == 404


def test_it_listens_on_loopback_alone(address: str) -> None:
    port = urlsplit(address).port
    listening = [
        line.split()[1]
        for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
        if line.split()[3] == "0A"
    ]
    assert [each for each in listening if each.endswith(f":{port:04X}")] == [f"0100007F:{port:04X}"]
    in_six = [line.split()[1] for line in Path("/proc/net/tcp6").read_text().splitlines()[1:]]
    assert not any(each.endswith(f":{port:04X}") for each in in_six)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_says_goodbye_and_ends_while_a_page_is_open(log: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "upwash", "view", str(log), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip().removeprefix("view ready at ")
        connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
        connection.request("GET", "/events")
        page = connection.getresponse()
        assert page.readline() == b"retry: 1000\n"
        process.send_signal(number)
        assert page.read().endswith(b"event: end\ndata: null\n\n")
        connection.close()
        assert process.wait(timeout=60) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""


@pytest.fixture(scope="module")
def finds(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A log with findings on a photo that can be had, and the address of the page about it."""
    log = flight(tmp_path_factory.mktemp("logs") / "finds.jsonl", "look here", [BOX], source="park 2")
    with ready_program("view", log.parent, "view", str(log), "--port", "0") as address:
        yield log, address


@pytest.mark.parametrize("name", ["csv", "geojson", "kml", "zip"])
def test_the_findings_are_served_as_the_report_writes_them(
    finds: tuple[Path, str], tmp_path: Path, name: str
) -> None:
    log, address = finds
    assert main(["report", str(log), "--findings", str(tmp_path / f"f.{name}")]) == 0
    response, body = ask(address, f"/findings.{name}")
    assert body == (tmp_path / f"f.{name}").read_bytes()
    assert response.headers["Content-Disposition"] == f'attachment; filename="findings.{name}"'


def test_a_finding_with_a_box_has_a_picture(finds: tuple[Path, str]) -> None:
    _, address = finds
    response, body = ask(address, "/crops/0/1/0.jpg")
    assert (response.status, response.headers["Content-Type"]) == (200, "image/jpeg")
    assert body.startswith(b"\xff\xd8\xff")
    for path in ("/crops/0/1/1.jpg", "/crops/0/2/0.jpg", "/crops/1/1/0.jpg", "/findings.xlsx"):
        assert ask(address, path)[0].status == 404, path


def test_a_port_in_use_is_told(address: str, log: Path) -> None:
    command = [sys.executable, "-m", "upwash", "view", str(log), "--port", str(urlsplit(address).port)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 2
    assert "give another, or 0" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("port", ["66000", "-1", "many"])
def test_what_is_no_port_is_refused(log: Path, port: str) -> None:
    with pytest.raises(SystemExit):
        main(["view", str(log), f"--port={port}"])
