"""The mission's loop, the same for every peer."""

from __future__ import annotations

import time
from collections.abc import Callable

from bench.peers.telling import tell

PHOTO_BYTES = 430_000
PERIOD_S = 2.0
_WARM_UP_S = 90.0
_PAUSE_S = 0.2


def make_calls(call: Callable[[bytes], str], photo: bytes, *, folder: str, calls: int) -> None:
    """Call until the server answers, then make `calls` calls, each 2 s after the last one or at its end.

    Raises TimeoutError if the server never answers. Exceptions of later calls are reported and counted.
    """
    give_up_s = time.monotonic() + _WARM_UP_S
    while call(photo) != "server":
        if time.monotonic() > give_up_s:
            raise TimeoutError(f"no answer from the server within {_WARM_UP_S:.0f} s")
        time.sleep(_PAUSE_S)
    tell(folder, "began")
    for _ in range(calls):
        began_s = time.monotonic()
        place = raised = ""
        try:
            place = call(photo)
        except Exception as error:  # noqa: BLE001 - whatever reaches the mission is counted
            raised = repr(error)[:1000]
        tell(folder, "call", began_s=began_s, place=place, raised=raised)
        time.sleep(max(0.0, began_s + PERIOD_S - time.monotonic()))
