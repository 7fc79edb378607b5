"""Reviews that the page hands in: kept beside the log, for this program's own page and its own user alone."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from tests.report.test_findings import BOX, flight
from tests.view.test_page import ask

from upwash.cli.main import main
from upwash.launch.processes import ready_program
from upwash.report.record import read_records, reviewed_of
from upwash.report.reviews import review_file

pytestmark = pytest.mark.system

REVIEW = {
    "log": 0,
    "finding": {"t_s": 16, "message": 0, "index": 0},
    "verdict": "rejected",
    "reviewer": "anna",
}
NOBODY = 65534
PYTHON = shutil.which("python3", path="/usr/bin:/bin")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return flight(tmp_path / "f.jsonl", [BOX, {**BOX, "left_px": 300.0}])


@pytest.fixture
def address(log: Path) -> Iterator[str]:
    with ready_program("view", log.parent, "view", str(log), "--port", "0") as address:
        yield address


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a page beside whose log no review is written."""
    log = flight(tmp_path_factory.mktemp("untouched") / "f.jsonl", [BOX, {**BOX, "left_px": 300.0}])
    with ready_program("view", log.parent, "view", str(log), "--port", "0") as address:
        yield address
        assert not review_file(log).exists()


def told(address: str, kind: str) -> Any:
    """The first message of that kind."""
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
    try:
        connection.request("GET", "/events")
        answer = connection.getresponse()
        while answer.readline().strip() != f"event: {kind}".encode():
            pass
        return json.loads(answer.readline().removeprefix(b"data: "))
    finally:
        connection.close()


def headers_of(address: str) -> dict[str, str]:
    """What the page sends."""
    token = told(address, "page")["reviewing"]["token"]
    return {"Origin": address.rstrip("/"), "Content-Type": "application/json", "X-Upwash-Token": token}


def send(address: str, headers: dict[str, str], review: object = REVIEW) -> tuple[int, str]:
    connection = http.client.HTTPConnection(urlsplit(address).netloc, timeout=60)
    try:
        connection.request("POST", "/review", json.dumps(review), headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def test_a_review_is_kept_beside_the_log_and_shown_at_once(address: str, log: Path) -> None:
    before = log.read_bytes()
    assert send(address, headers_of(address)) == (204, "")
    assert log.read_bytes() == before
    assert reviewed_of(read_records([log])).tally.words == "1 of 2 reviewed, 1 rejected"
    with review_file(log).open() as kept:
        assert json.loads(kept.readline())["reviewer"] == "anna"
    for _ in range(100):  # a look at the file every 50 ms
        (found,) = told(address, "findings")
        if found["reviews"]:
            break
    assert found["reviews"]["1"]["verdict"] == "rejected"
    assert found["words"] == "1 hot-spot"
    assert b"\n1," not in ask(address, "/findings.csv")[1]


def without(headers: dict[str, str], name: str) -> dict[str, str]:
    return {each: value for each, value in headers.items() if each != name}


def test_what_is_not_the_page_itself_writes_nothing(untouched: str) -> None:
    address, own = untouched, headers_of(untouched)
    port = urlsplit(address).port
    for headers in (
        without(own, "Origin"),
        {**own, "Origin": "null"},
        {**own, "Origin": "https://elsewhere.example"},
        {**own, "Origin": f"http://localhost:{port}"},
        {**own, "Sec-Fetch-Site": "same-site"},
        without(own, "X-Upwash-Token"),
        {**own, "X-Upwash-Token": "guess"},
        {**own, "X-Upwash-Token": "\xfc"},
    ):
        status, why = send(address, headers)
        assert (status, bool(why)) == (403, True), headers
    assert send(address, {**own, "Host": "upwash.example"})[0] == 421
    assert send(address, {**own, "Content-Type": "text/plain"})[0] == 415
    assert ask(address, "/review", **own)[0].status == 405


ODD = [
    (404, {**REVIEW, "finding": {"t_s": 16, "message": 0, "index": 2}}),
    (404, {**REVIEW, "log": 1}),
    (422, {**REVIEW, "verdict": "perhaps"}),
    (422, {**REVIEW, "path": "/etc/passwd"}),
    (422, {**REVIEW, "log": "../f"}),
    (422, {**REVIEW, "label": "x" * 101}),
    (422, {**REVIEW, "note": "x" * 1001}),
    (422, []),
    (413, {**REVIEW, "note": "x" * 20_000}),
]


def test_odd_reviews_are_refused_with_a_sentence(untouched: str) -> None:
    own = headers_of(untouched)
    for status, review in ODD:
        answer = send(untouched, own, review)
        assert (answer[0], bool(answer[1])) == (status, True), review


def test_too_many_reviews_have_to_wait(address: str) -> None:
    own = headers_of(address)
    statuses = [send(address, own)[0] for _ in range(80)]
    assert statuses[:50] == [204] * 50
    assert 429 in statuses


def test_a_review_that_cannot_be_kept_is_told(address: str, log: Path) -> None:
    review_file(log).mkdir()
    status, why = send(address, headers_of(address))
    assert status == 507
    assert "f.review.jsonl: cannot be written" in why and "the review was not kept" in why


@pytest.mark.skipif(os.getuid() != 0 or PYTHON is None, reason="takes another user, and Python for all users")
def test_other_users_of_the_machine_write_nothing(address: str, log: Path) -> None:
    script = (
        "import http.client, sys; c = http.client.HTTPConnection(sys.argv[1]); "
        "c.request('POST', '/review', sys.argv[2], eval(sys.argv[3])); print(c.getresponse().status)"
    )
    command = [str(PYTHON), "-I", "-S", "-c", script, urlsplit(address).netloc, json.dumps(REVIEW)]
    own = headers_of(address)
    claims = {**own, "X-Forwarded-For": "127.0.0.1"}
    for user, headers, status in ((NOBODY, own, "403"), (NOBODY, claims, "403"), (0, own, "204")):
        done = subprocess.run(
            [*command, repr(headers)],
            capture_output=True,
            text=True,
            check=True,
            user=user,
            cwd="/",
        )
        assert done.stdout.strip() == status
    assert len(review_file(log).read_bytes().splitlines()) == 1


def test_a_page_that_is_a_file_has_no_token(log: Path, tmp_path: Path) -> None:
    assert main(["report", str(log), "-o", str(tmp_path / "f.html")]) == 0
    assert '"review_files":["f.review.jsonl"],"reviewing":null' in (tmp_path / "f.html").read_text()
