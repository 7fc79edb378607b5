"""Dask: a scheduler and a worker at the server, `submit` and `result(2)` at the drone."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError

import distributed

TIMEOUT_S = 2.0
READY_S = 30


def serve(address: str, compute: object) -> None:
    """Serves until the process is ended."""
    host, _, port = address.rpartition(":")
    for words in (
        ("scheduler", "--host", host, "--port", port, "--no-dashboard"),
        ("worker", f"tcp://{address}", "--no-dashboard", "--local-directory", tempfile.mkdtemp()),
    ):
        subprocess.Popen((sys.executable, "-m", "dask", *words), stdout=subprocess.DEVNULL)
    with distributed.Client(f"tcp://{address}", timeout=READY_S) as client:  # type: ignore[no-untyped-call, unused-ignore]
        client.wait_for_workers(1, timeout=READY_S)
    print("ready", flush=True)
    threading.Event().wait()


class Client:
    """Submits the computation, and computes here where its result does not come."""

    def __init__(
        self, address: str, *, compute: Callable[[bytes], str], local: Callable[[bytes], str]
    ) -> None:
        self._client = distributed.Client(f"tcp://{address}")  # type: ignore[no-untyped-call, unused-ignore]
        self._compute = compute
        self._local = local

    def call(self, photo: bytes) -> str:
        """Where it was computed."""
        try:
            return str(self._client.submit(self._compute, photo, pure=False).result(TIMEOUT_S))
        except (TimeoutError, CancelledError, OSError):  # base classes of distributed's errors
            return self._local(photo)
