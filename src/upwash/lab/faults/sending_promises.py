"""Promises about what is sent: 25, smaller requests, and 26, calls that a second server gets too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.lab.faults.history import Breach, History, service_of

_MOST_FAILURES = 3  # in a row
_REFUSED = "builtins.TypeError: look():"  # an instance's word on arguments of other types


def less_to_send(history: History) -> Iterator[Breach]:
    """A part is used only as far as the user allows its loss, keeps the types, and is given up after failures."""
    most_loss = history.config.policy.most_loss
    allowed = {
        service.name
        for service in history.config.services
        if service.before_sending is not None and max(service.before_sending.loss.values()) <= most_loss
    }
    failed, given_up = Counter[str](), set[str]()
    for event in history.run.events:
        match event:
            case schema.Decided(less_s=float()) if not most_loss or service_of(event) not in allowed:
                yield event, f"less may be sent, and most_loss is {most_loss:g}"
            case schema.Decided(less_s=float()) if service_of(event) in given_up:
                yield event, "the part was given up before"
            case schema.Call(sent_bytes=int(sent_bytes), whole_bytes=int(whole_bytes)):
                failed[service_of(event)] = 0
                if sent_bytes >= whole_bytes:
                    yield event, f"{sent_bytes} bytes were sent in place of {whole_bytes}"
            case schema.Dropped():  # perhaps an answer to less
                failed[service_of(event)] = 0
            case schema.SentWhole(given_up=is_last):
                service = service_of(event)
                failed[service] += 1
                given_up |= {service} if is_last else set()
                if failed[service] >= _MOST_FAILURES and not is_last:
                    yield event, f"the part failed {failed[service]} times in a row and is not given up"
            case schema.RemoteRaised(raised=raised) if raised.startswith(_REFUSED):
                yield event, "what was sent has other types than the service takes"


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
                    number = f"it is number {asked[service]} of {calls} calls"
                    yield event, f"{number}, {extra[service]:g} is allowed"
