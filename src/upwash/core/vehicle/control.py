"""Who commands the vehicle: the program, the pilot, a ground station, a fail-safe, or an unknown party.

Laws:

1. A command is sent only while the vehicle is the program's.
2. It becomes the program's by a claim alone. A person's act stands behind each claim: the program was started with
   the vehicle disarmed, or resumed with the vehicle in the program's own mode.
3. From the first report whose mode, arming or target differs from what was commanded, it is not the program's any
   more. The same holds after the autopilot restarted in a flight. No later report gives it back: a claim after that
   is refused for as long as the program runs.
4. While a command is on its way, the state before it and each state that it leads to are no difference.
5. Silence changes nothing. What the vehicle did meanwhile shows in the first report after it.
6. An owner is named by evidence alone. Later evidence may name another owner, never the program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum

from msgspec import Struct

from upwash.core.geo import Position, distance_m
from upwash.errors import AutopilotOverruled

_SAME_PLACE_M = 1.0  # a vehicle keeps a target in metres from its own origin, and rounds it
_MOST_PENDING = 4  # commands to places in a row without an answer


class Targets:
    """Compares reported targets with commands: a report must agree with the last obeyed command, or one after it.

    Altitudes of commands and of reports count from the same place. Before the first command, the first report is the
    target of an earlier program, and no difference. A command whose answer was not awaited may have been obeyed.
    """

    def __init__(self) -> None:
        # The last command, and those sent since: () without one, None for a take-off, which reports no target.
        self._obeyed: tuple[Position | None, ...] = ()
        self._pending: tuple[Position | None, ...] = ()

    def send(self, place: Position | None) -> None:
        """Note that a command to `place` is about to be sent; None for a take-off, which has no target."""
        if place not in self._pending[-1:]:  # else it is sent again
            self._pending = (*self._pending, place)[-_MOST_PENDING:]

    def settle(self, *, obeyed: bool) -> None:
        """Note whether the vehicle obeyed the last command or refused it."""
        if obeyed:
            self._obeyed, self._pending = self._pending[-1:] or self._obeyed, ()
        else:
            self._pending = self._pending[:-1]

    def difference(self, reported: Position | None) -> str:
        """How a reported target, None for a velocity, differs from the commands; "" if it does not."""
        if not self._obeyed:
            if reported is not None and not self._pending:
                self._obeyed = (reported,)
            return ""
        if reported is None:
            return "" if self._pending else "it follows a velocity that the program did not command"
        expected = (*self._obeyed, *self._pending)
        if any(place is not None and distance_m(place, reported) <= _SAME_PLACE_M for place in expected):
            return ""
        there = f"{reported.east_m:.0f} m east, {reported.north_m:.0f} m north"
        (obeyed,) = self._obeyed
        if obeyed is None:
            return f"it was sent to {there}, which the program did not command"
        apart_m = distance_m(obeyed, reported)
        return f"it was sent to {there}, {apart_m:.0f} m from where the program sent it"


_KNOWN_LATE_S = 1.0  # after the mode, that the remote control moved


class Owner(StrEnum):
    """The parties that can command the vehicle."""

    NOBODY = "nobody"  # not claimed yet
    PROGRAM = "program"
    PILOT = "pilot"
    GROUND_STATION = "ground station"
    FAILSAFE = "fail-safe"
    EARLIER_RUN = "earlier run"  # of this program: the vehicle comes down as that run commanded
    UNKNOWN = "unknown"  # no report shows who acted


_WHO = {
    Owner.NOBODY: "the program has not taken the vehicle",
    Owner.PROGRAM: "the program has the vehicle",
    Owner.PILOT: "the pilot has the vehicle",
    Owner.GROUND_STATION: "a ground station or another program has the vehicle",
    Owner.FAILSAFE: "a fail-safe has the vehicle",
    Owner.EARLIER_RUN: "the vehicle follows an earlier run of the program",
    Owner.UNKNOWN: "the program has lost the vehicle",
}


class ControlChange(StrEnum):
    """The events that can change the owner: a claim, or what a report shows."""

    CLAIMED = "claimed"
    MODE_CHANGED = "mode changed, and no report tells of the remote control"
    MODE_SWITCHED = "mode changed as the remote control moved"
    MODE_COMMANDED = "mode changed, and the remote control did not move"
    REMOTE_MOVED = "remote control moved"  # what is known late of a change of the mode
    MODE_FAILED_SAFE = "mode changed by a fail-safe"
    ARMED = "armed"
    ARMED_BY_REMOTE = "armed as the remote control moved"
    FOUND_FAILING_SAFE = "claimed while a fail-safe flies it"
    FOUND_COMING_DOWN = "claimed while it comes down as an earlier run of the program commanded"
    DISARMED = "disarmed"
    TARGET_CHANGED = "target changed"  # in the program's own mode: sticks cannot do that
    RESTARTED = "autopilot restarted"


_MODES = {
    ControlChange.MODE_CHANGED: Owner.UNKNOWN,
    ControlChange.MODE_SWITCHED: Owner.PILOT,
    ControlChange.MODE_COMMANDED: Owner.GROUND_STATION,
    ControlChange.MODE_FAILED_SAFE: Owner.FAILSAFE,
}
_BY_EVIDENCE = {
    **_MODES,
    ControlChange.ARMED: Owner.UNKNOWN,
    ControlChange.ARMED_BY_REMOTE: Owner.PILOT,
    ControlChange.RESTARTED: Owner.UNKNOWN,
}
TRANSITIONS: Mapping[tuple[Owner, ControlChange], Owner] = {
    (Owner.NOBODY, ControlChange.CLAIMED): Owner.PROGRAM,
    **{(Owner.NOBODY, change): Owner.NOBODY for change in _MODES},  # a switch on the ground
    (Owner.NOBODY, ControlChange.ARMED): Owner.UNKNOWN,
    (Owner.NOBODY, ControlChange.ARMED_BY_REMOTE): Owner.PILOT,
    (Owner.NOBODY, ControlChange.FOUND_FAILING_SAFE): Owner.FAILSAFE,
    (Owner.NOBODY, ControlChange.FOUND_COMING_DOWN): Owner.EARLIER_RUN,
    **{
        (owner, change): named
        for owner in Owner
        if owner is not Owner.NOBODY
        for change, named in _BY_EVIDENCE.items()
    },
    (Owner.PROGRAM, ControlChange.CLAIMED): Owner.PROGRAM,
    (Owner.PROGRAM, ControlChange.DISARMED): Owner.UNKNOWN,  # the pilot, or its own delay on the ground
    (Owner.PROGRAM, ControlChange.TARGET_CHANGED): Owner.GROUND_STATION,
    (Owner.GROUND_STATION, ControlChange.REMOTE_MOVED): Owner.PILOT,
}
"""Complete but for what changes nothing: the claim of a vehicle that was lost (law 3), and, of a vehicle that is not
the program's, that it is disarmed, is sent elsewhere, or restarts before the claim.
"""


class Control(Struct, frozen=True):
    """The vehicle's owner, since when, and why."""

    owner: Owner
    since_s: float
    why: str

    @property
    def is_ours(self) -> bool:
        """Whether a command may be sent (law 1)."""
        return self.owner is Owner.PROGRAM

    def __str__(self) -> str:
        return f"{_WHO[self.owner]}: {self.why}"


class Heartbeat(Struct, frozen=True, gc=False):
    """One heartbeat of the autopilot, with facts from other messages.

    `failsafe` is why a fail-safe may have chosen the mode, or "". `remote_moved` tells whether the pilot's remote
    control has just moved; it and `on_ground` are None if the vehicle does not report them.
    """

    mode: str
    armed: bool
    failsafe: str = ""
    on_ground: bool | None = None
    remote_moved: bool | None = None


class Latch:
    """Follows claims, commands and reports; `control` is the owner that results.

    Modes are given by name. A claim must come after the first report.
    """

    def __init__(self, now_s: float) -> None:
        self.control = Control(Owner.NOBODY, now_s, "not claimed yet")
        self._reported: Heartbeat | None = None
        self._mode: str | None = None  # the last commanded mode seen; None: any, while it stands disarmed
        self._modes_ahead: tuple[str, ...] = ()  # those that the command on its way leads to, in order
        self._armed = False
        self._armed_ahead: bool | None = None
        self._targets = Targets()

    def claim(self, now_s: float, *, own_mode: str, resumes: bool, ordered_mode: str = "") -> None:
        """Claim the vehicle for the program, if law 2 allows it; `control` has the result, and why.

        `ordered_mode` is the mode that an earlier run of the program commanded last to bring the vehicle down, or "".
        """
        reported = self._reported
        if self.control.owner is not Owner.NOBODY or reported is None:
            return
        if not reported.armed:
            self._mode, self._armed = None, False
            self._take(ControlChange.CLAIMED, "it was disarmed when the program was started", now_s)
        elif resumes and reported.mode == own_mode:
            self._mode, self._armed = reported.mode, True
            self._take(
                ControlChange.CLAIMED, f"it was in mode {own_mode} when the program was resumed", now_s
            )
        else:
            wanted = f"switch it to {own_mode} and resume the flight" if resumes else "disarm it first"
            self._take(*_found_armed(reported, wanted, ordered_mode if resumes else ""), now_s)

    def require(self, step: str, vehicle_said: str = "") -> None:
        """Raises AutopilotOverruled unless the program has the vehicle (law 1)."""
        if not self.control.is_ours:
            raise AutopilotOverruled(step, f"{self.control}; nothing was sent", vehicle_said)

    def expect_modes(self, modes: Sequence[str]) -> None:
        """Note that a command that leads through these modes, in order, is about to be sent."""
        self._modes_ahead = tuple(modes)
        if self._mode is None and self._reported is not None:
            self._mode = self._reported.mode

    def expect_armed(self, armed: bool) -> None:
        """Note that a command is about to be sent after which the vehicle is armed, or disarmed."""
        self._armed_ahead = armed

    def expect_target(self, place: Position | None) -> None:
        """Note that a command to this place is about to be sent; None for a take-off, straight up."""
        self._targets.send(place)

    def settle_target(self, *, obeyed: bool) -> None:
        """Note whether the vehicle obeyed or refused the last command to a place."""
        self._targets.settle(obeyed=obeyed)

    def withdraw(self) -> None:
        """Note that the command on its way was refused, and changes neither mode nor arming."""
        self._modes_ahead, self._armed_ahead = (), None

    def report(self, report: Heartbeat, now_s: float) -> None:
        """Take in a heartbeat (laws 3 and 4)."""
        before, self._reported = self._reported, report
        if self.control.is_ours:
            self._compare_arming(report, now_s)
            # What has lost its motors may go back to the mode that it begins with: no pilot's switch.
            if self.control.is_ours or report.failsafe:
                self._compare_mode(report, now_s)
        elif before is not None:
            self._compare_lost(before, report, now_s)

    def report_target(self, place: Position | None, now_s: float) -> None:
        """Take in the reported target (laws 3 and 4), while the vehicle is in the program's own mode.

        None: the vehicle follows a velocity instead of a place.
        """
        if not self.control.is_ours or not self._armed or self._modes_ahead:
            return
        if difference := self._targets.difference(place):
            self._take(ControlChange.TARGET_CHANGED, difference, now_s)

    def report_restart(self, why: str, now_s: float) -> None:
        """Take in that the autopilot restarted: the program loses the vehicle, unless it stands disarmed."""
        if self.control.owner is Owner.NOBODY or (self.control.is_ours and not self._armed):
            return
        self._take(ControlChange.RESTARTED, why, now_s)

    def _compare_arming(self, report: Heartbeat, now_s: float) -> None:
        if report.armed == self._armed_ahead:
            self._armed, self._armed_ahead = report.armed, None
            if not report.armed:  # it stands, and may go back to the mode that it had before the flight
                self._mode, self._modes_ahead, self._targets = None, (), Targets()
        elif report.armed != self._armed:
            self._take(*_armed_or_disarmed(report), now_s)

    def _compare_mode(self, report: Heartbeat, now_s: float) -> None:
        if report.mode in self._modes_ahead:
            past = self._modes_ahead.index(report.mode) + 1
            self._mode, self._modes_ahead = report.mode, self._modes_ahead[past:]
        elif self._mode is not None and report.mode != self._mode:
            commanded = self._modes_ahead[-1] if self._modes_ahead else self._mode
            self._take_mode(report, now_s, f", {commanded} was commanded")

    def _compare_lost(self, before: Heartbeat, report: Heartbeat, now_s: float) -> None:
        if report.armed and not before.armed:
            self._take(*_armed_or_disarmed(report), now_s)
        changed = report.armed and report.mode != before.mode  # disarmed it may go back to an earlier mode
        if changed or (report.failsafe and report.failsafe != before.failsafe):  # the cause may come late
            self._take_mode(report, now_s, "")
        elif report.remote_moved and report.mode != self._mode:
            lost = self.control
            if lost.owner is Owner.GROUND_STATION and now_s - lost.since_s <= _KNOWN_LATE_S:
                why = f"the vehicle is in mode {report.mode} (the remote control moved)"
                self._take(ControlChange.REMOTE_MOVED, why, now_s)

    def _take_mode(self, report: Heartbeat, now_s: float, instead_of: str) -> None:
        if report.failsafe:
            change, by = ControlChange.MODE_FAILED_SAFE, f" ({report.failsafe})"
        else:
            change, by = _MODE_CHANGED[report.remote_moved]
        self._take(change, f"the vehicle is in mode {report.mode}{by}{instead_of}", now_s)

    def _take(self, change: ControlChange, why: str, now_s: float) -> None:
        before, owner = self.control, TRANSITIONS[self.control.owner, change]
        if owner is not Owner.NOBODY:
            self.control = Control(owner, before.since_s if owner is before.owner else now_s, why)


_DISARMED = {
    True: "it was disarmed on the ground, or disarmed itself, as a vehicle does after a landing or a long stand",
    False: "its motors stopped in the air, and it does not say who stopped them",
    None: "its motors stopped, and it does not say whether it stands on the ground",
}


_MODE_CHANGED = {
    True: (ControlChange.MODE_SWITCHED, " (the remote control moved)"),
    False: (ControlChange.MODE_COMMANDED, " (the remote control did not move)"),
    None: (ControlChange.MODE_CHANGED, " (no report tells who chose it)"),
}


def _found_armed(report: Heartbeat, wanted: str, ordered_mode: str) -> tuple[ControlChange, str]:
    """The evidence of a vehicle that was found armed, and what to do."""
    if report.failsafe:
        why = f"it is armed, in mode {report.mode} ({report.failsafe}); to give it to the program, {wanted}"
        return ControlChange.FOUND_FAILING_SAFE, why
    if report.mode == ordered_mode:
        why = f"it is in mode {report.mode}, as that run commanded; wait for the landing and resume, or {wanted}"
        return ControlChange.FOUND_COMING_DOWN, why
    why = f"it is armed, in mode {report.mode}; to give it to the program, {wanted}"
    return ControlChange.ARMED, why


def _armed_or_disarmed(report: Heartbeat) -> tuple[ControlChange, str]:
    if report.armed and report.remote_moved:
        return ControlChange.ARMED_BY_REMOTE, "somebody else armed it (the remote control moved)"
    if report.armed:
        return ControlChange.ARMED, "somebody else armed it"
    return ControlChange.DISARMED, _DISARMED[report.on_ground]
