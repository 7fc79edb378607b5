"""A door's bounds on connections, handshakes, and requests, which are counted by frames of HTTP/2."""

from __future__ import annotations

import asyncio
import resource
from collections import Counter
from dataclasses import dataclass
from typing import Any

from upwash.core.admission.limits import Allowance

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # of a client's HTTP/2 connection: RFC 9113
_HEADER_BYTES = 9  # of a frame: 3 with the length of its payload, 1 with its type, 5 others
_FRAMES = {0: "data", 1: "begun", 3: "broken_off", 8: "window"}  # by type
_MOST_FILES = 65_536


@dataclass(frozen=True, slots=True)
class DoorLimits:
    """Bounds on connections and requests; those on requests are for each certificate."""

    strangers: int = 256
    strangers_per_address: int = 64
    handshakes: int = 64  # under way at once: TLS takes 0.2 MB for a peer that announces a long message
    handshakes_per_address: int = 16
    handshakes_per_address_per_s: float = 20.0
    silence_s: float = 10.0
    handshake_s: float = 10.0  # for a round trip of 1 s, with packets lost
    connections: int = 1024
    connections_per_certificate: int = 64
    begun_per_s: float = 1000.0
    broken_off_per_s: float = 50.0
    idle_per_s: float = 500.0
    pieces_per_s: float = 20_000.0  # of bodies, in both directions: about 300 MB/s in full frames
    burst_s: float = 2.0  # the allowance of this time may be used at once
    shut_out_s: float = 10.0  # for a certificate that exceeds a bound

    @staticmethod
    def of_this_process() -> DoorLimits:
        """Raises this process's limit of open files, and returns the bounds that fit: a caller takes three files."""
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        most = _MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, _MOST_FILES)
        if soft < most:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        files = max(soft, most)
        return DoorLimits(connections=min(1024, files // 6), strangers=min(256, files // 8))


class ConnectionLimits:
    """At most `most` connections, and `per_group` in a group: an address, or a certificate. The oldest is cancelled.

    A new connection replaces the oldest: an honest caller needs only a moment, or connects again after a dead one.
    """

    def __init__(self, most: int, *, per_group: int) -> None:
        self._most = most
        self._per_group = per_group
        self._groups: dict[asyncio.Task[Any], str] = {}  # by the task of a connection, the oldest first
        self._sizes: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._groups)

    def add(self, connection: asyncio.Task[Any], group: str) -> None:
        """Adds the connection; cancels an older connection if a bound is exceeded."""
        self._groups[connection] = group
        self._sizes[group] += 1
        if self._sizes[group] > self._per_group:
            self._cancel_oldest(group)
        elif len(self._groups) > self._most:
            self._cancel_oldest(self._sizes.most_common(1)[0][0])

    def remove(self, connection: asyncio.Task[Any]) -> None:
        """Removes the connection."""
        group = self._groups.pop(connection, None)
        if group is not None:
            self._sizes[group] -= 1
            if not self._sizes[group]:
                del self._sizes[group]

    def _cancel_oldest(self, group: str) -> None:
        oldest = next(connection for connection, of in self._groups.items() if of == group)
        self.remove(oldest)
        oldest.cancel()


class RateLimit:
    """Lets `per_s` callers a second pass, twice as many after a rest, in the order of their arrival.

    Without the order, callers that try again at once could keep out a caller that waits.
    """

    def __init__(self, per_s: float) -> None:
        self._allowance = Allowance(per_s, at_once=2 * per_s)
        self._order = asyncio.Lock()

    async def wait(self) -> None:
        """Returns when the caller may pass."""
        now_s = asyncio.get_running_loop().time
        async with self._order:
            await asyncio.sleep(self._allowance.take_anyway_s(1, now_s=now_s()))


class FrameCounter:
    """Counts the frames of one HTTP/2 connection; it keeps only the header that it is reading."""

    def __init__(self) -> None:
        self._to_skip = len(PREFACE)
        self._header = bytearray()

    def count(self, chunk: bytes) -> Counter[str]:
        """The frames that begin in the next bytes.

        Kinds: `begun` and `broken_off` requests, `data` of bodies, `window` for replies; all others are `idle`.
        """
        counted: Counter[str] = Counter()
        at = 0
        while at < len(chunk):
            if self._to_skip:
                skipped = min(self._to_skip, len(chunk) - at)
                self._to_skip -= skipped
                at += skipped
                continue
            missing = _HEADER_BYTES - len(self._header)
            self._header += chunk[at : at + missing]
            at += missing
            if len(self._header) == _HEADER_BYTES:
                self._to_skip = int.from_bytes(self._header[:3], "big")
                counted[_FRAMES.get(self._header[3], "idle")] += 1
                self._header.clear()
        return counted


class CertificateLimit:
    """Bounds what one certificate does in a second, over all its connections."""

    def __init__(self, limits: DoorLimits) -> None:
        self.shut_out_until_s = 0.0
        self._shut_out_s = limits.shut_out_s
        self._allowances = {
            kinds: Allowance(per_s, at_once=per_s * limits.burst_s)
            for kinds, per_s in (
                (("begun",), limits.begun_per_s),
                (("broken_off",), limits.broken_off_per_s),
                (("idle",), limits.idle_per_s),
                (("data", "window"), limits.pieces_per_s),
            )
        }

    def take(self, counted: Counter[str], now_s: float) -> None:
        """Counts these frames; raises ConnectionAbortedError if they exceed a bound."""
        for kinds, allowance in self._allowances.items():
            number = sum(counted[kind] for kind in kinds)
            if number and not allowance.take(number, now_s=now_s):
                self.shut_out_until_s = now_s + self._shut_out_s
                raise ConnectionAbortedError("it begins or breaks off more requests than any drone would")
