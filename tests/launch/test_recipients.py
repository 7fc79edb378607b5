"""Programs, webhooks and TAK as recipients of findings: what they get, and what is said of those that fail."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from tests.waiting import wait_for

from upwash.config.user import UserConfig
from upwash.errors import UsageError
from upwash.launch.recipients import (
    CursorOnTarget,
    NotTaken,
    Program,
    Recipient,
    Webhook,
    as_event,
    recipients_of,
)

FACTS: dict[str, Any] = {
    "uid": "upwash-heron-20260501T120000.000000-1",
    "drone": "heron",
    "label": "hot-spot",
    "score": 0.874,
    "time": "2026-05-01T12:00:16.500Z",
    "latitude_deg": 39.5,
    "longitude_deg": 22.5,
    "error_m": 2.1,
    "place_is": "the object's own place",
}
TOKEN = "t0ken"
LATE = "no answer within 0.3 s"


class Server(ThreadingHTTPServer):
    """Keeps what was posted; `stopped` ends answers that would not end."""

    daemon_threads = True

    def __init__(self, context: ssl.SSLContext | None = None) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        if context is not None:
            self.socket = context.wrap_socket(self.socket, server_side=True, do_handshake_on_connect=False)
        self.got: list[tuple[str, dict[str, str], Any]] = []
        self.stopped = threading.Event()

    def url(self, path: str, scheme: str = "http") -> str:
        return f"{scheme}://127.0.0.1:{self.server_address[1]}{path}"

    def handle_error(self, *_: object) -> None:
        """A client that has gone is not news."""


class Handler(BaseHTTPRequestHandler):
    """Answers with the status, or the fault, that the path names."""

    server: Server

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.got.append((self.path, dict(self.headers), body))
        match self.path.strip("/").partition("?")[0]:
            case "closes":
                return
            case "silent":
                self.server.stopped.wait(60.0)
            case "drips":
                self._without_end(b"H")
            case "garbage":
                self.wfile.write(b"\xff\x00 me too\r\n\r\n")
            case "endless":
                self.send_response(200)
                self.end_headers()
                self._without_end(b"x" * 4096, pause_s=0.0)
            case status if not status.isdigit():
                self.send_error(501)
            case status:
                self.send_response(int(status))
                self.send_header("Location", "/204")
                self.end_headers()

    def do_GET(self) -> None:
        self.server.got.append((self.path, {}, None))

    def _without_end(self, part: bytes, pause_s: float = 0.05) -> None:
        with contextlib.suppress(OSError):
            while not self.server.stopped.wait(pause_s):
                self.wfile.write(part)

    def log_message(self, *_: object) -> None:
        pass


@contextlib.contextmanager
def serving(context: ssl.SSLContext | None = None) -> Iterator[Server]:
    with Server(context) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.stopped.set()
            server.shutdown()
            thread.join()


@pytest.fixture
def server() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """From its call on a recipient has 0.3 s; a loaded computer may need that for an answer by itself."""
    return lambda: monkeypatch.setattr("upwash.launch.recipients._LIMIT_S", 0.3)


async def why(recipient: Recipient) -> tuple[str, bool]:
    """Why it does not take a finding, and whether for good."""
    with pytest.raises(NotTaken) as failure:
        await recipient.take(FACTS)
    return str(failure.value), failure.value.for_good


async def test_a_webhook_gets_a_finding_as_json_with_the_token(server: Server, tmp_path: Path) -> None:
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    (hook,) = recipients_of(UserConfig(webhook=server.url("/204?of=us"), token_file=tmp_path / "token"))
    await hook.take(FACTS)
    ((path, headers, body),) = server.got
    assert (path, body) == ("/204?of=us", FACTS)
    assert headers["Content-Type"] == "application/json"
    assert headers["Authorization"] == f"Bearer {TOKEN}"


@pytest.mark.parametrize(
    ("path", "said", "for_good"),
    [
        ("/301", "it answered 301 Moved Permanently", True),
        ("/404", "it answered 404 Not Found", True),
        ("/408", "it answered 408 Request Timeout", False),
        ("/429", "it answered 429 Too Many Requests", False),
        ("/503", "it answered 503 Service Unavailable", False),
        ("/799", "it answered 799", False),
        ("/closes", "it closed the connection without an answer", False),
        ("/silent", LATE, False),
        ("/drips", LATE, False),
        ("/garbage", "its answer is not HTTP", False),
    ],
)
async def test_a_webhook_that_does_not_take_a_finding_says_why_without_secrets(
    server: Server, hurry: Callable[[], None], path: str, said: str, for_good: bool
) -> None:
    if said == LATE:
        hurry()
    hook = Webhook(server.url(f"{path}?key=secret"), TOKEN)
    assert await why(hook) == (said, for_good)
    assert [asked for asked, _, _ in server.got] in ([], [f"{path}?key=secret"]), "no redirect is followed"
    assert hook.name == "the webhook at 127.0.0.1"


async def test_the_body_of_an_answer_may_have_no_end(server: Server) -> None:
    await Webhook(server.url("/endless"), None).take(FACTS)


async def test_a_webhook_that_is_not_there_or_has_a_wrong_certificate_is_said(
    keys: Path, server: Server, hurry: Callable[[], None]
) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(keys / "s1.pem", keys / "s1.key")
    with serving(context) as secret:
        said, _ = await why(Webhook(secret.url("/204", "https"), None))
        assert said.startswith("its certificate is not trusted: ")
        assert secret.got == []
    assert (await why(Webhook(secret.url("/204"), None)))[0] == "it is not reached: Connection refused"
    hurry()  # the server waits for a line, and the name may be asked of a network that is not there
    said, _ = await why(Webhook(server.url("/204", "https"), None))
    assert said.startswith("TLS failed: ") or said == LATE
    for nowhere in (
        Webhook("http://nowhere.invalid/204", None),
        CursorOnTarget("udp://nowhere.invalid:6969"),
    ):
        said, for_good = await why(nowhere)
        assert said.startswith("it is not reached: ") or said == LATE
        assert not for_good


@pytest.mark.system
async def test_a_command_gets_a_finding_on_its_standard_input(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "told.sh"
    script.write_text('#!/bin/sh\ncat > "$1"\necho printed; echo complained >&2\n')
    script.chmod(0o755)
    await Program(str(script), str(tmp_path / "got; echo injected")).take(FACTS)
    assert json.loads((tmp_path / "got; echo injected").read_text()) == FACTS
    assert capfd.readouterr() == ("", "")


@pytest.mark.system
@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("exit 3", "it ended with exit code 3"),
        ("kill -KILL $$", "it ended with SIGKILL"),
        ("sleep 60 & echo $! > child; wait", "it did not end within 0.3 s"),
    ],
)
async def test_a_command_that_fails_or_does_not_end_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hurry: Callable[[], None], script: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if "sleep" in script:
        hurry()
    assert await why(Program("sh", "-c", script)) == (said, False)
    if (child := tmp_path / "child").exists() and (pid := child.read_text().strip()):
        await asyncio.to_thread(wait_for, lambda: not Path(f"/proc/{pid}/exe").exists())


@pytest.mark.system
async def test_a_command_ends_with_a_flight_that_ends_at_once(tmp_path: Path) -> None:
    task = asyncio.ensure_future(Program("sh", "-c", f"echo $$ > {tmp_path}/pid; sleep 60").take(FACTS))
    await asyncio.to_thread(wait_for, lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


@pytest.mark.system
async def test_a_command_that_has_gone_is_said(tmp_path: Path) -> None:
    assert await why(Program(str(tmp_path / "gone"))) == (
        "it cannot be run: No such file or directory",
        False,
    )


@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]"])
async def test_tak_gets_a_finding_with_degrees_as_one_datagram(host: str) -> None:
    family = socket.AF_INET6 if "[" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as tak:
        tak.bind((host.strip("[]"), 0))
        tak.settimeout(10.0)
        recipient = CursorOnTarget(f"udp://{host}:{tak.getsockname()[1]}")
        await recipient.take({**FACTS, "latitude_deg": None})
        await recipient.take(FACTS)
        event = ElementTree.fromstring(tak.recv(65_536))
    assert event.attrib == {
        "version": "2.0",
        "uid": FACTS["uid"],
        "type": "b-m-p-s-m",
        "how": "m-g",
        "time": "2026-05-01T12:00:16.500Z",
        "start": "2026-05-01T12:00:16.500Z",
        "stale": "2026-05-02T12:00:16.500Z",
    }
    (point, detail) = event
    assert point.attrib == {"lat": "39.5", "lon": "22.5", "hae": "9999999.0", "ce": "2.1", "le": "9999999.0"}
    assert [part.tag for part in detail] == ["contact", "remarks"]
    assert detail[0].get("callsign") == "hot-spot 87 %"
    assert detail[1].text == "hot-spot 87 %; the object's own place; heron"


@pytest.mark.parametrize("label", ['</contact>&"<>' * 5000, "\U0001f525" * 64_000, "a\nb\x00\x1b[2J\ud800￾"])
def test_no_label_breaks_an_event_or_outgrows_a_datagram(label: str) -> None:
    event = as_event({**FACTS, "label": label, "drone": "d" * 5000, "error_m": None})
    assert len(event) <= 1400
    (point, detail) = ElementTree.fromstring(event)
    assert point.get("ce") == "9999999.0"
    callsign = detail[0].get("callsign") or ""
    assert callsign.isprintable()
    assert callsign[:2] == label[:2].replace("\n", "\\")


async def test_a_webhook_goes_through_the_proxy_of_the_environment_and_a_token_in_the_clear_does_not(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", server.url("").replace("//", "//me:s%40fe@"))
    hook = Webhook("http://hooks.invalid/204?x=1", None)
    assert hook.name == "the webhook at hooks.invalid, through the proxy 127.0.0.1"
    with pytest.raises(NotTaken, match="501"):  # the stand-in knows no target with a host
        await hook.take(FACTS)
    ((target, headers, _),) = server.got
    assert (target, headers["Proxy-Authorization"]) == ("http://hooks.invalid/204?x=1", "Basic bWU6c0BmZQ==")
    assert "proxy" not in Webhook("http://hooks.invalid/204", TOKEN).name
    monkeypatch.setenv("no_proxy", "hooks.invalid")
    assert "proxy" not in Webhook("http://hooks.invalid/204", None).name


async def test_a_webhook_over_tls_asks_the_proxy_for_a_tunnel(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("https_proxy", f"127.0.0.1:{server.server_address[1]}")
    said, for_good = await why(Webhook("https://hooks.invalid/204", None))
    assert "Tunnel connection failed: 501" in said and not for_good
    monkeypatch.setenv("https_proxy", "socks5://127.0.0.1:1")
    with pytest.raises(UsageError, match="https_proxy: expected an http:// URL"):
        Webhook("https://hooks.invalid/204", None)
