"""How many drones a server takes at the same time, if not configured: as many as can keep its instances busy.

A drone keeps an instance busy for a share of its time: the duration of a call, of the time between two of its calls.
As many drones fit as there are such shares in the lanes of the instance. Waiting behind other calls is not counted,
or a crowd would make room for a larger crowd. Before it is measured the share is a quarter: most drones fly for
longer than they call. The number is at most the number of drones whose calls are remembered: no larger crowd is
measured.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

_SHARE = 0.25  # until it is measured
_LEAST_CALLS = 2  # of one drone, for a measured share
_WEIGHT = 0.2  # of the latest call in a drone's share
MOST_DRONES = 64  # whose shares count, the latest
_FEW = 0.02  # a share that is written with a decimal


@dataclass(slots=True)
class _Calls:
    """How busy one drone keeps one service: the share of the time between calls that a call computes."""

    ended_s: float | None  # the last one; None after a new arrival
    share: float = 0.0
    count: int = 0

    def answered(self, *, took_s: float, queued_s: float, now_s: float) -> None:
        """Add a call that has ended."""
        if self.ended_s is not None:
            cycle_s = max(took_s, now_s - self.ended_s - queued_s)
            share = took_s / cycle_s if cycle_s > 0 else 1.0
            self.count += 1
            self.share += (share - self.share) * max(_WEIGHT, 1 / self.count)
        self.ended_s = now_s


class MeasuredSlots:
    """The number of slots of one server, from the measured calls that it answered."""

    def __init__(self, lanes: Mapping[str, int]) -> None:
        self._lanes = dict(lanes)  # by service
        self._calls: dict[str, OrderedDict[str, _Calls]] = {}  # by service and drone, the latest last

    def offer(self, lanes: Mapping[str, int]) -> None:
        """Replace the offered services, with the lanes of each; forget what was measured of others."""
        self._lanes = dict(lanes)
        self._calls = {service: calls for service, calls in self._calls.items() if service in lanes}

    def came(self, drone: str) -> None:
        """Note that the drone with that `Client.key` has a new slot: the time since its last call does not count."""
        for calls in self._calls.values():
            if drone in calls:
                calls[drone].ended_s = None

    def answered(self, service: str, drone: str, *, took_s: float, queued_s: float, now_s: float) -> None:
        """Add a call of the drone that has ended: it waited `queued_s` for other calls and computed for `took_s`."""
        calls = self._calls.setdefault(service, OrderedDict())
        known = calls.setdefault(drone, _Calls(None))
        calls.move_to_end(drone)
        known.answered(took_s=took_s, queued_s=queued_s, now_s=now_s)
        if len(calls) > MOST_DRONES:
            calls.popitem(last=False)

    @property
    def count(self) -> int:
        """The number of slots: the smallest number over the measured services, or over all if none is measured."""
        return max(1, min((self._count_of(service) for service in self._known()), default=1))

    @property
    def why(self) -> str:
        """Why the number is what it is, in words: the service that allows the fewest drones."""
        service = min(self._known(), key=self._count_of, default="")
        share = self._share_of(service)
        if share is None:
            guess = f"{service} is not measured yet, and taken to be busy for {100 * _SHARE:.0f} % of a drone's time"
            return guess if service else "no service is offered"
        percent = f"{100 * share:.1f} %" if share < _FEW else f"{100 * share:.0f} %"
        busy = f"a drone keeps {service} busy for {percent} of its time"
        is_capped = self._lanes[service] / share > self._count_of(service) + 1
        return f"{busy}, and no more drones are measured at once" if is_capped else busy

    def _known(self) -> list[str]:
        """The measured services, or all if none is measured: a service without calls says nothing."""
        measured = [service for service in self._lanes if self._share_of(service) is not None]
        return sorted(measured or self._lanes)

    def _count_of(self, service: str) -> int:
        lanes, share = self._lanes[service], self._share_of(service)
        return max(lanes, min(MOST_DRONES, int(lanes / (_SHARE if share is None else share))))

    def _share_of(self, service: str) -> float | None:
        shares = [
            calls.share for calls in self._calls.get(service, {}).values() if calls.count >= _LEAST_CALLS
        ]
        return max(sum(shares) / len(shares), 1e-3) if shares else None
