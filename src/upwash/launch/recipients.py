"""Who gets the findings of a flight: a program, a webhook, and TAK. Each takes one finding at a time, within 10 s."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import functools
import http.client
import os
import re
import shutil
import signal
import socket
import ssl
import threading
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from http import HTTPStatus
from pathlib import Path
from typing import Any, Protocol, TypeAlias
from urllib.parse import SplitResult, unquote, urlsplit
from urllib.request import getproxies_environment, proxy_bypass
from xml.etree import ElementTree

import msgspec

from upwash.config.user import UserConfig
from upwash.errors import ConfigError, UpwashError, UsageError
from upwash.support.background import in_thread
from upwash.support.input_files import read_named_text
from upwash.support.text import printable, signal_name

Facts: TypeAlias = Mapping[str, Any]

_LIMIT_S = 10.0
_TIMES_OUT = (HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_MANY_REQUESTS)
_TOKEN = re.compile(r"[!-~]+")
_LARGEST_TOKEN_BYTES = 10_000
_UNKNOWN = "9999999.0"  # in Cursor on Target, of heights and errors
_STALE = timedelta(days=1)
_MULTICAST_HOPS = 64
_LARGEST_DATAGRAM_BYTES = 1400
_LONGEST_NAME = 40  # characters, on a map


class NotTaken(UpwashError):
    """A recipient did not take a finding; `for_good` says that it would not take the same finding later either."""

    def __init__(self, why: str, *, for_good: bool = False) -> None:
        super().__init__(why)
        self.for_good = for_good


class Recipient(Protocol):
    """Takes findings; its name has no secrets."""

    @property
    def name(self) -> str:
        """Who it is, for messages."""

    async def take(self, facts: Facts) -> None:
        """Gives it one finding; raises NotTaken."""


def recipients_of(user: UserConfig) -> list[Recipient]:
    """Those of the configuration; raises UsageError or ConfigError where this computer cannot reach one."""
    return list(_recipients(user))


def _recipients(user: UserConfig) -> Iterator[Recipient]:
    if user.command:
        if shutil.which(user.command[0]) is None:
            raise UsageError(
                f"user.command: {user.command[0]} is no program that can be run: check its path, and make the file "
                "executable (chmod +x)"
            )
        yield Program(*user.command)
    if user.webhook is not None:
        yield Webhook(user.webhook, None if user.token_file is None else _token(user.token_file))
    if user.cursor_on_target is not None:
        yield CursorOnTarget(user.cursor_on_target)


def _token(file: Path) -> str:
    token = read_named_text(file, most_bytes=_LARGEST_TOKEN_BYTES).strip()
    if not _TOKEN.fullmatch(token):
        raise ConfigError(str(file), "", "expected one token: ASCII characters, without blanks")
    return token


def _as_json(facts: Facts) -> bytes:
    return msgspec.json.encode(facts)


class Program:
    """A command that runs for each finding, with the finding as a line of JSON on its standard input."""

    def __init__(self, *words: str) -> None:
        self._words = words
        self.name = f"the command {words[0]}"

    async def take(self, facts: Facts) -> None:
        """Runs it; a command that does not end in time is killed, with the programs that it has started."""
        nowhere = asyncio.subprocess.DEVNULL
        try:
            process = await asyncio.create_subprocess_exec(
                *self._words,
                stdin=asyncio.subprocess.PIPE,
                stdout=nowhere,
                stderr=nowhere,
                start_new_session=True,
            )
        except OSError as error:
            raise NotTaken(f"it cannot be run: {error.strerror}") from None
        try:
            async with asyncio.timeout(_LIMIT_S):
                await process.communicate(_as_json(facts) + b"\n")
        except TimeoutError:
            raise NotTaken(f"it did not end within {_LIMIT_S:g} s") from None
        finally:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                await process.wait()
        if process.returncode:
            code = process.returncode
            raise NotTaken(f"it ended with {f'exit code {code}' if code > 0 else signal_name(-code)}")


class Webhook:
    """A URL that gets each finding by POST. A status of 2xx takes it; redirects are not followed.

    The proxy of the environment (`http_proxy`, `https_proxy`, `no_proxy`) is used, except for a token in the clear.
    Raises UsageError for a proxy that is no `http://` URL.
    """

    def __init__(self, url: str, token: str | None) -> None:
        self._url = urlsplit(url)
        self._context = ssl.create_default_context() if self._url.scheme == "https" else None
        self._target = (self._url.path or "/") + (f"?{self._url.query}" if self._url.query else "")
        self._proxy = None if token is not None and self._context is None else _proxy_for(self._url)
        self._headers = {"Content-Type": "application/json", "User-Agent": "upwash", "Connection": "close"}
        if token is not None:
            self._headers["Authorization"] = f"Bearer {token}"
        self.name = f"the webhook at {self._url.hostname}"  # the rest of many such URLs is a secret
        if self._proxy is not None:
            self.name += f", through the proxy {self._proxy.hostname}"
            if self._context is None:
                self._target = f"http://{self._url.netloc.rpartition('@')[2]}{self._target}"
                self._headers |= _authorization(self._proxy)

    async def take(self, facts: Facts) -> None:
        """Sends it; the connection is cut where no status came in time, and the body of an answer is not read."""
        connection, given_up = self._connection(), threading.Event()
        try:
            async with asyncio.timeout(_LIMIT_S):
                post = functools.partial(self._post, connection, _as_json(facts), given_up)
                status = await in_thread(post, name="a webhook")
        except (OSError, http.client.HTTPException) as error:
            raise NotTaken(_why(error)) from None
        finally:
            given_up.set()
            if (open_socket := connection.sock) is not None:  # the thread closes it and sets it to None
                with contextlib.suppress(OSError):
                    socket.socket.shutdown(open_socket, socket.SHUT_RDWR)
        if not 200 <= status < 300:
            again = status >= 500 or status in _TIMES_OUT
            said = f"it answered {status} {_phrase(status)}".rstrip()
            raise NotTaken(said, for_good=not again)

    def _connection(self) -> http.client.HTTPConnection:
        place = self._proxy or self._url
        host = place.hostname or ""
        if self._context is None:
            return http.client.HTTPConnection(host, place.port, timeout=_LIMIT_S)
        if self._proxy is None:
            return http.client.HTTPSConnection(host, place.port, timeout=_LIMIT_S, context=self._context)
        connection = http.client.HTTPSConnection(
            host, place.port or http.client.HTTP_PORT, timeout=_LIMIT_S, context=self._context
        )
        connection.set_tunnel(self._url.hostname or "", self._url.port, _authorization(self._proxy))
        return connection

    def _post(self, connection: http.client.HTTPConnection, body: bytes, given_up: threading.Event) -> int:
        """The status of the answer; in a thread."""
        try:
            connection.connect()
            if given_up.is_set():  # a look-up of the name can outlast the limit
                raise TimeoutError
            connection.request("POST", self._target, body, self._headers)
            return connection.getresponse().status
        finally:
            connection.close()


def _proxy_for(url: SplitResult) -> SplitResult | None:
    proxy = getproxies_environment().get(url.scheme)
    if not proxy or proxy_bypass(url.netloc.rpartition("@")[2]):
        return None
    split = urlsplit(proxy if "://" in proxy else f"http://{proxy}")
    if split.scheme != "http" or not split.hostname:
        raise UsageError(
            f"{url.scheme}_proxy: expected an http:// URL of a proxy; correct it, or set no_proxy"
        )
    return split


def _authorization(proxy: SplitResult) -> dict[str, str]:
    """The header with the user and the password of the proxy's URL; none for a URL without a user."""
    if proxy.username is None:
        return {}
    secret = f"{unquote(proxy.username)}:{unquote(proxy.password or '')}".encode()
    return {"Proxy-Authorization": f"Basic {base64.b64encode(secret).decode()}"}


def _why(error: OSError | http.client.HTTPException) -> str:
    match error:
        case TimeoutError():
            return f"no answer within {_LIMIT_S:g} s"
        case ssl.SSLCertVerificationError():
            return f"its certificate is not trusted: {error.verify_message}"
        case ssl.SSLError():
            return f"TLS failed: {(error.reason or 'no reason').replace('_', ' ').lower()}"
        case http.client.RemoteDisconnected():
            return "it closed the connection without an answer"
        case OSError():
            return (
                f"it is not reached: {error.strerror or printable(str(error), 100) or type(error).__name__}"
            )
    return "its answer is not HTTP"


def _phrase(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return ""


class CursorOnTarget:
    """An address, often a multicast group, that gets each finding with degrees as an event of Cursor on Target."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._place = parts.hostname, parts.port
        self.name = f"Cursor on Target at {parts.netloc}"

    async def take(self, facts: Facts) -> None:
        """Sends one datagram; a finding without degrees is left out."""
        if facts["latitude_deg"] is None or facts["time"] is None:
            return
        try:
            async with asyncio.timeout(_LIMIT_S):
                await in_thread(functools.partial(self._send, as_event(facts)), name="Cursor on Target")
        except OSError as error:
            raise NotTaken(_why(error)) from None

    def _send(self, event: bytes) -> None:
        family, _, _, _, place = socket.getaddrinfo(*self._place, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, socket.SOCK_DGRAM) as out:
            if family == socket.AF_INET6:
                out.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, _MULTICAST_HOPS)
            else:
                out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, _MULTICAST_HOPS)
            out.settimeout(_LIMIT_S)
            out.sendto(event, place)


def as_event(facts: Facts) -> bytes:
    """A finding as an event of Cursor on Target, with as much text as a datagram has room for."""
    label = facts["label"] if facts["score"] is None else f"{facts['label']} {100 * facts['score']:.0f} %"
    remarks = f"{label}; {facts['place_is']}; {facts['drone']}"
    for most in (1000, 300, 150, 75):
        event = _event(facts, printable(label, _LONGEST_NAME), printable(remarks, most))
        if len(event) <= _LARGEST_DATAGRAM_BYTES:
            break
    return event


def _event(facts: Facts, name: str, remarks: str) -> bytes:
    error_m, began = facts["error_m"], datetime.fromisoformat(facts["time"])
    stale = (began + _STALE).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    times = {"time": facts["time"], "start": facts["time"], "stale": stale}
    # The type is a spot on the map; `how` says that a machine derived the place from GPS.
    event = ElementTree.Element(
        "event", version="2.0", uid=facts["uid"], type="b-m-p-s-m", how="m-g", **times
    )
    ElementTree.SubElement(
        event,
        "point",
        lat=str(facts["latitude_deg"]),
        lon=str(facts["longitude_deg"]),
        hae=_UNKNOWN,
        ce=_UNKNOWN if error_m is None else str(error_m),
        le=_UNKNOWN,
    )
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign=name)
    ElementTree.SubElement(detail, "remarks").text = remarks
    return (
        '<?xml version="1.0" encoding="UTF-8"?>' + ElementTree.tostring(event, encoding="unicode")
    ).encode()
