"""What is predicted of small missions, and what `upwash check` says of them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from statistics import fmean

import pytest
from msgspec import UNSET

import upwash
from upwash.cli.main import main
from upwash.core.geo import Position
from upwash.errors import UpwashError, UsageError
from upwash.lab.campaigns.campaign import Chunk, fly_chunk
from upwash.lab.campaigns.file import CampaignRow
from upwash.lab.run import simulate
from upwash.preflight.acts import WithActs
from upwash.preflight.answers import ServerAnswers, answers_of
from upwash.preflight.check import MissionCheck, check, missions_to_fly, read_plan
from upwash.preflight.placement import STEPS, Places, Trials, best_places, candidates, place
from upwash.preflight.prediction import ALONE, AS_CONFIGURED, LOCAL_ONLY, drawn_worlds, without
from upwash.preflight.worth import Worth, manners
from upwash.support.text import lasting

SCENARIO = """
[mission]
waypoints_m = [[0, 0], [30, 0], [60, 0], [90, 0], [300, 0], [330, 0]]

[[service]]
name = "detector"
local_call_s = { light = 3.0, heavy = 10.0 }

[[server]]
name = "s1"
east_m = 45.0
north_m = 0.0
range_m = 60.0
remote_call_s = { light = 0.3, heavy = 0.7 }
"""
SECOND = """
[[server]]
name = "s2"
east_m = 3000.0
north_m = 0.0
range_m = 60.0
remote_call_s = { light = 0.3, heavy = 0.7 }
"""
NOISE = "\n[noise]\ncall = 0.1\nleg = 0.1\n"


@contextlib.contextmanager
def here(chunks: Sequence[Chunk]) -> Generator[Iterator[list[CampaignRow]]]:
    yield map(fly_chunk, chunks)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "drone.toml"
    file.write_text(SCENARIO)
    return file


def checked(file: Path, *, seeds: int = 1) -> tuple[MissionCheck, dict[str, float]]:
    found = check(read_plan(file), seeds=seeds, fly=here)
    return found, {
        prediction.case: prediction.mission_time_s
        for prediction in found.predictions
        if prediction.mission_time_s is not None
    }


def test_each_case_is_predicted_by_the_missions_themselves(file: Path) -> None:
    file.write_text(SCENARIO + SECOND)
    plan = read_plan(file)
    found, times_s = checked(file)
    assert list(times_s) == [LOCAL_ONLY, AS_CONFIGURED, without("s1"), without("s2"), ALONE]
    assert times_s[AS_CONFIGURED] == simulate(plan.config).result.mission_time_s
    assert times_s[AS_CONFIGURED] == times_s[without("s2")] < times_s[without("s1")]
    assert times_s[ALONE] == pytest.approx(times_s[LOCAL_ONLY], rel=0.01)
    assert [warning.kind for warning in found.warnings] == ["covers-nothing"]
    assert missions_to_fly(plan, 3) >= 3 * len(times_s)


def test_coverage_is_of_the_files_waypoints(file: Path) -> None:
    found, _ = checked(file)
    assert found.servers[0].waypoints == (0, 1, 2, 3)
    assert found.uncovered == (4, 5)
    assert found.servers[0].longest_stay_s > 4 * 10.0  # four calls on the drone, at least


def test_noise_gives_a_margin_that_has_the_mean_within_it(file: Path) -> None:
    file.write_text(SCENARIO + NOISE)
    (local_only, configured, _) = checked(file, seeds=4)[0].predictions
    assert local_only.missions == 4
    assert local_only.mission_time_s is not None
    assert configured.mission_time_s is not None
    assert 0 < local_only.certain_margin_s < local_only.mission_time_s - configured.mission_time_s


def test_a_mission_is_predicted_to_its_end_whatever_the_reserve(file: Path) -> None:
    _, times_s = checked(file)
    file.write_text(
        SCENARIO.replace("[mission]", "[mission]\nreserve_percent = 50.0")
        + "[vehicle]\nendurance_s = 150.0\n"
    )
    found, again_s = checked(file)
    assert again_s == times_s
    assert found.usable_s == 75.0 < times_s[AS_CONFIGURED]
    assert [warning.kind for warning in found.warnings] == ["battery"]
    file.write_text(
        SCENARIO.replace("[mission]", "[mission]\nreserve_s = 75.0") + "[vehicle]\nendurance_s = 150.0\n"
    )
    found, again_s = checked(file)
    assert again_s == times_s
    assert found.usable_s == 75.0
    assert [warning.kind for warning in found.warnings] == ["battery", "too-far"]


def test_a_drone_that_never_offloads_has_one_case(file: Path) -> None:
    file.write_text(SCENARIO + '[policy]\nname = "local-only"\n')
    assert list(checked(file)[1]) == [LOCAL_ONLY]


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("def fly(drone):\n    raise ValueError('no idea')\n", "raised ValueError: no idea"),
        ("def fly(drone):\n    drone.autopilot.goto(drone.plan[0])\n", "not completed in simulation: goto"),
    ],
)
def test_a_mission_that_fails_by_itself_is_said_to(file: Path, program: str, said: str) -> None:
    (file.parent / "failing.py").write_text(program)
    file.write_text(SCENARIO.replace("[mission]", '[mission]\nprogram = "failing.py:fly"'))
    with pytest.raises(UpwashError, match=said):
        checked(file)


def test_the_order_of_the_waypoints_is_said_and_why(file: Path) -> None:
    assert checked(file)[0].order == ""
    file.write_text(SCENARIO.replace("[mission]", '[mission]\norder = "best-sweep"'))
    assert checked(file)[0].order == "as given: by forecast no sweep is quicker"
    file.write_text(SCENARIO.replace("[mission]", "[mission]\norder = 1"))
    assert checked(file)[0].order.startswith("sweep 1, by rows from the ")


# --- where more servers would help --------------------------------------------------------------------------


def test_candidates_are_spread_over_the_field() -> None:
    field = candidates([Position(0.0, 0.0), Position(60.0, 0.0), Position(60.0, 120.0)])
    assert len(field) == STEPS**2
    assert (field[0], field[-1]) == (Position(5.0, 10.0), Position(55.0, 110.0))
    assert len(candidates([Position(0.0, 7.0), Position(60.0, 7.0)])) == STEPS


def test_a_server_is_placed_where_none_is_and_none_where_it_gains_nothing(file: Path) -> None:
    plan = read_plan(file)
    _, times_s = checked(file)
    placement, document = place(plan.document, plan.config, file, more=3, fly=here)
    places = placement.places
    assert [server["name"] for server in document["server"]] == ["s1", "new1"]
    assert [site.server for site in places] == ["new1"]
    assert places[0].east_m > 240.0  # within range of the last two waypoints
    assert placement.mission_time_s < times_s[AS_CONFIGURED]
    assert placement.one_less_s == pytest.approx(times_s[AS_CONFIGURED])
    assert places[0].gain_s == pytest.approx(times_s[AS_CONFIGURED] - placement.mission_time_s)


def test_the_servers_of_the_file_are_placed_anew(file: Path) -> None:
    file.write_text(SCENARIO + SECOND)
    plan = read_plan(file)
    placement, document = place(plan.document, plan.config, file, more=0, fly=here)
    assert [server["name"] for server in document["server"]] == [site.server for site in placement.places]
    assert {site.server for site in placement.places} <= {"s1", "s2"}
    assert placement.mission_time_s <= checked(file)[1][AS_CONFIGURED]


LINE = [Position(float(east_m), 0.0) for east_m in range(0, 101, 10)]


def left_out_with(*reach_m: float) -> Trials:
    """Trials that count how many places of the line no server covers."""

    def times_s(trials: Sequence[Places]) -> list[float]:
        return [sum(not covered(at, places) for at in LINE) for places in trials]

    def covered(at: Position, places: Places) -> bool:
        sites = zip(places, reach_m, strict=False)
        return any(site is not None and abs(site.east_m - at.east_m) <= reach for site, reach in sites)

    return Trials(times_s)


def test_two_servers_share_the_way_where_the_best_place_of_one_is_the_middle() -> None:
    trials = left_out_with(25.0, 25.0)
    (alone,) = best_places(LINE, [25.0], trials)
    assert alone is not None
    assert 25.0 <= alone.east_m <= 75.0
    assert trials.time_s(best_places(LINE, [25.0, 25.0], trials)) == 0.0


def test_no_server_is_placed_that_gains_nothing() -> None:
    trials = left_out_with(50.0, 30.0)
    assert len(best_places(LINE, [50.0, 30.0], trials)) == 1


def test_without_a_server_to_be_like_nothing_is_placed(file: Path) -> None:
    file.write_text(SCENARIO.partition("[[server]]")[0])
    plan = read_plan(file)
    with pytest.raises(UsageError, match=r"without a \[\[server\]\]"):
        place(plan.document, plan.config, file, more=1, fly=here)


# --- the command --------------------------------------------------------------------------------------------


def test_a_person_reads_coverage_predictions_and_warnings(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(file), "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    assert "4 of 6    0-3" in printed
    assert "out of every server's range: 4-5" in printed
    assert "nothing to warn of" in printed
    file.write_text(SCENARIO + SECOND)
    assert main(["check", str(file), "--workers", "1"]) == 1
    assert "warning: s2 covers no waypoint" in capsys.readouterr().out


def test_a_person_reads_how_far_home_is_where_a_reserve_counts_it(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = '\n[vehicle]\nprofile = "arducopter"\nendurance_s = 1000.0\n'
    file.write_text(SCENARIO.replace("[mission]", "[mission]\nreserve_s = 60.0") + vehicle)
    assert main(["check", str(file), "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    assert (
        "from waypoint 5, 330 m from home, it takes longest to the ground at home: 1:21, 8 % of the"
        in printed
    )
    assert "battery left" in printed


def test_no_word_of_a_prediction_is_broken_at_80_columns(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    keys = '[mission]\nmode = "heavy"\nfinish_by_s = 1000.0\nlighter = { heavy = "light" }'
    vehicle = '\n[vehicle]\nprofile = "arducopter"\nendurance_s = 1000.0\n'
    file.write_text(SCENARIO.replace("[mission]", keys).replace('mode = "heavy"\n\n', "\n") + vehicle + NOISE)
    main(["check", str(file), "--workers", "1", "--seeds", "2"])
    lines = capsys.readouterr().out.splitlines()
    heading = next(number for number, line in enumerate(lines) if "battery left" in line)
    cases = [line.split("  ")[1] for line in lines[heading + 1 : heading + 4]]
    assert cases == [LOCAL_ONLY, AS_CONFIGURED, without("s1")]


def test_json_is_one_object_and_the_figure_is_drawn(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    figures = file.parent / "figures"
    assert main(["check", str(file), "--json", "--workers", "1", "--figures", str(figures)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == [
        "config", "waypoints", "order", "uncovered", "servers", "predictions", "usable_s", "usable_wh", "farthest",
        "warnings", "notices", "worth", "load",
    ]  # fmt: skip
    assert [each["case"] for each in found["predictions"]] == [LOCAL_ONLY, AS_CONFIGURED, without("s1")]
    assert (figures / "coverage.png").is_file()


ON_A_GRID = SCENARIO.replace(
    "waypoints_m = [[0, 0], [30, 0], [60, 0], [90, 0], [300, 0], [330, 0]]",
    "grid = { columns = 4, rows = 2, spacing_m = 30.0 }",
)
DEMANDING = "[event]\nevery = 1\n"


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (
            SCENARIO + DEMANDING,
            "1 server is worth carrying to the field if the drone flies in its quickest manner and 100 % of the "
            "answers demand an act: ",
        ),
        (
            SCENARIO,
            "1 server is not worth carrying to the field if the drone flies in its quickest manner and no ",
        ),
        (SCENARIO + SECOND + DEMANDING, "; s2 (saves 0.0 s beside the others) can stay at home then"),
        (ON_A_GRID, "(on the move: mission.photos.every_m = 30) with it and "),
        (ON_A_GRID + "[camera]\nphoto_s = 20.0\n", '(policy.stay_or_go = "learn") with it'),
        (SCENARIO + "[policy]\nname = 'local-only'\n", ""),
        (SCENARIO.replace("[mission]", "[mission]\nfinish_by_s = 900.0\nlighter = { heavy = 'light' }"), ""),
    ],
)
def test_servers_are_worth_carrying_beside_a_drone_that_is_flown_well(
    file: Path, capsys: pytest.CaptureFixture[str], document: str, said: str
) -> None:
    file.write_text(document)
    main(["check", str(file), "--workers", "1"])
    printed = " ".join(capsys.readouterr().out.split())
    assert said in printed
    assert ("worth carrying" in printed) is bool(said)


def test_what_servers_save_is_the_difference_of_the_quickest_flights(file: Path) -> None:
    file.write_text(SCENARIO + NOISE)
    worth = checked(file, seeds=4)[0].worth
    assert isinstance(worth, Worth)
    assert worth.saved_s == (worth.alone.mission_time_s or 0) - (worth.served.mission_time_s or 0)
    assert abs(worth.saved_s) < (worth.margin_s or 0)
    assert not worth.worth
    assert worth.alone.case == worth.served.case == 'policy.stay_or_go = "learn"'


GOES = """
[policy]
stay_or_go = "learn"
"""


@pytest.mark.parametrize(
    ("event", "share", "said"),
    [
        ("", 0.0, "the forecasts above have no act, as there is no [event]"),
        ("[event]\nevery = 4", 0.25, "25 % of the answers demand an act, as [event] says"),
        ("[event]\nprobability = 0.05", 0.05, "5 % of the answers demand an act, as [event] says"),
    ],
)
def test_a_forecast_says_what_share_of_answers_demands_something(
    file: Path, capsys: pytest.CaptureFixture[str], event: str, share: float, said: str
) -> None:
    file.write_text(f"{SCENARIO}{GOES}{event}\n")
    main(["check", str(file), "--workers", "1"])
    assert said in capsys.readouterr().out
    main(["check", str(file), "--workers", "1", "--json"])
    assert json.loads(capsys.readouterr().out)["demanding_share"] == share


def test_without_a_chance_of_acts_a_check_tells_the_mission_with_and_without_them(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    acts = SCENARIO.replace("[mission]", "[mission]\naction_s = 5.0")
    file.write_text(f"{acts}[event]\nprobability = 0.75\n")
    known, times_s = checked(file, seeds=5)
    assert known.with_acts is UNSET
    file.write_text(acts)
    found, without_s = checked(file)
    assert isinstance(found.with_acts, WithActs)
    assert (found.with_acts.share, found.with_acts.source) == (0.75, "assumed")
    with_s = {each.case: each.mission_time_s for each in found.with_acts.predictions}
    assert with_s == {case: times_s[case] for case in (LOCAL_ONLY, AS_CONFIGURED)}
    main(["check", str(file), "--workers", "1"])
    said = " ".join(capsys.readouterr().out.split())
    assert f"no [event]: {lasting(without_s[AS_CONFIGURED])} (" in said
    assert "without servers) if three of four answers demand an act" in said


def test_a_check_takes_the_share_of_acts_from_the_map_of_earlier_flights(file: Path) -> None:
    kept = file.with_name("demands.json")
    learns = {"policy.stay_or_go": "learn", "policy.demand_map": str(kept), "event": {"every": 2}}
    upwash.simulate(file, overrides=learns, keep_demands=True)
    file.write_text(f'{SCENARIO}{GOES}demand_map = "{kept.name}"\n')
    acts = checked(file)[0].with_acts
    assert isinstance(acts, WithActs)
    assert acts.source == "policy.demand_map"
    assert 0.3 < acts.share < 0.7


def test_a_forecast_is_of_a_drone_that_goes_as_configured(file: Path) -> None:
    stays = checked(file)[1][AS_CONFIGURED]
    file.write_text(SCENARIO + GOES)
    assert checked(file)[1][AS_CONFIGURED] < stays


def test_it_says_what_it_assumes_of_a_vehicle_of_which_the_file_says_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mission.py").write_text("def fly(drone):\n    drone.autopilot.arm()\n")
    flight = """
    [mission]
    program = "mission.py:fly"
    home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
    waypoints_m = [[0, 0]]
    [autopilot]
    connection = "udpin:127.0.0.1:14550"
    """
    told = {}
    for vehicle in ("", "[vehicle]\nprofile = 'px4'"):
        file = tmp_path / "drone.toml"
        file.write_text(flight + vehicle)
        main(["check", str(file), "--workers", "1"])
        told[vehicle] = " ".join(capsys.readouterr().out.split())
    assert ["the predictions assume 1 m/s²" in said for said in told.values()] == [True, False]


MISSION_FOR_FLIGHT = """
[mission]
program = "{program}"
waypoints_m = [[0, 0]]
home = {{ latitude_deg = 39.0, longitude_deg = 22.0 }}
[autopilot]
connection = "udpout:127.0.0.1:1"
"""


@pytest.mark.parametrize(
    ("statement", "kinds"),
    [
        ('getattr(drone.camera, "take" + "_photo")()', {"no-camera"}),  # which its source does not show
        ("drone.autopilot.hover(1.0)", set()),
    ],
)
def test_a_missing_camera_is_warned_of_where_the_simulated_mission_takes_a_photo(
    tmp_path: Path, statement: str, kinds: set[str]
) -> None:
    (tmp_path / "mission.py").write_text(
        f"def fly(drone):\n    drone.autopilot.arm()\n    {statement}\n    drone.autopilot.disarm()\n"
    )
    (tmp_path / "drone.toml").write_text(MISSION_FOR_FLIGHT.format(program="mission.py:fly"))
    found, _ = checked(tmp_path / "drone.toml")
    assert {warning.kind for warning in found.warnings} == kinds


ASKS = """
from upwash import Drone, service

@service(where="servers")
class Segmenter:
    def segment(self, photo: bytes) -> list[str]:
        return []

def survey(drone: Drone) -> None:
    segmenter = drone.service(Segmenter, unanswered=None, within_s=WITHIN_S)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.stay_or_go(drone.start(segmenter.segment, drone.camera.take_photo()), print)
    drone.end_flight()
    drone.autopilot.disarm()
"""


@pytest.mark.parametrize(
    ("within_s", "policy", "warned"),
    [
        ("None", "look-ahead", ""),
        (
            "20.0",
            "look-ahead",
            "1 call of segmenter will not be answered, at waypoint 4: no server answered within 20 s",
        ),
        ("0.5", "look-ahead", "within_s = 0.5 is less than the 0.7 s of the fastest server"),
        ("None", "local-only", "only servers run it, and local-only uses none"),
    ],
)
def test_it_says_which_photos_servers_will_answer_and_when(
    tmp_path: Path, within_s: str, policy: str, warned: str
) -> None:
    (tmp_path / "asks.py").write_text(ASKS.replace("WITHIN_S", within_s))
    text = SCENARIO.replace('name = "detector"\nlocal_call_s = { light = 3.0, heavy = 10.0 }', "")
    text = text.replace("[[service]]\n", '[[service]]\nname = "segmenter"\nprogram = "asks.py:Segmenter"\n')
    text = text.replace("{ light = 0.3, heavy = 0.7 }", "0.7").replace(
        "[mission]\n",
        f'[policy]\nname = "{policy}"\ndetour_s = 200.0\n\n[mission]\nprogram = "asks.py:survey"\n',
    )
    file = tmp_path / "drone.toml"
    file.write_text(text)
    plan = read_plan(file)
    found = check(plan, seeds=1, fly=here)
    assert isinstance(found.answers, ServerAnswers)
    flown = simulate(plan.config).result
    assert [stay.waypoints for stay in found.answers.answered] == [
        stay.waypoints for stay in answers_of(simulate(plan.config).events, plan.config).answered
    ]
    told = [waypoint for stay in found.answers.answered for waypoint in stay.waypoints]
    assert sorted(told) == sorted(call.waypoint for call in flown.calls if call.waypoint is not None)
    never = [waypoint for never in found.answers.never for waypoint in never.waypoints]
    assert sorted(told + never) == [0, 1, 2, 3, 4, 5]
    (*_, last) = [warning.text for warning in found.warnings if warning.kind == "unanswered"] or [""]
    assert warned in last and bool(warned) == bool(last)
    assert not {"no-gain", "hurts"} & {warning.kind for warning in found.warnings}


@pytest.mark.parametrize(("columns", "worlds"), [(10, 5), (60, 4), (121, 1), (600, 1)])
def test_a_mission_of_many_photos_is_flown_in_fewer_worlds(file: Path, columns: int, worlds: int) -> None:
    grid = f"grid = {{ columns = {columns}, rows = 1, spacing_m = 10.0 }}"
    file.write_text(
        f'[mission]\naltitude_m = 20.0\n{grid}\n[[service]]\nname = "detector"\nlocal_call_s = 1.0\n'
    )
    assert drawn_worlds(read_plan(file).config) == worlds


def test_the_drone_alone_is_flown_once_in_each_world(file: Path) -> None:
    file.write_text(SCENARIO + NOISE)
    plan, flown = read_plan(file), list[tuple[str, int]]()

    def noted(chunks: Sequence[Chunk]) -> contextlib.AbstractContextManager[Iterator[list[CampaignRow]]]:
        flown.extend((chunk.values[0], seed) for chunk in chunks for seed in chunk.seeds)
        return here(chunks)

    found = check(plan, seeds=2, fly=noted).predictions[0]
    assert [seed for case, seed in flown if case == LOCAL_ONLY] == [2]
    times_s = [upwash.simulate(file, policy=LOCAL_ONLY, seed=seed).mission_time_s for seed in (1, 2)]
    assert found.missions == 2
    assert found.mission_time_s == pytest.approx(fmean(times_s))


def test_rows_without_acts_are_judged_as_configured_alone(file: Path) -> None:
    rows = SCENARIO.replace("[mission]", "[mission]\nphotos = { every_m = 10.0 }")
    file.write_text(rows)
    plan = read_plan(file)
    assert [name for name, _ in manners(plan.document, plan.config, file)] == [AS_CONFIGURED]
    file.write_text(rows + "\n[event]\nprobability = 0.1\n")
    plan = read_plan(file)
    assert len(list(manners(plan.document, plan.config, file))) == 2


def test_the_table_says_what_each_server_saves_and_the_first_lines_what_all_save(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(SCENARIO + SECOND + DEMANDING)
    _, times_s = checked(file)
    main(["check", str(file), "--workers", "1"])
    printed = capsys.readouterr().out
    served_s, alone_s = times_s[AS_CONFIGURED], times_s[LOCAL_ONLY]
    assert f"{lasting(served_s)} as configured, {100 * (1 - served_s / alone_s):.0f} % less than" in printed
    saved = {
        line.split()[0]: line.split("  ")[-2].strip() for line in printed.splitlines() if " of 6 " in line
    }
    assert saved == {"s1": lasting(times_s["without s1"] - served_s), "s2": "0.0 s"}
