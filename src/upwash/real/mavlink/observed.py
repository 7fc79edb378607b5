"""A vehicle at the other end of a MAVLink connection: its reports, and questions to it.

Questions, such as for a report or a parameter, change nothing. They are always sent, also while a pilot has the
vehicle.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Sequence
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position
from upwash.core.vehicle.control import Heartbeat, Latch
from upwash.errors import AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import (
    LinkLost,
    LinkRestored,
    LinkTrouble,
)
from upwash.mavlink.packets import Message, sender_of
from upwash.mavlink.signing import Signing
from upwash.real.mavlink.gate import admits
from upwash.real.mavlink.identity import AutopilotInfo, Identity, first_heartbeat
from upwash.real.mavlink.link import MavlinkLink, Opener
from upwash.real.mavlink.news import VehicleNewsFeed
from upwash.real.mavlink.numbering import BootClock, Numbering
from upwash.real.mavlink.receiver import is_signed
from upwash.real.mavlink.settings import DriverPatience
from upwash.real.mavlink.streams import Streams
from upwash.real.mavlink.telemetry import FirmwareProfile, VehicleTelemetry
from upwash.support.background import end, kept_up, only_logged, start
from upwash.support.text import worded

_HEARTBEAT_S = 1.0
_LOOKS_EACH_S = 0.5
_HEARTBEAT, _SYSTEM_TIME = mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
_HOME_POSITION = mavlink.MAVLINK_MSG_ID_HOME_POSITION
_TELL_THE_MODE = ("HEARTBEAT", "CURRENT_MODE")
_TELL_WHY = ("FENCE_STATUS", "STATUSTEXT", "EVENT")
_TELL_WHOSE = ("HEARTBEAT", "CURRENT_MODE", "POSITION_TARGET_GLOBAL_INT", "POSITION_TARGET_LOCAL_NED")
_BLIND_S = 1.5  # after a defect in taking in one of these, which come once a second, until one is taken in
_STOOD_S = 1.0  # on the ground before its motors stop
_WRONG_TIMES = 2  # in a row that sequence numbers do not count
_NUMBERS_PROBLEM = (
    "the sequence numbers of the vehicle's messages do not count up, as behind a bridge that packs the messages "
    "anew; which messages are late is judged by their time since boot"
)
_SIGNS = (
    "signs its messages and answers none that is not signed: name the file of its key as autopilot.signing_key, or "
    "remove the key from the vehicle with a ground station"
)


class ObservedVehicle:
    """The vehicle with that `system` on the connection, or without `system` the only vehicle on it.

    Other senders are ignored. Messages that arrive twice or late are ignored, too: a mode that the vehicle has left,
    an answer to an earlier attempt. An impossible message is a sign of life only, and an exception in the handling of
    a message costs only that message (`gate`). But while reports of the vehicle's owner cannot be taken in, the
    vehicle counts as silent, and gets no command. `firmware`, one of the `firmwares`, is valid after `found`
    returned.
    """

    def __init__(
        self,
        connection: str | Opener,
        patience: DriverPatience,
        firmwares: Sequence[FirmwareProfile],
        *,
        signing: Signing | None = None,
        system: int | None = None,
    ) -> None:
        self.news = VehicleNewsFeed()
        self.telemetry = VehicleTelemetry()
        self.patience = patience
        self.identity = Identity(firmwares, system=system, news=self.news)
        self._loop = asyncio.get_running_loop()
        self._missed_s: dict[str, float] = {}  # when a report of the owner could not be taken in, by its kind
        self.latch = Latch(self.now_s)
        self._were_armed = False  # the motors, when their state was last judged
        self._listeners: list[Callable[[Message], None]] = []
        self._texts_told = 0
        self._silent_s = 0.0  # in all, of silences that are over
        self._numbering = Numbering()
        self._clock = BootClock()
        self._streams = Streams(self.question, quiet_after_s=patience.quiet_after_s, news=self.news)
        self._judges_from_s = math.inf  # the sequence numbers, as until then two vehicles may send them
        self._asks = False  # whether to ask for reports: not before the right vehicle is certain
        self._only_signed = True  # whether each message of the vehicle was signed
        self._is_signing = signing is not None
        self._last_heard_s = self.now_s
        self.mode_told_s = -math.inf  # when it last reported its mode
        self._news = asyncio.Event()
        self._link = MavlinkLink(
            connection,
            partial(self._spare, self._sort_out),
            signing=signing,
            follows=self.identity.follows,
            overheard=partial(self._spare, self.identity.overhear),
            moved_after_s=patience.dead_after_s,
        )
        self.heartbeat_word: Callable[[], int] = lambda: 0  # the custom_mode of our heartbeats
        self.hindrance: Callable[[], str] = lambda: ""  # the known reason why a verb takes long
        self.missed_after_s = math.inf  # after a silence of this length its dead man may have acted
        self._tasks = [self._keep_up(self._accompany), self._keep_up(self._watch_link)]

    async def found(
        self, *, within_s: float, waiting: Callable[[str, float], None] = lambda *_: None
    ) -> None:
        """Returns when the vehicle sends heartbeats, and no other vehicle does.

        Raises AutopilotNotHeard if no vehicle sends any; AutopilotError if the vehicle cannot be flown, if there are
        several, or if the vehicle answers signed questions only. `waiting` gets the reason of the wait and its
        seconds.
        """
        await first_heartbeat(
            self._link, self.identity, self._news.wait, within_s=within_s, waiting=waiting
        )  # the vehicle's first message sets the event
        if self.identity.system is None:
            await self.look_for_others("connect")
        self.require_alone("connect")
        self._asks, self._judges_from_s = True, self.now_s + self.patience.others_s
        self._streams.begin(self.firmware, self.now_s)
        if self._is_signing or not self._only_signed:
            return
        # A vehicle that signs may hear only signed messages: it answers no question then.
        answered = await self.happens(
            "connect", lambda: bool(self.telemetry.answers), within_s=self.patience.signed_s
        )
        if not answered:
            raise AutopilotRefused("connect", f"{self.identity.vehicle} on {self._link.connection} {_SIGNS}")

    async def look_for_others(self, step: str) -> None:
        """Looks for other vehicles for `others_s`, by questions; raises AutopilotRefused if several may be meant.

        Once the vehicle is found, silences of the link do not count.
        """
        left_s = self.patience.others_s
        while left_s > 0:
            self.ask(self.identity.twins.question(self.now_s))
            if self._asks:
                self.ask_for(_HOME_POSITION)
            await self.happens(step, lambda: bool(self.identity.doubt), within_s=min(_LOOKS_EACH_S, left_s))
            self.require_alone(step)
            left_s -= _LOOKS_EACH_S if self.linked or not self._asks else 0.0

    def require_alone(self, step: str) -> None:
        """Raises AutopilotRefused while several vehicles may be meant."""
        if self.identity.doubt:
            raise AutopilotRefused(step, self.identity.doubt)

    @property
    def firmware(self) -> FirmwareProfile:
        """The vehicle's firmware; valid after `found`."""
        return self.identity.firmware

    @property
    def found_vehicle(self) -> AutopilotInfo:
        """The vehicle's ids and type; valid after `found`."""
        vehicle = self.identity.vehicle
        assert vehicle is not None, "it was not found yet"  # noqa: S101
        return vehicle

    @property
    def ids(self) -> tuple[int, int]:
        """The vehicle's system and component; before `found` zeros, which address all systems."""
        return self.identity.ids or (0, 0)

    @property
    def now_s(self) -> float:
        """The event loop's time, in seconds."""
        return self._loop.time()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the vehicle's first message, by its own clock."""
        return self._clock.elapsed_s

    @property
    def mode_name(self) -> str:
        """The flight mode's name."""
        mode = self.telemetry.mode
        return "unknown" if mode is None else self.firmware.mode_name(mode)

    @property
    def said_lately(self) -> str:
        """The vehicle's texts of the last three seconds, the most severe first."""
        return self.telemetry.said_lately(self.now_s)

    @contextlib.contextmanager
    def listening(self, hear: Callable[[Message], None]) -> Iterator[None]:
        """Calls `hear` with each message of the vehicle until the end of the block."""
        self._listeners.append(hear)
        try:
            yield
        finally:
            self._listeners.remove(hear)

    @property
    def linked(self) -> bool:
        """Whether the vehicle's last message is younger than `quiet_after_s`."""
        return self.now_s < self._last_heard_s + self.patience.quiet_after_s

    async def link_lost(self) -> None:
        """Waits until no message of the vehicle has come for `quiet_after_s`."""
        while self.linked:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(self._last_heard_s + self.patience.quiet_after_s):
                    await self._news.wait()

    async def link_restored(self) -> None:
        """Waits for a message of the vehicle; returns at once while it is linked."""
        while not self.linked:
            await self._news.wait()

    @property
    def silent_s(self) -> float:
        """Seconds since the vehicle's last message."""
        return self.now_s - self._last_heard_s

    def heard_since(self, number: int, time_s: float) -> bool:
        """Whether a message of that number has come since `time_s`."""
        return self._streams.heard_s(number) >= time_s

    @property
    def unix_s(self) -> float | None:
        """The time now by the vehicle's GPS, in seconds since 1970; None while it does not know it."""
        reported_s = self.telemetry.unix_s
        return reported_s and reported_s + self.now_s - self._streams.heard_s(_SYSTEM_TIME)

    async def close(self) -> None:
        """Closes the connection; the vehicle is left as it is."""
        await end(*self._tasks)
        await self._link.close()

    def _keep_up(self, work: Callable[[], Coroutine[Any, Any, None]]) -> asyncio.Task[None]:
        """Run the work, and again after a defect, with a warning: a vehicle without messages may end the flight."""

        def tell(defect: Exception) -> None:
            why = f"a defect of upwash: {worded(defect)}"
            self.news.tell(LinkTrouble(about="defect", why=why))

        kept = kept_up(work, name="the vehicle's link", pause_s=_HEARTBEAT_S, failed=tell)
        return start(kept, name="the vehicle's link", failed=only_logged)

    async def until(self, step: str, condition: Callable[[], bool]) -> None:
        """Waits until the condition, checked at each message, is true; raises AutopilotLost on silence."""
        while not condition():
            try:
                async with asyncio.timeout_at(self._last_heard_s + self.patience.lost_after_s):
                    await self._news.wait()
            except TimeoutError:
                link, lost_after_s = self._link, self.patience.lost_after_s
                what = (
                    "nothing was" if link.silent_s > lost_after_s / 2 else "others, and not the vehicle, were"
                )
                problem = f"{what} heard on {link.connection} for {lost_after_s:g} s{link.why_silent}"
                raise AutopilotLost(step, problem) from None

    async def happens(self, step: str, condition: Callable[[], bool], *, within_s: float) -> bool:
        """Waits for the condition; returns whether it became true within the time."""
        try:
            async with asyncio.timeout(within_s):
                await self.until(step, condition)
        except TimeoutError:
            return False
        return True

    @contextlib.asynccontextmanager
    async def limited(self, step: str, timeout_s: float) -> AsyncIterator[None]:
        """Raises AutopilotTimeout if the block takes longer; silences of the link do not count."""
        begun_s, silent_before_s = self.now_s, self._silence_so_far_s()
        timer: asyncio.TimerHandle

        def look() -> None:
            nonlocal timer
            silent_s = self._silence_so_far_s() - silent_before_s
            left_s = begun_s + timeout_s + silent_s - self.now_s
            if left_s <= 0 and self.linked:
                limit.reschedule(self.now_s)
            else:
                timer = self._loop.call_later(max(left_s, self.patience.answer_s / 2), look)

        try:
            async with asyncio.timeout(None) as limit:
                timer = self._loop.call_later(timeout_s, look)
                yield
        except TimeoutError:
            problem = f"not done within {timeout_s:.0f} s, in mode {self.mode_name}{self.hindrance()}"
            raise AutopilotTimeout(step, problem, self.said_lately) from None
        finally:
            timer.cancel()

    def ask(self, message: Message) -> None:
        """Sends a question to the vehicle: a message that changes nothing about its flight."""
        self._link.send(message)

    def ask_for(self, number: int) -> None:
        """Asks for one report of that message number; HEARTBEAT has the mode, and comes once a second by itself."""
        self.question(mavlink.MAV_CMD_REQUEST_MESSAGE, number)

    def question(self, command: int, *parameters: float) -> None:
        """Sends a command that only asks, once, without a wait for its answer."""
        self.ask(self.command_long(command, *parameters))

    async def answered(
        self, step: str, ask: Callable[[], None], answer: Callable[[], object], *, times: int
    ) -> bool:
        """Asks up to `times` times, until `answer()` is true; returns whether it is true in the end."""
        for _ in range(times):
            if answer():
                return True
            ask()
            await self.happens(step, lambda: bool(answer()), within_s=self.patience.answer_s)
        return bool(answer())

    def command_long(self, command: int, *parameters: float) -> Message:
        """A COMMAND_LONG to the vehicle; missing parameters are 0."""
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        return mavlink.MAVLink_command_long_message(*self.ids, command, 0, *padded)

    def beat(self) -> None:
        """Sends a heartbeat, in addition to the one each second."""
        self._link.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                base_mode=0,
                custom_mode=self.heartbeat_word(),
                system_status=mavlink.MAV_STATE_ACTIVE,
                mavlink_version=3,
            )
        )

    def _silence_so_far_s(self) -> float:
        silent_s = self.silent_s
        return self._silent_s + (silent_s if silent_s >= self.patience.quiet_after_s else 0.0)

    def _spare(self, step: Callable[..., object], message: Message, *more: float) -> bool:
        return self.news.spare(message, partial(step, message, *more))

    def _sort_out(self, message: Message) -> None:
        identity, linked, now_s = self.identity, self.linked, self.now_s
        if identity.meet(message):
            self._link.speak_as_part_of(message.get_srcSystem())
        if sender_of(message) != identity.ids or not identity.believes(message, now_s):
            return
        if not self._numbering.is_news(message, now_s, linked=linked):
            return
        if self.silent_s >= self.missed_after_s:  # the dead man's own text is lost in a long silence
            why = f"its dead man, after {self.silent_s:.0f} s without a link"
            self.telemetry.suspect_dead_man(why, now_s)
        is_report = admits(message, self.firmware.ranges, self.news) and self._take_in(message, now_s)
        if all(now_s - missed_s > _BLIND_S for missed_s in self._missed_s.values()):
            self._count_as_heard(message, now_s, is_report=is_report, linked=linked)
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _take_in(self, message: Message, now_s: float) -> bool:
        """Run all steps with the message; return whether all succeeded. A failed step does not skip the others."""
        steps = (
            self._look_for_restart,
            self.telemetry.take,
            partial(self.firmware.take, self.telemetry),
            self._take_control,
            self._tell_texts,
        )
        done = [self._spare(step, message, now_s) for step in steps]
        done += [self._spare(hear, message) for hear in tuple(self._listeners)]
        kind = message.get_type()
        if all(done):
            self._missed_s.pop(kind, None)
        elif kind in _TELL_WHOSE:
            self._missed_s[kind] = now_s
        return all(done)

    def _count_as_heard(self, message: Message, now_s: float, *, is_report: bool, linked: bool) -> None:
        """Note a message as a sign of life, and if `is_report` as a report."""
        self._silent_s = self._silence_so_far_s()
        self._last_heard_s = now_s
        self._only_signed &= is_signed(message)
        if is_report:
            self._streams.heard(message, now_s)
        if self._asks and not linked:
            self.ask_for(_HEARTBEAT)
            self._streams.begin(self.firmware, now_s)

    def _look_for_restart(self, message: Message, now_s: float) -> None:
        """Report a restart to the latch; forget the landed state from before it."""
        before_s, boot_ms = self._clock.boot_s, getattr(message, "time_boot_ms", None)
        if boot_ms is None or not self._clock.take(boot_ms / 1e3, now_s):
            return
        self.telemetry.landed_state = mavlink.MAV_LANDED_STATE_UNDEFINED
        why = f"its autopilot restarted: its clock went from {before_s:.0f} s after boot to {boot_ms / 1e3:.0f} s"
        self._judge(lambda: self.latch.report_restart(why, now_s))

    def judge_target(self, place: Position | None) -> None:
        """Report the vehicle's target, above the sea, to the latch; None: the vehicle follows a velocity."""
        self._judge(lambda: self.latch.report_target(place, self.now_s))

    def _judge(self, report: Callable[[], None]) -> None:
        before = self.latch.control
        report()
        if self.latch.control != before:
            self.news.tell(self.latch.control)

    def _take_control(self, message: Message, now_s: float) -> None:
        """Report each heartbeat to the latch, and modes that a fail-safe chose."""
        if self.telemetry.mode is None or message.get_type() not in (*_TELL_THE_MODE, *_TELL_WHY):
            return
        if self.telemetry.disarms:
            if message.get_type() == "HEARTBEAT" and self.telemetry.disarms == 1:
                self.ask_for(_HEARTBEAT)  # a second one in a row confirms that its motors stopped
            return
        if message.get_type() in _TELL_THE_MODE:
            self.mode_told_s = now_s
        mode, telemetry = self.mode_name, self.telemetry
        armed, failsafe = telemetry.armed, self.firmware.failsafe(telemetry, mode)
        # ArduCopter says that it stands as soon as its motors stop, wherever that is.
        stood = telemetry.disarmed_s - telemetry.airborne_s > _STOOD_S
        stands = telemetry.stands if armed or stood else False
        heartbeat = Heartbeat(mode, armed, failsafe, stands, telemetry.remote.moved(now_s))
        self._judge(lambda: self.latch.report(heartbeat, now_s))
        if self._were_armed and not armed and not self.latch.control.is_ours:
            self.ask_for(_SYSTEM_TIME)  # which shows a restart
        self._were_armed = armed

    def _tell_texts(self, _message: Message, _now_s: float) -> None:
        new = self.telemetry.texts_heard - self._texts_told
        self._texts_told = self.telemetry.texts_heard
        for _, text in list(self.telemetry.texts)[-new:] if new else ():
            self.news.tell(text)

    async def _accompany(self) -> None:
        """Send heartbeats as a companion computer: a second ground station would hide the loss of the real one."""
        for number in itertools.count():
            await self._link.opened.wait()
            self.beat()
            self._look_at_reports()
            # A peer that vanished silently leaves a connection behind that brings nothing.
            self._link.reopen_if_dead(self.patience.dead_after_s)
            if self.identity.ids and number % round(1 / self._streams.share) == 0:
                self.ask(self.identity.twins.question(self.now_s))
            await asyncio.sleep(_HEARTBEAT_S)

    async def _watch_link(self) -> None:
        """Report each silence, once the vehicle was found."""
        while self.identity.ids is None:
            await self._news.wait()
        while True:
            await self.link_lost()
            self.news.tell(LinkLost(silent_s=round(self.silent_s, 1)))
            since_s = self._last_heard_s
            await self.link_restored()
            self.news.tell(LinkRestored(silent_s=round(self._last_heard_s - since_s, 1)))

    def _look_at_reports(self) -> None:
        """Ask for missing reports, and warn of sequence numbers that do not count up."""
        if not self._asks:
            return
        numbering = self._numbering
        self._streams.look(self.now_s, linked=self.linked, received_share=numbering.received_share)
        if numbering.counts_up:  # a vehicle that joins later shows within this time, too
            self._judges_from_s = self.now_s + self.patience.others_s
        if numbering.wrong_times >= _WRONG_TIMES and self._is_alone():
            self.news.once("numbers", _NUMBERS_PROBLEM)

    def _is_alone(self) -> bool:
        """Whether other vehicles had time to show, and none did."""
        return self.now_s >= self._judges_from_s and not self.identity.doubt
