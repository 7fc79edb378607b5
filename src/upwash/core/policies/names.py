"""The policies by name, and what a policy of the user's own is called: `mine.py:Class` or `package.module:Class`."""

from __future__ import annotations

from typing import Literal, get_args

from upwash.core.policies.look_ahead import LookAhead
from upwash.core.policies.policy import Deadline, LocalOnly, LocationAware, Opportunistic, Policy, WaitRule

PolicyName = Literal["local-only", "opportunistic", "location-aware", "look-ahead"]
POLICIES: tuple[str, ...] = get_args(PolicyName)


def is_own(name: str) -> bool:
    """Whether the name is that of a user's own policy."""
    return ":" in name


def make_policy(
    name: str, *, gain_switch: float, gain_wait: float, patient_first_call: bool = False
) -> Policy:
    """The policy of that name, one of POLICIES; raises KeyError for any other name."""
    wait = WaitRule(gain_wait=gain_wait, deadline=Deadline(patient_first=patient_first_call))
    location_aware = LocationAware(gain_switch=gain_switch, wait=wait)
    made: tuple[Policy, ...] = (
        LocalOnly(),
        Opportunistic(wait=wait),
        location_aware,
        LookAhead(reactive=location_aware),
    )
    return dict(zip(POLICIES, made, strict=True))[name]
