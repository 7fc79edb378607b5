"""The server's end of TLS connections, each in a known amount of memory.

asyncio's own TLS keeps 256 KiB for each connection from its first byte on, and as much again for a slow reader. Here
a connection keeps at most one record of what has arrived, and what its socket does not take at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from typing import Any

from upwash.real.link.streams import StreamEnd, room

_RECORD_BYTES = 2**14  # the most that TLS carries at once
_MOST_HANDSHAKE_BYTES = 2**14  # from a peer that has shown nothing yet: a hello and a certificate take 2 KiB
_LAST_WORDS_S = 1.0


async def shake_hands(connection: socket.socket, context: ssl.SSLContext, *, within_s: float) -> StreamEnd:
    """The TLS connection, after its peer has shown a certificate of the context's authority; raises OSError."""
    end = StreamEnd()
    tls = _Tls(context, end)
    await asyncio.get_running_loop().connect_accepted_socket(lambda: tls, connection)
    try:
        async with asyncio.timeout(within_s):
            await tls.shaken
    except BaseException:
        tls.close()
        raise
    return end


class _Tls(asyncio.Transport, asyncio.BufferedProtocol):
    """TLS between a socket's transport, whose protocol it is, and a `StreamEnd`, whose transport it is."""

    def __init__(self, context: ssl.SSLContext, end: StreamEnd) -> None:
        super().__init__()
        self._end = end
        self.shaken: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._received_bytes = 0
        self._last_words: asyncio.TimerHandle | None = None

    # --- what the end calls ---------------------------------------------------------------------------------

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._tls if name == "ssl_object" else self._socket.get_extra_info(name, default)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        whole = memoryview(data)
        for start in range(0, len(whole), _RECORD_BYTES):
            self._tls.write(whole[start : start + _RECORD_BYTES])
            self._flush()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._socket.set_write_buffer_limits(high, low)

    def pause_reading(self) -> None:
        self._socket.pause_reading()

    def resume_reading(self) -> None:
        self._socket.resume_reading()

    def is_closing(self) -> bool:
        return self._socket.is_closing()

    def close(self) -> None:
        """Closes the connection when all is sent, and soon in any case."""
        if self.is_closing():
            return
        with contextlib.suppress(ssl.SSLError):  # no handshake, or the peer has not ended TLS itself
            self._tls.unwrap()
        self._flush()
        self._socket.close()
        self._last_words = asyncio.get_running_loop().call_later(_LAST_WORDS_S, self._socket.abort)

    def abort(self) -> None:
        self._socket.abort()

    # --- what the socket's transport calls ------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - of a stream
        self._socket = transport
        self._end.connection_made(self)

    def get_buffer(self, _sizehint: int) -> memoryview:
        return room()

    def buffer_updated(self, count: int) -> None:
        arrived, clear = bytes(room()[:count]), bytearray()
        try:
            for start in range(0, count, _RECORD_BYTES):
                self._incoming.write(arrived[start : start + _RECORD_BYTES])
                with contextlib.suppress(ssl.SSLWantReadError):
                    if not self.shaken.done():
                        self._shake()
                    while True:
                        clear += self._tls.read(_RECORD_BYTES)
        except OSError as error:
            if not self.shaken.done():
                self.shaken.set_exception(error)
            self.close()  # with the alert that TLS has for the peer
        else:
            self._flush()
        if clear and not self.is_closing():
            self._end.data_received(bytes(clear))

    def eof_received(self) -> None:
        self.close()

    def pause_writing(self) -> None:
        self._end.pause_writing()

    def resume_writing(self) -> None:
        self._end.resume_writing()

    def connection_lost(self, error: Exception | None) -> None:
        if self._last_words is not None:
            self._last_words.cancel()
        if not self.shaken.done():
            self.shaken.set_exception(ConnectionAbortedError())
        self._end.connection_lost(error)
        del self._end  # which has this as its transport: all memory of TLS goes now

    def _shake(self) -> None:
        self._received_bytes += self._incoming.pending
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            if self._received_bytes >= _MOST_HANDSHAKE_BYTES:
                raise ConnectionAbortedError("its handshake is longer than any drone's") from None
            raise
        self.shaken.set_result(None)

    def _flush(self) -> None:
        if self._outgoing.pending and not self.is_closing():
            self._socket.write(self._outgoing.read())
