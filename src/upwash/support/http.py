"""HTTP servers by uvicorn, with bounds, so that no client holds up others. Nothing else of upwash uses uvicorn.

A request has 5 s to arrive and 16 KiB. Of more than 64 connections the oldest is closed: if new ones were refused,
any program in reach could lock the others out.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Generator, Mapping
from typing import Any, cast

import h11
import uvicorn
from uvicorn.protocols.http.flow_control import CLOSE_HEADER
from uvicorn.protocols.http.h11_impl import H11Protocol

_CONNECTIONS = 64
_REQUEST_S = 5.0  # for a request to be whole
_READING_S = 10.0  # for the last answer of a connection to be read
_LARGEST_HEAD_BYTES = 2**14
_PIECE_BYTES = 2**10
_BAD_REQUEST = b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class HttpServer(uvicorn.Server):
    """Serves an ASGI application, each answer with these headers; leaves signals to the program.

    Only with the header `Connection: close` an answer must be read within 10 s.
    """

    def __init__(self, application: Any, *, headers: Mapping[str, str], goodbye_s: int) -> None:
        super().__init__(
            uvicorn.Config(
                application,
                http=_Impatient,
                h11_max_incomplete_event_size=_LARGEST_HEAD_BYTES,
                backlog=_CONNECTIONS,  # also the most that are accepted before the oldest is closed
                headers=list(headers.items()),
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="error",  # strangers could fill the log with warnings
                access_log=False,
                proxy_headers=False,  # any program can send them
                server_header=False,
                timeout_graceful_shutdown=goodbye_s,
            )
        )

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Nothing, as the program does it."""
        yield


class _Impatient(H11Protocol):
    """One connection, with the bounds that uvicorn lacks."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._timer = self.loop.call_later(_REQUEST_S, self._hang_up)
        opened = cast("set[_Impatient]", self.connections)
        if len(opened) > _CONNECTIONS:
            oldest = min(opened, key=lambda each: each._since_s)
            opened.remove(oldest)
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Takes it in pieces, as h11 bounds only what is not whole yet."""
        for start in range(0, len(data), _PIECE_BYTES):
            if self.conn.their_state is not h11.ERROR:
                super().data_received(data[start : start + _PIECE_BYTES])

    def send_400_response(self, msg: str) -> None:
        """Goes on reading: the kernel drops the answer of a connection that is closed with unread data."""
        if self._is_answering():
            self.transport.abort()
        else:
            self.transport.write(_BAD_REQUEST)
            self.transport.write_eof()
            self._abort_later()

    def on_response_complete(self) -> None:
        if CLOSE_HEADER in self.config.encoded_headers:
            self._abort_later()
        else:
            self._timer.cancel()
            self._timer = self.loop.call_later(_REQUEST_S, self._hang_up)
        super().on_response_complete()

    def shutdown(self) -> None:
        """Waits for answers that are being made, not for readers."""
        if self.transport.is_closing():
            self.transport.abort()
        else:
            super().shutdown()

    def _abort_later(self) -> None:
        self._timer.cancel()
        self._timer = self.loop.call_later(_READING_S, self.transport.abort)

    def _hang_up(self) -> None:
        if not self._is_answering():
            self.transport.close()

    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete
