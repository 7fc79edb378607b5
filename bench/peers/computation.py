"""The computation, the same for every peer: a wait in place of work, counted as it begins."""

from __future__ import annotations

import time
from pathlib import Path

from bench.peers.telling import tell

ON_SERVER_S = 0.6
LATE_S = 5.0
LATE_FILE = "late"
_LOOK_S = 0.02


def on_server(folder: str, photo: bytes) -> str:
    """Where it was computed; while the folder has the file `late` the answer waits for its end, 5 s at most."""
    tell(folder, "computed", place="server", photo_bytes=len(photo))
    time.sleep(ON_SERVER_S)
    answer_s = time.monotonic() + LATE_S
    while Path(folder, LATE_FILE).exists() and time.monotonic() < answer_s:
        time.sleep(_LOOK_S)
    return "server"


def on_drone(folder: str, takes_s: float, photo: bytes) -> str:
    """The place of the computation, after `takes_s`."""
    tell(folder, "computed", place="drone", photo_bytes=len(photo))
    time.sleep(takes_s)
    return "drone"
