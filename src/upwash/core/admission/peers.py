"""What daemons ask of each other: to hold a slot for a drone on its way.

A peer whose announced drones do not come is refused for a time: its key may be stolen, and its drones invented. A
drone may have one slot held at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec import Struct

_MOST_MISSED = 3  # drones in a row that a peer expected in vain
_MISTRUST_HOLDS = 10  # for how many times the longest hold it is refused then


class _SentAhead(Struct, frozen=True):
    """A request to `peer` to hold a slot for a drone until `until_s`.

    If the peer refuses, its earlier hold still lasts until `otherwise_s`.
    """

    peer: str
    until_s: float
    otherwise_s: float


class Peers:
    """The servers of the operator's other daemons; a slot is held for their drones for `hold_s` at most."""

    def __init__(self, names: Iterable[str], *, hold_s: float) -> None:
        self.names = tuple(names)
        self._hold_s = hold_s
        self._missed: dict[
            str, tuple[int, float]
        ] = {}  # by peer: drones in a row, and when the last one failed
        self._sent_ahead: dict[str, _SentAhead] = {}  # by drone, until the slot is held no longer

    def unknown(self, peer: str) -> str:
        """Why a server is no peer of this daemon; "" if it is one."""
        return "" if peer in self.names else f"{peer} is no peer of this daemon"

    # --- what peers ask of this daemon ------------------------------------------------------------------------

    def mistrust(self, peer: str, *, now_s: float) -> str:
        """Why nothing is held for the peer now: its last announced drones did not come; "" if it is trusted."""
        times, last_s = self._missed.get(peer, (0, -math.inf))
        if times >= _MOST_MISSED and now_s < last_s + _MISTRUST_HOLDS * self._hold_s:
            return f"the last {times} drones that {peer} expected did not come"
        return ""

    def came(self, peer: str) -> None:
        """Note that a drone came that the peer had announced; the peer is trusted again."""
        self._missed.pop(peer, None)

    def missed(self, peer: str, *, now_s: float) -> None:
        """Note that a drone announced by the peer did not come; three in a row have the peer refused for a time."""
        times, _ = self._missed.get(peer, (0, now_s))
        self._missed[peer] = times + 1, now_s

    # --- what this daemon asks of peers -----------------------------------------------------------------------

    def elsewhere(self, drone: str, peer: str, *, now_s: float) -> str:
        """Why the peer cannot hold a slot for the drone: another peer holds one; "" if it can; after `forget`."""
        ahead = self._sent_ahead.get(drone)
        if ahead is not None and ahead.peer != peer:
            return f"{drone} has a slot of {ahead.peer} held for another {ahead.until_s - now_s:.0f} s"
        return ""

    def ask(self, drone: str, peer: str, *, for_s: float, now_s: float) -> None:
        """Note a request that the peer hold a slot for the drone for `for_s`."""
        ahead = self._sent_ahead.get(drone)
        known_s = ahead.until_s if ahead is not None else now_s
        until_s = max(known_s, now_s + min(self._hold_s, for_s))
        self._sent_ahead[drone] = _SentAhead(peer, until_s, otherwise_s=known_s)

    def refused(self, drone: str, peer: str) -> None:
        """Note that the peer refused the latest hold; earlier holds still count."""
        ahead = self._sent_ahead.get(drone)
        if ahead is not None and ahead.peer == peer:
            self._sent_ahead[drone] = _SentAhead(peer, ahead.otherwise_s, ahead.otherwise_s)

    def forget(self, *, now_s: float) -> None:
        """Forget holds whose time is over."""
        self._sent_ahead = {
            drone: ahead for drone, ahead in self._sent_ahead.items() if ahead.until_s > now_s
        }
