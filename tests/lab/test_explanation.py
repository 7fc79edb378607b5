"""`upwash explain`: the reasons of a flight in words, and the same world under other policies."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash import simulate_fleet
from upwash.cli.main import main
from upwash.support.text import lasting

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "scenarios" / "power-line-heavy.toml"
IN_ITS_WORLD = ("--scenario", str(SCENARIO))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("flight") / "log.jsonl"
    assert main(["simulate", str(SCENARIO), "--policy", "look-ahead", "--json", "--log", str(file)]) == 0
    return file


def explanation(capsys: pytest.CaptureFixture[str], log: Path, *options: str) -> list[str]:
    capsys.readouterr()
    assert main(["explain", str(log), *options]) == 0
    return capsys.readouterr().out.splitlines()


def without_its_scenario(log: Path, tmp_path: Path) -> Path:
    """The log as a real flight leaves it."""
    lines = log.read_bytes().splitlines(keepends=True)
    file = tmp_path / "flown.jsonl"
    file.write_bytes(b"".join(lines[1:]))
    return file


def test_every_call_is_explained_by_what_was_believed(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    lines = explanation(capsys, log)
    headings = [line for line in lines if line.startswith("waypoint ")]
    assert len(headings) == 81
    fifth = lines[lines.index(headings[5]) : lines.index(headings[6])]
    assert fifth[0].endswith("on pole2, 3.08 s")
    assert fifth[1] == "    Ran on pole2, ready after a wait of 2.38 s, in 3.08 s."
    assert "pole1 was deselected: pole2 serves the next 20 calls in " in fifth[2]
    assert "less than with pole1 kept" in fifth[2]
    assert "0.70 s on pole2 (joining for 9.1 of 11.5 s)" in fifth[4]
    assert fifth[5].endswith("decided: wait for pole2 for at most 6.8 s (expected to be ready in 2.38 s)")


def test_the_calls_of_one_waypoint_or_the_worst_alone_are_explained(
    capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    everything = explanation(capsys, log, *IN_ITS_WORLD)
    one = explanation(capsys, log, "--waypoint", "5", *IN_ITS_WORLD)
    assert [line for line in one if line.startswith("waypoint ")] == [
        line for line in everything if line.startswith("waypoint 5,")
    ]
    assert one[-5:] == everything[-5:], "the missions are compared all the same"
    assert explanation(capsys, log, "--worst", "3")[0] == (
        "no call took longer than was expected of the best place for it"
    )


def test_a_waypoint_without_a_call_is_refused(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    assert main(["explain", str(log), "--waypoint", "999"]) == 2
    assert "--waypoint 999: no call was made there" in capsys.readouterr().err


def test_other_policies_are_flown_in_the_world_that_is_given(
    capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    lines = explanation(capsys, log, *IN_ITS_WORLD)
    told = [line for line in lines if line.startswith("    local-only: on the drone, 10.00 s; ")]
    assert len(told) == 81
    assert "location-aware: on the drone, 10.00 s" in told[5]
    took = dict(
        line.strip().split(": ") for line in lines[-5:]
    )  # all from 10:00 to 59:59: as text in their order
    assert took["look-ahead"] == lines[-6].split()[2].rstrip(";")
    assert took["theoretical minimum"] < took["look-ahead"] < took["location-aware"]


def test_a_log_without_a_world_is_explained_by_itself_or_in_one_that_is_given(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    flown = without_its_scenario(log, tmp_path)
    alone = explanation(capsys, flown)
    assert alone[-1].endswith("give --scenario FILE to see what other policies would have done")
    assert not any("local-only" in line for line in alone)
    assert explanation(capsys, flown, *IN_ITS_WORLD) == explanation(capsys, log, *IN_ITS_WORLD)


def test_no_program_of_the_world_that_a_log_names_runs_unless_that_world_is_given(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    ran = tmp_path / "ran"
    (tmp_path / "sent.py").write_text(f"open({str(ran)!r}, 'w').close()\ndef fly(drone): pass\n")
    world = tmp_path / "world.toml"
    world.write_text('[mission]\nprogram = "sent.py:fly"\nwaypoints_m = [[0, 0], [10, 0]]\n')
    named, *events = log.read_bytes().splitlines(keepends=True)
    sent = tmp_path / "sent.jsonl"
    sent.write_bytes(named.replace(str(SCENARIO).encode(), str(world).encode()) + b"".join(events))
    assert f"(the log names {world}, whose programs run then)" in explanation(capsys, sent)[-1]
    assert not ran.exists()
    explanation(capsys, sent, "--scenario", str(world))
    assert ran.exists()


def test_a_world_where_the_mission_makes_other_calls_is_no_comparison_call_by_call(
    capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    lines = explanation(capsys, log, "--scenario", str(ROOT / "scenarios" / "no-servers.toml"))
    assert "    local-only: other calls; opportunistic: other calls; location-aware: other calls" in lines


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("seed = 1\n", "is not an event log"),
        ("[]\n", "is not an event log"),
        ("{}\n", "is not an event log"),
        ("", "is not an event log"),
        ('{"t": 0.0, "event": "landed"}\n', "no service call"),
    ],
)
def test_what_is_no_log_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, complaint: str
) -> None:
    file = tmp_path / "log.jsonl"
    file.write_text(text)
    assert main(["explain", str(file)]) == 2
    assert complaint in capsys.readouterr().err
    assert main(["explain", str(tmp_path / "missing.jsonl")]) == 2
    assert "cannot read the event log" in capsys.readouterr().err


FLEET = """
[mission]
grid = { columns = 3, rows = 2, spacing_m = 20.0 }

[[service]]
name = "detector"
local_call_s = { light = 3.0, heavy = 10.0 }

[[server]]
name = "s1"
east_m = 20.0
north_m = 20.0
range_m = 90.0
remote_call_s = { light = 0.3, heavy = 0.7 }

[[drone]]
name = "d1"
policy = "local-only"

[[drone]]
name = "d2"
departs_s = 20.0
waypoints_m = [[0, 0], [20, 0], [40, 0]]
"""


def test_one_of_several_drones_is_explained_among_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario, log = tmp_path / "fleet.toml", tmp_path / "log.jsonl"
    scenario.write_text(FLEET)
    assert main(["simulate", str(scenario), "--json", "--log", str(log)]) == 0
    fleet = simulate_fleet(scenario)
    for name, calls in ("d1", 6), ("d2", 3):
        lines = explanation(capsys, log.with_name(f"log-{name}.jsonl"), "--scenario", str(scenario))
        assert len([line for line in lines if line.startswith("waypoint ")]) == calls
        flown = fleet.drones[name]
        (own,) = [line for line in lines if line == f"    {flown.policy}: {lasting(flown.mission_time_s)}"]
        assert "in the same world, among drones that fly as the scenario says, simulated:" in lines[-6]
        assert own in lines[-5:]


def test_the_drone_that_is_explained_is_one_of_the_scenarios(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], log: Path
) -> None:
    scenario = tmp_path / "fleet.toml"
    scenario.write_text(FLEET)
    assert main(["explain", str(log), "--scenario", str(scenario)]) == 2
    assert 'name one with --drone; unknown drone "drone"; allowed: d1, d2' in capsys.readouterr().err
    assert "other calls" in "".join(explanation(capsys, log, "--scenario", str(scenario), "--drone", "d2"))
    assert main(["explain", str(log), "--drone", "d2"]) == 2
    assert "--drone d2 goes with --scenario FILE" in capsys.readouterr().err
    assert main(["explain", str(log), "--drone", "d2", *IN_ITS_WORLD]) == 2
    assert "has no [[drone]] tables: leave it out" in capsys.readouterr().err


# --- answers that come later ----------------------------------------------------------------------------------


def flown(tmp_path: Path, manner: str) -> Path:
    scenario, file = tmp_path / "survey.toml", tmp_path / f"{manner}.jsonl"
    scenario.write_text(
        f"""
        [mission]
        mode = "heavy"
        waypoints_m = [[0, 0], [20, 0], [40, 0], [60, 0]]
        [policy]
        name = "local-only"
        stay_or_go = "{manner}"
        [[service]]
        name = "detector"
        local_call_s = {{ light = 3.0, heavy = 3.0 }}
        [event]
        every = 4
        offset = 1
        """
    )
    assert main(["simulate", str(scenario), "--json", "--log", str(file)]) == 0
    return file


def of_waypoint(lines: list[str], waypoint: int) -> list[str]:
    (first,) = (number for number, line in enumerate(lines) if line.startswith(f"waypoint {waypoint}, "))
    return lines[first : lines.index("", first)]


def test_it_says_why_the_drone_went_on_and_how_far_it_turned_back(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = explanation(capsys, flown(tmp_path, "go"))
    assert of_waypoint(lines, 0)[4:6] == [
        "    the drone went on before the answer: it always goes; to go saves 3.00 s where the answer demands "
        "nothing, and costs 9.00 s where it does, by earlier answers with a chance of 25 %",
        "    the answer was taken at 0:20, and demanded nothing",
    ]
    assert "    the answer demanded something: the drone turned back, and flew 9.0 m" in of_waypoint(lines, 1)
    assert "    the drone stayed for the answer: no waypoint is known to follow" in of_waypoint(lines, 3)


def test_of_a_drone_that_always_stays_it_says_nothing_of_going(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = explanation(capsys, flown(tmp_path, "stay"))
    assert not [line for line in lines if "went on" in line or "stayed" in line or "demanded" in line]
