"""The promise about calls that a second server gets too: 26."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.lab.faults.history import Breach, History, service_of


def two_servers(history: History) -> Iterator[Breach]:
    """Only calls with a deadline go to a second server, which is READY and gets no more than its share."""
    extra = {service.name: service.deadline.extra for service in history.config.services if service.deadline}
    states: dict[str, State] = {}
    ended, asked = Counter[str](), Counter[str]()
    for event in history.run.events:
        match event:
            case schema.ServerStep(server=server, after=after):
                states[server] = after
            case schema.Call():
                ended[service_of(event)] += 1
            case schema.Seconded(server=server, second=second):
                service = service_of(event)
                if service not in extra:
                    yield event, f"{service} has no deadline"
                    continue
                if second == server or states.get(second) is not State.READY:
                    yield event, f"{second} is {states.get(second)}, and {server} has the call"
                asked[service] += 1
                calls = ended[service] + 1
                if asked[service] > 1 + extra[service] * calls:
                    yield (
                        event,
                        f"it is number {asked[service]} of {calls} calls, {extra[service]:g} is allowed",
                    )
