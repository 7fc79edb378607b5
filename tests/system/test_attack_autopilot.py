"""A flight over `udpin` while somebody sends to the drone's port: it is flown as if nobody did."""

from __future__ import annotations

import asyncio

import pytest
from tests.system.attacks.datagrams import ATTACKS
from tests.system.attacks.flown import KEY, flown

pytestmark = pytest.mark.system

NEAR_M = 1.5  # as the router last heard it, a tenth of a second ago


def require_flown(attack: str, key: bytes | None = None) -> None:
    outcome = asyncio.run(flown(ATTACKS[attack], key=key))
    assert outcome.ended == "flown"
    assert outcome.astray == 0
    assert outcome.off_m < NEAR_M
    assert outcome.faults == []


@pytest.mark.parametrize("attack", ["junk", "of_nothing_known", "of_a_pilot", "at_waypoints"])
def test_strangers_are_neither_believed_nor_answered(attack: str) -> None:
    require_flown(attack)


@pytest.mark.parametrize("attack", ["before_the_vehicles", "forged", "of_another_key", "replayed"])
def test_with_signatures_who_is_first_or_has_the_vehicles_address_is_not_believed(attack: str) -> None:
    require_flown(attack, KEY)
