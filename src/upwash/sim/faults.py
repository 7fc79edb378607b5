"""What goes wrong in a simulated world, where and when: docs/faults.md says what each kind of fault and of lie does.

The programs know nothing of it: faults sit in the models around them. Instances that run when a fault begins still
run when it is over, except those of `crash`, `power-cut`, `hung`, `poisoned` and `unstartable`. Each kind of lie
changes an honest reply in several ways, in turn.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import Any

import msgspec

from upwash.config.world import FaultConfig, Lie
from upwash.core.admission.clients import Client
from upwash.errors import Refused, Unreachable, UsageError
from upwash.rpc.protocol import (
    AVAILABILITY,
    HOLD,
    LEAVE,
    PREPARE,
    START,
    AvailabilityReply,
    AvailabilityRequest,
    HoldReply,
    LeaveRequest,
    StartReply,
    resolve,
)
from upwash.sim.link import Handler, Switchboard
from upwash.support.background import never

_FLAP_S = 5.0
_LEAST_STEP_S = 1e-6  # so that a flap that rounding puts at this very moment is waited for, too
_MOVING = ("off", "stuck", "slow", "flapping")  # what can befall links and the autopilot
_AS_OFF = ("flapping", "power-cut")
_MOST_STRANGERS = 64
_SERVER = (
    *(*_MOVING, "garbage", "wrong", "lying", "full"),
    *("crash", "power-cut", "hung", "poisoned", "unstartable"),
)
_INCIDENTS = (
    "pilot",
    "fail-safe",
    "diverted",
    "home",
    "jump",
    "restart",
    "impostor",
    "battery",
)  # of the autopilot alone
_SETTINGS = ("hovers", "rally")  # of the autopilot's returns
COMPUTER = "computer"  # the drone's
SCARCE = ("files", "threads", "memory", "disk")  # what it may lack
_NOBODY = ":1"
_UNDECODABLE = b"\xc1" * 16  # the one byte that MessagePack never uses
_ELSEWHERE = (
    "nobody.invalid:1", "dns:///nobody.invalid:1", "xds:///nobody", "unix:/run/nobody.sock", "unix-abstract:nobody",
    ":0", ":70000", "ipv4:10.0.0.1:1", "",
)  # fmt: skip
_LEASES_S = (0.003, math.nan, -1.0, math.inf, 1e300, 0.0)
_MANY = 300  # more than any field holds
_LONG = "x" * 10_000
_ESCAPES = "\x1b[2J\x1b]0;nobody\x07\x9b31m\u202e\u2066\r\nupwash: all is well"
_RESULTS: tuple[dict[str, Any], ...] = (
    {"value": {"neither": "this"}}, {"value": [[[]]]}, {"value": "text"}, {"value": math.nan}, {"fault": 7}, {},
)  # fmt: skip
_FAULTS = (
    "upwash.drone.flight:AutopilotOverruled", "upwash.errors:MissionStopped", "upwash.drone.mission:MissionFailed",
    "builtins:SystemExit", "builtins:KeyboardInterrupt", "builtins:MemoryError", "nobody:Known", _ESCAPES,
)  # fmt: skip
_LIES: Mapping[tuple[Lie, str], Sequence[dict[str, Any]]] = {  # by lie and path, except of availability
    ("elsewhere", START): [{"endpoint": address} for address in _ELSEWHERE],
    ("oversized", START): [{"endpoint": f":{_LONG}"}, {"reason": _LONG}],
    ("oversized", PREPARE): [{"held": False, "reason": _LONG}],
    ("oversized", HOLD): [{"held": False, "reason": _LONG}],
    ("control", START): [{"reason": _ESCAPES}, {"endpoint": _ESCAPES}],
    ("control", PREPARE): [{"held": False, "reason": _ESCAPES}],
    ("control", HOLD): [{"held": False, "reason": _ESCAPES}],
}


class Faults:
    """The faults of a run, by target and time."""

    def __init__(self, faults: Sequence[FaultConfig]) -> None:
        for index, fault in enumerate(faults):
            allowed = _kinds_at(fault.target)
            if fault.kind not in allowed:
                raise UsageError(
                    f"fault[{index}].kind: {fault.target} cannot be {fault.kind}: give one of {', '.join(allowed)}"
                )
        self.incidents = tuple(fault for fault in faults if fault.kind in _INCIDENTS)
        self.settings = tuple(fault for fault in faults if fault.kind in _SETTINGS)
        self._faults = [fault for fault in faults if fault.kind not in _INCIDENTS + _SETTINGS]

    def now(self, target: str) -> FaultConfig | None:
        """The present fault of the target, the first if there are several; off if it flaps or has no power."""
        if not self._faults:
            return None
        now_s = asyncio.get_running_loop().time()
        for fault in self._faults:
            if fault.target == target and fault.from_s <= now_s < fault.to_s and _is_on(fault, now_s):
                return msgspec.structs.replace(fault, kind="off") if fault.kind in _AS_OFF else fault
        return None

    async def change(self, target: str) -> None:
        """Return at the next change of a fault of the target; never without a fault."""
        loop = asyncio.get_running_loop()
        changes = [_next_change_s(fault, loop.time()) for fault in self._faults if fault.target == target]
        next_s = max(min(changes, default=math.inf), loop.time() + _LEAST_STEP_S)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(next_s if next_s < math.inf else None):
                await never()

    def power_cuts(self, target: str) -> int:
        """How many power cuts of the target have begun."""
        return sum(
            fault.target == target
            and fault.kind == "power-cut"
            and fault.from_s <= asyncio.get_running_loop().time()
            for fault in self._faults
        )

    async def befalls(self, target: str, kind: str) -> None:
        """Wait until the target has a fault of that kind."""
        while (fault := self.now(target)) is None or fault.kind != kind:
            await self.change(target)


def _kinds_at(target: str) -> tuple[str, ...]:
    if target == "autopilot":
        return _MOVING + _INCIDENTS + _SETTINGS
    if target == COMPUTER:
        return SCARCE
    return _MOVING if target.startswith("link:") else _SERVER


def _is_on(fault: FaultConfig, now_s: float) -> bool:
    return fault.kind != "flapping" or int((now_s - fault.from_s) / _FLAP_S) % 2 == 0


def _next_change_s(fault: FaultConfig, now_s: float) -> float:
    """The time at which the fault next begins, ends or flaps; infinite if it does not change."""
    if now_s < fault.from_s:
        return fault.from_s
    if fault.kind == "flapping" and now_s < fault.to_s:
        flaps = int((now_s - fault.from_s) / _FLAP_S) + 1
        return min(fault.from_s + flaps * _FLAP_S, fault.to_s)
    return fault.to_s if now_s < fault.to_s else math.inf


class FaultyServer:
    """One server with its faults, which affect the handlers that are plugged in through it."""

    def __init__(self, name: str, address: str, board: Switchboard, *, faults: Faults) -> None:
        self._name = name
        self._address = address
        self._lies = 0
        self._board = board
        self._faults = faults
        self._strangers: list[Client] = []  # that have taken all slots
        self._power_cuts = 0  # whose instances have ended
        self._crash: Callable[[str], None]

    def plug(self, address: str, handler: Handler) -> None:
        """Let the instance answer at that port of the server, subject to the faults."""

        async def answer(path: str, body: bytes, client: Client) -> bytes:
            return self._lie(await self._suffering(lambda: handler(path, body, client)), as_instance)

        self._board.plug(resolve(address, self._address), answer)

    def unplug(self, address: str) -> None:
        """From now on the address has no handler."""
        self._board.unplug(resolve(address, self._address))

    def plug_daemon(self, daemon: Handler, *, crash: Callable[[str], None]) -> None:
        """Let the daemon answer at the server's address, subject to the faults; `crash` ends its instances."""

        async def answer(path: str, body: bytes, client: Client) -> bytes:
            reply = await self._suffering(lambda: ask(path, body, client))
            return self._lie(reply, partial(as_daemon, path=path))

        async def ask(path: str, body: bytes, client: Client) -> bytes:
            match self._kind():
                case "wrong" if path == AVAILABILITY:
                    services = msgspec.msgpack.decode(body, type=AvailabilityRequest).services
                    reply = AvailabilityReply(
                        available=True, endpoints=dict.fromkeys(services, _NOBODY), lease_s=30.0
                    )
                    return msgspec.msgpack.encode(reply)
                case "wrong" if path == START:
                    return msgspec.msgpack.encode(StartReply(endpoint=_NOBODY))
                case "wrong" if path in (PREPARE, HOLD):
                    return msgspec.msgpack.encode(HoldReply(held=True))
                case "full" if path != LEAVE:
                    return await self._ask_among_strangers(daemon, path, body, client)
                case "crash" if path == AVAILABILITY:
                    crash("crashed")
            for stranger in self._strangers:
                await self._leaves(daemon, stranger)
            self._strangers.clear()
            return await daemon(path, body, client)

        self._crash = crash
        self._board.plug(self._address, answer)

    async def _suffering(self, ask: Callable[[], Awaitable[bytes]]) -> bytes:
        await self._endure()
        reply = await ask()
        if self._lose_power():
            raise Unreachable(f"{self._name} lost its power")
        fault = self._faults.now(self._name)
        if fault is not None and fault.kind == "slow":
            await asyncio.sleep(fault.extra_s)
        await self._endure()
        return _UNDECODABLE if self._kind() == "garbage" else reply

    def _lose_power(self) -> bool:
        """Whether a power cut began since the last look: then all instances end."""
        before, self._power_cuts = self._power_cuts, self._faults.power_cuts(self._name)
        if self._power_cuts > before:
            self._crash("lost its power")
        return self._power_cuts > before

    async def _endure(self) -> None:
        self._lose_power()
        match self._kind():
            case "off":
                raise Unreachable(f"{self._name} does not answer")
            case "stuck":
                await never()

    async def _ask_among_strangers(self, daemon: Handler, path: str, body: bytes, client: Client) -> bytes:
        """Strangers take all free slots first, so that the daemon itself refuses the drone."""
        if self._strangers:
            for stranger in self._strangers:
                await self._asks(daemon, stranger)
        else:
            for number in range(_MOST_STRANGERS):
                stranger = Client(f"stranger-{number}")
                if not await self._asks(daemon, stranger):
                    await self._leaves(daemon, stranger)
                    break
                self._strangers.append(stranger)
        return await daemon(path, body, client)

    async def _asks(self, daemon: Handler, stranger: Client) -> bool:
        request = AvailabilityRequest(self._name, [])
        reply = await daemon(AVAILABILITY, msgspec.msgpack.encode(request), stranger)
        return msgspec.msgpack.decode(reply, type=AvailabilityReply).available

    async def _leaves(self, daemon: Handler, stranger: Client) -> None:
        await daemon(LEAVE, msgspec.msgpack.encode(LeaveRequest(self._name)), stranger)

    def _lie(self, reply: bytes, lie: Callable[..., bytes]) -> bytes:
        """The reply, changed if the server lies now; each lie takes the next way, the first by the fault's time."""
        fault = self._faults.now(self._name)
        if fault is None or fault.kind != "lying":
            return reply
        self._lies += 1
        return lie(fault.lie, reply=reply, number=self._lies + int(1000 * fault.from_s))

    def _kind(self) -> str:
        fault = self._faults.now(self._name)
        return fault.kind if fault else ""


def as_daemon(lie: Lie, *, path: str, reply: bytes, number: int) -> bytes:
    """The daemon's honest reply, changed in the way of that number."""
    honest: dict[str, Any] = msgspec.msgpack.decode(reply)
    ways = _availability_lies(lie, honest) if path == AVAILABILITY else _LIES.get((lie, path), ())
    if not ways:
        return reply
    way = ways[number % len(ways)]
    return msgspec.msgpack.encode(honest | way if path == AVAILABILITY else way)


def as_instance(lie: Lie, *, reply: bytes, number: int) -> bytes:
    """The service's honest reply, changed in the way of that number; may raise Refused."""
    match lie:
        case "types":
            return msgspec.msgpack.encode(_RESULTS[number % len(_RESULTS)])
        case "faults":
            fault = {"type": _FAULTS[number % len(_FAULTS)], "message": _ESCAPES}
            return msgspec.msgpack.encode({"fault": fault})
        case "control":
            raise Refused(_ESCAPES)
    return reply


def _availability_lies(lie: Lie, honest: Mapping[str, Any]) -> Sequence[dict[str, Any]]:
    """The changed fields of an availability reply, for each way of the lie."""
    endpoints = honest.get("endpoints", {})
    strangers = [f"stranger-{number}" for number in range(_MANY)]
    match lie:
        case "elsewhere":
            return [{"endpoints": dict.fromkeys(endpoints, address)} for address in _ELSEWHERE]
        case "unwanted":
            unwanted = dict.fromkeys(strangers[:100], ":1")
            return [{"endpoints": endpoints | unwanted, "peers": [*honest.get("peers", []), *unwanted]}]
        case "oversized":
            return [
                {"endpoints": dict.fromkeys(strangers, ":1")},
                {"endpoints": dict.fromkeys(endpoints, f":{_LONG}")},
                {"available": False, "reason": _LONG},
                {"peers": strangers},
                {"peers": [_LONG]},
            ]
        case "lease":
            return [{"lease_s": lease_s} for lease_s in _LEASES_S]
        case "control":
            return [
                {"available": False, "reason": _ESCAPES},
                {"endpoints": dict.fromkeys(endpoints, f":1{_ESCAPES}")},
                {_ESCAPES: _ESCAPES, "peers": [_ESCAPES]},
            ]
    return []
