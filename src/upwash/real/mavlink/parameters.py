"""Reading and setting a vehicle's parameters, and the quantities in them under the names of each firmware version.

MAVLink has an answer for a parameter that a vehicle does not have (PARAM_ERROR). Today's autopilots do not send that
answer: a missing parameter and a lost question look alike. So the last question of each round is for a parameter that
every version of the firmware has. If the last answer comes in several rounds, and the answer for another parameter
never comes, the vehicle does not have the other parameter.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotTimeout
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.packets import Message
from upwash.real.mavlink.vehicle import MavlinkVehicle

Names: TypeAlias = tuple[str, ...]
"""The names of one parameter in the versions of a firmware."""

_ATTEMPTS = 12
_SETS = 3
_ROUNDS_THAT_TELL = 3  # with the last answer, without that for a parameter: the vehicle does not have it
_ROUNDS_THAT_TELL_WITH_LOSSES = 6  # the same, over a link that lost a question or an answer meanwhile
_ASKED_AT_ONCE = 5  # parameters, of up to two names each: ArduPilot keeps 20 questions of all links
_LATER_S = 0.1  # a datagram may come later than the next one
_AS_BYTES = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}
_MOST = {"": 1e3, "%": 100.0, "mAh": 1e7, "s": 3_600.0, "m": 10_000.0, "m/s": 100.0, "m/s²": 100.0}  # by unit


class Reading(dict[str, float]):
    """The finite values of a vehicle's parameters, by name.

    `absent` has the names of parameters that the vehicle does not have, `senseless` the values that are no numbers.
    For a parameter that is in neither, no answer came.
    """

    def __init__(self, values: Mapping[str, float], absent: frozenset[str]) -> None:
        super().__init__({name: value for name, value in values.items() if math.isfinite(value)})
        self.senseless = {name: value for name, value in values.items() if name not in self}
        self.absent = absent

    def why_unknown(self, *names: str) -> str:
        """Why the value of the parameter with these names is not known."""
        if odd := [f"{name} is {self.senseless[name]:g}" for name in names if name in self.senseless]:
            return f"the vehicle says that its {odd[0]}, which makes no sense"
        if self.absent.issuperset(names):
            return f"the vehicle has no parameter {' or '.join(names)}"
        return f"the vehicle did not answer what its {' or '.join(names)} is: the link loses messages"


@dataclass(frozen=True, slots=True, eq=False)
class VehicleQuantity:
    """A quantity, with the names of its parameter, the oldest first, and the size of each name's unit in `unit`.

    `usual` replaces an unknown value; if it is None, `without` describes the consequence. A value below `least`, or
    above what any vehicle can do, counts as unknown.
    """

    what: str
    names: Mapping[str, float]
    unit: str
    usual: float | None
    least: float = 0.0
    without: str = ""

    @property
    def name(self) -> str:
        """The best-known name of its parameter."""
        return next(iter(self.names))

    @property
    def instead(self) -> str:
        """The consequence of an unknown value, in words."""
        if self.usual is None:
            return self.without
        return f"{self.what} is guessed to be {self.usual:g} {self.unit}"


@dataclass(frozen=True, slots=True)
class QuantityValues:
    """The known values of some quantities, and the names of the others."""

    values: Mapping[VehicleQuantity, float]
    guessed: tuple[str, ...]
    told: Mapping[VehicleQuantity, tuple[str, float]] = field(default_factory=dict)
    """The name and the value of each in the vehicle's own version."""

    def known(self, quantity: VehicleQuantity) -> float | None:
        """The vehicle's value; None if unknown."""
        return self.values.get(quantity)

    def __getitem__(self, quantity: VehicleQuantity) -> float:
        """The vehicle's value, or else the usual value; KeyError if there is neither."""
        value = self.values.get(quantity, quantity.usual)
        if value is None:
            raise KeyError(quantity.name)
        return value


async def read_quantities(vehicle: MavlinkVehicle, quantities: Sequence[VehicleQuantity]) -> QuantityValues:
    """Asks the vehicle for the quantities; reports each unknown quantity as a `VehicleSetting`."""
    reading = await read_parameters(vehicle, [tuple(quantity.names) for quantity in quantities])
    values: dict[VehicleQuantity, float] = {}
    told: dict[VehicleQuantity, tuple[str, float]] = {}
    guessed: list[str] = []
    for quantity in quantities:
        names, value = quantity.names, None
        if name := next((name for name in names if name in reading), ""):
            told[quantity], value = (name, reading[name]), reading[name] * names[name]
        if value is not None and quantity.least <= value <= _MOST[quantity.unit]:
            values[quantity] = value
            continue
        why = reading.why_unknown(*names) if value is None else f"{value:g} {quantity.unit} makes no sense"
        vehicle.news.tell(VehicleSetting(name=quantity.name, value=None, advice=f"{why}; {quantity.instead}"))
        guessed.append(quantity.name)
    return QuantityValues(values, tuple(guessed), told)


@dataclass(frozen=True, slots=True)
class _Parameter:
    value: float
    kind: int  # MAV_PARAM_TYPE


async def read_parameters(vehicle: MavlinkVehicle, wanted: Iterable[str | Names]) -> Reading:
    """Asks for each parameter, by its name or by all its names at once; one answer is enough."""
    answers, absent = await _read(vehicle, wanted)
    return Reading({name: answer.value for name, answer in answers.items()}, absent)


async def set_parameter(vehicle: MavlinkVehicle, name: str, value: float) -> None:
    """Sets a parameter; returns once the vehicle reports the value, raises AutopilotTimeout if it does not.

    Does not check who has the vehicle, so use it only for parameters that do not affect the flight.
    """
    answers, absent = await _read(vehicle, [name])
    before = answers.get(name)
    if before is None:
        raise AutopilotTimeout("parameter", Reading({}, absent).why_unknown(name), vehicle.said_lately)
    wire = _encoded(value, before.kind) if vehicle.firmware.sends_parameters_as_bytes else value
    for _ in range(_SETS):
        vehicle.ask(mavlink.MAVLink_param_set_message(*vehicle.ids, name.encode(), wire, before.kind))
        after = (await _read(vehicle, [name]))[0].get(name)
        if after is not None and math.isclose(after.value, value, rel_tol=1e-6, abs_tol=1e-6):
            return
    raise AutopilotTimeout("parameter", f"{name} was not set to {value:g}", vehicle.said_lately)


async def _read(
    vehicle: MavlinkVehicle, wanted: Iterable[str | Names]
) -> tuple[dict[str, _Parameter], frozenset[str]]:
    """The parameters with an answer, and the names of the parameters that the vehicle does not have."""
    groups = [(names,) if isinstance(names, str) else names for names in wanted]
    answers: dict[str, _Parameter] = {}
    absent: set[str] = set()
    for begin in range(0, len(groups), _ASKED_AT_ONCE):
        questions = _Questions(vehicle, groups[begin : begin + _ASKED_AT_ONCE])
        with vehicle.listening(questions.hear):
            await questions.ask()
        answers |= questions.answers
        absent |= questions.absent
    return answers, frozenset(absent)


@dataclass(slots=True)
class _Questions:
    """Questions for some parameters, repeated until each has an answer or is known to be missing."""

    vehicle: MavlinkVehicle
    groups: Sequence[Names]
    answers: dict[str, _Parameter] = field(default_factory=dict)
    absent: set[str] = field(default_factory=set)
    _unanswered: dict[Names, int] = field(default_factory=dict)  # in how many rounds that tell
    _last_is_told: bool = False
    _loses: bool = False

    def hear(self, message: Message) -> None:
        names = [name for group in self.groups for name in group]
        match message.get_type():
            case "PARAM_VALUE":
                if message.param_id in names:
                    value = _decoded(self.vehicle, message)
                    self.answers[message.param_id] = _Parameter(value, message.param_type)
                if message.param_id == self.vehicle.firmware.always_has:
                    self._last_is_told = True
            case "PARAM_ERROR" if message.error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST:
                self.absent.update(name for name in names if name == message.param_id)

    async def ask(self) -> None:
        """Returns when nothing is left to ask, or after the last round."""
        for attempt in range(_ATTEMPTS):
            if not (missing := self._missing()):
                return
            self._last_is_told = False
            for name in (*(name for group in missing for name in group), self.vehicle.firmware.always_has):
                ids = self.vehicle.ids
                self.vehicle.ask(mavlink.MAVLink_param_request_read_message(*ids, name.encode(), -1))
            await self._answered(lambda: self._last_is_told, within_s=self.vehicle.patience.answer_s)
            await self._answered(lambda: False, within_s=_LATER_S)
            came_late = attempt > 0 and len(self._missing()) < len(missing)
            self._loses |= came_late or not self._last_is_told
            if self._last_is_told:
                self._count_unanswered()

    async def _answered(self, or_else: Callable[[], bool], *, within_s: float) -> None:
        await self.vehicle.happens("parameters", lambda: not self._missing() or or_else(), within_s=within_s)

    def _missing(self) -> list[Names]:
        return [
            group
            for group in self.groups
            if not any(name in self.answers for name in group) and not self.absent.issuperset(group)
        ]

    def _count_unanswered(self) -> None:
        enough = _ROUNDS_THAT_TELL_WITH_LOSSES if self._loses else _ROUNDS_THAT_TELL
        for group in self._missing():
            self._unanswered[group] = self._unanswered.get(group, 0) + 1
            if self._unanswered[group] >= enough:
                self.absent.update(group)


def _decoded(vehicle: MavlinkVehicle, message: Message) -> float:
    layout = _AS_BYTES.get(message.param_type)
    if layout is None or not vehicle.firmware.sends_parameters_as_bytes:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def _encoded(value: float, kind: int) -> float:
    layout = _AS_BYTES.get(kind)
    if layout is None:
        return value
    return float(struct.unpack("<f", struct.pack(layout, round(value)))[0])
