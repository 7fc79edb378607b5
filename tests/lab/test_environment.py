"""The environment of Gymnasium over simulated missions."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from tests.programs import ROOT

import upwash
from upwash.errors import MissionFailed, UsageError

gymnasium = pytest.importorskip("gymnasium", reason="needs upwash[gymnasium]")

from upwash.environment import UpwashEnv  # noqa: E402 - which needs it

Question = Literal["choose", "decide", "place_in_line", "where_to_wait", "when_to_act"]
SCENARIOS = ROOT / "scenarios"
DEMONSTRATION, ROWS = SCENARIOS / "demonstration.toml", SCENARIOS / "on-the-move.toml"
NOISE = {"noise.call": 0.3}


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = threading.active_count()
    yield
    assert threading.active_count() == before


@pytest.fixture
def env() -> Iterator[UpwashEnv]:
    made = UpwashEnv(DEMONSTRATION, overrides=NOISE)
    yield made
    made.close()


def episode(
    env: UpwashEnv, seed: int, act: Callable[[dict[str, Any]], int] = lambda info: info["built_in"]
) -> tuple[float, dict[str, Any]]:
    """The return of an agent, by default of one that repeats the built-in answers; and how the mission ended."""
    seen, info = env.reset(seed=seed)
    total, ends = 0.0, False
    while not ends:
        assert seen in env.observation_space
        assert info["action_mask"][0] and info["action_mask"][info["built_in"]]
        seen, reward, terminated, truncated, info = env.step(act(info))
        total, ends = total + reward, terminated or truncated
    assert terminated and seen in env.observation_space
    return total, info


@pytest.mark.parametrize("question", ["choose", "decide"])
def test_gymnasium_checks_it(question: str) -> None:
    from gymnasium.utils.env_checker import check_env

    made = gymnasium.make(
        "upwash.environment:upwash/Mission-v0", scenario=DEMONSTRATION, question=question, overrides=NOISE
    )
    check_env(made.unwrapped)
    made.close()


@pytest.mark.parametrize(
    ("scenario", "question"),
    [
        (SCENARIOS / "thesis.toml", "choose"),
        (SCENARIOS / "thesis.toml", "decide"),
        (ROWS, "place_in_line"),
        (ROWS, "where_to_wait"),
        (ROWS, "when_to_act"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.stem,
)
def test_the_built_in_answers_fly_the_simulated_mission_and_others_another_one(
    scenario: Path, question: Question
) -> None:
    env = UpwashEnv(scenario, question, overrides=NOISE)
    simulated = upwash.simulate(scenario, seed=3, overrides=NOISE)
    total, end = episode(env, 3)
    assert end["result"].mission_time_s == simulated.mission_time_s
    assert end["result"].calls == simulated.calls
    assert total == pytest.approx(-simulated.mission_time_s, abs=1e-6)
    total, end = episode(env, 3, lambda _: 0)
    assert end["result"].mission_time_s > simulated.mission_time_s
    assert total == pytest.approx(-end["result"].mission_time_s, abs=1e-6)


@pytest.mark.parametrize("question", ["choose", "decide", "place_in_line"])
def test_a_random_agent_flies_whole_missions(question: Question) -> None:
    env = UpwashEnv(ROWS if question == "place_in_line" else SCENARIOS / "thesis.toml", question)
    env.action_space.seed(1)
    total, end = episode(env, 1, lambda _: int(env.action_space.sample()))
    assert end["result"].completed and total == pytest.approx(-end["result"].mission_time_s, abs=1e-6)


def test_a_seed_draws_the_noise_and_without_one_each_mission_has_its_own(env: UpwashEnv) -> None:
    first, again, other = (episode(env, seed)[0] for seed in (1, 1, 2))
    assert first == again != other
    env.reset(seed=1)
    drawn = [env.reset()[1]["question"] for _ in range(2)]
    env.reset(seed=1)
    assert [env.reset()[1]["question"] for _ in range(2)] == drawn


def test_a_mission_ends_with_close_and_with_reset(env: UpwashEnv) -> None:
    before = threading.active_count()
    for _ in range(3):
        env.reset(seed=1)
        env.step(0)
        assert threading.active_count() > before
    env.close()
    assert threading.active_count() == before
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    assert episode(env, 1)[1]["result"].completed
    env.close()


def test_an_action_that_is_not_possible_counts_as_0(env: UpwashEnv) -> None:
    def after(action: int) -> Any:
        _, info = env.reset(seed=1)
        while not info["action_mask"].any(where=[False, True, True]):
            _, _, _, _, info = env.step(0)
        assert list(info["action_mask"]) == [1, 1, 0], "only the first server is in range"
        return [env.step(action)[4]["question"].current for _ in range(3)]

    assert after(2) == after(0) == [None] * 3
    assert after(1) == ["s1"] * 3


def test_an_agent_is_asked_for_no_coming_call_in_a_forecast() -> None:
    env = UpwashEnv(SCENARIOS / "thesis.toml", "decide")
    _, info = env.reset(seed=1)
    asked, ends = [info["question"]], False
    while not ends:
        _, _, ends, _, info = env.step(info["built_in"])
        asked += [info["question"]] if not ends else []
    assert not any(call.is_foreseen for call in asked)
    assert len(asked) < 2 * len(info["result"].calls)


def test_errors_and_failures_of_the_mission_are_told(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    verbs = ("arm()", "takeoff(drone.altitude_m)", "goto(drone.plan[0])")
    lines = ["def fly(drone):", *(f"    drone.autopilot.{verb}" for verb in verbs), "    1 / 0"]
    program.write_text("\n".join(lines))
    env = UpwashEnv(DEMONSTRATION, overrides={"mission.program": f"{program}:fly"})
    _, info = env.reset(seed=1)
    with pytest.raises(MissionFailed, match="ZeroDivisionError"):
        while True:
            _, _, _, _, info = env.step(info["built_in"])
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    env = UpwashEnv(DEMONSTRATION, overrides={"vehicle.endurance_s": 60.0, "mission.reserve_s": 20.0})
    _, info = env.reset(seed=1)
    terminated = truncated = False
    while not (terminated or truncated):
        _, _, terminated, truncated, info = env.step(info["built_in"])
    assert truncated and not terminated and info["failure"] and not info["result"].completed


def test_the_program_of_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs/own-policy.md").read_text()
    (program,) = re.findall(r"```python\n(from upwash\.environment .*?)```", page, re.DOTALL)
    found: dict[str, Any] = {}
    exec(program, found)
    assert found["total"] == pytest.approx(-found["info"]["result"].mission_time_s)


def test_what_cannot_be_flown_is_refused() -> None:
    with pytest.raises(UsageError, match="'land' is no question to a policy: choose, decide, "):
        UpwashEnv(DEMONSTRATION, "land")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="drones, and this is for one"):
        UpwashEnv(SCENARIOS / "fleet-demonstration.toml").reset(seed=1)
    with pytest.raises(UsageError, match="the mission never called place_in_line"):
        UpwashEnv(DEMONSTRATION, "place_in_line").reset(seed=1)
