"""Which photos servers will answer, and when: the calls of services that only servers run, in a simulated mission."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from msgspec import Struct

from upwash.config.checks import only_on_servers
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.reading import Document
from upwash.core.operation import title_of
from upwash.drone.preparation import make_estimates
from upwash.eventlog import schema
from upwash.eventlog.narration import at_places
from upwash.eventlog.progress import MissionTime
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate
from upwash.missions.bundled import load_specs
from upwash.preflight.prediction import LOCAL_ONLY, changed
from upwash.preflight.warnings import PreflightWarning
from upwash.support.text import clock, counted


class AnsweredAt(Struct, frozen=True, kw_only=True):
    """The calls of one operation that a server answers in one stay in its range, by their waypoints.

    From the first answer to the last, in seconds of the mission; the longest of the calls took `longest_s`.
    """

    operation: str
    server: str
    waypoints: tuple[int, ...]
    from_s: float
    to_s: float
    longest_s: float


class NeverAnswered(Struct, frozen=True, kw_only=True):
    """The calls of one operation that end without an answer for the same reason, by their waypoints."""

    operation: str
    waypoints: tuple[int, ...]
    why: str
    within_s: float | None = None


class ServerAnswers(Struct, frozen=True, kw_only=True):
    """The answers of services that only servers run, in the mission as configured."""

    answered: tuple[AnsweredAt, ...]
    never: tuple[NeverAnswered, ...]


def foretell(document: Document, config: DroneConfig, file: Path) -> ServerAnswers | None:
    """Fly the mission once as configured; None without a service that only servers run."""
    if not any(map(only_on_servers, config.services)):
        return None
    return answers_of(simulate(drone_config(changed(document), file)).events, config)


def answers_of(events: Sequence[Event], config: DroneConfig) -> ServerAnswers:
    """The answers in the log of a mission."""
    names = {service.name for service in config.services if only_on_servers(service)}
    began, stays = MissionTime(), dict[tuple[str, str, int | None], list[tuple[int, float, float]]]()
    never = dict[tuple[str, str, float | None], list[int]]()
    for event in events:
        began.take(event)
        match event:
            case schema.Call(
                waypoint=int(waypoint), operation=operation, server=str(server), check=check
            ) if operation.partition(".")[0] in names:
                at_s = event.t - (began.at_s or 0.0)
                stays.setdefault((operation, server, check), []).append((waypoint, at_s, event.delay_s))
            case schema.Unanswered(waypoint=int(waypoint), operation=operation, why=why, within_s=within_s):
                never.setdefault((operation, why, within_s), []).append(waypoint)
    return ServerAnswers(
        answered=tuple(
            AnsweredAt(
                operation=operation,
                server=server,
                waypoints=tuple(sorted(waypoint for waypoint, _, _ in calls)),
                from_s=round(calls[0][1], 1),
                to_s=round(calls[-1][1], 1),
                longest_s=round(max(delay_s for _, _, delay_s in calls), 1),
            )
            for (operation, server, _), calls in stays.items()
        ),
        never=tuple(
            NeverAnswered(operation=operation, waypoints=tuple(sorted(waypoints)), why=why, within_s=within_s)
            for (operation, why, within_s), waypoints in never.items()
        ),
    )


def told_answers(answers: ServerAnswers) -> Iterator[str]:
    """The same in lines for a person."""
    for stay in answers.answered:
        when = f"at {clock(stay.from_s)}"
        if stay.to_s > stay.from_s:
            when = f"from {clock(stay.from_s)} to {clock(stay.to_s)}"
        yield (
            f"{title_of(stay.operation)}, {at_places(stay.waypoints)}: answered by {stay.server} {when}, up to "
            f"{stay.longest_s:.0f} s after the call"
        )
    for never in answers.never:
        yield f"{title_of(never.operation)}, {at_places(never.waypoints)}: never answered, as {never.why}"


def answer_concerns(config: DroneConfig, answers: ServerAnswers) -> Iterator[PreflightWarning]:
    """Warn of calls that no server will answer, and of deadlines that no server can keep."""
    if config.policy.name == LOCAL_ONLY:
        for service in filter(only_on_servers, config.services):
            yield PreflightWarning(
                "unanswered",
                f"no call of {service.name} will be answered: only servers run it, and {LOCAL_ONLY} uses none",
            )
        return
    estimates = make_estimates(config, load_specs(config.services))
    fastest_s = {
        str(operation): min(delays_s)
        for operation in estimates.operations
        if (
            delays_s := [
                delay_s
                for server in config.servers
                if (delay_s := estimates.remote_s(server.name, operation)) is not None
            ]
        )
    }
    for never in answers.never:
        count = counted(len(never.waypoints), "call")
        least_s = fastest_s.get(never.operation)
        if least_s is None:
            why = "no [[server]] has a time for it: add it to remote_call_s"
        elif never.within_s is not None and never.within_s < least_s:
            why = f"within_s = {never.within_s:g} is less than the {least_s:g} s of the fastest server"
        else:
            why = never.why
        yield PreflightWarning(
            "unanswered",
            f"{count} of {title_of(never.operation)} will not be answered, at {at_places(never.waypoints)}: {why}",
        )
