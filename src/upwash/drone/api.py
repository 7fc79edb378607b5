"""The objects that a mission uses: the drone, its vehicle, camera, user and services."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, ParamSpec, TypeVar

from upwash.config.drone import DroneConfig, SecondLook
from upwash.config.places import ending
from upwash.core.geo import GeoPosition, LocalFrame, Position, Waypoint
from upwash.core.operation import Operation
from upwash.drone.answered_photos import AnsweredPhotos
from upwash.drone.calls import MissionCalls
from upwash.drone.mission import MissionThread
from upwash.drone.object_acts import ObjectAnswer
from upwash.drone.objects import FoundObject
from upwash.drone.payload import Payload
from upwash.drone.pending import Pending
from upwash.drone.photographer import Photographer
from upwash.drone.places import position_of
from upwash.drone.settling import Settling
from upwash.drone.vehicle import Vehicle
from upwash.errors import UsageError
from upwash.ports import Notifier
from upwash.rpc.service import Method, Patience, make_stub, spec_of

P = ParamSpec("P")
T = TypeVar("T")
Mission = Callable[["Drone"], None]
_NOTHING: Final = object()  # is told


class User:
    """Sends messages of a mission to the drone's user."""

    def __init__(self, notifier: Notifier, thread: MissionThread, photos: AnsweredPhotos) -> None:
        self._notifier = notifier
        self._thread = thread
        self._photos = photos

    def notify(self, message: object, at: Waypoint | Position) -> None:
        """Sends the user a message about a waypoint or position.

        Objects of an answer, alone, in lists or in other values, lie on the photo that the call was made with.
        """
        photo = self._photos.number_of(message)
        self._thread.call(self._notifier.notify(message, position_of(at), photo), is_message=True)


class Drone:
    """The drone of a mission program; only the mission's own thread may call its methods.

    `plan` has the waypoints to visit, in flight order. Configured are `altitude_m`, above home, `action_s`, the
    duration of an action at a waypoint, `on_rows`, whether photos are taken without stopping, and `second_look`, how
    objects are looked at again, None without it. `home` is where east and north are 0; None if no file says.
    """

    plan: tuple[Waypoint, ...]
    altitude_m: float
    action_s: float
    on_rows: bool
    second_look: SecondLook | None
    autopilot: Vehicle
    camera: Photographer
    payload: Payload
    user: User
    home: GeoPosition | None

    def __init__(
        self,
        config: DroneConfig,
        *,
        plan: tuple[Waypoint, ...],
        autopilot: Vehicle,
        camera: Photographer,
        payload: Payload,
        user: User,
        calls: MissionCalls,
        settling: Settling,
    ) -> None:
        mission = config.mission
        self.plan = plan
        self.altitude_m = mission.altitude_m
        self.action_s = mission.action_s
        self.on_rows = mission.photos is not None
        self.second_look = mission.second_look
        self.home = mission.home.place if mission.home else None
        self.autopilot = autopilot
        self.camera = camera
        self.payload = payload
        self.user = user
        self._lands = ending(mission) == "land"
        self._services = frozenset(service.name for service in config.services)
        self._calls = calls
        self._settling = settling

    def end_flight(self) -> None:
        """Ends the flight as the plan says: lands where the vehicle is, or returns home and lands.

        With `mission.photos` and a plan it first flies to the plan's waypoints after the last photo.
        """
        self._settling.leave()
        if self._lands:
            self.autopilot.land()
        else:
            self.autopilot.return_home_and_land()

    def to_degrees(self, place: Waypoint | Position) -> GeoPosition:
        """The place in degrees (WGS 84), and its altitude above home; raises UsageError without a home."""
        if self.home is None:
            raise UsageError("mission.home is missing: no place of this mission is known in degrees")
        return LocalFrame(self.home).geo(position_of(place))

    def service(self, cls: type[T], *, unanswered: object = _NOTHING, within_s: float | None = None) -> T:
        """An object of the service's class; upwash decides for each call of a method where it runs.

        A service with `where="servers"` needs `unanswered`: what a call returns that no server answers within
        `within_s`, or else before the drone has landed. With `unanswered=Unanswered` the call raises that. Raises
        UsageError for a service that the configuration does not name.
        """
        spec = spec_of(cls)
        name = spec.name
        if name not in self._services:
            raise UsageError(
                f"the mission calls the service {name!r}, which the configuration does not name: add a [[service]] "
                f'table with name = "{name}"; it names {", ".join(sorted(self._services)) or "none"}'
            )
        if spec.on_drone:
            if unanswered is not _NOTHING or within_s is not None:
                raise UsageError(
                    f"drone.service({cls.__name__}, ...): the drone can answer each call of {name}: leave unanswered "
                    'and within_s out, or declare the service with @service(where="servers")'
                )
            return make_stub(cls, self._call)
        if unanswered is _NOTHING:
            raise UsageError(
                f"drone.service({cls.__name__}): only servers run {name}, and perhaps none is in reach: say what a "
                f"call without an answer returns, as in drone.service({cls.__name__}, unanswered=None), or write "
                "unanswered=upwash.Unanswered to have that raised"
            )
        if within_s is not None and not 0 < within_s < math.inf:
            raise UsageError(
                f"drone.service({cls.__name__}): within_s is {within_s!r}: give seconds above 0, or leave it out to "
                "wait until the drone has landed"
            )
        return make_stub(cls, self._call, Patience(unanswered, within_s))

    def start(self, call: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Pending[T]:
        """Starts a call of a service's method, `drone.start(detector.process_photo, photo)`, and does not wait.

        Raises UsageError while another call is pending. If `stay_or_go` left an answer open, first waits for it and
        acts. With rows (`mission.photos`) neither holds: several calls are open at once.
        """
        self._settling.settle_for_call()
        return self._calls.start(call, *args, **kwargs)

    def stay_or_go(
        self,
        pending: Pending[T],
        act: Callable[[T], object],
        *,
        demands: Callable[[T], object] = bool,
        failed: Callable[[Exception], object] | None = None,
    ) -> None:
        """Calls `act(answer)` at this waypoint if `demands(answer)` is true.

        The key `stay_or_go` of the configuration decides whether the drone waits here for the answer, or the mission
        goes on at once, to the next waypoint at most. If the answer then has a demand, the drone comes back, acts,
        and flies to its former target. The next call, and the way down, wait for the answer. `demands` is called
        once, at any place. If the call raises an exception, `failed` gets it at this waypoint; without `failed`, the
        method that waits raises it there. On a row of `mission.photos` the mission goes on over many waypoints.
        """
        self._settling.take_up(self._settling.action(pending.call, demands, act, failed))

    def when_answered(
        self,
        pending: Pending[T],
        tell: Callable[[T], object],
        *,
        failed: Callable[[Exception], object] | None = None,
    ) -> None:
        """Calls `tell(answer)` as soon as the answer is there, wherever the drone is then; it flies on meanwhile.

        `goto` and verbs that wait for answers call it, in the order of the answers. The way down begins after the
        last answer. Of two answers the last counts. If the call raises an exception, `failed` gets the exception;
        without `failed` that verb raises it. `tell` and `failed` may only notify: other verbs raise UsageError.
        """
        self._settling.leave_open(self._settling.action(pending.call, None, tell, failed))

    def act_once(
        self,
        pending: Pending[T],
        act: Callable[[FoundObject], object],
        *,
        wanted: Callable[[FoundObject], object] | None = None,
        tell: Callable[[T], object] | None = None,
        failed: Callable[[Exception], object] | None = None,
    ) -> None:
        """Calls `act(found)` once for each object that answers of this flight show, over the object's place.

        Findings of all answers within their stated error of each other are one object. The drone flies to the object
        where the way gets least longer, at once or later, within `policy.act_within_s`. `wanted(found)` says which
        objects are acted on, all by default. It is called again before the act. `tell` and `failed` are called as by
        `when_answered`. Findings of an answer that have no place have one act together, where their photo was taken.
        An object whose way a fence forbids is left out.
        """
        answer = ObjectAnswer(self._settling, pending.call, act, wanted=wanted, tell=tell, failed=failed)
        self._settling.take_up(answer)

    def _call(
        self, operation: Operation, method: Method, request: bytes, arguments: tuple[object, ...]
    ) -> Any:
        self._settling.settle_for_call()
        return self._calls.call(operation, method, request, arguments)
