"""What the laws of core/admission/turns.py come to, whoever comes and goes and whatever a drone says."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.core.admission.turns import ASK_AGAIN_S

RENEWED_S = 10.0  # a third of a lease
SERVICES = ["counter", "detector"]

Moves = Iterator[tuple[float, str]]  # how long until a drone says something, and what


@dataclass
class Wait:
    """A drone's wait for a slot, and who else was there in that time."""

    since_s: float
    others: set[str] = field(default_factory=set)


class Field:
    """Drones at one server; time passes from one message to the next."""

    def __init__(self, *, slots: int, turn_s: float) -> None:
        self.slots = slots
        self.turn_s = turn_s
        self.now_s = 0.0
        self.had_s: dict[str, float] = {}  # slot time, as the daemon gave it
        self.waits: dict[str, Wait] = {}
        self.ended: list[tuple[float, int]] = []  # how long a wait was, and how many others were there
        self._host = AdmissionController({"s1": ServerOffer(frozenset(SERVICES), slots, turn_s)})

    def run(self, drones: dict[str, Moves], *, until_s: float, look: Callable[[], None]) -> None:
        """Has each drone say what it says, when it says it; `look` is called each time before."""
        self.had_s = dict.fromkeys(drones, 0.0)
        due: list[tuple[float, str, str]] = []
        for drone, moves in drones.items():
            self._next(due, drone, moves)
        while due and due[0][0] <= until_s:
            at_s, drone, what = heapq.heappop(due)
            self._pass(at_s)
            look()
            self._say(drone, what)
            self._next(due, drone, drones[drone])
        self._pass(until_s)
        for drone in list(self.waits):
            self._waited(drone)

    def holds(self, drone: str) -> bool:
        return drone in self._host.leases("s1")

    def _next(self, due: list[tuple[float, str, str]], drone: str, moves: Moves) -> None:
        for pause_s, what in itertools.islice(moves, 1):
            heapq.heappush(due, (self.now_s + pause_s, drone, what))

    def _pass(self, at_s: float) -> None:
        for drone in self._host.leases("s1"):
            self.had_s[drone] += at_s - self.now_s
        self.now_s = at_s

    def _say(self, drone: str, what: str) -> None:
        client = Client(drone)
        match what:
            case "leave":
                self._host.leave("s1", client, now_s=self.now_s)
            case "start":
                self._host.start("s1", "detector", client, now_s=self.now_s)
            case services:
                self._host.availability("s1", services.split(), client, now_s=self.now_s)
        if what == "leave" or self.holds(drone):
            self._waited(drone)
        else:
            self.waits.setdefault(drone, Wait(self.now_s))
        there = self._host.leases("s1") | self.waits.keys()
        for name, wait in self.waits.items():
            wait.others |= there - {name}

    def _waited(self, drone: str) -> None:
        wait = self.waits.pop(drone, None)
        if wait is not None:
            self.ended.append((self.now_s - wait.since_s, len(wait.others)))


def honest(world: Field, drone: str, visits: Sequence[tuple[float, float]]) -> Moves:
    """Comes after each pause for so long; asks every 2 s for a slot, and every 10 s with one."""
    for away_s, stay_s in visits:
        yield away_s, "detector"
        leaves_s = world.now_s + stay_s
        while (pause_s := RENEWED_S if world.holds(drone) else ASK_AGAIN_S) < leaves_s - world.now_s:
            yield pause_s, "detector"
        yield max(0.0, leaves_s - world.now_s), "leave"


def liar(moves: Sequence[tuple[float, str]], *, comes_s: float) -> Moves:
    """Says these things over and over."""
    yield comes_s, "detector"
    yield from itertools.cycle(moves)


slots = st.integers(1, 4)
turns_s = st.sampled_from([5.0, 30.0])
soon_s = st.floats(0.0, ASK_AGAIN_S)
visits = st.lists(
    st.tuples(st.sampled_from([0.5, 5.0, 40.0]) | soon_s, st.sampled_from([1.0, 20.0, 50.0, 200.0, 400.0])),
    min_size=1,
    max_size=6,
)
lies = st.lists(
    st.tuples(
        st.sampled_from([0.1, 1.0, 1.9, 4.0, 5.9, 7.0, 15.0, 29.0]),
        st.sampled_from(["", "counter", "detector", "counter detector", "nonsense", "start", "leave"]),
    ),
    min_size=1,
    max_size=8,
)


def unaware_s(turn_s: float) -> float:
    """A turn shorter than a drone is silent is over before it knows, and another has begun before it asks again."""
    return RENEWED_S + ASK_AGAIN_S if turn_s < RENEWED_S else 0.0


def no_wait_is_too_long(slots: int, turn_s: float, drones: list[list[tuple[float, float]]]) -> None:
    """Others have two turns at most before a drone that asks: the first may end just short of what it has had."""
    world = Field(slots=slots, turn_s=turn_s)
    moves = {f"d{number}": honest(world, f"d{number}", drone) for number, drone in enumerate(drones)}
    world.run(moves, until_s=600.0, look=lambda: None)
    for waited_s, others in world.ended:
        most_s = 2 * math.ceil(others / slots) * (turn_s + ASK_AGAIN_S)
        assert waited_s <= most_s, f"{others} others"


def no_lie_pays(
    slots: int, turn_s: float, phases: list[float], told: list[tuple[float, str]], comes_s: float | None
) -> None:
    """Of those that are there from the start, a liar has had a turn and a half more at most than any honest drone.

    One that comes later, which counts as having had as little as the least of them, is before those that have just
    had a turn: by two turns, as any honest drone in its place.
    """
    world = Field(slots=slots, turn_s=turn_s)
    drones = {f"d{n}": honest(world, f"d{n}", [(phase_s, math.inf)]) for n, phase_s in enumerate(phases)}
    most_s = unaware_s(turn_s) + (1.5 * turn_s if comes_s is None else 2 * (turn_s + ASK_AGAIN_S))
    since_s = ASK_AGAIN_S if comes_s is None else comes_s
    had_before_s: dict[str, float] = {}

    def look() -> None:
        if world.now_s >= since_s and not had_before_s:
            had_before_s.update(world.had_s)
        had_s = {name: world.had_s[name] - before_s for name, before_s in had_before_s.items()}
        assert not had_s or had_s.pop("liar") - min(had_s.values()) <= most_s

    world.run({**drones, "liar": liar(told, comes_s=comes_s or 0.0)}, until_s=400.0, look=look)


def test_a_turn_that_ends_unnoticed_costs_the_pause_before_the_next_question_too() -> None:
    no_lie_pays(
        2, 5.0, [0.0, 0.0], [(5.9, "")], None
    )  # 17.9 s more, in the first 400 s and in the first 32,000


def test_all_turns_that_are_over_end_at_the_next_questions_of_those_that_wait() -> None:
    world = Field(slots=20, turn_s=10.0)
    phases_s = [ASK_AGAIN_S * number / 40 for number in range(40)]
    world.run(
        {f"d{n:02}": honest(world, f"d{n:02}", [(phase_s, math.inf)]) for n, phase_s in enumerate(phases_s)},
        until_s=10.0 + 2 * ASK_AGAIN_S,
        look=lambda: None,
    )
    first, second = range(20), range(20, 40)
    assert not any(world.holds(f"d{number:02}") for number in first)
    assert all(world.holds(f"d{number:02}") for number in second)


some = settings(max_examples=60)
many = settings(max_examples=1000)
fields = given(slots, turns_s, st.lists(visits, min_size=2, max_size=14))
liars = given(
    slots, turns_s, st.lists(soon_s, min_size=1, max_size=8), lies, st.none() | st.floats(ASK_AGAIN_S, 150.0)
)

test_a_drone_that_keeps_asking_waits_two_turns_of_each_of_the_others_at_most = some(
    fields(no_wait_is_too_long)
)
test_whatever_a_drone_says_it_has_hardly_more_than_an_honest_one_beside_it = some(liars(no_lie_pays))
test_no_wait_is_too_long_in_many_fields = pytest.mark.nightly(many(fields(no_wait_is_too_long)))
test_no_lie_pays_in_many_fields = pytest.mark.nightly(many(liars(no_lie_pays)))
