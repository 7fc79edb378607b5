"""The deeds of the vehicle's fail-safes, and their delays, as observed of a real ArduCopter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from upwash.vehicle.ardupilot.boot import EKF_FLIES_BY_GPS, EKF_HOLDS_STILL, WARNING, RecordedStory, Text
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.body.parameters import ParameterTable

_RETURN, _LAND = 6, 9  # modes
_LOST_EKF_FLAGS = 37  # attitude, height and a speed upwards
_DOUBTS_S, _LANDS_S, _STANDS_STILL_S, _GIVES_UP_WAY_BACK_S = 7.6, 8.0, 15.2, 22.2  # without GPS
_RADIO_S = 1.0
_GLITCHING_EKF_FLAGS = EKF_FLIES_BY_GPS | 1 << 15
_GLITCH_NOTICED_S, _GLITCH_BELIEVED_S, _GLITCH_OVER_S = 1.4, 10.2, 20.0
GLITCH_M, GLITCH_CLEARED_S = 55.66, _GLITCH_OVER_S  # to the north; the text comes while GPS is off, too


@dataclass(frozen=True, slots=True)
class FailsafeTrigger:
    """Texts for now, the mode to change to, and the apparent jump of its place to the north."""

    texts: tuple[Text, ...] = ()
    mode: int | None = None
    jump_m: float = 0.0


def _lane_switch(lane: int) -> tuple[Text, ...]:
    return Text(f"EKF3 lane switch {lane}"), Text(f"EKF primary changed:{lane}", WARNING)


_CLEARED = FailsafeTrigger((Text("Glitch cleared"),))


def _gps_jumps(jump_m: float, cleared_s: float) -> RecordedStory[FailsafeTrigger]:
    """The vehicle doubts its GPS, believes it, and takes the glitch for over, whether it is or not."""
    return RecordedStory(
        (
            (0.2, FailsafeTrigger(_lane_switch(1))),
            (0.4, FailsafeTrigger(_lane_switch(0))),
            (_GLITCH_NOTICED_S, FailsafeTrigger((Text("GPS Glitch or Compass error"),))),
            (_GLITCH_BELIEVED_S, FailsafeTrigger(_lane_switch(1), jump_m=jump_m)),
            (cleared_s, _CLEARED),
        )
    )


def _glitch_ends(jump_m: float) -> RecordedStory[FailsafeTrigger]:
    """The GPS jumps back before the vehicle took the glitch for over."""
    return RecordedStory(
        (
            (0.2, FailsafeTrigger(_lane_switch(0))),
            (5.2, FailsafeTrigger(_lane_switch(1))),
            (_GLITCH_BELIEVED_S, FailsafeTrigger(_lane_switch(0), jump_m=jump_m)),
            (_GLITCH_OVER_S, _CLEARED),
        )
    )


_NO_GPS = (
    (_LANDS_S, FailsafeTrigger((Text("EKF variance"), Text("EKF Failsafe: changed to LAND Mode")), _LAND)),
    (
        _STANDS_STILL_S,
        FailsafeTrigger(tuple(Text(f"EKF3 IMU{number} stopped aiding", WARNING) for number in (0, 1))),
    ),
    (_GIVES_UP_WAY_BACK_S, FailsafeTrigger((Text("SmartRTL deactivated: bad position", WARNING),))),
)


class Failsafes:
    """The fail-safes that have triggered. A glitch puts GPS off by `glitch_m`, and is over in `glitch_cleared_s`."""

    def __init__(self, *, glitch_m: float = GLITCH_M, glitch_cleared_s: float = GLITCH_CLEARED_S) -> None:
        self._glitch_begins = _gps_jumps(glitch_m, glitch_cleared_s)
        self._glitch_ends = _glitch_ends(-glitch_m)
        self._glitch_ends_later = _gps_jumps(-glitch_m, _GLITCH_OVER_S)
        self._cleared_s = glitch_cleared_s
        self._cleared_early = False
        self.battery = False
        self.lost_place = False
        self.ekf_flags = EKF_FLIES_BY_GPS
        self.heard_ground_s: float | None = None
        self._landed = False
        self._lost_links: set[str] = set()
        self._no_gps = RecordedStory(_NO_GPS)
        self._glitch_s: float | None = None
        self._glitch_over_s: float | None = None

    @property
    def active(self) -> bool:
        """Whether one of them has taken over, and what it is about is still wrong."""
        return self.battery or self._landed or bool(self._lost_links)

    def triggers(
        self,
        now_s: float,
        since_s: Mapping[FaultKind, float],
        parameters: ParameterTable,
        *,
        flying: bool,
        armed: bool,
        low_batteries: Mapping[FaultKind, str],
        by_position: bool,
    ) -> Iterator[FailsafeTrigger]:
        """The triggers due now, from the times since which the faults of `since_s` have lasted."""
        yield from self._without_gps(
            now_s, since_s.get(FaultKind.GPS), flying=flying, by_position=by_position
        )
        yield from self._glitching(now_s, since_s.get(FaultKind.GLITCH))
        for fault, low in low_batteries.items():
            yield from self._empty(now_s, fault, since_s.get(fault), parameters, low, armed=armed)
        yield from self._out_of_reach(now_s, since_s.get(FaultKind.RADIO), parameters, armed=armed)
        yield from self._unheard(now_s, parameters, armed=armed)

    def _without_gps(
        self, now_s: float, since_s: float | None, *, flying: bool, by_position: bool
    ) -> Iterator[FailsafeTrigger]:
        if since_s is None:
            self.lost_place = self._landed = False
            self.ekf_flags = EKF_FLIES_BY_GPS
            self._no_gps.begin()
            return
        lost_s = now_s - since_s
        if lost_s >= _STANDS_STILL_S:
            self.ekf_flags = EKF_HOLDS_STILL
        elif lost_s >= _DOUBTS_S:
            self.ekf_flags = _LOST_EKF_FLAGS
        for trigger in self._no_gps.next(lost_s):
            if trigger.mode is not None:
                self._landed = flying and by_position
            if self._landed:
                yield trigger
        self.lost_place = lost_s >= _LANDS_S

    def _glitching(self, now_s: float, since_s: float | None) -> Iterator[FailsafeTrigger]:
        if since_s is not None:
            if self._glitch_s is None:
                self._glitch_begins.begin()
            self._glitch_s, self._glitch_over_s = since_s, None
            yield from self._glitch_begins.next(now_s - since_s)
            if _GLITCH_NOTICED_S <= now_s - since_s < self._cleared_s:
                self.ekf_flags = _GLITCHING_EKF_FLAGS
            return
        if self._glitch_s is None:
            return
        if self._glitch_over_s is None:
            self._glitch_over_s = now_s
            self._cleared_early = now_s - self._glitch_s >= self._cleared_s
            self._glitch_ends.begin()
            self._glitch_ends_later.begin()
        believed = self._glitch_begins.told_s >= _GLITCH_BELIEVED_S
        ended_s = now_s - self._glitch_over_s
        if not self._cleared_early or ended_s >= _GLITCH_NOTICED_S:
            self.ekf_flags = _GLITCHING_EKF_FLAGS
        story = self._glitch_ends_later if self._cleared_early else self._glitch_ends
        for trigger in story.next(ended_s):
            yield trigger if believed or not trigger.jump_m else FailsafeTrigger(trigger.texts)
        if ended_s >= _GLITCH_OVER_S:
            self._glitch_s, self.ekf_flags = None, EKF_FLIES_BY_GPS

    def _empty(
        self,
        now_s: float,
        fault: FaultKind,
        since_s: float | None,
        parameters: ParameterTable,
        low: str,
        *,
        armed: bool,
    ) -> Iterator[FailsafeTrigger]:
        if self.battery or since_s is None or not armed:
            return
        action = "BATT_FS_LOW_ACT" if fault is FaultKind.BATTERY else "BATT2_FS_LOW_ACT"
        if now_s - since_s >= parameters["BATT_LOW_TIMER"]:
            self.battery = True
            mode = {1: _LAND, 2: _RETURN, 3: _RETURN, 4: _RETURN}.get(int(parameters[action]))
            acts = (Text("Battery Failsafe", WARNING),) if mode else ()
            yield FailsafeTrigger((Text(low, WARNING), *acts), mode)

    def _out_of_reach(
        self, now_s: float, since_s: float | None, parameters: ParameterTable, *, armed: bool
    ) -> Iterator[FailsafeTrigger]:
        action = int(parameters["FS_THR_ENABLE"])
        lost = since_s is not None and now_s - since_s >= _RADIO_S and bool(action)
        yield from self._latch("Radio", _LAND if action == 3 else _RETURN, lost=lost, armed=armed)

    def _unheard(self, now_s: float, parameters: ParameterTable, *, armed: bool) -> Iterator[FailsafeTrigger]:
        action, heard_s = int(parameters["FS_GCS_ENABLE"]), self.heard_ground_s
        lost = bool(action) and heard_s is not None and now_s - heard_s >= parameters["FS_GCS_TIMEOUT"]
        yield from self._latch("GCS", _LAND if action == 5 else _RETURN, lost=lost, armed=armed)

    def _latch(self, name: str, mode: int, *, lost: bool, armed: bool) -> Iterator[FailsafeTrigger]:
        """A link's fail-safe begins once while the vehicle is armed, and ends with the link's return."""
        if lost and name not in self._lost_links and armed:
            self._lost_links.add(name)
            yield FailsafeTrigger((Text(f"{name} Failsafe", WARNING),), mode)
        elif not lost and name in self._lost_links:
            self._lost_links.remove(name)
            yield FailsafeTrigger((Text(f"{name} Failsafe Cleared", WARNING),))
