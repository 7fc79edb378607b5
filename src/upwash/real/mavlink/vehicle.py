"""A vehicle at the other end of a MAVLink connection: commands that it answers.

Every command passes the latch (`core.control`): it is sent only while the vehicle is the program's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.mavlink.names import name_of
from upwash.mavlink.version import Version
from upwash.real.mavlink.heard import HeardVehicle
from upwash.real.mavlink.hearing import Message

_LATE_TEXT_S = 0.5
_CHUNK_BYTES, _MOST_TEXTS = 50, 0xFFFF
_WILL_BE_DONE = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


class MavlinkVehicle(HeardVehicle):
    """One that is also told what to do: nothing is sent while somebody else has it."""

    version: Version | None = None  # of its firmware, as far as the vehicle tells it
    _texts_said = 0  # long ones, of which each has a number

    def claim(self, step: str, *, resumes: bool) -> None:
        """Takes the vehicle for the program; AutopilotOverruled where it may not."""
        before = self.latch.control
        self.latch.claim(self._loop.time(), own_mode=self.firmware.own_mode, resumes=resumes)
        if self.latch.control != before:
            self.tell(self.latch.control)
        self.require_control(step)

    def require_control(self, step: str) -> None:
        """Raises AutopilotOverruled unless the program has the vehicle."""
        self.latch.require(step, self.said_lately)

    async def command(
        self, step: str, command: int, *parameters: float, expect: Callable[[], None] | None = None
    ) -> None:
        """Returns when the vehicle has said yes; raises AutopilotRefused, or AutopilotTimeout if it says nothing.

        `expect` tells the latch, just before each attempt, what the command leads to.
        """

        def message(attempt: int) -> Message:
            system, component = self.ids
            padded = (*parameters, *[0.0] * (7 - len(parameters)))
            return mavlink.MAVLink_command_long_message(system, component, command, attempt, *padded)

        await self._answered(step, command, message, expect)

    async def command_at(
        self,
        step: str,
        command: int,
        place: GeoPosition,
        *,
        frame: int,
        parameters: Sequence[float] = (),
        expect: Callable[[], None] | None = None,
    ) -> None:
        """The same with a place, whose degrees arrive exactly; its altitude is in the frame."""
        await self._answered(step, command, self._at(command, place, frame, parameters), expect)

    async def result_at(self, step: str, command: int, place: GeoPosition, *, frame: int) -> int:
        """The vehicle's answer (MAV_RESULT) to a command with a place; AutopilotTimeout without one."""
        return await self._result(step, command, self._at(command, place, frame, ()), None)

    def _at(
        self, command: int, place: GeoPosition, frame: int, parameters: Sequence[float]
    ) -> Callable[[int], Message]:
        def message(_attempt: int) -> Message:
            system, component = self.ids
            padded = (*parameters, *[0.0] * (4 - len(parameters)))
            x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
            return mavlink.MAVLink_command_int_message(
                system, component, frame, command, 0, 0, *padded, x, y, place.altitude_m
            )

        return message

    async def _answered(
        self,
        step: str,
        command: int,
        message: Callable[[int], Message],
        expect: Callable[[], None] | None = None,
    ) -> None:
        begun_s = self._loop.time()
        result = await self._result(step, command, message, expect)
        if result not in _WILL_BE_DONE:
            texts = self.telemetry.texts
            await self.happens(step, lambda: bool(texts and texts[-1][0] >= begun_s), within_s=_LATE_TEXT_S)
            answer = name_of("MAV_RESULT", result)
            problem = f"the vehicle answered {answer} to {name_of('MAV_CMD', command)}"
            raise AutopilotRefused(step, problem, self.telemetry.said_since(begun_s))

    async def _result(
        self, step: str, command: int, message: Callable[[int], Message], expect: Callable[[], None] | None
    ) -> int:
        """What the vehicle answers (MAV_RESULT) to the command, which is repeated until it does."""
        answers = self.telemetry.answers
        begun_s = self._loop.time()
        attempt = 0
        while attempt < self.patience.attempts:
            await self._look(step)
            self.require_control(step)
            if expect is not None:
                expect()
            answers.pop(command, None)
            self._link.send(message(attempt))
            if await self.happens(step, lambda: command in answers, within_s=self.patience.answer_s):
                return answers[command]
            if self.linked:
                attempt += 1
        raise AutopilotTimeout(
            step,
            f"no answer to {name_of('MAV_CMD', command)} after {attempt} attempts",
            self.telemetry.said_since(begun_s),
        )

    async def _look(self, step: str) -> None:
        """Returns upon a heartbeat that was asked for now.

        Its own may be a second old, or from before a silence: a pilot may have taken the vehicle since.
        """
        begun_s = self._loop.time()
        heartbeat = mavlink.MAVLINK_MSG_ID_HEARTBEAT
        while not self.heard_since(heartbeat, begun_s):
            self.ask_for(heartbeat)
            await self.happens(
                step, lambda: self.heard_since(heartbeat, begun_s), within_s=self.patience.answer_s
            )

    async def change_mode(self, step: str, parameters: Sequence[float], modes: Sequence[str]) -> None:
        """Returns when the vehicle reports the last of the modes, which DO_SET_MODE with the parameters leads to."""

        def expect() -> None:
            self.latch.expect_modes(modes)

        set_mode = mavlink.MAV_CMD_DO_SET_MODE
        await self.effect(step, lambda: self.mode_name == modes[-1], expect, set_mode, *parameters)

    async def arm(self, step: str, *, armed: bool) -> None:
        """Returns when the vehicle reports that its motors run, or that they stand still."""

        def expect() -> None:
            self.latch.expect_armed(armed)

        if armed:
            self.require_alone(step)
        arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        await self.effect(step, lambda: self.telemetry.armed == armed, expect, arm, armed)

    async def effect(
        self,
        step: str,
        done: Callable[[], bool],
        expect: Callable[[], None],
        command: int,
        *parameters: float,
    ) -> None:
        """Commands until the vehicle reports that it did so: an answer may belong to an earlier attempt."""
        for _ in range(self.patience.attempts):
            try:
                await self.command(step, command, *parameters, expect=expect)
            except AutopilotRefused:
                self.latch.withdraw()
                raise
            self.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            if await self.happens(step, lambda: done() or not self.is_ours, within_s=self.patience.effect_s):
                self.require_control(step)
                return
        raise AutopilotTimeout(
            step, f"{name_of('MAV_CMD', command)} was accepted and not done", self.said_lately
        )

    @property
    def is_ours(self) -> bool:
        """Whether the program has the vehicle."""
        return self.latch.control.is_ours

    def say(self, severity: int, text: str) -> None:
        """Sends words to whoever listens to the vehicle; long ones in chunks that have a number in common."""
        body = text.encode()
        if len(body) <= _CHUNK_BYTES:
            self._link.send(mavlink.MAVLink_statustext_message(severity, body))
            return
        self._texts_said = self._texts_said % _MOST_TEXTS + 1
        for sequence, at in enumerate(range(0, len(body) + 1, _CHUNK_BYTES)):  # the last one is not full
            chunk = body[at : at + _CHUNK_BYTES]
            self._link.send(mavlink.MAVLink_statustext_message(severity, chunk, self._texts_said, sequence))

    def steer(self, step: str, message: Callable[[int, int], Message]) -> None:
        """Sends a command that gets no answer, made for a system and component; AutopilotOverruled if not ours."""
        self.require_control(step)
        self._link.send(message(*self.ids))
