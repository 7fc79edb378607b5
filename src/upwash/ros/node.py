"""The node of `upwash ros`: its topics, services, parameters, diagnostics and lifecycle."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from std_msgs.msg import String

from upwash.core.knowledge.servers import SELECTED, State
from upwash.drone.stream import StreamAnswer
from upwash.eventlog import schema
from upwash.ros.session import guarded, sentence_of
from upwash.ros.topics import EventTopic
from upwash.services.detection import Detection
from upwash.support.background import begin
from upwash.support.text import printable

_KEPT = 10
_LONGEST_PARAMETER = 1000  # characters
_SUMMARY = 200

Parameter = str | int | float | bool | list[str] | list[float]
Transition = Callable[[bool], Coroutine[Any, Any, str]]  # to active or not; returns why it failed, or ""
Asked = Callable[[str], Coroutine[Any, Any, tuple[Any | None, StreamAnswer]]]


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One status of the diagnostics: its name, what is wrong, and values. `is_error` where nothing works."""

    name: str
    troubles: Sequence[str] = ()
    values: Mapping[str, object] = field(default_factory=dict)
    is_error: bool = False


def mirrored(table: object, name: str = "") -> dict[str, Parameter]:
    """The plain values of a configuration as parameters, by names with dots; what has no value is left out."""
    if isinstance(table, dict):
        named = [(str(key), value) for key, value in table.items()]
    elif isinstance(table, list | tuple) and table and all(isinstance(item, dict) for item in table):
        named = [(str(item.get("name", number)), item) for number, item in enumerate(table)]
    elif isinstance(table, list | tuple):
        if all(isinstance(item, int | float) for item in table):
            return {name: [float(item) for item in table]} if table else {}
        return {name: [printable(str(item), _LONGEST_PARAMETER) for item in table]}
    else:
        plain = table if isinstance(table, bool | int | float | str | None) else str(table)
        return {} if plain is None else {name: plain}
    found: dict[str, Parameter] = {}
    for key, value in named:
        found |= mirrored(value, ".".join(filter(None, (name, key))))
    return found


class UpwashNode(LifecycleNode):
    """The lifecycle node; its methods are for the event loop's thread, and its callbacks come in that of ROS.

    `~/SERVICE/result`, `~/events` and `~/servers` are JSON in std_msgs/String, the last one latched.
    `~/SERVICE/detections` is vision_msgs/Detection2DArray where that is installed. `~/SERVICE` is a std_srvs/Trigger
    that computes the newest photo.
    """

    def __init__(
        self,
        *,
        drone: str,
        services: Iterable[str],
        servers: Iterable[str],
        parameters: Mapping[str, Parameter],
        transition: Transition,
        asked: Asked,
        context: Any,
    ) -> None:
        super().__init__("upwash", context=context)
        self._drone, self._transition, self._asked = drone, transition, asked
        self._loop = asyncio.get_running_loop()
        self._said: dict[str, str] = {}
        self._unfit: dict[str, int] = {}  # subscribers of each topic with another quality of service
        self.states = dict.fromkeys(servers, State.AVL)
        self._declare(parameters)
        self._events = EventTopic(self)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._servers = self._publisher(String, "~/servers", latched)
        self._results = {name: self._publisher(String, f"~/{name}/result") for name in services}
        self._diagnostics, self._diagnostic_types = self._optional("diagnostic_msgs.msg", "DiagnosticArray")
        if self._diagnostics:
            self._diagnostics = self._publisher(self._diagnostics, "/diagnostics")
        detections, self._vision = self._optional("vision_msgs.msg", "Detection2DArray")
        self._detections = (
            {name: self._publisher(detections, f"~/{name}/detections") for name in self._results}
            if detections
            else {}
        )
        trigger, _ = self._optional("std_srvs.srv", "Trigger")
        for name in self._results if trigger else ():
            self.create_service(trigger, f"~/{name}", self._answering(name))
        self._publish_servers()

    # --- lifecycle, in the thread of ROS ---

    def on_activate(self, state: Any) -> Any:
        """Starts the services; FAILURE if one cannot run."""
        return self._go(True)

    def on_deactivate(self, state: Any) -> Any:
        """Ends the services, and leaves the servers."""
        return self._go(False)

    def on_shutdown(self, state: Any) -> Any:
        """As `on_deactivate`."""
        return self._go(False)

    def _go(self, active: bool) -> Any:
        try:
            why = asyncio.run_coroutine_threadsafe(self._transition(active), self._loop).result()
        except Exception as error:  # noqa: BLE001 - no exception may reach the spin
            why = sentence_of(error)
        if why:
            self.tell(why)
        return TransitionCallbackReturn.FAILURE if why else TransitionCallbackReturn.SUCCESS

    # --- what is published ---

    def tell(self, why: str) -> None:
        """Logs a trouble, unless it is the last logged trouble."""
        if self._said.get("") != why:
            self._said[""] = why
            self.get_logger().warning(why)

    def follow(self, event: schema.Event) -> None:
        """Publishes an event of the log; and the servers' states after those that change one."""
        self._events.follow(event)
        if isinstance(event, schema.ServerStep):
            self.states[event.server] = event.after
            self._publish_servers()

    def answer(self, message: Any, answer: StreamAnswer) -> None:
        """Publishes what became of the photo of that message, with its stamp and frame."""
        self._publish(self._results[answer.service], String(data=_json_of(message, answer)))
        if (publisher := self._detections.get(answer.service)) and not answer.why:
            self._publish(publisher, self._as_detections(message, answer.value))

    def diagnose(self, findings: Iterable[Diagnostic]) -> None:
        """Publishes diagnostics, and logs troubles that are new."""
        unfit = [
            f"{count} subscriber(s) of {topic} asked for a quality of service that it does not offer"
            for topic, count in self._unfit.items()
        ]
        statuses = [*findings, *([Diagnostic("subscribers", unfit)] if unfit else [])]
        for finding in statuses:
            words = "; ".join(finding.troubles)
            kind = "".join(letter for letter in words if not letter.isdigit())  # without counts of seconds
            if kind != self._said.get(finding.name, ""):
                self._said[finding.name] = kind
                if words:
                    self.get_logger().warning(f"{finding.name}: {words}")
                else:  # rclpy lets no line of a program log with two severities
                    self.get_logger().info(f"{finding.name}: as it should be")
        if not self._diagnostics:
            return
        types = self._diagnostic_types
        array = types.DiagnosticArray(status=[self._status(types, finding) for finding in statuses])
        array.header.stamp = self.get_clock().now().to_msg()
        self._publish(self._diagnostics, array)

    def _status(self, types: Any, finding: Diagnostic) -> Any:
        level = types.DiagnosticStatus.OK
        if finding.troubles:
            level = types.DiagnosticStatus.ERROR if finding.is_error else types.DiagnosticStatus.WARN
        return types.DiagnosticStatus(
            level=level,
            name=f"upwash: {finding.name}",
            message=printable("; ".join(finding.troubles) or "OK", 4 * _SUMMARY),
            hardware_id=self._drone,
            values=[
                types.KeyValue(key=key, value=printable(str(value), _SUMMARY))
                for key, value in finding.values.items()
                if value is not None
            ],
        )

    def _publish_servers(self) -> None:
        selected = [server for server, state in self.states.items() if state in SELECTED]
        self._publish(
            self._servers,
            String(data=msgspec.json.encode({"selected": selected, "states": self.states}).decode()),
        )

    def _publish(self, publisher: Any, message: Any) -> None:
        try:
            publisher.publish(message)
        except Exception as error:  # noqa: BLE001 - such as a context that was shut down from outside
            with contextlib.suppress(Exception):
                self.tell(sentence_of(error))

    def _as_detections(self, message: Any, found: object) -> Any:
        types = self._vision
        array = types.Detection2DArray(header=message.header)
        for number, detection in enumerate(found if isinstance(found, list) else ()):
            if not isinstance(detection, Detection):
                continue
            shown = types.Detection2D(header=message.header, id=str(number))
            shown.bbox.center.position.x = detection.left_px + detection.width_px / 2
            shown.bbox.center.position.y = detection.top_px + detection.height_px / 2
            shown.bbox.size_x, shown.bbox.size_y = detection.width_px, detection.height_px
            hypothesis = types.ObjectHypothesisWithPose()
            hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = detection.label, detection.score
            shown.results.append(hypothesis)
            array.detections.append(shown)
        return array

    # --- how it is made ---

    def _declare(self, parameters: Mapping[str, Parameter]) -> None:
        from rcl_interfaces.msg import ParameterDescriptor

        for name, value in parameters.items():
            self.declare_parameter(
                name,
                value,
                ParameterDescriptor(read_only=True, description="as configured"),
                ignore_override=True,
            )

    def _publisher(self, kind: Any, topic: str, qos: QoSProfile | None = None) -> Any:
        def hear(event: Any) -> None:
            self._unfit[topic] = event.total_count

        events = PublisherEventCallbacks(
            incompatible_qos=guarded(hear, self.tell),
            incompatible_type=lambda _: None,
            use_default_callbacks=False,
        )
        return self.create_publisher(kind, topic, qos or QoSProfile(depth=_KEPT), event_callbacks=events)

    def _optional(self, module: str, name: str) -> tuple[Any, Any]:
        """The type of that name and its module; None for both, and a line in the log, without the package."""
        try:
            types = __import__(module, fromlist=[name])
        except ImportError:
            self.get_logger().info(
                f"{module.partition('.')[0]} is not installed: nothing of its types is offered"
            )
            return None, None
        return getattr(types, name), types

    def _answering(self, service: str) -> Callable[..., Any]:
        async def answer(_request: Any, response: Any) -> Any:
            """In the thread of ROS, which spins on while the event loop computes."""
            done: Any = Future(executor=self.executor)

            def begun() -> None:
                task = begin(self._asked(service), name=f"{service} asked by ROS")
                task.add_done_callback(ended)

            def ended(task: asyncio.Task[Any]) -> None:
                if task.cancelled() or task.exception():
                    done.set_result(
                        (False, "the node is ending" if task.cancelled() else str(task.exception()))
                    )
                else:
                    message, given = task.result()
                    done.set_result((not given.why, given.why or _json_of(message, given)))
                if self.executor is not None:
                    self.executor.wake()

            try:
                self._loop.call_soon_threadsafe(begun)
            except RuntimeError:
                response.message = "the node is ending"
                return response
            response.success, response.message = await done
            return response

        return answer


def _json_of(message: Any, answer: StreamAnswer) -> str:
    header, call = message.header, answer.call
    said: dict[str, object] = {
        "stamp": {"sec": header.stamp.sec, "nanosec": header.stamp.nanosec},
        "frame_id": header.frame_id,
        "service": answer.service,
        "method": answer.method,
        "place": None if call is None else call.place,
        "delay_s": None if call is None else round(call.delay_s, 6),
    }
    said |= {"error": answer.why} if answer.why else {"result": answer.value}
    return msgspec.json.encode(
        said, enc_hook=lambda value: value.tolist() if hasattr(value, "tolist") else str(value)
    ).decode()
