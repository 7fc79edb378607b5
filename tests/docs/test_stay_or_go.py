"""What missions take that stay, go or learn, and what docs/calls.md says of that."""

from __future__ import annotations

from typing import Any

import pytest
from tests.docs.test_docs import ROOT
from tests.scenarios import scenario, server

from upwash.lab.bounds import bound_of
from upwash.lab.run import simulate

PAGE = (ROOT / "docs/calls.md").read_text()
ROWS = [  # seconds to stay, go and learn, and the least possible
    ("10", "every tenth", 2497.0, 1432.8, 1432.8, 1287.0),
    ("10", "none", 2437.0, 1237.0, 1237.0, 1237.0),
    ("3", "every tenth", 1650.0, 1423.8, 1426.8, 1287.0),
    ("3", "none", 1590.0, 1230.0, 1233.0, 1230.0),
    ("0.7 or 10", "every tenth", 1501.9, 1330.6, 1330.6, 1287.0),
    ("0.7 or 10", "none", 1441.9, 1237.0, 1237.0, 1237.0),
]
# By a model of the question that shares no code with this one, and takes the next photo again after a turn back. It
# acts at once.
MODELLED_S = {
    ("10", "every tenth"): (2497.0, 1525.0, 1525.0),
    ("10", "none"): (2437.0, 1237.0, None),
    ("3", "every tenth"): (1650.0, 1434.0, 1437.0),
    ("3", "none"): (1590.0, 1230.0, None),
    ("0.7 or 10", "every tenth"): (1501.9, 1330.6, 1330.6),
    ("0.7 or 10", "none"): (1441.9, 1237.0, None),
}
MANNERS = ("stay", "go", "learn")
AT_ONCE = {"range_m": 105.0, "check_s": 0.0, "check_running_s": 0.0, "truth": {"join_s": 0.0, "start_s": 0.0}}
SERVERS = [server("s1", 80.0, 80.0, **AT_ONCE), server("s2", 120.0, 120.0, **AT_ONCE)]


def flown_s(delay_s: str, events: str, manner: str, **policy: float) -> tuple[float, float]:
    """How long the survey takes, and the bound of that."""
    servers, name = (SERVERS, "location-aware") if "or" in delay_s else ([], "local-only")
    local_s = float(delay_s.rpartition("or")[2])
    event: dict[str, Any] = {"event": {"every": 10, "offset": 5}} if events == "every tenth" else {}
    config = scenario(
        *servers,
        columns=11,
        rows=11,
        mission={"action_s": 5.0},
        policy={"name": name, "stay_or_go": manner, **policy},
        service=[{"name": "detector", "local_call_s": {"light": 3.0, "heavy": local_s}}],
        **event,
    )
    run = simulate(config)
    bound = bound_of(run, config)
    assert bound is not None
    return run.result.mission_time_s, bound.free_s


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]} s, {row[1]}")
def test_missions_take_as_long_as_is_known(row: tuple[Any, ...]) -> None:
    delay_s, events, *known_s = row
    flown = {manner: flown_s(delay_s, events, manner) for manner in MANNERS}
    assert flown["go"][1] == pytest.approx(flown["learn"][1]), "it is of the world, not of the flight"
    missions_s = (*(mission_s for mission_s, _ in flown.values()), flown["go"][1])
    assert missions_s == pytest.approx(known_s, abs=0.05)


@pytest.mark.parametrize("case", MODELLED_S, ids=lambda case: f"{case[0]} s, {case[1]}")
def test_a_model_that_acts_at_once_takes_as_long(case: tuple[str, str]) -> None:
    for manner, modelled_s in zip(MANNERS, MODELLED_S[case], strict=True):
        mission_s, _ = flown_s(*case, manner, act_within_s=0.0)
        assert modelled_s is None or mission_s == pytest.approx(modelled_s, rel=0.01)


def test_the_page_says_what_going_saves() -> None:
    saved = sorted(1 - moving_s / row[2] for row in ROWS for moving_s in row[3:5])
    assert f"both save {100 * saved[0]:.0f} to {100 * saved[-1]:.0f} %" in PAGE


def test_all_cases_are_modelled() -> None:
    assert {(delay_s, events) for delay_s, events, *_ in ROWS} == MODELLED_S.keys()
