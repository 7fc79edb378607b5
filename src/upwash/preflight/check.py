"""Checks a configuration before take-off: flies it in simulation, and holds the file against what came of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
from msgspec import UNSET, Struct, UnsetType

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.flight_times import usable_s
from upwash.config.places import coverage_of, file_notices, server_areas, waypoints
from upwash.config.reading import Document, read_document
from upwash.core.planning.order import Order
from upwash.drone.deadlines import require_deadlines
from upwash.drone.preparation import make_estimates, order_of, unkept_deadlines
from upwash.errors import UpwashError
from upwash.eventlog import schema
from upwash.lab.campaigns.campaign import Fly, row_of
from upwash.lab.campaigns.file import CampaignRow
from upwash.lab.outcome import outcome_of, quiet_daemons
from upwash.lab.run import Run, simulate
from upwash.lab.speed import with_speed
from upwash.missions.bundled import load_specs
from upwash.preflight.acts import WithActs, act_worlds, acts_cost, demanding_share, fly_with_acts
from upwash.preflight.answers import ServerAnswers, answer_concerns, foretell
from upwash.preflight.load import Load, load_of
from upwash.preflight.placement import Placement
from upwash.preflight.prediction import LOCAL_ONLY, Prediction, cases, changed, predict
from upwash.preflight.speed import SpeedCheck, check_speed
from upwash.preflight.warnings import Belief, PreflightWarning, is_for_flight, usable_wh, warnings
from upwash.preflight.waypoints import Farthest, ServerCoverage, coverage, farthest, uncovered
from upwash.preflight.worth import Worth, flown_well, judge, missions_to_judge
from upwash.support.progress import work


class CheckInput(Struct, frozen=True):
    """What is about to be flown, as it stands in the file and as values."""

    file: Path
    document: Document
    config: DroneConfig


class MissionCheck(Struct, frozen=True, kw_only=True):
    """What was found: the one object that `upwash check --json` prints.

    `usable_s` is how long the battery lasts above the mission's reserve, and `usable_wh` the simulated battery's
    energy above it; None if the file does not say. `farthest` is the waypoint with the longest way home. `order`
    is the order of the waypoints with its reason, "" for the given order. `notices` say how the flight differs
    from a plan, and what services print and find in the camera's photos. `demanding_share` is the share of
    answers that demand an act, if the drone may go on before it has them. `with_acts` is the mission with acts,
    where nothing tells their share. `speed` is the check of the ground speed, if photos are taken in flight.
    `worth` is what the servers save a drone that is flown well; UNSET without a server, with lighter calls, with
    deadlines, and with services that only servers run. `load` says whether the drone's own computer keeps up, in
    the manner that `worth` names for a drone with servers, or else as configured; UNSET without photos that the
    drone could compute, and for a drone alone that chooses its speed. `placement` has places of servers, if asked
    for. `answers` tells when servers answer the calls of such services, and `deadlines` how surely calls with a
    deadline keep it.
    """

    config: str
    waypoints: int
    order: str = ""
    uncovered: tuple[int, ...]
    servers: tuple[ServerCoverage, ...]
    predictions: tuple[Prediction, ...]
    usable_s: float | None
    usable_wh: float | None = None
    farthest: Farthest
    warnings: tuple[PreflightWarning, ...]
    notices: tuple[str, ...] = ()
    placement: Placement | UnsetType = UNSET
    demanding_share: float | UnsetType = UNSET
    with_acts: WithActs | UnsetType = UNSET
    speed: SpeedCheck | UnsetType = UNSET
    worth: Worth | UnsetType = UNSET
    load: Load | UnsetType = UNSET
    answers: ServerAnswers | UnsetType = UNSET
    deadlines: tuple[str, ...] | UnsetType = UNSET


def read_plan(file: Path) -> CheckInput:
    """The file's configuration; raises ConfigError."""
    document = read_document(file)
    return CheckInput(file, document, drone_config(document, file))


def missions_to_fly(plan: CheckInput, seeds: int) -> int:
    """How many missions `check` flies at most."""
    further = missions_to_judge(plan.document, plan.config, plan.file)
    acting = 2 * act_worlds(plan.config, seeds) if acts_cost(plan.config) else 0
    return (len(dict(cases(plan.document, plan.config))) + further) * seeds + acting


def check(
    plan: CheckInput, *, seeds: int, fly: Fly, flown: Callable[[int], None] = lambda _: None
) -> MissionCheck:
    """Flies each case of the mission in simulation with the seeds 1 to `seeds`, and says what was found.

    Raises UpwashError for a mission that is not completed even with every call on the drone.
    """
    places = [waypoint.position for waypoint in waypoints(plan.config.mission)]
    specs = load_specs(plan.config.services)
    order = order_of(plan.config, specs)
    config, speed_why = with_speed(plan.config, simulate)
    deadlines = require_deadlines(plan.config, specs, make_estimates(plan.config, specs), order.waypoints)
    alone, done = _flown_alone(plan, order, seeds)
    covered = coverage(
        places,
        server_areas(plan.config),
        alone.range_intervals,
        ended_s=alone.result.mission_time_s,
        known=coverage_of(plan.config),
    )
    flown(len(done))
    predictions = predict(
        dict(cases(plan.document, plan.config)), plan.file, seeds=seeds, fly=fly, flown=flown, done=done
    )
    acts = fly_with_acts(plan.document, plan.config, plan.file, seeds=seeds, fly=fly, flown=flown)
    answers = foretell(plan.document, plan.config, plan.file)
    worth = judge(plan.document, plan.config, plan.file, predictions, seeds=seeds, fly=fly, flown=flown)
    told: list[str] = []
    refusals = tuple(_refusals(plan.config, alone, told.append))
    return MissionCheck(
        config=str(plan.file),
        waypoints=len(places),
        order=order.why,
        uncovered=uncovered(len(places), covered),
        servers=covered,
        predictions=tuple(predictions),
        usable_s=usable_s(plan.config),
        usable_wh=usable_wh(plan.config),
        farthest=farthest(config),
        warnings=(
            *warnings(config, covered, list(beliefs(plan.config, alone)), predictions),
            *(PreflightWarning("no-better-answer", why) for why in unkept_deadlines(plan.config, specs)),
            *(answer_concerns(plan.config, answers) if answers is not None else ()),
            *refusals,
        ),
        notices=(*file_notices(plan.config), *told),
        demanding_share=UNSET if (share := demanding_share(plan.config)) is None else share,
        with_acts=acts or UNSET,
        speed=check_speed(config, speed_why) or UNSET,
        worth=worth or UNSET,
        load=UNSET
        if worth is None and speed_why  # of a drone alone, which keeps up with what it chose
        else load_of(flown_well(plan.document, config, plan.file, worth), specs) or UNSET,
        answers=answers or UNSET,
        deadlines=tuple(map(str, deadlines)) or UNSET,
    )


def _flown_alone(plan: CheckInput, order: Order, seeds: int) -> tuple[Run, list[CampaignRow]]:
    """The mission with every call on the drone, in the order that will be flown, and its row of a prediction."""
    config = drone_config(changed(plan.document, policy=LOCAL_ONLY), plan.file)
    in_order = "given" if order.sweep is None else order.sweep
    mission = msgspec.structs.replace(config.mission, order=in_order)
    with quiet_daemons():
        run = simulate(msgspec.structs.replace(config, mission=mission))
    if run.failure:
        raise UpwashError(f"the mission is not completed in simulation: {run.failure}")
    is_predicted = config.mission.order == in_order and 1 <= config.seed <= seeds
    return run, [row_of((LOCAL_ONLY,), config, outcome_of(run))] if is_predicted else []


def beliefs(config: DroneConfig, run: Run) -> Iterator[Belief]:
    """What is believed of each operation that the mission called."""
    estimates = make_estimates(config, load_specs(config.services))
    called = {call.operation for call in run.result.calls}
    called |= {call.asked for call in run.result.calls if call.first_s is not None}
    for operation in estimates.operations:
        local_s = estimates.local_s(operation)
        if local_s is None or str(operation) not in called:
            continue
        remote_s = {server.name: estimates.remote_s(server.name, operation) for server in config.servers}
        yield Belief(
            operation=str(operation),
            local_s=local_s,
            remote_s={name: call_s for name, call_s in remote_s.items() if call_s is not None},
        )


def _refusals(config: DroneConfig, alone: Run, tell: Callable[[str], None]) -> Iterator[PreflightWarning]:
    """What `upwash fly` would refuse, and failures of the camera and the services in flight.

    `tell` gets what the services print, and what they find in the camera's photos.
    """
    camera, is_flown = config.camera, is_for_flight(config)
    named = (camera.folder, camera.bag, camera.calibration, camera.terrain, camera.keep)
    if not is_flown and not any(named):
        return
    # these import the whole flight program
    from upwash.launch.cameras import NO_CAMERA, Look, look, needs_camera
    from upwash.launch.heard import heard
    from upwash.launch.readiness import expiry_trouble, file_refusals, refusals
    from upwash.launch.survey import services_in_trouble

    refused = list(refusals(config) if is_flown else file_refusals(config))
    for refusal in refused:
        yield PreflightWarning(refusal.kind, str(refusal.error))
    if not is_flown:
        return
    if trouble := expiry_trouble(config):
        yield PreflightWarning("certificate-ends", trouble)
    if not needs_camera(config) and any(isinstance(event, schema.PhotoTaken) for event in alone.events):
        yield PreflightWarning("no-camera", NO_CAMERA)
    seen = Look({})
    if not any(refusal.kind == "no-camera" for refusal in refused):
        try:
            with work("looking at the camera's photos"):
                seen = asyncio.run(look(config))
        except UpwashError as error:
            yield PreflightWarning("camera", str(error))
    for trouble in seen.troubles:
        yield PreflightWarning("camera", trouble)
    with work("calling each service"), heard() as found_out:
        failures = asyncio.run(services_in_trouble(config, seen.photos, tell))
    for line in found_out.lines:
        tell(line)
    for text in (*found_out.warnings, *map(str, failures)):
        yield PreflightWarning("service", text)
