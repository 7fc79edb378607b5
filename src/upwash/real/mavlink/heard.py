"""A vehicle at the other end of a MAVLink connection, as far as it is listened to and asked.

Questions, such as for a report or a parameter, change nothing: they are sent whoever has the vehicle.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Sequence
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.admission.limits import Allowance
from upwash.core.geo import Position
from upwash.core.vehicle.control import Heartbeat, Latch
from upwash.errors import AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.mavlink.signing import Signing
from upwash.ports import HomeMoved, LinkChanged, LinkTrouble, PositionDoubted, VehicleNews, VehicleText
from upwash.real.mavlink.boot_clock import BootClock
from upwash.real.mavlink.firmware import Firmware
from upwash.real.mavlink.hearing import Message, is_signed
from upwash.real.mavlink.identity import Heard, Identity, sender_of
from upwash.real.mavlink.link import MavlinkLink
from upwash.real.mavlink.numbering import Numbering
from upwash.real.mavlink.ranges import admits
from upwash.real.mavlink.search import Search
from upwash.real.mavlink.settings import Patience
from upwash.real.mavlink.streams import Streams
from upwash.real.mavlink.telemetry import Telemetry
from upwash.real.mavlink.troubles import Troubles
from upwash.support.background import end, kept_up, only_logged, start

_HEARTBEAT_S = 1.0
_TELL_THE_MODE = ("HEARTBEAT", "CURRENT_MODE", "FENCE_STATUS")
_TELL_WHOSE = ("HEARTBEAT", "CURRENT_MODE", "POSITION_TARGET_GLOBAL_INT", "POSITION_TARGET_LOCAL_NED")
_BLIND_S = (
    1.5  # after a defect in taking one of these in, unless the next one was taken in; they come once a second
)
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
_NEWS_KEPT = 1000  # until somebody listens
_AT_WILL = VehicleText, HomeMoved, PositionDoubted  # what a vehicle, or a forger, may say without end
_AT_WILL_PER_S, _AT_WILL_AT_ONCE = 5.0, 100.0


class HeardVehicle:
    """The vehicle with that `system` on the connection, or without `system` the only vehicle on it.

    Others on the connection are ignored. Messages that arrive twice or late are ignored too: a mode that the vehicle
    has left, an answer to an earlier attempt. A message that cannot be true is a sign of life and nothing else
    (`ranges`), and an exception in the handling of one costs that message alone (`troubles`). But while reports of
    whose the vehicle is cannot be taken in, the vehicle counts as silent, and gets no command. `firmwares` can be
    flown; `firmware` is right after `found` returned.
    """

    def __init__(
        self,
        connection: str,
        patience: Patience,
        firmwares: Sequence[Firmware],
        *,
        signing: Signing | None = None,
        system: int | None = None,
    ) -> None:
        self.telemetry = Telemetry()
        self.patience = patience
        self.identity = Identity(firmwares, system=system, tell=self.tell)
        self._loop = asyncio.get_running_loop()
        self._troubles = Troubles(self.tell)
        self._at_will = Allowance(_AT_WILL_PER_S, at_once=_AT_WILL_AT_ONCE)
        self._missed_s: dict[str, float] = {}  # when a report of the owner could not be taken in, by its kind
        self.latch = Latch(self._loop.time())
        self._hear_news: Callable[[VehicleNews], None] | None = None
        self._unheard_news: deque[VehicleNews] = deque(maxlen=_NEWS_KEPT)
        self._listeners: list[Callable[[Message], None]] = []
        self._texts_told = 0
        self._silent_s = 0.0  # in all, of silences that are over
        self._numbering = Numbering()
        self._clock = BootClock()
        self._streams = Streams(self.question, quiet_after_s=patience.quiet_after_s, tell=self.tell)
        self._asks = False  # whether to ask for reports: not before the right vehicle is certain
        self._only_signed = True  # whether each message of the vehicle was signed
        self._is_signing = signing is not None
        self._told_numbers = False
        self._last_heard_s = self._loop.time()
        self.mode_told_s = -math.inf  # when it last was
        self._news = asyncio.Event()
        self._link = MavlinkLink(
            connection,
            self._hear,
            signing=signing,
            follows=self.identity.follows,
            overheard=self._overhear,
            moved_after_s=patience.dead_after_s,
        )
        self.heartbeat_word: Callable[[], int] = lambda: 0  # what else each of our heartbeats says
        self.hindrance: Callable[[], str] = lambda: ""  # what is known of why it takes long
        self.missed_after_s = math.inf  # after so long a silence of the link its dead man may have acted
        self._tasks = [self._keep_up(self._accompany), self._keep_up(self._watch_link)]

    async def found(
        self, *, within_s: float, waiting: Callable[[str, float], None] = lambda *_: None
    ) -> None:
        """Returns when the vehicle sends heartbeats, and no other vehicle does.

        Raises AutopilotNotHeard if no vehicle sends any. Raises AutopilotError if a vehicle that cannot be flown
        does, if several vehicles do, or if the vehicle answers signed questions alone. `waiting` gets the reason of
        the wait and its seconds.
        """
        search = Search(self._link, self.identity)
        await search.over(
            self._news.wait, within_s=within_s, waiting=waiting
        )  # the vehicle's first message sets the event
        if self.identity.system is None:
            await asyncio.sleep(self.patience.others_s)
        self.require_alone("connect")
        self._asks = True
        self._streams.begin(self.firmware, self._loop.time())
        await self._require_answers()

    def require_alone(self, step: str) -> None:
        """Raises AutopilotRefused while several vehicles may be meant."""
        if self.identity.doubt:
            raise AutopilotRefused(step, self.identity.doubt)

    async def _require_answers(self) -> None:
        """A vehicle that signs may hear nothing that is not signed: it answers no question then."""
        if self._is_signing or not self._only_signed:
            return
        if not await self.happens(
            "connect", lambda: bool(self.telemetry.answers), within_s=self.patience.signed_s
        ):
            raise AutopilotRefused("connect", f"{self.identity.vehicle} on {self._link.connection} {_SIGNS}")

    @property
    def firmware(self) -> Firmware:
        """What it runs, once it was found."""
        return self.identity.firmware

    @property
    def found_vehicle(self) -> Heard:
        """What its heartbeat says that it is, once it was found."""
        vehicle = self.identity.vehicle
        assert vehicle is not None, "it was not found yet"  # noqa: S101
        return vehicle

    @property
    def ids(self) -> tuple[int, int]:
        """Its system and component; zeros, which stand for everybody, until it was found."""
        return self.identity.ids or (0, 0)

    @property
    def now_s(self) -> float:
        """The loop's time."""
        return self._loop.time()

    @property
    def elapsed_s(self) -> float:
        """The vehicle's own time, from when it was first heard."""
        return self._clock.elapsed_s

    @property
    def mode_name(self) -> str:
        """The flight mode's name."""
        mode = self.telemetry.mode
        return "unknown" if mode is None else self.firmware.mode_name(mode)

    @property
    def said_lately(self) -> str:
        """What it said in the last seconds, the most severe first."""
        return self.telemetry.said_lately(self._loop.time())

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """Has `hear` called with all news, and first with those since the connection was made."""
        self._hear_news = hear
        while self._unheard_news:
            hear(self._unheard_news.popleft())

    def tell(self, news: VehicleNews) -> None:
        """Passes news on to the listener, or keeps the news until there is one; floods are cut to five a second."""
        if isinstance(news, _AT_WILL) and not self._at_will.take(1, now_s=self._loop.time()):
            what = type(news).__name__
            self._troubles.count("flood", what, f"the vehicle says more than is told and logged ({what})")
            return
        if self._hear_news:
            self._hear_news(news)
        else:
            self._unheard_news.append(news)

    @contextlib.contextmanager
    def listening(self, hear: Callable[[Message], None]) -> Iterator[None]:
        """Has `hear` called with each message of the vehicle until the end of the block."""
        self._listeners.append(hear)
        try:
            yield
        finally:
            self._listeners.remove(hear)

    @property
    def linked(self) -> bool:
        """Whether the vehicle has been heard lately."""
        return self._loop.time() < self._last_heard_s + self.patience.quiet_after_s

    async def link_lost(self) -> None:
        """Returns when nothing has been heard of the vehicle for `quiet_after_s`."""
        while self.linked:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(self._last_heard_s + self.patience.quiet_after_s):
                    await self._news.wait()

    async def link_restored(self) -> None:
        """Returns when the vehicle is heard, at once if it is."""
        while not self.linked:
            await self._news.wait()

    @property
    def silent_s(self) -> float:
        """For how long nothing has been heard of it."""
        return self._loop.time() - self._last_heard_s

    def heard_since(self, number: int, time_s: float) -> bool:
        """Whether the message of that number has come since then."""
        return self._streams.heard_s(number) >= time_s

    @property
    def unix_s(self) -> float | None:
        """The time now by the vehicle's GPS; None while it does not know it."""
        told_s = self.telemetry.unix_s
        return told_s and told_s + self._loop.time() - self._streams.heard_s(
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
        )

    async def close(self) -> None:
        """Gives up the connection."""
        await end(*self._tasks)
        await self._link.close()

    def _keep_up(self, work: Callable[[], Coroutine[Any, Any, None]]) -> asyncio.Task[None]:
        """Has the work go on after a defect, with a warning: a vehicle that hears nothing may end the flight."""

        def tell(defect: Exception) -> None:
            self.tell(LinkTrouble("defect", f"a defect of upwash: {type(defect).__name__}: {defect}"))

        kept = kept_up(work, name="the vehicle's link", pause_s=_HEARTBEAT_S, failed=tell)
        return start(kept, name="the vehicle's link", failed=only_logged)

    async def until(self, step: str, condition: Callable[[], bool]) -> None:
        """Returns when the condition, looked at with each message, is true; raises AutopilotLost on silence."""
        while not condition():
            try:
                async with asyncio.timeout_at(self._last_heard_s + self.patience.lost_after_s):
                    await self._news.wait()
            except TimeoutError:
                raise AutopilotLost(step, self._silence()) from None

    async def happens(self, step: str, condition: Callable[[], bool], *, within_s: float) -> bool:
        """Whether the condition comes true within the time."""
        try:
            async with asyncio.timeout(within_s):
                await self.until(step, condition)
        except TimeoutError:
            return False
        return True

    @contextlib.asynccontextmanager
    async def limited(self, step: str, timeout_s: float) -> AsyncIterator[None]:
        """Raises AutopilotTimeout where the block takes longer; silences of the link do not count."""
        begun_s, silent_before_s = self._loop.time(), self._silence_so_far_s()
        timer: asyncio.TimerHandle

        def look() -> None:
            nonlocal timer
            silent_s = self._silence_so_far_s() - silent_before_s
            left_s = begun_s + timeout_s + silent_s - self._loop.time()
            if left_s <= 0 and self.linked:
                limit.reschedule(self._loop.time())
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

    def ask(self, message: Callable[[int, int], Message]) -> None:
        """Sends a question, made for a system and component: one that changes nothing about how the vehicle flies."""
        self._link.send(message(*self.ids))

    def ask_for(self, number: int) -> None:
        """Asks for one report of that message number. A mode comes by HEARTBEAT, up to a second late by itself."""
        self.question(mavlink.MAV_CMD_REQUEST_MESSAGE, number)

    def question(self, command: int, *parameters: float) -> None:
        """Sends a command that only asks, once; nobody waits for its answer."""
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self.ask(
            lambda system, component: mavlink.MAVLink_command_long_message(
                system, component, command, 0, *padded
            )
        )

    def beat(self) -> None:
        """Sends a heartbeat, as it also does once a second."""
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
        now_silent_s = self._loop.time() - self._last_heard_s
        return self._silent_s + (now_silent_s if now_silent_s >= self.patience.quiet_after_s else 0.0)

    def _spare(self, step: Callable[..., None], message: Message, *more: float) -> bool:
        return self._troubles.spare(message, partial(step, message, *more))

    def _overhear(self, message: Message) -> None:
        self._spare(self.identity.overhear, message)

    def _hear(self, message: Message) -> None:
        self._spare(self._sort_out, message)

    def _sort_out(self, message: Message) -> None:
        identity, linked, now_s = self.identity, self.linked, self._loop.time()
        if identity.meet(message):
            self._link.speak_as_part_of(message.get_srcSystem())
        if sender_of(message) != identity.ids or not identity.believes(message, now_s):
            return
        if not self._numbering.is_news(message, now_s, linked=linked):
            return
        self._suspect_dead_man(now_s)
        is_report = admits(message, self.firmware.ranges, self._troubles) and self._take_in(message, now_s)
        if all(now_s - missed_s > _BLIND_S for missed_s in self._missed_s.values()):
            self._count_as_heard(message, now_s, is_report=is_report, linked=linked)
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _take_in(self, message: Message, now_s: float) -> bool:
        """Whether all of it was taken in; no step misses the message because another fails."""
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
        """It is a sign of life, and a report where it was taken in."""
        self._silent_s = self._silence_so_far_s()
        self._last_heard_s = now_s
        self._only_signed &= is_signed(message)
        if is_report:
            self._streams.heard(message, now_s)
        if self._asks and not linked:
            self.ask_for(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            self._streams.begin(self.firmware, now_s)

    def _suspect_dead_man(self, now_s: float) -> None:
        """What it said when it acted is lost where the link was."""
        silent_s = now_s - self._last_heard_s
        if silent_s >= self.missed_after_s:
            self.telemetry.suspect_dead_man(f"its dead man, after {silent_s:.0f} s without a link", now_s)

    def _look_for_restart(self, message: Message, now_s: float) -> None:
        """Tells the latch; what the vehicle said before of the ground is not true any more."""
        before_s, boot_ms = self._clock.boot_s, getattr(message, "time_boot_ms", None)
        if boot_ms is None or not self._clock.take(boot_ms / 1e3, now_s):
            return
        self.telemetry.landed_state = mavlink.MAV_LANDED_STATE_UNDEFINED
        why = f"its autopilot restarted: its clock went from {before_s:.0f} s after boot to {boot_ms / 1e3:.0f} s"
        self._judge(lambda: self.latch.report_restart(why, now_s))

    def judge_target(self, place: Position | None) -> None:
        """Tells the latch where the vehicle says that it steers to, above the sea; None: it follows a velocity."""
        self._judge(lambda: self.latch.report_target(place, self._loop.time()))

    def _judge(self, report: Callable[[], None]) -> None:
        before = self.latch.control
        report()
        if self.latch.control != before:
            self.tell(self.latch.control)

    def _take_control(self, message: Message, now_s: float) -> None:
        """Feeds the latch with each heartbeat, and with what says that a fail-safe chose the mode."""
        if self.telemetry.mode is None or message.get_type() not in _TELL_THE_MODE:
            return
        if message.get_type() != "FENCE_STATUS":
            self.mode_told_s = now_s
        mode, told = self.mode_name, self.telemetry
        # ArduCopter says that it stands as soon as its motors stop, wherever that is.
        stands = told.stands if told.armed or now_s - told.airborne_s > _STOOD_S else False
        moved = told.remote.moved(now_s)
        report = Heartbeat(mode, told.armed, self.firmware.failsafe(told, mode), stands, moved)
        self._judge(lambda: self.latch.report(report, now_s))
        if told.disarmed_s == now_s and not self.latch.control.is_ours:
            self.ask_for(mavlink.MAVLINK_MSG_ID_SYSTEM_TIME)  # which tells a restart

    def _tell_texts(self, _message: Message, _now_s: float) -> None:
        new = self.telemetry.texts_heard - self._texts_told
        self._texts_told = self.telemetry.texts_heard
        for _, text in list(self.telemetry.texts)[-new:] if new else ():
            self.tell(text)

    async def _accompany(self) -> None:
        """Heartbeats as a companion computer: as a ground station it would hide the loss of the real one."""
        while True:
            await self._link.opened.wait()
            self.beat()
            self._look_at_reports()
            self._leave_a_dead_connection()
            await asyncio.sleep(_HEARTBEAT_S)

    async def _watch_link(self) -> None:
        """Tells of each silence, once the vehicle was found."""
        while self.identity.ids is None:
            await self._news.wait()
        while True:
            await self.link_lost()
            self.tell(LinkChanged(linked=False, silent_s=self.silent_s))
            since_s = self._last_heard_s
            await self.link_restored()
            self.tell(LinkChanged(linked=True, silent_s=self._last_heard_s - since_s))

    def _look_at_reports(self) -> None:
        """Has them asked for where they are missing, and tells of numbers that do not count."""
        if not self._asks:
            return
        numbering = self._numbering
        share = numbering.received_share
        self._streams.look(self.firmware, self._loop.time(), linked=self.linked, received_share=share)
        if numbering.wrong_times >= _WRONG_TIMES and not self._told_numbers:
            self._told_numbers = True
            self.tell(LinkTrouble("numbers", _NUMBERS_PROBLEM))

    def _leave_a_dead_connection(self) -> None:
        """A peer that vanished without a word leaves a connection behind on which nothing ever comes."""
        last_sign_s = max(self._last_heard_s, self._link.opened_s)
        if self._loop.time() - last_sign_s > self.patience.dead_after_s:
            self._link.reopen()

    def _silence(self) -> str:
        link, lost_after_s = self._link, self.patience.lost_after_s
        return f"nothing was heard on {link.connection} for {lost_after_s:g} s{link.why_silent}"
