"""What a comparison makes of the calls that it was told of."""

from __future__ import annotations

from typing import Any

from bench.peers.order import Figures, Trial
from bench.peers.table import tables
from bench.peers.trial import Fault, figures_of


def call(began_s: float, at_s: float, place: str, raised: str = "") -> dict[str, Any]:
    return {"what": "call", "began_s": began_s, "at_s": at_s, "place": place, "raised": raised}


def computed(at_s: float, place: str) -> dict[str, Any]:
    return {"what": "computed", "at_s": at_s, "place": place}


TOLD = [
    computed(1.0, "drone"),  # before the calls that count
    computed(5.0, "server"),
    {"what": "began", "at_s": 10.0},
    computed(10.1, "server"),
    call(10.0, 10.7, "server"),
    computed(12.1, "server"),
    computed(14.0, "drone"),
    call(12.0, 17.0, "drone"),
    call(17.0, 17.5, "", "ValueError()"),
    computed(19.5, "server"),
    call(19.0, 20.2, "server"),
]


def test_what_was_computed_twice_shows_and_what_was_before_the_calls_does_not() -> None:
    figures = figures_of(TOLD, Fault(11.0, 18.0, 19.5))
    assert (figures.by_server, figures.by_drone, figures.raised) == (2, 1, ["ValueError()"])
    assert (figures.server_computed, figures.drone_computed) == (3, 1)
    assert round(figures.total_s, 6) == 10.2
    assert figures.longest_s == 5.0


def test_the_servers_own_delay_is_that_of_its_answers_before_the_fault() -> None:
    before, none = (figures_of(TOLD, Fault(11.0, to_s, to_s)).remote_s for to_s in (18.0, 11.0))
    assert before is not None
    assert none is not None
    assert round(before, 6) == 0.7
    assert round(none, 6) == 0.95  # of all of them, as there was no fault


def test_the_server_is_back_with_its_first_answer_after_the_fault() -> None:
    figures = figures_of(TOLD, Fault(11.0, 18.0, 19.5))
    assert figures.back_s is not None
    assert figures.back_after_ready_s is not None
    assert round(figures.back_s, 6) == 2.2
    assert round(figures.back_after_ready_s, 6) == 0.7
    assert figures_of(TOLD, Fault(11.0, 20.5, 20.5)).back_s is None
    assert figures_of(TOLD, Fault(11.0, 11.0, 11.0)).back_s is None  # there was no fault


def test_a_trial_that_failed_and_a_server_that_never_came_back_are_told() -> None:
    def trial(peer: str, figures: Figures | None) -> Trial:
        return Trial(peer=peer, scenario="killed", local_s=3.0, round=0, figures=figures)

    back, gone = (figures_of(TOLD, Fault(11.0, to_s, to_s + 0.5)) for to_s in (18.0, 20.5))
    seen, made = tables([trial("one", back), trial("other", gone), trial("third", None)])
    assert "| one | 10.2/5.0/1/2.2 (1.7) |" in seen
    assert "| other | 10.2/5.0/1/- |" in seen
    assert "| third | failed |" in seen
    assert "| one | 2+1 / 3+1 |" in made
