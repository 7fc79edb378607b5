"""Takes reviews of findings from the page, and keeps them beside the logs: all that a page can write.

A review counts only from the page that this program serves: a browser says which page sends it, and the page has a
token of this program's run. Other users of the machine may look, but the review must come from the user who runs the
program.
"""

from __future__ import annotations

import asyncio
import getpass
import os
import secrets
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta
from starlette.requests import Request
from starlette.responses import Response

from upwash.core.admission.limits import Allowance
from upwash.errors import NotWritten
from upwash.report.reviews import (
    LONGEST_LABEL,
    LONGEST_NAME,
    LONGEST_NOTE,
    FindingKey,
    Review,
    Verdict,
    append_review,
)
from upwash.support.loopback import user_of
from upwash.support.text import printable
from upwash.view.feed import Feed, Reviewing

_MOST_BYTES = 2**14  # of a request
_PATIENCE_S = 5.0
_PER_S, _AT_ONCE = 5.0, 50  # requests
_TOKEN = "X-Upwash-Token"  # noqa: S105 - the name of a header


def new_reviewing() -> Reviewing:
    """A token for this run, and the name of the user who runs it; empty where the system has none."""
    try:
        user = os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):
        user = ""
    return Reviewing(secrets.token_urlsafe(32), printable(user, LONGEST_NAME))


class _Refused(Exception):
    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


class _Sent(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    log: Annotated[int, Meta(ge=0)]
    finding: FindingKey
    verdict: Verdict
    label: Annotated[str, Meta(max_length=LONGEST_LABEL)] = ""
    note: Annotated[str, Meta(max_length=LONGEST_NOTE)] = ""
    reviewer: Annotated[str, Meta(max_length=LONGEST_NAME)] = ""


class Desk:
    """Where the page hands in reviews."""

    def __init__(self, feed: Feed, reviewing: Reviewing) -> None:
        self._feed = feed
        self._token = reviewing.token.encode()
        self._pace = Allowance(_PER_S, at_once=_AT_ONCE)
        self._writing = asyncio.Lock()
        self._users = {os.getuid(), 0}
        if (user := os.environ.get("SUDO_UID", "")).isdecimal():
            self._users.add(int(user))

    async def take(self, request: Request) -> Response:
        """Keeps the review; an answer with a sentence where it does not."""
        try:
            self._require_own_page(request)
            sent = await self._read(request)
            log = self._log_of(sent)
            review = Review(
                time=datetime.now(UTC),
                finding=sent.finding,
                verdict=sent.verdict,
                label=sent.label,
                note=sent.note,
                reviewer=sent.reviewer,
            )
            async with self._writing:
                await asyncio.to_thread(append_review, log, review)
        except _Refused as refused:
            return Response(str(refused), status_code=refused.status, headers={"Connection": "close"})
        except NotWritten as error:
            return Response(str(error), status_code=507)
        return Response(status_code=204)

    def _require_own_page(self, request: Request) -> None:
        """Raises _Refused for what is not the page in the browser of the user who runs this program."""
        headers = request.headers
        own = f"http://{headers.get('host', '')}".lower()
        if [origin.lower() for origin in headers.getlist("origin")] != [own]:
            raise _Refused(403, "reviews are taken from this program's own page alone")
        if not secrets.compare_digest(headers.get(_TOKEN, "").encode(), self._token):
            raise _Refused(403, "this page is of an earlier run of the program: load it again")
        client, server = request.client, request.scope.get("server")
        try:
            user = user_of((client.host, client.port), tuple(server)) if client and server else None
        except OSError:
            user = None
        if user not in self._users:
            raise _Refused(
                403,
                "reviews are taken from the user who started this program alone: download them, or run upwash view",
            )
        if not self._pace.take(1, now_s=time.monotonic()):
            raise _Refused(429, "too many reviews at once: wait a few seconds")
        if headers.get("content-type") != "application/json":
            raise _Refused(415, "a review is sent as application/json")

    async def _read(self, request: Request) -> _Sent:
        body = bytearray()
        try:
            async with asyncio.timeout(_PATIENCE_S):
                async for piece in request.stream():
                    body += piece
                    if len(body) > _MOST_BYTES:
                        raise _Refused(413, f"a review has at most {_MOST_BYTES // 2**10} KiB")
        except TimeoutError:
            raise _Refused(408, f"the review did not arrive within {_PATIENCE_S:g} s") from None
        try:
            return _DECODER.decode(body)
        except (ValueError, RecursionError) as error:
            raise _Refused(422, f"this is no review: {printable(str(error), 200)}") from None

    def _log_of(self, sent: _Sent) -> Path:
        recordings = self._feed.recordings
        recording = recordings[sent.log] if sent.log < len(recordings) else None
        if recording is None or all(found.key != sent.finding for found in recording.news.story.findings):
            raise _Refused(404, "the log has no such finding any more: load the page again")
        return recording.log


_DECODER = msgspec.json.Decoder(_Sent)
