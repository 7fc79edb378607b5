"""Quantities that upwash reads from a vehicle's parameters, under the names of each firmware version."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from upwash.ports import VehicleSetting
from upwash.real.mavlink.parameters import Reading, read_parameters
from upwash.real.mavlink.vehicle import MavlinkVehicle

_MOST = {"": 1e3, "%": 100.0, "mAh": 1e7, "s": 3_600.0, "m": 10_000.0, "m/s": 100.0, "m/s²": 100.0}  # by unit


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A quantity, with the names of its parameter, the oldest first, and the size of each name's unit in `unit`.

    `usual` stands for an unknown value. If `usual` is None, `without` says what follows from an unknown value. A
    value below `least`, or above what any vehicle does, makes no sense, and counts as unknown.
    """

    what: str
    names: Mapping[str, float]
    unit: str
    usual: float | None
    least: float = 0.0
    without: str = ""

    @property
    def name(self) -> str:
        """The name by which most people know it."""
        return next(iter(self.names))

    def in_words(self, value: float) -> str:
        """A value, as a sentence has it."""
        return f"{value:g} {self.unit}"


@dataclass(frozen=True, slots=True)
class Told:
    """The known values of some quantities, and why the others are not known."""

    values: Mapping[Quantity, float]
    why_not: Mapping[Quantity, str]

    def known(self, quantity: Quantity) -> float | None:
        """The vehicle's value, or None."""
        return self.values.get(quantity)

    def __getitem__(self, quantity: Quantity) -> float:
        """The vehicle's value, or else the usual value; KeyError if there is neither."""
        value = self.values.get(quantity, quantity.usual)
        if value is None:
            raise KeyError(quantity.name)
        return value

    @property
    def guessed(self) -> tuple[str, ...]:
        """The names of the quantities that are not known."""
        return tuple(each.name for each in self.why_not)


async def read_quantities(vehicle: MavlinkVehicle, quantities: Sequence[Quantity]) -> Told:
    """Asks for all of them. Each unknown quantity becomes a `VehicleSetting`, which says what follows."""
    reading = await read_parameters(vehicle, [tuple(each.names) for each in quantities])
    values: dict[Quantity, float] = {}
    why_not: dict[Quantity, str] = {}
    for each in quantities:
        value = _value(each, reading)
        if value is None:
            why_not[each] = reading.why_unknown(*each.names)
        elif each.least <= value <= _MOST[each.unit]:
            values[each] = value
        else:
            why_not[each] = f"{each.in_words(value)} makes no sense"
    for each, why in why_not.items():
        vehicle.tell(VehicleSetting(each.name, None, f"{why}; {_instead(each)}"))
    return Told(values, why_not)


def _value(quantity: Quantity, reading: Reading) -> float | None:
    return next((reading[name] * size for name, size in quantity.names.items() if name in reading), None)


def _instead(quantity: Quantity) -> str:
    if quantity.usual is None:
        return quantity.without
    return f"{quantity.what} is guessed to be {quantity.in_words(quantity.usual)}"
