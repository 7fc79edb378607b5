"""The errors of upwash.

UpwashError
├── UsageError                input of the user (command, configuration, declaration) that cannot work
│   ├── ConfigError             a configuration file: names the file, the key and the remedy
│   ├── CredentialsError        certificates or keys: missing, unreadable, of another authority
│   ├── DeclarationError        a service class that cannot be offered
│   └── ModelError              a detector's network: names the file and the place in it
├── AutopilotError            the vehicle: names the step and the vehicle's last text
│   ├── AutopilotRefused        the vehicle refused the command
│   │   └── AutopilotOverruled      the pilot or a fail-safe has the vehicle
│   ├── AutopilotTimeout        the vehicle did not complete the step in time
│   ├── AutopilotLost           its link went silent
│   └── AutopilotNotHeard       no message ever came: the flight did not begin
├── CameraError               the camera gave no photo: names the camera and its fault
├── NetworkError              a server's network could not be joined
├── LinkError                 a request got no usable answer
│   ├── Unreachable             no program at the address, or the connection broke
│   ├── DeadlineExceeded        no answer in time
│   ├── Refused                 the other side refused, with its reason
│   └── GarbledReply            an answer that cannot be decoded
├── InstanceError             a service instance did not start, or crashed
│   └── EngineError             the container engine refused, failed, or does not answer
├── Unanswered                no server answered a call that only servers compute
├── ServiceError              the service's own exception, of a class that is unknown here
├── NotWritten                a file could not be written: names what was kept
├── NotKept                   the work was done, but not all of its output could be written
├── MissionStopped            the mission is being ended from outside
│   └── ReserveReached          the battery is down to the reserve
├── MissionFailed             the mission program raised an exception that is none of these
└── TransitionError           a programming error: an event that a server's state does not allow
"""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "AutopilotError",
    "AutopilotLost",
    "AutopilotNotHeard",
    "AutopilotOverruled",
    "AutopilotRefused",
    "AutopilotTimeout",
    "CameraError",
    "ConfigError",
    "CredentialsError",
    "DeadlineExceeded",
    "DeclarationError",
    "EngineError",
    "GarbledReply",
    "InstanceError",
    "LinkError",
    "MissionFailed",
    "MissionStopped",
    "ModelError",
    "NetworkError",
    "NotKept",
    "NotWritten",
    "Refused",
    "ReserveReached",
    "ServiceError",
    "TransitionError",
    "Unanswered",
    "Unreachable",
    "UpwashError",
    "UsageError",
]


class UpwashError(Exception):
    """The base of all errors of upwash."""


_LONGEST = (
    2000  # characters of a message that quotes a file: what is wrong stands first, what to do about it last
)
_LAST = 600


class UsageError(UpwashError):
    """The user's command, configuration or declaration cannot work; nothing was started."""

    def __init__(self, message: str) -> None:
        if len(message) > _LONGEST:
            message = f"{message[: _LONGEST - _LAST - 1]}…{message[-_LAST:]}"
        super().__init__(message)


class ConfigError(UsageError):
    """A configuration file that cannot be used."""

    def __init__(self, file: str, key: str, problem: str) -> None:
        self.file = file
        self.key = key
        self.problem = problem
        super().__init__(f"{file}: {key}: {problem}" if key else f"{file}: {problem}")


class CredentialsError(UsageError):
    """A certificate or key that is missing, unreadable or of another authority."""


class DeclarationError(UsageError):
    """A class that cannot be offered as a service."""


class ModelError(UsageError):
    """A file of a detector's network that cannot be used; `where` names the line, layer or offset."""

    def __init__(self, file: Path, where: str, problem: str) -> None:
        self.file = file
        self.where = where
        self.problem = problem
        super().__init__(": ".join(filter(None, (str(file), where, problem))))


class AutopilotError(UpwashError):
    """The vehicle did not carry out a command; `step` names it."""

    def __init__(self, step: str, problem: str, vehicle_said: str = "") -> None:
        self.step = step
        self.problem = problem
        self.vehicle_said = vehicle_said
        said = f'; the vehicle last said: "{vehicle_said}"' if vehicle_said else ""
        super().__init__(f"{step}: {problem}{said}")


class AutopilotRefused(AutopilotError):
    """The vehicle refused the command, or the program did not send it."""


class AutopilotOverruled(AutopilotRefused):
    """A pilot, a ground station or a fail-safe has the vehicle; no command was sent."""


class AutopilotTimeout(AutopilotError):
    """The vehicle did not complete the step in time."""


class AutopilotLost(AutopilotError):
    """The link to the vehicle went silent."""


class AutopilotNotHeard(AutopilotError):
    """No message of the vehicle ever came, and no command was sent; the vehicle may be switched on later."""


class CameraError(UpwashError):
    """The camera gave no photo."""

    def __init__(self, camera: str, problem: str) -> None:
        self.camera = camera
        self.problem = problem
        super().__init__(f"camera {camera}: {problem}")


class NetworkError(UpwashError):
    """A server's network could not be joined."""


class LinkError(UpwashError):
    """A request got no usable answer: the network's or the other side's fault, never the service's."""


class Unreachable(LinkError):
    """No program answers at the address, or the connection broke."""


class DeadlineExceeded(LinkError):
    """No answer came in time."""


UNREACHED = (
    NetworkError,
    Unreachable,
    DeadlineExceeded,
)  # errors that show the state of the path to a server


class NotBegun(LinkError):
    """An instance did not begin a call in the time that its caller allows: `queue_s` of other calls are before it."""

    def __init__(self, queue_s: float, whose: str = "it") -> None:
        super().__init__(f"{whose} has {queue_s:.1f} s of calls in its queue")
        self.queue_s = queue_s


class Refused(LinkError):
    """The other side refused the request; the message is its reason."""


class NoLease(Refused):
    """The instance does not serve this drone any more, or not yet: the drone must ask for a slot."""


class ServerFull(Refused):
    """The server is full: `waiting` drones queue, this drone included; retry after `ask_again_s`."""

    def __init__(self, why: str, *, waiting: int, ask_again_s: float) -> None:
        super().__init__(why)
        self.waiting = waiting
        self.ask_again_s = ask_again_s


class ServicePaused(Refused):
    """The server does not start a service that keeps failing, for another `pause_s`."""

    def __init__(self, why: str, *, pause_s: float) -> None:
        super().__init__(why)
        self.pause_s = pause_s


class GarbledReply(LinkError):
    """An answer came that cannot be decoded."""


class InstanceError(UpwashError):
    """A service instance did not start, or crashed."""


class NotReadyInTime(InstanceError):
    """A service instance was not ready within the configured time."""

    def __init__(self, instance: str, within_s: float, *, whose: str = "the drone's") -> None:
        super().__init__(
            f"{instance} was not ready within {within_s:g} s: raise start_timeout_s in {whose} configuration if its "
            "start takes longer"
        )


class OutcomeUnknown(InstanceError):
    """A call that must not run twice may have run: the drone's service crashed in it, or gave no answer."""


class EngineError(InstanceError):
    """The container engine refused or failed an operation, or does not answer."""


class Unanswered(UpwashError):
    """No server answered a call in time, of a service that only servers run."""


class ServiceError(UpwashError):
    """An exception of the service whose class is unknown here; `type_name` and `message` describe it."""

    def __init__(self, type_name: str, message: str) -> None:
        self.type_name = type_name
        self.message = message
        super().__init__(f"{type_name}: {message}")


class NotWritten(UpwashError):
    """A file could not be written; `kept` describes what exists of it or in its place."""

    def __init__(self, file: Path, error: OSError, kept: str) -> None:
        self.file = file
        super().__init__(
            f"{file}: cannot be written ({error.strerror or error}): {kept}; make room, or name another place"
        )


class NotKept(UpwashError):
    """The work was done, but not all of its output could be written."""


class MissionStopped(UpwashError):
    """The mission is being ended from outside; every verb raises this from now on."""


class ReserveReached(MissionStopped):
    """The mission was ended because the battery is down to the reserve, or the way home would leave less."""


class MissionFailed(UpwashError):
    """The mission program raised; `trace` says where, for its author, from the program's own code on."""

    def __init__(self, said: str, trace: str = "") -> None:
        self.trace = trace
        super().__init__(said)


class TransitionError(UpwashError):
    """An event that the server's state does not allow: a programming error."""
