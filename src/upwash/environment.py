"""An environment of Gymnasium over simulated missions, to train policies: docs/own-policy.md#training-a-policy."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, NamedTuple

import msgspec

from upwash import policies
from upwash.core.knowledge.servers import CHECKING
from upwash.errors import UsageError
from upwash.lab.run import Run
from upwash.lab.scenario import read_scenario
from upwash.lab.steps import PolicyQuestion, SteppedMission
from upwash.support.loading import extra

with extra("gymnasium"):
    import gymnasium
    import numpy as np

__all__ = ["UpwashEnv"]

_MOST = 1e6  # of a number in an observation; in place of a larger one, or of an infinite one
_MOST_SEEN = 32  # calls in line, and gaps, the first ones
_WHY = "the agent's choice"


class UpwashEnv(gymnasium.Env[Any, Any]):
    """The twin of a scenario of one drone: each step is a question to its policy, and an episode is one mission.

    `question` is a method of policies. The agent answers in its place; the scenario's policy answers all others. The
    reward is minus the seconds since the question before, so that the return is minus the mission's time.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str] | Mapping[str, object],
        question: Literal["choose", "decide", "place_in_line", "where_to_wait", "when_to_act"] = "choose",
        *,
        overrides: Mapping[str, object] | None = None,
    ) -> None:
        self._config = read_scenario(scenario, overrides=overrides)
        if question not in _QUESTIONS:
            raise UsageError(f"{question!r} is no question to a policy: {', '.join(_QUESTIONS)}")
        self._method, self._question = question, _QUESTIONS[question]
        self._servers = [server.name for server in self._config.servers]
        shape, self._actions = self._question.size(len(self._servers))
        self.observation_space = gymnasium.spaces.Box(-_MOST, _MOST, shape, np.float32)
        self.action_space = gymnasium.spaces.Discrete(self._actions)
        self._mission: SteppedMission | None = None
        self._asked: PolicyQuestion | None = None
        self._rewarded_s = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin the mission of the seed, or of a drawn one; return its first question.

        The second value has the `question` as policies get it, the `action_mask` of possible actions, and the action
        of the scenario's policy, `built_in`. Raises UsageError for a mission that asks nothing.
        """
        super().reset(seed=seed)
        self.close()
        flown = int(self.np_random.integers(2**31)) if seed is None else seed
        self._mission = SteppedMission(msgspec.structs.replace(self._config, seed=flown), self._method)
        asked, self._rewarded_s = self._mission.next(), 0.0
        if isinstance(asked, Run):
            raise UsageError(f"the mission never called {self._method}: {asked.failure or 'it is over'}")
        return self._seen(asked), self._told(asked)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Answer the question; return the next one, or the end, with the mission's `result` and `failure`.

        An action that is not possible counts as 0. Raises the mission's error.
        """
        if self._mission is None or self._asked is None:
            raise gymnasium.error.ResetNeeded("no mission is under way: call reset()")
        before, self._asked = self._asked, None
        possible = self._question.possible(before.about, before.built_in, self._servers)
        self._mission.answer(possible.get(int(action), possible[0]))
        asked = self._mission.next()
        at_s = asked.result.mission_time_s if isinstance(asked, Run) else asked.at_s
        reward, self._rewarded_s = self._rewarded_s - at_s, at_s
        if isinstance(asked, PolicyQuestion):
            return self._seen(asked), reward, False, False, self._told(asked)
        self.close()
        told = {"result": asked.result, "failure": asked.failure}
        return self._seen(before), reward, not asked.failure, bool(asked.failure), told

    def close(self) -> None:
        """End the mission that is under way, and its thread."""
        mission, self._mission, self._asked = self._mission, None, None
        if mission is not None:
            mission.end()

    def _seen(self, asked: PolicyQuestion) -> Any:
        seen = np.zeros(self.observation_space.shape or (), np.float32)
        for row, numbers in enumerate(self._question.rows(asked.about, self._servers)):
            seen[row, : len(numbers)] = np.clip(numbers, -_MOST, _MOST)
        return seen

    def _told(self, asked: PolicyQuestion) -> dict[str, Any]:
        self._asked = asked
        possible = self._question.possible(asked.about, asked.built_in, self._servers)
        mask = np.zeros(self._actions, np.int8)
        mask[list(possible)] = 1
        built_in = next((number for number, answer in possible.items() if answer == asked.built_in), 0)
        return {"question": asked.about, "action_mask": mask, "built_in": built_in}


class _Question(NamedTuple):
    """A question in numbers, for the names of all servers: the shape and the count of actions, rows, and answers."""

    size: Callable[[int], tuple[tuple[int, int], int]]
    rows: Callable[[Any, list[str]], Iterable[tuple[float, ...]]]
    possible: Callable[[Any, Any, list[str]], Mapping[int, Any]]  # by their actions


def _situation(about: policies.Situation, servers: list[str]) -> Iterable[tuple[float, ...]]:
    options, at = {each.server: each for each in about.options}, about.position or policies.Position(0.0, 0.0)
    under_way = (type(None), policies.Local, policies.Remote, policies.Wait).index(type(about.under_way))
    yield about.now_s, about.local_mean_call_s, under_way, at.east_m, at.north_m, at.altitude_m
    for name in servers:
        numbers: tuple[float, ...] = (0, name == about.current)
        if (each := options.get(name)) is not None:
            since_s, is_ready = about.now_s - each.in_range_since_s, each.state is policies.State.READY
            numbers = (1, name == about.current, is_ready, each.full, each.mean_call_s, since_s)
        yield numbers


def _choices(about: policies.Situation, built_in: policies.Choice, servers: list[str]) -> Mapping[int, Any]:
    offered = {None, *(each.server for each in about.options)}
    choices = {n: policies.Choice(name, _WHY) for n, name in enumerate((None, *servers)) if name in offered}
    return {n: built_in if each.server == built_in.server else each for n, each in choices.items()}


def _call(about: policies.CallInputs, servers: list[str]) -> Iterable[tuple[float, ...]]:
    yield about.local_s, about.remote_s, about.check_expected_s, about.check_elapsed_s, about.is_first
    yield servers.index(about.server), about.state is policies.State.READY, about.state in CHECKING


def _decisions(about: policies.CallInputs, built_in: policies.Decision, _: list[str]) -> Mapping[int, Any]:
    decisions: dict[int, policies.Decision] = {0: policies.Local(_WHY)}
    if about.state is policies.State.READY:
        within_s = policies.Deadline().seconds(
            local_s=about.local_s, remote_s=about.remote_s, is_first=about.is_first
        )
        decisions[1] = policies.Remote(about.server, within_s, _WHY)
    elif about.state in CHECKING:
        decisions[2] = policies.Wait(about.server, about.local_s, _WHY)
    return {n: built_in if type(each) is type(built_in) else each for n, each in decisions.items()}


def _line(about: policies.Line, _: list[str]) -> Iterable[tuple[float, ...]]:
    for lane in (about.drone, about.server):
        yield (0, _MOST) if lane is None else msgspec.structs.astuple(lane)
    for call in about.calls[:_MOST_SEEN]:
        yield call.local_s, call.remote_s, call.waited_s, call.urgent


def _takes(about: policies.Line, *_: object) -> Mapping[int, Any]:
    takes: dict[int, policies.Take | None] = {0: None}
    for n, call in enumerate(about.calls[:_MOST_SEEN]):
        if about.drone.is_free and call.local_s < math.inf:
            takes[1 + n] = policies.Take(n, "drone")
        if about.server is not None and about.server.is_free and call.remote_s < math.inf:
            takes[1 + _MOST_SEEN + n] = policies.Take(n, "server")
    return takes


def _stay(about: policies.Stay, servers: list[str]) -> Iterable[tuple[float, ...]]:
    yield about.calls, about.passes_range
    places = {place.server: place for place in about.places}
    for name in (None, *servers):
        place = places.get(name)
        yield () if place is None else (1, place.extra_s, place.answered_s, place.ends_s)


def _waits(about: policies.Stay, _: object, servers: list[str]) -> Mapping[int, Any]:
    offered = {place.server for place in about.places}
    return {n: name for n, name in enumerate((None, *servers)) if name in offered}


def _late(about: policies.LateAct, _: list[str]) -> Iterable[tuple[float, ...]]:
    yield (about.at_once_s,)
    yield from ((gap.extra_s, gap.in_s) for gap in about.gaps[:_MOST_SEEN])


_QUESTIONS = {
    "choose": _Question(lambda n: ((n + 1, 6), n + 1), _situation, _choices),
    "decide": _Question(lambda _: ((2, 5), 3), _call, _decisions),
    "place_in_line": _Question(lambda _: ((2 + _MOST_SEEN, 4), 1 + 2 * _MOST_SEEN), _line, _takes),
    "where_to_wait": _Question(lambda n: ((n + 2, 4), n + 1), _stay, _waits),
    "when_to_act": _Question(
        lambda _: ((1 + _MOST_SEEN, 2), 1 + _MOST_SEEN),
        _late,
        lambda act, *_: dict(enumerate((None, *range(len(act.gaps[:_MOST_SEEN]))))),
    ),
}
gymnasium.register("upwash/Mission-v0", entry_point="upwash.environment:UpwashEnv")
