"""What a person sees of a check: progress while missions are flown, then coverage, predictions and warnings."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence

import msgspec
from msgspec import UNSET
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.flight_times import told_pace
from upwash.eventlog.narration import spans
from upwash.lab.campaigns.campaign import Fly
from upwash.lab.figures import FigureFiles
from upwash.preflight.acts import told_acts
from upwash.preflight.answers import told_answers
from upwash.preflight.check import CheckInput, MissionCheck, check, missions_to_fly
from upwash.preflight.load import told_load
from upwash.preflight.placement import Placement, place
from upwash.preflight.prediction import (
    AS_CONFIGURED,
    LOCAL_ONLY,
    MOST_WORLDS,
    Prediction,
    drawn_worlds,
    without,
)
from upwash.preflight.speed import told_speed
from upwash.preflight.warnings import PreflightWarning, is_for_flight
from upwash.preflight.waypoints import Farthest
from upwash.preflight.worth import told_worth
from upwash.sim.chance import plays_a_part
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, lasting

_NO_PACE = (
    "the file does not say how the vehicle flies, and the predictions assume 1 m/s² and a take-off of 10 s: for an "
    'ArduCopter write profile = "arducopter" in [vehicle], for a PX4 "px4"'
)


def show_check(
    plan: CheckInput,
    *,
    seeds: int | None = None,
    more_servers: int | None = None,
    as_json: bool = False,
    figures: FigureFiles | None = None,
    fly: Fly,
) -> bool:
    """Checks the file and prints what was found; returns whether there is nothing to warn of.

    Where chance plays a part, each case is flown with `seeds` seeds; without it with as many as take little time.
    """
    seeds = (seeds or drawn_worlds(plan.config)) if plays_a_part(plan.config) else 1
    with work("missions flown in simulation", missions_to_fly(plan, seeds)) as flown:
        found = check(plan, seeds=seeds, fly=fly, flown=flown)
    drawn = plan.config
    if more_servers is not None:
        with work("missions flown to try places for servers") as flown:
            placement, document = place(
                plan.document, plan.config, plan.file, more=more_servers, fly=fly, flown=flown
            )
        found = msgspec.structs.replace(found, placement=placement)
        drawn = drone_config(document, plan.file)
    if as_json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _print(found, plan.config, more_servers or len(plan.config.servers), Console(markup=False))
    if figures is not None:
        from upwash.lab.figures.coverage import draw_coverage

        draw_coverage(drawn, figures.files("coverage"))
    return not found.warnings


def _print(found: MissionCheck, config: DroneConfig, to_place: int, console: Console) -> None:
    say(
        f"{found.config} is understood: {counted(found.waypoints, 'waypoint')}, "
        f"{counted(len(config.services), 'service')}, {counted(len(config.servers), 'server')}",
        console,
    )
    if found.order:
        say(Text(f"order of the waypoints: {found.order}"), console)
    if not is_for_flight(config):
        say(
            "it is a scenario without autopilot.connection and server addresses: what a flight needs was not checked",
            console,
        )
    if verdict := _verdict(found):
        say(Text(verdict, style="bold"), console)
    console.print()
    if found.servers:
        show_table(_coverage_table(found), console)
        say(
            Text(f"waypoints out of every server's range: {spans(found.uncovered) or 'none'}"),
            console,
        )
        console.print()
    show_table(_prediction_table(found), console)
    say(_how_sure(found, config), console)
    if is_for_flight(config) and told_pace(config.vehicle) is None:
        say(_NO_PACE, console)
    if acts := told_acts(config, found.predictions, found.with_acts or None):
        say(acts, console)
    for lines in _told(found, config):
        console.print()
        for line in lines:
            say(line, console)
    if config.mission.reserve_s is not None:
        say(_farthest_line(found.farthest, config), console)
    if found.placement is not UNSET:
        console.print()
        for line in _told_placement(found.placement, to_place):
            say(line, console)
    console.print()
    print_findings(found.notices, found.warnings, console)


def _verdict(found: MissionCheck) -> str:
    """How long the mission takes as configured, and how much less than without servers; "" if unknown."""
    times_s = {prediction.case: prediction.mission_time_s for prediction in found.predictions}
    time_s, alone_s = times_s.get(AS_CONFIGURED), times_s.get(LOCAL_ONLY)
    if not time_s or not alone_s:
        return ""
    less = 100 * (1 - time_s / alone_s)
    which = "more" if less < 0 else "less"
    return f"{lasting(time_s)} as configured, {abs(less):.0f} % {which} than with every call on the drone"


def _told(found: MissionCheck, config: DroneConfig) -> Iterator[Iterable[str]]:
    """The lines of each part that was checked."""
    worth = found.worth or None
    yield (
        *([told_worth(worth, config)] if worth else ()),
        *([told_load(found.load, judged=worth is not None)] if found.load else ()),
    )
    if found.deadlines is not UNSET:
        yield found.deadlines
    if found.answers is not UNSET:
        yield told_answers(found.answers)
    if found.speed is not UNSET:
        yield told_speed(found.speed)


def _told_placement(placement: Placement, asked: int) -> Iterator[str]:
    count = len(placement.places)
    for site in placement.places:
        yield (
            f"{site.server} at {site.east_m:.0f} m east, {site.north_m:.0f} m north: without it the mission takes "
            f"{lasting(site.gain_s)} longer"
        )
    if count:
        yield (
            f"with {counted(count, 'server')} there it takes {lasting(placement.mission_time_s)}, and with one "
            f"less, at the best places for that, {lasting(placement.one_less_s)}"
        )
    if count < asked:
        yield "one more server would gain nothing, wherever it stands"


def print_findings(notices: Sequence[str], warnings: Sequence[PreflightWarning], console: Console) -> None:
    """Prints the notices and the warnings."""
    for notice in notices:
        say(Text("notice: ", style="cyan") + Text(notice), console)
    for warning in warnings:
        say(Text("warning: ", style="yellow") + Text(warning.text), console)
    if not warnings:
        console.print(Text("nothing to warn of", style="green"))


def _coverage_table(found: MissionCheck) -> Table:
    by_case = {prediction.case: prediction for prediction in found.predictions}
    configured, waypoints = by_case.get(AS_CONFIGURED), found.waypoints
    table = Table(box=None, padding=(0, 2))
    table.add_column("server", overflow="fold")
    table.add_column("covers", justify="right", no_wrap=True)
    table.add_column("waypoints", overflow="fold")
    for title in ("longest in range", *(["saves as configured"] if configured else [])):
        table.add_column(title, justify="right", no_wrap=True)
    for server in found.servers:
        stay = f"no range: measured at {len(server.measured)} of {waypoints}"
        if server.range_m is not None:
            stay = lasting(server.longest_stay_s)
        table.add_row(
            Text(server.server),
            f"{len(server.waypoints)} of {waypoints}",
            spans(server.waypoints),
            stay,
            *([_saved(configured, by_case[without(server.server)])] if configured else []),
        )
    return table


def _saved(configured: Prediction, other: Prediction) -> str:
    """What a server saves, by the mission without it."""
    if configured.mission_time_s is None or other.mission_time_s is None:
        return "-"
    margin_s = configured.certain_margin_s + other.certain_margin_s
    return lasting(other.mission_time_s - configured.mission_time_s, margin_s)


def _prediction_table(found: MissionCheck) -> Table:
    local_only_s = next(
        (prediction.mission_time_s for prediction in found.predictions if prediction.case == LOCAL_ONLY), None
    )
    table = Table(box=None, padding=(0, 2))
    table.add_column("predicted", overflow="fold")
    for title in (
        "mission time",
        "against\nlocal-only" if _are_lighter(found) else "against local-only",
        *(["lighter\ncalls"] if _are_lighter(found) else []),
        *(["battery left"] if found.usable_s or found.usable_wh else []),
    ):
        table.add_column(title, justify="right", no_wrap=True)
    for prediction in found.predictions:
        table.add_row(*_prediction_cells(prediction, local_only_s, found))
    return table


def _prediction_cells(prediction: Prediction, local_only_s: float | None, found: MissionCheck) -> list[Text]:
    time_s = prediction.mission_time_s
    if time_s is None:
        return [Text(prediction.case), Text("not completed", style="red")]
    cells = [Text(prediction.case), Text(lasting(time_s, prediction.margin_s))]
    cells.append(Text(f"{100 * (time_s / local_only_s - 1):+.0f} %" if local_only_s else "-"))
    if _are_lighter(found):
        cells.append(Text(f"{prediction.lighter or 0:.0f}"))
    if found.usable_wh and prediction.energy_wh is not None:
        left_wh = found.usable_wh - prediction.energy_wh
        cells.append(Text(f"{left_wh:.1f} Wh", style="red" if left_wh < 0 else ""))
    elif found.usable_s:
        left_s = found.usable_s - time_s
        cells.append(Text(lasting(left_s), style="red" if left_s < 0 else ""))
    return cells


def _are_lighter(found: MissionCheck) -> bool:
    return any(prediction.lighter is not None for prediction in found.predictions)


def _how_sure(found: MissionCheck, config: DroneConfig) -> str:
    missions = found.predictions[0].missions
    if plays_a_part(config):
        sure = f"means of {counted(missions, 'simulated mission')} each, ± 95 % confidence"
        if missions == 1:
            sure = f"one simulated mission each, in one drawn world: --seeds {MOST_WORLDS} flies more"
    else:
        sure = "one simulated mission each, as without [noise] all are alike"
    if found.usable_s is not None or found.usable_wh is not None:
        return sure
    return f"{sure}; vehicle.endurance_s is not given, so nothing says whether the battery lasts"


def _farthest_line(far: Farthest, config: DroneConfig) -> str:
    down = "there" if config.autopilot.on_failure == "land" else "at home"
    needs = "" if far.needed_percent is None else f", {far.needed_percent:.0f} % of the battery"
    return (
        f"from waypoint {far.waypoint}, {far.away_m:.0f} m from home, it takes longest to the ground {down}: "
        f"{lasting(far.home_s)}{needs}, without wind"
    )
