"""Which call of a line a free place takes."""

from __future__ import annotations

import math
import random

import pytest

from upwash.core.geo import Measured, Position
from upwash.core.planning.backlog import Backlog, ServerBelief
from upwash.core.planning.earliest import first_taken
from upwash.core.planning.legs import Pace

NEVER = math.inf


@pytest.mark.parametrize(
    ("line", "other_in_s", "taken"),
    [
        ([], 0.0, None),
        ([(9.9, 4.4)], 0.0, None),  # the other place answers it at 4.4
        ([(9.9, 4.4)] * 2, 0.0, None),  # at 8.8
        ([(9.9, 4.4)] * 3, 0.0, 2),  # at 13.2
        ([(9.9, 4.4)] * 3, 2.0, 1),  # at 10.8
        ([(9.9, 4.4)], 6.0, 0),
        ([(9.9, NEVER), (9.9, 4.4)], 0.0, 0),  # it does not run there
        ([(NEVER, 4.4), (9.9, 4.4), (9.9, 4.4)], 0.0, 2),  # it runs only there, and comes first
        ([(NEVER, NEVER), (9.9, 4.4)], 6.0, 1),  # neither place has it yet
        ([(4.4, 9.9)] * 3, 0.0, 0),
        ([(30.0, 4.4), (1.0, 0.5), (1.0, 0.5)], 0.0, 1),  # a short one behind a long one
    ],
)
def test_the_first_call_is_taken_that_is_answered_before_the_other_place_gets_to_it(
    line: list[tuple[float, float]], other_in_s: float, taken: int | None
) -> None:
    assert first_taken(line, other_in_s=other_in_s) == taken


def test_of_two_places_that_answer_at_one_time_one_has_the_call() -> None:
    assert first_taken([(2.0, 1.0)], other_in_s=1.0) is None
    assert first_taken([(2.0, 1.0)], other_in_s=1.0, in_ties=True) == 0
    assert first_taken([(NEVER, NEVER)], other_in_s=1.0, in_ties=True) is None


def answered_s(local_s: float, remote_s: float | None, photos: int) -> float:
    """When the last photo is answered; the server is there all the time."""
    servers = {} if remote_s is None else {"s1": ServerBelief(Measured(), remote_s, 0.0)}
    backlog = Backlog(
        photos=photos,
        local_s=local_s,
        servers=servers,
        gain_switch=0.25,
        ground_speed_m_s=5.0,
        pace=Pace(),
        after=None,
    )
    here = Position(0.0, 0.0)
    return backlog.wait_at(here, here=here).answered_s


@pytest.mark.parametrize("seed", range(60))
def test_a_faster_server_ends_the_line_no_later(seed: int) -> None:
    """But for the last call: one place may have it when the other would have been free a moment later.

    What is left then is less than a call of the slower server.
    """
    chance = random.Random(seed)
    local_s, photos = 10 ** chance.uniform(-0.7, 1.5), chance.randint(1, 60)
    last_s, slower_s = answered_s(local_s, None, photos), local_s
    for share in sorted((chance.uniform(0.02, 1.0) for _ in range(8)), reverse=True):
        end_s = answered_s(local_s, share * local_s, photos)
        assert end_s <= last_s + slower_s + 1e-6
        assert end_s <= answered_s(local_s, None, photos) + 1e-6, "served it is no slower than alone"
        last_s, slower_s = min(last_s, end_s), share * local_s
