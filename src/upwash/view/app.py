"""The web application: the page, its feed and its photos, for browsers on this machine and for nothing else."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Sequence
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from upwash.report.crops import crop_of
from upwash.report.finding_files import FORMATS, findings_file
from upwash.report.photos import PhotoShelf
from upwash.support.addresses import names_this_machine
from upwash.view.desk import Desk
from upwash.view.document import document, sources
from upwash.view.feed import Feed
from upwash.view.news import News
from upwash.view.tiles import BaseMap, kind_of

_LISTENS_AT = "127.0.0.1"
_POLICY = (
    "default-src 'none'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    f"{sources()}; img-src 'self' data:"
)
_KEPT_CROPS = 256
_LONGEST_PATH = 1_000  # characters: Python reads no number of more than 4,300 digits
_HANGS_UP = {"Connection": "close"}
_HEADERS = {
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


def headers_of_answers(*, images: Sequence[str]) -> dict[str, str]:
    """What a browser may do with any answer; `images` are further sources of images, in a policy's words."""
    return {**_HEADERS, "Content-Security-Policy": " ".join((_POLICY, *images))}


def application(feed: Feed, photos: PhotoShelf, beneath: BaseMap | None = None) -> Starlette:
    """Serves the page of the feed; nothing but reviews of findings can be written, by the page itself.

    `beneath` is the map.
    """
    rendering = asyncio.Semaphore(1)
    packing = asyncio.Semaphore(1)
    crop_for = functools.lru_cache(_KEPT_CROPS)(lambda finding: crop_of(finding, photos))

    async def page(request: Request) -> Response:
        return HTMLResponse("".join(document("upwash: flight")))

    async def events(request: Request) -> Response:
        after = request.headers.get("last-event-id", "")
        return StreamingResponse(feed.messages(after), media_type="text/event-stream")

    async def picture(
        request: Request, of: Callable[[News], Sequence[Any]], make: Callable[[Any], bytes | None]
    ) -> Response:
        log, run, number = (request.path_params[name] for name in ("log", "run", "number"))
        recording = feed.recordings[log] if log < len(feed.recordings) else None
        pictured = () if recording is None or recording.run != run else of(recording.news)
        if number >= len(pictured):
            return Response("the log has no such photo or finding", status_code=404)
        async with rendering:
            jpeg = await asyncio.to_thread(make, pictured[number])
        if jpeg is None:
            return Response("this program cannot find or make the picture", status_code=404)
        return Response(jpeg, media_type="image/jpeg")

    async def photo(request: Request) -> Response:
        return await picture(request, lambda news: news.shots, photos.find)

    async def crop(request: Request) -> Response:
        return await picture(request, lambda news: news.story.findings, crop_for)

    async def tile(request: Request) -> Response:
        z, x, y = (request.path_params[name] for name in "zxy")
        found = None
        if beneath and beneath.find and z <= beneath.tiles.to_zoom and max(x, y) < 2**z:
            found = await asyncio.to_thread(beneath.find, z, x, y)
        if found is None or (kind := kind_of(found)) is None:
            return Response(status_code=204)  # beyond the map's border there is nothing, which is no error
        return Response(found, media_type=kind)

    async def findings(request: Request) -> Response:
        name = request.path_params["format"]
        if name not in FORMATS:
            return Response("no such format", status_code=404)
        async with packing:
            content = await asyncio.to_thread(findings_file, name, feed.flights, photos)
        saved = {"Content-Disposition": f'attachment; filename="findings.{name}"'}
        return Response(content, media_type=FORMATS[name], headers=saved)

    desk = [Route("/review", Desk(feed, feed.reviewing).take, methods=["POST"])] if feed.reviewing else []
    return Starlette(
        routes=[
            *desk,
            Route("/", page),
            Route("/events", events),
            Route("/photos/{log:int}/{run:int}/{number:int}.jpg", photo),
            Route("/crops/{log:int}/{run:int}/{number:int}.jpg", crop),
            Route("/findings.{format}", findings),
            Route("/tiles/{z:int}/{x:int}/{y:int}", tile),
        ],
        middleware=[Middleware(_OwnHost)],
    )


class _OwnHost:
    """Refuses what pages from elsewhere ask for, also where their name was made to mean this machine.

    Browsers say with each request which page makes it. A link from elsewhere to the page itself is followed.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        reached_at = (scope.get("server") or (_LISTENS_AT,))[0]
        app: ASGIApp = self._app
        if len(hosts) != 1 or not names_this_machine(
            hosts[0], known_as=(_LISTENS_AT,), reached_at=reached_at
        ):
            app = Response("this page is another machine's", status_code=421, headers=_HANGS_UP)
        elif not _is_own(headers, hosts[0]):
            app = Response("another page may not ask for this", status_code=403, headers=_HANGS_UP)
        elif len(scope["path"]) > _LONGEST_PATH:
            app = Response("there is nothing at so long a path", status_code=404, headers=_HANGS_UP)
        await app(scope, receive, send)


def _is_own(headers: Headers, host: str) -> bool:
    """Whether the page of that host asks, or a person by an address or a link, or no browser."""
    if any(origin.lower() != f"http://{host}".lower() for origin in headers.getlist("origin")):
        return False
    follows_link = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
    return follows_link or set(headers.getlist("sec-fetch-site")) <= {"same-origin", "none"}
