"""What the items of a plan command the camera, as autopilots understand them.

Photos by time come before photos by distance, and each have their own end, as with ArduPilot: IMAGE_STOP_CAPTURE ends
no photos by distance. DO_TRIGGER_CONTROL and DO_SET_CAM_TRIGG_INTERVAL are PX4's: ArduPilot has neither in a mission.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from upwash.plans.items import Item
from upwash.plans.plan import PhotoTrigger

_MS = 1000.0
_SWINGS = (
    "swings the camera between its photos, and upwash does not: plan the photos by distance "
    "(DO_SET_CAM_TRIGG_DIST, 206)"
)


class TriggerCommands:
    """Follows the commands to the camera."""

    def __init__(self) -> None:
        self._by_distance: PhotoTrigger | None = None
        self._by_time: PhotoTrigger | None = None
        self._last: PhotoTrigger | None = None  # that began photos, for a start without a distance or time

    def take(self, item: Item) -> PhotoTrigger | str | None:
        """What the item commands, or why the camera takes no photo by it; None for an item of another kind."""
        command = _COMMANDS.get(item.command)
        return None if command is None else command(self, item)

    def _digicam(self, item: Item) -> PhotoTrigger | str:
        if item.value(5) != 1:
            return f"left out: it takes no photo, as its parameter 5 (shoot) is {item.value(5) or 0:g}, not 1"
        return _at_once(item)

    def _distance(self, item: Item) -> PhotoTrigger:
        every_m = item.parameters[0]
        ends = every_m in (0, -1)
        self._by_distance = None if ends else _begin(item, every_m=math.nan if every_m is None else every_m)
        self._last = self._by_distance or self._last
        return self._left_by_time(item) if self._by_time else self._on(item, now=item.value(3) == 1)

    def _oblique(self, item: Item) -> PhotoTrigger:
        swings = (item.value(4) or 0) >= 2
        trigger = self._distance(replace(item, parameters=(item.parameters[0], *[0.0] * 6)))
        return replace(trigger, problem=_SWINGS if swings else "")

    def _interval(self, item: Item) -> PhotoTrigger | str:
        every_ms = item.value(1) or 0.0
        if every_ms <= 0:
            return f"left out: a time of {every_ms:g} ms (parameter 1) changes nothing"
        return self._each(item, _begin(item, every_s=every_ms / _MS))

    def _image(self, item: Item) -> PhotoTrigger:
        every_s, most = item.value(2) or 0.0, item.value(3) or 0.0
        count = int(most) if 0 < most < math.inf else 0
        if count == 1 or (every_s == 0 and not count):
            return _at_once(item)
        return self._each(item, _begin(item, every_s=every_s, most=count or None))

    def _image_end(self, item: Item) -> PhotoTrigger:
        if self._by_time is None and self._by_distance is not None:
            return replace(_at_once(item), now=False)
        self._by_time = None
        return self._on(item, now=False)

    def _control(self, item: Item) -> PhotoTrigger | str:
        starts, pauses = item.value(1), item.value(3) == 1
        if starts == 0 or pauses:
            self._by_time = self._by_distance = None
            return self._on(item, now=False)
        if starts != 1:
            return "left out: it neither starts nor ends photos"
        trigger = self._last or _begin(item, every_m=math.nan)
        if trigger.every_s is not None:
            return self._each(item, trigger)
        self._by_distance = trigger
        return self._on(item, now=False)

    def _each(self, item: Item, trigger: PhotoTrigger) -> PhotoTrigger:
        self._by_time = self._last = trigger
        return self._on(item, now=True)

    def _on(self, item: Item, *, now: bool) -> PhotoTrigger:
        """The photos that go on after the item; none where all ended."""
        on = self._by_time or self._by_distance or PhotoTrigger(0)
        return replace(on, item=item.number, command=item.name, now=now)

    def _left_by_time(self, item: Item) -> PhotoTrigger:
        return replace(_at_once(item), now=item.value(3) == 1)


def _at_once(item: Item) -> PhotoTrigger:
    return PhotoTrigger(item.number, item.name, now=True, leaves_on=True)


def _begin(
    item: Item, *, every_m: float | None = None, every_s: float | None = None, most: int | None = None
) -> PhotoTrigger:
    return PhotoTrigger(item.number, item.name, every_m=every_m, every_s=every_s, most=most)


_COMMANDS: dict[int, Callable[[TriggerCommands, Item], PhotoTrigger | str]] = {
    203: TriggerCommands._digicam,
    206: TriggerCommands._distance,
    214: TriggerCommands._interval,
    260: TriggerCommands._oblique,
    2000: TriggerCommands._image,
    2001: TriggerCommands._image_end,
    2003: TriggerCommands._control,
}
