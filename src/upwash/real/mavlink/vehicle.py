"""A vehicle at the other end of a MAVLink connection: commands to it, and their answers.

Every command passes the latch (`core.vehicle.control`): it is sent only while the vehicle is the program's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.mavlink.packets import Message, name_of
from upwash.mavlink.version import Version
from upwash.real.mavlink.observed import ObservedVehicle
from upwash.support.text import counted

_FRESH_WITHIN_S = 0.5  # until the request for a heartbeat is repeated
_LATE_TEXT_S = 0.5
_CHUNK_BYTES, _MOST_TEXTS = 50, 0xFFFF
_WILL_BE_DONE = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
_HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT


class MavlinkVehicle(ObservedVehicle):
    """Sends commands to a vehicle while it is the program's."""

    version: Version | None = None  # of its firmware; None where it does not tell it
    _texts_said = 0  # long ones, each with a number

    @property
    def is_ours(self) -> bool:
        """Whether the program has the vehicle."""
        return self.latch.control.is_ours

    def claim(self, step: str, *, resumes: bool, ordered_mode: str = "") -> None:
        """Claims the vehicle for the program; raises AutopilotOverruled if that is refused."""
        own_mode = self.firmware.own_mode
        self._judge(
            lambda: self.latch.claim(
                self.now_s, own_mode=own_mode, resumes=resumes, ordered_mode=ordered_mode
            ),
        )
        self.require_control(step)

    def require_control(self, step: str) -> None:
        """Raises AutopilotOverruled unless the program has the vehicle."""
        self.latch.require(step, self.said_lately)

    @property
    def may_steer(self) -> bool:
        """Whether the program has the vehicle, and no other vehicle obeys the same commands."""
        return self.is_ours and not self.identity.two_with_one_id

    def require_one(self, step: str) -> None:
        """Raises AutopilotRefused if two vehicles obey the same commands: no target may be sent to both."""
        if self.identity.two_with_one_id:
            raise AutopilotRefused(step, self.identity.two_with_one_id)

    def steer(self, step: str, message: Message) -> None:
        """Sends a command without an answer; raises AutopilotOverruled unless the program has the vehicle."""
        self.require_control(step)
        self._link.send(message)

    async def command(
        self, step: str, command: int, *parameters: float, expect: Callable[[], None] = lambda: None
    ) -> None:
        """Sends a COMMAND_LONG, missing parameters 0; returns when the vehicle accepts it, as `accept` does."""
        await self.accept(step, self.command_long(command, *parameters), expect)

    def command_int(self, command: int, place: GeoPosition, frame: int, *parameters: float) -> Message:
        """A COMMAND_INT to the vehicle, which carries degrees exactly; the altitude counts in that frame."""
        padded = (*parameters, *[0.0] * (4 - len(parameters)))
        x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        return mavlink.MAVLink_command_int_message(
            *self.ids, frame, command, 0, 0, *padded, x, y, place.altitude_m
        )

    async def accept(self, step: str, command: Message, expect: Callable[[], None] = lambda: None) -> None:
        """Sends the command; returns when the vehicle accepts it.

        Raises AutopilotRefused, or AutopilotTimeout without an answer.

        `expect` announces the command's effect to the latch, just before each attempt.
        """
        begun_s = self.now_s
        result = await self.result(step, command, expect)
        if result not in _WILL_BE_DONE:
            texts = self.telemetry.texts
            await self.happens(step, lambda: bool(texts and texts[-1][0] >= begun_s), within_s=_LATE_TEXT_S)
            answer, name = name_of("MAV_RESULT", result), name_of("MAV_CMD", command.command)
            problem = f"the vehicle answered {answer} to {name}"
            raise AutopilotRefused(step, problem, self.telemetry.said_since(begun_s))

    async def result(self, step: str, command: Message, expect: Callable[[], None] = lambda: None) -> int:
        """Sends the command until the answer comes; returns the answer (MAV_RESULT).

        Attempts while the link is silent do not count.
        """
        answers, number, begun_s, attempt = self.telemetry.answers, command.command, self.now_s, 0
        while attempt < self.patience.attempts:
            await self.confirm_control(step)
            expect()
            answers.pop(number, None)
            command.confirmation = attempt  # which a COMMAND_INT does not send
            self._link.send(command)
            if await self.happens(step, lambda: number in answers, within_s=self.patience.answer_s):
                return answers[number]
            if self.linked:
                attempt += 1
        problem = f"no answer to {name_of('MAV_CMD', number)} after {counted(attempt, 'attempt')}"
        raise AutopilotTimeout(step, problem, self.telemetry.said_since(begun_s))

    async def confirm_control(self, step: str) -> None:
        """Waits for a fresh heartbeat; raises AutopilotOverruled unless the vehicle is still the program's then.

        The last heartbeat may be a second old, or from before a silence: a pilot may have taken the vehicle since.
        """
        asked_s = self.now_s
        while not self.heard_since(_HEARTBEAT, asked_s) or self.telemetry.disarms:
            self.require_control(step)
            self.ask_for(_HEARTBEAT)
            await self.happens(
                step,
                lambda: self.heard_since(_HEARTBEAT, asked_s) and not self.telemetry.disarms,
                within_s=min(_FRESH_WITHIN_S, self.patience.answer_s),
            )
        self.require_control(step)

    async def change_mode(self, step: str, parameters: Sequence[float], mode: str) -> None:
        """Commands DO_SET_MODE with the parameters; returns when the vehicle reports the mode."""
        await self._effect(
            step,
            lambda: self.mode_name == mode,
            lambda: self.latch.expect_modes((mode,)),
            mavlink.MAV_CMD_DO_SET_MODE,
            *parameters,
        )

    async def arm(self, step: str, *, armed: bool) -> None:
        """Arms or disarms the vehicle; returns when it reports so."""
        if armed:
            self.require_alone(step)
        await self._effect(
            step,
            lambda: self.telemetry.armed == armed,
            lambda: self.latch.expect_armed(armed),
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
            armed,
        )

    async def _effect(
        self,
        step: str,
        done: Callable[[], bool],
        expect: Callable[[], None],
        command: int,
        *parameters: float,
    ) -> None:
        """Repeat the command until the vehicle reports its effect, as an answer may belong to an earlier attempt."""
        for _ in range(self.patience.attempts):
            try:
                await self.command(step, command, *parameters, expect=expect)
            except AutopilotRefused:
                self.latch.withdraw()
                raise
            self.ask_for(_HEARTBEAT)
            if await self.happens(step, lambda: done() or not self.is_ours, within_s=self.patience.effect_s):
                self.require_control(step)
                return
        problem = f"{name_of('MAV_CMD', command)} was accepted and not done"
        raise AutopilotTimeout(step, problem, self.said_lately)

    def say(self, severity: int, text: str) -> None:
        """Sends a text to all receivers of the vehicle's messages; a long text in chunks that share a number."""
        body = text.encode()
        if len(body) <= _CHUNK_BYTES:
            self._link.send(mavlink.MAVLink_statustext_message(severity, body))
            return
        self._texts_said = self._texts_said % _MOST_TEXTS + 1
        for sequence, at in enumerate(range(0, len(body) + 1, _CHUNK_BYTES)):  # the last one is not full
            chunk = body[at : at + _CHUNK_BYTES]
            self._link.send(mavlink.MAVLink_statustext_message(severity, chunk, self._texts_said, sequence))
