"""A service that turns against its daemon, over everything that joins the two."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Mapping

import msgspec

from upwash.rpc.service import service


@service
class Hostile:
    """Shares a process with the instance's end of the control line, so it can say there what it likes."""

    def __init__(self) -> None:
        self._control = socket.socket(fileno=os.dup(int(sys.argv[1])))

    def echo(self, data: bytes) -> bytes:
        """What an honest service would do."""
        return data

    def invent_methods(self, drone: str, many: int) -> None:
        """Says that calls of methods that there are not had an answer, as a drone made them."""
        for first in range(0, many, 100):
            self._say(
                *(
                    _answer(drone, f"invented_{number}", 0.01)
                    for number in range(first, min(many, first + 100))
                )
            )

    def claim_times(self, drone: str, many: int) -> None:
        """Says that a drone's calls took forever, or less than nothing."""
        for took_s in (1e300, -1e300):
            self._say(*[_answer(drone, "echo", took_s)] * many)

    def speak_out_of_turn(self, many: int) -> None:
        """Says again and again that it is ready."""
        for _ in range(many):
            self._say({"type": "ready", "address": "unix:/nowhere"})

    def fail_at_length(self) -> None:
        """Says why it cannot serve, once it does."""
        self._say({"type": "failed", "why": "x" * 60_000})

    def forge_calls(self, drones: list[str], period_s: float) -> None:
        """From now on says, as long as it lives, that these drones call."""

        def forge() -> None:
            while True:
                self._say(*({"type": "called", "drone": drone} for drone in drones))
                time.sleep(period_s)

        threading.Thread(target=forge, daemon=True).start()

    def print_much(self, total_bytes: int, line: str) -> None:
        """Prints the line until that much is out."""
        chunk = f"{line}\n".encode() * 1000
        written = 0
        while written < total_bytes:
            written += os.write(1, chunk)

    def leave(self, code: int) -> None:
        """Ends the process with that code."""
        os._exit(code)

    def cut_the_line(self) -> None:
        """Says what nobody understands, and goes on although its daemon hangs up."""
        os.killpg = lambda *_: None  # by which it would end itself
        self._control.sendall(b"}\n")

    def _say(self, *messages: Mapping[str, object]) -> None:
        self._control.sendall(b"".join(msgspec.json.encode(message) + b"\n" for message in messages))


def _answer(drone: str, method: str, took_s: float) -> dict[str, object]:
    return {"type": "answered", "drone": drone, "method": method, "queued_s": 0.0, "took_s": took_s}
