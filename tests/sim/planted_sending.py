"""Defects of parts that make requests smaller before they are sent."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
from tests.sim.planting import plant, planted

from upwash.core.knowledge.estimates import Estimates
from upwash.core.selection.call_placement import CallPlacement
from upwash.drone.before_sending import BeforeSending, NotReduced
from upwash.errors import InstanceError
from upwash.rpc.service import Method, Reduced


@planted("less is sent whatever loss the user allows", Estimates, "__init__")
def any_loss(init: Any, self: Estimates, **known: Any) -> None:
    init(self, **known | {"most_loss": 1.0})


plant("a part that fails is tried for ever", Estimates, "tries_part", lambda *_: True)
plant("a server that was left meanwhile gets the smaller request", CallPlacement, "may_send", lambda *_: True)


@planted("a call fails with its part", BeforeSending, "reduce")
async def fails_with_it(reduce: Any, self: BeforeSending, *call: Any, **more: Any) -> Any:
    try:
        return await reduce(self, *call, **more)
    except NotReduced as error:
        raise InstanceError(str(error)) from error


@planted("a part takes as long as it likes", BeforeSending, "reduce")
async def takes_long(reduce: Any, self: BeforeSending, *call: Any, deadline_s: float) -> Any:
    await asyncio.sleep(2 * deadline_s)
    return await reduce(self, *call, deadline_s=deadline_s)


@planted("a part changes the types of arguments", Method, "reduced")
def other_types(reduced: Any, self: Method, request: bytes, reply: bytes) -> Reduced:
    arguments = msgspec.msgpack.decode(reduced(self, request, reply))
    return Reduced(msgspec.msgpack.encode(arguments | {"number": str(arguments["number"])}))
