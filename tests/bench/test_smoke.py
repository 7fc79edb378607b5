"""Every program of bench/ tells its options; at night it runs with little to do, and prints its figures."""

from __future__ import annotations

import json
import re
import runpy
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.programs import ROOT, printed
from tests.system.browser import why_not

from upwash.errors import UsageError
from upwash.real.instances.sandbox import find_sandbox

QUICK = {  # what each prints, among others
    "baselines": r"\| waits \| 3 \| .*\n(.*\n)*.*\| 10 % \|( -?[\d.]+ /?){3}\|(.*\n)*\| 2, same field, 2 servers \|",
    "batches": r"\nheavy +[\d.]+ ms( +[\d.]+){3}\n",
    "call": r"upwash, on the server, mutual TLS +[\d.]+ ms +[\d.]+\n",
    "deadline_bounds": r"\| one \| log-normal, 0.988 in time \| 300 \| [\d.]+ % \| [\d.]+ % \|",
    "decide": r"range everywhere +median [\d.]+ ms",
    "demands": r"\| 3 %, corner 80 % \| 4 s( \| -?[\d.]+ ± [\d.]+ %){4} \|\n",
    "deployments": r"\| Raspberry Pi 5, 48 tiles \| 4.4 / 1.7 \| 1.5( \| -?[\d.]+ / -?[\d.]+){3} \|",
    "detector": r"heavy +[\d.]+ ms +[\d.]+ ms +[\d.]+ ms +[\d.]+ +\d+\n",
    "findings": r" 40 m +0° 1.5 m \|( +\d+ \|){1}( +[\d.]+ m +[\d.]+ m +[\d.]+ % \|){2} +[\d.]+ +[\d.]+\n",
    "fleets": r"- look-ahead\n( +[\d.]+)+\n",
    "fleets_rows": r"8 drones: [\d.]+ s, [\d.]+ s in the model; 1 fields: [\d.]+ of the model .*; 0 blacklistings\n",
    "first_call": r"\| look-ahead \| \+0.5 s \| thesis, .* \| [-+][\d.]+ % \|",
    "gains": r"\| thesis: equal-servers-light, hitl \| [\d.]+ ± [\d.]+ \| [\d.]+ ± [\d.]+ \| = \|",
    "hedging": r"\| no answer \| with \| ([\d.]+ \| ){4}\d+ \| \d+ of \d+ \|",
    "lighter": r"\| 1372 \| \d+ \| [\d.]+ s \| 0\.9\d+ \|",
    "load": r"\| 1 \| upwash, 1 slot \| [\d.]+ \| (\d+|nan) \| (\d+|nan) \| 0 \|",
    "metrics": r"[\d.]+ us for each call\n",
    "own_policy": r"in a process +median +\d+ us.*\nprocess to thread, within a turn: [\d.]+",
    "only_servers": r"\| rows \| 40 m \| [\d.]+ of 121 \|( [\d.]+ s \|){2}( [\d.]+ \|){3} [\d.]+ s \|\n",
    "placement": r"\| thesis( \| [\d.]+ s){3} \| \d+ of 300 \|\n",
    "rows": r"10 %( \| [\d.]+){5}\n1,485 photos .*\n4 m/s \|  \|  \| [\d.]+ \|  \| \n",
    "rows_choices": r"\| `photos\.order = \"newest\"` \| 2 \| -?[\d.]+ ± [\d.]+ % \| \d \| \d \|",
    "rows_rules": r"beside the model, all \(2\): [-+][\d.]+% in the mean",
    "acts": r"beside acting at once, all \(2\): [+-][\d.]+%",
    "size": r"core +[\d,]+\n",
    "sharing": r"adjacent fields, 4 servers.*\n.*bound\n +1( +[\d.]+ / [\d.]+ / [\d.]+){4} +[\d.]+\n",
    "simulate": r"- servers, all near\n( +[\d.]+)+\n",
    "stay_or_go": r" 50 % +[\d.]+( +-?[\d.]+ ± [\d.]+ %){2} +[\d.]+ / [\d.]+\n",
    "tiles": r"\| auto \| 49 (\| \d+ ms ){3}\| [\d.]+ \| [\d.]+ (PASS|MISS) \|",
    "whatif": r"\d+ of 3 hold \([\d.]+ %\)",
    "two_answers": r"\| rows \| 4 s \| [\d.]+ \| -?[\d.]+ ± [\d.]+ % \|",
    "vehicle": r"\| total \| [\d.]+ \| [\d.]+ \|",
}
RUN_BELOW = {"flights", "px4_events", "px4_figures"}  # in moments
BELOW = {"promises", "sandbox", "view", "weight", *RUN_BELOW}
# In test_smoke_as_root.py and tests/system/test_peers_bench.py.
AS_ROOT = {"containers", "deadlines", "less_to_send", "links", "peers", "ros", "validate"}
ENDS = {"client", "servers"}  # which `call` and `load` start


def test_no_program_is_left_out() -> None:
    programs = {
        file.stem
        for file in (ROOT / "bench").glob("*.py")
        if '\nif __name__ == "__main__":' in file.read_text()
    }
    programs |= {file.parent.name for file in (ROOT / "bench").glob("*/__main__.py")}
    assert programs == QUICK.keys() | BELOW | AS_ROOT | ENDS


@pytest.mark.parametrize("program", sorted((QUICK.keys() | BELOW | AS_ROOT) - RUN_BELOW))
def test_a_program_tells_how_it_is_used(
    program: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [program, "--help"])
    monkeypatch.delitem(sys.modules, f"bench.{program}", raising=False)
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"bench.{program}", run_name="__main__", alter_sys=True)
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage: ")


@pytest.mark.system
@pytest.mark.nightly
@pytest.mark.parametrize("program", QUICK)
def test_a_program_prints_its_figures(program: str) -> None:
    assert re.search(QUICK[program], printed(f"bench.{program}", "--quick"))


@pytest.mark.system
@pytest.mark.nightly
def test_missions_of_two_checkouts_stand_beside_each_other() -> None:
    said = printed("bench.simulate", "--quick", "--against", str(ROOT))
    assert re.search(
        r"\nprocessor: median [\d.]+ ms there, [\d.]+ ms here; ratio within a turn [\d.]+\n", said
    )


@pytest.mark.system
@pytest.mark.nightly
def test_a_soak_tells_what_the_daemon_holds() -> None:
    said = printed("bench.load", "--quick", "--soak", "2")
    assert re.search(r"\d+ s: [\d.]+ MB, \d+ descriptors\n", said)
    assert re.search(r"\n\d+ calls, 0 failed, p50 (\d+|nan) ms", said)


def test_flights_of_an_arducopter_stand_beside_the_stand_ins() -> None:
    assert re.search(
        r"\| hold at 4.9 m/s runs on \| [\d.]+ \| [\d.]+ \| [-+][\d.]+ % \|", printed("bench.flights")
    )


def test_pages_are_looked_at_without_being_written() -> None:
    assert re.search(r"(\d+) of \1 pages were as the results say", printed("bench.promises", "--check"))


@pytest.mark.system
@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/smaps").exists(), reason="/proc/PID/smaps is Linux's")
def test_a_drones_programs_are_weighed() -> None:
    said = printed("bench.weight", "--quick")
    assert said.startswith("MB, medians of 1 ")
    assert re.search(r"\ndrone on its own +([\d.]+ +){4}[\d.]+\n", said)
    assert re.search(r"\nits service imports \d+ modules: [\d.]+ MB", said)


@pytest.mark.system
@pytest.mark.nightly
@pytest.mark.skipif(bool(why_not()), reason=why_not())
def test_a_page_is_watched() -> None:
    said = printed("bench.view", "--quick")
    assert re.search(r"\n20 waypoints, .* limit 5.0 s:\n  now, opened at once: [\d.]+ s \(median\)", said)
    for what in "positions", "calls":
        assert re.search(rf"\n{what}: \d+ shown after [\d.]+ s \(median\)", said)


@pytest.mark.sandbox
@pytest.mark.system
@pytest.mark.nightly
def test_calls_into_a_sandbox_stand_beside_others() -> None:
    try:
        find_sandbox(readable=())
    except UsageError as error:
        pytest.skip(str(error))
    assert re.search(r"\nin bubblewrap [-+][\d.]+ ms, [\d.]+ times", printed("bench.sandbox", "--quick"))


# --- what reads recordings of a PX4 -------------------------------------------------------------------------


def test_events_of_a_px4_are_named_by_number(tmp_path: Path) -> None:
    group = {"events": {"7": {"name": "armed"}}}
    components = {"1": {"event_groups": {"default": group, "calibration": group}}, "2": {"event_groups": {}}}
    metadata = tmp_path / "all_events.json"
    metadata.write_text(json.dumps({"components": components}))
    assert printed("bench.px4_events", metadata) == f"number,name\n{(1 << 24) + 7},armed\n"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a vehicle that flies 40 m northwards in 10 s and back, steadily, and then stands."""
    folder = tmp_path_factory.mktemp("recordings")
    telemetry = b"".join(map(recorded_position, range(100)))
    legs = (
        "[ 20.0] arrival at 0.0,0.0,10 x: 10.0 s\n"
        "[ 30.0] arrival at 0.0,40.0,10 x: 10.0 s\n"
        "[ 40.0] arrival at 0.0,0.0,10 x: 10.0 s\n"
    )
    ends = "[ 50.0] land at destination\n[ 60.0] LANDED_STATE ON_GROUND\n[ 61.0] landing_detected\n"
    words = {f"ref_{kind}": legs for kind in ("reposition_8", "offboard_4", "offboard_default")}
    words |= {
        "ref_reposition_4": (
            f"{legs}[ 10.0] lift (0.3 m) after 3.5 s\n[ 12.0] AUTO.LOITER after 9.0 s at 9.8 m\n"
            f"[ 45.0] COMMAND [1, 4, 5, 0]\n{ends}[ 62.0] commander_disarmed_by\n"
        ),
        "fault_companion_link_lost": (
            "[ 20.0] companion silent\n[ 22.0] mission_comp_lost\n[ 23.0] COMMAND [1, 4, 5, 0]\n"
            "[ 30.0] GCS gone\n[ 32.0] commander_gcs_lost\n[ 33.0] MODE AUTO.RTL\n"
            f"{ends}"
        ),
        "fault_low_battery": f"[ 45.0] MODE AUTO.LAND\n{ends}",
        "fault_prearm_refused": "[ 1.0] commander_armed_by\n[ 11.0] auto preflight\n",
        "fault_offboard_loss_act0": (
            f"[ 20.0] companion silent\n[ 21.0] Failsafe activated\n[ 22.0] MODE POSCTL\n{ends}"
        ),
        "fault_offboard_loss_act5": "[ 38.0] left OFFBOARD\n",
        "fault_gps_lost": f"[ 20.0] SIM_GPS_USED = 0\n[ 25.0] MODE AUTO.LAND\n{ends}",
        "pilot_mode_switch": "[ 38.0] pilot switches to POSCTL\n",
    }
    for name, text in words.items():
        (folder / f"{name}.log").write_text(text)
        (folder / f"{name}.tlog").write_bytes(telemetry)
    return folder


def recorded_position(second: int) -> bytes:
    """What a .tlog has of one second."""
    there = 20 <= second < 30
    moves = there or 30 <= second < 40
    north_m = 4.0 * (second - 20) if there else 4.0 * (40 - second) if moves else 0.0
    position = mavlink.MAVLink_global_position_int_message(
        second * 1000,
        round((39.3666 + north_m / 111_037.0) * 1e7),
        round(22.9507e7),
        10_000,
        10_000,
        (400 if there else -400) if moves else 0,
        0,
        0,
        0,
    )
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return (second * 1_000_000).to_bytes(8) + bytes(position.pack(sender))


def test_figures_are_read_out_of_recordings_of_a_px4(recordings: Path) -> None:
    head, *rows = printed("bench.px4_figures", recordings).splitlines()
    assert head == "figure,median,least,most,times"
    figures = dict(row.split(",", 1) for row in rows)
    assert figures["leg_reposition_4_s"] == "10.0,10.0,10.0,1"
    assert figures["companion_lost_s"] == "2.0,2.0,2.0,1"
    head, *rows = printed("bench.px4_figures", recordings, "--profiles").splitlines()
    assert head == "kind,time_s,way_m,speed_m_s"
    assert "offboard_4,5.0,20.0,4.0" in rows
