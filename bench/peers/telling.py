"""What the programs of a trial tell it: datagrams to a socket in a folder that all of them see."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path
from typing import Any

SOCKET = "told"
_MOST_BYTES = 10_000


def tell(folder: str, what: str, **facts: object) -> None:
    """Report an event with the machine's monotonic time."""
    message = {"what": what, "at_s": time.monotonic(), **facts}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(json.dumps(message).encode(), f"{folder}/{SOCKET}")


class Listener:
    """Read the events that are reported in the folder from now on."""

    def __init__(self, folder: Path) -> None:
        self.told: list[dict[str, Any]] = []
        self.began = threading.Event()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / SOCKET))
        (folder / SOCKET).chmod(0o777)  # a service's sandbox may be another user's
        threading.Thread(target=self._listen, name="listener", daemon=True).start()

    def _listen(self) -> None:
        while True:
            message = json.loads(self._socket.recv(_MOST_BYTES))
            self.told.append(message)
            if message["what"] == "began":
                self.began.set()
