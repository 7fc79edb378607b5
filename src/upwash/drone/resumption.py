"""What an interrupted flight has completed, read from its event log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from upwash.config.drone import DroneConfig
from upwash.config.places import movable_waypoints, waypoints
from upwash.core.geo import Position, ground_distance_m
from upwash.core.planning.order import Order
from upwash.core.vehicle.control import Owner
from upwash.drone.objects import FlightObjects
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces, OpenDemands
from upwash.eventlog.schema import Event
from upwash.ports import ComingDown
from upwash.support.text import counted

_SAME_PLACE_M = 0.01


def waypoints_done(events: Iterable[Event], config: DroneConfig) -> frozenset[int]:
    """The indexes of the waypoints that need no second visit.

    A waypoint is done if the drone has left it for another, or if it has as many results as a waypoint that the drone
    left. If the drone left none, it needs as many results as there are services. A waypoint is not done while its
    answer, or the action that the answer demands, is due. Raises UsageError for the log of another or a completed
    mission.
    """
    plan = {waypoint.index: waypoint.position for waypoint in waypoints(config.mission)}
    results: dict[int, int] = {}  # of the last visit to each waypoint
    left: set[int] = set()
    owed = OpenDemands()
    here: int | None = None
    back_at: int | None = None  # the waypoint of the way back
    whereabouts = CallPlaces()
    completed = False
    for event in events:
        whereabouts.take(event)
        owed.take(event)
        match event:
            case schema.LogOpened():
                results, left, owed, here, completed = {}, set(), OpenDemands(), None, False
            case schema.MissionCompleted():
                completed = True
            case schema.MissionStarted():
                _require_same_drone(event, config, len(plan))
                here = None
            case schema.SetOff(back=True, waypoint=waypoint):
                here, back_at = None, waypoint  # its calls are still to be made, or over
            case schema.SetOff(waypoint=int(index)) if here is not None and index != here:
                left.add(here)
                here = None
            case schema.Arrived(waypoint=int(index), east_m=east_m, north_m=north_m):
                _require_same_place(index, Position(east_m, north_m), plan)
                here = index
                if index != back_at or index not in results:
                    results[index] = 0
                back_at = None
            case schema.Call() if (waypoint := whereabouts.of_call) is not None and waypoint in results:
                results[waypoint] += 1
    if completed:
        raise UsageError("the mission in this log was completed: there is nothing to take up")
    wanted = max(1, max((results[index] for index in left), default=len(config.services)))
    return frozenset((left | {index for index, count in results.items() if count >= wanted}) - owed.waypoints)


def order_begun(events: Iterable[Event], config: DroneConfig) -> Order | None:
    """The order in which the waypoints were flown, as logged; None if the log has none.

    Raises UsageError for the order of another plan.
    """
    planned: schema.Planned | None = None
    for event in events:
        if isinstance(event, schema.LogOpened | schema.Planned):
            planned = event if isinstance(event, schema.Planned) else None
    if planned is None:
        return None
    if not planned.order:
        return Order(waypoints(config.mission))
    by_index = {waypoint.index: waypoint for waypoint in movable_waypoints(config.mission)}
    if sorted(planned.order) != sorted(by_index):
        raise UsageError("this log is of another plan: its order is of other waypoints than there are now")
    return Order(tuple(by_index[index] for index in planned.order), planned.order_why)


def objects_acted_on(events: Iterable[Event]) -> FlightObjects:
    """The objects that the mission has acted on, as logged."""
    acted, last = list[schema.FoundRecord](), 0
    for event in events:
        match event:
            case schema.LogOpened():
                acted, last = [], 0
            case schema.Demanded(object=schema.FoundRecord(number=number)):
                last = max(last, number)
            case schema.Acted(object=schema.FoundRecord() as record):
                acted.append(record)
    return FlightObjects(acted, last=last)


def ordered_down(events: Iterable[Event]) -> ComingDown | None:
    """How the program last ordered the vehicle to come down; None after a landing or another owner."""
    ordered: ComingDown | None = None
    for event in events:
        match event:
            case schema.Returning() | schema.SafeEnd(action="return"):
                ordered = "return"
            case schema.Landing() | schema.SafeEnd(action="land"):
                ordered = "land"
            case schema.ControlChanged(owner=Owner.PROGRAM | Owner.EARLIER_RUN):
                pass
            case (
                schema.ControlChanged()
                | schema.SafeEnd()
                | schema.Landed()
                | schema.Stood()
                | schema.Disarmed()
                | schema.Armed()
                | schema.SetOff()
                | schema.Holding()
            ):
                ordered = None
    return ordered


def _require_same_drone(started: schema.MissionStarted, config: DroneConfig, planned: int) -> None:
    if started.drone != config.name:
        raise UsageError(f"this log is of the drone {started.drone}, not of {config.name}")
    if started.waypoints != planned:
        had = counted(started.waypoints, "waypoint")
        raise UsageError(f"this log is of another plan: it had {had}, and the plan has {planned}")


def _require_same_place(index: int, logged: Position, plan: Mapping[int, Position]) -> None:
    if (planned := plan.get(index)) is None:
        raise UsageError(f"this log is of another plan: the plan has no waypoint {index}")
    if (off_m := ground_distance_m(planned, logged)) > _SAME_PLACE_M:
        where = f"waypoint {index} was {off_m:.2f} m from where it is now"
        raise UsageError(f"this log is of another plan: {where}")
