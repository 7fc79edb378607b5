"""The wait for the first heartbeat of a vehicle."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from upwash.errors import AutopilotError, AutopilotNotHeard
from upwash.mavlink.signing import Refusal
from upwash.real.mavlink.identity import Identity
from upwash.real.mavlink.link import MavlinkLink

_LOOKED_EACH_S = 1.0
_DEFINITE_S = 10.0  # the wait ends so long after the first heartbeat of a wrong vehicle
_TOLD_AFTER_S, _TOLD_EACH_S = 3.0, 15.0
_DEFINITE = Refusal.UNSIGNED, Refusal.OTHER_KEY
_REMEDIES = {
    Refusal.UNSIGNED: "give it the key with a ground station, or leave autopilot.signing_key out",
    Refusal.OTHER_KEY: "give it the key of autopilot.signing_key with a ground station, or name the file of its key",
    Refusal.STALE: "wait until its GPS has a fix, and see that this computer's clock is right",
    Refusal.REPLAYED: "somebody repeats what it said earlier, or it was started anew: try again",
}


class Search:
    """Waits for the vehicle of an identity on a link, and knows which others sent heartbeats."""

    def __init__(self, link: MavlinkLink, identity: Identity) -> None:
        self._link = link
        self._identity = identity

    async def over(
        self,
        news: Callable[[], Awaitable[object]],
        *,
        within_s: float,
        waiting: Callable[[str, float], None],
    ) -> None:
        """Returns after the first heartbeat; AutopilotNotHeard without it, AutopilotError for a wrong vehicle.

        `news` returns after a message of the vehicle. `waiting` gets the reason of the wait and its seconds.
        """
        now_s = asyncio.get_running_loop().time
        begun_s, told_s, until_s = now_s(), _TOLD_AFTER_S, within_s
        while self._identity.vehicle is None:
            waited_s = now_s() - begun_s
            if self._is_definite:
                until_s = min(until_s, waited_s + _DEFINITE_S)
            if waited_s >= until_s:
                raise self._not_found(within_s)
            if waited_s >= told_s:
                told_s += _TOLD_EACH_S
                waiting(self._why(), waited_s)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(_LOOKED_EACH_S, until_s - waited_s)):
                    await news()

    @property
    def _is_definite(self) -> bool:
        """Whether a longer wait cannot help: a wrong key, or a vehicle that cannot be flown."""
        return self._link.refused in _DEFINITE or self._identity.is_unflyable

    def _why(self) -> str:
        link = self._link
        if link.refused is not None:
            return f"an autopilot was heard on {link.connection}, and its messages {link.refused.value}"
        heard = self._identity.heard_instead(link.connection)
        return heard or f"no autopilot was heard on {link.connection}{link.why_silent}"

    def _not_found(self, within_s: float) -> AutopilotError:
        refused = self._link.refused
        if refused is not None:
            remedy = _REMEDIES[refused]
        elif self._identity.heard_instead(""):
            remedy = f"nothing else came within {within_s:g} s"
        else:
            remedy = (
                f"{within_s:g} s were waited: check that it is powered, that the address or device and its speed are "
                "right, and that no other program holds it"
            )
        kind = AutopilotError if self._is_definite else AutopilotNotHeard
        return kind("connect", f"{self._why()}; {remedy}")
