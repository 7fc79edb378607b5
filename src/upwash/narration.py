"""What the events of a flight say to a person, a sentence each, while it lasts or afterwards."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from upwash.core.control import Owner
from upwash.core.servers import State
from upwash.ports import SEVERITIES

_SAFE_ENDS = {
    "return": "returning to land",
    "land": "landing where it is",
    "hold": "stopping to hover",
    "disarm": "disarming on the ground",
}
WARNING = 4
_OWNERS = {
    Owner.NOBODY: "nobody",
    Owner.PROGRAM: "the program",
    Owner.PILOT: "the pilot",
    Owner.FAILSAFE: "a fail-safe",
    Owner.UNKNOWN: "nobody known",
}
LEFT_HOVERING = "The vehicle hovers where it is, and nobody flies it now: take over with the remote control."


def spans(indices: Sequence[int]) -> str:
    """Ascending numbers as a person writes them: "0-4, 7"."""
    stretches = []
    for _, stretch in itertools.groupby(enumerate(indices), key=lambda each: each[1] - each[0]):
        members = [index for _, index in stretch]
        stretches.append(str(members[0]) if len(members) == 1 else f"{members[0]}-{members[-1]}")
    return ", ".join(stretches)


def ran_on(place: str) -> str:
    """Where a call ran, as a sentence says it."""
    return "on the drone" if place == "local" else f"on {place}"


def counted(number: int, noun: str) -> str:
    """So many of it: 1 call, 2 calls."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


class Tone(StrEnum):
    """How a sentence is meant."""

    PLAIN = "plain"
    ASIDE = "aside"  # what changes nothing for the mission
    CHECKING = "checking"
    READY = "ready"
    REMOTE = "remote"  # a call that ran on a server
    FOUND = "found"  # what the mission tells its user
    TROUBLE = "trouble"  # something failed, and the flight goes on
    ALARM = "alarm"  # a person should look


MEANINGS = {  # CHECK-R means what CHECK does
    State.AVL: "available",
    State.AVL_R: "available, its services running",
    State.CHECK: "being checked",
    State.READY: "ready for calls",
    State.BLACKLISTED: "blacklisted",
}
_STATE_TONES: dict[str, Tone] = {
    State.READY: Tone.READY,
    State.CHECK: Tone.CHECKING,
    State.CHECK_R: Tone.CHECKING,
    State.BLACKLISTED: Tone.TROUBLE,
}


def tone_of(state: str) -> Tone:
    """How it is meant that a server is in that state."""
    return _STATE_TONES.get(state, Tone.ASIDE)


@dataclass(frozen=True, slots=True)
class Said:
    """One sentence."""

    text: str
    tone: Tone = Tone.PLAIN


class Narrator:
    """Follows the events of one flight in their order, and knows what the drone is doing."""

    def __init__(self) -> None:
        self.doing = "starting the services of the drone"
        self.where = ""
        self.reached = 0  # waypoints
        self.started = False  # whether the mission has begun
        self.control = ""  # who has the vehicle, since when and why; empty while the program has

    def tell(self, event: Mapping[str, Any]) -> Said | None:
        """What the event says; None for one that is not worth a sentence."""
        match event:
            case {"event": "position", "east_m": east_m, "north_m": north_m, "altitude_m": altitude_m}:
                self.where = f"{east_m:.0f} m east, {north_m:.0f} m north, {altitude_m:.0f} m up"
                return None
            case {"event": "call"}:
                return _call(event, self.doing)
            case {"server": server, "before": before, "after": after, "why": why}:
                because = f" ({why})" if why else ""
                return Said(f"{server}: {before} → {after}{because}", tone_of(after))
            case {"event": "leg" | "arrived" as leg, "waypoint": waypoint}:
                place = "a place beside the plan" if waypoint is None else f"waypoint {waypoint}"
                self.doing = f"flying to {place}" if leg == "leg" else f"at {place}"
                self.reached += leg == "arrived" and waypoint is not None
                return None
            case {"event": "notified", "message": message}:
                return Said(f"told the user: {in_one_line(message)}", Tone.FOUND)
            case _:
                said = self._course(event) or self._vehicle(event) or _vehicle_told(event)
                return said or _ending(event) or _failure(event) or _clock(event)

    def _course(self, event: Mapping[str, Any]) -> Said | None:
        match event:
            case {"event": "local_ready", "service": service}:
                return Said(f"{service} is ready on the drone")
            case {"event": "mission_started", "policy": policy}:
                self.started = True
                self.doing = "before take-off"
                done = event.get("done", ())
                self.reached = len(done)
                before = f"taken up again, {len(done)} waypoints done before" if done else "started"
                return Said(f"mission {before}, policy {policy}")
            case {"event": "returning" | "landed" as doing}:
                self.doing = doing
                return Said("returning home to land" if doing == "returning" else "landed")
            case {"event": "safe_end", "action": action, "why": why}:
                self.doing = _SAFE_ENDS[action]
                return Said(f"{self.doing}: {why}", Tone.ALARM)
            case {"event": "left_hovering"}:
                self.doing = "hovering"
                return Said(LEFT_HOVERING, Tone.ALARM)
        return None

    def _vehicle(self, event: Mapping[str, Any]) -> Said | None:
        """Who has the vehicle, and how it gets into the air and down again."""
        match event:
            case {"event": "control", "owner": owner, "why": why}:
                taken = f"{who_has_it(owner)} has the vehicle since {event['t']:.1f} s: {why}"
                self.control = "" if owner == Owner.PROGRAM else taken
                return _control(owner, why)
            case {"event": "arming_delayed", "reasons": reasons}:
                self.doing = "waiting until the vehicle can be armed"
                said = "; ".join(reasons) or "it does not say why"
                return Said(f"the vehicle cannot be armed yet: {said}", Tone.TROUBLE)
            case {"event": "armed"}:
                self.doing = "armed"
                return Said("armed")
            case {"event": "took_off", "altitude_m": altitude_m}:
                self.doing = "in the air"
                return Said(f"took off to {altitude_m:g} m")
            case {"event": "stood"}:
                self.doing = "on the ground"
                return Said("the vehicle stands on the ground")
        return None


def _vehicle_told(event: Mapping[str, Any]) -> Said | None:
    """What the vehicle says, but for its reasons not to arm, which are told when they change."""
    match event:
        case {"event": "vehicle_said", "severity": severity, "text": text} if severity <= WARNING:
            if text.startswith(("PreArm: ", "Arm: ")):
                return None
            return Said(f"the vehicle says: {text} ({SEVERITIES[severity]})", Tone.TROUBLE)
        case {"event": "vehicle_setting", "name": name, "value": value, "advice": advice}:
            return Said(f"the vehicle's {name} is {value:g}: {advice}", Tone.TROUBLE)
        case {"event": "unsigned_port", "why": why}:
            return Said(why, Tone.TROUBLE)
        case {"event": "link_lost", "silent_s": silent_s}:
            return Said(f"the vehicle is not heard any more, for {silent_s:.1f} s", Tone.TROUBLE)
        case {"event": "link_restored", "silent_s": silent_s}:
            return Said(f"the vehicle is heard again, after {silent_s:.1f} s")
        case {"event": "dead_man_set", "silence_s": silence_s, "action": action}:
            doing = "returns" if action == "return" else "lands"
            said = f"the autopilot {doing} if it does not hear this program for {silence_s:g} s"
            return Said(said, Tone.ASIDE)
        case {"event": "energy", "left_percent": left, "home_s": home_s, "margin_percent": spare}:
            return Said(f"battery {left:.0f} %, home in {home_s:.0f} s, {spare:.0f} % to spare", Tone.ASIDE)
    return None


def who_has_it(owner: str) -> str:
    """An owner of the vehicle, as a sentence names it."""
    return _OWNERS[Owner(owner)]


def _control(owner: str, why: str) -> Said:
    if owner == Owner.PROGRAM:
        return Said(f"the program has the vehicle: {why}", Tone.ASIDE)
    return Said(f"{who_has_it(owner)} has the vehicle: {why}; nothing is sent to it any more", Tone.ALARM)


def _ending(event: Mapping[str, Any]) -> Said | None:
    match event:
        case {"event": "stopping", "why": why}:
            return Said(
                f"stopping ({why}); once more ends this at once, the vehicle left to itself", Tone.ALARM
            )
        case {"event": "left_to_pilot" | "mission_ended" | "following_ended" as ending, "why": why}:
            return Said(f"{ending.replace('_', ' ')}: {why}", Tone.ALARM)
    return None


def _clock(event: Mapping[str, Any]) -> Said | None:
    match event:
        case {"event": "waiting_for_the_time", "why": why}:
            return Said(f"waiting for the vehicle's GPS to tell the time: {why}", Tone.TROUBLE)
        case {"event": "clock_set", "before": before, "after": after}:
            return Said(f"this computer's clock said {before}: set to {after}, as the vehicle's GPS has it")
        case {"event": "clock_differs", "clock": clock, "gps": gps, "why": why}:
            return Said(
                f"this computer's clock says {clock}, the vehicle's GPS {gps}: left as it is, {why}",
                Tone.TROUBLE,
            )
    return None


def _failure(event: Mapping[str, Any]) -> Said | None:
    match event:
        case {"event": name, "why": why} if name.endswith("_failed"):
            return Said(f"{name.replace('_', ' ')}: {why}", Tone.TROUBLE)
        case {"event": "remote_raised", "server": server, "operation": operation, "raised": raised}:
            said = f"{server} says that {operation} raised {raised}; making the call on the drone"
            return Said(said, Tone.TROUBLE)
        case {"event": "local_ended", "service": service, "how": how}:
            return Said(f"{service} on the drone ended ({how}); starting it again", Tone.TROUBLE)
    return None


def _call(event: Mapping[str, Any], doing: str) -> Said:
    waited = f" after waiting {event['waited_s']:.1f} s" if event["wait"] else ""
    return Said(
        f"{doing}: {event['operation']} {ran_on(event['place'])}, {event['delay_s']:.2f} s{waited} "
        f"({event['decision']})",
        Tone.PLAIN if event["place"] == "local" else Tone.REMOTE,
    )


def in_one_line(message: object) -> str:
    """A message to the user: detections by their number and labels, anything else as it is."""
    if isinstance(message, list) and all(isinstance(item, dict) and "label" in item for item in message):
        labels = [item["label"] for item in message]
        return ", ".join(f"{labels.count(label)} x {label}" for label in dict.fromkeys(labels))
    return str(message)
