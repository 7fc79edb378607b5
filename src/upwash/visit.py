"""One visit to a server: join its network, ask, have the services started, call, leave."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from typing import NoReturn

import msgspec

from upwash.errors import LinkError, Refused, Unreachable, UpwashError
from upwash.ports import Dialer, Link, Network
from upwash.protocol import (
    AVAILABILITY,
    HEALTH_CHECK,
    LEAST_LEASE_S,
    LEAVE,
    PREPARE,
    START,
    AvailabilityReply,
    AvailabilityRequest,
    HoldReply,
    LeaveRequest,
    PrepareRequest,
    StartReply,
    StartRequest,
    decode_reply,
    resolve,
    service_path,
)

_ANSWER_S = 5.0  # a daemon answers at once or is in trouble
_FAREWELL_S = 0.5


@dataclass(frozen=True, slots=True)
class Contact:
    """How a server is reached, and which of the drone's services are wanted there."""

    name: str
    network: str
    address: str
    services: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a server that is available says: whether all wanted services run, and whom it can have prepared."""

    running: bool
    peers: tuple[str, ...]


class Visit:
    """The drone's business with one server, from selection to de-selection."""

    def __init__(self, contact: Contact, *, network: Network, dialer: Dialer) -> None:
        self._contact = contact
        self._network = network
        self._dialer = dialer
        self._daemon: Link | None = None
        self._instances: dict[str, Link] = {}
        self._lease_s = LEAST_LEASE_S
        self._joined = False
        self._lost = ""  # why, once the network is
        self._calls = 0
        self._quiet = asyncio.Event()
        self._quiet.set()

    async def join(self, *, timeout_s: float) -> bool:
        """Joins the server's network; whether it had to be joined. Raises NetworkError."""
        if self._lost:
            await self._network.leave()
            self._joined, self._lost = False, ""
        if self._joined:
            return False
        await self._network.join(self._contact.network, timeout_s=timeout_s)
        self._joined = True
        return True

    async def lost(self) -> str:
        """Returns why, once the network that was joined is lost; whatever is under way there has failed by then."""
        self._lost = await self._network.lost()
        await self._hang_up()
        return self._lost

    async def ask(self) -> Answer:
        """Asks for the services; raises LinkError where the server is not available."""
        self._daemon = self._dialer.dial(self._contact.address, server=self._contact.name)
        answer = await self._availability()
        for service in self._contact.services:
            if service in answer.endpoints:
                self._dial(service, answer.endpoints[service])
        running = all(service in self._instances for service in self._contact.services)
        return Answer(running, tuple(answer.peers))

    async def probe(self) -> bool:
        """Returns once the daemon, and each wanted service that runs, gives a sign of life; whether all of them run.

        Asks over connections of its own, as those of before may be dead without showing it. Raises LinkError.
        """
        daemon = self._dialer.dial(self._contact.address, server=self._contact.name)
        links = [daemon]
        try:
            answer = await self._availability(daemon)
            for service in self._contact.services:
                if service in answer.endpoints:
                    address = resolve(answer.endpoints[service], self._contact.address)
                    links.append(self._dialer.dial(address, server=self._contact.name))
                    with contextlib.suppress(Refused):  # which is an answer too
                        await links[-1].request(HEALTH_CHECK, b"", timeout_s=_ANSWER_S)
        finally:
            for link in links:
                await link.close()
        return all(service in answer.endpoints for service in self._contact.services)

    async def start(self, *, timeout_s: float) -> None:
        """Has the services that do not run yet started, and learns their endpoints."""
        for service in self._contact.services:
            if service in self._instances:
                continue
            request = StartRequest(self._contact.name, service)
            reply = decode_reply(
                await self._tell(START, request, timeout_s=timeout_s), StartReply, sender=self._contact.name
            )
            if not reply.endpoint:
                raise Refused(f"{self._contact.name} cannot start {service}: {reply.reason}")
            self._dial(service, reply.endpoint)

    async def prepare(self, peer: Contact, *, arrives_in_s: float, hold_s: float) -> None:
        """Has the peer of this server start its services and hold a slot; raises LinkError where it will not."""
        request = PrepareRequest(
            self._contact.name, peer.name, list(peer.services), arrives_in_s=arrives_in_s, hold_s=hold_s
        )
        reply = decode_reply(
            await self._tell(PREPARE, request, timeout_s=_ANSWER_S), HoldReply, sender=self._contact.name
        )
        if not reply.held:
            raise Refused(reply.reason)

    async def keep_lease(self) -> NoReturn:
        """Renews the lease, as the drone may be busy flying for longer than it lasts; until cancelled."""
        while True:
            await asyncio.sleep(self._lease_s / 3)
            with contextlib.suppress(
                UpwashError
            ):  # whether the server can still be used, the next call tells
                await self._availability()

    async def call(self, service: str, method: str, request: bytes, *, deadline_s: float) -> bytes:
        """Runs one call there; raises LinkError."""
        instance = self._instances.get(service)
        if instance is None:
            raise Refused(f"{self._contact.name} does not run {service}")
        self._calls += 1
        self._quiet.clear()
        try:
            return await instance.request(service_path(service, method), request, timeout_s=deadline_s)
        except LinkError as error:
            if self._lost:
                raise Unreachable(f"{self._contact.name}: its network was lost: {self._lost}") from error
            raise
        finally:
            self._calls -= 1
            if self._calls == 0:
                self._quiet.set()

    async def end(self, *, in_range: bool) -> bool:
        """Leaves: in range, after the calls under way and with a word to the daemon; else at once.

        Returns whether the daemon answered.
        """
        answered = False
        if in_range:
            await self._quiet.wait()  # each has its deadline
            if self._daemon is not None:
                with contextlib.suppress(LinkError):
                    await self._tell(LEAVE, LeaveRequest(self._contact.name), timeout_s=_FAREWELL_S)
                    answered = True
        await self._hang_up()
        await self._network.leave()
        return answered

    async def hang_up(self) -> None:
        """Drops the calls under way and every connection, and stays on the network."""
        await self._hang_up()
        self._instances, self._daemon = {}, None

    async def _hang_up(self) -> None:
        for link in (*self._instances.values(), self._daemon):
            if link is not None:
                await link.close()

    async def _availability(self, daemon: Link | None = None) -> AvailabilityReply:
        request = AvailabilityRequest(self._contact.name, list(self._contact.services))
        answer = decode_reply(
            await self._tell(AVAILABILITY, request, timeout_s=_ANSWER_S, daemon=daemon),
            AvailabilityReply,
            sender=self._contact.name,
        )
        if not answer.available:
            raise Refused(f"{self._contact.name} is unavailable: {answer.reason}")
        self._lease_s = answer.lease_s
        return answer

    async def _tell(
        self, path: str, message: msgspec.Struct, *, timeout_s: float, daemon: Link | None = None
    ) -> bytes:
        daemon = daemon or self._daemon
        assert daemon is not None  # noqa: S101 - dialled by ask()
        return await daemon.request(path, msgspec.msgpack.encode(message), timeout_s=timeout_s)

    def _dial(self, service: str, endpoint: str) -> None:
        address = resolve(endpoint, self._contact.address)
        self._instances[service] = self._dialer.dial(address, server=self._contact.name)
