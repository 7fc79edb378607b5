"""The lanes that compute a drone's calls, one on the drone and one at each server, and who holds them.

A lane is held from the decision for it until the answer is there, and beyond that for as long as a computation or a
request goes on whose answer is of no use any more. Only a free lane gets a call.
"""

from __future__ import annotations


class Lanes:
    """Which lanes the drone's own calls hold, and until when; a lane has the name of its place."""

    def __init__(self) -> None:
        self._held: dict[object, tuple[str, float]] = {}

    def hold(self, holder: object, place: str, until_s: float) -> None:
        """Note that a lane is held, and when that is expected to end; a holder has one lane at a time."""
        self._held[holder] = place, until_s

    def release(self, holder: object) -> None:
        """Note that the holder has its lane no more, if it had one."""
        self._held.pop(holder, None)

    def is_free(self, place: str) -> bool:
        """Whether no call holds the lane."""
        return all(held != place for held, _ in self._held.values())

    def rest_s(self, place: str, now_s: float) -> float:
        """The seconds until the lane is expected to be free; 0 where that was expected earlier."""
        ends_s = [until_s for held, until_s in self._held.values() if held == place]
        return max([now_s, *ends_s]) - now_s
