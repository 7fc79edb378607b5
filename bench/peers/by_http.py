"""HTTP: `requests` at the drone, `http.server` with threads at the server."""

from __future__ import annotations

from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import requests

TIMEOUT_S = 2.0


def serve(address: str, compute: Callable[[bytes], str]) -> None:
    """Serves until the process is ended."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            photo = self.rfile.read(int(self.headers["Content-Length"]))
            answer = compute(photo).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

    host, _, port = address.rpartition(":")
    server = ThreadingHTTPServer((host, int(port)), Handler)
    print("ready", flush=True)
    server.serve_forever()


class Client:
    """Posts the photo, and computes here where that fails."""

    def __init__(self, address: str, *, compute: object, local: Callable[[bytes], str]) -> None:
        self._url = f"http://{address}/"
        self._local = local

    def call(self, photo: bytes) -> str:
        """Where it was computed."""
        try:
            reply = requests.post(self._url, data=photo, timeout=TIMEOUT_S)
            reply.raise_for_status()
        except requests.RequestException:
            return self._local(photo)
        return reply.text
