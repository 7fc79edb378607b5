"""Whom a port that anyone may send to listens to and answers."""

from __future__ import annotations

import math
import re
from typing import Any, TypeAlias

from upwash.real.mavlink.hearing import Hearing

Address: TypeAlias = tuple[Any, ...]  # host and port, and more with IPv6

_LONGEST_INTRODUCTION_BYTES = 2048  # no router sends longer datagrams
_OVERHEARD_EACH_S = 0.05
# The header of an autopilot's heartbeat: to look for it costs a thousandth of what it costs to read nonsense.
_HEARTBEAT = re.compile(rb"\xfd\x09[\x00\x01]...\x01\x00\x00\x00|\xfe\x09..\x01\x00", re.DOTALL)


class Peer:
    """The address that the vehicle was first heard from, for as long as it is heard from there.

    Once nothing believable has come from it for `moved_after_s`, as of a router that was started anew, a heartbeat
    of the same vehicle from another port of its host makes that the peer, or from another host where messages are
    signed.
    Without signatures who speaks first is believed, and who sends with the peer's address.
    """

    def __init__(self, hearing: Hearing, *, moved_after_s: float, signed: bool) -> None:
        self.address: Address | None = None
        self.ignored = 0  # datagrams of others
        self.last_ignored: Address | None = None
        self._hearing = hearing
        self._moved_after_s = moved_after_s
        self._signed = signed
        self._heard_s = 0.0
        self._overheard_s = -math.inf
        self._late: Address | None = None  # of a vehicle whose signatures are too old, while there is no peer

    @property
    def answered(self) -> Address | None:
        """Where what is sent goes to.

        A vehicle without GPS may sign with the time of its last flight. It takes over ours once it hears our
        heartbeat, and is believed then; nothing else is sent before there is a peer.
        """
        return self.address or self._late

    def take(self, data: bytes, address: Address, now_s: float) -> None:
        """Has a datagram heard if it is the peer's, or makes its sender that."""
        if address == self.address:
            if self._hearing.take(data):
                self._heard_s = now_s
        elif self._may_be(address, now_s) and _may_introduce(data):
            self._meet(data, address, now_s)
        else:
            self._ignore(address)
            self._overhear(data, now_s)

    def _may_be(self, address: Address, now_s: float) -> bool:
        """Whether the vehicle's heartbeat from there would make it the peer."""
        if self.address is None:
            return True
        silent = now_s - self._heard_s > self._moved_after_s
        return silent and (self._signed or address[0] == self.address[0])

    def _meet(self, data: bytes, address: Address, now_s: float) -> None:
        is_vehicle, has_key = self._hearing.meet(data)
        if is_vehicle:
            self.address, self._heard_s = address, now_s
        elif has_key:
            self._late = address
        else:
            self._ignore(address)

    def _overhear(self, data: bytes, now_s: float) -> None:
        """Takes note of another vehicle at another address, at a pace that a flood does not raise."""
        if now_s - self._overheard_s >= _OVERHEARD_EACH_S and _may_introduce(data):
            self._overheard_s = now_s
            self._hearing.overhear(data)

    def _ignore(self, address: Address) -> None:
        self.ignored += 1
        self.last_ignored = address


def _may_introduce(data: bytes) -> bool:
    return len(data) <= _LONGEST_INTRODUCTION_BYTES and _HEARTBEAT.search(data) is not None
