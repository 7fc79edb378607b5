"""Puts a drone's services on ROS 2: photos of a topic become calls, and answers go to topics."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from upwash.config.drone import DroneConfig
from upwash.core.geo import LocalFrame
from upwash.core.knowledge.servers import State
from upwash.drone.offloading import CallPorts
from upwash.drone.stream import Stream, StreamAnswer, photo_method
from upwash.errors import UpwashError, UsageError
from upwash.eventlog import schema
from upwash.launch.drone import (
    drone_credentials,
    home_of,
    opened_networks,
    require_address,
    require_certificates,
    server_dialer,
    server_finder,
)
from upwash.missions.bundled import load_services
from upwash.real.host.clock import keep_right_from_services
from upwash.real.host.journal import FileJournal
from upwash.real.host.signals import stopping_politely
from upwash.real.instances.runtime import OwnProcesses
from upwash.ros.position import NowhereKnown, TopicPosition
from upwash.ros.session import ros_imports, spinning
from upwash.ros.topics import ImageTopic, jpeg_soon
from upwash.rpc.service import spec_of
from upwash.support.background import beside, first, in_thread, kept_up

if TYPE_CHECKING:
    from upwash.ros.node import Diagnostic, UpwashNode

TOPIC = "image/compressed"
_MIRRORED = ("name", "mission", "policy", "network", "camera", "ros", "service", "server")
_DIAGNOSED_S = 1.0


async def serve_ros(
    config: DroneConfig, *, log: Path, args: Sequence[str] = (), managed: bool = False
) -> None:
    """Runs the node until SIGINT or SIGTERM; `args` are ROS arguments, the log gets every event.

    With `managed` a lifecycle manager configures and activates the node. Raises UsageError for what prevents it, and
    InstanceError where a service cannot run on the drone at all.
    """
    for server in config.servers:
        require_address(server)
        require_certificates(server, config)
    program = _RosProgram(config)
    async with contextlib.AsyncExitStack() as stack:
        await program.run(stack, log=log, args=args, managed=managed)


class _RosProgram:
    def __init__(self, config: DroneConfig) -> None:
        self._config = config
        services = load_services(config.services)
        self._specs = {name: spec_of(service.cls) for name, service in services.items()}
        self._programs = {name: service.program for name, service in services.items()}
        self._parts = {name: service.part for name, service in services.items() if service.part}
        self._names = [name for name, spec in self._specs.items() if photo_method(spec)]
        if not self._names:
            raise UsageError(
                "no [[service]] has a method that takes a photo, `def find(self, photo: bytes)`, and nothing besides"
            )
        self._wanted, self._unwanted, self._over = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self._settled = asyncio.Condition()
        self._stream: Stream[Any] | None = None  # while active
        self._images: ImageTopic | None = None
        self._why = ""  # the last activation failed
        self._failure: UpwashError | None = None
        self._computed = dict.fromkeys(self._names, 0)
        self._failed = dict.fromkeys(self._names, 0)
        self._last: dict[str, StreamAnswer] = {}
        self._steps: dict[str, str] = {}  # the last reason of each server's state

    async def run(
        self, stack: contextlib.AsyncExitStack, *, log: Path, args: Sequence[str], managed: bool
    ) -> None:
        config = self._config
        with ros_imports():
            from upwash.ros.node import UpwashNode, mirrored
        tables = msgspec.to_builtins(config, enc_hook=str)
        make = functools.partial(
            UpwashNode,
            drone=config.name,
            services=self._names,
            servers=[server.name for server in config.servers],
            parameters=mirrored({key: tables[key] for key in _MIRRORED}),
            transition=self._change,
            asked=self._ask,
        )
        self._node: UpwashNode = stack.enter_context(spinning(make, args=args))
        journal = FileJournal(log, watchers=(self._node.follow, self._follow))
        stack.enter_context(contextlib.closing(journal))
        keep_right_from_services()
        ports = await self._ports(journal, stack)
        stack.enter_context(stopping_politely(self._stop))
        await stack.enter_async_context(
            beside(kept_up(self._diagnose, name="diagnostics", pause_s=_DIAGNOSED_S), name="the diagnostics")
        )
        if not managed:
            await stack.enter_async_context(beside(self._start(), name="the start of the node"))
        await self._live(ports)

    async def _ports(self, journal: FileJournal, stack: contextlib.AsyncExitStack) -> CallPorts:
        config = self._config
        topic = config.ros.position
        self._whereabouts = (
            NowhereKnown() if topic is None else TopicPosition(self._node, topic, LocalFrame(home_of(config)))
        )
        credentials = drone_credentials(config)
        own = OwnProcesses(config.name, max_message_bytes=config.max_message_bytes)
        return CallPorts(
            autopilot=self._whereabouts,
            networks=await opened_networks(config, self._whereabouts, journal, stack),
            dialer=server_dialer(config, credentials),
            onboard_dialer=own,
            onboard_runtime=own,
            journal=journal,
            finder=server_finder(config),
        )

    async def _start(self) -> None:
        """Configures and activates the node, from a thread of its own, as another node would."""
        await in_thread(self._node.trigger_configure, name="the node's configuration")
        await in_thread(self._node.trigger_activate, name="the node's activation")
        if self._why:
            self._over.set()

    def _stop(self, _why: str) -> None:
        self._over.set()

    async def _live(self, ports: CallPorts) -> None:
        """Is active whenever that is wanted, until it is over."""
        while not self._over.is_set():
            await first(self._wanted.wait(), self._over.wait())
            if self._over.is_set():
                break
            try:
                await self._be_active(ports)
            except UpwashError as error:
                self._why, self._failure = str(error), error
                self._want(False)
            await self._settle(None)
        if self._why and self._failure is not None:
            raise self._failure

    async def _be_active(self, ports: CallPorts) -> None:
        stream = Stream[Any](
            self._config,
            specs=self._specs,
            programs=self._programs,
            parts=self._parts,
            ports=ports,
            jpeg=self._jpeg,
            answered=self._answered,
            at_most=self._config.ros.at_most,
        )
        loop = asyncio.get_running_loop()

        def came(message: Any) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(stream.offer, message)

        async with stream.running():
            topic = self._config.camera.topic or TOPIC
            self._images = ImageTopic(self._node, topic, came, now_s=time.monotonic)
            try:
                self._why = ""
                await self._settle(stream)
                await first(self._unwanted.wait(), self._over.wait())
            finally:
                self._images.close()
                self._images = None
                self._stream = None

    async def _settle(self, stream: Stream[Any] | None) -> None:
        async with self._settled:
            self._stream = stream
            self._settled.notify_all()

    def _want(self, active: bool) -> None:
        on, off = (self._wanted, self._unwanted) if active else (self._unwanted, self._wanted)
        on.set()
        off.clear()

    async def _change(self, active: bool) -> str:
        """A transition of the lifecycle: why it failed, or ""."""
        if self._over.is_set():
            return "" if not active else "the node is ending"
        self._why = ""
        self._want(active)
        async with self._settled:
            await self._settled.wait_for(lambda: (self._stream is not None) is active or bool(self._why))
        return self._why

    async def _ask(self, service: str) -> tuple[Any | None, StreamAnswer]:
        if self._stream is None:
            return None, StreamAnswer(service, "", why="the node is not active")
        return await self._stream.ask(service)

    async def _jpeg(self, message: Any) -> bytes:
        return await jpeg_soon(self._images.name if self._images else "", message)

    def _answered(self, message: Any, answer: StreamAnswer) -> None:
        self._computed[answer.service] += not answer.why
        self._failed[answer.service] += bool(answer.why)
        self._last[answer.service] = answer
        self._node.answer(message, answer)

    def _follow(self, event: schema.Event) -> None:
        if self._stream is not None:
            self._stream.follow(event)
        if isinstance(event, schema.ServerStep):
            self._steps[event.server] = event.why

    # --- diagnostics ---

    async def _diagnose(self) -> None:
        self._node.diagnose(self._findings())

    def _findings(self) -> Iterator[Diagnostic]:
        from upwash.ros.node import Diagnostic

        images, stream = self._images, self._stream
        if images is not None:
            yield Diagnostic(
                "photos",
                tuple(images.troubles()),
                {"topic": images.name, "type": images.type, "received": images.received},
            )
        if troubles := tuple(self._whereabouts.troubles()):
            yield Diagnostic("position", troubles)
        if stream is None:
            yield Diagnostic(
                "node", (self._why,) if self._why else (), {"active": False}, is_error=bool(self._why)
            )
            return
        for name in self._names:
            last = self._last.get(name)
            call = last.call if last is not None else None
            yield Diagnostic(
                name,
                (last.why,) if last is not None and last.why else (),
                {
                    "computed": self._computed[name],
                    "failed": self._failed[name],
                    "dropped": stream.dropped(name),
                    "place": call and call.place,
                    "delay_s": call and round(call.delay_s, 3),
                },
                is_error=True,
            )
        server, round_trip_s = stream.link
        for name, state in self._node.states.items():
            why = self._steps.get(name, "")
            values = {"state": state, "round_trip_s": round_trip_s if name == server else None, "why": why}
            yield Diagnostic(name, (why or "it failed",) if state is State.BLACKLISTED else (), values)
