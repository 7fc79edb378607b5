"""The promises' checks bite: each planted defect is found."""

from __future__ import annotations

import pytest
from tests.sim.planted import MOST_SEEDS, first_broken
from tests.sim.planting import DEFECTS, Defect

pytestmark = pytest.mark.long

# By `python -m tests.sim.planted`; a search from 1 would spend minutes in worlds that keep their promises.
FOUND_BY_SEED = {
    "every call has the patience of a first one": 133,
    "a drone is served after its turn": 34,
    "a drone without a slot asks without pause": 10,
    "services that nobody wants are dialled": 30,
    "a silent vehicle ends the watch over ranges": 45,
    "an autopilot that restarted is flown on": 179,
    "a restart is taken for the pilot's act": 45,
    "a failed server is probed without pause": 87,
    "an instance of no use is never replaced": 59,
    "calls go to the server in preparation": 273,
    "a transition of the server table is skipped": 95,
    "turns never end": 431,
    "a slot is held until the drone comes": 301,
    "a drone has several slots held at a time": 301,
    "a slot is held for a server that is no peer": 825,
    "an arrival counts though the position jumped": 96,
    "a restart on the ground ends the flight": 1192,
    "another program's heartbeat is believed": 70,
    "hedging has no budget": 374,
    "the bounds of a reply's fields are not checked": 99,
    "a lease may be as short as a server likes": 99,
    "what a server says was raised is logged as it is": 176,
    "a failed server is probed only once": 939,
    "a server that keeps failing is not left alone for longer": 173,
    "a service that does not start is tried without pause": 136,
    "a drone ignores the pause that a server names": 136,
    "a photo whose demand was met is taken again": 1109,
    "the first answer counts where a better one came": 569,
    "the demand of a better answer is not met": 569,
    "the demand of each of two answers is met": 109,
    "an instance that only servers run starts on the drone": 45,
    "a call waits beyond the deadline that the mission chose": 146,
    "a call that no server answered is not in the log": 89,
    "a call that was answered ends without an answer too": 45,
    "a part that fails is tried for ever": 133,
    "a server that was left meanwhile gets the smaller request": 2280,
}


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.what)
def test_a_planted_defect_breaks_a_promise(defect: Defect) -> None:
    since = FOUND_BY_SEED.get(defect.what, 1)
    assert first_broken(defect, since=since), f"{defect.what}: not found from seed {since} to {MOST_SEEDS}"


def test_each_seed_is_of_a_defect() -> None:
    assert {defect.what for defect in DEFECTS} > FOUND_BY_SEED.keys()
