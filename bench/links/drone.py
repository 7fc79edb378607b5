"""The drone's end: `python -m bench.links.drone ORDER KEYS`, which prints a `Seen` as JSON."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import msgspec
from bench.echo import Echo
from bench.links.wan import ADDRESS

from upwash.drone.networks import NoNetwork
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import LinkError
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import read_credentials
from upwash.rpc.service import spec_of
from upwash.support.background import beside

START_S = 60.0


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """Calls with a photo and a deadline, after at most the given number of checks."""

    calls: int
    photo_bytes: int
    deadline_s: float
    checks: int


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """What came of it: how long the server took to be ready, calls that it answered, and the last failure."""

    ready_s: float | None
    delays_s: list[float]
    failure: str = ""


async def visit(session: ServerSession, order: Order) -> Seen:
    """Has the server made ready, and calls it as a flight does; a call that fails is not made again."""
    now_s = asyncio.get_running_loop().time
    began_s, failure = now_s(), ""
    for _ in range(order.checks):
        try:
            await session.ask()
            if not session.running:
                await session.start(timeout_s=START_S)
            break
        except LinkError as error:
            failure = str(error)
            await session.hang_up()
    else:
        return Seen(ready_s=None, delays_s=[], failure=failure)
    ready_s, delays_s = now_s() - began_s, []
    _, request = spec_of(Echo).methods["measure"].encode((bytes(order.photo_bytes),), {})
    async with beside(session.keep_lease(), name="the lease"):
        for _ in range(order.calls):
            called_s = now_s()
            try:
                await session.call("echo", "measure", request, deadline_s=order.deadline_s)
            except LinkError as error:
                failure = str(error)
            else:
                delays_s.append(now_s() - called_s)
    await session.end(in_range=True)
    return Seen(ready_s=ready_s, delays_s=delays_s, failure=failure)


def session_with(keys: str, service: str) -> ServerSession:
    """A session with the daemon at the other end, which runs the service."""
    folder = Path(keys)
    shown = read_credentials(folder / "authority.pem", folder / "drone.pem", folder / "drone.key")
    return ServerSession(
        ServerEndpoint("s1", "", ADDRESS, (service,)),
        network=NoNetwork(),
        dialer=GrpcDialer("drone", shown, max_message_bytes=2**25),
    )


def main(order: str, keys: str) -> None:
    """Prints what the drone saw."""
    seen = visit(session_with(keys, "echo"), msgspec.json.decode(order, type=Order))
    print(msgspec.json.encode(asyncio.run(seen)).decode())


if __name__ == "__main__":
    main(*sys.argv[1:])
